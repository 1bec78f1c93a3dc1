//! Sorting: particles into the order of the grid's blocks and cells, and the layout of blocks that follows from it.

use crate::mpm::Model;
use crate::mpm::bodies::Bodies;
use crate::mpm::connect::connected;
use crate::mpm::layout::{BLOCK_NODES, Block, Coord, Grid, Layout, NO_BLOCK, WallFace};
use crate::mpm::particles::{EMPTY_LANE, Group, LANES, Lanes, Particles, vec_of};
use crate::mpm::spare::{BufferPool, fit};
use crate::mpm::walls;
use crate::real::{Real, RealOps};

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
    Ok(cut.sorted(model, bodies, old, spare))
}

/// The same for those of some blocks alone, which are before other faces than they were. The others stay where they are.
pub(crate) fn sort_by_faces<T: Real>(
    model: &Model<T>,
    bodies: &Bodies<T>,
    (old, layout): (&Particles<T>, &Layout),
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
        cut.part(model, bodies, blocks[0].coord, &keys, old);
    }
    cut.sorted(model, bodies, old, spare)
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

    /// Brings the particles there.
    fn sorted<T: Real>(
        mut self,
        model: &Model<T>,
        bodies: &Bodies<T>,
        old: &Particles<T>,
        spare: &mut BufferPool<T>,
    ) -> Sorted<T> {
        let mut groups = spare.acquire_groups(self.groups);
        let mut ids = vec![[EMPTY_LANE; LANES]; self.groups];
        let mut order = vec![EMPTY_LANE; self.groups * LANES];
        let mut places = &self.places[..];
        for block in &self.blocks {
            let (own, others) = places.split_at(block.particles);
            places = others;
            let resting = resting_group(&model.grid, block.coord);
            let to = &mut groups[block.first_group..block.first_group + block.groups()];
            to.fill(resting);
            for (group, places) in own.chunks(LANES).enumerate() {
                let first = places[0] as usize;
                let as_they_were = first.is_multiple_of(LANES)
                    && places.len() == LANES
                    && places.iter().zip(first..).all(|(place, at)| *place as usize == at);
                if as_they_were {
                    to[group] = old.groups[first / LANES];
                } else {
                    for (lane, place) in places.iter().enumerate() {
                        let place = *place as usize;
                        to[group].copy_lane(lane, &old.groups[place / LANES], place % LANES);
                    }
                }
            }
            for (at, place) in (block.first_group * LANES..).zip(own) {
                let from = *place as usize;
                ids[at / LANES][at % LANES] = old.ids[from / LANES][from % LANES];
                order[at] = *place;
            }
        }
        let layout = connected(model, bodies, std::mem::take(&mut self.blocks));
        (Particles { groups, ids: ids.into() }, layout, order)
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
