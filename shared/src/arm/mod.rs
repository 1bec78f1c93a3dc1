//! The kinematics of an arm of six joints, of Universal Robots' e-Series, as a model that has no state.
//!
//! [`ArmModel`] turns poses of the tool into joints ([`inverse`]) and back ([`links`]), always in one of the eight postures,
//! and refuses what a real arm would refuse: poses out of its reach, joints beyond their range or speed, and the
//! neighbourhood of singularities, where a small motion of the tool asks for a large one of the joints.
//!
//! All functions are those of `libm`: the same bits on every machine.

pub mod inverse;
mod kind;
pub mod links;

use core::fmt;

use nalgebra::{Matrix6, Quaternion, UnitQuaternion, Vector3};

use crate::fault::FaultCode;
use crate::pose::Pose;
use inverse::{OutOfReach, Posture};
pub use kind::{ArmFigures, ArmKind};
pub use links::Joints;
use links::SingularityMargins;

/// Joints may be off by this through rounding, radians: what the speed of a joint is not held against.
const ROUNDING_RAD: f64 = 1e-9;

/// An arm, how it is mounted and what it allows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmModel {
    /// Which arm.
    pub kind: ArmKind,
    /// Where the arm's base stands in the world.
    pub world_from_base: Pose,
    /// Where the tool's frame sits on the flange ("tool centre point").
    pub flange_from_tool: Pose,
    /// Which of the eight ways to reach a pose.
    pub posture: Posture,
    /// How far each joint may turn to either side, radians.
    pub joint_range_rad: [f64; 6],
    /// How fast each joint may turn, rad/s.
    pub joint_speed_rad_s: [f64; 6],
    /// Least of the [`SingularityMargins`] that is allowed, 0 to 1.
    ///
    /// Within a margin m, moving the flange asks of some joint about 1 / m times the speed that it asks for where the arm
    /// stands best. A twentieth is three degrees of the elbow or the wrist, 41 mm of the shoulder.
    pub singularity_margin: f64,
}

impl ArmModel {
    /// With the joints of that arm, which keeps a twentieth from singularities.
    #[must_use]
    pub fn new(kind: ArmKind, world_from_base: Pose, flange_from_tool: Pose, posture: Posture) -> Self {
        let figures = kind.figures();
        Self {
            kind,
            world_from_base,
            flange_from_tool,
            posture,
            joint_range_rad: figures.range_rad,
            joint_speed_rad_s: figures.speed_rad_s,
            singularity_margin: 0.05,
        }
    }

    /// That of the scene `bench`: the base 0.1 m below the bench's floor, 0.8 m in front of the volume's edge y = 0, forward
    /// along +y.
    ///
    /// The flange is held sideways, facing +y, 0.2 m before the tool's origin, by a bracket that reaches the handle over
    /// the container's wall. Its axis is the tool's pitch axis, so pitching is wrist 3 alone, and flange and arm stay
    /// beyond the bench's edge (y < 0). At a pitch of 90 degrees wrist 3 is in the middle of its range. The base is 0.26 m
    /// along x, which is the bench's middle and the wrist's sideways offset.
    #[must_use]
    pub fn bench() -> Self {
        let half_turn = core::f64::consts::FRAC_1_SQRT_2;
        let quaternion = |w, x, y, z| UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
        // The base's x axis towards -y: the arm reaches along its own -x.
        let world_from_base = Pose {
            position_m: Vector3::new(0.26, -0.8, -0.1),
            orientation: quaternion(half_turn, 0.0, 0.0, -half_turn),
        };
        // The tool's x, y and z axes are -y, z and -x of the flange.
        let flange_from_tool =
            Pose { position_m: Vector3::new(0.0, 0.0, 0.2), orientation: quaternion(0.5, 0.5, -0.5, -0.5) };
        Self::new(ArmKind::Ur5e, world_from_base, flange_from_tool, Posture::PREFERRED[0])
    }

    /// Pose of the tool in the world.
    #[must_use]
    pub fn world_from_tool(&self, joints: &Joints) -> Pose {
        let base_from_tool = links::base_from_flange(self.kind, joints).then(&self.flange_from_tool);
        self.world_from_base.then(&base_from_tool)
    }

    /// Velocity (m/s) of the tool's origin and angular velocity (rad/s) of the tool, world axes, for each joint turning by
    /// 1 rad/s: the geometric Jacobian.
    #[must_use]
    pub fn jacobian(&self, joints: &Joints) -> Matrix6<f64> {
        let base_from_tool = links::base_from_flange(self.kind, joints).then(&self.flange_from_tool);
        let rotation = self.world_from_base.orientation.to_rotation_matrix();
        let columns =
            links::twists(self.kind, joints, &base_from_tool.position_m).map(|[vx, vy, vz, wx, wy, wz]| {
                let [vx, vy, vz] = (rotation * Vector3::new(vx, vy, vz)).into();
                let [wx, wy, wz] = (rotation * Vector3::new(wx, wy, wz)).into();
                [vx, vy, vz, wx, wy, wz]
            });
        Matrix6::from(columns)
    }

    /// The joints that put the tool at a pose in the model's posture, each by whole turns as near to `near` as can be.
    ///
    /// # Errors
    /// The pose is out of reach, too near to a singularity, or beyond a joint's range.
    pub fn joints_near(&self, near: &Joints, world_from_tool: &Pose) -> Result<Joints, ArmError> {
        let world_from_flange = world_from_tool.then(&self.flange_from_tool.inverse());
        let base_from_flange = self.world_from_base.inverse().then(&world_from_flange);
        let joints = inverse::joints_of(self.kind, &base_from_flange, self.posture)?;
        let joints = inverse::unwound(&joints, near);
        self.check_joints(&joints)?;
        Ok(joints)
    }

    /// The joints that put the tool at a pose in the model's posture, if they can be there `dt_s` seconds after `from`.
    ///
    /// # Errors
    /// As for [`ArmModel::joints_near`], or a joint would have to turn faster than it may.
    pub fn joints_after(&self, from: &Joints, world_from_tool: &Pose, dt_s: f64) -> Result<Joints, ArmError> {
        let joints = self.joints_near(from, world_from_tool)?;
        self.check_speed(from, &joints, dt_s.max(0.0))?;
        Ok(joints)
    }

    /// Checks joints that the arm is to stand at.
    ///
    /// # Errors
    /// They are too near to a singularity, or one is beyond its range.
    pub fn check_joints(&self, joints: &Joints) -> Result<(), ArmError> {
        self.check_margin(joints)?;
        self.check_range(joints)
    }

    fn check_margin(&self, joints: &Joints) -> Result<(), ArmError> {
        let (joint, margin) = SingularityMargins::of(self.kind, joints).least();
        if margin >= self.singularity_margin {
            Ok(())
        } else {
            Err(ArmError::Singular { joint, margin, bound: self.singularity_margin })
        }
    }

    fn check_range(&self, joints: &Joints) -> Result<(), ArmError> {
        for ((joint, angle_rad), bound_rad) in (1..).zip(*joints).zip(self.joint_range_rad) {
            let within = angle_rad.abs() <= bound_rad;
            if !within {
                return Err(ArmError::JointLimit { joint, angle_rad, bound_rad });
            }
        }
        Ok(())
    }

    /// Checks that the joints can get from `from` to `to` in `dt_s` seconds.
    ///
    /// # Errors
    /// A joint would have to turn faster than it may.
    pub fn check_speed(&self, from: &Joints, to: &Joints, dt_s: f64) -> Result<(), ArmError> {
        for (((joint, from), to), bound_rad_s) in (1..).zip(from).zip(to).zip(self.joint_speed_rad_s) {
            let step_rad = (to - from).abs();
            let within = step_rad <= bound_rad_s * dt_s + ROUNDING_RAD;
            if !within {
                return Err(ArmError::JointSpeed { joint, speed_rad_s: step_rad / dt_s, bound_rad_s });
            }
        }
        Ok(())
    }
}

/// What an arm cannot do: the joint, counted from the base and from 1, what it would take, and what there is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ArmError {
    /// No joints put the tool there.
    Unreachable {
        /// 1: the wrist would be within the base's column; 3: too far from the shoulder, or too near to it.
        joint: u8,
        /// Distance of the wrist from axis 1, or from the shoulder, metres.
        distance_m: f64,
        /// The most if it is smaller than the distance, the least if it is larger, metres.
        bound_m: f64,
    },
    /// A joint would have to turn too far.
    JointLimit {
        /// Which.
        joint: u8,
        /// The angle it would have, radians.
        angle_rad: f64,
        /// Largest angle to either side, radians.
        bound_rad: f64,
    },
    /// A joint would have to turn too fast.
    JointSpeed {
        /// Which.
        joint: u8,
        /// The speed it would have, rad/s.
        speed_rad_s: f64,
        /// Largest speed, rad/s.
        bound_rad_s: f64,
    },
    /// The pose is too near to a singularity.
    Singular {
        /// 1, 3 or 5, as in [`SingularityMargins`].
        joint: u8,
        /// Margin at the pose.
        margin: f64,
        /// Least margin.
        bound: f64,
    },
}

impl ArmError {
    /// The fault that it is.
    #[must_use]
    pub const fn code(&self) -> FaultCode {
        match self {
            Self::Unreachable { .. } => FaultCode::ArmUnreachable,
            Self::JointLimit { .. } => FaultCode::ArmJointLimit,
            Self::JointSpeed { .. } => FaultCode::ArmJointSpeed,
            Self::Singular { .. } => FaultCode::ArmSingular,
        }
    }
}

impl From<OutOfReach> for ArmError {
    fn from(OutOfReach { joint, distance_m, bound_m }: OutOfReach) -> Self {
        Self::Unreachable { joint, distance_m, bound_m }
    }
}

impl fmt::Display for ArmError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Unreachable { joint, distance_m, bound_m } => {
                let side = if distance_m < bound_m { "least" } else { "most" };
                let from = if joint == 1 { "axis 1" } else { "the shoulder" };
                write!(
                    f,
                    "the wrist would be {distance_m:.4} m from {from}, and can be {bound_m:.4} m at the {side}"
                )
            }
            Self::JointLimit { joint, angle_rad, bound_rad } => write!(
                f,
                "joint {joint} would turn to {angle_rad:.4} rad, and turns {bound_rad:.4} rad to either side at the most"
            ),
            Self::JointSpeed { joint, speed_rad_s, bound_rad_s } => write!(
                f,
                "joint {joint} would turn at {speed_rad_s:.4} rad/s, and turns at {bound_rad_s:.4} rad/s at the most"
            ),
            Self::Singular { joint, margin, bound } => write!(
                f,
                "joint {joint} would come to a margin of {margin:.4} from a singularity, and needs {bound:.4} at the least"
            ),
        }
    }
}

impl core::error::Error for ArmError {}
