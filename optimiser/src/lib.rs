//! Differentiable MLS-MPM powder simulator and the optimiser of scooping skills.

pub mod cli;
pub mod memory;
pub mod scene;
