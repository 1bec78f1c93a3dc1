//! The signed distance of a box along the axes of its frame.

use super::face::box_face;
use super::signed_distance::{Scalar, SignedDistance};
use super::slab::slab;
use super::{Face, Plane, Shape};
use crate::real::Real;
use crate::small::{Vec3, sub};

/// Box centred at `centre`, with half edges `half`. Lengths in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AlignedBox<T> {
    pub(crate) centre: Vec3<T>,
    pub(crate) half: Vec3<T>,
}

impl AlignedBox<f64> {
    /// The same in another precision.
    pub(super) fn rounded<R: Real>(&self) -> AlignedBox<R> {
        AlignedBox { centre: self.centre.map(R::from_f64), half: self.half.map(R::from_f64) }
    }
}

impl<T: Real> SignedDistance<T> for AlignedBox<T> {
    #[inline(always)]
    fn distance<S: Scalar<T>>(&self, y: [S; 3]) -> (S, [S; 3]) {
        slab(y, self.centre, self.half)
    }

    #[inline(always)]
    fn half_thickness(&self) -> Option<T> {
        Some(self.half[0].at_most(self.half[1]).at_most(self.half[2]))
    }

    #[inline(always)]
    fn face(&self, y: Vec3<T>) -> i32 {
        box_face(sub(y, self.centre), self.half)
    }

    fn continued(&self, face: Face) -> Option<Shape<T>> {
        let (k, low) = face.of_box();
        let (centre, half) = (*self.centre.get(k)?, self.half[k]);
        Some(Shape::Plane(Plane::across(k, if low { centre - half } else { centre + half }, low)))
    }
}
