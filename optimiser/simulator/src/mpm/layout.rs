//! Which particles share which part of the grid.
//!
//! The grid is cut into blocks of 4x4x4 cells. Particles are sorted by the block and cell of their stencil's
//! base node. Each block that holds particles owns a padded tile of nodes to which only its particles
//! write; a node block adds the tiles that overlap it in a fixed order. So no two threads ever write to one
//! place, and sums are the same for any number of threads.
//!
//! The tile has one cell of slack on every side: a particle may leave its block by up to a cell before
//! the particles have to be sorted again.
//!
//! Where walls have two sides ([`super::walls`]), particles of a block that are before different faces have tiles of their own,
//! and a block of nodes has several layers where some of those do not see the same nodes.

use crate::mpm::particles::LANES;
use crate::mpm::stencil::{TILE_EDGE, TILE_LENGTH, Tile};
use crate::real::Real;
use crate::scene::{BLOCK_CELLS, PADDING_BLOCKS, Scene};
use crate::shape::Face;

/// Cells along one edge of a block.
pub(crate) const BLOCK_EDGE: usize = BLOCK_CELLS;
/// Nodes that a block owns.
pub(crate) const BLOCK_NODES: usize = BLOCK_EDGE * BLOCK_EDGE * BLOCK_EDGE;
/// "No such block".
pub(crate) const NO_BLOCK: u32 = u32::MAX;
/// The 27 neighbours of a block, itself included, in the order of [`neighbour_offsets`].
type Neighbours = [u32; 27];

/// Where a block is in the grid of blocks.
pub(crate) type Coord = [i32; 3];
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

/// A face of one of the pieces that stand in the powder's way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct WallFace {
    /// Number of the piece.
    pub(crate) piece: u16,
    pub(crate) face: Face,
}

/// Some of the nodes that a block owns: bit `n` stands for node `n`.
pub(crate) type NodeSet = u64;

/// The particles of one block; of those that are before the same faces.
#[derive(Clone, Debug)]
pub(crate) struct Block {
    pub(crate) coord: [i32; 3],
    /// What they are before, by pieces in order; none of pieces that are too far off to matter.
    pub(crate) faces: Vec<WallFace>,
    pub(crate) first_group: usize,
    pub(crate) particles: usize,
    /// Node blocks around it: their first layer.
    pub(crate) nodes: Neighbours,
    /// Nodes that are in another layer.
    pub(crate) detours: Vec<Detour>,
}

/// Nodes around a block that are not in the first layer of those of their place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Detour {
    /// Which of the 27 neighbours.
    pub(crate) neighbour: u8,
    /// The layer.
    pub(crate) node_block: u32,
    pub(crate) nodes: NodeSet,
}

impl Block {
    pub(crate) fn groups(&self) -> usize {
        self.particles.div_ceil(LANES)
    }

    /// Particles in the block's group number `g`.
    pub(crate) fn occupied(&self, g: usize) -> usize {
        (self.particles - g * LANES).min(LANES)
    }

    /// Places of its particles in memory.
    pub(crate) fn places(&self) -> impl Iterator<Item = usize> {
        let first = self.first_group * LANES;
        first..first + self.particles
    }

    /// The parts of the node blocks around it that are its own: which neighbour, which node block, and which of its nodes.
    fn parts(&self) -> impl Iterator<Item = (usize, u32, NodeSet)> {
        self.nodes.into_iter().enumerate().flat_map(move |(n, first)| {
            let detours = self.detours.iter().filter(move |d| usize::from(d.neighbour) == n);
            let elsewhere = detours.clone().fold(0, |nodes, d| nodes | d.nodes);
            let own = (n, first, SHARED_NODES[26 - n] & !elsewhere);
            std::iter::once(own).chain(detours.map(move |d| (n, d.node_block, d.nodes)))
        })
    }
}

/// A tile that adds to a block of nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Source {
    /// Number of the particle block.
    pub(crate) tile: u32,
    /// Which of the 27 neighbours that is.
    pub(crate) neighbour: u8,
    /// Which of the nodes that they share it adds to; all, if all bits are set.
    pub(crate) nodes: NodeSet,
}

/// Nodes that lie behind a face, or in the solid for those beyond an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Side {
    pub(crate) of: WallFace,
    pub(crate) nodes: NodeSet,
}

/// One block of nodes, or one layer of them, and the particle blocks whose tiles overlap it.
#[derive(Clone, Debug)]
pub(crate) struct NodeBlock {
    pub(crate) coord: [i32; 3],
    /// In the order in which they are added up.
    pub(crate) sources: Vec<Source>,
    /// What its nodes are behind for those who send to them, by pieces in order.
    pub(crate) sides: Vec<Side>,
}

/// Blocks in use.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    pub(crate) blocks: Vec<Block>,
    pub(crate) nodes: Vec<NodeBlock>,
    /// What moving pieces hide of the nodes, as it was when the layers were made.
    pub(crate) moving: Vec<HiddenBy>,
}

impl Layout {
    /// Nothing.
    pub(crate) fn empty() -> Self {
        Self { blocks: Vec::new(), nodes: Vec::new(), moving: Vec::new() }
    }

    /// Places of the grid, each with the layers of its nodes.
    pub(crate) fn places(&self) -> impl Iterator<Item = &[NodeBlock]> {
        self.nodes.chunk_by(|a, b| a.coord == b.coord)
    }

    /// Groups of all blocks.
    pub(crate) fn groups(&self) -> usize {
        self.blocks.last().map_or(0, |last| last.first_group + last.groups())
    }

    /// Bytes.
    pub(crate) fn bytes(&self) -> usize {
        let of_block = |b: &Block| size_of_val(b) + size_of_val(&b.faces[..]) + size_of_val(&b.detours[..]);
        let of_node =
            |n: &NodeBlock| size_of_val(n) + size_of_val(&n.sources[..]) + size_of_val(&n.sides[..]);
        let blocks = self.blocks.iter().map(of_block).sum::<usize>();
        blocks + self.nodes.iter().map(of_node).sum::<usize>() + size_of_val(&self.moving[..])
    }
}

/// What a piece hides of a block's nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Hidden {
    /// Nodes in it.
    pub(crate) solid: NodeSet,
    /// Nodes before each of its faces, continued beyond their edges.
    pub(crate) before: [NodeSet; Face::PAIRED],
}

impl Hidden {
    pub(crate) const NOTHING: Self = Self { solid: 0, before: [0; Face::PAIRED] };

    /// From those who are before a face, or beyond an edge.
    pub(crate) fn from(&self, face: Face) -> NodeSet {
        self.solid | face.opposite().map_or(0, |opposite| self.before[opposite.number()])
    }
}

/// What a piece hides of a block of the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct HiddenBy {
    /// Number of the block.
    pub(crate) block: u32,
    /// Number of the piece.
    pub(crate) piece: u16,
    pub(crate) nodes: Hidden,
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

/// The nodes of a node block that it shares with the tile of each neighbour.
pub(crate) const SHARED_NODES: [NodeSet; 27] = {
    let mut out = [0; 27];
    let mut n = 0;
    while n < 27 {
        out[n] = shared_nodes(n);
        n += 1;
    }
    out
};

const fn shared_nodes(neighbour: usize) -> NodeSet {
    let mut nodes = 0;
    let offset = [neighbour as i32 / 9 - 1, neighbour as i32 / 3 % 3 - 1, neighbour as i32 % 3 - 1];
    let [(ax, _, nx), (ay, _, ny), (az, _, nz)] =
        [overlap(offset[0]), overlap(offset[1]), overlap(offset[2])];
    let mut n = 0;
    while n < BLOCK_NODES {
        let [i, j, k] = [n / (BLOCK_EDGE * BLOCK_EDGE), n / BLOCK_EDGE % BLOCK_EDGE, n % BLOCK_EDGE];
        if i >= ax && i < ax + nx && j >= ay && j < ay + ny && k >= az && k < az + nz {
            nodes |= 1 << n;
        }
        n += 1;
    }
    nodes
}

/// These nodes of a node block, each with its place in the tile of a neighbour that shares it.
#[inline(always)]
pub(crate) fn places_in_tile(neighbour: usize, nodes: NodeSet) -> impl Iterator<Item = (usize, usize)> {
    let offset = [neighbour / 9, neighbour / 3 % 3, neighbour % 3].map(|o| overlap(o as i32 - 1));
    let first = offset.map(|(a, t, _)| t as i32 - a as i32);
    let edge = TILE_EDGE as i32;
    let first = (first[0] * edge + first[1]) * edge + first[2];
    let mut left = nodes;
    std::iter::from_fn(move || {
        let n = left.trailing_zeros() as usize;
        left &= left.checked_sub(1)?;
        let [i, j, k] = [n / (BLOCK_EDGE * BLOCK_EDGE), n / BLOCK_EDGE % BLOCK_EDGE, n % BLOCK_EDGE];
        let at = ((i * TILE_EDGE + j) * TILE_EDGE + k) as i32 + first;
        Some((n, at as usize))
    })
}

/// Whether a condition holds for any node that a block's tile shares with a node block that is asked for, `ask(neighbour, node block)`:
/// `test(node block, place in it, place in the tile)`.
pub(crate) fn any_shared(
    block: &Block,
    ask: impl Fn(usize, usize) -> bool,
    test: impl Fn(usize, usize, usize) -> bool,
) -> bool {
    let mut asked = block.parts().filter(|(neighbour, node_block, _)| ask(*neighbour, *node_block as usize));
    asked.any(|(neighbour, node_block, nodes)| {
        // Seen from the node block, the tile's block lies in the opposite direction.
        places_in_tile(26 - neighbour, nodes).any(|(node, at)| test(node_block as usize, node, at))
    })
}

/// Along one axis, for each node of a tile: which neighbour (0, 1, 2) owns it, and its place there.
const OWNERS: [(usize, usize); TILE_EDGE] = [(0, 3), (1, 0), (1, 1), (1, 2), (1, 3), (2, 0), (2, 1), (2, 2)];

/// Fills a particle block's tile from the node blocks around it, those of some neighbours at least: bit `n` for neighbour `n`.
#[inline(always)]
pub(crate) fn load_tile<T: Real>(block: &Block, nodes: &[Nodes<T>], neighbours: u32, tile: &mut Tile<T>) {
    let (rows, _) = tile.as_chunks_mut::<TILE_EDGE>();
    for (i, (nx, ax)) in OWNERS.into_iter().enumerate() {
        for ny in 0..3 {
            // Three columns of blocks along z: below, here, above.
            let column = (nx * 3 + ny) * 3;
            if neighbours >> column & 7 == 0 {
                continue;
            }
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
    for detour in block.detours.iter().filter(|detour| neighbours >> detour.neighbour & 1 == 1) {
        let nodes = &nodes[detour.node_block as usize];
        for (n, at) in places_in_tile(26 - usize::from(detour.neighbour), detour.nodes) {
            tile[at] = nodes[n];
        }
    }
}

/// A tile of zeros.
pub(crate) const fn empty_tile<T: Real>() -> Tile<T> {
    [[T::ZERO; 4]; TILE_LENGTH]
}
