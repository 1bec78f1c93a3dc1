//! The control sequence as it is shipped: rounded to counts, and what the rounded one does.

use super::{SkillError, SkillMap, Theta};
use crate::scene;
use powderline_shared::{
    displacement::{Displacement, Lsb, Quantiser, Setpoint, StepCounts, displacement_between, pose_at},
    limits::{LimitChecker, Limits, PeakUse},
    pose::{Pose, exp_so3},
};

/// Resolution of every plan that is made here.
pub const LSB: Lsb = Lsb { translation_nm: 100, rotation_nrad: 100 };

/// A quantised control sequence.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct QuantisedControls {
    /// What a plan stores: one difference of setpoints per control step.
    pub steps: Vec<StepCounts>,
    /// The setpoints, from tick 1.
    pub setpoints: Vec<Setpoint>,
    /// What is simulated and performed: the displacement between successive setpoints.
    pub controls: Vec<Displacement>,
}

impl QuantisedControls {
    /// Rounds the cumulative displacements, so that no setpoint is off by more than half an LSB.
    ///
    /// # Errors
    /// A displacement that is no setpoint, above all a rotation that reaches pi.
    pub fn new(controls: &[Displacement]) -> Result<Self, SkillError> {
        let mut quantiser = Quantiser::new(LSB);
        let mut steps = Vec::with_capacity(controls.len());
        let mut setpoints = Vec::with_capacity(controls.len());
        for control in controls {
            let (setpoint, step) = quantiser.push(control)?;
            steps.push(step);
            setpoints.push(setpoint);
        }
        let controls = controls_of(&setpoints, LSB);
        Ok(Self { steps, setpoints, controls })
    }
}

/// The displacements between successive setpoints, the first from the anchor.
pub fn controls_of(setpoints: &[Setpoint], lsb: Lsb) -> Vec<Displacement> {
    let previous = std::iter::once(&Setpoint::ANCHOR).chain(setpoints);
    previous.zip(setpoints).map(|(&from, &to)| displacement_between(from, to, lsb)).collect()
}

/// The tool's pose before the motion: pitched about its pitch axis, then turned to the heading.
pub(super) fn start_pose(tool: &scene::Tool, heading_rad: f64) -> Pose {
    let pitch = exp_so3(&[0.0, tool.start_pitch_deg.to_radians(), 0.0].into());
    let heading = exp_so3(&[0.0, 0.0, heading_rad].into());
    Pose { position_m: tool.start_position_m.into(), orientation: heading * pitch }
}

impl SkillMap {
    /// The tool's pose before the motion.
    pub fn start_pose(&self) -> &Pose {
        &self.start
    }

    /// What the motion must keep.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// From tick to tick, microseconds.
    pub fn control_period_us(&self) -> u32 {
        self.period_us
    }

    /// The control sequence of a skill as it is shipped.
    ///
    /// # Errors
    /// The skill is not a motion, see [`SkillError`].
    pub fn quantise(&self, theta: &Theta) -> Result<QuantisedControls, SkillError> {
        QuantisedControls::new(&self.controls(theta)?)
    }

    /// Checks a quantised motion against the scene's limits, from rest to rest.
    ///
    /// # Errors
    /// [`SkillError::Limits`] and [`SkillError::Violation`].
    pub fn check_limits(&self, quantised: &QuantisedControls) -> Result<PeakUse, SkillError> {
        self.limits.validate()?;
        self.limits.check_resolution(LSB, self.period_us)?;
        let mut checker = LimitChecker::new(self.limits, LSB, self.period_us, self.start);
        for setpoint in &quantised.setpoints {
            checker.check(pose_at(&self.start, *setpoint, LSB))?;
        }
        checker.finish()?;
        Ok(checker.peak_use())
    }

    /// Checks every corner of theta's range. Travels and, with minimum jerk, durations grow with
    /// theta, and each coordinate of the path is largest and smallest at corners: what holds there
    /// holds for all skills. Limits alone: for walls in the tool's way see
    /// [`super::colliding_skill`].
    ///
    /// # Errors
    /// [`SkillError::Corner`] with what is wrong at the first corner that is not a motion within
    /// the limits.
    pub fn check_all_corners(&self) -> Result<(), SkillError> {
        for theta in Theta::lattice(2) {
            self.quantise(&theta)
                .and_then(|quantised| self.check_limits(&quantised))
                .map_err(|source| SkillError::Corner { theta, source: Box::new(source) })?;
        }
        Ok(())
    }
}
