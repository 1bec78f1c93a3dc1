//! What a skill may achieve, guessed from what others achieved in two worlds: a coarse one that is cheap, and the one that counts.
//!
//! | symbol | identifier | meaning |
//! |--------|------------|---------|
//! | a      | `amount`   | what arrives, over what is wanted |
//! | U      | `unit_m`   | what it costs if all that is wanted is missing: the wanted particles' number times the source's distance, metres |
//! | r      | `rest`     | the loss without its edge, L - U abs(1 - a): where in the target it lies, and what is lost |
//! | c, d   | `coarse`, `shift` | a and r are each c(theta) in the coarse world, and c(theta) + d(theta) in the one that counts |
//!
//! The loss has an edge where the wanted amount arrives, at which no smooth guess of it is any good; a and r are smooth on either side. So
//! these two are guessed, each as a Gaussian process, and the loss put together from them: with that, the edge is where it belongs from the
//! first. (Astudillo and Frazier 2019, "Bayesian optimization of composite functions". Of two worlds: Kennedy and O'Hagan 2000, "Predicting the
//! output from a complex computer code when fast approximations are available", with their factor of one.) The coarse world is known at
//! dozens of places, and d at a few; d is guessed to be much the same everywhere, and beyond that to change over `SHIFT_LENGTH`.
//!
//! Where all powder that can be had is wanted there is no edge: a is then not looked at, r is the loss.

use super::gaussian_process::{Factor, GaussianProcess, Guess, matern};

/// Over which distance in theta the worlds differ by something else.
const SHIFT_LENGTH: f64 = 0.7;

/// Variance of what the worlds differ by everywhere, over that of what they differ by here and there.
const SHIFT_EVERYWHERE: f64 = 4.0;

/// Noise of a difference of the worlds, over its size.
const SHIFT_NOISE: f64 = 0.1;

/// The worlds differ by this part of the function's deviation at the least.
const LEAST_SHIFT: f64 = 0.05;

/// What was found at a place: a and r.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Parts {
    pub(super) amount: f64,
    pub(super) rest: f64,
}

/// How parts become a loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Edge {
    /// U, in the loss's own unit; 0 where there is no edge.
    pub(super) unit_m: f64,
}

impl Edge {
    /// The parts of a loss.
    pub(super) fn parts(&self, amount: f64, loss: f64) -> Parts {
        Parts { amount, rest: loss - self.unit_m * (1.0 - amount).abs() }
    }

    /// The loss of parts.
    pub(super) fn loss(&self, parts: Parts) -> f64 {
        self.unit_m * (1.0 - parts.amount).abs() + parts.rest
    }
}

/// Places and what was found there.
#[derive(Clone, Debug, Default)]
pub(super) struct Known {
    pub(super) places: Vec<Vec<f64>>,
    pub(super) parts: Vec<Parts>,
}

impl Known {
    pub(super) fn push(&mut self, place: Vec<f64>, parts: Parts) {
        self.places.push(place);
        self.parts.push(parts);
    }

    /// The place with the lowest loss, and that.
    pub(super) fn best(&self, edge: &Edge) -> Option<(&Vec<f64>, f64)> {
        let (at, loss) = self.lowest(edge)?;
        Some((&self.places[at], loss))
    }

    fn lowest(&self, edge: &Edge) -> Option<(usize, f64)> {
        let losses = self.parts.iter().map(|parts| edge.loss(*parts));
        losses.enumerate().min_by(|a, b| a.1.total_cmp(&b.1))
    }

    pub(super) fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Of all places, the most that arrives.
    pub(super) fn most_arrives(&self) -> f64 {
        self.parts.iter().map(|parts| parts.amount).fold(0.0, f64::max)
    }

    /// Whether what arrives is off what is wanted by more than `part` of it, in the one with the lowest loss. Never where there is no edge.
    pub(super) fn is_off(&self, edge: &Edge, part: f64) -> bool {
        let off = |(at, _): (usize, f64)| (self.parts[at].amount - 1.0).abs() > part;
        edge.unit_m > 0.0 && self.lowest(edge).is_some_and(off)
    }

    /// So many of them, those with the lowest losses, in the order in which they came.
    pub(super) fn best_of(&self, most: usize, edge: &Edge) -> Self {
        let mut ranked: Vec<usize> = (0..self.places.len()).collect();
        ranked.sort_by(|a, b| edge.loss(self.parts[*a]).total_cmp(&edge.loss(self.parts[*b])));
        ranked.truncate(most);
        ranked.sort_unstable();
        let mut best = Self::default();
        ranked.into_iter().for_each(|at| best.push(self.places[at].clone(), self.parts[at]));
        best
    }

    fn of(&self, part: impl Fn(&Parts) -> f64) -> Vec<f64> {
        self.parts.iter().map(part).collect()
    }
}

/// Guesses of a and r.
#[derive(Clone, Debug)]
pub(super) struct Surrogate {
    edge: Edge,
    amount: Part,
    rest: Part,
}

/// Guesses of one of them.
#[derive(Clone, Debug)]
struct Part {
    coarse: GaussianProcess,
    shift: Option<Shift>,
}

impl Surrogate {
    /// Of what is known of the coarse world, at least one place, and of the one that counts; where there is one world only, that is
    /// `coarse`, and nothing is known of another.
    pub(super) fn fitted(edge: Edge, coarse: &Known, fine: &Known) -> Self {
        let part = |of: fn(&Parts) -> f64| {
            let coarse = GaussianProcess::fitted(&coarse.places, &coarse.of(of));
            let shift = Shift::between(&coarse, fine, of);
            Part { coarse, shift }
        };
        Self { edge, amount: part(|parts| parts.amount), rest: part(|parts| parts.rest) }
    }

    /// The same with more known, by the same lengths and noise.
    pub(super) fn with(&self, coarse: &Known, fine: &Known) -> Self {
        let part = |part: &Part, of: fn(&Parts) -> f64| {
            let coarse = part.coarse.like(&coarse.places, &coarse.of(of));
            let shift = Shift::between(&coarse, fine, of);
            Part { coarse, shift }
        };
        Self {
            edge: self.edge,
            amount: part(&self.amount, |parts| parts.amount),
            rest: part(&self.rest, |parts| parts.rest),
        }
    }

    /// What is most likely found at a place.
    pub(super) fn parts(&self, place: &[f64]) -> Parts {
        Parts { amount: self.amount.at(place).mean, rest: self.rest.at(place).mean }
    }

    /// The loss of that.
    #[cfg(test)]
    fn loss(&self, place: &[f64]) -> f64 {
        self.edge.loss(self.parts(place))
    }

    /// By how much the loss may be expected to fall below the best one, `draws` of two normal variables being what may be.
    pub(super) fn expected_gain(&self, place: &[f64], best: f64, draws: &[[f64; 2]]) -> f64 {
        self.expected(place, draws, |loss| (best - loss).max(0.0))
    }

    /// The loss that may be expected: the less is known of what arrives, the farther from the edge that is, so it is higher than that of
    /// what is most likely.
    pub(super) fn expected_loss(&self, place: &[f64], draws: &[[f64; 2]]) -> f64 {
        self.expected(place, draws, |loss| loss)
    }

    fn expected(&self, place: &[f64], draws: &[[f64; 2]], of: impl Fn(f64) -> f64) -> f64 {
        let (amount, rest) = (self.amount.at(place), self.rest.at(place));
        let drawn = |guess: &Guess, by: f64| guess.mean + by * guess.deviation;
        let one = |[a, r]: &[f64; 2]| {
            of(self.edge.loss(Parts { amount: drawn(&amount, *a), rest: drawn(&rest, *r) }))
        };
        draws.iter().map(one).sum::<f64>() / draws.len() as f64
    }
}

impl Part {
    fn at(&self, place: &[f64]) -> Guess {
        let coarse = self.coarse.at(place);
        let Some(shift) = &self.shift else { return coarse };
        let by = shift.at(place);
        // What is not known of the coarse world is not known of the other one either.
        let both = coarse.deviation * coarse.deviation + by.deviation * by.deviation;
        Guess { mean: coarse.mean + by.mean, deviation: libm::sqrt(both) }
    }
}

/// What the world that counts has more than the coarse one.
#[derive(Clone, Debug)]
struct Shift {
    places: Vec<Vec<f64>>,
    size: f64,
    factor: Factor,
    weights: Vec<f64>,
}

impl Shift {
    fn between(coarse: &GaussianProcess, fine: &Known, of: fn(&Parts) -> f64) -> Option<Self> {
        if fine.places.is_empty() {
            return None;
        }
        let more = |(place, parts): (&Vec<f64>, &Parts)| of(parts) - coarse.at(place).mean;
        let by: Vec<f64> = fine.places.iter().zip(&fine.parts).map(more).collect();
        let square = by.iter().map(|x| x * x).sum::<f64>() / by.len() as f64;
        let size = libm::sqrt(square).max(LEAST_SHIFT * coarse.deviation());
        let places = fine.places.clone();
        let noise = SHIFT_NOISE * SHIFT_NOISE;
        let factor =
            Factor::of(places.len(), |i, j| alike(&places[i], &places[j]) + if i == j { noise } else { 0.0 });
        let weights = factor.solve(&by);
        Some(Self { places, size, factor, weights })
    }

    fn at(&self, place: &[f64]) -> Guess {
        let near: Vec<f64> = self.places.iter().map(|x| alike(place, x)).collect();
        let left = alike(place, place) - self.factor.norm_squared(&near);
        Guess {
            mean: near.iter().zip(&self.weights).map(|(a, b)| a * b).sum(),
            deviation: self.size * libm::sqrt(left.max(0.0)),
        }
    }
}

fn alike(a: &[f64], b: &[f64]) -> f64 {
    SHIFT_EVERYWHERE + matern(a, b, &vec![SHIFT_LENGTH; a.len()])
}

#[cfg(test)]
mod tests {
    use super::*;

    const EDGE: Edge = Edge { unit_m: 100.0 };

    fn place(i: i32) -> Vec<f64> {
        let share = |by: f64| 2.0 * (f64::from(i) * by).fract() - 1.0;
        vec![share(0.754_877_666), share(0.569_840_290)]
    }

    /// What arrives rises with the first component; what is lost with the square of the second.
    fn parts(x: &[f64]) -> Parts {
        Parts { amount: 1.0 + 0.8 * x[0], rest: 20.0 + 30.0 * x[1] * x[1] }
    }

    fn known(count: i32, of: impl Fn(&[f64]) -> Parts) -> Known {
        let mut known = Known::default();
        for i in 1..=count {
            known.push(place(i), of(&place(i)));
        }
        known
    }

    #[test]
    fn a_loss_is_taken_apart_and_put_together() {
        for (amount, loss) in [(0.3, 90.0), (1.0, 20.0), (1.2, 45.0)] {
            assert!((EDGE.loss(EDGE.parts(amount, loss)) - loss).abs() < 1e-12);
        }
        assert!((EDGE.parts(0.8, 50.0).rest - 30.0).abs() < 1e-12);
    }

    #[test]
    fn the_edge_is_where_the_amount_arrives() {
        let surrogate = Surrogate::fitted(EDGE, &known(40, parts), &Known::default());
        let loss = |x: f64| surrogate.loss(&[x, 0.1]);
        let lowest = (-99..=99).map(|x| f64::from(x) / 100.0).min_by(|a, b| loss(*a).total_cmp(&loss(*b)));
        assert!(lowest.unwrap().abs() < 0.02, "{lowest:?}");
        // No smooth function is as pointed.
        assert!(loss(0.1) - loss(0.0) > 6.0 && loss(-0.1) - loss(0.0) > 6.0);
    }

    #[test]
    fn one_look_into_the_other_world_shifts_all_guesses() {
        let other = |x: &[f64]| Parts { amount: parts(x).amount + 0.1, rest: parts(x).rest + 3.0 };
        let mut fine = Known::default();
        fine.push(vec![0.2, 0.2], other(&[0.2, 0.2]));
        let surrogate = Surrogate::fitted(EDGE, &known(40, parts), &fine);
        for place in [[0.2, 0.2], [-0.3, 0.0], [0.5, -0.5]] {
            let (guess, right) = (surrogate.parts(&place), other(&place));
            assert!((guess.amount - right.amount).abs() < 0.04, "{guess:?} {right:?}");
            assert!((guess.rest - right.rest).abs() < 1.5, "{guess:?} {right:?}");
        }
    }

    #[test]
    fn gain_is_expected_where_it_may_be() {
        let surrogate = Surrogate::fitted(EDGE, &known(30, parts), &Known::default());
        let draws: Vec<[f64; 2]> =
            (0..64).map(|i| [libm::sin(f64::from(i)), libm::cos(f64::from(i))]).collect();
        let gain = |place: [f64; 2], best| surrogate.expected_gain(&place, best, &draws);
        assert!(gain([0.0, 0.0], 40.0) > 15.0 && gain([-1.0, 0.0], 40.0) < 1e-9);
        assert!(gain([0.0, 0.0], 10.0) < 1.0);
    }

    #[test]
    fn what_is_not_known_is_expected_to_cost() {
        let near = known(40, parts);
        let surrogate = Surrogate::fitted(EDGE, &near, &Known::default());
        let draws: Vec<[f64; 2]> =
            (0..64).map(|i| [1.4 * libm::sin(f64::from(i)), 1.4 * libm::cos(f64::from(i))]).collect();
        let dearer = |place: [f64; 2]| surrogate.expected_loss(&place, &draws) - surrogate.loss(&place);
        // At the edge, near what is known and far away from it.
        assert!(dearer([0.0, 0.1]) < 1.0, "{}", dearer([0.0, 0.1]));
        assert!(dearer([0.0, 5.0]) > 5.0 * dearer([0.0, 0.1]).max(0.1), "{}", dearer([0.0, 5.0]));
    }

    #[test]
    fn the_best_are_kept_in_their_order() {
        let known = known(30, parts);
        let best = known.best_of(5, &EDGE);
        assert_eq!(best.places.len(), 5);
        assert_eq!(best.best(&EDGE), known.best(&EDGE));
        let at: Vec<usize> =
            best.places.iter().map(|place| known.places.iter().position(|x| x == place).unwrap()).collect();
        assert!(at.is_sorted());
        let most = known.parts.iter().map(|parts| parts.amount).fold(0.0, f64::max);
        assert!(most > 1.5 && (known.most_arrives() - most).abs() < 1e-12 && !known.is_empty());
    }
}
