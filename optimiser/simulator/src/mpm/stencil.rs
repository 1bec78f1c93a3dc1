//! Quadratic B-splines, and what a particle does to its nodes.
//!
//! A particle with cell coordinate `X = x/dx` touches the 27 nodes from `base = floor(X - 1/2)`; with
//! `f = X - base` in [1/2, 3/2) the weights along one axis are
//! `[(3/2 - f)^2/2, 3/4 - (f - 1)^2, (f - 1/2)^2/2]`.
//!
//! Everything that a particle sends to a node is affine in the node's index `(i, j, k)`: `P_ijk = p + i a + j b + k c`, four
//! numbers each. [`scatter`] knows no more than that; it serves particle to grid and the adjoint of grid to particle. What comes
//! back from the nodes is in [`super::gather`].

use crate::real::Real;

/// Nodes along one edge of a block's tile: 4 cells, 2 for the spline, and one cell of slack on either side so
/// that particles need not be sorted in every substep.
pub(crate) const TILE_EDGE: usize = 8;
/// Nodes in a tile, and one that is none: the loops here read, and write back, one beyond each row of three.
pub(crate) const TILE_LENGTH: usize = TILE_EDGE * TILE_EDGE * TILE_EDGE + 1;
/// Four numbers at each node of a tile: momentum and mass, velocity, or their cotangents.
pub(crate) type Tile<T> = [[T; 4]; TILE_LENGTH];

/// Weights of one particle, and where its 27 nodes start in the tile.
#[derive(Clone, Copy)]
pub(crate) struct Stencil<T> {
    pub(crate) start: usize,
    /// Of its nine rows: the weight along x times the one along y, those of one x together.
    pub(crate) rows: [T; 9],
    /// Along the rows.
    pub(crate) along: [T; 3],
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
    let half = T::from_f64(0.5);
    let (a, b, c) = (T::from_f64(1.5) - f, f - T::ONE, f - half);
    [half * a * a, T::from_f64(0.75) - b * b, half * c * c]
}

/// Derivatives of the weights with respect to `X`.
#[inline(always)]
pub(crate) fn weight_slopes<T: Real>(f: T) -> [T; 3] {
    let b = f - T::ONE;
    [f - T::from_f64(1.5), -(b + b), f - T::from_f64(0.5)]
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

/// The nine rows of nodes of a stencil, or what is to be added to them.
#[repr(align(64))]
struct Rows<T>([[T; ROW]; 9]);

impl<T: Real> Rows<T> {
    /// `node += w P` for the 27 nodes.
    #[inline(always)]
    fn add(&mut self, s: &Stencil<T>, a: &Affine<T>) {
        let rows = &mut self.0;
        let k = [T::ZERO, T::ONE, T::ONE + T::ONE];
        for n in 0..ROW {
            let wz = of_node(n, s.along);
            let along_j = wz * of_part(n, a.steps[1]);
            let along_i = wz * of_part(n, a.steps[0]);
            let p = wz * of_node(n, k).mul_add(of_part(n, a.steps[2]), of_part(n, a.p));
            let mut add = |i: usize, j: usize, p: T| {
                let at = &mut rows[3 * i + j][n];
                *at = s.rows[3 * i + j].mul_add(p, *at);
            };
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

    #[inline(always)]
    fn add_to(&self, tile: &mut Tile<T>, start: usize) {
        let start = 4 * start;
        let tile = &mut tile.as_flattened_mut()[start..start + REACH];
        // All rows in one loop, as above: a short loop for each would be unrolled, and its pieces not always put together again.
        for n in 0..ROW {
            for i in 0..3 {
                for j in 0..3 {
                    tile[i * NEXT_LAYER + j * NEXT_ROW + n] += self.0[3 * i + j][n];
                }
            }
        }
    }
}

/// `node += w P` for the 27 nodes of each of `occupied` particles. What particles with the same nodes send one after another is added
/// up before it goes to the tile: sorted particles are so almost always.
#[inline(always)]
pub(crate) fn scatter<T: Real>(
    tile: &mut Tile<T>,
    occupied: usize,
    stencil: impl Fn(usize) -> Stencil<T>,
    affine: impl Fn(usize) -> Affine<T>,
) {
    scatter_all([tile], occupied, stencil, |l| [affine(l)]);
}

/// The same into several tiles at once, with as many functions.
#[inline(always)]
pub(crate) fn scatter_all<T: Real, const N: usize>(
    tiles: [&mut Tile<T>; N],
    occupied: usize,
    stencil: impl Fn(usize) -> Stencil<T>,
    affine: impl Fn(usize) -> [Affine<T>; N],
) {
    let mut l = 0;
    while l < occupied {
        let start = stencil(l).start;
        let mut rows: [Rows<T>; N] = std::array::from_fn(|_| Rows([[T::ZERO; ROW]; 9]));
        while l < occupied && stencil(l).start == start {
            let (stencil, affine) = (stencil(l), affine(l));
            for n in 0..N {
                rows[n].add(&stencil, &affine[n]);
            }
            l += 1;
        }
        for n in 0..N {
            rows[n].add_to(tiles[n], start);
        }
    }
}
