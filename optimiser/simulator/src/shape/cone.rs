//! The signed distance of the wall of a cone, and of what a face of it bounds.

use super::face::box_face;
use super::signed_distance::{Scalar, SignedDistance, norm2};
use super::slab::slab;
use super::{Face, Shape};
use crate::real::Real;
use crate::small::Vec3;

/// Solid of revolution about z whose profile is a rectangle that leans outwards: the wall of a funnel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cone<T> {
    /// Middle radius of the profile.
    pub(crate) radius: T,
    /// Middle height of the profile.
    pub(crate) height: T,
    /// Half extent of the profile across the wall.
    pub(crate) half_across: T,
    /// Half extent of the profile along the wall.
    pub(crate) half_along: T,
    /// Sine and cosine of the angle by which the wall leans from the vertical.
    pub(crate) lean: [T; 2],
}

impl Cone<f64> {
    /// The same in another precision.
    pub(super) fn rounded<R: Real>(&self) -> Cone<R> {
        Cone {
            radius: R::from_f64(self.radius),
            height: R::from_f64(self.height),
            half_across: R::from_f64(self.half_across),
            half_along: R::from_f64(self.half_along),
            lean: self.lean.map(R::from_f64),
        }
    }
}

impl<T: Real> Cone<T> {
    /// From the profile's middle: outwards across the wall, and upwards along it.
    #[inline(always)]
    fn in_profile<S: Scalar<T>>(&self, rho: S, z: S) -> [S; 2] {
        let [sin, cos] = self.lean.map(S::constant);
        let (out, up) = (rho - S::constant(self.radius), z - S::constant(self.height));
        [out * cos - up * sin, out * sin + up * cos]
    }

    /// Of the profile's sides, outwards, in radius and height: outer and inner, upper and lower.
    #[inline(always)]
    fn side(&self, number: usize) -> [T; 2] {
        let [sin, cos] = self.lean;
        match number {
            0 => [cos, -sin],
            1 => [-cos, sin],
            2 => [sin, cos],
            _ => [-sin, -cos],
        }
    }
}

impl<T: Real> SignedDistance<T> for Cone<T> {
    #[inline(always)]
    fn distance<S: Scalar<T>>(&self, y: [S; 3]) -> (S, [S; 3]) {
        let rho = norm2::<T, S>(y[0], y[1]);
        let [across, along] = self.in_profile(rho, y[2]);
        let half = [self.half_across, self.half_along, T::from_f64(1e9)];
        let (distance, profile) = slab([across, along, S::constant(T::ZERO)], [T::ZERO; 3], half);
        let [sin, cos] = self.lean.map(S::constant);
        let outwards = (profile[0] * cos + profile[1] * sin) * rho.recip();
        (distance, [y[0] * outwards, y[1] * outwards, profile[1] * cos - profile[0] * sin])
    }

    #[inline(always)]
    fn half_thickness(&self) -> Option<T> {
        Some(self.half_across.at_most(self.half_along))
    }

    #[inline(always)]
    fn bend(&self, y: Vec3<T>) -> [T; 2] {
        let face = self.face(y) as usize;
        let rho = norm2::<T, T>(y[0], y[1]);
        bend(self.side(face)[0], rho).map(|bend| bend.only_if(face < 4))
    }

    /// Outer and inner, upper and lower.
    #[inline(always)]
    fn face(&self, y: Vec3<T>) -> i32 {
        let [across, along] = self.in_profile(norm2::<T, T>(y[0], y[1]), y[2]);
        box_face([across, along, T::ZERO], [self.half_across, self.half_along, T::from_f64(1e9)])
    }

    fn continued(&self, face: Face) -> Option<Shape<T>> {
        let number = face.number();
        (number < 4).then(|| {
            let normal = self.side(number);
            let half = if number < 2 { self.half_across } else { self.half_along };
            let offset = normal[0] * self.radius + normal[1] * self.height + half;
            Shape::Slope(Slope { normal, offset })
        })
    }
}

/// What bends a cone by its normal's part along the radius.
#[inline(always)]
fn bend<T: Real>(radial: T, rho: T) -> [T; 2] {
    let per_radius = radial / rho;
    [per_radius, -(per_radius * per_radius)]
}

/// Everything on one side of a cone about z, continued beyond its edges: `normal . (rho, z) < offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Slope<T> {
    /// Outwards, in radius and height, of length 1.
    pub(crate) normal: [T; 2],
    pub(crate) offset: T,
}

impl Slope<f64> {
    /// The same in another precision.
    pub(super) fn rounded<R: Real>(&self) -> Slope<R> {
        Slope { normal: self.normal.map(R::from_f64), offset: R::from_f64(self.offset) }
    }
}

impl<T: Real> SignedDistance<T> for Slope<T> {
    #[inline(always)]
    fn distance<S: Scalar<T>>(&self, y: [S; 3]) -> (S, [S; 3]) {
        let rho = norm2::<T, S>(y[0], y[1]);
        let [radial, axial] = self.normal.map(S::constant);
        let outwards = radial * rho.recip();
        let distance = radial * rho + axial * y[2] - S::constant(self.offset);
        (distance, [y[0] * outwards, y[1] * outwards, axial])
    }

    #[inline(always)]
    fn half_thickness(&self) -> Option<T> {
        None
    }

    #[inline(always)]
    fn bend(&self, y: Vec3<T>) -> [T; 2] {
        bend(self.normal[0], norm2::<T, T>(y[0], y[1]))
    }
}
