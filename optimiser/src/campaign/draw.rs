//! Numbers that are drawn.
//!
//! A number comes from seed, draw and key alone: more draws, other keys or other cases change none of those that were there.

use super::file::{Normal, Relative, Spread, Uniform};
use sha2::{Digest as _, Sha256};

/// The value of a key in one of the draws; `own` is what it is without.
pub(super) fn drawn(seed: u64, draw: u32, key: &str, spread: &Spread, own: f64) -> f64 {
    let [one, other] = uniforms(seed, draw, key);
    match *spread {
        Spread::Uniform(Uniform { low, high }) => low + one * (high - low),
        Spread::Relative(Relative { relative }) => own * (1.0 + relative * (2.0 * one - 1.0)),
        Spread::Normal(Normal { mean, deviation }) => {
            // Box and Muller's, by the libm that is the same everywhere; `one` may be 0.
            let length = libm::sqrt(-2.0 * libm::log(1.0 - one));
            mean + deviation * length * libm::cos(2.0 * std::f64::consts::PI * other)
        }
    }
}

/// Two numbers from 0 to below 1.
fn uniforms(seed: u64, draw: u32, key: &str) -> [f64; 2] {
    let digest = Sha256::new()
        .chain_update(seed.to_le_bytes())
        .chain_update(draw.to_le_bytes())
        .chain_update(key)
        .finalize();
    [0, 8].map(|at| {
        let eight = std::array::from_fn(|k| digest[at + k]);
        // As many bits as a number from 0 to 1 has in steps of one size.
        (u64::from_le_bytes(eight) >> 11) as f64 / (1u64 << 53) as f64
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(spread: &Spread) -> Vec<f64> {
        (0..10_000).map(|draw| drawn(7, draw, "friction_angle_deg", spread, 40.0)).collect()
    }

    fn mean_and_deviation(values: &[f64]) -> [f64; 2] {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        [mean, (squares / values.len() as f64).sqrt()]
    }

    #[test]
    fn draws_are_distributed_as_they_should_be() {
        let uniform = all(&Spread::Uniform(Uniform { low: 30.0, high: 42.0 }));
        assert!(uniform.iter().all(|value| (30.0..42.0).contains(value)));
        let [mean, deviation] = mean_and_deviation(&uniform);
        assert!(
            (mean - 36.0).abs() < 0.1 && (deviation - 12.0 / 12f64.sqrt()).abs() < 0.05,
            "{mean} {deviation}"
        );
        let [mean, deviation] =
            mean_and_deviation(&all(&Spread::Normal(Normal { mean: -3.0, deviation: 2.0 })));
        assert!((mean + 3.0).abs() < 0.06 && (deviation - 2.0).abs() < 0.05, "{mean} {deviation}");
        let relative = all(&Spread::Relative(Relative { relative: 0.1 }));
        assert!(relative.iter().all(|value| (36.0..44.0).contains(value)));
        assert!((mean_and_deviation(&relative)[0] - 40.0).abs() < 0.1);
    }

    #[test]
    fn a_draw_depends_on_seed_number_and_key_and_stays_what_it_is() {
        let spread = Spread::Uniform(Uniform { low: 0.0, high: 1.0 });
        let of = |seed, draw, key| drawn(seed, draw, key, &spread, 0.0).to_bits();
        let first = of(1, 0, "density_kg_m3");
        assert_eq!(first, of(1, 0, "density_kg_m3"));
        for other in [of(2, 0, "density_kg_m3"), of(1, 1, "density_kg_m3"), of(1, 0, "cohesion_pa")] {
            assert_ne!(first, other);
        }
        // Pinned: campaigns that were begun go on with the same numbers.
        let pinned = drawn(1, 0, "density_kg_m3", &Spread::Normal(Normal { mean: 0.0, deviation: 1.0 }), 0.0);
        assert!((pinned - 0.290_848_494_523_138).abs() < 1e-14, "{pinned:?}");
    }
}
