//! From a bench description to a motion: simulation, gradient, skill, optimiser, plan.

pub mod bench;
pub mod cli;
pub mod compare;
pub mod memory;
mod mpm;
pub mod optim;
pub mod real;
pub mod report;
pub mod rollout;
pub mod scene;
mod shape;
pub mod skill;
mod small;
