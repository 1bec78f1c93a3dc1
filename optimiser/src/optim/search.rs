//! A run of epochs: epoch e evaluates theta_e, records it, then updates; N epochs are N updates and N + 1
//! evaluations, the last of them without gradient, since nothing follows it.

use super::{
    Estimate, Estimator, EstimatorState, Findings, GradientError, Place, Probe, RmsProp, RmsPropState,
};
use powderline_simulator::{
    rollout::Evaluation,
    scene,
    skill::{Theta, check_theta},
};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Losses are sums of distances, metres: more is not what comes of millions of particles within some metres, and too much
/// for an axis.
const MAX_LOSS_M: f64 = 1e12;

/// One evaluated epoch; one line of `metrics.jsonl`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EpochRecord {
    /// Updates made before this evaluation.
    pub epoch: u32,
    /// Loss, metres.
    pub loss: f64,
    /// Target count minus particles in the target container.
    pub indicator: i64,
    /// Particles in the target container.
    pub transported: u32,
    /// Particles in no container and not on the tool.
    pub spilled: u32,
    /// Particles on the tool at the end.
    pub on_tool: u32,
    /// Skill parameters that were evaluated.
    pub theta: Theta,
    /// What the update used as the gradient of the loss; none at the last epoch. In components that it does not
    /// change: the adjoint's value, 0 if no adjoint was computed.
    pub gradient: Option<Theta>,
    /// Wall time of all the epoch's evaluations, seconds.
    pub seconds: f64,
    /// The adjoint, where it was computed.
    pub adjoint: [Option<f64>; 5],
    /// Central differences of the loss, where they were computed.
    pub differences: [Option<f64>; 5],
    /// Weight of the adjoint in the gradient, 0 to 1, in the components that the update changes.
    pub first_order_weight: [Option<f64>; 5],
}

impl EpochRecord {
    fn is_sound(&self, epoch: u32) -> bool {
        let timed = (0.0..=f64::MAX).contains(&self.seconds);
        self.epoch == epoch && is_loss(self.loss) && check_theta(&self.theta).is_ok() && timed
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
}

impl From<&scene::Optimiser> for Method {
    fn from(settings: &scene::Optimiser) -> Self {
        Self { rule: settings.into(), estimator: settings.into() }
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
}

impl Search {
    /// A search of `epochs` updates from `theta`.
    pub fn new(theta: Theta, epochs: u32) -> Self {
        Self {
            epochs,
            state: RmsPropState::new(theta),
            estimates: EstimatorState::default(),
            history: Vec::new(),
        }
    }

    /// Whether epochs can have led here, so that more of them can follow. Numbers that are only written down or added up may
    /// be anything.
    pub fn is_sound(&self) -> bool {
        let updates = self.state.updates;
        // The last epoch is evaluated without an update.
        let evaluated = self.history.len() - usize::from(self.is_done());
        updates <= self.epochs
            && evaluated == updates as usize
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

    /// The points whose losses are needed besides, now that the evaluation of [`Search::next`] gave `adjoint`.
    pub fn probes(&self, method: &Method, adjoint: Option<&Theta>) -> Vec<Probe> {
        if self.is_last() {
            return Vec::new();
        }
        method.estimator.probes(&self.estimates, &self.place(&method.rule), adjoint)
    }

    /// Takes the answers to [`Search::next`] and [`Search::probes`], and updates theta unless this was the last
    /// epoch.
    ///
    /// # Errors
    /// Loss or gradient not finite, or one of them missing; the search is then unchanged.
    pub fn record(
        &mut self,
        method: &Method,
        evaluation: &Evaluation,
        probes: &[f64],
        seconds: f64,
    ) -> Result<&EpochRecord, SearchError> {
        let RmsPropState { theta, updates: epoch, .. } = self.state;
        if !is_loss(evaluation.loss) {
            return Err(SearchError::Loss { epoch, loss: evaluation.loss });
        }
        let (estimate, gradient) = if self.is_last() {
            (Estimate::default(), None)
        } else {
            let estimate = self.update(method, evaluation, probes)?;
            (estimate, Some(estimate.gradient))
        };
        let record = EpochRecord {
            epoch,
            loss: evaluation.loss,
            indicator: evaluation.indicator,
            transported: evaluation.transported,
            spilled: evaluation.spilled,
            on_tool: evaluation.on_tool,
            theta,
            gradient,
            seconds,
            adjoint: estimate.adjoint,
            differences: estimate.differences,
            first_order_weight: estimate.first_order_weight,
        };
        Ok(self.history.push_mut(record))
    }

    /// Estimates the gradient and goes a step.
    fn update(
        &mut self,
        method: &Method,
        evaluation: &Evaluation,
        probes: &[f64],
    ) -> Result<Estimate, SearchError> {
        let place = self.place(&method.rule);
        let epoch = place.epoch;
        let wanted = method.estimator.wants_adjoint(&self.estimates, &place);
        let adjoint = evaluation.gradient.filter(|_| wanted);
        if wanted && adjoint.is_none() {
            return Err(SearchError::Missing { epoch, missing: "the gradient" });
        }
        if probes.len() != self.probes(method, adjoint.as_ref()).len() {
            return Err(SearchError::Missing { epoch, missing: "a probe" });
        }
        let found = Findings { loss: evaluation.loss, adjoint, probes };
        let (estimate, estimates) = method.estimator.combine(&self.estimates, &place, &found);
        self.state = method
            .rule
            .update(&self.state, &estimate.gradient, &estimate.noise)
            .map_err(|source| SearchError::Gradient { epoch, source })?;
        self.estimates = estimates;
        Ok(estimate)
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
        if self.is_done() && epochs > self.epochs {
            self.history.pop();
        }
        self.epochs = self.epochs.max(epochs);
    }

    /// Whether all epochs are evaluated.
    pub fn is_done(&self) -> bool {
        self.history.len() > self.epochs as usize
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
    };

    /// A bowl whose gradient is wrong in depth, so that the search has all kinds of epochs.
    fn bowl(theta: &Theta, gradient: bool) -> Evaluation {
        let loss: f64 = theta.iter().map(|x| (x - 0.3) * (x - 0.3)).sum();
        let mut slope = theta.map(|x| 2.0 * (x - 0.3));
        slope[0] += 1e3 * libm::sin(1e6 * theta[0]);
        Evaluation {
            loss,
            indicator: 5,
            transported: 1,
            spilled: 0,
            on_tool: 0,
            gradient: gradient.then_some(slope),
        }
    }

    fn probed(search: &Search, method: &Method, evaluation: &Evaluation) -> Vec<f64> {
        let probes = search.probes(method, evaluation.gradient.as_ref());
        probes.iter().map(|probe| bowl(&probe.theta, false).loss).collect()
    }

    fn advance_by(search: &mut Search, method: &Method, epochs: usize) {
        for _ in 0..epochs {
            let request = search.next(method).unwrap();
            let evaluation = bowl(&request.theta, request.want_gradient);
            let losses = probed(search, method, &evaluation);
            search.record(method, &evaluation, &losses, 0.0).unwrap();
            assert!(search.is_sound());
        }
    }

    fn advance(search: &mut Search, epochs: usize) {
        advance_by(search, &METHOD, epochs);
    }

    #[test]
    fn evaluates_one_more_epoch_than_it_updates() {
        let mut search = Search::new([-0.5; 5], 10);
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
        let mut whole = Search::new([-0.5, 0.9, 0.123, -0.7, 0.1], 10);
        advance(&mut whole, 11);
        for interruption in 0..=10 {
            let mut search = Search::new([-0.5, 0.9, 0.123, -0.7, 0.1], 10);
            advance(&mut search, interruption);
            let mut loaded: Search = postcard::from_bytes(&postcard::to_allocvec(&search).unwrap()).unwrap();
            advance(&mut loaded, 11 - interruption);
            assert_eq!(postcard::to_allocvec(&loaded).unwrap(), postcard::to_allocvec(&whole).unwrap());
        }
    }

    #[test]
    fn extended_search_has_the_bits_of_a_longer_one() {
        let mut long = Search::new([-0.5; 5], 10);
        advance(&mut long, 11);
        let mut short = Search::new([-0.5; 5], 6);
        advance(&mut short, 7);
        short.extend(10);
        assert_eq!(short.next(&METHOD).map(|request| request.epoch), Some(6));
        advance(&mut short, 5);
        assert_eq!(short, long);
    }

    #[test]
    fn what_is_not_finite_leaves_the_search_unchanged() {
        let mut search = Search::new([-0.5; 5], 10);
        let before = search.clone();
        let sound = bowl(&[-0.5; 5], true);
        let losses = probed(&search, &METHOD, &sound);
        for broken in [
            Evaluation { loss: f64::NAN, ..sound },
            Evaluation { loss: f64::MAX, ..sound },
            Evaluation { loss: -1.0, ..sound },
            Evaluation { gradient: Some([f64::INFINITY; 5]), ..sound },
            Evaluation { gradient: None, ..sound },
        ] {
            assert!(search.record(&METHOD, &broken, &losses, 0.0).is_err());
            assert_eq!(search, before);
        }
        for broken in [vec![], vec![f64::NAN; losses.len()], [&losses[..], &[1.0]].concat()] {
            assert!(search.record(&METHOD, &sound, &broken, 0.0).is_err());
            assert_eq!(search, before);
        }
    }

    #[test]
    fn what_no_epochs_lead_to_is_not_sound() {
        let mut sound = Search::new([-0.5; 5], 10);
        advance(&mut sound, 5);
        let defects: [fn(&mut Search); 15] = [
            |search| search.epochs = 4,
            |search| search.state.updates = 6,
            |search| search.state.updates = u32::MAX,
            |search| search.state.theta[4] = 1.001,
            |search| search.state.theta[0] = f64::NAN,
            |search| search.state.paces[0].mean_square = -1.0,
            |search| search.state.paces[0].mean_square = f64::INFINITY,
            |search| search.state.paces[0].rate = 1.001,
            |search| search.state.paces[0].slope = f64::NAN,
            |search| search.history.clear(),
            |search| search.history[1].epoch = u32::MAX,
            |search| search.history[1].loss = f64::MAX,
            |search| search.history[1].loss = f64::NAN,
            |search| search.history[1].theta[2] = -1.001,
            |search| search.history[1].seconds = f64::INFINITY,
        ];
        for (index, defect) in defects.into_iter().enumerate() {
            let mut search = sound.clone();
            defect(&mut search);
            assert!(!search.is_sound(), "{index}");
        }
    }

    #[test]
    fn adjoint_alone_needs_no_probes() {
        let estimator = Estimator { gradient: GradientEstimator::Adjoint, ..METHOD.estimator };
        let method = Method { estimator, ..METHOD };
        let mut search = Search::new([-0.5; 5], 10);
        assert_eq!(
            search.next(&method).map(|request| (request.want_gradient, request.probes)),
            Some((true, 0))
        );
        advance_by(&mut search, &method, 11);
        for record in &search.history()[..10] {
            let gradient = bowl(&record.theta, true).gradient;
            assert_eq!(record.gradient, gradient);
            assert_eq!((record.adjoint, record.differences), (gradient.unwrap().map(Some), [None; 5]));
        }
    }

    #[test]
    fn records_tell_where_the_gradient_comes_from() {
        let mut search = Search::new([-0.5; 5], 10);
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
