//! Where the bench is seen from.

use super::V;
use crate::Bench;

/// Nearer than this to the camera nothing is drawn, metres.
const NEAR_M: f32 = 1e-3;

/// Share of the picture that stays empty at each edge.
const MARGIN: f32 = 0.06;

/// A perspective camera that turns about a bench and always has the whole of [`Bench::extent`] in view at zoom 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// 0 looks along +y, from the front; a positive angle moves the camera counter-clockwise seen from above, degrees.
    pub azimuth_deg: f64,
    /// 0 looks horizontally, 90 straight down, degrees.
    pub elevation_deg: f64,
    /// 1 has the whole bench in view, 2 shows the middle twice as large.
    pub zoom: f64,
    /// Angle between the left and the right edge of the picture at zoom 1, degrees; 5 to 120.
    pub field_of_view_deg: f64,
}

impl Default for Camera {
    fn default() -> Self {
        Self { azimuth_deg: 22.0, elevation_deg: 24.0, zoom: 1.0, field_of_view_deg: 30.0 }
    }
}

impl Camera {
    /// Whether every number can be used: finite, a zoom above zero, a field of view of 5 to 120 degrees.
    pub(super) fn is_valid(&self) -> bool {
        self.azimuth_deg.is_finite()
            && (-90.0..=90.0).contains(&self.elevation_deg)
            && (0.01..=1e3).contains(&self.zoom)
            && (5.0..=120.0).contains(&self.field_of_view_deg)
    }

    /// The horizontal axis of the world that points at the camera most.
    pub(super) fn facing(&self) -> V {
        let (sine, cosine) = (self.azimuth_deg.to_radians() as f32).sin_cos();
        if sine.abs() > cosine.abs() {
            V::new(sine.signum(), 0.0, 0.0)
        } else {
            V::new(0.0, -cosine.signum(), 0.0)
        }
    }
}

/// A camera at its place, for a picture of a number of pixels.
#[derive(Clone, Debug)]
pub(super) struct View {
    pub(super) eye: V,
    pub(super) right: V,
    pub(super) up: V,
    pub(super) forward: V,
    /// Pixels that something one metre wide covers one metre away.
    pub(super) focal_px: f32,
    /// Columns and rows.
    pub(super) size_px: [usize; 2],
}

impl View {
    /// The nearest place from which all the points are in the picture, zoom apart.
    pub(super) fn framing(camera: &Camera, size_px: [usize; 2], points_m: &[V]) -> Self {
        let (sin_a, cos_a) = (camera.azimuth_deg.to_radians() as f32).sin_cos();
        let (sin_e, cos_e) = (camera.elevation_deg.to_radians() as f32).sin_cos();
        let right = V::new(cos_a, sin_a, 0.0);
        let forward = V::new(-sin_a * cos_e, cos_a * cos_e, -sin_e);
        let up = right.cross(&forward);
        let tan = 0.5 * (camera.field_of_view_deg.to_radians() as f32);
        let tan = tan.sin() / tan.cos();
        let slope = [tan, tan * size_px[1] as f32 / size_px[0] as f32].map(|tan| tan * (1.0 - 2.0 * MARGIN));
        // A point is in view where |x - eye.x| <= slope (z - eye.z), in the camera's axes; and so for y.
        let limits = |axis: &V, slope: f32| {
            let low = points_m.iter().map(|p| p.dot(axis) + slope * p.dot(&forward)).fold(f32::MAX, f32::min);
            let high =
                points_m.iter().map(|p| p.dot(axis) - slope * p.dot(&forward)).fold(f32::MIN, f32::max);
            (0.5 * (low + high), (low - high) / (2.0 * slope))
        };
        let ((x, back_x), (y, back_y)) = (limits(&right, slope[0]), limits(&up, slope[1]));
        let eye = right * x + up * y + forward * back_x.min(back_y);
        let focal_px = 0.5 * size_px[0] as f32 / tan * camera.zoom as f32;
        Self { eye, right, up, forward, focal_px, size_px }
    }

    /// To the right, up, and away from the camera, metres.
    pub(super) fn local(&self, point_m: &V) -> V {
        let from = point_m - self.eye;
        V::new(from.dot(&self.right), from.dot(&self.up), from.dot(&self.forward))
    }

    /// Column, row and how far away, of a point in the camera's axes that is not behind it.
    pub(super) fn pixel(&self, local_m: &V) -> Option<[f32; 3]> {
        let scale = self.focal_px / local_m.z;
        let [middle_x, middle_y] = self.size_px.map(|size| 0.5 * size as f32);
        // Not-a-number is not in view either.
        (local_m.z > NEAR_M).then(|| [middle_x + local_m.x * scale, middle_y - local_m.y * scale, local_m.z])
    }

    /// From the camera through the middle of a pixel, as far as one metre away along `forward`; the camera's axes.
    pub(super) fn ray(&self, column: usize, row: usize) -> V {
        let [middle_x, middle_y] = self.size_px.map(|size| 0.5 * size as f32);
        V::new(
            (column as f32 + 0.5 - middle_x) / self.focal_px,
            (middle_y - row as f32 - 0.5) / self.focal_px,
            1.0,
        )
    }

    /// A direction of the camera's axes, in the world's.
    pub(super) fn world(&self, local: &V) -> V {
        self.right * local.x + self.up * local.y + self.forward * local.z
    }
}

/// What has to be in view at zoom 1.
pub(super) fn corners(bench: &Bench) -> Vec<V> {
    bench.extent.corners().map(|corner| V::from(corner.map(|x| x as f32))).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::sample::bench;

    #[test]
    fn the_whole_bench_is_in_view_from_everywhere() {
        let size_px = [320, 240];
        for azimuth_deg in [-170.0, -45.0, 0.0, 22.0, 90.0] {
            for elevation_deg in [-90.0, 0.0, 24.0, 90.0] {
                let camera = Camera { azimuth_deg, elevation_deg, ..Camera::default() };
                let view = View::framing(&camera, size_px, &corners(&bench()));
                let pixels = corners(&bench()).into_iter().map(|corner| view.pixel(&view.local(&corner)));
                for [x, y, _] in pixels.map(|pixel| pixel.expect("before the camera")) {
                    assert!((0.0..320.0).contains(&x) && (0.0..240.0).contains(&y), "{camera:?}: {x}, {y}");
                }
            }
        }
    }

    #[test]
    fn a_ray_goes_through_its_pixel() {
        let view = View::framing(&Camera::default(), [320, 240], &corners(&bench()));
        let [x, y, depth_m] = view.pixel(&(view.ray(17, 200) * 2.0)).expect("before the camera");
        assert!((x - 17.5).abs() < 1e-3 && (y - 200.5).abs() < 1e-3 && (depth_m - 2.0).abs() < 1e-6);
    }
}
