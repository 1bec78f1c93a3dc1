//! The simulated arm controller, as a program.

mod lines;

use std::fs::{self, File};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{self, BufWriter, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::{Context, bail};
use clap::{Args, CommandFactory, Parser, Subcommand, ValueEnum};
use clap_complete::{Shell, generate};
use powderline_firmware_sim::controller::{ArmConfig, DEFAULT_WATCHDOG_US};
use powderline_firmware_sim_cli::link::faults::Faults;
use powderline_firmware_sim_cli::link::world::Logged;
use powderline_firmware_sim_cli::serve::{self, Announcer, Options, bench_start};
use powderline_firmware_sim_cli::storm::{self, Summary};
use powderline_host::key::read_key_file;
use powderline_host::link::Link;
use powderline_host::realtime;
use powderline_host::terminal::LiveLine;
use powderline_host::words::counted;
use powderline_shared::arm::ArmModel;
use powderline_shared::plan::Mounting;
use powderline_shared::plan::file::{check_plan, read_plan_file};
use powderline_shared::pose::Pose;
use powderline_shared::trajectory::{Sample, TrajectoryHeader};
use powderline_shared::wire::frame::Dialect;
use serde_json::{Value, json};

use lines::Lines;

/// The simulated arm controller: on a wire, or on a simulated one that has every fault
#[derive(Debug, Parser)]
#[command(name = "firmware-sim", bin_name = "firmware-sim", version)]
#[command(args_conflicts_with_subcommands = true, arg_required_else_help = true)]
#[command(after_help = "Exit codes:\n  \
    0    done\n  \
    1    it failed, or something took place that may never happen\n  \
    2    wrong usage\n  \
    141  nobody reads the output any more (as in `| head`); an arm on a wire goes on all the same")]
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
    /// Key that whoever moves the arm must have too (32 bytes, or 64 hexadecimal digits); without one, anybody may
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Stand at the start pose of this plan; without it, at that of the scene bench
    #[arg(long, value_name = "PLAN")]
    at: Option<PathBuf>,
    /// Which arm
    #[arg(long, value_enum, default_value_t = ArmChoice::Own)]
    arm: ArmChoice,
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
    /// Print one JSON object in the end, of the motions made; what is said on the way goes to standard error
    #[arg(long)]
    json: bool,
}

/// Priority asked for under SCHED_FIFO: above the executor's, as the arm's own controller would be.
const PRIORITY: u8 = 50;

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ArmChoice {
    /// The arm of the plan, as `[arm]` of its scene puts it, with joints that lag; without a plan the one beside the scene bench
    Own,
    /// An arm that is where it is told to be
    Ideal,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Play plans between executor and arm over a simulated wire, with faults drawn from seeds, and hold both to what may
    /// never happen
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
        /// Print one JSON object
        #[arg(long)]
        json: bool,
    },
    /// Print what completes commands and options in a shell
    Completions {
        /// The shell
        shell: Shell,
    },
    /// Write the manual pages
    Man {
        /// Folder for the pages, such as ~/.local/share/man/man1
        #[arg(value_name = "DIR")]
        folder: PathBuf,
    },
}

fn parse_range(text: &str) -> Result<Range<u64>, String> {
    let wrong = || format!("\"{text}\" is not a range of seeds; write 0..1000");
    let (from, to) = text.split_once("..").ok_or_else(wrong)?;
    let (from, to): (u64, u64) = (from.parse().map_err(|_| wrong())?, to.parse().map_err(|_| wrong())?);
    if from < to { Ok(from..to) } else { Err(wrong()) }
}

/// Whoever was to read the output went away.
#[derive(Debug)]
struct Unread;

impl std::fmt::Display for Unread {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("nobody reads the output")
    }
}

impl std::error::Error for Unread {}

/// As a shell has it for a program that a closed pipe has ended.
const EXIT_UNREAD: u8 = 141;

fn main() -> ExitCode {
    let Arguments { command, serve } = Arguments::parse();
    let json = match &command {
        Some(Command::Storm { json, .. }) => *json,
        Some(_) => false,
        None => serve.json,
    };
    let done = match command {
        Some(Command::Storm { seed: Some(seed), .. }) => replay(seed, json),
        Some(Command::Storm { seeds, table: true, .. }) => loss_table(seeds, json),
        Some(Command::Storm { seeds, .. }) => storm(seeds, json),
        Some(Command::Completions { shell }) => completions(shell),
        Some(Command::Man { folder }) => man(&folder),
        None => serve_arm(&serve),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if error.is::<Unread>() => ExitCode::from(EXIT_UNREAD),
        Err(error) => {
            // First what a program waits for; standard error may be a pipe that nobody reads.
            if json && !error.is::<Breached>() {
                // There is no one left to tell if this fails too.
                let _ = say(&format!("{}\n", json!({ "error": format!("{error:#}"), "exit_code": 1 })));
            }
            tell(&format!("firmware-sim: {error:#}"));
            ExitCode::FAILURE
        }
    }
}

fn completions(shell: Shell) -> anyhow::Result<()> {
    let mut script = Vec::new();
    generate(shell, &mut Arguments::command(), "firmware-sim", &mut script);
    say(&String::from_utf8_lossy(&script))
}

fn man(folder: &Path) -> anyhow::Result<()> {
    fs::create_dir_all(folder)
        .and_then(|()| clap_mangen::generate_to(Arguments::command(), folder))
        .with_context(|| format!("{}: cannot be written", folder.display()))?;
    let pages = Arguments::command();
    let commands = pages.get_subcommands().map(|command| format!("firmware-sim-{}", command.get_name()));
    std::iter::once("firmware-sim".to_owned())
        .chain(commands)
        .try_for_each(|page| say(&format!("{}\n", folder.join(page + ".1").display())))
}

fn serve_arm(arguments: &Serve) -> anyhow::Result<()> {
    let Some(on) = arguments.on.clone() else { bail!("nothing to do: give --on WIRE, or the command storm") };
    let (pose, own) = arguments.at.as_deref().map_or_else(|| Ok((bench_start(), None)), start_of)?;
    let arm = match arguments.arm {
        ArmChoice::Ideal => ArmConfig::ideal(pose),
        ArmChoice::Own => {
            let (model, whose) = match own {
                Some(own) => (own.model(), "the plan's arm"),
                None => (ArmModel::bench(), "the arm beside the scene bench"),
            };
            ArmConfig::jointed(model, pose).map_err(|error| {
                anyhow::anyhow!(
                    "{whose} cannot stand there ({error}); a plan whose scene has an [arm] brings its own, and --arm ideal \
                     can stand anywhere"
                )
            })?
        }
    };
    // Another one at each start, so that nothing that was said to an arm before is taken for said to this one.
    let nonce_seed = RandomState::new().build_hasher().finish();
    let key = arguments.key.as_deref().map(read_key_file).transpose()?;
    let arm = ArmConfig { watchdog_us: 1_000 * arguments.watchdog, nonce_seed, key, ..arm };
    // Whatever is granted helps; a controller that is held up all the same says so and stops.
    let _ = realtime::prepare((arguments.priority > 0).then_some(arguments.priority));
    let options = Options { on, arm, once: arguments.once };
    let lines = if arguments.json { Lines::to(io::stderr()) } else { Lines::to(io::stdout()) };
    let lines = lines.context("lines cannot be written")?;
    let (executed, motions) = (arguments.executed.clone(), arguments.json.then(Vec::new));
    let mut person = Person { executed, motions, lines };
    serve::serve(&options, &mut person)?;
    person.motions.map_or(Ok(()), |motions| say(&format!("{}\n", json!({ "motions": motions }))))
}

/// Where a plan starts, and the arm that it was made for.
fn start_of(plan: &Path) -> anyhow::Result<(Pose, Option<Mounting>)> {
    let bytes = read_plan_file(plan)?;
    let plan = check_plan(plan, &bytes)?;
    Ok((plan.header().start_pose(), plan.header().arm))
}

/// Whoever sits in front of the terminal.
struct Person {
    executed: Option<PathBuf>,
    /// The motions so far, where they are to be one JSON object in the end.
    motions: Option<Vec<Value>>,
    /// On standard error, where standard output has the object.
    lines: Lines,
}

impl Announcer for Person {
    fn say(&mut self, line: &str) {
        self.lines.say(line);
    }

    fn executed(&mut self, plan_hash: u64, period_us: u32, poses: &[Pose]) -> anyhow::Result<()> {
        let last = poses.last().map(|pose| pose.position_m).unwrap_or_default();
        let (ticks, x, y, z) = (poses.len(), last.x, last.y, last.z);
        self.say(&format!(
            "At rest after {}, at ({x:.6}, {y:.6}, {z:.6}) m.",
            counted(ticks as u64, "tick", "ticks")
        ));
        if let Some(motions) = &mut self.motions {
            motions.push(json!({
                "plan_hash": format!("{plan_hash:016x}"),
                "period_us": period_us,
                "ticks": ticks,
                "end_position_m": [x, y, z],
                "executed": self.executed,
            }));
        }
        let Some(path) = &self.executed else { return Ok(()) };
        write_executed(path, plan_hash, period_us, poses)
            .with_context(|| format!("{}: the motion cannot be written", path.display()))?;
        self.say(&format!("The motion is in {}.", path.display()));
        Ok(())
    }
}

/// Under another name first: a reader finds a whole motion or none.
fn write_executed(path: &Path, plan_hash: u64, period_us: u32, poses: &[Pose]) -> io::Result<()> {
    let unfinished = path.with_extension("unfinished");
    let mut file = BufWriter::new(File::create(&unfinished)?);
    writeln!(file, "{}", TrajectoryHeader { plan_hash, period_us })?;
    for (tick, pose) in (0..).zip(poses) {
        writeln!(file, "{}", Sample { tick, pose: *pose })?;
    }
    file.into_inner()?.sync_all()?;
    fs::rename(&unfinished, path)
}

/// Something took place that may never happen; what was found is said already.
#[derive(Debug)]
struct Breached(String);

impl std::fmt::Display for Breached {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Breached {}

/// A failure if there are breaches, whether or not somebody has read of them; else whatever became of the reading.
fn unless_breached(breaches: u64, remark: &str, said: anyhow::Result<()>) -> anyhow::Result<()> {
    if breaches == 0 {
        return said;
    }
    Err(Breached(format!("{}{remark}", counted(breaches, "breach", "breaches"))).into())
}

fn storm(seeds: Range<u64>, json: bool) -> anyhow::Result<()> {
    let total = seeds.end - seeds.start;
    let (done, line) = (AtomicU64::new(0), LiveLine::on_stderr());
    let summary = storm::run_seeds(seeds, |more| {
        let so_far = done.fetch_add(more, Ordering::Relaxed) + more;
        if let Some(line) = line.filter(|_| so_far.is_multiple_of(256)) {
            line.draw(&format!("  {so_far} of {}", counted(total, "run", "runs")));
        }
    });
    if let Some(line) = line {
        line.clear();
    }
    let text = if json { format!("{}\n", summary_object(&summary)) } else { summary.to_string() };
    unless_breached(summary.breach_count, "; replay one with --seed", say(&text))
}

fn summary_object(summary: &Summary) -> Value {
    let (silence_us, silence_seed) = summary.worst_silence_us;
    let breaches: Vec<Value> =
        summary.breaches.iter().map(|(seed, what)| json!({ "seed": seed, "what": what })).collect();
    json!({
        "runs": summary.runs,
        "completed": summary.completed,
        "simulated_us": summary.simulated_us,
        "frames": summary.frames,
        "events": summary.events,
        "endings": summary.endings,
        "arm_faults": summary.arm_faults,
        "worst_silence": { "us": silence_us, "seed": silence_seed },
        "worst_end_error_lsb": summary.worst_end_error_lsb,
        "worst_tracking_m": summary.worst_tracking_m,
        "breach_count": summary.breach_count,
        "breaches": breaches,
    })
}

fn replay(seed: u64, json: bool) -> anyhow::Result<()> {
    let (run, log) = storm::run_seed(seed, true);
    let mut lines = log.into_iter().map(|(at_us, logged)| log_line(at_us, logged));
    let breaches: Vec<&str> = run.breaches.iter().map(|breach| breach.what.as_str()).collect();
    let said = if json {
        let log: Vec<String> = lines.collect();
        say(&format!("{}\n", json!({ "seed": seed, "breaches": breaches, "log": log })))
    } else {
        lines.try_for_each(|line| say(&format!("{line}\n")))
    };
    let first = breaches.first().map(|first| format!(", the first: {first}")).unwrap_or_default();
    unless_breached(breaches.len() as u64, &first, said)
}

/// As candump has it.
fn log_line(at_us: u64, logged: Logged) -> String {
    let (seconds, micros) = (at_us / 1_000_000, at_us % 1_000_000);
    match logged {
        Logged::Frame(frame) => {
            let data: String = frame.data.iter().map(|byte| format!("{byte:02X}")).collect();
            let mark = if frame.data.len() > 8 { "##0" } else { "#" };
            format!("({seconds:010}.{micros:06}) sim0 {:03X}{mark}{data}", frame.id)
        }
        Logged::Remark(text) => format!("# {seconds}.{micros:06} {text}"),
    }
}

/// Loss by delay: how many plans complete, and how far the arm is from where it was due, at the worst.
fn loss_table(seeds: Range<u64>, json: bool) -> anyhow::Result<()> {
    const LOSSES: [f64; 5] = [0.0, 0.001, 0.01, 0.05, 0.2];
    const DELAYS_US: [u64; 5] = [0, 1_000, 5_000, 20_000, 50_000];
    // With one object to come in the end, the table is for nobody.
    let cell = |text: &str| if json { Ok(()) } else { say(text) };
    let (mut breaches, mut rows) = (0, Vec::new());
    for dialect in [Dialect::Classic, Dialect::Fd] {
        let plans = counted(seeds.end - seeds.start, "plan", "plans");
        cell(&format!(
            "\n{dialect:?}, 100 Hz, {plans} each: completed (largest deviation on the way, mm)\n   loss"
        ))?;
        DELAYS_US.iter().try_for_each(|delay_us| cell(&format!("  {:>10} ms", *delay_us as f64 / 1e3)))?;
        cell("\n")?;
        for loss in LOSSES {
            cell(&format!("{:>5.1} %", 100.0 * loss))?;
            for delay_us in DELAYS_US {
                let summary = storm::run_loss(seeds.clone(), &Faults::none(dialect, 10_000), loss, delay_us);
                let share = 100.0 * summary.completed as f64 / summary.runs as f64;
                breaches += summary.breach_count;
                cell(&format!("  {share:>5.1} % ({:.2})", 1e3 * summary.worst_tracking_m))?;
                rows.push(json!({
                    "dialect": format!("{dialect:?}").to_lowercase(),
                    "loss": loss,
                    "delay_us": delay_us,
                    "runs": summary.runs,
                    "completed": summary.completed,
                    "worst_tracking_m": summary.worst_tracking_m,
                }));
            }
            cell("\n")?;
        }
    }
    let said = match json {
        true => say(&format!("{}\n", json!({ "rows": rows, "breach_count": breaches }))),
        false => say("\nEvery plan that is not completed is stopped with its reason, which is latched.\n"),
    };
    unless_breached(breaches, " of what may never happen", said)
}

/// One line on standard error; where that fails, nobody is left to be told.
fn tell(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}

/// Writes to standard output.
fn say(text: &str) -> anyhow::Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Ok(()) => Ok(()),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Err(Unread.into()),
        Err(error) => Err(error).context("standard output cannot be written"),
    }
}
