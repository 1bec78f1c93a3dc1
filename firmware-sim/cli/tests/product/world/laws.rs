//! What may never happen, whatever has happened.

use powderline_executor::{Action, Config, Executor, Outcome};
use powderline_firmware_sim::controller::Controller;
use powderline_firmware_sim_cli::link::motion;
use powderline_firmware_sim_cli::link::witness::silence_bound_us;
use powderline_shared::displacement::{Axis, pose_at};
use powderline_shared::fault::{Fault, FaultCode};
use powderline_shared::pose::{Pose, norm};
use powderline_shared::wire::message::{FromArm, NO_SESSION, OpenRequest, ToArm};
use powderline_shared::wire::state::{Command, State};

use super::{AXES, HANDSHAKE_US, World, slot_of};

/// Longest life of an executor to which nothing is delivered any more, microseconds: the arm falls silent, and then
/// stopping it is given up.
const LAST_WORDS_US: u64 = 3 * HANDSHAKE_US;

/// Number of the session that performs a plan after everything; no other executor takes it.
const LAST_SESSION: u16 = 0x0C00;

/// How far off its plan's axis the arm may be by rounding of real numbers, metres or radians.
const ROUNDING: f64 = 1e-9;

/// What is seen of the arm.
#[derive(Clone, Copy, Debug)]
pub(super) struct Look {
    pose: Pose,
    state: State,
    fault: Option<Fault>,
    standstill: bool,
    clock_runs: bool,
    applied_tick: u32,
    lost: u32,
    session: u16,
    anchor: Option<Pose>,
}

impl Look {
    pub(super) fn at(arm: &Controller) -> Self {
        let status = arm.status();
        Self {
            pose: arm.pose(),
            state: status.state,
            fault: arm.fault(),
            standstill: status.standstill,
            clock_runs: arm.next_tick_us().is_some(),
            applied_tick: status.applied_tick,
            lost: arm.lost(),
            session: status.session,
            anchor: arm.anchor(),
        }
    }

    fn may_move(&self) -> bool {
        matches!(self.state, State::OperationEnabled | State::QuickStopActive | State::FaultReactionActive)
    }

    fn is_latched(&self) -> bool {
        matches!(self.state, State::Fault | State::QuickStopActive | State::FaultReactionActive)
    }
}

impl World<'_> {
    pub(super) fn breach(&mut self, what: String) {
        self.report.breaches.push(what);
    }

    /// Holds what the arm has done, when it was told `message` or nothing, to what it may do.
    pub(super) fn watch(&mut self, before: &Look, message: Option<&ToArm>) {
        let after = Look::at(self.arm());
        self.watch_motion(before, &after);
        self.watch_latched(before, &after, message);
        self.watch_obedience(before, &after, message);
        self.watch_sessions(before, &after, message);
    }

    fn watch_motion(&mut self, before: &Look, after: &Look) {
        let moved = before.pose != after.pose;
        if moved && !before.may_move() {
            self.breach(format!("the arm moved in the state {}", before.state.name()));
        }
        if !after.may_move() && (!after.standstill || after.clock_runs) {
            self.breach(format!("the arm's clock runs in the state {}", after.state.name()));
        }
        if moved && before.standstill {
            self.breach(String::from("the arm moved while it said that it stands"));
        }
        if moved && before.state == State::OperationEnabled && self.at_rest.contains(&before.session) {
            self.breach(format!("session {:#06x} moves the arm after its executor's end", before.session));
        }
        if after.state == State::OperationEnabled && !after.standstill {
            self.watch_setpoint(before, after);
        }
    }

    /// While operation is enabled every pose is on the way of the session's own plan, and a setpoint taken is exactly the
    /// plan's.
    fn watch_setpoint(&mut self, before: &Look, after: &Look) {
        let (Some(anchor), Some(slot)) = (after.anchor, slot_of(after.session)) else {
            return self.breach(String::from("the arm moves without an anchored session"));
        };
        let plan = self.scene.plan(slot);
        let commanded = self.arm().motion().pose;
        let off = anchor.displacement_to(&commanded);
        let mut across = Axis::ALL.into_iter().zip(off.components()).filter(|(axis, _)| *axis != AXES[slot]);
        if across.any(|(_, off)| off.abs() > ROUNDING) {
            self.breach(format!("session {:#06x} moves the arm along {off:?}", after.session));
        }
        let taken = after.applied_tick > before.applied_tick && after.lost == before.lost;
        let planned = plan.setpoints().find(|setpoint| setpoint.tick == after.applied_tick);
        let expected = planned.map(|setpoint| pose_at(&anchor, setpoint, plan.header().lsb));
        if taken && expected != Some(commanded) {
            let (tick, session) = (after.applied_tick, after.session);
            self.breach(format!("setpoint {tick} of session {session:#06x} is not what its executor sent"));
        }
    }

    fn watch_latched(&mut self, before: &Look, after: &Look, message: Option<&ToArm>) {
        if after.is_latched() && after.fault.is_none() {
            self.breach(format!("no reason is latched in the state {}", after.state.name()));
        }
        let left = before.is_latched() && !after.is_latched();
        let forgotten = before.fault.is_some() && after.fault != before.fault;
        if !left && !forgotten {
            return;
        }
        let asked = match message {
            Some(ToArm::Control { command: Command::FaultReset, .. }) => before.state == State::Fault,
            Some(ToArm::Control { command: Command::DisableVoltage, .. }) => {
                before.state == State::QuickStopActive
            }
            Some(ToArm::Open(request)) => is_reset(request) && before.state != State::FaultReactionActive,
            _ => false,
        };
        let opened = matches!(message, Some(ToArm::Open(request)) if request.session == after.session);
        let closed = after.fault.is_none()
            && after.state == State::SwitchOnDisabled
            && (after.session == NO_SESSION || opened);
        if !(asked && closed && before.standstill) {
            self.breach(format!(
                "latched {:?} in the state {} became {:?} in the state {} through {message:?}",
                before.fault,
                before.state.name(),
                after.fault,
                after.state.name()
            ));
        }
    }

    /// Only a latched stop is left on the word of somebody who is not in session with the arm.
    fn watch_obedience(&mut self, before: &Look, after: &Look, message: Option<&ToArm>) {
        let Some(ToArm::Control { session, command }) = message else { return };
        let changed = (before.state, before.session) != (after.state, after.session);
        if changed && *session != before.session && !before.is_latched() {
            let (from, to) = (before.state.name(), after.state.name());
            self.breach(format!("{command:?} of session {session:#06x} led from {from} to {to}"));
        }
    }

    /// Only whoever resets a latched stop may take the place of the session that latched it.
    fn watch_sessions(&mut self, before: &Look, after: &Look, message: Option<&ToArm>) {
        let replaced = before.session != NO_SESSION && after.session != before.session;
        let reset = before.is_latched() && matches!(message, Some(ToArm::Open(request)) if is_reset(request));
        if replaced && ((after.session != NO_SESSION && !reset) || !before.standstill) {
            self.breach(format!("session {:#06x} gave way to {:#06x}", before.session, after.session));
        }
        if after.session != before.session {
            self.left.extend(before.anchor.map(|anchor| (before.session, anchor, before.pose)));
        }
        let Some(anchor) = after.anchor.filter(|_| before.anchor.is_none() || replaced) else { return };
        if self.anchored.is_some_and(|(last, _)| last == after.session) {
            self.breach(format!("session {:#06x} is anchored once more", after.session));
        }
        self.anchored = Some((after.session, anchor));
        if anchor != before.pose || after.state != State::OperationEnabled || !before.standstill {
            self.breach(format!("session {:#06x} is anchored where the arm does not stand", after.session));
        }
    }

    pub(super) fn watch_ending(&mut self, slot: usize, session: u16, outcome: Outcome) {
        let (now, last) = (Look::at(self.arm()), self.anchored);
        let claims_rest = !matches!(outcome, Outcome::Stopped { standstill: false, .. });
        // Whoever was enabled since may move it.
        if claims_rest && last.is_none_or(|(last, _)| last == session) && !now.standstill {
            self.breach(format!(
                "the executor of session {session:#06x} says {outcome:?}, but the arm moves"
            ));
        }
        if claims_rest {
            self.at_rest.push(session);
        }
        if outcome == Outcome::Completed {
            self.watch_completion(slot, session, &now.pose);
        }
    }

    fn watch_completion(&mut self, slot: usize, session: u16, pose: &Pose) {
        let last = self.anchored;
        let present = last.filter(|(last, _)| *last == session).map(|(_, anchor)| (anchor, *pose));
        let past = self.left.iter().rev().find(|(left, ..)| *left == session);
        let Some((anchor, pose)) = past.map(|(_, anchor, pose)| (*anchor, *pose)).or(present) else {
            return self
                .breach(format!("session {session:#06x} completed, but the last one enabled was {last:?}"));
        };
        let plan = self.scene.plan(slot);
        let end = pose_at(&anchor, plan.end_setpoint(), plan.header().lsb);
        if pose != end || !is_at_start(&anchor) {
            self.breach(format!("session {session:#06x} completed at {pose:?} from {anchor:?}"));
        }
    }

    // --- ways out ---

    /// Whether the arm, left alone, comes to rest out of operation, can then be reset by a person, and performs a plan
    /// over a wire in order.
    ///
    /// # Errors
    /// What does not.
    pub(crate) fn find_way_out(&self) -> Result<(), String> {
        let (mut arm, mut now_us) = (self.arm().clone(), self.now_us);
        let until_us = now_us + silence_bound_us(self.scene.period_us);
        while now_us < until_us {
            now_us = arm.poll_at().clamp(now_us + 1, until_us);
            drop(drain(&mut arm, now_us));
        }
        let status = arm.status();
        if !status.standstill || status.state == State::OperationEnabled {
            return Err(format!("left alone, the arm is in {status:?}"));
        }
        drop(drain(&mut arm, now_us));
        self.perform(&mut arm, now_us)
    }

    fn perform(&self, arm: &mut Controller, mut now_us: u64) -> Result<(), String> {
        let at_start = is_at_start(&arm.pose());
        let plan = self.scene.plan(0);
        let config = Config { session: LAST_SESSION, reset: true, ..Config::default() };
        let mut executor = Executor::new(now_us, &plan, config);
        let until_us = now_us + LAST_WORDS_US;
        let outcome = loop {
            if now_us > until_us {
                return Err(String::from("after a reset the arm plays for ever"));
            }
            drain(arm, now_us).iter().for_each(|message| executor.handle_message(now_us, message));
            match executor.poll(now_us) {
                Action::Send(message) => arm.handle_message(now_us, &message),
                Action::Finished(outcome) => break outcome,
                Action::Wait => {
                    let next_us = executor.poll_at().map_or(now_us, |at_us| at_us.min(arm.poll_at()));
                    now_us = next_us.max(now_us + 1);
                }
            }
        };
        let right = match outcome {
            Outcome::Completed => at_start,
            Outcome::Stopped { fault, standstill } => {
                !at_start && standstill && fault.code == FaultCode::AnchorElsewhere
            }
        };
        right.then_some(()).ok_or_else(|| format!("after a reset the arm does not play: {outcome:?}"))
    }

    /// Whether an executor to which nothing is delivered any more ends.
    ///
    /// # Errors
    /// It does not.
    pub(crate) fn let_end(&self, slot: usize) -> Result<(), String> {
        let Some(executor) = &self.nodes[slot].machine else { return Ok(()) };
        let (mut executor, mut now_us) = (Executor::clone(executor), self.now_us);
        let until_us = now_us + LAST_WORDS_US;
        loop {
            match executor.poll(now_us) {
                Action::Send(_) => {}
                Action::Finished(_) => return Ok(()),
                Action::Wait if now_us >= until_us => {
                    return Err(format!("executor {slot} does not end though it hears nothing"));
                }
                Action::Wait => now_us = executor.poll_at().unwrap_or(until_us).clamp(now_us + 1, until_us),
            }
        }
    }
}

fn is_reset(request: &OpenRequest) -> bool {
    request.reset_nonce != 0
}

fn is_at_start(pose: &Pose) -> bool {
    let off = motion::start().displacement_to(pose);
    norm(&off.translation()) <= Config::default().anchor_tolerance_m
}

fn drain(arm: &mut Controller, now_us: u64) -> Vec<FromArm> {
    std::iter::from_fn(|| arm.poll(now_us)).collect()
}
