//! The motion as a table: columns with their units in their names, a row for each tick.
//!
//! | columns                                   | what                                                              |
//! |-------------------------------------------|-------------------------------------------------------------------|
//! | `time_s`                                  | since the beginning                                               |
//! | `x_m`, `y_m`, `z_m`                       | origin of the tool's frame in the world                           |
//! | `qw`, `qx`, `qy`, `qz`                    | unit quaternion from tool to world coordinates                    |
//! | `vx_m_s`, `vy_m_s`, `vz_m_s`              | velocity of the origin, world axes                                |
//! | `wx_rad_s`, `wy_rad_s`, `wz_rad_s`        | angular velocity, world axes                                      |
//! | `joint1_rad` .. `joint6_rad`              | joints from the base to the flange, where there is an arm         |
//! | `joint1_rad_s` .. `joint6_rad_s`          | their speeds                                                      |
//!
//! Numbers are the shortest that read back as the same bits.

use std::io::{self, Write};

use powderline_shared::plan::{Mounting, StartPose};
use serde::ser::{Serialize, SerializeMap, Serializer};

use super::Motion;

const POSE: [&str; 7] = ["x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"];
const VELOCITY: [&str; 6] = ["vx_m_s", "vy_m_s", "vz_m_s", "wx_rad_s", "wy_rad_s", "wz_rad_s"];
const JOINTS: [&str; 6] =
    ["joint1_rad", "joint2_rad", "joint3_rad", "joint4_rad", "joint5_rad", "joint6_rad"];
const SPEEDS: [&str; 6] =
    ["joint1_rad_s", "joint2_rad_s", "joint3_rad_s", "joint4_rad_s", "joint5_rad_s", "joint6_rad_s"];

/// Writes the table as comma-separated values.
///
/// # Errors
/// What the system says.
pub fn write_csv(out: &mut dyn Write, motion: &Motion) -> io::Result<()> {
    writeln!(out, "{}", names(motion).join(","))?;
    for tick in 0..=motion.path.last_tick() {
        let row: Vec<String> = row(motion, tick).iter().map(f64::to_string).collect();
        writeln!(out, "{}", row.join(","))?;
    }
    Ok(())
}

/// Writes one JSON object on one line: what the motion is of, and under `motion` the table's columns by their names.
///
/// # Errors
/// What the system says.
pub fn write_json(out: &mut dyn Write, motion: &Motion) -> io::Result<()> {
    serde_json::to_writer(&mut *out, &Document::new(motion))?;
    writeln!(out)
}

fn names(motion: &Motion) -> Vec<&'static str> {
    let joints = motion.arm.iter().flat_map(|_| JOINTS.into_iter().chain(SPEEDS));
    ["time_s"].into_iter().chain(POSE).chain(VELOCITY).chain(joints).collect()
}

fn row(motion: &Motion, tick: usize) -> Vec<f64> {
    let StartPose { position_m, orientation_wxyz } = StartPose::from(&motion.path.poses[tick]);
    let joints = motion.arm.iter().flat_map(|arm| arm.joints[tick].into_iter().chain(arm.speeds[tick]));
    let pose = position_m.into_iter().chain(orientation_wxyz);
    std::iter::once(motion.path.time_s(tick))
        .chain(pose)
        .chain(motion.velocities[tick])
        .chain(joints)
        .collect()
}

/// The JSON object.
#[derive(serde::Serialize)]
struct Document<'a> {
    plan_hash: String,
    scene_digest: String,
    optimiser_version: String,
    period_s: f64,
    steps: usize,
    translation_lsb_m: f64,
    rotation_lsb_rad: f64,
    arm: Option<Arm>,
    motion: Columns<'a>,
}

/// An arm and how it stands, as JSON says it.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Arm {
    /// Name, as the command line takes it.
    pub model: &'static str,
    /// Base in the world: metres, unit quaternion (w, x, y, z).
    pub world_from_base: StartPose,
    /// Plan's tool frame in the flange, likewise.
    pub flange_from_tool: StartPose,
    /// Whether it reaches forward, not backward over its base.
    pub reaches_forward: bool,
    /// Whether its elbow is up, not down.
    pub elbow_up: bool,
    /// Whether the sine of joint 5 is positive.
    pub wrist_positive: bool,
}

impl<'a> Document<'a> {
    fn new(motion: &'a Motion) -> Self {
        Self {
            plan_hash: format!("{:016x}", motion.plan_hash),
            scene_digest: motion.digest_text(),
            optimiser_version: motion.version_text(),
            period_s: motion.path.period_s(),
            steps: motion.path.last_tick(),
            translation_lsb_m: motion.path.lsb.translation_m(),
            rotation_lsb_rad: motion.path.lsb.rotation_rad(),
            arm: motion.arm.as_ref().map(|arm| Arm::from(&Mounting::from(&arm.model))),
            motion: Columns(motion),
        }
    }
}

impl From<&Mounting> for Arm {
    fn from(arm: &Mounting) -> Self {
        Self {
            model: arm.kind.name(),
            world_from_base: arm.world_from_base,
            flange_from_tool: arm.flange_from_tool,
            reaches_forward: arm.posture.reaches_forward,
            elbow_up: arm.posture.elbow_is_up(),
            wrist_positive: arm.posture.wrist_positive,
        }
    }
}

struct Columns<'a>(&'a Motion);

impl Serialize for Columns<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let rows: Vec<Vec<f64>> = (0..=self.0.path.last_tick()).map(|tick| row(self.0, tick)).collect();
        let names = names(self.0);
        let mut map = serializer.serialize_map(Some(names.len()))?;
        for (column, name) in names.into_iter().enumerate() {
            let values: Vec<f64> = rows.iter().map(|row| row[column]).collect();
            map.serialize_entry(name, &values)?;
        }
        map.end()
    }
}
