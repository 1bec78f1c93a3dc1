//! The search for a good motion. Every way to search asks and is told: [`Search::ask`] says which motions to simulate, [`Search::tell`] takes
//! what came of them.
//!
//! Nothing here simulates, reads a clock or touches a file. A search is a function of its [`Method`], its seed and what it was told, to
//! the last bit, so that whoever keeps that can make it again: that is how runs are resumed ([`crate::run`]).
//!
//! | [`Method`] | where it looks next |
//! |---|---|
//! | `surrogate` | where two Gaussian processes guess most: in a coarse copy of the scene first, then in the scene itself ([`surrogate`]) |
//! | `restarted`, `mixed`, `differences`, `exact` | down a gradient, by RMSprop as the paper does ([`descent`]) |
//! | `path` | a skill as `surrogate` does, then splines in time that are added to it, down the restarted adjoint |
//! | `cma-es`, `sac`, `random` | [`powderline_baseline`] |
//! | `path-cma-es` | as `path`, but by losses alone |
//!
//! ```
//! use powderline_optimiser::optim::{Found, Method, Problem};
//! use powderline_shared::plan::Precision;
//! use powderline_simulator::{rollout::{SimulatorSettings, boxed_simulator}, scene::Scene, skill::Theta};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let scene = Scene::load("bench-small")?;
//! let mut simulator = boxed_simulator(&scene, Precision::F32, &SimulatorSettings::default())?;
//! let mut search = Method::Random.search(&Problem::new(&scene, 1));
//! for _ in 0..1 {
//!     let trials = search.ask(false);
//!     # let trials = &trials[..1];
//!     let found = trials.iter().map(|trial| {
//!         let theta = Theta::new(trial.point.clone().try_into().expect("five parameters"))?;
//!         Ok(Found { evaluation: simulator.evaluate(&theta)?, gradient: None })
//!     });
//!     let found: Vec<Found> = found.collect::<Result<_, Box<dyn std::error::Error>>>()?;
//!     # let one = found[0].clone();
//!     # let found = vec![one; search.ask(false).len()];
//!     search.tell(&found)?;
//! }
//! # Ok(())
//! # }
//! ```

mod black_box;
mod coarse_to_fine;
pub mod descent;
mod gaussian_process;
mod method;
mod path;
mod record;
pub mod surrogate;

pub use method::{Method, Problem};
pub(crate) use record::are_sound;
pub use record::{EpochRecord, Work};

use powderline_simulator::{
    rollout::Evaluation,
    skill::{Splines, Theta},
};
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Losses are sums of distances, metres: more is not what comes of millions of particles within some metres, and too much
/// for an axis.
const MAX_LOSS_M: f64 = 1e12;

/// Stream of the seed's generator that theta is drawn from, so that other users of the seed are independent of it.
const THETA_STREAM: u64 = 0x0074_6865_7461;

/// A way to search, on its way.
pub trait Search {
    /// The trials to make next, at least one; the same until it is told of them. `is_last`: no epoch follows the one that these belong to.
    fn ask(&mut self, is_last: bool) -> Vec<Trial>;

    /// What came of them, in their order. The epoch that ends with them; none if more has to be asked before it ends.
    ///
    /// # Errors
    /// A number that nothing follows from. Nothing can be asked then.
    fn tell(&mut self, found: &[Found]) -> Result<Option<Epoch>, SearchError>;
}

/// A motion to simulate.
#[derive(Clone, Debug, PartialEq)]
pub struct Trial {
    /// Parameters of the skill, each from -1 to 1.
    pub point: Vec<f64>,
    /// What is added to the skill's motion, if anything is.
    pub splines: Option<Splines>,
    /// Where.
    pub world: World,
    /// Whether as it is shipped, rounded to whole counts.
    pub is_rounded: bool,
    /// Which adjoint is wanted besides.
    pub adjoint: Option<Adjoint>,
    /// Whether a motion that comes to no end, for powder left the simulated volume or a number was not finite, is an answer too: it costs
    /// more than powder at rest.
    pub may_fail: bool,
}

impl Trial {
    /// In the scene itself, not rounded and without a derivative, and not to fail.
    pub(crate) fn of(point: Vec<f64>) -> Self {
        Self { point, splines: None, world: World::Fine, is_rounded: false, adjoint: None, may_fail: false }
    }
}

/// Where motions are simulated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum World {
    /// In a coarse copy of the scene ([`powderline_simulator::scene::Scene::coarse`]).
    Coarse,
    /// In the scene itself.
    #[default]
    Fine,
}

/// A derivative of the loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Adjoint {
    /// Of the very numbers that the simulation computes.
    Exact,
    /// Over larger steps ([`powderline_simulator::rollout::restart`]).
    Restarted,
}

impl Adjoint {
    /// As tables have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Restarted => "restarted",
        }
    }
}

/// What came of a [`Trial`].
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// What the motion achieves, as of the scene's particles: what was found in a coarse world is put in these.
    pub evaluation: Evaluation,
    /// The derivative of the loss, metres, if it was wanted: by the trial's splines' coefficients where it has splines, by its skill's
    /// parameters where not. None of one that came to no end.
    pub gradient: Option<Vec<f64>>,
}

/// What followed an epoch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Step {
    /// Nothing: it was the last.
    #[default]
    None,
    /// Another one, from what is known.
    Update,
    /// No direction led anywhere: the next epoch begins from another draw.
    Restart,
}

/// A step of a search that is done: its best trial, by the loss, and what it knew of slopes.
#[derive(Clone, Debug, PartialEq)]
pub struct Epoch {
    /// Which of the trials that were told last or before stands for it.
    pub trial: Trial,
    /// What came of that.
    pub evaluation: Evaluation,
    /// Whether any of its trials could stand for it as well: which one does is then for those to say who know what is wanted.
    pub has_peers: bool,
    /// What followed.
    pub step: Step,
    /// Where the step went by a gradient.
    pub slopes: Option<Slopes>,
}

/// The gradient of a step, by component, metres per unit of theta, and where it comes from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Slopes {
    /// What the step used.
    pub gradient: Vec<f64>,
    /// The adjoint, where it was computed.
    pub adjoint: Vec<Option<f64>>,
    /// Central differences of the loss, where they were computed.
    pub differences: Vec<Option<f64>>,
    /// Weight of the adjoint in the gradient, 0 to 1.
    pub first_order_weight: Vec<f64>,
    /// Half-step of the differences; none where there are none.
    pub half_step: Option<f64>,
}

/// A number that a search cannot go on from.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SearchError {
    /// The loss is no sum of distances: NaN, negative or without bound.
    #[error("the loss is {loss}")]
    Loss {
        /// Loss.
        loss: f64,
    },
    /// A component of the gradient is NaN or infinite.
    #[error("the gradient with respect to the {parameter} is {value}")]
    Gradient {
        /// Which component.
        parameter: String,
        /// Its value.
        value: f64,
    },
    /// What was asked for is not what was told.
    #[error(
        "{asked} trials were asked for, and {told} were told of, or one without the gradient that was wanted"
    )]
    Missing {
        /// Trials asked for.
        asked: usize,
        /// Trials told of.
        told: usize,
    },
}

/// Whether these are answers to these trials that something follows from.
pub(crate) fn check(asked: &[Trial], told: &[Found]) -> Result<(), SearchError> {
    let answers = |(trial, found): (&Trial, &Found)| match (&trial.adjoint, &found.gradient) {
        (Some(_), Some(gradient)) => {
            gradient.len()
                == trial.splines.as_ref().map_or(trial.point.len(), |added| added.coefficients.len())
        }
        // Of one that came to no end there is none.
        (wanted, _) => wanted.is_none() || trial.may_fail,
    };
    if asked.len() != told.len() || !asked.iter().zip(told).all(answers) {
        return Err(SearchError::Missing { asked: asked.len(), told: told.len() });
    }
    let wrong = told.iter().map(|found| found.evaluation.loss).find(|loss| !is_loss(*loss));
    wrong.map_or(Ok(()), |loss| Err(SearchError::Loss { loss }))
}

pub(crate) fn is_loss(loss: f64) -> bool {
    (0.0..=MAX_LOSS_M).contains(&loss)
}

/// Draws the first theta uniformly from `ranges`, `[low, high]` for each component.
pub fn initial_theta(ranges: &[[f64; 2]; 5], seed: u64) -> Theta {
    drawn_theta(ranges, seed, 0)
}

/// The theta that is drawn after `before` others.
fn drawn_theta(ranges: &[[f64; 2]; 5], seed: u64, before: u32) -> Theta {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(THETA_STREAM);
    // Two words of 32 bits for each component.
    rng.set_word_pos(10 * u128::from(before));
    Theta::clamped(ranges.map(|[low, high]| (low + unit(&mut rng) * (high - low)).clamp(low, high)))
}

/// A number from 0 to below 1.
fn unit(rng: &mut ChaCha8Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 * f64::EPSILON / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    const RANGES: [[f64; 2]; 5] = [[-1.0, 1.0], [-0.5, 0.5], [0.25, 0.25], [0.0, 1.0], [-1.0, -0.5]];

    #[test]
    fn initial_theta_lies_in_its_ranges_and_depends_on_the_seed_only() {
        for seed in 0..100 {
            let theta = initial_theta(&RANGES, seed).components();
            assert!(theta.iter().zip(RANGES).all(|(value, [low, high])| (low..=high).contains(value)));
            assert_eq!(theta.map(f64::to_bits), initial_theta(&RANGES, seed).components().map(f64::to_bits));
            assert_ne!(
                theta.map(f64::to_bits),
                initial_theta(&RANGES, seed + 1).components().map(f64::to_bits)
            );
        }
    }

    #[test]
    fn draws_follow_one_another() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        rng.set_stream(THETA_STREAM);
        for before in 0..20 {
            let whole = [[0.0, 1.0]; 5].map(|_| unit(&mut rng));
            let drawn = drawn_theta(&[[0.0, 1.0]; 5], 7, before).components();
            assert_eq!(drawn.map(f64::to_bits), whole.map(f64::to_bits), "{before}");
        }
    }

    #[test]
    fn initial_theta_covers_its_range() {
        let first = |seed: u64| initial_theta(&RANGES, seed).components()[0];
        let mean: f64 = (0..1000).map(first).sum::<f64>() / 1000.0;
        let square: f64 = (0..1000).map(|seed| first(seed).powi(2)).sum::<f64>() / 1000.0;
        assert!(mean.abs() < 0.06 && (square - 1.0 / 3.0).abs() < 0.03, "{mean} {square}");
    }
}
