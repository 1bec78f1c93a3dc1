//! Walls with two sides: who sees which nodes of the grid.
//!
//! A node in a wall, or a cell behind it, gets mass from powder on either side, and a velocity that is neither's: a part of what presses on
//! one side is felt on the other, and powder that lets go is held back. With `walls = "two_sided"` each particle has, for each piece of
//! a wall near it, the face that it is before ([`crate::shape::Face`]). It does not see what that face hides: nodes in the
//! solid, and those before the opposite face. Such a node is another one for it: it has a layer of its own ([`super::layers`]), with
//! mass and momentum of those for whom it is behind the same faces, and with contact with these faces as if they went on beyond their
//! edges. Momentum is kept and weights add up to 1, as everybody gathers from the nodes to which they scatter.
//!
//! Beyond an edge a particle is before no face. The solid is hidden from it, without contact: contact at the particle itself is what it
//! has there.
//!
//! Particles are sorted by block and faces, so that those of one tile see the same nodes. What they are before, and what tool
//! and gates hide, is looked at when particles are sorted, and every [`LOOK_EVERY`] substeps. In between, who has gone
//! around an edge, and nodes that a tool has passed, count for what they were: particles go a tenth of a cell in that time, the tool a
//! fifth.
//!
//! The adjoint goes back through the same tiles and layers. Sides are whole numbers: it is the derivative between the jumps at which
//! somebody comes to be before another face.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::mpm::Model;
use crate::mpm::bodies::Bodies;
use crate::mpm::grid_update::{CHUNKS, NodeLanes};
use crate::mpm::layout::{BLOCK_EDGE, Block, Grid, Hidden, HiddenBy, Layout, NodeSet, WallFace};
use crate::mpm::obstacle::{
    Colliders, Faces, HIDDEN_REACH_CELLS, NearbyCollider, block_centre, distance, half_diagonal,
};
use crate::mpm::particles::{Group, LANES, Lanes, vec_of};
use crate::mpm::sleep::SleepState;
use crate::real::Real;
use crate::shape::{Face, Shape, SignedDistance, with_solid};
use crate::small::{Vec3, mul_vec, sub, tr_mul_vec};

/// Substeps after which it is looked who is before what.
pub(crate) const LOOK_EVERY: u32 = 8;

/// A particle reaches so far beyond its cell along each axis, in cells.
const SPLINE_REACH_CELLS: f64 = 1.5;
/// What it may go before it is looked at again, and what a wall bends towards it within its reach, in cells.
const SLACK_CELLS: f64 = 0.5;
/// Points so near to a surface, in cells, lie in it: containers stand on nodes.
const SKIN_CELLS: f64 = 1e-4;

/// What fixed walls hide, and near which blocks they are.
#[derive(Clone, Debug)]
pub(crate) struct Walls {
    /// For each block of the grid the numbers of those that its particles may come near to.
    near: Vec<Vec<u16>>,
    /// What they hide of each block of nodes, in the order of blocks and pieces.
    hidden: BTreeMap<u32, Vec<(u16, Hidden)>>,
}

impl Walls {
    /// None if walls have no two sides.
    pub(crate) fn new<T: Real>(
        grid: &Grid,
        colliders: &Colliders<T>,
        node_places: &NodeLanes<T>,
        arch: super::Arch<T>,
    ) -> Option<Self> {
        if !colliders.have_two_sides() {
            return None;
        }
        let walls: Vec<_> = colliders.at_rest().filter(|piece| piece.piece.is_two_sided).collect();
        let mut out = Self { near: vec![Vec::new(); grid.block_count()], hidden: BTreeMap::new() };
        for (index, near) in out.near.iter_mut().enumerate() {
            let coord = grid.coord(index);
            near.extend(walls.iter().filter(|w| reaches_particles(grid, coord, w)).map(|w| w.number));
            let of_nodes = walls.iter().filter(|wall| reaches_nodes(grid, coord, wall));
            let hides = |wall: &NearbyCollider<'_, T>| {
                let faces = colliders.faces(wall.number);
                let hidden = arch.dispatch(HiddenNodes { wall: *wall, faces, grid, coord, node_places });
                (hidden != Hidden::NOTHING).then_some((wall.number, hidden))
            };
            let hidden: Vec<_> = of_nodes.filter_map(hides).collect();
            if !hidden.is_empty() {
                out.hidden.insert(index as u32, hidden);
            }
        }
        Some(out)
    }

    /// Pieces that particles of a block may come near to.
    fn near<'a, T: Real>(
        &self,
        model: &'a Model<T>,
        bodies: &'a Bodies<T>,
        coord: [i32; 3],
    ) -> Vec<NearbyCollider<'a, T>> {
        let grid = &model.grid;
        let fixed = self.near[grid.index(coord)].iter().map(|number| model.obstacles.fixed_piece(*number));
        let moving = moving_walls(model, bodies).filter(|wall| reaches_particles(grid, coord, wall));
        fixed.chain(moving).collect()
    }
}

fn moving_walls<'a, T: Real>(
    model: &'a Model<T>,
    bodies: &'a Bodies<T>,
) -> impl Iterator<Item = NearbyCollider<'a, T>> {
    model.obstacles.moving(bodies).filter(|wall| wall.piece.is_two_sided)
}

fn reaches_particles<T: Real>(grid: &Grid, coord: [i32; 3], wall: &NearbyCollider<'_, T>) -> bool {
    is_within(grid, coord, wall, BLOCK_EDGE + 2)
}

fn reaches_nodes<T: Real>(grid: &Grid, coord: [i32; 3], wall: &NearbyCollider<'_, T>) -> bool {
    is_within(grid, coord, wall, BLOCK_EDGE)
}

fn is_within<T: Real>(grid: &Grid, coord: [i32; 3], wall: &NearbyCollider<'_, T>, cells: usize) -> bool {
    let reach = half_diagonal(cells, grid.dx) + HIDDEN_REACH_CELLS * grid.dx;
    distance(wall.piece, wall.motion, block_centre(grid, coord)) <= T::from_f64(reach)
}

/// Points in a body's frame.
#[inline(always)]
fn in_frame<T: Real>(wall: &NearbyCollider<'_, T>, x: &[Lanes<T>; 3]) -> [Lanes<T>; 3] {
    let motion = *wall.motion;
    let mut out = [Lanes::ZERO; 3];
    for l in 0..LANES {
        let y = tr_mul_vec(&motion.rotation, sub(vec_of(x, l), motion.position));
        for axis in 0..3 {
            out[axis][l] = y[axis];
        }
    }
    out
}

#[inline(always)]
fn distances<T: Real>(shape: &Shape<T>, y: &[Lanes<T>; 3]) -> Lanes<T> {
    let mut out = Lanes::ZERO;
    with_solid!(*shape, solid => {
        for l in 0..LANES {
            out[l] = solid.distance::<T>(vec_of(y, l)).0;
        }
    });
    out
}

/// Bit `l` is set where the number of lane `l` is below a limit.
#[inline(always)]
fn below<T: Real>(lanes: &Lanes<T>, limit: T) -> NodeSet {
    let mut bits = [0u16; LANES];
    for l in 0..LANES {
        bits[l] = u16::from(lanes[l] < limit) << l;
    }
    bits.iter().fold(0u16, |all, bit| all | bit).into()
}

/// Finds what a wall hides of a block of nodes.
struct HiddenNodes<'a, T> {
    wall: NearbyCollider<'a, T>,
    faces: &'a Faces<T>,
    grid: &'a Grid,
    coord: [i32; 3],
    node_places: &'a NodeLanes<T>,
}

impl<T: Real> pulp::NullaryFnOnce for HiddenNodes<'_, T> {
    type Output = Hidden;

    #[inline(always)]
    fn call(self) -> Hidden {
        let origin = self.grid.block_origin(self.coord).map(T::from_f64);
        let [skin, reach] = [SKIN_CELLS, HIDDEN_REACH_CELLS].map(|cells| T::from_f64(cells * self.grid.dx));
        let mut out = Hidden::NOTHING;
        for chunk in 0..CHUNKS {
            let mut x = self.node_places[chunk];
            for axis in 0..3 {
                for l in 0..LANES {
                    x[axis][l] += origin[axis];
                }
            }
            let y = in_frame(&self.wall, &x);
            let s = distances(&self.wall.piece.shape, &y);
            let near = below(&s, reach);
            if near == 0 {
                continue;
            }
            let to_place = chunk * LANES;
            out.solid |= below(&s, skin) << to_place;
            for (number, before) in out.before.iter_mut().enumerate() {
                if let Some(face) = &self.faces[number] {
                    let not_before = below(&distances(&face.shape, &y), skin);
                    *before |= (near & !not_before) << to_place;
                }
            }
        }
        out
    }
}

/// What particles are before: for each piece and lane the number of the face, and [`MATTERS`] if the particle is so near that something
/// may be hidden from it.
struct FacesOfParticles<'a, T> {
    model: &'a Model<T>,
    wall: NearbyCollider<'a, T>,
    x: &'a [Lanes<T>; 3],
}

const MATTERS: u8 = 8;

impl<T: Real> pulp::NullaryFnOnce for FacesOfParticles<'_, T> {
    type Output = [u8; LANES];

    #[inline(always)]
    fn call(self) -> [u8; LANES] {
        let inverse_dx = self.model.inverse_dx;
        let [reach, slack] = [SPLINE_REACH_CELLS, SLACK_CELLS].map(T::from_f64);
        let y = in_frame(&self.wall, self.x);
        let rotation = self.wall.motion.rotation;
        let mut out = [0; LANES];
        with_solid!(self.wall.piece.shape, solid => {
            let mut faces = [0; LANES];
            let mut matters = [0; LANES];
            for l in 0..LANES {
                let (s, normal) = solid.distance::<T>(vec_of(&y, l));
                let n: Vec3<T> = mul_vec(&rotation, normal);
                let along_axes = n[0].abs() + n[1].abs() + n[2].abs();
                matters[l] = i32::from(s * inverse_dx < reach * along_axes + slack);
                faces[l] = SignedDistance::<T>::face(&solid, vec_of(&y, l));
            }
            for l in 0..LANES {
                out[l] = (faces[l] + i32::from(MATTERS) * matters[l]) as u8;
            }
        });
        out
    }
}

/// Particles of a block that are before the same faces, by their numbers in it.
pub(crate) struct Part {
    pub(crate) faces: Vec<WallFace>,
    pub(crate) particles: Vec<u32>,
}

/// Parts a block's particles by the faces that they are before; `None` if they all stay together, before no face that matters.
pub(crate) fn parted<T: Real>(
    model: &Model<T>,
    bodies: &Bodies<T>,
    coord: [i32; 3],
    x: impl Fn(usize) -> Vec3<T>,
    particles: usize,
) -> Option<Vec<Part>> {
    let near = model.walls.as_ref()?.near(model, bodies, coord);
    if near.is_empty() {
        return None;
    }
    let mut groups = vec![[Lanes::ZERO; 3]; particles.div_ceil(LANES)];
    for lane in 0..groups.len() * LANES {
        // Lanes beyond the last particle are as that one.
        let x = x(lane.min(particles - 1));
        (0..3).for_each(|axis| groups[lane / LANES][axis][lane % LANES] = x[axis]);
    }
    let mut common = Vec::new();
    // Of each particle; those that have had the same face of every piece so far have the same number.
    let mut classes: Vec<u32> = vec![0; particles];
    let mut faces_of_class: Vec<Vec<WallFace>> = vec![Vec::new()];
    for wall in near {
        let of_group = |x: &[Lanes<T>; 3]| model.arch.dispatch(FacesOfParticles { model, wall, x });
        let codes: Vec<u8> = groups.iter().flat_map(of_group).take(particles).collect();
        let Some(faces) = own_faces(&codes) else { continue };
        let piece = wall.number;
        if let Some(face) = faces[0].filter(|_| faces.iter().all(|face| *face == faces[0])) {
            common.push(WallFace { piece, face });
            continue;
        }
        let mut pairs: Vec<(u32, Option<Face>)> =
            classes.iter().copied().zip(faces.iter().copied()).collect();
        pairs.sort_unstable();
        pairs.dedup();
        let with = |(class, face): &(u32, Option<Face>)| {
            let mut faces = faces_of_class[*class as usize].clone();
            faces.extend(face.map(|face| WallFace { piece, face }));
            faces
        };
        let next = pairs.iter().map(with).collect();
        for (class, face) in classes.iter_mut().zip(faces) {
            *class = pairs.binary_search(&(*class, face)).expect("one of them") as u32;
        }
        faces_of_class = next;
    }
    if common.is_empty() && faces_of_class.len() == 1 {
        return None;
    }
    let mut parts: Vec<Part> = faces_of_class
        .into_iter()
        .map(|mut faces| {
            faces.extend(&common);
            faces.sort_unstable();
            Part { faces, particles: Vec::new() }
        })
        .collect();
    for (particle, class) in classes.into_iter().enumerate() {
        parts[class as usize].particles.push(particle as u32);
    }
    Some(parts)
}

/// Which faces of a piece count, from the codes of a block's particles: of those that are near their own; of the others as well, if it
/// is one of these. None if nobody is near.
fn own_faces(codes: &[u8]) -> Option<Vec<Option<Face>>> {
    let mut counts = [false; MATTERS as usize];
    for code in codes.iter().filter(|code| **code >= MATTERS) {
        counts[usize::from(code % MATTERS)] = true;
    }
    let own = |code: &u8| {
        let face = code % MATTERS;
        counts[usize::from(face)].then(|| Face::from_number(face.into()))
    };
    counts.contains(&true).then(|| codes.iter().map(own).collect())
}

/// Of each block whether some of its particles are before other faces than when they were sorted.
pub(crate) fn before_other_faces<T: Real>(
    model: &Model<T>,
    bodies: &Bodies<T>,
    layout: &Layout,
    groups: &[Group<T>],
    rest: &[SleepState<T>],
) -> Vec<bool> {
    let Some(walls) = &model.walls else { return vec![false; layout.blocks.len()] };
    let is_wrong = |(block, rest): (&Block, &SleepState<T>)| {
        !rest.is_asleep()
            && walls.near(model, bodies, block.coord).into_iter().any(|wall| {
                let face = block.faces.iter().find(|face| face.piece == wall.number);
                let right = face.map_or(u8::MAX, |face| MATTERS + face.face.number() as u8);
                (0..block.groups()).any(|g| {
                    let x = &groups[block.first_group + g].x;
                    let codes = model.arch.dispatch(FacesOfParticles { model, wall, x });
                    codes[..block.occupied(g)].iter().any(|code| *code >= MATTERS && *code != right)
                })
            })
    };
    layout.blocks.par_iter().zip(rest).with_min_len(4).map(is_wrong).collect()
}

/// What those of the moving pieces hide of the blocks of nodes that some particles are near to.
pub(crate) fn moving_hidden<T: Real>(
    model: &Model<T>,
    bodies: &Bodies<T>,
    blocks: &[Block],
    nodes: impl Iterator<Item = [i32; 3]>,
) -> Vec<HiddenBy> {
    if model.walls.is_none() {
        return Vec::new();
    }
    let (grid, node_places) = (&model.grid, &model.node_places);
    let is_near = |wall: &NearbyCollider<'_, T>| {
        blocks.iter().any(|block| block.faces.iter().any(|face| face.piece == wall.number))
    };
    let walls: Vec<_> = moving_walls(model, bodies).filter(is_near).collect();
    let mut out = Vec::new();
    for coord in nodes {
        for wall in walls.iter().filter(|wall| reaches_nodes(grid, coord, wall)) {
            let faces = model.obstacles.faces(wall.number);
            let kernel = HiddenNodes { wall: *wall, faces, grid, coord, node_places };
            let nodes = model.arch.dispatch(kernel);
            if nodes != Hidden::NOTHING {
                out.push(HiddenBy { block: grid.index(coord) as u32, piece: wall.number, nodes });
            }
        }
    }
    out
}

/// What the pieces hide of a block of nodes that some of those who send to it are before; `moving` is of this block.
pub(crate) fn hidden_of<T: Real>(
    model: &Model<T>,
    index: usize,
    moving: &[HiddenBy],
    is_asked_for: impl Fn(u16) -> bool,
) -> Vec<(u16, Hidden)> {
    let fixed = model.walls.as_ref().and_then(|walls| walls.hidden.get(&(index as u32)));
    let fixed = fixed.into_iter().flatten().copied();
    fixed
        .chain(moving.iter().map(|by| (by.piece, by.nodes)))
        .filter(|(piece, _)| is_asked_for(*piece))
        .collect()
}
