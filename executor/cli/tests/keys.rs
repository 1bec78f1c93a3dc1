//! Ends with a key, and whoever has another one, or none, between them. In frames, under virtual time.

mod common;

use common::{header, one_move, plan_bytes};
use powderline_executor::{Config, Endpoint, FrameAction, Outcome};
use powderline_firmware_sim::controller::{ArmConfig, Controller};
use powderline_firmware_sim::endpoint::Endpoint as ArmEndpoint;
use powderline_shared::fault::FaultCode;
use powderline_shared::plan::PlanReader;
use powderline_shared::wire::Context;
use powderline_shared::wire::auth::{Key, MOST_WRONG_TAGS};
use powderline_shared::wire::codec::{Encoder, FromArmDecoder};
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::ids;
use powderline_shared::wire::message::{FromArm, Refusal};
use powderline_shared::wire::state::State;

/// How often both ends are looked after, microseconds.
const STEP_US: u64 = 1_000;

fn key(byte: u8) -> Key {
    Key::new(&[byte; 32])
}

fn config(key: Option<Key>, nonce: u64) -> Config {
    Config { key, nonce, ..Config::default() }
}

fn arm_for(plan: &PlanReader<'_>, dialect: Dialect, key: Option<Key>, nonce_seed: u64) -> ArmEndpoint {
    let config = ArmConfig { nonce_seed, key, ..ArmConfig::ideal(plan.header().start_pose()) };
    ArmEndpoint::new(Controller::new(config), dialect)
}

/// Which way a frame goes.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Way {
    ToArm,
    FromArm,
}

/// How a session ended, why it was refused, and all that was said to the arm, with the moment.
struct Played {
    outcome: Outcome,
    refusal: Option<Refusal>,
    said: Vec<(u64, Frame)>,
}

impl Played {
    #[track_caller]
    fn is_stopped(&self, code: FaultCode) {
        let Outcome::Stopped { fault, .. } = self.outcome else { panic!("{:?}", self.outcome) };
        assert_eq!(fault.code, code);
    }
}

/// Plays; `between` is whoever stands between the ends, and hands on what it likes of each frame.
fn play(
    plan: &PlanReader<'_>,
    dialect: Dialect,
    arm: &mut ArmEndpoint,
    (from_us, config): (u64, Config),
    mut between: impl FnMut(u64, Way, Frame) -> Vec<Frame>,
) -> Played {
    let mut endpoint = Endpoint::new(from_us, plan, dialect, config);
    let mut said = Vec::new();
    for now_us in (from_us..from_us + 30_000_000).step_by(STEP_US as usize) {
        while let Some(frame) = arm.poll(now_us) {
            for frame in between(now_us, Way::FromArm, frame) {
                let _ = endpoint.handle_frame(now_us, &frame);
            }
        }
        loop {
            match endpoint.poll(now_us) {
                FrameAction::Send(frame) => {
                    said.push((now_us, frame.clone()));
                    between(now_us, Way::ToArm, frame)
                        .iter()
                        .for_each(|frame| arm.handle_frame(now_us, frame));
                }
                FrameAction::Wait => break,
                FrameAction::Finished(outcome) => {
                    return Played { outcome, refusal: endpoint.executor().refusal(), said };
                }
            }
        }
    }
    panic!("the session never ends")
}

fn nobody(_: u64, _: Way, frame: Frame) -> Vec<Frame> {
    vec![frame]
}

#[test]
fn with_the_same_key_a_plan_is_played_as_without() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    for dialect in Dialect::ALL {
        let ends = [None, Some(key(1))].map(|key| {
            let mut arm = arm_for(&plan, dialect, key, 1);
            let played = play(&plan, dialect, &mut arm, (0, config(key, 5)), nobody);
            assert_eq!(played.outcome, Outcome::Completed, "{dialect:?}");
            arm.controller().pose()
        });
        assert_eq!(ends[0], ends[1]);
    }
}

#[test]
fn ends_that_do_not_agree_on_a_key_say_so_and_nothing_moves() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    for dialect in Dialect::ALL {
        for (own, arms, reason) in [
            (Some(key(1)), Some(key(2)), Refusal::KeyOther),
            (Some(key(1)), None, Refusal::Keyless),
            (None, Some(key(2)), Refusal::KeyWanted),
        ] {
            let mut arm = arm_for(&plan, dialect, arms, 1);
            let played = play(&plan, dialect, &mut arm, (0, config(own, 5)), nobody);
            played.is_stopped(FaultCode::SessionRefused);
            assert_eq!(played.refusal, Some(reason));
            assert_eq!(arm.controller().key_refusal().map(|(_, reason)| reason), Some(reason));
            assert!(arm.controller().request().is_none() && !arm.controller().has_moved());
        }
    }
}

#[test]
fn an_answer_without_the_key_is_no_answer() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let dialect = Dialect::Fd;
    // Somebody answers in the arm's place: as an arm without a key, or with a tag of another one.
    for with_tag in [false, true] {
        let mut arm = arm_for(&plan, dialect, Some(key(1)), 1);
        let played = play(&plan, dialect, &mut arm, (0, config(Some(key(1)), 5)), |_, way, frame| {
            if way == Way::ToArm || frame.id != ids::HANDSHAKE_FROM_ARM {
                return vec![frame];
            }
            let mut decoder = FromArmDecoder::new(dialect);
            let said = decoder.handle_frame(&frame).unwrap_or_default();
            let Some(FromArm::OpenedKeyed { session, nonce, digest, mut tag }) = said.first().copied() else {
                return vec![frame];
            };
            tag.0[7] ^= 1;
            let plain = FromArm::Opened { session, nonce, digest };
            let other = FromArm::OpenedKeyed { session, nonce, digest, tag };
            Encoder::new(dialect).from_arm(&Context::NONE, if with_tag { &other } else { &plain }).collect()
        });
        played.is_stopped(FaultCode::ArmUnproven);
        assert!(!arm.controller().has_moved());
    }
}

#[test]
fn a_recorded_session_moves_nothing() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    for dialect in Dialect::ALL {
        let mut arm = arm_for(&plan, dialect, Some(key(1)), 1);
        let played = play(&plan, dialect, &mut arm, (0, config(Some(key(1)), 5)), nobody);
        assert_eq!(played.outcome, Outcome::Completed);
        for nonce_seed in 2..30 {
            let mut arm = arm_for(&plan, dialect, Some(key(1)), nonce_seed);
            for (at_us, frame) in &played.said {
                arm.handle_frame(*at_us, frame);
                while arm.poll(*at_us).is_some() {}
                assert_ne!(arm.controller().state(), State::ReadyToSwitchOn);
            }
            assert!(!arm.controller().has_moved());
        }
    }
}

/// The low bit of a data byte, flipped.
fn flipped(mut frame: Frame, byte: usize) -> Frame {
    frame.data[byte] ^= 1;
    frame
}

/// Plays with a forged setpoint before each right one, so that it would be the first of its tick: what came of it, how many were forged, and the
/// arm.
fn guessed_setpoints(dialect: Dialect, byte: usize, nonce: u64) -> (Played, u32, ArmEndpoint) {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let mut arm = arm_for(&plan, dialect, Some(key(1)), 1);
    let mut guesses = 0;
    let played = play(&plan, dialect, &mut arm, (0, config(Some(key(1)), nonce)), |now_us, way, frame| {
        let forged = way == Way::ToArm && frame.id == ids::SETPOINT_T && now_us > 300_000;
        guesses += u32::from(forged);
        if forged { vec![flipped(frame.clone(), byte), frame] } else { vec![frame] }
    });
    (played, guesses, arm)
}

/// On eight bytes one guess in 256 is right, and the arm stops for what it says: a setpoint that is another than the one after it.
#[test]
fn guessed_setpoints_stop_an_arm_on_eight_bytes_and_are_dropped_elsewhere() {
    let mut right = 0;
    for nonce in 0..16 {
        let (played, guesses, arm) = guessed_setpoints(Dialect::Classic, 0, nonce);
        let code = arm.controller().fault().map(|fault| fault.code).unwrap();
        played.is_stopped(code);
        assert!(arm.controller().status().standstill);
        match code {
            FaultCode::WrongTags => assert!((MOST_WRONG_TAGS..MOST_WRONG_TAGS + 20).contains(&guesses)),
            FaultCode::SetpointRepeated => right += 1,
            other => panic!("{other:?} with nonce {nonce}"),
        }
    }
    // Half a guess is to be expected.
    assert!(right <= 3, "{right}");
    let (played, guesses, _) = guessed_setpoints(Dialect::Fd, 12, 5);
    assert!(played.outcome == Outcome::Completed && guesses > 50, "{:?}, {guesses}", played.outcome);
}

#[test]
fn guessed_reports_stop_an_arm_on_eight_bytes() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let mut arm = arm_for(&plan, Dialect::Classic, Some(key(1)), 1);
    let played =
        play(&plan, Dialect::Classic, &mut arm, (0, config(Some(key(1)), 5)), |now_us, way, frame| {
            let forged = way == Way::FromArm && frame.id == ids::STATUS && now_us > 300_000;
            if forged { vec![flipped(frame.clone(), 4), frame] } else { vec![frame] }
        });
    played.is_stopped(FaultCode::WrongTags);
    assert!(arm.controller().status().standstill);
}

/// An executor that is gone is not replaced by its own heartbeats, said again.
#[test]
fn recorded_heartbeats_of_a_session_keep_no_arm_alive() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    for dialect in Dialect::ALL {
        let alive = |key: Option<Key>| {
            let mut arm = arm_for(&plan, dialect, key, 1);
            let mut endpoint = Endpoint::new(0, &plan, dialect, config(key, 5));
            let mut heartbeats = Vec::new();
            for now_us in (0..3_000_000).step_by(STEP_US as usize) {
                while let Some(frame) = arm.poll(now_us) {
                    let _ = endpoint.handle_frame(now_us, &frame);
                }
                // It moves none of the arm, and is gone after half a second.
                while let FrameAction::Send(frame) = endpoint.poll(now_us) {
                    if now_us >= 500_000 {
                        break;
                    }
                    match frame.id {
                        ids::HEARTBEAT_TO_ARM => heartbeats.push(frame.clone()),
                        ids::SETPOINT_T | ids::SETPOINT_R => continue,
                        _ => {}
                    }
                    arm.handle_frame(now_us, &frame);
                }
                if now_us >= 500_000 && now_us % 50_000 == 0 {
                    heartbeats.iter().for_each(|frame| arm.handle_frame(now_us, frame));
                }
            }
            assert!(!heartbeats.is_empty());
            arm.controller().state() == State::OperationEnabled
        };
        assert_eq!([None, Some(key(1))].map(alive), [true, false], "{dialect:?}");
    }
}
