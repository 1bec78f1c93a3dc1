//! What is wrong with single fields, gathered.

use super::checker::{Checked, Checker, Range};
use crate::scene::SceneError;
use crate::scene::figures::plain;

/// What is wrong with the fields, gathered.
pub(in crate::scene) struct Found<'a> {
    pub(super) checker: &'a Checker<'a>,
    pub(super) errors: Vec<SceneError>,
}

impl Found<'_> {
    /// Whether it is right.
    fn keep(&mut self, checked: Checked) -> bool {
        let is_right = checked.is_ok();
        self.errors.extend(checked.err());
        is_right
    }

    pub(in crate::scene) fn refuse(&mut self, field: &str, value: String, right: String) {
        self.errors.push(self.checker.invalid(field, value, right));
    }

    pub(in crate::scene) fn name(&mut self, field: &str, name: &str) -> bool {
        self.keep(self.checker.name(field, name))
    }

    pub(in crate::scene) fn number(&mut self, field: &str, value: f64, range: Range) -> bool {
        self.keep(self.checker.number(field, value, range))
    }

    pub(in crate::scene) fn count(&mut self, field: &str, value: u32, low: u32, high: u32) -> bool {
        self.keep(self.checker.count(field, value, low, high))
    }

    /// Every component within the same range; the first that is not is named.
    pub(in crate::scene) fn vector(&mut self, field: &str, values: &[f64], range: Range) -> bool {
        let number =
            |(index, value): (usize, &f64)| self.checker.number(&format!("{field}[{index}]"), *value, range);
        let all = values.iter().enumerate().try_for_each(number);
        self.keep(all)
    }

    /// `[low, high]`, both within the range, low not above high.
    pub(in crate::scene) fn bounds(&mut self, field: &str, bounds: [f64; 2], range: Range) -> bool {
        self.vector(field, &bounds, range) && self.keep(self.checker.ordered(field, bounds))
    }

    /// The thickness of a wall.
    pub(in crate::scene) fn wall(&mut self, field: &str, thickness_m: f64, cell_m: f64) {
        if self.number(field, thickness_m, Range::above(0.0, 1.0)) {
            self.thick(field, thickness_m, cell_m);
        }
    }

    /// What is much thinner than a cell would let powder through.
    pub(in crate::scene) fn thick(&mut self, field: &str, thickness_m: f64, cell_m: f64) {
        let least_m = 0.5 * cell_m;
        if thickness_m < least_m * (1.0 - 1e-9) {
            let right = format!(
                "it must be at least half a cell, {} for domain.cell_m = {}",
                plain(least_m),
                plain(cell_m)
            );
            self.refuse(field, plain(thickness_m), right);
        }
    }
}
