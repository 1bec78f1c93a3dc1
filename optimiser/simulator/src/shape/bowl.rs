//! The signed distance of a hemispherical shell.

use super::round::bend;
use super::signed_distance::{Scalar, SignedDistance, norm2, norm3};
use super::{Face, Plane, Round, Shape};
use crate::real::Real;
use crate::small::Vec3;

/// Hemispherical shell, open towards +z, centre of the sphere at the origin, rim rounded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bowl<T> {
    /// Radius of the shell's middle surface.
    pub(crate) radius: T,
    /// Half the wall thickness.
    pub(crate) half: T,
}

impl Bowl<f64> {
    /// The same in another precision.
    pub(super) fn rounded<R: Real>(&self) -> Bowl<R> {
        Bowl { radius: R::from_f64(self.radius), half: R::from_f64(self.half) }
    }
}

impl<T: Real> SignedDistance<T> for Bowl<T> {
    /// Below the rim the shell of the sphere; above the rim plane the nearest point lies on the rim circle.
    #[inline(always)]
    fn distance<S: Scalar<T>>(&self, y: [S; 3]) -> (S, [S; 3]) {
        let r = S::constant(self.radius);
        let rho = norm2::<T, S>(y[0], y[1]);
        let length = norm3::<T, S>(y);
        let below = y[2].value() <= T::ZERO;
        // Below the rim the normal is radial, away from the middle surface.
        let gap = length - r;
        let side = S::constant(if gap.value() < T::ZERO { -T::ONE } else { T::ONE });
        let radial = side * length.recip();
        // Above, it points away from the rim circle.
        let to_rim = rho - r;
        let rim = norm2::<T, S>(to_rim, y[2]);
        let inverse = rim.recip();
        let across = to_rim * inverse * rho.recip();
        let distance = S::select(below, gap.abs(), rim) - S::constant(self.half);
        let normal = [
            S::select(below, y[0] * radial, y[0] * across),
            S::select(below, y[1] * radial, y[1] * across),
            S::select(below, y[2] * radial, y[2] * inverse),
        ];
        (distance, normal)
    }

    #[inline(always)]
    fn half_thickness(&self) -> Option<T> {
        Some(self.half)
    }

    #[inline(always)]
    fn bend(&self, y: Vec3<T>) -> [T; 2] {
        let length = norm3::<T, T>(y);
        let sign = if length < self.radius { -T::ONE } else { T::ONE };
        bend(length, sign, T::from_f64(2.0)).map(|bend| bend.only_if(y[2] <= T::ZERO))
    }

    /// Inner and outer, and on top of the rim.
    #[inline(always)]
    fn face(&self, y: Vec3<T>) -> i32 {
        let outer = norm3::<T, T>(y) > self.radius;
        let over_rim = (norm2::<T, T>(y[0], y[1]) - self.radius).abs() <= self.half;
        let above = (if over_rim { Face::RIM } else { Face::EDGE }).number() as i32;
        if y[2] > T::ZERO { above } else { i32::from(outer) }
    }

    fn continued(&self, face: Face) -> Option<Shape<T>> {
        let round = |radius, sign| Shape::Round(Round { radius, sign, along_z: T::ONE });
        match face.number() {
            0 => Some(round(self.radius - self.half, -T::ONE)),
            1 => Some(round(self.radius + self.half, T::ONE)),
            _ => (face == Face::RIM).then(|| Shape::Plane(Plane::across(2, self.half, false))),
        }
    }
}
