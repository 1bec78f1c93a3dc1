//! `optimise gradcheck`: the adjoint's gradient against finite differences.

use super::{CliError, Context, Progress, Resources, options::PrecisionArg, slopes};
use clap::{Args, ValueEnum};
use powderline_shared::plan::{Precision, SkillParameter};
use powderline_simulator::rollout::gradcheck::{CHECKED_THETA, HALF_STEPS, Smoothed, Window, smoothed};
use powderline_simulator::rollout::{AnySimulator, RolloutError, Workload};
use powderline_simulator::scene::{Aim, DEFAULT_SCENE, Scene};
use powderline_simulator::skill::{SkillMap, Theta};
use serde::Serialize;
use std::fmt::Write;
use std::path::PathBuf;

/// Arguments of `optimise gradcheck`.
#[derive(Clone, Debug, Args)]
pub(super) struct GradcheckArgs {
    /// Scene: an embedded name or a TOML file [default: bench]
    #[arg(value_name = "SCENE")]
    pub scene: Option<String>,
    /// Control steps in a window of the motion; the longer horizons go on from there to the scene's own
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub steps: u32,
    /// Only the windows, not the longer horizons
    #[arg(long)]
    pub short: bool,
    /// Instead of all that: the exact and the restarted gradient beside differences over +-0.1, for so many drawn skills of
    /// the scene as it is
    #[arg(long, value_name = "N", group = "table", conflicts_with_all = ["steps", "short"], value_parser = clap::value_parser!(u32).range(2..=1000))]
    pub skills: Option<u32>,
    /// The same for this skill: five numbers in [-1, 1]; can be given more than once
    #[arg(long, value_name = "D,A,L,T,P", allow_hyphen_values = true, group = "table", conflicts_with_all = ["steps", "short", "skills", "first"])]
    pub theta: Vec<String>,
    /// What the loss asks for, if it is not what the scene says
    #[arg(long)]
    pub aim: Option<AimArg>,
    /// Packings that each of the skills is measured with, the first of them of the seed
    #[arg(long, value_name = "N", conflicts_with_all = ["steps", "short"], default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub packings: u32,
    /// Which of the drawn skills is the first to be tried
    #[arg(long, value_name = "N", requires = "skills", default_value_t = 0, value_parser = clap::value_parser!(u64).range(..=1_000_000))]
    pub first: u64,
    /// Seed of the packing [default: the scene's powder.seed]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Precision of the simulation [default: f64, with --skills or --theta f32]
    #[arg(long)]
    pub precision: Option<PrecisionArg>,
    /// Threads and memory.
    #[command(flatten)]
    pub resources: Resources,
    /// Folder that keeps the table of --skills or --theta, skill by skill; one that was stopped goes on from there
    #[arg(long, value_name = "DIR", requires = "table")]
    pub out: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// What the loss asks for.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(super) enum AimArg {
    /// The wanted amount, and the rest where it came from.
    Amount,
    /// All powder.
    All,
}

impl From<AimArg> for Aim {
    fn from(aim: AimArg) -> Self {
        match aim {
            AimArg::Amount => Self::Amount,
            AimArg::All => Self::All,
        }
    }
}

#[derive(Serialize)]
struct Report {
    scene: String,
    precision: &'static str,
    theta: Theta,
    windows: Vec<Window>,
    growth: Vec<Window>,
    smoothed: Option<Smoothed>,
    /// What makes the command fail, if anything does: then there is what was compared before.
    failure: Option<String>,
}

/// Runs the command.
///
/// # Errors
/// One sentence.
pub(super) fn execute(arguments: &GradcheckArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let mut scene = Scene::load(arguments.scene.as_deref().unwrap_or(DEFAULT_SCENE))?;
    if let Some(aim) = arguments.aim {
        scene = scene.with(|spec| spec.objective.aim = aim.into())?;
    }
    if arguments.skills.is_some() || !arguments.theta.is_empty() {
        return slopes::execute(arguments, &scene, context);
    }
    check(arguments, &scene, context)
}

/// Ends of the longer horizons: doubling from the first window to the scene's own horizon.
fn horizons(short: u32, own: u32) -> Vec<u32> {
    let doubling = std::iter::successors(Some(short), |n| n.checked_mul(2)).skip(1);
    doubling.take_while(|n| *n < own).chain((own > short).then_some(own)).collect()
}

fn check(arguments: &GradcheckArgs, scene: &Scene, context: &mut Context<'_>) -> Result<(), CliError> {
    let precision = arguments.precision.map_or(Precision::F64, Precision::from);
    let setup = arguments.resources.setup(arguments.seed.unwrap_or(scene.powder.seed), precision);
    // Falling asleep is a jump, if a small one, that no difference over a small step survives.
    let scene = &scene.without_sleep();
    setup.check_memory(scene, Workload::Gradient, 0)?;
    let mut simulator = AnySimulator::new(scene, setup.precision, &setup.settings)?;
    let progress = Progress::new(&context.err, context.live);
    simulator.as_dyn().set_progress(progress.watch(&context.interrupt));
    let mut report = Report {
        scene: scene.name.clone(),
        precision: setup.precision.name(),
        theta: CHECKED_THETA,
        windows: Vec::new(),
        growth: Vec::new(),
        smoothed: None,
        failure: None,
    };
    let compared = report.fill(arguments, scene, &mut simulator, &progress).map_err(CliError::from);
    progress.clear();
    report.failure = compared.as_ref().err().map(ToString::to_string);
    // What took so long is shown, even if it ended early.
    if arguments.json {
        context.json(&report)?;
    } else if compared.is_ok() || !report.windows.is_empty() {
        write!(context.out, "{}", text(&report))?;
    }
    compared
}

impl Report {
    /// Compares window after window.
    fn fill(
        &mut self,
        arguments: &GradcheckArgs,
        scene: &Scene,
        simulator: &mut AnySimulator,
        progress: &Progress,
    ) -> Result<(), RolloutError> {
        let map = SkillMap::new(scene);
        let own = scene.time.horizon_steps;
        let mut window = |start: u32, end: u32| -> Result<Window, RolloutError> {
            progress.begin(&format!("differences, control steps {start} to {end}"), 0, &[]);
            simulator.check_window(&map, start, end)
        };
        // After the motion's end no parameter is at work.
        let motion_s = map.duration_s(&CHECKED_THETA);
        let motion = (motion_s / scene.time.control_period_s()).ceil() as u32;
        for start in (0..own.min(motion)).step_by(arguments.steps as usize) {
            self.windows.push(window(start, own.min(start + arguments.steps))?);
        }
        if arguments.short {
            return Ok(());
        }
        for end in horizons(arguments.steps, own) {
            self.growth.push(window(0, end)?);
        }
        self.smoothed = Some(smoothed(simulator.as_dyn())?);
        Ok(())
    }
}

fn text(report: &Report) -> String {
    let mut out = String::new();
    let _ = writeln!(out, "{}, {}, theta {}", report.scene, report.precision, report.theta);
    for w in &report.windows {
        write_window(&mut out, w);
    }
    let _ = writeln!(out, "\nLargest relative error at the best half-step:\n");
    for w in report.windows.iter().chain(&report.growth) {
        let _ = writeln!(out, "control steps {:>4} to {:>4}   {:.1e}", w.start, w.end, w.error);
    }
    if let Some(s) = &report.smoothed {
        let _ = writeln!(
            out,
            "\nAgainst differences over +-{} in theta, whole horizon: cosine {:.3}\n",
            s.half_step, s.cosine
        );
        for ((parameter, adjoint), difference) in SkillParameter::ALL.iter().zip(s.adjoint).zip(s.differences)
        {
            let _ = writeln!(
                out,
                "{:24}  adjoint {adjoint:>12.4} m   differences {difference:>12.4} m",
                parameter.name()
            );
        }
    }
    out
}

fn write_window(out: &mut String, w: &Window) {
    let _ = writeln!(out, "\nControl steps {} to {}, loss {:.6} m.", w.start, w.end, w.loss);
    let _ = writeln!(out, "Relative error of central differences against the adjoint, by half-step:\n");
    let _ = write!(out, "{:24}{:>16}", "", "adjoint, m");
    for h in HALF_STEPS {
        let _ = write!(out, "{h:>9.0e}");
    }
    out.push('\n');
    for (parameter, c) in SkillParameter::ALL.iter().zip(&w.components) {
        let _ = write!(out, "{:24}", parameter.name());
        if c.error.is_none() {
            let _ = writeln!(out, "{:>16}", "not at work");
            continue;
        }
        let _ = write!(out, "{:>16.8}", c.adjoint);
        for (_, d) in &c.differences {
            let _ = write!(out, "{:>9.0e}", (d - c.adjoint).abs() / c.adjoint.abs().max(f64::MIN_POSITIVE));
        }
        out.push('\n');
    }
}
