//! Which joints put the flange at a pose: closed form, one of eight postures.
//!
//! Symbols as in [`super::links`]. From the flange's position p and axes x6, y6, z6 (z6 = z5):
//!
//! 1. p - d6 z6 is where axes 5 and 6 meet; its horizontal part is w e + d4 n, which gives w up to its sign, then q1.
//! 2. n in the flange's axes is (s5 c6, -s5 s6, c5), which gives q5 up to its sign, then q6.
//! 3. z5 is c5 n - s5 (c234 e + s234 k), which gives q234.
//! 4. What is left is a triangle with sides a2 and a3, which gives q3 up to its sign, then q2 and q4.
//!
//! Every angle comes from both its sine and its cosine, so away from singularities the result is exact to rounding. There is
//! nothing to iterate and nothing that could slip into another posture.

use core::f64::consts::TAU;

use core::fmt;

use super::kind::{ArmFigures, ArmKind};
use super::links::{Joints, signed_margins};
use crate::pose::Pose;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// One of the eight postures in which the arm can reach a pose. To get from one to another it must pass a singularity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Posture {
    /// w is negative: the arm reaches along its own -x, as it does with all joints at zero.
    pub reaches_forward: bool,
    /// sin(q3) is positive. Reaching forward, the elbow is then up.
    pub elbow_positive: bool,
    /// sin(q5) is positive.
    pub wrist_positive: bool,
}

impl Posture {
    /// All eight, the usual ones first: reaching forward before backward over the own base, with the elbow up before down,
    /// with a positive wrist before a negative one.
    pub const PREFERRED: [Self; 8] = [
        Self::new(true, true, true),
        Self::new(true, true, false),
        Self::new(true, false, true),
        Self::new(true, false, false),
        // Reaching backward, it is the negative elbow that is up.
        Self::new(false, false, true),
        Self::new(false, false, false),
        Self::new(false, true, true),
        Self::new(false, true, false),
    ];

    const fn new(reaches_forward: bool, elbow_positive: bool, wrist_positive: bool) -> Self {
        Self { reaches_forward, elbow_positive, wrist_positive }
    }

    /// Whether the elbow is above the line from shoulder to wrist.
    #[must_use]
    pub const fn elbow_is_up(&self) -> bool {
        self.reaches_forward == self.elbow_positive
    }

    /// The posture of given joints.
    #[must_use]
    pub fn of(kind: ArmKind, joints: &Joints) -> Self {
        let [shoulder, elbow, wrist] = signed_margins(kind, joints);
        Self { reaches_forward: shoulder < 0.0, elbow_positive: elbow > 0.0, wrist_positive: wrist > 0.0 }
    }
}

/// As people say it: `reaches forward, elbow up, wrist 2 at a positive angle`.
impl fmt::Display for Posture {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let reach = if self.reaches_forward { "forward" } else { "backward over its base" };
        let elbow = if self.elbow_is_up() { "up" } else { "down" };
        let wrist = if self.wrist_positive { "positive" } else { "negative" };
        write!(f, "reaches {reach}, elbow {elbow}, wrist 2 at a {wrist} angle")
    }
}

/// A distance that the links cannot take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OutOfReach {
    /// Joint that would have to give it, counted from 1.
    pub(super) joint: u8,
    /// What the pose asks for, metres.
    pub(super) distance_m: f64,
    /// What there is: the most if it is smaller, the least if it is larger.
    pub(super) bound_m: f64,
}

/// The joints, each within half a turn of zero but for q4, that put the flange at `base_from_flange` in this posture.
pub(super) fn joints_of(
    kind: ArmKind,
    base_from_flange: &Pose,
    posture: Posture,
) -> Result<Joints, OutOfReach> {
    let figures = kind.figures();
    let ArmFigures { d1_m, d5_m, d6_m, .. } = figures;
    let axes = base_from_flange.orientation.to_rotation_matrix();
    let z5 = axes * Vector3::z();
    let wrist_2 = base_from_flange.position_m - z5 * *d6_m;

    let (e, n) = arm_plane(figures, &wrist_2, posture)?;
    let [nx, ny, nz]: [f64; 3] = axes.inverse_transform_vector(&n).into();
    let sign = if posture.wrist_positive { 1.0 } else { -1.0 };
    let q234 = libm::atan2(-sign * z5.z, -sign * z5.dot(&e));
    let (s234, c234) = libm::sincos(q234);
    let [q2, q3] = triangle(figures, wrist_2.dot(&e) - d5_m * s234, wrist_2.z - d1_m + d5_m * c234, posture)?;
    Ok([
        libm::atan2(e.y, e.x),
        q2,
        q3,
        q234 - q2 - q3,
        libm::atan2(sign * length(nx, ny), nz),
        libm::atan2(-sign * ny, sign * nx),
    ])
}

/// The directions e and n of the arm's plane.
fn arm_plane(
    figures: &ArmFigures,
    wrist_2: &Vector3<f64>,
    posture: Posture,
) -> Result<(Vector3<f64>, Vector3<f64>), OutOfReach> {
    let d4_m = figures.d4_m;
    let distance_m = length(wrist_2.x, wrist_2.y);
    if distance_m >= d4_m {
        let along_m = libm::sqrt((distance_m - d4_m) * (distance_m + d4_m));
        let w = if posture.reaches_forward { -along_m } else { along_m };
        let square = distance_m * distance_m;
        let c1 = (w * wrist_2.x - d4_m * wrist_2.y) / square;
        let s1 = (w * wrist_2.y + d4_m * wrist_2.x) / square;
        Ok((Vector3::new(c1, s1, 0.0), Vector3::new(s1, -c1, 0.0)))
    } else {
        Err(OutOfReach { joint: 1, distance_m, bound_m: d4_m })
    }
}

/// q2 and q3 for wrist 1 at (u, v) from the shoulder, along e and k.
fn triangle(figures: &ArmFigures, u: f64, v: f64, posture: Posture) -> Result<[f64; 2], OutOfReach> {
    let ArmFigures { a2_m, a3_m, .. } = *figures;
    let [longest_m, shortest_m] = figures.span_m();
    let distance_m = length(u, v);
    if (shortest_m..=longest_m).contains(&distance_m) {
        let square = distance_m * distance_m;
        let c3 = ((square - a2_m * a2_m - a3_m * a3_m) / (2.0 * a2_m * a3_m)).clamp(-1.0, 1.0);
        let sine = libm::sqrt((1.0 - c3) * (1.0 + c3));
        let s3 = if posture.elbow_positive { sine } else { -sine };
        // u + i v = (a2 + a3 exp(i q3)) exp(i q2)
        let (re, im) = (a2_m + a3_m * c3, a3_m * s3);
        Ok([libm::atan2(v * re - u * im, u * re + v * im), libm::atan2(s3, c3)])
    } else {
        let bound_m = if distance_m < shortest_m { shortest_m } else { longest_m };
        Err(OutOfReach { joint: 3, distance_m, bound_m })
    }
}

/// The same angles, each by whole turns as near to `near` as can be.
pub(super) fn unwound(joints: &Joints, near: &Joints) -> Joints {
    let mut unwound = *joints;
    for (angle, near) in unwound.iter_mut().zip(near) {
        *angle += TAU * libm::round((near - *angle) / TAU);
    }
    unwound
}

fn length(x: f64, y: f64) -> f64 {
    libm::sqrt(x * x + y * y)
}

#[cfg(test)]
mod tests {
    use super::super::links::{SingularityMargins, base_from_flange};
    use super::*;
    use crate::pose::{exp_so3, norm};
    use core::f64::consts::PI;
    use proptest::prelude::*;
    use std::vec::Vec;

    const KIND: ArmKind = ArmKind::Ur5e;
    const UR5E: &ArmFigures = KIND.figures();

    fn joints_with_margin(margin: f64) -> impl Strategy<Value = Joints> {
        [-TAU..TAU, -TAU..TAU, -TAU..TAU, -TAU..TAU, -TAU..TAU, -TAU..TAU]
            .prop_filter("near a singularity", move |joints: &Joints| {
                SingularityMargins::of(KIND, joints).least().1 > margin
            })
    }

    fn largest_difference(a: &Joints, b: &Joints) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    /// Whether upper arm and forearm make an arch and not a bowl.
    fn elbow_rises([_, q2, q3, ..]: &Joints) -> bool {
        let elbow = [UR5E.a2_m * q2.cos(), UR5E.a2_m * q2.sin()];
        let wrist = [elbow[0] + UR5E.a3_m * (q2 + q3).cos(), elbow[1] + UR5E.a3_m * (q2 + q3).sin()];
        elbow[1] > wrist[1] * elbow[0] / wrist[0]
    }

    #[test]
    fn eight_postures_reach_one_pose() {
        let pose = base_from_flange(KIND, &[0.4, -1.1, 1.3, -0.7, 1.2, 0.5]);
        let mut found = Vec::new();
        for posture in Posture::PREFERRED {
            let joints = joints_of(KIND, &pose, posture).unwrap();
            assert_eq!(Posture::of(KIND, &joints), posture);
            let off = pose.displacement_to(&base_from_flange(KIND, &joints));
            assert!(norm(&off.translation()) < 1e-14 && norm(&off.rotation()) < 1e-14, "{joints:?}");
            assert_eq!(posture.elbow_is_up(), elbow_rises(&joints), "{joints:?}");
            found.push(joints);
        }
        for (index, joints) in found.iter().enumerate() {
            assert!(found.iter().skip(index + 1).all(|other| largest_difference(joints, other) > 0.1));
        }
    }

    #[test]
    fn out_of_reach_names_the_link() {
        let forward = Posture { reaches_forward: true, elbow_positive: true, wrist_positive: true };
        // The flange faces down.
        let down = |position_m: [f64; 3]| Pose {
            position_m: position_m.into(),
            orientation: exp_so3(&Vector3::new(PI, 0.0, 0.0)),
        };
        let reach = |position_m| joints_of(KIND, &down(position_m), forward);
        let found = reach([0.05, 0.05, 0.5]).unwrap_err();
        assert_eq!((found.joint, found.bound_m), (1, 0.1333));
        assert!((found.distance_m - libm::sqrt(0.005)).abs() < 1e-15, "{found:?}");
        let found = reach([1.2, 0.0, 0.2]).unwrap_err();
        assert_eq!(found.joint, 3);
        assert!((found.bound_m - 0.8172).abs() < 1e-15 && found.distance_m > found.bound_m, "{found:?}");
        // Reaching backward, wrist 2 can be so low and so near that wrist 1 comes to the shoulder.
        let beside = down([libm::hypot(UR5E.d4_m, UR5E.d5_m), 0.0, UR5E.d1_m - UR5E.d6_m]);
        let found = joints_of(KIND, &beside, Posture { reaches_forward: false, ..forward }).unwrap_err();
        assert_eq!(found.joint, 3);
        assert!((found.bound_m - 0.0328).abs() < 1e-15 && found.distance_m < 1e-15, "{found:?}");
        for number in [f64::NAN, f64::INFINITY, -f64::INFINITY, 1e300] {
            assert!(reach([number, 0.3, 0.3]).is_err() && reach([0.3, 0.3, number]).is_err());
        }
    }

    #[test]
    fn a_joint_is_unwound_to_the_nearest_turn() {
        let near = [3.0, -3.0, 5.9, -5.9, 0.0, 6.2];
        let found = unwound(&[-3.0, 3.0, 0.1, -0.1, 3.0, -3.0], &near);
        let expected = [TAU - 3.0, 3.0 - TAU, TAU + 0.1, -TAU - 0.1, 3.0, TAU - 3.0];
        assert!(largest_difference(&found, &expected) < 1e-15, "{found:?}");
    }

    proptest! {
        #[test]
        fn joints_come_back(joints in joints_with_margin(0.05)) {
            let pose = base_from_flange(KIND, &joints);
            let found = unwound(&joints_of(KIND, &pose, Posture::of(KIND, &joints)).unwrap(), &joints);
            prop_assert!(largest_difference(&found, &joints) < 1e-12, "{found:?} for {joints:?}");
            let off = pose.displacement_to(&base_from_flange(KIND, &found));
            prop_assert!(norm(&off.translation()) < 1e-14, "{}", norm(&off.translation()));
            prop_assert!(norm(&off.rotation()) < 1e-14, "{}", norm(&off.rotation()));
        }
    }
}
