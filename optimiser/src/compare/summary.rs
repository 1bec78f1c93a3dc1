//! The table below the figure.

use super::{Comparison, Curve, Track, Try};
use crate::report::words::{duration, grouped};
use powderline_simulator::scene::figures::mass;
use serde::Serialize;

/// A part of the way from the powder at rest to the best known skill that counts as having got there.
const ARRIVED: f64 = 0.9;

/// What a curve has achieved, over the seeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// The curve.
    pub name: String,
    /// Mass of a particle, kilogram.
    pub particle_mass_kg: f64,
    /// Seeds.
    pub seeds: usize,
    /// Mean indicator of the best skill so far at the beginning, in the middle and at the end.
    pub indicator: [Option<f64>; 3],
    /// Standard deviation over the seeds of the indicator at the end.
    pub indicator_spread: Option<f64>,
    /// Lowest loss of all seeds, metres.
    pub best_loss: f64,
    /// Mean over the seeds of the lowest loss, metres.
    pub mean_loss: f64,
    /// Standard deviation over the seeds of the lowest loss, metres.
    pub loss_spread: f64,
    /// Seeds that came nine tenths of the way from the powder at rest to the best skill known.
    pub arrived: usize,
    /// Mean rollouts until then, over those seeds.
    pub rollouts: Option<f64>,
    /// Mean seconds of simulation until then, over those seeds.
    pub seconds: Option<f64>,
    /// Mean rollouts in all.
    pub all_rollouts: f64,
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Standard deviation of a sample; 0 of one value.
pub(super) fn spread(values: &[f64]) -> f64 {
    let mean = mean(values);
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (squares / values.len().saturating_sub(1).max(1) as f64).sqrt()
}

/// One row a curve; `rest_loss` is the loss of powder that nobody moves, metres, by seed.
pub fn summarise(comparison: &Comparison, rest_loss: &dyn Fn(u64) -> f64) -> Vec<Row> {
    let tries = || comparison.tracks.iter().flat_map(|track| &track.tries);
    let lowest = |a: f64, one: &Try| a.min(one.loss);
    // What is no skill breaks limits of the arm: not what others should be measured by.
    let best_skill = tries().filter(|one| one.theta.is_some()).fold(f64::INFINITY, lowest);
    let best_known = if best_skill.is_finite() { best_skill } else { tries().fold(f64::INFINITY, lowest) };
    let row = |curve: &Curve| {
        Row::of(comparison, *curve, &|seed| {
            let rest = rest_loss(seed);
            rest - ARRIVED * (rest - best_known)
        })
    };
    comparison.curves().iter().map(row).collect()
}

impl Row {
    fn of(comparison: &Comparison, curve: Curve, enough: &dyn Fn(u64) -> f64) -> Self {
        let tracks: Vec<(&Track, &[Try])> = comparison
            .tracks_of(curve)
            .map(|track| {
                let most = comparison.tries_by(curve, comparison.budget.epochs);
                (track, &track.tries[..track.tries.len().min(most)])
            })
            .collect();
        let epochs = comparison.budget.epochs;
        let indicators = |epoch: u32| -> Option<Vec<f64>> {
            let at = |(track, _): &(&Track, &[Try])| comparison.best(curve, track, epoch);
            tracks.iter().map(|track| at(track).map(|best| best.indicator as f64)).collect()
        };
        let best: Vec<f64> = tracks
            .iter()
            .map(|(_, tries)| tries.iter().map(|one| one.loss).fold(f64::INFINITY, f64::min))
            .collect();
        let arrivals: Vec<&Try> = tracks
            .iter()
            .filter_map(|(track, tries)| tries.iter().find(|one| one.loss <= enough(track.seed)))
            .collect();
        let over = |value: &dyn Fn(&Try) -> f64| {
            let values: Vec<f64> = arrivals.iter().map(|one| value(one)).collect();
            (!values.is_empty()).then(|| mean(&values))
        };
        let all = |(_, tries): &(&Track, &[Try])| tries.last().map_or(0.0, |last| f64::from(last.rollouts));
        Self {
            name: curve.name(),
            particle_mass_kg: comparison.amounts.particle_mass_kg,
            seeds: tracks.len(),
            indicator: [0, epochs / 2, epochs].map(|epoch| indicators(epoch).map(|values| mean(&values))),
            indicator_spread: indicators(epochs).map(|values| spread(&values)),
            best_loss: best.iter().copied().fold(f64::INFINITY, f64::min),
            mean_loss: mean(&best),
            loss_spread: spread(&best),
            arrived: arrivals.len(),
            rollouts: over(&|one| f64::from(one.rollouts)),
            seconds: over(&|one| one.seconds),
            all_rollouts: mean(&tracks.iter().map(all).collect::<Vec<_>>()),
        }
    }

    /// Headings of the table, for a comparison of so many epochs.
    pub fn headings(epochs: u32) -> [String; 8] {
        [
            "method".into(),
            "missing, epoch 0".into(),
            format!("epoch {}", epochs / 2),
            format!("epoch {epochs}"),
            "lowest loss, m".into(),
            "rollouts to 90 %".into(),
            "time to 90 %".into(),
            "rollouts in all".into(),
        ]
    }

    /// The row as text.
    pub fn cells(&self) -> [String; 8] {
        let number = |value: f64| grouped(value.round() as i64);
        let grams = |particles: f64| mass(particles.round() * self.particle_mass_kg);
        let missing = |at: usize| {
            self.indicator[at].map_or("-".into(), |mean| format!("{} ({})", grams(mean), number(mean)))
        };
        let at_the_end = match (self.indicator[2], self.indicator_spread) {
            (Some(mean), Some(spread)) => {
                format!("{} +- {} ({} +- {})", grams(mean), grams(spread), number(mean), number(spread))
            }
            _ => "-".into(),
        };
        let arrival = |text: Option<String>| match (text, self.arrived) {
            (Some(text), arrived) if arrived == self.seeds => text,
            (Some(text), arrived) => format!("{text} ({arrived} of {})", self.seeds),
            (None, _) => "never".into(),
        };
        [
            self.name.clone(),
            missing(0),
            missing(1),
            at_the_end,
            format!("{:.1} +- {:.1}", self.mean_loss, self.loss_spread),
            arrival(self.rollouts.map(number)),
            arrival(self.seconds.map(duration)),
            number(self.all_rollouts),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Method, tests::comparison};
    use super::*;

    #[test]
    fn rows_say_what_was_achieved() {
        let rows = summarise(&comparison(), &|_| 100.0);
        let [gradient, random, more] = &rows[..] else { panic!("{rows:?}") };
        assert_eq!((gradient.name.as_str(), gradient.seeds), ("gradient", 2));
        assert_eq!(gradient.indicator, [Some(55.0), Some(40.0), Some(35.0)]);
        assert!((gradient.mean_loss - 35.0).abs() < 1e-12 && (gradient.best_loss - 30.0).abs() < 1e-12);
        // Nine tenths of the way from 100 to 30 are at 37.
        assert_eq!((gradient.arrived, gradient.rollouts, gradient.seconds), (1, Some(3.0), Some(6.0)));
        assert_eq!((random.arrived, random.rollouts), (0, None));
        assert_eq!(random.indicator, [Some(79.5), Some(78.5), Some(77.5)]);
        assert_eq!(more.name, "random, 2 times the rollouts");
        assert!((more.all_rollouts - 12.0).abs() < 1e-12 && (random.all_rollouts - 6.0).abs() < 1e-12);
        let cells = gradient.cells();
        assert_eq!(cells[3], "280 mg +- 56 mg (35 +- 7)");
        assert_eq!(cells[5], "3 (1 of 2)");
    }

    #[test]
    fn others_are_not_measured_by_what_is_no_skill() {
        let rows = summarise(&comparison(), &|_| 100.0);
        let mut with_steps = comparison();
        let mut steps = Track { method: Method::GradientSteps, ..with_steps.tracks[0].clone() };
        steps.tries.iter_mut().for_each(|one| (one.theta, one.loss) = (None, 1.0));
        with_steps.tracks.push(steps);
        assert_eq!(summarise(&with_steps, &|_| 100.0)[..rows.len()], rows);
    }

    #[test]
    fn spread_is_that_of_a_sample() {
        assert!((spread(&[1.0, 3.0]) - 2.0f64.sqrt()).abs() < 1e-12);
        assert!(spread(&[5.0]).abs() < 1e-12 && spread(&[]).abs() < 1e-12);
    }
}
