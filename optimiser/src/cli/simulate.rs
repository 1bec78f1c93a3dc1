//! `optimise simulate`: one rollout, of a skill, of a plan, or of what an arm made of a plan.

use super::{
    CliError, Context, Progress, Setup,
    executed::ExecutedReport,
    motion::{Motion, MotionArgs, NOT_REPRODUCED, Task, collision_words, is_reproduced},
};
use crate::report::{
    amounts::{Amounts, off, percent},
    finding::Outcome,
    summary::cells,
    words::hex,
};
use clap::Args;
use powderline_shared::plan::{Finer as PlanFiner, PlanHeader, Prediction};
use powderline_simulator::{
    rollout::{Evaluation, RolloutError, SimulatorSettings, Workload},
    scene::{
        Obstacle, Scene, ToolPart,
        figures::{count, mass},
    },
    skill::{Collision, SkillMap},
};
use serde::Serialize;

/// Arguments of `optimise simulate`.
#[derive(Clone, Debug, Args)]
pub(super) struct SimulateArgs {
    /// The motion.
    #[command(flatten)]
    pub motion: MotionArgs,
    /// See what the motion brings on smaller cells, too: N = 2 is half the size, with 8 times the particles, and takes about 16 times
    /// as long
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=4))]
    pub refine: Option<u32>,
    /// See what the motion brings in so many other packings of the powder, too, of the seeds after its own: how much of it is chance. With
    /// --refine on the smaller cells as well
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=1000))]
    pub packings: Option<u32>,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// Where a scene says how large cells are.
const OWN: &str = "the scene's own cells";

#[derive(Serialize)]
struct Report {
    scene: String,
    scene_digest: String,
    /// Where the motion takes the tool through a container or a gate: nothing that an arm may do.
    collision: Option<CollisionReport>,
    seed: u64,
    precision: &'static str,
    theta: [f64; 5],
    amounts: Amounts,
    indicator: i64,
    #[serde(flatten)]
    outcome: Outcome,
    seconds: f64,
    finer: Option<Finer>,
    packings: Option<Packings>,
    plan: Option<PlanReport>,
    executed: Option<ExecutedReport>,
    /// What makes the command fail, if anything does.
    failure: Option<String>,
}

/// What the same motion brings on smaller cells.
#[derive(Serialize)]
struct Finer {
    cell_m: f64,
    amounts: Amounts,
    #[serde(flatten)]
    outcome: Outcome,
    /// What arrives there over what arrives on the scene's own cells, less 1; none where nothing does.
    change: Option<f64>,
    seconds: f64,
    packings: Option<Packings>,
}

/// What the same motion brings in other packings of the powder.
#[derive(Serialize)]
struct Packings {
    /// How many were asked for: fewer were looked at where that ended early.
    asked: u32,
    /// Of those in which it comes to an end; none if there is none.
    mean: Option<Mean>,
    each: Vec<Packing>,
    seconds: f64,
}

/// Mean of what it brings in each of them.
#[derive(Serialize)]
struct Mean {
    mass_kg: f64,
    miss: f64,
    lost_kg: f64,
    loss_m: f64,
}

/// One of them.
#[derive(Serialize)]
struct Packing {
    seed: u64,
    #[serde(flatten)]
    outcome: Option<Outcome>,
    /// Why it comes to no end.
    error: Option<String>,
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
            Obstacle::Table | Obstacle::Stand | Obstacle::Border => (None, None),
        };
        Self { part, container, gate, at_s: collision.at_s, sentence }
    }
}

/// How the result compares with what the plan says about itself.
#[derive(Serialize)]
struct PlanReport {
    content_hash: String,
    predicted: Prediction,
    /// What it says of smaller cells; null if nobody looked.
    finer: Option<PlanFiner>,
    /// Whether loss and indicator came out exactly so; nobody expects that of an executed motion.
    reproduced: Option<bool>,
}

/// Runs the command.
///
/// # Errors
/// One sentence; also when a plan's loss or indicator is not reproduced exactly.
pub(super) fn execute(arguments: &SimulateArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let task = arguments.motion.task()?;
    // Refused here, before anything is simulated.
    let finer = arguments.refine.map(|by| task.scene.refined(by)).transpose()?;
    check_memory(&task, finer.as_ref())?;
    let (found, seconds) = simulated(&task, &task.scene, &task.setup, "simulating", context)?;
    let mut report = Report::new(&task, &found, seconds);
    // What was found is printed however that ends.
    let further = report.look_further(&task, finer.as_ref(), arguments.packings, context);
    let ended = match report.plan {
        Some(PlanReport { reproduced: Some(false), .. }) => {
            let other = CliError::Failed(NOT_REPRODUCED.into());
            Err(match further {
                Ok(()) => other,
                Err(further) => other.with_remark(&further.to_string()),
            })
        }
        _ => further,
    };
    report.failure = ended.as_ref().err().map(ToString::to_string);
    if arguments.json {
        context.json(&report)?;
    } else {
        write!(context.out, "{}", report.text())?;
    }
    ended
}

/// Whether memory will do, for the scene and for the smaller cells, if those are looked at.
fn check_memory(task: &Task, finer: Option<&Scene>) -> Result<(), CliError> {
    task.setup.check_memory(&task.scene, Workload::Single, 0)?;
    let Some(finer) = finer else { return Ok(()) };
    task.setup.check_memory(finer, Workload::Single, 0).map_err(|error| {
        let on = cells(finer.domain.cell_m);
        CliError::from(error).with_remark(&format!("that is for {on}, which --refine asks for"))
    })
}

/// What a motion brings in a scene, its own or a finer copy of it, in a packing, its own or another.
fn simulated(
    task: &Task,
    scene: &Scene,
    setup: &Setup,
    doing: &str,
    context: &mut Context<'_>,
) -> Result<(Evaluation, f64), CliError> {
    let (found, seconds) = tried(task, scene, setup, doing, context)?;
    Ok((found?, seconds))
}

/// The same where it may come to no end.
fn tried(
    task: &Task,
    scene: &Scene,
    setup: &Setup,
    doing: &str,
    context: &mut Context<'_>,
) -> Result<(Result<Evaluation, RolloutError>, f64), CliError> {
    let mut simulator = (context.factory)(scene, setup)?;
    let progress = Progress::new(&context.err, context.live);
    simulator.set_progress(progress.watch(&context.interrupt));
    progress.begin(doing, 0, &[]);
    let result = match &task.motion {
        Motion::Skill(theta, splines) => SkillMap::new(&task.scene)
            .motion(theta, splines.as_ref())
            .map_err(RolloutError::from)
            .and_then(|controls| simulator.simulate(&controls)),
        Motion::Plan { controls, .. } => simulator.simulate(controls),
        Motion::Executed { executed, .. } => simulator.simulate_from(&executed.anchor, &executed.controls),
    };
    progress.clear();
    Ok((result, progress.seconds()))
}

impl Finer {
    /// What was found there, and no other packings yet.
    fn new(scene: &Scene, own: &Outcome, found: &Evaluation, seconds: f64) -> Self {
        let amounts = Amounts::from(scene);
        let outcome = Outcome::of_evaluation(&amounts, found);
        let change = (own.mass_kg > 0.0).then(|| outcome.mass_kg / own.mass_kg - 1.0);
        Self { cell_m: scene.domain.cell_m, amounts, outcome, change, seconds, packings: None }
    }

    fn text(&self) -> String {
        let Self { amounts, outcome, change, seconds, packings, .. } = self;
        let on = cells(self.cell_m);
        let packings = packings.as_ref().map(|packings| packings.text(amounts, &on));
        let change = match change.map(|change| (change, percent(change.abs()))) {
            None => String::new(),
            Some((_, same)) if same == "0 %" => " as much as on the scene's own,".into(),
            Some((change, percent)) => {
                format!(" {percent} {} than on the scene's own,", if change < 0.0 { "less" } else { "more" })
            }
        };
        format!(
            "On {on}: {},{change} {}. {} In {seconds:.1} s.\n{}",
            amounts.powder(outcome.census.target),
            amounts.off(outcome.census.target),
            amounts.rest(&outcome.census),
            packings.unwrap_or_default(),
        )
    }
}

impl Packings {
    /// None looked at yet.
    fn new(asked: u32) -> Self {
        Self { asked, mean: None, each: Vec::new(), seconds: 0.0 }
    }

    /// Looks at them, and keeps what was looked at however that ends.
    fn look(
        &mut self,
        task: &Task,
        scene: &Scene,
        on: &str,
        context: &mut Context<'_>,
    ) -> Result<(), CliError> {
        let own = task.setup.settings.seed_of(&task.scene);
        let amounts = Amounts::from(scene);
        for number in 1..=self.asked {
            let seed = own.wrapping_add(number.into());
            let settings = SimulatorSettings { seed: Some(seed), ..task.setup.settings };
            let doing = format!("simulating, packing {number} of {}", self.asked);
            let (found, took) = tried(task, scene, &Setup { settings, ..task.setup }, &doing, context)?;
            self.each.push(match found {
                Err(error) if error.is_of_motion() => {
                    Packing { seed, outcome: None, error: Some(error.to_string()) }
                }
                Err(RolloutError::Stopped) => {
                    let looked = format!("{} of {}", self.each.len(), self.asked);
                    return Err(CliError::Interrupted(format!(
                        "stopped after {looked} other packings on {on}"
                    )));
                }
                Err(error) => {
                    return Err(
                        CliError::from(error).with_remark(&format!("that is of seed {seed}, on {on}"))
                    );
                }
                Ok(found) => {
                    Packing { seed, outcome: Some(Outcome::of_evaluation(&amounts, &found)), error: None }
                }
            });
            self.seconds += took;
            self.mean = Mean::of(&self.each);
        }
        Ok(())
    }

    fn text(&self, amounts: &Amounts, on: &str) -> String {
        let Self { mean, each, seconds, .. } = self;
        if each.is_empty() {
            return String::new();
        }
        let looked = count(each.len() as i64, "other packing");
        let begin = format!("In {looked} of the powder, on {on}");
        let failed = |packing: &Packing| {
            packing
                .error
                .as_ref()
                .map(|why| format!(" With seed {} it comes to no end: {why}.", packing.seed))
        };
        let failed: String = each.iter().filter_map(failed).collect();
        let Some(mean) = mean else {
            return format!("{begin}, it comes to no end in any.{failed}\n");
        };
        let found =
            || each.iter().filter_map(|packing| packing.outcome.as_ref()).map(|outcome| outcome.census);
        let arrives = || found().map(|census| census.target);
        let met = arrives().filter(|particles| amounts.is_met(*particles) == Some(true)).count();
        let met = amounts.tolerance.map_or(String::new(), |_| format!(", within the tolerance in {met}"));
        format!(
            "{begin}: {} on average, {}; {} at least, {} at most{met}. {} are lost on average, {} at most. Loss {:.3} m on average, in \
             {seconds:.1} s.{failed}\n",
            mass(mean.mass_kg),
            off(mean.miss),
            amounts.mass(arrives().min().unwrap_or_default()),
            amounts.mass(arrives().max().unwrap_or_default()),
            mass(mean.lost_kg),
            amounts.mass(found().map(|census| census.lost()).max().unwrap_or_default()),
            mean.loss_m,
        )
    }
}

impl Mean {
    fn of(each: &[Packing]) -> Option<Self> {
        let found: Vec<&Outcome> = each.iter().filter_map(|packing| packing.outcome.as_ref()).collect();
        let mean = |of: fn(&Outcome) -> f64| {
            found.iter().map(|outcome| of(outcome)).sum::<f64>() / found.len() as f64
        };
        (!found.is_empty()).then(|| Self {
            mass_kg: mean(|outcome| outcome.mass_kg),
            miss: mean(|outcome| outcome.miss),
            lost_kg: mean(|outcome| outcome.lost_kg),
            loss_m: mean(|outcome| outcome.loss_m),
        })
    }
}

impl Report {
    fn new(task: &Task, found: &Evaluation, seconds: f64) -> Self {
        let (theta, plan, executed) = match &task.motion {
            Motion::Skill(theta, _) => (theta.components(), None, None),
            Motion::Plan { header, content_hash, .. } => {
                let reproduced = Some(is_reproduced(header, found));
                (header.theta, Some(PlanReport::new(header, *content_hash, reproduced)), None)
            }
            Motion::Executed { header, content_hash, executed, .. } => {
                let plan = PlanReport::new(header, *content_hash, None);
                (header.theta, Some(plan), Some(executed.report.clone()))
            }
        };
        let amounts = Amounts::from(&task.scene);
        Self {
            scene: task.scene.name.clone(),
            scene_digest: hex(&task.scene.digest()),
            collision: task.collision().map(CollisionReport::from),
            seed: task.setup.settings.seed_of(&task.scene),
            precision: task.setup.precision.name(),
            theta,
            indicator: found.indicator,
            outcome: Outcome::of_evaluation(&amounts, found),
            seconds,
            finer: None,
            packings: None,
            amounts,
            plan,
            executed,
            failure: None,
        }
    }
}

impl PlanReport {
    fn new(header: &PlanHeader, content_hash: u64, reproduced: Option<bool>) -> Self {
        let (predicted, finer) = (header.predicted, header.finer);
        Self { content_hash: format!("{content_hash:016x}"), predicted, finer, reproduced }
    }

    fn text(&self, amounts: &Amounts) -> String {
        let Prediction { loss_m, census, .. } = self.predicted;
        let finer = self.finer.map(|finer| {
            format!(
                "Those are of the scene's own cells; on {}, by which the plan is judged, it says that {} arrive.\n",
                cells(finer.cell_m),
                mass(finer.arrives_kg())
            )
        });
        let own = match self.reproduced {
            Some(true) => "Loss and amount are exactly those that the plan predicts.\n".into(),
            _ => format!(
                "The plan predicts that {} arrive, with a loss of {loss_m} m. {}\n",
                amounts.powder(census.target),
                amounts.rest(&census)
            ),
        };
        own + &finer.unwrap_or_default()
    }
}

impl Report {
    /// Looks at smaller cells and other packings, and keeps what was looked at however that ends.
    fn look_further(
        &mut self,
        task: &Task,
        finer: Option<&Scene>,
        packings: Option<u32>,
        context: &mut Context<'_>,
    ) -> Result<(), CliError> {
        if let Some(scene) = finer {
            self.look_at_finer(task, scene, packings, context)?;
        }
        packings.map_or(Ok(()), |count| {
            self.packings.insert(Packings::new(count)).look(task, &task.scene, OWN, context)
        })
    }

    fn look_at_finer(
        &mut self,
        task: &Task,
        scene: &Scene,
        packings: Option<u32>,
        context: &mut Context<'_>,
    ) -> Result<(), CliError> {
        let on = cells(scene.domain.cell_m);
        let left_out = |error: CliError, what: &str| match packings {
            Some(_) => error.with_remark(&format!("{what} were not looked at")),
            None => error,
        };
        let (found, seconds) = simulated(task, scene, &task.setup, "simulating, on smaller cells", context)
            .map_err(|error| {
            left_out(error.with_remark(&format!("what it brings on {on} is not known")), "other packings")
        })?;
        let finer = self.finer.insert(Finer::new(scene, &self.outcome, &found, seconds));
        packings
            .map_or(Ok(()), |count| {
                finer.packings.insert(Packings::new(count)).look(task, scene, &on, context)
            })
            .map_err(|error| left_out(error, &format!("other packings on {OWN}")))
    }

    fn text(&self) -> String {
        let Self { scene, seed, precision, seconds, amounts, .. } = self;
        let Outcome { census, loss_m, .. } = self.outcome;
        let warning = self.collision.as_ref().map(|collision| format!("Warning: {}.\n", collision.sentence));
        let mut text = warning.unwrap_or_default();
        text += &format!(
            "{scene}, seed {seed}, {precision}: {} of the {} wanted arrive, {}.\n{}\nLoss {loss_m} m, in {seconds:.1} s.\n",
            amounts.powder(census.target),
            mass(amounts.wanted_kg),
            amounts.off(census.target),
            amounts.rest(&census),
        );
        text += &self.finer.as_ref().map(Finer::text).unwrap_or_default();
        let packings = self.packings.as_ref().map(|packings| packings.text(amounts, OWN));
        text += &packings.unwrap_or_default();
        text += &self.plan.as_ref().map(|plan| plan.text(amounts)).unwrap_or_default();
        text += &self.executed.as_ref().map(ExecutedReport::text).unwrap_or_default();
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_simulator::rollout::Census;

    #[test]
    fn packings_in_which_a_motion_comes_to_no_end_are_named_and_not_averaged() {
        let amounts = Amounts::from(&Scene::load("bench").unwrap());
        let brings = |seed, target| {
            let outcome = Outcome::new(&amounts, Census { target, ..Census::default() }, 2.0);
            Packing { seed, outcome: Some(outcome), error: None }
        };
        let lost = |seed| Packing { seed, outcome: None, error: Some("powder left".into()) };
        let text = |each: Vec<Packing>| {
            Packings { asked: 3, mean: Mean::of(&each), each, seconds: 1.0 }
                .text(&amounts, "the scene's own cells")
        };
        assert_eq!(
            text(vec![brings(5, 1188), lost(6), brings(7, 1260)]),
            "In 3 other packings of the powder, on the scene's own cells: 9.792 g on average, 2 % too much; 9.504 g at least, 10.08 g at most, \
             within the tolerance in 1. 0 mg are lost on average, 0 mg at most. Loss 2.000 m on average, in 1.0 s. With seed 6 it comes to no \
             end: powder left.\n"
        );
        assert_eq!(
            text(vec![lost(6), lost(7)]),
            "In 2 other packings of the powder, on the scene's own cells, it comes to no end in any. With seed 6 it comes to no end: powder \
             left. With seed 7 it comes to no end: powder left.\n"
        );
    }
}
