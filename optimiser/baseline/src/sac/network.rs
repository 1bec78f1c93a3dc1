//! Networks as plain numbers: burn differentiates, this keeps, steps and averages the weights.
//!
//! | symbol | here | source |
//! |---|---|---|
//! | theta, phi | `Network::weights` | Haarnoja et al. 2018, arXiv:1812.05905 |
//! | tau | `fraction` in [`Network::follow`] | ibid., algorithm 1 |
//! | alpha, beta1, beta2, epsilon | `rate`, [`BETA_1`], [`BETA_2`], [`EPSILON`] | Kingma and Ba 2015, arXiv:1412.6980, algorithm 1 |
//! | m, v, t | `Adam::mean`, `Adam::square`, `Adam::steps` | ibid. |

use crate::noise::Noise;
use burn_autodiff::Autodiff;
use burn_ndarray::{NdArray, NdArrayDevice};
use burn_tensor::backend::Backend;
use burn_tensor::{Tensor, TensorData, activation};

/// Numbers without derivatives.
pub(crate) type Plain = NdArray<f32>;
/// Numbers that remember where they came from.
pub(crate) type Traced = Autodiff<Plain>;

/// A fully connected network with ReLU after each layer but the last.
#[derive(Clone, Debug)]
pub(crate) struct Network {
    /// Inputs and outputs of each layer.
    shapes: Vec<[usize; 2]>,
    /// Of each layer the matrix, inputs by outputs, then the bias, 1 by outputs.
    weights: Vec<Vec<f32>>,
}

/// The weights of a network as tensors.
pub(crate) struct Layers<B: Backend>(Vec<Tensor<B, 2>>);

impl Network {
    /// `sizes` are the inputs, the units of each hidden layer and the outputs. Weights and biases are uniform in
    /// plus or minus 1 / sqrt(inputs of the layer), as in most implementations of SAC.
    pub(crate) fn new(sizes: &[usize], noise: &mut Noise) -> Self {
        let shapes: Vec<_> = sizes.windows(2).map(|pair| [pair[0], pair[1]]).collect();
        let mut weights = Vec::new();
        for [inputs, outputs] in &shapes {
            let bound = (*inputs as f64).sqrt().recip();
            let mut draw = |count: usize| (0..count).map(|_| (bound * noise.signed()) as f32).collect();
            weights.push(draw(inputs * outputs));
            weights.push(draw(*outputs));
        }
        Self { shapes, weights }
    }

    /// The weights as tensors of whichever backend is wanted.
    pub(crate) fn layers<B: Backend<Device = NdArrayDevice>>(&self) -> Layers<B> {
        let shapes = self.shapes.iter().flat_map(|&[inputs, outputs]| [[inputs, outputs], [1, outputs]]);
        Layers(
            self.weights.iter().zip(shapes).map(|(numbers, shape)| tensor(numbers.clone(), shape)).collect(),
        )
    }

    /// The weights as tensors, and every one of them traced.
    pub(crate) fn traced(&self) -> Layers<Traced> {
        Layers(self.layers().0.into_iter().map(Tensor::require_grad).collect())
    }

    /// Moves each weight by `fraction` of the way to its counterpart in `leader`.
    pub(crate) fn follow(&mut self, leader: &Self, fraction: f32) {
        for (own, target) in self.weights.iter_mut().flatten().zip(leader.weights.iter().flatten()) {
            *own += fraction * (target - *own);
        }
    }
}

impl<B: Backend> Layers<B> {
    /// Outputs of the network, one row for each row of `inputs`.
    pub(crate) fn forward(&self, inputs: Tensor<B, 2>) -> Tensor<B, 2> {
        let mut hidden = inputs;
        for (index, layer) in self.0.chunks_exact(2).enumerate() {
            if index > 0 {
                hidden = activation::relu(hidden);
            }
            hidden = hidden.matmul(layer[0].clone()) + layer[1].clone();
        }
        hidden
    }
}

impl Layers<Traced> {
    /// Derivatives of `loss` by each weight, in the order of `Network::weights`; zero where `loss` does not depend on it.
    pub(crate) fn gradients(&self, loss: &Tensor<Traced, 1>) -> Vec<Vec<f32>> {
        let mut found = loss.backward();
        let gradient = |weight: &Tensor<Traced, 2>| match weight.grad_remove(&mut found) {
            Some(gradient) => numbers(gradient),
            None => vec![0.0; weight.dims().iter().product()],
        };
        self.0.iter().map(gradient).collect()
    }
}

const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.999;
const EPSILON: f32 = 1e-8;
/// Moments smaller than this count as zero: they move no weight, and processors are slow with the numbers below 1e-38
/// that the moments of unused units decay to.
const NEGLIGIBLE: f32 = 1e-30;

/// The optimiser Adam, for one group of weights.
#[derive(Clone, Debug, Default)]
pub(crate) struct Adam {
    steps: i32,
    mean: Vec<f32>,
    square: Vec<f32>,
}

impl Adam {
    /// One step of `network` down `gradients`.
    pub(crate) fn step_network(&mut self, network: &mut Network, gradients: &[Vec<f32>], rate: f32) {
        self.step(network.weights.iter_mut().flatten(), gradients.iter().flatten(), rate);
    }

    /// One step of `weights` down `gradients`, as many of them and in the same order at every step.
    pub(crate) fn step<'a>(
        &mut self,
        weights: impl Iterator<Item = &'a mut f32>,
        gradients: impl Iterator<Item = &'a f32> + Clone,
        rate: f32,
    ) {
        let count = gradients.clone().count();
        self.mean.resize(count, 0.0);
        self.square.resize(count, 0.0);
        self.steps += 1;
        let unbias_mean = (1.0 - BETA_1.powi(self.steps)).recip();
        let unbias_square = (1.0 - BETA_2.powi(self.steps)).recip();
        let moments = self.mean.iter_mut().zip(&mut self.square);
        for ((weight, gradient), (mean, square)) in weights.zip(gradients).zip(moments) {
            *mean = felt(*mean + (1.0 - BETA_1) * (gradient - *mean));
            *square = felt(*square + (1.0 - BETA_2) * (gradient * gradient - *square));
            *weight -= rate * *mean * unbias_mean / ((*square * unbias_square).sqrt() + EPSILON);
        }
    }
}

fn felt(moment: f32) -> f32 {
    if moment.abs() < NEGLIGIBLE { 0.0 } else { moment }
}

/// A matrix of `numbers`, row by row.
pub(crate) fn tensor<B: Backend<Device = NdArrayDevice>>(
    numbers: Vec<f32>,
    shape: [usize; 2],
) -> Tensor<B, 2> {
    Tensor::from_data(TensorData::new(numbers, shape), &NdArrayDevice::Cpu)
}

/// The numbers of a matrix, row by row.
pub(crate) fn numbers<const D: usize>(tensor: Tensor<Plain, D>) -> Vec<f32> {
    tensor.into_data().into_vec().expect("the backend's numbers are f32")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_network_by_hand() {
        // relu([1, 2] [[1, -1], [0.5, 1]] + [0, -3]) = [2, 0]; times [[3], [7]] plus 0.5 is 6.5.
        let network = Network {
            shapes: vec![[2, 2], [2, 1]],
            weights: vec![vec![1.0, -1.0, 0.5, 1.0], vec![0.0, -3.0], vec![3.0, 7.0], vec![0.5]],
        };
        let layers = network.traced();
        let output = layers.forward(tensor(vec![1.0, 2.0], [1, 2]));
        assert_eq!(numbers(output.clone().inner()), [6.5]);
        let expected: [&[f32]; 4] = [&[3.0, 0.0, 6.0, 0.0], &[3.0, 0.0], &[2.0, 0.0], &[1.0]];
        assert_eq!(layers.gradients(&output.sum()), expected);
    }

    #[test]
    fn adams_first_step_is_the_rate_long_and_it_finds_a_minimum() {
        let mut weights = [1.0_f32, -2.0];
        Adam::default().step(weights.iter_mut(), [0.01, -300.0].iter(), 0.1);
        assert!((weights[0] - 0.9).abs() < 1e-5 && (weights[1] + 1.9).abs() < 1e-5, "{weights:?}");
        let mut adam = Adam::default();
        for _ in 0..2000 {
            let gradients = weights.map(|w| 2.0 * (w - 0.5));
            adam.step(weights.iter_mut(), gradients.iter(), 0.01);
        }
        assert!(weights.iter().all(|w| (w - 0.5).abs() < 1e-3), "{weights:?}");
    }

    #[test]
    fn a_follower_goes_its_fraction_of_the_way() {
        let mut noise = Noise::new(1, 0);
        let leader = Network::new(&[3, 4, 2], &mut noise);
        let mut follower = Network::new(&[3, 4, 2], &mut noise);
        let before = follower.weights[2][5];
        follower.follow(&leader, 0.25);
        let expected = 0.75 * before + 0.25 * leader.weights[2][5];
        assert!((follower.weights[2][5] - expected).abs() < 1e-7);
    }
}
