use std::f64::consts::PI;

use nalgebra::Vector3;
use powderline_shared::arm::inverse::Posture;
use powderline_shared::arm::links::{self, Link};
use powderline_shared::arm::{ArmError, ArmKind, Joints};
use powderline_shared::displacement::{Displacement, Lsb, Quantiser};
use powderline_shared::limits::{Limit, Limits};
use powderline_shared::plan::{PlanHeader, PlanWriter, Precision, Prediction, StartPose, Version};
use powderline_shared::pose::{Pose, exp_so3, norm};
use serde_json::Value;

use super::*;
use crate::Sink as _;
use crate::picture::sample;
use powderline_simulator::arm::{Around, Mount, Refusal, Surroundings, Transit, cycles_us};

const PERIOD_US: u32 = 10_000;
const CYCLE_US: u32 = 2_000;

fn limits() -> Limits {
    Limits {
        workspace_min_m: [-2.0; 3],
        workspace_max_m: [2.0; 3],
        linear_velocity_m_s: 1.0,
        linear_acceleration_m_s2: 10.0,
        linear_jerk_m_s3: 1_000.0,
        angular_velocity_rad_s: 10.0,
        angular_acceleration_rad_s2: 100.0,
        angular_jerk_rad_s3: 10_000.0,
    }
}

fn minimum_jerk(s: f64) -> f64 {
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

/// The bytes of a plan that moves and turns with minimum jerk, from a place in front of the arm at the origin.
fn plan(ticks: u32, way_m: [f64; 3], turn_rad: [f64; 3], limits: Limits) -> Vec<u8> {
    plan_along(minimum_jerk, ticks, way_m, turn_rad, limits)
}

/// The same, of which a share has been done after a share of the time.
fn plan_along(
    done: fn(f64) -> f64,
    ticks: u32,
    way_m: [f64; 3],
    turn_rad: [f64; 3],
    limits: Limits,
) -> Vec<u8> {
    let header = PlanHeader {
        scene_digest: [0xab; 32],
        optimiser_version: Version { major: 1, minor: 2, patch: 3 },
        seed: 1,
        precision: Precision::F32,
        theta: [0.0; 5],
        skill_parameters: [0.0; 5],
        path_coefficients: 0,
        control_period_us: PERIOD_US,
        step_count: ticks,
        lsb: Lsb::default(),
        start: StartPose { position_m: [-0.45, -0.1, 0.3], orientation_wxyz: [0.5, 0.5, -0.5, 0.5] },
        limits,
        predicted: Prediction::default(),
        finer: None,
        arm: None,
    };
    let at = |tick: u32| done(f64::from(tick) / f64::from(ticks));
    let mut bytes = Vec::new();
    let sink = |part: &[u8]| {
        bytes.extend_from_slice(part);
        Ok::<(), std::convert::Infallible>(())
    };
    let mut writer = PlanWriter::new(sink, &header).expect("a header");
    let mut quantiser = Quantiser::new(header.lsb);
    for tick in 1..=ticks {
        let part = at(tick) - at(tick - 1);
        let step = Displacement {
            translation_m: way_m.map(|way| part * way),
            rotation_rad: turn_rad.map(|turn| part * turn),
        };
        let (_, counts) = quantiser.push(&step).expect("a step");
        writer.step(counts).expect("room");
    }
    writer.finish().expect("a plan");
    bytes
}

fn motion_of(bytes: &[u8]) -> Motion {
    Motion::new(&PlanReader::new(bytes).expect("a plan")).expect("a motion within its limits")
}

/// 1 s, 0.14 m, 0.6 rad.
fn motion() -> Motion {
    motion_of(&plan(100, [0.1, 0.05, -0.08], [0.3, 0.5, -0.1], limits()))
}

fn mount() -> Mount {
    let flange_from_tool = Pose {
        position_m: Vector3::new(0.01, 0.02, 0.1),
        orientation: exp_so3(&Vector3::new(0.3, 0.2, 0.1)),
    };
    Mount {
        kind: ArmKind::Ur5e,
        world_from_base: Pose::identity(),
        flange_from_tool,
        posture: None,
        near: None,
        clearance_m: None,
    }
}

/// The arm's motion with a table far below.
fn arm_motion(motion: &Motion, mount: &Mount, cycle_us: u32) -> Result<ArmMotion, Refusal> {
    ArmMotion::new(&motion.path, mount, &Surroundings::table(-1.0), cycle_us)
}

fn shifted(x_m: f64) -> Mount {
    let world_from_base = Pose { position_m: Vector3::new(x_m, 0.0, 0.0), ..Pose::identity() };
    Mount { world_from_base, ..mount() }
}

fn with_arm() -> Motion {
    let mut motion = motion();
    motion.arm = Some(arm_motion(&motion, &mount(), CYCLE_US).expect("an arm that can"));
    motion
}

fn refused(motion: &Motion, mount: &Mount, cycle_us: u32) -> Refusal {
    arm_motion(motion, mount, cycle_us).map(drop).expect_err("a motion that no arm can make")
}

fn arm_of(motion: &Motion) -> &ArmMotion {
    motion.arm.as_ref().expect("an arm")
}

// --- the tool ---

#[test]
fn velocities_are_the_derivatives_of_the_poses_and_both_ends_rest() {
    let motion = motion();
    assert_eq!((motion.path.last_tick(), motion.path.duration_s(), motion.path.time_s(7)), (100, 1.0, 0.07));
    assert_eq!((motion.velocities[0], motion.velocities[100]), ([0.0; 6], [0.0; 6]));
    for tick in 1..100 {
        let over = motion.path.poses[tick - 1].displacement_to(&motion.path.poses[tick + 1]).components();
        for (found, over) in motion.velocities[tick].iter().zip(over) {
            assert!((found - over / 0.02).abs() < 2e-3, "tick {tick}: {found} for {}", over / 0.02);
        }
    }
    // The peak of minimum jerk is 15/8 of the mean.
    let fastest = motion.velocities[50];
    assert!(
        (fastest[0] - 0.1 * 1.875).abs() < 1e-4 && (fastest[4] - 0.5 * 1.875).abs() < 1e-3,
        "{fastest:?}"
    );
}

#[test]
fn a_plan_that_breaks_its_own_limits_is_no_motion() {
    let slow = Limits { linear_velocity_m_s: 0.1, ..limits() };
    let bytes = plan(100, [0.1, 0.0, 0.0], [0.0; 3], slow);
    let violation = Motion::new(&PlanReader::new(&bytes).expect("a plan")).expect_err("too fast");
    assert_eq!(violation.limit, Limit::LinearVelocity);
}

// --- the arm ---

#[test]
fn the_joints_put_the_tool_where_the_plan_has_it() {
    let motion = with_arm();
    let arm = arm_of(&motion);
    assert_eq!(arm.joints.len(), 101);
    assert_eq!(arm.model.posture, Posture::PREFERRED[0]);
    for (joints, pose) in arm.joints.iter().zip(&motion.path.poses) {
        let off = pose.displacement_to(&arm.model.world_from_tool(joints));
        assert!(norm(&off.translation()) < 1e-13 && norm(&off.rotation()) < 1e-13, "{off:?}");
    }
    // Between ticks the tool is on the plan's own way, but for what a spline in joints is another than one in space.
    for (tick, pair) in motion.path.poses.windows(2).enumerate() {
        let joints = arm.joints_at(&motion.path, motion.path.time_us(tick) + 5_000);
        let middle = (pair[0].position_m + pair[1].position_m) / 2.0;
        let off_m = norm(&(arm.model.world_from_tool(&joints).position_m - middle));
        assert!(off_m < 1e-4, "tick {tick}: {off_m}");
    }
    assert_eq!(arm.joints_at(&motion.path, 99_000_000), arm.joints[100]);
    // The Jacobian takes the speeds of the joints to the tool's.
    let speeds = arm.model.jacobian(&arm.joints[40]) * nalgebra::Vector6::from(arm.speeds[40]);
    for (found, expected) in speeds.iter().zip(motion.velocities[40]) {
        assert!((found - expected).abs() < 1e-4, "{speeds} for {expected}");
    }
}

#[test]
fn figures_are_the_worst_of_the_whole_way() {
    let motion = with_arm();
    let figures = &arm_of(&motion).figures;
    let speeds = || arm_of(&motion).speeds.iter().flatten().map(|speed| speed.abs());
    let fastest = speeds().fold(0.0, f64::max);
    assert!((figures.speed_rad_s - fastest).abs() < 1e-3, "{figures:?} for {fastest}");
    assert!(figures.margin > 0.05 && figures.margin < 1.0, "{figures:?}");
    // 15/8 of 0.137 m in 1 s, of 1 m/s.
    assert!((figures.limit_use.linear_velocity - 0.2578).abs() < 1e-3, "{figures:?}");
}

#[test]
fn cycles_go_on_until_the_motion_is_over() {
    let motion = motion();
    assert_eq!(cycles_us(&motion.path, 2_000).count(), 500);
    assert_eq!(cycles_us(&motion.path, 2_000).last(), Some(1_000_000));
    assert_eq!(cycles_us(&motion.path, 64_000).last(), Some(1_024_000));
}

#[test]
fn an_arm_too_far_away_is_refused_with_how_much_nearer_it_must_be() {
    let motion = motion();
    let refusal = refused(&motion, &shifted(1.2), CYCLE_US);
    let Refusal::Arm {
        time_s,
        error: ArmError::Unreachable { joint: 3, distance_m, bound_m },
        all_postures: true,
    } = refusal
    else {
        panic!("{refusal}")
    };
    assert!(time_s == 0.0 && distance_m > bound_m, "{refusal}");
    let nearer = format!("put the base at least {:.0} mm nearer", 1e3 * (distance_m - bound_m) + 1.0);
    assert!(refusal.to_string().ends_with(&nearer), "{refusal}");
    assert!(refusal.to_string().starts_with("at 0.000 s the wrist would be 1."), "{refusal}");
}

#[test]
fn an_arm_that_loses_reach_on_the_way_is_refused_with_the_time() {
    let motion = motion_of(&plan(3_000, [-0.7, 0.0, 0.0], [0.0; 3], limits()));
    let refusal = refused(&motion, &mount(), CYCLE_US);
    assert!(matches!(refusal, Refusal::Arm { time_s, .. } if (5.0..25.0).contains(&time_s)), "{refusal}");
    assert!(refusal.to_string().ends_with("put the base at least 1 mm nearer"), "{refusal}");
}

#[test]
fn joints_that_would_be_too_fast_are_refused() {
    let motion = motion_of(&plan(60, [0.0; 3], [0.0, 2.0, 0.0], limits()));
    let refusal = refused(&motion, &mount(), CYCLE_US);
    let Refusal::Arm { error: ArmError::JointSpeed { speed_rad_s, bound_rad_s, .. }, .. } = refusal else {
        panic!("{refusal}")
    };
    assert!(speed_rad_s > PI && bound_rad_s == PI, "{refusal}");
    assert!(refusal.to_string().contains("rad/s, and turns at 3.1416 rad/s at the most"), "{refusal}");
}

/// Turning about the flange's axis is wrist 3 alone.
fn on_axis() -> (Mount, Vector3<f64>) {
    let axis = motion().path.poses[0].orientation * Vector3::z();
    (Mount { flange_from_tool: Pose::identity(), ..mount() }, axis)
}

/// Wrist 3 where such a motion begins, in the second of its turns.
fn far_turned() -> (Mount, f64) {
    let (mount, axis) = on_axis();
    let motion = motion_of(&plan(400, [0.0; 3], axis.into(), limits()));
    let mut near = arm_motion(&motion, &mount, CYCLE_US).expect("a turn").joints[0];
    near[5] += 2.0 * PI;
    (Mount { near: Some(near), ..mount }, near[5])
}

#[test]
fn joints_beyond_their_range_are_refused() {
    let (mount, begin_rad) = far_turned();
    let turned = |turn_rad: f64| plan(400, [0.0; 3], (on_axis().1 * turn_rad).into(), limits());
    let left_rad = 2.0 * PI - begin_rad;
    arm_motion(&motion_of(&turned(left_rad - 1e-3)), &mount, CYCLE_US).expect("within its range");
    let refusal = refused(&motion_of(&turned(left_rad + 0.2)), &mount, CYCLE_US);
    let is_limit = |error| matches!(error, ArmError::JointLimit { joint: 6, .. });
    assert!(
        matches!(refusal, Refusal::Arm { error, all_postures: false, .. } if is_limit(error)),
        "{refusal}"
    );
}

#[test]
fn joints_beyond_their_range_between_ticks_are_refused() {
    // There and back, with the furthest point amid two ticks, which lie 3 / 201^2 of the way before it.
    let bump = |s: f64| 64.0 * (s * (1.0 - s)).powi(3);
    let (mount, begin_rad) = far_turned();
    let turn_rad = 2.0 * PI - begin_rad + 6e-5;
    let motion = motion_of(&plan_along(bump, 201, [0.0; 3], (on_axis().1 * turn_rad).into(), limits()));
    let refusal = refused(&motion, &mount, CYCLE_US);
    let is_limit = |error| matches!(error, ArmError::JointLimit { joint: 6, .. });
    assert!(
        matches!(refusal, Refusal::Arm { time_s, error, .. } if is_limit(error) && (time_s - 1.005).abs() < 0.004),
        "{refusal}"
    );
    arm_motion(&motion, &mount, PERIOD_US).expect("within its range at every tick");
}

#[test]
fn joints_too_fast_between_ticks_are_refused() {
    // Fastest amid two ticks, by 1.0002 of what the way over that tick comes to.
    let (mount, axis) = on_axis();
    let turn_rad = 1.0001 * PI * 0.41 / 1.875;
    let motion = motion_of(&plan(41, [0.0; 3], (axis * turn_rad).into(), limits()));
    let refusal = refused(&motion, &mount, CYCLE_US);
    assert!(
        matches!(refusal, Refusal::Arm { error: ArmError::JointSpeed { joint: 6, .. }, .. }),
        "{refusal}"
    );
    arm_motion(&motion, &mount, PERIOD_US).expect("slow enough from tick to tick");
}

#[test]
fn a_pose_beyond_the_workspace_by_its_rounding_is_within() {
    let tight = Limits { workspace_max_m: [-0.45 - 4e-8, 2.0, 2.0], ..limits() };
    let motion = motion_of(&plan(100, [0.0, 0.1, 0.0], [0.0; 3], tight));
    arm_motion(&motion, &mount(), CYCLE_US).expect("what the plan's own check takes");
}

#[test]
fn what_could_help_near_a_singularity_depends_on_which_it_is() {
    for (joint, remedy) in [(1, "farther away"), (3, "nearer"), (5, "turn the tool in the flange")] {
        let error = ArmError::Singular { joint, margin: 0.01, bound: 0.05 };
        let text = Refusal::Arm { time_s: 1.0, error, all_postures: false }.to_string();
        assert!(
            text.starts_with(&format!("at 1.000 s joint {joint} would come to a margin of 0.0100")),
            "{text}"
        );
        assert!(text.contains(remedy) && !text.contains("no other posture"), "{text}");
    }
}

#[test]
fn links_stay_above_the_table() {
    let motion = motion();
    let make = |height_m, clearance_m, near| {
        let mount = Mount { clearance_m, near, ..mount() };
        ArmMotion::new(&motion.path, &mount, &Surroundings::table(height_m), CYCLE_US)
    };
    let (kept_m, kept) = (0.02, Some(0.02));
    let free = make(0.0, None, None).expect("an arm that can");
    let nearest = free.figures.nearest();
    // As high as its own joints put it; the upper arm but for the quarter at the shoulder.
    let heights = free.joints.iter().flat_map(|joints| {
        let mut axes = links::axes(ArmKind::Ur5e, joints);
        axes[0][0] = axes[0][0].lerp(&axes[0][1], 0.25);
        axes.into_iter()
            .zip(Link::ALL)
            .map(|(ends, link)| ends[0].z.min(ends[1].z) - link.radius_m(ArmKind::Ur5e))
    });
    let lowest_m = heights.fold(f64::INFINITY, f64::min);
    assert!((lowest_m - nearest.distance_m).abs() < 1e-4, "{lowest_m} {nearest:?}");
    // This posture lets the table be so high and no higher, to what distances are right to.
    let (near, highest_m) = (Some(free.joints[0]), nearest.distance_m - kept_m);
    make(highest_m - 2e-4, kept, near).expect("just enough room");
    let refusal = make(highest_m + 2e-4, kept, near).map(drop).expect_err("just too little");
    assert!(matches!(refusal, Refusal::TooNear { all_postures: false, .. }), "{refusal}");
    // Of all postures the one with most room is taken where that decides.
    let table_m = highest_m + kept_m - 1e-3;
    let room_m = make(table_m, None, None).map_or(0.0, |arm| arm.figures.nearest().distance_m);
    assert!(room_m >= 1e-3 - 2e-4, "{room_m}");
    let refusal = make(2.0, kept, None).map(drop).expect_err("no posture is above that");
    assert!(matches!(refusal, Refusal::TooNear { all_postures: true, .. }), "{refusal}");
    let sentence = refusal.to_string();
    assert!(sentence.contains("mm deep in the table, and 20.0 mm is the least that is kept"), "{sentence}");
}

#[test]
fn near_decides_the_posture() {
    let motion = motion();
    let start = motion.path.poses[0];
    let mut begun = 0;
    for posture in Posture::PREFERRED {
        let model = powderline_shared::arm::ArmModel::new(
            ArmKind::Ur5e,
            mount().world_from_base,
            mount().flange_from_tool,
            posture,
        );
        let Ok(joints) = model.joints_near(&[0.0; 6], &start) else { continue };
        let near = Some(joints.map(|joint| joint + 0.01));
        if let Ok(found) = arm_motion(&motion, &Mount { near, ..mount() }, CYCLE_US) {
            assert_eq!(found.model.posture, posture);
            assert!(found.joints[0].iter().zip(joints).all(|(a, b)| (a - b).abs() < 1e-12));
            begun += 1;
        }
    }
    assert!(begun >= 4, "{begun}");
}

#[test]
fn what_breaks_a_limit_between_ticks_only_is_refused_for_cycles_shorter_than_ticks() {
    // The jerk of minimum jerk begins at once, with 60 times the way over the cube of the time.
    let tight = Limits { linear_jerk_m_s3: 0.9 * 60.0 * 0.1 / 0.064, ..limits() };
    let motion = motion_of(&plan(40, [0.1, 0.0, 0.0], [0.0; 3], tight));
    let refusal = refused(&motion, &mount(), CYCLE_US);
    let Refusal::Between { time_s, violation } = refusal else { panic!("{refusal}") };
    assert!(violation.limit == Limit::LinearJerk && time_s < 0.05, "{refusal}");
    assert!(refusal.to_string().contains("m/s^3, but the plan's limit is 84.375 m/s^3"), "{refusal}");
    arm_motion(&motion, &mount(), PERIOD_US).expect("what the plan's own check looks at");
}

// --- tables ---

fn text(write: impl FnOnce(&mut dyn std::io::Write) -> std::io::Result<()>) -> String {
    let mut bytes = Vec::new();
    write(&mut bytes).expect("memory takes everything");
    String::from_utf8(bytes).expect("text")
}

#[test]
fn a_table_has_a_row_for_each_tick_and_numbers_that_read_back() {
    let (plain, motion) = (self::motion(), with_arm());
    let csv = text(|out| table::write_csv(out, &plain));
    assert_eq!(
        csv.lines().next(),
        Some("time_s,x_m,y_m,z_m,qw,qx,qy,qz,vx_m_s,vy_m_s,vz_m_s,wx_rad_s,wy_rad_s,wz_rad_s")
    );
    let csv = text(|out| table::write_csv(out, &motion));
    let names: Vec<&str> = csv.lines().next().expect("names").split(',').collect();
    assert_eq!(
        (csv.lines().count(), names.len(), names[14], names[25]),
        (102, 26, "joint1_rad", "joint6_rad_s")
    );
    for (tick, line) in csv.lines().skip(1).enumerate() {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().expect("a number")).collect();
        let pose = &motion.path.poses[tick];
        assert_eq!(cells[0], motion.path.time_s(tick));
        assert_eq!([cells[1], cells[2], cells[3]], <[f64; 3]>::from(pose.position_m));
        assert_eq!([cells[4], cells[5]], [pose.orientation.w, pose.orientation.i]);
        assert_eq!(cells[8..14], motion.velocities[tick]);
        assert_eq!(cells[14..20], arm_of(&motion).joints[tick]);
        assert_eq!(cells[20..26], arm_of(&motion).speeds[tick]);
    }
}

#[test]
fn the_object_holds_the_table_and_what_it_is_of() {
    let motion = with_arm();
    let object: Value = serde_json::from_str(&text(|out| table::write_json(out, &motion))).expect("JSON");
    assert_eq!(object["plan_hash"], format!("{:016x}", motion.plan_hash));
    assert_eq!(object["scene_digest"], "ab".repeat(32));
    assert_eq!((&object["optimiser_version"], &object["period_s"]), (&"1.2.3".into(), &0.01.into()));
    assert_eq!(object["arm"]["elbow_up"], true);
    let column = |name: &str| object["motion"][name].as_array().expect(name).clone();
    assert_eq!((column("time_s").len(), object["motion"].as_object().expect("columns").len()), (101, 26));
    assert_eq!(column("joint4_rad")[33], arm_of(&motion).joints[33][3]);
    let object: Value =
        serde_json::from_str(&text(|out| table::write_json(out, &self::motion()))).expect("JSON");
    assert!(object["arm"].is_null() && object["motion"]["joint1_rad"].is_null());
}

// --- programs ---

/// The program of the motion, as it is or with something else.
fn program(cycle_us: u32, speed: f64, home: Option<Joints>, payload_kg: Option<f64>) -> String {
    let motion = with_arm();
    let arm = arm_of(&motion);
    let (mount, surroundings) = (&mount(), &Surroundings::table(-1.0));
    let around = Around { mount, surroundings, scene: None, home, cycle_us };
    let transit = Transit::new(&motion.path, arm, &around).expect("a way");
    let (motion, transit, knows_scene) = (&motion, &transit, payload_kg.is_some());
    let program = urscript::Program { motion, arm, transit, cycle_us, speed, payload_kg, knows_scene };
    text(|out| program.write(out))
}

#[test]
fn a_program_has_a_line_for_each_tick_and_no_exponents() {
    let motion = with_arm();
    let arm = arm_of(&motion);
    let whole = program(CYCLE_US, 1.0, None, None);
    let (_, rest) = whole.split_once("Powderline: plays the motion").expect("a motion");
    let (motion_alone, _) = rest.split_once("Powderline: back to").expect("a way back");
    let ticks: Vec<&str> =
        motion_alone.lines().filter(|line| line.starts_with("  powderline_tick(")).collect();
    assert_eq!(ticks.len(), 100);
    for (line, (joints, speeds)) in ticks.iter().zip(arm.joints.iter().zip(&arm.speeds).skip(1)) {
        let inner = line.trim_start_matches("  powderline_tick([").trim_end_matches("])");
        let numbers: Vec<f64> =
            inner.replace("], [", ", ").split(", ").map(|n| n.parse().expect(n)).collect();
        let expected = joints.iter().chain(speeds);
        assert!(numbers.iter().zip(expected).all(|(a, b)| (a - b).abs() <= 1e-12), "{line}");
    }
    for line in whole.lines().filter(|line| !line.trim_start().starts_with('#')) {
        assert!(line.is_ascii(), "{line}");
        let digit =
            |letter: Option<char>| letter.is_some_and(|letter| letter.is_ascii_digit() || letter == '-');
        // A plan's hash in a message may well look like one.
        for code in line.split('"').step_by(2) {
            let exponent =
                |at: usize| digit(code[..at].chars().last()) && digit(code[at + 1..].chars().next());
            assert!(!code.match_indices('e').any(|(at, _)| exponent(at)), "{line}");
        }
    }
    assert!(whole.contains("t=0.002, lookahead_time=0.03, gain=2000)"), "{whole}");
    let slower = program(8_000, 1.0, None, None);
    assert!(slower.contains("global powderline_us = 8000.0") && slower.contains("t=0.008,"), "{slower}");
}

#[test]
fn a_program_says_its_arm_its_speed_and_its_payload() {
    let home = [0.0, -1.6, 0.0, -1.6, 0.0, 0.0];
    let slow = program(CYCLE_US, 0.07, Some(home), Some(0.4));
    for part in [
        "for a UR5e; PolyScope 5.9 or later",
        "if the arm is not like a UR5e (its flange is 20 mm or more from where it should be), or farther than 0.1 rad",
        "is no UR5e",
        "# At 7 % of full speed, on the same path",
        "powderline_us = powderline_us + 140.0\n",
        "  set_payload(0.4, [",
        "0.0, -91.7, 0.0, -91.7, 0.0, 0.0 degrees. Bring it there first",
        "movej(begin, a=0.021, v=0.014)",
    ] {
        assert!(slow.contains(part), "{part}: {slow:.3000}");
    }
    assert_eq!(slow.matches("movej(").count(), 3);
    let full = program(CYCLE_US, 1.0, None, None);
    assert!(
        !full.contains("of full speed")
            && !full.contains("set_payload")
            && full.contains("# NOT LOOKED AT: what tool and arm may run into")
            && !slow.contains("NOT LOOKED AT")
            && full.matches("movej(").count() == 1
    );
    // Of the way only how fast it is gone differs.
    let ticks = |text: &str| text.matches("  powderline_tick(").count();
    assert_eq!(ticks(&full), ticks(&slow));
}

// --- messages ---

#[test]
fn a_message_is_little_endian_cdr() {
    let pose = Pose { position_m: Vector3::new(1.0, 2.0, 3.0), ..Pose::identity() };
    let header = ros::Header::new(1_500_000, "world");
    let bytes = ros::encoded(&ros::PoseStamped { header, pose: (&pose).into() }).expect("bytes");
    let mut expected = vec![0, 1, 0, 0];
    expected.extend(1i32.to_le_bytes());
    expected.extend(500_000_000u32.to_le_bytes());
    expected.extend(6u32.to_le_bytes());
    // Six bytes up to where doubles may lie, counted from behind the encoding.
    expected.extend(b"world\0\0\0\0\0\0\0");
    [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0f64].iter().for_each(|value| expected.extend(value.to_le_bytes()));
    assert_eq!(bytes, expected);
}

/// Topics and how many messages each has, and when the last of them is, nanoseconds.
fn topics(bytes: &[u8]) -> std::collections::BTreeMap<String, (usize, u64)> {
    let mut topics = std::collections::BTreeMap::new();
    for message in ::mcap::MessageStream::new(bytes).expect("a file") {
        let message = message.expect("a message");
        assert_eq!(message.channel.message_encoding, "cdr");
        let (count, last) = topics.entry(message.channel.topic.clone()).or_insert((0, 0));
        assert_eq!(message.sequence as usize, *count);
        (*count, *last) = (*count + 1, message.log_time);
    }
    topics
}

#[test]
fn messages_are_there_for_each_tick() {
    let write = |motion: &Motion| {
        let mut bytes = Vec::new();
        mcap::write(&mut bytes, motion).expect("memory takes everything");
        bytes
    };
    let found = topics(&write(&with_arm()));
    let end = 1_000_000_000;
    let expected = [
        ("/joint_states", (101, end)),
        ("/joint_trajectory", (1, 0)),
        ("/tf", (101, end)),
        ("/tool_pose", (101, end)),
    ];
    assert_eq!(found, expected.map(|(topic, what)| (topic.to_owned(), what)).into());
    assert_eq!(topics(&write(&motion())).len(), 2);
    assert_eq!(write(&with_arm()), write(&with_arm()));
}

#[test]
fn powder_comes_beside_the_motion() {
    let mut bytes = Vec::new();
    let mut recording = mcap::Recording::new(&mut bytes, &motion(), "powder.mcap").expect("a file");
    for index in 0..3 {
        recording.frame(&sample::frame(index, &sample::positions(index))).expect("a frame");
    }
    recording.finish(&[]).expect("an end");
    drop(recording);
    let found = topics(&bytes);
    let last_ns = (1e9 * sample::frame(2, &[]).time_s) as u64;
    assert_eq!((found["/powder"], found["/tf"].0), ((3, last_ns), 101));
}

#[test]
fn a_full_disk_is_said_with_the_file() {
    struct Full;
    impl std::io::Write for Full {
        fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
            Err(std::io::ErrorKind::StorageFull.into())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    assert!(
        table::write_csv(&mut Full, &motion()).is_err() && table::write_json(&mut Full, &motion()).is_err()
    );
    let error = mcap::Recording::new(Full, &motion(), "full.mcap").err().expect("no room");
    assert!(error.to_string().starts_with("full.mcap cannot be written"), "{error}");
}
