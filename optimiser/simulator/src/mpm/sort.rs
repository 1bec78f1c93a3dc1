//! Sorting: particles into the order of the grid's blocks and cells, and the layout of blocks that follows from it.

use crate::mpm::layout::{BLOCK_NODES, Block, Grid, Layout, NO_BLOCK, NodeBlock, neighbour_offsets};
use crate::mpm::particles::{EMPTY_LANE, Group, LANES, Lanes, Particles, vec_of};
use crate::mpm::spare::{BufferPool, fit};
use crate::real::{Real, RealOps};

/// A particle that is no longer anywhere on the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct EscapedParticle {
    pub(crate) particle: u32,
}

/// Particles in the order of blocks and cells, the layout, and where each lane came from (place in the old
/// memory order, [`EMPTY_LANE`] for padding). Stable: particles of one cell keep their order.
pub(crate) fn sort<T: Real>(
    grid: &Grid,
    old: &Particles<T>,
    spare: &mut BufferPool<T>,
) -> Result<(Particles<T>, Layout, Vec<u32>), EscapedParticle> {
    let mut keys = Vec::with_capacity(old.groups.len() * LANES);
    for (g, lane, particle) in old.occupied() {
        let x = vec_of(&old.groups[g].x, lane).map(RealOps::to_f64);
        let key = grid.key(x).ok_or(EscapedParticle { particle })?;
        keys.push(u64::from(key) << 32 | (g * LANES + lane) as u64);
    }
    keys.sort_unstable();

    let block_of = |key: &u64| (*key >> 32) as usize / BLOCK_NODES;
    let by_block = || keys.chunk_by(|a, b| block_of(a) == block_of(b));
    let count = by_block().map(|keys| keys.len().div_ceil(LANES)).sum();
    let mut groups = spare.acquire_groups(count);
    let mut ids = vec![[EMPTY_LANE; LANES]; count];
    let mut order = vec![EMPTY_LANE; count * LANES];
    let mut blocks: Vec<Block> = Vec::with_capacity(by_block().count());
    let mut first_group = 0;
    for keys in by_block() {
        let block = Block {
            coord: grid.coord(block_of(&keys[0])),
            first_group,
            particles: keys.len(),
            nodes: [NO_BLOCK; 27],
        };
        let resting = resting_group(grid, block.coord);
        groups[first_group..first_group + block.groups()].fill(resting);
        for (at, key) in (first_group * LANES..).zip(keys) {
            let place = (key & 0xffff_ffff) as usize;
            groups[at / LANES].copy_lane(at % LANES, &old.groups[place / LANES], place % LANES);
            ids[at / LANES][at % LANES] = old.ids[place / LANES][place % LANES];
            order[at] = place as u32;
        }
        first_group += block.groups();
        blocks.push(block);
    }
    let nodes = connect(grid, &mut blocks);
    Ok((Particles { groups, ids: ids.into() }, Layout { blocks, nodes }, order))
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

/// Finds the node blocks that the particle blocks touch and links both ways.
fn connect(grid: &Grid, blocks: &mut [Block]) -> Vec<NodeBlock> {
    let mut touched: Vec<usize> = blocks
        .iter()
        .flat_map(|b| neighbour_offsets().map(|o| grid.index([0, 1, 2].map(|a| b.coord[a] + o[a]))))
        .collect();
    touched.sort_unstable();
    touched.dedup();
    let mut nodes: Vec<NodeBlock> =
        touched.iter().map(|i| NodeBlock { coord: grid.coord(*i), tiles: [NO_BLOCK; 27] }).collect();
    for (b, block) in blocks.iter_mut().enumerate() {
        for (n, o) in neighbour_offsets().enumerate() {
            let index = grid.index([0, 1, 2].map(|a| block.coord[a] + o[a]));
            let at = touched.binary_search(&index).expect("collected above");
            block.nodes[n] = at as u32;
            // Seen from the node block, the particle block lies in the opposite direction.
            nodes[at].tiles[26 - n] = b as u32;
        }
    }
    nodes
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
