//! How much memory simulations need, how much they may have, and how much the process holds.
//!
//! A gradient keeps checkpoints, states at the beginning of substeps, and recomputes what else the adjoint needs from them
//! (see `rollout/schedule.rs`). With `c` states and at most `r` passes over any substep, `binomial(c + r, c)`
//! substeps can be reversed. So the least that a scene needs is estimated before anything is computed, and generously;
//! whatever a budget has beyond that goes into states, for as long as the operating system's count of the process leaves
//! room.

use std::fs::{self, File};
use std::path::Path;

use crate::mpm::particles::LANES;
use crate::mpm::spare::{Size, state_bytes};
use crate::mpm::substep::vectors_on_grid;
use crate::real::Real;
use crate::scene::{BLOCK_CELLS, Scene, VolumeCorrection};
use powderline_shared::plan::Precision;

/// Numbers in a particle's state: position 3, velocity 3, affine velocity 9, elastic strain 6, volume correction 1.
pub(crate) const PARTICLE_SCALARS: u64 = 22;

/// The running program without any simulation: its text, its fonts, its figures, what the allocator holds; bytes, generously.
const PROCESS_BYTES: u64 = 16 << 20;

/// Stack of a thread and what the allocator holds for it, bytes. A simulator has each thread twice: for one rollout, and for
/// several side by side.
const THREAD_BYTES: u64 = 128 << 10;

/// States that a rollout holds at a time: the settled one, the one it begins at and the one at work; what is on the grid and what
/// sleeps as much as two more.
const MOTION_STATES: u64 = 5;

/// What a gradient holds beside these and the checkpoints: the final state, two sets of cotangents, scratch.
const ADJOINT_STATES: u64 = 4;

/// States of rollouts side by side at a time: the most differences that are taken at once, and those at work.
pub(crate) const BRANCHES: u64 = 16;

/// Passes over a substep for which the need is estimated.
pub(crate) const PASSES: [u32; 4] = [1, 2, 3, 4];

/// What is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Workload {
    /// One motion at a time.
    Single,
    /// Several motions side by side.
    Batch,
    /// A gradient, and several motions side by side.
    Gradient,
}

impl Workload {
    /// In words.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Single => "a motion",
            Self::Batch => "several motions side by side",
            Self::Gradient => "a gradient",
        }
    }
}

/// Need when no substep is advanced more often than `passes` times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct MemoryEstimate {
    /// How often a substep is advanced, at most; the adjoint itself computes it once more.
    pub passes: u32,
    /// States kept at a time, the fewest possible.
    pub kept_states: u64,
    /// Peak memory, bytes: what to give to `--memory`.
    pub bytes: u64,
}

/// Sizes of what a scene's simulation holds, bytes.
struct Sizes {
    /// Whatever is simulated.
    fixed: u64,
    /// A state, with what is on its grid, when the powder has spread.
    state: u64,
}

impl Sizes {
    fn new(scene: &Scene, precision: Precision, threads: usize) -> Self {
        match precision {
            Precision::F32 => Self::of::<f32>(scene, threads),
            Precision::F64 => Self::of::<f64>(scene, threads),
        }
    }

    fn of<T: Real>(scene: &Scene, threads: usize) -> Self {
        // The motion with what its gradient needs for each control step, and the motions of the probes; the list of obstacles for
        // each block of the grid, and what they leave of its nodes' room; and each particle's place in the packing and at the end.
        const PER_CONTROL_STEP: u64 = 720 + 16 * 104;
        const PER_PARTICLE: u64 = 120;
        let rooms = scene.powder.volume_correction == VolumeCorrection::Grid;
        let per_block = 64 + if rooms { (BLOCK_CELLS.pow(3) * size_of::<T>()) as u64 } else { 0 };
        let blocks: u64 = scene.block_counts().iter().map(|count| *count as u64).product();
        let fixed = PROCESS_BYTES
            + 2 * THREAD_BYTES * threads as u64
            + PER_CONTROL_STEP * u64::from(scene.time.horizon_steps)
            + per_block * blocks
            + PER_PARTICLE * scene.particle_count() as u64;
        // A fifth for lanes that hold no particle.
        let groups = scene.particle_count().div_ceil(LANES) * 6 / 5;
        // Identity and origin of each particle.
        let besides = (2 * groups * LANES * size_of::<u32>()) as u64;
        let vectors = vectors_on_grid(scene.powder.transfer.is_some());
        let size = Size { groups, nodes: 2 * node_blocks(scene), vectors, besides };
        Self { fixed, state: state_bytes::<T>(size) }
    }

    /// For a gradient with so many kept states. Rollouts side by side take theirs from these.
    fn of_gradient(&self, kept_states: u64) -> u64 {
        self.with(MOTION_STATES + ADJOINT_STATES + kept_states.max(BRANCHES))
    }

    fn with(&self, states: u64) -> u64 {
        let bytes = self.fixed + states * self.state;
        // So much that the slack can be left free.
        (bytes + LEAST_SLACK_BYTES) * SLACK_SHARE / (SLACK_SHARE - 1) + 1
    }
}

/// Blocks of nodes that powder in one heap reaches, wherever the heap lies on the grid; it spreads over up to twice as many.
fn node_blocks(scene: &Scene) -> usize {
    let cells = scene.particle_count() as f64 / f64::from(scene.powder.particles_per_cell);
    let edge = (cells / BLOCK_CELLS.pow(3) as f64).cbrt() + 1.0;
    (edge + 2.0).powi(3).ceil() as usize
}

/// Estimates the need of a gradient for 1 to 4 passes over each substep, with so many threads.
pub fn estimate_memory(scene: &Scene, precision: Precision, threads: usize) -> [MemoryEstimate; 4] {
    let sizes = Sizes::new(scene, precision, threads);
    PASSES.map(|passes| {
        let kept_states = min_checkpoints(substeps(scene), passes);
        MemoryEstimate { passes, kept_states, bytes: sizes.of_gradient(kept_states) }
    })
}

/// The least budget for some work, bytes. With less, a gradient would take many times as long.
pub(crate) fn least_memory(scene: &Scene, precision: Precision, threads: usize, work: Workload) -> u64 {
    let sizes = Sizes::new(scene, precision, threads);
    match work {
        Workload::Single => sizes.with(MOTION_STATES),
        Workload::Batch => sizes.with(MOTION_STATES + BRANCHES),
        Workload::Gradient => sizes.of_gradient(default_min_checkpoints(substeps(scene) as usize) as u64),
    }
}

fn substeps(scene: &Scene) -> u64 {
    u64::from(scene.time.horizon_steps) * u64::from(scene.time.substeps)
}

/// The fewest states that a gradient over so many substeps keeps, whatever memory there is.
pub(crate) fn default_min_checkpoints(steps: usize) -> usize {
    min_checkpoints(steps as u64, PASSES[PASSES.len() - 1]) as usize
}

/// Smallest `c` with `binomial(c + passes, passes) >= steps`.
pub(crate) fn min_checkpoints(steps: u64, passes: u32) -> u64 {
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

/// What is left free of a budget, for what is small and not counted one by one: some bytes, a share, and what the allocator
/// keeps for each thread.
const LEAST_SLACK_BYTES: u64 = 6 << 20;
const SLACK_SHARE: u64 = 32;
const THREAD_SLACK_BYTES: u64 = 256 << 10;

/// What a process may hold, and does.
pub(crate) struct Budget {
    bytes: u64,
    threads: usize,
    /// What a gradient needs at least.
    least: u64,
    /// What it holds beside states that are kept, where the system does not tell.
    standing: u64,
    resident: Resident,
}

impl Budget {
    /// Of a process that may hold so many bytes and simulates a scene.
    pub(crate) fn new<T: Real>(bytes: u64, scene: &Scene, threads: usize) -> Self {
        let sizes = Sizes::of::<T>(scene, threads);
        let least = sizes.of_gradient(default_min_checkpoints(substeps(scene) as usize) as u64);
        let standing = sizes.fixed + (MOTION_STATES + ADJOINT_STATES) * sizes.state;
        Self { bytes, threads, least, standing, resident: Resident::new() }
    }

    /// Bytes that the process may take more than it has, if states hold `in_states`.
    pub(crate) fn left(&self, in_states: u64) -> u64 {
        let held = self.resident.bytes().unwrap_or(self.standing + in_states);
        self.limit().saturating_sub(held)
    }

    fn limit(&self) -> u64 {
        let slack = LEAST_SLACK_BYTES + self.bytes / SLACK_SHARE + THREAD_SLACK_BYTES * self.threads as u64;
        self.bytes.saturating_sub(slack)
    }

    /// Bytes that workers may take to follow several motions side by side.
    pub(crate) fn for_workers(&self) -> u64 {
        self.bytes.saturating_sub(self.least) / 4
    }
}

/// What the operating system counts of this process.
pub(crate) struct Resident {
    /// Stays open: this is asked as often as states are kept.
    file: Option<File>,
    page_bytes: u64,
}

impl Resident {
    #[cfg(target_os = "linux")]
    pub(crate) fn new() -> Self {
        let file = File::open("/proc/self/statm").ok();
        Self { file, page_bytes: rustix::param::page_size() as u64 }
    }

    #[cfg(not(target_os = "linux"))]
    pub(crate) fn new() -> Self {
        Self { file: None, page_bytes: 0 }
    }

    /// Bytes of main memory that the process holds; none where the system does not tell.
    pub(crate) fn bytes(&self) -> Option<u64> {
        use std::io::{Read, Seek};
        let mut file = self.file.as_ref()?;
        let mut text = [0; 128];
        file.rewind().ok()?;
        let length = file.read(&mut text).ok()?;
        // The size in pages, and how many of them are in main memory.
        let pages = std::str::from_utf8(&text[..length]).ok()?.split(' ').nth(1)?;
        Some(pages.parse::<u64>().ok()? * self.page_bytes)
    }
}

/// Memory that this process can hold without taking any from others, bytes: what it holds, and what the machine has available
/// or a container's limit leaves. None where the system does not tell.
pub fn available_bytes() -> Option<u64> {
    let machine = kibibytes("/proc/meminfo", "MemAvailable:")?;
    let left = left_of_limits().map_or(machine, |left| left.min(machine));
    Some(left + Resident::new().bytes()?)
}

/// A line of a file of `/proc` that gives a size in `kB`, as bytes.
pub(crate) fn kibibytes(file: &str, name: &str) -> Option<u64> {
    let text = fs::read_to_string(file).ok()?;
    let size = text.lines().find_map(|line| line.strip_prefix(name))?;
    Some(size.trim().strip_suffix(" kB")?.parse::<u64>().ok()? << 10)
}

/// What is left of the limits of the control groups that this process is in, of either version.
fn left_of_limits() -> Option<u64> {
    let groups = fs::read_to_string("/proc/self/cgroup").ok()?;
    let left = |line: &str| {
        let (_, group) = line.split_once(':')?;
        let (root, path, files) = match group.split_once(':')? {
            ("", path) => ("/sys/fs/cgroup", path, ["memory.max", "memory.current", "inactive_file"]),
            ("memory", path) => (
                "/sys/fs/cgroup/memory",
                path,
                ["memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"],
            ),
            _ => return None,
        };
        let group = Path::new(root).join(path.trim_start_matches('/'));
        let groups = group.ancestors().take_while(|folder| folder.starts_with(root));
        groups.filter_map(|folder| left_of_limit(folder, files)).min()
    };
    groups.lines().filter_map(left).min()
}

/// What is left of a control group's limit, if it has one. Files that the system keeps in memory while there is room do not count.
fn left_of_limit(folder: &Path, [limit, usage, cached]: [&str; 3]) -> Option<u64> {
    let read = |file: &str| fs::read_to_string(folder.join(file)).ok();
    let number = |file: &str| read(file)?.trim().parse::<u64>().ok();
    let cached = read("memory.stat")
        .and_then(|text| text.lines().find_map(|line| line.strip_prefix(cached)?.trim().parse::<u64>().ok()));
    Some(number(limit)?.saturating_sub(number(usage)?.saturating_sub(cached.unwrap_or(0))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mpm::spare::fit;

    #[test]
    fn memory_that_is_taken_counts() {
        let resident = Resident::new();
        let before = resident.bytes().expect("Linux tells");
        let mut vector = Vec::new();
        fit(&mut vector, 32 << 20, 1u8);
        let after = resident.bytes().expect("Linux tells");
        assert_eq!(vector[vector.len() - 1], 1);
        assert!(after > before + (16 << 20), "{before} {after}");
    }

    #[test]
    fn fewer_states_cost_more_passes() {
        let needs = estimate_memory(&Scene::load("bench").unwrap(), Precision::F32, 2);
        let kept = needs.map(|need| need.kept_states);
        assert_eq!(kept, [9_999, 140, 38, 20]);
        assert!(needs.is_sorted_by(|a, b| a.bytes > b.bytes));
    }

    #[test]
    fn more_work_and_more_threads_need_more() {
        let scene = Scene::load("bench").unwrap();
        let least = |threads, work| least_memory(&scene, Precision::F32, threads, work);
        assert!(least(2, Workload::Single) < least(2, Workload::Batch));
        assert!(least(2, Workload::Batch) < least(2, Workload::Gradient));
        assert!(least(64, Workload::Gradient) > least(2, Workload::Gradient) + 62 * 2 * THREAD_BYTES);
        assert_eq!(least(2, Workload::Gradient), estimate_memory(&scene, Precision::F32, 2)[3].bytes);
    }

    #[test]
    fn a_limit_leaves_what_is_not_used_and_not_cached() {
        let folder = tempfile::tempdir().unwrap();
        let files = ["memory.max", "memory.current", "inactive_file"];
        let write = |file: &str, text: &str| fs::write(folder.path().join(file), text).unwrap();
        assert_eq!(left_of_limit(folder.path(), files), None);
        write("memory.max", "1000\n");
        write("memory.current", "700\n");
        assert_eq!(left_of_limit(folder.path(), files), Some(300));
        write("memory.stat", "anon 300\ninactive_file 400\nactive_file 5\n");
        assert_eq!(left_of_limit(folder.path(), files), Some(700));
        write("memory.max", "max\n");
        assert_eq!(left_of_limit(folder.path(), files), None);
        assert!(available_bytes().is_some_and(|bytes| bytes > 1 << 20));
    }

    #[test]
    fn fewest_states_reach_just_far_enough() {
        assert_eq!(min_checkpoints(1, 1), 1);
        assert_eq!(min_checkpoints(560, 3), 13);
        assert_eq!(min_checkpoints(561, 3), 14);
    }
}
