//! The arm as the controller sees it: poses in, poses or a reason out.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector3;
use powderline_firmware_sim::arm::Arm;
use powderline_firmware_sim::arm::servo::Lag;
use powderline_shared::arm::{ArmError, ArmModel};
use powderline_shared::fault::FaultCode;
use powderline_shared::pose::{Pose, exp_so3, norm};

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

/// The bench's arm, with the lag of its drives.
fn arm_at(pose: Pose) -> Result<Arm, ArmError> {
    Arm::new(ArmModel::bench(), Lag::default(), pose)
}

/// Whether the arm takes a pose as its next one.
fn check(arm: &Arm, pose: &Pose, dt_s: f64) -> Result<(), ArmError> {
    arm.target(arm.told(), pose, dt_s).map(drop)
}

/// Lets time go by, in which the arm is told to go to a pose; if it cannot, to where it was told to be before.
fn follow(arm: &mut Arm, pose: Pose, dt_s: f64) -> Result<(), ArmError> {
    let target = arm.target(arm.told(), &pose, dt_s);
    arm.follow(*target.as_ref().unwrap_or(arm.told()), dt_s);
    target.map(drop)
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

// --- following ---

#[test]
fn an_ideal_arm_is_anywhere_at_once() {
    let mut arm = Arm::ideal(start());
    assert_eq!((arm.pose(), arm.told().pose, arm.joints()), (start(), start(), None));
    let far = pitched([1e6, 0.0, 0.0], 10.0);
    assert_eq!(check(&arm, &far, 0.0), Ok(()));
    assert_eq!(follow(&mut arm, far, 0.0), Ok(()));
    assert_eq!((arm.pose(), arm.told().pose), (far, far));
}

#[test]
fn without_lag_the_tool_is_exactly_where_it_is_told_to_be() {
    let mut arm = Arm::new(ArmModel::bench(), Lag::NONE, start()).unwrap();
    assert_eq!(arm.pose(), start());
    let end = pitched([0.16, 0.05, 0.12], 130.0);
    for tick in 1..=200 {
        let pose = between(&start(), &end, f64::from(tick) / 200.0);
        assert_eq!(check(&arm, &pose, 0.01), Ok(()));
        assert_eq!(follow(&mut arm, pose, 0.01), Ok(()));
        assert_eq!((arm.pose(), arm.told().pose), (pose, pose));
    }
}

#[test]
fn with_lag_the_tool_is_late_and_settles() {
    let mut arm = arm_at(start()).unwrap();
    let speed_m_s = 0.2;
    let along = |t_s: f64| pitched([0.0455 + speed_m_s * t_s, 0.048, 0.066], 80.0);
    for tick in 1..=100 {
        follow(&mut arm, along(0.002 * f64::from(tick)), 0.002).unwrap();
    }
    // On a long way at constant speed the tool is late by the time constant, but for the way's curvature in the joints.
    assert_eq!(arm.told().pose, along(0.2));
    assert_near(&arm.pose(), &along(0.2 - 0.010), 2e-5);

    let behind = apart(&arm.pose(), &arm.told().pose)[0];
    for time_constants in 1..=40 {
        follow(&mut arm, along(0.2), 0.010).unwrap();
        let expected = behind * f64::from(-time_constants).exp();
        let left = apart(&arm.pose(), &arm.told().pose)[0];
        assert!((left - expected).abs() < 0.01 * expected + 1e-14, "{time_constants}: {left} for {expected}");
    }
    assert_near(&arm.pose(), &along(0.2), 1e-14);
}

#[test]
fn a_standing_arm_stays_for_ever_and_at_any_rate() {
    let mut arm = arm_at(start()).unwrap();
    for dt_s in [0.0, 1e-6, 0.01, 1e9, -1.0, f64::NAN] {
        assert_eq!(follow(&mut arm, start(), dt_s), Ok(()));
        assert_eq!(arm.pose(), start());
    }
}

#[test]
fn a_refused_command_changes_nothing_but_the_time() {
    let mut arm = arm_at(start()).unwrap();
    let next = pitched([0.0475, 0.048, 0.066], 80.0);
    follow(&mut arm, next, 0.01).unwrap();
    let mut other = arm;
    let refused = follow(&mut arm, pitched([0.0475, 0.048, 3.0], 80.0), 0.01).unwrap_err();
    assert_eq!(refused.code(), FaultCode::ArmUnreachable);
    follow(&mut other, next, 0.01).unwrap();
    assert_eq!((arm.pose(), arm.told().pose, arm.joints()), (other.pose(), next, other.joints()));
}

/// Pins the bits, which must be the same on every machine.
#[test]
fn bits_are_pinned() {
    let mut arm = arm_at(start()).unwrap();
    follow(&mut arm, pitched([0.05, 0.047, 0.068], 81.0), 0.01).unwrap();
    let Pose { position_m, orientation } = arm.pose();
    let bits = [position_m.x, position_m.y, position_m.z, orientation.j].map(f64::to_bits);
    assert_eq!(bits, [0x3fa82523e72c09e0, 0x3fa8640810e425f0, 0x3fb115c007d01b56, 0xbfe4a5d5d61f5982]);
}

// --- refusals ---

/// The first refusal on the way, in steps of `dt_s`.
fn first_refusal(arm: &mut Arm, steps: u32, dt_s: f64, way: impl Fn(f64) -> Pose) -> ArmError {
    for step in 1..=steps {
        let pose = way(f64::from(step) / f64::from(steps));
        let expected = check(arm, &pose, dt_s);
        let found = follow(arm, pose, dt_s);
        assert_eq!(found, expected);
        if let Err(error) = found {
            return error;
        }
    }
    panic!("all was accepted");
}

#[test]
fn too_far_away() {
    let error = arm_at(pitched([0.1, 0.9, 0.1], 80.0)).unwrap_err();
    assert_eq!(error.code(), FaultCode::ArmUnreachable);
    assert!(matches!(error, ArmError::Unreachable { joint: 3, distance_m, bound_m }
        if distance_m > 1.3 && (bound_m - 0.8172).abs() < 1e-15));
    assert!(error.to_string().ends_with("m from the shoulder, and can be 0.8172 m at the most"), "{error}");
}

#[test]
fn within_the_column() {
    let above_base = pitched([0.3, -0.7 + 0.0996 + 0.1, 0.5], 80.0);
    let error = arm_at(above_base).unwrap_err();
    assert_eq!(error.code(), FaultCode::ArmUnreachable);
    assert!(matches!(error, ArmError::Unreachable { joint: 1, distance_m, bound_m: 0.1333 }
        if (distance_m - 0.04).abs() < 1e-12));
    assert!(error.to_string().ends_with("0.0400 m from axis 1, and can be 0.1333 m at the least"), "{error}");
}

#[test]
fn no_number_at_all() {
    let mut arm = arm_at(start()).unwrap();
    for number in [f64::NAN, f64::INFINITY, f64::MAX] {
        let error = follow(&mut arm, pitched([number, 0.048, 0.066], 80.0), 0.01).unwrap_err();
        assert_eq!(error.code(), FaultCode::ArmUnreachable);
    }
    assert!(follow(&mut arm, pitched([0.0455, 0.048, 0.066], f64::NAN), 0.01).is_err());
    assert_eq!(arm.pose(), start());
}

#[test]
fn a_joint_at_its_limit() {
    let mut arm = arm_at(start()).unwrap();
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
    let arm = arm_at(start()).unwrap();
    let turned = |angle_rad: f64| pitched([0.0455, 0.048, 0.066], 80.0 + angle_rad.to_degrees());
    assert_eq!(check(&arm, &turned(0.999 * PI * 0.01), 0.01), Ok(()));
    let error = check(&arm, &turned(1.001 * PI * 0.01), 0.01).unwrap_err();
    assert_eq!(error.code(), FaultCode::ArmJointSpeed);
    assert!(matches!(error, ArmError::JointSpeed { joint: 6, speed_rad_s, bound_rad_s: PI }
        if (speed_rad_s - 1.001 * PI).abs() < 1e-9));
    for dt_s in [0.0, -1.0, f64::NAN] {
        assert!(matches!(check(&arm, &turned(0.001), dt_s), Err(ArmError::JointSpeed { .. })));
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
        let mut arm = arm_at(start()).unwrap();
        first_refusal(&mut arm, steps, 0.01, |share| between(&start(), &end, share))
    };
    // The arm stretched out.
    is_singular(from(pitched([0.0455, 0.048, 1.0], 80.0), 8_000), 3);
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
    let arm = arm_at(start()).unwrap();
    let mut beyond = arm.joints().unwrap();
    beyond[4] = -0.2;
    let error = check(&arm, &model.world_from_tool(&beyond), 0.01).unwrap_err();
    assert_eq!(error.code(), FaultCode::ArmJointSpeed);
}
