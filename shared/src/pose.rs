//! Poses and the rotation group SO(3), bit for bit the same on every machine.
//!
//! | symbol   | identifier        | meaning                                                          |
//! |----------|-------------------|------------------------------------------------------------------|
//! | p        | `position_m`      | origin of the tool in world coordinates                          |
//! | R        | `orientation`     | rotation that takes tool coordinates to world coordinates        |
//! | r        | `rotation_rad`    | rotation vector: unit axis times angle                           |
//! | exp(r)   | [`exp_so3`]       | quaternion (cos(a/2), sin(a/2) r/a), a = norm of r               |
//! | log(q)   | [`log_so3`]       | rotation vector of q with norm at most pi                        |
//!
//! Displacements are expressed in world axes: (dp, dr) takes (p, R) to (p + dp, exp(dr) R).

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Below this angle (rad) sin(a/2)/a is taken from its series, whose next term is then below one part in 10^18.
const SMALL_ANGLE_RAD: f64 = 1e-4;

/// Position and orientation of the tool in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Origin of the tool in world coordinates, metres.
    pub position_m: Vector3<f64>,
    /// Takes tool coordinates to world coordinates.
    pub orientation: UnitQuaternion<f64>,
}

impl Pose {
    /// The tool's axes on the world's axes.
    #[must_use]
    pub fn identity() -> Self {
        Self { position_m: Vector3::zeros(), orientation: UnitQuaternion::identity() }
    }

    /// Whether the numbers are those of a pose: finite, and a unit quaternion to within 1e-9.
    #[must_use]
    pub fn is_proper(&self) -> bool {
        let q = self.orientation;
        let off = libm::sqrt(q.w * q.w + q.i * q.i + q.j * q.j + q.k * q.k) - 1.0;
        // Not a number is not within the tolerance either.
        self.position_m.iter().all(|value| value.is_finite()) && libm::fabs(off) <= 1e-9
    }

    /// a_from_c of `self` = a_from_b and b_from_c.
    #[must_use]
    pub fn then(&self, b_from_c: &Self) -> Self {
        Self {
            position_m: self.world_from_tool(&b_from_c.position_m),
            orientation: renormalised(self.orientation * b_from_c.orientation),
        }
    }

    /// b_from_a of `self` = a_from_b.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self { position_m: self.tool_from_world(&Vector3::zeros()), orientation: self.orientation.inverse() }
    }

    /// World coordinates of a point given in tool coordinates, metres.
    #[must_use]
    pub fn world_from_tool(&self, point_m: &Vector3<f64>) -> Vector3<f64> {
        self.orientation * point_m + self.position_m
    }

    /// Tool coordinates of a point given in world coordinates, metres.
    #[must_use]
    pub fn tool_from_world(&self, point_m: &Vector3<f64>) -> Vector3<f64> {
        self.orientation.inverse() * (point_m - self.position_m)
    }

    /// The pose after a displacement in world axes: (p + dp, exp(dr) R).
    #[must_use]
    pub fn displaced(&self, displacement: &Displacement) -> Self {
        Self {
            position_m: self.position_m + displacement.translation(),
            orientation: renormalised(exp_so3(&displacement.rotation()) * self.orientation),
        }
    }

    /// The displacement in world axes that takes `self` to `next`, inverse of [`Pose::displaced`].
    #[must_use]
    pub fn displacement_to(&self, next: &Self) -> Displacement {
        let rotation = log_so3(&(next.orientation * self.orientation.inverse()));
        Displacement {
            translation_m: (next.position_m - self.position_m).into(),
            rotation_rad: rotation.into(),
        }
    }
}

/// Control of one step: translation and rotation vector, both in world axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Displacement {
    /// Translation, metres.
    pub translation_m: [f64; 3],
    /// Rotation vector (axis times angle), radians.
    pub rotation_rad: [f64; 3],
}

impl Displacement {
    /// Translation as a vector, metres.
    #[must_use]
    pub fn translation(&self) -> Vector3<f64> {
        Vector3::from(self.translation_m)
    }

    /// Rotation vector, radians.
    #[must_use]
    pub fn rotation(&self) -> Vector3<f64> {
        Vector3::from(self.rotation_rad)
    }

    /// The six numbers in the order of `displacement::Axis::ALL`.
    #[must_use]
    pub fn components(&self) -> [f64; 6] {
        let [x, y, z] = self.translation_m;
        let [rx, ry, rz] = self.rotation_rad;
        [x, y, z, rx, ry, rz]
    }
}

impl From<[f64; 6]> for Displacement {
    /// From the six numbers in the order of `displacement::Axis::ALL`.
    fn from([x, y, z, rx, ry, rz]: [f64; 6]) -> Self {
        Self { translation_m: [x, y, z], rotation_rad: [rx, ry, rz] }
    }
}

/// Rotation by `rotation_rad` (axis times angle, radians).
#[must_use]
pub fn exp_so3(rotation_rad: &Vector3<f64>) -> UnitQuaternion<f64> {
    let angle = norm(rotation_rad);
    let half = 0.5 * angle;
    let scale = if angle < SMALL_ANGLE_RAD { 0.5 - angle * angle / 48.0 } else { libm::sin(half) / angle };
    let [x, y, z] = (*rotation_rad).into();
    UnitQuaternion::new_unchecked(Quaternion::new(libm::cos(half), x * scale, y * scale, z * scale))
}

/// Rotation vector (radians) of a rotation, norm at most pi.
///
/// Accurate to rounding everywhere: near zero because the sine, not the cosine, carries the angle; near pi because the
/// axis comes from the quaternion, not from the rotation matrix. At exactly pi both signs of the axis are the same
/// rotation and the stored one is returned.
#[must_use]
pub fn log_so3(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let imaginary = rotation.imag();
    let sine = norm(&imaginary);
    // q and -q are one rotation; the one with w >= 0 has the angle in [0, pi].
    let (cosine, sign) = if rotation.w < 0.0 { (-rotation.w, -1.0) } else { (rotation.w, 1.0) };
    let scale = if sine < 1e-8 { 2.0 / cosine } else { 2.0 * libm::atan2(sine, cosine) / sine };
    imaginary * (sign * scale)
}

/// Euclidean norm in a fixed order of operations.
#[must_use]
pub fn norm(vector: &Vector3<f64>) -> f64 {
    let [x, y, z]: [f64; 3] = (*vector).into();
    libm::sqrt(x * x + y * y + z * z)
}

/// The same rotation with its quaternion brought back to unit length after a product.
#[must_use]
pub fn renormalised(rotation: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let Quaternion { coords } = *rotation.quaternion();
    let [x, y, z, w]: [f64; 4] = coords.into();
    let length = libm::sqrt(w * w + x * x + y * y + z * z);
    UnitQuaternion::new_unchecked(Quaternion::new(w / length, x / length, y / length, z / length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::PI;
    use proptest::prelude::*;

    fn vector(limit: f64) -> impl Strategy<Value = Vector3<f64>> {
        [-limit..limit, -limit..limit, -limit..limit].prop_map(Vector3::from)
    }

    #[test]
    fn numbers_that_are_no_pose_are_known_as_such() {
        let with = |position_m: [f64; 3], [w, x, y, z]: [f64; 4]| Pose {
            position_m: position_m.into(),
            orientation: UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)),
        };
        assert!(with([0.0; 3], [0.5; 4]).is_proper());
        assert!(!with([0.0, f64::NAN, 0.0], [0.5; 4]).is_proper());
        assert!(!with([0.0, f64::INFINITY, 0.0], [0.5; 4]).is_proper());
        assert!(!with([0.0; 3], [f64::NAN, 0.0, 0.0, 1.0]).is_proper());
        assert!(!with([0.0; 3], [0.5, 0.5, 0.5, 0.6]).is_proper());
    }

    #[test]
    fn log_is_exact_near_zero() {
        for exponent in 1..200 {
            let r = Vector3::new(0.6, -0.8, 0.0) * libm::pow(10.0, -f64::from(exponent));
            let back = log_so3(&exp_so3(&r));
            assert!(norm(&(back - r)) <= 4e-16 * norm(&r), "10^-{exponent}: {back} for {r}");
        }
        assert_eq!(log_so3(&exp_so3(&Vector3::zeros())), Vector3::zeros());
    }

    #[test]
    fn log_is_exact_near_pi() {
        for exponent in 0..16 {
            let angle = PI - libm::pow(10.0, -f64::from(exponent));
            let r = Vector3::new(2.0, -3.0, 6.0) / 7.0 * angle;
            let back = log_so3(&exp_so3(&r));
            assert!(norm(&(back - r)) < 2e-15, "pi - 10^-{exponent}: {back} for {r}");
        }
    }

    #[test]
    fn beyond_pi_the_short_way_round_is_returned() {
        let back = log_so3(&exp_so3(&Vector3::new(0.0, 0.0, PI + 0.25)));
        assert!((back.z + PI - 0.25).abs() < 1e-15, "{back}");
    }

    #[test]
    fn bits_are_pinned() {
        let q = exp_so3(&Vector3::new(0.1, -0.7, 1.3));
        assert_eq!(q.w.to_bits(), 0x3fe7_a1e8_5ca7_dc8a);
        let r = log_so3(&(q * q * q));
        assert_eq!(
            r.map(f64::to_bits),
            Vector3::new(0xbfbf_e45d_5438_467b, 0x3feb_e7d1_a9b1_3da7, 0xbff9_e98b_d46d_b942)
        );
    }

    proptest! {
        #[test]
        fn exp_agrees_with_nalgebra(r in vector(3.0)) {
            let difference = exp_so3(&r).angle_to(&UnitQuaternion::from_scaled_axis(r));
            prop_assert!(difference < 1e-7);
        }

        #[test]
        fn exp_of_log_is_the_same_rotation(r in vector(10.0)) {
            let q = exp_so3(&r);
            let back = exp_so3(&log_so3(&q));
            prop_assert!(norm(&log_so3(&(back * q.inverse()))) < 1e-14);
        }

        #[test]
        fn tool_and_world_coordinates_are_inverse(p in vector(2.0), r in vector(1.7), point in vector(1.0)) {
            let pose = Pose { position_m: p, orientation: exp_so3(&r) };
            let back = pose.tool_from_world(&pose.world_from_tool(&point));
            prop_assert!(norm(&(back - point)) < 1e-14);
        }
    }
}
