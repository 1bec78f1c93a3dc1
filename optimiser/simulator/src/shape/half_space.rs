//! The signed distance of all that lies below a plane.

use super::signed_distance::{Scalar, SignedDistance};
use crate::real::Real;

/// Everything below `z = 0`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HalfSpace;

impl<T: Real> SignedDistance<T> for HalfSpace {
    #[inline(always)]
    fn distance<S: Scalar<T>>(&self, y: [S; 3]) -> (S, [S; 3]) {
        (y[2], [S::constant(T::ZERO), S::constant(T::ZERO), S::constant(T::ONE)])
    }

    #[inline(always)]
    fn half_thickness(&self) -> Option<T> {
        None
    }
}
