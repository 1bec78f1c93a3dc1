//! Whether the tool stays clear of the containers all along a motion.
//!
//! The simulation does not ask: tool and containers are given motions there, and pass through each other. An arm that is
//! told to do the same breaks something.

use super::{SkillMap, Theta};
use crate::scene::{PlacedTool, Scene, ToolPart};
use powderline_shared::{displacement::Displacement, pose::Pose};
use thiserror::Error;

/// Values of each skill parameter that stand for its range.
const SAMPLES: usize = 3;

/// Control steps from one look at a sampled skill to the next.
const STRIDE: usize = 4;

/// A place where the tool would be inside a container's material.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("the {part} would pass through container {container:?} at {at_s:.2} s")]
pub struct Collision {
    /// What of the tool.
    pub part: ToolPart,
    /// The container's name.
    pub container: String,
    /// When it begins, seconds from the start of the motion.
    pub at_s: f64,
}

/// The first collision of a motion that begins at `start`; none if the tool stays clear.
pub fn collision(scene: &Scene, start: &Pose, controls: &[Displacement]) -> Option<Collision> {
    first_of(scene, start, controls, 1)
}

fn first_of(scene: &Scene, start: &Pose, controls: &[Displacement], stride: usize) -> Option<Collision> {
    let solids = scene.solids();
    let poses = controls.iter().scan(*start, |pose, control| {
        *pose = pose.displaced(control);
        Some(*pose)
    });
    let looked_at = (1u32..).zip(poses).step_by(stride);
    looked_at.into_iter().find_map(|(step, pose)| {
        let (part, container) = PlacedTool::at(&scene.tool, &pose).inside_of(&solids)?;
        let at_s = f64::from(step) * scene.time.control_period_s();
        Some(Collision { part, container: container.into(), at_s })
    })
}

/// A skill within the scene's bounds whose tool would pass through a container, if one is found among their ends and
/// middles.
pub fn colliding_skill(scene: &Scene) -> Option<(Theta, Collision)> {
    let map = SkillMap::new(scene);
    let mut skills = (0..SAMPLES.pow(5))
        .map(|index| std::array::from_fn(|k| (index / SAMPLES.pow(k as u32) % SAMPLES) as f64 - 1.0));
    skills.find_map(|theta: Theta| {
        let motion = map.quantised(&theta).ok()?;
        first_of(scene, map.start_pose(), &motion.controls, STRIDE).map(|collision| (theta, collision))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_skill_of_the_shipped_scenes_stays_clear() {
        for name in ["bench", "bench-small", "bench-fine"] {
            let scene = Scene::load(name).unwrap();
            assert_eq!(colliding_skill(&scene), None, "{name}");
        }
    }

    #[test]
    fn a_low_lift_takes_the_tool_through_the_source() {
        let mut scene = Scene::load("bench").unwrap();
        scene.skill.lift_height_m[0] = 0.020;
        let map = SkillMap::new(&scene);
        let motion = |lift: f64| map.quantised(&[1.0, -1.0, lift, 0.0, 0.0]).unwrap().controls;
        let found = collision(&scene, map.start_pose(), &motion(-1.0)).unwrap();
        assert_eq!((found.part, found.container.as_str()), (ToolPart::Body, "source"));
        assert!(
            found.to_string().starts_with("the tool's body would pass through container \"source\" at 0."),
            "{found}"
        );
        assert_eq!(collision(&scene, map.start_pose(), &motion(1.0)), None);
        assert!(colliding_skill(&scene).is_some());
    }

    #[test]
    fn a_long_handle_dips_into_the_target_when_it_is_turned_over() {
        let mut scene = Scene::load("bench").unwrap();
        scene.tool.handle.length_m = 0.09;
        let map = SkillMap::new(&scene);
        let motion = map.quantised(&[0.0, -1.0, -1.0, 0.0, 1.0]).unwrap().controls;
        let found = collision(&scene, map.start_pose(), &motion).unwrap();
        assert_eq!((found.part, found.container.as_str()), (ToolPart::Handle, "target"));
    }
}
