//! `optimise shorten`: a plan's motion made faster, as long as no more powder is lost by that.

use super::{
    CliError, Context, Progress, Resources,
    kept::{GO_ON, Kept},
    motion::{MotionArgs, Task},
    next,
    refine::{self, PlanToChange},
    run::watched,
};
use crate::{
    able::obstacle,
    report::{
        amounts::{Amounts, percent},
        finding::Outcome,
        folder::RunFolder,
    },
    shorten::{duration_s, hastened, holds, most_haste},
};
use clap::Args;
use powderline_simulator::{
    PHYSICS_VERSION,
    rollout::{Census, RolloutError, Workload},
    scene::{
        Scene,
        figures::{about, mass},
    },
    skill::{QuantisedControls, SkillMap, Splines},
};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Arguments of `optimise shorten`.
#[derive(Clone, Debug, Args)]
pub(super) struct ShortenArgs {
    /// The plan
    #[arg(value_name = "PLAN")]
    pub plan: PathBuf,
    /// Threads and memory.
    #[command(flatten)]
    pub resources: Resources,
    /// Folder for the faster plan, its scene, and what was simulated: one that was stopped goes on from there [default: `shortened` beside
    /// the plan]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// What was simulated in haste so far, in the folder.
const HASTE: &str = "haste.json";

/// What the looks are of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Subject {
    plan: String,
    physics: u32,
}

/// The motion in so much haste.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Hurried {
    haste: f64,
    /// Why the arm may not perform it.
    obstacle: Option<String>,
    census: Census,
}

/// What is said.
#[derive(Serialize)]
struct Report {
    /// The motion's, without the rest after it.
    duration_s: f64,
    duration_before_s: f64,
    /// The whole plan's.
    plan_s: f64,
    plan_before_s: f64,
    haste: f64,
    linear_speed_m_s: f64,
    angular_speed_rad_s: f64,
    overlap: f64,
    /// Where the most is known of it, of the plan as it came.
    before: Outcome,
    #[serde(flatten)]
    refined: refine::Report,
}

/// Runs the command.
///
/// # Errors
/// One sentence; what was simulated before is saved.
pub(super) fn execute(arguments: &ShortenArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let task = MotionArgs::of_plan(&arguments.plan, arguments.resources).task()?;
    let plan = PlanToChange::of(&arguments.plan, &task)?;
    let by = plan.looked_at_by(&task.scene);
    let finest = |scene: &Scene| if by > 1 { scene.refined(by) } else { Ok(scene.clone()) };
    task.setup.check_memory(&finest(&task.scene)?, Workload::Single, 0)?;
    let folder = RunFolder::take(
        &arguments.out.clone().unwrap_or_else(|| arguments.plan.with_file_name("shortened")),
    )?;
    let of = Subject { plan: plan.name.clone(), physics: PHYSICS_VERSION };
    let mut hurry =
        Hurry { task: &task, plan: &plan, kept: Kept::begun(&folder, HASTE, of.clone())?, folder: &folder };
    let haste = hurry.most(context).map_err(|error| match error {
        CliError::Interrupted(_) => error.with_remark(GO_ON),
        error => error,
    })?;
    let quick = hastened(&task.scene, &plan.theta, haste)?;
    let looks = Kept::begun_beside(&folder, refine::LOOKS, of)?;
    let (refined, map) =
        plan.corrected([quick.clone(), finest(&quick)?], &task.setup, &folder, looks, context)?;
    let report = Report {
        duration_s: duration_s(&quick, &refined.theta()),
        duration_before_s: duration_s(&task.scene, &plan.theta),
        plan_s: quick.time.horizon_s(),
        plan_before_s: task.scene.time.horizon_s(),
        haste,
        linear_speed_m_s: quick.skill.linear_speed_m_s,
        angular_speed_rad_s: quick.skill.angular_speed_rad_s,
        overlap: quick.skill.overlap,
        before: plan.outcome(&task.scene),
        refined,
    };
    if arguments.json {
        context.json(&report)?;
    } else {
        write!(context.out, "{}{}", report.text(), report.refined.text(&map))?;
        write!(context.out, "{}", next::play(&report.refined.plan))?;
    }
    report.refined.shortfall().map_or(Ok(()), |shortfall| Err(CliError::Missed(shortfall)))
}

/// The plan's motion in haste, on the scene's own cells.
struct Hurry<'a> {
    task: &'a Task,
    plan: &'a PlanToChange,
    folder: &'a RunFolder,
    kept: Kept<Subject, Hurried>,
}

impl Hurry<'_> {
    /// The most haste that is well.
    fn most(&mut self, context: &Context<'_>) -> Result<f64, CliError> {
        let amounts = Amounts::from(&self.task.scene);
        let before = self.look(0.0, context)?;
        let mut is_well = |haste: f64| {
            let now = self.look(haste, context)?;
            Ok(now.obstacle.is_none() && holds(&amounts, &before.census, &now.census))
        };
        most_haste(&mut is_well)?.ok_or_else(|| {
            let least = self.kept.looks.last().expect("several looks");
            let why = match &least.obstacle {
                Some(why) => why.clone(),
                None => format!(
                    "{} arrive and {} are lost, where it was {} and {}",
                    amounts.mass(least.census.target),
                    mass(amounts.kg(least.census.lost())),
                    amounts.mass(before.census.target),
                    mass(amounts.kg(before.census.lost()))
                ),
            };
            CliError::Failed(format!(
                "the motion stays as fast as it is: with the least haste that is looked at {why}; higher limits, or a skill that loses \
                 less, could be made faster"
            ))
        })
    }

    /// As it was seen before, or else simulated and kept.
    fn look(&mut self, haste: f64, context: &Context<'_>) -> Result<Hurried, CliError> {
        let is_it = |seen: &&Hurried| seen.haste.to_bits() == haste.to_bits();
        if let Some(seen) = self.kept.looks.iter().find(is_it) {
            return Ok(seen.clone());
        }
        let seen = self.simulated(haste, context)?;
        self.kept.looks.push(seen.clone());
        self.kept.keep(self.folder, HASTE)?;
        Ok(seen)
    }

    fn simulated(&self, haste: f64, context: &Context<'_>) -> Result<Hurried, CliError> {
        let PlanToChange { theta, splines, .. } = self.plan;
        let splines: Option<&Splines> = splines.as_ref();
        let scene = hastened(&self.task.scene, theta, haste)?;
        let map = SkillMap::new(&scene);
        let nothing = |why| Hurried { haste, obstacle: Some(why), census: Census::default() };
        if let Some(why) = obstacle(&scene, &map, theta, splines) {
            return Ok(nothing(why));
        }
        let motion = QuantisedControls::new(&map.motion(theta, splines)?)?;
        let progress = Progress::new(&context.err, context.live);
        progress.begin(&format!("{} s", about(duration_s(&scene, theta), 3)), 0, &[]);
        let found = watched(context, &self.task.setup, &progress)(&scene)
            .and_then(|mut simulator| simulator.simulate(&motion.controls));
        progress.clear();
        match found {
            Ok(found) => Ok(Hurried { haste, obstacle: None, census: found.census }),
            Err(error @ (RolloutError::Escaped { .. } | RolloutError::NonFinite { .. })) => {
                Ok(nothing(error.to_string()))
            }
            Err(error) => Err(error.into()),
        }
    }
}

impl Report {
    fn text(&self) -> String {
        format!(
            "The motion takes {} s, {} less than before, and the plan with the rest after it {} s instead of {}. Mean speeds are {} m/s and {} rad/s, the overlap {}. \
             Before, it lost {}.\n",
            about(self.duration_s, 3),
            percent(1.0 - self.duration_s / self.duration_before_s),
            about(self.plan_s, 3),
            about(self.plan_before_s, 3),
            about(self.linear_speed_m_s, 3),
            about(self.angular_speed_rad_s, 3),
            about(self.overlap, 3),
            mass(self.before.lost_kg),
        )
    }
}
