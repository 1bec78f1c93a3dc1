//! Which setpoints keep their limits for certain, found in whole numbers and `f32`: on a microcontroller without `f64` in hardware
//! a tenth of what [`LimitChecker`](crate::limits::LimitChecker) takes, which decides whatever does not pass here.
//!
//! | symbol  | identifier | meaning                                                                         |
//! |---------|------------|---------------------------------------------------------------------------------|
//! | c_k     | `counts`   | setpoint k, in LSB                                                              |
//! | d_k     | `step`     | by how much it moves on from k - 1: counts along axes, radians about them       |
//! | e_k     | `error`    | how far d_k may be off                                                          |
//! | h       | period     | time of a tick                                                                  |
//! | J       |            | left Jacobian of SO(3)                                                          |
//!
//! Along axes d_k is the difference of the counts, exactly. About them it is
//!
//! ```text
//! log(exp(R_k) exp(R_{k-1})^-1) = J((R_k + R_{k-1}) / 2) (R_k - R_{k-1}) + O(|R_k - R_{k-1}|^3)
//! ```
//!
//! where the last term is odd and at most 0.0152 |R_k - R_{k-1}|^3 for rotations up to pi, by trial. With what `f32` rounds this is
//! e_k; a first, second or third difference is below its limit for certain if its norm and the errors in it are, and one part
//! in a thousand is left for all else. No limit becomes wider by that, and none tighter.

use crate::displacement::{Lsb, Setpoint};
use crate::limits::{Limits, PeakUse, TICKS_TO_REST};
use crate::pose::Pose;

/// Share of a step that `f32` may round.
const ROUNDING: f32 = 2e-6;

/// Of a rotation's step, cubed: what the middle of the step misses.
const MIDPOINT: f32 = 0.02;

/// Steps about axes up to here, radians; of larger ones, and of the two after one, nothing is certain.
const LARGEST_STEP: f32 = 0.3;

/// Share of a limit up to which this is certain.
const CERTAIN: f64 = 0.999;

/// Series of (1 - cos a) / a^2 and of (a - sin a) / a^3 in a^2: exact to `f32` up to pi.
const COSINE: [f32; 9] = series(2.0, 1.0 / 2.0);
const SINE: [f32; 9] = series(3.0, 1.0 / 6.0);

/// From 1/n! on: 1/n!, -1/(n + 2)!, 1/(n + 4)!, ..
const fn series(mut n: f64, mut term: f64) -> [f32; 9] {
    let mut terms = [0.0; 9];
    let mut rest: &mut [f32] = &mut terms;
    while let [head, tail @ ..] = rest {
        #[expect(clippy::cast_possible_truncation, reason = "rounding is in the errors")]
        let rounded = term as f32;
        *head = rounded;
        term /= -(n + 1.0) * (n + 2.0);
        n += 2.0;
        rest = tail;
    }
    terms
}

type Vector = [f32; 3];

fn less([a, b, c]: Vector, [x, y, z]: Vector) -> Vector {
    [a - x, b - y, c - z]
}

fn plus_scaled([a, b, c]: Vector, by: f32, [x, y, z]: Vector) -> Vector {
    [a + by * x, b + by * y, c + by * z]
}

fn cross([a, b, c]: Vector, [x, y, z]: Vector) -> Vector {
    [b * z - c * y, c * x - a * z, a * y - b * x]
}

fn squared([x, y, z]: Vector) -> f32 {
    x * x + y * y + z * z
}

/// At least the norm.
fn size(vector: Vector) -> f32 {
    vector.into_iter().map(libm::fabsf).sum()
}

fn polynomial(terms: &[f32; 9], x: f32) -> f32 {
    terms.iter().rev().fold(0.0, |sum, term| sum * x + term)
}

/// Steps along, or about, the axes, and their differences.
#[derive(Clone, Copy, Debug)]
struct Differences {
    /// First, second and third.
    values: [Vector; 3],
    /// Of this step, and of the two before.
    errors: [f32; 3],
}

impl Differences {
    const REST: Self = Self { values: [[0.0; 3]; 3], errors: [0.0; 3] };

    fn next(&self, step: Vector, error: f32) -> Self {
        let [first, second, _] = self.values;
        let [last, before, _] = self.errors;
        let change = less(step, first);
        Self { values: [step, change, less(change, second)], errors: [error, last, before] }
    }

    /// Of the first, second and third difference.
    fn error_sums(&self) -> [f32; 3] {
        let [e, last, before] = self.errors;
        [e, e + last, e + 2.0 * last + before]
    }
}

/// Three limits, as differences of steps.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    certain: [f32; 3],
    /// The limits without what rounding to counts may add, for shares.
    bare: [f64; 3],
}

impl Bounds {
    /// From limits and noises per second, per second squared and cubed; `unit` is what 1 of a step is worth.
    fn new(limits: [f64; 3], noises: [f64; 3], h: f64, unit: f64) -> Self {
        let [v, a, j] = limits;
        let bare = [v * h / unit, a * h * h / unit, j * h * h * h / unit];
        let mut certain = [0.0; 3];
        for (((certain, bare), limit), noise) in certain.iter_mut().zip(bare).zip(limits).zip(noises) {
            #[expect(clippy::cast_possible_truncation, reason = "far less than what is left")]
            let value = (CERTAIN * bare * (1.0 + noise / limit)) as f32;
            *certain = value;
        }
        Self { certain, bare }
    }

    fn hold(&self, differences: &Differences) -> bool {
        let known = differences.values.into_iter().zip(differences.error_sums());
        known.zip(self.certain).all(|((value, error), bound)| {
            let left = bound - error;
            left > 0.0 && squared(value) <= left * left
        })
    }

    /// What the largest differences are of the limits.
    fn shares(&self, peaks: [f32; 3]) -> [f64; 3] {
        let mut shares = [0.0; 3];
        for ((share, peak), bare) in shares.iter_mut().zip(peaks).zip(self.bare) {
            *share = libm::sqrt(f64::from(peak)) / bare;
        }
        shares
    }
}

/// Looks at the setpoints of a motion one after the other.
#[derive(Clone, Copy, Debug)]
pub struct Sieve {
    /// Lowest and highest counts along the axes.
    workspace: [[i32; 3]; 2],
    rotation_rad: f32,
    linear: Bounds,
    angular: Bounds,
    last: Setpoint,
    known: [Differences; 2],
    /// The largest differences so far, squared.
    peaks: [[f32; 3]; 2],
}

impl Sieve {
    /// At rest at `anchor`.
    #[must_use]
    pub fn new(anchor: &Pose, limits: &Limits, lsb: Lsb, period_us: u32) -> Self {
        let h = f64::from(period_us) / 1e6;
        let ([v, a, j], [w, alpha, zeta]) = limits.noises(lsb, period_us);
        let linear = [limits.linear_velocity_m_s, limits.linear_acceleration_m_s2, limits.linear_jerk_m_s3];
        let angular =
            [limits.angular_velocity_rad_s, limits.angular_acceleration_rad_s2, limits.angular_jerk_rad_s3];
        #[expect(clippy::cast_possible_truncation, reason = "rounding is in the errors")]
        let rotation_rad = lsb.rotation_rad() as f32;
        Self {
            workspace: workspace(anchor, limits, lsb),
            rotation_rad,
            linear: Bounds::new(linear, [v, a, j], h, lsb.translation_m()),
            angular: Bounds::new(angular, [w, alpha, zeta], h, 1.0),
            last: Setpoint::ANCHOR,
            known: [Differences::REST; 2],
            peaks: [[0.0; 3]; 2],
        }
    }

    /// The state after the next setpoint, and whether it keeps all limits for certain. Nothing is known of one that does not: it
    /// may keep them as well.
    #[must_use]
    pub fn after(&self, setpoint: Setpoint) -> (Self, bool) {
        let [linear, angular] = self.known;
        let (along, along_error) = self.along(setpoint);
        let (about, about_error) = self.about(setpoint);
        let known = [linear.next(along, along_error), angular.next(about, about_error)];
        let passes = self.is_inside(setpoint)
            && known.iter().zip([&self.linear, &self.angular]).all(|(known, bounds)| bounds.hold(known));
        let mut next = Self { last: setpoint, known, ..*self };
        next.raise_peaks();
        (next, passes)
    }

    /// Whether the motion may end at the last setpoint for certain: staying there breaks no limit either.
    #[must_use]
    pub fn may_end(&self) -> bool {
        let mut staying = *self;
        (0..TICKS_TO_REST).all(|_| {
            let (next, passes) = staying.after(staying.last);
            staying = next;
            passes
        })
    }

    fn raise_peaks(&mut self) {
        let values = self.known.iter().flat_map(|known| known.values);
        for (peak, value) in self.peaks.iter_mut().flatten().zip(values) {
            *peak = libm::fmaxf(*peak, squared(value));
        }
    }

    /// Largest use of each limit so far, to within one per cent of itself.
    #[must_use]
    pub fn peak_use(&self) -> PeakUse {
        let [linear, angular] = self.peaks;
        let [linear_velocity, linear_acceleration, linear_jerk] = self.linear.shares(linear);
        let [angular_velocity, angular_acceleration, angular_jerk] = self.angular.shares(angular);
        PeakUse {
            linear_velocity,
            linear_acceleration,
            linear_jerk,
            angular_velocity,
            angular_acceleration,
            angular_jerk,
        }
    }

    fn is_inside(&self, setpoint: Setpoint) -> bool {
        let [low, high] = self.workspace;
        setpoint
            .counts
            .into_iter()
            .zip(low)
            .zip(high)
            .all(|((count, low), high)| (low..=high).contains(&count))
    }

    /// By how much the setpoint moves on along the axes, counts.
    fn along(&self, setpoint: Setpoint) -> (Vector, f32) {
        let [x, y, z, ..] = setpoint.counts;
        let [a, b, c, ..] = self.last.counts;
        let step = [float(x, a, -1), float(y, b, -1), float(z, c, -1)];
        (step, size(step) * ROUNDING)
    }

    /// The same about them, radians.
    fn about(&self, setpoint: Setpoint) -> (Vector, f32) {
        let [_, _, _, x, y, z] = setpoint.counts;
        let [_, _, _, a, b, c] = self.last.counts;
        let unit = self.rotation_rad;
        let change = [float(x, a, -1), float(y, b, -1), float(z, c, -1)].map(|count| count * unit);
        let middle = [float(x, a, 1), float(y, b, 1), float(z, c, 1)].map(|count| count * (0.5 * unit));
        let square = squared(middle);
        let once = cross(middle, change);
        let twice = cross(middle, once);
        let step = plus_scaled(change, polynomial(&COSINE, square), once);
        let step = plus_scaled(step, polynomial(&SINE, square), twice);
        let size = size(change);
        let error =
            if size <= LARGEST_STEP { size * (ROUNDING + MIDPOINT * squared(change)) } else { f32::INFINITY };
        (step, error)
    }
}

/// The sum or the difference of two counts.
fn float(a: i32, b: i32, sign: i64) -> f32 {
    #[expect(clippy::cast_precision_loss, reason = "rounding is in the errors")]
    let value = i64::from(a).saturating_add(i64::from(b).saturating_mul(sign)) as f32;
    value
}

/// The counts for which the origin of the tool is in the box, one to spare.
fn workspace(anchor: &Pose, limits: &Limits, lsb: Lsb) -> [[i32; 3]; 2] {
    let origin: [f64; 3] = anchor.position_m.into();
    let (mut low, mut high) = ([0; 3], [0; 3]);
    let sides = limits.workspace_min_m.into_iter().zip(limits.workspace_max_m);
    for (((low, high), origin), (min, max)) in low.iter_mut().zip(&mut high).zip(origin).zip(sides) {
        let counts = |side: f64| (side - origin) / lsb.translation_m();
        #[expect(
            clippy::cast_possible_truncation,
            reason = "what is beyond all counts becomes the last of them"
        )]
        let (least, most) = (counts(min) as i32, counts(max) as i32);
        *low = least.saturating_add(2);
        *high = most.saturating_sub(2);
    }
    [low, high]
}

#[cfg(test)]
#[expect(
    clippy::indexing_slicing,
    clippy::cast_possible_truncation,
    reason = "six axes, and counts that fit"
)]
mod tests {
    use super::*;
    use crate::displacement::pose_at;
    use crate::limits::LimitChecker;
    use nalgebra::{UnitQuaternion, Vector3};
    use proptest::prelude::*;

    fn limits() -> Limits {
        Limits {
            workspace_min_m: [-0.02, -0.3, -0.3],
            workspace_max_m: [0.05, 0.3, 0.3],
            linear_velocity_m_s: 0.5,
            linear_acceleration_m_s2: 5.0,
            linear_jerk_m_s3: 400.0,
            angular_velocity_rad_s: 2.0,
            angular_acceleration_rad_s2: 20.0,
            angular_jerk_rad_s3: 2_000.0,
        }
    }

    fn anchor() -> Pose {
        let orientation = UnitQuaternion::from_euler_angles(0.3, -1.2, 2.0);
        Pose { position_m: Vector3::new(0.01, 0.1, -0.1), orientation }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2_000))]

        /// Jerky walks that use the limits more or less, from any rotation on: whatever passes is accepted by who decides, and
        /// what uses no limit by more than 0.97 passes.
        #[test]
        fn what_passes_keeps_the_limits(
            jerks in prop::collection::vec(prop::array::uniform6(-1.0..1.0_f64), 1..60), hard in 0.05..1.2_f64,
            fine: bool, period_us in prop::sample::select(&[1_000_u32, 4_000, 10_000]),
        ) {
            let lsb = if fine { Lsb::default() } else { Lsb { translation_nm: 1_000, rotation_nrad: 10_000 } };
            let (limits, h) = (limits(), f64::from(period_us) / 1e6);
            if limits.check_resolution(lsb, period_us).is_err() {
                return Ok(());
            }
            let mut checker = LimitChecker::new(limits, lsb, period_us, anchor());
            let mut sieve = Sieve::new(&anchor(), &limits, lsb, period_us);
            let (mut a, mut v, mut x) = ([0.0; 6], [0.0; 6], [0.0; 6]);
            for (tick, jerk) in (1..).zip(jerks) {
                for axis in 0..6 {
                    let (most, unit) = if axis < 3 { (400.0, lsb.translation_m()) } else { (2_000.0, lsb.rotation_rad()) };
                    a[axis] += hard * most * jerk[axis] * h;
                    v[axis] += a[axis] * h;
                    x[axis] += v[axis] * h / unit;
                }
                let setpoint = Setpoint { tick, counts: x.map(|x| x.round() as i32) };
                if setpoint.validate(lsb).is_err() {
                    break;
                }
                let (next, passes) = sieve.after(setpoint);
                let found = checker.check(pose_at(&anchor(), setpoint, lsb));
                let Ok(motion) = found else {
                    prop_assert!(!passes, "{found:?}");
                    break;
                };
                sieve = next;
                let bounds = [0.5, 5.0, 400.0, 2.0, 20.0, 2_000.0];
                let easy = motion.norms().into_iter().zip(bounds).all(|(value, bound)| value < 0.97 * bound);
                let inside = (-0.0299..0.0399).contains(&(f64::from(setpoint.counts[0]) * lsb.translation_m()));
                prop_assert!(passes || !easy || !inside, "{motion:?}");
            }
            let (found, exact) = (sieve.peak_use(), checker.peak_use());
            for (found, exact) in [
                (found.linear_velocity, exact.linear_velocity),
                (found.linear_jerk, exact.linear_jerk),
                (found.angular_velocity, exact.angular_velocity),
                (found.angular_acceleration, exact.angular_acceleration),
                (found.angular_jerk, exact.angular_jerk),
            ] {
                prop_assert!((found - exact).abs() <= 0.01 * exact + 1e-6, "{found} for {exact}");
            }
        }

        /// The term that the middle of a step misses is as small as is said.
        #[test]
        fn a_step_about_axes_is_as_exact_as_is_said(
            from in prop::array::uniform3(-1.8..1.8_f64), by in prop::array::uniform3(-0.17..0.17_f64), small in 0.0..1.0_f64,
        ) {
            let lsb = Lsb::default();
            let counts = |r: [f64; 3]| r.map(|r| (r * 1e7).round() as i32);
            let at = |tick, [x, y, z]: [i32; 3]| Setpoint { tick, counts: [0, 0, 0, x, y, z] };
            let before = at(1, counts(from));
            let to: [f64; 3] = core::array::from_fn(|axis| from[axis] + small * by[axis]);
            let after = at(2, counts(to));
            prop_assume!(before.validate(lsb).is_ok() && after.validate(lsb).is_ok());
            let (sieve, _) = Sieve::new(&anchor(), &limits(), lsb, 10_000).after(before);
            let (found, error) = sieve.about(after);
            let exact = crate::displacement::displacement_between(before, after, lsb).rotation();
            let off = exact - Vector3::from(found.map(f64::from));
            prop_assert!(crate::pose::norm(&off) <= f64::from(error), "{} {error}", crate::pose::norm(&off));
        }
    }
}
