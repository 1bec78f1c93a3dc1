//! A plan's skill changed until what it brings on a finer grid is what is wanted.
//!
//! A rollout on cells of half the size takes 16 times as long, so few are spent: to which parameter the amount answers best, and how much, is seen
//! by differences on the scene's own grid, and then that parameter is changed by the secant through the last looks at the finer one. How the amounts of both
//! grids answer may differ by more than a factor of two, their ratio changes with the skill: what the own grid says is good for a first step only.

use crate::failure::Failure;
use powderline_shared::plan::SkillParameter;
use powderline_simulator::{rollout::Evaluation, skill::Theta};

/// Looks at the finer grid after the first, at most.
const MOST_CORRECTIONS: usize = 6;
/// Half the step of the differences that tell how the amount answers to a parameter.
const HALF_STEP: f64 = 0.1;
/// The largest step of a parameter.
const LARGEST_STEP: f64 = 0.5;
/// By how much two looks may say that the amount answers otherwise than it seemed before: the rest is taken for noise.
const MOST_STEEPER: f64 = 3.0;
/// A correction goes on for one look more where less than this share of the tolerance is left: in other packings of the powder a motion
/// brings a little more or less. A skill that is met as it came stays: nobody knows yet which parameter to change, and to see that takes
/// ten motions.
const LEFT_FOR_LUCK: f64 = 0.5;
/// Between two looks on either side of what is wanted the next one keeps so far from both, as a share of the way.
const KEEPS_FROM_ENDS: f64 = 0.2;
/// A parameter leads no farther where it could be changed by less than this,
const NEXT_TO_NOTHING: f64 = 1e-3;
/// or where so many looks at it came no nearer and all on one side: the finer grid's amount has its peak there.
const MOST_ASTRAY: usize = 2;

/// Where a skill is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Grid {
    /// The scene's own.
    Own,
    /// The finer one.
    Finer,
}

/// What a skill brings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// The skill.
    pub theta: Theta,
    /// In the target, kilogram.
    pub mass_kg: f64,
    /// All that was found.
    pub evaluation: Evaluation,
}

/// Looks at a skill; none if the arm may not perform it, or powder is lost from the simulation.
pub type LookFn<'a> = &'a mut dyn FnMut(Grid, &Theta) -> Result<Option<Look>, Failure>;

/// What is wanted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// Kilogram.
    pub mass_kg: f64,
    /// Relative; none where as much as can be had is wanted.
    pub tolerance: Option<f64>,
}

impl Wanted {
    fn off(self, mass_kg: f64) -> f64 {
        (mass_kg / self.mass_kg - 1.0).abs()
    }

    fn is_met(self, mass_kg: f64) -> bool {
        self.is_within(1.0, mass_kg)
    }

    /// Whether so large a share of the tolerance is enough.
    fn is_within(self, share: f64, mass_kg: f64) -> bool {
        self.tolerance.is_none_or(|tolerance| self.off(mass_kg) <= share * tolerance * (1.0 + 1e-9))
    }
}

/// How a skill was corrected.
#[derive(Clone, Debug, PartialEq)]
pub struct Corrected {
    /// As it came, and each correction of it, on the finer grid.
    pub tried: Vec<Look>,
    /// Which of them brings there what is wanted, or comes nearest.
    pub best: usize,
    /// As it came, and that one, on the scene's own grid.
    pub own: [Look; 2],
}

impl Corrected {
    /// The one to be performed, on the finer grid.
    pub fn best(&self) -> &Look {
        &self.tried[self.best]
    }
}

/// Corrects a skill until the finer grid brings what is wanted.
///
/// # Errors
/// What a look ends with. [`Failure::Failed`] where the skill itself cannot be looked at.
pub fn corrected(theta: &Theta, wanted: Wanted, look: LookFn<'_>) -> Result<Corrected, Failure> {
    let none = || {
        let why = "the arm may not perform it, or powder leaves the grid";
        Failure::Failed(format!("the plan's skill cannot be looked at: {why}"))
    };
    let own = look(Grid::Own, theta)?.ok_or_else(none)?;
    let finer = look(Grid::Finer, theta)?.ok_or_else(none)?;
    let mut found = Corrected { tried: vec![finer], best: 0, own: [own; 2] };
    if wanted.is_met(finer.mass_kg) || finer.mass_kg <= 0.0 || own.mass_kg <= 0.0 {
        return Ok(found);
    }
    let share = finer.mass_kg / own.mass_kg;
    for (parameter, slope) in slopes(&own, look)? {
        found.along(parameter, share * slope, wanted, look)?;
        if wanted.is_met(found.best().mass_kg) {
            break;
        }
    }
    found.look_back(wanted, look)?;
    Ok(found)
}

/// Parameters by how the amount answers to them on the own grid, kilogram per unit: the one that answers best comes first. Where one side
/// of a skill cannot be looked at, the other one tells.
fn slopes(own: &Look, look: LookFn<'_>) -> Result<Vec<(SkillParameter, f64)>, Failure> {
    let mut slopes = Vec::new();
    for parameter in SkillParameter::ALL {
        let mut side = |step: f64| {
            let moved = own.theta.moved(parameter, step);
            Ok::<_, Failure>(look(Grid::Own, &moved)?.unwrap_or(*own))
        };
        let [low, high] = [side(-HALF_STEP)?, side(HALF_STEP)?];
        let run = high.theta[parameter] - low.theta[parameter];
        if run > 0.0 {
            slopes.push((parameter, (high.mass_kg - low.mass_kg) / run));
        }
    }
    // Stable: the first of equals stays first.
    slopes.sort_by(|(_, a), (_, b)| b.abs().total_cmp(&a.abs()));
    slopes.retain(|(_, slope)| *slope != 0.0);
    Ok(slopes)
}

impl Corrected {
    /// Changes one parameter, from the best so far on, as long as that leads nearer.
    fn along(
        &mut self,
        parameter: SkillParameter,
        mut slope: f64,
        wanted: Wanted,
        look: LookFn<'_>,
    ) -> Result<(), Failure> {
        let mut last = *self.best();
        // The nearest looks with too little and with too much.
        let mut sides = [None; 2];
        let (mut reach, mut astray) = (LARGEST_STEP, 0);
        // How far the arm may go, as far as that was seen.
        let mut way = f64::INFINITY;
        let mut is_last = false;
        while self.tried.len() <= MOST_CORRECTIONS && astray < MOST_ASTRAY && !is_last {
            let best_kg = self.best().mass_kg;
            if wanted.is_within(1.0 - LEFT_FOR_LUCK, best_kg) {
                break;
            }
            is_last = wanted.is_met(best_kg);
            sides[usize::from(last.mass_kg > wanted.mass_kg)] = Some(last);
            let from = *self.best();
            // From the last look none follows, so that it need not keep from what is known.
            let keeps = if is_last { 0.0 } else { KEEPS_FROM_ENDS };
            let step = next(&from, sides, parameter, (slope, reach, keeps), wanted) - from.theta[parameter];
            let theta = from.theta.moved(parameter, step.clamp(-way, way));
            let step = (theta[parameter] - from.theta[parameter]).abs();
            if step < NEXT_TO_NOTHING {
                break;
            }
            let Some(now) = look(Grid::Finer, &theta)? else {
                // What the arm may not perform is too far.
                way = 0.5 * step;
                continue;
            };
            let risen = (now.mass_kg - last.mass_kg) / (theta[parameter] - last.theta[parameter]);
            if (risen / slope).is_finite() {
                slope *= (risen / slope).clamp(1.0 / MOST_STEEPER, MOST_STEEPER);
            }
            self.tried.push(now);
            if wanted.off(now.mass_kg) < wanted.off(self.best().mass_kg) {
                self.best = self.tried.len() - 1;
            } else if sides.contains(&None) {
                reach *= 0.5;
                astray += 1;
            }
            last = now;
        }
        Ok(())
    }

    /// Looks at the best on the own grid as well. One of which there is nothing to be seen makes way for the next best; as it came there
    /// is.
    fn look_back(&mut self, wanted: Wanted, look: LookFn<'_>) -> Result<(), Failure> {
        let mut by_miss: Vec<usize> = (0..self.tried.len()).collect();
        // Stable: the first of equals stays first.
        by_miss.sort_by(|a, b| {
            let [a, b] = [a, b].map(|k| wanted.off(self.tried[*k].mass_kg));
            a.total_cmp(&b)
        });
        for k in by_miss {
            if let Some(own) = look(Grid::Own, &self.tried[k].theta)? {
                (self.best, self.own[1]) = (k, own);
                return Ok(());
            }
        }
        Ok(())
    }
}

/// Where to look next: between the sides where there are both, else along the slope.
fn next(
    from: &Look,
    sides: [Option<Look>; 2],
    parameter: SkillParameter,
    (slope, reach, keeps): (f64, f64, f64),
    wanted: Wanted,
) -> f64 {
    if let [Some(little), Some(much)] = sides {
        let share = (wanted.mass_kg - little.mass_kg) / (much.mass_kg - little.mass_kg);
        let share = share.clamp(keeps, 1.0 - keeps);
        let [low, high] = [little, much].map(|look| look.theta[parameter]);
        return low + share * (high - low);
    }
    let step = ((wanted.mass_kg - from.mass_kg) / slope).clamp(-reach, reach);
    from.theta[parameter] + step
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_simulator::rollout::Census;

    const WANTED: Wanted = Wanted { mass_kg: 0.01, tolerance: Some(0.02) };

    /// Depth brings most, lift a little; the finer grid `share` of it, which falls with the depth. What is deeper than `deepest` the arm
    /// may not perform.
    fn bench(share: f64, deepest: f64) -> impl FnMut(Grid, &Theta) -> Result<Option<Look>, Failure> {
        move |grid, theta| {
            let [depth, _, lift, _, _] = theta.components();
            if depth > deepest {
                return Ok(None);
            }
            let own_kg = 0.01 + 0.006 * depth + 0.001 * depth * depth + 0.0005 * lift;
            let share = if grid == Grid::Finer { share - 0.02 * depth } else { 1.0 };
            // In particles of 8 mg.
            let target = (share * own_kg / 8e-6) as u32;
            let evaluation = Evaluation::new(1.0, 0, Census { target, ..Census::default() });
            Ok(Some(Look { theta: *theta, mass_kg: f64::from(target) * 8e-6, evaluation }))
        }
    }

    #[test]
    fn a_skill_is_corrected_by_what_answers_best_in_few_looks() {
        for share in [0.75, 0.9, 1.2] {
            let (mut bench, mut looks) = (bench(share, 1.0), [0, 0]);
            let start = Theta::clamped([0.0; 5]);
            let mut look = |grid, theta: &Theta| {
                looks[usize::from(grid == Grid::Finer)] += 1;
                bench(grid, theta)
            };
            let found = corrected(&start, WANTED, &mut look).unwrap();
            let best = found.best();
            assert!(WANTED.is_met(best.mass_kg), "{share}: {best:?}");
            let [depth, angle, lift, ..] = best.theta.components();
            assert!(depth.signum() == (1.0 - share).signum() && (angle, lift) == (0.0, 0.0), "{best:?}");
            assert_eq!([found.own[0].theta, found.own[1].theta], [start, best.theta]);
            assert!(looks[1] <= 4 && looks[0] == 12, "{share}: {looks:?}");
        }
    }

    /// Where both grids' amounts keep their ratio, the first step is right.
    #[test]
    fn the_first_step_knows_how_much_of_the_own_grids_amount_the_finer_one_has() {
        let mut look = |grid, theta: &Theta| {
            let share = if grid == Grid::Finer { 0.85 } else { 1.0 };
            let mass_kg = share * (0.01 + 0.006 * theta.components()[0]);
            Ok(Some(Look { theta: *theta, mass_kg, evaluation: Evaluation::new(1.0, 0, Census::default()) }))
        };
        let found = corrected(&Theta::clamped([0.0; 5]), WANTED, &mut look).unwrap();
        assert!(found.tried.len() == 2 && WANTED.off(found.best().mass_kg) < 1e-9, "{found:?}");
    }

    /// The finer grid answers a third as much as the own one, and both by steps of a particle.
    #[test]
    fn a_grid_that_answers_otherwise_is_met_all_the_same() {
        for [mass_kg, slope] in [[0.0115, 0.002], [0.0085, 0.002], [0.0115, 0.012], [0.0085, 0.012]] {
            let mut look = |grid, theta: &Theta| {
                let depth = theta.components()[0];
                let kg = if grid == Grid::Finer { mass_kg + slope * depth } else { 0.01 + 0.006 * depth };
                let target = (kg / 8e-6) as u32;
                let evaluation = Evaluation::new(1.0, 0, Census { target, ..Census::default() });
                Ok(Some(Look { theta: *theta, mass_kg: f64::from(target) * 8e-6, evaluation }))
            };
            let found = corrected(&Theta::clamped([0.0; 5]), WANTED, &mut look).unwrap();
            assert!(WANTED.is_met(found.best().mass_kg), "{mass_kg} {slope}: {found:?}");
        }
    }

    /// What is met by a hair is looked at once more, and kept where that comes no nearer.
    #[test]
    fn a_part_of_the_tolerance_is_left_for_other_packings() {
        for (first_kg, again_kg, best) in [(0.0112, None, 2), (0.008, None, 2), (0.0112, Some(0.0104), 1)] {
            let mut looks = 0;
            let mut look = |grid, theta: &Theta| {
                let depth = theta.components()[0];
                looks += usize::from(grid == Grid::Finer);
                // The first step goes too far by an eighth of the way, or by a thirteenth: 1.5 % of what is wanted.
                let slope = 0.006 * first_kg / 0.01 * if first_kg > 0.01 { 1.125 } else { 1.075 };
                let finer_kg = first_kg + slope * depth;
                let mass_kg = match (grid, again_kg) {
                    (Grid::Own, _) => 0.01 + 0.006 * depth,
                    (Grid::Finer, Some(again_kg)) if looks == 3 => again_kg,
                    (Grid::Finer, _) => finer_kg,
                };
                Ok(Some(Look {
                    theta: *theta,
                    mass_kg,
                    evaluation: Evaluation::new(1.0, 0, Census::default()),
                }))
            };
            let found = corrected(&Theta::clamped([0.0; 5]), WANTED, &mut look).unwrap();
            let off = found.tried.iter().map(|look| WANTED.off(look.mass_kg)).collect::<Vec<_>>();
            assert!(off.len() == 3 && off[1] > 0.01 && off[1] < 0.02, "{off:?}");
            assert_eq!(found.best, best, "{off:?}");
            assert!(again_kg.is_some() || off[2] < 0.01, "{off:?}");
        }
    }

    /// On the finer grid what answers best on the own one has its peak: looks are left for what answers next best.
    #[test]
    fn a_parameter_that_leads_nowhere_makes_way_for_the_next() {
        let mut look = |grid, theta: &Theta| {
            let [depth, angle, ..] = theta.components();
            let mass_kg = match grid {
                Grid::Own => 0.01 + 0.006 * angle + 0.004 * depth,
                Grid::Finer => 0.0085 + 0.001 * angle - 0.01 * angle * angle + 0.003 * depth,
            };
            Ok(Some(Look { theta: *theta, mass_kg, evaluation: Evaluation::new(1.0, 0, Census::default()) }))
        };
        let found = corrected(&Theta::clamped([0.0; 5]), WANTED, &mut look).unwrap();
        assert!(WANTED.is_met(found.best().mass_kg), "{found:?}");
        assert!(found.best().theta.components()[0] > 0.3, "{found:?}");
    }

    /// Depth leads no farther than the arm may go, lift a little farther.
    #[test]
    fn what_cannot_be_met_comes_as_near_as_it_may() {
        let found = corrected(&Theta::clamped([0.0; 5]), WANTED, &mut bench(0.7, 0.2)).unwrap();
        let best = found.best();
        let [depth, _, lift, ..] = best.theta.components();
        assert!(!WANTED.is_met(best.mass_kg) && found.best > 0, "{best:?}");
        assert!(depth > 0.1 && depth <= 0.2 && lift > 0.4, "{best:?}");
    }

    /// Between a skill that brings too little and one that brings too much there are some that the arm may not perform.
    #[test]
    fn a_gap_between_too_little_and_too_much_ends_it() {
        for gap in [[0.005, 0.24], [0.03, 0.11], [0.004, 0.4]] {
            let mut looks = 0;
            let mut look = |grid, theta: &Theta| {
                looks += 1;
                assert!(looks < 100, "it goes on for ever");
                let depth = theta.components()[0];
                // On the finer grid a step by what the own one says goes too far.
                let kg = if grid == Grid::Finer { 0.0095 + 0.012 * depth } else { 0.01 + 0.002 * depth };
                let is_able = grid == Grid::Own || depth < gap[0] || depth > gap[1];
                let evaluation = Evaluation::new(1.0, 0, Census::default());
                Ok(is_able.then_some(Look { theta: *theta, mass_kg: kg, evaluation }))
            };
            let found = corrected(&Theta::clamped([0.0; 5]), WANTED, &mut look).unwrap();
            assert!(found.tried.len() > 1 && found.tried.len() <= MOST_CORRECTIONS + 1, "{found:?}");
            let least = found.tried.iter().map(|look| WANTED.off(look.mass_kg)).fold(f64::INFINITY, f64::min);
            assert!((WANTED.off(found.best().mass_kg) - least).abs() < 1e-12, "{found:?}");
        }
    }

    /// Deeper is not possible on either grid, and less deep is what is needed.
    #[test]
    fn a_parameter_that_is_blocked_on_one_side_leads_to_the_other() {
        let found = corrected(&Theta::clamped([0.0; 5]), WANTED, &mut bench(1.3, 0.05)).unwrap();
        let [depth, angle, lift, ..] = found.best().theta.components();
        assert!(WANTED.is_met(found.best().mass_kg), "{found:?}");
        assert!(depth < -0.1 && (angle, lift) == (0.0, 0.0), "{found:?}");
    }

    #[test]
    fn what_only_the_finer_grid_can_simulate_makes_way_for_the_next_best() {
        let start = Theta::clamped([0.0; 5]);
        let usual = corrected(&start, WANTED, &mut bench(0.75, 1.0)).unwrap();
        let lost = usual.best().theta;
        let mut bench = bench(0.75, 1.0);
        let mut look = |grid, theta: &Theta| match grid == Grid::Own && *theta == lost {
            true => Ok(None),
            false => bench(grid, theta),
        };
        let found = corrected(&start, WANTED, &mut look).unwrap();
        assert!(found.tried == usual.tried && found.best != usual.best, "{found:?}");
        assert_eq!(found.own[1].theta, found.best().theta);
    }

    #[test]
    fn a_skill_that_brings_what_is_wanted_stays_and_so_does_one_of_which_all_is_wanted() {
        let start = Theta::clamped([0.0; 5]);
        let found = corrected(&start, WANTED, &mut bench(0.99, 1.0)).unwrap();
        assert_eq!((found.tried.len(), found.best().theta, found.own[0]), (1, start, found.own[1]));
        let all = Wanted { tolerance: None, ..WANTED };
        assert_eq!(corrected(&start, all, &mut bench(0.7, 1.0)).unwrap().tried.len(), 1);
        // Nothing arrives: nothing to correct by.
        let mut nothing = |_, theta: &Theta| {
            Ok(Some(Look {
                theta: *theta,
                mass_kg: 0.0,
                evaluation: Evaluation::new(1.0, 0, Census::default()),
            }))
        };
        assert_eq!(corrected(&start, WANTED, &mut nothing).unwrap().tried.len(), 1);
    }

    #[test]
    fn whoever_stops_is_heard() {
        let mut bench = bench(0.8, 1.0);
        let mut left = 7;
        let mut look = |grid, theta: &Theta| {
            left -= 1;
            if left == 0 { Err(Failure::Interrupted("stopped".into())) } else { bench(grid, theta) }
        };
        let stopped = corrected(&Theta::clamped([0.0; 5]), WANTED, &mut look);
        assert_eq!(stopped, Err(Failure::Interrupted("stopped".into())));
    }
}
