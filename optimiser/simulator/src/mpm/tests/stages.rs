//! Material and contact, each alone.

use super::{Dice, assert_slope_two, taylor_slope};
use crate::mpm::contact::{BodyState, ContactParams, contact, contact_adjoint};
use crate::mpm::density::elastic_volume;
use crate::mpm::material::{
    self, LODE_FACTOR, Material, ReturnBar, is_mild, trial_strain, trial_strain_adjoint,
};
use crate::mpm::principal::{self, eigen};
use crate::real::Real;
use crate::scene::{Cuboid, Flow, YieldSurface};
use crate::shape::{
    AlignedBox, Bowl, Capsule, HalfSpace, OrientedBox, Shape, SignedDistance, Tube, with_solid,
};
use crate::small::{Mat3, Sym3, compose, determinant, full, inner, plus_diagonal, trace};

/// Cotangents of a symmetric matrix are entries of the full one: off-diagonal entries count twice.
fn stored(bar: Sym3<f64>) -> [f64; 6] {
    [bar[0], bar[1], bar[2], 2.0 * bar[3], 2.0 * bar[4], 2.0 * bar[5]]
}

fn weighted(tau: Sym3<f64>, strain: Sym3<f64>, q: f64, a: &Sym3<f64>, b: &Sym3<f64>, c: f64) -> f64 {
    let inner = |x: &Sym3<f64>, y: &Sym3<f64>| -> f64 {
        (0..3).map(|i| x[i] * y[i]).sum::<f64>() + 2.0 * (3..6).map(|i| x[i] * y[i]).sum::<f64>()
    };
    inner(&tau, a) + inner(&strain, b) + c * q
}

type Map = fn(&Material<f64>, Sym3<f64>, [f64; 2]) -> (Sym3<f64>, Sym3<f64>, f64);
type Adjoint = fn(&Material<f64>, Sym3<f64>, [f64; 2], &ReturnBar<f64>) -> (Sym3<f64>, [f64; 2]);

/// The return map by series and the one by eigenvectors.
const MAPS: [(Map, Adjoint); 2] = [
    (material::return_map, material::return_map_adjoint),
    (principal::return_map, principal::return_map_adjoint),
];

/// With one angle and with two.
const FLOWS: [Option<Flow>; 2] = [None, Some(Flow { grain_diameter_m: 5e-4, grain_density_kg_m3: 1667.0 })];

const SURFACES: [YieldSurface; 2] = [YieldSurface::DruckerPrager, YieldSurface::MatsuokaNakai];

/// Sand of 10 kPa in units in which stress and strain are of one order.
fn sand<T: Real>(cohesion: f64, surface: YieldSurface) -> Material<T> {
    let angle = 35f64.to_radians();
    Material::new(1.0, 0.2, angle, cohesion / libm::tan(angle), surface)
}

#[test]
fn eigenvectors_diagonalise_to_rounding() {
    let mut dice = Dice::new(5);
    for case in 0..2000 {
        let scale = 10f64.powi(-(case % 9));
        let mut s: Sym3<f64> = dice.many(scale);
        if case % 4 == 0 {
            s[3] = 0.0;
            s[0] = s[1];
        }
        let (w, u) = eigen(s);
        let back = compose(&u, w);
        for i in 0..6 {
            assert!((back[i] - s[i]).abs() < 4e-15 * scale, "{s:?}");
        }
        let narrow = s.map(|x| x as f32);
        let (w, u) = eigen(narrow);
        let back = compose(&u, w);
        for i in 0..6 {
            assert!(f64::from((back[i] - narrow[i]).abs()) < 2e-6 * scale, "{s:?}");
        }
    }
}

/// One strain well inside each branch: elastic, cone, apex.
fn branches() -> [(&'static str, Sym3<f64>, f64); 3] {
    [
        ("elastic", [-0.031, -0.028, -0.034, 0.0021, -0.0013, 0.0008], 0.0),
        ("cone", [-0.031, 0.012, -0.024, 0.021, -0.013, 0.008], 0.004),
        ("apex", [0.031, 0.012, 0.024, 0.021, -0.013, 0.008], 0.01),
    ]
}

#[test]
fn return_map_has_taylor_slope_two_on_every_branch() {
    for (cohesion, surface) in [0.0, 0.004].into_iter().flat_map(|c| SURFACES.map(|s| (c, s))) {
        for (strength, flow) in [None, Some(0.3 * cohesion)].into_iter().flat_map(|s| FLOWS.map(|f| (s, f))) {
            let m = sand(cohesion, surface).with_tensile_strength(strength).with_flow(flow);
            for ((name, strain, q), (return_map, return_map_adjoint)) in
                branches().into_iter().flat_map(|branch| MAPS.map(|map| (branch, map)))
            {
                assert!(is_mild(strain));
                let mut dice = Dice::new(9);
                let (a, b, c): (Sym3<f64>, Sym3<f64>, f64) = (dice.many(1.0), dice.many(1.0), dice.roll());
                let d = dice.roll();
                let f = |x: &[f64]| {
                    let (tau, e, q) = return_map(&m, [x[0], x[1], x[2], x[3], x[4], x[5]], [x[6], x[7]]);
                    weighted(tau, e, q, &a, &b, c) + d * (q + elastic_volume(e))
                };
                let bar = ReturnBar { tau: a, strain: b, q: c, volume: d };
                // As much as the depth: there the slope is half way.
                let shear = 0.03;
                let (bar, [q_bar, shear_bar]) = return_map_adjoint(&m, strain, [q, shear], &bar);
                let s = stored(bar);
                let gradient = [s[0], s[1], s[2], s[3], s[4], s[5], q_bar, shear_bar];
                let x = [strain[0], strain[1], strain[2], strain[3], strain[4], strain[5], q, shear];
                assert!(flow.is_none() || name != "cone" || shear_bar != 0.0);
                // At the apex without cohesion the map is linear: the remainder is rounding.
                let at_apex = name == "apex";
                if at_apex {
                    for k in 0..8 {
                        let moved = |h: f64| {
                            let mut x = x;
                            x[k] += h;
                            f(&x)
                        };
                        let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                        assert!((slope - gradient[k]).abs() < 1e-8, "apex {k}: {slope} {}", gradient[k]);
                    }
                }
                assert_slope_two(name, taylor_slope(8, 3, 1e-4, &f, &x, &gradient));
            }
        }
    }
}

/// Largest differences between the two return maps and their adjoints, relative to the strain, over random strains; and how
/// many of them were on the cone and at the apex.
fn differences<T: Real>(size: f64, cohesion: f64, surface: YieldSurface) -> ([f64; 2], [usize; 2]) {
    let two_angles = FLOWS[usize::from(surface == YieldSurface::MatsuokaNakai)];
    let m = sand::<T>(cohesion, surface).with_flow(two_angles);
    let mut dice = Dice::new(31);
    let (mut worst, mut seen) = ([0.0_f64; 2], [0; 2]);
    let narrow = |s: Sym3<f64>| s.map(T::from_f64);
    for case in 0..4000 {
        let mean = 2.0 * size * (dice.roll() - 0.3);
        let strain = plus_diagonal(dice.many::<6>(size), mean);
        let (strain, q) =
            (narrow(strain), T::from_f64(if case % 3 == 0 { size * dice.roll().abs() } else { 0.0 }));
        if !is_mild(strain) || trace(strain).to_f64() < -1.5 {
            continue;
        }
        let (a, b, c) = (narrow(dice.many(1.0)), narrow(dice.many(1.0)), T::from_f64(dice.roll()));
        let beside = [q, T::from_f64(size * f64::from(case % 5) / 5.0)];
        let (tau, new, q_new) = material::return_map(&m, strain, beside);
        let (want_tau, want_new, want_q) = principal::return_map(&m, strain, beside);
        let bar = ReturnBar { tau: a, strain: b, q: c, volume: T::from_f64(dice.roll()) };
        let (want_bar, want_beside) = principal::return_map_adjoint(&m, strain, beside, &bar);
        let (bar, beside_bar) = material::return_map_adjoint(&m, strain, beside, &bar);
        seen[0] += usize::from(inner(tau, tau).to_f64() > 0.0 && new != strain);
        seen[1] += usize::from(q_new != T::ZERO);
        let off = |x: &[T], y: &[T]| -> f64 {
            x.iter().zip(y).map(|(x, y)| (x.to_f64() - y.to_f64()).abs()).fold(0.0, f64::max)
        };
        let strains = [off(&tau, &want_tau), off(&new, &want_new), off(&[q_new], &[want_q])];
        worst[0] = strains.into_iter().fold(worst[0], |worst, off| worst.max(off / size));
        worst[1] = worst[1].max(off(&bar, &want_bar)).max(off(&beside_bar, &want_beside));
    }
    (worst, seen)
}

#[test]
fn series_and_eigenvectors_say_the_same() {
    for size in [1e-6, 1e-3, 0.03, 0.15, 0.3, 0.4] {
        for (cohesion, surface) in [0.0, 0.02].into_iter().flat_map(|c| SURFACES.map(|s| (c, s))) {
            let (worst, seen) = differences::<f64>(size, cohesion, surface);
            assert!(worst.iter().all(|off| *off < 5e-14), "{size}, {surface:?}: {worst:?}");
            assert!(seen[0] > 100 && (seen[1] > 200 || cohesion > 0.0), "{size}: {seen:?}");
            // Close to a branch's edge the two may be on different sides of it: there the map is continuous, and its
            // derivative is not.
            let (worst, _) = differences::<f32>(size, cohesion, surface);
            assert!(worst[0] < 3e-5, "{size}, {surface:?}: {worst:?}");
        }
    }
}

#[test]
fn what_is_no_mild_strain_is_known() {
    let spin = |shear: f64| -> Sym3<f64> { [0.0, 0.0, 0.0, shear, 0.0, 0.0] };
    assert!(is_mild(spin(0.42)) && !is_mild(spin(0.43)));
    // Any change of volume that leaves one.
    assert!(is_mild([9.0, 9.0, 9.0, 0.0, 0.0, 0.0]) && is_mild([-0.9, -0.9, -0.9, 0.0, 0.0, 0.0]));
    assert!(!is_mild([-1.1, -1.1, -1.1, 0.0, 0.0, 0.0]) && !is_mild([f64::NAN; 6]));
}

#[test]
fn return_map_adjoint_holds_at_equal_stretches() {
    SURFACES.into_iter().for_each(adjoint_holds_at_equal_stretches);
}

fn adjoint_holds_at_equal_stretches(surface: YieldSurface) {
    let m = sand(0.0, surface);
    let equal: [Sym3<f64>; 4] = [
        [-0.02, -0.02, -0.02, 0.0, 0.0, 0.0],
        [-0.02, -0.02, -0.021, 0.0, 0.0, 0.0],
        [-0.03, 0.01, 0.01, 0.0, 0.0, 0.0],
        [-0.02, -0.02 * (1.0 + 1e-12), -0.02, 1e-14, 0.0, 0.0],
    ];
    let mut dice = Dice::new(11);
    for (strain, (return_map, return_map_adjoint)) in
        equal.into_iter().flat_map(|strain| MAPS.map(|map| (strain, map)))
    {
        let (a, b): (Sym3<f64>, Sym3<f64>) = (dice.many(1.0), dice.many(1.0));
        let f = |x: &[f64; 6]| {
            let (tau, e, q) = return_map(&m, *x, [0.0; 2]);
            weighted(tau, e, q, &a, &b, 0.0)
        };
        let bar = ReturnBar { tau: a, strain: b, q: 0.0, volume: 0.0 };
        let gradient = stored(return_map_adjoint(&m, strain, [0.0; 2], &bar).0);
        for k in 0..6 {
            let at = |h: f64| {
                let mut x = strain;
                x[k] += h;
                f(&x)
            };
            let slope = (at(1e-6) - at(-1e-6)) / 2e-6;
            assert!((slope - gradient[k]).abs() < 1e-8, "{strain:?} {k}: {slope} {}", gradient[k]);
        }
    }
}

#[test]
fn shear_has_taylor_slope_two_and_knows_neither_spin_nor_expansion() {
    let m = sand::<f64>(0.0, YieldSurface::MatsuokaNakai).with_flow(FLOWS[1]);
    let matrix = |x: &[f64]| -> Mat3<f64> { [[x[0], x[1], x[2]], [x[3], x[4], x[5]], [x[6], x[7], x[8]]] };
    // One that is of order one.
    let rate = 1.0 / m.shear(&matrix(&[0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])).0.sqrt();
    let f = |x: &[f64]| m.shear(&matrix(x).map(|row| row.map(|x| rate * x))).0;
    assert!((f(&[0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]) - 1.0).abs() < 1e-12);
    assert!(f(&[2.0, 1.0, -3.0, -1.0, 2.0, 0.5, 3.0, -0.5, 2.0]) < 1e-30);
    let x: [f64; 9] = Dice::new(23).many(1.0);
    let c = matrix(&x).map(|row| row.map(|x| rate * x));
    let gradient =
        m.shear_adjoint(&m.shear(&c).1, 1.0).as_flattened().iter().map(|x| rate * x).collect::<Vec<_>>();
    assert_slope_two("shear", taylor_slope(9, 4, 1e-3, &f, &x, &gradient));
}

/// Sheared at one pressure, powder has 1.05 of its key's slope at rest, 0.95 when it flows fast, and the mean of both at an inertial
/// number of 0.1, however stiff it is.
#[test]
fn friction_goes_from_rest_to_flow_with_the_inertial_number() {
    let (pressure, diameter, density) = (200.0_f64, 5e-4, 1667.0);
    for modulus in [1e4, 1e6] {
        let slope = |flow: Option<Flow>, inertial: f64| {
            let m = Material::<f64>::new(modulus, 0.2, 0.5, 0.0, YieldSurface::MatsuokaNakai).with_flow(flow);
            let rate = inertial / diameter * (pressure / density).sqrt();
            let (shear, _) = m.shear(&[[0.0, 0.0, rate], [0.0; 3], [0.0; 3]]);
            let depth = pressure / (m.lambda + 2.0 * m.mu / 3.0);
            m.slope * m.strength(depth, shear).0 / depth
        };
        let key = slope(None, 0.0);
        for (inertial, want) in [(0.0, 1.05), (1e-3, 1.05), (0.1, 1.0), (30.0, 0.95)] {
            let found = slope(FLOWS[1], inertial) / key;
            assert!((found - want).abs() < 1e-3, "{modulus} Pa, I = {inertial}: {found}, not {want}");
            assert_eq!(slope(None, inertial).to_bits(), key.to_bits());
        }
    }
}

#[test]
fn trial_strain_has_taylor_slope_two() {
    let mut dice = Dice::new(21);
    let strain: Sym3<f64> = dice.many(0.02);
    let l: [f64; 9] = dice.many(0.03);
    let a: Sym3<f64> = dice.many(1.0);
    let matrix = |x: &[f64]| -> Mat3<f64> { [[x[0], x[1], x[2]], [x[3], x[4], x[5]], [x[6], x[7], x[8]]] };
    let f = |x: &[f64]| {
        let e = trial_strain([x[0], x[1], x[2], x[3], x[4], x[5]], &matrix(&x[6..]));
        weighted(e, [0.0; 6], 0.0, &a, &[0.0; 6], 0.0)
    };
    let (e_bar, l_bar) = trial_strain_adjoint(strain, &matrix(&l), a);
    let gradient: Vec<f64> = stored(e_bar).into_iter().chain(l_bar.into_iter().flatten()).collect();
    let x: Vec<f64> = strain.into_iter().chain(l).collect();
    assert_slope_two("trial strain", taylor_slope(15, 4, 1e-3, &f, &x, &gradient));
}

/// Opened step by step, powder bears its tensile strength and then less and less; pressed together, it bears it again.
#[test]
fn tension_is_cut_off_and_lost_where_powder_opens() {
    for surface in SURFACES {
        let strength = 0.002;
        let m = sand::<f64>(0.004, surface).with_tensile_strength(Some(strength));
        let opened = |(mut strain, mut q): (Sym3<f64>, f64), rate: f64, steps: usize| {
            let l = [[rate, 0.0, 0.0], [0.0, 0.3 * rate, 0.0], [0.0, 0.0, 0.3 * rate]];
            let mut tensions = Vec::new();
            for _ in 0..steps {
                let (tau, new, q_new) = material::return_map(&m, trial_strain(strain, &l), [q, 0.0]);
                (strain, q) = (new, q_new);
                tensions.push(trace(tau) / 3.0);
            }
            ((strain, q), tensions)
        };
        let (apart, tensions) = opened(([0.0; 6], 0.0), 1e-4, 600);
        let peak = tensions.iter().copied().fold(0.0, f64::max);
        assert!((peak / strength - 1.0).abs() < 0.02, "{surface:?}: {peak}");
        assert!(tensions[599].abs() < 1e-12 && apart.1 > 0.05, "{surface:?}: {}", tensions[599]);
        assert!(tensions.windows(2).skip(100).all(|pair| pair[1] <= pair[0] + 1e-12), "{surface:?}");
        let (pressed, _) = opened(apart, -1e-4, 640);
        let (_, again) = opened(pressed, 1e-4, 300);
        let peak = again.into_iter().fold(0.0, f64::max);
        assert!((peak / strength - 1.0).abs() < 0.02, "{surface:?}: {peak} again");
    }
}

/// `I1 I2/I3` of every stress on the surface is that of triaxial compression at the friction angle, `9 + 8 tan^2(phi)`.
#[test]
fn matsuoka_and_nakais_invariants_are_those_of_the_friction_angle() {
    for (degrees, tolerance) in [(1.0, 1e-6), (20.0, 1e-3), (30.0, 1e-3), (40.0, 1e-2), (50.0, 0.06)] {
        let angle = f64::to_radians(degrees);
        let m = Material::<f64>::new(1.0, 0.2, angle, 0.0, YieldSurface::MatsuokaNakai);
        let want = 9.0 + 8.0 * angle.tan().powi(2);
        let (mut dice, mut seen) = (Dice::new(17), 0);
        for (return_map, _) in (0..500).flat_map(|_| MAPS) {
            let trial = plus_diagonal(dice.many::<6>(0.02), -0.01);
            let (tau, strain, q) = return_map(&m, trial, [0.0; 2]);
            // What was elastic, or has no stress left, is not on the surface.
            if q > 0.0 || (0..6).all(|i| (strain[i] - trial[i]).abs() < 1e-9) {
                continue;
            }
            let i1 = trace(tau);
            let i2 = 0.5 * (i1 * i1 - inner(tau, tau));
            let found = i1 * i2 / determinant(tau);
            assert!((found / want - 1.0).abs() < tolerance, "{degrees} deg: {found}, not {want}");
            seen += 1;
        }
        assert!(seen > 200, "{degrees} deg: {seen} on the surface");
    }
}

/// The paper's form: `F = U S V^T`, Hencky strains `ln s_i`, the same cone, `F' = U S' V^T`.
#[test]
fn the_strain_form_agrees_with_deformation_gradient_and_svd() {
    use nalgebra::{Matrix3, Vector3};
    let cases = [0.0, 0.003].into_iter().flat_map(|c| SURFACES.map(|s| (c, s)));
    for ((cohesion, surface), (return_map, _)) in cases.flat_map(|case| MAPS.map(|map| (case, map))) {
        let m = sand(cohesion, surface);
        let mut dice = Dice::new(77);
        let mut f = Matrix3::<f64>::identity();
        let (mut strain, mut q) = ([0.0; 6], 0.0);
        let mut volume = 0.0;
        let mut seen = [0; 3];
        for step in 0..3000 {
            // Mostly compression and shear, with spells of opening, so that all branches are met.
            let squeeze = if step % 100 < 60 { -1.5e-4 } else { 1.6e-4 };
            let l: Mat3<f64> = std::array::from_fn(|i| {
                std::array::from_fn(|j| 3e-3 * dice.roll() + if i == j { squeeze } else { 0.0 })
            });
            let (tau, new, q_new) = return_map(&m, trial_strain(strain, &l), [q, 0.0]);
            (strain, q) = (new, q_new);

            let l = Matrix3::from_fn(|i, j| l[i][j]);
            let svd = ((Matrix3::identity() + l) * f).svd(true, true);
            let (u, v_t) = (svd.u.expect("asked for"), svd.v_t.expect("asked for"));
            let eps = svd.singular_values.map(|s| s.ln() + volume / 3.0);
            let t = eps.sum();
            let e = eps - Vector3::repeat(t / 3.0);
            let n = e.norm();
            let (narrowing, _) = m.narrowing(LODE_FACTOR * e.product() / n.powi(3));
            let excess = n + m.slope * (t - m.apex) / narrowing;
            let (new, branch) = if t >= m.apex {
                volume = t - m.apex;
                (Vector3::repeat(m.apex / 3.0), 2)
            } else if excess <= 0.0 {
                volume = 0.0;
                (eps, 0)
            } else {
                volume = 0.0;
                (eps - e * (excess / n), 1)
            };
            seen[branch] += 1;
            f = u * Matrix3::from_diagonal(&new.map(f64::exp)) * v_t;
            let hencky = new * (2.0 * m.mu) + Vector3::repeat(m.lambda * new.sum());
            let want_tau = u * Matrix3::from_diagonal(&hencky) * u.transpose();
            let want_strain = f * f.transpose() - Matrix3::identity();
            let (tau, strain) = (full(tau), full(strain));
            for i in 0..3 {
                for j in 0..3 {
                    assert!((tau[i][j] - want_tau[(i, j)]).abs() < 1e-11, "stress, step {step}");
                    assert!((strain[i][j] - want_strain[(i, j)]).abs() < 1e-11, "strain, step {step}");
                }
            }
            assert!((q - volume).abs() < 1e-11);
        }
        assert!(seen.iter().all(|n| *n > 50), "branches met: {seen:?}");
    }
}

fn turned() -> OrientedBox<f64> {
    let cuboid =
        Cuboid { centre_m: [0.1, 0.2, -0.1], size_m: [0.9, 0.3, 0.7], rotation_deg: [25.0, -40.0, 110.0] };
    OrientedBox { centre: cuboid.centre_m, half: cuboid.size_m.map(|edge| 0.5 * edge), axes: cuboid.axes() }
}

fn shapes() -> Vec<Shape<f64>> {
    vec![
        Shape::HalfSpace(HalfSpace),
        Shape::AlignedBox(AlignedBox { centre: [0.1, -0.2, 0.05], half: [0.5, 0.4, 0.2] }),
        Shape::Bowl(Bowl { radius: 0.8, half: 0.12 }),
        Shape::Tube(Tube { radius: 0.6, half_radial: 0.1, height: 0.2, half_axial: 0.5 }),
        Shape::Capsule(Capsule { from: [-0.3, 0.1, 0.0], along: [0.7, -0.2, 0.4], radius: 0.15 }),
        Shape::OrientedBox(turned()),
    ]
}

#[test]
fn normals_are_the_gradients_of_the_distances() {
    let mut dice = Dice::new(31);
    for shape in shapes() {
        for _ in 0..400 {
            let y: [f64; 3] = dice.many(1.2);
            with_solid!(shape, solid => {
                let (_, n) = solid.distance::<f64>(y);
                for k in 0..3 {
                    let at = |h: f64| {
                        let mut y = y;
                        y[k] += h;
                        solid.distance::<f64>(y).0
                    };
                    let (right, left) = ((at(1e-6) - at(0.0)) / 1e-6, (at(0.0) - at(-1e-6)) / 1e-6);
                    // Not at the edges of the nearest face, where the normal jumps.
                    if (right - left).abs() < 1e-3 {
                        assert!((0.5 * (right + left) - n[k]).abs() < 1e-4, "{shape:?} at {y:?}");
                    }
                }
                let length = n.iter().map(|n| n * n).sum::<f64>().sqrt();
                assert!((length - 1.0).abs() < 1e-9, "{shape:?} at {y:?}: normal of length {length}");
            });
        }
    }
}

/// Position, velocity, and all that moves the body, as one vector.
fn contact_of<D: SignedDistance<f64>>(
    solid: &D,
    law: &ContactParams<f64>,
    base: &BodyState<f64>,
    x: &[f64],
) -> [f64; 3] {
    use nalgebra::{Matrix3, Rotation3, Vector3};
    let turn = Rotation3::from_scaled_axis(Vector3::new(x[9], x[10], x[11])).into_inner();
    let rotation = turn * Matrix3::from_fn(|i, j| base.rotation[i][j]);
    let body = BodyState {
        rotation: std::array::from_fn(|i| std::array::from_fn(|j| rotation[(i, j)])),
        position: [x[6], x[7], x[8]],
        velocity: [x[12], x[13], x[14]],
        angular_velocity: [x[15], x[16], x[17]],
    };
    contact(solid, &body, law, [x[0], x[1], x[2]], [x[3], x[4], x[5]])
}

#[test]
fn contact_has_taylor_slope_two_in_position_velocity_and_the_bodys_motion() {
    use nalgebra::{Rotation3, Vector3};
    let r = Rotation3::from_scaled_axis(Vector3::new(0.4, -0.3, 0.8)).into_inner();
    let mut dice = Dice::new(41);
    for shape in shapes() {
        let mut checked = 0;
        while checked < 40 {
            let nodes = checked % 2 == 0;
            let law = ContactParams {
                friction: 0.4,
                band: 0.3,
                inflation: if nodes { 0.05 } else { 0.0 },
                separation_factor: if nodes { 0.0 } else { 1.0 },
                pushout_rate: if nodes { 0.0 } else { 2.0 },
                max_pushout_speed: 0.7,
            };
            let base = BodyState {
                rotation: std::array::from_fn(|i| std::array::from_fn(|j| r[(i, j)])),
                position: [0.1, 0.2, -0.1],
                velocity: [0.0; 3],
                angular_velocity: [0.0; 3],
            };
            let point: [f64; 3] = dice.many(0.9);
            let free: [f64; 3] = dice.many(1.0);
            let twist: [f64; 6] = dice.many(0.5);
            let weight: [f64; 3] = dice.many(1.0);
            let x: Vec<f64> =
                point.into_iter().chain(free).chain(base.position).chain([0.0; 3]).chain(twist).collect();
            with_solid!(shape, solid => {
                let local = crate::small::tr_mul_vec(&base.rotation, crate::small::sub(point, base.position));
                if solid.distance::<f64>(local).0 > 0.9 * law.reach() {
                    continue;
                }
                let f = |x: &[f64]| {
                    let v = contact_of(&solid, &law, &base, x);
                    v[0] * weight[0] + v[1] * weight[1] + v[2] * weight[2]
                };
                let body = BodyState { velocity: [twist[0], twist[1], twist[2]], angular_velocity: [twist[3], twist[4], twist[5]], ..base };
                let b = contact_adjoint(&solid, &body, &law, point, free, weight);
                let gradient: Vec<f64> = b.x.into_iter().chain(b.v).chain(b.x.map(|x| -x)).chain(b.rotation)
                    .chain(b.velocity).chain(b.angular_velocity).collect();
                let slope = taylor_slope(18, 7, 1e-5, &f, &x, &gradient);
                // A point within reach of a kink (contact opens, friction locks, nearest face changes) has slope 1
                // from every gradient; such points are rare, and a wrong gradient has slope 1 everywhere.
                if (slope - 2.0).abs() < 0.1 {
                    checked += 1;
                } else {
                    assert!(slope > 0.9 && kink_nearby(&f, &x), "{shape:?} at {point:?}: slope {slope}");
                }
            });
        }
    }
}

/// Whether the one-sided slopes of `f` along a coordinate differ within the reach of the Taylor test.
fn kink_nearby(f: &dyn Fn(&[f64]) -> f64, x: &[f64]) -> bool {
    (0..x.len()).any(|k| {
        let at = |h: f64| {
            let mut x = x.to_vec();
            x[k] += h;
            f(&x)
        };
        let h = 2e-5;
        let second = |centre: f64| ((at(centre + h) - 2.0 * at(centre) + at(centre - h)) / (h * h)).abs();
        second(0.0) > 10.0 * second(40.0 * h).max(second(-40.0 * h)) || second(0.0) > 1e3
    })
}
