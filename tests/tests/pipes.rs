//! Readers that go away before a program has said everything, as in `| head`.

#![cfg(unix)]

use std::io::{PipeWriter, pipe};
use std::path::Path;

use crate::programs::{Done, EXECUTE, FIRMWARE_SIM, OPTIMISE, Place, command, wait};

/// A pipe that nobody reads.
fn closed() -> PipeWriter {
    pipe().unwrap().1
}

fn unread(program: &str, arguments: &[&str]) -> Done {
    wait(command(program, arguments).stdout(closed()).spawn().unwrap())
}

#[test]
fn a_closed_pipe_is_no_failure_that_anybody_is_told_of() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.tiny_run("run", 0));
    // An arm that moves, and help, are none the worse for it; 141 is what a shell has for a program that ends of this.
    for (program, arguments, code) in [
        (OPTIMISE, &["check", "bench-small"][..], 141),
        (OPTIMISE, &["check", "bench-small", "--json"], 141),
        (OPTIMISE, &["inspect", &plan], 141),
        (OPTIMISE, &["scenes"], 141),
        (OPTIMISE, &["simulate", "--plan", &plan], 141),
        (OPTIMISE, &["--help"], 0),
        (OPTIMISE, &["check", "bnch", "--json"], 2),
        (EXECUTE, &[&plan], 0),
        (EXECUTE, &[&plan, "--json"], 0),
        (EXECUTE, &[&plan, "--dry-run"], 0),
        (EXECUTE, &["--help"], 0),
        (FIRMWARE_SIM, &["storm", "--seed", "3"], 141),
        (FIRMWARE_SIM, &["storm", "--seeds", "0..4", "--json"], 141),
        (FIRMWARE_SIM, &["storm", "--seeds", "0..1000000", "--table"], 141),
        (FIRMWARE_SIM, &["--help"], 0),
    ] {
        let done = unread(program, arguments);
        assert_eq!(done.code, Some(code), "{arguments:?}: {done:?}");
        assert_eq!(done.err.is_empty(), code != 2, "{arguments:?}: {done:?}");
    }
}

#[test]
fn a_run_that_nobody_watches_any_more_comes_to_its_plan() {
    let place = Place::new();
    let folder = place.path("run");
    let arguments = ["run", &place.tiny(), "--no-refine", "--epochs", "1", "--out", &folder];
    let both = closed();
    let status =
        command(OPTIMISE, &arguments).stdout(both.try_clone().unwrap()).stderr(both).status().unwrap();
    assert_eq!(status.code(), Some(141));
    assert!(Path::new(&folder).join("skill.plan").is_file());
}

#[test]
fn errors_keep_their_exit_codes_when_nobody_reads_them() {
    for (program, arguments, code) in [
        (OPTIMISE, &["inspect", "missing.plan"][..], 2),
        (EXECUTE, &["missing.plan", "--json"], 3),
        (FIRMWARE_SIM, &["--on", "sim"], 1),
    ] {
        let both = closed();
        let status =
            command(program, arguments).stdout(both.try_clone().unwrap()).stderr(both).status().unwrap();
        assert_eq!(status.code(), Some(code), "{arguments:?}");
    }
}
