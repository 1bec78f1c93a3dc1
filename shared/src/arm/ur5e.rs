//! Geometry of the UR5e: where the joints put the flange, how fast, and how near to a singularity.
//!
//! Denavit-Hartenberg parameters (classic convention, T = Rz(q) Tz(d) Tx(a) Rx(alpha)) as published by Universal Robots,
//! "DH Parameters for calculations of kinematics and dynamics", table UR5e. They are the nominal ones; a real arm comes
//! with its own small corrections.
//!
//! | joint      | a (m)   | d (m)  | alpha   | identifier      |
//! |------------|---------|--------|---------|-----------------|
//! | 1 base     | 0       | 0.1625 | pi / 2  | [`D1_M`]        |
//! | 2 shoulder | -0.425  | 0      | 0       | [`A2_M`]        |
//! | 3 elbow    | -0.3922 | 0      | 0       | [`A3_M`]        |
//! | 4 wrist 1  | 0       | 0.1333 | pi / 2  | [`D4_M`]        |
//! | 5 wrist 2  | 0       | 0.0997 | -pi / 2 | [`D5_M`]        |
//! | 6 wrist 3  | 0       | 0.0996 | 0       | [`D6_M`]        |
//!
//! The axes of joints 2, 3 and 4 are parallel, so upper arm and forearm move in one plane. In the base's coordinates, with
//! c and s for cosine and sine and q23 for q2 + q3:
//!
//! | symbol | meaning                                      | value                                         |
//! |--------|----------------------------------------------|-----------------------------------------------|
//! | k      | axis of joint 1                              | (0, 0, 1)                                     |
//! | e      | horizontal direction of the plane            | (c1, s1, 0)                                   |
//! | n      | normal of the plane, axis of joints 2, 3, 4  | (s1, -c1, 0)                                  |
//! | z4     | axis of joint 5                              | s234 e - c234 k                               |
//! | x4     | third axis there                             | c234 e + s234 k                               |
//! | z5     | axis of joint 6                              | c5 n - s5 x4                                  |
//! | w      | wrist's distance from joint 1, along e       | a2 c2 + a3 c23 + d5 s234                      |
//! | p      | flange                                       | w e + (d1 + a2 s2 + a3 s23 - d5 c234) k + d4 n + d6 z5 |

use core::f64::consts::{FRAC_PI_2, PI, TAU};

use crate::pose::{Pose, exp_so3, renormalised};
use nalgebra::Vector3;

/// Angles of the six joints, from the base to the flange, radians.
pub type Joints = [f64; 6];

/// Height of the shoulder above the base, metres.
pub const D1_M: f64 = 0.1625;
/// Length of the upper arm, metres; negative, since the arm stretches against its x axes.
pub const A2_M: f64 = -0.425;
/// Length of the forearm, metres; negative as well.
pub const A3_M: f64 = -0.3922;
/// Sideways offset of the wrist from the arm's plane, metres.
pub const D4_M: f64 = 0.1333;
/// From wrist 1 to wrist 2, metres.
pub const D5_M: f64 = 0.0997;
/// From wrist 2 to the flange, metres.
pub const D6_M: f64 = 0.0996;

/// Longest and shortest distance that upper arm and forearm span, metres.
pub const SPAN_M: [f64; 2] = [-(A2_M + A3_M), A3_M - A2_M];

/// How far each joint turns to either side, radians.
pub const RANGE_RAD: [f64; 6] = [TAU; 6];
/// How fast each joint turns, rad/s.
pub const SPEED_RAD_S: [f64; 6] = [PI; 6];

/// Upper arm and forearm lie beside the plane of the table above, along n by so much, metres: the offsets of their meshes in
/// Universal Robots' own ROS description (`ur_description`, `config/ur5e/visual_parameters.yaml`).
const BESIDE_M: [f64; 2] = [0.138, 0.007];

/// A part of the arm that moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Link {
    /// From the shoulder to the elbow.
    UpperArm,
    /// From the elbow to wrist 1.
    Forearm,
    /// The joint housing about axis 4.
    Wrist1,
    /// The joint housing about axis 5.
    Wrist2,
    /// From there to the flange.
    Wrist3,
}

impl Link {
    /// All, from the base to the flange.
    pub const ALL: [Self; 5] = [Self::UpperArm, Self::Forearm, Self::Wrist1, Self::Wrist2, Self::Wrist3];

    /// As people call it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::UpperArm => "upper arm",
            Self::Forearm => "forearm",
            Self::Wrist1 => "wrist 1",
            Self::Wrist2 => "wrist 2",
            Self::Wrist3 => "wrist 3",
        }
    }

    /// Radius of the capsule that the link lies in, metres; housings and tubes as UR's drawing of the arm has them, rounded up.
    #[must_use]
    pub const fn radius_m(self) -> f64 {
        match self {
            Self::UpperArm => 0.07,
            Self::Forearm => 0.06,
            Self::Wrist1 | Self::Wrist2 | Self::Wrist3 => 0.05,
        }
    }
}

/// Both ends of the axis of each link's capsule in the order of [`Link::ALL`], base coordinates, metres.
#[must_use]
pub fn axes(joints: &Joints) -> [[Vector3<f64>; 2]; 5] {
    let links = Links::at(joints);
    let [upper, fore] = BESIDE_M.map(|aside_m| links.n * aside_m);
    let [shoulder, elbow, wrist_1] = [links.shoulder(), links.elbow(), links.wrist_1()];
    [
        [shoulder + upper, elbow + upper],
        [elbow + fore, wrist_1 + fore],
        [wrist_1 + fore, wrist_1 + links.n * D4_M],
        [wrist_1 + links.n * D4_M, links.wrist_2()],
        [links.wrist_2(), links.flange()],
    ]
}

/// Sine and cosine.
#[derive(Clone, Copy)]
struct Turn {
    s: f64,
    c: f64,
}

impl Turn {
    fn by(angle_rad: f64) -> Self {
        let (s, c) = libm::sincos(angle_rad);
        Self { s, c }
    }
}

/// The vectors of the table above, base coordinates.
struct Links {
    e: Vector3<f64>,
    n: Vector3<f64>,
    z4: Vector3<f64>,
    z5: Vector3<f64>,
    q2: Turn,
    q23: Turn,
}

impl Links {
    fn at(joints: &Joints) -> Self {
        let [q1, q2, q3, q4, q5, _] = *joints;
        let [q1, q234, q5] = [q1, q2 + q3 + q4, q5].map(Turn::by);
        let [e, n] = [Vector3::new(q1.c, q1.s, 0.0), Vector3::new(q1.s, -q1.c, 0.0)];
        let k = Vector3::z();
        let x4 = e * q234.c + k * q234.s;
        let z4 = e * q234.s - k * q234.c;
        Self { e, n, z4, z5: n * q5.c - x4 * q5.s, q2: Turn::by(q2), q23: Turn::by(joints[1] + q3) }
    }

    fn shoulder(&self) -> Vector3<f64> {
        Vector3::z() * D1_M
    }

    fn elbow(&self) -> Vector3<f64> {
        self.shoulder() + (self.e * self.q2.c + Vector3::z() * self.q2.s) * A2_M
    }

    /// Where the axis of joint 4 meets the arm's plane.
    fn wrist_1(&self) -> Vector3<f64> {
        self.elbow() + (self.e * self.q23.c + Vector3::z() * self.q23.s) * A3_M
    }

    /// Where the axes of joints 5 and 6 meet.
    fn wrist_2(&self) -> Vector3<f64> {
        self.wrist_1() + self.n * D4_M + self.z4 * D5_M
    }

    fn flange(&self) -> Vector3<f64> {
        self.wrist_2() + self.z5 * D6_M
    }
}

/// Pose of the flange in the base's coordinates.
#[must_use]
pub fn base_from_flange(joints: &Joints) -> Pose {
    let [q1, q2, q3, q4, q5, q6] = *joints;
    let about = |axis: Vector3<f64>, angle_rad: f64| exp_so3(&(axis * angle_rad));
    // Rz(q1) Rx(90) Rz(q234) Rx(90) Rz(q5) Rx(-90) Rz(q6), with the first three quarter turns carried through.
    let orientation = about(Vector3::z(), q1)
        * about(Vector3::y(), -(q2 + q3 + q4))
        * about(Vector3::z(), -q5)
        * about(Vector3::x(), FRAC_PI_2)
        * about(Vector3::z(), q6);
    Pose { position_m: Links::at(joints).flange(), orientation: renormalised(orientation) }
}

/// Columns of the geometric Jacobian in the base's coordinates of the point `tip_m`, fixed to the flange: number i is the
/// velocity (m/s) of the point and the angular velocity (rad/s) of the flange while joint i turns by 1 rad/s.
pub(super) fn twists(joints: &Joints, tip_m: &Vector3<f64>) -> [[f64; 6]; 6] {
    let links = Links::at(joints);
    let twist = |axis: Vector3<f64>, origin_m: Vector3<f64>| {
        let [vx, vy, vz] = axis.cross(&(tip_m - origin_m)).into();
        let [wx, wy, wz] = axis.into();
        [vx, vy, vz, wx, wy, wz]
    };
    [
        twist(Vector3::z(), Vector3::zeros()),
        twist(links.n, links.shoulder()),
        twist(links.n, links.elbow()),
        twist(links.n, links.wrist_1()),
        twist(links.z4, links.wrist_2()),
        twist(links.z5, links.wrist_2()),
    ]
}

/// How far from a singularity, as a joint's share of what is best: 0 is singular, 1 is as far as can be.
///
/// The determinant of the flange's Jacobian is a2 a3 w sin(q3) sin(q5), which has three ways to vanish:
///
/// | joint | margin            | at zero                                                                        |
/// |-------|-------------------|--------------------------------------------------------------------------------|
/// | 1     | abs(w) / (abs(a2) + abs(a3)) | the wrist's centre in the plane through axis 1 across the arm's          |
/// | 3     | abs(sin q3)       | the arm stretched out or folded up                                             |
/// | 5     | abs(sin q5)       | axis 6 parallel to axes 2, 3 and 4                                             |
///
/// Unlike a singular value of the Jacobian these need no characteristic length and name the joint to blame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SingularityMargins {
    /// Shoulder, elbow and wrist.
    pub shares: [f64; 3],
}

impl SingularityMargins {
    /// Joints by which the margins are named, counted from 1.
    pub const JOINTS: [u8; 3] = [1, 3, 5];

    /// Margins of a posture.
    #[must_use]
    pub fn of(joints: &Joints) -> Self {
        Self { shares: signed_margins(joints).map(f64::abs) }
    }

    /// The least of the three, and its joint.
    #[must_use]
    pub fn least(&self) -> (u8, f64) {
        let named = Self::JOINTS.into_iter().zip(self.shares);
        named.fold((1, f64::INFINITY), |least, next| if next.1 < least.1 { next } else { least })
    }
}

/// Shoulder, elbow and wrist margin, with the signs that tell the eight postures apart.
pub(super) fn signed_margins(joints: &Joints) -> [f64; 3] {
    let [_, q2, q3, q4, q5, _] = *joints;
    let reach_m = A2_M * libm::cos(q2) + A3_M * libm::cos(q2 + q3) + D5_M * libm::sin(q2 + q3 + q4);
    [reach_m / -(A2_M + A3_M), libm::sin(q3), libm::sin(q5)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::norm;
    use nalgebra::{Matrix4, Matrix6, Rotation3};
    use proptest::prelude::*;

    /// Rz(q) Tz(d) Tx(a) Rx(alpha), written out.
    fn link(q: f64, d: f64, a: f64, alpha: f64) -> Matrix4<f64> {
        let ((s, c), (sa, ca)) = (q.sin_cos(), alpha.sin_cos());
        Matrix4::new(
            c,
            -s * ca,
            s * sa,
            a * c, //
            s,
            c * ca,
            -c * sa,
            a * s, //
            0.0,
            sa,
            ca,
            d, //
            0.0,
            0.0,
            0.0,
            1.0,
        )
    }

    /// The published table, row by row.
    fn product_of_links(joints: &Joints) -> Matrix4<f64> {
        let [q1, q2, q3, q4, q5, q6] = *joints;
        link(q1, 0.1625, 0.0, FRAC_PI_2)
            * link(q2, 0.0, -0.425, 0.0)
            * link(q3, 0.0, -0.3922, 0.0)
            * link(q4, 0.1333, 0.0, FRAC_PI_2)
            * link(q5, 0.0997, 0.0, -FRAC_PI_2)
            * link(q6, 0.0996, 0.0, 0.0)
    }

    fn joints() -> impl Strategy<Value = Joints> {
        [-TAU..TAU, -TAU..TAU, -TAU..TAU, -TAU..TAU, -TAU..TAU, -TAU..TAU]
    }

    /// One joint, counted from 0, turned further.
    fn turned(mut joints: Joints, joint: usize, step_rad: f64) -> Joints {
        joints.iter_mut().skip(joint).take(1).for_each(|angle| *angle += step_rad);
        joints
    }

    fn assert_stands(joints: Joints, position_m: [f64; 3], rotation: Rotation3<f64>) {
        let found = base_from_flange(&joints);
        assert!(norm(&(found.position_m - Vector3::from(position_m))) < 1e-15, "{found:?}");
        assert!((found.orientation.to_rotation_matrix().matrix() - rotation.matrix()).norm() < 1e-15);
    }

    #[test]
    fn known_postures() {
        let columns = |x: [f64; 3], y: [f64; 3], z: [f64; 3]| {
            Rotation3::from_basis_unchecked(&[Vector3::from(x), Vector3::from(y), Vector3::from(z)])
        };
        // All joints at zero: stretched out along -x, the flange facing -y.
        let facing = columns([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]);
        assert_stands([0.0; 6], [-0.8172, -0.2329, 0.0628], facing);
        // Upright, the arm's own "zero" of the mounting drawings: 0, -90, 0, -90, 0, 0 degrees.
        let up = [0.0, -FRAC_PI_2, 0.0, -FRAC_PI_2, 0.0, 0.0];
        assert_stands(
            up,
            [0.0, -0.2329, 0.1625 + 0.425 + 0.3922 + 0.0997],
            columns([-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]),
        );
    }

    #[test]
    fn margins_name_the_joint() {
        let fine = [0.3, -1.2, 1.5, -0.4, FRAC_PI_2, 0.0];
        assert!(SingularityMargins::of(&fine).least().1 > 0.5);
        assert_eq!(SingularityMargins::of(&turned(fine, 2, -1.5)).least(), (3, 0.0));
        assert_eq!(SingularityMargins::of(&turned(fine, 4, -FRAC_PI_2)).least(), (5, 0.0));
        // Upright with wrist 2 above the shoulder.
        let (joint, share) =
            SingularityMargins::of(&[0.0, -FRAC_PI_2 - 0.1, 0.2, -0.1 - FRAC_PI_2, 1.0, 0.0]).least();
        let reach_m = A2_M * -(0.1f64.sin()) + A3_M * 0.1f64.sin();
        assert_eq!(joint, 1);
        assert!((share - reach_m.abs() / 0.8172).abs() < 1e-15, "{share}");
    }

    proptest! {
        #[test]
        fn the_flange_is_where_the_product_of_the_links_puts_it(joints in joints()) {
            let found = base_from_flange(&joints);
            let expected = product_of_links(&joints);
            let position = expected.fixed_view::<3, 1>(0, 3);
            prop_assert!((found.position_m - position).norm() < 2e-15);
            let rotation = found.orientation.to_rotation_matrix();
            prop_assert!((rotation.matrix() - expected.fixed_view::<3, 3>(0, 0)).norm() < 5e-15);
        }

        #[test]
        fn the_jacobian_is_the_derivative(joints in joints(), lever in [-0.2..0.2, -0.2..0.2, -0.2..0.2f64]) {
            let (lever, step) = (Vector3::from(lever), 1e-5);
            let found = Matrix6::from(twists(&joints, &base_from_flange(&joints).world_from_tool(&lever)));
            for (column, joint) in found.column_iter().zip(0..6) {
                let [before, after] = [-step, step].map(|step| {
                    let flange = base_from_flange(&turned(joints, joint, step));
                    Pose { position_m: flange.world_from_tool(&lever), ..flange }
                });
                let difference = before.displacement_to(&after);
                prop_assert!((column.fixed_rows::<3>(0) - difference.translation() / (2.0 * step)).norm() < 1e-9);
                prop_assert!((column.fixed_rows::<3>(3) - difference.rotation() / (2.0 * step)).norm() < 1e-9);
            }
        }

        #[test]
        fn the_margins_are_the_factors_of_the_determinant(joints in joints()) {
            let flange_m = base_from_flange(&joints).position_m;
            let determinant = Matrix6::from(twists(&joints, &flange_m)).determinant();
            let factors: f64 = SingularityMargins::of(&joints).shares.iter().product();
            prop_assert!((determinant.abs() - 0.425 * 0.3922 * 0.8172 * factors).abs() < 1e-14);
        }
    }
}
