//! Box scoop, open at the front (+x) and on top (+z). Its edges are its rim and the front of its floor.

use super::body::{Body, EDGE_POINTS, Point, extent, share};
use crate::scene::solid::dot;
use crate::scene::validate::{Found, Range};
use crate::shape::{AlignedBox, Shape};

/// A box scoop with its walls.
pub(super) struct BoxScoop {
    /// Length, width, height.
    pub(super) inner_size_m: [f64; 3],
    pub(super) wall_m: f64,
}

impl Body for BoxScoop {
    fn check(&self, found: &mut Found<'_>, cell_m: f64) {
        found.vector("tool.shape.inner_size_m", &self.inner_size_m, Range::closed(cell_m, 1.0));
    }

    /// Floor, back and two sides.
    fn solids(&self) -> Vec<Shape<f64>> {
        let wall = |centre, half| Shape::AlignedBox(AlignedBox { centre, half });
        let ([l, w, h], t) = (self.inner_size_m, self.wall_m);
        let (hl, hw) = (0.5 * l, 0.5 * w);
        let half_height = 0.5 * (h + t);
        vec![
            wall([-0.5 * t, 0.0, -h - 0.5 * t], [hl + 0.5 * t, hw + t, 0.5 * t]),
            wall([-hl - 0.5 * t, 0.0, -half_height], [0.5 * t, hw + t, half_height]),
            wall([-0.5 * t, hw + 0.5 * t, -half_height], [hl + 0.5 * t, 0.5 * t, half_height]),
            wall([-0.5 * t, -hw - 0.5 * t, -half_height], [hl + 0.5 * t, 0.5 * t, half_height]),
        ]
    }

    fn support(&self, [x, y, z]: Point) -> f64 {
        let ([length, width, height], wall) = (self.inner_size_m, self.wall_m);
        let along = if x > 0.0 { 0.5 * length * x } else { -(0.5 * length + wall) * x };
        along + (0.5 * width + wall) * y.abs() + (height + wall) * (-z).max(0.0)
    }

    fn bounding_radius_m(&self) -> f64 {
        let ([length, width, height], wall) = (self.inner_size_m, self.wall_m);
        let half = [0.5 * length + wall, 0.5 * width + wall, height + wall];
        libm::sqrt(dot(half, half))
    }

    fn rear_m(&self) -> f64 {
        0.5 * self.inner_size_m[0] + 0.5 * self.wall_m
    }

    /// Of the front of the floor.
    fn lip_m(&self, forward: Point) -> f64 {
        let [length, _, height] = self.inner_size_m;
        0.5 * length * forward[0] - height * forward[2]
    }

    fn half_width_m(&self) -> f64 {
        0.5 * self.inner_size_m[0].min(self.inner_size_m[1])
    }

    /// In the box around its inside, with as much room above as below.
    fn carries(&self, [x, y, z]: Point, room_m: f64) -> bool {
        let [length, width, height] = self.inner_size_m;
        x.abs() <= 0.5 * length + room_m && y.abs() <= 0.5 * width + room_m && z.abs() <= height + room_m
    }

    fn cavity_extent_m(&self, turned: &dyn Fn(Point) -> Point) -> [[f64; 2]; 3] {
        let [length, width, height] = self.inner_size_m;
        extent((0..8).map(|corner| {
            let side = |bit: usize| if corner >> bit & 1 == 0 { -0.5 } else { 0.5 };
            turned([side(0) * length, side(1) * width, (side(2) - 0.5) * height])
        }))
    }

    fn encloses(&self, [x, y, z]: Point) -> bool {
        let [length, width, height] = self.inner_size_m;
        x.abs() <= 0.5 * length && y.abs() <= 0.5 * width && (-height..=0.0).contains(&z)
    }

    fn is_open_at(&self, [x, _, z]: Point) -> bool {
        z > 0.0 || x > 0.5 * self.inner_size_m[0]
    }

    fn edge(&self) -> Vec<Point> {
        let [length, width, height] = self.inner_size_m;
        let at = |index| {
            let along = share(index) - 0.5;
            let (x, y) = (along * length, along * width);
            [
                [-0.5 * length, y, 0.0],
                [x, -0.5 * width, 0.0],
                [x, 0.5 * width, 0.0],
                [0.5 * length, y, -height],
            ]
        };
        (0..=EDGE_POINTS).flat_map(at).collect()
    }
}
