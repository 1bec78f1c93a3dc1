//! Where the tool reaches at a given pose.
//!
//! The body stands for its convex hull: the cavity counts as solid, which only matters for things inside it. World
//! axes of the tool at heading h and pitch p: x = cos p h - sin p z, y = z x h, z = sin p h + cos p z.

use super::solid::{Hull, Obstacle, Solid, Vec3, dot};
use super::{Cuboid, Scene, Tool, ToolShape};
use nalgebra::Vector3;
use powderline_shared::pose::Pose;
use std::fmt;

impl Tool {
    /// Distance from the tool's origin to its lowest point when the opening looks straight up, metres.
    pub fn body_depth_m(&self) -> f64 {
        self.body_support([0.0, 0.0, -1.0])
    }

    /// Ends of the handle's axis in the tool's frame, metres: its round end touches the inside of the rear wall.
    pub fn handle_axis_m(&self) -> [[f64; 3]; 2] {
        let (start, along) = self.handle();
        [start, [0, 1, 2].map(|i| start[i] + along[i])]
    }

    /// Where the handle's axis begins, and from there to its end, tool frame, metres.
    pub(crate) fn handle(&self) -> ([f64; 3], [f64; 3]) {
        let half_wall = 0.5 * self.wall_thickness_m;
        let rear = match &self.shape {
            ToolShape::Bowl { inner_radius_m } => inner_radius_m + half_wall,
            ToolShape::BoxScoop { inner_size_m } => 0.5 * inner_size_m[0] + half_wall,
            ToolShape::Cuboids { .. } => self.body_support([-1.0, 0.0, 0.0]) - half_wall,
        };
        let start = rear + half_wall.max(self.handle.radius_m);
        let (rise, length) = (self.handle.rise_deg.to_radians(), self.handle.length_m);
        ([-start, 0.0, 0.0], [-length * libm::cos(rise), 0.0, length * libm::sin(rise)])
    }

    /// Reach of the body from the tool's origin, tool frame.
    pub(super) fn body_support(&self, direction: Vec3) -> f64 {
        let [x, y, z] = direction;
        let wall = self.wall_thickness_m;
        match &self.shape {
            ToolShape::Bowl { inner_radius_m } => {
                let across = libm::hypot(x, y);
                let below_rim = if z > 0.0 { across } else { libm::hypot(across, z) };
                (inner_radius_m + wall) * below_rim
            }
            ToolShape::BoxScoop { inner_size_m: [length, width, height] } => {
                let along = if x > 0.0 { 0.5 * length * x } else { -(0.5 * length + wall) * x };
                along + (0.5 * width + wall) * y.abs() + (height + wall) * (-z).max(0.0)
            }
            ToolShape::Cuboids { cuboid } => farthest(cuboid.iter().map(|cuboid| cuboid.support(direction))),
        }
    }

    /// Lowest and highest coordinates of the body, tool frame, metres.
    pub(crate) fn body_extent_m(&self) -> [Vec3; 2] {
        let mut extent = [[0.0; 3]; 2];
        for axis in 0..3 {
            let mut along = [0.0; 3];
            along[axis] = 1.0;
            extent[1][axis] = self.body_support(along);
            extent[0][axis] = -self.body_support(along.map(|x| -x));
        }
        extent
    }

    /// Of a ball around the tool's origin that holds all of it, metres.
    pub(crate) fn bounding_radius_m(&self) -> f64 {
        let wall = self.wall_thickness_m;
        let body = match &self.shape {
            ToolShape::Bowl { inner_radius_m } => inner_radius_m + wall,
            ToolShape::BoxScoop { inner_size_m: [length, width, height] } => {
                let half = [0.5 * length + wall, 0.5 * width + wall, height + wall];
                libm::sqrt(dot(half, half))
            }
            ToolShape::Cuboids { cuboid } => farthest(
                cuboid.iter().flat_map(Cuboid::corners_m).map(|corner| libm::sqrt(dot(corner, corner))),
            ),
        };
        let ends = self.handle_axis_m().map(|end| libm::sqrt(dot(end, end)) + self.handle.radius_m);
        body.max(ends[0]).max(ends[1])
    }

    fn handle_support(&self, direction: Vec3) -> f64 {
        let [near, far] = self.handle_axis_m();
        dot(near, direction).max(dot(far, direction)) + self.handle.radius_m
    }
}

fn farthest(reaches: impl Iterator<Item = f64>) -> f64 {
    reaches.fold(f64::NEG_INFINITY, f64::max)
}

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
    pub(super) fn new(scene: &'a Scene, origin: Vec3, pitch_deg: f64) -> Self {
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

    fn to_tool(&self, direction: Vec3) -> Vec3 {
        self.axes.map(|axis| dot(axis, direction))
    }

    /// Largest p . `direction` over the body, world frame.
    pub(super) fn body_support(&self, direction: Vec3) -> f64 {
        dot(self.origin, direction) + self.tool.body_support(self.to_tool(direction))
    }

    /// Largest p . `direction` over the handle, world frame.
    pub(super) fn handle_support(&self, direction: Vec3) -> f64 {
        dot(self.origin, direction) + self.tool.handle_support(self.to_tool(direction))
    }

    /// Whether the body stays clear of a convex solid.
    pub(super) fn body_clears(&self, solid: &Hull) -> bool {
        solid.clear_of(|direction| self.body_support(direction))
    }

    /// Whether the handle stays clear of a convex solid.
    pub(super) fn handle_clears(&self, solid: &Hull) -> bool {
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
