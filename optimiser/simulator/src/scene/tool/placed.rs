//! The tool at a given pose, and what it stands in there.
//!
//! The body stands for its convex hull: the cavity counts as solid, which only matters for things inside it. World
//! axes of the tool at heading h and pitch p: x = cos p h - sin p z, y = z x h, z = sin p h + cos p z.

use super::Tool;
use crate::scene::Scene;
use crate::scene::solid::{Hull, Obstacle, Solid, Vec3, dot, extent_of};
use nalgebra::Vector3;
use powderline_shared::pose::Pose;
use std::fmt;

/// A part of the tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToolPart {
    /// Bowl or scoop.
    Body,
    /// Handle.
    Handle,
}

impl fmt::Display for ToolPart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Body => "tool's body",
            Self::Handle => "tool's handle",
        })
    }
}

/// The tool somewhere in the world.
pub(crate) struct PlacedTool<'a> {
    tool: &'a Tool,
    origin: Vec3,
    /// The tool's x, y, z in the world frame.
    axes: [Vec3; 3],
}

impl<'a> PlacedTool<'a> {
    pub(in crate::scene) fn new(scene: &'a Scene, origin: Vec3, pitch_deg: f64) -> Self {
        let (sin_h, cos_h) = libm::sincos(scene.skill.heading_deg.to_radians());
        let (sin_p, cos_p) = libm::sincos(pitch_deg.to_radians());
        let axes = [
            [cos_p * cos_h, cos_p * sin_h, -sin_p],
            [-sin_h, cos_h, 0.0],
            [sin_p * cos_h, sin_p * sin_h, cos_p],
        ];
        Self { tool: &scene.tool, origin, axes }
    }

    pub(crate) fn at(tool: &'a Tool, pose: &Pose) -> Self {
        let axis = |axis: Vec3| (pose.orientation * Vector3::from(axis)).into();
        let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(axis);
        Self { tool, origin: pose.position_m.into(), axes }
    }

    /// The first of the solids that a part of the tool is inside of so long after the motion's start.
    pub(crate) fn inside_of<'s>(
        &self,
        solids: &'s [Solid<'_>],
        time_s: f64,
    ) -> Option<(ToolPart, &'s Obstacle)> {
        solids.iter().find_map(|solid| {
            let moved = solid.displacement_m(time_s)?;
            // Seen from a solid that moves, it is the tool that does.
            let seen = Self { origin: [0, 1, 2].map(|axis| self.origin[axis] - moved[axis]), ..*self };
            Some((seen.part_inside(solid)?, &solid.obstacle))
        })
    }

    fn part_inside(&self, solid: &Solid<'_>) -> Option<ToolPart> {
        let [low, high] = solid.extent;
        let reach = self.tool.bounding_radius_m();
        if !(0..3).all(|k| self.origin[k] + reach > low[k] && self.origin[k] - reach < high[k]) {
            return None;
        }
        let within = |clears: &dyn Fn(&Hull) -> bool| !solid.pieces.iter().all(clears);
        let body = within(&|piece| self.body_clears(piece)).then_some(ToolPart::Body);
        body.or_else(|| within(&|piece| self.handle_clears(piece)).then_some(ToolPart::Handle))
    }

    /// Whether the body reaches beyond the simulated volume, whose corners are 0 and `size_m`, by more than `slack_m`, metres.
    pub(crate) fn leaves(&self, size_m: Vec3, slack_m: f64) -> bool {
        let [low, high] = extent_of(|direction| self.body_support(direction));
        (0..3).any(|axis| high[axis] > size_m[axis] + slack_m || low[axis] < -slack_m)
    }

    fn to_tool(&self, direction: Vec3) -> Vec3 {
        self.axes.map(|axis| dot(axis, direction))
    }

    /// Largest p . `direction` over the body, world frame.
    pub(crate) fn body_support(&self, direction: Vec3) -> f64 {
        dot(self.origin, direction) + self.tool.body_support(self.to_tool(direction))
    }

    /// Largest p . `direction` over the handle, world frame.
    pub(in crate::scene) fn handle_support(&self, direction: Vec3) -> f64 {
        dot(self.origin, direction) + self.tool.handle_support(self.to_tool(direction))
    }

    /// Whether the body stays clear of a convex solid.
    pub(in crate::scene) fn body_clears(&self, solid: &Hull) -> bool {
        solid.clear_of(|direction| self.body_support(direction))
    }

    /// Whether the handle stays clear of a convex solid.
    pub(in crate::scene) fn handle_clears(&self, solid: &Hull) -> bool {
        solid.clear_of(|direction| self.handle_support(direction))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bowl_reaches_a_radius_down_at_any_pitch_up_to_a_right_angle() {
        let scene = Scene::load("bench").unwrap();
        for pitch in [-90.0, -50.0, 0.0, 50.0, 90.0] {
            let tool = PlacedTool::new(&scene, [0.0; 3], pitch);
            assert!((tool.body_support([0.0, 0.0, -1.0]) - 0.020).abs() < 1e-15);
        }
        // Upside down the rim is the lowest part.
        let tool = PlacedTool::new(&scene, [0.0; 3], 180.0);
        assert!(tool.body_support([0.0, 0.0, -1.0]).abs() < 1e-15);
        assert!((tool.body_support([0.0, 0.0, 1.0]) - 0.020).abs() < 1e-15);
    }

    #[test]
    fn positive_pitch_lowers_the_lip_towards_the_heading() {
        let scene = Scene::load("bench").unwrap();
        let tool = PlacedTool::new(&scene, [0.0; 3], 90.0);
        // The opening looks along +x: nothing of the bowl lies before its rim plane.
        assert!(tool.body_support([1.0, 0.0, 0.0]).abs() < 1e-15);
        assert!((tool.body_support([-1.0, 0.0, 0.0]) - 0.020).abs() < 1e-15);
    }

    #[test]
    fn handle_rises_behind_the_bowl() {
        let scene = Scene::load("bench").unwrap();
        let [near, far] = scene.tool.handle_axis_m();
        // Middle of the wall at 18 mm, and the rod's radius.
        assert!((near[0] + 0.022).abs() < 1e-15);
        assert!(far[0] < near[0] && far[2] > 0.035);
    }
}
