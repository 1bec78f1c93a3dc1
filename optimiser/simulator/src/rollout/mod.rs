//! What the optimiser asks of a simulator.

mod branches;
pub mod gradcheck;
pub(crate) mod loss;
mod outcome;
pub(crate) mod path;
pub(crate) mod schedule;
mod simulator;
#[cfg(test)]
mod tests;

pub use outcome::Destination;
pub(crate) use simulator::RolloutState;
pub use simulator::Simulator;

pub use crate::memory::Workload;
use crate::memory::least_memory;
use crate::scene::Scene;
use crate::skill::{Control, SkillError, Theta};
pub use powderline_shared::{displacement::Displacement, plan::Precision, pose::Pose};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// What one simulated motion achieved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evaluation {
    /// Loss of the scene's objective (see [`crate::scene::Aim`]), metres.
    pub loss: f64,
    /// Target count minus the particles inside the target container at the end.
    pub indicator: i64,
    /// Particles inside the target container at the end.
    pub transported: u32,
    /// Particles inside no container and not on the tool at the end.
    pub spilled: u32,
    /// Particles on the tool at the end.
    pub on_tool: u32,
    /// Derivative of the loss with respect to theta, when asked for.
    pub gradient: Option<Theta>,
}

/// Derivative of the loss with respect to one displacement of a control sequence, the others held, in the world
/// frame: what [`Displacement`] has in metres and in radians, this has per metre and per radian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DisplacementGradient {
    /// Metres of loss per metre of each component of the translation.
    pub per_metre: [f64; 3],
    /// Metres of loss per radian of each component of the rotation vector, as it stands in the displacement: about the
    /// world's axes, whatever way the tool is turned.
    pub per_radian: [f64; 3],
}

impl DisplacementGradient {
    /// The six numbers in the order of [`Displacement::components`].
    pub fn components(&self) -> [f64; 6] {
        let [x, y, z] = self.per_metre;
        let [rx, ry, rz] = self.per_radian;
        [x, y, z, rx, ry, rz]
    }
}

impl From<Control> for DisplacementGradient {
    /// From the cotangent of a [`Control`], translation before rotation vector as there.
    fn from([x, y, z, rx, ry, rz]: Control) -> Self {
        Self { per_metre: [x, y, z], per_radian: [rx, ry, rz] }
    }
}

/// A custom loss: takes the particle positions at the end of a motion (m, in packing order), returns the loss and its
/// derivative with respect to each position.
pub type LossFn<'a> = &'a (dyn Fn(&[[f64; 3]]) -> (f64, Vec<[f64; 3]>) + Sync);

/// Called now and then with work units done and in total; `false` stops the rollout with [`RolloutError::Stopped`].
pub type Progress<'a> = &'a mut (dyn FnMut(u64, u64) -> bool + Send);

/// Powder and tool at one moment of a motion.
#[derive(Clone, Copy, Debug)]
pub struct Snapshot<'a> {
    /// Control steps done.
    pub step: usize,
    /// The tool.
    pub tool: Pose,
    /// Particles in the order of the packing, metres.
    pub positions_m: &'a [[f32; 3]],
    /// Their velocities, m/s.
    pub velocities_m_s: &'a [[f32; 3]],
}

/// Looks at snapshots as they come; `false` stops the rollout with [`RolloutError::Stopped`].
pub type Observer<'a> = &'a mut (dyn FnMut(&Snapshot<'_>) -> bool + Send);

/// A motion that is recorded.
#[derive(Clone, Copy, Debug)]
pub struct Recording<'a> {
    /// Where the tool begins.
    pub anchor: &'a Pose,
    /// What it does.
    pub controls: &'a [Displacement],
    /// Control steps from one snapshot to the next, at least one; the first is that of the beginning.
    pub every: usize,
}

/// Why a rollout has no result.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
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
    /// A particle left the simulated volume.
    #[error(
        "particle {particle} left the simulated volume in control step {step}, substep {substep}: a larger domain or more substeps would hold it"
    )]
    Escaped {
        /// Control step.
        step: u32,
        /// Substep within the control step.
        substep: u32,
        /// Particle.
        particle: u32,
    },
    /// The operating system refused to start the threads.
    #[error("{threads} threads could not be started: ask for fewer")]
    Threads {
        /// How many.
        threads: usize,
    },
    /// The memory budget is too small, even with the most recomputation.
    #[error(
        "a memory budget of {} MiB is too little: this scene needs {} MiB for {}{}, with {threads} {}",
        given >> 20,
        (least >> 20) + 1,
        work.name(),
        if *besides { " and what is made of it" } else { "" },
        if *threads == 1 { "thread" } else { "threads" }
    )]
    Memory {
        /// Budget, bytes.
        given: u64,
        /// The least that will do, bytes.
        least: u64,
        /// What was to be computed.
        work: Workload,
        /// Whether the budget also had to hold output such as pictures.
        besides: bool,
        /// By how many threads.
        threads: usize,
    },
    /// A custom loss returned a number of derivatives other than the number of particles.
    #[error(
        "the loss has {given} derivatives, but there are {particles} particles: one for each would be right"
    )]
    LossGradientLength {
        /// Derivatives.
        given: usize,
        /// Particles.
        particles: usize,
    },
    /// The skill is not a motion.
    #[error(transparent)]
    Skill(#[from] SkillError),
}

impl RolloutError {
    /// The same error, its control step counted from `steps` control steps earlier.
    fn later_by(self, steps: usize) -> Self {
        let more = steps as u32;
        match self {
            Self::NonFinite { stage, step, substep, particle } => {
                Self::NonFinite { stage, step: step + more, substep, particle }
            }
            Self::Escaped { step, substep, particle } => {
                Self::Escaped { step: step + more, substep, particle }
            }
            other => other,
        }
    }
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

    /// Evaluations of several skills, without gradients, in their order.
    ///
    /// # Errors
    /// See [`RolloutError`]; that of the first skill that has one.
    fn evaluate_all(
        &mut self,
        thetas: &[Theta],
        progress: Progress<'_>,
    ) -> Result<Vec<Evaluation>, RolloutError> {
        let count = thetas.len() as u64;
        let one = |(index, theta): (u64, &Theta)| {
            self.evaluate(theta, false, &mut |done, total| progress(index * total + done, count * total))
        };
        (0..).zip(thetas).map(one).collect()
    }

    /// Loss of a given control sequence (that of a quantised plan), without gradient.
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn simulate(
        &mut self,
        controls: &[Displacement],
        progress: Progress<'_>,
    ) -> Result<Evaluation, RolloutError>;

    /// Loss of a given control sequence, and its derivative with respect to each displacement.
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn simulate_with_gradient(
        &mut self,
        controls: &[Displacement],
        progress: Progress<'_>,
    ) -> Result<(Evaluation, Vec<DisplacementGradient>), RolloutError>;

    /// Loss of a given control sequence for a tool that begins at `anchor` and not at the scene's start pose.
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn simulate_from(
        &mut self,
        anchor: &Pose,
        controls: &[Displacement],
        progress: Progress<'_>,
    ) -> Result<Evaluation, RolloutError>;

    /// The same, with snapshots on the way; and where each particle is in the end, in the order of the packing.
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn record(
        &mut self,
        recording: &Recording<'_>,
        observer: Observer<'_>,
        progress: Progress<'_>,
    ) -> Result<(Evaluation, Vec<Destination>), RolloutError>;
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

impl Default for SimulatorSettings {
    /// The first packing in `f32`, a thread for each processor, 1 GiB.
    fn default() -> Self {
        Self { seed: 1, precision: Precision::F32, threads: None, memory_bytes: 1 << 30 }
    }
}

impl SimulatorSettings {
    /// Threads, as given or one per processor.
    pub fn thread_count(&self) -> usize {
        self.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from))
    }
}

/// Checks that the memory budget suffices for `work` (gradients in reasonable time), with `besides_bytes` left for its
/// output.
///
/// # Errors
/// [`RolloutError::Memory`] if not.
pub fn check_memory(
    scene: &Scene,
    settings: &SimulatorSettings,
    work: Workload,
    besides_bytes: u64,
) -> Result<(), RolloutError> {
    let (given, threads) = (settings.memory_bytes, settings.thread_count());
    let least = least_memory(scene, settings.precision, threads, work) + besides_bytes;
    if given >= least {
        return Ok(());
    }
    Err(RolloutError::Memory { given, least, work, besides: besides_bytes > 0, threads })
}

/// The simulator of a validated scene, in the precision of the settings.
///
/// # Errors
/// See [`Simulator::new`].
pub fn boxed_simulator(
    scene: &Scene,
    settings: &SimulatorSettings,
) -> Result<Box<dyn Evaluate>, RolloutError> {
    Ok(match settings.precision {
        Precision::F32 => Box::new(Simulator::<f32>::new(scene, settings)?),
        Precision::F64 => Box::new(Simulator::<f64>::new(scene, settings)?),
    })
}

/// Loss of the initial packing, before any motion, metres.
pub fn initial_loss(scene: &Scene, seed: u64) -> f64 {
    loss::loss(scene, &scene.particle_positions_m(seed)).0
}

pub(crate) fn thread_pool(threads: usize) -> Result<rayon::ThreadPool, RolloutError> {
    let builder = rayon::ThreadPoolBuilder::new().num_threads(threads);
    builder.build().map_err(|_| RolloutError::Threads { threads })
}
