//! The tool's way in the world, which an arm is to make.

use crate::skill::{LSB, QuantisedControls, SkillMap};
use powderline_shared::displacement::{Lsb, pose_at};
use powderline_shared::limits::Limits;
use powderline_shared::pose::Pose;

/// Where the tool is at each tick, and what its motion keeps.
#[derive(Clone, Debug)]
pub struct ToolPath {
    /// From tick to tick, microseconds.
    pub period_us: u32,
    /// What a count of the plan is worth: a pose is within half of it on each axis.
    pub lsb: Lsb,
    /// What the motion keeps.
    pub limits: Limits,
    /// Tool in the world at each tick, the start first; at least that one.
    pub poses: Vec<Pose>,
}

impl ToolPath {
    /// The way of a skill's motion.
    #[must_use]
    pub fn of_skill(map: &SkillMap, motion: &QuantisedControls) -> Self {
        let start = *map.start_pose();
        let setpoints = motion.setpoints.iter().map(|setpoint| pose_at(&start, *setpoint, LSB));
        Self {
            period_us: map.control_period_us(),
            lsb: LSB,
            limits: *map.limits(),
            poses: std::iter::once(start).chain(setpoints).collect(),
        }
    }

    /// The last tick.
    #[must_use]
    pub fn last_tick(&self) -> usize {
        self.poses.len() - 1
    }

    /// Microseconds from the beginning to a tick.
    #[must_use]
    pub fn time_us(&self, tick: usize) -> u64 {
        tick as u64 * u64::from(self.period_us)
    }

    /// Seconds from the beginning to a tick.
    #[must_use]
    pub fn time_s(&self, tick: usize) -> f64 {
        self.time_us(tick) as f64 / 1e6
    }

    /// Length of the motion, seconds.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.time_s(self.last_tick())
    }

    /// From tick to tick, seconds.
    #[must_use]
    pub fn period_s(&self) -> f64 {
        f64::from(self.period_us) / 1e6
    }
}
