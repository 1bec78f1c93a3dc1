//! What is sent is what is heard.

use nalgebra::{UnitQuaternion, Vector3};
use powderline_shared::displacement::{Lsb, Setpoint};
use powderline_shared::fault::Reported;
use powderline_shared::limits::Limits;
use powderline_shared::pose::Pose;
use powderline_shared::wire::Context;
use powderline_shared::wire::codec::{Encoder, FromArmDecoder, ToArmDecoder};
use powderline_shared::wire::frame::Dialect;
use powderline_shared::wire::message::{FromArm, Heartbeat, NO_SESSION, OpenRequest, Refusal, Status, ToArm};
use powderline_shared::wire::state::{Command, Phase, State};
use proptest::prelude::*;
use proptest::sample::select;

use crate::samples::{self, arm, executor, frames_from_arm, frames_to_arm, heard};

#[test]
fn every_sample_is_heard_as_it_was_sent() {
    for dialect in Dialect::ALL {
        let sent: Vec<ToArm> = samples::to_arm(dialect).into_iter().map(|(_, message)| message).collect();
        let mut decoder = arm(dialect);
        assert_eq!(heard(&frames_to_arm(dialect, &sent), |frame| decoder.handle_frame(frame)), sent);
        assert_eq!(sent.iter().find_map(samples::lsb_of), Some(dialect.lsb()));

        let sent: Vec<FromArm> = samples::from_arm().into_iter().map(|(_, message)| message).collect();
        let mut decoder = executor(dialect);
        assert_eq!(heard(&frames_from_arm(dialect, &sent), |frame| decoder.handle_frame(frame)), sent);
    }
}

fn commands() -> impl Strategy<Value = Command> {
    select(Command::ALL.to_vec())
}

fn dialects() -> impl Strategy<Value = Dialect> {
    select(Dialect::ALL.to_vec())
}

fn contexts() -> impl Strategy<Value = Context> {
    (any::<u16>(), any::<u64>()).prop_map(|(session, seal)| {
        if session == NO_SESSION { Context::NONE } else { Context { session, seal, key: None } }
    })
}

fn faults() -> impl Strategy<Value = Reported> {
    (any::<u16>(), any::<u32>()).prop_map(|(number, tick)| Reported { number, tick })
}

fn refusals() -> impl Strategy<Value = Refusal> {
    prop_oneof![
        any::<u16>().prop_map(|arm| Refusal::Version { arm }),
        (faults(), any::<u32>()).prop_map(|(fault, nonce)| Refusal::Latched { fault, nonce }),
        select(vec![
            Refusal::Busy,
            Refusal::Closed,
            Refusal::Period,
            Refusal::Meaningless,
            Refusal::Coarse,
            Refusal::Counts,
            Refusal::KeyWanted,
            Refusal::Keyless,
            Refusal::KeyOther
        ]),
    ]
}

fn limits() -> impl Strategy<Value = Limits> {
    let number = prop::num::f64::ANY.prop_filter("comparable", |value| !value.is_nan());
    prop::collection::vec(number, 12).prop_map(|values| {
        let [ax, ay, az, bx, by, bz, v, a, j, w, c, k] = values.try_into().unwrap();
        Limits {
            workspace_min_m: [ax, ay, az],
            workspace_max_m: [bx, by, bz],
            linear_velocity_m_s: v,
            linear_acceleration_m_s2: a,
            linear_jerk_m_s3: j,
            angular_velocity_rad_s: w,
            angular_acceleration_rad_s2: c,
            angular_jerk_rad_s3: k,
        }
    })
}

fn requests() -> impl Strategy<Value = OpenRequest> {
    let numbers = (any::<[u16; 3]>(), any::<u64>(), any::<[u32; 4]>());
    (numbers, limits()).prop_map(|((small, plan_hash, large), limits)| {
        let ([version, session, start_level], [period_us, end_tick, translation_nm, rotation_nrad]) =
            (small, large);
        let lsb = Lsb { translation_nm, rotation_nrad };
        OpenRequest {
            version,
            session,
            plan_hash,
            period_us,
            end_tick,
            lsb,
            limits,
            start_level,
            reset_nonce: start_level.into(),
        }
    })
}

fn poses() -> impl Strategy<Value = Pose> {
    (prop::array::uniform3(-9.0..9.0), prop::array::uniform3(-3.0..3.0)).prop_map(|(position, rotation)| {
        Pose {
            position_m: Vector3::from(position),
            orientation: UnitQuaternion::from_scaled_axis(Vector3::from(rotation)),
        }
    })
}

/// State and phase that belong together.
fn states() -> impl Strategy<Value = (State, Option<Phase>)> {
    let phases = [Phase::Armed, Phase::Streaming, Phase::Completing, Phase::Holding];
    (select(State::ALL.to_vec()), select(phases.to_vec()))
        .prop_map(|(state, phase)| (state, (state == State::OperationEnabled).then_some(phase)))
}

/// A walk whose every step is within reach of the classic frames.
fn walks() -> impl Strategy<Value = Vec<Setpoint>> {
    prop::collection::vec((any::<[i16; 6]>(), 1_u32..=127), 1..40).prop_map(|steps| {
        let mut at = Setpoint::ANCHOR;
        let mut walk = Vec::new();
        for (step, ticks) in steps {
            for (count, step) in at.counts.iter_mut().zip(step) {
                *count += i32::from(step);
            }
            at.tick += ticks;
            walk.push(at);
        }
        walk
    })
}

/// Encodes and decodes one message to the arm, both ends in one context.
fn to_arm_and_back(dialect: Dialect, context: Context, message: ToArm) -> Vec<ToArm> {
    let mut decoder = ToArmDecoder::new(dialect);
    decoder.set_context(context);
    let frames: Vec<_> = Encoder::new(dialect).to_arm(&context, &message).collect();
    heard(&frames, |frame| decoder.handle_frame(frame))
}

fn from_arm_and_back(dialect: Dialect, context: Context, near: Setpoint, message: FromArm) -> Vec<FromArm> {
    let mut decoder = FromArmDecoder::new(dialect);
    decoder.set_context(context);
    decoder.expect(near);
    let frames: Vec<_> = Encoder::new(dialect).from_arm(&context, &message).collect();
    heard(&frames, |frame| decoder.handle_frame(frame))
}

proptest! {
    #[test]
    fn records_survive(dialect in dialects(), context in contexts(), request in requests(), session: u16,
                       reason in refusals(), pose in poses()) {
        let message = ToArm::Open(request);
        prop_assert_eq!(to_arm_and_back(dialect, context, message), [message]);
        for message in [
            FromArm::Opened { session, nonce: request.period_us, digest: request.plan_hash },
            FromArm::Refused { session, reason },
            FromArm::Anchored { session, pose },
        ] {
            prop_assert_eq!(from_arm_and_back(dialect, context, Setpoint::ANCHOR, message), [message]);
        }
    }

    #[test]
    fn commands_and_heartbeats_survive(dialect in dialects(), context in contexts(), command in commands(),
                                       own: bool, lost: u16, dropped: u16) {
        let session = if own { context.session } else { NO_SESSION };
        prop_assume!(context != Context::NONE);
        let message = ToArm::Control { session: context.session, command };
        prop_assert_eq!(to_arm_and_back(dialect, context, message), [message]);
        let message = ToArm::Heartbeat { session: context.session };
        prop_assert_eq!(to_arm_and_back(dialect, context, message), [message]);
        let message = FromArm::Heartbeat(Heartbeat { session, lost, dropped });
        prop_assert_eq!(from_arm_and_back(dialect, context, Setpoint::ANCHOR, message), [message]);
    }

    #[test]
    fn status_and_fault_survive_near_an_expected_tick(dialect in dialects(), context in contexts(),
        (state, phase) in states(), standstill: bool, expected: u32, by in -30_000..30_000_i32, have: u16, counter: u8,
        number: u16,
    ) {
        let Context { session, .. } = context;
        let tick = expected.saturating_add_signed(by);
        let near = Setpoint { tick: expected, ..Setpoint::ANCHOR };
        // Without a session nobody knows where ticks are.
        let tick = if session == NO_SESSION { tick & 0xFFFF } else { tick };
        let message = FromArm::Status(Status { session, state, phase, standstill, applied_tick: tick, have, counter });
        prop_assert_eq!(from_arm_and_back(dialect, context, near, message), [message]);
        let message = FromArm::Fault { session, fault: Reported { number, tick } };
        prop_assert_eq!(from_arm_and_back(dialect, context, near, message), [message]);
    }

    #[test]
    fn walks_survive(dialect in dialects(), context in contexts(), walk in walks()) {
        let mut encoder = Encoder::new(dialect);
        let (mut arm, mut executor) = (ToArmDecoder::new(dialect), FromArmDecoder::new(dialect));
        arm.set_context(context);
        executor.set_context(context);
        for setpoint in walk {
            let sent = ToArm::Setpoint { session: context.session, setpoint };
            let frames: Vec<_> = encoder.to_arm(&context, &sent).collect();
            prop_assert_eq!(heard(&frames, |frame| arm.handle_frame(frame)).pop(), Some(sent));
            let sent = FromArm::Actual { session: context.session, reached: setpoint };
            let frames: Vec<_> = encoder.from_arm(&context, &sent).collect();
            prop_assert_eq!(heard(&frames, |frame| executor.handle_frame(frame)), [sent]);
        }
    }
}

#[test]
fn a_tick_without_session_ends_at_sixteen_bits() {
    let fault = Reported { number: 501, tick: 70_000 };
    let message = FromArm::Fault { session: NO_SESSION, fault };
    let cut = FromArm::Fault { session: NO_SESSION, fault: Reported { tick: 65_535, ..fault } };
    let anchor = Setpoint::ANCHOR;
    assert_eq!(from_arm_and_back(Dialect::Classic, Context::NONE, anchor, message), [cut]);
    assert_eq!(from_arm_and_back(Dialect::Fd, Context::NONE, anchor, message), [message]);
}
