//! Whether every skill within the bounds fits: workspace, domain, the source's floor and walls, the horizon.

use super::checker::{Checked, Checker};
use super::layout::{AXIS_NAMES, inside_domain};
use crate::scene::figures::{about, at_most, list, plain};
use crate::scene::path::{SegmentEnvelope, pitches};
use crate::scene::solid::{TOUCH_M, Vec3, Wall};
use crate::scene::{PlacedTool, Profile, Scene};

/// Everything about the motions that can be judged without making one.
pub(super) fn check(checker: &Checker<'_>, scene: &Scene) -> Checked {
    check_workspace_box(checker, scene)?;
    check_floor(checker, scene)?;
    check_scoop_walls(checker, scene)?;
    for stage in scene.stages() {
        check_workspace(checker, scene, &stage)?;
        check_domain(checker, scene, &stage)?;
    }
    check_speed(checker, scene)?;
    check_horizon(checker, scene)
}

fn check_workspace_box(checker: &Checker<'_>, scene: &Scene) -> Checked {
    let (low, high) = (scene.limits.workspace_min_m, scene.limits.workspace_max_m);
    if (0..3).all(|axis| low[axis] < high[axis]) {
        return Ok(());
    }
    Err(checker.invalid(
        "limits.workspace_max_m",
        list(&high),
        format!("it must exceed limits.workspace_min_m = {} in every component", list(&low)),
    ))
}

fn check_workspace(checker: &Checker<'_>, scene: &Scene, stage: &SegmentEnvelope) -> Checked {
    for origin in &stage.origins {
        for (axis, coordinate) in origin.iter().enumerate() {
            let (low, high) = (scene.limits.workspace_min_m[axis], scene.limits.workspace_max_m[axis]);
            if !(low - TOUCH_M..=high + TOUCH_M).contains(coordinate) {
                return Err(checker.invalid(
                    stage.field,
                    list(&stage.value),
                    format!(
                        "the tool's origin would then be at {} = {}, outside the limits' workspace, which goes \
                         from {} to {}",
                        AXIS_NAMES[axis],
                        about(*coordinate, 4),
                        plain(low),
                        plain(high)
                    ),
                ));
            }
        }
    }
    Ok(())
}

/// The body only: what the handle meets outside the domain is none of the simulation's business.
fn check_domain(checker: &Checker<'_>, scene: &Scene, stage: &SegmentEnvelope) -> Checked {
    for origin in &stage.origins {
        for pitch_deg in pitches(stage.pitch_deg) {
            let tool = PlacedTool::new(scene, *origin, pitch_deg);
            inside_domain(checker, scene, stage.field, &stage.value, "the tool", |direction| {
                tool.body_support(direction)
            })?;
        }
    }
    Ok(())
}

/// The deepest scoop stays above the source's floor.
fn check_floor(checker: &Checker<'_>, scene: &Scene) -> Checked {
    let (tool, skill) = (&scene.tool, &scene.skill);
    let start = tool.start_position_m;
    let scoop_pitch = [tool.start_pitch_deg - skill.scooping_angle_deg[1], tool.start_pitch_deg];
    let lowest_m = pitches(scoop_pitch)
        .map(|pitch_deg| -PlacedTool::new(scene, start, pitch_deg).body_support([0.0, 0.0, -1.0]))
        .fold(f64::INFINITY, f64::min);
    let (floor_m, floor) = scene.source().floor();
    let room_m = lowest_m - skill.approach_m - floor_m;
    if skill.scooping_depth_m[1] <= room_m + TOUCH_M {
        return Ok(());
    }
    let below_m = skill.scooping_depth_m[1] - room_m;
    let right = match room_m >= skill.scooping_depth_m[0] {
        true => format!("at most {} would be right", at_most(room_m)),
        false => format!(
            "a tool.start_position_m that is {} m higher, or a skill.approach_m that is so much shorter, would be right",
            about(below_m, 3)
        ),
    };
    Err(checker.invalid(
        "skill.scooping_depth_m",
        list(&skill.scooping_depth_m),
        format!(
            "at the deepest scoop the tool would go {} m below the {floor} of container {:?}; {right}",
            about(below_m, 3),
            scene.source().name,
        ),
    ))
}

/// Going down and scooping keep clear of the source's walls at every depth and angle.
fn check_scoop_walls(checker: &Checker<'_>, scene: &Scene) -> Checked {
    let walls = scene.source().walls();
    if let Some((wall, depth_m)) = deepest(scene, &walls, scene.insert_poses()) {
        return Err(checker.invalid(
            "tool.start_position_m",
            list(&scene.tool.start_position_m),
            format!(
                "on its way down from there the tool would go {} m into the {}; a start further inside would be right",
                about(depth_m, 2),
                wall.name
            ),
        ));
    }
    if let Some((wall, depth_m)) = deepest(scene, &walls, scene.scoop_poses()) {
        let right = if wall.is_ahead(scene.heading()) {
            "a shorter sweep or a start further back would be right"
        } else {
            "a start so much further from that wall would be right"
        };
        return Err(checker.invalid(
            "skill.sweep_m",
            plain(scene.skill.sweep_m),
            format!(
                "while scooping along skill.heading_deg = {} the tool would go {} m into the {}; {right}",
                plain(scene.skill.heading_deg),
                about(depth_m, 2),
                wall.name
            ),
        ));
    }
    Ok(())
}

/// The wall that the tool's body goes deepest into at any of these poses (origin, pitch in degrees), and how deep, metres;
/// none if it stays clear of them all.
fn deepest<'w>(
    scene: &Scene,
    walls: &'w [Wall],
    poses: impl Iterator<Item = (Vec3, f64)>,
) -> Option<(&'w Wall, f64)> {
    let hits = poses.flat_map(|(origin, pitch_deg)| {
        let tool = PlacedTool::new(scene, origin, pitch_deg);
        walls
            .iter()
            .filter_map(move |wall| Some((wall, wall.depth_m(|direction| tool.body_support(direction))?)))
    });
    hits.max_by(|(_, a), (_, b)| a.total_cmp(b))
}

/// Minimum-jerk segments are stretched until the limits hold; constant-speed ones are not.
fn check_speed(checker: &Checker<'_>, scene: &Scene) -> Checked {
    let (skill, limits) = (&scene.skill, &scene.limits);
    if skill.profile == Profile::ConstantSpeed && skill.overlap > 0.0 {
        return Err(checker.invalid(
            "skill.overlap",
            plain(skill.overlap),
            "with profile = \"constant_speed\" both speeds would add up; 0, or profile = \"minimum_jerk\", would be right",
        ));
    }
    let too_fast = |field: &str, speed: f64, limit_field: &str, limit: f64| {
        if skill.profile == Profile::MinimumJerk || speed <= limit {
            return Ok(());
        }
        Err(checker.invalid(
            field,
            plain(speed),
            format!("{limit_field} = {} allows no more with profile = \"constant_speed\"", plain(limit)),
        ))
    };
    too_fast(
        "skill.linear_speed_m_s",
        skill.linear_speed_m_s,
        "limits.linear_velocity_m_s",
        limits.linear_velocity_m_s,
    )?;
    too_fast(
        "skill.angular_speed_rad_s",
        skill.angular_speed_rad_s,
        "limits.angular_velocity_rad_s",
        limits.angular_velocity_rad_s,
    )
}

fn check_horizon(checker: &Checker<'_>, scene: &Scene) -> Checked {
    let longest_s = scene.longest_skill_s();
    let horizon_s = scene.time.horizon_s();
    let slack_s = 1e-6 * scene.time.control_period_s();
    if longest_s <= horizon_s + slack_s {
        return Ok(());
    }
    let steps = (longest_s / scene.time.control_period_s()).ceil();
    Err(checker.invalid(
        "time.horizon_steps",
        scene.time.horizon_steps,
        format!(
            "that is {} s and the longest skill within the bounds takes {} s; at least {} would be right",
            about(horizon_s, 4),
            about(longest_s, 4),
            about(steps, 12)
        ),
    ))
}
