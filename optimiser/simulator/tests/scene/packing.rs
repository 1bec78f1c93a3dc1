//! Initial particle positions.

use powderline_simulator::scene::Scene;
use proptest::prelude::*;

#[test]
fn same_seed_same_bits_and_another_seed_another_packing() {
    let scene = Scene::load("bench-small").unwrap();
    let bits = |seed| -> Vec<[u64; 3]> {
        scene.particle_positions_m(seed).iter().map(|position| position.map(f64::to_bits)).collect()
    };
    assert_eq!(bits(1), bits(1));
    assert_ne!(bits(1), bits(2));
}

#[test]
fn the_stream_of_numbers_is_pinned() {
    let scene = Scene::load("bench-small").unwrap();
    let first = scene.particle_positions_m(1)[0].map(f64::to_bits);
    assert_eq!(first, [4_582_218_203_357_912_714, 4_579_564_100_369_491_252, 4_573_102_357_148_010_324]);
}

#[test]
fn one_particle_in_every_sub_cell_in_order() {
    let scene = Scene::load("bench").unwrap();
    let positions = scene.particle_positions_m(scene.powder.seed);
    let counts = [32, 32, 11];
    assert_eq!(positions.len(), counts.iter().product::<usize>());
    for (index, position) in positions.iter().enumerate() {
        let expected = [index % 32, index / 32 % 32, index / 1024];
        let found = std::array::from_fn(|axis| {
            ((position[axis] - scene.powder.fill_min_m[axis]) / 0.002).floor() as usize
        });
        assert_eq!(expected, found);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn count_is_as_predicted_and_all_lie_inside(
        per_cell in 1u32..=64,
        size in prop::array::uniform3(0.003..0.03f64),
        seed in any::<u64>(),
    ) {
        let mut scene = Scene::load("bench").unwrap();
        scene.powder.particles_per_cell = per_cell;
        let (low, high) = (scene.powder.fill_min_m, &mut scene.powder.fill_max_m);
        *high = std::array::from_fn(|axis| low[axis] + size[axis]);
        let positions = scene.particle_positions_m(seed);
        prop_assert_eq!(positions.len(), scene.particle_count());
        let expected = size.iter().product::<f64>() / scene.particle_volume_m3();
        prop_assert!((positions.len() as f64 - expected).abs() <= 0.5 + 1e-6 * expected);
        let (low, high) = (scene.powder.fill_min_m, scene.powder.fill_max_m);
        let inside = |position: &[f64; 3]| (0..3).all(|axis| (low[axis]..=high[axis]).contains(&position[axis]));
        prop_assert!(positions.iter().all(inside));
    }
}
