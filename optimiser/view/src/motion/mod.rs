//! The motion of a plan for robots and other programs: a table ([`table`]), a program for the controller of a UR arm
//! ([`urscript`]), ROS 2 messages in a file ([`mcap`]). Nothing is simulated.
//!
//! | time    | tick k is k control periods after the motion begins; tick 0 is the start                           |
//! |---------|----------------------------------------------------------------------------------------------------|
//! | pose    | of the tool's frame in the world, exactly that of the plan's setpoint                               |
//! | between | the cubic spline ([`spline`]) through all ticks, whose slopes are the velocities; rest at both ends |
//! | joints  | those of an arm that holds the tool ([`powderline_simulator::arm`]), where there is one             |

pub mod mcap;
mod ros;
pub mod table;
pub mod urscript;

use powderline_shared::displacement::pose_at;
use powderline_shared::limits::Violation;
use powderline_shared::plan::{PlanReader, Version};
use powderline_shared::pose::Pose;

use powderline_simulator::arm::{ArmMotion, ToolPath, spline};

/// Where the tool of a plan is and how fast it goes, at each tick.
#[derive(Clone, Debug)]
pub struct Motion {
    /// Content hash of the plan.
    pub plan_hash: u64,
    /// Digest of the scene that the plan was made for.
    pub scene_digest: [u8; 32],
    /// What made the plan.
    pub version: Version,
    /// Where the tool is at each tick.
    pub path: ToolPath,
    /// Velocity of the tool's origin (m/s) and angular velocity (rad/s) at each tick, world axes.
    pub velocities: Vec<[f64; 6]>,
    /// The arm that makes the motion.
    pub arm: Option<ArmMotion>,
}

impl Motion {
    /// The motion of a plan, without an arm.
    ///
    /// # Errors
    /// The plan breaks its own limits.
    pub fn new(plan: &PlanReader<'_>) -> Result<Self, Violation> {
        plan.check_limits()?;
        let header = plan.header();
        let (start, lsb, period_us) = (header.start_pose(), header.lsb, header.control_period_us);
        let setpoints = plan.setpoints().map(|setpoint| pose_at(&start, setpoint, lsb));
        let poses: Vec<Pose> = std::iter::once(start).chain(setpoints).collect();
        let velocities = spline::per_second(spline::slopes(&ways(&poses)), period_us);
        Ok(Self {
            plan_hash: plan.content_hash(),
            scene_digest: header.scene_digest,
            version: header.optimiser_version,
            path: ToolPath { period_us, lsb, limits: header.limits, poses },
            velocities,
            arm: None,
        })
    }

    fn version_text(&self) -> String {
        let Version { major, minor, patch } = self.version;
        format!("{major}.{minor}.{patch}")
    }

    /// Digest of the scene, hexadecimal.
    fn digest_text(&self) -> String {
        self.scene_digest.iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

/// How far the tool has come at each tick, metres, and how far it has turned, radians: the sum of the ticks' rotation vectors,
/// whose derivative is the angular velocity but for an error of second order in the angle of one tick.
fn ways(poses: &[Pose]) -> Vec<[f64; 6]> {
    let mut turned = [0.0; 3];
    let mut before = poses.first().copied().unwrap_or_else(Pose::identity);
    let way = |pose: &Pose| {
        let step = before.displacement_to(pose);
        before = *pose;
        turned = std::array::from_fn(|axis| turned[axis] + step.rotation_rad[axis]);
        let ([x, y, z], [rx, ry, rz]) = (pose.position_m.into(), turned);
        [x, y, z, rx, ry, rz]
    };
    poses.iter().map(way).collect()
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "numbers that are written read back to the last bit")]
mod tests;
