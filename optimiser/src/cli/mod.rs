//! The command line of `optimise`: arguments in, text or one JSON object out.
//!
//! Exit codes: 0 done, 1 the result could not be written, 2 bad input (also for unknown arguments).

pub mod check;

use std::io::{self, Write};

use clap::{Parser, Subcommand};
use thiserror::Error;

use crate::scene::SceneError;

/// Optimises how a robot arm scoops and pours powder, in simulation.
#[derive(Debug, Parser)]
#[command(name = "optimise", version)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Validates a scene and says what it will cost.
    Check(check::CheckArgs),
}

/// Why a command failed, as one sentence.
#[derive(Debug, Error)]
pub enum CliError {
    /// The scene was refused.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The result could not be written.
    #[error("the result could not be written: {0}")]
    Output(#[from] io::Error),
}

impl CliError {
    /// The process's exit code.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Scene(_) => 2,
            Self::Output(_) => 1,
        }
    }
}

impl Cli {
    /// Runs the command; results go to `out`.
    ///
    /// # Errors
    /// A [`CliError`], to be shown on standard error.
    pub fn run(&self, out: &mut dyn Write) -> Result<(), CliError> {
        match &self.command {
            Command::Check(args) => check::run(args, out),
        }
    }
}
