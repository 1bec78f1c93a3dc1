//! The arm as the controller sees it: poses in, poses or a reason out.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{Matrix6, Vector3};
use powderline_firmware_sim::arm::inverse::Posture;
use powderline_firmware_sim::arm::servo::Lag;
use powderline_firmware_sim::arm::ur5e::SingularityMargins;
use powderline_firmware_sim::arm::{Arm, ArmError, ArmModel, Joints};
use powderline_shared::fault::FaultCode;
use powderline_shared::pose::{Pose, exp_so3, norm};
use proptest::prelude::*;

/// The tool at a place on the bench, pitched about y.
fn pitched(position_m: [f64; 3], pitch_deg: f64) -> Pose {
    Pose {
        position_m: Vector3::from(position_m),
        orientation: exp_so3(&Vector3::new(0.0, pitch_deg.to_radians(), 0.0)),
    }
}

/// Where the default bench's motion starts.
fn start() -> Pose {
    pitched([0.0455, 0.048, 0.066], 80.0)
}

fn without_lag() -> ArmModel {
    ArmModel { lag: Lag { time_constant_s: 0.0 }, ..ArmModel::bench() }
}

/// Distances in position (metres) and rotation (radians).
fn apart(a: &Pose, b: &Pose) -> [f64; 2] {
    let between = a.displacement_to(b);
    [norm(&between.translation()), norm(&between.rotation())]
}

fn assert_near(a: &Pose, b: &Pose, tolerance: f64) {
    assert!(apart(a, b).iter().all(|distance| *distance < tolerance), "{a:?} {b:?} {:?}", apart(a, b));
}

/// From `from` to `to`, straight and at constant angular velocity.
fn between(from: &Pose, to: &Pose, share: f64) -> Pose {
    let mut part = from.displacement_to(to);
    part.translation_m = part.translation_m.map(|value| value * share);
    part.rotation_rad = part.rotation_rad.map(|value| value * share);
    from.displaced(&part)
}

// --- the bench ---

/// What the sweep of the bench found, at worst.
#[derive(Debug)]
struct Worst {
    margin: f64,
    singular_value: f64,
    range_left_rad: f64,
    joint_speed_rad_s: f64,
    off: f64,
}

/// Joint speeds, at most, for the tool moving in any direction at `v` m/s while it pitches at `w` rad/s.
fn largest_joint_speed(jacobian: &Matrix6<f64>, v: f64, w: f64) -> f64 {
    let inverse = jacobian.try_inverse().unwrap();
    let rows = inverse.row_iter();
    rows.map(|row| v * row.fixed_columns::<3>(0).norm() + w * row[4].abs()).fold(0.0, f64::max)
}

/// The Jacobian's smallest singular value with lengths measured in units of 0.1 m, the reach of the wrist.
fn smallest_singular_value(jacobian: &Matrix6<f64>) -> f64 {
    let mut scaled = *jacobian;
    scaled.fixed_view_mut::<3, 6>(0, 0).scale_mut(10.0);
    scaled.singular_values().min()
}

#[test]
fn the_whole_bench_is_well_within_reach() {
    let model = without_lag();
    let mut worst = Worst {
        margin: f64::INFINITY,
        singular_value: f64::INFINITY,
        range_left_rad: f64::INFINITY,
        joint_speed_rad_s: 0.0,
        off: 0.0,
    };
    let steps = |count: u32, last: f64| (0..=count).map(move |k| last * f64::from(k) / f64::from(count));
    for (x, y) in steps(10, 0.25).flat_map(|x| steps(4, 0.08).map(move |y| (x, y))) {
        for (z, pitch_deg) in steps(8, 0.2).flat_map(|z| steps(24, 240.0).map(move |p| (z, p - 30.0))) {
            let pose = pitched([x, y, z], pitch_deg);
            let joints = Arm::new(model, pose).unwrap().joints().unwrap();
            let jacobian = model.jacobian(&joints);
            worst.margin = worst.margin.min(SingularityMargins::of(&joints).least().1);
            worst.singular_value = worst.singular_value.min(smallest_singular_value(&jacobian));
            let left = joints.iter().map(|angle| TAU - angle.abs()).fold(TAU, f64::min);
            worst.range_left_rad = worst.range_left_rad.min(left);
            worst.joint_speed_rad_s = worst.joint_speed_rad_s.max(largest_joint_speed(&jacobian, 0.3, 0.0));
            worst.off = apart(&pose, &model.world_from_tool(&joints)).into_iter().fold(worst.off, f64::max);
            // Pitching is wrist 3 alone.
            let pitching = jacobian.try_inverse().unwrap().column(4).into_owned();
            assert!((pitching[5] - 1.0).abs() < 1e-12 && pitching.fixed_rows::<5>(0).norm() < 1e-12);
        }
    }
    println!("{worst:?}");
    assert!(worst.margin > 0.55, "{worst:?}");
    assert!(worst.singular_value > 0.5, "{worst:?}");
    assert!(worst.range_left_rad > 4.1, "{worst:?}");
    assert!(worst.joint_speed_rad_s < 0.5 * PI, "{worst:?}");
    assert!(worst.off < 1e-14, "{worst:?}");
}

#[test]
fn the_flange_stays_beyond_the_edge_of_the_bench() {
    let model = without_lag();
    for (x, y, z) in [(0.0, 0.08, 0.0), (0.25, 0.08, 0.2), (0.125, 0.08, 0.1)] {
        for pitch_deg in [-30.0, 80.0, 210.0] {
            let pose = pitched([x, y, z], pitch_deg);
            let flange_m = pose.world_from_tool(&model.flange_from_tool.tool_from_world(&Vector3::zeros()));
            assert!((flange_m - Vector3::new(x, -0.02, z)).norm() < 1e-15, "{flange_m}");
        }
    }
}

// --- following ---

#[test]
fn an_ideal_arm_is_anywhere_at_once() {
    let mut arm = Arm::ideal(start());
    assert_eq!((arm.pose(), arm.commanded(), arm.joints()), (start(), start(), None));
    let far = pitched([1e6, 0.0, 0.0], 10.0);
    assert_eq!(arm.check(&far, 0.0), Ok(()));
    assert_eq!(arm.follow(far, 0.0), Ok(()));
    assert_eq!((arm.pose(), arm.commanded()), (far, far));
}

#[test]
fn without_lag_the_tool_is_exactly_where_it_is_told_to_be() {
    let mut arm = Arm::new(without_lag(), start()).unwrap();
    assert_eq!(arm.pose(), start());
    let end = pitched([0.16, 0.05, 0.12], 130.0);
    for tick in 1..=200 {
        let pose = between(&start(), &end, f64::from(tick) / 200.0);
        assert_eq!(arm.check(&pose, 0.01), Ok(()));
        assert_eq!(arm.follow(pose, 0.01), Ok(()));
        assert_eq!((arm.pose(), arm.commanded()), (pose, pose));
    }
}

#[test]
fn with_lag_the_tool_is_late_and_settles() {
    let mut arm = Arm::new(ArmModel::bench(), start()).unwrap();
    let speed_m_s = 0.2;
    let along = |t_s: f64| pitched([0.0455 + speed_m_s * t_s, 0.048, 0.066], 80.0);
    for tick in 1..=100 {
        arm.follow(along(0.002 * f64::from(tick)), 0.002).unwrap();
    }
    // On a long way at constant speed the tool is late by the time constant, but for the way's curvature in the joints.
    assert_eq!(arm.commanded(), along(0.2));
    assert_near(&arm.pose(), &along(0.2 - 0.010), 2e-5);

    let behind = apart(&arm.pose(), &arm.commanded())[0];
    for time_constants in 1..=40 {
        arm.follow(along(0.2), 0.010).unwrap();
        let expected = behind * f64::from(-time_constants).exp();
        let left = apart(&arm.pose(), &arm.commanded())[0];
        assert!((left - expected).abs() < 0.01 * expected + 1e-14, "{time_constants}: {left} for {expected}");
    }
    assert_near(&arm.pose(), &along(0.2), 1e-14);
}

#[test]
fn a_standing_arm_stays_for_ever_and_at_any_rate() {
    let mut arm = Arm::new(ArmModel::bench(), start()).unwrap();
    for dt_s in [0.0, 1e-6, 0.01, 1e9, -1.0, f64::NAN] {
        assert_eq!(arm.follow(start(), dt_s), Ok(()));
        assert_eq!(arm.pose(), start());
    }
}

#[test]
fn a_refused_command_changes_nothing_but_the_time() {
    let mut arm = Arm::new(ArmModel::bench(), start()).unwrap();
    let next = pitched([0.0475, 0.048, 0.066], 80.0);
    arm.follow(next, 0.01).unwrap();
    let mut other = arm;
    let refused = arm.follow(pitched([0.0475, 0.048, 3.0], 80.0), 0.01).unwrap_err();
    assert_eq!(refused.code(), FaultCode::ArmUnreachable);
    other.follow(next, 0.01).unwrap();
    assert_eq!((arm.pose(), arm.commanded(), arm.joints()), (other.pose(), next, other.joints()));
}

/// Pins the bits, which must be the same on every machine.
#[test]
fn bits_are_pinned() {
    let mut arm = Arm::new(ArmModel::bench(), start()).unwrap();
    arm.follow(pitched([0.05, 0.047, 0.068], 81.0), 0.01).unwrap();
    let Pose { position_m, orientation } = arm.pose();
    let bits = [position_m.x, position_m.y, position_m.z, orientation.j].map(f64::to_bits);
    assert_eq!(bits, [0x3fa825224e539690, 0x3fa8641342731100, 0x3fb115b8b54548da, 0xbfe4a5d5d61f5982]);
}

// --- refusals ---

/// The first refusal on the way, in steps of `dt_s`.
fn first_refusal(arm: &mut Arm, steps: u32, dt_s: f64, way: impl Fn(f64) -> Pose) -> ArmError {
    for step in 1..=steps {
        let pose = way(f64::from(step) / f64::from(steps));
        let expected = arm.check(&pose, dt_s);
        let found = arm.follow(pose, dt_s);
        assert_eq!(found, expected);
        if let Err(error) = found {
            return error;
        }
    }
    panic!("all was accepted");
}

#[test]
fn too_far_away() {
    let error = Arm::new(ArmModel::bench(), pitched([0.1, 0.9, 0.1], 80.0)).unwrap_err();
    assert_eq!(error.code(), FaultCode::ArmUnreachable);
    assert!(matches!(error, ArmError::Unreachable { joint: 3, distance_m, bound_m }
        if distance_m > 1.3 && (bound_m - 0.8172).abs() < 1e-15));
    assert!(error.to_string().ends_with("m from the shoulder, and can be 0.8172 m at the most"), "{error}");
}

#[test]
fn within_the_column() {
    let above_base = pitched([0.3, -0.7 + 0.0996 + 0.1, 0.5], 80.0);
    let error = Arm::new(ArmModel::bench(), above_base).unwrap_err();
    assert_eq!(error.code(), FaultCode::ArmUnreachable);
    assert!(matches!(error, ArmError::Unreachable { joint: 1, distance_m, bound_m: 0.1333 }
        if (distance_m - 0.04).abs() < 1e-12));
    assert!(error.to_string().ends_with("0.0400 m from axis 1, and can be 0.1333 m at the least"), "{error}");
}

#[test]
fn no_number_at_all() {
    let mut arm = Arm::new(ArmModel::bench(), start()).unwrap();
    for number in [f64::NAN, f64::INFINITY, f64::MAX] {
        let error = arm.follow(pitched([number, 0.048, 0.066], 80.0), 0.01).unwrap_err();
        assert_eq!(error.code(), FaultCode::ArmUnreachable);
    }
    assert!(arm.follow(pitched([0.0455, 0.048, 0.066], f64::NAN), 0.01).is_err());
    assert_eq!(arm.pose(), start());
}

#[test]
fn a_joint_at_its_limit() {
    let mut arm = Arm::new(ArmModel::bench(), start()).unwrap();
    // Round and round about the pitch axis: wrist 3, which is at 0 for a pitch of 90 degrees.
    let way = |share: f64| pitched([0.0455, 0.048, 0.066], 80.0 + 720.0 * share);
    let error = first_refusal(&mut arm, 720, 0.01, way);
    assert_eq!(error.code(), FaultCode::ArmJointLimit);
    assert!(matches!(error, ArmError::JointLimit { joint: 6, angle_rad, bound_rad: TAU }
        if angle_rad > TAU && angle_rad < TAU + 0.02));
    // A whole turn and all that the start left of the second.
    let accepted = arm.joints().unwrap()[5];
    assert!(accepted > TAU - 0.1, "{accepted}");
}

#[test]
fn a_joint_at_its_speed() {
    let arm = Arm::new(ArmModel::bench(), start()).unwrap();
    let turned = |angle_rad: f64| pitched([0.0455, 0.048, 0.066], 80.0 + angle_rad.to_degrees());
    assert_eq!(arm.check(&turned(0.999 * PI * 0.01), 0.01), Ok(()));
    let error = arm.check(&turned(1.001 * PI * 0.01), 0.01).unwrap_err();
    assert_eq!(error.code(), FaultCode::ArmJointSpeed);
    assert!(matches!(error, ArmError::JointSpeed { joint: 6, speed_rad_s, bound_rad_s: PI }
        if (speed_rad_s - 1.001 * PI).abs() < 1e-9));
    for dt_s in [0.0, -1.0, f64::NAN] {
        assert!(matches!(arm.check(&turned(0.001), dt_s), Err(ArmError::JointSpeed { .. })));
    }
}

#[test]
fn the_neighbourhood_of_each_singularity() {
    let is_singular = |error: ArmError, wanted: u8| {
        assert_eq!(error.code(), FaultCode::ArmSingular);
        let ArmError::Singular { joint, margin, bound } = error else { panic!("{error}") };
        assert!(joint == wanted && margin < bound && margin > 0.8 * bound, "{error}");
    };
    // Slowly enough that no joint comes to its speed before.
    let from = |end: Pose, steps: u32| {
        let mut arm = Arm::new(ArmModel::bench(), start()).unwrap();
        first_refusal(&mut arm, steps, 0.01, |share| between(&start(), &end, share))
    };
    // The arm stretched out.
    is_singular(from(pitched([0.0455, 0.048, 1.0], 80.0), 2_000), 3);
    // The wrist over the shoulder: it passes the column at its offset.
    is_singular(from(pitched([0.26 - 0.1333, -0.5, 0.3], 80.0), 2_000), 1);
    // Axis 6 turned into the direction of axes 2 to 4.
    let turned = Pose { orientation: exp_so3(&(Vector3::z() * 1.5)) * start().orientation, ..start() };
    is_singular(from(turned, 4_000), 5);
}

#[test]
fn a_leap_over_a_singularity_is_too_fast() {
    // The mirror image in wrist 2: the tool hardly moves, in another posture it would even be near.
    let model = ArmModel::bench();
    let arm = Arm::new(model, start()).unwrap();
    let mut beyond = arm.joints().unwrap();
    beyond[4] = -0.2;
    let error = arm.check(&model.world_from_tool(&beyond), 0.01).unwrap_err();
    assert_eq!(error.code(), FaultCode::ArmJointSpeed);
}

// --- any posture ---

fn joints() -> impl Strategy<Value = Joints> {
    let turn = 0.9 * TAU;
    [-turn..turn, -turn..turn, -turn..turn, -turn..turn, -turn..turn, -turn..turn]
        .prop_filter("near a singularity", |joints: &Joints| SingularityMargins::of(joints).least().1 > 0.06)
}

proptest! {
    /// Position to 10^-14 m, rotation to 10^-14 rad, and the joints that it began with.
    #[test]
    fn joints_come_back_from_the_pose(joints in joints()) {
        let model = ArmModel { posture: Posture::of(&joints), ..without_lag() };
        let pose = model.world_from_tool(&joints);
        let found = model.joints_near(&joints, &pose).unwrap();
        prop_assert!(joints.iter().zip(found).all(|(a, b)| (a - b).abs() < 1e-12));
        let off = apart(&pose, &model.world_from_tool(&found));
        prop_assert!(off.iter().all(|off| *off < 1e-14), "{off:?}");
    }

    /// While the joints move slowly, what is found from the poses is the way that they went.
    #[test]
    fn the_arm_goes_the_way_of_the_joints(start in joints(), rate in [-1.0..1.0, -1.0..1.0, -1.0..1.0, -1.0..1.0, -1.0..1.0, -1.0..1.0f64]) {
        let model = ArmModel { posture: Posture::of(&start), ..without_lag() };
        let mut found = start;
        for tick in 1..=50 {
            let mut expected = start;
            for (angle, rate) in expected.iter_mut().zip(rate) {
                *angle += 0.01 * f64::from(tick) * rate;
            }
            match model.joints_after(&found, &model.world_from_tool(&expected), 0.01) {
                Ok(joints) => found = joints,
                Err(error) => {
                    let margin = SingularityMargins::of(&expected).least().1;
                    let named = matches!(error, ArmError::Singular { margin: found, .. } if (found - margin).abs() < 1e-9);
                    prop_assert!(named, "{error}");
                    break;
                }
            }
            prop_assert!(expected.iter().zip(found).all(|(a, b)| (a - b).abs() < 1e-12), "{expected:?} {found:?}");
        }
    }

    /// The Jacobian of the tool in the world.
    #[test]
    fn the_jacobian_is_the_derivative(joints in joints()) {
        let (model, step) = (ArmModel::bench(), 1e-5);
        let jacobian = model.jacobian(&joints);
        for (column, joint) in jacobian.column_iter().zip(0..6) {
            let [before, after] = [-step, step].map(|step| {
                let mut moved = joints;
                moved[joint] += step;
                model.world_from_tool(&moved)
            });
            let difference = before.displacement_to(&after);
            prop_assert!((column.fixed_rows::<3>(0) - difference.translation() / (2.0 * step)).norm() < 1e-9);
            prop_assert!((column.fixed_rows::<3>(3) - difference.rotation() / (2.0 * step)).norm() < 1e-9);
        }
    }
}

#[test]
fn the_bench_is_begun_with_elbow_up_and_wrist_3_in_the_middle() {
    let pose = pitched([0.26 - 0.1333, 0.04, 0.1], 90.0);
    let joints = Arm::new(ArmModel::bench(), pose).unwrap().joints().unwrap();
    // The upper arm leans forward from upright, the forearm comes down, wrist 1 levels it out.
    let [q1, q2, q3, q4, q5, q6] = joints;
    assert!(q1.abs() < 1e-12 && (q5 - FRAC_PI_2).abs() < 1e-12 && q6.abs() < 1e-12, "{joints:?}");
    assert!(q2 > -FRAC_PI_2 && q2 < 0.0 && q3 > FRAC_PI_2 && (q2 + q3 + q4).abs() < 1e-12, "{joints:?}");
}
