//! Numbers that a skill is computed with: plain `f64`, or dual numbers that carry five partial derivatives.
//!
//! Forward mode is the natural choice here: five inputs, thousands of outputs.

use std::ops::{Add, Div, Mul, Sub};

/// Field operations and the two roots that the mapping from skill to motion needs.
pub(super) trait SkillScalar:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// A constant: all derivatives are zero.
    fn constant(value: f64) -> Self;
    /// The number without its derivatives.
    fn value(self) -> f64;
    /// Square root; derivatives exist for positive values only.
    fn sqrt(self) -> Self;
    /// Cube root; derivatives exist for values other than zero.
    fn cbrt(self) -> Self;
}

impl SkillScalar for f64 {
    fn constant(value: f64) -> Self {
        value
    }

    fn value(self) -> f64 {
        self
    }

    fn sqrt(self) -> Self {
        libm::sqrt(self)
    }

    fn cbrt(self) -> Self {
        libm::cbrt(self)
    }
}

/// A value and its partial derivatives with respect to the five components of theta.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Dual5 {
    /// The value.
    pub(super) value: f64,
    /// Partial derivatives.
    pub(super) partials: [f64; 5],
}

impl Dual5 {
    /// The independent variable `index`, whose partial derivative with respect to itself is one.
    ///
    /// # Panics
    /// When `index` is not below 5.
    pub(super) fn variable(value: f64, index: usize) -> Self {
        let mut partials = [0.0; 5];
        partials[index] = 1.0;
        Self { value, partials }
    }

    /// `f(self)`, given `f` and its derivative at `self.value`.
    fn chain(self, value: f64, derivative: f64) -> Self {
        Self { value, partials: self.partials.map(|partial| derivative * partial) }
    }

    /// The bilinear combination `a * self' + b * rhs'` around a given value.
    fn combine(self, rhs: Self, value: f64, a: f64, b: f64) -> Self {
        let partials = std::array::from_fn(|k| a * self.partials[k] + b * rhs.partials[k]);
        Self { value, partials }
    }
}

impl Add for Dual5 {
    type Output = Self;

    fn add(self, rhs: Self) -> Self {
        self.combine(rhs, self.value + rhs.value, 1.0, 1.0)
    }
}

impl Sub for Dual5 {
    type Output = Self;

    fn sub(self, rhs: Self) -> Self {
        self.combine(rhs, self.value - rhs.value, 1.0, -1.0)
    }
}

impl Mul for Dual5 {
    type Output = Self;

    fn mul(self, rhs: Self) -> Self {
        self.combine(rhs, self.value * rhs.value, rhs.value, self.value)
    }
}

impl Div for Dual5 {
    type Output = Self;

    fn div(self, rhs: Self) -> Self {
        let quotient = self.value / rhs.value;
        self.combine(rhs, quotient, 1.0 / rhs.value, -quotient / rhs.value)
    }
}

impl SkillScalar for Dual5 {
    fn constant(value: f64) -> Self {
        Self { value, partials: [0.0; 5] }
    }

    fn value(self) -> f64 {
        self.value
    }

    fn sqrt(self) -> Self {
        let root = libm::sqrt(self.value);
        self.chain(root, 0.5 / root)
    }

    fn cbrt(self) -> Self {
        let root = libm::cbrt(self.value);
        self.chain(root, 1.0 / (3.0 * root * root))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Exercises every operation of [`SkillScalar`].
    fn mixed<S: SkillScalar>(x: S, y: S) -> S {
        (x * y + S::constant(2.0)).sqrt() / (x - y * S::constant(0.25)).cbrt()
    }

    proptest! {
        #[test]
        fn partials_agree_with_central_differences(x in 1.0..3.0f64, y in 0.5..2.0f64) {
            let dual = mixed(Dual5::variable(x, 1), Dual5::variable(y, 4));
            let h = 1e-6;
            let dx = (mixed(x + h, y) - mixed(x - h, y)) / (2.0 * h);
            let dy = (mixed(x, y + h) - mixed(x, y - h)) / (2.0 * h);
            prop_assert_eq!(dual.value.to_bits(), mixed(x, y).to_bits());
            prop_assert!((dual.partials[1] - dx).abs() < 1e-8);
            prop_assert!((dual.partials[4] - dy).abs() < 1e-8);
            prop_assert_eq!(dual.partials[0].to_bits(), 0.0f64.to_bits());
        }
    }
}
