//! Messages of every kind, one session of them.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use powderline_shared::displacement::{Lsb, Setpoint};
use powderline_shared::fault::{Fault, FaultCode};
use powderline_shared::limits::Limits;
use powderline_shared::pose::Pose;
use powderline_shared::wire::Context;
use powderline_shared::wire::auth::Key;
use powderline_shared::wire::codec::{Encoder, FromArmDecoder, Rejected, ToArmDecoder};
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::message::{
    FromArm, Heartbeat, NO_SESSION, OpenRequest, PROTOCOL_VERSION, Refusal, Status, ToArm,
};
use powderline_shared::wire::state::{Command, Phase, State};

/// What the arm has opened for the classic [`open_request`], with this nonce.
pub(crate) const CONTEXT: Context = Context { session: 0x1234, seal: 0xcef0_4bf9_5369_9a72, key: None };
pub(crate) const NONCE: u32 = 0x5eed_0001;
pub(crate) const PLAN_HASH: u64 = 0x0123_4567_89ab_cdef;
pub(crate) const SESSION: u16 = CONTEXT.session;
/// Of both ends: bytes 0, 1, .. 31.
pub(crate) fn key() -> Key {
    Key::new(&std::array::from_fn(|at| at as u8))
}
pub(crate) const OWN_NONCE: u64 = 0x1122_3344_5566_7788;

/// The same session between ends that have the key.
pub(crate) fn keyed() -> Context {
    CONTEXT.with_key(key().session(&open_request(Dialect::Classic), OWN_NONCE, NONCE))
}

/// The messages of a session with a key, for those without one.
pub(crate) fn to_arm_keyed(dialect: Dialect) -> Vec<(String, ToArm)> {
    let request = open_request(dialect);
    let mut all = to_arm(dialect);
    all[0].1 = ToArm::OpenKeyed(request, key().prove(&request, OWN_NONCE));
    all
}

/// The same from the arm.
pub(crate) fn from_arm_keyed() -> Vec<(String, FromArm)> {
    let request = open_request(Dialect::Classic);
    let tag = key().answer(&request, OWN_NONCE, NONCE);
    let mut all = from_arm();
    all[0].1 = FromArm::OpenedKeyed { session: SESSION, nonce: NONCE, digest: request.digest(), tag };
    all
}

/// Messages to the arm in an order in which they can be decoded, with their names.
pub(crate) fn to_arm(dialect: Dialect) -> Vec<(String, ToArm)> {
    let mut all = vec![("open".into(), ToArm::Open(open_request(dialect)))];
    for command in Command::ALL {
        all.push((format!("control {command:?}"), ToArm::Control { session: SESSION, command }));
    }
    for setpoint in setpoints() {
        let name = format!("setpoint tick {}", setpoint.tick);
        all.push((name, ToArm::Setpoint { session: SESSION, setpoint }));
    }
    all.push(("heartbeat".into(), ToArm::Heartbeat { session: SESSION }));
    all.push(("stop".into(), ToArm::Stop));
    all
}

/// Messages from the arm in an order in which they can be decoded, with their names.
pub(crate) fn from_arm() -> Vec<(String, FromArm)> {
    let fault = Fault { code: FaultCode::SetpointMissing, tick: 70_000 };
    let digest = open_request(Dialect::Classic).digest();
    let mut all = vec![("opened".into(), FromArm::Opened { session: SESSION, nonce: NONCE, digest })];
    for reason in [
        Refusal::Version { arm: 4 },
        Refusal::Busy,
        Refusal::Closed,
        Refusal::Latched { fault: fault.into(), nonce: 0x5eed_0002 },
        Refusal::Period,
        Refusal::Meaningless,
        Refusal::Coarse,
        Refusal::Counts,
        Refusal::KeyWanted,
        Refusal::Keyless,
        Refusal::KeyOther,
    ] {
        all.push((format!("refused {reason:?}"), FromArm::Refused { session: SESSION, reason }));
    }
    all.push(("anchored".into(), FromArm::Anchored { session: SESSION, pose: anchor() }));
    for reached in setpoints() {
        all.push((format!("actual tick {}", reached.tick), FromArm::Actual { session: SESSION, reached }));
    }
    all.extend(statuses().into_iter().map(|(name, status)| (name, FromArm::Status(status))));
    let early = Fault { tick: 41, ..fault };
    all.push(("fault".into(), FromArm::Fault { session: SESSION, fault: early.into() }));
    let unbound = Fault { code: FaultCode::OperatorStop, tick: 40_000 };
    all.push(("fault without session".into(), FromArm::Fault { session: NO_SESSION, fault: unbound.into() }));
    let heartbeat = Heartbeat { session: SESSION, lost: 2, dropped: 513 };
    all.push(("heartbeat".into(), FromArm::Heartbeat(heartbeat)));
    let idle = Heartbeat { session: NO_SESSION, lost: 0, dropped: 7 };
    all.push(("heartbeat without session".into(), FromArm::Heartbeat(idle)));
    all
}

/// Cumulative displacements that leave the 16 bits of the classic frames, each within reach of the one before.
pub(crate) fn setpoints() -> [Setpoint; 5] {
    let at = |tick, counts| Setpoint { tick, counts };
    [
        at(1, [1, -1, 0, 2, -2, 0]),
        at(2, [25_000, -25_000, 300, 31_000, -31_000, 5]),
        at(3, [50_000, -50_000, 600, 62_000, -62_000, 10]),
        at(4, [70_000, -80_000, 900, 93_000, -93_000, 15]),
        at(100, [70_001, -80_001, 901, 93_001, -93_001, 16]),
    ]
}

fn statuses() -> Vec<(String, Status)> {
    let mut all = Vec::new();
    let idle = Status {
        session: NO_SESSION,
        state: State::SwitchOnDisabled,
        phase: None,
        standstill: true,
        applied_tick: 0,
        have: 0,
        counter: 255,
    };
    all.push(("status without session".into(), idle));
    for (counter, state) in (0..).zip(State::ALL) {
        let standstill = !matches!(state, State::FaultReactionActive);
        let phase = (state == State::OperationEnabled).then_some(Phase::Armed);
        let status = Status { session: SESSION, state, phase, standstill, counter, ..idle };
        all.push((format!("status {}", state.name()), status));
    }
    for (applied_tick, phase) in [(41, Phase::Streaming), (300, Phase::Completing), (310, Phase::Holding)] {
        let status = Status {
            session: SESSION,
            state: State::OperationEnabled,
            phase: Some(phase),
            standstill: phase == Phase::Holding,
            applied_tick,
            have: 0b1011,
            counter: 9,
        };
        all.push((format!("status {phase:?}"), status));
    }
    all
}

pub(crate) fn open_request(dialect: Dialect) -> OpenRequest {
    OpenRequest {
        version: PROTOCOL_VERSION,
        session: SESSION,
        plan_hash: PLAN_HASH,
        period_us: 10_000,
        end_tick: 600,
        lsb: dialect.lsb(),
        limits: Limits {
            workspace_min_m: [-0.25, -0.5, 0.0],
            workspace_max_m: [0.5, 0.5, 0.75],
            linear_velocity_m_s: 0.5,
            linear_acceleration_m_s2: 2.0,
            linear_jerk_m_s3: 40.0,
            angular_velocity_rad_s: 2.0,
            angular_acceleration_rad_s2: 10.0,
            angular_jerk_rad_s3: 200.0,
        },
        start_level: 4,
        reset_nonce: 0,
    }
}

fn anchor() -> Pose {
    Pose {
        position_m: Vector3::new(0.1, 0.2, 0.3),
        orientation: UnitQuaternion::new_unchecked(Quaternion::new(0.5, 0.5, -0.5, 0.5)),
    }
}

pub(crate) fn arm(dialect: Dialect) -> ToArmDecoder {
    let mut decoder = ToArmDecoder::new(dialect);
    decoder.set_context(CONTEXT);
    decoder
}

pub(crate) fn executor(dialect: Dialect) -> FromArmDecoder {
    let mut decoder = FromArmDecoder::new(dialect);
    decoder.set_context(CONTEXT);
    decoder
}

/// All frames of some messages, by one encoder.
pub(crate) fn frames_to_arm(dialect: Dialect, messages: &[ToArm]) -> Vec<Frame> {
    let mut encoder = Encoder::new(dialect);
    messages.iter().flat_map(|message| encoder.to_arm(&CONTEXT, message)).collect()
}

/// All frames of some messages.
pub(crate) fn frames_from_arm(dialect: Dialect, messages: &[FromArm]) -> Vec<Frame> {
    let encoder = Encoder::new(dialect);
    messages.iter().flat_map(|message| encoder.from_arm(&CONTEXT, message)).collect()
}

/// What a decoder makes of some frames, each of which it must take.
pub(crate) fn heard<M, const N: usize>(
    frames: &[Frame],
    mut handle: impl FnMut(&Frame) -> Result<heapless::Vec<M, N>, Rejected>,
) -> Vec<M> {
    frames.iter().flat_map(|frame| handle(frame).unwrap()).collect()
}

pub(crate) fn setpoint(tick: u32, counts: [i32; 6]) -> ToArm {
    ToArm::Setpoint { session: SESSION, setpoint: Setpoint { tick, counts } }
}

pub(crate) fn lsb_of(message: &ToArm) -> Option<Lsb> {
    if let ToArm::Open(request) = message { Some(request.lsb) } else { None }
}
