//! A motion that was recorded.

use numpy::{PyArray1, PyArray2, PyArray3};
use powderline_simulator::rollout::Destination;
use pyo3::prelude::*;

use crate::evaluation::Evaluation;

/// A recorded motion: what it achieves, and the powder on its way.
#[pyclass(frozen, module = "powderline")]
pub(crate) struct Motion {
    /// What it achieves.
    #[pyo3(get)]
    pub(crate) evaluation: Py<Evaluation>,
    /// When each frame is, seconds since the motion's beginning; shape (frames,).
    #[pyo3(get)]
    pub(crate) times_s: Py<PyArray1<f64>>,
    /// The tool in each frame: x, y, z in metres, and the unit quaternion w, x, y, z; shape (frames, 7).
    #[pyo3(get)]
    pub(crate) tool: Py<PyArray2<f64>>,
    /// Particles in each frame, in the order of the packing, metres; shape (frames, particles, 3), 32 bits.
    #[pyo3(get)]
    pub(crate) positions_m: Py<PyArray3<f32>>,
    /// Their velocities, m/s; the same shape.
    #[pyo3(get)]
    pub(crate) velocities_m_s: Py<PyArray3<f32>>,
    pub(crate) destinations: Vec<Destination>,
}

#[pymethods]
impl Motion {
    /// Where each particle is at the end, in the order of the packing: source, target, rims, tool, spilled or in_flight.
    #[getter]
    fn destinations(&self) -> Vec<&'static str> {
        self.destinations.iter().map(|destination| destination.name()).collect()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let shape: Vec<usize> = self.positions_m.bind(py).as_any().getattr("shape")?.extract()?;
        let evaluation: String = self.evaluation.bind(py).as_any().repr()?.extract()?;
        Ok(format!("Motion({} frames of {} particles, {evaluation})", shape[0], shape[1]))
    }
}
