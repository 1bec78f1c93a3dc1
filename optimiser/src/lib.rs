//! From a bench description to a motion: simulation, gradient, skill, optimiser, plan.

pub mod optim;
pub mod rollout;
pub mod scene;
pub mod skill;
