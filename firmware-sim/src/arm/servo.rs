//! A joint that follows its command late: first-order lag, solved exactly.
//!
//! | symbol | identifier        | meaning                                              |
//! |--------|-------------------|------------------------------------------------------|
//! | tau    | `time_constant_s` | tau dx/dt = u - x                                    |
//! | u      | `from`, `to`      | command, on a straight line over dt                  |
//! | x      | `real`            | the joint                                            |
//! | z      |                   | dt / tau                                             |
//!
//! Over one interval dt the solution is
//!
//! ```text
//! x(dt) = u1 + (x0 - u0) exp(-z) - (u1 - u0) (1 - exp(-z)) / z
//! ```
//!
//! which is stable for any dt, splits into shorter intervals without a change, and is u1 itself where there is no lag.

use powderline_shared::arm::Joints;

/// First-order lag of the joints' drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lag {
    /// Time after which a step has been followed but for 1 / e, seconds. Zero is no lag; below zero is taken as zero.
    pub time_constant_s: f64,
}

impl Default for Lag {
    /// 10 ms.
    fn default() -> Self {
        Self { time_constant_s: 0.010 }
    }
}

impl Lag {
    /// Joints that are where they are told to be.
    pub const NONE: Self = Self { time_constant_s: 0.0 };

    /// Where joints that stand at `real` are after `dt_s`, while the command goes from `from` to `to`.
    ///
    /// A step is a command that goes from `to` to `to`. A time below zero is taken as zero.
    #[must_use]
    pub fn after(self, dt_s: f64, real: &Joints, from: &Joints, to: &Joints) -> Joints {
        let lags = self.time_constant_s > 0.0;
        let z = dt_s.max(0.0) / self.time_constant_s;
        if !lags || z == 0.0 {
            return if lags { *real } else { *to };
        }
        let (kept, missed) = (libm::exp(-z), -libm::expm1(-z) / z);
        let mut next = *to;
        for (((x, u1), u0), x0) in next.iter_mut().zip(to).zip(from).zip(real) {
            *x = u1 + (x0 - u0) * kept - (u1 - u0) * missed;
        }
        next
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "what does not move does not move by a bit")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const TAU_S: f64 = 0.01;

    fn lag() -> Lag {
        Lag { time_constant_s: TAU_S }
    }

    #[test]
    fn a_step_is_followed_exponentially() {
        let (start, target) = ([1.0, -2.0, 0.5, 0.0, 3.0, -0.1], [2.0, -2.5, 0.5, 1.0, 2.0, 6.0]);
        let mut real = start;
        for tick in 1..=200_i32 {
            real = lag().after(0.002, &real, &target, &target);
            let left = (-0.2 * f64::from(tick)).exp();
            for ((x, x0), u) in real.iter().zip(start).zip(target) {
                assert!((x - (u + (x0 - u) * left)).abs() < 2e-15, "tick {tick}: {x}");
            }
        }
        // Settled: 40 time constants.
        assert!(real.iter().zip(target).all(|(x, u)| (x - u).abs() < 2e-15));
        assert_eq!(lag().after(0.002, &target, &target, &target), target);
    }

    #[test]
    fn a_ramp_is_followed_one_time_constant_late() {
        let rate = 1.5;
        let (mut real, mut command) = ([0.0; 6], [0.0; 6]);
        for tick in 1..=300_i32 {
            let next = [rate * 0.001 * f64::from(tick); 6];
            real = lag().after(0.001, &real, &command, &next);
            command = next;
            let t = 0.001 * f64::from(tick);
            let expected = rate * (t - TAU_S * (1.0 - (-t / TAU_S).exp()));
            assert!((real[0] - expected).abs() < 1e-15, "{t} s: {} for {expected}", real[0]);
        }
        assert!((command[0] - real[0] - rate * TAU_S).abs() < 1e-14);
    }

    #[test]
    fn without_lag_the_joint_is_where_it_is_told_to_be() {
        let (from, to) = ([0.1; 6], [0.3; 6]);
        for time_constant_s in [0.0, -1.0, f64::NAN] {
            for dt_s in [0.0, 1e-6, 1.0] {
                assert_eq!(Lag { time_constant_s }.after(dt_s, &from, &from, &to), to);
            }
        }
    }

    #[test]
    fn without_time_nothing_moves() {
        for dt_s in [0.0, -1.0, f64::NAN, 1e-300] {
            let found = lag().after(dt_s, &[0.25; 6], &[0.5; 6], &[1.0; 6]);
            assert_eq!(found, [0.25; 6]);
        }
    }

    #[test]
    fn any_time_is_stable() {
        for dt_s in [1.0, 1e6, 1e300, f64::INFINITY] {
            let found = lag().after(dt_s, &[-3.0; 6], &[0.5; 6], &[1.0; 6]);
            assert!(found.iter().all(|x| (x - 1.0).abs() <= 0.5 * TAU_S / dt_s + 1e-15), "{found:?}");
        }
    }

    proptest! {
        #[test]
        fn one_interval_is_the_same_as_two(
            (x, u0, u1) in (-6.0..6.0, -6.0..6.0, -6.0..6.0f64), share in 0.0..1.0, dt_s in 0.0..0.1,
        ) {
            let between = u0 + (u1 - u0) * share;
            let whole = lag().after(dt_s, &[x; 6], &[u0; 6], &[u1; 6]);
            let half = lag().after(dt_s * share, &[x; 6], &[u0; 6], &[between; 6]);
            let both = lag().after(dt_s * (1.0 - share), &half, &[between; 6], &[u1; 6]);
            prop_assert!((whole[0] - both[0]).abs() < 1e-14);
        }
    }
}
