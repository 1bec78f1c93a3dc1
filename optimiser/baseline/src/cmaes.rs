//! CMA-ES: covariance matrix adaptation evolution strategy, by the crate `fcmaes-core`; here are its bounds and its batches.
//!
//! | symbol | here | source |
//! |---|---|---|
//! | n | `dimension` | |
//! | lambda = 4 + floor(3 ln n) | `population` | Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772, eq. 48 |
//! | sigma^(0) | [`FIRST_STEP`] | |
//! | m^(0) | `mean` in [`CmaEs::start`] | |

use crate::Search;
use crate::noise::Noise;
use fcmaes_core::{Cmaes, CmaesParams, Fitness};

/// Stream of the seed's generator that first means and the seeds of the inner generator are drawn from.
const START_STREAM: u64 = 0x7374_6172_7473;

/// First standard deviation along each axis: 0.3 of the interval's length of 2, as the tutorial advises (appendix A of
/// arXiv:1604.00772).
const FIRST_STEP: f64 = 0.6;

/// Covariance matrix adaptation with active update of the covariance (Jastrebski and Arnold 2006).
///
/// *Start.* The mean is drawn uniformly from [-1, 1]^n, as the other searches draw their first points.
///
/// *Bounds.* The strategy itself is unbounded. Each coordinate that leaves [-1, 1] is reflected at the bounds until it
/// lies within, and the loss there counts as the loss of the point that left: the strategy minimises the loss continued
/// evenly and periodically beyond the box. Nothing is clipped, so that no sample is wasted on the box's faces.
///
/// *Batches.* A generation is handed out in as many pieces as the caller likes. The strategy learns of it when all its
/// losses are known; those of an unfinished last generation it never learns.
///
/// *Restarts.* Where the strategy has converged to rounding or has degenerated, a new one starts with another mean.
/// This takes some thousand evaluations at least.
pub struct CmaEs {
    dimension: usize,
    noise: Noise,
    strategy: Cmaes,
    /// The generation in work, within bounds, in the strategy's order.
    generation: Vec<Vec<f64>>,
    /// Losses of the first points of `generation`.
    losses: Vec<f64>,
    /// Points handed out whose losses are awaited; they follow those whose losses are known.
    asked: usize,
}

impl CmaEs {
    /// A search over [-1, 1]^`dimension`, which is one at least, with the default population 4 + 3 ln n.
    pub fn new(dimension: usize, seed: u64) -> Self {
        assert!(dimension > 0, "a search needs a dimension");
        let mut noise = Noise::new(seed, START_STREAM);
        let strategy = Self::start(dimension, &mut noise);
        Self { dimension, noise, strategy, generation: Vec::new(), losses: Vec::new(), asked: 0 }
    }

    /// Points in a generation.
    pub fn population(&self) -> usize {
        self.strategy.popsize()
    }

    fn start(dimension: usize, noise: &mut Noise) -> Cmaes {
        let mean: Vec<f64> = (0..dimension).map(|_| noise.signed()).collect();
        // A population of 0 is the default of 4 + 3 ln n; empty bounds are none.
        let settings = CmaesParams { popsize: 0, seed: noise.bits(), ..CmaesParams::default() };
        Cmaes::new(Fitness::new(dimension, 1, Vec::new(), Vec::new()), &mean, &[FIRST_STEP], &settings)
    }

    /// Passes the finished generation on to the strategy, or to a new one if this one can do no more.
    fn finish_generation(&mut self) {
        if self.strategy.tell(&self.losses) != 0 {
            self.strategy = Self::start(self.dimension, &mut self.noise);
        }
        self.generation.clear();
        self.losses.clear();
    }
}

impl Search for CmaEs {
    /// What is left of the generation, or the first `most` points of it. Asking again before telling gives the same.
    fn ask(&mut self, most: usize) -> Vec<Vec<f64>> {
        if self.generation.is_empty() {
            self.generation = self.strategy.ask().into_iter().map(reflected).collect();
        }
        let left = &self.generation[self.losses.len()..];
        self.asked = left.len().min(most.max(1));
        left[..self.asked].to_vec()
    }

    /// A loss that is not finite counts as the worst.
    fn tell(&mut self, losses: &[f64]) {
        assert_eq!(losses.len(), self.asked, "one loss for each point asked for");
        self.asked = 0;
        self.losses.extend(losses);
        if self.losses.len() == self.generation.len() && !self.losses.is_empty() {
            self.finish_generation();
        }
    }
}

/// `point` with each coordinate reflected at -1 and 1 until it lies between.
fn reflected(mut point: Vec<f64>) -> Vec<f64> {
    for x in &mut point {
        // Inside the box a coordinate stays as it is, to the last bit.
        if x.abs() > 1.0 {
            *x = 1.0 - ((*x + 1.0).rem_euclid(4.0) - 2.0).abs();
        }
    }
    point
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reflection_is_even_at_both_bounds_and_has_period_four() {
        let cases =
            [(0.3, 0.3), (1.0, 1.0), (1.25, 0.75), (-1.25, -0.75), (3.0, -1.0), (4.5, 0.5), (-3.5, 0.5)];
        for (from, to) in cases {
            let found = reflected(vec![from])[0];
            assert!((found - to).abs() < 1e-15, "{from} went to {found}");
        }
    }
}
