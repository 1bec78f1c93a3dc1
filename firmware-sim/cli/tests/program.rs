//! The program, from outside.

use std::io::{BufRead, BufReader, Read};
use std::process::{Command, Output, Stdio};

use serde_json::{Value, json};

fn firmware_sim(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_firmware-sim")).args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> &str {
    str::from_utf8(bytes).unwrap()
}

/// The one JSON object on standard output.
fn object(output: &Output) -> Value {
    let text = text(&output.stdout);
    assert_eq!(text.lines().count(), 1, "{text}");
    serde_json::from_str(text).unwrap()
}

#[test]
fn it_says_its_own_name() {
    assert!(text(&firmware_sim(&["--version"]).stdout).starts_with("firmware-sim 0."));
    assert!(text(&firmware_sim(&["--help"]).stdout).contains("Usage: firmware-sim [OPTIONS]"));
    assert!(text(&firmware_sim(&["storm", "--sed", "1"]).stderr).contains("Usage: firmware-sim storm "));
}

#[test]
fn a_storm_is_one_object() {
    let report = object(&firmware_sim(&["storm", "--seeds", "0..20", "--json"]));
    assert_eq!((&report["runs"], &report["breach_count"]), (&20.into(), &0.into()));
    assert_eq!(report["endings"].as_object().unwrap().values().map(|n| n.as_u64().unwrap()).sum::<u64>(), 20);
    let replayed = object(&firmware_sim(&["storm", "--seed", "3", "--json"]));
    let said = firmware_sim(&["storm", "--seed", "3"]);
    let log: Vec<&str> = text(&said.stdout).lines().collect();
    assert!(log.len() > 100);
    assert_eq!(replayed, json!({ "seed": 3, "breaches": [], "log": log }));
    let table = object(&firmware_sim(&["storm", "--table", "--seeds", "0..1", "--json"]));
    let rows = table["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 2 * 5 * 5);
    assert!(rows.iter().all(|row| row["runs"] == 1 && row["completed"].as_u64() <= Some(1)), "{table}");
}

#[test]
fn one_run_is_no_plural() {
    let said = firmware_sim(&["storm", "--seeds", "0..1"]);
    let first = text(&said.stdout).lines().next().unwrap();
    assert!(first.starts_with("1 run, ") && first.ends_with(" seconds of simulated time"), "{first}");
}

#[test]
fn a_failure_is_an_object_too() {
    let output = firmware_sim(&["--on", "serial:/nowhere", "--json"]);
    let object = object(&output);
    assert_eq!((output.status.code(), &object["exit_code"]), (Some(1), &1.into()));
    let said = text(&output.stderr).trim_end();
    assert_eq!(said, format!("firmware-sim: {}", object["error"].as_str().unwrap()));
    assert!(said.contains("/nowhere"), "{said}");
}

#[test]
#[cfg(unix)]
fn an_arm_that_is_asked_for_an_object_speaks_elsewhere() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_firmware-sim"))
        .args(["--on", "pty", "--json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let (mut first, mut out) = (String::new(), String::new());
    BufReader::new(child.stderr.take().unwrap()).read_line(&mut first).unwrap();
    assert!(first.contains("listens on serial:"), "{first}");
    // `kill` as a shell has it built in; a program of that name is not everywhere.
    let process = child.id().to_string();
    assert!(Command::new("sh").args(["-c", "kill -INT \"$0\"", &process]).status().unwrap().success());
    child.stdout.take().unwrap().read_to_string(&mut out).unwrap();
    assert_eq!((child.wait().unwrap().code(), out.as_str()), (Some(0), "{\"motions\":[]}\n"));
}

#[test]
fn a_shell_and_a_reader_get_what_they_want_to_know() {
    assert!(text(&firmware_sim(&["completions", "fish"]).stdout).contains("storm"));
    let folder = tempfile::tempdir().unwrap();
    let output = firmware_sim(&["man", folder.path().to_str().unwrap()]);
    let pages: Vec<&str> = text(&output.stdout).lines().collect();
    assert!(pages.iter().all(|page| std::fs::read_to_string(page).unwrap().contains(".TH")), "{pages:?}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), pages.len());
}
