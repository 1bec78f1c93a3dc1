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
//! # What it shows
//!
//! Two cores of a Xeon with AVX-512 (rustc 1.95, 20,000 particles, `f32`, one thread; ns per particle and substep):
//!
//! ```text
//! ns per particle and substep              median      min     mean  processor  operations    floor  times
//!
//! forward
//!   sort                                      0.2      0.2      1.1        0.1           0
//!   particles to grid, with return map       21.7     19.0     21.9       21.8        1311      6.5    3.3
//!   grid update, with contact                 6.7      6.1      7.2        6.6          92      0.5   14.5
//!   grid to particles, with contact          26.0     25.2     27.8       26.1        1355      6.8    3.9
//!
//! adjoint
//!   particles to grid, again                 12.5     12.1     12.8       12.6        1311      6.5    1.9
//!   grid update, again                        3.3      3.1      3.3        3.2          92      0.5    7.1
//!   adjoint of grid to particles             65.7     62.6     68.5       65.6        3092     15.4    4.3
//!   adjoint of grid update                   12.0     11.5     12.4       12.0         225      1.1   10.6
//!   adjoint of particles to grid             60.4     58.8     62.2       60.4        3991     19.9    3.0
//!   adjoint of sort                           0.0      0.0      0.4        0.0           0
//!
//! alone
//!   return map                               15.4      9.2     16.7       15.5         533      2.7    5.8
//!   adjoint of return map                    20.8     15.6     21.5       20.8        1266      6.3    3.3
//!   sort, each time                          85.6     70.9     92.6       85.6           0
//!   adjoint of sort, each time               31.7     21.4     38.5       31.8           0
//!
//! whole
//!   forward                                  57.2     50.6     58.1       57.2        2757     13.7    4.2
//!   forward and gradient                    285.1    269.1    298.3      285.0       13605     67.8    4.2
//! ```
//!
//! - Particles to grid: half the return map, half the scatter, which adds nine rows of nodes for each particle. The rows of
//!   particles with the same nodes stay in registers, with four of sixteen lanes of each row in vain.
//! - Grid to particles: the gather reads a group's nodes once for all sixteen lanes ([`crate`]'s `mpm/gather.rs`), some two
//!   runs of 300 multiply-adds a group; about half of its lanes are in each run. Broadcasts and spilled registers take as long as the
//!   arithmetic.
//! - Grid update: sums of tiles from the cache, and contact with walls and tool; nearly no arithmetic, and blocks without mass
//!   are left out. Its multiple of the floor says little.
//! - Adjoints: the same gathers with the derivatives of the weights (twice the arithmetic), and the return map twice, forward and
//!   back. States that were kept come from the last cache or from memory: 176 bytes a particle are worth 17 ns there.
//! - "Again" is what the grid of a substep costs where it was not kept with its state: at the ends of the schedule's runs. Its time
//!   is spread over all substeps, its operations are those of one that needs it.
//! - The return map alone takes longest where powder is sheared by more than 0.6: those groups go to the eigenvectors.
//!
//! # What limits each stage
//!
//! Instructions, misses of the first and of the second-level cache (48 KiB and 2 MiB) and branches guessed wrong, per particle and
//! substep, by callgrind, which knows vectors of 256 bits only (with 512 bits it is about half the instructions); and the
//! shares of samples of the same program with 512 bits (`perf record -e cpu-clock`) that hit instructions with whole vectors, and
//! such with an operand on the stack:
//!
//! | stage | instructions | L1 misses | L2 misses | mispredicted | whole vectors | on the stack | what limits it |
//! |---|---|---|---|---|---|---|---|
//! | particles to grid | 285 | 2.3 | 1.9 | 0.4 | 68 % | 3 % | issue of instructions |
//! | grid update | 63 | 1.3 | 0.9 | 0.8 | 56 % | 0 | branches, and loads of tiles |
//! | grid to particles | 359 | 2.2 | 1.0 | 0.6 | 77 % | 18 % | loads: broadcasts, spilled vectors |
//! | its adjoint | 896 | 4.5 | 1.9 | 1.7 | 69 % | 19 % | spilled vectors, contact's branches |
//! | adjoint of grid update | 106 | 1.3 | 0.9 | 0.7 | 57 % | 4 % | branches of contact |
//! | adjoint of particles to grid | 916 | 4.2 | 2.9 | 1.0 | 89 % | 29 % | loads and stores of spilled vectors |
//! | return map alone | 90 | 1.6 | 1.6 | 0 | | | arithmetic, 70 % of the multiply-adds that fit |
//!
//! The return map was also written with explicit vectors, twice as long a text: with `pulp` and with `fearless_simd` it takes 3 to 7 %
//! longer than these arrays, which the compiler vectorises inside `pulp`'s dispatch; `wide`, which has no dispatch, takes 2.5
//! times as long in a program that runs everywhere. With 256 bits explicit vectors would be 1.2 to 1.3 times as fast as the arrays.
//! `-C target-cpu=x86-64-v4` makes everything here half as fast: the compiler then prefers vectors of 256 bits.
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
