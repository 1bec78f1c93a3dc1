//! The arm as pictures and pages show it: the capsules of its links, the column that it turns on, and what holds the tool.
//!
//! Links are the capsules that are kept clear of everything around, so what is seen to touch that does touch; of each other, and of the column,
//! they are kept as [`powderline_simulator::arm::Contact`] has it. The bracket is only drawn: it says that the tool does not float.

use nalgebra::{Point3, Vector3};
use powderline_shared::arm::Joints;
use powderline_shared::arm::links::{Link, axes, base_from_flange, column_axis};
use powderline_shared::pose::Pose;
use powderline_simulator::arm::{ArmMotion, ToolPath};

use crate::extent::Extent;

/// Ticks from one posture to the next where all of them have to be in view.
const LOOKED_AT: usize = 10;

/// How thick a post below a raised base is, of the column's radius.
const POST: f64 = 0.6;

/// An arm, and what it does.
#[derive(Clone, Debug)]
pub struct Arm {
    /// Its joints at every tick.
    pub motion: ArmMotion,
    /// The tool's way that they make.
    pub path: ToolPath,
    /// Top of the table that it stands on, and the bench's block, metres.
    pub table_m: f64,
    /// Where a bracket takes hold of the tool, tool frame, metres.
    pub held_m: [f64; 3],
    /// How thick the bracket is, metres.
    pub bracket_radius_m: f64,
}

/// A rod with round ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    /// Ends of its axis, world frame, metres.
    pub ends_m: [[f64; 3]; 2],
    /// Metres.
    pub radius_m: f64,
}

impl Capsule {
    /// The box about it.
    #[must_use]
    pub fn extent(&self) -> Extent {
        let [a, b] = self.ends_m;
        let side =
            |axis: usize, pick: fn(f64, f64) -> f64, sign: f64| pick(a[axis], b[axis]) + sign * self.radius_m;
        Extent {
            low_m: [0, 1, 2].map(|axis| side(axis, f64::min, -1.0)),
            high_m: [0, 1, 2].map(|axis| side(axis, f64::max, 1.0)),
        }
    }
}

impl Arm {
    /// What stands still: the column from the base to the shoulder, and below a base that is raised, a post down to the table.
    #[must_use]
    pub fn standing(&self) -> Vec<Capsule> {
        let kind = self.motion.model.kind;
        let [base_m, shoulder_m] = column_axis(kind).map(|end| self.world(end));
        let radius_m = kind.figures().column_radius_m;
        let column = Capsule { ends_m: [base_m, shoulder_m], radius_m };
        // One that hangs or leans is held by something else.
        let is_raised = base_m[2] > self.table_m + 1e-6 && shoulder_m[2] > base_m[2];
        let post =
            Capsule { ends_m: [[base_m[0], base_m[1], self.table_m], base_m], radius_m: POST * radius_m };
        std::iter::once(column).chain(is_raised.then_some(post)).collect()
    }

    /// Frame of the flange in the world, so long after the motion's start, seconds.
    #[must_use]
    pub fn flange(&self, time_s: f64) -> Pose {
        let model = &self.motion.model;
        model.world_from_base.then(&base_from_flange(model.kind, &self.joints(time_s)))
    }

    fn joints(&self, time_s: f64) -> Joints {
        self.motion.joints_at(&self.path, (1e6 * time_s.max(0.0)).round() as u64)
    }

    /// What moves, so long after the motion's start, seconds: the links in the order of [`Link::ALL`], then the bracket.
    #[must_use]
    pub fn moving(&self, time_s: f64) -> [Capsule; 6] {
        let model = &self.motion.model;
        let joints = self.joints(time_s);
        let axes = axes(model.kind, &joints);
        let held_m = model.world_from_tool(&joints).world_from_tool(&self.held_m.into());
        let bracket =
            Capsule { ends_m: [self.world(axes[4][1]), held_m.into()], radius_m: self.bracket_radius_m };
        std::array::from_fn(|at| match Link::ALL.get(at) {
            Some(link) => {
                Capsule { ends_m: axes[at].map(|end| self.world(end)), radius_m: link.radius_m(model.kind) }
            }
            None => bracket,
        })
    }

    /// The box about all of it, above the table, wherever it goes.
    #[must_use]
    pub fn extent(&self) -> Extent {
        let ticks = (0..=self.path.last_tick()).step_by(LOOKED_AT).chain([self.path.last_tick()]);
        let moving = ticks.flat_map(|tick| self.moving(self.path.time_s(tick)));
        let boxes = moving.chain(self.standing()).map(|capsule| capsule.extent());
        let floor = Extent { low_m: self.world(Vector3::zeros()), high_m: self.world(Vector3::zeros()) };
        let mut all = boxes.fold(floor, |all, one| all.and(&one));
        all.low_m[2] = all.low_m[2].max(self.table_m);
        all
    }

    /// A point of the base's frame in the world.
    fn world(&self, point_m: Vector3<f64>) -> [f64; 3] {
        self.motion.model.world_from_base.world_from_tool(&point_m).into()
    }

    /// The side from which it is not between the reader and a point: 0, 90, 180 or 270 degrees, as a camera's azimuth counts.
    #[must_use]
    pub fn far_side_deg(&self, of_m: [f64; 3]) -> f64 {
        let towards = Point3::from(self.world(Vector3::zeros())) - Point3::from(of_m);
        match (towards.x.abs() > towards.y.abs(), towards.x > 0.0, towards.y > 0.0) {
            (false, _, true) => 0.0,
            (false, _, false) => 180.0,
            (true, true, _) => 270.0,
            (true, false, _) => 90.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::sample;

    fn distance(one: [f64; 3], other: [f64; 3]) -> f64 {
        (Vector3::from(one) - Vector3::from(other)).norm()
    }

    #[test]
    fn the_bodies_join_from_the_table_to_the_tool() {
        let arm = sample::arm();
        for tick in [0, 10, 20] {
            let time_s = arm.path.time_s(tick);
            let (standing, moving) = (arm.standing(), arm.moving(time_s));
            assert_eq!(standing.len(), 1, "the base stands on the table");
            assert!(distance(standing[0].ends_m[0], [0.26, -0.8, -0.1]) < 1e-12);
            // The shoulder's housing holds both the column's end and the upper arm's.
            let reach = standing[0].radius_m + moving[0].radius_m;
            assert!(distance(standing[0].ends_m[1], moving[0].ends_m[0]) < reach);
            // From forearm to flange each begins where the one before ends.
            for pair in moving[1..].windows(2) {
                assert!(distance(pair[0].ends_m[1], pair[1].ends_m[0]) < 1e-12, "{pair:?}");
            }
            let flange = arm.flange(time_s);
            assert!(distance(moving[5].ends_m[0], flange.position_m.into()) < 1e-12);
            // The bracket ends at the handle of the tool, which is where the motion has it.
            let held = arm.path.poses[tick].world_from_tool(&arm.held_m.into());
            assert!(distance(moving[5].ends_m[1], held.into()) < 1e-9);
            let tool = flange.then(&arm.motion.model.flange_from_tool);
            assert!((tool.position_m - arm.path.poses[tick].position_m).norm() < 1e-9);
        }
    }

    #[test]
    fn a_raised_base_has_a_post_down_to_the_table() {
        let arm = Arm { table_m: -0.4, ..sample::arm() };
        let [column, post] = arm.standing()[..] else { panic!("two") };
        assert!(distance(post.ends_m[0], [0.26, -0.8, -0.4]) < 1e-12);
        assert!(distance(post.ends_m[1], column.ends_m[0]) < 1e-12);
        assert!(post.radius_m < column.radius_m);
    }

    #[test]
    fn all_of_it_is_within_its_extent() {
        let arm = sample::arm();
        let all = arm.extent();
        assert!((all.low_m[2] - arm.table_m).abs() < 1e-12);
        for tick in 0..=arm.path.last_tick() {
            for Capsule { ends_m, .. } in arm.moving(arm.path.time_s(tick)) {
                assert!(ends_m.iter().all(|end| Extent::about([*end]).map(|at| all.and(&at)) == Some(all)));
            }
        }
        assert!(all.size_m()[2] > 0.5, "{all:?}");
    }

    #[test]
    fn the_reader_stands_opposite_to_it() {
        let arm = sample::arm();
        for (of_m, side_deg) in
            [([0.26, 0.0], 180.0), ([0.26, -2.0], 0.0), ([2.0, -0.8], 90.0), ([-2.0, -0.8], 270.0)]
        {
            let found_deg = arm.far_side_deg([of_m[0], of_m[1], 0.0]);
            assert!((found_deg - side_deg).abs() < 1e-9, "{found_deg} for {of_m:?}");
        }
    }
}
