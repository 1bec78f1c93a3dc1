//! Whether an arm can make a skill's motion, and how: its joints from tick to tick and between, kept from singularities, from the
//! ends of their ranges and from speeds that they do not have, and its links from table, containers, gates and each other.
//!
//! | what | where |
//! |---|---|
//! | the tool's way that is to be made | [`ToolPath`] |
//! | how the arm stands and holds the tool | [`Mount`]; of a scene by [`Mount::of`], of a plan by [`Mount::of_plan`] |
//! | what is around it | [`Surroundings`] |
//! | what passes through what of the arm itself | [`Contact`] |
//! | its joints, or why there are none | [`ArmMotion`], [`Refusal`] |
//! | the path between two ticks | [`spline`] |
//! | the ways to a motion's start and back | [`Transit`] |
//!
//! Links are capsules about the lines between the joints' axes. What joins flange and handle is the user's own and not looked at;
//! handle and tool are, by [`crate::skill::collision`].

mod motion;
mod path;
mod self_collision;
pub mod spline;
mod surroundings;
mod transit;

pub use motion::{ArmMotion, Clearance, Figures, Mount, Refusal, cycles_us};
pub use path::ToolPath;
pub use self_collision::{Contact, Part};
pub use surroundings::Surroundings;
pub use transit::{Around, Transit, TransitError};

use crate::scene::{Arm, Scene};
use crate::skill::{QuantisedControls, SkillMap, Theta};
use nalgebra::Vector3;
use powderline_shared::plan::Mounting;
use powderline_shared::pose::{Pose, exp_so3, renormalised};

/// From one setpoint of an arm's controller to the next, microseconds: the 500 Hz of UR's e-Series.
pub const CYCLE_US: u32 = 2_000;

/// A pose from its position (m) and roll, pitch, yaw (degrees) about the fixed x, y, z axes in turn.
#[must_use]
pub fn pose(position_m: [f64; 3], rotation_deg: [f64; 3]) -> Pose {
    let about = |axis: Vector3<f64>, angle_deg: f64| exp_so3(&(axis * angle_deg.to_radians()));
    let [roll, pitch, yaw] = rotation_deg;
    let orientation = about(Vector3::z(), yaw) * about(Vector3::y(), pitch) * about(Vector3::x(), roll);
    Pose { position_m: position_m.into(), orientation: renormalised(orientation) }
}

impl Mount {
    /// How a scene's arm stands and holds the tool.
    #[must_use]
    pub fn of(arm: &Arm) -> Self {
        Self {
            kind: arm.kind,
            world_from_base: pose(arm.base_position_m, arm.base_rotation_deg),
            flange_from_tool: pose(arm.tool_position_m, arm.tool_rotation_deg),
            posture: arm.posture.map(Into::into),
            near: None,
            clearance_m: Some(arm.clearance_m),
        }
    }

    /// How a plan's arm stands and holds the tool; `clearance_m` as [`Mount::clearance_m`], which a plan does not say.
    #[must_use]
    pub fn of_plan(arm: &Mounting, clearance_m: Option<f64>) -> Self {
        Self {
            kind: arm.kind,
            world_from_base: arm.world_from_base.pose(),
            flange_from_tool: arm.flange_from_tool.pose(),
            posture: Some(arm.posture),
            near: None,
            clearance_m,
        }
    }
}

/// What a scene's arm does to make a skill's motion; nothing if the scene has no arm.
///
/// # Errors
/// What the arm cannot do first, in the posture that gets furthest.
pub fn arm_motion(
    scene: &Scene,
    map: &SkillMap,
    motion: &QuantisedControls,
) -> Result<Option<ArmMotion>, Refusal> {
    let Some(arm) = &scene.arm else { return Ok(None) };
    let around = Surroundings::of_scene(scene, arm.table_height_m);
    ArmMotion::new(&ToolPath::of_skill(map, motion), &Mount::of(arm), &around, CYCLE_US).map(Some)
}

/// What a scene's arm can do, by the middle and the corners of the ranges in `[skill]`.
#[derive(Clone, Debug)]
pub struct Ability {
    /// How it makes the motion in the middle of all ranges.
    pub middle: Result<ArmMotion, Refusal>,
    /// A corner whose motion it cannot make, if there is one, or else the middle.
    pub unable: Option<(Theta, Refusal)>,
    /// It can make none of them.
    pub none: bool,
}

impl Ability {
    /// Looks at a valid scene; nothing if it has no arm.
    #[must_use]
    pub fn of(scene: &Scene) -> Option<Self> {
        let arm = scene.arm.as_ref()?;
        let (map, mut mount) = (SkillMap::new(scene), Mount::of(arm));
        let around = Surroundings::of_scene(scene, arm.table_height_m);
        let path = |theta: &Theta| Some(ToolPath::of_skill(&map, &map.quantise(theta).ok()?));
        let middle = ArmMotion::new(&path(&Theta::MIDDLE)?, &mount, &around, CYCLE_US);
        let any_posture = mount;
        // What does in the middle mostly does in the corners.
        mount.posture = mount.posture.or_else(|| middle.as_ref().ok().map(|arm| arm.model.posture));
        let can = |path: &ToolPath| match ArmMotion::new(path, &mount, &around, CYCLE_US) {
            Err(_) => ArmMotion::new(path, &any_posture, &around, CYCLE_US).map(drop),
            Ok(_) => Ok(()),
        };
        let tried: Vec<(Theta, Result<(), Refusal>)> =
            Theta::lattice(2).filter_map(|theta| Some((theta, can(&path(&theta)?)))).collect();
        let none = middle.is_err() && tried.iter().all(|(_, can)| can.is_err());
        let unable = tried.into_iter().find_map(|(theta, can)| Some((theta, can.err()?)));
        let unable = unable.or_else(|| Some((Theta::MIDDLE, middle.as_ref().err()?.clone())));
        Some(Self { middle, unable, none })
    }
}
