//! Signed distances of tools and containers, with normals and with the second derivatives that the adjoint
//! of contact needs.
//!
//! A distance is written once, generic over the scalar. With [`Dual`] numbers the same code gives the
//! derivative of the normal in a direction, that is the product of the (symmetric) Hessian with a vector.

use core::ops::{Add, Mul, Neg, Sub};

use crate::real::{Real, RealOps};
use crate::small::{Mat3, Vec3, three};

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
}

/// Everything below `z = 0`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HalfSpace;

/// Box centred at `centre`, with half edges `half`. Lengths in metres, here and below.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AlignedBox<T> {
    pub(crate) centre: Vec3<T>,
    pub(crate) half: Vec3<T>,
}

/// A box that is turned: its axes are the rows of `axes`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct OrientedBox<T> {
    pub(crate) centre: Vec3<T>,
    pub(crate) half: Vec3<T>,
    pub(crate) axes: Mat3<T>,
}

/// Hemispherical shell, open towards +z, centre of the sphere at the origin, rim rounded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bowl<T> {
    /// Radius of the shell's middle surface.
    pub(crate) radius: T,
    /// Half the wall thickness.
    pub(crate) half: T,
}

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

/// Rod with round ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Capsule<T> {
    /// One end of the axis.
    pub(crate) from: Vec3<T>,
    /// From that end to the other.
    pub(crate) along: Vec3<T>,
    pub(crate) radius: T,
}

/// Any of the solids.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Shape<T> {
    HalfSpace(HalfSpace),
    AlignedBox(AlignedBox<T>),
    Bowl(Bowl<T>),
    Tube(Tube<T>),
    Capsule(Capsule<T>),
    OrientedBox(OrientedBox<T>),
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
        }
    };
}
pub(crate) use with_solid;

impl<T: Real> Shape<T> {
    /// Half the wall thickness; none for what has no second side.
    pub(crate) fn half_thickness(&self) -> Option<T> {
        match *self {
            Self::HalfSpace(_) => None,
            Self::AlignedBox(AlignedBox { half, .. }) | Self::OrientedBox(OrientedBox { half, .. }) => {
                Some(half[0].at_most(half[1]).at_most(half[2]))
            }
            Self::Bowl(Bowl { half, .. }) => Some(half),
            Self::Tube(Tube { half_radial, half_axial, .. }) => Some(half_radial.at_most(half_axial)),
            Self::Capsule(Capsule { radius, .. }) => Some(radius),
        }
    }
}

impl Shape<f64> {
    /// Signed distance at a point of the solid's own frame, metres.
    pub(crate) fn distance_at(&self, point_m: Vec3<f64>) -> f64 {
        with_solid!(*self, solid => solid.distance(point_m).0)
    }
}

impl<T: Real> SignedDistance<T> for HalfSpace {
    #[inline(always)]
    fn distance<S: Scalar<T>>(&self, y: [S; 3]) -> (S, [S; 3]) {
        (y[2], [S::constant(T::ZERO), S::constant(T::ZERO), S::constant(T::ONE)])
    }
}

/// Keeps a division by a length of zero finite; a length this small is on the edge or axis itself.
const TINY: f64 = 1e-18;

/// Points this close to a box's surface, m, count as inside, where the normal is that of one face: a distance of
/// rounding size has no direction, and faces that lie on grid nodes are common.
const SKIN: f64 = 1e-6;

#[inline(always)]
fn norm3<T: Real, S: Scalar<T>>(a: [S; 3]) -> S {
    (a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + S::constant(T::from_f64(TINY))).sqrt()
}

#[inline(always)]
fn norm2<T: Real, S: Scalar<T>>(a: S, b: S) -> S {
    (a * a + b * b + S::constant(T::from_f64(TINY))).sqrt()
}

impl<T: Real> SignedDistance<T> for AlignedBox<T> {
    #[inline(always)]
    fn distance<S: Scalar<T>>(&self, y: [S; 3]) -> (S, [S; 3]) {
        slab(y, self.centre, self.half)
    }
}

#[inline(always)]
fn slab<T: Real, S: Scalar<T>>(y: [S; 3], centre: [T; 3], half: [T; 3]) -> (S, [S; 3]) {
    let r = three!(i => y[i] - S::constant(centre[i]));
    let q = three!(i => r[i].abs() - S::constant(half[i]));
    let sign = three!(i => S::constant(if r[i].value() < T::ZERO { -T::ONE } else { T::ONE }));
    // Outside: distance to the nearest point of face, edge or corner.
    let out = three!(i => q[i].positive_part());
    let distance = norm3::<T, S>(out);
    let inverse = distance.recip();
    // Inside: the nearest face decides.
    let (a, b, c) = (q[0].value(), q[1].value(), q[2].value());
    let x_face = a >= b && a >= c;
    let y_face = !x_face && b >= c;
    let z_face = !x_face && !y_face;
    let outside = a.at_least(b).at_least(c) > T::from_f64(SKIN);
    let deepest = S::select(x_face, q[0], S::select(y_face, q[1], q[2]));
    let face = [x_face, y_face, z_face];
    let zero = S::constant(T::ZERO);
    let normal =
        three!(i => S::select(outside, out[i] * inverse * sign[i], S::select(face[i], sign[i], zero)));
    (S::select(outside, distance, deepest), normal)
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
}

impl<T: Real> SignedDistance<T> for Bowl<T> {
    /// Below the rim the shell of the sphere; above the rim plane the nearest point lies on the rim circle.
    #[inline(always)]
    fn distance<S: Scalar<T>>(&self, y: [S; 3]) -> (S, [S; 3]) {
        let r = S::constant(self.radius);
        let rho = norm2::<T, S>(y[0], y[1]);
        let length = norm3::<T, S>(y);
        let below = y[2].value() <= T::ZERO;
        // Below the rim the normal is radial, away from the middle surface.
        let gap = length - r;
        let side = S::constant(if gap.value() < T::ZERO { -T::ONE } else { T::ONE });
        let radial = side * length.recip();
        // Above, it points away from the rim circle.
        let to_rim = rho - r;
        let rim = norm2::<T, S>(to_rim, y[2]);
        let inverse = rim.recip();
        let across = to_rim * inverse * rho.recip();
        let distance = S::select(below, gap.abs(), rim) - S::constant(self.half);
        let normal = [
            S::select(below, y[0] * radial, y[0] * across),
            S::select(below, y[1] * radial, y[1] * across),
            S::select(below, y[2] * radial, y[2] * inverse),
        ];
        (distance, normal)
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
}
