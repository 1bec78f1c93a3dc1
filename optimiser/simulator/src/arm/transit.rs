//! The ways to a motion's start and back from its end, which a program for a real arm makes around the motion: from above the
//! start straight down to it; from the end straight up, and level back to above the start, with the tool turned back above target or source.
//!
//! Each leg is a straight line with the tool turning about one axis, from rest to rest in minimum jerk as the skill's own
//! segments ([`crate::skill`]), at half of the motion's limits. Before the motion gates are shut, after it they are where they are at
//! its end: none may still be sliding then.

use nalgebra::Vector3;
use powderline_shared::arm::{ArmModel, Joints};
use powderline_shared::displacement::Displacement;
use powderline_shared::pose::{Pose, norm};
use thiserror::Error;

use super::motion::{ArmMotion, Clearance, Mount, Refusal, line_clearance};
use super::path::ToolPath;
use super::self_collision::{Part, contact};
use super::surroundings::Surroundings;
use crate::scene::{Obstacle, PlacedTool, Scene, ToolPart, TurnBack};
use crate::skill::{Collision, minimum_jerk_position, rest_to_rest_steps, standing_collision};

/// Share of the motion's limits.
const SHARE: f64 = 0.5;

/// When all gates are shut, seconds from the motion's start: one may open with it.
pub(super) const BEFORE_S: f64 = -1.0;

/// From one height that is tried to the next, metres.
const RISE_M: f64 = 0.005;

/// How much higher than just clear the tool goes, metres.
const MARGIN_M: f64 = 0.010;

/// A way back may end so far from where the way there begins, radians.
const SAME_RAD: f64 = 1e-4;

/// From joints to joints in a straight line of them no point moves farther from look to look, metres.
const LOOK_M: f64 = 0.002;

/// What a motion lies between.
#[derive(Clone, Copy, Debug)]
pub struct Around<'a> {
    /// How the arm stands and holds the tool.
    pub mount: &'a Mount,
    /// What is around the arm.
    pub surroundings: &'a Surroundings,
    /// What the tool may run into, and above what it is turned back. Without, nobody looks, and the tool goes as high as the motion
    /// itself does.
    pub scene: Option<&'a Scene>,
    /// Joints at which the arm is before and after, radians.
    pub home: Option<Joints>,
    /// From setpoint to setpoint, microseconds.
    pub cycle_us: u32,
}

/// The ways to a motion's start and back.
#[derive(Clone, Debug)]
pub struct Transit {
    /// Height of the tool's origin in the world where it goes across, metres.
    pub height_m: f64,
    /// From above the start down to it.
    pub approach: ArmMotion,
    /// From the end back to above the start.
    pub retreat: ArmMotion,
    /// Above what the tool is turned back.
    pub turn_back: TurnBack,
    /// Joints before and after, if they are others than those above the start, radians.
    pub home: Option<Joints>,
    /// What a link comes nearest to on all these ways; when, is no time of the motion's.
    pub nearest: Clearance,
}

/// Why there is no way.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum TransitError {
    /// The tool would run into something at every height.
    #[error(
        "from no height up to the workspace's top, {:.0} mm, is there a way to the start and back: the {part} would pass through \
         {obstacle}; a higher limits.workspace_max_m[2] or lower walls would be right", 1e3 * top_m
    )]
    InTheWay {
        /// What of the tool.
        part: ToolPart,
        /// What it would pass through.
        obstacle: Obstacle,
        /// Top of the workspace, metres.
        top_m: f64,
    },
    /// Nobody knows where a gate is on the way back.
    #[error(
        "{gate} is still sliding when the motion ends; one that opens earlier, slides faster or less far, or a longer rest at the end, \
         would be right"
    )]
    GateSlides {
        /// Which.
        gate: Obstacle,
    },
    /// The arm cannot.
    #[error("on the way {way} {refusal}")]
    Arm {
        /// To the start or back.
        way: &'static str,
        /// Why not.
        refusal: Refusal,
    },
    /// The way back ends with a joint turned otherwise than the way there begins.
    #[error(
        "on the way back joint {joint} would end {off_rad:.2} rad from where it began; less turning in the skill would be right"
    )]
    Wound {
        /// Which, from 1.
        joint: usize,
        /// How far, radians.
        off_rad: f64,
    },
    /// A joint does not go so far.
    #[error("joint {joint} of --home is {:.1} degrees, and turns {:.1} to either side at the most", angle_rad.to_degrees(), bound_rad.to_degrees())]
    HomeRange {
        /// Which, from 1.
        joint: usize,
        /// What it would be, radians.
        angle_rad: f64,
        /// The end of its range, radians.
        bound_rad: f64,
    },
    /// Something is between home and start.
    #[error(
        "on the straight way of all joints from --home to above the start {part} would {how}, after {share:.0} % of it; another \
         --home would be right"
    )]
    HomeBlocked {
        /// Of the arm, or of the tool.
        part: Part,
        /// Such as "be 3.0 mm from the table".
        how: String,
        /// Of the way, percent.
        share: f64,
    },
}

impl Transit {
    /// The ways around the motion that an arm makes of a path.
    ///
    /// # Errors
    /// There is no way that stays clear and that the arm can make.
    pub fn new(path: &ToolPath, arm: &ArmMotion, around: &Around<'_>) -> Result<Self, TransitError> {
        let turn_back =
            around.scene.and_then(|scene| scene.arm.as_ref()?.turn_back_above).unwrap_or_default();
        let end_s = path.duration_s();
        let gates = around.scene.map_or(&[][..], |scene| &scene.gates);
        if let Some(gate) = gates.iter().find(|gate| gate.is_sliding(end_s)) {
            return Err(TransitError::GateSlides { gate: Obstacle::Gate(gate.name.clone()) });
        }
        let height_m = height_m(path, around.scene, turn_back)?;
        let [up, back] = ways(path, height_m, turn_back);
        let made = |way: &Way, joints: &Joints, time_s: f64, named| {
            let mount = Mount { posture: Some(arm.model.posture), near: Some(*joints), ..*around.mount };
            let surroundings = around.surroundings.standing(time_s);
            ArmMotion::new(&way.path(path), &mount, &surroundings, around.cycle_us)
                .map_err(|refusal| TransitError::Arm { way: named, refusal })
        };
        let approach = made(&up, &arm.joints[0], BEFORE_S, "to the start")?.reversed();
        let retreat = made(&back, &arm.joints[path.last_tick()], end_s, "back")?;
        let (first, last) = (approach.joints[0], retreat.joints[retreat.joints.len() - 1]);
        for (joint, (from, to)) in (1..).zip(first.iter().zip(last)) {
            if (to - from).abs() > SAME_RAD {
                return Err(TransitError::Wound { joint, off_rad: (to - from).abs() });
            }
        }
        let mut found = vec![approach.figures.nearest().clone(), retreat.figures.nearest().clone()];
        if let Some(home) = &around.home {
            check_range(&arm.model, home)?;
            for time_s in [BEFORE_S, end_s] {
                found.push(home_clearance(&arm.model, [home, &first], around, time_s)?);
            }
        }
        let nearest = found.into_iter().min_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
        let nearest = nearest.expect("two ways");
        Ok(Self { height_m, approach, retreat, turn_back, home: around.home, nearest })
    }

    /// Joints before and after, radians.
    #[must_use]
    pub fn begin(&self) -> &Joints {
        self.home.as_ref().unwrap_or(&self.approach.joints[0])
    }
}

/// Poses at its ticks, the first included.
struct Way {
    poses: Vec<Pose>,
}

impl Way {
    fn path(&self, path: &ToolPath) -> ToolPath {
        ToolPath { poses: self.poses.clone(), ..*path }
    }

    /// Goes on from rest to rest.
    fn then(mut self, leg: &Displacement, path: &ToolPath) -> Self {
        let from = self.poses[self.poses.len() - 1];
        let (way_m, turn_rad) = (norm(&leg.translation()), norm(&leg.rotation()));
        let ticks = rest_to_rest_steps(way_m, turn_rad, &path.limits, SHARE, path.period_s());
        self.poses.extend((1..=ticks).map(|tick| {
            let share = minimum_jerk_position(tick as f64 / ticks as f64);
            from.displaced(&Displacement {
                translation_m: leg.translation_m.map(|way| share * way),
                rotation_rad: leg.rotation_rad.map(|turn| share * turn),
            })
        }));
        self
    }

    fn controls(&self) -> Vec<Displacement> {
        self.poses.windows(2).map(|pair| pair[0].displacement_to(&pair[1])).collect()
    }
}

/// The way up from the start, and the way from the end to above the start.
fn ways(path: &ToolPath, height_m: f64, turn_back: TurnBack) -> [Way; 2] {
    let (start, end) = (path.poses[0], path.poses[path.last_tick()]);
    let up = |pose: &Pose| Displacement {
        translation_m: [0.0, 0.0, (height_m - pose.position_m.z).max(0.0)],
        ..Displacement::default()
    };
    let across: Vector3<f64> = start.position_m - end.position_m;
    let across = Displacement { translation_m: [across.x, across.y, 0.0], ..Displacement::default() };
    let turn = Displacement { rotation_rad: turned_back(path), ..Displacement::default() };
    let legs = match turn_back {
        TurnBack::Target => [turn, across],
        TurnBack::Source => [across, turn],
    };
    let from = |pose: Pose| Way { poses: vec![pose] }.then(&up(&pose), path);
    [from(start), legs.iter().fold(from(end), |way, leg| way.then(leg, path))]
}

/// The turn from the end's orientation to the start's. A skill turns the tool about one axis: back by all that it has turned, not
/// on by what is left to a whole turn, which would wind up the wrist.
fn turned_back(path: &ToolPath) -> [f64; 3] {
    let (start, end) = (path.poses[0], path.poses[path.last_tick()]);
    let turns = path.poses.windows(2).map(|pair| pair[0].displacement_to(&pair[1]).rotation());
    let back: [f64; 3] = (-turns.sum::<Vector3<f64>>()).into();
    let there = end.displaced(&Displacement { rotation_rad: back, ..Displacement::default() });
    let off = norm(&there.displacement_to(&start).rotation());
    if off < SAME_RAD { back } else { end.displacement_to(&start).rotation_rad }
}

/// What the tool would run into on either way.
fn in_the_way(path: &ToolPath, scene: &Scene, turn_back: TurnBack, height_m: f64) -> Option<Collision> {
    let [up, back] = ways(path, height_m, turn_back);
    let hit = |way: &Way, time_s| standing_collision(scene, &way.poses[0], &way.controls(), time_s);
    hit(&up, BEFORE_S).or_else(|| hit(&back, path.duration_s()))
}

/// The lowest height at which both ways are clear, and a margin.
fn height_m(path: &ToolPath, scene: Option<&Scene>, turn_back: TurnBack) -> Result<f64, TransitError> {
    let heights = path.poses.iter().map(|pose| pose.position_m.z);
    let Some(scene) = scene else { return Ok(heights.fold(f64::NEG_INFINITY, f64::max)) };
    let lowest_m = path.poses[0].position_m.z.max(path.poses[path.last_tick()].position_m.z);
    let top_m = path.limits.workspace_max_m[2];
    let in_the_way = |height_m| in_the_way(path, scene, turn_back, height_m);
    let mut height_m = lowest_m;
    while let Some(collision) = in_the_way(height_m) {
        height_m += RISE_M;
        if height_m > top_m {
            let (part, obstacle) = (collision.part, collision.obstacle);
            return Err(TransitError::InTheWay { part, obstacle, top_m });
        }
    }
    let higher_m = (height_m + MARGIN_M).min(top_m).max(height_m);
    Ok(if in_the_way(higher_m).is_none() { higher_m } else { height_m })
}

fn check_range(model: &ArmModel, home: &Joints) -> Result<(), TransitError> {
    for (joint, (angle_rad, bound_rad)) in (1..).zip(home.iter().zip(model.joint_range_rad)) {
        if angle_rad.abs() > bound_rad {
            return Err(TransitError::HomeRange { joint, angle_rad: *angle_rad, bound_rad });
        }
    }
    Ok(())
}

/// What a link comes nearest to between two joints' positions in a straight line, which is the way of UR's `movej`.
fn home_clearance(
    model: &ArmModel,
    ends: [&Joints; 2],
    around: &Around<'_>,
    time_s: f64,
) -> Result<Clearance, TransitError> {
    let surroundings = around.surroundings.standing(time_s);
    let turned: f64 = ends[0].iter().zip(ends[1]).map(|(from, to)| (to - from).abs()).sum();
    let arm_m = model.kind.figures().reach_m + norm(&model.flange_from_tool.position_m);
    let reach_m = arm_m + around.scene.map_or(0.0, |scene| scene.tool.bounding_radius_m());
    let looks = (turned * reach_m / LOOK_M).ceil().max(1.0) as u32;
    let blocked =
        |part: Part, how: String, share: f64| TransitError::HomeBlocked { part, how, share: 100.0 * share };
    let solids = around.scene.map(Scene::solids).unwrap_or_default();
    let mut nearest: Option<Clearance> = None;
    for look in 0..=looks {
        let share = f64::from(look) / f64::from(looks);
        let joints: Joints = std::array::from_fn(|k| ends[0][k] + share * (ends[1][k] - ends[0][k]));
        if let Some(met) = contact(model, &joints, surroundings.tool()) {
            return Err(blocked(met.part, met.to_string(), share));
        }
        let clearance = line_clearance(model, &joints, &surroundings, time_s);
        if around.mount.clearance_m.is_some_and(|least_m| clearance.distance_m < least_m) {
            return Err(blocked(Part::Link(clearance.link), clearance.to_string(), share));
        }
        if let Some(scene) = around.scene {
            let pose = model.world_from_tool(&joints);
            if let Some((part, obstacle)) = PlacedTool::at(&scene.tool, &pose).inside_of(&solids, time_s) {
                return Err(blocked(Part::Tool(part), format!("pass through {obstacle}"), share));
            }
        }
        if nearest.as_ref().is_none_or(|least| clearance.distance_m < least.distance_m) {
            nearest = Some(clearance);
        }
    }
    Ok(nearest.expect("two looks at least"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::CYCLE_US;
    use crate::scene::{Gate, GateOpening, GateShape};
    use crate::skill::{SkillMap, Theta};
    use powderline_shared::arm::links::axes;

    struct Case {
        scene: Scene,
        path: ToolPath,
        mount: Mount,
        surroundings: Surroundings,
    }

    impl Case {
        fn new(name: &str, change: impl Fn(&mut Scene)) -> Self {
            let mut scene = Scene::load(name).unwrap();
            change(&mut scene);
            let (map, arm) = (SkillMap::new(&scene), scene.arm.clone().unwrap());
            let path = ToolPath::of_skill(&map, &map.quantise(&Theta::MIDDLE).unwrap());
            let surroundings = Surroundings::of_scene(&scene, arm.table_height_m);
            Self { mount: Mount::of(&arm), scene, path, surroundings }
        }

        fn transit(&self, home: Option<Joints>) -> Result<Transit, TransitError> {
            let Self { scene, path, mount, surroundings } = self;
            let arm = ArmMotion::new(path, mount, surroundings, CYCLE_US).unwrap();
            let around = Around { mount, surroundings, scene: Some(scene), home, cycle_us: CYCLE_US };
            Transit::new(path, &arm, &around)
        }
    }

    /// Where the tool is along one of the ways.
    fn poses(way: &ArmMotion) -> Vec<Pose> {
        way.joints.iter().map(|joints| way.model.world_from_tool(joints)).collect()
    }

    #[test]
    fn the_tool_comes_straight_down_and_goes_straight_up_and_back() {
        for name in ["bench", "bench-small", "vial", "workcell"] {
            let case = Case::new(name, |_| ());
            let transit = case.transit(None).unwrap();
            let (start, end) = (case.path.poses[0], case.path.poses[case.path.last_tick()]);
            let down = poses(&transit.approach);
            for pose in &down {
                let off = pose.displacement_to(&start);
                assert!(off.translation_m[0].hypot(off.translation_m[1]) < 1e-9, "{name} {off:?}");
                assert!(norm(&off.rotation()) < 1e-9, "{name} {off:?}");
            }
            assert!((down[0].position_m.z - transit.height_m).abs() < 1e-9);
            assert!(down.windows(2).all(|pair| pair[1].position_m.z < pair[0].position_m.z + 1e-12));
            let back = poses(&transit.retreat);
            assert!(norm(&back[0].displacement_to(&end).translation()) < 1e-9);
            let (first, last) = (down[0], back[back.len() - 1]);
            let off = last.displacement_to(&first);
            assert!(off.components().iter().all(|off| off.abs() < 1e-9), "{name} {off:?}");
            // Nothing is in the way, also not 5 mm lower, which is half of the margin.
            let lower_m = transit.height_m - 0.5 * MARGIN_M;
            assert_eq!(in_the_way(&case.path, &case.scene, TurnBack::Target, lower_m), None, "{name}");
        }
    }

    #[test]
    fn the_tool_is_turned_back_where_the_scene_says() {
        // Of the places at which it turns, the mean along the way from source to target.
        let turns_at = |turn_back| {
            let case = Case::new("bench", |scene| {
                scene.arm.as_mut().unwrap().turn_back_above = turn_back;
            });
            let back = poses(&case.transit(None).unwrap().retreat);
            let turning: Vec<f64> = back
                .windows(2)
                .filter(|pair| norm(&pair[0].displacement_to(&pair[1]).rotation()) > 1e-4)
                .map(|pair| pair[0].position_m.x)
                .collect();
            turning.iter().sum::<f64>() / turning.len() as f64
        };
        let [usual, target, source] = [None, Some(TurnBack::Target), Some(TurnBack::Source)].map(turns_at);
        let case = Case::new("bench", |_| ());
        assert_eq!(usual.to_bits(), target.to_bits());
        assert!((target - case.path.poses[case.path.last_tick()].position_m.x).abs() < 1e-6, "{target}");
        assert!((source - case.path.poses[0].position_m.x).abs() < 1e-6, "{source}");
    }

    /// A turn by more than half a turn goes back the way it came, and so the wrist is not wound up.
    #[test]
    fn a_long_turn_is_undone() {
        let Case { mut path, .. } = Case::new("bench", |_| ());
        let start = path.poses[0];
        let turned = |angle: f64| {
            start.displaced(&Displacement { rotation_rad: [0.0, angle, 0.0], ..Displacement::default() })
        };
        path.poses = (0..=400).map(|tick| turned(0.01 * f64::from(tick))).collect();
        let back = turned_back(&path);
        assert!((back[1] + 4.0).abs() < 1e-9 && back[0].hypot(back[2]) < 1e-9, "{back:?}");
    }

    #[test]
    fn ways_keep_half_of_the_limits() {
        let case = Case::new("bench", |_| ());
        let transit = case.transit(None).unwrap();
        for way in [&transit.approach, &transit.retreat] {
            let used = way.figures.limit_use;
            let most = [
                used.linear_velocity,
                used.linear_acceleration,
                used.linear_jerk,
                used.angular_velocity,
                used.angular_acceleration,
                used.angular_jerk,
            ];
            assert!(most.iter().all(|share| *share < 1.01 * SHARE), "{used:?}");
            assert!(most.iter().any(|share| *share > 0.9 * SHARE), "{used:?}");
        }
    }

    #[test]
    fn what_stands_in_the_way_is_named() {
        // From within the source to within the target, in a workspace that ends there.
        let Case { scene, mut path, .. } = Case::new("bench", |_| ());
        let deep = |pose: &Pose, x_m: f64| {
            let translation_m = [x_m, 0.0, -0.02];
            pose.displaced(&Displacement { translation_m, ..Displacement::default() })
        };
        path.poses = vec![deep(&path.poses[0], 0.0), deep(&path.poses[0], 0.13)];
        height_m(&path, Some(&scene), TurnBack::Target).expect("a way over the walls");
        path.limits.workspace_max_m[2] = path.poses[0].position_m.z + 1e-3;
        let error = height_m(&path, Some(&scene), TurnBack::Target).unwrap_err();
        let sentence = error.to_string();
        assert!(
            sentence.starts_with("from no height up to the workspace's top, ")
                && sentence.contains("would pass through container \""),
            "{sentence}"
        );
    }

    /// Gates are where they are at the motion's start on the way to it, and where they are at its end on the way back.
    #[test]
    fn a_gate_is_in_the_way_before_it_opens_and_not_after() {
        let height = |position_m, size_m, opens_at_s| {
            let case = Case::new("bench", |scene| {
                scene.gates = vec![Gate {
                    name: "plate".into(),
                    position_m,
                    yaw_deg: 0.0,
                    friction: 0.4,
                    opens_at_s,
                    shape: GateShape::Box { size_m },
                    opening: GateOpening::Vanish {},
                }];
            });
            height_m(&case.path, Some(&case.scene), TurnBack::Target).map_err(|error| error.to_string())
        };
        let free_m = Case::new("bench", |_| ()).transit(None).unwrap().height_m;
        // Between source and target, up to the workspace's top.
        let between = |opens_at_s| height([0.116, 0.048, 0.0], [0.004, 0.09, 0.25], opens_at_s);
        assert_eq!(between(1.0), Ok(free_m));
        assert!(between(1e4).is_err_and(|error| error.contains("gate \"plate\"")));
        // Above the start alone, where the way back ends as well: what is there before counts, also if it opens with the motion.
        let above = |opens_at_s| height([0.0455, 0.048, 0.092], [0.03, 0.03, 0.004], opens_at_s);
        for opens_at_s in [0.0, 1.0] {
            assert!(above(opens_at_s).is_err_and(|error| error.contains("gate \"plate\"")), "{opens_at_s}");
        }
    }

    /// A gate that slides to where the wrist goes on the way back is in its way, also if it was far off before; one that slides yet is
    /// refused.
    #[test]
    fn links_keep_from_a_gate_where_it_is_when_they_go_by() {
        let free = Case::new("bench", |_| ()).transit(None).unwrap();
        let model = &free.retreat.model;
        // Of the arm above the start that is farthest from the arm at the motion's end.
        let places = |joints: &Joints| {
            let along = |[from, to]: [Vector3<f64>; 2]| {
                (0..=10).map(move |k| from + (to - from) * (0.1 * f64::from(k)))
            };
            axes(model.kind, joints).into_iter().flat_map(along).collect::<Vec<_>>()
        };
        let [above, end] = [free.retreat.joints.len() - 1, 0].map(|at| places(&free.retreat.joints[at]));
        let off = |place: &Vector3<f64>| {
            end.iter().map(|other| (place - other).norm()).fold(f64::INFINITY, f64::min)
        };
        let farthest = above.iter().copied().max_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
        assert!(off(&farthest) > 0.09, "{}", off(&farthest));
        let wrist = model.world_from_base.then(&Pose { position_m: farthest, ..Pose::identity() }).position_m;
        let sliding = |opens_at_s: f64, velocity_m_s: f64| {
            let case = Case::new("bench", |scene| {
                scene.arm.as_mut().unwrap().clearance_m = 0.005;
                scene.gates = vec![Gate {
                    name: "plate".into(),
                    position_m: [wrist.x, wrist.y, wrist.z + 0.5],
                    yaw_deg: 0.0,
                    friction: 0.4,
                    opens_at_s,
                    shape: GateShape::Box { size_m: [0.004, 0.004, 0.004] },
                    opening: GateOpening::Slide { velocity_m_s: [0.0, 0.0, -velocity_m_s], travel_m: 0.5 },
                }];
            });
            case.transit(None).map(|found| found.nearest.distance_m).map_err(|error| error.to_string())
        };
        // It opens after the motion, and so never; at its end; and too late to be there by then.
        assert_eq!(sliding(9.0, 1.0), Ok(free.nearest.distance_m));
        let error = sliding(4.2, 1.0).unwrap_err();
        assert!(error.starts_with("on the way back ") && error.contains("gate \"plate\""), "{error}");
        let error = sliding(4.8, 1.0).unwrap_err();
        assert!(error.starts_with("gate \"plate\" is still sliding when the motion ends; "), "{error}");
    }

    #[test]
    fn a_home_is_in_range_and_has_a_free_way() {
        let case = Case::new("bench", |_| ());
        let above = case.transit(None).unwrap();
        let home = above.approach.joints[0].map(|joint| joint - 0.2);
        let transit = case.transit(Some(home)).unwrap();
        assert_eq!((transit.begin(), above.begin()), (&home, &above.approach.joints[0]));
        assert!(transit.nearest.distance_m <= above.nearest.distance_m);
        let error = case.transit(Some([0.0, 7.0, 0.0, 0.0, 0.0, 0.0])).unwrap_err();
        assert!(matches!(error, TransitError::HomeRange { joint: 2, .. }), "{error}");
        // The shoulder turned so far down that arm and tool go into the bench.
        let mut low = above.approach.joints[0];
        low[1] += 0.5;
        let error = case.transit(Some(low)).unwrap_err();
        assert!(matches!(error, TransitError::HomeBlocked { .. }), "{error}");
        // The elbow folded up.
        let mut folded = above.approach.joints[0];
        folded[2] = 3.1;
        let sentence = case.transit(Some(folded)).unwrap_err().to_string();
        assert!(
            sentence.contains("to above the start its forearm would pass through its base or shoulder, "),
            "{sentence}"
        );
        // With nothing kept from anything it is the tool that is in the way.
        let loose = Case { mount: Mount { clearance_m: None, ..case.mount }, ..case };
        let sentence = loose.transit(Some(low)).unwrap_err().to_string();
        assert!(sentence.contains("to above the start the tool's "), "{sentence}");
    }
}
