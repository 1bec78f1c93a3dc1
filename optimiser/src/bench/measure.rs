//! What is run, what is read off, and what comes of it.

use std::ops::Range;
use std::sync::OnceLock;
use std::time::Instant;

use powderline_shared::plan::Precision;
use serde::Serialize;

use super::problem::{Problem, SUBSTEPS};
use super::{BenchError, machine};
use crate::memory::{PARTICLE_SCALARS, fewest_states};
use crate::mpm::laps::{Lap, Pass, Reading, Stage};
use crate::real::Real;
use crate::rollout::{Moment, Progress, RolloutError, Simulator, thread_pool};

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

/// Told what is being done, and how far it is; `false` ends it with [`RolloutError::Stopped`].
pub type Watch<'a> = &'a mut (dyn FnMut(&str, u64, u64) -> bool + Send);

/// Control steps before anything is measured: the powder comes to lie on floor and bowl.
const WARM_UP: usize = 2;

/// Into how many parts the substeps are divided; gradient and forward run take turns in each.
const PARTS: usize = 5;

/// How often a gradient may advance each substep: as much as a long motion takes that keeps one state in a hundred.
const PASSES: u32 = 2;

/// Everything that is measured of stages, in the order of the report: key, part of the report, name.
const ENTRIES: [(Pass, Stage, &str, &str); 12] = [
    (Pass::Forward, Stage::Sort, "forward", "sort"),
    (Pass::Forward, Stage::ParticlesToGrid, "forward", "particles to grid, with return map"),
    (Pass::Forward, Stage::GridUpdate, "forward", "grid update, with contact"),
    (Pass::Forward, Stage::GridToParticles, "forward", "grid to particles, with contact"),
    (Pass::Adjoint, Stage::ParticlesToGrid, "adjoint", "particles to grid, again"),
    (Pass::Adjoint, Stage::GridUpdate, "adjoint", "grid update, again"),
    (Pass::Adjoint, Stage::GridToParticlesAdjoint, "adjoint", "adjoint of grid to particles"),
    (Pass::Adjoint, Stage::GridUpdateAdjoint, "adjoint", "adjoint of grid update"),
    (Pass::Adjoint, Stage::ParticlesToGridAdjoint, "adjoint", "adjoint of particles to grid"),
    (Pass::Adjoint, Stage::Unsort, "adjoint", "adjoint of sort"),
    (Pass::Material, Stage::ReturnMap, "alone", "return map"),
    (Pass::Material, Stage::ReturnMapAdjoint, "alone", "adjoint of return map"),
];

/// The stages that a substep and its adjoint are made of.
pub const STAGES: [Stage; 8] = [
    Stage::Sort,
    Stage::ParticlesToGrid,
    Stage::GridUpdate,
    Stage::GridToParticles,
    Stage::GridToParticlesAdjoint,
    Stage::GridUpdateAdjoint,
    Stage::ParticlesToGridAdjoint,
    Stage::Unsort,
];

/// Nanoseconds since the first reading.
fn nanoseconds() -> Reading {
    static START: OnceLock<Instant> = OnceLock::new();
    [START.get_or_init(Instant::now).elapsed().as_nanos() as u64, 0]
}

/// A bed with a bowl in it, at some moment.
pub struct Bench<T: Real> {
    problem: Problem,
    simulator: Simulator<T>,
    moment: Moment<T>,
    /// Control steps done.
    step: usize,
}

/// What a run took: in all, and stage by stage.
struct Taken {
    /// Moments when a control step began, and when the last one ended.
    stamps: Vec<Instant>,
    laps: Vec<Lap>,
}

impl<T: Real> Bench<T> {
    /// A bed at rest, free of stress.
    ///
    /// # Errors
    /// See [`BenchError`].
    pub fn new(particles: usize, grid: usize, threads: usize) -> Result<Self, BenchError> {
        Self::of(Problem::new(particles, grid)?, threads)
    }

    fn of(problem: Problem, threads: usize) -> Result<Self, BenchError> {
        let pool = thread_pool(threads)?;
        // Memory is looked after before; what is kept is bounded by number.
        let mut simulator = Simulator::new(&problem.scene, problem.packing.clone(), pool, u64::MAX);
        let moment = simulator.beginning(&mut |_, _| true)?;
        Ok(Self { problem, simulator, moment, step: 0 })
    }

    fn next(&self, steps: usize) -> Range<usize> {
        self.step..self.step + steps
    }

    /// Goes on by so many control steps.
    fn forward(&mut self, steps: usize, progress: Progress<'_>) -> Result<Taken, RolloutError> {
        let controls = self.problem.controls(self.next(steps));
        let mut stamps = Vec::with_capacity(steps + 1);
        self.simulator.laps().follow(nanoseconds);
        let end = self.simulator.after(&self.moment, &controls, &mut |done, total| {
            stamps.push(Instant::now());
            progress(done, total)
        });
        let laps = self.simulator.laps().take();
        self.moment = end?;
        self.step += steps;
        Ok(Taken { stamps, laps })
    }

    /// The gradient of the loss after so many control steps, from here; stays here.
    fn gradient(&mut self, steps: usize, progress: Progress<'_>) -> Result<Taken, RolloutError> {
        let controls = self.problem.controls(self.next(steps));
        let kept = fewest_states((steps * SUBSTEPS as usize) as u64, PASSES) as usize;
        self.simulator.keep_at_most(kept);
        self.simulator.laps().follow(nanoseconds);
        let began = Instant::now();
        let gradient = self.simulator.control_gradient(&self.moment, &controls, progress);
        let stamps = vec![began, Instant::now()];
        let laps = self.simulator.laps().take();
        gradient?;
        Ok(Taken { stamps, laps })
    }

    /// The material of the powder as it is, by itself.
    fn material(&mut self) -> Vec<Lap> {
        self.simulator.laps().follow(nanoseconds);
        self.simulator.material(&self.moment);
        self.simulator.laps().take()
    }

    /// Nanoseconds that a stage takes in so many substeps (or adjoints of substeps), rounded up to whole control steps;
    /// the powder moves on.
    ///
    /// # Errors
    /// See [`RolloutError`].
    pub fn time_of(&mut self, stage: Stage, substeps: u64) -> Result<f64, RolloutError> {
        let forward = ENTRIES.iter().any(|(pass, s, _, _)| *s == stage && *pass == Pass::Forward);
        let material = matches!(stage, Stage::ReturnMap | Stage::ReturnMapAdjoint);
        let wanted = if forward { Pass::Forward } else { Pass::Adjoint };
        let (mut total_ns, mut count) = (0, 0);
        while count < substeps {
            let laps = match (forward, material) {
                (true, _) => self.forward(1, &mut |_, _| true)?.laps,
                (_, true) => self.material(),
                _ => self.gradient(1, &mut |_, _| true)?.laps,
            };
            let laps = laps.iter().filter(|lap| material || lap.pass == wanted);
            for lap in laps {
                total_ns += lap.stages[stage as usize][0];
                count += 1;
            }
        }
        Ok(total_ns as f64 * substeps as f64 / count as f64)
    }
}

/// Nanoseconds per particle and substep: over the blocks of the run, the middle, the smallest and the average.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Timing {
    /// Median over the blocks.
    pub median_ns: f64,
    /// The fastest block.
    pub min_ns: f64,
    /// Average over the blocks.
    pub mean_ns: f64,
}

impl Timing {
    /// All zero without blocks.
    fn of(mut blocks: Vec<f64>) -> Self {
        blocks.sort_by(f64::total_cmp);
        let n = blocks.len();
        let at = |index: usize| blocks.get(index).copied().unwrap_or_default();
        Self {
            median_ns: 0.5 * (at(n / 2) + at(n.saturating_sub(1) / 2)),
            min_ns: at(0),
            mean_ns: blocks.iter().sum::<f64>() / n.max(1) as f64,
        }
    }
}

/// A stage.
#[derive(Clone, Debug, Serialize)]
pub struct StageReport {
    /// `forward`, `adjoint` (with what it computes again of the substep), or `alone`.
    pub part: &'static str,
    /// What it does.
    pub name: &'static str,
    /// What it takes.
    #[serde(flatten)]
    pub time: Timing,
}

/// A whole rollout.
#[derive(Clone, Debug, Serialize)]
pub struct WholeReport {
    /// `forward`, or `forward and gradient`.
    pub name: &'static str,
    /// What it takes, for each substep of the motion.
    #[serde(flatten)]
    pub time: Timing,
    /// Substeps of the motion in one rollout.
    pub substeps: usize,
    /// How often each of them was advanced, on average.
    pub advances: f64,
    /// States kept at a time.
    pub kept_states: u64,
}

/// The machine, as it was in this very run.
#[derive(Clone, Debug, Serialize)]
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

/// Measured blocks, as nanoseconds per particle and substep.
#[derive(Default)]
struct Blocks {
    stages: [Vec<f64>; ENTRIES.len()],
    forward: Vec<f64>,
    gradient: Vec<f64>,
    /// Substeps advanced in gradients, and substeps of their motions.
    advanced: [usize; 2],
    fma_rates: Vec<f64>,
    /// How long threads waited for processors, and how long everything took, ns.
    waited: Option<[u64; 2]>,
}

impl Blocks {
    /// The laps of one block; `passes` are those that it is about.
    fn take_stages(&mut self, laps: &[Lap], passes: &[Pass], particles: usize) {
        for (entry, blocks) in ENTRIES.iter().zip(&mut self.stages) {
            let of_pass = || laps.iter().filter(|lap| lap.pass == entry.0);
            let count = of_pass().count();
            if count > 0 && passes.contains(&entry.0) {
                let total_ns: u64 = of_pass().map(|lap| lap.stages[entry.1 as usize][0]).sum();
                blocks.push(total_ns as f64 / (count * particles) as f64);
            }
        }
    }

    fn take_forward(&mut self, taken: &Taken, particles: usize) {
        let substeps = SUBSTEPS as usize;
        for (laps, stamps) in taken.laps.chunks(substeps).zip(taken.stamps.windows(2)) {
            self.take_stages(laps, &[Pass::Forward], particles);
            let block_ns = (stamps[1] - stamps[0]).as_nanos() as f64;
            self.forward.push(block_ns / (substeps * particles) as f64);
        }
    }

    fn take_gradient(&mut self, taken: &Taken, steps: usize, particles: usize) {
        let substeps = steps * SUBSTEPS as usize;
        self.take_stages(&taken.laps, &[Pass::Adjoint], particles);
        let whole_ns = (taken.stamps[1] - taken.stamps[0]).as_nanos() as f64;
        self.gradient.push(whole_ns / (substeps * particles) as f64);
        self.advanced[0] += taken.laps.iter().filter(|lap| lap.pass == Pass::Forward).count();
        self.advanced[1] += substeps;
    }
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
    let states =
        if settings.forward_only { 7 } else { 12 + fewest_states((part * SUBSTEPS as usize) as u64, PASSES) };
    (64 << 20) + machine::READ_BYTES as u64 + states * state + grid
}

/// Measures.
///
/// # Errors
/// See [`BenchError`].
pub fn run(settings: &Settings, watch: Watch<'_>) -> Result<Report, BenchError> {
    match settings.precision {
        Precision::F32 => measure::<f32>(settings, "f32", watch),
        Precision::F64 => measure::<f64>(settings, "f64", watch),
    }
}

fn measure<T: Real>(
    settings: &Settings,
    precision: &'static str,
    watch: Watch<'_>,
) -> Result<Report, BenchError> {
    let steps = settings.substeps.div_ceil(SUBSTEPS as usize).max(1);
    let part = steps.div_ceil(PARTS);
    check_memory(settings, part)?;
    let mut bench = Bench::<T>::new(settings.particles, settings.grid, settings.threads)?;
    bench.forward(WARM_UP, &mut |done, total| watch("warming up", done, total))?;
    let forward_peak_bytes = machine::peak_bytes();
    let blocks = measure_blocks(settings, &mut bench, [steps, part], watch)?;
    let peak_bytes = machine::peak_bytes();
    let (particle_blocks, lanes) = bench.moment.blocks_and_lanes();
    drop(bench);

    let read_gb_per_s = machine::read_rate();
    let scalar_bytes = size_of::<T>() as f64;
    let traffic = 2.0 * PARTICLE_SCALARS as f64 * scalar_bytes;
    Ok(Report {
        particles: settings.particles,
        grid: settings.grid,
        precision,
        threads: settings.threads,
        substeps: steps * SUBSTEPS as usize,
        warm_up_substeps: WARM_UP * SUBSTEPS as usize,
        particle_blocks,
        filled_lanes: settings.particles as f64 / lanes as f64,
        machine: Machine {
            vector_bits: machine::vector_bits(),
            fma_gflops: Timing::of(blocks.fma_rates.clone()).median_ns,
            fma_gflops_max: blocks.fma_rates.iter().copied().fold(0.0, f64::max),
            read_gb_per_s,
            waiting_share: blocks
                .waited
                .map(|[waited, all]| waited as f64 / (all.max(1) as f64 * settings.threads as f64)),
        },
        stages: stages(&blocks),
        whole: whole(&blocks, part),
        memory: Memory {
            peak_bytes,
            forward_peak_bytes,
            state_bytes_per_particle: (PARTICLE_SCALARS as f64 * scalar_bytes + 8.0) * lanes as f64
                / settings.particles as f64,
            traffic_bytes_per_particle: traffic,
            traffic_ns: traffic / read_gb_per_s,
        },
    })
}

fn check_memory(settings: &Settings, part: usize) -> Result<(), BenchError> {
    let Some(free) = settings.memory_bytes.or_else(machine::free_bytes) else { return Ok(()) };
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
    let (began, waited_before) = (Instant::now(), machine::waited_ns());
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
            blocks.take_gradient(&taken, part, particles);
            let laps = bench.material();
            blocks.take_stages(&laps, &[Pass::Material], particles);
        }
        let taken = bench.forward(part, &mut |d, t| told(4 * width, 5 * width, d, t))?;
        blocks.take_forward(&taken, particles);
        done += part;
    }
    let waited = machine::waited_ns().zip(waited_before).map(|(after, before)| after.saturating_sub(before));
    blocks.waited = waited.map(|waited| [waited, began.elapsed().as_nanos() as u64]);
    Ok(blocks)
}

fn stages(blocks: &Blocks) -> Vec<StageReport> {
    let all = ENTRIES.iter().zip(&blocks.stages).filter(|(_, times)| !times.is_empty());
    all.map(|((_, _, part, name), times)| StageReport { part, name, time: Timing::of(times.clone()) })
        .collect()
}

fn whole(blocks: &Blocks, part: usize) -> Vec<WholeReport> {
    let substeps = part * SUBSTEPS as usize;
    let forward = WholeReport {
        name: "forward",
        time: Timing::of(blocks.forward.clone()),
        substeps,
        advances: 1.0,
        kept_states: 0,
    };
    let [advanced, of] = blocks.advanced;
    let gradient = (of > 0).then(|| WholeReport {
        name: "forward and gradient",
        time: Timing::of(blocks.gradient.clone()),
        substeps,
        advances: advanced as f64 / of as f64,
        kept_states: fewest_states(substeps as u64, PASSES),
    });
    [forward].into_iter().chain(gradient).collect()
}
