//! `optimise compare`: ways to search, side by side.

use super::{
    CliError, Context, Resources, check,
    motion::{Motion, Task},
    next,
    options::{DEFAULT_PRECISION, PrecisionArg},
    run::{self, completed, workload},
};
use crate::{
    compare::{Comparison, Row, Track, cost_of, summarise},
    failure::of_file,
    optim::{Method, World},
    report::{
        folder::{COMPARISON, CURVES, RunFolder, SCENE, STATE},
        record::RunRecord,
        state::{RunState, Settings},
        tries::Try,
        words::hex,
    },
    run::{MAX_EPOCHS, Run, Watcher, Worlds},
};
use clap::Args;
use powderline_shared::plan::Precision;
use powderline_simulator::{
    rollout::{Workload, initial_loss},
    scene::{DEFAULT_SCENE, Digest, Scene},
    skill::{SkillMap, Theta},
};
use serde::{Deserialize, Serialize};
use std::{
    fmt::Write as _,
    io::Write as _,
    path::{Path, PathBuf},
};

/// Every try of every track.
const TABLE: &str = "comparison.csv";
/// The figure for papers.
const PICTURE: &str = "curves.png";
/// The summary, as printed.
const SUMMARY: &str = "summary.md";

/// Most seeds, and most rollouts of a search.
const MAX_SEEDS: usize = 100;
const MAX_ROLLOUTS: u32 = 100_000;

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
    /// Rollouts after which the searches are judged, rising; each search ends with the last. A motion in the coarse world counts as 0.3, an
    /// adjoint as 4 or 6 besides its rollout. With --resume, more than before [default: 30,120]
    #[arg(long, value_name = "N,..", value_delimiter = ',')]
    pub rollouts: Vec<u32>,
    /// Methods, in the order of the legend
    #[arg(
        long,
        value_name = "METHOD,..",
        value_delimiter = ',',
        default_value = "surrogate,restarted,differences,cma-es,sac,random",
        conflicts_with = "resume"
    )]
    pub methods: Vec<Method>,
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
    /// Run no search: begin the comparison, and name the searches that are left, a line each, for --only
    #[arg(long)]
    pub prepare: bool,
    /// Run these searches and no other, so that processes and machines share the work; each writes into its own folder in DIR alone. Once
    /// all are there, --resume without this draws the figure
    #[arg(long, value_name = "SEARCH,..", value_delimiter = ',', requires = "resume", conflicts_with_all = ["prepare", "rollouts"])]
    pub only: Vec<String>,
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
    rollouts: &'a [u32],
    /// As the table has them, one for each method.
    rows: Vec<Row>,
}

/// What `--json` prints of a part of a comparison.
#[derive(Serialize)]
struct Part<'a> {
    folder: &'a Path,
    /// Searches that have not had their rollouts yet, by the names of their folders.
    left: Vec<String>,
}

/// What a comparison was begun with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Plan {
    scene: Digest,
    precision: Precision,
    seeds: Vec<u64>,
    methods: Vec<Method>,
    rollouts: Vec<u32>,
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
    if let Some(folder) = arguments.resume.as_ref().filter(|_| !arguments.only.is_empty()) {
        return Experiment::share(folder, arguments.resources)?.part(
            &arguments.only,
            arguments.json,
            context,
        );
    }
    let experiment = match &arguments.resume {
        Some(folder) => Experiment::open(folder, arguments.resources)?.prolonged(arguments)?,
        None => Experiment::start(arguments)?,
    };
    if arguments.prepare {
        return experiment.say_left(arguments.json, context);
    }
    let comparison =
        experiment.complete(context).map_err(|error| error.with_remark(&experiment.how_to_go_on(&[])))?;
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
        let rollouts = if arguments.rollouts.is_empty() { vec![30, 120] } else { arguments.rollouts.clone() };
        let plan = Plan {
            scene: scene.digest(),
            precision: arguments.precision.map_or(DEFAULT_PRECISION, Precision::from),
            seeds: distinct("--seeds", &arguments.seeds)?,
            methods: distinct("--methods", &arguments.methods)?,
            rollouts,
        };
        plan.check()?;
        SkillMap::new(&scene)
            .check_all_corners()
            .map_err(|error| CliError::Input(format!("{name}: {error}")))?;
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
    fn open(path: &Path, resources: Resources) -> Result<Self, CliError> {
        Self::of_folder(RunFolder::open_with(path, COMPARISON)?, resources)
    }

    /// The same beside others who do so: for whoever writes into folders of searches alone.
    fn share(path: &Path, resources: Resources) -> Result<Self, CliError> {
        Self::of_folder(RunFolder::share(path, COMPARISON)?, resources)
    }

    /// The same beside whoever works on it: for whoever only reads.
    ///
    /// # Errors
    /// One sentence.
    pub(super) fn look(path: &Path, resources: Resources) -> Result<Self, CliError> {
        Self::of_folder(RunFolder::look(path, COMPARISON)?, resources)
    }

    fn of_folder(folder: RunFolder, resources: Resources) -> Result<Self, CliError> {
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

    /// With more rollouts, if more are asked for: nothing that was evaluated changes by that.
    fn prolonged(mut self, arguments: &CompareArgs) -> Result<Self, CliError> {
        if arguments.rollouts.is_empty() {
            return Ok(self);
        }
        let last = |rollouts: &[u32]| rollouts.last().copied().unwrap_or_default();
        let (now, asked) = (last(&self.plan.rollouts), last(&arguments.rollouts));
        if asked < now {
            return Err(CliError::Input(format!(
                "--rollouts ends with {asked}, but the comparison has {now}; it can only be prolonged"
            )));
        }
        self.plan.rollouts.clone_from(&arguments.rollouts);
        self.plan.check()?;
        self.plan.check_memory(&self.scene, self.resources)?;
        self.save_plan()?;
        Ok(self)
    }

    fn save_plan(&self) -> Result<(), CliError> {
        let text = serde_json::to_string_pretty(&self.plan).map_err(std::io::Error::from)?;
        Ok(self.folder.replace(COMPARISON, text.as_bytes())?)
    }

    fn of(&self, tracks: Vec<Track>) -> Comparison {
        Comparison {
            scene: self.scene.name.clone(),
            amounts: (&self.scene).into(),
            budgets: self.plan.rollouts.clone(),
            tracks,
        }
    }

    fn folder_of(&self, search: Search) -> PathBuf {
        self.folder.file(&search.name())
    }

    /// What was saved of a search, if it has begun.
    fn record_of(&self, search: Search) -> Result<Option<RunRecord>, CliError> {
        let folder = self.folder_of(search);
        if folder.join(STATE).exists() { Ok(Some(RunRecord::read(&folder)?)) } else { Ok(None) }
    }

    /// Whether a search has had its rollouts.
    fn is_enough(&self, state: &RunState) -> bool {
        cost_of(state.tries()) >= f64::from(self.plan.rollouts.last().copied().unwrap_or_default())
    }

    /// Names of the searches that have not.
    pub(super) fn left(&self) -> Result<Vec<String>, CliError> {
        let mut left = Vec::new();
        for search in self.plan.searches() {
            if !self.record_of(search)?.is_some_and(|record| self.is_enough(&record.state)) {
                left.push(search.name());
            }
        }
        Ok(left)
    }

    fn say_left(&self, json: bool, context: &mut Context<'_>) -> Result<(), CliError> {
        let (folder, left) = (self.folder.path(), self.left()?);
        if json {
            return context.json(&Part { folder, left });
        }
        for name in &left {
            writeln!(context.out, "{name}")?;
        }
        let words = match left.len() {
            0 => format!("All searches are whole. Draw them with: {}", self.command(&[])),
            _ => format!("Run each of these, anywhere, with: {} SEARCH", self.command(&["--only"])),
        };
        Ok(writeln!(context.err, "{words}")?)
    }

    fn command(&self, more: &[&str]) -> String {
        let folder = self.folder.path().to_string_lossy();
        next::optimise(&[&["compare", "--resume", &folder], more].concat())
    }

    fn how_to_go_on(&self, more: &[&str]) -> String {
        format!("what was evaluated is saved, go on with: {}", self.command(more))
    }

    /// Runs the searches of these names, and leaves what is of all to whoever draws them.
    fn part(&self, names: &[String], json: bool, context: &mut Context<'_>) -> Result<(), CliError> {
        let searches = names.iter().map(|name| self.plan.search(name)).collect::<Result<Vec<_>, _>>()?;
        let remark = self.how_to_go_on(&["--only", &names.join(",")]);
        for search in searches {
            self.track(search, context).map_err(|error| error.with_remark(&remark))?;
        }
        self.say_left(json, context)
    }

    /// What was simulated until now.
    ///
    /// # Errors
    /// One sentence, about a file that cannot be read or understood.
    pub(super) fn so_far(&self) -> Result<Comparison, CliError> {
        let mut tracks = Vec::new();
        for search in self.plan.searches() {
            tracks.extend(self.record_of(search)?.map(|record| self.track_of(&record.state)));
        }
        Ok(self.of(tracks))
    }

    fn track_of(&self, state: &RunState) -> Track {
        Track { method: state.settings.method, seed: state.seed, tries: state.tries().cloned().collect() }
    }

    /// The scene.
    pub(super) fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Rollouts after which searches are judged.
    pub(super) fn budgets(&self) -> &[u32] {
        &self.plan.rollouts
    }

    /// The best skill of all, as a motion, and whose it is; none if no skill was simulated in the scene itself.
    pub(super) fn best_motion(&self, comparison: &Comparison) -> Option<(Task, String)> {
        let skill = |one: &Try| Theta::new(one.theta[..].try_into().ok()?).ok();
        let tries =
            comparison.tracks.iter().flat_map(|track| track.tries.iter().map(move |one| (track, one)));
        let fine = tries.filter(|(_, one)| one.world == World::Fine);
        let skills = fine.filter_map(|(track, one)| Some((track, one, skill(one)?)));
        let (track, one, theta) = skills.min_by(|(_, a, _), (_, b, _)| a.loss.total_cmp(&b.loss))?;
        let whose = format!("{}, seed {}", track.method.name(), track.seed);
        let task = Task {
            scene: self.scene.clone(),
            setup: self.resources.setup(track.seed, self.plan.precision),
            motion: Motion::Skill(theta, one.splines.clone()),
        };
        Some((task, whose))
    }

    /// The rows of the summary.
    pub(super) fn rows(&self, comparison: &Comparison) -> Vec<Row> {
        summarise(comparison, &|seed| initial_loss(&self.scene, seed))
    }

    /// Runs what is left, track after track, and draws what there is after each seed.
    fn complete(&self, context: &mut Context<'_>) -> Result<Comparison, CliError> {
        let mut comparison = self.of(Vec::new());
        // Seed after seed, so that there is something to compare early.
        let searches: Vec<Search> = self.plan.searches().collect();
        for of_seed in searches.chunks(self.plan.methods.len()) {
            for search in of_seed {
                let track = self.track(*search, context)?;
                comparison.tracks.push(track);
            }
            // What was drawn of more seeds before, as of fewer rollouts, stays until there is as much again.
            let later = &searches[comparison.tracks.len()..];
            if later.iter().all(|search| !self.folder_of(*search).exists()) {
                self.write(&comparison)?;
            }
        }
        Ok(comparison)
    }

    /// A run like any other, in a folder of its own, that ends with its rollouts and makes no plan.
    fn track(&self, search: Search, context: &mut Context<'_>) -> Result<Track, CliError> {
        let Search { method, seed } = search;
        let (path, precision) = (self.folder_of(search), self.plan.precision);
        let settings = Settings { method, epochs: MAX_EPOCHS, patience_epochs: 0, refine_by: 0 };
        let mut run = match self.record_of(search)? {
            Some(record) => {
                let state = &record.state;
                if !state.is_of(self.plan.scene, (seed, precision), settings) {
                    return Err(CliError::Input(format!(
                        "{} holds another run than the comparison's {}: of another scene, seed, precision or method; move it away to begin \
                         this search anew",
                        path.display(),
                        search.name()
                    )));
                }
                let whole = self.is_enough(state).then(|| self.track_of(state));
                match (Run::resume(RunFolder::open(&path)?, record, None), whole) {
                    // A later version would search elsewhere; but here there is nothing left to search.
                    (Err(CliError::Input(_)), Some(track)) => return Ok(track),
                    (resumed, _) => resumed?,
                }
            }
            None => {
                // Of a search that was killed as it began the scene alone may be there.
                let scene = path.join(SCENE);
                if std::fs::read(&scene).is_ok_and(|text| text == self.scene.to_toml().as_bytes()) {
                    std::fs::remove_file(&scene).map_err(of_file(&scene, "removed"))?;
                }
                Run::begin(RunFolder::create(&path)?, self.scene.clone(), (seed, precision), settings)?
            }
        };
        if !self.is_enough(&run.record().state) {
            let setup = self.resources.setup(seed, precision);
            let search = |run: &mut Run, worlds: &mut Worlds<'_>, watcher: &dyn Watcher| {
                run.search_until(|state| self.is_enough(state), worlds, watcher)
            };
            completed(&mut run, &setup, search, &|_| {}, context)?;
        }
        Ok(self.track_of(&run.record().state))
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
            rollouts: &self.plan.rollouts,
            rows: self.rows(comparison),
        }
    }

    /// The table, as Markdown and for people who read it as it is.
    fn summary(&self, comparison: &Comparison) -> String {
        let mut lines = vec![Row::headings(&self.plan.rollouts)];
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

/// One of the searches of a comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Search {
    method: Method,
    seed: u64,
}

impl Search {
    /// Its name, and its folder's.
    fn name(self) -> String {
        format!("{}-seed{}", self.method.name(), self.seed)
    }
}

impl Plan {
    /// All that is to be run: seed after seed, method after method.
    fn searches(&self) -> impl Iterator<Item = Search> {
        let of = |seed: &u64| {
            self.methods.iter().map(|method| Search { method: *method, seed: *seed }).collect::<Vec<_>>()
        };
        self.seeds.iter().flat_map(of)
    }

    /// The search of a name.
    fn search(&self, name: &str) -> Result<Search, CliError> {
        let names = || self.searches().map(Search::name).collect::<Vec<_>>().join(", ");
        self.searches().find(|search| search.name() == name).ok_or_else(|| {
            CliError::Input(format!("--only names {name}, but the comparison has {}", names()))
        })
    }

    /// Whether memory will do for every method.
    fn check_memory(&self, scene: &Scene, resources: Resources) -> Result<(), CliError> {
        let setup = resources.setup(0, self.precision);
        let has_gradient = self.methods.iter().any(|method| workload(*method) == Workload::Gradient);
        let work = if has_gradient { Workload::Gradient } else { Workload::Batch };
        Ok(setup.check_memory(scene, work, 0)?)
    }

    fn check(&self) -> Result<(), CliError> {
        let input = |text: String| Err(CliError::Input(text));
        if !self.rollouts.is_sorted_by(|a, b| a < b) || self.rollouts.first().is_none_or(|first| *first == 0)
        {
            return input(format!(
                "rollouts are {:?}; whole numbers above 0 that rise would be right",
                self.rollouts
            ));
        }
        if let Some(most) = self.rollouts.last().filter(|most| **most > MAX_ROLLOUTS) {
            return input(format!("rollouts end with {most}, but at most {MAX_ROLLOUTS} are possible"));
        }
        match self.seeds.len() {
            0 => input("there is no seed, and one at least is needed".into()),
            count if count > MAX_SEEDS => {
                input(format!("there are {count} seeds, but at most {MAX_SEEDS} are possible"))
            }
            _ if self.methods.is_empty() => input("there is no method, and one at least is needed".into()),
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

/// Every try of every track.
fn table(comparison: &Comparison) -> String {
    let mut text = String::from(
        "method,seed,try,epoch,world,adjoint,cpu_seconds,loss_m,indicator,source,target,rims,tool,spilled,in_flight,theta_0,theta_1,theta_2,theta_3,theta_4\n",
    );
    for track in &comparison.tracks {
        for (index, one) in track.tries.iter().enumerate() {
            let Try { epoch, world, adjoint, loss, indicator, census, cpu_seconds, theta, .. } = one;
            let census = census.named().map(|(_, particles)| particles.to_string()).join(",");
            let theta = theta.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
            let world = if *world == World::Coarse { "coarse" } else { "fine" };
            let adjoint = adjoint.map_or("", crate::optim::Adjoint::name);
            // Writing to a string does not fail.
            let _ = writeln!(
                text,
                "{},{},{index},{epoch},{world},{adjoint},{cpu_seconds:.3},{loss},{indicator},{census},{theta}",
                track.method.name(),
                track.seed
            );
        }
    }
    text
}
