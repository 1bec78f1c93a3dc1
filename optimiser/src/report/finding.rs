//! What a run found: which epoch became the plan, which were passed over and why, what was wanted and what arrives.
//!
//! Decided here, once. The terminal, `metrics.jsonl`, `curves.svg`, the page, `inspect` and `--json` say it, and decide nothing.

use super::{
    advice::{advice, advice_on_finer, advice_on_lost},
    amounts::Amounts,
    judged::{Judged, Rule},
    looks::Seen,
    state::Settings,
    words::hex,
};
use crate::{
    optim::{EpochRecord, Step, Work, World},
    refine::Grid,
};
use powderline_shared::plan::{Mounting, PlanError, PlanHeader, Precision};
use powderline_simulator::{
    rollout::{Census, Evaluation, Places},
    scene::Scene,
    skill::{Theta, ThetaError},
};
use serde::Serialize;

/// What a motion brings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// Mass in the target container at the end, kilogram.
    pub mass_kg: f64,
    /// How far that is off the wanted mass, relative: negative where powder is missing.
    pub miss: f64,
    /// What is on rims, spilled or in flight, kilogram.
    pub lost_kg: f64,
    /// All the powder by where it is, kilogram.
    pub powder_kg: Places<f64>,
    /// The same in particles.
    pub census: Census,
    /// Loss, metres.
    pub loss_m: f64,
}

impl Outcome {
    /// Of particles by where they are.
    pub fn new(amounts: &Amounts, census: Census, loss_m: f64) -> Self {
        Self {
            mass_kg: amounts.kg(census.target),
            miss: amounts.miss(census.target),
            lost_kg: amounts.kg(census.lost()),
            powder_kg: census.map(|particles| amounts.kg(particles)),
            census,
            loss_m,
        }
    }

    /// Of an epoch.
    pub fn of_epoch(amounts: &Amounts, record: &EpochRecord) -> Self {
        Self::new(amounts, record.census, record.loss)
    }

    /// Of a simulated motion.
    pub fn of_evaluation(amounts: &Amounts, found: &Evaluation) -> Self {
        Self::new(amounts, found.census, found.loss)
    }

    /// Of a plan on the scene's own cells, as it says itself.
    pub fn of_plan(amounts: &Amounts, header: &PlanHeader) -> Self {
        Self::new(amounts, header.predicted.census, header.predicted.loss_m)
    }

    /// Of a plan where the most is known of it: on smaller cells, if it was looked at there. And what is wanted, in the particles of those.
    pub fn finest_of_plan(own: &Amounts, header: &PlanHeader) -> (Amounts, Self) {
        match header.finer {
            None => (*own, Self::of_plan(own, header)),
            Some(finer) => {
                let amounts = own.in_particles_of(finer.particle_mass_kg);
                (amounts, Self::new(&amounts, finer.census, finer.loss_m))
            }
        }
    }
}

/// A plan: the skill that it was made of, and what it brings as shipped (quantised, simulated again).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shipped {
    /// The skill.
    pub theta: Theta,
    /// What arrives, on the scene's own cells.
    pub outcome: Outcome,
    /// The arm that can make it.
    pub arm: Option<Mounting>,
    /// What it brings on smaller cells, if it was looked at there.
    pub finer: Option<OnFiner>,
}

impl Shipped {
    /// What a plan says of itself, and what was seen while it was corrected.
    ///
    /// # Errors
    /// Its theta is none.
    pub fn new(amounts: &Amounts, header: &PlanHeader, looks: &[Seen]) -> Result<Self, PlanError> {
        let theta = Theta::new(header.theta)
            .map_err(|ThetaError { value, .. }| PlanError::ThetaOutOfRange { value })?;
        let outcome = Outcome::of_plan(amounts, header);
        let finer = OnFiner::new(amounts, header, theta, looks);
        Ok(Self { theta, outcome, arm: header.arm, finer })
    }

    /// The skill and what it brought when the search left it, before it was corrected.
    fn as_found(&self) -> (Theta, Outcome) {
        self.finer.map_or((self.theta, self.outcome), |finer| (finer.theta_before, finer.before[0]))
    }

    /// Whether it was made of this epoch. Where that was not rounded, what it brings may be another.
    fn is_of_epoch(&self, record: &EpochRecord) -> bool {
        let (theta, found) = self.as_found();
        let brings = (record.loss.to_bits(), record.census) == (found.loss_m.to_bits(), found.census);
        is_same(theta, record.theta.components()) && (brings || !record.rounded)
    }

    /// Whether it was made of this skill, bit by bit.
    pub fn is_of(&self, theta: [f64; 5]) -> bool {
        is_same(self.theta, theta)
    }
}

/// Bit by bit.
pub(super) fn is_same(theta: Theta, other: [f64; 5]) -> bool {
    theta.components().map(f64::to_bits) == other.map(f64::to_bits)
}

/// A plan on smaller cells than the scene's own.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OnFiner {
    /// Edge of those cells, metres.
    pub cell_m: f64,
    /// What is wanted, in the particles there.
    pub amounts: Amounts,
    /// What the plan brings there.
    pub plan: Outcome,
    /// Whether it was changed for that.
    pub corrected: bool,
    /// Its skill before.
    pub theta_before: Theta,
    /// What that brought: on the scene's own cells, and there.
    pub before: [Outcome; 2],
    /// Motions that were simulated for it: on the scene's own cells, and there.
    pub rollouts: [u32; 2],
    /// Processor time of those, seconds.
    pub cpu_seconds: f64,
}

impl OnFiner {
    /// What a plan says of itself; before that, the first that was seen on each grid.
    fn new(amounts: &Amounts, header: &PlanHeader, theta: Theta, looks: &[Seen]) -> Option<Self> {
        let finer = header.finer?;
        let (there, plan) = Outcome::finest_of_plan(amounts, header);
        let of_grid = |grid| move |seen: &&Seen| seen.grid == grid && seen.obstacle.is_none();
        let first = |grid, of: &Amounts, none: Outcome| {
            let first = looks.iter().find(of_grid(grid));
            first.map_or(none, |seen| Outcome::new(of, seen.census, seen.loss_m))
        };
        let theta_before = looks.first().map_or(theta, |seen| seen.theta);
        Some(Self {
            cell_m: finer.cell_m,
            amounts: there,
            plan,
            corrected: !is_same(theta_before, header.theta),
            theta_before,
            before: [
                first(Grid::Own, amounts, Outcome::of_plan(amounts, header)),
                first(Grid::Finer, &there, plan),
            ],
            rollouts: [Grid::Own, Grid::Finer].map(|grid| looks.iter().filter(of_grid(grid)).count() as u32),
            cpu_seconds: looks.iter().map(|seen| seen.cpu_seconds).sum(),
        })
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
    /// How it searched.
    pub method: &'static str,
    /// What it simulated, all epochs together.
    pub work: Work,
    /// Epochs that were evaluated in the coarse copy of the scene.
    pub coarse_epochs: Vec<u32>,
    /// Epochs that the search was allowed, if it ended before the last of them.
    pub ended_of: Option<u32>,
    /// How many epochs that gain nothing end it.
    pub patience_epochs: u32,
    /// The last epoch that brought a gain worth going on for; none as long as the amount is not met. Of a path, which has the patience for
    /// itself, its first epoch at the earliest, and none before that.
    pub last_gain: Option<u32>,
    /// Whether a path was to be searched, and no epoch was left for it.
    #[serde(skip)]
    pub no_path: bool,
    /// Epochs after which it began anew from another skill.
    pub restarts: Vec<u32>,
    /// Epochs that could be no plan.
    pub passed_over: Vec<PassedOver>,
    /// Epochs that would have come before the plan's, but whose motions, rounded to whole counts, no longer bring the wanted amount.
    pub rounded_out: Vec<u32>,
    /// What epoch 0 brought.
    pub first: Outcome,
    /// How many coefficients of splines are added to the motion of the chosen epoch's skill: 0 where the motion is the skill's own.
    pub coefficients: usize,
    /// What the chosen epoch brought; before its motion was rounded to whole counts, if it was not evaluated so.
    pub best: Option<Outcome>,
    /// What the plan brings on the scene's own cells; nothing before there is one.
    pub plan: Option<Outcome>,
    /// Edge of those, metres.
    pub cell_m: f64,
    /// The plan on smaller cells, by which it is then judged; nothing where it was not looked at there.
    pub finer: Option<OnFiner>,
    /// Why it was not, if it was to be.
    pub unrefined: Option<String>,
    /// The arm that can make the plan's motion, where the scene has one.
    pub arm: Option<Mounting>,
    /// Whether the plan brings the wanted amount within the tolerance, on the smallest cells on which it was looked at; nothing before there
    /// is one, and where as much as can be had is wanted.
    pub met: Option<bool>,
    /// What could help, from what was measured, where it does not, or where much is lost on the way.
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
    /// How it searches.
    pub settings: Settings,
    /// All epochs, in order.
    pub epochs: &'a [Judged],
    /// Epochs that the search was allowed, if it ended before the last of them.
    pub ended_of: Option<u32>,
    /// The plan, once there is one.
    pub shipped: Option<&'a Shipped>,
    /// Why that was not looked at on smaller cells, if it was to be.
    pub unrefined: Option<&'a str>,
}

impl Finding {
    /// What a run has found; nothing before its first epoch.
    pub fn new(run: &RunSoFar<'_>) -> Option<Self> {
        let RunSoFar { scene, seed, precision, settings, epochs, ended_of, shipped, unrefined } = *run;
        let [first, ..] = epochs else { return None };
        let (amounts, rule) = (Amounts::from(scene), Rule::of(scene));
        let epoch = match shipped {
            // The same skill may have been looked at in the coarse world, too.
            Some(shipped) => epochs
                .iter()
                .position(|Judged { record, .. }| record.world == World::Fine && shipped.is_of_epoch(record)),
            None => rule.choose(&amounts, epochs),
        };
        let candidates = rule.candidates(&amounts, epochs);
        let rounded_out = match shipped.and(epoch) {
            Some(shipped) => candidates.into_iter().take_while(|other| *other != shipped).collect(),
            None => Vec::new(),
        };
        let passed_over = epochs.iter().filter_map(|epoch| {
            Some(PassedOver { epoch: epoch.record.epoch, reason: epoch.obstacle.clone()? })
        });
        let restarts = epochs.iter().map(|epoch| &epoch.record).filter(|record| record.step == Step::Restart);
        let coarse = epochs.iter().map(|epoch| &epoch.record).filter(|record| record.world == World::Coarse);
        let mut work = Work::default();
        epochs.iter().for_each(|epoch| work.add(&epoch.record.work));
        let plan = shipped.map(|shipped| shipped.outcome);
        let finer = shipped.and_then(|shipped| shipped.finer);
        let is_met = |amounts: &Amounts, outcome: Outcome| amounts.is_met(outcome.census.target);
        let found_met = shipped.and_then(|shipped| is_met(&amounts, shipped.as_found().1));
        let met = finer.map_or(found_met, |finer| is_met(&finer.amounts, finer.plan));
        let advice = match (met, found_met, shipped) {
            // The search did what it should.
            (Some(false), Some(true), Some(shipped)) => advice_on_finer(scene, shipped.theta),
            (Some(false), ..) => advice(scene, epochs, epoch),
            (Some(true), _, Some(shipped)) => {
                let brings = finer.map_or(shipped.outcome, |finer| finer.plan);
                let ended = (epochs.len(), ended_of.is_some());
                advice_on_lost(scene, shipped.theta, brings.lost_kg, ended).into_iter().collect()
            }
            _ => Vec::new(),
        };
        Some(Self {
            scene: scene.name.clone(),
            scene_digest: hex(&scene.digest()),
            seed,
            precision: precision.name(),
            amounts,
            rule,
            epoch: epoch.map(|epoch| epoch as u32),
            last_epoch: epochs.len() as u32 - 1,
            method: settings.method.name(),
            work,
            coarse_epochs: coarse.map(|record| record.epoch).collect(),
            ended_of,
            patience_epochs: settings.patience_epochs,
            last_gain: rule.last_gain(&amounts, epochs).and_then(|gain| {
                match settings.method.begins_with_a_skill() {
                    // What comes after the skill has its patience, too.
                    true => epochs
                        .iter()
                        .find(|epoch| epoch.record.splines.is_some())
                        .map(|first| gain.max(first.record.epoch)),
                    false => Some(gain),
                }
            }),
            no_path: settings.method.begins_with_a_skill()
                && epochs.iter().all(|epoch| epoch.record.splines.is_none()),
            restarts: restarts.map(|record| record.epoch).collect(),
            passed_over: passed_over.collect(),
            rounded_out: rounded_out.into_iter().map(|epoch| epoch as u32).collect(),
            first: Outcome::of_epoch(&amounts, &first.record),
            coefficients: epoch
                .and_then(|epoch| epochs[epoch].record.splines.as_ref())
                .map_or(0, |added| added.coefficients.len()),
            best: epoch.map(|epoch| Outcome::of_epoch(&amounts, &epochs[epoch].record)),
            plan,
            cell_m: scene.domain.cell_m,
            finer,
            unrefined: unrefined.map(String::from),
            arm: shipped.and_then(|shipped| shipped.arm),
            met,
            advice,
        })
    }

    /// Whether the search may end: the amount is met, and either nothing was gained for as many epochs as the scene has patience,
    /// or the search would begin anew.
    pub fn is_settled(&self) -> bool {
        let Some(last_gain) = self.last_gain else { return false };
        let gained_nothing = self.last_epoch - last_gain >= self.patience_epochs;
        self.patience_epochs > 0 && (gained_nothing || self.leads_nowhere())
    }

    /// Whether the search would begin anew after its last epoch.
    pub(crate) fn leads_nowhere(&self) -> bool {
        self.restarts.last() == Some(&self.last_epoch)
    }

    /// What the plan brings where the most is known of it: on smaller cells, if it was looked at there.
    pub fn finest(&self) -> Option<(&Amounts, &Outcome)> {
        let own = self.plan.as_ref().map(|plan| (&self.amounts, plan));
        self.finer.as_ref().map(|finer| (&finer.amounts, &finer.plan)).or(own)
    }

    /// What the plan brought on the scene's own cells when the search left it.
    pub fn as_found(&self) -> Option<&Outcome> {
        self.finer.as_ref().map(|finer| &finer.before[0]).or(self.plan.as_ref())
    }

    /// Whether the plan is another skill's than that of the epoch which the search left.
    pub fn is_corrected(&self) -> bool {
        self.finer.is_some_and(|finer| finer.corrected)
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
    use powderline_simulator::{scene::Aim, skill::SkillMap};

    fn judged(transported: &[u32], losses: &[f64], blocked: &[u32]) -> Vec<Judged> {
        let epoch = |(epoch, (&transported, &loss))| Judged {
            record: EpochRecord {
                epoch,
                loss,
                census: Census { target: transported, ..Census::default() },
                theta: Theta::clamped([f64::from(epoch) / 10.0; 5]),
                ..EpochRecord::default()
            },
            obstacle: blocked.contains(&epoch).then(|| "the arm is too slow".into()),
        };
        (0..).zip(transported.iter().zip(losses)).map(epoch).collect()
    }

    #[test]
    fn the_plan_loses_least_of_what_is_within_the_tolerance() {
        let amounts = Amounts::from(&Scene::load("bench").unwrap());
        let arrives = [1200, 1190, 1210, 1150, 1205, 1200];
        let mut epochs = judged(&arrives, &[20.0, 21.0, 19.0, 10.0, 12.0, 5.0], &[4]);
        for (epoch, rims, spilled) in [(0, 13, 2), (1, 2, 0), (2, 0, 2), (3, 0, 0), (4, 0, 0), (5, 0, 0)] {
            epochs[epoch].record.census.rims = rims;
            epochs[epoch].record.census.spilled = spilled;
        }
        epochs[5].record.world = World::Coarse;
        // Epochs 1 and 2 have 12 particles lost, missing or too much, 0 has 15; 3 loses nothing but misses, 4 is blocked, 5 was not
        // evaluated in the scene itself.
        assert_eq!(Rule::LeastLost.choose(&amounts, &epochs), Some(2));
    }

    /// Nobody knows where its powder is: it is no plan before one that misses, however wide the tolerance.
    #[test]
    fn a_motion_that_came_to_no_end_comes_last() {
        let mut amounts = Amounts::from(&Scene::load("bench").unwrap());
        amounts.tolerance = Some(1.0);
        let mut epochs = judged(&[0, 300], &[1.0, 9.0], &[]);
        epochs[1].record.census.spilled = 900;
        assert_eq!(Rule::LeastLost.choose(&amounts, &epochs), Some(1));
        let scene = Scene::load("bench").unwrap();
        let map = SkillMap::new(&scene);
        let judged = |record: EpochRecord| Judged::new(&scene, &map, record).obstacle;
        assert_eq!(judged(epochs[1].record.clone()), None);
        assert_eq!(judged(epochs[0].record.clone()).as_deref(), Some("powder leaves the grid"));
    }

    #[test]
    fn the_very_amount_again_is_no_gain() {
        let mut amounts = Amounts::from(&Scene::load("bench").unwrap());
        amounts.tolerance = Some(0.0);
        let epochs = judged(&[1200, 1200, 1200], &[9.0, 9.0, 9.0], &[]);
        assert_eq!(Rule::LeastLost.last_gain(&amounts, &epochs), Some(0));
    }

    #[test]
    fn a_search_is_settled_when_the_amount_is_met_and_nothing_more_is_gained() {
        let scene = Scene::load("bench").unwrap();
        let settled_by = |scene: &Scene, settings: Settings, epochs: &[Judged]| {
            let run = RunSoFar {
                scene,
                seed: 1,
                precision: Precision::F32,
                settings,
                epochs,
                ended_of: None,
                shipped: None,
                unrefined: None,
            };
            Finding::new(&run).unwrap().is_settled()
        };
        let settled = |scene: &Scene, epochs: &[Judged]| settled_by(scene, Settings::default(), epochs);
        let losses = [50.0, 20.0, 21.0, 22.0, 19.0];
        let mut epochs = judged(&[100, 1190, 1191, 900, 1200], &losses, &[]);
        assert_eq!([2, 3, 4].map(|count| settled(&scene, &epochs[..count])), [false, false, true]);
        // Of 24 that the tolerance is, 6 fewer missing or too many are a gain, and 1 is none.
        assert!(
            !settled(&scene, &epochs)
                && settled(&scene, &judged(&[100, 1190, 1191, 1192], &losses[..4], &[]))
        );
        // A twentieth less loss is a gain as well, within the tolerance or not; less than that, and before the amount is met, it is none.
        let falling =
            |third: f64| settled(&scene, &judged(&[100, 1190, 900, 900], &[50.0, 20.0, third, 22.0], &[]));
        assert_eq!([18.9, 19.1].map(falling), [false, true]);
        assert!(!settled(&scene, &judged(&[100, 1100, 1110, 900], &losses[..4], &[])), "it is not met");
        assert!(
            !settled(&scene, &judged(&[100, 1200, 1110, 900], &losses[..4], &[1])),
            "it may not be performed"
        );
        epochs[1].record.step = Step::Restart;
        assert!(settled(&scene, &epochs[..2]), "it leads nowhere");
        let patient = Settings { patience_epochs: 0, ..Settings::default() };
        assert!(!settled_by(&scene, patient, &epochs), "it goes on to the last");
        let greedy = scene.with(|spec| spec.objective.aim = Aim::All).unwrap();
        assert!(!settled(&greedy, &epochs), "there is always more");
    }

    #[test]
    fn without_an_epoch_within_the_tolerance_the_plan_is_the_smallest_miss() {
        let scene =
            Scene::load("bench").unwrap().with(|spec| spec.objective.amount.tolerance = 0.005).unwrap();
        let amounts = Amounts::from(&scene);
        // Epoch 1 hits but is blocked, 3 and 4 miss alike, 2 has the lowest loss.
        let epochs = judged(&[0, 1200, 1150, 1190, 1210, 1100], &[90.0, 15.0, 14.0, 20.0, 18.0, 30.0], &[1]);
        assert_eq!(Rule::of(&scene).choose(&amounts, &epochs), Some(4));
        let greedy = scene.with(|spec| spec.objective.aim = Aim::All).unwrap();
        assert_eq!(Rule::of(&greedy).choose(&amounts, &epochs), Some(2));
        assert_eq!(Rule::LeastLost.choose(&amounts, &judged(&[5], &[1.0], &[0])), None);
        // The earliest of equals.
        assert_eq!(Rule::LeastLost.choose(&amounts, &judged(&[5, 5, 5], &[2.0, 1.0, 1.0], &[])), Some(1));
    }

    #[test]
    fn an_epoch_whose_rounded_motion_misses_makes_room_for_the_next_within_the_tolerance() {
        let scene = Scene::load("bench").unwrap();
        let amounts = Amounts::from(&scene);
        let mut epochs = judged(&[1000, 1195, 1200, 1205, 1197], &[90.0, 15.0, 17.0, 12.0, 16.0], &[3]);
        for (epoch, rims) in [(1, 0), (2, 9), (3, 0), (4, 4)] {
            epochs[epoch].record.census.rims = rims;
        }
        assert_eq!(Rule::LeastLost.candidates(&amounts, &epochs), [1, 4, 2], "3 is blocked, 0 is off");
        assert_eq!(Rule::LeastLost.candidates(&amounts, &epochs[..1]), [0]);
        assert_eq!(Rule::LowestLoss.candidates(&amounts, &epochs)[0], 1);
        // Where none is within, the next best may take the place of one that comes to no end; what came to none already is last.
        let far = |epoch: usize| epochs[epoch].record.clone();
        let mut off: Vec<Judged> =
            [0, 0, 0].map(|epoch| Judged { record: far(epoch), obstacle: None }).into();
        for (epoch, target) in [(0, 0), (1, 2600), (2, 900)] {
            (off[epoch].record.epoch, off[epoch].record.census.target) = (epoch as u32, target);
        }
        assert_eq!(Rule::LeastLost.candidates(&amounts, &off), [2, 1, 0]);
        let finding = |epoch: u32, target: u32| {
            let census = Census { target, ..Census::default() };
            let outcome = Outcome::new(&amounts, census, 15.1);
            let shipped = Shipped {
                theta: Theta::clamped([f64::from(epoch) / 10.0; 5]),
                outcome,
                arm: None,
                finer: None,
            };
            let run = RunSoFar {
                scene: &scene,
                seed: 1,
                precision: Precision::F32,
                settings: Settings::default(),
                epochs: &epochs,
                ended_of: None,
                shipped: Some(&shipped),
                unrefined: None,
            };
            Finding::new(&run).unwrap()
        };
        let said = |finding: &Finding| finding.sentences().join(" ");
        assert!(finding(1, 1181).rounded_out.is_empty());
        assert!(!said(&finding(1, 1181)).contains("came before it"));
        let second = finding(2, 1200);
        assert_eq!(second.rounded_out, [1, 4]);
        let words =
            "Epochs 1 and 4 came before it, but their motions, rounded to whole counts, miss the tolerance.";
        assert!(said(&second).contains(words), "{}", said(&second));
        // None stays within: that is said, and no other epoch is spoken of.
        let none = finding(4, 1170);
        assert!(
            said(&none).contains("misses the wanted amount least once its motion is rounded"),
            "{}",
            said(&none)
        );
        assert!(!said(&none).contains("came before it"));
    }

    #[test]
    fn what_was_shipped_is_found_again_whatever_came_after() {
        let scene = Scene::load("bench").unwrap();
        let amounts = Amounts::from(&scene);
        let epochs = judged(&[0, 1100, 1200], &[90.0, 15.0, 14.0], &[2]);
        let census = Census { target: 1101, spilled: 7, ..Census::default() };
        let shipped = Shipped {
            theta: Theta::clamped([0.1; 5]),
            outcome: Outcome::new(&amounts, census, 15.1),
            arm: None,
            finer: None,
        };
        let mut run = RunSoFar {
            scene: &scene,
            seed: 1,
            precision: Precision::F32,
            settings: Settings::default(),
            epochs: &epochs,
            ended_of: None,
            shipped: Some(&shipped),
            unrefined: None,
        };
        let finding = Finding::new(&run).unwrap();
        assert_eq!((finding.epoch, finding.met), (Some(1), Some(false)));
        assert!(finding.is_shipped(1) && !finding.is_shipped(2));
        assert_eq!(finding.obstacle(2), Some("the arm is too slow"));
        assert_eq!((finding.plan.unwrap().census.target, finding.best.unwrap().census.target), (1101, 1100));
        run.shipped = None;
        let before = Finding::new(&run).unwrap();
        assert_eq!((before.epoch, before.met, before.is_shipped(1)), (Some(1), None, false));
        run.epochs = &[];
        assert_eq!(Finding::new(&run), None);
    }
}
