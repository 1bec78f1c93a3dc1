//! The adjoint's gradient against differences of the loss.
//!
//! Three questions, in this order. Is the adjoint the derivative of the rollout? Central differences answer it
//! over short windows of the motion: with shrinking step their error falls until rounding takes over; the plateau
//! between is the proof. How does the agreement fare with a longer horizon? And is the derivative the slope that
//! an optimiser wants? Differences over a step of 0.1, smooth where the loss is rugged, answer that.
//!
//! A window starts from the state that the skill has reached there, and ends with the loss at its own end; the
//! parameters move the controls within it. The windows together hold the whole skill, so that every parameter is
//! at work in one of them.

use std::ops::Range;

use serde::Serialize;

use crate::real::Real;
use crate::rollout::{DisplacementGradient, Evaluation, RolloutError, Simulate, Simulator, Tick};
use crate::skill::{SkillMap, SkillParameter, Theta, ThetaGradient};

/// The skill at which gradients are checked: a middling scoop that reaches the target.
pub const CHECKED_THETA: Theta =
    Theta::MIDDLE.moved(SkillParameter::ScoopingDepth, 0.3).moved(SkillParameter::PouringAngle, 0.3);

/// Half-steps of the central differences.
pub const HALF_STEPS: [f64; 7] = [1e-3, 1e-4, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7];

/// Half-step of the smoothed differences.
const SMOOTH_HALF_STEP: f64 = 0.1;

/// One component of the gradient.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Component {
    /// Derivative by the adjoint, m.
    pub adjoint: f64,
    /// `(half-step, central difference)`.
    pub differences: Vec<(f64, f64)>,
    /// Smallest `|difference - adjoint|`, relative to the larger of the component itself and a thousandth of the
    /// gradient's length: a component that is nearly zero has no digits of its own. None if the parameter does not
    /// move the tool in the window.
    pub error: Option<f64>,
}

/// All five components over a stretch of the motion.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Window {
    /// First control step.
    pub start: u32,
    /// Control step after the last.
    pub end: u32,
    /// Loss at the end, m.
    pub loss: f64,
    /// Depth, scoop angle, lift, transport, pour angle.
    pub components: Vec<Component>,
    /// Largest error of the components.
    pub error: f64,
}

/// The gradient against the slope over a step that an optimiser might take.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Smoothed {
    /// Half-step in theta.
    pub half_step: f64,
    /// Gradient by the adjoint, m.
    pub adjoint: ThetaGradient,
    /// Central differences over the half-step, m.
    pub differences: ThetaGradient,
    /// Cosine of the angle between both.
    pub cosine: f64,
}

/// Checks the control steps from `start` to `end`.
///
/// # Errors
/// See [`RolloutError`].
pub(crate) fn check_window<T: Real>(
    simulator: &mut Simulator<T>,
    map: &SkillMap,
    start: u32,
    end: u32,
) -> Result<Window, RolloutError> {
    simulator.watched(|simulator, tick| checked(simulator, map, start as usize..end as usize, tick))
}

fn checked<T: Real>(
    simulator: &mut Simulator<T>,
    map: &SkillMap,
    stretch: Range<usize>,
    progress: Tick<'_>,
) -> Result<Window, RolloutError> {
    let linear = map.linearise(&CHECKED_THETA)?;
    let beginning = simulator.initial_state(progress)?;
    let from = simulator.advanced(&beginning, &linear.controls[..stretch.start], progress)?;
    let controls = linear.controls[stretch.clone()].to_vec();
    let in_stretch = |error: RolloutError| error.later_by(stretch.start);
    let (at, bars) = simulator.control_gradient(&from, &controls, progress).map_err(in_stretch)?;
    let mut by_displacement = vec![DisplacementGradient::default(); stretch.start];
    by_displacement.extend(bars.into_iter().map(DisplacementGradient::from));
    let gradient = linear.pull_back(&by_displacement);

    let length = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
    let mut components = Vec::new();
    for (parameter, adjoint) in SkillParameter::ALL.into_iter().zip(gradient) {
        let k = parameter.index();
        let at_work = linear.jacobian[stretch.clone()].iter().flatten().any(|row| row[k] != 0.0);
        let half_steps = if at_work { &HALF_STEPS[..] } else { &[] };
        let moved = |step: f64| -> Result<_, RolloutError> {
            let theta = CHECKED_THETA.moved(parameter, step);
            Ok(map.controls(&theta)?[stretch.clone()].to_vec())
        };
        let both_ways = half_steps.iter().flat_map(|h| [moved(*h), moved(-h)]);
        let motions = both_ways.collect::<Result<_, _>>()?;
        let ends = simulator.evaluate_motions(&from, motions, progress).map_err(in_stretch)?;
        let slope = |(h, pair): (&f64, &[Evaluation])| (*h, (pair[0].loss - pair[1].loss) / (2.0 * h));
        let differences: Vec<_> = half_steps.iter().zip(ends.chunks_exact(2)).map(slope).collect();
        let scale = adjoint.abs().max(1e-3 * length).max(f64::MIN_POSITIVE);
        let best = differences.iter().map(|(_, d)| (d - adjoint).abs() / scale).fold(f64::INFINITY, f64::min);
        components.push(Component { adjoint, differences, error: at_work.then_some(best) });
    }
    let error = components.iter().filter_map(|c| c.error).fold(0.0, f64::max);
    let (start, end) = (stretch.start as u32, stretch.end as u32);
    Ok(Window { start, end, loss: at.loss, components, error })
}

/// Compares the gradient of the scene as it is with differences over a large step.
///
/// # Errors
/// See [`RolloutError`].
pub fn smoothed(simulator: &mut dyn Simulate) -> Result<Smoothed, RolloutError> {
    let (_, adjoint) = simulator.evaluate_with_gradient(&CHECKED_THETA)?;
    let both_ways = SkillParameter::ALL.into_iter().flat_map(|parameter| {
        [SMOOTH_HALF_STEP, -SMOOTH_HALF_STEP].map(|step| CHECKED_THETA.moved(parameter, step))
    });
    let ends = simulator.evaluate_all(&both_ways.collect::<Vec<_>>())?;
    let differences: ThetaGradient =
        std::array::from_fn(|k| (ends[2 * k].loss - ends[2 * k + 1].loss) / (2.0 * SMOOTH_HALF_STEP));
    let dot = |a: &ThetaGradient, b: &ThetaGradient| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let cosine =
        dot(&adjoint, &differences) / (dot(&adjoint, &adjoint) * dot(&differences, &differences)).sqrt();
    Ok(Smoothed { half_step: SMOOTH_HALF_STEP, adjoint, differences, cosine })
}
