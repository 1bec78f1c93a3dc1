//! Where the time goes: each stage of a substep, forward and adjoint, and whole rollouts, timed as they really run.
//!
//! The stages are not run one by one for this: the rollout's own substeps are, and the time is read off between their
//! stages (`mpm/laps.rs`). So the stages add up to the whole, and meet the caches as they are.

mod counted;
mod machine;
mod measure;
mod problem;

use thiserror::Error;

use crate::rollout::RolloutError;

pub use crate::mpm::laps::Stage;
pub use counted::Elementary;
pub use measure::{
    Arithmetic, Bench, Machine, Memory, Report, STAGES, Settings, StageReport, Timing, Watch, WholeReport,
    run,
};
pub use problem::{PARTICLES_PER_CELL, SUBSTEPS};

/// Why nothing was measured.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum BenchError {
    /// The bed does not fit into the grid.
    #[error(
        "a grid of {grid}^3 cells holds a bed of {most} particles at most, not of {particles}: give a larger --grid"
    )]
    Grid {
        /// Particles wanted.
        particles: usize,
        /// Cells along each edge.
        grid: usize,
        /// Particles that there is room for.
        most: usize,
    },
    /// There is not enough memory.
    #[error(
        "{particles} particles need about {} MiB of memory, and there are {} MiB: ask for fewer{}",
        need >> 20,
        free >> 20,
        if *forward_only { "" } else { ", or for --forward-only" }
    )]
    Memory {
        /// Particles wanted.
        particles: usize,
        /// Bytes that they need.
        need: u64,
        /// Bytes that there are.
        free: u64,
        /// Whether the adjoint was left out already.
        forward_only: bool,
    },
    /// The simulation failed.
    #[error(transparent)]
    Rollout(#[from] RolloutError),
}
