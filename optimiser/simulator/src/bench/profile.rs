//! Where the time of a rollout of a scene goes: powder that rests and flows, tool and walls as they are there.

use powderline_shared::plan::Precision;
use serde::Serialize;

use super::machine::nanoseconds;
use super::measure::{ENTRIES, Watch, difference};
use crate::mpm::timings::{Pass, PassTimings, Reading};
use crate::real::Real;
use crate::rollout::{RolloutError, Simulator, SimulatorSettings};
use crate::scene::Scene;
use crate::skill::{SkillMap, Theta};

/// What is rolled out, and how.
#[derive(Clone, Copy, Debug)]
pub struct ProfileSettings<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// The skill whose motion is made.
    pub theta: &'a Theta,
    /// Number format of the powder's state.
    pub precision: Precision,
    /// Threads and memory.
    pub simulator: SimulatorSettings,
    /// No gradient.
    pub forward_only: bool,
}

/// Wall time, and processor time of all threads together, seconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Seconds {
    /// By the clock.
    pub wall_s: f64,
    /// Of all threads together.
    pub processor_s: f64,
}

impl Seconds {
    fn of([wall_ns, processor_ns]: Reading) -> Self {
        let [wall_s, processor_s] = [wall_ns, processor_ns].map(|ns| ns as f64 * 1e-9);
        Self { wall_s, processor_s }
    }
}

/// A stage of a run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct StageTime {
    /// `forward`, or `adjoint` (with what it computes again of the substep).
    pub part: &'static str,
    /// What it does.
    pub name: &'static str,
    /// What it took in the whole run.
    #[serde(flatten)]
    pub time: Seconds,
}

/// A run from the settled powder to the end of the motion.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct RunTime {
    /// `forward`, or `forward and gradient`.
    pub name: &'static str,
    /// All of it: stages, and what is between them.
    #[serde(flatten)]
    pub time: Seconds,
    /// How often each substep was advanced, on average.
    pub advances: f64,
    /// Its stages.
    pub stages: Vec<StageTime>,
}

/// Where the time of a rollout goes.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Profile {
    /// The scene's name.
    pub scene: String,
    /// The skill.
    pub theta: [f64; 5],
    /// Particles.
    pub particles: usize,
    /// `f32` or `f64`.
    pub precision: &'static str,
    /// Threads.
    pub threads: usize,
    /// Substeps of the motion.
    pub substeps: usize,
    /// Settling before the motion: once for all rollouts of a scene.
    pub settling: Seconds,
    /// Forward, and with the gradient.
    pub runs: Vec<RunTime>,
}

/// Rolls out a skill of a scene, then once more with its gradient, and says what each stage took.
///
/// # Errors
/// See [`RolloutError`].
pub fn profile(settings: &ProfileSettings<'_>, watch: Watch<'_>) -> Result<Profile, RolloutError> {
    match settings.precision {
        Precision::F32 => profile_in::<f32>(settings, watch),
        Precision::F64 => profile_in::<f64>(settings, watch),
    }
}

fn profile_in<T: Real>(settings: &ProfileSettings<'_>, watch: Watch<'_>) -> Result<Profile, RolloutError> {
    let ProfileSettings { scene, theta, precision, simulator: resources, forward_only } = *settings;
    let controls = SkillMap::new(scene).controls(theta)?;
    let substeps = controls.len() * scene.time.substeps as usize;
    let mut simulator = Simulator::<T>::new(scene, &resources)?;
    let began = nanoseconds();
    let settled = simulator.initial_state(&mut |done, total| watch("settling", done, total))?;
    let settling = Seconds::of(difference(nanoseconds(), began));
    let mut run = |name, job: &mut dyn FnMut(&mut Simulator<T>) -> Result<(), RolloutError>| {
        simulator.timings().follow(nanoseconds);
        let began = nanoseconds();
        let done = job(&mut simulator);
        let time = Seconds::of(difference(nanoseconds(), began));
        let timings = simulator.timings().take();
        let forward = timings.iter().filter(|lap| lap.pass == Pass::Forward).count();
        let advances = forward as f64 / substeps as f64;
        done.map(|()| RunTime { name, time, advances, stages: stages(&timings) })
    };
    let mut runs = vec![run("forward", &mut |simulator| {
        simulator.advanced(&settled, &controls, &mut |d, t| watch("forward", d, t)).map(|_| ())
    })?];
    if !forward_only {
        runs.push(run("forward and gradient", &mut |simulator| {
            simulator.control_gradient(&settled, &controls, &mut |d, t| watch("gradient", d, t)).map(|_| ())
        })?);
    }
    Ok(Profile {
        scene: scene.name.clone(),
        theta: theta.components(),
        particles: scene.particle_count(),
        precision: precision.name(),
        threads: resources.thread_count(),
        substeps,
        settling,
        runs,
    })
}

/// What each stage took of all passes.
fn stages(timings: &[PassTimings]) -> Vec<StageTime> {
    let taken = |pass: Pass, stage| {
        let mut laps = timings.iter().filter(|lap| lap.pass == pass).map(|lap| lap.stages[stage as usize]);
        let first = laps.next()?;
        Some(laps.fold(first, |sum, lap| [sum[0] + lap[0], sum[1] + lap[1]]))
    };
    let entries = ENTRIES.iter().filter(|(pass, ..)| *pass != Pass::Alone);
    let all = entries.filter_map(|(pass, stage, part, name)| {
        taken(*pass, *stage).map(|reading| StageTime { part, name, time: Seconds::of(reading) })
    });
    all.collect()
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::*;

    /// Stages are all that a run does, but for what is between them, and each is there.
    #[test]
    fn stages_add_up_to_the_run() {
        let scene = Scene::load("bench-small").and_then(|scene| {
            scene.with(|spec| {
                spec.powder.particles_per_cell = 1;
                spec.time.settle_s = 0.05;
            })
        });
        let (scene, theta) = (scene.expect("valid"), Theta::new([0.0; 5]).expect("in range"));
        let simulator = SimulatorSettings { threads: Some(1), ..SimulatorSettings::default() };
        let precision = Precision::F32;
        let settings =
            ProfileSettings { scene: &scene, theta: &theta, precision, simulator, forward_only: true };
        let found = profile(&settings, &mut |_, _, _| ControlFlow::Continue(())).expect("runs");
        let [forward] = &found.runs[..] else { panic!("{found:?}") };
        assert_eq!(forward.stages.len(), 4);
        assert!((forward.advances - 1.0).abs() < 1e-12, "{}", forward.advances);
        let sum: f64 = forward.stages.iter().map(|stage| stage.time.wall_s).sum();
        // How much it is beside the stages depends on the machine; that nothing is counted twice does not.
        assert!(sum > 0.5 * forward.time.wall_s && sum <= forward.time.wall_s, "{sum} of {:?}", forward.time);
        assert!(found.settling.wall_s > 0.0 && found.substeps > 1000);
    }
}
