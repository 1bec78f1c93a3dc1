//! How much memory a rollout with its gradient needs, by how many states are kept.
//!
//! What is kept are states at the beginning of substeps; whatever else the adjoint needs is computed again from them
//! (see `rollout/schedule.rs`). With `c` states and at most `r` passes over any substep, `binomial(c + r, c)`
//! substeps can be reversed.

use crate::scene::{BLOCK_CELLS, Scene};
use powderline_shared::plan::Precision;

/// Numbers in a particle's state: position 3, velocity 3, affine velocity 9, elastic strain 6, volume correction 1.
pub const PARTICLE_SCALARS: u64 = 22;

/// Executable, stacks and allocator of the running program, bytes, generously.
pub const PROCESS_BYTES: u64 = 40 << 20;

/// States that a rollout holds beside the kept ones: the settled one, the one at work and the one at the end, the
/// cotangents, what particles send to the grid, and scratch.
pub const STANDING_STATES: u64 = 7;

/// States of rollouts side by side at a time: the probes of one epoch, and two at work.
pub const BRANCHES: u64 = 13;

/// Passes over a substep for which the need is estimated.
pub const PASSES: [u32; 4] = [1, 2, 3, 4];

/// Need when no substep is advanced more often than `passes` times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Need {
    /// How often a substep is advanced, at most; the adjoint itself computes it once more.
    pub passes: u32,
    /// States kept at a time, the fewest possible.
    pub kept_states: u64,
    /// Peak memory, bytes: what to give to `--memory`.
    pub bytes: u64,
}

/// The smallest of the needs, bytes: with less, a gradient would take many times as long.
pub(crate) fn least_memory(scene: &Scene, precision: Precision) -> u64 {
    memory_needs(scene, precision)[PASSES.len() - 1].bytes
}

/// What does not depend on the powder's state, bytes: the program, the motion with what its gradient needs for each
/// control step (and the motions of the probes), and the list of obstacles for each block of the grid.
pub(crate) fn fixed_bytes(scene: &Scene) -> u64 {
    const PER_CONTROL_STEP: u64 = 720 + 11 * 104;
    const PER_BLOCK: u64 = 64;
    let blocks: u64 = scene.block_counts().iter().map(|count| *count as u64).product();
    PROCESS_BYTES + PER_CONTROL_STEP * u64::from(scene.time.horizon_steps) + PER_BLOCK * blocks
}

/// Estimates the need of a gradient for each of [`PASSES`].
pub fn memory_needs(scene: &Scene, precision: Precision) -> [Need; 4] {
    let scalar_bytes: u64 = match precision {
        Precision::F32 => 4,
        Precision::F64 => 8,
    };
    let particles = scene.particle_count() as u64;
    let [tiles, nodes] = grid_bytes(scene, scalar_bytes);
    // Identity and origin of each particle; a tenth for lanes that hold none. Momentum and velocity at the nodes.
    let powder = particles * (PARTICLE_SCALARS * scalar_bytes + 2 * size_of::<u32>() as u64) * 11 / 10;
    let state_bytes = powder + 2 * nodes;
    let steps = u64::from(scene.time.horizon_steps) * u64::from(scene.time.substeps);
    let standing_bytes =
        fixed_bytes(scene) + STANDING_STATES * state_bytes + BRANCHES * powder + 3 * (tiles + 3 * nodes);
    PASSES.map(|passes| {
        let kept_states = fewest_states(steps, passes);
        Need { passes, kept_states, bytes: standing_bytes + grown(kept_states * state_bytes) }
    })
}

/// What kept states take before the end: they grow as the powder spreads over more blocks, and with it the fragments between them.
pub(crate) fn grown(bytes: u64) -> u64 {
    bytes + bytes / 5 * 2
}

/// Tiles of the blocks that hold powder, and four numbers for each node of these and of the layer of blocks around them; for powder
/// in one heap that lies anywhere on the grid.
fn grid_bytes(scene: &Scene, scalar_bytes: u64) -> [u64; 2] {
    let cells = scene.particle_count() as f64 / f64::from(scene.powder.particles_per_cell);
    let edge = (cells / BLOCK_CELLS.pow(3) as f64).cbrt() + 1.0;
    let of_blocks = |edge: f64, nodes: usize| (edge.powi(3).ceil() as u64) * nodes as u64 * 4 * scalar_bytes;
    [of_blocks(edge, (2 * BLOCK_CELLS).pow(3)), of_blocks(edge + 2.0, BLOCK_CELLS.pow(3))]
}

/// Smallest `c` with `binomial(c + passes, passes) >= steps`.
pub(crate) fn fewest_states(steps: u64, passes: u32) -> u64 {
    let reach =
        |states: u64| (1..=passes).fold(1.0, |b, k| b * (states + u64::from(k)) as f64 / f64::from(k));
    let (mut low, mut high) = (1, steps.max(1));
    while low < high {
        let middle = low + (high - low) / 2;
        if reach(middle) >= steps as f64 {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fewer_states_cost_more_passes() {
        let needs = memory_needs(&Scene::load("bench").unwrap(), Precision::F32);
        let kept = needs.map(|need| need.kept_states);
        assert_eq!(kept, [9_999, 140, 38, 20]);
        assert!(needs.is_sorted_by(|a, b| a.bytes > b.bytes));
    }

    #[test]
    fn fewest_states_reach_just_far_enough() {
        assert_eq!(fewest_states(1, 1), 1);
        assert_eq!(fewest_states(560, 3), 13);
        assert_eq!(fewest_states(561, 3), 14);
    }
}
