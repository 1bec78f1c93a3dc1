//! The faces of solids: which side of a wall a point is on, and what is behind it.
//!
//! | Solid | Faces, each beside the opposite one |
//! |---|---|
//! | box | high and low x, y, z of its own axes |
//! | tube, disc | outer and inner, top and bottom |
//! | bowl | inner and outer; the rim, which has no opposite |
//!
//! A point is before the face that is nearest, measured along that face's axis: a box's wedges beyond an edge, where two faces
//! would do, are [`Face::EDGE`]. In a solid it is before the face through which it would come out first.
//!
//! A wall's faces are smooth and go on beyond its edges ([`super::Shape::continued`]): a plane, a cylinder, a sphere. Somebody who is
//! before a face does not see what lies in the solid, nor what is before the continuation of the opposite face
//! ([`super::Shape::hides`]).

use crate::real::Real;
use crate::small::{Vec3, three};

/// A face of a solid. Of the first six, `2k` and `2k + 1` are opposite ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Face(u8);

impl Face {
    /// Those that can have an opposite.
    pub(crate) const PAIRED: usize = 6;
    /// The one that has none: a bowl's rim.
    pub(crate) const RIM: Self = Self(6);
    /// Beyond an edge: before no face.
    pub(crate) const EDGE: Self = Self(7);

    /// From what [`super::SignedDistance::face`] gives.
    pub(crate) fn from_number(number: i32) -> Self {
        Self(number as u8)
    }

    pub(crate) fn number(self) -> usize {
        usize::from(self.0)
    }

    pub(crate) fn opposite(self) -> Option<Self> {
        (self.number() < Self::PAIRED).then_some(Self(self.0 ^ 1))
    }

    /// All that a solid can have.
    pub(crate) fn all() -> impl Iterator<Item = Self> {
        (0..=Self::RIM.0).map(Self)
    }

    /// Along which axis a box's face lies, and whether on its low side.
    pub(super) fn of_box(self) -> (usize, bool) {
        (self.number() / 2, !self.0.is_multiple_of(2))
    }
}

/// Number of the face of a box about the origin that a point is before.
#[inline(always)]
pub(super) fn box_face<T: Real>(r: Vec3<T>, half: Vec3<T>) -> i32 {
    let q = three!(k => r[k].abs() - half[k]);
    let outside = three!(k => i32::from(q[k] > T::ZERO));
    let low = three!(k => i32::from(r[k] < T::ZERO));
    let by_yz = if q[1] >= q[2] { 2 + low[1] } else { 4 + low[2] };
    let nearest = if q[0] >= q[1] && q[0] >= q[2] { low[0] } else { by_yz };
    if outside[0] + outside[1] + outside[2] > 1 { i32::from(Face::EDGE.0) } else { nearest }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::mpm::obstacle::{container_shapes, gate_shape};
    use crate::scene::{Container, ContainerShape, Cuboid, Gate, GateOpening, GateShape, Tool, ToolShape};
    use crate::shape::{
        AlignedBox, Bowl, Capsule, Cone, HalfSpace, OrientedBox, Shape, SignedDistance, Tube, with_solid,
    };
    use crate::small::{dot, sub};

    fn point(size: f64) -> impl Strategy<Value = [f64; 3]> {
        [-size..size, -size..size, -size..size]
    }

    /// Every solid that has two sides, about as large as 1.
    fn solid() -> impl Strategy<Value = Shape<f64>> {
        let sizes =
            (point(0.3), [0.05..0.8, 0.05..0.8, 0.05..0.8], [-180.0..180.0, -90.0..90.0, -180.0..180.0]);
        let round = (0.2..0.9f64, 0.02..0.15f64, -0.3..0.3f64, 0.1..0.8f64);
        let lean = 5.0..80.0f64;
        (0usize..6, sizes, round, lean).prop_map(
            |(kind, (centre, half, rotation_deg), (radius, t, height, half_axial), lean)| match kind {
                0 => Shape::AlignedBox(AlignedBox { centre, half }),
                1 => {
                    let axes = Cuboid { centre_m: centre, size_m: half, rotation_deg }.axes();
                    Shape::OrientedBox(OrientedBox { centre, half, axes })
                }
                2 => Shape::Bowl(Bowl { radius, half: t }),
                3 => Shape::Tube(Tube { radius, half_radial: t, height, half_axial }),
                4 => {
                    let lean: [f64; 2] = lean.to_radians().sin_cos().into();
                    // Its lower edge stays clear of the axis.
                    let half_along = half_axial.min(0.6 * (radius - t) / lean[0]);
                    Shape::Cone(Cone { radius, height, half_across: t, half_along, lean })
                }
                _ => Shape::Tube(Tube { radius: 0.0, half_radial: radius, height, half_axial: t }),
            },
        )
    }

    fn between(a: [f64; 3], b: [f64; 3], share: f64) -> [f64; 3] {
        [0, 1, 2].map(|k| a[k] + share * (b[k] - a[k]))
    }

    /// Whether a straight line goes through a solid.
    fn crosses(shape: &Shape<f64>, a: [f64; 3], b: [f64; 3]) -> bool {
        (0..=4000).any(|n| shape.distance_at(between(a, b, f64::from(n) / 4000.0)) < 0.0)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4096))]

        /// Before a face, that face is the nearest surface there is; beyond an edge the edge is, and in a solid the face that
        /// a point is nearest to.
        #[test]
        fn a_face_is_the_nearest_surface(shape in solid(), y in point(1.3)) {
            let (face, (s, n)) = (shape.face_at(y), shape.distance_and_normal_at(y));
            let faces: Vec<_> = Face::all().filter_map(|f| Some((f, shape.continued(f)?))).collect();
            if face == Face::EDGE {
                prop_assert!(s > 0.0);
                prop_assert!(faces.iter().all(|(_, surface)| surface.distance_at(y) < s));
                // Nobody beyond an edge is hidden from, but by the solid.
                prop_assert!(!shape.hides(face, y));
                return Ok(());
            }
            let (own, normal) = shape.continued(face).unwrap().distance_and_normal_at(y);
            if matches!(shape, Shape::Bowl(_)) && face == Face::RIM {
                // The rim is round, its continuation a plane on top of it.
                prop_assert!(own <= s && normal[2] > 1.0 - 1e-12);
            } else {
                // Right on a face the distance is the face's to within a micrometre.
                prop_assert!((own - s).abs() < 2e-6, "{own} {s}");
                prop_assert!(s.abs() < 1e-6 || sub(normal, n).iter().all(|d| d.abs() < 1e-9), "{normal:?} {n:?}");
            }
            prop_assert_eq!(shape.hides(face, y), s <= 0.0);
        }

        /// What is before the opposite face lies behind the wall: no straight line leads there but through it.
        #[test]
        fn between_opposite_faces_there_is_the_wall(shape in solid(), a in point(1.3), b in point(1.3)) {
            let face = shape.face_at(a);
            let mut b = b;
            // Through the hole in the middle there is another way from top to bottom; below a cone's, from inside to outside.
            let in_one_plane = match shape {
                Shape::Tube(_) => (2..4).contains(&face.number()),
                Shape::Cone(_) => true,
                _ => false,
            };
            if in_one_plane {
                let longer = b[0].hypot(b[1]) / a[0].hypot(a[1]);
                (b[0], b[1]) = (longer * a[0], longer * a[1]);
            }
            if face.opposite() == Some(shape.face_at(b)) {
                prop_assert!(crosses(&shape, a, b));
                prop_assert!(shape.hides(face, b));
                // And for those over there it is the other way round.
                let other = shape.face_at(b);
                prop_assert!(shape.hides(other, a) && (shape.distance_at(b) <= 0.0 || !shape.hides(other, b)));
            }
        }

        /// Who is in a silo sees nothing below its floor, but from above the hole what is below it.
        #[test]
        fn a_silo_is_open_where_its_hole_is(
            radius in 0.02..0.1f64, hole in 0.2..0.8f64, t in 0.001..0.02f64, away in 0.0..1.0f64, turn in 0.0..6.0f64,
            above in 0.01..1.0f64, below in 1.01..2.0f64,
        ) {
            let outlet_radius_m = hole * radius;
            let shape = ContainerShape::Silo { inner_radius_m: radius, inner_height_m: 2.0 * radius, outlet_radius_m };
            let container = Container {
                name: String::new(), position_m: [0.0; 3], yaw_deg: 0.0, wall_thickness_m: t, friction: 0.4, shape,
            };
            let pieces = container_shapes(&container);
            let at = |rho: f64, z: f64| [rho * turn.cos(), rho * turn.sin(), z];
            let is_open = |rho: f64| {
                let (from, to) = (at(rho, above * t), at(rho, -below * t));
                pieces.iter().all(|piece| !crosses(piece, from, to) && !piece.hides(piece.face_at(from), to))
            };
            prop_assert!(is_open(outlet_radius_m * 0.99 * away), "through the hole");
            let beside = outlet_radius_m * 1.01 + away * (radius - outlet_radius_m * 1.01);
            prop_assert!(!is_open(beside), "through the floor");
        }

        /// The same of a box and its slot.
        #[test]
        fn a_slotted_box_is_open_where_its_slot_is(
            size in [0.02..0.1f64, 0.02..0.1f64], slot in 0.2..0.8f64, t in 0.001..0.02f64, away in 0.0..1.0f64, across in -0.99..0.99f64,
            above in 0.01..1.0f64, below in 1.01..2.0f64, left in any::<bool>(),
        ) {
            let slot_width_m = slot * size[0];
            let shape = ContainerShape::SlottedBox { inner_size_m: [size[0], size[1], 0.1], slot_width_m };
            let container = Container {
                name: String::new(), position_m: [0.0; 3], yaw_deg: 0.0, wall_thickness_m: t, friction: 0.4, shape,
            };
            let pieces = container_shapes(&container);
            let at = |x: f64, z: f64| [if left { -x } else { x }, 0.5 * across * size[1], z];
            let is_open = |x: f64| {
                let (from, to) = (at(x, above * t), at(x, -below * t));
                pieces.iter().all(|piece| !crosses(piece, from, to) && !piece.hides(piece.face_at(from), to))
            };
            let (edge, wall) = (0.5 * slot_width_m, 0.5 * size[0]);
            prop_assert!(is_open(edge * 0.99 * away), "through the slot");
            prop_assert!(!is_open(edge * 1.01 + away * (wall - edge * 1.01)), "through the floor");
        }

        /// Who is in a hopper's cone sees nothing of what is outside of it at the same height, but what is below the hole.
        #[test]
        fn a_hoppers_cone_parts_inside_and_outside(
            radius in 0.02..0.1f64, hole in 0.2..0.8f64, half_angle_deg in 10.0..75.0f64, t in 0.001..0.02f64,
            cylinder in 0.0..0.05f64, inside in [0.0..0.99f64, 0.02..0.98f64], beyond in 0.01..1.0f64, turn in 0.0..6.0f64,
        ) {
            let outlet_radius_m = hole * radius;
            let shape = |inner_height_m| ContainerShape::Hopper {
                inner_radius_m: radius, inner_height_m, outlet_radius_m, half_angle_deg,
            };
            let top = shape(0.0).cone_height_m();
            let shape = shape(top + cylinder);
            let container = Container {
                name: String::new(), position_m: [0.0; 3], yaw_deg: 0.0, wall_thickness_m: t, friction: 0.4,
                shape: shape.clone(),
            };
            let pieces = container_shapes(&container);
            let at = |rho: f64, z: f64| [rho * turn.cos(), rho * turn.sin(), z];
            let z = inside[1] * top;
            let inner = shape.inner_radius_at_m(z).unwrap();
            let within = at(inside[0] * inner, z);
            prop_assert!(pieces.iter().all(|piece| piece.distance_at(within) > 0.0));
            let cos = half_angle_deg.to_radians().cos();
            let outside = at(inner + (1.0 + beyond) * t / cos, z);
            let hidden = |from: [f64; 3], what| pieces.iter().any(|piece| piece.hides(piece.face_at(from), what));
            // Beside the cone, not below its edge nor above its end.
            let (sin, along) = (half_angle_deg.to_radians().sin(), (1.0 + beyond) * t * half_angle_deg.to_radians().tan());
            let length = top / cos;
            let is_beside = |rho: f64| {
                let up = (rho - outlet_radius_m) * sin + z * cos;
                (0.0..length).contains(&up)
            };
            if is_beside(inside[0] * inner) && is_beside(inner) && inside[1] * length + along < length {
                prop_assert!(hidden(within, outside), "{within:?} {outside:?}");
                prop_assert!(crosses(&pieces[0], within, outside));
            }
            let (above, below) = (at(0.0, z), at(0.5 * outlet_radius_m, -2.0 * t));
            prop_assert!(pieces.iter().all(|piece| !crosses(piece, above, below)), "through the hole");
        }

        /// Along a face its continuation is smooth: a distance with a gradient of length 1, curved no more than the solid.
        #[test]
        fn a_continued_face_is_smooth(shape in solid(), number in 0..7, y in point(1.3), d in point(1.0)) {
            let Some(surface) = shape.continued(Face::from_number(number)) else { return Ok(()) };
            prop_assert!(surface.half_thickness().is_none());
            let (s, n) = surface.distance_and_normal_at(y);
            let near = surface.distance_and_normal_at([0, 1, 2].map(|k| y[k] + 1e-6 * d[k])).0;
            // Not near the axis or the middle, which no surface is.
            let axis = match shape {
                Shape::Bowl(_) => dot(y, y).sqrt(),
                _ => y[0].hypot(y[1]),
            };
            if axis > 0.05 {
                prop_assert!((dot(n, n) - 1.0).abs() < 1e-12);
                prop_assert!((near - s - 1e-6 * dot(n, d)).abs() < 1e-10, "{}", near - s - 1e-6 * dot(n, d));
            }
        }

        /// What bends a surface is the Laplacian of its distance, and that one's slope along the normal.
        #[test]
        fn a_surfaces_bend_is_the_laplacian_of_its_distance(
            shape in solid(), number in 0..7, is_continued in any::<bool>(), y in point(1.3),
        ) {
            let face = shape.face_at(y);
            let continued = shape.continued(Face::from_number(number));
            let surface = if is_continued { continued } else { Some(shape).filter(|_| face < Face::RIM) };
            let Some(surface) = surface else { return Ok(()) };
            let h = 1e-4;
            let moved = |k: usize, by: f64| [0, 1, 2].map(|i| y[i] + by * f64::from(u8::from(i == k)));
            let around: Vec<_> = (0..3).flat_map(|k| [moved(k, h), moved(k, -h)]).collect();
            if y[0].hypot(y[1]) < 0.2 || !is_continued && around.iter().any(|x| shape.face_at(*x) != face) {
                return Ok(());
            }
            let bend = |x| with_solid!(surface, solid => SignedDistance::<f64>::bend(&solid, x));
            let (s, n) = surface.distance_and_normal_at(y);
            let laplacian = around.iter().map(|x| surface.distance_at(*x) - s).sum::<f64>() / (h * h);
            prop_assert!((bend(y)[0] - laplacian).abs() < 1e-4, "{} {laplacian}", bend(y)[0]);
            let [ahead, back] = [h, -h].map(|h| bend([0, 1, 2].map(|k| y[k] + h * n[k]))[0]);
            let slope = (ahead - back) / (2.0 * h);
            prop_assert!((bend(y)[1] - slope).abs() < 1e-4, "{} {slope}", bend(y)[1]);
        }

        /// Whoever is in a container sees nothing of what is outside of its walls below the rim, corners included.
        #[test]
        fn a_container_parts_inside_and_outside(
            round in any::<bool>(), size in [0.02..0.1f64, 0.02..0.1f64, 0.02..0.1f64], t in 0.001..0.02f64,
            inside in point(0.99), other in point(0.99), outside in point(1.0), beyond in 1e-6..1.0f64,
        ) {
            let shape = if round {
                ContainerShape::Cylinder { inner_radius_m: 0.5 * size[0], inner_height_m: size[2] }
            } else {
                ContainerShape::Box { inner_size_m: size }
            };
            let container = Container {
                name: String::new(), position_m: [0.0; 3], yaw_deg: 0.0, wall_thickness_m: t, friction: 0.4, shape,
            };
            let half = if round { [0.5 * size[0]; 2] } else { [0.5 * size[0], 0.5 * size[1]] };
            // How far out, the walls' inner faces being at 1.
            let out = |p: [f64; 3]| if round { p[0].hypot(p[1]) } else { p[0].abs().max(p[1].abs()) };
            let within = |p: [f64; 3]| {
                let shrunk = if round { 0.7 } else { 1.0 };
                [half[0] * shrunk * p[0], half[1] * shrunk * p[1], size[2] * (0.5 + 0.5 * p[2])]
            };
            let (a, also_in) = (within(inside), within(other));
            let b = if outside[2] < -0.5 {
                [half[0] * 1.5 * outside[0], half[1] * 1.5 * outside[1], -t * (1.0 + beyond)]
            } else {
                let far = (1.0 / out(outside).max(1e-9), t * (1.0 + beyond));
                let [x, y] = [0, 1].map(|k| outside[k] * far.0 * (half[k] + far.1));
                [x, y, size[2] * outside[2].abs()]
            };
            let pieces = container_shapes(&container);
            let hidden = |from: [f64; 3], what: [f64; 3]| pieces.iter().any(|piece| piece.hides(piece.face_at(from), what));
            prop_assert!(hidden(a, b), "{a:?} {b:?}");
            prop_assert!(pieces.iter().all(|piece| piece.face_at(a) != Face::EDGE));
            // Nothing in the container is hidden from those in it, nor from whoever is above the rim.
            prop_assert!(!hidden(a, also_in));
            prop_assert!(!hidden([a[0], a[1], size[2] * 1.01], also_in));
        }
    }

    #[test]
    fn tools_and_gates_part_what_is_in_them_from_what_is_not() {
        let wall_thickness_m = 0.003;
        let hidden = |pieces: &[Shape<f64>], from: [f64; 3], what: [f64; 3]| {
            pieces.iter().any(|piece| piece.hides(piece.face_at(from), what))
        };
        let scoop = Tool {
            shape: ToolShape::BoxScoop { inner_size_m: [0.02, 0.016, 0.01] },
            wall_thickness_m,
            ..crate::scene::Scene::load("bench").unwrap().tool.clone()
        };
        let pieces = scoop.solids();
        let inside = [-0.009, 0.007, -0.009];
        for outside in [
            [-0.009, 0.007, -0.0135],
            [-0.009, 0.0115, -0.009],
            [-0.0135, 0.007, -0.009],
            [-0.0135, 0.0115, -0.0135],
        ] {
            assert!(hidden(&pieces, inside, outside), "{outside:?}");
        }
        for outside in [[-0.009, 0.007, -0.0135], [-0.009, 0.0115, -0.009], [-0.0135, 0.007, -0.009]] {
            assert!(hidden(&pieces, outside, inside), "{outside:?}");
        }
        // It is open at the front and on top.
        for outside in [[0.012, 0.0, -0.005], [0.0, 0.0, 0.003]] {
            assert!(!hidden(&pieces, [0.009, 0.0, -0.005], outside), "{outside:?}");
        }
        let bowl = Tool { shape: ToolShape::Bowl { inner_radius_m: 0.016 }, wall_thickness_m, ..scoop };
        let pieces = bowl.solids();
        assert!(hidden(&pieces, [0.0, 0.0, -0.0155], [0.0, 0.0, -0.0195]));
        assert!(hidden(&pieces, [0.0, 0.0195, -0.001], [0.0, 0.0155, -0.001]));
        assert!(!hidden(&pieces, [0.0, 0.015, -0.001], [0.0, 0.0, 0.003]));
        // Over the rim there is a way.
        let (over, beside) = ([0.0, 0.0175, 0.002], [0.0, 0.0205, 0.001]);
        assert!(!hidden(&pieces, over, beside) && !hidden(&pieces, over, [0.0, 0.014, 0.001]));
        let pipe = Gate {
            name: String::new(),
            position_m: [0.0; 3],
            yaw_deg: 0.0,
            friction: 0.4,
            opens_at_s: 0.0,
            shape: GateShape::Tube { inner_radius_m: 0.01, height_m: 0.03, wall_thickness_m },
            opening: GateOpening::Vanish {},
        };
        let pieces = [gate_shape(&pipe)];
        assert!(hidden(&pieces, [0.009, 0.0, 0.01], [0.0135, 0.0, 0.01]));
        assert!(!hidden(&pieces, [0.009, 0.0, 0.032], [0.0, 0.0, 0.01]));
    }

    #[test]
    fn rods_and_half_spaces_have_one_side() {
        let rod = Capsule { from: [0.0; 3], along: [0.0, 0.0, 1.0], radius: 0.1 };
        for shape in [Shape::HalfSpace(HalfSpace), Shape::Capsule(rod)] {
            assert!(Face::all().all(|face| shape.continued(face).is_none()));
            assert!(!shape.has_two_sides());
        }
        assert!(Shape::Bowl(Bowl { radius: 1.0, half: 0.1 }).has_two_sides());
    }
}
