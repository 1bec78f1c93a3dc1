//! The `optimise` command: arguments, progress, files, words.
//!
//! Exit codes: 0 success; 1 the command failed, or a plan did not reproduce; 2 the input makes no sense; 130 interrupted.
//! Results go to standard output, progress and errors (one sentence) to standard error. With `--json` standard output
//! holds one JSON object and nothing else.

mod bench;
mod check;
mod compare;
mod error;
mod executed;
mod export;
mod film;
mod gradcheck;
mod inspect;
mod interrupt;
mod motion;
mod options;
mod progress;
mod render;
mod report;
mod run;
mod simulate;
mod size;
mod steps;
#[cfg(test)]
mod tests;

pub use check::{CheckArgs, CheckReport, MemoryRow};
pub use error::CliError;
pub use interrupt::Interrupt;
pub use options::{PrecisionArg, Resources};
pub use progress::Progress;
pub use size::{format_size, parse_size};

use clap::{Parser, Subcommand};
use powderline_simulator::{
    rollout::{Evaluate, RolloutError, SimulatorSettings, boxed_simulator},
    scene::Scene,
};
use serde::Serialize;
use std::{
    ffi::OsString,
    io::{self, IsTerminal, Write},
    process::ExitCode,
};

/// Optimises a skill that scoops, carries and pours powder, and writes it as a plan for an arm.
#[derive(Debug, Parser)]
#[command(name = "optimise", version, args_conflicts_with_subcommands = true)]
#[command(
    after_help = "Without a command, `optimise [OPTIONS] [SCENE]` means `optimise run [OPTIONS] [SCENE]`."
)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    run: run::RunArgs,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Optimise a skill and write the plan (the default)
    Run(run::RunArgs),
    /// Validate a scene and say what it will cost
    Check(check::CheckArgs),
    /// Simulate one skill, a plan again, or what the arm made of a plan
    Simulate(simulate::SimulateArgs),
    /// Compare the gradient with finite differences
    Gradcheck(gradcheck::GradcheckArgs),
    /// Compare ways to search for a skill, each with the same number of rollouts
    Compare(compare::CompareArgs),
    /// Make one page of a run, a comparison or a plan: curves, tables, a replay in 3-D
    Report(report::ReportArgs),
    /// Draw pictures and animations of a motion
    Render(render::RenderArgs),
    /// Write the motion of a plan for a robot, ROS 2 or pandas, or the powder for ParaView and MeshLab
    Export(export::ExportArgs),
    /// Say what a plan holds
    Inspect(inspect::InspectArgs),
    /// Measure what each stage of the simulator takes
    #[command(after_help = "The scene that is called bench runs by `optimise`, or `optimise run bench`.")]
    Bench(bench::BenchArgs),
}

/// Where a command gets its simulator from.
pub type Factory<'a> = &'a dyn Fn(&Scene, &SimulatorSettings) -> Result<Box<dyn Evaluate>, RolloutError>;

/// What surrounds a command.
pub struct Context<'a> {
    /// Makes simulators.
    pub factory: Factory<'a>,
    /// Whether the person asked to stop.
    pub interrupt: Interrupt,
    /// Standard output.
    pub out: &'a mut (dyn Write + Send),
    /// Standard error.
    pub err: &'a mut (dyn Write + Send),
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

/// The whole program: parses the arguments, runs the command, prints the error if there is one.
pub fn main() -> ExitCode {
    let mut context = Context {
        factory: &boxed_simulator,
        interrupt: Interrupt::install(),
        out: &mut io::stdout(),
        err: &mut io::stderr(),
        live: io::stderr().is_terminal(),
    };
    match execute(std::env::args_os(), &mut context) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // With nowhere to write to, the exit code has to do.
            let _ = writeln!(context.err, "{error}");
            error.exit_code()
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
    let cli = Cli::parse_from(arguments);
    match cli.command {
        None => run::execute(&cli.run, context),
        Some(Command::Run(arguments)) => run::execute(&arguments, context),
        Some(Command::Check(arguments)) => check::run(&arguments, context.out),
        Some(Command::Simulate(arguments)) => simulate::execute(&arguments, context),
        Some(Command::Gradcheck(arguments)) => gradcheck::execute(&arguments, context),
        Some(Command::Compare(arguments)) => compare::execute(&arguments, context),
        Some(Command::Report(arguments)) => report::execute(&arguments, context),
        Some(Command::Render(arguments)) => render::execute(&arguments, context),
        Some(Command::Export(arguments)) => export::execute(&arguments, context),
        Some(Command::Inspect(arguments)) => inspect::execute(&arguments, context),
        Some(Command::Bench(arguments)) => bench::execute(&arguments, context),
    }
}
