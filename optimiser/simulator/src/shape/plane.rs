//! The signed distance of all that lies below a plane anywhere: a flat face, continued beyond its edges.

use super::signed_distance::{Scalar, SignedDistance};
use crate::real::Real;
use crate::small::{Vec3, three};

/// Everything below `normal . y = offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Plane<T> {
    /// Outwards, of length 1.
    pub(crate) normal: Vec3<T>,
    pub(crate) offset: T,
}

impl<T: Real> Plane<T> {
    /// Across the axis `k`, the solid lying below it, or above it.
    #[inline(always)]
    pub(super) fn across(k: usize, at: T, solid_is_above: bool) -> Self {
        let sign = if solid_is_above { -T::ONE } else { T::ONE };
        Self { normal: three!(i => sign.only_if(i == k)), offset: sign * at }
    }
}

impl Plane<f64> {
    /// The same in another precision.
    pub(super) fn rounded<R: Real>(&self) -> Plane<R> {
        Plane { normal: self.normal.map(R::from_f64), offset: R::from_f64(self.offset) }
    }
}

impl<T: Real> SignedDistance<T> for Plane<T> {
    #[inline(always)]
    fn distance<S: Scalar<T>>(&self, y: [S; 3]) -> (S, [S; 3]) {
        let normal = three!(i => S::constant(self.normal[i]));
        let along = normal[0] * y[0] + normal[1] * y[1] + normal[2] * y[2];
        (along - S::constant(self.offset), normal)
    }

    #[inline(always)]
    fn half_thickness(&self) -> Option<T> {
        None
    }
}
