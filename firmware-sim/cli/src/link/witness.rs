//! Somebody who knows nothing of the two state machines but what can be seen from outside, and holds them to what may
//! never happen.
//!
//! | invariant           | statement                                                                                       |
//! |---------------------|-------------------------------------------------------------------------------------------------|
//! | limits              | speed, acceleration, jerk from tick to tick: those in force; in a latched stop, the arm's own   |
//! | workspace           | while operation is enabled the tool is inside the box in force                                  |
//! | authentic           | a setpoint taken is, to the last bit, the one that the session's executor sent for that tick    |
//! | enabled             | the arm moves in operation enabled, quick stop active and fault reaction active only            |
//! | silence             | nothing heard of the session's executor for [`silence_bound_us`]: the arm stands                |
//! | latched             | a latched reason stays until a standing arm is reset                                            |
//! | no motion unheld    | an arm that nobody is in session with ends at standstill, not in operation enabled              |
//! | arrived or stopped  | completed means at the plan's end; standing means standing                                      |

use std::collections::HashMap;

use powderline_firmware_sim::controller::{Controller, DEFAULT_WATCHDOG_US};
use powderline_firmware_sim::stop::LONGEST_STOP_US;
use powderline_shared::displacement::{Axis, Lsb, Setpoint, pose_at};
use powderline_shared::fault::Fault;
use powderline_shared::limits::{Limits, Motion};
use powderline_shared::pose::Pose;
use powderline_shared::wire::message::NO_SESSION;
use powderline_shared::wire::state::State;

/// Ticks without a look at the arm's derivatives after it was held up: until each difference is one of regular ticks.
const BLIND_TICKS: u32 = 4;

/// Longest time from the last that is heard of an executor to standstill, microseconds of the arm's time: the watchdog,
/// the tick at which it takes effect, and the longest stop.
#[must_use]
pub fn silence_bound_us(period_us: u32) -> u64 {
    DEFAULT_WATCHDOG_US.saturating_add(u64::from(period_us)).saturating_add(u64::from(LONGEST_STOP_US))
}

/// Something that may never happen, and did.
#[derive(Clone, Debug, PartialEq)]
pub struct Breach {
    /// When, microseconds of true time.
    pub at_us: u64,
    /// One sentence.
    pub what: String,
}

/// See the head of this file.
#[derive(Clone, Debug)]
pub struct Witness {
    lsb: Lsb,
    own_limits: Limits,
    seen: Motion,
    blind_ticks: u32,
    last: Look,
    sent: HashMap<u16, Vec<Setpoint>>,
    anchors: HashMap<u16, Pose>,
    /// Where sessions that are over have left the arm: their end may hear of it late.
    left: HashMap<u16, Pose>,
    heard_us: u64,
    stood_us: u64,
    /// What may never happen, and did.
    pub breaches: Vec<Breach>,
    /// Longest time from the last that was heard of an executor to standstill, microseconds of the arm's time.
    pub worst_silence_us: u64,
}

/// What was seen the last time.
#[derive(Clone, Copy, Debug)]
struct Look {
    pose: Pose,
    state: State,
    fault: Option<Fault>,
    standstill: bool,
    next_tick_us: Option<u64>,
    applied_tick: u32,
    lost: u32,
    session: u16,
}

impl Look {
    fn at(arm: &Controller) -> Self {
        let status = arm.status();
        Self {
            pose: arm.pose(),
            state: status.state,
            fault: arm.fault(),
            standstill: status.standstill,
            next_tick_us: arm.next_tick_us(),
            applied_tick: status.applied_tick,
            lost: arm.lost(),
            session: status.session,
        }
    }
}

impl Witness {
    /// Begins to watch an arm that stands.
    #[must_use]
    pub fn new(arm: &Controller, lsb: Lsb, own_limits: Limits) -> Self {
        Self {
            lsb,
            own_limits,
            seen: Motion::at_rest(arm.pose()),
            blind_ticks: 0,
            last: Look::at(arm),
            sent: HashMap::new(),
            anchors: HashMap::new(),
            left: HashMap::new(),
            heard_us: 0,
            stood_us: 0,
            breaches: Vec::new(),
            worst_silence_us: 0,
        }
    }

    /// An executor has sent a setpoint.
    pub fn setpoint_sent(&mut self, session: u16, setpoint: Setpoint) {
        let sent = self.sent.entry(session).or_default();
        if sent.last().is_none_or(|last| last.tick < setpoint.tick) {
            sent.push(setpoint);
        }
    }

    /// Something of the arm's own session has reached it, by the arm's clock.
    pub fn heard(&mut self, arm_us: u64) {
        self.heard_us = self.heard_us.max(arm_us);
    }

    /// The arm was held up for so long.
    pub fn held_up(&mut self, for_us: u64) {
        self.heard_us = self.heard_us.saturating_add(for_us);
        self.blind_ticks = BLIND_TICKS;
    }

    /// Another controller has been switched on: what was latched is gone with the one before.
    pub fn restarted(&mut self, arm: &Controller) {
        self.seen = Motion::at_rest(arm.pose());
        self.last = Look::at(arm);
    }

    /// Looks at the arm after it has had time to do something. `arm_us` is its clock.
    pub fn look(&mut self, at_us: u64, arm_us: u64, arm: &Controller) {
        let now = Look::at(arm);
        let last = self.last;
        if let Some(anchor) = arm.anchor() {
            self.anchors.insert(now.session, anchor);
        }
        if now.session != last.session {
            self.left.insert(last.session, last.pose);
        }
        let may_move = |state| {
            matches!(state, State::OperationEnabled | State::QuickStopActive | State::FaultReactionActive)
        };
        if now.pose != last.pose && !may_move(last.state) {
            self.breach(at_us, format!("the arm moved in the state {}", last.state.name()));
        }
        if last.fault.is_some() && now.fault != last.fault {
            let reset = now.fault.is_none()
                && now.state == State::SwitchOnDisabled
                && last.standstill
                && matches!(last.state, State::Fault | State::QuickStopActive);
            if !reset {
                self.breach(at_us, format!("a latched reason went from {:?} to {:?}", last.fault, now.fault));
            }
        }
        if matches!(now.state, State::Fault | State::QuickStopActive | State::FaultReactionActive)
            && now.fault.is_none()
        {
            self.breach(at_us, format!("no reason is latched in the state {}", now.state.name()));
        }
        if last.next_tick_us.is_some_and(|tick_us| tick_us <= arm_us) {
            self.tick(at_us, arm, &now);
        }
        self.check_silence(at_us, arm_us, arm, &now);
        if now.standstill {
            if !last.standstill {
                self.came_to_rest(at_us, arm, &now);
            }
            self.stood_us = at_us;
            self.seen = Motion::at_rest(now.pose);
        }
        self.last = now;
    }

    fn tick(&mut self, at_us: u64, arm: &Controller, now: &Look) {
        self.seen = self.seen.moved_to(now.pose, arm.period_us());
        if self.blind_ticks > 0 {
            self.blind_ticks = self.blind_ticks.saturating_sub(1);
        } else {
            self.check_limits(at_us, arm, now);
        }
        if now.state != State::OperationEnabled {
            return;
        }
        self.check_workspace(at_us, arm, now);
        let taken = now.session == self.last.session
            && now.applied_tick == self.last.applied_tick.saturating_add(1)
            && now.lost == self.last.lost;
        if taken {
            self.check_authentic(at_us, arm, now);
        }
    }

    /// An arm that is said to stand no longer moves in the tick to come, whenever it was said: that, too, is within limits.
    fn came_to_rest(&mut self, at_us: u64, arm: &Controller, now: &Look) {
        self.seen = self.seen.moved_to(now.pose, arm.period_us());
        if self.blind_ticks == 0 {
            self.check_limits(at_us, arm, now);
        }
    }

    fn check_limits(&mut self, at_us: u64, arm: &Controller, now: &Look) {
        let limits = if now.state == State::OperationEnabled { arm.limits() } else { self.own_limits };
        let noises = noise(self.lsb, arm.period_us());
        for (((limit, bound), value), noise) in
            limits.derivative_bounds().into_iter().zip(self.seen.norms()).zip(noises)
        {
            if value > bound * (1.0 + 1e-6) + noise {
                let state = now.state.name();
                self.breach(
                    at_us,
                    format!("{limit} was {value} {}, the limit is {bound} ({state})", limit.unit()),
                );
            }
        }
    }

    fn check_workspace(&mut self, at_us: u64, arm: &Controller, now: &Look) {
        let Limits { workspace_min_m: min, workspace_max_m: max, .. } = arm.limits();
        let position: [f64; 3] = now.pose.position_m.into();
        for (((x, min), max), axis) in position.into_iter().zip(min).zip(max).zip(Axis::ALL) {
            let tolerance = self.lsb.translation_m();
            if !(min - tolerance..=max + tolerance).contains(&x) {
                self.breach(at_us, format!("{axis} was {x} m, outside the workspace"));
            }
        }
    }

    fn check_authentic(&mut self, at_us: u64, arm: &Controller, now: &Look) {
        let sent = self.sent.get(&now.session).map(Vec::as_slice).unwrap_or_default();
        let sent = sent.iter().find(|sent| sent.tick == now.applied_tick);
        let expected = arm.anchor().zip(sent).map(|(anchor, sent)| pose_at(&anchor, *sent, self.lsb));
        if expected != Some(arm.motion().pose) {
            let (tick, session) = (now.applied_tick, now.session);
            self.breach(
                at_us,
                format!("setpoint {tick} of session {session:#06x} is not what its executor sent"),
            );
        }
    }

    fn check_silence(&mut self, at_us: u64, arm_us: u64, arm: &Controller, now: &Look) {
        let silence_us = arm_us.saturating_sub(self.heard_us);
        if !self.last.standstill && now.standstill && now.fault.is_some() {
            self.worst_silence_us = self.worst_silence_us.max(silence_us);
        }
        if !now.standstill && silence_us > silence_bound_us(arm.period_us()) {
            self.breach(at_us, format!("the arm moves {silence_us} us after it last heard of its executor"));
        }
    }

    /// An executor says that its plan, which ends so far from its anchor, is completed.
    pub fn completed(
        &mut self,
        at_us: u64,
        arm: &Controller,
        session: u16,
        end: Setpoint,
        plan_lsb: Lsb,
    ) -> f64 {
        let Some(anchor) = self.anchors.get(&session) else {
            self.breach(at_us, String::from("completed without ever having been enabled"));
            return f64::INFINITY;
        };
        // Component by component, as setpoints are rounded; the logarithm of the difference of two rotations is not that.
        let pose = self.left.get(&session).copied().unwrap_or(arm.pose());
        let found = anchor.displacement_to(&pose).components();
        let lsb = Axis::ALL.map(|axis| self.lsb.of(axis));
        let off = found.into_iter().zip(end.cumulative(plan_lsb).components()).zip(lsb);
        let worst = off.fold(0.0_f64, |worst, ((found, end), lsb)| worst.max((found - end).abs() / lsb));
        if worst > 0.5 * (1.0 + 1e-6) {
            self.breach(at_us, format!("completed, {worst} LSB off the plan's end"));
        }
        worst
    }

    /// An executor says that the arm stands; its news may be so old.
    pub fn said_to_stand(&mut self, at_us: u64, news_us: u64) {
        if self.stood_us.saturating_add(news_us) < at_us {
            self.breach(at_us, String::from("an executor says that the arm stands, but it moves"));
        }
    }

    /// The run is over; nobody has been in session with the arm for longer than the bound of silence.
    pub fn over(&mut self, at_us: u64, arm: &Controller) {
        let status = arm.status();
        if !status.standstill || status.state == State::OperationEnabled || !latched_or_closed(arm) {
            self.breach(at_us, format!("left alone, the arm is in the state {}", status.state.name()));
        }
    }

    /// Takes note of a breach.
    pub fn breach(&mut self, at_us: u64, what: String) {
        self.breaches.push(Breach { at_us, what });
    }
}

fn latched_or_closed(arm: &Controller) -> bool {
    arm.fault().is_some() || arm.status().session == NO_SESSION
}

/// What rounding to counts can add to the differences from tick to tick: see `powderline_shared::limits`.
fn noise(lsb: Lsb, period_us: u32) -> [f64; 6] {
    let h = f64::from(period_us) / 1e6;
    let of = |q: f64| {
        let v = 1.01 * 3.0_f64.sqrt() * q / h;
        [v, 2.0 * v / h, 4.0 * v / (h * h)]
    };
    let ([v, a, j], [w, alpha, zeta]) = (of(lsb.translation_m()), of(lsb.rotation_rad()));
    [v, a, j, w, alpha, zeta]
}
