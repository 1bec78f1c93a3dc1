//! The search for good skill parameters: curriculum RMSprop, as a state that is passed in and handed back.
//!
//! Nothing here simulates, reads a clock or touches a file. [`Search::next`] says what to evaluate, [`Search::probes`]
//! what else the answer makes necessary, [`Search::record`] takes the answers; a search that was saved and loaded again goes on with the same bits.

mod estimate;
mod rmsprop;
mod search;
pub mod steps;

pub use estimate::{
    Estimate, Estimator, EstimatorState, Findings, Place, Probe, REMEASURE_EPOCHS, TRUSTED_WEIGHT,
    USELESS_WEIGHT,
};
pub use rmsprop::{GradientError, Pace, RmsProp, RmsPropState};
pub(crate) use search::is_loss;
pub use search::{
    Answer, EpochRecord, Method, Request, Restarts, Search, SearchError, Step, WIDEST_HALF_STEP,
};

use powderline_simulator::skill::Theta;
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};

/// Stream of the seed's generator that theta is drawn from, so that other users of the seed are independent of it.
const THETA_STREAM: u64 = 0x0074_6865_7461;

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
    Theta::clamped(ranges.map(|[low, high]| {
        let unit = (rng.next_u64() >> 11) as f64 * f64::EPSILON / 2.0;
        (low + unit * (high - low)).clamp(low, high)
    }))
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
            let whole = [[0.0, 1.0]; 5].map(|_| (rng.next_u64() >> 11) as f64 * f64::EPSILON / 2.0);
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
