//! Initial particle positions.

use powderline_simulator::scene::{Amount, FillShape, Quantity, Scene};
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

/// A column of 32 mm radius in whole sub-cells.
fn column() -> Scene {
    Scene::load("bench").unwrap().with(|spec| spec.powder.fill_shape = FillShape::Cylinder).unwrap()
}

#[test]
fn a_column_is_filled_evenly() {
    let scene = column();
    let positions = scene.particle_positions_m(1);
    // pi/4 of the 32 x 32 x 11 sub-cells of the box.
    assert_eq!((positions.len(), scene.particle_count()), (8847, 8847));
    let (low, radius_m) = (scene.powder.fill_min_m, 0.032);
    let cell_of = |p: &[f64; 3]| [0, 1, 2].map(|axis| ((p[axis] - low[axis]) / 0.002) as usize);
    // Every layer has as many, to one, and no sub-cell two; those within the circle have all one.
    let mut held = std::collections::BTreeSet::new();
    let mut layers = [0usize; 11];
    for p in &positions {
        assert!(libm::hypot(p[0] - 0.056, p[1] - 0.048) <= radius_m);
        assert!(held.insert(cell_of(p)), "two in one sub-cell: {p:?}");
        layers[cell_of(p)[2]] += 1;
    }
    assert!(layers.iter().all(|count| (804..=805).contains(count)), "{layers:?}");
    for index in 0..32 * 32 * 11 {
        let cell = [index % 32, index / 32 % 32, index / 1024];
        let farthest = [0, 1].map(|axis| {
            let from_middle = cell[axis] as f64 - 16.0;
            from_middle.abs().max((from_middle + 1.0).abs())
        });
        assert!(libm::hypot(farthest[0], farthest[1]) > 16.0 || held.contains(&cell), "{cell:?}");
    }
    // No side has more than the others, and no distance from the axis: the second moment is half the radius squared.
    let mean = |number: &dyn Fn(&[f64; 3]) -> f64| positions.iter().map(number).sum::<f64>() / 8847.0;
    assert!(mean(&|p| p[0] - 0.056).abs() < 5e-5 && mean(&|p| p[1] - 0.048).abs() < 5e-5);
    let moment = mean(&|p| (p[0] - 0.056).powi(2) + (p[1] - 0.048).powi(2)) / (0.5 * radius_m * radius_m);
    assert!((moment - 1.0).abs() < 2e-3, "{moment}");
}

#[test]
fn the_packing_of_a_column_is_pinned() {
    let positions = column().particle_positions_m(1);
    let bits = |index: usize| positions[index].map(f64::to_bits);
    assert_eq!(bits(0), [4_587_054_182_874_421_950, 4_580_762_266_720_551_315, 4_571_582_645_843_167_584]);
    assert_eq!(bits(5000), [4_589_229_535_386_411_869, 4_584_996_034_464_945_826, 4_580_283_674_239_113_548]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn count_is_as_predicted_and_all_lie_inside(
        per_cell in 1u32..=64,
        size in prop::array::uniform3(0.003..0.03f64),
        seed in any::<u64>(),
    ) {
        let scene = Scene::load("bench").unwrap().with(|spec| {
            spec.objective.amount = Amount::new(Quantity::Particles(1));
            spec.powder.particles_per_cell = per_cell;
            let low = spec.powder.fill_min_m;
            spec.powder.fill_max_m = std::array::from_fn(|axis| low[axis] + size[axis]);
        });
        // Smaller than a particle.
        prop_assume!(scene.is_ok());
        let scene = scene.unwrap();
        let positions = scene.particle_positions_m(seed);
        prop_assert_eq!(positions.len(), scene.particle_count());
        let expected = size.iter().product::<f64>() / scene.particle_volume_m3();
        prop_assert!((positions.len() as f64 - expected).abs() <= 0.5 + 1e-6 * expected);
        let (low, high) = (scene.powder.fill_min_m, scene.powder.fill_max_m);
        let inside = |position: &[f64; 3]| (0..3).all(|axis| (low[axis]..=high[axis]).contains(&position[axis]));
        prop_assert!(positions.iter().all(inside));
    }

    #[test]
    fn a_column_has_the_particles_of_its_volume(
        per_cell in 1u32..=64,
        radius in 0.0005..0.016f64,
        height in 0.001..0.02f64,
        seed in any::<u64>(),
    ) {
        let bench = Scene::load("bench").unwrap();
        let low = bench.powder.fill_min_m;
        let scene = bench.with(|spec| {
            spec.objective.amount = Amount::new(Quantity::Particles(1));
            spec.powder.fill_shape = FillShape::Cylinder;
            spec.powder.particles_per_cell = per_cell;
            spec.powder.fill_max_m = [low[0] + 2.0 * radius, low[1] + 2.0 * radius, low[2] + height];
        });
        // Smaller than a particle.
        prop_assume!(scene.is_ok());
        let scene = scene.unwrap();
        let positions = scene.particle_positions_m(seed);
        prop_assert_eq!(positions.len(), scene.particle_count());
        let volume = std::f64::consts::PI * radius * radius * height;
        prop_assert!((positions.len() as f64 - volume / scene.particle_volume_m3()).abs() <= 0.5 + 1e-6);
        for p in &positions {
            let out = libm::hypot(p[0] - low[0] - radius, p[1] - low[1] - radius);
            prop_assert!(out <= radius * (1.0 + 1e-12) && (low[2]..=scene.powder.fill_max_m[2]).contains(&p[2]));
        }
    }
}
