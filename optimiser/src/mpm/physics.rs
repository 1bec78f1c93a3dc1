//! Whole substeps: their derivative, what they conserve, and the physics that a powder must show.

use powderline_shared::plan::Precision;
use powderline_shared::pose::{Pose, exp_so3};

use crate::mpm::Model;
use crate::mpm::contact::Motion;
use crate::mpm::material::return_map;
use crate::mpm::particles::{Group, Particles, mat_of, set_mat, set_vec, vec_of};
use crate::mpm::substep::{State, Workspace, unsort_bar};
use crate::mpm::tests::Dice;
use crate::real::Real;
use crate::rollout::path::{displacement, resting};
use crate::rollout::{SimulatorSettings, gradcheck, simulator};
use crate::scene::{Scene, ToolShape};
use crate::skill::SkillMap;
use crate::small::{cross, sub};

fn bench_small() -> Scene {
    Scene::load("bench-small").expect("shipped")
}

fn far_away<T: Real>() -> Motion<T> {
    resting(&Pose { position_m: [9.0, 9.0, 9.0].into(), orientation: exp_so3(&[0.0; 3].into()) })
}

fn run<T: Real>(model: &Model<T>, tool: &Motion<T>, positions: &[[f64; 3]], substeps: usize) -> State<T> {
    let mut state = State::new(model, &Particles::at_rest(positions)).expect("on the grid");
    let mut workspace = Workspace::new();
    for _ in 0..substeps {
        workspace.advance(model, tool, &mut state).expect("on the grid");
    }
    state
}

/// Points of a lattice of `spacing` within a box for which `keep` holds.
fn lattice(low: [f64; 3], high: [f64; 3], spacing: f64, keep: impl Fn([f64; 3]) -> bool) -> Vec<[f64; 3]> {
    let count = |a: usize| ((high[a] - low[a]) / spacing).round() as usize;
    let at = |i: usize, a: usize| low[a] + (i as f64 + 0.5) * spacing;
    let mut out = Vec::new();
    for i in 0..count(0) {
        for j in 0..count(1) {
            out.extend((0..count(2)).map(|k| [at(i, 0), at(j, 1), at(k, 2)]).filter(|p| keep(*p)));
        }
    }
    out
}

/// A state in the middle of scooping, and the tool's motion there.
fn scooping() -> (Model<f64>, State<f64>, Motion<f64>) {
    let scene = bench_small();
    let map = SkillMap::new(&scene);
    let controls: Vec<_> =
        map.controls(&gradcheck::CHECKED_THETA).expect("fits").iter().map(displacement).collect();
    let path = crate::rollout::path::Path::new(
        *map.start_pose(),
        controls,
        scene.time.substeps,
        scene.time.control_period_s(),
    );
    let model = Model::new(&scene);
    let mut state =
        State::new(&model, &Particles::at_rest(&scene.particle_positions_m(1))).expect("on the grid");
    let mut workspace = Workspace::new();
    let begun = 22 * scene.time.substeps as usize;
    for substep in 0..begun {
        workspace.advance(&model, &path.motion(substep), &mut state).expect("on the grid");
    }
    (model, state, path.motion(begun))
}

/// Sum of products of all numbers of all particles, in the order of identities.
fn inner(state: &State<f64>, weights: &[[f64; 22]]) -> f64 {
    let mut sum = 0.0;
    for (g, l, id) in state.particles.living() {
        let group = &state.particles.groups[g];
        for (row, w) in group.rows().zip(&weights[id as usize]) {
            sum += row[l] * w;
        }
    }
    sum
}

#[test]
fn a_substep_in_the_middle_of_scooping_has_the_derivative_its_adjoint_says() {
    let (model, state, tool) = scooping();
    let count = state.particles.living().count();
    let mut dice = Dice::new(3);
    // Scales make every kind of number matter about equally.
    let scales: [f64; 22] = std::array::from_fn(|row| {
        [1e3, 1.0, 1e-2, 1.0, 1.0][[3, 6, 15, 21, 22].iter().position(|e| row < *e).unwrap()]
    });
    let weights: Vec<[f64; 22]> =
        (0..count).map(|_| std::array::from_fn(|r| scales[r] * dice.roll())).collect();
    let moves: Vec<[f64; 22]> =
        (0..count).map(|_| std::array::from_fn(|r| 1e-3 / scales[r] * dice.roll())).collect();
    let tool_moves: [f64; 12] = std::array::from_fn(|k| [1e-6, 1e-4, 1e-3, 1e-2][k / 3] * dice.roll());

    let loss_at = |h: f64| {
        let mut moved = state.clone();
        for (g, l, id) in state.particles.living() {
            let rows = moved.particles.groups[g].rows_mut();
            for (row, m) in rows.zip(&moves[id as usize]) {
                row[l] += h * m;
            }
        }
        let mut body = tool;
        let t = |k: usize| tool_moves[k] * h;
        let turn = exp_so3(&[t(3), t(4), t(5)].into()).to_rotation_matrix().into_inner();
        let before = nalgebra::Matrix3::from_fn(|i, j| tool.rotation[i][j]);
        let after = turn * before;
        for i in 0..3 {
            body.position[i] += t(i);
            body.velocity[i] += t(6 + i);
            body.angular_velocity[i] += t(9 + i);
            body.rotation[i] = std::array::from_fn(|j| after[(i, j)]);
        }
        let mut workspace = Workspace::new();
        workspace.advance(&model, &body, &mut moved).expect("on the grid");
        inner(&moved, &weights)
    };

    let mut end = state.clone();
    let mut workspace = Workspace::new();
    workspace.advance(&model, &tool, &mut end).expect("on the grid");
    let mut bar = vec![Group::ZERO; end.particles.groups.len()];
    for (g, l, id) in end.particles.living() {
        for (r, (row, w)) in bar[g].rows_mut().zip(&weights[id as usize]).enumerate() {
            // A stored off-diagonal strain stands for two entries of the tensor.
            row[l] = if (18..21).contains(&r) { 0.5 * w } else { *w };
        }
    }
    let mut bar = unsort_bar(&end, bar);
    let tool_bar = workspace.retreat(&model, &tool, &state, &mut bar);
    let mut slope = 0.0;
    for (g, l, id) in state.particles.living() {
        for (r, (row, m)) in bar[g].rows().zip(&moves[id as usize]).enumerate() {
            slope += if (18..21).contains(&r) { 2.0 } else { 1.0 } * row[l] * m;
        }
    }
    let parts = [tool_bar.position, tool_bar.rotation, tool_bar.velocity, tool_bar.angular_velocity];
    slope += parts.iter().flatten().zip(tool_moves).map(|(b, m)| b * m).sum::<f64>();

    let error_at = |h: f64| ((loss_at(h) - loss_at(-h)) / (2.0 * h) / slope - 1.0).abs();
    let errors = [3e-4, 1e-4, 3e-5, 1e-5].map(error_at);
    println!("relative errors of central differences: {errors:?}, slope {slope}");
    assert!(errors.iter().any(|e| *e < 5e-6), "{errors:?}");
}

#[test]
fn free_flight_conserves_mass_momentum_and_angular_momentum() {
    let mut scene = bench_small();
    scene.domain.gravity_m_s2 = [0.0; 3];
    scene.container.clear();
    let model: Model<f64> = Model::new(&scene);
    let positions = lattice([0.06, 0.02, 0.04], [0.09, 0.04, 0.06], 0.002, |_| true);
    let mut state = State::new(&model, &Particles::at_rest(&positions)).expect("on the grid");
    let mut dice = Dice::new(8);
    for (g, l, _) in state.particles.living().collect::<Vec<_>>() {
        let group = &mut state.particles.groups[g];
        set_vec(&mut group.v, l, dice.many(0.2));
        let c: [f64; 9] = dice.many(20.0);
        set_mat(&mut group.c, l, [[c[0], c[1], c[2]], [c[3], c[4], c[5]], [c[6], c[7], c[8]]]);
        let strain: [f64; 6] = dice.many(0.004);
        for (row, e) in group.strain.iter_mut().zip(strain) {
            row[l] = e - 0.004;
        }
    }
    // Linear momentum, angular momentum (orbit and spin), per particle mass.
    let momenta = |state: &State<f64>| {
        let (mut p, mut j) = ([0.0; 3], [0.0; 3]);
        for (g, l, _) in state.particles.living() {
            let group = &state.particles.groups[g];
            let (x, v, c) = (vec_of(&group.x, l), vec_of(&group.v, l), mat_of(&group.c, l));
            let spin = [c[2][1] - c[1][2], c[0][2] - c[2][0], c[1][0] - c[0][1]];
            let orbit = cross(x, v);
            for i in 0..3 {
                p[i] += v[i];
                j[i] += orbit[i] + 0.25 * scene.domain.cell_m.powi(2) * spin[i];
            }
        }
        (p, j)
    };
    let before = momenta(&state);
    let mut workspace = Workspace::new();
    for _ in 0..50 {
        workspace.advance(&model, &far_away(), &mut state).expect("on the grid");
        let mass = workspace.mass_on_grid();
        let want = positions.len() as f64 * scene.particle_mass_kg();
        assert!((mass / want - 1.0).abs() < 1e-12, "{mass} kg on the grid, {want} kg of powder");
    }
    let after = momenta(&state);
    let scale = positions.len() as f64;
    for i in 0..3 {
        assert!((after.0[i] - before.0[i]).abs() < 1e-14 * scale, "momentum {:?} {:?}", before.0, after.0);
        assert!((after.1[i] - before.1[i]).abs() < 1e-14 * scale, "angular {:?} {:?}", before.1, after.1);
    }
}

#[test]
fn base_pressure_is_hydrostatic() {
    let mut scene = bench_small();
    for c in &mut scene.container {
        c.friction = 0.0;
    }
    let model: Model<f64> = Model::new(&scene);
    let positions = scene.particle_positions_m(1);
    let state = run(&model, &far_away(), &positions, 2000);
    let height = scene.powder.fill_max_m[2] - scene.powder.fill_min_m[2];
    // Vertical pressure of every particle against the weight of what lies above it: a straight line to the base.
    let (mut depths, mut pressures) = (Vec::new(), Vec::new());
    let top = scene.powder.fill_min_m[2] + height;
    for (g, l, _) in state.particles.living() {
        let group = &state.particles.groups[g];
        let strain = group.strain_of(l);
        let (tau, _, _) = return_map(&model.material, strain, 0.0);
        depths.push(top - group.x[2][l]);
        pressures.push(-tau[2]);
    }
    let n = depths.len() as f64;
    let (md, mp) = (depths.iter().sum::<f64>() / n, pressures.iter().sum::<f64>() / n);
    let cov: f64 = depths.iter().zip(&pressures).map(|(d, p)| (d - md) * (p - mp)).sum();
    let var: f64 = depths.iter().map(|d| (d - md) * (d - md)).sum();
    let base = mp + cov / var * (height - md);
    let want = scene.powder.density_kg_m3 * 9.81 * height;
    println!("base pressure {base:.2} Pa, hydrostatic {want:.2} Pa");
    assert!((base / want - 1.0).abs() < 0.05, "{base} Pa instead of {want} Pa");
}

#[test]
fn a_full_spoon_leaks_nothing_in_five_seconds() {
    let scene = Scene::load("bench").expect("shipped");
    let ToolShape::Bowl { inner_radius_m: r } = scene.tool.shape else { panic!("the bench has a bowl") };
    let centre = [0.12, 0.048, 0.12];
    let pose = Pose { position_m: centre.into(), orientation: exp_so3(&[0.0; 3].into()) };
    let inside = |p: [f64; 3]| {
        let d = sub(p, centre);
        crate::small::dot(d, d).sqrt() < r - 0.0005 && d[2] < -0.001
    };
    let low = centre.map(|c| c - 0.016);
    let positions = lattice(low, [centre[0] + 0.016, centre[1] + 0.016, centre[2]], 0.002, inside);
    let model: Model<f32> = Model::new(&scene);
    let state = run(&model, &resting(&pose), &positions, 10_000);
    let (mut leaked, mut over_the_rim) = (0, 0);
    for p in state.particles.positions_by_id() {
        let d = sub(p, centre);
        let far = crate::small::dot(d, d).sqrt() > r + 0.5 * scene.tool.wall_thickness_m;
        leaked += usize::from(far && d[2] < 0.0);
        over_the_rim += usize::from(far && d[2] >= 0.0);
    }
    println!("{} particles, {leaked} leaked, {over_the_rim} over the rim", positions.len());
    assert!(positions.len() > 800);
    assert_eq!((leaked, over_the_rim), (0, 0));
}

#[test]
fn a_pile_is_steeper_the_greater_the_friction_angle() {
    let slopes: Vec<f64> = [15.0, 30.0, 45.0]
        .into_iter()
        .map(|angle| {
            let mut scene = bench_small();
            scene.container.clear();
            scene.domain.size_m = [0.16, 0.16, 0.06];
            scene.domain.friction = 0.8;
            scene.powder.friction_angle_deg = angle;
            let model: Model<f32> = Model::new(&scene);
            let round = |p: [f64; 3]| (p[0] - 0.08).hypot(p[1] - 0.08) < 0.016;
            let positions = lattice([0.06, 0.06, 0.0], [0.1, 0.1, 0.024], 0.002, round);
            let end = run(&model, &far_away(), &positions, 1600).particles.positions_by_id();
            let mut heights: Vec<f64> = end.iter().map(|p| p[2]).collect();
            let mut radii: Vec<f64> = end.iter().map(|p| (p[0] - 0.08).hypot(p[1] - 0.08)).collect();
            heights.sort_by(f64::total_cmp);
            radii.sort_by(f64::total_cmp);
            let high = |v: &[f64]| v[v.len() * 98 / 100];
            (high(&heights) / high(&radii)).atan().to_degrees()
        })
        .collect();
    println!("slopes of the pile at friction angles of 15, 30, 45 deg: {slopes:.1?} deg");
    assert!(slopes.windows(2).all(|s| s[1] > s[0] + 1.0), "{slopes:?}");
}

#[test]
fn threads_and_memory_change_no_bit_of_loss_and_gradient() {
    let scene = bench_small();
    let map = SkillMap::new(&scene);
    let controls: Vec<_> =
        map.controls(&gradcheck::CHECKED_THETA).expect("fits")[..24].iter().map(displacement).collect();
    let gradient = |threads: usize, memory_bytes: u64| {
        let settings =
            SimulatorSettings { seed: 1, precision: Precision::F32, threads: Some(threads), memory_bytes };
        let mut s = simulator::<f32>(&scene, &settings).expect("threads");
        let start = s.beginning(&mut |_, _| true).expect("settles");
        let (evaluation, bars) = s.control_gradient(&start, &controls, &mut |_, _| true).expect("runs");
        let bits: Vec<[u64; 6]> = bars.iter().map(|b| b.map(f64::to_bits)).collect();
        (evaluation.loss.to_bits(), bits)
    };
    let one = gradient(1, 1 << 30);
    assert!(one.1.iter().flatten().any(|b| *b != 0));
    assert!(one == gradient(2, 1 << 30), "two threads");
    assert!(one == gradient(3, 52 << 20), "three threads and few checkpoints");
}

#[test]
fn the_gradient_of_a_scoop_agrees_with_central_differences() {
    let scene = bench_small();
    let settings =
        SimulatorSettings { seed: 1, precision: Precision::F64, threads: None, memory_bytes: 1 << 30 };
    let mut s = simulator::<f64>(&scene, &settings).expect("threads");
    let map = SkillMap::new(&scene);
    let window = gradcheck::check_window(&mut s, &map, 12, 32, &mut |_, _| true).expect("runs");
    for c in &window.components {
        println!("adjoint {:e}, error {:?}", c.adjoint, c.error);
    }
    assert!(window.components[0].adjoint != 0.0 && window.components[1].adjoint != 0.0);
    assert!(window.error < 1e-5, "{}", window.error);
}
