//! What a plan's skill, and corrections of it, bring on the scene's own cells and on smaller ones.

use super::finding::is_same;
use crate::{
    optim::is_loss,
    refine::{Grid, Look},
};
use powderline_simulator::{
    rollout::{Census, Evaluation},
    skill::Theta,
};
use serde::{Deserialize, Serialize};

/// A skill's motion, rounded to whole counts, on one of two grids.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Seen {
    /// Where.
    pub grid: Grid,
    /// The skill.
    pub theta: Theta,
    /// Why there is nothing to be seen.
    pub obstacle: Option<String>,
    /// Loss, metres.
    pub loss_m: f64,
    /// Wanted particles that did not arrive; negative if more did.
    pub indicator: i64,
    /// Particles of that grid by where they are at the end.
    pub census: Census,
    /// Processor time, seconds.
    pub cpu_seconds: f64,
}

impl Seen {
    /// What a motion brings.
    pub fn new(grid: Grid, theta: &Theta, found: &Evaluation, cpu_seconds: f64) -> Self {
        let Evaluation { loss, indicator, census, .. } = *found;
        Self { grid, theta: *theta, obstacle: None, loss_m: loss, indicator, census, cpu_seconds }
    }

    /// That there is none.
    pub fn nothing(grid: Grid, theta: &Theta, why: String) -> Self {
        let found = Evaluation::new(0.0, 0, Census::default());
        Self { obstacle: Some(why), ..Self::new(grid, theta, &found, 0.0) }
    }

    /// Whether it is of this skill, bit by bit, on this grid.
    pub fn is_of(&self, grid: Grid, theta: &Theta) -> bool {
        self.grid == grid && is_same(self.theta, theta.components())
    }

    /// What was seen, where a particle has this mass; nothing where there was nothing to be seen.
    pub fn look(&self, particle_mass_kg: f64) -> Option<Look> {
        let mass_kg = f64::from(self.census.target) * particle_mass_kg;
        let evaluation = Evaluation::new(self.loss_m, self.indicator, self.census);
        self.obstacle.is_none().then_some(Look { theta: self.theta, mass_kg, evaluation })
    }

    pub(crate) fn is_sound(&self) -> bool {
        is_loss(self.loss_m) && (0.0..=f64::MAX).contains(&self.cpu_seconds)
    }
}
