//! What the programs say to type next, typed.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::programs::{EXECUTE, OPTIMISE, Place};

/// The programs under the names that they are installed by, in a folder that a shell has to be careful with.
fn installed(place: &Place) -> String {
    let folder = place.path("my programs");
    fs::create_dir(&folder).unwrap();
    for (file, name) in [(OPTIMISE, "optimise"), (EXECUTE, "execute")] {
        fs::hard_link(file, Path::new(&folder).join(name)).unwrap();
    }
    folder
}

#[cfg(unix)]
#[test]
fn what_is_said_to_type_next_can_be_typed() {
    let place = Place::new();
    let (folder, scene) = (installed(&place), place.tiny());
    let path = format!("{folder}:{}", std::env::var("PATH").unwrap());
    let program = format!("{folder}/optimise");
    for (on_path, begins) in [(false, "'"), (true, "execute ")] {
        let run = if on_path { "a run" } else { "run" };
        let mut first = Command::new(&program);
        first.args([&scene, "--no-refine", "--epochs", "0", "--out", &place.path(run)]);
        if on_path {
            first.env("PATH", &path);
        }
        let said = String::from_utf8(first.output().unwrap().stdout).unwrap();
        let next = said.lines().last().unwrap().trim();
        assert!(next.starts_with(begins), "{next}");
        let mut typed = Command::new("sh");
        typed.args(["-c", &format!("{next} --json")]).current_dir("/");
        if on_path {
            typed.env("PATH", &path);
        }
        let played: Value = serde_json::from_slice(&typed.output().unwrap().stdout).unwrap();
        assert_eq!(played["completed"], true, "{next}");
    }
}
