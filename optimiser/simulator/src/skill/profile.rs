//! How a segment is travelled in time: the normalised position `s(r)`, `r` being time over duration.
//!
//! | symbol        | identifier          | constant speed | minimum jerk                     |
//! |---------------|---------------------|----------------|----------------------------------|
//! | s(r)          | `position`          | r              | 10 r^3 - 15 r^4 + 6 r^5          |
//! | max abs s'    | `Peaks::velocity`   | 1              | 15/8 (at r = 1/2)                |
//! | max abs s''   | `Peaks::acceleration` | infinite     | 10/sqrt(3) (at r = 1/2 -+ sqrt(3)/6) |
//! | max abs s'''  | `Peaks::jerk`       | infinite       | 60 (at r = 0 and r = 1)          |

use super::real::SkillScalar;
use crate::scene::Profile;

/// Largest derivatives of the minimum-jerk `s(r)` over `[0, 1]`.
pub(crate) struct Peaks {
    pub(crate) velocity: f64,
    pub(super) acceleration: f64,
    pub(super) jerk: f64,
}

/// Peaks of the minimum-jerk profile; 10/sqrt(3) is rounded up in its last digit.
pub(crate) const MINIMUM_JERK: Peaks =
    Peaks { velocity: 1.875, acceleration: 5.773_502_691_896_26, jerk: 60.0 };

/// Normalised position at normalised time `r`; rests at 0 before the segment and at 1 after it.
pub(super) fn position<S: SkillScalar>(profile: Profile, r: S) -> S {
    if r.value() <= 0.0 {
        return S::constant(0.0);
    }
    if r.value() >= 1.0 {
        return S::constant(1.0);
    }
    match profile {
        Profile::ConstantSpeed => r,
        Profile::MinimumJerk => minimum_jerk(r),
    }
}

/// Normalised position of minimum jerk.
pub(crate) fn minimum_jerk_position(r: f64) -> f64 {
    position(Profile::MinimumJerk, r)
}

/// Evaluated from the nearer end, so that the approach to 1 is as smooth in floating point as the start at 0.
fn minimum_jerk<S: SkillScalar>(r: S) -> S {
    let one = S::constant(1.0);
    if r.value() > 0.5 {
        return one - minimum_jerk(one - r);
    }
    let bracket = (r * S::constant(6.0) - S::constant(15.0)) * r + S::constant(10.0);
    r * r * r * bracket
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn minimum_jerk_is_the_quintic() {
        for k in 0..=1000 {
            let r = f64::from(k) / 1000.0;
            let quintic = 10.0 * r.powi(3) - 15.0 * r.powi(4) + 6.0 * r.powi(5);
            assert!((position(Profile::MinimumJerk, r) - quintic).abs() < 1e-14);
        }
    }

    #[test]
    fn peaks_bound_the_derivatives_and_are_attained() {
        let velocity = |r: f64| 30.0 * r * r * (1.0 - r) * (1.0 - r);
        let acceleration = |r: f64| 60.0 * r * (1.0 - r) * (1.0 - 2.0 * r);
        let jerk = |r: f64| 60.0 * (1.0 - 6.0 * r + 6.0 * r * r);
        let largest =
            |f: &dyn Fn(f64) -> f64| (0..=100_000).map(|k| f(f64::from(k) / 1e5).abs()).fold(0.0, f64::max);
        for (found, bound) in [
            (largest(&velocity), MINIMUM_JERK.velocity),
            (largest(&acceleration), MINIMUM_JERK.acceleration),
            (largest(&jerk), MINIMUM_JERK.jerk),
        ] {
            assert!(found <= bound && found > bound * (1.0 - 1e-8), "{found} against {bound}");
        }
    }

    #[test]
    fn rests_outside_the_segment() {
        for profile in [Profile::ConstantSpeed, Profile::MinimumJerk] {
            assert_eq!(position(profile, -0.1).to_bits(), 0.0f64.to_bits());
            assert_eq!(position(profile, 1.1).to_bits(), 1.0f64.to_bits());
        }
    }
}
