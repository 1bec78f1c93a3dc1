//! From nodes to particles, for a group at a time: lane `l` of every loop here is particle `l`.
//!
//! Particles whose stencils begin at the same node read the same 27 nodes, so that a node's number is one number for all
//! lanes. A group is sorted by cells, and is read in [`Run`]s: all particles whose stencil begins at one node, or at the
//! next one along z. A run has rows of four nodes; particles that are not in it take part with weights of 0. A group is
//! about two runs, and each particle that has left its cell since the last sort may be one more: that costs
//! time and changes nothing else.
//!
//! What a particle takes are sums `sum w g` and `sum w g (i, j, k)`, and for adjoints `sum (dw/dX) (g.P)` with the affine
//! `P_ijk = p + i a + j b + k c` that it sends (see [`super::stencil`]); the node index counts from the
//! particle's own first node. A node's fourth number is mass, or density.

use crate::mpm::particles::{LANES, Lanes};
use crate::mpm::stencil::{TILE_EDGE, Tile};
use crate::mpm::stencil_positions::{StencilPositions, Weights};
use crate::real::Real;
use crate::small::three;

/// What a group has gathered; 0 for lanes without a particle.
pub(crate) struct Gathered<T> {
    /// `sum w g`
    pub(crate) sum: [Lanes<T>; 3],
    /// First moments `sum w g (i, j, k)`: component of `g`, axis of the node index.
    pub(crate) first: [Lanes<T>; 9],
    /// `sum (dw/dX) (g.P)`
    pub(crate) gradient: [Lanes<T>; 3],
}

impl<T: Real> Gathered<T> {
    const ZERO: Self = Self { sum: [Lanes::ZERO; 3], first: [Lanes::ZERO; 9], gradient: [Lanes::ZERO; 3] };
}

/// What the particles of a group send to the grid.
#[derive(Clone, Copy)]
pub(crate) struct Sent<T> {
    /// `p`, at the first node.
    pub(crate) base: [Lanes<T>; 3],
    /// Increments `a`, `b`, `c` from node to node: the columns of this matrix.
    pub(crate) a_dx: [Lanes<T>; 9],
}

/// What the particles of a group send to the nodes' fourth number: an affine function, too.
#[derive(Clone, Copy)]
pub(crate) struct Fourth<T> {
    /// At the first node.
    pub(crate) base: Lanes<T>,
    /// Increments from node to node.
    pub(crate) steps: [Lanes<T>; 3],
}

impl<T: Real> Fourth<T> {
    pub(crate) const ZERO: Self = Self { base: Lanes::ZERO, steps: [Lanes::ZERO; 3] };
}

/// `sum w g` and `sum w g (i, j, k)` of the nodes' fourth number.
pub(crate) struct GatheredFourth<T> {
    pub(crate) sum: Lanes<T>,
    /// 0 if they were not asked for.
    pub(crate) first: [Lanes<T>; 3],
}

/// Nodes along a row of a run.
const ROW: usize = 4;
/// From the first node of a run to the end of its last row.
const REACH: usize = (2 * TILE_EDGE + 2) * TILE_EDGE + ROW;
/// Where no stencil begins: for lanes that have been seen to, or are empty.
const NOWHERE: i32 = i32::MAX / 2;

/// Particles that read the same rows of nodes.
struct Run {
    /// The first node.
    start: usize,
    /// How many nodes after it each particle's stencil begins; only those with 0 or 1 are in the run.
    offset: [i32; LANES],
}

impl Run {
    /// The next run of the lanes that wait.
    #[inline(always)]
    fn next(waiting: &mut [i32; LANES]) -> Option<Self> {
        let mut first = NOWHERE;
        for l in 0..LANES {
            first = first.min(waiting[l]);
        }
        if first == NOWHERE {
            return None;
        }
        let mut offset = *waiting;
        for l in 0..LANES {
            offset[l] -= first;
            waiting[l] = if offset[l] < 2 { NOWHERE } else { waiting[l] };
        }
        Some(Self { start: first as usize, offset })
    }

    /// 1 for particles whose stencil begins at the second node of the rows.
    #[inline(always)]
    fn z_offset<T: Real>(&self, l: usize) -> T {
        T::ONE.only_if(self.offset[l] == 1)
    }

    /// What a particle's three weights along z are for the four nodes of a row.
    #[inline(always)]
    fn along_row<T: Real>(&self, l: usize, w: [T; 3]) -> [T; ROW] {
        let (at_first, at_second) = (self.offset[l] == 0, self.offset[l] == 1);
        let either = |a: T, b: T| if at_first { a } else { b };
        [
            w[0].only_if(at_first),
            either(w[1], w[0].only_if(at_second)),
            either(w[2], w[1].only_if(at_second)),
            w[2].only_if(at_second),
        ]
    }
}

/// Lanes without a particle wait for nothing.
#[inline(always)]
fn waiting(start: &[i32; LANES], occupied: usize, lanes: core::ops::Range<usize>) -> [i32; LANES] {
    let mut out = *start;
    for l in 0..LANES {
        out[l] = if l < occupied && lanes.contains(&l) { out[l] } else { NOWHERE };
    }
    out
}

#[inline(always)]
fn sum_3<T: Real>(a: [T; 3], b: [T; 3]) -> T {
    a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0]))
}

#[inline(always)]
fn sum_4<T: Real>(a: [T; 4], b: [T; 4]) -> T {
    a[3].mul_add(b[3], a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0])))
}

/// `w_1 g_1 + 2 w_2 g_2`
#[inline(always)]
fn moment<T: Real>(w: [T; 3], g: [T; 3]) -> T {
    (w[2] + w[2]).mul_add(g[2], w[1] * g[1])
}

/// Calls a kernel for as many lanes at a time as a vector of 512 bits holds: runs are then no longer than they have to be.
macro_rules! for_parts {
    ($t:ty, $kernel:ident $(<$($all:tt),+>)? ($($argument:expr),*)) => {
        if size_of::<$t>() == 4 {
            $kernel::<$t, 0, 16 $(, $($all),+)?>($($argument),*);
        } else {
            $kernel::<$t, 0, 8 $(, $($all),+)?>($($argument),*);
            $kernel::<$t, 8, 16 $(, $($all),+)?>($($argument),*);
        }
    };
}

/// What a group takes of the nodes in a substep; what was not asked for is 0.
pub(crate) struct Taken<T> {
    /// Of the nodes' velocities, without gradient.
    pub(crate) velocity: Gathered<T>,
    /// `sum w g` of the nodes' fourth number.
    pub(crate) density: Lanes<T>,
    /// `sum w g` of the nodes' velocities without forces.
    pub(crate) unforced: [Lanes<T>; 3],
}

/// All that a group takes in a substep, in one go: runs and their weights are found once for all of it.
#[inline(always)]
pub(crate) fn gather_all<T: Real>(
    tile: &Tile<T>,
    unforced: Option<&Tile<T>>,
    with_density: bool,
    places: &StencilPositions<T>,
    w: &Weights<T>,
    occupied: usize,
) -> Taken<T> {
    let zero = Lanes::ZERO;
    let mut out = Taken { velocity: Gathered::ZERO, density: zero, unforced: [zero; 3] };
    match (with_density, unforced) {
        (true, Some(other)) => {
            for_parts!(T, take < true, true > (tile, other, places, w, occupied, &mut out))
        }
        (true, None) => for_parts!(T, take < true, false > (tile, tile, places, w, occupied, &mut out)),
        (false, Some(other)) => {
            for_parts!(T, take < false, true > (tile, other, places, w, occupied, &mut out))
        }
        (false, None) => for_parts!(T, take < false, false > (tile, tile, places, w, occupied, &mut out)),
    }
    out
}

#[inline(always)]
fn take<T: Real, const FROM: usize, const TO: usize, const DENSITY: bool, const UNFORCED: bool>(
    tile: &Tile<T>,
    other: &Tile<T>,
    places: &StencilPositions<T>,
    w: &Weights<T>,
    occupied: usize,
    out: &mut Taken<T>,
) {
    let mut waiting = waiting(&places.start, occupied, FROM..TO);
    while let Some(run) = Run::next(&mut waiting) {
        let nodes: &[[T; 4]; REACH] = tile[run.start..].first_chunk().expect("stencils lie in the tile");
        let other: &[[T; 4]; REACH] = other[run.start..].first_chunk().expect("stencils lie in the tile");
        let (mut sum, mut first) = (out.velocity.sum, out.velocity.first);
        let (mut density, mut unforced) = (out.density, out.unforced);
        for l in FROM..TO {
            let (wx, wy) = (three!(n => w[0][n][l]), three!(n => w[1][n][l]));
            let wz = run.along_row(l, three!(n => w[2][n][l]));
            let wz_k = [wz[1], wz[2] + wz[2], T::from_f64(3.0) * wz[3]];
            let place = |i: usize, j: usize, k: usize| (i * TILE_EDGE + j) * TILE_EDGE + k;
            let layer = |i: usize| {
                let row = |j: usize| {
                    let g = |k: usize, c: usize| nodes[place(i, j, k)][c];
                    let sum = three!(c => sum_4(wz, [g(0, c), g(1, c), g(2, c), g(3, c)]));
                    (sum, three!(c => sum_3(wz_k, [g(1, c), g(2, c), g(3, c)])))
                };
                let ((r0, k0), (r1, k1), (r2, k2)) = (row(0), row(1), row(2));
                let sum = three!(c => sum_3(wy, [r0[c], r1[c], r2[c]]));
                let by_j = three!(c => moment(wy, [r0[c], r1[c], r2[c]]));
                (sum, by_j, three!(c => sum_3(wy, [k0[c], k1[c], k2[c]])))
            };
            let ((s0, j0, k0), (s1, j1, k1), (s2, j2, k2)) = (layer(0), layer(1), layer(2));
            let up = run.z_offset::<T>(l);
            for c in 0..3 {
                let all = sum_3(wx, [s0[c], s1[c], s2[c]]);
                sum[c][l] += all;
                first[3 * c][l] += moment(wx, [s0[c], s1[c], s2[c]]);
                first[3 * c + 1][l] += sum_3(wx, [j0[c], j1[c], j2[c]]);
                first[3 * c + 2][l] += sum_3(wx, [k0[c], k1[c], k2[c]]) - up * all;
            }
            let alone = |nodes: &[[T; 4]; REACH], c: usize| {
                let g = |i: usize, j: usize, k: usize| nodes[place(i, j, k)][c];
                let row = |i: usize, j: usize| sum_4(wz, [g(i, j, 0), g(i, j, 1), g(i, j, 2), g(i, j, 3)]);
                sum_3(wx, three!(i => sum_3(wy, three!(j => row(i, j)))))
            };
            if DENSITY {
                density[l] += alone(nodes, 3);
            }
            if UNFORCED {
                for c in 0..3 {
                    unforced[c][l] += alone(other, c);
                }
            }
        }
        out.velocity.sum = sum;
        out.velocity.first = first;
        (out.density, out.unforced) = (density, unforced);
    }
}

/// `sum w g` alone.
#[inline(always)]
pub(crate) fn gather_sum<T: Real>(
    tile: &Tile<T>,
    places: &StencilPositions<T>,
    w: &Weights<T>,
    occupied: usize,
) -> [Lanes<T>; 3] {
    let mut out = [Lanes::ZERO; 3];
    for_parts!(T, sums(tile, places, w, occupied, &mut out));
    out
}

#[inline(always)]
fn sums<T: Real, const FROM: usize, const TO: usize>(
    tile: &Tile<T>,
    places: &StencilPositions<T>,
    w: &Weights<T>,
    occupied: usize,
    out: &mut [Lanes<T>; 3],
) {
    let mut waiting = waiting(&places.start, occupied, FROM..TO);
    while let Some(run) = Run::next(&mut waiting) {
        let nodes: &[[T; 4]; REACH] = tile[run.start..].first_chunk().expect("stencils lie in the tile");
        let mut sum = *out;
        for l in FROM..TO {
            let (wx, wy) = (three!(n => w[0][n][l]), three!(n => w[1][n][l]));
            let wz = run.along_row(l, three!(n => w[2][n][l]));
            for c in 0..3 {
                let g = |i: usize, j: usize, k: usize| nodes[(i * TILE_EDGE + j) * TILE_EDGE + k][c];
                let row = |i: usize, j: usize| sum_4(wz, [g(i, j, 0), g(i, j, 1), g(i, j, 2), g(i, j, 3)]);
                sum[c][l] += sum_3(wx, three!(i => sum_3(wy, three!(j => row(i, j)))));
            }
        }
        *out = sum;
    }
}

/// Sum and, with `MOMENTS`, first moments of the nodes' fourth number.
#[inline(always)]
pub(crate) fn gather_fourth<T: Real, const MOMENTS: bool>(
    tile: &Tile<T>,
    places: &StencilPositions<T>,
    w: &Weights<T>,
    occupied: usize,
) -> GatheredFourth<T> {
    let mut out = GatheredFourth { sum: Lanes::ZERO, first: [Lanes::ZERO; 3] };
    for_parts!(T, fourth_moments<MOMENTS>(tile, places, w, occupied, &mut out));
    out
}

#[inline(always)]
fn fourth_moments<T: Real, const FROM: usize, const TO: usize, const MOMENTS: bool>(
    tile: &Tile<T>,
    places: &StencilPositions<T>,
    w: &Weights<T>,
    occupied: usize,
    out: &mut GatheredFourth<T>,
) {
    let mut waiting = waiting(&places.start, occupied, FROM..TO);
    while let Some(run) = Run::next(&mut waiting) {
        let nodes: &[[T; 4]; REACH] = tile[run.start..].first_chunk().expect("stencils lie in the tile");
        let (mut sum, mut first) = (out.sum, out.first);
        for l in FROM..TO {
            let (wx, wy) = (three!(n => w[0][n][l]), three!(n => w[1][n][l]));
            let wz = run.along_row(l, three!(n => w[2][n][l]));
            let g = |i: usize, j: usize, k: usize| nodes[(i * TILE_EDGE + j) * TILE_EDGE + k][3];
            let rows = three!(i => three!(j => sum_4(wz, [g(i, j, 0), g(i, j, 1), g(i, j, 2), g(i, j, 3)])));
            let layers = three!(i => sum_3(wy, rows[i]));
            let all = sum_3(wx, layers);
            sum[l] += all;
            if MOMENTS {
                let wz_k = [wz[1], wz[2] + wz[2], T::from_f64(3.0) * wz[3]];
                let along =
                    three!(i => sum_3(wy, three!(j => sum_3(wz_k, [g(i, j, 1), g(i, j, 2), g(i, j, 3)]))));
                first[0][l] += moment(wx, layers);
                first[1][l] += sum_3(wx, three!(i => moment(wy, rows[i])));
                first[2][l] += sum_3(wx, along) - run.z_offset::<T>(l) * all;
            }
        }
        *out = GatheredFourth { sum, first };
    }
}

/// [`gather`], and `sum (dw/dX) (g.P)`; the nodes' fourth number meets each particle's `mass`.
#[inline(always)]
pub(crate) fn gather_with_gradient<T: Real>(
    tile: &Tile<T>,
    places: &StencilPositions<T>,
    w: &Weights<T>,
    sent: &Sent<T>,
    mass: &Lanes<T>,
    occupied: usize,
    rows: &mut Rows<T>,
) -> Gathered<T> {
    let (slopes, mut out) = (places.slopes(), Gathered::ZERO);
    let fourth = Fourth { base: *mass, steps: [Lanes::ZERO; 3] };
    for_parts!(T, of_runs<MASS>(tile, places, w, &slopes, sent, &fourth, occupied, &mut rows.0, &mut out));
    out
}

/// `sum w g` and `sum (dw/dX) (g.P)` alone, with nodes of three numbers.
#[inline(always)]
pub(crate) fn gather_gradient<T: Real>(
    tile: &Tile<T>,
    places: &StencilPositions<T>,
    w: &Weights<T>,
    sent: &Sent<T>,
    occupied: usize,
    rows: &mut Rows<T>,
) -> Gathered<T> {
    let (slopes, mut out) = (places.slopes(), Gathered::ZERO);
    let fourth = Fourth::ZERO;
    for_parts!(T, of_runs<NONE>(tile, places, w, &slopes, sent, &fourth, occupied, &mut rows.0, &mut out));
    out
}

/// The same with nodes of four numbers.
#[inline(always)]
pub(crate) fn gather_gradient_of_four<T: Real>(
    tile: &Tile<T>,
    places: &StencilPositions<T>,
    w: &Weights<T>,
    sent: &Sent<T>,
    fourth: &Fourth<T>,
    occupied: usize,
    rows: &mut Rows<T>,
) -> Gathered<T> {
    let (slopes, mut out) = (places.slopes(), Gathered::ZERO);
    for_parts!(T, of_runs<AFFINE>(tile, places, w, &slopes, sent, fourth, occupied, &mut rows.0, &mut out));
    out
}

/// What the nodes' fourth number meets in [`of_runs`]: nothing; one number, and moments are asked for; an affine function.
const NONE: u8 = 0;
const MASS: u8 = 1;
const AFFINE: u8 = 2;

/// What the weights along z make of a row's nodes: `sum w g`, `sum w g k`, `sum w g.P` and `sum dw/dz g.P`.
#[derive(Clone, Copy)]
struct Row<T> {
    sum: [Lanes<T>; 3],
    by_k: [Lanes<T>; 3],
    product: Lanes<T>,
    slope: Lanes<T>,
}

impl<T: Real> Row<T> {
    const ZERO: Self =
        Self { sum: [Lanes::ZERO; 3], by_k: [Lanes::ZERO; 3], product: Lanes::ZERO, slope: Lanes::ZERO };
}

/// Room for the nine rows of a run: made once, since clearing it for each run takes a tenth of the time of all.
pub(crate) struct Rows<T>([Row<T>; 9]);

impl<T: Real> Rows<T> {
    #[inline(always)]
    pub(crate) fn new() -> Self {
        Self([Row::ZERO; 9])
    }
}

/// Weights along the rows of a run, their derivatives, and `p` at the rows' first nodes.
struct Along<T> {
    w: [Lanes<T>; ROW],
    w_k: [Lanes<T>; ROW - 1],
    slopes: [Lanes<T>; ROW],
    base: [Lanes<T>; 3],
    up: Lanes<T>,
}

/// The rows first, in a loop of its own, since all 27 nodes at once take more registers than there are. `WITH` is what the
/// fourth number meets.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "inlined parts of one function")]
fn of_runs<T: Real, const FROM: usize, const TO: usize, const WITH: u8>(
    tile: &Tile<T>,
    places: &StencilPositions<T>,
    w: &Weights<T>,
    slopes: &Weights<T>,
    sent: &Sent<T>,
    fourth: &Fourth<T>,
    occupied: usize,
    rows: &mut [Row<T>; 9],
    out: &mut Gathered<T>,
) {
    let mut waiting = waiting(&places.start, occupied, FROM..TO);
    while let Some(run) = Run::next(&mut waiting) {
        let nodes: &[[T; 4]; REACH] = tile[run.start..].first_chunk().expect("stencils lie in the tile");
        let along = along_rows::<T, FROM, TO>(&run, &w[2], &slopes[2], sent);
        for (n, row) in rows.iter_mut().enumerate() {
            let (i, j) = (n / 3, n % 3);
            let nodes: &[[T; 4]; ROW] =
                nodes[(i * TILE_EDGE + j) * TILE_EDGE..].first_chunk().expect("nine rows");
            let [i, j] = [i, j].map(|n| T::from_f64(n as f64));
            *row = of_row::<T, FROM, TO, WITH>(nodes, &along, sent, fourth, [i, j]);
        }
        add_rows::<T, FROM, TO, WITH>(rows, [&w[0], &w[1]], [&slopes[0], &slopes[1]], &along.up, out);
    }
}

#[inline(always)]
fn along_rows<T: Real, const FROM: usize, const TO: usize>(
    run: &Run,
    w: &[Lanes<T>; 3],
    slopes: &[Lanes<T>; 3],
    sent: &Sent<T>,
) -> Along<T> {
    let zero = Lanes::ZERO;
    let mut out = Along { w: [zero; 4], w_k: [zero; 3], slopes: [zero; 4], base: sent.base, up: zero };
    for l in FROM..TO {
        let w = run.along_row(l, three!(n => w[n][l]));
        let slopes = run.along_row(l, three!(n => slopes[n][l]));
        for k in 0..ROW {
            out.w[k][l] = w[k];
            out.slopes[k][l] = slopes[k];
        }
        out.w_k[0][l] = w[1];
        out.w_k[1][l] = w[2] + w[2];
        out.w_k[2][l] = T::from_f64(3.0) * w[3];
        let up = run.z_offset::<T>(l);
        for c in 0..3 {
            out.base[c][l] = sent.base[c][l] - up * sent.a_dx[3 * c + 2][l];
        }
        out.up[l] = up;
    }
    out
}

#[inline(always)]
fn of_row<T: Real, const FROM: usize, const TO: usize, const WITH: u8>(
    nodes: &[[T; 4]; ROW],
    along: &Along<T>,
    sent: &Sent<T>,
    fourth: &Fourth<T>,
    [i, j]: [T; 2],
) -> Row<T> {
    // A copy on the stack cannot alias what is written.
    let nodes = *nodes;
    let Row { mut sum, mut by_k, mut product, mut slope } = Row::ZERO;
    for l in FROM..TO {
        let w = [along.w[0][l], along.w[1][l], along.w[2][l], along.w[3][l]];
        let slopes = [along.slopes[0][l], along.slopes[1][l], along.slopes[2][l], along.slopes[3][l]];
        let step = three!(c => sent.a_dx[3 * c + 2][l]);
        let p0 =
            three!(c => i.mul_add(sent.a_dx[3 * c][l], j.mul_add(sent.a_dx[3 * c + 1][l], along.base[c][l])));
        let p1 = three!(c => p0[c] + step[c]);
        let p2 = three!(c => p1[c] + step[c]);
        let p3 = three!(c => p2[c] + step[c]);
        let along_i = i.mul_add(fourth.steps[0][l], j.mul_add(fourth.steps[1][l], fourth.base[l]));
        let times = |k: usize, p: [T; 3]| {
            let product = sum_3(p, [nodes[k][0], nodes[k][1], nodes[k][2]]);
            match WITH {
                MASS => fourth.base[l].mul_add(nodes[k][3], product),
                AFFINE => {
                    let k_of_own = T::from_f64(k as f64) - along.up[l];
                    k_of_own.mul_add(fourth.steps[2][l], along_i).mul_add(nodes[k][3], product)
                }
                _ => product,
            }
        };
        let products = [times(0, p0), times(1, p1), times(2, p2), times(3, p3)];
        product[l] = sum_4(w, products);
        slope[l] = sum_4(slopes, products);
        for c in 0..3 {
            sum[c][l] = sum_4(w, [nodes[0][c], nodes[1][c], nodes[2][c], nodes[3][c]]);
        }
        if WITH == MASS {
            let w_k = three!(n => along.w_k[n][l]);
            for c in 0..3 {
                by_k[c][l] = sum_3(w_k, [nodes[1][c], nodes[2][c], nodes[3][c]]);
            }
        }
    }
    Row { sum, by_k, product, slope }
}

/// The weights along x and y.
#[inline(always)]
fn add_rows<T: Real, const FROM: usize, const TO: usize, const WITH: u8>(
    rows: &[Row<T>; 9],
    w: [&[Lanes<T>; 3]; 2],
    slopes: [&[Lanes<T>; 3]; 2],
    up: &Lanes<T>,
    out: &mut Gathered<T>,
) {
    let Gathered { mut sum, mut first, mut gradient } = *out;
    for l in FROM..TO {
        let [wx, wy] = [three!(n => w[0][n][l]), three!(n => w[1][n][l])];
        let [dx, dy] = [three!(n => slopes[0][n][l]), three!(n => slopes[1][n][l])];
        let products = three!(i => three!(j => rows[3 * i + j].product[l]));
        let products_y = three!(i => sum_3(wy, products[i]));
        gradient[0][l] += sum_3(dx, products_y);
        gradient[1][l] += sum_3(wx, three!(i => sum_3(dy, products[i])));
        gradient[2][l] += sum_3(wx, three!(i => sum_3(wy, three!(j => rows[3 * i + j].slope[l]))));
        for c in 0..3 {
            let rows_c = three!(i => three!(j => rows[3 * i + j].sum[c][l]));
            let layers = three!(i => sum_3(wy, rows_c[i]));
            let all = sum_3(wx, layers);
            sum[c][l] += all;
            if WITH == MASS {
                first[3 * c][l] += moment(wx, layers);
                first[3 * c + 1][l] += sum_3(wx, three!(i => moment(wy, rows_c[i])));
                let by_k = three!(i => sum_3(wy, three!(j => rows[3 * i + j].by_k[c][l])));
                first[3 * c + 2][l] += sum_3(wx, by_k) - up[l] * all;
            }
        }
    }
    *out = Gathered { sum, first, gradient };
}
