//! `optimise run`: the optimisation, from a scene (or a run to resume) to a plan.

use super::{
    CliError, Context, Interrupt, Progress, Resources, Setup, check, next,
    options::{DEFAULT_PRECISION, PrecisionArg},
};
use crate::{
    optim::{EpochRecord, Method, Step},
    report::{
        amounts::Amounts,
        finding::Finding,
        folder::{PLAN, RunFolder},
        record::RunRecord,
        state::{RunState, Settings},
        summary::cells,
        words::hex,
    },
    run::{Run, Watcher, Worlds, checked_epochs, refinable},
};
use clap::Args;
use powderline_shared::plan::Precision;
use powderline_simulator::{
    rollout::{RolloutError, Simulate, Workload},
    scene::{DEFAULT_SCENE, Scene},
    skill::colliding_skill,
};
use serde::Serialize;
use std::{
    io::Write,
    path::{Path, PathBuf},
};

/// Arguments of `optimise run`.
#[derive(Clone, Debug, Args)]
pub struct RunArgs {
    /// Scene: the name of an embedded one (bench, bench-small, bench-fine, vial, workcell) or a TOML file [default: bench]
    #[arg(value_name = "SCENE")]
    pub scene: Option<String>,
    /// Seed of the packing and of the search [default: the scene's powder.seed]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// How to search [default: surrogate]
    #[arg(long, value_name = "METHOD")]
    pub method: Option<Method>,
    /// Epochs after the first, at most [default: 16, with --method path 32]
    #[arg(long, value_name = "N")]
    pub epochs: Option<u32>,
    /// End when the amount is met and so many epochs in a row have gained nothing; 0 goes on to the last [default: 2]
    #[arg(long, value_name = "N")]
    pub patience: Option<u32>,
    /// Leave the plan as the search found it: by default it is simulated on cells of half the size too, and corrected until the wanted
    /// amount arrives there
    #[arg(long)]
    pub no_refine: bool,
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

/// Is told of each epoch when it is saved: its line of `metrics.jsonl`.
pub type EpochFn<'a> = &'a dyn Fn(&str);

/// Runs the command.
///
/// # Errors
/// One sentence; everything evaluated before is saved.
pub(super) fn execute(arguments: &RunArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    run(arguments, None, &|_| {}, context)
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
    let mut run = match &arguments.resume {
        Some(folder) => resumed(arguments, folder, context)?,
        None => begun(arguments, scene, context)?,
    };
    go_on(&mut run, arguments.resources, on_epoch, context)?;
    conclude(&run, arguments.json, context)
}

/// Looks at everything before there is a folder: what is refused leaves nothing behind.
fn begun(arguments: &RunArgs, scene: Option<&Scene>, context: &Context<'_>) -> Result<Run, CliError> {
    let (name, scene) = match scene {
        Some(scene) => (scene.name.as_str(), scene.clone()),
        None => {
            let name = arguments.scene.as_deref().unwrap_or(DEFAULT_SCENE);
            (name, Scene::load(name)?)
        }
    };
    if let Some(why) = check::infeasible(&scene) {
        return Err(CliError::Input(format!("{name}: {why}")));
    }
    let map = powderline_simulator::skill::SkillMap::new(&scene);
    map.check_all_corners().map_err(|error| CliError::Input(format!("{name}: {error}")))?;
    let seed = arguments.seed.unwrap_or(scene.powder.seed);
    let precision = arguments.precision.map_or(DEFAULT_PRECISION, Precision::from);
    let usual = Settings::of(arguments.method.unwrap_or_default());
    let settings = Settings {
        epochs: checked_epochs(arguments.epochs.unwrap_or(usual.epochs))?,
        patience_epochs: arguments.patience.unwrap_or(usual.patience_epochs),
        refine_by: if arguments.no_refine { 0 } else { usual.refine_by },
        ..usual
    };
    let setup = arguments.resources.setup(seed, precision);
    check_able(&setup, &scene, settings, context)?;
    let folder = match &arguments.out {
        Some(path) => RunFolder::create(path)?,
        None => RunFolder::create_numbered(
            &Path::new("runs").join(format!("{}-seed{seed}", safe_name(&scene.name))),
        )?,
    };
    Run::begin(folder, scene, (seed, precision), settings)
}

fn resumed(arguments: &RunArgs, path: &Path, context: &Context<'_>) -> Result<Run, CliError> {
    let folder = RunFolder::open(path)?;
    let mut record = RunRecord::read(path)?;
    refuse_differences(arguments, path, &record.state)?;
    let epochs = arguments.epochs.map(checked_epochs).transpose()?;
    let is_prolonged =
        epochs.is_some_and(|all| all > record.state.settings.epochs) && !record.state.is_settled();
    if arguments.no_refine && (!record.state.finished || is_prolonged) {
        record.state.settings.refine_by = 0;
        record.state.looks.clear();
    }
    if !record.state.finished || is_prolonged {
        let state = &record.state;
        // Before a prolongation takes anything back.
        let setup = arguments.resources.setup(state.seed, state.precision);
        check_able(&setup, &record.scene, state.settings, context)?;
    }
    Run::resume(folder, record, epochs)
}

/// Whether memory and threads will do.
fn check_able(
    setup: &Setup,
    scene: &Scene,
    settings: Settings,
    context: &Context<'_>,
) -> Result<(), CliError> {
    check_memory(setup, scene, settings)?;
    Ok((context.factory)(scene, setup).map(|_| ())?)
}

/// What is left to do of it.
fn go_on(
    run: &mut Run,
    resources: Resources,
    on_epoch: EpochFn<'_>,
    context: &mut Context<'_>,
) -> Result<(), CliError> {
    let state = &run.record().state;
    if state.finished {
        let prolongs = match state.is_settled() {
            true => {
                "the amount was met and nothing more gained; one that is begun with --patience 0 goes on to the last epoch".into()
            }
            false => format!("--epochs with more than {} prolongs it", state.settings.epochs),
        };
        // Nobody need hear it.
        let _ =
            writeln!(context.err, "The run in {} is finished; {prolongs}.", run.folder().path().display());
        return Ok(());
    }
    let resumable =
        format!("the epochs before are saved, go on with: {}", resume_command(run.folder().path()));
    let setup = resources.setup(state.seed, state.precision);
    completed(run, &setup, Run::complete, on_epoch, context).map_err(|error| error.with_remark(&resumable))
}

/// Drives a run, and says how it goes.
pub(super) fn completed(
    run: &mut Run,
    setup: &Setup,
    job: impl FnOnce(&mut Run, &mut Worlds<'_>, &dyn Watcher) -> Result<(), CliError>,
    on_epoch: EpochFn<'_>,
    context: &mut Context<'_>,
) -> Result<(), CliError> {
    let progress = Progress::new(&context.err, context.live);
    let RunRecord { state, scene, .. } = run.record();
    progress.line(&format!(
        "{}: {}, seed {}, {}, into {}",
        scene.name,
        state.settings.method.name(),
        state.seed,
        state.precision.name(),
        run.folder().path().display()
    ));
    if let Some((theta, collision)) = colliding_skill(scene) {
        progress.line(&format!("skills such as theta = {theta} are passed over: {collision}"));
    }
    let (interrupt, simulators) = (&context.interrupt, watched(context, setup, &progress));
    let mut worlds = Worlds::new(scene, state.seed, &simulators);
    let teller = Teller { progress: &progress, interrupt, on_epoch };
    let result = job(run, &mut worlds, &teller);
    progress.clear();
    result
}

/// Makes simulators that say how far they are, and that Ctrl-C ends.
pub(super) fn watched<'a>(
    context: &'a Context<'_>,
    setup: &'a Setup,
    progress: &'a Progress,
) -> impl Fn(&Scene) -> Result<Box<dyn Simulate>, RolloutError> + 'a {
    |scene| {
        let mut simulator = (context.factory)(scene, setup)?;
        simulator.set_progress(progress.watch(&context.interrupt));
        Ok(simulator)
    }
}

/// Says how a run goes on standard error.
pub(super) struct Teller<'a> {
    pub progress: &'a Progress,
    pub interrupt: &'a Interrupt,
    pub on_epoch: EpochFn<'a>,
}

impl Watcher for Teller<'_> {
    fn begin(&self, task: &str, later: u32, history: &[EpochRecord]) {
        self.progress.begin(task, later, history);
    }

    fn is_stopped(&self) -> bool {
        self.interrupt.is_requested()
    }

    fn epoch(&self, line: &str, amounts: &Amounts, last_and_all: [u32; 2], history: &[EpochRecord]) {
        if let Some(record) = history.last() {
            self.progress.epoch(record, amounts, last_and_all, history);
            self.say_step(record);
        }
        (self.on_epoch)(line);
    }

    fn say(&self, text: &str) {
        self.progress.line(text);
    }
}

impl Teller<'_> {
    /// Says where the search had to look farther than usual.
    fn say_step(&self, record: &EpochRecord) {
        let Some(widest) = record.slopes.as_ref().and_then(|slopes| slopes.half_step) else { return };
        match record.step {
            Step::Restart => self.say(&format!(
                "  no parameter leads anywhere, over +-{widest} of theta: the search begins anew from another skill"
            )),
            Step::Update if widest > crate::optim::descent::HALF_STEP => self.say(&format!(
                "  noise was all that +-{} of theta showed: the step goes by differences over +-{widest}",
                crate::optim::descent::HALF_STEP
            )),
            Step::Update | Step::None => {}
        }
    }
}

/// Says what was found, in the order of what the person needs first.
fn conclude(run: &Run, json: bool, context: &mut Context<'_>) -> Result<(), CliError> {
    let finding = run.finding()?;
    let path = run.folder().file(PLAN);
    if json {
        context.json(&Report { folder: run.folder().path(), plan: path, finding: &finding })?;
    } else {
        write!(context.out, "\n{}", finding.text(run.record().skills()))?;
        let curves = run.folder().file(crate::report::folder::CURVES);
        writeln!(context.out, "\nThe curves are in {}.", curves.display())?;
        write!(context.out, "{}", next::play(&path))?;
    }
    finding.shortfall().map_or(Ok(()), |shortfall| Err(CliError::Missed(shortfall)))
}

/// Whether memory will do, for the search and for the look at smaller cells after it.
pub(super) fn check_memory(setup: &Setup, scene: &Scene, settings: Settings) -> Result<(), CliError> {
    setup.check_memory(scene, workload(settings.method), 0)?;
    let Ok(Some(finer)) = refinable(scene, settings) else { return Ok(()) };
    setup.check_memory(&finer, Workload::Single, 0).map_err(|error| {
        let cell = cells(finer.domain.cell_m);
        CliError::from(error)
            .with_remark(&format!("that is for the plan on {cell}, which --no-refine leaves out"))
    })
}

/// What a method asks of memory.
pub(super) fn workload(method: Method) -> Workload {
    if method.has_adjoint() { Workload::Gradient } else { Workload::Batch }
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
    let Settings { method, patience_epochs, .. } = state.settings;
    if let Some(asked) = arguments.method.filter(|asked| *asked != method) {
        return refuse(format!("was started with method {}, not {}", method.name(), asked.name()));
    }
    if let Some(asked) = arguments.patience.filter(|asked| *asked != patience_epochs) {
        return refuse(format!("was started with patience {patience_epochs}, not {asked}"));
    }
    Ok(())
}
