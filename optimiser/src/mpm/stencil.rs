//! Quadratic B-splines and the three inner loops of all transfers.
//!
//! A particle with cell coordinate `X = x/dx` touches the 27 nodes from `base = floor(X - 1/2)`; with
//! `f = X - base` in [1/2, 3/2) the weights along one axis are
//! `[(3/2 - f)^2/2, 3/4 - (f - 1)^2, (f - 1/2)^2/2]`.
//!
//! Everything that a transfer sends to or takes from a node is affine in the node's index `(i, j, k)`:
//! `P_ijk = p + i a + j b + k c`, four numbers each. The loops here know no more than that:
//!
//! | function | what it does | used by |
//! |---|---|---|
//! | [`scatter`] | `node += w P` | particle to grid; adjoint of grid to particle |
//! | [`gather`] | `sum w g`, `sum w g (i, j, k)` | grid to particle |
//! | [`gather_with_gradient`] | those, and `sum (dw/dX) (g.P)` | both adjoints |

use crate::real::Real;

/// Nodes along one edge of a block's tile: 4 cells, 2 for the spline, and one cell of slack on either side so
/// that particles need not be sorted in every substep.
pub(crate) const TILE_EDGE: usize = 8;
/// Nodes in a tile.
pub(crate) const TILE_NODES: usize = TILE_EDGE * TILE_EDGE * TILE_EDGE;
/// Four numbers at each node of a tile: momentum and mass, velocity, or their cotangents.
pub(crate) type Tile<T> = [[T; 4]; TILE_NODES];

/// Weights of one particle along the three axes, and where its 27 nodes start in the tile.
#[derive(Clone, Copy)]
pub(crate) struct Stencil<T> {
    pub(crate) start: usize,
    pub(crate) w: [[T; 3]; 3],
}

/// An affine function of the node index: value at node (0, 0, 0) and its increments.
#[derive(Clone, Copy)]
pub(crate) struct Affine<T> {
    pub(crate) p: [T; 4],
    pub(crate) steps: [[T; 4]; 3],
}

/// Weights at `f` in [1/2, 3/2).
#[inline(always)]
pub(crate) fn weights<T: Real>(f: T) -> [T; 3] {
    let half = T::of(0.5);
    let (a, b, c) = (T::of(1.5) - f, f - T::ONE, f - half);
    [half * a * a, T::of(0.75) - b * b, half * c * c]
}

/// Derivatives of the weights with respect to `X`.
#[inline(always)]
pub(crate) fn weight_slopes<T: Real>(f: T) -> [T; 3] {
    let b = f - T::ONE;
    [f - T::of(1.5), -(b + b), f - T::of(0.5)]
}

#[inline(always)]
fn plus<T: Real>(a: [T; 4], b: [T; 4]) -> [T; 4] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]]
}

#[inline(always)]
fn times<T: Real>(s: T, a: [T; 4]) -> [T; 4] {
    [s * a[0], s * a[1], s * a[2], s * a[3]]
}

#[inline(always)]
fn each<T: Real>(a: [T; 4], b: [T; 4]) -> [T; 4] {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3]]
}

#[inline(always)]
fn total<T: Real>(a: [T; 4]) -> T {
    (a[0] + a[1]) + (a[2] + a[3])
}

/// The three nodes of one row.
#[inline(always)]
fn row<T: Real>(tile: &Tile<T>, start: usize, i: usize, j: usize) -> &[[T; 4]; 3] {
    let at = start + i * TILE_EDGE * TILE_EDGE + j * TILE_EDGE;
    tile[at..at + 3].as_array().expect("three nodes")
}

/// `node += w P` for the 27 nodes.
#[inline(always)]
pub(crate) fn scatter<T: Real>(tile: &mut Tile<T>, s: &Stencil<T>, a: &Affine<T>) {
    let mut pi = a.p;
    for i in 0..3 {
        let mut pj = pi;
        for j in 0..3 {
            let wij = s.w[0][i] * s.w[1][j];
            let at = s.start + i * TILE_EDGE * TILE_EDGE + j * TILE_EDGE;
            let nodes = &mut tile[at..at + 3];
            let p1 = plus(pj, a.steps[2]);
            let p2 = plus(p1, a.steps[2]);
            nodes[0] = plus(nodes[0], times(wij * s.w[2][0], pj));
            nodes[1] = plus(nodes[1], times(wij * s.w[2][1], p1));
            nodes[2] = plus(nodes[2], times(wij * s.w[2][2], p2));
            pj = plus(pj, a.steps[1]);
        }
        pi = plus(pi, a.steps[0]);
    }
}

/// Weighted sum of the nodes' values, and their first moments in the node index.
#[derive(Clone, Copy)]
pub(crate) struct Moments<T> {
    pub(crate) sum: [T; 4],
    pub(crate) first: [[T; 4]; 3],
}

/// `sum w g` and `sum w g (i, j, k)`.
#[inline(always)]
pub(crate) fn gather<T: Real>(tile: &Tile<T>, s: &Stencil<T>) -> Moments<T> {
    let zero = [T::ZERO; 4];
    let mut m = Moments { sum: zero, first: [zero; 3] };
    let index = [T::ZERO, T::ONE, T::ONE + T::ONE];
    let twice = s.w[2][2] + s.w[2][2];
    for i in 0..3 {
        let mut sum_i = zero;
        for j in 0..3 {
            let g = row(tile, s.start, i, j);
            let r = plus(plus(times(s.w[2][0], g[0]), times(s.w[2][1], g[1])), times(s.w[2][2], g[2]));
            let rk = plus(times(s.w[2][1], g[1]), times(twice, g[2]));
            let wij = s.w[0][i] * s.w[1][j];
            let r = times(wij, r);
            sum_i = plus(sum_i, r);
            m.first[2] = plus(m.first[2], times(wij, rk));
            m.first[1] = plus(m.first[1], times(index[j], r));
        }
        m.sum = plus(m.sum, sum_i);
        m.first[0] = plus(m.first[0], times(index[i], sum_i));
    }
    m
}

/// [`gather`], and `sum (dw/dX_axis) (g.P)` for the three axes; `slopes` are the derivatives of the weights.
#[inline(always)]
pub(crate) fn gather_with_gradient<T: Real>(
    tile: &Tile<T>,
    s: &Stencil<T>,
    slopes: &[[T; 3]; 3],
    a: &Affine<T>,
) -> (Moments<T>, [T; 3]) {
    let zero = [T::ZERO; 4];
    let mut m = Moments { sum: zero, first: [zero; 3] };
    let mut gradient = [zero; 3];
    let index = [T::ZERO, T::ONE, T::ONE + T::ONE];
    let (wz, dz) = (s.w[2], slopes[2]);
    let mut pi = a.p;
    for i in 0..3 {
        let mut pj = pi;
        let mut sum_i = zero;
        for j in 0..3 {
            let g = row(tile, s.start, i, j);
            let w1 = times(wz[1], g[1]);
            let w2 = times(wz[2], g[2]);
            let r = plus(plus(times(wz[0], g[0]), w1), w2);
            let rk = plus(plus(w1, w2), w2);
            let d1 = times(dz[1], g[1]);
            let d2 = times(dz[2], g[2]);
            let d = plus(plus(times(dz[0], g[0]), d1), d2);
            let dk = plus(plus(d1, d2), d2);
            let along_row = plus(each(pj, r), each(a.steps[2], rk));
            let across = plus(each(pj, d), each(a.steps[2], dk));
            let wij = s.w[0][i] * s.w[1][j];
            gradient[0] = plus(gradient[0], times(slopes[0][i] * s.w[1][j], along_row));
            gradient[1] = plus(gradient[1], times(s.w[0][i] * slopes[1][j], along_row));
            gradient[2] = plus(gradient[2], times(wij, across));
            let r = times(wij, r);
            sum_i = plus(sum_i, r);
            m.first[2] = plus(m.first[2], times(wij, rk));
            m.first[1] = plus(m.first[1], times(index[j], r));
            pj = plus(pj, a.steps[1]);
        }
        m.sum = plus(m.sum, sum_i);
        m.first[0] = plus(m.first[0], times(index[i], sum_i));
        pi = plus(pi, a.steps[0]);
    }
    (m, [total(gradient[0]), total(gradient[1]), total(gradient[2])])
}
