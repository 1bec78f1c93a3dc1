//! What happens at the cuts of a restarted adjoint: where a gradient that is off gets that from.

use nalgebra::Vector3;
use serde::Serialize;

use crate::rollout::path::PoseBar;
use crate::rollout::{DisplacementGradient, Evaluation, outcome::AT_REST_M_S};
use crate::skill::ThetaGradient;

/// A restarted gradient, and how it came about.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Restarted {
    /// As of a rollout.
    pub evaluation: Evaluation,
    /// Derivative of the loss with respect to theta, metres.
    pub gradient: ThetaGradient,
    /// The cuts, from the motion's beginning to its end.
    pub cuts: Vec<CutReport>,
    /// What the controls between cuts bring to the gradient, metres: those before the first cut first.
    pub shares: Vec<ThetaGradient>,
    /// The derivative with respect to each displacement, the others held.
    pub by_displacement: Vec<DisplacementGradient>,
}

impl Restarted {
    /// Of a simulator of one's own, which restarts nowhere.
    #[must_use]
    pub fn new(evaluation: Evaluation, gradient: ThetaGradient) -> Self {
        Self { evaluation, gradient, cuts: Vec::new(), shares: Vec::new(), by_displacement: Vec::new() }
    }
}

/// What happened at one cut.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CutReport {
    /// Control step that begins at the cut.
    pub step: usize,
    /// Cotangent of the tool's pose as the exact adjoint of the stretch after the cut leaves it: metres per metre, metres per radian.
    pub tool_before: [f64; 6],
    /// The one that the adjoint goes on with.
    pub tool_after: [f64; 6],
    /// Grains on the tool.
    pub carried: Population,
    /// Others that move faster than 0.05 m/s.
    pub moving: Population,
    /// All others.
    pub resting: Population,
}

/// Cotangents of the positions of some grains.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Population {
    /// How many.
    pub grains: u32,
    /// Sum of the exact adjoint's, metres per metre.
    pub exact: [f64; 3],
    /// Sum of the slopes that take their place.
    pub slopes: [f64; 3],
    /// The largest of the exact adjoint's.
    pub largest_exact: f64,
    /// The largest slope.
    pub largest_slope: f64,
}

impl CutReport {
    pub(super) fn new(step: usize, pose: &PoseBar) -> Self {
        Self { step, tool_before: pose.components(), ..Self::default() }
    }

    pub(super) fn population(&mut self, carried: bool, velocity: &[f64; 3]) -> &mut Population {
        if carried {
            &mut self.carried
        } else if Vector3::from(*velocity).norm() > AT_REST_M_S {
            &mut self.moving
        } else {
            &mut self.resting
        }
    }
}

impl Population {
    pub(super) fn take(&mut self, exact: &Vector3<f64>, slope: &Vector3<f64>) {
        self.grains += 1;
        for axis in 0..3 {
            self.exact[axis] += exact[axis];
            self.slopes[axis] += slope[axis];
        }
        self.largest_exact = self.largest_exact.max(exact.norm());
        self.largest_slope = self.largest_slope.max(slope.norm());
    }
}
