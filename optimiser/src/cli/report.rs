//! `optimise report`: a run, a comparison or a plan as one page that opens from disk.

use super::{
    CliError, Context, Resources,
    compare::Experiment,
    film::Film,
    inspect::read_plan,
    motion::{Motion, MotionArgs, Task},
};
use crate::{
    compare::{Comparison, Row},
    optim::EpochRecord,
    report::{
        folder::{COMPARISON, METRICS, PLAN},
        words::{duration, grouped, parameter, precision_name},
    },
};
use clap::Args;
use powderline_shared::plan::{PlanReader, SKILL_PARAMETERS};
use powderline_simulator::{rollout::Evaluation, skill::Theta};
use powderline_view::page::{Chart, Figure, Page, Recorder, Series, Table};
use std::{
    fs,
    path::{Path, PathBuf},
};

/// Frames of the replay, seconds apart; the page shows what lies between.
const PERIOD_S: f64 = 0.02;

/// File in the folder of a run or a comparison.
const REPORT: &str = "report.html";

/// A longer file of metrics is not from a run, bytes.
const MAX_METRICS_BYTES: u64 = 64 << 20;

/// Arguments of `optimise report`.
#[derive(Clone, Debug, Args)]
pub(super) struct ReportArgs {
    /// Folder of a run or of a comparison, or a plan
    #[arg(value_name = "RUN_OR_COMPARISON_OR_PLAN")]
    pub of: PathBuf,
    /// Motion that the arm made of the plan, as recorded: shown over the planned one
    #[arg(long, value_name = "FILE")]
    pub executed: Option<PathBuf>,
    /// The page [default: report.html in the folder, or beside the plan]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Only curves and tables, no replay: nothing is simulated
    #[arg(long)]
    pub no_replay: bool,
    /// Threads and memory.
    #[command(flatten)]
    pub resources: Resources,
}

/// Runs the command.
///
/// # Errors
/// One sentence.
pub(super) fn execute(arguments: &ReportArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let of = &arguments.of;
    let (mut page, task) = if of.join(COMPARISON).exists() {
        arguments.comparison()?
    } else if of.join(METRICS).exists() {
        arguments.run()?
    } else if of.is_dir() {
        return Err(CliError::Input(format!(
            "{} holds neither a run ({METRICS}) nor a comparison ({COMPARISON})",
            of.display()
        )));
    } else {
        arguments.plan(of)?
    };
    if let Some(task) = task.filter(|_| !arguments.no_replay) {
        let film = Film::new(&task, PERIOD_S)?;
        let mut recorder = Recorder::new(&film.bench());
        let found = film.shoot(&mut recorder, context)?;
        page.replay = recorder.into_replay();
        page.figures.extend(outcome(&task, &found));
    }
    let usual = || if of.is_dir() { of.join(REPORT) } else { of.with_file_name(REPORT) };
    let path = arguments.out.clone().unwrap_or_else(usual);
    page.write(&path)?;
    writeln!(context.out, "The page is {}: open it in a browser.", path.display())?;
    Ok(())
}

impl ReportArgs {
    /// What is to be replayed of a plan, with the arm's motion where there is a record of it.
    fn task(&self, plan: &Path) -> Result<Task, CliError> {
        let motion = MotionArgs {
            scene: None,
            theta: None,
            plan: Some(plan.into()),
            executed: self.executed.clone(),
            seed: None,
            precision: None,
            resources: self.resources,
        };
        motion.task()
    }

    fn plan(&self, path: &Path) -> Result<(Page, Option<Task>), CliError> {
        let bytes = read_plan(path)?;
        let plan = PlanReader::new(&bytes)
            .map_err(|error| CliError::Input(format!("{} is no usable plan: {error}", path.display())))?;
        let task = self.task(path)?;
        let page = Page {
            title: format!("{}: a plan", task.scene.name),
            tables: vec![parameters(&plan)],
            ..Page::default()
        };
        Ok((page, Some(task)))
    }

    fn run(&self) -> Result<(Page, Option<Task>), CliError> {
        let history = read_history(&self.of.join(METRICS))?;
        let path = self.of.join(PLAN);
        let plan = path.exists().then(|| self.plan(&path)).transpose()?;
        let (plan, task) = plan.map_or((Page::default(), None), |(page, task)| (page, task));
        let scene = task.as_ref().map_or_else(
            || self.of.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            |task| {
                format!(
                    "{}, seed {}, {}",
                    task.scene.name,
                    task.settings.seed,
                    precision_name(task.settings.precision)
                )
            },
        );
        let mut tables = plan.tables;
        tables.push(epochs(&history));
        Ok((
            Page { title: scene, figures: progress(&history), charts: run_charts(&history), tables, ..plan },
            task,
        ))
    }

    fn comparison(&self) -> Result<(Page, Option<Task>), CliError> {
        if self.executed.is_some() {
            return Err(CliError::Input(
                "--executed goes with a plan or a run, not with a comparison".into(),
            ));
        }
        let experiment = Experiment::open(&self.of, self.resources)?;
        let comparison = experiment.so_far()?;
        let task = experiment.best_motion(&comparison);
        let page = Page {
            title: format!("{}: comparison of methods", comparison.scene),
            charts: comparison_charts(&comparison),
            tables: vec![summary(&experiment, &comparison)],
            notes: vec![format!(
                "Curves are means over the seeds of the best motion found so far, bands one standard deviation.{}",
                if task.is_some() { " The replay shows the best skill of all." } else { "" }
            )],
            ..Page::default()
        };
        Ok((page, task))
    }
}

/// What came of the motion that is replayed.
fn outcome(task: &Task, found: &Evaluation) -> Vec<Figure> {
    let whose = match task.motion {
        Motion::Executed { .. } => "as executed",
        Motion::Plan { .. } | Motion::Skill(_) => "as replayed",
    };
    let target = found.indicator + i64::from(found.transported);
    vec![
        Figure::new(
            &format!("Arrived, {whose}"),
            &format!("{} of {}", grouped(found.transported.into()), grouped(target)),
        ),
        Figure::new("Spilled", &grouped(found.spilled.into())),
        Figure::new("Loss", &format!("{:.3} m", found.loss)),
    ]
}

/// The skill in physical units.
fn parameters(plan: &PlanReader<'_>) -> Table {
    let header = plan.header();
    let row = |index: usize| {
        vec![
            SKILL_PARAMETERS[index].0.into(),
            parameter(index, header.skill_parameters[index]),
            format!("{:.4}", header.theta[index]),
        ]
    };
    Table {
        title: "Skill".into(),
        columns: ["parameter", "value", "theta"].map(String::from).into(),
        rows: (0..SKILL_PARAMETERS.len()).map(row).map(Into::into).collect(),
    }
}

/// The epochs that a run has written down.
pub(super) fn read_history(path: &Path) -> Result<Vec<EpochRecord>, CliError> {
    let wrong = |why: String| CliError::Input(format!("{} {why}", path.display()));
    let size = fs::metadata(path).map_err(|error| wrong(format!("cannot be read: {error}")))?.len();
    if size > MAX_METRICS_BYTES {
        return Err(wrong(format!("has {size} bytes, more than any run writes")));
    }
    let text = fs::read_to_string(path).map_err(|error| wrong(format!("cannot be read: {error}")))?;
    let line = |(number, line): (usize, &str)| {
        serde_json::from_str(line)
            .map_err(|error| wrong(format!("is no record of a run: line {number}: {error}")))
    };
    (1..).zip(text.lines()).map(line).collect()
}

/// What a run achieved.
fn progress(history: &[EpochRecord]) -> Vec<Figure> {
    let Some(best) = history.iter().min_by(|a, b| a.loss.total_cmp(&b.loss)) else { return Vec::new() };
    let seconds: f64 = history.iter().map(|record| record.seconds).sum();
    vec![
        Figure::new("Lowest loss", &format!("{:.3} m, epoch {}", best.loss, best.epoch)),
        Figure::new("First loss", &format!("{:.3} m", history[0].loss)),
        Figure::new("Epochs", &format!("{}, in {}", history.len(), duration(seconds))),
    ]
}

fn over_epochs(name: &str, history: &[EpochRecord], value: impl Fn(&EpochRecord) -> f64) -> Series {
    Series::new(name, history.iter().map(|record| [f64::from(record.epoch), value(record)]).collect())
}

/// A curve for each of the five parameters.
fn by_parameter(history: &[EpochRecord], value: impl Fn(&EpochRecord) -> [Option<f64>; 5]) -> Vec<Series> {
    let series = |index: usize| {
        over_epochs(SKILL_PARAMETERS[index].0, history, |record| value(record)[index].unwrap_or(f64::NAN))
    };
    (0..SKILL_PARAMETERS.len()).map(series).collect()
}

fn run_charts(history: &[EpochRecord]) -> Vec<Chart> {
    let theta = |record: &EpochRecord| record.theta.map(Some);
    let gradient =
        |record: &EpochRecord| record.gradient.map_or([None; 5], |gradient: Theta| gradient.map(Some));
    vec![
        Chart::new("Loss", "epoch", "loss, m", vec![over_epochs("loss", history, |record| record.loss)]),
        Chart::new(
            "Indicator",
            "epoch",
            "wanted particles that are missing",
            vec![over_epochs("indicator", history, |record| record.indicator as f64)],
        ),
        Chart::new("Skill parameters", "epoch", "theta", by_parameter(history, theta)),
        Chart::new("Gradient", "epoch", "loss by theta, m", by_parameter(history, gradient)),
        Chart::new(
            "Weight of the adjoint in the gradient",
            "epoch",
            "weight, 0 to 1",
            by_parameter(history, |record| record.first_order_weight),
        ),
    ]
}

fn epochs(history: &[EpochRecord]) -> Table {
    let columns = ["epoch", "loss, m", "indicator", "arrived", "spilled", "seconds"];
    let row = |record: &EpochRecord| {
        vec![
            record.epoch.to_string(),
            format!("{:.3}", record.loss),
            record.indicator.to_string(),
            record.transported.to_string(),
            record.spilled.to_string(),
            format!("{:.1}", record.seconds),
        ]
    };
    Table {
        title: "Epochs".into(),
        columns: columns.map(String::from).into(),
        rows: history.iter().map(row).map(Into::into).collect(),
    }
}

fn comparison_charts(comparison: &Comparison) -> Vec<Chart> {
    let panel = |title: &str, panel: crate::compare::figure::Panel| {
        let series = panel.bands.into_iter().map(|band| Series {
            name: band.name,
            points: band.points.iter().map(|[x, mean, _]| [*x, *mean]).collect(),
            band: Some(band.points.iter().map(|[_, mean, spread]| [mean - spread, mean + spread]).collect()),
            colour: None,
        });
        Chart::new(title, panel.x_name, panel.y_name, series.collect())
    };
    vec![
        panel("Indicator of the best skill so far", comparison.by_epoch()),
        panel("Lowest loss so far", comparison.by_rollouts()),
    ]
}

fn summary(experiment: &Experiment, comparison: &Comparison) -> Table {
    Table {
        title: "Summary".into(),
        columns: Row::headings(comparison.budget.epochs).into(),
        rows: experiment.rows(comparison).iter().map(|row| Vec::from(row.cells()).into()).collect(),
    }
}
