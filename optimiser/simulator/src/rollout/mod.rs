//! Motions of the tool, what the powder makes of them, and the derivative of that.
//!
//! [`Simulator::new`] gives the simulator of a scene in a precision that is known when compiling,
//! [`boxed_simulator`] in one that is chosen at run time. Both are asked through [`Simulate`]:
//!
//! | Wanted | Method |
//! |---|---|
//! | the loss of a skill | [`Simulate::evaluate`] |
//! | of several skills, side by side | [`Simulate::evaluate_all`] |
//! | of several other motions, side by side | [`Simulate::simulate_all`] |
//! | its gradient by the five parameters | [`Simulate::evaluate_with_gradient`] |
//! | a slope that holds over larger steps | [`Simulate::evaluate_restarted`] |
//! | the loss of any motion of the tool | [`Simulate::simulate`] |
//! | its derivative by every displacement | [`Simulate::simulate_with_gradient`] |
//! | the same over larger steps | [`Simulate::simulate_restarted`] |
//! | the same of a loss of one's own | [`Simulate::gradient_of_custom_loss`] |
//! | the same over larger steps | [`Simulate::restarted_gradient_of_custom_loss`] |
//! | every grain on the way, and where it ends | [`Simulate::record`] |
//! | the grains at the end alone | [`Simulate::final_positions_m`] |
//! | a motion that depends on what the powder does | [`Simulator::begin`], [`Simulator::advance`] |
//!
//! A motion is a list of displacements, one for each control step, of any length: an empty one
//! leaves the powder as it has settled, a longer one than the scene's horizon is simulated to its
//! end. Everything "at the end" is at the end of the motion given. The motion is taken as it is:
//! neither limits nor walls or gates in the tool's way are looked at
//! ([`crate::skill::SkillMap::check_limits`], [`crate::skill::collision`]). Before the motion the
//! powder settles for `time.settle_s` with the tool at its start; that is done once for all
//! motions. Gates are shut then, and open by the time since the motion began.
//!
//! # What a gradient is good for
//!
//! The adjoint is exact: the derivative of the very numbers that the forward pass computes. But the
//! motion of single grains is chaotic, so that it says little beyond small steps.
//! `optimise gradcheck bench-small` ([`gradcheck`]) compares it with central differences over
//! half-steps from 1e-3 to 1e-7 in theta. The largest relative error of a component, at its best
//! half-step, of commit 496603e, whose scenes had no `transfer`:
//!
//! | Control steps | `f64` | `f32`, where rounding drowns such differences |
//! |---|---|---|
//! | 0 to 100 | 2.0e-6 | 4.3e-2 |
//! | 100 to 200 | 1.2e-6 | 0.38 |
//! | 0 to 330, the whole skill | 1.4e-2 | 0.66 |
//!
//! With today's scenes it is 2.4e-6, 1.5e-4 and 7.6e-3 in `f64`: where some grain comes to be before another face of a wall
//! the motion jumps, and differences over larger half-steps look across such jumps.
//!
//! Over steps that a search might take the slope is another: with differences over half-steps of
//! 0.1 the whole skill's gradient had a cosine of 0.82 (`f64`), and 3.5 times the length; it has one of -0.92, and 10 times the
//! length, with `transfer` and walls with two sides. [`restart`] says why, and has a gradient that forgets what single grains do.

mod any;
mod branches;
pub mod gradcheck;
pub(crate) mod loss;
mod outcome;
pub(crate) mod path;
pub mod restart;
pub(crate) mod schedule;
mod simulator;
pub mod slopes;
#[cfg(test)]
mod tests;
mod watch;

pub use any::{AnySimulator, AnyState};
pub use outcome::Destination;
pub use simulator::{RolloutState, Simulator};
pub use watch::{ProgressFn, Tick, Watch, part};
pub(crate) use watch::{go_on, quiet};

pub use crate::memory::Workload;
use crate::memory::least_memory;
use crate::scene::Scene;
pub use crate::skill::DisplacementGradient;
use crate::skill::{SkillError, Theta, ThetaError, ThetaGradient};
pub use powderline_shared::{
    census::{Census, Places},
    displacement::Displacement,
    plan::Precision,
    pose::Pose,
};
use std::ops::ControlFlow;
use thiserror::Error;

/// What one simulated motion achieved.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Evaluation {
    /// Loss of the scene's objective (see [`crate::scene::Aim`]), metres.
    pub loss: f64,
    /// Target count minus the particles inside the target container at the end.
    pub indicator: i64,
    /// Particles by their [`Destination`] at the end; [`SceneSpec::particle_mass_kg`](crate::scene::SceneSpec::particle_mass_kg) each.
    pub census: Census,
}

impl Evaluation {
    /// What was found, by a simulator of one's own.
    pub fn new(loss: f64, indicator: i64, census: Census) -> Self {
        Self { loss, indicator, census }
    }
}

/// A custom loss: takes the particle positions at the end of a motion (m, in packing order), and writes the loss's derivative with
/// respect to each into the second slice, which is as long and all zero. Returns the loss.
pub type LossFn<'a> = &'a (dyn Fn(&[[f64; 3]], &mut [[f64; 3]]) -> f64 + Sync);

/// A custom loss for [`Simulate::restarted_gradient_of_custom_loss`]: takes the particle positions at the end of a motion (m, in
/// packing order), and writes what each costs of the loss into the second slice, which is as long and all zero: how the loss changes if that
/// particle is elsewhere and all others stay. A constant more or less does not matter; where the loss is a sum over particles, it is the
/// summand. Returns the loss.
pub type CostsFn<'a> = &'a (dyn Fn(&[[f64; 3]], &mut [f64]) -> f64 + Sync);

/// Powder and tool at one moment of a motion. Where a gate is then, [`crate::scene::Gate::displacement_m`] tells.
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

/// Looks at snapshots as they come; [`ControlFlow::Break`] ends the rollout with [`RolloutError::Stopped`].
pub type Observer<'a> = &'a mut (dyn FnMut(&Snapshot<'_>) -> ControlFlow<()> + Send);

/// A motion that is recorded.
#[derive(Clone, Copy, Debug)]
pub struct Recording<'a> {
    /// Where the tool begins.
    pub anchor: &'a Pose,
    /// What it does.
    pub controls: &'a [Displacement],
    /// Control steps from one snapshot to the next; 0 counts as 1. The first shows the settled
    /// powder before the motion, the last is the last whole multiple of these steps: the end of the
    /// motion, if its length is one.
    pub every: usize,
}

/// Why a rollout has no result.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum RolloutError {
    /// Whoever is told the progress, or looks at snapshots, asked for it.
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
        "particle {particle} left the simulated volume in control step {step}, substep {substep}: \
         a larger domain or more substeps would hold it"
    )]
    Escaped {
        /// Control step.
        step: u32,
        /// Substep within the control step.
        substep: u32,
        /// Particle.
        particle: u32,
    },
    /// What happened while the powder settled: then no motion is to blame.
    #[error("while the powder settles, before any motion: {0}")]
    Settling(Box<RolloutError>),
    /// A displacement takes the tool to where no numbers are.
    #[error("the displacement of control step {step} takes the tool to no finite place")]
    Motion {
        /// Control step.
        step: u32,
    },
    /// Motions that are simulated side by side have one length.
    #[error(
        "the motions have {first} and {other} control steps, and motions that are simulated side by side have as many each"
    )]
    Lengths {
        /// Control steps of the first.
        first: usize,
        /// And of another one.
        other: usize,
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
    /// The skill is not a motion.
    #[error(transparent)]
    Skill(#[from] SkillError),
    /// The skill lies so near to an end of theta's range that a difference would go beyond.
    #[error(transparent)]
    Theta(#[from] ThetaError),
}

impl RolloutError {
    /// Whether it is the motion that comes to no end, and another one might: powder escapes, or numbers do.
    pub fn is_of_motion(&self) -> bool {
        matches!(self, Self::Escaped { .. } | Self::NonFinite { .. })
    }

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
            Self::Motion { step } => Self::Motion { step: step + more },
            other => other,
        }
    }
}

/// A simulator of one scene: [`Simulator`] in either precision, [`boxed_simulator`] where that is chosen at run time.
pub trait Simulate {
    /// Who is told how far it is.
    fn watch(&mut self) -> &mut Watch;

    /// From now on this is told how far every call is, and may end it. May be called from any of the threads.
    fn set_progress(&mut self, progress: ProgressFn) {
        self.watch().set(progress);
    }

    /// Loss of a skill.
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn evaluate(&mut self, theta: &Theta) -> Result<Evaluation, RolloutError>;

    /// Losses of several skills side by side, in their order.
    ///
    /// # Errors
    /// See [`RolloutError`]; that of the first skill that has one.
    fn evaluate_all(&mut self, thetas: &[Theta]) -> Result<Vec<Evaluation>, RolloutError> {
        one_by_one(self, thetas, Self::evaluate)
    }

    /// Loss of a skill, and its derivative with respect to theta, metres, by the exact adjoint.
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn evaluate_with_gradient(&mut self, theta: &Theta) -> Result<(Evaluation, ThetaGradient), RolloutError>;

    /// Loss of a skill, its gradient by the adjoint that [`restart`]s as asked, and how that came about.
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn evaluate_restarted(
        &mut self,
        theta: &Theta,
        restarts: &restart::Restarts,
    ) -> Result<restart::Restarted, RolloutError>;

    /// Loss of a motion that begins at the scene's start pose: of a skill's controls, of a
    /// quantised plan's, or any other.
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn simulate(&mut self, controls: &[Displacement]) -> Result<Evaluation, RolloutError>;

    /// Losses of several such motions of one length side by side, in their order.
    ///
    /// # Errors
    /// See [`RolloutError`]; that of the first motion that has one.
    fn simulate_all(&mut self, motions: &[Vec<Displacement>]) -> Result<Vec<Evaluation>, RolloutError> {
        one_by_one(self, motions, |s, controls| s.simulate(controls))
    }

    /// The same for a tool that begins at `anchor` and not at the scene's start pose. Nothing is asked of the anchor: a tool that
    /// begins within the powder pushes it out while it settles.
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn simulate_from(&mut self, anchor: &Pose, controls: &[Displacement])
    -> Result<Evaluation, RolloutError>;

    /// [`Self::simulate`], and the derivative of the loss with respect to each displacement, the others held.
    /// See [what it is good for](self#what-a-gradient-is-good-for).
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn simulate_with_gradient(
        &mut self,
        controls: &[Displacement],
    ) -> Result<(Evaluation, Vec<DisplacementGradient>), RolloutError>;

    /// The same by the adjoint that [`restart`]s.
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn simulate_restarted(
        &mut self,
        controls: &[Displacement],
        restarts: &restart::Restarts,
    ) -> Result<(Evaluation, Vec<DisplacementGradient>), RolloutError>;

    /// A custom loss at the end of such a motion, and its derivative with respect to each
    /// displacement, the others held: per metre and per radian, whatever the loss's own unit is.
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn gradient_of_custom_loss(
        &mut self,
        controls: &[Displacement],
        loss: LossFn<'_>,
    ) -> Result<(f64, Vec<DisplacementGradient>), RolloutError>;

    /// The same by the adjoint that [`restart`]s.
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn restarted_gradient_of_custom_loss(
        &mut self,
        controls: &[Displacement],
        costs: CostsFn<'_>,
        restarts: &restart::Restarts,
    ) -> Result<(f64, Vec<DisplacementGradient>), RolloutError>;

    /// Positions (m) at the end of such a motion, in the order of the packing.
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn final_positions_m(&mut self, controls: &[Displacement]) -> Result<Vec<[f64; 3]>, RolloutError>;

    /// [`Self::simulate_from`] with snapshots on the way; and where each particle is in the end, in
    /// the order of the packing.
    ///
    /// # Errors
    /// See [`RolloutError`].
    fn record(
        &mut self,
        recording: &Recording<'_>,
        observer: Observer<'_>,
    ) -> Result<(Evaluation, Vec<Destination>), RolloutError>;
}

/// Evaluations one after another, each told as its share of the whole.
fn one_by_one<S: Simulate + ?Sized, M>(
    simulator: &mut S,
    all: &[M],
    evaluate: impl Fn(&mut S, &M) -> Result<Evaluation, RolloutError>,
) -> Result<Vec<Evaluation>, RolloutError> {
    let share = |done: usize| done as f64 / all.len() as f64;
    let one = |(index, motion): (usize, &M)| {
        let outer = simulator.watch().enter([share(index), share(index + 1)]);
        let found = evaluate(simulator, motion);
        simulator.watch().leave(outer);
        found
    };
    all.iter().enumerate().map(one).collect()
}

/// How a scene is simulated. Nothing here but the seed changes a bit of the result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SimulatorSettings {
    /// Seed of the packing; by default the scene's own, `powder.seed`.
    pub seed: Option<u64>,
    /// Threads; by default as many as the machine has processors.
    pub threads: Option<usize>,
    /// Most memory that the process may take, bytes; checkpoints are chosen to fit. 1 GiB by default.
    pub memory_bytes: u64,
}

impl Default for SimulatorSettings {
    /// The scene's own packing, a thread for each processor, 1 GiB.
    fn default() -> Self {
        Self { seed: None, threads: None, memory_bytes: 1 << 30 }
    }
}

impl SimulatorSettings {
    /// Seed of the packing, as given or the scene's own.
    pub fn seed_of(&self, scene: &Scene) -> u64 {
        self.seed.unwrap_or(scene.powder.seed)
    }

    /// Threads, as given or one per processor.
    pub fn thread_count(&self) -> usize {
        self.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from))
    }
}

/// Checks that the memory budget suffices for `work` in this precision (gradients in reasonable time), with
/// `besides_bytes` left for its output.
///
/// # Errors
/// [`RolloutError::Memory`] if not.
pub fn check_memory(
    scene: &Scene,
    precision: Precision,
    settings: &SimulatorSettings,
    work: Workload,
    besides_bytes: u64,
) -> Result<(), RolloutError> {
    let (given, threads) = (settings.memory_bytes, settings.thread_count());
    let least = least_memory(scene, precision, threads, work) + besides_bytes;
    if given >= least {
        return Ok(());
    }
    Err(RolloutError::Memory { given, least, work, besides: besides_bytes > 0, threads })
}

/// The simulator of a scene with the powder's state in numbers of this precision.
///
/// # Errors
/// See [`Simulator::new`].
// Inlined, it would be compiled once more, with all of the simulator, wherever it is called.
#[inline(never)]
pub fn boxed_simulator(
    scene: &Scene,
    precision: Precision,
    settings: &SimulatorSettings,
) -> Result<Box<dyn Simulate>, RolloutError> {
    Ok(match precision {
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
