//! The file of a campaign.

use super::CampaignError;
use powderline_shared::plan::Precision;
use powderline_simulator::scene::closest_match;
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, fs, path::Path};

/// A longer file is none of a campaign, bytes.
const MAX_BYTES: u64 = 1 << 20;

/// What a campaign's file says: lists of what is to be combined, each with each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CampaignFile {
    /// Name: heading of the page, and of the folder.
    pub name: String,
    /// Benches: names of scenes that come with the program, or TOML files, from the campaign's file on.
    pub benches: Vec<String>,
    /// Wanted in the target container, kilogram; as the benches say, if there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub amounts_kg: Vec<f64>,
    /// Seeds, of packing and first skill.
    pub seeds: Seeds,
    /// Updates of each search; as the benches say, if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub epochs: Option<u32>,
    /// A skill: each case is then one rollout of it, and no search.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub theta: Option<[f64; 5]>,
    /// Whether each search's plan is corrected by what it brings on smaller cells.
    #[serde(default = "yes")]
    pub refine: bool,
    /// Number format of the simulation.
    #[serde(default)]
    pub precision: PrecisionName,
    /// Whether each search's page shows its plan in motion, for which that is simulated once more.
    #[serde(default = "yes")]
    pub replays: bool,
    /// Powders: each what it changes in the benches' `[powder]`. The benches' own, if there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub powder: Vec<Powder>,
    /// Numbers of the powder that are not known exactly.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub draws: Option<Draws>,
}

fn yes() -> bool {
    true
}

/// Seeds of a campaign.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected a list of seeds, or { first = 1, count = 30 }")]
pub enum Seeds {
    /// These.
    List(Vec<u64>),
    /// So many, one after another.
    Range(SeedRange),
}

/// Seeds, one after another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SeedRange {
    /// The first.
    pub first: u64,
    /// How many.
    pub count: u64,
}

impl Seeds {
    /// How many there are.
    pub fn len(&self) -> u64 {
        match self {
            Self::List(seeds) => seeds.len() as u64,
            Self::Range(range) => range.count,
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// One of them.
    pub(super) fn at(&self, index: u64) -> u64 {
        match self {
            Self::List(seeds) => seeds[index as usize],
            Self::Range(range) => range.first + index,
        }
    }
}

/// Number format, as files call it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PrecisionName {
    /// 32-bit floating point.
    #[default]
    F32,
    /// 64-bit floating point.
    F64,
}

impl From<PrecisionName> for Precision {
    fn from(name: PrecisionName) -> Self {
        match name {
            PrecisionName::F32 => Self::F32,
            PrecisionName::F64 => Self::F64,
        }
    }
}

/// A powder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Powder {
    /// What it is called.
    pub name: String,
    /// Keys of a scene's `[powder]`, with its values.
    #[serde(flatten)]
    pub changes: toml::Table,
}

/// Draws of numbers of the powder, the same for each bench, powder, amount and seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Draws {
    /// How many.
    pub count: u32,
    /// Seed of the draws.
    pub seed: u64,
    /// What is drawn: keys of a scene's `[powder]`.
    pub powder: BTreeMap<String, Spread>,
}

/// Where a number lies.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(
    untagged,
    expecting = "expected { low = .., high = .. }, { mean = .., deviation = .. } or { relative = 0.1 }"
)]
pub enum Spread {
    /// Anywhere between two values, each as likely.
    Uniform(Uniform),
    /// Normally distributed.
    Normal(Normal),
    /// Anywhere within a share of the powder's own value, each as likely.
    Relative(Relative),
}

/// See [`Spread::Uniform`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Uniform {
    /// From.
    pub low: f64,
    /// To.
    pub high: f64,
}

/// See [`Spread::Normal`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Normal {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub deviation: f64,
}

/// See [`Spread::Relative`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Relative {
    /// 0.1 is from nine tenths to eleven tenths.
    pub relative: f64,
}

impl CampaignFile {
    /// Reads a campaign's file.
    ///
    /// # Errors
    /// One sentence that names file and field.
    pub fn load(path: &Path) -> Result<Self, CampaignError> {
        let named = |why: String| CampaignError(format!("{}: {why}", path.display()));
        let unreadable = |error: std::io::Error| named(format!("cannot be read: {error}"));
        let about = fs::metadata(path).map_err(unreadable)?;
        if !about.is_file() {
            return Err(named("is no file; a campaign in TOML would be right".into()));
        }
        if about.len() > MAX_BYTES {
            return Err(named(format!("has {} bytes, but a campaign has at most {MAX_BYTES}", about.len())));
        }
        let text = String::from_utf8(fs::read(path).map_err(unreadable)?)
            .map_err(|_| named("is no text; a campaign in TOML would be right".into()))?;
        Self::parse(&path.display().to_string(), &text)
    }

    /// Reads a campaign's text; `file` names it in messages.
    ///
    /// # Errors
    /// One sentence that names file and field.
    pub fn parse(file: &str, text: &str) -> Result<Self, CampaignError> {
        let read: Self = toml::from_str(text).map_err(|error| {
            let at = error.span().map_or(0, |span| span.start).min(text.len());
            let line = 1 + text.as_bytes()[..at].iter().filter(|byte| **byte == b'\n').count();
            CampaignError(format!("{file}, line {line}: {}", plainly(error.message())))
        })?;
        read.check().map_err(|why| CampaignError(format!("{file}: {why}")))?;
        Ok(read)
    }

    /// As text.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a campaign holds nothing that TOML cannot express")
    }

    /// What can be said without any scene.
    fn check(&self) -> Result<(), String> {
        is_name(&self.name).then_some(()).ok_or_else(|| unnamed("name", &self.name))?;
        if self.benches.is_empty() {
            return Err("benches is [], but there must be one at least, such as [\"bench-small\"]".into());
        }
        if self.seeds.is_empty() {
            return Err("seeds has none, but there must be one at least".into());
        }
        if let Seeds::Range(SeedRange { first, count }) = self.seeds
            && first.checked_add(count).is_none()
        {
            return Err(format!("seeds goes from {first} on for {count}, beyond 2^64 - 1"));
        }
        if let Some(theta) = self.theta {
            if let Some(value) = theta.into_iter().find(|value| !(-1.0..=1.0).contains(value)) {
                return Err(format!("theta has {value}, but each of its five numbers must be from -1 to 1"));
            }
            if self.epochs.is_some() {
                return Err(
                    "epochs and theta exclude each other: with theta each case is one rollout of that skill"
                        .into(),
                );
            }
        }
        if let Some(wrong) = self.amounts_kg.iter().find(|kg| !(kg.is_finite() && **kg > 0.0)) {
            return Err(format!("amounts_kg has {wrong}, but each must be above 0"));
        }
        twice("benches", self.benches.iter().cloned())?;
        twice("amounts_kg", self.amounts_kg.iter().map(ToString::to_string))?;
        if let Seeds::List(seeds) = &self.seeds {
            twice("seeds", seeds.iter().map(ToString::to_string))?;
        }
        twice("the powders' names", self.powder.iter().map(|powder| powder.name.clone()))?;
        for Powder { name, changes } in &self.powder {
            is_name(name).then_some(()).ok_or_else(|| unnamed("powder.name", name))?;
            if changes.contains_key("seed") {
                return Err(format!("powder {name:?} has a seed, but the seeds are those of `seeds`"));
            }
        }
        self.draws.as_ref().map_or(Ok(()), Draws::check)
    }
}

impl Draws {
    fn check(&self) -> Result<(), String> {
        if self.count == 0 || self.powder.is_empty() {
            let what = if self.count == 0 { "count is 0" } else { "powder is empty" };
            return Err(format!("draws.{what}, but there must be one at least; or leave [draws] out"));
        }
        for (key, spread) in &self.powder {
            let (given, right) = match *spread {
                Spread::Uniform(Uniform { low, high }) if !(low <= high && (high - low).is_finite()) => {
                    (format!("from {low} to {high}"), "low must not be above high")
                }
                Spread::Normal(Normal { mean, deviation })
                    if !(mean.is_finite() && (0.0..f64::MAX).contains(&deviation)) =>
                {
                    (format!("{mean} +- {deviation}"), "deviation must not be negative")
                }
                Spread::Relative(Relative { relative }) if !(0.0..1.0).contains(&relative) => {
                    (format!("relative = {relative}"), "relative must be from 0 to below 1")
                }
                _ => continue,
            };
            return Err(format!("draws.powder.{key} is {given}, but {right}"));
        }
        Ok(())
    }
}

/// A name goes into those of folders.
fn is_name(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-.".contains(c);
    (1..=32).contains(&name.len()) && name.chars().all(plain) && !name.starts_with(['.', '-'])
}

fn unnamed(field: &str, name: &str) -> String {
    format!(
        "{field} is {name:?}, but it must be 1 to 32 letters (a to z), digits, hyphens or dots: folders are called by it"
    )
}

fn twice(what: &str, values: impl Iterator<Item = String>) -> Result<(), String> {
    let mut all: Vec<String> = values.collect();
    all.sort_unstable();
    let same = all.windows(2).find(|pair| pair[0] == pair[1]);
    same.map_or(Ok(()), |pair| Err(format!("{what}: {} is there twice", pair[0])))
}

/// What serde says, in words that a reader of the file knows; of an unknown key first what may have been meant.
fn plainly(message: &str) -> String {
    let plain = message.split_whitespace().collect::<Vec<_>>().join(" ");
    let Some(rest) = plain.strip_prefix("unknown field ") else { return plain };
    let mut words = rest.split('`').skip(1).step_by(2);
    let word = words.next().unwrap_or_default();
    let known = words.clone().collect::<Vec<_>>().join("`, `");
    let meant =
        closest_match(word, words).map_or(String::new(), |meant| format!("; did you mean `{meant}`?"));
    let separator = if meant.is_empty() { "; possible" } else { " Possible" };
    format!("unknown key `{word}`{meant}{separator} are `{known}`")
}
