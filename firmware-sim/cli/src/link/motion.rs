//! Plans for the simulated wire: smooth moves that an arm can perform.

use std::convert::Infallible;

use powderline_shared::displacement::{Displacement, Lsb, Quantiser};
use powderline_shared::limits::Limits;
use powderline_shared::plan::{PlanHeader, PlanWriter, Precision, Prediction, StartPose, Version};
use powderline_shared::pose::Pose;

use super::dice::Dice;

/// One minimum-jerk move from rest to rest.
#[derive(Clone, Copy, Debug)]
pub struct Move {
    /// Translation, metres.
    pub translation_m: [f64; 3],
    /// Rotation vector, radians.
    pub rotation_rad: [f64; 3],
    /// Control steps.
    pub steps: u32,
}

/// Limits that moves made by [`random_moves`] keep.
#[must_use]
pub fn limits() -> Limits {
    Limits {
        workspace_min_m: [-0.5; 3],
        workspace_max_m: [1.0; 3],
        linear_velocity_m_s: 1.0,
        linear_acceleration_m_s2: 8.0,
        linear_jerk_m_s3: 400.0,
        angular_velocity_rad_s: 4.0,
        angular_acceleration_rad_s2: 30.0,
        angular_jerk_rad_s3: 1_500.0,
    }
}

/// Where moves start.
#[must_use]
pub fn start() -> Pose {
    StartPose { position_m: [0.3, 0.2, 0.4], orientation_wxyz: [0.8, 0.0, 0.6, 0.0] }.pose()
}

/// One to three moves, each of 0.3 to 0.9 s.
pub fn random_moves(dice: &mut Dice, period_us: u32) -> Vec<Move> {
    let count = dice.between(1, 3);
    (0..count)
        .map(|_| {
            let length_us = dice.between(300_000, 900_000);
            let mut within = |reach: f64| [(); 3].map(|()| reach * (2.0 * dice.share() - 1.0));
            let (translation_m, rotation_rad) = (within(0.06), within(0.25));
            let steps = u32::try_from(length_us.div_ceil(u64::from(period_us))).unwrap_or(1);
            Move { translation_m, rotation_rad, steps }
        })
        .collect()
}

/// The plan file of the moves, one after another from `start`, with the limits that it promises to keep.
///
/// # Panics
/// If they do not make a plan; those of [`random_moves`] with [`limits`] do.
#[must_use]
pub fn plan_bytes(start: &Pose, limits: Limits, period_us: u32, moves: &[Move]) -> Vec<u8> {
    let header = PlanHeader {
        scene_digest: [0; 32],
        optimiser_version: Version { major: 0, minor: 0, patch: 0 },
        seed: 0,
        precision: Precision::F64,
        theta: [0.0; 5],
        skill_parameters: [0.0; 5],
        path_coefficients: 0,
        control_period_us: period_us,
        step_count: moves.iter().map(|part| part.steps).sum(),
        lsb: Lsb::default(),
        start: StartPose::from(start),
        limits,
        predicted: Prediction::default(),
        finer: None,
        arm: None,
    };
    let mut bytes = Vec::new();
    let sink = |part: &[u8]| {
        bytes.extend_from_slice(part);
        Ok::<(), Infallible>(())
    };
    let mut writer = PlanWriter::new(sink, &header).expect("the header is one of a plan");
    let mut quantiser = Quantiser::new(header.lsb);
    for part in moves {
        for step in 1..=part.steps {
            let at = |step: u32| minimum_jerk(f64::from(step) / f64::from(part.steps));
            let share = at(step) - at(step.saturating_sub(1));
            let displacement = Displacement {
                translation_m: part.translation_m.map(|x| x * share),
                rotation_rad: part.rotation_rad.map(|r| r * share),
            };
            let (_, counts) = quantiser.push(&displacement).expect("small moves fit the counters");
            writer.step(counts).expect("a vector takes everything");
        }
    }
    writer.finish().expect("as many steps as promised");
    bytes
}

fn minimum_jerk(s: f64) -> f64 {
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}
