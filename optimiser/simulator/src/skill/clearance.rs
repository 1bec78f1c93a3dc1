//! Whether the tool stays clear of the containers, of the gates that are there, and of what all stands on, all along a motion, and
//! its body within the simulated volume.
//!
//! The simulation does not check this: there tool, containers, gates and floor are kinematic and pass through each other. A real
//! arm would collide. Beyond the volume nothing is simulated.

use super::{SkillMap, SkillParameter, Theta};
use crate::scene::{Gate, Obstacle, PlacedTool, Scene, ToolPart};
use powderline_shared::{displacement::Displacement, pose::Pose};
use thiserror::Error;

/// Values of each skill parameter that stand for its range.
const SAMPLES: usize = 3;

/// Looks in one control step, at most: velocity limits are far from that in any motion that is performed.
const MOST_LOOKS: f64 = 1000.0;

/// How far beyond the simulated volume the tool may be: more than the rounding of controls, less than shows, metres.
const BORDER_SLACK_M: f64 = 1e-4;

/// A place where the tool would be inside the material of a container, gate, stand or table, or its body beyond the simulated volume.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("the {part} would pass through {obstacle} at {at_s:.2} s")]
#[non_exhaustive]
pub struct Collision {
    /// What of the tool.
    pub part: ToolPart,
    /// What it would pass through.
    pub obstacle: Obstacle,
    /// When it begins, seconds from the start of the motion.
    pub at_s: f64,
}

/// The first collision of a motion that begins at `start`; none if the tool stays clear.
///
/// Between two samples no point of the tool moves as far, seen from any wall, as the thinnest wall or tool part is thick (no
/// tunnelling), whatever the control period. Where the tool comes to rest, as between two segments and at the end, there is always a sample.
pub fn collision(scene: &Scene, start: &Pose, controls: &[Displacement]) -> Option<Collision> {
    let solids = scene.solids();
    let period_s = scene.time.control_period_s();
    let meets = |tool: &PlacedTool<'_>, at_s: f64| {
        let leaves = || {
            tool.leaves(scene.domain.size_m, BORDER_SLACK_M).then_some((ToolPart::Body, &Obstacle::Border))
        };
        tool.inside_of(&solids, at_s).or_else(leaves)
    };
    first_by(scene, start, controls, |steps| steps * period_s, meets)
}

/// The same with all gates where they are so long after the motion's start, and of no matter how far the tool goes: a way home leads out of
/// the simulated volume.
pub(crate) fn standing_collision(
    scene: &Scene,
    start: &Pose,
    controls: &[Displacement],
    time_s: f64,
) -> Option<Collision> {
    let solids = scene.solids();
    first_by(scene, start, controls, |_| time_s, |tool, at_s| tool.inside_of(&solids, at_s))
}

/// `clock` says when, in seconds from the start of the motion, so many control steps are done; `meets` what a tool meets then.
fn first_by<'s>(
    scene: &Scene,
    start: &Pose,
    controls: &[Displacement],
    clock: impl Fn(f64) -> f64,
    meets: impl Fn(&PlacedTool<'_>, f64) -> Option<(ToolPart, &'s Obstacle)>,
) -> Option<Collision> {
    let stride_m = stride_m(scene);
    let inside = |pose: &Pose, at_s: f64| {
        let (part, obstacle) = meets(&PlacedTool::at(&scene.tool, pose), at_s)?;
        Some(Collision { part, obstacle: obstacle.clone(), at_s })
    };
    let (mut pose, mut unseen_m, mut last_m, mut slows) = (*start, 0.0, f64::INFINITY, false);
    for (step, control) in controls.iter().enumerate() {
        let at_s = |part: f64| clock(step as f64 + part);
        let travel_m = travel_m(scene, control) + gates_travel_m(&scene.gates, [at_s(0.0), at_s(1.0)]);
        // Where it was slowest it may have turned.
        let turns = std::mem::replace(&mut slows, travel_m <= last_m) && travel_m > last_m;
        last_m = travel_m;
        if turns && unseen_m > 0.0 {
            if let Some(collision) = inside(&pose, at_s(0.0)) {
                return Some(collision);
            }
            unseen_m = 0.0;
        }
        // A step that is long is looked at on the way, short ones at the end of a stride.
        let strides = (unseen_m + travel_m) / stride_m;
        let looks = if strides < 1.0 { 0.0 } else { strides.ceil().min(MOST_LOOKS) };
        for look in 1..=looks as u32 {
            let part = f64::from(look) / looks;
            let (seen, at_s) = (pose.displaced(&fraction(control, part)), at_s(part));
            if let Some(collision) = inside(&seen, at_s) {
                return Some(collision);
            }
        }
        unseen_m = if looks > 0.0 { 0.0 } else { unseen_m + travel_m };
        pose = pose.displaced(control);
    }
    let end_s = clock(controls.len() as f64);
    if unseen_m > 0.0 { inside(&pose, end_s) } else { None }
}

fn stride_m(scene: &Scene) -> f64 {
    let walls = scene.containers.iter().map(|container| container.wall_thickness_m);
    let gates = scene.gates.iter().map(|gate| gate.shape.least_thickness_m());
    let parts = [2.0 * scene.tool.handle.radius_m, scene.tool.wall_thickness_m];
    0.5 * walls.chain(gates).chain(parts).fold(f64::INFINITY, f64::min)
}

/// How far a displacement takes any point of the tool, at most, metres.
fn travel_m(scene: &Scene, control: &Displacement) -> f64 {
    length(control.translation_m) + length(control.rotation_rad) * scene.tool.bounding_radius_m()
}

/// How far the fastest gate moves from one time to another, metres.
fn gates_travel_m(gates: &[Gate], times_s: [f64; 2]) -> f64 {
    let travel_m = |gate: &Gate| {
        let [Some(from), Some(to)] = times_s.map(|time_s| gate.displacement_m(time_s)) else { return 0.0 };
        length([0, 1, 2].map(|axis| to[axis] - from[axis]))
    };
    gates.iter().map(travel_m).fold(0.0, f64::max)
}

fn length([x, y, z]: [f64; 3]) -> f64 {
    libm::sqrt(x * x + y * y + z * z)
}

fn fraction(control: &Displacement, part: f64) -> Displacement {
    Displacement {
        translation_m: control.translation_m.map(|x| part * x),
        rotation_rad: control.rotation_rad.map(|x| part * x),
    }
}

/// A skill within the scene's bounds whose tool would pass through something, if one is found among their ends and middles.
pub fn colliding_skill(scene: &Scene) -> Option<(Theta, Collision)> {
    let map = SkillMap::new(scene);
    Theta::lattice(SAMPLES)
        .find_map(|theta| collision_of(scene, &map, &theta).map(|collision| (theta, collision)))
}

/// Every skill takes the tool through a wall.
#[derive(Clone, Debug, PartialEq, Error)]
#[error(
    "each of {} skills across the ranges of [skill] takes the tool through something, and with the highest lift {collision}; a higher \
     skill.lift_height_m, a longer transport or lower walls would be right", SAMPLES.pow(5)
)]
pub struct Impassable {
    collision: Collision,
}

/// Checks that some skill within the scene's bounds stays clear of everything.
///
/// # Errors
/// None of their ends and middles does.
pub fn check_passable(scene: &Scene) -> Result<(), Impassable> {
    const HIGHEST: Theta = Theta::MIDDLE.moved(SkillParameter::LiftHeight, 1.0);
    let map = SkillMap::new(scene);
    match collision_of(scene, &map, &HIGHEST) {
        Some(collision)
            if Theta::lattice(SAMPLES).all(|theta| collision_of(scene, &map, &theta).is_some()) =>
        {
            Err(Impassable { collision })
        }
        _ => Ok(()),
    }
}

fn collision_of(scene: &Scene, map: &SkillMap, theta: &Theta) -> Option<Collision> {
    collision(scene, map.start_pose(), &map.quantise(theta).ok()?.controls)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{ContainerShape, GateOpening, GateShape};

    #[test]
    fn every_skill_of_the_shipped_scenes_stays_clear() {
        for name in ["bench", "bench-small", "bench-fine", "vial", "workcell"] {
            let scene = Scene::load(name).unwrap();
            assert_eq!(colliding_skill(&scene), None, "{name}");
        }
    }

    /// A handle that hangs down beyond the edge of the bench: on a table there is no room for it, beside a stand there is.
    #[test]
    fn a_handle_stays_above_what_the_bench_stands_on() {
        let mut scene = Scene::load("bench").unwrap();
        scene.tool.handle.rise_deg = -50.0;
        let inside = |scene: &Scene, z_m: f64| {
            let pose = Pose { position_m: [-0.010, 0.048, z_m].into(), ..Pose::identity() };
            let solids = scene.solids();
            let found = PlacedTool::at(&scene.tool, &pose).inside_of(&solids, 0.0);
            found.map(|(part, obstacle)| (part, obstacle.clone()))
        };
        assert_eq!(inside(&scene, 0.030), None);
        assert_eq!(inside(&scene, -0.060), Some((ToolPart::Body, Obstacle::Stand)));
        scene.arm = None;
        assert_eq!(inside(&scene, 0.030), Some((ToolPart::Handle, Obstacle::Table)));
        assert_eq!(inside(&scene, 0.060), None);
    }

    /// Down to where the body is less than half a stride deep in the floor, and back: neither the turn nor the end goes unseen.
    #[test]
    fn where_it_turns_and_where_it_ends_is_looked_at() {
        let scene = Scene::load("bench").unwrap();
        let stride_m = stride_m(&scene);
        let start = *SkillMap::new(&scene).start_pose();
        let down = |way_m: f64, steps: u32| {
            let place = move |step: u32| {
                way_m * crate::skill::minimum_jerk_position(f64::from(step) / f64::from(steps))
            };
            (0..steps).map(move |step| Displacement {
                translation_m: [0.0, 0.0, place(step) - place(step + 1)],
                ..Displacement::default()
            })
        };
        let touches = |way_m: f64| {
            let solids = scene.solids();
            let pose = start
                .displaced(&Displacement { translation_m: [0.0, 0.0, -way_m], ..Displacement::default() });
            PlacedTool::at(&scene.tool, &pose).inside_of(&solids, 0.0).is_some()
        };
        let mut touching_m = 0.0;
        while !touches(touching_m) {
            touching_m += 1e-5;
        }
        for share in [0.05, 0.3, 0.6, 0.95] {
            let way_m = touching_m + share * stride_m;
            let there: Vec<_> = down(way_m, 40).collect();
            let up = there
                .iter()
                .map(|step| Displacement { translation_m: step.translation_m.map(|x| -x), ..*step });
            let rest = [Displacement::default(); 2];
            let and_back: Vec<_> = there.iter().copied().chain(up.clone()).collect();
            let after_a_rest: Vec<_> = there.iter().copied().chain(rest).chain(up).collect();
            assert!(collision(&scene, &start, &after_a_rest).is_some(), "{share}");
            assert!(collision(&scene, &start, &there).is_some(), "{share}");
            assert!(collision(&scene, &start, &and_back).is_some(), "{share}");
            assert_eq!(collision(&scene, &start, &down(touching_m - 1e-4, 40).collect::<Vec<_>>()), None);
        }
    }

    #[test]
    fn a_wall_that_no_skill_clears_is_known_beforehand() {
        let mut scene = Scene::load("vial").unwrap();
        assert_eq!(check_passable(&scene), Ok(()));
        let target = scene.objective.target.clone();
        let vial = scene.containers.iter_mut().find(|container| container.name == target);
        if let ContainerShape::Cylinder { inner_height_m, .. } = &mut vial.unwrap().shape {
            *inner_height_m = 0.15;
        }
        let sentence = check_passable(&scene).unwrap_err().to_string();
        assert!(
            sentence.starts_with("each of 243 skills across the ranges of [skill]")
                && sentence.contains("would pass through container \"vial\""),
            "{sentence}"
        );
    }

    #[test]
    fn a_low_lift_takes_the_tool_through_the_source() {
        let mut scene = Scene::load("bench").unwrap();
        scene.skill.lift_height_m[0] = 0.020;
        let map = SkillMap::new(&scene);
        let skill = |lift: f64| Theta::new([1.0, -1.0, lift, 0.0, 0.0]).unwrap();
        let motion = |lift: f64| map.quantise(&skill(lift)).unwrap().controls;
        let found = collision(&scene, map.start_pose(), &motion(-1.0)).unwrap();
        assert_eq!((found.part, &found.obstacle), (ToolPart::Body, &Obstacle::Container("source".into())));
        assert!(
            found.to_string().starts_with("the tool's body would pass through container \"source\" at 0."),
            "{found}"
        );
        assert_eq!(collision(&scene, map.start_pose(), &motion(1.0)), None);
        assert!(colliding_skill(&scene).is_some());
    }

    #[test]
    fn no_wall_is_jumped_over_in_a_long_control_step() {
        let scene = Scene::load("bench").unwrap();
        let map = SkillMap::new(&scene);
        // Down beside the source's far wall, then through it to the middle of the target, in one step each.
        let step = |x: f64, z: f64| Displacement { translation_m: [x, 0.0, z], rotation_rad: [0.0; 3] };
        let found = collision(&scene, map.start_pose(), &[step(0.0, -0.03), step(0.13, 0.0)]).unwrap();
        assert_eq!((found.part, &found.obstacle), (ToolPart::Body, &Obstacle::Container("source".into())));
        assert!(found.at_s > 0.01 && found.at_s < 0.02, "{found}");
        // The way over the walls is free.
        assert_eq!(collision(&scene, map.start_pose(), &[step(0.0, 0.06), step(0.13, 0.0)]), None);
    }

    /// Within the workspace it may, were it not for what is simulated; a way home leads out of it all the same.
    #[test]
    fn the_body_stays_within_the_simulated_volume() {
        let scene = Scene::load("bench").unwrap();
        let start = *SkillMap::new(&scene).start_pose();
        let top_m = PlacedTool::at(&scene.tool, &start).body_support([0.0, 0.0, 1.0]);
        let up = |beyond_m: f64| {
            let way_m = scene.domain.size_m[2] - top_m + beyond_m;
            let step = Displacement { translation_m: [0.0, 0.0, way_m / 40.0], ..Displacement::default() };
            [step; 40]
        };
        assert_eq!(collision(&scene, &start, &up(0.0)), None);
        let found = collision(&scene, &start, &up(0.001)).unwrap();
        assert_eq!((found.part, &found.obstacle), (ToolPart::Body, &Obstacle::Border));
        assert!(
            found.to_string().contains("the border of the simulated volume (domain.size_m) at 0."),
            "{found}"
        );
        assert_eq!(standing_collision(&scene, &start, &up(0.001), 0.0), None);
    }

    /// A plate in the way from the source to the target.
    fn plate(opens_at_s: f64, opening: GateOpening) -> Gate {
        Gate {
            name: "plate".into(),
            position_m: [0.116, 0.048, 0.0],
            yaw_deg: 0.0,
            friction: 0.4,
            opens_at_s,
            shape: GateShape::Box { size_m: [0.004, 0.09, 0.2] },
            opening,
        }
    }

    #[test]
    fn a_gate_is_in_the_way_until_it_has_opened() {
        let mut scene = Scene::load("bench").unwrap();
        let map = SkillMap::new(&scene);
        let motion = map.quantise(&Theta::MIDDLE).unwrap().controls;
        let mut met = |opens_at_s: f64, opening: GateOpening| {
            scene.gates = vec![plate(opens_at_s, opening)];
            assert_eq!(scene.clone().into_spec().validate_as("scene").err(), None);
            collision(&scene, map.start_pose(), &motion)
        };
        let found = met(9.0, GateOpening::Vanish {}).unwrap();
        assert_eq!((found.part, &found.obstacle), (ToolPart::Body, &Obstacle::Gate("plate".into())));
        assert!(
            found.to_string().starts_with("the tool's body would pass through gate \"plate\" at 1."),
            "{found}"
        );
        // It comes there at that time, so that one which opens just before is no longer met, whichever way.
        assert_eq!(met(found.at_s - 0.02, GateOpening::Vanish {}), None);
        let mut down = |opens_at_s: f64| {
            met(opens_at_s, GateOpening::Slide { velocity_m_s: [0.0, 0.0, -0.5], travel_m: 0.2 })
        };
        assert_eq!(down(found.at_s - 0.4), None);
        assert!(down(found.at_s - 0.1).is_some());
        // Skills that the search may find are judged alike.
        scene.gates = vec![plate(9.0, GateOpening::Vanish {})];
        assert!(
            colliding_skill(&scene).is_some_and(|(_, found)| matches!(found.obstacle, Obstacle::Gate(_)))
        );
    }

    #[test]
    fn a_gate_that_slides_into_a_tool_at_rest_is_met() {
        let mut scene = Scene::load("bench").unwrap();
        let still = Displacement { translation_m: [0.0; 3], rotation_rad: [0.0; 3] };
        // Its face comes from 114 mm at 0.2 m/s; the handle reaches to 84.3 mm.
        scene.gates =
            vec![plate(0.1, GateOpening::Slide { velocity_m_s: [-0.2, 0.0, 0.0], travel_m: 0.029 })];
        let start = *SkillMap::new(&scene).start_pose();
        assert_eq!(collision(&scene, &start, &[still; 100]), None);
        scene.gates[0].opening = GateOpening::Slide { velocity_m_s: [-0.2, 0.0, 0.0], travel_m: 0.031 };
        let found = collision(&scene, &start, &[still; 100]).unwrap();
        assert!(found.part == ToolPart::Handle && (0.248..0.262).contains(&found.at_s), "{found}");
    }

    #[test]
    fn a_long_handle_dips_into_the_target_when_it_is_turned_over() {
        let mut scene = Scene::load("bench").unwrap();
        scene.tool.handle.length_m = 0.09;
        let map = SkillMap::new(&scene);
        let over = Theta::new([0.0, -1.0, -1.0, 0.0, 1.0]).unwrap();
        let motion = map.quantise(&over).unwrap().controls;
        let found = collision(&scene, map.start_pose(), &motion).unwrap();
        assert_eq!((found.part, &found.obstacle), (ToolPart::Handle, &Obstacle::Container("target".into())));
    }
}
