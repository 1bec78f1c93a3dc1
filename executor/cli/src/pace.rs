//! How time passes during a run.

use std::thread;
use std::time::{Duration, Instant};

/// Lets time pass.
pub trait Pace {
    /// Returns at `moment_us` after the begin of the run, or later.
    fn wait_until(&mut self, moment_us: u64);

    /// How much later than wanted at the worst, microseconds.
    fn worst_lateness_us(&self) -> Option<u64>;
}

/// Time passes at once.
#[derive(Clone, Copy, Debug, Default)]
pub struct VirtualTime;

impl Pace for VirtualTime {
    fn wait_until(&mut self, _moment_us: u64) {}

    fn worst_lateness_us(&self) -> Option<u64> {
        None
    }
}

/// Time passes by the wall clock. Each wait is for a moment, not for a duration, so that lateness never adds up.
#[derive(Clone, Copy, Debug)]
pub struct WallClock {
    start: Instant,
    worst_lateness_us: u64,
}

impl WallClock {
    /// Begins now.
    #[must_use]
    pub fn start() -> Self {
        Self { start: Instant::now(), worst_lateness_us: 0 }
    }
}

impl Pace for WallClock {
    fn wait_until(&mut self, moment_us: u64) {
        let wanted = Duration::from_micros(moment_us);
        // A sleep may return early where signals interrupt it.
        while let Some(left) = wanted.checked_sub(self.start.elapsed()).filter(|left| !left.is_zero()) {
            thread::sleep(left);
        }
        let late = self.start.elapsed().saturating_sub(wanted).as_micros();
        self.worst_lateness_us = self.worst_lateness_us.max(u64::try_from(late).unwrap_or(u64::MAX));
    }

    fn worst_lateness_us(&self) -> Option<u64> {
        Some(self.worst_lateness_us)
    }
}
