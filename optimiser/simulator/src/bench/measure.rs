//! What is run, what is read off, and what comes of it.

use std::ops::{ControlFlow, Range};

use powderline_shared::plan::Precision;
use serde::Serialize;

use super::BenchError;
use super::counted::{Counted, Elementary, operations};
use super::machine::{self, nanoseconds};
use super::problem::{Problem, SUBSTEPS};
use crate::memory::{PARTICLE_SCALARS, available_bytes, min_checkpoints};
use crate::mpm::timings::{Gauge, Pass, PassTimings, Reading, Stage};
use crate::real::Real;
use crate::rollout::{RolloutError, RolloutState, Simulator, Tick, quiet, thread_pool};

/// What is to be measured.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Particles in the bed.
    pub particles: usize,
    /// Cells along each edge of the grid.
    pub grid: usize,
    /// Substeps, rounded up to whole control steps of [`SUBSTEPS`].
    pub substeps: usize,
    /// Threads.
    pub threads: usize,
    /// Number format of the powder's state.
    pub precision: Precision,
    /// No gradient and no adjoint.
    pub forward_only: bool,
    /// Most memory to use, bytes; what the system can give when not given.
    pub memory_bytes: Option<u64>,
}

/// Told what is being done, and how far it is; [`ControlFlow::Break`] ends it with
/// [`RolloutError::Stopped`].
pub type Watch<'a> = &'a mut (dyn FnMut(&str, u64, u64) -> ControlFlow<()> + Send);

/// Control steps before anything is measured: the powder comes to lie on floor and bowl.
const WARM_UP: usize = 2;

/// Into how many parts the substeps are divided; gradient and forward run take turns in each.
const PARTS: usize = 5;

/// How often a gradient may advance each substep: as much as a long motion takes that keeps one state in a hundred.
const PASSES: u32 = 2;

/// Everything that is measured of stages, in the order of the report: key, part of the report, name.
pub(super) const ENTRIES: [(Pass, Stage, &str, &str); 14] = [
    (Pass::Forward, Stage::Sort, "forward", "sort"),
    (Pass::Forward, Stage::ParticlesToGrid, "forward", "particles to grid, with return map"),
    (Pass::Forward, Stage::GridUpdate, "forward", "grid update, with contact"),
    (Pass::Forward, Stage::GridToParticles, "forward", "grid to particles, with contact"),
    (Pass::Adjoint, Stage::ParticlesToGrid, "adjoint", "particles to grid, again"),
    (Pass::Adjoint, Stage::GridUpdate, "adjoint", "grid update, again"),
    (Pass::Adjoint, Stage::GridToParticlesAdjoint, "adjoint", "adjoint of grid to particles"),
    (Pass::Adjoint, Stage::GridUpdateAdjoint, "adjoint", "adjoint of grid update"),
    (Pass::Adjoint, Stage::ParticlesToGridAdjoint, "adjoint", "adjoint of particles to grid"),
    (Pass::Adjoint, Stage::SortAdjoint, "adjoint", "adjoint of sort"),
    (Pass::Alone, Stage::ReturnMap, "alone", "return map"),
    (Pass::Alone, Stage::ReturnMapAdjoint, "alone", "adjoint of return map"),
    (Pass::Alone, Stage::Sort, "alone", "sort, each time"),
    (Pass::Alone, Stage::SortAdjoint, "alone", "adjoint of sort, each time"),
];

/// All stages, as [`Bench::time_of`] takes them.
pub const STAGES: [Stage; 10] = [
    Stage::Sort,
    Stage::ParticlesToGrid,
    Stage::GridUpdate,
    Stage::GridToParticles,
    Stage::GridToParticlesAdjoint,
    Stage::GridUpdateAdjoint,
    Stage::ParticlesToGridAdjoint,
    Stage::SortAdjoint,
    Stage::ReturnMap,
    Stage::ReturnMapAdjoint,
];

/// A bed with a bowl in it, at some moment.
pub struct Bench<T: Real> {
    problem: Problem,
    simulator: Simulator<T>,
    moment: RolloutState<T>,
    /// Control steps done.
    step: usize,
    gauge: Gauge,
}

/// What a run took: in all, and stage by stage.
struct Taken {
    /// Readings when a control step began, and when the last one ended.
    stamps: Vec<Reading>,
    timings: Vec<PassTimings>,
}

impl<T: Real> Bench<T> {
    /// A bed at rest, free of stress.
    ///
    /// # Errors
    /// See [`BenchError`].
    pub fn new(particles: usize, grid: usize, threads: usize) -> Result<Self, BenchError> {
        Self::of(Problem::new(particles, grid)?, threads, nanoseconds)
    }

    fn of(problem: Problem, threads: usize, gauge: Gauge) -> Result<Self, BenchError> {
        let pool = thread_pool(threads)?;
        // Memory is looked after before; what is kept is bounded by number.
        let mut simulator = Simulator::with_packing(&problem.scene, problem.packing.clone(), pool, u64::MAX);
        let moment = simulator.initial_state(&mut quiet)?;
        Ok(Self { problem, simulator, moment, step: 0, gauge })
    }

    /// Substeps of so many control steps.
    fn substeps(&self, steps: usize) -> usize {
        steps * self.problem.scene.time.substeps as usize
    }

    fn next(&self, steps: usize) -> Range<usize> {
        self.step..self.step + steps
    }

    /// Goes on by so many control steps.
    fn forward(&mut self, steps: usize, progress: Tick<'_>) -> Result<Taken, RolloutError> {
        let controls = self.problem.controls(self.next(steps));
        let (gauge, mut stamps) = (self.gauge, Vec::with_capacity(steps + 1));
        self.simulator.timings().follow(self.gauge);
        let end = self.simulator.advanced(&self.moment, &controls, &mut |done, total| {
            stamps.push(gauge());
            progress(done, total)
        });
        let timings = self.simulator.timings().take();
        self.moment = end?;
        self.step += steps;
        Ok(Taken { stamps, timings })
    }

    /// The gradient of the loss after so many control steps, from here; stays here.
    fn gradient(&mut self, steps: usize, progress: Tick<'_>) -> Result<Taken, RolloutError> {
        let controls = self.problem.controls(self.next(steps));
        let kept = min_checkpoints(self.substeps(steps) as u64, PASSES) as usize;
        self.simulator.set_max_checkpoints(kept);
        self.simulator.timings().follow(self.gauge);
        let began = (self.gauge)();
        let gradient = self.simulator.control_gradient(&self.moment, &controls, progress);
        let stamps = vec![began, (self.gauge)()];
        let timings = self.simulator.timings().take();
        gradient?;
        Ok(Taken { stamps, timings })
    }

    /// Sort, material and their adjoints by themselves, for the powder as it is.
    fn alone(&mut self) -> Result<Vec<PassTimings>, RolloutError> {
        self.simulator.timings().follow(self.gauge);
        let done = self.simulator.alone(&self.moment);
        let timings = self.simulator.timings().take();
        done.map(|()| timings)
    }

    /// Nanoseconds that a stage takes in so many substeps (or adjoints of substeps, or sorts); a stage of a substep lets
    /// the powder move on.
    ///
    /// # Errors
    /// See [`RolloutError`].
    pub fn time_of(&mut self, stage: Stage, substeps: u64) -> Result<f64, RolloutError> {
        let pass = match stage {
            Stage::ParticlesToGrid | Stage::GridUpdate | Stage::GridToParticles => Pass::Forward,
            Stage::GridToParticlesAdjoint | Stage::GridUpdateAdjoint | Stage::ParticlesToGridAdjoint => {
                Pass::Adjoint
            }
            Stage::Sort | Stage::SortAdjoint | Stage::ReturnMap | Stage::ReturnMapAdjoint => Pass::Alone,
        };
        let (mut total_ns, mut count) = (0, 0);
        while count < substeps {
            let timings = match pass {
                Pass::Forward => self.forward(1, &mut quiet)?.timings,
                Pass::Adjoint => self.gradient(1, &mut quiet)?.timings,
                Pass::Alone => self.alone()?,
            };
            for lap in timings.iter().filter(|lap| lap.pass == pass) {
                total_ns += lap.stages[stage as usize][0];
                count += 1;
            }
        }
        Ok(total_ns as f64 * substeps as f64 / count as f64)
    }
}

/// What one block of a run took of wall time and of processor time (of all threads together), ns per particle and
/// substep.
type Block = [f64; 2];

/// Nanoseconds per particle and substep, over the blocks of the run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct TimeStats {
    /// Median over the blocks.
    pub median_ns: f64,
    /// The fastest block.
    pub min_ns: f64,
    /// Average over the blocks.
    pub mean_ns: f64,
    /// Median of the processor time, all threads together: other processes on the machine do not show here.
    pub processor_ns: f64,
}

/// The middle number, or the mean of the two in the middle; 0 of none.
fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    let at = |index: usize| numbers.get(index).copied().unwrap_or_default();
    0.5 * (at(numbers.len() / 2) + at(numbers.len().saturating_sub(1) / 2))
}

impl TimeStats {
    fn of(blocks: &[Block]) -> Self {
        let wall = || blocks.iter().map(|[wall, _]| *wall);
        Self {
            median_ns: median(wall().collect()),
            min_ns: wall().reduce(f64::min).unwrap_or_default(),
            mean_ns: wall().sum::<f64>() / blocks.len().max(1) as f64,
            processor_ns: median(blocks.iter().map(|[_, processor]| *processor).collect()),
        }
    }
}

/// The arithmetic of a stage or of a rollout.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Arithmetic {
    /// Floating-point operations per particle and substep, as counted in this bed.
    pub operations: f64,
    /// How many of them are divisions and square roots, which take longer than the floor says.
    pub divisions_and_roots: f64,
    /// What they would take at the rate of fused multiply-adds, ns: the best that arithmetic allows.
    pub floor_ns: f64,
    /// Processor time over what the operations take of it at that rate; none without operations.
    pub multiple: Option<f64>,
}

impl Arithmetic {
    fn of(counted: [f64; 2], time: &TimeStats, fma_gflops: f64, threads: usize) -> Self {
        let [operations, divisions_and_roots] = counted;
        let processor_floor_ns = operations / fma_gflops;
        Self {
            operations,
            divisions_and_roots,
            floor_ns: processor_floor_ns / threads as f64,
            multiple: (operations > 0.0).then(|| time.processor_ns / processor_floor_ns),
        }
    }
}

/// A stage.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct StageReport {
    /// `forward`, `adjoint` (with what it computes again of the substep), or `alone`.
    pub part: &'static str,
    /// What it does.
    pub name: &'static str,
    /// What it takes.
    #[serde(flatten)]
    pub time: TimeStats,
    /// What it computes.
    #[serde(flatten)]
    pub arithmetic: Arithmetic,
}

/// A whole rollout.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct WholeReport {
    /// `forward`, or `forward and gradient`.
    pub name: &'static str,
    /// What it takes, for each substep of the motion.
    #[serde(flatten)]
    pub time: TimeStats,
    /// What it computes.
    #[serde(flatten)]
    pub arithmetic: Arithmetic,
    /// Substeps of the motion in one rollout.
    pub substeps: usize,
    /// How often each of them was advanced, on average.
    pub advances: f64,
    /// States kept at a time.
    pub kept_states: u64,
}

/// The machine, as it was in this very run.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Machine {
    /// Width of its vectors, bits.
    pub vector_bits: u32,
    /// Operations a nanosecond that one thread does in fused multiply-adds, two operations each: median of the
    /// readings, which were taken in turn with the blocks.
    pub fma_gflops: f64,
    /// The best reading.
    pub fma_gflops_max: f64,
    /// Bytes a nanosecond that one thread reads from an array of 256 MiB.
    pub read_gb_per_s: f64,
    /// Part of the time that the threads wanted to run and another process had the processor.
    pub waiting_share: Option<f64>,
}

/// Memory.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Memory {
    /// The most that the process held, bytes.
    pub peak_bytes: Option<u64>,
    /// The most that it held before the first gradient.
    pub forward_peak_bytes: Option<u64>,
    /// A state as it is kept, bytes per particle.
    pub state_bytes_per_particle: f64,
    /// What a substep cannot but move, per particle: it reads the state and writes the next one.
    pub traffic_bytes_per_particle: f64,
    /// How long that takes at the measured rate of reading, ns, if no cache holds the state.
    pub traffic_ns: f64,
}

/// What came out.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Report {
    /// Particles.
    pub particles: usize,
    /// Cells along each edge of the grid.
    pub grid: usize,
    /// `f32` or `f64`.
    pub precision: &'static str,
    /// Threads.
    pub threads: usize,
    /// Substeps measured.
    pub substeps: usize,
    /// Substeps before.
    pub warm_up_substeps: usize,
    /// Blocks of 4x4x4 cells that hold particles.
    pub particle_blocks: usize,
    /// Part of the lanes of the particles' groups that holds particles.
    pub filled_lanes: f64,
    /// The machine.
    pub machine: Machine,
    /// Stages.
    pub stages: Vec<StageReport>,
    /// Whole rollouts.
    pub whole: Vec<WholeReport>,
    /// Memory.
    pub memory: Memory,
}

/// What was measured.
#[derive(Default)]
struct Blocks {
    stages: [Vec<Block>; ENTRIES.len()],
    forward: Vec<Block>,
    gradient: Vec<Block>,
    /// Substeps advanced in gradients, and substeps of their motions.
    advanced: [usize; 2],
    fma_rates: Vec<f64>,
    /// How long threads waited for processors, and how long everything took, ns.
    waited: Option<[u64; 2]>,
}

/// A part of the total for each of `count` things.
fn each(total: Reading, count: usize) -> Block {
    total.map(|total| total as f64 / count.max(1) as f64)
}

pub(super) fn difference(after: Reading, before: Reading) -> Reading {
    [after[0] - before[0], after[1] - before[1]]
}

/// Per particle and pass: an entry's share of the timings; none where they do not have its pass.
fn share(
    timings: &[PassTimings],
    (pass, stage, ..): (Pass, Stage, &str, &str),
    particles: usize,
) -> Option<Block> {
    let readings = || timings.iter().filter(|lap| lap.pass == pass).map(|lap| lap.stages[stage as usize]);
    let count = readings().count();
    let total = readings().fold([0; 2], |sum, reading| [sum[0] + reading[0], sum[1] + reading[1]]);
    (count > 0).then(|| each(total, count * particles))
}

impl Blocks {
    /// The timings of one block, as far as they belong to a pass.
    fn take_stages(&mut self, timings: &[PassTimings], pass: Pass, particles: usize) {
        for (entry, blocks) in ENTRIES.iter().zip(&mut self.stages) {
            if entry.0 == pass {
                blocks.extend(share(timings, *entry, particles));
            }
        }
    }

    fn take_forward(&mut self, taken: &Taken, particles: usize) {
        let substeps = SUBSTEPS as usize;
        for (timings, stamps) in taken.timings.chunks(substeps).zip(taken.stamps.windows(2)) {
            self.take_stages(timings, Pass::Forward, particles);
            self.forward.push(each(difference(stamps[1], stamps[0]), substeps * particles));
        }
    }

    fn take_gradient(&mut self, taken: &Taken, substeps: usize, particles: usize) {
        self.take_stages(&taken.timings, Pass::Adjoint, particles);
        self.gradient.push(each(difference(taken.stamps[1], taken.stamps[0]), substeps * particles));
        self.advanced[0] += taken.timings.iter().filter(|lap| lap.pass == Pass::Forward).count();
        self.advanced[1] += substeps;
    }
}

/// Operations per particle and substep of each entry, and how many of them are divisions and roots, counted in the first
/// substep of the bed and its adjoint.
fn counts<T: Elementary>(
    settings: &Settings,
    watch: Watch<'_>,
) -> Result<[[f64; 2]; ENTRIES.len()], BenchError> {
    let problem = Problem::new(settings.particles, settings.grid)?.by_substeps();
    let mut bench = Bench::<Counted<T>>::of(problem, 1, operations)?;
    let mut told = |done, total| watch("counting operations", done, total);
    let timings = if settings.forward_only {
        bench.forward(1, &mut told)?.timings
    } else {
        let mut timings = bench.gradient(1, &mut told)?.timings;
        timings.extend(bench.alone()?);
        timings
    };
    Ok(ENTRIES.map(|entry| share(&timings, entry, settings.particles).unwrap_or_default()))
}

/// Memory that a measurement needs, bytes, generously.
fn need(settings: &Settings, part: usize) -> u64 {
    let scalar: u64 = match settings.precision {
        Precision::F32 => 4,
        Precision::F64 => 8,
    };
    // Padding lanes make up a quarter, at most, of the groups of a bed that is not tiny.
    let state = settings.particles as u64 * (PARTICLE_SCALARS * scalar + 8) * 5 / 4;
    // Tiles and nodes: blocks of 64 cells with some 512 particles have a tile of 512 nodes and three sets of 64.
    let grid = settings.particles as u64 * 4 * scalar * 2 + settings.grid.pow(3) as u64 * 2;
    let states = if settings.forward_only {
        7
    } else {
        12 + min_checkpoints((part * SUBSTEPS as usize) as u64, PASSES)
    };
    (64 << 20) + machine::READ_BYTES as u64 + states * state + grid
}

/// Measures.
///
/// # Errors
/// See [`BenchError`].
pub fn run(settings: &Settings, watch: Watch<'_>) -> Result<Report, BenchError> {
    match settings.precision {
        Precision::F32 => measure::<f32>(settings, watch),
        Precision::F64 => measure::<f64>(settings, watch),
    }
}

fn measure<T: Elementary>(settings: &Settings, watch: Watch<'_>) -> Result<Report, BenchError> {
    let steps = settings.substeps.div_ceil(SUBSTEPS as usize).max(1);
    let part = steps.div_ceil(PARTS);
    check_memory(settings, part)?;
    let mut bench = Bench::<T>::new(settings.particles, settings.grid, settings.threads)?;
    bench.forward(WARM_UP, &mut |done, total| watch("warming up", done, total))?;
    let forward_peak_bytes = machine::peak_bytes();
    let blocks = measure_blocks(settings, &mut bench, [steps, part], watch)?;
    let peak_bytes = machine::peak_bytes();
    let (particle_blocks, lanes) = bench.moment.blocks_and_lanes();
    // Before what follows takes memory of its own.
    drop(bench);

    let counts = counts::<T>(settings, watch)?;
    let machine = machine_of(&blocks, settings.threads);
    let memory = Memory {
        peak_bytes,
        forward_peak_bytes,
        ..memory_of(settings.particles, lanes, size_of::<T>(), machine.read_gb_per_s)
    };
    let arithmetic = |counted: [f64; 2], time: &TimeStats| {
        Arithmetic::of(counted, time, machine.fma_gflops, settings.threads)
    };
    Ok(Report {
        particles: settings.particles,
        grid: settings.grid,
        precision: settings.precision.name(),
        threads: settings.threads,
        substeps: steps * SUBSTEPS as usize,
        warm_up_substeps: WARM_UP * SUBSTEPS as usize,
        particle_blocks,
        filled_lanes: settings.particles as f64 / lanes as f64,
        stages: stages(&blocks, &counts, &arithmetic),
        whole: whole(&blocks, part, &counts, &arithmetic),
        machine,
        memory,
    })
}

fn machine_of(blocks: &Blocks, threads: usize) -> Machine {
    let share = |[waited, all]: [u64; 2]| waited as f64 / (all.max(1) as f64 * threads as f64);
    Machine {
        vector_bits: machine::vector_bits(),
        fma_gflops: median(blocks.fma_rates.clone()),
        fma_gflops_max: blocks.fma_rates.iter().copied().fold(0.0, f64::max),
        read_gb_per_s: machine::read_rate(),
        waiting_share: blocks.waited.map(share),
    }
}

fn memory_of(particles: usize, lanes: usize, scalar_bytes: usize, read_gb_per_s: f64) -> Memory {
    let state = PARTICLE_SCALARS as f64 * scalar_bytes as f64;
    Memory {
        peak_bytes: None,
        forward_peak_bytes: None,
        // Identity and origin go with each lane.
        state_bytes_per_particle: (state + 8.0) * lanes as f64 / particles as f64,
        traffic_bytes_per_particle: 2.0 * state,
        traffic_ns: 2.0 * state / read_gb_per_s,
    }
}

fn check_memory(settings: &Settings, part: usize) -> Result<(), BenchError> {
    let Some(free) = settings.memory_bytes.or_else(available_bytes) else { return Ok(()) };
    let need = need(settings, part);
    if need > free {
        let Settings { particles, forward_only, .. } = *settings;
        return Err(BenchError::Memory { particles, need, free, forward_only });
    }
    Ok(())
}

/// Gradient and forward run in turn over the same substeps, so that whatever slows the machine slows both.
fn measure_blocks<T: Real>(
    settings: &Settings,
    bench: &mut Bench<T>,
    [steps, part]: [usize; 2],
    watch: Watch<'_>,
) -> Result<Blocks, BenchError> {
    let particles = settings.particles;
    let mut blocks = Blocks::default();
    let (began, waited_before) = (nanoseconds(), machine::waited_ns());
    let mut done = 0;
    while done < steps {
        let part = part.min(steps - done);
        // The gradient takes some four times as long as the forward run.
        let mut told = |from: u64, to: u64, part_done: u64, part_total: u64| {
            let all = 5 * steps as u64 * 1000;
            let within = (to - from) * 1000 * part_done / part_total.max(1);
            watch("measuring", 5 * done as u64 * 1000 + from * 1000 + within, all)
        };
        let width = part as u64;
        blocks.fma_rates.push(machine::fma_rate(settings.precision));
        if !settings.forward_only {
            let taken = bench.gradient(part, &mut |d, t| told(0, 4 * width, d, t))?;
            blocks.take_gradient(&taken, bench.substeps(part), particles);
            for _ in 0..part {
                blocks.take_stages(&bench.alone()?, Pass::Alone, particles);
            }
        }
        let taken = bench.forward(part, &mut |d, t| told(4 * width, 5 * width, d, t))?;
        blocks.take_forward(&taken, particles);
        done += part;
    }
    let waited = machine::waited_ns().zip(waited_before).map(|(after, before)| after.saturating_sub(before));
    blocks.waited = waited.map(|waited| [waited, nanoseconds()[0] - began[0]]);
    Ok(blocks)
}

/// Puts counts and times together.
type Judge<'a> = &'a dyn Fn([f64; 2], &TimeStats) -> Arithmetic;

fn stages(blocks: &Blocks, counts: &[[f64; 2]; ENTRIES.len()], judge: Judge<'_>) -> Vec<StageReport> {
    let all = ENTRIES.iter().zip(&blocks.stages).zip(counts).filter(|((_, times), _)| !times.is_empty());
    all.map(|(((_, _, part, name), times), counted)| {
        let time = TimeStats::of(times);
        StageReport { part, name, time, arithmetic: judge(*counted, &time) }
    })
    .collect()
}

fn whole(
    blocks: &Blocks,
    part: usize,
    counts: &[[f64; 2]; ENTRIES.len()],
    judge: Judge<'_>,
) -> Vec<WholeReport> {
    let substeps = part * SUBSTEPS as usize;
    let of = |pass: Pass| {
        let counts = ENTRIES.iter().zip(counts).filter(|(entry, _)| entry.0 == pass);
        counts.fold([0.0; 2], |sum, (_, counted)| [sum[0] + counted[0], sum[1] + counted[1]])
    };
    let (once, adjoint) = (of(Pass::Forward), of(Pass::Adjoint));
    let report = |name, blocks: &[Block], advances: f64, counted: [f64; 2], kept_states: u64| {
        let time = TimeStats::of(blocks);
        WholeReport { name, time, arithmetic: judge(counted, &time), substeps, advances, kept_states }
    };
    let forward = report("forward", &blocks.forward, 1.0, once, 0);
    let [advanced, in_all] = blocks.advanced;
    let gradient = (in_all > 0).then(|| {
        let advances = advanced as f64 / in_all as f64;
        let counted = [0, 1].map(|i| advances * once[i] + adjoint[i]);
        let kept = min_checkpoints(substeps as u64, PASSES);
        report("forward and gradient", &blocks.gradient, advances, counted, kept)
    });
    [forward].into_iter().chain(gradient).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::real::{Polynomial, RealOps};

    #[test]
    #[expect(clippy::float_cmp, reason = "halves of whole numbers")]
    fn medians_lie_in_the_middle() {
        assert_eq!(median(vec![]), 0.0);
        assert_eq!(median(vec![3.0]), 3.0);
        assert_eq!(median(vec![9.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(vec![9.0, 1.0, 2.0, 4.0]), 3.0);
    }

    fn tiny() -> Settings {
        Settings {
            particles: 1_000,
            grid: 16,
            substeps: 1,
            threads: 1,
            precision: Precision::F32,
            forward_only: false,
            memory_bytes: None,
        }
    }

    fn entry(pass: Pass, stage: Stage) -> usize {
        ENTRIES.iter().position(|entry| entry.0 == pass && entry.1 == stage).expect("measured")
    }

    #[test]
    fn operations_of_the_scatter_are_those_counted_by_hand() {
        let counts = counts::<f32>(&tiny(), &mut |_, _, _| ControlFlow::Continue(())).expect("fits");
        let bench = Bench::<f32>::new(1_000, 16, 1).expect("fits");
        let (_, lanes) = bench.moment.blocks_and_lanes();
        let lanes_per_particle = lanes as f64 / 1_000.0;
        let [whole, material] = [(Pass::Forward, Stage::ParticlesToGrid), (Pass::Alone, Stage::ReturnMap)]
            .map(|(pass, stage)| counts[entry(pass, stage)]);
        // For each lane its place and its weights, six and nine operations along each axis, and nine products of them. For each
        // particle the scatter, and for each run of particles with the same nodes nine rows (see `counted.rs`).
        // The momentum without forces is scattered as well: for each lane 9 and 3 products, and 18 operations to take it to its first node.
        let expected = lanes_per_particle * (3 * (6 + 9) + 9 + 9 + 3 + 18) as f64 + 2.0 * 561.0;
        let of_runs = 0.5 * (whole[0] - material[0] - expected);
        assert!(of_runs > 144.0 / 16.0 && of_runs < 144.0 / 2.0, "{whole:?} {material:?} {expected}");
        assert!((whole[1] - material[1]).abs() < 1e-9, "a scatter neither divides nor takes roots");
    }

    #[test]
    fn precisions_differ_by_their_elementary_functions() {
        let narrow = counts::<f32>(&tiny(), &mut |_, _, _| ControlFlow::Continue(())).expect("fits");
        let wide = counts::<f64>(&tiny(), &mut |_, _, _| ControlFlow::Continue(())).expect("fits");
        let (_, lanes) = Bench::<f64>::new(1_000, 16, 1).expect("fits").moment.blocks_and_lanes();
        let at = entry(Pass::Alone, Stage::ReturnMap);
        // A logarithm and an exponential, and a series for either of matrices: four operations a term.
        let functions = (f64::LN_1P[0] - f32::LN_1P[0]) + (f64::EXP_M1[0] - f32::EXP_M1[0]);
        let terms = |ln: Polynomial, exp: Polynomial| (ln.terms + exp.terms) as u64;
        let more =
            terms(f64::LN_1P_SERIES, f64::EXP_M1_SERIES) - terms(f32::LN_1P_SERIES, f32::EXP_M1_SERIES);
        let functions = functions + 4 * more;
        let expected = functions as f64 * lanes as f64 / 1_000.0;
        assert!((wide[at][0] - narrow[at][0] - expected).abs() < 1e-9, "{wide:?} {narrow:?}");
        let at = entry(Pass::Forward, Stage::GridUpdate);
        // A node on a surface may be behind a wall in one precision and not in the other.
        assert!((wide[at][0] / narrow[at][0] - 1.0).abs() < 2e-4);
    }

    #[test]
    fn a_stage_is_timed_by_itself() {
        let mut bench = Bench::<f32>::new(1_000, 16, 2).expect("fits");
        for stage in STAGES {
            let ns = bench.time_of(stage, 3).expect("runs");
            assert!(ns > 0.0 && ns < 1e12, "{stage:?}: {ns}");
        }
    }
}
