//! Down a gradient: epoch e evaluates theta_e, then updates it by RMSprop; the last epoch is evaluated without gradient, since nothing
//! follows it.
//!
//! No theta is evaluated twice. Where the noise leaves nothing of the gradient in any component, or all that is left points
//! out of the range, theta would stay where it is: then the differences are taken over twice the distance, which halves
//! their noise, up to [`WIDEST_HALF_STEP`]; and if that leads nowhere either, the search begins anew from another draw.

mod estimate;
mod rmsprop;

pub use estimate::{
    Estimate, Estimator, EstimatorState, Findings, Place, Probe, REMEASURE_EPOCHS, Source, TRUSTED_WEIGHT,
    USELESS_WEIGHT,
};
pub use rmsprop::{Pace, RmsProp, RmsPropState};

use super::{Epoch, Found, Search, SearchError, Slopes, Step, Trial, check, drawn_theta};
use powderline_simulator::{
    rollout::Evaluation,
    skill::{Theta, ThetaGradient},
};

/// Half-step beyond which differences are no slope any more, in units of theta, which goes from -1 to 1.
pub const WIDEST_HALF_STEP: f64 = 0.4;

/// Half-step of the differences: far enough for single grains to average out.
pub const HALF_STEP: f64 = 0.1;

/// A search down a gradient, on its way.
#[derive(Clone, Debug)]
pub struct Descent {
    rule: RmsProp,
    estimator: Estimator,
    /// `[low, high]` of each component, and the seed, that thetas to begin from are drawn from.
    draws: ([[f64; 2]; 5], u64),
    state: RmsPropState,
    estimates: EstimatorState,
    began_anew: u32,
    is_last: bool,
    /// Of the present epoch.
    answer: Option<Answer>,
    /// Losses of its probes, ring by ring.
    rings: Vec<Vec<f64>>,
}

/// What came of the present theta.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Answer {
    evaluation: Evaluation,
    adjoint: Option<ThetaGradient>,
}

/// What an epoch's findings make of the search.
struct Attempt {
    estimate: Estimate,
    estimates: EstimatorState,
    state: RmsPropState,
}

impl Attempt {
    /// Whether theta is another one after it.
    fn moves(&self, from: &Theta) -> bool {
        self.state.theta.components().map(f64::to_bits) != from.components().map(f64::to_bits)
    }
}

impl Descent {
    /// A search that begins with the first theta that is drawn from `ranges`, `[low, high]` for each component.
    pub fn new(source: Source, ranges: &[[f64; 2]; 5], seed: u64) -> Self {
        Self::from_theta(RmsProp::default(), source, drawn_theta(ranges, seed, 0), (*ranges, seed))
    }

    fn from_theta(rule: RmsProp, source: Source, theta: Theta, draws: ([[f64; 2]; 5], u64)) -> Self {
        Self {
            rule,
            estimator: Estimator { gradient: source, half_step: HALF_STEP },
            draws,
            state: RmsPropState::new(theta),
            estimates: EstimatorState::default(),
            began_anew: 0,
            is_last: false,
            answer: None,
            rings: Vec::new(),
        }
    }

    fn place(&self) -> Place {
        Place { epoch: self.state.updates, theta: self.state.theta }
    }

    fn wants_adjoint(&self) -> bool {
        !self.is_last && self.estimator.wants_adjoint(&self.estimates, &self.place())
    }

    fn probes(&self, adjoint: Option<&ThetaGradient>) -> Vec<Probe> {
        if self.is_last { Vec::new() } else { self.estimator.probes(&self.estimates, &self.place(), adjoint) }
    }

    /// The points whose losses are needed besides; none if theta moves by those that are known, or if no wider ring is left.
    fn wider(&self, answer: &Answer) -> Result<Vec<Probe>, SearchError> {
        let Some(estimator) = self.estimator.widened(self.rings.len()) else { return Ok(Vec::new()) };
        let attempt = self.attempt(answer)?;
        if attempt.moves(&self.state.theta) {
            return Ok(Vec::new());
        }
        Ok(estimator.probes(&attempt.estimates.elsewhere(), &self.place(), None))
    }

    /// What comes of the findings: of the first ring and the adjoint together, then of each wider ring alone.
    fn attempt(&self, answer: &Answer) -> Result<Attempt, SearchError> {
        let place = self.place();
        let go = |estimator: &Estimator,
                  known: &EstimatorState,
                  adjoint: Option<ThetaGradient>,
                  probes: &[f64]| {
            let found = Findings { loss: answer.evaluation.loss, adjoint, probes };
            let (estimate, estimates) = estimator.combine(known, &place, &found);
            let state = self.rule.update(&self.state, &estimate.gradient, &estimate.noise)?;
            Ok(Attempt { estimate, estimates, state })
        };
        let (first, wider) =
            self.rings.split_first().map_or((&[][..], &[][..]), |(first, wider)| (first, wider));
        let mut last = go(&self.estimator, &self.estimates, answer.adjoint, first)?;
        for (ring, probes) in (1..).zip(wider) {
            // It was asked for, so there is one.
            let Some(estimator) = self.estimator.widened(ring) else { break };
            let wide = go(&estimator, &last.estimates.elsewhere(), None, probes)?;
            // Curvature is all that their second differences would tell.
            let adjoint = last.estimate.adjoint;
            last = Attempt { estimate: Estimate { adjoint, ..wide.estimate }, state: wide.state, ..last };
        }
        Ok(last)
    }

    /// Goes a step along the estimated gradient, or begins anew where that is none.
    fn update(&mut self, answer: &Answer) -> Result<(Estimate, Step), SearchError> {
        let attempt = self.attempt(answer)?;
        let step = if attempt.moves(&self.state.theta) { Step::Update } else { Step::Restart };
        (self.state, self.estimates) = (attempt.state, attempt.estimates);
        if step == Step::Restart {
            self.begin_anew();
        }
        Ok((attempt.estimate, step))
    }

    /// From another theta that is drawn.
    fn begin_anew(&mut self) {
        self.began_anew += 1;
        let (ranges, seed) = &self.draws;
        self.state = self.state.restarted(drawn_theta(ranges, *seed, self.began_anew));
        self.estimates = self.estimates.elsewhere();
    }

    fn epoch(&mut self, answer: &Answer) -> Result<Epoch, SearchError> {
        let (theta, widest) = (self.state.theta, self.rings.len().saturating_sub(1));
        let (step, slopes) = if self.is_last {
            (Step::None, None)
        } else {
            let (estimate, step) = self.update(answer)?;
            let has_differences = estimate.differences.iter().any(Option::is_some);
            let half_step =
                self.estimator.widened(widest).filter(|_| has_differences).map(|wide| wide.half_step);
            let slopes = Slopes {
                gradient: estimate.gradient.to_vec(),
                adjoint: estimate.adjoint.to_vec(),
                differences: estimate.differences.to_vec(),
                first_order_weight: estimate.first_order_weight.to_vec(),
                half_step,
            };
            (step, Some(slopes))
        };
        (self.answer, self.rings) = (None, Vec::new());
        Ok(Epoch { trial: trial(&theta), evaluation: answer.evaluation, has_peers: false, step, slopes })
    }
}

/// One that comes to no end has a loss all the same, and no adjoint.
fn trial(theta: &Theta) -> Trial {
    Trial { may_fail: true, ..Trial::of(theta.components().to_vec()) }
}

impl Search for Descent {
    fn ask(&mut self, is_last: bool) -> Vec<Trial> {
        self.is_last = is_last;
        let of_probes = |probes: Vec<Probe>| probes.into_iter().map(|probe| trial(&probe.theta)).collect();
        match &self.answer {
            None if self.wants_adjoint() => {
                vec![Trial { adjoint: self.estimator.gradient.adjoint(), ..trial(&self.state.theta) }]
            }
            None => std::iter::once(trial(&self.state.theta)).chain(of_probes(self.probes(None))).collect(),
            Some(answer) if self.rings.is_empty() => of_probes(self.probes(answer.adjoint.as_ref())),
            // What cannot be gone on from was said before.
            Some(answer) => of_probes(self.wider(answer).unwrap_or_default()),
        }
    }

    fn tell(&mut self, found: &[Found]) -> Result<Option<Epoch>, SearchError> {
        check(&self.ask(self.is_last), found)?;
        let losses = |found: &[Found]| found.iter().map(|found| found.evaluation.loss).collect();
        let answer = match (self.answer, found) {
            (None, [first, ..]) if first.gradient.is_none() && self.wants_adjoint() => {
                let (trial, evaluation) = (trial(&self.state.theta), first.evaluation);
                self.begin_anew();
                let step = Step::Restart;
                return Ok(Some(Epoch { trial, evaluation, has_peers: false, step, slopes: None }));
            }
            (None, [first, probes @ ..]) => {
                let adjoint = first.gradient.as_ref().and_then(|gradient| gradient[..].try_into().ok());
                // Without an adjoint, probes came along.
                if adjoint.is_none() {
                    self.rings.push(losses(probes));
                }
                Answer { evaluation: first.evaluation, adjoint }
            }
            (Some(answer), probes) => {
                self.rings.push(losses(probes));
                answer
            }
            (None, []) => return Err(SearchError::Missing { asked: 1, told: 0 }),
        };
        self.answer = Some(answer);
        if !self.is_last {
            if self.rings.is_empty() && !self.probes(answer.adjoint.as_ref()).is_empty() {
                return Ok(None);
            }
            if self.rings.is_empty() {
                self.rings.push(Vec::new());
            }
            if !self.wider(&answer)?.is_empty() {
                return Ok(None);
            }
        }
        self.epoch(&answer).map(Some)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optim::World;
    use powderline_simulator::rollout::Census;

    const RANGES: [[f64; 2]; 5] = [[-0.9, 0.9]; 5];

    fn at(components: [f64; 5]) -> Theta {
        Theta::new(components).unwrap()
    }

    fn from(source: Source, theta: [f64; 5]) -> Descent {
        let rule = RmsProp { learning_rate: 0.05, ..RmsProp::default() };
        Descent::from_theta(rule, source, at(theta), (RANGES, 3))
    }

    fn mixed() -> Descent {
        from(Source::Mixed, [-0.5; 5])
    }

    /// A bowl whose gradient is wrong in depth, so that the search has all kinds of epochs.
    fn bowl(trial: &Trial) -> Found {
        let loss: f64 = trial.point.iter().map(|x| (x - 0.3) * (x - 0.3)).sum();
        let mut slope: Vec<f64> = trial.point.iter().map(|x| 2.0 * (x - 0.3)).collect();
        slope[0] += 1e3 * libm::sin(1e6 * trial.point[0]);
        let census = Census { target: 1, ..Census::default() };
        Found {
            evaluation: Evaluation::new(loss, 5, census),
            gradient: trial.adjoint.is_some().then_some(slope),
        }
    }

    /// One epoch, and how many trials it took.
    fn epoch(search: &mut Descent, is_last: bool, of: impl Fn(&Trial) -> Found) -> (Epoch, usize) {
        let mut count = 0;
        loop {
            let trials = search.ask(is_last);
            assert!(!trials.is_empty() && trials == search.ask(is_last), "the same until it is told");
            assert!(
                trials.iter().all(|trial| trial.world == World::Fine && !trial.is_rounded && trial.may_fail)
            );
            count += trials.len();
            let found: Vec<Found> = trials.iter().map(&of).collect();
            if let Some(epoch) = search.tell(&found).unwrap() {
                return (epoch, count);
            }
        }
    }

    fn epochs(search: &mut Descent, count: usize) -> Vec<Epoch> {
        (0..count).map(|_| epoch(search, false, bowl).0).collect()
    }

    #[test]
    fn the_last_epoch_takes_no_gradient() {
        let mut search = mixed();
        assert!(
            epochs(&mut search, 3).iter().all(|epoch| epoch.slopes.is_some() && epoch.step == Step::Update)
        );
        let (last, count) = epoch(&mut search, true, bowl);
        assert_eq!((last.step, last.slopes, count), (Step::None, None, 1));
    }

    /// It ends neither the search nor, being asked for again and again, every search that goes on with it.
    #[test]
    fn where_a_motion_comes_to_no_end_it_begins_anew() {
        let endless =
            |_: &Trial| Found { evaluation: Evaluation::new(200.0, 9, Census::default()), gradient: None };
        let mut search = from(Source::Exact, [-0.5; 5]);
        let (lost, _) = epoch(&mut search, false, endless);
        assert_eq!((lost.step, lost.slopes), (Step::Restart, None));
        let (next, _) = epoch(&mut search, false, bowl);
        assert_eq!(next.step, Step::Update);
        assert_ne!(next.trial.point, lost.trial.point);
        // By differences it has a loss like any other.
        let mut search = from(Source::Differences, [-0.5; 5]);
        let first = epoch(&mut search, false, |trial| match trial.point == [-0.5; 5] {
            true => endless(trial),
            false => bowl(trial),
        });
        assert_ne!(epoch(&mut search, false, bowl).0.trial.point, first.0.trial.point);
    }

    #[test]
    fn the_same_answers_lead_to_the_same_thetas() {
        let thetas =
            |epochs: Vec<Epoch>| epochs.into_iter().map(|epoch| epoch.trial.point).collect::<Vec<_>>();
        assert_eq!(thetas(epochs(&mut mixed(), 8)), thetas(epochs(&mut mixed(), 8)));
    }

    #[test]
    fn what_is_not_finite_or_missing_is_refused() {
        let answers: [fn(&Trial) -> Found; 4] = [
            |trial| Found { evaluation: Evaluation::new(f64::NAN, 0, Census::default()), ..bowl(trial) },
            |trial| Found { evaluation: Evaluation::new(f64::MAX, 0, Census::default()), ..bowl(trial) },
            |trial| Found { evaluation: Evaluation::new(-1.0, 0, Census::default()), ..bowl(trial) },
            |trial| Found { gradient: Some(vec![1.0; 4]), ..bowl(trial) },
        ];
        for broken in answers {
            let mut search = mixed();
            let trials = search.ask(false);
            assert!(search.tell(&trials.iter().map(broken).collect::<Vec<_>>()).is_err());
        }
        let mut search = mixed();
        assert!(search.tell(&[]).is_err());
        // A slope without end is named by its component.
        let mut search = from(Source::Exact, [-0.5; 5]);
        let trials = search.ask(false);
        let found = Found { gradient: Some(vec![0.0, f64::INFINITY, 0.0, 0.0, 0.0]), ..bowl(&trials[0]) };
        let error = search.tell(&[found]).unwrap_err().to_string();
        assert_eq!(error, "the gradient with respect to the scooping angle is inf");
    }

    /// Nothing arrives anywhere but in a corner.
    fn plateau(trial: &Trial) -> Found {
        let loss = if trial.point[0] > 0.5 { 9.0 - trial.point[0] } else { 9.0 };
        let gradient = trial.adjoint.is_some().then(|| vec![0.0; 5]);
        Found { evaluation: Evaluation::new(loss, 5, Census::default()), gradient }
    }

    fn level(trial: &Trial) -> Found {
        Found { evaluation: Evaluation::new(9.0, 5, Census::default()), ..plateau(trial) }
    }

    #[test]
    fn a_search_that_stands_still_looks_wider_and_then_begins_anew() {
        // From 0.2 the corner is seen over 0.4 alone.
        let mut search = from(Source::Mixed, [0.2, 0.0, 0.0, 0.0, 0.0]);
        let (seen, count) = epoch(&mut search, false, plateau);
        assert_eq!((seen.step, seen.slopes.unwrap().half_step, count), (Step::Update, Some(0.4), 31));
        assert!(search.ask(false)[0].point[0] > 0.2);
        // From -0.5 it is not seen at all.
        let mut search = mixed();
        let all: Vec<Epoch> = (0..10).map(|_| epoch(&mut search, false, level).0).collect();
        assert!(all.iter().all(|epoch| epoch.step == Step::Restart), "{all:?}");
        let thetas: Vec<&Vec<f64>> = all.iter().map(|epoch| &epoch.trial.point).collect();
        for (index, theta) in thetas.iter().enumerate() {
            assert!(!thetas[..index].contains(theta), "epoch {index} was evaluated before");
        }
        assert!(thetas[1..].iter().copied().flatten().all(|x| x.abs() <= 0.9));
        assert_eq!(*thetas[1], drawn_theta(&RANGES, 3, 1).components());
    }

    #[test]
    fn a_corner_that_the_slope_points_out_of_is_left() {
        let mut search = from(Source::Exact, [1.0; 5]);
        let sloping = |by: f64| move |trial: &Trial| Found { gradient: Some(vec![by; 5]), ..bowl(trial) };
        let (left, count) = epoch(&mut search, false, sloping(-1.0));
        assert_eq!((left.step, left.slopes.unwrap().half_step, count), (Step::Restart, None, 1));
        // The first step from there is as long as that from the first theta.
        let before = search.ask(false)[0].point[0];
        epoch(&mut search, false, sloping(1.0));
        let went = before - search.ask(false)[0].point[0];
        assert!((went - search.rule.learning_rate).abs() < 1e-6, "{went}");
    }

    #[test]
    fn the_adjoint_alone_needs_no_probes() {
        let mut search = from(Source::Exact, [-0.5; 5]);
        for _ in 0..10 {
            let (one, count) = epoch(&mut search, false, bowl);
            let slopes = one.slopes.unwrap();
            let gradient =
                bowl(&Trial { adjoint: Some(crate::optim::Adjoint::Exact), ..one.trial }).gradient.unwrap();
            assert_eq!((count, &slopes.gradient), (1, &gradient));
            assert_eq!(slopes.adjoint, gradient.into_iter().map(Some).collect::<Vec<_>>());
            assert_eq!((slopes.differences, slopes.half_step), (vec![None; 5], None));
        }
    }

    #[test]
    fn differences_alone_need_no_adjoint_and_come_at_once() {
        let mut search = from(Source::Differences, [-0.5; 5]);
        let trials = search.ask(false);
        assert!(trials.len() == 11 && trials.iter().all(|trial| trial.adjoint.is_none()));
        let (one, count) = epoch(&mut search, false, bowl);
        let slopes = one.slopes.unwrap();
        assert_eq!((count, &slopes.adjoint, slopes.half_step), (11, &vec![None; 5], Some(HALF_STEP)));
        assert!(slopes.gradient.iter().all(|slope| (slope + 1.6).abs() < 1e-9), "{slopes:?}");
    }

    #[test]
    fn epochs_tell_where_the_gradient_comes_from() {
        let all = epochs(&mut mixed(), 10);
        let slopes: Vec<&Slopes> = all.iter().map(|epoch| epoch.slopes.as_ref().unwrap()).collect();
        assert!(slopes[0].adjoint.iter().all(Option::is_some));
        assert!(slopes[0].differences.iter().all(Option::is_some));
        // The wrong component is measured throughout, the others are trusted after two epochs.
        assert!(slopes.iter().all(|slopes| slopes.differences[0].is_some()));
        assert!(slopes[2].differences[1].is_none());
    }

    #[test]
    fn a_bowl_is_descended_by_each_source_but_the_one_that_is_wrong() {
        // At the bottom nothing leads on, and the search begins anew.
        let lowest = |source| {
            let losses =
                epochs(&mut from(source, [-0.5; 5]), 60).into_iter().map(|epoch| epoch.evaluation.loss);
            losses.fold(f64::INFINITY, f64::min)
        };
        for source in [Source::Mixed, Source::Differences, Source::Restarted] {
            assert!(lowest(source) < 0.01, "{source:?}: {}", lowest(source));
        }
        assert!(lowest(Source::Exact) > 0.01, "{}", lowest(Source::Exact));
    }
}
