//! A skill first, then a path near it: splines in time that are added to the skill's motion, so that some dozens of numbers say how
//! the tool moves ([`SplinePath`]).
//!
//! The skill is searched as [`super::coarse_to_fine`] does, until one brings the wanted amount in the scene itself and an epoch there gains less
//! than [`SKILL_GAIN`] of the loss, or for [`SKILL_EPOCHS`] epochs there. From the best of them the path begins.
//!
//! # Descent
//!
//! Differences of dozens of numbers cost dozens of rollouts; an adjoint costs as much as for five, so this is where one pays. It has to hold over the
//! steps that a search takes, which the restarted one does ([`powderline_simulator::rollout::restart`]).
//!
//! Where an amount is wanted, the loss has an edge: powder that is missing and powder that is too much cost alike, and the two slopes point
//! against each other. A descent by the slope at hand crosses the edge to and fro. So each step goes by a *bundle* of the last gradients
//! near by, against the shortest vector of their convex hull: the direction in which all of them fall (Wolfe 1975; Lemarechal 1975). Where
//! gradients of both sides are known, that leads along the edge; where they are noisy, it averages them.
//!
//! An epoch takes a gradient, by the restarted adjoint, and makes [`LINE_TRIALS`] trials along the direction, each half as far as the one before
//! and all as a plan would ship them. The search goes on from the lowest of them, and the next epoch begins with twice its length.
//!
//! That need not be lower than where it stood. Which grain falls off the rim is chance, and the loss of a motion is known no better than to
//! some per cent: 0.16 m of 3 m on `bench-small`, over packings as over steps of a hundredth. The skill that a path begins with is the luckiest
//! of a dozen, and a search that wants to be lower than that never leaves it. Only where all trials are higher than the lowest loss so far by
//! more than [`CHANCE`] does it stay, take the next gradient at the lowest of them (a null step) and halve the lengths; where they are short
//! already, it goes back to the lowest place so far and begins anew there, by gradients near by.
//!
//! A motion that the arm cannot perform is never asked for. One that is too fast or too rough is moved to the nearest that is not
//! ([`SplinePath::within_limits`]), so that the search slides along the limits. Where a wall, the workspace or the arm's reach is in the way,
//! the way is halved until it is not.

use super::black_box::BlackBox;
use super::coarse_to_fine::CoarseToFine;
use super::{Adjoint, Epoch, Found, Problem, Search, SearchError, Step, Trial, World, check};
use powderline_baseline::CmaEs;
use powderline_simulator::rollout::Evaluation;
use powderline_simulator::scene::PathSplines;
use powderline_simulator::skill::{SplinePath, Splines, Theta};

/// Epochs in the scene itself after which the path begins in any case, and the gain of one, over the loss before, for which it waits.
const SKILL_EPOCHS: u32 = 6;
const SKILL_GAIN: f64 = 0.05;

/// Trials along a direction.
const LINE_TRIALS: usize = 4;

/// Lengths of steps, in units of coefficients: of the first, and the shortest that an epoch begins from. It tries twice that, and down to a
/// quarter of it, where chance is most of what is seen.
const FIRST_LENGTH: f64 = 0.25;
const LEAST_LENGTH: f64 = 0.1;

/// How much higher than the lowest so far a loss may be by chance, as a share of that.
const CHANCE: f64 = 0.2;

/// Share of the arm's limits that is left free: a motion in whole counts is rougher.
const MARGIN: f64 = 0.002;

/// A step's shortest way that is still worth a trial.
const SHORTEST: f64 = 1e-3;

/// How far from a place from which no gradient led on the next one is taken, in units of coefficients.
const NEAR_BY: f64 = 0.1;

/// Gradients in the bundle at most, and how far away they may be taken, over the present length.
const BUNDLE: usize = 5;
const REACH: f64 = 2.0;

/// How far a search that sees losses alone goes from the skill, in units of coefficients.
const BLIND_RANGE: f64 = 2.0;

/// How a path is searched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum By {
    /// By the restarted adjoint.
    Gradient,
    /// By losses alone, to compare with.
    Losses,
}

/// The whole search.
pub(super) struct SkillThenPath {
    problem: Problem,
    by: By,
    skill: CoarseToFine,
    /// The best skill in the scene itself, and what it brings.
    best: Option<(Vec<f64>, Evaluation)>,
    fine_epochs: u32,
    path: Option<Box<dyn Search>>,
}

impl SkillThenPath {
    pub(super) fn new(problem: Problem, by: By) -> Self {
        let skill = CoarseToFine::new(problem.clone());
        Self { problem, by, skill, best: None, fine_epochs: 0, path: None }
    }

    fn keep_best(&mut self, trials: &[Trial], found: &[Found]) {
        let fine = trials.iter().zip(found).filter(|(trial, _)| trial.is_rounded);
        for (trial, Found { evaluation, .. }) in fine {
            let key = |found: &Evaluation| (self.problem.is_well_within(found), -found.loss);
            if self.best.as_ref().is_none_or(|(_, best)| key(evaluation) > key(best)) {
                self.best = Some((trial.point.clone(), *evaluation));
            }
        }
    }

    /// The path from the best skill on, once that is good enough; `before` is what the best brought an epoch earlier.
    fn begun(&self, before: Option<Evaluation>) -> Option<Box<dyn Search>> {
        let (skill, found) = self.best.as_ref()?;
        let gains_little = before.is_some_and(|before| {
            self.problem.is_well_within(&before) && found.loss > (1.0 - SKILL_GAIN) * before.loss
        });
        if !gains_little && self.fine_epochs < SKILL_EPOCHS {
            return None;
        }
        let near = Near::new(self.problem.clone(), skill.clone())?;
        Some(match self.by {
            By::Gradient => Box::new(Descent::new(near, found.loss)),
            By::Losses => Box::new(Blind::new(near)),
        })
    }
}

impl Search for SkillThenPath {
    fn ask(&mut self, is_last: bool) -> Vec<Trial> {
        match &mut self.path {
            Some(path) => path.ask(is_last),
            None => self.skill.ask(is_last),
        }
    }

    fn tell(&mut self, found: &[Found]) -> Result<Option<Epoch>, SearchError> {
        if let Some(path) = &mut self.path {
            return path.tell(found);
        }
        let trials = self.skill.ask(false);
        let ended = self.skill.tell(found)?;
        let before = self.best.as_ref().map(|(_, found)| *found);
        self.keep_best(&trials, found);
        if let Some(ended) = &ended {
            self.fine_epochs += u32::from(ended.trial.world == World::Fine);
            self.path = self.begun(before);
        }
        Ok(ended)
    }
}

/// Paths near a skill.
struct Near {
    problem: Problem,
    skill: Vec<f64>,
    path: SplinePath,
}

impl Near {
    /// None of what is no skill.
    fn new(problem: Problem, skill: Vec<f64>) -> Option<Self> {
        let theta = Theta::new(skill[..].try_into().ok()?).ok()?;
        let PathSplines { knots, freedoms } = &problem.path;
        let path = SplinePath::new(&problem.map, &theta, freedoms, *knots as usize).ok()?;
        Some(Self { problem, skill, path })
    }

    fn dimensions(&self) -> usize {
        self.path.dimensions()
    }

    /// The path with these coefficients, as it would be shipped.
    fn trial(&self, coefficients: Vec<f64>) -> Trial {
        let splines = Splines { freedoms: self.problem.path.freedoms.clone(), coefficients };
        let trial = Trial::of(self.skill.clone());
        Trial { splines: Some(splines), is_rounded: true, may_fail: true, ..trial }
    }

    /// The first of these ways along a direction that the arm can make and that lead somewhere else, each half as long as the one before; none if
    /// even the shortest is not possible.
    fn able(&self, from: &[f64], direction: &[f64], length: f64) -> Option<(f64, Trial)> {
        let lengths = std::iter::successors(Some(length), |length| Some(0.5 * length));
        lengths.take_while(|length| *length >= SHORTEST).find_map(|length| {
            let limits = self.problem.map.limits();
            let there = self.path.within_limits(limits, MARGIN, moved(from, direction, length));
            let leads_on = norm(&less(&there, from)) >= SHORTEST;
            let trial = self.trial(there);
            (leads_on && self.problem.is_able(&trial)).then_some((length, trial))
        })
    }
}

/// The search by gradients.
struct Descent {
    near: Near,
    at: Vec<f64>,
    /// Where the loss was lowest so far, and how low.
    lowest: (Vec<f64>, f64),
    /// Where the next gradient is taken; none if there is one.
    place: Option<Vec<f64>>,
    /// Gradients and where they were taken, the latest last.
    bundle: Vec<(Vec<f64>, Vec<f64>)>,
    /// Of the last step.
    length: f64,
    /// How often it took a gradient near by instead, since none led on.
    anew: u32,
    /// Asked for last and not told yet, and how far each goes.
    asked: Vec<Trial>,
    lengths: Vec<f64>,
}

impl Descent {
    fn new(near: Near, loss: f64) -> Self {
        let at = vec![0.0; near.dimensions()];
        let (lowest, place) = ((at.clone(), loss), Some(at.clone()));
        let (asked, lengths) = (Vec::new(), Vec::new());
        Self { near, at, lowest, place, bundle: Vec::new(), length: FIRST_LENGTH, anew: 0, asked, lengths }
    }

    /// Against the shortest vector of the convex hull of the gradients near by; none if there is no way to go.
    fn direction(&self) -> Option<Vec<f64>> {
        let is_near = |place: &[f64]| norm(&less(place, &self.at)) <= REACH * self.length.max(LEAST_LENGTH);
        let latest = self.bundle.last().map(|(_, gradient)| gradient);
        let others = self.bundle.iter().rev().skip(1).filter(|(place, _)| is_near(place));
        let near: Vec<&[f64]> =
            latest.into_iter().chain(others.map(|(_, gradient)| gradient)).map(Vec::as_slice).collect();
        let shortest = shortest_of_hull(&near)?;
        let length = norm(&shortest);
        (length > 0.0).then(|| shortest.iter().map(|x| -x / length).collect())
    }

    /// Trials along the direction, and how far each goes.
    fn line(&self) -> Vec<(f64, Trial)> {
        let mut trials: Vec<(f64, Trial)> = Vec::new();
        let mut length = 2.0 * self.length;
        let direction = self.direction();
        while let Some(direction) = direction.as_ref().filter(|_| trials.len() < LINE_TRIALS) {
            let Some((reached, trial)) = self.near.able(&self.at, direction, length) else { break };
            trials.push((reached, trial));
            length = 0.5 * reached;
        }
        if trials.is_empty() {
            // Nowhere to go: what is known already, so that the epoch ends.
            trials.push((0.0, self.near.trial(self.at.clone())));
        }
        trials
    }

    fn take_gradient(&mut self, place: Vec<f64>, found: &Found) -> Result<(), SearchError> {
        let Some(gradient) = found.gradient.clone() else {
            // Nearer, by those that are known.
            self.length = (0.5 * self.length).max(LEAST_LENGTH);
            return Ok(());
        };
        if let Some(k) = gradient.iter().position(|slope| !slope.is_finite()) {
            let parameter = format!("path's coefficient {k}");
            return Err(SearchError::Gradient { parameter, value: gradient[k] });
        }
        self.bundle.push((place, gradient));
        if self.bundle.len() > BUNDLE {
            self.bundle.remove(0);
        }
        Ok(())
    }

    /// Goes on from the trials along a direction; which of them is the lowest.
    fn step(&mut self, trials: &[Trial], found: &[Found]) -> usize {
        let loss = |k: &usize| found[*k].evaluation.loss;
        let lowest = (0..found.len()).min_by(|a, b| loss(a).total_cmp(&loss(b))).unwrap_or_default();
        let there = trials[lowest].splines.as_ref().map_or(Vec::new(), |added| added.coefficients.clone());
        self.place = Some(there.clone());
        if loss(&lowest) < self.lowest.1 {
            self.lowest = (there.clone(), loss(&lowest));
        }
        let leads_on = self.lengths[lowest] > 0.0;
        if leads_on && loss(&lowest) <= (1.0 + CHANCE) * self.lowest.1 {
            self.at = there;
            self.length = self.lengths[lowest].max(LEAST_LENGTH);
        } else if leads_on && self.length > LEAST_LENGTH {
            self.length = (0.5 * self.length).max(LEAST_LENGTH);
        } else {
            self.begin_anew();
        }
        lowest
    }

    /// From the lowest place so far, by a gradient near by.
    fn begin_anew(&mut self) {
        self.at.clone_from(&self.lowest.0);
        (self.length, self.anew) = (FIRST_LENGTH, self.anew + 1);
        self.bundle.clear();
        self.place = Some(self.near_by());
    }

    /// A place near by, each time in another direction: from the present one none leads on.
    fn near_by(&self) -> Vec<f64> {
        let size = 1.0 / libm::sqrt(self.at.len() as f64);
        // Signs as good as drawn, by the golden ratio.
        let is_up = |k: u32| self.anew.wrapping_mul(k + 1).wrapping_mul(0x9e37_79b9) >> 31 == 0;
        let direction: Vec<f64> =
            (0..).zip(&self.at).map(|(k, _)| if is_up(k) { size } else { -size }).collect();
        let there = self.near.able(&self.at, &direction, NEAR_BY).and_then(|(_, trial)| trial.splines);
        there.map_or_else(|| self.at.clone(), |added| added.coefficients)
    }
}

impl Search for Descent {
    fn ask(&mut self, _: bool) -> Vec<Trial> {
        if self.asked.is_empty() {
            (self.lengths, self.asked) = match &self.place {
                Some(place) => {
                    let trial = self.near.trial(place.clone());
                    (vec![0.0], vec![Trial { adjoint: Some(Adjoint::Restarted), ..trial }])
                }
                None => self.line().into_iter().unzip(),
            };
        }
        self.asked.clone()
    }

    fn tell(&mut self, found: &[Found]) -> Result<Option<Epoch>, SearchError> {
        check(&self.asked, found)?;
        let trials = std::mem::take(&mut self.asked);
        if let Some(place) = self.place.take() {
            self.take_gradient(place, &found[0])?;
            return Ok(None);
        }
        let lowest = self.step(&trials, found);
        let (trial, evaluation) = (trials[lowest].clone(), found[lowest].evaluation);
        Ok(Some(Epoch { trial, evaluation, has_peers: true, step: Step::Update, slopes: None }))
    }
}

/// The search by losses.
struct Blind {
    near: Near,
    search: BlackBox,
}

impl Blind {
    fn new(near: Near) -> Self {
        let strategy = CmaEs::new(near.dimensions(), near.problem.seed);
        Self { near, search: BlackBox::new(Box::new(strategy)) }
    }

    /// The path that a point between -1 and 1 means, drawn in towards the skill as far as the arm needs it.
    fn trial(&self, point: &[f64]) -> Trial {
        let nowhere = vec![0.0; point.len()];
        let able = self.near.able(&nowhere, point, BLIND_RANGE);
        able.map_or_else(|| self.near.trial(nowhere), |(_, trial)| trial)
    }
}

impl Search for Blind {
    fn ask(&mut self, is_last: bool) -> Vec<Trial> {
        self.search.ask(is_last).iter().map(|trial| self.trial(&trial.point)).collect()
    }

    fn tell(&mut self, found: &[Found]) -> Result<Option<Epoch>, SearchError> {
        let ended = self.search.tell(found)?;
        Ok(ended.map(|ended| Epoch { trial: self.trial(&ended.trial.point), ..ended }))
    }
}

fn moved(from: &[f64], direction: &[f64], length: f64) -> Vec<f64> {
    from.iter().zip(direction).map(|(x, d)| x + length * d).collect()
}

fn less(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn norm(a: &[f64]) -> f64 {
    libm::sqrt(dot(a, a))
}

/// The shortest vector of the convex hull of some; none of none. By steps that move weight from the one that is worst along it to the one
/// that is best (Mitchell, Demyanov and Malozemov 1974).
fn shortest_of_hull(vectors: &[&[f64]]) -> Option<Vec<f64>> {
    const MOST_STEPS: usize = 1000;
    let mut shortest = vectors.first()?.to_vec();
    let mut weights = vec![0.0; vectors.len()];
    weights[0] = 1.0;
    for _ in 0..MOST_STEPS {
        let along: Vec<f64> = vectors.iter().map(|vector| dot(vector, &shortest)).collect();
        let by_along = |a: &usize, b: &usize| along[*a].total_cmp(&along[*b]);
        let to = (0..vectors.len()).min_by(by_along)?;
        let from = (0..vectors.len()).filter(|k| weights[*k] > 0.0).max_by(by_along)?;
        let way = less(vectors[to], vectors[from]);
        let square = dot(&way, &way);
        let share = if square > 0.0 { (-dot(&shortest, &way) / square).min(weights[from]) } else { 0.0 };
        if share <= 1e-12 {
            break;
        }
        weights[to] += share;
        weights[from] -= share;
        shortest = moved(&shortest, &way, share);
    }
    Some(shortest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optim::Method;
    use powderline_simulator::{rollout::Census, scene::Scene, skill::Freedom};

    const WANTED: f64 = 1200.0;

    fn problem(seed: u64) -> Problem {
        Problem::new(&Scene::load("bench").unwrap(), seed).without_obstacles()
    }

    fn near(problem: Problem) -> Near {
        Near::new(problem, vec![0.1, 0.0, -0.2, 0.0, 0.3]).unwrap()
    }

    /// A bench whose amount is a sum of all coefficients, with an edge where it is right, and whose spread falls along some of them, and what
    /// is a hundred times steeper across the edge than along it.
    fn edged(c: &[f64]) -> (Evaluation, Vec<f64>) {
        let amount: f64 = c.iter().sum::<f64>() - 0.5;
        let spread: f64 =
            c.iter().enumerate().map(|(k, c)| (c - 0.3 * f64::from((k % 2) as u32)).powi(2)).sum();
        let loss = 5.0 * amount.abs() + spread;
        let slope =
            |(k, c): (usize, &f64)| 5.0 * amount.signum() + 2.0 * (c - 0.3 * f64::from((k % 2) as u32));
        let census = Census { target: (WANTED * (1.0 + 0.1 * amount)) as u32, ..Census::default() };
        (Evaluation::new(loss, 0, census), c.iter().enumerate().map(slope).collect())
    }

    fn found(trial: &Trial) -> Found {
        let (evaluation, gradient) = edged(&trial.splines.as_ref().unwrap().coefficients);
        Found { evaluation, gradient: trial.adjoint.map(|_| gradient) }
    }

    /// The lowest loss after so many epochs.
    fn lowest(search: &mut dyn Search, epochs: usize) -> f64 {
        let mut lowest = f64::INFINITY;
        for _ in 0..epochs {
            loop {
                let trials = search.ask(false);
                assert_eq!(trials, search.ask(false));
                let found: Vec<Found> = trials.iter().map(found).collect();
                lowest = found.iter().map(|found| found.evaluation.loss).fold(lowest, f64::min);
                if search.tell(&found).unwrap().is_some() {
                    break;
                }
            }
        }
        lowest
    }

    #[test]
    fn the_shortest_of_a_hull_is_what_geometry_says() {
        let near = |found: Option<Vec<f64>>, expected: [f64; 2]| {
            let found = found.unwrap();
            assert!(less(&found, &expected).iter().all(|x| x.abs() < 1e-9), "{found:?} {expected:?}");
        };
        near(shortest_of_hull(&[&[3.0, 4.0]]), [3.0, 4.0]);
        near(shortest_of_hull(&[&[1.0, 1.0], &[-1.0, 1.0]]), [0.0, 1.0]);
        // Beyond the end of the line between them: the end.
        near(shortest_of_hull(&[&[1.0, 1.0], &[3.0, 1.0]]), [1.0, 1.0]);
        // The origin within them.
        near(shortest_of_hull(&[&[1.0, 0.0], &[-1.0, 1.0], &[-1.0, -1.0]]), [0.0, 0.0]);
        assert_eq!(shortest_of_hull(&[]), None);
    }

    #[test]
    fn it_goes_along_the_edge_where_the_amount_is_right() {
        let (nothing, _) = edged(&[0.0; 36]);
        let mut search = Descent::new(near(problem(1)), nothing.loss);
        let reached = lowest(&mut search, 30);
        // On the edge the least spread is that of the nearest point to 0.3 (0, 1, 0, 1, ..) with the sum of 0.5: (18 0.3 - 0.5)^2 / 36.
        let least = (18.0 * 0.3 - 0.5f64).powi(2) / 36.0;
        assert!(nothing.loss > 4.0 && reached < least + 0.15, "{} {reached} {least}", nothing.loss);
        // By losses alone it takes more trials to come as far: 30 epochs have 150 and some, and as many gradients.
        let blind = lowest(&mut Blind::new(near(problem(1))), 30);
        assert!(blind > reached + 0.2, "{blind} {reached}");
    }

    #[test]
    fn it_goes_the_ways_that_the_scene_lets_it() {
        let freedoms = vec![Freedom::Up, Freedom::Sideways];
        let of_scene = |knots| {
            let path = PathSplines { knots, freedoms: freedoms.clone() };
            let scene = Scene::load("bench").unwrap().with(|spec| spec.skill.path = path).unwrap();
            near(Problem::new(&scene, 1).without_obstacles())
        };
        for knots in [1, 5] {
            let searches: [Box<dyn Search>; 2] =
                [Box::new(Descent::new(of_scene(knots), 3.0)), Box::new(Blind::new(of_scene(knots)))];
            for mut search in searches {
                let trials = search.ask(false);
                let splines = trials[0].splines.as_ref().unwrap();
                assert_eq!((&splines.freedoms, splines.knots()), (&freedoms, knots as usize));
                search.tell(&trials.iter().map(found).collect::<Vec<_>>()).unwrap();
            }
        }
        assert_eq!(near(problem(1)).dimensions(), 36);
    }

    #[test]
    fn gradients_that_were_taken_far_away_do_not_count() {
        let unit =
            |k: usize, size: f64| -> Vec<f64> { (0..36).map(|j| if j == k { size } else { 0.0 }).collect() };
        let mut search = Descent::new(near(problem(1)), 3.0);
        search.length = 1.0;
        search.bundle = vec![(unit(0, 3.0), unit(0, 1.0)), (unit(0, 0.0), unit(1, 1.0))];
        assert_eq!(search.direction(), Some(unit(1, -1.0)));
        search.bundle[0].0 = unit(0, 1.0);
        let both = search.direction().unwrap();
        assert!((both[0] - both[1]).abs() < 1e-12 && (norm(&both) - 1.0).abs() < 1e-12, "{both:?}");
    }

    /// A skill whose loss is by chance lower than that of any path near by, on a bench where most of the loss is not to be avoided.
    #[test]
    fn a_lucky_skill_does_not_hold_it() {
        let (nothing, _) = edged(&[0.0; 36]);
        // As good as drawn from each motion's coefficients.
        let luck = |c: &[f64]| {
            let mixed = c.iter().fold(0, |mixed: u64, x| {
                (mixed.rotate_left(5) ^ x.to_bits()).wrapping_mul(0x9e37_79b9_7f4a_7c15)
            });
            1.0 + 0.1 * ((mixed >> 32) as f64 / f64::from(u32::MAX) - 0.5)
        };
        let mut search = Descent::new(near(problem(1)), 38.0);
        let mut last = 0.0;
        for _ in 0..60 {
            let trials = search.ask(false);
            let told = |trial: &Trial| {
                let found = found(trial);
                let luck = luck(&trial.splines.as_ref().unwrap().coefficients);
                let evaluation =
                    Evaluation::new(luck * (40.0 + found.evaluation.loss), 0, found.evaluation.census);
                Found { evaluation, ..found }
            };
            let told: Vec<_> = trials.iter().map(told).collect();
            if let Some(ended) = search.tell(&told).unwrap() {
                last = edged(&ended.trial.splines.unwrap().coefficients).0.loss;
            }
        }
        let way = norm(&search.at);
        assert!(last < 0.4 * nothing.loss && way > 0.5, "{last} {} {way}", nothing.loss);
    }

    /// Gradients that point uphill: it turns back again and again, and never goes far up.
    #[test]
    fn a_wrong_gradient_does_not_lead_it_away() {
        let (nothing, _) = edged(&[0.0; 36]);
        let mut search = Descent::new(near(problem(1)), nothing.loss);
        for _ in 0..80 {
            let trials = search.ask(false);
            let wrong = |trial: &Trial| {
                let found = found(trial);
                Found { gradient: found.gradient.map(|slopes| slopes.iter().map(|x| -x).collect()), ..found }
            };
            search.tell(&trials.iter().map(wrong).collect::<Vec<_>>()).unwrap();
            assert!(edged(&search.at).0.loss <= (1.0 + CHANCE) * nothing.loss, "{:?}", search.at);
        }
        assert!(search.anew > 5, "{}", search.anew);
    }

    #[test]
    fn what_the_arm_cannot_perform_is_not_asked_for() {
        let high = |splines: &Splines| splines.coefficients.iter().any(|c| c.abs() > 0.2);
        let problem = problem(1).with_blocked_paths(high);
        let (nothing, _) = edged(&[0.0; 36]);
        let searches: [Box<dyn Search>; 2] = [
            Box::new(Descent::new(near(problem.clone()), nothing.loss)),
            Box::new(Blind::new(near(problem))),
        ];
        for mut search in searches {
            for _ in 0..20 {
                let trials = search.ask(false);
                assert!(trials.iter().all(|trial| !high(trial.splines.as_ref().unwrap())));
                assert!(trials.iter().all(|trial| trial.is_rounded && trial.world == World::Fine));
                search.tell(&trials.iter().map(found).collect::<Vec<_>>()).unwrap();
            }
        }
    }

    #[test]
    fn where_no_way_leads_down_it_ends_its_epochs_all_the_same() {
        let flat = Evaluation::new(3.0, 0, Census::default());
        // Slopes of nothing, or none at all, as where powder escapes.
        for slopes in [Some(vec![0.0; 36]), None] {
            let mut search = Descent::new(near(problem(1)), 3.0);
            let mut ended = 0;
            for _ in 0..40 {
                let trials = search.ask(false);
                let told = |trial: &Trial| Found {
                    evaluation: flat,
                    gradient: slopes.clone().filter(|_| trial.adjoint.is_some()),
                };
                let told: Vec<_> = trials.iter().map(told).collect();
                ended += u32::from(search.tell(&told).unwrap().is_some());
            }
            assert_eq!(ended, 20);
        }
        // However long it finds none, by the next that there are it goes on.
        let (nothing, _) = edged(&[0.0; 36]);
        let mut search = Descent::new(near(problem(1)), nothing.loss);
        for _ in 0..40 {
            let trials = search.ask(false);
            let told = |trial: &Trial| Found { gradient: None, ..found(trial) };
            search.tell(&trials.iter().map(told).collect::<Vec<_>>()).unwrap();
        }
        let reached = lowest(&mut search, 10);
        assert!(reached < 0.6 * nothing.loss, "{reached} {}", nothing.loss);
        let mut search = Descent::new(near(problem(1)), 3.0);
        let trials = search.ask(false);
        let nonsense = Found { evaluation: flat, gradient: Some(vec![f64::NAN; 36]) };
        assert_eq!(trials.len(), 1);
        let error = search.tell(&[nonsense]).unwrap_err().to_string();
        assert_eq!(error, "the gradient with respect to the path's coefficient 0 is NaN");
    }

    /// Where powder escapes there is no gradient: the way goes on by those that are known, and comes as low.
    #[test]
    fn a_place_without_a_gradient_does_not_end_it() {
        let (nothing, _) = edged(&[0.0; 36]);
        let mut search = Descent::new(near(problem(1)), nothing.loss);
        let (mut asked, mut reached) = (0, f64::INFINITY);
        for _ in 0..80 {
            let trials = search.ask(false);
            let told = |trial: &Trial| {
                let found = found(trial);
                asked += u32::from(trial.adjoint.is_some());
                // Nor is there ever one where it begins.
                let begins = trial.splines.as_ref().unwrap().coefficients.iter().all(|c| *c == 0.0);
                let is_lost = trial.adjoint.is_some() && (begins || asked % 3 == 2);
                Found { gradient: found.gradient.filter(|_| !is_lost), ..found }
            };
            let told: Vec<_> = trials.iter().map(told).collect();
            reached = told.iter().map(|found| found.evaluation.loss).fold(reached, f64::min);
            search.tell(&told).unwrap();
        }
        assert!(asked > 20 && reached < 0.5 * nothing.loss, "{asked} {reached} {}", nothing.loss);
    }

    #[test]
    fn a_path_begins_with_the_best_skill_once_the_amount_is_met() {
        for by in [By::Gradient, By::Losses] {
            let mut search = SkillThenPath::new(problem(1), by);
            let mut skills = Vec::new();
            // Half of what is wanted arrives in the scene itself, until the third epoch there; the fifth gains little.
            let mut fine = 0;
            let first = loop {
                let trials = search.ask(false);
                if trials[0].splines.is_some() {
                    break trials;
                }
                fine += u32::from(trials[0].is_rounded);
                let arrives = if fine < 3 { 600 } else { 1190 };
                let told: Vec<Found> = (0..trials.len())
                    .map(|k| {
                        let census = Census { target: arrives, ..Census::default() };
                        let loss = 100.0 + f64::from(k as u32)
                            - 15.0 * f64::from(fine.min(4))
                            - 0.1 * f64::from(fine);
                        Found { evaluation: Evaluation::new(loss, 0, census), gradient: None }
                    })
                    .collect();
                skills = trials.iter().map(|trial| trial.point.clone()).collect();
                search.tell(&told).unwrap();
            };
            assert_eq!(fine, 5);
            assert!(first.iter().all(|trial| trial.point == skills[0]), "the lowest of the last");
        }
        assert!(Method::Path.has_adjoint() && !Method::PathCmaEs.has_adjoint());
    }
}
