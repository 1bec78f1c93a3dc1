//! Arguments that several commands share.

use super::size::{Memory, parse_memory};
use clap::{Args, ValueEnum};
use powderline_shared::plan::Precision;
use powderline_simulator::rollout::{
    RolloutError, Simulate, SimulatorSettings, Workload, boxed_simulator, check_memory,
};
use powderline_simulator::scene::Scene;

/// Number format of the simulation, as an argument.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PrecisionArg {
    /// 32-bit floating point
    F32,
    /// 64-bit floating point
    F64,
}

impl From<PrecisionArg> for Precision {
    fn from(argument: PrecisionArg) -> Self {
        match argument {
            PrecisionArg::F32 => Self::F32,
            PrecisionArg::F64 => Self::F64,
        }
    }
}

impl From<Precision> for PrecisionArg {
    fn from(precision: Precision) -> Self {
        match precision {
            Precision::F32 => Self::F32,
            Precision::F64 => Self::F64,
        }
    }
}

/// Precision when none is given.
pub(super) const DEFAULT_PRECISION: Precision = Precision::F32;

/// Threads that may be asked for.
pub const MAX_THREADS: u16 = 1024;

/// Resources of the simulation; they do not change its results.
#[derive(Clone, Copy, Debug, Args)]
pub struct Resources {
    /// Threads; results are the same for any number [default: one per processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(MAX_THREADS)))]
    pub threads: Option<u16>,
    /// Most memory that the process may hold, such as 128MiB, 2GiB or 500MB; `none` is as much as is useful, and never more
    /// than the machine has available. Results are the same for any
    #[arg(long, value_name = "SIZE", value_parser = parse_memory, default_value = "1GiB")]
    pub memory: Memory,
}

impl Resources {
    /// What is to be simulated with.
    pub fn setup(&self, seed: u64, precision: Precision) -> Setup {
        let (threads, memory_bytes) = (self.threads.map(usize::from), self.memory.bytes());
        Setup { precision, settings: SimulatorSettings { seed: Some(seed), threads, memory_bytes } }
    }
}

/// What a simulator is made with.
#[derive(Clone, Copy, Debug)]
pub struct Setup {
    /// Of its numbers.
    pub precision: Precision,
    /// All else.
    pub settings: SimulatorSettings,
}

impl Setup {
    /// The simulator of a scene.
    ///
    /// # Errors
    /// See [`boxed_simulator`].
    pub fn simulator(&self, scene: &Scene) -> Result<Box<dyn Simulate>, RolloutError> {
        boxed_simulator(scene, self.precision, &self.settings)
    }

    /// Whether memory will do.
    ///
    /// # Errors
    /// See [`check_memory`].
    pub fn check_memory(
        &self,
        scene: &Scene,
        work: Workload,
        besides_bytes: u64,
    ) -> Result<(), RolloutError> {
        check_memory(scene, self.precision, &self.settings, work, besides_bytes)
    }
}
