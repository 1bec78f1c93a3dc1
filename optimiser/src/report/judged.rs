//! Which epochs the arm may perform, and which of these becomes the plan.

use super::amounts::Amounts;
use crate::optim::EpochRecord;
use powderline_simulator::{
    scene::{Aim, Scene},
    skill::{SkillMap, Theta, collision},
};
use serde::Serialize;

/// How the plan is chosen among the epochs whose motion the arm may perform.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// The smallest miss of the wanted amount, ties by loss.
    SmallestMiss,
    /// The lowest loss: as much as can be had is wanted.
    LowestLoss,
}

impl Rule {
    /// The rule that goes with what a scene asks for.
    pub fn of(scene: &Scene) -> Self {
        match scene.objective.aim {
            Aim::Amount => Self::SmallestMiss,
            Aim::All => Self::LowestLoss,
        }
    }

    /// The rule as the end of a sentence on an epoch.
    pub fn words(self) -> &'static str {
        match self {
            Self::SmallestMiss => "misses the wanted amount least (ties by loss)",
            Self::LowestLoss => "has the lowest loss",
        }
    }

    /// The epoch to ship; none if the arm may perform no epoch's motion.
    pub fn choose(self, amounts: &Amounts, epochs: &[Judged]) -> Option<usize> {
        let key = |record: &EpochRecord| match self {
            Self::SmallestMiss => [amounts.miss(record.transported).abs(), record.loss],
            Self::LowestLoss => [record.loss, 0.0],
        };
        let order = |a: &&Judged, b: &&Judged| {
            let [a, b] = [key(&a.record), key(&b.record)];
            a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1]))
        };
        let able = epochs.iter().filter(|epoch| epoch.obstacle.is_none());
        able.min_by(order).map(|epoch| epoch.record.epoch as usize)
    }
}

/// An epoch, and what keeps the arm from performing its motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Judged {
    /// What was found.
    pub record: EpochRecord,
    /// Why it can be no plan; nothing if it can.
    pub obstacle: Option<String>,
}

impl Judged {
    /// Judges the motion of an epoch's skill: the arm's limits, and walls in the tool's way.
    pub fn new(scene: &Scene, map: &SkillMap, record: EpochRecord) -> Self {
        Self { record, obstacle: obstacle(scene, map, &record.theta) }
    }
}

fn obstacle(scene: &Scene, map: &SkillMap, theta: &Theta) -> Option<String> {
    let quantised = match map.quantise(theta).and_then(|quantised| {
        map.check_limits(&quantised)?;
        Ok(quantised)
    }) {
        Ok(quantised) => quantised,
        Err(error) => return Some(error.to_string()),
    };
    collision(scene, map.start_pose(), &quantised.controls).map(|collision| collision.to_string())
}
