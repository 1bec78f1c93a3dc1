//! Geometry of the arms: where the joints put the flange, how fast, and how near to a singularity.
//!
//! Denavit-Hartenberg parameters (classic convention, T = Rz(q) Tz(d) Tx(a) Rx(alpha)); their values are those of
//! [`ArmFigures`], the nominal ones. A real arm comes with its own small corrections.
//!
//! | joint      | a  | d  | alpha   |
//! |------------|----|----|---------|
//! | 1 base     | 0  | d1 | pi / 2  |
//! | 2 shoulder | a2 | 0  | 0       |
//! | 3 elbow    | a3 | 0  | 0       |
//! | 4 wrist 1  | 0  | d4 | pi / 2  |
//! | 5 wrist 2  | 0  | d5 | -pi / 2 |
//! | 6 wrist 3  | 0  | d6 | 0       |
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

use core::f64::consts::FRAC_PI_2;

use super::kind::{ArmFigures, ArmKind};
use crate::pose::{Pose, exp_so3, renormalised};
use nalgebra::Vector3;

/// Angles of the six joints, from the base to the flange, radians.
pub type Joints = [f64; 6];

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

    /// Radius of the capsule that the link lies in, metres.
    #[must_use]
    pub const fn radius_m(self, kind: ArmKind) -> f64 {
        let [upper_arm, forearm, wrist_1, wrist_2, wrist_3] = kind.figures().radius_m;
        match self {
            Self::UpperArm => upper_arm,
            Self::Forearm => forearm,
            Self::Wrist1 => wrist_1,
            Self::Wrist2 => wrist_2,
            Self::Wrist3 => wrist_3,
        }
    }
}

/// Both ends of the axis of each link's capsule in the order of [`Link::ALL`], base coordinates, metres.
#[must_use]
pub fn axes(kind: ArmKind, joints: &Joints) -> [[Vector3<f64>; 2]; 5] {
    let links = Links::at(kind, joints);
    let [upper, fore] = links.figures.beside_m.map(|aside_m| links.n * aside_m);
    let [shoulder, elbow, wrist_1] = [links.shoulder(), links.elbow(), links.wrist_1()];
    [
        [shoulder + upper, elbow + upper],
        [elbow + fore, wrist_1 + fore],
        [wrist_1 + fore, wrist_1 + links.n * links.figures.d4_m],
        [wrist_1 + links.n * links.figures.d4_m, links.wrist_2()],
        [links.wrist_2(), links.flange()],
    ]
}

/// Both ends of the axis of the capsule that holds base and shoulder, base coordinates, metres.
#[must_use]
pub fn column_axis(kind: ArmKind) -> [Vector3<f64>; 2] {
    [Vector3::zeros(), Vector3::z() * kind.figures().d1_m]
}

/// Normal of the plane in which upper arm and forearm move, base coordinates.
#[must_use]
pub fn normal(kind: ArmKind, joints: &Joints) -> Vector3<f64> {
    Links::at(kind, joints).n
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
    figures: &'static ArmFigures,
    e: Vector3<f64>,
    n: Vector3<f64>,
    z4: Vector3<f64>,
    z5: Vector3<f64>,
    q2: Turn,
    q23: Turn,
}

impl Links {
    fn at(kind: ArmKind, joints: &Joints) -> Self {
        let [q1, q2, q3, q4, q5, _] = *joints;
        let [q1, q234, q5] = [q1, q2 + q3 + q4, q5].map(Turn::by);
        let [e, n] = [Vector3::new(q1.c, q1.s, 0.0), Vector3::new(q1.s, -q1.c, 0.0)];
        let k = Vector3::z();
        let x4 = e * q234.c + k * q234.s;
        let z4 = e * q234.s - k * q234.c;
        let figures = kind.figures();
        Self { figures, e, n, z4, z5: n * q5.c - x4 * q5.s, q2: Turn::by(q2), q23: Turn::by(joints[1] + q3) }
    }

    fn shoulder(&self) -> Vector3<f64> {
        Vector3::z() * self.figures.d1_m
    }

    fn elbow(&self) -> Vector3<f64> {
        self.shoulder() + (self.e * self.q2.c + Vector3::z() * self.q2.s) * self.figures.a2_m
    }

    /// Where the axis of joint 4 meets the arm's plane.
    fn wrist_1(&self) -> Vector3<f64> {
        self.elbow() + (self.e * self.q23.c + Vector3::z() * self.q23.s) * self.figures.a3_m
    }

    /// Where the axes of joints 5 and 6 meet.
    fn wrist_2(&self) -> Vector3<f64> {
        self.wrist_1() + self.n * self.figures.d4_m + self.z4 * self.figures.d5_m
    }

    fn flange(&self) -> Vector3<f64> {
        self.wrist_2() + self.z5 * self.figures.d6_m
    }
}

/// Pose of the flange in the base's coordinates.
#[must_use]
pub fn base_from_flange(kind: ArmKind, joints: &Joints) -> Pose {
    let [q1, q2, q3, q4, q5, q6] = *joints;
    let about = |axis: Vector3<f64>, angle_rad: f64| exp_so3(&(axis * angle_rad));
    // Rz(q1) Rx(90) Rz(q234) Rx(90) Rz(q5) Rx(-90) Rz(q6), with the first three quarter turns carried through.
    let orientation = about(Vector3::z(), q1)
        * about(Vector3::y(), -(q2 + q3 + q4))
        * about(Vector3::z(), -q5)
        * about(Vector3::x(), FRAC_PI_2)
        * about(Vector3::z(), q6);
    Pose { position_m: Links::at(kind, joints).flange(), orientation: renormalised(orientation) }
}

/// Columns of the geometric Jacobian in the base's coordinates of the point `tip_m`, fixed to the flange: number i is the
/// velocity (m/s) of the point and the angular velocity (rad/s) of the flange while joint i turns by 1 rad/s.
pub(super) fn twists(kind: ArmKind, joints: &Joints, tip_m: &Vector3<f64>) -> [[f64; 6]; 6] {
    let links = Links::at(kind, joints);
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
    pub fn of(kind: ArmKind, joints: &Joints) -> Self {
        Self { shares: signed_margins(kind, joints).map(f64::abs) }
    }

    /// The least of the three, and its joint.
    #[must_use]
    pub fn least(&self) -> (u8, f64) {
        let named = Self::JOINTS.into_iter().zip(self.shares);
        named.fold((1, f64::INFINITY), |least, next| if next.1 < least.1 { next } else { least })
    }
}

/// Shoulder, elbow and wrist margin, with the signs that tell the eight postures apart.
pub(super) fn signed_margins(kind: ArmKind, joints: &Joints) -> [f64; 3] {
    let ArmFigures { a2_m, a3_m, d5_m, .. } = kind.figures();
    let [_, q2, q3, q4, q5, _] = *joints;
    let reach_m = a2_m * libm::cos(q2) + a3_m * libm::cos(q2 + q3) + d5_m * libm::sin(q2 + q3 + q4);
    [reach_m / -(a2_m + a3_m), libm::sin(q3), libm::sin(q5)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::norm;
    use core::f64::consts::TAU;
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

    /// The table, row by row.
    fn product_of_links(kind: ArmKind, joints: &Joints) -> Matrix4<f64> {
        let [q1, q2, q3, q4, q5, q6] = *joints;
        let ArmFigures { d1_m, a2_m, a3_m, d4_m, d5_m, d6_m, .. } = *kind.figures();
        link(q1, d1_m, 0.0, FRAC_PI_2)
            * link(q2, 0.0, a2_m, 0.0)
            * link(q3, 0.0, a3_m, 0.0)
            * link(q4, d4_m, 0.0, FRAC_PI_2)
            * link(q5, d5_m, 0.0, -FRAC_PI_2)
            * link(q6, d6_m, 0.0, 0.0)
    }

    fn kinds() -> impl Strategy<Value = ArmKind> {
        prop::sample::select(&ArmKind::ALL[..])
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
        let found = base_from_flange(ArmKind::Ur5e, &joints);
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
        assert!(SingularityMargins::of(ArmKind::Ur5e, &fine).least().1 > 0.5);
        assert_eq!(SingularityMargins::of(ArmKind::Ur5e, &turned(fine, 2, -1.5)).least(), (3, 0.0));
        assert_eq!(SingularityMargins::of(ArmKind::Ur5e, &turned(fine, 4, -FRAC_PI_2)).least(), (5, 0.0));
        // Upright with wrist 2 above the shoulder.
        let (joint, share) =
            SingularityMargins::of(ArmKind::Ur5e, &[0.0, -FRAC_PI_2 - 0.1, 0.2, -0.1 - FRAC_PI_2, 1.0, 0.0])
                .least();
        let reach_m = -0.425 * -(0.1f64.sin()) - 0.3922 * 0.1f64.sin();
        assert_eq!(joint, 1);
        assert!((share - reach_m.abs() / 0.8172).abs() < 1e-15, "{share}");
    }

    proptest! {
        #[test]
        fn the_flange_is_where_the_product_of_the_links_puts_it(kind in kinds(), joints in joints()) {
            let found = base_from_flange(kind, &joints);
            let expected = product_of_links(kind, &joints);
            let position = expected.fixed_view::<3, 1>(0, 3);
            prop_assert!((found.position_m - position).norm() < 4e-15);
            let rotation = found.orientation.to_rotation_matrix();
            prop_assert!((rotation.matrix() - expected.fixed_view::<3, 3>(0, 0)).norm() < 5e-15);
        }

        #[test]
        fn the_jacobian_is_the_derivative(kind in kinds(), joints in joints(), lever in [-0.2..0.2, -0.2..0.2, -0.2..0.2f64]) {
            let (lever, step) = (Vector3::from(lever), 1e-5);
            let found = Matrix6::from(twists(kind, &joints, &base_from_flange(kind, &joints).world_from_tool(&lever)));
            for (column, joint) in found.column_iter().zip(0..6) {
                let [before, after] = [-step, step].map(|step| {
                    let flange = base_from_flange(kind, &turned(joints, joint, step));
                    Pose { position_m: flange.world_from_tool(&lever), ..flange }
                });
                let difference = before.displacement_to(&after);
                prop_assert!((column.fixed_rows::<3>(0) - difference.translation() / (2.0 * step)).norm() < 1e-9);
                prop_assert!((column.fixed_rows::<3>(3) - difference.rotation() / (2.0 * step)).norm() < 1e-9);
            }
        }

        #[test]
        fn the_margins_are_the_factors_of_the_determinant(kind in kinds(), joints in joints()) {
            let flange_m = base_from_flange(kind, &joints).position_m;
            let determinant = Matrix6::from(twists(kind, &joints, &flange_m)).determinant();
            let factors: f64 = SingularityMargins::of(kind, &joints).shares.iter().product();
            let ArmFigures { a2_m, a3_m, .. } = kind.figures();
            prop_assert!((determinant.abs() + a2_m * a3_m * (a2_m + a3_m) * factors).abs() < 1e-13);
        }
    }
}
