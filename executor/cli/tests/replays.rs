//! What is not ours on the wire: sessions that were recorded, other arms, other executors. In frames, under virtual time.

mod common;

use common::{header, one_move, plan_bytes};
use powderline_executor::{Config, Endpoint, FrameAction, Outcome};
use powderline_firmware_sim::controller::{ArmConfig, Controller};
use powderline_firmware_sim::endpoint::Endpoint as ArmEndpoint;
use powderline_shared::fault::FaultCode;
use powderline_shared::plan::PlanReader;
use powderline_shared::pose::Pose;
use powderline_shared::wire::Context;
use powderline_shared::wire::codec::Encoder;
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::message::{FromArm, Heartbeat, NO_SESSION, Status};
use powderline_shared::wire::state::State;

/// How often both ends are looked after, microseconds.
const STEP_US: u64 = 1_000;

/// A frame to the arm, and when it was sent.
type Recorded = Vec<(u64, Frame)>;

fn arm_for(plan: &PlanReader<'_>, dialect: Dialect, nonce_seed: u64) -> ArmEndpoint {
    let config = ArmConfig { nonce_seed, ..ArmConfig::ideal(plan.header().start_pose()) };
    ArmEndpoint::new(Controller::new(config), dialect)
}

/// Plays to an arm, from a moment on; `overheard` is what somebody else says to the executor at each step.
fn play(
    plan: &PlanReader<'_>,
    dialect: Dialect,
    arm: &mut ArmEndpoint,
    (from_us, config): (u64, Config),
    mut overheard: impl FnMut(u64, &mut Endpoint<'_>) -> Vec<Frame>,
) -> (Outcome, Recorded) {
    let mut endpoint = Endpoint::new(from_us, plan, dialect, config);
    let mut recorded = Recorded::new();
    for now_us in (from_us..).step_by(STEP_US as usize) {
        assert!(now_us < from_us + 30_000_000, "the session never ends");
        while let Some(frame) = arm.poll(now_us) {
            let _ = endpoint.handle_frame(now_us, &frame);
        }
        for frame in overheard(now_us, &mut endpoint) {
            let _ = endpoint.handle_frame(now_us, &frame);
        }
        loop {
            match endpoint.poll(now_us) {
                FrameAction::Send(frame) => {
                    recorded.push((now_us - from_us, frame.clone()));
                    arm.handle_frame(now_us, &frame);
                }
                FrameAction::Wait => break,
                FrameAction::Finished(outcome) => return (outcome, recorded),
            }
        }
    }
    unreachable!("time goes on")
}

/// Says to an arm what was recorded, at the same pace, from a moment on; whether it has moved or was enabled.
fn replay(arm: &mut ArmEndpoint, recorded: &Recorded, from_us: u64) -> bool {
    let (before, mut enabled) = (arm.controller().pose(), false);
    for (at_us, frame) in recorded {
        let now_us = from_us + at_us;
        arm.handle_frame(now_us, frame);
        while arm.poll(now_us).is_some() {}
        enabled |= arm.controller().state() == State::OperationEnabled;
    }
    enabled || arm.controller().pose() != before
}

#[test]
fn a_recorded_session_moves_no_arm_once_more() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    for dialect in Dialect::ALL {
        let mut arm = arm_for(&plan, dialect, 1);
        let (outcome, recorded) = play(&plan, dialect, &mut arm, (0, Config::default()), |_, _| Vec::new());
        assert_eq!(outcome, Outcome::Completed);
        // The very arm, the same after it was off and on, and after its memory has been filled by many others.
        assert!(!replay(&mut arm, &recorded, 10_000_000), "{dialect:?}");
        for nonce_seed in 2..50 {
            assert!(
                !replay(&mut arm_for(&plan, dialect, nonce_seed), &recorded, 0),
                "{dialect:?} {nonce_seed}"
            );
        }
        let mut now_us = 20_000_000;
        for session in 100..120 {
            let config = Config { session, ..Config::default() };
            // The first of them leaves the arm where the plan ends; the others find it there, and leave again.
            let (_, others) = play(&plan, dialect, &mut arm, (now_us, config), |_, _| Vec::new());
            assert!(!others.is_empty());
            now_us += 10_000_000;
        }
        assert!(!replay(&mut arm, &recorded, now_us), "{dialect:?}");
    }
}

#[test]
fn a_latched_stop_is_not_reset_by_what_was_recorded() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    for dialect in Dialect::ALL {
        let stopped = |nonce_seed, session| {
            let mut arm = arm_for(&plan, dialect, nonce_seed);
            let stop = |now_us, endpoint: &mut Endpoint<'_>| {
                if now_us == 300_000 {
                    endpoint.executor_mut().handle_hard_stop(now_us);
                }
                Vec::new()
            };
            play(&plan, dialect, &mut arm, (0, Config { session, ..Config::default() }), stop);
            assert_eq!(arm.controller().fault().map(|fault| fault.code), Some(FaultCode::SoftwareStop));
            arm
        };
        // An arm is stopped, and reset by somebody who has looked: recorded. From where it stands it is not moved.
        let mut arm = stopped(1, 7);
        let config = Config { session: 8, reset: true, ..Config::default() };
        let (outcome, reset) = play(&plan, dialect, &mut arm, (10_000_000, config), |_, _| Vec::new());
        let Outcome::Stopped { fault, standstill: true } = outcome else { panic!("{outcome:?}") };
        assert_eq!((fault.code, arm.controller().fault()), (FaultCode::AnchorElsewhere, None), "{dialect:?}");
        // It is stopped again, and hears the recording: one that gives out its nonces once more would obey.
        for (nonce_seed, obeys) in [(1, true), (2, false)] {
            let mut arm = stopped(nonce_seed, 7);
            let fault = arm.controller().fault();
            replay(&mut arm, &reset, 10_000_000);
            let found = arm.controller().fault();
            assert_eq!(found, fault.filter(|_| !obeys), "{dialect:?}, nonces {nonce_seed}");
        }
    }
}

fn of_nobody(dialect: Dialect, message: FromArm) -> Vec<Frame> {
    Encoder::new(dialect).from_arm(&Context::NONE, &message).collect()
}

fn stands(counter: u8) -> Status {
    Status {
        session: NO_SESSION,
        state: State::SwitchOnDisabled,
        phase: None,
        standstill: true,
        applied_tick: 0,
        have: 0,
        counter,
    }
}

#[test]
fn standstill_and_counters_of_another_arm_count_for_nothing() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    for dialect in Dialect::ALL {
        // It says all the time that it stands, with counters that are ahead of our arm's.
        let foreign = move |now_us: u64| {
            let counter = (now_us / STEP_US * 11 % 256) as u8;
            of_nobody(dialect, FromArm::Status(stands(counter)))
        };
        let mut arm = arm_for(&plan, dialect, 1);
        let (outcome, _) =
            play(&plan, dialect, &mut arm, (0, Config::default()), |now_us, _| foreign(now_us));
        assert_eq!(outcome, Outcome::Completed, "{dialect:?}");
        let mut arm = arm_for(&plan, dialect, 1);
        let (outcome, _) = play(&plan, dialect, &mut arm, (0, Config::default()), |now_us, endpoint| {
            if now_us == 600_000 {
                endpoint.executor_mut().handle_stop(now_us);
            }
            foreign(now_us)
        });
        let Outcome::Stopped { fault, standstill } = outcome else { panic!("{outcome:?}") };
        assert_eq!((fault.code, standstill), (FaultCode::OperatorStop, true));
        assert!(arm.controller().status().standstill, "believed while it moved");
    }
}

#[test]
fn another_arm_on_the_wire_is_named() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    for dialect in Dialect::ALL {
        let mut arm = arm_for(&plan, dialect, 1);
        let heartbeat = FromArm::Heartbeat(Heartbeat { session: NO_SESSION, lost: 0, dropped: 0 });
        let (outcome, _) = play(&plan, dialect, &mut arm, (0, Config::default()), |now_us, _| {
            if now_us % 100_000 == 50_000 { of_nobody(dialect, heartbeat) } else { Vec::new() }
        });
        let Outcome::Stopped { fault, standstill } = outcome else { panic!("{outcome:?}") };
        assert_eq!((fault.code, standstill), (FaultCode::ArmDuplicate, true));
    }
}

/// Both answer the same Open, each with a nonce of its own, and listen to it. On classic CAN the segments of the two answers mix
/// until one comes as a whole; the arm that nobody speaks to then says soon that it is in no session.
#[test]
fn two_arms_that_both_answer_are_named_and_the_other_one_is_not_moved() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    for dialect in Dialect::ALL {
        let mut arms = [1, 2].map(|nonce_seed| arm_for(&plan, dialect, nonce_seed));
        let mut endpoint = Endpoint::new(0, &plan, dialect, Config::default());
        let (fault, moved) = among(&mut arms, &mut endpoint, plan.header().start_pose());
        assert_eq!((fault, moved <= 1), (FaultCode::ArmDuplicate, true), "{dialect:?} {moved}");
    }
}

/// One executor and some arms on one wire: why it stopped, and how many arms are elsewhere than before.
fn among(arms: &mut [ArmEndpoint], endpoint: &mut Endpoint<'_>, start: Pose) -> (FaultCode, usize) {
    for now_us in (0..10_000_000).step_by(STEP_US as usize) {
        for arm in arms.iter_mut() {
            while let Some(frame) = arm.poll(now_us) {
                let _ = endpoint.handle_frame(now_us, &frame);
            }
        }
        loop {
            match endpoint.poll(now_us) {
                FrameAction::Send(frame) => arms.iter_mut().for_each(|arm| arm.handle_frame(now_us, &frame)),
                FrameAction::Wait => break,
                FrameAction::Finished(outcome) => {
                    let Outcome::Stopped { fault, .. } = outcome else { panic!("{outcome:?}") };
                    return (fault.code, arms.iter().filter(|arm| arm.controller().pose() != start).count());
                }
            }
        }
    }
    panic!("the session never ends");
}
