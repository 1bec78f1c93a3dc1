//! The arm's controller: states, session, playback by its own clock, limits on everything, stops by itself.
//!
//! At each tick exactly one pose is commanded for the next, in this order of preference:
//!
//! 1. the setpoint of the next tick;
//! 2. it is missing but the one after is there: the path of constant jerk to that one (loss of single setpoints heals);
//! 3. nothing is there: the begin of a stop, for at most [`BRIDGED_TICKS`] ticks;
//! 4. still nothing, or any limit broken: the rest of the stop, latched.
//!
//! Nobody is trusted to be there: a session that is not heard of for [`ArmConfig::watchdog_us`] is over, with a latched fault if
//! operation is enabled, moving or not. A controller that was itself held up for too long while it moved ([`OVERRUN_TICKS`], [`OVERRUN_US`])
//! does not make up for lost time, it stops: the drives have begun to without it.
//!
//! Every commanded pose but those of a latched stop passes the limit check first. A stop keeps the limits in force, or, if
//! they would make it take longer than [`GENTLE_STOP_US`], the arm's own ones; see [`crate::stop`] for its bound in time. What
//! the joints cannot do they are not told, in a stop either: where they could not follow one of the tool, they brake by
//! themselves. What has been commanded for a tick is done, and what has come to rest stays where it is.

use std::collections::VecDeque;

use nalgebra::Vector3;
use powderline_shared::arm::{ArmError, ArmModel, Joints};
use powderline_shared::displacement::{Displacement, Lsb, Setpoint, pose_at};
use powderline_shared::fault::{Fault, FaultCode, Side};
use powderline_shared::following::{Following, FollowingWatch};
use powderline_shared::limits::{Limits, Motion, PeakUse, Violation};
use powderline_shared::pose::Pose;
use powderline_shared::wire::Context;
use powderline_shared::wire::auth::{Key, Proof};
use powderline_shared::wire::message::{
    BRIDGED_TICKS, FromArm, HEARTBEAT_US, Heartbeat, OpenRequest, Refusal, Status, ToArm,
};
use powderline_shared::wire::state::{Command, Phase, State};

use crate::arm::servo::Lag;
use crate::arm::{Arm, JointMotion, Target};
use crate::buffer::Refused;
use crate::interpolator::{Commanded, Interpolator};
pub use crate::session::LONGEST_PERIOD_US;
use crate::session::{self, Anchored, Session};
use crate::stop::{GENTLE_STOP_US, JointStop, StopProfile};

/// Ticks that a controller may be late before it gives up and stops, or [`OVERRUN_US`] if that is more.
pub const OVERRUN_TICKS: u64 = 2;

/// Time that a controller may be late with ticks that are shorter, microseconds. The arm's drives go on by themselves for
/// that; left alone for longer, they brake by themselves.
pub const OVERRUN_US: u64 = 20_000;

/// Ticks on the last setpoint after which velocity, acceleration and jerk are zero.
const SETTLE_TICKS: u32 = 3;

/// How near to its command an arm has to be to count as settled, LSB: it then reports the very counts of its setpoint.
const SETTLED_LSB: f64 = 0.25;

/// How long an arm may take to settle, microseconds.
const LONGEST_SETTLING_US: u64 = 500_000;

/// Ticks during which a bridged setpoint still shows in the jerk.
const BRIDGE_ECHO_TICKS: u32 = 3;

/// Nonces drawn for a session; one in a dozen makes a key that could be taken for another one.
const MOST_DRAWS: u32 = 1_000;

/// Ticks kept for whoever writes down the motion: more than a stop has that is over when a controller wakes up.
const TICKS_KEPT: usize = 20_000;

/// Messages kept for a reader that is late; the oldest go first.
const OUTBOX_CAPACITY: usize = 256;

/// What a simulated arm is.
#[derive(Clone, Copy, Debug)]
pub struct ArmConfig {
    /// Its own limits; a session can only tighten them.
    pub limits: Limits,
    /// The mechanics, standing where it stands at power on.
    pub arm: Arm,
    /// When a session that is not heard of is over, microseconds.
    pub watchdog_us: u64,
    /// How far it may be from where it is told to be.
    pub following: Following,
    /// What its nonces come from: a number that is another one at each power on.
    pub nonce_seed: u64,
    /// The key that whoever opens a session must have too; without one, anybody may.
    pub key: Option<Key>,
}

/// When a session that is not heard of is over, unless the configuration says otherwise, microseconds.
pub const DEFAULT_WATCHDOG_US: u64 = 3 * HEARTBEAT_US;

impl ArmConfig {
    /// An ideal arm standing at `pose` that is about as quick as research arms are: linear limits as published for the
    /// Franka arm, two wrist joints of pi rad/s turning together, and 2 m of reach.
    #[must_use]
    pub fn ideal(pose: Pose) -> Self {
        let limits = Limits {
            workspace_min_m: [-2.0; 3],
            workspace_max_m: [2.0; 3],
            linear_velocity_m_s: 3.0,
            linear_acceleration_m_s2: 9.0,
            linear_jerk_m_s3: 4_500.0,
            angular_velocity_rad_s: core::f64::consts::TAU,
            angular_acceleration_rad_s2: 50.0,
            angular_jerk_rad_s3: 8_500.0,
        };
        Self {
            limits,
            arm: Arm::ideal(pose),
            watchdog_us: DEFAULT_WATCHDOG_US,
            following: Following::default(),
            nonce_seed: 0,
            key: None,
        }
    }

    /// An arm with joints, its tool at `pose`, with the same Cartesian limits: its joints have their own.
    ///
    /// # Errors
    /// It cannot stand there.
    pub fn jointed(model: ArmModel, pose: Pose) -> Result<Self, ArmError> {
        Ok(Self { arm: Arm::new(model, Lag::default(), pose)?, ..Self::ideal(pose) })
    }
}

/// Where the tool was at one tick, and in whose motion: by the time that somebody asks, the session may be over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tick {
    /// The session that moves the arm.
    pub context: Context,
    /// Its plan.
    pub plan_hash: u64,
    /// Its control period.
    pub period_us: u32,
    /// Where the tool was.
    pub pose: Pose,
    /// Where the joints were, radians, if there are any.
    pub joints: Option<Joints>,
}

/// The simulated controller, with its arm.
#[derive(Clone, Debug)]
pub struct Controller {
    own_limits: Limits,
    watchdog_us: u64,
    following: Following,
    watch: FollowingWatch,
    nonces: Nonces,
    key: Option<Key>,
    /// The last session that was refused because of the key.
    key_refusal: Option<(u16, Refusal)>,
    /// What one count is worth on the wire, if it is at the end of one.
    counts: Option<Lsb>,
    /// What resets a latched stop.
    challenge: Option<u32>,
    /// How the session before ended.
    farewell: Option<Status>,
    state: State,
    session: Option<Session>,
    arm: Arm,
    /// Up to when the arm has moved.
    followed_us: u64,
    /// Since when its command rests on the last pose of a motion.
    resting_since_us: Option<u64>,
    path: Interpolator,
    motion: Motion,
    /// The same of the joints, if there are any.
    turning: Option<JointMotion>,
    activity: Activity,
    next_tick_us: Option<u64>,
    fault: Option<Fault>,
    violation: Option<Violation>,
    dropped: u16,
    /// Of the next status.
    counter: u8,
    heard_us: u64,
    heartbeat_at_us: u64,
    outbox: VecDeque<FromArm>,
    /// Where the arm was at the last ticks, if anybody has asked; the first of a motion is its anchor.
    ticks: Option<VecDeque<Tick>>,
    has_moved: bool,
    closed: ClosedSessions,
}

/// Sessions that are over, the oldest forgotten first. What is left of them on the wire opens them no more, and no other is
/// opened that it could be taken for.
#[derive(Clone, Copy, Debug)]
struct ClosedSessions {
    contexts: [Context; 16],
    next: usize,
}

impl Default for ClosedSessions {
    fn default() -> Self {
        Self { contexts: [Context::NONE; 16], next: 0 }
    }
}

impl ClosedSessions {
    fn add(&mut self, context: Context) {
        if let Some(slot) = self.contexts.get_mut(self.next) {
            *slot = context;
        }
        self.next = self.next.wrapping_add(1).checked_rem(self.contexts.len()).unwrap_or(0);
    }

    fn has(&self, session: u16) -> bool {
        self.known().any(|closed| closed.session == session)
    }

    fn resemble(&self, context: &Context) -> bool {
        self.known().any(|closed| closed.resembles(context))
    }

    fn known(&self) -> impl Iterator<Item = &Context> {
        self.contexts.iter().filter(|closed| **closed != Context::NONE)
    }
}

/// What the clock drives.
#[derive(Clone, Copy, Debug)]
enum Activity {
    /// Nothing; the arm stands.
    Still,
    /// The stream of setpoints; a stop has begun if setpoints are missing.
    Following { bridge: Option<(StopProfile, u32)> },
    /// On the last setpoint, for so many more ticks.
    Settling { ticks_left: u32 },
    /// A stop.
    Stopping(Stop),
}

/// Which way a stop goes.
#[derive(Clone, Copy, Debug)]
enum Stop {
    /// The tool's.
    Tool(StopProfile),
    /// That of joints which cannot follow the tool's.
    Joints(JointStop),
}

/// Numbers that do not come again: SplitMix64 (G. L. Steele, D. Lea and C. H. Flood, OOPSLA 2014). They tell what was recorded
/// from what is meant; who listens knows them.
#[derive(Clone, Copy, Debug)]
struct Nonces(u64);

impl Nonces {
    /// The next one, which is not 0.
    fn next(&mut self) -> u32 {
        loop {
            self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            let [_, _, _, _, a, b, c, d] = (mixed ^ (mixed >> 31)).to_le_bytes();
            let nonce = u32::from_le_bytes([a, b, c, d]);
            if nonce != 0 {
                return nonce;
            }
        }
    }
}

impl Controller {
    /// Power on. The self-test of the simulation is over at once (transitions 0 and 1).
    #[must_use]
    pub fn new(config: ArmConfig) -> Self {
        let mut controller = Self {
            own_limits: config.limits,
            watchdog_us: config.watchdog_us,
            following: config.following,
            watch: FollowingWatch::new(config.following),
            nonces: Nonces(config.nonce_seed),
            key: config.key,
            key_refusal: None,
            counts: None,
            challenge: None,
            farewell: None,
            state: State::SwitchOnDisabled,
            session: None,
            arm: config.arm,
            followed_us: 0,
            resting_since_us: None,
            path: Interpolator::hold(*config.arm.told()),
            motion: Motion::at_rest(config.arm.told().pose),
            turning: config.arm.told().joints.map(JointMotion::at_rest),
            activity: Activity::Still,
            next_tick_us: None,
            fault: None,
            violation: None,
            dropped: 0,
            counter: 0,
            heard_us: 0,
            // Now: the first thing that it does is to say that it is there.
            heartbeat_at_us: 0,
            outbox: VecDeque::new(),
            ticks: None,
            has_moved: false,
            closed: ClosedSessions::default(),
        };
        controller.report();
        controller
    }

    /// Takes in one message.
    pub fn handle_message(&mut self, now_us: u64, message: &ToArm) {
        self.advance(now_us);
        match *message {
            ToArm::Open(request) => self.open(now_us, &request, None),
            ToArm::OpenKeyed(request, proof) => self.open(now_us, &request, Some(proof)),
            ToArm::Control { session, command } if self.is_current(session) => {
                self.heard_us = now_us;
                self.command(command);
            }
            ToArm::Control { session, .. } if self.is_over(session) => self.repeat_farewell(),
            ToArm::Setpoint { session, setpoint } if self.is_current(session) => {
                self.setpoint(now_us, setpoint);
            }
            ToArm::Heartbeat { session } if self.is_current(session) => self.heard_us = now_us,
            ToArm::Stop => self.hard_stop(),
            ToArm::Control { .. } | ToArm::Setpoint { .. } | ToArm::Heartbeat { .. } => self.drop_one(),
        }
        self.advance(now_us);
    }

    /// A message that could not be understood.
    pub fn handle_rejected(&mut self) {
        self.drop_one();
    }

    /// Somebody without the key speaks on the wire, and guesses: an arm that could be moved stops.
    pub fn handle_wrong_tags(&mut self) {
        if self.state == State::OperationEnabled {
            self.stop(State::FaultReactionActive, FaultCode::WrongTags);
        }
    }

    /// Lets time pass. What the arm says about it waits for the next poll.
    pub fn let_pass(&mut self, now_us: u64) {
        self.advance(now_us);
    }

    /// Lets time pass; then the next message to the executor, if any. Call until `None`.
    pub fn poll(&mut self, now_us: u64) -> Option<FromArm> {
        self.advance(now_us);
        self.outbox.pop_front()
    }

    /// When to poll next, at the latest.
    #[must_use]
    pub fn poll_at(&self) -> u64 {
        let due = [self.next_tick_us, self.session_ends_us()].into_iter().flatten();
        due.fold(self.heartbeat_at_us, u64::min)
    }

    /// Whether it has moved since power on.
    #[must_use]
    pub fn has_moved(&self) -> bool {
        self.has_moved
    }

    /// Where the arm was at the ticks since this was asked last, the oldest first; nothing the first time. The last 20,000 are
    /// kept.
    pub fn take_ticks(&mut self) -> impl Iterator<Item = Tick> + '_ {
        self.ticks.get_or_insert_default().drain(..)
    }

    /// When the next tick is due; `None` while nothing moves.
    #[must_use]
    pub fn next_tick_us(&self) -> Option<u64> {
        self.next_tick_us
    }

    /// The anchor of the session, if it has one.
    #[must_use]
    pub fn anchor(&self) -> Option<Pose> {
        self.anchored().map(|anchored| anchored.anchor)
    }

    /// Where the tool is, as of the last poll.
    #[must_use]
    pub fn pose(&self) -> Pose {
        self.arm.pose()
    }

    /// What is commanded for the next tick, with its derivatives.
    #[must_use]
    pub fn motion(&self) -> &Motion {
        &self.motion
    }

    /// The state.
    #[must_use]
    pub fn state(&self) -> State {
        self.state
    }

    /// The latched fault.
    #[must_use]
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// The last session that was refused because of the key, and why.
    #[must_use]
    pub fn key_refusal(&self) -> Option<(u16, Refusal)> {
        self.key_refusal
    }

    /// The numbers behind a latched limit fault.
    #[must_use]
    pub fn violation(&self) -> Option<Violation> {
        self.violation
    }

    /// How much of the limits in force the accepted setpoints have used.
    #[must_use]
    pub fn peak_use(&self) -> Option<PeakUse> {
        self.anchored().map(|anchored| anchored.checker.peak_use())
    }

    /// The limits in force: the arm's own, tightened by the session's.
    #[must_use]
    pub fn limits(&self) -> Limits {
        self.session.as_ref().map_or(self.own_limits, |session| session.limits)
    }

    fn anchored(&self) -> Option<&Anchored> {
        self.session.as_ref()?.anchored.as_ref()
    }

    fn anchored_mut(&mut self) -> Option<&mut Anchored> {
        self.session.as_mut()?.anchored.as_mut()
    }

    fn is_current(&self, session: u16) -> bool {
        self.session.as_ref().is_some_and(|open| open.request.session == session)
    }

    fn drop_one(&mut self) {
        self.dropped = self.dropped.saturating_add(1);
    }

    // --- session and states ---

    /// Says what one count is worth on the wire that it is joined to; sessions of other counts are refused.
    pub fn set_counts(&mut self, lsb: Lsb) {
        self.counts = Some(lsb);
    }

    fn open(&mut self, now_us: u64, request: &OpenRequest, proof: Option<Proof>) {
        let (session, digest) = (request.session, request.digest());
        if let Err(reason) = self.check_proof(request, proof) {
            self.key_refusal = Some((session, reason));
            return self.send(FromArm::Refused { session, reason });
        }
        if self.answers_challenge(request) {
            self.leave_operation(State::SwitchOnDisabled);
        }
        // A repeated request is answered again, for the answer may have been lost; one that differs in anything is another.
        let same = |open: &&Session| open.request.digest() == digest && open.proof == proof;
        let open = self.session.as_ref().filter(same);
        let repeated = open.filter(|_| self.may_open()).map(|open| open.nonce);
        let nonce = match repeated.map_or_else(|| self.admit(request), Ok) {
            Ok(nonce) => nonce,
            Err(reason) => return self.send(FromArm::Refused { session, reason }),
        };
        self.heard_us = now_us;
        if repeated.is_none() {
            // Power that one session has left on is not another one's.
            if self.state == State::SwitchedOn {
                self.state = State::SwitchOnDisabled;
            }
            let context = self.context_of(request, proof, nonce);
            self.session = Some(Session::new((request, proof), &self.own_limits, (context, nonce)));
        }
        self.send(match self.key.zip(proof) {
            Some((key, proof)) => {
                let tag = key.answer(request, proof.nonce, nonce);
                FromArm::OpenedKeyed { session, nonce, digest, tag }
            }
            None => FromArm::Opened { session, nonce, digest },
        });
        self.report();
    }

    /// Before anything else is looked at: whether the request comes from somebody who may ask.
    fn check_proof(&self, request: &OpenRequest, proof: Option<Proof>) -> Result<(), Refusal> {
        match (self.key, proof) {
            (None, None) => Ok(()),
            (Some(key), Some(proof)) if key.proves(request, &proof) => Ok(()),
            (Some(_), Some(_)) => Err(Refusal::KeyOther),
            (Some(_), None) => Err(Refusal::KeyWanted),
            (None, Some(_)) => Err(Refusal::Keyless),
        }
    }

    fn context_of(&self, request: &OpenRequest, proof: Option<Proof>, nonce: u32) -> Context {
        let context = Context::sealed(request, nonce);
        match self.key.zip(proof) {
            Some((key, proof)) => context.with_key(key.session(request, proof.nonce, nonce)),
            None => context,
        }
    }

    /// The nonce of the session that is opened for the request.
    fn admit(&mut self, request: &OpenRequest) -> Result<u32, Refusal> {
        let latched = self.fault.is_some() && self.is_current(request.session);
        if self.closed.has(request.session) || latched {
            return Err(Refusal::Closed);
        }
        if let Some(fault) = self.fault {
            let nonces = &mut self.nonces;
            let nonce = *self.challenge.get_or_insert_with(|| nonces.next());
            return Err(Refusal::Latched { fault: fault.into(), nonce });
        }
        if self.session.is_some() || !self.may_open() {
            return Err(Refusal::Busy);
        }
        session::admit(request, &self.own_limits, self.counts)?;
        Ok(self.fresh_nonce(request))
    }

    /// Once operation is enabled it is too late.
    fn may_open(&self) -> bool {
        self.fault.is_none()
            && matches!(self.state, State::SwitchOnDisabled | State::ReadyToSwitchOn | State::SwitchedOn)
    }

    /// One that makes a key of its own: unlike that of no session, and unlike those of the last sessions.
    fn fresh_nonce(&mut self, request: &OpenRequest) -> u32 {
        let mut nonce = self.nonces.next();
        for _ in 0..MOST_DRAWS {
            let context = Context::sealed(request, nonce);
            if context.is_usable() && !self.closed.resemble(&context) {
                break;
            }
            nonce = self.nonces.next();
        }
        nonce
    }

    /// Who latched a stop may be gone: whoever has been told what is latched may take a standing arm out of it.
    fn answers_challenge(&self, request: &OpenRequest) -> bool {
        let latched = matches!(self.state, State::Fault | State::QuickStopActive) && self.is_still();
        latched && self.challenge.is_some_and(|nonce| nonce == request.reset_nonce)
    }

    fn is_over(&self, session: u16) -> bool {
        self.farewell.is_some_and(|farewell| farewell.session == session)
    }

    /// Whoever asks a session that is over for something has not heard that it is. In another session the arm may move.
    fn repeat_farewell(&mut self) {
        self.drop_one();
        if let Some(farewell) = self.farewell {
            let standstill = self.is_still();
            self.send(FromArm::Status(Status { standstill, counter: self.counter, ..farewell }));
            self.counter = self.counter.wrapping_add(1);
        }
    }

    fn command(&mut self, command: Command) {
        use State as S;
        let still = self.is_still();
        match (self.state, command) {
            (S::SwitchOnDisabled, Command::Shutdown) => self.enter(S::ReadyToSwitchOn),
            (S::SwitchedOn, Command::Shutdown) => self.enter(S::ReadyToSwitchOn),
            (S::ReadyToSwitchOn, Command::SwitchOn) => self.enter(S::SwitchedOn),
            (S::SwitchedOn, Command::EnableOperation) => self.enable(),
            (S::ReadyToSwitchOn | S::SwitchedOn, Command::DisableVoltage | Command::QuickStop) => {
                self.enter(S::SwitchOnDisabled);
            }
            (S::OperationEnabled, Command::SwitchOn) if still => self.leave_operation(S::SwitchedOn),
            // Asked again, for the anchor may have been lost.
            (S::OperationEnabled, Command::EnableOperation) => self.repeat_anchor(),
            (S::OperationEnabled, Command::Shutdown) if still => self.leave_operation(S::ReadyToSwitchOn),
            (S::OperationEnabled | S::QuickStopActive, Command::DisableVoltage) if still => {
                self.leave_operation(S::SwitchOnDisabled);
            }
            // A moving arm keeps its power until it stands, whatever is asked.
            (
                S::OperationEnabled,
                Command::QuickStop | Command::SwitchOn | Command::Shutdown | Command::DisableVoltage,
            ) => self.stop(S::QuickStopActive, FaultCode::StopCommanded),
            (S::Fault, Command::FaultReset) => self.leave_operation(S::SwitchOnDisabled),
            _ => {
                self.drop_one();
                self.report();
            }
        }
    }

    fn enter(&mut self, state: State) {
        self.state = state;
        self.report();
    }

    fn enable(&mut self) {
        // Not where the arm is, which may be a quarter of an LSB off: the command goes on without a jump.
        let anchor = self.arm.told().pose;
        let Some(session) = self.session.as_mut() else { return self.drop_one() };
        session.anchored = Some(Anchored::new(session, anchor));
        // What was seen of the last motion is no strike against this one.
        self.watch = FollowingWatch::new(self.following);
        self.hold();
        self.state = State::OperationEnabled;
        self.repeat_anchor();
    }

    fn repeat_anchor(&mut self) {
        let Some(session) = &self.session else { return };
        let Some(anchored) = &session.anchored else { return };
        let (session, pose) = (session.request.session, anchored.anchor);
        self.report();
        self.send(FromArm::Anchored { session, pose });
    }

    /// Closes the session: the next motion needs a new one, with a new anchor. A session that could be enabled once more
    /// would be led by its own old messages, said again, from an anchor that they were not meant for.
    fn leave_operation(&mut self, state: State) {
        self.state = state;
        self.close();
        self.fault = None;
        self.violation = None;
        self.challenge = None;
        self.report();
    }

    /// The session is over, in the state that has just been entered. Its end is told so, in the session.
    fn close(&mut self) {
        let Some(session) = self.session.take() else { return };
        self.closed.add(session.context);
        self.farewell = Some(Status {
            session: session.request.session,
            state: self.state,
            phase: None,
            standstill: true,
            applied_tick: session.anchored.map_or(0, |anchored| anchored.applied_tick),
            have: 0,
            counter: self.counter,
        });
        self.farewell.into_iter().for_each(|farewell| self.send(FromArm::Status(farewell)));
        self.counter = self.counter.wrapping_add(1);
    }

    fn is_still(&self) -> bool {
        matches!(self.activity, Activity::Still)
    }

    // --- setpoints ---

    fn setpoint(&mut self, now_us: u64, setpoint: Setpoint) {
        let following = matches!(self.activity, Activity::Still | Activity::Following { .. });
        if self.state != State::OperationEnabled || !following {
            return self.drop_one();
        }
        let Some(request) = self.session.as_ref().map(|session| session.request) else { return };
        let Some(anchored) = self.anchored_mut() else { return };
        if anchored.ended {
            return self.drop_one();
        }
        let found = if setpoint.tick > request.end_tick {
            Err(FaultCode::SetpointPastEnd)
        } else if setpoint.validate(request.lsb).is_err() {
            Err(FaultCode::SetpointNotRepresentable)
        } else {
            match anchored.buffer.insert(setpoint, anchored.applied_tick) {
                Ok(()) => Ok(true),
                Err(Refused::Stale | Refused::Same) => Ok(false),
                Err(Refused::Different) => Err(FaultCode::SetpointRepeated),
                Err(Refused::BeyondCredit) => Err(FaultCode::SetpointBeyondCredit),
            }
        };
        // One that is said again says nothing of whoever said it first.
        if found != Ok(false) {
            self.heard_us = now_us;
        }
        match found {
            Ok(true) if self.is_still() => {
                self.start_if_filled(now_us);
                // Until the clock runs nothing else would say what has arrived.
                self.report();
            }
            Ok(true) => {}
            Ok(false) => self.drop_one(),
            Err(code) => self.stop(State::FaultReactionActive, code),
        }
    }

    fn start_if_filled(&mut self, now_us: u64) {
        let Some(session) = &self.session else { return };
        let Some(anchored) = &session.anchored else { return };
        let wanted = u32::from(session.request.start_level).min(session.request.end_tick);
        if self.is_still() && u32::from(anchored.buffer.count_after(0)) >= wanted {
            self.activity = Activity::Following { bridge: None };
            self.next_tick_us = Some(now_us);
        }
    }

    // --- the clock ---

    fn advance(&mut self, now_us: u64) {
        self.check_overrun(now_us);
        while let Some(tick_us) = self.next_tick_us.filter(|tick_us| *tick_us <= now_us) {
            let period_us = self.period_us();
            self.next_tick_us = Some(tick_us.saturating_add(u64::from(period_us)));
            self.move_arm(tick_us);
            self.check_following();
            self.note_tick();
            self.report_actual();
            self.tick(tick_us);
            if self.is_still() {
                self.next_tick_us = None;
            }
            self.report();
        }
        self.move_arm(now_us);
        if self.session_ends_us().is_some_and(|end_us| end_us <= now_us) {
            self.lose_session();
        }
        if self.heartbeat_at_us <= now_us {
            self.heartbeat_at_us = now_us.saturating_add(HEARTBEAT_US);
            self.beat();
        }
    }

    /// The arm goes on, along the path, to where it is due.
    fn move_arm(&mut self, now_us: u64) {
        #[expect(clippy::cast_precision_loss, reason = "2^53 microseconds are 285 years")]
        let dt_s = now_us.saturating_sub(self.followed_us) as f64 / 1e6;
        self.followed_us = self.followed_us.max(now_us);
        let target = match self.path.at(now_us) {
            Commanded::End(target) => target,
            Commanded::Joints(joints) => self.arm.target_of(joints),
            Commanded::Pose(pose) => Target::pose(pose),
        };
        self.arm.follow(target, dt_s);
    }

    /// An arm that is not where it is told to be stops, whoever told it.
    fn check_following(&mut self) {
        if self.state != State::OperationEnabled {
            return;
        }
        let off = self.arm.told().pose.displacement_to(&self.arm.pose()).components();
        let [x, y, z] = self.motion.linear.velocity.into();
        let [rx, ry, rz] = self.motion.angular.velocity.into();
        let tick = self.anchored().map_or(0, |anchored| anchored.applied_tick);
        if self.watch.check(tick, off, [x, y, z, rx, ry, rz]).is_err() {
            self.stop(State::FaultReactionActive, FaultCode::ArmFollowing);
        }
    }

    fn note_tick(&mut self) {
        self.has_moved = true;
        let (Some(ticks), Some(Session { request, context, .. })) = (&mut self.ticks, &self.session) else {
            return;
        };
        if ticks.len() >= TICKS_KEPT {
            ticks.pop_front();
        }
        let OpenRequest { plan_hash, period_us, .. } = *request;
        let (pose, joints) = (self.arm.pose(), self.arm.joints());
        ticks.push_back(Tick { context: *context, plan_hash, period_us, pose, joints });
    }

    /// Whether the arm has come to where its command rests. One that never does is not waited for.
    fn has_settled(&mut self, tick_us: u64) -> bool {
        let since_us = *self.resting_since_us.get_or_insert(tick_us);
        self.is_there() || tick_us.saturating_sub(since_us) >= LONGEST_SETTLING_US
    }

    fn is_there(&self) -> bool {
        let off = self.arm.told().pose.displacement_to(&self.arm.pose());
        let lsb = self.session.as_ref().map(|session| session.request.lsb).unwrap_or_default();
        let near = |off: Vector3<f64>, lsb: f64| off.iter().all(|x| x.abs() < SETTLED_LSB * lsb);
        near(off.translation(), lsb.translation_m()) && near(off.rotation(), lsb.rotation_rad())
    }

    /// The drives were left alone for too long. They have not stood meanwhile, for that would have been abrupt, and to go on from
    /// it a leap: they have braked by themselves, from the first tick for which nobody told them anything. So the clock goes on
    /// without a gap, and all that has become of the ticks that were missed is the stop, be it this one or one that had begun.
    fn check_overrun(&mut self, now_us: u64) {
        let late = self.next_tick_us.map_or(0, |tick_us| now_us.saturating_sub(tick_us));
        let tolerated = OVERRUN_TICKS.saturating_mul(u64::from(self.period_us())).max(OVERRUN_US);
        if late > tolerated && !matches!(self.activity, Activity::Stopping(_)) {
            self.stop(State::FaultReactionActive, FaultCode::ArmOverrun);
        }
    }

    /// When the session is over if nothing more is heard of it. A latched stop is not a session's any more; power that a
    /// session has left on goes with the time that it had.
    fn session_ends_us(&self) -> Option<u64> {
        let latched =
            matches!(self.state, State::QuickStopActive | State::FaultReactionActive | State::Fault);
        let held = self.session.is_some() || self.state == State::SwitchedOn;
        (held && !latched).then(|| self.heard_us.saturating_add(self.watchdog_us))
    }

    fn lose_session(&mut self) {
        if self.state == State::OperationEnabled {
            return self.stop(State::FaultReactionActive, FaultCode::ExecutorSilent);
        }
        self.state = State::SwitchOnDisabled;
        self.close();
        self.report();
    }

    fn tick(&mut self, tick_us: u64) {
        match self.activity {
            Activity::Still => {}
            Activity::Following { bridge } => self.follow(tick_us, bridge),
            Activity::Settling { ticks_left } => self.settle(tick_us, ticks_left),
            Activity::Stopping(stop) => self.brake(tick_us, stop),
        }
    }

    fn follow(&mut self, tick_us: u64, bridge: Option<(StopProfile, u32)>) {
        let Some(session) = &self.session else { return };
        let Some(anchored) = &session.anchored else { return };
        let OpenRequest { lsb, end_tick, .. } = session.request;
        let tick = anchored.applied_tick.saturating_add(1);
        if tick > end_tick {
            return match bridge {
                None => self.settle(tick_us, SETTLE_TICKS),
                // The last setpoint itself is missing: this is not the end of the plan.
                Some((profile, _)) => self.miss(tick_us, profile),
            };
        }
        let at = |tick| anchored.buffer.peek(tick).map(|found| pose_at(&anchored.anchor, found, lsb));
        let (here, after) = (at(tick), at(tick.saturating_add(1)));
        match (here, after) {
            (Some(pose), after) => self.take(tick_us, pose, after),
            (None, Some(after)) => {
                self.lose_one(tick);
                let pose = self.towards(after);
                self.take(tick_us, pose, Some(after));
            }
            (None, None) => {
                self.lose_one(tick);
                self.extrapolate(tick_us, bridge);
            }
        }
    }

    /// Commands a pose that the limit check accepts; stops otherwise. The pose after it bends the path towards it, so it
    /// has a say only if it will be accepted too.
    fn take(&mut self, tick_us: u64, pose: Pose, after: Option<Pose>) {
        let target = match self.next_target(self.path.end(), &pose) {
            Ok(target) => target,
            Err(error) => {
                self.latch(State::FaultReactionActive, error.code());
                return self.brake(tick_us, self.stop_from_here());
            }
        };
        let after = after.and_then(|after| self.next_target(&target, &after).ok());
        let Some(anchored) = self.anchored_mut() else { return };
        match anchored.checker.check(pose) {
            Ok(motion) => {
                let mut probe = anchored.checker;
                let after = after.filter(|after| probe.check(after.pose).is_ok());
                anchored.applied_tick = anchored.applied_tick.saturating_add(1);
                let applied = anchored.applied_tick;
                if anchored.buffer.take(applied).is_some() {
                    anchored.received = (applied, pose);
                }
                self.activity = Activity::Following { bridge: None };
                self.command_target(tick_us, target, motion, after);
            }
            Err(violation) => self.refuse(tick_us, violation),
        }
    }

    /// What the arm makes of a pose one tick after a target.
    fn next_target(&self, from: &Target, pose: &Pose) -> Result<Target, ArmError> {
        self.arm.target(from, pose, f64::from(self.period_us()) / 1e6)
    }

    /// Nothing to go by: begins, or goes on with, a stop that may still be taken back.
    fn extrapolate(&mut self, tick_us: u64, bridge: Option<(StopProfile, u32)>) {
        let fresh = || {
            StopProfile::within_limits(&self.motion, &self.limits(), self.period_us()).map(|stop| (stop, 0))
        };
        let Some((mut profile, ticks)) = bridge.or_else(fresh) else {
            let profile = StopProfile::new(&self.motion, &self.limits(), &self.own_limits, self.period_us());
            return self.miss(tick_us, profile);
        };
        if ticks >= BRIDGED_TICKS {
            return self.miss(tick_us, profile);
        }
        let pose = profile.next_pose().unwrap_or(self.motion.pose);
        self.take(tick_us, pose, None);
        if let Activity::Following { bridge } = &mut self.activity {
            *bridge = Some((profile, ticks.saturating_add(1)));
        }
    }

    /// Stays on the last setpoint; also a motion, which must keep the limits.
    fn settle(&mut self, tick_us: u64, ticks_left: u32) {
        let target = *self.path.end();
        let Some(anchored) = self.anchored_mut() else { return };
        anchored.ended = true;
        if ticks_left == 0 && self.has_settled(tick_us) {
            self.activity = Activity::Still;
            self.resting_since_us = None;
            return;
        }
        let Some(anchored) = self.anchored_mut() else { return };
        match anchored.checker.check(target.pose) {
            Ok(motion) => {
                self.activity = Activity::Settling { ticks_left: ticks_left.saturating_sub(1) };
                self.command_target(tick_us, target, motion, Some(target));
            }
            Err(violation) => self.refuse(tick_us, violation),
        }
    }

    fn brake(&mut self, tick_us: u64, mut stop: Stop) {
        let next = self.next_of(&mut stop, self.path.end());
        self.activity = Activity::Stopping(stop);
        if let Some(target) = next {
            let after = self.next_of(&mut stop, &target).unwrap_or(target);
            let motion = self.motion.moved_to(target.pose, self.period_us());
            return self.command_target(tick_us, target, motion, Some(after));
        }
        self.hold();
        if self.has_settled(tick_us) {
            self.stand();
        }
    }

    /// The target of a stop that comes after another one; `None` at rest.
    fn next_of(&self, stop: &mut Stop, from: &Target) -> Option<Target> {
        if let Stop::Tool(profile) = stop {
            match self.next_target(from, &profile.next_pose()?) {
                Ok(target) => return Some(target),
                // It has been tried before the stop began; should it not hold all the same, the joints brake from here.
                Err(_) => *stop = Stop::Joints(self.joint_stop(&self.limits())?),
            }
        }
        let Stop::Joints(joints) = stop else { return None };
        joints.next_joints().map(|joints| self.arm.target_of(joints))
    }

    /// A stop has come to its end. Quick stop stays active until power is taken away; a fault reaction becomes a fault. An arm that
    /// was not waited for any longer gets no further: what is said to stand does.
    fn stand(&mut self) {
        self.activity = Activity::Still;
        self.resting_since_us = None;
        if !self.is_there() {
            self.arm.stay();
        }
        self.hold();
        if self.state == State::FaultReactionActive {
            self.state = State::Fault;
        }
    }

    /// What the arm is told it stays told.
    fn hold(&mut self) {
        let told = *self.arm.told();
        self.path = Interpolator::hold(told);
        self.motion = Motion::at_rest(told.pose);
        self.turning = told.joints.map(JointMotion::at_rest);
    }

    fn command_target(&mut self, tick_us: u64, target: Target, motion: Motion, after: Option<Target>) {
        self.path = self.path.extended(target, after, tick_us, self.period_us());
        self.motion = motion;
        self.turning = self.turned_to(self.turning, &target);
    }

    fn turned_to(&self, turning: Option<JointMotion>, target: &Target) -> Option<JointMotion> {
        turning.zip(target.joints).map(|(turning, joints)| turning.moved_to(joints, self.period_us()))
    }

    /// Where constant jerk leads in one tick if it is to lead to `after` in two: with d the displacement of both,
    /// the first one's is v h / 2 + a h^2 / 4 + d / 4.
    fn towards(&self, after: Pose) -> Pose {
        let h = f64::from(self.period_us()) / 1e6;
        let both = self.motion.pose.displacement_to(&after);
        let (linear, angular) = (&self.motion.linear, &self.motion.angular);
        let first = |v, a, d| v * (h / 2.0) + a * (h * h / 4.0) + d / 4.0;
        self.motion.pose.displaced(&Displacement {
            translation_m: first(linear.velocity, linear.acceleration, both.translation()).into(),
            rotation_rad: first(angular.velocity, angular.acceleration, both.rotation()).into(),
        })
    }

    fn lose_one(&mut self, tick: u32) {
        if let Some(anchored) = self.anchored_mut() {
            anchored.lost = anchored.lost.saturating_add(1);
            anchored.echo_until = tick.saturating_add(BRIDGE_ECHO_TICKS);
        }
    }

    // --- stops ---

    /// A commanded pose breaks a limit. If that is the echo of a lost setpoint, the loss is the reason; not so if the
    /// setpoint would have been refused without the loss as well.
    fn refuse(&mut self, tick_us: u64, violation: Violation) {
        let echo = self.session.as_ref().is_some_and(|session| session.is_echo(&violation));
        let code =
            if echo { FaultCode::SetpointMissing } else { FaultCode::from_limit(violation.limit, Side::Arm) };
        if self.fault.is_none() {
            self.violation = Some(violation);
        }
        self.latch(State::FaultReactionActive, code);
        self.brake(tick_us, self.stop_from_here());
    }

    /// Setpoints are missing for too long: a stop is now latched; the one that has begun, unless it would take too long.
    fn miss(&mut self, tick_us: u64, begun: StopProfile) {
        self.latch(State::FaultReactionActive, FaultCode::SetpointMissing);
        let soon = begun.ticks().saturating_mul(self.period_us()) <= GENTLE_STOP_US;
        let stop = if soon { self.possible(begun, &self.limits()) } else { self.stop_from_here() };
        self.brake(tick_us, stop);
    }

    /// Latches a reason between two ticks; braking begins with the next.
    fn stop(&mut self, state: State, code: FaultCode) {
        self.latch(state, code);
        if self.is_still() {
            self.stand();
        } else {
            self.activity = Activity::Stopping(self.stop_from_here());
            self.resting_since_us = None;
        }
        self.report();
    }

    /// Whoever asks, from whatever state: as hard as the arm itself allows. Who leads the arm up does not go on with it.
    fn hard_stop(&mut self) {
        use State as S;
        match self.state {
            S::SwitchOnDisabled | S::ReadyToSwitchOn | S::SwitchedOn | S::OperationEnabled
                if self.session.is_some() =>
            {
                self.stop(S::QuickStopActive, FaultCode::SoftwareStop);
            }
            S::ReadyToSwitchOn | S::SwitchedOn => self.enter(S::SwitchOnDisabled),
            _ => self.report(),
        }
        if !self.is_still() {
            self.activity = Activity::Stopping(self.stop_within(&self.own_limits));
        }
    }

    fn stop_from_here(&self) -> Stop {
        self.stop_within(&self.limits())
    }

    fn stop_within(&self, limits: &Limits) -> Stop {
        let profile = StopProfile::new(&self.motion, limits, &self.own_limits, self.period_us());
        self.possible(profile, limits)
    }

    /// The stop of the tool, if there are no joints that cannot follow it to its end; else theirs.
    fn possible(&self, profile: StopProfile, limits: &Limits) -> Stop {
        let joints = if self.is_followed(profile) { None } else { self.joint_stop(limits) };
        joints.map_or(Stop::Tool(profile), Stop::Joints)
    }

    fn is_followed(&self, mut profile: StopProfile) -> bool {
        let (mut target, mut turning) = (*self.path.end(), self.turning);
        let hardness = |turning: &Option<JointMotion>| {
            turning.map_or(0.0, |turning| {
                turning.acceleration_rad_s2.iter().fold(0.0, |most, x| libm::fmax(most, x.abs()))
            })
        };
        let hardest = libm::fmax(hardness(&turning), self.own_limits.angular_acceleration_rad_s2);
        while turning.is_some()
            && let Some(pose) = profile.next_pose()
        {
            let Ok(next) = self.next_target(&target, &pose) else { return false };
            (target, turning) = (next, self.turned_to(turning, &next));
            if hardness(&turning) > hardest {
                return false;
            }
        }
        true
    }

    fn joint_stop(&self, limits: &Limits) -> Option<JointStop> {
        let (turning, model) = self.turning.as_ref().zip(self.arm.model())?;
        Some(JointStop::new(turning, model, limits, &self.own_limits, self.period_us()))
    }

    /// The first reason stays.
    fn latch(&mut self, state: State, code: FaultCode) {
        self.state = state;
        let tick = self.anchored().map_or(0, |anchored| anchored.applied_tick);
        if self.fault.is_none() {
            self.fault = Some(Fault { code, tick });
            self.report_fault();
        }
    }

    /// Control period of the session; without one, the longest there is.
    #[must_use]
    pub fn period_us(&self) -> u32 {
        self.session.as_ref().map_or(LONGEST_PERIOD_US, |session| session.request.period_us)
    }

    // --- reports ---

    fn phase(&self) -> Option<Phase> {
        let session = self.session.as_ref().filter(|_| self.state == State::OperationEnabled)?;
        let anchored = session.anchored.as_ref()?;
        Some(match self.activity {
            Activity::Still | Activity::Stopping(_) if anchored.ended => Phase::Holding,
            Activity::Still | Activity::Stopping(_) => Phase::Armed,
            Activity::Following { .. } if anchored.ahead_until() < session.request.end_tick => {
                Phase::Streaming
            }
            Activity::Following { .. } | Activity::Settling { .. } => Phase::Completing,
        })
    }

    /// The state as it would be reported now.
    #[must_use]
    pub fn status(&self) -> Status {
        let anchored = self.anchored();
        let applied_tick = anchored.map_or(0, |anchored| anchored.applied_tick);
        Status {
            session: self.session_number(),
            state: self.state,
            phase: self.phase(),
            standstill: self.is_still(),
            applied_tick,
            have: anchored.map_or(0, |anchored| anchored.buffer.have_after(applied_tick)),
            counter: self.counter,
        }
    }

    /// Setpoints that were not there when they were needed.
    #[must_use]
    pub fn lost(&self) -> u32 {
        self.anchored().map_or(0, |anchored| anchored.lost)
    }

    /// Messages dropped since power on.
    #[must_use]
    pub fn dropped(&self) -> u16 {
        self.dropped
    }

    /// The open session.
    #[must_use]
    pub fn context(&self) -> Context {
        self.session.as_ref().map_or(Context::NONE, |session| session.context)
    }

    /// What the open session is about.
    #[must_use]
    pub fn request(&self) -> Option<&OpenRequest> {
        self.session.as_ref().map(|session| &session.request)
    }

    fn session_number(&self) -> u16 {
        self.context().session
    }

    fn report(&mut self) {
        self.send(FromArm::Status(self.status()));
        self.counter = self.counter.wrapping_add(1);
    }

    fn report_actual(&mut self) {
        let Some(session) = &self.session else { return };
        let Some(anchored) = &session.anchored else { return };
        let from_anchor = anchored.anchor.displacement_to(&self.arm.pose());
        // An arm that was stopped half a turn from its anchor has nothing to say.
        let Ok(reached) = Setpoint::from_cumulative(anchored.applied_tick, &from_anchor, session.request.lsb)
        else {
            return;
        };
        let session = session.request.session;
        self.send(FromArm::Actual { session, reached });
    }

    fn report_fault(&mut self) {
        if let Some(fault) = self.fault {
            self.send(FromArm::Fault { session: self.session_number(), fault: fault.into() });
        }
    }

    /// Everything that somebody may have missed.
    fn beat(&mut self) {
        let lost = u16::try_from(self.lost()).unwrap_or(u16::MAX);
        let heartbeat = Heartbeat { session: self.session_number(), lost, dropped: self.dropped };
        self.send(FromArm::Heartbeat(heartbeat));
        self.report_fault();
        if self.is_still() {
            self.report_actual();
        }
        self.report();
    }

    fn send(&mut self, message: FromArm) {
        if self.outbox.len() >= OUTBOX_CAPACITY {
            self.outbox.pop_front();
        }
        self.outbox.push_back(message);
    }
}
