//! Searches that see losses and nothing else, as searches like any other.

use super::{Epoch, Found, Search, SearchError, Step, Trial, check};
use powderline_simulator::rollout::Evaluation;

/// Trials that are asked for at a time, at most: what an interruption costs.
const BATCH: usize = 8;

/// Trials of an epoch: as many as a skill and five central differences take.
const TRIALS_PER_EPOCH: usize = 11;

/// One of [`powderline_baseline`]'s.
pub(super) struct BlackBox {
    search: Box<dyn powderline_baseline::Search>,
    /// Asked for last, and not told yet.
    asked: Vec<Trial>,
    /// Of the present epoch.
    told: usize,
    best: Option<(Trial, Evaluation)>,
}

impl BlackBox {
    pub(super) fn new(search: Box<dyn powderline_baseline::Search>) -> Self {
        Self { search, asked: Vec::new(), told: 0, best: None }
    }
}

impl Search for BlackBox {
    fn ask(&mut self, _: bool) -> Vec<Trial> {
        if self.asked.is_empty() {
            let left = TRIALS_PER_EPOCH - self.told;
            let trial = |point| Trial { may_fail: true, ..Trial::of(point) };
            self.asked = self.search.ask(left.min(BATCH)).into_iter().map(trial).collect();
        }
        self.asked.clone()
    }

    fn tell(&mut self, found: &[Found]) -> Result<Option<Epoch>, SearchError> {
        check(&self.asked, found)?;
        let losses: Vec<f64> = found.iter().map(|found| found.evaluation.loss).collect();
        self.search.tell(&losses);
        for (trial, found) in std::mem::take(&mut self.asked).into_iter().zip(found) {
            let evaluation = found.evaluation;
            if self.best.as_ref().is_none_or(|(_, best)| evaluation.loss < best.loss) {
                self.best = Some((trial, evaluation));
            }
        }
        self.told += found.len();
        if self.told < TRIALS_PER_EPOCH {
            return Ok(None);
        }
        self.told = 0;
        let best = self.best.take();
        Ok(best.map(|(trial, evaluation)| Epoch {
            trial,
            evaluation,
            has_peers: true,
            step: Step::Update,
            slopes: None,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_baseline::RandomSearch;
    use powderline_simulator::rollout::Census;

    #[test]
    fn an_epoch_is_so_many_trials_and_its_best_stands_for_it() {
        let mut search = BlackBox::new(Box::new(RandomSearch::new(5, 1)));
        for _ in 0..3 {
            let mut all = Vec::new();
            let epoch = loop {
                let trials = search.ask(false);
                assert_eq!(trials, search.ask(true), "the same until it is told");
                all.extend(trials.iter().map(|trial| trial.point[0]));
                let found = |trial: &Trial| Found {
                    evaluation: Evaluation::new(1.0 + trial.point[0], 0, Census::default()),
                    gradient: None,
                };
                let found: Vec<Found> = trials.iter().map(found).collect();
                assert!(search.tell(&found[1..]).is_err());
                if let Some(epoch) = search.tell(&found).unwrap() {
                    break epoch;
                }
            };
            assert_eq!(all.len(), 11);
            let lowest = all.into_iter().fold(f64::INFINITY, f64::min);
            assert_eq!(epoch.trial.point[0].to_bits(), lowest.to_bits());
        }
    }
}
