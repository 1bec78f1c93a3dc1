//! One plan, one session, from opening to standstill.
//!
//! | stage      | waits for                                   | then                                              |
//! |------------|---------------------------------------------|---------------------------------------------------|
//! | opening    | the arm to accept the session               | enabling                                          |
//! | enabling   | each state of [`WAY_UP`], then the anchor   | streaming, if the anchor is the plan's start      |
//! | streaming  | credit; sends guarded setpoints             | leaving, when the arm stands on the last setpoint |
//! | leaving    | ready to switch on                          | done: completed                                   |
//! | stopping   | the arm to report standstill                | done: stopped, with the first reason latched      |
//!
//! Stopping goes on for as long as the arm reports that it moves, but not beyond [`Config::standstill_us`], half of which it
//! has for a controlled stop; and when a person has asked for a hard stop, not beyond [`HARD_STOP_US`]. An arm that has not
//! reported standstill by then, or that falls silent, is given up, and the outcome says that nobody knows whether it stands.
//!
//! Whatever is asked of the arm is asked again after [`Config::retry_us`] until it is done or the time for it is over. A
//! setpoint that the arm does not report as there is sent again, at most one in each control period.

use heapless::Deque;
use powderline_shared::displacement::{Displacement, Lsb, Setpoint, displacement_between};
use powderline_shared::fault::{Fault, FaultCode, Reported};
use powderline_shared::following::{Following, FollowingWatch};
use powderline_shared::limits::{PeakUse, Violation};
use powderline_shared::plan::{PlanHeader, PlanReader};
use powderline_shared::pose::{Pose, norm};
use powderline_shared::wire::Context;
use powderline_shared::wire::auth::{Key, Tag};
use powderline_shared::wire::message::{
    FromArm, HEARTBEAT_US, NO_SESSION, OpenRequest, PROTOCOL_VERSION, Refusal, Status, ToArm,
};
use powderline_shared::wire::state::{Command, Phase, State};

use crate::belief::{Belief, Doubt};
use crate::guard::{Guard, fault_of};
use crate::player::Player;
use crate::schedule::{DEFAULT_LOOK_AHEAD, Schedule};
use crate::telemetry::Telemetry;
use crate::window::Window;

/// Commands that lead from standing without power to operation enabled: in which state, which command.
pub const WAY_UP: [(State, Command); 3] = [
    (State::SwitchOnDisabled, Command::Shutdown),
    (State::ReadyToSwitchOn, Command::SwitchOn),
    (State::SwitchedOn, Command::EnableOperation),
];

/// Room for messages that are not setpoints. Each is also retried, so a full queue costs time, not a message.
const OUTBOX_CAPACITY: usize = 4;

/// How long a person who has asked for a hard stop waits for the arm to stand, microseconds: no longer than a person waits
/// before pulling the plug.
pub const HARD_STOP_US: u64 = 800_000;

/// How long an arm has to say that it stands before it is believed, microseconds: more than once, and nothing else meanwhile.
pub const STANDS_US: u64 = 100_000;

/// How long an arm has held the last setpoint when what it says of where it is counts against it, microseconds. It says that with
/// each heartbeat; what it said while it settled may come until then, for a status goes before it on a CAN bus.
const HOLDS_US: u64 = HEARTBEAT_US;

/// Signs of life of an arm that is in no session, while ours is in one, that are too many to be left over from before.
const STRANGERS: u8 = 3;

/// Periods without a report after which the arm is silent, at the least.
const SILENT_PERIODS: u64 = 4;

/// What may differ from arm to arm. Times in microseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Number of the session; best a random one. If the arm has closed one of that number not long ago, the next is taken.
    pub session: u16,
    /// What one count is worth on the wire; the plan's own if `None`. Setpoints are rounded to it before they are checked.
    pub lsb: Option<Lsb>,
    /// Control period to play at, microseconds; the plan's own if `None`.
    pub period_us: Option<u32>,
    /// The key that the arm has too; without one, whoever is on the wire is believed.
    pub key: Option<Key>,
    /// With a key: a number that is another one for each session.
    pub nonce: u64,
    /// Whether an arm with a latched stop is to be reset first. Somebody has looked at it and says so.
    pub reset: bool,
    /// Setpoints ahead of the arm's clock.
    pub look_ahead: u16,
    /// Largest distance of the anchor from the plan's start pose, metres.
    pub anchor_tolerance_m: f64,
    /// Largest angle of the anchor from the plan's start pose, radians.
    pub anchor_tolerance_rad: f64,
    /// How far the arm may be from where it is due on its way.
    pub following: Following,
    /// When an unanswered request is repeated.
    pub retry_us: u64,
    /// When the handshake or leaving is given up, an arm that makes no progress, and stopping one that no longer reports.
    pub handshake_us: u64,
    /// When stopping an arm is given up that goes on reporting that it moves. An arm stops within 1 s and settles within 0.5 s;
    /// after half of this it is asked to stop as hard as it can.
    pub standstill_us: u64,
    /// When an arm that moves and does not report counts as silent; at least four control periods.
    pub silence_us: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            session: 1,
            lsb: None,
            period_us: None,
            key: None,
            nonce: 0,
            reset: false,
            look_ahead: DEFAULT_LOOK_AHEAD,
            anchor_tolerance_m: 0.5e-3,
            anchor_tolerance_rad: 5e-3,
            following: Following::default(),
            retry_us: 100_000,
            handshake_us: 2_000_000,
            standstill_us: 6_000_000,
            silence_us: 300_000,
        }
    }
}

/// What to do now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// Send this; then poll again.
    Send(ToArm),
    /// Nothing before [`Executor::poll_at`], unless a message arrives.
    Wait,
    /// The session is over.
    Finished(Outcome),
}

/// How a session ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The arm holds the last setpoint.
    Completed,
    /// The session ended before the plan did.
    Stopped {
        /// Why.
        fault: Fault,
        /// Whether the arm has reported that it stands still. If not, it may be moving yet.
        standstill: bool,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Opening,
    Enabling,
    Streaming,
    Leaving,
    Stopping,
    Done(Outcome),
}

/// The executor of one plan.
#[derive(Clone, Debug)]
pub struct Executor<'a> {
    config: Config,
    header: PlanHeader,
    plan_hash: u64,
    /// What was agreed on with the arm; none before it has opened the session.
    context: Context,
    /// What the arm has given out to be reset by; 0 if it need not or may not be.
    reset_nonce: u32,
    /// The stop that it had latched when it gave that out.
    latched: Option<Reported>,
    /// Whether it has been in somebody else's session since it was asked first.
    was_busy: bool,
    lsb: Lsb,
    period_us: u32,
    player: Player<'a>,
    schedule: Schedule,
    window: Window,
    belief: Belief,
    following: FollowingWatch,
    doubt: Option<Doubt>,
    guard: Option<Guard>,
    stage: Stage,
    outbox: Deque<ToArm, OUTBOX_CAPACITY>,
    arm: Option<Status>,
    /// The last of those that belong to the session.
    ours: Option<Status>,
    /// Where the arm has said that it stands while it is enabled.
    anchor: Option<Pose>,
    /// Where the arm has reported to be, as a displacement from the anchor.
    reached: Option<Setpoint>,
    /// Since when it is not known where the arm is at the ticks that it reports.
    lost_us: Option<u64>,
    /// Since when the arm has said that it rests on the last setpoint, and not that it is there.
    resting_since_us: Option<u64>,
    fault: Option<Fault>,
    violation: Option<Violation>,
    refusal: Option<Refusal>,
    telemetry: Telemetry,
    /// Whether to stop as fast as the arm can.
    hard: bool,
    /// Signs of life of another arm.
    strangers: u8,
    /// When the last was heard.
    stranger_us: Option<u64>,
    /// When the arm's last heartbeat in the session was.
    own_heartbeat_us: u64,
    /// Since when the arm has said nothing but that it stands, while it is being stopped.
    stands_since_us: Option<u64>,
    heard_us: u64,
    reported_us: u64,
    /// The highest tick and the last phase that the arm has got to, and when.
    furthest: (u32, Option<Phase>),
    progress_us: u64,
    /// When that was first asked whose answer is waited for.
    asked_us: Option<u64>,
    /// Whether anything has been asked yet.
    has_asked: bool,
    retry_at_us: u64,
    give_up_at_us: u64,
    /// While stopping: when it is given up whatever the arm says.
    stop_ends_at_us: u64,
    heartbeat_at_us: u64,
    resend_at_us: u64,
}

impl<'a> Executor<'a> {
    /// Opens a session with the next poll.
    #[must_use]
    pub fn new(now_us: u64, plan: &PlanReader<'a>, config: Config) -> Self {
        let header = *plan.header();
        let config = Config { session: config.session.max(1), ..config };
        let period_us = config.period_us.unwrap_or(header.control_period_us);
        let schedule = Schedule::new(config.look_ahead, period_us);
        Self {
            config,
            header,
            plan_hash: plan.content_hash(),
            context: Context::NONE,
            reset_nonce: 0,
            latched: None,
            was_busy: false,
            lsb: config.lsb.unwrap_or(header.lsb),
            period_us,
            player: Player::new(plan),
            schedule,
            window: Window::default(),
            belief: Belief::new(period_us, header.step_count, schedule.look_ahead()),
            following: FollowingWatch::new(config.following),
            doubt: None,
            guard: None,
            stage: Stage::Opening,
            outbox: Deque::new(),
            arm: None,
            ours: None,
            anchor: None,
            reached: None,
            lost_us: None,
            resting_since_us: None,
            fault: None,
            violation: None,
            refusal: None,
            telemetry: Telemetry::default(),
            hard: false,
            strangers: 0,
            own_heartbeat_us: 0,
            stranger_us: None,
            stands_since_us: None,
            heard_us: now_us,
            reported_us: now_us,
            furthest: (0, None),
            progress_us: now_us,
            asked_us: None,
            has_asked: false,
            retry_at_us: now_us,
            give_up_at_us: now_us.saturating_add(config.handshake_us),
            stop_ends_at_us: u64::MAX,
            heartbeat_at_us: now_us.saturating_add(HEARTBEAT_US),
            resend_at_us: now_us,
        }
    }

    /// Takes in one message of the arm.
    pub fn handle_message(&mut self, now_us: u64, message: &FromArm) {
        match *message {
            FromArm::Opened { session, nonce, digest } if session == self.config.session => {
                self.opened(now_us, nonce, digest, None);
            }
            FromArm::OpenedKeyed { session, nonce, digest, tag } if session == self.config.session => {
                self.opened(now_us, nonce, digest, Some(tag));
            }
            FromArm::Refused { session, reason } if session == self.config.session => {
                self.refused(now_us, &reason);
            }
            FromArm::Anchored { session, pose } if self.is_ours(session) => self.anchored(now_us, &pose),
            FromArm::Actual { session, reached } if self.is_ours(session) => self.actual(now_us, reached),
            FromArm::Fault { session, fault } if self.is_ours(session) => self.arm_fault(now_us, fault),
            FromArm::Heartbeat(heartbeat) if self.is_ours(heartbeat.session) => {
                self.heard_us = now_us;
                self.own_heartbeat_us = now_us;
                self.telemetry.lost = heartbeat.lost;
                self.telemetry.dropped = heartbeat.dropped;
            }
            FromArm::Heartbeat(heartbeat) if heartbeat.session == NO_SESSION => self.stranger(now_us),
            FromArm::Status(status) if !self.is_ours(status.session) => self.foreign_status(&status),
            FromArm::Status(status) if self.is_news(&status) => self.status(now_us, &status),
            // Of another session, or older than what is known: no business of ours.
            FromArm::Opened { .. }
            | FromArm::OpenedKeyed { .. }
            | FromArm::Refused { .. }
            | FromArm::Anchored { .. }
            | FromArm::Actual { .. }
            | FromArm::Fault { .. }
            | FromArm::Heartbeat(_)
            | FromArm::Status(_) => {}
        }
    }

    /// A person wants the arm to stop.
    pub fn handle_stop(&mut self, now_us: u64) {
        self.stop(now_us, FaultCode::OperatorStop);
    }

    /// A person wants the arm to stop as fast as it can.
    pub fn handle_hard_stop(&mut self, now_us: u64) {
        let first = !self.hard;
        self.hard = true;
        self.stop(now_us, FaultCode::OperatorStop);
        // A stop that has begun is asked to be a hard one.
        if self.stage == Stage::Stopping && first {
            self.stop_ends_at_us = self.stop_ends_at_us.min(now_us.saturating_add(HARD_STOP_US));
            self.ask(now_us);
        }
    }

    /// Somebody without the key speaks on the wire, and guesses.
    pub fn handle_wrong_tags(&mut self, now_us: u64) {
        self.stop(now_us, FaultCode::WrongTags);
    }

    /// The wire is gone. The arm, which hears nothing any more, stops by itself.
    pub fn handle_link_lost(&mut self, now_us: u64) {
        self.stop(now_us, FaultCode::LinkLost);
    }

    /// What to do now. Call until it says [`Action::Wait`] or [`Action::Finished`].
    pub fn poll(&mut self, now_us: u64) -> Action {
        self.check_time(now_us);
        if let Some(message) = self.outbox.pop_front() {
            return Action::Send(message);
        }
        match self.stage {
            Stage::Done(outcome) => Action::Finished(outcome),
            Stage::Streaming => {
                self.resend(now_us).or_else(|| self.next_setpoint(now_us)).unwrap_or(Action::Wait)
            }
            Stage::Opening | Stage::Enabling | Stage::Leaving | Stage::Stopping => Action::Wait,
        }
    }

    /// The same while the wire has no room: time passes, an arm that has fallen silent is noticed, but what there is to say
    /// waits. Only a hard stop is given out, for a wire that has room for it even so: on a CAN bus it goes before all else.
    pub fn poll_urgent(&mut self, now_us: u64) -> Action {
        self.check_time(now_us);
        if let Stage::Done(outcome) = self.stage {
            return Action::Finished(outcome);
        }
        // What was to be said before it is needless now.
        while self.hard
            && let Some(message) = self.outbox.pop_front()
        {
            if message == ToArm::Stop {
                return Action::Send(message);
            }
        }
        Action::Wait
    }

    /// When to poll next even if no message arrives, microseconds; a moment in the past means at once, `None` that the
    /// session is over.
    #[must_use]
    pub fn poll_at(&self) -> Option<u64> {
        if !self.outbox.is_empty() {
            return Some(0);
        }
        let soonest = match self.stage {
            Stage::Done(_) => return None,
            Stage::Streaming => {
                let setpoint_us = self.player.peek().and_then(|next| self.schedule.due_us(next.tick));
                let resend_us = self.missing().map(|_| self.resend_at_us);
                let due = [setpoint_us, resend_us].into_iter().flatten();
                due.fold(self.silent_at_us().min(self.stalled_at_us()).min(self.lost_at_us()), u64::min)
            }
            Stage::Opening | Stage::Enabling | Stage::Leaving => self.retry_at_us.min(self.give_up_at_us),
            Stage::Stopping => self.retry_at_us.min(self.give_up_at_us).min(self.stop_ends_at_us),
        };
        Some(soonest.min(self.heartbeat_at_us))
    }

    /// The arm's last report.
    #[must_use]
    pub fn arm_status(&self) -> Option<&Status> {
        self.arm.as_ref()
    }

    /// The arm's last report in the session.
    #[must_use]
    pub fn session_status(&self) -> Option<Status> {
        self.ours
    }

    /// Where the arm has reported to be, as a displacement from its anchor in counts of the wire.
    #[must_use]
    pub fn reached(&self) -> Option<Setpoint> {
        self.reached
    }

    /// The pose that the arm has reported last, exact to half an LSB of the wire.
    #[must_use]
    pub fn actual_pose(&self) -> Option<Pose> {
        Some(self.guard.as_ref()?.pose_at(self.reached?))
    }

    /// What has been counted and measured.
    #[must_use]
    pub fn telemetry(&self) -> Telemetry {
        self.telemetry
    }

    /// The last setpoint that has left, if it is not too long ago.
    #[must_use]
    pub fn last_sent(&self) -> Option<Setpoint> {
        self.window.setpoint(self.telemetry.sent)
    }

    /// What the frames of the session are told by; none before the arm has opened it.
    #[must_use]
    pub fn context(&self) -> Context {
        self.context
    }

    /// Number of the session.
    #[must_use]
    pub fn session(&self) -> u16 {
        self.config.session
    }

    /// The numbers behind a limit fault of our own.
    #[must_use]
    pub fn violation(&self) -> Option<Violation> {
        self.violation
    }

    /// What the arm reported and was not believed, or understood.
    #[must_use]
    pub fn doubt(&self) -> Option<Doubt> {
        self.doubt
    }

    /// Why the arm refused the session; none once it has opened it.
    #[must_use]
    pub fn refusal(&self) -> Option<Refusal> {
        self.refusal
    }

    /// Whether the arm has been stopped since it was asked for a session with [`Config::reset`], so that nobody has looked at that stop.
    #[must_use]
    pub fn is_stopped_anew(&self) -> bool {
        self.config.reset
            && matches!(self.refusal, Some(Refusal::Latched { nonce, .. }) if !self.was_looked_at(nonce))
    }

    /// The stop that the arm had latched and was reset from, [`Config::reset`]; none before it has opened the session.
    #[must_use]
    pub fn reset_from(&self) -> Option<Reported> {
        self.latched.filter(|_| self.context != Context::NONE)
    }

    /// Largest use of each limit by the setpoints sent.
    #[must_use]
    pub fn peak_use(&self) -> PeakUse {
        self.guard.map_or_else(PeakUse::default, |guard| guard.peak_use())
    }

    /// Before the arm has opened the session, nothing is of ours.
    fn is_ours(&self, session: u16) -> bool {
        self.context != Context::NONE && session == self.context.session
    }

    // --- what the arm says ---

    /// Reports are counted, so that one that was delayed does not undo what is known since. An arm that was switched off
    /// and on begins to count anew; it may seem silent for a while, which is not far from the truth.
    fn is_news(&self, status: &Status) -> bool {
        // Half of the numbers are ahead of any number, the other half behind.
        self.ours.is_none_or(|known| (1..128).contains(&status.counter.wrapping_sub(known.counter)))
    }

    fn opened(&mut self, now_us: u64, nonce: u32, digest: u64, tag: Option<Tag>) {
        let request = self.open_request();
        let Some(context) = self.proven(&request, nonce, tag) else { return self.unproven() };
        match self.stage {
            Stage::Opening if digest == request.digest() => {
                self.heard_us = now_us;
                self.context = context;
                // Whatever it was, it is over.
                self.refusal = None;
                // No round trip: an arm may have been asleep until now, or busy with another session.
                self.enter(now_us, Stage::Enabling);
            }
            Stage::Opening => self.end_untouched(Fault { code: FaultCode::OpenedOther, tick: 0 }),
            // One arm gives one answer.
            _ if context != self.context => self.stop(now_us, FaultCode::ArmDuplicate),
            _ => self.heard_us = now_us,
        }
    }

    /// The session that the arm's answer stands for, if it was made with the key that we have.
    fn proven(&self, request: &OpenRequest, nonce: u32, tag: Option<Tag>) -> Option<Context> {
        let context = Context::sealed(request, nonce);
        let own = self.config.nonce;
        match (self.config.key, tag) {
            (None, None) => Some(context),
            (Some(key), Some(tag)) if key.answer(request, own, nonce) == tag => {
                Some(context.with_key(key.session(request, own, nonce)))
            }
            _ => None,
        }
    }

    /// Once the session is open, this is nobody's business.
    fn unproven(&mut self) {
        if self.stage == Stage::Opening {
            self.end_untouched(Fault { code: FaultCode::ArmUnproven, tick: 0 });
        }
    }

    /// An arm that is in a session does not say that it is in none. Ours does when it has lost the session, and has no more heartbeats in
    /// it then, though it answers in it.
    fn stranger(&mut self, now_us: u64) {
        let heard_since =
            self.stranger_us.replace(now_us).is_none_or(|last_us| self.own_heartbeat_us > last_us);
        if !matches!(self.stage, Stage::Enabling | Stage::Streaming) || !heard_since {
            return;
        }
        self.strangers = self.strangers.saturating_add(1);
        if self.strangers >= STRANGERS {
            self.stop(now_us, FaultCode::ArmDuplicate);
        }
    }

    /// Of no session, or of another one: something to show until there is one, and nothing more.
    fn foreign_status(&mut self, status: &Status) {
        if self.stage == Stage::Opening {
            self.arm = Some(*status);
        }
    }

    fn refused(&mut self, now_us: u64, reason: &Refusal) {
        if self.stage != Stage::Opening {
            return;
        }
        self.refusal = Some(*reason);
        match reason {
            // A session whose executor is gone is closed by the arm before we give up.
            Refusal::Busy => {
                self.was_busy = true;
                self.latched = None;
            }
            Refusal::Closed => self.renumber(),
            // Asked for again at once, but not twice: an arm that moves is asked with the next request.
            Refusal::Latched { nonce, fault } if self.config.reset && self.was_looked_at(*nonce) => {
                self.latched = Some(*fault);
                let news = self.reset_nonce != *nonce;
                self.reset_nonce = *nonce;
                if news {
                    self.ask(now_us);
                }
            }
            _ => self.end_untouched(Fault { code: FaultCode::SessionRefused, tick: 0 }),
        }
    }

    /// Whether the stop is the one that was there when a person said that it may be reset: not one that was latched since.
    fn was_looked_at(&self, nonce: u32) -> bool {
        !self.was_busy && (self.reset_nonce == 0 || self.reset_nonce == nonce)
    }

    /// Another number, asked for with the next request.
    fn renumber(&mut self) {
        self.config.session = self.config.session.wrapping_add(1).max(1);
    }

    fn anchored(&mut self, now_us: u64, anchor: &Pose) {
        self.heard_us = now_us;
        // One arm has one anchor in a session.
        if self.anchor.is_some_and(|known| known != *anchor) {
            return self.stop(now_us, FaultCode::ArmDuplicate);
        }
        if self.stage != Stage::Enabling {
            return;
        }
        self.answered(now_us);
        if !anchor.is_proper() {
            return self.stop(now_us, FaultCode::AnchorMeaningless);
        }
        let off = self.header.start_pose().displacement_to(anchor);
        let near = norm(&off.translation()) <= self.config.anchor_tolerance_m
            && norm(&off.rotation()) <= self.config.anchor_tolerance_rad;
        if !near {
            return self.stop(now_us, FaultCode::AnchorElsewhere);
        }
        let PlanHeader { limits, step_count, .. } = self.header;
        self.guard = Some(Guard::new(*anchor, limits, self.lsb, self.period_us, step_count));
        self.anchor = Some(*anchor);
        self.reached = Some(Setpoint::ANCHOR);
        self.progress_us = now_us;
        self.enter(now_us, Stage::Streaming);
    }

    fn actual(&mut self, now_us: u64, reached: Setpoint) {
        self.heard_us = now_us;
        if self.is_streamed()
            && let Err(doubt) = self.belief.check(now_us, reached.tick)
        {
            return self.disbelieve(now_us, doubt);
        }
        if self.reached.is_some_and(|known| known.tick > reached.tick) {
            return;
        }
        // An arm that settles says the last tick more than once.
        let first = self.reached.is_none_or(|known| known.tick < reached.tick);
        self.reached = Some(reached);
        if let Some(sent) = self.window.setpoint(reached.tick).filter(|_| self.stage == Stage::Streaming) {
            let off = displacement_between(sent, reached, self.lsb);
            self.telemetry.handle_tracking(&off, first);
            if first {
                self.lost_us = None;
                self.follow(now_us, sent, &off);
            }
        }
        match self.stage {
            Stage::Leaving => self.stay_at_end(now_us, reached),
            _ => {
                self.leave_at_end(now_us);
                self.check_end(now_us);
            }
        }
    }

    /// An arm that has been let go may sink onto its brakes, but no farther than one at rest may be off.
    fn stay_at_end(&mut self, now_us: u64, reached: Setpoint) {
        let Some(end) = self.end_setpoint().filter(|end| end.tick == reached.tick) else { return };
        let off = displacement_between(end, reached, self.lsb).components();
        if let Some(astray) = self.config.following.excess(end.tick, off, [0.0; 6]) {
            self.doubt.get_or_insert(Doubt::Astray(astray));
            self.stop(now_us, FaultCode::EndElsewhere);
        }
    }

    /// Holds where the arm is against where it is due, as fast as it is due to move there.
    fn follow(&mut self, now_us: u64, sent: Setpoint, off: &Displacement) {
        let before = match sent.tick {
            1 => Some(Setpoint::ANCHOR),
            tick => tick.checked_sub(1).and_then(|before| self.window.setpoint(before)),
        };
        let Some(before) = before else { return };
        let period_s = f64::from(self.period_us) / 1e6;
        let velocity = displacement_between(before, sent, self.lsb).components().map(|step| step / period_s);
        if let Err(astray) = self.following.check(sent.tick, off.components(), velocity) {
            self.doubt.get_or_insert(Doubt::Astray(astray));
            self.stop(now_us, FaultCode::ArmAstray);
        }
    }

    /// The arm tells why it stopped. If all that was known is that it left its state, this is the reason.
    fn arm_fault(&mut self, now_us: u64, reported: Reported) {
        self.heard_us = now_us;
        let unexplained = self.fault.is_none_or(|known| known.code == FaultCode::StateUnexpected);
        let fault = reported.known().unwrap_or_else(|_| {
            if unexplained {
                self.doubt.get_or_insert(Doubt::UnknownFault { number: reported.number });
            }
            Fault { code: FaultCode::ArmFaultUnknown, tick: reported.tick }
        });
        self.latch(now_us, fault);
        if unexplained && let Some(known) = &mut self.fault {
            *known = fault;
        }
    }

    fn status(&mut self, now_us: u64, status: &Status) {
        self.heard_us = now_us;
        if self.stage == Stage::Stopping && self.is_of_before(status) {
            return;
        }
        let news = self.ours.is_none_or(|known| known.state != status.state);
        let falls_back = self.ours.is_some_and(|known| falls_back(known.state, status.state));
        match self.believed(now_us, status) {
            Ok(believed) => self.progress(now_us, &believed),
            Err(doubt) => return self.disbelieve(now_us, doubt),
        }
        self.arm = self.ours;
        match self.stage {
            // Somebody has stopped it on its way up, or it has closed the session: it is not led up once more. Why, its fault says.
            Stage::Enabling if falls_back || is_latched(status.state) => {
                self.stop(now_us, FaultCode::StateUnexpected);
            }
            Stage::Leaving if is_latched(status.state) => self.stop(now_us, FaultCode::StateUnexpected),
            // Once operation is enabled the anchor is on its way.
            Stage::Enabling if news && status.state != State::OperationEnabled => {
                self.answered(now_us);
                self.ask(now_us);
            }
            Stage::Streaming => self.watch(now_us, status),
            Stage::Leaving if status.state == State::ReadyToSwitchOn && status.standstill => {
                self.stage = Stage::Done(Outcome::Completed);
            }
            Stage::Stopping => self.watch_stop(now_us, status),
            Stage::Opening | Stage::Enabling | Stage::Leaving | Stage::Done(_) => {}
        }
    }

    /// What an arm said on its way up, said once more by somebody else while it stops: it would seem to stand.
    fn is_of_before(&self, status: &Status) -> bool {
        !may_move(status.state) && status.state != State::Fault && status.applied_tick < self.belief.tick()
    }

    /// Whether what the arm says of ticks counts; while it stops only whether it stands is waited for.
    fn is_streamed(&self) -> bool {
        matches!(self.stage, Stage::Enabling | Stage::Streaming | Stage::Leaving)
    }

    /// The status with a tick that is believed. While it stops, an arm that lies of its tick may yet say that it stands.
    fn believed(&mut self, now_us: u64, status: &Status) -> Result<Status, Doubt> {
        match (self.stage, self.belief.hear(now_us, status)) {
            (_, Ok(())) => Ok(*status),
            (Stage::Stopping | Stage::Done(_), Err(_)) => {
                Ok(Status { applied_tick: self.belief.tick(), have: 0, ..*status })
            }
            (_, Err(doubt)) => Err(doubt),
        }
    }

    fn disbelieve(&mut self, now_us: u64, doubt: Doubt) {
        self.doubt = Some(doubt);
        self.latch(now_us, Fault { code: FaultCode::ArmTickImpossible, tick: self.belief.tick() });
    }

    fn progress(&mut self, now_us: u64, status: &Status) {
        self.reported_us = now_us;
        self.ours = Some(*status);
        // An arm that goes to and fro does not get on.
        let (tick, phase) = self.furthest;
        if status.applied_tick > tick || status.phase > phase {
            self.progress_us = now_us;
            self.furthest = (tick.max(status.applied_tick), phase.max(status.phase));
        }
        let running = matches!(status.phase, Some(Phase::Streaming | Phase::Completing));
        // It says where it is at a tick before it says that it has taken the next one; before it is anchored it is nowhere.
        let located = self.reached.is_none_or(|known| known.tick.saturating_add(1) >= status.applied_tick);
        self.lost_us = if located { None } else { Some(self.lost_us.unwrap_or(now_us)) };
        self.schedule.handle_progress(now_us, status.applied_tick, status.credit_until(), running);
        let round_trip_us = self.window.arrived(now_us, status.applied_tick, status.have);
        round_trip_us.into_iter().for_each(|time_us| self.telemetry.round_trip.record(time_us));
    }

    fn watch(&mut self, now_us: u64, status: &Status) {
        if status.state != State::OperationEnabled {
            return self.stop(now_us, FaultCode::StateUnexpected);
        }
        self.leave_at_end(now_us);
    }

    /// Goes on once the arm has reported both that it stands on the last setpoint and where that is, in whatever order. Where it
    /// is may have been lost, or overtaken by the status; it is repeated. Should nothing follow, the arm is silent or stalled.
    fn leave_at_end(&mut self, now_us: u64) {
        let Some(end) = self.end_setpoint().filter(|_| self.stage == Stage::Streaming) else { return };
        let holds = self.ours.is_some_and(|arm| {
            arm.phase == Some(Phase::Holding) && arm.standstill && arm.applied_tick == end.tick
        });
        // Equal counts: the arm stands within half an LSB of the setpoint.
        let there = self.reached == Some(end);
        self.resting_since_us = (holds && !there).then(|| self.resting_since_us.unwrap_or(now_us));
        if holds && there {
            self.enter(now_us, Stage::Leaving);
        }
    }

    /// An arm that has held the last setpoint for a while, and says then that it is elsewhere, is.
    fn check_end(&mut self, now_us: u64) {
        let held = self.resting_since_us.is_some_and(|since_us| now_us.saturating_sub(since_us) >= HOLDS_US);
        if self.stage == Stage::Streaming && held && self.holds_elsewhere() {
            self.stop(now_us, FaultCode::EndElsewhere);
        }
    }

    /// Whether the arm holds the last setpoint and has said last that it is elsewhere.
    fn holds_elsewhere(&self) -> bool {
        let end = self.end_setpoint().filter(|_| self.resting_since_us.is_some());
        end.zip(self.reached).is_some_and(|(end, reached)| reached.tick == end.tick && reached != end)
    }

    /// The plan's last setpoint in counts of the wire.
    fn end_setpoint(&self) -> Option<Setpoint> {
        self.player.end().rescaled(self.header.lsb, self.lsb).ok()
    }

    /// Standstill is watched for a time: an arm that has said so once may have stood between two ticks, or another one spoken.
    fn watch_stop(&mut self, now_us: u64, status: &Status) {
        // In a session that is over it says nothing of this one; somebody else may be moving it.
        if !status.standstill && may_move(status.state) {
            // It moves, but it still answers.
            self.give_up_at_us = now_us.saturating_add(self.config.handshake_us);
        }
        let stopped = !matches!(status.state, State::OperationEnabled | State::FaultReactionActive);
        if !(stopped && status.standstill) {
            self.stands_since_us = None;
            return;
        }
        let since_us = *self.stands_since_us.get_or_insert(now_us);
        self.give_up_at_us = self.give_up_at_us.max(since_us.saturating_add(3 * STANDS_US));
        // One that was let go says so in the end of its session; from then on it may move in another one.
        let closed = self.is_let_go() && status.state == State::ReadyToSwitchOn;
        let stands = closed || now_us.saturating_sub(since_us) >= STANDS_US;
        if let Some(fault) = self.fault.filter(|_| stands) {
            self.end(fault, true);
        }
    }

    // --- what we say ---

    /// A setpoint that should have arrived long ago, by what the arm last said.
    fn missing(&self) -> Option<Setpoint> {
        let round_trip = self.telemetry.round_trip;
        // On the way, a setpoint may be overtaken by a little without being lost.
        let overtaken_us =
            round_trip.shortest_us().unwrap_or(u64::MAX).saturating_add(u64::from(self.period_us) / 2);
        // An arm may tell of it in its next report only, however quick its answers are.
        let next_report_us = overtaken_us.saturating_add(self.period_us.into());
        let overdue_us = round_trip.overdue_us().max(next_report_us);
        self.window.missing(self.reported_us, overtaken_us, overdue_us)
    }

    fn resend(&mut self, now_us: u64) -> Option<Action> {
        if now_us < self.resend_at_us {
            return None;
        }
        let setpoint = self.missing()?;
        self.resend_at_us = now_us.saturating_add(u64::from(self.period_us));
        self.telemetry.resent = self.telemetry.resent.saturating_add(1);
        Some(self.send_setpoint(now_us, setpoint))
    }

    fn next_setpoint(&mut self, now_us: u64) -> Option<Action> {
        let planned = self.player.peek().filter(|next| self.schedule.allows(now_us, next.tick))?;
        let guard = self.guard.as_mut()?;
        let Ok(setpoint) = planned.rescaled(self.header.lsb, self.lsb) else {
            return Some(self.stop_instead(now_us, FaultCode::PlanUnreadable));
        };
        if let Err(violation) = guard.check(setpoint) {
            self.violation = Some(violation);
            self.latch(now_us, fault_of(&violation));
            return Some(self.pop());
        }
        self.player.advance();
        if self.player.peek().is_none() && planned != self.player.end() {
            // The plan was read to its end when it was opened; its memory must have changed.
            return Some(self.stop_instead(now_us, FaultCode::PlanUnreadable));
        }
        self.telemetry.sent = setpoint.tick;
        self.telemetry.late_us = self.schedule.late_us(now_us, setpoint.tick);
        Some(self.send_setpoint(now_us, setpoint))
    }

    fn send_setpoint(&mut self, now_us: u64, setpoint: Setpoint) -> Action {
        self.window.sent(now_us, setpoint);
        self.belief.sent(now_us, setpoint.tick);
        Action::Send(ToArm::Setpoint { session: self.config.session, setpoint })
    }

    fn stop_instead(&mut self, now_us: u64, code: FaultCode) -> Action {
        self.stop(now_us, code);
        self.pop()
    }

    fn pop(&mut self) -> Action {
        self.outbox.pop_front().map_or(Action::Wait, Action::Send)
    }

    /// Asks the arm for whatever the present stage needs.
    fn ask(&mut self, now_us: u64) {
        self.has_asked = true;
        self.retry_at_us = now_us.saturating_add(self.config.retry_us);
        match self.stage {
            Stage::Opening => self.queue(self.opening()),
            Stage::Enabling => {
                if let Some(command) = self.next_step_up() {
                    // Asked again, it is the first time that counts: which of the two is answered nobody can tell.
                    self.asked_us.get_or_insert(now_us);
                    self.command(command);
                }
            }
            Stage::Leaving => self.command(Command::Shutdown),
            Stage::Stopping if self.hard || self.stops_for_too_long(now_us) && self.may_be_at_work() => {
                self.queue(ToArm::Stop);
            }
            Stage::Stopping if self.is_let_go() && self.ours.is_some_and(|arm| arm.standstill) => {
                self.command(Command::Shutdown);
            }
            Stage::Stopping => self.command(Command::QuickStop),
            Stage::Streaming | Stage::Done(_) => {}
        }
    }

    /// An arm at the wrong place has been sent no setpoint: there is nothing to stop, nor to latch. By shutdown, as at the end of a
    /// plan: disable voltage would reset a stop that somebody else has latched meanwhile.
    fn is_let_go(&self) -> bool {
        self.fault.is_some_and(|fault| fault.code == FaultCode::AnchorElsewhere)
    }

    /// Whether the arm may be at work in this session, for all that is known. If it is not, a stop frame, which is of no session,
    /// would stop what somebody else does.
    fn may_be_at_work(&self) -> bool {
        self.ours.is_none_or(|arm| may_move(arm.state))
    }

    /// A controlled stop that takes longer than one may take.
    fn stops_for_too_long(&self, now_us: u64) -> bool {
        self.stop_ends_at_us.saturating_sub(now_us) < self.config.standstill_us / 2
    }

    /// An arm that is enabled and whose anchor has not arrived is asked again: it then repeats it.
    fn next_step_up(&self) -> Option<Command> {
        let arm = self.ours?;
        let step = WAY_UP.iter().find(|(from, _)| *from == arm.state).map(|(_, command)| *command);
        step.or((arm.state == State::OperationEnabled).then_some(Command::EnableOperation))
    }

    /// The arm has done what it was asked for.
    fn answered(&mut self, now_us: u64) {
        if let Some(asked_us) = self.asked_us.take() {
            let time_us = now_us.saturating_sub(asked_us);
            self.schedule.handle_round_trip(time_us);
            self.telemetry.round_trip.record(time_us);
        }
    }

    fn open_request(&self) -> OpenRequest {
        let PlanHeader { step_count, limits, .. } = self.header;
        OpenRequest {
            version: PROTOCOL_VERSION,
            session: self.config.session,
            plan_hash: self.plan_hash,
            period_us: self.period_us,
            end_tick: step_count,
            lsb: self.lsb,
            limits,
            start_level: self.schedule.look_ahead(),
            reset_nonce: self.reset_nonce,
        }
    }

    fn opening(&self) -> ToArm {
        let request = self.open_request();
        self.config.key.map_or(ToArm::Open(request), |key| {
            ToArm::OpenKeyed(request, key.prove(&request, self.config.nonce))
        })
    }

    fn command(&mut self, command: Command) {
        self.queue(ToArm::Control { session: self.config.session, command });
    }

    fn queue(&mut self, message: ToArm) {
        // A full queue means that nobody polls; the newest request is the one that counts.
        if self.outbox.is_full() {
            self.outbox.pop_front();
        }
        // There is room after one was taken out.
        let _ = self.outbox.push_back(message);
    }

    // --- stages ---

    fn enter(&mut self, now_us: u64, stage: Stage) {
        self.stage = stage;
        self.give_up_at_us = now_us.saturating_add(self.config.handshake_us);
        self.ask(now_us);
    }

    fn stop(&mut self, now_us: u64, code: FaultCode) {
        self.latch(now_us, Fault { code, tick: self.belief.tick() });
    }

    /// The first reason stays; from here on there is only stopping.
    fn latch(&mut self, now_us: u64, fault: Fault) {
        if matches!(self.stage, Stage::Stopping | Stage::Done(_)) {
            return;
        }
        self.fault = Some(fault);
        self.outbox.clear();
        if self.stage == Stage::Opening {
            return self.end_untouched(fault);
        }
        self.stop_ends_at_us = now_us.saturating_add(self.config.standstill_us);
        self.enter(now_us, Stage::Stopping);
    }

    fn end(&mut self, fault: Fault, standstill: bool) {
        self.stage = Stage::Done(Outcome::Stopped { fault, standstill });
    }

    /// Nothing has been asked of the arm that could make it move; but somebody else may be moving it.
    fn end_untouched(&mut self, fault: Fault) {
        self.end(fault, false);
    }

    // --- time ---

    fn check_time(&mut self, now_us: u64) {
        if now_us >= self.heartbeat_at_us && !matches!(self.stage, Stage::Done(_)) {
            self.heartbeat_at_us = now_us.saturating_add(HEARTBEAT_US);
            if self.context != Context::NONE {
                self.queue(ToArm::Heartbeat { session: self.context.session });
            }
        }
        match self.stage {
            Stage::Done(_) => {}
            Stage::Streaming => {
                if now_us >= self.silent_at_us() {
                    self.stop(now_us, FaultCode::ArmSilent);
                } else if now_us >= self.lost_at_us() {
                    let (tick, known) = (self.belief.tick(), self.reached.map_or(0, |reached| reached.tick));
                    self.doubt = Some(Doubt::Unlocated { tick, known });
                    self.stop(now_us, FaultCode::ArmSilent);
                } else if now_us >= self.stalled_at_us() {
                    let elsewhere = self.holds_elsewhere();
                    self.stop(
                        now_us,
                        if elsewhere { FaultCode::EndElsewhere } else { FaultCode::ArmStalled },
                    );
                }
            }
            Stage::Opening | Stage::Enabling | Stage::Leaving | Stage::Stopping => {
                let stop_ends = self.stage == Stage::Stopping && now_us >= self.stop_ends_at_us;
                if now_us >= self.give_up_at_us || stop_ends {
                    self.give_up(now_us);
                } else if now_us >= self.retry_at_us {
                    // The very first request is asked here too.
                    let again = u32::from(self.has_asked);
                    self.telemetry.retries = self.telemetry.retries.saturating_add(again);
                    self.ask(now_us);
                }
            }
        }
    }

    fn give_up(&mut self, now_us: u64) {
        match (self.stage, self.fault) {
            (Stage::Stopping, Some(fault)) => self.end(fault, false),
            (Stage::Opening, _) if self.refusal.is_some() => {
                self.end_untouched(Fault { code: FaultCode::SessionRefused, tick: 0 });
            }
            _ => self.stop(now_us, FaultCode::HandshakeTimeout),
        }
    }

    fn silent_at_us(&self) -> u64 {
        self.heard_us.saturating_add(self.longest_silence_us())
    }

    /// When an arm that goes on, and does not say where it is, counts as silent.
    fn lost_at_us(&self) -> u64 {
        self.lost_us.map_or(u64::MAX, |since_us| since_us.saturating_add(self.longest_silence_us()))
    }

    fn longest_silence_us(&self) -> u64 {
        self.config.silence_us.max(self.some_periods_us())
    }

    /// When an arm that has not moved on, or that moves on so slowly that it falls behind its clock by as much, is given up;
    /// later than one that says nothing at all.
    fn stalled_at_us(&self) -> u64 {
        let allowance_us = self.config.handshake_us.max(self.longest_silence_us().saturating_mul(2));
        let stands_at_us = self.progress_us.saturating_add(allowance_us);
        self.belief.overdue_us(allowance_us).map_or(stands_at_us, |late_us| late_us.min(stands_at_us))
    }

    fn some_periods_us(&self) -> u64 {
        u64::from(self.period_us).saturating_mul(SILENT_PERIODS)
    }
}

/// Whether an arm in this state may move.
fn may_move(state: State) -> bool {
    matches!(state, State::OperationEnabled | State::QuickStopActive | State::FaultReactionActive)
}

/// Whether an arm in this state has a stop latched.
fn is_latched(state: State) -> bool {
    matches!(state, State::QuickStopActive | State::FaultReactionActive | State::Fault)
}

/// Whether an arm on its way up is back where it begins: a stop or the end of the session does that. From switched on to ready it may
/// have been taken by a shutdown of our own, said twice and overtaken.
fn falls_back(before: State, now: State) -> bool {
    let is_beyond = matches!(before, State::ReadyToSwitchOn | State::SwitchedOn | State::OperationEnabled);
    let is_let_go = before == State::OperationEnabled && now == State::ReadyToSwitchOn;
    is_beyond && now == State::SwitchOnDisabled || is_let_go
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_shared::wire::state::{Event, transition};

    #[test]
    fn what_goes_back_to_the_beginning_falls_back() {
        use State as S;
        for before in State::ALL {
            let wanted: &[State] = match before {
                S::OperationEnabled => &[S::SwitchOnDisabled, S::ReadyToSwitchOn],
                S::SwitchedOn | S::ReadyToSwitchOn => &[S::SwitchOnDisabled],
                _ => &[],
            };
            for now in State::ALL {
                assert_eq!(falls_back(before, now), wanted.contains(&now), "{before:?} {now:?}");
            }
        }
    }

    #[test]
    fn the_way_up_is_one_of_the_table() {
        let mut state = State::SwitchOnDisabled;
        for (from, command) in WAY_UP {
            assert_eq!(from, state);
            state = transition(from, Event::Command(command)).unwrap().to;
        }
        assert_eq!(state, State::OperationEnabled);
    }
}
