//! The plan file from outside: pinned bytes, damage, hostile content, round trips.

use std::convert::Infallible;

use powderline_shared::arm::ArmKind;
use powderline_shared::arm::inverse::Posture;
use powderline_shared::census::Census;
use powderline_shared::displacement::{Displacement, Lsb, Quantiser, Setpoint, StepCounts, pose_at};
use powderline_shared::limits::{Limit, Limits};
use powderline_shared::plan::{
    Crc32, FORMAT_VERSION, Finer, MAX_STEPS, Mounting, PlanError, PlanHeader, PlanReader, PlanSummary,
    PlanWriter, Precision, Prediction, SliceSink, StartPose, Version, WriteError,
};
use proptest::prelude::*;

const GOLDEN: &[u8] = include_bytes!("golden/plan-v4.plan");
const STEPS: u32 = 100;

fn header(step_count: u32) -> PlanHeader {
    PlanHeader {
        scene_digest: core::array::from_fn(|i| u8::try_from(i * 7).unwrap()),
        optimiser_version: Version { major: 0, minor: 1, patch: 300 },
        seed: 0x0123_4567_89ab_cdef,
        precision: Precision::F32,
        theta: [-1.0, -0.25, 0.0, 0.5, 1.0],
        skill_parameters: [0.018, 1.2, 0.06, 0.112, 2.2],
        path_coefficients: 36,
        control_period_us: 10_000,
        step_count,
        lsb: Lsb::default(),
        start: StartPose { position_m: [0.1, 0.2, 0.3], orientation_wxyz: [0.5, 0.5, -0.5, 0.5] },
        limits: Limits {
            workspace_min_m: [0.0; 3],
            workspace_max_m: [0.5, 0.6, 0.7],
            linear_velocity_m_s: 0.5,
            linear_acceleration_m_s2: 2.0,
            linear_jerk_m_s3: 40.0,
            angular_velocity_rad_s: 2.0,
            angular_acceleration_rad_s2: 10.0,
            angular_jerk_rad_s3: 200.0,
        },
        predicted: Prediction {
            loss_m: 1158.25,
            indicator: -3,
            wanted_kg: 0.0068,
            particle_mass_kg: 8e-6,
            census: Census { source: 2345, target: 853, rims: 4, tool: 3, spilled: 1, in_flight: 2 },
        },
        finer: Some(Finer {
            cell_m: 0.002,
            loss_m: 1161.5,
            particle_mass_kg: 1e-6,
            census: Census { source: 18_900, target: 6_701, rims: 40, tool: 20, spilled: 9, in_flight: 3 },
        }),
        arm: Some(Mounting {
            kind: ArmKind::Ur5e,
            world_from_base: StartPose {
                position_m: [0.6, 0.25, 0.0],
                orientation_wxyz: [1.0, 0.0, 0.0, 0.0],
            },
            // Rolled by 20 degrees.
            flange_from_tool: StartPose {
                position_m: [0.0, 0.0, 0.1],
                orientation_wxyz: [0.984_807_753_012_208, 0.173_648_177_666_930_33, 0.0, 0.0],
            },
            posture: Posture::PREFERRED[0],
        }),
    }
}

/// A minimum-jerk move with a turn, quantised.
fn smooth_steps(count: u32) -> Vec<StepCounts> {
    let at = |k: u32| {
        let s = f64::from(k) / f64::from(count);
        s * s * s * (10.0 + s * (6.0 * s - 15.0))
    };
    let mut quantiser = Quantiser::new(Lsb::default());
    let step = |k: u32| {
        let d = at(k) - at(k - 1);
        Displacement { translation_m: [0.1 * d, -0.02 * d, 0.05 * d], rotation_rad: [0.0, 0.4 * d, -0.1 * d] }
    };
    (1..=count).map(|k| quantiser.push(&step(k)).unwrap().1).collect()
}

fn write(
    header: &PlanHeader,
    steps: &[StepCounts],
) -> Result<(Vec<u8>, PlanSummary), WriteError<Infallible>> {
    let mut bytes = Vec::new();
    let sink = |part: &[u8]| {
        bytes.extend_from_slice(part);
        Ok(())
    };
    let mut writer = PlanWriter::new(sink, header)?;
    for step in steps {
        writer.step(*step)?;
    }
    let summary = writer.finish()?;
    Ok((bytes, summary))
}

fn golden_steps() -> Vec<StepCounts> {
    smooth_steps(STEPS)
}

/// Replaces the checksum by the one that fits, as someone would who means harm.
fn resealed(mut bytes: Vec<u8>) -> Vec<u8> {
    bytes.truncate(bytes.len() - 4);
    let mut crc = Crc32::default();
    crc.update(&bytes);
    bytes.extend(crc.value().to_le_bytes());
    bytes
}

#[test]
fn bytes_are_pinned() {
    let (bytes, summary) = write(&header(STEPS), &golden_steps()).unwrap();
    assert!(
        bytes == GOLDEN,
        "the plan format has changed: give it a new version, old plans are kept by users"
    );
    let plan = PlanReader::new(GOLDEN).unwrap();
    assert_eq!(*plan.header(), header(STEPS));
    assert!(plan.steps().eq(golden_steps()));
    assert_eq!(plan.end_setpoint(), summary.end);
    assert_eq!(plan.content_hash(), summary.content_hash);
    assert_eq!(summary.bytes, GOLDEN.len());
}

#[test]
fn the_end_is_where_the_steps_lead() {
    let plan = PlanReader::new(GOLDEN).unwrap();
    let end = plan.end_setpoint();
    assert_eq!(plan.setpoints().last(), Some(end));
    assert_eq!(end.tick, STEPS);
    assert_eq!(plan.end_pose(), pose_at(&header(STEPS).start.pose(), end, Lsb::default()));
    assert!((plan.end_pose().position_m.x - 0.2).abs() < 0.5e-7 * 1.001);
}

#[test]
fn the_motion_is_checked_against_its_own_limits() {
    let plan = PlanReader::new(GOLDEN).unwrap();
    assert!(plan.check_limits().unwrap().linear_velocity > 0.3);
    let slow = Limits { linear_velocity_m_s: 0.1, ..header(STEPS).limits };
    let (bytes, _) = write(&PlanHeader { limits: slow, ..header(STEPS) }, &golden_steps()).unwrap();
    let violation = PlanReader::new(&bytes).unwrap().check_limits().unwrap_err();
    assert_eq!(violation.limit, Limit::LinearVelocity);
}

#[test]
fn truncation_at_every_byte_is_refused() {
    for length in 0..GOLDEN.len() {
        assert!(PlanReader::new(&GOLDEN[..length]).is_err(), "{length}");
        if length >= 10 {
            let resealed = resealed([&GOLDEN[..length], &[0; 4]].concat());
            let found = PlanReader::new(&resealed);
            assert_eq!(found.is_ok(), length == GOLDEN.len() - 4, "resealed at {length}: {found:?}");
        }
    }
}

#[test]
fn every_single_flipped_bit_is_refused() {
    let mut bytes = GOLDEN.to_vec();
    for bit in 0..bytes.len() * 8 {
        bytes[bit / 8] ^= 1 << (bit % 8);
        assert!(PlanReader::new(&bytes).is_err(), "bit {bit}");
        bytes[bit / 8] ^= 1 << (bit % 8);
    }
}

#[test]
fn a_version_from_the_future_is_refused_with_both_numbers() {
    let mut bytes = GOLDEN.to_vec();
    bytes[8..10].copy_from_slice(&7_u16.to_le_bytes());
    let error = PlanReader::new(&resealed(bytes)).unwrap_err();
    assert_eq!(error, PlanError::Version { found: 7 });
    let sentence = error.to_string();
    assert!(sentence.contains('7') && sentence.contains(&FORMAT_VERSION.to_string()), "{sentence}");
}

#[test]
fn what_is_no_plan_is_named() {
    assert!(matches!(PlanReader::new(b""), Err(PlanError::TooShort { bytes: 0, least: 14 })));
    assert!(matches!(PlanReader::new(b"[domain]\nsize_m = 1\n"), Err(PlanError::NotAPlan { .. })));
    assert!(matches!(PlanReader::new(&[0xff; 4096]), Err(PlanError::NotAPlan { .. })));
}

#[test]
fn bytes_after_the_last_step_are_refused() {
    let mut bytes = GOLDEN.to_vec();
    bytes.splice(bytes.len() - 4..bytes.len() - 4, [0; 3]);
    assert_eq!(PlanReader::new(&resealed(bytes)).unwrap_err(), PlanError::TrailingBytes { bytes: 3 });
}

#[test]
fn a_header_that_cannot_be_meant_is_refused_by_writer_and_reader() {
    let fine = header(STEPS);
    let mut cases = vec![
        (PlanHeader { control_period_us: 0, ..fine }, "control period"),
        (PlanHeader { control_period_us: u32::MAX, ..fine }, "control period"),
        (PlanHeader { step_count: 0, ..fine }, "step count"),
        (PlanHeader { step_count: MAX_STEPS + 1, ..fine }, "step count"),
        (PlanHeader { lsb: Lsb { translation_nm: 0, ..fine.lsb }, ..fine }, "translation LSB"),
        (PlanHeader { lsb: Lsb { rotation_nrad: 0, ..fine.lsb }, ..fine }, "rotation LSB"),
        (PlanHeader { theta: [0.0, 1.5, 0.0, 0.0, 0.0], ..fine }, "theta"),
        (PlanHeader { predicted: Prediction { wanted_kg: -1.0, ..fine.predicted }, ..fine }, "wanted mass"),
        (
            PlanHeader { predicted: Prediction { particle_mass_kg: -1.0, ..fine.predicted }, ..fine },
            "mass of a particle",
        ),
        (PlanHeader { limits: Limits { linear_jerk_m_s3: -1.0, ..fine.limits }, ..fine }, "linear jerk"),
        (PlanHeader { limits: Limits { linear_jerk_m_s3: 0.01, ..fine.limits }, ..fine }, "linear jerk"),
        (PlanHeader { limits: Limits { workspace_min_m: [1.0; 3], ..fine.limits }, ..fine }, "workspace"),
        (PlanHeader { start: StartPose { orientation_wxyz: [1.0; 4], ..fine.start }, ..fine }, "orientation"),
    ];
    let refined = fine.finer.unwrap();
    let finer = |finer| PlanHeader { finer: Some(finer), ..fine };
    cases.push((finer(Finer { cell_m: 0.0, ..refined }), "finer grid has cells of 0 m"));
    let lighter = Finer { particle_mass_kg: -1.0, ..refined };
    cases.push((finer(lighter), "mass of a particle of the finer grid"));
    let mounted = fine.arm.unwrap();
    let arm = |arm| PlanHeader { arm: Some(arm), ..fine };
    let skewed = StartPose { orientation_wxyz: [1.0; 4], ..fine.start };
    cases.push((arm(Mounting { world_from_base: skewed, ..mounted }), "orientation of the arm's base"));
    cases.push((
        arm(Mounting { flange_from_tool: skewed, ..mounted }),
        "orientation of the tool in the flange",
    ));
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        cases.push((PlanHeader { theta: [value; 5], ..fine }, "theta"));
        cases.push((PlanHeader { skill_parameters: [value; 5], ..fine }, "skill parameters"));
        let predicted = |predicted| PlanHeader { predicted, ..fine };
        cases.push((predicted(Prediction { loss_m: value, ..fine.predicted }), "predicted loss"));
        cases.push((predicted(Prediction { wanted_kg: value, ..fine.predicted }), "wanted mass"));
        cases.push((
            predicted(Prediction { particle_mass_kg: value, ..fine.predicted }),
            "mass of a particle",
        ));
        cases.push((finer(Finer { cell_m: value, ..refined }), "cell of the finer grid"));
        cases.push((finer(Finer { loss_m: value, ..refined }), "loss on the finer grid"));
        let lighter = Finer { particle_mass_kg: value, ..refined };
        cases.push((finer(lighter), "mass of a particle of the finer grid"));
        let start = StartPose { position_m: [value; 3], ..fine.start };
        cases.push((PlanHeader { start, ..fine }, "start position"));
        cases.push((arm(Mounting { world_from_base: start, ..mounted }), "position of the arm's base"));
        cases.push((
            arm(Mounting { flange_from_tool: start, ..mounted }),
            "position of the tool in the flange",
        ));
        let limits = Limits { angular_velocity_rad_s: value, ..fine.limits };
        cases.push((PlanHeader { limits, ..fine }, "angular velocity"));
    }
    for (header, field) in cases {
        let Err(WriteError::Plan(error)) = write(&header, &[]) else { panic!("written without {field}") };
        assert!(error.to_string().contains(field), "{error}");
        let bytes = sealed_by_hand(&header, &golden_steps());
        let refused = PlanReader::new(&bytes).unwrap_err();
        assert_eq!(refused.to_string(), error.to_string());
    }
}

/// A plan file made without the writer and its checks.
fn sealed_by_hand(header: &PlanHeader, steps: &[StepCounts]) -> Vec<u8> {
    let mut bytes = GOLDEN[..10].to_vec();
    bytes.extend_from_slice(postcard::to_slice(header, &mut [0; 1024]).unwrap());
    for step in steps {
        bytes.extend_from_slice(postcard::to_slice(step, &mut [0; 64]).unwrap());
    }
    bytes.extend([0; 4]);
    resealed(bytes)
}

#[test]
fn hostile_steps_overflow_nothing() {
    for step in [[i32::MAX; 6], [i32::MIN; 6], [i32::MAX, 0, 0, 0, 0, 0], [0, 0, 0, 0, i32::MIN, 0]] {
        let steps = vec![step; STEPS as usize];
        let refused = PlanReader::new(&sealed_by_hand(&header(STEPS), &steps)).unwrap_err();
        assert!(matches!(refused, PlanError::Setpoint(_)), "{refused}");
    }
    let promised = PlanHeader { step_count: MAX_STEPS, ..header(STEPS) };
    let refused = PlanReader::new(&sealed_by_hand(&promised, &golden_steps())).unwrap_err();
    assert_eq!(refused, PlanError::Step { step: STEPS + 1, step_count: MAX_STEPS });
}

#[test]
fn the_writer_counts_its_steps() {
    let steps = golden_steps();
    let too_few = write(&header(STEPS), &steps[1..]);
    assert_eq!(too_few, Err(PlanError::StepCount { given: STEPS - 1, promised: STEPS }.into()));
    let too_many = write(&header(STEPS - 1), &steps);
    assert_eq!(too_many, Err(PlanError::StepCount { given: STEPS, promised: STEPS - 1 }.into()));
}

#[test]
fn a_slice_takes_a_plan_that_fits_and_no_other() {
    let fill = |buffer: &mut [u8]| {
        let mut writer = PlanWriter::new(SliceSink::new(buffer), &header(STEPS))?;
        for step in golden_steps() {
            writer.step(step)?;
        }
        writer.finish()
    };
    let mut buffer = vec![0; GOLDEN.len()];
    fill(&mut buffer).unwrap();
    assert_eq!(buffer, GOLDEN);
    for length in [0, 5, 300, GOLDEN.len() - 1] {
        assert!(matches!(fill(&mut buffer[..length]), Err(WriteError::Sink(_))), "{length}");
    }
}

proptest! {
    #[test]
    fn plans_survive_the_round_trip(
        steps in prop::collection::vec(prop::array::uniform6(-20_000..20_000_i32), 1..200),
        seed: u64, indicator: i64, loss in -1e300..1e300,
    ) {
        let header = PlanHeader {
            seed, predicted: Prediction { indicator, loss_m: loss, ..header(STEPS).predicted },
            ..header(u32::try_from(steps.len()).unwrap())
        };
        let (bytes, summary) = write(&header, &steps).unwrap();
        let plan = PlanReader::new(&bytes).unwrap();
        prop_assert_eq!(*plan.header(), header);
        prop_assert!(plan.steps().eq(steps.iter().copied()));
        prop_assert_eq!(plan.content_hash(), summary.content_hash);
        let sum: Vec<i32> = (0..6).map(|axis| steps.iter().map(|step| step[axis]).sum()).collect();
        prop_assert_eq!(plan.end_setpoint(), Setpoint { tick: header.step_count, counts: sum.try_into().unwrap() });
    }

    #[test]
    fn random_bytes_never_panic(mut bytes in prop::collection::vec(any::<u8>(), 0..2_000), keep in 0usize..400) {
        let keep = keep.min(bytes.len());
        bytes[..keep].copy_from_slice(&GOLDEN[..keep]);
        prop_assert!(PlanReader::new(&bytes).is_err());
        if bytes.len() >= 14 {
            // With a checksum that fits, the decoder itself meets the bytes.
            let _ = PlanReader::new(&resealed(bytes));
        }
    }
}
