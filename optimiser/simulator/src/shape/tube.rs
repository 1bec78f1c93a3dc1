//! The signed distance of a tube, or a disc.

use super::signed_distance::{Scalar, SignedDistance, norm2};
use super::slab::slab;
use crate::real::Real;

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
}
