//! A motion that is made piece by piece.

use std::sync::{Mutex, PoisonError};

use numpy::{PyArray1, PyArray2};
use powderline_simulator::rollout::AnyState;
use pyo3::{PyTraverseError, PyVisit, exceptions::PyRuntimeError, prelude::*};

use crate::arrays::{self, Table};
use crate::evaluation::Evaluation;
use crate::simulator::Simulator;

/// A motion that is made piece by piece, by `Simulator.episode`. In pieces it comes to the same bits as whole. A simulator may have
/// several; each keeps its own powder.
#[pyclass(frozen, module = "powderline")]
pub(crate) struct Episode {
    simulator: Py<Simulator>,
    now: Mutex<Now>,
}

struct Now {
    state: AnyState,
    steps: usize,
}

impl Episode {
    pub(crate) fn new(simulator: Py<Simulator>, state: AnyState) -> Self {
        Self { simulator, now: Mutex::new(Now { state, steps: 0 }) }
    }

    /// What is known now; a step that is being made elsewhere is not waited for.
    fn now<R>(&self, look: impl FnOnce(&mut Now) -> R) -> PyResult<R> {
        let busy = |_| PyRuntimeError::new_err("this episode is making a step in another thread");
        let mut now = match self.now.try_lock() {
            Err(std::sync::TryLockError::Poisoned(now)) => PoisonError::into_inner(now),
            other => other.map_err(busy)?,
        };
        Ok(look(&mut now))
    }
}

#[pymethods]
impl Episode {
    /// Makes control steps, and says what has been achieved by then: an Evaluation, as if the motion ended there.
    ///
    /// displacements: as for `Simulator.motion`; shape (steps, 6). Where it raises, the powder is where it was, unless what raises comes
    /// when all is done, as Ctrl-C may: `time_s` tells.
    fn step(&self, py: Python<'_>, displacements: Table<'_>) -> PyResult<Evaluation> {
        let controls = arrays::displacements("displacements", &displacements)?;
        let simulator = self.simulator.get();
        let found = self.now(|now| {
            let Now { state, steps } = now;
            arrays::within(simulator.scene(), state.tool(), &controls)?;
            simulator.simulated(py, |s, _| {
                let found = s.advance(state, &controls)?;
                *steps += controls.len();
                Ok(found)
            })
        })??;
        Ok(simulator.evaluation(&found))
    }

    /// The simulator's `progress` may refer to whoever holds the episode.
    fn __traverse__(&self, visit: PyVisit<'_>) -> Result<(), PyTraverseError> {
        visit.call(&self.simulator)
    }

    /// Time since the motion began, seconds.
    #[getter]
    fn time_s(&self) -> PyResult<f64> {
        self.now(|now| now.steps as f64 * self.simulator.get().period_s())
    }

    /// The tool: x, y, z in metres, and the unit quaternion w, x, y, z; shape (7,).
    #[getter]
    fn tool<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(arrays::array(py, &self.now(|now| arrays::of_pose(now.state.tool()))?))
    }

    /// Particles in the order of the packing, metres; shape (particles, 3), 32 bits.
    #[getter]
    fn positions_m<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        Ok(arrays::table(py, self.now(|now| now.state.positions_m())?))
    }

    /// Their velocities, m/s; the same shape.
    #[getter]
    fn velocities_m_s<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        Ok(arrays::table(py, self.now(|now| now.state.velocities_m_s())?))
    }

    fn __repr__(&self) -> PyResult<String> {
        Ok(format!("Episode({:.3} s)", self.time_s()?))
    }
}
