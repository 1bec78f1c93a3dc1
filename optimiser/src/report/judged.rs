//! Which epochs the arm may perform, and which of these becomes the plan.

use super::amounts::Amounts;
use super::tries::Try;
use crate::able::obstacle;
use crate::optim::{EpochRecord, World};
use powderline_simulator::{
    rollout::Census,
    scene::{Aim, Scene},
    skill::SkillMap,
};
use serde::Serialize;
use std::cmp::Ordering;

/// A gain that is worth going on for: of what is lost, missing or too much, over the tolerance; of the loss, over the lowest so far.
const WORTH_GOING_ON: f64 = 0.25;
const LOSS_WORTH_GOING_ON: f64 = 0.05;

/// How the plan is chosen among the epochs of the scene itself whose motion the arm may perform.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// Of the epochs within the tolerance the one with the least powder lost, missing or too much; if there are none, the smallest miss. Ties
    /// by loss.
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
            Self::LeastLost if within => {
                [" within the tolerance", "has least powder lost, missing or too much (ties by loss)"]
            }
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

    /// Epochs that could be the plan, the best first, if the motions of those before, once they are rounded to whole counts, bring the wanted
    /// amount no longer, or come to no end: all that are within the tolerance; or else all.
    pub fn candidates(self, amounts: &Amounts, epochs: &[Judged]) -> Vec<usize> {
        let is_met = |epoch: &usize| amounts.is_met(epochs[*epoch].record.census.target) == Some(true);
        let ranked = self.rank(amounts, epochs);
        let within: Vec<usize> = ranked.iter().copied().filter(is_met).collect();
        if within.is_empty() { ranked } else { within }
    }

    /// The last epoch that brought a gain worth going on for: the first within the tolerance; each within it that has by a quarter of the
    /// tolerance less powder lost, missing or too much than all before it; and, once one was within it, each that has by a twentieth less
    /// loss than all before it. None as long as none is within the tolerance.
    pub fn last_gain(self, amounts: &Amounts, epochs: &[Judged]) -> Option<u32> {
        let least = WORTH_GOING_ON * amounts.tolerance?;
        let (mut last, mut least_off, mut lowest) = (None, f64::INFINITY, f64::INFINITY);
        for epoch in epochs.iter().filter(|epoch| epoch.counts()) {
            let record = &epoch.record;
            let off = match amounts.is_met(record.census.target) {
                Some(true) => amounts.off_share(&record.census),
                _ => f64::INFINITY,
            };
            let falls = last.is_some() && record.loss <= (1.0 - LOSS_WORTH_GOING_ON) * lowest;
            lowest = record.loss.min(lowest);
            if off < least_off && off <= least_off - least || falls {
                last = Some(record.epoch);
                least_off = off.min(least_off);
            }
        }
        last
    }

    /// Of motions of the same world the one that stands for them.
    pub fn best<'a>(self, amounts: &Amounts, tries: impl Iterator<Item = &'a Try>) -> Option<&'a Try> {
        let of = |one: &Try| self.key(amounts, &one.census, one.loss);
        tries.min_by(|a, b| ordered(&of(a), &of(b)))
    }

    /// What makes one motion better than another: what is smaller, the first number before the second.
    fn key(self, amounts: &Amounts, census: &Census, loss: f64) -> [f64; 3] {
        match self {
            Self::LeastLost if is_endless(census) => [2.0, 1.0, loss],
            Self::LeastLost if amounts.is_met(census.target) == Some(true) => {
                // To a millionth: sums are rounded.
                [0.0, (amounts.off_share(census) * 1e6).round(), loss]
            }
            Self::LeastLost => [1.0, amounts.miss(census.target).abs(), loss],
            Self::LowestLoss => [loss; 3],
        }
    }

    /// The epochs whose motion the arm may perform, the best first.
    fn rank(self, amounts: &Amounts, epochs: &[Judged]) -> Vec<usize> {
        let of = |judged: &Judged| self.key(amounts, &judged.record.census, judged.record.loss);
        let order = |a: &&Judged, b: &&Judged| ordered(&of(a), &of(b));
        let mut able: Vec<&Judged> = epochs.iter().filter(|epoch| epoch.counts()).collect();
        // Stable: the earliest of equals comes first.
        able.sort_by(order);
        able.into_iter().map(|epoch| epoch.record.epoch as usize).collect()
    }
}

/// Of a motion that came to no end nobody knows where the powder is.
fn is_endless(census: &Census) -> bool {
    *census == Census::default()
}

fn ordered(a: &[f64; 3], b: &[f64; 3]) -> Ordering {
    a.iter().zip(b).fold(Ordering::Equal, |order, (a, b)| order.then(a.total_cmp(b)))
}

/// An epoch, and what keeps the arm from performing its motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Judged {
    /// What was found.
    pub record: EpochRecord,
    /// Why it can be no plan; nothing if it can.
    pub obstacle: Option<String>,
}

impl Amounts {
    /// What is lost, missing or too much, over what is wanted.
    fn off_share(&self, census: &Census) -> f64 {
        self.kg(census.lost()) / self.wanted_kg + self.miss(census.target).abs()
    }
}

impl Judged {
    /// Whether it could be the plan.
    fn counts(&self) -> bool {
        self.obstacle.is_none() && self.record.world == World::Fine
    }

    /// Judges the motion of an epoch's skill: the limits that it keeps, walls in the tool's way, whether the scene's arm can, and whether it
    /// came to an end.
    pub fn new(scene: &Scene, map: &SkillMap, record: EpochRecord) -> Self {
        let endless = || is_endless(&record.census).then(|| "powder leaves the grid".into());
        let obstacle = obstacle(scene, map, &record.theta, record.splines.as_ref()).or_else(endless);
        Self { record, obstacle }
    }
}
