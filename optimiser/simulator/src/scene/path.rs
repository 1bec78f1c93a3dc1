//! Where the tool can be in the course of any skill within the bounds.

use super::Scene;
use super::solid::Vec3;

/// Steps of sampled pitch, degrees.
const PITCH_STEP_DEG: f64 = 2.0;

/// Samples along a range of travel or of a parameter.
const SAMPLES: u32 = 8;

/// One stage of the motion: the extreme places of the tool's origin and its range of pitch.
pub(super) struct SegmentEnvelope {
    /// The field that moves the tool there.
    pub(super) field: &'static str,
    /// That field's value.
    pub(super) value: Vec<f64>,
    /// Corners of the set of places that the stage ends in.
    pub(super) origins: Vec<Vec3>,
    /// Smallest and largest pitch, degrees.
    pub(super) pitch_deg: [f64; 2],
}

/// Pitches from one end of a range to the other, both included.
pub(super) fn pitches(range_deg: [f64; 2]) -> impl Iterator<Item = f64> {
    let steps = ((range_deg[1] - range_deg[0]) / PITCH_STEP_DEG).ceil().max(1.0);
    (0..=steps as u32).map(move |step| {
        let fraction = f64::from(step) / steps;
        range_deg[0] + fraction * (range_deg[1] - range_deg[0])
    })
}

fn samples(range: [f64; 2]) -> impl Iterator<Item = f64> + Clone {
    (0..=SAMPLES).map(move |step| range[0] + f64::from(step) / f64::from(SAMPLES) * (range[1] - range[0]))
}

impl Scene {
    /// Direction of scooping and transport, world frame.
    pub(super) fn heading(&self) -> Vec3 {
        let (sin, cos) = libm::sincos(self.skill.heading_deg.to_radians());
        [cos, sin, 0.0]
    }

    /// The tool's origin after travelling `forward_m` along the heading and `up_m` upwards from the start.
    pub(super) fn origin_after(&self, forward_m: f64, up_m: f64) -> Vec3 {
        let [cos, sin, _] = self.heading();
        let [x, y, z] = self.tool.start_position_m;
        [x + forward_m * cos, y + forward_m * sin, z + up_m]
    }

    /// The stages of the motion in order.
    pub(super) fn stages(&self) -> [SegmentEnvelope; 5] {
        let skill = &self.skill;
        let start_deg = self.tool.start_pitch_deg;
        let [shallow_m, deep_m] = skill.scooping_depth_m.map(|depth_m| -skill.approach_m - depth_m);
        let [carried_low_deg, carried_high_deg] =
            [start_deg - skill.scooping_angle_deg[1], start_deg - skill.scooping_angle_deg[0]];
        let [lifted_low_m, lifted_high_m] =
            [deep_m + skill.lift_height_m[0], shallow_m + skill.lift_height_m[1]];
        let swept_m = skill.sweep_m;
        let at = |forwards: &[f64], ups: [f64; 2]| {
            forwards.iter().flat_map(|forward| ups.map(|up| self.origin_after(*forward, up))).collect()
        };
        let transported_m = skill.transport_displacement_m.map(|travel_m| swept_m + travel_m);
        [
            SegmentEnvelope {
                field: "tool.start_position_m",
                value: self.tool.start_position_m.to_vec(),
                origins: at(&[0.0], [0.0, 0.0]),
                pitch_deg: [start_deg; 2],
            },
            SegmentEnvelope {
                field: "skill.scooping_depth_m",
                value: skill.scooping_depth_m.to_vec(),
                origins: at(&[0.0], [shallow_m, deep_m]),
                pitch_deg: [start_deg; 2],
            },
            SegmentEnvelope {
                field: "skill.sweep_m",
                value: vec![skill.sweep_m],
                origins: at(&[swept_m], [shallow_m, deep_m]),
                pitch_deg: [carried_low_deg, start_deg],
            },
            SegmentEnvelope {
                field: "skill.lift_height_m",
                value: skill.lift_height_m.to_vec(),
                origins: at(&[swept_m], [lifted_low_m, lifted_high_m]),
                pitch_deg: [carried_low_deg, carried_high_deg],
            },
            SegmentEnvelope {
                field: "skill.transport_displacement_m",
                value: skill.transport_displacement_m.to_vec(),
                origins: at(&transported_m, [lifted_low_m, lifted_high_m]),
                pitch_deg: [carried_low_deg, carried_high_deg + skill.pouring_angle_deg[1]],
            },
        ]
    }

    /// Poses (origin, pitch in degrees) on the way down, the deepest included.
    pub(super) fn insert_poses(&self) -> impl Iterator<Item = (Vec3, f64)> {
        let down_m = self.skill.approach_m + self.skill.scooping_depth_m[1];
        samples([0.0, -down_m]).map(|up_m| (self.origin_after(0.0, up_m), self.tool.start_pitch_deg))
    }

    /// Poses during the scoop, over all depths and angles.
    pub(super) fn scoop_poses(&self) -> impl Iterator<Item = (Vec3, f64)> {
        let skill = &self.skill;
        samples(skill.scooping_depth_m).flat_map(move |depth_m| {
            samples(skill.scooping_angle_deg).flat_map(move |angle_deg| {
                samples([0.0, 1.0]).map(move |progress| {
                    let origin = self.origin_after(progress * skill.sweep_m, -skill.approach_m - depth_m);
                    (origin, self.tool.start_pitch_deg - progress * angle_deg)
                })
            })
        })
    }
}
