//! What can be wrong with a scene, each as one sentence.

use thiserror::Error;

/// Most characters of a name, of a scene, of a container or of a gate.
pub(super) const MAX_NAME_CHARS: usize = 64;

/// Whether it can be shown as it is.
pub(super) fn is_name(name: &str) -> bool {
    (1..=MAX_NAME_CHARS).contains(&name.chars().count()) && !name.chars().any(char::is_control)
}

/// How messages name table `index` of a list, `container` or `gate`: by its name where that is printable and unique, else by
/// its index.
pub(super) fn listed_path(list: &str, names: &[&str], index: usize) -> String {
    let bearers = |name: &str| names.iter().filter(|other| **other == name).count();
    match names.get(index) {
        Some(name) if is_name(name) && bearers(name) == 1 => format!("{list} {name:?}"),
        _ => format!("{list}[{index}]"),
    }
}

/// Why a scene was refused. Displays as one sentence that names the file and, where there is one, the field,
/// its value and what would be right.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum SceneError {
    /// Neither an embedded scene nor a file.
    #[error("there is no scene and no file called `{name}`; the embedded scenes are {known}{meant}")]
    UnknownName {
        /// What was asked for.
        name: String,
        /// Names of the embedded scenes.
        known: String,
        /// The question whether one of them was meant, or nothing.
        meant: String,
    },
    /// The operating system refused to read the file.
    #[error("{file} cannot be read: {reason}")]
    Unreadable {
        /// The scene file.
        file: String,
        /// The operating system's reason.
        reason: String,
    },
    /// A folder, a pipe or a device.
    #[error("{file} is {what}, not a file; {right} would be right")]
    NotAFile {
        /// The path.
        file: String,
        /// What it is instead.
        what: &'static str,
        /// What would be right.
        right: String,
    },
    /// Larger than any scene can sensibly be; it was not read.
    #[error("{file} holds {bytes} bytes, but a scene has at most {limit} bytes")]
    TooLarge {
        /// The scene file.
        file: String,
        /// Its size, bytes.
        bytes: u64,
        /// [`super::MAX_SCENE_BYTES`].
        limit: u64,
    },
    /// Not UTF-8.
    #[error("{file} is not a text file: byte {offset} is not valid UTF-8; a scene in TOML would be right")]
    NotText {
        /// The scene file.
        file: String,
        /// Offset of the first bad byte.
        offset: usize,
    },
    /// Nothing but white space and comments.
    #[error("{file} is empty; a scene in TOML would be right (`optimise new FILE` writes an example)")]
    Empty {
        /// The scene file.
        file: String,
    },
    /// Not TOML.
    #[error("{file} is not valid TOML at line {line}, column {column}: {reason}")]
    Syntax {
        /// The scene file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// The parser's reason.
        reason: String,
    },
    /// Unknown or missing field, or a value of the wrong type.
    #[error("{file}: {field} at line {line}: {reason}")]
    Structure {
        /// The scene file.
        file: String,
        /// Dotted path of the field, or of the table that it belongs to, a container or gate by its name.
        field: String,
        /// Line, from 1.
        line: usize,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// A value out of its range, or at odds with the other fields.
    #[error("{file}: {field} is {value}, but {expected}")]
    Invalid {
        /// The scene file.
        file: String,
        /// Dotted path of the field, a container or gate by its name.
        field: String,
        /// Its value.
        value: String,
        /// What would be right.
        expected: String,
    },
    /// Several values out of range, two at least, in the order of the fields. Displays a line for each.
    #[error("{}", lines(.0))]
    Several(Vec<Self>),
}

impl SceneError {
    /// The sentence about a scene that a program has put together: it has no lines that somebody wrote.
    pub fn without_line(&self) -> String {
        match self {
            Self::Structure { file, field, reason, .. } => format!("{file}: {field}: {reason}"),
            other => other.to_string(),
        }
    }
}

fn lines(errors: &[SceneError]) -> String {
    errors.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
}
