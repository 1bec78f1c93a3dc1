//! What a motion achieves.

use powderline_optimiser::report::{
    amounts::{Amounts, percent},
    finding::Outcome,
};
use powderline_simulator::{rollout, scene, scene::figures::mass};
use pyo3::prelude::*;

use crate::json;

/// What a motion achieves: how much powder it brings into the target container, and the loss.
#[pyclass(frozen, module = "powderline")]
pub(crate) struct Evaluation {
    amounts: Amounts,
    outcome: Outcome,
    /// Particles that are missing in the target container at the end; negative where there are too many.
    #[pyo3(get)]
    indicator: i64,
}

/// What makes an evaluation again, and of what.
type Pickled<'py> = (Bound<'py, PyAny>, ((f64, u32, Option<f64>, f64), [u32; 6], f64, i64));

/// What arrives of what is wanted, such as `1.208 g of 1.6 g (-24 %)`.
pub(crate) fn arrival(amounts: &Amounts, outcome: &Outcome) -> String {
    let Outcome { mass_kg, miss, .. } = *outcome;
    let sign = if miss > 0.0 { "+" } else { "" };
    format!("{} of {} ({sign}{})", mass(mass_kg), mass(amounts.wanted_kg), percent(miss))
}

impl Evaluation {
    pub(crate) fn new(scene: &scene::Scene, found: &rollout::Evaluation) -> Self {
        let amounts = Amounts::from(scene);
        Self { outcome: Outcome::of_evaluation(&amounts, found), amounts, indicator: found.indicator }
    }
}

#[pymethods]
impl Evaluation {
    /// Loss of the scene's objective, metres: what a search makes small. A sum over particles of how far each is from where it should be
    /// at the end, so that it grows with their number: with `objective.aim = "amount"` over those that are missing in the target,
    /// or are too many there, with "all" over all of them; and with `lost_weight` over those that are lost.
    #[getter]
    fn loss(&self) -> f64 {
        self.outcome.loss_m
    }

    /// What is in the target container at the end, kilogram.
    #[getter]
    fn mass_kg(&self) -> f64 {
        self.outcome.mass_kg
    }

    /// What is wanted there, kilogram.
    #[getter]
    fn wanted_kg(&self) -> f64 {
        self.amounts.wanted_kg
    }

    /// How far `mass_kg` is off `wanted_kg`, relative: negative where powder is missing.
    #[getter]
    fn miss(&self) -> f64 {
        self.outcome.miss
    }

    /// Whether the miss is within the scene's tolerance; None where as much as can be had is wanted.
    #[getter]
    fn met(&self) -> Option<bool> {
        self.amounts.is_met(self.outcome.census.target)
    }

    /// What is on rims, spilled or in flight at the end, kilogram; what stays in the source or on the tool is not lost.
    #[getter]
    fn lost_kg(&self) -> f64 {
        self.outcome.lost_kg
    }

    /// Particles by where they are at the end: source, target, rims, tool, spilled, in_flight.
    #[getter]
    fn census<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(py, &self.outcome.census)
    }

    fn __eq__(&self, other: &Bound<'_, PyAny>) -> bool {
        other.cast::<Self>().is_ok_and(|other| {
            let other = other.get();
            (self.amounts, self.outcome, self.indicator) == (other.amounts, other.outcome, other.indicator)
        })
    }

    fn __hash__(&self) -> u64 {
        self.outcome.loss_m.to_bits() ^ self.indicator as u64
    }

    /// From what `__reduce__` gives.
    #[staticmethod]
    fn _of(amounts: (f64, u32, Option<f64>, f64), census: [u32; 6], loss_m: f64, indicator: i64) -> Self {
        let (wanted_kg, wanted_particles, tolerance, particle_mass_kg) = amounts;
        let amounts = Amounts { wanted_kg, wanted_particles, tolerance, particle_mass_kg };
        let [source, target, rims, tool, spilled, in_flight] = census;
        let census = rollout::Census { source, target, rims, tool, spilled, in_flight };
        Self { outcome: Outcome::new(&amounts, census, loss_m), amounts, indicator }
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<Pickled<'py>> {
        let Self { amounts, outcome, indicator } = slf.get();
        let Amounts { wanted_kg, wanted_particles, tolerance, particle_mass_kg } = *amounts;
        let rollout::Census { source, target, rims, tool, spilled, in_flight } = outcome.census;
        let amounts = (wanted_kg, wanted_particles, tolerance, particle_mass_kg);
        let census = [source, target, rims, tool, spilled, in_flight];
        Ok((slf.get_type().getattr("_of")?, (amounts, census, outcome.loss_m, *indicator)))
    }

    fn __repr__(&self) -> String {
        let Outcome { lost_kg, loss_m, .. } = self.outcome;
        let arrival = arrival(&self.amounts, &self.outcome);
        format!("Evaluation({arrival}, {} lost, loss {loss_m:.3} m)", mass(lost_kg))
    }
}
