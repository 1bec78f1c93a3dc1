//! What is asked of a tool's body, whatever its shape.
//!
//! Everything in the tool's frame, metres. A shape knows how thick its walls are.

use crate::scene::solid::extent_of;
use crate::scene::validate::Found;
use crate::shape::Shape;

/// Point or direction in the tool's frame: origin at the middle of the opening, +z out of it, +x towards the lip.
pub(in crate::scene) type Point = [f64; 3];

/// Points that stand for an edge.
pub(super) const EDGE_POINTS: usize = 96;

/// What is asked of a tool's body: of its fields, of its walls, and of the powder in it.
pub(in crate::scene) trait Body {
    /// Says which of the shape's fields are out of range.
    fn check(&self, found: &mut Found<'_>, cell_m: f64);

    /// The walls, as powder meets them one after the other.
    fn solids(&self) -> Vec<Shape<f64>>;

    /// Largest p . `direction` over the body, of which what it encloses is part.
    fn support(&self, direction: Point) -> f64;

    /// Of a ball around the origin that holds all of it.
    fn bounding_radius_m(&self) -> f64;

    /// How far behind the origin the handle meets it: to the middle of its rear wall.
    fn rear_m(&self) -> f64;

    /// How far along `forward` the edge lies that powder leaves over when it is poured.
    fn lip_m(&self, forward: Point) -> f64;

    /// Half of the narrowest that powder is held in, which the cells must resolve.
    fn half_width_m(&self) -> f64;

    /// Whether powder there counts as lying in or on it, with so much room around where it can lie.
    fn carries(&self, point: Point, room_m: f64) -> bool;

    /// Lowest and highest coordinates of the cavity once it is turned.
    fn cavity_extent_m(&self, turned: &dyn Fn(Point) -> Point) -> [[f64; 2]; 3];

    /// Whether a point is in the cavity.
    fn encloses(&self, point: Point) -> bool;

    /// Whether a point just outside the cavity is there through an opening, not through a wall.
    fn is_open_at(&self, point: Point) -> bool;

    /// Points of the edges that powder can leave over.
    fn edge(&self) -> Vec<Point>;

    /// Lowest and highest coordinates of the body.
    fn extent_m(&self) -> [Point; 2] {
        extent_of(|direction| self.support(direction))
    }
}

/// Lowest and highest coordinates of some points.
pub(super) fn extent(points: impl Iterator<Item = Point>) -> [[f64; 2]; 3] {
    points.fold([[f64::INFINITY, f64::NEG_INFINITY]; 3], |found, point| {
        [0, 1, 2].map(|axis| [found[axis][0].min(point[axis]), found[axis][1].max(point[axis])])
    })
}

/// How much of an edge lies before one of its points, 0 to 1.
pub(super) fn share(index: usize) -> f64 {
    index as f64 / EDGE_POINTS as f64
}
