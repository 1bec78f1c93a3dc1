//! Signed distances of tools and containers, with normals and with the second derivatives that the adjoint
//! of contact needs. One file per solid.
//!
//! A distance is written once, generic over the scalar. With [`Dual`] numbers the same code gives the
//! derivative of the normal in a direction, that is the product of the (symmetric) Hessian with a vector.
//!
//! Solids with walls have faces, on either side of them: see [`face`].

mod aligned_box;
mod bowl;
mod capsule;
mod cone;
mod face;
mod half_space;
mod oriented_box;
mod plane;
mod round;
mod signed_distance;
mod slab;
mod tube;

use crate::real::Real;
use crate::small::Vec3;

pub(crate) use aligned_box::AlignedBox;
pub(crate) use bowl::Bowl;
pub(crate) use capsule::Capsule;
pub(crate) use cone::{Cone, Slope};
pub(crate) use face::Face;
pub(crate) use half_space::HalfSpace;
pub(crate) use oriented_box::OrientedBox;
pub(crate) use plane::Plane;
pub(crate) use round::Round;
pub(crate) use signed_distance::{Dual, SignedDistance};
pub(crate) use tube::Tube;

/// Any of the solids, and what a face of one bounds if it goes on beyond its edges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Shape<T> {
    HalfSpace(HalfSpace),
    AlignedBox(AlignedBox<T>),
    Bowl(Bowl<T>),
    Tube(Tube<T>),
    Capsule(Capsule<T>),
    OrientedBox(OrientedBox<T>),
    Plane(Plane<T>),
    Round(Round<T>),
    Cone(Cone<T>),
    Slope(Slope<T>),
}

/// Runs `$body` with `$solid` bound to the concrete solid inside a [`Shape`], so that a loop over lanes in
/// it is compiled for that solid alone.
macro_rules! with_solid {
    ($shape:expr, $solid:ident => $body:expr) => {
        match $shape {
            $crate::shape::Shape::HalfSpace($solid) => $body,
            $crate::shape::Shape::AlignedBox($solid) => $body,
            $crate::shape::Shape::Bowl($solid) => $body,
            $crate::shape::Shape::Tube($solid) => $body,
            $crate::shape::Shape::Capsule($solid) => $body,
            $crate::shape::Shape::OrientedBox($solid) => $body,
            $crate::shape::Shape::Plane($solid) => $body,
            $crate::shape::Shape::Round($solid) => $body,
            $crate::shape::Shape::Cone($solid) => $body,
            $crate::shape::Shape::Slope($solid) => $body,
        }
    };
}
pub(crate) use with_solid;

impl<T: Real> Shape<T> {
    /// Half the wall thickness; none for what has no second side.
    pub(crate) fn half_thickness(&self) -> Option<T> {
        with_solid!(*self, solid => SignedDistance::<T>::half_thickness(&solid))
    }

    /// Whether there are faces on opposite sides of it.
    pub(crate) fn has_two_sides(&self) -> bool {
        Face::all().any(|face| self.continued(face).is_some())
    }

    /// What a face bounds if it goes on beyond its edges; none if there is no such face.
    pub(crate) fn continued(&self, face: Face) -> Option<Self> {
        with_solid!(*self, solid => SignedDistance::<T>::continued(&solid, face))
    }
}

impl Shape<f64> {
    /// The same in the precision of a simulation.
    pub(crate) fn rounded<T: Real>(&self) -> Shape<T> {
        match self {
            Self::HalfSpace(solid) => Shape::HalfSpace(*solid),
            Self::AlignedBox(solid) => Shape::AlignedBox(solid.rounded()),
            Self::Bowl(solid) => Shape::Bowl(solid.rounded()),
            Self::Tube(solid) => Shape::Tube(solid.rounded()),
            Self::Capsule(solid) => Shape::Capsule(solid.rounded()),
            Self::OrientedBox(solid) => Shape::OrientedBox(solid.rounded()),
            Self::Plane(solid) => Shape::Plane(solid.rounded()),
            Self::Round(solid) => Shape::Round(solid.rounded()),
            Self::Cone(solid) => Shape::Cone(solid.rounded()),
            Self::Slope(solid) => Shape::Slope(solid.rounded()),
        }
    }

    /// Signed distance at a point of the solid's own frame, metres.
    pub(crate) fn distance_at(&self, point_m: Vec3<f64>) -> f64 {
        self.distance_and_normal_at(point_m).0
    }

    /// The same with the outward normal.
    pub(crate) fn distance_and_normal_at(&self, point_m: Vec3<f64>) -> (f64, Vec3<f64>) {
        with_solid!(*self, solid => solid.distance(point_m))
    }

    /// The face that a point is before.
    #[cfg(test)]
    pub(crate) fn face_at(&self, point_m: Vec3<f64>) -> Face {
        Face::from_number(with_solid!(*self, solid => SignedDistance::<f64>::face(&solid, point_m)))
    }

    /// Whether those before a face, or beyond an edge, do not see a point: it is in the solid, or before the opposite face.
    #[cfg(test)]
    pub(crate) fn hides(&self, face: Face, point_m: Vec3<f64>) -> bool {
        let beyond = |surface: Self| surface.distance_at(point_m) > 0.0;
        let opposite = face.opposite().and_then(|opposite| self.continued(opposite));
        self.distance_at(point_m) <= 0.0 || opposite.is_some_and(beyond)
    }
}
