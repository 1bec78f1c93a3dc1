//! A number that counts what is done with it.
//!
//! The simulator is written for any [`Real`]; run with [`Counted`] numbers it does what it always does, on the same bits,
//! and the counter shows how many operations that was. Additions, subtractions, multiplications, divisions and square
//! roots count as one each; comparisons, minima, signs and conversions do not count. Lanes that hold no particle and
//! nodes without mass count like all others where the simulator computes them. Sums that are `f64` in any precision
//! (those of the tool's cotangent, a few hundred additions for a group that touches it) are left out.

use std::cell::Cell;
use std::fmt;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use crate::mpm::timings::Reading;
use crate::real::{Polynomial, Real, RealOps};

thread_local! {
    static DONE: Cell<Reading> = const { Cell::new([0; 2]) };
}

/// Operations that this thread has done so far, and how many of them are divisions and square roots.
pub(crate) fn operations() -> Reading {
    DONE.get()
}

/// Kept out of line: the simulator's kernels with every operation counted in place would be compiled for minutes.
#[inline(never)]
fn count([all, slow]: Reading) {
    let [all_before, slow_before] = DONE.get();
    DONE.set([all_before + all, slow_before + slow]);
}

/// What counts as one operation.
const ONE: Reading = [1, 0];
/// A division or square root.
const SLOW: Reading = [1, 1];

/// What the elementary functions of a type cost: operations, and how many of them are divisions and square roots.
pub trait Elementary: Real {
    /// Of `ln(1 + x)`.
    const LN_1P: [u64; 2];
    /// Of `exp(x) - 1`.
    const EXP_M1: [u64; 2];
    /// Of the nearest integer.
    const NEAREST: [u64; 2] = [2, 0];
}

impl Elementary for f32 {
    const LN_1P: [u64; 2] = [28, 2];
    const EXP_M1: [u64; 2] = [23, 0];
}

impl Elementary for f64 {
    const LN_1P: [u64; 2] = [34, 2];
    const EXP_M1: [u64; 2] = [37, 0];
}

/// A number whose operations are counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub(crate) struct Counted<T>(T);

impl<T: Real> fmt::Display for Counted<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(&self.0, f)
    }
}

macro_rules! counted {
    ($operation:ident, $method:ident, $cost:expr) => {
        impl<T: Real> $operation for Counted<T> {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                count($cost);
                Self(self.0.$method(other.0))
            }
        }
    };
}

counted!(Add, add, ONE);
counted!(Sub, sub, ONE);
counted!(Mul, mul, ONE);
counted!(Div, div, SLOW);

impl<T: Real> Neg for Counted<T> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self(-self.0)
    }
}

impl<T: Real> AddAssign for Counted<T> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<T: Real> SubAssign for Counted<T> {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

impl<T: Elementary> Real for Counted<T> {}

impl<T: Elementary> RealOps for Counted<T> {
    const ZERO: Self = Self(T::ZERO);
    const ONE: Self = Self(T::ONE);
    const TINY: Self = Self(T::TINY);
    const LN_1P_SERIES: Polynomial = T::LN_1P_SERIES;
    const EXP_M1_SERIES: Polynomial = T::EXP_M1_SERIES;

    #[inline(always)]
    fn from_f64(x: f64) -> Self {
        Self(T::from_f64(x))
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self.0.to_f64()
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        count(SLOW);
        Self(self.0.sqrt())
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(self.0.abs())
    }
    #[inline(always)]
    fn nearest(self) -> (Self, i32) {
        count(T::NEAREST);
        let (whole, integer) = self.0.nearest();
        (Self(whole), integer)
    }
    #[inline(always)]
    fn ln_1p(self) -> Self {
        count(T::LN_1P);
        Self(self.0.ln_1p())
    }
    #[inline(always)]
    fn exp_m1(self) -> Self {
        count(T::EXP_M1);
        Self(self.0.exp_m1())
    }
    #[inline(always)]
    fn is_finite(self) -> bool {
        self.0.is_finite()
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        count([2, 0]);
        Self(self.0.mul_add(a.0, b.0))
    }
    /// Without vectors: they would not make counting faster, and each instruction set is another copy of all kernels.
    #[inline(always)]
    fn dispatch<K: pulp::NullaryFnOnce>(_: pulp::Arch, kernel: K) -> K::Output {
        kernel.call()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mpm::gather::gather_all;
    use crate::mpm::particles::Lanes;
    use crate::mpm::stencil::{Affine, Stencil, TILE_LENGTH, scatter, weights};
    use crate::mpm::stencil_positions::StencilPositions;
    use crate::small::{compose, dot};

    fn cost<R>(job: impl FnOnce() -> R) -> Reading {
        let before = operations();
        std::hint::black_box(job());
        let after = operations();
        [after[0] - before[0], after[1] - before[1]]
    }

    /// Operators in the text of a function of `real.rs`, constants like `1.0 / 6.0` and comments left out.
    fn operators(type_name: &str, function: &str) -> Reading {
        let text = include_str!("../real.rs");
        let (_, text) = text.split_once(&format!("impl RealOps for {type_name} ")).expect("implementation");
        let (_, text) = text.split_once(&format!("fn {function}(")).expect("function");
        let (body, _) = text.split_once("\n    }\n").expect("end of the function");
        let lines = body.lines().filter(|line| !line.trim_start().starts_with("//"));
        let body = lines.collect::<Vec<_>>().join("\n").replace("1.0 / ", "");
        let count = |operator: &str| body.matches(operator).count() as u64;
        let nearest = 2 * count(".nearest()");
        [count(" + ") + count(" - ") + count(" * ") + count(" / ") + nearest, count(" / ")]
    }

    #[test]
    fn elementary_functions_cost_what_their_text_says() {
        for name in ["f32", "f64"] {
            assert_eq!(operators(name, "nearest"), <f32 as Elementary>::NEAREST, "{name}");
        }
        assert_eq!(operators("f32", "ln_1p"), f32::LN_1P);
        assert_eq!(operators("f64", "ln_1p"), f64::LN_1P);
        assert_eq!(operators("f32", "exp_m1"), f32::EXP_M1);
        assert_eq!(operators("f64", "exp_m1"), f64::EXP_M1);
    }

    #[test]
    fn what_can_be_counted_by_hand_is_counted_so() {
        type C = Counted<f32>;
        let x = C::from_f64(0.75);
        assert_eq!(cost(|| dot([x; 3], [x; 3])), [5, 0]);
        assert_eq!(cost(|| -x.at_least(C::ONE).abs()), [0, 0]);
        assert_eq!(cost(|| (x / x).sqrt()), [2, 2]);
        assert_eq!(cost(|| x.exp_m1()), f32::EXP_M1);
        // Six entries of three terms: two products and a sum each, less one sum an entry.
        assert_eq!(cost(|| compose(&[[x; 3]; 3], [x; 3])), [6 * (3 * 3 - 1), 0]);
        // 3/2 - f, f - 1, f - 1/2; two squares of two products, one of one product and a difference.
        assert_eq!(cost(|| weights(x)), [3 + 2 + 2 + 2, 0]);

        let tile = [[x; 4]; TILE_LENGTH];
        let stencil = Stencil { start: 0, rows: [x; 9], along: [x; 3] };
        let affine = Affine { p: [x; 4], steps: [[x; 4]; 3] };
        // Sixteen numbers a row: the products and sums of the affine function, and its steps; nine rows: a product and a sum. One
        // sum for 2. For each run of particles with the same nodes, nine rows are added to the tile.
        let rows = 16 * (2 + 3 + 3 + 3 * 3 + 9 * 2) + 1;
        let scattered = |count: usize| cost(|| scatter(&mut tile.clone(), count, |_| stencil, |_| affine));
        assert_eq!([scattered(1), scattered(5)], [[rows + 16 * 9, 0], [5 * rows + 16 * 9, 0]]);
        // For each of sixteen lanes: the weights of moments along a row; nine rows of four and three nodes for three components;
        // three layers of two sums and a moment; over the layers the same and one more sum, each put to the other runs', and the
        // step back of two. Once for each of the two runs here.
        let places = StencilPositions {
            start: std::array::from_fn(|l| if l < 9 { 3 } else { 77 }),
            f: [Lanes([x; 16]); 3],
        };
        let w = places.weights();
        let run = 2 + 9 * 3 * (7 + 5) + 3 * 3 * (5 + 4 + 5) + 3 * ((5 + 1) + (4 + 1) + (5 + 1) + (5 + 2 + 1));
        assert_eq!(cost(|| gather_all(&tile, None, false, &places, &w, 16)), [2 * 16 * run, 0]);
    }

    #[test]
    fn counting_changes_no_bit() {
        for x in [0.3f32, -0.01, 1e-7, 2.5] {
            let y = Counted(x);
            assert_eq!(((y * y + y) / (y - Counted(3.0))).0.to_bits(), ((x * x + x) / (x - 3.0)).to_bits());
            assert_eq!(y.ln_1p().0.to_bits(), RealOps::ln_1p(x).to_bits());
            assert_eq!(y.exp_m1().sqrt().0.to_bits(), RealOps::exp_m1(x).sqrt().to_bits());
        }
    }
}
