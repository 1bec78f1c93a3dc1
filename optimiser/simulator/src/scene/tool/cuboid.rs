//! Rectangular blocks, of which a tool can be built.

use crate::scene::solid::{Vec3, dot};
use nalgebra::Rotation3;
use serde::{Deserialize, Serialize};

/// Most cuboids of one tool.
pub const MAX_CUBOIDS: usize = 64;

/// A rectangular block of a tool, in the tool's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cuboid {
    /// Its middle, metres; each component -1 to 1.
    pub centre_m: [f64; 3],
    /// Edges along its own x, y, z, metres; each half a cell to 1.
    pub size_m: [f64; 3],
    /// Roll, pitch and yaw, degrees, right-handed: turned about the tool's x, then its y, then its z axis, `Rz Ry Rx`; each -360
    /// to 360, zero if not given.
    #[serde(default)]
    pub rotation_deg: [f64; 3],
}

impl Cuboid {
    /// The cuboid's own x, y, z in the tool's frame.
    pub(crate) fn axes(&self) -> [Vec3; 3] {
        let [roll, pitch, yaw] = self.rotation_deg.map(f64::to_radians);
        Rotation3::from_euler_angles(roll, pitch, yaw).into_inner().into()
    }

    /// Its eight corners, tool frame, metres: corner i has the high x of the cuboid's own axes if bit 0 is
    /// set, the high y if bit 1 is, the high z if bit 2 is.
    pub fn corners_m(&self) -> [Vec3; 8] {
        let axes = self.axes();
        std::array::from_fn(|corner| {
            let side = |axis: usize| if corner >> axis & 1 == 0 { -0.5 } else { 0.5 };
            let along =
                |i: usize| (0..3).map(|axis| side(axis) * self.size_m[axis] * axes[axis][i]).sum::<f64>();
            std::array::from_fn(|i| self.centre_m[i] + along(i))
        })
    }

    /// Largest p . `direction` over the cuboid, tool frame.
    pub(super) fn support(&self, direction: Vec3) -> f64 {
        let half = |axis: Vec3, size: f64| 0.5 * size * dot(axis, direction).abs();
        dot(self.centre_m, direction)
            + self.axes().into_iter().zip(self.size_m).map(|(axis, size)| half(axis, size)).sum::<f64>()
    }

    /// Lowest and highest point on the vertical through (x, y), tool frame, metres; none if it passes by.
    pub(super) fn heights_m(&self, x: f64, y: f64) -> Option<[f64; 2]> {
        let from = [x - self.centre_m[0], y - self.centre_m[1], -self.centre_m[2]];
        let mut heights = [f64::NEG_INFINITY, f64::INFINITY];
        for (axis, size) in self.axes().into_iter().zip(self.size_m) {
            let (at_zero, slope) = (dot(axis, from), axis[2]);
            let faces = [-0.5, 0.5].map(|side| (side * size - at_zero) / slope);
            if slope.abs() < 1e-12 {
                if at_zero.abs() > 0.5 * size {
                    return None;
                }
                continue;
            }
            heights = [heights[0].max(faces[0].min(faces[1])), heights[1].min(faces[0].max(faces[1]))];
        }
        (heights[0] <= heights[1]).then_some(heights)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TURNED: Cuboid = Cuboid {
        centre_m: [0.01, -0.02, 0.03],
        size_m: [0.02, 0.04, 0.06],
        rotation_deg: [20.0, -35.0, 50.0],
    };

    #[test]
    fn turns_about_x_then_y_then_z() {
        let turned = |rotation_deg| Cuboid { rotation_deg, ..TURNED }.axes();
        let near = |a: Vec3, b: Vec3| (0..3).all(|i| (a[i] - b[i]).abs() < 1e-15);
        assert!(near(turned([90.0, 0.0, 0.0])[1], [0.0, 0.0, 1.0]));
        assert!(near(turned([0.0, 90.0, 0.0])[0], [0.0, 0.0, -1.0]));
        assert!(near(turned([0.0, 0.0, 90.0])[0], [0.0, 1.0, 0.0]));
        // Its y goes up by the roll, and stays there under the yaw.
        assert!(near(turned([90.0, 0.0, 90.0])[1], [0.0, 0.0, 1.0]));
        let [x, y, z] = TURNED.axes();
        assert!([dot(x, y), dot(y, z), dot(z, x)].iter().all(|product| product.abs() < 1e-15));
        assert!([x, y, z].iter().all(|axis| (dot(*axis, *axis) - 1.0).abs() < 1e-15));
    }

    #[test]
    fn reach_and_heights_are_those_of_its_corners() {
        let corners = TURNED.corners_m();
        for direction in [[1.0, 0.0, 0.0], [0.3, -0.8, 0.52], [0.0, 0.0, -1.0]] {
            let support = corners.iter().map(|corner| dot(*corner, direction)).fold(f64::MIN, f64::max);
            assert!((TURNED.support(direction) - support).abs() < 1e-15);
        }
        // Over a corner the vertical touches; beside all of them it passes by.
        let top = corners.into_iter().max_by(|a, b| a[2].total_cmp(&b[2])).unwrap();
        let [_, high] =
            TURNED.heights_m(top[0] + 1e-9 * (0.01 - top[0]), top[1] + 1e-9 * (-0.02 - top[1])).unwrap();
        assert!((high - top[2]).abs() < 1e-8);
        assert_eq!(TURNED.heights_m(0.2, 0.0), None);
        let [low, high] = TURNED.heights_m(0.01, -0.02).unwrap();
        assert!((low + high - 0.06).abs() < 1e-15 && high > low + 0.02);
    }
}
