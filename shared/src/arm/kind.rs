//! Which arm: one table of lengths, ranges, speeds and sizes.

use core::f64::consts::{PI, TAU};

use serde::{Deserialize, Serialize};

/// An arm whose kinematics are known: Universal Robots' e-Series.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ArmKind {
    /// UR3e.
    Ur3e,
    /// UR5e.
    Ur5e,
    /// UR10e.
    Ur10e,
    /// UR16e.
    Ur16e,
    /// UR20.
    Ur20,
    /// UR30.
    Ur30,
}

/// What tells one arm from another.
///
/// | figure | source |
/// |---|---|
/// | lengths | Universal Robots, "DH Parameters for calculations of kinematics and dynamics"; the same as in its ROS description, `ur_description`, `config/*/default_kinematics.yaml` |
/// | speeds | there, `config/*/joint_limits.yaml` |
/// | ranges | the data sheets: a whole turn to either side. The UR3e's joint 6 turns without end, and is held to that all the same; planners often hold the elbow to half a turn |
/// | reach, payload | the data sheets |
/// | offsets beside the arm's plane | there, `config/*/physical_parameters.yaml`: `shoulder_offset`, `elbow_offset` |
/// | radii | the farthest vertex of the collision mesh there, `meshes/*/collision`, from the capsule's axis, rounded up to 5 mm; boxes likewise |
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmFigures {
    /// Height of the shoulder above the base, metres.
    pub d1_m: f64,
    /// Length of the upper arm, metres; negative, since the arm stretches against its x axes.
    pub a2_m: f64,
    /// Length of the forearm, metres; negative as well.
    pub a3_m: f64,
    /// Sideways offset of the wrist from the arm's plane, metres.
    pub d4_m: f64,
    /// From wrist 1 to wrist 2, metres.
    pub d5_m: f64,
    /// From wrist 2 to the flange, metres.
    pub d6_m: f64,
    /// How far each joint turns to either side, radians.
    pub range_rad: [f64; 6],
    /// How fast each joint turns, rad/s.
    pub speed_rad_s: [f64; 6],
    /// How far upper arm and forearm lie beside the arm's plane, along its normal, metres.
    pub beside_m: [f64; 2],
    /// Radii of the capsules that hold the links, in the order of [`super::links::Link::ALL`], metres.
    pub radius_m: [f64; 5],
    /// Boxes about the axes of upper arm and forearm, narrower than their capsules: half their width in the arm's plane, which is also how far
    /// they go beyond either end, and half their width along its normal, metres; the forearm's without the elbow's housing, which no wrist
    /// gets at.
    pub half_box_m: [[f64; 2]; 2],
    /// Radius of the capsule about axis 1, from the base to the shoulder, that holds base and shoulder, metres.
    pub column_radius_m: f64,
    /// What it reaches, metres.
    pub reach_m: f64,
    /// What it carries, kilograms.
    pub payload_kg: f64,
}

impl ArmKind {
    /// All.
    pub const ALL: [Self; 6] = [Self::Ur3e, Self::Ur5e, Self::Ur10e, Self::Ur16e, Self::Ur20, Self::Ur30];

    /// As files and programs name it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ur3e => "ur3e",
            Self::Ur5e => "ur5e",
            Self::Ur10e => "ur10e",
            Self::Ur16e => "ur16e",
            Self::Ur20 => "ur20",
            Self::Ur30 => "ur30",
        }
    }

    /// As people name it.
    #[must_use]
    pub const fn label(self) -> &'static str {
        match self {
            Self::Ur3e => "UR3e",
            Self::Ur5e => "UR5e",
            Self::Ur10e => "UR10e",
            Self::Ur16e => "UR16e",
            Self::Ur20 => "UR20",
            Self::Ur30 => "UR30",
        }
    }

    /// Its figures.
    #[must_use]
    pub const fn figures(self) -> &'static ArmFigures {
        match self {
            Self::Ur3e => &UR3E,
            Self::Ur5e => &UR5E,
            Self::Ur10e => &UR10E,
            Self::Ur16e => &UR16E,
            Self::Ur20 => &UR20,
            Self::Ur30 => &UR30,
        }
    }
}

impl ArmFigures {
    /// Longest and shortest distance that upper arm and forearm span, metres.
    #[must_use]
    pub fn span_m(&self) -> [f64; 2] {
        [-(self.a2_m + self.a3_m), libm::fabs(self.a3_m - self.a2_m)]
    }
}

const UR3E: ArmFigures = ArmFigures {
    d1_m: 0.15185,
    a2_m: -0.24355,
    a3_m: -0.2132,
    d4_m: 0.13105,
    d5_m: 0.08535,
    d6_m: 0.0921,
    range_rad: [TAU; 6],
    speed_rad_s: [PI, PI, PI, TAU, TAU, TAU],
    beside_m: [0.120, 0.027],
    radius_m: [0.075, 0.060, 0.060, 0.060, 0.040],
    half_box_m: [[0.050, 0.060], [0.040, 0.055]],
    column_radius_m: 0.080,
    reach_m: 0.5,
    payload_kg: 3.0,
};

const UR5E: ArmFigures = ArmFigures {
    d1_m: 0.1625,
    a2_m: -0.425,
    a3_m: -0.3922,
    d4_m: 0.1333,
    d5_m: 0.0997,
    d6_m: 0.0996,
    range_rad: [TAU; 6],
    speed_rad_s: [PI; 6],
    beside_m: [0.138, 0.007],
    radius_m: [0.100, 0.080, 0.070, 0.070, 0.045],
    half_box_m: [[0.065, 0.080], [0.060, 0.060]],
    column_radius_m: 0.095,
    reach_m: 0.85,
    payload_kg: 5.0,
};

const UR10E: ArmFigures = ArmFigures {
    d1_m: 0.1807,
    a2_m: -0.6127,
    a3_m: -0.57155,
    d4_m: 0.17415,
    d5_m: 0.11985,
    d6_m: 0.11655,
    range_rad: [TAU; 6],
    speed_rad_s: [PI * 2.0 / 3.0, PI * 2.0 / 3.0, PI, PI, PI, PI],
    beside_m: [0.1762, 0.0393],
    radius_m: [0.115, 0.085, 0.085, 0.085, 0.055],
    half_box_m: [[0.080, 0.095], [0.060, 0.070]],
    column_radius_m: 0.125,
    reach_m: 1.3,
    payload_kg: 12.5,
};

const UR16E: ArmFigures = ArmFigures {
    a2_m: -0.4784,
    a3_m: -0.36,
    beside_m: [0.176, 0.040],
    reach_m: 0.9,
    payload_kg: 16.0,
    ..UR10E
};

const UR20: ArmFigures = ArmFigures {
    d1_m: 0.2363,
    a2_m: -0.862,
    a3_m: -0.7287,
    d4_m: 0.201,
    d5_m: 0.1593,
    d6_m: 0.1543,
    range_rad: [TAU; 6],
    speed_rad_s: [
        PI * 2.0 / 3.0,
        PI * 2.0 / 3.0,
        PI * 5.0 / 6.0,
        PI * 7.0 / 6.0,
        PI * 7.0 / 6.0,
        PI * 7.0 / 6.0,
    ],
    beside_m: [0.260, 0.043],
    radius_m: [0.160, 0.130, 0.100, 0.100, 0.060],
    half_box_m: [[0.095, 0.135], [0.080, 0.085]],
    column_radius_m: 0.165,
    reach_m: 1.75,
    payload_kg: 20.0,
};

const UR30: ArmFigures = ArmFigures { a2_m: -0.637, a3_m: -0.5037, reach_m: 1.3, payload_kg: 30.0, ..UR20 };
