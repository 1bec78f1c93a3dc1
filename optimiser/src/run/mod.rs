//! A run: a search for a motion in a folder that it can be gone on with from, to the same bits, and the plan that comes of it.
//!
//! ```text
//! Search (optim) -- trials --> Worlds -- what came of them --> Search, state, epochs --> Finding --> plan
//! plan -- skills --> Grids -- what they bring on smaller cells --> refine --> plan, corrected
//! ```
//!
//! The program `optimise` and the Python package drive a [`Run`] and say how it goes; a program of one's own does likewise.

mod grids;
mod worlds;

pub use grids::{Grids, KeepFn};
pub use worlds::{Simulators, Worlds};

use crate::{
    failure::Failure,
    optim::{Epoch, EpochRecord, Found, Problem, Search, Trial, Work, World},
    refine::Grid,
    report::{
        amounts::Amounts,
        curves::Curves,
        finding::{Finding, Outcome},
        folder::{CURVES, METRICS, PLAN, RunFolder, SCENE, STATE, TRIES},
        judged::Rule,
        looks::Seen,
        plan::{PlanParts, on_finer},
        record::RunRecord,
        state::{Evaluated, RunState, Settings},
        summary::cells,
        tries::Try,
    },
};
use powderline_shared::plan::{Finer, Mounting, Precision};
use powderline_simulator::{
    arm::arm_motion,
    rollout::{Evaluation, Places, RolloutError},
    scene::Scene,
    skill::{QuantisedControls, SkillMap, Splines, Theta},
};
use serde::Serialize;
use std::{collections::BTreeMap, time::Instant};

/// Most epochs of a run.
pub const MAX_EPOCHS: u32 = 10_000;

/// A run looks at its plan on smaller cells if a rollout there has no more substeps of particles than this: some ten minutes of one
/// processor.
const MOST_PARTICLE_SUBSTEPS: u64 = 5_000_000_000;

/// Who is told how a run goes, and may end it.
pub trait Watcher {
    /// A piece of work begins; about so many like the epochs of the history follow it.
    fn begin(&self, task: &str, later: u32, history: &[EpochRecord]);

    /// Whether to stop where it can be gone on from.
    fn is_stopped(&self) -> bool;

    /// An epoch is saved: its line of `metrics.jsonl`, what is wanted, the last epoch that is to come and the last that there might be.
    fn epoch(&self, line: &str, amounts: &Amounts, last_and_all: [u32; 2], history: &[EpochRecord]);

    /// Something else that a person would want to know.
    fn say(&self, text: &str);
}

/// A run whose folder is open and locked.
pub struct Run {
    folder: RunFolder,
    record: RunRecord,
    search: Box<dyn Search>,
    /// What epochs' motions bring once they are rounded to whole counts, as far as that was asked.
    rounded: BTreeMap<usize, Evaluation>,
}

/// A skill, what is added to its motion, that motion in whole counts, and what it brings.
struct Performed {
    theta: Theta,
    splines: Option<Splines>,
    quantised: QuantisedControls,
    evaluation: Evaluation,
    finer: Option<Finer>,
}

/// A line of `metrics.jsonl`.
#[derive(Serialize)]
struct Line<'a> {
    #[serde(flatten)]
    record: &'a EpochRecord,
    /// What arrives, kilogram, and how far that is off the wanted mass, relative.
    mass_kg: f64,
    miss: f64,
    /// What is lost, and all the powder by where it is, kilogram.
    lost_kg: f64,
    powder_kg: Places<f64>,
    /// Why the arm may not perform the motion.
    passed_over: Option<&'a str>,
    /// Whether the plan is made of it.
    shipped: bool,
}

impl Run {
    /// A run that begins in a folder.
    ///
    /// # Errors
    /// Not every skill of the scene is a motion, or the folder cannot be written.
    pub fn begin(
        folder: RunFolder,
        scene: Scene,
        (seed, precision): (u64, Precision),
        settings: Settings,
    ) -> Result<Self, Failure> {
        SkillMap::new(&scene).check_all_corners()?;
        let state = RunState::new(scene.digest(), seed, precision, settings);
        folder.replace(SCENE, scene.to_toml().as_bytes())?;
        // A scene without a state would be in the way of a second attempt, and nothing to resume from either.
        folder.replace(STATE, &state.to_bytes()).inspect_err(|_| folder.discard(SCENE))?;
        Self::of(folder, RunRecord::new(scene, state))
    }

    /// The run in a folder, to be gone on with; with so many epochs in all, if it has fewer.
    ///
    /// # Errors
    /// There is none, or it cannot be gone on with.
    pub fn resume(folder: RunFolder, mut record: RunRecord, epochs: Option<u32>) -> Result<Self, Failure> {
        if let Some(epochs) = epochs {
            prolong(&mut record, epochs)?;
        }
        record.map.check_all_corners()?;
        let run = Self::of(folder, record)?;
        // The state leads: a line too many or too few, from a run that was ended between two writes, is put right.
        run.write_metrics()?;
        let tries: String = run.record.state.tries().map(json_line).collect();
        run.folder.replace(TRIES, tries.as_bytes())?;
        run.save()?;
        if let Some(finding) = run.record.finding() {
            run.write_curves(&finding)?;
        }
        Ok(run)
    }

    /// With the search made again from what it was told.
    fn of(folder: RunFolder, record: RunRecord) -> Result<Self, Failure> {
        let RunRecord { scene, state, .. } = &record;
        let mut search = state.settings.method.search(&Problem::new(scene, state.seed));
        let nonsense = || {
            let file = folder.file(STATE);
            Failure::Input(format!(
                "{} cannot be resumed from: this version of the search would have gone elsewhere; start a new run",
                file.display()
            ))
        };
        for (number, epoch) in state.epochs.iter().enumerate() {
            let mut ended = None;
            for round in &epoch.rounds {
                let trials = search.ask(state.is_last(number));
                if trials.len() != round.len()
                    || !round.iter().zip(&trials).all(|(tried, trial)| tried.is_of(trial))
                {
                    return Err(nonsense());
                }
                let found: Vec<_> = round.iter().map(Try::found).collect();
                ended = search.tell(&found).map_err(|_| nonsense())?;
            }
            let EpochRecord { work, seconds, .. } = epoch.record;
            let ended = ended.map(|ended| standing(scene, ended, &epoch.rounds));
            let again = ended.and_then(|ended| EpochRecord::new(number as u32, &ended, work, seconds));
            if again.as_ref() != Some(&epoch.record) {
                return Err(nonsense());
            }
        }
        Ok(Self { folder, record, search, rounded: BTreeMap::new() })
    }

    /// All that it knows.
    pub fn record(&self) -> &RunRecord {
        &self.record
    }

    /// Where it is.
    pub fn folder(&self) -> &RunFolder {
        &self.folder
    }

    /// What it has found so far.
    ///
    /// # Errors
    /// Nothing yet.
    pub fn finding(&self) -> Result<Finding, Failure> {
        self.record.finding().ok_or_else(|| Failure::Failed("the run has no epoch yet".into()))
    }

    /// Evaluates the epochs that are left, then writes the plan: of a motion that brings the wanted amount also in whole counts, if one is
    /// found before the last epoch. At the end it is corrected by what it brings on smaller cells, if the settings want that and it can be
    /// had; who ends the run there has the plan that the search left.
    ///
    /// # Errors
    /// One sentence; everything evaluated before is saved.
    pub fn complete(&mut self, worlds: &mut Worlds<'_>, watcher: &dyn Watcher) -> Result<(), Failure> {
        loop {
            while !self.record.state.is_done() {
                self.epoch(worlds, watcher)?;
            }
            let performed = self.performed(worlds, watcher)?;
            let is_met = Amounts::from(&self.record.scene).is_met(performed.evaluation.census.target);
            if !self.record.state.is_settled() || is_met == Some(true) {
                self.write_plan(&performed)?;
                if let Some(corrected) = self.refined(&performed, worlds, watcher)? {
                    self.write_plan(&corrected)?;
                }
                return self.finish();
            }
            watcher
                .say("  rounded to whole counts, no motion stays within the tolerance: the search goes on");
            self.record.state.settled = false;
        }
    }

    /// Evaluates epochs until that was enough, or until the last, and makes no plan.
    ///
    /// # Errors
    /// One sentence; everything evaluated before is saved.
    pub fn search_until(
        &mut self,
        is_enough: impl Fn(&RunState) -> bool,
        worlds: &mut Worlds<'_>,
        watcher: &dyn Watcher,
    ) -> Result<(), Failure> {
        while !self.record.state.is_done() && !is_enough(&self.record.state) {
            self.epoch(worlds, watcher)?;
        }
        Ok(())
    }

    /// One epoch.
    fn epoch(&mut self, worlds: &mut Worlds<'_>, watcher: &dyn Watcher) -> Result<(), Failure> {
        let state = &self.record.state;
        let (number, epochs) = (state.epochs.len(), state.settings.epochs);
        let (is_last, history) = (state.is_last(number), state.history());
        let (mut rounds, mut work, begun): (Vec<Vec<Try>>, _, _) =
            (Vec::new(), Work::default(), Instant::now());
        let ended = loop {
            let trials = self.search.ask(is_last);
            if let Some(words) = turn(&history, &trials).filter(|_| rounds.is_empty()) {
                watcher.say(words);
            }
            // A search that others end does not know how many epochs it has.
            match epochs {
                MAX_EPOCHS => watcher.begin(&format!("epoch {number}"), 0, &history),
                _ => watcher.begin(&format!("epoch {number}/{epochs}"), epochs - number as u32, &history),
            }
            if watcher.is_stopped() {
                return Err(RolloutError::Stopped.into());
            }
            let tried = worlds.evaluate(number as u32, &trials)?;
            let found: Vec<Found> = tried.iter().map(Try::found).collect();
            let failed = |error| Failure::Failed(format!("epoch {number}: {error}"));
            let ended = self.search.tell(&found).map_err(failed)?;
            tried.iter().for_each(|one| work.add(&one.work()));
            rounds.push(tried);
            if let Some(ended) = ended {
                break ended;
            }
        };
        let seconds = (begun.elapsed().as_secs_f64() * 1e3).round() / 1e3;
        let ended = standing(&self.record.scene, ended, &rounds);
        let record = EpochRecord::new(number as u32, &ended, work, seconds)
            .ok_or_else(|| Failure::Failed(format!("epoch {number} ended with no skill")))?;
        self.save_epoch(Evaluated { record, rounds }, watcher)
    }

    fn save_epoch(&mut self, epoch: Evaluated, watcher: &dyn Watcher) -> Result<(), Failure> {
        let record = epoch.record.clone();
        let tries: String = epoch.rounds.iter().flatten().map(json_line).collect();
        self.record.push(epoch);
        let finding = self.finding()?;
        let state = &mut self.record.state;
        state.settled |= finding.is_settled() && !state.is_done();
        let all = state.settings.epochs;
        let last = if state.is_done() { record.epoch } else { all };
        let line = self.line(&finding, &record);
        self.folder.append(TRIES, tries.as_bytes())?;
        self.folder.append(METRICS, line.as_bytes())?;
        self.save()?;
        self.write_curves(&finding)?;
        watcher.epoch(&line, &finding.amounts, [last, all], &self.record.state.history());
        Ok(())
    }

    fn save(&self) -> Result<(), Failure> {
        Ok(self.folder.replace(STATE, &self.record.state.to_bytes())?)
    }

    fn line(&self, finding: &Finding, record: &EpochRecord) -> String {
        let outcome = Outcome::of_epoch(&finding.amounts, record);
        json_line(&Line {
            record,
            mass_kg: outcome.mass_kg,
            miss: outcome.miss,
            lost_kg: outcome.lost_kg,
            powder_kg: outcome.powder_kg,
            passed_over: finding.obstacle(record.epoch),
            shipped: finding.is_shipped(record.epoch),
        })
    }

    fn write_metrics(&self) -> Result<(), Failure> {
        let lines: String = self.record.finding().map_or(String::new(), |finding| {
            self.record.epochs.iter().map(|epoch| self.line(&finding, &epoch.record)).collect()
        });
        Ok(self.folder.replace(METRICS, lines.as_bytes())?)
    }

    fn write_curves(&self, finding: &Finding) -> Result<(), Failure> {
        let RunRecord { scene, map, state, .. } = &self.record;
        let headline = finding.headline();
        // What the plan brings on the scene's own cells as well does not go into a line of the picture.
        let below = headline.split_once("; ").map_or(headline.as_str(), |(first, _)| first);
        let curves = Curves {
            title: [&format!("{}, seed {}", scene.name, state.seed), below],
            history: &state.history(),
            // A search that others end does not know how many epochs it has.
            epochs: if state.settings.epochs == MAX_EPOCHS {
                finding.last_epoch
            } else {
                state.settings.epochs
            },
            shipped: finding.epoch,
            plan: finding.as_found(),
            corrected: finding.is_corrected(),
            passed_over: &finding.passed_over.iter().map(|passed| passed.epoch).collect::<Vec<_>>(),
            map,
            amounts: &finding.amounts,
        };
        let svg = curves.to_svg().map_err(|error| Failure::Failed(error.to_string()))?;
        Ok(self.folder.replace(CURVES, svg.as_bytes())?)
    }

    /// Writes a skill's motion, and what it brings as it will be performed.
    fn write_plan(&self, performed: &Performed) -> Result<(), Failure> {
        let Performed { theta, splines, quantised, evaluation, finer } = performed;
        let RunRecord { scene, map, state, .. } = &self.record;
        let arm = arm_motion(scene, map, quantised).map_err(|refusal| {
            Failure::Failed(format!("the arm cannot make the plan's motion: {refusal}"))
        })?;
        let parts = PlanParts {
            scene,
            map,
            seed: state.seed,
            precision: state.precision,
            theta,
            path_coefficients: splines.as_ref().map_or(0, |added| added.coefficients.len()),
            quantised,
            evaluation,
            finer: *finer,
            arm: arm.as_ref().map(|arm| Mounting::from(&arm.model)),
        };
        let plan = parts.to_bytes().map_err(unfit)?;
        Ok(self.folder.replace(PLAN, &plan)?)
    }

    /// The plan in the folder is what the run came to.
    fn finish(&mut self) -> Result<(), Failure> {
        let plan = self.folder.read(PLAN)?;
        self.record.ship(&plan).map_err(unfit)?;
        self.record.state.finished = true;
        self.save()?;
        self.write_metrics()?;
        self.write_curves(&self.finding()?)
    }

    /// What the search's plan is corrected to by what it brings on smaller cells; nothing where it is not looked at there.
    fn refined(
        &mut self,
        found: &Performed,
        worlds: &mut Worlds<'_>,
        watcher: &dyn Watcher,
    ) -> Result<Option<Performed>, Failure> {
        let state = &mut self.record.state;
        state.unrefined = None;
        let finer = match refinable(&self.record.scene, state.settings) {
            Ok(None) => return Ok(None),
            Ok(Some(finer)) => finer,
            Err(why) => return Ok(self.unrefined(why, watcher)),
        };
        // Simulated already, or taken from what was kept.
        let own = Seen::new(Grid::Own, &found.theta, &found.evaluation, 0.0);
        if state.looks.first().is_none_or(|first| !first.is_of(Grid::Own, &found.theta)) {
            state.looks = vec![own];
        }
        watcher.say(&format!(
            "  the plan on {}, and corrected by what it brings there; who stops now has it as the search left it:",
            cells(finer.domain.cell_m)
        ));
        let scenes = [self.record.scene.clone(), finer.clone()];
        let mut grids = Grids::new(scenes, found.splines.clone(), state.looks.clone(), worlds.leave());
        let mut is_kept = true;
        let corrected = grids.corrected(&found.theta, watcher, &mut |seen| {
            self.record.state.looks = seen.to_vec();
            self.save().inspect_err(|_| is_kept = false)
        });
        let corrected = match corrected {
            // The search's plan is there, whatever this comes to. What cannot be kept now may be another time.
            Err(error @ (Failure::Input(_) | Failure::Failed(_))) if is_kept => {
                return Ok(self.unrefined(error.to_string(), watcher));
            }
            other => other.map_err(|error| error.with_remark("the plan that the search left is written"))?,
        };
        let (own, there) = (&corrected.own[1], corrected.best());
        let controls = self.record.map.motion(&own.theta, found.splines.as_ref())?;
        Ok(Some(Performed {
            theta: own.theta,
            splines: found.splines.clone(),
            quantised: QuantisedControls::new(&controls)?,
            evaluation: own.evaluation,
            finer: Some(on_finer(&finer, &there.evaluation)),
        }))
    }

    /// Nobody looks at the plan on smaller cells.
    fn unrefined(&mut self, why: String, watcher: &dyn Watcher) -> Option<Performed> {
        watcher.say(&format!("  the plan is not looked at on smaller cells: {why}"));
        self.record.state.unrefined = Some(why);
        self.record.state.looks.clear();
        None
    }

    /// The best skill whose motion still brings the wanted amount when it is rounded to whole counts; if none does, the one that then
    /// misses it least.
    fn performed(&mut self, worlds: &mut Worlds<'_>, watcher: &dyn Watcher) -> Result<Performed, Failure> {
        let Finding { rule, amounts, passed_over, .. } = self.finding()?;
        let mut nearest: Option<Performed> = None;
        for epoch in rule.candidates(&amounts, &self.record.epochs) {
            let record = &self.record.epochs[epoch].record;
            let (theta, known) = (record.theta, record.rounded.then(|| record.evaluation()));
            let controls = self.record.map.motion(&theta, record.splines.as_ref())?;
            let quantised = QuantisedControls::new(&controls)?;
            let evaluation = match known.or(self.rounded.get(&epoch).copied()) {
                Some(found) => found,
                None => match rehearsed(&quantised, worlds, watcher)? {
                    Some(found) => found,
                    // Rounded, it comes to no end: another one may.
                    None => continue,
                },
            };
            self.rounded.insert(epoch, evaluation);
            let miss = |found: &Evaluation| amounts.miss(found.census.target).abs();
            let is_nearer = nearest.as_ref().is_none_or(|other| miss(&evaluation) < miss(&other.evaluation));
            let is_met = amounts.is_met(evaluation.census.target) == Some(true);
            if is_met || is_nearer {
                let splines = record.splines.clone();
                nearest = Some(Performed { theta, splines, quantised, evaluation, finer: None });
            }
            // Where none is within the tolerance, none that comes after the best is better.
            if is_met || amounts.is_met(record.census.target) != Some(true) {
                break;
            }
        }
        nearest.ok_or_else(|| {
            let why = passed_over.first().map_or("powder leaves the grid", |passed| &passed.reason);
            Failure::Failed(format!("no evaluated skill is a motion that the arm may perform: {why}"))
        })
    }
}

fn unfit(error: impl std::fmt::Display) -> Failure {
    Failure::Failed(format!("no plan can be made: {error}"))
}

/// The scene on the smaller cells on which a run looks at its plan; none where that is not wanted.
///
/// # Errors
/// Why it does not, although it is.
pub fn refinable(scene: &Scene, settings: Settings) -> Result<Option<Scene>, String> {
    if settings.refine_by == 0 {
        return Ok(None);
    }
    let finer = scene.refined(settings.refine_by).map_err(|error| error.to_string())?;
    let steps = u64::from(finer.time.horizon_steps) * u64::from(finer.time.substeps);
    let substeps = finer.particle_count() as u64 * steps;
    match substeps <= MOST_PARTICLE_SUBSTEPS {
        true => Ok(Some(finer)),
        false => Err(format!(
            "a rollout there would take {substeps:.1e} substeps of particles, and a run spends at most {MOST_PARTICLE_SUBSTEPS:.0e} of \
             them; `optimise refine` takes the time that it takes"
        )),
    }
}

/// What is said where a search turns to another world, or to other motions.
fn turn(history: &[EpochRecord], trials: &[Trial]) -> Option<&'static str> {
    let is_coarse = trials.iter().all(|trial| trial.world == World::Coarse);
    let is_path = trials.iter().all(|trial| trial.splines.is_some());
    if is_path && history.last().is_some_and(|record| record.splines.is_none()) {
        return Some("  near the best skill, by splines that are added to its motion:");
    }
    match (history.last().map_or(World::Fine, |record| record.world), is_coarse) {
        (World::Fine, true) => Some("  in a coarse copy of the scene, to see where to look:"),
        (World::Coarse, false) => Some("  in the scene itself, in whole counts:"),
        _ => None,
    }
}

/// The epoch with the trial that stands for it by what the scene wants, where several could.
fn standing(scene: &Scene, ended: Epoch, rounds: &[Vec<Try>]) -> Epoch {
    let best = Rule::of(scene).best(&Amounts::from(scene), rounds.iter().flatten());
    match best.filter(|_| ended.has_peers) {
        Some(best) => Epoch { trial: best.trial(), evaluation: best.evaluation(), ..ended },
        None => ended,
    }
}

/// What a motion in whole counts brings; none if it comes to no end.
fn rehearsed(
    quantised: &QuantisedControls,
    worlds: &mut Worlds<'_>,
    watcher: &dyn Watcher,
) -> Result<Option<Evaluation>, Failure> {
    if watcher.is_stopped() {
        return Err(RolloutError::Stopped.into());
    }
    watcher.begin("the plan, as shipped", 0, &[]);
    match worlds.rehearse(&quantised.controls) {
        Err(error) if error.is_of_motion() => Ok(None),
        found => Ok(Some(found?)),
    }
}

/// Epochs as given, if there are not too many.
///
/// # Errors
/// There are.
pub fn checked_epochs(epochs: u32) -> Result<u32, Failure> {
    if epochs <= MAX_EPOCHS {
        return Ok(epochs);
    }
    Err(Failure::Input(format!("--epochs is {epochs}, but at most {MAX_EPOCHS} are possible")))
}

/// A line of a file of JSON lines.
fn json_line(record: &impl Serialize) -> String {
    let line = serde_json::to_string(record).expect("a record holds nothing that JSON cannot express");
    line + "\n"
}

fn prolong(record: &mut RunRecord, epochs: u32) -> Result<(), Failure> {
    let state = &mut record.state;
    let now = state.settings.epochs;
    if epochs < now {
        return Err(Failure::Input(format!(
            "--epochs is {epochs}, but the run has {now}; it can only be prolonged"
        )));
    }
    if epochs > now && !state.is_settled() {
        state.extend(epochs);
        // The last epoch is evaluated again, as one that others follow.
        record.epochs.truncate(record.state.epochs.len());
        record.shipped = None;
    } else if !state.finished {
        // Its search may go on yet, if no motion keeps within the tolerance once it is rounded.
        state.settings.epochs = epochs;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optim::Step;
    use powderline_simulator::rollout::Census;

    #[test]
    fn of_peers_the_one_that_brings_what_is_wanted_stands_for_them() {
        let scene = Scene::load("bench").unwrap();
        let wanted = scene.target_count() as u32;
        let tried = |target: u32, loss: f64| {
            let trial = Trial { may_fail: true, ..Trial::of(vec![loss / 100.0; 5]) };
            let evaluation = Evaluation::new(loss, 0, Census { target, ..Census::default() });
            Try::new(0, &trial, &Found { evaluation, gradient: None }, 1.0)
        };
        // The lowest loss misses the tolerance; the other one brings what is wanted.
        let rounds = [vec![tried(wanted - 40, 20.0), tried(wanted, 26.0)]];
        let lowest = &rounds[0][0];
        for (has_peers, loss) in [(true, 26.0), (false, 20.0)] {
            let (trial, evaluation) = (lowest.trial(), lowest.evaluation());
            let ended = Epoch { trial, evaluation, has_peers, step: Step::Update, slopes: None };
            let standing = standing(&scene, ended, &rounds);
            assert!((standing.evaluation.loss - loss).abs() < 1e-12, "{standing:?}");
            assert!((standing.trial.point[0] - loss / 100.0).abs() < 1e-12, "{standing:?}");
        }
    }
}
