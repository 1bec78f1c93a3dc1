//! Gradients of whole motions beside the slope that a search wants, over many skills and packings.
//!
//! | symbol | meaning | in code |
//! |---|---|---|
//! | d | slope of the loss: central differences over [`HALF_STEP`], mean over the packings | `slope` |
//! | g | a gradient, mean over the packings | `estimate` |
//! | c | mean of d over all other skills, the constant direction | |
//! | n_k | how uncertain component k of d is, from the packings: standard deviation of the mean | `noise` |
//!
//! The cosine of g and d alone is a weak test: scooping depth matters most everywhere, so that c, which knows nothing of the skill,
//! points about as well as d. Hence c stands beside the gradients as a control, and of each gradient it is also said how well the
//! rest of it, without its part along c, fits the rest of d. A sign counts where abs d_k > n_k.

use serde::{Deserialize, Serialize};

use crate::bench::cpu_seconds;
use crate::rollout::restart::Restarts;
use crate::rollout::{Evaluation, RolloutError, Simulate, part};
use crate::skill::{SkillParameter, Theta, ThetaError, ThetaGradient};

/// Half-step of the differences, in units of theta.
pub const HALF_STEP: f64 = 0.1;

/// Particles that a skill has to deliver at least: below, there is no slope to speak of.
pub const LEAST_DELIVERED: u32 = 20;

/// Progress of a gradient in units of that of a rollout.
const GRADIENT_WORK: f64 = 8.0;

/// One skill with one packing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Measured {
    /// Particles that arrive.
    pub delivered: u32,
    /// Whether one of the differences looks across the edge of the miss: where the skill brings too little its end brings enough, or the
    /// other way round. With [`Aim::Amount`](crate::scene::Aim::Amount) the loss has a kink there, and such a difference is the mean of
    /// two slopes.
    pub across_edge: bool,
    /// Central differences of the loss, metres.
    pub slope: ThetaGradient,
    /// The gradient by the exact adjoint, metres.
    pub exact: ThetaGradient,
    /// The gradient by the restarted adjoint, metres.
    pub restarted: ThetaGradient,
    /// What they took of processors.
    pub seconds: Seconds,
}

/// Processor time of all threads together, seconds; wall-clock time where the system does not tell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Seconds {
    /// Of one rollout, the mean of those of the differences.
    pub rollout: f64,
    /// Of a rollout with the exact adjoint.
    pub exact: f64,
    /// Of a rollout with the restarted one.
    pub restarted: f64,
}

/// Number `draw` of a sequence of skills that fills theta's range evenly, its ends left out so that differences fit in.
#[must_use]
pub fn skill(draw: u64) -> Theta {
    // Roberts 2018: powers of the root of x^6 = x + 1.
    const ROOT: f64 = 1.134_724_138_401_519_4;
    Theta::clamped(std::array::from_fn(|k| {
        let share = (0.5 + (draw + 1) as f64 / ROOT.powi(k as i32 + 1)).fract();
        (1.0 - HALF_STEP) * (2.0 * share - 1.0)
    }))
}

/// Measures one skill; nothing if it delivers less than [`LEAST_DELIVERED`].
///
/// # Errors
/// See [`RolloutError`]; [`RolloutError::Theta`] where the skill leaves no room for differences over [`HALF_STEP`].
pub fn measure(
    simulator: &mut dyn Simulate,
    theta: &Theta,
    restarts: &Restarts,
) -> Result<Option<Measured>, RolloutError> {
    const ROLLOUTS: f64 = 11.0;
    let whole = ROLLOUTS + 2.0 * GRADIENT_WORK;
    // Settles the powder, so that it counts nowhere.
    simulator.evaluate_all(&[])?;
    let at = part(simulator, [0.0, 1.0 / whole], |simulator| simulator.evaluate(theta))?;
    let delivered = at.census.target;
    if delivered < LEAST_DELIVERED {
        return Ok(None);
    }
    let both_ways = both_ways(theta)?;
    let from_s = cpu_seconds();
    let ends =
        part(simulator, [1.0 / whole, ROLLOUTS / whole], |simulator| simulator.evaluate_all(&both_ways))?;
    let rollout = (cpu_seconds() - from_s) / both_ways.len() as f64;
    let slope = std::array::from_fn(|k| (ends[2 * k].loss - ends[2 * k + 1].loss) / (2.0 * HALF_STEP));
    let across_edge = looks_across_edge(&at, &ends);
    let from_s = cpu_seconds();
    let mut gradient = |restarts: &Restarts, from: f64| {
        let span = [from / whole, (from + GRADIENT_WORK) / whole];
        let found = part(simulator, span, |simulator| simulator.evaluate_restarted(theta, restarts));
        found.map(|found| found.gradient)
    };
    let exact = gradient(&restarts.without_cuts(), ROLLOUTS)?;
    let between_s = cpu_seconds();
    let restarted = gradient(restarts, ROLLOUTS + GRADIENT_WORK)?;
    Ok(Some(Measured {
        delivered,
        across_edge,
        slope,
        exact,
        restarted,
        seconds: Seconds { rollout, exact: between_s - from_s, restarted: cpu_seconds() - between_s },
    }))
}

/// The ends of the differences, two by two: the upper one first.
fn both_ways(theta: &Theta) -> Result<Vec<Theta>, ThetaError> {
    let ends = |which| [HALF_STEP, -HALF_STEP].map(|step| theta.with(which, theta[which] + step));
    SkillParameter::ALL.into_iter().flat_map(ends).collect()
}

/// Whether one of these ends brings enough where the skill itself does not, or the other way round.
fn looks_across_edge(at: &Evaluation, ends: &[Evaluation]) -> bool {
    let is_short = |found: &Evaluation| found.indicator > 0;
    ends.iter().any(|end| is_short(end) != is_short(at))
}

/// One skill over all packings.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Row {
    /// The skill.
    pub theta: Theta,
    /// By packing.
    pub packings: Vec<Measured>,
    /// Whether a difference looks across the edge of the miss with any of them.
    pub across_edge: bool,
    /// Mean slope, metres.
    pub slope: ThetaGradient,
    /// How uncertain that is, metres; none of a single packing.
    pub noise: Option<ThetaGradient>,
    /// Mean gradient by the exact adjoint, metres.
    pub exact: ThetaGradient,
    /// Mean gradient by the restarted adjoint, metres.
    pub restarted: ThetaGradient,
}

/// How well one kind of gradient fits the slope, over all skills.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Fit {
    /// Cosine with the slope: median and lowest.
    pub cosine: [f64; 2],
    /// Cosine of what is left of both without the constant direction; none of that direction itself.
    pub residual_cosine: Option<[f64; 2]>,
    /// Length over that of the slope: median, lowest, highest.
    pub length: [f64; 3],
    /// Of each component, how many signs are right, and of how many.
    pub signs: [[usize; 2]; 5],
    /// Of each component, the correlation with that of the slope over skills; none of what does not vary.
    pub correlation: [Option<f64>; 5],
}

/// What a table says.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Summary {
    /// The exact adjoint.
    pub exact: Fit,
    /// The restarted one.
    pub restarted: Fit,
    /// The mean slope of the other skills.
    pub constant: Fit,
    /// Cost of the exact adjoint in rollouts, by processor time.
    pub exact_in_rollouts: f64,
    /// Cost of the restarted one.
    pub restarted_in_rollouts: f64,
}

impl Row {
    /// Of one skill's packings, of which there is at least one.
    #[must_use]
    pub fn new(theta: Theta, packings: Vec<Measured>) -> Self {
        let count = packings.len() as f64;
        let mean = |of: fn(&Measured) -> &ThetaGradient| -> ThetaGradient {
            std::array::from_fn(|k| packings.iter().map(|one| of(one)[k]).sum::<f64>() / count)
        };
        let slope = mean(|one| &one.slope);
        let noise = (packings.len() > 1).then(|| {
            std::array::from_fn(|k| {
                let squares: f64 = packings.iter().map(|one| (one.slope[k] - slope[k]).powi(2)).sum();
                libm::sqrt(squares / (count - 1.0) / count)
            })
        });
        let (exact, restarted) = (mean(|one| &one.exact), mean(|one| &one.restarted));
        let across_edge = packings.iter().any(|one| one.across_edge);
        Self { theta, packings, across_edge, slope, noise, exact, restarted }
    }
}

impl Summary {
    /// Of all skills; none of fewer than two, which have no constant direction.
    #[must_use]
    pub fn new(rows: &[Row]) -> Option<Self> {
        if rows.len() < 2 {
            return None;
        }
        let others = |left_out: usize, k: usize| {
            let others = rows.iter().enumerate().filter(|(index, _)| *index != left_out);
            others.map(|(_, row)| row.slope[k]).sum::<f64>() / (rows.len() - 1) as f64
        };
        let constant: Vec<ThetaGradient> =
            (0..rows.len()).map(|index| std::array::from_fn(|k| others(index, k))).collect();
        let of = |estimate: fn(&Row) -> ThetaGradient| rows.iter().map(estimate).collect::<Vec<_>>();
        let all = || rows.iter().flat_map(|row| &row.packings).map(|one| &one.seconds);
        let rollout_s: f64 = all().map(|seconds| seconds.rollout).sum();
        Some(Self {
            exact: Fit::new(rows, &of(|row| row.exact), Some(&constant)),
            restarted: Fit::new(rows, &of(|row| row.restarted), Some(&constant)),
            constant: Fit::new(rows, &constant, None),
            exact_in_rollouts: all().map(|seconds| seconds.exact).sum::<f64>() / rollout_s,
            restarted_in_rollouts: all().map(|seconds| seconds.restarted).sum::<f64>() / rollout_s,
        })
    }
}

impl Fit {
    fn new(rows: &[Row], estimates: &[ThetaGradient], constant: Option<&[ThetaGradient]>) -> Self {
        let cosines = rows.iter().zip(estimates).map(|(row, estimate)| cosine(estimate, &row.slope));
        let cosines = ordered(cosines);
        let residuals = constant.map(|constant| {
            let all = rows.iter().zip(estimates).zip(constant);
            ordered(all.map(|((row, g), c)| cosine(&without(g, c), &without(&row.slope, c))))
        });
        let lengths = ordered(
            rows.iter().zip(estimates).map(|(row, g)| length(g) / length(&row.slope).max(f64::MIN_POSITIVE)),
        );
        let signs = std::array::from_fn(|k| {
            let clear = |row: &Row| row.slope[k].abs() > row.noise.map_or(0.0, |noise| noise[k]);
            let clear = rows.iter().zip(estimates).filter(|(row, _)| clear(row));
            let right = clear.clone().filter(|(row, g)| row.slope[k] * g[k] > 0.0);
            [right.count(), clear.count()]
        });
        let correlation = std::array::from_fn(|k| {
            correlation(rows.iter().zip(estimates).map(|(row, g)| [row.slope[k], g[k]]))
        });
        Self {
            cosine: [median(&cosines), cosines[0]],
            residual_cosine: residuals.map(|all| [median(&all), all[0]]),
            length: [median(&lengths), lengths[0], lengths[lengths.len() - 1]],
            signs,
            correlation,
        }
    }
}

fn dot(a: &ThetaGradient, b: &ThetaGradient) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn length(a: &ThetaGradient) -> f64 {
    libm::sqrt(dot(a, a))
}

/// Cosine of the angle between two vectors: 0 if one has no direction.
#[must_use]
pub fn cosine(a: &ThetaGradient, b: &ThetaGradient) -> f64 {
    let lengths = length(a) * length(b);
    if lengths > 0.0 { dot(a, b) / lengths } else { 0.0 }
}

/// A vector less its part along another.
fn without(a: &ThetaGradient, along: &ThetaGradient) -> ThetaGradient {
    let square = dot(along, along);
    let share = if square > 0.0 { dot(a, along) / square } else { 0.0 };
    std::array::from_fn(|k| a[k] - share * along[k])
}

fn ordered(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut all: Vec<f64> = values.collect();
    all.sort_by(f64::total_cmp);
    all
}

/// Of what is in order and not empty.
fn median(all: &[f64]) -> f64 {
    f64::midpoint(all[(all.len() - 1) / 2], all[all.len() / 2])
}

fn correlation(pairs: impl Iterator<Item = [f64; 2]> + Clone) -> Option<f64> {
    let count = pairs.clone().count() as f64;
    let mean = [0, 1].map(|side| pairs.clone().map(|pair| pair[side]).sum::<f64>() / count);
    let sum = |a: usize, b: usize| pairs.clone().map(|p| (p[a] - mean[a]) * (p[b] - mean[b])).sum::<f64>();
    let spread = libm::sqrt(sum(0, 0) * sum(1, 1));
    (spread > 0.0).then(|| sum(0, 1) / spread)
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "numbers that are exact")]
mod tests {
    use super::*;
    use crate::rollout::Census;

    fn measured(slope: ThetaGradient, exact: ThetaGradient, restarted: ThetaGradient) -> Measured {
        let seconds = Seconds { rollout: 2.0, exact: 20.0, restarted: 10.0 };
        Measured { delivered: 50, across_edge: false, slope, exact, restarted, seconds }
    }

    /// Slopes share a large first component; the restarted gradient is half as long, the exact one points the other way.
    fn rows() -> Vec<Row> {
        let slopes = [[-10.0, 1.0, 0.0, 2.0, 0.0], [-10.0, -1.0, 0.0, 2.0, 0.0], [-10.0, 0.0, 3.0, 2.0, 0.0]];
        let row = |slope: ThetaGradient| {
            let [exact, restarted] = [-2.0, 0.5].map(|times| slope.map(|x| times * x));
            let shaken = |by: f64| {
                let mut slope = slope;
                slope[3] += by;
                measured(slope, exact, restarted)
            };
            Row::new(Theta::MIDDLE, vec![shaken(5.0), shaken(-5.0)])
        };
        slopes.map(row).into()
    }

    #[test]
    fn a_summary_says_direction_length_signs_and_cost() {
        let rows = rows();
        assert_eq!(rows[0].slope, [-10.0, 1.0, 0.0, 2.0, 0.0]);
        assert_eq!(rows[0].noise, Some([0.0, 0.0, 0.0, 5.0, 0.0]));
        let summary = Summary::new(&rows).unwrap();
        let near = |a: f64, b: f64| (a - b).abs() < 1e-12;
        let Summary { exact, restarted, constant, .. } = &summary;
        assert!(near(restarted.cosine[0], 1.0) && near(restarted.cosine[1], 1.0));
        assert!(near(exact.cosine[0], -1.0) && near(exact.cosine[1], -1.0));
        assert!(near(restarted.residual_cosine.unwrap()[1], 1.0));
        assert!(near(exact.residual_cosine.unwrap()[0], -1.0) && constant.residual_cosine.is_none());
        assert!(restarted.length.iter().all(|x| near(*x, 0.5)) && exact.length.iter().all(|x| near(*x, 2.0)));
        // The third component is nothing in two of three, the fourth is less than its noise.
        assert_eq!(restarted.signs, [[3, 3], [2, 2], [1, 1], [0, 0], [0, 0]]);
        assert_eq!(exact.signs, [[0, 3], [0, 2], [0, 1], [0, 0], [0, 0]]);
        assert!(near(restarted.correlation[1].unwrap(), 1.0) && near(exact.correlation[2].unwrap(), -1.0));
        assert_eq!(restarted.correlation[0], None);
        // Of the first skill: the mean of [-10, -1, 0, 2, 0] and [-10, 0, 3, 2, 0].
        let first = cosine(&[-10.0, -0.5, 1.5, 2.0, 0.0], &rows[0].slope);
        assert!(constant.cosine[1] <= first && constant.cosine[0] > 0.9);
        assert!(near(summary.exact_in_rollouts, 10.0) && near(summary.restarted_in_rollouts, 5.0));
        assert!(Summary::new(&rows[..1]).is_none());
    }

    #[test]
    fn the_edge_is_where_the_wanted_amount_arrives() {
        let missing = |indicator: i64| Evaluation::new(1.0, indicator, Census::default());
        let looks_across = |at: i64, ends: [i64; 2]| looks_across_edge(&missing(at), &ends.map(missing));
        assert!(looks_across(5, [9, 0]) && looks_across(0, [1, -4]) && looks_across(-5, [-9, 3]));
        assert!(!looks_across(5, [9, 1]) && !looks_across(0, [0, -4]));
    }

    #[test]
    fn what_has_no_direction_has_no_cosine() {
        assert_eq!(cosine(&[0.0; 5], &[1.0; 5]), 0.0);
        assert_eq!(
            without(&[1.0, 2.0, 0.0, 0.0, 0.0], &[0.0, 3.0, 0.0, 0.0, 0.0]),
            [1.0, 0.0, 0.0, 0.0, 0.0]
        );
        assert_eq!(without(&[1.0; 5], &[0.0; 5]), [1.0; 5]);
        assert_eq!(median(&[1.0, 2.0, 4.0]), 2.0);
        assert_eq!(median(&[1.0, 2.0, 4.0, 9.0]), 3.0);
    }

    #[test]
    fn drawn_skills_are_always_the_same_and_leave_room_for_differences() {
        for draw in 0..200 {
            let theta = skill(draw);
            assert!(theta.components().iter().all(|x| x.abs() <= 1.0 - HALF_STEP), "{theta}");
            assert_eq!(theta, skill(draw));
            assert_eq!(both_ways(&theta).map(|ends| ends.len()), Ok(10));
        }
        assert_ne!(skill(0), skill(1));
    }

    #[test]
    fn a_skill_without_room_for_differences_is_refused_by_name() {
        let ends = both_ways(&Theta::clamped([0.9, 0.0, 0.0, 0.0, -0.9])).unwrap();
        assert_eq!((ends[0].components()[0], ends[9].components()[4]), (1.0, -1.0));
        let error = both_ways(&Theta::clamped([0.0, 0.0, 0.95, 0.0, 0.0])).unwrap_err();
        assert!(error.to_string().contains("(lift height) is 1.05"), "{error}");
    }
}
