//! `optimise campaign`: many cases on one machine, several at a time.

mod case;
mod crew;

use self::{
    case::{Obstacles, folder_of, known, workload},
    crew::{Crew, Told},
};
use super::{CliError, Context, Progress, Resources, next, size::format_size};
use crate::{
    campaign::{
        Campaign, CampaignError, Outcome, Status,
        page::{TABLE_FILE, page, verdict},
        table::{counts, parquet},
    },
    report::{
        amounts::percent,
        folder::RunFolder,
        words::{count, duration, grouped},
    },
};
use clap::Args;
use powderline_simulator::scene::figures::mass;
use powderline_view::page::Tone;
use serde::Serialize;
use std::{
    fs,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

/// The campaign, in its folder.
const CAMPAIGN: &str = "campaign.toml";
/// Its page.
const REPORT: &str = "report.html";

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

/// A campaign whose folder is open and locked.
struct Experiment {
    campaign: Campaign,
    folder: RunFolder,
    /// What became of each case, as far as is known.
    outcomes: Vec<Option<Outcome>>,
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
    let folder = experiment.folder.path().to_string_lossy().into_owned();
    let again = next::optimise(&["campaign", "--resume", &folder]);
    let worked = experiment.work(crew, &progress, context);
    progress.clear();
    let written = experiment.write();
    let remark = format!("what is done is saved, go on with: {again}");
    worked.and(written).map_err(|error| error.with_remark(&remark))?;
    experiment.conclude(arguments.json, crew, context)
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

/// Looks at every setting before anything is begun, and at what may be done at a time.
fn checked(campaign: &Campaign, resources: Resources, context: &Context<'_>) -> Result<Crew, CliError> {
    if let Some(epochs) = campaign.file().epochs {
        crate::run::checked_epochs(epochs)?;
    }
    let (mut refusals, mut scenes): (Vec<String>, Vec<_>) = (Vec::new(), Vec::new());
    let mut obstacles = Obstacles::new(campaign);
    for setting in campaign.settings() {
        if context.interrupt.is_requested() {
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
    if !refusals.is_empty() {
        return Err(CliError::Input(refused(campaign, &refusals)));
    }
    let needs = |each: Resources| {
        let setup = each.setup(0, campaign.file().precision.into());
        scenes.iter().try_for_each(|scene| Ok(setup.check_memory(scene, workload(campaign), 0)?))
    };
    crew::crew(campaign.case_count() as usize, resources, &needs)
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

impl Experiment {
    fn start(campaign: Campaign, out: Option<&Path>) -> Result<Self, CliError> {
        let folder = match out {
            Some(path) if path.join(CAMPAIGN).exists() => {
                let path = path.display();
                return Err(CliError::Input(format!(
                    "{path} already holds a campaign, which is not overwritten; choose another --out, or go on with it by --resume {path}"
                )));
            }
            Some(path) => RunFolder::create(path)?,
            None => RunFolder::create_numbered(&Path::new("runs").join(&campaign.file().name))?,
        };
        let begun = Self::of(campaign, folder)?;
        begun.save()?;
        Ok(begun)
    }

    /// With what an earlier session has done; with more cases, if the campaign has more now.
    fn open(campaign: Campaign, path: &Path) -> Result<Self, CliError> {
        let begun = Self::of(campaign, RunFolder::open_with(path, CAMPAIGN)?)?;
        begun.save()?;
        Ok(begun)
    }

    fn of(campaign: Campaign, folder: RunFolder) -> Result<Self, CliError> {
        let (mut outcomes, mut scene) = (Vec::with_capacity(campaign.case_count() as usize), None);
        for case in campaign.cases() {
            let path = folder_of(folder.path(), &case);
            if !path.exists() {
                outcomes.push(None);
                continue;
            }
            // Seeds share their scene.
            let setting = case.setting.index;
            let (_, scene) = match scene.take() {
                Some(same @ (index, _)) if index == setting => scene.insert(same),
                _ => scene.insert((setting, case.setting.scene()?)),
            };
            outcomes.push(known(&path, &case.key(scene))?);
        }
        Ok(Self { campaign, folder, outcomes })
    }

    /// The campaign as it goes on from here, with its benches: the files that it came from may go.
    fn save(&self) -> Result<(), CliError> {
        let (text, benches) = self.campaign.to_files();
        fs::create_dir_all(self.folder.file("benches"))?;
        for (file, text) in benches {
            self.folder.replace(&file, text.as_bytes())?;
        }
        Ok(self.folder.replace(CAMPAIGN, text.as_bytes())?)
    }

    /// Does what is left.
    fn work(&mut self, crew: Crew, progress: &Progress, context: &mut Context<'_>) -> Result<(), CliError> {
        let is_left =
            |outcome: &Option<Outcome>| outcome.as_ref().is_none_or(|o| o.status() == Status::Failed);
        let left: Vec<u64> =
            (0..).zip(&self.outcomes).filter(|(_, o)| is_left(o)).map(|(case, _)| case).collect();
        let all = self.outcomes.len();
        if left.is_empty() {
            progress.line(&format!("all of {} are done", self.folder.path().display()));
            return Ok(());
        }
        if left.len() < all {
            let done = grouped((all - left.len()) as i64);
            progress.line(&format!("{done} are done already"));
        }
        progress.line(&format!("{}, into {}", crew.words(), self.folder.path().display()));
        progress.begin(&count(left.len() as i64, "case"), 0, &[]);
        let (mut finished, mut written) = (0, Instant::now());
        let folder = self.folder.path().to_owned();
        let campaign = self.campaign.clone();
        crew::work((&campaign, &folder), &left, crew, &context.interrupt, &mut |told| {
            match told {
                Told::Tick => {}
                Told::Words(words) => progress.line(words),
                Told::Done(index) => {
                    finished += 1;
                    let words = self.learn(index)?;
                    progress.line(&format!("[{}/{}] {words}", grouped(finished), grouped(left.len() as i64)));
                    if written.elapsed() >= WRITE {
                        self.write()?;
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

    /// Reads what became of a case, and says it.
    fn learn(&mut self, index: u64) -> Result<String, CliError> {
        let case = self.campaign.case(index);
        let path = folder_of(self.folder.path(), &case);
        let outcome = known(&path, &case.key(&case.setting.scene()?))?;
        let outcome =
            outcome.ok_or_else(|| CliError::Failed(format!("{} has lost its outcome", path.display())))?;
        let words = match (outcome.found(), outcome.error()) {
            (Some(found), _) => {
                let sign = if found.miss > 0.0 { "+" } else { "" };
                let status = outcome.status().name();
                format!(
                    "{}: {} arrive ({sign}{}), {status}",
                    case.name,
                    mass(found.mass_kg),
                    percent(found.miss)
                )
            }
            (None, why) => format!("{}: failed: {}", case.name, why.unwrap_or_default()),
        };
        self.outcomes[index as usize] = Some(outcome);
        Ok(words)
    }

    /// Page and table of what is known.
    fn write(&self) -> Result<(), CliError> {
        let failed = |error: &dyn std::fmt::Display| CliError::Failed(error.to_string());
        let table = parquet(&self.campaign, &self.outcomes).map_err(|error| failed(&error))?;
        self.folder.replace(TABLE_FILE, &table)?;
        let root = self.folder.path();
        let link = |case: &crate::campaign::Case<'_>| {
            let file = folder_of(root, case).join(REPORT);
            let below = file.strip_prefix(root).ok()?;
            file.exists().then(|| {
                below
                    .components()
                    .map(|part| part.as_os_str().to_string_lossy())
                    .collect::<Vec<_>>()
                    .join("/")
            })
        };
        let page = page(&self.campaign, &self.outcomes, &link);
        page.write(&self.folder.file(REPORT)).map_err(|error| failed(&error))
    }

    /// Says what came of it, in the order of what the person needs first.
    fn conclude(&self, json: bool, crew: Crew, context: &mut Context<'_>) -> Result<(), CliError> {
        let [(_, failed), (_, missed), (_, done), (_, met)] = counts(&self.outcomes);
        let (tone, verdict) = verdict(&self.campaign, &self.outcomes);
        let root = self.folder.path();
        if json {
            let (cases, workers, threads_each) = (self.outcomes.len(), crew.workers, crew.each.threads);
            let folder = Some(root);
            context.json(&Report { folder, cases, met, missed, done, failed, workers, threads_each })?;
        } else {
            writeln!(context.out, "\n{verdict}")?;
            writeln!(
                context.out,
                "The page is {}: open it in a browser. The table is {}.",
                root.join(REPORT).display(),
                root.join(TABLE_FILE).display()
            )?;
        }
        match (failed, tone) {
            (0, Tone::Bad) => Err(CliError::Missed(verdict)),
            (0, _) => Ok(()),
            _ => {
                let first = self.outcomes.iter().flatten().find_map(Outcome::error).unwrap_or_default();
                Err(CliError::Failed(format!("{} failed; the first: {first}", count(failed as i64, "case"))))
            }
        }
    }
}
