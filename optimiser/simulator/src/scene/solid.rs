//! Convex solids by their reach, and whether two of them are apart.
//!
//! The reach of a solid in direction d (its support function) is max over its points p of p . d. Two convex solids
//! A and B are apart exactly when reach_A(d) + reach_B(-d) <= 0 for some d. Here d runs over the solids' own face
//! normals and a fixed set of directions, so "apart" is always true, and "not apart" errs only for gaps below about
//! a hundredth of the solids' size.

use super::figures::plain;
use super::{Container, ContainerShape, FillShape, Gate, GateShape, Powder, Scene};
use std::fmt;
use std::sync::LazyLock;

/// A vector, world or tool frame.
pub(super) type Vec3 = [f64; 3];

/// Gap that still counts as touching rather than overlapping, metres.
pub(super) const TOUCH_M: f64 = 1e-9;

/// A table is larger than what an arm reaches, metres.
const FAR_M: f64 = 20.0;

const UP: Vec3 = [0.0, 0.0, 1.0];

/// Segments that stand for a round wall.
const ROUND_SEGMENTS: usize = 64;

/// Directions tried besides the face normals.
const DIRECTIONS: usize = 512;

pub(super) fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Lowest and highest coordinates of a solid, given by its reach.
pub(super) fn extent_of(support: impl Fn(Vec3) -> f64) -> [Vec3; 2] {
    let ends = |axis: usize| {
        let mut along = [0.0; 3];
        along[axis] = 1.0;
        [-support(along.map(|x: f64| -x)), support(along)]
    };
    [0, 1].map(|end| std::array::from_fn(|axis| ends(axis)[end]))
}

/// What may stand in the way, by its name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Obstacle {
    /// What arm and bench stand on.
    Table,
    /// What the simulated volume stands on, down to the table.
    Stand,
    /// A container.
    Container(String),
    /// A gate, while it is there.
    Gate(String),
    /// Where the simulated volume ends: there is nothing, but what a tool does beyond it is not simulated.
    Border,
}

impl fmt::Display for Obstacle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Table => f.write_str("the table"),
            Self::Stand => f.write_str("the stand below the bench"),
            Self::Container(name) => write!(f, "container {name:?}"),
            Self::Gate(name) => write!(f, "gate {name:?}"),
            Self::Border => f.write_str("the border of the simulated volume (domain.size_m)"),
        }
    }
}

/// The material of what stands in the tool's way.
pub(crate) struct Solid<'a> {
    pub(super) obstacle: Obstacle,
    /// Convex pieces; those of a gate where it is shut.
    pub(super) pieces: Vec<Hull>,
    /// Lowest and highest coordinates.
    pub(super) extent: [Vec3; 2],
    /// The gate that it is, if it is one.
    gate: Option<&'a Gate>,
}

impl Solid<'_> {
    /// How far it is from where its pieces are, so long after the motion's start, metres; none if it is not there.
    pub(super) fn displacement_m(&self, time_s: f64) -> Option<Vec3> {
        self.gate.map_or(Some([0.0; 3]), |gate| gate.displacement_m(time_s))
    }
}

impl Scene {
    /// What stands in the tool's way.
    pub(crate) fn solids(&self) -> Vec<Solid<'_>> {
        let container = |one: &Container| Solid {
            obstacle: Obstacle::Container(one.name.clone()),
            pieces: one.pieces(),
            extent: one.outer().extent(),
            gate: None,
        };
        let gates = self.gates.iter().map(|gate| Solid {
            obstacle: Obstacle::Gate(gate.name.clone()),
            pieces: gate.pieces(),
            extent: gate.outer().extent(),
            gate: Some(gate),
        });
        self.containers.iter().map(container).chain(gates).chain(self.ground()).collect()
    }

    /// The table, and above it, if it is lower than the bench top, the stand.
    fn ground(&self) -> impl Iterator<Item = Solid<'_>> {
        let table_m = self.arm.as_ref().map_or(0.0, |arm| arm.table_height_m);
        let [length_m, width_m, _] = self.domain.size_m;
        let table = Hull::aligned_box([-FAR_M, -FAR_M, table_m - FAR_M], [FAR_M, FAR_M, table_m]);
        let stand = (table_m < 0.0)
            .then(|| Hull::aligned_box([0.0, 0.0, table_m], [length_m, width_m, 0.0]))
            .map(|hull| (Obstacle::Stand, hull));
        [(Obstacle::Table, table)].into_iter().chain(stand).map(|(obstacle, hull)| Solid {
            obstacle,
            extent: hull.extent(),
            pieces: vec![hull],
            gate: None,
        })
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
        extent_of(|direction| self.support(direction))
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
        let frame = self.frame();
        let [x, y, _] = frame.axes;
        let turned = match self.yaw_deg.rem_euclid(360.0) {
            turn_deg if turn_deg > 0.0 => format!(", turned by {} degrees", plain(self.yaw_deg)),
            _ => String::new(),
        };
        let opposite = |axis: Vec3| axis.map(|component| -component);
        let sides = [("-x", opposite(x)), ("+x", x), ("-y", opposite(y)), ("+y", y)];
        let walls = self.pieces().into_iter().skip(1).enumerate().map(|(index, hull)| {
            let (name, outwards) = match self.shape {
                ContainerShape::Box { .. } | ContainerShape::SlottedBox { .. } => {
                    let (side, outwards) = sides[index];
                    (format!("{side} wall of container {:?}{turned}", self.name), outwards)
                }
                ContainerShape::Cylinder { .. }
                | ContainerShape::Silo { .. }
                | ContainerShape::Hopper { .. } => {
                    let outwards = frame.outwards(index as f64 + 0.5);
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

    fn frame(&self) -> Frame {
        Frame::new(self.position_m, self.yaw_deg)
    }

    /// Inner height, metres.
    pub fn inner_height_m(&self) -> f64 {
        match self.shape {
            ContainerShape::Box { inner_size_m } | ContainerShape::SlottedBox { inner_size_m, .. } => {
                inner_size_m[2]
            }
            ContainerShape::Cylinder { inner_height_m, .. }
            | ContainerShape::Silo { inner_height_m, .. }
            | ContainerShape::Hopper { inner_height_m, .. } => inner_height_m,
        }
    }

    /// The container with its inside, floor plate included.
    pub(super) fn outer(&self) -> Hull {
        let (wall, frame) = (self.wall_thickness_m, self.frame());
        match self.shape {
            ContainerShape::Box { inner_size_m: [x, y, z] }
            | ContainerShape::SlottedBox { inner_size_m: [x, y, z], .. } => {
                frame.block([-0.5 * x - wall, -0.5 * y - wall, -wall], [0.5 * x + wall, 0.5 * y + wall, z])
            }
            ContainerShape::Cylinder { inner_radius_m, inner_height_m }
            | ContainerShape::Silo { inner_radius_m, inner_height_m, .. } => {
                frame.prism(inner_radius_m + wall, -wall, inner_height_m)
            }
            ContainerShape::Hopper { inner_height_m, .. } => self.cone_up_to(inner_height_m),
        }
    }

    /// The container's material in convex pieces: the floor plate first, then the walls. A hole in the floor counts as floor, and so does the
    /// whole of a cone: nothing but powder goes there.
    pub(super) fn pieces(&self) -> Vec<Hull> {
        let (wall, frame) = (self.wall_thickness_m, self.frame());
        match self.shape {
            ContainerShape::Box { inner_size_m: [x, y, z] }
            | ContainerShape::SlottedBox { inner_size_m: [x, y, z], .. } => {
                let (x, y) = (0.5 * x, 0.5 * y);
                vec![
                    frame.block([-x - wall, -y - wall, -wall], [x + wall, y + wall, 0.0]),
                    frame.block([-x - wall, -y - wall, 0.0], [-x, y + wall, z]),
                    frame.block([x, -y - wall, 0.0], [x + wall, y + wall, z]),
                    frame.block([-x, -y - wall, 0.0], [x, -y, z]),
                    frame.block([-x, y, 0.0], [x, y + wall, z]),
                ]
            }
            ContainerShape::Cylinder { inner_radius_m, inner_height_m }
            | ContainerShape::Silo { inner_radius_m, inner_height_m, .. } => {
                let floor = frame.prism(inner_radius_m + wall, -wall, 0.0);
                std::iter::once(floor)
                    .chain(frame.pipe(inner_radius_m, wall, [0.0, inner_height_m]))
                    .collect()
            }
            ContainerShape::Hopper { inner_radius_m, inner_height_m, .. } => {
                let top = self.shape.cone_height_m();
                let has_walls = self.shape.upright_from_m(wall).is_some();
                let walls = has_walls.then(|| frame.pipe(inner_radius_m, wall, [top, inner_height_m]));
                std::iter::once(self.cone_up_to(top)).chain(walls.into_iter().flatten()).collect()
            }
        }
    }

    /// A hopper's cone, filled, and if it has a cylinder that with its inside up to a height.
    fn cone_up_to(&self, height: f64) -> Hull {
        let ContainerShape::Hopper { inner_radius_m, outlet_radius_m, half_angle_deg, .. } = self.shape
        else {
            return self.outer();
        };
        let (wall, (sin, cos)) = (self.wall_thickness_m, libm::sincos(half_angle_deg.to_radians()));
        let edge = [wall * cos, -wall * sin];
        let lower = [outlet_radius_m + edge[0], edge[1]];
        let corners = match self.shape.upright_from_m(wall) {
            Some(low) => [lower, [inner_radius_m + wall, low], [inner_radius_m + wall, height]],
            None => {
                let top = self.shape.cone_height_m();
                [lower, [inner_radius_m + edge[0], top + edge[1]], [inner_radius_m, top]]
            }
        };
        self.frame().turned(&corners)
    }

    /// Whether it stands apart from another; a hopper may reach into what is open.
    pub(super) fn is_apart(&self, other: &Self) -> bool {
        let is_hopper = |one: &Self| matches!(one.shape, ContainerShape::Hopper { .. });
        let pieces_are = || {
            let others = other.pieces();
            self.pieces().iter().all(|piece| others.iter().all(|other| piece.clear_of_hull(other)))
        };
        self.outer().clear_of_hull(&other.outer()) || (is_hopper(self) || is_hopper(other)) && pieces_are()
    }

    /// Whether a point lies inside the container, rim included.
    pub(super) fn holds_point(&self, [x, y, z]: Vec3) -> bool {
        self.holds_heights(z, z) && self.holds_column([x, y], 0.0, z)
    }

    /// Whether the powder lies inside the container at its start, rim included.
    pub(super) fn holds_powder(&self, powder: &Powder) -> bool {
        self.holds_heights(powder.fill_min_m[2], powder.fill_max_m[2]) && self.holds_columns(powder)
    }

    /// What of the container the powder would be in at its start, in words, and by how much, metres; nothing if it is clear.
    pub(super) fn powder_in(&self, powder: &Powder) -> Option<(String, f64)> {
        // What stands for a cone here is filled: powder in it is judged by itself.
        let begins_in_it = powder.fill_min_m[2] >= self.position_m[2] - TOUCH_M;
        if begins_in_it && self.holds_columns(powder) {
            return None;
        }
        if let Some(depth_m) = self.beyond_cone_m(powder).filter(|_| begins_in_it) {
            return Some((format!("{} of container {:?}", self.below(), self.name), depth_m));
        }
        let filled = powder.fill_hull();
        let depth_m = |hull: &Hull| {
            let clear = hull.clear_of(|direction| powder.fill_support(direction));
            (!clear).then(|| hull.overlap_m(&filled))
        };
        let from_inside = self.holds_column(powder.fill_middle_m(), 0.0, powder.fill_min_m[2]);
        // From inside it is the inner face that counts, however thick the wall.
        let wall_depth_m = |wall: &Wall| {
            let beyond_m = || wall.beyond_m(|direction| powder.fill_support(direction));
            depth_m(&wall.hull).map(|depth_m| if from_inside { beyond_m() } else { depth_m })
        };
        // Round walls are of straight pieces here, and the powder may be as round as they are.
        let walls = if self.holds_columns(powder) { Vec::new() } else { self.walls() };
        let in_walls = walls.iter().filter_map(|wall| Some((wall.name.clone(), wall_depth_m(wall)?)));
        let deepest = in_walls.max_by(|a, b| a.1.total_cmp(&b.1));
        deepest.or_else(|| {
            let [floor, ..] = &self.pieces()[..] else { return None };
            Some((format!("{} of container {:?}", self.below(), self.name), depth_m(floor)?))
        })
    }

    /// What its first piece is called.
    pub(super) fn below(&self) -> &'static str {
        match self.shape {
            ContainerShape::Hopper { .. } => "cone",
            _ => "floor",
        }
    }

    /// How far powder that begins within a hopper's cone goes beyond its wall there, metres; none where it does not begin there.
    fn beyond_cone_m(&self, powder: &Powder) -> Option<f64> {
        let ContainerShape::Hopper { half_angle_deg, .. } = self.shape else { return None };
        let low_m = powder.fill_min_m[2];
        let begins_there = low_m - self.position_m[2] < self.shape.cone_height_m()
            && self.holds_column(powder.fill_middle_m(), 0.0, low_m);
        let inner_m = self.shape.inner_radius_at_m(low_m - self.position_m[2])?;
        let [x, y, _] = self.position_m;
        let beyond = powder
            .columns()
            .into_iter()
            .map(|(middle, radius_m)| libm::hypot(middle[0] - x, middle[1] - y) + radius_m - inner_m);
        begins_there.then(|| beyond.fold(0.0, f64::max) * libm::cos(half_angle_deg.to_radians()))
    }

    /// Above which height a tool stays, metres, and what is there, in words.
    pub(super) fn floor(&self) -> (f64, &'static str) {
        match self.shape {
            ContainerShape::Hopper { .. } => {
                (self.position_m[2] + self.shape.cone_height_m(), "upper end of the cone")
            }
            _ => (self.position_m[2], "floor"),
        }
    }

    /// Whether these heights lie between the inner floor and the rim, both included.
    pub(super) fn holds_heights(&self, low_m: f64, high_m: f64) -> bool {
        let floor_m = self.position_m[2];
        low_m >= floor_m - TOUCH_M && high_m <= floor_m + self.inner_height_m() + TOUCH_M
    }

    /// Whether the powder lies between the walls at its start, how high ever.
    fn holds_columns(&self, powder: &Powder) -> bool {
        let low_m = powder.fill_min_m[2];
        powder.columns().into_iter().all(|(middle, radius_m)| self.holds_column(middle, radius_m, low_m))
    }

    /// Whether an upright round column that begins at such a height lies between the walls.
    fn holds_column(&self, [x, y]: [f64; 2], radius_m: f64, low_m: f64) -> bool {
        let from_centre = [x - self.position_m[0], y - self.position_m[1], 0.0];
        let [along, across, _] = self.frame().axes.map(|axis| dot(axis, from_centre));
        match self.shape {
            ContainerShape::Box { inner_size_m } | ContainerShape::SlottedBox { inner_size_m, .. } => {
                along.abs() + radius_m <= 0.5 * inner_size_m[0] + TOUCH_M
                    && across.abs() + radius_m <= 0.5 * inner_size_m[1] + TOUCH_M
            }
            _ => {
                let inner_m = self.shape.inner_radius_at_m(low_m - self.position_m[2]);
                inner_m.is_some_and(|inner_m| libm::hypot(along, across) + radius_m <= inner_m + TOUCH_M)
            }
        }
    }
}

impl Gate {
    fn frame(&self) -> Frame {
        Frame::new(self.position_m, self.yaw_deg)
    }

    /// The shut gate with its inside.
    pub(super) fn outer(&self) -> Hull {
        match self.shape {
            GateShape::Box { size_m } => self.frame().plate(size_m),
            GateShape::Tube { inner_radius_m, height_m, wall_thickness_m } => {
                self.frame().prism(inner_radius_m + wall_thickness_m, 0.0, height_m)
            }
        }
    }

    /// The shut gate's material in convex pieces.
    pub(super) fn pieces(&self) -> Vec<Hull> {
        match self.shape {
            GateShape::Box { size_m } => vec![self.frame().plate(size_m)],
            GateShape::Tube { inner_radius_m, height_m, wall_thickness_m } => {
                self.frame().pipe(inner_radius_m, wall_thickness_m, [0.0, height_m]).collect()
            }
        }
    }

    /// Whether the shut gate is clear of the powder at its start, which may stand within a tube.
    pub(super) fn clear_of_powder(&self, powder: &Powder) -> bool {
        let within = match self.shape {
            GateShape::Box { .. } => false,
            GateShape::Tube { inner_radius_m, .. } => {
                powder.columns().into_iter().all(|([x, y], radius_m)| {
                    let from_axis_m = libm::hypot(x - self.position_m[0], y - self.position_m[1]);
                    from_axis_m + radius_m <= inner_radius_m + TOUCH_M
                })
            }
        };
        within || self.pieces().iter().all(|piece| piece.clear_of(|direction| powder.fill_support(direction)))
    }
}

/// An upright frame somewhere in the world.
struct Frame {
    origin: Vec3,
    /// Its x, y, z, world frame.
    axes: [Vec3; 3],
}

impl Frame {
    fn new(origin: Vec3, yaw_deg: f64) -> Self {
        let (sin, cos) = libm::sincos(yaw_deg.to_radians());
        Self { origin, axes: [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]] }
    }

    /// Box in the frame.
    fn block(&self, min: Vec3, max: Vec3) -> Hull {
        let local = Hull::aligned_box(min, max);
        Hull {
            points: local.points.into_iter().map(|point| self.to_world(point)).collect(),
            normals: self.axes.to_vec(),
        }
    }

    /// Box that stands on the origin.
    fn plate(&self, [x, y, z]: [f64; 3]) -> Hull {
        self.block([-0.5 * x, -0.5 * y, 0.0], [0.5 * x, 0.5 * y, z])
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

    /// What is around a convex profile, of corners in radius and height, that is turned about the vertical, and all in it.
    fn turned(&self, corners: &[[f64; 2]]) -> Hull {
        let widened = 1.0 / libm::cos(std::f64::consts::PI / ROUND_SEGMENTS as f64);
        let ring = |index: usize| {
            let (sin, cos) = libm::sincos(segment_angle(index as f64 + 0.5));
            corners.iter().map(move |[r, z]| self.to_world([widened * r * cos, widened * r * sin, *z]))
        };
        let sides = (0..ROUND_SEGMENTS).flat_map(|index| {
            let outwards = self.outwards(index as f64);
            corners.windows(2).map(move |ends| {
                let [rise, run] = [ends[1][1] - ends[0][1], ends[1][0] - ends[0][0]];
                let length = libm::hypot(rise, run);
                let [x, y, _] = outwards.map(|component| component * rise / length);
                [x, y, -run / length]
            })
        });
        Hull { points: (0..ROUND_SEGMENTS).flat_map(ring).collect(), normals: sides.chain([UP]).collect() }
    }

    /// A round wall from one height to another, segment after segment.
    fn pipe(&self, inner_radius: f64, wall: f64, heights: [f64; 2]) -> impl Iterator<Item = Hull> {
        (0..ROUND_SEGMENTS).map(move |index| self.stave(index, inner_radius, wall, heights))
    }

    /// One segment of a round wall.
    fn stave(&self, index: usize, inner_radius: f64, wall: f64, heights: [f64; 2]) -> Hull {
        let points = [0, 1].into_iter().flat_map(|end| {
            let (sin, cos) = libm::sincos(segment_angle((index + end) as f64));
            [inner_radius, inner_radius + wall]
                .into_iter()
                .flat_map(move |radius| heights.map(|z| self.to_world([radius * cos, radius * sin, z])))
        });
        let outwards = self.outwards(index as f64 + 0.5);
        let along = [-outwards[1], outwards[0], 0.0];
        Hull { points: points.collect(), normals: vec![outwards, along, UP] }
    }

    /// Direction from the axis to a place on a round wall, counted in segments.
    fn outwards(&self, segments: f64) -> Vec3 {
        let [x, y, _] = self.axes;
        let (sin, cos) = libm::sincos(segment_angle(segments));
        std::array::from_fn(|axis| cos * x[axis] + sin * y[axis])
    }

    fn to_world(&self, point: Vec3) -> Vec3 {
        let [x, y, _] = self.axes;
        let [px, py, pz] = self.origin;
        [px + point[0] * x[0] + point[1] * y[0], py + point[0] * x[1] + point[1] * y[1], pz + point[2]]
    }
}

fn segment_angle(index: f64) -> f64 {
    std::f64::consts::TAU * index / ROUND_SEGMENTS as f64
}

impl Powder {
    /// What is filled with powder; around a round column.
    pub(super) fn fill_hull(&self) -> Hull {
        match self.fill_shape {
            FillShape::Box => Hull::aligned_box(self.fill_min_m, self.fill_max_m),
            FillShape::Cylinder => {
                let [[x, y], high_m] = [self.fill_middle_m(), [self.fill_min_m[2], self.fill_max_m[2]]];
                Frame::new([x, y, 0.0], 0.0).prism(self.fill_radius_m(), high_m[0], high_m[1])
            }
        }
    }

    /// Largest p . `direction` over what is filled with powder.
    pub(super) fn fill_support(&self, direction: Vec3) -> f64 {
        let [low, high] = [self.fill_min_m, self.fill_max_m];
        let farther = |axis: usize| (low[axis] * direction[axis]).max(high[axis] * direction[axis]);
        match self.fill_shape {
            FillShape::Box => farther(0) + farther(1) + farther(2),
            FillShape::Cylinder => {
                let ([x, y], [dx, dy, _]) = (self.fill_middle_m(), direction);
                x * dx + y * dy + self.fill_radius_m() * libm::hypot(dx, dy) + farther(2)
            }
        }
    }

    /// Upright round columns, middle and radius (metres), that lie in a convex space exactly when the powder does: the box's
    /// edges, or the one that is filled.
    fn columns(&self) -> Vec<([f64; 2], f64)> {
        let [[x0, y0, _], [x1, y1, _]] = [self.fill_min_m, self.fill_max_m];
        match self.fill_shape {
            FillShape::Box => [[x0, y0], [x0, y1], [x1, y0], [x1, y1]].map(|edge| (edge, 0.0)).to_vec(),
            FillShape::Cylinder => vec![(self.fill_middle_m(), self.fill_radius_m())],
        }
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
