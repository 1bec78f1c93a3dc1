//! What of the arm's reports is believed: what an arm says of itself is checked as what is said to it is.
//!
//! An arm takes setpoints one by one, at most one in a control period, and bridges at most [`BRIDGED_TICKS`] that are
//! missing. So a tick that it reports
//!
//! * is at most that of the setpoint sent last and [`BRIDGED_TICKS`], and never after the end of the plan;
//! * is never below one that it has reported before;
//! * is at most 1 + (t - t0) / h, with t0 the moment at which the setpoint left that started its clock, and h the control
//!   period: it may be late for many reasons, but early for none.
//!
//! Two clocks differ: an arm's may run faster than ours by one part in `DRIFT_SHARE`, and what both round to whole ticks is
//! forgiven.

use core::fmt;
use core::num::{NonZeroU32, NonZeroU64};

use powderline_shared::following::Astray;
use powderline_shared::wire::message::{BRIDGED_TICKS, Status};

/// By which part of the time the arm's clock may be ahead of ours: 0.2 %, many times what a poor crystal is off.
const DRIFT_SHARE: u64 = 512;

/// What the arm reports and cannot be believed, understood or borne.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Doubt {
    /// No setpoint has been sent for it, nor for one that it could be bridged from.
    Unsent {
        /// What the arm reports.
        tick: u32,
        /// The last setpoint sent.
        sent: u32,
    },
    /// It says that a setpoint is there which has not been sent.
    Invented {
        /// Of which tick.
        tick: u32,
        /// The last setpoint sent.
        sent: u32,
    },
    /// It has been at a later one before.
    Back {
        /// What the arm reports.
        tick: u32,
        /// What it had reported.
        known: u32,
    },
    /// It cannot be there yet.
    Early {
        /// What the arm reports.
        tick: u32,
        /// The latest that it can be at by now.
        latest: u32,
    },
    /// It goes on, but has not said for long where it is.
    Unlocated {
        /// The tick that it is at.
        tick: u32,
        /// The last at which it said where it was.
        known: u32,
    },
    /// A fault of a number that this version has none for.
    UnknownFault {
        /// What the arm reports.
        number: u16,
    },
    /// It is too far from where it is due.
    Astray(Astray),
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Unsent { tick, sent } => {
                write!(f, "it reported tick {tick}, but the last setpoint sent was that of tick {sent}")
            }
            Self::Invented { tick, sent } => write!(
                f,
                "it reported that the setpoint of tick {tick} is there, but the last one sent was that of tick {sent}"
            ),
            Self::Back { tick, known } => {
                write!(f, "it reported tick {tick} after it had reported tick {known}")
            }
            Self::Early { tick, latest } => {
                write!(f, "it reported tick {tick}, but cannot be beyond tick {latest} by now")
            }
            Self::Unlocated { tick, known } => {
                write!(f, "it reported tick {tick}, but not where it was at any after tick {known}")
            }
            Self::Astray(astray) => astray.fmt(f),
            Self::UnknownFault { number } => write!(f, "it reported fault {number}"),
        }
    }
}

/// What is known for sure, and what of the arm's reports agrees with it. Times in microseconds.
#[derive(Clone, Copy, Debug)]
pub struct Belief {
    /// Not zero by its type, so that nothing has to be proved where it divides.
    period_us: NonZeroU64,
    end_tick: u32,
    /// Setpoints that start the arm's clock.
    start_level: u32,
    /// The highest tick believed.
    tick: u32,
    /// The last setpoint sent.
    sent: u32,
    /// When the setpoint left that starts the arm's clock.
    start_us: Option<u64>,
}

impl Belief {
    /// An arm that has been sent nothing. A period of zero counts as one.
    #[must_use]
    pub fn new(period_us: u32, end_tick: u32, start_level: u16) -> Self {
        Self {
            period_us: NonZeroU32::new(period_us).unwrap_or(NonZeroU32::MIN).into(),
            end_tick,
            start_level: u32::from(start_level).min(end_tick),
            tick: 0,
            sent: 0,
            start_us: None,
        }
    }

    /// The highest tick believed.
    #[must_use]
    pub fn tick(&self) -> u32 {
        self.tick
    }

    /// A setpoint leaves.
    pub fn sent(&mut self, now_us: u64, tick: u32) {
        self.sent = self.sent.max(tick);
        if tick >= self.start_level {
            self.start_us.get_or_insert(now_us);
        }
    }

    /// Takes in a status of the arm's own session that is news.
    ///
    /// # Errors
    /// Why it is not believed; then nothing of it is kept.
    pub fn hear(&mut self, now_us: u64, status: &Status) -> Result<(), Doubt> {
        let tick = status.applied_tick;
        if tick < self.tick {
            return Err(Doubt::Back { tick, known: self.tick });
        }
        self.check(now_us, tick)?;
        if status.have != 0 {
            let ahead = u16::BITS.saturating_sub(status.have.leading_zeros());
            let tick = tick.saturating_add(ahead);
            if tick > self.sent {
                return Err(Doubt::Invented { tick, sent: self.sent });
            }
        }
        self.tick = tick;
        Ok(())
    }

    /// Whether the arm can be at a tick by now.
    ///
    /// # Errors
    /// Why not.
    pub fn check(&self, now_us: u64, tick: u32) -> Result<(), Doubt> {
        // Nothing is bridged before the first setpoint, nor beyond the last.
        let bridged = if self.sent == 0 { 0 } else { self.sent.saturating_add(BRIDGED_TICKS) };
        if tick > bridged.min(self.end_tick) {
            return Err(Doubt::Unsent { tick, sent: self.sent });
        }
        let latest = self.latest(now_us);
        if tick > latest {
            return Err(Doubt::Early { tick, latest });
        }
        Ok(())
    }

    /// The latest tick that the arm can be at.
    fn latest(&self, now_us: u64) -> u32 {
        let Some(start_us) = self.start_us else { return 0 };
        let gone_us = now_us.saturating_sub(start_us);
        let gone_us = gone_us.saturating_add(gone_us / DRIFT_SHARE);
        // The first is taken at once; one more for what both clocks round.
        u32::try_from(gone_us / self.period_us).unwrap_or(u32::MAX).saturating_add(2)
    }

    /// By when an arm that keeps to its clock has reported the next tick, and not a tick later than `allowance_us` ago; `None`
    /// before its clock can have started.
    #[must_use]
    pub fn overdue_us(&self, allowance_us: u64) -> Option<u64> {
        let due_us = u64::from(self.tick).saturating_add(1).saturating_mul(self.period_us.get());
        let slow_us = due_us.saturating_add(due_us / DRIFT_SHARE);
        Some(self.start_us?.saturating_add(slow_us).saturating_add(allowance_us))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_shared::wire::state::{Phase, State};

    const H: u64 = 10_000;

    fn status(applied_tick: u32, have: u16) -> Status {
        Status {
            session: 1,
            state: State::OperationEnabled,
            phase: Some(Phase::Streaming),
            standstill: false,
            applied_tick,
            have,
            counter: 0,
        }
    }

    /// All of the first 16 of 100 setpoints have left at 0.
    fn streaming() -> Belief {
        let mut belief = Belief::new(10_000, 100, 4);
        (1..=16).for_each(|tick| belief.sent(0, tick));
        belief
    }

    #[test]
    fn what_an_arm_can_do_is_believed() {
        let mut belief = streaming();
        for tick in 0..=16 {
            assert_eq!(belief.hear(u64::from(tick) * H, &status(tick, 0)), Ok(()), "{tick}");
        }
        // Nothing follows: it bridges two.
        assert_eq!(belief.hear(17 * H, &status(18, 0)), Ok(()));
        assert_eq!(belief.tick(), 18);
    }

    #[test]
    fn what_was_not_sent_cannot_have_been_taken() {
        let mut belief = streaming();
        assert_eq!(belief.hear(99 * H, &status(19, 0)), Err(Doubt::Unsent { tick: 19, sent: 16 }));
        assert_eq!(belief.hear(99 * H, &status(10, 0b100_0000)), Err(Doubt::Invented { tick: 17, sent: 16 }));
        assert_eq!(belief.hear(99 * H, &status(10, 0b11_1111)), Ok(()));
        let mut ending = Belief::new(10_000, 3, 4);
        (1..=3).for_each(|tick| ending.sent(0, tick));
        assert_eq!(ending.hear(9 * H, &status(4, 0)), Err(Doubt::Unsent { tick: 4, sent: 3 }));
        let mut fresh = Belief::new(10_000, 3, 4);
        assert_eq!(fresh.hear(9 * H, &status(1, 0)), Err(Doubt::Unsent { tick: 1, sent: 0 }));
    }

    #[test]
    fn no_tick_goes_back() {
        let mut belief = streaming();
        assert_eq!(belief.hear(12 * H, &status(12, 0)), Ok(()));
        assert_eq!(belief.hear(13 * H, &status(11, 0)), Err(Doubt::Back { tick: 11, known: 12 }));
        assert_eq!((belief.hear(13 * H, &status(12, 0)), belief.tick()), (Ok(()), 12));
    }

    #[test]
    fn no_tick_comes_before_its_time() {
        let mut belief = streaming();
        assert_eq!(belief.hear(2 * H, &status(5, 0)), Err(Doubt::Early { tick: 5, latest: 4 }));
        assert_eq!(belief.hear(2 * H, &status(4, 0)), Ok(()));
        // Its clock cannot run before it has the setpoints that start it.
        let mut waiting = Belief::new(10_000, 100, 4);
        (1..=3).for_each(|tick| waiting.sent(0, tick));
        assert_eq!(waiting.hear(9 * H, &status(1, 0)), Err(Doubt::Early { tick: 1, latest: 0 }));
        waiting.sent(9 * H, 4);
        assert_eq!(waiting.hear(9 * H, &status(1, 0)), Ok(()));
    }

    #[test]
    fn a_clock_that_is_a_little_fast_is_no_lie() {
        let mut belief = Belief::new(10_000, 100_000, 1);
        for tick in 1..=50_000_u32 {
            let now_us = u64::from(tick.saturating_sub(1)) * (H - 10);
            belief.sent(now_us, tick);
            assert_eq!(belief.hear(now_us, &status(tick, 0)), Ok(()), "{tick}");
        }
    }

    #[test]
    fn an_arm_that_falls_behind_its_clock_is_overdue() {
        let mut belief = streaming();
        assert_eq!(Belief::new(10_000, 100, 4).overdue_us(5), None);
        assert_eq!(belief.overdue_us(0), Some(H + H / 512));
        assert_eq!(belief.hear(12 * H, &status(12, 0)), Ok(()));
        assert_eq!(belief.overdue_us(7), Some(13 * H + 13 * H / 512 + 7));
    }
}
