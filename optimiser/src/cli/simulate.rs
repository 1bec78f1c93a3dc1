//! `optimise simulate`: one rollout, of a skill, of a plan, or of what an arm made of a plan.

use super::{
    CliError, Context, Progress, Resources,
    executed::{Executed, ExecutedReport},
    inspect::read_plan,
    options::{DEFAULT_PRECISION, PrecisionArg, precision_name},
};
use crate::{
    report::{
        folder,
        words::{grouped, hex},
    },
    rollout::{Evaluation, SimulatorSettings},
    scene::{DEFAULT_SCENE, Scene},
    skill::{SkillMap, Theta, check_theta, controls_of},
};
use clap::Args;
use powderline_shared::{
    displacement::Displacement,
    plan::{PlanHeader, PlanReader, Precision},
};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Arguments of `optimise simulate`.
#[derive(Clone, Debug, Args)]
#[group(id = "motion", required = true, multiple = false, args = ["theta", "plan"])]
pub(super) struct SimulateArgs {
    /// Scene: an embedded name or a TOML file [default: the scene.toml beside the plan, otherwise bench]
    #[arg(value_name = "SCENE")]
    pub scene: Option<String>,
    /// Skill: depth, scoop angle, lift, transport, pour angle, each in [-1, 1]
    #[arg(long, value_name = "A,B,C,D,E", allow_hyphen_values = true)]
    pub theta: Option<String>,
    /// Plan to simulate again
    #[arg(long, value_name = "FILE")]
    pub plan: Option<PathBuf>,
    /// Motion that the arm made of the plan, as recorded: simulate the powder under that, beside the plan's prediction
    #[arg(long, value_name = "FILE", requires = "plan", conflicts_with = "theta")]
    pub executed: Option<PathBuf>,
    /// Seed of the packing [default: 1; a plan brings its own]
    #[arg(long, value_name = "N", conflicts_with = "plan")]
    pub seed: Option<u64>,
    /// Precision of the simulation [default: f32; a plan brings its own]
    #[arg(long, conflicts_with = "plan")]
    pub precision: Option<PrecisionArg>,
    /// Threads and memory.
    #[command(flatten)]
    pub resources: Resources,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// What is to be simulated.
struct Task {
    scene: Scene,
    settings: SimulatorSettings,
    motion: Motion,
}

enum Motion {
    Skill(Theta),
    Plan { header: Box<PlanHeader>, content_hash: u64, controls: Vec<Displacement> },
    Executed { header: Box<PlanHeader>, content_hash: u64, executed: Box<Executed> },
}

#[derive(Serialize)]
struct Report {
    scene: String,
    scene_digest: String,
    seed: u64,
    precision: &'static str,
    theta: Theta,
    loss: f64,
    indicator: i64,
    target: i64,
    transported: u32,
    spilled: u32,
    seconds: f64,
    plan: Option<PlanReport>,
    executed: Option<ExecutedReport>,
}

/// How the result compares with what the plan says about itself.
#[derive(Serialize)]
struct PlanReport {
    content_hash: String,
    loss: f64,
    indicator: i64,
    transported: u32,
    spilled: u32,
    /// Whether loss and indicator came out exactly so; nobody expects that of an executed motion.
    reproduced: Option<bool>,
}

/// Runs the command.
///
/// # Errors
/// One sentence; also when a plan's loss or indicator is not reproduced exactly.
pub(super) fn execute(arguments: &SimulateArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let task = match (&arguments.plan, &arguments.theta) {
        (Some(plan), _) => plan_task(arguments, plan)?,
        (None, theta) => skill_task(arguments, theta.as_deref().unwrap_or_default())?,
    };
    let report = task.simulate(context)?;
    if arguments.json {
        context.json(&report)?;
    } else {
        write!(context.out, "{}", report.text())?;
    }
    match &report.plan {
        Some(PlanReport { reproduced: Some(false), .. }) => {
            Err(CliError::Failed("the plan's loss and indicator were not reproduced".into()))
        }
        _ => Ok(()),
    }
}

fn skill_task(arguments: &SimulateArgs, theta: &str) -> Result<Task, CliError> {
    let theta = parse_theta(theta)?;
    let scene = Scene::load(arguments.scene.as_deref().unwrap_or(DEFAULT_SCENE))?;
    // Refused here, before anything is simulated.
    SkillMap::new(&scene).controls(&theta)?;
    let precision = arguments.precision.map_or(DEFAULT_PRECISION, Precision::from);
    let settings = arguments.resources.settings(arguments.seed.unwrap_or(scene.powder.seed), precision);
    Ok(Task { scene, settings, motion: Motion::Skill(theta) })
}

fn plan_task(arguments: &SimulateArgs, path: &Path) -> Result<Task, CliError> {
    let bytes = read_plan(path)?;
    let plan = PlanReader::new(&bytes)
        .map_err(|error| CliError::Input(format!("{} is no usable plan: {error}", path.display())))?;
    let (header, content_hash) = (*plan.header(), plan.content_hash());
    let name = arguments.scene.clone().or_else(|| scene_beside(path)).unwrap_or_else(|| DEFAULT_SCENE.into());
    let scene = Scene::load(&name)?;
    if scene.digest() != header.scene_digest {
        let [plan, scene] = [header.scene_digest, scene.digest()].map(|digest| hex(&digest[..4]));
        let path = path.display();
        return Err(CliError::Input(format!(
            "{path} was made for another scene than {name} (digest {plan}, not {scene})"
        )));
    }
    let settings = arguments.resources.settings(header.seed, header.precision);
    let header = Box::new(header);
    let motion = match &arguments.executed {
        None => {
            let controls = controls_of(&plan.setpoints().collect::<Vec<_>>(), header.lsb);
            Motion::Plan { header, content_hash, controls }
        }
        Some(path) => {
            let executed = Box::new(Executed::read(path, &plan, &scene)?);
            Motion::Executed { header, content_hash, executed }
        }
    };
    Ok(Task { scene, settings, motion })
}

fn scene_beside(plan: &Path) -> Option<String> {
    let scene = plan.parent()?.join(folder::SCENE);
    // A bare `scene.toml` is fine: no embedded scene has a dot in its name.
    scene.exists().then(|| scene.to_string_lossy().into_owned())
}

/// Five numbers in [-1, 1], separated by commas.
fn parse_theta(text: &str) -> Result<Theta, CliError> {
    let wrong = |why: &str| {
        CliError::Input(format!(
            "--theta is `{text}`, but five numbers in [-1, 1], separated by commas, would be right: {why}"
        ))
    };
    let numbers = text
        .split(',')
        .map(|part| part.trim().parse().map_err(|_| wrong(&format!("`{}` is no number", part.trim()))))
        .collect::<Result<Vec<f64>, _>>()?;
    let theta =
        numbers.try_into().map_err(|numbers: Vec<f64>| wrong(&format!("there are {}", numbers.len())))?;
    check_theta(&theta)?;
    Ok(theta)
}

impl Task {
    fn simulate(&self, context: &mut Context<'_>) -> Result<Report, CliError> {
        let mut simulator = (context.factory)(&self.scene, &self.settings)?;
        let interrupt = context.interrupt.clone();
        let mut progress = Progress::new(context.err, context.live);
        progress.begin("simulating", 0, &[]);
        let mut tick = |done, total| {
            progress.tick(done, total);
            !interrupt.is_requested()
        };
        let result = match &self.motion {
            Motion::Skill(theta) => simulator.evaluate(theta, false, &mut tick),
            Motion::Plan { controls, .. } => simulator.simulate(controls, &mut tick),
            Motion::Executed { executed, .. } => {
                simulator.simulate_from(&executed.anchor, &executed.controls, &mut tick)
            }
        };
        progress.clear();
        let seconds = progress.seconds();
        Ok(self.report(&result?, seconds))
    }

    fn report(&self, found: &Evaluation, seconds: f64) -> Report {
        let (theta, plan, executed) = match &self.motion {
            Motion::Skill(theta) => (*theta, None, None),
            Motion::Plan { header, content_hash, .. } => {
                let reproduced = found.loss.to_bits() == header.predicted_loss.to_bits()
                    && found.indicator == header.predicted_indicator;
                (header.theta, Some(PlanReport::new(header, *content_hash, Some(reproduced))), None)
            }
            Motion::Executed { header, content_hash, executed } => {
                let plan = PlanReport::new(header, *content_hash, None);
                (header.theta, Some(plan), Some(executed.report.clone()))
            }
        };
        Report {
            scene: self.scene.name.clone(),
            scene_digest: hex(&self.scene.digest()),
            seed: self.settings.seed,
            precision: precision_name(self.settings.precision),
            theta,
            loss: found.loss,
            indicator: found.indicator,
            target: found.indicator + i64::from(found.transported),
            transported: found.transported,
            spilled: found.spilled,
            seconds,
            plan,
            executed,
        }
    }
}

impl PlanReport {
    fn new(header: &PlanHeader, content_hash: u64, reproduced: Option<bool>) -> Self {
        Self {
            content_hash: format!("{content_hash:016x}"),
            loss: header.predicted_loss,
            indicator: header.predicted_indicator,
            transported: header.predicted_transported_count,
            spilled: header.predicted_spilled_count,
            reproduced,
        }
    }

    fn text(&self) -> String {
        let Self { loss, indicator, .. } = self;
        match self.reproduced {
            Some(true) => "Loss and indicator are exactly those that the plan reports.\n".into(),
            Some(false) => format!("The plan reports a loss of {loss} m and an indicator of {indicator}.\n"),
            None => {
                let [transported, spilled] = [self.transported, self.spilled].map(|n| grouped(n.into()));
                format!(
                    "The plan predicts a loss of {loss} m, an indicator of {indicator} ({transported} arrive, {spilled} \
                     spill).\n"
                )
            }
        }
    }
}

impl Report {
    fn text(&self) -> String {
        let Self { scene, seed, precision, loss, indicator, seconds, .. } = self;
        let [transported, target, spilled] =
            [self.transported.into(), self.target, self.spilled.into()].map(grouped);
        let mut text = format!(
            "{scene}, seed {seed}, {precision}: loss {loss} m, indicator {indicator} ({transported} of {target} wanted \
             particles arrive, {spilled} spill), in {seconds:.1} s.\n"
        );
        text += &self.plan.as_ref().map(PlanReport::text).unwrap_or_default();
        text += &self.executed.as_ref().map(ExecutedReport::text).unwrap_or_default();
        text
    }
}
