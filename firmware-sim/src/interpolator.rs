//! The path between two ticks.
//!
//! | symbol | identifier    | meaning                                                                      |
//! |--------|---------------|------------------------------------------------------------------------------|
//! | d      | `step`        | displacement of the tick (translation, rotation vector)                      |
//! | m0, m1 | `tangents`    | velocity times period at both ends: the mean of the steps before and after   |
//! | s      | share         | time within the period, 0..1                                                 |
//!
//! ```text
//! r(s) = (s^3 - 2 s^2 + s) m0 + (3 s^2 - 2 s^3) d + (s^3 - s^2) m1;     pose(s) = (p + r_t(s), exp(r_r(s)) R)
//! ```
//!
//! Setpoints are passed exactly, the velocity has no jumps. (For rotation the tangents are taken as if the rotations of
//! one tick commuted; the error is of second order in the angle of one tick.)

use nalgebra::Vector3;
use powderline_shared::displacement::Displacement;
use powderline_shared::pose::Pose;

/// Cubic path from one pose to the next.
#[derive(Clone, Copy, Debug)]
pub struct Interpolator {
    from: Pose,
    to: Pose,
    step: Displacement,
    tangents: [Displacement; 2],
    start_us: u64,
    period_us: u32,
}

impl Interpolator {
    /// Stays at a pose.
    #[must_use]
    pub fn hold(pose: Pose) -> Self {
        let none = Displacement::default();
        Self { from: pose, to: pose, step: none, tangents: [none; 2], start_us: 0, period_us: 1 }
    }

    /// Goes on to `to` within one period that starts at `start_us`; `after` is the pose of the tick after, if known.
    #[must_use]
    pub fn extended(&self, to: Pose, after: Option<Pose>, start_us: u64, period_us: u32) -> Self {
        let step = self.to.displacement_to(&to);
        let [_, reached] = self.tangents;
        let leaving = after.map_or(step, |after| mean(&step, &to.displacement_to(&after)));
        Self { from: self.to, to, step, tangents: [reached, leaving], start_us, period_us }
    }

    /// The commanded pose.
    #[must_use]
    pub fn pose_at(&self, now_us: u64) -> Pose {
        let elapsed_us = now_us.saturating_sub(self.start_us);
        if elapsed_us >= u64::from(self.period_us) {
            return self.to;
        }
        #[expect(clippy::cast_precision_loss, reason = "less than a period, which fits 32 bits")]
        let s = elapsed_us as f64 / f64::from(self.period_us);
        let [m0, m1] = self.tangents;
        let part =
            |pick: fn(&Displacement) -> Vector3<f64>| hermite(s, &pick(&m0), &pick(&self.step), &pick(&m1));
        self.from.displaced(&Displacement {
            translation_m: part(Displacement::translation).into(),
            rotation_rad: part(Displacement::rotation).into(),
        })
    }
}

fn mean(a: &Displacement, b: &Displacement) -> Displacement {
    Displacement {
        translation_m: ((a.translation() + b.translation()) / 2.0).into(),
        rotation_rad: ((a.rotation() + b.rotation()) / 2.0).into(),
    }
}

fn hermite(s: f64, m0: &Vector3<f64>, d: &Vector3<f64>, m1: &Vector3<f64>) -> Vector3<f64> {
    m0 * (s * (1.0 - s) * (1.0 - s)) + d * (s * s * (3.0 - 2.0 * s)) - m1 * (s * s * (1.0 - s))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64) -> Pose {
        let turn = Displacement { translation_m: [x, 0.0, 0.0], rotation_rad: [0.0, 0.0, 3.0 * x] };
        Pose::identity().displaced(&turn)
    }

    #[test]
    fn setpoints_are_passed_exactly_and_constant_speed_is_kept() {
        let mut path = Interpolator::hold(at(0.0));
        for tick in 0..10_u32 {
            let x = |tick: u32| 0.001 * f64::from(tick);
            let start_us = u64::from(tick) * 1_000;
            path = path.extended(at(x(tick + 1)), Some(at(x(tick + 2))), start_us, 1_000);
            assert_eq!(path.pose_at(start_us + 1_000), at(x(tick + 1)));
            if tick > 1 {
                let found = path.pose_at(start_us + 250).position_m.x;
                assert!((found - 0.001 * (f64::from(tick) + 0.25)).abs() < 1e-12, "{found}");
            }
        }
    }

    #[test]
    fn velocity_is_continuous_across_ticks() {
        let mut path = Interpolator::hold(at(0.0));
        let x = |tick: i32| 0.001 * f64::from(tick * tick);
        let mut last: Option<f64> = None;
        for tick in 0..8 {
            let start_us = 1_000 * u64::try_from(tick).unwrap();
            path = path.extended(at(x(tick + 1)), Some(at(x(tick + 2))), start_us, 1_000);
            let speed = |now_us| path.pose_at(now_us + 1).position_m.x - path.pose_at(now_us).position_m.x;
            if let Some(last) = last {
                assert!((speed(start_us) - last).abs() < 0.01 * last.abs() + 1e-8);
            }
            last = Some(speed(start_us + 999));
        }
    }

    #[test]
    fn after_its_period_a_path_stays_at_its_end() {
        let path = Interpolator::hold(at(0.0)).extended(at(0.1), None, 0, 1_000);
        assert_eq!(path.pose_at(u64::MAX), at(0.1));
    }
}
