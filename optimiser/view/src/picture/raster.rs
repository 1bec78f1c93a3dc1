//! Which surface is nearest to the camera in each pixel.

use super::V;
use super::camera::View;
use super::facet::Facet;

/// Share of its depth by which a wall may seem to lie below the floor on which it stands.
const ON_FLOOR: f32 = 1e-4;

/// What a surface is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Finish {
    /// Nothing is there.
    Empty,
    /// What is seen of the floor is its shadows.
    Floor,
    /// Scatters light.
    Matt,
    /// Scatters and reflects it.
    Metal,
}

/// The nearest surface in a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Texel {
    /// Along the camera's axis, metres.
    pub(super) depth_m: f32,
    /// World frame, away from the surface.
    pub(super) normal: V,
    /// Colour in white light, linear.
    pub(super) albedo: [f32; 3],
    pub(super) finish: Finish,
}

/// The nearest surface in every pixel, row by row from the top.
#[derive(Clone)]
pub(super) struct Canvas<'a> {
    pub(super) view: &'a View,
    pub(super) texels: Vec<Texel>,
}

impl<'a> Canvas<'a> {
    /// A floor at a height and nothing on it.
    pub(super) fn floor(view: &'a View, height_m: f32) -> Self {
        let [columns, rows] = view.size_px;
        let texel = |index: usize| {
            let ray = view.world(&view.ray(index % columns, index / columns));
            let depth_m = (height_m - view.eye.z) / ray.z;
            let finish = if depth_m > 0.0 && depth_m.is_finite() { Finish::Floor } else { Finish::Empty };
            let depth_m = if finish == Finish::Floor { depth_m } else { f32::INFINITY };
            Texel { depth_m, normal: V::z(), albedo: [0.0; 3], finish }
        };
        Self { view, texels: (0..columns * rows).map(texel).collect() }
    }

    /// Draws a matt sphere where nothing is nearer.
    ///
    /// A pixel's ray is `t d` with `d.z = 1`, so `t` is the depth. The ray's point nearest to the centre is found
    /// first, as the textbook's discriminant would lose all digits of a sphere as small as a grain.
    pub(super) fn sphere(&mut self, centre_m: &V, radius_m: f32, albedo: [f32; 3]) {
        let centre = self.view.local(centre_m);
        let Some([x, y, depth_m]) = self.view.pixel(&centre) else { return };
        // At the edge of a wide picture a sphere is drawn longer than it is.
        let stretch = length_ratio(&centre) * depth_m / (depth_m - radius_m).max(0.1 * depth_m);
        let reach = self.view.focal_px * radius_m / depth_m * stretch * stretch + 1.0;
        let Some([columns, rows]) = span([[x - reach, x + reach], [y - reach, y + reach]], self.view.size_px)
        else {
            return;
        };
        for row in rows[0]..rows[1] {
            for column in columns[0]..columns[1] {
                let ray = self.view.ray(column, row);
                let along = ray.dot(&ray);
                let nearest = ray.dot(&centre) / along;
                let aside = ray * nearest - centre;
                let inside = radius_m * radius_m - aside.dot(&aside);
                let texel = &mut self.texels[row * self.view.size_px[0] + column];
                let depth_m = nearest - (inside / along).sqrt();
                if inside > 0.0 && depth_m < texel.depth_m {
                    let normal = self.view.world(&((ray * depth_m - centre) / radius_m));
                    *texel = Texel { depth_m, normal, albedo, finish: Finish::Matt };
                }
            }
        }
    }

    /// Draws triangles where nothing is nearer; what `keep` refuses by its place and side stays out.
    pub(super) fn solid(&mut self, facets: &[Facet], albedo: [f32; 3], finish: Finish) {
        let view = self.view;
        for facet in facets {
            fragments(view, facet, |fragment| {
                let texel = &mut self.texels[fragment.pixel];
                if fragment.depth_m < texel.depth_m && fragment.is_front(view) {
                    *texel = Texel { depth_m: fragment.depth_m, normal: fragment.normal, albedo, finish };
                }
            });
        }
    }

    /// Draws half a hollow solid, cut open at a plane through `middle_m` with the normal `facing`. The underside of one
    /// that stands on the floor is as far away as the floor: it covers the floor, whatever rounding says.
    pub(super) fn cut(&mut self, facets: &[Facet], middle_m: &V, facing: &V, colours: [[f32; 3]; 2]) {
        let view = self.view;
        for facet in facets {
            fragments(view, facet, |fragment| {
                let texel = &mut self.texels[fragment.pixel];
                let nearer = if texel.finish == Finish::Floor { 1.0 - ON_FLOOR } else { 1.0 };
                if fragment.depth_m * nearer >= texel.depth_m
                    || (fragment.point_m - middle_m).dot(facing) > 0.0
                {
                    return;
                }
                // The inside of a wall is seen through the cut only: it is drawn as the cut.
                let (normal, albedo) = if fragment.is_front(view) {
                    (fragment.normal, colours[0])
                } else {
                    (*facing, colours[1])
                };
                *texel = Texel { depth_m: fragment.depth_m, normal, albedo, finish: Finish::Matt };
            });
        }
    }
}

/// A triangle in one pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fragment {
    pub(super) pixel: usize,
    pub(super) depth_m: f32,
    pub(super) point_m: V,
    pub(super) normal: V,
    /// To the nearest fold of the surface, pixels.
    pub(super) to_crease_px: f32,
}

impl Fragment {
    /// Whether the surface's outer side is seen.
    pub(super) fn is_front(&self, view: &View) -> bool {
        self.normal.dot(&(self.point_m - view.eye)) < 0.0
    }
}

/// Calls `plot` for every pixel whose middle a triangle covers. A triangle that reaches behind the camera is not drawn.
pub(super) fn fragments(view: &View, facet: &Facet, mut plot: impl FnMut(Fragment)) {
    let [Some(a), Some(b), Some(c)] = facet.corners.map(|corner| view.pixel(&view.local(&corner))) else {
        return;
    };
    covered([a, b, c], view.size_px, |column, row, share, to_edge_px| {
        // What is straight in space is straight in the picture as 1 / depth.
        let weights = [share[0] / a[2], share[1] / b[2], share[2] / c[2]];
        let depth_m = 1.0 / (weights[0] + weights[1] + weights[2]);
        let mix = |values: &[V; 3]| {
            (values[0] * weights[0] + values[1] * weights[1] + values[2] * weights[2]) * depth_m
        };
        let distance = |edge: usize| if facet.creases[edge] { to_edge_px[edge] } else { f32::INFINITY };
        plot(Fragment {
            pixel: row * view.size_px[0] + column,
            depth_m,
            point_m: mix(&facet.corners),
            normal: super::facet::unit(&mix(&facet.normals)),
            to_crease_px: distance(0).min(distance(1)).min(distance(2)),
        });
    });
}

/// Calls `plot` with column, row, the share that each corner has in it, and the distance to each corner's opposite edge,
/// for every pixel whose middle lies in a triangle given by x and y.
pub(super) fn covered(
    corners: [[f32; 3]; 3],
    size_px: [usize; 2],
    mut plot: impl FnMut(usize, usize, [f32; 3], [f32; 3]),
) {
    let bounds = [0, 1].map(|axis| {
        let values = corners.map(|corner| corner[axis]);
        [values[0].min(values[1]).min(values[2]), values[0].max(values[1]).max(values[2])]
    });
    let side = |from: [f32; 3], to: [f32; 3], x: f32, y: f32| {
        (to[0] - from[0]) * (y - from[1]) - (to[1] - from[1]) * (x - from[0])
    };
    let [a, b, c] = corners;
    let area = side(a, b, c[0], c[1]);
    let Some([columns, rows]) = span(bounds, size_px) else { return };
    // Not-a-number is no area.
    if area.is_nan() || area.abs() <= 0.0 {
        return;
    }
    let length = |from: [f32; 3], to: [f32; 3]| {
        let [x, y] = [to[0] - from[0], to[1] - from[1]];
        (x * x + y * y).sqrt()
    };
    let heights = [length(b, c), length(c, a), length(a, b)].map(|length| area.abs() / length);
    for row in rows[0]..rows[1] {
        for column in columns[0]..columns[1] {
            let (x, y) = (column as f32 + 0.5, row as f32 + 0.5);
            let share = [side(b, c, x, y), side(c, a, x, y), side(a, b, x, y)].map(|value| value / area);
            if share.iter().all(|share| *share >= 0.0) {
                plot(column, row, share, [0, 1, 2].map(|edge| share[edge] * heights[edge]));
            }
        }
    }
}

/// The columns and rows, first and one past the last, that an interval of x and one of y reach; if there are any.
fn span(bounds: [[f32; 2]; 2], size_px: [usize; 2]) -> Option<[[usize; 2]; 2]> {
    let clipped = |[low, high]: [f32; 2], size: usize| {
        // Conversion to whole numbers saturates, and takes not-a-number to 0.
        [(low.floor() as usize).min(size), (high.ceil() as usize).min(size)]
    };
    let spans = [clipped(bounds[0], size_px[0]), clipped(bounds[1], size_px[1])];
    spans.iter().all(|[first, end]| first < end).then_some(spans)
}

/// How much longer the way to a point is than its depth.
fn length_ratio(local_m: &V) -> f32 {
    super::facet::length(local_m) / local_m.z
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::Camera;

    /// Corners of the unit square in pixels, cut into two triangles along a diagonal.
    #[test]
    fn two_triangles_cover_a_square_without_gap_or_pixel_outside() {
        let corner = |x, y| [x, y, 1.0];
        let square = [corner(2.0, 3.0), corner(12.0, 3.0), corner(12.0, 10.0), corner(2.0, 10.0)];
        let mut seen = vec![false; 16 * 16];
        for triangle in [[0, 1, 2], [0, 2, 3]] {
            covered(triangle.map(|index| square[index]), [16, 16], |column, row, share, _| {
                assert!((share.iter().sum::<f32>() - 1.0).abs() < 1e-5);
                seen[row * 16 + column] = true;
            });
        }
        for (index, seen) in seen.iter().enumerate() {
            let expected = (2..12).contains(&(index % 16)) && (3..10).contains(&(index / 16));
            assert_eq!(*seen, expected, "column {}, row {}", index % 16, index / 16);
        }
    }

    #[test]
    fn the_nearer_of_a_sphere_and_a_triangle_wins() {
        let points = [V::zeros(), V::new(1.0, 1.0, 1.0)];
        let view = View::framing(&Camera::default(), [65, 65], &points);
        let middle = 32 * 65 + 32;
        let at = |depth_m: f32| view.eye + view.forward * depth_m;
        let corner = |right: f32, up: f32| at(1.0) + view.right * right + view.up * up;
        let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(0.0, 1.0)];
        let facet = Facet { corners, normals: [-view.forward; 3], creases: [false; 3] };
        for (depth_m, expected_m, finish) in [(0.5, 0.4, Finish::Matt), (2.0, 1.0, Finish::Metal)] {
            for sphere_first in [true, false] {
                let mut canvas = Canvas::floor(&view, 0.0);
                for draws_sphere in [sphere_first, !sphere_first] {
                    if draws_sphere {
                        canvas.sphere(&at(depth_m), 0.1, [1.0, 0.0, 0.0]);
                    } else {
                        canvas.solid(std::slice::from_ref(&facet), [0.0, 1.0, 0.0], Finish::Metal);
                    }
                }
                let texel = &canvas.texels[middle];
                assert_eq!(texel.finish, finish);
                assert!((texel.depth_m - expected_m).abs() < 1e-4, "{} m", texel.depth_m);
            }
        }
    }
}
