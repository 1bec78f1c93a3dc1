//! Powder as a material: St. Venant-Kirchhoff-Hencky elasticity with a Drucker-Prager yield cone, volume
//! correction and cohesion, on the elastic left Cauchy-Green strain `E = b^e - I`.
//!
//! | symbol | identifier | meaning |
//! |---|---|---|
//! | `E`, `E_tr`, `E'` | `strain` | `b^e - I`: at the start, trial, after the return (symmetric, dimensionless) |
//! | `L` | `l` | `dt C`, displacement gradient of one substep |
//! | `q`, `q'` | `q` | volume correction (Tampubolon et al. 2017, section 4.3.4) |
//! | `a`, `B` | `a`, `b` | `tr E_tr/3`; deviator of `E_tr` divided by `1 + a` |
//! | `eps` | | Hencky strain `ln(I + E_tr)/2 + q/3 I = (ln(1 + a)/2 + q/3) I + ln(I + B)/2` |
//! | `t`, `e`, `n` | `t`, `e`, `n` | trace and deviator of `eps`; the deviator's norm |
//! | `c` | `slope` | cone slope in strain space, `alpha (3 lambda + 2 mu)/(2 mu)` |
//! | `t_c` | `apex` | trace at the cone's apex: 0 without cohesion |
//! | `k` | `keep` | part of the deviator that is kept: 1 elastic, `c (t_c - t)/n` on the cone, 0 at the apex |
//! | `eps'` | `mean`, `k e` | after the return: `min(t, t_c)/3 I + k e` |
//! | `tau` | `tau` | Kirchhoff stress `2 mu eps' + lambda tr(eps') I`, Pa |
//!
//! Drucker-Prager as in Klar et al. 2016, "Drucker-Prager elastoplasticity for sand animation". Isotropy lets
//! `b^e = F F^T` stand for `F`, and makes the return an affine map of `eps`: so nothing here needs the singular value
//! decomposition of the paper, nor eigenvectors. What is needed are a logarithm and an exponential of symmetric matrices,
//! `E' = exp(2 mean) exp(2 k e) - I`, and of traceless ones those are short series ([`super::matrix_polynomial`]) as long as the shear is
//! not large ([`is_mild`]); where it is, [`super::principal`] does the same by eigenvectors.
//! A symmetric cotangent holds the entries of the full matrix: `dL = sum_ij bar_ij dE_ij` over all nine `ij`.

use crate::mpm::matrix_polynomial::{CayleyHamilton, horner, horner_with_slopes};
use crate::real::Real;
use crate::small::{Mat3, Sym3, blend, full, inner, plus_diagonal, scale_sym, three, trace};

/// Constants of the return map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Material<T> {
    /// First Lame parameter, Pa.
    pub(crate) lambda: T,
    /// Shear modulus, Pa.
    pub(crate) mu: T,
    /// Cone slope `c`.
    pub(crate) slope: T,
    /// Trace of the Hencky strain at the cone's apex.
    pub(crate) apex: T,
}

impl<T: Real> Material<T> {
    /// From Young's modulus (Pa), Poisson's ratio, friction angle (rad) and cohesion (Pa).
    ///
    /// The cone is the one through the triaxial compression corners of Mohr-Coulomb,
    /// `alpha = sqrt(2/3) 2 sin(phi)/(3 - sin(phi))`; its apex carries the tension `cohesion cot(phi)`.
    pub(crate) fn new(youngs_modulus: f64, poissons_ratio: f64, friction_angle: f64, cohesion: f64) -> Self {
        let lambda =
            youngs_modulus * poissons_ratio / ((1.0 + poissons_ratio) * (1.0 - 2.0 * poissons_ratio));
        let mu = youngs_modulus / (2.0 * (1.0 + poissons_ratio));
        let sine = libm::sin(friction_angle);
        let alpha = (2.0f64 / 3.0).sqrt() * 2.0 * sine / (3.0 - sine);
        let bulk = lambda + 2.0 * mu / 3.0;
        let tension = if cohesion == 0.0 { 0.0 } else { cohesion / libm::tan(friction_angle) };
        Self {
            lambda: T::from_f64(lambda),
            mu: T::from_f64(mu),
            slope: T::from_f64(alpha * 3.0 * bulk / (2.0 * mu)),
            apex: T::from_f64(tension / bulk),
        }
    }
}

/// `E_tr = (I + L)(I + E)(I + L)^T - I`, written so that small strains keep their digits.
#[inline(always)]
pub(crate) fn trial_strain<T: Real>(strain: Sym3<T>, l: &Mat3<T>) -> Sym3<T> {
    let m = l_times_b(strain, l);
    let entry = |i: usize, j: usize| {
        m[i][0].mul_add(l[j][0], m[i][1].mul_add(l[j][1], m[i][2].mul_add(l[j][2], m[i][j] + m[j][i])))
    };
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
    let gf = product(&g, &f);
    // Of F^T G F.
    let entry = |i: usize, j: usize| f[0][i].mul_add(gf[0][j], f[1][i].mul_add(gf[1][j], f[2][i] * gf[2][j]));
    let mut l_bar = product(&g, &fb);
    for row in &mut l_bar {
        for x in row {
            *x += *x;
        }
    }
    ([entry(0, 0), entry(1, 1), entry(2, 2), entry(0, 1), entry(0, 2), entry(1, 2)], l_bar)
}

/// `A B`, in multiply-adds.
#[inline(always)]
fn product<T: Real>(a: &Mat3<T>, b: &Mat3<T>) -> Mat3<T> {
    three!(i => three!(j => a[i][0].mul_add(b[0][j], a[i][1].mul_add(b[1][j], a[i][2] * b[2][j]))))
}

/// `L (I + E)`
#[inline(always)]
fn l_times_b<T: Real>(strain: Sym3<T>, l: &Mat3<T>) -> Mat3<T> {
    let e = full(strain);
    three!(i => three!(j => {
        l[i][0].mul_add(e[0][j], l[i][1].mul_add(e[1][j], l[i][2].mul_add(e[2][j], l[i][j])))
    }))
}

/// Largest Frobenius norm of `B` for the series: an eigenvalue of a traceless matrix of that norm is at most 0.49, and one
/// of `2 k e` at most 0.596.
const MILD: f64 = 0.6;

/// `tr E/3`, `1/(1 + tr E/3)` and `B`.
#[inline(always)]
fn spread<T: Real>(trial: Sym3<T>) -> (T, T, Sym3<T>) {
    let a = T::from_f64(1.0 / 3.0) * trace(trial);
    let inverse = T::ONE / (T::ONE + a);
    (a, inverse, scale_sym(inverse, plus_diagonal(trial, -a)))
}

/// Whether the shear is small enough for [`return_map`]; not if the strain is none (a volume of 0 or less, or NaN).
#[inline(always)]
pub(crate) fn is_mild<T: Real>(trial: Sym3<T>) -> bool {
    let (_, inverse, b) = spread(trial);
    inverse > T::ZERO && inner(b, b) <= T::from_f64(MILD * MILD)
}

/// Everything about one return that its adjoint needs as well.
struct Return<T> {
    e: Sym3<T>,
    /// `1/n`
    inverse_n: T,
    t: T,
    keep: T,
    mean: T,
    at_apex: bool,
    on_cone: bool,
}

/// The return, with `f` the numbers of `ln(I + B) = f0 I + f1 B + f2 B^2`.
#[inline(always)]
fn yielded<T: Real>(m: &Material<T>, a: T, b: &CayleyHamilton<T>, f: [T; 3], q: T) -> Return<T> {
    let (third, half) = (T::from_f64(1.0 / 3.0), T::from_f64(0.5));
    let trace_ln = T::from_f64(3.0) * f[0] + (f[2] + f[2]) * b.m2;
    let t = T::from_f64(1.5) * a.ln_1p() + q + half * trace_ln;
    let e = scale_sym(half, b.combine([f[0] - third * trace_ln, f[1], f[2]]));
    // A deviator below this length has no direction worth the name; on the cone it is longer.
    let n = inner(e, e).at_least(T::TINY).sqrt();
    let inverse_n = T::ONE / n;
    let room = m.slope * (m.apex - t);
    let at_apex = t >= m.apex;
    let elastic = n <= room;
    let keep = if elastic { T::ONE } else { room * inverse_n };
    let keep = if at_apex { T::ZERO } else { keep };
    let mean = third * if at_apex { m.apex } else { t };
    Return { e, inverse_n, t, keep, mean, at_apex, on_cone: !elastic && !at_apex }
}

/// Kirchhoff stress (Pa), strain and volume correction after the return to the yield surface; of a trial strain that
/// [`is_mild`].
#[inline(always)]
pub(crate) fn return_map<T: Real>(m: &Material<T>, trial: Sym3<T>, q: T) -> (Sym3<T>, Sym3<T>, T) {
    let (a, _, b) = spread(trial);
    let b = CayleyHamilton::of(b);
    let r = yielded(m, a, &b, horner(&T::LN_1P_SERIES, b.m2, b.m3), q);
    let two_mu = m.mu + m.mu;
    let pressure = (two_mu + T::from_f64(3.0) * m.lambda) * r.mean;
    let tau = plus_diagonal(scale_sym(two_mu * r.keep, r.e), pressure);
    let x = CayleyHamilton::of(scale_sym(r.keep + r.keep, r.e));
    let h = horner(&T::EXP_M1_SERIES, x.m2, x.m3);
    let grown = (r.mean + r.mean).exp_m1();
    let s = T::ONE + grown;
    let strain = x.combine([grown + s * h[0], s * h[1], s * h[2]]);
    (tau, strain, (r.t - m.apex).only_if(r.at_apex))
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
    let (third, half, two) = (T::from_f64(1.0 / 3.0), T::from_f64(0.5), T::from_f64(2.0));
    let two_mu = m.mu + m.mu;
    let (a, inverse, b) = spread(trial);
    let b = CayleyHamilton::of(b);
    let (f, f_slopes) = horner_with_slopes(&T::LN_1P_SERIES, b.m2, b.m3);
    let r = yielded(m, a, &b, f, q);
    let x = CayleyHamilton::of(scale_sym(r.keep + r.keep, r.e));
    let (h, h_slopes) = horner_with_slopes(&T::EXP_M1_SERIES, x.m2, x.m3);

    // Back from E' = (s - 1) I + s expm1(X), s = exp(2 mean), X = 2 k e, and from tau.
    let s = T::ONE + (r.mean + r.mean).exp_m1();
    let strain_trace = trace(strain_bar);
    let grown_bar =
        strain_trace + h[0] * strain_trace + h[1] * inner(strain_bar, x.b) + h[2] * inner(strain_bar, x.b2);
    let mean_bar = two * s * grown_bar + (two_mu + T::from_f64(3.0) * m.lambda) * trace(tau_bar);
    let x_bar = x.combine_adjoint(h, h_slopes, scale_sym(s, strain_bar));
    let kept_bar = blend(two, x_bar, two_mu, tau_bar);

    // Back through the return.
    let along = inner(kept_bar, r.e) * r.inverse_n;
    let e_bar = blend(r.keep, kept_bar, -(r.keep * along * r.inverse_n).only_if(r.on_cone), r.e);
    let t_bar = third * mean_bar - (m.slope * along).only_if(r.on_cone);
    let t_bar = if r.at_apex { q_bar } else { t_bar };

    // Back from e = dev ln(I + B)/2 and t = 3/2 ln(1 + a) + q + tr ln(I + B)/2.
    let ln_bar = plus_diagonal(scale_sym(half, e_bar), half * (t_bar - third * trace(e_bar)));
    let b_bar = b.combine_adjoint(f, f_slopes, ln_bar);
    let a_bar = inverse * (T::from_f64(1.5) * t_bar - inner(b_bar, b.b));
    let b_bar = scale_sym(inverse, b_bar);
    (plus_diagonal(b_bar, third * (a_bar - trace(b_bar))), t_bar)
}
