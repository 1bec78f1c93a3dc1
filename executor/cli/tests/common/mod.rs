//! Plans for tests.

use std::convert::Infallible;

use powderline_shared::census::Census;
use powderline_shared::displacement::{Displacement, Lsb, Quantiser};
use powderline_shared::limits::Limits;
use powderline_shared::plan::{PlanHeader, PlanWriter, Precision, Prediction, StartPose, Version};

/// One smooth move: translation (m), rotation vector in its own frame of reference (rad), steps.
#[derive(Clone, Debug)]
pub(crate) struct Move {
    pub(crate) translation_m: [f64; 3],
    pub(crate) rotation_rad: [f64; 3],
    pub(crate) steps: u32,
}

pub(crate) fn header() -> PlanHeader {
    PlanHeader {
        scene_digest: [7; 32],
        optimiser_version: Version { major: 0, minor: 1, patch: 0 },
        seed: 1,
        precision: Precision::F32,
        theta: [0.0; 5],
        skill_parameters: [0.018, 1.2, 0.06, 0.112, 2.2],
        path_coefficients: 0,
        control_period_us: 10_000,
        step_count: 0,
        lsb: Lsb::default(),
        start: StartPose { position_m: [0.3, 0.2, 0.4], orientation_wxyz: [0.8, 0.0, 0.6, 0.0] },
        limits: Limits {
            workspace_min_m: [-0.5; 3],
            workspace_max_m: [1.0; 3],
            linear_velocity_m_s: 1.0,
            linear_acceleration_m_s2: 5.0,
            linear_jerk_m_s3: 100.0,
            angular_velocity_rad_s: 4.0,
            angular_acceleration_rad_s2: 20.0,
            angular_jerk_rad_s3: 400.0,
        },
        predicted: Prediction {
            loss_m: 1.0,
            indicator: 3,
            wanted_kg: 0.006_824,
            particle_mass_kg: 8e-6,
            census: Census { source: 2000, target: 850, rims: 1, tool: 0, spilled: 2, in_flight: 0 },
        },
        finer: None,
        arm: None,
    }
}

pub(crate) fn one_move() -> Vec<Move> {
    vec![Move { translation_m: [0.1, -0.05, 0.08], rotation_rad: [0.1, 0.9, 0.0], steps: 120 }]
}

/// Minimum-jerk share of a move.
fn smooth(s: f64) -> f64 {
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

/// The moves one after another, each from rest to rest.
pub(crate) fn plan_bytes(header: &PlanHeader, moves: &[Move]) -> Vec<u8> {
    let step_count = moves.iter().map(|segment| segment.steps).sum();
    let mut bytes = Vec::new();
    let sink = |part: &[u8]| {
        bytes.extend_from_slice(part);
        Ok::<(), Infallible>(())
    };
    let mut writer = PlanWriter::new(sink, &PlanHeader { step_count, ..*header }).unwrap();
    let mut quantiser = Quantiser::new(header.lsb);
    for segment in moves {
        let at = |step: u32| smooth(f64::from(step) / f64::from(segment.steps));
        for step in 1..=segment.steps {
            let share = at(step) - at(step - 1);
            let displacement = Displacement {
                translation_m: segment.translation_m.map(|x| x * share),
                rotation_rad: segment.rotation_rad.map(|r| r * share),
            };
            writer.step(quantiser.push(&displacement).unwrap().1).unwrap();
        }
    }
    writer.finish().unwrap();
    bytes
}
