//! Rollouts past gates: from whatever state, in whatever pieces, and their derivative.

use powderline_shared::displacement::Displacement;

use crate::real::Real;
use std::ops::ControlFlow;

use crate::rollout::{Evaluation, Recording, Simulate, Simulator, SimulatorSettings, gradcheck, quiet};
use crate::scene::{Aim, FillShape, Gate, GateOpening, GateShape, Scene};
use crate::skill::{SkillMap, Theta};

/// The small bench with a column of powder in a pipe that lets go of it, and a plate before its upper half.
fn column(opens_at_s: f64, opening: GateOpening) -> Scene {
    let mut scene = Scene::load("bench-small").expect("shipped");
    scene.powder.fill_min_m = [0.032, 0.020, 0.004];
    scene.powder.fill_max_m = [0.056, 0.044, 0.018];
    scene.powder.fill_shape = FillShape::Cylinder;
    let pipe = Gate {
        name: "pipe".into(),
        position_m: [0.044, 0.032, 0.004],
        yaw_deg: 0.0,
        friction: 0.3,
        opens_at_s,
        shape: GateShape::Tube { inner_radius_m: 0.012, height_m: 0.016, wall_thickness_m: 0.004 },
        opening,
    };
    let plate = Gate {
        name: "plate".into(),
        position_m: [0.064, 0.032, 0.008],
        yaw_deg: 10.0,
        shape: GateShape::Box { size_m: [0.003, 0.020, 0.016] },
        opening: GateOpening::Vanish {},
        opens_at_s: opens_at_s + 0.03,
        ..pipe.clone()
    };
    scene.gates = vec![pipe, plate];
    assert_eq!(scene.clone().into_spec().validate_as("column").err(), None);
    scene
}

const LIFTED: GateOpening = GateOpening::Slide { velocity_m_s: [0.02, 0.0, 0.1], travel_m: 0.008 };

fn controls(scene: &Scene, steps: usize) -> Vec<Displacement> {
    SkillMap::new(scene).controls(&gradcheck::CHECKED_THETA).expect("fits")[..steps].to_vec()
}

fn simulator<T: Real>(scene: &Scene, threads: usize, memory_bytes: u64) -> Simulator<T> {
    let settings = SimulatorSettings { seed: Some(1), threads: Some(threads), memory_bytes };
    Simulator::new(scene, &settings).expect("threads")
}

/// Powder in a pipe over the source's edge, on a plate that goes: of what falls some is in the source, some on its rim, some beside
/// it, some falls yet, and no grain is in two places or in none.
#[test]
fn powder_that_starts_outside_the_source_is_all_accounted_for() {
    let mut scene = column(0.05, GateOpening::Vanish {});
    let source = scene.source().clone();
    let edge_m = source.position_m[0] - 0.022;
    let [_, y, z] = source.position_m;
    let height_m = z + source.inner_height_m() + 0.060;
    scene.powder.fill_min_m = [edge_m - 0.008, y - 0.008, height_m + 0.004];
    scene.powder.fill_max_m = [edge_m + 0.008, y + 0.008, height_m + 0.016];
    scene.gates.truncate(1);
    let lid = Gate {
        name: "lid".into(),
        position_m: [edge_m, y, height_m],
        shape: GateShape::Box { size_m: [0.024, 0.024, 0.004] },
        ..scene.gates[0].clone()
    };
    scene.gates[0].position_m = [edge_m, y, height_m + 0.004];
    scene.gates[0].opens_at_s = 9000.0;
    scene.gates.push(lid);
    assert_eq!(scene.clone().into_spec().validate_as("funnel").err(), None);
    let mut s = simulator::<f32>(&scene, 2, 1 << 30);
    let mut last = None;
    for steps in [2, 10, 60] {
        let controls = controls(&scene, steps);
        let census = s.simulate(&controls).expect("runs").census;
        assert_eq!(census.all() as usize, scene.particle_count(), "{census:?}");
        println!("{steps} {census:?}");
        last = Some(census);
    }
    let census = last.expect("there were some");
    assert!(census.source > 0 && census.spilled > 0, "{census:?}");
}

#[test]
fn threads_and_kept_states_change_no_bit_of_a_gradient_past_gates() {
    // So that powder sleeps in the pipe, far enough below the tool, and wakes when it has gone.
    let mut scene = column(0.06, GateOpening::Vanish {});
    scene.domain.sleep_speed_m_s = 0.01;
    scene.time.settle_s = 0.4;
    scene.tool.start_position_m[2] += 0.008;
    scene.skill.approach_m += 0.008;
    let controls = controls(&scene, 24);
    let gradient = |threads: usize, kept: usize| {
        let mut s = simulator::<f32>(&scene, threads, 1 << 30);
        s.set_max_checkpoints(kept);
        let start = s.initial_state(&mut quiet).expect("settles");
        assert!(start.sleepers() > 0);
        let (evaluation, bars) = s.control_gradient(&start, &controls, &mut quiet).expect("runs");
        let bits: Vec<[u64; 6]> = bars.iter().map(|b| b.map(f64::to_bits)).collect();
        (evaluation.loss.to_bits(), bits)
    };
    let one = gradient(1, usize::MAX);
    assert!(one.1.iter().flatten().any(|b| *b != 0));
    for (threads, kept) in [(1, 5), (2, usize::MAX), (7, 9)] {
        assert!(one == gradient(threads, kept), "{threads} threads, {kept} states");
    }
    let mut s = simulator::<f32>(&scene, 2, 1 << 30);
    let simulated = s.simulate(&controls).expect("runs");
    assert_eq!(simulated.loss.to_bits(), one.0);
}

/// Pieces of a motion end to end are the motion: a gate opens when it should, not when a piece begins.
#[test]
fn a_motion_past_gates_can_be_cut_anywhere() {
    let losses = [GateOpening::Vanish {}, LIFTED].map(|opening| {
        let mut scene = column(0.0503, opening);
        scene.domain.sleep_speed_m_s = 0.01;
        let controls = controls(&scene, 20);
        let mut s = simulator::<f32>(&scene, 2, 1 << 30);
        let whole = s.simulate(&controls).expect("runs");
        for every in [1, 3, 8] {
            let map = SkillMap::new(&scene);
            let recording = Recording { anchor: map.start_pose(), controls: &controls, every };
            let (recorded, _) = s.record(&recording, &mut |_| ControlFlow::Continue(())).expect("runs");
            assert_eq!(recorded.loss.to_bits(), whole.loss.to_bits(), "{every}");
        }
        let start = s.initial_state(&mut quiet).expect("settles");
        for at in [4, 5, 6, 13] {
            let (first, rest) = controls.split_at(at);
            let middle = s.advanced(&start, first, &mut quiet).expect("runs");
            let (end, _) = s.control_gradient(&middle, rest, &mut quiet).expect("runs");
            let all = s.evaluate_motions(&middle, vec![rest.to_vec(); 2], &mut quiet).expect("runs");
            assert!([end, all[0], all[1]].iter().all(|e| e.loss.to_bits() == whole.loss.to_bits()), "{at}");
        }
        whole.loss.to_bits()
    });
    let shut = column(9000.0, LIFTED);
    let mut s = simulator::<f32>(&shut, 2, 1 << 30);
    let held = s.simulate(&controls(&shut, 20)).expect("runs").loss.to_bits();
    assert!(losses[0] != losses[1] && losses[0] != held && losses[1] != held, "gates do something");
}

#[test]
fn skills_side_by_side_past_gates_have_the_bits_of_skills_alone() {
    let mut scene = column(0.2, GateOpening::Vanish {});
    scene.time.horizon_steps = 300;
    let skills: Vec<Theta> = [0.1, -0.1, 0.2]
        .map(|depth| [depth, 0.0, 0.0, 0.0, 0.3])
        .into_iter()
        .chain([[0.1; 5]])
        .map(Theta::clamped)
        .collect();
    let evaluate = |threads: usize| -> Vec<Evaluation> {
        let mut s = simulator::<f32>(&scene, threads, 1 << 30);
        s.evaluate_all(&skills).expect("runs")
    };
    let mut s = simulator::<f32>(&scene, 2, 1 << 30);
    let alone: Vec<_> = skills.iter().map(|theta| s.evaluate(theta).expect("runs")).collect();
    assert!(evaluate(1) == alone && evaluate(3) == alone);
    assert!(alone[0].loss.to_bits() != alone[1].loss.to_bits());
}

/// The pipe opens before the tool comes to the powder, or while it is in it; or it is lifted in the very last step, or while the
/// tool is in it.
#[test]
fn the_gradient_past_gates_agrees_with_central_differences() {
    for (opens_at_s, opening) in
        [(0.03, GateOpening::Vanish {}), (0.16, GateOpening::Vanish {}), (0.23, LIFTED), (0.15, LIFTED)]
    {
        let mut scene = column(opens_at_s, opening.clone());
        // Without the kinks of particles that come to be among the wanted ones, or cease to.
        scene.objective.aim = Aim::All;
        scene.time.settle_s = 0.0;
        let controls = controls(&scene, 24);
        let mut s = simulator::<f64>(&scene, 2, 1 << 30);
        let (_, slopes) = s.simulate_with_gradient(&controls).expect("runs");
        let direction = |step: usize, k: usize| libm::sin((6 * step + k) as f64);
        let mut loss_at = |h: f64| {
            let moved = |(step, control): (usize, &Displacement)| {
                let control = control.components();
                Displacement::from(std::array::from_fn(|k| control[k] + h * direction(step, k)))
            };
            let moved: Vec<_> = controls.iter().enumerate().map(moved).collect();
            s.simulate(&moved).expect("runs").loss
        };
        let adjoint: f64 = slopes
            .iter()
            .enumerate()
            .flat_map(|(step, slope)| {
                slope.components().into_iter().enumerate().map(move |(k, slope)| slope * direction(step, k))
            })
            .sum();
        // Among so many particles there is a kink next to anywhere: with one so near on one side, the other side tells.
        let at = loss_at(0.0);
        let error = |h: &f64| {
            let [ahead, behind] = [*h, -h].map(&mut loss_at);
            let slopes = [(ahead - behind) / (2.0 * h), (ahead - at) / h, (at - behind) / h];
            slopes.map(|slope| (slope / adjoint - 1.0).abs()).into_iter().fold(f64::INFINITY, f64::min)
        };
        let errors: Vec<f64> = [1e-8, 1e-9, 1e-10, 1e-11].iter().map(error).collect();
        println!("opens at {opens_at_s} s, {opening:?}: adjoint {adjoint:e}, errors {errors:?}");
        assert!(adjoint != 0.0 && errors.iter().any(|error| *error < 1e-5), "{adjoint:e} {errors:?}");
    }
}

/// A window that begins in the middle of the skill finds the gates as they are then.
#[test]
fn windows_of_a_skill_past_gates_pass_the_gradient_check() {
    let mut scene = column(0.14, LIFTED);
    scene.domain.sleep_speed_m_s = 0.0;
    let mut s = simulator::<f64>(&scene, 2, 1 << 30);
    let map = SkillMap::new(&scene);
    let window = gradcheck::check_window(&mut s, &map, 12, 28).expect("runs");
    println!("{:?}", window.components.iter().map(|c| (c.adjoint, c.error)).collect::<Vec<_>>());
    assert!(window.components[0].adjoint != 0.0);
    assert!(window.error < 1e-5, "{}", window.error);
    let controls = map.controls(&gradcheck::CHECKED_THETA).expect("fits");
    let whole = s.simulate(&controls[..28]).expect("runs");
    assert_eq!(whole.loss.to_bits(), window.loss.to_bits());
    let positions = s.final_positions_m(&controls[..28]).expect("runs");
    assert_eq!(positions.len(), scene.particle_count());
}
