//! Differentiable MLS-MPM powder simulator and the optimiser of scooping skills.

pub mod scene;
