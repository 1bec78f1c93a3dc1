//! What a run found, in words.

use super::words::{grouped, parameter};
use crate::optim::EpochRecord;
use powderline_shared::plan::SKILL_PARAMETERS;
use powderline_simulator::{
    rollout::Evaluation,
    scene::figures::about,
    skill::{SkillMap, Theta},
};
use std::fmt::Write;

/// What the words are about.
#[derive(Clone, Debug)]
pub struct Finding<'a> {
    /// The mapping of the scene.
    pub map: &'a SkillMap,
    /// Epoch 0.
    pub first: &'a EpochRecord,
    /// The epoch whose skill became the plan.
    pub best: &'a EpochRecord,
    /// An epoch of lower loss whose skill could not, and why.
    pub passed_over: Option<(&'a EpochRecord, String)>,
    /// The last epoch.
    pub last: &'a EpochRecord,
    /// What the plan, quantised, achieves.
    pub plan: &'a Evaluation,
    /// Mass of a particle, kilogram.
    pub particle_mass_kg: f64,
}

impl Finding<'_> {
    /// A paragraph on the result, then one line per skill parameter.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a string does not fail.
        let _ = writeln!(text, "{}", self.verdict());
        let _ = writeln!(text, "{}", self.powder());
        if let Some((epoch, reason)) = &self.passed_over {
            let EpochRecord { epoch, loss, .. } = epoch;
            let _ = writeln!(text, "Epoch {epoch} was passed over with its loss of {loss:.3} m: {reason}.");
        }
        let _ = writeln!(text, "\n{:<24}{:>12}{:>14}", "skill", "at epoch 0", "in the plan");
        let [first, best] =
            [self.first.theta, self.best.theta].map(|theta: Theta| self.map.parameters(&theta));
        for (index, (name, _)) in SKILL_PARAMETERS.iter().enumerate() {
            let [from, to] = [first[index], best[index]].map(|value| parameter(index, value));
            let _ = writeln!(text, "{name:<24}{from:>12}{to:>14}");
        }
        text
    }

    fn verdict(&self) -> String {
        let (first, best, last) = (self.first, self.best, self.last);
        let able = if self.passed_over.is_some() { " that the arm may perform" } else { "" };
        if best.epoch == first.epoch {
            return format!(
                "None of the {} epochs after the first{able} improved on it: the plan is the skill the run started from, \
                 with a loss of {:.3} m.",
                last.epoch, first.loss
            );
        }
        let share = 100.0 * (first.loss - best.loss) / first.loss;
        format!(
            "The loss fell from {:.3} m at epoch 0 to {:.3} m at epoch {} (by {share:.1} %), the best of {} epochs{able}; \
             that skill is the plan.",
            first.loss, best.loss, best.epoch, last.epoch
        )
    }

    fn powder(&self) -> String {
        let plan = self.plan;
        let target = plan.indicator + i64::from(plan.transported);
        let off = about(100.0 * plan.indicator.abs() as f64 / target as f64, 2);
        let missing = match plan.indicator {
            1.. => format!("{off} % less than the {} wanted", grouped(target)),
            0 => format!("exactly the {} wanted", grouped(target)),
            _ => format!("{off} % more than the {} wanted", grouped(target)),
        };
        format!(
            "As shipped (quantised, simulated again) it has a loss of {:.3} m and brings {} particles ({} g) into the target \
             container, {missing}; {} spill. At epoch 0 it was {} particles, and {} spilled.",
            plan.loss,
            grouped(plan.transported.into()),
            about(1e3 * self.particle_mass_kg * f64::from(plan.transported), 4),
            grouped(plan.spilled.into()),
            grouped(self.first.transported.into()),
            grouped(self.first.spilled.into()),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_simulator::scene::Scene;

    fn record(epoch: u32, loss: f64) -> EpochRecord {
        EpochRecord {
            epoch,
            loss,
            indicator: 800,
            transported: 50,
            spilled: 2,
            theta: [0.0; 5],
            seconds: 1.0,
            ..EpochRecord::default()
        }
    }

    #[test]
    fn says_what_changed_and_what_arrives() {
        let map = SkillMap::new(&Scene::load("bench").unwrap());
        let plan = Evaluation { loss: 1130.0, indicator: -1, transported: 851, spilled: 4, gradient: None };
        let finding = Finding {
            map: &map,
            first: &record(0, 1200.0),
            best: &EpochRecord { theta: [1.0; 5], ..record(27, 1128.0) },
            last: &record(30, 1129.0),
            plan: &plan,
            passed_over: None,
            particle_mass_kg: 8e-6,
        };
        let text = finding.text();
        for part in [
            "from 1200.000 m",
            "epoch 27 (by 6.0 %)",
            "851 particles (6.808 g)",
            "0.12 % more than the 850",
            "20.0 mm",
            "110.0 deg",
        ] {
            assert!(text.contains(part), "{part} in {text}");
        }
        let none = Finding { best: &record(0, 1200.0), ..finding.clone() };
        assert!(none.text().contains("None of the 30 epochs after the first improved"));
        let reason = "the tool's handle would pass through container \"target\" at 3.21 s".into();
        let text = Finding { passed_over: Some((&record(29, 1100.0), reason)), ..finding }.text();
        assert!(text.contains("the best of 30 epochs that the arm may perform; that skill"), "{text}");
        assert!(
            text.contains("\nEpoch 29 was passed over with its loss of 1100.000 m: the tool's handle"),
            "{text}"
        );
    }
}
