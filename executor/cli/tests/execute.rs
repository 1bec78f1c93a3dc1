//! The program, from outside.

mod common;

use std::fs::{self, File};
use std::path::Path;
use std::process::{Command, Output};

use common::{header, one_move, plan_bytes};
use powderline_shared::limits::Limits;
use powderline_shared::plan::{FORMAT_VERSION, MAX_FILE_BYTES, PlanHeader};
use serde_json::Value;
use tempfile::TempDir;

fn execute(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_execute")).args(arguments).output().unwrap()
}

fn path(dir: &TempDir, name: &str) -> String {
    dir.path().join(name).to_str().unwrap().to_owned()
}

fn written(dir: &TempDir, name: &str, bytes: &[u8]) -> String {
    let path = path(dir, name);
    fs::write(&path, bytes).unwrap();
    path
}

fn good_plan() -> Vec<u8> {
    plan_bytes(&header(), &one_move())
}

/// The one JSON object on standard output.
fn json(output: &Output) -> Value {
    let text = str::from_utf8(&output.stdout).unwrap();
    assert_eq!(text.trim_end().lines().count(), 1, "{text}");
    serde_json::from_str(text).unwrap()
}

/// Exit code 3 and one sentence on standard error that holds all of `words`; the same as JSON.
fn assert_refused(plan: &str, words: &[&str]) {
    let output = execute(&[plan]);
    let error = str::from_utf8(&output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(3), "{error}");
    assert!(output.stdout.is_empty());
    assert_eq!(error.trim_end().lines().count(), 1, "{error}");
    assert!(!error.contains("panicked"));
    for word in words.iter().chain([&plan]) {
        assert!(error.contains(word), "\"{word}\" is missing in: {error}");
    }
    let output = execute(&[plan, "--json"]);
    let object = json(&output);
    assert_eq!((output.status.code(), &object["exit_code"]), (Some(3), &Value::from(3)));
    assert!(error.contains(object["error"].as_str().unwrap()));
}

#[test]
fn a_good_plan_is_performed() {
    let dir = TempDir::new().unwrap();
    let plan = written(&dir, "skill.plan", &good_plan());
    let output = execute(&[&plan]);
    let text = str::from_utf8(&output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0), "{text}");
    for words in ["120 steps of 10 ms", "Completed: 120 of 120 ticks", "within half a count", "peak use"] {
        assert!(text.contains(words), "\"{words}\" is missing in: {text}");
    }
    assert!(output.stderr.is_empty());
}

#[test]
fn haste_that_breaks_a_limit_is_not_laid_to_the_wire() {
    let dir = TempDir::new().unwrap();
    let plan = written(&dir, "skill.plan", &good_plan());
    let output = execute(&[&plan, "--rate", "2000"]);
    let error = str::from_utf8(&output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(6), "{error}");
    assert!(
        error.contains("cannot be played 20.00 times as fast as it was planned: with --rate 2000 the"),
        "{error}"
    );
    assert!(error.trim_end().ends_with("; its own rate is 100") && !error.contains("rounded"), "{error}");
}

#[test]
fn json_is_one_object_with_the_facts() {
    let dir = TempDir::new().unwrap();
    let plan = written(&dir, "skill.plan", &good_plan());
    let output = execute(&[&plan, "--json"]);
    assert_eq!(output.status.code(), Some(0));
    let report = json(&output);
    assert_eq!(report["completed"], true);
    assert_eq!(report["within_half_lsb"], true);
    assert_eq!((&report["stop"], &report["standstill"]), (&Value::Null, &Value::from(true)));
    assert_eq!(report["ticks"]["applied"], 120);
    assert_eq!(report["plan"]["predicted"]["census"]["target"], 850);
    assert_eq!(report["final_pose"], report["plan_end_pose"]);
    assert!(report["peak_use_percent"]["linear_velocity"].as_f64().unwrap() > 10.0);
}

#[test]
fn under_the_wall_clock_the_arm_ends_at_the_same_bits() {
    let dir = TempDir::new().unwrap();
    let mut moves = one_move();
    moves[0].steps = 60;
    moves[0].translation_m = [0.01; 3];
    moves[0].rotation_rad = [0.0, 0.1, 0.0];
    let plan = written(&dir, "skill.plan", &plan_bytes(&header(), &moves));
    let (virtual_time, wall_clock) =
        (json(&execute(&[&plan, "--json"])), json(&execute(&[&plan, "--json", "--realtime"])));
    assert_eq!(virtual_time["final_pose"], wall_clock["final_pose"]);
    assert!(wall_clock["jitter"]["max_us"].is_number() && virtual_time["jitter"].is_null());
}

#[test]
fn files_that_are_no_plans_are_refused_in_one_sentence() {
    let dir = TempDir::new().unwrap();
    assert_refused(&path(&dir, "missing.plan"), &["no such file"]);
    assert_refused(dir.path().to_str().unwrap(), &["directory", "plan file"]);
    assert_refused(&written(&dir, "empty", b""), &["empty"]);
    assert_refused(&written(&dir, "short", b"PWD"), &["3 bytes", "14"]);
    assert_refused(&written(&dir, "scene.toml", b"name = \"bench\"\n"), &["begins with", "PWDLPLAN"]);
    assert_refused(&written(&dir, "binary", &[0xa5; 100_000]), &["begins with"]);
    let good = good_plan();
    assert_refused(&written(&dir, "cut", &good[..good.len() / 2]), &["checksum", "cut short"]);
    let mut flipped = good.clone();
    flipped[200] ^= 4;
    assert_refused(&written(&dir, "flipped", &flipped), &["checksum", "damaged"]);
    let mut future = good;
    future[8] = 9;
    assert_refused(&written(&dir, "future", &future), &["version 9", &format!("version {FORMAT_VERSION}")]);
}

#[test]
fn a_huge_file_is_refused_unread() {
    let dir = TempDir::new().unwrap();
    let huge = path(&dir, "huge.plan");
    File::create(&huge).unwrap().set_len(1 << 30).unwrap();
    assert_refused(&huge, &["1073741824 bytes", &MAX_FILE_BYTES.to_string()]);
}

#[test]
#[cfg(unix)]
fn a_device_is_refused() {
    if Path::new("/dev/zero").exists() {
        assert_refused("/dev/zero", &["not a regular file"]);
    }
}

#[test]
fn a_plan_that_breaks_its_own_limits_is_refused_with_the_numbers() {
    let dir = TempDir::new().unwrap();
    let limits = Limits { linear_velocity_m_s: 0.1, ..header().limits };
    let bytes = plan_bytes(&PlanHeader { limits, ..header() }, &one_move());
    assert_refused(&written(&dir, "fast.plan", &bytes), &["linear velocity", "tick", "0.1 m/s"]);
}

#[test]
fn a_plan_too_fast_for_the_arm_is_a_fault_with_its_reason() {
    let dir = TempDir::new().unwrap();
    let limits = Limits {
        linear_velocity_m_s: 100.0,
        linear_acceleration_m_s2: 1e3,
        linear_jerk_m_s3: 1e5,
        angular_velocity_rad_s: 100.0,
        angular_acceleration_rad_s2: 1e3,
        angular_jerk_rad_s3: 1e5,
        ..header().limits
    };
    let mut moves = one_move();
    moves[0].steps = 10;
    let plan = written(&dir, "fast.plan", &plan_bytes(&PlanHeader { limits, ..header() }, &moves));
    let output = execute(&[&plan, "--json"]);
    let report = json(&output);
    assert_eq!(output.status.code(), Some(1), "{report}");
    assert_eq!(
        (&report["completed"], &report["within_half_lsb"]),
        (&Value::from(false), &Value::from(false))
    );
    assert!((301..=307).contains(&report["stop"]["code"].as_u64().unwrap()), "{report}");
    assert!(report["stop"]["detail"].as_str().unwrap().contains("but the limit is"), "{report}");
    let text = execute(&[&plan]);
    assert!(str::from_utf8(&text.stdout).unwrap().contains("Stopped at tick"));
}

#[test]
fn wrong_usage_is_exit_code_2() {
    assert_eq!(execute(&[]).status.code(), Some(2));
    assert_eq!(execute(&["a", "b"]).status.code(), Some(2));
    assert_eq!(execute(&["a", "--nonsense"]).status.code(), Some(2));
    let help = execute(&["--help"]);
    assert_eq!(help.status.code(), Some(0));
    assert!(str::from_utf8(&help.stdout).unwrap().contains("Exit codes"));
}

#[test]
fn it_says_its_own_name() {
    assert!(str::from_utf8(&execute(&["--version"]).stdout).unwrap().starts_with("execute 0."));
    for arguments in [&[][..], &["a", "--nonsense"]] {
        let error = execute(arguments).stderr;
        assert!(str::from_utf8(&error).unwrap().contains("Usage: execute "), "{error:?}");
    }
}

#[test]
fn a_shell_and_a_reader_get_what_they_want_to_know_without_a_plan() {
    let script = execute(&["--completions", "bash"]);
    assert!(str::from_utf8(&script.stdout).unwrap().contains("--look-ahead"));
    let dir = TempDir::new().unwrap();
    let folder = path(&dir, "man1");
    assert_eq!(execute(&["--man", &folder]).status.code(), Some(0));
    let page = fs::read_to_string(format!("{folder}/execute.1")).unwrap();
    assert!(page.contains(".TH execute") && page.contains("Exit codes"), "{page}");
    assert_eq!(execute(&["--man", &folder, "a.plan"]).status.code(), Some(2));
    assert_eq!(execute(&["--completions", "dosh"]).status.code(), Some(2));
}

#[test]
#[cfg(unix)]
fn a_standard_error_that_cannot_be_written_changes_nothing() {
    let Ok(full) = File::options().write(true).open("/dev/full") else { return };
    let mut command = Command::new(env!("CARGO_BIN_EXE_execute"));
    let output = command.args(["missing.plan", "--json"]).stderr(full).output().unwrap();
    assert_eq!((output.status.code(), &json(&output)["exit_code"]), (Some(3), &Value::from(3)));
}

#[test]
#[cfg(unix)]
fn ctrl_c_is_a_controlled_stop() {
    use std::io::{BufRead, BufReader, Read};
    use std::process::Stdio;

    let dir = TempDir::new().unwrap();
    let mut moves = one_move();
    moves[0].steps = 3_000;
    let plan = written(&dir, "long.plan", &plan_bytes(&header(), &moves));
    let mut child = Command::new(env!("CARGO_BIN_EXE_execute"))
        .args([&plan, "--realtime"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut out = BufReader::new(child.stdout.take().unwrap());
    let mut text = String::new();
    while !text.lines().last().unwrap_or_default().starts_with("Playing") {
        assert_ne!(out.read_line(&mut text).unwrap(), 0, "{text}");
    }
    // `kill` as a shell has it built in; a program of that name is not everywhere.
    let process = child.id().to_string();
    assert!(Command::new("sh").args(["-c", "kill -INT \"$0\"", &process]).status().unwrap().success());
    out.read_to_string(&mut text).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(4), "{text}");
    assert!(text.contains("Stopped at tick") && text.contains("(fault 501)"), "{text}");
}

/// What was recorded before stays until there is something to be told of another session.
#[test]
fn a_record_of_before_outlives_a_wire_that_is_not_there() {
    let dir = TempDir::new().unwrap();
    let plan = written(&dir, "skill.plan", &good_plan());
    let record = written(&dir, "record.log", b"what happened before");
    for (to, code, words) in [
        ("serial:/dev/nowhere", 6, "/dev/nowhere"),
        ("pty", 6, "pty is what firmware-sim opens"),
        ("sim", 5, "is for an arm on a wire"),
    ] {
        let output = execute(&[&plan, "--to", to, "--record", &record]);
        let error = str::from_utf8(&output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{error}");
        assert!(error.contains(words), "\"{words}\" is missing in: {error}");
        assert_eq!(fs::read(&record).unwrap(), b"what happened before");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2, "{to}");
    }
}

#[test]
fn a_dry_run_says_what_it_has_looked_at() {
    let dir = TempDir::new().unwrap();
    let plan = written(&dir, "skill.plan", &good_plan());
    for to in ["sim", "serial:/dev/nowhere"] {
        let output = execute(&[&plan, "--to", to, "--dry-run"]);
        let text = str::from_utf8(&output.stdout).unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", str::from_utf8(&output.stderr).unwrap());
        assert!(text.ends_with("; no wire was opened, and nothing was sent.\n"), "{text}");
    }
    let output = execute(&[&plan, "--to", "serial:/dev/nowhere", "--dry-run", "--rate", "2000"]);
    assert_eq!(output.status.code(), Some(6));
}
