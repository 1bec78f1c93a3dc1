//! Convex solids by their reach, and whether two of them are apart.
//!
//! The reach of a solid in direction d (its support function) is max over its points p of p . d. Two convex solids
//! A and B are apart exactly when reach_A(d) + reach_B(-d) <= 0 for some d. Here d runs over the solids' own face
//! normals and a fixed set of directions, so "apart" is always true, and "not apart" errs only for gaps below about
//! a hundredth of the solids' size.

use super::figures::plain;
use super::{Container, ContainerShape, Powder, Scene};
use std::sync::LazyLock;

/// A vector, world or tool frame.
pub(super) type Vec3 = [f64; 3];

/// Gap that still counts as touching rather than overlapping, metres.
pub(super) const TOUCH_M: f64 = 1e-9;

const UP: Vec3 = [0.0, 0.0, 1.0];

/// Segments that stand for a round wall.
const ROUND_SEGMENTS: usize = 64;

/// Directions tried besides the face normals.
const DIRECTIONS: usize = 512;

pub(super) fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A container's material.
pub(crate) struct Solid {
    /// The container's name.
    pub(super) name: String,
    /// Convex pieces.
    pub(super) pieces: Vec<Hull>,
    /// Lowest and highest coordinates.
    pub(super) extent: [Vec3; 2],
}

impl Scene {
    /// What stands in the tool's way.
    pub(crate) fn solids(&self) -> Vec<Solid> {
        let solid =
            |c: &Container| Solid { name: c.name.clone(), pieces: c.pieces(), extent: c.outer().extent() };
        self.containers.iter().map(solid).collect()
    }
}

/// Convex hull of points.
#[derive(Clone, Debug)]
pub(super) struct Hull {
    points: Vec<Vec3>,
    /// Normals of its faces, one of each opposite pair.
    normals: Vec<Vec3>,
}

impl Hull {
    /// Whether it is apart from another solid, given by its reach.
    pub(super) fn clear_of(&self, other: impl Fn(Vec3) -> f64) -> bool {
        apart(&self.normals, |direction| self.support(direction), other)
    }

    /// Whether it is apart from another hull.
    pub(super) fn clear_of_hull(&self, other: &Self) -> bool {
        let normals: Vec<Vec3> = self.normals.iter().chain(&other.normals).copied().collect();
        apart(&normals, |direction| self.support(direction), |direction| other.support(direction))
    }

    /// How far it would have to go, at least, to be apart from another hull, metres.
    pub(super) fn overlap_m(&self, other: &Self) -> f64 {
        let along = |d: Vec3| self.support(d) + other.support(d.map(|component| -component));
        let both_ways = |d: &Vec3| along(*d).min(along(d.map(|component| -component)));
        let directions = self.normals.iter().chain(&other.normals).chain(SPREAD.iter());
        directions.map(both_ways).fold(f64::INFINITY, f64::min)
    }

    /// Largest p . `direction` over the hull.
    pub(super) fn support(&self, direction: Vec3) -> f64 {
        self.points.iter().map(|point| dot(*point, direction)).fold(f64::NEG_INFINITY, f64::max)
    }

    /// Lowest and highest coordinates.
    fn extent(&self) -> [Vec3; 2] {
        let ends = |axis: usize| {
            let mut along = [0.0; 3];
            along[axis] = 1.0;
            [-self.support(along.map(|x: f64| -x)), self.support(along)]
        };
        [0, 1].map(|end| std::array::from_fn(|axis| ends(axis)[end]))
    }

    /// Box aligned with the world's axes.
    pub(super) fn aligned_box(min: Vec3, max: Vec3) -> Self {
        let corner = |index: usize| {
            std::array::from_fn(|axis| if index >> axis & 1 == 0 { min[axis] } else { max[axis] })
        };
        Self { points: (0..8).map(corner).collect(), normals: vec![[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], UP] }
    }
}

/// Whether two convex solids, given by their reaches, are apart along one of `normals` or of a fixed set of
/// directions.
fn apart(normals: &[Vec3], a: impl Fn(Vec3) -> f64, b: impl Fn(Vec3) -> f64) -> bool {
    let separates = |d: Vec3| a(d) + b(d.map(|component| -component)) <= TOUCH_M;
    let both_ways = |d: Vec3| separates(d) || separates(d.map(|component| -component));
    normals.iter().copied().any(both_ways) || SPREAD.iter().copied().any(both_ways)
}

static SPREAD: LazyLock<[Vec3; DIRECTIONS]> = LazyLock::new(|| std::array::from_fn(spread_direction));

/// Directions spread evenly over the half sphere (Fibonacci lattice).
fn spread_direction(index: usize) -> Vec3 {
    const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;
    let up = (index as f64 + 0.5) / DIRECTIONS as f64;
    let (sin, cos) = libm::sincos(GOLDEN_ANGLE * index as f64);
    let across = (1.0 - up * up).sqrt();
    [across * cos, across * sin, up]
}

/// A wall of a container.
pub(super) struct Wall {
    /// Which one, in words.
    pub(super) name: String,
    hull: Hull,
    /// Away from the container's middle, world frame.
    outwards: Vec3,
}

impl Wall {
    /// How far a convex solid, given by its reach, goes beyond the wall's inner face, metres; none if it stays clear.
    pub(super) fn depth_m(&self, support: impl Fn(Vec3) -> f64) -> Option<f64> {
        (!self.hull.clear_of(&support)).then(|| self.beyond_m(support))
    }

    /// How far a convex solid reaches beyond the plane of the wall's inner face, metres; negative if it does not.
    pub(super) fn beyond_m(&self, support: impl Fn(Vec3) -> f64) -> f64 {
        support(self.outwards) + self.hull.support(self.outwards.map(|x| -x))
    }

    /// Whether something stays clear of it, by its own judgement of a convex solid.
    pub(super) fn is_clear(&self, clears: impl Fn(&Hull) -> bool) -> bool {
        clears(&self.hull)
    }

    /// Whether the wall lies within 60 degrees of this horizontal direction.
    pub(super) fn is_ahead(&self, direction: Vec3) -> bool {
        // Within 60 degrees: beside that it is another way that helps.
        dot(self.outwards, direction) > 0.5
    }
}

impl Container {
    /// Its walls, in the order of its pieces.
    pub(super) fn walls(&self) -> Vec<Wall> {
        let [x, y, _] = self.axes();
        let turned = match self.yaw_deg.rem_euclid(360.0) {
            turn_deg if turn_deg > 0.0 => format!(", turned by {} degrees", plain(self.yaw_deg)),
            _ => String::new(),
        };
        let opposite = |axis: Vec3| axis.map(|component| -component);
        let sides = [("-x", opposite(x)), ("+x", x), ("-y", opposite(y)), ("+y", y)];
        let walls = self.pieces().into_iter().skip(1).enumerate().map(|(index, hull)| {
            let (name, outwards) = match self.shape {
                ContainerShape::Box { .. } => {
                    let (side, outwards) = sides[index];
                    (format!("{side} wall of container {:?}{turned}", self.name), outwards)
                }
                ContainerShape::Cylinder { .. } => {
                    let outwards = self.outwards(index as f64 + 0.5);
                    let towards_deg = libm::atan2(outwards[1], outwards[0]).to_degrees().rem_euclid(360.0);
                    (
                        format!("wall of container {:?} at {towards_deg:.0} degrees from +x", self.name),
                        outwards,
                    )
                }
            };
            Wall { name, hull, outwards }
        });
        walls.collect()
    }

    /// The container's own axes, world frame.
    fn axes(&self) -> [Vec3; 3] {
        let (sin, cos) = libm::sincos(self.yaw_deg.to_radians());
        [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]
    }

    /// Inner height, metres.
    pub fn inner_height_m(&self) -> f64 {
        match self.shape {
            ContainerShape::Box { inner_size_m } => inner_size_m[2],
            ContainerShape::Cylinder { inner_height_m, .. } => inner_height_m,
        }
    }

    /// The container with its inside, floor plate included.
    pub(super) fn outer(&self) -> Hull {
        let wall = self.wall_thickness_m;
        match self.shape {
            ContainerShape::Box { inner_size_m: [x, y, z] } => {
                self.block([-0.5 * x - wall, -0.5 * y - wall, -wall], [0.5 * x + wall, 0.5 * y + wall, z])
            }
            ContainerShape::Cylinder { inner_radius_m, inner_height_m } => {
                self.prism(inner_radius_m + wall, -wall, inner_height_m)
            }
        }
    }

    /// The container's material in convex pieces: the floor plate first, then the walls.
    pub(super) fn pieces(&self) -> Vec<Hull> {
        let wall = self.wall_thickness_m;
        match self.shape {
            ContainerShape::Box { inner_size_m: [x, y, z] } => {
                let (x, y) = (0.5 * x, 0.5 * y);
                vec![
                    self.block([-x - wall, -y - wall, -wall], [x + wall, y + wall, 0.0]),
                    self.block([-x - wall, -y - wall, 0.0], [-x, y + wall, z]),
                    self.block([x, -y - wall, 0.0], [x + wall, y + wall, z]),
                    self.block([-x, -y - wall, 0.0], [x, -y, z]),
                    self.block([-x, y, 0.0], [x, y + wall, z]),
                ]
            }
            ContainerShape::Cylinder { inner_radius_m, inner_height_m } => {
                let floor = self.prism(inner_radius_m + wall, -wall, 0.0);
                let staves =
                    (0..ROUND_SEGMENTS).map(|index| self.stave(index, inner_radius_m, inner_height_m));
                std::iter::once(floor).chain(staves).collect()
            }
        }
    }

    /// Whether the box from `min` to `max` (world frame) lies inside the container, rim included.
    pub(super) fn holds_box(&self, min: Vec3, max: Vec3) -> bool {
        let corners = [[min[0], min[1]], [min[0], max[1]], [max[0], min[1]], [max[0], max[1]]];
        self.holds_heights(min[2], max[2]) && corners.iter().all(|[x, y]| self.holds_column(*x, *y))
    }

    /// Whether these heights lie between the inner floor and the rim, both included.
    pub(super) fn holds_heights(&self, low_m: f64, high_m: f64) -> bool {
        let floor_m = self.position_m[2];
        low_m >= floor_m - TOUCH_M && high_m <= floor_m + self.inner_height_m() + TOUCH_M
    }

    fn holds_column(&self, x: f64, y: f64) -> bool {
        let from_centre = [x - self.position_m[0], y - self.position_m[1], 0.0];
        let [along, across, _] = self.axes().map(|axis| dot(axis, from_centre));
        match self.shape {
            ContainerShape::Box { inner_size_m } => {
                along.abs() <= 0.5 * inner_size_m[0] + TOUCH_M
                    && across.abs() <= 0.5 * inner_size_m[1] + TOUCH_M
            }
            ContainerShape::Cylinder { inner_radius_m, .. } => {
                libm::hypot(along, across) <= inner_radius_m + TOUCH_M
            }
        }
    }

    /// Box in the container's frame.
    fn block(&self, min: Vec3, max: Vec3) -> Hull {
        let local = Hull::aligned_box(min, max);
        Hull {
            points: local.points.into_iter().map(|point| self.to_world(point)).collect(),
            normals: self.axes().to_vec(),
        }
    }

    /// Upright prism around a circle.
    fn prism(&self, radius: f64, low: f64, high: f64) -> Hull {
        let corner = radius / libm::cos(std::f64::consts::PI / ROUND_SEGMENTS as f64);
        let points = (0..ROUND_SEGMENTS).flat_map(|index| {
            let (sin, cos) = libm::sincos(segment_angle(index as f64 + 0.5));
            [low, high].map(|z| self.to_world([corner * cos, corner * sin, z]))
        });
        let sides = (0..ROUND_SEGMENTS / 2).map(|index| self.outwards(index as f64));
        Hull { points: points.collect(), normals: sides.chain([UP]).collect() }
    }

    /// One segment of a round wall.
    fn stave(&self, index: usize, inner_radius: f64, height: f64) -> Hull {
        let points = [0, 1].into_iter().flat_map(|end| {
            let (sin, cos) = libm::sincos(segment_angle((index + end) as f64));
            [inner_radius, inner_radius + self.wall_thickness_m]
                .into_iter()
                .flat_map(move |radius| [0.0, height].map(|z| self.to_world([radius * cos, radius * sin, z])))
        });
        let outwards = self.outwards(index as f64 + 0.5);
        let along = [-outwards[1], outwards[0], 0.0];
        Hull { points: points.collect(), normals: vec![outwards, along, UP] }
    }

    /// Direction from the container's middle to a place on its round wall, counted in segments.
    fn outwards(&self, segments: f64) -> Vec3 {
        let [x, y, _] = self.axes();
        let (sin, cos) = libm::sincos(segment_angle(segments));
        std::array::from_fn(|axis| cos * x[axis] + sin * y[axis])
    }

    fn to_world(&self, point: Vec3) -> Vec3 {
        let [x, y, _] = self.axes();
        let [px, py, pz] = self.position_m;
        [px + point[0] * x[0] + point[1] * y[0], py + point[0] * x[1] + point[1] * y[1], pz + point[2]]
    }
}

fn segment_angle(index: f64) -> f64 {
    std::f64::consts::TAU * index / ROUND_SEGMENTS as f64
}

impl Powder {
    /// The box filled with powder.
    pub(super) fn fill_box(&self) -> Hull {
        Hull::aligned_box(self.fill_min_m, self.fill_max_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn boxes_apart(gap: f64) -> bool {
        let a = Hull::aligned_box([0.0; 3], [1.0; 3]);
        let b = Hull::aligned_box([1.0 + gap, 0.0, 0.0], [2.0, 1.0, 1.0]);
        a.clear_of_hull(&b)
    }

    #[test]
    fn boxes_that_touch_are_apart_and_boxes_that_overlap_are_not() {
        assert!(boxes_apart(0.0));
        assert!(boxes_apart(0.1));
        assert!(!boxes_apart(-1e-6));
        let (a, b) = (Hull::aligned_box([0.0; 3], [1.0; 3]), Hull::aligned_box([0.75, 0.5, 0.0], [2.0; 3]));
        assert!((a.overlap_m(&b) - 0.25).abs() < 1e-12);
    }

    #[test]
    fn a_corner_beside_a_corner_is_found_without_a_hint() {
        let a = Hull::aligned_box([0.0; 3], [1.0; 3]);
        let tip = [[1.15, 1.15, 0.85], [1.15, 0.85, 1.15], [0.85, 1.15, 1.15]];
        let support = |direction| tip.iter().map(|point| dot(*point, direction)).fold(f64::MIN, f64::max);
        assert!(a.clear_of(support));
    }
}
