//! How long the skill's segments last, for judging a scene before any motion is made.
//!
//! A segment of travel D at mean speed v lasts D / v, and with minimum jerk at least as long as the limits ask:
//! 15/8 D / v_max, sqrt(10/sqrt(3) D' / a_max), cbrt(60 D' / j_max), where D'^2 = D^2 + D_0^2 and D_0 is the travel
//! of one control period, as the skill's durations have it to be smooth at D = 0. Segments that move and turn take the longest of
//! both. `continuous` timing joins the terms by the norm of order 16, a smooth upper bound of the longest;
//! `rounded` timing rounds to control steps.

use super::{Limits, Profile, Scene, Skill, Timing};

/// Travel D of a segment's translation or rotation, with the speed and limits that hold for it.
#[derive(Clone, Copy)]
struct Leg {
    travel: f64,
    /// Travel of one control period.
    floor: f64,
    speed: f64,
    velocity: f64,
    acceleration: f64,
    jerk: f64,
}

impl Leg {
    fn linear(travel_m: f64, period_s: f64, skill: &Skill, limits: &Limits) -> Self {
        Self {
            travel: travel_m,
            floor: skill.linear_speed_m_s * period_s,
            speed: skill.linear_speed_m_s,
            velocity: limits.linear_velocity_m_s,
            acceleration: limits.linear_acceleration_m_s2,
            jerk: limits.linear_jerk_m_s3,
        }
    }

    fn angular(travel_deg: f64, period_s: f64, skill: &Skill, limits: &Limits) -> Self {
        Self {
            travel: travel_deg.to_radians(),
            floor: skill.angular_speed_rad_s * period_s,
            speed: skill.angular_speed_rad_s,
            velocity: limits.angular_velocity_rad_s,
            acceleration: limits.angular_acceleration_rad_s2,
            jerk: limits.angular_jerk_rad_s3,
        }
    }

    fn by_speed_s(&self) -> f64 {
        self.travel / self.speed
    }

    fn by_limits_s(&self) -> [f64; 3] {
        let travel = self.travel.hypot(self.floor);
        [
            1.875 * self.travel / self.velocity,
            (10.0 / 3f64.sqrt() * travel / self.acceleration).sqrt(),
            (60.0 * travel / self.jerk).cbrt(),
        ]
    }
}

impl Scene {
    /// Duration of the longest skill within the bounds (theta = 1 throughout), seconds, rest excluded.
    pub fn longest_skill_s(&self) -> f64 {
        let (skill, limits) = (&self.skill, &self.limits);
        let period_s = self.time.control_period_s();
        let linear = |travel_m| Leg::linear(travel_m, period_s, skill, limits);
        let angular = |travel_deg| Leg::angular(travel_deg, period_s, skill, limits);
        [
            vec![linear(skill.approach_m)],
            vec![linear(skill.scooping_depth_m[1])],
            vec![linear(skill.sweep_m), angular(skill.scooping_angle_deg[1])],
            vec![linear(skill.lift_height_m[1])],
            vec![linear(skill.transport_displacement_m[1])],
            vec![angular(skill.pouring_angle_deg[1])],
        ]
        .iter()
        .map(|legs| self.segment_s(legs))
        .sum()
    }

    fn segment_s(&self, legs: &[Leg]) -> f64 {
        let by_speed = legs.iter().map(Leg::by_speed_s);
        let by_limits: Vec<f64> = match self.skill.profile {
            Profile::ConstantSpeed => Vec::new(),
            Profile::MinimumJerk => legs.iter().flat_map(Leg::by_limits_s).collect(),
        };
        match self.skill.timing {
            Timing::Continuous => norm_16(by_speed.chain(by_limits)),
            Timing::Rounded => {
                let period_s = self.time.control_period_s();
                let steps = (longest(by_speed) / period_s).round();
                let least_steps = (longest(by_limits) / period_s).ceil();
                steps.max(least_steps).max(1.0) * period_s
            }
        }
    }
}

fn longest(durations: impl IntoIterator<Item = f64>) -> f64 {
    durations.into_iter().fold(0.0, f64::max)
}

fn norm_16(terms: impl Iterator<Item = f64>) -> f64 {
    let terms: Vec<f64> = terms.collect();
    let scale = longest(terms.iter().copied());
    if scale <= 0.0 {
        return 0.0;
    }
    terms.iter().map(|term| (term / scale).powi(16)).sum::<f64>().powf(1.0 / 16.0) * scale
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn longest_skill_at_constant_speed_is_the_sum_of_travel_over_speed() {
        let mut scene = Scene::load("bench").unwrap();
        scene.skill.profile = Profile::ConstantSpeed;
        scene.skill.sweep_m = 0.0;
        let travel_m = 0.020 + 0.020 + 0.090 + 0.160;
        let turn_rad = (100.0f64 + 160.0).to_radians();
        let expected_s = travel_m / scene.skill.linear_speed_m_s + turn_rad / scene.skill.angular_speed_rad_s;
        assert!((scene.longest_skill_s() - expected_s).abs() < 1e-12);
        scene.skill.timing = Timing::Rounded;
        assert!((scene.longest_skill_s() - expected_s).abs() < 6.0 * 0.005);
    }

    #[test]
    fn limits_lengthen_minimum_jerk_segments() {
        let mut scene = Scene::load("bench").unwrap();
        let before_s = scene.longest_skill_s();
        scene.limits.linear_acceleration_m_s2 *= 0.1;
        assert!(scene.longest_skill_s() > before_s + 0.1);
    }
}
