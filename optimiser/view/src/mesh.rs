//! Triangles of what stands or moves on a bench, made from its dimensions.

use nalgebra::{Isometry3, Point3, Vector3};

/// Corners of a circle.
const SIDES: usize = 48;

/// Rings from the bottom of a bowl to its rim, or from the equator of a round end to its pole.
const RINGS: usize = 12;

/// Triangles that share their corners; seen from outside their corners run counter-clockwise.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Corners, metres.
    pub points_m: Vec<[f64; 3]>,
    /// Indices of each triangle's corners.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Everything of both.
    #[must_use]
    pub fn and(mut self, other: Self) -> Self {
        let first = self.points_m.len() as u32;
        self.points_m.extend(other.points_m);
        self.triangles.extend(other.triangles.iter().map(|triangle| triangle.map(|corner| corner + first)));
        self
    }

    /// The same elsewhere.
    #[must_use]
    pub fn moved(mut self, to: &Isometry3<f64>) -> Self {
        for point in &mut self.points_m {
            *point = (to * Point3::from(*point)).coords.into();
        }
        self
    }

    /// Box between two corners.
    #[must_use]
    pub fn block(low: [f64; 3], high: [f64; 3]) -> Self {
        let corner =
            |index: usize| [0, 1, 2].map(|axis| if index >> axis & 1 == 0 { low[axis] } else { high[axis] });
        Self::cuboid(std::array::from_fn(corner))
    }

    /// Box with these corners: corner i has the high x if bit 0 is set, the high y if bit 1 is, the high z if bit 2 is,
    /// along its own axes.
    #[must_use]
    pub fn cuboid(corners_m: [[f64; 3]; 8]) -> Self {
        let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let triangles = faces.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        Self { points_m: corners_m.into(), triangles }
    }

    /// Box without a lid: inner dimensions, origin at the centre of the inner floor, walls and floor outside them.
    #[must_use]
    pub fn open_box(inner_size_m: [f64; 3], wall_m: f64) -> Self {
        let [x, y, z] = [0.5 * inner_size_m[0], 0.5 * inner_size_m[1], inner_size_m[2]];
        Self::block([-x - wall_m, -y - wall_m, -wall_m], [x + wall_m, y + wall_m, 0.0])
            .and(Self::box_walls([x, y, z], wall_m))
    }

    /// The same with a slot across the whole of its floor, in the middle and along y.
    #[must_use]
    pub fn slotted_box(inner_size_m: [f64; 3], slot_width_m: f64, wall_m: f64) -> Self {
        let [x, y, z] = [0.5 * inner_size_m[0], 0.5 * inner_size_m[1], inner_size_m[2]];
        let slot = 0.5 * slot_width_m;
        Self::block([-x - wall_m, -y - wall_m, -wall_m], [-slot, y + wall_m, 0.0])
            .and(Self::block([slot, -y - wall_m, -wall_m], [x + wall_m, y + wall_m, 0.0]))
            .and(Self::block([-slot, -y - wall_m, -wall_m], [slot, -y, 0.0]))
            .and(Self::block([-slot, y, -wall_m], [slot, y + wall_m, 0.0]))
            .and(Self::box_walls([x, y, z], wall_m))
    }

    /// Walls of a box by half its length and width and its height, on its floor.
    fn box_walls([x, y, z]: [f64; 3], wall_m: f64) -> Self {
        Self::block([-x - wall_m, -y - wall_m, 0.0], [-x, y + wall_m, z])
            .and(Self::block([x, -y - wall_m, 0.0], [x + wall_m, y + wall_m, z]))
            .and(Self::block([-x, -y - wall_m, 0.0], [x, -y, z]))
            .and(Self::block([-x, y, 0.0], [x, y + wall_m, z]))
    }

    /// Round container without a lid: inner dimensions, origin at the centre of the inner floor.
    #[must_use]
    pub fn open_cylinder(inner_radius_m: f64, inner_height_m: f64, wall_m: f64) -> Self {
        let outer = inner_radius_m + wall_m;
        Self::turned(&[
            [0.0, -wall_m],
            [outer, -wall_m],
            [outer, inner_height_m],
            [inner_radius_m, inner_height_m],
            [inner_radius_m, 0.0],
            [0.0, 0.0],
        ])
    }

    /// The same with a round hole in the middle of the floor.
    #[must_use]
    pub fn silo(inner_radius_m: f64, inner_height_m: f64, outlet_radius_m: f64, wall_m: f64) -> Self {
        let outer = inner_radius_m + wall_m;
        Self::turned(&[
            [outlet_radius_m, -wall_m],
            [outer, -wall_m],
            [outer, inner_height_m],
            [inner_radius_m, inner_height_m],
            [inner_radius_m, 0.0],
            [outlet_radius_m, 0.0],
            [outlet_radius_m, -wall_m],
        ])
    }

    /// Upright round cylinder above a cone whose wall leans by `lean_rad` from the vertical, down to a round hole with its middle at the
    /// origin; where the cone ends at the rim, that alone.
    #[must_use]
    pub fn hopper(
        inner_radius_m: f64,
        inner_height_m: f64,
        outlet_radius_m: f64,
        lean_rad: f64,
        wall_m: f64,
    ) -> Self {
        let (sin, cos) = lean_rad.sin_cos();
        let cone_m = (inner_radius_m - outlet_radius_m) * cos / sin;
        let outer = |radius: f64, height: f64| [radius + wall_m * cos, height - wall_m * sin];
        // Heights are written to some digits.
        let ends_at_rim = inner_height_m <= cone_m * (1.0 + 1e-3);
        let low = (cone_m - wall_m * sin).min(inner_height_m - wall_m);
        let cylinder = [
            [inner_radius_m + wall_m, low],
            [inner_radius_m + wall_m, inner_height_m],
            [inner_radius_m, inner_height_m],
        ];
        let cylinder = cylinder.into_iter().filter(|_| !ends_at_rim);
        let below = [outer(outlet_radius_m, 0.0), outer(inner_radius_m, cone_m)];
        let inside = [[inner_radius_m, cone_m], [outlet_radius_m, 0.0], below[0]];
        Self::turned(&below.into_iter().chain(cylinder).chain(inside).collect::<Vec<_>>())
    }

    /// Upright round pipe that stands on the origin, open at both ends.
    #[must_use]
    pub fn pipe(inner_radius_m: f64, height_m: f64, wall_m: f64) -> Self {
        let outer = inner_radius_m + wall_m;
        Self::turned(&[
            [inner_radius_m, 0.0],
            [outer, 0.0],
            [outer, height_m],
            [inner_radius_m, height_m],
            [inner_radius_m, 0.0],
        ])
    }

    /// Hemispherical shell open towards +z, centre of the sphere at the origin.
    #[must_use]
    pub fn bowl(inner_radius_m: f64, wall_m: f64) -> Self {
        let arc = |radius: f64, ring: usize| {
            let angle = std::f64::consts::FRAC_PI_2 * ring as f64 / RINGS as f64;
            [radius * angle.sin(), -radius * angle.cos()]
        };
        let outside = (0..=RINGS).map(|ring| arc(inner_radius_m + wall_m, ring));
        let inside = (0..=RINGS).rev().map(|ring| arc(inner_radius_m, ring));
        Self::turned(&outside.chain(inside).collect::<Vec<_>>())
    }

    /// Box open at +x and +z, origin at the middle of the inner dimensions' top.
    #[must_use]
    pub fn box_scoop(inner_size_m: [f64; 3], wall_m: f64) -> Self {
        let [x, y, z] = [0.5 * inner_size_m[0], 0.5 * inner_size_m[1], inner_size_m[2]];
        Self::block([-x - wall_m, -y - wall_m, -z - wall_m], [x, y + wall_m, -z])
            .and(Self::block([-x - wall_m, -y - wall_m, -z], [-x, y + wall_m, 0.0]))
            .and(Self::block([-x, -y - wall_m, -z], [x, -y, 0.0]))
            .and(Self::block([-x, y, -z], [x, y + wall_m, 0.0]))
    }

    /// Rod with round ends about the line between two points.
    #[must_use]
    pub fn capsule(from_m: [f64; 3], to_m: [f64; 3], radius_m: f64) -> Self {
        let (from, to) = (Vector3::from(from_m), Vector3::from(to_m));
        let length = (to - from).norm();
        let arc = |ring: usize| {
            let angle = std::f64::consts::FRAC_PI_2 * ring as f64 / RINGS as f64;
            [radius_m * angle.sin(), radius_m * angle.cos()]
        };
        let near = (0..=RINGS).map(|ring| [arc(ring)[0], -arc(ring)[1]]);
        let far = (0..=RINGS).rev().map(|ring| [arc(ring)[0], length + arc(ring)[1]]);
        let along = nalgebra::UnitQuaternion::rotation_between(&Vector3::z(), &(to - from));
        // Only a rod straight down has no shortest rotation.
        let turn = along.unwrap_or_else(|| {
            nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
        });
        Self::turned(&near.chain(far).collect::<Vec<_>>()).moved(&Isometry3::from_parts(from.into(), turn))
    }

    /// A profile of (radius, z), counter-clockwise around the solid with the axis on its left, turned about z.
    fn turned(profile: &[[f64; 2]]) -> Self {
        let point = |side: usize, [radius, z]: [f64; 2]| {
            let angle = std::f64::consts::TAU * side as f64 / SIDES as f64;
            [radius * angle.cos(), radius * angle.sin(), z]
        };
        let points_m = (0..SIDES).flat_map(|side| profile.iter().map(move |at| point(side, *at))).collect();
        let rows = profile.len();
        let at = |side: usize, row: usize| ((side % SIDES) * rows + row) as u32;
        let triangles = (0..SIDES)
            .flat_map(|side| (0..rows - 1).map(move |row| (side, row)))
            .flat_map(|(side, row)| {
                let (a, b) = (at(side, row), at(side, row + 1));
                let (c, d) = (at(side + 1, row), at(side + 1, row + 1));
                [[a, c, d], [a, d, b]]
            })
            // At the axis one of the two has no area.
            .filter(|triangle| !is_flat(&points_of(profile, *triangle, rows)))
            .collect();
        Self { points_m, triangles }
    }

    /// The solid's volume, cubic metres, if the surface is closed.
    #[must_use]
    pub fn volume_m3(&self) -> f64 {
        let corner = |index: u32| Vector3::from(self.points_m[index as usize]);
        self.triangles.iter().map(|[a, b, c]| corner(*a).dot(&corner(*b).cross(&corner(*c))) / 6.0).sum()
    }
}

/// The profile's points under a triangle's corners.
fn points_of(profile: &[[f64; 2]], triangle: [u32; 3], rows: usize) -> [[f64; 2]; 3] {
    triangle.map(|corner| profile[corner as usize % rows])
}

/// Whether two corners are one point on the axis.
fn is_flat(points: &[[f64; 2]; 3]) -> bool {
    let near = |i: usize, j: usize| (points[i][1] - points[j][1]).abs() < 1e-12;
    let on_axis = |i: usize, j: usize| points[i][0].max(points[j][0]) < 1e-12 && near(i, j);
    on_axis(0, 1) || on_axis(1, 2) || on_axis(0, 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;
    use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_4, PI, SQRT_2, TAU};

    /// Each edge is run through once in either direction: closed, and all triangles look outwards or all inwards.
    fn is_closed(mesh: &Mesh) -> bool {
        let corner = |index: u32| mesh.points_m[index as usize].map(|x| (x * 1e9).round() as i64);
        let mut edges: HashMap<_, i32> = HashMap::new();
        for [a, b, c] in &mesh.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                *edges.entry((corner(*from), corner(*to))).or_default() += 1;
                *edges.entry((corner(*to), corner(*from))).or_default() -= 1;
            }
        }
        edges.values().all(|count| *count == 0)
    }

    #[test]
    fn solids_are_closed_and_have_their_volume() {
        // Polygons of 48 sides lie within circles.
        let round = 0.99;
        // By Guldin: a profile's area times the way of its middle.
        let cone = 0.05 * SQRT_2 * TAU * (0.75 + 0.05 * FRAC_1_SQRT_2);
        // The wall between cone and cylinder: of the ring below the cylinder, what the cone has not.
        let below = 0.1 * FRAC_1_SQRT_2;
        let corner = PI * 0.21 * below - 0.5 * below * below * TAU * (1.0 + below / 3.0);
        let cases = [
            (Mesh::block([0.0; 3], [1.0, 2.0, 3.0]), 6.0, 1.0),
            (Mesh::open_box([1.0, 2.0, 3.0], 0.1), 1.2 * 2.2 * 3.1 - 6.0, 1.0),
            (Mesh::box_scoop([1.0, 2.0, 3.0], 0.1), 1.1 * 2.2 * 3.1 - 6.0, 1.0),
            (Mesh::open_cylinder(1.0, 2.0, 0.1), PI * (1.21 * 2.1 - 2.0), round),
            (Mesh::slotted_box([1.0, 2.0, 3.0], 0.4, 0.1), 1.2 * 2.2 * 3.1 - 6.0 - 0.4 * 2.0 * 0.1, 1.0),
            (Mesh::silo(1.0, 2.0, 0.5, 0.1), PI * (1.21 * 2.1 - 2.0 - 0.25 * 0.1), round),
            (Mesh::hopper(1.0, 0.5, 0.5, FRAC_PI_4, 0.1), cone, round),
            (Mesh::hopper(1.0, 1.5, 0.5, FRAC_PI_4, 0.1), cone + PI * 0.21 * 1.0 + corner, round),
            (Mesh::pipe(1.0, 2.0, 0.1), PI * 0.21 * 2.0, round),
            (Mesh::bowl(1.0, 0.1), 2.0 / 3.0 * PI * (1.331 - 1.0), round),
            (Mesh::capsule([1.0, 2.0, 3.0], [1.0, 2.0, 1.0], 0.5), PI * (0.5 + 4.0 / 3.0 * 0.125), 0.98),
        ];
        for (mesh, volume, at_least) in cases {
            assert!(is_closed(&mesh));
            let ratio = mesh.volume_m3() / volume;
            assert!((at_least - 1e-9..1.0 + 1e-9).contains(&ratio), "{ratio}");
        }
    }

    #[test]
    fn capsules_reach_from_end_to_end() {
        let mesh = Mesh::capsule([0.1, 0.0, 0.0], [0.1, 0.3, 0.4], 0.05);
        let reach = |direction: [f64; 3]| {
            let along = |p: &[f64; 3]| p.iter().zip(direction).map(|(a, b)| a * b).sum::<f64>();
            mesh.points_m.iter().map(along).fold(f64::MIN, f64::max)
        };
        assert!((reach([0.0, 0.6, 0.8]) - 0.55).abs() < 1e-9);
        assert!((reach([0.0, -0.6, -0.8]) - 0.05).abs() < 1e-9);
    }
}
