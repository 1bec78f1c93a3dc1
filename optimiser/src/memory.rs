//! How much memory a rollout with its gradient needs, for each way of keeping checkpoints.
//!
//! A checkpoint is the state at the start of a control step. The adjoint of a control step needs the state before
//! each of its substeps; these are recomputed from a checkpoint into the step's tape. Grids are recomputed too.

use crate::scene::{BLOCK_CELLS, Scene};

/// Scalars of a particle's state: position 3, velocity 3, affine velocity 9, elastic strain 6, volume correction 1.
pub const PARTICLE_SCALARS: usize = 22;

/// Scalars of a grid cell: mass and three of momentum.
pub const CELL_SCALARS: usize = 4;

/// Floating-point type of the simulation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// 32-bit.
    F32,
    /// 64-bit.
    F64,
}

impl Precision {
    /// Size of a scalar, bytes.
    pub fn scalar_bytes(self) -> u64 {
        match self {
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// Which states are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Schedule {
    /// One checkpoint per control step.
    EveryStep,
    /// One per `stride` control steps, and one per step within the stretch being differentiated.
    Strided {
        /// Control steps from one lasting checkpoint to the next.
        stride: u32,
    },
    /// As many as `checkpoints`, placed anew as the adjoint moves back (Revolve).
    Binomial {
        /// Checkpoints kept at a time.
        checkpoints: u32,
    },
}

/// Need of one schedule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScheduleEstimate {
    /// The schedule.
    pub schedule: Schedule,
    /// Peak memory, bytes.
    pub bytes: u64,
    /// How often each control step is computed forward, at most.
    pub forward_runs: u32,
}

/// What a rollout with its gradient needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryEstimate {
    /// One checkpoint, bytes.
    pub checkpoint_bytes: u64,
    /// The states before each substep of one control step, bytes.
    pub tape_bytes: u64,
    /// Grid and its adjoint, bytes, were every block in use.
    pub grid_bytes: u64,
    /// Every control step, every k-th, binomial.
    pub schedules: [ScheduleEstimate; 3],
}

/// Estimates the memory for the forward and adjoint rollout of a scene.
pub fn memory_estimate(scene: &Scene, precision: Precision) -> MemoryEstimate {
    let particles = scene.particle_count() as u64;
    let scalar_bytes = precision.scalar_bytes();
    let checkpoint_bytes = particles * (PARTICLE_SCALARS as u64 * scalar_bytes + size_of::<u32>() as u64);
    let blocks = scene.block_counts().map(|count| count as u64).iter().product::<u64>();
    let grid_bytes = 2 * blocks * (BLOCK_CELLS.pow(3) * CELL_SCALARS) as u64 * scalar_bytes;
    let tape_bytes = u64::from(scene.time.substeps) * checkpoint_bytes;
    // The running state and its cotangent.
    let standing_bytes = 2 * checkpoint_bytes + tape_bytes + grid_bytes;
    let steps = scene.time.horizon_steps;
    let estimate = |schedule, checkpoints: u32, forward_runs| ScheduleEstimate {
        schedule,
        bytes: standing_bytes + u64::from(checkpoints) * checkpoint_bytes,
        forward_runs,
    };
    let stride = f64::from(steps).sqrt().ceil() as u32;
    let (slots, repeats) = binomial_slots(steps);
    MemoryEstimate {
        checkpoint_bytes,
        tape_bytes,
        grid_bytes,
        schedules: [
            estimate(Schedule::EveryStep, steps, 2),
            estimate(Schedule::Strided { stride }, steps.div_ceil(stride) + stride, 3),
            estimate(Schedule::Binomial { checkpoints: slots }, slots, repeats + 1),
        ],
    }
}

/// Fewest checkpoints with which no control step is advanced more than three times, and that number: s checkpoints
/// and r repeats cover (s + r)! / (s! r!) steps (Griewank and Walther 2000).
fn binomial_slots(steps: u32) -> (u32, u32) {
    const REPEATS: u32 = 3;
    let covered = |slots: u64| (slots + 1) * (slots + 2) * (slots + 3) / 6;
    let slots = (1u32..).find(|slots| covered(u64::from(*slots)) >= u64::from(steps)).unwrap_or(steps);
    (slots, REPEATS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bench_in_single_precision() {
        let scene = Scene::load("bench").unwrap();
        let estimate = memory_estimate(&scene, Precision::F32);
        assert_eq!(estimate.checkpoint_bytes, 11_264 * (22 * 4 + 4));
        assert_eq!(estimate.tape_bytes, 20 * estimate.checkpoint_bytes);
        assert_eq!(estimate.grid_bytes, 2 * 18 * 8 * 15 * 64 * 4 * 4);
        let [every, strided, binomial] = estimate.schedules;
        assert_eq!(every.bytes - strided.bytes, (500 - 45) * 1_036_288);
        assert_eq!(strided.schedule, Schedule::Strided { stride: 23 });
        assert_eq!(binomial.schedule, Schedule::Binomial { checkpoints: 13 });
        assert!(every.bytes > strided.bytes && strided.bytes > binomial.bytes);
    }

    #[test]
    fn binomial_slots_are_the_fewest() {
        assert_eq!(binomial_slots(1), (1, 3));
        assert_eq!(binomial_slots(4), (1, 3));
        assert_eq!(binomial_slots(5), (2, 3));
        assert_eq!(binomial_slots(560), (13, 3));
        assert_eq!(binomial_slots(561), (14, 3));
        assert_eq!(binomial_slots(100_000), (83, 3));
    }
}
