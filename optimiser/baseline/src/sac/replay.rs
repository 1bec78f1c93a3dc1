//! What the agent has lived through.

use crate::noise::Noise;

/// One step of an agent in its environment.
#[derive(Clone, Debug, PartialEq)]
pub struct Transition {
    /// What was seen before the step.
    pub observation: Vec<f64>,
    /// What was done, each component in [-1, 1].
    pub action: Vec<f64>,
    /// What was earned, in any unit.
    pub reward: f64,
    /// What was seen after the step.
    pub next_observation: Vec<f64>,
    /// Nothing can be earned after this step. Not set where an episode is merely cut off.
    pub done: bool,
}

/// The last `capacity` transitions.
#[derive(Clone, Debug)]
pub(crate) struct Replay {
    transitions: Vec<Transition>,
    capacity: usize,
    /// Where the next transition goes once the buffer is full.
    oldest: usize,
}

impl Replay {
    pub(crate) fn new(capacity: usize) -> Self {
        Self { transitions: Vec::new(), capacity: capacity.max(1), oldest: 0 }
    }

    pub(crate) fn len(&self) -> usize {
        self.transitions.len()
    }

    pub(crate) fn push(&mut self, transition: Transition) {
        if self.transitions.len() < self.capacity {
            self.transitions.push(transition);
        } else {
            self.transitions[self.oldest] = transition;
            self.oldest = (self.oldest + 1) % self.capacity;
        }
    }

    /// `count` transitions, uniform and with replacement; some must have been pushed.
    pub(crate) fn sample(&self, count: usize, noise: &mut Noise) -> Vec<&Transition> {
        (0..count).map(|_| &self.transitions[noise.below(self.transitions.len())]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_gives_way_and_all_others_are_drawn() {
        let mut replay = Replay::new(4);
        for reward in 0..6 {
            let empty = Vec::new;
            let (observation, action, next_observation) = (empty(), empty(), empty());
            replay.push(Transition {
                observation,
                action,
                reward: f64::from(reward),
                next_observation,
                done: false,
            });
        }
        let mut drawn: Vec<i64> = replay
            .sample(100, &mut Noise::new(1, 0))
            .iter()
            .map(|transition| transition.reward as i64)
            .collect();
        drawn.sort_unstable();
        drawn.dedup();
        assert_eq!(drawn, [2, 3, 4, 5]);
    }
}
