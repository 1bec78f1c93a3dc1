//! What a command has done so far, kept in its folder: the same command goes on from there.

use super::CliError;
use crate::report::folder::{COMPARISON, PLAN, RunFolder, SCENE, STATE};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::{Map, Value};

/// What a command that is stopped before it is done says. What failed would fail again.
pub(super) fn that_goes_on(error: CliError) -> CliError {
    match error {
        CliError::Interrupted(_) => {
            error.with_remark("what was simulated is saved, and the same command goes on from there")
        }
        error => error,
    }
}

/// What was done, and what it is of: that of something else is not gone on with.
#[derive(Serialize, Deserialize)]
pub(super) struct Kept<S, T> {
    #[serde(flatten)]
    of: S,
    /// In the order in which it was done.
    pub(super) looks: Vec<T>,
}

impl<S: Serialize + DeserializeOwned, T: Serialize + DeserializeOwned> Kept<S, T> {
    /// What a file in the folder has of the same; nothing yet if there is no such file.
    ///
    /// # Errors
    /// It is of something else, or the folder holds something else.
    pub(super) fn begun(folder: &RunFolder, file: &str, of: S) -> Result<Self, CliError> {
        let others = [(PLAN, "plan"), (STATE, "run"), (COMPARISON, "comparison"), (SCENE, "scene")];
        let other = others.into_iter().find(|(other, _)| folder.file(other).exists());
        if let Some((_, what)) = other.filter(|_| !folder.file(file).exists()) {
            return Err(CliError::Input(format!(
                "{} holds a {what} of something else; another --out would be right",
                folder.path().display()
            )));
        }
        Self::begun_beside(folder, file, of)
    }

    /// The same in a folder that is known to be the command's.
    ///
    /// # Errors
    /// It is of something else.
    pub(super) fn begun_beside(folder: &RunFolder, file: &str, of: S) -> Result<Self, CliError> {
        if !folder.file(file).exists() {
            return Ok(Self { of, looks: Vec::new() });
        }
        let name = folder.file(file).display().to_string();
        let kept: Self = serde_json::from_slice(&folder.read(file)?)
            .map_err(|error| CliError::Input(format!("{name} is nothing to go on from: {error}")))?;
        if let Some((field, [found, asked])) = difference(&kept.of, &of) {
            return Err(CliError::Input(format!(
                "{name} was begun with {field} {found}, and {asked} is asked for; another --out would be right"
            )));
        }
        Ok(kept)
    }
}

impl<S: Serialize, T: Serialize> Kept<S, T> {
    /// Writes it.
    ///
    /// # Errors
    /// It cannot be written.
    pub(super) fn keep(&self, folder: &RunFolder, file: &str) -> Result<(), CliError> {
        let text = serde_json::to_vec(self).map_err(std::io::Error::from)?;
        Ok(folder.replace(file, &text)?)
    }
}

/// The first field in which two of a kind differ, and what each has there.
pub(super) fn difference(this: &impl Serialize, that: &impl Serialize) -> Option<(String, [Value; 2])> {
    let [these, those] = [fields(this), fields(that)];
    let mut both = these.into_iter().zip(those);
    both.find_map(|((name, a), (_, b))| (a != b).then_some((name, [a, b])))
}

fn fields(of: &impl Serialize) -> Map<String, Value> {
    match serde_json::to_value(of) {
        Ok(Value::Object(fields)) => fields,
        _ => Map::new(),
    }
}
