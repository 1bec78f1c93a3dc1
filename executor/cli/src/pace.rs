//! How time passes during a run on the simulated arm.

use powderline_host::clock;
use powderline_host::jitter::{Jitter, JitterSummary};
use powderline_host::wait::wait_until;

/// Lets time pass.
pub trait Pace {
    /// Returns at `moment_us` after the begin of the run, or later.
    fn wait_until(&mut self, moment_us: u64);

    /// How late the process woke up, if it slept at all.
    fn jitter(&self) -> Option<JitterSummary>;
}

/// Time passes at once.
#[derive(Clone, Copy, Debug, Default)]
pub struct VirtualTime;

impl Pace for VirtualTime {
    fn wait_until(&mut self, _moment_us: u64) {}

    fn jitter(&self) -> Option<JitterSummary> {
        None
    }
}

/// Time passes by the wall clock. Each wait is for a moment, not for a duration, so that lateness never adds up.
#[derive(Clone, Debug)]
pub struct WallClock {
    start_us: u64,
    jitter: Jitter,
}

impl WallClock {
    /// Begins now. A cycle counts as late beyond `late_beyond_us`.
    #[must_use]
    pub fn start(late_beyond_us: u64) -> Self {
        Self { start_us: clock::now_us(), jitter: Jitter::new(late_beyond_us) }
    }
}

impl Pace for WallClock {
    fn wait_until(&mut self, moment_us: u64) {
        // Nothing but the moment is waited for, which cannot fail.
        if let Ok(woken) = wait_until::<0>(Some(self.start_us.saturating_add(moment_us)), []) {
            woken.late_us.into_iter().for_each(|late_us| self.jitter.record(late_us));
        }
    }

    fn jitter(&self) -> Option<JitterSummary> {
        self.jitter.summary()
    }
}
