//! The `optimise` command: arguments, progress, files, words.
//!
//! Exit codes: 0 success; 1 the command failed, a plan did not reproduce, or a line of `validate` no longer holds; 2
//! the input makes no sense, or asks for what cannot be done; 3 a run is finished and its plan written, but misses
//! the wanted amount by more than the tolerance; 130 interrupted; 141 nobody reads the output any more. Results go to
//! standard output, progress and errors (one sentence) to standard error. With `--json` standard output holds one
//! JSON object and nothing else: the command's, or, where it came to none, `error` with the sentence and `exit_code`.
//! Only arguments that cannot be parsed leave it empty.

mod arm_words;
mod bench;
mod campaign;
mod check;
mod compare;
mod executed;
mod export;
mod film;
mod gradcheck;
mod inspect;
mod interrupt;
mod kept;
mod motion;
mod new;
mod next;
mod options;
mod progress;
mod refine;
mod render;
mod report;
mod run;
mod scenes;
mod shell;
mod shorten;
mod simulate;
mod size;
mod slopes;
#[cfg(test)]
mod tests;
mod validate;

pub use crate::failure::Failure as CliError;
pub use crate::run::MAX_EPOCHS;
pub use campaign::{Experiment, check_apart, perform_apart};
pub use check::{CheckArgs, CheckReport, MemoryRow};
pub use interrupt::Interrupt;
pub use motion::{embedded_scene_of_plan, scene_of_plan};
pub use options::{MAX_THREADS, PrecisionArg, Resources, Setup};
pub use progress::{Progress, Stream, is_live};
pub use report::{ReportArgs, execute as report};
pub use run::{EpochFn, RunArgs, run};
pub use size::{Memory, format_size, parse_size};

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use powderline_simulator::{
    rollout::{RolloutError, Simulate},
    scene::{EMBEDDED_SCENES, Scene, closest_match},
};
use serde::Serialize;
use std::{
    ffi::OsString,
    io::{self, Write},
    path::Path,
    process::ExitCode,
};

/// Optimises a skill that scoops, carries and pours powder, and writes it as a plan for an arm.
#[derive(Debug, Parser)]
#[command(name = "optimise", bin_name = "optimise", version, args_conflicts_with_subcommands = true)]
#[command(
    after_help = "Without a command, `optimise [OPTIONS] [SCENE]` means `optimise run [OPTIONS] [SCENE]`.\n\n\
    Exit codes:\n  \
    0    success\n  \
    1    the command failed, a plan did not reproduce, or a line of `validate` no longer holds\n  \
    2    the input makes no sense, or asks for what cannot be done\n  \
    3    the plan is written, but misses the wanted amount by more than the tolerance\n  \
    130  interrupted (Ctrl-C)\n  \
    141  nobody reads the output any more (as in `| head`)"
)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    run: run::RunArgs,
}

/// In the order in which they are needed.
#[derive(Debug, Subcommand)]
enum Command {
    /// List the scenes that come with the program
    Scenes(scenes::ScenesArgs),
    /// Write a scene to begin from
    New(new::NewArgs),
    /// Validate a scene and say what it will cost
    Check(check::CheckArgs),
    /// Optimise a skill and write the plan (the default)
    Run(run::RunArgs),
    /// Make one page of a run, a comparison or a plan: curves, tables, a replay in 3-D
    Report(report::ReportArgs),
    /// Say what a plan holds
    Inspect(inspect::InspectArgs),
    /// Simulate one skill, a plan again, or what the arm made of a plan
    Simulate(simulate::SimulateArgs),
    /// Correct a plan until what it brings on smaller cells is what is wanted
    Refine(refine::RefineArgs),
    /// Make a plan's motion faster, as long as no more powder is lost by that
    Shorten(shorten::ShortenArgs),
    /// Draw pictures and animations of a motion
    Render(render::RenderArgs),
    /// Write the motion of a plan for a robot, ROS 2 or pandas, or the powder for ParaView and MeshLab
    Export(export::ExportArgs),
    /// Compare ways to search for a skill, each with the same number of rollouts
    Compare(compare::CompareArgs),
    /// Run many cases: benches, powders, amounts and seeds, each combined with each
    Campaign(campaign::CampaignArgs),
    /// Compare the gradient with finite differences
    Gradcheck(gradcheck::GradcheckArgs),
    /// Say how true the powder is: what is measured, the reference, its source, the tolerance
    Validate(validate::ValidateArgs),
    /// Measure what each stage of the simulator takes
    #[command(after_help = "The scene that is called bench runs by `optimise`, or `optimise run bench`.")]
    Bench(bench::BenchArgs),
    /// Print what completes commands and options in a shell
    Completions(shell::CompletionsArgs),
    /// Write the manual pages
    Man(shell::ManArgs),
}

/// Where a command gets its simulator from.
pub type Factory<'a> = &'a dyn Fn(&Scene, &Setup) -> Result<Box<dyn Simulate>, RolloutError>;

/// What surrounds a command.
pub struct Context<'a> {
    /// Makes simulators.
    pub factory: Factory<'a>,
    /// Whether the person asked to stop.
    pub interrupt: Interrupt,
    /// Standard output.
    pub out: &'a mut (dyn Write + Send),
    /// Standard error.
    pub err: Stream,
    /// Whether standard error is a terminal.
    pub live: bool,
}

impl Context<'_> {
    fn json(&mut self, object: &impl Serialize) -> Result<(), CliError> {
        let text = serde_json::to_string(object).map_err(io::Error::from)?;
        writeln!(self.out, "{text}")?;
        Ok(())
    }
}

/// The whole program.
pub fn main() -> ExitCode {
    ExitCode::from(program(std::env::args_os()))
}

/// The same with other arguments than the process's, the program's name first: parses them, runs the command, prints the error if
/// there is one, returns the exit code.
pub fn program<T: Into<OsString> + Clone>(arguments: impl IntoIterator<Item = T>) -> u8 {
    let mut context = Context {
        factory: &|scene, setup| setup.simulator(scene),
        interrupt: Interrupt::install(),
        out: &mut io::stdout(),
        err: Stream::new(io::stderr()),
        live: is_live(),
    };
    match execute(arguments, &mut context) {
        Ok(()) => 0,
        Err(error) => {
            if error != CliError::Unread {
                // With nowhere to write to, the exit code has to do.
                let _ = writeln!(context.err, "{error}");
            }
            error.code()
        }
    }
}

/// Runs the command that `arguments` (the program's name first) ask for.
///
/// Help, version and arguments that cannot be parsed end the process, as clap does.
///
/// # Errors
/// The command's sentence.
pub fn execute<I, T>(arguments: I, context: &mut Context<'_>) -> Result<(), CliError>
where
    I: IntoIterator<Item = T>,
    T: Into<OsString> + Clone,
{
    let arguments: Vec<OsString> = arguments.into_iter().map(Into::into).collect();
    mistyped(arguments.get(1))?;
    let matches = Cli::command().get_matches_from(&arguments);
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    let of_command = matches.subcommand().map_or(&matches, |(_, of_command)| of_command);
    let json = matches!(of_command.try_get_one::<bool>("json"), Ok(Some(true)));

    let mut out = Watched { out: &mut *context.out, used: false };
    let mut within = Context {
        factory: context.factory,
        interrupt: context.interrupt.clone(),
        out: &mut out,
        err: context.err.clone(),
        live: context.live,
    };
    let result = run_command(cli, &mut within);
    if let Err(error) = &result
        && json
        && !out.used
    {
        let failure = serde_json::json!({ "error": error.to_string(), "exit_code": error.code() });
        // The sentence goes to standard error all the same.
        let _ = context.json(&failure);
    }
    result
}

fn run_command(cli: Cli, context: &mut Context<'_>) -> Result<(), CliError> {
    match cli.command {
        None => run::execute(&cli.run, context),
        Some(Command::Scenes(arguments)) => scenes::execute(&arguments, context),
        Some(Command::New(arguments)) => new::execute(&arguments, context),
        Some(Command::Check(arguments)) => check::run(&arguments, context.out),
        Some(Command::Run(arguments)) => run::execute(&arguments, context),
        Some(Command::Report(arguments)) => report::execute(&arguments, context),
        Some(Command::Inspect(arguments)) => inspect::execute(&arguments, context),
        Some(Command::Simulate(arguments)) => simulate::execute(&arguments, context),
        Some(Command::Refine(arguments)) => refine::execute(&arguments, context),
        Some(Command::Shorten(arguments)) => shorten::execute(&arguments, context),
        Some(Command::Render(arguments)) => render::execute(&arguments, context),
        Some(Command::Export(arguments)) => export::execute(&arguments, context),
        Some(Command::Compare(arguments)) => compare::execute(&arguments, context),
        Some(Command::Campaign(arguments)) => campaign::execute(&arguments, context),
        Some(Command::Gradcheck(arguments)) => gradcheck::execute(&arguments, context),
        Some(Command::Validate(arguments)) => validate::execute(&arguments, context),
        Some(Command::Bench(arguments)) => bench::execute(&arguments, context),
        Some(Command::Completions(arguments)) => shell::completions(arguments, context),
        Some(Command::Man(arguments)) => shell::man(&arguments, context),
    }
}

/// Refuses a first word that is most like a command: taken for a scene, it would be refused for what comes after it.
fn mistyped(word: Option<&OsString>) -> Result<(), CliError> {
    let Some(word) = word.and_then(|word| word.to_str()) else { return Ok(()) };
    if word.contains(['-', '/', '\\', '.']) || Path::new(word).exists() {
        return Ok(());
    }
    let program = Cli::command();
    let commands: Vec<&str> =
        program.get_subcommands().map(clap::Command::get_name).chain(["help"]).collect();
    let scenes = EMBEDDED_SCENES.map(|(name, _)| name);
    if commands.contains(&word) {
        return Ok(());
    }
    match closest_match(word, scenes.into_iter().chain(commands)) {
        Some(meant) if !scenes.contains(&meant) => Err(CliError::Input(format!(
            "there is no command, no scene and no file called `{word}`; did you mean the command `{meant}`?"
        ))),
        _ => Ok(()),
    }
}

/// Standard output, and whether anything was written to it.
struct Watched<'a> {
    out: &'a mut (dyn Write + Send),
    used: bool,
}

impl Write for Watched<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.used = true;
        self.out.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}
