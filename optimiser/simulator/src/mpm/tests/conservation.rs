//! Mass, linear and angular momentum in free flight.
//!
//! Angular momentum of a particle is `x cross m v` and that of its affine velocity, `m dx^2/4` times the axial
//! vector of `C` (Jiang et al. 2017, "An angular momentum conserving affine-particle-in-cell method").

use crate::mpm::Model;
use crate::mpm::particles::{Lanes, Particles, mat_of, vec_of};
use crate::mpm::substep::State;
use crate::mpm::tests::{Dice, advance, empty_bench, far_away, lattice, on_grid, row, to_tiles};
use crate::real::Real;
use crate::scene::{Scene, Transfer};
use crate::small::cross;

const SUBSTEPS: usize = 20;

/// Time in which the velocity residue decays, where it is given back, s.
const RESIDUE_S: f64 = 0.05;

/// A stirred cloud in the middle of an empty box without gravity. Viscosity is on.
fn cloud<T: Real>() -> (Model<T>, State<T>) {
    cloud_in(&free_bench())
}

fn free_bench() -> Scene {
    let mut scene = empty_bench([0.064; 3]);
    scene.domain.gravity_m_s2 = [0.0; 3];
    scene
}

fn cloud_in<T: Real>(scene: &Scene) -> (Model<T>, State<T>) {
    let mut dice = Dice::new(61);
    let model = Model::<T>::new(scene);
    assert!(model.viscous_loss > T::ZERO);
    let points = lattice([0.022, 0.023, 0.021], [0.042, 0.043, 0.039], 0.002, &mut dice);
    let mut state = State::new(&model, &far_away(), &Particles::at_rest(&points)).unwrap();
    let places: Vec<_> = state.particles.occupied().collect();
    for (g, l, _) in places {
        for k in 3..21 {
            let number = match k {
                3..6 => [0.2, -0.1, 0.05][k - 3] + 0.2 * dice.roll(),
                6..15 => 8.0 * dice.roll(),
                // Mostly compressed, so that there is stress.
                15..18 => -0.02 + 0.02 * dice.roll(),
                _ => 0.01 * dice.roll(),
            };
            row(&mut state.particles.groups[g], k)[l] = T::from_f64(number);
        }
    }
    (model, state)
}

/// Linear and angular momentum, and the sums of the absolute values of their terms.
fn momenta<T: Real>(model: &Model<T>, state: &State<T>) -> ([f64; 6], [f64; 6]) {
    let (m, dx) = (model.mass.to_f64(), model.grid.dx);
    let (mut sum, mut size) = ([0.0; 6], [0.0; 6]);
    for (g, l, _) in state.particles.occupied() {
        let group = &state.particles.groups[g];
        let (x, v) = (vec_of(&group.x, l).map(T::to_f64), vec_of(&group.v, l).map(T::to_f64));
        let c = mat_of(&group.c, l).map(|row| row.map(T::to_f64));
        let orbital = cross(x, v);
        let spin = [c[2][1] - c[1][2], c[0][2] - c[2][0], c[1][0] - c[0][1]].map(|w| 0.25 * dx * dx * w);
        for i in 0..3 {
            sum[i] += m * v[i];
            sum[3 + i] += m * (orbital[i] + spin[i]);
            size[i] += m * v[i].abs();
            size[3 + i] += m * (orbital[i].abs() + spin[i].abs());
        }
    }
    (sum, size)
}

fn relative_drift<T: Real>() -> f64 {
    let (model, mut state) = cloud::<T>();
    let (before, size) = momenta(&model, &state);
    advance(&model, &far_away(), &mut state, SUBSTEPS);
    let (after, _) = momenta(&model, &state);
    (0..6).map(|i| (after[i] - before[i]).abs() / size[i]).fold(0.0, f64::max)
}

fn relative_mass_error<T: Real>() -> f64 {
    let (model, state) = cloud::<T>();
    let tiles = to_tiles(&model, &state).tiles;
    let (nodes, _) = on_grid(&model, &far_away(), &state, &tiles);
    let on_grid: f64 = nodes.iter().flatten().map(|n| n[3].to_f64()).sum();
    let in_particles = model.mass.to_f64() * state.particles.occupied().count() as f64;
    (on_grid / in_particles - 1.0).abs()
}

#[test]
fn free_flight_keeps_mass_and_momenta_to_rounding() {
    let (mass, drift) = (relative_mass_error::<f64>(), relative_drift::<f64>());
    println!("f64: mass {mass:.1e}, momenta over {SUBSTEPS} substeps {drift:.1e}");
    assert!(mass < 1e-14 && drift < 1e-14, "{mass} {drift}");
    let (mass, drift) = (relative_mass_error::<f32>(), relative_drift::<f32>());
    println!("f32: mass {mass:.1e}, momenta over {SUBSTEPS} substeps {drift:.1e}");
    assert!(mass < 1e-6 && drift < 2e-6, "{mass} {drift}");
}

/// What the tests above would miss if stress, spin and viscosity were all absent: the motion changes, and viscosity
/// takes energy.
#[test]
fn viscosity_slows_the_strain_rate_and_nothing_else() {
    let energy = |model: &Model<f64>, mut state: State<f64>| {
        advance(model, &far_away(), &mut state, SUBSTEPS);
        kinetic(&state)
    };
    let (mut model, state) = cloud::<f64>();
    let viscous = energy(&model, state.clone());
    model.viscous_loss = 0.0;
    let inviscid = energy(&model, state);
    println!("kinetic energy with viscosity over without: {:.4}", viscous / inviscid);
    assert!(viscous < inviscid);
}

/// What is given back has no momentum; that it has velocity, the energy shows. It has angular momentum: no part of the affine
/// velocities is given back.
#[test]
fn the_velocity_residue_that_is_given_back_has_no_momentum() {
    let mut scene = free_bench();
    let end = |scene: &Scene| {
        let (model, mut state) = cloud_in::<f64>(scene);
        let (before, size) = momenta(&model, &state);
        advance(&model, &far_away(), &mut state, SUBSTEPS);
        let (after, _) = momenta(&model, &state);
        let drift: [f64; 6] = std::array::from_fn(|i| (after[i] - before[i]).abs() / size[i]);
        (drift, kinetic(&state))
    };
    let (_, lost) = end(&scene);
    scene.powder.transfer = Some(Transfer { residue_time_s: RESIDUE_S });
    let (drift, kept) = end(&scene);
    println!("drift of momenta {drift:?}; energy over that without {:.2}", kept / lost);
    assert!(drift[..3].iter().all(|drift| *drift < 1e-14) && kept > 1.2 * lost, "{drift:?} {kept} {lost}");
}

/// Sum of the squares of the velocities.
fn kinetic<T: Real>(state: &State<T>) -> f64 {
    let of = |(g, l, _): (usize, usize, u32)| -> f64 {
        vec_of(&state.particles.groups[g].v, l).iter().map(|v| v.to_f64() * v.to_f64()).sum()
    };
    state.particles.occupied().map(of).sum()
}

/// A wave of shear four cells long, of which the grid cannot hold all; what is left of its energy after 10 ms depends on the number of
/// substeps, unless what the grid cannot hold decays by time.
#[test]
fn what_is_lost_in_a_time_does_not_depend_on_the_substeps() {
    let left = |substeps: u32, transfer: Option<Transfer>| {
        let mut scene = free_bench();
        scene.powder.transfer = transfer;
        scene.time.substeps = substeps;
        let (mut model, mut state) = cloud_in::<f64>(&scene);
        // Without stress; and so slow that the particles stay where they are.
        (model.stress_dx, model.viscous_loss) = (0.0, 0.0);
        for group in &mut state.particles.groups {
            (group.c, group.v) = ([Lanes::ZERO; 9], [Lanes::ZERO; 3]);
            for (v, x) in group.v[1].iter_mut().zip(group.x[0].iter()) {
                *v = 1e-4 * libm::sin(2.0 * std::f64::consts::PI * x / (4.0 * scene.domain.cell_m));
            }
        }
        let before = kinetic(&state);
        advance(&model, &far_away(), &mut state, substeps as usize);
        kinetic(&state) / before
    };
    let of = |transfer| [20, 80].map(|substeps| left(substeps, transfer));
    let [coarse, fine] = of(None);
    let [coarse_back, fine_back] = of(Some(Transfer { residue_time_s: RESIDUE_S }));
    println!("left without: {coarse:.4}, {fine:.4}; given back: {coarse_back:.4}, {fine_back:.4}");
    assert!((fine_back / coarse_back - 1.0).abs() < 0.02, "{coarse_back} {fine_back}");
    assert!(coarse < 0.5 * coarse_back && fine < 0.9 * coarse, "{coarse} {fine}");
}
