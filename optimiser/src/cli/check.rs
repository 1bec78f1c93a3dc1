//! `optimise check`: resolves and validates a scene and says what it will cost.

use std::fmt;
use std::io::Write;

use clap::Args;
use serde::Serialize;

use super::{
    CliError,
    arm_words::{ArmUse, clearance_words},
};
use crate::report::{
    amounts::{Amounts, percent},
    words::{grouped, hex},
};
use powderline_shared::plan::Precision;
use powderline_simulator::arm::Ability;
use powderline_simulator::memory::{MemoryEstimate, estimate_memory};
use powderline_simulator::scene::figures::{about, mass};
use powderline_simulator::scene::{Capacity, DEFAULT_SCENE, MAX_CFL, Scene};
use powderline_simulator::skill::{SkillMap, check_passable, colliding_skill};

/// Arguments of `optimise check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// Name of an embedded scene (bench, bench-small, bench-fine, vial, workcell) or path of a scene file.
    #[arg(default_value = DEFAULT_SCENE)]
    pub scene: String,
    /// Prints one JSON object instead of text.
    #[arg(long)]
    pub json: bool,
}

/// What `optimise check` reports.
#[derive(Debug, Serialize)]
pub struct CheckReport {
    /// The scene's name.
    pub scene: String,
    /// Digest of the resolved scene, hexadecimal.
    pub digest: String,
    /// Particles.
    pub particles: usize,
    /// What is wanted in the target container, in kilogram and in particles, and how near is near enough.
    pub amounts: Amounts,
    /// What the tool carries at most.
    pub tool_capacity: Capacity,
    /// Why no motion within the bounds can bring the wanted amount, and what would be right; nothing if nothing stands against it.
    pub infeasible: Option<String>,
    /// Why `optimise run` would refuse it for its motion limits; nothing if it would not.
    pub refused: Option<String>,
    /// Edge of a grid cell, metres.
    pub cell_m: f64,
    /// Cells along x, y, z, without padding.
    pub cells: [usize; 3],
    /// Blocks of 4 x 4 x 4 cells along x, y, z, with one block of padding at either end.
    pub blocks: [usize; 3],
    /// Courant number.
    pub cfl_number: f64,
    /// The highest Courant number that is accepted.
    pub max_cfl_number: f64,
    /// MPM substeps in one control step.
    pub substeps: u32,
    /// Length of an MPM substep, seconds.
    pub dt_sub_s: f64,
    /// Control steps in the whole motion.
    pub horizon_steps: u32,
    /// Length of the whole motion, seconds.
    pub horizon_s: f64,
    /// Settling time before the motion, seconds.
    pub settle_s: f64,
    /// Longest skill within the bounds, seconds.
    pub longest_skill_s: f64,
    /// Memory of a rollout with its gradient, bytes, per precision and checkpoint schedule.
    pub memory: Vec<MemoryRow>,
    /// What the scene's arm does to make the motion in the middle of all ranges; nothing without an arm, or where it cannot.
    arm: Option<ArmUse>,
    /// The same in words.
    arm_words: Option<String>,
    /// What is allowed but worth knowing.
    pub remarks: Vec<String>,
}

/// Memory need of one precision and number of kept states.
#[derive(Clone, Debug, Serialize)]
pub struct MemoryRow {
    /// `f32` or `f64`.
    pub precision: &'static str,
    /// States kept at a time.
    pub kept_states: u64,
    /// Peak memory, bytes.
    pub bytes: u64,
    /// How often each substep is computed forward, at most.
    pub forward_runs: u32,
}

/// Runs `optimise check`.
///
/// # Errors
/// A bad scene, or `out` refuses.
pub(super) fn run(args: &CheckArgs, out: &mut dyn Write) -> Result<(), CliError> {
    let scene = Scene::load(&args.scene)?;
    let report = CheckReport::new(&scene);
    if args.json {
        serde_json::to_writer(&mut *out, &report).map_err(std::io::Error::from)?;
        writeln!(out)?;
    } else {
        write!(out, "{report}")?;
    }
    let why: Vec<String> = report.infeasible.into_iter().chain(report.refused).collect();
    if why.is_empty() {
        Ok(())
    } else {
        Err(CliError::Input(format!("{}: {}", args.scene, why.join("; and "))))
    }
}

/// Why no skill of a valid scene can do what it wants, in one sentence.
pub(super) fn infeasible(scene: &Scene) -> Option<String> {
    infeasible_for(scene, Ability::of(scene).as_ref())
}

/// The same, whatever the powder is and however much of it is wanted: of tool, containers, skill and arm alone.
pub(super) fn immovable(scene: &Scene) -> Option<String> {
    immovable_for(scene, Ability::of(scene).as_ref())
}

fn infeasible_for(scene: &Scene, ability: Option<&Ability>) -> Option<String> {
    scene.check_feasible().err().map(|error| error.to_string()).or_else(|| immovable_for(scene, ability))
}

fn immovable_for(scene: &Scene, ability: Option<&Ability>) -> Option<String> {
    let blocked = || check_passable(scene).err().map(|error| error.to_string());
    let unable = || {
        let (label, refusal) = (
            scene.arm.as_ref()?.kind.label(),
            ability.filter(|ability| ability.none)?.middle.as_ref().err()?,
        );
        Some(format!(
            "the {label} of [arm] can make no motion of [skill], neither in the middle nor at the ends of its ranges: in the middle, \
             {refusal}"
        ))
    };
    blocked().or_else(unable)
}

impl CheckReport {
    /// Gathers the figures of a valid scene.
    pub fn new(scene: &Scene) -> Self {
        let ability = Ability::of(scene);
        let middle = ability.as_ref().and_then(|ability| ability.middle.as_ref().ok());
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            scene: scene.name.clone(),
            digest: hex(&scene.digest()),
            particles: scene.particle_count(),
            amounts: scene.into(),
            tool_capacity: scene.tool_capacity(),
            infeasible: infeasible_for(scene, ability.as_ref()),
            refused: SkillMap::new(scene).check_all_corners().err().map(|error| error.to_string()),
            cell_m: scene.domain.cell_m,
            cells: scene.cell_counts(),
            blocks: scene.block_counts(),
            cfl_number: scene.cfl_number(),
            max_cfl_number: MAX_CFL,
            substeps: scene.time.substeps,
            dt_sub_s: scene.time.substep_s(),
            horizon_steps: scene.time.horizon_steps,
            horizon_s: scene.time.horizon_s(),
            settle_s: scene.time.settle_s,
            longest_skill_s: scene.longest_skill_s(),
            memory: [(Precision::F32, "f32"), (Precision::F64, "f64")]
                .into_iter()
                .flat_map(|(precision, name)| {
                    estimate_memory(scene, precision, threads).map(|need| MemoryRow::new(name, need))
                })
                .collect(),
            arm: middle.map(ArmUse::from),
            arm_words: middle.map(|arm| {
                let (kind, posture) = (arm.model.kind.label(), arm.model.posture);
                format!("{kind} {posture}, in the middle of all ranges. {}", clearance_words(&arm.figures))
            }),
            remarks: remarks(scene, ability.as_ref()),
        }
    }
}

/// The scene's own remarks, and whether its skills stay clear of the containers and the arm can make them.
fn remarks(scene: &Scene, ability: Option<&Ability>) -> Vec<String> {
    let collision = colliding_skill(scene).map(|(theta, collision)| {
        format!("`optimise run` would pass over some skills of this range: with theta = {theta} {collision}")
    });
    let unable = ability.filter(|ability| !ability.none).and_then(|ability| ability.unable.as_ref());
    let unable = unable.map(|(theta, refusal)| {
        format!(
            "`optimise run` would pass over some skills of this range: with theta = {theta} the arm cannot make the motion: \
             {refusal}"
        )
    });
    let armless = scene.arm.is_none().then(|| {
        "the scene has no [arm], so that nobody looks whether an arm can make the motion and stays clear of the bench".into()
    });
    let grains = Amounts::from(scene).grains_too_large();
    scene.warnings().into_iter().chain(grains).chain(collision).chain(unable).chain(armless).collect()
}

impl MemoryRow {
    fn new(precision: &'static str, need: MemoryEstimate) -> Self {
        let MemoryEstimate { passes, kept_states, bytes, .. } = need;
        Self { precision, kept_states, bytes, forward_runs: passes + 1 }
    }
}

impl fmt::Display for CheckReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [cells_x, cells_y, cells_z] = self.cells;
        let [blocks_x, blocks_y, blocks_z] = self.blocks;
        let Self { amounts, tool_capacity, .. } = self;
        match (&self.infeasible, &self.refused) {
            (None, None) => writeln!(f, "{} is a valid scene.", self.scene)?,
            (Some(_), _) => {
                writeln!(f, "{} is a valid scene, but what it wants cannot be done.", self.scene)?
            }
            (None, Some(_)) => {
                writeln!(f, "{} is a valid scene, but not every skill is a motion.", self.scene)?
            }
        }
        writeln!(
            f,
            "wanted         {}, within {}; the tool carries about {} heaped, {} level",
            amounts.wanted(),
            amounts.tolerance.map_or("no tolerance: as much as can be had".into(), percent),
            mass(tool_capacity.heaped_kg),
            mass(tool_capacity.level_kg)
        )?;
        writeln!(
            f,
            "powder         {} in {} particles of {}",
            mass(self.particles as f64 * amounts.particle_mass_kg),
            grouped(self.particles as i64),
            mass(amounts.particle_mass_kg)
        )?;
        writeln!(
            f,
            "grid           {cells_x} x {cells_y} x {cells_z} cells of {} mm; with padding {blocks_x} x {blocks_y} x \
             {blocks_z} blocks of 4 x 4 x 4 cells",
            about(1e3 * self.cell_m, 4)
        )?;
        writeln!(
            f,
            "CFL number     {} (at most {}) with {} substeps of {} us",
            about(self.cfl_number, 3),
            self.max_cfl_number,
            self.substeps,
            about(1e6 * self.dt_sub_s, 4)
        )?;
        writeln!(
            f,
            "horizon        {} control steps, {} s, after {} s of settling",
            self.horizon_steps,
            about(self.horizon_s, 6),
            about(self.settle_s, 6)
        )?;
        writeln!(f, "longest skill  {} s", about(self.longest_skill_s, 3))?;
        if let Some(arm) = &self.arm_words {
            writeln!(f, "arm            {arm}")?;
        }
        writeln!(f, "memory for a rollout with its gradient (`--memory`), by the states kept:")?;
        self.memory.iter().try_for_each(|row| writeln!(f, "  {row}"))?;
        self.remarks.iter().try_for_each(|remark| writeln!(f, "Note: {remark}."))
    }
}

impl fmt::Display for MemoryRow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mebibytes = self.bytes as f64 / f64::from(1 << 20);
        let runs = self.forward_runs;
        let kept = self.kept_states;
        write!(f, "{}  {mebibytes:>9.0} MiB  {kept:>9} states kept, {runs} forward runs", self.precision)
    }
}
