//! How late the process wakes up: a histogram of fixed size, so that a cycle can record without allocating.

use std::fmt;

use hdrhistogram::Histogram;
use serde::Serialize;

/// Lateness beyond this counts as this, microseconds.
const MOST_US: u64 = 60_000_000;
/// Decimal digits that the percentiles keep.
const DIGITS: u8 = 3;

/// Lateness of wake-ups.
#[derive(Clone, Debug)]
pub struct Jitter {
    histogram: Histogram<u64>,
    late_beyond_us: u64,
    late_cycles: u64,
}

impl Jitter {
    /// An empty one. A cycle counts as late if it begins more than `late_beyond_us` after its moment.
    #[must_use]
    pub fn new(late_beyond_us: u64) -> Self {
        #[expect(clippy::expect_used, reason = "both arguments are constants, which a test runs through")]
        let histogram =
            Histogram::new_with_max(MOST_US, DIGITS).expect("1 us to a minute with 3 digits is a histogram");
        Self { histogram, late_beyond_us, late_cycles: 0 }
    }

    /// Records a cycle that began so late, microseconds.
    pub fn record(&mut self, late_us: u64) {
        self.histogram.saturating_record(late_us);
        self.late_cycles = self.late_cycles.saturating_add(u64::from(late_us > self.late_beyond_us));
    }

    /// The figures so far; `None` without a cycle.
    #[must_use]
    pub fn summary(&self) -> Option<JitterSummary> {
        (!self.histogram.is_empty()).then(|| JitterSummary {
            cycles: self.histogram.len(),
            p50_us: self.histogram.value_at_quantile(0.5),
            p99_us: self.histogram.value_at_quantile(0.99),
            p999_us: self.histogram.value_at_quantile(0.999),
            max_us: self.histogram.max(),
            late_cycles: self.late_cycles,
            late_beyond_us: self.late_beyond_us,
        })
    }
}

/// Figures of a run: how late cycles began, microseconds after their moments, to three digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct JitterSummary {
    /// Cycles recorded.
    pub cycles: u64,
    /// Half of the cycles were no later.
    pub p50_us: u64,
    /// 99 % were no later.
    pub p99_us: u64,
    /// 99.9 % were no later.
    pub p999_us: u64,
    /// The latest.
    pub max_us: u64,
    /// Cycles later than `late_beyond_us`.
    pub late_cycles: u64,
    /// What counts as late.
    pub late_beyond_us: u64,
}

impl fmt::Display for JitterSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} cycles began late by {} us (median), {} us (99 %), {} us (99.9 %), {} us (worst); {} by more than {} us",
            self.cycles,
            self.p50_us,
            self.p99_us,
            self.p999_us,
            self.max_us,
            self.late_cycles,
            self.late_beyond_us
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_the_recorded_cycles() {
        let mut jitter = Jitter::new(990);
        assert_eq!(jitter.summary(), None);
        (1..=1000).for_each(|late_us| jitter.record(late_us));
        let summary = jitter.summary().unwrap();
        assert_eq!((summary.cycles, summary.p50_us, summary.p99_us, summary.p999_us), (1000, 500, 990, 999));
        assert_eq!((summary.max_us, summary.late_cycles), (1000, 10));
        assert_eq!(
            summary.to_string(),
            "1000 cycles began late by 500 us (median), 990 us (99 %), 999 us (99.9 %), 1000 us (worst); \
             10 by more than 990 us"
        );
        assert_eq!(serde_json::to_value(summary).unwrap()["p999_us"], 999);
    }

    #[test]
    fn no_lateness_and_endless_lateness_are_recorded() {
        let mut jitter = Jitter::new(0);
        jitter.record(0);
        assert_eq!(jitter.summary().unwrap().late_cycles, 0);
        jitter.record(u64::MAX);
        let summary = jitter.summary().unwrap();
        assert_eq!((summary.p50_us, summary.late_cycles), (0, 1));
        assert!(summary.max_us >= MOST_US);
    }
}
