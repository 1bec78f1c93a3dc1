//! What a run found: which epoch became the plan, which were passed over and why, what was wanted and what arrives.
//!
//! Decided here, once. The terminal, `metrics.jsonl`, `curves.svg`, the page, `inspect` and `--json` say it, and decide nothing.

use super::{
    advice::advice,
    amounts::Amounts,
    judged::{Judged, Rule},
    words::{hex, precision_name},
};
use crate::optim::EpochRecord;
use powderline_shared::plan::{PlanHeader, Precision};
use powderline_simulator::{rollout::Evaluation, scene::Scene, skill::Theta};
use serde::Serialize;

/// What a motion brings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// Particles in the target container at the end.
    pub particles: u32,
    /// Their mass, kilogram.
    pub mass_kg: f64,
    /// How far that is off the wanted mass, relative: negative where powder is missing.
    pub miss: f64,
    /// Particles in no container and not on the tool.
    pub spilled_particles: u32,
    /// Their mass, kilogram.
    pub spilled_kg: f64,
    /// Loss, metres.
    pub loss_m: f64,
}

impl Outcome {
    /// Of the particles that arrive and spill.
    pub fn new(amounts: &Amounts, transported: u32, spilled: u32, loss_m: f64) -> Self {
        Self {
            particles: transported,
            mass_kg: amounts.kg(transported),
            miss: amounts.miss(transported),
            spilled_particles: spilled,
            spilled_kg: amounts.kg(spilled),
            loss_m,
        }
    }

    /// Of an epoch.
    pub fn of_epoch(amounts: &Amounts, record: &EpochRecord) -> Self {
        Self::new(amounts, record.transported, record.spilled, record.loss)
    }

    /// Of a simulated motion.
    pub fn of_evaluation(amounts: &Amounts, found: &Evaluation) -> Self {
        Self::new(amounts, found.transported, found.spilled, found.loss)
    }

    /// Of a plan, as it says itself.
    pub fn of_plan(amounts: &Amounts, header: &PlanHeader) -> Self {
        let PlanHeader { predicted_transported_count, predicted_spilled_count, predicted_loss, .. } = header;
        Self::new(amounts, *predicted_transported_count, *predicted_spilled_count, *predicted_loss)
    }
}

/// A plan: the skill that it was made of, and what it brings as shipped (quantised, simulated again).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shipped {
    /// The skill.
    pub theta: Theta,
    /// What arrives.
    pub outcome: Outcome,
}

impl Shipped {
    /// What a plan says of itself.
    pub fn new(amounts: &Amounts, header: &PlanHeader) -> Self {
        Self { theta: header.theta, outcome: Outcome::of_plan(amounts, header) }
    }

    /// Whether it was made of this skill, bit by bit.
    pub fn is_of(&self, theta: &Theta) -> bool {
        self.theta.map(f64::to_bits) == theta.map(f64::to_bits)
    }
}

/// An epoch that could be no plan.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PassedOver {
    /// Its number.
    pub epoch: u32,
    /// Why.
    pub reason: String,
}

/// What a run found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// The scene's name.
    pub scene: String,
    /// Its digest, hexadecimal.
    pub scene_digest: String,
    /// Seed of packing and first skill.
    pub seed: u64,
    /// `f32` or `f64`.
    pub precision: &'static str,
    /// What is wanted.
    pub amounts: Amounts,
    /// How the plan is chosen.
    pub rule: Rule,
    /// The epoch whose skill is the plan; before there is a plan, the one that would be.
    pub epoch: Option<u32>,
    /// Last epoch that was evaluated.
    pub last_epoch: u32,
    /// Epochs in which only depth, angle and lift moved.
    pub curriculum_epochs: u32,
    /// Epochs that could be no plan.
    pub passed_over: Vec<PassedOver>,
    /// What the first skill brought.
    pub first: Outcome,
    /// What the chosen epoch brought, before its motion was quantised.
    pub best: Option<Outcome>,
    /// What the plan brings; nothing before there is one.
    pub plan: Option<Outcome>,
    /// Whether the plan brings the wanted amount within the tolerance; nothing before there is one, and where as much as can be had is
    /// wanted.
    pub met: Option<bool>,
    /// What could help, from what was measured, where it does not.
    pub advice: Vec<String>,
}

/// A run as far as it has got.
#[derive(Clone, Copy, Debug)]
pub struct RunSoFar<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Seed of packing and first skill.
    pub seed: u64,
    /// Precision of the simulation.
    pub precision: Precision,
    /// All epochs, in order.
    pub epochs: &'a [Judged],
    /// The plan, once there is one.
    pub shipped: Option<&'a Shipped>,
}

impl Finding {
    /// What a run has found; nothing before its first epoch.
    pub fn new(run: &RunSoFar<'_>) -> Option<Self> {
        let RunSoFar { scene, seed, precision, epochs, shipped } = *run;
        let [first, ..] = epochs else { return None };
        let (amounts, rule) = (Amounts::from(scene), Rule::of(scene));
        let epoch = match shipped {
            Some(shipped) => epochs.iter().position(|epoch| shipped.is_of(&epoch.record.theta)),
            None => rule.choose(&amounts, epochs),
        };
        let passed_over = epochs.iter().filter_map(|epoch| {
            Some(PassedOver { epoch: epoch.record.epoch, reason: epoch.obstacle.clone()? })
        });
        let plan = shipped.map(|shipped| shipped.outcome);
        let met = plan.and_then(|plan| amounts.is_met(plan.particles));
        Some(Self {
            scene: scene.name.clone(),
            scene_digest: hex(&scene.digest()),
            seed,
            precision: precision_name(precision),
            amounts,
            rule,
            epoch: epoch.map(|epoch| epoch as u32),
            last_epoch: epochs.len() as u32 - 1,
            curriculum_epochs: scene.optimiser.curriculum_epochs,
            passed_over: passed_over.collect(),
            first: Outcome::of_epoch(&amounts, &first.record),
            best: epoch.map(|epoch| Outcome::of_epoch(&amounts, &epochs[epoch].record)),
            plan,
            met,
            advice: if met == Some(false) { advice(scene, epochs, epoch) } else { Vec::new() },
        })
    }

    /// Whether an epoch is the plan's.
    pub fn is_shipped(&self, epoch: u32) -> bool {
        self.plan.is_some() && self.epoch == Some(epoch)
    }

    /// Why an epoch could be no plan.
    pub fn obstacle(&self, epoch: u32) -> Option<&str> {
        self.passed_over.iter().find(|passed| passed.epoch == epoch).map(|passed| passed.reason.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_simulator::scene::Aim;

    fn judged(transported: &[u32], losses: &[f64], blocked: &[u32]) -> Vec<Judged> {
        let epoch = |(epoch, (&transported, &loss))| Judged {
            record: EpochRecord {
                epoch,
                loss,
                transported,
                theta: [f64::from(epoch) / 10.0; 5],
                ..EpochRecord::default()
            },
            obstacle: blocked.contains(&epoch).then(|| "the arm is too slow".into()),
        };
        (0..).zip(transported.iter().zip(losses)).map(epoch).collect()
    }

    #[test]
    fn the_plan_is_the_smallest_miss_that_the_arm_may_perform() {
        let mut scene = Scene::load("bench").unwrap();
        let amounts = Amounts::from(&scene);
        // Epoch 1 hits but is blocked, 3 and 4 miss alike, 2 has the lowest loss.
        let epochs = judged(&[0, 1200, 1150, 1190, 1210, 1100], &[90.0, 15.0, 14.0, 20.0, 18.0, 30.0], &[1]);
        assert_eq!(Rule::of(&scene).choose(&amounts, &epochs), Some(4));
        scene.objective.aim = Aim::All;
        assert_eq!(Rule::of(&scene).choose(&amounts, &epochs), Some(2));
        assert_eq!(Rule::SmallestMiss.choose(&amounts, &judged(&[5], &[1.0], &[0])), None);
        // The earliest of equals.
        assert_eq!(Rule::SmallestMiss.choose(&amounts, &judged(&[5, 5, 5], &[2.0, 1.0, 1.0], &[])), Some(1));
    }

    #[test]
    fn what_was_shipped_is_found_again_whatever_came_after() {
        let scene = Scene::load("bench").unwrap();
        let amounts = Amounts::from(&scene);
        let epochs = judged(&[0, 1100, 1200], &[90.0, 15.0, 14.0], &[2]);
        let shipped = Shipped { theta: [0.1; 5], outcome: Outcome::new(&amounts, 1101, 7, 15.1) };
        let mut run = RunSoFar {
            scene: &scene,
            seed: 1,
            precision: Precision::F32,
            epochs: &epochs,
            shipped: Some(&shipped),
        };
        let finding = Finding::new(&run).unwrap();
        assert_eq!((finding.epoch, finding.met), (Some(1), Some(false)));
        assert!(finding.is_shipped(1) && !finding.is_shipped(2));
        assert_eq!(finding.obstacle(2), Some("the arm is too slow"));
        assert_eq!((finding.plan.unwrap().particles, finding.best.unwrap().particles), (1101, 1100));
        run.shipped = None;
        let before = Finding::new(&run).unwrap();
        assert_eq!((before.epoch, before.met, before.is_shipped(1)), (Some(1), None, false));
        run.epochs = &[];
        assert_eq!(Finding::new(&run), None);
    }
}
