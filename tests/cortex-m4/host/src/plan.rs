//! A plan for the flash: down, scoop, lift, transport, pour and back, each from rest to rest.

use std::convert::Infallible;

use anyhow::Result;
use powderline_shared::census::Census;
use powderline_shared::displacement::{Displacement, Lsb, Quantiser};
use powderline_shared::limits::Limits;
use powderline_shared::plan::{
    PlanHeader, PlanReader, PlanWriter, Precision, Prediction, StartPose, Version,
};

/// Translation (m), rotation vector in world axes (rad), steps.
const MOVES: [([f64; 3], [f64; 3], u32); 6] = [
    ([0.013, -0.007, -0.052], [0.0, 0.11, 0.0], 60),
    ([0.041, 0.003, 0.009], [0.02, 0.83, -0.05], 80),
    ([0.0, 0.0, 0.071], [0.0, 0.17, 0.0], 60),
    ([0.096, -0.038, 0.012], [0.0, 0.0, 0.4], 90),
    ([0.008, 0.0, -0.015], [0.21, 1.35, 0.1], 110),
    ([0.0, 0.021, 0.033], [-0.1, -1.2, 0.0], 90),
];

/// The plan's bytes, checked as any reader will.
pub(crate) fn bytes() -> Result<Vec<u8>> {
    let header = header();
    let mut bytes = Vec::new();
    let sink = |part: &[u8]| {
        bytes.extend_from_slice(part);
        Ok::<(), Infallible>(())
    };
    let mut writer = PlanWriter::new(sink, &header).map_err(|error| anyhow::anyhow!("{error:?}"))?;
    let mut quantiser = Quantiser::new(header.lsb);
    for (translation_m, rotation_rad, steps) in MOVES {
        for step in 1..=steps {
            let share = progress(step, steps) - progress(step - 1, steps);
            let displacement = Displacement {
                translation_m: translation_m.map(|x| x * share),
                rotation_rad: rotation_rad.map(|r| r * share),
            };
            let (_, counts) = quantiser.push(&displacement)?;
            writer.step(counts).map_err(|error| anyhow::anyhow!("{error:?}"))?;
        }
    }
    writer.finish().map_err(|error| anyhow::anyhow!("{error:?}"))?;
    PlanReader::new(&bytes)?.check_limits()?;
    Ok(bytes)
}

/// Minimum-jerk share of a move.
fn progress(step: u32, steps: u32) -> f64 {
    let s = f64::from(step) / f64::from(steps);
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

fn header() -> PlanHeader {
    PlanHeader {
        scene_digest: [7; 32],
        optimiser_version: Version { major: 0, minor: 1, patch: 0 },
        seed: 1,
        precision: Precision::F32,
        theta: [0.0; 5],
        skill_parameters: [0.018, 1.2, 0.06, 0.112, 2.2],
        path_coefficients: 0,
        control_period_us: 10_000,
        step_count: MOVES.iter().map(|(_, _, steps)| steps).sum(),
        lsb: Lsb::default(),
        start: StartPose { position_m: [0.3, 0.2, 0.25], orientation_wxyz: [0.8, 0.0, 0.6, 0.0] },
        limits: Limits {
            workspace_min_m: [0.0; 3],
            workspace_max_m: [0.7; 3],
            linear_velocity_m_s: 0.5,
            linear_acceleration_m_s2: 2.0,
            linear_jerk_m_s3: 40.0,
            angular_velocity_rad_s: 3.0,
            angular_acceleration_rad_s2: 15.0,
            angular_jerk_rad_s3: 300.0,
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
