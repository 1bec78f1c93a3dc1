//! `optimise refine`: a plan corrected until what it brings on smaller cells is what is wanted.

use super::{
    CliError, Context, Progress, Resources,
    motion::{Motion, MotionArgs, Task},
    next,
    run::{Teller, watched},
};
use crate::{
    refine::{Corrected, Grid, Look},
    report::{
        amounts::Amounts,
        finding::Outcome,
        folder::{PLAN, RunFolder, SCENE},
        looks::Seen,
        plan::{PlanParts, on_finer},
        record::RunRecord,
        summary::{arrival, cells},
        words::parameter,
    },
    run::Grids,
};
use clap::Args;
use powderline_shared::plan::{Mounting, PlanHeader, SkillParameter};
use powderline_simulator::{
    PHYSICS_VERSION,
    arm::arm_motion,
    rollout::{Displacement, Workload},
    scene::{
        Scene,
        figures::{about, mass},
    },
    skill::{QuantisedControls, SkillMap, Splines, Theta},
};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Arguments of `optimise refine`.
#[derive(Clone, Debug, Args)]
pub(super) struct RefineArgs {
    /// The plan
    #[arg(value_name = "PLAN")]
    pub plan: PathBuf,
    /// By how much smaller the cells are: 2 is half the size, and a rollout takes about 16 times as long
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(2..=4))]
    pub by: u32,
    /// Threads and memory.
    #[command(flatten)]
    pub resources: Resources,
    /// Folder for the corrected plan, and for what was simulated: one that was stopped goes on from there [default: `refined` beside the
    /// plan]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// What was simulated so far, in the folder.
const LOOKS: &str = "looks.json";

#[derive(Serialize, Deserialize)]
struct Looks {
    #[serde(flatten)]
    of: Subject,
    looks: Vec<Seen>,
}

/// What the looks are of: those of something else are not gone on with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Subject {
    plan: String,
    by: u32,
    physics: u32,
}

impl Subject {
    /// What another one is not of: the field, what this has and what that has.
    fn other_than(&self, that: &Self) -> Option<(&'static str, [String; 2])> {
        let fields = [
            ("plan", [self.plan.clone(), that.plan.clone()]),
            ("--by", [self.by, that.by].map(|by| by.to_string())),
            ("physics", [self.physics, that.physics].map(|physics| physics.to_string())),
        ];
        fields.into_iter().find(|(_, [a, b])| a != b)
    }
}

/// What is said.
#[derive(Serialize)]
struct Report {
    folder: PathBuf,
    plan: PathBuf,
    /// Whether the finer grid brings what is wanted; null where as much as can be had is.
    met: Option<bool>,
    cell_m: f64,
    finer_cell_m: f64,
    amounts: Amounts,
    finer_amounts: Amounts,
    /// As it came, and each correction of it, on the smaller cells.
    tried: Vec<Line>,
    best: usize,
    /// As it came, and the best, on the scene's own cells.
    own: [Outcome; 2],
    rollouts: [usize; 2],
    cpu_seconds: f64,
}

/// One skill on the smaller cells.
#[derive(Serialize)]
struct Line {
    theta: Theta,
    #[serde(flatten)]
    outcome: Outcome,
}

/// Runs the command.
///
/// # Errors
/// One sentence; what was simulated before is saved.
pub(super) fn execute(arguments: &RefineArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let task = MotionArgs {
        scene: None,
        theta: None,
        plan: Some(arguments.plan.clone()),
        executed: None,
        seed: None,
        precision: None,
        resources: arguments.resources,
    }
    .task()?;
    let Motion::Plan { header, content_hash, controls } = &task.motion else {
        unreachable!("a plan was given")
    };
    let finer = task.scene.refined(arguments.by)?;
    task.setup.check_memory(&finer, Workload::Single, 0)?;
    let splines = splines_of(&arguments.plan, &task, header, controls)?;
    let of = Subject { plan: format!("{content_hash:016x}"), by: arguments.by, physics: PHYSICS_VERSION };
    let out = match &arguments.out {
        Some(out) => out.clone(),
        None => arguments.plan.with_file_name("refined"),
    };
    let folder = RunFolder::take(&out)?;
    let mut looks = begun(of, &folder)?;
    let scenes = [task.scene.clone(), finer];
    let progress = Progress::new(&context.err, context.live);
    let found = {
        let simulators = watched(context, &task.setup, &progress);
        let teller = Teller { progress: &progress, interrupt: &context.interrupt, on_epoch: &|_| {} };
        let mut grids = Grids::new(scenes.clone(), splines.clone(), looks.looks.clone(), &simulators);
        grids.corrected(&Theta::new(header.theta)?, &teller, &mut |seen| {
            looks.looks = seen.to_vec();
            let text = serde_json::to_vec(&looks).map_err(std::io::Error::from)?;
            Ok(folder.replace(LOOKS, &text)?)
        })
    };
    progress.clear();
    let found = found.map_err(|error| {
        error.with_remark("what was simulated is saved, and the same command goes on from there")
    })?;
    let refined = Refined { folder: &folder, scenes: &scenes, map: SkillMap::new(&task.scene), splines };
    refined.write_plan(&found, header)?;
    let report = refined.report(&found, &looks.looks);
    if arguments.json {
        context.json(&report)?;
    } else {
        write!(context.out, "{}", report.text(&refined.map))?;
        write!(context.out, "{}", next::play(&report.plan))?;
    }
    report.shortfall().map_or(Ok(()), |shortfall| Err(CliError::Missed(shortfall)))
}

/// What is added to the skill's motion; as the run has it beside which the plan lies.
fn splines_of(
    path: &Path,
    task: &Task,
    header: &PlanHeader,
    controls: &[Displacement],
) -> Result<Option<Splines>, CliError> {
    let (map, theta) = (SkillMap::new(&task.scene), Theta::new(header.theta)?);
    let is_it = |splines: Option<&Splines>| {
        let made = map.motion(&theta, splines).and_then(|controls| QuantisedControls::new(&controls));
        made.is_ok_and(|made| made.controls == controls)
    };
    if is_it(None) {
        return Ok(None);
    }
    let run = path.parent().and_then(|folder| RunRecord::read(folder).ok());
    let added = run.iter().flat_map(|run| &run.epochs).filter_map(|epoch| epoch.record.splines.as_ref());
    match added.into_iter().find(|splines| is_it(Some(splines))) {
        Some(splines) => Ok(Some(splines.clone())),
        None => Err(CliError::Input(format!(
            "{}: its motion is not its skill's own, and the run that found it is not beside it, so it cannot be changed; `{}` says \
             what it brings on smaller cells",
            path.display(),
            next::optimise(&["simulate", "--plan", &path.to_string_lossy(), "--refine", "2"])
        ))),
    }
}

/// What the folder has of the same.
fn begun(of: Subject, folder: &RunFolder) -> Result<Looks, CliError> {
    let file = folder.file(LOOKS);
    if !file.exists() {
        if folder.file(PLAN).exists() {
            return Err(CliError::Input(format!(
                "{} holds a plan of something else; another --out would be right",
                folder.path().display()
            )));
        }
        return Ok(Looks { of, looks: Vec::new() });
    }
    let name = file.display();
    let looks: Looks = serde_json::from_slice(&folder.read(LOOKS)?)
        .map_err(|error| CliError::Input(format!("{name} is nothing to go on from: {error}")))?;
    if let Some((field, [found, asked])) = looks.of.other_than(&of) {
        return Err(CliError::Input(format!(
            "{name} was begun with {field} {found}, and {asked} is asked for; another --out would be right"
        )));
    }
    Ok(looks)
}

/// What came of it, in its folder.
struct Refined<'a> {
    folder: &'a RunFolder,
    /// The scene, and its finer copy.
    scenes: &'a [Scene; 2],
    map: SkillMap,
    splines: Option<Splines>,
}

impl Refined<'_> {
    /// The best of what was tried.
    fn write_plan(&self, found: &Corrected, header: &PlanHeader) -> Result<(), CliError> {
        let (own, finer) = (&found.own[1], found.best());
        let [scene, fine] = self.scenes;
        let unfit = |error: String| CliError::Failed(format!("no plan can be made: {error}"));
        let quantised = QuantisedControls::new(&self.map.motion(&own.theta, self.splines.as_ref())?)?;
        let arm = arm_motion(scene, &self.map, &quantised).map_err(|refusal| unfit(refusal.to_string()))?;
        let parts = PlanParts {
            scene,
            map: &self.map,
            seed: header.seed,
            precision: header.precision,
            theta: &own.theta,
            path_coefficients: self.splines.as_ref().map_or(0, |added| added.coefficients.len()),
            quantised: &quantised,
            evaluation: &own.evaluation,
            finer: Some(on_finer(fine, &finer.evaluation)),
            arm: arm.as_ref().map(|arm| Mounting::from(&arm.model)),
        };
        let plan = parts.to_bytes().map_err(|error| unfit(error.to_string()))?;
        self.folder.replace(SCENE, scene.to_toml().as_bytes())?;
        Ok(self.folder.replace(PLAN, &plan)?)
    }

    fn report(&self, found: &Corrected, seen: &[Seen]) -> Report {
        let [scene, fine] = self.scenes;
        let [amounts, of_fine] = [scene, fine].map(Amounts::from);
        let line = |look: &Look| Line {
            theta: look.theta,
            outcome: Outcome::of_evaluation(&of_fine, &look.evaluation),
        };
        let simulated = |grid| {
            let is_it = |seen: &&Seen| seen.grid == grid && seen.obstacle.is_none();
            seen.iter().filter(is_it).count()
        };
        Report {
            folder: self.folder.path().into(),
            plan: self.folder.file(PLAN),
            met: of_fine.is_met(found.best().evaluation.census.target),
            cell_m: scene.domain.cell_m,
            finer_cell_m: fine.domain.cell_m,
            amounts,
            finer_amounts: of_fine,
            tried: found.tried.iter().map(line).collect(),
            best: found.best,
            own: found.own.map(|look| Outcome::of_evaluation(&amounts, &look.evaluation)),
            rollouts: [Grid::Own, Grid::Finer].map(simulated),
            cpu_seconds: seen.iter().map(|seen| seen.cpu_seconds).sum(),
        }
    }
}

impl Report {
    /// Such as `18 % too little`.
    fn off(&self, line: &Line) -> String {
        self.finer_amounts.off(line.outcome.census.target)
    }

    fn text(&self, map: &SkillMap) -> String {
        let Self { tried, best, .. } = self;
        let (first, line) = (&tried[0], &tried[*best]);
        let mut text = format!(
            "On {} the plan brings {}; on the scene's own of {} mm it brings {}.\n",
            cells(self.finer_cell_m),
            arrival(&self.finer_amounts, &line.outcome),
            about(1e3 * self.cell_m, 3),
            mass(self.own[1].mass_kg),
        );
        text += &match best {
            0 => "It is the plan as it came".to_owned(),
            _ => format!(
                "As it came, it brought {} ({}) and {}",
                mass(first.outcome.mass_kg),
                self.off(first),
                mass(self.own[0].mass_kg)
            ),
        };
        text += &format!(
            ". Simulated: {} motions on the scene's own cells, {} on the smaller ones, {:.0} s of processor time.\n",
            self.rollouts[0], self.rollouts[1], self.cpu_seconds
        );
        let [from, to] = [first, line].map(|line| map.parameters(&line.theta));
        for which in SkillParameter::ALL {
            let [from, to] = [from, to].map(|values| parameter(which, values[which.index()]));
            if from != to {
                text += &format!("{}: {from} before, {to} now.\n", which.name());
            }
        }
        text
    }

    fn shortfall(&self) -> Option<String> {
        (self.met == Some(false)).then(|| {
            format!(
                "on {} the plan brings {}, and the tolerance is {}",
                cells(self.finer_cell_m),
                self.off(&self.tried[self.best]),
                self.amounts.tolerance()
            )
        })
    }
}
