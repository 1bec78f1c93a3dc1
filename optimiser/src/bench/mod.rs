//! Where the time goes: what each stage of a substep takes, forward and adjoint, and what whole rollouts take.
//!
//! # How it is measured
//!
//! `optimise bench` fills a box with powder, eight particles in a cell, and lets a bowl that is buried in it go to and fro, so
//! that powder, box and bowl touch from the first substep on. After two control steps to warm up, the substeps that
//! `--steps` asks for are divided into five parts. In each part the gradient of the loss, the stages that can run
//! by themselves, and a forward run of the same substeps take turns, so that whatever slows the machine slows all of them.
//!
//! No stage is imitated. The rollout's own code runs, with its checkpoints, and the clocks are read between the
//! stages of its substeps (`mpm/laps.rs`): the stages add up to the whole, and meet the caches as they are. A control step
//! is one block of a forward run, a part is one block of a gradient.
//!
//! The gradient keeps as few states as let it advance each substep at most twice. That is what a long motion costs that
//! fits into memory; with more memory it costs one advance less.
//!
//! # What the columns say
//!
//! | column | meaning |
//! |---|---|
//! | `median`, `min`, `mean` | wall time over the blocks, ns per particle and substep |
//! | `processor` | median of the processor time of all threads together: what other processes take does not show in it |
//! | `operations` | additions, subtractions, multiplications, divisions and square roots, one each, per particle and substep |
//! | `floor` | what they would take if all were halves of fused multiply-adds at the rate that this run measured, ns |
//! | `times` | processor time over the same floor: how far from the best that arithmetic allows |
//!
//! Operations are counted, not estimated: the simulator is written for any type of numbers, and one that counts
//! is put through the first substep of the same bed and its adjoint. The rate is that of independent fused
//! multiply-adds in registers, with the vectors that the kernels are dispatched to, on one thread.
//!
//! # How to reproduce it
//!
//! ```text
//! cargo run --release --bin optimise -- bench --particles 20000 --threads 1 --precision f32
//! cargo bench -p powderline-optimiser
//! ```
//!
//! The second one times each stage with criterion and compares with its own last run.

mod counted;
mod machine;
mod measure;
mod problem;

use thiserror::Error;

use crate::report::words::grouped;
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
        "a grid of {grid}^3 cells holds a bed of about {} particles at most, not of {}: give a larger --grid",
        grouped(*most as i64),
        grouped(*particles as i64)
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
        "{} particles need about {} MiB of memory, and there are {} MiB: ask for fewer{}",
        grouped(*particles as i64),
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
