//! What stands in the powder's way: the domain's walls, containers, gates, and the tool, as lists of convex or shell
//! pieces, each with its own contact law.
//!
//! A container is several pieces, applied one after the other, rather than one union: the normal of a union
//! jumps along the bisector of an inner corner, the composition of pieces does not.

use smallvec::SmallVec;

use crate::mpm::bodies::{Bodies, turned};
use crate::mpm::contact::{BodyState, ContactParams};
use crate::mpm::density::room_beside;
use crate::mpm::layout::{BLOCK_EDGE, BLOCK_NODES, Coord, Grid, NodeBlock, Side};
use crate::real::Real;
use crate::scene::{Container, ContainerShape, Gate, GateShape, Scene, Tool, VolumeCorrection, Walls};
use crate::shape::{AlignedBox, Cone, Face, HalfSpace, Shape, SignedDistance, Tube, with_solid};
use crate::small::{sub, tr_mul_vec};

/// One piece of a body.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Collider<T> {
    pub(crate) shape: Shape<T>,
    pub(crate) node_law: ContactParams<T>,
    pub(crate) particle_law: ContactParams<T>,
    /// It is a wall with two sides: what is on the other one is not seen.
    pub(crate) is_two_sided: bool,
}

impl<T: Real> Collider<T> {
    /// One of its faces, continued beyond its edges.
    fn continued(&self, face: Face) -> Option<Self> {
        Some(Self { shape: self.shape.continued(face)?, ..*self })
    }
}

/// Of what has no other side: more than any spline is wide, in cells.
const ENDLESS: f64 = 1e3;

/// A piece that never moves.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FixedCollider<T> {
    pub(crate) piece: Collider<T>,
    pub(crate) motion: BodyState<T>,
}

/// All obstacles, and which fixed ones are near which block.
#[derive(Clone, Debug)]
pub(crate) struct Colliders<T> {
    pub(crate) fixed: Vec<FixedCollider<T>>,
    /// One of each gate.
    pub(crate) gates: Vec<Collider<T>>,
    pub(crate) tool: Vec<Collider<T>>,
    /// Where walls have two sides, the faces of each piece by its number; else nothing.
    faces: Vec<Faces<T>>,
    /// For each block of the grid the fixed pieces that its nodes can touch.
    near_nodes: Vec<Vec<u16>>,
    /// For each block of the grid the fixed pieces that its particles can touch.
    near_particles: Vec<Vec<u16>>,
    /// For each block of the grid the fixed pieces that take room from its nodes, if anybody asks.
    near_rooms: Vec<Vec<u16>>,
    /// Distance within which a piece takes room from a node, m; 0 if nobody asks.
    room_reach: T,
    /// For each block of the grid what the fixed pieces leave of the room of its nodes; none where they leave all.
    rooms: Vec<Option<Box<[T; BLOCK_NODES]>>>,
}

/// Half the diagonal of a cube of `cells`, m.
pub(crate) fn half_diagonal(cells: usize, dx: f64) -> f64 {
    0.5 * 3f64.sqrt() * cells as f64 * dx
}

impl<T: Real> Colliders<T> {
    pub(crate) fn new(scene: &Scene, grid: &Grid) -> Self {
        let builder = Builder::new(scene);
        let mut fixed = builder.domain(scene);
        for container in &scene.containers {
            fixed.extend(builder.container(container));
        }
        let gates = scene.gates.iter().map(|gate| builder.gate(gate)).collect();
        let tool = builder.tool(&scene.tool);
        let near = |cells: usize, margin: &dyn Fn(&Collider<T>) -> T| -> Vec<Vec<u16>> {
            (0..grid.block_count())
                .map(|index| {
                    let centre = block_centre(grid, grid.coord(index));
                    let reach = T::from_f64(half_diagonal(cells, grid.dx));
                    let touches = |f: &FixedCollider<T>| {
                        distance(&f.piece, &f.motion, centre) <= reach + margin(&f.piece)
                    };
                    (0u16..).zip(&fixed).filter(|(_, f)| touches(f)).map(|(i, _)| i).collect()
                })
                .collect()
        };
        let contact = |piece: &Collider<T>| piece.node_law.reach();
        let (near_nodes, near_particles) = (near(BLOCK_EDGE, &contact), near(BLOCK_EDGE + 4, &contact));
        let (room_reach, rooms, near_rooms) = if scene.powder.volume_correction == VolumeCorrection::Grid {
            let reach = T::from_f64(ROOM_REACH_CELLS * grid.dx);
            let near = near(BLOCK_EDGE, &|_| reach);
            let rooms = near.iter().enumerate().map(|(index, near)| rooms(grid, index, near, &fixed));
            (reach, rooms.collect(), near)
        } else {
            (T::ZERO, Vec::new(), Vec::new())
        };
        let pieces = || fixed.iter().map(|f| &f.piece).chain(&gates).chain(&tool);
        let faces = match scene.domain.walls {
            Walls::Shared => Vec::new(),
            Walls::TwoSided => pieces().map(faces_of).collect(),
        };
        Self { fixed, gates, tool, faces, near_nodes, near_particles, near_rooms, room_reach, rooms }
    }

    /// Whether walls have two sides.
    pub(crate) fn have_two_sides(&self) -> bool {
        !self.faces.is_empty()
    }

    pub(crate) fn is_fixed(&self, number: u16) -> bool {
        usize::from(number) < self.fixed.len()
    }

    /// The faces of a piece, where walls have two sides.
    pub(crate) fn faces(&self, number: u16) -> &Faces<T> {
        &self.faces[usize::from(number)]
    }

    /// A face of a piece, continued beyond its edges; none where there is only an edge.
    #[inline(always)]
    pub(crate) fn face(&self, number: u16, face: Face) -> Option<&Collider<T>> {
        self.faces(number).get(face.number())?.as_ref()
    }

    /// The fixed pieces.
    pub(crate) fn at_rest(&self) -> impl Iterator<Item = NearbyCollider<'_, T>> {
        (0..self.fixed.len() as u16).map(|number| self.fixed_piece(number))
    }

    pub(crate) fn fixed_piece(&self, number: u16) -> NearbyCollider<'_, T> {
        let f = &self.fixed[usize::from(number)];
        NearbyCollider { number, piece: &f.piece, motion: &f.motion, is_fixed: true, of_tool: false }
    }

    /// Gates that are there, then the tool's pieces.
    pub(crate) fn moving<'a>(&'a self, bodies: &'a Bodies<T>) -> impl Iterator<Item = NearbyCollider<'a, T>> {
        let moved = |number, piece, motion, of_tool| NearbyCollider {
            number,
            piece,
            motion,
            is_fixed: false,
            of_tool,
        };
        let first = self.fixed.len() as u16;
        let gates = (first..).zip(self.gates.iter().zip(&bodies.gates));
        let there = gates.filter(|(_, (_, gate))| gate.is_there);
        let gates = there.map(move |(number, (piece, gate))| moved(number, piece, &gate.motion, false));
        let tool = (first + self.gates.len() as u16..).zip(&self.tool);
        gates.chain(tool.map(move |(number, piece)| moved(number, piece, &bodies.tool, true)))
    }

    /// What the fixed pieces leave of the room of a block's nodes; none if all.
    #[inline(always)]
    pub(crate) fn rooms(&self, grid: &Grid, coord: [i32; 3]) -> Option<&[T; BLOCK_NODES]> {
        self.rooms.get(grid.index(coord))?.as_deref()
    }

    /// Pieces that nodes of the block may touch, in the order of application: fixed ones, gates that are there, then the tool's. Among
    /// them those that some nodes are behind.
    pub(crate) fn at_nodes<'a>(
        &'a self,
        grid: &Grid,
        node: &NodeBlock,
        bodies: &'a Bodies<T>,
    ) -> Pieces<'a, T> {
        self.touching(grid, (node.coord, &node.sides), bodies, &self.near_nodes, BLOCK_EDGE)
    }

    /// The same for pieces that take room from the block's nodes.
    pub(crate) fn taking_room<'a>(
        &'a self,
        grid: &Grid,
        node: &NodeBlock,
        bodies: &'a Bodies<T>,
    ) -> Pieces<'a, T> {
        self.touching(grid, (node.coord, &node.sides), bodies, &self.near_rooms, BLOCK_EDGE)
    }

    /// Pieces that particles of the block (slack included) may touch.
    pub(crate) fn at_particles<'a>(
        &'a self,
        grid: &Grid,
        coord: [i32; 3],
        bodies: &'a Bodies<T>,
    ) -> Pieces<'a, T> {
        self.touching(grid, (coord, &[]), bodies, &self.near_particles, BLOCK_EDGE + 4)
    }

    /// Whether the tool is within so many cells of the block's.
    pub(crate) fn tool_is_near(
        &self,
        grid: &Grid,
        coord: [i32; 3],
        tool: &BodyState<T>,
        margin_cells: usize,
    ) -> bool {
        let centre = block_centre(grid, coord);
        let reach = T::from_f64(half_diagonal(BLOCK_EDGE + 2 * margin_cells, grid.dx));
        self.tool.iter().any(|p| distance(p, tool, centre) <= reach + p.node_law.reach())
    }

    /// Whether a gate that has just gone, or moves, is within so many cells of the block's.
    pub(crate) fn is_stirred(
        &self,
        grid: &Grid,
        coord: [i32; 3],
        bodies: &Bodies<T>,
        margin_cells: usize,
    ) -> bool {
        let centre = block_centre(grid, coord);
        let reach = T::from_f64(half_diagonal(BLOCK_EDGE + 2 * margin_cells, grid.dx));
        let mut stirring = self.gates.iter().zip(&bodies.gates).filter(|(_, gate)| gate.stirs);
        stirring.any(|(p, gate)| distance(p, &gate.motion, centre) <= reach + p.node_law.reach())
    }

    fn touching<'a>(
        &'a self,
        grid: &Grid,
        (coord, sides): (Coord, &[Side]),
        bodies: &'a Bodies<T>,
        near: &[Vec<u16>],
        cells: usize,
    ) -> Pieces<'a, T> {
        let near = &near[grid.index(coord)];
        let behind = sides.iter().map(|side| side.of.piece);
        let mut far: Vec<u16> =
            behind.filter(|n| usize::from(*n) < self.fixed.len() && !near.contains(n)).collect();
        let mut out: Pieces<'a, T> = near.iter().map(|number| self.fixed_piece(*number)).collect();
        if !far.is_empty() {
            far.dedup();
            out.extend(far.into_iter().map(|number| self.fixed_piece(number)));
            out.sort_by_key(|piece| piece.number);
        }
        let centre = block_centre(grid, coord);
        let reach = T::from_f64(half_diagonal(cells, grid.dx));
        let is_near = |n: &NearbyCollider<'a, T>| {
            let own = n.piece.node_law.reach().at_least(self.room_reach);
            distance(n.piece, n.motion, centre) <= reach + own
                || sides.iter().any(|side| side.of.piece == n.number)
        };
        out.extend(self.moving(bodies).filter(is_near));
        out
    }
}

/// The faces of a piece, continued beyond its edges: those that there are, by their numbers.
pub(crate) type Faces<T> = [Option<Collider<T>>; Face::PAIRED + 1];

fn faces_of<T: Real>(piece: &Collider<T>) -> Faces<T> {
    std::array::from_fn(|number| piece.continued(Face::from_number(number as i32)))
}

/// From a wall to the farthest node behind it that a particle before it can reach, in cells: half the width of a spline along each
/// axis, and what a particle may move before it is looked at again.
pub(crate) const HIDDEN_REACH_CELLS: f64 = 3.1;

/// The outward normal of a piece at a point in its frame, and the part of a node's spline there that it leaves, with the derivative along
/// the normal. A surface that bends is as one that is flat and lies where it is on average over the spline, whose variance along
/// each axis is a quarter of a cell's square; near the axis of one that is round, where that is not so, it lies [`BEND_LIMIT_CELLS`]
/// off at most. `TWO_SIDED` is whether the piece is.
#[inline(always)]
pub(crate) fn room_of<T: Real, D: SignedDistance<T>, const TWO_SIDED: bool>(
    solid: &D,
    inverse_dx: T,
    y: [T; 3],
) -> ([T; 3], (T, T)) {
    let (s, normal) = solid.distance::<T>(y);
    let s = inverse_dx * s;
    let endless = T::from_f64(ENDLESS);
    let own = solid.half_thickness().map_or(endless, |half| inverse_dx * (half + half));
    if !TWO_SIDED {
        return (normal, room_beside(s, own));
    }
    let hides = solid.face(y) < Face::PAIRED as i32;
    let (eighth, dx) = (T::from_f64(0.125), T::ONE / inverse_dx);
    let [bend, slope] = solid.bend(y);
    let limit = T::from_f64(BEND_LIMIT_CELLS);
    let bent = eighth * dx * bend;
    let slope = slope.only_if(bent.abs() < limit);
    let bent = bent.at_least(-limit).at_most(limit);
    let (room, by_distance) = room_beside(s + bent, if hides { endless } else { own });
    (normal, (room, by_distance * (T::ONE + eighth * dx * dx * slope)))
}

/// How far a surface that bends lies from one that is flat at most, on average over a node's spline, in cells.
const BEND_LIMIT_CELLS: f64 = 0.25;

/// Half the width of a node's spline, in cells: nothing farther off takes room from it.
const ROOM_REACH_CELLS: f64 = 1.5;

/// What some fixed pieces leave of the room of a block's nodes.
fn rooms<T: Real>(
    grid: &Grid,
    index: usize,
    near: &[u16],
    fixed: &[FixedCollider<T>],
) -> Option<Box<[T; BLOCK_NODES]>> {
    if near.is_empty() {
        return None;
    }
    let origin = grid.block_origin(grid.coord(index));
    let node = |n: usize| {
        let ijk = [n / (BLOCK_EDGE * BLOCK_EDGE), n / BLOCK_EDGE % BLOCK_EDGE, n % BLOCK_EDGE];
        let x = [0, 1, 2].map(|axis| T::from_f64(origin[axis] + ijk[axis] as f64 * grid.dx));
        let pieces = near.iter().map(|i| &fixed[usize::from(*i)]);
        pieces.fold(T::ONE, |room, f| {
            let inverse_dx = T::from_f64(1.0 / grid.dx);
            let y = tr_mul_vec(&f.motion.rotation, sub(x, f.motion.position));
            room * with_solid!(f.piece.shape, solid => if f.piece.is_two_sided {
                room_of::<T, _, true>(&solid, inverse_dx, y).1.0
            } else {
                room_of::<T, _, false>(&solid, inverse_dx, y).1.0
            })
        })
    };
    Some(Box::new(std::array::from_fn(node)))
}

/// A piece near a block, with its motion at this instant.
#[derive(Clone, Copy)]
pub(crate) struct NearbyCollider<'a, T> {
    /// Fixed pieces first, then gates, then the tool's.
    pub(crate) number: u16,
    pub(crate) piece: &'a Collider<T>,
    pub(crate) motion: &'a BodyState<T>,
    /// Never moves nor goes.
    pub(crate) is_fixed: bool,
    pub(crate) of_tool: bool,
}

/// As many pieces as are near a block, as a rule: no memory is asked for then.
pub(crate) const USUALLY_NEAR: usize = 8;

/// Pieces near a block.
pub(crate) type Pieces<'a, T> = SmallVec<[NearbyCollider<'a, T>; USUALLY_NEAR]>;

pub(crate) fn block_centre<T: Real>(grid: &Grid, coord: [i32; 3]) -> [T; 3] {
    grid.block_origin(coord).map(|o| T::from_f64(o + 0.5 * BLOCK_EDGE as f64 * grid.dx))
}

pub(crate) fn distance<T: Real>(piece: &Collider<T>, motion: &BodyState<T>, x: [T; 3]) -> T {
    let y = tr_mul_vec(&motion.rotation, sub(x, motion.position));
    with_solid!(piece.shape, solid => solid.distance::<T>(y).0)
}

/// Outward push of particles that got below a surface: fraction of the depth per substep, and its bound, m/s.
const PUSH_FRACTION: f64 = 0.1;
const PUSH_LIMIT: f64 = 0.05;
/// The particles' band as a fraction of the nodes': particle contact only closes what the grid cannot resolve.
const PARTICLE_BAND: f64 = 0.4;

struct Builder {
    band: f64,
    dt: f64,
    dx: f64,
    two_sided: bool,
}

impl Builder {
    fn new(scene: &Scene) -> Self {
        let period = f64::from(scene.time.control_period_us) * 1e-6;
        Self {
            band: scene.domain.contact_band_cells * scene.domain.cell_m,
            dt: period / f64::from(scene.time.substeps),
            dx: scene.domain.cell_m,
            two_sided: scene.domain.walls == Walls::TwoSided,
        }
    }

    fn piece<T: Real>(&self, solid: Shape<f64>, friction: f64) -> Collider<T> {
        let shape = solid.rounded::<T>();
        let is_two_sided = self.two_sided && shape.has_two_sides();
        // Walls thinner than a cell could lie between two nodes and stop none of them, unless those behind them count.
        let inflation = |h: T| (T::from_f64(0.5 * self.dx) - h).at_least(T::ZERO).only_if(!is_two_sided);
        let lets_go = self.two_sided || shape.half_thickness().is_none();
        let node_law = ContactParams {
            friction: T::from_f64(friction),
            band: T::from_f64(self.band),
            inflation: shape.half_thickness().map_or(T::ZERO, inflation),
            separation_factor: T::ONE.only_if(lets_go),
            pushout_rate: T::ZERO,
            max_pushout_speed: T::ZERO,
        };
        let particle_law = ContactParams {
            band: T::from_f64(self.band * PARTICLE_BAND),
            inflation: T::ZERO,
            separation_factor: T::ONE,
            pushout_rate: T::from_f64(PUSH_FRACTION / self.dt),
            max_pushout_speed: T::from_f64(PUSH_LIMIT),
            ..node_law
        };
        Collider { shape, node_law, particle_law, is_two_sided }
    }

    /// Floor, four sides and lid of the simulated volume.
    fn domain<T: Real>(&self, scene: &Scene) -> Vec<FixedCollider<T>> {
        let size = scene.domain.size_m;
        // Inward normal (third column: the half space's z axis) and a point of each wall.
        let walls = [
            ([0.0, 0.0, 1.0], [0.0; 3]),
            ([1.0, 0.0, 0.0], [0.0; 3]),
            ([0.0, 1.0, 0.0], [0.0; 3]),
            ([-1.0, 0.0, 0.0], size),
            ([0.0, -1.0, 0.0], size),
            ([0.0, 0.0, -1.0], size),
        ];
        walls
            .into_iter()
            .map(|(normal, point)| {
                let piece = self.piece(Shape::HalfSpace(HalfSpace), scene.domain.friction);
                FixedCollider { piece, motion: at_rest(frame_with_z(normal), point) }
            })
            .collect()
    }

    fn container<T: Real>(&self, c: &Container) -> Vec<FixedCollider<T>> {
        let rotation = turned(c.yaw_deg);
        let fixed = |shape| FixedCollider {
            piece: self.piece(shape, c.friction),
            motion: at_rest(rotation, c.position_m),
        };
        container_shapes(c).into_iter().map(fixed).collect()
    }

    /// A gate in its own frame.
    fn gate<T: Real>(&self, gate: &Gate) -> Collider<T> {
        self.piece(gate_shape(gate), gate.friction)
    }

    /// The tool's pieces in its own frame.
    fn tool<T: Real>(&self, tool: &Tool) -> Vec<Collider<T>> {
        tool.solids().into_iter().map(|solid| self.piece(solid, tool.friction)).collect()
    }
}

/// Floor and walls of a container in its own frame.
pub(crate) fn container_shapes(c: &Container) -> Vec<Shape<f64>> {
    let t = c.wall_thickness_m;
    match c.shape {
        ContainerShape::Box { inner_size_m } => {
            let [lx, ly, _] = inner_size_m;
            let floor = block([0.0, 0.0, -0.5 * t], [0.5 * lx + t, 0.5 * ly + t, 0.5 * t]);
            std::iter::once(floor).chain(box_walls(inner_size_m, t)).collect()
        }
        ContainerShape::SlottedBox { inner_size_m, slot_width_m: slot } => {
            let [lx, ly, _] = inner_size_m;
            // From the slot to the outside of the wall.
            let (middle, half) = (0.5 * (0.5 * (slot + lx) + t), 0.5 * (0.5 * (lx - slot) + t));
            let floor = |x: f64| block([x, 0.0, -0.5 * t], [half, 0.5 * ly + t, 0.5 * t]);
            [floor(middle), floor(-middle)].into_iter().chain(box_walls(inner_size_m, t)).collect()
        }
        ContainerShape::Cylinder { inner_radius_m: r, inner_height_m: h } => vec![
            ring(0.0, r + t, -0.5 * t, 0.5 * t),
            ring(r + 0.5 * t, 0.5 * t, 0.5 * (h - t), 0.5 * (h + t)),
        ],
        ContainerShape::Silo { inner_radius_m: r, inner_height_m: h, outlet_radius_m: hole } => vec![
            ring(0.5 * (hole + r + t), 0.5 * (r + t - hole), -0.5 * t, 0.5 * t),
            ring(r + 0.5 * t, 0.5 * t, 0.5 * (h - t), 0.5 * (h + t)),
        ],
        ContainerShape::Hopper {
            inner_radius_m: r,
            inner_height_m: h,
            outlet_radius_m: hole,
            half_angle_deg,
        } => {
            let (top, (sin, cos)) = (c.shape.cone_height_m(), libm::sincos(half_angle_deg.to_radians()));
            let cone = Cone {
                radius: 0.5 * (hole + r + t * cos),
                height: 0.5 * (top - t * sin),
                half_across: 0.5 * t,
                half_along: 0.5 * libm::hypot(r - hole, top),
                lean: [sin, cos],
            };
            let upright = |low: f64| ring(r + 0.5 * t, 0.5 * t, 0.5 * (h + low), 0.5 * (h - low));
            let upright = c.shape.upright_from_m(t).map(upright);
            [Some(Shape::Cone(cone)), upright].into_iter().flatten().collect()
        }
    }
}

/// Walls of a box in its own frame, down to the floor's underside.
fn box_walls([lx, ly, h]: [f64; 3], t: f64) -> [Shape<f64>; 4] {
    let (hx, hy) = (0.5 * lx, 0.5 * ly);
    let (middle, half_height) = (0.5 * (h - t), 0.5 * (h + t));
    [
        block([hx + 0.5 * t, 0.0, middle], [0.5 * t, hy + t, half_height]),
        block([-hx - 0.5 * t, 0.0, middle], [0.5 * t, hy + t, half_height]),
        block([0.0, hy + 0.5 * t, middle], [hx + t, 0.5 * t, half_height]),
        block([0.0, -hy - 0.5 * t, middle], [hx + t, 0.5 * t, half_height]),
    ]
}

/// A gate in its own frame.
pub(crate) fn gate_shape(gate: &Gate) -> Shape<f64> {
    match gate.shape {
        GateShape::Box { size_m } => Shape::AlignedBox(AlignedBox {
            centre: [0.0, 0.0, 0.5 * size_m[2]],
            half: size_m.map(|edge| 0.5 * edge),
        }),
        GateShape::Tube { inner_radius_m: r, height_m: h, wall_thickness_m: t } => {
            ring(r + 0.5 * t, 0.5 * t, 0.5 * h, 0.5 * h)
        }
    }
}

fn block(centre: [f64; 3], half: [f64; 3]) -> Shape<f64> {
    Shape::AlignedBox(AlignedBox { centre, half })
}

/// A tube about the vertical, or a disc, by the middle of its profile and half of its extents.
fn ring(radius: f64, half_radial: f64, height: f64, half_axial: f64) -> Shape<f64> {
    Shape::Tube(Tube { radius, half_radial, height, half_axial })
}

fn at_rest<T: Real>(rotation: [[f64; 3]; 3], position: [f64; 3]) -> BodyState<T> {
    BodyState {
        rotation: rotation.map(|row| row.map(T::from_f64)),
        position: position.map(T::from_f64),
        velocity: [T::ZERO; 3],
        angular_velocity: [T::ZERO; 3],
    }
}

/// A rotation whose third column is the given axis direction.
fn frame_with_z(z: [f64; 3]) -> [[f64; 3]; 3] {
    let x = if z[0] == 0.0 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let y = crate::small::cross(z, x);
    [[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]]]
}
