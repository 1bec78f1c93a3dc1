//! What stands for the gradient: the adjoint alone, central differences of the loss alone, or both mixed.
//!
//! The adjoint is exact but heavy-tailed: a grain balanced on the rim amplifies perturbations a thousandfold, and its
//! derivative is a correct answer to the wrong question. The slope over a distance at which such grains average out
//! is what a search wants. [`Source::Mixed`] weighs the two by their measured variances, component by
//! component (Suh, Simchowitz, Zhang, Tedrake 2022, "Do differentiable simulators give better policy gradients?").
//! [`Source::Restarted`] does the same with the adjoint that restarts, which trades the variance for a bias
//! ([`powderline_simulator::rollout::restart`]):
//!
//! | symbol  | meaning                                                                                      |
//! |---------|----------------------------------------------------------------------------------------------|
//! | g1      | first order: the adjoint                                                                     |
//! | g0      | zeroth order: (L(theta + h e) - L(theta - h e)) / distance, both ends clamped to [-1, 1]     |
//! | sigma   | shot noise of the loss: median of abs(L(+) - 2 L(0) + L(-)) / (0.6745 sqrt 6)                |
//! | s0^2    | variance of g0: 2 sigma^2 / distance^2                                                       |
//! | s1^2    | error of g1: mean of (g1 - g0)^2 over the measured epochs, this one included, - s0^2, >= 0   |
//! | alpha   | weight of g1: s0^2 / (s0^2 + s1^2)                                                           |
//! | g       | alpha g1 + (1 - alpha) g0                                                                    |
//! | s       | standard deviation of g: sqrt(alpha) s1 where both are known, s0 of g0 alone, 0 of g1 alone  |
//!
//! An outlier of g1 enters s1 before it is weighed, so that it weighs itself down. Sigma comes from evaluations that
//! are made anyway, those of the last epochs and of all components. Curvature counts as noise there, which the
//! median keeps in bounds and which is harmless where it does not: it makes s0 at most the change of the slope over
//! 0.43 h, and a g1 as close to g0 as that is as good as any. Ends that were clamped tell nothing about sigma, and
//! neither do rollouts that were the same to the last bit; with no measurement at all, sigma is 0 and g is g0.
//!
//! Work is saved where two measurements in a row allow it, for at most [`REMEASURE_EPOCHS`] from the last one:
//!
//! - A component with alpha above [`TRUSTED_WEIGHT`] needs no differences, g is g1; unless g1 surprises, that is
//!   differs from the component's last g by more than abs(g) + 5 s0. Then it is measured at once, because a single
//!   outlier in RMSprop's running mean would stop the component for dozens of epochs.
//! - If alpha is below [`USELESS_WEIGHT`] in all components, no adjoint is computed, g is g0.

use super::WIDEST_HALF_STEP;
use crate::optim::Adjoint;
use powderline_simulator::skill::{SkillParameter, Theta, ThetaGradient};

/// The adjoint alone suffices where its weight was above this.
pub const TRUSTED_WEIGHT: f64 = 0.5;

/// The adjoint is not worth its computing where its weight was below this.
pub const USELESS_WEIGHT: f64 = 0.1;

/// Epochs from one measurement of the weight to the next, at most.
pub const REMEASURE_EPOCHS: u32 = 5;

/// Measurements in a row that must agree before work is saved.
const AGREEING: u32 = 2;

/// How far beyond the component's last gradient a trusted adjoint may lie, in standard deviations of g0.
const SURPRISE: f64 = 5.0;

/// Second differences that the shot noise is taken from: those of three epochs of five components.
const RESIDUALS: usize = 15;

const COMPONENTS: usize = SkillParameter::ALL.len();

/// Median of the absolute value of a normal variable, in standard deviations.
const MEDIAN_OF_NORMAL: f64 = 0.6745;

/// What stands for the gradient of the loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The exact adjoint.
    Exact,
    /// The exact adjoint and central differences, weighted in every component by their measured variances.
    Mixed,
    /// The adjoint that restarts and central differences, weighted likewise.
    Restarted,
    /// Central differences.
    Differences,
}

impl Source {
    /// The adjoint that it takes.
    pub(super) fn adjoint(self) -> Option<Adjoint> {
        match self {
            Self::Exact | Self::Mixed => Some(Adjoint::Exact),
            Self::Restarted => Some(Adjoint::Restarted),
            Self::Differences => None,
        }
    }
}

/// How the gradient is estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimator {
    /// From what.
    pub gradient: Source,
    /// Half-step of the central differences, in units of theta.
    pub half_step: f64,
}

/// All that the estimate of one epoch hands to the next.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EstimatorState {
    /// The latest second differences of the loss, absolute, metres, oldest first.
    residuals: Vec<f64>,
    components: [Trust; 5],
}

/// What is known about the adjoint in one component.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Trust {
    /// Epochs in which adjoint and differences were both computed.
    measurements: u32,
    /// The last of them.
    measured_at: u32,
    /// Mean over them of (g1 - g0)^2.
    mean_square: f64,
    /// How many of them in a row, to the last, had a weight above [`TRUSTED_WEIGHT`].
    trusted: u32,
    /// How many of them in a row, to the last, had a weight below [`USELESS_WEIGHT`].
    useless: u32,
    /// The gradient that was used last.
    gradient: f64,
}

/// Where the gradient is wanted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Epoch.
    pub epoch: u32,
    /// Skill parameters.
    pub theta: Theta,
}

/// A point near theta whose loss is needed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Probe {
    /// The component that differs.
    pub component: usize,
    /// The point; only one component differs from the place's.
    pub theta: Theta,
}

impl Place {
    fn value(&self, component: usize) -> f64 {
        self.theta.components()[component]
    }
}

impl Probe {
    /// Of the component that differs.
    fn value(&self) -> f64 {
        self.theta.components()[self.component]
    }
}

/// What was found at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Findings<'a> {
    /// Loss at theta, metres.
    pub loss: f64,
    /// The adjoint, if it was wanted.
    pub adjoint: Option<ThetaGradient>,
    /// The loss at each of the probes, metres.
    pub probes: &'a [f64],
}

/// The gradient, and where it comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// What the step uses.
    pub gradient: ThetaGradient,
    /// Its standard deviation, as far as it is known; 0 otherwise.
    pub noise: [f64; 5],
    /// The adjoint, where it was computed.
    pub adjoint: [Option<f64>; 5],
    /// The central differences, where they were computed.
    pub differences: [Option<f64>; 5],
    /// Weight of the adjoint in `gradient`.
    pub first_order_weight: [f64; 5],
}

/// A central difference.
#[derive(Clone, Copy)]
struct Difference {
    slope: f64,
    distance: f64,
    /// Absolute second difference, if it tells something about the shot noise.
    residual: Option<f64>,
}

impl Estimator {
    /// With differences over 2^`ring` times the distance; none where there are no differences, or where they would be too wide.
    pub(super) fn widened(&self, ring: usize) -> Option<Self> {
        let half_step = self.half_step * libm::exp2(ring as f64);
        let is_right = ring == 0 || half_step <= WIDEST_HALF_STEP * (1.0 + 1e-9);
        (self.gradient != Source::Exact && is_right).then_some(Self { half_step, ..*self })
    }

    /// Whether the adjoint has to be computed.
    pub fn wants_adjoint(&self, state: &EstimatorState, place: &Place) -> bool {
        let useless = |trust: &Trust| trust.useless >= AGREEING && trust.is_fresh(place.epoch);
        match self.gradient {
            Source::Exact => true,
            Source::Differences => false,
            _ => !state.components.iter().all(useless),
        }
    }

    /// The points whose losses have to be computed, once it is known what the adjoint is (`None` if it is not
    /// wanted, or not known yet: what it may surprise with is then left out).
    pub fn probes(
        &self,
        state: &EstimatorState,
        place: &Place,
        adjoint: Option<&ThetaGradient>,
    ) -> Vec<Probe> {
        if self.gradient == Source::Exact {
            return Vec::new();
        }
        (0..COMPONENTS)
            .filter(|&k| !self.adjoint_suffices(state, place, k, adjoint.map(|adjoint| adjoint[k])))
            .flat_map(|component| self.ends(place, component).map(|theta| Probe { component, theta }))
            // At a bound one of the ends is theta itself.
            .filter(|probe| probe.value().to_bits() != place.value(probe.component).to_bits())
            .collect()
    }

    /// Whether a component needs no differences; `g1` is its adjoint, if that is known.
    fn adjoint_suffices(
        &self,
        state: &EstimatorState,
        place: &Place,
        component: usize,
        g1: Option<f64>,
    ) -> bool {
        let trust = &state.components[component];
        let allowed =
            trust.gradient.abs() + SURPRISE * libm::sqrt(state.variance(self.distance(place, component)));
        trust.trusted >= AGREEING
            && trust.is_fresh(place.epoch)
            && g1.is_none_or(|g1| (g1 - trust.gradient).abs() <= allowed)
    }

    /// Lower and upper end of the difference.
    fn ends(&self, place: &Place, component: usize) -> [Theta; 2] {
        [-self.half_step, self.half_step].map(|step| place.theta.moved(SkillParameter::ALL[component], step))
    }

    /// How far apart they are.
    fn distance(&self, place: &Place, component: usize) -> f64 {
        let [low, high] = self.ends(place, component).map(|end| end.components()[component]);
        high - low
    }

    /// What comes of the findings: the gradient, and the state for the next epoch. Components that have neither an
    /// adjoint nor probes come out as 0.
    pub fn combine(
        &self,
        state: &EstimatorState,
        place: &Place,
        found: &Findings<'_>,
    ) -> (Estimate, EstimatorState) {
        let probes = self.probes(state, place, found.adjoint.as_ref());
        let differences: [Option<Difference>; 5] =
            std::array::from_fn(|k| self.difference(place, k, &probes, found));
        let mut next = state.clone();
        next.keep(differences.iter().flatten().filter_map(|difference| difference.residual));
        let mut estimate = Estimate {
            gradient: found.adjoint.unwrap_or_default(),
            noise: [0.0; 5],
            adjoint: found.adjoint.map_or([None; 5], |adjoint| adjoint.map(Some)),
            differences: differences.map(|difference| difference.map(|difference| difference.slope)),
            first_order_weight: [0.0; 5],
        };
        for (k, difference) in differences.iter().enumerate() {
            let weighed = next.weigh(place.epoch, k, estimate.adjoint[k], difference.as_ref());
            estimate.gradient[k] = weighed.gradient;
            estimate.noise[k] = weighed.noise;
            estimate.first_order_weight[k] = weighed.weight;
            next.components[k].gradient = weighed.gradient;
        }
        (estimate, next)
    }

    /// A component's difference, if there are probes for it.
    fn difference(
        &self,
        place: &Place,
        component: usize,
        probes: &[Probe],
        found: &Findings<'_>,
    ) -> Option<Difference> {
        let mut losses = [found.loss; 2];
        let mut probed = false;
        for (probe, &loss) in
            probes.iter().zip(found.probes).filter(|(probe, _)| probe.component == component)
        {
            losses[usize::from(probe.value() > place.value(component))] = loss;
            probed = true;
        }
        let distance = self.distance(place, component);
        let second = (losses[1] - 2.0 * found.loss + losses[0]).abs();
        let whole = place.value(component).abs() + self.half_step <= 1.0;
        probed.then(|| Difference {
            slope: (losses[1] - losses[0]) / distance,
            distance,
            residual: (whole && second > 0.0).then_some(second),
        })
    }
}

impl EstimatorState {
    /// The same noise elsewhere, where nothing is known of the adjoint.
    pub(super) fn elsewhere(&self) -> Self {
        Self { components: [Trust::default(); 5], residuals: self.residuals.clone() }
    }

    /// Keeps second differences, the latest of them.
    fn keep(&mut self, residuals: impl Iterator<Item = f64>) {
        self.residuals.extend(residuals);
        let surplus = self.residuals.len().saturating_sub(RESIDUALS);
        self.residuals.drain(..surplus);
    }

    /// Variance of a difference of two losses, divided by their distance in theta.
    fn variance(&self, distance: f64) -> f64 {
        // A second difference has six times the variance of a loss, a first difference twice.
        let deviation = median(&self.residuals) / MEDIAN_OF_NORMAL / distance;
        deviation * deviation / 3.0
    }

    /// The gradient in a component.
    fn weigh(
        &mut self,
        epoch: u32,
        component: usize,
        adjoint: Option<f64>,
        difference: Option<&Difference>,
    ) -> Weighed {
        let variance = difference.map_or(0.0, |difference| self.variance(difference.distance));
        match (adjoint, difference) {
            (Some(g1), Some(difference)) => {
                let g0 = difference.slope;
                let weight = self.components[component].measure(epoch, g1 - g0, variance);
                // alpha s1^2 = (1 - alpha) s0^2
                let noise = libm::sqrt((1.0 - weight) * variance);
                Weighed { gradient: weight * g1 + (1.0 - weight) * g0, noise, weight }
            }
            (Some(g1), None) => Weighed { gradient: g1, noise: 0.0, weight: 1.0 },
            (None, Some(difference)) => {
                Weighed { gradient: difference.slope, noise: libm::sqrt(variance), weight: 0.0 }
            }
            (None, None) => Weighed { gradient: 0.0, noise: 0.0, weight: 0.0 },
        }
    }
}

/// A component's gradient, its standard deviation, and the weight of the adjoint in it.
struct Weighed {
    gradient: f64,
    noise: f64,
    weight: f64,
}

impl Trust {
    fn is_fresh(&self, epoch: u32) -> bool {
        epoch.saturating_sub(self.measured_at) < REMEASURE_EPOCHS
    }

    /// Takes how far adjoint and difference are apart, and the difference's variance; gives the adjoint's weight.
    fn measure(&mut self, epoch: u32, apart: f64, variance: f64) -> f64 {
        self.measurements += 1;
        self.measured_at = epoch;
        self.mean_square += (apart * apart - self.mean_square) / f64::from(self.measurements);
        // s0^2 + s1^2 with s1^2 = max(mean - s0^2, 0).
        let sum = self.mean_square.max(variance);
        let weight = if sum > 0.0 { variance / sum } else { 1.0 };
        self.trusted = if weight > TRUSTED_WEIGHT { self.trusted + 1 } else { 0 };
        self.useless = if weight < USELESS_WEIGHT { self.useless + 1 } else { 0 };
        weight
    }
}

/// The median; 0 of nothing.
fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => 0.0,
        length => 0.5 * (sorted[(length - 1) / 2] + sorted[length / 2]),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{RmsProp, RmsPropState};
    use super::*;
    use rand_chacha::{
        ChaCha8Rng,
        rand_core::{Rng, SeedableRng},
    };

    const MIXED: Estimator = Estimator { gradient: Source::Mixed, half_step: 0.1 };
    const ADJOINT: Estimator = Estimator { gradient: Source::Exact, half_step: 0.1 };
    const MINIMUM: [f64; 5] = [0.3, -0.2, 0.5, -0.4, 0.1];

    /// A quadratic with shot noise of 1 m, as the simulated bench has it.
    struct Bench {
        rng: ChaCha8Rng,
        /// Scale of the adjoint's error in each component; its distribution is Cauchy's, without mean or variance.
        tail: [f64; 5],
        forward: usize,
        adjoint: usize,
    }

    impl Bench {
        fn new(seed: u64, tail: [f64; 5]) -> Self {
            Self { rng: ChaCha8Rng::seed_from_u64(seed), tail, forward: 0, adjoint: 0 }
        }

        /// In (0, 1).
        fn uniform(&mut self) -> f64 {
            ((self.rng.next_u64() >> 12) as f64 + 0.5) * f64::EPSILON
        }

        fn loss(&mut self, theta: &Theta) -> f64 {
            self.forward += 1;
            let noise: f64 = (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0;
            let components = theta.components();
            1200.0
                + noise
                + components.iter().zip(MINIMUM).map(|(x, m)| 50.0 * (x - m) * (x - m)).sum::<f64>()
        }

        fn adjoint(&mut self, theta: &Theta) -> ThetaGradient {
            self.adjoint += 1;
            let theta = theta.components();
            std::array::from_fn(|k| {
                let cauchy = libm::tan(std::f64::consts::PI * (self.uniform() - 0.5));
                100.0 * (theta[k] - MINIMUM[k]) + self.tail[k] * cauchy
            })
        }

        fn estimate(
            &mut self,
            estimator: &Estimator,
            state: &EstimatorState,
            place: &Place,
        ) -> (Estimate, EstimatorState) {
            let loss = self.loss(&place.theta);
            let adjoint = estimator.wants_adjoint(state, place).then(|| self.adjoint(&place.theta));
            let probes = estimator.probes(state, place, adjoint.as_ref());
            let losses: Vec<_> = probes.iter().map(|probe| self.loss(&probe.theta)).collect();
            estimator.combine(state, place, &Findings { loss, adjoint, probes: &losses })
        }

        /// Estimates at one place, epoch after epoch.
        fn estimates(&mut self, components: [f64; 5], epochs: u32) -> Vec<Estimate> {
            let mut state = EstimatorState::default();
            (0..epochs)
                .map(|epoch| {
                    let (estimate, next) = self.estimate(&MIXED, &state, &place(epoch, components));
                    state = next;
                    estimate
                })
                .collect()
        }

        /// Distance from the minimum after a search.
        fn search(&mut self, estimator: &Estimator, epochs: u32) -> f64 {
            let rule = RmsProp { learning_rate: 0.05, ..RmsProp::default() };
            let mut state = EstimatorState::default();
            let mut search = RmsPropState::new(Theta::new([-0.6, 0.7, -0.5, 0.5, -0.8]).unwrap());
            for epoch in 0..epochs {
                let (estimate, next) =
                    self.estimate(estimator, &state, &Place { epoch, theta: search.theta });
                state = next;
                search = rule.update(&search, &estimate.gradient, &estimate.noise).unwrap();
            }
            search.theta.components().iter().zip(MINIMUM).map(|(x, m)| (x - m).abs()).fold(0.0, f64::max)
        }
    }

    fn place(epoch: u32, components: [f64; 5]) -> Place {
        Place { epoch, theta: Theta::new(components).unwrap() }
    }

    #[test]
    fn mixed_search_arrives_where_the_adjoint_alone_does_not() {
        for seed in 0..10 {
            let tail = [300.0, 300.0, 300.0, 0.5, 0.5];
            let mixed = Bench::new(seed, tail).search(&MIXED, 60);
            let adjoint = Bench::new(seed, tail).search(&ADJOINT, 60);
            assert!(mixed < 0.15 && adjoint > 0.4, "seed {seed}: {mixed} and {adjoint}");
        }
    }

    #[test]
    fn clean_adjoint_takes_over() {
        let (mut saved, mut weight) = (0, 0.0);
        for seed in 0..10 {
            let mut bench = Bench::new(seed, [0.0; 5]);
            let estimates = bench.estimates([-0.5; 5], 40);
            let weights = estimates.last().unwrap().first_order_weight;
            weight += weights.iter().sum::<f64>() / 50.0;
            saved += 11 * 40 - bench.forward;
        }
        assert!(weight > 0.8, "{weight}");
        assert!(saved > 10 * 40 * 5, "half of the differences should be saved: {saved}");
    }

    #[test]
    fn heavy_tailed_adjoint_is_ignored() {
        for seed in 0..10 {
            let mut bench = Bench::new(seed, [300.0; 5]);
            let estimates = bench.estimates([-0.5; 5], 40);
            for estimate in &estimates[3..] {
                let weights = estimate.first_order_weight;
                assert!(weights.iter().all(|&weight| weight < 0.1), "seed {seed}: {weights:?}");
                for (k, (g, m)) in estimate.gradient.iter().zip(MINIMUM).enumerate() {
                    let slope = 100.0 * (-0.5 - m);
                    assert!((g - slope).abs() < 60.0, "seed {seed}, component {k}: {g} for {slope}");
                }
            }
            assert!(bench.adjoint <= 14, "most adjoints should be saved: {}", bench.adjoint);
        }
    }

    /// A state in which everything is known about all components.
    fn known(apart: f64) -> EstimatorState {
        let mut state = EstimatorState { residuals: vec![2.0; 3], ..EstimatorState::default() };
        let variance = state.variance(0.2);
        for trust in &mut state.components {
            for epoch in 8..10 {
                trust.measure(epoch, apart, variance);
            }
            trust.gradient = 10.0;
        }
        state
    }

    #[test]
    fn trusted_components_are_measured_again_in_time_or_when_they_surprise() {
        let state = known(1.0);
        let adjoint = [12.0; 5];
        for epoch in 10..14 {
            let place = place(epoch, [0.0; 5]);
            assert!(MIXED.wants_adjoint(&state, &place));
            assert!(MIXED.probes(&state, &place, Some(&adjoint)).is_empty());
        }
        assert_eq!(MIXED.probes(&state, &place(14, [0.0; 5]), Some(&adjoint)).len(), 10);
        let surprising = [12.0, -17344.0, 12.0, 0.0, 0.0];
        let probes = MIXED.probes(&state, &place(10, [0.0; 5]), Some(&surprising));
        assert_eq!(probes.iter().map(|probe| probe.component).collect::<Vec<_>>(), [1, 1]);
    }

    #[test]
    fn surprise_weighs_itself_down() {
        let state = known(1.0);
        let at = place(10, [0.0; 5]);
        let adjoint = Some([12.0, -17344.0, 12.0, 12.0, 12.0]);
        let (estimate, next) =
            MIXED.combine(&state, &at, &Findings { loss: 100.0, adjoint, probes: &[99.0, 101.0] });
        assert!((estimate.gradient[1] - 10.0).abs() < 0.1, "{:?}", estimate.gradient);
        assert_eq!((next.components[1].trusted, next.components[0].trusted), (0, 2));
    }

    #[test]
    fn useless_adjoint_is_skipped_and_computed_again_in_time() {
        let state = known(1000.0);
        for (epoch, wanted) in [(10, false), (13, false), (14, true)] {
            let place = place(epoch, [0.0; 5]);
            assert_eq!(MIXED.wants_adjoint(&state, &place), wanted, "epoch {epoch}");
            assert_eq!(MIXED.probes(&state, &place, None).len(), 10);
        }
        let mut doubtful = state.clone();
        doubtful.components[4].useless = 1;
        assert!(MIXED.wants_adjoint(&doubtful, &place(10, [0.0; 5])), "one component may still use it");
        let losses = [99.0, 101.0, 99.0, 103.0, 101.0, 99.0, 100.0, 100.0, 98.0, 100.0];
        let found = Findings { loss: 100.0, adjoint: None, probes: &losses };
        let (estimate, next) = MIXED.combine(&state, &place(10, [0.0; 5]), &found);
        let expected = [10.0, 20.0, -10.0, 0.0, 10.0];
        assert!(estimate.gradient.iter().zip(expected).all(|(g, e)| (g - e).abs() < 1e-9), "{estimate:?}");
        assert_eq!(estimate.adjoint, [None; 5]);
        assert!(estimate.first_order_weight.iter().all(|weight| *weight == 0.0));
        // Nothing was measured.
        assert_eq!(next.components.map(|trust| trust.measured_at), [9; 5]);
    }

    #[test]
    fn ends_are_clamped_and_the_distance_is_the_actual_one() {
        let at = place(0, [1.0, -0.95, 0.0, 0.0, 0.0]);
        let state = EstimatorState::default();
        let probes = MIXED.probes(&state, &at, None);
        let ends: Vec<_> = probes.iter().map(|probe| (probe.component, probe.value())).collect();
        assert_eq!(ends[..5], [(0, 0.9), (1, -1.0), (1, -0.95 + 0.1), (2, -0.1), (2, 0.1)]);
        let loss = |theta: &Theta| {
            let [depth, scoop, lift, ..] = theta.components();
            3.0 * depth - 2.0 * scoop + lift * lift
        };
        let losses: Vec<_> = probes.iter().map(|probe| loss(&probe.theta)).collect();
        let found = Findings { loss: loss(&at.theta), adjoint: Some([5.0; 5]), probes: &losses };
        let (estimate, next) = MIXED.combine(&state, &at, &found);
        let slopes = [3.0, -2.0, 0.0, 0.0, 0.0];
        assert!(
            estimate.differences.iter().flatten().zip(slopes).all(|(d, s)| (d - s).abs() < 1e-9),
            "{:?}",
            estimate.differences
        );
        // Clamped ends say nothing about the noise, and neither does what does not change.
        assert_eq!(next.residuals.len(), 1);
    }

    #[test]
    fn without_any_noise_measured_the_differences_decide() {
        let at = place(0, [0.0; 5]);
        let found = Findings {
            loss: 1.0,
            adjoint: Some([7.0, 0.0, 0.0, 0.0, 0.0]),
            probes: &[0.5, 1.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0],
        };
        let (estimate, _) = MIXED.combine(&EstimatorState::default(), &at, &found);
        let weights = estimate.first_order_weight;
        assert!(weights[0].abs() < 1e-15 && weights[1..].iter().all(|weight| (weight - 1.0).abs() < 1e-15));
        assert!((estimate.gradient[0] - 5.0).abs() < 1e-12);
    }

    #[test]
    fn shot_noise_is_found_in_spite_of_curvature() {
        let mut bench = Bench::new(3, [300.0; 5]);
        let mut state = EstimatorState::default();
        for epoch in 0..20 {
            state = bench.estimate(&MIXED, &state, &place(epoch, [0.2; 5])).1;
        }
        let deviation = libm::sqrt(state.variance(0.2));
        assert!((4.0..14.0).contains(&deviation), "{deviation} where 7.07 is right");
        assert_eq!(state.residuals.len(), RESIDUALS);
    }

    #[test]
    fn adjoint_alone_is_passed_on() {
        let mut bench = Bench::new(1, [300.0; 5]);
        let (estimate, _) = bench.estimate(&ADJOINT, &EstimatorState::default(), &place(0, [0.0; 5]));
        assert_eq!(
            estimate.adjoint.map(Option::unwrap).map(f64::to_bits),
            estimate.gradient.map(f64::to_bits)
        );
        assert_eq!(estimate.differences, [None; 5]);
        assert_eq!((bench.forward, bench.adjoint), (1, 1));
    }
}
