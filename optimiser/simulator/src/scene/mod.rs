//! The description of a bench: what `scene.toml` holds, with SI units in the key names.
//!
//! A [`Scene`] is valid: every number lies in the range documented at its field, and the fields agree with each
//! other. It comes from [`Scene::load`], from [`Scene::from_toml`], or from a [`SceneSpec`], which has the same fields
//! with anything in them, by [`SceneSpec::validate`]. World frame: z up, floor at z = 0, the simulated volume is
//! `[0, domain.size_m]`.
//!
//! Five scenes come along:
//!
//! | Name | Particles | Cell | Tool, inside | Wanted | What it is |
//! |---|---|---|---|---|---|
//! | `bench` | 11,264 of 8 mg | 4 mm | bowl, radius 16 mm | 9.6 g | the default, box to box |
//! | `bench-small` | 2,772 of 8 mg | 4 mm | bowl, radius 10 mm | 1.6 g | a smaller one, for tests |
//! | `bench-fine` | 90,112 of 1 mg | 2 mm | bowl, radius 16 mm | 9.6 g | `bench`, cells half as wide |
//! | `vial` | 7,168 of 2.092 mg | 3 mm | box scoop, 18 x 15 x 10.5 mm | 1 g | light powder into a vial |
//! | `workcell` | 7,168 of 1.35 mg | 3 mm | box scoop, 18 x 12 x 10.5 mm | 600 mg | into a narrow vial, arm and powder on one table |
//!
//! A scene may have gates ([`Gate`]): walls that are there until they open, at a time after the
//! motion's start, for a column that is released, a slide below a hopper, a lock. Their motion is
//! prescribed, so nothing is differentiated by it. Powder fills a box or the round column in it
//! ([`FillShape`]).
//!
//! To build one in code, load the one that is nearest and change its fields, [`Scene::with`]. Some advice:
//! - What is to be resolved (a wall, a heap, the inside of a tool) should be four cells wide or
//!   high; a slope of a heap that is two cells high means nothing.
//! - Faces of containers lie best on grid nodes (multiples of the cell) or midway;
//!   [`Scene::warnings`] names those that do not.
//! - A finer cell needs more substeps: [`SceneSpec::cfl_number`] must be at most [`MAX_CFL`], and
//!   viscosity takes at most [`MAX_VISCOUS_LOSS`].
//! - A core advances 10 to 20 million particles by a substep in a second; a gradient costs about
//!   five times as much.
//!
//! # The scene `bench`
//!
//! ```toml
#![doc = include_str!("../../scenes/bench.toml")]
//! ```

mod amount;
mod arm;
mod canonical;
mod capacity;
mod closest_match;
mod coarse;
mod derived;
mod embedded;
mod error;
mod feasible;
pub mod figures;
mod gate;
mod packing;
mod parse;
mod path;
mod read;
mod refined;
mod remarks;
mod ruler;
mod solid;
mod timing;
mod tool;
mod valid;
mod validate;

use crate::skill::{Freedom, USUAL_KNOTS};
use serde::{Deserialize, Serialize};

pub use amount::{Amount, DEFAULT_TOLERANCE, Quantity};
pub use arm::{Arm, Elbow, PostureChoice, Shoulder, TurnBack, Wrist};
pub use canonical::{DIGEST_VERSION, Digest};
pub use capacity::Capacity;
pub use closest_match::closest_match;
pub use derived::{
    BLOCK_CELLS, MAX_CELLS, MAX_CFL, MAX_PARTICLES, MAX_SUBSTEPS, MAX_VISCOUS_LOSS, PADDING_BLOCKS,
};
pub use embedded::{DEFAULT_SCENE, EMBEDDED_SCENES, embedded_scene};
pub use error::SceneError;
pub use feasible::{Infeasible, Remedy};
pub use gate::{Gate, GateOpening, GateShape, MAX_GATES};
pub use powderline_shared::limits::Limits;
pub use read::MAX_SCENE_BYTES;
pub use solid::Obstacle;
pub(crate) use tool::PlacedTool;
pub use tool::{Cuboid, Handle, MAX_CUBOIDS, Tool, ToolPart, ToolShape};
pub use valid::Scene;

/// A whole bench, as written in TOML, valid or not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneSpec {
    /// Name shown in reports, 1 to 64 printable characters.
    pub name: String,
    /// Simulated volume and grid.
    pub domain: Domain,
    /// Powder: where it lies and what it is made of.
    pub powder: Powder,
    /// Control period, substeps and horizon.
    pub time: Time,
    /// Open containers standing on the bench, 2 to 16, none overlapping another.
    #[serde(rename = "container")]
    pub containers: Vec<Container>,
    /// Walls that are there until they open, 0 to [`MAX_GATES`]; none if the file has none.
    #[serde(rename = "gate", default)]
    pub gates: Vec<Gate>,
    /// Spoon or scoop, moved by the arm.
    pub tool: Tool,
    /// Five skill parameters and how they become a motion.
    pub skill: Skill,
    /// Limits that the motion must respect; copied into the plan and checked again by the arm.
    pub limits: Limits,
    /// The arm that makes the motion; none if the file has none, and then nobody looks whether one can.
    #[serde(default)]
    pub arm: Option<Arm>,
    /// What is wanted.
    pub objective: Objective,
}

/// Simulated volume `[0, size]`, floor at z = 0, z up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Domain {
    /// Extent along x, y, z, metres; each 0.01 to 10, typically 0.1 to 0.5. Rounded up to whole cells.
    pub size_m: [f64; 3],
    /// Edge of a grid cell, metres; 0.0001 to 0.1, typically 0.002 to 0.005.
    pub cell_m: f64,
    /// Gravity, m/s^2; each component -100 to 100, on Earth `[0, 0, -9.81]`.
    pub gravity_m_s2: [f64; 3],
    /// Coulomb friction of the domain's floor and walls, dimensionless; 0 to 2, typically 0.4.
    pub friction: f64,
    /// Width over which contact with tool and containers fades out beyond a surface, in cells; 0.01
    /// to 2, typically 0.25.
    pub contact_band_cells: f64,
    /// Whether powder on one side of a wall has its own grid nodes; [`Walls::Shared`] if the file does not say.
    #[serde(default)]
    pub walls: Walls,
    /// Blocks of powder (4 x 4 x 4 cells) that stay slower than this for 0.03 s fall asleep: their
    /// particles stay as they are, at rest to within this speed, and cost nothing. They wake when
    /// the tool, or a gate that moves, comes within two cells, a gate as near vanishes, a node of
    /// theirs moves or a particle arrives. m/s; 0 to 0.01, typically 0.001; 0: never.
    pub sleep_speed_m_s: f64,
    /// Which speed of a block that is, and which nodes wake it; [`SleepBy::Largest`] if the file does not say.
    #[serde(default)]
    pub sleep_by: SleepBy,
    /// What neighbours feel of powder that sleeps; [`Sleepers::Moving`] if the file does not say.
    #[serde(default)]
    pub sleepers: Sleepers,
}

/// With which velocity powder sleeps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Sleepers {
    /// With that with which it fell asleep: it stays where it is, but goes on giving its momentum to its neighbours, and what lies on an
    /// incline beside it creeps by up to the speed below which powder falls asleep.
    #[default]
    Moving,
    /// With none.
    Still,
}

/// By what powder at rest is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum SleepBy {
    /// By the fastest particle of a block. Powder that is thinner than a cell, as at the foot of a heap, then never comes to rest, and the
    /// heap sinks by some percent in ten seconds.
    #[default]
    Largest,
    /// By the root of the mean square over a block, of speeds after contact. Nodes with less than a twentieth of a
    /// full one's mass wake nobody. The source has the definitions, in `mpm/sleep.rs`.
    MeanSquare,
}

/// What the two sides of a wall have to do with each other: of containers, gates, and the tool without its handle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Walls {
    /// Both share the grid's nodes in it. A sixth of a pressure is felt on the other side, powder lets go of
    /// walls late, and is packed too densely on those that are curved.
    #[default]
    Shared,
    /// Powder on either side has nodes of its own: nothing is felt through a wall, and powder that lets go falls freely. Who is on which
    /// side is looked at every few substeps; where somebody changes sides the forward pass has a small jump, which the exact adjoint, as
    /// any derivative, does not see. The source has the definitions, in `mpm/walls.rs`.
    TwoSided,
}

/// Powder: its initial box, its sampling by particles and its material.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Powder {
    /// Lower corner of the box filled with powder, metres, world frame; clear of walls, as a rule inside the source container.
    pub fill_min_m: [f64; 3],
    /// Upper corner of the box filled with powder, metres, world frame.
    pub fill_max_m: [f64; 3],
    /// What of that box is filled; all of it if the file does not say.
    #[serde(default)]
    pub fill_shape: FillShape,
    /// Particles per grid cell of powder; 1 to 64, typically 8.
    pub particles_per_cell: u32,
    /// What programs take for the seed of [`crate::rollout::SimulatorSettings`] if they are given
    /// none; a simulator takes that one alone. 0 to 2^64 - 1.
    pub seed: u64,
    /// Young's modulus, pascal; 100 to 1e9, typically 1e4. Real grains are stiffer; the CFL number
    /// limits it.
    pub youngs_modulus_pa: f64,
    /// Poisson's ratio, dimensionless; 0 to 0.49, typically 0.2.
    pub poissons_ratio: f64,
    /// Bulk density, kg/m^3; 10 to 25,000, typically 1000.
    pub density_kg_m3: f64,
    /// Angle of internal friction `phi` in triaxial compression, degrees; 0 to 60, typically 35; at
    /// most 36.8 with [`YieldSurface::DruckerPrager`]. What it is in other states of stress,
    /// `yield` says. With `flow` it is between those of powder at rest and flowing powder, at most 35.2 with
    /// [`YieldSurface::DruckerPrager`].
    pub friction_angle_deg: f64,
    /// Whether powder that flows has less friction than powder at rest; none if the file has none: one angle for both.
    #[serde(default)]
    pub flow: Option<Flow>,
    /// Form of the yield surface.
    #[serde(rename = "yield")]
    pub yield_surface: YieldSurface,
    /// What holds the powder's volume together.
    pub volume_correction: VolumeCorrection,
    /// Shear strain over which powder comes to be as loose as the grid sees it, where density falls by itself within a cell (`R = 1`), and
    /// `R^2` of that elsewhere; dimensionless; 0.001 to 100, typically 1. None if the file has none: at once, even at rest, and heaps that are awake slowly flatten. Needs
    /// [`VolumeCorrection::Grid`]. The source has the equations, in `mpm/density.rs`.
    #[serde(default)]
    pub loosening_strain: Option<f64>,
    /// What of the particles' velocities survives the grid; none if the file has none: nothing that is finer than the grid (APIC).
    #[serde(default)]
    pub transfer: Option<Transfer>,
    /// Mohr-Coulomb cohesion in plane strain, as a shear cell measures it, pascal; 0 (dry sand) to 1e5, for cohesive powder about 50. Needs a
    /// friction angle.
    pub cohesion_pa: f64,
    /// Mean tension at which cohesive powder parts, pascal; 0 to [`Powder::apex_tension_pa`], the tension
    /// at the apex of the yield surface, typically half of that. Powder that has parted loses it, and its cohesion,
    /// over the first 5 % of volume that it opens by, and has both again when it is pressed together.
    /// None (the key left out): it parts at the apex, and bears that tension as often as it comes there.
    #[serde(default)]
    pub tensile_strength_pa: Option<f64>,
    /// Shear viscosity of the flowing powder, Pa s; 0 to 100, typically 0.08. Besides being
    /// physical it keeps single grains on the surface from amplifying the smallest disturbance,
    /// without which gradients of long motions are noise.
    pub viscosity_pa_s: f64,
}

/// Form of the yield surface. Either goes through the triaxial compression corners of Mohr-Coulomb's,
/// `|s| = sqrt(2/3) 6 sin(phi)/(3 - sin(phi)) p` with the mean stress `p` and the deviator's norm
/// `|s|`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum YieldSurface {
    /// Drucker and Prager's round cone, the paper's. In other states of stress than compression it
    /// is the stronger one: 35 degrees act as 55 in plane strain and as 68 in triaxial extension.
    /// From 36.87 degrees on (`sin(phi) = 0.6`) it would carry tension there, so such angles are
    /// refused.
    DruckerPrager,
    /// Matsuoka and Nakai's surface, `I1 I2/I3 = 9 + 8 tan^2(phi)` in the invariants of the stress: the
    /// same angle in compression and in extension, and up to 4 degrees more in between, as sands
    /// have it (35 degrees act as 39 in plane strain).
    MatsuokaNakai,
}

/// What of the particles' velocities survives the grid.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Transfer {
    /// What the grid cannot hold of the powder's velocity is given back and decays in this time, seconds; 0.0001 to 10,
    /// typically 0.05, a few times `sqrt(cell_m/9.81)`. Without it that is lost in every substep: powder then flows the less far the
    /// shorter the substeps are, and the stiffer it is. The source has the equations, in `mpm/residue.rs`.
    pub residue_time_s: f64,
}

/// Powder with two angles: at rest its yield surface is 1.05 times, flowing 0.95 times as steep as that of its friction angle. It
/// passes from the one to the other smoothly around the inertial number `d rate sqrt(rho_s/pressure)` of 0.1. Both factors are
/// what columns of sand run out by and how high they stay, as far as poured heaps still stand at their friction angle. The source
/// has the equations, in `mpm/material.rs`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Flow {
    /// Diameter `d` of a grain, metres; 1e-6 to 0.01, typically 0.0005.
    pub grain_diameter_m: f64,
    /// Density `rho_s` of what grains are made of, kg/m^3; 10 to 25,000, typically 1.6 times the bulk density.
    pub grain_density_kg_m3: f64,
}

/// How powder that has come apart knows when it touches again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum VolumeCorrection {
    /// Each particle adds up the volume that it has gained (Tampubolon et al. 2017). What it adds up
    /// is noise where powder flies and tumbles: poured powder then lies at 0.8 to 1.8 of its density.
    Strain,
    /// That sum is held to the density that the grid sees: poured powder lies at its density to within
    /// some hundredths. The source has the bounds, in `mpm/density.rs`.
    Grid,
}

/// What of the fill box is filled with powder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FillShape {
    /// All of it.
    #[default]
    Box,
    /// The upright round column inscribed in it, which must be as long as wide.
    Cylinder,
}

/// Control period, substeps and horizon.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Time {
    /// Control period, microseconds (one control step, one tick on the wire); 100 to 100,000, typically
    /// 10,000.
    pub control_period_us: u32,
    /// MPM substeps in one control step; 1 to 10,000, typically 20. The CFL number sets the lower end.
    pub substeps: u32,
    /// Control steps in the whole motion; 1 to 100,000, typically 500. The longest skill must fit in.
    pub horizon_steps: u32,
    /// Time the powder is given to settle, tool at rest at its start pose, before the motion
    /// starts, seconds; 0 to 60, typically 0.2.
    pub settle_s: f64,
}

/// A container standing in the domain, open at the top.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Container {
    /// Name, 1 to 64 printable characters, unique in the scene; `objective` refers to it.
    pub name: String,
    /// Centre of the inner floor, metres, world frame. The container's floor plate lies below it,
    /// one wall thickness thick: a container that stands on the domain's floor has z =
    /// `wall_thickness_m`.
    pub position_m: [f64; 3],
    /// Rotation about the vertical, degrees, counter-clockwise from above; -360 to 360.
    pub yaw_deg: f64,
    /// Thickness of walls and floor, metres; half a cell to 1, typically one cell.
    pub wall_thickness_m: f64,
    /// Coulomb friction of walls and floor, dimensionless; 0 to 2, typically 0.4. A heap keeps its
    /// foot only on a floor whose friction is about that of the powder, the tangent of its angle,
    /// or more.
    pub friction: f64,
    /// Shape and inner dimensions.
    pub shape: ContainerShape,
}

/// Inner dimensions; open at the top.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum ContainerShape {
    /// Rectangular box.
    Box {
        /// Inner length (x), width (y) and height (z) in the container's own frame, metres; each
        /// one cell to 10.
        inner_size_m: [f64; 3],
    },
    /// Upright round cylinder.
    Cylinder {
        /// Inner radius, metres; one cell to 10.
        inner_radius_m: f64,
        /// Inner height, metres; one cell to 10.
        inner_height_m: f64,
    },
    /// Upright round cylinder with a round hole in the middle of its floor, through which powder flows out. A gate may shut it; what
    /// has come through is no longer in the container.
    Silo {
        /// Inner radius, metres; one cell to 10.
        inner_radius_m: f64,
        /// Inner height, metres; one cell to 10.
        inner_height_m: f64,
        /// Radius of the hole, metres; one cell to `inner_radius_m`. Powder flows evenly through holes at least 12 cells across.
        outlet_radius_m: f64,
    },
    /// Upright round cylinder above a cone that narrows to a round hole; of no cylinder, a funnel. The middle of the hole is the
    /// container's place. A gate may shut it; what has come through is no longer in the container.
    Hopper {
        /// Inner radius of the cylinder, metres; two cells to 10.
        inner_radius_m: f64,
        /// Inner height from the hole to the rim, cone and cylinder together, metres; at least the cone's, at most 10.
        inner_height_m: f64,
        /// Radius of the hole, metres; one cell to one less than `inner_radius_m`.
        outlet_radius_m: f64,
        /// From the vertical to the cone's wall, degrees; 5 to 85.
        half_angle_deg: f64,
    },
    /// Rectangular box with a slot across the whole of its floor, in the middle and along its y axis, through which powder flows out. A
    /// gate may shut it; what has come through is no longer in the container.
    SlottedBox {
        /// Inner length (x), width (y) and height (z) in the container's own frame, metres; each
        /// one cell to 10.
        inner_size_m: [f64; 3],
        /// Width of the slot, along x, metres; one cell to the inner length.
        slot_width_m: f64,
    },
}

impl ContainerShape {
    /// Height of the cone of a hopper, metres; 0 of what has none.
    pub fn cone_height_m(&self) -> f64 {
        match *self {
            Self::Hopper { inner_radius_m, outlet_radius_m, half_angle_deg, .. } => {
                (inner_radius_m - outlet_radius_m) / libm::tan(half_angle_deg.to_radians())
            }
            _ => 0.0,
        }
    }

    /// From which height on a hopper has an upright wall, metres: from as low as its cone's outer edge, so that no gap is left between
    /// them, and over no less than the wall's thickness. None of a funnel, which ends with its cone.
    pub(crate) fn upright_from_m(&self, wall_m: f64) -> Option<f64> {
        let Self::Hopper { inner_height_m, half_angle_deg, .. } = *self else { return None };
        let top_m = self.cone_height_m();
        let (sin, _) = libm::sincos(half_angle_deg.to_radians());
        let low_m = (top_m - wall_m * sin).min(inner_height_m - wall_m);
        // Heights are written to some digits.
        (inner_height_m > top_m * (1.0 + 1e-3)).then_some(low_m)
    }

    /// How far the inside of a round one goes from its axis, so high above its place, metres; none of a box.
    pub(crate) fn inner_radius_at_m(&self, height_m: f64) -> Option<f64> {
        match *self {
            Self::Box { .. } | Self::SlottedBox { .. } => None,
            Self::Cylinder { inner_radius_m, .. } | Self::Silo { inner_radius_m, .. } => Some(inner_radius_m),
            Self::Hopper { inner_radius_m, outlet_radius_m, half_angle_deg, .. } => {
                let widened = height_m.max(0.0) * libm::tan(half_angle_deg.to_radians());
                Some(inner_radius_m.min(outlet_radius_m + widened))
            }
        }
    }
}

/// Theta in [-1, 1]^5 maps affinely to these bounds (low at -1, high at +1); low equal to high fixes a
/// parameter.
///
/// The motion: straight down by `approach_m` + depth; pitch back by the scooping angle while moving
/// `sweep_m` forward; straight up by the lift; forward by the transport displacement; pitch forward
/// by the pouring angle; rest until the horizon. It is that of the tool's origin, about which the
/// tool is pitched: in the end the pitch is the start's - scooping angle + pouring angle, and the
/// origin has gone sweep + transport forward.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Skill {
    /// Depth of the tool's lowest point below the powder's surface, metres; 0.0001 to 1.
    pub scooping_depth_m: [f64; 2],
    /// Rotation of the opening back up (pitch decreases by it), degrees; 1 to 180.
    pub scooping_angle_deg: [f64; 2],
    /// Height of the lift from the end of the scoop, metres; 0.001 to 5.
    pub lift_height_m: [f64; 2],
    /// Horizontal travel along the heading after the lift, metres; 0.001 to 5.
    pub transport_displacement_m: [f64; 2],
    /// Rotation of the opening towards the heading (pitch increases by it), degrees; 1 to 180.
    pub pouring_angle_deg: [f64; 2],
    /// Where theta starts: each component drawn uniformly from this range by the run's seed; -1 to 1.
    pub initial_theta: [[f64; 2]; 5],
    /// Horizontal direction of scooping and transport, degrees counter-clockwise from +x; -360 to 360.
    pub heading_deg: f64,
    /// Downward travel from the start pose until the tool's lowest point meets the powder's
    /// surface, before the scooping depth, metres; 0.0001 to 1, typically 0.02.
    pub approach_m: f64,
    /// Forward travel during the scoop segment, metres; 0 to 1, typically 0.016.
    pub sweep_m: f64,
    /// Mean linear speed of each translating segment, m/s; 0.001 to 5, typically 0.14. With
    /// `minimum_jerk` the peak is 1.875 times as high.
    pub linear_speed_m_s: f64,
    /// Mean angular speed of the scoop and pour segments, rad/s; 0.01 to 50, typically 1.5. With
    /// `minimum_jerk` the peak is 1.875 times as high.
    pub angular_speed_rad_s: f64,
    /// How far the transport begins before the lift ends, and the pour before the transport does: this share of `T1 T2 / (T1 + T2)`
    /// of their times, which is half of each where both take as long; 0 to 1. Not at all if the file does not say.
    #[serde(default)]
    pub overlap: f64,
    /// How segment lengths become segment times.
    pub timing: Timing,
    /// How the speed runs within a segment.
    pub profile: Profile,
    /// What a search of paths may add to the motion.
    #[serde(default)]
    pub path: PathSplines,
}

/// What a search of paths may add to a skill's motion: cubic B-splines in time, [`crate::skill::SplinePath`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PathSplines {
    /// Splines for each freedom, and so numbers to search; 1 to [`MAX_KNOTS`], [`USUAL_KNOTS`] if the file does not say.
    pub knots: u32,
    /// In which ways the tool may leave the skill's motion, each of them once; those in which the skill itself moves if the file does
    /// not say.
    pub freedoms: Vec<Freedom>,
}

impl Default for PathSplines {
    fn default() -> Self {
        Self { knots: USUAL_KNOTS, freedoms: Freedom::OF_SKILL.to_vec() }
    }
}

/// Splines that each freedom of a path may have.
pub const MAX_KNOTS: u32 = 64;

/// How segment lengths become segment times.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Timing {
    /// Every segment is rounded to whole control steps, as in the paper; the gradient takes the
    /// count as fixed.
    Rounded,
    /// Segments end at exact times and the motion is sampled at every control step.
    Continuous,
}

/// How the speed runs within a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Profile {
    /// The mean speed throughout, as in the paper; velocity jumps at both ends.
    ConstantSpeed,
    /// Quintic from rest to rest.
    MinimumJerk,
}

impl Profile {
    /// Largest velocity over the mean.
    pub fn peak_over_mean(self) -> f64 {
        match self {
            Self::ConstantSpeed => 1.0,
            Self::MinimumJerk => crate::skill::MINIMUM_JERK.velocity,
        }
    }
}

/// What is wanted: how much powder, where, and how it is judged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Objective {
    /// Name of the source container.
    pub source: String,
    /// Name of the target container, another one.
    pub target: String,
    /// The point that the loss draws the powder to, metres, world frame; inside the domain.
    pub p_target_m: [f64; 3],
    /// How much powder should arrive.
    pub amount: Amount,
    /// What the loss asks for.
    pub aim: Aim,
    /// How the distance of a particle from `p_target_m` is measured.
    pub norm: Norm,
    /// Which particles the loss sees.
    pub observation: Observation,
    /// What powder beside the containers or on their rims costs the loss: so many times what missing powder costs, the distance
    /// from `p_target_m` to the source. Nothing if the file does not say.
    #[serde(default)]
    pub lost_weight: f64,
}

/// What the loss asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Aim {
    /// The wanted amount at `p_target_m`, and the rest where it came from. With the distances `d_i`
    /// of the particles from `p_target_m`, n wanted ones, and the distance `D` of the nearest point
    /// inside the source: the sum of `d_i` over the n nearest, plus the sum of `max(0, D - d_i)`
    /// over all others.
    Amount,
    /// All powder at `p_target_m`, as in the paper: as much as can be had, whatever amount is
    /// wanted. The sum of all `d_i`.
    All,
}

/// How a particle's distance from the target point is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Norm {
    /// Straight-line distance.
    Euclidean,
    /// Sum of the distances along x, y and z.
    L1,
}

impl Norm {
    /// Of a vector, in its own unit.
    pub fn length(self, [x, y, z]: &[f64; 3]) -> f64 {
        match self {
            Self::Euclidean => libm::sqrt(x * x + y * y + z * z),
            Self::L1 => x.abs() + y.abs() + z.abs(),
        }
    }
}

/// Which particles the loss sees at the end of the motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
#[non_exhaustive]
pub enum Observation {
    /// Every particle.
    All,
    /// A fixed random subset of this many particles.
    Subsample {
        /// Size of the subset; 1 to all particles.
        particles: u32,
    },
    /// The particles that a camera above would see: the highest of each pixel column.
    VisibleFromAbove {
        /// Edge of a square pixel on the ground, metres; 0.0001 to 0.1.
        pixel_m: f64,
    },
}
