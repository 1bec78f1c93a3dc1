//! Differentiable MLS-MPM powder simulator and the optimiser of scooping skills.

pub mod cli;
pub mod memory;
pub mod optim;
pub mod report;
pub mod rollout;
pub mod scene;
pub mod skill;
