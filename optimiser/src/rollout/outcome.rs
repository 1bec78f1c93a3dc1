//! What a motion achieved: loss with its gradient, and where the powder ended up.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::scene::{Container, ContainerShape, Norm, Observation, Scene, ToolShape};
use powderline_shared::pose::Pose;
use powderline_view::Destination;

/// Which particles the loss sees, by identity.
///
/// The choice is a constant for the gradient: it flows through the positions of the particles seen.
pub(crate) fn observed(scene: &Scene, positions: &[[f64; 3]]) -> Vec<usize> {
    match scene.objective.observation {
        Observation::All => (0..positions.len()).collect(),
        Observation::Subsample { particles } => {
            subsample(scene.powder.seed, positions.len(), particles as usize)
        }
        Observation::VisibleFromAbove { pixel_m } => visible_from_above(positions, pixel_m),
    }
}

/// The first `wanted` of a Fisher-Yates shuffle, in ascending order.
fn subsample(seed: u64, count: usize, wanted: usize) -> Vec<usize> {
    // A stream of its own, so that the packing and the subsample do not share random numbers.
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(1);
    let mut all: Vec<usize> = (0..count).collect();
    let wanted = wanted.min(count);
    for i in 0..wanted {
        let j = i + (random.next_u64() % (count - i) as u64) as usize;
        all.swap(i, j);
    }
    all.truncate(wanted);
    all.sort_unstable();
    all
}

/// The highest particle of each pixel column.
fn visible_from_above(positions: &[[f64; 3]], pixel_m: f64) -> Vec<usize> {
    let mut highest = std::collections::BTreeMap::new();
    for (id, [x, y, z]) in positions.iter().enumerate() {
        let pixel = ((x / pixel_m).floor() as i64, (y / pixel_m).floor() as i64);
        let best = highest.entry(pixel).or_insert(id);
        if *z > positions[*best][2] {
            *best = id;
        }
    }
    let mut out: Vec<usize> = highest.into_values().collect();
    out.sort_unstable();
    out
}

/// Sum over the observed particles of the distance (m) from `p_target`, and its gradient for every particle.
pub(crate) fn loss(scene: &Scene, positions: &[[f64; 3]]) -> (f64, Vec<[f64; 3]>) {
    let mut sum = 0.0;
    let mut gradient = vec![[0.0; 3]; positions.len()];
    let target = scene.objective.p_target_m;
    for id in observed(scene, positions) {
        let d = [0, 1, 2].map(|i| positions[id][i] - target[i]);
        match scene.objective.norm {
            Norm::Euclidean => {
                let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
                sum += length;
                if length > 0.0 {
                    gradient[id] = d.map(|x| x / length);
                }
            }
            Norm::L1 => {
                sum += d[0].abs() + d[1].abs() + d[2].abs();
                gradient[id] = d.map(|x| if x == 0.0 { 0.0 } else { x.signum() });
            }
        }
    }
    (sum, gradient)
}

/// Particles by where they are at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Census {
    /// Inside the target container, below its rim.
    pub(crate) transported: u32,
    /// Above no container's floor, and not on the tool.
    pub(crate) spilled: u32,
}

pub(crate) fn census(scene: &Scene, positions: &[[f64; 3]], tool: &Pose) -> Census {
    let mut census = Census { transported: 0, spilled: 0 };
    for destination in destinations(scene, positions, tool) {
        match destination {
            Destination::Target => census.transported += 1,
            Destination::Spilled => census.spilled += 1,
            Destination::Left | Destination::Tool => {}
        }
    }
    census
}

/// Where each particle is when the motion is over.
pub(crate) fn destinations(scene: &Scene, positions: &[[f64; 3]], tool: &Pose) -> Vec<Destination> {
    let target = scene.container.iter().find(|c| c.name == scene.objective.target);
    let of = |p: &[f64; 3]| {
        let held = held(scene, tool, p);
        if target.is_some_and(|t| inside(t, p)) {
            Destination::Target
        } else if held {
            Destination::Tool
        } else if scene.container.iter().any(|c| above(c, p, 1.0)) {
            Destination::Left
        } else {
            Destination::Spilled
        }
    };
    positions.iter().map(of).collect()
}

/// In the container's own frame, floor at z = 0.
fn local(c: &Container, p: &[f64; 3]) -> [f64; 3] {
    let d = [0, 1, 2].map(|i| p[i] - c.position_m[i]);
    let (sin, cos) = libm::sincos(c.yaw_deg.to_radians());
    [cos * d[0] + sin * d[1], cos * d[1] - sin * d[0], d[2]]
}

/// Over the container's inner floor, with `walls` times its wall thickness added.
fn above(c: &Container, p: &[f64; 3], walls: f64) -> bool {
    let [x, y, _] = local(c, p);
    let extra = walls * c.wall_thickness_m;
    match c.shape {
        ContainerShape::Box { inner_size_m: [lx, ly, _] } => {
            x.abs() <= 0.5 * lx + extra && y.abs() <= 0.5 * ly + extra
        }
        ContainerShape::Cylinder { inner_radius_m, .. } => x.hypot(y) <= inner_radius_m + extra,
    }
}

/// Between the container's walls and below its rim. A particle may stand in a wall's surface by a fraction of
/// the wall thickness, as contact is soft.
fn inside(c: &Container, p: &[f64; 3]) -> bool {
    let height = match c.shape {
        ContainerShape::Box { inner_size_m } => inner_size_m[2],
        ContainerShape::Cylinder { inner_height_m, .. } => inner_height_m,
    };
    let z = local(c, p)[2];
    above(c, p, 0.25) && z >= -0.25 * c.wall_thickness_m && z <= height
}

/// In the ball (or box) around the tool's inner space.
fn held(scene: &Scene, tool: &Pose, p: &[f64; 3]) -> bool {
    let y = tool.tool_from_world(&(*p).into());
    let t = scene.tool.wall_thickness_m;
    match scene.tool.shape {
        ToolShape::Bowl { inner_radius_m } => y.norm() <= inner_radius_m + t,
        ToolShape::BoxScoop { inner_size_m: [l, w, h] } => {
            y.x.abs() <= 0.5 * l + t && y.y.abs() <= 0.5 * w + t && y.z.abs() <= h + t
        }
    }
}
