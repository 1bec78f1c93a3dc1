//! What every solid gives, the numbers that it is written in, and lengths of vectors of them.

use core::ops::{Add, Mul, Neg, Sub};

use super::{Face, Shape};
use crate::real::{Real, RealOps};
use crate::small::Vec3;

/// What a signed distance may do with its numbers.
pub(crate) trait Scalar<T: Real>:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Neg<Output = Self>
{
    fn constant(x: T) -> Self;
    fn value(self) -> T;
    fn sqrt(self) -> Self;
    fn recip(self) -> Self;

    #[inline(always)]
    fn select(condition: bool, yes: Self, no: Self) -> Self {
        if condition { yes } else { no }
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self::select(self.value() < T::ZERO, -self, self)
    }
    #[inline(always)]
    fn positive_part(self) -> Self {
        Self::select(self.value() > T::ZERO, self, Self::constant(T::ZERO))
    }
}

impl<T: Real> Scalar<T> for T {
    #[inline(always)]
    fn constant(x: T) -> Self {
        x
    }
    #[inline(always)]
    fn value(self) -> T {
        self
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        RealOps::sqrt(self)
    }
    #[inline(always)]
    fn recip(self) -> Self {
        T::ONE / self
    }
}

/// Forward-mode dual number with one partial derivative.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Dual<T> {
    pub(crate) value: T,
    pub(crate) partial: T,
}

impl<T: Real> Add for Dual<T> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self { value: self.value + o.value, partial: self.partial + o.partial }
    }
}
impl<T: Real> Sub for Dual<T> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self { value: self.value - o.value, partial: self.partial - o.partial }
    }
}
impl<T: Real> Mul for Dual<T> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        Self { value: self.value * o.value, partial: self.partial * o.value + self.value * o.partial }
    }
}
impl<T: Real> Neg for Dual<T> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self { value: -self.value, partial: -self.partial }
    }
}
impl<T: Real> Scalar<T> for Dual<T> {
    #[inline(always)]
    fn constant(x: T) -> Self {
        Self { value: x, partial: T::ZERO }
    }
    #[inline(always)]
    fn value(self) -> T {
        self.value
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        Self { value: root, partial: T::from_f64(0.5) * self.partial / root }
    }
    #[inline(always)]
    fn recip(self) -> Self {
        let r = T::ONE / self.value;
        Self { value: r, partial: -(self.partial * r * r) }
    }
}

/// A solid whose signed distance is known in closed form, in a frame of its own.
pub(crate) trait SignedDistance<T: Real>: Copy + Sync {
    /// Signed distance (negative inside) and outward unit normal at `y`.
    fn distance<S: Scalar<T>>(&self, y: [S; 3]) -> (S, [S; 3]);

    /// Half the wall thickness; none for what has no second side.
    fn half_thickness(&self) -> Option<T>;

    /// Number of the [`Face`] that a point is before; of what has one side, one that has no opposite.
    #[inline(always)]
    fn face(&self, _y: Vec3<T>) -> i32 {
        Face::RIM.number() as i32
    }

    /// The distance's Laplacian, 1/m, and its derivative along the normal, 1/m^2: how the surface bends; 0 of flat faces, and of edges,
    /// whose bend has no scale.
    #[inline(always)]
    fn bend(&self, _y: Vec3<T>) -> [T; 2] {
        [T::ZERO; 2]
    }

    /// What a face bounds if it goes on beyond its edges; none of what has one side.
    fn continued(&self, _face: Face) -> Option<Shape<T>> {
        None
    }
}

/// Keeps a division by a length of zero finite; a length this small is on the edge or axis itself.
const TINY: f64 = 1e-18;

#[inline(always)]
pub(super) fn norm3<T: Real, S: Scalar<T>>(a: [S; 3]) -> S {
    (a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + S::constant(T::from_f64(TINY))).sqrt()
}

#[inline(always)]
pub(super) fn norm2<T: Real, S: Scalar<T>>(a: S, b: S) -> S {
    (a * a + b * b + S::constant(T::from_f64(TINY))).sqrt()
}
