//! The 6D displacement (the control u of one step) and its exact, quantised form.
//!
//! | symbol | identifier        | meaning                                                                    |
//! |--------|-------------------|----------------------------------------------------------------------------|
//! | u_k    | [`Displacement`]  | (dp_k, dr_k) in world axes; takes (p, R) to (p + dp_k, exp(dr_k) R)        |
//! | X0     | anchor            | pose when operation was enabled                                            |
//! | T_k    | translation       | dp_1 + ... + dp_k                                                          |
//! | R_k    | rotation          | log(exp(dr_k) ... exp(dr_1)), norm below pi                                |
//! | c_k    | `counts`          | (T_k, R_k) in units of the [`Lsb`], rounded to whole numbers               |
//! | s_k    | [`StepCounts`]    | c_k - c_{k-1}, what a plan stores                                          |
//!
//! Rounding the cumulative value, never the step, keeps the error of every setpoint at half an LSB: it cannot drift.
//! [`pose_at`] and [`displacement_between`] are the only way back; optimiser and arm both use them, so what was
//! simulated is what is performed, bit for bit.

use core::cmp::Ordering;
use core::f64::consts::PI;
use core::fmt;

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

pub use crate::pose::Displacement;
use crate::pose::{Pose, exp_so3, log_so3, norm, renormalised};

/// Largest LSB that is accepted: 1 mm, 1 mrad.
pub const LSB_MAX: u32 = 1_000_000;

const NANO_PER_UNIT: f64 = 1e9;

/// Three such components make a rotation vector of less than pi: 3.12 rad.
const LITTLE_NRAD: u64 = 1_800_000_000;

/// One of the six numbers of a displacement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Translation along x.
    X,
    /// Translation along y.
    Y,
    /// Translation along z.
    Z,
    /// Rotation vector, x.
    Rx,
    /// Rotation vector, y.
    Ry,
    /// Rotation vector, z.
    Rz,
}

impl Axis {
    /// In the order of counts and components.
    pub const ALL: [Self; 6] = [Self::X, Self::Y, Self::Z, Self::Rx, Self::Ry, Self::Rz];
}

impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
            Self::Rx => "rx",
            Self::Ry => "ry",
            Self::Rz => "rz",
        })
    }
}

/// What one count is worth. Whole nanometres and nanoradians, so that it is exact.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lsb {
    /// Translation per count, nanometres.
    pub translation_nm: u32,
    /// Rotation per count, nanoradians.
    pub rotation_nrad: u32,
}

impl Default for Lsb {
    /// 0.1 micrometre and 0.1 microradian.
    fn default() -> Self {
        Self { translation_nm: 100, rotation_nrad: 100 }
    }
}

impl Lsb {
    /// Translation per count, metres.
    #[must_use]
    pub fn translation_m(self) -> f64 {
        f64::from(self.translation_nm) / NANO_PER_UNIT
    }

    /// Rotation per count, radians.
    #[must_use]
    pub fn rotation_rad(self) -> f64 {
        f64::from(self.rotation_nrad) / NANO_PER_UNIT
    }

    /// Whether both sizes lie in 1..=[`LSB_MAX`].
    #[must_use]
    pub fn is_valid(self) -> bool {
        (1..=LSB_MAX).contains(&self.translation_nm) && (1..=LSB_MAX).contains(&self.rotation_nrad)
    }

    /// What a count along an axis is worth, metres or radians.
    #[must_use]
    pub fn of(self, axis: Axis) -> f64 {
        f64::from(self.nano_of(axis)) / NANO_PER_UNIT
    }

    fn nano_of(self, axis: Axis) -> u32 {
        match axis {
            Axis::X | Axis::Y | Axis::Z => self.translation_nm,
            Axis::Rx | Axis::Ry | Axis::Rz => self.rotation_nrad,
        }
    }
}

/// Difference of the counts of two successive setpoints.
pub type StepCounts = [i32; 6];

/// Cumulative displacement from the anchor at one tick, in LSB.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Setpoint {
    /// Control period at whose end the displacement is reached; 0 is the anchor itself.
    pub tick: u32,
    /// T_k (x, y, z) and R_k (rx, ry, rz) in LSB.
    pub counts: [i32; 6],
}

impl Setpoint {
    /// The anchor: tick 0, no displacement.
    pub const ANCHOR: Self = Self { tick: 0, counts: [0; 6] };

    /// Rounds a cumulative displacement from the anchor to the nearest counts.
    ///
    /// # Errors
    /// A component that is not finite or does not fit its counter, or a rotation of pi or more.
    pub fn from_cumulative(tick: u32, cumulative: &Displacement, lsb: Lsb) -> Result<Self, SetpointError> {
        let mut counts = [0; 6];
        let values = cumulative.components();
        for ((count, value), axis) in counts.iter_mut().zip(values).zip(Axis::ALL) {
            *count = round_to_counts(tick, axis, value, lsb)?;
        }
        let setpoint = Self { tick, counts };
        setpoint.validate(lsb)?;
        Ok(setpoint)
    }

    /// The next setpoint, one tick later.
    ///
    /// # Errors
    /// A counter or the tick overflows; the rotation reaches pi or jumps across it.
    pub fn stepped(self, step: StepCounts, lsb: Lsb) -> Result<Self, SetpointError> {
        let tick = self.tick.checked_add(1).ok_or(SetpointError::TickOverflow)?;
        let mut counts = [0; 6];
        for (((count, old), step), axis) in counts.iter_mut().zip(self.counts).zip(step).zip(Axis::ALL) {
            *count = old.checked_add(step).ok_or(SetpointError::OutOfRange {
                tick,
                axis,
                value: f64::from(old) + f64::from(step),
            })?;
        }
        let next = Self { tick, counts };
        next.validate(lsb)?;
        next.check_continuity(self, lsb)?;
        Ok(next)
    }

    /// The counts to add to `previous` to arrive here.
    ///
    /// # Errors
    /// A difference that does not fit its counter, or a rotation that jumps across pi.
    pub fn step_from(self, previous: Self, lsb: Lsb) -> Result<StepCounts, SetpointError> {
        let mut step = [0; 6];
        for (((step, new), old), axis) in step.iter_mut().zip(self.counts).zip(previous.counts).zip(Axis::ALL)
        {
            *step = new.checked_sub(old).ok_or(SetpointError::OutOfRange {
                tick: self.tick,
                axis,
                value: f64::from(new) - f64::from(old),
            })?;
        }
        self.check_continuity(previous, lsb)?;
        Ok(step)
    }

    /// The same displacement in counts of another LSB, rounded to the nearest, halves to the even one.
    ///
    /// # Errors
    /// A counter overflows, or rounding takes the rotation to pi.
    pub fn rescaled(self, from: Lsb, to: Lsb) -> Result<Self, SetpointError> {
        if from == to {
            return Ok(self);
        }
        let mut counts = [0; 6];
        for ((count, old), axis) in counts.iter_mut().zip(self.counts).zip(Axis::ALL) {
            let nano = i64::from(old).saturating_mul(i64::from(from.nano_of(axis)));
            let rounded = divided_to_nearest(nano, i64::from(to.nano_of(axis)));
            *count = rounded.and_then(|rounded| i32::try_from(rounded).ok()).ok_or({
                #[expect(clippy::cast_precision_loss, reason = "for a message")]
                let value = nano as f64 / f64::from(to.nano_of(axis));
                SetpointError::OutOfRange { tick: self.tick, axis, value }
            })?;
        }
        let setpoint = Self { tick: self.tick, counts };
        setpoint.validate(to)?;
        Ok(setpoint)
    }

    /// Cumulative displacement (T_k, R_k) from the anchor.
    #[must_use]
    pub fn cumulative(self, lsb: Lsb) -> Displacement {
        let [x, y, z, rx, ry, rz] = self.counts;
        let length = |count: i32| nano_value(i64::from(count), lsb.translation_nm);
        let angle = |count: i32| nano_value(i64::from(count), lsb.rotation_nrad);
        Displacement {
            translation_m: [length(x), length(y), length(z)],
            rotation_rad: [angle(rx), angle(ry), angle(rz)],
        }
    }

    /// Checks that the rotation from the anchor is below pi.
    ///
    /// # Errors
    /// It is not.
    pub fn validate(self, lsb: Lsb) -> Result<(), SetpointError> {
        if self.turns_little_from(Self::ANCHOR, lsb) {
            return Ok(());
        }
        let angle_rad = norm(&self.cumulative(lsb).rotation());
        if angle_rad < PI {
            Ok(())
        } else {
            Err(SetpointError::RotationTooLarge { tick: self.tick, angle_rad })
        }
    }

    /// Whether no component of R differs by more than 1.8 rad, so that the norm of the difference is below pi for certain: told in
    /// whole numbers, which a microcontroller is quick with.
    fn turns_little_from(self, other: Self, lsb: Lsb) -> bool {
        let [_, _, _, new @ ..] = self.counts;
        let [_, _, _, old @ ..] = other.counts;
        new.into_iter().zip(old).all(|(new, old): (i32, i32)| {
            u64::from(new.abs_diff(old)).saturating_mul(u64::from(lsb.rotation_nrad)) <= LITTLE_NRAD
        })
    }

    /// A rotation that passes through pi reappears with the opposite sign. Setpoints in between, and with them
    /// interpolation, would be wrong, so such a step is refused: R moves by less than 1.6 times the step's own angle,
    /// hence a move of pi or more is a jump and not a motion.
    fn check_continuity(self, previous: Self, lsb: Lsb) -> Result<(), SetpointError> {
        if self.turns_little_from(previous, lsb) {
            return Ok(());
        }
        let change = self.cumulative(lsb).rotation() - previous.cumulative(lsb).rotation();
        if norm(&change) < PI { Ok(()) } else { Err(SetpointError::RotationJump { tick: self.tick }) }
    }
}

/// Pose of a setpoint: (p0 + T_k, exp(R_k) R0).
#[must_use]
pub fn pose_at(anchor: &Pose, setpoint: Setpoint, lsb: Lsb) -> Pose {
    anchor.displaced(&setpoint.cumulative(lsb))
}

/// The 6D displacement from one setpoint to the next: dp = T_k - T_{k-1}, dr = log(exp(R_k) exp(R_{k-1})^-1).
#[must_use]
pub fn displacement_between(previous: Setpoint, next: Setpoint, lsb: Lsb) -> Displacement {
    let mut translation_m = [0.0; 3];
    for ((value, new), old) in translation_m.iter_mut().zip(next.counts).zip(previous.counts) {
        // The difference of counts is exact, the difference of the two lengths would not be.
        *value = nano_value(i64::from(new).saturating_sub(i64::from(old)), lsb.translation_nm);
    }
    let before = exp_so3(&previous.cumulative(lsb).rotation());
    let after = exp_so3(&next.cumulative(lsb).rotation());
    Displacement { translation_m, rotation_rad: log_so3(&(after * before.inverse())).into() }
}

/// Turns exact displacements, one step at a time, into setpoints and step counts.
#[derive(Clone, Debug)]
pub struct Quantiser {
    lsb: Lsb,
    translation_m: Vector3<f64>,
    /// Low part of the sum (Neumaier), so that a long plan does not lose what a single step adds.
    translation_low_m: Vector3<f64>,
    rotation: UnitQuaternion<f64>,
    last: Setpoint,
}

impl Quantiser {
    /// Starts at the anchor.
    #[must_use]
    pub fn new(lsb: Lsb) -> Self {
        Self {
            lsb,
            translation_m: Vector3::zeros(),
            translation_low_m: Vector3::zeros(),
            rotation: UnitQuaternion::identity(),
            last: Setpoint::ANCHOR,
        }
    }

    /// Adds one step. The new setpoint is within half an LSB of the exact cumulative displacement on each axis.
    ///
    /// # Errors
    /// A component that is not finite or does not fit its counter, or a rotation that reaches pi. The quantiser is
    /// then unchanged.
    pub fn push(&mut self, step: &Displacement) -> Result<(Setpoint, StepCounts), SetpointError> {
        let tick = self.last.tick.checked_add(1).ok_or(SetpointError::TickOverflow)?;
        let (translation_m, translation_low_m) =
            compensated_sum(&self.translation_m, &self.translation_low_m, &step.translation());
        let rotation = renormalised(exp_so3(&step.rotation()) * self.rotation);
        let cumulative = Displacement {
            translation_m: (translation_m + translation_low_m).into(),
            rotation_rad: log_so3(&rotation).into(),
        };
        let setpoint = Setpoint::from_cumulative(tick, &cumulative, self.lsb)?;
        let counts = setpoint.step_from(self.last, self.lsb)?;
        *self = Self { lsb: self.lsb, translation_m, translation_low_m, rotation, last: setpoint };
        Ok((setpoint, counts))
    }

    /// The last setpoint.
    #[must_use]
    pub fn setpoint(&self) -> Setpoint {
        self.last
    }
}

/// Quantises a whole stream of displacements; stops at the first error.
pub fn quantise<I>(displacements: I, lsb: Lsb) -> impl Iterator<Item = Result<StepCounts, SetpointError>>
where
    I: IntoIterator<Item = Displacement>,
{
    let mut quantiser = Quantiser::new(lsb);
    displacements.into_iter().map(move |step| quantiser.push(&step).map(|(_, counts)| counts))
}

/// Why a displacement cannot be a setpoint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SetpointError {
    /// A component is NaN or infinite.
    NotFinite {
        /// Tick of the setpoint.
        tick: u32,
        /// Component.
        axis: Axis,
    },
    /// A component does not fit a signed 32-bit counter.
    OutOfRange {
        /// Tick of the setpoint.
        tick: u32,
        /// Component.
        axis: Axis,
        /// The component in LSB.
        value: f64,
    },
    /// The cumulative rotation is pi or more.
    RotationTooLarge {
        /// Tick of the setpoint.
        tick: u32,
        /// Norm of the rotation vector, radians.
        angle_rad: f64,
    },
    /// The cumulative rotation passes through pi between two ticks.
    RotationJump {
        /// Tick of the setpoint.
        tick: u32,
    },
    /// More ticks than a 32-bit counter holds.
    TickOverflow,
}

impl fmt::Display for SetpointError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::NotFinite { tick, axis } => {
                write!(f, "the {axis} displacement at tick {tick} is not a finite number")
            }
            Self::OutOfRange { tick, axis, value } => write!(
                f,
                "the {axis} displacement at tick {tick} is {value} counts, but a counter holds at most {} either way",
                i32::MAX
            ),
            Self::RotationTooLarge { tick, angle_rad } => write!(
                f,
                "the rotation from the anchor at tick {tick} is {angle_rad} rad, but it must stay below pi"
            ),
            Self::RotationJump { tick } => write!(
                f,
                "the rotation from the anchor passes through pi at tick {tick}, but it must stay below pi"
            ),
            Self::TickOverflow => write!(f, "the plan has more than {} ticks", u32::MAX),
        }
    }
}

impl core::error::Error for SetpointError {}

/// `count * nano` billionths, correctly rounded as long as the product is below 2^53.
#[expect(
    clippy::cast_precision_loss,
    reason = "2^53 nm is 9,000 km; beyond that the last bit does not matter"
)]
fn nano_value(count: i64, nano: u32) -> f64 {
    count.saturating_mul(i64::from(nano)) as f64 / NANO_PER_UNIT
}

fn round_to_counts(tick: u32, axis: Axis, value: f64, lsb: Lsb) -> Result<i32, SetpointError> {
    if !value.is_finite() {
        return Err(SetpointError::NotFinite { tick, axis });
    }
    let counts = libm::rint(value * NANO_PER_UNIT / f64::from(lsb.nano_of(axis)));
    if libm::fabs(counts) > f64::from(i32::MAX) {
        return Err(SetpointError::OutOfRange { tick, axis, value: counts });
    }
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a whole number within the counter's range, checked above"
    )]
    let counts = counts as i32;
    Ok(counts)
}

/// Neumaier's sum: adds `term` to `high + low`, the rounding error going to `low`.
/// Halves go to the even number; `None` for a divisor that is not positive.
fn divided_to_nearest(value: i64, divisor: i64) -> Option<i64> {
    if divisor <= 0 {
        return None;
    }
    let (floor, rest) = (value.checked_div_euclid(divisor)?, value.checked_rem_euclid(divisor)?);
    let up = match rest.saturating_mul(2).cmp(&divisor) {
        Ordering::Less => false,
        Ordering::Greater => true,
        Ordering::Equal => floor & 1 == 1,
    };
    floor.checked_add(i64::from(up))
}

fn compensated_sum(
    high: &Vector3<f64>,
    low: &Vector3<f64>,
    term: &Vector3<f64>,
) -> (Vector3<f64>, Vector3<f64>) {
    let sum = high + term;
    let lost = high.zip_zip_map(term, &sum, |high, term, sum| {
        if libm::fabs(high) >= libm::fabs(term) { (high - sum) + term } else { (term - sum) + high }
    });
    (sum, low + lost)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn displacement(translation: f64, rotation: f64) -> impl Strategy<Value = Displacement> {
        let t = -translation..translation;
        let r = -rotation..rotation;
        ([t.clone(), t.clone(), t], [r.clone(), r.clone(), r])
            .prop_map(|(translation_m, rotation_rad)| Displacement { translation_m, rotation_rad })
    }

    #[test]
    fn default_lsb_is_a_tenth_of_a_micrometre_and_microradian() {
        assert_eq!(Lsb::default().translation_m().to_bits(), 1e-7_f64.to_bits());
        assert_eq!(Lsb::default().rotation_rad().to_bits(), 1e-7_f64.to_bits());
    }

    #[test]
    fn a_third_of_a_count_each_step_never_drifts() {
        let mut quantiser = Quantiser::new(Lsb::default());
        let step = Displacement { translation_m: [1e-7 / 3.0, 0.0, 0.0], ..Displacement::default() };
        for _ in 0..30_000 {
            quantiser.push(&step).unwrap();
        }
        assert_eq!(quantiser.setpoint(), Setpoint { tick: 30_000, counts: [10_000, 0, 0, 0, 0, 0] });
    }

    #[test]
    fn counts_of_another_lsb_are_the_nearest() {
        let (fine, coarse) = (Lsb::default(), Lsb { translation_nm: 1_000, rotation_nrad: 10_000 });
        let setpoint = Setpoint { tick: 9, counts: [15, 25, -25, 149, -150, -151] };
        let found = setpoint.rescaled(fine, coarse).unwrap();
        assert_eq!(found, Setpoint { tick: 9, counts: [2, 2, -2, 1, -2, -2] });
        assert_eq!(setpoint.rescaled(fine, fine), Ok(setpoint));
        assert_eq!(found.rescaled(coarse, fine).unwrap().counts, [20, 20, -20, 100, -200, -200]);
        let far = Setpoint { tick: 9, counts: [i32::MAX, 0, 0, 0, 0, 0] };
        assert!(matches!(far.rescaled(coarse, fine), Err(SetpointError::OutOfRange { axis: Axis::X, .. })));
    }

    #[test]
    fn rotation_through_pi_is_refused() {
        let mut quantiser = Quantiser::new(Lsb::default());
        let step = Displacement { rotation_rad: [0.0, 0.1, 0.0], ..Displacement::default() };
        for _ in 0..31 {
            quantiser.push(&step).unwrap();
        }
        assert_eq!(quantiser.push(&step), Err(SetpointError::RotationJump { tick: 32 }));
        assert_eq!(quantiser.setpoint().tick, 31);
    }

    #[test]
    fn a_value_that_is_no_number_or_too_large_is_refused() {
        let mut quantiser = Quantiser::new(Lsb::default());
        let nan = Displacement { translation_m: [0.0, f64::NAN, 0.0], ..Displacement::default() };
        assert_eq!(quantiser.push(&nan), Err(SetpointError::NotFinite { tick: 1, axis: Axis::Y }));
        let far = Displacement { translation_m: [0.0, 0.0, 300.0], ..Displacement::default() };
        assert!(matches!(quantiser.push(&far), Err(SetpointError::OutOfRange { axis: Axis::Z, .. })));
        let bad = Displacement { rotation_rad: [f64::INFINITY, 0.0, 0.0], ..Displacement::default() };
        assert!(quantiser.push(&bad).is_err());
    }

    #[test]
    fn counters_are_checked_against_hostile_steps() {
        let lsb = Lsb::default();
        let near_end = Setpoint { tick: 1, counts: [i32::MAX, 0, 0, 0, 0, 0] };
        assert!(matches!(near_end.stepped([1, 0, 0, 0, 0, 0], lsb), Err(SetpointError::OutOfRange { .. })));
        let last = Setpoint { tick: u32::MAX, counts: [0; 6] };
        assert_eq!(last.stepped([0; 6], lsb), Err(SetpointError::TickOverflow));
        let turned = Setpoint::ANCHOR.stepped([0, 0, 0, i32::MAX, 0, 0], lsb);
        assert!(matches!(turned, Err(SetpointError::RotationTooLarge { .. })));
        let step = near_end.step_from(Setpoint { tick: 0, counts: [i32::MIN, 0, 0, 0, 0, 0] }, lsb);
        assert!(matches!(step, Err(SetpointError::OutOfRange { .. })));
    }

    proptest! {
        #[test]
        fn setpoints_stay_within_half_an_lsb(steps in prop::collection::vec(displacement(1e-3, 3e-3), 1..400)) {
            let lsb = Lsb::default();
            let mut quantiser = Quantiser::new(lsb);
            let mut translation = Vector3::zeros();
            let mut rotation = UnitQuaternion::identity();
            for step in steps {
                translation += step.translation();
                rotation = exp_so3(&step.rotation()) * rotation;
                let (setpoint, _) = quantiser.push(&step).unwrap();
                let found = setpoint.cumulative(lsb);
                let half = 0.5 * (1.0 + 1e-6) * 1e-7;
                prop_assert!((found.translation() - translation).amax() <= half);
                prop_assert!((found.rotation() - log_so3(&rotation)).amax() <= half);
            }
        }

        #[test]
        fn step_counts_rebuild_every_setpoint(steps in prop::collection::vec(displacement(1e-3, 3e-3), 1..100)) {
            let lsb = Lsb::default();
            let mut quantiser = Quantiser::new(lsb);
            let mut rebuilt = Setpoint::ANCHOR;
            let counts: Vec<_> = quantise(steps.iter().copied(), lsb).map(Result::unwrap).collect();
            for (step, counts) in steps.iter().zip(counts) {
                let (setpoint, same) = quantiser.push(step).unwrap();
                prop_assert_eq!(same, counts);
                rebuilt = rebuilt.stepped(counts, lsb).unwrap();
                prop_assert_eq!(rebuilt, setpoint);
            }
        }

        #[test]
        fn displacement_to_undoes_displaced(start in displacement(2.0, 1.7), u in displacement(1.0, 1.7)) {
            let start = Pose::identity().displaced(&start);
            let found = start.displacement_to(&start.displaced(&u));
            prop_assert!(norm(&(found.translation() - u.translation())) < 1e-15);
            prop_assert!(norm(&(found.rotation() - u.rotation())) < 1e-13);
        }

        #[test]
        fn displacements_between_setpoints_lead_to_the_pose(steps in prop::collection::vec(displacement(1e-2, 2e-2), 1..60)) {
            let lsb = Lsb::default();
            let anchor = Pose { position_m: Vector3::new(0.3, 0.2, 0.1), orientation: exp_so3(&Vector3::new(0.4, -1.0, 2.0)) };
            let mut quantiser = Quantiser::new(lsb);
            let (mut walked, mut last) = (anchor, Setpoint::ANCHOR);
            for step in &steps {
                let (setpoint, _) = quantiser.push(step).unwrap();
                walked = walked.displaced(&displacement_between(last, setpoint, lsb));
                last = setpoint;
            }
            let error = walked.displacement_to(&pose_at(&anchor, last, lsb));
            prop_assert!(norm(&error.translation()) < 1e-13 && norm(&error.rotation()) < 1e-12);
        }
    }
}
