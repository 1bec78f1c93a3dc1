//! Arms that lie, or that say the same for ever: the executor believes nothing that cannot be, and waits for nothing without
//! end. First under virtual time, message by message, then the program on a pseudo-terminal.

mod common;

use std::collections::VecDeque;
use std::os::fd::OwnedFd;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use common::{Move, header, one_move, plan_bytes};
use powderline_executor::session::{HARD_STOP_US, STANDS_US};
use powderline_executor::{Action, Config, Executor, Outcome};
use powderline_firmware_sim::controller::{ArmConfig, Controller};
use powderline_host::clock;
use powderline_host::transport::{Incoming, Pty, Transport};
use powderline_shared::displacement::Setpoint;
use powderline_shared::fault::{FaultCode, Reported};
use powderline_shared::plan::{PlanHeader, PlanReader};
use powderline_shared::pose::Pose;
use powderline_shared::wire::Context;
use powderline_shared::wire::codec::{Encoder, FromArmDecoder, ToArmDecoder};
use powderline_shared::wire::frame::Dialect;
use powderline_shared::wire::message::{FromArm, NO_SESSION, Refusal, Status};
use powderline_shared::wire::state::{Phase, State};
use rustix::fs::{Mode, OFlags, open};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use serde_json::Value;
use tempfile::TempDir;

/// What an arm makes of a status before it says it.
type Lie = fn(Status) -> Status;

/// What an arm makes of anything before it says it, without a memory.
type Word = fn(FromArm) -> FromArm;

/// What it says instead; of its faults, nothing.
fn lied(message: FromArm, lie: Lie) -> Option<FromArm> {
    match message {
        FromArm::Status(status) if status.session != NO_SESSION => Some(FromArm::Status(lie(status))),
        FromArm::Fault { .. } => None,
        other => Some(other),
    }
}

/// A tick far beyond what has been sent, from tick 50 on.
fn boasts(status: Status) -> Status {
    let applied_tick = if status.applied_tick >= 50 { 110 } else { status.applied_tick };
    Status { applied_tick, ..status }
}

/// Setpoints that nobody has sent.
fn has_what_was_not_sent(status: Status) -> Status {
    let have = if status.applied_tick >= 50 { 0xFFFF } else { status.have };
    Status { have, applied_tick: status.applied_tick + u32::from(status.applied_tick >= 50), ..status }
}

/// Ten ticks at once, that have been sent.
fn leaps(status: Status) -> Status {
    let leap = if status.applied_tick >= 50 { 10 } else { 0 };
    Status { applied_tick: status.applied_tick + leap, have: status.have >> leap, ..status }
}

/// Back by ten ticks.
fn goes_back(status: Status) -> Status {
    let back = if status.applied_tick >= 50 { 10 } else { 0 };
    Status { applied_tick: status.applied_tick - back, have: 0, ..status }
}

/// For ever on its way to a fault.
fn reacts_for_ever(status: Status) -> Status {
    if status.applied_tick < 20 {
        return status;
    }
    Status { state: State::FaultReactionActive, phase: None, standstill: false, ..status }
}

/// To and fro between two ticks or two phases, without end.
fn wavers(status: Status) -> Status {
    if status.applied_tick < 20 {
        return status;
    }
    let phase = if status.counter.is_multiple_of(2) { Phase::Streaming } else { Phase::Armed };
    Status {
        phase: Some(phase),
        state: State::OperationEnabled,
        standstill: false,
        applied_tick: 20,
        have: 0,
        ..status
    }
}

/// Obeys a stop, and never says that it stands.
fn never_stands(status: Status) -> Status {
    let standstill = status.standstill && status.state != State::QuickStopActive;
    Status { standstill, ..status }
}

// --- under virtual time ---

/// Plays to an arm that lies, with a stop and a hard stop asked for at these moments; how it ended, and when.
fn play(lie: Lie, stop_us: Option<u64>, hard_us: Option<u64>) -> (Outcome, Option<String>, u64) {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let mut arm = Controller::new(ArmConfig::ideal(plan.header().start_pose()));
    let mut executor = Executor::new(0, &plan, Config::default());
    let mut now_us = 0;
    loop {
        while let Some(message) = arm.poll(now_us) {
            lied(message, lie).iter().for_each(|said| executor.handle_message(now_us, said));
        }
        if stop_us == Some(now_us) {
            executor.handle_stop(now_us);
        }
        if hard_us == Some(now_us) {
            executor.handle_hard_stop(now_us);
        }
        match executor.poll(now_us) {
            Action::Send(message) => arm.handle_message(now_us, &message),
            Action::Wait => now_us += 1_000,
            Action::Finished(outcome) => {
                return (outcome, executor.doubt().map(|doubt| doubt.to_string()), now_us);
            }
        }
        assert!(now_us < 30_000_000, "the session never ends");
    }
}

#[track_caller]
fn assert_stopped(outcome: Outcome, code: FaultCode, stands: bool) {
    let Outcome::Stopped { fault, standstill } = outcome else { panic!("{outcome:?}") };
    assert_eq!((fault.code, standstill), (code, stands));
}

#[test]
fn a_tick_that_cannot_be_stops_the_arm() {
    for (lie, words) in [
        (boasts as Lie, "it reported tick 110, but the last setpoint sent was that of tick 6"),
        (has_what_was_not_sent, " is there, but the last one sent was that of tick 6"),
        (leaps, "it reported tick 60, but cannot be beyond tick 5"),
        (goes_back, "it reported tick 40 after it had reported tick 49"),
    ] {
        let (outcome, doubt, _) = play(lie, None, None);
        assert_stopped(outcome, FaultCode::ArmTickImpossible, true);
        let doubt = doubt.unwrap();
        assert!(doubt.contains(words), "`{words}` in: {doubt}");
    }
    let (outcome, doubt, _) = play(|status| status, None, None);
    assert_eq!((outcome, doubt), (Outcome::Completed, None));
}

#[test]
fn an_arm_that_never_reports_standstill_is_given_up() {
    let standstill_us = Config::default().standstill_us;
    let (outcome, _, ended_us) = play(reacts_for_ever, None, None);
    assert_stopped(outcome, FaultCode::StateUnexpected, false);
    assert!((standstill_us..standstill_us + 1_000_000).contains(&ended_us), "{ended_us}");
    let (outcome, _, ended_us) = play(never_stands, Some(500_000), None);
    assert_stopped(outcome, FaultCode::OperatorStop, false);
    assert_eq!(ended_us, 500_000 + standstill_us);
}

#[test]
fn whoever_asks_twice_waits_no_longer_than_a_second() {
    const _: () = assert!(HARD_STOP_US < 1_000_000);
    for lie in [reacts_for_ever as Lie, never_stands, wavers] {
        for hard_us in [10_000, 900_000, 3_000_000] {
            let (_, _, ended_us) = play(lie, Some(hard_us - 10_000), Some(hard_us));
            assert!(ended_us <= hard_us + HARD_STOP_US, "{ended_us} for {hard_us}");
        }
    }
}

#[test]
fn to_and_fro_is_no_progress() {
    let (outcome, _, ended_us) = play(wavers, None, None);
    assert_stopped(outcome, FaultCode::ArmStalled, false);
    let Config { handshake_us, standstill_us, .. } = Config::default();
    assert!(ended_us <= 1_200_000 + handshake_us + standstill_us, "{ended_us}");
}

/// Plays to an arm that says something else; how it ended.
fn hear(mut word: impl FnMut(FromArm) -> FromArm) -> (Outcome, Option<String>, u64) {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let mut arm = Controller::new(ArmConfig::ideal(plan.header().start_pose()));
    let mut executor = Executor::new(0, &plan, Config::default());
    let mut now_us = 0;
    loop {
        while let Some(message) = arm.poll(now_us) {
            let said = said_in_frames(word(message));
            executor.handle_message(now_us, &said);
        }
        match executor.poll(now_us) {
            Action::Send(message) => arm.handle_message(now_us, &message),
            Action::Wait => now_us += 1_000,
            Action::Finished(outcome) => {
                return (outcome, executor.doubt().map(|doubt| doubt.to_string()), now_us);
            }
        }
        assert!(now_us < 30_000_000, "the session never ends");
    }
}

/// A message, through frames.
fn said_in_frames(message: FromArm) -> FromArm {
    let context = Context { session: 1, seal: 0, key: None };
    let mut decoder = FromArmDecoder::new(Dialect::Fd);
    decoder.set_context(context);
    let frames = Encoder::new(Dialect::Fd).from_arm(&context, &message);
    let heard = frames.flat_map(|frame| decoder.handle_frame(&frame).unwrap());
    heard.last().unwrap()
}

/// What an arm says of where it is.
fn displaced(message: FromArm, by: impl Fn(u32, i32) -> i32) -> FromArm {
    match message {
        FromArm::Actual { session, mut reached } => {
            reached.counts[0] = by(reached.tick, reached.counts[0]);
            FromArm::Actual { session, reached }
        }
        other => other,
    }
}

#[test]
fn an_arm_that_is_not_where_it_is_due_is_stopped() {
    // One that never moves, one that is 5 mm off, one that reports noise of 4 mm; one that is 1 mm off, and one glitch.
    for (word, found) in [
        ((|message| displaced(message, |_, _| 0)) as Word, true),
        (|message| displaced(message, |_, x| x + 50_000), true),
        (|message| displaced(message, |tick, x| x + if tick % 2 == 0 { 40_000 } else { -40_000 }), true),
        (|message| displaced(message, |tick, x| x + if tick < 120 { 10_000 } else { 0 }), false),
        (|message| displaced(message, |tick, x| x + if tick == 60 { 900_000 } else { 0 }), false),
    ] {
        let (outcome, doubt, _) = hear(word);
        if found {
            assert_stopped(outcome, FaultCode::ArmAstray, true);
            let doubt = doubt.unwrap();
            assert!(doubt.contains("mm off in x, and may be "), "{doubt}");
        } else {
            assert_eq!((outcome, doubt), (Outcome::Completed, None));
        }
    }
}

/// Until it is at the end, where it was at another tick than the one that it is at.
fn located(message: FromArm, tick: impl Fn(u32) -> u32) -> FromArm {
    match message {
        FromArm::Actual { session, reached }
            if reached.tick < one_move().iter().map(|part| part.steps).sum() =>
        {
            let reached = Setpoint { tick: tick(reached.tick), ..Setpoint::ANCHOR };
            FromArm::Actual { session, reached }
        }
        other => other,
    }
}

#[test]
fn an_arm_that_does_not_say_where_it_is_is_stopped() {
    // Nothing but the anchor; always so long ago that nobody knows any more where it was due.
    for word in [(|message| located(message, |_| 0)) as Word, |message| {
        located(message, |tick| tick.saturating_sub(33))
    }] {
        let (outcome, doubt, ended_us) = hear(word);
        assert_stopped(outcome, FaultCode::ArmSilent, true);
        assert!(doubt.unwrap().contains(", but not where it was"));
        assert!(ended_us < 1_000_000, "{ended_us}");
    }
    // One that says so five ticks late: at no status does it say where it was at that tick.
    let (mut late, mut at, mut behind) = (VecDeque::new(), 0, 0);
    let (outcome, doubt, _) = hear(|message| {
        match message {
            FromArm::Actual { .. } => late.push_back(message),
            FromArm::Status(status) if status.phase == Some(Phase::Streaming) => {
                behind += u32::from(at + 5 < status.applied_tick);
            }
            _ => {}
        }
        let FromArm::Actual { session, .. } = message else { return message };
        let anchor = FromArm::Actual { session, reached: Setpoint::ANCHOR };
        let said = if late.len() > 5 { late.pop_front().unwrap() } else { anchor };
        if let FromArm::Actual { reached, .. } = said {
            at = reached.tick;
        }
        said
    });
    assert!(behind > 50, "{behind}");
    assert_eq!((outcome, doubt), (Outcome::Completed, None));
}

#[test]
fn an_arm_that_has_two_anchors_is_stopped() {
    static SAID: AtomicI32 = AtomicI32::new(0);
    // Once more, in place of a report on its way.
    let (outcome, ..) = hear(|message| match message {
        FromArm::Status(status) if status.applied_tick == 9 && SAID.swap(1, Ordering::Relaxed) == 0 => {
            let mut pose = header().start_pose();
            pose.position_m.x += 1e-4;
            FromArm::Anchored { session: status.session, pose }
        }
        other => other,
    });
    assert_stopped(outcome, FaultCode::ArmDuplicate, true);
}

#[test]
fn an_arm_that_never_says_that_it_stands_has_not_completed() {
    let (outcome, ..) = hear(|message| match message {
        FromArm::Status(status) => FromArm::Status(Status { standstill: false, ..status }),
        other => other,
    });
    assert_stopped(outcome, FaultCode::ArmStalled, false);
}

#[test]
fn an_arm_that_leaves_the_end_when_it_is_let_go_is_stopped() {
    static OFF: AtomicI32 = AtomicI32::new(0);
    // Once, in place of the first status of an arm that has been let go.
    fn strays(message: FromArm) -> FromArm {
        match message {
            FromArm::Status(status) if status.state == State::ReadyToSwitchOn && status.applied_tick > 0 => {
                let plan = plan_bytes(&header(), &one_move());
                let end = PlanReader::new(&plan).unwrap().end_setpoint();
                match OFF.swap(0, Ordering::Relaxed) {
                    0 => message,
                    off => {
                        displaced(FromArm::Actual { session: status.session, reached: end }, |_, x| x + off)
                    }
                }
            }
            other => other,
        }
    }
    // By 6 mm, and by 10 um, which a brake may give.
    OFF.store(60_000, Ordering::Relaxed);
    let (outcome, doubt, _) = hear(strays);
    assert_stopped(outcome, FaultCode::EndElsewhere, true);
    assert!(doubt.unwrap().contains("it was 6.000 mm off in x"));
    OFF.store(100, Ordering::Relaxed);
    assert_eq!(hear(strays).0, Outcome::Completed);
    assert_eq!(OFF.load(Ordering::Relaxed), 0, "it was never let go");
}

#[test]
fn an_anchor_that_is_no_pose_and_a_fault_of_a_later_version_are_said_at_once() {
    let (outcome, _, ended_us) = hear(|message| match message {
        FromArm::Anchored { session, mut pose } => {
            pose.position_m.y = f64::NAN;
            FromArm::Anchored { session, pose }
        }
        other => other,
    });
    assert_stopped(outcome, FaultCode::AnchorMeaningless, true);
    // At once; then it is watched that it stands.
    assert!(ended_us <= 2 * STANDS_US, "{ended_us}");
    let (outcome, doubt, ended_us) = hear(|message| match message {
        FromArm::Status(status) if status.applied_tick == 9 && status.phase.is_some() => {
            FromArm::Fault { session: status.session, fault: Reported { number: 777, tick: 9 } }
        }
        other => other,
    });
    assert_stopped(outcome, FaultCode::ArmFaultUnknown, true);
    assert_eq!(doubt.as_deref(), Some("it reported fault 777"));
    assert!(ended_us < 1_000_000, "{ended_us}");
    let (outcome, _, ended_us) = hear(|message| match message {
        FromArm::Opened { session, .. } => {
            let fault = Reported { number: 777, tick: 9 };
            FromArm::Refused { session, reason: Refusal::Latched { fault, nonce: 1 } }
        }
        other => other,
    });
    assert_stopped(outcome, FaultCode::SessionRefused, false);
    assert_eq!(ended_us, 0);
    let said = Refusal::Latched { fault: Reported { number: 777, tick: 9 }, nonce: 1 }.to_string();
    assert!(said.contains("fault 777 at tick 9, which this version does not know"), "{said}");
}

#[test]
fn an_unknown_fault_is_the_reason_of_no_stop_that_was_latched_before_it() {
    static SAID: AtomicI32 = AtomicI32::new(0);
    let next = |said| SAID.compare_exchange(said, said + 1, Ordering::Relaxed, Ordering::Relaxed).is_ok();
    // Two anchors; and while it stops for that, a fault.
    let (outcome, doubt, _) = hear(|message| match message {
        FromArm::Status(status) if status.applied_tick == 9 && next(0) => {
            let pose = Pose { position_m: Default::default(), ..header().start_pose() };
            FromArm::Anchored { session: status.session, pose }
        }
        FromArm::Status(Status { session, state: State::QuickStopActive, .. }) if next(1) => {
            FromArm::Fault { session, fault: Reported { number: 777, tick: 9 } }
        }
        other => other,
    });
    assert_eq!(SAID.load(Ordering::Relaxed), 2, "it said no fault");
    assert_stopped(outcome, FaultCode::ArmDuplicate, true);
    assert_eq!(doubt, None);
}

#[test]
fn an_unknown_fault_is_the_reason_why_the_arm_left_its_state() {
    let (outcome, doubt, _) = hear(|message| match message {
        FromArm::Status(status) if status.applied_tick >= 9 && status.state == State::OperationEnabled => {
            FromArm::Status(Status { state: State::FaultReactionActive, phase: None, ..status })
        }
        FromArm::Fault { session, .. } => {
            FromArm::Fault { session, fault: Reported { number: 777, tick: 9 } }
        }
        other => other,
    });
    assert_stopped(outcome, FaultCode::ArmFaultUnknown, true);
    assert_eq!(doubt.as_deref(), Some("it reported fault 777"));
}

// --- the program ---

/// An arm that lies, at the end of a pseudo-terminal.
struct Liar {
    wire: String,
    over: Arc<AtomicBool>,
    arm: Option<JoinHandle<()>>,
}

impl Liar {
    fn start(bytes: &[u8], lie: Lie) -> Self {
        let mut pty = Pty::create().unwrap();
        let wire = format!("serial:{}", pty.path().display());
        let arm = ArmConfig::ideal(PlanReader::new(bytes).unwrap().header().start_pose());
        let over = Arc::new(AtomicBool::new(false));
        let stop = Arc::clone(&over);
        let arm = thread::spawn(move || {
            let mut controller = Controller::new(ArmConfig { watchdog_us: 5_000_000, ..arm });
            let (encoder, mut decoder) = (Encoder::new(Dialect::Fd), ToArmDecoder::new(Dialect::Fd));
            let (start_us, mut contexts) = (clock::now_us(), [Context::NONE; 2]);
            let mut now_us = 0;
            while !stop.load(Ordering::Relaxed) {
                // In small steps, so that an arm whose thread was held up by this machine does not stop for that.
                now_us = (clock::now_us() - start_us).min(now_us + 5_000);
                while let Some(received) = pty.receive().unwrap() {
                    let Incoming::Frame(frame) = received.what else { continue };
                    let messages = decoder.handle_frame(&frame).unwrap_or_default();
                    messages.iter().for_each(|message| controller.handle_message(now_us, message));
                }
                while let Some(message) = controller.poll(now_us) {
                    if controller.context() != contexts[0] {
                        contexts = [controller.context(), contexts[0]];
                        decoder.set_context(contexts[0]);
                    }
                    let Some(said) = lied(message, lie) else { continue };
                    for frame in encoder.from_arm(&of(&contexts, &said), &said) {
                        pty.send(&frame).unwrap();
                    }
                }
                if now_us + 5_000 > clock::now_us() - start_us {
                    thread::sleep(Duration::from_millis(1));
                }
            }
        });
        Self { wire, over, arm: Some(arm) }
    }
}

impl Drop for Liar {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        self.arm.take().into_iter().for_each(|arm| arm.join().unwrap());
    }
}

/// The context that a message is of.
fn of(contexts: &[Context; 2], message: &FromArm) -> Context {
    let session = match message {
        FromArm::Status(status) => status.session,
        FromArm::Heartbeat(heartbeat) => heartbeat.session,
        FromArm::Actual { session, .. } | FromArm::Fault { session, .. } => *session,
        FromArm::Opened { .. }
        | FromArm::OpenedKeyed { .. }
        | FromArm::Refused { .. }
        | FromArm::Anchored { .. } => NO_SESSION,
    };
    let known = contexts.iter().find(|context| context.session == session && session != NO_SESSION);
    known.copied().unwrap_or(Context::NONE)
}

/// Slow enough for a machine that is busy with other things.
fn slow_plan() -> Vec<u8> {
    let slow = Move { steps: 60, ..one_move().remove(0) };
    plan_bytes(&PlanHeader { control_period_us: 40_000, ..header() }, &[slow])
}

fn command(dir: &TempDir, bytes: &[u8], wire: &str) -> Command {
    let plan = dir.path().join("skill.plan");
    std::fs::write(&plan, bytes).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_execute"));
    command
        .arg(&plan)
        .args(["--to", wire, "--arm-timeout", "2000", "--priority", "0"])
        .stdout(Stdio::piped());
    command
}

fn execute(dir: &TempDir, bytes: &[u8], wire: &str) -> Child {
    command(dir, bytes, wire).arg("--json").spawn().unwrap()
}

fn interrupt(child: &Child) {
    // `kill` as a shell has it built in; a program of that name is not everywhere.
    let process = child.id().to_string();
    assert!(Command::new("sh").args(["-c", "kill -INT \"$0\"", &process]).status().unwrap().success());
}

/// The exit code and the report.
fn ended(child: Child) -> (Option<i32>, Value) {
    let output = child.wait_with_output().unwrap();
    (output.status.code(), serde_json::from_slice(&output.stdout).unwrap())
}

#[test]
fn the_program_stops_an_arm_whose_tick_cannot_be() {
    for (lie, words) in [
        (
            (|status| Status {
                applied_tick: if status.applied_tick > 20 { 55 } else { status.applied_tick },
                ..status
            }) as Lie,
            "tick 55",
        ),
        (
            |status| Status {
                applied_tick: if status.applied_tick > 20 { 10 } else { status.applied_tick },
                ..status
            },
            "after it had reported tick 20",
        ),
    ] {
        let (dir, bytes) = (TempDir::new().unwrap(), slow_plan());
        let liar = Liar::start(&bytes, lie);
        let (code, report) = ended(execute(&dir, &bytes, &liar.wire));
        assert_eq!((code, &report["stop"]["code"]), (Some(1), &Value::from(114)), "{report}");
        assert!(report["stop"]["detail"].as_str().unwrap().contains(words), "{report}");
    }
}

#[test]
fn a_person_who_asks_twice_gets_the_program_to_end() {
    let (dir, bytes) = (TempDir::new().unwrap(), slow_plan());
    let liar = Liar::start(&bytes, reacts_for_ever);
    let child = execute(&dir, &bytes, &liar.wire);
    // By then it waits for a standstill that never comes.
    thread::sleep(Duration::from_millis(2_500));
    interrupt(&child);
    thread::sleep(Duration::from_millis(100));
    let asked = Instant::now();
    interrupt(&child);
    let (code, report) = ended(child);
    assert_eq!((code, &report["standstill"]), (Some(1), &Value::from(false)), "{report}");
    // Without the second it would have waited for this long; a machine that is busy may take some of it.
    assert!(asked.elapsed() < Duration::from_micros(Config::default().standstill_us), "{report}");
}

// --- a terminal that nobody reads ---

/// A terminal without room for a byte more, as one behind a line that has stalled; it is one as long as its master is there.
fn stalled_terminal() -> (OwnedFd, OwnedFd) {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let name = ptsname(&master, Vec::new()).unwrap();
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
    let filled = open(&name, flags | OFlags::NONBLOCK, Mode::empty()).unwrap();
    // What waits for the system to take it on makes room once more.
    for _ in 0..3 {
        while rustix::io::write(&filled, b".").is_ok() {}
        thread::sleep(Duration::from_millis(20));
    }
    (master, open(&name, flags, Mode::empty()).unwrap())
}

/// Waits for a program that may hang: then it is ended, and that is a failure.
#[track_caller]
fn ended_in_time(mut child: Child) -> (Option<i32>, String) {
    let began = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if began.elapsed() > Duration::from_secs(30) {
            child.kill().unwrap();
            child.wait().unwrap();
            panic!("it waits for its terminal");
        }
        thread::sleep(Duration::from_millis(10));
    }
    let output = child.wait_with_output().unwrap();
    (output.status.code(), String::from_utf8(output.stdout).unwrap())
}

#[test]
fn a_terminal_that_nobody_reads_holds_up_neither_the_motion_nor_a_stop() {
    for (is_stopped, code, words) in [(false, 0, "Completed: 60 of 60"), (true, 4, "(fault 501)")] {
        let (dir, bytes) = (TempDir::new().unwrap(), slow_plan());
        let arm = Liar::start(&bytes, |status| status);
        let (_master, terminal) = stalled_terminal();
        let child = command(&dir, &bytes, &arm.wire).env("TERM", "xterm").stderr(terminal).spawn().unwrap();
        if is_stopped {
            thread::sleep(Duration::from_millis(1_500));
            interrupt(&child);
        }
        let (found, said) = ended_in_time(child);
        assert!(found == Some(code) && said.contains(words), "{found:?}: {said}");
    }
}

/// One object, and the code of what the arm did, whatever becomes of the record.
#[test]
fn a_record_that_cannot_be_written_takes_nothing_from_the_report() {
    let (dir, bytes) = (TempDir::new().unwrap(), slow_plan());
    let liar = Liar::start(&bytes, |status| status);
    let output =
        command(&dir, &bytes, &liar.wire).args(["--json", "--record", "/dev/full"]).output().unwrap();
    let text = str::from_utf8(&output.stdout).unwrap();
    assert_eq!(text.lines().count(), 1, "{text}");
    let report: Value = serde_json::from_str(text).unwrap();
    assert_eq!((output.status.code(), &report["completed"]), (Some(5), &true.into()), "{text}");
}
