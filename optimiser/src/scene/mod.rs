//! The description of a bench: what `scene.toml` holds, with SI units in the key names.

use serde::{Deserialize, Serialize};

/// A whole bench, as written in TOML.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Name shown in reports.
    pub name: String,
    /// Simulated volume and grid.
    pub domain: Domain,
    /// Powder: where it lies and what it is made of.
    pub powder: Powder,
    /// Control period, substeps and horizon.
    pub time: Time,
    /// Open containers standing on the bench.
    pub container: Vec<Container>,
    /// Spoon or scoop, moved by the arm.
    pub tool: Tool,
    /// Five skill parameters and how they become a motion.
    pub skill: Skill,
    /// Limits that the motion must respect; copied into the plan and checked again by the arm.
    pub limits: Limits,
    /// What is wanted.
    pub objective: Objective,
    /// Optimiser settings.
    pub optimiser: Optimiser,
}

/// Simulated volume `[0, size]`, floor at z = 0, z up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Domain {
    pub size_m: [f64; 3],
    pub cell_m: f64,
    pub gravity_m_s2: [f64; 3],
    /// Coulomb friction of the domain's floor and walls.
    pub friction: f64,
    /// Width over which contact with tool, containers fades out beyond a surface, in cells.
    pub contact_band_cells: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Powder {
    pub fill_min_m: [f64; 3],
    pub fill_max_m: [f64; 3],
    pub particles_per_cell: u32,
    pub seed: u64,
    pub youngs_modulus_pa: f64,
    pub poissons_ratio: f64,
    pub density_kg_m3: f64,
    pub friction_angle_deg: f64,
    pub cohesion_pa: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Time {
    /// Control period, microseconds (one control step, one tick on the wire).
    pub control_period_us: u32,
    /// MPM substeps in one control step.
    pub substeps: u32,
    /// Control steps in the whole motion.
    pub horizon_steps: u32,
    /// Time the powder is given to settle, tool at rest at its start pose, before the motion starts.
    pub settle_s: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Container {
    pub name: String,
    /// Centre of the inner floor.
    pub position_m: [f64; 3],
    /// Rotation about the vertical.
    pub yaw_deg: f64,
    pub wall_thickness_m: f64,
    pub friction: f64,
    pub shape: ContainerShape,
}

/// Inner dimensions; open at the top.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum ContainerShape {
    Box { inner_size_m: [f64; 3] },
    Cylinder { inner_radius_m: f64, inner_height_m: f64 },
}

/// The tool's own frame: origin at the middle of the opening (rim plane), +z out of the opening, +x the
/// direction in which it scoops and pours (its lip), handle along -x.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tool {
    pub shape: ToolShape,
    pub wall_thickness_m: f64,
    pub friction: f64,
    /// Start position of the tool's origin.
    pub start_position_m: [f64; 3],
    /// Start pitch: how far the opening is tilted from straight up towards the scooping direction.
    pub start_pitch_deg: f64,
    pub handle: Handle,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum ToolShape {
    /// Hemispherical bowl.
    Bowl { inner_radius_m: f64 },
    /// Box scoop, open at +x (front) and +z (top): inner length (x), width (y), height (z).
    BoxScoop { inner_size_m: [f64; 3] },
}

/// Straight round rod (capsule) that starts at the tool's rear rim and runs along -x, raised by `rise_deg` towards +z.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Handle {
    pub length_m: f64,
    pub radius_m: f64,
    pub rise_deg: f64,
}

/// Theta in [-1, 1]^5 maps affinely to these bounds (low at -1, high at +1).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Skill {
    pub scooping_depth_m: [f64; 2],
    pub scooping_angle_deg: [f64; 2],
    pub lift_height_m: [f64; 2],
    pub transport_displacement_m: [f64; 2],
    pub pouring_angle_deg: [f64; 2],
    /// Where theta starts: each component drawn uniformly from this range by the run's seed.
    pub initial_theta: [[f64; 2]; 5],
    /// Horizontal direction of scooping and transport, counter-clockwise from +x.
    pub heading_deg: f64,
    /// Downward travel from the start pose to the powder's surface, before the scooping depth.
    pub approach_m: f64,
    /// Forward travel during the scoop segment.
    pub sweep_m: f64,
    /// Mean linear speed of each translating segment.
    pub linear_speed_m_s: f64,
    /// Mean angular speed of the scoop and pour segments.
    pub angular_speed_rad_s: f64,
    pub timing: Timing,
    pub profile: Profile,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Timing { Rounded, Continuous }

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Profile { ConstantSpeed, MinimumJerk }

/// Motion limits of the arm, of the tool's origin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    pub workspace_min_m: [f64; 3],
    pub workspace_max_m: [f64; 3],
    pub linear_velocity_m_s: f64,
    pub linear_acceleration_m_s2: f64,
    pub linear_jerk_m_s3: f64,
    pub angular_velocity_rad_s: f64,
    pub angular_acceleration_rad_s2: f64,
    pub angular_jerk_rad_s3: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Objective {
    /// Name of the source container.
    pub source: String,
    /// Name of the target container.
    pub target: String,
    /// The point that the loss draws the powder to.
    pub p_target_m: [f64; 3],
    /// How much powder should arrive.
    pub amount: Amount,
    pub norm: Norm,
    pub observation: Observation,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Amount { Particles(u32), MassKg(f64) }

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Norm { Euclidean, L1 }

/// Which particles the loss sees at the end of the motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Observation {
    All,
    /// A fixed random subset of this many particles.
    Subsample { particles: u32 },
    /// The particles that a camera above would see: the highest of each pixel column.
    VisibleFromAbove { pixel_m: f64 },
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Optimiser {
    pub epochs: u32,
    /// Epochs in which only depth, angle and lift are updated.
    pub curriculum_epochs: u32,
    pub learning_rate: f64,
    /// RMSprop's decay of the squared gradient.
    pub beta: f64,
    pub epsilon: f64,
}
