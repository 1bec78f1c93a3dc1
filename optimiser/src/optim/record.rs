//! What is written down of an epoch.

use super::{Epoch, Slopes, Step, World, is_loss};
use powderline_simulator::{
    rollout::{Census, Evaluation},
    skill::{Splines, Theta},
};
use serde::{Deserialize, Serialize};

/// One evaluated epoch: the one of its trials that stands for it; one line of `metrics.jsonl`. Counts and losses are as of the scene's particles, also
/// those of the coarse world.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EpochRecord {
    /// Its number, from 0.
    pub epoch: u32,
    /// Where it was evaluated.
    pub world: World,
    /// Whether as it is shipped, rounded to whole counts.
    pub rounded: bool,
    /// Loss, metres.
    pub loss: f64,
    /// Target count minus particles in the target container.
    pub indicator: i64,
    /// Particles by where they are at the end.
    pub census: Census,
    /// Skill parameters.
    pub theta: Theta,
    /// What is added to the skill's motion, if anything is.
    pub splines: Option<Splines>,
    /// What the epoch simulated, all its trials together.
    pub work: Work,
    /// Wall time of that, seconds.
    pub seconds: f64,
    /// What followed.
    pub step: Step,
    /// Where that went by a gradient.
    pub slopes: Option<Slopes>,
}

/// What was simulated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Work {
    /// Motions in the coarse world.
    pub coarse_rollouts: u32,
    /// Motions in the scene itself, with derivatives or without.
    pub rollouts: u32,
    /// How many of them with an adjoint.
    pub adjoints: u32,
    /// Processor time of all threads together, seconds.
    pub cpu_seconds: f64,
}

impl Work {
    /// Adds other work.
    pub fn add(&mut self, other: &Self) {
        self.coarse_rollouts = self.coarse_rollouts.saturating_add(other.coarse_rollouts);
        self.rollouts = self.rollouts.saturating_add(other.rollouts);
        self.adjoints = self.adjoints.saturating_add(other.adjoints);
        self.cpu_seconds += other.cpu_seconds;
    }
}

/// Numbers that a motion may be told apart by from its skill's, at most; a file may say anything.
const MAX_COEFFICIENTS: usize = 6 * 256;

/// Whether a path can have these.
pub(crate) fn are_sound(splines: Option<&Splines>) -> bool {
    splines.is_none_or(|Splines { freedoms, coefficients }| {
        (1..=6).contains(&freedoms.len())
            && coefficients.len() <= MAX_COEFFICIENTS
            && coefficients.len().is_multiple_of(freedoms.len())
            && coefficients.iter().all(|coefficient| coefficient.is_finite())
    })
}

impl EpochRecord {
    /// The record of a search's epoch; none if it is no skill's.
    pub fn new(number: u32, epoch: &Epoch, work: Work, seconds: f64) -> Option<Self> {
        let Epoch { trial, evaluation, step, slopes, .. } = epoch;
        let theta = Theta::new(trial.point[..].try_into().ok()?).ok()?;
        Some(Self {
            epoch: number,
            world: trial.world,
            rounded: trial.is_rounded,
            loss: evaluation.loss,
            indicator: evaluation.indicator,
            census: evaluation.census,
            theta,
            splines: trial.splines.clone(),
            work,
            seconds,
            step: *step,
            slopes: slopes.clone(),
        })
    }

    /// What was found.
    pub fn evaluation(&self) -> Evaluation {
        Evaluation::new(self.loss, self.indicator, self.census)
    }

    /// Whether it can be the record of this epoch.
    pub(crate) fn is_sound(&self, epoch: u32) -> bool {
        let timed = [self.seconds, self.work.cpu_seconds].iter().all(|s| (0.0..=f64::MAX).contains(s));
        self.epoch == epoch && is_loss(self.loss) && timed && are_sound(self.splines.as_ref())
    }
}
