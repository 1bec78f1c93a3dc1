//! One case of a campaign, done in this process.

use crate::{
    campaign::{Campaign, Case, End, Found, Outcome, Setting},
    cli::{
        CliError, Context, Interrupt, Resources, Stream, check, report,
        run::{self, RunArgs},
    },
    failure::of_file,
    report::{
        amounts::Amounts,
        finding,
        folder::{PLAN, RunFolder, STATE},
        record::RunRecord,
        state::Settings,
    },
};
use powderline_shared::plan::{PlanReader, Precision, file::read_plan_file};
use powderline_simulator::{
    scene::Scene,
    skill::{SkillMap, Theta},
};
use std::{
    collections::BTreeMap,
    fs, io,
    path::{Path, PathBuf},
};

/// Folder of the cases' folders.
pub(super) const CASES: &str = "cases";

/// What became of a case, in its folder.
const OUTCOME: &str = "outcome.json";

/// A case's folder, within the campaign's.
pub(super) fn folder_of(campaign: &Path, case: &Case<'_>) -> PathBuf {
    campaign.join(CASES).join(&case.name)
}

/// What the campaign's folder holds of a case, if that is of this very case; nothing of one that failed, which is tried again.
///
/// # Errors
/// The folder holds a case that was computed for something else.
pub(super) fn known(folder: &Path, key: &str) -> Result<Option<Outcome>, CliError> {
    let path = folder.join(OUTCOME);
    // What was written half is not there: it is renamed when it is whole.
    let Ok(bytes) = fs::read(&path) else { return Ok(None) };
    let outcome: Outcome = serde_json::from_slice(&bytes).map_err(|error| {
        CliError::Input(format!("{} is not what a campaign leaves behind: {error}", path.display()))
    })?;
    match outcome.key == key {
        true => Ok(Some(outcome)),
        false => Err(of_another_case(&path)),
    }
}

fn of_another_case(path: &Path) -> CliError {
    CliError::Input(format!(
        "{} is of another case: of another scene, seed, version or way to search; choose another folder with --out",
        path.display()
    ))
}

/// Whether a run that a folder may hold is this very case's, and can be gone on with. One that cannot be read is that case's own trouble.
fn check_begun(campaign: &Campaign, case: &Case<'_>, scene: &Scene, folder: &Path) -> Result<(), CliError> {
    let Some((settings, Ok(record))) = settings(campaign).zip(Some(RunRecord::read(folder))) else {
        return Ok(());
    };
    let precision = Precision::from(campaign.file().precision);
    match record.state.is_of(scene.digest(), (case.seed, precision), settings) {
        true => Ok(()),
        false => Err(of_another_case(&folder.join(STATE))),
    }
}

/// What stands in the way of settings' cases.
pub(super) struct Obstacles<'a> {
    campaign: &'a Campaign,
    /// Whether the powder lies elsewhere in some settings of a bench: then each is looked at by itself.
    moves: bool,
    /// By bench, what tool and arm cannot do; the same for all its settings, and far from quickly found.
    immovable: BTreeMap<&'a str, Option<String>>,
}

impl<'a> Obstacles<'a> {
    pub(super) fn new(campaign: &'a Campaign) -> Self {
        let file = campaign.file();
        let drawn = file.draws.iter().flat_map(|draws| draws.powder.keys());
        let mut keys = file.powder.iter().flat_map(|powder| powder.changes.keys()).chain(drawn);
        Self { campaign, moves: keys.any(|key| key.starts_with("fill_")), immovable: BTreeMap::new() }
    }

    /// Why a setting's cases cannot be done.
    pub(super) fn of(&mut self, setting: &Setting<'a>, scene: &Scene) -> Option<String> {
        match self.campaign.file().theta.map(Theta::new) {
            Some(Err(error)) => Some(error.to_string()),
            Some(Ok(theta)) => SkillMap::new(scene).controls(&theta).err().map(|error| error.to_string()),
            None => {
                scene.check_feasible().err().map(|error| error.to_string()).or_else(|| match self.moves {
                    true => immovable(scene),
                    false => {
                        self.immovable.entry(setting.bench()).or_insert_with(|| immovable(scene)).clone()
                    }
                })
            }
        }
    }
}

/// What tool and arm cannot do, whatever the powder is.
fn immovable(scene: &Scene) -> Option<String> {
    let corners = || SkillMap::new(scene).check_all_corners().err().map(|error| error.to_string());
    check::immovable(scene).or_else(corners)
}

/// How its cases search; they do not where they are rollouts.
pub(super) fn settings(campaign: &Campaign) -> Option<Settings> {
    let (usual, file) = (Settings::default(), campaign.file());
    let refine_by = if file.refine { usual.refine_by } else { 0 };
    let epochs = file.epochs.unwrap_or(usual.epochs);
    (!campaign.is_of_rollouts()).then_some(Settings { epochs, refine_by, ..usual })
}

/// Does a case, or goes on with it, and writes down what became of it. One that is done is not done again.
///
/// # Errors
/// It was stopped, or its folder cannot be used; what it fails of otherwise is its outcome.
pub(super) fn perform(
    campaign: &Campaign,
    folder: &Path,
    index: u64,
    resources: Resources,
    interrupt: &Interrupt,
) -> Result<Outcome, CliError> {
    let case = campaign.case(index);
    let scene = case.setting.scene().map_err(|error| CliError::Input(error.to_string()))?;
    let (key, folder) = (case.key(&scene), folder_of(folder, &case));
    if let Some(done) = known(&folder, &key)?.filter(|outcome| outcome.found().is_some()) {
        return Ok(done);
    }
    check_begun(campaign, &case, &scene, &folder)?;
    let work = Work { campaign, case: &case, scene: &scene, folder: &folder, resources, interrupt };
    let found = match campaign.file().theta {
        Some(theta) => work.rollout(theta),
        None => work.search(),
    };
    let end = match found {
        Ok(found) => End::Found(found),
        Err(stopped @ CliError::Interrupted(_)) => return Err(stopped),
        Err(error) => End::Error(error.to_string()),
    };
    write_down(&folder, Outcome { key, end })
}

/// Writes down what became of a case.
///
/// # Errors
/// [`crate::report::folder::FolderError`].
pub(super) fn write_down(folder: &Path, outcome: Outcome) -> Result<Outcome, CliError> {
    let text = serde_json::to_string(&outcome).map_err(io::Error::from)?;
    RunFolder::take(folder)?.replace(OUTCOME, text.as_bytes())?;
    Ok(outcome)
}

/// What is to be done of a case.
struct Work<'a> {
    campaign: &'a Campaign,
    case: &'a Case<'a>,
    scene: &'a Scene,
    folder: &'a Path,
    resources: Resources,
    interrupt: &'a Interrupt,
}

impl Work<'_> {
    fn precision(&self) -> Precision {
        self.campaign.file().precision.into()
    }

    fn rollout(&self, theta: [f64; 5]) -> Result<Found, CliError> {
        let setup = self.resources.setup(self.case.seed, self.precision());
        let mut simulator = setup.simulator(self.scene)?;
        let interrupt = self.interrupt.clone();
        simulator.set_progress(Box::new(move |_| interrupt.flow()));
        let theta = Theta::new(theta)?;
        let found = simulator.evaluate(&theta)?;
        Ok(Found::of_rollout(&Amounts::from(self.scene), theta, &found))
    }

    /// A run like any other.
    fn search(&self) -> Result<Found, CliError> {
        // Before its state is there, a run cannot be gone on with.
        if self.folder.exists() && !self.folder.join(STATE).exists() {
            fs::remove_dir_all(self.folder).map_err(of_file(self.folder, "removed"))?;
        }
        self.run()?;
        let found = self.found()?;
        // What was found stands, whatever becomes of its page.
        match self.page(None) {
            Err(CliError::Failed(why) | CliError::Input(why)) => self.page(Some(why))?,
            ended => ended?,
        }
        Ok(found)
    }

    /// Without a replay where something is in its way.
    fn page(&self, obstacle: Option<String>) -> Result<(), CliError> {
        let page = report::ReportArgs {
            of: self.folder.into(),
            executed: None,
            out: None,
            no_replay: !self.campaign.file().replays,
            obstacle,
            json: false,
            resources: self.resources,
        };
        self.quietly(|context| report::execute(&page, context))
    }

    /// The one place where `optimise run` is called.
    fn run(&self) -> Result<(), CliError> {
        let begun = self.folder.join(STATE).exists();
        let (out, resume) =
            if begun { (None, Some(self.folder.into())) } else { (Some(self.folder.into()), None) };
        let arguments = RunArgs {
            scene: None,
            seed: Some(self.case.seed),
            method: None,
            epochs: self.campaign.file().epochs,
            patience: None,
            no_refine: !self.campaign.file().refine,
            precision: Some(self.precision().into()),
            resources: self.resources,
            out,
            resume,
            json: false,
        };
        let ended = self.quietly(|context| run::run(&arguments, Some(self.scene), &|_| {}, context));
        match ended {
            // A plan that misses is a result.
            Err(CliError::Missed(_)) => Ok(()),
            other => other,
        }
    }

    /// Does a command of which nobody hears.
    fn quietly(
        &self,
        command: impl FnOnce(&mut Context<'_>) -> Result<(), CliError>,
    ) -> Result<(), CliError> {
        let mut context = Context {
            factory: &|scene, setup| setup.simulator(scene),
            interrupt: self.interrupt.clone(),
            out: &mut io::sink(),
            err: Stream::new(io::sink()),
            live: false,
        };
        command(&mut context)
    }

    /// What the run in the folder has found.
    fn found(&self) -> Result<Found, CliError> {
        let record = RunRecord::read(self.folder)?;
        let (Some(found), Some(shipped)) = (record.finding(), &record.shipped) else {
            return Err(CliError::Failed("the run came to no plan".into()));
        };
        let bytes = read_plan_file(&self.folder.join(PLAN))?;
        let plan = PlanReader::new(&bytes).map_err(|error| CliError::Failed(error.to_string()))?;
        let (amounts, outcome) = finding::Outcome::finest_of_plan(&found.amounts, plan.header());
        Ok(Found {
            met: found.met,
            epochs: found.epoch.map(|epoch| [found.last_epoch, epoch]),
            plan: Some(format!("{:016x}", plan.content_hash())),
            own_mass_kg: shipped.outcome.mass_kg,
            loss_m: shipped.outcome.loss_m,
            ..Found::of(&amounts, shipped.theta, &outcome)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{cli::size::Memory, run::Run};

    /// Whoever changes a powder between two calls does not get the search of the one before under the new one's name.
    #[test]
    fn a_search_that_was_begun_for_another_powder_is_not_gone_on_with() {
        let place = tempfile::tempdir().unwrap();
        let campaign = |density: u32, more: &str| {
            let file = place.path().join("many.toml");
            let text = format!(
                "name = \"many\"\nbenches = [\"bench-small\"]\nseeds = [1]\n{more}\n[[powder]]\nname = \"salt\"\n\
                 density_kg_m3 = {density}.0\n"
            );
            fs::write(&file, text).unwrap();
            Campaign::load(&file).unwrap()
        };
        let first = campaign(1000, "");
        let case = first.case(0);
        let scene = case.setting.scene().unwrap();
        let folder = folder_of(place.path(), &case);
        let precision = Precision::from(first.file().precision);
        let begun = RunFolder::create(&folder).unwrap();
        drop(Run::begin(begun, scene.clone(), (case.seed, precision), settings(&first).unwrap()).unwrap());
        assert!(check_begun(&first, &case, &scene, &folder).is_ok());
        for other in [campaign(1100, ""), campaign(1000, "epochs = 3"), campaign(1000, "refine = false")] {
            let resources = Resources { threads: Some(1), memory: Memory::Available };
            let done = perform(&other, place.path(), 0, resources, &Interrupt::default());
            let error = done.unwrap_err().to_string();
            assert!(error.contains("state is of another case: of another scene, seed"), "{error}");
            assert!(!folder.join(OUTCOME).exists());
        }
    }
}
