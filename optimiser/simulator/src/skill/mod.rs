//! From five skill parameters to a control sequence, with its derivative.
//!
//! `g` of the paper: theta in `[-1, 1]^5` maps affinely to scooping depth, scooping angle, lift height, transport
//! displacement and pouring angle; these set the travels of six segments (approach, insert, scoop, lift,
//! transport, pour); the segments, laid end to end at fixed mean speeds (or the last three a little over each other), are a motion of the tool; the motion
//! sampled at the control ticks is the control sequence: one six-dimensional displacement per control step, in
//! the world frame, translation (metres) before rotation vector (radians). After the pour the tool rests to the end of the horizon.
//!
//! Where the mapping is not smooth: with `rounded` timing where a step count flips (the count is a constant for
//! the derivative); with `constant_speed` where a control tick meets the end of a segment, and where a travel
//! passes through zero. `continuous` timing with `minimum_jerk` is twice continuously differentiable everywhere.

mod clearance;
mod duration;
mod motion;
mod profile;
mod quantised;
mod real;
mod spline_path;
#[cfg(test)]
mod tests;
mod theta;

pub(crate) use clearance::standing_collision;
pub use clearance::{Collision, Impassable, check_passable, colliding_skill, collision};
pub(crate) use duration::rest_to_rest_steps;
pub use motion::SegmentKind;
pub use powderline_shared::plan::SkillParameter;
pub(crate) use profile::{MINIMUM_JERK, minimum_jerk_position};
pub use quantised::{LSB, QuantisedControls, controls_of};
use real::{Dual5, SkillScalar};
pub use spline_path::{Freedom, SplinePath, Splines, UNIT_ANGLE_RAD, USUAL_KNOTS};
pub use theta::{Theta, ThetaError, ThetaGradient};

use crate::scene::{Limits, Scene, Skill, Time, Tool};
use duration::{Caps, Pace};
use motion::{Coordinates, Segment, TimeParametrisation, Travel};
use powderline_shared::{
    displacement::{Displacement, SetpointError},
    limits::{LimitsError, Violation},
    pose::Pose,
};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// One control step: translation in metres, then rotation vector in radians, world frame.
pub type Control = [f64; 6];

/// Why a skill gives no valid motion.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum SkillError {
    /// The segments take longer than the horizon.
    #[error("the motion takes {motion_s:.3} s, longer than the horizon of {horizon_s:.3} s")]
    TooLong {
        /// Time that the segments take together, seconds.
        motion_s: f64,
        /// Horizon, seconds.
        horizon_s: f64,
    },
    /// A displacement that no setpoint can represent.
    #[error(transparent)]
    Setpoint(#[from] SetpointError),
    /// The scene's limits are invalid.
    #[error(transparent)]
    Limits(#[from] LimitsError),
    /// The motion takes the tool through a container.
    #[error(transparent)]
    Collision(#[from] Collision),
    /// The motion breaks a limit.
    #[error(transparent)]
    Violation(#[from] Violation),
    /// Not every skill that the scene allows is a motion that the arm can make.
    #[error("the scene allows a skill that the arm cannot perform (theta = {theta}): {source}")]
    Corner {
        /// The skill, a corner of theta's range.
        theta: Theta,
        /// What is wrong with it.
        source: Box<SkillError>,
    },
}

/// The place of one segment in time, seconds from the start of the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct SegmentSpan {
    /// What the segment does.
    pub kind: SegmentKind,
    /// Start, seconds.
    pub start_s: f64,
    /// End, seconds.
    pub end_s: f64,
}

/// Derivative of the loss with respect to one displacement of a control sequence, the others held,
/// in the world frame: what [`Displacement`] has in metres and in radians, this has per metre and
/// per radian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DisplacementGradient {
    /// Metres of loss per metre of each component of the translation.
    pub per_metre: [f64; 3],
    /// Metres of loss per radian of each component of the rotation vector, as it stands in the
    /// displacement: about the world's axes, whatever way the tool is turned.
    pub per_radian: [f64; 3],
}

impl DisplacementGradient {
    /// The six numbers in the order of [`Displacement::components`].
    pub fn components(&self) -> [f64; 6] {
        let [x, y, z] = self.per_metre;
        let [rx, ry, rz] = self.per_radian;
        [x, y, z, rx, ry, rz]
    }
}

impl From<Control> for DisplacementGradient {
    /// From the cotangent of a [`Control`], translation before rotation vector as there.
    fn from([x, y, z, rx, ry, rz]: Control) -> Self {
        Self { per_metre: [x, y, z], per_radian: [rx, ry, rz] }
    }
}

/// A control sequence with its derivative.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Linearisation {
    /// One displacement per control step.
    pub controls: Vec<Displacement>,
    /// `jacobian[i][row][k]`: derivative of `controls[i][row]` with respect to theta's component `k`.
    pub jacobian: Vec<[[f64; 5]; 6]>,
}

impl Linearisation {
    /// Gradient with respect to theta, given that with respect to the controls, as
    /// [`simulate_with_gradient`](crate::rollout::Simulate::simulate_with_gradient) has it.
    ///
    /// Summed in the order of the steps, so its bits depend on nothing else. Those of steps that are missing count as zero.
    pub fn pull_back(&self, gradient: &[DisplacementGradient]) -> ThetaGradient {
        let mut theta_bar = [0.0; 5];
        for (jacobian, of_step) in self.jacobian.iter().zip(gradient) {
            for (row, bar) in jacobian.iter().zip(of_step.components()) {
                for (sum, partial) in theta_bar.iter_mut().zip(row) {
                    *sum += bar * partial;
                }
            }
        }
        theta_bar
    }
}

/// The mapping of one scene.
#[derive(Clone, Debug)]
pub struct SkillMap {
    /// Physical values at theta = -1 and +1: metres and radians.
    bounds: [[f64; 2]; 5],
    /// Unit vector of the heading, world frame.
    forward: [f64; 3],
    /// Unit vector of the pitch axis, world frame.
    pitch_axis: [f64; 3],
    approach_m: f64,
    sweep_m: f64,
    /// How far the tool's body reaches from its origin.
    body_radius_m: f64,
    clock: TimeParametrisation,
    period_us: u32,
    start: Pose,
    limits: Limits,
}

impl SkillMap {
    /// Takes what it needs from a validated scene.
    pub fn new(scene: &Scene) -> Self {
        Self::from_parts(&scene.skill, &scene.time, &scene.limits, &scene.tool)
    }

    fn from_parts(skill: &Skill, time: &Time, limits: &Limits, tool: &Tool) -> Self {
        let bounds = |parameter: SkillParameter| {
            let range = skill.range(parameter);
            if parameter.is_angle() { range.map(f64::to_radians) } else { range }
        };
        let (sin, cos) = libm::sincos(skill.heading_deg.to_radians());
        Self {
            bounds: SkillParameter::ALL.map(bounds),
            forward: [cos, sin, 0.0],
            pitch_axis: [-sin, cos, 0.0],
            approach_m: skill.approach_m,
            sweep_m: skill.sweep_m,
            body_radius_m: tool.body_radius_m(),
            clock: clock(skill, time, limits),
            period_us: time.control_period_us,
            start: quantised::start_pose(tool, skill.heading_deg.to_radians()),
            limits: *limits,
        }
    }

    /// The five parameters in metres and radians.
    pub fn parameters(&self, theta: &Theta) -> [f64; 5] {
        self.physical(&theta.components())
    }

    /// The components of theta for five parameters in metres and radians, inverse of [`Self::parameters`]; 0 for one that the scene
    /// fixes. Beyond [-1, 1] where they lie beyond the scene's bounds, and by a rounding error where they lie at one: [`Theta::new`]
    /// refuses that, [`Theta::clamped`] does not.
    pub fn theta(&self, parameters: &[f64; 5]) -> [f64; 5] {
        std::array::from_fn(|k| {
            let [low, high] = self.bounds[k];
            if low >= high { 0.0 } else { (2.0 * parameters[k] - low - high) / (high - low) }
        })
    }

    /// The segments' places in time; the tool rests from the end of the last one.
    pub fn segments(&self, theta: &Theta) -> Vec<SegmentSpan> {
        self.schedule(&theta.components())
            .iter()
            .map(|segment| SegmentSpan {
                kind: segment.kind,
                start_s: segment.start_s,
                end_s: segment.end_s(),
            })
            .collect()
    }

    /// How long the segments take together, seconds; the rest after them is not in it.
    pub fn duration_s(&self, theta: &Theta) -> f64 {
        self.schedule(&theta.components()).last().map_or(0.0, Segment::end_s)
    }

    /// The control sequence, one displacement per control step.
    ///
    /// # Errors
    /// [`SkillError::TooLong`].
    pub fn controls(&self, theta: &Theta) -> Result<Vec<Displacement>, SkillError> {
        Ok(self.control_vectors(theta)?.into_iter().map(Displacement::from).collect())
    }

    /// The same with splines added, if there are any.
    ///
    /// # Errors
    /// [`SkillError::TooLong`].
    pub fn motion(&self, theta: &Theta, splines: Option<&Splines>) -> Result<Vec<Displacement>, SkillError> {
        match splines {
            None => self.controls(theta),
            Some(added) => {
                let path = SplinePath::new(self, theta, &added.freedoms, added.knots())?;
                Ok(path.controls(&added.coefficients))
            }
        }
    }

    fn control_vectors(&self, theta: &Theta) -> Result<Vec<Control>, SkillError> {
        let coordinates = self.coordinates(&theta.components())?;
        Ok(coordinates.array_windows().map(|[from, to]| self.control(from, to)).collect())
    }

    /// The control sequence and its derivative, exact to rounding.
    ///
    /// # Errors
    /// [`SkillError::TooLong`].
    pub fn linearise(&self, theta: &Theta) -> Result<Linearisation, SkillError> {
        let theta = theta.components();
        let dual: [Dual5; 5] = std::array::from_fn(|k| Dual5::variable(theta[k], k));
        let coordinates = self.coordinates(&dual)?;
        let steps: Vec<[Dual5; 6]> =
            coordinates.array_windows().map(|[from, to]| self.control(from, to)).collect();
        Ok(Linearisation {
            controls: steps.iter().map(|step| step.map(|component| component.value).into()).collect(),
            jacobian: steps.iter().map(|step| step.map(|component| component.partials)).collect(),
        })
    }

    /// Exact at both ends of the range.
    fn physical<S: SkillScalar>(&self, theta: &[S; 5]) -> [S; 5] {
        let half = S::constant(0.5);
        std::array::from_fn(|k| {
            let [low, high] = self.bounds[k].map(S::constant);
            half * ((S::constant(1.0) - theta[k]) * low + (S::constant(1.0) + theta[k]) * high)
        })
    }

    fn travels<S: SkillScalar>(&self, theta: &[S; 5]) -> [Travel<S>; 6] {
        let [depth, scoop, lift, transport, pour] = self.physical(theta);
        let [approach, sweep] = [self.approach_m, self.sweep_m].map(S::constant);
        let down = |travel: S| Some(S::constant(0.0) - travel);
        let rest = |kind| Travel { kind, forward: None, up: None, pitch: None };
        [
            Travel { up: down(approach), ..rest(SegmentKind::Approach) },
            Travel { up: down(depth), ..rest(SegmentKind::Insert) },
            Travel { forward: Some(sweep), pitch: down(scoop), ..rest(SegmentKind::Scoop) },
            Travel { up: Some(lift), ..rest(SegmentKind::Lift) },
            Travel { forward: Some(transport), ..rest(SegmentKind::Transport) },
            Travel { pitch: Some(pour), ..rest(SegmentKind::Pour) },
        ]
    }

    fn schedule<S: SkillScalar>(&self, theta: &[S; 5]) -> Vec<Segment<S>> {
        self.clock.schedule(&self.travels(theta))
    }

    fn coordinates<S: SkillScalar>(&self, theta: &[S; 5]) -> Result<Vec<Coordinates<S>>, SkillError> {
        let segments = self.schedule(theta);
        let motion_s = segments.last().map_or(0.0, |segment| segment.end_s().value());
        let horizon_s = f64::from(self.clock.horizon_steps) * self.clock.period_s;
        // A millionth of a control step: end times are sums of rounded numbers.
        if motion_s > horizon_s + 1e-6 * self.clock.period_s {
            return Err(SkillError::TooLong { motion_s, horizon_s });
        }
        Ok(self.clock.sample(&segments))
    }

    fn control<S: SkillScalar>(&self, from: &Coordinates<S>, to: &Coordinates<S>) -> [S; 6] {
        let [forward, up, pitch]: [S; 3] = std::array::from_fn(|k| to[k] - from[k]);
        let along = |axis: f64, travel: S| travel * S::constant(axis);
        [
            along(self.forward[0], forward),
            along(self.forward[1], forward),
            up,
            along(self.pitch_axis[0], pitch),
            along(self.pitch_axis[1], pitch),
            S::constant(0.0),
        ]
    }
}

fn clock(skill: &Skill, time: &Time, limits: &Limits) -> TimeParametrisation {
    let period_s = f64::from(time.control_period_us) * 1e-6;
    let pace = |speed, caps| Pace { speed, caps, floor: speed * period_s };
    TimeParametrisation {
        linear: pace(skill.linear_speed_m_s, Caps::linear(limits, 1.0)),
        angular: pace(skill.angular_speed_rad_s, Caps::angular(limits, 1.0)),
        timing: skill.timing,
        profile: skill.profile,
        overlap: skill.overlap,
        period_s,
        horizon_steps: time.horizon_steps,
    }
}
