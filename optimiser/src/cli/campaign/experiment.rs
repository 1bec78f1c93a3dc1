//! A campaign's folder: what it was begun with, what became of each case, table and page.
//!
//! Who does the cases, and where, is not known here: whoever does one tells of it.

use super::case::{CASES, folder_of, known, write_down};
use crate::{
    campaign::{
        Campaign, Case, End, Outcome, Status,
        page::{TABLE_FILE, page, verdict},
        table::{counts, parquet},
    },
    cli::CliError,
    failure::of_file,
    report::{
        amounts::percent,
        folder::{CAMPAIGN, RunFolder},
        words::count,
    },
};
use powderline_simulator::scene::figures::mass;
use powderline_view::page::Tone;
use std::{
    fs, io,
    path::{Path, PathBuf},
};

/// Its page, and that of each search.
pub(super) const REPORT: &str = "report.html";

/// A campaign whose folder is open and locked.
#[derive(Debug)]
pub struct Experiment {
    campaign: Campaign,
    folder: RunFolder,
    /// What became of each case, as far as is known.
    outcomes: Vec<Option<Outcome>>,
}

impl Experiment {
    /// Begins a campaign in a folder; in `runs/<name>`, numbered if taken, where none is given.
    ///
    /// # Errors
    /// The folder holds a campaign or a run, or cannot be used.
    pub fn start(campaign: Campaign, out: Option<&Path>) -> Result<Self, CliError> {
        let folder = match out {
            Some(path) => RunFolder::create(path)?,
            None => RunFolder::create_numbered(&Path::new("runs").join(&campaign.file().name))?,
        };
        let begun = Self::of(campaign, folder)?;
        begun.save()?;
        Ok(begun)
    }

    /// Goes on with what earlier sessions have left in a folder; with more cases, if the campaign has more now.
    ///
    /// # Errors
    /// The folder holds no campaign, or cases of another one, or cannot be used.
    pub fn open(campaign: Campaign, path: &Path) -> Result<Self, CliError> {
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
        let place = self.folder.file("benches");
        fs::create_dir_all(&place).map_err(of_file(&place, "created"))?;
        for (file, text) in benches {
            self.folder.replace(&file, text.as_bytes())?;
        }
        Ok(self.folder.replace(CAMPAIGN, text.as_bytes())?)
    }

    /// The campaign.
    pub fn campaign(&self) -> &Campaign {
        &self.campaign
    }

    /// Its folder.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// What became of each case, as far as is known.
    pub fn outcomes(&self) -> &[Option<Outcome>] {
        &self.outcomes
    }

    /// Numbers of the cases that are still to be done; one that failed is tried again.
    pub fn left(&self) -> Vec<u64> {
        let is_left =
            |outcome: &Option<Outcome>| outcome.as_ref().is_none_or(|o| o.status() == Status::Failed);
        (0..).zip(&self.outcomes).filter(|(_, outcome)| is_left(outcome)).map(|(case, _)| case).collect()
    }

    /// Reads what became of a case in its folder, and says it.
    ///
    /// # Errors
    /// There is nothing of it, or of another case.
    pub fn learn(&mut self, index: u64) -> Result<String, CliError> {
        let case = self.campaign.case(index);
        let path = folder_of(self.folder.path(), &case);
        let outcome = known(&path, &case.key(&case.setting.scene()?))?;
        let outcome =
            outcome.ok_or_else(|| CliError::Failed(format!("{} has lost its outcome", path.display())))?;
        let words = match (outcome.found(), outcome.error()) {
            (Some(found), _) => {
                let sign = if found.miss > 0.0 { "+" } else { "" };
                let (arrive, miss) = (mass(found.mass_kg), percent(found.miss));
                format!("{}: {arrive} arrive ({sign}{miss}), {}", case.name, outcome.status().name())
            }
            (None, why) => format!("{}: failed: {}", case.name, why.unwrap_or_default()),
        };
        self.outcomes[index as usize] = Some(outcome);
        Ok(words)
    }

    /// Puts the folder of a case that was done elsewhere in its place, whole or not at all, and says what became of it. What is there
    /// of the case already gives way.
    ///
    /// # Errors
    /// It cannot be written, or is of another case.
    pub fn deliver(&mut self, index: u64, files: &[(String, Vec<u8>)]) -> Result<String, CliError> {
        let case = self.campaign.case(index);
        let place = folder_of(self.folder.path(), &case);
        let fresh = self.folder.file(&format!("{CASES}/.{}", case.name));
        let removed = |path: &Path| match fs::remove_dir_all(path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        };
        removed(&fresh)?;
        let written = RunFolder::take(&fresh)?;
        for (name, bytes) in files {
            // Its files are in the folder itself.
            match Path::new(name).file_name() == Some(name.as_ref()) {
                true => written.replace(name, bytes)?,
                false => return Err(CliError::Failed(format!("{name:?} is no file of a case"))),
            }
        }
        drop(written);
        removed(&place)?;
        fs::rename(&fresh, &place).map_err(of_file(&fresh, "put into its place"))?;
        self.learn(index)
    }

    /// Writes down why nothing was found, and says it.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn fail(&mut self, index: u64, why: String) -> Result<String, CliError> {
        let case = self.campaign.case(index);
        let key = case.key(&case.setting.scene()?);
        write_down(&folder_of(self.folder.path(), &case), Outcome { key, end: End::Error(why) })?;
        self.learn(index)
    }

    /// Page and table of what is known.
    ///
    /// # Errors
    /// They cannot be written.
    pub fn write(&self) -> Result<(), CliError> {
        let failed = |error: &dyn std::fmt::Display| CliError::Failed(error.to_string());
        let table = parquet(&self.campaign, &self.outcomes).map_err(|error| failed(&error))?;
        self.folder.replace(TABLE_FILE, &table)?;
        // A search has its page before its outcome.
        let has_page = |case: &Case<'_>| {
            self.outcomes[case.index as usize]
                .as_ref()
                .and_then(Outcome::found)
                .is_some_and(|o| o.plan.is_some())
        };
        let link = |case: &Case<'_>| has_page(case).then(|| format!("{CASES}/{}/{REPORT}", case.name));
        let page = page(&self.campaign, &self.outcomes, &link);
        page.write(&self.page_path()).map_err(|error| failed(&error))
    }

    /// Where the page is.
    pub fn page_path(&self) -> PathBuf {
        self.folder.file(REPORT)
    }

    /// Where the table is.
    pub fn table_path(&self) -> PathBuf {
        self.folder.file(TABLE_FILE)
    }

    /// What is to be known first, in one sentence.
    pub fn verdict(&self) -> String {
        verdict(&self.campaign, &self.outcomes).1
    }

    /// Whether all of it came to what was wanted.
    ///
    /// # Errors
    /// Cases failed: the first of them says why. Or some miss what was wanted.
    pub fn judged(&self) -> Result<(), CliError> {
        let [(_, failed), ..] = counts(&self.outcomes);
        let (tone, verdict) = verdict(&self.campaign, &self.outcomes);
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
