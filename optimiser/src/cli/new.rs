//! `optimise new`: a scene to begin from.

use super::{CliError, Context, next};
use clap::Args;
use powderline_simulator::scene::{DEFAULT_SCENE, EMBEDDED_SCENES, Scene, closest_match, embedded_scene};
use serde::Serialize;
use std::{
    fs::OpenOptions,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

/// Most characters of a scene's name.
const MAX_NAME_CHARS: usize = 64;

/// Arguments of `optimise new`.
#[derive(Clone, Debug, Args)]
pub(super) struct NewArgs {
    /// File to write, such as my-bench.toml; one that is there already is left alone
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// The scene to begin from; bench explains every key
    #[arg(long, value_name = "SCENE", default_value = DEFAULT_SCENE)]
    pub from: String,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

#[derive(Serialize)]
struct Report<'a> {
    file: &'a Path,
    from: &'a str,
    name: &'a str,
}

/// Runs the command.
///
/// # Errors
/// One sentence.
pub(super) fn execute(arguments: &NewArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let NewArgs { file, from, json } = arguments;
    let shown = file.to_string_lossy();
    if embedded_scene(&shown).is_some() {
        return Err(CliError::Input(format!(
            "`{shown}` always means the scene that comes with the program; another name, such as my-{shown}.toml, would be right"
        )));
    }
    let text = embedded_scene(from).ok_or_else(|| unknown(from))?;
    let name = name_of(file);
    let text = renamed(text, &name);
    // Nothing is written that `optimise check` would refuse.
    Scene::from_toml(&shown, &text)?;
    write_new(file, &text)?;
    if *json {
        return context.json(&Report { file, from, name: &name });
    }
    writeln!(
        context.out,
        "{shown} is the scene {from} under the name {name}. Change it, then let this look at it:\n"
    )?;
    writeln!(context.out, "    {}", next::optimise(&["check", &shown]))?;
    Ok(())
}

fn unknown(from: &str) -> CliError {
    let names = EMBEDDED_SCENES.map(|(name, _)| name);
    let meant =
        closest_match(from, names).map(|meant| format!("; did you mean {meant}?")).unwrap_or_default();
    CliError::Input(format!(
        "--from is `{from}`, but the scenes to begin from are {}{meant}",
        names.join(", ")
    ))
}

/// The file's name without its ending, as a scene's name.
fn name_of(file: &Path) -> String {
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let name: String = stem.chars().filter(|c| !c.is_control()).take(MAX_NAME_CHARS).collect();
    if name.is_empty() { "my-bench".into() } else { name }
}

/// The text of a scene with another name, and without a word about files that are not there.
fn renamed(text: &str, name: &str) -> String {
    let line = |line: &str| match line.split_once('=') {
        Some((key, rest)) if key.trim() == "name" => {
            let remark = rest.find('#').map_or("", |at| &rest[at..]);
            format!("name = {} {remark}", toml::Value::from(name)).trim_end().to_owned()
        }
        _ if line.contains("explained in bench.toml") => {
            "# Every key is explained in the scene that `optimise new FILE` writes.".into()
        }
        _ => line.to_owned(),
    };
    // The scene's own name stands above the first table; those of containers do not.
    let table = text.find("\n[").unwrap_or(text.len());
    let (head, tables) = text.split_at(table);
    head.lines().map(line).collect::<Vec<_>>().join("\n") + tables
}

fn write_new(file: &Path, text: &str) -> Result<(), CliError> {
    let shown = file.display();
    let failed = |error: io::Error| match error.kind() {
        io::ErrorKind::AlreadyExists => {
            CliError::Input(format!("{shown} is there already and is not overwritten; choose another name"))
        }
        _ => CliError::Failed(format!("{shown} cannot be written: {error}")),
    };
    let mut opened = OpenOptions::new().write(true).create_new(true).open(file).map_err(failed)?;
    // Half a scene would be in the way of a second attempt.
    opened.write_all(text.as_bytes()).inspect_err(|_| drop(std::fs::remove_file(file))).map_err(failed)
}
