//! A Gaussian process: what a function of a few variables may be, by its values at some places.
//!
//! | symbol | identifier | meaning |
//! |--------|------------|---------|
//! | x, y   | `places`, `values` | where it is known, each component from -1 to 1, and what it is there; z: less the mean, over the deviation |
//! | l_k    | `lengths`  | how far apart places are, along component k, that tell little of each other |
//! | n      | `noise`    | variance of what is measured, over that of the function |
//! | s^2    | `variance` | variance of the function |
//! | K      | `factor`   | K_ij = k(x_i, x_j) + n (i = j), as its Cholesky factor |
//!
//! ```text
//! k(x, x') = (1 + r + r^2/3) exp(-r),   r^2 = 5 sum ((x_k - x'_k)/l_k)^2          Matern's, nu = 5/2
//! mean(x)  = k(x)^T K^-1 z              variance(x) = s^2 (1 - k(x)^T K^-1 k(x))
//! ```
//!
//! (Rasmussen and Williams 2006, "Gaussian Processes for Machine Learning", equations 2.25, 2.26, 4.17.) Lengths and noise are those under
//! which the values are most likely (equation 2.30, with s^2 = z^T K^-1 z / count, which is most likely given the rest), times a prior that is
//! wide: the logarithm of a length is around that of half the range, within a factor of two, that of the noise around a hundredth, within
//! one of four and a half.
//!
//! Sums have one order and functions come from `libm`, so that the same values give the same bits everywhere.

/// Least noise: values are rounded.
const LEAST_NOISE: f64 = 1e-3;

/// Noise that the search for lengths and noise begins with.
const STARTS: [f64; 2] = [USUAL_NOISE, 0.2];

/// Noise in the middle of the prior.
const USUAL_NOISE: f64 = 1e-2;

/// Steps of the search for lengths and noise, in their logarithms: the first, and the one that is not halved any more.
const STEPS: [f64; 2] = [0.8, 0.1];

/// A deviation below this is none: all values are the same.
const LEAST_DEVIATION: f64 = 1e-12;

/// What is known of a function.
#[derive(Clone, Debug)]
pub(super) struct GaussianProcess {
    places: Vec<Vec<f64>>,
    lengths: Vec<f64>,
    noise: f64,
    /// Mean and deviation of the values.
    mean: f64,
    deviation: f64,
    variance: f64,
    factor: Factor,
    /// K^-1 z.
    weights: Vec<f64>,
}

/// A value that may be, and how far off it may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Guess {
    pub(super) mean: f64,
    pub(super) deviation: f64,
}

impl GaussianProcess {
    /// Of values at places, at least one, with the lengths and the noise that make them most likely.
    pub(super) fn fitted(places: &[Vec<f64>], values: &[f64]) -> Self {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let deviation = libm::sqrt(values.iter().map(|y| (y - mean) * (y - mean)).sum::<f64>() / count);
        let deviation = if deviation > LEAST_DEVIATION { deviation } else { 1.0 };
        let scaled: Vec<f64> = values.iter().map(|y| (y - mean) / deviation).collect();
        let dimensions = places[0].len();
        // What looks like noise may be a function of short lengths: both are looked at.
        let found = STARTS.map(|noise| {
            let start = [vec![0.0; dimensions], vec![libm::log(noise)]].concat();
            lowest(start, |logarithms| unlikeliness(places, &scaled, logarithms))
        });
        let [(smooth, of_smooth), (noisy, of_noisy)] = found;
        let (lengths, noise) = settings(if of_noisy < of_smooth { &noisy } else { &smooth });
        let factor =
            Factor::of(places.len(), |i, j| covariance(&places[i], &places[j], &lengths, noise, i == j));
        let weights = factor.solve(&scaled);
        let variance = dot(&scaled, &weights) / count;
        Self { places: places.to_vec(), lengths, noise, mean, deviation, variance, factor, weights }
    }

    /// With the lengths and the noise of another one.
    pub(super) fn like(&self, places: &[Vec<f64>], values: &[f64]) -> Self {
        let Self { mean, deviation, variance, noise, .. } = *self;
        let lengths = self.lengths.clone();
        let scaled: Vec<f64> = values.iter().map(|y| (y - mean) / deviation).collect();
        let factor =
            Factor::of(places.len(), |i, j| covariance(&places[i], &places[j], &lengths, noise, i == j));
        let weights = factor.solve(&scaled);
        Self { places: places.to_vec(), lengths, noise, mean, deviation, variance, factor, weights }
    }

    /// Deviation of the values that it was fitted to.
    pub(super) fn deviation(&self) -> f64 {
        self.deviation
    }

    /// What it may be at a place, without noise.
    pub(super) fn at(&self, place: &[f64]) -> Guess {
        let near: Vec<f64> = self.places.iter().map(|x| matern(place, x, &self.lengths)).collect();
        let left = 1.0 - self.factor.norm_squared(&near);
        Guess {
            mean: self.mean + self.deviation * dot(&near, &self.weights),
            deviation: self.deviation * libm::sqrt(self.variance * left.max(0.0)),
        }
    }
}

/// The logarithms' lengths and noise.
fn settings(logarithms: &[f64]) -> (Vec<f64>, f64) {
    let (noise, lengths) = logarithms.split_last().expect("a noise at the least");
    (lengths.iter().map(|x| libm::exp(*x)).collect(), LEAST_NOISE + libm::exp(*noise))
}

/// Minus the logarithm of how likely the values are, and of the prior.
fn unlikeliness(places: &[Vec<f64>], scaled: &[f64], logarithms: &[f64]) -> f64 {
    let (lengths, noise) = settings(logarithms);
    let factor = Factor::of(places.len(), |i, j| covariance(&places[i], &places[j], &lengths, noise, i == j));
    let count = scaled.len() as f64;
    let variance = (factor.norm_squared(scaled) / count).max(1e-9);
    let (of_noise, of_lengths) = logarithms.split_last().expect("a noise at the least");
    let square = |x: f64| 0.5 * x * x;
    let prior = of_lengths.iter().map(|x| square(x / 0.7)).sum::<f64>()
        + square((of_noise - libm::log(USUAL_NOISE)) / 1.5);
    0.5 * count * libm::log(variance) + factor.half_log_determinant() + prior
}

fn covariance(a: &[f64], b: &[f64], lengths: &[f64], noise: f64, same: bool) -> f64 {
    matern(a, b, lengths) + if same { noise } else { 0.0 }
}

/// Matern's covariance of two places, 1 for the same.
pub(super) fn matern(a: &[f64], b: &[f64], lengths: &[f64]) -> f64 {
    let away = |((a, b), length): ((&f64, &f64), &f64)| (a - b) / length * ((a - b) / length);
    let r = libm::sqrt(5.0 * a.iter().zip(b).zip(lengths).map(away).sum::<f64>());
    (1.0 + r + r * r / 3.0) * libm::exp(-r)
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Goes along each component in turn, to and fro, and halves its steps where that leads nowhere (Hooke and Jeeves 1961, without their
/// pattern moves).
fn lowest(mut at: Vec<f64>, of: impl Fn(&[f64]) -> f64) -> (Vec<f64>, f64) {
    let [mut step, least] = STEPS;
    let mut value = of(&at);
    while step >= least {
        let before = value;
        for k in 0..at.len() {
            for sign in [1.0, -1.0] {
                let mut moved = at.clone();
                moved[k] += sign * step;
                let there = of(&moved);
                if there < value {
                    (at, value) = (moved, there);
                    break;
                }
            }
        }
        if before - value < 1e-3 {
            step *= 0.5;
        }
    }
    (at, value)
}

/// A lower triangle L with L L^T a covariance matrix.
#[derive(Clone, Debug)]
pub(super) struct Factor(Vec<Vec<f64>>);

impl Factor {
    /// Cholesky's, row by row.
    pub(super) fn of(count: usize, entry: impl Fn(usize, usize) -> f64) -> Self {
        let mut rows: Vec<Vec<f64>> = Vec::with_capacity(count);
        for i in 0..count {
            let mut row: Vec<f64> = Vec::with_capacity(i + 1);
            for (j, other) in rows.iter().enumerate() {
                row.push((entry(i, j) - dot(&row, &other[..j])) / other[j]);
            }
            let left = entry(i, i) - dot(&row, &row);
            // Noise keeps it above that, but for rounding.
            row.push(libm::sqrt(left.max(1e-12)));
            rows.push(row);
        }
        Self(rows)
    }

    /// L^-1 b.
    fn forward(&self, b: &[f64]) -> Vec<f64> {
        let mut out: Vec<f64> = Vec::with_capacity(b.len());
        for (row, b) in self.0.iter().zip(b) {
            let i = out.len();
            out.push((b - dot(&row[..i], &out)) / row[i]);
        }
        out
    }

    /// b^T (L L^T)^-1 b.
    pub(super) fn norm_squared(&self, b: &[f64]) -> f64 {
        let y = self.forward(b);
        dot(&y, &y)
    }

    /// (L L^T)^-1 b.
    pub(super) fn solve(&self, b: &[f64]) -> Vec<f64> {
        let mut out = self.forward(b);
        for i in (0..out.len()).rev() {
            out[i] /= self.0[i][i];
            let x = out[i];
            for (j, below) in out[..i].iter_mut().enumerate() {
                *below -= self.0[i][j] * x;
            }
        }
        out
    }

    fn half_log_determinant(&self) -> f64 {
        self.0.iter().enumerate().map(|(i, row)| libm::log(row[i])).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places that fill a square evenly.
    fn places(count: i32) -> Vec<Vec<f64>> {
        let share = |i: i32, by: f64| 2.0 * (f64::from(i) * by).fract() - 1.0;
        (1..=count).map(|i| vec![share(i, 0.754_877_666), share(i, 0.569_840_290)]).collect()
    }

    fn known(count: i32, of: impl Fn(&[f64]) -> f64) -> GaussianProcess {
        let places = places(count);
        let values: Vec<f64> = places.iter().map(|place| of(place)).collect();
        GaussianProcess::fitted(&places, &values)
    }

    #[test]
    fn a_smooth_function_is_guessed_between_its_places() {
        let of = |x: &[f64]| 3.0 + libm::sin(2.0 * x[0]) - x[0] * x[1];
        let known = known(40, of);
        for place in [[0.13, -0.41], [-0.6, 0.5], [0.8, 0.2]] {
            let guess = known.at(&place);
            assert!((guess.mean - of(&place)).abs() < 0.05, "{place:?}: {guess:?} for {}", of(&place));
            assert!(guess.deviation < 0.1, "{guess:?}");
        }
        // Where nothing is near, little is known.
        assert!(known.at(&[4.0, 4.0]).deviation > 5.0 * known.at(&[0.13, -0.41]).deviation);
    }

    #[test]
    fn what_does_not_count_has_a_long_length() {
        let known = known(40, |x| libm::sin(3.0 * x[0]));
        assert!(known.lengths[1] > 2.0 * known.lengths[0], "{:?}", known.lengths);
    }

    #[test]
    fn noise_is_told_from_the_function() {
        let dice = |x: &[f64]| {
            let hashed = 43_758.545 * libm::sin(12.9898 * x[0] + 78.233 * x[1]);
            2.0 * (hashed - libm::floor(hashed)) - 1.0
        };
        let noisy = known(60, |x| x[0] + 0.3 * dice(x));
        let smooth = known(60, |x| x[0]);
        assert!(noisy.noise > 10.0 * smooth.noise, "{} {}", noisy.noise, smooth.noise);
        assert!((noisy.at(&[0.5, 0.0]).mean - 0.5).abs() < 0.2);
    }

    #[test]
    fn one_value_and_values_that_are_all_the_same_are_guessed_everywhere() {
        let one = GaussianProcess::fitted(&[vec![0.0, 0.0]], &[7.0]);
        assert!((one.at(&[0.5, 0.5]).mean - 7.0).abs() < 1e-9);
        let flat = known(10, |_| 2.0).at(&[0.3, 0.3]);
        assert!((flat.mean - 2.0).abs() < 1e-9 && flat.deviation.is_finite());
    }

    #[test]
    fn more_that_is_known_keeps_lengths_and_changes_guesses() {
        let known = known(20, |x| x[0]);
        let mut places = known.places.clone();
        let mut values: Vec<f64> = places.iter().map(|place| place[0]).collect();
        places.push(vec![0.5, 0.5]);
        values.push(3.0);
        let more = known.like(&places, &values);
        assert_eq!(more.lengths, known.lengths);
        assert!(more.at(&[0.5, 0.5]).mean > known.at(&[0.5, 0.5]).mean + 0.3);
    }

    #[test]
    fn a_factor_solves() {
        let entry = |i: usize, j: usize| if i == j { 3.0 } else { 1.0 / (1.0 + i.abs_diff(j) as f64) };
        let factor = Factor::of(6, entry);
        let b: Vec<f64> = (0..6).map(|i| f64::from(i) - 2.0).collect();
        let x = factor.solve(&b);
        for (i, b) in b.iter().enumerate() {
            let sum: f64 = x.iter().enumerate().map(|(j, x)| entry(i, j) * x).sum();
            assert!((sum - b).abs() < 1e-12);
        }
        let along: f64 = b.iter().zip(&x).map(|(b, x)| b * x).sum();
        assert!((factor.norm_squared(&b) - along).abs() < 1e-12);
    }
}
