//! `optimise compare`: the paper's experiment.

use super::{
    CliError, Context, Progress, Resources, check,
    motion::{Motion, Task},
    next,
    options::{DEFAULT_PRECISION, PrecisionArg},
    run::{self, RunArgs},
    steps,
};
use crate::{
    compare::{Budget, Comparison, Method, Row, Track, Try, summarise},
    optim::EpochRecord,
    report::amounts::Amounts,
    report::folder::{COMPARISON, CURVES, METRICS, RunFolder, SCENE, TRIES},
    report::words::{count, duration, hex},
};
use clap::Args;
use powderline_baseline::Search;
use powderline_shared::plan::Precision;
use powderline_simulator::{
    rollout::{Simulate, Workload, initial_loss},
    scene::{DEFAULT_SCENE, Digest, Scene},
    skill::{SkillMap, Theta},
};
use serde::{Deserialize, Serialize};
use std::{
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
};

/// A longer file of metrics is not from a run, bytes.
const MAX_METRICS_BYTES: u64 = 64 << 20;
/// Every try of every track.
const TABLE: &str = "comparison.csv";
/// The figure for papers.
const PICTURE: &str = "curves.png";
/// The summary, as printed.
const SUMMARY: &str = "summary.md";

/// Skills that are evaluated at a time, at most: what an interruption costs.
const BATCH: usize = 8;

/// Most seeds, and most rollouts of a search.
const MAX_SEEDS: usize = 100;
const MAX_TRIES: u64 = 1_000_000;

/// Arguments of `optimise compare`.
#[derive(Clone, Debug, Args)]
pub(super) struct CompareArgs {
    /// Scene: an embedded name or a TOML file [default: bench]
    #[arg(value_name = "SCENE", conflicts_with = "resume")]
    pub scene: Option<String>,
    /// Seeds, each of packing, first skill and search
    #[arg(
        long,
        value_name = "N,..",
        value_delimiter = ',',
        default_value = "1,2,3",
        conflicts_with = "resume"
    )]
    pub seeds: Vec<u64>,
    /// Updates along the gradient; with --resume, more than before [default: the scene's]
    #[arg(long, value_name = "N")]
    pub epochs: Option<u32>,
    /// Methods, in the order of the legend
    #[arg(
        long,
        value_name = "METHOD,..",
        value_delimiter = ',',
        default_value = "gradient,sac,cma-es,random",
        conflicts_with = "resume"
    )]
    pub methods: Vec<Method>,
    /// Rollouts that searches without gradients have for each epoch; the default is what the gradient takes for a skill and
    /// five central differences
    #[arg(
        long,
        value_name = "N",
        default_value = "11",
        value_parser = clap::value_parser!(u32).range(1..=10_000),
        conflicts_with = "resume"
    )]
    pub rollouts_per_epoch: u32,
    /// Show besides what searches without gradients achieve with so many times the rollouts
    #[arg(
        long,
        value_name = "N",
        default_value = "1",
        value_parser = clap::value_parser!(u32).range(1..=1_000),
        conflicts_with = "resume"
    )]
    pub budget_factor: u32,
    /// Precision of the simulation [default: f32]
    #[arg(long, conflicts_with = "resume")]
    pub precision: Option<PrecisionArg>,
    /// Threads and memory.
    #[command(flatten)]
    pub resources: Resources,
    /// Folder to write into, new or without a comparison [default: runs/<scene>-comparison, numbered if taken]
    #[arg(long, value_name = "DIR", conflicts_with = "resume")]
    pub out: Option<PathBuf>,
    /// Go on with the comparison in this folder
    #[arg(long, value_name = "DIR")]
    pub resume: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

#[derive(Serialize)]
struct Report<'a> {
    folder: &'a Path,
    scene: &'a str,
    scene_digest: String,
    precision: &'static str,
    seeds: &'a [u64],
    /// As the table has them, one for each method and budget.
    rows: Vec<Row>,
}

/// What a comparison was begun with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Plan {
    scene: Digest,
    precision: Precision,
    seeds: Vec<u64>,
    methods: Vec<Method>,
    budget: Budget,
}

/// A comparison whose folder is open and locked.
pub(super) struct Experiment {
    folder: RunFolder,
    scene: Scene,
    plan: Plan,
    resources: Resources,
}

/// Runs the command.
///
/// # Errors
/// One sentence; everything evaluated before is saved.
pub(super) fn execute(arguments: &CompareArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let experiment = match &arguments.resume {
        Some(folder) => Experiment::open(folder, arguments.resources)?.prolonged(arguments)?,
        None => Experiment::start(arguments)?,
    };
    let folder = experiment.folder.path().to_string_lossy();
    let again = next::optimise(&["compare", "--resume", &folder]);
    let remark = format!("what was evaluated is saved, go on with: {again}");
    let comparison = experiment.complete(context).map_err(|error| error.with_remark(&remark))?;
    if arguments.json {
        return context.json(&experiment.report(&comparison));
    }
    write!(context.out, "\n{}", experiment.summary(&comparison))?;
    writeln!(context.out, "\nThe figure is in {}.", experiment.folder.file(CURVES).display())?;
    Ok(())
}

impl Experiment {
    fn start(arguments: &CompareArgs) -> Result<Self, CliError> {
        let name = arguments.scene.as_deref().unwrap_or(DEFAULT_SCENE);
        let scene = Scene::load(name)?;
        if let Some(why) = check::infeasible(&scene) {
            return Err(CliError::Input(format!("{name}: {why}")));
        }
        let plan = Plan {
            scene: scene.digest(),
            precision: arguments.precision.map_or(DEFAULT_PRECISION, Precision::from),
            seeds: distinct("--seeds", &arguments.seeds)?,
            methods: distinct("--methods", &arguments.methods)?,
            budget: Budget {
                epochs: run::checked_epochs(arguments.epochs.unwrap_or(scene.optimiser.epochs))?,
                rollouts_per_epoch: arguments.rollouts_per_epoch,
                factor: arguments.budget_factor,
            },
        };
        plan.check()?;
        for method in &plan.methods {
            SkillMap::new(&method.scene(&scene)?)
                .check_all_corners()
                .map_err(|error| CliError::Input(format!("{name}, for {}: {error}", method.name())))?;
        }
        plan.check_memory(&scene, arguments.resources)?;
        let folder = match &arguments.out {
            Some(path) => RunFolder::create(path)?,
            None => {
                let name = format!("{}-comparison", run::safe_name(&scene.name));
                RunFolder::create_numbered(&Path::new("runs").join(name))?
            }
        };
        folder.replace(SCENE, scene.to_toml().as_bytes())?;
        let begun = Self { folder, scene, plan, resources: arguments.resources };
        begun.save_plan().inspect_err(|_| begun.folder.discard(SCENE))?;
        Ok(begun)
    }

    /// Takes a comparison that was begun.
    ///
    /// # Errors
    /// One sentence.
    pub(super) fn open(path: &Path, resources: Resources) -> Result<Self, CliError> {
        let folder = RunFolder::open_with(path, COMPARISON)?;
        let file = folder.file(COMPARISON).display().to_string();
        let plan: Plan = serde_json::from_slice(&folder.read(COMPARISON)?).map_err(|error| {
            CliError::Input(format!("{file} is not what a comparison leaves behind: {error}"))
        })?;
        plan.check().map_err(|error| CliError::Input(format!("{file}: {error}")))?;
        let name = folder.file(SCENE).display().to_string();
        let scene = Scene::load(&name)?;
        if scene.digest() != plan.scene {
            let [saved, found] = [plan.scene, scene.digest()].map(|digest| hex(&digest[..4]));
            return Err(CliError::Input(format!(
                "{name} is no longer the scene that the comparison was started with (digest {saved}, not {found})"
            )));
        }
        Ok(Self { folder, scene, plan, resources })
    }

    /// With more epochs, if more are asked for: nothing that was evaluated changes by that.
    fn prolonged(mut self, arguments: &CompareArgs) -> Result<Self, CliError> {
        let now = self.plan.budget.epochs;
        let epochs = run::checked_epochs(arguments.epochs.unwrap_or(now))?;
        if epochs < now {
            return Err(CliError::Input(format!(
                "--epochs is {epochs}, but the comparison has {now}; it can only be prolonged"
            )));
        }
        self.plan.budget.epochs = epochs;
        self.plan.check()?;
        self.plan.check_memory(&self.scene, self.resources)?;
        self.save_plan()?;
        Ok(self)
    }

    fn save_plan(&self) -> Result<(), CliError> {
        let text = serde_json::to_string_pretty(&self.plan).map_err(std::io::Error::from)?;
        Ok(self.folder.replace(COMPARISON, text.as_bytes())?)
    }

    fn empty(&self) -> Comparison {
        Comparison {
            scene: self.scene.name.clone(),
            amounts: (&self.scene).into(),
            budget: self.plan.budget,
            tracks: Vec::new(),
        }
    }

    fn folder_of(&self, method: Method, seed: u64) -> PathBuf {
        self.folder.file(&format!("{}-seed{seed}", method.name()))
    }

    /// What was evaluated until now.
    ///
    /// # Errors
    /// One sentence, about a file that cannot be read or understood.
    pub(super) fn so_far(&self) -> Result<Comparison, CliError> {
        let mut comparison = self.empty();
        for seed in &self.plan.seeds {
            for method in &self.plan.methods {
                let folder = self.folder_of(*method, *seed);
                let [metrics, tries] = [METRICS, TRIES].map(|file| folder.join(file));
                if metrics.exists() {
                    comparison.tracks.push(Track::of_epochs(*method, *seed, &read_history(&metrics)?));
                } else if tries.exists() {
                    let tries = read_tries(&RunFolder::take(&folder)?)?;
                    comparison.tracks.push(Track { method: *method, seed: *seed, tries });
                }
            }
        }
        Ok(comparison)
    }

    /// The scene.
    pub(super) fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The best skill of all, as a motion, and whose it is; none if no skill was evaluated. Motions that are no skill's are left out: they
    /// keep no limit of the arm but its workspace and the speed along each axis.
    pub(super) fn best_motion(&self, comparison: &Comparison) -> Option<(Task, String)> {
        let skills = comparison
            .tracks
            .iter()
            .flat_map(|track| track.tries.iter().filter_map(move |one| Some((track, one.loss, one.theta?))));
        let (track, _, theta) = skills.min_by(|(_, a, _), (_, b, _)| a.total_cmp(b))?;
        let whose = format!("{}, seed {}", track.method.name(), track.seed);
        let task = Task {
            // It was right when the comparison began.
            scene: track.method.scene(&self.scene).ok()?,
            setup: self.resources.setup(track.seed, self.plan.precision),
            motion: Motion::Skill(theta),
        };
        Some((task, whose))
    }

    /// The rows of the summary.
    pub(super) fn rows(&self, comparison: &Comparison) -> Vec<Row> {
        summarise(comparison, &|seed| initial_loss(&self.scene, seed))
    }

    /// Runs what is left, track after track, and draws what there is after each.
    fn complete(&self, context: &mut Context<'_>) -> Result<Comparison, CliError> {
        let mut comparison = self.empty();
        // Seed after seed, so that there is something to compare early.
        for seed in &self.plan.seeds {
            for method in &self.plan.methods {
                let track = self.track(*method, *seed, context)?;
                comparison.tracks.push(track);
            }
            self.write(&comparison)?;
        }
        Ok(comparison)
    }

    fn track(&self, method: Method, seed: u64, context: &mut Context<'_>) -> Result<Track, CliError> {
        let path = self.folder_of(method, seed);
        match method.search(seed) {
            Some(search) => self.search(method, seed, search, &path, context),
            None if method == Method::GradientSteps => self.steps(seed, &path, context),
            None => self.gradient(method, seed, &path, context),
        }
    }

    /// A run like any other, in a folder of its own.
    fn gradient(
        &self,
        method: Method,
        seed: u64,
        path: &Path,
        context: &mut Context<'_>,
    ) -> Result<Track, CliError> {
        let file = format!("{}.toml", method.name());
        self.folder.replace(&file, method.scene(&self.scene)?.to_toml().as_bytes())?;
        let arguments = RunArgs {
            scene: Some(self.folder.file(&file).display().to_string()),
            seed: Some(seed),
            epochs: Some(self.plan.budget.epochs),
            precision: Some(self.plan.precision.into()),
            resources: self.resources,
            out: Some(path.into()),
            resume: None,
            json: false,
        };
        let history = run::completed(&arguments, context)?;
        Ok(Track::of_epochs(method, seed, &history))
    }

    /// A search over displacements.
    fn steps(&self, seed: u64, path: &Path, context: &mut Context<'_>) -> Result<Track, CliError> {
        let setup = self.resources.setup(seed, self.plan.precision);
        steps::completed(&self.scene, &setup, self.plan.budget.epochs, path, context)
    }

    fn search(
        &self,
        method: Method,
        seed: u64,
        search: Box<dyn Search>,
        path: &Path,
        context: &mut Context<'_>,
    ) -> Result<Track, CliError> {
        let folder = RunFolder::take(path)?;
        let setup = self.resources.setup(seed, self.plan.precision);
        let mut tracing = Tracing {
            known: read_tries(&folder)?,
            track: Track { method, seed, tries: Vec::new() },
            search,
            folder,
            most: self.plan.budget.tries(),
            asked: Vec::new(),
        };
        tracing.replay()?;
        if !tracing.is_done() {
            let simulator = (context.factory)(&self.scene, &setup)?;
            tracing.go_on(&self.scene, simulator, context)?;
        }
        Ok(tracing.track)
    }

    fn write(&self, comparison: &Comparison) -> Result<(), CliError> {
        let failed = |error: crate::compare::figure::FigureError| CliError::Failed(error.to_string());
        self.folder.replace(CURVES, comparison.to_svg().map_err(failed)?.as_bytes())?;
        self.folder.replace(PICTURE, &comparison.to_png().map_err(failed)?)?;
        self.folder.replace(TABLE, table(comparison).as_bytes())?;
        Ok(self.folder.replace(SUMMARY, self.summary(comparison).as_bytes())?)
    }

    fn report(&self, comparison: &Comparison) -> Report<'_> {
        Report {
            folder: self.folder.path(),
            scene: &self.scene.name,
            scene_digest: hex(&self.plan.scene),
            precision: self.plan.precision.name(),
            seeds: &self.plan.seeds,
            rows: self.rows(comparison),
        }
    }

    /// The table, as Markdown and for people who read it as it is.
    fn summary(&self, comparison: &Comparison) -> String {
        let mut lines = vec![Row::headings(self.plan.budget.epochs)];
        lines.extend(self.rows(comparison).iter().map(Row::cells));
        let width = |column: usize| lines.iter().map(|line| line[column].len()).max().unwrap_or_default();
        let mut text = String::new();
        for (index, line) in lines.iter().enumerate() {
            for (column, cell) in line.iter().enumerate() {
                // Writing to a string does not fail.
                let _ = write!(text, "| {cell:<width$} ", width = width(column));
            }
            text += "|\n";
            if index == 0 {
                (0..line.len()).for_each(|column| text += &format!("|{}", "-".repeat(width(column) + 2)));
                text += "|\n";
            }
        }
        text
    }
}

impl Plan {
    /// Whether memory will do for every method.
    fn check_memory(&self, scene: &Scene, resources: Resources) -> Result<(), CliError> {
        let setup = resources.setup(0, self.precision);
        let has_gradient = self.methods.iter().any(|method| method.is_gradient());
        let work = if has_gradient { Workload::Gradient } else { Workload::Batch };
        Ok(setup.check_memory(scene, work, 0)?)
    }

    fn check(&self) -> Result<(), CliError> {
        let tries = u64::from(self.budget.epochs + 1)
            * u64::from(self.budget.rollouts_per_epoch)
            * u64::from(self.budget.factor);
        if tries > MAX_TRIES {
            return Err(CliError::Input(format!(
                "epochs, rollouts per epoch and budget factor make {tries} rollouts of a search, but at most {MAX_TRIES} are \
                 possible"
            )));
        }
        match self.seeds.len() {
            0 => Err(CliError::Input("there is no seed, and one at least is needed".into())),
            count if count > MAX_SEEDS => {
                Err(CliError::Input(format!("there are {count} seeds, but at most {MAX_SEEDS} are possible")))
            }
            _ if self.methods.is_empty() => {
                Err(CliError::Input("there is no method, and one at least is needed".into()))
            }
            _ => Ok(()),
        }
    }
}

/// The list, if nothing is in it twice.
fn distinct<T: Clone + PartialEq + std::fmt::Debug>(name: &str, list: &[T]) -> Result<Vec<T>, CliError> {
    match (1..list.len()).find(|index| list[..*index].contains(&list[*index])) {
        None => Ok(list.to_vec()),
        Some(index) => {
            Err(CliError::Input(format!("{name} names {:?} twice, and once is enough", list[index])))
        }
    }
}

/// A search without gradients on its way.
struct Tracing {
    folder: RunFolder,
    search: Box<dyn Search>,
    track: Track,
    /// What an earlier session has evaluated.
    known: Vec<Try>,
    /// Skills to evaluate.
    most: u32,
    /// What the search has asked for last and was not told yet.
    asked: Vec<Theta>,
}

impl Tracing {
    fn is_done(&self) -> bool {
        self.track.tries.len() >= self.most as usize
    }

    /// The next skills to evaluate; the same until the search is told of them.
    fn ask(&mut self) -> Result<Vec<Theta>, CliError> {
        if self.asked.is_empty() {
            let left = self.most as usize - self.track.tries.len();
            let wrong = |_| CliError::Failed("a search asked for a skill without five parameters".into());
            let skill = |point: Vec<f64>| -> Result<Theta, CliError> {
                Ok(Theta::new(point.try_into().map_err(wrong)?)?)
            };
            let points = self.search.ask(left.min(BATCH));
            self.asked = points.into_iter().map(skill).collect::<Result<_, _>>()?;
        }
        Ok(self.asked.clone())
    }

    fn tell(&mut self, tries: &[Try]) {
        self.asked.clear();
        self.search.tell(&tries.iter().map(|one| one.loss).collect::<Vec<_>>());
        self.track.tries.extend(tries);
    }

    /// Tells the search what it was told before, as far as that is known in whole batches.
    fn replay(&mut self) -> Result<(), CliError> {
        while !self.is_done() {
            let done = self.track.tries.len();
            let skills = self.ask()?;
            let Some(known) = self.known.get(done..done + skills.len()).map(<[Try]>::to_vec) else { break };
            let bits = |theta: Theta| theta.components().map(f64::to_bits);
            let same = |(skill, one): (&Theta, &Try)| Some(bits(*skill)) == one.theta.map(bits);
            if !skills.iter().zip(&known).all(same) {
                return Err(CliError::Input(format!(
                    "{} holds skills that this version of the search does not ask for; start a new comparison",
                    self.folder.file(TRIES).display()
                )));
            }
            self.tell(&known);
        }
        // What is left of a batch that was not finished is evaluated again.
        let lines: String = self.track.tries.iter().map(run::json_line).collect();
        Ok(self.folder.replace(TRIES, lines.as_bytes())?)
    }

    fn go_on(
        &mut self,
        scene: &Scene,
        mut simulator: Box<dyn Simulate>,
        context: &mut Context<'_>,
    ) -> Result<(), CliError> {
        let name = self.track.method.name();
        let progress = Progress::new(&context.err, context.live);
        simulator.set_progress(progress.watch(&context.interrupt));
        progress.line(&format!(
            "{}: {name}, seed {}, {}, into {}",
            scene.name,
            self.track.seed,
            count(self.most.into(), "rollout"),
            self.folder.path().display()
        ));
        while !self.is_done() {
            let done = self.track.tries.len();
            progress.begin(&format!("{name} {done}/{}", self.most), 0, &[]);
            let skills = self.ask()?;
            let found = simulator.evaluate_all(&skills);
            progress.clear();
            let found = found?;
            let seconds = (progress.seconds() * 1e3).round() / 1e3 / skills.len() as f64;
            let mut tries: Vec<Try> = Vec::with_capacity(skills.len());
            for (theta, found) in skills.iter().zip(&found) {
                let last = tries.last().or(self.track.tries.last());
                tries.push(Try::after(last, Some(*theta), found, 1, seconds));
            }
            let lines: String = tries.iter().map(run::json_line).collect();
            self.folder.append(TRIES, lines.as_bytes())?;
            self.tell(&tries);
        }
        progress.line(&self.outcome(&scene.into()));
        Ok(())
    }

    fn outcome(&self, amounts: &Amounts) -> String {
        let tries = &self.track.tries;
        let Some(best) = tries.iter().min_by(|a, b| a.loss.total_cmp(&b.loss)) else { return String::new() };
        let seconds = tries.last().map_or(0.0, |last| last.seconds);
        format!(
            "{}, seed {}: lowest loss {:.3} m ({} arrive) after {} of {}, {}",
            self.track.method.name(),
            self.track.seed,
            best.loss,
            amounts.powder(best.census.target),
            best.rollouts,
            count(tries.len() as i64, "rollout"),
            duration(seconds)
        )
    }
}

/// What an earlier session has evaluated; a last line that it did not finish is left out.
fn read_tries(folder: &RunFolder) -> Result<Vec<Try>, CliError> {
    if !folder.file(TRIES).exists() {
        return Ok(Vec::new());
    }
    let bytes = folder.read(TRIES)?;
    let whole = bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
    let lines = bytes[..whole].split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
    let parsed = (1..).zip(lines).map(|(number, line)| {
        let tried: Result<Try, _> = serde_json::from_slice(line);
        tried.map_err(|error| {
            let file = folder.file(TRIES).display().to_string();
            CliError::Input(format!("{file}, line {number}, is not what a comparison leaves behind: {error}"))
        })
    });
    parsed.collect()
}

/// Every try of every track.
fn table(comparison: &Comparison) -> String {
    let mut text = String::from(
        "method,seed,try,rollouts,seconds,loss_m,indicator,source,target,rims,tool,spilled,in_flight,theta_0,theta_1,theta_2,theta_3,theta_4\n",
    );
    for track in &comparison.tracks {
        for (index, one) in track.tries.iter().enumerate() {
            let Try { loss, indicator, census, rollouts, seconds, theta } = one;
            let census = census.named().map(|(_, particles)| particles.to_string()).join(",");
            // Five cells, empty where the motion is no skill's.
            let theta = theta
                .map_or(",".repeat(4), |theta| theta.components().map(|value| value.to_string()).join(","));
            // Writing to a string does not fail.
            let _ = writeln!(
                text,
                "{},{},{index},{rollouts},{seconds:.3},{loss},{indicator},{census},{theta}",
                track.method.name(),
                track.seed
            );
        }
    }
    text
}

/// The epochs that a run has written down.
fn read_history(path: &Path) -> Result<Vec<EpochRecord>, CliError> {
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
