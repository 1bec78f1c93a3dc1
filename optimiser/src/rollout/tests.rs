//! Whole rollouts: their bits, and their derivative.

use powderline_shared::plan::Precision;

use crate::rollout::path::displacement;
use crate::rollout::{SimulatorSettings, gradcheck, simulator};
use crate::scene::Scene;
use crate::skill::SkillMap;

#[test]
fn threads_and_memory_change_no_bit_of_loss_and_gradient() {
    let scene = Scene::load("bench-small").expect("shipped");
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
    let scene = Scene::load("bench-small").expect("shipped");
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
