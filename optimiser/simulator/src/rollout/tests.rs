//! Whole rollouts: their bits, and their derivative.

mod gates;

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use powderline_shared::displacement::Displacement;

use crate::mpm::Model;
use crate::rollout::path::Trajectory;
use crate::rollout::restart::{Carrying, Cut, Restarts};
use crate::rollout::{
    Destination, DisplacementGradient, Recording, RolloutError, Simulate, Simulator, SimulatorSettings,
    Snapshot, gradcheck, loss, outcome, quiet,
};
use crate::scene::{
    Aim, Cuboid, Flow, Infeasible, Scene, SleepBy, Sleepers, Tool, ToolShape, Transfer, VolumeCorrection,
    Walls, YieldSurface,
};
use crate::skill::{SkillMap, SkillParameter, Theta};

/// The small bench with the paper's powder, which is viscous, and with every part of it that can be another; and with walls of two sides,
/// the last ones' powder sleeping by the mean of its speeds, and the last one's loosened by shear.
fn benches() -> [Scene; 6] {
    let mut scene = Scene::load("bench-small").expect("shipped");
    scene.powder.yield_surface = YieldSurface::DruckerPrager;
    scene.powder.volume_correction = VolumeCorrection::Strain;
    scene.powder.transfer = None;
    scene.powder.viscosity_pa_s = 0.08;
    scene.domain.walls = Walls::Shared;
    scene.domain.sleep_by = SleepBy::Largest;
    scene.domain.sleepers = Sleepers::Moving;
    let mut other = scene.clone();
    other.powder.yield_surface = YieldSurface::MatsuokaNakai;
    other.powder.volume_correction = VolumeCorrection::Grid;
    let mut gets_back = other.clone();
    gets_back.powder.transfer = Some(Transfer { residue_time_s: 0.05 });
    gets_back.powder.flow = Some(Flow { grain_diameter_m: 5e-4, grain_density_kg_m3: 1667.0 });
    let two_sided = |scene: &Scene| {
        let mut scene = scene.clone();
        scene.domain.walls = Walls::TwoSided;
        scene
    };
    let [of_simple, mut of_all] = [two_sided(&scene), two_sided(&gets_back)];
    of_all.domain.sleep_by = SleepBy::MeanSquare;
    of_all.domain.sleepers = Sleepers::Still;
    let mut by_shear = of_all.clone();
    by_shear.powder.loosening_strain = Some(1.0);
    [scene, other, gets_back, of_simple, of_all, by_shear]
}

#[test]
fn threads_and_memory_change_no_bit_of_loss_and_gradient() {
    benches().into_iter().for_each(no_bit_changes);
}

fn no_bit_changes(mut scene: Scene) {
    // So that powder falls asleep, and is woken by the spoon, within these steps.
    scene.domain.sleep_speed_m_s = 0.01;
    scene.time.settle_s = 0.4;
    let map = SkillMap::new(&scene);
    let controls: Vec<_> = map.controls(&gradcheck::CHECKED_THETA).expect("fits")[..24].to_vec();
    let gradient = |threads: usize, memory_bytes: u64| {
        let settings = SimulatorSettings { seed: Some(1), threads: Some(threads), memory_bytes };
        let mut s = Simulator::<f32>::new(&scene, &settings).expect("threads");
        let start = s.initial_state(&mut quiet).expect("settles");
        let (evaluation, bars) = s.control_gradient(&start, &controls, &mut quiet).expect("runs");
        assert!(start.sleepers() > 0);
        let bits: Vec<[u64; 6]> = bars.iter().map(|b| b.map(f64::to_bits)).collect();
        (evaluation.loss.to_bits(), bits)
    };
    let one = gradient(1, 1 << 30);
    assert!(one.1.iter().flatten().any(|b| *b != 0));
    assert!(one == gradient(2, 1 << 30), "two threads");
    assert!(one == gradient(3, 64 << 20), "three threads and few checkpoints");
}

/// A restarted gradient has the same bits for any threads and memory; one that never restarts is the exact one, and one that does
/// is another.
#[test]
fn restarts_change_no_bit_by_threads_or_memory_and_are_what_makes_the_difference() {
    // Powder that is given back what the grid cannot hold.
    let mut scene = benches()[2].clone();
    scene.domain.cell_m *= 2.0;
    scene.time.substeps /= 2;
    let theta = gradcheck::CHECKED_THETA;
    let usual = Restarts::of_skill(&scene, &SkillMap::new(&scene), &theta);
    let simulator = |threads: usize, memory_bytes: u64| {
        let settings = SimulatorSettings { seed: Some(1), threads: Some(threads), memory_bytes };
        Simulator::<f32>::new(&scene, &settings).expect("threads")
    };
    let restarted = |threads: usize, memory_bytes: u64, restarts: &Restarts| {
        let mut s = simulator(threads, memory_bytes);
        s.evaluate_restarted(&theta, restarts).expect("runs")
    };
    let one = restarted(1, 1 << 30, &usual);
    assert_eq!(one, restarted(2, 1 << 30, &usual), "two threads");
    assert_eq!(one, restarted(16, 48 << 20, &usual), "sixteen threads and few checkpoints");
    // The same where the way back does not go through that, whatever the simulator did before.
    let past = Restarts { through_residue: false, ..usual.clone() };
    let of_past = restarted(1, 1 << 30, &past);
    assert_eq!(of_past, restarted(3, 48 << 20, &past), "few checkpoints");
    let mut used = simulator(2, 1 << 30);
    used.evaluate_restarted(&theta, &usual).expect("runs");
    assert_eq!(of_past, used.evaluate_restarted(&theta, &past).expect("runs"), "after another one");
    assert_ne!(of_past.gradient.map(f64::to_bits), one.gradient.map(f64::to_bits));
    let (exact, gradient) = simulator(2, 1 << 30).evaluate_with_gradient(&theta).expect("runs");
    let bits = |gradient: &[f64; 5]| gradient.map(f64::to_bits);
    assert_eq!(one.evaluation.loss.to_bits(), exact.loss.to_bits());
    assert_ne!(bits(&one.gradient), bits(&gradient));
    let without = restarted(2, 1 << 30, &usual.without_cuts());
    assert_eq!((exact, gradient), (without.evaluation, without.gradient));
}

/// Branches have a speed of their own below which powder sleeps: where all that has left the tool does, another slope is measured.
#[test]
fn powder_sleeps_in_branches_as_the_restarts_say() {
    let scene = Scene::load("bench-small").expect("shipped");
    let theta = gradcheck::CHECKED_THETA;
    let usual = Restarts::of_skill(&scene, &SkillMap::new(&scene), &theta);
    let carrying = usual.carrying.clone().expect("it carries");
    let mut s = Simulator::<f32>::new(&scene, &SimulatorSettings::default()).expect("threads");
    let mut restarted = |sleep_speed_m_s: f64| {
        let tilt = carrying.ways[2..].to_vec();
        let carrying = Some(Carrying { ways: tilt, sleep_speed_m_s, ..carrying.clone() });
        let restarts = Restarts { steps: Vec::new(), carrying, ..usual.clone() };
        s.evaluate_restarted(&theta, &restarts).expect("runs")
    };
    let [one, asleep] = [carrying.sleep_speed_m_s, 100.0].map(&mut restarted);
    assert_eq!(asleep.evaluation.loss.to_bits(), one.evaluation.loss.to_bits());
    assert_ne!(asleep.gradient.map(f64::to_bits), one.gradient.map(f64::to_bits));
}

/// Carrying: tilting tool and powder over the pour costs what whole motions say that are tilted there; and the scene's loss as one of
/// one's own.
#[test]
fn what_is_carried_is_moved_as_a_body_and_a_custom_loss_has_the_same_bits() {
    let mut scene = Scene::load("bench-small").expect("shipped");
    scene.domain.cell_m *= 2.0;
    scene.time.substeps /= 2;
    let theta = gradcheck::CHECKED_THETA;
    let restarts = Restarts::of_skill(&scene, &SkillMap::new(&scene), &theta);
    let mut s = Simulator::<f32>::new(&scene, &SimulatorSettings::default()).expect("threads");
    let wanted = s.evaluate_restarted(&theta, &restarts).expect("runs");
    let carrying = restarts.carrying.as_ref().expect("it carries");
    let (tilt, controls) = (carrying.ways[2], SkillMap::new(&scene).controls(&theta).expect("fits"));
    let mut end = |sign: f64| s.simulate(&carrying.moved(&controls, &tilt, sign)).expect("runs").loss;
    let rise = 0.5 * (end(1.0) - end(-1.0));
    let moment = wanted.by_displacement[carrying.over.start].per_radian;
    let along: f64 = (0..3).map(|k| moment[k] * tilt.rotation()[k]).sum();
    assert!(rise != 0.0 && (along - rise).abs() < 1e-9 * rise.abs(), "{along} {rise}");
    // As a loss of one's own, the scene's has the same bits; that of a motion through all of which the adjoint goes as well.
    let own = |positions: &[[f64; 3]], costs: &mut [f64]| {
        costs.iter_mut().zip(loss::values(&scene, positions)).for_each(|(cost, of)| *cost = of.unwrap());
        loss::loss(&scene, positions).0
    };
    let (of_own, slopes) = s.restarted_gradient_of_custom_loss(&controls, &own, &restarts).expect("runs");
    assert_eq!((of_own.to_bits(), &slopes), (wanted.evaluation.loss.to_bits(), &wanted.by_displacement));
    let through_all = Restarts { carrying: None, ..restarts.clone() };
    let wanted = s.evaluate_restarted(&theta, &through_all).expect("runs");
    let (_, other) = s.restarted_gradient_of_custom_loss(&controls, &own, &through_all).expect("runs");
    assert!(other == wanted.by_displacement && other != slopes);
}

/// What goes back from where the digging ends is the exact derivative of a loss that is linear in the positions there, of the slopes,
/// and of what the tool's own pose has beside them. What comes after is what was measured of the body.
#[test]
fn the_derivative_of_the_digging_is_the_exact_one() {
    let mut scene = Scene::load("bench-small").expect("shipped");
    scene.domain.cell_m *= 2.0;
    scene.time.substeps /= 2;
    let (theta, map) = (gradcheck::CHECKED_THETA, SkillMap::new(&scene));
    let linear = map.linearise(&theta).expect("fits");
    // One body without any way to go: what it costs is not asked, and all the tool's pose has is what is taken from the grains.
    let usual = Restarts::of_skill(&scene, &map, &theta);
    let carrying = Carrying { ways: Vec::new(), ..usual.carrying.clone().expect("it carries") };
    let turn = carrying.from;
    let restarts = Restarts { steps: Vec::new(), carrying: Some(carrying), room_m: -1.0, ..usual };
    let mut s = Simulator::<f64>::new(&scene, &SimulatorSettings::default()).expect("threads");
    let mut positions = |steps: usize| s.final_positions_m(&linear.controls[..steps]).expect("runs");
    let (there, end) = (positions(turn), positions(linear.controls.len()));
    let values = loss::values(&scene, &end);
    let before = linear.controls[..turn].to_vec();
    let path = Trajectory::new(
        0,
        *map.start_pose(),
        before.clone(),
        scene.time.substeps,
        scene.time.control_period_s(),
    );
    let model = Model::<f64>::new(&scene);
    let bodies = &path.bodies(&model.gates, path.len() - 1);
    let tool = path.end().expect("it moves");
    let cut = Cut { scene: &scene, model: &model, bodies, tool, step: turn, restarts: &restarts };
    let slopes = cut.slopes(&there, &values);
    let loss = |x: &[[f64; 3]], gradient: &mut [[f64; 3]]| {
        gradient.copy_from_slice(&slopes);
        x.iter().zip(&slopes).map(|(x, s)| x[0] * s[0] + x[1] * s[1] + x[2] * s[2]).sum()
    };
    let (_, bars) = s.gradient_of_custom_loss(&before, &loss).expect("runs");
    let bars: Vec<[f64; 6]> = bars.iter().map(DisplacementGradient::components).collect();
    let restarted = s.evaluate_restarted(&theta, &restarts).expect("runs");
    assert_eq!(restarted.by_displacement.len(), linear.controls.len());
    let found = restarted.by_displacement.iter().map(|one| one.components().map(f64::to_bits));
    let expected = bars.iter().map(|bar| bar.map(f64::to_bits));
    assert!(bars.iter().flatten().any(|x| *x != 0.0));
    assert!(
        found.eq(expected.chain(std::iter::repeat_n([0.0f64.to_bits(); 6], linear.controls.len() - turn)))
    );
    assert_eq!((restarted.cuts.len(), restarted.shares.len()), (1, 2));
    assert_eq!(restarted.evaluation.loss.to_bits(), s.evaluate(&theta).expect("runs").loss.to_bits());
}

#[test]
fn a_gradient_ends_with_the_powder_of_a_simulation_sleepers_and_all() {
    let mut scene = Scene::load("bench-small").expect("shipped");
    scene.domain.sleep_speed_m_s = 0.01;
    scene.time.settle_s = 0.4;
    let map = SkillMap::new(&scene);
    let controls: Vec<_> = map.controls(&gradcheck::CHECKED_THETA).expect("fits")[..4].to_vec();
    let settings = SimulatorSettings { seed: Some(1), threads: Some(2), memory_bytes: 1 << 30 };
    let mut s = Simulator::<f32>::new(&scene, &settings).expect("threads");
    let start = s.initial_state(&mut quiet).expect("settles");
    let end = s.advanced(&start, &controls, &mut quiet).expect("runs");
    assert!(end.sleepers() > 0);
    let (evaluation, _) = s.control_gradient(&start, &controls, &mut quiet).expect("runs");
    assert_eq!(s.judge(&end).loss.to_bits(), evaluation.loss.to_bits());
}

#[test]
fn skills_evaluated_side_by_side_have_the_bits_of_skills_evaluated_alone() {
    let mut scene = Scene::load("bench-small").expect("shipped");
    // The beginnings of the skills differ in depth, in angle, in nothing, and in what comes later.
    scene.time.horizon_steps = 300;
    scene.domain.cell_m *= 2.0;
    scene.time.substeps /= 2;
    let skills: Vec<Theta> = [(0, 0.1), (1, 0.1), (1, -0.1), (4, 0.0), (3, 0.1), (4, 0.2), (4, -0.2)]
        .into_iter()
        .map(|(k, step)| gradcheck::CHECKED_THETA.moved(SkillParameter::ALL[k], step))
        .collect();
    let evaluate = |threads: usize, memory_bytes: u64| {
        let settings = SimulatorSettings { seed: Some(1), threads: Some(threads), memory_bytes };
        let mut s = Simulator::<f32>::new(&scene, &settings).expect("threads");
        let calls = Arc::new(AtomicUsize::new(0));
        let (counted, mut last) = (calls.clone(), 0.0);
        s.set_progress(Box::new(move |share| {
            assert!((last..=1.0).contains(&share));
            last = share;
            counted.fetch_add(1, Ordering::Relaxed);
            ControlFlow::Continue(())
        }));
        let all = s.evaluate_all(&skills);
        s.set_progress(Box::new(|_| ControlFlow::Continue(())));
        let calls = calls.load(Ordering::Relaxed);
        assert!(calls > 0 && calls < 300 * skills.len(), "beginnings are shared: {calls} steps");
        (all.expect("runs"), s)
    };
    let (side_by_side, mut s) = evaluate(3, 1 << 30);
    assert!(evaluate(1, 1 << 30).0 == side_by_side, "one thread");
    assert!(evaluate(3, 48 << 20).0 == side_by_side, "little memory");
    let alone: Vec<_> = skills.iter().map(|theta| s.evaluate(theta).expect("runs")).collect();
    assert!(side_by_side == alone);
    assert!(alone[0].loss.to_bits() != alone[1].loss.to_bits());
    let mut patience = 40;
    s.set_progress(Box::new(move |_| {
        patience -= 1;
        if patience > 0 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    }));
    assert_eq!(s.evaluate_all(&skills), Err(RolloutError::Stopped));
}

#[test]
fn a_worker_that_panics_ends_the_others() {
    let scene = Scene::load("bench-small").expect("shipped");
    let settings = SimulatorSettings { seed: Some(1), threads: Some(2), memory_bytes: 1 << 30 };
    let mut s = Simulator::<f32>::new(&scene, &settings).expect("threads");
    let skills = [0.1, -0.1, 0.2].map(|depth| Theta::MIDDLE.moved(SkillParameter::ScoopingDepth, depth));
    let mut calls = 0;
    s.set_progress(Box::new(move |_| {
        calls += 1;
        assert!(calls < 30, "on purpose");
        ControlFlow::Continue(())
    }));
    let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| s.evaluate_all(&skills)));
    assert!(panicked.is_err());
}

#[test]
fn the_gradient_of_a_scoop_agrees_with_central_differences() {
    benches().into_iter().for_each(scoop_agrees_with_differences);
}

fn scoop_agrees_with_differences(mut scene: Scene) {
    // How a sleeper's weight on its neighbours depends on its particles is left out.
    scene.domain.sleep_speed_m_s = 0.0;
    let map = SkillMap::new(&scene);
    let agrees = |seed: u64| {
        let settings = SimulatorSettings { seed: Some(seed), threads: None, memory_bytes: 1 << 30 };
        let mut s = Simulator::<f64>::new(&scene, &settings).expect("threads");
        let window = gradcheck::check_window(&mut s, &map, 12, 32).expect("runs");
        for c in &window.components {
            println!("seed {seed}: adjoint {:e}, error {:?}", c.adjoint, c.error);
        }
        assert!(window.components[0].adjoint != 0.0 && window.components[1].adjoint != 0.0);
        window.error < 1e-5
    };
    // Some grain may be at a kink, or at a jump, nearer than the smallest difference; of a wrong gradient no seed's agrees.
    assert!((1..=2).any(agrees));
}

/// A simulator whose powder sleeps, and a motion's first steps.
fn beginning(steps: usize) -> (Simulator<f32>, SkillMap, Vec<Displacement>) {
    let mut scene = Scene::load("bench-small").expect("shipped");
    scene.domain.sleep_speed_m_s = 0.01;
    scene.time.settle_s = 0.1;
    let map = SkillMap::new(&scene);
    let controls = map.controls(&gradcheck::CHECKED_THETA).expect("fits")[..steps].to_vec();
    let settings = SimulatorSettings { seed: Some(1), threads: Some(2), memory_bytes: 1 << 30 };
    (Simulator::new(&scene, &settings).expect("threads"), map, controls)
}

fn same_place((shown, end): (&[f32; 3], &[f64; 3])) -> bool {
    shown.map(f32::to_bits) == end.map(|x| (x as f32).to_bits())
}

#[test]
fn a_motion_that_is_looked_at_ends_as_one_that_is_not() {
    let (mut s, map, controls) = beginning(25);
    let alone = s.simulate(&controls).expect("runs");
    let positions = s.final_positions_m(&controls).expect("runs");
    for every in [1, 10, 25, 40] {
        let recording = Recording { anchor: map.start_pose(), controls: &controls, every };
        let (mut steps, mut last) = (Vec::new(), Vec::new());
        let mut observer = |snapshot: &Snapshot<'_>| {
            steps.push(snapshot.step);
            last = snapshot.positions_m.to_vec();
            assert_eq!(snapshot.positions_m.len(), snapshot.velocities_m_s.len());
            ControlFlow::Continue(())
        };
        let (evaluation, destinations) = s.record(&recording, &mut observer).expect("runs");
        assert_eq!(evaluation.loss.to_bits(), alone.loss.to_bits(), "{every}");
        assert_eq!(steps, (0..=25).step_by(every).collect::<Vec<_>>());
        assert_eq!(destinations.len(), positions.len());
        if 25 % every == 0 {
            assert!(last.iter().zip(&positions).all(same_place));
        }
        let refused = s.record(&recording, &mut |_| ControlFlow::Break(()));
        assert_eq!(refused.err(), Some(RolloutError::Stopped));
    }
    // Who asks for a stop is heard at each control step, however seldom somebody looks; and the end is told.
    for (every, stops_at) in [(40, 0.5), (10, 0.9), (25, 2.0)] {
        let (reached, steps) = (Arc::new(AtomicUsize::new(0)), 25.0);
        let told = Arc::clone(&reached);
        s.set_progress(Box::new(move |share| {
            told.store((share * steps) as usize, Ordering::Relaxed);
            if share >= stops_at { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        }));
        let recording = Recording { anchor: map.start_pose(), controls: &controls, every };
        let found = s.record(&recording, &mut |_| ControlFlow::Continue(()));
        assert_eq!(found.is_ok(), stops_at > 1.0, "{every}");
        let reached = reached.load(Ordering::Relaxed) as f64;
        assert!((reached - steps * f64::min(stops_at, 1.0)).abs() <= 1.0, "{every} {reached}");
    }
}

#[test]
fn a_motion_to_nowhere_and_motions_of_several_lengths_are_refused() {
    let (mut s, map, controls) = beginning(4);
    for broken in [f64::NAN, f64::INFINITY] {
        let mut nowhere = controls.clone();
        nowhere[2].translation_m[1] = broken;
        let refused = Some(RolloutError::Motion { step: 2 });
        assert_eq!(s.simulate(&nowhere).err(), refused);
        assert_eq!(s.simulate_with_gradient(&nowhere).err(), refused);
        let mut state = s.begin(map.start_pose()).expect("settles");
        s.advance(&mut state, &controls[..1]).expect("runs");
        assert_eq!(s.advance(&mut state, &nowhere[1..]).err(), refused);
    }
    let lengths = s.simulate_all(&[controls.clone(), controls[..3].to_vec()]).unwrap_err();
    assert_eq!(lengths, RolloutError::Lengths { first: 4, other: 3 });
}

/// Then it is no motion's fault, and no other one would do.
#[test]
fn powder_that_does_not_settle_is_said_to_be_that() {
    let mut scene = Scene::load("bench-small").expect("shipped");
    // Thrown out of the grid before anything moves.
    scene.domain.gravity_m_s2 = [0.0, 0.0, 5e3];
    let map = SkillMap::new(&scene);
    let mut s = Simulator::<f32>::new(&scene, &SimulatorSettings::default()).expect("threads");
    let error = s.simulate(&map.controls(&Theta::MIDDLE).expect("fits")).unwrap_err();
    assert!(matches!(error, RolloutError::Settling(_)) && !error.is_of_motion(), "{error}");
    assert!(error.to_string().starts_with("while the powder settles, before any motion: "), "{error}");
}

#[test]
fn a_motion_in_pieces_comes_to_the_same_bits_as_whole() {
    let (mut s, map, controls) = beginning(40);
    let whole = s.simulate(&controls).expect("runs");
    let positions = s.final_positions_m(&controls).expect("runs");
    let mut state = s.begin(map.start_pose()).expect("settles");
    // Another one beside it, which must not disturb it.
    let mut other = s.begin(map.start_pose()).expect("settles");
    for piece in [&controls[..7], &controls[7..7], &controls[7..30], &controls[30..]] {
        s.advance(&mut state, piece).expect("runs");
        s.advance(&mut other, &controls[..3]).expect("runs");
    }
    assert_eq!(s.judge(&state), whole);
    assert_eq!(*state.tool(), controls.iter().fold(*map.start_pose(), |pose, step| pose.displaced(step)));
    assert!(state.positions_m().iter().zip(&positions).all(same_place));
    let before = state.positions_m();
    let outwards = Displacement { translation_m: [-1.0, 0.0, 0.0], ..Displacement::default() };
    // So fast that powder is thrown out of the grid.
    let error = s.advance(&mut state, &[outwards; 3]).unwrap_err();
    let (RolloutError::Escaped { step, .. } | RolloutError::NonFinite { step, .. }) = error else {
        panic!("{error}")
    };
    assert!((40..43).contains(&step), "{step}");
    assert_eq!(state.positions_m(), before);
}

#[test]
fn the_gradient_of_controls_agrees_with_central_differences() {
    benches().into_iter().for_each(controls_agree_with_differences);
}

fn controls_agree_with_differences(mut scene: Scene) {
    // Without the kinks of particles that come to be among the wanted ones, or cease to.
    scene.objective.aim = Aim::All;
    scene.time.settle_s = 0.0;
    let map = SkillMap::new(&scene);
    let controls = &map.controls(&gradcheck::CHECKED_THETA).expect("fits")[..24];
    let settings = SimulatorSettings { seed: Some(1), threads: None, memory_bytes: 1 << 30 };
    let mut s = Simulator::<f64>::new(&scene, &settings).expect("threads");
    let whole = controls.to_vec();
    let (evaluation, slopes) = s.simulate_with_gradient(&whole).expect("runs");
    let simulated = s.simulate(&whole).expect("runs");
    assert_eq!(evaluation.loss.to_bits(), simulated.loss.to_bits());
    assert_eq!(slopes.len(), controls.len());
    // A direction of translations alone, in metres, and one of rotations alone, in radians.
    for half in [0..3, 3..6] {
        let direction = |step: usize, k: usize| {
            if half.contains(&k) { libm::sin((6 * step + k) as f64) } else { 0.0 }
        };
        let mut loss_at = |h: f64| {
            let moved = |(step, control): (usize, &Displacement)| {
                let control = control.components();
                Displacement::from(std::array::from_fn(|k| control[k] + h * direction(step, k)))
            };
            let moved: Vec<_> = controls.iter().enumerate().map(moved).collect();
            s.simulate(&moved).expect("runs").loss
        };
        let along = |(step, slope): (usize, &DisplacementGradient)| -> [f64; 6] {
            let slope = slope.components();
            std::array::from_fn(|k| slope[k] * direction(step, k))
        };
        let terms: Vec<f64> = slopes.iter().enumerate().flat_map(along).collect();
        // The terms may cancel; errors are measured by their sizes.
        let (adjoint, size) = (terms.iter().sum::<f64>(), terms.iter().map(|term| term.abs()).sum::<f64>());
        let error = |h: &f64| ((loss_at(*h) - loss_at(-h)) / (2.0 * h) - adjoint).abs() / size;
        // Kinks are nearer the longer a particle remembers its velocity; below 1e-9 there is rounding, more or less of it.
        let errors: Vec<f64> = [1e-7, 1e-8, 1e-9, 3e-10, 1e-10].iter().map(error).collect();
        println!("{half:?}: adjoint {adjoint:e} of {size:e}, errors {errors:?}");
        assert!(errors.iter().any(|error| *error < 1e-5), "{half:?}: {adjoint:e} {errors:?}");
    }
}

#[test]
fn a_loss_of_ones_own_is_differentiated_like_the_scenes() {
    let mut scene = Scene::load("bench-small").expect("shipped");
    scene.time.settle_s = 0.0;
    let map = SkillMap::new(&scene);
    let controls: Vec<_> = map.controls(&gradcheck::CHECKED_THETA).expect("fits")[..20].to_vec();
    let settings = SimulatorSettings::default();
    let mut s = Simulator::<f64>::new(&scene, &settings).expect("threads");
    let (usual, slopes) = s.simulate_with_gradient(&controls).expect("runs");
    let own = |positions: &[[f64; 3]], slopes: &mut [[f64; 3]]| {
        let (loss, gradient) = super::loss::loss(&scene, positions);
        slopes.copy_from_slice(&gradient);
        loss
    };
    let (loss, again) = s.gradient_of_custom_loss(&controls, &own).expect("runs");
    assert_eq!(loss.to_bits(), usual.loss.to_bits());
    assert!(slopes == again && slopes.iter().any(|slope| slope.per_metre[2] != 0.0));
    // A multiple of it has as much of a slope.
    let twice = |positions: &[[f64; 3]], slopes: &mut [[f64; 3]]| {
        let loss = own(positions, slopes);
        slopes.iter_mut().flatten().for_each(|slope| *slope *= 2.0);
        2.0 * loss
    };
    let (loss, doubled) = s.gradient_of_custom_loss(&controls, &twice).expect("runs");
    assert_eq!(loss.to_bits(), (2.0 * usual.loss).to_bits());
    for (one, two) in slopes.iter().zip(&doubled) {
        assert_eq!(one.components().map(|g| (2.0 * g).to_bits()), two.components().map(f64::to_bits));
    }
    // What it does not write is no slope.
    let (_, none) = s.gradient_of_custom_loss(&controls, &|_, _| 1.0).expect("runs");
    assert!(
        none.iter().flat_map(DisplacementGradient::components).all(|slope| slope.abs() < f64::MIN_POSITIVE)
    );
}

/// Inner dimensions of a scoop.
const SCOOP_M: [f64; 3] = [0.018, 0.016, 0.010];

/// The small bench with a scoop, and with the same scoop put together from cuboids.
fn scoops() -> [Scene; 2] {
    let mut scene = Scene::load("bench-small").expect("shipped");
    let ([l, w, h], t) = (SCOOP_M, scene.tool.wall_thickness_m);
    let cuboid = |centre_m: [f64; 3], half_m: [f64; 3]| Cuboid {
        centre_m,
        size_m: half_m.map(|edge| 2.0 * edge),
        rotation_deg: [0.0; 3],
    };
    let (hl, hw, half_height) = (0.5 * l, 0.5 * w, 0.5 * (h + t));
    let cuboids = vec![
        cuboid([-0.5 * t, 0.0, -h - 0.5 * t], [hl + 0.5 * t, hw + t, 0.5 * t]),
        cuboid([-hl - 0.5 * t, 0.0, -half_height], [0.5 * t, hw + t, half_height]),
        cuboid([-0.5 * t, hw + 0.5 * t, -half_height], [hl + 0.5 * t, 0.5 * t, half_height]),
        cuboid([-0.5 * t, -hw - 0.5 * t, -half_height], [hl + 0.5 * t, 0.5 * t, half_height]),
    ];
    let shapes = [ToolShape::BoxScoop { inner_size_m: SCOOP_M }, ToolShape::Cuboids { cuboid: cuboids }];
    shapes.map(|shape| {
        scene.tool.shape = shape;
        scene.clone()
    })
}

/// A scoop put together from cuboids is the scoop: the same bits.
#[test]
fn a_scoop_of_cuboids_moves_powder_as_the_scoop_does() {
    let [scoop, cuboids] = scoops();
    let skill = SkillMap::new(&scoop).controls(&gradcheck::CHECKED_THETA).expect("fits");
    let controls: Vec<_> = skill[..80].to_vec();
    let gradient = |scene: &Scene| {
        let mut scene = scene.clone();
        scene.time.settle_s = 0.0;
        let mut s = Simulator::<f32>::new(&scene, &SimulatorSettings::default()).expect("threads");
        let (evaluation, slopes) = s.simulate_with_gradient(&controls).expect("runs");
        (evaluation.loss.to_bits(), slopes)
    };
    let found = gradient(&scoop);
    assert!(found == gradient(&cuboids));
    // One that has no floor carries something else.
    let mut floorless = cuboids;
    if let ToolShape::Cuboids { cuboid } = &mut floorless.tool.shape {
        cuboid.remove(0);
    }
    assert!(found.0 != gradient(&floorless).0);
}

/// It reaches as far, its handle begins where the scoop's does, and it may not start where the scoop may not.
#[test]
fn a_scoop_of_cuboids_stands_where_the_scoop_does() {
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
    let [scoop, cuboids] = scoops();
    let reach = |tool: &Tool| [tool.body_extent_m(), tool.handle_axis_m()].concat().concat();
    reach(&scoop.tool).into_iter().zip(reach(&cuboids.tool)).for_each(|(a, b)| near(a, b));
    // The body is the farthest only of a tool with a short handle.
    let radius_m = |scene: &Scene, length_m: f64| {
        let mut tool = scene.tool.clone();
        tool.handle.length_m = length_m;
        tool.bounding_radius_m()
    };
    for length_m in [0.001, 0.03] {
        near(radius_m(&scoop, length_m), radius_m(&cuboids, length_m));
    }
    assert!(radius_m(&cuboids, 0.001) < radius_m(&cuboids, 0.03));

    let refused = |scene: &Scene, height_mm: u8| {
        let mut scene = scene.clone();
        scene.tool.start_position_m[2] = 1e-3 * f64::from(height_mm);
        scene.clone().into_spec().validate_as("it").err().map(|error| error.to_string())
    };
    let answers: Vec<_> = (15..65).map(|mm| [&scoop, &cuboids].map(|scene| refused(scene, mm))).collect();
    assert!(answers.iter().all(|[a, b]| a == b), "{answers:#?}");
    let says = |what: &str| answers.iter().flatten().flatten().any(|text| text.contains(what));
    assert!(says("overlaps the powder") && answers.iter().flatten().any(Option::is_none), "{answers:#?}");
}

/// Its lip is the edge that is the furthest forward: that of the scoop, but for the floor's thickness.
#[test]
fn the_lip_of_a_scoop_of_cuboids_is_the_scoops() {
    for lean_deg in [0.0f64, 30.0] {
        let [gap_m, other_m] = scoops().map(|mut scene| {
            scene.tool.start_pitch_deg = -lean_deg;
            (scene.skill.scooping_angle_deg, scene.skill.pouring_angle_deg) = ([0.0; 2], [0.0; 2]);
            scene.skill.transport_displacement_m = [0.01, 0.02];
            match scene.check_feasible() {
                Err(Infeasible::OutOfReach { gap_m, .. }) => gap_m,
                other => panic!("{other:?}"),
            }
        });
        let lower_m = libm::sin(lean_deg.to_radians()) * 0.004;
        assert!((gap_m - other_m - lower_m).abs() < 1e-12, "{lean_deg}: {gap_m} {other_m}");
    }
}

/// What lies in a scoop, or heaped upon it, lies on it: of cuboids as well, in the box a wall's thickness around them.
#[test]
fn a_scoop_of_cuboids_holds_what_the_scoop_holds() {
    let [scoop, cuboids] = scoops();
    let ([l, w, h], t) = (SCOOP_M, scoop.tool.wall_thickness_m);
    let tool = *SkillMap::new(&scoop).start_pose();
    let held = |scene: &Scene, points: Vec<[f64; 3]>| {
        let world = |point: [f64; 3]| tool.world_from_tool(&point.into()).into();
        let world: Vec<[f64; 3]> = points.into_iter().map(world).collect();
        let at_rest = vec![[0.0; 3]; world.len()];
        let grains = outcome::Grains { positions: &world, velocities: &at_rest };
        let on_tool = outcome::census(scene, grains, &tool).tool;
        let of = outcome::destinations(scene, grains, &tool);
        let held: Vec<bool> = of.into_iter().map(|it| it == Destination::Tool).collect();
        assert_eq!(held.iter().filter(|it| **it).count(), on_tool as usize);
        held
    };
    let sides = [-0.9, 0.0, 0.9];
    let point = |i: usize| [0.5 * l * sides[i % 3], 0.5 * w * sides[i / 3 % 3], h * sides[i / 9]];
    for scene in [&scoop, &cuboids] {
        assert!(held(scene, (0..27).map(point).collect()).into_iter().all(|it| it));
    }
    // Just inside and just outside of each side of a box.
    let around = |low: [f64; 3], high: [f64; 3]| {
        let beside = |(axis, at_m): (usize, f64)| {
            [-1e-6, 1e-6].map(|off_m| {
                let mut point = [0.0; 3];
                point[axis] = at_m + off_m * at_m.signum();
                point
            })
        };
        low.into_iter().enumerate().chain(high.into_iter().enumerate()).flat_map(beside).collect()
    };
    let outside = [0.5 * l + t, 0.5 * w + t, h + t];
    let in_and_out = [true, false].repeat(6);
    assert_eq!(held(&scoop, around(outside.map(|x| -x), outside)), in_and_out);
    let [x, y, z] = outside.map(|x| x + t);
    assert_eq!(held(&cuboids, around([-x, -y, -z], [x - t, y, z])), in_and_out);
}
