//! Starting the programs and reading what they say.

use std::ffi::OsStr;
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use powderline_simulator::scene::Scene;
use serde_json::Value;
use tempfile::TempDir;

pub(crate) const OPTIMISE: &str = env!("CARGO_BIN_EXE_tested-optimise");
pub(crate) const EXECUTE: &str = env!("CARGO_BIN_EXE_tested-execute");
pub(crate) const FIRMWARE_SIM: &str = env!("CARGO_BIN_EXE_tested-firmware-sim");

/// What a process left behind.
#[derive(Debug)]
pub(crate) struct Done {
    pub(crate) code: Option<i32>,
    pub(crate) out: String,
    pub(crate) err: String,
}

impl Done {
    fn new(output: Output) -> Self {
        let text = |bytes| String::from_utf8(bytes).unwrap();
        Self { code: output.status.code(), out: text(output.stdout), err: text(output.stderr) }
    }

    /// Standard output of a process that succeeded.
    #[track_caller]
    pub(crate) fn succeeded(self) -> String {
        assert_eq!(self.code, Some(0), "{self:?}");
        self.out
    }

    /// Standard output of a run that came to its plan, whether that brings the wanted amount or misses it (exit code 3).
    #[track_caller]
    pub(crate) fn finished(self) -> String {
        assert!(matches!(self.code, Some(0 | 3)), "{self:?}");
        self.out
    }

    /// The one JSON object, and nothing else, on the standard output of a process that succeeded.
    #[track_caller]
    pub(crate) fn json(self) -> Value {
        let out = self.succeeded();
        assert_eq!(out.lines().count(), 1, "{out}");
        serde_json::from_str(&out).unwrap()
    }

    /// Nothing but one sentence on standard error, with a word that tells what it is about.
    #[track_caller]
    pub(crate) fn refused(&self, code: i32, about: &str) {
        assert_eq!(self.err.lines().count(), 1, "{self:?}");
        self.ended(code, about);
    }

    /// One sentence at the end of what it said before.
    #[track_caller]
    pub(crate) fn ended(&self, code: i32, about: &str) {
        assert_eq!(self.code, Some(code), "{self:?}");
        assert!(self.out.is_empty(), "{self:?}");
        assert!(!self.err.contains("panicked"), "{self:?}");
        let sentence = self.err.lines().last().unwrap_or_default();
        assert!(sentence.contains(about), "`{about}` in: {sentence}");
        assert!(!sentence.contains(['{', '}']), "debug output in: {sentence}");
    }
}

pub(crate) fn command(program: &str, arguments: &[&str]) -> Command {
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

pub(crate) fn run(program: &str, arguments: &[&str]) -> Done {
    Done::new(command(program, arguments).output().unwrap())
}

/// Waits for the end.
pub(crate) fn wait(child: Child) -> Done {
    Done::new(child.wait_with_output().unwrap())
}

/// A folder for one test.
pub(crate) struct Place(TempDir);

impl Place {
    pub(crate) fn new() -> Self {
        Self(TempDir::new_in(env!("CARGO_TARGET_TMPDIR")).unwrap())
    }

    pub(crate) fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_owned()
    }

    pub(crate) fn write(&self, name: &str, bytes: &[u8]) -> String {
        let path = self.path(name);
        fs::write(&path, bytes).unwrap();
        path
    }

    /// A scene that takes a second: `bench-small` on a grid twice as coarse.
    pub(crate) fn tiny(&self) -> String {
        self.tiny_with(8)
    }

    /// The same with so many particles to a cell.
    pub(crate) fn tiny_with(&self, particles_per_cell: u32) -> String {
        let mut scene = Scene::load("bench-small").unwrap().into_spec();
        scene.name = "tiny".into();
        scene.domain.cell_m *= 2.0;
        scene.time.substeps /= 2;
        scene.powder.particles_per_cell = particles_per_cell;
        self.write("tiny.toml", scene.to_toml().as_bytes())
    }

    /// A finished run of the tiny scene, without the look at smaller cells.
    pub(crate) fn tiny_run(&self, name: &str, epochs: u32) -> String {
        let folder = self.path(name);
        let arguments =
            ["run", &self.tiny(), "--no-refine", "--epochs", &epochs.to_string(), "--out", &folder];
        run(OPTIMISE, &arguments).finished();
        folder
    }
}

/// A file of a run.
pub(crate) fn bytes(folder: impl AsRef<OsStr>, file: &str) -> Vec<u8> {
    fs::read(Path::new(&folder).join(file)).unwrap()
}

/// The lines of `metrics.jsonl` as they are, but for the seconds.
pub(crate) fn metrics(folder: &str) -> Vec<String> {
    let text = String::from_utf8(bytes(folder, "metrics.jsonl")).unwrap();
    let timeless = |line: &str| {
        let (before, rest) = line.split_once(",\"cpu_seconds\":").unwrap();
        let (_, rest) = rest.split_once(",\"seconds\":").unwrap();
        let (_, after) = rest.split_once(',').unwrap();
        format!("{before}}},{after}")
    };
    text.lines().map(timeless).collect()
}

/// The same plan, metrics and curves, byte for byte.
#[track_caller]
pub(crate) fn assert_same_bits(one: &str, other: &str) {
    assert_eq!(metrics(one), metrics(other));
    for file in ["skill.plan", "curves.svg", "scene.toml"] {
        assert!(bytes(one, file) == bytes(other, file), "{file} of {one} and of {other} differ");
    }
}
