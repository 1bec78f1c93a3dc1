//! Differentiable powder simulator and skill optimiser.

mod mpm;
mod real;
pub mod scene;
mod shape;
mod small;
