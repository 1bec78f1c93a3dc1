//! A body put together from cuboids. Its edge is the border of what they cover, seen from above.

use super::body::{Body, Point, extent};
use super::cuboid::{Cuboid, MAX_CUBOIDS};
use crate::scene::ruler::Ruler;
use crate::scene::solid::dot;
use crate::scene::validate::{Found, Range, TURN_DEG};
use crate::shape::{OrientedBox, Shape};

/// Cuboids, and the wall that the handle ends in.
pub(super) struct Cuboids<'a> {
    pub(super) cuboids: &'a [Cuboid],
    pub(super) wall_m: f64,
}

impl Cuboids<'_> {
    fn corners_m(&self) -> impl Iterator<Item = Point> {
        self.cuboids.iter().flat_map(Cuboid::corners_m)
    }

    /// Of each cuboid that the vertical through (x, y) meets, the lowest and the highest point on it.
    fn heights_m(&self, x: f64, y: f64) -> impl Iterator<Item = [f64; 2]> {
        self.cuboids.iter().filter_map(move |cuboid| cuboid.heights_m(x, y))
    }
}

impl Body for Cuboids<'_> {
    fn check(&self, found: &mut Found<'_>, cell_m: f64) {
        let count = self.cuboids.len();
        if count == 0 || count > MAX_CUBOIDS {
            let right = format!("1 to {MAX_CUBOIDS} cuboids would be right");
            found.refuse("tool.shape.cuboid", format!("{count} cuboids"), right);
            return;
        }
        for (index, cuboid) in self.cuboids.iter().enumerate() {
            let field = |name: &str| format!("tool.shape.cuboid[{index}].{name}");
            found.vector(&field("centre_m"), &cuboid.centre_m, Range::closed(-1.0, 1.0));
            let least = cuboid.size_m.iter().copied().fold(f64::INFINITY, f64::min);
            if found.vector(&field("size_m"), &cuboid.size_m, Range::above(0.0, 1.0)) {
                found.thick(&field("size_m"), least, cell_m);
            }
            found.vector(&field("rotation_deg"), &cuboid.rotation_deg, TURN_DEG);
        }
    }

    fn solids(&self) -> Vec<Shape<f64>> {
        let solid = |cuboid: &Cuboid| {
            let half = cuboid.size_m.map(|edge| 0.5 * edge);
            Shape::OrientedBox(OrientedBox { centre: cuboid.centre_m, half, axes: cuboid.axes() })
        };
        self.cuboids.iter().map(solid).collect()
    }

    fn support(&self, direction: Point) -> f64 {
        farthest(self.cuboids.iter().map(|cuboid| cuboid.support(direction)))
    }

    fn bounding_radius_m(&self) -> f64 {
        farthest(self.corners_m().map(|corner| libm::sqrt(dot(corner, corner))))
    }

    fn rear_m(&self) -> f64 {
        self.support([-1.0, 0.0, 0.0]) - 0.5 * self.wall_m
    }

    /// Of whatever is the furthest forward.
    fn lip_m(&self, forward: Point) -> f64 {
        self.support(forward)
    }

    /// Half of what they measure across.
    fn half_width_m(&self) -> f64 {
        let [low, high] = self.extent_m();
        0.5 * (high[0] - low[0]).min(high[1] - low[1])
    }

    /// In the box around them, with room for a heap, which is at most as high as they are.
    fn carries(&self, point: Point, room_m: f64) -> bool {
        let [low, high] = self.extent_m();
        let above = [room_m, room_m, room_m + high[2] - low[2]];
        (0..3).all(|i| (low[i] - room_m..=high[i] + above[i]).contains(&point[i]))
    }

    fn cavity_extent_m(&self, turned: &dyn Fn(Point) -> Point) -> [[f64; 2]; 3] {
        let [x, y, [low, high]] = extent(self.corners_m().map(turned));
        // With room above the highest of them, which powder lies on too.
        [x, y, Ruler::with_one_more([low, high])]
    }

    /// Over one of the cuboids and within none.
    fn encloses(&self, [x, y, z]: Point) -> bool {
        self.heights_m(x, y).any(|[low, _]| low < z) && self.is_open_at([x, y, z])
    }

    fn is_open_at(&self, [x, y, z]: Point) -> bool {
        self.heights_m(x, y).all(|[low, high]| z < low || z > high)
    }

    /// At the height of their upper side.
    fn edge(&self) -> Vec<Point> {
        // No wall lies between two of the verticals.
        let thinnest_m = self.cuboids.iter().flat_map(|cuboid| cuboid.size_m).fold(f64::INFINITY, f64::min);
        let [x, y, _] = extent(self.corners_m()).map(|along| Ruler::fine(along, 0.5 * thinnest_m));
        let top_m = |i: usize, j: usize| {
            let highest = |top: Option<f64>, [_, high]: [f64; 2]| Some(top.map_or(high, |top| top.max(high)));
            self.heights_m(x.at(i), y.at(j)).fold(None, highest)
        };
        let place = |index: usize| (index / y.parts, index % y.parts);
        let tops: Vec<Option<f64>> = (0..x.parts * y.parts).map(place).map(|(i, j)| top_m(i, j)).collect();
        let covered = |i: usize, j: usize| i < x.parts && j < y.parts && tops[i * y.parts + j].is_some();
        let is_inside = |(i, j): (usize, usize)| {
            covered(i + 1, j)
                && covered(i, j + 1)
                && covered(i.wrapping_sub(1), j)
                && covered(i, j.wrapping_sub(1))
        };
        let on_border = (0..tops.len()).filter(|index| !is_inside(place(*index)));
        let point =
            |index: usize| tops[index].map(|top_m| [x.at(place(index).0), y.at(place(index).1), top_m]);
        on_border.filter_map(point).collect()
    }
}

fn farthest(reaches: impl Iterator<Item = f64>) -> f64 {
    reaches.fold(f64::NEG_INFINITY, f64::max)
}
