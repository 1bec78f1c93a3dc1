//! A plan's motion made faster, as long as no more powder is lost by that.
//!
//! Three numbers say how much, each from 0 to 1: lift, transport and pour overlap more, from as the scene has it to 1, and the mean speeds
//! rise, linear and angular, from the scene's to those whose peaks are the arm's limits. One after the other is taken as far as all is well, by halving. Minimum-jerk
//! segments keep the limits whatever they are. Scooping is faster as well, but nothing overlaps as long as the tool is in the bed, so what the tool holds changes
//! little; that is put right afterwards ([`crate::refine`]).

use crate::{failure::Failure, report::amounts::Amounts};
use powderline_simulator::{
    rollout::Census,
    scene::{Profile, Scene, SceneError, figures::mass},
    skill::{SkillMap, Theta},
};
use serde::{Deserialize, Serialize};

/// How often the haste is halved between one that is well and one that is not.
const HALVINGS: u32 = 3;

/// Of what is wanted, what may be lost more than before, over the tolerance.
const LOST_MORE: f64 = 0.25;
/// The tolerance of a scene that wants as much as can be had.
const USUAL_TOLERANCE: f64 = 0.02;
/// Of what arrived, what may arrive less or more before that is put right.
const WITHIN_REACH: f64 = 0.2;

/// How much faster a motion is, each from 0 to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Haste {
    /// Of the overlap, up to 1.
    pub overlap: f64,
    /// Of the linear speed, up to the arm's limit.
    pub linear: f64,
    /// Of the angular speed.
    pub angular: f64,
}

impl Haste {
    /// In the order in which they are taken: what saves most first.
    fn parts(&mut self) -> [&mut f64; 3] {
        [&mut self.overlap, &mut self.linear, &mut self.angular]
    }
}

/// The scene with a skill that is made in haste, and a horizon as much shorter as this skill's motion is.
///
/// # Errors
/// One sentence; of a valid scene there is none.
pub fn hastened(scene: &Scene, theta: &Theta, haste: &Haste) -> Result<Scene, Failure> {
    let peak = scene.skill.profile.peak_over_mean();
    let faster = |speed: f64, limit: f64, haste| speed * libm::pow((limit / peak / speed).max(1.0), haste);
    let unfit = |error: SceneError| Failure::Input(error.to_string());
    let quick = scene
        .with(|spec| {
            let (skill, limits) = (&mut spec.skill, &spec.limits);
            skill.linear_speed_m_s = faster(skill.linear_speed_m_s, limits.linear_velocity_m_s, haste.linear);
            skill.angular_speed_rad_s =
                faster(skill.angular_speed_rad_s, limits.angular_velocity_rad_s, haste.angular);
            if skill.profile == Profile::MinimumJerk {
                skill.overlap += haste.overlap * (1.0 - skill.overlap);
            }
        })
        .map_err(unfit)?;
    let period_s = scene.time.control_period_s();
    let saved = ((duration_s(scene, theta) - duration_s(&quick, theta)) / period_s + 1e-6).max(0.0) as u32;
    // The longest skill, which may save less, has room still.
    let longest = ((quick.longest_skill_s() - 1e-9) / period_s).ceil() as u32;
    let steps = scene.time.horizon_steps;
    quick
        .with(|spec| spec.time.horizon_steps = steps.saturating_sub(saved).max(longest.min(steps)))
        .map_err(unfit)
}

/// How long a skill's motion takes, without the rest after it, seconds.
pub fn duration_s(scene: &Scene, theta: &Theta) -> f64 {
    SkillMap::new(scene).duration_s(theta)
}

/// Whether a faster motion is as good as before: hardly more is lost, and so much arrives that a change of the skill puts it right; where as
/// much as can be had is wanted, hardly less.
pub fn holds(amounts: &Amounts, before: &Census, now: &Census) -> bool {
    let [before_kg, now_kg] = [before, now].map(|census| amounts.kg(census.target));
    let arrives = match amounts.tolerance {
        Some(_) => (now_kg - before_kg).abs() <= WITHIN_REACH * before_kg,
        None => brings_less(amounts, before_kg, now_kg).is_none(),
    };
    arrives && loses_more(amounts, amounts.kg(before.lost()), amounts.kg(now.lost())).is_none()
}

/// That a faster motion brings less than it may where as much as can be had is wanted, in a sentence.
pub fn brings_less(amounts: &Amounts, before_kg: f64, now_kg: f64) -> Option<String> {
    let less_kg = most_worse_kg(amounts);
    (amounts.tolerance.is_none() && now_kg < before_kg - less_kg * (1.0 + 1e-9)).then(|| {
        format!(
            "{} arrive, before {}, and a faster motion may bring {} less; the plan as it was brings more",
            mass(now_kg),
            mass(before_kg),
            mass(less_kg)
        )
    })
}

/// How much more a faster motion may lose, or less it may bring, kilogram.
fn most_worse_kg(amounts: &Amounts) -> f64 {
    LOST_MORE * amounts.tolerance.unwrap_or(USUAL_TOLERANCE) * amounts.wanted_kg
}

/// That a faster motion loses more than it may, in a sentence.
pub fn loses_more(amounts: &Amounts, before_kg: f64, now_kg: f64) -> Option<String> {
    let more_kg = most_worse_kg(amounts);
    (now_kg > before_kg + more_kg * (1.0 + 1e-9)).then(|| {
        format!(
            "{} are lost, before {}, and a faster motion may lose {} more; the plan as it was loses less",
            mass(now_kg),
            mass(before_kg),
            mass(more_kg)
        )
    })
}

/// The most haste that is well, as far as a few looks tell; none if no haste at all is.
///
/// # Errors
/// What a look ends with.
pub fn most_haste(
    is_well: &mut dyn FnMut(&Haste) -> Result<bool, Failure>,
) -> Result<Option<Haste>, Failure> {
    let mut well = Haste::default();
    for part in 0..well.parts().len() {
        let mut with = |value: f64| {
            let mut haste = well;
            *haste.parts()[part] = value;
            Ok::<_, Failure>(is_well(&haste)?.then_some(haste))
        };
        let (mut best, mut too_much) = (None, 1.0);
        let mut next = too_much;
        for _ in 0..=HALVINGS {
            match with(next)? {
                Some(haste) => best = Some((next, haste)),
                None => too_much = next,
            }
            let reached = best.map_or(0.0, |(value, _)| value);
            if reached >= too_much {
                break;
            }
            next = 0.5 * (reached + too_much);
        }
        well = best.map_or(well, |(_, haste)| haste);
    }
    Ok((well != Haste::default()).then_some(well))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: Haste = Haste { overlap: 1.0, linear: 1.0, angular: 1.0 };
    const OVERLAP: Haste = Haste { linear: 0.0, angular: 0.0, ..ALL };
    const LINEAR: Haste = Haste { overlap: 0.0, angular: 0.0, ..ALL };
    const ANGULAR: Haste = Haste { overlap: 0.0, linear: 0.0, ..ALL };

    #[test]
    fn haste_takes_the_arm_to_its_limits_and_keeps_them() {
        let scene = Scene::load("bench").unwrap();
        let theta = Theta::clamped([0.3, 0.0, 0.0, 0.0, 0.3]);
        let mut last_s = duration_s(&scene, &theta);
        let rest = |scene: &Scene| scene.time.horizon_s() - duration_s(scene, &theta);
        for share in [0.25, 0.5, 0.75, 1.0] {
            let haste = Haste { overlap: share, linear: share, angular: share };
            let quick = hastened(&scene, &theta, &haste).unwrap();
            let map = SkillMap::new(&quick);
            map.check_all_corners().unwrap();
            let now_s = duration_s(&quick, &theta);
            assert!(now_s < last_s - 0.1, "{haste:?}: {last_s} {now_s}");
            last_s = now_s;
            // The powder has as long to come to rest, to a control step.
            assert!((rest(&quick) - rest(&scene)).abs() < 0.0101, "{haste:?}");
        }
        let quick = hastened(&scene, &theta, &ALL).unwrap().into_spec().skill;
        assert!((quick.linear_speed_m_s - 0.3 / 1.875).abs() < 1e-12 && (quick.overlap - 1.0).abs() < 1e-12);
        assert_eq!(hastened(&scene, &theta, &Haste::default()).unwrap(), scene);
    }

    /// Also where the horizon is as short as the longest skill allows, whichever skill is made faster.
    #[test]
    fn the_horizon_has_room_for_every_skill_still() {
        let usual = ["bench", "bench-small", "vial", "workcell"].map(|name| Scene::load(name).unwrap());
        // Where the scooping of small angles takes as long as its sweep, and that of large ones longer.
        let sweeping = usual[0].with(|spec| {
            spec.skill.scooping_angle_deg = [5.0, 110.0];
            spec.limits.linear_velocity_m_s = 0.5;
        });
        for scene in usual.into_iter().chain([sweeping.unwrap()]) {
            let name = scene.name.clone();
            let least = (scene.longest_skill_s() / scene.time.control_period_s()).ceil() as u32;
            let scene = scene.with(|spec| spec.time.horizon_steps = least).unwrap();
            for corner in 0..32 {
                let sign = |k: u32| if corner >> k & 1 == 1 { 1.0 } else { -1.0 };
                let theta = Theta::clamped([0, 1, 2, 3, 4].map(sign));
                for haste in [ALL, OVERLAP, LINEAR, ANGULAR, Haste { overlap: 0.0, ..ALL }] {
                    let quick = hastened(&scene, &theta, &haste);
                    assert!(
                        quick.is_ok_and(|quick| quick.time.horizon_steps <= least),
                        "{name} {theta} {haste:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn what_is_faster_than_the_limits_already_stays() {
        let fast = Scene::load("bench").unwrap().with(|spec| spec.skill.linear_speed_m_s = 0.25).unwrap();
        let quick = hastened(&fast, &Theta::MIDDLE, &ALL).unwrap();
        assert!((quick.skill.linear_speed_m_s - 0.25).abs() < 1e-12);
    }

    #[test]
    fn each_kind_of_haste_is_taken_as_far_as_all_is_well() {
        // How much of each is well, and what is found of it.
        for (limits, found) in [
            ([2.0, 2.0, 2.0], Some([1.0, 1.0, 1.0])),
            ([0.8, 0.3, 0.13], Some([0.75, 0.25, 0.125])),
            ([0.95, 0.1, 0.5], Some([0.875, 0.0, 0.5])),
            ([0.1, 0.0, 0.12], None),
        ] {
            let mut looks = 0;
            let mut is_well = |haste: &Haste| {
                looks += 1;
                Ok([haste.overlap, haste.linear, haste.angular]
                    .iter()
                    .zip(limits)
                    .all(|(x, limit)| *x <= limit))
            };
            let most = most_haste(&mut is_well).unwrap();
            assert_eq!(most.map(|haste| [haste.overlap, haste.linear, haste.angular]), found);
            assert!(looks <= 12, "{looks}");
        }
        let stopped = || Failure::Interrupted("stopped".into());
        assert_eq!(most_haste(&mut |_| Err(stopped())), Err(stopped()));
    }

    #[test]
    fn more_that_is_lost_does_not_hold_and_neither_does_what_is_out_of_reach() {
        let amounts = Amounts::from(&Scene::load("bench").unwrap());
        // Of 1,200 particles a quarter of two per cent is six.
        let census = |target, spilled| Census { target, spilled, ..Census::default() };
        let before = census(1200, 10);
        for (now, well) in [
            (census(1210, 16), true),
            (census(1210, 17), false),
            (census(950, 0), false),
            (census(1000, 0), true),
        ] {
            assert_eq!(holds(&amounts, &before, &now), well, "{now:?}");
        }
        // Where nobody puts the amount right, hardly less may arrive.
        let greedy = Amounts { tolerance: None, ..amounts };
        for (now, well) in [(1194, true), (1193, false), (1500, true)] {
            assert_eq!(holds(&greedy, &before, &census(now, 0)), well, "{now:?}");
        }
        let words = brings_less(&greedy, 9.6e-3, 9.5e-3).unwrap();
        assert!(
            words.starts_with("9.5 g arrive, before 9.6 g, and a faster motion may bring 48 mg less;"),
            "{words}"
        );
        // A quarter of two per cent of 9.6 g.
        assert_eq!(loses_more(&amounts, 80e-6, 128e-6), None);
        let words = loses_more(&amounts, 80e-6, 130e-6).unwrap();
        assert!(
            words.starts_with("130 mg are lost, before 80 mg, and a faster motion may lose 48 mg more;"),
            "{words}"
        );
    }
}
