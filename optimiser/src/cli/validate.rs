//! `optimise validate`: how true the powder is.

use super::{CliError, Context, Progress};
use clap::Args;
use powderline_simulator::{
    scene::{DEFAULT_SCENE, Scene},
    validate::{Line, Record, Scope, Table, Verdict, figure, quantity, run},
};
use serde::Serialize;
use std::{
    fmt::Write,
    fs,
    path::{Path, PathBuf},
};

/// Arguments of `optimise validate`.
#[derive(Clone, Debug, Args)]
pub(super) struct ValidateArgs {
    /// Scene whose law of the powder and numerics are measured: an embedded name or a TOML file. Geometry,
    /// friction angle, Young's modulus, cohesion (none), cell and floor are those of each line [default:
    /// bench]
    #[arg(value_name = "SCENE")]
    pub scene: Option<String>,
    /// What can be measured within a minute on two cores: coarse grids, one seed (the default)
    #[arg(long, conflicts_with = "full")]
    pub short: bool,
    /// Everything, stochastic lines with three seeds; about a quarter of an hour on two cores
    #[arg(long)]
    pub full: bool,
    /// Only lines that have these words in their name or that of their group, as `spoon` with --full
    #[arg(
        long,
        value_name = "WORDS",
        default_value = "",
        hide_default_value = true,
        conflicts_with = "write"
    )]
    pub only: String,
    /// Threads; results are the same for any number [default: one per processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Also write the table into this folder, as short.json or full.json, and full.md
    #[arg(long, value_name = "DIR")]
    pub write: Option<PathBuf>,
    /// The commit that is measured, for what is written
    #[arg(long, value_name = "HASH", requires = "write", default_value = "unknown")]
    pub commit: String,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report<'a> {
    /// Lines that held in the table that came with the program and do not now.
    no_longer_holds: &'a [String],
    /// Controls that do not fail.
    does_not_fail: &'a [String],
    /// What makes the command fail, if anything does.
    failure: Option<&'a str>,
    /// How many lines hold.
    summary: String,
    #[serde(flatten)]
    table: &'a Table,
}

/// Runs the command.
///
/// # Errors
/// One sentence; also if a line no longer holds, or a control does not fail.
pub(super) fn execute(arguments: &ValidateArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let name = arguments.scene.as_deref().unwrap_or(DEFAULT_SCENE);
    let scene = Scene::load(name)?;
    let scope = if arguments.full { Scope::Full } else { Scope::Short };
    if let Some(folder) = &arguments.write {
        fs::create_dir_all(folder).map_err(|error| unwritable(folder, &error))?;
    }
    let table = measure(arguments, &scene, scope, context)?;
    if table.wanted == 0 {
        return Err(no_line_has(&arguments.only, scope));
    }
    // What another powder did before, nobody knows.
    let is_default = Scene::load(DEFAULT_SCENE).is_ok_and(|default| default == scene);
    let before = is_default.then(|| Record::committed(scope).table.only(&arguments.only));
    let no_longer = before.map_or_else(Vec::new, |before| table.no_longer_good(&before));
    let loose: Vec<String> = table.with(Verdict::DoesNotFail).map(|line| line.name.clone()).collect();
    let judged = judged(&no_longer, &loose);
    if arguments.json {
        let unfinished = (!table.is_whole()).then(|| unfinished(&table));
        let (failure, summary) = (unfinished.as_deref().or(judged.as_deref()), table.summary());
        let (no_longer_holds, does_not_fail) = (&no_longer, &loose);
        context.json(&Report { no_longer_holds, does_not_fail, failure, summary, table: &table })?;
    } else {
        write!(context.out, "{}", text(&table, &no_longer))?;
    }
    if !table.is_whole() {
        return Err(CliError::Interrupted(unfinished(&table)));
    }
    if let Some(folder) = &arguments.write {
        let scene = arguments.scene.as_ref().map_or(String::new(), |scene| format!("{scene} "));
        let command = format!("optimise validate {scene}--{}", scope.name());
        write_files(folder, &Record::new(&command, &arguments.commit, table))?;
    }
    match judged {
        Some(sentence) => Err(CliError::Failed(sentence)),
        None => Ok(()),
    }
}

fn measure(
    arguments: &ValidateArgs,
    scene: &Scene,
    scope: Scope,
    context: &mut Context<'_>,
) -> Result<Table, CliError> {
    let interrupt = context.interrupt.clone();
    let threads = arguments
        .threads
        .map_or_else(|| std::thread::available_parallelism().map_or(1, usize::from), usize::from);
    let progress = Progress::new(&context.err, context.live);
    progress.begin(&format!("{} table of {}", scope.name(), scene.name), 0, &[]);
    let table = run(scene, scope, &arguments.only, threads, &mut |done, total| {
        progress.tick(done as f64 / total.max(1) as f64);
        interrupt.flow()
    });
    progress.clear();
    Ok(table?)
}

fn no_line_has(words: &str, scope: Scope) -> CliError {
    let full = Record::committed(Scope::Full).table;
    let more = match full.clone().only(words).lines.len() {
        0 => {
            let mut groups: Vec<&str> = full.lines.iter().map(|line| line.group.as_str()).collect();
            groups.dedup();
            format!("the groups are: {}", groups.join("; "))
        }
        1 => "one with --full has".into(),
        count => format!("{count} with --full have"),
    };
    CliError::Input(format!(
        "--only is `{words}`, but no line of the {} table has that in its name; {more}",
        scope.name()
    ))
}

fn unwritable(path: &Path, error: &std::io::Error) -> CliError {
    CliError::Failed(format!("{} cannot be written: {error}", path.display()))
}

fn write_files(folder: &Path, record: &Record) -> Result<(), CliError> {
    let scope = record.table.scope;
    let write = |name: String, text: String| {
        let path = folder.join(name);
        fs::write(&path, text).map_err(|error| unwritable(&path, &error))
    };
    write(format!("{}.json", scope.name()), record.json())?;
    if scope == Scope::Full { write("full.md".into(), record.markdown()) } else { Ok(()) }
}

/// What makes the command fail, in a sentence.
pub(super) fn judged(no_longer: &[String], loose: &[String]) -> Option<String> {
    let of =
        |names: &[String], what: &str| (!names.is_empty()).then(|| format!("{what}: {}", names.join("; ")));
    let parts = [
        of(no_longer, "what held before no longer holds"),
        of(loose, "what is broken on purpose is not noticed"),
    ];
    let parts: Vec<String> = parts.into_iter().flatten().collect();
    (!parts.is_empty()).then(|| parts.join(". And "))
}

fn unfinished(table: &Table) -> String {
    format!("stopped on request: {} of {} lines are measured", table.lines.len(), table.wanted)
}

pub(super) fn text(table: &Table, no_longer: &[String]) -> String {
    let mut out = String::new();
    // Writing to a string does not fail.
    let _ = write_text(&mut out, table, no_longer);
    out
}

fn write_text(out: &mut String, table: &Table, no_longer: &[String]) -> std::fmt::Result {
    if !table.is_whole() {
        writeln!(out, "Not whole: {}.", unfinished(table))?;
    }
    for name in no_longer {
        writeln!(out, "No longer holds: {name}.")?;
    }
    for line in table.with(Verdict::DoesNotFail) {
        writeln!(out, "Does not fail, and must: {}.", line.name)?;
    }
    writeln!(out, "The powder of {}. {}", table.scene, table.summary())?;
    let mut group = "";
    for block in table.blocks() {
        if group != block[0].group {
            group = &block[0].group;
            write!(out, "\n{group:62}{:>22}{:>14}   {:22}", "measured", "reference", "tolerance")?;
        }
        writeln!(out)?;
        block.iter().try_for_each(|line| write_line(out, line))?;
        writeln!(out, "    Reference: {}.\n    Tolerance: {}.", block[0].source, block[0].why)?;
    }
    Ok(())
}

fn write_line(out: &mut String, line: &Line) -> std::fmt::Result {
    let Line { name, unit, reference, tolerance: [low, high], verdict, sentence, .. } = line;
    let tolerance = format!("{} to {}", figure(*low), figure(*high));
    let (measured, reference) = (line.measured_words(), quantity(*reference, unit));
    writeln!(out, "  {name:60}{measured:>22}{reference:>14}   {tolerance:22}{}", verdict.words())?;
    if sentence.is_empty() { Ok(()) } else { writeln!(out, "      {sentence}") }
}
