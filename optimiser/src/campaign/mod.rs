//! Many cases at once: benches, powders, amounts, draws of uncertain numbers and seeds, each combined with each.
//!
//! Nothing here simulates. A [`Campaign`] says which cases there are and what the scene of each is; an [`Outcome`] what became of one;
//! [`table`] and [`page`] show all of them. Each case is a run like any other, or one rollout, and its result depends on nothing but
//! the case: where and in which order cases are run changes no bit.

mod draw;
mod file;
mod outcome;
pub mod page;
pub mod table;

pub use file::{
    CampaignFile, Draws, Normal, Powder, PrecisionName, Relative, SeedRange, Seeds, Spread, Uniform,
};
pub use outcome::{End, Found, Outcome, Status};

use powderline_simulator::{
    PHYSICS_VERSION,
    scene::{EMBEDDED_SCENES, Scene, SceneError, figures::about},
};
use sha2::{Digest as _, Sha256};
use std::path::Path;
use thiserror::Error;

/// Most cases of a campaign.
pub const MAX_CASES: u64 = 100_000;

/// Why a campaign is none, in one sentence, or one for each case that cannot be run.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct CampaignError(pub String);

/// A campaign with its benches at hand.
#[derive(Clone, Debug, PartialEq)]
pub struct Campaign {
    file: CampaignFile,
    /// In the order of the file.
    benches: Vec<Scene>,
    /// Each bench's `[powder]` and the rest as text's tables, to be changed.
    tables: Vec<toml::Table>,
}

/// What is simulated, whatever the seed: a bench with a powder, an amount and a draw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting<'a> {
    campaign: &'a Campaign,
    /// Its number.
    pub index: u64,
    bench: usize,
    powder: Option<&'a Powder>,
    /// Wanted in the target container, kilogram, where that is not the bench's own affair.
    pub amount_kg: Option<f64>,
    /// Number of the draw, from 0.
    pub draw: Option<u32>,
}

/// One of a campaign's cases.
#[derive(Clone, Debug, PartialEq)]
pub struct Case<'a> {
    /// Its number.
    pub index: u64,
    /// What it is called, and its folder.
    pub name: String,
    /// What is simulated.
    pub setting: Setting<'a>,
    /// Seed of packing and first skill.
    pub seed: u64,
}

impl Campaign {
    /// The campaign of a file; benches that are files are looked for from there on.
    ///
    /// # Errors
    /// One sentence, about the file or about a bench.
    pub fn load(path: &Path) -> Result<Self, CampaignError> {
        let file = CampaignFile::load(path)?;
        let beside = path.parent().unwrap_or(Path::new(""));
        let is_known = |name: &str| EMBEDDED_SCENES.iter().any(|(known, _)| *known == name);
        let found = |name: &String| match is_known(name) {
            true => Scene::load(name),
            false => Scene::load(&beside.join(name).to_string_lossy()),
        };
        let benches: Result<Vec<Scene>, SceneError> = file.benches.iter().map(found).collect();
        let benches =
            benches.map_err(|error| CampaignError(format!("{}: benches: {error}", path.display())))?;
        Self::new(file, benches)
            .map_err(|CampaignError(why)| CampaignError(format!("{}: {why}", path.display())))
    }

    /// A campaign of these benches, one for each that the file names.
    ///
    /// # Errors
    /// One sentence.
    pub fn new(file: CampaignFile, benches: Vec<Scene>) -> Result<Self, CampaignError> {
        let tables =
            benches.iter().map(|bench| bench.to_toml().parse().expect("a scene's text is TOML")).collect();
        let campaign = Self { file, benches, tables };
        let sizes = campaign.sizes();
        let count = sizes.iter().try_fold(1u64, |product, (_, size)| product.checked_mul(*size));
        if count.is_none_or(|count| count > MAX_CASES) {
            let factors = sizes.iter().filter(|(_, size)| *size > 1);
            let product =
                factors.map(|(what, size)| format!("{size} {what}")).collect::<Vec<_>>().join(" x ");
            return Err(CampaignError(format!(
                "{product} are more than {MAX_CASES} cases, the most that a campaign has"
            )));
        }
        for (index, bench) in campaign.benches.iter().enumerate() {
            let name = safe(&bench.name);
            if name.is_empty() {
                return Err(CampaignError(format!(
                    "benches: {} has the name {:?}, of which nothing is left in a file's; letters or digits would be right",
                    campaign.file.benches[index], bench.name
                )));
            }
            if let Some(other) = campaign.benches[..index].iter().position(|other| safe(&other.name) == name)
            {
                let [a, b] = [other, index].map(|index| &campaign.file.benches[index]);
                return Err(CampaignError(format!(
                    "benches: {a} and {b} have the same name, {name:?}, as files have it"
                )));
            }
        }
        let names = campaign.file.amounts_kg.iter().map(|kg| amount_name(*kg));
        let mut names: Vec<String> = names.collect();
        names.sort_unstable();
        if let Some(same) = names.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(CampaignError(format!("amounts_kg: two are {}, to six digits", same[0])));
        }
        Ok(campaign)
    }

    /// How many there are of what is combined.
    fn sizes(&self) -> [(&'static str, u64); 5] {
        let or_one = |count: usize| count.max(1) as u64;
        [
            ("benches", self.benches.len() as u64),
            ("powders", or_one(self.file.powder.len())),
            ("amounts", or_one(self.file.amounts_kg.len())),
            ("draws", self.file.draws.as_ref().map_or(1, |draws| draws.count.into())),
            ("seeds", self.file.seeds.len()),
        ]
    }

    /// What the file says.
    pub fn file(&self) -> &CampaignFile {
        &self.file
    }

    /// The benches, as they are without the campaign.
    pub fn benches(&self) -> &[Scene] {
        &self.benches
    }

    /// How many cases there are.
    pub fn case_count(&self) -> u64 {
        self.sizes().iter().map(|(_, size)| size).product()
    }

    /// How many settings there are, each with every seed.
    pub fn setting_count(&self) -> u64 {
        self.case_count() / self.file.seeds.len()
    }

    /// One of the settings; seeds change fastest from case to case, then draws, amounts, powders.
    pub fn setting(&self, index: u64) -> Setting<'_> {
        let [_, (_, powders), (_, amounts), (_, draws), _] = self.sizes();
        let (rest, draw) = (index / draws, index % draws);
        let (rest, amount) = (rest / amounts, rest % amounts);
        let (bench, powder) = (rest / powders, rest % powders);
        Setting {
            campaign: self,
            index,
            bench: bench as usize,
            powder: self.file.powder.get(powder as usize),
            amount_kg: self.file.amounts_kg.get(amount as usize).copied(),
            draw: self.file.draws.as_ref().map(|_| draw as u32),
        }
    }

    /// All settings, in order.
    pub fn settings(&self) -> impl Iterator<Item = Setting<'_>> {
        (0..self.setting_count()).map(|index| self.setting(index))
    }

    /// One of the cases.
    pub fn case(&self, index: u64) -> Case<'_> {
        let seeds = self.file.seeds.len();
        let (setting, seed) = (self.setting(index / seeds), self.file.seeds.at(index % seeds));
        Case { index, name: format!("{}_seed{seed}", setting.name()), setting, seed }
    }

    /// All cases, in order.
    pub fn cases(&self) -> impl Iterator<Item = Case<'_>> {
        (0..self.case_count()).map(|index| self.case(index))
    }

    /// Whether each case is one rollout, and no search.
    pub fn is_of_rollouts(&self) -> bool {
        self.file.theta.is_some()
    }

    /// The same campaign with its benches as files beside its own: what it is saved as, and those files.
    pub fn to_files(&self) -> (String, Vec<(String, String)>) {
        let name = |bench: &Scene| format!("benches/{}.toml", safe(&bench.name));
        let benches = self.benches.iter().map(name).collect();
        let saved = CampaignFile { benches, ..self.file.clone() };
        (saved.to_toml(), self.benches.iter().map(|bench| (name(bench), bench.to_toml())).collect())
    }
}

impl<'a> Setting<'a> {
    /// The bench's name.
    pub fn bench(&self) -> &'a str {
        &self.campaign.benches[self.bench].name
    }

    /// The powder's name; none where it is the bench's own.
    pub fn powder(&self) -> Option<&'a str> {
        self.powder.map(|powder| powder.name.as_str())
    }

    /// What it is called: its parts, with underscores between them.
    pub fn name(&self) -> String {
        let parts = [
            Some(safe(self.bench())),
            self.powder().map(String::from),
            self.amount_kg.map(amount_name),
            self.draw.map(|draw| format!("draw{}", draw + 1)),
        ];
        parts.into_iter().flatten().collect::<Vec<_>>().join("_")
    }

    /// Its `[powder]`: the bench's, with what powder and draw change.
    ///
    /// # Errors
    /// One sentence, about a draw around a number that is not there.
    pub fn powder_fields(&self) -> Result<toml::Table, CampaignError> {
        let own = self.campaign.tables[self.bench].get("powder").and_then(toml::Value::as_table);
        let mut fields = own.cloned().unwrap_or_default();
        if let Some(powder) = self.powder {
            merge(&mut fields, &powder.changes);
        }
        let Some((draws, draw)) = self.campaign.file.draws.as_ref().zip(self.draw) else { return Ok(fields) };
        for (key, spread) in &draws.powder {
            let own = fields.get(key).and_then(number);
            if own.is_none() && matches!(spread, Spread::Relative(_)) {
                let why =
                    format!("draws.powder.{key} is relative, but the powder has no number of that name");
                return Err(CampaignError(why));
            }
            let value = draw::drawn(draws.seed, draw, key, spread, own.unwrap_or_default());
            fields.insert(key.clone(), value.into());
        }
        Ok(fields)
    }

    /// Its scene.
    ///
    /// # Errors
    /// One sentence, or a line for each value that is out of range.
    pub fn scene(&self) -> Result<Scene, CampaignError> {
        let mut fields = self.campaign.tables[self.bench].clone();
        let name = self.name();
        fields.insert("name".into(), name.clone().into());
        fields.insert("powder".into(), self.powder_fields()?.into());
        if let Some(kg) = self.amount_kg
            && let Some(objective) = fields.get_mut("objective").and_then(toml::Value::as_table_mut)
        {
            let mut amount = toml::Table::new();
            // The tolerance stays, and how much is wanted is said once.
            let tolerance = objective.get("amount").and_then(|old| old.get("tolerance")).cloned();
            amount.extend(tolerance.map(|tolerance| ("tolerance".to_owned(), tolerance)));
            amount.insert("mass_kg".into(), kg.into());
            objective.insert("amount".into(), amount.into());
        }
        let text = toml::to_string(&fields).map_err(|error| CampaignError(error.to_string()))?;
        Scene::from_toml(&name, &text).map_err(|error| CampaignError(error.without_line()))
    }
}

/// Another one with whatever changes what a search comes to: how it searches, how its plan is corrected, what the arm may perform.
const SEARCH_VERSION: u32 = 2;

impl Case<'_> {
    /// What a result is of: 64 hexadecimal digits that change with everything that the result depends on.
    pub fn key(&self, scene: &Scene) -> String {
        let CampaignFile { epochs, theta, refine, precision, .. } = &self.setting.campaign.file;
        // A rollout makes no plan that could be corrected.
        let refine = *refine && theta.is_none();
        // How a search searches is nothing to a rollout.
        let search = if theta.is_none() { format!(" {SEARCH_VERSION}") } else { String::new() };
        let work =
            format!("{PHYSICS_VERSION} {} {epochs:?} {theta:?} {refine} {precision:?}{search}", self.seed);
        let digest = Sha256::new().chain_update(scene.digest()).chain_update(work).finalize();
        crate::report::words::hex(&digest)
    }
}

/// Puts changes into a table, table by table.
fn merge(fields: &mut toml::Table, changes: &toml::Table) {
    for (key, change) in changes {
        match (fields.get_mut(key).and_then(toml::Value::as_table_mut), change.as_table()) {
            (Some(old), Some(change)) => merge(old, change),
            _ => {
                fields.insert(key.clone(), change.clone());
            }
        }
    }
}

/// A number of a scene.
fn number(value: &toml::Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))
}

/// Such as `1.6g`.
fn amount_name(kg: f64) -> String {
    format!("{}g", about(1e3 * kg, 6))
}

/// A scene's name as part of a folder's.
fn safe(name: &str) -> String {
    let safe = |c: char| if c.is_alphanumeric() || "-.".contains(c) { c } else { '-' };
    let name: String = name.chars().map(safe).collect();
    name.trim_start_matches('.').into()
}
