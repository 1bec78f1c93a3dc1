//! Sorting: particles into the order of the grid's blocks and cells, and the layout of blocks that follows from it.

use crate::mpm::Model;
use crate::mpm::bodies::Bodies;
use crate::mpm::connect::{connected, connected_like};
use crate::mpm::layout::{BLOCK_NODES, Block, Coord, Grid, Layout, NO_BLOCK, WallFace};
use crate::mpm::particles::{EMPTY_LANE, Group, LANES, Lanes, Particles, vec_of};
use crate::mpm::spare::{BufferPool, fit};
use crate::mpm::walls;
use crate::real::{Real, RealOps};
use std::sync::Arc;

/// A particle that is no longer anywhere on the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct EscapedParticle {
    pub(crate) particle: u32,
}

/// Particles in another order, the layout, and where each lane came from (place in the old memory order, [`EMPTY_LANE`] for padding).
pub(crate) type Sorted<T> = (Particles<T>, Layout, Vec<u32>);

/// Particles in the order of blocks, of the faces that they are before, and of cells. Stable: particles of one cell keep their order.
pub(crate) fn sort<T: Real>(
    model: &Model<T>,
    bodies: &Bodies<T>,
    old: &Particles<T>,
    spare: &mut BufferPool<T>,
) -> Result<Sorted<T>, EscapedParticle> {
    let mut keys = Vec::with_capacity(old.groups.len() * LANES);
    for (g, lane, particle) in old.occupied() {
        let x = vec_of(&old.groups[g].x, lane).map(RealOps::to_f64);
        let key = model.grid.key(x).ok_or(EscapedParticle { particle })?;
        keys.push(keyed(key, g * LANES + lane));
    }
    keys.sort_unstable();
    let mut cut = Cut::new(keys.len());
    for keys in keys.chunk_by(|a, b| block_of(*a) == block_of(*b)) {
        cut.part(model, bodies, model.grid.coord(block_of(keys[0])), keys, old);
    }
    let (particles, order) = cut.moved(&model.grid, old, spare);
    Ok((particles, connected(model, bodies, cut.blocks), order))
}

/// The same for those of some blocks alone, which are before other faces than they were. The others stay where they are.
pub(crate) fn sort_by_faces<T: Real>(
    model: &Model<T>,
    bodies: &Bodies<T>,
    (old, layout): (Particles<T>, &Layout),
    is_wrong: &[bool],
    spare: &mut BufferPool<T>,
) -> Sorted<T> {
    let mut cut = Cut::new(old.groups.len() * LANES);
    let mut first = 0;
    for blocks in layout.blocks.chunk_by(|a, b| a.coord == b.coord) {
        let is_wrong = &is_wrong[first..first + blocks.len()];
        first += blocks.len();
        if !is_wrong.contains(&true) {
            blocks.iter().for_each(|block| cut.keep(block));
            continue;
        }
        let places = blocks.iter().flat_map(Block::places);
        // Some may have left the block's cells since the last sort: that they are in its tile is enough.
        let key = |place: usize| {
            let x = vec_of(&old.groups[place / LANES].x, place % LANES);
            model.grid.key(x.map(RealOps::to_f64)).unwrap_or_default()
        };
        let mut keys: Vec<u64> = places.map(|place| keyed(key(place), place)).collect();
        keys.sort_unstable();
        cut.part(model, bodies, blocks[0].coord, &keys, &old);
    }
    let (particles, order) = if cut.is_same(layout, |a, b| a.groups() == b.groups()) {
        cut.moved_in_place(&model.grid, old)
    } else {
        let moved = cut.moved(&model.grid, &old, spare);
        spare.return_groups(old.groups);
        moved
    };
    let layout = match cut.is_same(layout, |a, b| a.faces == b.faces) {
        true => connected_like(model, bodies, cut.blocks, layout),
        false => connected(model, bodies, cut.blocks),
    };
    (particles, layout, order)
}

/// Sort key, and the particle's place in the old memory order.
fn keyed(key: u32, place: usize) -> u64 {
    u64::from(key) << 32 | place as u64
}

fn block_of(key: u64) -> usize {
    (key >> 32) as usize / BLOCK_NODES
}

/// Place in the old memory order of a key's particle.
fn place_of(key: u64) -> usize {
    (key & 0xffff_ffff) as usize
}

/// Blocks, one after another, and from which places their particles come.
struct Cut {
    blocks: Vec<Block>,
    places: Vec<u32>,
    groups: usize,
}

impl Cut {
    fn new(particles: usize) -> Self {
        Self { blocks: Vec::new(), places: Vec::with_capacity(particles), groups: 0 }
    }

    fn push(&mut self, coord: Coord, faces: Vec<WallFace>, places: impl Iterator<Item = usize>) {
        let before = self.places.len();
        self.places.extend(places.map(|place| place as u32));
        let (nodes, detours) = ([NO_BLOCK; 27], Vec::new());
        let particles = self.places.len() - before;
        let block = Block { coord, faces, first_group: self.groups, particles, nodes, detours };
        self.groups += block.groups();
        self.blocks.push(block);
    }

    /// A block as it was.
    fn keep(&mut self, block: &Block) {
        self.push(block.coord, block.faces.clone(), block.places());
    }

    /// The particles of a block, by the faces that they are before.
    fn part<T: Real>(
        &mut self,
        model: &Model<T>,
        bodies: &Bodies<T>,
        coord: Coord,
        keys: &[u64],
        old: &Particles<T>,
    ) {
        let place = |particle: usize| place_of(keys[particle]);
        let x = |particle: usize| vec_of(&old.groups[place(particle) / LANES].x, place(particle) % LANES);
        match walls::parted(model, bodies, coord, x, keys.len()) {
            None => self.push(coord, Vec::new(), keys.iter().map(|key| place_of(*key))),
            Some(parts) => parts.into_iter().for_each(|part| {
                self.push(coord, part.faces, part.particles.iter().map(|particle| place(*particle as usize)));
            }),
        }
    }

    /// Whether there are as many blocks as in a layout, at the same places of the grid, and each as like its own as is asked for.
    fn is_same(&self, layout: &Layout, is_like: impl Fn(&Block, &Block) -> bool) -> bool {
        let mut pairs = self.blocks.iter().zip(&layout.blocks);
        self.blocks.len() == layout.blocks.len() && pairs.all(|(a, b)| a.coord == b.coord && is_like(a, b))
    }

    /// Brings the particles there, and tells where each lane came from.
    fn moved<T: Real>(
        &self,
        grid: &Grid,
        old: &Particles<T>,
        spare: &mut BufferPool<T>,
    ) -> (Particles<T>, Vec<u32>) {
        let mut groups = spare.acquire_groups(self.groups);
        let mut ids = vec![[EMPTY_LANE; LANES]; self.groups];
        bring(grid, (&self.blocks, &self.places), (0, &old.groups, &old.ids), (&mut groups, &mut ids));
        (Particles { groups, ids: ids.into() }, self.order())
    }

    /// The same where each block has its groups where it had them: most stay as they are.
    fn moved_in_place<T: Real>(&self, grid: &Grid, mut particles: Particles<T>) -> (Particles<T>, Vec<u32>) {
        let (groups, ids) = (&mut particles.groups, Arc::make_mut(&mut particles.ids));
        let mut left = &self.places[..];
        for blocks in self.blocks.chunk_by(|a, b| a.coord == b.coord) {
            let (places, others) = left.split_at(blocks.iter().map(|block| block.particles).sum());
            left = others;
            if !blocks.iter().flat_map(Block::places).zip(places).all(|(at, from)| at == *from as usize) {
                let first = blocks[0].first_group;
                let own = first..first + blocks.iter().map(Block::groups).sum::<usize>();
                let (old_groups, old_ids) = (groups[own.clone()].to_vec(), ids[own].to_vec());
                bring(grid, (blocks, places), (first, &old_groups, &old_ids), (groups, ids));
            }
        }
        (particles, self.order())
    }

    /// Where each lane comes from.
    fn order(&self) -> Vec<u32> {
        let mut order = vec![EMPTY_LANE; self.groups * LANES];
        let lanes = self.blocks.iter().flat_map(Block::places);
        lanes.zip(&self.places).for_each(|(lane, from)| order[lane] = *from);
        order
    }
}

/// Copies the particles at `places` to the groups of `blocks`, in that order. `groups` and `ids` are what was there, from group number
/// `first` on.
fn bring<T: Real>(
    grid: &Grid,
    (blocks, mut places): (&[Block], &[u32]),
    (first, groups, ids): (usize, &[Group<T>], &[[u32; LANES]]),
    (to_groups, to_ids): (&mut [Group<T>], &mut [[u32; LANES]]),
) {
    for block in blocks {
        let (own, others) = places.split_at(block.particles);
        places = others;
        for (to, places) in (block.first_group..).zip(own.chunks(LANES)) {
            let (to_group, to_ids) = (&mut to_groups[to], &mut to_ids[to]);
            let at = places[0] as usize;
            let from = |place: &u32| (*place as usize / LANES - first, *place as usize % LANES);
            let as_they_were = at.is_multiple_of(LANES)
                && places.len() == LANES
                && places.iter().zip(at..).all(|(place, at)| *place as usize == at);
            if as_they_were {
                (*to_group, *to_ids) = (groups[at / LANES - first], ids[at / LANES - first]);
                continue;
            }
            if places.len() < LANES {
                (*to_group, *to_ids) = (resting_group(grid, block.coord), [EMPTY_LANE; LANES]);
            }
            for (lane, (group, from)) in places.iter().map(from).enumerate() {
                to_group.copy_lane(lane, &groups[group], from);
                to_ids[lane] = ids[group][from];
            }
        }
    }
}

/// Padding lanes sit at rest in the middle of their block, so that every formula stays finite there.
fn resting_group<T: Real>(grid: &Grid, coord: [i32; 3]) -> Group<T> {
    let mut group = Group::ZERO;
    let origin = grid.block_origin(coord);
    for axis in 0..3 {
        group.x[axis] = Lanes([T::from_f64(origin[axis] + 2.0 * grid.dx); LANES]);
    }
    group
}

/// Cotangents of the particles after a sort, put back into the order before it: into `out`, whatever was there.
pub(crate) fn sort_adjoint<T: Real>(
    sorted: &[Group<T>],
    order: &[u32],
    old_groups: usize,
    out: &mut Vec<Group<T>>,
) {
    fit(out, old_groups, Group::ZERO);
    out.fill(Group::ZERO);
    for (to, from) in order.iter().enumerate() {
        if *from != EMPTY_LANE {
            let from = *from as usize;
            out[from / LANES].copy_lane(from % LANES, &sorted[to / LANES], to % LANES);
        }
    }
}
