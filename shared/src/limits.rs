//! Motion limits, and the check that a stream of poses keeps them.
//!
//! The same check runs when a plan is made, when it is loaded, in front of the wire and behind it: nobody trusts the one
//! before. Derivatives are finite differences over the control period h of what is really commanded:
//!
//! | symbol | identifier     | equation                                                              |
//! |--------|----------------|-----------------------------------------------------------------------|
//! | v_k    | `velocity`     | (p_k - p_{k-1}) / h, or log(R_k R_{k-1}^-1) / h for rotation          |
//! | a_k    | `acceleration` | (v_k - v_{k-1}) / h                                                   |
//! | j_k    | `jerk`         | (a_k - a_{k-1}) / h                                                   |
//! | q      | LSB            | each component of a setpoint is off by at most q / 2                  |
//!
//! # Tolerance for quantisation
//! Rounding adds e_k with |e_k| <= sqrt(3) q / 2 to a position. The differences above then carry at most
//! (1 + 1) |e| / h in velocity, (1 + 2 + 1) |e| / h^2 in acceleration and (1 + 3 + 3 + 1) |e| / h^3 in jerk:
//!
//! ```text
//! v: sqrt(3) q / h        a: 2 sqrt(3) q / h^2        j: 4 sqrt(3) q / h^3
//! ```
//!
//! At q = 0.1 um and h = 10 ms that is 17 um/s, 3.5 mm/s^2 and 0.69 m/s^3; at 1 ms the jerk part is 693 m/s^3. For
//! rotation the same holds: the rotation vector's rounding reaches the rotation through the left Jacobian of SO(3), whose
//! norm is 1, and the step's logarithm through its inverse, whose norm is below 1 + a^2 / 20 for a step of angle a; one
//! per cent covers steps of up to 0.4 rad. Limits are compared with this tolerance added, and limits that drown in it
//! are refused ([`Limits::check_resolution`]).

use core::fmt;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::displacement::{Axis, Lsb};
use crate::pose::{Pose, norm};

const SQRT_3: f64 = 1.732_050_807_568_877_2;
const MICROSECONDS_PER_SECOND: f64 = 1e6;

/// Share of a limit that rounding in f64 may use up.
const RELATIVE_ROUNDING: f64 = 1e-9;

/// Ticks at rest after the last setpoint in which velocity, acceleration and jerk return to zero.
pub const TICKS_TO_REST: u32 = 3;

/// What the motion of the tool's origin must keep; also the section `limits` of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Lower corner of the workspace box, metres.
    pub workspace_min_m: [f64; 3],
    /// Upper corner of the workspace box, metres.
    pub workspace_max_m: [f64; 3],
    /// Speed, m/s.
    pub linear_velocity_m_s: f64,
    /// Acceleration, m/s^2.
    pub linear_acceleration_m_s2: f64,
    /// Jerk, m/s^3.
    pub linear_jerk_m_s3: f64,
    /// Angular speed, rad/s.
    pub angular_velocity_rad_s: f64,
    /// Angular acceleration, rad/s^2.
    pub angular_acceleration_rad_s2: f64,
    /// Angular jerk, rad/s^3.
    pub angular_jerk_rad_s3: f64,
}

impl Limits {
    /// The six bounds on derivatives, each with its limit.
    #[must_use]
    pub fn derivative_bounds(&self) -> [(Limit, f64); 6] {
        [
            (Limit::LinearVelocity, self.linear_velocity_m_s),
            (Limit::LinearAcceleration, self.linear_acceleration_m_s2),
            (Limit::LinearJerk, self.linear_jerk_m_s3),
            (Limit::AngularVelocity, self.angular_velocity_rad_s),
            (Limit::AngularAcceleration, self.angular_acceleration_rad_s2),
            (Limit::AngularJerk, self.angular_jerk_rad_s3),
        ]
    }

    /// Checks that the numbers can be limits at all.
    ///
    /// # Errors
    /// The first bound that is not a positive finite number, or workspace side that is empty.
    pub fn validate(&self) -> Result<(), LimitsError> {
        for (limit, value) in self.derivative_bounds() {
            if !(value.is_finite() && value > 0.0) {
                return Err(LimitsError::NotPositive { limit, value });
            }
        }
        for ((min, max), axis) in self.workspace_min_m.into_iter().zip(self.workspace_max_m).zip(Axis::ALL) {
            if !(min.is_finite() && max.is_finite() && min < max) {
                return Err(LimitsError::EmptyWorkspace { axis, min, max });
            }
        }
        Ok(())
    }

    /// Checks that each limit can be told from the noise that quantisation puts on it.
    ///
    /// # Errors
    /// The first limit that is not larger than its own quantisation noise.
    pub fn check_resolution(&self, lsb: Lsb, period_us: u32) -> Result<(), LimitsError> {
        let noises = QuantisationNoise::new(lsb, period_us).as_array();
        for ((limit, bound), noise) in self.derivative_bounds().into_iter().zip(noises) {
            if noise >= bound {
                return Err(LimitsError::DrownsInNoise { limit, bound, noise });
            }
        }
        Ok(())
    }

    /// The largest share of any limit that quantisation noise may add to it (1 = as much again).
    #[must_use]
    pub fn noise_share(&self, lsb: Lsb, period_us: u32) -> f64 {
        let noises = QuantisationNoise::new(lsb, period_us).as_array();
        let shares =
            self.derivative_bounds().into_iter().zip(noises).map(|((_, bound), noise)| noise / bound);
        shares.fold(0.0, libm::fmax)
    }

    /// What quantisation noise may add to each limit along the axes, and about them.
    pub(crate) fn noises(&self, lsb: Lsb, period_us: u32) -> ([f64; 3], [f64; 3]) {
        let QuantisationNoise { linear, angular, .. } = QuantisationNoise::new(lsb, period_us);
        (linear, angular)
    }

    /// The tighter of two limits, one by one.
    #[must_use]
    pub fn tighter(&self, other: &Self) -> Self {
        let min = |a: f64, b: f64| libm::fmin(a, b);
        let [ax, ay, az] = self.workspace_min_m;
        let [bx, by, bz] = other.workspace_min_m;
        let [cx, cy, cz] = self.workspace_max_m;
        let [dx, dy, dz] = other.workspace_max_m;
        Self {
            workspace_min_m: [libm::fmax(ax, bx), libm::fmax(ay, by), libm::fmax(az, bz)],
            workspace_max_m: [min(cx, dx), min(cy, dy), min(cz, dz)],
            linear_velocity_m_s: min(self.linear_velocity_m_s, other.linear_velocity_m_s),
            linear_acceleration_m_s2: min(self.linear_acceleration_m_s2, other.linear_acceleration_m_s2),
            linear_jerk_m_s3: min(self.linear_jerk_m_s3, other.linear_jerk_m_s3),
            angular_velocity_rad_s: min(self.angular_velocity_rad_s, other.angular_velocity_rad_s),
            angular_acceleration_rad_s2: min(
                self.angular_acceleration_rad_s2,
                other.angular_acceleration_rad_s2,
            ),
            angular_jerk_rad_s3: min(self.angular_jerk_rad_s3, other.angular_jerk_rad_s3),
        }
    }
}

/// One limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limit {
    /// Side of the workspace box along an axis (x, y or z).
    Workspace(Axis),
    /// Speed.
    LinearVelocity,
    /// Acceleration.
    LinearAcceleration,
    /// Jerk.
    LinearJerk,
    /// Angular speed.
    AngularVelocity,
    /// Angular acceleration.
    AngularAcceleration,
    /// Angular jerk.
    AngularJerk,
}

impl Limit {
    /// Unit of the limit's value and bound.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::Workspace(_) => "m",
            Self::LinearVelocity => "m/s",
            Self::LinearAcceleration => "m/s^2",
            Self::LinearJerk => "m/s^3",
            Self::AngularVelocity => "rad/s",
            Self::AngularAcceleration => "rad/s^2",
            Self::AngularJerk => "rad/s^3",
        }
    }
}

impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Workspace(axis) => write!(f, "{axis} position"),
            Self::LinearVelocity => f.write_str("linear velocity"),
            Self::LinearAcceleration => f.write_str("linear acceleration"),
            Self::LinearJerk => f.write_str("linear jerk"),
            Self::AngularVelocity => f.write_str("angular velocity"),
            Self::AngularAcceleration => f.write_str("angular acceleration"),
            Self::AngularJerk => f.write_str("angular jerk"),
        }
    }
}

/// Why numbers cannot be limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LimitsError {
    /// A bound is zero, negative or not finite.
    NotPositive {
        /// Which.
        limit: Limit,
        /// The number given.
        value: f64,
    },
    /// A side of the workspace box has no length.
    EmptyWorkspace {
        /// Which side.
        axis: Axis,
        /// Lower end, metres.
        min: f64,
        /// Upper end, metres.
        max: f64,
    },
    /// Quantisation noise at this period is as large as the bound.
    DrownsInNoise {
        /// Which.
        limit: Limit,
        /// The bound.
        bound: f64,
        /// The noise.
        noise: f64,
    },
}

impl fmt::Display for LimitsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::NotPositive { limit, value } => {
                write!(
                    f,
                    "the limit on {limit} is {value} {}, but it must be a positive number",
                    limit.unit()
                )
            }
            Self::EmptyWorkspace { axis, min, max } => write!(
                f,
                "the workspace runs from {min} m to {max} m along {axis}, but its lower end must lie below its upper end"
            ),
            Self::DrownsInNoise { limit, bound, noise } => write!(
                f,
                "the limit on {limit} is {bound} {unit}, but rounding to the LSB alone makes up to {noise:.3} {unit} at \
                 this control period; use a smaller LSB or a longer period",
                unit = limit.unit()
            ),
        }
    }
}

impl core::error::Error for LimitsError {}

/// The first limit that a motion breaks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Violation {
    /// Which limit.
    pub limit: Limit,
    /// Tick of the setpoint that breaks it; for a motion that does not end at rest, up to three past the last.
    pub tick: u32,
    /// The motion's value, in the limit's unit.
    pub value: f64,
    /// What it may be at most (at least, for a workspace's lower side).
    pub bound: f64,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { limit, tick, value, bound } = *self;
        let unit = limit.unit();
        write!(f, "the {limit} at tick {tick} is {value:.6} {unit}, but the limit is {bound} {unit}")
    }
}

impl core::error::Error for Violation {}

/// How much quantisation alone can add to each derivative.
#[derive(Clone, Copy, Debug, PartialEq)]
struct QuantisationNoise {
    linear: [f64; 3],
    angular: [f64; 3],
    half_lsb_m: f64,
}

impl QuantisationNoise {
    fn new(lsb: Lsb, period_us: u32) -> Self {
        let h = period_s(period_us);
        let scale = |q: f64| {
            let v = 1.01 * SQRT_3 * q / h;
            [v, 2.0 * v / h, 4.0 * v / (h * h)]
        };
        Self {
            linear: scale(lsb.translation_m()),
            angular: scale(lsb.rotation_rad()),
            half_lsb_m: 0.5 * lsb.translation_m(),
        }
    }

    fn as_array(&self) -> [f64; 6] {
        let [v, a, j] = self.linear;
        let [w, alpha, zeta] = self.angular;
        [v, a, j, w, alpha, zeta]
    }
}

/// Finite differences of a position or an orientation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Derivatives {
    /// First difference, per second.
    pub velocity: Vector3<f64>,
    /// Second difference, per second squared.
    pub acceleration: Vector3<f64>,
    /// Third difference, per second cubed.
    pub jerk: Vector3<f64>,
}

impl Derivatives {
    /// Standstill.
    #[must_use]
    pub fn zero() -> Self {
        let zero = Vector3::zeros();
        Self { velocity: zero, acceleration: zero, jerk: zero }
    }

    fn next(&self, change: &Vector3<f64>, h: f64) -> Self {
        let velocity = change / h;
        let acceleration = (velocity - self.velocity) / h;
        Self { velocity, acceleration, jerk: (acceleration - self.acceleration) / h }
    }

    fn norms(&self) -> [f64; 3] {
        [norm(&self.velocity), norm(&self.acceleration), norm(&self.jerk)]
    }
}

/// A pose with the finite differences that led to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Where the tool is.
    pub pose: Pose,
    /// Differences of the position: m/s, m/s^2, m/s^3.
    pub linear: Derivatives,
    /// Differences of the orientation: rad/s, rad/s^2, rad/s^3, world axes.
    pub angular: Derivatives,
}

impl Motion {
    /// Standstill at a pose.
    #[must_use]
    pub fn at_rest(pose: Pose) -> Self {
        Self { pose, linear: Derivatives::zero(), angular: Derivatives::zero() }
    }

    /// The motion after moving to `pose` within one control period.
    #[must_use]
    pub fn moved_to(&self, pose: Pose, period_us: u32) -> Self {
        let h = period_s(period_us);
        let change = self.pose.displacement_to(&pose);
        Self {
            pose,
            linear: self.linear.next(&change.translation(), h),
            angular: self.angular.next(&change.rotation(), h),
        }
    }

    /// |v|, |a|, |j|, then the same for rotation.
    #[must_use]
    pub fn norms(&self) -> [f64; 6] {
        let [v, a, j] = self.linear.norms();
        let [w, alpha, zeta] = self.angular.norms();
        [v, a, j, w, alpha, zeta]
    }
}

/// Largest value of each derivative so far, as a share of its limit (1 = all of it).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PeakUse {
    /// Of the speed limit.
    pub linear_velocity: f64,
    /// Of the acceleration limit.
    pub linear_acceleration: f64,
    /// Of the jerk limit.
    pub linear_jerk: f64,
    /// Of the angular speed limit.
    pub angular_velocity: f64,
    /// Of the angular acceleration limit.
    pub angular_acceleration: f64,
    /// Of the angular jerk limit.
    pub angular_jerk: f64,
}

impl PeakUse {
    fn raise(&mut self, limit: Limit, share: f64) {
        let peak = match limit {
            Limit::Workspace(_) => return,
            Limit::LinearVelocity => &mut self.linear_velocity,
            Limit::LinearAcceleration => &mut self.linear_acceleration,
            Limit::LinearJerk => &mut self.linear_jerk,
            Limit::AngularVelocity => &mut self.angular_velocity,
            Limit::AngularAcceleration => &mut self.angular_acceleration,
            Limit::AngularJerk => &mut self.angular_jerk,
        };
        *peak = libm::fmax(*peak, share);
    }
}

/// Checks successive poses, one per control period, against limits. The motion starts from rest.
#[derive(Clone, Copy, Debug)]
pub struct LimitChecker {
    limits: Limits,
    noise: QuantisationNoise,
    period_us: u32,
    tick: u32,
    motion: Motion,
    peak: PeakUse,
}

impl LimitChecker {
    /// At rest at `start`, tick 0.
    #[must_use]
    pub fn new(limits: Limits, lsb: Lsb, period_us: u32, start: Pose) -> Self {
        Self {
            limits,
            noise: QuantisationNoise::new(lsb, period_us),
            period_us,
            tick: 0,
            motion: Motion::at_rest(start),
            peak: PeakUse::default(),
        }
    }

    /// Checks the pose of the next tick and, if it keeps the limits, takes it as the new state.
    ///
    /// # Errors
    /// The first limit broken. The state is then unchanged, as is right for a setpoint that is refused.
    pub fn check(&mut self, pose: Pose) -> Result<Motion, Violation> {
        let tick = self.tick.saturating_add(1);
        let motion = self.motion.moved_to(pose, self.period_us);
        self.check_workspace(tick, &pose)?;
        self.check_derivatives(tick, &motion)?;
        for ((limit, bound), value) in self.limits.derivative_bounds().into_iter().zip(motion.norms()) {
            self.peak.raise(limit, value / bound);
        }
        self.tick = tick;
        self.motion = motion;
        Ok(motion)
    }

    /// Checks that the motion may end here: staying at the last pose must break no limit either.
    ///
    /// # Errors
    /// The limit that the sudden end breaks.
    pub fn finish(&mut self) -> Result<(), Violation> {
        for _ in 0..TICKS_TO_REST {
            self.check(self.motion.pose)?;
        }
        Ok(())
    }

    /// Goes on from a motion that others have found to keep the limits.
    pub fn resume(&mut self, tick: u32, motion: Motion) {
        self.tick = tick;
        self.motion = motion;
    }

    /// The last accepted motion.
    #[must_use]
    pub fn motion(&self) -> &Motion {
        &self.motion
    }

    /// Tick of the last accepted pose.
    #[must_use]
    pub fn tick(&self) -> u32 {
        self.tick
    }

    /// The limits in force.
    #[must_use]
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Largest use of each limit so far.
    #[must_use]
    pub fn peak_use(&self) -> PeakUse {
        self.peak
    }

    fn check_workspace(&self, tick: u32, pose: &Pose) -> Result<(), Violation> {
        let position: [f64; 3] = pose.position_m.into();
        let slack = self.noise.half_lsb_m * 1.01;
        let sides = self.limits.workspace_min_m.into_iter().zip(self.limits.workspace_max_m);
        for ((value, (min, max)), axis) in position.into_iter().zip(sides).zip(Axis::ALL) {
            // Asked as "is it inside", so that NaN fails.
            let (above_min, below_max) = (value >= min - slack, value <= max + slack);
            if !above_min {
                return Err(Violation { limit: Limit::Workspace(axis), tick, value, bound: min });
            }
            if !below_max {
                return Err(Violation { limit: Limit::Workspace(axis), tick, value, bound: max });
            }
        }
        Ok(())
    }

    fn check_derivatives(&self, tick: u32, motion: &Motion) -> Result<(), Violation> {
        let bounds = self.limits.derivative_bounds().into_iter().zip(self.noise.as_array());
        for (((limit, bound), noise), value) in bounds.zip(motion.norms()) {
            let kept = value <= bound * (1.0 + RELATIVE_ROUNDING) + noise;
            if !kept {
                return Err(Violation { limit, tick, value, bound });
            }
        }
        Ok(())
    }
}

fn period_s(period_us: u32) -> f64 {
    f64::from(period_us) / MICROSECONDS_PER_SECOND
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::displacement::{Displacement, Setpoint, pose_at};
    use proptest::prelude::*;

    const PERIOD_US: u32 = 10_000;

    fn limits() -> Limits {
        Limits {
            workspace_min_m: [-0.5; 3],
            workspace_max_m: [0.5; 3],
            linear_velocity_m_s: 0.5,
            linear_acceleration_m_s2: 2.0,
            linear_jerk_m_s3: 40.0,
            angular_velocity_rad_s: 2.0,
            angular_acceleration_rad_s2: 10.0,
            angular_jerk_rad_s3: 200.0,
        }
    }

    fn checker(limits: Limits) -> LimitChecker {
        LimitChecker::new(limits, Lsb::default(), PERIOD_US, Pose::identity())
    }

    /// Minimum-jerk share of a segment.
    fn smooth(s: f64) -> f64 {
        s * s * s * (10.0 + s * (6.0 * s - 15.0))
    }

    fn run(checker: &mut LimitChecker, steps: u32, d: impl Fn(f64) -> Displacement) -> Result<(), Violation> {
        let lsb = Lsb::default();
        for k in 1..=steps {
            let setpoint = Setpoint::from_cumulative(k, &d(f64::from(k) / f64::from(steps)), lsb).unwrap();
            checker.check(pose_at(&Pose::identity(), setpoint, lsb))?;
        }
        checker.finish()
    }

    fn along(translation: f64, rotation: f64) -> impl Fn(f64) -> Displacement {
        move |s| Displacement {
            translation_m: [smooth(s) * translation, 0.0, 0.0],
            rotation_rad: [0.0, smooth(s) * rotation, 0.0],
        }
    }

    #[test]
    fn a_minimum_jerk_move_uses_what_theory_says() {
        let mut checker = checker(limits());
        run(&mut checker, 100, along(0.2, 0.5)).unwrap();
        // Peaks of the minimum-jerk polynomial: 1.875 D/T, 5.7735 D/T^2, 60 D/T^3.
        let peak = checker.peak_use();
        assert!((peak.linear_velocity - 1.875 * 0.2 / 0.5).abs() < 1e-3, "{peak:?}");
        assert!((peak.linear_acceleration - 5.7735 * 0.2 / 2.0).abs() < 2e-3, "{peak:?}");
        assert!((peak.angular_velocity - 1.875 * 0.5 / 2.0).abs() < 1e-3, "{peak:?}");
        assert!(peak.linear_jerk > 0.2 && peak.linear_jerk < 60.0 * 0.2 / 40.0 + 0.02, "{peak:?}");
    }

    #[test]
    fn each_limit_is_found_with_its_tick_value_and_bound() {
        let fine = limits();
        let cases = [
            (Limits { workspace_max_m: [0.1, 0.5, 0.5], ..fine }, Limit::Workspace(Axis::X)),
            (Limits { linear_velocity_m_s: 0.3, ..fine }, Limit::LinearVelocity),
            (Limits { linear_acceleration_m_s2: 1.0, ..fine }, Limit::LinearAcceleration),
            (Limits { linear_jerk_m_s3: 8.0, ..fine }, Limit::LinearJerk),
            (Limits { angular_velocity_rad_s: 0.8, ..fine }, Limit::AngularVelocity),
            (Limits { angular_acceleration_rad_s2: 2.0, ..fine }, Limit::AngularAcceleration),
            (Limits { angular_jerk_rad_s3: 20.0, ..fine }, Limit::AngularJerk),
        ];
        for (limits, limit) in cases {
            let violation = run(&mut checker(limits), 100, along(0.2, 0.5)).unwrap_err();
            assert_eq!(violation.limit, limit);
            assert!(violation.value > violation.bound && violation.tick >= 1);
        }
    }

    #[test]
    fn a_motion_that_ends_moving_is_refused() {
        let mut checker = checker(limits());
        let half =
            |s: f64| Displacement { translation_m: [0.2 * smooth(s / 2.0), 0.0, 0.0], ..Default::default() };
        let violation = run(&mut checker, 50, half).unwrap_err();
        assert_eq!((violation.limit, violation.tick), (Limit::LinearAcceleration, 51));
    }

    #[test]
    fn a_refused_pose_leaves_the_state_as_it_was() {
        let mut checker = checker(limits());
        let before = *checker.motion();
        let far = Pose { position_m: Vector3::new(0.1, 0.0, 0.0), ..Pose::identity() };
        assert_eq!(checker.check(far).unwrap_err().limit, Limit::LinearVelocity);
        assert_eq!((*checker.motion(), checker.tick()), (before, 0));
        let nan = Pose { position_m: Vector3::new(f64::NAN, 0.0, 0.0), ..Pose::identity() };
        assert_eq!(checker.check(nan).unwrap_err().limit, Limit::Workspace(Axis::X));
    }

    #[test]
    fn limits_that_are_none_are_refused() {
        assert_eq!(limits().validate(), Ok(()));
        for value in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(Limits { angular_jerk_rad_s3: value, ..limits() }.validate().is_err());
            assert!(Limits { linear_velocity_m_s: value, ..limits() }.validate().is_err());
        }
        let flat = Limits { workspace_max_m: [0.5, -0.5, 0.5], ..limits() };
        assert!(matches!(flat.validate(), Err(LimitsError::EmptyWorkspace { axis: Axis::Y, .. })));
        assert_eq!(limits().check_resolution(Lsb::default(), PERIOD_US), Ok(()));
        let at_1_khz = limits().check_resolution(Lsb::default(), 1_000);
        assert!(matches!(at_1_khz, Err(LimitsError::DrownsInNoise { limit: Limit::LinearJerk, .. })));
    }

    #[test]
    fn the_share_of_the_noise_is_that_of_the_limit_it_harms_most() {
        // 4 sqrt(3) 0.1 um / (10 ms)^3 is 0.69 m/s^3, and one per cent more.
        let share = limits().noise_share(Lsb::default(), PERIOD_US);
        assert!((share - 1.01 * 0.692_82 / 40.0).abs() < 1e-6, "{share}");
        let coarse = Lsb { rotation_nrad: 1_000, ..Lsb::default() };
        assert!((limits().noise_share(coarse, PERIOD_US) / share - 2.0).abs() < 1e-9);
    }

    proptest! {
        /// The tolerance is what rounding can do and no less: any smooth motion exactly at its limits passes whatever
        /// its rounding, and worst-case rounding reaches more than half of it.
        #[test]
        fn quantisation_never_trips_a_limit(
            direction in [-1.0..1.0, -1.0..1.0, -1.0..1.0f64], turn in [-1.0..1.0, -1.0..1.0, -1.0..1.0f64], steps in 60u32..200
        ) {
            let motion = |s: f64| Displacement {
                translation_m: direction.map(|d| 0.2 * d * smooth(s)),
                rotation_rad: turn.map(|r| 1.5 * r * smooth(s)),
            };
            // The limits are the peaks of the exact motion.
            let mut exact = LimitChecker::new(loose(), Lsb { translation_nm: 1, rotation_nrad: 1 }, PERIOD_US, Pose::identity());
            for k in 1..=steps {
                exact.check(Pose::identity().displaced(&motion(f64::from(k) / f64::from(steps)))).unwrap();
            }
            exact.finish().unwrap();
            let peak = exact.peak_use();
            let tight = Limits {
                linear_velocity_m_s: peak.linear_velocity * 1e6,
                linear_acceleration_m_s2: peak.linear_acceleration * 1e6,
                linear_jerk_m_s3: peak.linear_jerk * 1e6,
                angular_velocity_rad_s: peak.angular_velocity * 1e6,
                angular_acceleration_rad_s2: peak.angular_acceleration * 1e6,
                angular_jerk_rad_s3: peak.angular_jerk * 1e6,
                ..loose()
            };
            let found = run(&mut checker(tight), steps, motion);
            prop_assert!(found.is_ok(), "{}", found.unwrap_err());
        }
    }

    fn loose() -> Limits {
        Limits {
            workspace_min_m: [-1.0; 3],
            workspace_max_m: [1.0; 3],
            linear_velocity_m_s: 1e6,
            linear_acceleration_m_s2: 1e6,
            linear_jerk_m_s3: 1e6,
            angular_velocity_rad_s: 1e6,
            angular_acceleration_rad_s2: 1e6,
            angular_jerk_rad_s3: 1e6,
        }
    }

    #[test]
    fn worst_rounding_reaches_more_than_half_the_tolerance() {
        // Alternating counts are the worst that rounding to half an LSB can do to a body at rest.
        let mut motion = Motion::at_rest(Pose::identity());
        let half = 0.5e-7;
        for k in 0..8 {
            let offset = if k % 2 == 0 { half } else { -half };
            let position_m = Vector3::new(offset, offset, offset);
            motion = motion.moved_to(Pose { position_m, ..Pose::identity() }, PERIOD_US);
        }
        let noise = QuantisationNoise::new(Lsb::default(), PERIOD_US).as_array();
        for (value, noise) in motion.norms().into_iter().zip(noise).take(3) {
            assert!(value <= noise && value > 0.98 * noise, "{value} {noise}");
        }
    }
}
