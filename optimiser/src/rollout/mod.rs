//! What the optimiser asks of a simulator.

use crate::{
    scene::Scene,
    skill::{SkillError, Theta},
};
use powderline_shared::{displacement::Displacement, plan::Precision};
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

/// How a scene is simulated. Nothing here but seed and precision changes a bit of the result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SimulatorSettings {
    /// Seed of the packing.
    pub seed: u64,
    /// Number format of the powder's state.
    pub precision: Precision,
    /// Threads; as many as the machine has processors when not given.
    pub threads: Option<usize>,
    /// Most memory that the process may take, bytes; checkpoints are chosen to fit.
    pub memory_bytes: u64,
}

/// Why a scene cannot be simulated with the given settings.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SimulatorError {
    /// This version of the program has none.
    #[error("this version of the program cannot simulate yet")]
    Missing,
}

/// The simulator of a scene: the one place where the commands get it from.
///
/// # Errors
/// See [`SimulatorError`].
pub fn simulator(_scene: &Scene, _settings: &SimulatorSettings) -> Result<Box<dyn Evaluate>, SimulatorError> {
    Err(SimulatorError::Missing)
}
