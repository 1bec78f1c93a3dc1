//! Volume held to the density that the grid sees.
//!
//! The volume correction `q` integrates a velocity gradient that is noise where powder flies and tumbles, and nothing in it
//! knows where the mass is: poured powder then lies at 0.8 to 1.8 of its density. With `volume_correction = "grid"` the
//! particle's own volume is held between two bounds at the end of every fourth substep.
//!
//! | symbol | identifier | meaning |
//! |---|---|---|
//! | `m_i/a_i` | `inverse_room` | mass of a node over the part of its spline that no solid takes, at least 0.05 |
//! | `rho` | `rho` | density that the particle sees, of that at rest: `sum w m_i/(a_i rho_0 dx^3)` |
//! | `L` | `open` | `-ln(rho)`: the logarithmic volume that it should have |
//! | `R` | `slope` | `dx |grad rho|/rho`, `4 |sum w rho_i (x_i - x)/dx|/rho` |
//! | `t` | `volume` | its own logarithmic volume, `q + ln(det(I + E))/2`; the return map does not change it |
//! | `dev D` | | symmetric part of the velocity gradient with which the substep begins, without its trace |
//! | `g` | `sheared` | shear rate `sqrt(2 dev D : dev D)`, smooth at rest, times the time between two holds: to and fro counts twice |
//! | `g_0` | `strain` | `loosening_strain` |
//! | `b` | `share` | `g/(g + g_0 R^2)`; 1 if the scene has no `loosening_strain` |
//!
//! ```text
//! q' = q - max(0, t - (L + 0.05)) + b max(0, low - max(0, t)),   low = L - 0.06 - 0.3 R - 0.29 R^2
//! ```
//!
//! From above: what believes to be looser than it is would have to be pressed together before it bears. From below: what lies
//! looser than it believes has to come together before it bears. The splines smear a free surface over two cells; there
//! `-ln(rho)` is `0.3 R + 0.29 R^2` to within 0.1 at any depth and place between the nodes, so that surfaces are hardly taken for
//! loose powder. The bounds are the widest with which a filled box, and a heap, lie at their density within 5 % (`optimise validate`).
//! `max(0, t)`: what bears a pressure is let go of smoothly as `low` passes 0.
//!
//! With `b = 1` powder at rest is loosened, too. Where a surface is not as smooth as that, at the size of a single particle, `low` is
//! now and then above what a particle of it believes: it bears nothing for some substeps, falls until it does, and a heap that is awake
//! flattens, whatever its friction angle and the time step: one of 25 degrees sinks by 3.7 % in 5.5 s, more than half of what lies within a
//! cell of its surface bearing nothing. By `b` powder near a surface that does not deform stays as it is, as in critical state theory,
//! where density changes with shear strain; inside, where `low` is sure, a little shear is enough. A column that has collapsed sinks by 1.2
//! instead of 2.8 % in 4 s with `g_0 = 1` (the test `powder_that_is_loosened_by_shear_alone_stays_a_heap_when_awake`).
//!
//! Dunatunga and Kamrin 2015, "Continuum modelling and simulation of granular flows through their many phases", track density so
//! that separated powder bears nothing; here density is not tracked but seen, since a tracked one drifts like `q`.

use crate::mpm::gather::{Fourth, GatheredFourth, gather_fourth};
use crate::mpm::material::twice_shear;
use crate::mpm::particles::{Group, LANES, Lanes, mat_of};
use crate::mpm::stencil::Tile;
use crate::mpm::stencil_positions::{StencilPositions, Weights};
use crate::real::Real;
use crate::small::{Mat3, Sym3, determinant, dot, three, trace};

/// Room of a particle's volume above what the grid sees, and below it.
const ABOVE: f64 = 0.05;
const BELOW: f64 = 0.06;
/// `-ln(rho)` at a free surface by powers of `R`.
const SURFACE: [f64; 2] = [0.3, 0.29];
/// Slopes `R` below this have no direction worth the name.
const FLAT: f64 = 0.01;
/// Density below which it is no matter how much.
const NOTHING: f64 = 1e-4;

/// What a particle sees of the grid.
#[derive(Clone, Copy)]
struct Seen<T> {
    rho: T,
    open: T,
    /// `sum w rho_i (x_i - x)/dx`
    moment: [T; 3],
    slope: T,
}

impl<T: Real> Seen<T> {
    #[inline(always)]
    fn new(fourth: &GatheredFourth<T>, places: &StencilPositions<T>, l: usize) -> Self {
        let (f, sum) = (places.f(l), fourth.sum[l]);
        let rho = sum.at_least(T::from_f64(NOTHING));
        let moment = three!(axis => fourth.first[axis][l] - sum * f[axis]);
        let flat = T::from_f64(0.25 * FLAT) * rho;
        let slope = T::from_f64(4.0) * (dot(moment, moment) + flat * flat).sqrt() / rho;
        Self { rho, open: open(rho), moment, slope }
    }

    #[inline(always)]
    fn low(&self) -> T {
        let at_surface = self.slope * (T::from_f64(SURFACE[0]) + T::from_f64(SURFACE[1]) * self.slope);
        self.open - T::from_f64(BELOW) - at_surface
    }
}

#[inline(always)]
fn open<T: Real>(rho: T) -> T {
    -(rho - T::ONE).ln_1p()
}

/// How much a particle is too loose and too dense for what the grid sees.
#[inline(always)]
fn excess<T: Real>(volume: T, open: T) -> T {
    (volume - (open + T::from_f64(ABOVE))).at_least(T::ZERO)
}

#[inline(always)]
fn lack<T: Real>(volume: T, low: T) -> T {
    (low - volume.at_least(T::ZERO)).at_least(T::ZERO)
}

/// `ln(det(I + E))/2`
#[inline(always)]
pub(crate) fn elastic_volume<T: Real>(strain: Sym3<T>) -> T {
    let [xx, yy, zz, xy, xz, yz] = strain;
    let minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz;
    T::from_f64(0.5) * (trace(strain) + minors + determinant(strain)).ln_1p()
}

/// `ln(det(I + L))`
#[inline(always)]
fn volume_change<T: Real>(l: &Mat3<T>) -> T {
    let minor = |i: usize, j: usize| l[i][i] * l[j][j] - l[i][j] * l[j][i];
    let determinant = dot(l[0], crate::small::cross(l[1], l[2]));
    (l[0][0] + l[1][1] + l[2][2] + minor(0, 1) + minor(0, 2) + minor(1, 2) + determinant).ln_1p()
}

/// Least room of a node: in a wall's middle there is none, and next to nothing lies there.
const LEAST_ROOM: f64 = 0.05;

/// Part of a quadratic spline above a plane that lies `s` cells below its middle, and its derivative, the spline itself.
#[inline(always)]
fn above_plane<T: Real>(s: T) -> (T, T) {
    let s = s.at_least(T::from_f64(-1.5)).at_most(T::from_f64(1.5));
    let (half, sixth) = (T::from_f64(0.5), T::from_f64(1.0 / 6.0));
    let (low, high) = (s + T::from_f64(1.5), T::from_f64(1.5) - s);
    let outer = s.abs() > half;
    let near = low.at_most(high);
    let tail = near * near * near * sixth;
    let tail = if s < T::ZERO { tail } else { T::ONE - tail };
    let middle = half + s * (T::from_f64(0.75) - s * s * T::from_f64(1.0 / 3.0));
    let spline = if outer { half * near * near } else { T::from_f64(0.75) - s * s };
    (if outer { tail } else { middle }, spline)
}

/// Part of a node's spline that a solid leaves, its surface being flat for this, and the derivative by the distance: `s` cells
/// from the solid, which is `thickness` cells thick.
#[inline(always)]
pub(crate) fn room_beside<T: Real>(s: T, thickness: T) -> (T, T) {
    let ((before, slope), (behind, slope_behind)) = (above_plane(s), above_plane(-(s + thickness)));
    (before + behind, slope - slope_behind)
}

/// `1/a`, and whether it is the least room that counts.
#[inline(always)]
pub(crate) fn inverse_room<T: Real>(room: T) -> (T, bool) {
    let least = T::from_f64(LEAST_ROOM);
    (T::ONE / room.at_least(least), room <= least)
}

/// Whether anywhere the lower bound could be above 0: where the powder is no looser than its margin, no slope is asked for.
#[inline(always)]
fn any_loose<T: Real>(rho: &Lanes<T>, occupied: usize) -> bool {
    let dense = T::from_f64(1.0 / (1.0 + BELOW));
    let mut loose = Lanes::ZERO;
    for l in 0..LANES {
        loose[l] = T::ONE.only_if(rho[l] < dense);
    }
    loose[..occupied].contains(&T::ONE)
}

/// Which share of a particle's lack of volume is added in one hold: more with more shear, less near a surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Loosening<T> {
    strain: T,
    /// From one hold to the next, s.
    interval: T,
}

/// Shear rates below this count by their square, 1/s: rest has no direction.
const REST_RATE: f64 = 0.01;

impl<T: Real> Loosening<T> {
    /// Over a shear strain, with so many seconds from hold to hold.
    pub(crate) fn new(strain: f64, interval_s: f64) -> Self {
        Self { strain: T::from_f64(strain), interval: T::from_f64(interval_s) }
    }

    /// `b` for a velocity gradient (1/s) and `R`; then `k` and `db/dR`, the derivative of `b` by the velocity gradient being `k 2 dev D`.
    #[inline(always)]
    fn share(&self, c: &Mat3<T>, slope: T) -> (T, [T; 2]) {
        let (_, square) = twice_shear(c);
        let (half, rest) = (T::from_f64(0.5) * square, T::from_f64(REST_RATE));
        let rate = (half + rest * rest).sqrt();
        // Less what it would be at rest, without a difference of like numbers.
        let sheared = self.interval * half / (rate + rest);
        let needed = self.strain * slope * slope;
        let inverse = T::ONE / (sheared + needed);
        let by_needed = -(sheared * inverse * inverse);
        let by_slope = by_needed * T::from_f64(2.0) * self.strain * slope;
        (sheared * inverse, [needed * inverse * inverse * self.interval / rate, by_slope])
    }
}

/// [`Loosening::share`] of a particle; 1 if there is no such law.
#[inline(always)]
fn share_of<T: Real>(law: &Option<Loosening<T>>, group: &Group<T>, l: usize, slope: T) -> (T, [T; 2]) {
    // Not by a closure: one that is not inlined is compiled for the baseline instruction set.
    match law {
        Some(law) => law.share(&mat_of(&group.c, l), slope),
        None => (T::ONE, [T::ZERO; 2]),
    }
}

/// Holds the volume corrections of a group, strain and correction being those after the return. `tile` has densities as its
/// fourth numbers, `density` is what the particles see of them; velocity gradients are still those of before the substep.
#[inline(always)]
pub(crate) fn hold_volume<T: Real>(
    tile: &Tile<T>,
    density: &Lanes<T>,
    places: &StencilPositions<T>,
    weights: &Weights<T>,
    occupied: usize,
    loosening: &Option<Loosening<T>>,
    state: &mut Group<T>,
) {
    let mut q = state.q[0];
    let mut volume = Lanes::ZERO;
    for l in 0..LANES {
        volume[l] = state.q[0][l] + elastic_volume(state.strain_of(l));
        q[l] -= excess(volume[l], open(density[l].at_least(T::from_f64(NOTHING))));
    }
    if any_loose(density, occupied) {
        let seen = gather_fourth::<T, true>(tile, places, weights, occupied);
        for l in 0..LANES {
            let at = Seen::new(&seen, places, l);
            let (share, _) = share_of(loosening, state, l, at.slope);
            // Padding sees no mass.
            q[l] += (share * lack(volume[l], at.low())).only_if(l < occupied);
        }
    }
    state.q[0] = q;
}

/// What the adjoint of [`hold_volume`] gives.
pub(crate) struct HeldVolumeBar<T> {
    /// Cotangent of `t`.
    pub(crate) volume: Lanes<T>,
    /// `k`, that of the velocity gradient being `k 2 dev D`; 0 without `loosening_strain`.
    pub(crate) shear: Lanes<T>,
    /// What goes to the nodes' fourth numbers.
    pub(crate) fourth: Fourth<T>,
    /// Cotangent of the places in cells, but for the derivatives of the weights.
    pub(crate) through_f: [Lanes<T>; 3],
}

/// Adjoint of [`hold_volume`], `input` being the state before the substep and `q_bar` the cotangent of the corrections; none where
/// no bound was met.
#[inline(always)]
pub(crate) fn hold_volume_adjoint<T: Real>(
    tile: &Tile<T>,
    places: &StencilPositions<T>,
    weights: &Weights<T>,
    occupied: usize,
    (dt, loosening): (T, &Option<Loosening<T>>),
    input: &Group<T>,
    q_bar: &Lanes<T>,
) -> Option<HeldVolumeBar<T>> {
    let seen = gather_fourth::<T, false>(tile, places, weights, occupied);
    let (mut volume, mut too_loose) = (Lanes::ZERO, Lanes::ZERO);
    for l in 0..LANES {
        let c = mat_of(&input.c, l);
        let grown = volume_change(&three!(i => three!(j => dt * c[i][j])));
        volume[l] = input.q[0][l] + elastic_volume(input.strain_of(l)) + grown;
        too_loose[l] = excess(volume[l], open(seen.sum[l].at_least(T::from_f64(NOTHING))));
    }
    let loose = any_loose(&seen.sum, occupied);
    if !loose && !too_loose[..occupied].iter().any(|excess| *excess > T::ZERO) {
        return None;
    }
    let seen = gather_fourth::<T, true>(tile, places, weights, occupied);
    let mut out = HeldVolumeBar {
        volume: Lanes::ZERO,
        shear: Lanes::ZERO,
        fourth: Fourth::ZERO,
        through_f: [Lanes::ZERO; 3],
    };
    for l in 0..LANES {
        let (at, f) = (Seen::new(&seen, places, l), places.f(l));
        let above = q_bar[l].only_if(too_loose[l] > T::ZERO);
        let lacking = lack(volume[l], at.low()).only_if(loose);
        let (share, [by_shear, by_slope]) = share_of(loosening, input, l, at.slope);
        let share_bar = lacking * q_bar[l];
        out.shear[l] = by_shear * share_bar;
        let below = (share * q_bar[l]).only_if(lacking > T::ZERO);
        out.volume[l] = -(above + below.only_if(volume[l] > T::ZERO));
        let slope_bar = by_slope * share_bar
            - below * (T::from_f64(SURFACE[0]) + T::from_f64(2.0 * SURFACE[1]) * at.slope);
        let inverse = T::ONE / at.rho;
        // R = 4 sqrt(|moment|^2 + (flat rho)^2)/rho; the second part does not change with rho.
        let moment_bar = three!(axis => {
            T::from_f64(16.0) * slope_bar * at.moment[axis] * inverse * inverse / at.slope
        });
        let along = dot(moment_bar, at.moment);
        let rho_bar = (-((above + below) + along) * inverse).only_if(seen.sum[l] > T::from_f64(NOTHING));
        out.fourth.base[l] = rho_bar - dot(moment_bar, f);
        for axis in 0..3 {
            out.fourth.steps[axis][l] = moment_bar[axis];
            out.through_f[axis][l] = moment_bar[axis] * seen.sum[l];
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::mpm::tests::{Dice, assert_gradient};

    const LAW: fn() -> Loosening<f64> = || Loosening::new(0.5, 0.002);

    fn shear(rate: f64) -> Mat3<f64> {
        [[0.0, rate, 0.0], [0.0; 3], [0.0; 3]]
    }

    #[test]
    fn half_of_it_is_loosened_by_the_shear_that_the_slope_asks_for() {
        // 0.5 R^2 in 2 ms.
        for slope in [0.1, 1.0, 3.0] {
            let rate = 0.5 * slope * slope / 0.002;
            for (times, want) in [(1.0, 0.5), (1e4, 1.0), (1e-4, 0.0), (3.0, 0.75)] {
                let (share, _) = LAW().share(&shear(times * rate), slope);
                assert!((share - want).abs() < 2e-3, "{slope} {times}: {share}");
            }
        }
        // Neither growth nor spin nor rest is shear.
        let grows_and_spins = [[3.0, 7.0, -2.0], [-7.0, 3.0, 5.0], [2.0, -5.0, 3.0]];
        for c in [grows_and_spins, shear(0.0)] {
            assert!(LAW().share(&c, 0.01).0 < 1e-12);
        }
    }

    #[test]
    fn the_share_has_taylor_slope_two() {
        let x: [f64; 10] = Dice::new(31).many(1.0);
        let at = |x: &[f64]| -> (Mat3<f64>, f64) {
            (three!(i => three!(j => 100.0 * x[3 * i + j])), 0.7 + 0.2 * x[9])
        };
        let f = |x: &[f64]| {
            let (c, slope) = at(x);
            LAW().share(&c, slope).0
        };
        let (c, slope) = at(&x);
        let (_, [k, by_slope]) = LAW().share(&c, slope);
        let (twice, _) = twice_shear(&c);
        let mut gradient: Vec<f64> = twice.as_flattened().iter().map(|twice| 100.0 * k * twice).collect();
        gradient.push(0.2 * by_slope);
        assert_gradient("share", 1e-3, &f, &x, &gradient);
    }

    proptest! {
        #[test]
        fn the_share_is_a_share_of_any_number(
            strain in prop_oneof![Just(0.001), Just(100.0), 0.001..100.0f64],
            interval in 1e-7..0.1f64, rate in prop_oneof![Just(0.0), 0.0..1e6f64], slope in 0.01..1e6f64,
        ) {
            let law = Loosening::<f32>::new(strain, interval);
            let c = [[0.0, rate as f32, 0.0], [0.0; 3], [0.0; 3]];
            let (share, slopes) = law.share(&c, slope as f32);
            prop_assert!((0.0..=1.0).contains(&share) && slopes.iter().all(|slope| slope.is_finite()), "{share} {slopes:?}");
        }
    }
}
