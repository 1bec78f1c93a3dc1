//! How much powder the tool carries: its cavity, heaped as steeply as the powder stands.
//!
//! | symbol | here |
//! |---|---|
//! | p, pitch of the tool while it carries | `pitch_rad` |
//! | phi, angle of repose, taken as the angle of internal friction | `repose_rad` |
//! | h(x, y), highest surface that stays on the tool | `surface_m` |
//!
//! `h(x, y) = min over the edge e of (z_e + tan(phi) |(x, y) - (x_e, y_e)|)`: from no edge over which powder could leave does it
//! rise more steeply than phi. The edge of a bowl is its rim; that of a scoop its rim and the front of its floor.
//! Level powder is the same with phi = 0.

use super::{Scene, ToolShape};
use serde::Serialize;

/// Parts that the cavity's extent is cut into, along each axis.
const PARTS: usize = 48;
/// Points that stand for an edge.
const EDGE_POINTS: usize = 96;
/// Step between two pitches that are tried, radians.
const PITCH_STEP_RAD: f64 = 0.035;

/// Point in the tool's frame: origin at the middle of the opening, +z out of it, +x towards the lip.
type Point = [f64; 3];

/// What the tool carries at most, kilogram.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Capacity {
    /// Heaped as steeply as the powder stands.
    pub heaped_kg: f64,
    /// With a level surface.
    pub level_kg: f64,
}

/// An extent in equal parts.
#[derive(Clone, Copy)]
struct Ruler {
    from_m: f64,
    step_m: f64,
}

impl Ruler {
    fn new([from_m, to_m]: [f64; 2]) -> Self {
        Self { from_m, step_m: (to_m - from_m) / PARTS as f64 }
    }

    /// The middle of a part.
    fn at(&self, index: usize) -> f64 {
        self.from_m + (index as f64 + 0.5) * self.step_m
    }

    fn middles(self) -> impl Iterator<Item = f64> {
        (0..PARTS).map(move |index| self.at(index))
    }
}

impl Scene {
    /// What the tool can carry at the best of the pitches that the scooping angle's bounds allow.
    pub fn tool_capacity(&self) -> Capacity {
        let kg = |repose_deg: f64| self.powder.density_kg_m3 * self.carried_m3(repose_deg.to_radians());
        Capacity { heaped_kg: kg(self.powder.friction_angle_deg), level_kg: kg(0.0) }
    }

    fn carried_m3(&self, repose_rad: f64) -> f64 {
        let [least, most] = self
            .skill
            .scooping_angle_deg
            .map(|scoop_deg| (self.tool.start_pitch_deg - scoop_deg).to_radians());
        let steps = ((least - most) / PITCH_STEP_RAD).ceil().max(1.0);
        (0..=steps as u32)
            .map(|step| {
                self.tool.shape.heaped_m3(most + f64::from(step) / steps * (least - most), repose_rad)
            })
            .fold(0.0, f64::max)
    }
}

impl ToolShape {
    /// Volume of the highest heap that stays on the tool at this pitch, cubic metres.
    fn heaped_m3(&self, pitch_rad: f64, repose_rad: f64) -> f64 {
        let (sin, cos) = libm::sincos(pitch_rad);
        let upright = |[x, y, z]: Point| [x * cos + z * sin, y, z * cos - x * sin];
        let tilted = |[x, y, z]: Point| [x * cos - z * sin, y, x * sin + z * cos];
        let edge: Vec<Point> = self.edge().into_iter().map(upright).collect();
        let [x, y, z] = self.extent_m(upright).map(Ruler::new);
        let slope = libm::tan(repose_rad);
        let mut sum_m = 0.0;
        for (x_m, y_m) in x.middles().flat_map(|x_m| y.middles().map(move |y_m| (x_m, y_m))) {
            let surface_m = edge
                .iter()
                .map(|e| e[2] + slope * libm::hypot(x_m - e[0], y_m - e[1]))
                .fold(f64::INFINITY, f64::min);
            let inside = |index: &usize| self.holds(tilted([x_m, y_m, z.at(*index)]));
            let Some(bottom) = (0..PARTS).find(inside) else { continue };
            let top = (bottom..PARTS).find(|index| !inside(index)).unwrap_or(PARTS);
            // Under a wall that leans over, powder ends there; in the open it goes on as a heap.
            let ceiling_m = if self.is_open_at(tilted([x_m, y_m, z.at(top)])) {
                f64::INFINITY
            } else {
                z.at(top) - 0.5 * z.step_m
            };
            sum_m += (surface_m.min(ceiling_m) - (z.at(bottom) - 0.5 * z.step_m)).max(0.0);
        }
        sum_m * x.step_m * y.step_m
    }

    /// Extent of the cavity along x, y, z once it is turned, metres.
    fn extent_m(&self, upright: impl Fn(Point) -> Point) -> [[f64; 2]; 3] {
        match *self {
            // Of the whole ball, which holds it at any pitch.
            Self::Bowl { inner_radius_m } => [[-inner_radius_m, inner_radius_m]; 3],
            Self::BoxScoop { inner_size_m: [length, width, height] } => {
                let corners: Vec<Point> = (0..8)
                    .map(|corner| {
                        let side = |bit: usize| if corner >> bit & 1 == 0 { -0.5 } else { 0.5 };
                        upright([side(0) * length, side(1) * width, (side(2) - 0.5) * height])
                    })
                    .collect();
                [0, 1, 2].map(|axis| {
                    let along = || corners.iter().map(|corner| corner[axis]);
                    [along().fold(f64::INFINITY, f64::min), along().fold(f64::NEG_INFINITY, f64::max)]
                })
            }
        }
    }

    fn holds(&self, [x, y, z]: Point) -> bool {
        match *self {
            Self::Bowl { inner_radius_m } => z <= 0.0 && libm::hypot(libm::hypot(x, y), z) <= inner_radius_m,
            Self::BoxScoop { inner_size_m: [length, width, height] } => {
                x.abs() <= 0.5 * length && y.abs() <= 0.5 * width && (-height..=0.0).contains(&z)
            }
        }
    }

    /// Whether a point just outside the cavity is there through an opening, not through a wall.
    fn is_open_at(&self, [x, _, z]: Point) -> bool {
        match *self {
            Self::Bowl { .. } => z > 0.0,
            Self::BoxScoop { inner_size_m: [length, ..] } => z > 0.0 || x > 0.5 * length,
        }
    }

    /// Points over which powder can leave.
    fn edge(&self) -> Vec<Point> {
        let share = |index: usize| index as f64 / EDGE_POINTS as f64;
        match *self {
            Self::Bowl { inner_radius_m } => (0..EDGE_POINTS)
                .map(|index| {
                    let (sin, cos) = libm::sincos(core::f64::consts::TAU * share(index));
                    [inner_radius_m * cos, inner_radius_m * sin, 0.0]
                })
                .collect(),
            Self::BoxScoop { inner_size_m: [length, width, height] } => (0..=EDGE_POINTS)
                .flat_map(|index| {
                    let along = share(index) - 0.5;
                    let (x, y) = (along * length, along * width);
                    [
                        [-0.5 * length, y, 0.0],
                        [x, -0.5 * width, 0.0],
                        [x, 0.5 * width, 0.0],
                        [0.5 * length, y, -height],
                    ]
                })
                .collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The closed forms: a hemisphere and a cone; a wedge on the floor of a scoop whose walls are higher than it.
    #[test]
    fn heaps_have_the_volume_of_the_textbook() {
        let phi = 35f64.to_radians();
        let r = 0.016f64;
        let bowl = ToolShape::Bowl { inner_radius_m: r };
        let textbook = core::f64::consts::PI * r.powi(3) * (2.0 + phi.tan()) / 3.0;
        assert!((bowl.heaped_m3(0.0, phi) / textbook - 1.0).abs() < 0.02);
        let level = core::f64::consts::PI * r.powi(3) * 2.0 / 3.0;
        assert!((bowl.heaped_m3(0.0, 0.0) / level - 1.0).abs() < 0.02);

        let [length, width, height] = [0.02, 0.012, 0.03];
        let scoop = ToolShape::BoxScoop { inner_size_m: [length, width, height] };
        let wedge = 0.5 * length * length * phi.tan() * width;
        assert!((scoop.heaped_m3(0.0, phi) / wedge - 1.0).abs() < 0.05);
        // Leaning back by 20 degrees the open front lets 55 degrees stand against the rear wall.
        let leaning = scoop.heaped_m3((-20f64).to_radians(), phi);
        let steep = 0.5 * length * length * 55f64.to_radians().tan() * width;
        assert!((leaning / steep - 1.0).abs() < 0.08, "{leaning} {steep}");
    }

    #[test]
    fn tilting_a_bowl_loses_powder_until_none_is_left() {
        let bowl = ToolShape::Bowl { inner_radius_m: 0.016 };
        let carried = |deg: f64| bowl.heaped_m3(deg.to_radians(), 0.6);
        assert!(carried(0.0) > carried(30.0) && carried(30.0) > carried(60.0));
        assert!((carried(40.0) / carried(-40.0) - 1.0).abs() < 1e-6);
        assert!(carried(130.0) < 0.01 * carried(0.0));
    }

    #[test]
    fn the_spoon_of_the_bench_carries_what_was_measured() {
        let Capacity { heaped_kg, level_kg } = Scene::load("bench").unwrap().tool_capacity();
        assert!((0.0110..0.0122).contains(&heaped_kg), "{heaped_kg}");
        assert!((0.0084..0.0088).contains(&level_kg), "{level_kg}");
    }
}
