//! From TOML text to a scene's fields, and refusals in words that a reader of the file knows.

use serde_json::Value;
use toml::de::{DeTable, DeValue, Deserializer, Error};

use super::closest_match::did_you_mean;
use super::error::listed_path;
use super::{DEFAULT_SCENE, SceneError, SceneSpec, embedded_scene};

/// Tables of a scene, besides its [`LISTS`] of tables.
const TABLES: [&str; 8] = ["domain", "powder", "time", "tool", "skill", "limits", "arm", "objective"];

/// A table that scenes had once.
const FORMER_TABLE: &str = "optimiser";

/// Lists of tables, each with a name.
const LISTS: [&str; 2] = ["container", "gate"];

/// Reads a scene without judging its values.
pub(super) fn parse(file: &str, text: &str) -> Result<SceneSpec, SceneError> {
    let source = Source { file, text };
    let raw = DeTable::parse(text).map_err(|error| source.syntax(&error))?;
    let raw = raw.into_inner();
    source.scene(&raw).map_err(|error| with_names(error, &raw))
}

/// The refusal with a container's or gate's name in the place of its number.
fn with_names(error: SceneError, raw: &DeTable<'_>) -> SceneError {
    let SceneError::Structure { file, field, line, reason } = error else { return error };
    let named = |list: &str| {
        let (index, path) = field.strip_prefix(list)?.strip_prefix('[')?.split_once(']')?;
        let name = |table: &DeValue<'_>| Some(table.as_table()?.get("name")?.get_ref().as_str()?.to_owned());
        let tables = raw.get(list)?.get_ref().as_array()?;
        let names: Vec<String> =
            tables.iter().map(|table| name(table.get_ref()).unwrap_or_default()).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        Some(listed_path(list, &names, index.parse().ok()?) + path)
    };
    let field = LISTS.into_iter().find_map(named).unwrap_or(field);
    SceneError::Structure { file, field, line, reason }
}

/// The text being read, and its name in messages.
struct Source<'a> {
    file: &'a str,
    text: &'a str,
}

impl Source<'_> {
    fn scene(&self, raw: &DeTable<'_>) -> Result<SceneSpec, SceneError> {
        self.check_tables(raw)?;
        let deserializer = Deserializer::parse(self.text).map_err(|error| self.syntax(&error))?;
        let scene: SceneSpec = serde_path_to_error::deserialize(deserializer).map_err(|error| {
            let path = error.path().to_string();
            let field = if path == "." { "the scene" } else { &path };
            self.structure(field, start(error.inner()), in_plain_words(&path, error.inner().message()))
        })?;
        let resolved = serde_json::to_value(&scene).expect("every field has a notation in JSON");
        self.check_lists("", 0, &DeValue::Table(raw.clone()), &resolved)?;
        Ok(scene)
    }

    fn syntax(&self, error: &Error) -> SceneError {
        let (line, column) = self.position(start(error));
        SceneError::Syntax {
            file: self.file.to_owned(),
            line,
            column,
            reason: in_plain_words("", error.message()),
        }
    }

    fn structure(&self, field: &str, offset: usize, reason: String) -> SceneError {
        SceneError::Structure {
            file: self.file.to_owned(),
            field: one_line(field),
            line: self.position(offset).0,
            reason,
        }
    }

    /// Serde reads a table from a list, field by field; in a scene that is a mistake, `[[tool]]` for `[tool]`.
    fn check_tables(&self, raw: &DeTable<'_>) -> Result<(), SceneError> {
        if let Some(table) = raw.get(FORMER_TABLE) {
            let reason = "a scene no longer says how it is searched; without this table it would be right, and `optimise run --help` says \
                          what can be chosen instead";
            return Err(self.structure(FORMER_TABLE, table.span().start, reason.to_owned()));
        }
        for key in TABLES {
            if let Some(value) = raw.get(key).filter(|value| value.get_ref().is_array()) {
                return Err(self.not_a_table(key, value.span().start));
            }
        }
        Ok(())
    }

    /// Serde drops what a list holds beyond the expected length, and reads tables from lists; neither may pass.
    fn check_lists(
        &self,
        path: &str,
        offset: usize,
        raw: &DeValue<'_>,
        resolved: &Value,
    ) -> Result<(), SceneError> {
        match (raw, resolved) {
            (DeValue::Array(_), Value::Object(_)) => Err(self.not_a_table(path, offset)),
            (DeValue::Array(raw), Value::Array(resolved)) if raw.len() != resolved.len() => {
                let reason = format!("invalid length {}, expected a list of {}", raw.len(), resolved.len());
                Err(self.structure(path, offset, reason))
            }
            (DeValue::Array(raw), Value::Array(resolved)) => {
                raw.iter().zip(resolved).enumerate().try_for_each(|(index, (raw, resolved))| {
                    self.check_lists(&format!("{path}[{index}]"), raw.span().start, raw.get_ref(), resolved)
                })
            }
            (DeValue::Table(raw), Value::Object(resolved)) => raw.iter().try_for_each(|(key, raw)| {
                let key: &str = key.get_ref();
                let path = if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
                resolved.get(key).map_or(Ok(()), |resolved| {
                    self.check_lists(&path, raw.span().start, raw.get_ref(), resolved)
                })
            }),
            _ => Ok(()),
        }
    }

    fn not_a_table(&self, field: &str, offset: usize) -> SceneError {
        self.structure(field, offset, "invalid type: a list, expected a single table".to_owned())
    }

    /// Line and column, from 1.
    fn position(&self, offset: usize) -> (usize, usize) {
        let before = &self.text.as_bytes()[..offset.min(self.text.len())];
        let line_start = before.iter().rposition(|&byte| byte == b'\n').map_or(0, |newline| newline + 1);
        (before.iter().filter(|&&byte| byte == b'\n').count() + 1, before.len() - line_start + 1)
    }
}

fn start(error: &Error) -> usize {
    error.span().map_or(0, |span| span.start)
}

/// Foreign text on one line, without control characters, and not endless.
fn one_line(message: &str) -> String {
    const MAX_CHARS: usize = 400;
    let line = message.split_whitespace().collect::<Vec<_>>().join(" ");
    let shown: String = line.chars().filter(|character| !character.is_control()).take(MAX_CHARS).collect();
    if line.chars().count() > MAX_CHARS { shown + "..." } else { shown }
}

/// The line of a key in the scene that is the reference, with the key's unit, meaning and range; `table` may have an index.
fn example(table: &str, key: &str) -> Option<String> {
    let table = table.split('[').next()?;
    let headers = [format!("[{table}]"), format!("[[{table}]]")];
    let is_header = |line: &str| headers.iter().any(|header| line.starts_with(header));
    // What may be left out stands there as a comment.
    let stated = |line: &'static str| line.strip_prefix("# ").unwrap_or(line);
    let is_it = |line: &&str| line.strip_prefix(key).is_some_and(|rest| rest.trim_start().starts_with('='));
    let lines = embedded_scene(DEFAULT_SCENE)?.lines().skip_while(|line| !is_header(line)).skip(1);
    lines.take_while(|line| !line.starts_with('[')).map(stated).find(is_it).map(one_line)
}

/// What serde says of the value at `path`. It speaks of Rust types; the reader of a scene file knows numbers, lists and
/// tables.
fn in_plain_words(path: &str, message: &str) -> String {
    let words = [
        ("expected f64", "expected a number"),
        ("expected u32", "expected a whole number from 0 to 4294967295"),
        ("expected u64", "expected a whole number from 0 to 18446744073709551615"),
        ("expected an array of length", "expected a list of"),
        ("expected a sequence", "expected a list"),
        ("expected internally tagged enum ContainerShape", A_KIND),
        ("expected internally tagged enum ToolShape", A_KIND),
        ("expected internally tagged enum GateShape", A_KIND),
        ("expected internally tagged enum GateOpening", A_KIND),
        ("expected internally tagged enum Observation", A_KIND),
        ("` as i128,", "`,"),
        ("floating-point number overflowed", "number too large, expected at most 1.79e308"),
        ("wanted string or table", A_CHOICE),
    ];
    let plain = words.iter().fold(one_line(message), |text, (rust, plain)| text.replace(rust, plain));
    if let Some(asked) = asked(message, &plain) {
        return asked;
    }
    let missing = plain.strip_prefix("missing field `").and_then(|rest| rest.strip_suffix('`'));
    let wants_table = || [A_KIND, A_CHOICE].iter().any(|words| plain.contains(words));
    // Of a table within a table, such as a shape, the whole line.
    let own_line = || path.rsplit_once('.').and_then(|(table, key)| example(table, key));
    let example = match missing {
        Some(key) => example(path, key).or_else(own_line),
        None => own_line().filter(|_| wants_table()),
    };
    if let Some(example) = example {
        return format!("{plain}; in the scene `{DEFAULT_SCENE}` it is: {example}");
    }
    // What remains of `expected struct Domain` and the like.
    match plain.find("expected struct ") {
        Some(start) => plain[..start].to_owned() + "expected a table",
        None => plain,
    }
}

const A_KIND: &str = "expected a table with a `kind`";
const A_CHOICE: &str = "expected a name or a table";

/// Of an unknown key or choice: whether one of those that are possible there was meant, or the one table that the key belongs into.
/// That comes first; the list of what is possible may be long.
fn asked(message: &str, plain: &str) -> Option<String> {
    // "unknown field `word`, expected one of `this`, `that`": each word between two marks.
    let rest = message.strip_prefix("unknown field ").or_else(|| message.strip_prefix("unknown variant "))?;
    let mut words = rest.split('`').skip(1).step_by(2);
    let word = words.next()?;
    let (unknown, expected) = plain.split_once(", expected ")?;
    let tables: Vec<&str> = TABLES.into_iter().filter(|table| example(table, word).is_some()).collect();
    if let ([table], true) = (&tables[..], message.starts_with("unknown field ")) {
        return Some(format!("{unknown}; that key belongs into [{table}]"));
    }
    let question = did_you_mean(word, words.clone());
    // One that is possible has been named, if there is no other.
    let possible = match expected.strip_prefix("one of ").unwrap_or(expected) {
        _ if question.is_empty() => return Some(plain.to_owned()),
        _ if words.count() == 1 => String::new(),
        words => format!(" Possible are {}", words.replace(" or ", ", ")),
    };
    Some(unknown.to_owned() + &question + &possible)
}
