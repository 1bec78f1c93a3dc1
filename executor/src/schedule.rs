//! How far ahead of the arm setpoints may be sent, and when the next one may.
//!
//! | symbol  | identifier      | meaning                                                                      |
//! |---------|-----------------|------------------------------------------------------------------------------|
//! | k       | `applied_tick`  | last setpoint that the arm has reported as taken                             |
//! | t0      | `start_us`      | when the arm took tick 0, by our clock; estimated from its reports           |
//! | e(t)    | `estimate`      | tick that the arm is thought to be at: floor((t - t0) / h), not below k      |
//! | L       | `ahead`         | look-ahead, and what the arm goes on during a round trip; at most what it has room for |
//! | C       | `credit_until`  | last tick for which the arm has room, as it says                             |
//!
//! Setpoint n may be sent when n <= min(e(t) + L, C). The estimate follows the arm's clock even while reports are lost; the
//! credit, which only reports can raise, bounds what a wrong estimate can do.

use core::num::{NonZeroU32, NonZeroU64};

use powderline_shared::wire::message::DEPTH;

/// Setpoints ahead of the arm's clock, unless the configuration says otherwise: as many as the arm has room for. A full
/// buffer leaves the most time for sending again what was lost, and none of the stops waits for what is in it.
pub const DEFAULT_LOOK_AHEAD: u16 = 16;
const _: () = assert!(DEFAULT_LOOK_AHEAD as u32 == DEPTH);

/// Share of a late report's lateness by which the estimate is put back: a report that was delayed says little, a clock
/// that drifts says the same thing in every report.
const LATENESS_SHARE: u64 = 16;

/// See the head of this file. Times in microseconds.
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    /// Not zero by its type, so that nothing has to be proved where it divides.
    period_us: NonZeroU64,
    look_ahead: u16,
    round_trip_us: u64,
    applied_tick: u32,
    credit_until: u32,
    start_us: Option<u64>,
}

impl Schedule {
    /// No credit yet. A look-ahead of zero could never start; it counts as one, as does a period of zero.
    #[must_use]
    pub fn new(look_ahead: u16, period_us: u32) -> Self {
        Self {
            period_us: NonZeroU32::new(period_us).unwrap_or(NonZeroU32::MIN).into(),
            look_ahead: look_ahead.max(1),
            round_trip_us: 0,
            applied_tick: 0,
            credit_until: 0,
            start_us: None,
        }
    }

    /// Takes in how long an answer took. The longest counts.
    pub fn handle_round_trip(&mut self, round_trip_us: u64) {
        self.round_trip_us = self.round_trip_us.max(round_trip_us);
    }

    /// Takes in the arm's report. Reports may arrive out of order; progress never goes back. `running` says whether the
    /// arm's clock runs.
    pub fn handle_progress(&mut self, now_us: u64, applied_tick: u32, credit_until: u32, running: bool) {
        self.applied_tick = self.applied_tick.max(applied_tick);
        self.credit_until = self.credit_until.max(credit_until);
        if !running || applied_tick < self.applied_tick {
            return;
        }
        let start_us = now_us.saturating_sub(u64::from(applied_tick).saturating_mul(self.period_us.get()));
        let corrected = self.start_us.map_or(start_us, |known_us| match start_us.checked_sub(known_us) {
            Some(late_us) => known_us.saturating_add(late_us / LATENESS_SHARE),
            None => start_us,
        });
        self.start_us = Some(corrected);
    }

    /// When the setpoint of `tick` may be sent, which may be in the past; `None` as long as the arm must report first.
    #[must_use]
    pub fn due_us(&self, tick: u32) -> Option<u64> {
        if tick > self.credit_until {
            return None;
        }
        let wait = u64::from(tick).saturating_sub(self.ahead());
        if wait <= u64::from(self.applied_tick) {
            return Some(0);
        }
        Some(self.start_us?.saturating_add(wait.saturating_mul(self.period_us.get())))
    }

    /// Whether the setpoint of `tick` may be sent now.
    #[must_use]
    pub fn allows(&self, now_us: u64, tick: u32) -> bool {
        self.due_us(tick).is_some_and(|due_us| due_us <= now_us)
    }

    /// Setpoints ahead, without what is added for the round trip.
    #[must_use]
    pub fn look_ahead(&self) -> u16 {
        self.look_ahead
    }

    /// How long after the moment at which the setpoint of `tick` could leave at the soonest it leaves now, microseconds;
    /// `None` before the arm's clock is known. The estimate of that clock follows the reports that came quickest, so this is
    /// what held up the arm's report, its way here, and this side.
    #[must_use]
    pub fn late_us(&self, now_us: u64, tick: u32) -> Option<u64> {
        let wait = u64::from(tick).checked_sub(self.ahead())?;
        let due_us = self.start_us?.saturating_add(wait.saturating_mul(self.period_us.get()));
        Some(now_us.saturating_sub(due_us))
    }

    fn ahead(&self) -> u64 {
        let underway = self.round_trip_us.div_ceil(self.period_us.get());
        u64::from(self.look_ahead).saturating_add(underway).min(DEPTH.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const H: u64 = 10_000;

    fn schedule() -> Schedule {
        Schedule::new(4, 10_000)
    }

    #[test]
    fn the_smaller_of_look_ahead_and_credit_counts() {
        let mut schedule = schedule();
        assert!(!schedule.allows(0, 1));
        schedule.handle_progress(0, 0, 6, false);
        assert!(schedule.allows(0, 4) && !schedule.allows(9 * H, 5));
        schedule.handle_progress(10 * H, 10, 12, true);
        assert!(schedule.allows(10 * H, 12) && !schedule.allows(99 * H, 13));
    }

    #[test]
    fn our_clock_goes_on_while_reports_are_lost() {
        let mut schedule = schedule();
        schedule.handle_progress(50 * H, 10, 26, true);
        assert!(schedule.allows(50 * H, 14) && !schedule.allows(50 * H, 15));
        assert!(!schedule.allows(51 * H - 1, 15) && schedule.allows(51 * H, 15));
        assert_eq!(schedule.due_us(20), Some(56 * H));
        assert!(schedule.allows(62 * H, 26));
        assert_eq!(schedule.due_us(27), None);
    }

    #[test]
    fn a_report_that_was_delayed_hardly_counts_but_a_clock_that_drifts_does() {
        let mut schedule = schedule();
        schedule.handle_progress(0, 0, 16, true);
        schedule.handle_progress(3 * H + H / 2, 3, 19, true);
        assert!(schedule.due_us(12).unwrap() < 8 * H + H / 10);
        for tick in 4..300 {
            schedule.handle_progress(u64::from(tick) * (H + 100), tick, tick + 16, true);
        }
        let late_us = schedule.due_us(310).unwrap() - 306 * H;
        assert!((25_000..31_000).contains(&late_us), "{late_us}");
    }

    #[test]
    fn a_long_round_trip_is_made_up_for() {
        let mut schedule = schedule();
        schedule.handle_round_trip(35_000);
        schedule.handle_round_trip(1_000);
        schedule.handle_progress(0, 0, 16, false);
        assert!(schedule.allows(0, 8) && !schedule.allows(0, 9));
    }

    #[test]
    fn lateness_is_told_from_the_quickest_reports() {
        let mut schedule = schedule();
        assert_eq!(schedule.late_us(0, 5), None);
        schedule.handle_progress(100, 0, 16, true);
        assert_eq!(schedule.late_us(100, 4), Some(0));
        assert_eq!(schedule.late_us(H + 150, 5), Some(50));
        schedule.handle_progress(H + 40, 1, 17, true);
        assert_eq!(schedule.late_us(H + 150, 5), Some(110));
    }

    #[test]
    fn an_old_report_takes_nothing_back() {
        let mut schedule = schedule();
        schedule.handle_progress(20 * H, 20, 36, true);
        schedule.handle_progress(20 * H, 3, 19, true);
        assert!(schedule.allows(20 * H, 24) && !schedule.allows(20 * H, 25));
    }
}
