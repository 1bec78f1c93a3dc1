//! Random search.

use crate::Search;
use crate::noise::Noise;

/// Stream of the seed's generator that the points are drawn from.
const POINT_STREAM: u64 = 0x706f_696e_7473;

/// Independent points, uniform in [-1, 1]^n. Learns nothing from what it is told.
#[derive(Clone, Debug)]
pub struct RandomSearch {
    dimension: usize,
    noise: Noise,
}

impl RandomSearch {
    /// A search over [-1, 1]^`dimension`.
    pub fn new(dimension: usize, seed: u64) -> Self {
        Self { dimension, noise: Noise::new(seed, POINT_STREAM) }
    }
}

impl Search for RandomSearch {
    /// As many points as are wanted, one at least.
    fn ask(&mut self, most: usize) -> Vec<Vec<f64>> {
        let Self { dimension, noise } = self;
        (0..most.max(1)).map(|_| (0..*dimension).map(|_| noise.signed()).collect()).collect()
    }

    fn tell(&mut self, _losses: &[f64]) {}
}
