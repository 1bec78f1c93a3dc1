//! The mechanics behind the controller: an arm of six joints, or an ideal one that is where it is told to be.
//!
//! [`Arm::new`] is a UR5e on a stand ([`ArmModel`]). It takes poses and turns them into joints itself, always in the posture
//! that it began with, and refuses what a real one would refuse: [`Arm::target`] is asked tick by tick, and what it grants is
//! granted. Its joints follow with the lag of a drive ([`servo`]), so where it is and where it is told to be are two things.
//!
//! Nothing here allocates, and all functions are those of `libm`: the same bits on every machine.

pub mod servo;

use nalgebra::Vector6;
use powderline_shared::arm::{ArmError, ArmModel, Joints};
use powderline_shared::pose::Pose;

use servo::Lag;

/// What an arm is told: where its tool is to be, and the joints that put it there, if it has any.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Of the tool.
    pub pose: Pose,
    /// Radians.
    pub joints: Option<Joints>,
}

impl Target {
    /// Of an arm that has no joints.
    #[must_use]
    pub fn pose(pose: Pose) -> Self {
        Self { pose, joints: None }
    }
}

/// Joints at a tick, with the differences that led to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointMotion {
    /// Radians.
    pub angles_rad: Joints,
    /// First difference, rad/s.
    pub velocity_rad_s: Vector6<f64>,
    /// Second difference, rad/s^2.
    pub acceleration_rad_s2: Vector6<f64>,
}

impl JointMotion {
    /// Standstill.
    #[must_use]
    pub fn at_rest(angles_rad: Joints) -> Self {
        let zero = Vector6::zeros();
        Self { angles_rad, velocity_rad_s: zero, acceleration_rad_s2: zero }
    }

    /// The motion after turning to `angles_rad` within one control period.
    #[must_use]
    pub fn moved_to(&self, angles_rad: Joints, period_us: u32) -> Self {
        let h = f64::from(period_us) / 1e6;
        let velocity_rad_s = (Vector6::from(angles_rad) - Vector6::from(self.angles_rad)) / h;
        Self { angles_rad, velocity_rad_s, acceleration_rad_s2: (velocity_rad_s - self.velocity_rad_s) / h }
    }
}

/// An arm: where it is told to be, and where it is.
#[derive(Clone, Copy, Debug)]
pub struct Arm {
    told: Target,
    pose: Pose,
    mechanics: Option<Mechanics>,
}

/// An arm that has joints.
#[derive(Clone, Copy, Debug)]
struct Mechanics {
    model: ArmModel,
    lag: Lag,
    real: Joints,
}

impl Arm {
    /// Standing at `pose`, in the model's posture, each joint within half a turn of zero.
    ///
    /// # Errors
    /// The arm cannot stand there.
    pub fn new(model: ArmModel, lag: Lag, pose: Pose) -> Result<Self, ArmError> {
        let real = model.joints_near(&[0.0; 6], &pose)?;
        let told = Target { pose, joints: Some(real) };
        Ok(Self { told, pose, mechanics: Some(Mechanics { model, lag, real }) })
    }

    /// An arm without joints that is where it is told to be, at once and wherever that is.
    #[must_use]
    pub fn ideal(pose: Pose) -> Self {
        Self { told: Target::pose(pose), pose, mechanics: None }
    }

    /// What puts the tool at `pose`, `dt_s` seconds after `from`. Wherever the arm has come to, it may stay.
    ///
    /// # Errors
    /// The arm cannot.
    pub fn target(&self, from: &Target, pose: &Pose, dt_s: f64) -> Result<Target, ArmError> {
        if from.pose == *pose {
            return Ok(*from);
        }
        let joints = self.mechanics.zip(from.joints);
        let joints = joints.map(|(arm, near)| arm.model.joints_after(&near, pose, dt_s)).transpose()?;
        Ok(Target { pose: *pose, joints })
    }

    /// The target that these joints are, which nobody asks whether the arm likes them.
    #[must_use]
    pub fn target_of(&self, joints: Joints) -> Target {
        let pose = self.mechanics.map_or(self.told.pose, |arm| arm.model.world_from_tool(&joints));
        Target { pose, joints: Some(joints) }
    }

    /// Lets `dt_s` seconds go by, in which the command goes, joint by joint in a straight line, from the last one to `target`.
    pub fn follow(&mut self, target: Target, dt_s: f64) {
        let from = std::mem::replace(&mut self.told, target);
        let Some(((arm, from), to)) = self.mechanics.as_mut().zip(from.joints).zip(target.joints) else {
            self.pose = target.pose;
            return;
        };
        arm.real = arm.lag.after(dt_s, &arm.real, &from, &to);
        // Where nothing lags, the tool is at the very pose that was asked for, not at that of joints rounded on the way.
        #[expect(clippy::float_cmp, reason = "joints that are there are so to the last bit")]
        let there = arm.real == to;
        self.pose = if there { target.pose } else { arm.model.world_from_tool(&arm.real) };
    }

    /// Tells it to be where it is.
    pub fn stay(&mut self) {
        self.told = Target { pose: self.pose, joints: self.joints() };
    }

    /// Where the tool is.
    #[must_use]
    pub fn pose(&self) -> Pose {
        self.pose
    }

    /// What it is told.
    #[must_use]
    pub fn told(&self) -> &Target {
        &self.told
    }

    /// Where the joints are, radians; an ideal arm has none.
    #[must_use]
    pub fn joints(&self) -> Option<Joints> {
        self.mechanics.map(|arm| arm.real)
    }

    /// Whose joints they are; an ideal arm has none.
    #[must_use]
    pub fn model(&self) -> Option<&ArmModel> {
        self.mechanics.as_ref().map(|arm| &arm.model)
    }
}
