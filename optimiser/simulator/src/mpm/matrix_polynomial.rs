//! Functions of symmetric matrices without trace, by powers instead of eigenvectors.
//!
//! Such a matrix satisfies `B^3 = m2 B + m3 I` with `m2 = tr(B^2)/2` and `m3 = det B` (Cayley-Hamilton), so a power series
//! in `B` is `f0 I + f1 B + f2 B^2` with three numbers `f`, found by Horner's rule in two multiply-adds a power.

use crate::real::{Polynomial, Real};
use crate::small::{Sym3, inner, trace};

/// `B`, `B^2` and the two invariants.
#[derive(Clone, Copy)]
pub(crate) struct CayleyHamilton<T> {
    pub(crate) b: Sym3<T>,
    pub(crate) b2: Sym3<T>,
    pub(crate) m2: T,
    pub(crate) m3: T,
}

impl<T: Real> CayleyHamilton<T> {
    #[inline(always)]
    pub(crate) fn of(b: Sym3<T>) -> Self {
        let [xx, yy, zz, xy, xz, yz] = b;
        let (xy2, xz2, yz2) = (xy * xy, xz * xz, yz * yz);
        let b2 = [
            xx.mul_add(xx, xy2 + xz2),
            yy.mul_add(yy, xy2 + yz2),
            zz.mul_add(zz, xz2 + yz2),
            xz.mul_add(yz, -(xy * zz)),
            xy.mul_add(yz, -(xz * yy)),
            xy.mul_add(xz, -(yz * xx)),
        ];
        let m2 = T::from_f64(0.5) * (b2[0] + b2[1] + b2[2]);
        // The cofactors of the first row are those of b2 - m2 I.
        let m3 = xx.mul_add(b2[0] - m2, xy.mul_add(b2[3], xz * b2[4]));
        Self { b, b2, m2, m3 }
    }

    /// `f0 I + f1 B + f2 B^2`
    #[inline(always)]
    pub(crate) fn combine(&self, f: [T; 3]) -> Sym3<T> {
        let (b, b2) = (&self.b, &self.b2);
        let entry = |i: usize| f[1].mul_add(b[i], f[2] * b2[i]);
        [f[0] + entry(0), f[0] + entry(1), f[0] + entry(2), entry(3), entry(4), entry(5)]
    }

    /// Cotangent of `B` from the cotangent `bar` of `f(B)`, where `f` are the numbers and `slopes` their derivatives with
    /// respect to `m2` and `m3`.
    #[inline(always)]
    pub(crate) fn combine_adjoint(&self, f: [T; 3], slopes: [[T; 3]; 2], bar: Sym3<T>) -> Sym3<T> {
        let (b, b2) = (&self.b, &self.b2);
        let f_bar = [trace(bar), inner(bar, *b), inner(bar, *b2)];
        let along = |s: [T; 3]| f_bar[0].mul_add(s[0], f_bar[1].mul_add(s[1], f_bar[2] * s[2]));
        let (m2_bar, m3_bar) = (along(slopes[0]), along(slopes[1]));
        let turned = anticommutator(bar, *b);
        let entry =
            |i: usize| f[1].mul_add(bar[i], f[2].mul_add(turned[i], m2_bar.mul_add(b[i], m3_bar * b2[i])));
        let less = m3_bar * self.m2;
        [entry(0) - less, entry(1) - less, entry(2) - less, entry(3), entry(4), entry(5)]
    }
}

/// `A B + B A`
#[inline(always)]
fn anticommutator<T: Real>(a: Sym3<T>, b: Sym3<T>) -> Sym3<T> {
    let [ax, ay, az, axy, axz, ayz] = a;
    let [bx, by, bz, bxy, bxz, byz] = b;
    let (dxy, dxz, dyz) = (axy * bxy, axz * bxz, ayz * byz);
    let twice = |x: T| x + x;
    [
        twice(ax.mul_add(bx, dxy + dxz)),
        twice(ay.mul_add(by, dxy + dyz)),
        twice(az.mul_add(bz, dxz + dyz)),
        axy.mul_add(bx + by, bxy.mul_add(ax + ay, axz.mul_add(byz, ayz * bxz))),
        axz.mul_add(bx + bz, bxz.mul_add(ax + az, axy.mul_add(byz, ayz * bxy))),
        ayz.mul_add(by + bz, byz.mul_add(ay + az, axy.mul_add(bxz, axz * bxy))),
    ]
}

/// Runs a body for `k` from `$n - 2` down to 0. Unrolled by hand: a loop would keep the loop over lanes around it from
/// vectorising.
macro_rules! downwards {
    ($n:expr, $k:ident => $body:expr) => {
        downwards!(@ $n, $k, $body, 24 23 22 21 20 19 18 17 16 15 14 13 12 11 10 9 8 7 6 5 4 3 2 1 0)
    };
    (@ $n:expr, $k:ident, $body:expr, $($at:literal)*) => {
        $(if $at + 1 < $n {
            let $k: usize = $at;
            $body
        })*
    };
}

pub(crate) use downwards;

/// The numbers of `x p(x)` at `B`, where `p` is the series.
#[inline(always)]
pub(crate) fn horner<T: Real>(p: &Polynomial, m2: T, m3: T) -> [T; 3] {
    let c = &p.coefficients;
    let mut f = [T::from_f64(c[p.terms - 1]), T::ZERO, T::ZERO];
    downwards!(p.terms, k => f = [f[2].mul_add(m3, T::from_f64(c[k])), f[2].mul_add(m2, f[0]), f[1]]);
    [f[2] * m3, f[2].mul_add(m2, f[0]), f[1]]
}

/// [`horner`], and the derivatives with respect to `m2` and `m3`.
#[inline(always)]
pub(crate) fn horner_with_slopes<T: Real>(p: &Polynomial, m2: T, m3: T) -> ([T; 3], [[T; 3]; 2]) {
    let (c, zero) = (&p.coefficients, [T::ZERO; 3]);
    let mut f = [T::from_f64(c[p.terms - 1]), T::ZERO, T::ZERO];
    let (mut by_m2, mut by_m3) = (zero, zero);
    downwards!(p.terms, k => {
        by_m2 = [by_m2[2] * m3, by_m2[2].mul_add(m2, by_m2[0] + f[2]), by_m2[1]];
        by_m3 = [by_m3[2].mul_add(m3, f[2]), by_m3[2].mul_add(m2, by_m3[0]), by_m3[1]];
        f = [f[2].mul_add(m3, T::from_f64(c[k])), f[2].mul_add(m2, f[0]), f[1]];
    });
    by_m2 = [by_m2[2] * m3, by_m2[2].mul_add(m2, by_m2[0] + f[2]), by_m2[1]];
    by_m3 = [by_m3[2].mul_add(m3, f[2]), by_m3[2].mul_add(m2, by_m3[0]), by_m3[1]];
    ([f[2] * m3, f[2].mul_add(m2, f[0]), f[1]], [by_m2, by_m3])
}
