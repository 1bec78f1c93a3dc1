//! The return map by eigendecomposition, for any strain. [`super::material`] has a faster one for small shear, which covers
//! nearly all particles.
//!
//! | symbol | identifier | meaning |
//! |---|---|---|
//! | `w_i`, `U` | `w`, `u` | eigenvalues and eigenvectors of `E_tr` |
//! | `eps_i` | `eps` | Hencky strains `ln(1 + w_i)/2 + q/3` |
//! | `d` | `d` | direction of the deviator of `eps` |
//!
//! The other symbols are those of [`super::material`]; `E' = U diag(exp(2 eps'_i) - 1) U^T`. The adjoint has no
//! `1/(s_i^2 - s_j^2)` singularity when written with `expm1`.

use crate::mpm::material::{LODE_FACTOR, Material, ReturnBar, lode};
use crate::real::Real;
use crate::small::{Mat3, Sym3, Vec3, compose, full, mul, three, transpose};

/// One Jacobi rotation that annihilates entry `(p, q)` of the symmetric matrix `a`; `u` collects the rotations.
#[inline(always)]
fn rotate<T: Real>(a: &mut Mat3<T>, u: &mut Mat3<T>, p: usize, q: usize) {
    let r = 3 - p - q;
    let d = a[q][q] - a[p][p];
    let twice = a[p][q] + a[p][q];
    let root = (d * d + twice * twice).sqrt();
    let denominator = d.abs() + root;
    let signed = if d < T::ZERO { -twice } else { twice };
    let t = if denominator > T::ZERO { signed / denominator } else { T::ZERO };
    let c = T::ONE / (T::ONE + t * t).sqrt();
    let s = t * c;
    let shift = t * a[p][q];
    a[p][p] -= shift;
    a[q][q] += shift;
    a[p][q] = T::ZERO;
    a[q][p] = T::ZERO;
    let (arp, arq) = (a[r][p], a[r][q]);
    a[r][p] = c * arp - s * arq;
    a[r][q] = s * arp + c * arq;
    a[p][r] = a[r][p];
    a[q][r] = a[r][q];
    for row in u {
        let (x, y) = (row[p], row[q]);
        row[p] = c * x - s * y;
        row[q] = s * x + c * y;
    }
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix by four sweeps of cyclic Jacobi: what is left off the
/// diagonal is then below 1e-19 of the norm (measured over random matrices; the convergence is cubic).
///
/// Unrolled by hand: a loop here would keep the loop over lanes around it from vectorising.
#[inline(always)]
pub(crate) fn eigen<T: Real>(strain: Sym3<T>) -> (Vec3<T>, Mat3<T>) {
    let mut a = full(strain);
    let mut u = [[T::ONE, T::ZERO, T::ZERO], [T::ZERO, T::ONE, T::ZERO], [T::ZERO, T::ZERO, T::ONE]];
    sweep(&mut a, &mut u);
    sweep(&mut a, &mut u);
    sweep(&mut a, &mut u);
    sweep(&mut a, &mut u);
    ([a[0][0], a[1][1], a[2][2]], u)
}

#[inline(always)]
fn sweep<T: Real>(a: &mut Mat3<T>, u: &mut Mat3<T>) {
    rotate(a, u, 0, 1);
    rotate(a, u, 0, 2);
    rotate(a, u, 1, 2);
}

/// Everything about one return that its adjoint needs as well.
struct Principal<T> {
    w: Vec3<T>,
    u: Mat3<T>,
    eps: Vec3<T>,
    /// Hencky strains after the return.
    eps_new: Vec3<T>,
    /// Unit deviator.
    d: Vec3<T>,
    t: T,
    keep: T,
    lode: T,
    /// `Y` and its derivative.
    narrowing: (T, T),
    /// `S` and its derivative.
    bond: (T, T),
    /// Derivatives of [`Material::strength`].
    strength: [T; 2],
    parted: bool,
    elastic: bool,
}

#[inline(always)]
fn principal<T: Real>(m: &Material<T>, trial: Sym3<T>, [q, shear]: [T; 2]) -> Principal<T> {
    let third = T::from_f64(1.0 / 3.0);
    let (w, u) = eigen(trial);
    let half = T::from_f64(0.5);
    let eps =
        [half * w[0].ln_1p() + third * q, half * w[1].ln_1p() + third * q, half * w[2].ln_1p() + third * q];
    let t = eps[0] + eps[1] + eps[2];
    let mean = third * t;
    let e = [eps[0] - mean, eps[1] - mean, eps[2] - mean];
    let n = (e[0] * e[0] + e[1] * e[1] + e[2] * e[2]).sqrt();
    // A deviator below this length has no direction worth the name; on the cone it is longer.
    let inverse = T::ONE / n.at_least(T::from_f64(1e-30));
    let d = [e[0] * inverse, e[1] * inverse, e[2] * inverse];
    let lode = lode(e[0] * e[1] * e[2], inverse);
    let narrowing = m.narrowing(lode);
    let bond = m.bond(q);
    let (apex, cut) = (bond.0 * m.apex, bond.0 * m.cut);
    let parted = t >= cut;
    let trace = if parted { cut } else { t };
    let (strength, slopes) = m.strength(apex - trace, shear);
    let room = m.slope * strength / narrowing.0;
    let elastic = n <= room;
    let keep = if elastic { T::ONE } else { room * inverse };
    let mean = third * trace;
    let eps_new = [mean + keep * e[0], mean + keep * e[1], mean + keep * e[2]];
    let strength = slopes;
    Principal { w, u, eps, eps_new, d, t, keep, lode, narrowing, bond, strength, parted, elastic }
}

/// Kirchhoff stress (Pa), strain and volume correction after the return to the yield surface. What comes `beside` the trial strain
/// are volume correction and shear.
#[inline(always)]
pub(crate) fn return_map<T: Real>(m: &Material<T>, trial: Sym3<T>, beside: [T; 2]) -> (Sym3<T>, Sym3<T>, T) {
    let p = principal(m, trial, beside);
    let pressure = m.lambda * (p.eps_new[0] + p.eps_new[1] + p.eps_new[2]);
    let two_mu = m.mu + m.mu;
    let tau = three!(i => two_mu * p.eps_new[i] + pressure);
    let grown = three!(i => (p.eps_new[i] + p.eps_new[i]).exp_m1());
    (compose(&p.u, tau), compose(&p.u, grown), (p.t - p.bond.0 * m.cut).only_if(p.parted))
}

/// Cotangents of [`return_map`]: of the trial strain, and of volume correction and shear.
#[inline(always)]
pub(crate) fn return_map_adjoint<T: Real>(
    m: &Material<T>,
    trial: Sym3<T>,
    beside: [T; 2],
    bar: &ReturnBar<T>,
) -> (Sym3<T>, [T; 2]) {
    let ReturnBar { tau: tau_bar, strain: strain_bar, q: q_bar, volume: volume_bar } = *bar;
    let third = T::from_f64(1.0 / 3.0);
    let two = T::from_f64(2.0);
    let p = principal(m, trial, beside);
    let ut = transpose(&p.u);
    let tb = mul(&mul(&ut, &full(tau_bar)), &p.u);
    let bb = mul(&mul(&ut, &full(strain_bar)), &p.u);
    let stretch = three!(i => T::ONE + (two * p.eps_new[i]).exp_m1());

    // Diagonal: from eps' back through the return to eps.
    let trace = m.lambda * (tb[0][0] + tb[1][1] + tb[2][2]);
    let new_bar = three!(i => two * m.mu * tb[i][i] + trace + two * stretch[i] * bb[i][i]);
    let mean = third * (new_bar[0] + new_bar[1] + new_bar[2]);
    let along = p.d[0] * new_bar[0] + p.d[1] * new_bar[1] + p.d[2] * new_bar[2];
    let (narrowing, narrowing_slope) = p.narrowing;
    // dl/deps is -3 sqrt(6) dev(cof d)/n - 3 l d/n, with cof d = (d_1 d_2, d_0 d_2, d_0 d_1) whose trace is -1/2.
    let turning = -(p.keep * along * narrowing_slope / narrowing);
    let sixth = T::from_f64(1.0 / 6.0);
    let room_bar = (m.slope * along / narrowing).only_if(!p.elastic);
    let [room_bar, shear_bar] = [p.strength[0] * room_bar, p.strength[1] * room_bar];
    let trace_bar = mean - room_bar;
    let t_bar = volume_bar + if p.parted { q_bar } else { trace_bar };
    let eps_bar = three!(i => {
        let cofactor = p.d[(i + 1) % 3] * p.d[(i + 2) % 3] + sixth;
        let turned = turning * (T::from_f64(LODE_FACTOR) * cofactor - T::from_f64(3.0) * p.lode * p.d[i]);
        let dev = new_bar[i] - mean;
        let on_cone = p.keep * (dev - p.d[i] * along) + turned;
        t_bar + if p.elastic { dev } else { on_cone }
    });
    // What bonds are left: of the apex, and of the cut-off where that is met.
    let q_in_bar = p.bond.1 * (m.apex * room_bar + m.cut * (trace_bar - q_bar).only_if(p.parted));
    let s2 = three!(i => T::ONE + p.w[i]);
    let diagonal = three!(i => eps_bar[i] / (two * s2[i]));

    // Off the diagonal: how the eigenvectors turn. Divided differences through expm1 stay exact at w_i = w_j.
    let off = |i: usize, j: usize| {
        let d = two * (p.eps[i] - p.eps[j]);
        let numerator = m.mu * p.keep * tb[i][j] + stretch[j] * p.keep * psi(p.keep * d) * bb[i][j];
        numerator / (s2[j] * psi(d))
    };
    let (g01, g02, g12) = (off(0, 1), off(0, 2), off(1, 2));
    let g = [[diagonal[0], g01, g02], [g01, diagonal[1], g12], [g02, g12, diagonal[2]]];
    let out = mul(&mul(&p.u, &g), &ut);
    let q_in = third * (eps_bar[0] + eps_bar[1] + eps_bar[2]) + q_in_bar;
    ([out[0][0], out[1][1], out[2][2], out[0][1], out[0][2], out[1][2]], [q_in, shear_bar])
}

/// `expm1(x)/x`, 1 at 0.
#[inline(always)]
fn psi<T: Real>(x: T) -> T {
    let safe = if x == T::ZERO { T::ONE } else { x };
    let y = safe.exp_m1() / safe;
    if x == T::ZERO { T::ONE } else { y }
}
