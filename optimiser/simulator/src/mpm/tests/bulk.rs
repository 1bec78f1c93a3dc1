//! How powder at rest bears its weight, and how it heaps.

use crate::mpm::Model;
use crate::mpm::particles::Particles;
use crate::mpm::substep::{State, Workspace};
use crate::mpm::tests::{
    Settled, advance, awake, empty_bench, even_lattice, far_away, mean, settle, settled_often,
};
use crate::scene::{ContainerShape, Flow, Powder, Scene, VolumeCorrection, Walls, YieldSurface};

/// Height of the bed in [`boxed`], m.
const HEIGHT_M: f64 = 0.024;

/// A box of 24 x 24 mm whose floor and walls lie `shift` off the grid's nodes, and a bed in it.
fn boxed(shift: f64, friction: f64) -> (Scene, Vec<[f64; 3]>) {
    let mut scene = awake("bench-small");
    scene.containers.truncate(1);
    let c = &mut scene.containers[0];
    c.friction = friction;
    c.position_m = [0.032 + shift, 0.032 + shift, 0.008 + shift];
    c.shape = ContainerShape::Box { inner_size_m: [0.024, 0.024, 0.036] };
    let [x, y, z] = c.position_m;
    let bed = even_lattice([x - 0.012, y - 0.012, z], [x + 0.012, y + 0.012, z + HEIGHT_M]);
    (scene, bed)
}

fn height(scene: &Scene, bed: &[Settled]) -> f64 {
    2.0 * (mean(bed, |_| true, |p| p.x[2]) - scene.containers[0].position_m[2])
}

/// Nothing but the numerics brings the elastic bed to rest, and where it may leave the floor it swings by a half yet after two seconds:
/// pressures are means over time.
#[test]
fn the_base_of_a_frictionless_box_bears_the_powders_weight() {
    let cases = [
        (Walls::Shared, 0.0, 0.05, 0.97),
        (Walls::Shared, 0.001, 0.05, 0.85),
        (Walls::Shared, 0.002, 0.3, 0.91),
        (Walls::Shared, 0.003, 0.3, 0.82),
        (Walls::TwoSided, 0.0, 0.05, 0.97),
        (Walls::TwoSided, 0.001, 0.15, 0.96),
        (Walls::TwoSided, 0.002, 0.3, 0.95),
        (Walls::TwoSided, 0.003, 0.5, 0.95),
    ];
    for (walls, shift, tolerance, least_height) in cases {
        let (mut scene, positions) = boxed(shift, 0.0);
        scene.domain.walls = walls;
        let [x, y, z] = scene.containers[0].position_m;
        let early = settle(&scene, &positions, 2000);
        let swings = settled_often(&scene, &positions, 4000, 37, 27);
        let end = swings.last().expect("some instants");
        let inside = |p: &Settled| (p.x[0] - x).abs() < 0.012 && (p.x[1] - y).abs() < 0.012 && p.x[2] > z;
        let height = height(&scene, &early);
        // Vertical pressure over depth, a straight line down to the base.
        let depths: Vec<f64> = positions.iter().map(|p| z + HEIGHT_M - p[2]).collect();
        let pressure =
            |k: usize| swings.iter().map(|bed| -bed[k].stress[2]).sum::<f64>() / swings.len() as f64;
        let pressures: Vec<f64> = (0..positions.len()).map(pressure).collect();
        let base = line(&depths, &pressures, HEIGHT_M);
        let want = scene.powder.density_kg_m3 * 9.81 * HEIGHT_M;
        println!(
            "{walls:?} walls {shift} m off the nodes: {base:.1} Pa at the base, {want:.1} Pa of weight, {height:.5} m high"
        );
        assert!(end.iter().all(inside), "powder left the box");
        assert!(height > least_height * HEIGHT_M, "{height} m high");
        // The floor bears at the nodes in it, too deep where it lies between nodes: with two sides it feels 12, 27 and 46 % too much a quarter,
        // a half and three quarters of a cell off them.
        assert!((base / want - 1.0).abs() < tolerance, "{base} Pa instead of {want} Pa");
    }
}

/// With the friction of the shipped scenes.
#[test]
fn a_bed_at_rest_hardly_sinks() {
    for (shift, limit) in [(0.0, 1e-4), (0.001, 5e-4), (0.002, 1e-4), (0.003, 5e-4)] {
        let (scene, positions) = boxed(shift, 0.4);
        let [before, after] =
            [1000, 2000].map(|substeps| height(&scene, &settle(&scene, &positions, substeps)));
        let rate = (before - after) / before / (1000.0 * scene.time.substep_s());
        println!(
            "walls {shift} m off the nodes: a bed {before:.5} m high sinks by {:.3} % a second",
            100.0 * rate
        );
        assert!(rate < limit, "{rate} 1/s");
    }
}

/// Value at `at` of the straight line through the points, by least squares.
fn line(x: &[f64], y: &[f64], at: f64) -> f64 {
    let n = x.len() as f64;
    let (mx, my) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let covariance: f64 = x.iter().zip(y).map(|(x, y)| (x - mx) * (y - my)).sum();
    let variance: f64 = x.iter().map(|x| (x - mx) * (x - mx)).sum();
    my + covariance / variance * (at - mx)
}

/// Slope of what is left of a column, degrees.
fn pile_deg(friction_angle_deg: f64, flow: Option<Flow>) -> f64 {
    let mut scene = empty_bench([0.16, 0.16, 0.06]);
    scene.domain.friction = 0.8;
    scene.powder.friction_angle_deg = friction_angle_deg;
    scene.powder.flow = flow;
    let model: Model<f32> = Model::new(&scene);
    let mut positions = even_lattice([0.06, 0.06, 0.0], [0.1, 0.1, 0.024]);
    positions.retain(|p| (p[0] - 0.08).hypot(p[1] - 0.08) < 0.016);
    let mut state = State::new(&model, &far_away(), &Particles::at_rest(&positions)).unwrap();
    advance(&model, &far_away(), &mut state, 1600);
    let end = state.particles.positions_by_id();
    let mut heights: Vec<f64> = end.iter().map(|p| p[2]).collect();
    let mut radii: Vec<f64> = end.iter().map(|p| (p[0] - 0.08).hypot(p[1] - 0.08)).collect();
    heights.sort_by(f64::total_cmp);
    radii.sort_by(f64::total_cmp);
    let high = |v: &[f64]| v[v.len() * 98 / 100];
    (high(&heights) / high(&radii)).atan().to_degrees()
}

/// Grains of a micrometre are never fast, so have the slope of rest; those of a centimetre nearly always are.
#[test]
fn a_pile_of_two_angles_is_steeper_the_smaller_the_grains() {
    let flow = |grain_diameter_m| Some(Flow { grain_diameter_m, grain_density_kg_m3: 1600.0 });
    let [small, none, large] = [flow(1e-6), None, flow(0.01)].map(|flow| pile_deg(30.0, flow));
    println!(
        "slopes of a pile of 30 deg: small grains {small:.2}, one angle {none:.2}, large grains {large:.2} deg"
    );
    assert!(small > none && none > large, "{small} {none} {large}");
}

#[test]
fn a_pile_is_steeper_the_greater_the_friction_angle() {
    let slopes = [15.0, 30.0, 45.0].map(|angle| pile_deg(angle, None));
    println!("slopes of the pile at friction angles of 15, 30, 45 deg: {slopes:.1?} deg");
    assert!(slopes.windows(2).all(|s| s[1] > s[0] + 1.0), "{slopes:?}");
}

/// How far the upper edge of a vertical cut has sunk and gone forward, over its height of 24 mm, once its weight has come up slowly.
fn cut_moved(powder: &Powder) -> f64 {
    let (height, bed, cell) = (0.024, 0.012, 0.002);
    let mut scene = empty_bench([0.096, 4.0 * cell, 0.048]);
    scene.domain.cell_m = cell;
    scene.domain.friction = 0.0;
    scene.time.substeps = 40;
    scene.powder = powder.clone();
    let mut model: Model<f32> = Model::new(&scene);
    let s = 0.5 * cell;
    let mut positions = Vec::new();
    let count = |l: f64| (l / s).round() as usize;
    for i in 0..count(0.096) {
        for j in 0..count(4.0 * cell) {
            for k in 0..count(height + bed) {
                let x = [i, j, k].map(|n| (n as f64 + 0.5) * s);
                if x[0] < 0.048 || x[2] < bed {
                    positions.push(x);
                }
            }
        }
    }
    let edge: Vec<usize> = positions
        .iter()
        .enumerate()
        .filter(|(_, x)| x[2] > height + bed - 0.004 && x[0] > 0.044 && x[0] < 0.048)
        .map(|(id, _)| id)
        .collect();
    let mut state = State::new(&model, &far_away(), &Particles::at_rest(&positions)).unwrap();
    let g = model.gravity_dt;
    let mut workspace = Workspace::new();
    let ramp = (0.3 / scene.time.substep_s()) as usize;
    for substep in 0..2 * ramp {
        let part = (substep as f32 / ramp as f32).min(1.0);
        model.gravity_dt = g.map(|g| part * g);
        workspace.substep(&model, &far_away(), &mut state).unwrap();
    }
    let end = state.particles.positions_by_id();
    let moved = |id: &usize| (end[*id][0] - positions[*id][0]) + (positions[*id][2] - end[*id][2]);
    edge.iter().map(moved).sum::<f64>() / edge.len() as f64 / height
}

/// A vertical cut in cohesive powder stands to the height `4 cohesion/(density g) tan(45 deg + phi/2)` (Terzaghi 1943, Theoretical
/// Soil Mechanics), within 15 %.
#[test]
fn a_vertical_cut_stands_to_its_critical_height() {
    for (phi, strength) in [(35.0f64, None), (35.0, Some(0.3)), (25.0, Some(0.3))] {
        let needed = 9810.0 * 0.024 / (4.0 * (45.0 + 0.5 * phi).to_radians().tan());
        let moved = |part: f64| {
            let mut powder = Scene::load("bench-small").unwrap().into_spec().powder;
            powder.friction_angle_deg = phi;
            powder.yield_surface = YieldSurface::MatsuokaNakai;
            powder.volume_correction = VolumeCorrection::Grid;
            powder.cohesion_pa = part * needed;
            powder.tensile_strength_pa = strength.map(|part: f64| part * powder.apex_tension_pa());
            cut_moved(&powder)
        };
        let [stands, falls] = [1.15, 0.85].map(moved);
        println!(
            "{phi} deg, tensile strength {strength:?}: moved by {stands:.3} and {falls:.3} of its height"
        );
        assert!(stands < 0.05 && falls > 0.1, "{phi} deg: {stands} {falls}");
    }
}
