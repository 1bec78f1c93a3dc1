//! `optimise refine`: a plan corrected until what it brings on smaller cells is what is wanted.

use super::{
    CliError, Context, Progress, Resources, Setup,
    kept::{Kept, that_goes_on},
    motion::{Motion, MotionArgs, Task},
    next,
    run::{Teller, watched},
};
use crate::{
    refine::{Corrected, Grid, Look},
    report::{
        amounts::Amounts,
        finding::Outcome,
        folder::{PLAN, RunFolder, SCENE, STATE},
        looks::Seen,
        plan::{PlanParts, on_finer},
        record::RunRecord,
        summary::{arrival, cells},
        words::{hex, parameter},
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
        figures::{about, count, mass},
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
pub(super) const LOOKS: &str = "looks.json";

/// What is said.
#[derive(Serialize)]
pub(super) struct Report {
    folder: PathBuf,
    pub(super) plan: PathBuf,
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
    let task = MotionArgs::of_plan(&arguments.plan, arguments.resources).task()?;
    let plan = PlanToChange::of(&arguments.plan, &task)?;
    let finer = task.scene.refined(arguments.by)?;
    task.setup.check_memory(&finer, Workload::Single, 0)?;
    let folder =
        RunFolder::take(&arguments.out.clone().unwrap_or_else(|| arguments.plan.with_file_name("refined")))?;
    let looks = Kept::begun(&folder, LOOKS, plan.subject(&task.scene, arguments.by))?;
    let grids = [task.scene.clone(), finer];
    let (report, map) = plan.corrected(grids, &task.setup, &folder, looks, context)?;
    if arguments.json {
        context.json(&report)?;
    } else {
        write!(context.out, "{}", report.text(&map, "As it came, it brought"))?;
        write!(context.out, "{}", next::play(&report.plan))?;
    }
    report.shortfall().map_or(Ok(()), |shortfall| Err(CliError::Missed(shortfall)))
}

/// What the looks are of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Subject {
    plan: String,
    #[serde(rename = "--by")]
    by: u32,
    /// Digest of the scene whose plan it becomes.
    scene: String,
    physics: u32,
}

/// A plan whose skill is to be changed.
pub(super) struct PlanToChange {
    /// Its content's hash.
    pub(super) name: String,
    header: PlanHeader,
    pub(super) theta: Theta,
    pub(super) splines: Option<Splines>,
}

impl PlanToChange {
    /// The plan of a task.
    ///
    /// # Errors
    /// Nobody knows what is added to its skill's motion.
    pub(super) fn of(path: &Path, task: &Task) -> Result<Self, CliError> {
        let Motion::Plan { header, content_hash, controls } = &task.motion else {
            unreachable!("a plan was given")
        };
        Ok(Self {
            name: format!("{content_hash:016x}"),
            header: **header,
            theta: Theta::new(header.theta)?,
            splines: splines_of(path, task, header, controls)?,
        })
    }

    /// By how much smaller the cells are on which it was looked at; 1 if it was not.
    pub(super) fn looked_at_by(&self, scene: &Scene) -> u32 {
        self.header.finer.map_or(1, |finer| (scene.domain.cell_m / finer.cell_m).round() as u32)
    }

    /// What looks at its skill in a scene, on cells so much smaller, are of.
    pub(super) fn subject(&self, scene: &Scene, by: u32) -> Subject {
        let digest = scene.digest();
        Subject { plan: self.name.clone(), by, scene: hex(&digest[..8]), physics: PHYSICS_VERSION }
    }

    /// What it brings, where the most is known of it.
    pub(super) fn outcome(&self, scene: &Scene) -> Outcome {
        Outcome::finest_of_plan(&Amounts::from(scene), &self.header).1
    }

    /// Corrects its skill until the second grid brings what is wanted, and writes the plan, which is one of the first grid's scene.
    ///
    /// # Errors
    /// One sentence; what was simulated before is saved.
    pub(super) fn corrected(
        &self,
        scenes: [Scene; 2],
        setup: &Setup,
        folder: &RunFolder,
        mut looks: Kept<Subject, Seen>,
        context: &mut Context<'_>,
    ) -> Result<(Report, SkillMap), CliError> {
        let progress = Progress::new(&context.err, context.live);
        let found = {
            let simulators = watched(context, setup, &progress);
            let teller = Teller { progress: &progress, interrupt: &context.interrupt, on_epoch: &|_| {} };
            let mut grids =
                Grids::new(scenes.clone(), self.splines.clone(), looks.looks.clone(), &simulators);
            grids.corrected(&self.theta, &teller, &mut |seen| {
                looks.looks = seen.to_vec();
                looks.keep(folder, LOOKS)
            })
        };
        progress.clear();
        let found = found.map_err(that_goes_on)?;
        let map = SkillMap::new(&scenes[0]);
        let refined = Refined { folder, scenes: &scenes, map: &map, splines: self.splines.as_ref() };
        refined.write_plan(&found, &self.header)?;
        Ok((refined.report(&found, &looks.looks), map))
    }
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
    let folder = path.parent().filter(|folder| folder.join(STATE).exists());
    let run = folder.map(RunRecord::read).transpose().map_err(|error| {
        CliError::from(error).with_remark(&format!(
            "{} is of that run, and its motion, which is not its skill's own, cannot be changed without",
            path.display()
        ))
    })?;
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

/// What came of it, in its folder.
struct Refined<'a> {
    folder: &'a RunFolder,
    /// The scene, and its finer copy.
    scenes: &'a [Scene; 2],
    map: &'a SkillMap,
    splines: Option<&'a Splines>,
}

impl Refined<'_> {
    /// Whether the second grid is one.
    fn is_finer(&self) -> bool {
        self.scenes[1].domain.cell_m < self.scenes[0].domain.cell_m
    }

    /// The best of what was tried.
    fn write_plan(&self, found: &Corrected, header: &PlanHeader) -> Result<(), CliError> {
        let (own, finer) = (&found.own[1], found.best());
        let [scene, fine] = self.scenes;
        let unfit = |error: String| CliError::Failed(format!("no plan can be made: {error}"));
        let quantised = QuantisedControls::new(&self.map.motion(&own.theta, self.splines)?)?;
        let arm = arm_motion(scene, self.map, &quantised).map_err(|refusal| unfit(refusal.to_string()))?;
        let parts = PlanParts {
            scene,
            map: self.map,
            seed: header.seed,
            precision: header.precision,
            theta: &own.theta,
            path_coefficients: self.splines.map_or(0, |added| added.coefficients.len()),
            quantised: &quantised,
            evaluation: &own.evaluation,
            finer: self.is_finer().then(|| on_finer(fine, &finer.evaluation)),
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

    /// What the plan brings, where the most is known of it.
    pub(super) fn outcome(&self) -> &Outcome {
        &self.tried[self.best].outcome
    }

    /// The skill that the plan has now.
    pub(super) fn theta(&self) -> Theta {
        self.tried[self.best].theta
    }

    fn is_finer(&self) -> bool {
        self.finer_cell_m < self.cell_m
    }

    /// `came` begins the sentence that says what the skill brought before it was changed.
    pub(super) fn text(&self, map: &SkillMap, came: &str) -> String {
        let Self { tried, best, .. } = self;
        let (first, line) = (&tried[0], &tried[*best]);
        let arrives = arrival(&self.finer_amounts, &line.outcome);
        let mut text = match self.is_finer() {
            true => format!(
                "On {} the plan brings {arrives}; on the scene's own of {} mm it brings {}.\n",
                cells(self.finer_cell_m),
                about(1e3 * self.cell_m, 3),
                mass(self.own[1].mass_kg),
            ),
            false => format!("The plan brings {arrives}.\n"),
        };
        let on_own =
            if self.is_finer() { format!(" and {}", mass(self.own[0].mass_kg)) } else { String::new() };
        text += &match best {
            0 => "The skill is as it came".to_owned(),
            _ => format!("{came} {} ({}){on_own}", mass(first.outcome.mass_kg), self.off(first)),
        };
        text += &format!(
            ". Simulated: {}, {:.0} s of processor time.\n",
            motions(self.rollouts, self.is_finer()),
            self.cpu_seconds
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

    pub(super) fn shortfall(&self) -> Option<String> {
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

/// Such as `12 motions on the scene's own cells, 2 motions on the smaller ones`.
fn motions(rollouts: [usize; 2], is_finer: bool) -> String {
    let [own, there] = rollouts.map(|motions| count(motions as i64, "motion"));
    match is_finer {
        true => format!("{own} on the scene's own cells, {there} on the smaller ones"),
        false => count((rollouts[0] + rollouts[1]) as i64, "motion"),
    }
}
