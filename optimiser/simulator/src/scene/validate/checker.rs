//! Ranges and the sentences about them.

use std::fmt::Display;

use crate::scene::error::{MAX_NAME_CHARS, is_name, listed_path};
use crate::scene::figures::{about, list, plain};
use crate::scene::{Container, Gate, SceneError};

/// Result of a check.
pub(super) type Checked = Result<(), SceneError>;

/// Interval of a number, in the unit of its key.
#[derive(Clone, Copy)]
pub(in crate::scene) struct Range {
    low: f64,
    high: f64,
    low_excluded: bool,
}

impl Range {
    /// From `low` to `high`, both allowed.
    pub(in crate::scene) const fn closed(low: f64, high: f64) -> Self {
        Self { low, high, low_excluded: false }
    }

    /// Above `low`, up to `high`.
    pub(in crate::scene) const fn above(low: f64, high: f64) -> Self {
        Self { low_excluded: true, ..Self::closed(low, high) }
    }

    /// False for NaN.
    pub(super) fn contains(&self, value: f64) -> bool {
        let above = if self.low_excluded { value > self.low } else { value >= self.low };
        above && value <= self.high
    }

    /// The question after a length that would be right if it was meant in millimetres.
    fn in_metres(&self, field: &str, value: f64) -> Option<String> {
        let name =
            field.strip_suffix(']').and_then(|field| field.rsplit_once('[')).map_or(field, |(name, _)| name);
        let is_length = name.ends_with("_m");
        let metres = 1e-3 * value;
        (is_length && value.abs() > self.high && self.contains(metres))
            .then(|| format!("; did you mean metres, that is {}?", about(metres, 6)))
    }

    fn sentence(&self) -> String {
        let (low, high) = (plain(self.low), plain(self.high));
        match self.low_excluded {
            false => format!("must be from {low} to {high}"),
            true => format!("must be above {low} and at most {high}"),
        }
    }
}

/// An angle of a thing that may be turned any way.
pub(in crate::scene) const TURN_DEG: Range = Range::closed(-360.0, 360.0);

/// What messages call the containers, in their order.
pub(super) fn container_paths(containers: &[Container]) -> Vec<String> {
    listed_paths("container", containers.iter().map(|container| container.name.as_str()).collect())
}

/// What messages call the gates, in their order.
pub(super) fn gate_paths(gates: &[Gate]) -> Vec<String> {
    listed_paths("gate", gates.iter().map(|gate| gate.name.as_str()).collect())
}

fn listed_paths(list: &str, names: Vec<&str>) -> Vec<String> {
    (0..names.len()).map(|index| listed_path(list, &names, index)).collect()
}

/// Writes refusals in the name of one file.
pub(in crate::scene) struct Checker<'a> {
    pub(super) file: &'a str,
}

impl Checker<'_> {
    /// "{file}: {field} is {value}, but {expected}".
    pub(super) fn invalid(
        &self,
        field: impl Into<String>,
        value: impl Display,
        expected: impl Into<String>,
    ) -> SceneError {
        SceneError::Invalid {
            file: self.file.to_owned(),
            field: field.into(),
            value: value.to_string(),
            expected: expected.into(),
        }
    }

    /// A number within its range.
    pub(super) fn number(&self, field: &str, value: f64, range: Range) -> Checked {
        if range.contains(value) {
            return Ok(());
        }
        let metres = range.in_metres(field, value).unwrap_or_default();
        Err(self.invalid(field, plain(value), format!("it {}{metres}", range.sentence())))
    }

    /// A whole number within its range.
    pub(super) fn count(&self, field: &str, value: u32, low: u32, high: u32) -> Checked {
        self.number(field, f64::from(value), Range::closed(f64::from(low), f64::from(high)))
    }

    /// `[low, high]`, low not above high.
    pub(super) fn ordered(&self, field: &str, bounds: [f64; 2]) -> Checked {
        if bounds[0] <= bounds[1] {
            return Ok(());
        }
        Err(self.invalid(field, list(&bounds), "the first number must not exceed the second"))
    }

    /// 1 to 64 printable characters.
    pub(super) fn name(&self, field: &str, name: &str) -> Checked {
        if is_name(name) {
            return Ok(());
        }
        let shown: String = name.chars().take(MAX_NAME_CHARS).collect();
        Err(self.invalid(field, format!("{shown:?}"), "it must have 1 to 64 printable characters"))
    }
}
