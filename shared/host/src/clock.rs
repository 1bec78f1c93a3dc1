//! The clock that nobody sets: `CLOCK_MONOTONIC`, microseconds.

use std::time::{Duration, SystemTime};

use rustix::time::{ClockId, Timespec, clock_gettime};

/// A kernel time stamp that says it is older than this comes from a wall clock that was set in between.
const OLDEST_STAMP: Duration = Duration::from_secs(60);

/// Now, microseconds of `CLOCK_MONOTONIC`.
#[must_use]
pub fn now_us() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    let whole_us = u64::try_from(now.tv_sec).unwrap_or(0).saturating_mul(1_000_000);
    // Nanoseconds of one second: never negative.
    whole_us.saturating_add(u64::try_from(now.tv_nsec).unwrap_or(0) / 1000)
}

/// The moment of a wall-clock time stamp, microseconds of `CLOCK_MONOTONIC`, never after now.
///
/// The kernel stamps received frames by the wall clock only. What counts is their age, which is taken at once, before
/// anybody can set that clock; an age without sense counts as none.
#[must_use]
pub fn monotonic_us_of(stamp: SystemTime) -> u64 {
    let age = SystemTime::now().duration_since(stamp).unwrap_or_default();
    let age = if age > OLDEST_STAMP { Duration::ZERO } else { age };
    now_us().saturating_sub(micros(age))
}

/// A moment or a duration as the kernel takes it.
pub(crate) fn timespec(us: u64) -> Timespec {
    Timespec {
        tv_sec: i64::try_from(us / 1_000_000).unwrap_or(i64::MAX),
        tv_nsec: i64::from(u32::try_from(us % 1_000_000).unwrap_or(0)).saturating_mul(1000),
    }
}

fn micros(duration: Duration) -> u64 {
    u64::try_from(duration.as_micros()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_rises_at_the_rate_of_time() {
        let (begin_us, begin) = (now_us(), std::time::Instant::now());
        std::thread::sleep(Duration::from_millis(20));
        let (passed_us, passed) = (now_us() - begin_us, begin.elapsed());
        assert!(passed_us >= 20_000);
        assert!(passed.as_micros().abs_diff(u128::from(passed_us)) < 20_000, "{passed_us} {passed:?}");
    }

    #[test]
    fn a_stamp_becomes_a_moment_and_a_stamp_without_sense_becomes_now() {
        let before_us = now_us();
        let moment_us = monotonic_us_of(SystemTime::now() - Duration::from_millis(300));
        assert!((before_us - 301_000..=now_us() - 300_000).contains(&moment_us));
        for stamp in [SystemTime::now() + Duration::from_secs(9), SystemTime::UNIX_EPOCH] {
            let before_us = now_us();
            let moment_us = monotonic_us_of(stamp);
            assert!((before_us..=now_us()).contains(&moment_us));
        }
    }

    #[test]
    fn microseconds_become_seconds_and_nanoseconds() {
        let moment = timespec(12_345_678);
        assert_eq!((moment.tv_sec, moment.tv_nsec), (12, 345_678_000));
    }
}
