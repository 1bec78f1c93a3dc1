//! Where the particles of a group stand in their block's tile, and their weights.

use crate::mpm::layout::BLOCK_EDGE;
use crate::mpm::particles::{LANES, Lanes, vec_of};
use crate::mpm::stencil::{Stencil, TILE_EDGE, weight_slopes, weights};
use crate::real::Real;
use crate::small::{Vec3, three};

/// Where the particles of a group stand in their block's tile.
#[derive(Clone, Copy)]
pub(crate) struct StencilPositions<T> {
    /// The first of each particle's 27 nodes.
    pub(crate) start: [i32; LANES],
    /// Distance from that node, in cells.
    pub(crate) f: [Lanes<T>; 3],
}

/// Between which nodes of a tile the stencils of some particles begin.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reach {
    first: [i32; 3],
    last: [i32; 3],
}

/// All neighbours of a block: see [`Reach::neighbours`].
pub(crate) const ALL_NEIGHBOURS: u32 = (1 << 27) - 1;

impl Reach {
    pub(crate) const NOTHING: Self = Self { first: [i32::MAX; 3], last: [i32::MIN; 3] };

    /// A group more.
    #[inline(always)]
    pub(crate) fn add(&mut self, start: &[i32; LANES]) {
        let edge = TILE_EDGE as i32;
        for l in 0..LANES {
            let begins = [start[l] / (edge * edge), start[l] / edge % edge, start[l] % edge];
            for axis in 0..3 {
                self.first[axis] = self.first[axis].min(begins[axis]);
                self.last[axis] = self.last[axis].max(begins[axis]);
            }
        }
    }

    /// Which of the 27 neighbours of the block own nodes that those stencils may have: bit `n` for neighbour `n`.
    pub(crate) fn neighbours(&self) -> u32 {
        let along = |axis: usize| {
            let (first, last) = (self.first[axis], self.last[axis].saturating_add(2));
            let own = BLOCK_EDGE as i32;
            [first < 1, first <= own && last >= 1, last > own]
        };
        let [x, y, z] = [along(0), along(1), along(2)];
        let bit = |n: usize| u32::from(x[n / 9] && y[n / 3 % 3] && z[n % 3]) << n;
        (0..27).fold(0, |bits, n| bits | bit(n))
    }
}

/// Weights of a group along the three axes, or their derivatives: axis, node, lane. Found for all lanes at once; the loops
/// over nodes then only read them.
pub(crate) type Weights<T> = [[Lanes<T>; 3]; 3];

/// What [`super::stencil::scatter`] takes of the weights of a group.
pub(crate) struct Stencils<T> {
    start: [i32; LANES],
    rows: [Lanes<T>; 9],
    along: [Lanes<T>; 3],
}

impl<T: Real> Stencils<T> {
    /// One particle's.
    #[inline(always)]
    pub(crate) fn of(&self, l: usize) -> Stencil<T> {
        let along = three!(n => self.along[n][l]);
        Stencil { start: self.start[l] as usize, rows: std::array::from_fn(|n| self.rows[n][l]), along }
    }
}

impl<T: Real> StencilPositions<T> {
    /// Of the particles at `x` (m); `shift` is what `x/dx` lacks of the coordinate in the tile.
    #[inline(always)]
    pub(crate) fn of(inverse_dx: T, shift: Vec3<T>, x: &[Lanes<T>; 3]) -> Self {
        let edge = TILE_EDGE as i32;
        let mut out = Self { start: [0; LANES], f: [Lanes::ZERO; 3] };
        for axis in 0..3 {
            let (mut f, mut start, x) = (Lanes::ZERO, out.start, x[axis]);
            for l in 0..LANES {
                let at = x[l] * inverse_dx + shift[axis];
                // floor(at - 1/2), but for ties, where either neighbour is right: the splines are continuous.
                let (whole, base) = (at - T::ONE).nearest();
                f[l] = at - whole;
                start[l] = start[l] * edge + base;
            }
            out.f[axis] = f;
            out.start = start;
        }
        out
    }

    #[inline(always)]
    pub(crate) fn f(&self, l: usize) -> Vec3<T> {
        vec_of(&self.f, l)
    }

    /// Weights of the group.
    #[inline(always)]
    pub(crate) fn weights(&self) -> Weights<T> {
        self.along_axes(weights)
    }

    /// Derivatives of [`Self::weights`].
    #[inline(always)]
    pub(crate) fn slopes(&self) -> Weights<T> {
        self.along_axes(weight_slopes)
    }

    #[inline(always)]
    fn along_axes(&self, of: impl Fn(T) -> [T; 3]) -> Weights<T> {
        let mut out = [[Lanes::ZERO; 3]; 3];
        for l in 0..LANES {
            for axis in 0..3 {
                let numbers = of(self.f[axis][l]);
                for node in 0..3 {
                    out[axis][node][l] = numbers[node];
                }
            }
        }
        out
    }

    /// Those of the group, with what can be multiplied for all its particles at once.
    #[inline(always)]
    pub(crate) fn stencils(&self, w: &Weights<T>) -> Stencils<T> {
        let mut rows = [Lanes::ZERO; 9];
        for l in 0..LANES {
            for i in 0..3 {
                for j in 0..3 {
                    rows[3 * i + j][l] = w[0][i][l] * w[1][j][l];
                }
            }
        }
        Stencils { start: self.start, rows, along: w[2] }
    }
}
