//! `optimise completions` and `optimise man`: what a shell and `man` want to know of the program.

use super::{Cli, CliError, Context};
use clap::{Args, CommandFactory};
use clap_complete::{Shell, generate};
use serde::Serialize;
use std::{
    fs,
    path::{Path, PathBuf},
};

/// Arguments of `optimise completions`.
#[derive(Clone, Debug, Args)]
pub(super) struct CompletionsArgs {
    /// The shell; `source <(optimise completions bash)` in ~/.bashrc, for one
    #[arg(value_name = "SHELL")]
    pub shell: Shell,
}

/// Arguments of `optimise man`.
#[derive(Clone, Debug, Args)]
pub(super) struct ManArgs {
    /// Folder for the pages, such as ~/.local/share/man/man1
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

#[derive(Serialize)]
struct Report {
    files: Vec<PathBuf>,
}

/// Prints the completions.
///
/// # Errors
/// Standard output's.
pub(super) fn completions(arguments: CompletionsArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let (mut program, mut script) = (Cli::command(), Vec::new());
    generate(arguments.shell, &mut program, "optimise", &mut script);
    Ok(context.out.write_all(&script)?)
}

/// Writes one page for the program and one for each of its commands.
///
/// # Errors
/// One sentence.
pub(super) fn man(arguments: &ManArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let folder = arguments.folder.as_path();
    let failed = |error| CliError::Failed(format!("{} cannot be written: {error}", folder.display()));
    let files = write_pages(folder).map_err(failed)?;
    if arguments.json {
        return context.json(&Report { files });
    }
    for file in &files {
        writeln!(context.out, "{}", file.display())?;
    }
    Ok(())
}

fn write_pages(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    fs::create_dir_all(folder)?;
    let program = Cli::command();
    let name = program.get_name().to_owned();
    let commands = program.get_subcommands().map(|command| format!("{name}-{}", command.get_name()));
    let pages: Vec<String> = std::iter::once(name.clone()).chain(commands).collect();
    clap_mangen::generate_to(program, folder)?;
    Ok(pages.into_iter().map(|page| folder.join(format!("{page}.1"))).collect())
}
