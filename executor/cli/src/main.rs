//! `execute PLAN`: plays a plan on an arm.

use std::fs::File;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, anyhow, bail};
use clap::{Arg, ArgMatches, CommandFactory, FromArgMatches, Parser, value_parser};
use clap_complete::Shell;
use powderline_executor::Config;
use powderline_executor::guard::{Unplayable, rehearse};
use powderline_executor::schedule::DEFAULT_LOOK_AHEAD;
use powderline_executor_cli::pace::{VirtualTime, WallClock};
use powderline_executor_cli::report::{PlanFacts, Report};
use powderline_executor_cli::run::{Observer, RunResult, StopWish, play};
use powderline_executor_cli::wire::{self, FlightRecorder};
use powderline_firmware_sim::controller::ArmConfig;
use powderline_host::candump::Writer;
use powderline_host::key::read_key_file;
use powderline_host::link::Link;
use powderline_host::realtime;
use powderline_host::signals::Signals;
use powderline_host::terminal::LiveLine;
use powderline_host::transport::{self, LinkError, Transport};
use powderline_host::wait::Interest;
use powderline_host::words::counted;
use powderline_shared::displacement::Lsb;
use powderline_shared::following::Following;
use powderline_shared::plan::file::{LoadError, check_plan, read_plan_file};
use powderline_shared::plan::{PERIOD_US_MAX, PERIOD_US_MIN, PlanReader};
use powderline_shared::wire::auth::Key;
use powderline_shared::wire::frame::Dialect;
use powderline_shared::wire::message::Status;

const EXIT_FAULT: u8 = 1;
const EXIT_BAD_PLAN: u8 = 3;
const EXIT_STOPPED: u8 = 4;
const EXIT_OTHER: u8 = 5;
const EXIT_WIRE: u8 = 6;

/// Least time between two updates of the progress line, microseconds.
const PROGRESS_EVERY_US: u64 = 100_000;

/// Priority asked for under SCHED_FIFO: above ordinary real-time work, below the kernel's own threads.
const PRIORITY: u8 = 49;

/// Plays a plan on an arm and says where the arm ended.
#[derive(Debug, Parser)]
#[command(
    name = "execute",
    bin_name = "execute",
    version,
    after_help = "Exit codes:\n  \
    0  the arm performed the whole plan and stands at its end\n  \
    1  the arm was stopped by a fault, does not stand at the plan's end, or has not reported standstill\n  \
    2  wrong usage\n  \
    3  the plan file cannot be read, is damaged, or breaks its own limits\n  \
    4  a person stopped the arm (Ctrl-C)\n  \
    5  anything else, such as an output that cannot be written\n  \
    6  the wire cannot be used, or is too slow or too coarse for the plan\n\n\
    Ctrl-C is a controlled stop; a second one stops as hard as the arm can. \
    Where nobody reads the output any more (as in `| head`) the arm goes on all the same, and the exit code says how it ended."
)]
struct Arguments {
    /// Plan file, as written by optimise (RUN/skill.plan)
    plan: PathBuf,
    /// Where the arm is.
    #[arg(
        long,
        value_name = "WIRE",
        default_value = "sim",
        help = "Where the arm is: sim, can:IFACE[@BITRATE], canfd:IFACE[@NOMINAL/DATA] or serial:DEVICE[@BAUD]"
    )]
    to: Link,
    /// Key that the arm has too (32 bytes, or 64 hexadecimal digits): frames of whoever has another one, or none, are not believed
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Setpoints a second; the plan's own rate by default. Another rate plays the same path faster or slower
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    /// Time without a report after which the arm counts as silent, milliseconds
    #[arg(long, value_name = "MS", default_value_t = 300, value_parser = clap::value_parser!(u64).range(LEAST_ARM_TIMEOUT_MS..=10_000))]
    arm_timeout: u64,
    /// How far the arm may be along an axis from where it is due, millimetres; how far it goes in 30 ms is added
    #[arg(long, value_name = "MM", default_value_t = 1e3 * Following::default().linear_m, value_parser = positive)]
    following: f64,
    /// How far the arm may be turned about an axis from where it is due, milliradians; how far it turns in 30 ms is added
    #[arg(long, value_name = "MRAD", default_value_t = 1e3 * Following::default().angular_rad, value_parser = positive)]
    following_angle: f64,
    /// Setpoints to be ahead of the arm's clock; by default as many as it has room for
    #[arg(long, value_name = "TICKS", default_value_t = DEFAULT_LOOK_AHEAD, value_parser = clap::value_parser!(u16).range(1..=16))]
    look_ahead: u16,
    /// Reset an arm that has a stop latched. Look at it first
    #[arg(long)]
    reset: bool,
    /// Say what the system granted for real time, and how late each cycle began
    #[arg(long)]
    measure: bool,
    /// Priority under SCHED_FIFO on a wire, 1 to 99; 0 leaves the process scheduled as usual
    #[arg(long, value_name = "PRIORITY", default_value_t = PRIORITY, value_parser = clap::value_parser!(u8).range(0..=99))]
    priority: u8,
    /// Write the last frames of the session to this file, in candump's format
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Check everything that can be checked without an arm, and stop there
    #[arg(long)]
    dry_run: bool,
    /// With the simulated arm: play by the wall clock, with progress; without it, virtual time passes at once
    #[arg(long)]
    realtime: bool,
    /// Write one JSON object to standard output, and nothing else
    #[arg(long)]
    json: bool,
}

/// An arm that stands speaks every 100 ms, and one of its frames may be lost.
const LEAST_ARM_TIMEOUT_MS: u64 = 250;

fn positive(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("\"{text}\" is no number"))?;
    if value > 0.0 && value.is_finite() { Ok(value) } else { Err("it must be finite and above 0".into()) }
}

/// The wire cannot be used for this plan.
#[derive(Debug)]
struct WireError(String);

impl std::fmt::Display for WireError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for WireError {}

impl From<LinkError> for WireError {
    fn from(error: LinkError) -> Self {
        Self(error.to_string())
    }
}

const COMPLETIONS: &str = "completions";
const MAN: &str = "man";

/// The program's arguments, and what may be asked of the program itself: beside that no plan is needed.
fn program() -> clap::Command {
    let completions = Arg::new(COMPLETIONS)
        .value_name("SHELL")
        .value_parser(value_parser!(Shell))
        .help("Print what completes the options in this shell, and do nothing else");
    let man = Arg::new(MAN)
        .value_name("DIR")
        .value_parser(value_parser!(PathBuf))
        .help("Write the manual page into this folder, and do nothing else");
    let itself = [completions.long(COMPLETIONS), man.long(MAN)];
    Arguments::command().args(itself.map(|argument| argument.exclusive(true)))
}

/// Answers what is asked of the program itself; `false` if nothing is.
fn speak_of_itself(asked: &ArgMatches) -> anyhow::Result<bool> {
    if let Some(shell) = asked.get_one::<Shell>(COMPLETIONS) {
        let mut script = Vec::new();
        clap_complete::generate(*shell, &mut program(), "execute", &mut script);
        say(&String::from_utf8_lossy(&script))?;
    } else if let Some(folder) = asked.get_one::<PathBuf>(MAN) {
        std::fs::create_dir_all(folder)
            .and_then(|()| clap_mangen::generate_to(program(), folder))
            .with_context(|| format!("{}: cannot be written", folder.display()))?;
        say(&format!("{}\n", folder.join("execute.1").display()))?;
    } else {
        return Ok(false);
    }
    Ok(true)
}

fn main() -> ExitCode {
    let asked = program().get_matches();
    match speak_of_itself(&asked) {
        Ok(false) => {}
        Ok(true) => return ExitCode::SUCCESS,
        Err(error) => {
            tell(&format!("execute: {error:#}\n"));
            return ExitCode::from(EXIT_OTHER);
        }
    }
    let arguments = Arguments::from_arg_matches(&asked).unwrap_or_else(|error| error.exit());
    match run(&arguments) {
        Ok(code) => code,
        Err(error) => ExitCode::from(fail(&arguments, &error)),
    }
}

/// Says what went wrong, once on standard error and, if wanted, as JSON; the exit code.
fn fail(arguments: &Arguments, error: &anyhow::Error) -> u8 {
    let code = match error {
        error if error.is::<LoadError>() => EXIT_BAD_PLAN,
        error if error.is::<WireError>() => EXIT_WIRE,
        _ => EXIT_OTHER,
    };
    tell(&format!("execute: {error:#}\n"));
    if arguments.json {
        let object = serde_json::json!({ "error": format!("{error:#}"), "exit_code": code });
        // There is no one left to tell if this fails too.
        let _ = writeln!(io::stdout(), "{object}");
    }
    code
}

fn run(arguments: &Arguments) -> anyhow::Result<ExitCode> {
    let bytes = read_plan_file(&arguments.plan)?;
    let plan = check_plan(&arguments.plan, &bytes)?;
    let file = arguments.plan.display().to_string();
    let config = config(arguments, &plan)?;
    check_record(arguments)?;
    let load = check_wire(arguments, &plan, &config)?;
    announce(arguments, &format!("{}  wire      {}{load}\n", PlanFacts::new(&file, &plan), arguments.to))?;
    if arguments.dry_run {
        if arguments.to == Link::Sim {
            simulated_arm(&plan)?;
        }
        return say_dry(arguments);
    }
    let mut record = arguments.record.as_deref().map(Record::create).transpose()?;
    let performed = match &arguments.to {
        Link::Sim => perform_here(arguments, &plan, config),
        to => perform_there(arguments, &plan, config, to, record.as_mut()),
    };
    let result = match performed {
        Ok(result) => result,
        Err(error) => {
            let written = record.map_or(Ok(()), |record| record.finish(&arguments.to, &format!("{error:#}")));
            written.unwrap_or_else(|other| tell(&format!("execute: {other:#}\n")));
            return Err(error);
        }
    };
    let report = Report::new(&file, &plan, &result);
    let written = record.map_or(Ok(()), |record| record.finish(&arguments.to, &report.cause()));
    if arguments.json {
        say(&format!("{}\n", serde_json::to_string(&report)?))?;
    } else {
        say(&report.to_string())?;
    }
    // What the arm did comes first: the report stands, and so does what it ends with.
    if let Err(error) = &written {
        tell(&format!("execute: {error:#}\n"));
    }
    Ok(match &report {
        report if report.succeeded() && written.is_err() => ExitCode::from(EXIT_OTHER),
        report if report.succeeded() => ExitCode::SUCCESS,
        report if report.stopped_by_a_person() => ExitCode::from(EXIT_STOPPED),
        _ => ExitCode::from(EXIT_FAULT),
    })
}

fn config(arguments: &Arguments, plan: &PlanReader<'_>) -> anyhow::Result<Config> {
    let own_us = plan.header().control_period_us;
    let period_us = arguments.rate.map_or(Ok(own_us), |rate_hz| {
        let period_us = (1e6 / rate_hz).round();
        let range = f64::from(PERIOD_US_MIN)..=f64::from(PERIOD_US_MAX);
        if !range.contains(&period_us) {
            bail!(
                "--rate {rate_hz} Hz cannot be kept: it must lie between {} and {} Hz",
                1e6 / range.end(),
                1e6 / range.start()
            );
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a whole number in the range above"
        )]
        let period_us = period_us as u32;
        Ok(period_us)
    })?;
    // Any number that nobody else is likely to have; which of them are usable is the executor's to know.
    #[expect(clippy::cast_possible_truncation, reason = "any 16 bits will do")]
    let session = (drawn() as u16).max(1);
    Ok(Config {
        session,
        key: key(arguments)?,
        nonce: drawn(),
        period_us: Some(period_us),
        look_ahead: arguments.look_ahead,
        reset: arguments.reset,
        silence_us: 1_000 * arguments.arm_timeout,
        following: Following {
            linear_m: 1e-3 * arguments.following,
            angular_rad: 1e-3 * arguments.following_angle,
            ..Following::default()
        },
        ..Config::default()
    })
}

/// Another number each time.
fn drawn() -> u64 {
    RandomState::new().build_hasher().finish()
}

fn key(arguments: &Arguments) -> anyhow::Result<Option<Key>> {
    let Some(path) = &arguments.key else { return Ok(None) };
    if arguments.to == Link::Sim {
        bail!("--key {} is for an arm on a wire; give --to WIRE too", path.display());
    }
    Ok(Some(read_key_file(path)?))
}

/// Whether the plan can be played over the wire at all: limits, counts, load. Words for the load.
fn check_wire(arguments: &Arguments, plan: &PlanReader<'_>, config: &Config) -> Result<String, WireError> {
    if arguments.to == Link::Pty {
        return Err(WireError(
            "pty is what firmware-sim opens; give the serial:DEVICE that it prints".into(),
        ));
    }
    let period_us = config.period_us.unwrap_or(plan.header().control_period_us);
    let (lsb, span) = scale(&arguments.to, plan);
    let rate_hz = 1e6 / f64::from(period_us);
    rehearse(plan, lsb, period_us, span).map_err(|error| {
        let (file, to) = (arguments.plan.display(), &arguments.to);
        let own_us = plan.header().control_period_us;
        let times = f64::from(own_us) / f64::from(period_us);
        match error {
            // It is the haste, not the wire, that breaks the limit.
            Unplayable::Limit(violation) if times > 1.0 && rehearse(plan, lsb, own_us, span).is_ok() => {
                WireError(format!(
                    "{file} cannot be played {times:.2} times as fast as it was planned: with --rate {rate_hz:.0} {violation}; its own \
                     rate is {:.0}",
                    1e6 / f64::from(own_us)
                ))
            }
            _ => WireError(format!("{file} cannot be played to {to}: {error}")),
        }
    })?;
    let mut words = format!(", {rate_hz:.0} setpoints a second");
    if let Some(medium) = wire::medium(&arguments.to)? {
        let percent = medium.load_percent(period_us);
        if percent > 100.0 {
            return Err(WireError(format!(
                "{} is too slow for {rate_hz:.0} setpoints a second: they would load it by {percent:.0} per cent; a lower \
                 --rate plays the plan more slowly",
                arguments.to
            )));
        }
        words.push_str(&format!(", a load of at most {percent:.1} %"));
    }
    if config.key.is_some() {
        words.push_str(", with a key");
    }
    Ok(words)
}

/// What a count is worth on a wire, and how far apart positions may be there to be told apart.
fn scale(to: &Link, plan: &PlanReader<'_>) -> (Lsb, Option<u32>) {
    match to {
        Link::Sim => (plan.header().lsb, None),
        Link::Can { .. } => (Dialect::Classic.lsb(), Dialect::Classic.span()),
        Link::CanFd { .. } | Link::Serial { .. } | Link::Pty => (Dialect::Fd.lsb(), Dialect::Fd.span()),
    }
}

fn say_dry(arguments: &Arguments) -> anyhow::Result<ExitCode> {
    if arguments.json {
        say("{\"dry_run\":true,\"exit_code\":0}\n")?;
    } else {
        say(
            "The plan's limits and the load of the wire are in order; no wire was opened, and nothing was sent.\n",
        )?;
    }
    Ok(ExitCode::SUCCESS)
}

fn perform_here(arguments: &Arguments, plan: &PlanReader<'_>, config: Config) -> anyhow::Result<RunResult> {
    let mut person = Person::attend(arguments, plan, arguments.realtime)?;
    let clock = if arguments.realtime { "by the wall clock" } else { "in virtual time" };
    let (arm, which) = simulated_arm(plan)?;
    announce(arguments, &format!("Playing on the simulated arm, {which}, {clock}.\n"))?;
    let period_us = config.period_us.unwrap_or(plan.header().control_period_us);
    let result = if arguments.realtime {
        play(plan, config, arm, &mut WallClock::start(u64::from(period_us) / 10), &mut person)
    } else {
        play(plan, config, arm, &mut VirtualTime, &mut person)
    };
    person.finish();
    Ok(result)
}

/// The plan's own arm, whose joints lag, and what it is; an ideal one where no arm was looked at.
fn simulated_arm(plan: &PlanReader<'_>) -> anyhow::Result<(ArmConfig, String)> {
    let start = plan.header().start_pose();
    let Some(arm) = plan.header().arm else {
        return Ok((ArmConfig::ideal(start), "which is where it is told to be".into()));
    };
    let kind = arm.kind.label();
    let config = ArmConfig::jointed(arm.model(), start).map_err(|error| {
        anyhow!("the plan's {kind} cannot stand at the plan's start: {error}; make the plan anew")
    })?;
    Ok((config, format!("a {kind} whose joints lag")))
}

fn perform_there(
    arguments: &Arguments,
    plan: &PlanReader<'_>,
    config: Config,
    to: &Link,
    record: Option<&mut Record>,
) -> anyhow::Result<RunResult> {
    let wire = transport::open(to).map_err(WireError::from)?;
    let mut wire: Box<dyn Transport> = wire.ok_or_else(|| anyhow!("{to} is no wire"))?;
    // From here on Ctrl-C is a controlled stop; only then may the arm move.
    let mut person = Person::attend(arguments, plan, true)?;
    let granted = realtime::prepare((arguments.priority > 0).then_some(arguments.priority));
    if arguments.measure {
        announce(arguments, &format!("{granted}\n"))?;
    }
    announce(arguments, &format!("Playing to {to}.\n"))?;
    let mut spare = None;
    let recorder = record.map_or_else(|| spare.insert(Box::default()), |record| &mut record.recorder);
    let mut result = wire::play(plan, config, wire.as_mut(), recorder, &mut person)
        .context("the wire cannot be waited for")?;
    person.finish();
    if !arguments.measure {
        result.jitter = None;
    }
    Ok(result)
}

fn announce(arguments: &Arguments, text: &str) -> anyhow::Result<()> {
    if arguments.json { Ok(()) } else { say(text) }
}

fn check_record(arguments: &Arguments) -> anyhow::Result<()> {
    let Some(path) = &arguments.record else { return Ok(()) };
    if arguments.to == Link::Sim {
        bail!(
            "--record {} is for an arm on a wire: there are no frames here; give --to WIRE too",
            path.display()
        );
    }
    Ok(())
}

/// Where the last frames go when the session is over: to a file beside it, which is there before the arm moves. One of before stays until
/// then, and where there is no frame.
struct Record {
    path: PathBuf,
    part: PathBuf,
    file: File,
    recorder: Box<FlightRecorder>,
}

impl Record {
    fn create(path: &Path) -> anyhow::Result<Self> {
        // A pipe, a device or a folder is no file that another could take the place of.
        let is_other = std::fs::metadata(path).is_ok_and(|there| !there.is_file());
        let mut part = path.as_os_str().to_owned();
        part.push(if is_other { "" } else { ".part" });
        let part = PathBuf::from(part);
        let file = File::create(&part).with_context(|| format!("{}: cannot be written", path.display()))?;
        Ok(Self { path: path.to_owned(), part, file, recorder: Box::default() })
    }

    /// With how it ended.
    fn finish(self, to: &Link, cause: &str) -> anyhow::Result<()> {
        if self.recorder.frames().next().is_none() {
            // There is nothing to be told of a session that there was none of.
            if self.part != self.path {
                let _ = std::fs::remove_file(&self.part);
            }
            return Ok(());
        }
        let (interface, dialect) = match to {
            Link::Can { interface, .. } => (interface.as_str(), Dialect::Classic),
            Link::CanFd { interface, .. } => (interface.as_str(), Dialect::Fd),
            Link::Sim | Link::Serial { .. } | Link::Pty => ("serial0", Dialect::Fd),
        };
        let Self { path, part, file, recorder } = self;
        let mut log = Writer::new(BufWriter::new(file), interface, dialect);
        let write = || -> io::Result<()> {
            if recorder.forgotten() > 0 {
                let (one, more) = ("frame before these is", "frames before these are");
                log.remark(&format!("{} forgotten", counted(recorder.forgotten(), one, more)))?;
            }
            for recorded in recorder.frames() {
                log.frame(recorded.at_us, &recorded.frame)?;
            }
            log.remark(cause)?;
            log.into_inner().flush()?;
            if part == path { Ok(()) } else { std::fs::rename(&part, &path) }
        };
        write().with_context(|| format!("{}: cannot be written", path.display()))
    }
}

/// Whoever sits in front of the terminal: sees progress, may press Ctrl-C.
struct Person {
    signals: Signals,
    step_count: u32,
    progress: Option<LiveLine>,
    next_update_us: u64,
}

impl Person {
    fn attend(arguments: &Arguments, plan: &PlanReader<'_>, takes_time: bool) -> anyhow::Result<Self> {
        let signals = Signals::install()
            .context("Ctrl-C cannot be caught, and an arm that cannot be stopped must not start")?;
        let progress = LiveLine::on_stderr().filter(|_| takes_time && !arguments.json);
        Ok(Self { signals, step_count: plan.header().step_count, progress, next_update_us: 0 })
    }

    fn finish(&self) {
        if let Some(line) = self.progress {
            line.clear();
        }
    }
}

impl Observer for Person {
    fn observe(&mut self, now_us: u64, arm: &Status) -> StopWish {
        if let Some(line) = self.progress.filter(|_| now_us >= self.next_update_us) {
            self.next_update_us = now_us.saturating_add(PROGRESS_EVERY_US);
            let percent = 100.0 * f64::from(arm.applied_tick) / f64::from(self.step_count);
            line.draw(&format!(
                "  tick {} of {} ({percent:.0} %), {}, {} buffered",
                arm.applied_tick,
                self.step_count,
                arm.state.name(),
                arm.buffered()
            ));
        }
        self.signals.wish()
    }

    fn interest(&self) -> Option<Interest<'_>> {
        Some(self.signals.interest())
    }
}

/// Writes to standard error. Where that fails, as on a terminal that has been closed, nobody is left to be told; the arm
/// is still to be stopped as it should.
fn tell(text: &str) {
    let mut err = io::stderr().lock();
    let _ = err.write_all(text.as_bytes()).and_then(|()| err.flush());
}

/// Writes to standard output. A reader that went away (`| head`) is no error of ours.
fn say(text: &str) -> anyhow::Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(error).context("standard output cannot be written")
        }
        _ => Ok(()),
    }
}
