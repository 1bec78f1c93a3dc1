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
//! Velocity, acceleration and jerk are the differences over a tick that the limits are defined by, and count up to and
//! beyond standstill. Where the polynomial would first exceed the speed limit (braking begins while still accelerating
//! near it), the acceleration is taken out first, as fast as the jerk allows.
//!
//! A stop is bounded in time, whatever limits a session asks for. Translation and rotation each take the first that works:
//!
//! 1. the shortest T that keeps the limits in force, if it is at most [`GENTLE_STOP_US`];
//! 2. T = [`GENTLE_STOP_US`], within the arm's own limits on acceleration and jerk and the speed limit in force;
//! 3. the shortest T that keeps the arm's own limits, if it is at most [`LONGEST_STOP_US`];
//! 4. the same with the arm's own limits doubled until it works: an arm that cannot stop within its limits in
//!    [`LONGEST_STOP_US`] had better break them than go on.
//!
//! The workspace box has no say here: an arm that must stop while it moves along or towards a wall of the box may pass it
//! by its stopping distance. Whoever draws the box leaves that margin.
//!
//! # Joints
//! Where joints cannot follow such a stop, each of them brakes by the same polynomial, all within the same T: a [`JointStop`]. The
//! fastest kind of joint keeps the limits on angular acceleration and jerk, a slower one as much less as it is slower. No
//! joint turns faster than it may: its acceleration is rather taken out at once than as fast as the jerk allows. Range and
//! neighbourhood of singularities have as little say as the workspace box, and for the same reason.

use nalgebra::SVector;
use powderline_shared::arm::{ArmModel, Joints};
use powderline_shared::displacement::Displacement;
use powderline_shared::limits::{Limits, Motion};
use powderline_shared::pose::Pose;

use crate::arm::JointMotion;

/// Longest stop that a session's limits may lead to, microseconds.
pub const GENTLE_STOP_US: u32 = 500_000;

/// Longest stop of all, microseconds.
pub const LONGEST_STOP_US: u32 = 1_000_000;

/// Most ticks of a stop that is not bounded in time, [`StopProfile::within_limits`].
const MAX_TICKS: u32 = 20_000;

/// How often the arm's own limits are doubled, at the most.
const DOUBLINGS: i32 = 64;

/// Deceleration of translation and rotation, side by side.
#[derive(Clone, Copy, Debug)]
pub struct StopProfile {
    pose: Pose,
    linear: Ramp<3>,
    angular: Ramp<3>,
    tick: u32,
    h: f64,
}

impl StopProfile {
    /// Brakes from `motion` in bounded time: by the limits in force if they allow it, else by the arm's own.
    #[must_use]
    pub fn new(motion: &Motion, in_force: &Limits, own: &Limits, period_us: u32) -> Self {
        let h = f64::from(period_us) / 1e6;
        let [along, about] = ramps(motion, h);
        Self {
            pose: motion.pose,
            linear: along.bounded(linear(in_force), linear(own), period_us),
            angular: about.bounded(angular(in_force), angular(own), period_us),
            tick: 0,
            h,
        }
    }

    /// Brakes from `motion` within `limits`, as long as that may take; `None` beyond any reasonable time.
    #[must_use]
    pub fn within_limits(motion: &Motion, limits: &Limits, period_us: u32) -> Option<Self> {
        let h = f64::from(period_us) / 1e6;
        let [along, about] = ramps(motion, h);
        Some(Self {
            pose: motion.pose,
            linear: along.shortest(linear(limits), MAX_TICKS)?,
            angular: about.shortest(angular(limits), MAX_TICKS)?,
            tick: 0,
            h,
        })
    }

    /// The pose one tick later; `None` at rest.
    pub fn next_pose(&mut self) -> Option<Pose> {
        if self.tick >= self.ticks() {
            return None;
        }
        self.tick = self.tick.saturating_add(1);
        self.pose = self.pose.displaced(&Displacement {
            translation_m: (self.linear.velocity(self.tick) * self.h).into(),
            rotation_rad: (self.angular.velocity(self.tick) * self.h).into(),
        });
        Some(self.pose)
    }

    /// Length of the whole stop in ticks.
    #[must_use]
    pub fn ticks(&self) -> u32 {
        self.linear.ticks().max(self.angular.ticks())
    }
}

/// Deceleration of all joints, in a straight line of theirs.
#[derive(Clone, Copy, Debug)]
pub struct JointStop {
    /// In shares of how fast each joint is.
    joints: SVector<f64, 6>,
    shares: SVector<f64, 6>,
    ramp: Ramp<6>,
    tick: u32,
}

impl JointStop {
    /// Brakes the joints of `model` from `motion` in bounded time: by the limits in force if they allow it, else by the arm's
    /// own.
    #[must_use]
    pub fn new(
        motion: &JointMotion,
        model: &ArmModel,
        in_force: &Limits,
        own: &Limits,
        period_us: u32,
    ) -> Self {
        let fastest = model.joint_speed_rad_s.into_iter().fold(0.0, libm::fmax);
        let share = |speed: f64| if speed > 0.0 { speed / fastest } else { 1.0 };
        let shares = SVector::from(model.joint_speed_rad_s.map(share));
        let of_share = |values: &SVector<f64, 6>| values.component_div(&shares);
        let ramp = Ramp {
            v0: of_share(&motion.velocity_rad_s),
            a0: of_share(&motion.acceleration_rad_s2),
            ease: 0,
            brake: 0,
            h: f64::from(period_us) / 1e6,
            measure: Measure::EachJoint,
        };
        let bounds = |limits| {
            let [_, acceleration, jerk] = angular(limits);
            [fastest, acceleration, jerk]
        };
        Self {
            joints: of_share(&SVector::from(motion.angles_rad)),
            shares,
            ramp: ramp.bounded(bounds(in_force), bounds(own), period_us),
            tick: 0,
        }
    }

    /// The joints one tick later; `None` at rest.
    pub fn next_joints(&mut self) -> Option<Joints> {
        if self.tick >= self.ramp.ticks() {
            return None;
        }
        self.tick = self.tick.saturating_add(1);
        self.joints += self.ramp.velocity(self.tick) * self.ramp.h;
        Some(self.joints.component_mul(&self.shares).into())
    }
}

/// Those of translation and rotation, of no length yet.
fn ramps(motion: &Motion, h: f64) -> [Ramp<3>; 2] {
    [&motion.linear, &motion.angular].map(|from| Ramp {
        v0: from.velocity,
        a0: from.acceleration,
        ease: 0,
        brake: 0,
        h,
        measure: Measure::Tool,
    })
}

/// Bounds on velocity, acceleration and jerk.
type Bounds = [f64; 3];

fn linear(limits: &Limits) -> Bounds {
    [limits.linear_velocity_m_s, limits.linear_acceleration_m_s2, limits.linear_jerk_m_s3]
}

fn angular(limits: &Limits) -> Bounds {
    [limits.angular_velocity_rad_s, limits.angular_acceleration_rad_s2, limits.angular_jerk_rad_s3]
}

/// Whole periods in a time, at least one.
fn ticks_in(time_us: u32, period_us: u32) -> u32 {
    time_us.checked_div(period_us).unwrap_or(time_us).max(1)
}

/// What a bound is held against.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Measure {
    /// The norm. Where not all can be had, jerk is kept, and speed is not.
    Tool,
    /// The largest component. Where not all can be had, speed is kept, and jerk is not.
    EachJoint,
}

/// First `ease` ticks in which the acceleration goes to zero, then `brake` ticks of the polynomial.
#[derive(Clone, Copy, Debug)]
struct Ramp<const N: usize> {
    v0: SVector<f64, N>,
    a0: SVector<f64, N>,
    ease: u32,
    brake: u32,
    h: f64,
    measure: Measure,
}

impl<const N: usize> Ramp<N> {
    /// See the head of this file.
    fn bounded(self, in_force: Bounds, own: Bounds, period_us: u32) -> Self {
        let (soon, latest) = (ticks_in(GENTLE_STOP_US, period_us), ticks_in(LONGEST_STOP_US, period_us));
        let doubled = |times| own.map(|bound| bound * 2.0_f64.powi(times));
        let [_, acceleration, jerk] = own;
        self.shortest(in_force, soon)
            .or_else(|| self.of_length([in_force[0], acceleration, jerk], soon))
            .or_else(|| (0..DOUBLINGS).find_map(|times| self.shortest(doubled(times), latest)))
            .unwrap_or(Self { brake: latest, ..self })
    }

    /// The shortest that keeps the bounds; `None` if that is more than `longest` ticks.
    fn shortest(self, bounds: Bounds, longest: u32) -> Option<Self> {
        let bounds = self.attainable(bounds);
        let [velocity, acceleration, jerk] = bounds;
        let eased = self.eased(jerk);
        let (rather, bounds_kept) = match self.measure {
            Measure::Tool => (eased, [f64::INFINITY, acceleration, jerk]),
            Measure::EachJoint => (Self { ease: 1, ..self }, [velocity, acceleration, f64::INFINITY]),
        };
        self.with_shortest_brake(bounds, longest)
            .or_else(|| eased.with_shortest_brake(bounds, longest))
            .or_else(|| rather.with_shortest_brake(bounds_kept, longest))
    }

    /// The one of `length` ticks, if it keeps the bounds.
    fn of_length(self, bounds: Bounds, length: u32) -> Option<Self> {
        let bounds = self.attainable(bounds);
        let [_, _, jerk] = bounds;
        let fits = |ramp: Self| {
            let brake = length.checked_sub(ramp.ease).filter(|brake| *brake > 0)?;
            Some(Self { brake, ..ramp }).filter(|ramp| ramp.keeps(bounds))
        };
        fits(self).or_else(|| fits(self.eased(jerk)))
    }

    fn eased(self, jerk: f64) -> Self {
        Self { ease: ticks_up(self.size(&self.a0) / (jerk * self.h)), ..self }
    }

    /// In a fixed order of operations.
    fn size(&self, value: &SVector<f64, N>) -> f64 {
        match self.measure {
            Measure::Tool => libm::sqrt(value.iter().map(|x| x * x).sum()),
            Measure::EachJoint => value.iter().fold(0.0, |largest, x| libm::fmax(largest, x.abs())),
        }
    }

    /// What is beyond a limit already (by quantisation) need not get worse.
    fn attainable(&self, bounds: Bounds) -> Bounds {
        let [velocity, acceleration, jerk] = bounds;
        [velocity.max(self.size(&self.v0)), acceleration.max(self.size(&self.a0)), jerk]
    }

    /// Lengths that grow by a quarter until one keeps the bounds, then bisection: the shortest, or one close to it where
    /// a longer stop may break a bound that a shorter one keeps.
    fn with_shortest_brake(self, bounds: Bounds, longest: u32) -> Option<Self> {
        if [self.v0, self.a0].iter().all(|value| value.iter().all(|x| *x == 0.0)) {
            return Some(self);
        }
        let longest = longest.checked_sub(self.ease).filter(|ticks| *ticks > 0)?;
        let keeps = |brake| Self { brake, ..self }.keeps(bounds);
        let (mut too_short, mut brake) = (0, 1);
        while !keeps(brake) {
            if brake >= longest {
                return None;
            }
            too_short = brake;
            brake = brake.saturating_add(brake / 4).saturating_add(1).min(longest);
        }
        while brake.saturating_sub(too_short) > 1 {
            let middle = too_short.midpoint(brake);
            if keeps(middle) { brake = middle } else { too_short = middle }
        }
        Some(Self { brake, ..self })
    }

    fn keeps(&self, bounds: Bounds) -> bool {
        let (mut last_velocity, mut last_acceleration) = (self.v0, self.a0);
        // Two ticks beyond the end, until acceleration and jerk have come to zero as well.
        (1..=self.ticks().saturating_add(2)).all(|tick| {
            let velocity = self.velocity(tick);
            let acceleration = (velocity - last_velocity) / self.h;
            let jerk = (acceleration - last_acceleration) / self.h;
            (last_velocity, last_acceleration) = (velocity, acceleration);
            let values = [velocity, acceleration, jerk].map(|value| self.size(&value));
            values.into_iter().zip(bounds).all(|(value, bound)| value <= bound * (1.0 + 1e-9))
        })
    }

    fn ticks(&self) -> u32 {
        self.ease.saturating_add(self.brake)
    }

    fn velocity(&self, tick: u32) -> SVector<f64, N> {
        if tick >= self.ticks() {
            return SVector::zeros();
        }
        if tick <= self.ease {
            return self.easing_velocity(tick);
        }
        // After easing nothing is left of the acceleration.
        let (v1, a1) = if self.ease == 0 {
            (self.v0, self.a0)
        } else {
            (self.easing_velocity(self.ease), SVector::zeros())
        };
        let s = f64::from(tick.saturating_sub(self.ease)) / f64::from(self.brake);
        let length_s = f64::from(self.brake) * self.h;
        v1 * ((1.0 - s) * (1.0 - s) * (1.0 + 2.0 * s)) + a1 * (length_s * s * (1.0 - s) * (1.0 - s))
    }

    /// v0 + h a0 sum over i = 1..=tick of (1 - i / ease).
    fn easing_velocity(&self, tick: u32) -> SVector<f64, N> {
        if self.ease == 0 {
            return self.v0;
        }
        let (tick, ease) = (f64::from(tick), f64::from(self.ease));
        self.v0 + self.a0 * (self.h * (tick - tick * (tick + 1.0) / (2.0 * ease)))
    }
}

/// Rounded up, at least 1 if above zero, at most [`MAX_TICKS`].
fn ticks_up(value: f64) -> u32 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded from both sides")]
    let ticks = value.ceil().clamp(0.0, f64::from(MAX_TICKS)) as u32;
    ticks
}

#[cfg(test)]
#[expect(clippy::arithmetic_side_effects, reason = "a test may stop at the first surprise")]
mod tests {
    use super::*;
    use crate::controller::ArmConfig;
    use nalgebra::Vector3;
    use powderline_shared::limits::Derivatives;
    use powderline_shared::pose::norm;
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
        peaks_of(StopProfile::new(&motion, limits, limits, period_us), motion, period_us)
    }

    fn peaks_of(mut profile: StopProfile, motion: Motion, period_us: u32) -> ([f64; 6], u32) {
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

    /// The simulated arm's, which a session's limits may not go beyond.
    fn own() -> Limits {
        ArmConfig::ideal(Pose::identity()).limits
    }

    fn ms(ticks: u32, period_us: u32) -> u32 {
        ticks * period_us / 1_000
    }

    #[test]
    fn limits_that_allow_hardly_any_braking_do_not_make_a_stop_long() {
        let slow = Limits { linear_acceleration_m_s2: 0.01, angular_jerk_rad_s3: 0.1, ..limits(40.0) };
        let motion = moving(Vector3::x() * 0.25, Vector3::zeros(), Vector3::z() * 1.0, Vector3::zeros());
        for period_us in [100, 1_000, 10_000, 100_000] {
            let (peak, ticks) =
                peaks_of(StopProfile::new(&motion, &slow, &own(), period_us), motion, period_us);
            assert_eq!(ms(ticks, period_us), 500);
            // Not harder than half a second asks for: 1.5 v / T, and the first tick's step in acceleration.
            assert!(peak[1] < 1.6 * 0.25 / 0.5 && peak[4] < 1.6 * 1.0 / 0.5, "{peak:?}");
        }
    }

    #[test]
    fn from_its_top_speed_an_arm_stops_by_its_own_limits() {
        let own = own();
        let [v, a, w, alpha] =
            [3.0 * Vector3::x(), 9.0 * Vector3::y(), 6.2 * Vector3::z(), 50.0 * Vector3::x()];
        let motion = moving(v, a, w, alpha);
        for period_us in [1_000, 10_000] {
            let slow = Limits { linear_acceleration_m_s2: 0.01, angular_jerk_rad_s3: 0.1, ..own };
            let (peak, ticks) =
                peaks_of(StopProfile::new(&motion, &slow, &own, period_us), motion, period_us);
            assert!((500..700).contains(&ms(ticks, period_us)), "{} ms", ms(ticks, period_us));
            for ((limit, bound), value) in own.derivative_bounds().into_iter().zip(peak) {
                assert!(value <= bound * (1.0 + 1e-6), "{limit}: {value} > {bound}");
            }
        }
    }

    #[test]
    fn absurd_limits_still_lead_to_rest_in_bounded_time() {
        let motion = moving(Vector3::x() * 0.5, Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        for jerk in [1e-9, 1e-300] {
            let (_, ticks) = peaks(motion, &limits(jerk), 10_000);
            assert!((500..=1_000).contains(&ms(ticks, 10_000)), "{ticks} ticks");
        }
        assert!(StopProfile::within_limits(&motion, &limits(1e-9), 10_000).is_none());
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

        /// Whatever the joints do when they have to, each keeps its speed and all the arm's own limit, beside one another.
        #[test]
        fn joints_brake_within_what_they_can(
            shares in prop::array::uniform6(-1.0..1.0f64), speeding_up in prop::array::uniform6(-1.0..1.0f64),
            tightness in -6.0..0.0f64, slow: bool, period_us in prop::sample::select(vec![500, 1_000, 10_000]),
        ) {
            let mut model = ArmModel::bench();
            if slow {
                model.joint_speed_rad_s = [2.0, 2.0, 3.0, 4.0, 4.0, 4.0];
            }
            let session = Limits { angular_acceleration_rad_s2: 50.0 * 10.0_f64.powf(tightness), ..own() };
            let from = JointMotion {
                angles_rad: [0.5; 6],
                velocity_rad_s: SVector::from(shares).component_mul(&SVector::from(model.joint_speed_rad_s)),
                acceleration_rad_s2: SVector::from(speeding_up) * 25.0,
            };
            let mut stop = JointStop::new(&from, &model, &session, &own(), period_us);
            let (mut motion, mut ticks) = (from, 0);
            let mut next = || {
                ticks += 1;
                stop.next_joints()
            };
            while let Some(joints) = next() {
                motion = motion.moved_to(joints, period_us);
                for ((speed, bound), acceleration) in
                    motion.velocity_rad_s.iter().zip(model.joint_speed_rad_s).zip(&motion.acceleration_rad_s2)
                {
                    prop_assert!(speed.abs() <= bound * (1.0 + 1e-9), "{speed} rad/s");
                    prop_assert!(acceleration.abs() <= 50.0 * (1.0 + 1e-6), "{acceleration} rad/s^2");
                }
            }
            prop_assert!(motion.velocity_rad_s.iter().all(|speed| speed.abs() < 1e-9));
            prop_assert!((ticks - 1) * period_us <= LONGEST_STOP_US, "{ticks} ticks of {period_us} us");
        }

        /// Whatever a session's limits and the state of the arm within its own.
        #[test]
        fn no_stop_takes_longer_than_the_bound(
            (d1, d2, d3, d4) in (direction(), direction(), direction(), direction()),
            (v, a, w, alpha) in (0.0..3.0, 0.0..9.0, 0.0..6.2, 0.0..50.0),
            tightness in [-6.0..0.0, -6.0..0.0, -6.0..0.0, -6.0..0.0f64],
            period_us in prop::sample::select(vec![100, 1_000, 10_000, 100_000]),
        ) {
            let [t0, t1, t2, t3] = tightness.map(|exponent| 10.0_f64.powf(exponent));
            let session = Limits {
                linear_acceleration_m_s2: 9.0 * t0,
                linear_jerk_m_s3: 4_500.0 * t1,
                angular_acceleration_rad_s2: 50.0 * t2,
                angular_jerk_rad_s3: 8_500.0 * t3,
                ..own()
            };
            let motion = moving(d1 * v, d2 * a, d3 * w, d4 * alpha);
            let (_, ticks) = peaks_of(StopProfile::new(&motion, &session, &own(), period_us), motion, period_us);
            prop_assert!(ticks * period_us <= LONGEST_STOP_US, "{ticks} ticks of {period_us} us");
        }
    }
}
