//! Which epochs the arm may perform, and which of these becomes the plan.

use super::amounts::Amounts;
use crate::optim::EpochRecord;
use powderline_simulator::{
    arm::arm_motion,
    scene::{Aim, Scene},
    skill::{SkillMap, Theta, collision},
};
use serde::Serialize;
use std::cmp::Ordering;

/// How the plan is chosen among the epochs whose motion the arm may perform.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// Of the epochs within the tolerance the one that loses least powder; if there are none, the smallest miss. Ties by loss.
    LeastLost,
    /// The lowest loss: as much as can be had is wanted.
    LowestLoss,
}

impl Rule {
    /// The rule that goes with what a scene asks for.
    pub fn of(scene: &Scene) -> Self {
        match scene.objective.aim {
            Aim::Amount => Self::LeastLost,
            Aim::All => Self::LowestLoss,
        }
    }

    /// Of which epochs it is which one, where the epoch that it chose is within the tolerance, or is not.
    pub fn words(self, within: bool) -> [&'static str; 2] {
        match self {
            Self::LeastLost if within => [" within the tolerance", "loses least powder (ties by loss)"],
            Self::LeastLost => {
                ["", "misses the wanted amount least (ties by loss), and none is within the tolerance"]
            }
            Self::LowestLoss => ["", "has the lowest loss"],
        }
    }

    /// The epoch to ship; none if the arm may perform no epoch's motion.
    pub fn choose(self, amounts: &Amounts, epochs: &[Judged]) -> Option<usize> {
        self.rank(amounts, epochs).first().copied()
    }

    /// Epochs that could be the plan if their motion, once it is rounded to whole counts, brings the wanted amount no longer: all that
    /// are within the tolerance, the best first; or else the best alone.
    pub fn candidates(self, amounts: &Amounts, epochs: &[Judged]) -> Vec<usize> {
        let is_met = |epoch: &usize| amounts.is_met(epochs[*epoch].record.census.target) == Some(true);
        let ranked = self.rank(amounts, epochs);
        let first = ranked.first().copied();
        let within: Vec<usize> = match self {
            Self::LeastLost => ranked.into_iter().filter(is_met).collect(),
            Self::LowestLoss => Vec::new(),
        };
        if within.is_empty() { first.into_iter().collect() } else { within }
    }

    /// The epochs whose motion the arm may perform, the best first.
    fn rank(self, amounts: &Amounts, epochs: &[Judged]) -> Vec<usize> {
        let key = |record: &EpochRecord| match self {
            Self::LeastLost if amounts.is_met(record.census.target) == Some(true) => {
                [0.0, amounts.kg(record.census.lost()), record.loss]
            }
            Self::LeastLost => [1.0, amounts.miss(record.census.target).abs(), record.loss],
            Self::LowestLoss => [record.loss; 3],
        };
        let order = |a: &&Judged, b: &&Judged| {
            let pairs = key(&a.record).into_iter().zip(key(&b.record));
            pairs.fold(Ordering::Equal, |order, (a, b)| order.then(a.total_cmp(&b)))
        };
        let mut able: Vec<&Judged> = epochs.iter().filter(|epoch| epoch.obstacle.is_none()).collect();
        // Stable: the earliest of equals comes first.
        able.sort_by(order);
        able.into_iter().map(|epoch| epoch.record.epoch as usize).collect()
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
    /// Judges the motion of an epoch's skill: the limits that it keeps, walls in the tool's way, and whether the scene's arm can.
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
    let unable = || {
        let label = scene.arm.as_ref()?.kind.label();
        let refusal = arm_motion(scene, map, &quantised).err()?;
        Some(format!("the {label} cannot make the motion: {refusal}"))
    };
    let collision = collision(scene, map.start_pose(), &quantised.controls);
    collision.map(|collision| collision.to_string()).or_else(unable)
}
