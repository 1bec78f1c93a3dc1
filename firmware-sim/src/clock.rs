//! Time that passes only when it is told to.

/// A clock that stands still between [`VirtualClock::advance_to`]s, microseconds.
#[derive(Clone, Copy, Debug, Default)]
pub struct VirtualClock {
    now_us: u64,
}

impl VirtualClock {
    /// The present.
    #[must_use]
    pub fn now_us(&self) -> u64 {
        self.now_us
    }

    /// Moves on; a moment in the past leaves the clock where it is.
    pub fn advance_to(&mut self, moment_us: u64) {
        self.now_us = self.now_us.max(moment_us);
    }
}
