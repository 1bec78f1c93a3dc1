//! What moves, or comes to be gone, in the course of a rollout: the tool and the gates.
//!
//! The tool's motion is what a rollout is asked about, and has a cotangent. A gate's is prescribed in time: it has none, and
//! where a gate is depends on nothing but how many substeps of the motion are done, so that a rollout that goes on from any
//! state finds it where it was.

use crate::mpm::contact::BodyState;
use crate::real::Real;
use crate::scene::{Gate, Scene};

/// When a substep is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Moment {
    /// Before the motion, while the powder settles.
    Settling,
    /// In the motion, of which so many substeps are done.
    After(usize),
}

/// All that moves, in one substep.
#[derive(Clone, Debug)]
pub(crate) struct Bodies<T> {
    /// At the substep's end.
    pub(crate) tool: BodyState<T>,
    /// All gates of the scene.
    pub(crate) gates: Vec<GateState<T>>,
}

/// A gate in one substep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct GateState<T> {
    /// At the substep's end; where it was, if it is not there.
    pub(crate) motion: BodyState<T>,
    /// It stands in the powder's way.
    pub(crate) is_there: bool,
    /// It has just gone, or moves: powder near it wakes.
    pub(crate) stirs: bool,
}

/// Where a scene's gates are at any time.
#[derive(Clone, Debug)]
pub(crate) struct Gates {
    gates: Vec<Gate>,
    substep_s: f64,
}

impl Gates {
    pub(crate) fn new(scene: &Scene) -> Self {
        Self { gates: scene.gates.clone(), substep_s: scene.time.substep_s() }
    }

    /// All of them, in the substep that begins then.
    pub(crate) fn at<T: Real>(&self, moment: Moment) -> Vec<GateState<T>> {
        self.gates.iter().map(|gate| self.one_at(gate, moment)).collect()
    }

    fn one_at<T: Real>(&self, gate: &Gate, moment: Moment) -> GateState<T> {
        // A substep earlier, at its beginning and at its end.
        let [before, from, to] = match moment {
            Moment::Settling => [Some([0.0; 3]); 3],
            Moment::After(substeps) => {
                [-1.0, 0.0, 1.0].map(|more| gate.displacement_m((substeps as f64 + more) * self.substep_s))
            }
        };
        let place = to.or(from).unwrap_or_default();
        let moved = from.map_or([0.0; 3], |from| [0, 1, 2].map(|axis| place[axis] - from[axis]));
        let has_gone = from.is_none() && before.is_some();
        GateState {
            motion: BodyState {
                rotation: turned(gate.yaw_deg).map(|row| row.map(T::from_f64)),
                position: [0, 1, 2].map(|axis| T::from_f64(gate.position_m[axis] + place[axis])),
                velocity: moved.map(|along| T::from_f64(along / self.substep_s)),
                angular_velocity: [T::ZERO; 3],
            },
            is_there: from.is_some(),
            stirs: has_gone || moved.iter().any(|along| along.abs() > 0.0),
        }
    }
}

/// Rotation about the vertical.
pub(crate) fn turned(yaw_deg: f64) -> [[f64; 3]; 3] {
    let yaw = yaw_deg.to_radians();
    let (sin, cos) = (libm::sin(yaw), libm::cos(yaw));
    [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]
}
