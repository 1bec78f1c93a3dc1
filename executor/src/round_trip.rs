//! How long it takes from saying something to hearing of it, and for how long hearing nothing means nothing yet.

/// Share of a new time in the mean, and in the mean deviation from it, as in RFC 6298.
const MEAN_SHARE: i64 = 8;
const DEVIATION_SHARE: i64 = 4;
/// Mean deviations after which an answer is overdue, as in RFC 6298.
const DEVIATIONS: u64 = 4;

/// Times from saying something to hearing of it, microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RoundTrip {
    /// Shortest and longest.
    extremes: Option<(u64, u64)>,
    mean_us: u64,
    deviation_us: u64,
}

impl RoundTrip {
    /// Takes in a time.
    pub fn record(&mut self, time_us: u64) {
        let Some((shortest, longest)) = self.extremes else {
            self.extremes = Some((time_us, time_us));
            self.mean_us = time_us;
            self.deviation_us = time_us / 2;
            return;
        };
        self.extremes = Some((shortest.min(time_us), longest.max(time_us)));
        self.deviation_us = nearer(self.deviation_us, self.mean_us.abs_diff(time_us), DEVIATION_SHARE);
        self.mean_us = nearer(self.mean_us, time_us, MEAN_SHARE);
    }

    /// The shortest; `None` before anything was heard.
    #[must_use]
    pub fn shortest_us(&self) -> Option<u64> {
        self.extremes.map(|(shortest, _)| shortest)
    }

    /// The longest; `None` before anything was heard.
    #[must_use]
    pub fn longest_us(&self) -> Option<u64> {
        self.extremes.map(|(_, longest)| longest)
    }

    /// When an answer is overdue; never before anything was heard.
    #[must_use]
    pub fn overdue_us(&self) -> u64 {
        self.extremes
            .map_or(u64::MAX, |_| self.mean_us.saturating_add(self.deviation_us.saturating_mul(DEVIATIONS)))
    }
}

/// A mean moved towards a new value by one part in `share`.
fn nearer(mean: u64, value: u64, share: i64) -> u64 {
    let off = i64::try_from(value).unwrap_or(i64::MAX).saturating_sub_unsigned(mean);
    mean.saturating_add_signed(off.checked_div(share).unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_overdue_before_anything_was_heard() {
        assert_eq!(RoundTrip::default().overdue_us(), u64::MAX);
        assert_eq!(RoundTrip::default().shortest_us(), None);
    }

    #[test]
    fn steady_answers_are_overdue_soon_and_scattered_ones_late() {
        let [mut steady, mut scattered] = [RoundTrip::default(); 2];
        for i in 0..100 {
            steady.record(10_000);
            scattered.record(if i % 2 == 0 { 5_000 } else { 15_000 });
        }
        assert!((10_000..10_100).contains(&steady.overdue_us()), "{steady:?}");
        assert!((25_000..35_000).contains(&scattered.overdue_us()), "{scattered:?}");
        assert_eq!((scattered.shortest_us(), scattered.longest_us()), (Some(5_000), Some(15_000)));
    }

    #[test]
    fn times_without_bounds_are_taken_in() {
        let mut endless = RoundTrip::default();
        (0..200).for_each(|_| endless.record(u64::MAX));
        endless.record(0);
        assert_eq!(endless.overdue_us(), u64::MAX);
    }
}
