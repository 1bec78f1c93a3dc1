//! Which particles share which part of the grid.
//!
//! The grid is cut into blocks of 4x4x4 cells. Particles are sorted by the block and cell of their stencil's
//! base node. Each block that holds particles owns a padded tile of nodes to which only its particles
//! write; a node block adds the tiles that overlap it in a fixed order. So no two threads ever write to one
//! place, and sums are the same for any number of threads.
//!
//! The tile has one cell of slack on every side: a particle may leave its block by up to a cell before
//! the particles have to be sorted again.

use crate::mpm::particles::LANES;
use crate::mpm::stencil::{TILE_EDGE, TILE_LENGTH, Tile};
use crate::real::Real;
use crate::scene::{BLOCK_CELLS, PADDING_BLOCKS, Scene};

/// Cells along one edge of a block.
pub(crate) const BLOCK_EDGE: usize = BLOCK_CELLS;
/// Nodes that a block owns.
pub(crate) const BLOCK_NODES: usize = BLOCK_EDGE * BLOCK_EDGE * BLOCK_EDGE;
/// "No such block".
pub(crate) const NO_BLOCK: u32 = u32::MAX;
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
    pub(crate) fn key(&self, x: [f64; 3]) -> Option<u32> {
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
    pub(crate) fn occupied(&self, g: usize) -> usize {
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

pub(crate) fn neighbour_offsets() -> impl Iterator<Item = [i32; 3]> {
    (0..27).map(|n| [n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1])
}

/// Along one axis: first node of the block, first node of the tile, and how many nodes both share, when the
/// tile's block lies at `offset` from the node block.
pub(crate) const fn overlap(offset: i32) -> (usize, usize, usize) {
    match offset {
        -1 => (0, 5, 3),
        0 => (0, 1, 4),
        _ => (3, 0, 1),
    }
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
