//! How long a scene's skills last, for judging the scene before any motion is made.

use super::Scene;
use crate::skill::{SkillMap, Theta};

impl Scene {
    /// Duration of the longest skill within the bounds (theta = 1 throughout), seconds, rest excluded.
    pub fn longest_skill_s(&self) -> f64 {
        SkillMap::new(self).duration_s(&Theta::clamped([1.0; 5]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Profile, Timing};

    #[test]
    fn longest_skill_at_constant_speed_is_the_sum_of_travel_over_speed() {
        let mut scene = Scene::load("bench").unwrap();
        scene.skill.profile = Profile::ConstantSpeed;
        scene.skill.sweep_m = 0.0;
        let travel_m = 0.020 + 0.020 + 0.090 + 0.160;
        let [scoop_deg, pour_deg] = [scene.skill.scooping_angle_deg[1], scene.skill.pouring_angle_deg[1]];
        let turn_rad = (scoop_deg + pour_deg).to_radians();
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
