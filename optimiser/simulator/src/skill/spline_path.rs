//! Any motion near a skill's: what is added to it are cubic B-splines in time.
//!
//! | symbol | meaning |
//! |---|---|
//! | T | when the skill's last segment ends |
//! | n | knots: coefficients for each freedom |
//! | h | T / (n + 2), from knot to knot |
//! | B | the cubic B-spline, which reaches from -2 to 2 |
//! | s | a unit of a coefficient: [`UNIT_ANGLE_RAD`], and as far as turning by that moves the far end of the tool's body |
//!
//! ```text
//! added(t) = s sum_k c_k b_k(t),   b_k(t) = B(t/h - 2 - k),   the last one B(t/h - 1 - n) + B(t/h - 2 - n) + ...
//! ```
//!
//! So what is added begins at rest with nothing, ends at rest at T with s c_n, and is twice continuously differentiable in
//! between, as the skill is. A control is the skill's, plus what the splines change by in its period, component by component: linear in
//! the coefficients, whatever the freedoms are, so that the derivative is the same everywhere.

use super::{Control, DisplacementGradient, SkillError, SkillMap, Theta};
use powderline_shared::{displacement::Displacement, limits::Limits};
use serde::{Deserialize, Serialize};

/// Knots that a path has if nothing else is said.
pub const USUAL_KNOTS: u32 = 12;

/// Unit of coefficients that turn the tool, radians.
pub const UNIT_ANGLE_RAD: f64 = 0.15;

/// A way in which the tool may leave the skill's motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Freedom {
    /// Along the heading.
    Forward,
    /// Up.
    Up,
    /// About the horizontal axis across the heading.
    Pitch,
    /// Along that axis.
    Sideways,
    /// About the heading.
    Roll,
    /// About the vertical.
    Yaw,
}

impl Freedom {
    /// Those in which the skill itself moves.
    pub const OF_SKILL: [Self; 3] = [Self::Forward, Self::Up, Self::Pitch];

    /// As [`Control`] has it: a unit vector in its first or last three components, and whether it turns.
    pub(crate) fn direction(self, heading: [f64; 3], across: [f64; 3]) -> Control {
        let (axis, turns) = match self {
            Self::Forward => (heading, false),
            Self::Sideways => (across, false),
            Self::Up => ([0.0, 0.0, 1.0], false),
            Self::Pitch => (across, true),
            Self::Roll => (heading, true),
            Self::Yaw => ([0.0, 0.0, 1.0], true),
        };
        let from = if turns { 3 } else { 0 };
        std::array::from_fn(|row| if (from..from + 3).contains(&row) { axis[row - from] } else { 0.0 })
    }

    fn turns(self) -> bool {
        matches!(self, Self::Pitch | Self::Roll | Self::Yaw)
    }
}

/// What is added to a skill's motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Splines {
    /// In which ways.
    pub freedoms: Vec<Freedom>,
    /// As many for each freedom, those of the first one first, in the order of time; in units of [`UNIT_ANGLE_RAD`].
    pub coefficients: Vec<f64>,
}

impl Splines {
    /// For each freedom.
    pub fn knots(&self) -> usize {
        self.coefficients.len() / self.freedoms.len().max(1)
    }
}

/// A skill's motion and the splines that may be added to it.
#[derive(Clone, Debug)]
pub struct SplinePath {
    skill: Vec<Control>,
    /// What a unit of each freedom's coefficients does, as a control.
    units: Vec<Control>,
    knots: usize,
    /// What each spline changes by in each control step.
    changes: Vec<f64>,
    period_s: f64,
}

impl SplinePath {
    /// Near a skill, with so many knots for each freedom, at least one.
    ///
    /// # Errors
    /// [`SkillError::TooLong`].
    pub fn new(
        map: &SkillMap,
        theta: &Theta,
        freedoms: &[Freedom],
        knots: usize,
    ) -> Result<Self, SkillError> {
        let knots = knots.max(1);
        let unit = |freedom: &Freedom| {
            let size = match freedom.turns() {
                true => UNIT_ANGLE_RAD,
                false => UNIT_ANGLE_RAD * map.body_radius_m,
            };
            freedom.direction(map.forward, map.pitch_axis).map(|x| size * x)
        };
        let skill = map.control_vectors(theta)?;
        let end_s = map.duration_s(theta);
        let spacing = end_s / map.clock.period_s / (knots + 2) as f64;
        let at = |knot: usize, ticks: usize| spline((knot, knots), spacing, ticks as f64);
        let of_knot = |knot| (0..skill.len()).map(move |step| at(knot, step + 1) - at(knot, step));
        let changes = (0..knots).flat_map(of_knot).collect();
        let units = freedoms.iter().map(unit).collect();
        Ok(Self { skill, units, knots, changes, period_s: map.clock.period_s })
    }

    /// Coefficients in all: those of the first freedom come first, in the order of time.
    pub fn dimensions(&self) -> usize {
        self.units.len() * self.knots
    }

    /// The motion, one displacement per control step. Coefficients that are missing count as 0.
    pub fn controls(&self, coefficients: &[f64]) -> Vec<Displacement> {
        self.vectors(coefficients).into_iter().map(Displacement::from).collect()
    }

    fn vectors(&self, coefficients: &[f64]) -> Vec<Control> {
        let mut controls = self.skill.clone();
        for (unit, of_freedom) in self.units.iter().zip(coefficients.chunks(self.knots)) {
            for (step, control) in controls.iter_mut().enumerate() {
                let sum: f64 = (0..).zip(of_freedom).map(|(knot, c)| c * self.change(knot, step)).sum();
                *control = std::array::from_fn(|row| control[row] + sum * unit[row]);
            }
        }
        controls
    }

    /// The gradient with respect to the coefficients, given that with respect to the controls.
    pub fn pull_back(&self, gradient: &[DisplacementGradient]) -> Vec<f64> {
        let along = |unit: &Control| -> Vec<f64> {
            let component = |of_step: &DisplacementGradient| -> f64 {
                of_step.components().iter().zip(unit).map(|(bar, unit)| bar * unit).sum()
            };
            gradient.iter().map(component).collect()
        };
        let of_freedom = |unit: &Control| -> Vec<f64> {
            let along = along(unit);
            let of_knot = |knot| (0..).zip(&along).map(|(step, bar)| bar * self.change(knot, step)).sum();
            (0..self.knots).map(of_knot).collect()
        };
        self.units.iter().flat_map(of_freedom).collect()
    }

    /// The coefficients, changed by about as little as is needed for speeds, accelerations and jerks to keep the limits less `margin`, a
    /// share of them. Each step moves the coefficients against the derivative that is farthest beyond its limit, to where it is
    /// just within (Kaczmarz 1937; Agmon 1954); these sets are convex, so that the steps come to an end. What is left after
    /// so many of them is left. Of rotations about several axes this holds as far as they are small.
    pub fn within_limits(&self, limits: &Limits, margin: f64, mut coefficients: Vec<f64>) -> Vec<f64> {
        const MOST_STEPS: usize = 500;
        coefficients.resize(self.dimensions(), 0.0);
        for _ in 0..MOST_STEPS {
            let Some(worst) = self.worst(limits, margin, &coefficients) else { break };
            let slopes = self.slopes(&worst);
            let square: f64 = slopes.iter().map(|slope| slope * slope).sum();
            if square <= 0.0 {
                break;
            }
            for (coefficient, slope) in coefficients.iter_mut().zip(&slopes) {
                *coefficient -= slope * worst.beyond / square;
            }
        }
        coefficients
    }

    /// The derivative of the motion that is farthest beyond what is left of its limit; none if none is.
    fn worst(&self, limits: &Limits, margin: f64, coefficients: &[f64]) -> Option<Excess> {
        let [v, a, j, turning_v, turning_a, turning_j] = limits.derivative_bounds().map(|(_, bound)| bound);
        let bounds = [[v, a, j], [turning_v, turning_a, turning_j]];
        let mut worst: Option<(f64, Excess)> = None;
        let mut derivatives = self.vectors(coefficients);
        for order in 1..=3 {
            if order > 1 {
                derivatives = changes(&derivatives);
            }
            let per_second = libm::pow(self.period_s, f64::from(order));
            for (step, derivative) in derivatives.iter().enumerate() {
                for (half, bounds) in bounds.iter().enumerate() {
                    let part = &derivative[3 * half..3 * half + 3];
                    let size = libm::sqrt(part.iter().map(|x| x * x).sum()) / per_second;
                    let bound = (1.0 - margin) * bounds[order as usize - 1];
                    // Just within, so that rounding does not bring it back.
                    let share = size / bound - 1.0;
                    if share > 1e-6 && worst.as_ref().is_none_or(|(most, _)| share > *most) {
                        let toward = std::array::from_fn(|row| match row / 3 == half {
                            true => derivative[row] / (size * per_second),
                            false => 0.0,
                        });
                        let beyond = (size - (1.0 - 1e-6) * bound) * per_second;
                        worst = Some((share, Excess { order, step, toward, beyond }));
                    }
                }
            }
        }
        worst.map(|(_, worst)| worst)
    }

    /// What the size of a derivative changes by with each coefficient, times the period to the power of its order.
    fn slopes(&self, of: &Excess) -> Vec<f64> {
        let change = |knot: usize| -> f64 {
            let at = |back: usize| of.step.checked_sub(back).map_or(0.0, |step| self.change(knot, step));
            match of.order {
                1 => at(0),
                2 => at(0) - at(1),
                _ => at(0) - 2.0 * at(1) + at(2),
            }
        };
        let changes: Vec<f64> = (0..self.knots).map(change).collect();
        let along =
            |unit: &Control| -> f64 { unit.iter().zip(of.toward).map(|(unit, way)| unit * way).sum() };
        self.units.iter().flat_map(|unit| changes.iter().map(move |change| along(unit) * change)).collect()
    }

    /// What a spline changes by in a control step; nothing after the last.
    fn change(&self, knot: usize, step: usize) -> f64 {
        let steps = self.skill.len();
        if step < steps { self.changes[knot * steps + step] } else { 0.0 }
    }
}

/// A derivative that is beyond its limit.
struct Excess {
    /// 1: velocity, 2: acceleration, 3: jerk.
    order: u32,
    /// Control step with which it is there.
    step: usize,
    /// Its unit vector, of translation or of rotation.
    toward: Control,
    /// How far beyond, times the period to the power of the order.
    beyond: f64,
}

/// Of a motion that begins at rest, and ends so after the last step.
fn changes(of: &[Control]) -> Vec<Control> {
    let before = std::iter::once(&[0.0; 6]).chain(of);
    let all = before.zip(of.iter().chain(std::iter::once(&[0.0; 6])));
    all.map(|(before, after)| std::array::from_fn(|row| after[row] - before[row])).collect()
}

/// A spline of so many after so many ticks, whose knots are `spacing` ticks apart.
fn spline((knot, knots): (usize, usize), spacing: f64, ticks: f64) -> f64 {
    if spacing <= 0.0 {
        return 0.0;
    }
    let from_centre = ticks / spacing - (knot + 2) as f64;
    match knot + 1 == knots {
        // All the later ones with it: of those beyond the third none has begun before all of these add up to 1.
        true if from_centre >= 1.0 => 1.0,
        true => (0..3).map(|later| b_spline(from_centre - f64::from(later))).sum(),
        false => b_spline(from_centre),
    }
}

/// The cubic B-spline on whole knots.
fn b_spline(x: f64) -> f64 {
    let x = x.abs();
    if x < 1.0 {
        2.0 / 3.0 - x * x + 0.5 * x * x * x
    } else if x < 2.0 {
        (2.0 - x) * (2.0 - x) * (2.0 - x) / 6.0
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    const ALL: [Freedom; 6] =
        [Freedom::Forward, Freedom::Up, Freedom::Pitch, Freedom::Sideways, Freedom::Roll, Freedom::Yaw];

    /// `bench`, its tool turned to a heading that is no axis.
    fn map() -> SkillMap {
        let mut scene = Scene::load("bench").unwrap();
        scene.skill.heading_deg = 30.0;
        SkillMap::new(&scene)
    }

    fn path(knots: usize) -> SplinePath {
        SplinePath::new(&map(), &Theta::MIDDLE, &ALL, knots).unwrap()
    }

    /// What is added to a component of the controls, step by step.
    fn added(path: &SplinePath, coefficients: &[f64], row: usize) -> Vec<f64> {
        let [with, without] =
            [coefficients, &[]].map(|c| path.controls(c).into_iter().map(move |u| u.components()[row]));
        with.zip(without).map(|(with, without)| with - without).collect()
    }

    #[test]
    fn without_coefficients_it_is_the_skill() {
        let (map, path) = (map(), path(5));
        let skill: Vec<_> = map.controls(&Theta::MIDDLE).unwrap();
        assert_eq!(path.controls(&[]), skill);
        assert_eq!(path.controls(&[0.0; 30]), skill);
        assert_eq!((path.dimensions(), path.controls(&[0.5; 30]).len()), (30, skill.len()));
        let splines = Splines { freedoms: ALL.to_vec(), coefficients: vec![0.5; 30] };
        assert_eq!(splines.knots(), 5);
        assert_eq!(map.motion(&Theta::MIDDLE, Some(&splines)).unwrap(), path.controls(&[0.5; 30]));
        assert_eq!(map.motion(&Theta::MIDDLE, None).unwrap(), skill);
    }

    #[test]
    fn each_freedom_goes_its_way_by_the_unit_of_its_last_coefficient() {
        let (map, path) = (map(), path(4));
        let (sin, cos) = libm::sincos(30f64.to_radians());
        let size_m = UNIT_ANGLE_RAD * map.body_radius_m;
        let ways = [
            [cos * size_m, sin * size_m, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, size_m, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, -sin * UNIT_ANGLE_RAD, cos * UNIT_ANGLE_RAD, 0.0],
            [-sin * size_m, cos * size_m, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, cos * UNIT_ANGLE_RAD, sin * UNIT_ANGLE_RAD, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, UNIT_ANGLE_RAD],
        ];
        for (freedom, way) in ways.iter().enumerate() {
            for knot in 0..4 {
                let mut coefficients = [0.0; 24];
                coefficients[4 * freedom + knot] = 2.0;
                for (row, unit) in way.iter().enumerate() {
                    let sum: f64 = added(&path, &coefficients, row).iter().sum();
                    // All but the last come back.
                    let expected = if knot == 3 { 2.0 * unit } else { 0.0 };
                    assert!((sum - expected).abs() < 1e-12, "{freedom} {knot} {row}: {sum} {expected}");
                }
            }
        }
    }

    /// Of what is added, velocity and acceleration begin and end with nothing and have no jumps.
    #[test]
    fn it_begins_and_ends_at_rest_and_is_smooth() {
        let (map, path) = (map(), path(12));
        let coefficients: Vec<f64> = (0..72).map(|k| libm::sin(7.0 * f64::from(k))).collect();
        let end = map.segments(&Theta::MIDDLE).last().unwrap().end_s / map.clock.period_s;
        let velocity = added(&path, &coefficients, 2);
        assert!(velocity[..3].iter().all(|v| v.abs() < 1e-6), "{:?}", &velocity[..3]);
        assert!(velocity[end.ceil() as usize..].iter().all(|v| v.abs() < 1e-12));
        let largest = velocity.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
        let jerk = |v: &[f64; 3]| (v[2] - 2.0 * v[1] + v[0]).abs();
        let roughest = velocity.array_windows().map(jerk).fold(0.0, f64::max);
        // Over a spacing of some 20 steps a velocity of v has a jerk of about v/20^2.
        assert!(largest > 1e-5 && roughest < 0.02 * largest, "{largest} {roughest}");
    }

    /// The limits that `bench` has for a skill, which goes to them.
    #[test]
    fn a_motion_beyond_the_limits_is_brought_back_within_them_and_not_far() {
        let map = SkillMap::new(&Scene::load("bench").unwrap());
        let plane = SplinePath::new(&map, &Theta::MIDDLE, &Freedom::OF_SKILL, 12).unwrap();
        let kept = |coefficients: &[f64]| {
            let quantised = super::super::QuantisedControls::new(&plane.controls(coefficients)).unwrap();
            map.check_limits(&quantised).map(|_| ())
        };
        let is_able = |coefficients: &[f64]| kept(coefficients).is_ok();
        for draw in 0..12 {
            // Mostly turned, so that the workspace is not left.
            let size = |k: i32| if k < 24 { 0.5 } else { 6.0 };
            let wild: Vec<f64> =
                (0..36).map(|k| size(k) * libm::sin(f64::from(36 * draw + k) * 1.7)).collect();
            assert!(!is_able(&wild), "{draw}");
            let tame = plane.within_limits(map.limits(), 0.01, wild.clone());
            assert_eq!(kept(&tame), Ok(()), "{draw}: {tame:?}");
            // Less is given up than by drawing it in towards the skill as far as it needs.
            let away = |from: &[f64]| from.iter().zip(&wild).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
            let shares = (0..100).map(|share| 0.01 * f64::from(share));
            let drawn = shares.map(|share| wild.iter().map(|x| share * x).collect::<Vec<_>>());
            let nearest = drawn.filter(|c| is_able(c)).map(|c| away(&c)).fold(f64::INFINITY, f64::min);
            assert!(away(&tame) < 0.8 * nearest, "{draw}: {} {nearest}", away(&tame));
            // One that is within stays as it is.
            assert_eq!(plane.within_limits(map.limits(), 0.005, tame.clone()), tame);
        }
    }

    #[test]
    fn pull_back_is_the_derivative() {
        let path = path(7);
        let wave = |k: usize, f: f64| libm::sin(k as f64 * f);
        let coefficients: Vec<f64> = (0..42).map(|k| wave(k, 0.7)).collect();
        let steps = path.controls(&coefficients).len();
        let gradient: Vec<DisplacementGradient> =
            (0..steps).map(|step| std::array::from_fn(|row| wave(6 * step + row, 1.3)).into()).collect();
        let functional = |coefficients: &[f64]| -> f64 {
            let controls = path.controls(coefficients);
            let both = controls.iter().zip(&gradient);
            both.map(|(u, g)| u.components().iter().zip(g.components()).map(|(u, g)| u * g).sum::<f64>())
                .sum()
        };
        let found = path.pull_back(&gradient);
        assert_eq!(found.len(), 42);
        for (k, slope) in found.iter().enumerate() {
            let at = |h: f64| {
                let mut moved = coefficients.clone();
                moved[k] += h;
                functional(&moved)
            };
            assert!((at(0.5) - at(-0.5) - slope).abs() < 1e-10, "{k}: {} {slope}", at(0.5) - at(-0.5));
        }
    }
}
