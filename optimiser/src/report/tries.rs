//! What a search asked for and what came of it, one line of `tries.jsonl` each.

use crate::optim::{Adjoint, Found, Trial, Work, World, are_sound, is_loss};
use powderline_simulator::rollout::{Census, Evaluation};
use powderline_simulator::skill::Splines;
use serde::{Deserialize, Serialize};

/// One simulated motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Try {
    /// Epoch that it belongs to.
    pub epoch: u32,
    /// Its parameters, each from -1 to 1: theta.
    pub theta: Vec<f64>,
    /// What is added to the skill's motion, if anything is.
    pub splines: Option<Splines>,
    /// Where it was simulated.
    pub world: World,
    /// Whether as it is shipped, rounded to whole counts.
    pub rounded: bool,
    /// The adjoint that was wanted besides.
    pub adjoint: Option<Adjoint>,
    /// Loss, metres, as of the scene's particles.
    pub loss: f64,
    /// Wanted particles that did not arrive; negative if more did.
    pub indicator: i64,
    /// The scene's particles by where they are at the end.
    pub census: Census,
    /// The derivative of the loss, metres per unit of theta or, where there are splines, of their coefficients, if it was wanted.
    pub gradient: Option<Vec<f64>>,
    /// Processor time, seconds; that of motions simulated side by side is shared out evenly.
    pub cpu_seconds: f64,
}

impl Try {
    /// What came of a trial.
    pub fn new(epoch: u32, trial: &Trial, found: &Found, cpu_seconds: f64) -> Self {
        let Evaluation { loss, indicator, census, .. } = found.evaluation;
        Self {
            epoch,
            theta: trial.point.clone(),
            splines: trial.splines.clone(),
            world: trial.world,
            rounded: trial.is_rounded,
            adjoint: trial.adjoint,
            loss,
            indicator,
            census,
            gradient: found.gradient.clone(),
            cpu_seconds,
        }
    }

    /// Whether it is of this trial, bit by bit.
    pub(crate) fn is_of(&self, trial: &Trial) -> bool {
        let bits = |point: &[f64]| point.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        let added = |splines: &Option<Splines>| {
            splines.as_ref().map(|splines| (splines.freedoms.clone(), bits(&splines.coefficients)))
        };
        bits(&self.theta) == bits(&trial.point)
            && added(&self.splines) == added(&trial.splines)
            && (self.world, self.rounded, self.adjoint) == (trial.world, trial.is_rounded, trial.adjoint)
    }

    /// What a search is told of it.
    pub fn found(&self) -> Found {
        Found { evaluation: self.evaluation(), gradient: self.gradient.clone() }
    }

    /// What was found.
    pub fn evaluation(&self) -> Evaluation {
        Evaluation::new(self.loss, self.indicator, self.census)
    }

    /// What was asked for.
    pub fn trial(&self) -> Trial {
        Trial {
            point: self.theta.clone(),
            splines: self.splines.clone(),
            world: self.world,
            is_rounded: self.rounded,
            adjoint: self.adjoint,
            may_fail: true,
        }
    }

    /// What it took.
    pub fn work(&self) -> Work {
        let is_coarse = self.world == World::Coarse;
        Work {
            coarse_rollouts: is_coarse.into(),
            rollouts: (!is_coarse).into(),
            adjoints: self.adjoint.is_some().into(),
            cpu_seconds: self.cpu_seconds,
        }
    }

    pub(crate) fn is_sound(&self) -> bool {
        let is_timed = (0.0..=f64::MAX).contains(&self.cpu_seconds);
        is_loss(self.loss) && is_timed && are_sound(self.splines.as_ref())
    }
}
