//! The signed distance of a box, of which several solids are made.

use super::signed_distance::{Scalar, norm3};
use crate::real::Real;
use crate::small::three;

/// Points this close to a box's surface, m, count as inside, where the normal is that of one face: a distance of
/// rounding size has no direction, and faces that lie on grid nodes are common.
const SKIN: f64 = 1e-6;

#[inline(always)]
pub(super) fn slab<T: Real, S: Scalar<T>>(y: [S; 3], centre: [T; 3], half: [T; 3]) -> (S, [S; 3]) {
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
