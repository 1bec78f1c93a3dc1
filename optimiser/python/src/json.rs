//! What serde knows as Python's dictionaries, lists and numbers, by way of JSON: no other notation has both.

use pyo3::prelude::*;
use serde::{Serialize, de::DeserializeOwned};

/// As Python's own `json` reads it.
pub(crate) fn to_python<'py>(py: Python<'py>, value: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).expect("what is shown has a notation in JSON");
    py.import("json")?.call_method1("loads", (text,))
}

/// As Python's own `json` writes it.
pub(crate) fn from_python<T: DeserializeOwned>(value: &Bound<'_, PyAny>) -> PyResult<T> {
    let text: String = value.py().import("json")?.call_method1("dumps", (value,))?.extract()?;
    serde_json::from_str(&text).map_err(|error| pyo3::exceptions::PyValueError::new_err(error.to_string()))
}

/// The same without what is None, which TOML has no notation for.
pub(crate) fn without_none(value: &Bound<'_, PyAny>) -> PyResult<toml::Value> {
    fn strip(value: serde_json::Value) -> Option<serde_json::Value> {
        use serde_json::Value::{Array, Null, Object};
        Some(match value {
            Null => return None,
            Array(items) => Array(items.into_iter().filter_map(strip).collect()),
            Object(fields) => {
                Object(fields.into_iter().filter_map(|(key, value)| Some((key, strip(value)?))).collect())
            }
            other => other,
        })
    }
    let stripped = strip(from_python(value)?).unwrap_or_default();
    serde_json::from_value(stripped)
        .map_err(|error| pyo3::exceptions::PyValueError::new_err(error.to_string()))
}
