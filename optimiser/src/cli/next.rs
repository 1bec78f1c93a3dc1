//! What to type next, wherever the programs are and whoever started them.
//!
//! Started by `cargo run`, a program answers with `cargo run`, which builds what is not there yet. Otherwise it names itself,
//! and `execute` where that stands beside it: by name if the shell finds that file by it, by path if not. Where no `execute`
//! stands beside it, the name alone has to do, with a word on where to get it.

use std::{
    env::{self, consts::EXE_SUFFIX},
    ffi::OsString,
    path::{Path, PathBuf},
    process::Command,
};

/// A command line that starts `optimise` again with these arguments.
pub(super) fn optimise(arguments: &[&str]) -> String {
    Place::here().optimise(arguments)
}

/// A paragraph on how to play this plan on the simulated arm; its last line is the command.
pub(super) fn play(plan: &Path) -> String {
    Place::here().play(&plan.to_string_lossy())
}

/// This program once more, to be given arguments.
pub(super) fn again() -> Command {
    let program = env::current_exe().ok();
    match program {
        Some(program) if !is_python(&program) => Command::new(program),
        // As it was called: an environment's Python knows by that which packages it has.
        _ => {
            let mut command = Command::new(env::args_os().next().unwrap_or_else(|| "python3".into()));
            command.args(["-m", "powderline"]);
            command
        }
    }
}

/// Where this process stands, as far as it tells how to start the next one.
#[derive(Clone, Debug, Default)]
struct Place {
    /// This program's file.
    program: Option<PathBuf>,
    /// The working folder.
    folder: Option<PathBuf>,
    /// Folders in which the shell looks for programs.
    path: Option<OsString>,
    /// The workspace whose `cargo run` started this.
    workspace: Option<PathBuf>,
}

impl Place {
    fn here() -> Self {
        let ours = |name: &OsString| name == env!("CARGO_PKG_NAME");
        let package =
            env::var_os("CARGO_PKG_NAME").filter(ours).and_then(|_| env::var_os("CARGO_MANIFEST_DIR"));
        Self {
            // Python's own file says nothing: where its package is, the shell finds `optimise`.
            program: env::current_exe().ok().filter(|file| !is_python(file)),
            folder: env::current_dir().ok(),
            path: env::var_os("PATH"),
            workspace: package.and_then(|package| Some(Path::new(&package).parent()?.to_owned())),
        }
    }

    fn optimise(&self, arguments: &[&str]) -> String {
        let words = self.by_cargo("optimise").or_else(|| Some(self.words(self.program.as_deref()?)));
        line(words.unwrap_or_else(|| "optimise".into()), arguments)
    }

    fn play(&self, plan: &str) -> String {
        let beside = || {
            let file = self.program.as_deref()?.with_file_name(format!("execute{EXE_SUFFIX}"));
            file.is_file().then(|| self.words(&file))
        };
        let (words, hint) = match self.by_cargo("execute").or_else(beside) {
            Some(words) => (words, ""),
            None => (
                String::from("execute"),
                " (`cargo install --path executor/cli` in Powderline's folder installs it)",
            ),
        };
        format!("Next, play the plan on the simulated arm{hint}:\n\n    {}\n", line(words, &[plan]))
    }

    fn by_cargo(&self, program: &str) -> Option<String> {
        let workspace = self.workspace.as_deref()?;
        let manifest = match self.folder.as_deref() == Some(workspace) {
            true => String::new(),
            false => format!(" --manifest-path {}", quoted(&workspace.join("Cargo.toml").to_string_lossy())),
        };
        Some(format!("cargo run --release{manifest} --bin {program} --"))
    }

    /// How to call a program that is this file.
    fn words(&self, program: &Path) -> String {
        let name = program.file_stem().unwrap_or_default();
        if self.found(name.as_ref()).is_some_and(|found| same_file(&found, program)) {
            return quoted(&name.to_string_lossy());
        }
        let below = self.folder.as_deref().and_then(|folder| program.strip_prefix(folder).ok());
        // Without a slash it would be looked for elsewhere.
        let shown = below.map_or_else(
            || program.to_owned(),
            |below| match below.components().count() {
                1 => Path::new(".").join(below),
                _ => below.to_owned(),
            },
        );
        quoted(&shown.to_string_lossy())
    }

    /// The program that the shell starts by this name.
    fn found(&self, name: &Path) -> Option<PathBuf> {
        let file = name.with_extension(EXE_SUFFIX.trim_start_matches('.'));
        env::split_paths(self.path.as_ref()?).map(|folder| folder.join(&file)).find(|file| file.is_file())
    }
}

fn is_python(program: &Path) -> bool {
    program.file_stem().is_some_and(|name| name.to_string_lossy().starts_with("python"))
}

fn same_file(one: &Path, other: &Path) -> bool {
    matches!((one.canonicalize(), other.canonicalize()), (Ok(one), Ok(other)) if one == other)
}

fn line(program: String, arguments: &[&str]) -> String {
    arguments.iter().fold(program, |line, argument| line + " " + &quoted(argument))
}

/// A word as a shell takes it.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./:@%+,".contains(c) || (cfg!(windows) && c == '\\');
    match !word.is_empty() && word.chars().all(plain) {
        true => word.into(),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    /// A folder with empty programs in `bin` and `other`, and a working folder `work`.
    fn place(programs: &[&str]) -> (tempfile::TempDir, Place) {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().canonicalize().unwrap();
        for name in ["bin", "other", "work/target"] {
            fs::create_dir_all(root.join(name)).unwrap();
        }
        for program in programs {
            fs::write(root.join(format!("{program}{EXE_SUFFIX}")), "").unwrap();
        }
        let place = Place {
            program: Some(root.join(format!("{}{EXE_SUFFIX}", programs[0]))),
            folder: Some(root.join("work")),
            path: Some(env::join_paths([root.join("nowhere"), root.join("bin")]).unwrap()),
            workspace: None,
        };
        (folder, place)
    }

    fn command(paragraph: &str) -> &str {
        paragraph.lines().last().unwrap().trim()
    }

    #[test]
    fn what_the_shell_finds_goes_by_its_name() {
        let (_folder, place) = place(&["bin/optimise", "bin/execute"]);
        assert_eq!(command(&place.play("runs/a/skill.plan")), "execute runs/a/skill.plan");
        assert_eq!(place.optimise(&["--resume", "runs/my run"]), "optimise --resume 'runs/my run'");
    }

    #[test]
    fn what_the_shell_does_not_find_goes_by_its_path() {
        // The shell would start another one of the same name.
        let (folder, place) = place(&["other/optimise", "other/execute", "bin/execute"]);
        let other = folder.path().canonicalize().unwrap().join("other");
        let [optimise, execute] =
            ["optimise", "execute"].map(|name| other.join(format!("{name}{EXE_SUFFIX}")));
        assert_eq!(command(&place.play("x")), format!("{} x", execute.display()));
        assert_eq!(place.optimise(&["x"]), format!("{} x", optimise.display()));
    }

    #[test]
    fn a_program_below_the_working_folder_goes_by_the_short_path() {
        let (_folder, place) = place(&["work/target/optimise", "work/target/execute"]);
        assert_eq!(command(&place.play("x")), format!("target/execute{EXE_SUFFIX} x"));
        let (_folder, place) = self::place(&["work/optimise", "work/execute"]);
        assert_eq!(command(&place.play("x")), format!("./execute{EXE_SUFFIX} x"));
    }

    #[test]
    fn where_there_is_no_execute_it_says_how_to_get_it() {
        let (_folder, place) = place(&["bin/optimise"]);
        let paragraph = place.play("it's a.plan");
        assert_eq!(command(&paragraph), r"execute 'it'\''s a.plan'");
        assert!(paragraph.contains("`cargo install --path executor/cli`"), "{paragraph}");
    }

    #[test]
    fn cargo_answers_for_cargo_from_any_folder() {
        let (_folder, mut place) = place(&["work/target/optimise"]);
        place.workspace.clone_from(&place.folder);
        assert_eq!(command(&place.play("x")), "cargo run --release --bin execute -- x");
        assert_eq!(place.optimise(&["x"]), "cargo run --release --bin optimise -- x");
        place.folder = None;
        let manifest = place.workspace.as_deref().unwrap().join("Cargo.toml");
        let elsewhere =
            format!("cargo run --release --manifest-path {} --bin execute -- x", manifest.display());
        assert_eq!(command(&place.play("x")), elsewhere);
    }
}
