//! The signed distance of what a round face bounds, continued beyond its edges: a ball, a cylinder, or all around them.

use super::signed_distance::{Scalar, SignedDistance, norm3};
use crate::real::Real;
use crate::small::Vec3;

/// A ball about the origin or a cylinder about the z axis, or everything outside of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Round<T> {
    pub(crate) radius: T,
    /// 1 for what is inside, -1 for what is outside.
    pub(crate) sign: T,
    /// 1 for a ball, 0 for a cylinder.
    pub(crate) along_z: T,
}

/// What bends a surface around an axis (1) or in both directions (2), `length` away from the middle.
#[inline(always)]
pub(super) fn bend<T: Real>(length: T, sign: T, directions: T) -> [T; 2] {
    let inverse = T::ONE / length;
    [sign * directions * inverse, -(directions * inverse * inverse)]
}

impl Round<f64> {
    /// The same in another precision.
    pub(super) fn rounded<R: Real>(&self) -> Round<R> {
        let Self { radius, sign, along_z } = *self;
        Round { radius: R::from_f64(radius), sign: R::from_f64(sign), along_z: R::from_f64(along_z) }
    }
}

impl<T: Real> SignedDistance<T> for Round<T> {
    #[inline(always)]
    fn distance<S: Scalar<T>>(&self, y: [S; 3]) -> (S, [S; 3]) {
        let (sign, along_z) = (S::constant(self.sign), S::constant(self.along_z));
        let away = [y[0], y[1], along_z * y[2]];
        let length = norm3::<T, S>(away);
        let scale = sign * length.recip();
        (sign * (length - S::constant(self.radius)), [away[0] * scale, away[1] * scale, away[2] * scale])
    }

    #[inline(always)]
    fn half_thickness(&self) -> Option<T> {
        None
    }

    #[inline(always)]
    fn bend(&self, y: Vec3<T>) -> [T; 2] {
        let length = norm3::<T, T>([y[0], y[1], self.along_z * y[2]]);
        bend(length, self.sign, T::ONE + self.along_z)
    }
}
