//! `optimise bench`: what each stage of the simulator takes.

use super::{
    CliError, Context, Progress, format_size, motion::parse_theta, options::PrecisionArg, parse_size,
};
use crate::report::words::{count, grouped};
use clap::Args;
use powderline_shared::plan::Precision;
use powderline_simulator::bench::{
    Arithmetic, BenchError, Profile, ProfileSettings, Report, Seconds, Settings, TimeStats, Watch, profile,
    run,
};
use powderline_simulator::rollout::{SimulatorSettings, Workload, check_memory};
use powderline_simulator::scene::{MAX_PARTICLES, Scene};
use powderline_simulator::skill::Theta;
use serde::Serialize;
use std::{fmt::Write, ops::RangeInclusive};

/// Arguments of `optimise bench`.
#[derive(Clone, Debug, Args)]
pub(super) struct BenchArgs {
    /// Where the time of a whole rollout of this scene goes, instead of a bed of powder: a name, or a scene file
    #[arg(long, value_name = "SCENE", conflicts_with_all = ["particles", "grid", "steps"])]
    pub scene: Option<String>,
    /// With `--scene`: the skill, each parameter in [-1, 1]
    #[arg(long, value_name = "A,B,C,D,E", requires = "scene", allow_hyphen_values = true)]
    pub theta: Option<String>,
    /// Particles, eight in a cell; 1,000 to 4,000,000
    #[arg(long, value_name = "N", default_value_t = 20_000)]
    pub particles: u64,
    /// Cells along each edge of the grid; 16 to 256
    #[arg(long, value_name = "N", default_value_t = 64)]
    pub grid: u64,
    /// Substeps to measure, rounded up to whole control steps of 20; 1 to 1,000,000
    #[arg(long, value_name = "N", default_value_t = 200)]
    pub steps: u64,
    /// Threads
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: u16,
    /// Number format of the powder's state
    #[arg(long, default_value = "f32")]
    pub precision: PrecisionArg,
    /// Neither gradient nor adjoint
    #[arg(long)]
    pub forward_only: bool,
    /// Most memory to use, such as 500MB or 2GiB [default: what the system can give]
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    pub memory: Option<u64>,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

impl From<BenchError> for CliError {
    fn from(error: BenchError) -> Self {
        match error {
            BenchError::Rollout(error) => error.into(),
            _ => Self::Input(error.to_string()),
        }
    }
}

const PARTICLES: RangeInclusive<usize> = 1_000..=MAX_PARTICLES;
const GRID: RangeInclusive<usize> = 16..=256;
const STEPS: RangeInclusive<usize> = 1..=1_000_000;

/// A number that lies in its range.
fn within(name: &str, number: u64, range: RangeInclusive<usize>) -> Result<usize, CliError> {
    usize::try_from(number).ok().filter(|number| range.contains(number)).ok_or_else(|| {
        let [least, most] = [range.start(), range.end()].map(|end| grouped(*end as i64));
        CliError::Input(format!("{name} is a number from {least} to {most}, and {number} is not"))
    })
}

/// Runs the command.
///
/// # Errors
/// One sentence.
pub(super) fn execute(arguments: &BenchArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    if let Some(scene) = &arguments.scene {
        return of_scene(scene, arguments, context);
    }
    let settings = Settings {
        particles: within("--particles", arguments.particles, PARTICLES)?,
        grid: within("--grid", arguments.grid, GRID)?,
        substeps: within("--steps", arguments.steps, STEPS)?,
        threads: arguments.threads.into(),
        precision: Precision::from(arguments.precision),
        forward_only: arguments.forward_only,
        memory_bytes: arguments.memory,
    };
    let report = watched(context, |watch| run(&settings, watch))?;
    tell(&report, write_text, arguments, context)
}

/// Where the time of a rollout of a scene goes.
fn of_scene(scene: &str, arguments: &BenchArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let scene = Scene::load(scene)?;
    let theta = arguments.theta.as_deref().map_or_else(|| Ok(Theta::MIDDLE), parse_theta)?;
    let (precision, defaults) = (Precision::from(arguments.precision), SimulatorSettings::default());
    let simulator = SimulatorSettings {
        threads: Some(arguments.threads.into()),
        memory_bytes: arguments.memory.unwrap_or(defaults.memory_bytes),
        ..defaults
    };
    let work = if arguments.forward_only { Workload::Single } else { Workload::Gradient };
    check_memory(&scene, precision, &simulator, work, 0)?;
    let forward_only = arguments.forward_only;
    let settings = ProfileSettings { scene: &scene, theta: &theta, precision, simulator, forward_only };
    let profile = watched(context, |watch| profile(&settings, watch))?;
    tell(&profile, write_profile, arguments, context)
}

/// Runs something that says what it does, and how far it is.
fn watched<R>(context: &Context<'_>, job: impl FnOnce(Watch<'_>) -> R) -> R {
    let interrupt = context.interrupt.clone();
    let progress = Progress::new(&context.err, context.live);
    let mut task = String::new();
    let done = job(&mut |doing, done, total| {
        if task != doing {
            task = doing.into();
            progress.begin(doing, 0, &[]);
        }
        progress.tick(done as f64 / total.max(1) as f64);
        interrupt.flow()
    });
    progress.clear();
    done
}

/// As text, or as one JSON object.
fn tell<R: Serialize>(
    report: &R,
    write_text: fn(&mut String, &R) -> std::fmt::Result,
    arguments: &BenchArgs,
    context: &mut Context<'_>,
) -> Result<(), CliError> {
    if arguments.json {
        return context.json(report);
    }
    let mut text = String::new();
    // Writing to a string does not fail.
    let _ = write_text(&mut text, report);
    write!(context.out, "{text}")?;
    Ok(())
}

fn write_profile(out: &mut String, profile: &Profile) -> std::fmt::Result {
    writeln!(
        out,
        "{}, {}, {}, {}, {}; settled in {:.1} s of processor time.",
        profile.scene,
        count(profile.particles as i64, "particle"),
        count(profile.substeps as i64, "substep"),
        profile.precision,
        count(profile.threads as i64, "thread"),
        profile.settling.processor_s
    )?;
    writeln!(out, "\n{:38}{:>10}{:>12}{:>8}", "seconds", "wall", "processor", "share")?;
    for run in &profile.runs {
        writeln!(out, "\n{}", run.name)?;
        let mut row = |name: &str, [wall_s, processor_s]: [f64; 2]| {
            let share = 100.0 * processor_s / run.time.processor_s;
            writeln!(out, "  {name:36}{wall_s:>10.2}{processor_s:>12.2}{share:>6.1} %")
        };
        for stage in &run.stages {
            row(stage.name, [stage.time.wall_s, stage.time.processor_s])?;
        }
        let of_stages = |of: fn(&Seconds) -> f64| run.stages.iter().map(|stage| of(&stage.time)).sum::<f64>();
        let rest: [fn(&Seconds) -> f64; 2] = [|time| time.wall_s, |time| time.processor_s];
        row("what is between them", rest.map(|of| of(&run.time) - of_stages(of)))?;
        row("all", rest.map(|of| of(&run.time)))?;
    }
    let advanced = profile.runs.iter().find(|run| run.advances > 1.0);
    advanced.map_or(Ok(()), |run| {
        writeln!(out, "\nThe gradient advances each substep {:.2} times, beside the adjoint.", run.advances)
    })
}

fn write_text(out: &mut String, report: &Report) -> std::fmt::Result {
    writeln!(
        out,
        "{} in {}^3 cells, {}, {}; {} after {} to warm up.",
        count(report.particles as i64, "particle"),
        report.grid,
        report.precision,
        count(report.threads as i64, "thread"),
        count(report.substeps as i64, "substep"),
        report.warm_up_substeps
    )?;
    let machine = &report.machine;
    writeln!(
        out,
        "Vectors of {} bits; {:.0} GFLOP/s a thread in multiply-adds (at best {:.0}); reads {:.0} GB/s.",
        machine.vector_bits, machine.fma_gflops, machine.fma_gflops_max, machine.read_gb_per_s
    )?;
    write!(
        out,
        "{:.0} % of the lanes in {} blocks are filled.",
        100.0 * report.filled_lanes,
        report.particle_blocks
    )?;
    if let Some(share) = machine.waiting_share {
        write!(out, " The threads waited {:.0} % of the time for a processor.", 100.0 * share)?;
    }
    writeln!(
        out,
        "\n\n{:38}{:>9}{:>9}{:>9}{:>11}{:>12}{:>9}{:>7}",
        "ns per particle and substep", "median", "min", "mean", "processor", "operations", "floor", "times"
    )?;
    let mut part = "";
    for stage in &report.stages {
        if stage.part != part {
            part = stage.part;
            writeln!(out, "\n{part}")?;
        }
        row(out, stage.name, &stage.time, &stage.arithmetic)?;
    }
    writeln!(out, "\nwhole")?;
    for whole in &report.whole {
        row(out, whole.name, &whole.time, &whole.arithmetic)?;
    }
    if let Some(gradient) = report.whole.iter().find(|whole| whole.advances > 1.0) {
        writeln!(
            out,
            "\nThe gradient of {} keeps {} and advances each substep {:.2} times, beside the adjoint.",
            count(gradient.substeps as i64, "substep"),
            count(gradient.kept_states as i64, "state"),
            gradient.advances
        )?;
    }
    write_memory(out, report)
}

fn row(out: &mut String, name: &str, time: &TimeStats, arithmetic: &Arithmetic) -> std::fmt::Result {
    let TimeStats { median_ns, min_ns, mean_ns, processor_ns, .. } = time;
    write!(out, "  {name:36}{median_ns:>9.1}{min_ns:>9.1}{mean_ns:>9.1}{processor_ns:>11.1}")?;
    match arithmetic.multiple {
        Some(multiple) => {
            writeln!(out, "{:>12.0}{:>9.1}{multiple:>7.1}", arithmetic.operations, arithmetic.floor_ns)
        }
        None => writeln!(out, "{:>12}", 0),
    }
}

fn write_memory(out: &mut String, report: &Report) -> std::fmt::Result {
    let memory = &report.memory;
    let size = |bytes: Option<u64>| bytes.map_or("unknown".into(), format_size);
    writeln!(
        out,
        "Peak memory {}, {} before the first gradient; a state has {:.0} bytes a particle.",
        size(memory.peak_bytes),
        size(memory.forward_peak_bytes),
        memory.state_bytes_per_particle
    )?;
    writeln!(
        out,
        "A substep moves {:.0} bytes a particle at least: {:.1} ns if they come from memory.",
        memory.traffic_bytes_per_particle, memory.traffic_ns
    )
}
