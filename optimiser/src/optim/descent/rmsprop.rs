//! RMSprop, with three changes.
//!
//! | symbol | identifier      | equation                                              |
//! |--------|-----------------|-------------------------------------------------------|
//! | v      | `mean_square`   | v' = beta v + (1 - beta) g^2                          |
//! | v^     | `corrected`     | v^ = v' / (1 - beta^n), n updates of the component    |
//! | s      | `noise`         | standard deviation of g                               |
//! | k      | `kept`          | k = g max(0, 1 - s^2 / g^2)                           |
//! | r      | `rate`          | r' = r / 2 if k changes sign, else min(1, 1.2 r)      |
//! | Theta  | `theta`         | Theta' = clamp(Theta - lr r' k / (sqrt(v^) + eps))    |
//!
//! The gradient is neither clipped nor rescaled: a step is at most
//! lr / sqrt(1 - beta) in any component whatever the gradient's size.
//!
//! The paper has v for v^, g for k, and r = 1. Without the correction for the mean's start from zero (Kingma and Ba 2015, "Adam",
//! section 3) the first step of each component is lr / sqrt(1 - beta), three times as long as those that follow, in a
//! direction that a single gradient has given. And the division by the root of v makes a component whose gradient is all
//! noise wander as fast as one that leads somewhere; k is the positive-part James-Stein estimate of the slope behind a
//! measured g, and stands still there. Last, where the loss has an edge and not a valley (one particle too few costs as much
//! as one too many), steps as long as the slope is steep go to and fro across it for ever: a component whose slope changes
//! sign has gone too far and halves its steps, and lengthens them again while it goes on in one direction. That is the rule
//! of Rprop (Riedmiller and Braun 1993), which RMSprop descends from.

use crate::optim::SearchError;
use powderline_shared::plan::SkillParameter;
use powderline_simulator::skill::{Theta, ThetaGradient};

/// What becomes of a component's steps when its slope changes sign, and when it does not.
const SHORTENED: f64 = 0.5;
const LENGTHENED: f64 = 1.2;

/// The update rule.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RmsProp {
    /// Decay of the running mean of the squared gradient.
    pub beta: f64,
    /// Learning rate.
    pub learning_rate: f64,
    /// Added to the root of the running mean.
    pub epsilon: f64,
}

impl Default for RmsProp {
    /// The paper's, with steps five times as long.
    fn default() -> Self {
        Self { beta: 0.9, learning_rate: 0.25, epsilon: 1e-8 }
    }
}

/// What the updates of one component hand on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Running mean of the squared gradient.
    pub mean_square: f64,
    /// Length of the steps, 1 at first.
    pub rate: f64,
    /// The slope that the last step went along; 0 before the first.
    pub slope: f64,
}

impl Pace {
    /// Before the first update.
    pub const START: Self = Self { mean_square: 0.0, rate: 1.0, slope: 0.0 };
}

/// All that one update hands to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RmsPropState {
    /// Skill parameters.
    pub theta: Theta,
    /// How far each of them goes.
    pub paces: [Pace; 5],
    /// Updates made.
    pub updates: u32,
    /// How many of them before the search began anew, from another theta.
    pub before_restart: u32,
}

impl RmsPropState {
    /// Before the first update.
    pub fn new(theta: Theta) -> Self {
        Self { theta, paces: [Pace::START; 5], updates: 0, before_restart: 0 }
    }

    /// Anew from another theta: nothing is known of the slopes there.
    pub(super) fn restarted(&self, theta: Theta) -> Self {
        Self { theta, paces: [Pace::START; 5], updates: self.updates, before_restart: self.updates }
    }
}

impl RmsProp {
    /// One update; `noise` is the standard deviation of each component of the gradient, 0 where it is exact or not known.
    ///
    /// # Errors
    /// A component of the gradient that takes part, or its square, is not finite.
    pub fn update(
        &self,
        state: &RmsPropState,
        gradient: &ThetaGradient,
        noise: &[f64; 5],
    ) -> Result<RmsPropState, SearchError> {
        let mut next = RmsPropState { updates: state.updates + 1, ..*state };
        for (parameter, &g) in SkillParameter::ALL.into_iter().zip(gradient) {
            let index = parameter.index();
            let (pace, step) = self
                .step(&state.paces[index], g, noise[index], next.updates - state.before_restart)
                .ok_or_else(|| SearchError::Gradient { parameter: parameter.name().into(), value: g })?;
            next.paces[index] = pace;
            next.theta = next.theta.moved(parameter, -step);
        }
        Ok(next)
    }

    /// How far the `updates`-th update of a component takes it down the gradient `g`; none if the mean square is not finite.
    fn step(&self, pace: &Pace, g: f64, noise: f64, updates: u32) -> Option<(Pace, f64)> {
        let mean_square = self.beta * pace.mean_square + (1.0 - self.beta) * g * g;
        let corrected = mean_square / (1.0 - libm::pow(self.beta, f64::from(updates)));
        let slope = kept(g, noise);
        let rate = rate(pace.rate, pace.slope, slope);
        let step = self.learning_rate * rate * slope / (libm::sqrt(corrected) + self.epsilon);
        // What stands still has not turned.
        let slope = if slope == 0.0 { pace.slope } else { slope };
        mean_square.is_finite().then_some((Pace { mean_square, rate, slope }, step))
    }
}

/// What of a measured slope is likely to be one.
fn kept(g: f64, noise: f64) -> f64 {
    // No slope has no sign either.
    if g.abs() > noise { g * (1.0 - (noise / g) * (noise / g)) } else { 0.0 }
}

/// Length of the next step, after one along the slope `last`.
fn rate(rate: f64, last: f64, slope: f64) -> f64 {
    match last * slope {
        turned if turned < 0.0 => SHORTENED * rate,
        onwards if onwards > 0.0 => (LENGTHENED * rate).min(1.0),
        _ => rate,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RULE: RmsProp = RmsProp { beta: 0.9, learning_rate: 0.05, epsilon: 1e-8 };

    const EXACT: [f64; 5] = [0.0; 5];

    fn begun(theta: [f64; 5]) -> RmsPropState {
        RmsPropState::new(Theta::new(theta).unwrap())
    }

    fn theta(state: &RmsPropState) -> [f64; 5] {
        state.theta.components()
    }

    #[test]
    fn follows_the_equations() {
        let noise = [0.0, 1.0, 2.0, 0.0, 0.0];
        let first = RULE.update(&begun([0.0; 5]), &[2.0; 5], &noise).unwrap();
        // The mean of one gradient is its square.
        let step = 0.05 * 2.0 / (2.0 + 1e-8);
        assert!((theta(&first)[0] + step).abs() < 1e-15 && (first.paces[0].mean_square - 0.4).abs() < 1e-15);
        // Half the gradient is noise: a quarter less is kept. All of it: nothing.
        assert!(
            (theta(&first)[1] + 0.75 * step).abs() < 1e-15
                && (first.paces[1].mean_square - 0.4).abs() < 1e-15
        );
        assert_eq!(theta(&first)[2].to_bits(), 0.0f64.to_bits());
        let second = RULE.update(&first, &[-1.0; 5], &noise).unwrap();
        // The slope has turned.
        let step = 0.5 * 0.05 / ((0.46f64 / (1.0 - 0.81)).sqrt() + 1e-8);
        assert!((theta(&second)[0] - theta(&first)[0] - step).abs() < 1e-15);
    }

    #[test]
    fn noise_stands_still_where_a_slope_goes_on() {
        let mut state = begun([0.0; 5]);
        for n in 0..20 {
            let dice = 3.0 * libm::sin(f64::from(n * n));
            state = RULE.update(&state, &[dice, 8.0 + dice, 0.0, 0.0, 0.0], &[3.0; 5]).unwrap();
        }
        assert!(theta(&state)[0].abs() < 1e-12 && theta(&state)[1] < -0.7, "{state:?}");
    }

    #[test]
    fn comes_to_rest_at_an_edge() {
        let rule = RmsProp { learning_rate: 0.25, ..RULE };
        let mut state = begun([-0.9, 0.9, -0.5, 0.8, 1.0]);
        for _ in 0..25 {
            let gradient = theta(&state).map(|x| if x > 0.123 { 7.0 } else { -7.0 });
            state = rule.update(&state, &gradient, &EXACT).unwrap();
        }
        assert!(theta(&state).iter().all(|x| (x - 0.123).abs() < 0.02), "{state:?}");
    }

    #[test]
    fn steps_grow_again_but_not_beyond_the_first() {
        assert!((rate(0.5, 1.0, 3.0) - 0.6).abs() < 1e-15 && (rate(0.9, -1.0, -3.0) - 1.0).abs() < 1e-15);
        assert!((rate(0.5, 0.0, 3.0) - 0.5).abs() < 1e-15 && (rate(0.5, -1.0, 0.0) - 0.5).abs() < 1e-15);
    }

    #[test]
    fn gradient_that_is_not_finite_is_named() {
        let error = RULE.update(&begun([0.0; 5]), &[0.0, f64::NAN, 0.0, 0.0, 0.0], &EXACT).unwrap_err();
        assert_eq!(error.to_string(), "the gradient with respect to the scooping angle is NaN");
        assert!(RULE.update(&begun([0.0; 5]), &[1e200; 5], &EXACT).is_err());
    }

    #[test]
    fn descends_a_quadratic_from_anywhere() {
        let minimum = [0.3, -0.2, 0.5, -0.6, 0.1];
        let rule = RmsProp { learning_rate: 0.01, ..RULE };
        let mut state = begun([-0.9, 0.9, -0.5, 0.8, 1.0]);
        for _ in 0..400 {
            let gradient = std::array::from_fn(|k| 2.0 * (theta(&state)[k] - minimum[k]));
            state = rule.update(&state, &gradient, &EXACT).unwrap();
        }
        assert!(
            theta(&state).iter().zip(minimum).all(|(found, wanted)| (found - wanted).abs() < 0.02),
            "{state:?}"
        );
    }

    proptest! {
        #[test]
        fn theta_stays_in_its_range_and_steps_are_bounded(
            start in prop::array::uniform5(-1.0..=1.0f64),
            gradients in prop::collection::vec(prop::array::uniform5(-1e6..1e6f64), 1..50),
        ) {
            let mut state = begun(start);
            for gradient in gradients {
                let next = RULE.update(&state, &gradient, &EXACT).unwrap();
                for (new, old) in theta(&next).iter().zip(theta(&state)) {
                    prop_assert!((-1.0..=1.0).contains(new));
                    prop_assert!((new - old).abs() <= 0.05 / 0.1f64.sqrt() + 1e-12);
                }
                state = next;
            }
        }
    }
}
