//! Executor and simulated arm, joined, over virtual time.

mod common;

use common::{Move, header, one_move, plan_bytes};
use powderline_executor::belief::Doubt;
use powderline_executor::{Action, Config, Executor, Outcome};
use powderline_executor_cli::pace::VirtualTime;
use powderline_executor_cli::report::Report;
use powderline_executor_cli::run::{Observer, RunResult, StopWish, Unattended, play};
use powderline_firmware_sim::controller::{ArmConfig, Controller};
use powderline_shared::arm::ArmModel;
use powderline_shared::displacement::{Displacement, Lsb};
use powderline_shared::fault::{Fault, FaultCode};
use powderline_shared::limits::{Limit, Limits, Motion, Violation};
use powderline_shared::plan::{PlanHeader, PlanReader, StartPose};
use powderline_shared::pose::Pose;
use powderline_shared::wire::message::{FromArm, OpenRequest, PROTOCOL_VERSION, Refusal, Status, ToArm};
use powderline_shared::wire::state::{Command, Phase, State};
use proptest::prelude::*;

fn arm_for(plan: &PlanReader<'_>) -> ArmConfig {
    ArmConfig::ideal(plan.header().start_pose())
}

fn play_on(plan: &PlanReader<'_>, arm: ArmConfig) -> RunResult {
    play(plan, Config::default(), arm, &mut VirtualTime, &mut Unattended)
}

fn fault_code(outcome: Outcome) -> Option<FaultCode> {
    match outcome {
        Outcome::Completed => None,
        Outcome::Stopped { fault, .. } => Some(fault.code),
    }
}

#[test]
fn a_plan_ends_where_it_says_bit_for_bit() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let result = play_on(&plan, arm_for(&plan));
    assert_eq!(result.outcome, Outcome::Completed);
    assert_eq!(result.final_pose, Some(plan.end_pose()));
    assert_eq!((result.arm.unwrap().applied_tick, result.telemetry.lost), (120, 0));
    // Armed at once, 120 periods, three more until acceleration and jerk are gone.
    assert_eq!(result.duration_us, (120 + 3) * 10_000);
}

#[test]
fn what_was_sent_uses_the_limits_as_the_plan_does() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let (sent, planned) = (play_on(&plan, arm_for(&plan)).peak_use, plan.check_limits().unwrap());
    assert!((sent.linear_velocity - planned.linear_velocity).abs() < 1e-5 * planned.linear_velocity);
    assert!(sent.angular_jerk <= 1.01 * planned.angular_jerk);
}

#[test]
fn the_look_ahead_does_not_change_the_motion() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    for look_ahead in 0..=16 {
        let config = Config { look_ahead, ..Config::default() };
        let result = play(&plan, config, arm_for(&plan), &mut VirtualTime, &mut Unattended);
        assert_eq!(
            (result.outcome, result.final_pose),
            (Outcome::Completed, Some(plan.end_pose())),
            "{look_ahead}"
        );
    }
}

#[test]
fn a_plan_shorter_than_the_look_ahead_is_played() {
    let nothing = Move { translation_m: [0.0; 3], rotation_rad: [0.0; 3], steps: 1 };
    let bytes = plan_bytes(&header(), &[nothing]);
    let plan = PlanReader::new(&bytes).unwrap();
    assert_eq!(play_on(&plan, arm_for(&plan)).outcome, Outcome::Completed);
}

#[test]
fn each_limit_is_refused_by_executor_and_by_arm_independently() {
    let fine = header().limits;
    let cases = [
        (
            Limits { workspace_max_m: [0.35, 1.0, 1.0], ..fine },
            FaultCode::GuardWorkspace,
            FaultCode::ArmWorkspace,
        ),
        (
            Limits { linear_velocity_m_s: 0.15, ..fine },
            FaultCode::GuardLinearVelocity,
            FaultCode::ArmLinearVelocity,
        ),
        (
            Limits { linear_acceleration_m_s2: 0.4, ..fine },
            FaultCode::GuardLinearAcceleration,
            FaultCode::ArmLinearAcceleration,
        ),
        (Limits { linear_jerk_m_s3: 2.0, ..fine }, FaultCode::GuardLinearJerk, FaultCode::ArmLinearJerk),
        (
            Limits { angular_velocity_rad_s: 1.0, ..fine },
            FaultCode::GuardAngularVelocity,
            FaultCode::ArmAngularVelocity,
        ),
        (
            Limits { angular_acceleration_rad_s2: 2.0, ..fine },
            FaultCode::GuardAngularAcceleration,
            FaultCode::ArmAngularAcceleration,
        ),
        (
            Limits { angular_jerk_rad_s3: 15.0, ..fine },
            FaultCode::GuardAngularJerk,
            FaultCode::ArmAngularJerk,
        ),
    ];
    for (tight, by_executor, by_arm) in cases {
        // The plan breaks the limits that it carries: found when loaded, and by the guard.
        let bytes = plan_bytes(&PlanHeader { limits: tight, ..header() }, &one_move());
        let plan = PlanReader::new(&bytes).unwrap();
        assert!(plan.check_limits().is_err());
        let result = play_on(&plan, arm_for(&plan));
        assert_eq!(fault_code(result.outcome), Some(by_executor));
        assert!(result.violation.is_some() && result.arm.unwrap().standstill);

        // The plan is fine by its own limits, the arm has tighter ones. (The LSB is fine enough for the tightest.)
        let lsb = Lsb { translation_nm: 10, rotation_nrad: 10 };
        let bytes = plan_bytes(&PlanHeader { lsb, ..header() }, &one_move());
        let plan = PlanReader::new(&bytes).unwrap();
        let arm = ArmConfig { limits: tight, ..arm_for(&plan) };
        let result = play_on(&plan, arm);
        assert_eq!(fault_code(result.outcome), Some(by_arm));
        assert!(result.violation.is_some() && result.arm.unwrap().standstill);
    }
}

/// An arm that stands a little beside where the plan starts.
fn elsewhere(plan: &PlanReader<'_>) -> Pose {
    let off = Displacement { translation_m: [0.01, 0.0, 0.0], ..Displacement::default() };
    plan.header().start_pose().displaced(&off)
}

#[test]
fn an_arm_that_stands_elsewhere_is_not_moved() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let elsewhere = elsewhere(&plan);
    let result = play_on(&plan, ArmConfig::ideal(elsewhere));
    assert_eq!(fault_code(result.outcome), Some(FaultCode::AnchorElsewhere));
    assert_eq!(result.final_pose, Some(elsewhere));
}

/// What an arm that stands elsewhere is told once it is enabled, what becomes of it, and how the session ends. `between` may lose
/// what it is told then; the arm says of itself what `says` makes of it.
fn play_elsewhere(
    mut between: impl FnMut(&mut Controller, u64) -> bool,
    says: fn(Status) -> Status,
) -> (Vec<Command>, Controller, Outcome) {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let mut arm = Controller::new(ArmConfig::ideal(elsewhere(&plan)));
    let mut executor = Executor::new(0, &plan, Config::default());
    let (mut now_us, mut told, mut enabled) = (0, Vec::new(), false);
    loop {
        while let Some(message) = arm.poll(now_us) {
            let said = match message {
                FromArm::Status(status) => FromArm::Status(says(status)),
                other => other,
            };
            executor.handle_message(now_us, &said);
        }
        match executor.poll(now_us) {
            Action::Send(ToArm::Control { session, command }) => {
                told.extend(enabled.then_some(command));
                if !enabled || between(&mut arm, now_us) {
                    arm.handle_message(now_us, &ToArm::Control { session, command });
                }
                enabled |= arm.state() == State::OperationEnabled;
            }
            Action::Send(message) => arm.handle_message(now_us, &message),
            Action::Wait => now_us += 1_000,
            Action::Finished(outcome) => return (told, arm, outcome),
        }
        assert!(now_us < 10_000_000, "the session never ends");
    }
}

const STANDS_ELSEWHERE: Outcome =
    Outcome::Stopped { fault: Fault { code: FaultCode::AnchorElsewhere, tick: 0 }, standstill: true };

#[test]
fn an_arm_that_stands_elsewhere_is_let_go_and_nothing_is_latched() {
    for lost in 0..3 {
        let mut said = 0;
        let comes_through = |_: &mut Controller, _| {
            said += 1;
            said > lost
        };
        let (told, arm, outcome) = play_elsewhere(comes_through, |status| status);
        assert_eq!(outcome, STANDS_ELSEWHERE, "{lost}");
        assert_eq!((arm.fault(), arm.state()), (None, State::ReadyToSwitchOn), "{lost}");
        assert!(arm.request().is_none() && !arm.has_moved(), "its session is open yet");
        // Asked again only as long as it had not heard: soon the arm may be in another session.
        assert_eq!(told, vec![Command::Shutdown; lost + 1]);
    }
}

#[test]
fn a_stop_that_somebody_has_latched_meanwhile_is_not_reset_by_letting_an_arm_go() {
    let stopped = |arm: &mut Controller, now_us| {
        arm.handle_message(now_us, &ToArm::Stop);
        true
    };
    let (_, arm, outcome) = play_elsewhere(stopped, |status| status);
    assert_eq!(outcome, STANDS_ELSEWHERE);
    assert_eq!(arm.fault().map(|fault| fault.code), Some(FaultCode::SoftwareStop));
}

#[test]
fn an_arm_that_is_elsewhere_and_moves_is_stopped() {
    let moves = |status: Status| Status {
        standstill: status.standstill && status.state != State::OperationEnabled,
        ..status
    };
    let (told, arm, outcome) = play_elsewhere(|_, _| true, moves);
    assert_eq!((outcome, told.first()), (STANDS_ELSEWHERE, Some(&Command::QuickStop)));
    assert_eq!(arm.fault().map(|fault| fault.code), Some(FaultCode::StopCommanded));
}

#[test]
fn a_small_offset_of_the_anchor_is_carried_along() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let off = Displacement { translation_m: [1e-4, 0.0, -2e-4], ..Displacement::default() };
    let result = play_on(&plan, ArmConfig::ideal(plan.header().start_pose().displaced(&off)));
    assert_eq!(result.outcome, Outcome::Completed);
    let difference =
        plan.end_pose().displacement_to(&result.final_pose.unwrap()).translation() - off.translation();
    assert!(difference.norm() < 1e-12);
}

#[test]
fn an_arm_whose_limits_drown_in_noise_refuses_the_session() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let limits = Limits { linear_jerk_m_s3: 0.1, ..header().limits };
    let result = play_on(&plan, ArmConfig { limits, ..arm_for(&plan) });
    assert_eq!(fault_code(result.outcome), Some(FaultCode::SessionRefused));
    assert_eq!(result.refusal, Some(Refusal::Meaningless));
}

/// Asks for a stop between two ticks of the arm, and notes when the arm is seen to obey.
#[derive(Default)]
struct StopAtOnce {
    asked_us: Option<u64>,
    obeyed_us: Option<u64>,
}

impl Observer for StopAtOnce {
    fn observe(&mut self, now_us: u64, arm: &Status) -> StopWish {
        if arm.state == State::QuickStopActive {
            self.obeyed_us.get_or_insert(now_us);
        }
        if arm.applied_tick >= 50 {
            self.asked_us.get_or_insert(now_us);
        }
        if self.asked_us.is_some() { StopWish::Controlled } else { StopWish::None }
    }
}

#[test]
fn a_stop_does_not_wait_for_the_next_tick() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let mut observer = StopAtOnce::default();
    let result = play(&plan, Config::default(), arm_for(&plan), &mut VirtualTime, &mut observer);
    assert_eq!(fault_code(result.outcome), Some(FaultCode::OperatorStop));
    assert!(observer.asked_us.is_some());
    assert_eq!(observer.asked_us, observer.obeyed_us);
}

#[test]
fn whoever_has_something_to_say_is_to_be_polled_at_once() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let mut executor = Executor::new(0, &plan, Config::default());
    let Action::Send(ToArm::Open(request)) = executor.poll(0) else { panic!("nothing to open") };
    let opened = FromArm::Opened { session: 1, nonce: 1, digest: request.digest() };
    executor.handle_message(50_000, &opened);
    executor.handle_stop(50_000);
    assert!(executor.poll_at().unwrap() <= 50_000);
    assert!(matches!(
        executor.poll(50_000),
        Action::Send(ToArm::Control { command: Command::QuickStop, .. })
    ));
    assert!(executor.poll_at().unwrap() > 50_000);
}

/// Asks for a stop at a tick.
struct StopAt(u32);

impl Observer for StopAt {
    fn observe(&mut self, _now_us: u64, arm: &Status) -> StopWish {
        if arm.applied_tick >= self.0 { StopWish::Controlled } else { StopWish::None }
    }
}

#[test]
fn a_person_can_stop_at_any_tick() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    for tick in 0..120 {
        let result = play(&plan, Config::default(), arm_for(&plan), &mut VirtualTime, &mut StopAt(tick));
        assert_eq!(fault_code(result.outcome), Some(FaultCode::OperatorStop), "{tick}");
        assert!(result.arm.unwrap().standstill && result.arm.unwrap().state != State::OperationEnabled);
    }
}

#[test]
fn a_silent_arm_is_noticed() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let mut arm = Controller::new(arm_for(&plan));
    let mut executor = Executor::new(0, &plan, Config::default());
    let mut now_us = 0;
    let silent_from_us = 500_000;
    let outcome = loop {
        while let Some(message) = arm.poll(now_us) {
            if now_us < silent_from_us {
                executor.handle_message(now_us, &message);
            }
        }
        match executor.poll(now_us) {
            Action::Send(message) => arm.handle_message(now_us, &message),
            Action::Wait => {
                now_us += 1_000;
                assert!(now_us < 10_000_000, "the session never ends");
            }
            Action::Finished(outcome) => break outcome,
        }
    };
    let Outcome::Stopped { fault, standstill } = outcome else { panic!("{outcome:?}") };
    assert_eq!(fault.code, FaultCode::ArmSilent);
    assert!(!standstill, "nobody has said so");
    // The arm has come to rest by itself, and for its own reason.
    assert!(matches!(arm.state(), State::Fault | State::QuickStopActive));
    assert_eq!(arm.fault().map(|fault| fault.code), Some(FaultCode::SetpointMissing));
}

#[test]
fn a_stop_is_over_when_the_arm_stands_and_not_before() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    // By its limits the arm takes 0.2 s from the middle of the move.
    let config = Config { handshake_us: 50_000, retry_us: 20_000, ..Config::default() };
    let result = play(&plan, config, arm_for(&plan), &mut VirtualTime, &mut StopAt(60));
    let Outcome::Stopped { fault, standstill } = result.outcome else { panic!("{:?}", result.outcome) };
    assert_eq!(fault.code, FaultCode::OperatorStop);
    assert!(standstill && result.arm.unwrap().standstill, "given up while the arm moves");
    let took_us = result.duration_us - 60 * 10_000;
    assert!((100_000..500_000).contains(&took_us), "{took_us} us");
}

#[test]
fn a_stop_that_the_arm_does_not_confirm_is_not_reported_as_one() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let run = play(&plan, Config::default(), arm_for(&plan), &mut VirtualTime, &mut StopAt(60));
    let report = Report::new("skill.plan", &plan, &run);
    assert!(report.stopped_by_a_person() && report.to_string().starts_with("Stopped at tick"));

    let Outcome::Stopped { fault, .. } = run.outcome else { panic!("{:?}", run.outcome) };
    let unconfirmed = RunResult { outcome: Outcome::Stopped { fault, standstill: false }, ..run.clone() };
    let report = Report::new("skill.plan", &plan, &unconfirmed);
    let text = report.to_string();
    assert!(!text.contains("Stopped") && text.contains("may be moving"), "{text}");
    assert!(
        report.cause().starts_with("given up, and nobody knows whether it stands, at tick "),
        "{}",
        report.cause()
    );
    assert!(!report.stopped_by_a_person() && !report.succeeded());
    assert_eq!(serde_json::to_value(&report).unwrap()["standstill"], false);
}

#[test]
fn an_arm_that_sinks_when_it_is_let_go_is_not_said_to_have_completed() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let run = play_on(&plan, arm_for(&plan));
    let at_end = Report::new("skill.plan", &plan, &run);
    assert!(at_end.succeeded() && at_end.to_string().starts_with("Completed: "));
    let mut sunk = run.clone();
    // By 10 um: no fault, but not what the plan says.
    sunk.reached.as_mut().unwrap().counts[2] -= 100;
    let report = Report::new("skill.plan", &plan, &sunk);
    for said in [report.to_string(), report.cause()] {
        assert!(said.starts_with("The arm has left the plan's end"), "{said}");
    }
    assert!(!report.succeeded());
}

/// An executor whose first request was refused, and that has taken in the answer to its next one.
fn opened_after<'a>(plan: &PlanReader<'a>, reason: Refusal) -> Executor<'a> {
    let config = Config { reset: true, ..Config::default() };
    let mut executor = Executor::new(0, plan, config);
    assert!(matches!(executor.poll(0), Action::Send(ToArm::Open(_))));
    executor.handle_message(0, &FromArm::Refused { session: 1, reason });
    assert_eq!(executor.refusal(), Some(reason));
    for now_us in [0, config.retry_us] {
        if let Action::Send(ToArm::Open(request)) = executor.poll(now_us) {
            let opened = FromArm::Opened { session: request.session, nonce: 1, digest: request.digest() };
            executor.handle_message(now_us, &opened);
            return executor;
        }
    }
    panic!("it does not ask again")
}

#[test]
fn a_refusal_that_was_overcome_is_forgotten() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let fault = Fault { code: FaultCode::SetpointMissing, tick: 7 }.into();
    for reason in [Refusal::Latched { fault, nonce: 3 }, Refusal::Busy, Refusal::Closed] {
        let executor = opened_after(&plan, reason);
        assert_eq!(executor.refusal(), None, "{reason:?}");
        // What it was reset from is not.
        let latched = matches!(reason, Refusal::Latched { .. }).then_some(fault);
        assert_eq!(executor.reset_from(), latched, "{reason:?}");
    }
}

#[test]
fn a_stop_is_detailed_by_what_it_is_about() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let violation = |limit| Some(Violation { limit, tick: 3, value: 2.0, bound: 1.0 });
    // Whatever else there is to tell.
    let run = RunResult {
        refusal: Some(Refusal::Busy),
        is_stopped_anew: false,
        reset_from: None,
        doubt: Some(Doubt::Back { tick: 40, known: 49 }),
        violation: violation(Limit::LinearJerk),
        ..play_on(&plan, arm_for(&plan))
    };
    for (code, words) in [
        (FaultCode::OperatorStop, None),
        (FaultCode::AnchorElsewhere, None),
        (FaultCode::SetpointMissing, None),
        (FaultCode::ArmAngularJerk, None),
        (FaultCode::SessionRefused, Some("another session")),
        (FaultCode::ArmTickImpossible, Some("tick 40 after it had reported tick 49")),
        (FaultCode::ArmLinearJerk, Some("linear jerk")),
        (FaultCode::GuardLinearJerk, Some("linear jerk")),
    ] {
        let outcome = Outcome::Stopped { fault: Fault { code, tick: 3 }, standstill: true };
        let stop = Report::new("skill.plan", &plan, &RunResult { outcome, ..run.clone() }).stop.unwrap();
        match (stop.detail, words) {
            (None, None) => {}
            (Some(detail), Some(words)) => assert!(detail.contains(words), "{detail}"),
            (detail, _) => panic!("{code:?}: {detail:?}"),
        }
    }
}

/// Executor and arm joined by a wire that may change, drop or reorder what the arm says at one moment.
fn play_hearing(plan: &PlanReader<'_>, heard: impl FnMut(Vec<FromArm>) -> Vec<FromArm>) -> Outcome {
    play_with(plan, arm_for(plan), heard)
}

/// The same with another arm.
fn play_with(
    plan: &PlanReader<'_>,
    arm: ArmConfig,
    mut heard: impl FnMut(Vec<FromArm>) -> Vec<FromArm>,
) -> Outcome {
    let mut arm = Controller::new(arm);
    let mut executor = Executor::new(0, plan, Config::default());
    let mut now_us = 0;
    loop {
        let said = std::iter::from_fn(|| arm.poll(now_us)).collect();
        heard(said).iter().for_each(|message| executor.handle_message(now_us, message));
        match executor.poll(now_us) {
            Action::Send(message) => arm.handle_message(now_us, &message),
            Action::Wait => now_us += 1_000,
            Action::Finished(outcome) => return outcome,
        }
        assert!(now_us < 10_000_000, "the session never ends");
    }
}

fn is_pose_of(message: &FromArm, end_tick: u32) -> bool {
    matches!(message, FromArm::Actual { reached, .. } if reached.tick == end_tick)
}

#[test]
fn completed_means_that_the_arm_stands_at_the_plans_end() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    // Counts by which the arm is off: poses are reported to the nearest count.
    for (counts, code) in [
        ([0; 6], None),
        ([0, 0, 1, 0, 0, 0], Some(FaultCode::EndElsewhere)),
        ([0, 0, 0, -1, 0, 0], Some(FaultCode::EndElsewhere)),
    ] {
        let moved = |message| match message {
            FromArm::Actual { session, mut reached } => {
                reached.counts.iter_mut().zip(counts).for_each(|(count, off)| *count += off);
                FromArm::Actual { session, reached }
            }
            other => other,
        };
        let outcome = play_hearing(&plan, |said| said.into_iter().map(moved).collect());
        assert_eq!(fault_code(outcome), code, "off by {counts:?}");
    }
}

#[test]
fn an_end_that_the_arm_does_not_report_is_not_completed() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let end_tick = plan.header().step_count;
    let last_pose = |message: &FromArm| is_pose_of(message, end_tick);
    let without = |mut said: Vec<FromArm>| {
        said.retain(|message| !last_pose(message));
        said
    };
    assert_eq!(fault_code(play_hearing(&plan, without)), Some(FaultCode::ArmStalled));
}

/// A plan for the arm beside the bench, and that arm: its joints lag, so it says its last tick more than once until it is there.
fn lagging() -> (Vec<u8>, ArmConfig) {
    let start = StartPose { position_m: [0.05, 0.04, 0.12], orientation_wxyz: [1.0, 0.0, 0.0, 0.0] };
    let header = PlanHeader { start, ..header() };
    let moves = [Move { translation_m: [0.1, 0.0, 0.05], rotation_rad: [0.0, 0.5, 0.0], steps: 120 }];
    let arm = ArmConfig::jointed(ArmModel::bench(), header.start_pose()).unwrap();
    (plan_bytes(&header, &moves), arm)
}

fn is_holding(message: &FromArm) -> bool {
    matches!(message, FromArm::Status(status) if status.phase == Some(Phase::Holding))
}

/// What a wire makes of what the arm says at one moment; what it keeps for later, or remembers.
type Wire = fn(Vec<FromArm>, &mut Vec<FromArm>, u32) -> Vec<FromArm>;

/// Of where the arm is while it settles only the first report comes through; what it says once it holds, all.
fn loses_all_but_the_first(mut said: Vec<FromArm>, first: &mut Vec<FromArm>, end_tick: u32) -> Vec<FromArm> {
    if !first.iter().any(is_holding) {
        said.retain(|message| !is_pose_of(message, end_tick) || first.is_empty());
        first.extend(said.iter().filter(|message| is_pose_of(message, end_tick) || is_holding(message)));
    }
    said
}

/// A status goes before all else that waits for a CAN bus, as its identifier does.
fn lets_statuses_go_first(mut said: Vec<FromArm>, kept: &mut Vec<FromArm>, end_tick: u32) -> Vec<FromArm> {
    let holds = said.iter().any(is_holding);
    kept.extend(said.extract_if(.., |message| is_pose_of(message, end_tick)));
    // Two that settle wait for the bus yet.
    let leave = if holds { kept.len() } else { kept.len().saturating_sub(2) };
    said.extend(kept.drain(..leave));
    said
}

/// Where the arm was first at the last tick is said over and over, until it holds.
fn repeats_the_first(mut said: Vec<FromArm>, kept: &mut Vec<FromArm>, end_tick: u32) -> Vec<FromArm> {
    let Some(at) = said.iter().position(|message| is_pose_of(message, end_tick)) else { return said };
    if kept.is_empty() {
        kept.push(said[at]);
    }
    if !kept.iter().any(is_holding) {
        said.insert(at + 1, kept[0]);
        kept.extend(said.iter().copied().filter(is_holding));
    }
    said
}

#[test]
fn an_end_is_judged_by_what_the_arm_says_once_it_holds() {
    let (bytes, arm) = lagging();
    let plan = PlanReader::new(&bytes).unwrap();
    let end = plan.end_setpoint();
    let mut failed = Vec::new();
    for (wire, name) in [
        (loses_all_but_the_first as Wire, "lost"),
        (lets_statuses_go_first, "overtaken"),
        (repeats_the_first, "repeated"),
    ] {
        let (mut kept, mut last, mut at_first) = (Vec::new(), None, None);
        let outcome = play_with(&plan, arm, |said| {
            let heard = wire(said, &mut kept, end.tick);
            for message in &heard {
                match message {
                    FromArm::Actual { reached, .. } => last = Some(*reached),
                    held if is_holding(held) => at_first = at_first.or(last),
                    _ => {}
                }
            }
            heard
        });
        // Else nothing is shown by it.
        assert!(at_first.is_some_and(|known| known.tick == end.tick && known != end), "{name}: {at_first:?}");
        if outcome != Outcome::Completed {
            failed.push((name, outcome));
        }
    }
    assert_eq!(failed, []);
}

#[test]
fn an_end_may_be_reported_after_the_arm_holds_it() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let end_tick = plan.header().step_count;
    let mut held = 0;
    // All reports from the end are lost, until the arm has held it for a while.
    let late = |mut said: Vec<FromArm>| {
        held += said.iter().filter(|message| is_holding(message)).count();
        if held < 4 {
            said.retain(|message| !is_pose_of(message, end_tick));
        }
        said
    };
    assert_eq!(play_hearing(&plan, late), Outcome::Completed);
    assert_eq!(held, 4, "it was believed before it had said where it is");
}

#[test]
fn an_arm_that_says_nothing_more_of_where_it_holds_is_where_it_said_last() {
    let (bytes, arm) = lagging();
    let plan = PlanReader::new(&bytes).unwrap();
    let (end, mut last) = (plan.end_setpoint(), None);
    // It settles, and where it has settled is lost for ever.
    let outcome = play_with(&plan, arm, |mut said| {
        said.retain(|message| !matches!(message, FromArm::Actual { reached, .. } if *reached == end));
        last = said.iter().find(|message| is_pose_of(message, end.tick)).copied().or(last);
        said
    });
    assert!(last.is_some());
    assert_eq!(fault_code(outcome), Some(FaultCode::EndElsewhere));
}

#[test]
fn an_arm_that_never_answers_is_given_up() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let mut executor = Executor::new(0, &plan, Config::default());
    let (mut now_us, mut requests) = (0, 0);
    let outcome = loop {
        match executor.poll(now_us) {
            Action::Send(message) => {
                assert!(matches!(message, ToArm::Open(_) | ToArm::Heartbeat { .. }));
                requests += u32::from(matches!(message, ToArm::Open(_)));
            }
            Action::Wait => now_us = executor.poll_at().unwrap(),
            Action::Finished(outcome) => break outcome,
        }
    };
    assert_eq!(fault_code(outcome), Some(FaultCode::HandshakeTimeout));
    // At the first poll and every 0.1 s after.
    assert_eq!((now_us, requests), (2_000_000, 20));
}

#[test]
fn a_latched_arm_refuses_the_next_session_until_it_is_reset() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let mut arm = Controller::new(arm_for(&plan));
    stream_until_silent(&plan, &mut arm);
    assert_eq!(arm.state(), State::Fault);
    let refused = |arm: &mut Controller| {
        let mut executor = Executor::new(0, &plan, Config { session: 9, ..Config::default() });
        let Action::Send(open) = executor.poll(0) else { panic!("nothing to say") };
        arm.handle_message(10_000_000, &open);
        std::iter::from_fn(|| arm.poll(10_000_000)).any(|message| {
            matches!(message, FromArm::Refused { session: 9, reason: Refusal::Latched { .. } })
        })
    };
    assert!(refused(&mut arm));
    arm.handle_message(11_000_000, &ToArm::Control { session: 1, command: Command::FaultReset });
    assert!(!refused(&mut arm));
}

/// Opens, enables, sends the first setpoints and no more.
fn stream_until_silent(plan: &PlanReader<'_>, arm: &mut Controller) {
    let header = plan.header();
    let request = OpenRequest {
        version: PROTOCOL_VERSION,
        session: 1,
        plan_hash: plan.content_hash(),
        period_us: header.control_period_us,
        end_tick: header.step_count,
        lsb: header.lsb,
        limits: header.limits,
        start_level: 4,
        reset_nonce: 0,
    };
    arm.handle_message(0, &ToArm::Open(request));
    for command in [Command::Shutdown, Command::SwitchOn, Command::EnableOperation] {
        arm.handle_message(0, &ToArm::Control { session: 1, command });
    }
    for setpoint in plan.setpoints().take(16) {
        arm.handle_message(0, &ToArm::Setpoint { session: 1, setpoint });
    }
    (0..900).for_each(|tick| while arm.poll(tick * 10_000).is_some() {});
}

/// The joined pair with setpoints dropped by a rule; what an observer at the arm sees, tick by tick.
fn play_with_losses(plan: &PlanReader<'_>, drops: impl Fn(u32) -> bool) -> (Outcome, Controller, [f64; 6]) {
    let mut arm = Controller::new(arm_for(plan));
    // Not the default: so few setpoints ahead that the arm starts before the stream breaks off.
    let mut executor = Executor::new(0, plan, Config { look_ahead: 4, ..Config::default() });
    let period_us = plan.header().control_period_us;
    let (mut now_us, mut seen, mut peak) = (0, Motion::at_rest(arm.pose()), [0.0_f64; 6]);
    loop {
        while let Some(message) = arm.poll(now_us) {
            executor.handle_message(now_us, &message);
        }
        match executor.poll(now_us) {
            Action::Send(ToArm::Setpoint { setpoint, .. }) if drops(setpoint.tick) => {}
            Action::Send(message) => arm.handle_message(now_us, &message),
            Action::Finished(outcome) => return (outcome, arm, peak),
            Action::Wait => {
                now_us += u64::from(period_us);
                while let Some(message) = arm.poll(now_us) {
                    executor.handle_message(now_us, &message);
                }
                seen = seen.moved_to(arm.pose(), period_us);
                for (peak, value) in peak.iter_mut().zip(seen.norms()) {
                    *peak = peak.max(value);
                }
            }
        }
    }
}

fn assert_within(limits: &Limits, peak: [f64; 6]) {
    // Quantisation noise at 0.1 um, 10 ms.
    let noise = [2e-5, 4e-3, 0.7, 2e-5, 4e-3, 0.7];
    for (((limit, bound), value), noise) in limits.derivative_bounds().into_iter().zip(peak).zip(noise) {
        assert!(value <= bound + noise, "{limit}: {value} > {bound}");
    }
}

#[test]
fn a_stream_that_breaks_off_ends_in_a_latched_stop_with_its_reason() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    for from in (5..=120).step_by(5) {
        let (outcome, arm, peak) = play_with_losses(&plan, |tick| tick >= from);
        assert_eq!(fault_code(outcome), Some(FaultCode::SetpointMissing), "from {from}");
        assert_eq!(arm.state(), State::Fault);
        assert!(arm.status().standstill);
        assert_within(&header().limits, peak);
    }
}

fn segment() -> impl Strategy<Value = Move> {
    let offset = -0.06..0.06;
    let angle = -0.35..0.35;
    ([offset.clone(), offset.clone(), offset], [angle.clone(), angle.clone(), angle], 60u32..150)
        .prop_map(|(translation_m, rotation_rad, steps)| Move { translation_m, rotation_rad, steps })
}

proptest! {
    #[test]
    fn random_smooth_plans_arrive(moves in prop::collection::vec(segment(), 1..5), look_ahead in 1u16..=16) {
        let bytes = plan_bytes(&header(), &moves);
        let plan = PlanReader::new(&bytes).unwrap();
        plan.check_limits().unwrap();
        let config = Config { look_ahead, ..Config::default() };
        let result = play(&plan, config, arm_for(&plan), &mut VirtualTime, &mut Unattended);
        prop_assert_eq!(result.outcome, Outcome::Completed);
        // Against the exact, unquantised end: half an LSB and no more.
        let exact: f64 = moves.iter().map(|segment| segment.translation_m[0]).sum();
        let reached = result.final_pose.unwrap().position_m.x - plan.header().start.position_m[0];
        prop_assert!((reached - exact).abs() <= 0.5e-7 * 1.001);
        prop_assert_eq!(result.final_pose, Some(plan.end_pose()));
    }

    #[test]
    fn whatever_is_lost_the_arm_keeps_its_limits_and_arrives_or_says_why(
        moves in prop::collection::vec(segment(), 1..4), seed: u64, one_in in 2u64..60,
    ) {
        let bytes = plan_bytes(&header(), &moves);
        let plan = PlanReader::new(&bytes).unwrap();
        let lost = |tick: u32| {
            let mixed = (seed ^ u64::from(tick)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            (mixed >> 32) % one_in == 0
        };
        let (outcome, arm, peak) = play_with_losses(&plan, lost);
        assert_within(&header().limits, peak);
        match outcome {
            Outcome::Completed => prop_assert_eq!(arm.pose(), plan.end_pose()),
            Outcome::Stopped { fault, standstill } => {
                prop_assert!(standstill);
                // If the very first setpoints are lost the arm never starts; the executor gives up.
                prop_assert!(matches!(fault.code, FaultCode::SetpointMissing | FaultCode::ArmStalled), "{}", fault);
                prop_assert!(arm.status().standstill);
            }
        }
    }
}
