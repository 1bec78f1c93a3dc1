//! Arguments as Python gives them. What is wrong with one is said by its name, with what was given and what would be right.

use std::ops::RangeInclusive;

use powderline_simulator::scene::closest_match;
use pyo3::{
    exceptions::{PyTypeError, PyValueError},
    prelude::*,
    types::{PyInt, PyTuple},
};

/// Most characters of what was given in a message.
const MAX_SHOWN: usize = 60;

/// What was given, as Python writes it, and not endless.
pub(crate) fn shown(given: &Bound<'_, PyAny>) -> String {
    let text = given.repr().map_or_else(|_| "something".to_owned(), |text| text.to_string());
    let short: String = text.chars().filter(|c| !c.is_control()).take(MAX_SHOWN).collect();
    if text.chars().count() > MAX_SHOWN { short + ".." } else { short }
}

/// A whole number of this range, said in words by `right`.
pub(crate) fn whole<T: TryFrom<i128>>(
    what: &str,
    given: &Bound<'_, PyAny>,
    range: RangeInclusive<i128>,
    right: &str,
) -> PyResult<T> {
    let number = given.extract::<i128>();
    let fits = number.as_ref().ok().filter(|number| range.contains(number));
    fits.and_then(|number| T::try_from(*number).ok()).ok_or_else(|| {
        let text = format!("{what} is {}, but it must be {right}", shown(given));
        match number.is_ok() || given.is_instance_of::<PyInt>() {
            true => PyValueError::new_err(text),
            false => PyTypeError::new_err(text),
        }
    })
}

/// A number of this range, said in words by `right`.
pub(crate) fn real(
    what: &str,
    given: &Bound<'_, PyAny>,
    range: RangeInclusive<f64>,
    right: &str,
) -> PyResult<f64> {
    let number = given.extract::<f64>();
    let text = || format!("{what} is {}, but it must be {right}", shown(given));
    match number {
        Ok(number) if range.contains(&number) => Ok(number),
        Ok(_) => Err(PyValueError::new_err(text())),
        Err(_) => Err(PyTypeError::new_err(text())),
    }
}

/// One of several words.
pub(crate) fn word<T: Copy>(what: &str, given: &Bound<'_, PyAny>, known: &[(&str, T)]) -> PyResult<T> {
    let text = given.extract::<String>().ok();
    let found = known.iter().find(|(name, _)| Some(*name) == text.as_deref());
    found.map(|(_, value)| *value).ok_or_else(|| {
        let names: Vec<String> = known.iter().map(|(name, _)| format!("\"{name}\"")).collect();
        let (last, before) =
            names.split_last().map_or((String::new(), &[][..]), |(last, b)| (last.clone(), b));
        let meant = text.as_deref().and_then(|text| closest_match(text, known.iter().map(|(name, _)| *name)));
        let meant = meant.map_or(String::new(), |meant| format!("; did you mean \"{meant}\"?"));
        let text =
            format!("{what} is {}, but it must be {} or {last}{meant}", shown(given), before.join(", "));
        PyValueError::new_err(text)
    })
}

/// Refuses what was given by its place where names are wanted; `call` shows how.
pub(crate) fn by_name(others: &Bound<'_, PyTuple>, call: &str) -> PyResult<()> {
    let Ok(first) = others.get_item(0) else { return Ok(()) };
    Err(PyTypeError::new_err(format!(
        "{} is given by its place, but it must be by its name, as in {call}",
        shown(&first)
    )))
}
