//! Gates: where they are and when, what they hold, and whom they wake.

use proptest::prelude::*;

use crate::mpm::Model;
use crate::mpm::bodies::{Bodies, Moment};
use crate::mpm::obstacle::distance;
use crate::mpm::particles::Particles;
use crate::mpm::substep::{State, Workspace};
use crate::mpm::tests::{empty_bench, even_lattice, far_away};
use crate::real::Real;
use crate::scene::{Container, ContainerShape, Gate, GateOpening, GateShape, Scene, Walls};

/// A gate that vanishes.
fn gate(position_m: [f64; 3], yaw_deg: f64, shape: GateShape, opens_at_s: f64) -> Gate {
    let opening = GateOpening::Vanish {};
    Gate { name: "gate".into(), position_m, yaw_deg, friction: 0.4, opens_at_s, shape, opening }
}

fn with_gates(mut scene: Scene, gates: Vec<Gate>) -> Scene {
    scene.gates = gates;
    scene
}

/// The gates then, under a tool out of reach.
fn bodies<T: Real>(model: &Model<T>, moment: Moment) -> Bodies<T> {
    Bodies { gates: model.gates.at(moment), ..far_away() }
}

/// Substeps of the motion from one on.
fn go_on<T: Real>(model: &Model<T>, state: &mut State<T>, substeps: std::ops::Range<usize>) {
    let mut workspace = Workspace::new();
    for substep in substeps {
        workspace.substep(model, &bodies(model, Moment::After(substep)), state).unwrap();
    }
}

/// The powder after so many substeps of settling.
fn settled<T: Real>(model: &Model<T>, points: &[[f64; 3]], substeps: usize) -> State<T> {
    let mut state = State::new(model, &bodies(model, Moment::Settling), &Particles::at_rest(points)).unwrap();
    let mut workspace = Workspace::new();
    for _ in 0..substeps {
        workspace.substep(model, &bodies(model, Moment::Settling), &mut state).unwrap();
    }
    state
}

#[test]
fn a_silo_keeps_its_powder_until_its_gate_opens_and_then_loses_it_through_the_hole_alone() {
    let shape = ContainerShape::Silo { inner_radius_m: 0.024, inner_height_m: 0.06, outlet_radius_m: 0.012 };
    flows_out_of(shape, Walls::Shared, |[x, y]| x.hypot(y));
}

#[test]
fn a_box_loses_its_powder_through_its_slot_alone() {
    let shape = ContainerShape::SlottedBox { inner_size_m: [0.048, 0.04, 0.06], slot_width_m: 0.016 };
    // As long as the box is wide.
    let out = |[x, y]: [f64; 2]| (0.012 / 0.008 * x.abs()).max(0.012 / 0.02 * y.abs());
    for walls in [Walls::Shared, Walls::TwoSided] {
        flows_out_of(shape.clone(), walls, out);
    }
}

/// Powder in a container with an outlet above a gate: kept until that opens, then lost through the outlet alone, whose edge is 12 mm
/// from the middle by the measure that is given.
fn flows_out_of(shape: ContainerShape, walls: Walls, out: impl Fn([f64; 2]) -> f64) {
    let (dx, middle) = (0.004, 0.048);
    let mut scene = empty_bench([0.096, 0.096, 0.128]);
    scene.domain.walls = walls;
    scene.containers.push(Container {
        name: "silo".into(),
        position_m: [middle, middle, 0.048],
        yaw_deg: 0.0,
        wall_thickness_m: dx,
        friction: 0.4,
        shape,
    });
    // A plate under the hole.
    let plate = GateShape::Box { size_m: [0.032, 0.048, dx] };
    let scene = with_gates(scene, vec![gate([middle, middle, 0.048 - 2.0 * dx], 0.0, plate, 0.0)]);
    let points: Vec<_> = even_lattice([0.030, 0.030, 0.048], [0.066, 0.066, 0.084])
        .into_iter()
        .filter(|p| (p[0] - middle).hypot(p[1] - middle) < 0.022)
        .collect();
    let model = Model::<f64>::new(&scene);
    let below = |state: &State<f64>| {
        let low = |p: &[f64; 3]| p[2] < 0.048 - 1.5 * dx;
        state.particles.positions_by_id().into_iter().filter(low).collect::<Vec<_>>()
    };
    let mut state = settled(&model, &points, 400);
    assert!(below(&state).is_empty());
    go_on(&model, &mut state, 0..300);
    let through = below(&state);
    assert!(through.len() > points.len() / 20 && through.len() < points.len() / 2, "{}", through.len());
    // It falls straight down, as wide as the hole to within what the grid tells apart, until it lands.
    let falls: Vec<_> = through.iter().filter(|p| p[2] > 2.0 * dx).collect();
    let widest = falls.iter().map(|p| out([p[0] - middle, p[1] - middle])).fold(0.0, f64::max);
    assert!(falls.len() > through.len() / 4 && widest < 0.012 + dx, "{} {widest}", falls.len());
}

#[test]
fn a_gate_that_vanishes_is_there_until_the_substep_it_opens_in_and_stirs_in_that_one() {
    let shape = GateShape::Box { size_m: [0.004, 0.02, 0.02] };
    for (opens_at_s, first) in [(0.0, 0), (0.0005, 1), (0.3, 600), (0.30001, 601)] {
        let scene =
            with_gates(empty_bench([0.064; 3]), vec![gate([0.03; 3], 0.0, shape.clone(), opens_at_s)]);
        let model = Model::<f64>::new(&scene);
        let seen =
            |moment| (model.gates.at::<f64>(moment)[0].is_there, model.gates.at::<f64>(moment)[0].stirs);
        assert_eq!(seen(Moment::Settling), (true, false));
        let told: Vec<_> = (0..first + 2).map(|substep| seen(Moment::After(substep))).collect();
        let mut wanted = vec![(true, false); first];
        wanted.extend([(false, true), (false, false)]);
        assert!(told == wanted, "{opens_at_s}");
    }
}

#[test]
fn a_gate_that_slides_goes_as_far_as_it_should_and_stirs_as_long() {
    let shape = GateShape::Box { size_m: [0.004, 0.02, 0.02] };
    let mut slide = gate([0.03, 0.02, 0.01], 20.0, shape, 0.01);
    // 60 m/s^-1 of 0.5 ms: 0.03 mm a substep; 3.05 mm are 101 of these and two thirds of one.
    slide.opening = GateOpening::Slide { velocity_m_s: [0.0, -0.036, 0.048], travel_m: 0.00305 };
    let model = Model::<f64>::new(&with_gates(empty_bench([0.064; 3]), vec![slide]));
    let at = |substep| model.gates.at::<f64>(Moment::After(substep))[0];
    let near = |found: [f64; 3], wanted: [f64; 3]| {
        assert!((0..3).all(|i| (found[i] - wanted[i]).abs() < 1e-12), "{found:?} {wanted:?}");
    };
    for substep in 0..200usize {
        let state = at(substep);
        assert!(state.is_there);
        assert_eq!(state.stirs, (20..122).contains(&substep), "{substep}");
        let done = (substep as f64 - 19.0).clamp(0.0, 305.0 / 3.0);
        let in_this = done - (substep as f64 - 20.0).clamp(0.0, 305.0 / 3.0);
        near(state.motion.position, [0.03, 0.02 - 1.8e-5 * done, 0.01 + 2.4e-5 * done]);
        assert!((state.motion.velocity[2] - 0.048 * in_this).abs() < 1e-9, "{substep}");
        assert_eq!(state.motion.rotation, at(0).motion.rotation);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// The collider of a gate is the solid that its dimensions say, where its position and yaw say.
    #[test]
    fn a_gate_fills_what_its_shape_says(
        point in prop::array::uniform3(0.0..0.1f64),
        size in prop::array::uniform3(0.004..0.05f64),
        yaw_deg in -360.0..360.0f64,
        is_tube in any::<bool>(),
    ) {
        let [x, y, z] = size;
        let (shape, position_m) = match is_tube {
            true => (GateShape::Tube { inner_radius_m: x, height_m: y, wall_thickness_m: z }, [0.05, 0.04, 0.02]),
            false => (GateShape::Box { size_m: size }, [0.05, 0.04, 0.02]),
        };
        let scene = with_gates(empty_bench([0.1; 3]), vec![gate(position_m, yaw_deg, shape, 1.0)]);
        let model = Model::<f64>::new(&scene);
        let (sin, cos) = yaw_deg.to_radians().sin_cos();
        let [dx, dy, dz] = [0, 1, 2].map(|i| point[i] - position_m[i]);
        let (along, across) = (cos * dx + sin * dy, cos * dy - sin * dx);
        // How far the point is within each pair of faces.
        let depths = match is_tube {
            true => {
                let rho = along.hypot(across);
                vec![rho - x, x + z - rho, dz, y - dz]
            }
            false => vec![0.5 * x - along.abs(), 0.5 * y - across.abs(), dz, z - dz],
        };
        let depth = depths.iter().copied().fold(f64::INFINITY, f64::min);
        let shut = model.gates.at(Moment::Settling)[0].motion;
        let found = distance(&model.obstacles.gates[0], &shut, point);
        if depth > 0.0 {
            prop_assert!((found + depth).abs() < 1e-9, "{} {}", found, depth);
        } else {
            // Outside the corners are farther than the faces.
            prop_assert!(found >= -depth - 2e-6 && found <= 3f64.sqrt() * 0.2, "{} {}", found, depth);
        }
    }
}

const TUBE: GateShape = GateShape::Tube { inner_radius_m: 0.016, height_m: 0.048, wall_thickness_m: 0.004 };

/// A column of powder in a tube on the floor of an empty box, and where its axis is.
fn column(opens_at_s: f64) -> (Scene, Vec<[f64; 3]>, [f64; 2]) {
    let scene = empty_bench([0.128, 0.128, 0.064]);
    let scene = with_gates(scene, vec![gate([0.064, 0.064, 0.0], 0.0, TUBE, opens_at_s)]);
    let mut points = even_lattice([0.048, 0.048, 0.0], [0.080, 0.080, 0.032]);
    points.retain(|p| (p[0] - 0.064).hypot(p[1] - 0.064) < 0.016);
    (scene, points, [0.064; 2])
}

#[test]
fn a_shut_tube_holds_its_column_and_one_that_has_gone_lets_it_collapse() {
    let (scene, points, [x, y]) = column(0.25);
    let model = Model::<f32>::new(&scene);
    let mut state = settled(&model, &points, 500);
    let farthest_m = |state: &State<f32>| {
        let out = |p: [f64; 3]| (p[0] - x).hypot(p[1] - y);
        state.particles.positions_by_id().into_iter().map(out).fold(0.0, f64::max)
    };
    go_on(&model, &mut state, 0..500);
    let held_m = farthest_m(&state);
    go_on(&model, &mut state, 500..1000);
    let released_m = farthest_m(&state);
    println!(
        "column of 16 mm radius and 32 mm height: {held_m:.4} m while held, {released_m:.4} m 0.25 s later"
    );
    assert!(held_m < 0.018, "{held_m}");
    assert!(released_m > 0.030, "{released_m}");
}

/// A tray below a plate that is pulled aside: nothing falls before, nearly all of it after.
#[test]
fn a_slide_lets_powder_through_when_it_is_pulled() {
    let scene = empty_bench([0.064, 0.064, 0.064]);
    let shaft = GateShape::Tube { inner_radius_m: 0.016, height_m: 0.032, wall_thickness_m: 0.004 };
    let shaft = gate([0.032, 0.032, 0.024], 0.0, shaft, 1e4);
    let mut slide = gate([0.032, 0.032, 0.020], 0.0, GateShape::Box { size_m: [0.044, 0.044, 0.004] }, 0.05);
    slide.opening = GateOpening::Slide { velocity_m_s: [0.6, 0.0, 0.0], travel_m: 0.045 };
    let model = Model::<f32>::new(&with_gates(scene, vec![shaft, slide]));
    let mut points = even_lattice([0.016, 0.016, 0.024], [0.048, 0.048, 0.040]);
    points.retain(|p| (p[0] - 0.032).hypot(p[1] - 0.032) < 0.016);
    let mut state = settled(&model, &points, 200);
    let below = |state: &State<f32>| {
        state.particles.positions_by_id().iter().filter(|p| p[2] < 0.021).count() as f64 / points.len() as f64
    };
    go_on(&model, &mut state, 0..100);
    let before = below(&state);
    go_on(&model, &mut state, 100..700);
    let after = below(&state);
    println!("share of the powder below the slide: {before:.3} while it is shut, {after:.3} after");
    assert!(before == 0.0 && after > 0.95, "{before} {after}");
}

#[test]
fn sleepers_beside_a_gate_wake_in_the_substep_in_which_it_opens_and_no_other() {
    // Two beds, each held by a plate, of which one opens.
    let mut scene = empty_bench([0.128, 0.032, 0.064]);
    scene.domain.sleep_speed_m_s = 5e-4;
    let plate = |x: f64, opens_at_s: f64| {
        gate([x, 0.016, 0.0], 0.0, GateShape::Box { size_m: [0.004, 0.032, 0.040] }, opens_at_s)
    };
    let mut points = even_lattice([0.0; 3], [0.028, 0.032, 0.020]);
    points.extend(even_lattice([0.100, 0.0, 0.0], [0.128, 0.032, 0.020]));
    for slides in [false, true] {
        let (mut opens, stays) = (plate(0.030, 0.02), plate(0.098, 1e4));
        if slides {
            opens.opening = GateOpening::Slide { velocity_m_s: [0.0, 0.0, 0.2], travel_m: 0.02 };
        }
        let model = Model::<f64>::new(&with_gates(scene.clone(), vec![opens, stays]));
        let mut state = settled(&model, &points, 2000);
        let asleep = |state: &State<f64>| state.sleepers().filter(|asleep| *asleep).count();
        let blocks = state.layout.blocks.len();
        assert_eq!(asleep(&state), blocks, "powder at rest against a shut gate sleeps");
        go_on(&model, &mut state, 0..40);
        assert_eq!(asleep(&state), blocks, "and goes on to sleep until it opens");
        // One that goes on from there, or begins anew, does the same.
        let mut again = state.clone();
        go_on(&model, &mut state, 40..41);
        let awake = blocks - asleep(&state);
        assert!(awake > 0 && awake < blocks, "{awake} of {blocks}");
        let is_awake = |state: &State<f64>| -> Vec<bool> { state.sleepers().map(|asleep| !asleep).collect() };
        for (block, awake) in state.layout.blocks.iter().zip(is_awake(&state)) {
            let x = model.grid.block_origin(block.coord)[0];
            assert!(awake || !(0.016..0.048).contains(&x), "the block at {x} m sleeps");
            assert!(!awake || x < 0.08, "the block at {x} m is far away");
        }
        let before = state.particles.positions_by_id();
        go_on(&model, &mut state, 41..800);
        go_on(&model, &mut again, 40..800);
        assert!(again.particles.groups == state.particles.groups);
        let after = state.particles.positions_by_id();
        let gone = before.iter().zip(&after).filter(|(a, b)| b[0] - a[0] > 0.004).count();
        println!("slides: {slides}, {gone} particles have gone on by more than a cell");
        assert!(gone > 100, "{gone}");
    }
}
