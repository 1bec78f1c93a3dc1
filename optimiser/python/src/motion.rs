//! A motion that was recorded.

use numpy::{PyArray1, PyArray2, PyArray3};
use powderline_simulator::rollout::Destination;
use pyo3::{exceptions::PyValueError, prelude::*};

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

/// What makes a motion again, and of what.
type Pickled<'py> = (Bound<'py, PyAny>, Parts);
type Parts =
    (Py<Evaluation>, Py<PyArray1<f64>>, Py<PyArray2<f64>>, Py<PyArray3<f32>>, Py<PyArray3<f32>>, Vec<u8>);

#[pymethods]
impl Motion {
    /// From what `__reduce__` gives.
    #[staticmethod]
    fn _of(
        evaluation: Py<Evaluation>,
        times_s: Bound<'_, PyArray1<f64>>,
        tool: Bound<'_, PyArray2<f64>>,
        positions_m: Bound<'_, PyArray3<f32>>,
        velocities_m_s: Bound<'_, PyArray3<f32>>,
        places: Vec<u8>,
    ) -> PyResult<Self> {
        let place = |place: &u8| {
            Destination::ALL
                .get(usize::from(*place))
                .copied()
                .ok_or_else(|| PyValueError::new_err(format!("{place} is no place where powder may be")))
        };
        Ok(Self {
            evaluation,
            times_s: times_s.unbind(),
            tool: tool.unbind(),
            positions_m: positions_m.unbind(),
            velocities_m_s: velocities_m_s.unbind(),
            destinations: places.iter().map(place).collect::<PyResult<_>>()?,
        })
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<Pickled<'py>> {
        let (py, motion) = (slf.py(), slf.get());
        let place =
            |here: &Destination| Destination::ALL.iter().position(|place| place == here).unwrap_or(0) as u8;
        let parts = (
            motion.evaluation.clone_ref(py),
            motion.times_s.clone_ref(py),
            motion.tool.clone_ref(py),
            motion.positions_m.clone_ref(py),
            motion.velocities_m_s.clone_ref(py),
            motion.destinations.iter().map(place).collect(),
        );
        Ok((slf.get_type().getattr("_of")?, parts))
    }

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
