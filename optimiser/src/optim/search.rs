//! A run of epochs: epoch e evaluates theta_e, records it, then updates; N epochs are N updates and N + 1
//! evaluations, the last of them without gradient, since nothing follows it.
//!
//! No theta is evaluated twice. Where the noise leaves nothing of the gradient in any component, or all that is left points
//! out of the range, theta would stay where it is: then the differences are taken over twice the distance, which halves
//! their noise, up to [`WIDEST_HALF_STEP`]; and if that leads nowhere either, the search begins anew from another draw.

use super::{
    Estimate, Estimator, EstimatorState, Findings, GradientError, Place, Probe, RmsProp, RmsPropState,
    drawn_theta,
};
use powderline_simulator::{
    rollout::{Census, Evaluation},
    scene::Scene,
    skill::{Theta, ThetaGradient},
};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Losses are sums of distances, metres: more is not what comes of millions of particles within some metres, and too much
/// for an axis.
const MAX_LOSS_M: f64 = 1e12;

/// Half-step beyond which differences are no slope any more, in units of theta, which goes from -1 to 1.
pub const WIDEST_HALF_STEP: f64 = 0.4;

/// What followed an epoch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Step {
    /// Nothing: it was the last.
    #[default]
    None,
    /// An update along the gradient.
    Update,
    /// No direction led anywhere: the next epoch's theta is another draw.
    Restart,
}

/// One evaluated epoch; one line of `metrics.jsonl`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EpochRecord {
    /// Updates made before this evaluation.
    pub epoch: u32,
    /// Loss, metres.
    pub loss: f64,
    /// Target count minus particles in the target container.
    pub indicator: i64,
    /// Particles by where they are at the end.
    pub census: Census,
    /// Skill parameters that were evaluated.
    pub theta: Theta,
    /// What the update used as the gradient of the loss; none at the last epoch. In components that it does not
    /// change: the adjoint's value, 0 if no adjoint was computed.
    pub gradient: Option<ThetaGradient>,
    /// Wall time of all the epoch's evaluations, seconds.
    pub seconds: f64,
    /// The adjoint, where it was computed.
    pub adjoint: [Option<f64>; 5],
    /// Central differences of the loss, where they were computed.
    pub differences: [Option<f64>; 5],
    /// Weight of the adjoint in the gradient, 0 to 1, in the components that the update changes.
    pub first_order_weight: [Option<f64>; 5],
    /// Half-step of the differences, in units of theta; none where there are no differences.
    pub half_step: Option<f64>,
    /// Rollouts beside the one at theta, for the differences.
    pub probes: u32,
    /// What followed.
    pub step: Step,
}

impl EpochRecord {
    fn is_sound(&self, epoch: u32) -> bool {
        let timed = (0.0..=f64::MAX).contains(&self.seconds);
        self.epoch == epoch && is_loss(self.loss) && timed
    }
}

pub(crate) fn is_loss(loss: f64) -> bool {
    (0.0..=MAX_LOSS_M).contains(&loss)
}

/// How the search goes from epoch to epoch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Method {
    /// What becomes of a gradient.
    pub rule: RmsProp,
    /// Where the gradient comes from.
    pub estimator: Estimator,
    /// Where to begin anew.
    pub restarts: Restarts,
}

/// Where a search begins anew that has nowhere to go: what its first theta was drawn from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Restarts {
    /// `[low, high]` for each component.
    pub ranges: [[f64; 2]; 5],
    /// Seed of the draws.
    pub seed: u64,
}

impl Method {
    /// As the scene has it.
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let restarts = Restarts { ranges: scene.skill.initial_theta, seed };
        Self { rule: (&scene.optimiser).into(), estimator: (&scene.optimiser).into(), restarts }
    }
}

/// What to evaluate next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Request {
    /// Epoch.
    pub epoch: u32,
    /// Skill parameters.
    pub theta: Theta,
    /// Whether the adjoint is needed.
    pub want_gradient: bool,
    /// How many probes are likely to be wanted after it.
    pub probes: usize,
}

/// What comes of a [`Request`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// The skill's evaluation.
    pub evaluation: Evaluation,
    /// The gradient by an adjoint, metres, if it was wanted.
    pub adjoint: Option<ThetaGradient>,
}

/// An evaluation that the search cannot go on from.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum SearchError {
    /// The loss is no sum of distances: NaN, negative or without bound.
    #[error("the loss of epoch {epoch} is {loss}")]
    Loss {
        /// Epoch.
        epoch: u32,
        /// Loss.
        loss: f64,
    },
    /// The gradient is NaN or infinite.
    #[error("epoch {epoch}: {source}")]
    Gradient {
        /// Epoch.
        epoch: u32,
        /// Which component.
        source: GradientError,
    },
    /// A gradient or probes were asked for and not delivered.
    #[error("the evaluation of epoch {epoch} came back without {missing} that was asked for")]
    Missing {
        /// Epoch.
        epoch: u32,
        /// What is missing.
        missing: &'static str,
    },
}

/// A search in progress. Serialises bit for bit (in a binary format, or one that keeps every digit).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Search {
    epochs: u32,
    state: RmsPropState,
    estimates: EstimatorState,
    history: Vec<EpochRecord>,
    settled: bool,
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

impl Search {
    /// A search of `epochs` updates from `theta`.
    pub fn new(theta: Theta, epochs: u32) -> Self {
        Self {
            epochs,
            state: RmsPropState::new(theta),
            estimates: EstimatorState::default(),
            history: Vec::new(),
            settled: false,
        }
    }

    /// Whether epochs can have led here, so that more of them can follow. Numbers that are only written down or added up may
    /// be anything.
    pub fn is_sound(&self) -> bool {
        let updates = self.state.updates;
        // The last epoch is evaluated without an update.
        let evaluated = self.history.len() - usize::from(self.is_complete());
        updates <= self.epochs
            && evaluated == updates as usize
            && !(self.settled && self.history.is_empty())
            && self.state.is_sound()
            && self.estimates.is_sound(updates)
            && (0..).zip(&self.history).all(|(epoch, record)| record.is_sound(epoch))
    }

    /// What to evaluate next; nothing when the search is done.
    pub fn next(&self, method: &Method) -> Option<Request> {
        let place = self.place(&method.rule);
        (!self.is_done()).then(|| Request {
            epoch: place.epoch,
            theta: place.theta,
            want_gradient: !self.is_last() && method.estimator.wants_adjoint(&self.estimates, &place),
            probes: self.probes(method, None).len(),
        })
    }

    /// The points whose losses are needed besides, now that the answer to [`Search::next`] has `adjoint`.
    pub fn probes(&self, method: &Method, adjoint: Option<&ThetaGradient>) -> Vec<Probe> {
        if self.is_last() {
            return Vec::new();
        }
        method.estimator.probes(&self.estimates, &self.place(&method.rule), adjoint)
    }

    /// The points whose losses are needed besides, now that `rings` hold those of [`Search::probes`] and of this function's
    /// earlier answers; none if theta moves, or if no wider ring is left.
    ///
    /// # Errors
    /// Those of [`Search::record`].
    pub fn wider(
        &self,
        method: &Method,
        answer: &Answer,
        rings: &[Vec<f64>],
    ) -> Result<Vec<Probe>, SearchError> {
        let Some(estimator) = method.estimator.widened(rings.len()) else { return Ok(Vec::new()) };
        if self.is_last() {
            return Ok(Vec::new());
        }
        let attempt = self.attempt(method, answer, rings)?;
        if attempt.moves(&self.state.theta) {
            return Ok(Vec::new());
        }
        Ok(estimator.probes(&attempt.estimates.elsewhere(), &self.place(&method.rule), None))
    }

    /// Takes the answers to [`Search::next`], [`Search::probes`] and [`Search::wider`], and updates theta unless this was the
    /// last epoch.
    ///
    /// # Errors
    /// Loss or gradient not finite, or one of them missing; the search is then unchanged.
    pub fn record(
        &mut self,
        method: &Method,
        answer: &Answer,
        rings: &[Vec<f64>],
        seconds: f64,
    ) -> Result<&EpochRecord, SearchError> {
        let RmsPropState { theta, updates: epoch, .. } = self.state;
        let evaluation = &answer.evaluation;
        if !is_loss(evaluation.loss) {
            return Err(SearchError::Loss { epoch, loss: evaluation.loss });
        }
        let (estimate, step) = if self.is_last() {
            (Estimate::default(), Step::None)
        } else {
            self.update(method, answer, rings)?
        };
        let widest = rings.len().saturating_sub(1);
        let has_differences = estimate.differences.iter().any(Option::is_some);
        let record = EpochRecord {
            epoch,
            loss: evaluation.loss,
            indicator: evaluation.indicator,
            census: evaluation.census,
            theta,
            gradient: (step != Step::None).then_some(estimate.gradient),
            seconds,
            adjoint: estimate.adjoint,
            differences: estimate.differences,
            first_order_weight: estimate.first_order_weight,
            half_step: method
                .estimator
                .widened(widest)
                .filter(|_| has_differences)
                .map(|wide| wide.half_step),
            probes: rings.iter().map(Vec::len).sum::<usize>() as u32,
            step,
        };
        Ok(self.history.push_mut(record))
    }

    /// Goes a step along the estimated gradient, or begins anew where that is none.
    fn update(
        &mut self,
        method: &Method,
        answer: &Answer,
        rings: &[Vec<f64>],
    ) -> Result<(Estimate, Step), SearchError> {
        if !self.wider(method, answer, rings)?.is_empty() {
            return Err(SearchError::Missing { epoch: self.state.updates, missing: "a wider probe" });
        }
        let attempt = self.attempt(method, answer, rings)?;
        let step = if attempt.moves(&self.state.theta) { Step::Update } else { Step::Restart };
        (self.state, self.estimates) = match step {
            Step::Restart => {
                let Restarts { ranges, seed } = &method.restarts;
                let theta = drawn_theta(ranges, *seed, 1 + self.restarts());
                (attempt.state.restarted(theta), attempt.estimates.elsewhere())
            }
            _ => (attempt.state, attempt.estimates),
        };
        Ok((attempt.estimate, step))
    }

    /// What comes of the findings: of the first ring and the adjoint together, then of each wider ring alone.
    fn attempt(&self, method: &Method, answer: &Answer, rings: &[Vec<f64>]) -> Result<Attempt, SearchError> {
        let place = self.place(&method.rule);
        let epoch = place.epoch;
        let missing = |missing| SearchError::Missing { epoch, missing };
        let wanted = method.estimator.wants_adjoint(&self.estimates, &place);
        let adjoint = answer.adjoint.filter(|_| wanted);
        if wanted && adjoint.is_none() {
            return Err(missing("the gradient"));
        }
        let go = |estimator: &Estimator,
                  known: &EstimatorState,
                  adjoint: Option<ThetaGradient>,
                  probes: &[f64]| {
            if probes.len() != estimator.probes(known, &place, adjoint.as_ref()).len() {
                return Err(missing("a probe"));
            }
            let found = Findings { loss: answer.evaluation.loss, adjoint, probes };
            let (estimate, estimates) = estimator.combine(known, &place, &found);
            let state = method
                .rule
                .update(&self.state, &estimate.gradient, &estimate.noise)
                .map_err(|source| SearchError::Gradient { epoch, source })?;
            Ok(Attempt { estimate, estimates, state })
        };
        let [first, wider @ ..] = rings else { return Err(missing("a probe")) };
        let mut last = go(&method.estimator, &self.estimates, adjoint, first)?;
        for (ring, probes) in (1..).zip(wider) {
            if last.moves(&place.theta) {
                return Err(missing("an end of its probes"));
            }
            let estimator = method.estimator.widened(ring).ok_or(missing("an end of its probes"))?;
            let wide = go(&estimator, &last.estimates.elsewhere(), None, probes)?;
            // Curvature is all that their second differences would tell.
            let adjoint = last.estimate.adjoint;
            last = Attempt { estimate: Estimate { adjoint, ..wide.estimate }, state: wide.state, ..last };
        }
        Ok(last)
    }

    /// How often it began anew.
    fn restarts(&self) -> u32 {
        self.history.iter().filter(|record| record.step == Step::Restart).count() as u32
    }

    fn place(&self, rule: &RmsProp) -> Place {
        let RmsPropState { theta, updates, .. } = self.state;
        Place { epoch: updates, theta, active: rule.active_components(updates) }
    }

    /// Whether the next epoch is the last, which no update follows.
    fn is_last(&self) -> bool {
        self.state.updates >= self.epochs
    }

    /// Prolongs the search to `epochs` updates. The last epoch of a search that was done is taken back, to be
    /// evaluated again with its gradient: the result has the bits of a search that was this long from the start.
    pub fn extend(&mut self, epochs: u32) {
        if self.is_complete() && epochs > self.epochs {
            self.history.pop();
        }
        self.epochs = self.epochs.max(epochs);
    }

    /// Whether nothing is left to evaluate.
    pub fn is_done(&self) -> bool {
        self.settled || self.is_complete()
    }

    /// Whether all epochs are evaluated.
    fn is_complete(&self) -> bool {
        self.history.len() > self.epochs as usize
    }

    /// Ends the search before its last epoch: what was found is good enough.
    pub fn settle(&mut self) {
        self.settled = !self.history.is_empty();
    }

    /// Goes on after all: what was found is not good enough.
    pub fn unsettle(&mut self) {
        self.settled = false;
    }

    /// Whether it was ended before its last epoch.
    pub fn is_settled(&self) -> bool {
        self.settled && !self.is_complete()
    }

    /// Updates that the search makes in all.
    pub fn epochs(&self) -> u32 {
        self.epochs
    }

    /// The evaluated epochs, in order.
    pub fn history(&self) -> &[EpochRecord] {
        &self.history
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_simulator::scene::GradientEstimator;

    const METHOD: Method = Method {
        rule: RmsProp { beta: 0.9, learning_rate: 0.05, epsilon: 1e-8, curriculum_epochs: 4 },
        estimator: Estimator { gradient: GradientEstimator::Mixed, half_step: 0.1 },
        restarts: Restarts { ranges: [[-0.9, 0.9]; 5], seed: 3 },
    };

    fn at(components: [f64; 5]) -> Theta {
        Theta::new(components).unwrap()
    }

    /// A bowl whose gradient is wrong in depth, so that the search has all kinds of epochs.
    fn bowl(theta: &Theta, want_gradient: bool) -> Answer {
        let theta = theta.components();
        let loss: f64 = theta.iter().map(|x| (x - 0.3) * (x - 0.3)).sum();
        let mut slope = theta.map(|x| 2.0 * (x - 0.3));
        slope[0] += 1e3 * libm::sin(1e6 * theta[0]);
        let census = Census { target: 1, ..Census::default() };
        Answer { evaluation: Evaluation::new(loss, 5, census), adjoint: want_gradient.then_some(slope) }
    }

    fn probed(search: &Search, method: &Method, answer: &Answer) -> Vec<Vec<f64>> {
        probed_in(search, method, answer, |theta| bowl(theta, false).evaluation.loss)
    }

    /// The losses of all rings that the search asks for.
    fn probed_in(
        search: &Search,
        method: &Method,
        answer: &Answer,
        loss: impl Fn(&Theta) -> f64,
    ) -> Vec<Vec<f64>> {
        let losses =
            |probes: Vec<Probe>| -> Vec<f64> { probes.iter().map(|probe| loss(&probe.theta)).collect() };
        let mut rings = vec![losses(search.probes(method, answer.adjoint.as_ref()))];
        loop {
            match search.wider(method, answer, &rings).unwrap() {
                none if none.is_empty() => return rings,
                probes => rings.push(losses(probes)),
            }
        }
    }

    fn advance_by(search: &mut Search, method: &Method, epochs: usize) {
        for _ in 0..epochs {
            let request = search.next(method).unwrap();
            let answer = bowl(&request.theta, request.want_gradient);
            let losses = probed(search, method, &answer);
            search.record(method, &answer, &losses, 0.0).unwrap();
            assert!(search.is_sound());
        }
    }

    fn advance(search: &mut Search, epochs: usize) {
        advance_by(search, &METHOD, epochs);
    }

    #[test]
    fn evaluates_one_more_epoch_than_it_updates() {
        let mut search = Search::new(at([-0.5; 5]), 10);
        advance(&mut search, 11);
        assert!(search.is_done() && search.next(&METHOD).is_none());
        assert_eq!(
            search.history().iter().map(|record| record.epoch).collect::<Vec<_>>(),
            (0..=10).collect::<Vec<_>>()
        );
        assert!(search.history()[..10].iter().all(|record| record.gradient.is_some()));
        assert!(search.history()[10].gradient.is_none());
    }

    #[test]
    fn saved_and_loaded_search_goes_on_with_the_same_bits() {
        let mut whole = Search::new(at([-0.5, 0.9, 0.123, -0.7, 0.1]), 10);
        advance(&mut whole, 11);
        for interruption in 0..=10 {
            let mut search = Search::new(at([-0.5, 0.9, 0.123, -0.7, 0.1]), 10);
            advance(&mut search, interruption);
            let mut loaded: Search = postcard::from_bytes(&postcard::to_allocvec(&search).unwrap()).unwrap();
            advance(&mut loaded, 11 - interruption);
            assert_eq!(postcard::to_allocvec(&loaded).unwrap(), postcard::to_allocvec(&whole).unwrap());
        }
    }

    #[test]
    fn extended_search_has_the_bits_of_a_longer_one() {
        let mut long = Search::new(at([-0.5; 5]), 10);
        advance(&mut long, 11);
        let mut short = Search::new(at([-0.5; 5]), 6);
        advance(&mut short, 7);
        short.extend(10);
        assert_eq!(short.next(&METHOD).map(|request| request.epoch), Some(6));
        advance(&mut short, 5);
        assert_eq!(short, long);
    }

    #[test]
    fn what_is_not_finite_leaves_the_search_unchanged() {
        let mut search = Search::new(at([-0.5; 5]), 10);
        let before = search.clone();
        let sound = bowl(&at([-0.5; 5]), true);
        let losses = probed(&search, &METHOD, &sound);
        let costing = |loss: f64| {
            let Evaluation { indicator, census, .. } = sound.evaluation;
            Answer { evaluation: Evaluation::new(loss, indicator, census), ..sound }
        };
        for broken in [
            costing(f64::NAN),
            costing(f64::MAX),
            costing(-1.0),
            Answer { adjoint: Some([f64::INFINITY; 5]), ..sound },
            Answer { adjoint: None, ..sound },
        ] {
            assert!(search.record(&METHOD, &broken, &losses, 0.0).is_err());
            assert_eq!(search, before);
        }
        let ring = &losses[0];
        let broken_rings = [
            vec![],
            vec![vec![]],
            vec![vec![f64::NAN; ring.len()]],
            vec![[&ring[..], &[1.0]].concat()],
            vec![ring.clone(), ring.clone()],
            vec![vec![1.0; ring.len()], vec![]],
        ];
        for broken in broken_rings {
            assert!(search.record(&METHOD, &sound, &broken, 0.0).is_err());
            assert_eq!(search, before);
        }
    }

    #[test]
    fn what_no_epochs_lead_to_is_not_sound() {
        let mut sound = Search::new(at([-0.5; 5]), 10);
        advance(&mut sound, 5);
        let defects: [fn(&mut Search); 13] = [
            |search| search.epochs = 4,
            |search| search.state.updates = 6,
            |search| search.state.updates = u32::MAX,
            |search| search.state.paces[0].mean_square = -1.0,
            |search| search.state.paces[0].mean_square = f64::INFINITY,
            |search| search.state.paces[0].rate = 1.001,
            |search| search.state.paces[0].slope = f64::NAN,
            |search| search.history.clear(),
            |search| search.state.before_restart = 6,
            |search| search.history[1].epoch = u32::MAX,
            |search| search.history[1].loss = f64::MAX,
            |search| search.history[1].loss = f64::NAN,
            |search| search.history[1].seconds = f64::INFINITY,
        ];
        for (index, defect) in defects.into_iter().enumerate() {
            let mut search = sound.clone();
            defect(&mut search);
            assert!(!search.is_sound(), "{index}");
        }
    }

    /// Nothing arrives anywhere but in a corner.
    fn plateau(theta: &Theta) -> f64 {
        let [depth, ..] = theta.components();
        if depth > 0.5 { 9.0 - depth } else { 9.0 }
    }

    fn step_on(search: &mut Search, method: &Method, loss: impl Fn(&Theta) -> f64) -> EpochRecord {
        let request = search.next(method).unwrap();
        let mut answer =
            Answer { adjoint: request.want_gradient.then_some([0.0; 5]), ..bowl(&request.theta, false) };
        answer.evaluation.loss = loss(&request.theta);
        let rings = probed_in(search, method, &answer, loss);
        *search.record(method, &answer, &rings, 0.0).unwrap()
    }

    #[test]
    fn a_search_that_stands_still_looks_wider_and_then_begins_anew() {
        let method = Method { rule: RmsProp { curriculum_epochs: 0, ..METHOD.rule }, ..METHOD };
        // From 0.2 the corner is seen over 0.4 alone.
        let mut search = Search::new(at([0.2, 0.0, 0.0, 0.0, 0.0]), 10);
        let record = step_on(&mut search, &method, plateau);
        assert_eq!((record.step, record.half_step, record.probes), (Step::Update, Some(0.4), 30));
        assert!(search.next(&method).unwrap().theta.components()[0] > 0.2);
        // From -0.5 it is not seen at all.
        let mut search = Search::new(at([-0.5; 5]), 10);
        let thetas: Vec<Theta> = (0..10).map(|_| step_on(&mut search, &method, |_| 9.0).theta).collect();
        assert!(search.history().iter().all(|record| record.step == Step::Restart), "{search:?}");
        for (index, theta) in thetas.iter().enumerate() {
            assert!(!thetas[..index].contains(theta), "epoch {index} was evaluated before");
        }
        assert!(thetas[1..].iter().flat_map(Theta::components).all(|x| x.abs() <= 0.9));
        let bits = |theta: Theta| theta.components().map(f64::to_bits);
        assert_eq!(bits(thetas[1]), bits(drawn_theta(&method.restarts.ranges, 3, 1)));
        assert!(search.is_sound());
    }

    #[test]
    fn a_corner_that_the_slope_points_out_of_is_left() {
        let estimator = Estimator { gradient: GradientEstimator::Adjoint, ..METHOD.estimator };
        let method = Method { estimator, ..METHOD };
        let mut search = Search::new(at([1.0; 5]), 10);
        let answer = Answer { adjoint: Some([-1.0; 5]), ..bowl(&at([1.0; 5]), false) };
        let record = *search.record(&method, &answer, &[vec![]], 0.0).unwrap();
        assert_eq!((record.step, record.half_step, record.probes), (Step::Restart, None, 0));
        // The first step from there is as long as that from the first theta.
        let theta = search.next(&method).unwrap().theta;
        let answer = Answer { adjoint: Some([1.0; 5]), ..bowl(&theta, false) };
        search.record(&method, &answer, &[vec![]], 0.0).unwrap();
        let depth = |theta: Theta| theta.components()[0];
        let went = depth(theta) - depth(search.next(&method).unwrap().theta);
        assert!((went - method.rule.learning_rate).abs() < 1e-6, "{went}");
    }

    #[test]
    fn a_settled_search_is_done_and_stays_so_until_it_is_to_go_on() {
        let mut search = Search::new(at([-0.5; 5]), 10);
        search.settle();
        assert!(!search.is_done(), "nothing is found yet");
        advance(&mut search, 4);
        search.settle();
        search.extend(20);
        assert!(
            search.is_done() && search.is_settled() && search.is_sound() && search.next(&METHOD).is_none()
        );
        assert_eq!((search.history().len(), search.epochs()), (4, 20));
        search.unsettle();
        assert!(!search.is_done() && search.next(&METHOD).is_some());
    }

    #[test]
    fn adjoint_alone_needs_no_probes() {
        let estimator = Estimator { gradient: GradientEstimator::Adjoint, ..METHOD.estimator };
        let method = Method { estimator, ..METHOD };
        let mut search = Search::new(at([-0.5; 5]), 10);
        assert_eq!(
            search.next(&method).map(|request| (request.want_gradient, request.probes)),
            Some((true, 0))
        );
        advance_by(&mut search, &method, 11);
        for record in &search.history()[..10] {
            let gradient = bowl(&record.theta, true).adjoint;
            assert_eq!(record.gradient, gradient);
            assert_eq!((record.adjoint, record.differences), (gradient.unwrap().map(Some), [None; 5]));
        }
    }

    #[test]
    fn records_tell_where_the_gradient_comes_from() {
        let mut search = Search::new(at([-0.5; 5]), 10);
        advance(&mut search, 11);
        let [first, .., last] = search.history() else { panic!("there are eleven epochs") };
        assert!(first.adjoint.iter().all(Option::is_some));
        assert_eq!(first.differences.map(|value| value.is_some()), [true, true, true, false, false]);
        assert_eq!(first.first_order_weight.map(|value| value.is_some()), [true, true, true, false, false]);
        assert_eq!(
            (last.adjoint, last.differences, last.first_order_weight),
            ([None; 5], [None; 5], [None; 5])
        );
        // The wrong component is measured throughout, the others are trusted after two epochs.
        assert!(search.history()[..10].iter().all(|record| record.differences[0].is_some()));
        assert!(search.history()[2].differences[1].is_none());
    }
}
