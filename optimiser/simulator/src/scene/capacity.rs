//! How much powder the tool carries: its cavity, heaped as steeply as the powder stands.
//!
//! | symbol | here |
//! |---|---|
//! | p, pitch of the tool while it carries | `pitch_rad` |
//! | phi, angle of repose, taken as the angle of internal friction | `repose_rad` |
//! | h(x, y), highest surface that stays on the tool | `surface_m` |
//!
//! `h(x, y) = min over the edge e of (z_e + tan(phi) |(x, y) - (x_e, y_e)|)`: from no edge over
//! which powder could leave does it rise more steeply than phi. The edge of a bowl is its rim; that
//! of a scoop its rim and the front of its floor; that of cuboids the border of what they cover,
//! seen from above. Level powder is the same with phi = 0.

use super::{Cuboid, Scene, ToolShape};
use serde::Serialize;

/// Parts that the cavity's extent is cut into, along each axis.
const PARTS: usize = 48;
/// Most parts where thin walls ask for more.
const MOST_PARTS: usize = 1000;
/// Points that stand for an edge.
const EDGE_POINTS: usize = 96;
/// Step between two pitches that are tried, radians.
const PITCH_STEP_RAD: f64 = 0.035;

/// Point in the tool's frame: origin at the middle of the opening, +z out of it, +x towards the lip.
type Point = [f64; 3];

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

/// An extent in equal parts.
#[derive(Clone, Copy)]
struct Ruler {
    from_m: f64,
    step_m: f64,
    parts: usize,
}

impl Ruler {
    fn new(extent_m: [f64; 2]) -> Self {
        Self::in_parts(extent_m, PARTS)
    }

    fn in_parts([from_m, to_m]: [f64; 2], parts: usize) -> Self {
        Self { from_m, step_m: (to_m - from_m) / parts as f64, parts }
    }

    /// In parts of at most so many metres.
    fn fine(extent_m: [f64; 2], most_m: f64) -> Self {
        let parts = ((extent_m[1] - extent_m[0]) / most_m).ceil() as usize;
        Self::in_parts(extent_m, parts.clamp(PARTS, MOST_PARTS))
    }

    /// The middle of a part.
    fn at(&self, index: usize) -> f64 {
        self.from_m + (index as f64 + 0.5) * self.step_m
    }

    fn middles(self) -> impl Iterator<Item = f64> {
        (0..self.parts).map(move |index| self.at(index))
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
        let (shape, edge) = (&self.tool.shape, self.tool.shape.edge());
        (0..=steps as u32)
            .map(|step| shape.heaped_m3(&edge, most + f64::from(step) / steps * (least - most), repose_rad))
            .fold(0.0, f64::max)
    }
}

impl ToolShape {
    /// Volume of the highest heap that stays on the tool of this edge at this pitch, cubic metres.
    fn heaped_m3(&self, edge: &[Point], pitch_rad: f64, repose_rad: f64) -> f64 {
        let (sin, cos) = libm::sincos(pitch_rad);
        let upright = |[x, y, z]: Point| [x * cos + z * sin, y, z * cos - x * sin];
        let tilted = |[x, y, z]: Point| [x * cos - z * sin, y, x * sin + z * cos];
        let edge: Vec<Point> = edge.iter().copied().map(upright).collect();
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
        match self {
            // Of the whole ball, which holds it at any pitch.
            Self::Bowl { inner_radius_m } => [[-inner_radius_m, *inner_radius_m]; 3],
            Self::BoxScoop { inner_size_m: [length, width, height] } => extent((0..8).map(|corner| {
                let side = |bit: usize| if corner >> bit & 1 == 0 { -0.5 } else { 0.5 };
                upright([side(0) * length, side(1) * width, (side(2) - 0.5) * height])
            })),
            Self::Cuboids { cuboid } => extent(cuboid.iter().flat_map(Cuboid::corners_m).map(upright)),
        }
    }

    fn holds(&self, [x, y, z]: Point) -> bool {
        match self {
            Self::Bowl { inner_radius_m } => z <= 0.0 && libm::hypot(libm::hypot(x, y), z) <= *inner_radius_m,
            Self::BoxScoop { inner_size_m: [length, width, height] } => {
                x.abs() <= 0.5 * length && y.abs() <= 0.5 * width && (-height..=0.0).contains(&z)
            }
            // Over one of the cuboids and within none.
            Self::Cuboids { cuboid } => {
                let mut spans = cuboid.iter().filter_map(|cuboid| cuboid.heights_m(x, y));
                spans.any(|[low, _]| low < z) && self.is_open_at([x, y, z])
            }
        }
    }

    /// Whether a point just outside the cavity is there through an opening, not through a wall.
    fn is_open_at(&self, [x, y, z]: Point) -> bool {
        match self {
            Self::Bowl { .. } => z > 0.0,
            Self::BoxScoop { inner_size_m: [length, ..] } => z > 0.0 || x > 0.5 * length,
            Self::Cuboids { cuboid } => {
                let mut spans = cuboid.iter().filter_map(|cuboid| cuboid.heights_m(x, y));
                spans.all(|[low, high]| z < low || z > high)
            }
        }
    }

    /// Points over which powder can leave.
    fn edge(&self) -> Vec<Point> {
        let share = |index: usize| index as f64 / EDGE_POINTS as f64;
        match self {
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
            Self::Cuboids { cuboid } => border(cuboid),
        }
    }
}

/// Lowest and highest coordinates of some points.
fn extent(points: impl Iterator<Item = Point>) -> [[f64; 2]; 3] {
    points.fold([[f64::INFINITY, f64::NEG_INFINITY]; 3], |found, point| {
        [0, 1, 2].map(|axis| [found[axis][0].min(point[axis]), found[axis][1].max(point[axis])])
    })
}

/// The border of what cuboids cover, seen from above, at the height of their upper side.
fn border(cuboids: &[Cuboid]) -> Vec<Point> {
    // No wall lies between two of the verticals.
    let thinnest_m = cuboids.iter().flat_map(|cuboid| cuboid.size_m).fold(f64::INFINITY, f64::min);
    let [x, y, _] =
        extent(cuboids.iter().flat_map(Cuboid::corners_m)).map(|along| Ruler::fine(along, 0.5 * thinnest_m));
    let top_m = |i: usize, j: usize| {
        let highest = |top: Option<f64>, [_, high]: [f64; 2]| Some(top.map_or(high, |top| top.max(high)));
        cuboids.iter().filter_map(|cuboid| cuboid.heights_m(x.at(i), y.at(j))).fold(None, highest)
    };
    let place = |index: usize| (index / y.parts, index % y.parts);
    let tops: Vec<Option<f64>> = (0..x.parts * y.parts).map(place).map(|(i, j)| top_m(i, j)).collect();
    let covered = |i: usize, j: usize| i < x.parts && j < y.parts && tops[i * y.parts + j].is_some();
    let is_inside = |(i, j): (usize, usize)| {
        covered(i + 1, j)
            && covered(i, j + 1)
            && covered(i.wrapping_sub(1), j)
            && covered(i, j.wrapping_sub(1))
    };
    let on_border = (0..tops.len()).filter(|index| !is_inside(place(*index)));
    let point = |index: usize| tops[index].map(|top_m| [x.at(place(index).0), y.at(place(index).1), top_m]);
    on_border.filter_map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heaped_m3(shape: &ToolShape, pitch_rad: f64, repose_rad: f64) -> f64 {
        shape.heaped_m3(&shape.edge(), pitch_rad, repose_rad)
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
            assert!((a / b - 1.0).abs() < 0.06, "{pitch_deg}: {a} {b}");
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
