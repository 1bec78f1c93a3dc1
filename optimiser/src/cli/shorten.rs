//! `optimise shorten`: a plan's motion made faster, as long as no more powder is lost by that.

use super::{
    CliError, Context, Progress, Resources,
    kept::{Kept, that_goes_on},
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
    shorten::{Haste, brings_less, duration_s, hastened, holds, loses_more, most_haste},
};
use clap::Args;
use powderline_simulator::{
    PHYSICS_VERSION,
    rollout::{Census, Workload},
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

/// What is said of the faster motion before its skill was changed.
const FASTER_BROUGHT: &str = "With the skill as it came, the faster motion brought";

/// By less than this nobody makes a motion faster, seconds.
const WORTH_A_LOOK_S: f64 = 1e-3;

/// What the looks are of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Subject {
    plan: String,
    physics: u32,
}

/// The motion in so much haste.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Hurried {
    haste: Haste,
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
    haste: Haste,
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
        Hurry { task: &task, plan: &plan, kept: Kept::begun(&folder, HASTE, of)?, folder: &folder };
    let haste = hurry.most(context).map_err(that_goes_on)?;
    let quick = hastened(&task.scene, &plan.theta, &haste)?;
    let looks = Kept::begun_beside(&folder, refine::LOOKS, plan.subject(&quick, by))?;
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
        writeln!(context.out, "{}{}", report.text(), report.refined.text(&map, FASTER_BROUGHT))?;
        write!(context.out, "{}", next::play(&report.refined.plan))?;
    }
    report.shortfall(&Amounts::from(&task.scene)).map_or(Ok(()), |shortfall| Err(CliError::Missed(shortfall)))
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
    fn most(&mut self, context: &Context<'_>) -> Result<Haste, CliError> {
        let amounts = Amounts::from(&self.task.scene);
        let before = self.look(&Haste::default(), context)?;
        let mut shortest_s = self.duration_s(&Haste::default())?;
        let mut is_well = |haste: &Haste| {
            // In a scene that is none, as where the longest skill is longer, nothing is made.
            let Ok(takes_s) = self.duration_s(haste) else { return Ok(false) };
            // Of what is as fast as it can be there is nothing to be seen.
            if takes_s > shortest_s - WORTH_A_LOOK_S {
                return Ok(false);
            }
            let now = self.look(haste, context)?;
            let is_well = now.obstacle.is_none() && holds(&amounts, &before.census, &now.census);
            if is_well {
                shortest_s = takes_s;
            }
            Ok(is_well)
        };
        most_haste(&mut is_well)?.ok_or_else(|| CliError::Failed(self.stays(&amounts, &before)))
    }

    /// Why the motion is not made faster.
    fn stays(&self, amounts: &Amounts, before: &Hurried) -> String {
        let words = |census: &Census| {
            let lost = mass(amounts.kg(census.lost()));
            format!("{} arrive and {lost} are lost", amounts.mass(census.target))
        };
        let why = match self.kept.looks.last().filter(|last| last.haste != Haste::default()) {
            None => "it is as fast as the limits allow".to_owned(),
            Some(Hurried { obstacle: Some(why), .. }) => {
                format!("with the least haste that is looked at {why}")
            }
            Some(last) => format!(
                "with the least haste that is looked at {}, before {}",
                words(&last.census),
                words(&before.census)
            ),
        };
        format!(
            "the motion stays as it is: {why}; higher limits, or a skill that loses less, could be made faster"
        )
    }

    fn duration_s(&self, haste: &Haste) -> Result<f64, CliError> {
        Ok(duration_s(&hastened(&self.task.scene, &self.plan.theta, haste)?, &self.plan.theta))
    }

    /// As it was seen before, or else simulated and kept.
    fn look(&mut self, haste: &Haste, context: &Context<'_>) -> Result<Hurried, CliError> {
        if let Some(seen) = self.kept.looks.iter().find(|seen| seen.haste == *haste) {
            // What was seen by a version of before may be more than the arm may perform.
            let obstacle = seen.obstacle.clone().or(self.obstacle(haste)?);
            return Ok(Hurried { obstacle, ..seen.clone() });
        }
        let progress = Progress::new(&context.err, context.live);
        let seen = self.simulated(haste, &progress, context);
        progress.clear();
        let seen = seen?;
        let amounts = Amounts::from(&self.task.scene);
        let found = match &seen.obstacle {
            Some(why) => why.clone(),
            None => {
                format!("{}, {} lost", amounts.mass(seen.census.target), mass(amounts.kg(seen.census.lost())))
            }
        };
        progress.line(&format!("  in {} s: {found}", about(self.duration_s(haste)?, 3)));
        self.kept.looks.push(seen.clone());
        self.kept.keep(self.folder, HASTE)?;
        Ok(seen)
    }

    /// Why the arm may not perform the motion.
    fn obstacle(&self, haste: &Haste) -> Result<Option<String>, CliError> {
        let PlanToChange { theta, splines, .. } = self.plan;
        let scene = hastened(&self.task.scene, theta, haste)?;
        Ok(obstacle(&scene, &SkillMap::new(&scene), theta, splines.as_ref()))
    }

    fn simulated(
        &self,
        haste: &Haste,
        progress: &Progress,
        context: &Context<'_>,
    ) -> Result<Hurried, CliError> {
        let PlanToChange { theta, splines, .. } = self.plan;
        let splines: Option<&Splines> = splines.as_ref();
        let scene = hastened(&self.task.scene, theta, haste)?;
        let (map, haste) = (SkillMap::new(&scene), *haste);
        let nothing = |why| Hurried { haste, obstacle: Some(why), census: Census::default() };
        if let Some(why) = self.obstacle(&haste)? {
            return Ok(nothing(why));
        }
        let motion = QuantisedControls::new(&map.motion(theta, splines)?)?;
        progress.begin(&format!("in {} s", about(duration_s(&scene, theta), 3)), 0, &[]);
        let found = watched(context, &self.task.setup, progress)(&scene)
            .and_then(|mut simulator| simulator.simulate(&motion.controls));
        match found {
            Ok(found) => Ok(Hurried { haste, obstacle: None, census: found.census }),
            Err(error) if error.is_of_motion() => Ok(nothing(error.to_string())),
            Err(error) => Err(error.into()),
        }
    }
}

impl Report {
    /// Why it is not what was asked for, if it is not.
    fn shortfall(&self, amounts: &Amounts) -> Option<String> {
        let (before, now) = (&self.before, self.refined.outcome());
        self.refined
            .shortfall()
            .or_else(|| brings_less(amounts, before.mass_kg, now.mass_kg))
            .or_else(|| loses_more(amounts, before.lost_kg, now.lost_kg))
    }

    fn text(&self) -> String {
        let seconds = |time_s: f64| about(time_s, 3);
        let share = percent(1.0 - self.duration_s / self.duration_before_s);
        let lost = [self.refined.outcome(), &self.before].map(|outcome| mass(outcome.lost_kg));
        format!(
            "The motion takes {} s, {share} less than before, and with the rest after it {} s instead of {}. {} are lost, before {}.\n\
             Mean speeds are {} m/s and {} rad/s, lift, transport and pour overlap by {}.\n",
            seconds(self.duration_s),
            seconds(self.plan_s),
            seconds(self.plan_before_s),
            lost[0],
            lost[1],
            about(self.linear_speed_m_s, 3),
            about(self.angular_speed_rad_s, 3),
            about(self.overlap, 3),
        )
    }
}
