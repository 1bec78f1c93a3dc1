//! The simulated arm controller, as a program.

use std::fs::{self, File};
use std::io::{self, BufWriter, IsTerminal, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::{Context, bail};
use clap::{Args, Parser, Subcommand, ValueEnum};
use powderline_firmware_sim::controller::{ArmConfig, DEFAULT_WATCHDOG_US};
use powderline_firmware_sim_cli::link::faults::Faults;
use powderline_firmware_sim_cli::link::world::Logged;
use powderline_firmware_sim_cli::serve::{self, Announcer, Options, bench_start};
use powderline_firmware_sim_cli::storm;
use powderline_host::link::Link;
use powderline_host::realtime;
use powderline_shared::plan::PlanReader;
use powderline_shared::pose::Pose;
use powderline_shared::trajectory::{Sample, TrajectoryHeader};
use powderline_shared::wire::Context as WireContext;
use powderline_shared::wire::frame::Dialect;

/// The simulated arm controller: on a wire, or on a simulated one that has every fault
#[derive(Debug, Parser)]
#[command(name = "firmware-sim", bin_name = "firmware-sim", version)]
#[command(args_conflicts_with_subcommands = true, arg_required_else_help = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    serve: Serve,
}

#[derive(Debug, Args)]
struct Serve {
    /// Wire to listen on.
    #[arg(
        long,
        value_name = "WIRE",
        help = "Wire to listen on: can:IFACE, canfd:IFACE, serial:DEVICE[@BAUD], or pty, which makes one and says its name"
    )]
    on: Option<Link>,
    /// Stand at the start pose of this plan; without it, at that of the scene bench
    #[arg(long, value_name = "PLAN")]
    at: Option<PathBuf>,
    /// A UR5e beside the bench, with joints that lag; or an ideal arm, which is where it is told to be
    #[arg(long, value_enum, default_value_t = ArmKind::Ur5e)]
    arm: ArmKind,
    /// Time without a sign of life of the executor after which the arm stops, milliseconds
    #[arg(long, value_name = "MS", default_value_t = DEFAULT_WATCHDOG_US / 1_000, value_parser = clap::value_parser!(u64).range(10..=10_000))]
    watchdog: u64,
    /// Priority under SCHED_FIFO, 1 to 99; 0 leaves the process scheduled as usual
    #[arg(long, value_name = "PRIORITY", default_value_t = PRIORITY, value_parser = clap::value_parser!(u8).range(0..=99))]
    priority: u8,
    /// Write the motion that the arm has made to this file, for `optimise simulate --executed`
    #[arg(long, value_name = "FILE")]
    executed: Option<PathBuf>,
    /// End after the first session that has moved the arm
    #[arg(long)]
    once: bool,
}

/// Priority asked for under SCHED_FIFO: above the executor's, as the arm's own controller would be.
const PRIORITY: u8 = 50;

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ArmKind {
    Ur5e,
    Ideal,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Plays plans between executor and arm over a simulated wire, with faults drawn from seeds, and holds both to what
    /// may never happen
    Storm {
        /// Seeds to run, the last one not included
        #[arg(long, default_value = "0..1000", value_parser = parse_range)]
        seeds: Range<u64>,
        /// Run this seed only, with its log in candump's format
        #[arg(long, conflicts_with = "seeds")]
        seed: Option<u64>,
        /// Instead, a table of what comes of plain loss and delay
        #[arg(long, conflicts_with = "seed")]
        table: bool,
    },
}

fn parse_range(text: &str) -> Result<Range<u64>, String> {
    let wrong = || format!("\"{text}\" is not a range of seeds; write 0..1000");
    let (from, to) = text.split_once("..").ok_or_else(wrong)?;
    let (from, to): (u64, u64) = (from.parse().map_err(|_| wrong())?, to.parse().map_err(|_| wrong())?);
    if from < to { Ok(from..to) } else { Err(wrong()) }
}

fn main() -> ExitCode {
    let Arguments { command, serve } = Arguments::parse();
    let done = match command {
        Some(Command::Storm { seed: Some(seed), .. }) => replay(seed),
        Some(Command::Storm { seeds, table: true, .. }) => loss_table(seeds),
        Some(Command::Storm { seeds, .. }) => storm(seeds),
        None => serve_arm(&serve),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("firmware-sim: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn serve_arm(arguments: &Serve) -> anyhow::Result<()> {
    let Some(on) = arguments.on.clone() else { bail!("nothing to do: give --on WIRE, or the command storm") };
    let pose = arguments.at.as_deref().map_or_else(|| Ok(bench_start()), start_of)?;
    let arm = match arguments.arm {
        ArmKind::Ideal => ArmConfig::ideal(pose),
        ArmKind::Ur5e => ArmConfig::ur5e(pose).map_err(|error| {
            anyhow::anyhow!("the arm cannot stand there ({error}); --arm ideal can stand anywhere")
        })?,
    };
    let arm = ArmConfig { watchdog_us: 1_000 * arguments.watchdog, ..arm };
    // Whatever is granted helps; a controller that is held up all the same says so and stops.
    let _ = realtime::prepare((arguments.priority > 0).then_some(arguments.priority));
    let options = Options { on, arm, once: arguments.once };
    serve::serve(&options, &mut Person { executed: arguments.executed.clone() })
}

fn start_of(plan: &Path) -> anyhow::Result<Pose> {
    let named = |error: &dyn std::fmt::Display| anyhow::anyhow!("{}: {error}", plan.display());
    let bytes = std::fs::read(plan).map_err(|error| named(&error))?;
    let plan =
        PlanReader::new(&bytes).map_err(|error| named(&format!("this is not a usable plan: {error}")))?;
    Ok(plan.header().start_pose())
}

/// Whoever sits in front of the terminal.
struct Person {
    executed: Option<PathBuf>,
}

impl Announcer for Person {
    fn say(&mut self, line: &str) {
        // Should nobody listen any more, the arm goes on all the same.
        let _ = writeln!(io::stdout(), "{line}");
    }

    fn executed(&mut self, context: &WireContext, period_us: u32, poses: &[Pose]) -> anyhow::Result<()> {
        let last = poses.last().map(|pose| pose.position_m).unwrap_or_default();
        let (ticks, x, y, z) = (poses.len(), last.x, last.y, last.z);
        self.say(&format!("At rest after {ticks} ticks, at ({x:.6}, {y:.6}, {z:.6}) m."));
        let Some(path) = &self.executed else { return Ok(()) };
        write_executed(path, context, period_us, poses)
            .with_context(|| format!("{}: the motion cannot be written", path.display()))?;
        self.say(&format!("The motion is in {}.", path.display()));
        Ok(())
    }
}

/// Under another name first: a reader finds a whole motion or none.
fn write_executed(path: &Path, context: &WireContext, period_us: u32, poses: &[Pose]) -> io::Result<()> {
    let unfinished = path.with_extension("unfinished");
    let mut file = BufWriter::new(File::create(&unfinished)?);
    writeln!(file, "{}", TrajectoryHeader { plan_hash: context.plan_hash, period_us })?;
    for (tick, pose) in (0..).zip(poses) {
        writeln!(file, "{}", Sample { tick, pose: *pose })?;
    }
    file.into_inner()?.sync_all()?;
    fs::rename(&unfinished, path)
}

fn storm(seeds: Range<u64>) -> anyhow::Result<()> {
    let total = seeds.end - seeds.start;
    let (done, shows) = (AtomicU64::new(0), io::stderr().is_terminal());
    let summary = storm::run_seeds(seeds, |more| {
        let so_far = done.fetch_add(more, Ordering::Relaxed) + more;
        if shows && so_far.is_multiple_of(256) {
            eprint!("\r  {so_far} of {total} runs");
        }
    });
    if shows {
        eprint!("\r\x1b[K");
    }
    say(&summary.to_string())?;
    if summary.breach_count > 0 {
        bail!("{} breaches; replay one with --seed", summary.breach_count);
    }
    Ok(())
}

fn replay(seed: u64) -> anyhow::Result<()> {
    let (run, log) = storm::run_seed(seed, true);
    for (at_us, logged) in log {
        let (seconds, micros) = (at_us / 1_000_000, at_us % 1_000_000);
        match logged {
            Logged::Frame(frame) => {
                let data: String = frame.data.iter().map(|byte| format!("{byte:02X}")).collect();
                let mark = if frame.data.len() > 8 { "##0" } else { "#" };
                say(&format!("({seconds:010}.{micros:06}) sim0 {:03X}{mark}{data}\n", frame.id))?;
            }
            Logged::Remark(text) => say(&format!("# {seconds}.{micros:06} {text}\n"))?,
        }
    }
    if !run.breaches.is_empty() {
        bail!("{} breaches, the first: {}", run.breaches.len(), run.breaches[0].what);
    }
    Ok(())
}

/// Loss by delay: how many plans complete, and how far the arm is from where it was due, at the worst.
fn loss_table(seeds: Range<u64>) -> anyhow::Result<()> {
    const LOSSES: [f64; 5] = [0.0, 0.001, 0.01, 0.05, 0.2];
    const DELAYS_US: [u64; 5] = [0, 1_000, 5_000, 20_000, 50_000];
    let mut breaches = 0;
    for dialect in [Dialect::Classic, Dialect::Fd] {
        say(&format!(
            "\n{dialect:?}, 100 Hz, {} plans each: completed (largest deviation on the way, mm)\n",
            seeds.end - seeds.start
        ))?;
        say("   loss")?;
        DELAYS_US.iter().try_for_each(|delay_us| say(&format!("  {:>10} ms", *delay_us as f64 / 1e3)))?;
        say("\n")?;
        for loss in LOSSES {
            say(&format!("{:>5.1} %", 100.0 * loss))?;
            for delay_us in DELAYS_US {
                let summary = storm::run_loss(seeds.clone(), &Faults::none(dialect, 10_000), loss, delay_us);
                let share = 100.0 * summary.completed as f64 / summary.runs as f64;
                breaches += summary.breach_count;
                say(&format!("  {share:>5.1} % ({:.2})", 1e3 * summary.worst_tracking_m))?;
            }
            say("\n")?;
        }
    }
    say("\nEvery plan that is not completed is stopped with its reason, which is latched.\n")?;
    if breaches > 0 {
        bail!("{breaches} breaches of what may never happen");
    }
    Ok(())
}

/// Writes to standard output. A reader that went away (`| head`) is no error of ours.
fn say(text: &str) -> anyhow::Result<()> {
    match io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(error).context("standard output cannot be written")
        }
        _ => Ok(()),
    }
}
