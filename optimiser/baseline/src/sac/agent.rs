//! Soft actor-critic with two critics and a temperature that adapts itself.
//!
//! Equations are those of Haarnoja et al. 2018, "Soft Actor-Critic Algorithms and Applications", arXiv:1812.05905.
//!
//! | symbol | here | equation |
//! |---|---|---|
//! | s, a, r, s' | `Batch` | |
//! | pi_phi | `Agent::policy` | 8 |
//! | Q_theta1, Q_theta2 | `Agent::critics` | |
//! | Q_theta-bar | `Agent::targets` | algorithm 1 |
//! | V(s') | inside `Agent::returns` | 3 |
//! | J_Q(theta) | loss in `Agent::update_critics` | 5 |
//! | J_pi(phi) | loss in `Agent::update_policy` | 9 |
//! | J(alpha) | `temperature_slope` | 18 |
//! | alpha | `Agent::temperature` | |
//! | H-bar | `Settings::target_entropy` | 17, 18 |
//! | gamma, tau, lambda | `Settings::{discount, smoothing, learning_rate}` | |

use super::network::{Adam, Layers, Network, Plain, Traced, numbers, tensor};
use super::policy::Gaussian;
use super::replay::{Replay, Transition};
use crate::noise::Noise;
use burn_ndarray::NdArrayDevice;
use burn_tensor::Tensor;
use burn_tensor::backend::Backend;

/// Streams of the seed's generator: first weights, what is done, what is learned from.
const WEIGHT_STREAM: u64 = 0x77_6569_6768;
const ACTION_STREAM: u64 = 0x61_6374_696f;
const BATCH_STREAM: u64 = 0x62_6174_6368;

/// What an [`Agent`] can be told; [`Settings::default`] is what the comparison uses.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Units of each of the two hidden layers, 256 as in the authors' table of hyperparameters.
    pub hidden: usize,
    /// Transitions that one gradient step learns from.
    pub batch: usize,
    /// Of policy, critics and temperature alike.
    pub learning_rate: f64,
    /// Gamma: what a reward one step later is worth.
    pub discount: f64,
    /// Tau: the fraction of the way that target critics go towards their critics at each update.
    pub smoothing: f64,
    /// Entropy that the temperature aims at, in nats; minus the number of actions where `None`.
    pub target_entropy: Option<f64>,
    /// Gradient steps after each recorded transition, once there are `batch` of them.
    pub updates_per_step: usize,
    /// First steps, whose actions are uniform.
    pub warmup: usize,
    /// Transitions kept; each new one then replaces the oldest.
    pub capacity: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            hidden: 256,
            batch: 8,
            learning_rate: 1e-3,
            discount: 0.99,
            smoothing: 0.005,
            target_entropy: None,
            updates_per_step: 1,
            warmup: 8,
            capacity: 1_000_000,
        }
    }
}

/// An agent that learns from rewards what to do.
///
/// What it does is a function of its seed and of what it was told, to the last bit, on one kind of processor: no sum is
/// split between threads.
#[derive(Clone, Debug)]
pub struct Agent {
    settings: Settings,
    actions: usize,
    policy: Learner,
    critics: [Learner; 2],
    targets: [Network; 2],
    log_temperature: f32,
    log_temperature_adam: Adam,
    replay: Replay,
    /// Rewards are learned as (reward - origin) / unit.
    reward_origin: f64,
    reward_unit: f64,
    action_noise: Noise,
    batch_noise: Noise,
    acted: usize,
}

/// A network and the optimiser of its weights.
#[derive(Clone, Debug)]
struct Learner {
    network: Network,
    adam: Adam,
}

/// Transitions as matrices, one row for each.
struct Batch {
    observations: Tensor<Plain, 2>,
    actions: Tensor<Plain, 2>,
    rewards: Tensor<Plain, 2>,
    next_observations: Tensor<Plain, 2>,
    /// 0 after the last step of an episode, 1 otherwise.
    continues: Tensor<Plain, 2>,
}

impl Agent {
    /// An agent that sees `observations` numbers and answers with `actions` numbers in [-1, 1].
    pub fn new(observations: usize, actions: usize, seed: u64, settings: Settings) -> Self {
        assert!(observations > 0 && actions > 0 && settings.batch > 0 && settings.hidden > 0);
        let mut noise = Noise::new(seed, WEIGHT_STREAM);
        let hidden = settings.hidden;
        let mut learner = |inputs, outputs| Learner {
            network: Network::new(&[inputs, hidden, hidden, outputs], &mut noise),
            adam: Adam::default(),
        };
        let policy = learner(observations, 2 * actions);
        let critics = [learner(observations + actions, 1), learner(observations + actions, 1)];
        let targets = critics.each_ref().map(|critic| critic.network.clone());
        Self {
            actions,
            policy,
            critics,
            targets,
            log_temperature: 0.0,
            log_temperature_adam: Adam::default(),
            replay: Replay::new(settings.capacity),
            reward_origin: 0.0,
            reward_unit: 1.0,
            action_noise: Noise::new(seed, ACTION_STREAM),
            batch_noise: Noise::new(seed, BATCH_STREAM),
            acted: 0,
            settings,
        }
    }

    /// What to do next, exploring.
    pub fn act(&mut self, observation: &[f64]) -> Vec<f64> {
        self.acted += 1;
        if self.acted <= self.settings.warmup {
            return (0..self.actions).map(|_| self.action_noise.signed()).collect();
        }
        let noise = normal_matrix([1, self.actions], &mut self.action_noise);
        let (action, _) = self.gaussian(observation).sample(noise);
        numbers(action).into_iter().map(f64::from).collect()
    }

    /// What to do without exploring: the policy's median.
    pub fn act_greedily(&self, observation: &[f64]) -> Vec<f64> {
        numbers(self.gaussian(observation).mean.tanh()).into_iter().map(f64::from).collect()
    }

    /// First actions still to come that are uniform, whatever is recorded meanwhile.
    pub fn warmup_left(&self) -> usize {
        self.settings.warmup.saturating_sub(self.acted)
    }

    /// Alpha: what one nat of entropy is worth, in units of the learned reward.
    pub fn temperature(&self) -> f64 {
        f64::from(self.log_temperature.exp())
    }

    /// Learns rewards, past and future, as (reward - `origin`) / `unit`; `unit` is positive.
    pub fn scale_rewards(&mut self, origin: f64, unit: f64) {
        (self.reward_origin, self.reward_unit) = (origin, unit);
    }

    /// Keeps a transition, and learns from a batch of those kept.
    pub fn record(&mut self, transition: Transition) {
        self.replay.push(transition);
        if self.replay.len() >= self.settings.batch {
            for _ in 0..self.settings.updates_per_step {
                self.update();
            }
        }
    }

    fn gaussian(&self, observation: &[f64]) -> Gaussian<Plain> {
        let row = observation.iter().map(|&x| x as f32).collect();
        Gaussian::from_outputs(self.policy.network.layers().forward(tensor(row, [1, observation.len()])))
    }

    /// One gradient step of everything: the loop body of algorithm 1.
    fn update(&mut self) {
        let batch = self.batch();
        self.update_critics(&batch);
        let log_probabilities = self.update_policy(&batch.observations);
        self.update_temperature(&log_probabilities);
        for (target, critic) in self.targets.iter_mut().zip(&self.critics) {
            target.follow(&critic.network, self.settings.smoothing as f32);
        }
    }

    fn batch(&mut self) -> Batch {
        let drawn = self.replay.sample(self.settings.batch, &mut self.batch_noise);
        let matrix = |row: &dyn Fn(&Transition) -> Vec<f64>| {
            let numbers: Vec<f32> =
                drawn.iter().flat_map(|transition| row(transition)).map(|x| x as f32).collect();
            let columns = numbers.len() / drawn.len();
            tensor(numbers, [drawn.len(), columns])
        };
        let (origin, unit) = (self.reward_origin, self.reward_unit);
        Batch {
            observations: matrix(&|t| t.observation.clone()),
            actions: matrix(&|t| t.action.clone()),
            rewards: matrix(&|t| vec![(t.reward - origin) / unit]),
            next_observations: matrix(&|t| t.next_observation.clone()),
            continues: matrix(&|t| vec![if t.done { 0.0 } else { 1.0 }]),
        }
    }

    /// What the critics are to say: r + gamma V(s').
    fn returns(&mut self, batch: &Batch) -> Tensor<Plain, 2> {
        let noise = normal_matrix([self.settings.batch, self.actions], &mut self.batch_noise);
        let outputs = self.policy.network.layers().forward(batch.next_observations.clone());
        let (actions, log_probabilities) = Gaussian::from_outputs(outputs).sample(noise);
        let targets = self.targets.each_ref().map(Network::layers);
        let worth = lower_value(&targets, batch.next_observations.clone(), actions);
        let value = worth - log_probabilities * self.log_temperature.exp();
        batch.rewards.clone() + batch.continues.clone() * value * self.settings.discount
    }

    fn update_critics(&mut self, batch: &Batch) {
        let returns = Tensor::from_inner(self.returns(batch));
        let inputs: Tensor<Traced, 2> =
            Tensor::from_inner(Tensor::cat(vec![batch.observations.clone(), batch.actions.clone()], 1));
        for critic in &mut self.critics {
            let layers = critic.network.traced();
            let loss = (layers.forward(inputs.clone()) - returns.clone()).square().mean() * 0.5;
            critic.step(&layers.gradients(&loss), &self.settings);
        }
    }

    /// Improves the policy; returns the log densities of the actions that it drew for that.
    fn update_policy(&mut self, observations: &Tensor<Plain, 2>) -> Vec<f32> {
        let observations = Tensor::<Traced, 2>::from_inner(observations.clone());
        let noise = normal_matrix([self.settings.batch, self.actions], &mut self.batch_noise);
        let layers = self.policy.network.traced();
        let outputs = layers.forward(observations.clone());
        let (actions, log_probabilities) = Gaussian::from_outputs(outputs).sample(noise);
        let critics = self.critics.each_ref().map(|critic| critic.network.layers::<Traced>());
        let value = lower_value(&critics, observations, actions);
        let loss = (log_probabilities.clone() * self.log_temperature.exp() - value).mean();
        self.policy.step(&layers.gradients(&loss), &self.settings);
        numbers(log_probabilities.inner())
    }

    fn update_temperature(&mut self, log_probabilities: &[f32]) {
        let target = self.settings.target_entropy.unwrap_or(-(self.actions as f64)) as f32;
        let slope = temperature_slope(self.log_temperature, log_probabilities, target);
        let rate = self.settings.learning_rate as f32;
        self.log_temperature_adam.step(std::iter::once(&mut self.log_temperature), [slope].iter(), rate);
    }
}

impl Learner {
    fn step(&mut self, gradients: &[Vec<f32>], settings: &Settings) {
        self.adam.step_network(&mut self.network, gradients, settings.learning_rate as f32);
    }
}

/// The lower of two critics' values of what was done, rows by 1: both err, and the policy would seek the higher error.
fn lower_value<B: Backend>(
    critics: &[Layers<B>; 2],
    observations: Tensor<B, 2>,
    actions: Tensor<B, 2>,
) -> Tensor<B, 2> {
    let inputs = Tensor::cat(vec![observations, actions], 1);
    critics[0].forward(inputs.clone()).min_pair(critics[1].forward(inputs))
}

/// Derivative of J(alpha) = E[-alpha (log pi + H-bar)] by log alpha.
fn temperature_slope(log_temperature: f32, log_probabilities: &[f32], target_entropy: f32) -> f32 {
    let mean = log_probabilities.iter().sum::<f32>() / log_probabilities.len() as f32;
    -log_temperature.exp() * (mean + target_entropy)
}

fn normal_matrix<B: Backend<Device = NdArrayDevice>>(shape: [usize; 2], noise: &mut Noise) -> Tensor<B, 2> {
    tensor((0..shape[0] * shape[1]).map(|_| noise.normal() as f32).collect(), shape)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_temperature_rises_while_the_entropy_is_below_its_target_and_falls_above() {
        let settings = Settings { hidden: 4, ..Settings::default() };
        for (entropy, rises) in [(-9.0, true), (-6.0, true), (-4.0, false), (3.0, false)] {
            let mut agent = Agent::new(1, 5, 1, settings.clone());
            let before = agent.temperature();
            // The entropy is minus the mean log density; the target is -5.
            agent.update_temperature(&[-entropy - 0.5, -entropy + 0.5]);
            assert_eq!(agent.temperature() > before, rises, "entropy {entropy}");
        }
        assert!((temperature_slope(2_f32.ln(), &[3.0, 5.0], -5.0) - 2.0).abs() < 1e-6);
    }

    #[test]
    fn returns_stop_at_the_end_of_an_episode() {
        let mut agent = Agent::new(2, 1, 1, Settings { hidden: 4, batch: 1, ..Settings::default() });
        agent.scale_rewards(1.0, 2.0);
        for done in [true, false] {
            let observation = vec![0.1, 0.2];
            let transition = Transition {
                next_observation: vec![0.3, 0.4],
                action: vec![0.5],
                reward: 7.0,
                observation,
                done,
            };
            agent.replay = Replay::new(1);
            agent.replay.push(transition);
            let batch = agent.batch();
            let found = numbers(agent.returns(&batch))[0];
            assert_eq!((found - 3.0).abs() < 1e-6, done, "{found}");
        }
    }
}
