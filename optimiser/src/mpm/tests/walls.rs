//! What powder feels of a wall, and of what lies behind it.

use powderline_shared::pose::{Pose, exp_so3};

use crate::mpm::Model;
use crate::mpm::material::return_map;
use crate::mpm::particles::{Particles, vec_of};
use crate::mpm::substep::{State, Workspace};
use crate::rollout::path::resting;
use crate::scene::{ContainerShape, Scene};

/// A particle at rest.
#[derive(Clone, Copy)]
struct Settled {
    x: [f64; 3],
    /// Kirchhoff stress, Pa: xx, yy, zz, and shear.
    stress: [f64; 6],
}

/// Every particle after `substeps` without a tool.
fn settle(scene: &Scene, positions: &[[f64; 3]], substeps: usize) -> Vec<Settled> {
    let model: Model<f64> = Model::new(scene);
    let tool = resting(&Pose { position_m: [9.0; 3].into(), orientation: exp_so3(&[0.0; 3].into()) });
    let mut state = State::new(&model, &Particles::at_rest(positions)).expect("on the grid");
    let mut workspace = Workspace::new();
    for _ in 0..substeps {
        workspace.advance(&model, &tool, &mut state).expect("on the grid");
    }
    let mut out = vec![Settled { x: [0.0; 3], stress: [0.0; 6] }; positions.len()];
    for (g, l, id) in state.particles.living() {
        let group = &state.particles.groups[g];
        let (stress, _, _) = return_map(&model.material, group.strain_of(l), 0.0);
        out[id as usize] = Settled { x: vec_of(&group.x, l), stress };
    }
    out
}

/// Eight particles to a cell of 4 mm, evenly.
fn lattice(low: [f64; 3], high: [f64; 3]) -> Vec<[f64; 3]> {
    let count = |a: usize| ((high[a] - low[a]) / 0.002).round() as usize;
    let mut out = Vec::new();
    for i in 0..count(0) {
        for j in 0..count(1) {
            for k in 0..count(2) {
                let at =
                    |n: usize, a: usize| low[a] + (n as f64 + 0.5) * (high[a] - low[a]) / count(a) as f64;
                out.push([at(i, 0), at(j, 1), at(k, 2)]);
            }
        }
    }
    out
}

/// A wall from x = `face` to `face + thickness` across the domain.
fn with_wall(face: f64, thickness: f64, end: f64) -> Scene {
    let mut scene = Scene::load("bench-small").expect("shipped");
    scene.container.truncate(1);
    let c = &mut scene.container[0];
    c.wall_thickness_m = thickness;
    c.friction = 0.0;
    c.position_m = [0.5 * (face - 0.008), 0.016, 0.0];
    c.shape = ContainerShape::Box { inner_size_m: [face + 0.008, 0.048, 0.04] };
    scene.domain.friction = 0.0;
    scene.domain.size_m = [end, 0.032, 0.048];
    scene
}

/// Mean of a number over the particles for which `keep` holds.
fn mean(of: &[Settled], keep: impl Fn(&Settled) -> bool, number: impl Fn(&Settled) -> f64) -> f64 {
    let kept: Vec<f64> = of.iter().filter(|p| keep(p)).map(number).collect();
    kept.iter().sum::<f64>() / kept.len() as f64
}

/// A bed is pressed on a wall by gravity at 45 deg; behind the wall lies a thin layer.
#[test]
fn powder_behind_a_wall_does_not_feel_what_presses_on_its_front() {
    for thickness in [0.003, 0.004] {
        for step in 0..8 {
            let face = 0.024 + 0.0005 * f64::from(step);
            let (back, end) = (face + thickness, face + thickness + 0.008);
            let mut scene = with_wall(face, thickness, end);
            scene.domain.gravity_m_s2 = [9.81, 0.0, -9.81];
            let layer = lattice([back, 0.0, 0.0], [end, 0.032, 0.008]);
            let both: Vec<_> = layer.iter().copied().chain(lattice([0.0; 3], [face, 0.032, 0.024])).collect();
            let pressed = settle(&scene, &both, 400);
            let alone = settle(&scene, &layer, 400);
            let behind = &pressed[..layer.len()];
            let pressure = |of: &[Settled]| mean(of, |_| true, |p| -p.stress[0]);
            let place = |of: &[Settled]| mean(of, |_| true, |p| p.x[0]);
            let push =
                mean(&pressed[layer.len()..], |p| p.x[2] < 0.008 && p.x[0] > face - 0.008, |p| -p.stress[0]);
            let felt = (pressure(behind) - pressure(&alone)) / push;
            let moved = place(behind) - place(&alone);
            println!(
                "wall of {thickness} m at {face} m: {push:.0} Pa in front, {:.1} % felt behind, moved {moved:.1e} m",
                felt * 100.0
            );
            assert!(
                push > 150.0 && felt.abs() < 0.2 && moved.abs() < 1e-4,
                "wall of {thickness} m at {face} m"
            );
        }
    }
}

/// A bed of 24 mm after a second, with walls and floor on nodes and between them.
#[test]
fn powder_in_a_frictionless_box_keeps_its_volume_and_its_base_bears_its_weight() {
    for step in 0..4 {
        let mut scene = Scene::load("bench-small").expect("shipped");
        scene.container.truncate(1);
        let shift = 0.001 * f64::from(step);
        let c = &mut scene.container[0];
        c.friction = 0.0;
        c.position_m = [0.032 + shift, 0.032 + shift, 0.008 + shift];
        c.shape = ContainerShape::Box { inner_size_m: [0.024, 0.024, 0.036] };
        let [x, y, z] = c.position_m;
        let positions = lattice([x - 0.012, y - 0.012, z], [x + 0.012, y + 0.012, z + 0.024]);
        let end = settle(&scene, &positions, 2000);
        let inside = |p: &Settled| (p.x[0] - x).abs() < 0.012 && (p.x[1] - y).abs() < 0.012 && p.x[2] > z;
        let height = 2.0 * (mean(&end, |_| true, |p| p.x[2]) - z);
        // Vertical pressure over depth, a straight line down to the base.
        let depths: Vec<f64> = positions.iter().map(|p| z + 0.024 - p[2]).collect();
        let pressures: Vec<f64> = end.iter().map(|p| -p.stress[2]).collect();
        let base = line(&depths, &pressures, 0.024);
        let want = scene.powder.density_kg_m3 * 9.81 * 0.024;
        println!(
            "walls {shift} m off the nodes: {base:.1} Pa at the base, {want:.1} Pa of weight, height {:.2} mm",
            height * 1e3
        );
        assert!(end.iter().all(inside), "powder left the box");
        assert!(height > 0.8 * 0.024, "{height} m high");
        // The floor bears at the nodes in it: up to half a cell too deep where it lies between nodes.
        let tolerance = if step == 0 { 0.05 } else { 0.3 };
        assert!((base / want - 1.0).abs() < tolerance, "{base} Pa instead of {want} Pa");
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

#[test]
fn powder_falls_off_a_wall() {
    for step in 0..4 {
        let face = 0.024 + 0.001 * f64::from(step);
        let back = face + 0.004;
        let mut scene = with_wall(face, 0.004, 0.072);
        scene.domain.gravity_m_s2 = [9.81, 0.0, 0.0];
        let layer = lattice([back, 0.008, 0.008], [back + 0.008, 0.024, 0.032]);
        let end = settle(&scene, &layer, 120);
        let nearest = end.iter().map(|p| p.x[0] - back).fold(f64::INFINITY, f64::min);
        println!("wall at {face} m: nearest {:.1} mm off after 0.06 s, 17.7 mm in free fall", nearest * 1e3);
        assert!(nearest > 0.004, "{nearest} m");
    }
}
