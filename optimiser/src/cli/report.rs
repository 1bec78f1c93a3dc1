//! `optimise report`: a run, a comparison or a plan as one page that opens from disk.

use super::{
    CliError, Context, Resources,
    compare::Experiment,
    executed::ExecutedReport,
    film::Film,
    inspect::run_of,
    motion::{Motion, MotionArgs, Task},
};
use crate::{
    compare::{Comparison, Row},
    failure::of_file,
    optim::{EpochRecord, Slopes, Work, World},
    report::{
        amounts::{Amounts, counted, percent},
        finding::{Finding, Outcome},
        folder::{COMPARISON, PLAN, STATE},
        judged::Judged,
        record::RunRecord,
        summary::cells,
        words::{capitalised, count, duration, hex, parameter},
    },
};
use clap::Args;
use powderline_shared::plan::{
    PlanHeader, PlanReader, SkillParameter,
    file::{parse_plan, read_plan_file},
};
use powderline_simulator::scene::{
    Scene,
    figures::{about, mass},
};
use powderline_view::page::{
    Chart, Figure, Mark, Page, Recorder, Row as PageRow, Scale, Series, Table, Tone,
};
use serde::Serialize;
use std::{
    fs,
    path::{Path, PathBuf},
};

/// Frames of the replay, seconds apart; the page shows what lies between.
const PERIOD_S: f64 = 0.02;

/// File in the folder of a run or a comparison.
const REPORT: &str = "report.html";

/// What `--json` prints.
#[derive(Serialize)]
struct Report<'a> {
    page: &'a Path,
    /// Of a run, and of a plan in its run's folder.
    run: Option<Finding>,
    /// What the replay showed, where there is one.
    replayed: Option<Outcome>,
    /// Of a motion that an arm made of the plan.
    executed: Option<&'a ExecutedReport>,
    /// Why what is replayed cannot be made as it is shown, or is not what the plan says.
    remarks: Vec<String>,
}

/// What a page is made of.
struct Draft {
    page: Page,
    /// What is to be replayed.
    task: Option<Task>,
    finding: Option<Finding>,
}

/// Arguments of `optimise report`.
#[derive(Clone, Debug, Args)]
pub struct ReportArgs {
    /// Folder of a run or of a comparison, or a plan
    #[arg(value_name = "RUN_OR_COMPARISON_OR_PLAN")]
    pub of: PathBuf,
    /// Motion that the arm made of the plan, as recorded: shown over the planned one
    #[arg(long, value_name = "FILE", conflicts_with = "no_replay")]
    pub executed: Option<PathBuf>,
    /// The page [default: report.html in the folder, or beside the plan]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Only curves and tables, no replay: nothing is simulated
    #[arg(long)]
    pub no_replay: bool,
    /// What is in the replay's way: said on the page.
    #[arg(skip)]
    pub obstacle: Option<String>,
    /// Print what the page says as one JSON object
    #[arg(long)]
    pub json: bool,
    /// Threads and memory.
    #[command(flatten)]
    pub resources: Resources,
}

/// Runs the command.
///
/// # Errors
/// One sentence.
pub fn execute(arguments: &ReportArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let of = &arguments.of;
    let path = arguments.page()?;
    let Draft { mut page, task, finding } = if of.join(COMPARISON).exists() {
        arguments.comparison()?
    } else if of.join(STATE).exists() {
        arguments.run()?
    } else if of.is_dir() {
        return Err(CliError::Input(format!(
            "{} holds neither a run ({STATE}) nor a comparison ({COMPARISON})",
            of.display()
        )));
    } else {
        arguments.plan(of, None)?
    };
    page.notes.extend(arguments.obstacle.iter().map(|why| format!("There is no replay: {why}.")));
    let task = task.filter(|_| !arguments.no_replay && arguments.obstacle.is_none());
    let (mut replayed, mut remarks) = (None, Vec::new());
    if let Some(task) = &task {
        let film = Film::new(task, PERIOD_S, Recorder::most_bytes)?.with_arm();
        let mut recorder = Recorder::new(&film.bench());
        let found = film.shoot(&mut recorder, context)?;
        page.replay = recorder.into_replay();
        let amounts = Amounts::from(&task.scene);
        let outcome = Outcome::of_evaluation(&amounts, &found);
        // Of a plan the page says what the plan says: the smaller cells come first, where it was looked at there.
        if !matches!(task.motion, Motion::Plan { .. }) || page.figures.is_empty() {
            show_outcome(&mut page, task, &amounts, &outcome);
        }
        replayed = Some(outcome);
        remarks = film.obstacles().into_iter().chain(film.disagreement(&found)).collect();
        remarks.iter().for_each(|remark| doubt(&mut page, remark));
    }
    page.write(&path)?;
    let executed = task.as_ref().and_then(Task::executed);
    if arguments.json {
        return context.json(&Report { page: &path, run: finding, replayed, executed, remarks });
    }
    match (finding, &page.verdict) {
        // Of a run that is not finished the page knows of a plan that it may have all the same.
        (Some(Finding { plan: None, .. }), Some((_, verdict))) => writeln!(context.out, "{verdict}")?,
        (Some(finding), _) => writeln!(context.out, "{}", finding.headline())?,
        (None, _) => {}
    }
    if let Some((executed, (_, verdict))) = executed.zip(page.verdict) {
        write!(context.out, "{verdict}\n{}", executed.text())?;
    }
    writeln!(context.out, "The page is {}: open it in a browser.", path.display())?;
    Ok(())
}

impl ReportArgs {
    /// Where the page will be: looked at before anything is simulated.
    fn page(&self) -> Result<PathBuf, CliError> {
        let of = &self.of;
        let usual = || if of.is_dir() { of.join(REPORT) } else { of.with_file_name(REPORT) };
        let path = self.out.clone().unwrap_or_else(usual);
        if path.is_dir() {
            return Err(CliError::Input(format!(
                "{} is a folder; the name of the page, such as {}, would be right",
                path.display(),
                path.join(REPORT).display()
            )));
        }
        if let Some(folder) = self.out.as_deref().and_then(Path::parent) {
            fs::create_dir_all(folder).map_err(of_file(folder, "created"))?;
        }
        Ok(path)
    }

    /// What is to be replayed of a plan, with the arm's motion where there is a record of it.
    fn task(&self, plan: &Path) -> Result<Task, CliError> {
        let executed = self.executed.clone();
        MotionArgs { executed, ..MotionArgs::of_plan(plan, self.resources) }.task()
    }

    /// With what its run found, if that is known already.
    fn plan(&self, path: &Path, known: Option<Finding>) -> Result<Draft, CliError> {
        let bytes = read_plan_file(path)?;
        let plan = parse_plan(path, &bytes)?;
        let task = self.task(path)?;
        let finding = known.or_else(|| run_of(path, &plan));
        let (amounts, outcome) = Outcome::finest_of_plan(&Amounts::from(&task.scene), plan.header());
        let mut facts = scene_facts(&task.scene);
        facts.extend(plan_facts(&plan));
        facts.extend(date(path));
        let page = Page {
            title: format!("{}: a plan", task.scene.name),
            verdict: Some(verdict(&amounts, &outcome, &on(plan.header()))),
            figures: figures_of_plan(&amounts, &outcome, &task.scene, plan.header()),
            replay_shows: shows(&task, finding.as_ref().and_then(|finding| finding.epoch)),
            tables: vec![parameters(&plan)],
            facts,
            notes: notes(finding.as_ref(), plan.header(), task.executed()),
            ..Page::default()
        };
        Ok(Draft { page, task: Some(task), finding })
    }

    fn run(&self) -> Result<Draft, CliError> {
        let record = RunRecord::read(&self.of)?;
        let finding = record.finding();
        let title =
            format!("{}, seed {}, {}", record.scene.name, record.state.seed, record.state.precision.name());
        let plan = self.of.join(PLAN);
        let mut draft = match (record.shipped, plan.exists()) {
            (Some(_), _) => self.plan(&plan, finding.clone())?,
            (None, true) => {
                let mut draft = self.plan(&plan, None)?;
                if let Some((_, verdict)) = draft.page.verdict.take() {
                    let words = format!("The run is not finished; the plan as it is now: {verdict}");
                    draft.page.verdict = Some((Tone::Plain, words));
                }
                draft
            }
            (None, false) => {
                if let Some(executed) = &self.executed {
                    return Err(CliError::Input(format!(
                        "--executed is {}, but the run in {} has no plan yet that it could be of",
                        executed.display(),
                        self.of.display()
                    )));
                }
                let page = Page {
                    verdict: Some((Tone::Plain, "The run is not finished: there is no plan yet.".into())),
                    facts: scene_facts(&record.scene),
                    ..Page::default()
                };
                Draft { page, task: None, finding: None }
            }
        };
        draft.page.title = title;
        if let Some(finding) = &finding {
            draft.page.charts = run_charts(&record, finding);
            draft.page.tables.push(epochs(&record.epochs, finding));
            if finding.plan.is_none() {
                draft.page.notes.extend(finding.sentences());
            }
            draft
                .page
                .notes
                .extend(finding.advice.iter().map(|advice| format!("What could help: {advice}.")));
            draft.page.facts.extend(run_facts(&record, finding));
        }
        Ok(Draft { finding, ..draft })
    }

    fn comparison(&self) -> Result<Draft, CliError> {
        if self.executed.is_some() {
            return Err(CliError::Input(
                "--executed goes with a plan or a run, not with a comparison".into(),
            ));
        }
        let experiment = Experiment::look(&self.of, self.resources)?;
        let comparison = experiment.so_far()?;
        let best = experiment.best_motion(&comparison);
        let (task, whose) = best.map_or((None, None), |(task, whose)| (Some(task), Some(whose)));
        let page = Page {
            title: format!("{}: comparison of methods", comparison.scene),
            replay_shows: whose
                .map(|whose| format!("The skill with the lowest loss of all: {whose}."))
                .unwrap_or_default(),
            charts: comparison_charts(&comparison),
            tables: vec![summary(&experiment, &comparison)],
            facts: scene_facts(experiment.scene()).into_iter().chain(date(&self.of.join(COMPARISON))).collect(),
            notes: std::iter::once(
                "Curves are means over the seeds of the best motion found so far, bands one standard deviation.".into(),
            )
            .chain(unfinished(&experiment.left()?))
            .collect(),
            ..Page::default()
        };
        Ok(Draft { page, task, finding: None })
    }
}

/// What a page says of a plan: of which cells its figures are, and what the run found where that is at hand.
fn notes(finding: Option<&Finding>, header: &PlanHeader, executed: Option<&ExecutedReport>) -> Vec<String> {
    let own = mass(header.predicted.arrives_kg());
    let of_which = header.finer.map(|finer| match executed {
        None => format!(
            "The figures are those on {}; on the scene's own, which the replay shows, the plan brings {own}.",
            cells(finer.cell_m),
        ),
        Some(_) => format!(
            "The figures are those of the executed motion on the scene's own cells, where the plan predicts {own}; on {} it predicts {}.",
            cells(finer.cell_m),
            mass(finer.arrives_kg())
        ),
    });
    let of_motion = executed.map(ExecutedReport::text).unwrap_or_default();
    let of_motion = of_motion.lines().map(String::from).collect::<Vec<_>>();
    let of_run = finding.iter().flat_map(|finding| finding.sentences());
    of_which.into_iter().chain(of_motion).chain(of_run).collect()
}

/// Says at the top of a page what keeps its motion from being what it seems.
fn doubt(page: &mut Page, remark: &str) {
    let remark = capitalised(remark);
    let before = page.verdict.take().map(|(_, words)| words + " But: ").unwrap_or_default();
    page.verdict = Some((Tone::Bad, before + &remark));
}

/// What is replayed, above the replay.
fn shows(task: &Task, epoch: Option<u32>) -> String {
    let skill = epoch.map(|epoch| format!(", the skill of epoch {epoch}")).unwrap_or_default();
    match task.motion {
        Motion::Executed { .. } => {
            format!("The motion that the arm made of the plan{skill}; the plan's own is drawn over it.")
        }
        Motion::Plan { .. } => format!("The plan as shipped{skill}."),
        Motion::Skill(..) => "One skill.".into(),
    }
}

/// On which cells a plan is judged, if not on the scene's own.
fn on(header: &PlanHeader) -> String {
    header.finer.map_or(String::new(), |finer| format!(" on {}", cells(finer.cell_m)))
}

/// Whether an outcome is what was asked for, and on which cells.
fn verdict(amounts: &Amounts, outcome: &Outcome, on: &str) -> (Tone, String) {
    let off = amounts.off(outcome.census.target);
    match amounts.is_met(outcome.census.target) {
        Some(true) => {
            (Tone::Good, format!("Brings the wanted amount{on}: {off}, within {}.", amounts.tolerance()))
        }
        Some(false) => {
            (Tone::Bad, format!("Misses the wanted amount{on}: {off}, more than {}.", amounts.tolerance()))
        }
        None => (Tone::Plain, "As much as can be had was wanted.".into()),
    }
}

fn figures(amounts: &Amounts, outcome: &Outcome) -> Vec<Figure> {
    let tone = match amounts.is_met(outcome.census.target) {
        Some(true) => Tone::Good,
        Some(false) => Tone::Bad,
        None => Tone::Plain,
    };
    let sign = if outcome.miss < 0.0 { "-" } else { "+" };
    vec![
        Figure::new("Wanted", &mass(amounts.wanted_kg)).with_note(&counted(amounts.wanted_particles)),
        Figure::new("Arrives", &mass(outcome.mass_kg)).with_note(&counted(outcome.census.target)),
        Figure::new("Error", &format!("{sign}{}", percent(outcome.miss.abs()))).toned(tone),
        Figure::new("Lost", &mass(outcome.lost_kg)).with_note(&counted(outcome.census.lost())),
        Figure::new("Loss", &format!("{:.3} m", outcome.loss_m)),
    ]
}

/// Those of a plan. What it brings on the scene's own cells stands for the loss where it is judged by smaller ones, of whose many particles
/// the loss is a sum.
fn figures_of_plan(amounts: &Amounts, outcome: &Outcome, scene: &Scene, header: &PlanHeader) -> Vec<Figure> {
    let mut shown = figures(amounts, outcome);
    if let Some(finer) = header.finer {
        let of = |cell_m: f64| format!("on {}", cells(cell_m));
        let own = mass(header.predicted.arrives_kg());
        shown[1].note = format!("{}, {}", shown[1].note, of(finer.cell_m));
        shown.pop();
        shown.push(Figure::new("On the scene's own cells", &own).with_note(&of(scene.domain.cell_m)));
    }
    shown
}

/// Puts what a replay showed at the top of the page; what a plan predicted stays beside it.
fn show_outcome(page: &mut Page, task: &Task, amounts: &Amounts, outcome: &Outcome) {
    let mut shown = figures(amounts, outcome);
    let (tone, words) = match &task.motion {
        Motion::Executed { header, .. } => {
            let planned = mass(header.predicted.arrives_kg());
            shown[1].note = format!("{}; the plan predicts {planned}", shown[1].note);
            let on = if header.finer.is_some() { " on the scene's own cells" } else { "" };
            let (tone, words) = verdict(amounts, outcome, on);
            (tone, format!("As executed. {words}"))
        }
        _ => verdict(amounts, outcome, ""),
    };
    page.verdict = Some((tone, words));
    page.figures = shown;
}

/// The skill in physical units.
fn parameters(plan: &PlanReader<'_>) -> Table {
    let header = plan.header();
    let row = |which: SkillParameter| {
        vec![
            which.name().into(),
            parameter(which, header.skill_parameters[which.index()]),
            format!("{:.4}", header.theta[which.index()]),
        ]
    };
    Table {
        title: match header.path_coefficients {
            0 => "Skill of the plan".into(),
            _ => "Skill near which the plan's motion is a path".into(),
        },
        columns: ["parameter", "value", "theta"].map(String::from).into(),
        rows: SkillParameter::ALL.into_iter().map(row).map(Into::into).collect(),
    }
}

fn fact(name: &str, value: impl Into<String>) -> (String, String) {
    (name.into(), value.into())
}

fn scene_facts(scene: &Scene) -> Vec<(String, String)> {
    let powder = &scene.powder;
    let amounts = Amounts::from(scene);
    vec![
        fact("Scene", &scene.name),
        fact("Scene digest", hex(&scene.digest())),
        fact(
            "Powder",
            format!(
                "{} in {} of {}: {} kg/m^3, friction {} deg, cohesion {} Pa",
                mass(scene.particle_count() as f64 * amounts.particle_mass_kg),
                counted(scene.particle_count() as u32),
                mass(amounts.particle_mass_kg),
                powder.density_kg_m3,
                powder.friction_angle_deg,
                powder.cohesion_pa
            ),
        ),
        fact("From, to", format!("{}, {}", scene.objective.source, scene.objective.target)),
        fact("Cells", format!("{} mm", about(1e3 * scene.domain.cell_m, 3))),
        fact("Tool carries", format!("about {} heaped", mass(scene.tool_capacity().heaped_kg))),
    ]
}

fn plan_facts(plan: &PlanReader<'_>) -> Vec<(String, String)> {
    let header = plan.header();
    let version = header.optimiser_version;
    let limits = match plan.check_limits() {
        Ok(used) => [
            ("velocity", used.linear_velocity, used.angular_velocity),
            ("acceleration", used.linear_acceleration, used.angular_acceleration),
            ("jerk", used.linear_jerk, used.angular_jerk),
        ]
        .map(|(name, linear, angular)| {
            format!("{name} {} linear, {} angular", percent(linear), percent(angular))
        })
        .join("; "),
        Err(broken) => format!("broken: {broken}"),
    };
    let duration_s = f64::from(header.step_count) * f64::from(header.control_period_us) * 1e-6;
    vec![
        fact("Plan", format!("{:016x}", plan.content_hash())),
        fact("Motion", format!("{duration_s:.2} s in steps of {} us", header.control_period_us)),
        fact("Limits used", limits),
        fact("Made by", format!("optimise {}.{}.{}", version.major, version.minor, version.patch)),
    ]
}

/// When a file was written, to the minute; nothing where the system does not tell.
fn date(of: &Path) -> Option<(String, String)> {
    let written = fs::metadata(of).and_then(|file| file.modified()).ok()?;
    let stamp = humantime::format_rfc3339_seconds(written).to_string();
    let (day, time) = stamp.split_once('T')?;
    Some(fact("Date", format!("{day}, {} UTC", time.get(..5)?)))
}

fn run_facts(record: &RunRecord, finding: &Finding) -> Vec<(String, String)> {
    let seconds: f64 = record.epochs.iter().map(|epoch| epoch.record.seconds).sum();
    let Work { coarse_rollouts, rollouts, adjoints, cpu_seconds } = finding.work;
    let simulated = [(coarse_rollouts, "coarse rollout"), (rollouts, "rollout"), (adjoints, "adjoint")]
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .map(|(many, what)| count(many.into(), what))
        .collect::<Vec<_>>()
        .join(", ");
    vec![
        fact("Search", record.state.settings.method.name()),
        fact("Epochs", format!("0 to {}, in {}", record.epochs.len() - 1, duration(seconds))),
        fact("Simulated", format!("{simulated}, in {} of processor time", duration(cpu_seconds))),
        fact("Physics", format!("version {}", record.state.physics)),
    ]
}

fn over_epochs(name: &str, epochs: &[Judged], value: impl Fn(&EpochRecord) -> f64) -> Series {
    Series::new(
        name,
        epochs.iter().map(|Judged { record, .. }| [f64::from(record.epoch), value(record)]).collect(),
    )
}

/// A curve for each of the five parameters.
fn by_parameter(epochs: &[Judged], value: impl Fn(&EpochRecord) -> [Option<f64>; 5]) -> Vec<Series> {
    let series = |which: SkillParameter| {
        over_epochs(which.name(), epochs, |record| value(record)[which.index()].unwrap_or(f64::NAN))
    };
    SkillParameter::ALL.into_iter().map(series).collect()
}

/// Marks the shipped epoch, those passed over, and those of the coarse world.
fn marked(mut chart: Chart, finding: &Finding) -> Chart {
    if let Some(epoch) = finding.epoch.filter(|epoch| finding.is_shipped(*epoch)) {
        chart = chart.marked(f64::from(epoch), chosen(finding));
    }
    for passed in &finding.passed_over {
        chart = chart.marked(f64::from(passed.epoch), Mark::passed_over(&passed.reason));
    }
    match finding.coarse_epochs.last() {
        None => chart,
        Some(last) => chart.shaded(0.0, f64::from(*last), "in a coarse copy of the scene"),
    }
}

/// What became of the epoch that the search left.
fn chosen(finding: &Finding) -> Mark {
    if finding.is_corrected() { Mark::corrected() } else { Mark::shipped() }
}

fn run_charts(record: &RunRecord, finding: &Finding) -> Vec<Chart> {
    let epochs = &record.epochs;
    let grams = |record: &EpochRecord| 1e3 * finding.amounts.kg(record.census.target);
    let wanted = |_: &EpochRecord| 1e3 * finding.amounts.wanted_kg;
    let parameters = |unit: &str, scale: f64| {
        SkillParameter::ALL
            .into_iter()
            .filter(|which| which.unit() == unit)
            .map(|which| {
                let value = |epoch: &EpochRecord| scale * record.map.parameters(&epoch.theta)[which.index()];
                over_epochs(which.name(), epochs, value).coloured(which.index())
            })
            .collect()
    };
    let of_slopes = |value: fn(&Slopes) -> &[f64]| {
        move |record: &EpochRecord| -> [Option<f64>; 5] {
            std::array::from_fn(|k| record.slopes.as_ref().and_then(|slopes| value(slopes).get(k).copied()))
        }
    };
    let is_rounded = epochs.iter().all(|epoch| epoch.record.rounded || epoch.record.world == World::Coarse);
    let before = if is_rounded { "" } else { ", before rounding to whole counts" };
    let mut charts = vec![
        Chart::new(
            "Powder that arrives",
            "epoch",
            &format!("mass, g{before}"),
            vec![
                over_epochs("arrives", epochs, grams),
                Series { reference: true, ..over_epochs("wanted", epochs, wanted) },
            ],
        ),
        Chart::new(
            "Loss",
            "epoch",
            &format!("loss, m{before}"),
            vec![over_epochs("loss", epochs, |record| record.loss)],
        )
        .scaled(Scale::LogIfWide),
        Chart::new("Skill: lengths", "epoch", "mm", parameters("m", 1e3)),
        Chart::new("Skill: angles", "epoch", "deg", parameters("rad", 180.0 / std::f64::consts::PI)),
    ];
    if epochs.iter().any(|epoch| epoch.record.slopes.is_some()) {
        let gradient = by_parameter(epochs, of_slopes(|slopes| &slopes.gradient));
        let weight = by_parameter(epochs, of_slopes(|slopes| &slopes.first_order_weight));
        charts.push(Chart::new("Gradient", "epoch", "loss by theta, m", gradient));
        charts.push(
            Chart::new("Weight of the adjoint in the gradient", "epoch", "weight, 0 to 1", weight)
                .scaled(Scale::Share),
        );
    }
    charts.into_iter().map(|chart| marked(chart, finding)).collect()
}

fn epochs(epochs: &[Judged], finding: &Finding) -> Table {
    let columns =
        ["epoch", "world", "arrives", "particles", "error", "lost", "loss, m", "rollouts", "seconds"];
    let amounts = &finding.amounts;
    let row = |Judged { record, obstacle }: &Judged| PageRow {
        cells: vec![
            record.epoch.to_string(),
            if record.world == World::Coarse { "coarse" } else { "the scene" }.into(),
            amounts.mass(record.census.target),
            record.census.target.to_string(),
            amounts.off(record.census.target),
            amounts.mass(record.census.lost()),
            format!("{:.3}", record.loss),
            (record.work.rollouts + record.work.coarse_rollouts).to_string(),
            format!("{:.1}", record.seconds),
        ],
        mark: match obstacle {
            Some(reason) => Some(Mark::passed_over(reason)),
            None => finding.is_shipped(record.epoch).then(|| chosen(finding)),
        },
        link: None,
    };
    Table {
        title: "Epochs: of each the motion that stands for it".into(),
        columns: columns.map(String::from).into(),
        rows: epochs.iter().map(row).collect(),
    }
}

fn comparison_charts(comparison: &Comparison) -> Vec<Chart> {
    let panel = |title: &str, panel: crate::compare::figure::Panel| {
        let series = panel.bands.into_iter().map(|band| Series {
            name: band.name,
            points: band.points.iter().map(|[x, mean, _]| [*x, *mean]).collect(),
            band: Some(band.points.iter().map(|[_, mean, spread]| [mean - spread, mean + spread]).collect()),
            ..Series::default()
        });
        let scale = if panel.log_if_wide { Scale::LogIfWide } else { Scale::Linear };
        Chart::new(title, panel.x_name, panel.y_name, series.collect()).scaled(scale)
    };
    vec![
        panel("Powder that the best skill so far misses", comparison.by_number()),
        panel("Lowest loss so far", comparison.by_time()),
    ]
}

/// Which searches of a comparison are not in it, or not whole.
fn unfinished(left: &[String]) -> Option<String> {
    (!left.is_empty()).then(|| {
        format!(
            "The comparison is not whole: {} not at the end of the rollouts yet: {}.",
            if left.len() == 1 { "a search is".into() } else { format!("{} searches are", left.len()) },
            left.join(", ")
        )
    })
}

fn summary(experiment: &Experiment, comparison: &Comparison) -> Table {
    Table {
        title: "Summary".into(),
        columns: Row::headings(experiment.budgets()),
        rows: experiment.rows(comparison).iter().map(|row| row.cells().into()).collect(),
    }
}
