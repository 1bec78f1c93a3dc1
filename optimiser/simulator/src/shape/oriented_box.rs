//! The signed distance of a box that is turned.

use super::face::box_face;
use super::signed_distance::{Scalar, SignedDistance};
use super::slab::slab;
use super::{Face, Plane, Shape};
use crate::real::Real;
use crate::small::{Mat3, Vec3, dot, mul_vec, scale, sub, three};

/// A box that is turned: its axes are the rows of `axes`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct OrientedBox<T> {
    pub(crate) centre: Vec3<T>,
    pub(crate) half: Vec3<T>,
    pub(crate) axes: Mat3<T>,
}

impl OrientedBox<f64> {
    /// The same in another precision.
    pub(super) fn rounded<R: Real>(&self) -> OrientedBox<R> {
        OrientedBox {
            centre: self.centre.map(R::from_f64),
            half: self.half.map(R::from_f64),
            axes: self.axes.map(|axis| axis.map(R::from_f64)),
        }
    }
}

impl<T: Real> SignedDistance<T> for OrientedBox<T> {
    #[inline(always)]
    fn distance<S: Scalar<T>>(&self, y: [S; 3]) -> (S, [S; 3]) {
        let axis = |k: usize, i: usize| S::constant(self.axes[k][i]);
        let r = three!(i => y[i] - S::constant(self.centre[i]));
        let own = three!(k => axis(k, 0) * r[0] + axis(k, 1) * r[1] + axis(k, 2) * r[2]);
        let (distance, n) = slab(own, [T::ZERO; 3], self.half);
        (distance, three!(i => axis(0, i) * n[0] + axis(1, i) * n[1] + axis(2, i) * n[2]))
    }

    #[inline(always)]
    fn half_thickness(&self) -> Option<T> {
        Some(self.half[0].at_most(self.half[1]).at_most(self.half[2]))
    }

    #[inline(always)]
    fn face(&self, y: Vec3<T>) -> i32 {
        box_face(mul_vec(&self.axes, sub(y, self.centre)), self.half)
    }

    fn continued(&self, face: Face) -> Option<Shape<T>> {
        let (k, low) = face.of_box();
        let normal = scale(if low { -T::ONE } else { T::ONE }, *self.axes.get(k)?);
        Some(Shape::Plane(Plane { normal, offset: dot(normal, self.centre) + self.half[k] }))
    }
}
