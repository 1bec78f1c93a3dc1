//! What a run found, and `optimise report`, from Python.

use std::path::PathBuf;

use powderline_optimiser::cli::{self, ReportArgs};
use powderline_optimiser::report::record::RunRecord;
use pyo3::{exceptions::PyValueError, prelude::*};

use crate::command::{object_of, resources};

/// What the run in a folder found, as the program says it at the end; none before its first epoch.
#[pyfunction]
pub(crate) fn summary(folder: PathBuf) -> PyResult<Option<String>> {
    let record = RunRecord::read(&folder).map_err(|error| PyValueError::new_err(error.to_string()))?;
    Ok(record.finding().map(|finding| finding.text(record.skills())))
}

/// As `optimise report`; the Python package makes a `Report` of what this returns.
#[pyfunction]
#[pyo3(signature = (of, *, executed, out, replay, threads, memory, say))]
#[expect(clippy::too_many_arguments, reason = "keywords")]
pub(crate) fn report<'py>(
    py: Python<'py>,
    of: PathBuf,
    executed: Option<PathBuf>,
    out: Option<PathBuf>,
    replay: bool,
    threads: Option<&Bound<'py, PyAny>>,
    memory: &Bound<'py, PyAny>,
    say: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let resources = resources(threads, memory)?;
    let arguments =
        ReportArgs { of, executed, out, no_replay: !replay, obstacle: None, json: true, resources };
    object_of(py, say, |_| Ok(()), |context| cli::report(&arguments, context))
}
