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
//!
//! An arm that has joints goes that way joint by joint: what is between two poses that it can take, it can take.

use nalgebra::{SVector, Vector6};
use powderline_shared::arm::Joints;
use powderline_shared::displacement::Displacement;
use powderline_shared::pose::Pose;

use crate::arm::Target;

/// Cubic path from one target to the next.
#[derive(Clone, Copy, Debug)]
pub struct Interpolator {
    from: Target,
    to: Target,
    step: Step,
    tangents: [Step; 2],
    start_us: u64,
    period_us: u32,
}

/// What changes in one tick.
#[derive(Clone, Copy, Debug)]
struct Step {
    tool: Displacement,
    joints: Vector6<f64>,
}

impl Step {
    fn none() -> Self {
        Self { tool: Displacement::default(), joints: Vector6::zeros() }
    }

    fn between(from: &Target, to: &Target) -> Self {
        let of = |target: &Target| Vector6::from(target.joints.unwrap_or_default());
        Self { tool: from.pose.displacement_to(&to.pose), joints: of(to) - of(from) }
    }

    fn mean(&self, other: &Self) -> Self {
        let tool = Displacement {
            translation_m: ((self.tool.translation() + other.tool.translation()) / 2.0).into(),
            rotation_rad: ((self.tool.rotation() + other.tool.rotation()) / 2.0).into(),
        };
        Self { tool, joints: (self.joints + other.joints) / 2.0 }
    }
}

impl Interpolator {
    /// Stays at a target.
    #[must_use]
    pub fn hold(target: Target) -> Self {
        let none = Step::none();
        Self { from: target, to: target, step: none, tangents: [none; 2], start_us: 0, period_us: 1 }
    }

    /// Goes on to `to` within one period that starts at `start_us`; `after` is the target of the tick after, if known.
    #[must_use]
    pub fn extended(&self, to: Target, after: Option<Target>, start_us: u64, period_us: u32) -> Self {
        let step = Step::between(&self.to, &to);
        let [_, reached] = self.tangents;
        let leaving = after.map_or(step, |after| step.mean(&Step::between(&to, &after)));
        Self { from: self.to, to, step, tangents: [reached, leaving], start_us, period_us }
    }

    /// Where it leads.
    #[must_use]
    pub fn end(&self) -> &Target {
        &self.to
    }

    /// What is commanded: the end once the period is over, before it the pose, or, of an arm that has joints, these.
    #[must_use]
    pub fn at(&self, now_us: u64) -> Commanded {
        let elapsed_us = now_us.saturating_sub(self.start_us);
        if elapsed_us >= u64::from(self.period_us) {
            return Commanded::End(self.to);
        }
        #[expect(clippy::cast_precision_loss, reason = "less than a period, which fits 32 bits")]
        let s = elapsed_us as f64 / f64::from(self.period_us);
        match self.from.joints {
            Some(joints) => Commanded::Joints(self.joints_at(s, &joints)),
            None => Commanded::Pose(self.pose_at(s)),
        }
    }

    fn joints_at(&self, s: f64, from: &Joints) -> Joints {
        let [m0, m1] = self.tangents;
        (Vector6::from(*from) + hermite(s, &m0.joints, &self.step.joints, &m1.joints)).into()
    }

    fn pose_at(&self, s: f64) -> Pose {
        let [m0, m1] = self.tangents;
        let part = |pick: fn(&Displacement) -> SVector<f64, 3>| {
            hermite(s, &pick(&m0.tool), &pick(&self.step.tool), &pick(&m1.tool))
        };
        self.from.pose.displaced(&Displacement {
            translation_m: part(Displacement::translation).into(),
            rotation_rad: part(Displacement::rotation).into(),
        })
    }
}

/// What a path says at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Commanded {
    /// To be at its end.
    End(Target),
    /// To have these joints.
    Joints(Joints),
    /// To have the tool there, however.
    Pose(Pose),
}

fn hermite<const N: usize>(
    s: f64,
    m0: &SVector<f64, N>,
    d: &SVector<f64, N>,
    m1: &SVector<f64, N>,
) -> SVector<f64, N> {
    m0 * (s * (1.0 - s) * (1.0 - s)) + d * (s * s * (3.0 - 2.0 * s)) - m1 * (s * s * (1.0 - s))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64) -> Target {
        let turn = Displacement { translation_m: [x, 0.0, 0.0], rotation_rad: [0.0, 0.0, 3.0 * x] };
        Target::pose(Pose::identity().displaced(&turn))
    }

    fn jointed(x: f64) -> Target {
        Target { joints: Some([x, 0.0, 2.0 * x, 0.0, 0.0, -x]), ..at(x) }
    }

    /// Along x, of the tool or of the first joint.
    fn x_of(commanded: Commanded) -> f64 {
        match commanded {
            Commanded::End(target) => target.joints.map_or(target.pose.position_m.x, |[x, ..]| x),
            Commanded::Joints([x, ..]) => x,
            Commanded::Pose(pose) => pose.position_m.x,
        }
    }

    #[test]
    fn setpoints_are_passed_exactly_and_constant_speed_is_kept() {
        for at in [at, jointed] {
            let mut path = Interpolator::hold(at(0.0));
            for tick in 0..10_u32 {
                let x = |tick: u32| 0.001 * f64::from(tick);
                let start_us = u64::from(tick) * 1_000;
                path = path.extended(at(x(tick + 1)), Some(at(x(tick + 2))), start_us, 1_000);
                assert_eq!(path.at(start_us + 1_000), Commanded::End(at(x(tick + 1))));
                if tick > 1 {
                    let found = x_of(path.at(start_us + 250));
                    assert!((found - 0.001 * (f64::from(tick) + 0.25)).abs() < 1e-12, "{found}");
                }
            }
        }
    }

    #[test]
    fn velocity_is_continuous_across_ticks() {
        for at in [at, jointed] {
            let mut path = Interpolator::hold(at(0.0));
            let x = |tick: i32| 0.001 * f64::from(tick * tick);
            let mut last: Option<f64> = None;
            for tick in 0..8 {
                let start_us = 1_000 * u64::try_from(tick).unwrap();
                path = path.extended(at(x(tick + 1)), Some(at(x(tick + 2))), start_us, 1_000);
                let speed = |now_us| x_of(path.at(now_us + 1)) - x_of(path.at(now_us));
                if let Some(last) = last {
                    assert!((speed(start_us) - last).abs() < 0.01 * last.abs() + 1e-8);
                }
                last = Some(speed(start_us + 999));
            }
        }
    }

    #[test]
    fn after_its_period_a_path_stays_at_its_end() {
        let path = Interpolator::hold(at(0.0)).extended(at(0.1), None, 0, 1_000);
        assert_eq!(path.at(u64::MAX), Commanded::End(at(0.1)));
    }
}
