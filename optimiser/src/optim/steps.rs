//! The search over low-level actions: every displacement of the motion is free, instead of five skill parameters.
//!
//! | symbol | identifier    | equation                                                                      |
//! |--------|---------------|-------------------------------------------------------------------------------|
//! | u      | `controls`    | one displacement for each control step, metres and radians, world frame       |
//! | r      | [`Reach`]     | velocity limit times control period, linear and angular                       |
//! | w      |               | w = u / r, the variables, each in [-1, 1]                                     |
//! | g      | [`DisplacementGradient`]     | of the loss by w: that by u, times r                                          |
//! | w'     |               | w' = clamp(w - lr r' g / (sqrt(v^) + eps)), as for skills                     |
//!
//! The tool is held within the scene's workspace: a displacement that would leave it ends at its border. Accelerations and
//! jerks are free; skills keep the arm's limits by their making, and a motion of free displacements does not.
//!
//! What is kept is u and not w: a search that begins with a skill's displacements begins with their bits.
//!
//! Where a motion has no loss, since powder left the simulated volume or a number was not finite, the search goes back
//! to the best motion known, with the running means that it had there, and leaves it by half the step: every such
//! epoch halves the learning rate for good.
//!
//! As in the search for skills, nothing here simulates, reads a clock or touches a file.

use super::{Pace, RmsProp, search::is_loss};
use powderline_shared::displacement::Displacement;
use powderline_simulator::{rollout::DisplacementGradient, scene::Scene, skill::Control};
use serde::{Deserialize, Serialize};

/// Learning rate, in units of w: of 0.001, 0.003, 0.01, 0.03 and 0.1 that with the lowest loss after ten epochs of
/// `bench-small` with `aim = "all"`, mean of three seeds (then without workspace and halving). Saved searches do not hold it: who
/// changes it raises the version of their files.
const LEARNING_RATE: f64 = 0.03;

/// The longest displacement of one control step along each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    /// Of each component of the translation, metres.
    pub translation_m: f64,
    /// Of each component of the rotation vector, radians.
    pub rotation_rad: f64,
}

impl Reach {
    /// In the order of [`Displacement::components`].
    fn components(&self) -> [f64; 6] {
        let Self { translation_m: t, rotation_rad: r } = *self;
        [t, t, t, r, r, r]
    }

    fn clamped(&self, control: &Control) -> Displacement {
        let reach = self.components();
        Displacement::from(std::array::from_fn(|k| control[k].clamp(-reach[k], reach[k])))
    }

    fn holds(&self, control: &Displacement) -> bool {
        let reach = self.components();
        control.components().iter().zip(reach).all(|(x, reach)| (-reach..=reach).contains(x))
    }
}

/// How the search goes from epoch to epoch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepRule {
    /// What becomes of a slope; all components take part from the first update.
    pub rule: RmsProp,
    /// How far one displacement may go.
    pub reach: Reach,
    /// Where the tool begins, metres.
    pub start_m: [f64; 3],
    /// Least and greatest position of the tool, metres.
    pub workspace_m: [[f64; 3]; 2],
}

impl From<&Scene> for StepRule {
    fn from(scene: &Scene) -> Self {
        let period_s = scene.time.control_period_s();
        Self {
            rule: RmsProp {
                learning_rate: LEARNING_RATE,
                curriculum_epochs: 0,
                ..RmsProp::from(&scene.optimiser)
            },
            reach: Reach {
                translation_m: scene.limits.linear_velocity_m_s * period_s,
                rotation_rad: scene.limits.angular_velocity_rad_s * period_s,
            },
            start_m: scene.tool.start_position_m,
            workspace_m: [scene.limits.workspace_min_m, scene.limits.workspace_max_m],
        }
    }
}

/// Where updates have led.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Place {
    controls: Vec<Displacement>,
    paces: Vec<[Pace; 6]>,
    updates: u32,
}

/// The motion with the lowest loss, and what is needed to leave it again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Best {
    loss: f64,
    place: Place,
    slopes: Vec<DisplacementGradient>,
}

/// A search in progress. Serialises bit for bit (in a binary format, or one that keeps every digit).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepSearch {
    place: Place,
    /// How many times the learning rate was halved.
    halvings: u32,
    best: Option<Best>,
}

impl StepSearch {
    /// A search that begins with these controls, those beyond the reach at its end.
    pub fn new(rule: &StepRule, controls: &[Displacement]) -> Self {
        let clamped = |control: &Displacement| rule.reach.clamped(&control.components());
        let controls: Vec<_> = controls.iter().map(clamped).collect();
        let paces = vec![[Pace::START; 6]; controls.len()];
        Self { place: Place { controls, paces, updates: 0 }, halvings: 0, best: None }
    }

    /// The motion to evaluate next, with its gradient.
    pub fn controls(&self) -> &[Displacement] {
        &self.place.controls
    }

    /// The lowest loss of all motions evaluated, metres.
    pub fn lowest_loss(&self) -> Option<f64> {
        self.best.as_ref().map(|best| best.loss)
    }

    /// How many times the learning rate was halved.
    pub fn halvings(&self) -> u32 {
        self.halvings
    }

    /// The search after its motion was found to have this loss (metres) and these slopes; none if a number is not
    /// finite or missing.
    pub fn onward(&self, rule: &StepRule, loss: f64, slopes: &[DisplacementGradient]) -> Option<Self> {
        if !is_loss(loss) || slopes.len() != self.place.controls.len() {
            return None;
        }
        let place = self.place.updated(rule, self.halvings, slopes)?;
        let best = match &self.best {
            Some(best) if best.loss <= loss => best.clone(),
            _ => Best { loss, place: self.place.clone(), slopes: slopes.into() },
        };
        Some(Self { place, halvings: self.halvings, best: Some(best) })
    }

    /// The search after its motion was found to have no loss; none if there is nothing to go back to.
    pub fn back(&self, rule: &StepRule) -> Option<Self> {
        let best = self.best.clone()?;
        let halvings = self.halvings.saturating_add(1);
        let place = best.place.updated(rule, halvings, &best.slopes)?;
        Some(Self { place, halvings, best: Some(best) })
    }

    /// Whether epochs of a motion of so many control steps can have led here, so that more of them can follow.
    pub fn is_sound(&self, rule: &StepRule, steps: usize) -> bool {
        let best_is_sound = self.best.as_ref().is_none_or(|best| {
            is_loss(best.loss)
                && best.place.is_sound(rule, steps)
                && best.slopes.len() == steps
                && best.place.updated(rule, self.halvings, &best.slopes).is_some()
        });
        self.place.is_sound(rule, steps) && best_is_sound
    }
}

impl Place {
    /// One update down the slopes; none if one of them, or its square, is not finite.
    fn updated(&self, rule: &StepRule, halvings: u32, slopes: &[DisplacementGradient]) -> Option<Self> {
        let StepRule { rule: rmsprop, reach, start_m, workspace_m: [least, greatest] } = rule;
        let mut at = *start_m;
        // Halved more often than that, a step is none.
        let learning_rate = libm::scalbn(rmsprop.learning_rate, -(halvings.min(2000) as i32));
        let rmsprop = RmsProp { learning_rate, ..*rmsprop };
        let updates = self.updates.checked_add(1)?;
        let mut next = Self { updates, ..self.clone() };
        let lines = next.controls.iter_mut().zip(&mut next.paces).zip(slopes);
        for ((control, paces), slope) in lines {
            let (slope, reach_of) = (slope.components(), reach.components());
            let mut moved = control.components();
            for k in 0..6 {
                let (pace, step) = rmsprop.step(&paces[k], slope[k] * reach_of[k], 0.0, updates)?;
                paces[k] = pace;
                moved[k] -= step * reach_of[k];
            }
            for k in 0..3 {
                let to = at[k] + moved[k];
                // Only what would leave the workspace is cut short, so that all else keeps its bits.
                if !(least[k]..=greatest[k]).contains(&to) {
                    moved[k] = to.clamp(least[k], greatest[k]) - at[k];
                }
            }
            *control = reach.clamped(&moved);
            at = std::array::from_fn(|k| at[k] + control.translation_m[k]);
        }
        Some(next)
    }

    fn is_sound(&self, rule: &StepRule, steps: usize) -> bool {
        self.controls.len() == steps
            && self.paces.len() == steps
            && self.updates < u32::MAX
            && self.controls.iter().all(|control| rule.reach.holds(control))
            && self.paces.iter().flatten().all(Pace::is_sound)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RULE: StepRule = StepRule {
        rule: RmsProp { beta: 0.9, learning_rate: 0.1, epsilon: 1e-8, curriculum_epochs: 0 },
        reach: Reach { translation_m: 0.004, rotation_rad: 0.05 },
        start_m: [0.0; 3],
        workspace_m: [[-1.0; 3], [1.0; 3]],
    };

    fn slope(value: f64) -> DisplacementGradient {
        DisplacementGradient { per_metre: [value; 3], per_radian: [value; 3] }
    }

    /// A bowl in w with its bottom elsewhere for each component, deeper where the step is later.
    fn bowl(controls: &[Displacement]) -> (f64, Vec<DisplacementGradient>) {
        let (mut loss, mut slopes) = (0.0, Vec::new());
        for (step, control) in (1..).zip(controls) {
            let (u, r) = (control.components(), RULE.reach.components());
            let error: Control = std::array::from_fn(|k| u[k] / r[k] - bottom(k));
            loss += f64::from(step) * error.iter().map(|x| x * x).sum::<f64>();
            slopes.push(DisplacementGradient::from(std::array::from_fn(|k| {
                2.0 * f64::from(step) * error[k] / r[k]
            })));
        }
        (loss, slopes)
    }

    fn bottom(k: usize) -> f64 {
        [0.3, -0.2, 0.5, -0.6, 0.1, 0.0][k]
    }

    fn begun() -> StepSearch {
        StepSearch::new(&RULE, &[[0.001, 0.0, -0.003, 0.01, 0.04, -0.02].into(); 3])
    }

    /// Goes on by so many epochs; the motion of some has no loss.
    fn advanced(mut search: StepSearch, epochs: std::ops::Range<usize>) -> StepSearch {
        for epoch in epochs {
            let (loss, slopes) = bowl(search.controls());
            search = match epoch % 7 {
                5 => search.back(&RULE).unwrap(),
                _ => search.onward(&RULE, loss, &slopes).unwrap(),
            };
            assert!(search.is_sound(&RULE, 3));
        }
        search
    }

    #[test]
    fn follows_the_equations() {
        let search = StepSearch::new(&RULE, &[[0.0; 6].into()]);
        let first = search.onward(&RULE, 5.0, &[slope(2.0)]).unwrap();
        // The mean of one slope is its square: a tenth of the reach, in metres and in radians, whatever the slope.
        let [x, .., rz] = first.controls()[0].components();
        assert!((x + 0.1 * 0.004).abs() < 1e-9 && (rz + 0.1 * 0.05).abs() < 1e-8, "{first:?}");
        let [x, .., rz] = first.place.paces[0].map(|pace| pace.mean_square);
        assert!((x - 0.1 * 0.008f64.powi(2)).abs() < 1e-12 && (rz - 0.1 * 0.1f64.powi(2)).abs() < 1e-12);
        let second = first.onward(&RULE, 4.0, &[slope(-1.0)]).unwrap();
        // The slope has turned.
        let step = 0.5 * 0.1 * 0.004 / (0.46f64 / (1.0 - 0.81)).sqrt();
        let [before, after] = [&first, &second].map(|search| search.controls()[0].translation_m[0]);
        assert!((after - before - step).abs() < 1e-9, "{after} {before} {step}");
    }

    #[test]
    fn begins_with_the_bits_of_its_controls_and_keeps_them_where_the_loss_is_flat() {
        let control = [0.001 / 3.0, -0.0, 0.0, 0.01 / 7.0, 0.0, -0.02];
        let search = StepSearch::new(&RULE, &[control.into()]);
        let next = search.onward(&RULE, 1.0, &[DisplacementGradient::default()]).unwrap();
        for search in [search, next] {
            assert_eq!(search.controls()[0].components().map(f64::to_bits), control.map(f64::to_bits));
        }
    }

    #[test]
    fn descends_a_quadratic() {
        let rule = StepRule { rule: RmsProp { learning_rate: 0.01, ..RULE.rule }, ..RULE };
        let mut search = begun();
        for _ in 0..300 {
            let (loss, slopes) = bowl(search.controls());
            search = search.onward(&rule, loss, &slopes).unwrap();
        }
        let reach = rule.reach.components();
        for control in search.controls() {
            let error = |k: usize| control.components()[k] / reach[k] - bottom(k);
            assert!((0..6).all(|k| error(k).abs() < 0.02), "{control:?}");
        }
        assert!(search.lowest_loss().unwrap() < 0.01);
    }

    #[test]
    fn saved_and_loaded_search_goes_on_with_the_same_bits() {
        let whole = postcard::to_allocvec(&advanced(begun(), 0..20)).unwrap();
        for interruption in 0..=20 {
            let saved = postcard::to_allocvec(&advanced(begun(), 0..interruption)).unwrap();
            let loaded: StepSearch = postcard::from_bytes(&saved).unwrap();
            let gone_on = advanced(loaded, interruption..20);
            assert_eq!(postcard::to_allocvec(&gone_on).unwrap(), whole, "{interruption}");
        }
    }

    #[test]
    fn a_motion_without_loss_is_taken_back_to_half_the_step_from_the_best() {
        let start = begun();
        assert!(start.back(&RULE).is_none());
        let (loss, slopes) = bowl(start.controls());
        let best = start.onward(&RULE, loss, &slopes).unwrap();
        let worse = best.onward(&RULE, loss + 1.0, &[slope(1.0); 3]).unwrap();
        let at = |search: &StepSearch| search.controls()[0].translation_m[0];
        for (lost, share) in [(best.clone(), 0.5), (worse, 0.5), (best.back(&RULE).unwrap(), 0.25)] {
            let back = lost.back(&RULE).unwrap();
            let [whole, less] = [&best, &back].map(|search| at(search) - at(&start));
            assert!((less - share * whole).abs() < 1e-12 && whole != 0.0, "{less} of {whole}");
            assert_eq!(back.lowest_loss(), Some(loss));
        }
        // However often, a number comes of it.
        let many = StepSearch { halvings: u32::MAX, ..best }.back(&RULE).unwrap();
        assert_eq!(many.controls(), start.controls());
    }

    #[test]
    fn what_is_not_finite_or_missing_is_refused() {
        let search = advanced(begun(), 0..3);
        let sound = [slope(1.0); 3];
        assert!(search.onward(&RULE, 1.0, &sound).is_some());
        for loss in [f64::NAN, f64::INFINITY, -1.0] {
            assert!(search.onward(&RULE, loss, &sound).is_none());
        }
        for slopes in [vec![], vec![slope(1.0); 4], vec![slope(f64::NAN); 3], vec![slope(1e200); 3]] {
            assert!(search.onward(&RULE, 1.0, &slopes).is_none());
        }
    }

    #[test]
    fn what_no_epochs_lead_to_is_not_sound() {
        let defects: [fn(&mut StepSearch); 9] = [
            |search| search.place.controls[1].translation_m[2] = 0.0041,
            |search| search.place.controls[1].rotation_rad[0] = f64::NAN,
            |search| search.place.paces[0][5].mean_square = -1.0,
            |search| search.place.paces.truncate(2),
            |search| search.place.updates = u32::MAX,
            |search| search.best.as_mut().unwrap().loss = f64::NAN,
            |search| search.best.as_mut().unwrap().slopes[2] = slope(f64::INFINITY),
            |search| search.best.as_mut().unwrap().slopes.truncate(2),
            |search| search.best.as_mut().unwrap().place.controls.truncate(2),
        ];
        let sound = advanced(begun(), 0..3);
        assert!(sound.is_sound(&RULE, 3) && !sound.is_sound(&RULE, 4));
        for (index, defect) in defects.into_iter().enumerate() {
            let mut search = sound.clone();
            defect(&mut search);
            assert!(!search.is_sound(&RULE, 3), "{index}");
        }
    }

    #[test]
    fn the_tool_stays_in_the_workspace() {
        let rule = StepRule { workspace_m: [[-0.001, -1.0, -1.0], [1.0, 0.002, 1.0]], ..RULE };
        let mut search = StepSearch::new(&rule, &[[0.0; 6].into(); 3]);
        for _ in 0..20 {
            // Down the slope is towards -x and +y.
            let pushed = DisplacementGradient { per_metre: [1.0, -1.0, 0.0], per_radian: [0.0; 3] };
            search = search.onward(&rule, 1.0, &[pushed; 3]).unwrap();
            let mut at = [0.0; 3];
            for control in search.controls() {
                at = std::array::from_fn(|k| at[k] + control.translation_m[k]);
                assert!(at[0] > -0.001 - 1e-12 && at[1] < 0.002 + 1e-12, "{at:?}");
            }
        }
        assert!(search.controls()[0].translation_m[0] < -0.0009);
    }

    proptest! {
        #[test]
        fn displacements_stay_within_reach(
            start in prop::array::uniform6(-0.1..0.1f64),
            slopes in prop::collection::vec(prop::array::uniform6(-1e6..1e6f64), 1..50),
        ) {
            let mut search = StepSearch::new(&RULE, &[start.into()]);
            for slope in slopes {
                search = search.onward(&RULE, 1.0, &[DisplacementGradient::from(slope)]).unwrap();
                prop_assert!(search.is_sound(&RULE, 1));
                let control = search.controls()[0];
                prop_assert!(control.translation_m.iter().all(|x| x.abs() <= 0.004));
                prop_assert!(control.rotation_rad.iter().all(|x| x.abs() <= 0.05));
            }
        }
    }
}
