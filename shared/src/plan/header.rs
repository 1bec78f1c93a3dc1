//! What a plan says about itself.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::PlanError;
use crate::arm::inverse::Posture;
use crate::arm::{ArmKind, ArmModel};
use crate::census::Census;
use crate::displacement::{LSB_MAX, Lsb};
use crate::limits::Limits;
use crate::pose::Pose;

/// Shortest control period, microseconds.
pub const PERIOD_US_MIN: u32 = 100;
/// Longest control period, microseconds; a stop begins at a tick, so a longer one would delay it.
pub const PERIOD_US_MAX: u32 = 100_000;
/// Most steps of a plan: almost three hours at 100 Hz.
pub const MAX_STEPS: u32 = 1_000_000;

/// How far the norm of the start orientation may be from 1.
const UNIT_TOLERANCE: f64 = 1e-9;

/// Version of the program that made a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Version {
    /// Incompatible changes.
    pub major: u16,
    /// Additions.
    pub minor: u16,
    /// Repairs.
    pub patch: u16,
}

/// Floating-point numbers that the powder was simulated in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Precision {
    /// 32 bits.
    F32,
    /// 64 bits.
    F64,
}

impl Precision {
    /// Both.
    pub const ALL: [Self; 2] = [Self::F32, Self::F64];

    /// As options and reports write it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }
}

/// The anchor that the plan expects, as stored.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StartPose {
    /// Origin of the tool in the world, metres.
    pub position_m: [f64; 3],
    /// Unit quaternion (w, x, y, z) from tool to world coordinates.
    pub orientation_wxyz: [f64; 4],
}

impl From<&Pose> for StartPose {
    fn from(pose: &Pose) -> Self {
        let q = pose.orientation;
        Self { position_m: pose.position_m.into(), orientation_wxyz: [q.w, q.i, q.j, q.k] }
    }
}

impl StartPose {
    /// Takes the stored numbers as they are, so that the same bits come out on every machine.
    #[must_use]
    pub fn pose(&self) -> Pose {
        let [w, x, y, z] = self.orientation_wxyz;
        Pose {
            position_m: Vector3::from(self.position_m),
            orientation: UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)),
        }
    }
}

/// Provenance, motion and prediction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanHeader {
    /// Digest of the resolved scene that the plan was made for.
    pub scene_digest: [u8; 32],
    /// Version of the optimiser.
    pub optimiser_version: Version,
    /// Seed of the run.
    pub seed: u64,
    /// Number format of the simulation.
    pub precision: Precision,
    /// Parameters of the skill whose motion this is, or near which it is a path; normalised to [-1, 1], in the order of
    /// [`SkillParameter::ALL`](super::SkillParameter::ALL).
    pub theta: [f64; 5],
    /// The same in physical units: m, rad, m, m, rad.
    pub skill_parameters: [f64; 5],
    /// How many numbers say how the motion leaves the skill's: 0 where it is the skill's own.
    pub path_coefficients: u32,
    /// Control period, microseconds; one step of the body each.
    pub control_period_us: u32,
    /// Steps in the body.
    pub step_count: u32,
    /// What one count of the body is worth.
    pub lsb: Lsb,
    /// The anchor X0.
    pub start: StartPose,
    /// What the motion keeps.
    pub limits: Limits,
    /// What the quantised motion brings.
    pub predicted: Prediction,
    /// What it brings on a finer grid; none if nobody looked.
    pub finer: Option<Finer>,
    /// The arm that can make the motion, as was looked at when the plan was made; none if nobody looked.
    pub arm: Option<Mounting>,
}

/// An arm, how it stands and holds the tool, and how it reaches.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mounting {
    /// Which arm.
    pub kind: ArmKind,
    /// Its base in the world.
    pub world_from_base: StartPose,
    /// The tool's frame in the flange.
    pub flange_from_tool: StartPose,
    /// The posture that it keeps all the way.
    pub posture: Posture,
}

impl Mounting {
    /// The arm's kinematics.
    #[must_use]
    pub fn model(&self) -> ArmModel {
        ArmModel::new(self.kind, self.world_from_base.pose(), self.flange_from_tool.pose(), self.posture)
    }
}

impl From<&ArmModel> for Mounting {
    fn from(model: &ArmModel) -> Self {
        Self {
            kind: model.kind,
            world_from_base: StartPose::from(&model.world_from_base),
            flange_from_tool: StartPose::from(&model.flange_from_tool),
            posture: model.posture,
        }
    }
}

/// What a motion brings, as it was simulated; by default nothing, as of a motion without powder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Prediction {
    /// Loss, metres.
    pub loss_m: f64,
    /// Target count minus particles that arrive.
    pub indicator: i64,
    /// Mass that was wanted in the target container, kilograms.
    pub wanted_kg: f64,
    /// Mass of one particle, kilograms.
    pub particle_mass_kg: f64,
    /// Particles by where they are at the end.
    pub census: Census,
}

impl Prediction {
    /// What arrives in the target container, kilograms.
    #[must_use]
    pub fn arrives_kg(&self) -> f64 {
        f64::from(self.census.target) * self.particle_mass_kg
    }
}

/// What a motion brings on a finer grid than the one that it was found on, which says how far that is to be believed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finer {
    /// Edge of the grid's cells, metres.
    pub cell_m: f64,
    /// Loss, metres.
    pub loss_m: f64,
    /// Mass of one particle, kilograms.
    pub particle_mass_kg: f64,
    /// Particles by where they are at the end.
    pub census: Census,
}

impl Finer {
    /// What arrives in the target container, kilograms.
    #[must_use]
    pub fn arrives_kg(&self) -> f64 {
        f64::from(self.census.target) * self.particle_mass_kg
    }
}

impl PlanHeader {
    /// The anchor X0.
    #[must_use]
    pub fn start_pose(&self) -> Pose {
        self.start.pose()
    }

    /// Checks that every number can be meant.
    ///
    /// # Errors
    /// The first field that cannot.
    pub fn validate(&self) -> Result<(), PlanError> {
        self.check_finite()?;
        self.check_ranges()?;
        self.limits.validate()?;
        self.limits.check_resolution(self.lsb, self.control_period_us)?;
        Ok(())
    }

    fn check_finite(&self) -> Result<(), PlanError> {
        let start = &self.start;
        let [base, tool] = self.mounted();
        let finer = self.finer();
        let groups: [(&'static str, &[f64]); 14] = [
            ("theta", &self.theta),
            ("skill parameters", &self.skill_parameters),
            ("start position", &start.position_m),
            ("start orientation", &start.orientation_wxyz),
            ("predicted loss", &[self.predicted.loss_m]),
            ("wanted mass", &[self.predicted.wanted_kg]),
            ("mass of a particle", &[self.predicted.particle_mass_kg]),
            ("cell of the finer grid", &[finer.cell_m]),
            ("loss on the finer grid", &[finer.loss_m]),
            ("mass of a particle of the finer grid", &[finer.particle_mass_kg]),
            ("position of the arm's base", &base.position_m),
            ("orientation of the arm's base", &base.orientation_wxyz),
            ("position of the tool in the flange", &tool.position_m),
            ("orientation of the tool in the flange", &tool.orientation_wxyz),
        ];
        for (field, values) in groups {
            if let Some(&value) = values.iter().find(|value| !value.is_finite()) {
                return Err(PlanError::NotFinite { field, value });
            }
        }
        Ok(())
    }

    fn check_ranges(&self) -> Result<(), PlanError> {
        if let Some(&value) = self.theta.iter().find(|value| !(-1.0..=1.0).contains(*value)) {
            return Err(PlanError::ThetaOutOfRange { value });
        }
        let Prediction { wanted_kg, particle_mass_kg, .. } = self.predicted;
        let finer = self.finer();
        for (field, value) in [
            ("wanted mass", wanted_kg),
            ("mass of a particle", particle_mass_kg),
            ("mass of a particle of the finer grid", finer.particle_mass_kg),
        ] {
            if value < 0.0 {
                return Err(PlanError::NegativeMass { field, value });
            }
        }
        if finer.cell_m <= 0.0 {
            return Err(PlanError::NoCell { value: finer.cell_m });
        }
        in_range("control period in microseconds", self.control_period_us, PERIOD_US_MIN, PERIOD_US_MAX)?;
        in_range("step count", self.step_count, 1, MAX_STEPS)?;
        in_range("translation LSB in nanometres", self.lsb.translation_nm, 1, LSB_MAX)?;
        in_range("rotation LSB in nanoradians", self.lsb.rotation_nrad, 1, LSB_MAX)?;
        let [base, tool] = self.mounted();
        for (field, pose) in [
            ("start orientation", &self.start),
            ("orientation of the arm's base", &base),
            ("orientation of the tool in the flange", &tool),
        ] {
            let [w, x, y, z] = pose.orientation_wxyz;
            let norm = libm::sqrt(w * w + x * x + y * y + z * z);
            if libm::fabs(norm - 1.0) > UNIT_TOLERANCE {
                return Err(PlanError::OrientationNotUnit { field, norm });
            }
        }
        Ok(())
    }

    /// The finer grid; where there is none, one that stands for it.
    fn finer(&self) -> Finer {
        let none = Finer { cell_m: 1.0, loss_m: 0.0, particle_mass_kg: 0.0, census: Census::default() };
        self.finer.unwrap_or(none)
    }

    /// Base and tool of the arm; where there is none, poses that stand for them.
    fn mounted(&self) -> [StartPose; 2] {
        let none = StartPose::from(&Pose::identity());
        self.arm.map_or([none; 2], |arm| [arm.world_from_base, arm.flange_from_tool])
    }
}

fn in_range(field: &'static str, value: u32, min: u32, max: u32) -> Result<(), PlanError> {
    if (min..=max).contains(&value) { Ok(()) } else { Err(PlanError::OutOfRange { field, value, min, max }) }
}
