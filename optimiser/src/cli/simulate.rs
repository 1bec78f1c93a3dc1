//! `optimise simulate`: one rollout, of a skill, of a plan, or of what an arm made of a plan.

use super::{
    CliError, Context, Progress,
    executed::ExecutedReport,
    motion::{Motion, MotionArgs, Task, collision_words},
};
use crate::report::{
    amounts::Amounts,
    finding::Outcome,
    words::{hex, precision_name},
};
use clap::Args;
use powderline_shared::plan::PlanHeader;
use powderline_simulator::{
    rollout::{Evaluation, Workload, check_memory},
    scene::{Obstacle, ToolPart, figures::mass},
    skill::{Collision, Theta},
};
use serde::Serialize;

/// Arguments of `optimise simulate`.
#[derive(Clone, Debug, Args)]
pub(super) struct SimulateArgs {
    /// The motion.
    #[command(flatten)]
    pub motion: MotionArgs,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

#[derive(Serialize)]
struct Report {
    scene: String,
    scene_digest: String,
    /// Where the motion takes the tool through a container or a gate: nothing that an arm may do.
    collision: Option<CollisionReport>,
    seed: u64,
    precision: &'static str,
    theta: Theta,
    amounts: Amounts,
    loss: f64,
    indicator: i64,
    transported: u32,
    transported_kg: f64,
    /// How far that is off the wanted mass, relative.
    miss: f64,
    spilled: u32,
    spilled_kg: f64,
    seconds: f64,
    plan: Option<PlanReport>,
    executed: Option<ExecutedReport>,
}

#[derive(Serialize)]
struct CollisionReport {
    /// Of the tool: `body` or `handle`.
    part: &'static str,
    /// Its name, if it is a container.
    container: Option<String>,
    /// Its name, if it is a gate.
    gate: Option<String>,
    /// From the beginning of the motion.
    at_s: f64,
    /// In words.
    sentence: String,
}

impl From<Collision> for CollisionReport {
    fn from(collision: Collision) -> Self {
        let sentence = collision_words(&collision);
        let part = match collision.part {
            ToolPart::Body => "body",
            ToolPart::Handle => "handle",
        };
        let (container, gate) = match collision.obstacle {
            Obstacle::Gate(name) => (None, Some(name)),
            Obstacle::Container(name) => (Some(name), None),
        };
        Self { part, container, gate, at_s: collision.at_s, sentence }
    }
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
    let task = arguments.motion.task()?;
    let report = Report::of(&task, context)?;
    if arguments.json {
        context.json(&report)?;
    } else {
        write!(context.out, "{}", report.text())?;
    }
    match &report.plan {
        Some(PlanReport { reproduced: Some(false), .. }) => {
            Err(CliError::Failed("the plan's loss and amount were not reproduced".into()))
        }
        _ => Ok(()),
    }
}

impl Report {
    fn of(task: &Task, context: &mut Context<'_>) -> Result<Self, CliError> {
        check_memory(&task.scene, &task.settings, Workload::Single, 0)?;
        let mut simulator = (context.factory)(&task.scene, &task.settings)?;
        let interrupt = context.interrupt.clone();
        let mut progress = Progress::new(context.err, context.live);
        progress.begin("simulating", 0, &[]);
        let mut tick = |done, total| {
            progress.tick(done, total);
            !interrupt.is_requested()
        };
        let result = match &task.motion {
            Motion::Skill(theta) => simulator.evaluate(theta, false, &mut tick),
            Motion::Plan { controls, .. } => simulator.simulate(controls, &mut tick),
            Motion::Executed { executed, .. } => {
                simulator.simulate_from(&executed.anchor, &executed.controls, &mut tick)
            }
        };
        progress.clear();
        let seconds = progress.seconds();
        Ok(Self::new(task, &result?, seconds))
    }

    fn new(task: &Task, found: &Evaluation, seconds: f64) -> Self {
        let (theta, plan, executed) = match &task.motion {
            Motion::Skill(theta) => (*theta, None, None),
            Motion::Plan { header, content_hash, .. } => {
                let reproduced = found.loss.to_bits() == header.predicted_loss.to_bits()
                    && found.indicator == header.predicted_indicator;
                (header.theta, Some(PlanReport::new(header, *content_hash, Some(reproduced))), None)
            }
            Motion::Executed { header, content_hash, executed, .. } => {
                let plan = PlanReport::new(header, *content_hash, None);
                (header.theta, Some(plan), Some(executed.report.clone()))
            }
        };
        let amounts = Amounts::from(&task.scene);
        let outcome = Outcome::of_evaluation(&amounts, found);
        Self {
            scene: task.scene.name.clone(),
            scene_digest: hex(&task.scene.digest()),
            collision: task.collision().map(CollisionReport::from),
            seed: task.settings.seed,
            precision: precision_name(task.settings.precision),
            theta,
            loss: found.loss,
            indicator: found.indicator,
            transported: found.transported,
            transported_kg: outcome.mass_kg,
            miss: outcome.miss,
            spilled: found.spilled,
            spilled_kg: outcome.spilled_kg,
            seconds,
            amounts,
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

    fn text(&self, amounts: &Amounts) -> String {
        let loss = self.loss;
        let [transported, spilled] =
            [self.transported, self.spilled].map(|particles| amounts.powder(particles));
        match self.reproduced {
            Some(true) => "Loss and amount are exactly those that the plan predicts.\n".into(),
            _ => format!(
                "The plan predicts that {transported} arrive and {spilled} spill, with a loss of {loss} m.\n"
            ),
        }
    }
}

impl Report {
    fn text(&self) -> String {
        let Self { scene, seed, precision, loss, seconds, amounts, .. } = self;
        let warning = self.collision.as_ref().map(|collision| format!("Warning: {}.\n", collision.sentence));
        let mut text = warning.unwrap_or_default();
        text += &format!(
            "{scene}, seed {seed}, {precision}: {} of the {} wanted arrive, {}; {} spill.\nLoss {loss} m, in {seconds:.1} s.\n",
            amounts.powder(self.transported),
            mass(amounts.wanted_kg),
            amounts.off(self.transported),
            amounts.powder(self.spilled),
        );
        text += &self.plan.as_ref().map(|plan| plan.text(amounts)).unwrap_or_default();
        text += &self.executed.as_ref().map(ExecutedReport::text).unwrap_or_default();
        text
    }
}
