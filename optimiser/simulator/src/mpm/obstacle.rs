//! What stands in the powder's way: the domain's walls, containers, and the tool, as lists of convex or shell
//! pieces, each with its own contact law.
//!
//! A container is several pieces, applied one after the other, rather than one union: the normal of a union
//! jumps along the bisector of an inner corner, the composition of pieces does not.

use crate::mpm::contact::{BodyState, ContactParams};
use crate::mpm::layout::{BLOCK_EDGE, Grid};
use crate::real::Real;
use crate::scene::{Container, ContainerShape, Cuboid, Scene, Tool, ToolShape};
use crate::shape::{
    AlignedBox, Bowl, Capsule, HalfSpace, OrientedBox, Shape, SignedDistance, Tube, with_solid,
};
use crate::small::{sub, tr_mul_vec};

/// One piece of a body.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Collider<T> {
    pub(crate) shape: Shape<T>,
    pub(crate) node_law: ContactParams<T>,
    pub(crate) particle_law: ContactParams<T>,
}

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
    pub(crate) tool: Vec<Collider<T>>,
    /// For each block of the grid the fixed pieces that its nodes can touch.
    near_nodes: Vec<Vec<u16>>,
    /// For each block of the grid the fixed pieces that its particles can touch.
    near_particles: Vec<Vec<u16>>,
}

/// Half the diagonal of a cube of `cells`, m.
fn half_diagonal(cells: usize, dx: f64) -> f64 {
    0.5 * 3f64.sqrt() * cells as f64 * dx
}

impl<T: Real> Colliders<T> {
    pub(crate) fn new(scene: &Scene, grid: &Grid) -> Self {
        let builder = Builder::new(scene);
        let mut fixed = builder.domain(scene);
        for container in &scene.containers {
            fixed.extend(builder.container(container));
        }
        let tool = builder.tool(&scene.tool);
        let near = |cells: usize| {
            (0..grid.block_count())
                .map(|index| {
                    let centre = block_centre(grid, grid.coord(index));
                    let reach = T::from_f64(half_diagonal(cells, grid.dx));
                    let touches = |f: &FixedCollider<T>| {
                        distance(&f.piece, &f.motion, centre) <= reach + f.piece.node_law.reach()
                    };
                    (0u16..).zip(&fixed).filter(|(_, f)| touches(f)).map(|(i, _)| i).collect()
                })
                .collect()
        };
        let (near_nodes, near_particles) = (near(BLOCK_EDGE), near(BLOCK_EDGE + 4));
        Self { fixed, tool, near_nodes, near_particles }
    }

    /// Pieces that nodes of the block may touch, in the order of application: fixed ones, then the tool's.
    pub(crate) fn at_nodes<'a>(
        &'a self,
        grid: &Grid,
        coord: [i32; 3],
        tool: &'a BodyState<T>,
    ) -> Vec<NearbyCollider<'a, T>> {
        self.touching(grid, coord, tool, &self.near_nodes, BLOCK_EDGE)
    }

    /// Pieces that particles of the block (slack included) may touch.
    pub(crate) fn at_particles<'a>(
        &'a self,
        grid: &Grid,
        coord: [i32; 3],
        tool: &'a BodyState<T>,
    ) -> Vec<NearbyCollider<'a, T>> {
        self.touching(grid, coord, tool, &self.near_particles, BLOCK_EDGE + 4)
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

    fn touching<'a>(
        &'a self,
        grid: &Grid,
        coord: [i32; 3],
        tool: &'a BodyState<T>,
        near: &[Vec<u16>],
        cells: usize,
    ) -> Vec<NearbyCollider<'a, T>> {
        let fixed = near[grid.index(coord)].iter().map(|i| {
            let f = &self.fixed[usize::from(*i)];
            NearbyCollider { piece: &f.piece, motion: &f.motion, moving: false }
        });
        let centre = block_centre(grid, coord);
        let reach = T::from_f64(half_diagonal(cells, grid.dx));
        let moving = self
            .tool
            .iter()
            .filter(|p| distance(p, tool, centre) <= reach + p.node_law.reach())
            .map(|piece| NearbyCollider { piece, motion: tool, moving: true });
        fixed.chain(moving).collect()
    }
}

/// A piece near a block, with its motion at this instant.
#[derive(Clone, Copy)]
pub(crate) struct NearbyCollider<'a, T> {
    pub(crate) piece: &'a Collider<T>,
    pub(crate) motion: &'a BodyState<T>,
    /// Belongs to the tool.
    pub(crate) moving: bool,
}

fn block_centre<T: Real>(grid: &Grid, coord: [i32; 3]) -> [T; 3] {
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
}

impl Builder {
    fn new(scene: &Scene) -> Self {
        let period = f64::from(scene.time.control_period_us) * 1e-6;
        Self {
            band: scene.domain.contact_band_cells * scene.domain.cell_m,
            dt: period / f64::from(scene.time.substeps),
            dx: scene.domain.cell_m,
        }
    }

    fn piece<T: Real>(&self, shape: Shape<T>, friction: f64) -> Collider<T> {
        // Walls thinner than a cell could lie between two nodes and stop none of them.
        let node_law = ContactParams {
            friction: T::from_f64(friction),
            band: T::from_f64(self.band),
            inflation: shape
                .half_thickness()
                .map_or(T::ZERO, |h| (T::from_f64(0.5 * self.dx) - h).at_least(T::ZERO)),
            separation_factor: if shape.half_thickness().is_some() { T::ZERO } else { T::ONE },
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
        Collider { shape, node_law, particle_law }
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
        let t = c.wall_thickness_m;
        let shapes = match c.shape {
            ContainerShape::Box { inner_size_m: [lx, ly, h] } => {
                let wall = |centre: [f64; 3], half: [f64; 3]| {
                    Shape::AlignedBox(AlignedBox {
                        centre: centre.map(T::from_f64),
                        half: half.map(T::from_f64),
                    })
                };
                let (hx, hy) = (0.5 * lx, 0.5 * ly);
                let middle = 0.5 * (h - t);
                let half_height = 0.5 * (h + t);
                vec![
                    wall([0.0, 0.0, -0.5 * t], [hx + t, hy + t, 0.5 * t]),
                    wall([hx + 0.5 * t, 0.0, middle], [0.5 * t, hy + t, half_height]),
                    wall([-hx - 0.5 * t, 0.0, middle], [0.5 * t, hy + t, half_height]),
                    wall([0.0, hy + 0.5 * t, middle], [hx + t, 0.5 * t, half_height]),
                    wall([0.0, -hy - 0.5 * t, middle], [hx + t, 0.5 * t, half_height]),
                ]
            }
            ContainerShape::Cylinder { inner_radius_m: r, inner_height_m: h } => {
                let ring = |radius: f64, half_radial: f64, height: f64, half_axial: f64| {
                    Shape::Tube(Tube {
                        radius: T::from_f64(radius),
                        half_radial: T::from_f64(half_radial),
                        height: T::from_f64(height),
                        half_axial: T::from_f64(half_axial),
                    })
                };
                vec![
                    ring(0.0, r + t, -0.5 * t, 0.5 * t),
                    ring(r + 0.5 * t, 0.5 * t, 0.5 * (h - t), 0.5 * (h + t)),
                ]
            }
        };
        let yaw = c.yaw_deg.to_radians();
        let (sin, cos) = (libm::sin(yaw), libm::cos(yaw));
        let rotation = [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]];
        let fixed = |shape| FixedCollider {
            piece: self.piece(shape, c.friction),
            motion: at_rest(rotation, c.position_m),
        };
        shapes.into_iter().map(fixed).collect()
    }

    /// The tool's pieces in its own frame.
    fn tool<T: Real>(&self, tool: &Tool) -> Vec<Collider<T>> {
        let t = tool.wall_thickness_m;
        let mut shapes = match &tool.shape {
            ToolShape::Bowl { inner_radius_m: r } => {
                vec![Shape::Bowl(Bowl { radius: T::from_f64(r + 0.5 * t), half: T::from_f64(0.5 * t) })]
            }
            ToolShape::BoxScoop { inner_size_m: [l, w, h] } => scoop(*l, *w, *h, t),
            ToolShape::Cuboids { cuboid } => cuboid.iter().map(oriented).collect(),
        };
        let (from, along) = tool.handle();
        shapes.push(Shape::Capsule(Capsule {
            from: from.map(T::from_f64),
            along: along.map(T::from_f64),
            radius: T::from_f64(tool.handle.radius_m),
        }));
        shapes.into_iter().map(|shape| self.piece(shape, tool.friction)).collect()
    }
}

/// Floor, back and two sides of a box scoop; the opening's middle is the origin, the front (+x) is open.
fn scoop<T: Real>(l: f64, w: f64, h: f64, t: f64) -> Vec<Shape<T>> {
    let wall = |centre: [f64; 3], half: [f64; 3]| {
        Shape::AlignedBox(AlignedBox { centre: centre.map(T::from_f64), half: half.map(T::from_f64) })
    };
    let (hl, hw) = (0.5 * l, 0.5 * w);
    let half_height = 0.5 * (h + t);
    vec![
        wall([-0.5 * t, 0.0, -h - 0.5 * t], [hl + 0.5 * t, hw + t, 0.5 * t]),
        wall([-hl - 0.5 * t, 0.0, -half_height], [0.5 * t, hw + t, half_height]),
        wall([-0.5 * t, hw + 0.5 * t, -half_height], [hl + 0.5 * t, 0.5 * t, half_height]),
        wall([-0.5 * t, -hw - 0.5 * t, -half_height], [hl + 0.5 * t, 0.5 * t, half_height]),
    ]
}

fn oriented<T: Real>(cuboid: &Cuboid) -> Shape<T> {
    Shape::OrientedBox(OrientedBox {
        centre: cuboid.centre_m.map(T::from_f64),
        half: cuboid.size_m.map(|edge| T::from_f64(0.5 * edge)),
        axes: cuboid.axes().map(|axis| axis.map(T::from_f64)),
    })
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
