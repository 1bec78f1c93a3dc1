//! ROS 2 messages, as far as a motion needs them, in CDR: what goes onto the wire and into bags.
//!
//! Fields have the names and the order of the messages' definitions, which lie in `assets/ros`.

use std::io;

use byteorder::LittleEndian;
use nalgebra::Vector3;
use powderline_shared::pose::Pose as Placed;
use serde::Serialize;

/// A message's type and definition.
pub(super) struct Kind {
    pub(super) name: &'static str,
    pub(super) definition: &'static str,
}

macro_rules! kind {
    ($package:literal, $message:literal) => {
        Kind {
            name: concat!($package, "/msg/", $message),
            definition: include_str!(concat!("../../assets/ros/", $message, ".msg")),
        }
    };
}

pub(super) const POSE_STAMPED: Kind = kind!("geometry_msgs", "PoseStamped");
pub(super) const TF_MESSAGE: Kind = kind!("tf2_msgs", "TFMessage");
pub(super) const JOINT_TRAJECTORY: Kind = kind!("trajectory_msgs", "JointTrajectory");
pub(super) const JOINT_STATE: Kind = kind!("sensor_msgs", "JointState");
pub(super) const POINT_CLOUD_2: Kind = kind!("sensor_msgs", "PointCloud2");

/// The joints of a UR arm, as its ROS driver calls them, from the base to the flange.
pub(super) const JOINT_NAMES: [&str; 6] = [
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
];

/// A number in a 32-bit float.
const FLOAT32: u8 = 7;

/// The bytes of a message: which encoding it is, then little-endian CDR.
pub(super) fn encoded(message: &impl Serialize) -> io::Result<Vec<u8>> {
    let mut bytes = vec![0, 1, 0, 0];
    let body = cdr_encoding::to_vec::<_, LittleEndian>(message).map_err(io::Error::other)?;
    bytes.extend(body);
    Ok(bytes)
}

/// A moment, and a length of time.
#[derive(Clone, Copy, Serialize)]
pub(super) struct Time {
    sec: i32,
    nanosec: u32,
}

impl Time {
    pub(super) fn from_us(time_us: u64) -> Self {
        Self { sec: (time_us / 1_000_000) as i32, nanosec: (time_us % 1_000_000) as u32 * 1_000 }
    }
}

#[derive(Serialize)]
pub(super) struct Header {
    stamp: Time,
    frame_id: &'static str,
}

impl Header {
    pub(super) fn new(time_us: u64, frame_id: &'static str) -> Self {
        Self { stamp: Time::from_us(time_us), frame_id }
    }
}

#[derive(Serialize)]
struct Xyz {
    x: f64,
    y: f64,
    z: f64,
}

impl From<Vector3<f64>> for Xyz {
    fn from(vector: Vector3<f64>) -> Self {
        Self { x: vector.x, y: vector.y, z: vector.z }
    }
}

#[derive(Serialize)]
struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

/// `geometry_msgs/msg/Pose` and, with the same layout, `geometry_msgs/msg/Transform`.
#[derive(Serialize)]
pub(super) struct Pose {
    position: Xyz,
    orientation: Quaternion,
}

impl From<&Placed> for Pose {
    fn from(pose: &Placed) -> Self {
        let turn = pose.orientation.quaternion();
        let orientation = Quaternion { x: turn.i, y: turn.j, z: turn.k, w: turn.w };
        Self { position: pose.position_m.into(), orientation }
    }
}

#[derive(Serialize)]
pub(super) struct PoseStamped {
    pub(super) header: Header,
    pub(super) pose: Pose,
}

#[derive(Serialize)]
pub(super) struct TransformStamped {
    pub(super) header: Header,
    pub(super) child_frame_id: &'static str,
    pub(super) transform: Pose,
}

#[derive(Serialize)]
pub(super) struct TfMessage {
    pub(super) transforms: Vec<TransformStamped>,
}

#[derive(Serialize)]
pub(super) struct JointTrajectoryPoint<'a> {
    pub(super) positions: &'a [f64],
    pub(super) velocities: &'a [f64],
    pub(super) accelerations: &'a [f64],
    pub(super) effort: &'a [f64],
    pub(super) time_from_start: Time,
}

#[derive(Serialize)]
pub(super) struct JointTrajectory<'a> {
    pub(super) header: Header,
    pub(super) joint_names: &'a [&'static str],
    pub(super) points: Vec<JointTrajectoryPoint<'a>>,
}

#[derive(Serialize)]
pub(super) struct JointState<'a> {
    pub(super) header: Header,
    pub(super) name: &'a [&'static str],
    pub(super) position: &'a [f64],
    pub(super) velocity: &'a [f64],
    pub(super) effort: &'a [f64],
}

#[derive(Serialize)]
struct PointField {
    name: &'static str,
    offset: u32,
    datatype: u8,
    count: u32,
}

/// Points with velocities, in the order of their numbers.
#[derive(Serialize)]
pub(super) struct PointCloud2 {
    header: Header,
    height: u32,
    width: u32,
    fields: Vec<PointField>,
    is_bigendian: bool,
    point_step: u32,
    row_step: u32,
    data: Vec<u8>,
    is_dense: bool,
}

impl PointCloud2 {
    /// Positions in metres and velocities in m/s.
    pub(super) fn new(header: Header, points: impl Iterator<Item = ([f32; 3], [f32; 3])>) -> Self {
        let names = ["x", "y", "z", "vx", "vy", "vz"];
        let field =
            |(index, name): (u32, _)| PointField { name, offset: 4 * index, datatype: FLOAT32, count: 1 };
        let point_step = 4 * names.len() as u32;
        let numbers = points.flat_map(|(position, velocity)| position.into_iter().chain(velocity));
        let data: Vec<u8> = numbers.flat_map(f32::to_le_bytes).collect();
        let row_step = data.len() as u32;
        Self {
            header,
            height: 1,
            width: row_step / point_step,
            fields: (0..).zip(names).map(field).collect(),
            is_bigendian: false,
            point_step,
            row_step,
            data,
            is_dense: true,
        }
    }
}
