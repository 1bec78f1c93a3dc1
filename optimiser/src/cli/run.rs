//! `optimise run`: the optimisation, from a scene (or a run to resume) to a plan.

use super::{
    CliError, Context, Interrupt, Progress, Resources, check, next,
    options::{DEFAULT_PRECISION, PrecisionArg},
};
use crate::{
    optim::{Answer, EpochRecord, Method, Request, Search, SearchError, Step, initial_theta},
    report::{
        amounts::Amounts,
        curves::Curves,
        finding::{Finding, Outcome},
        folder::{CURVES, METRICS, PLAN, RunFolder, SCENE, STATE},
        plan::PlanParts,
        record::RunRecord,
        state::RunState,
        words::hex,
    },
};
use clap::Args;
use powderline_shared::plan::{Mounting, Precision};
use powderline_simulator::{
    arm::arm_motion,
    rollout::{self, Evaluation, Places, RolloutError, Simulate, restart::Restarts},
    scene::{DEFAULT_SCENE, GradientEstimator, Scene},
    skill::{QuantisedControls, SkillMap, Theta, ThetaGradient, colliding_skill},
};
use serde::Serialize;
use std::{
    collections::BTreeMap,
    io::Write,
    path::{Path, PathBuf},
};

/// Arguments of `optimise run`.
#[derive(Clone, Debug, Args)]
pub struct RunArgs {
    /// Scene: the name of an embedded one (bench, bench-small, bench-fine, vial, workcell) or a TOML file [default: bench]
    #[arg(value_name = "SCENE")]
    pub scene: Option<String>,
    /// Seed of the packing and of the first skill [default: 1]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Updates to make; each epoch is evaluated, and the result of the last, so N updates take N + 1 evaluations
    /// [default: the scene's]
    #[arg(long, value_name = "N")]
    pub epochs: Option<u32>,
    /// Precision of the simulation [default: f32]
    #[arg(long)]
    pub precision: Option<PrecisionArg>,
    /// Threads and memory.
    #[command(flatten)]
    pub resources: Resources,
    /// Folder to write into, new or without a run; by default `runs/<scene>-seed<seed>`, numbered if taken
    #[arg(long, value_name = "DIR", conflicts_with = "resume")]
    pub out: Option<PathBuf>,
    /// Go on with the run in this folder; with a larger --epochs also when it is finished
    #[arg(long, value_name = "DIR")]
    pub resume: Option<PathBuf>,
    /// Print what was found as one JSON object
    #[arg(long)]
    pub json: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report<'a> {
    folder: &'a Path,
    plan: PathBuf,
    #[serde(flatten)]
    finding: &'a Finding,
}

/// A line of `metrics.jsonl`.
#[derive(Serialize)]
struct Line<'a> {
    #[serde(flatten)]
    record: &'a EpochRecord,
    /// What arrives, kilogram, and how far that is off the wanted mass, relative.
    mass_kg: f64,
    miss: f64,
    /// What is lost, and all the powder by where it is, kilogram.
    lost_kg: f64,
    powder_kg: Places<f64>,
    /// Why the arm may not perform the motion.
    passed_over: Option<&'a str>,
    /// Whether the plan is made of it.
    shipped: bool,
}

/// Most epochs of a run.
pub const MAX_EPOCHS: u32 = 100_000;

/// Time of a gradient, in evaluations without one; for the progress bar.
const GRADIENT_COST: f64 = 5.4;

/// Is told of each epoch when it is saved: its line of `metrics.jsonl`.
pub type EpochFn<'a> = &'a dyn Fn(&str);

/// A run whose folder is open and locked.
struct Run<'a> {
    folder: RunFolder,
    on_epoch: EpochFn<'a>,
    method: Method,
    record: RunRecord,
    /// What epochs' motions bring once they are rounded to whole counts, as far as that was asked.
    rounded: BTreeMap<usize, Evaluation>,
}

/// A skill, its motion in whole counts, and what that brings.
struct Performed {
    theta: Theta,
    quantised: QuantisedControls,
    evaluation: Evaluation,
}

/// A run and the simulator for it.
type Begun<'a> = (Run<'a>, Box<dyn Simulate>);

/// What to run, and who is told.
#[derive(Clone, Copy)]
struct Order<'a> {
    arguments: &'a RunArgs,
    /// A scene that is at hand, instead of the one that the arguments name.
    scene: Option<&'a Scene>,
    on_epoch: EpochFn<'a>,
}

impl<'a> Order<'a> {
    fn new(arguments: &'a RunArgs) -> Self {
        Self { arguments, scene: None, on_epoch: &|_| {} }
    }
}

fn simulator(
    arguments: &RunArgs,
    scene: &Scene,
    state: &RunState,
    context: &Context<'_>,
) -> Result<Box<dyn Simulate>, CliError> {
    let setup = arguments.resources.setup(state.seed, state.precision);
    if !state.finished {
        setup.check_memory(scene, rollout::Workload::Gradient, 0)?;
    }
    Ok((context.factory)(scene, &setup)?)
}

/// Runs the command.
///
/// # Errors
/// One sentence; everything evaluated before is saved.
pub(super) fn execute(arguments: &RunArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    Order::new(arguments).execute(context)
}

/// `optimise run` for programs: of the scene at hand, if there is one, instead of the one that the arguments name.
///
/// # Errors
/// One sentence; everything evaluated before is saved.
pub fn run(
    arguments: &RunArgs,
    scene: Option<&Scene>,
    on_epoch: EpochFn<'_>,
    context: &mut Context<'_>,
) -> Result<(), CliError> {
    Order { arguments, scene, on_epoch }.execute(context)
}

impl Order<'_> {
    fn execute(&self, context: &mut Context<'_>) -> Result<(), CliError> {
        let (mut run, mut simulator) = match &self.arguments.resume {
            Some(folder) => Run::resume(*self, folder, context)?,
            None => Run::start(*self, context)?,
        };
        run.go_on(simulator.as_mut(), context)?;
        run.conclude(self.arguments.json, context)
    }
}

/// The epochs of a run that is begun, gone on with, or only looked at, as its folder (`out`) needs it.
///
/// # Errors
/// One sentence; everything evaluated before is saved.
pub(super) fn completed(
    arguments: &RunArgs,
    context: &mut Context<'_>,
) -> Result<Vec<EpochRecord>, CliError> {
    let begun = arguments.out.as_deref().filter(|folder| folder.join(STATE).exists());
    let (mut run, mut simulator) = match begun {
        Some(folder) => Run::resume(Order::new(arguments), folder, context)?,
        None => Run::start(Order::new(arguments), context)?,
    };
    if !run.record.state.finished {
        match run.complete(simulator.as_mut(), context) {
            // A comparison asks what was found, not whether the arm may perform it.
            Err(error) if !(run.record.state.search.is_done() && run.finding()?.epoch.is_none()) => {
                return Err(error);
            }
            _ => {}
        }
    }
    Ok(run.record.state.search.history().to_vec())
}

impl<'a> Run<'a> {
    /// Makes the simulator before the folder: what it refuses leaves nothing behind.
    fn start(order: Order<'a>, context: &Context<'_>) -> Result<Begun<'a>, CliError> {
        let Order { arguments, on_epoch, .. } = order;
        let (name, scene) = match order.scene {
            Some(scene) => (scene.name.as_str(), scene.clone()),
            None => {
                let name = arguments.scene.as_deref().unwrap_or(DEFAULT_SCENE);
                (name, Scene::load(name)?)
            }
        };
        if let Some(why) = check::infeasible(&scene) {
            return Err(CliError::Input(format!("{name}: {why}")));
        }
        let map = SkillMap::new(&scene);
        map.check_all_corners().map_err(|error| CliError::Input(format!("{name}: {error}")))?;
        let seed = arguments.seed.unwrap_or(scene.powder.seed);
        let epochs = checked_epochs(arguments.epochs.unwrap_or(scene.optimiser.epochs))?;
        let precision = arguments.precision.map_or(DEFAULT_PRECISION, Precision::from);
        let search = Search::new(initial_theta(&scene.skill.initial_theta, seed), epochs);
        let state = RunState::new(scene.digest(), seed, precision, search);
        let simulator = simulator(arguments, &scene, &state, context)?;
        let folder = match &arguments.out {
            Some(path) => RunFolder::create(path)?,
            None => RunFolder::create_numbered(
                &Path::new("runs").join(format!("{}-seed{seed}", safe_name(&scene.name))),
            )?,
        };
        folder.replace(SCENE, scene.to_toml().as_bytes())?;
        // A scene without a state would be in the way of a second attempt, and nothing to resume from either.
        folder.replace(STATE, &state.to_bytes()).inspect_err(|_| folder.discard(SCENE))?;
        let method = Method::new(&scene, seed);
        let record = RunRecord::new(scene, state);
        Ok((Self { folder, on_epoch, method, record, rounded: BTreeMap::new() }, simulator))
    }

    fn resume(order: Order<'a>, path: &Path, context: &Context<'_>) -> Result<Begun<'a>, CliError> {
        let Order { arguments, on_epoch, .. } = order;
        let folder = RunFolder::open(path)?;
        let mut record = RunRecord::read(path)?;
        refuse_differences(arguments, path, &record.state)?;
        if let Some(epochs) = arguments.epochs {
            prolong(&mut record, checked_epochs(epochs)?)?;
        }
        record.map.check_all_corners()?;
        let simulator = simulator(arguments, &record.scene, &record.state, context)?;
        let method = Method::new(&record.scene, record.state.seed);
        let run = Self { folder, on_epoch, method, record, rounded: BTreeMap::new() };
        // The state leads: a line too many or too few, from a run that was ended between two writes, is put right.
        run.write_metrics()?;
        run.folder.replace(STATE, &run.record.state.to_bytes())?;
        Ok((run, simulator))
    }

    /// What is left to do of it.
    fn go_on(&mut self, simulator: &mut dyn Simulate, context: &mut Context<'_>) -> Result<(), CliError> {
        if self.record.state.finished {
            let (path, search) = (self.folder.path().display(), &self.record.state.search);
            let prolongs = match search.is_settled() {
                true => "the amount was met and nothing more gained; in a scene with optimiser.patience_epochs = 0 a run goes on to the last epoch".into(),
                false => format!("--epochs with more than {} prolongs it", search.epochs()),
            };
            writeln!(context.err, "The run in {path} is finished; {prolongs}.")?;
            return Ok(());
        }
        let resumable =
            format!("the epochs before are saved, go on with: {}", resume_command(self.folder.path()));
        self.complete(simulator, context).map_err(|error| error.with_remark(&resumable))
    }

    /// Evaluates the epochs that are left, then writes the plan.
    fn complete(&mut self, simulator: &mut dyn Simulate, context: &mut Context<'_>) -> Result<(), CliError> {
        let RunState { seed, precision, .. } = self.record.state;
        let progress = Progress::new(&context.err, context.live);
        simulator.set_progress(progress.watch(&context.interrupt));
        progress.line(&format!(
            "{}: seed {seed}, {}, into {}",
            self.record.scene.name,
            precision.name(),
            self.folder.path().display()
        ));
        if let Some((theta, collision)) = colliding_skill(&self.record.scene) {
            progress.line(&format!("skills such as theta = {theta} are passed over: {collision}"));
        }
        let result = self
            .search(simulator, &progress, &context.interrupt)
            .and_then(|performed| self.write_plan(&performed));
        progress.clear();
        result
    }

    /// Epochs until one is found whose motion brings the wanted amount also in whole counts, or until the last.
    fn search(
        &mut self,
        simulator: &mut dyn Simulate,
        progress: &Progress,
        interrupt: &Interrupt,
    ) -> Result<Performed, CliError> {
        loop {
            self.evaluate_epochs(simulator, progress, interrupt)?;
            let performed = self.performed(simulator, progress, interrupt)?;
            let amounts = Amounts::from(&self.record.scene);
            let search = &mut self.record.state.search;
            if !search.is_settled() || amounts.is_met(performed.evaluation.census.target) == Some(true) {
                return Ok(performed);
            }
            progress
                .line("  rounded to whole counts, no motion stays within the tolerance: the search goes on");
            search.unsettle();
        }
    }

    fn evaluate_epochs(
        &mut self,
        simulator: &mut dyn Simulate,
        progress: &Progress,
        interrupt: &Interrupt,
    ) -> Result<(), CliError> {
        let epochs = self.record.state.search.epochs();
        while let Some(request) = self.record.state.search.next(&self.method) {
            let task = format!("epoch {}/{epochs}", request.epoch);
            progress.begin(&task, epochs - request.epoch, self.record.state.search.history());
            let mut work = Work { simulator: &mut *simulator, interrupt };
            let (answer, rings) = self.evaluate_epoch(&request, &mut work)?;
            self.save_epoch(&answer, &rings, progress)?;
        }
        Ok(())
    }

    /// Where the adjoint restarts, if the scene asks for one that does.
    fn restarts(&self, theta: &Theta) -> Option<Restarts> {
        let scene = &self.record.scene;
        let asked = scene.optimiser.gradient == GradientEstimator::Restarted;
        asked.then(|| Restarts::of_skill(scene, &SkillMap::new(scene), theta))
    }

    /// The answer for the skill, and the losses of the probes that it makes necessary, ring by ring.
    fn evaluate_epoch(
        &self,
        request: &Request,
        work: &mut Work<'_>,
    ) -> Result<(Answer, Vec<Vec<f64>>), CliError> {
        let cost = if request.want_gradient { GRADIENT_COST } else { 1.0 };
        let share = |done: f64, probes: usize| done / (cost + probes as f64);
        let search = &self.record.state.search;
        let thetas = |adjoint: Option<&ThetaGradient>| {
            search.probes(&self.method, adjoint).into_iter().map(|probe| probe.theta)
        };
        let (answer, probes) = if request.want_gradient {
            let (evaluation, adjoint) = work.evaluate_with_gradient(
                &request.theta,
                self.restarts(&request.theta).as_ref(),
                share(cost, request.probes),
            )?;
            let probes: Vec<Theta> = thetas(Some(&adjoint)).collect();
            let answer = Answer { evaluation, adjoint: Some(adjoint) };
            (answer, work.evaluate_all(&probes, share(cost, probes.len()))?)
        } else {
            let all: Vec<Theta> = std::iter::once(request.theta).chain(thetas(None)).collect();
            let mut evaluations = work.evaluate_all(&all, 0.0)?;
            (Answer { evaluation: evaluations.remove(0), adjoint: None }, evaluations)
        };
        let losses = |probes: Vec<Evaluation>| probes.iter().map(|evaluation| evaluation.loss).collect();
        let mut rings: Vec<Vec<f64>> = vec![losses(probes)];
        loop {
            let wider = search.wider(&self.method, &answer, &rings)?;
            if wider.is_empty() {
                return Ok((answer, rings));
            }
            let thetas: Vec<Theta> = wider.into_iter().map(|probe| probe.theta).collect();
            rings.push(losses(work.evaluate_all(&thetas, 0.0)?));
        }
    }

    fn save_epoch(
        &mut self,
        answer: &Answer,
        rings: &[Vec<f64>],
        progress: &Progress,
    ) -> Result<(), CliError> {
        let seconds = (progress.seconds() * 1e3).round() / 1e3;
        let record = *self.record.state.search.record(&self.method, answer, rings, seconds)?;
        self.record.push(record);
        let finding = self.finding()?;
        if finding.is_settled() && !self.record.state.search.is_done() {
            self.record.state.search.settle();
        }
        let search = &self.record.state.search;
        let last = if search.is_done() { record.epoch } else { search.epochs() };
        progress.epoch(&record, &finding.amounts, [last, search.epochs()], search.history());
        self.say_step(&record, progress);
        let line = self.line(&finding, &record);
        self.folder.append(METRICS, line.as_bytes())?;
        self.folder.replace(STATE, &self.record.state.to_bytes())?;
        self.write_curves(&finding)?;
        (self.on_epoch)(&line);
        Ok(())
    }

    /// Says where the search had to look farther than usual.
    fn say_step(&self, record: &EpochRecord, progress: &Progress) {
        let usual = self.method.estimator.half_step;
        let widest = record.half_step.unwrap_or(usual);
        match record.step {
            Step::Restart => progress.line(&format!(
                "  no parameter leads anywhere, over +-{widest} of theta: the search begins anew from another skill"
            )),
            Step::Update if widest > usual => progress.line(&format!(
                "  noise was all that +-{usual} of theta showed: the step goes by differences over +-{widest}"
            )),
            Step::Update | Step::None => {}
        }
    }

    /// What the run has found so far.
    fn finding(&self) -> Result<Finding, CliError> {
        self.record.finding().ok_or_else(|| CliError::Failed("the run has no epoch yet".into()))
    }

    fn line(&self, finding: &Finding, record: &EpochRecord) -> String {
        let outcome = Outcome::of_epoch(&finding.amounts, record);
        json_line(&Line {
            record,
            mass_kg: outcome.mass_kg,
            miss: outcome.miss,
            lost_kg: outcome.lost_kg,
            powder_kg: outcome.powder_kg,
            passed_over: finding.obstacle(record.epoch),
            shipped: finding.is_shipped(record.epoch),
        })
    }

    fn write_metrics(&self) -> Result<(), CliError> {
        let lines: String = self.record.finding().map_or(String::new(), |finding| {
            self.record.epochs.iter().map(|epoch| self.line(&finding, &epoch.record)).collect()
        });
        Ok(self.folder.replace(METRICS, lines.as_bytes())?)
    }

    fn write_curves(&self, finding: &Finding) -> Result<(), CliError> {
        let search = &self.record.state.search;
        let curves = Curves {
            title: [
                &format!("{}, seed {}", self.record.scene.name, self.record.state.seed),
                &finding.headline(),
            ],
            history: search.history(),
            epochs: search.epochs(),
            curriculum_epochs: self.method.rule.curriculum_epochs,
            shipped: finding.epoch,
            plan: finding.plan.as_ref(),
            passed_over: &finding.passed_over.iter().map(|passed| passed.epoch).collect::<Vec<_>>(),
            map: &self.record.map,
            amounts: &finding.amounts,
        };
        let svg = curves.to_svg().map_err(|error| CliError::Failed(error.to_string()))?;
        Ok(self.folder.replace(CURVES, svg.as_bytes())?)
    }

    /// Writes the chosen skill's motion, and what it brings as it will be performed.
    fn write_plan(&mut self, Performed { theta, quantised, evaluation }: &Performed) -> Result<(), CliError> {
        let RunRecord { scene, map, state, .. } = &self.record;
        let arm = arm_motion(scene, map, quantised).map_err(|refusal| {
            CliError::Failed(format!("the arm cannot make the plan's motion: {refusal}"))
        })?;
        let parts = PlanParts {
            scene,
            map,
            seed: state.seed,
            precision: state.precision,
            theta,
            quantised,
            evaluation,
            arm: arm.as_ref().map(|arm| Mounting::from(&arm.model)),
        };
        let unfit = |error| CliError::Failed(format!("no plan can be made: {error}"));
        let plan = parts.to_bytes().map_err(unfit)?;
        self.folder.replace(PLAN, &plan)?;
        self.record.ship(&plan).map_err(unfit)?;
        self.record.state.finished = true;
        self.folder.replace(STATE, &self.record.state.to_bytes())?;
        self.write_metrics()?;
        self.write_curves(&self.finding()?)
    }

    /// The best skill whose motion still brings the wanted amount when it is rounded to whole counts; if none does, the one that then
    /// misses it least.
    fn performed(
        &mut self,
        simulator: &mut dyn Simulate,
        progress: &Progress,
        interrupt: &Interrupt,
    ) -> Result<Performed, CliError> {
        let Finding { rule, amounts, passed_over, .. } = self.finding()?;
        let mut nearest: Option<Performed> = None;
        for epoch in rule.candidates(&amounts, &self.record.epochs) {
            let theta = self.record.epochs[epoch].record.theta;
            let quantised = self.record.map.quantise(&theta)?;
            let evaluation = match self.rounded.get(&epoch) {
                Some(found) => *found,
                None => rehearsed(&quantised, simulator, progress, interrupt)?,
            };
            self.rounded.insert(epoch, evaluation);
            let miss = |found: &Evaluation| amounts.miss(found.census.target).abs();
            let is_nearer = nearest.as_ref().is_none_or(|other| miss(&evaluation) < miss(&other.evaluation));
            let is_met = amounts.is_met(evaluation.census.target) == Some(true);
            if is_met || is_nearer {
                nearest = Some(Performed { theta, quantised, evaluation });
            }
            if is_met {
                break;
            }
        }
        nearest.ok_or_else(|| {
            CliError::Failed(format!(
                "no evaluated skill is a motion that the arm may perform: {}",
                passed_over.first().map_or("there is none", |passed| &passed.reason)
            ))
        })
    }

    /// Says what was found, in the order of what the person needs first.
    fn conclude(&self, json: bool, context: &mut Context<'_>) -> Result<(), CliError> {
        let finding = self.finding()?;
        let path = self.folder.file(PLAN);
        if json {
            context.json(&Report { folder: self.folder.path(), plan: path, finding: &finding })?;
        } else {
            write!(context.out, "\n{}", finding.text(self.record.skills()))?;
            writeln!(context.out, "\nThe curves are in {}.", self.folder.file(CURVES).display())?;
            write!(context.out, "{}", next::play(&path))?;
        }
        finding.shortfall().map_or(Ok(()), |shortfall| Err(CliError::Missed(shortfall)))
    }
}

/// What a motion in whole counts brings.
fn rehearsed(
    quantised: &QuantisedControls,
    simulator: &mut dyn Simulate,
    progress: &Progress,
    interrupt: &Interrupt,
) -> Result<Evaluation, CliError> {
    stop_if_requested(interrupt)?;
    progress.begin("the plan, as shipped", 0, &[]);
    Ok(simulator.simulate(&quantised.controls)?)
}

/// What evaluates, until the person asks to stop.
struct Work<'a> {
    simulator: &'a mut dyn Simulate,
    interrupt: &'a Interrupt,
}

impl Work<'_> {
    /// One evaluation, which takes the bar to `end`; by the exact adjoint, if nothing restarts.
    fn evaluate_with_gradient(
        &mut self,
        theta: &Theta,
        restarts: Option<&Restarts>,
        end: f64,
    ) -> Result<(Evaluation, ThetaGradient), CliError> {
        self.go([0.0, end], |simulator| match restarts {
            None => simulator.evaluate_with_gradient(theta),
            Some(restarts) => {
                let found = simulator.evaluate_restarted(theta, restarts)?;
                Ok((found.evaluation, found.gradient))
            }
        })
    }

    /// Evaluations without gradients, which take the bar from `start` to the end.
    fn evaluate_all(&mut self, thetas: &[Theta], start: f64) -> Result<Vec<Evaluation>, CliError> {
        self.go([start, 1.0], |simulator| simulator.evaluate_all(thetas))
    }

    fn go<R>(
        &mut self,
        span: [f64; 2],
        job: impl FnOnce(&mut dyn Simulate) -> Result<R, RolloutError>,
    ) -> Result<R, CliError> {
        stop_if_requested(self.interrupt)?;
        Ok(rollout::part(self.simulator, span, job)?)
    }
}

impl From<SearchError> for CliError {
    fn from(error: SearchError) -> Self {
        Self::Failed(error.to_string())
    }
}

fn stop_if_requested(interrupt: &Interrupt) -> Result<(), CliError> {
    if interrupt.is_requested() { Err(RolloutError::Stopped.into()) } else { Ok(()) }
}

/// Epochs as given, if there are not too many.
pub(super) fn checked_epochs(epochs: u32) -> Result<u32, CliError> {
    if epochs <= MAX_EPOCHS {
        return Ok(epochs);
    }
    Err(CliError::Input(format!("--epochs is {epochs}, but at most {MAX_EPOCHS} are possible")))
}

/// A scene's name as a folder's name.
pub(super) fn safe_name(scene: &str) -> String {
    let safe = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '-' };
    let name: String = scene.chars().map(safe).collect();
    name.trim_start_matches('.').into()
}

fn resume_command(folder: &Path) -> String {
    next::optimise(&["--resume", &folder.to_string_lossy()])
}

/// A line of a file of JSON lines.
pub(super) fn json_line(record: &impl serde::Serialize) -> String {
    let line = serde_json::to_string(record).expect("a record holds nothing that JSON cannot express");
    line + "\n"
}

/// What is given again on resuming must be what the run was started with.
fn refuse_differences(arguments: &RunArgs, path: &Path, state: &RunState) -> Result<(), CliError> {
    let refuse = |what: String| Err(CliError::Input(format!("the run in {} {what}", path.display())));
    if let Some(name) = &arguments.scene {
        let digest = Scene::load(name)?.digest();
        if digest != state.scene {
            let [asked, saved] = [digest, state.scene].map(|digest| hex(&digest[..4]));
            return refuse(format!(
                "was started with another scene than `{name}` (digest {saved}, not {asked})"
            ));
        }
    }
    if let Some(seed) = arguments.seed.filter(|seed| *seed != state.seed) {
        return refuse(format!("was started with seed {}, not {seed}", state.seed));
    }
    let asked = arguments.precision.map(Precision::from);
    if let Some(asked) = asked.filter(|asked| *asked != state.precision) {
        let [asked, saved] = [asked, state.precision].map(Precision::name);
        return refuse(format!("was started with precision {saved}, not {asked}"));
    }
    Ok(())
}

fn prolong(record: &mut RunRecord, epochs: u32) -> Result<(), CliError> {
    let state = &mut record.state;
    let now = state.search.epochs();
    if epochs < now {
        return Err(CliError::Input(format!(
            "--epochs is {epochs}, but the run has {now}; it can only be prolonged"
        )));
    }
    if epochs > now && !state.search.is_settled() {
        state.search.extend(epochs);
        state.finished = false;
        // The last epoch is evaluated again, with a gradient.
        record.epochs.truncate(state.search.history().len());
        record.shipped = None;
    }
    Ok(())
}
