//! A simulator whose number format is chosen at run time, and whose motions may be made piece by piece.
//!
//! It is compiled here, once: whoever uses [`Simulator`] itself has the compiler make all of it once more, and so he would where
//! a function of this file were inlined.

use powderline_shared::{displacement::Displacement, plan::Precision, pose::Pose};

use super::{
    Evaluation, RolloutError, RolloutState, Simulate, Simulator, SimulatorSettings,
    gradcheck::{self, Window},
};
use crate::{scene::Scene, skill::SkillMap};

/// A [`Simulator`] of one of the number formats.
pub enum AnySimulator {
    /// In 32 bits.
    F32(Box<Simulator<f32>>),
    /// In 64 bits.
    F64(Box<Simulator<f64>>),
}

/// A [`RolloutState`] of one of the number formats.
pub enum AnyState {
    /// In 32 bits.
    F32(Box<RolloutState<f32>>),
    /// In 64 bits.
    F64(Box<RolloutState<f64>>),
}

impl AnySimulator {
    /// The simulator of a scene with the powder's state in numbers of this precision.
    ///
    /// # Errors
    /// See [`Simulator::new`].
    #[inline(never)]
    pub fn new(
        scene: &Scene,
        precision: Precision,
        settings: &SimulatorSettings,
    ) -> Result<Self, RolloutError> {
        Ok(match precision {
            Precision::F32 => Self::F32(Box::new(Simulator::new(scene, settings)?)),
            Precision::F64 => Self::F64(Box::new(Simulator::new(scene, settings)?)),
        })
    }

    /// What it does whatever its number format is.
    #[inline(never)]
    pub fn as_dyn(&mut self) -> &mut dyn Simulate {
        match self {
            Self::F32(simulator) => simulator.as_mut(),
            Self::F64(simulator) => simulator.as_mut(),
        }
    }

    /// See [`Simulator::begin`].
    ///
    /// # Errors
    /// See [`RolloutError`].
    #[inline(never)]
    pub fn begin(&mut self, anchor: &Pose) -> Result<AnyState, RolloutError> {
        Ok(match self {
            Self::F32(simulator) => AnyState::F32(Box::new(simulator.begin(anchor)?)),
            Self::F64(simulator) => AnyState::F64(Box::new(simulator.begin(anchor)?)),
        })
    }

    /// See [`Simulator::advance`]; what has been achieved if the motion ends then.
    ///
    /// # Errors
    /// See [`RolloutError`].
    ///
    /// # Panics
    /// If the state is one of another number format.
    #[inline(never)]
    pub fn advance(
        &mut self,
        state: &mut AnyState,
        controls: &[Displacement],
    ) -> Result<Evaluation, RolloutError> {
        match (self, state) {
            (Self::F32(simulator), AnyState::F32(state)) => {
                simulator.advance(state, controls).map(|()| simulator.judge(state))
            }
            (Self::F64(simulator), AnyState::F64(state)) => {
                simulator.advance(state, controls).map(|()| simulator.judge(state))
            }
            _ => panic!("a state of another number format"),
        }
    }

    /// Checks the gradient over the control steps from `start` to `end` against differences.
    ///
    /// # Errors
    /// See [`RolloutError`].
    #[inline(never)]
    pub fn check_window(&mut self, map: &SkillMap, start: u32, end: u32) -> Result<Window, RolloutError> {
        match self {
            Self::F32(simulator) => gradcheck::check_window(simulator, map, start, end),
            Self::F64(simulator) => gradcheck::check_window(simulator, map, start, end),
        }
    }
}

impl AnyState {
    /// See [`RolloutState::tool`].
    #[inline(never)]
    pub fn tool(&self) -> &Pose {
        match self {
            Self::F32(state) => state.tool(),
            Self::F64(state) => state.tool(),
        }
    }

    /// See [`RolloutState::positions_m`].
    #[inline(never)]
    pub fn positions_m(&self) -> Vec<[f32; 3]> {
        match self {
            Self::F32(state) => state.positions_m(),
            Self::F64(state) => state.positions_m(),
        }
    }

    /// See [`RolloutState::velocities_m_s`].
    #[inline(never)]
    pub fn velocities_m_s(&self) -> Vec<[f32; 3]> {
        match self {
            Self::F32(state) => state.velocities_m_s(),
            Self::F64(state) => state.velocities_m_s(),
        }
    }
}
