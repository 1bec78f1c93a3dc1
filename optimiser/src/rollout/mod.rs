//! What the optimiser asks of a simulator.

use crate::skill::{SkillError, Theta};
use powderline_shared::displacement::Displacement;
use thiserror::Error;

/// What one simulated motion achieved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evaluation {
    /// Sum of the distances of the observed particles from the target point, metres.
    pub loss: f64,
    /// Target count minus the particles inside the target container at the end.
    pub indicator: i64,
    /// Particles inside the target container at the end.
    pub transported: u32,
    /// Particles inside no container at the end.
    pub spilled: u32,
    /// Derivative of the loss with respect to theta, when asked for.
    pub gradient: Option<Theta>,
}

/// Called now and then with work units done and in total; `false` stops the rollout with [`RolloutError::Stopped`].
pub type Progress<'a> = &'a mut dyn FnMut(u64, u64) -> bool;

/// Why a rollout has no result.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum RolloutError {
    /// The progress callback asked for it.
    #[error("stopped on request")]
    Stopped,
    /// A number of the simulation is NaN or infinite.
    #[error(
        "{stage} of control step {step}, substep {substep} gave particle {particle} a value that is not finite"
    )]
    NonFinite {
        /// Stage of the substep, forward or adjoint.
        stage: &'static str,
        /// Control step.
        step: u32,
        /// Substep within the control step.
        substep: u32,
        /// Particle.
        particle: u32,
    },
    /// The skill is not a motion.
    #[error(transparent)]
    Skill(#[from] SkillError),
}

/// A simulator of one scene.
pub trait Evaluate {
    /// Loss of a skill, and its gradient if wanted.
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn evaluate(
        &mut self,
        theta: &Theta,
        want_gradient: bool,
        progress: Progress<'_>,
    ) -> Result<Evaluation, RolloutError>;

    /// Loss of a given control sequence (that of a quantised plan), without gradient.
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn simulate(
        &mut self,
        controls: &[Displacement],
        progress: Progress<'_>,
    ) -> Result<Evaluation, RolloutError>;
}
