//! Ranges and the sentences about them.

use std::fmt::Display;

use crate::scene::SceneError;
use crate::scene::figures::{list, plain};

/// Result of a check.
pub(super) type Checked = Result<(), SceneError>;

/// Interval of a number, in the unit of its key.
#[derive(Clone, Copy)]
pub(super) struct Range {
    low: f64,
    high: f64,
    low_excluded: bool,
    high_excluded: bool,
}

impl Range {
    /// From `low` to `high`, both allowed.
    pub(super) const fn closed(low: f64, high: f64) -> Self {
        Self { low, high, low_excluded: false, high_excluded: false }
    }

    /// Above `low`, up to `high`.
    pub(super) const fn above(low: f64, high: f64) -> Self {
        Self { low_excluded: true, ..Self::closed(low, high) }
    }

    /// From `low` to below `high`.
    pub(super) const fn below(low: f64, high: f64) -> Self {
        Self { high_excluded: true, ..Self::closed(low, high) }
    }

    /// False for NaN.
    fn contains(&self, value: f64) -> bool {
        let above = if self.low_excluded { value > self.low } else { value >= self.low };
        let below = if self.high_excluded { value < self.high } else { value <= self.high };
        above && below
    }

    fn sentence(&self) -> String {
        let (low, high) = (plain(self.low), plain(self.high));
        match (self.low_excluded, self.high_excluded) {
            (false, false) => format!("must be from {low} to {high}"),
            (true, _) => format!("must be above {low} and at most {high}"),
            (false, true) => format!("must be at least {low} and below {high}"),
        }
    }
}

/// Writes refusals in the name of one file.
pub(super) struct Checker<'a> {
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
        Err(self.invalid(field, plain(value), format!("it {}", range.sentence())))
    }

    /// A whole number within its range.
    pub(super) fn count(&self, field: &str, value: u32, low: u32, high: u32) -> Checked {
        self.number(field, f64::from(value), Range::closed(f64::from(low), f64::from(high)))
    }

    /// Every component within the same range.
    pub(super) fn vector(&self, field: &str, values: &[f64], range: Range) -> Checked {
        values
            .iter()
            .enumerate()
            .try_for_each(|(index, value)| self.number(&format!("{field}[{index}]"), *value, range))
    }

    /// `[low, high]`, both within the range, low not above high.
    pub(super) fn bounds(&self, field: &str, bounds: [f64; 2], range: Range) -> Checked {
        self.vector(field, &bounds, range)?;
        if bounds[0] <= bounds[1] {
            return Ok(());
        }
        Err(self.invalid(field, list(&bounds), "the first number must not exceed the second"))
    }

    /// 1 to 64 printable characters.
    pub(super) fn name(&self, field: &str, name: &str) -> Checked {
        let length = name.chars().count();
        if (1..=64).contains(&length) && !name.chars().any(char::is_control) {
            return Ok(());
        }
        let shown: String = name.chars().take(64).collect();
        Err(self.invalid(field, format!("{shown:?}"), "it must have 1 to 64 printable characters"))
    }
}
