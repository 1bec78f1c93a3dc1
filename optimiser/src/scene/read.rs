//! Reading a scene: by name, from a file, from text.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::{Scene, SceneError, embedded};

/// A scene file longer than this is refused without being read, bytes.
pub const MAX_SCENE_BYTES: u64 = 1 << 20;

impl Scene {
    /// Loads an embedded scene by name (`bench`, `bench-small`, `bench-fine`) or a scene file by path.
    ///
    /// A name wins over a file of the same name in the working folder; write `./bench` for the file.
    ///
    /// # Errors
    /// A [`SceneError`] that names the file and what would be right.
    pub fn load(path_or_name: &str) -> Result<Self, SceneError> {
        match embedded::embedded_scene(path_or_name) {
            Some(text) => Self::from_toml(path_or_name, text),
            None => Self::from_toml(path_or_name, &read_text(path_or_name)?),
        }
    }

    /// Reads and validates a scene from TOML. `source_name` stands for the file in messages.
    ///
    /// # Errors
    /// A [`SceneError`] that names the field, its value and what would be right.
    pub fn from_toml(source_name: &str, text: &str) -> Result<Self, SceneError> {
        if text.lines().all(|line| line.trim_start().is_empty() || line.trim_start().starts_with('#')) {
            return Err(SceneError::Empty { file: source_name.to_owned() });
        }
        let scene: Scene = parse(source_name, text)?;
        scene.validate(source_name)?;
        Ok(scene)
    }
}

fn read_text(path: &str) -> Result<String, SceneError> {
    let file = || path.to_owned();
    let unreadable =
        |error: std::io::Error| SceneError::Unreadable { file: file(), reason: error.to_string() };
    // A bare word that is no file was meant as the name of a scene.
    if !Path::new(path).exists() && !path.contains(['/', '\\', '.']) {
        return Err(SceneError::UnknownName { name: file(), known: embedded::known_names() });
    }
    let metadata = std::fs::metadata(path).map_err(unreadable)?;
    if metadata.is_dir() {
        return Err(SceneError::NotAFile { file: file(), what: "a folder" });
    }
    if !metadata.is_file() {
        return Err(SceneError::NotAFile { file: file(), what: "a pipe or a device" });
    }
    let too_large = |bytes| SceneError::TooLarge { file: file(), bytes, limit: MAX_SCENE_BYTES };
    if metadata.len() > MAX_SCENE_BYTES {
        return Err(too_large(metadata.len()));
    }
    let mut bytes = Vec::new();
    // The file may have grown since it was measured.
    File::open(path)
        .and_then(|opened| opened.take(MAX_SCENE_BYTES + 1).read_to_end(&mut bytes))
        .map_err(unreadable)?;
    if bytes.len() as u64 > MAX_SCENE_BYTES {
        return Err(too_large(bytes.len() as u64));
    }
    String::from_utf8(bytes)
        .map_err(|error| SceneError::NotText { file: file(), offset: error.utf8_error().valid_up_to() })
}

fn parse(source_name: &str, text: &str) -> Result<Scene, SceneError> {
    let file = || source_name.to_owned();
    let syntax = |error: toml::de::Error| {
        let (line, column) = position(text, &error);
        SceneError::Syntax { file: file(), line, column, reason: one_line(error.message()) }
    };
    let raw: toml::Table = text.parse().map_err(syntax)?;
    check_tables(source_name, &raw)?;
    let deserializer = toml::Deserializer::parse(text).map_err(syntax)?;
    let scene: Scene = serde_path_to_error::deserialize(deserializer).map_err(|error| {
        let path = error.path().to_string();
        SceneError::Structure {
            file: file(),
            field: if path == "." { "the scene".to_owned() } else { one_line(&path) },
            line: position(text, error.inner()).0,
            reason: in_plain_words(error.inner().message()),
        }
    })?;
    let resolved = toml::Table::try_from(&scene).expect("every field has a notation in TOML");
    check_lists(source_name, "", &toml::Value::Table(raw), &toml::Value::Table(resolved))?;
    Ok(scene)
}

/// Serde reads a table from a list, field by field; in a scene that is always a mistake, `[[tool]]` for `[tool]`.
fn check_tables(source_name: &str, raw: &toml::Table) -> Result<(), SceneError> {
    const TABLES: [&str; 8] =
        ["domain", "powder", "time", "tool", "skill", "limits", "objective", "optimiser"];
    let listed = TABLES.into_iter().find(|key| raw.get(*key).is_some_and(toml::Value::is_array));
    listed.map_or(Ok(()), |key| Err(not_a_table(source_name, key)))
}

/// Serde drops what a list holds beyond the expected length, and reads tables from lists; neither may pass.
fn check_lists(
    source_name: &str,
    path: &str,
    raw: &toml::Value,
    resolved: &toml::Value,
) -> Result<(), SceneError> {
    use toml::Value::{Array, Table};
    match (raw, resolved) {
        (Array(_), Table(_)) => Err(not_a_table(source_name, path)),
        (Array(raw), Array(resolved)) if raw.len() != resolved.len() => Err(SceneError::Invalid {
            file: source_name.to_owned(),
            field: path.to_owned(),
            value: format!("a list of {}", raw.len()),
            expected: format!("it must be a list of {}", resolved.len()),
        }),
        (Array(raw), Array(resolved)) => {
            raw.iter().zip(resolved).enumerate().try_for_each(|(index, (raw, resolved))| {
                check_lists(source_name, &format!("{path}[{index}]"), raw, resolved)
            })
        }
        (Table(raw), Table(resolved)) => raw.iter().try_for_each(|(key, raw)| {
            let dot = if path.is_empty() { "" } else { "." };
            resolved.get(key).map_or(Ok(()), |resolved| {
                check_lists(source_name, &format!("{path}{dot}{key}"), raw, resolved)
            })
        }),
        _ => Ok(()),
    }
}

fn not_a_table(source_name: &str, field: &str) -> SceneError {
    SceneError::Invalid {
        file: source_name.to_owned(),
        field: field.to_owned(),
        value: "a list".to_owned(),
        expected: "it must be a single table".to_owned(),
    }
}

/// Line and column of an error, from 1.
fn position(text: &str, error: &toml::de::Error) -> (usize, usize) {
    let offset = error.span().map_or(0, |span| span.start).min(text.len());
    let before = &text.as_bytes()[..offset];
    let line_start = before.iter().rposition(|&byte| byte == b'\n').map_or(0, |newline| newline + 1);
    (before.iter().filter(|&&byte| byte == b'\n').count() + 1, offset - line_start + 1)
}

/// Foreign text on one line, without control characters, and not endless.
fn one_line(message: &str) -> String {
    const MAX_CHARS: usize = 400;
    let line = message.split_whitespace().collect::<Vec<_>>().join(" ");
    let shown: String = line.chars().filter(|character| !character.is_control()).take(MAX_CHARS).collect();
    if line.chars().count() > MAX_CHARS { shown + "..." } else { shown }
}

/// Serde speaks of Rust types; the reader of a scene file knows numbers, lists and tables.
fn in_plain_words(message: &str) -> String {
    let words = [
        ("expected f64", "expected a number"),
        ("expected u32", "expected a whole number from 0 to 4294967295"),
        ("expected u64", "expected a whole number from 0 to 18446744073709551615"),
        ("expected an array of length", "expected a list of"),
        ("expected a sequence", "expected a list"),
        ("expected internally tagged enum ContainerShape", "expected a table with a `kind`"),
        ("expected internally tagged enum ToolShape", "expected a table with a `kind`"),
        ("expected internally tagged enum Observation", "expected a table with a `kind`"),
        ("wanted string or table", "expected a name or a table"),
        ("wanted exactly 1 element, more than 1 element", "expected a table with exactly one key"),
    ];
    let plain = words.iter().fold(one_line(message), |text, (rust, plain)| text.replace(rust, plain));
    // What remains of `expected struct Domain` and the like.
    match plain.find("expected struct ") {
        Some(start) => plain[..start].to_owned() + "expected a table",
        None => plain,
    }
}
