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
/// Nodes in a tile, and one that is none: the loops here read, and write back, one beyond each row of three.
pub(crate) const TILE_LENGTH: usize = TILE_EDGE * TILE_EDGE * TILE_EDGE + 1;
/// Four numbers at each node of a tile: momentum and mass, velocity, or their cotangents.
pub(crate) type Tile<T> = [[T; 4]; TILE_LENGTH];

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

/// Numbers of a row of nodes that the loops here handle at once: four of each of its three nodes, and of a fourth one whose
/// weight is 0, for vectors of 16 are what there is.
const ROW: usize = 16;
/// From a row to the next, and from a layer of rows to the next, in numbers.
const NEXT_ROW: usize = 4 * TILE_EDGE;
const NEXT_LAYER: usize = NEXT_ROW * TILE_EDGE;
/// From the first number of a stencil's nine rows to the end of the last.
const REACH: usize = 2 * NEXT_LAYER + 2 * NEXT_ROW + ROW;

/// What number `n` of a row takes of three numbers for its nodes.
#[inline(always)]
fn of_node<T: Real>(n: usize, of: [T; 3]) -> T {
    // Comparisons like these, on the number of the lane, become constant masks.
    if n < 4 {
        of[0]
    } else if n < 8 {
        of[1]
    } else if n < 12 {
        of[2]
    } else {
        T::ZERO
    }
}

/// What number `n` of a row takes of the four numbers that each node has.
#[inline(always)]
fn of_part<T: Real>(n: usize, of: [T; 4]) -> T {
    let part = n % 4;
    let low = if part < 1 { of[0] } else { of[1] };
    let high = if part < 3 { of[2] } else { of[3] };
    if part < 2 { low } else { high }
}

/// The numbers of a row's nodes, added up.
#[inline(always)]
fn over_nodes<T: Real>(row: &[T; ROW]) -> [T; 4] {
    let mut out = [T::ZERO; 4];
    for c in 0..4 {
        out[c] = (row[c] + row[c + 4]) + row[c + 8];
    }
    out
}

#[inline(always)]
fn total<T: Real>(row: &[T; ROW]) -> T {
    let [a, b, c, d] = over_nodes(row);
    (a + b) + (c + d)
}

/// `node += w P` for the 27 nodes.
#[inline(always)]
pub(crate) fn scatter<T: Real>(tile: &mut Tile<T>, s: &Stencil<T>, a: &Affine<T>) {
    let start = 4 * s.start;
    let rows = &mut tile.as_flattened_mut()[start..start + REACH];
    let [wx, wy, wz] = s.w;
    let k = [T::ZERO, T::ONE, T::ONE + T::ONE];
    for n in 0..ROW {
        let wz = of_node(n, wz);
        let along_j = wz * of_part(n, a.steps[1]);
        let along_i = wz * of_part(n, a.steps[0]);
        let p = wz * (of_part(n, a.p) + of_node(n, k) * of_part(n, a.steps[2]));
        let mut add =
            |i: usize, j: usize, p: T| rows[i * NEXT_LAYER + j * NEXT_ROW + n] += (wx[i] * wy[j]) * p;
        let mut layer = |i: usize, p: T| {
            add(i, 0, p);
            add(i, 1, p + along_j);
            add(i, 2, (p + along_j) + along_j);
        };
        layer(0, p);
        layer(1, p + along_i);
        layer(2, (p + along_i) + along_i);
    }
}

/// Weighted sum of the nodes' values, and their first moments in the node index.
#[derive(Clone, Copy)]
pub(crate) struct Moments<T> {
    pub(crate) sum: [T; 4],
    pub(crate) first: [[T; 4]; 3],
}

/// `a[0] b[0] + a[1] b[1] + a[2] b[2]`
#[inline(always)]
fn dot<T: Real>(a: [T; 3], b: [T; 3]) -> T {
    (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]
}

/// `sum w g` and `sum w g (i, j, k)`.
#[inline(always)]
pub(crate) fn gather<T: Real>(tile: &Tile<T>, s: &Stencil<T>) -> Moments<T> {
    let start = 4 * s.start;
    let rows = &tile.as_flattened()[start..start + REACH];
    let [wx, wy, wz] = s.w;
    let index = [T::ZERO, T::ONE, T::ONE + T::ONE];
    let [mut sum, mut by_i, mut by_j, mut by_k] = [[T::ZERO; ROW]; 4];
    for n in 0..ROW {
        let wz = of_node(n, wz);
        let layer = |i: usize| {
            let g = |j: usize| rows[i * NEXT_LAYER + j * NEXT_ROW + n];
            let (one, two) = (wy[1] * g(1), wy[2] * g(2));
            ((wy[0] * g(0) + one) + two, one + (two + two))
        };
        let ((s0, j0), (s1, j1), (s2, j2)) = (layer(0), layer(1), layer(2));
        let (one, two) = (wx[1] * s1, wx[2] * s2);
        let all = wz * ((wx[0] * s0 + one) + two);
        sum[n] = all;
        by_i[n] = wz * (one + (two + two));
        by_j[n] = wz * dot(wx, [j0, j1, j2]);
        by_k[n] = of_node(n, index) * all;
    }
    Moments { sum: over_nodes(&sum), first: [over_nodes(&by_i), over_nodes(&by_j), over_nodes(&by_k)] }
}

/// [`gather`], and `sum (dw/dX_axis) (g.P)` for the three axes; `slopes` are the derivatives of the weights.
#[inline(always)]
pub(crate) fn gather_with_gradient<T: Real>(
    tile: &Tile<T>,
    s: &Stencil<T>,
    slopes: &[[T; 3]; 3],
    a: &Affine<T>,
) -> (Moments<T>, [T; 3]) {
    let start = 4 * s.start;
    let rows = &tile.as_flattened()[start..start + REACH];
    let ([wx, wy, wz], [dx, dy, dz]) = (s.w, *slopes);
    let index = [T::ZERO, T::ONE, T::ONE + T::ONE];
    let [mut sum, mut by_i, mut by_j, mut by_k] = [[T::ZERO; ROW]; 4];
    let [mut along_x, mut along_y, mut along_z] = [[T::ZERO; ROW]; 3];
    for n in 0..ROW {
        let (wz, dz, k) = (of_node(n, wz), of_node(n, dz), of_node(n, index));
        let (along_i, along_j) = (of_part(n, a.steps[0]), of_part(n, a.steps[1]));
        let p = of_part(n, a.p) + k * of_part(n, a.steps[2]);
        // Sums over a layer: w g, w g j, w g.P and dw g.P.
        let layer = |i: usize, p: T| {
            let g = |j: usize| rows[i * NEXT_LAYER + j * NEXT_ROW + n];
            let (g0, g1, g2) = (g(0), g(1), g(2));
            let (one, two) = (wy[1] * g1, wy[2] * g2);
            let (sum, by_j) = ((wy[0] * g0 + one) + two, one + (two + two));
            let (one, two) = (dy[1] * g1, dy[2] * g2);
            let (slope, slope_by_j) = ((dy[0] * g0 + one) + two, one + (two + two));
            (sum, by_j, p * sum + along_j * by_j, p * slope + along_j * slope_by_j)
        };
        let (s0, j0, p0, d0) = layer(0, p);
        let (s1, j1, p1, d1) = layer(1, p + along_i);
        let (s2, j2, p2, d2) = layer(2, (p + along_i) + along_i);
        let (one, two) = (wx[1] * s1, wx[2] * s2);
        let all = wz * ((wx[0] * s0 + one) + two);
        sum[n] = all;
        by_i[n] = wz * (one + (two + two));
        by_j[n] = wz * dot(wx, [j0, j1, j2]);
        by_k[n] = k * all;
        along_x[n] = wz * dot(dx, [p0, p1, p2]);
        along_y[n] = wz * dot(wx, [d0, d1, d2]);
        along_z[n] = dz * dot(wx, [p0, p1, p2]);
    }
    let first = [over_nodes(&by_i), over_nodes(&by_j), over_nodes(&by_k)];
    (Moments { sum: over_nodes(&sum), first }, [total(&along_x), total(&along_y), total(&along_z)])
}
