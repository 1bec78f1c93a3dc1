//! The squashed Gaussian policy: a = tanh(u), u normal.
//!
//! | symbol | here | source |
//! |---|---|---|
//! | f_phi(epsilon; s) | [`sample`] | Haarnoja et al. 2018, arXiv:1812.05905, eq. 8 |
//! | epsilon | `noise` | ibid. |
//! | u = mu + sigma epsilon | `unsquashed` | ibid., appendix C |
//! | log pi(a given s) | [`log_probability`] | ibid., appendix C |

use burn_tensor::Tensor;
use burn_tensor::backend::Backend;
use std::f64::consts::{LN_2, TAU};

/// Bounds of the logarithm of the standard deviation, as in the authors' implementation.
const LOG_DEVIATION: [f64; 2] = [-20.0, 2.0];

/// Normal distributions before squashing: rows by actions.
pub(crate) struct Gaussian<B: Backend> {
    pub(crate) mean: Tensor<B, 2>,
    pub(crate) log_deviation: Tensor<B, 2>,
}

impl<B: Backend> Gaussian<B> {
    /// From the outputs of the policy's network: all means, then all logarithms of deviations.
    pub(crate) fn from_outputs(outputs: Tensor<B, 2>) -> Self {
        let actions = outputs.dims()[1] / 2;
        let [low, high] = LOG_DEVIATION;
        Self {
            mean: outputs.clone().narrow(1, 0, actions),
            log_deviation: outputs.narrow(1, actions, actions).clamp(low, high),
        }
    }

    /// Actions in (-1, 1) from standard normal `noise`, and the logarithm of their probability densities, rows by 1.
    pub(crate) fn sample(self, noise: Tensor<B, 2>) -> (Tensor<B, 2>, Tensor<B, 2>) {
        let unsquashed = self.mean + self.log_deviation.clone().exp() * noise.clone();
        let log_probability = log_probability(noise, self.log_deviation, unsquashed.clone());
        (unsquashed.tanh(), log_probability)
    }
}

/// Log density of tanh(u): the normal density of u, over the slope of tanh there.
///
/// Summed over the actions, log N(u; mu, sigma) - log(1 - tanh(u)^2). The last term is 2 (log 2 - u - softplus(-2 u)),
/// which does not round to log 0 where tanh(u) rounds to 1.
fn log_probability<B: Backend>(
    noise: Tensor<B, 2>,
    log_deviation: Tensor<B, 2>,
    unsquashed: Tensor<B, 2>,
) -> Tensor<B, 2> {
    let normal = noise.square() * -0.5 - log_deviation - 0.5 * TAU.ln();
    let log_slope = (-unsquashed.clone() + LN_2 - softplus(unsquashed * -2.0)) * 2.0;
    (normal - log_slope).sum_dim(1)
}

/// log(1 + exp(x)) that does not overflow.
fn softplus<B: Backend>(x: Tensor<B, 2>) -> Tensor<B, 2> {
    x.clone().abs().neg().exp().log1p() + x.clamp_min(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn_ndarray::{NdArray, NdArrayDevice};
    use burn_tensor::{DType, TensorData};

    type Exact = NdArray<f64>;

    fn exact(numbers: Vec<f64>, shape: [usize; 2]) -> Tensor<Exact, 2> {
        Tensor::from_data(TensorData::new(numbers, shape), (&NdArrayDevice::Cpu, DType::F64))
    }

    /// Log density of the one action tanh(`unsquashed`) under a Gaussian.
    fn log_density(unsquashed: f64, mean: f64, deviation: f64) -> f64 {
        let one = |x| exact(vec![x], [1, 1]);
        let noise = (unsquashed - mean) / deviation;
        log_probability(one(noise), one(deviation.ln()), one(unsquashed)).into_scalar()
    }

    #[test]
    fn densities_integrate_to_one() {
        for (mean, deviation) in [(0.0, 1.0), (0.7, 0.3), (-1.5, 0.8), (0.2, 2.0)] {
            let cells = 20_000;
            let density = |cell: i32| {
                let action = 2.0 * (f64::from(cell) + 0.5) / f64::from(cells) - 1.0;
                log_density(action.atanh(), mean, deviation).exp()
            };
            let integral: f64 = (0..cells).map(density).sum::<f64>() * 2.0 / f64::from(cells);
            assert!((integral - 1.0).abs() < 2e-3, "mean {mean}, deviation {deviation}: {integral}");
        }
    }

    #[test]
    fn density_is_the_textbook_one() {
        for (u, mean, deviation) in [(0.3_f64, 0.1, 0.5), (-2.0, -1.0, 1.5), (4.0, 0.0, 2.0)] {
            let noise = (u - mean) / deviation;
            let normal = (-0.5 * noise * noise).exp() / (deviation * TAU.sqrt());
            let textbook = (normal / (1.0 - u.tanh().powi(2))).ln();
            assert!((log_density(u, mean, deviation) - textbook).abs() < 1e-10);
        }
    }

    #[test]
    fn density_stays_finite_where_tanh_rounds_to_one() {
        // log N(u; 0, 10) + 2 u - 2 log 2, to within exp(-2 |u|).
        for u in [-400.0_f64, 400.0] {
            let expected =
                -0.5 * (u / 10.0).powi(2) - 10_f64.ln() - 0.5 * TAU.ln() + 2.0 * u.abs() - 2.0 * LN_2;
            assert!((log_density(u, 0.0, 10.0) - expected).abs() < 1e-9);
        }
    }

    #[test]
    fn samples_are_the_squashed_gaussians_and_actions_multiply() {
        let outputs = exact(vec![0.5, -0.2, 0.0, 99.0], [1, 4]);
        let (actions, log_probability) =
            Gaussian::from_outputs(outputs).sample(exact(vec![1.0, -0.5], [1, 2]));
        let u = [0.5 + 1.0, -0.2 - 0.5 * 2_f64.exp()];
        let actions: Vec<f64> = actions.into_data().into_vec().unwrap();
        assert!(actions.iter().zip(u).all(|(a, u)| (a - u.tanh()).abs() < 1e-12), "{actions:?}");
        let expected = log_density(u[0], 0.5, 1.0) + log_density(u[1], -0.2, 2_f64.exp());
        assert!((log_probability.into_scalar() - expected).abs() < 1e-12);
    }
}
