//! Where the powder ended up.

use crate::scene::{Container, ContainerShape, Scene, ToolShape};
use powderline_shared::pose::Pose;

/// Where a particle is when all is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Destination {
    /// In or above the source or another container that is not the target, walls included; or above
    /// the target's rim, as the top of a heap in a full one.
    Remained,
    /// In the target: between its inner walls, above its floor and below its rim. Comes first.
    Target,
    /// On the tool: in the ball around a bowl's inside, in the box around a scoop's or around
    /// cuboids, with as much room above as below. Powder around a tool that still stands in the bed
    /// counts, too. Comes second.
    Tool,
    /// Above no container and not on the tool.
    Spilled,
}

/// Particles by where they are at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Census {
    /// Inside the target container, below its rim.
    pub(crate) transported: u32,
    /// Above no container's floor, and not on the tool.
    pub(crate) spilled: u32,
    /// On the tool.
    pub(crate) on_tool: u32,
}

pub(crate) fn census(scene: &Scene, positions: &[[f64; 3]], tool: &Pose) -> Census {
    let mut census = Census { transported: 0, spilled: 0, on_tool: 0 };
    for destination in destinations(scene, positions, tool) {
        match destination {
            Destination::Target => census.transported += 1,
            Destination::Spilled => census.spilled += 1,
            Destination::Tool => census.on_tool += 1,
            Destination::Remained => {}
        }
    }
    census
}

/// Where each particle is when the motion is over.
pub(crate) fn destinations(scene: &Scene, positions: &[[f64; 3]], tool: &Pose) -> Vec<Destination> {
    let target = scene.containers.iter().find(|c| c.name == scene.objective.target);
    let of = |p: &[f64; 3]| {
        let held = held(scene, tool, p);
        if target.is_some_and(|t| inside(t, p)) {
            Destination::Target
        } else if held {
            Destination::Tool
        } else if scene.containers.iter().any(|c| above(c, p, 1.0)) {
            Destination::Remained
        } else {
            Destination::Spilled
        }
    };
    positions.iter().map(of).collect()
}

/// Over the container's inner floor, with `walls` times its wall thickness added.
fn above(c: &Container, p: &[f64; 3], walls: f64) -> bool {
    let [x, y, _] = c.local_m(p);
    let extra = walls * c.wall_thickness_m;
    match c.shape {
        ContainerShape::Box { inner_size_m: [lx, ly, _] } => {
            x.abs() <= 0.5 * lx + extra && y.abs() <= 0.5 * ly + extra
        }
        ContainerShape::Cylinder { inner_radius_m, .. } => libm::hypot(x, y) <= inner_radius_m + extra,
    }
}

/// Between the container's walls and below its rim. A particle may stand in a wall's surface by a
/// fraction of the wall thickness, as contact is soft.
fn inside(c: &Container, p: &[f64; 3]) -> bool {
    let z = c.local_m(p)[2];
    above(c, p, 0.25) && z >= -0.25 * c.wall_thickness_m && z <= c.inner_height_m()
}

/// In the ball (or box) around the tool's inner space.
fn held(scene: &Scene, tool: &Pose, p: &[f64; 3]) -> bool {
    let y = tool.tool_from_world(&(*p).into());
    let t = scene.tool.wall_thickness_m;
    match &scene.tool.shape {
        ToolShape::Bowl { inner_radius_m } => y.norm() <= inner_radius_m + t,
        ToolShape::BoxScoop { inner_size_m: [l, w, h] } => {
            y.x.abs() <= 0.5 * l + t && y.y.abs() <= 0.5 * w + t && y.z.abs() <= h + t
        }
        ToolShape::Cuboids { .. } => {
            let ([low, high], p) = (scene.tool.body_extent_m(), [y.x, y.y, y.z]);
            // A heap is at most as high as the body.
            let above = [t, t, t + high[2] - low[2]];
            (0..3).all(|i| (low[i] - t..=high[i] + above[i]).contains(&p[i]))
        }
    }
}
