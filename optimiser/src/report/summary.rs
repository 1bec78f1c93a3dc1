//! What a run found, in words.

use super::{
    amounts::{Amounts, percent},
    finding::{Finding, Outcome},
    words::{count, parameter},
};
use powderline_shared::plan::SkillParameter;
use powderline_simulator::scene::figures::{about, mass};
use std::fmt::Write;

impl Finding {
    /// What arrives of what was wanted: the sentence that comes first wherever a result is shown.
    pub fn headline(&self) -> String {
        match (&self.plan, &self.finer) {
            (None, _) => "There is no plan yet.".into(),
            (Some(plan), None) => format!("The plan brings {}.", arrival(&self.amounts, plan)),
            (Some(own), Some(finer)) => format!(
                "On {} the plan brings {}; on the scene's own of {} it brings {}.",
                cells(finer.cell_m),
                arrival(&finer.amounts, &finer.plan),
                millimetres(self.cell_m),
                mass(own.mass_kg)
            ),
        }
    }

    /// The sentences after the headline: where the rest is, which epoch it is and why, how the arm reaches, and which could not be.
    pub fn sentences(&self) -> Vec<String> {
        let rest = self.finest().map(|(amounts, outcome)| amounts.rest(&outcome.census));
        let arm = self.arm.map(|arm| format!("The {} {}.", arm.kind.label(), arm.posture));
        let ends =
            rest.into_iter().chain(self.finer_words()).chain([self.choice()]).chain(self.end()).chain(arm);
        ends.chain(self.path_words())
            .chain(self.rounding_words())
            .chain(self.restart_words())
            .chain(self.passed_over_words())
            .collect()
    }

    /// What looking at it on smaller cells came to, or why nobody did.
    fn finer_words(&self) -> Option<String> {
        let Some(finer) = &self.finer else {
            return self
                .unrefined
                .as_ref()
                .map(|why| format!("It was not looked at on smaller cells: {why}."));
        };
        let [own, there] = finer.before;
        let off = finer.amounts.off(there.census.target);
        let before = match finer.corrected {
            true => format!(
                "As the search left it, it brought {} there ({off}) and {}",
                mass(there.mass_kg),
                mass(own.mass_kg)
            ),
            false => "It is as the search left it".to_owned(),
        };
        let [own, there] = finer.rollouts.map(|motions| count(motions.into(), "motion"));
        Some(format!(
            "{before}. Simulated for that: {own} on the scene's own cells, {there} on the smaller ones, {:.0} s of processor time.",
            finer.cpu_seconds
        ))
    }

    /// Whether what the search left brings the wanted amount, on the scene's own cells.
    fn found_met(&self) -> Option<bool> {
        self.as_found().and_then(|found| self.amounts.is_met(found.census.target))
    }

    /// Which epoch it is, by which rule.
    pub fn choice(&self) -> String {
        let Some((epoch, best)) = self.epoch.zip(self.best) else {
            return "No epoch is a motion that the arm may perform.".into();
        };
        let able = if self.passed_over.is_empty() { "" } else { " that the arm may perform" };
        let was_met = self.amounts.is_met(best.census.target) == Some(true);
        let [which, why] = match was_met && self.found_met() == Some(false) {
            true => [
                " within the tolerance",
                "misses the wanted amount least once its motion is rounded to whole counts, and none stays within it",
            ],
            false => self.rule.words(was_met),
        };
        let said = |found: &Outcome| {
            format!("{}, with a loss of {:.3} m", self.amounts.powder(found.census.target), found.loss_m)
        };
        let found = self.as_found().copied().unwrap_or(best);
        let before = match said(&found) != said(&best) {
            true => format!(" before its motion was rounded to whole counts it brought {};", said(&best)),
            false => String::new(),
        };
        format!(
            "Epoch {epoch} of {} is {}: of the epochs{which}{able} it {why}. Its loss is {:.3} m;{before} epoch 0{} had {:.3} m and brought {}.",
            self.last_epoch,
            match self.plan {
                None => "the best so far",
                Some(_) if self.is_corrected() => "what was corrected",
                Some(_) => "the plan",
            },
            found.loss_m,
            if self.coarse_epochs.first() == Some(&0) { ", in the coarse world," } else { "" },
            self.first.loss_m,
            self.amounts.powder(self.first.census.target),
        )
    }

    /// Why the search ended before its last epoch, if it did.
    fn end(&self) -> Option<String> {
        let why = match self.leads_nowhere() {
            true => "the last epoch leads nowhere".to_owned(),
            false => format!("{} gained nothing", count(self.patience_epochs.into(), "further epoch")),
        };
        self.ended_of.map(|epochs| {
            format!("The search ended there, of at most {epochs} epochs: the amount is met, and {why}.")
        })
    }

    /// Whether the motion is more than a skill's.
    fn path_words(&self) -> Option<String> {
        let added = self.coefficients;
        match (added > 0, self.plan.is_some() && self.no_path) {
            (true, _) => Some(format!(
                "The motion is a path near the skill of that epoch: {added} numbers say how it leaves the skill's."
            )),
            (false, true) => Some(
                "No path was searched: all epochs went into the skill that it begins with; more of them, by --resume with a larger \
                 --epochs, go on to one."
                    .into(),
            ),
            (false, false) => None,
        }
    }

    /// Which epochs would have been the plan but for the rounding of their motions.
    fn rounding_words(&self) -> Option<String> {
        if self.found_met() != Some(true) {
            return None;
        }
        let epochs = listed(&self.rounded_out.iter().map(u32::to_string).collect::<Vec<_>>());
        match self.rounded_out.len() {
            0 => None,
            1 => Some(format!(
                "Epoch {epochs} came before it, but its motion, rounded to whole counts, misses the tolerance."
            )),
            _ => Some(format!(
                "Epochs {epochs} came before it, but their motions, rounded to whole counts, miss the tolerance."
            )),
        }
    }

    /// After which epochs the search began anew.
    fn restart_words(&self) -> Option<String> {
        // After the last nothing began.
        let restarts = self.restarts.iter().filter(|epoch| **epoch < self.last_epoch);
        let epochs: Vec<String> = restarts.map(u32::to_string).collect();
        let (epochs, number) = (listed(&epochs), epochs.len());
        match number {
            0 => None,
            1 => Some(format!("Epoch {epochs} led nowhere, so the next began anew from another skill.")),
            _ => Some(format!("Epochs {epochs} led nowhere, so the next ones began anew from other skills.")),
        }
    }

    /// Epochs that could be no plan, those of one reason together.
    pub fn passed_over_words(&self) -> Vec<String> {
        let mut groups: Vec<(&str, Vec<String>)> = Vec::new();
        for passed in &self.passed_over {
            let epoch = passed.epoch.to_string();
            match groups.iter_mut().find(|(reason, _)| *reason == passed.reason) {
                Some((_, epochs)) => epochs.push(epoch),
                None => groups.push((&passed.reason, vec![epoch])),
            }
        }
        let sentence = |(reason, epochs): (&str, Vec<String>)| match epochs.as_slice() {
            [one] => format!("Epoch {one} was passed over: {reason}."),
            all => format!("Epochs {} were passed over: {reason}.", listed(all)),
        };
        groups.into_iter().map(sentence).collect()
    }

    /// The result as paragraphs, what was asked for first, then one line per skill parameter: those at the first epoch and
    /// those of the plan, in physical units.
    pub fn text(&self, skills: [[f64; 5]; 2]) -> String {
        let mut text = String::new();
        // Writing to a string does not fail.
        let _ = self.write_text(&mut text, skills);
        text
    }

    fn write_text(&self, text: &mut String, [first, plan]: [[f64; 5]; 2]) -> std::fmt::Result {
        writeln!(text, "{}", self.headline())?;
        self.sentences().iter().try_for_each(|sentence| writeln!(text, "{sentence}"))?;
        if !self.advice.is_empty() {
            writeln!(text, "\nWhat could help:")?;
            self.advice.iter().try_for_each(|advice| writeln!(text, "- {advice}"))?;
        }
        writeln!(text, "\n{:<24}{:>12}{:>14}", "skill", "at epoch 0", "in the plan")?;
        for which in SkillParameter::ALL {
            let [from, to] = [first, plan].map(|values| parameter(which, values[which.index()]));
            writeln!(text, "{:<24}{from:>12}{to:>14}", which.name())?;
        }
        Ok(())
    }

    /// Why the plan is not what was asked for; nothing where it is.
    pub fn shortfall(&self) -> Option<String> {
        let (amounts, plan) = self.finest().filter(|_| self.met == Some(false))?;
        let there = self.finer.map_or(String::new(), |finer| format!("on {} ", cells(finer.cell_m)));
        Some(format!(
            "{there}the plan brings {} than wanted, and the tolerance is {}",
            match plan.miss {
                miss if miss < 0.0 => format!("{} less", percent(-miss)),
                miss => format!("{} more", percent(miss)),
            },
            amounts.tolerance()
        ))
    }
}

/// Such as `9.584 g (1,198 particles) of the 9.6 g wanted: 0.17 % too little, within the tolerance of 2 %`.
pub(crate) fn arrival(amounts: &Amounts, outcome: &Outcome) -> String {
    let arrives = amounts.powder(outcome.census.target);
    let than = match amounts.is_met(outcome.census.target) {
        None => return format!("{arrives}; as much as can be had was wanted"),
        Some(true) => "within",
        Some(false) => "more than",
    };
    format!(
        "{arrives} of the {} wanted: {}, {than} the tolerance of {}",
        mass(amounts.wanted_kg),
        amounts.off(outcome.census.target),
        amounts.tolerance()
    )
}

/// Such as `cells of 4 mm`.
pub(crate) fn cells(cell_m: f64) -> String {
    format!("cells of {}", millimetres(cell_m))
}

fn millimetres(cell_m: f64) -> String {
    format!("{} mm", about(1e3 * cell_m, 3))
}

/// Such as `1, 2 and 3`.
fn listed(words: &[String]) -> String {
    match words {
        [most @ .., last] if !most.is_empty() => format!("{} and {last}", most.join(", ")),
        few => few.concat(),
    }
}

#[cfg(test)]
mod tests {
    use crate::{
        optim::EpochRecord,
        report::{
            amounts::Amounts,
            finding::{Finding, OnFiner, Outcome, Shipped},
            judged::Judged,
            record::RunRecord,
            state::{RunState, Settings},
        },
    };
    use powderline_shared::plan::Precision;
    use powderline_simulator::{rollout::Census, scene::Scene, skill::Theta};

    fn found(arrives: [u32; 3], blocked: Option<&str>, planned: u32) -> (Finding, RunRecord) {
        let scene = Scene::load("bench").unwrap();
        let state = RunState::new(scene.digest(), 1, Precision::F32, Settings::default());
        let mut run = RunRecord::new(scene, state);
        run.epochs = (0..)
            .zip(arrives)
            .zip([0.0, 1.0, -1.0])
            .map(|((epoch, transported), component)| Judged {
                record: EpochRecord {
                    epoch,
                    loss: 100.0 - f64::from(epoch),
                    census: Census { target: transported, ..Census::default() },
                    theta: Theta::clamped([component; 5]),
                    ..EpochRecord::default()
                },
                obstacle: blocked.filter(|_| epoch != 1).map(str::to_owned),
            })
            .collect();
        let amounts = (&run.scene).into();
        let census = Census { target: planned, spilled: 8, source: 7, ..Census::default() };
        run.shipped = Some(Shipped {
            theta: Theta::clamped([1.0; 5]),
            outcome: Outcome::new(&amounts, census, 99.1),
            arm: None,
            finer: None,
        });
        (run.finding().unwrap(), run)
    }

    #[test]
    fn what_was_asked_for_is_said_first() {
        let (finding, run) = found([100, 1190, 1000], None, 1198);
        let text = finding.text(run.skills());
        assert!(
            text.starts_with(
                "The plan brings 9.584 g (1,198 particles) of the 9.6 g wanted: 0.17 % too little, within the tolerance of 2 %.\n\
                 64 mg are lost, all spilled; 56 mg stay in the source.\n\
                 Epoch 1 of 2 is the plan: of the epochs within the tolerance it has least powder lost, missing or too much (ties by loss). Its loss is \
                 99.100 m; before its motion was rounded to whole counts it brought 9.52 g (1,190 particles), with a loss of \
                 99.000 m; epoch 0 had 100.000 m and brought 800 mg (100 particles).\n"
            ),
            "{text}"
        );
        assert!(text.contains("scooping depth               11.0 mm       20.0 mm\n"), "{text}");
        assert!(!text.contains("help") && finding.shortfall().is_none(), "{text}");
    }

    /// Of a run that is not finished nothing reads as if there were a plan, or another search to come.
    #[test]
    fn as_long_as_there_is_no_plan_none_is_said_to_be_one() {
        let (_, mut run) = found([100, 1190, 1000], None, 1198);
        run.shipped = None;
        run.epochs[2].record.step = crate::optim::Step::Restart;
        let finding = run.finding().unwrap();
        let text = finding.text(run.skills());
        assert!(
            text.starts_with("There is no plan yet.\nEpoch 1 of 2 is the best so far: of the epochs"),
            "{text}"
        );
        assert!(!text.contains("is the plan") && !text.contains("began anew"), "{text}");
        run.epochs[1].record.step = crate::optim::Step::Restart;
        let text = run.finding().unwrap().text(run.skills());
        assert!(
            text.contains("\nEpoch 1 led nowhere, so the next began anew from another skill.\n"),
            "{text}"
        );
        // One that ends where it would begin anew does not say that later epochs gained nothing.
        let ended = crate::report::finding::Finding { ended_of: Some(16), ..finding };
        let text = ended.text(run.skills());
        assert!(
            text.contains("of at most 16 epochs: the amount is met, and the last epoch leads nowhere.\n"),
            "{text}"
        );
    }

    #[test]
    fn a_miss_reads_like_one_and_says_what_could_help() {
        let (finding, run) = found([1199, 1100, 1201], Some("the tool's handle would pass through it"), 1100);
        let text = finding.text(run.skills());
        assert!(
            text.contains("of the 9.6 g wanted: 8.3 % too little, more than the tolerance of 2 %.\n"),
            "{text}"
        );
        assert!(
            text.contains("Epochs 0 and 2 were passed over: the tool's handle would pass through it.\n"),
            "{text}"
        );
        assert!(text.contains("of the epochs that the arm may perform it misses"), "{text}");
        assert!(text.contains("What could help:\n- epoch 0 brought 9.592 g"), "{text}");
        assert_eq!(
            finding.shortfall().unwrap(),
            "the plan brings 8.3 % less than wanted, and the tolerance is 2 %"
        );
    }

    #[test]
    fn what_is_met_with_much_lost_says_what_could_help() {
        for (rims, words) in
            [(40, None), (150, Some("\nWhat could help:\n- 1.264 g, 13 % of what is wanted, is lost"))]
        {
            let (_, mut run) = found([100, 1190, 1000], None, 1198);
            let mut shipped = run.shipped.unwrap();
            let census = Census { rims, ..shipped.outcome.census };
            shipped.outcome = Outcome::new(&Amounts::from(&run.scene), census, 99.1);
            run.shipped = Some(shipped);
            let finding = run.finding().unwrap();
            let text = finding.text(run.skills());
            assert_eq!(finding.met, Some(true));
            assert_eq!(
                (text.contains("help"), words.is_none_or(|words| text.contains(words))),
                (words.is_some(), true),
                "{text}"
            );
        }
    }

    /// The search's plan met on the scene's own cells, and 14 % were missing on smaller ones.
    #[test]
    fn what_smaller_cells_say_comes_before_what_the_scenes_own_do() {
        let (_, mut run) = found([100, 1190, 1000], None, 1198);
        let amounts = Amounts::from(&run.scene);
        let there = amounts.in_particles_of(1e-6);
        let brings = |of: &Amounts, target: u32| {
            Outcome::new(of, Census { target, source: 10, ..Census::default() }, 99.1)
        };
        let said = |run: &RunRecord| {
            let finding = run.finding().unwrap();
            (finding.text(run.skills()), finding.shortfall(), finding.epoch)
        };
        let mut shipped = run.shipped.unwrap();
        let theta_before = shipped.theta;
        shipped.theta = Theta::clamped([0.4; 5]);
        shipped.outcome = brings(&amounts, 1400);
        for (target, met) in [(9500, true), (9000, false)] {
            shipped.finer = Some(OnFiner {
                cell_m: 0.002,
                amounts: there,
                plan: brings(&there, target),
                corrected: true,
                theta_before,
                before: [brings(&amounts, 1198), brings(&there, 8256)],
                rollouts: [12, 3],
                cpu_seconds: 379.2,
            });
            run.shipped = Some(shipped);
            let (text, shortfall, epoch) = said(&run);
            assert_eq!((epoch, shortfall.is_none()), (Some(1), met), "{shortfall:?}");
            let first = text.lines().next().unwrap();
            assert!(first.starts_with("On cells of 2 mm the plan brings 9"), "{text}");
            assert!(first.ends_with("; on the scene's own of 4 mm it brings 11.2 g."), "{text}");
            assert!(
                text.contains(
                    "\nAs the search left it, it brought 8.256 g there (14 % too little) and 9.584 g. Simulated for that: 12 motions on the \
                     scene's own cells, 3 motions on the smaller ones, 379 s of processor time.\nEpoch 1 of 2 is what was corrected: of"
                ),
                "{text}"
            );
            assert_eq!(text.contains("another --seed"), !met, "{text}");
            if let Some(shortfall) = shortfall {
                let words =
                    "on cells of 2 mm the plan brings 6.2 % less than wanted, and the tolerance is 2 %";
                assert_eq!(shortfall, words);
            }
        }
        shipped.finer = None;
        (run.shipped, run.state.unrefined) = (Some(shipped), Some("it would be too large".into()));
        assert!(said(&run).0.contains("\nIt was not looked at on smaller cells: it would be too large.\n"));
    }
}
