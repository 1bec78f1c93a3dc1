//! The tiles of all blocks, those of sleepers among them, and their sums at the nodes.

use crate::mpm::layout::{
    BLOCK_EDGE, BLOCK_NODES, NodeBlock, NodeSet, Nodes, Source, overlap, places_in_tile,
};
use crate::mpm::sleep::SleepState;
use crate::mpm::stencil::{TILE_EDGE, Tile};
use crate::mpm::stencil_positions::ALL_NEIGHBOURS;
use crate::real::Real;

/// The tiles of all blocks: those of this substep, and the sleepers'.
#[derive(Clone, Copy)]
pub(crate) struct Tiles<'a, T> {
    pub(crate) fresh: &'a [Tile<T>],
    pub(crate) rest: &'a [SleepState<T>],
    /// Which neighbours of each block hold anything of its tile; all, if nobody knows.
    pub(crate) reached: Option<&'a [u32]>,
    /// Whether sleepers send anything; in the adjoint they do not.
    pub(crate) sleepers_send: bool,
}

impl<'a, T: Real> Tiles<'a, T> {
    /// The tile of a source, or none if it sends nothing.
    #[inline(always)]
    fn of(&self, source: &Source) -> Option<&'a Tile<T>> {
        let b = source.tile as usize;
        let reached = self.reached.map_or(ALL_NEIGHBOURS, |reached| reached[b]);
        if reached >> (26 - source.neighbour) & 1 == 0 {
            return None;
        }
        match self.rest[b].sent() {
            None => Some(&self.fresh[b]),
            Some((tile, _)) => self.sleepers_send.then_some(tile),
        }
    }

    /// Whether anyone who is awake reaches a block of nodes.
    #[inline(always)]
    pub(crate) fn any_awake(&self, node: &NodeBlock) -> bool {
        node.sources.iter().any(|source| !self.rest[source.tile as usize].is_asleep())
    }

    /// Adds up the tiles that overlap a node block, in a fixed order.
    #[inline(always)]
    pub(crate) fn sum(&self, node: &NodeBlock, sum: &mut Nodes<T>) {
        *sum = [[T::ZERO; 4]; BLOCK_NODES];
        for source in &node.sources {
            let Some(tile) = self.of(source) else { continue };
            let neighbour = usize::from(source.neighbour);
            if source.nodes != NodeSet::MAX {
                for (n, at) in places_in_tile(neighbour, source.nodes) {
                    for k in 0..4 {
                        sum[n][k] += tile[at][k];
                    }
                }
                continue;
            }
            let offset = [neighbour / 9, neighbour / 3 % 3, neighbour % 3].map(|o| o as i32 - 1);
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
    }
}

/// Adds `N` nodes along z.
#[inline(always)]
fn add_nodes<T: Real, const N: usize>(to: &mut [[T; 4]], from: &[[T; 4]]) {
    let (to, from) = (to[..N].as_flattened_mut(), from[..N].as_flattened());
    for k in 0..4 * N {
        to[k] += from[k];
    }
}
