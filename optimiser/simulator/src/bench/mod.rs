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
//! stages of its substeps (`mpm/timings.rs`): the stages add up to the whole, and meet the caches as they are. A control step
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
//!   sort                                       0.2      0.2      1.0        0.1           0
//!   particles to grid, with return map        20.8     19.6     21.5       20.9        1176      7.2    2.9
//!   grid update, with contact                  7.0      6.5      7.4        7.0          92      0.6   12.5
//!   grid to particles, with contact           25.2     22.9     26.6       25.2        1355      8.3    3.0
//!
//! adjoint
//!   particles to grid, again                  11.3     10.7     11.4       11.4        1176      7.2    1.6
//!   grid update, again                         3.3      3.2      3.4        3.3          92      0.6    5.8
//!   adjoint of grid to particles              57.4     55.1     60.2       57.5        2957     18.1    3.2
//!   adjoint of grid update                    11.7     11.5     12.3       11.7         225      1.4    8.5
//!   adjoint of particles to grid              55.8     51.5     56.8       55.9        3991     24.4    2.3
//!   adjoint of sort                            0.0      0.0      0.3        0.0           0
//!
//! alone
//!   return map                                15.1      9.3     15.9       15.2         533      3.3    4.7
//!   adjoint of return map                     19.0     15.6     20.9       19.0        1266      7.7    2.5
//!   sort, each time                           90.7     71.9     98.6       90.7           0
//!   adjoint of sort, each time                29.7     19.9     35.2       29.8           0
//!
//! whole
//!   forward                                   54.5     50.8     56.7       54.5        2622     16.0    3.4
//!   forward and gradient                     258.8    246.8    267.8      258.8       13096     80.0    3.2
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
//! cargo bench -p powderline-simulator
//! ```
//!
//! The second one times each stage with criterion and compares with its own last run.
//!
//! `optimise bench --scene SCENE` says the same of a whole rollout of a scene: there most of the powder may be asleep, and walls are near.

mod counted;
mod machine;
mod measure;
mod problem;
mod profile;

use thiserror::Error;

use crate::rollout::RolloutError;
use crate::scene::figures::grouped;

pub use crate::mpm::timings::Stage;
pub use counted::Elementary;
pub use machine::cpu_seconds;
pub use measure::{
    Arithmetic, Bench, Machine, Memory, Report, STAGES, Settings, StageReport, TimeStats, Watch, WholeReport,
    run,
};
pub use problem::{PARTICLES_PER_CELL, SUBSTEPS};
pub use profile::{Profile, ProfileSettings, RunTime, Seconds, StageTime, profile};

/// Why nothing was measured.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
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
