//! How long a segment lasts: long enough for its mean speed, and for the arm's limits to hold by construction.
//!
//! A minimum-jerk segment of travel D and duration T has the peaks (see `profile`)
//!
//! ```text
//! |v| <= 15/8 D/T      |a| <= 10/sqrt(3) D/T^2      |j| <= 60 D/T^3
//! ```
//!
//! so it keeps within the limits v_max, a_max, j_max, at a mean speed of at most v, exactly when
//!
//! ```text
//! T >= max( D/v, 15/8 D/v_max, sqrt(10/sqrt(3) D/a_max), cbrt(60 D/j_max) )
//! ```
//!
//! At a fixed mean speed, a short segment would break the last two: v^2/D grows without bound as D goes to 0.
//!
//! That the arm's limits hold on the *control sequence* follows: the pose is twice continuously differentiable in
//! time (s' and s'' vanish at both ends of every segment), so first, second and third differences of the sampled
//! pose, divided by the control period's first, second and third power, are weighted means (B-spline kernels) of
//! its derivatives, and a mean never exceeds the largest value. Quantisation adds at most half an LSB to each
//! component of each setpoint, which the checker in `shared` allows for.
//!
//! Under `continuous` timing T must be smooth in the skill, so the maximum is replaced by the norm of order 16,
//! which is never below it and, with n terms, exceeds it by at most n^(1/16): 4.4 % where a scoop's sweep and
//! rotation take equally long, next to nothing where one term leads. In the two roots D is replaced by
//! `sqrt(D^2 + D_0^2)`, D_0 being the travel of one control period, because their slope at D = 0 is infinite.
//! Where the transport begins before the lift ends, two such segments move the tool at once, at right angles. With any durations and
//! any overlap the root of the sum of both squares is at most 1.0051 times the peak of the velocity, and sqrt(2) times those of
//! acceleration and jerk, so each has so much less of the limits ([`Pace::of_two_at_once`]).
//!
//! With `constant_speed` only D/v counts; its accelerations are jumps, which no duration brings within a limit.

use super::{profile::MINIMUM_JERK, real::SkillScalar};
use crate::scene::{Limits, Profile};
use std::f64::consts::FRAC_1_SQRT_2;

/// Limits that a segment's durations are made for: of translation (metres) or of rotation (radians).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Caps {
    pub(super) velocity: f64,
    pub(super) acceleration: f64,
    pub(super) jerk: f64,
}

impl Caps {
    /// A share of an arm's limits of translation.
    pub(super) fn linear(limits: &Limits, share: f64) -> Self {
        Self {
            velocity: share * limits.linear_velocity_m_s,
            acceleration: share * limits.linear_acceleration_m_s2,
            jerk: share * limits.linear_jerk_m_s3,
        }
    }

    /// A share of an arm's limits of rotation.
    pub(super) fn angular(limits: &Limits, share: f64) -> Self {
        Self {
            velocity: share * limits.angular_velocity_rad_s,
            acceleration: share * limits.angular_acceleration_rad_s2,
            jerk: share * limits.angular_jerk_rad_s3,
        }
    }
}

/// What a duration depends on besides the travel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pace {
    /// Mean speed, per second.
    pub(super) speed: f64,
    pub(super) caps: Caps,
    /// Travel of one control period at the mean speed.
    pub(super) floor: f64,
}

/// Velocity of two minimum-jerk segments at right angles, over the larger one's peak, at most; a little above what a test finds.
const TWO_VELOCITIES: f64 = 1.006;

impl Pace {
    /// For a segment that moves the tool at once with another one, at right angles.
    pub(super) fn of_two_at_once(self) -> Self {
        let Caps { velocity, acceleration, jerk } = self.caps;
        let caps = Caps {
            velocity: velocity / TWO_VELOCITIES,
            acceleration: acceleration * FRAC_1_SQRT_2,
            jerk: jerk * FRAC_1_SQRT_2,
        };
        Self { caps, ..self }
    }
}

/// A travel together with its pace.
#[derive(Clone, Copy)]
pub(super) struct Leg<S> {
    pub(super) travel: S,
    pub(super) pace: Pace,
}

impl<S: SkillScalar> Leg<S> {
    fn by_speed(&self) -> S {
        self.travel / S::constant(self.pace.speed)
    }

    /// Shortest durations that the velocity, acceleration and jerk limits allow.
    fn by_limits(&self) -> [S; 3] {
        let caps = self.pace.caps;
        let floor = S::constant(self.pace.floor);
        let travel = (self.travel * self.travel + floor * floor).sqrt();
        [
            self.travel * S::constant(MINIMUM_JERK.velocity / caps.velocity),
            (travel * S::constant(MINIMUM_JERK.acceleration / caps.acceleration)).sqrt(),
            (travel * S::constant(MINIMUM_JERK.jerk / caps.jerk)).cbrt(),
        ]
    }
}

/// Smooth duration of a segment whose legs are travelled at the same time, seconds.
pub(super) fn continuous_s<S: SkillScalar>(profile: Profile, legs: &[Leg<S>]) -> S {
    let mut norm = Norm16::default();
    for leg in legs {
        norm.push(leg.by_speed());
        if profile == Profile::MinimumJerk {
            leg.by_limits().into_iter().for_each(|term| norm.push(term));
        }
    }
    norm.finish()
}

/// Control steps of a segment under `rounded` timing: the paper's `round(D / (v dt))`, at least one, and for
/// minimum jerk at least as many as the limits need.
pub(super) fn rounded_steps<S: SkillScalar>(profile: Profile, legs: &[Leg<S>], period_s: f64) -> u64 {
    let longest =
        |durations: &mut dyn Iterator<Item = S>| durations.map(|t| t.value().abs()).fold(0.0, f64::max);
    let by_speed = libm::round(longest(&mut legs.iter().map(Leg::by_speed)) / period_s);
    let by_limits = match profile {
        Profile::ConstantSpeed => 0.0,
        Profile::MinimumJerk => libm::ceil(longest(&mut legs.iter().flat_map(Leg::by_limits)) / period_s),
    };
    by_speed.max(by_limits).max(1.0) as u64
}

/// Control steps of a way (metres) and a turn (radians) that are made at the same time in minimum jerk, within a share of the limits.
pub(crate) fn rest_to_rest_steps(
    way_m: f64,
    turn_rad: f64,
    limits: &Limits,
    share: f64,
    period_s: f64,
) -> u64 {
    let leg = |travel, caps| Leg { travel, pace: Pace { speed: f64::INFINITY, caps, floor: 0.0 } };
    let legs = [leg(way_m, Caps::linear(limits, share)), leg(turn_rad, Caps::angular(limits, share))];
    rounded_steps(Profile::MinimumJerk, &legs, period_s)
}

/// The norm of order 16 of at most eight terms: an upper bound of their largest magnitude, smooth in each of them
/// (also through zero, the order being even).
struct Norm16<S> {
    terms: [Option<S>; 8],
    len: usize,
}

impl<S: Copy> Default for Norm16<S> {
    fn default() -> Self {
        Self { terms: [None; 8], len: 0 }
    }
}

impl<S: SkillScalar> Norm16<S> {
    fn push(&mut self, term: S) {
        self.terms[self.len] = Some(term);
        self.len += 1;
    }

    /// Scaled by the largest term, so that powers neither overflow nor vanish; the scale cancels.
    fn finish(self) -> S {
        let terms = || self.terms.iter().flatten().copied();
        let scale = terms().map(|term| term.value().abs()).fold(0.0, f64::max);
        if scale <= 0.0 {
            return S::constant(0.0);
        }
        let power = |x: S| {
            let x2 = x * x;
            let x4 = x2 * x2;
            let x8 = x4 * x4;
            x8 * x8
        };
        let sum = terms().fold(S::constant(0.0), |sum, term| sum + power(term / S::constant(scale)));
        sum.sqrt().sqrt().sqrt().sqrt() * S::constant(scale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PACE: Pace =
        Pace { speed: 0.1, caps: Caps { velocity: 0.25, acceleration: 2.0, jerk: 40.0 }, floor: 0.001 };

    fn norm(terms: &[f64]) -> f64 {
        let mut norm = Norm16::default();
        terms.iter().for_each(|&term| norm.push(term));
        norm.finish()
    }

    #[test]
    fn norm_of_one_term_is_its_magnitude() {
        assert!((norm(&[0.4]) - 0.4).abs() < 1e-16);
        assert!((norm(&[-0.4]) - 0.4).abs() < 1e-16);
        assert_eq!(norm(&[0.0]).to_bits(), 0.0f64.to_bits());
    }

    proptest! {
        #[test]
        fn norm_lies_between_the_maximum_and_its_stated_excess(terms in prop::collection::vec(1e-9..10.0f64, 1..8)) {
            let largest = terms.iter().copied().fold(0.0, f64::max);
            let bound = largest * (terms.len() as f64).powf(1.0 / 16.0);
            let norm = norm(&terms);
            prop_assert!(norm >= largest * (1.0 - 1e-15) && norm <= bound * (1.0 + 1e-15));
        }

        #[test]
        fn durations_keep_the_peaks_within_the_caps(travel in -0.4..0.4f64) {
            let leg = Leg { travel, pace: PACE };
            let steps = rounded_steps(Profile::MinimumJerk, &[leg], 0.01);
            for duration in [continuous_s(Profile::MinimumJerk, &[leg]), steps as f64 * 0.01] {
                let travel = travel.abs();
                let slack = 1.0 + 1e-12;
                prop_assert!(MINIMUM_JERK.velocity * travel / duration <= PACE.caps.velocity * slack);
                prop_assert!(MINIMUM_JERK.acceleration * travel / duration.powi(2) <= PACE.caps.acceleration * slack);
                prop_assert!(MINIMUM_JERK.jerk * travel / duration.powi(3) <= PACE.caps.jerk * slack);
            }
        }
    }

    /// Any two durations, any overlap: at most what the limits are divided by, and hardly less.
    #[test]
    fn two_segments_at_right_angles_share_the_limits() {
        let velocity = |r: f64| 30.0 * r * r * (1.0 - r) * (1.0 - r);
        let acceleration = |r: f64| 60.0 * r * (1.0 - r) * (1.0 - 2.0 * r);
        let jerk = |r: f64| 60.0 * (1.0 - 6.0 * r + 6.0 * r * r);
        let largest = |of: &dyn Fn(f64) -> f64, peak: f64| {
            let (first, overlap) =
                ((1..60).map(|k| f64::from(k) / 60.0), (1..=10).map(|k| f64::from(k) / 10.0));
            let cases = first.flat_map(|first| overlap.clone().map(move |overlap| (first, overlap)));
            let at = |(first, overlap): (f64, f64), share: f64| {
                let (second, early) = (1.0 - first, overlap * first * (1.0 - first));
                libm::hypot(of(1.0 + (share - 1.0) * early / first), of(share * early / second)) / peak
            };
            let shares = (0..=100).map(|k| f64::from(k) / 100.0);
            cases.flat_map(|case| shares.clone().map(move |share| at(case, share))).fold(0.0, f64::max)
        };
        let (one, two) = (PACE.caps, PACE.of_two_at_once().caps);
        let both = [
            (largest(&velocity, MINIMUM_JERK.velocity), one.velocity / two.velocity),
            (largest(&acceleration, MINIMUM_JERK.acceleration), one.acceleration / two.acceleration),
            (largest(&jerk, MINIMUM_JERK.jerk), one.jerk / two.jerk),
        ];
        for (found, bound) in both {
            assert!(found <= bound && found > 0.99 * bound, "{found} of {bound}");
        }
    }

    #[test]
    fn constant_speed_takes_travel_over_speed() {
        let leg = Leg { travel: 0.0314, pace: PACE };
        assert!((continuous_s(Profile::ConstantSpeed, &[leg]) - 0.314).abs() < 1e-15);
        assert_eq!(rounded_steps(Profile::ConstantSpeed, &[leg], 0.01), 31);
        assert_eq!(rounded_steps(Profile::ConstantSpeed, &[Leg { travel: 0.0, pace: PACE }], 0.01), 1);
    }
}
