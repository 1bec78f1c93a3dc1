//! Soft actor-critic, and how it searches.

mod agent;
mod network;
mod policy;
mod replay;

pub use agent::{Agent, Settings};
pub use replay::Transition;

use crate::Search;

/// What the agent sees, always: there is nothing to see.
const OBSERVATION: [f64; 1] = [1.0];

/// Soft actor-critic that learns one point of [-1, 1]^n.
///
/// *One action per episode.* The point is the action and its negated loss the reward; the observation is constant, and
/// the episode is over after its one step. The discount of 0.99 thus has nothing to discount. The paper names the
/// discount, the batch of 8 and the learning rates of 0.001, and that the reward is the negated loss; it does not say
/// what an observation, an action or a step is. This is the reading in which an episode costs one simulation.
///
/// *Scale of rewards.* What entropy is worth against rewards depends on the unit of the loss, and SAC fails if rewards
/// are thousands. So rewards are learned in their own unit: less their mean, divided by their standard deviation, both
/// over all episodes so far, so that those in the replay buffer are rescaled with each new one. Multiplying all losses by a
/// factor or adding a constant then changes nothing but rounding. The paper says nothing of a scale.
///
/// *Learning.* After each episode, from the eighth on, as many gradient steps as `updates_per_step` says (each of both
/// critics, policy and temperature). The first eight points, which nothing is known for, are uniform, as those of
/// [`RandomSearch`](crate::RandomSearch).
#[derive(Clone, Debug)]
pub struct Sac {
    agent: Agent,
    asked: Vec<Vec<f64>>,
    losses: Moments,
}

impl Sac {
    /// A search over [-1, 1]^`dimension` with the paper's settings and one gradient step per episode.
    pub fn new(dimension: usize, seed: u64) -> Self {
        Self::with_settings(dimension, seed, Settings::default())
    }

    /// A search over [-1, 1]^`dimension`.
    pub fn with_settings(dimension: usize, seed: u64, settings: Settings) -> Self {
        let agent = Agent::new(OBSERVATION.len(), dimension, seed, settings);
        Self { agent, asked: Vec::new(), losses: Moments::default() }
    }

    /// The point that the policy would choose now if it did not explore.
    pub fn choice(&self) -> Vec<f64> {
        self.agent.act_greedily(&OBSERVATION)
    }

    /// Alpha: what one nat of entropy is worth, in standard deviations of the losses.
    pub fn temperature(&self) -> f64 {
        self.agent.temperature()
    }
}

impl Search for Sac {
    /// One point, since each is chosen after learning from the one before; up to `most` of the first, uniform ones.
    fn ask(&mut self, most: usize) -> Vec<Vec<f64>> {
        let count = most.min(self.agent.warmup_left()).max(1);
        self.asked = (0..count).map(|_| self.agent.act(&OBSERVATION)).collect();
        self.asked.clone()
    }

    /// A loss that is not finite counts as the worst so far.
    fn tell(&mut self, losses: &[f64]) {
        assert_eq!(losses.len(), self.asked.len(), "one loss for each point asked for");
        for (action, &loss) in std::mem::take(&mut self.asked).into_iter().zip(losses) {
            let loss = self.losses.add(loss);
            self.agent.scale_rewards(-self.losses.mean, self.losses.deviation());
            let observation = OBSERVATION.to_vec();
            let next_observation = observation.clone();
            self.agent.record(Transition {
                observation,
                action,
                reward: -loss,
                next_observation,
                done: true,
            });
        }
    }
}

/// Mean and spread of numbers, one by one (Welford 1962).
#[derive(Clone, Debug, Default)]
struct Moments {
    count: usize,
    mean: f64,
    squares: f64,
    largest: Option<f64>,
}

impl Moments {
    /// Adds `number`, or in place of one that is not finite the largest so far, and returns what was added.
    fn add(&mut self, number: f64) -> f64 {
        let number = if number.is_finite() { number } else { self.largest.unwrap_or(0.0) };
        self.count += 1;
        let before = number - self.mean;
        self.mean += before / self.count as f64;
        self.squares += before * (number - self.mean);
        self.largest = Some(self.largest.map_or(number, |largest| largest.max(number)));
        number
    }

    /// The standard deviation, or 1 where all numbers are the same.
    fn deviation(&self) -> f64 {
        let deviation = (self.squares / self.count.max(1) as f64).sqrt();
        if deviation > 0.0 { deviation } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_whole() {
        let mut moments = Moments::default();
        assert!((moments.deviation() - 1.0).abs() < 1e-15);
        let added: Vec<f64> = [1000.0, 1004.0, f64::NAN, 992.0].into_iter().map(|x| moments.add(x)).collect();
        assert_eq!(added, [1000.0, 1004.0, 1004.0, 992.0]);
        assert!((moments.mean - 1000.0).abs() < 1e-12 && (moments.deviation() - 24_f64.sqrt()).abs() < 1e-12);
    }
}
