//! `execute PLAN`: plays a plan on the simulated arm.

use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;
use clap::Parser;
use powderline_executor::Config;
use powderline_executor_cli::load::{LoadError, check_plan, read_plan_file};
use powderline_executor_cli::pace::{VirtualTime, WallClock};
use powderline_executor_cli::report::{PlanFacts, Report};
use powderline_executor_cli::run::{Observer, RunResult, play};
use powderline_firmware_sim::controller::ArmConfig;
use powderline_shared::plan::PlanReader;
use powderline_shared::wire::message::Status;

const EXIT_FAULT: u8 = 1;
const EXIT_BAD_PLAN: u8 = 3;
const EXIT_STOPPED: u8 = 4;
const EXIT_OTHER: u8 = 5;

/// Least time between two updates of the progress line, microseconds.
const PROGRESS_EVERY_US: u64 = 100_000;

/// Plays a plan on the simulated arm and says where the arm ended.
#[derive(Debug, Parser)]
#[command(
    version,
    after_help = "Exit codes:\n  \
    0  the arm performed the whole plan and stands at its end\n  \
    1  the arm was stopped by a fault, does not stand at the plan's end, or has not reported standstill\n  \
    2  wrong usage\n  \
    3  the plan file cannot be read, is damaged, or breaks its own limits\n  \
    4  a person stopped the arm (Ctrl-C)\n  \
    5  anything else, such as an output that cannot be written"
)]
struct Arguments {
    /// Plan file, as written by optimise (RUN/skill.plan)
    plan: PathBuf,
    /// Play by the wall clock, with progress; without it, virtual time passes at once
    #[arg(long)]
    realtime: bool,
    /// Write one JSON object to standard output, and nothing else
    #[arg(long)]
    json: bool,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    match run(&arguments) {
        Ok(code) => code,
        Err(error) => ExitCode::from(fail(&arguments, &error)),
    }
}

/// Says what went wrong, once on standard error and, if wanted, as JSON; the exit code.
fn fail(arguments: &Arguments, error: &anyhow::Error) -> u8 {
    let code = if error.is::<LoadError>() { EXIT_BAD_PLAN } else { EXIT_OTHER };
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
    // From here on Ctrl-C is a controlled stop; only then is the motion announced.
    let mut person = Person::attend(arguments, plan.header().step_count)?;
    if !arguments.json {
        let clock = if arguments.realtime { "wall clock" } else { "virtual time" };
        say(&format!("{}Playing on the simulated arm, {clock}.\n", PlanFacts::new(&file, &plan)))?;
    }
    let result = perform(arguments, &plan, &mut person);
    let report = Report::new(&file, &plan, &result);
    if arguments.json {
        say(&format!("{}\n", serde_json::to_string(&report)?))?;
    } else {
        say(&report.to_string())?;
    }
    Ok(match &report {
        report if report.succeeded() => ExitCode::SUCCESS,
        report if report.stopped_by_a_person() => ExitCode::from(EXIT_STOPPED),
        _ => ExitCode::from(EXIT_FAULT),
    })
}

fn perform(arguments: &Arguments, plan: &PlanReader<'_>, person: &mut Person) -> RunResult {
    let arm = ArmConfig::ideal(plan.header().start_pose());
    let config = Config::default();
    let result = if arguments.realtime {
        play(plan, config, arm, &mut WallClock::start(), person)
    } else {
        play(plan, config, arm, &mut VirtualTime, person)
    };
    person.finish();
    result
}

/// Whoever sits in front of the terminal: sees progress, may press Ctrl-C.
struct Person {
    wants_stop: Arc<AtomicBool>,
    step_count: u32,
    shows_progress: bool,
    next_update_us: u64,
}

impl Person {
    fn attend(arguments: &Arguments, step_count: u32) -> anyhow::Result<Self> {
        let wants_stop = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&wants_stop);
        ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed))
            .context("Ctrl-C cannot be caught, and an arm that cannot be stopped must not start")?;
        let shows_progress = arguments.realtime && !arguments.json && io::stderr().is_terminal();
        Ok(Self { wants_stop, step_count, shows_progress, next_update_us: 0 })
    }

    fn finish(&self) {
        if self.shows_progress {
            tell("\r\x1b[K");
        }
    }
}

impl Observer for Person {
    fn observe(&mut self, now_us: u64, arm: &Status) -> bool {
        if self.shows_progress && now_us >= self.next_update_us {
            self.next_update_us = now_us.saturating_add(PROGRESS_EVERY_US);
            let percent = 100.0 * f64::from(arm.applied_tick) / f64::from(self.step_count);
            tell(&format!(
                "\r\x1b[K  tick {} of {} ({percent:.0} %), {}, {} buffered",
                arm.applied_tick,
                self.step_count,
                arm.state.name(),
                arm.buffered()
            ));
        }
        self.wants_stop.load(Ordering::Relaxed)
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
