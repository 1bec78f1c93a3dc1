//! What serde knows as Python's dictionaries, lists and numbers, by way of JSON, and such as what TOML knows.

use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyString, PyTuple};
use serde::Serialize;

use crate::errors::SceneError;

/// As Python's own `json` reads it.
pub(crate) fn to_python<'py>(py: Python<'py>, value: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).expect("what is shown has a notation in JSON");
    py.import("json")?.call_method1("loads", (text,))
}

/// What Python calls numbers, words, lists and dictionaries, NumPy's among them; a None in a dictionary counts as a key that is not
/// there. `place` names it in messages.
pub(crate) fn from_python(place: &str, value: &Bound<'_, PyAny>) -> PyResult<toml::Value> {
    if let Ok(table) = value.cast::<PyDict>() {
        let mut fields = toml::Table::new();
        for (key, value) in table {
            let key = key.to_string();
            if !value.is_none() {
                fields.insert(key.clone(), from_python(&within(place, &key), &value)?);
            }
        }
        return Ok(fields.into());
    }
    if let Ok(flag) = value.cast::<PyBool>() {
        return Ok(flag.is_true().into());
    }
    if value.is_instance_of::<PyInt>() {
        // What is larger is larger than anything here; the scene says what would be right.
        return value.extract::<i64>().map(Into::into).or_else(|_| value.extract::<f64>().map(Into::into));
    }
    if value.is_instance_of::<PyFloat>() {
        return Ok(value.extract::<f64>()?.into());
    }
    if let Ok(text) = value.cast::<PyString>() {
        return Ok(text.to_string().into());
    }
    if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
        let items = value.try_iter()?.enumerate();
        let items: PyResult<Vec<toml::Value>> =
            items.map(|(index, item)| from_python(&format!("{place}[{index}]"), &item?)).collect();
        return Ok(items?.into());
    }
    // NumPy's numbers and arrays.
    if let Ok(plain) = value.call_method0("tolist") {
        return from_python(place, &plain);
    }
    let kind = value.get_type().name()?;
    Err(SceneError::new_err(format!(
        "{place} is a {kind}, but it must be a number, a word, a list or a dictionary"
    )))
}

fn within(place: &str, key: &str) -> String {
    if place.is_empty() { key.to_owned() } else { format!("{place}.{key}") }
}
