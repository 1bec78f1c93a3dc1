//! Three-vectors and 3x3 matrices as plain arrays, with every function inlined into the vector kernels.
//!
//! nalgebra is used wherever speed does not matter; its methods are not marked `inline(always)`, and a call
//! inside a kernel would fall back to the baseline instruction set.

use crate::real::Real;

/// `[f(0), f(1), f(2)]`. `array::map` does the same, but is not always inlined, and a call inside a loop over
/// lanes keeps it from becoming vector instructions.
macro_rules! three {
    ($i:ident => $value:expr) => {
        [
            {
                let $i = 0usize;
                $value
            },
            {
                let $i = 1usize;
                $value
            },
            {
                let $i = 2usize;
                $value
            },
        ]
    };
}
pub(crate) use three;

/// Three-vector.
pub(crate) type Vec3<T> = [T; 3];
/// 3x3 matrix, `m[row][column]`.
pub(crate) type Mat3<T> = [[T; 3]; 3];
/// Symmetric 3x3 matrix `[xx, yy, zz, xy, xz, yz]`.
pub(crate) type Sym3<T> = [T; 6];

#[inline(always)]
pub(crate) fn dot<T: Real>(a: Vec3<T>, b: Vec3<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(crate) fn cross<T: Real>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
pub(crate) fn add<T: Real>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
pub(crate) fn sub<T: Real>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(crate) fn scale<T: Real>(s: T, a: Vec3<T>) -> Vec3<T> {
    [s * a[0], s * a[1], s * a[2]]
}

/// `m a`
#[inline(always)]
pub(crate) fn mul_vec<T: Real>(m: &Mat3<T>, a: Vec3<T>) -> Vec3<T> {
    [dot(m[0], a), dot(m[1], a), dot(m[2], a)]
}

/// `m^T a`
#[inline(always)]
pub(crate) fn tr_mul_vec<T: Real>(m: &Mat3<T>, a: Vec3<T>) -> Vec3<T> {
    [
        m[0][0] * a[0] + m[1][0] * a[1] + m[2][0] * a[2],
        m[0][1] * a[0] + m[1][1] * a[1] + m[2][1] * a[2],
        m[0][2] * a[0] + m[1][2] * a[1] + m[2][2] * a[2],
    ]
}

#[inline(always)]
pub(crate) fn mul<T: Real>(a: &Mat3<T>, b: &Mat3<T>) -> Mat3<T> {
    let mut out = [[T::ZERO; 3]; 3];
    for i in 0..3 {
        for j in 0..3 {
            out[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j];
        }
    }
    out
}

#[inline(always)]
pub(crate) fn transpose<T: Real>(a: &Mat3<T>) -> Mat3<T> {
    [[a[0][0], a[1][0], a[2][0]], [a[0][1], a[1][1], a[2][1]], [a[0][2], a[1][2], a[2][2]]]
}

/// The full matrix of a symmetric one.
#[inline(always)]
pub(crate) fn full<T: Real>(s: Sym3<T>) -> Mat3<T> {
    [[s[0], s[3], s[4]], [s[3], s[1], s[5]], [s[4], s[5], s[2]]]
}

/// `u diag(w) u^T`
#[inline(always)]
pub(crate) fn compose<T: Real>(u: &Mat3<T>, w: Vec3<T>) -> Sym3<T> {
    let entry =
        |i: usize, j: usize| u[i][0] * w[0] * u[j][0] + u[i][1] * w[1] * u[j][1] + u[i][2] * w[2] * u[j][2];
    [entry(0, 0), entry(1, 1), entry(2, 2), entry(0, 1), entry(0, 2), entry(1, 2)]
}

#[inline(always)]
pub(crate) fn trace<T: Real>(a: Sym3<T>) -> T {
    a[0] + a[1] + a[2]
}

#[inline(always)]
pub(crate) fn determinant<T: Real>([xx, yy, zz, xy, xz, yz]: Sym3<T>) -> T {
    xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
}

/// `sum_ij a_ij b_ij` over all nine entries.
#[inline(always)]
pub(crate) fn inner<T: Real>(a: Sym3<T>, b: Sym3<T>) -> T {
    let off = a[3] * b[3] + a[4] * b[4] + a[5] * b[5];
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + (off + off)
}

/// `a + x I`
#[inline(always)]
pub(crate) fn plus_diagonal<T: Real>(a: Sym3<T>, x: T) -> Sym3<T> {
    [a[0] + x, a[1] + x, a[2] + x, a[3], a[4], a[5]]
}

/// `s a + t b`
#[inline(always)]
pub(crate) fn blend<T: Real>(s: T, a: Sym3<T>, t: T, b: Sym3<T>) -> Sym3<T> {
    let entry = |i: usize| s * a[i] + t * b[i];
    [entry(0), entry(1), entry(2), entry(3), entry(4), entry(5)]
}

/// `s a`
#[inline(always)]
pub(crate) fn scale_sym<T: Real>(s: T, a: Sym3<T>) -> Sym3<T> {
    [s * a[0], s * a[1], s * a[2], s * a[3], s * a[4], s * a[5]]
}
