//! The motion as ROS 2 messages in an MCAP file, for Foxglove, Rerun, PlotJuggler and `ros2 bag`.
//!
//! | topic               | message                          | when                     | frames               |
//! |---------------------|----------------------------------|--------------------------|----------------------|
//! | `/tool_pose`        | `geometry_msgs/PoseStamped`      | at each tick             | world                |
//! | `/tf`               | `tf2_msgs/TFMessage`             | at each tick             | world to tool, base  |
//! | `/joint_trajectory` | `trajectory_msgs/JointTrajectory`| once, at the beginning   | base                 |
//! | `/joint_states`     | `sensor_msgs/JointState`         | at each tick             | base                 |
//! | `/powder`           | `sensor_msgs/PointCloud2`        | at each simulated frame  | world                |
//!
//! Joints and the frame `base`, which is the controller's, are there if there is an arm, powder if it is asked for. Times
//! begin at 0. The file is not compressed.

use std::io::{self, Write};
use std::path::PathBuf;

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{McapError, WriteOptions, Writer};
use serde::Serialize;

use super::Motion;
use super::ros::{self, Header, Kind};
use crate::{Destination, Frame, Sink, ViewError};
use powderline_simulator::arm::ArmMotion;

const WORLD: &str = "world";
const TOOL: &str = "tool";
const BASE: &str = "base";

/// Writes the motion.
///
/// # Errors
/// What the system says.
pub fn write(out: &mut dyn Write, motion: &Motion) -> io::Result<()> {
    Messages::new(out, motion)?.finish()
}

/// Takes the powder's frames into the file that has the motion.
pub struct Recording<W: Write> {
    path: PathBuf,
    messages: Messages<W>,
    powder: Channel,
}

impl<W: Write> Recording<W> {
    /// Writes the motion. The path is for error messages.
    ///
    /// # Errors
    /// What the system says.
    pub fn new(out: W, motion: &Motion, path: impl Into<PathBuf>) -> Result<Self, ViewError> {
        let path = path.into();
        let error = |source| ViewError::File { path: path.clone(), source };
        let mut messages = Messages::new(out, motion).map_err(error)?;
        let powder = messages.channel("/powder", &ros::POINT_CLOUD_2).map_err(error)?;
        Ok(Self { path, messages, powder })
    }
}

impl<W: Write> Sink for Recording<W> {
    fn frame(&mut self, frame: &Frame<'_>) -> Result<(), ViewError> {
        let time_us = (1e6 * frame.time_s).round() as u64;
        let points = crate::export::particles(frame).map(|(position, velocity, _)| (position, velocity));
        let cloud = ros::PointCloud2::new(Header::new(time_us, WORLD), points);
        let written = self.messages.write(&mut self.powder, time_us, &cloud);
        written.map_err(|source| ViewError::File { path: self.path.clone(), source })
    }

    fn finish(&mut self, _destinations: &[Destination]) -> Result<(), ViewError> {
        self.messages.finish().map_err(|source| ViewError::File { path: self.path.clone(), source })
    }
}

/// A topic, and how many messages it has had.
struct Channel {
    id: u16,
    count: u32,
}

struct Messages<W: Write> {
    writer: Writer<NoSeek<W>>,
}

impl<W: Write> Messages<W> {
    fn new(out: W, motion: &Motion) -> io::Result<Self> {
        let options = WriteOptions::new()
            .profile("ros2")
            .library(format!("powderline {}", env!("CARGO_PKG_VERSION")))
            .compression(None)
            .disable_seeking(true);
        let writer = options.create(NoSeek::new(out)).map_err(io_error)?;
        let mut messages = Self { writer };
        messages.write_metadata(motion)?;
        if let Some(arm) = &motion.arm {
            messages.write_trajectory(motion, arm)?;
        }
        messages.write_ticks(motion)?;
        Ok(messages)
    }

    fn write_metadata(&mut self, motion: &Motion) -> io::Result<()> {
        let metadata = [
            ("plan_hash", format!("{:016x}", motion.plan_hash)),
            ("scene_digest", motion.digest_text()),
            ("optimiser_version", motion.version_text()),
            ("period_us", motion.path.period_us.to_string()),
        ];
        let metadata = metadata.map(|(name, value)| (name.to_owned(), value)).into();
        self.writer.write_metadata(&Metadata { name: "powderline".into(), metadata }).map_err(io_error)
    }

    fn write_trajectory(&mut self, motion: &Motion, arm: &ArmMotion) -> io::Result<()> {
        let point = |tick: usize| ros::JointTrajectoryPoint {
            positions: &arm.joints[tick],
            velocities: &arm.speeds[tick],
            accelerations: &[],
            effort: &[],
            time_from_start: ros::Time::from_us(motion.path.time_us(tick)),
        };
        let trajectory = ros::JointTrajectory {
            header: Header::new(0, BASE),
            joint_names: &ros::JOINT_NAMES,
            points: (0..=motion.path.last_tick()).map(point).collect(),
        };
        let mut channel = self.channel("/joint_trajectory", &ros::JOINT_TRAJECTORY)?;
        self.write(&mut channel, 0, &trajectory)
    }

    fn write_ticks(&mut self, motion: &Motion) -> io::Result<()> {
        let mut poses = self.channel("/tool_pose", &ros::POSE_STAMPED)?;
        let mut transforms = self.channel("/tf", &ros::TF_MESSAGE)?;
        let arm = motion.arm.as_ref();
        let mut states = arm.map(|_| self.channel("/joint_states", &ros::JOINT_STATE)).transpose()?;
        for (tick, tool) in motion.path.poses.iter().enumerate() {
            let time_us = motion.path.time_us(tick);
            let header = |frame_id| Header::new(time_us, frame_id);
            let pose = ros::PoseStamped { header: header(WORLD), pose: tool.into() };
            self.write(&mut poses, time_us, &pose)?;
            let base = arm.map(|arm| (BASE, &arm.model.world_from_base));
            let frames = [(TOOL, tool)].into_iter().chain(base);
            let transform = |(child_frame_id, pose): (&'static str, _)| ros::TransformStamped {
                header: header(WORLD),
                child_frame_id,
                transform: ros::Pose::from(pose),
            };
            self.write(
                &mut transforms,
                time_us,
                &ros::TfMessage { transforms: frames.map(transform).collect() },
            )?;
            if let (Some(arm), Some(states)) = (arm, &mut states) {
                let state = ros::JointState {
                    header: header(BASE),
                    name: &ros::JOINT_NAMES,
                    position: &arm.joints[tick],
                    velocity: &arm.speeds[tick],
                    effort: &[],
                };
                self.write(states, time_us, &state)?;
            }
        }
        Ok(())
    }

    fn channel(&mut self, topic: &str, kind: &Kind) -> io::Result<Channel> {
        let definition = kind.definition.as_bytes();
        let schema = self.writer.add_schema(kind.name, "ros2msg", definition).map_err(io_error)?;
        let id = self.writer.add_channel(schema, topic, "cdr", &Default::default()).map_err(io_error)?;
        Ok(Channel { id, count: 0 })
    }

    fn write(&mut self, channel: &mut Channel, time_us: u64, message: &impl Serialize) -> io::Result<()> {
        let (sequence, time_ns) = (channel.count, 1_000 * time_us);
        channel.count += 1;
        let header =
            MessageHeader { channel_id: channel.id, sequence, log_time: time_ns, publish_time: time_ns };
        self.writer.write_to_known_channel(&header, &ros::encoded(message)?).map_err(io_error)
    }

    fn finish(&mut self) -> io::Result<()> {
        self.writer.finish().map(drop).map_err(io_error)
    }
}

fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        error => io::Error::other(error),
    }
}
