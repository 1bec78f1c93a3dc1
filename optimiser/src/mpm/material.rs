//! Powder as a material: St. Venant-Kirchhoff-Hencky elasticity with a Drucker-Prager yield cone, volume
//! correction and cohesion, on the elastic left Cauchy-Green strain `E = b^e - I`.
//!
//! | symbol | identifier | meaning |
//! |---|---|---|
//! | `E`, `E_tr`, `E'` | `strain` | `b^e - I`: at the start, trial, after the return (symmetric, dimensionless) |
//! | `L` | `l` | `dt C`, displacement gradient of one substep |
//! | `q`, `q'` | `q` | volume correction (Tampubolon et al. 2017, section 4.3.4) |
//! | `w_i`, `U` | `w`, `u` | eigenvalues and eigenvectors of `E_tr` |
//! | `eps_i` | `eps` | Hencky strains `ln(1 + w_i)/2 + q/3` |
//! | `t`, `d`, `n` | `t`, `d`, `n` | trace, direction and length of the deviator of `eps` |
//! | `c` | `slope` | cone slope in strain space, `alpha (3 lambda + 2 mu)/(2 mu)` |
//! | `t_c` | `tip` | trace at the cone's tip: 0 without cohesion |
//! | `k` | `keep` | part of the deviator that is kept: 1 elastic, `c (t_c - t)/n` on the cone, 0 at the tip |
//! | `tau` | `tau` | Kirchhoff stress `U diag(2 mu eps' + lambda tr eps') U^T`, Pa |
//!
//! Drucker-Prager as in Klar et al. 2016, "Drucker-Prager elastoplasticity for sand animation". Isotropy lets
//! `b^e = F F^T` stand for `F`: the singular value decomposition of the paper becomes a symmetric
//! eigenproblem, whose adjoint has no `1/(s_i^2 - s_j^2)` singularity when written with `expm1`.
//! A symmetric cotangent holds the entries of the full matrix: `dL = sum_ij bar_ij dE_ij` over all nine `ij`.

use crate::real::Real;
use crate::small::{Mat3, Sym3, Vec3, compose, full, mul, three, tr_mul_vec, transpose};

/// Constants of the return map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Material<T> {
    /// First Lame parameter, Pa.
    pub(crate) lambda: T,
    /// Shear modulus, Pa.
    pub(crate) mu: T,
    /// Cone slope `c`.
    pub(crate) slope: T,
    /// Trace of the Hencky strain at the cone's tip.
    pub(crate) tip: T,
}

impl<T: Real> Material<T> {
    /// From Young's modulus (Pa), Poisson's ratio, friction angle (rad) and cohesion (Pa).
    ///
    /// The cone is the one through the triaxial compression corners of Mohr-Coulomb,
    /// `alpha = sqrt(2/3) 2 sin(phi)/(3 - sin(phi))`; its tip carries the tension `cohesion cot(phi)`.
    pub(crate) fn new(youngs_modulus: f64, poissons_ratio: f64, friction_angle: f64, cohesion: f64) -> Self {
        let lambda =
            youngs_modulus * poissons_ratio / ((1.0 + poissons_ratio) * (1.0 - 2.0 * poissons_ratio));
        let mu = youngs_modulus / (2.0 * (1.0 + poissons_ratio));
        let sine = libm::sin(friction_angle);
        let alpha = (2.0f64 / 3.0).sqrt() * 2.0 * sine / (3.0 - sine);
        let bulk = lambda + 2.0 * mu / 3.0;
        let tension = if cohesion == 0.0 { 0.0 } else { cohesion / libm::tan(friction_angle) };
        Self {
            lambda: T::of(lambda),
            mu: T::of(mu),
            slope: T::of(alpha * 3.0 * bulk / (2.0 * mu)),
            tip: T::of(tension / bulk),
        }
    }
}

/// `E_tr = (I + L)(I + E)(I + L)^T - I`, written so that small strains keep their digits.
#[inline(always)]
pub(crate) fn trial_strain<T: Real>(strain: Sym3<T>, l: &Mat3<T>) -> Sym3<T> {
    let m = l_times_b(strain, l);
    let entry =
        |i: usize, j: usize| m[i][j] + m[j][i] + (m[i][0] * l[j][0] + m[i][1] * l[j][1] + m[i][2] * l[j][2]);
    [
        strain[0] + entry(0, 0),
        strain[1] + entry(1, 1),
        strain[2] + entry(2, 2),
        strain[3] + entry(0, 1),
        strain[4] + entry(0, 2),
        strain[5] + entry(1, 2),
    ]
}

/// Cotangents of [`trial_strain`]: of `E` and of `L`.
#[inline(always)]
pub(crate) fn trial_strain_adjoint<T: Real>(
    strain: Sym3<T>,
    l: &Mat3<T>,
    bar: Sym3<T>,
) -> (Sym3<T>, Mat3<T>) {
    let g = full(bar);
    let mut f = *l;
    let mut fb = l_times_b(strain, l); // L (I + E), completed to (I + L)(I + E)
    let b = full(strain);
    for i in 0..3 {
        f[i][i] += T::ONE;
        for j in 0..3 {
            fb[i][j] += b[i][j];
        }
        fb[i][i] += T::ONE;
    }
    let gf = mul(&g, &f);
    let column = |i: usize| tr_mul_vec(&f, [gf[0][i], gf[1][i], gf[2][i]]);
    let (c0, c1, c2) = (column(0), column(1), column(2));
    let mut l_bar = mul(&g, &fb);
    for row in &mut l_bar {
        for x in row {
            *x += *x;
        }
    }
    ([c0[0], c1[1], c2[2], c1[0], c2[0], c2[1]], l_bar)
}

/// `L (I + E)`
#[inline(always)]
fn l_times_b<T: Real>(strain: Sym3<T>, l: &Mat3<T>) -> Mat3<T> {
    let mut m = mul(l, &full(strain));
    for i in 0..3 {
        for j in 0..3 {
            m[i][j] += l[i][j];
        }
    }
    m
}

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
    at_tip: bool,
    elastic: bool,
}

#[inline(always)]
fn principal<T: Real>(m: &Material<T>, trial: Sym3<T>, q: T) -> Principal<T> {
    let third = T::of(1.0 / 3.0);
    let (w, u) = eigen(trial);
    let half = T::of(0.5);
    let eps =
        [half * w[0].ln_1p() + third * q, half * w[1].ln_1p() + third * q, half * w[2].ln_1p() + third * q];
    let t = eps[0] + eps[1] + eps[2];
    let mean = third * t;
    let e = [eps[0] - mean, eps[1] - mean, eps[2] - mean];
    let n = (e[0] * e[0] + e[1] * e[1] + e[2] * e[2]).sqrt();
    // A deviator below this length has no direction worth the name; on the cone it is longer.
    let inverse = T::ONE / n.at_least(T::of(1e-30));
    let d = [e[0] * inverse, e[1] * inverse, e[2] * inverse];
    let room = m.slope * (m.tip - t);
    let at_tip = t >= m.tip;
    let elastic = n <= room;
    let keep = if elastic { T::ONE } else { room * inverse };
    let keep = if at_tip { T::ZERO } else { keep };
    let mean = if at_tip { third * m.tip } else { mean };
    let eps_new = [mean + keep * e[0], mean + keep * e[1], mean + keep * e[2]];
    Principal { w, u, eps, eps_new, d, t, keep, at_tip, elastic: elastic && !at_tip }
}

/// Kirchhoff stress (Pa), strain and volume correction after the return to the yield surface.
#[inline(always)]
pub(crate) fn return_map<T: Real>(m: &Material<T>, trial: Sym3<T>, q: T) -> (Sym3<T>, Sym3<T>, T) {
    let p = principal(m, trial, q);
    let pressure = m.lambda * (p.eps_new[0] + p.eps_new[1] + p.eps_new[2]);
    let two_mu = m.mu + m.mu;
    let tau = three!(i => two_mu * p.eps_new[i] + pressure);
    let grown = three!(i => (p.eps_new[i] + p.eps_new[i]).exp_m1());
    (compose(&p.u, tau), compose(&p.u, grown), (p.t - m.tip).only_if(p.at_tip))
}

/// Cotangents of [`return_map`]: of the trial strain and of `q`.
#[inline(always)]
pub(crate) fn return_map_adjoint<T: Real>(
    m: &Material<T>,
    trial: Sym3<T>,
    q: T,
    tau_bar: Sym3<T>,
    strain_bar: Sym3<T>,
    q_bar: T,
) -> (Sym3<T>, T) {
    let third = T::of(1.0 / 3.0);
    let two = T::of(2.0);
    let p = principal(m, trial, q);
    let ut = transpose(&p.u);
    let tb = mul(&mul(&ut, &full(tau_bar)), &p.u);
    let bb = mul(&mul(&ut, &full(strain_bar)), &p.u);
    let stretch = three!(i => T::ONE + (two * p.eps_new[i]).exp_m1());

    // Diagonal: from eps' back through the return to eps.
    let trace = m.lambda * (tb[0][0] + tb[1][1] + tb[2][2]);
    let new_bar = three!(i => two * m.mu * tb[i][i] + trace + two * stretch[i] * bb[i][i]);
    let mean = third * (new_bar[0] + new_bar[1] + new_bar[2]);
    let along = p.d[0] * new_bar[0] + p.d[1] * new_bar[1] + p.d[2] * new_bar[2];
    let eps_bar = three!(i => {
        let cone = mean + p.keep * (new_bar[i] - mean - p.d[i] * along) - m.slope * along;
        let returned = if p.elastic { new_bar[i] } else { cone };
        if p.at_tip { q_bar } else { returned }
    });
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
    let q_in = third * (eps_bar[0] + eps_bar[1] + eps_bar[2]);
    ([out[0][0], out[1][1], out[2][2], out[0][1], out[0][2], out[1][2]], q_in)
}

/// `expm1(x)/x`, 1 at 0.
#[inline(always)]
fn psi<T: Real>(x: T) -> T {
    let safe = if x == T::ZERO { T::ONE } else { x };
    let y = safe.exp_m1() / safe;
    if x == T::ZERO { T::ONE } else { y }
}
