//! The kinematics as their users see them: poses in, joints or a reason out.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{Isometry3, Matrix6, Translation3, UnitQuaternion, Vector3};
use powderline_shared::arm::inverse::Posture;
use powderline_shared::arm::links::SingularityMargins;
use powderline_shared::arm::{ArmError, ArmKind, ArmModel, Joints};
use powderline_shared::pose::{Pose, exp_so3, norm};
use proptest::prelude::*;

/// The tool at a place on the bench, pitched about y.
fn pitched(position_m: [f64; 3], pitch_deg: f64) -> Pose {
    Pose {
        position_m: Vector3::from(position_m),
        orientation: exp_so3(&Vector3::new(0.0, pitch_deg.to_radians(), 0.0)),
    }
}

/// Distances in position (metres) and rotation (radians).
fn apart(a: &Pose, b: &Pose) -> [f64; 2] {
    let between = a.displacement_to(b);
    [norm(&between.translation()), norm(&between.rotation())]
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
    let model = ArmModel::bench();
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
            let joints = model.joints_near(&[0.0; 6], &pose).unwrap();
            let jacobian = model.jacobian(&joints);
            worst.margin = worst.margin.min(SingularityMargins::of(ArmKind::Ur5e, &joints).least().1);
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
    assert!(worst.singular_value > 0.45, "{worst:?}");
    assert!(worst.range_left_rad > 4.1, "{worst:?}");
    assert!(worst.joint_speed_rad_s < 0.5 * PI, "{worst:?}");
    assert!(worst.off < 1e-14, "{worst:?}");
}

#[test]
fn the_flange_stays_beyond_the_edge_of_the_bench() {
    let model = ArmModel::bench();
    for (x, y, z) in [(0.0, 0.08, 0.0), (0.25, 0.08, 0.2), (0.125, 0.08, 0.1)] {
        for pitch_deg in [-30.0, 80.0, 210.0] {
            let pose = pitched([x, y, z], pitch_deg);
            let flange_m = pose.world_from_tool(&model.flange_from_tool.tool_from_world(&Vector3::zeros()));
            assert!((flange_m - Vector3::new(x, y - 0.2, z)).norm() < 1e-15, "{flange_m}");
        }
    }
}

// --- any posture ---

fn joints() -> impl Strategy<Value = Joints> {
    let turn = 0.9 * TAU;
    [-turn..turn, -turn..turn, -turn..turn, -turn..turn, -turn..turn, -turn..turn]
        .prop_filter("near a singularity", |joints: &Joints| {
            SingularityMargins::of(ArmKind::Ur5e, joints).least().1 > 0.06
        })
}

proptest! {
    /// Position to 10^-14 m, rotation to 10^-14 rad, and the joints that it began with.
    #[test]
    fn joints_come_back_from_the_pose(joints in joints()) {
        let model = ArmModel { posture: Posture::of(ArmKind::Ur5e, &joints), ..ArmModel::bench() };
        let pose = model.world_from_tool(&joints);
        let found = model.joints_near(&joints, &pose).unwrap();
        prop_assert!(joints.iter().zip(found).all(|(a, b)| (a - b).abs() < 1e-12));
        let off = apart(&pose, &model.world_from_tool(&found));
        prop_assert!(off.iter().all(|off| *off < 1e-14), "{off:?}");
    }

    /// While the joints move slowly, what is found from the poses is the way that they went.
    #[test]
    fn the_arm_goes_the_way_of_the_joints(start in joints(), rate in [-1.0..1.0, -1.0..1.0, -1.0..1.0, -1.0..1.0, -1.0..1.0, -1.0..1.0f64]) {
        let model = ArmModel { posture: Posture::of(ArmKind::Ur5e, &start), ..ArmModel::bench() };
        let mut found = start;
        for tick in 1..=50 {
            let mut expected = start;
            for (angle, rate) in expected.iter_mut().zip(rate) {
                *angle += 0.01 * f64::from(tick) * rate;
            }
            match model.joints_after(&found, &model.world_from_tool(&expected), 0.01) {
                Ok(joints) => found = joints,
                Err(error) => {
                    let margin = SingularityMargins::of(ArmKind::Ur5e, &expected).least().1;
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
    let joints = ArmModel::bench().joints_near(&[0.0; 6], &pose).unwrap();
    // The upper arm leans forward from upright, the forearm comes down, wrist 1 levels it out.
    let [q1, q2, q3, q4, q5, q6] = joints;
    assert!(q1.abs() < 1e-12 && (q5 - FRAC_PI_2).abs() < 1e-12 && q6.abs() < 1e-12, "{joints:?}");
    assert!(q2 > -FRAC_PI_2 && q2 < 0.0 && q3 > FRAC_PI_2 && (q2 + q3 + q4).abs() < 1e-12, "{joints:?}");
}

// --- the family ---

/// Joint origins as the maker's ROS description has them (`ur_description`, `config/*/default_kinematics.yaml`): x, y, z in metres,
/// roll, pitch, yaw in radians, from the base to the flange.
fn published(kind: ArmKind) -> [[f64; 6]; 6] {
    let [shoulder, upper_arm, forearm, wrist_1, wrist_2] = match kind {
        ArmKind::Ur3e => [0.15185, -0.24355, -0.2132, 0.13105, -0.08535],
        ArmKind::Ur5e => [0.1625, -0.425, -0.3922, 0.1333, -0.0997],
        ArmKind::Ur10e => [0.1807, -0.6127, -0.57155, 0.17415, -0.11985],
        ArmKind::Ur16e => [0.1807, -0.4784, -0.36, 0.17415, -0.11985],
        ArmKind::Ur20 => [0.2363, -0.862, -0.7287, 0.201, -0.1593],
        ArmKind::Ur30 => [0.2363, -0.637, -0.5037, 0.201, -0.1593],
    };
    let wrist_3 = match kind {
        ArmKind::Ur3e => 0.0921,
        ArmKind::Ur5e => 0.0996,
        ArmKind::Ur10e | ArmKind::Ur16e => 0.11655,
        ArmKind::Ur20 | ArmKind::Ur30 => 0.1543,
    };
    [
        [0.0, 0.0, shoulder, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, FRAC_PI_2, 0.0, 0.0],
        [upper_arm, 0.0, 0.0, 0.0, 0.0, 0.0],
        [forearm, 0.0, wrist_1, 0.0, 0.0, 0.0],
        [0.0, wrist_2, 0.0, FRAC_PI_2, 0.0, 0.0],
        [0.0, wrist_3, 0.0, FRAC_PI_2, PI, PI],
    ]
}

/// The product of these origins, each followed by its joint's turn about z.
fn chain(kind: ArmKind, joints: &Joints) -> Isometry3<f64> {
    published(kind).iter().zip(joints).fold(
        Isometry3::identity(),
        |pose, ([x, y, z, roll, pitch, yaw], joint)| {
            let origin = Isometry3::from_parts(
                Translation3::new(*x, *y, *z),
                UnitQuaternion::from_euler_angles(*roll, *pitch, *yaw),
            );
            pose * origin * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), *joint)
        },
    )
}

/// Numbers from -1 to 1, always the same.
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> f64 {
        // Knuth's multiplier; the upper bits are the good ones.
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

#[test]
fn every_arm_comes_back_from_ten_thousand_poses_in_every_posture() {
    for kind in ArmKind::ALL {
        let (mut draws, mut poses, mut solutions, mut off, mut off_chain) =
            (Draws(7), 0, 0, [0.0f64; 2], 0.0f64);
        let model = |posture| ArmModel::new(kind, Pose::identity(), Pose::identity(), posture);
        while poses < 10_000 {
            let joints: Joints = std::array::from_fn(|_| PI * draws.next());
            let margin = SingularityMargins::of(kind, &joints).least().1;
            if margin < 0.06 {
                continue;
            }
            poses += 1;
            let own = Posture::of(kind, &joints);
            let pose = model(own).world_from_tool(&joints);
            let wanted = chain(kind, &joints);
            off_chain = off_chain.max((wanted.translation.vector - pose.position_m).norm());
            off_chain = off_chain.max(wanted.rotation.angle_to(&pose.orientation));
            for posture in Posture::PREFERRED {
                // Another posture may be out of reach, or nearer to a singularity than is allowed.
                let Ok(found) = model(posture).joints_near(&joints, &pose) else {
                    assert!(posture != own, "{kind:?} {joints:?}");
                    continue;
                };
                solutions += 1;
                assert_eq!(Posture::of(kind, &found), posture);
                let apart = apart(&pose, &model(posture).world_from_tool(&found));
                off = [off[0].max(apart[0]), off[1].max(apart[1])];
                let same = joints.iter().zip(found).all(|(a, b)| (a - b).abs() < 1e-11);
                assert_eq!(same, posture == own, "{kind:?} {joints:?} {found:?}");
            }
        }
        println!(
            "{}: {poses} poses, {solutions} ways to reach them, off by {:.1e} m and {:.1e} rad at most; from the maker's chain by {off_chain:.1e}",
            kind.label(),
            off[0],
            off[1]
        );
        assert!(off.iter().all(|off| *off < 1e-13) && solutions > 4 * poses, "{kind:?} {off:?} {solutions}");
        assert!(off_chain < 1e-13, "{kind:?} {off_chain}");
    }
}

#[test]
fn every_arm_is_about_as_long_as_its_maker_says() {
    for kind in ArmKind::ALL {
        let figures = kind.figures();
        let [longest_m, _] = figures.span_m();
        let ratio = (longest_m + figures.d5_m) / figures.reach_m;
        assert!((0.95..1.15).contains(&ratio), "{kind:?} {ratio}");
    }
}
