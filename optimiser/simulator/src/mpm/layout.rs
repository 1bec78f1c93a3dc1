//! Which particles share which part of the grid.
//!
//! The grid is cut into blocks of 4x4x4 cells. Particles are sorted by the block and cell of their stencil's
//! base node. Each block that holds particles owns a padded tile of nodes to which only its particles
//! write; a node block adds the tiles that overlap it in a fixed order. So no two threads ever write to one
//! place, and sums are the same for any number of threads.
//!
//! The tile has one cell of slack on every side: a particle may leave its block by up to a cell before
//! the particles have to be sorted again.

use crate::memory::fit;
use crate::mpm::particles::{Group, LANES, Lanes, NOBODY, Particles};
use crate::mpm::sleep::Tiles;
use crate::mpm::spare::Spare;
use crate::mpm::stencil::{TILE_EDGE, TILE_LENGTH, Tile};
use crate::real::Real;
use crate::scene::{BLOCK_CELLS, PADDING_BLOCKS, Scene};

/// Cells along one edge of a block.
pub(crate) const BLOCK_EDGE: usize = BLOCK_CELLS;
/// Nodes that a block owns.
pub(crate) const BLOCK_NODES: usize = BLOCK_EDGE * BLOCK_EDGE * BLOCK_EDGE;
/// "No such block".
pub(crate) const NONE: u32 = u32::MAX;
/// The 27 neighbours of a block, itself included, in the order of [`neighbour_offsets`].
type Neighbours = [u32; 27];

/// Four numbers at each node that a block owns.
pub(crate) type Nodes<T> = [[T; 4]; BLOCK_NODES];

/// The background grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Grid {
    /// Cell size, m.
    pub(crate) dx: f64,
    /// Blocks along each axis, padding included.
    pub(crate) blocks: [i32; 3],
}

impl Grid {
    pub(crate) fn new(scene: &Scene) -> Self {
        Self { dx: scene.domain.cell_m, blocks: scene.block_counts().map(|count| count as i32) }
    }

    /// Node index of world coordinate 0.
    const ORIGIN: i32 = (PADDING_BLOCKS * BLOCK_EDGE) as i32;

    /// World position of the first node of a block, m.
    pub(crate) fn block_origin(&self, coord: [i32; 3]) -> [f64; 3] {
        coord.map(|c| f64::from(c * BLOCK_EDGE as i32 - Self::ORIGIN) * self.dx)
    }

    /// What to add to `x/dx` to get the coordinate in the tile of a block.
    pub(crate) fn tile_shift(coord: [i32; 3]) -> [f64; 3] {
        coord.map(|c| f64::from(Self::ORIGIN + 1 - c * BLOCK_EDGE as i32))
    }

    pub(crate) fn index(&self, coord: [i32; 3]) -> usize {
        let [x, y, z] = coord;
        ((x * self.blocks[1] + y) * self.blocks[2] + z) as usize
    }

    pub(crate) fn coord(&self, index: usize) -> [i32; 3] {
        let [_, ny, nz] = self.blocks;
        let index = index as i32;
        [index / (ny * nz), index / nz % ny, index % nz]
    }

    pub(crate) fn block_count(&self) -> usize {
        self.blocks.iter().map(|n| *n as usize).product()
    }

    /// Sort key of a position: block, then cell in the block. `None` outside the padded grid or if not finite.
    fn key(&self, x: [f64; 3]) -> Option<u32> {
        let mut coord = [0; 3];
        let mut cell = 0;
        for axis in 0..3 {
            let base = (x[axis] / self.dx - 0.5).floor() + f64::from(Self::ORIGIN);
            let end = f64::from((self.blocks[axis] - 1) * BLOCK_EDGE as i32);
            if !(base >= BLOCK_EDGE as f64 && base < end) {
                return None;
            }
            coord[axis] = base as i32 / BLOCK_EDGE as i32;
            cell = cell * BLOCK_EDGE as u32 + base as u32 % BLOCK_EDGE as u32;
        }
        Some(self.index(coord) as u32 * BLOCK_NODES as u32 + cell)
    }
}

/// The particles of one block.
#[derive(Clone, Debug)]
pub(crate) struct Block {
    pub(crate) coord: [i32; 3],
    pub(crate) first_group: usize,
    pub(crate) particles: usize,
    /// Node blocks around it.
    pub(crate) nodes: Neighbours,
}

impl Block {
    pub(crate) fn groups(&self) -> usize {
        self.particles.div_ceil(LANES)
    }

    /// Particles in the block's group number `g`.
    pub(crate) fn living(&self, g: usize) -> usize {
        (self.particles - g * LANES).min(LANES)
    }
}

/// One block of nodes, and the particle blocks whose tiles overlap it.
#[derive(Clone, Debug)]
pub(crate) struct NodeBlock {
    pub(crate) coord: [i32; 3],
    pub(crate) tiles: Neighbours,
}

/// Blocks in use.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    pub(crate) blocks: Vec<Block>,
    pub(crate) nodes: Vec<NodeBlock>,
}

fn neighbour_offsets() -> impl Iterator<Item = [i32; 3]> {
    (0..27).map(|n| [n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1])
}

/// A particle that is no longer anywhere on the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Lost {
    pub(crate) particle: u32,
}

/// Particles in the order of blocks and cells, the layout, and where each lane came from (place in the old
/// memory order, [`NOBODY`] for padding). Stable: particles of one cell keep their order.
pub(crate) fn sort<T: Real>(
    grid: &Grid,
    old: &Particles<T>,
    spare: &mut Spare<T>,
) -> Result<(Particles<T>, Layout, Vec<u32>), Lost> {
    let mut keys = Vec::with_capacity(old.groups.len() * LANES);
    for (g, lane, particle) in old.living() {
        let x = crate::mpm::particles::vec_of(&old.groups[g].x, lane).map(Real::to_f64);
        let key = grid.key(x).ok_or(Lost { particle })?;
        keys.push(u64::from(key) << 32 | (g * LANES + lane) as u64);
    }
    keys.sort_unstable();

    let block_of = |key: &u64| (*key >> 32) as usize / BLOCK_NODES;
    let by_block = || keys.chunk_by(|a, b| block_of(a) == block_of(b));
    let count = by_block().map(|keys| keys.len().div_ceil(LANES)).sum();
    let mut groups = spare.take_groups(count);
    let mut ids = vec![[NOBODY; LANES]; count];
    let mut order = vec![NOBODY; count * LANES];
    let mut blocks: Vec<Block> = Vec::with_capacity(by_block().count());
    let mut first_group = 0;
    for keys in by_block() {
        let block = Block {
            coord: grid.coord(block_of(&keys[0])),
            first_group,
            particles: keys.len(),
            nodes: [NONE; 27],
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
        group.x[axis] = Lanes([T::of(origin[axis] + 2.0 * grid.dx); LANES]);
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
        touched.iter().map(|i| NodeBlock { coord: grid.coord(*i), tiles: [NONE; 27] }).collect();
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
pub(crate) fn unsort<T: Real>(
    sorted: &[Group<T>],
    order: &[u32],
    old_groups: usize,
    out: &mut Vec<Group<T>>,
) {
    fit(out, old_groups, Group::ZERO);
    out.fill(Group::ZERO);
    for (to, from) in order.iter().enumerate() {
        if *from != NOBODY {
            let from = *from as usize;
            out[from / LANES].copy_lane(from % LANES, &sorted[to / LANES], to % LANES);
        }
    }
}

/// Along one axis: first node of the block, first node of the tile, and how many nodes both share, when the
/// tile's block lies at `offset` from the node block.
const fn overlap(offset: i32) -> (usize, usize, usize) {
    match offset {
        -1 => (0, 5, 3),
        0 => (0, 1, 4),
        _ => (3, 0, 1),
    }
}

/// Adds up the tiles that overlap a node block, in a fixed order.
#[inline(always)]
pub(crate) fn sum_tiles<T: Real>(node: &NodeBlock, tiles: Tiles<'_, T>) -> Nodes<T> {
    let mut sum = [[T::ZERO; 4]; BLOCK_NODES];
    for (n, offset) in neighbour_offsets().enumerate() {
        let Some(tile) = tiles.of(node.tiles[n]) else { continue };
        let [(ax, tx, nx), (ay, ty, ny), (az, tz, _)] = offset.map(overlap);
        for i in 0..nx {
            for j in 0..ny {
                let to = &mut sum[((ax + i) * BLOCK_EDGE + ay + j) * BLOCK_EDGE + az..];
                let from = &tile[((tx + i) * TILE_EDGE + ty + j) * TILE_EDGE + tz..];
                match offset[2] {
                    -1 => add_nodes::<T, { overlap(-1).2 }>(to, from),
                    0 => add_nodes::<T, { overlap(0).2 }>(to, from),
                    _ => add_nodes::<T, { overlap(1).2 }>(to, from),
                }
            }
        }
    }
    sum
}

/// Whether a condition holds for any node that a block's tile shares with a node block that is asked for:
/// `test(node block, place in it, place in the tile)`.
pub(crate) fn any_shared(
    block: &Block,
    ask: impl Fn(usize) -> bool,
    test: impl Fn(usize, usize, usize) -> bool,
) -> bool {
    neighbour_offsets().zip(block.nodes).filter(|(_, node_block)| ask(*node_block as usize)).any(
        |(offset, node_block)| {
            // Seen from the node block, the tile's block lies in the opposite direction.
            let [(ax, tx, nx), (ay, ty, ny), (az, tz, nz)] = offset.map(|o| overlap(-o));
            (0..nx * ny * nz).any(|n| {
                let [i, j, k] = [n / (ny * nz), n / nz % ny, n % nz];
                let node = ((ax + i) * BLOCK_EDGE + ay + j) * BLOCK_EDGE + az + k;
                let at = ((tx + i) * TILE_EDGE + ty + j) * TILE_EDGE + tz + k;
                test(node_block as usize, node, at)
            })
        },
    )
}

/// Adds `N` nodes along z.
#[inline(always)]
fn add_nodes<T: Real, const N: usize>(to: &mut [[T; 4]], from: &[[T; 4]]) {
    let (to, from) = (to[..N].as_flattened_mut(), from[..N].as_flattened());
    for k in 0..4 * N {
        to[k] += from[k];
    }
}

/// Along one axis, for each node of a tile: which neighbour (0, 1, 2) owns it, and its place there.
const OWNERS: [(usize, usize); TILE_EDGE] = [(0, 3), (1, 0), (1, 1), (1, 2), (1, 3), (2, 0), (2, 1), (2, 2)];

/// Fills a particle block's tile from the node blocks around it.
#[inline(always)]
pub(crate) fn load_tile<T: Real>(block: &Block, nodes: &[Nodes<T>], tile: &mut Tile<T>) {
    let (rows, _) = tile.as_chunks_mut::<TILE_EDGE>();
    for (i, (nx, ax)) in OWNERS.into_iter().enumerate() {
        for ny in 0..3 {
            // Three columns of blocks along z: below, here, above.
            let column = (nx * 3 + ny) * 3;
            let from = |k: usize| nodes[block.nodes[column + k] as usize].as_chunks::<BLOCK_EDGE>().0;
            let (below, here, above) = (from(0), from(1), from(2));
            let (ay, ty, count) = [(3, 0, 1), (0, 1, 4), (0, 5, 3)][ny];
            let first = ax * BLOCK_EDGE + ay;
            let rows = &mut rows[i * TILE_EDGE + ty..][..count];
            let [below, here, above] = [below, here, above].map(|rows| &rows[first..][..count]);
            for (to, ((a, b), c)) in rows.iter_mut().zip(below.iter().zip(here).zip(above)) {
                // In pieces that are one move each.
                to[0] = a[3];
                to[1..5].copy_from_slice(b);
                to[5..8].copy_from_slice(&c[..3]);
            }
        }
    }
}

/// A tile of zeros.
pub(crate) const fn empty_tile<T: Real>() -> Tile<T> {
    [[T::ZERO; 4]; TILE_LENGTH]
}
