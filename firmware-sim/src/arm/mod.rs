//! The mechanics behind the controller: an arm of six joints, or an ideal one that is where it is told to be.
//!
//! [`Arm::new`] is a UR5e on a stand ([`ArmModel`]). It takes poses and turns them into joints itself, always in the posture
//! that it began with, and refuses what a real one would refuse. Its joints follow with the lag of a drive ([`servo`]), so
//! where it is and where it is told to be are two things.
//!
//! Nothing here allocates, and all functions are those of `libm`: the same bits on every machine.

pub mod servo;

use powderline_shared::arm::{ArmError, ArmModel, Joints};
use powderline_shared::pose::Pose;

use servo::Lag;

/// An arm: where it is told to be, and where it is.
#[derive(Clone, Copy, Debug)]
pub struct Arm {
    commanded: Pose,
    pose: Pose,
    mechanics: Option<Mechanics>,
}

/// An arm that has joints.
#[derive(Clone, Copy, Debug)]
struct Mechanics {
    model: ArmModel,
    lag: Lag,
    commanded: Joints,
    real: Joints,
}

impl Arm {
    /// Standing at `pose`, in the model's posture, each joint within half a turn of zero.
    ///
    /// # Errors
    /// The arm cannot stand there.
    pub fn new(model: ArmModel, lag: Lag, pose: Pose) -> Result<Self, ArmError> {
        let joints = model.joints_near(&[0.0; 6], &pose)?;
        let mechanics = Mechanics { model, lag, commanded: joints, real: joints };
        Ok(Self { commanded: pose, pose, mechanics: Some(mechanics) })
    }

    /// An arm without joints that is where it is told to be, at once and wherever that is.
    #[must_use]
    pub fn ideal(pose: Pose) -> Self {
        Self { commanded: pose, pose, mechanics: None }
    }

    /// Whether the arm would take `commanded` as its next setpoint, `dt_s` seconds after the one it has.
    ///
    /// # Errors
    /// It would not.
    pub fn check(&self, commanded: &Pose, dt_s: f64) -> Result<(), ArmError> {
        self.mechanics.map_or(Ok(()), |arm| arm.model.joints_after(&arm.commanded, commanded, dt_s).map(drop))
    }

    /// Lets `dt_s` seconds go by, in which the command goes, joint by joint in a straight line, from the last one to
    /// `commanded`.
    ///
    /// # Errors
    /// The arm does not take `commanded`. Its last command stands, and the joints go on towards that.
    pub fn follow(&mut self, commanded: Pose, dt_s: f64) -> Result<(), ArmError> {
        let Some(arm) = &mut self.mechanics else {
            (self.commanded, self.pose) = (commanded, commanded);
            return Ok(());
        };
        let accepted = arm.model.joints_after(&arm.commanded, &commanded, dt_s);
        let from = arm.commanded;
        if let Ok(joints) = accepted {
            (self.commanded, arm.commanded) = (commanded, joints);
        }
        arm.real = arm.lag.after(dt_s, &arm.real, &from, &arm.commanded);
        // Where nothing lags, the tool is at the very pose that was asked for, not at that of joints rounded on the way.
        #[expect(clippy::float_cmp, reason = "joints that are there are so to the last bit")]
        let there = arm.real == arm.commanded;
        self.pose = if there { self.commanded } else { arm.model.world_from_tool(&arm.real) };
        accepted.map(drop)
    }

    /// Where the tool is.
    #[must_use]
    pub fn pose(&self) -> Pose {
        self.pose
    }

    /// Where the tool is told to be.
    #[must_use]
    pub fn commanded(&self) -> Pose {
        self.commanded
    }

    /// Where the joints are, radians; an ideal arm has none.
    #[must_use]
    pub fn joints(&self) -> Option<Joints> {
        self.mechanics.map(|arm| arm.real)
    }
}
