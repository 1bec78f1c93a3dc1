//! Writing and identifying scenes.

use powderline_simulator::scene::{
    Aim, Amount, ContainerShape, EMBEDDED_SCENES, FillShape, Flow, Gate, GateOpening, GateShape, Observation,
    PathSplines, Quantity, Scene, SleepBy, Sleepers, ToolShape, Transfer, VolumeCorrection, Walls,
    YieldSurface,
};
use powderline_simulator::skill::Freedom;
use proptest::prelude::*;

/// A valid scene away from the shipped ones, by small changes that break no rule.
fn arbitrary_scene() -> impl Strategy<Value = Scene> {
    let shapes = (any::<bool>(), any::<bool>(), any::<bool>(), 0usize..3);
    let numbers = (0.1..0.7f64, -10.0..10.0f64, 0.0..0.4f64, any::<u64>(), 1e-12..1.0f64);
    let choices = (1u32..850, any::<bool>(), 0usize..3);
    (shapes, numbers, choices).prop_map(
        |((round, scoop, column, gates), numbers, (particles, by_mass, observation))| {
            let (softness, tilt, poissons_ratio, seed, small) = numbers;
            let mut scene = Scene::load("bench").unwrap().into_spec();
            scene.name = format!("scene \"{seed}\" \u{e9}");
            scene.powder.youngs_modulus_pa *= softness;
            scene.powder.poissons_ratio = poissons_ratio;
            scene.powder.seed = seed;
            scene.domain.gravity_m_s2 = [tilt, -0.0, small];
            if round {
                scene.powder.yield_surface = YieldSurface::MatsuokaNakai;
                scene.powder.volume_correction = VolumeCorrection::Grid;
                scene.powder.flow =
                    Some(Flow { grain_diameter_m: 5e-4 + 1e-4 * small, grain_density_kg_m3: 1600.0 });
                scene.powder.loosening_strain = column.then_some(1.0 + small);
                scene.powder.transfer = Some(Transfer { residue_time_s: 0.05 + 0.1 * small });
            }
            if column {
                scene.domain.walls = Walls::TwoSided;
                scene.domain.sleep_by = SleepBy::MeanSquare;
                scene.domain.sleepers = Sleepers::Still;
            }
            if scoop {
                scene.powder.cohesion_pa = 7.0;
                scene.powder.tensile_strength_pa = Some(5.0 * small);
            }
            if round {
                scene.containers[1].shape =
                    ContainerShape::Cylinder { inner_radius_m: 0.03 + 1e-3 * small, inner_height_m: 0.04 };
            }
            if scoop && !round {
                scene.containers[1].shape = ContainerShape::SlottedBox {
                    inner_size_m: [0.06, 0.06, 0.04],
                    slot_width_m: 0.01 + 1e-3 * small,
                };
            }
            if round && scoop {
                let (inner_radius_m, inner_height_m) = (0.03, 0.04);
                scene.containers[1].shape = ContainerShape::Silo {
                    inner_radius_m,
                    inner_height_m,
                    outlet_radius_m: 0.01 + 1e-3 * small,
                };
            }
            if round && column {
                scene.containers[1].shape = ContainerShape::Hopper {
                    inner_radius_m: 0.03,
                    inner_height_m: 0.04,
                    outlet_radius_m: 0.01 + 1e-3 * small,
                    half_angle_deg: 45.0,
                };
            }
            if scoop {
                scene.tool.shape = ToolShape::BoxScoop { inner_size_m: [0.02, 0.02, 0.01 + 1e-3 * small] };
            }
            if column {
                scene.powder.fill_shape = FillShape::Cylinder;
            }
            scene.gates = (0..gates).map(|index| gate(index, small)).collect();
            if by_mass {
                scene.objective.amount = Amount::new(Quantity::MassKg(small * 0.07));
            } else {
                scene.objective.amount = Amount { wanted: Quantity::Particles(particles), tolerance: 0.01 };
            }
            scene.objective.observation = [
                Observation::All,
                Observation::Subsample { particles },
                Observation::VisibleFromAbove { pixel_m: 0.004 },
            ][observation];
            scene.objective.lost_weight = if by_mass { 0.0 } else { small };
            scene.skill.overlap = if column { small } else { 0.0 };
            if scoop {
                scene.skill.path =
                    PathSplines { knots: 1 + particles % 64, freedoms: vec![Freedom::Yaw, Freedom::Up] };
            }
            // A view from above goes with this one only.
            scene.objective.aim = [Aim::Amount, Aim::Amount, Aim::All][observation];
            scene.validate().expect("no rule is broken")
        },
    )
}

/// A pipe that vanishes, or a plate that slides.
fn gate(index: usize, small: f64) -> Gate {
    let (shape, opening) = match index {
        0 => (
            GateShape::Tube {
                inner_radius_m: 0.01 + 1e-3 * small,
                height_m: 0.01,
                wall_thickness_m: 0.002 + 1e-3 * small,
            },
            GateOpening::Vanish {},
        ),
        _ => (
            GateShape::Box { size_m: [0.01 + 1e-3 * small, 0.02, 0.004] },
            GateOpening::Slide { velocity_m_s: [-0.0, small, 0.1], travel_m: small },
        ),
    };
    Gate {
        name: format!("gate \"{index}\""),
        position_m: [0.176, 0.048, 0.004 + 1e-3 * small],
        yaw_deg: 100.0 * small,
        friction: small,
        opens_at_s: small,
        shape,
        opening,
    }
}

proptest! {
    #[test]
    fn a_written_scene_loads_back_equal_to_the_bit(scene in arbitrary_scene()) {
        let again = Scene::from_toml("again", &scene.to_toml()).unwrap();
        prop_assert_eq!(&again, &scene);
        prop_assert_eq!(again.digest(), scene.digest());
    }

    #[test]
    fn the_smallest_change_changes_the_digest(scene in arbitrary_scene()) {
        let changed = scene.with(|spec| spec.powder.density_kg_m3 = spec.powder.density_kg_m3.next_up()).unwrap();
        prop_assert_ne!(changed.digest(), scene.digest());
        if let Some(gate) = scene.gates.first() {
            let changed = scene.with(|spec| spec.gates[0].opens_at_s = gate.opens_at_s.next_up()).unwrap();
            prop_assert_ne!(changed.digest(), scene.digest());
        }
    }
}

#[test]
fn digests_differ_and_ignore_layout() {
    let digests = EMBEDDED_SCENES.map(|(name, _)| Scene::load(name).unwrap().digest());
    assert!(digests[0] != digests[1] && digests[1] != digests[2] && digests[0] != digests[2]);
    let (_, text) = EMBEDDED_SCENES[0];
    let without_comments: String =
        text.lines().map(|line| line.split(" #").next().unwrap().trim_end().to_owned() + "\n").collect();
    assert_eq!(Scene::from_toml("plain", &without_comments).unwrap().digest(), digests[0]);
}
