//! A run of epochs: epoch e evaluates theta_e, records it, then updates; N epochs are N updates and N + 1
//! evaluations, the last of them without gradient, since nothing follows it.

use super::{GradientError, RmsProp, RmsPropState};
use crate::{rollout::Evaluation, skill::Theta};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// One evaluated epoch; one line of `metrics.jsonl`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpochRecord {
    /// Updates made before this evaluation.
    pub epoch: u32,
    /// Loss, metres.
    pub loss: f64,
    /// Target count minus particles in the target container.
    pub indicator: i64,
    /// Particles in the target container.
    pub transported: u32,
    /// Particles in no container.
    pub spilled: u32,
    /// Skill parameters that were evaluated.
    pub theta: Theta,
    /// Gradient of the loss; none at the last epoch.
    pub gradient: Option<Theta>,
    /// Wall time of the evaluation, seconds.
    pub seconds: f64,
}

/// What to evaluate next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Request {
    /// Epoch.
    pub epoch: u32,
    /// Skill parameters.
    pub theta: Theta,
    /// Whether the gradient is needed.
    pub want_gradient: bool,
}

/// An evaluation that the search cannot go on from.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum SearchError {
    /// The loss is NaN or infinite.
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
    /// A gradient was asked for and not delivered.
    #[error("the evaluation of epoch {epoch} came back without the gradient that was asked for")]
    NoGradient {
        /// Epoch.
        epoch: u32,
    },
}

/// A search in progress. Serialises bit for bit (in a binary format, or one that keeps every digit).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Search {
    epochs: u32,
    state: RmsPropState,
    history: Vec<EpochRecord>,
}

impl Search {
    /// A search of `epochs` updates from `theta`.
    pub fn new(theta: Theta, epochs: u32) -> Self {
        Self { epochs, state: RmsPropState::new(theta), history: Vec::new() }
    }

    /// What to evaluate next; nothing when the search is done.
    pub fn next(&self) -> Option<Request> {
        (!self.is_done()).then_some(Request {
            epoch: self.state.updates,
            theta: self.state.theta,
            want_gradient: self.state.updates < self.epochs,
        })
    }

    /// Takes the answer to [`Search::next`], and updates theta unless this was the last epoch.
    ///
    /// # Errors
    /// Loss or gradient not finite, or a gradient missing; the search is then unchanged.
    pub fn record(
        &mut self,
        rule: &RmsProp,
        evaluation: &Evaluation,
        seconds: f64,
    ) -> Result<&EpochRecord, SearchError> {
        let epoch = self.state.updates;
        let last = epoch >= self.epochs;
        if !evaluation.loss.is_finite() {
            return Err(SearchError::Loss { epoch, loss: evaluation.loss });
        }
        let gradient = if last { None } else { evaluation.gradient };
        let next = match gradient {
            Some(gradient) => rule
                .update(&self.state, &gradient)
                .map_err(|source| SearchError::Gradient { epoch, source })?,
            None if last => self.state,
            None => return Err(SearchError::NoGradient { epoch }),
        };
        let record = EpochRecord {
            epoch,
            loss: evaluation.loss,
            indicator: evaluation.indicator,
            transported: evaluation.transported,
            spilled: evaluation.spilled,
            theta: self.state.theta,
            gradient,
            seconds,
        };
        self.state = next;
        Ok(self.history.push_mut(record))
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

    /// The epoch of the lowest loss, the earliest of equals.
    pub fn best(&self) -> Option<&EpochRecord> {
        self.history.iter().min_by(|a, b| a.loss.total_cmp(&b.loss))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULE: RmsProp = RmsProp { beta: 0.9, learning_rate: 0.05, epsilon: 1e-8, curriculum_epochs: 4 };

    fn bowl(theta: &Theta, gradient: bool) -> Evaluation {
        let loss: f64 = theta.iter().map(|x| (x - 0.3) * (x - 0.3)).sum();
        let gradient = gradient.then(|| theta.map(|x| 2.0 * (x - 0.3)));
        Evaluation { loss, indicator: 5, transported: 1, spilled: 0, gradient }
    }

    fn advance(search: &mut Search, epochs: usize) {
        for _ in 0..epochs {
            let request = search.next().unwrap();
            search.record(&RULE, &bowl(&request.theta, request.want_gradient), 0.0).unwrap();
        }
    }

    #[test]
    fn evaluates_one_more_epoch_than_it_updates() {
        let mut search = Search::new([-0.5; 5], 10);
        advance(&mut search, 11);
        assert!(search.is_done() && search.next().is_none());
        assert_eq!(
            search.history().iter().map(|record| record.epoch).collect::<Vec<_>>(),
            (0..=10).collect::<Vec<_>>()
        );
        assert!(search.history()[..10].iter().all(|record| record.gradient.is_some()));
        assert!(search.history()[10].gradient.is_none());
    }

    #[test]
    fn best_is_the_earliest_lowest_loss() {
        let mut search = Search::new([0.3; 5], 3);
        advance(&mut search, 4);
        assert_eq!(search.best().unwrap().epoch, 0);
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
        assert_eq!(short.next().map(|request| request.epoch), Some(6));
        advance(&mut short, 5);
        assert_eq!(short, long);
    }

    #[test]
    fn what_is_not_finite_leaves_the_search_unchanged() {
        let mut search = Search::new([-0.5; 5], 10);
        let before = search.clone();
        let sound = bowl(&[0.0; 5], true);
        for broken in [
            Evaluation { loss: f64::NAN, ..sound },
            Evaluation { gradient: Some([f64::INFINITY; 5]), ..sound },
            Evaluation { gradient: None, ..sound },
        ] {
            assert!(search.record(&RULE, &broken, 0.0).is_err());
            assert_eq!(search, before);
        }
    }
}
