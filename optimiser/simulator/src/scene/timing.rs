//! How long a scene's skills last, for judging the scene before any motion is made.

use super::{Scene, Timing};
use crate::skill::{SkillMap, Theta};

/// Transports between the ends of the range that are looked at where durations are rounded.
const ROUNDED_TRANSPORTS: u32 = 1000;

impl Scene {
    /// Duration of the longest skill within the bounds, seconds, rest excluded: theta = 1 throughout, but with an overlap perhaps -1 for the
    /// transport, of which little leaves little to overlap; in whole control steps one in between may leave less than either end.
    pub fn longest_skill_s(&self) -> f64 {
        let map = SkillMap::new(self);
        let lasts_s = |transport| map.duration_s(&Theta::clamped([1.0, 1.0, 1.0, transport, 1.0]));
        let parts = match self.skill.timing == Timing::Rounded && self.skill.overlap > 0.0 {
            true => ROUNDED_TRANSPORTS,
            false => 1,
        };
        let transports = (0..=parts).map(|part| 2.0 * f64::from(part) / f64::from(parts) - 1.0);
        transports.map(lasts_s).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Profile;

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

    /// In whole control steps a transport in between may leave less to overlap than either end.
    #[test]
    fn no_rounded_skill_lasts_longer_than_the_longest() {
        let mut scene = Scene::load("bench").unwrap();
        (scene.skill.timing, scene.skill.overlap) = (Timing::Rounded, 1.0);
        scene.skill.transport_displacement_m = [0.001, 0.16];
        let (map, longest_s) = (SkillMap::new(&scene), scene.longest_skill_s());
        for transport in (0..=4000).map(|part| f64::from(part) / 2000.0 - 1.0) {
            let theta = Theta::clamped([1.0, 1.0, 1.0, transport, 1.0]);
            assert!(map.duration_s(&theta) <= longest_s + 1e-12, "{theta}");
        }
    }

    /// Also where a short transport leaves little to overlap.
    #[test]
    fn no_skill_lasts_longer_than_the_longest() {
        for (transport_m, overlap, is_shortest) in
            [([0.06, 0.16], 0.0, false), ([0.06, 0.16], 1.0, false), ([0.001, 0.03], 1.0, true)]
        {
            let mut scene = Scene::load("bench").unwrap();
            (scene.skill.transport_displacement_m, scene.skill.overlap) = (transport_m, overlap);
            let (map, longest_s) = (SkillMap::new(&scene), scene.longest_skill_s());
            for place in 0..3u32.pow(5) {
                let at = |k: u32| f64::from(place / 3u32.pow(k) % 3) - 1.0;
                let theta = Theta::clamped([0, 1, 2, 3, 4].map(at));
                assert!(map.duration_s(&theta) <= longest_s + 1e-12, "{theta} {transport_m:?} {overlap}");
            }
            let usual_s = map.duration_s(&Theta::clamped([1.0; 5]));
            assert_eq!(longest_s > usual_s + 0.01, is_shortest, "{longest_s} {usual_s}");
        }
    }

    #[test]
    fn limits_lengthen_minimum_jerk_segments() {
        let mut scene = Scene::load("bench").unwrap();
        let before_s = scene.longest_skill_s();
        scene.limits.linear_acceleration_m_s2 *= 0.1;
        assert!(scene.longest_skill_s() > before_s + 0.1);
    }
}
