//! The signed distance of a tube, or a disc.

use super::face::box_face;
use super::round::bend;
use super::signed_distance::{Scalar, SignedDistance, norm2};
use super::slab::slab;
use super::{Face, Plane, Round, Shape};
use crate::real::Real;
use crate::small::Vec3;

/// Solid of revolution about z with a rectangular profile: a tube, or a disc when `radius` is zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Tube<T> {
    /// Middle radius of the profile.
    pub(crate) radius: T,
    /// Half extent of the profile in the radial direction.
    pub(crate) half_radial: T,
    /// Middle height of the profile.
    pub(crate) height: T,
    /// Half extent of the profile along z.
    pub(crate) half_axial: T,
}

impl Tube<f64> {
    /// The same in another precision.
    pub(super) fn rounded<R: Real>(&self) -> Tube<R> {
        Tube {
            radius: R::from_f64(self.radius),
            half_radial: R::from_f64(self.half_radial),
            height: R::from_f64(self.height),
            half_axial: R::from_f64(self.half_axial),
        }
    }
}

impl<T: Real> SignedDistance<T> for Tube<T> {
    #[inline(always)]
    fn distance<S: Scalar<T>>(&self, y: [S; 3]) -> (S, [S; 3]) {
        let rho = norm2::<T, S>(y[0], y[1]);
        let flat = [rho - S::constant(self.radius), y[2] - S::constant(self.height), S::constant(T::ZERO)];
        let (distance, profile) =
            slab(flat, [T::ZERO; 3], [self.half_radial, self.half_axial, T::from_f64(1e9)]);
        let across = profile[0] * rho.recip();
        (distance, [y[0] * across, y[1] * across, profile[1]])
    }

    #[inline(always)]
    fn half_thickness(&self) -> Option<T> {
        Some(self.half_radial.at_most(self.half_axial))
    }

    #[inline(always)]
    fn bend(&self, y: Vec3<T>) -> [T; 2] {
        let rho = norm2::<T, T>(y[0], y[1]);
        let is_round = self.face(y) < 2;
        let sign = if rho < self.radius { -T::ONE } else { T::ONE };
        bend(rho, sign, T::ONE).map(|bend| bend.only_if(is_round))
    }

    /// Outer and inner, top and bottom.
    #[inline(always)]
    fn face(&self, y: Vec3<T>) -> i32 {
        let rho = norm2::<T, T>(y[0], y[1]);
        let flat = [rho - self.radius, y[2] - self.height, T::ZERO];
        box_face(flat, [self.half_radial, self.half_axial, T::from_f64(1e9)])
    }

    fn continued(&self, face: Face) -> Option<Shape<T>> {
        let inner = self.radius - self.half_radial;
        let round = |radius, sign| Shape::Round(Round { radius, sign, along_z: T::ZERO });
        match face.number() {
            0 => Some(round(self.radius + self.half_radial, T::ONE)),
            // A disc has none.
            1 => (inner > T::ZERO).then(|| round(inner, -T::ONE)),
            2 => Some(Shape::Plane(Plane::across(2, self.height + self.half_axial, false))),
            3 => Some(Shape::Plane(Plane::across(2, self.height - self.half_axial, true))),
            _ => None,
        }
    }
}
