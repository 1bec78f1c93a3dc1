//! What must come out the same, bit for bit, on the microcontroller and on the host.
#![no_std]
#![forbid(unsafe_code)]

use powderline_shared::displacement::pose_at;
use powderline_shared::plan::{Fnv1a64, PlanReader};
use powderline_shared::pose::Pose;

/// The bits of every pose of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PoseBits {
    /// FNV-1a over the poses of all setpoints, in the order of their ticks.
    pub all: u64,
    /// The last pose: position (x, y, z), orientation (w, x, y, z).
    pub end: [u64; 7],
}

/// Walks the whole plan.
#[must_use]
pub fn pose_bits(plan: &PlanReader<'_>) -> PoseBits {
    let header = plan.header();
    let start = header.start_pose();
    let mut hash = Fnv1a64::default();
    let mut end = bits(&start);
    for setpoint in plan.setpoints() {
        end = bits(&pose_at(&start, setpoint, header.lsb));
        for number in end {
            hash.update(&number.to_le_bytes());
        }
    }
    PoseBits { all: hash.value(), end }
}

fn bits(pose: &Pose) -> [u64; 7] {
    let [x, y, z]: [f64; 3] = pose.position_m.into();
    let q = pose.orientation;
    [x, y, z, q.w, q.i, q.j, q.k].map(f64::to_bits)
}
