//! Executor and arm as two programs on a real wire: a pseudo-terminal anywhere, SocketCAN where there is one.
//!
//! The ignored tests, `vcan_..`, need the interface `vcan0`. `tests/run` runs them inside `tests/tools/with-vcan`;
//! elsewhere they are ignored, and fail when they are asked for all the same.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

use powderline_firmware_sim::controller::ArmConfig;
use powderline_firmware_sim_cli::link::motion::{Move, plan_bytes};
use powderline_firmware_sim_cli::serve::bench_start;
use powderline_host::candump::{self, Content};
use powderline_shared::displacement::pose_at;
use powderline_shared::plan::PlanReader;
use powderline_shared::pose::norm;
use powderline_shared::trajectory::TrajectoryReader;
use serde_json::Value;
use tempfile::TempDir;

use crate::programs::{EXECUTE, FIRMWARE_SIM};

/// Nothing here takes longer.
const PATIENCE: Duration = Duration::from_secs(60);

/// Ticks of the plan.
const TICKS: u32 = 60;

/// Control period: slow, for the machine that tests may be slower still.
const PERIOD_US: u32 = 40_000;

/// Up, tilting, and down again, within reach of the arm at the bench.
fn plan(dir: &Path) -> PathBuf {
    let part = |sign: f64| Move {
        translation_m: [sign * 0.03, 0.0, sign * 0.04],
        rotation_rad: [0.0, sign * 0.3, 0.0],
        steps: TICKS / 2,
    };
    let path = dir.join("skill.plan");
    let limits = ArmConfig::ideal(bench_start()).limits;
    fs::write(&path, plan_bytes(&bench_start(), limits, PERIOD_US, &[part(1.0), part(-1.0)])).unwrap();
    path
}

/// A thousand setpoints a second.
fn fine_plan(dir: &Path) -> PathBuf {
    let path = dir.join("fine.plan");
    let limits = ArmConfig::ideal(bench_start()).limits;
    let rest = Move { translation_m: [0.0; 3], rotation_rad: [0.0; 3], steps: 10 };
    fs::write(&path, plan_bytes(&bench_start(), limits, 1_000, &[rest])).unwrap();
    path
}

/// A program whose lines are read as they come; ended with the test.
struct Program {
    child: Child,
    lines: Receiver<String>,
    heard: Vec<String>,
}

impl Program {
    fn start(program: &str, arguments: &[&str]) -> Self {
        let mut child = Command::new(program)
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .spawn()
            .unwrap();
        let lines = lines_of(child.stdout.take().unwrap());
        Self { child, lines, heard: Vec::new() }
    }

    /// Waits for a line that holds `words`.
    #[track_caller]
    fn says(&mut self, words: &str) -> String {
        let until = Instant::now() + PATIENCE;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            match self.lines.recv_timeout(left) {
                Ok(line) => self.heard.push(line.clone()),
                Err(error) => panic!("\"{words}\" was never said ({error}): {:#?}", self.heard),
            }
            let line = self.heard.last().unwrap();
            if line.contains(words) {
                return line.clone();
            }
        }
    }

    /// Waits for the end; the exit code and all lines.
    fn ends(mut self) -> (Option<i32>, String) {
        let code = self.child.wait().unwrap().code();
        self.heard.extend(self.lines.iter());
        (code, std::mem::take(&mut self.heard).join("\n"))
    }

    fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A program of can-utils; ended with the test, or it would disturb the next one.
struct Tool(Child);

impl Tool {
    fn start(command: &mut Command) -> Self {
        Self(command.spawn().unwrap())
    }

    /// Asked to end, candump writes out what it holds; killed, it would not.
    fn interrupt(&mut self) {
        let interrupt = format!("kill -INT {}", self.0.id());
        assert!(Command::new("sh").args(["-c", &interrupt]).status().unwrap().success());
        self.0.wait().unwrap();
    }
}

impl Drop for Tool {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn lines_of(out: ChildStdout) -> Receiver<String> {
    let (sender, receiver) = channel();
    thread::spawn(move || {
        for line in BufReader::new(out).lines().map_while(Result::ok) {
            if sender.send(line).is_err() {
                return;
            }
        }
    });
    receiver
}

/// The arm, listening; and where.
fn arm(on: &str, more: &[&str]) -> (Program, String) {
    let mut arm = Program::start(
        FIRMWARE_SIM,
        &[&["--on", on, "--watchdog", "2000", "--priority", "0"], more].concat(),
    );
    let line = arm.says("listens on ");
    let wire = line.split("listens on ").nth(1).and_then(|rest| rest.split(';').next()).unwrap().to_owned();
    (arm, wire)
}

fn execute(plan: &Path, to: &str, more: &[&str]) -> Program {
    let arguments = [plan.to_str().unwrap(), "--to", to, "--arm-timeout", "2000", "--priority", "0"];
    Program::start(EXECUTE, &[&arguments, more].concat())
}

/// The last line, one JSON object.
#[track_caller]
fn json(program: Program, code: i32) -> Value {
    let (found, out) = program.ends();
    assert_eq!(found, Some(code), "{out}");
    serde_json::from_str(&out).unwrap()
}

/// The machine that tests held the arm's program up for so long that the arm stopped for that: rightly, and not what is
/// tested.
struct HeldUp;

/// The fault of an arm that was held up.
const HELD_UP: u32 = 132;

/// Tries again where the machine is busy; not for ever.
#[track_caller]
fn unless_held_up(scenario: impl Fn() -> Result<(), HeldUp>) {
    let done = (1..=4).any(|attempt| {
        let done = scenario().is_ok();
        if !done {
            eprintln!("attempt {attempt}: this machine held the arm up, which stopped for that");
        }
        done
    });
    assert!(done, "this machine is too busy for an arm");
}

fn assert_played(on: &str) {
    unless_held_up(|| played(on));
}

#[track_caller]
fn played(on: &str) -> Result<(), HeldUp> {
    let dir = TempDir::new().unwrap();
    let (plan, executed) = (plan(dir.path()), dir.path().join("executed.txt"));
    let (mut arm, wire) = arm(on, &["--once", "--executed", executed.to_str().unwrap()]);
    let (code, out) = execute(&plan, &wire, &["--json"]).ends();
    let report: Value = serde_json::from_str(&out).unwrap();
    if report["stop"]["code"] == HELD_UP {
        return Err(HeldUp);
    }
    assert_eq!(code, Some(0), "{out}");
    assert_eq!((&report["completed"], &report["within_half_lsb"]), (&Value::from(true), &Value::from(true)));
    assert_eq!(
        (&report["ticks"]["applied"], &report["standstill"]),
        (&Value::from(TICKS), &Value::from(true))
    );
    arm.says("holding the last setpoint");
    arm.says("State: ready to switch on");
    assert_eq!(arm.ends().0, Some(0));
    assert_tracked(on, &plan, &executed, &report["stream"]);
    Ok(())
}

/// What the executor says of an arm that lags is what the arm has written of its motion, but for the counts of the wire.
#[track_caller]
fn assert_tracked(on: &str, plan: &Path, executed: &Path, stream: &Value) {
    let plan = fs::read(plan).unwrap();
    let plan = PlanReader::new(&plan).unwrap();
    let (start, lsb) = (plan.header().start_pose(), plan.header().lsb);
    let mut reader = TrajectoryReader::default();
    let text = fs::read_to_string(executed).unwrap();
    let made = text.lines().filter_map(|line| reader.line(line.as_bytes()).unwrap()).skip(1);
    let off: Vec<_> = made
        .zip(plan.setpoints())
        .map(|(sample, setpoint)| pose_at(&start, setpoint, lsb).displacement_to(&sample.pose))
        .collect();
    assert_eq!((off.len(), &stream["tracked"]), (TICKS as usize, &Value::from(TICKS)));
    let off_m = off.iter().map(|off| norm(&off.translation())).fold(0.0, f64::max);
    let off_rad = off.iter().map(|off| norm(&off.rotation())).fold(0.0, f64::max);
    assert!(off_m > 1e-4 && off_rad > 1e-3, "the arm must lag: {off_m} m, {off_rad} rad");
    let [said_m, said_rad] = ["tracking_m", "tracking_rad"].map(|key| stream[key].as_f64().unwrap());
    // A report's counts.
    let [count_m, count_rad] = if on.starts_with("can:") { [1e-6, 1e-5] } else { [1e-7, 1e-7] };
    assert!((said_m - off_m).abs() <= 2.0 * count_m, "{said_m} m said, {off_m} m off");
    assert!((said_rad - off_rad).abs() <= 2.0 * count_rad, "{said_rad} rad said, {off_rad} rad off");
}

#[test]
fn a_plan_is_played_over_a_pseudo_terminal() {
    assert_played("pty");
}

/// A file with a key, and one with another.
fn keys(dir: &Path) -> [String; 2] {
    let (ours, other) = (dir.join("key"), dir.join("other"));
    fs::write(&ours, [0xA7; 32]).unwrap();
    fs::write(&other, "0123456789abcdef".repeat(4)).unwrap();
    [ours, other].map(|path| path.to_str().unwrap().to_owned())
}

#[test]
fn a_plan_is_played_with_a_key() {
    assert_played_with_a_key("pty");
}

fn assert_played_with_a_key(on: &str) {
    unless_held_up(|| {
        let dir = TempDir::new().unwrap();
        let (plan, [key, _]) = (plan(dir.path()), keys(dir.path()));
        let (mut arm, wire) = arm(on, &["--once", "--key", &key]);
        arm.says("It moves only for whoever has the key");
        let (code, out) = execute(&plan, &wire, &["--json", "--key", &key]).ends();
        let report: Value = serde_json::from_str(&out).unwrap();
        if report["stop"]["code"] == HELD_UP {
            return Err(HeldUp);
        }
        assert_eq!((code, &report["within_half_lsb"]), (Some(0), &Value::from(true)), "{out}");
        assert_eq!(arm.ends().0, Some(0));
        Ok(())
    });
}

#[test]
fn both_ends_say_that_their_keys_differ() {
    assert_keys_that_differ_are_told("pty");
}

fn assert_keys_that_differ_are_told(on: &str) {
    let dir = TempDir::new().unwrap();
    let (plan, [key, other]) = (plan(dir.path()), keys(dir.path()));
    for (own, arms, words) in [
        (Some(&other), Some(&key), "the arm has another key; both ends need the same --key FILE"),
        (None, Some(&key), "the arm has a key and was asked without; give --key FILE with the same"),
        (Some(&key), None, "the arm has no key and was asked with one; start it with the same --key FILE"),
    ] {
        let with = |key: Option<&String>| key.map_or(vec![], |key| vec!["--key".to_owned(), key.clone()]);
        let (own, arms) = (with(own), with(arms));
        let more: Vec<&str> = arms.iter().map(String::as_str).collect();
        let (mut arm, wire) = arm(on, &more);
        let more: Vec<&str> = own.iter().map(String::as_str).chain(["--json"]).collect();
        let report = json(execute(&plan, &wire, &more), 1);
        assert_eq!(
            (&report["stop"]["code"], &report["stop"]["detail"]),
            (&Value::from(401), &Value::from(words))
        );
        assert!(arm.says("is refused").ends_with(&format!("{words}.")));
    }
}

/// Half of a key opens a session, and gets no further: the arm is not silent, it is not believed.
#[test]
fn half_a_key_is_not_taken_for_an_arm_that_does_not_answer() {
    assert_half_a_key_is_told("pty", 404);
}

fn assert_half_a_key_is_told(on: &str, code: u16) {
    let dir = TempDir::new().unwrap();
    let (plan, [key, _]) = (plan(dir.path()), keys(dir.path()));
    let half = dir.path().join("half");
    fs::write(&half, [[0xA7; 16], [0xA8; 16]].concat()).unwrap();
    let (_arm, wire) = arm(on, &["--key", &key]);
    let report = json(execute(&plan, &wire, &["--json", "--key", half.to_str().unwrap()]), 1);
    assert_eq!(report["stop"]["code"], code, "{report}");
    let dropped = report["frames"]["wrong_tags"].as_u64().unwrap();
    let words = format!("{dropped} frames with a wrong tag were dropped; both ends need the same --key FILE");
    assert!(dropped >= 8 && report["stop"]["detail"] == words, "{report}");
}

#[test]
fn files_that_hold_no_key_are_refused_in_one_sentence() {
    let dir = TempDir::new().unwrap();
    let plan = plan(dir.path());
    let (short, pipe) = (dir.path().join("short"), dir.path().join("pipe"));
    fs::write(&short, [1; 31]).unwrap();
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    for (key, words) in [
        (short.to_str().unwrap(), "it has 31 bytes, and not 32, or 64 hexadecimal digits"),
        (pipe.to_str().unwrap(), "not a regular file"),
        ("/dev/zero", "not a regular file"),
        ("missing", "No such file"),
    ] {
        let plan = plan.to_str().unwrap();
        for (program, arguments, code) in [
            (EXECUTE, &[plan, "--to", "serial:/dev/null", "--key", key][..], 5),
            (FIRMWARE_SIM, &["--on", "pty", "--key", key], 1),
        ] {
            let output = Command::new(program).args(arguments).output().unwrap();
            let error = String::from_utf8(output.stderr).unwrap();
            assert_eq!(output.status.code(), Some(code), "{error}");
            assert!(error.trim_end().lines().count() == 1, "{error}");
            assert!(error.contains(key) && error.contains(words), "{error}");
        }
    }
    let [key, _] = keys(dir.path());
    let output = Command::new(EXECUTE).args([plan.to_str().unwrap(), "--key", &key]).output().unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(error.contains("is for an arm on a wire; give --to WIRE too"), "{error}");
}

#[test]
fn an_executor_that_is_killed_leaves_an_arm_that_stops_and_must_be_reset() {
    assert_survives_a_killed_executor("pty");
}

fn assert_survives_a_killed_executor(on: &str) {
    unless_held_up(|| survives_a_killed_executor(on));
}

#[track_caller]
fn survives_a_killed_executor(on: &str) -> Result<(), HeldUp> {
    let dir = TempDir::new().unwrap();
    let plan = plan(dir.path());
    let (mut arm, wire) = arm(on, &[]);
    let mut first = execute(&plan, &wire, &["--json"]);
    arm.says("following setpoints");
    thread::sleep(Duration::from_millis(800));
    first.kill();
    let reason = arm.says("Stopping: fault ");
    if reason.contains(&format!("fault {HELD_UP}")) {
        return Err(HeldUp);
    }
    assert!(reason.contains("fault 101") || reason.contains("fault 131"), "{reason}");
    arm.says("State: fault.");
    arm.says("At rest after");
    let report = json(execute(&plan, &wire, &["--json"]), 1);
    assert_eq!(report["stop"]["code"], 401);
    assert!(
        report["stop"]["detail"].as_str().unwrap().contains("then --reset takes it out of that"),
        "{report}"
    );
    // After a reset it is the anchor that is wrong: nothing moves the arm back by itself.
    let report = json(execute(&plan, &wire, &["--json", "--reset"]), 1);
    assert_eq!(report["stop"]["code"], 402, "{report}");
    let from = report["reset_from"].as_str().unwrap();
    assert!(from.starts_with("fault 101 at tick ") || from.starts_with("fault 131 at tick "), "{report}");
    Ok(())
}

#[test]
fn wires_that_cannot_be_used_are_refused_in_one_sentence() {
    let dir = TempDir::new().unwrap();
    let plan = plan(dir.path());
    for (wire, words) in [
        ("serial:/dev/does-not-exist", "/dev/does-not-exist"),
        ("serial:/dev/null@9600", "too slow for 1000 setpoints a second"),
        ("can:does-not-exist", "does-not-exist"),
    ] {
        let fine = fine_plan(dir.path());
        let plan = if wire.contains("9600") { &fine } else { &plan };
        let output = Command::new(EXECUTE).args([plan.to_str().unwrap(), "--to", wire]).output().unwrap();
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(6), "{wire}: {error}");
        assert!(error.trim_end().lines().count() == 1 && error.contains(words), "{wire}: {error}");
    }
    let output = Command::new(EXECUTE).args([plan.to_str().unwrap(), "--to", "usb:3"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn a_rate_at_which_a_plan_breaks_its_limits_is_refused_before_anything_is_sent() {
    let dir = TempDir::new().unwrap();
    let plan = plan(dir.path());
    let output = Command::new(EXECUTE)
        .args([plan.to_str().unwrap(), "--to", "can:vcan0", "--rate", "1000"])
        .output()
        .unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(6), "{error}");
    assert!(
        error.contains("40.00 times as fast as it was planned") && error.contains("the limit is"),
        "{error}"
    );
}

// --- SocketCAN ---

fn ip(arguments: &str) {
    let status = Command::new("ip").args(arguments.split_whitespace()).status().unwrap();
    assert!(status.success(), "ip {arguments}");
}

#[test]
#[ignore = "needs vcan0: run by tests/run inside tests/tools/with-vcan"]
fn vcan_a_key_is_asked_for_over_classic_can_and_over_can_fd() {
    for on in ["can:vcan0", "canfd:vcan0"] {
        assert_played_with_a_key(on);
        assert_keys_that_differ_are_told(on);
    }
    // On 8 bytes it is taken for somebody who guesses.
    assert_half_a_key_is_told("can:vcan0", 411);
    assert_half_a_key_is_told("canfd:vcan0", 404);
}

#[test]
#[ignore = "needs vcan0: run by tests/run inside tests/tools/with-vcan"]
fn vcan_a_plan_is_played_over_classic_can_and_over_can_fd() {
    assert_played("can:vcan0");
    assert_played("canfd:vcan0");
}

#[test]
#[ignore = "needs vcan0: run by tests/run inside tests/tools/with-vcan"]
fn vcan_an_executor_that_is_killed_leaves_an_arm_that_stops_and_must_be_reset() {
    assert_survives_a_killed_executor("can:vcan0");
    assert_survives_a_killed_executor("canfd:vcan0");
}

#[test]
#[ignore = "needs vcan0: run by tests/run inside tests/tools/with-vcan"]
fn vcan_an_arm_that_is_killed_is_given_up() {
    let dir = TempDir::new().unwrap();
    let (mut arm, wire) = arm("can:vcan0", &[]);
    let executor = execute(&plan(dir.path()), &wire, &["--json"]);
    arm.says("following setpoints");
    arm.kill();
    let report = json(executor, 1);
    assert_eq!((&report["stop"]["code"], &report["standstill"]), (&Value::from(111), &Value::from(false)));
}

#[test]
#[ignore = "needs vcan0: run by tests/run inside tests/tools/with-vcan"]
fn vcan_an_interface_taken_down_stops_both_and_comes_back() {
    let dir = TempDir::new().unwrap();
    let plan = plan(dir.path());
    let (mut arm, wire) = arm("can:vcan0", &[]);
    let executor = execute(&plan, &wire, &["--json"]);
    arm.says("following setpoints");
    ip("link set vcan0 down");
    let report = json(executor, 1);
    assert_eq!((&report["stop"]["code"], &report["standstill"]), (&Value::from(112), &Value::from(false)));
    assert!(report["wire"].as_str().unwrap().contains("vcan0 is down"), "{report}");
    arm.says("Stopping: fault ");
    ip("link set vcan0 up");
    arm.says("The wire is there again");
    let report = json(execute(&plan, &wire, &["--json", "--reset"]), 1);
    assert_eq!(report["stop"]["code"], 402, "{report}");
}

/// A queue before the interface that lets next to nothing through.
struct Clogged;

impl Clogged {
    fn new() -> Self {
        tc("qdisc add dev vcan0 root tbf rate 8bit burst 20 limit 40");
        Self
    }
}

impl Drop for Clogged {
    fn drop(&mut self) {
        tc("qdisc del dev vcan0 root");
    }
}

fn tc(arguments: &str) {
    let status = Command::new("tc").args(arguments.split_whitespace()).status().unwrap();
    assert!(status.success(), "tc {arguments}");
}

/// How often a process has gone to sleep so far.
fn sleeps(process: &Child) -> u64 {
    let status = fs::read_to_string(format!("/proc/{}/status", process.id())).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("voluntary_ctxt_switches:"));
    line.unwrap().trim().parse().unwrap()
}

#[test]
#[ignore = "needs vcan0 and tc: run by tests/run inside tests/tools/with-vcan"]
fn vcan_a_bus_that_takes_nothing_is_not_waited_for_by_spinning() {
    let _clogged = Clogged::new();
    let (arm, _) = arm("can:vcan0", &[]);
    // Its reports, ten a second, soon find the queue full.
    thread::sleep(Duration::from_secs(1));
    let before = sleeps(&arm.child);
    thread::sleep(Duration::from_secs(2));
    let slept = sleeps(&arm.child) - before;
    // In real time, a process that never sleeps lets nobody else run who could make room.
    assert!(slept >= 10, "slept {slept} times in 2 s");
}

#[test]
#[ignore = "needs vcan0 and can-utils: run by tests/run inside tests/tools/with-vcan"]
fn vcan_what_is_recorded_is_what_candump_sees_and_foreign_frames_do_no_harm() {
    let dir = TempDir::new().unwrap();
    let plan = plan(dir.path());
    let (record, log) = (dir.path().join("record.log"), dir.path().join("candump.log"));
    let (mut arm, wire) = arm("can:vcan0", &["--once"]);
    let candump = fs::File::create(&log).unwrap();
    let mut candump = Tool::start(Command::new("candump").args(["-L", "vcan0"]).stdout(candump));
    // Identifiers that are nobody's here, at the pace of the setpoints.
    let mut cangen =
        Tool::start(Command::new("cangen").args(["vcan0", "-g", "20", "-I", "555", "-L", "8", "-D", "r"]));
    thread::sleep(Duration::from_millis(300));
    let report = json(execute(&plan, &wire, &["--json", "--record", record.to_str().unwrap()]), 0);
    assert!(report["frames"]["rejected"].as_u64().unwrap() > 50, "cangen was not heard: {report}");
    arm.says("State: ready to switch on");
    cangen.interrupt();
    candump.interrupt();
    // Each identifier's frames in the order of the bus; the session's, which is less than candump has.
    let (recorded, seen) = (by_identifier(&record), by_identifier(&log));
    for id in [0x201, 0x301, 0x401, 0x601, 0x77F, 0x181, 0x281, 0x381, 0x581, 0x701] {
        let frames = |log: &[(u16, Vec<u8>)]| -> Vec<_> {
            log.iter().filter(|(found, _)| *found == id).cloned().collect()
        };
        let (recorded, seen) = (frames(&recorded), frames(&seen));
        assert!(!recorded.is_empty() && seen.len() >= recorded.len(), "{id:03X}");
        let place = seen.windows(recorded.len()).position(|window| window == recorded);
        assert!(place.is_some(), "{id:03X}: {recorded:02X?} is not a part of {seen:02X?}");
    }
    assert!(fs::read_to_string(&record).unwrap().trim_end().ends_with("completed: 60 of 60 ticks"));
}

fn by_identifier(log: &Path) -> Vec<(u16, Vec<u8>)> {
    let text = fs::read_to_string(log).unwrap();
    let frames = candump::read(&text).map(|record| match record.unwrap().content {
        Content::Frame { frame, .. } => Some((frame.id, frame.data.to_vec())),
        _ => None,
    });
    frames.flatten().collect()
}

#[test]
#[ignore = "needs vcan0 and can-utils: run by tests/run inside tests/tools/with-vcan"]
fn vcan_a_flood_ends_in_a_completed_plan_or_in_a_stop_with_its_reason() {
    let dir = TempDir::new().unwrap();
    let plan = plan(dir.path());
    let (mut arm, wire) = arm("can:vcan0", &[]);
    // Any identifier, ours among them, any length, any content, as fast as it goes.
    let cangen =
        Tool::start(Command::new("cangen").args(["vcan0", "-g", "0", "-i", "-x"]).stderr(Stdio::null()));
    let (code, out) = execute(&plan, &wire, &["--json"]).ends();
    drop(cangen);
    let report: Value = serde_json::from_str(&out).unwrap();
    match code {
        Some(0) => assert_eq!(report["within_half_lsb"], true),
        Some(1) => assert!(report["stop"]["reason"].as_str().unwrap().ends_with('.'), "{report}"),
        _ => panic!("{out}"),
    }
    // The arm is still there, stands, and can be had again.
    let report = json(execute(&plan, &wire, &["--json", "--reset"]), if code == Some(0) { 0 } else { 1 });
    assert!(code == Some(0) || report["stop"]["code"] == 402 || report["completed"] == true, "{report}");
    arm.kill();
}

/// A program of `tests/can`, with the Python that has its packages.
fn python(script: &str, arguments: &[&str]) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("can").join(script);
    let output = Command::new("python3").arg(&script).args(arguments).output().unwrap();
    let said = [output.stdout, output.stderr].concat();
    assert!(output.status.success(), "{}: {}", script.display(), String::from_utf8_lossy(&said));
}

#[test]
#[ignore = "needs vcan0, can-utils, python-can and cantools: run by tests/run inside tests/tools/with-vcan"]
fn vcan_a_client_that_knows_the_protocol_only_moves_the_arm_and_cantools_reads_it() {
    let dir = TempDir::new().unwrap();
    let log = dir.path().join("candump.log");
    let [key, _] = keys(dir.path());
    for with in [&[][..], &["--key", &key]] {
        let (_arm, _) = arm("can:vcan0", with);
        let candump = fs::File::create(&log).unwrap();
        let mut candump = Tool::start(Command::new("candump").args(["-L", "vcan0"]).stdout(candump));
        thread::sleep(Duration::from_millis(300));
        // Slowly, for the machine that tests may be slow.
        python("outside_client.py", &[&["vcan0", "--period-us", "60000"], with].concat());
        candump.interrupt();
        python("check_dbc.py", &[log.to_str().unwrap()]);
    }
}
