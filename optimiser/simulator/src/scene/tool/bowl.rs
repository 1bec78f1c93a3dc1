//! Hemispherical bowl, below the rim plane. Its edge is its rim.

use super::body::{Body, EDGE_POINTS, Point, share};
use crate::scene::validate::{Found, Range};
use crate::shape::{self, Shape};
use nalgebra::Vector3;

/// A bowl with its wall.
pub(super) struct Bowl {
    pub(super) inner_radius_m: f64,
    pub(super) wall_m: f64,
}

impl Body for Bowl {
    fn check(&self, found: &mut Found<'_>, cell_m: f64) {
        found.number("tool.shape.inner_radius_m", self.inner_radius_m, Range::closed(cell_m, 1.0));
    }

    fn solids(&self) -> Vec<Shape<f64>> {
        let half = 0.5 * self.wall_m;
        vec![Shape::Bowl(shape::Bowl { radius: self.inner_radius_m + half, half })]
    }

    fn support(&self, [x, y, z]: Point) -> f64 {
        let across = libm::hypot(x, y);
        let below_rim = if z > 0.0 { across } else { libm::hypot(across, z) };
        (self.inner_radius_m + self.wall_m) * below_rim
    }

    fn bounding_radius_m(&self) -> f64 {
        self.inner_radius_m + self.wall_m
    }

    fn rear_m(&self) -> f64 {
        self.inner_radius_m + 0.5 * self.wall_m
    }

    /// Of the rim's foremost point.
    fn lip_m(&self, forward: Point) -> f64 {
        self.inner_radius_m * forward[0]
    }

    fn half_width_m(&self) -> f64 {
        self.inner_radius_m
    }

    /// In the ball around its inside.
    fn carries(&self, point: Point, room_m: f64) -> bool {
        Vector3::from(point).norm() <= self.inner_radius_m + room_m
    }

    /// Of the whole ball, which holds it at any pitch.
    fn cavity_extent_m(&self, _: &dyn Fn(Point) -> Point) -> [[f64; 2]; 3] {
        [[-self.inner_radius_m, self.inner_radius_m]; 3]
    }

    fn encloses(&self, [x, y, z]: Point) -> bool {
        z <= 0.0 && libm::hypot(libm::hypot(x, y), z) <= self.inner_radius_m
    }

    fn is_open_at(&self, [_, _, z]: Point) -> bool {
        z > 0.0
    }

    fn edge(&self) -> Vec<Point> {
        let at = |index| {
            let (sin, cos) = libm::sincos(core::f64::consts::TAU * share(index));
            [self.inner_radius_m * cos, self.inner_radius_m * sin, 0.0]
        };
        (0..EDGE_POINTS).map(at).collect()
    }
}
