//! The paper's experiment: searches side by side, each with the same number of rollouts.
//!
//! Nothing here simulates or touches a file: [`Track`] holds what a search evaluated, [`Comparison`] judges tracks.
//!
//! A *rollout* is one simulated motion. An epoch of the gradient's search takes one for its skill, one for each probe of a
//! central difference, and [`ADJOINT_ROLLOUTS`] for an adjoint; an epoch of the others is as many rollouts as the
//! comparison grants them, each of a skill of its own. What a search has achieved by an epoch is the skill with the lowest
//! loss that it has evaluated so far: what one would send to the arm if it ended there, and the tool met no container.
//!
//! [`Method::GradientSteps`] is apart: its motions are no skill's, an epoch of it is a motion and its adjoint, and of the
//! arm's limits they keep the workspace and, along each axis, the speed.

pub mod figure;
mod method;
pub mod steps;
mod summary;

pub use method::Method;
pub use summary::{Row, summarise};

use crate::{optim::EpochRecord, report::amounts::Amounts};
use powderline_simulator::{
    rollout::{Census, Evaluation},
    skill::Theta,
};
use serde::{Deserialize, Serialize};

/// What an adjoint, exact or restarted, takes beside the rollout that it is the adjoint of: in rollouts, by processor time, as
/// `optimise gradcheck bench-small --skills 20` measures the exact one (7.0, the rollout included). The restarted one has come down to 4.6
/// and still counts as much.
pub const ADJOINT_ROLLOUTS: u32 = 6;

/// One evaluated motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Try {
    /// The skill; none where the motion is not that of a skill.
    pub theta: Option<Theta>,
    /// Loss, metres.
    pub loss: f64,
    /// Wanted particles that did not arrive; negative if more did.
    pub indicator: i64,
    /// Particles by where they were at the end.
    pub census: Census,
    /// Rollouts that the search has taken with this one.
    pub rollouts: u32,
    /// Seconds of simulation that it has taken with this one.
    pub seconds: f64,
}

impl Try {
    /// A try after another; `rollouts` and `seconds` are its own.
    pub fn after(
        last: Option<&Self>,
        theta: Option<Theta>,
        found: &Evaluation,
        rollouts: u32,
        seconds: f64,
    ) -> Self {
        let (before, spent) = last.map_or((0, 0.0), |last| (last.rollouts, last.seconds));
        Self {
            theta,
            loss: found.loss,
            indicator: found.indicator,
            census: found.census,
            rollouts: before.saturating_add(rollouts),
            seconds: spent + seconds,
        }
    }

    /// What was found.
    pub fn evaluation(&self) -> Evaluation {
        let Self { loss, indicator, census, .. } = *self;
        Evaluation::new(loss, indicator, census)
    }
}

/// What one search evaluated, from one seed.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// The search.
    pub method: Method,
    /// Seed of packing and search.
    pub seed: u64,
    /// In the order of evaluation.
    pub tries: Vec<Try>,
}

impl Track {
    /// The epochs of a search along the gradient.
    pub fn of_epochs(method: Method, seed: u64, history: &[EpochRecord]) -> Self {
        let mut tries: Vec<Try> = Vec::with_capacity(history.len());
        for record in history {
            let EpochRecord { theta, loss, indicator, census, seconds, .. } = *record;
            let found = Evaluation::new(loss, indicator, census);
            tries.push(Try::after(tries.last(), Some(theta), &found, rollouts(record), seconds));
        }
        Self { method, seed, tries }
    }
}

/// Rollouts that an epoch of the gradient's search took.
fn rollouts(record: &EpochRecord) -> u32 {
    let adjoint = if record.adjoint.iter().any(Option::is_some) { ADJOINT_ROLLOUTS } else { 0 };
    1 + adjoint + record.probes
}

/// How many rollouts there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Budget {
    /// Updates along the gradient; epoch 0 comes before the first.
    pub epochs: u32,
    /// Rollouts of an epoch of searches without gradients.
    pub rollouts_per_epoch: u32,
    /// How many times that many they have in the second curve of each.
    pub factor: u32,
}

impl Budget {
    /// Skills that a search without gradients evaluates in all.
    pub fn tries(&self) -> u32 {
        (self.epochs + 1) * self.rollouts_per_epoch * self.factor
    }
}

/// A curve of the figure: a method, with its budget or a multiple of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Curve {
    /// The method.
    pub method: Method,
    /// Times the budget.
    pub factor: u32,
}

impl Curve {
    /// As the legend says it.
    pub fn name(&self) -> String {
        match self.factor {
            1 => self.method.name().into(),
            factor => format!("{}, {factor} times the rollouts", self.method.name()),
        }
    }
}

/// All tracks, and what they are measured by.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// The scene's name.
    pub scene: String,
    /// What is wanted, and what particles weigh.
    pub amounts: Amounts,
    /// Rollouts.
    pub budget: Budget,
    /// The tracks.
    pub tracks: Vec<Track>,
}

impl Comparison {
    /// The curves, in the order of the methods.
    pub fn curves(&self) -> Vec<Curve> {
        let mut curves: Vec<Curve> = Vec::new();
        for track in &self.tracks {
            let multiple =
                (!track.method.is_gradient() && self.budget.factor > 1).then_some(self.budget.factor);
            for factor in [Some(1), multiple].into_iter().flatten() {
                let curve = Curve { method: track.method, factor };
                if !curves.contains(&curve) {
                    curves.push(curve);
                }
            }
        }
        curves
    }

    /// Tracks of a curve, one for each seed.
    pub fn tracks_of(&self, curve: Curve) -> impl Iterator<Item = &Track> {
        self.tracks.iter().filter(move |track| track.method == curve.method)
    }

    /// How many tries a curve has made by the end of an epoch.
    fn tries_by(&self, curve: Curve, epoch: u32) -> usize {
        let per_epoch =
            if curve.method.is_gradient() { 1 } else { self.budget.rollouts_per_epoch * curve.factor };
        ((epoch + 1) * per_epoch) as usize
    }

    /// The best try of a track by the end of an epoch; none if it has not got there.
    pub fn best(&self, curve: Curve, track: &Track, epoch: u32) -> Option<Try> {
        let tries = track.tries.get(..self.tries_by(curve, epoch))?;
        tries.iter().min_by(|a, b| a.loss.total_cmp(&b.loss)).copied()
    }

    /// The last epoch that every track of a curve has got to; none if one has not made any.
    pub fn last_epoch(&self, curve: Curve) -> Option<u32> {
        let reached = |epoch: &u32| {
            self.tracks_of(curve).all(|track| track.tries.len() >= self.tries_by(curve, *epoch))
        };
        (0..=self.budget.epochs).take_while(reached).last()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_simulator::scene::Scene;

    pub(super) fn at(loss: f64) -> Evaluation {
        let census = Census { target: (100.0 - loss) as u32, ..Census::default() };
        Evaluation::new(loss, 100 - i64::from(census.target), census)
    }

    pub(super) fn track(method: Method, seed: u64, losses: &[f64]) -> Track {
        let mut tries: Vec<Try> = Vec::new();
        for loss in losses {
            tries.push(Try::after(tries.last(), Some(Theta::MIDDLE), &at(*loss), 1, 2.0));
        }
        Track { method, seed, tries }
    }

    pub(super) fn comparison() -> Comparison {
        Comparison {
            scene: "bench".into(),
            amounts: (&Scene::load("bench").unwrap()).into(),
            budget: Budget { epochs: 2, rollouts_per_epoch: 2, factor: 2 },
            tracks: vec![
                track(Method::Gradient, 1, &[50.0, 40.0, 45.0]),
                track(Method::Gradient, 2, &[60.0, 40.0, 30.0]),
                track(Method::Random, 1, &(0..12).map(|i| 90.0 - f64::from(i)).collect::<Vec<_>>()),
                track(Method::Random, 2, &[70.0; 12]),
            ],
        }
    }

    #[test]
    fn the_best_so_far_counts() {
        let comparison = comparison();
        let losses = |curve: Curve, index: usize| -> Vec<Option<f64>> {
            let track = comparison.tracks_of(curve).nth(index).unwrap();
            (0..4).map(|epoch| comparison.best(curve, track, epoch).map(|best| best.loss)).collect()
        };
        let gradient = Curve { method: Method::Gradient, factor: 1 };
        assert_eq!(losses(gradient, 0), [Some(50.0), Some(40.0), Some(40.0), None]);
        let random = Curve { method: Method::Random, factor: 1 };
        assert_eq!(losses(random, 0), [Some(89.0), Some(87.0), Some(85.0), Some(83.0)]);
        let more = Curve { method: Method::Random, factor: 2 };
        assert_eq!(losses(more, 0), [Some(87.0), Some(83.0), Some(79.0), None]);
        assert_eq!(comparison.curves(), [gradient, random, more]);
        assert_eq!(comparison.last_epoch(more), Some(2));
    }

    #[test]
    fn tries_are_read_with_a_skill_and_without() {
        let saved = r#"{"theta":[0.1,0.2,0.3,0.4,0.5],"loss":2.5,"indicator":5,
            "census":{"source":0,"target":1,"rims":0,"tool":2,"spilled":0,"in_flight":0},
            "rollouts":11,"seconds":3.5}"#;
        let read: Try = serde_json::from_str(saved).unwrap();
        assert_eq!((read.theta, read.rollouts), (Theta::new([0.1, 0.2, 0.3, 0.4, 0.5]).ok(), 11));
        let without = Try { theta: None, ..read };
        let text = serde_json::to_string(&without).unwrap();
        assert_eq!(serde_json::from_str::<Try>(&text).unwrap(), without);
    }

    #[test]
    fn an_epoch_of_the_gradient_costs_what_it_computes() {
        let record = EpochRecord { probes: 4, ..EpochRecord::default() };
        assert_eq!(rollouts(&record), 5);
        assert_eq!(rollouts(&EpochRecord { adjoint: [Some(1.0); 5], ..record }), 5 + ADJOINT_ROLLOUTS);
        assert_eq!(rollouts(&EpochRecord::default()), 1);
    }
}
