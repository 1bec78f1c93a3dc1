//! A differentiable powder simulator: scenes, skills, rollouts, losses and their exact adjoint.

pub mod bench;
pub mod memory;
pub mod mpm;
pub mod real;
pub mod rollout;
pub mod scene;
mod shape;
pub mod skill;
mod small;
