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
//! Stopping goes on for as long as the arm reports that it moves; only an arm that falls silent is given up, and the
//! outcome then says that nobody knows whether it stands.
//!
//! Whatever is asked of the arm is asked again after [`Config::retry_us`] until it is done or the time for it is over.

use heapless::Deque;
use nalgebra::Vector3;
use powderline_shared::fault::{Fault, FaultCode};
use powderline_shared::limits::{PeakUse, Violation};
use powderline_shared::plan::{PlanHeader, PlanReader};
use powderline_shared::pose::{Pose, norm};
use powderline_shared::wire::message::{FromArm, OpenRequest, PROTOCOL_VERSION, Refusal, Status, ToArm};
use powderline_shared::wire::state::{Command, Phase, State};

use crate::guard::{Guard, fault_of};
use crate::player::Player;
use crate::schedule::{DEFAULT_LOOK_AHEAD, Schedule};

/// Commands that lead from standing without power to operation enabled: in which state, which command.
pub const WAY_UP: [(State, Command); 3] = [
    (State::SwitchOnDisabled, Command::Shutdown),
    (State::ReadyToSwitchOn, Command::SwitchOn),
    (State::SwitchedOn, Command::EnableOperation),
];

/// Room for messages that are not setpoints. Each is also retried, so a full queue costs time, not a message.
const OUTBOX_CAPACITY: usize = 4;

/// Periods without a report after which the arm is silent, at the least.
const SILENT_PERIODS: u64 = 4;

/// Largest difference between where the arm holds and the last setpoint, LSB; the excess over one half is for rounding.
const END_TOLERANCE_LSB: f64 = 0.5 * 1.01;

/// What may differ from arm to arm. Times in microseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Number of the session, not 0.
    pub session: u16,
    /// Setpoints ahead of the arm's clock.
    pub look_ahead: u16,
    /// Largest distance of the anchor from the plan's start pose, metres.
    pub anchor_tolerance_m: f64,
    /// Largest angle of the anchor from the plan's start pose, radians.
    pub anchor_tolerance_rad: f64,
    /// When an unanswered request is repeated.
    pub retry_us: u64,
    /// When the handshake or leaving is given up, and stopping an arm that no longer reports.
    pub handshake_us: u64,
    /// When an arm that moves and does not report counts as silent; at least four control periods.
    pub silence_us: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            session: 1,
            look_ahead: DEFAULT_LOOK_AHEAD,
            anchor_tolerance_m: 0.5e-3,
            anchor_tolerance_rad: 5e-3,
            retry_us: 100_000,
            handshake_us: 2_000_000,
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
    player: Player<'a>,
    schedule: Schedule,
    guard: Option<Guard>,
    stage: Stage,
    outbox: Deque<ToArm, OUTBOX_CAPACITY>,
    arm: Option<Status>,
    /// The pose that the arm has reported, with the tick that it belongs to.
    actual: Option<(u32, Pose)>,
    fault: Option<Fault>,
    violation: Option<Violation>,
    refusal: Option<Refusal>,
    heard_us: u64,
    retry_at_us: u64,
    give_up_at_us: u64,
}

impl<'a> Executor<'a> {
    /// Opens a session with the next poll.
    #[must_use]
    pub fn new(now_us: u64, plan: &PlanReader<'a>, config: Config) -> Self {
        Self {
            config,
            header: *plan.header(),
            plan_hash: plan.content_hash(),
            player: Player::new(plan),
            schedule: Schedule::new(config.look_ahead),
            guard: None,
            stage: Stage::Opening,
            outbox: Deque::new(),
            arm: None,
            actual: None,
            fault: None,
            violation: None,
            refusal: None,
            heard_us: now_us,
            retry_at_us: now_us,
            give_up_at_us: now_us.saturating_add(config.handshake_us),
        }
    }

    /// Takes in one message of the arm.
    pub fn handle_message(&mut self, now_us: u64, message: &FromArm) {
        match *message {
            FromArm::Opened { session } if self.is_ours(session) => {
                self.heard_us = now_us;
                if self.stage == Stage::Opening {
                    self.enter(now_us, Stage::Enabling);
                }
            }
            FromArm::Refused { session, reason } if self.is_ours(session) => {
                if self.stage == Stage::Opening {
                    self.refusal = Some(reason);
                    self.end_untouched(Fault { code: FaultCode::SessionRefused, tick: 0 });
                }
            }
            FromArm::Anchored { session, pose } if self.is_ours(session) => self.anchored(now_us, &pose),
            FromArm::Actual { session, tick, pose } if self.is_ours(session) => {
                self.heard_us = now_us;
                self.actual = Some((tick, pose));
                self.leave_at_end(now_us);
            }
            FromArm::Status(status) => self.status(now_us, &status),
            // Of another session: no business of ours.
            FromArm::Opened { .. }
            | FromArm::Refused { .. }
            | FromArm::Anchored { .. }
            | FromArm::Actual { .. } => {}
        }
    }

    /// A person wants the arm to stop.
    pub fn handle_stop(&mut self, now_us: u64) {
        self.stop(now_us, FaultCode::OperatorStop);
    }

    /// What to do now. Call until it says [`Action::Wait`] or [`Action::Finished`].
    pub fn poll(&mut self, now_us: u64) -> Action {
        self.check_time(now_us);
        if let Some(message) = self.outbox.pop_front() {
            return Action::Send(message);
        }
        match self.stage {
            Stage::Streaming => self.next_setpoint(now_us),
            Stage::Done(outcome) => Action::Finished(outcome),
            Stage::Opening | Stage::Enabling | Stage::Leaving | Stage::Stopping => Action::Wait,
        }
    }

    /// When to poll next even if no message arrives, microseconds; a moment in the past means at once, `None` that the
    /// session is over.
    #[must_use]
    pub fn poll_at(&self) -> Option<u64> {
        if !self.outbox.is_empty() {
            return Some(0);
        }
        match self.stage {
            Stage::Done(_) => None,
            Stage::Streaming => Some(self.silent_at_us()),
            Stage::Opening | Stage::Enabling | Stage::Leaving | Stage::Stopping => {
                Some(self.retry_at_us.min(self.give_up_at_us))
            }
        }
    }

    /// The arm's last report.
    #[must_use]
    pub fn arm_status(&self) -> Option<&Status> {
        self.arm.as_ref()
    }

    /// The arm's last reported pose.
    #[must_use]
    pub fn actual_pose(&self) -> Option<Pose> {
        self.actual.map(|(_, pose)| pose)
    }

    /// The numbers behind a limit fault of our own.
    #[must_use]
    pub fn violation(&self) -> Option<Violation> {
        self.violation
    }

    /// Why the arm refused the session.
    #[must_use]
    pub fn refusal(&self) -> Option<Refusal> {
        self.refusal
    }

    /// Largest use of each limit by the setpoints sent.
    #[must_use]
    pub fn peak_use(&self) -> PeakUse {
        self.guard.map_or_else(PeakUse::default, |guard| guard.peak_use())
    }

    fn is_ours(&self, session: u16) -> bool {
        session == self.config.session
    }

    // --- what the arm says ---

    fn anchored(&mut self, now_us: u64, anchor: &Pose) {
        self.heard_us = now_us;
        if self.stage != Stage::Enabling {
            return;
        }
        let off = self.header.start_pose().displacement_to(anchor);
        let near = norm(&off.translation()) <= self.config.anchor_tolerance_m
            && norm(&off.rotation()) <= self.config.anchor_tolerance_rad;
        if !near {
            return self.stop(now_us, FaultCode::AnchorElsewhere);
        }
        let PlanHeader { limits, lsb, control_period_us, step_count, .. } = self.header;
        self.guard = Some(Guard::new(*anchor, limits, lsb, control_period_us, step_count));
        self.actual = Some((0, *anchor));
        self.enter(now_us, Stage::Streaming);
    }

    fn status(&mut self, now_us: u64, status: &Status) {
        let ours = self.is_ours(status.session);
        if ours {
            self.heard_us = now_us;
            self.schedule.handle_progress(status.applied_tick, status.credit_until);
        }
        let news = self.arm.is_none_or(|known| known.state != status.state);
        self.arm = Some(*status);
        if let (true, Some(fault)) = (ours, status.fault) {
            self.latch(now_us, fault);
        }
        match self.stage {
            Stage::Enabling if news => self.ask(now_us),
            Stage::Streaming => self.watch(now_us, ours, status),
            Stage::Leaving if !ours && status.state == State::ReadyToSwitchOn => {
                self.stage = Stage::Done(Outcome::Completed);
            }
            Stage::Stopping => self.watch_stop(now_us, ours, status),
            Stage::Opening | Stage::Enabling | Stage::Leaving | Stage::Done(_) => {}
        }
    }

    fn watch(&mut self, now_us: u64, ours: bool, status: &Status) {
        if !ours || status.state != State::OperationEnabled {
            return self.stop(now_us, FaultCode::StateUnexpected);
        }
        self.leave_at_end(now_us);
    }

    /// Goes on once the arm has reported both that it holds the last setpoint and where that is, in whatever order.
    fn leave_at_end(&mut self, now_us: u64) {
        let end_tick = self.player.end().tick;
        let holds = self.arm.is_some_and(|arm| {
            self.is_ours(arm.session) && arm.phase == Some(Phase::Holding) && arm.applied_tick == end_tick
        });
        if self.stage != Stage::Streaming || !holds {
            return;
        }
        match self.stands_at_end() {
            Some(true) => self.enter(now_us, Stage::Leaving),
            Some(false) => self.stop(now_us, FaultCode::EndElsewhere),
            // Its last poses have been lost. Should none follow, the arm is silent.
            None => {}
        }
    }

    /// Whether the pose that the arm reports for the last tick is that of the last setpoint; `None` before it has.
    fn stands_at_end(&self) -> Option<bool> {
        let end = self.player.end();
        let (_, actual) = self.actual.filter(|(tick, _)| *tick == end.tick)?;
        let off = self.guard.as_ref()?.pose_at(end).displacement_to(&actual);
        let lsb = self.header.lsb;
        // Asked as "is it near", so that NaN fails.
        let near = |off: Vector3<f64>, lsb: f64| off.iter().all(|x| x.abs() <= END_TOLERANCE_LSB * lsb);
        Some(near(off.translation(), lsb.translation_m()) && near(off.rotation(), lsb.rotation_rad()))
    }

    fn watch_stop(&mut self, now_us: u64, ours: bool, status: &Status) {
        let stopped = !matches!(status.state, State::OperationEnabled | State::FaultReactionActive);
        match self.fault {
            Some(fault) if stopped && status.standstill => self.end(fault, true),
            // It moves, but it still answers.
            _ if ours && !status.standstill => {
                self.give_up_at_us = now_us.saturating_add(self.config.handshake_us);
            }
            _ => {}
        }
    }

    // --- what we say ---

    fn next_setpoint(&mut self, now_us: u64) -> Action {
        let Some(setpoint) = self.player.peek().filter(|next| self.schedule.allows(next.tick)) else {
            return Action::Wait;
        };
        let Some(guard) = self.guard.as_mut() else { return Action::Wait };
        if let Err(violation) = guard.check(setpoint) {
            self.violation = Some(violation);
            self.latch(now_us, fault_of(&violation));
            return self.outbox.pop_front().map_or(Action::Wait, Action::Send);
        }
        self.player.advance();
        if self.player.peek().is_none() && setpoint != self.player.end() {
            // The plan was read to its end when it was opened; its memory must have changed.
            self.stop(now_us, FaultCode::PlanUnreadable);
            return self.outbox.pop_front().map_or(Action::Wait, Action::Send);
        }
        Action::Send(ToArm::Setpoint { session: self.config.session, setpoint })
    }

    /// Asks the arm for whatever the present stage needs.
    fn ask(&mut self, now_us: u64) {
        self.retry_at_us = now_us.saturating_add(self.config.retry_us);
        let state = self.arm.map(|arm| arm.state);
        match self.stage {
            Stage::Opening => self.queue(ToArm::Open(self.open_request())),
            Stage::Enabling => {
                let next = WAY_UP.iter().find(|(from, _)| Some(*from) == state);
                next.into_iter().for_each(|(_, command)| self.command(*command));
            }
            Stage::Leaving => self.command(Command::Shutdown),
            Stage::Stopping => self.command(Command::QuickStop),
            Stage::Streaming | Stage::Done(_) => {}
        }
    }

    fn open_request(&self) -> OpenRequest {
        let PlanHeader { control_period_us, step_count, lsb, limits, .. } = self.header;
        OpenRequest {
            version: PROTOCOL_VERSION,
            session: self.config.session,
            plan_hash: self.plan_hash,
            period_us: control_period_us,
            end_tick: step_count,
            lsb,
            limits,
            start_level: self.schedule.look_ahead(),
        }
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
        let tick = self.arm.filter(|arm| self.is_ours(arm.session)).map_or(0, |arm| arm.applied_tick);
        self.latch(now_us, Fault { code, tick });
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
        self.enter(now_us, Stage::Stopping);
    }

    fn end(&mut self, fault: Fault, standstill: bool) {
        self.stage = Stage::Done(Outcome::Stopped { fault, standstill });
    }

    /// Nothing has been asked of the arm that could make it move: what it last said holds.
    fn end_untouched(&mut self, fault: Fault) {
        self.end(fault, self.arm.is_some_and(|arm| arm.standstill));
    }

    // --- time ---

    fn check_time(&mut self, now_us: u64) {
        match self.stage {
            Stage::Done(_) => {}
            Stage::Streaming => {
                if now_us >= self.silent_at_us() {
                    self.stop(now_us, FaultCode::ArmSilent);
                }
            }
            Stage::Opening | Stage::Enabling | Stage::Leaving | Stage::Stopping => {
                if now_us >= self.give_up_at_us {
                    self.give_up(now_us);
                } else if now_us >= self.retry_at_us {
                    self.ask(now_us);
                }
            }
        }
    }

    fn give_up(&mut self, now_us: u64) {
        match (self.stage, self.fault) {
            (Stage::Stopping, Some(fault)) => self.end(fault, false),
            _ => self.stop(now_us, FaultCode::HandshakeTimeout),
        }
    }

    fn silent_at_us(&self) -> u64 {
        let periods = u64::from(self.header.control_period_us).saturating_mul(SILENT_PERIODS);
        self.heard_us.saturating_add(self.config.silence_us.max(periods))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_shared::wire::state::{Event, transition};

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
