//! `optimise campaign`: many cases on one machine, several at a time.

mod case;
mod crew;
mod experiment;

pub use self::experiment::Experiment;

use self::{
    case::{Obstacles, settings},
    crew::{Crew, Site, Told},
};
use super::{CliError, Context, Interrupt, Progress, Resources, next, run::check_memory, size::format_size};
use crate::{
    campaign::{Campaign, CampaignError, table::counts},
    report::{
        folder::{CAMPAIGN, RunFolder},
        words::{count, duration, grouped},
    },
    run::MAX_EPOCHS,
};
use clap::Args;
use powderline_simulator::{rollout::Workload, scene::Scene};
use serde::Serialize;
use std::{
    path::{Path, PathBuf},
    process::Command,
    time::{Duration, Instant},
};

/// From one time that page and table are written to the next, at least.
const WRITE: Duration = Duration::from_secs(60);

/// Most refusals that are shown; the others are counted.
const MAX_REFUSALS: usize = 50;

/// Arguments of `optimise campaign`.
#[derive(Clone, Debug, Args)]
pub(super) struct CampaignArgs {
    /// The campaign, a TOML file: benches, powders, amounts and seeds, each combined with each
    #[arg(value_name = "FILE", required_unless_present_any = ["resume", "worker"])]
    pub file: Option<PathBuf>,
    /// Folder to write into, new or without a campaign [default: runs/<campaign>, numbered if taken]
    #[arg(long, value_name = "DIR", conflicts_with = "resume")]
    pub out: Option<PathBuf>,
    /// Go on with the campaign in this folder; with FILE, which may have more cases than before
    #[arg(long, value_name = "DIR")]
    pub resume: Option<PathBuf>,
    /// Only check it: nothing is begun
    #[arg(long, conflicts_with_all = ["resume", "out"])]
    pub check: bool,
    /// Threads and memory, of all cases that are done at a time together.
    #[command(flatten)]
    pub resources: Resources,
    /// Print what came of it as one JSON object
    #[arg(long)]
    pub json: bool,
    /// Do cases of the campaign in this folder, as told on standard input
    #[arg(long, value_name = "DIR", hide = true, conflicts_with_all = ["file", "out", "resume", "check", "json"])]
    pub worker: Option<PathBuf>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report<'a> {
    folder: Option<&'a Path>,
    cases: usize,
    met: usize,
    missed: usize,
    done: usize,
    failed: usize,
    workers: usize,
    threads_each: Option<u16>,
}

impl From<CampaignError> for CliError {
    fn from(error: CampaignError) -> Self {
        Self::Input(error.to_string())
    }
}

/// Runs the command.
///
/// # Errors
/// What stands in the way of a campaign, a line for each case that cannot be done; what came to a plan is saved.
pub(super) fn execute(arguments: &CampaignArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    if let Some(folder) = &arguments.worker {
        let campaign = Campaign::load(&folder.join(CAMPAIGN))?;
        return crew::serve(&campaign, folder, arguments.resources, context);
    }
    let campaign = match (&arguments.file, &arguments.resume) {
        (Some(file), _) => Campaign::load(file)?,
        (None, Some(folder)) => {
            // It says best what is missing.
            drop(RunFolder::open_with(folder, CAMPAIGN)?);
            Campaign::load(&folder.join(CAMPAIGN))?
        }
        (None, None) => return Err(CliError::Input("there is no file".into())),
    };
    let progress = Progress::new(&context.err, context.live);
    progress.line(&format!("{}: {}", campaign.file().name, count(campaign.case_count() as i64, "case")));
    let crew = checked(&campaign, arguments.resources, context)?;
    if arguments.check {
        return arguments.told_what_it_takes(&campaign, crew, context);
    }
    let mut experiment = match &arguments.resume {
        Some(folder) => Experiment::open(campaign, folder)?,
        None => Experiment::start(campaign, arguments.out.as_deref())?,
    };
    let again = next::optimise(&["campaign", "--resume", &experiment.path().to_string_lossy()]);
    let worked = work(&mut experiment, crew, &progress, context);
    progress.clear();
    let written = experiment.write();
    let remark = format!("what is done is saved, go on with: {again}");
    worked.and(written).map_err(|error| error.with_remark(&remark))?;
    conclude(&experiment, arguments.json, crew, context)
}

impl CampaignArgs {
    fn told_what_it_takes(
        &self,
        campaign: &Campaign,
        crew: Crew,
        context: &mut Context<'_>,
    ) -> Result<(), CliError> {
        if self.json {
            let cases = campaign.case_count() as usize;
            let (workers, threads_each) = (crew.workers, crew.each.threads);
            let report =
                Report { folder: None, cases, met: 0, missed: 0, done: 0, failed: 0, workers, threads_each };
            return context.json(&report);
        }
        writeln!(context.out, "{} can be run: {}.", campaign.file().name, crew.words())?;
        Ok(())
    }
}

impl Crew {
    fn words(&self) -> String {
        let Self { workers, each } = self;
        format!(
            "{} at a time, with {} and {} each",
            count(*workers as i64, "case"),
            count(i64::from(each.threads.unwrap_or(1)), "thread"),
            format_size(each.memory.bytes())
        )
    }
}

/// How many cases are done at a time on this machine, once every setting has been looked at.
fn checked(campaign: &Campaign, resources: Resources, context: &Context<'_>) -> Result<Crew, CliError> {
    let scenes = possible(campaign, &context.interrupt)?;
    let needs = |each: Resources| enough(campaign, &scenes, each);
    crew::crew(campaign.case_count() as usize, resources, &needs)
}

/// Looks at every setting before anything is begun, each case with threads and memory of its own.
///
/// # Errors
/// What stands in the way, a line for each setting whose cases cannot be done.
pub fn check_apart(campaign: &Campaign, each: Resources, interrupt: &Interrupt) -> Result<(), CliError> {
    enough(campaign, &possible(campaign, interrupt)?, each)
}

/// Does cases of the campaign whose file is in this folder, one after another, in a process of its own, which `program` is, and tells
/// of each that has come to its end. What they leave behind is in this folder, as for [`Experiment::learn`].
///
/// # Errors
/// It was stopped, or the folder cannot be used; what a case fails of otherwise is its outcome.
pub fn perform_apart(
    folder: &Path,
    cases: &[u64],
    each: Resources,
    program: &(dyn Fn() -> Command + Sync),
    interrupt: &Interrupt,
    ended: &mut dyn FnMut(u64),
) -> Result<(), CliError> {
    let campaign = Campaign::load(&folder.join(CAMPAIGN))?;
    let site = Site { campaign: &campaign, folder, program };
    crew::work(site, cases, Crew { workers: 1, each }, interrupt, &mut |told| {
        if let Told::Done(case) = told {
            ended(case);
        }
        Ok(())
    })
}

/// Whether each case can be done in so much memory.
fn enough(campaign: &Campaign, scenes: &[Scene], each: Resources) -> Result<(), CliError> {
    let setup = each.setup(0, campaign.file().precision.into());
    scenes.iter().try_for_each(|scene| match settings(campaign) {
        None => Ok(setup.check_memory(scene, Workload::Single, 0)?),
        Some(settings) => check_memory(&setup, scene, settings),
    })
}

/// The scenes that differ in what they take; all settings have been looked at.
fn possible(campaign: &Campaign, interrupt: &Interrupt) -> Result<Vec<Scene>, CliError> {
    if let Some(epochs) = campaign.file().epochs.filter(|epochs| *epochs > MAX_EPOCHS) {
        return Err(CliError::Input(format!(
            "epochs of campaign {:?} is {epochs}, but at most {MAX_EPOCHS} are possible",
            campaign.file().name
        )));
    }
    let (mut refusals, mut scenes): (Vec<String>, Vec<_>) = (Vec::new(), Vec::new());
    let mut obstacles = Obstacles::new(campaign);
    for setting in campaign.settings() {
        if interrupt.is_requested() {
            return Err(CliError::Interrupted("stopped on request; nothing was begun".into()));
        }
        let refused = match setting.scene() {
            Err(error) => Some(error.to_string()),
            Ok(scene) => {
                let refused = obstacles.of(&setting, &scene);
                // What a draw changes is no matter of memory.
                if setting.draw.is_none_or(|draw| draw == 0) {
                    scenes.push(scene);
                }
                refused
            }
        };
        // Its name may begin what is said of its scene.
        refusals.extend(refused.map(|why| match why.starts_with(&setting.name()) {
            true => why,
            false => format!("{}: {why}", setting.name()),
        }));
    }
    if refusals.is_empty() { Ok(scenes) } else { Err(CliError::Input(refused(campaign, &refusals))) }
}

/// The sentence, and the lines below it.
fn refused(campaign: &Campaign, refusals: &[String]) -> String {
    let seeds = campaign.file().seeds.len();
    let each = if seeds > 1 { format!(", each with {} seeds", grouped(seeds as i64)) } else { String::new() };
    let mut text = format!(
        "{}: {} of {} cannot be run{each}, and nothing was begun:",
        campaign.file().name,
        grouped(refusals.len() as i64),
        count(campaign.setting_count() as i64, "case"),
    );
    for refusal in refusals.iter().take(MAX_REFUSALS) {
        text += &format!("\n  {}", refusal.replace('\n', "\n  "));
    }
    if refusals.len() > MAX_REFUSALS {
        text += &format!("\n  and {} more", grouped((refusals.len() - MAX_REFUSALS) as i64));
    }
    text
}

/// Does what is left.
fn work(
    experiment: &mut Experiment,
    crew: Crew,
    progress: &Progress,
    context: &mut Context<'_>,
) -> Result<(), CliError> {
    let (left, all, folder) = (experiment.left(), experiment.outcomes().len(), experiment.path().to_owned());
    if left.is_empty() {
        progress.line(&format!("all of {} are done", folder.display()));
        return Ok(());
    }
    if left.len() < all {
        let done = grouped((all - left.len()) as i64);
        progress.line(&format!("{done} are done already"));
    }
    progress.line(&format!("{}, into {}", crew.words(), folder.display()));
    progress.begin(&count(left.len() as i64, "case"), 0, &[]);
    let (mut finished, mut written) = (0, Instant::now());
    let campaign = experiment.campaign().clone();
    let site = Site { campaign: &campaign, folder: &folder, program: &next::again };
    crew::work(site, &left, crew, &context.interrupt, &mut |told| {
        match told {
            Told::Tick => {}
            Told::Words(words) => progress.line(words),
            Told::Done(index) => {
                finished += 1;
                let words = experiment.learn(index)?;
                progress.line(&format!("[{}/{}] {words}", grouped(finished), grouped(left.len() as i64)));
                if written.elapsed() >= WRITE {
                    experiment.write()?;
                    written = Instant::now();
                }
            }
        }
        progress.tick(finished as f64 / left.len() as f64);
        Ok(())
    })?;
    let seconds = progress.seconds();
    progress.clear();
    progress.line(&format!("{} in {}", count(left.len() as i64, "case"), duration(seconds)));
    Ok(())
}

/// Says what came of it, in the order of what the person needs first.
fn conclude(
    experiment: &Experiment,
    json: bool,
    crew: Crew,
    context: &mut Context<'_>,
) -> Result<(), CliError> {
    if json {
        let [(_, failed), (_, missed), (_, done), (_, met)] = counts(experiment.outcomes());
        let (cases, workers, threads_each) = (experiment.outcomes().len(), crew.workers, crew.each.threads);
        let folder = Some(experiment.path());
        context.json(&Report { folder, cases, met, missed, done, failed, workers, threads_each })?;
    } else {
        let (page, table) = (experiment.page_path(), experiment.table_path());
        writeln!(context.out, "\n{}", experiment.verdict())?;
        writeln!(
            context.out,
            "The page is {}: open it in a browser. The table is {}.",
            page.display(),
            table.display()
        )?;
    }
    experiment.judged()
}
