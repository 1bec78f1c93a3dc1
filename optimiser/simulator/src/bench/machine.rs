//! What the machine can do: multiply-adds a second, bytes a second, and what the system says of memory.

use std::hint::black_box;
use std::sync::OnceLock;
use std::time::Instant;

use powderline_shared::plan::Precision;
use pulp::{Simd, WithSimd};

use crate::memory::kibibytes;
use crate::mpm::timings::Reading;

/// Sums that are independent of each other: enough to hide the latency of two units, and few enough for 16 registers.
const SUMS: usize = 12;

/// Multiply-adds to each sum in one reading; a few tenths of a millisecond.
const ROUNDS: u32 = 100_000;

/// Width of the vectors that the simulator's kernels are dispatched to, bits.
pub(crate) fn vector_bits() -> u32 {
    pulp::Arch::new().dispatch(Bits)
}

struct Bits;

impl WithSimd for Bits {
    type Output = u32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> u32 {
        8 * size_of::<S::f32s>() as u32
    }
}

/// Operations a nanosecond (GFLOP/s) that one thread does in fused multiply-adds, two operations each: the best of a
/// few readings, each short enough to lie between two interruptions.
pub(crate) fn fma_rate(precision: Precision) -> f64 {
    let once = || match precision {
        Precision::F32 => rate(MultiplyAdds32),
        Precision::F64 => rate(MultiplyAdds64),
    };
    (0..8).map(|_| once()).fold(0.0, f64::max)
}

/// A loop says how many operations it did in all.
fn rate(job: impl WithSimd<Output = u64>) -> f64 {
    let started = Instant::now();
    let operations = pulp::Arch::new().dispatch(job);
    operations as f64 / started.elapsed().as_nanos().max(1) as f64
}

macro_rules! multiply_adds {
    ($name:ident, $vector:ident, $scalar:ty, $splat:ident, $multiply_add:ident) => {
        struct $name;

        impl WithSimd for $name {
            type Output = u64;

            #[inline(always)]
            fn with_simd<S: Simd>(self, simd: S) -> u64 {
                let factor = simd.$splat(black_box(0.999));
                let term = simd.$splat(black_box(1e-3));
                let mut sums = [term; SUMS];
                for _ in 0..ROUNDS {
                    for sum in &mut sums {
                        *sum = simd.$multiply_add(*sum, factor, term);
                    }
                }
                black_box(sums);
                let lanes = size_of::<S::$vector>() / size_of::<$scalar>();
                2 * u64::from(ROUNDS) * (SUMS * lanes) as u64
            }
        }
    };
}

multiply_adds!(MultiplyAdds32, f32s, f32, splat_f32s, mul_add_e_f32s);
multiply_adds!(MultiplyAdds64, f64s, f64, splat_f64s, mul_add_e_f64s);

/// Bytes a nanosecond (GB/s) of processor time that one thread reads from an array of [`READ_BYTES`], at best.
pub(crate) fn read_rate() -> f64 {
    let numbers = vec![1u64; READ_BYTES / size_of::<u64>()];
    let once = || {
        let [_, before] = nanoseconds();
        let sum = black_box(&numbers).iter().fold(0u64, |sum, x| sum.wrapping_add(*x));
        black_box(sum);
        READ_BYTES as f64 / (nanoseconds()[1] - before).max(1) as f64
    };
    (0..4).map(|_| once()).fold(0.0, f64::max)
}

/// Larger than what a core has for itself; a large shared cache may hold it.
pub(crate) const READ_BYTES: usize = 256 << 20;

/// The most memory that the process has held so far, bytes; none where the system does not tell.
pub(crate) fn peak_bytes() -> Option<u64> {
    kibibytes("/proc/self/status", "VmHWM:")
}

/// Nanoseconds since the first reading, and those that the threads of this process have had a processor, all together: what
/// other processes take of the machine shows in the first only.
pub(crate) fn nanoseconds() -> Reading {
    static START: OnceLock<Instant> = OnceLock::new();
    let wall_ns = START.get_or_init(Instant::now).elapsed().as_nanos() as u64;
    [wall_ns, processor_ns().unwrap_or(wall_ns)]
}

/// Processor time of this process's threads so far, all together, seconds; wall-clock time where the system does not tell.
pub fn cpu_seconds() -> f64 {
    nanoseconds()[1] as f64 * 1e-9
}

#[cfg(unix)]
fn processor_ns() -> Option<u64> {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Some(u64::try_from(time.tv_sec).ok()? * 1_000_000_000 + u64::try_from(time.tv_nsec).ok()?)
}

#[cfg(not(unix))]
fn processor_ns() -> Option<u64> {
    None
}

/// How long the threads of this process have waited for a processor so far, ns, all together; none where the system does not
/// tell.
pub(crate) fn waited_ns() -> Option<u64> {
    let tasks = std::fs::read_dir("/proc/self/task").ok()?;
    let waited = |task: std::io::Result<std::fs::DirEntry>| -> Option<u64> {
        let text = std::fs::read_to_string(task.ok()?.path().join("schedstat")).ok()?;
        text.split_whitespace().nth(1)?.parse().ok()
    };
    tasks.map(waited).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loop_counts_two_operations_for_each_lane() {
        let lanes = u64::from(vector_bits() / 32);
        let expected = 2 * u64::from(ROUNDS) * SUMS as u64 * lanes;
        assert_eq!(pulp::Arch::new().dispatch(MultiplyAdds32), expected);
        assert_eq!(
            pulp::Arch::new().dispatch(MultiplyAdds64),
            (expected / 2).max(2 * u64::from(ROUNDS) * 12)
        );
    }

    #[test]
    fn both_clocks_go_on() {
        let before = nanoseconds();
        black_box(fma_rate(Precision::F64));
        let after = nanoseconds();
        assert!(before[0] < after[0] && before[1] < after[1], "{before:?} {after:?}");
    }

    #[test]
    fn the_system_tells_sizes() {
        assert!(peak_bytes().is_some_and(|bytes| (1 << 20..1 << 40).contains(&bytes)));
        assert_eq!(kibibytes("/proc/self/status", "NoSuchLine:"), None);
    }
}
