//! `optimise`: from a bench description to a motion.

use std::process::ExitCode;

use clap::Parser;
use powderline_optimiser::cli::Cli;

fn main() -> ExitCode {
    match Cli::parse().run(&mut std::io::stdout().lock()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(error.exit_code())
        }
    }
}
