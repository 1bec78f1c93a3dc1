//! The tiles of all blocks, those of sleepers among them, and their sums at the nodes.

use crate::mpm::layout::{BLOCK_EDGE, BLOCK_NODES, NodeBlock, Nodes, neighbour_offsets, overlap};
use crate::mpm::sleep::SleepState;
use crate::mpm::stencil::{TILE_EDGE, Tile};
use crate::real::Real;

/// The tiles of all blocks: those of this substep, and the sleepers'.
#[derive(Clone, Copy)]
pub(crate) struct Tiles<'a, T> {
    pub(crate) fresh: &'a [Tile<T>],
    pub(crate) rest: &'a [SleepState<T>],
    /// Whether sleepers send anything; in the adjoint they do not.
    pub(crate) sleepers_send: bool,
}

impl<'a, T: Real> Tiles<'a, T> {
    /// Tile number `b`, or none where there is no block.
    #[inline(always)]
    pub(crate) fn of(&self, b: u32) -> Option<&'a Tile<T>> {
        match self.rest.get(b as usize)?.tile() {
            None => self.fresh.get(b as usize),
            Some(tile) => self.sleepers_send.then_some(tile),
        }
    }

    /// Whether anyone who is awake reaches a block of nodes.
    #[inline(always)]
    pub(crate) fn any_awake(&self, node: &NodeBlock) -> bool {
        node.tiles.iter().any(|b| self.rest.get(*b as usize).is_some_and(|rest| !rest.is_asleep()))
    }

    /// Adds up the tiles that overlap a node block, in a fixed order.
    #[inline(always)]
    pub(crate) fn sum(&self, node: &NodeBlock) -> Nodes<T> {
        let mut sum = [[T::ZERO; 4]; BLOCK_NODES];
        for (n, offset) in neighbour_offsets().enumerate() {
            let Some(tile) = self.of(node.tiles[n]) else { continue };
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
}

/// Adds `N` nodes along z.
#[inline(always)]
fn add_nodes<T: Real, const N: usize>(to: &mut [[T; 4]], from: &[[T; 4]]) {
    let (to, from) = (to[..N].as_flattened_mut(), from[..N].as_flattened());
    for k in 0..4 * N {
        to[k] += from[k];
    }
}
