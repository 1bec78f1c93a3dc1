//! Powder as a material: St. Venant-Kirchhoff-Hencky elasticity with a yield cone (Drucker-Prager's or Matsuoka-Nakai's), volume
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
//! | `c` | `slope` | cone slope in strain space in triaxial compression, `alpha (3 lambda + 2 mu)/(2 mu)` |
//! | `l` | `lode` | cosine of three times the Lode angle, `-3 sqrt(6) det(e)/n^3`: 1 in triaxial compression, -1 in extension |
//! | `Y(l)` | `narrowing` | slope in triaxial compression over the slope at that Lode angle; 1 on Drucker-Prager's cone |
//! | `t_c` | `apex` | trace at the cone's apex: 0 without cohesion |
//! | `t_t` | `cut` | trace at which powder parts: `t_c`, or less where tension is cut off |
//! | `w` | `shear` | `k 2 D:D` of the last velocity gradient's deviatoric symmetric part `D`, `k = (d/I_h)^2 rho_s/K`: `w/P` is the square of the inertial number over `I_h` |
//! | `P` | `depth` | how far inside the cone's apex: `S t_c - min(t, S t_t)`; the pressure over the bulk modulus `K` |
//! | `c P (1 + B r)` | | what the deviator may be in compression, `r = P/(P + w)`: with two angles `c` is the slope of flowing powder, and `B` what powder at rest has more; else `B = 0` |
//! | `S(q)` | `bond` | part of apex and cut-off that is left of opened powder, `(1 - x)^2 (1 + 2 x)` with `x = q/0.05` in [0, 1]; 1 without a cut-off |
//! | `k` | `keep` | part of the deviator that is kept: 1 elastic, `c P (1 + B r)/(Y n)` on the cone, 0 at its apex |
//! | `eps'` | `mean`, `k e` | after the return: `min(t, S t_t)/3 I + k e` |
//! | `q'` | | `max(0, t - S t_t)` |
//! | `tau` | `tau` | Kirchhoff stress `2 mu eps' + lambda tr(eps') I`, Pa |
//!
//! Drucker-Prager as in Klar et al. 2016, "Drucker-Prager elastoplasticity for sand animation": a round cone, which means the
//! friction angle in triaxial compression and a larger one in every other state of stress. Matsuoka and Nakai 1974,
//! "Stress-deformation and strength characteristics of soil under three different principal stresses", bounds `I1 I2/I3`: the
//! same angle in compression and in extension, and up to 4 degrees more in plane strain, as sands have it. Both cones are
//! returned to along the deviator, which keeps its direction and so its Lode angle: `Y` is known beforehand.
//!
//! Two angles (`flow` in a scene): sand that flows has less friction than sand that is about to. With one angle a column of sand
//! either runs out as far as it should or stands as high as it should; with two, both. The passage is smooth in the inertial number
//! `I = d sqrt(2 D:D) sqrt(rho_s/p)` (MiDi 2004, "On dense granular flows"), at rest included. What flowing and resting powder have of
//! the friction angle's slope was found on columns, see [`AT_REST`].
//!
//! Isotropy lets `b^e = F F^T` stand for `F`, and the return is along `eps`: so nothing here needs the singular value
//! decomposition of the paper, nor eigenvectors. What is needed are a logarithm and an exponential of symmetric matrices,
//! `E' = exp(2 mean) exp(2 k e) - I`, and of traceless ones those are short series ([`super::matrix_polynomial`]) as long as the shear is
//! not large ([`is_mild`]); where it is, [`super::principal`] does the same by eigenvectors.
//! A symmetric cotangent holds the entries of the full matrix: `dL = sum_ij bar_ij dE_ij` over all nine `ij`.

use crate::mpm::matrix_polynomial::{CayleyHamilton, downwards, horner, horner_with_slopes};
use crate::real::Real;
use crate::scene::{Flow, Powder, YieldSurface};
use crate::small::{
    Mat3, Sym3, blend, determinant, dot, full, inner, plus_diagonal, scale_sym, three, trace,
};

/// Constants of the return map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Material<T> {
    /// First Lame parameter, Pa.
    pub(crate) lambda: T,
    /// Shear modulus, Pa.
    pub(crate) mu: T,
    /// Cone slope `c`, in triaxial compression; of flowing powder, if powder at rest has another.
    pub(crate) slope: T,
    /// `B`
    at_rest: T,
    /// `k`, s^2
    shear_scale: T,
    /// `Y(l)` by powers of `l`, lowest first.
    narrowing: [T; NARROWING_TERMS],
    /// Trace of the Hencky strain at the cone's apex.
    pub(crate) apex: T,
    /// At which powder parts.
    pub(crate) cut: T,
    /// One over the volume correction at which bonds are gone; 0 if they hold for ever.
    inverse_opening: T,
}

/// `2 dev D` of a velocity gradient, twice its symmetric part without its trace, and the square of its norm.
#[inline(always)]
pub(crate) fn twice_shear<T: Real>(c: &Mat3<T>) -> (Mat3<T>, T) {
    let spread = T::from_f64(2.0 / 3.0) * (c[0][0] + c[1][1] + c[2][2]);
    let twice = three!(i => three!(j => {
        let sum = c[i][j] + c[j][i];
        if i == j { sum - spread } else { sum }
    }));
    (twice, dot(twice[0], twice[0]) + dot(twice[1], twice[1]) + dot(twice[2], twice[2]))
}

impl<T: Real> Material<T> {
    /// The powder of a scene.
    pub(crate) fn of(powder: &Powder) -> Self {
        Self::new(
            powder.youngs_modulus_pa,
            powder.poissons_ratio,
            powder.friction_angle_deg.to_radians(),
            powder.apex_tension_pa(),
            powder.yield_surface,
        )
        .with_tensile_strength(powder.tensile_strength_pa)
        .with_flow(powder.flow)
    }

    /// With two angles.
    pub(crate) fn with_flow(self, flow: Option<Flow>) -> Self {
        let Some(Flow { grain_diameter_m, grain_density_kg_m3 }) = flow else { return self };
        let bulk = self.lambda.to_f64() + 2.0 * self.mu.to_f64() / 3.0;
        let time_per_root = grain_diameter_m / INERTIAL_NUMBER;
        Self {
            slope: T::from_f64(FLOWING) * self.slope,
            at_rest: T::from_f64(AT_REST / FLOWING - 1.0),
            shear_scale: T::from_f64(time_per_root * time_per_root * grain_density_kg_m3 / bulk),
            ..self
        }
    }

    /// `w` of a velocity gradient (1/s), and half its derivative by it over `k`, `2 D`.
    /// With one angle as well, where it is 0: a branch here keeps the whole loop over the lanes from being vectors, and costs four times as much.
    #[inline(always)]
    pub(crate) fn shear(&self, c: &Mat3<T>) -> (T, Mat3<T>) {
        let (twice, square) = twice_shear(c);
        (T::from_f64(0.5) * self.shear_scale * square, twice)
    }

    /// Adjoint of [`Self::shear`].
    #[inline(always)]
    pub(crate) fn shear_adjoint(&self, twice: &Mat3<T>, bar: T) -> Mat3<T> {
        let scale = (self.shear_scale + self.shear_scale) * bar;
        three!(i => three!(j => scale * twice[i][j]))
    }

    /// What the deviator may be before it is narrowed, over the slope, `P (1 + B r)`, and its derivatives by depth and shear.
    #[inline(always)]
    pub(crate) fn strength(&self, depth: T, shear: T) -> (T, [T; 2]) {
        let ratio = depth / (depth + shear + T::from_f64(NO_SHEAR));
        let more = self.at_rest * ratio;
        let by_depth = T::ONE + more * (T::ONE + T::ONE - ratio);
        (depth + more * depth, [by_depth, -(more * ratio)])
    }

    /// Whether powder at rest has another friction than powder that flows.
    #[inline(always)]
    pub(crate) fn has_two_angles(&self) -> bool {
        self.at_rest > T::ZERO
    }

    /// Parts at a mean tension (Pa), and has less of it and of cohesion the farther it has opened; at none given, at the cone's
    /// apex, and as often as it comes there.
    ///
    /// What holds a powder together are forces where grains touch: they are gone when grains are apart, and there again when the
    /// powder is pressed together, which is just what `q` tells.
    pub(crate) fn with_tensile_strength(self, strength: Option<f64>) -> Self {
        let Some(strength) = strength else { return self };
        let bulk = self.lambda.to_f64() + 2.0 * self.mu.to_f64() / 3.0;
        let cut = T::from_f64(strength / bulk).at_most(self.apex);
        Self { cut, inverse_opening: T::from_f64(1.0 / OPENING), ..self }
    }

    /// `S` and its derivative.
    #[inline(always)]
    pub(crate) fn bond(&self, q: T) -> (T, T) {
        let x = (q * self.inverse_opening).unit();
        let left = T::ONE - x;
        (left * left * (T::ONE + x + x), -(T::from_f64(6.0) * x * left * self.inverse_opening))
    }

    /// From Young's modulus (Pa), Poisson's ratio, friction angle (rad), the mean tension at the cone's apex (Pa) and the form of
    /// the cone.
    ///
    /// Either cone goes through the triaxial compression corners of Mohr-Coulomb,
    /// `alpha = sqrt(2/3) 2 sin(phi)/(3 - sin(phi))`.
    pub(crate) fn new(
        youngs_modulus: f64,
        poissons_ratio: f64,
        friction_angle: f64,
        tension: f64,
        surface: YieldSurface,
    ) -> Self {
        let lambda =
            youngs_modulus * poissons_ratio / ((1.0 + poissons_ratio) * (1.0 - 2.0 * poissons_ratio));
        let mu = youngs_modulus / (2.0 * (1.0 + poissons_ratio));
        let sine = libm::sin(friction_angle);
        let alpha = (2.0f64 / 3.0).sqrt() * 2.0 * sine / (3.0 - sine);
        let bulk = lambda + 2.0 * mu / 3.0;
        Self {
            lambda: T::from_f64(lambda),
            mu: T::from_f64(mu),
            slope: T::from_f64(alpha * 3.0 * bulk / (2.0 * mu)),
            at_rest: T::ZERO,
            shear_scale: T::ZERO,
            apex: T::from_f64(tension / bulk),
            cut: T::from_f64(tension / bulk),
            inverse_opening: T::ZERO,
            narrowing: match surface {
                YieldSurface::DruckerPrager => std::array::from_fn(|k| if k == 0 { T::ONE } else { T::ZERO }),
                YieldSurface::MatsuokaNakai => matsuoka_nakai(sine).map(T::from_f64),
            },
        }
    }

    /// `Y` and its derivative.
    #[inline(always)]
    pub(crate) fn narrowing(&self, lode: T) -> (T, T) {
        let c = &self.narrowing;
        let (mut value, mut slope) = (c[NARROWING_TERMS - 1], T::ZERO);
        downwards!(NARROWING_TERMS, k => {
            slope = slope.mul_add(lode, value);
            value = value.mul_add(lode, c[k]);
        });
        (value, slope)
    }
}

/// Slope of powder at rest, and of flowing powder, over that of the friction angle: for 30 degrees those of 31.4 and 28.6. Found on
/// columns that collapse, one and two radii high, and on poured heaps: with 1.1 columns stand as high as sand, but heaps stand 4
/// degrees above their friction angle; with 1 heaps stand at it, and columns are a sixth too low.
const AT_REST: f64 = 1.05;
const FLOWING: f64 = 0.95;
/// Inertial number at which powder has the mean of both.
const INERTIAL_NUMBER: f64 = 0.1;
/// What the shear of powder at its apex counts for at least: there no deviator is left, however that comes.
const NO_SHEAR: f64 = 1e-12;

/// Volume correction at which no bond is left.
const OPENING: f64 = 0.05;

/// Terms of `Y`: within 5e-5 of itself at 30 degrees, 1.5e-3 at 45, 1.5e-2 at 60.
const NARROWING_TERMS: usize = 8;

/// `-3 sqrt(6)`, the factor of the Lode angle's cosine.
pub(crate) const LODE_FACTOR: f64 = -7.348_469_228_349_534;

/// `l` from the determinant of `e` and `1/n`. Multiplied in this order it is 0, not infinity times 0, where `e` is no number to
/// speak of; rounding must not take it out of [-1, 1].
#[inline(always)]
pub(crate) fn lode<T: Real>(det: T, inverse_n: T) -> T {
    let l = T::from_f64(LODE_FACTOR) * det * inverse_n * inverse_n * inverse_n;
    l.at_least(-T::ONE).at_most(T::ONE)
}

/// `Y` of Matsuoka and Nakai's cone, `I1 I2/I3 = K` with `K = (9 - sin^2)/(1 - sin^2)`, as a polynomial.
///
/// With `p` the mean stress and `s` the deviator, `I1 = 3 p`, `I2 = 3 p^2 - |s|^2/2`, `I3 = p^3 - p |s|^2/2 + det s`; so
/// `y = p/|s|` is the largest root of `y^3 - a y + b l = 0`, `a = (K - 3)/(2 (K - 9))`, `b = K/(3 sqrt(6) (K - 9))`. `Y` is that
/// root over its value at `l = 1`, by interpolation at Chebyshev's nodes.
fn matsuoka_nakai(sine: f64) -> [f64; NARROWING_TERMS] {
    const N: usize = NARROWING_TERMS;
    let mut unit = [0.0; N];
    unit[0] = 1.0;
    // No friction, no cone; and next to none is a round one.
    if sine < 1e-3 {
        return unit;
    }
    let k = (9.0 - sine * sine) / (1.0 - sine * sine);
    let (a, b) = (0.5 * (k - 3.0) / (k - 9.0), k / (3.0 * 6.0f64.sqrt() * (k - 9.0)));
    let root = |l: f64| {
        // Newton's method from beyond the largest root: the polynomial is convex there.
        (0..60).fold(2.0 * (a / 3.0).sqrt(), |y, _| y - (y * y * y - a * y + b * l) / (3.0 * y * y - a))
    };
    let node = |i: usize| libm::cos(std::f64::consts::PI * (i as f64 + 0.5) / N as f64);
    // Newton's divided differences, then expanded by powers.
    let mut differences: [f64; N] = std::array::from_fn(|i| root(node(i)));
    for j in 1..N {
        for i in (j..N).rev() {
            differences[i] = (differences[i] - differences[i - 1]) / (node(i) - node(i - j));
        }
    }
    let mut powers = [0.0; N];
    for i in (0..N).rev() {
        for k in (1..N).rev() {
            powers[k] = powers[k - 1] - node(i) * powers[k];
        }
        powers[0] = differences[i] - node(i) * powers[0];
    }
    let at_compression: f64 = powers.iter().sum();
    powers.map(|c| c / at_compression)
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

/// The return, with `f` the numbers of `ln(I + B) = f0 I + f1 B + f2 B^2`.
#[inline(always)]
fn yielded<T: Real>(
    m: &Material<T>,
    a: T,
    b: &CayleyHamilton<T>,
    f: [T; 3],
    [q, shear]: [T; 2],
) -> Return<T> {
    let (third, half) = (T::from_f64(1.0 / 3.0), T::from_f64(0.5));
    let trace_ln = T::from_f64(3.0) * f[0] + (f[2] + f[2]) * b.m2;
    let t = T::from_f64(1.5) * a.ln_1p() + q + half * trace_ln;
    let e = scale_sym(half, b.combine([f[0] - third * trace_ln, f[1], f[2]]));
    // A deviator below this length has no direction worth the name; on the cone it is longer.
    let n = inner(e, e).at_least(T::TINY).sqrt();
    let inverse_n = T::ONE / n;
    let lode = lode(determinant(e), inverse_n);
    let narrowing = m.narrowing(lode);
    let bond = m.bond(q);
    let (apex, cut) = (bond.0 * m.apex, bond.0 * m.cut);
    let parted = t >= cut;
    let trace = if parted { cut } else { t };
    let (strength, slopes) = m.strength(apex - trace, shear);
    let room = m.slope * strength / narrowing.0;
    let elastic = n <= room;
    let keep = if elastic { T::ONE } else { room * inverse_n };
    let mean = third * trace;
    Return { e, inverse_n, t, keep, mean, lode, narrowing, bond, strength: slopes, parted, elastic }
}

/// Kirchhoff stress (Pa), strain and volume correction after the return to the yield surface; of a trial strain that
/// [`is_mild`]. What comes beside it are volume correction and shear.
#[inline(always)]
pub(crate) fn return_map<T: Real>(
    m: &Material<T>,
    trial: Sym3<T>,
    [q, shear]: [T; 2],
) -> (Sym3<T>, Sym3<T>, T) {
    let (a, _, b) = spread(trial);
    let b = CayleyHamilton::of(b);
    let r = yielded(m, a, &b, horner(&T::LN_1P_SERIES, b.m2, b.m3), [q, shear]);
    let two_mu = m.mu + m.mu;
    let pressure = (two_mu + T::from_f64(3.0) * m.lambda) * r.mean;
    let tau = plus_diagonal(scale_sym(two_mu * r.keep, r.e), pressure);
    let x = CayleyHamilton::of(scale_sym(r.keep + r.keep, r.e));
    let h = horner(&T::EXP_M1_SERIES, x.m2, x.m3);
    let grown = (r.mean + r.mean).exp_m1();
    let s = T::ONE + grown;
    let strain = x.combine([grown + s * h[0], s * h[1], s * h[2]]);
    (tau, strain, (r.t - r.bond.0 * m.cut).only_if(r.parted))
}

/// Cotangents of what a return gives.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReturnBar<T> {
    pub(crate) tau: Sym3<T>,
    pub(crate) strain: Sym3<T>,
    pub(crate) q: T,
    /// Of `t`, which is the same before and after.
    pub(crate) volume: T,
}

/// Cotangents of [`return_map`]: of the trial strain, and of volume correction and shear.
#[inline(always)]
pub(crate) fn return_map_adjoint<T: Real>(
    m: &Material<T>,
    trial: Sym3<T>,
    [q, shear]: [T; 2],
    bar: &ReturnBar<T>,
) -> (Sym3<T>, [T; 2]) {
    let ReturnBar { tau: tau_bar, strain: strain_bar, q: q_bar, volume: volume_bar } = *bar;
    let (third, half, two) = (T::from_f64(1.0 / 3.0), T::from_f64(0.5), T::from_f64(2.0));
    let two_mu = m.mu + m.mu;
    let (a, inverse, b) = spread(trial);
    let b = CayleyHamilton::of(b);
    let (f, f_slopes) = horner_with_slopes(&T::LN_1P_SERIES, b.m2, b.m3);
    let r = yielded(m, a, &b, f, [q, shear]);
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
    let along = (inner(kept_bar, r.e) * r.inverse_n).only_if(!r.elastic);
    let (narrowing, narrowing_slope) = r.narrowing;
    // On the cone k n = c P (1 + B r)/Y(l), where dl/de is -3 sqrt(6) e^2/n^3 - 3 l e/n^2, but for its trace.
    let turning = -(r.keep * along * narrowing_slope / narrowing) * r.inverse_n;
    let e2 = CayleyHamilton::of(r.e).b2;
    let shrinking = r.keep * along * r.inverse_n + T::from_f64(3.0) * r.lode * turning;
    let e_bar = blend(r.keep, kept_bar, -shrinking, r.e);
    let e_bar = blend(T::ONE, e_bar, T::from_f64(LODE_FACTOR) * turning * r.inverse_n, e2);
    let room_bar = m.slope * along / narrowing;
    let [room_bar, shear_bar] = [r.strength[0] * room_bar, r.strength[1] * room_bar];
    let trace_bar = third * mean_bar - room_bar;
    let t_bar = volume_bar + if r.parted { q_bar } else { trace_bar };
    // What bonds are left: of the apex, and of the cut-off where that is met.
    let cut_bar = (trace_bar - q_bar).only_if(r.parted);
    let q_in_bar = r.bond.1 * (m.apex * room_bar + m.cut * cut_bar);

    // Back from e = dev ln(I + B)/2 and t = 3/2 ln(1 + a) + q + tr ln(I + B)/2.
    let ln_bar = plus_diagonal(scale_sym(half, e_bar), half * (t_bar - third * trace(e_bar)));
    let b_bar = b.combine_adjoint(f, f_slopes, ln_bar);
    let a_bar = inverse * (T::from_f64(1.5) * t_bar - inner(b_bar, b.b));
    let b_bar = scale_sym(inverse, b_bar);
    (plus_diagonal(b_bar, third * (a_bar - trace(b_bar))), [t_bar + q_in_bar, shear_bar])
}
