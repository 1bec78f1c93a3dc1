//! What powder feels of a wall, and of what lies behind it.

use crate::mpm::Model;
use crate::mpm::particles::Particles;
use crate::mpm::substep::State;
use crate::mpm::tests::{Settled, advance, awake, even_lattice, mean, settle, standing};
use crate::scene::{ContainerShape, Scene, ToolShape};
use crate::small::{dot, sub};

/// A wall from x = `face` to `face + thickness` across the domain.
fn with_wall(face: f64, thickness: f64, end: f64) -> Scene {
    let mut scene = awake("bench-small");
    scene.containers.truncate(1);
    let c = &mut scene.containers[0];
    c.wall_thickness_m = thickness;
    c.friction = 0.0;
    c.position_m = [0.5 * (face - 0.008), 0.016, 0.0];
    c.shape = ContainerShape::Box { inner_size_m: [face + 0.008, 0.048, 0.04] };
    scene.domain.friction = 0.0;
    scene.domain.size_m = [end, 0.032, 0.048];
    scene
}

/// A bed is pressed on a wall by gravity at 45 deg; behind the wall lies a thin layer. A wall no thicker than a cell does not divide
/// the density that the grid sees, which moves the layer by up to a tenth of a cell.
#[test]
fn powder_behind_a_wall_does_not_feel_what_presses_on_its_front() {
    for thickness in [0.003, 0.004] {
        for step in 0..8 {
            let face = 0.024 + 0.0005 * f64::from(step);
            let (back, end) = (face + thickness, face + thickness + 0.008);
            let mut scene = with_wall(face, thickness, end);
            scene.domain.gravity_m_s2 = [9.81, 0.0, -9.81];
            let layer = even_lattice([back, 0.0, 0.0], [end, 0.032, 0.008]);
            let both: Vec<_> =
                layer.iter().copied().chain(even_lattice([0.0; 3], [face, 0.032, 0.024])).collect();
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
                push > 150.0 && felt.abs() < 0.17 && moved.abs() < 5e-4,
                "wall of {thickness} m at {face} m"
            );
        }
    }
}

#[test]
fn powder_falls_off_a_wall() {
    for step in 0..4 {
        let face = 0.024 + 0.001 * f64::from(step);
        let back = face + 0.004;
        let mut scene = with_wall(face, 0.004, 0.072);
        scene.domain.gravity_m_s2 = [9.81, 0.0, 0.0];
        let layer = even_lattice([back, 0.008, 0.008], [back + 0.008, 0.024, 0.032]);
        let end = settle(&scene, &layer, 120);
        let nearest = end.iter().map(|p| p.x[0] - back).fold(f64::INFINITY, f64::min);
        println!("wall at {face} m: nearest {:.1} mm off after 0.06 s, 17.7 mm in free fall", nearest * 1e3);
        assert!(nearest > 0.004, "{nearest} m");
    }
}

#[test]
fn a_full_spoon_leaks_nothing_in_five_seconds() {
    let scene = awake("bench");
    let ToolShape::Bowl { inner_radius_m: r } = scene.tool.shape else { panic!("the bench has a bowl") };
    let centre = [0.12, 0.048, 0.12];
    let mut positions =
        even_lattice(centre.map(|c| c - 0.016), [centre[0] + 0.016, centre[1] + 0.016, centre[2]]);
    positions.retain(|p| {
        let d = sub(*p, centre);
        dot(d, d).sqrt() < r - 0.0005 && d[2] < -0.001
    });
    let model: Model<f32> = Model::new(&scene);
    let mut state = State::new(&model, &Particles::at_rest(&positions)).unwrap();
    advance(&model, &standing(centre), &mut state, 10_000);
    let (mut leaked, mut over_the_rim) = (0, 0);
    for p in state.particles.positions_by_id() {
        let d = sub(p, centre);
        let far = dot(d, d).sqrt() > r + 0.5 * scene.tool.wall_thickness_m;
        leaked += usize::from(far && d[2] < 0.0);
        over_the_rim += usize::from(far && d[2] >= 0.0);
    }
    println!("{} particles, {leaked} leaked, {over_the_rim} over the rim", positions.len());
    assert!(positions.len() > 800);
    assert_eq!((leaked, over_the_rim), (0, 0));
}
