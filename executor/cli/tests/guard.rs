//! The guard, which looks at most setpoints in whole numbers only, refuses what the limits refuse, and nothing else.

use powderline_executor::guard::Guard;
use powderline_shared::displacement::{Lsb, Setpoint, pose_at};
use powderline_shared::limits::{LimitChecker, Limits, Violation};
use powderline_shared::plan::StartPose;
use powderline_shared::pose::Pose;
use proptest::prelude::*;

const LIMITS: Limits = Limits {
    workspace_min_m: [-0.05, -0.3, -0.3],
    workspace_max_m: [0.05, 0.3, 0.3],
    linear_velocity_m_s: 0.2,
    linear_acceleration_m_s2: 5.0,
    linear_jerk_m_s3: 400.0,
    angular_velocity_rad_s: 1.0,
    angular_acceleration_rad_s2: 20.0,
    angular_jerk_rad_s3: 2_000.0,
};

const PERIOD_US: u32 = 10_000;

fn anchor() -> Pose {
    StartPose { position_m: [0.01, 0.1, -0.1], orientation_wxyz: [0.1, -0.7, 0.5, 0.5] }.pose()
}

/// Every setpoint checked with all its digits, as the arm does.
fn plainly(setpoints: &[Setpoint], lsb: Lsb) -> Option<Violation> {
    let mut checker = LimitChecker::new(LIMITS, lsb, PERIOD_US, anchor());
    let found = setpoints.iter().find_map(|setpoint| {
        let pose = if setpoint.tick == 0 { anchor() } else { pose_at(&anchor(), *setpoint, lsb) };
        checker.check(pose).err()
    });
    found.or_else(|| checker.finish().err())
}

fn guarded(setpoints: &[Setpoint], lsb: Lsb) -> Option<Violation> {
    let mut guard = Guard::new(anchor(), LIMITS, lsb, PERIOD_US, setpoints.len() as u32);
    setpoints.iter().find_map(|setpoint| guard.check(*setpoint).err())
}

/// Setpoints of a walk by these jerks, as shares of the limits and more.
fn walk(jerks: &[[f64; 6]], hard: f64, lsb: Lsb) -> Vec<Setpoint> {
    let (h, [mut a, mut v, mut x]) = (f64::from(PERIOD_US) / 1e6, [[0.0; 6]; 3]);
    let mut setpoints = Vec::new();
    for (tick, jerk) in (1..).zip(jerks) {
        for axis in 0..6 {
            let (most, unit) =
                if axis < 3 { (400.0, lsb.translation_m()) } else { (2_000.0, lsb.rotation_rad()) };
            a[axis] += hard * most * jerk[axis] * h;
            v[axis] += a[axis] * h;
            x[axis] += v[axis] * h / unit;
        }
        setpoints.push(Setpoint { tick, counts: x.map(|x| x.round() as i32) });
    }
    setpoints
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4_000))]

    /// To the bits of the number in the message.
    #[test]
    fn the_guard_finds_what_the_limits_find(
        jerks in prop::collection::vec(prop::array::uniform6(-1.0..1.0_f64), 1..40), hard in 0.02..1.0_f64, fine: bool,
    ) {
        let lsb = if fine { Lsb::default() } else { Lsb { translation_nm: 1_000, rotation_nrad: 10_000 } };
        let setpoints = walk(&jerks, hard, lsb);
        prop_assert_eq!(guarded(&setpoints, lsb), plainly(&setpoints, lsb));
    }

    /// From the anchor at once, beyond a limit or just below.
    #[test]
    fn the_first_ticks_are_no_exception(counts in prop::array::uniform6(-6_000..6_000_i32), few in 1..1_000_i32, tick in 1..4_u32) {
        let lsb = Lsb::default();
        let at = |tick| Setpoint { tick, counts: [0; 6] };
        let mut setpoints: Vec<Setpoint> = (1..tick).map(at).collect();
        setpoints.push(Setpoint { tick, counts: counts.map(|count| count / few) });
        prop_assert_eq!(guarded(&setpoints, lsb), plainly(&setpoints, lsb));
    }
}

/// A motion at nine tenths of its limits, which passes at little cost, and one that breaks each of them by one per mille.
#[test]
fn each_limit_is_found_at_its_edge() {
    let lsb = Lsb { translation_nm: 1, rotation_nrad: 1 };
    // A sudden step from rest: velocity, acceleration and jerk at once, of which jerk is the tightest here.
    let h = f64::from(PERIOD_US) / 1e6;
    for (axis, jerk, unit) in [(1, 400.0, lsb.translation_m()), (5, 2_000.0, lsb.rotation_rad())] {
        for (share, breaks) in [(0.9, false), (0.9995, false), (1.001, true)] {
            let mut counts = [0; 6];
            counts[axis] = (share * jerk * h * h * h / unit) as i32;
            let setpoints: Vec<Setpoint> = (1..3).map(|tick| Setpoint { tick, counts }).collect();
            let (found, plain) = (guarded(&setpoints[..1], lsb), plainly(&setpoints[..1], lsb));
            assert_eq!(found, plain);
            let mut guard = Guard::new(anchor(), LIMITS, lsb, PERIOD_US, 9);
            assert_eq!(guard.check(setpoints[0]).is_err(), breaks, "{axis} {share}");
        }
    }
}
