//! What could help a run whose plan misses the wanted amount, or loses much on the way, from what its epochs measured.

use super::{
    amounts::{Amounts, percent},
    judged::Judged,
    words::parameter,
};
use crate::optim::World;
use powderline_shared::plan::SkillParameter;
use powderline_simulator::{
    scene::{Scene, figures::mass},
    skill::Theta,
};

/// Powder that counts as none, and as a good part, of the wanted.
const NEXT_TO_NOTHING: f64 = 0.01;
const A_GOOD_PART: f64 = 0.1;
/// Powder lost, of the wanted, from which on a plan that brings what is wanted is no good one.
const MUCH_LOST: f64 = 0.05;
/// Theta this near to its bound stands at it.
const AT_BOUND: f64 = 0.999;
/// A miss that shrank to this part in the last third of the epochs is still shrinking.
const STILL_SHRINKING: f64 = 0.7;

/// Sentences, the most likely remedy first. `shipped` is the epoch that became the plan.
pub(super) fn advice(scene: &Scene, epochs: &[Judged], shipped: Option<usize>) -> Vec<String> {
    let Some(plan) = shipped.map(|index| &epochs[index]) else { return Vec::new() };
    let measured = Measured { scene, amounts: Amounts::from(scene), epochs, plan };
    let found = match measured.nothing_moved().or_else(|| measured.lost_by_rounding()) {
        Some(reason) => vec![reason],
        None => [
            measured.nearer_but_passed_over(),
            measured.too_little_carried(),
            measured.stays_on_the_tool(),
            measured.misses_the_target(),
            measured.amounts.grains_too_large(),
            measured.still_shrinking().or_else(|| measured.on_both_sides()),
        ]
        .into_iter()
        .flatten()
        .chain(at_bounds(scene, plan.record.theta))
        .collect(),
    };
    if found.is_empty() { vec!["another --seed begins from another skill and packing".into()] } else { found }
}

/// What could help where the search's plan brings what is wanted on the scene's own cells, and what it was corrected to does not on
/// smaller ones.
pub(super) fn advice_on_finer(scene: &Scene, theta: Theta) -> Vec<String> {
    let other = "on smaller cells the skill answers otherwise, and no parameter alone led to the amount there: another --seed begins from \
                 another skill, and smaller cells of the scene's own (domain.cell_m) let the search see what they see";
    at_bounds(scene, theta).chain([other.into()]).collect()
}

/// What could help where the plan brings what is wanted, and much is lost on the way.
/// `epochs` are those that it ended after, and `settled` is whether it was allowed more.
pub(super) fn advice_on_lost(
    scene: &Scene,
    theta: Theta,
    lost_kg: f64,
    (epochs, settled): (usize, bool),
) -> Option<String> {
    let part = lost_kg / Amounts::from(scene).wanted_kg;
    let displacement = SkillParameter::TransportDisplacement;
    (part >= MUCH_LOST).then(|| {
        format!(
            "{}, {} of what is wanted, is lost, with a transport displacement of {} of {}: the pictures of `optimise report` show \
             where; another --seed begins from another skill, and {}",
            mass(lost_kg),
            percent(part),
            value(scene, displacement, theta[displacement]),
            key(scene, displacement),
            match settled {
                true => "a run that is begun with --patience 0 goes on to the last epoch".to_owned(),
                false => format!("--resume with --epochs {} goes on", 2 * epochs.saturating_sub(1).max(1)),
            }
        )
    })
}

struct Measured<'a> {
    scene: &'a Scene,
    amounts: Amounts,
    epochs: &'a [Judged],
    plan: &'a Judged,
}

impl Measured<'_> {
    fn wanted(&self) -> f64 {
        f64::from(self.amounts.wanted_particles)
    }

    /// The epochs of the scene itself.
    fn fine(&self) -> impl Iterator<Item = &Judged> {
        self.epochs.iter().filter(|epoch| epoch.record.world == World::Fine)
    }

    /// Particles that left the source in an epoch.
    fn carried(epoch: &Judged) -> u32 {
        let record = &epoch.record;
        record.census.target.saturating_add(record.census.lost()).saturating_add(record.census.tool)
    }

    fn most_carried(&self) -> u32 {
        self.epochs.iter().map(Self::carried).max().unwrap_or_default()
    }

    fn misses_by(&self, epoch: &Judged) -> f64 {
        self.amounts.miss(epoch.record.census.target).abs()
    }

    fn too_little(&self) -> bool {
        self.amounts.miss(self.plan.record.census.target) < 0.0
    }

    /// A parameter's value at a theta, as people say it.
    fn value(&self, which: SkillParameter, theta: f64) -> String {
        value(self.scene, which, theta)
    }

    /// The same in the plan.
    fn in_plan(&self, which: SkillParameter) -> String {
        self.value(which, self.plan.record.theta[which])
    }

    /// Such as `skill.scooping_depth_m = [0.002, 0.02]`.
    fn key(&self, which: SkillParameter) -> String {
        key(self.scene, which)
    }

    /// The smallest and largest value of a parameter in all epochs.
    fn tried(&self, which: SkillParameter) -> String {
        let values = || self.epochs.iter().map(|epoch| epoch.record.theta[which]);
        let [low, high] =
            [values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max)];
        let [low, high] = [low, high].map(|theta| self.value(which, theta));
        if low == high { low } else { format!("{low} to {high}") }
    }

    fn nothing_moved(&self) -> Option<String> {
        (f64::from(self.most_carried()) <= NEXT_TO_NOTHING * self.wanted()).then(|| {
            let bed_m = self.scene.powder.fill_max_m[2] - self.scene.powder.fill_min_m[2];
            format!(
                "in no epoch did the tool take up powder, so that the search had no slope to follow: it went {} deep into a bed of \
                 {} mm, with scooping angles of {}; a range that reaches deeper than {} would be right, and {} is the next to look at",
                self.tried(SkillParameter::ScoopingDepth),
                powderline_simulator::scene::figures::about(1e3 * bed_m, 3),
                self.tried(SkillParameter::ScoopingAngle),
                self.key(SkillParameter::ScoopingDepth),
                self.key(SkillParameter::ScoopingAngle)
            )
        })
    }

    fn lost_by_rounding(&self) -> Option<String> {
        (self.amounts.is_met(self.plan.record.census.target) == Some(true)).then(|| {
            format!(
                "the amount hangs by a few grains, for rounding a motion to whole counts is enough to miss it: --resume with --epochs {} \
                 looks for other motions, and a tolerance of more than {} leaves room for such",
                2 * (self.epochs.len() - 1).max(1),
                self.amounts.tolerance()
            )
        })
    }

    fn nearer_but_passed_over(&self) -> Option<String> {
        let nearer =
            |epoch: &&Judged| epoch.obstacle.is_some() && self.misses_by(epoch) < self.misses_by(self.plan);
        let best =
            self.fine().filter(nearer).min_by(|a, b| self.misses_by(a).total_cmp(&self.misses_by(b)))?;
        Some(format!(
            "epoch {} brought {}, but {}; bounds in [skill] that keep clear of that would be right",
            best.record.epoch,
            self.amounts.powder(best.record.census.target),
            best.obstacle.as_deref().unwrap_or_default()
        ))
    }

    fn too_little_carried(&self) -> Option<String> {
        let most = self.most_carried();
        let short =
            self.amounts.kg(most) < self.amounts.wanted_kg * (1.0 - self.amounts.tolerance.unwrap_or(0.0));
        (self.too_little() && short).then(|| {
            let capacity = self.scene.tool_capacity();
            format!(
                "no epoch carried more than {}; the tool holds about {} level and {} heaped, so a larger tool, a deeper {} or a smaller \
                 amount would be right",
                self.amounts.powder(most),
                mass(capacity.level_kg),
                mass(capacity.heaped_kg),
                self.key(SkillParameter::ScoopingDepth)
            )
        })
    }

    fn stays_on_the_tool(&self) -> Option<String> {
        let left = self.plan.record.census.tool;
        if !self.too_little() || f64::from(left) < A_GOOD_PART * self.wanted() {
            return None;
        }
        Some(format!(
            "{} stayed on the tool at a pouring angle of {}; a range that goes further than {} would be right",
            self.amounts.powder(left),
            self.in_plan(SkillParameter::PouringAngle),
            self.key(SkillParameter::PouringAngle)
        ))
    }

    fn misses_the_target(&self) -> Option<String> {
        let lost = self.plan.record.census.lost();
        (self.too_little() && f64::from(lost) >= A_GOOD_PART * self.wanted()).then(|| {
            format!(
                "{} fell on rims or beside them, with a transport displacement of {}; see where with `optimise report`, {} and the heading decide it",
                self.amounts.powder(lost),
                self.in_plan(SkillParameter::TransportDisplacement),
                self.key(SkillParameter::TransportDisplacement)
            )
        })
    }

    /// Whether the last third of the epochs came much nearer than those before.
    fn still_shrinking(&self) -> Option<String> {
        let all: Vec<&Judged> = self.fine().collect();
        let nearest =
            |part: &[&Judged]| part.iter().map(|epoch| self.misses_by(epoch)).fold(f64::INFINITY, f64::min);
        let (early, late) = all.split_at(all.len() - all.len() / 3);
        let shrinking = !late.is_empty() && nearest(late) < STILL_SHRINKING * nearest(early);
        shrinking.then(|| {
            format!(
                "the miss was still shrinking when the epochs ended: --resume with --epochs {} would go on",
                2 * (self.epochs.len() - 1)
            )
        })
    }

    /// Whether some epochs brought too much and others too little, between which the steps halve.
    fn on_both_sides(&self) -> Option<String> {
        let misses = || self.fine().map(|epoch| self.amounts.miss(epoch.record.census.target));
        (misses().any(|miss| miss < 0.0) && misses().any(|miss| miss > 0.0)).then(|| {
            format!(
                "some epochs brought too much and others too little: --resume with --epochs {} would close in on the amount",
                2 * (self.epochs.len() - 1)
            )
        })
    }
}

fn value(scene: &Scene, which: SkillParameter, theta: f64) -> String {
    let [low, high] = scene.skill.range(which);
    let value = low + 0.5 * (theta + 1.0) * (high - low);
    parameter(which, if which.is_angle() { value.to_radians() } else { value })
}

fn key(scene: &Scene, which: SkillParameter) -> String {
    let [low, high] = scene.skill.range(which);
    format!("skill.{} = [{low}, {high}]", which.key())
}

/// Parameters that stand at an end of their range.
fn at_bounds(scene: &Scene, theta: Theta) -> impl Iterator<Item = String> {
    SkillParameter::ALL.into_iter().filter_map(move |which| {
        let theta = theta[which];
        let [low, high] = scene.skill.range(which);
        (theta.abs() >= AT_BOUND && low < high).then(|| {
            format!(
                "the {} stands at the {} end of its range, {}; a wider {} would be right",
                which.name(),
                if theta > 0.0 { "upper" } else { "lower" },
                value(scene, which, theta.signum()),
                key(scene, which)
            )
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optim::EpochRecord;
    use powderline_simulator::{rollout::Census, skill::Theta};

    fn epochs(records: &[(u32, u32, u32)]) -> Vec<Judged> {
        (0..)
            .zip(records)
            .map(|(epoch, &(target, spilled, tool))| {
                let census = Census { target, spilled, tool, ..Census::default() };
                Judged { record: EpochRecord { epoch, census, ..EpochRecord::default() }, obstacle: None }
            })
            .collect()
    }

    fn said(scene: &Scene, epochs: &[Judged], shipped: usize) -> String {
        advice(scene, epochs, Some(shipped)).join("\n")
    }

    #[test]
    fn each_reason_for_a_miss_is_told_from_the_others() {
        let scene = Scene::load("bench").unwrap();
        let flat = epochs(&[(0, 0, 0), (0, 3, 1), (2, 0, 0)]);
        let text = said(&scene, &flat, 2);
        assert!(
            text.contains("11.0 mm deep into a bed of 22 mm")
                && text.contains("scooping_depth_m = [0.002, 0.02]"),
            "{text}"
        );
        assert_eq!(text.lines().count(), 1);

        let text = said(&scene, &epochs(&[(500, 0, 0), (600, 10, 0), (610, 0, 5)]), 2);
        assert!(text.contains("no epoch carried more than 4.92 g (615 particles)"), "{text}");
        assert!(text.contains("11.") && text.contains("heaped"), "{text}");

        let stuck = epochs(&[(300, 0, 1000), (320, 0, 1000), (310, 0, 1000)]);
        let text = said(&scene, &stuck, 1);
        assert!(text.contains("stayed on the tool at a pouring angle of 70.0 deg"), "{text}");

        let text = said(&scene, &epochs(&[(900, 400, 0), (950, 350, 0), (940, 350, 0)]), 1);
        assert!(
            text.contains(
                "2.8 g (350 particles) fell on rims or beside them, with a transport displacement of 110.0 mm"
            ),
            "{text}"
        );

        let text = said(&scene, &epochs(&[(100, 0, 0), (500, 0, 0), (1100, 200, 0)]), 2);
        assert!(text.contains("still shrinking") && text.contains("--epochs 4"), "{text}");

        let mut bound = epochs(&[(1000, 0, 500), (1100, 0, 110), (1000, 0, 500)]);
        bound[1].record.theta = Theta::MIDDLE.moved(SkillParameter::LiftHeight, -1.0);
        let text = said(&scene, &bound, 1);
        assert!(text.contains("the lift height stands at the lower end of its range, 60.0 mm"), "{text}");

        bound[0].record.census.target = 1199;
        bound[0].obstacle = Some("the tool's handle would pass".into());
        let text = said(&scene, &bound, 1);
        assert!(
            text.starts_with("epoch 0 brought 9.592 g (1,199 particles), but the tool's handle"),
            "{text}"
        );

        let text = said(&scene, &epochs(&[(1300, 0, 0), (1150, 50, 0), (1255, 0, 0)]), 2);
        assert!(text.contains("too much and others too little: --resume with --epochs 4"), "{text}");

        // The plan is told to have missed: only its rounded motion did.
        let text = said(&scene, &epochs(&[(900, 300, 0), (1201, 50, 0), (1100, 0, 0)]), 1);
        assert!(
            text.starts_with("the amount hangs by a few grains") && text.contains("--epochs 4"),
            "{text}"
        );
        assert_eq!(text.lines().count(), 1);

        let text = said(&scene, &epochs(&[(1300, 0, 0), (1250, 0, 0), (1255, 0, 0)]), 1);
        assert_eq!(text, "another --seed begins from another skill and packing");
    }

    #[test]
    fn grains_larger_than_the_tolerance_are_said() {
        let scene = Scene::load("bench").unwrap().with(|spec| {
            spec.objective.amount = powderline_simulator::scene::Amount::new(
                powderline_simulator::scene::Quantity::Particles(10),
            );
        });
        let scene = scene.unwrap();
        let text = said(&scene, &epochs(&[(20, 0, 0), (12, 0, 0)]), 1);
        assert!(text.contains("one particle is 10 % of the wanted amount"), "{text}");
    }
}
