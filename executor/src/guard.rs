//! The last look at a setpoint before it leaves: limits, from where the arm really stands.

use core::fmt;

use powderline_shared::displacement::{Axis, Lsb, Setpoint, SetpointError, pose_at};
use powderline_shared::fault::{Fault, FaultCode, Side};
use powderline_shared::limits::{LimitChecker, Limits, Motion, PeakUse, Violation};
use powderline_shared::plan::PlanReader;
use powderline_shared::pose::Pose;
use powderline_shared::sieve::Sieve;

/// Checks setpoints in the order of their ticks.
#[derive(Clone, Copy, Debug)]
pub struct Guard {
    anchor: Pose,
    lsb: Lsb,
    end_tick: u32,
    period_us: u32,
    /// Passes most setpoints at little cost.
    sieve: Sieve,
    /// Decides on the others.
    checker: LimitChecker,
    /// The last three, which velocity, acceleration and jerk come from.
    last: [Setpoint; 3],
}

impl Guard {
    /// For an arm that stands at `anchor`.
    #[must_use]
    pub fn new(anchor: Pose, limits: Limits, lsb: Lsb, period_us: u32, end_tick: u32) -> Self {
        Self {
            anchor,
            lsb,
            end_tick,
            period_us,
            sieve: Sieve::new(&anchor, &limits, lsb, period_us),
            checker: LimitChecker::new(limits, lsb, period_us, anchor),
            last: [Setpoint::ANCHOR; 3],
        }
    }

    /// Checks the next setpoint; the last one also for whether the arm may come to rest there.
    ///
    /// # Errors
    /// The first limit broken.
    pub fn check(&mut self, setpoint: Setpoint) -> Result<(), Violation> {
        let (sieve, passes) = self.sieve.after(setpoint);
        let ends = setpoint.tick >= self.end_tick;
        if !passes || (ends && !sieve.may_end()) {
            self.check_exactly(setpoint, ends)?;
        }
        self.sieve = sieve;
        let [_, b, c] = self.last;
        self.last = [b, c, setpoint];
        Ok(())
    }

    /// With the very numbers that the plan was checked with, and the arm checks with.
    fn check_exactly(&mut self, setpoint: Setpoint, ends: bool) -> Result<(), Violation> {
        let [a, b, c] = self.last;
        if self.checker.tick() != c.tick {
            // Standing at the anchor is no step of the motion.
            let moved = [b, c].into_iter().filter(|next| next.tick > 0);
            let motion = moved.fold(Motion::at_rest(self.led_to(a)), |motion, next| {
                motion.moved_to(self.led_to(next), self.period_us)
            });
            self.checker.resume(c.tick, motion);
        }
        self.checker.check(self.led_to(setpoint))?;
        if ends {
            let mut ending = self.checker;
            ending.finish()?;
        }
        Ok(())
    }

    /// Where the motion was led to: at first the anchor, with its very bits.
    fn led_to(&self, setpoint: Setpoint) -> Pose {
        if setpoint.tick == 0 { self.anchor } else { self.pose_at(setpoint) }
    }

    /// Where a setpoint leads.
    #[must_use]
    pub fn pose_at(&self, setpoint: Setpoint) -> Pose {
        pose_at(&self.anchor, setpoint, self.lsb)
    }

    /// Largest use of each limit so far, to within one per cent of itself.
    #[must_use]
    pub fn peak_use(&self) -> PeakUse {
        self.sieve.peak_use()
    }
}

/// Why a plan cannot be played over a wire.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Unplayable {
    /// Rounded to the counts of the wire, it breaks a limit.
    Limit(Violation),
    /// A setpoint does not fit the counters of the wire.
    Setpoint(SetpointError),
    /// It moves further than the wire can tell.
    TooFar {
        /// Along which component.
        axis: Axis,
        /// Tick at which it has moved so far.
        tick: u32,
        /// Counts within [`LOSSES_BRIDGED`] ticks and one.
        counts: u32,
        /// Most counts that the wire can tell.
        span: u32,
    },
}

impl fmt::Display for Unplayable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Limit(violation) => write!(f, "rounded to the counts of this wire, {violation}"),
            Self::Setpoint(error) => error.fmt(f),
            Self::TooFar { axis, tick, counts, span } => write!(
                f,
                "at tick {tick} it moves by {counts} counts of this wire along {axis} within {} ticks, but the wire tells \
                 {span} at most; use CAN FD or a serial line",
                LOSSES_BRIDGED.saturating_add(1)
            ),
        }
    }
}

impl core::error::Error for Unplayable {}

/// Setpoints in a row that may be lost without the next one being misunderstood.
pub const LOSSES_BRIDGED: u32 = 2;

/// Looks through a whole plan as it would be sent: rounded to `lsb`, one setpoint every `period_us`, on a wire that can
/// tell apart positions within `span` counts of each other (`None`: any).
///
/// # Errors
/// The first reason why it cannot be played so.
pub fn rehearse(
    plan: &PlanReader<'_>,
    lsb: Lsb,
    period_us: u32,
    span: Option<u32>,
) -> Result<PeakUse, Unplayable> {
    let header = plan.header();
    let mut guard = Guard::new(header.start_pose(), header.limits, lsb, period_us, header.step_count);
    let mut last = [Setpoint::ANCHOR; LOSSES_BRIDGED as usize + 1];
    for planned in plan.setpoints() {
        let setpoint = planned.rescaled(header.lsb, lsb).map_err(Unplayable::Setpoint)?;
        guard.check(setpoint).map_err(Unplayable::Limit)?;
        span.map_or(Ok(()), |span| check_span(last, setpoint, span))?;
        let [_, b, c] = last;
        last = [b, c, setpoint];
    }
    Ok(guard.peak_use())
}

fn check_span(
    last: [Setpoint; LOSSES_BRIDGED as usize + 1],
    setpoint: Setpoint,
    span: u32,
) -> Result<(), Unplayable> {
    for before in last {
        for ((new, old), axis) in setpoint.counts.into_iter().zip(before.counts).zip(Axis::ALL) {
            let counts = new.abs_diff(old);
            if counts > span {
                return Err(Unplayable::TooFar { axis, tick: setpoint.tick, counts, span });
            }
        }
    }
    Ok(())
}

/// The fault that a broken limit is.
#[must_use]
pub fn fault_of(violation: &Violation) -> Fault {
    Fault { code: FaultCode::from_limit(violation.limit, Side::Executor), tick: violation.tick }
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_shared::limits::Limit;

    const PERIOD_US: u32 = 10_000;

    fn loose() -> Limits {
        Limits {
            workspace_min_m: [-1.0; 3],
            workspace_max_m: [1.0; 3],
            linear_velocity_m_s: 1e3,
            linear_acceleration_m_s2: 1e3,
            linear_jerk_m_s3: 1e3,
            angular_velocity_rad_s: 1e3,
            angular_acceleration_rad_s2: 1e3,
            angular_jerk_rad_s3: 1e3,
        }
    }

    /// 20 micrometres and microradians, then none: 2 mm/s, 0.2 m/s^2, 20 m/s^3.
    fn first_violation(limits: Limits) -> Option<Violation> {
        let mut guard = Guard::new(Pose::identity(), limits, Lsb::default(), PERIOD_US, 1);
        guard.check(Setpoint { tick: 1, counts: [200, 0, 0, 0, 200, 0] }).err()
    }

    #[test]
    fn each_limit_is_refused_by_the_guard_alone() {
        assert_eq!(first_violation(loose()), None);
        let cases = [
            (Limits { workspace_max_m: [1e-5, 1.0, 1.0], ..loose() }, Limit::Workspace(Axis::X), 201),
            (Limits { linear_velocity_m_s: 1e-3, ..loose() }, Limit::LinearVelocity, 202),
            (Limits { linear_acceleration_m_s2: 0.1, ..loose() }, Limit::LinearAcceleration, 203),
            (Limits { linear_jerk_m_s3: 15.0, ..loose() }, Limit::LinearJerk, 204),
            (Limits { angular_velocity_rad_s: 1e-3, ..loose() }, Limit::AngularVelocity, 205),
            (Limits { angular_acceleration_rad_s2: 0.1, ..loose() }, Limit::AngularAcceleration, 206),
            (Limits { angular_jerk_rad_s3: 15.0, ..loose() }, Limit::AngularJerk, 207),
        ];
        for (limits, limit, code) in cases {
            let violation = first_violation(limits).unwrap();
            assert_eq!((violation.limit, fault_of(&violation).code.number()), (limit, code));
        }
    }

    #[test]
    fn the_last_setpoint_must_be_one_to_rest_on() {
        // Coming to rest is the larger jerk: +20 at the start, then -40.
        let found = first_violation(Limits { linear_jerk_m_s3: 30.0, ..loose() }).unwrap();
        assert_eq!((found.limit, found.tick), (Limit::LinearJerk, 2));
    }
}
