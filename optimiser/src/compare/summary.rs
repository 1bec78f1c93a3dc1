//! The table below the figure.

use super::{Best, Comparison, Count, Track};
use crate::optim::Method;
use crate::report::words::grouped;
use powderline_simulator::scene::figures::mass;
use serde::Serialize;

/// A part of the way from the powder at rest to the best known skill that counts as having got there.
const ARRIVED: f64 = 0.9;

/// What a method has achieved, over the seeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// The method.
    pub method: Method,
    /// Mass of a particle, kilogram.
    pub particle_mass_kg: f64,
    /// Seeds.
    pub seeds: usize,
    /// After each budget; nothing where not every seed has got there.
    pub after: Vec<Option<Achieved>>,
    /// Seeds that came nine tenths of the way from the powder at rest to the best skill known.
    pub arrived: usize,
    /// Mean rollouts until then, over those seeds, by number and by processor time.
    pub rollouts: Option<[f64; 2]>,
    /// Mean processor time until then, over those seeds, seconds.
    pub cpu_seconds: Option<f64>,
}

/// The best skills by the end of a budget.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Achieved {
    /// Rollouts, by number.
    pub rollouts: u32,
    /// Mean over the seeds of how many wanted particles are missing; negative if more arrive.
    pub indicator: f64,
    /// Mean over the seeds of how many are missing or too many.
    pub off: f64,
    /// Mean over the seeds of the loss, metres, and its standard deviation.
    pub loss: [f64; 2],
    /// Mean over the seeds of what all of it cost by processor time, rollouts.
    pub by_time: f64,
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

/// One row a method; `rest_loss` is the loss of powder that nobody moves, metres, by seed.
pub fn summarise(comparison: &Comparison, rest_loss: &dyn Fn(u64) -> f64) -> Vec<Row> {
    let last = |track: &Track| comparison.bests(track).last().map(|best| best.one.loss);
    let best_known = comparison.tracks.iter().filter_map(last).fold(f64::INFINITY, f64::min);
    let enough = |seed| {
        let rest = rest_loss(seed);
        rest - ARRIVED * (rest - best_known)
    };
    comparison.methods().into_iter().map(|method| Row::of(comparison, method, &enough)).collect()
}

impl Row {
    fn of(comparison: &Comparison, method: Method, enough: &dyn Fn(u64) -> f64) -> Self {
        let tracks: Vec<(u64, Vec<Best<'_>>)> =
            comparison.tracks_of(method).map(|track| (track.seed, comparison.bests(track))).collect();
        let arrivals: Vec<&Best<'_>> = tracks
            .iter()
            .filter_map(|(seed, bests)| bests.iter().find(|best| best.one.loss <= enough(*seed)))
            .collect();
        let over = |value: &dyn Fn(&Best<'_>) -> f64| {
            mean(&arrivals.iter().map(|best| value(best)).collect::<Vec<_>>())
        };
        let has_arrived = !arrivals.is_empty();
        Self {
            method,
            particle_mass_kg: comparison.amounts.particle_mass_kg,
            seeds: tracks.len(),
            after: comparison.budgets.iter().map(|budget| Achieved::by(*budget, &tracks)).collect(),
            arrived: arrivals.len(),
            rollouts: has_arrived
                .then(|| [Count::Number, Count::Time].map(|count| over(&|best| best.cost(count)))),
            cpu_seconds: has_arrived.then(|| over(&|best| best.cpu_seconds)),
        }
    }

    /// Headings of the table, for so many budgets.
    pub fn headings(budgets: &[u32]) -> Vec<String> {
        let after = |budget: &u32| {
            let budget = grouped(i64::from(*budget));
            [format!("off after {budget}"), "loss, m".into()]
        };
        let ends = ["rollouts to 90 %", "by processor time"].map(String::from);
        std::iter::once("method".into()).chain(budgets.iter().flat_map(after)).chain(ends).collect()
    }

    /// The row as text.
    pub fn cells(&self) -> Vec<String> {
        let number = |value: f64| grouped(value.round() as i64);
        let achieved = |one: &Option<Achieved>| match one {
            Some(Achieved { off, loss: [loss, spread], .. }) => [
                format!("{} ({})", mass(off * self.particle_mass_kg), number(*off)),
                format!("{loss:.1} +- {spread:.1}"),
            ],
            None => ["-".into(), "-".into()],
        };
        let some = if self.arrived == self.seeds {
            String::new()
        } else {
            format!(" ({} of {})", self.arrived, self.seeds)
        };
        let arrival = match self.rollouts {
            Some(rollouts) => rollouts.map(|rollouts| number(rollouts) + &some),
            None => ["never".into(), "never".into()],
        };
        std::iter::once(self.method.name().into())
            .chain(self.after.iter().flat_map(achieved))
            .chain(arrival)
            .collect()
    }
}

impl Achieved {
    /// By the end of a budget, if every seed has got there.
    fn by(budget: u32, tracks: &[(u64, Vec<Best<'_>>)]) -> Option<Self> {
        let within = |(_, bests): &(u64, Vec<Best<'_>>)| -> Option<(f64, f64, f64)> {
            let has = |best: &&Best<'_>| best.rollouts <= f64::from(budget) + 1e-9;
            bests.last().filter(|last| last.rollouts + 1e-9 >= f64::from(budget))?;
            let best = bests.iter().take_while(has).last()?;
            Some((best.one.indicator as f64, best.one.loss, best.by_time))
        };
        let all: Vec<(f64, f64, f64)> = tracks.iter().map(within).collect::<Option<_>>()?;
        if all.is_empty() {
            return None;
        }
        let of = |value: fn(&(f64, f64, f64)) -> f64| all.iter().map(value).collect::<Vec<_>>();
        let losses = of(|one| one.1);
        Some(Self {
            rollouts: budget,
            indicator: mean(&of(|one| one.0)),
            off: mean(&of(|one| one.0.abs())),
            loss: [mean(&losses), spread(&losses)],
            by_time: mean(&of(|one| one.2)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::comparison;
    use super::*;

    #[test]
    fn rows_say_what_was_achieved() {
        let rows = summarise(&comparison(), &|_| 100.0);
        let [surrogate, random] = &rows[..] else { panic!("{rows:?}") };
        assert_eq!((surrogate.method, surrogate.seeds), (Method::Surrogate, 2));
        let after: Vec<Achieved> = surrogate.after.iter().map(|one| one.unwrap()).collect();
        assert_eq!(after.iter().map(|one| one.off).collect::<Vec<_>>(), [40.0, 35.0]);
        assert!((after[1].loss[0] - 35.0).abs() < 1e-12 && (after[1].loss[1] - 50f64.sqrt()).abs() < 1e-12);
        // Nine tenths of the way from 100 to 30 are at 37.
        assert_eq!(
            (surrogate.arrived, surrogate.rollouts, surrogate.cpu_seconds),
            (1, Some([3.0, 3.0]), Some(6.0))
        );
        assert_eq!((random.arrived, random.rollouts), (0, None));
        let cells = surrogate.cells();
        assert_eq!(cells[1..3], ["320 mg (40)", "40.0 +- 0.0"]);
        assert_eq!(cells[5], "3 (1 of 2)");
        assert_eq!(random.cells()[5], "never");
        assert_eq!(cells.len(), Row::headings(&[2, 6]).len());
    }

    #[test]
    fn a_budget_that_nothing_was_simulated_in_has_no_entry() {
        let mut none = comparison();
        none.tracks[0].tries.clear();
        assert!(summarise(&none, &|_| 100.0)[0].after.iter().all(Option::is_none));
    }

    #[test]
    fn spread_is_that_of_a_sample() {
        assert!((spread(&[1.0, 3.0]) - 2.0f64.sqrt()).abs() < 1e-12);
        assert!(spread(&[5.0]).abs() < 1e-12 && spread(&[]).abs() < 1e-12);
    }
}
