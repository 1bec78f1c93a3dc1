//! The path between two ticks: the cubic spline through all of them, at rest at both ends.
//!
//! | symbol | identifier | meaning                                                       |
//! |--------|------------|---------------------------------------------------------------|
//! | q_k    | `values`   | what is passed at tick k, 0..=n                               |
//! | m_k    | `slopes`   | derivative there, per period; m_0 = m_n = 0                   |
//! | s      | `share`    | time since tick k, in periods, 0..1                           |
//!
//! ```text
//! m_{k-1} + 4 m_k + m_{k+1} = 3 (q_{k+1} - q_{k-1})
//! q(s) = q_k + s (m_k + s ((3 d - 2 m_k - m_{k+1}) + s (m_k + m_{k+1} - 2 d))),    d = q_{k+1} - q_k
//! ```
//!
//! Ticks are passed exactly, velocity and acceleration have no jumps, and the third derivative is constant between ticks: of
//! what was looked at it adds least to it. Tangents from the neighbouring ticks alone, with which the simulated arm makes
//! do, let accelerations jump at every tick, which at 500 Hz is three times the jerk that a plan of the scene `bench` has
//! at its own 100 Hz; the spline has 1.2 times that.

/// Slopes of the spline through `values`, per period.
#[must_use]
pub fn slopes<const N: usize>(values: &[[f64; N]]) -> Vec<[f64; N]> {
    let mut slopes = vec![[0.0; N]; values.len()];
    // Elimination: c_k = 1 / (4 - c_{k-1}).
    let mut upper = vec![0.0; values.len()];
    for (k, window) in (1..).zip(values.windows(3)) {
        upper[k] = 1.0 / (4.0 - upper[k - 1]);
        let before = slopes[k - 1];
        let right = |axis: usize| 3.0 * (window[2][axis] - window[0][axis]);
        slopes[k] = std::array::from_fn(|axis| (right(axis) - before[axis]) * upper[k]);
    }
    for k in (1..values.len().saturating_sub(1)).rev() {
        let after = slopes[k + 1];
        slopes[k].iter_mut().zip(after).for_each(|(slope, after)| *slope -= upper[k] * after);
    }
    slopes
}

/// The spline after tick k, for a share of the period from 0 to 1; `values` and `slopes` as of [`slopes`].
#[must_use]
pub fn between<const N: usize>(values: &[[f64; N]], slopes: &[[f64; N]], k: usize, share: f64) -> [f64; N] {
    let (Some([from, to]), Some([leaving, arriving])) = (values.get(k..k + 2), slopes.get(k..k + 2)) else {
        return values.last().copied().unwrap_or([0.0; N]);
    };
    std::array::from_fn(|axis| {
        let d = to[axis] - from[axis];
        let (m0, m1) = (leaving[axis], arriving[axis]);
        from[axis] + share * (m0 + share * ((3.0 * d - 2.0 * m0 - m1) + share * (m0 + m1 - 2.0 * d)))
    })
}

/// Slopes per period as slopes per second.
#[must_use]
pub fn per_second<const N: usize>(slopes: Vec<[f64; N]>, period_us: u32) -> Vec<[f64; N]> {
    let period_s = f64::from(period_us) / 1e6;
    slopes.into_iter().map(|slope| slope.map(|value| value / period_s)).collect()
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "ticks are passed to the last bit")]
mod tests {
    use super::*;

    /// Any values, always the same.
    fn values(count: u32) -> Vec<[f64; 2]> {
        (0..count).map(|k| [(f64::from(k) * 0.7).sin(), f64::from(k * k % 7)]).collect()
    }

    #[test]
    fn ticks_are_passed_and_both_ends_rest() {
        for count in [1, 2, 3, 4, 50] {
            let values = values(count);
            let slopes = slopes(&values);
            assert_eq!((slopes[0], slopes[slopes.len() - 1]), ([0.0; 2], [0.0; 2]));
            for (k, value) in values.iter().enumerate() {
                assert_eq!(between(&values, &slopes, k, 0.0), *value);
            }
            for k in 1..values.len() {
                let end = between(&values, &slopes, k - 1, 1.0);
                assert!(end.iter().zip(values[k]).all(|(a, b)| (a - b).abs() < 1e-14), "{end:?}");
            }
        }
    }

    #[test]
    fn velocity_and_acceleration_have_no_jumps() {
        let values = values(30);
        let slopes = slopes(&values);
        let step = 1e-4;
        let at = |k: usize, share: f64| between(&values, &slopes, k, share);
        for k in 1..29 {
            for axis in 0..2 {
                let before = [1.0, 1.0 - step, 1.0 - 2.0 * step].map(|share| at(k - 1, share)[axis]);
                let after = [0.0, step, 2.0 * step].map(|share| at(k, share)[axis]);
                let velocities = [(before[0] - before[1]) / step, (after[1] - after[0]) / step];
                assert!((velocities[0] - velocities[1]).abs() < 100.0 * step, "{k}: {velocities:?}");
                let second = |p: [f64; 3]| (p[0] - 2.0 * p[1] + p[2]) / (step * step);
                assert!((second(before) - second(after)).abs() < 200.0 * step, "{k}: acceleration");
            }
        }
    }

    #[test]
    fn a_cubic_that_rests_at_both_ends_is_followed() {
        let cubic = |t: f64| t * t * (3.0 - 2.0 * t);
        let values: Vec<_> = (0..=20).map(|k| [cubic(f64::from(k) / 20.0)]).collect();
        let slopes = slopes(&values);
        for k in 0..20 {
            for share in [0.25, 0.5, 0.9] {
                let expected = cubic((k as f64 + share) / 20.0);
                assert!((between(&values, &slopes, k, share)[0] - expected).abs() < 1e-15);
            }
        }
    }
}
