//! How much powder the tool carries: its cavity, heaped as steeply as the powder stands.
//!
//! | symbol | here |
//! |---|---|
//! | p, pitch of the tool while it carries | `pitch_rad` |
//! | phi, angle of repose, taken as the angle of internal friction | `repose_rad` |
//! | h(x, y), highest surface that stays on the tool | `surface_m` |
//!
//! `h(x, y) = min over the edge e of (z_e + tan(phi) |(x, y) - (x_e, y_e)|)`: from no edge over
//! which powder could leave does it rise more steeply than phi. What the edge is, the tool's shape
//! says. Level powder is the same with phi = 0.

use super::Scene;
use super::ruler::Ruler;
use super::tool::{Body, Point};
use serde::Serialize;

/// Step between two pitches that are tried, radians.
const PITCH_STEP_RAD: f64 = 0.035;

/// What the tool carries at most, kilogram: the largest heap at rest of which no flank is steeper
/// than the friction angle, over any edge that powder can leave by, at the best pitch that the
/// skill allows. An estimate from geometry alone. A simulated tool of cuboids with low rims has
/// carried up to twice as much.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Capacity {
    /// Heaped as steeply as the powder stands.
    pub heaped_kg: f64,
    /// With a level surface.
    pub level_kg: f64,
}

impl Scene {
    /// What the tool can carry at the best of the pitches that the scooping angle's bounds allow.
    pub fn tool_capacity(&self) -> Capacity {
        let kg = |repose_deg: f64| self.powder.density_kg_m3 * self.carried_m3(repose_deg.to_radians());
        Capacity { heaped_kg: kg(self.powder.friction_angle_deg), level_kg: kg(0.0) }
    }

    /// What it holds heaped where it does not lean, kilogram.
    pub(super) fn heaped_upright_kg(&self) -> f64 {
        let repose_rad = self.powder.friction_angle_deg.to_radians();
        self.powder.density_kg_m3 * self.tool.with_body(|body| heaped_m3(body, &body.edge(), 0.0, repose_rad))
    }

    fn carried_m3(&self, repose_rad: f64) -> f64 {
        let [least, most] = self
            .skill
            .scooping_angle_deg
            .map(|scoop_deg| (self.tool.start_pitch_deg - scoop_deg).to_radians());
        let steps = ((least - most) / PITCH_STEP_RAD).ceil().max(1.0);
        let pitches_rad = (0..=steps as u32).map(|step| most + f64::from(step) / steps * (least - most));
        self.tool.with_body(|body| {
            let edge = body.edge();
            pitches_rad.map(|pitch_rad| heaped_m3(body, &edge, pitch_rad, repose_rad)).fold(0.0, f64::max)
        })
    }
}

/// Volume of the highest heap that stays on a body of this edge at this pitch, cubic metres.
fn heaped_m3(body: &dyn Body, edge: &[Point], pitch_rad: f64, repose_rad: f64) -> f64 {
    let (sin, cos) = libm::sincos(pitch_rad);
    let upright = |[x, y, z]: Point| [x * cos + z * sin, y, z * cos - x * sin];
    let tilted = |[x, y, z]: Point| [x * cos - z * sin, y, x * sin + z * cos];
    let edge: Vec<Point> = edge.iter().copied().map(upright).collect();
    let [x, y, z] = body.cavity_extent_m(&upright).map(Ruler::new);
    let slope = libm::tan(repose_rad);
    let mut sum_m = 0.0;
    for (x_m, y_m) in x.middles().flat_map(|x_m| y.middles().map(move |y_m| (x_m, y_m))) {
        let surface_m = edge
            .iter()
            .map(|e| e[2] + slope * libm::hypot(x_m - e[0], y_m - e[1]))
            .fold(f64::INFINITY, f64::min);
        let inside = |index: &usize| body.encloses(tilted([x_m, y_m, z.at(*index)]));
        let Some(bottom) = (0..z.parts).find(inside) else { continue };
        let top = (bottom..z.parts).find(|index| !inside(index)).unwrap_or(z.parts);
        // Under a wall that leans over, powder ends there; in the open it goes on as a heap.
        let ceiling_m = if body.is_open_at(tilted([x_m, y_m, z.at(top)])) {
            f64::INFINITY
        } else {
            z.at(top) - 0.5 * z.step_m
        };
        sum_m += (surface_m.min(ceiling_m) - (z.at(bottom) - 0.5 * z.step_m)).max(0.0);
    }
    sum_m * x.step_m * y.step_m
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Cuboid, ToolShape};

    fn heaped_m3(shape: &ToolShape, pitch_rad: f64, repose_rad: f64) -> f64 {
        shape.with_body(0.0, |body| super::heaped_m3(body, &body.edge(), pitch_rad, repose_rad))
    }

    /// The closed forms: a hemisphere and a cone; a wedge on the floor of a scoop whose walls are
    /// higher than it.
    #[test]
    fn heaps_have_the_volume_of_the_textbook() {
        let phi = 35f64.to_radians();
        let r = 0.016f64;
        let bowl = ToolShape::Bowl { inner_radius_m: r };
        let textbook = core::f64::consts::PI * r.powi(3) * (2.0 + phi.tan()) / 3.0;
        assert!((heaped_m3(&bowl, 0.0, phi) / textbook - 1.0).abs() < 0.02);
        let level = core::f64::consts::PI * r.powi(3) * 2.0 / 3.0;
        assert!((heaped_m3(&bowl, 0.0, 0.0) / level - 1.0).abs() < 0.02);

        let [length, width, height] = [0.02, 0.012, 0.03];
        let scoop = ToolShape::BoxScoop { inner_size_m: [length, width, height] };
        let wedge = 0.5 * length * length * phi.tan() * width;
        assert!((heaped_m3(&scoop, 0.0, phi) / wedge - 1.0).abs() < 0.05);
        // Leaning back by 20 degrees the open front lets 55 degrees stand against the rear wall.
        let leaning = heaped_m3(&scoop, (-20f64).to_radians(), phi);
        let steep = 0.5 * length * length * 55f64.to_radians().tan() * width;
        assert!((leaning / steep - 1.0).abs() < 0.08, "{leaning} {steep}");
    }

    /// A scoop of cuboids holds what the same scoop of walls does, and the rims' own width of heap
    /// besides.
    #[test]
    fn blocks_hold_what_they_enclose() {
        let phi = 35f64.to_radians();
        let [length, width, height, wall] = [0.02, 0.012, 0.03, 1e-4];
        let cuboid = |min: Point, max: Point| Cuboid {
            centre_m: [0, 1, 2].map(|i| 0.5 * (min[i] + max[i])),
            size_m: [0, 1, 2].map(|i| max[i] - min[i]),
            rotation_deg: [0.0; 3],
        };
        let (x, y) = (0.5 * length, 0.5 * width);
        let walls = vec![
            cuboid([-x - wall, -y - wall, -height - wall], [x, y + wall, -height]),
            cuboid([-x - wall, -y - wall, -height], [-x, y + wall, 0.0]),
            cuboid([-x, -y - wall, -height], [x, -y, 0.0]),
            cuboid([-x, y, -height], [x, y + wall, 0.0]),
        ];
        let cuboids = ToolShape::Cuboids { cuboid: walls };
        let scoop = ToolShape::BoxScoop { inner_size_m: [length, width, height] };
        for pitch_deg in [0.0, -20.0, 15.0] {
            let [a, b] = [&cuboids, &scoop].map(|shape| heaped_m3(shape, f64::to_radians(pitch_deg), phi));
            assert!((a / b - 1.0).abs() < 0.08, "{pitch_deg}: {a} {b}");
        }
    }

    /// A gutter of two plates: level powder fills the triangle between them.
    #[test]
    fn a_gutter_of_two_plates_holds_its_triangle() {
        let [length, edge, wall] = [0.04, 0.02, 1e-4];
        let plate = |side: f64| {
            let (sin, cos) = libm::sincos(core::f64::consts::FRAC_PI_4);
            let rotation_deg = [side * 45.0, 0.0, 0.0];
            Cuboid {
                centre_m: [0.0, side * 0.5 * edge * cos, 0.5 * edge * sin],
                size_m: [length, edge, wall],
                rotation_deg,
            }
        };
        let end = |side: f64| Cuboid {
            centre_m: [side * 0.5 * length, 0.0, 0.5 * edge * 0.707],
            size_m: [wall, edge * 1.414, edge * 0.707],
            rotation_deg: [0.0; 3],
        };
        let gutter = ToolShape::Cuboids { cuboid: vec![plate(-1.0), plate(1.0), end(-1.0), end(1.0)] };
        let triangle = 0.5 * edge * edge * length;
        let level = heaped_m3(&gutter, 0.0, 0.0);
        assert!((level / triangle - 1.0).abs() < 0.08, "{level} {triangle}");
    }

    /// The closed form: a pyramid on a square.
    #[test]
    fn a_flat_plate_holds_a_heap() {
        let (edge, phi) = (0.03, 35f64.to_radians());
        let size_m = [edge, edge, 0.004];
        let plate = ToolShape::Cuboids {
            cuboid: vec![Cuboid { centre_m: [0.0; 3], size_m, rotation_deg: [0.0; 3] }],
        };
        let pyramid = edge.powi(3) * phi.tan() / 6.0;
        let heap = heaped_m3(&plate, 0.0, phi);
        // Its edge is looked at half a part within.
        assert!((heap / pyramid - 1.0).abs() < 0.08, "{heap} {pyramid}");
        assert!(heaped_m3(&plate, 0.0, 0.0) < 0.01 * pyramid);
    }

    #[test]
    fn tilting_a_bowl_loses_powder_until_none_is_left() {
        let bowl = ToolShape::Bowl { inner_radius_m: 0.016 };
        let carried = |deg: f64| heaped_m3(&bowl, deg.to_radians(), 0.6);
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
