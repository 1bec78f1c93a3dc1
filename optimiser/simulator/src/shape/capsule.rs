//! The signed distance of a rod with round ends.

use super::signed_distance::{Scalar, SignedDistance, norm3};
use crate::real::Real;
use crate::small::{Vec3, three};

/// Rod with round ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Capsule<T> {
    /// One end of the axis.
    pub(crate) from: Vec3<T>,
    /// From that end to the other.
    pub(crate) along: Vec3<T>,
    pub(crate) radius: T,
}

impl Capsule<f64> {
    /// The same in another precision.
    pub(super) fn rounded<R: Real>(&self) -> Capsule<R> {
        Capsule {
            from: self.from.map(R::from_f64),
            along: self.along.map(R::from_f64),
            radius: R::from_f64(self.radius),
        }
    }
}

impl<T: Real> SignedDistance<T> for Capsule<T> {
    #[inline(always)]
    fn distance<S: Scalar<T>>(&self, y: [S; 3]) -> (S, [S; 3]) {
        let r = three!(i => y[i] - S::constant(self.from[i]));
        let axis = three!(i => S::constant(self.along[i]));
        let inverse = S::constant(T::ONE / crate::small::dot(self.along, self.along));
        let part = (r[0] * axis[0] + r[1] * axis[1] + r[2] * axis[2]) * inverse;
        let part = S::select(part.value() > T::ONE, S::constant(T::ONE), part.positive_part());
        let away = three!(i => r[i] - part * axis[i]);
        let length = norm3::<T, S>(away);
        let scale = length.recip();
        (length - S::constant(self.radius), three!(i => away[i] * scale))
    }

    #[inline(always)]
    fn half_thickness(&self) -> Option<T> {
        Some(self.radius)
    }
}
