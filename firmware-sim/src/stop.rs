//! How a moving arm comes to rest within its limits.
//!
//! | symbol  | identifier     | meaning                                                      |
//! |---------|----------------|--------------------------------------------------------------|
//! | v0, a0  | `v0`, `a0`     | velocity and acceleration when the stop begins               |
//! | T       | ticks times h  | length of the stop                                           |
//! | s       | share          | time since the begin, 0..1 of T                              |
//!
//! ```text
//! v(s) = (1 - 3 s^2 + 2 s^3) v0 + (s - 2 s^2 + s^3) T a0
//! ```
//!
//! The shortest T is taken at which velocity, acceleration and jerk, as the differences over a tick that the limits are
//! defined by, stay within bounds up to and beyond standstill. Where that polynomial would first exceed the speed limit
//! (braking begins while still accelerating near it), the acceleration is taken out first, as fast as the jerk allows.
//!
//! The workspace box has no say here: an arm that must stop while it moves along or towards a wall of the box may pass it
//! by its stopping distance. Whoever draws the box leaves that margin.

use nalgebra::Vector3;
use powderline_shared::displacement::Displacement;
use powderline_shared::limits::{Derivatives, Limits, Motion};
use powderline_shared::pose::{Pose, norm};

/// No stop takes more ticks. Sane limits need a few hundred; with absurd ones (no jerk to speak of) it is better to stop
/// hard at this point than never.
pub const MAX_STOP_TICKS: u32 = 20_000;

/// Deceleration of translation and rotation, side by side.
#[derive(Clone, Copy, Debug)]
pub struct StopProfile {
    pose: Pose,
    linear: Ramp,
    angular: Ramp,
    tick: u32,
    h: f64,
}

impl StopProfile {
    /// Brakes from `motion`.
    #[must_use]
    pub fn new(motion: &Motion, limits: &Limits, period_us: u32) -> Self {
        let h = f64::from(period_us) / 1e6;
        let linear = [limits.linear_velocity_m_s, limits.linear_acceleration_m_s2, limits.linear_jerk_m_s3];
        let angular =
            [limits.angular_velocity_rad_s, limits.angular_acceleration_rad_s2, limits.angular_jerk_rad_s3];
        Self {
            pose: motion.pose,
            linear: Ramp::shortest(&motion.linear, linear, h),
            angular: Ramp::shortest(&motion.angular, angular, h),
            tick: 0,
            h,
        }
    }

    /// The pose one tick later; `None` at rest.
    pub fn next_pose(&mut self) -> Option<Pose> {
        if self.tick >= self.ticks() {
            return None;
        }
        self.tick += 1;
        self.pose = self.pose.displaced(&Displacement {
            translation_m: (self.linear.velocity(self.tick) * self.h).into(),
            rotation_rad: (self.angular.velocity(self.tick) * self.h).into(),
        });
        Some(self.pose)
    }

    /// Length of the whole stop.
    #[must_use]
    pub fn ticks(&self) -> u32 {
        self.linear.ticks().max(self.angular.ticks())
    }
}

/// First `ease` ticks in which the acceleration goes to zero, then `brake` ticks of the polynomial.
#[derive(Clone, Copy, Debug)]
struct Ramp {
    v0: Vector3<f64>,
    a0: Vector3<f64>,
    ease: u32,
    brake: u32,
    h: f64,
}

impl Ramp {
    fn shortest(from: &Derivatives, bounds: [f64; 3], h: f64) -> Self {
        let [velocity, acceleration, jerk] = bounds;
        // What is beyond a limit already (by quantisation) need not get worse.
        let (v0, a0) = (from.velocity, from.acceleration);
        let bounds = [velocity.max(norm(&v0)), acceleration.max(norm(&a0)), jerk];
        let direct = Self { v0, a0, ease: 0, brake: 0, h };
        let ease = ticks_up(norm(&a0) / (jerk * h));
        let eased = Self { ease, ..direct };
        direct
            .with_shortest_brake(bounds)
            .or_else(|| eased.with_shortest_brake(bounds))
            .or_else(|| eased.with_shortest_brake([f64::INFINITY, bounds[1], jerk]))
            .unwrap_or(Self { brake: MAX_STOP_TICKS, ..direct })
    }

    fn with_shortest_brake(self, bounds: [f64; 3]) -> Option<Self> {
        let shortest = u32::from(self.v0 != Vector3::zeros() || self.a0 != Vector3::zeros());
        (shortest..=MAX_STOP_TICKS).map(|brake| Self { brake, ..self }).find(|ramp| ramp.keeps(bounds))
    }

    fn keeps(&self, bounds: [f64; 3]) -> bool {
        let mut last = Derivatives { velocity: self.v0, acceleration: self.a0, jerk: Vector3::zeros() };
        // Two ticks beyond the end, until acceleration and jerk have come to zero as well.
        (1..=self.ticks() + 2).all(|tick| {
            let velocity = self.velocity(tick);
            let acceleration = (velocity - last.velocity) / self.h;
            let jerk = (acceleration - last.acceleration) / self.h;
            last = Derivatives { velocity, acceleration, jerk };
            let values = [norm(&velocity), norm(&acceleration), norm(&jerk)];
            values.into_iter().zip(bounds).all(|(value, bound)| value <= bound * (1.0 + 1e-9))
        })
    }

    fn ticks(&self) -> u32 {
        self.ease + self.brake
    }

    fn velocity(&self, tick: u32) -> Vector3<f64> {
        if tick >= self.ticks() {
            return Vector3::zeros();
        }
        if tick <= self.ease {
            return self.easing_velocity(tick);
        }
        // After easing nothing is left of the acceleration.
        let (v1, a1) = if self.ease == 0 {
            (self.v0, self.a0)
        } else {
            (self.easing_velocity(self.ease), Vector3::zeros())
        };
        let s = f64::from(tick - self.ease) / f64::from(self.brake);
        let length_s = f64::from(self.brake) * self.h;
        v1 * ((1.0 - s) * (1.0 - s) * (1.0 + 2.0 * s)) + a1 * (length_s * s * (1.0 - s) * (1.0 - s))
    }

    /// v0 + h a0 sum over i = 1..=tick of (1 - i / ease).
    fn easing_velocity(&self, tick: u32) -> Vector3<f64> {
        if self.ease == 0 {
            return self.v0;
        }
        let (tick, ease) = (f64::from(tick), f64::from(self.ease));
        self.v0 + self.a0 * (self.h * (tick - tick * (tick + 1.0) / (2.0 * ease)))
    }
}

/// Rounded up, at least 1 if above zero, at most [`MAX_STOP_TICKS`].
fn ticks_up(value: f64) -> u32 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded from both sides")]
    let ticks = value.ceil().clamp(0.0, f64::from(MAX_STOP_TICKS)) as u32;
    ticks
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn limits(jerk: f64) -> Limits {
        Limits {
            workspace_min_m: [-9.0; 3],
            workspace_max_m: [9.0; 3],
            linear_velocity_m_s: 0.5,
            linear_acceleration_m_s2: 2.0,
            linear_jerk_m_s3: jerk,
            angular_velocity_rad_s: 2.0,
            angular_acceleration_rad_s2: 10.0,
            angular_jerk_rad_s3: 10.0 * jerk,
        }
    }

    fn moving(v: Vector3<f64>, a: Vector3<f64>, w: Vector3<f64>, alpha: Vector3<f64>) -> Motion {
        let zero = Vector3::zeros();
        Motion {
            pose: Pose::identity(),
            linear: Derivatives { velocity: v, acceleration: a, jerk: zero },
            angular: Derivatives { velocity: w, acceleration: alpha, jerk: zero },
        }
    }

    /// Largest |v|, |a|, |j| of translation and rotation on the way to rest, and the ticks it takes.
    fn peaks(motion: Motion, limits: &Limits, period_us: u32) -> ([f64; 6], u32) {
        let mut profile = StopProfile::new(&motion, limits, period_us);
        let (mut motion, mut peak, mut ticks) = (motion, [0.0_f64; 6], 0);
        let mut raise = |motion: &Motion| {
            for (peak, value) in peak.iter_mut().zip(motion.norms()) {
                *peak = peak.max(value);
            }
        };
        while let Some(pose) = profile.next_pose() {
            motion = motion.moved_to(pose, period_us);
            raise(&motion);
            ticks += 1;
        }
        for _ in 0..3 {
            motion = motion.moved_to(motion.pose, period_us);
            raise(&motion);
        }
        assert!(motion.norms().iter().all(|norm| *norm < 1e-9), "{motion:?}");
        (peak, ticks)
    }

    #[test]
    fn at_rest_there_is_nothing_to_do() {
        let (_, ticks) = peaks(Motion::at_rest(Pose::identity()), &limits(40.0), 10_000);
        assert_eq!(ticks, 0);
    }

    #[test]
    fn a_stop_is_not_much_longer_than_the_shortest_possible() {
        let motion = moving(Vector3::x() * 0.5, Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        let (_, ticks) = peaks(motion, &limits(40.0), 1_000);
        // Trapezoid of acceleration: v / a + a / j.
        let shortest_s = 0.5 / 2.0 + 2.0 / 40.0;
        assert!(f64::from(ticks) / 1e3 < 1.3 * shortest_s, "{ticks} ms for {shortest_s} s");
    }

    #[test]
    fn absurd_limits_still_lead_to_rest() {
        let motion = moving(Vector3::x() * 0.5, Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        let (_, ticks) = peaks(motion, &limits(1e-9), 10_000);
        assert_eq!(ticks, MAX_STOP_TICKS);
    }

    fn direction() -> impl Strategy<Value = Vector3<f64>> {
        [-1.0..1.0, -1.0..1.0, -1.0..1.0f64]
            .prop_map(Vector3::from)
            .prop_filter("a direction", |v| norm(v) > 0.1)
            .prop_map(|v| v / norm(&v))
    }

    proptest! {
        /// From any state that a plan within limits can be in (v + a^2 / 2j below the speed limit, so that the plan itself
        /// has a way to go on), a stop keeps all limits.
        #[test]
        fn limits_hold_on_the_way_to_rest(
            (d1, d2, d3, d4) in (direction(), direction(), direction(), direction()),
            (a, alpha) in (0.0..1.0, 0.0..1.0), (v, w) in (0.0..1.0, 0.0..1.0), fast: bool,
        ) {
            let limits = limits(40.0);
            let reserve = |bound: f64, a: f64, jerk: f64| (bound - a * a / (2.0 * jerk)).max(0.0);
            let (a, alpha) = (2.0 * a, 10.0 * alpha);
            let motion = moving(
                d1 * (v * reserve(0.5, a, 40.0)), d2 * a,
                d3 * (w * reserve(2.0, alpha, 400.0)), d4 * alpha,
            );
            let (peak, _) = peaks(motion, &limits, if fast { 1_000 } else { 10_000 });
            for ((limit, bound), value) in limits.derivative_bounds().into_iter().zip(peak) {
                prop_assert!(value <= bound * (1.0 + 1e-6), "{limit}: {value} > {bound}");
            }
        }
    }
}
