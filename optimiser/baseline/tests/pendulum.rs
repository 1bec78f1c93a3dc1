//! Soft actor-critic on a problem that it is known to solve: the pendulum that is to be swung up and held, as in
//! Gymnasium's Pendulum-v1 (`gymnasium/envs/classic_control/pendulum.py`), with its constants, rewards and 200 steps.
//!
//! The whole training, with its learning curve:
//! `cargo test --release -p powderline-baseline --test pendulum -- --ignored --nocapture`

use powderline_baseline::sac::{Agent, Settings, Transition};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};
use std::f64::consts::{PI, TAU};

const EPISODE_STEPS: usize = 200;
const STEP_S: f64 = 0.05;
const GRAVITY: f64 = 10.0;
const MAX_SPEED: f64 = 8.0;
const MAX_TORQUE: f64 = 2.0;

/// A rod of 1 kg and 1 m. The angle is 0 where it stands.
struct Pendulum {
    angle: f64,
    speed: f64,
}

impl Pendulum {
    fn new(rng: &mut ChaCha8Rng) -> Self {
        let mut signed = || (rng.next_u64() >> 11) as f64 * f64::EPSILON - 1.0;
        Self { angle: PI * signed(), speed: signed() }
    }

    fn observation(&self) -> Vec<f64> {
        vec![self.angle.cos(), self.angle.sin(), self.speed]
    }

    /// Applies a torque for one step, of which `action` is the fraction; returns the reward.
    fn step(&mut self, action: f64) -> f64 {
        let torque = MAX_TORQUE * action.clamp(-1.0, 1.0);
        let from_top = (self.angle + PI).rem_euclid(TAU) - PI;
        let cost = from_top.powi(2) + 0.1 * self.speed.powi(2) + 0.001 * torque.powi(2);
        let acceleration = 1.5 * GRAVITY * self.angle.sin() + 3.0 * torque;
        self.speed = (self.speed + acceleration * STEP_S).clamp(-MAX_SPEED, MAX_SPEED);
        self.angle += self.speed * STEP_S;
        -cost
    }
}

/// Plays one episode and learns; returns the sum of its rewards.
fn train_episode(agent: &mut Agent, rng: &mut ChaCha8Rng) -> f64 {
    let mut pendulum = Pendulum::new(rng);
    let mut sum = 0.0;
    for _ in 0..EPISODE_STEPS {
        let observation = pendulum.observation();
        let action = agent.act(&observation);
        let reward = pendulum.step(action[0]);
        let next_observation = pendulum.observation();
        // The episode is cut off after its steps; the pendulum would swing on.
        agent.record(Transition { observation, action, reward, next_observation, done: false });
        sum += reward;
    }
    sum
}

/// Mean return of ten episodes without exploring, always from the same ten states.
fn mean_return(mut act: impl FnMut(&[f64]) -> f64) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(1000);
    let episode = |_| {
        let mut pendulum = Pendulum::new(&mut rng);
        (0..EPISODE_STEPS).map(|_| pendulum.step(act(&pendulum.observation()))).sum::<f64>()
    };
    (0..10).map(episode).sum::<f64>() / 10.0
}

/// Trains a new agent for `episodes` and returns its mean return then.
fn train(seed: u64, episodes: usize, settings: Settings) -> f64 {
    let mut agent = Agent::new(3, 1, seed, settings);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    for episode in 1..=episodes {
        let sum = train_episode(&mut agent, &mut rng);
        println!("episode {episode:3}: return {sum:7.0}, temperature {:.3}", agent.temperature());
    }
    let mean = mean_return(|observation| agent.act_greedily(observation)[0]);
    println!("seed {seed}: mean return of ten episodes without exploring {mean:.0}");
    mean
}

/// Smaller and with larger batches than in the comparison: what is tested is the algorithm.
fn settings() -> Settings {
    Settings { hidden: 64, batch: 64, warmup: 400, ..Settings::default() }
}

#[test]
fn doing_anything_at_random_or_nothing_at_all_earns_about_what_is_known() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let random = mean_return(|_| (rng.next_u64() >> 11) as f64 * f64::EPSILON - 1.0);
    assert!((-1700.0..-900.0).contains(&random), "{random}");
    let nothing = mean_return(|_| 0.0);
    assert!((-1900.0..-900.0).contains(&nothing), "{nothing}");
}

#[test]
fn a_short_training_learns_most_of_it() {
    let found = train(1, 15, settings());
    assert!(found > -500.0, "{found}");
}

#[test]
fn a_whole_training_swings_it_up_and_holds_it() {
    for seed in 1..=3 {
        let found = train(seed, 40, settings());
        assert!(found > -250.0, "seed {seed}: {found}");
    }
}
