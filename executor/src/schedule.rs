//! How far ahead of the arm setpoints may be sent.

/// Setpoints ahead of the arm's clock, unless the configuration says otherwise.
pub const DEFAULT_LOOK_AHEAD: u16 = 4;

/// Look-ahead of our own, credit of the arm's: the smaller one counts.
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    look_ahead: u16,
    applied_tick: u32,
    credit_until: u32,
}

impl Schedule {
    /// No credit yet. A look-ahead of zero could never start; it counts as one.
    #[must_use]
    pub fn new(look_ahead: u16) -> Self {
        Self { look_ahead: look_ahead.max(1), applied_tick: 0, credit_until: 0 }
    }

    /// Takes in the arm's report. Reports may arrive out of order; progress never goes back.
    pub fn handle_progress(&mut self, applied_tick: u32, credit_until: u32) {
        self.applied_tick = self.applied_tick.max(applied_tick);
        self.credit_until = self.credit_until.max(credit_until);
    }

    /// Whether the setpoint of `tick` may be sent now.
    #[must_use]
    pub fn allows(&self, tick: u32) -> bool {
        let ahead = self.applied_tick.saturating_add(u32::from(self.look_ahead));
        tick <= ahead.min(self.credit_until)
    }

    /// Setpoints ahead.
    #[must_use]
    pub fn look_ahead(&self) -> u16 {
        self.look_ahead
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smaller_of_look_ahead_and_credit_counts() {
        let mut schedule = Schedule::new(4);
        assert!(!schedule.allows(1));
        schedule.handle_progress(0, 16);
        assert!(schedule.allows(4) && !schedule.allows(5));
        schedule.handle_progress(10, 12);
        assert!(schedule.allows(14) && !schedule.allows(15));
        schedule.handle_progress(14, 16);
        assert!(schedule.allows(16) && !schedule.allows(17));
    }

    #[test]
    fn an_old_report_takes_nothing_back() {
        let mut schedule = Schedule::new(4);
        schedule.handle_progress(20, 36);
        schedule.handle_progress(3, 19);
        assert!(schedule.allows(24));
    }
}
