//! `optimise run` from Python, and the whole program.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError, mpsc};

use powderline_optimiser::cli::{self, CliError, MAX_EPOCHS, RunArgs};
use powderline_optimiser::optim::Method;
use pyo3::prelude::*;

use crate::command::{object_of, resources};
use crate::given;
use crate::scene::Scene;
use crate::simulator::{checked_precision, checked_seed};

fn checked_epochs(name: &str, count: &Bound<'_, PyAny>) -> PyResult<u32> {
    given::whole(name, count, 0..=i128::from(MAX_EPOCHS), &format!("from 0 to {MAX_EPOCHS}"))
}

fn checked_method(name: &Bound<'_, PyAny>) -> PyResult<Method> {
    let known: Vec<_> = Method::all().iter().map(|method| (method.name(), *method)).collect();
    given::word("method", name, &known)
}

/// As `optimise run`; the Python package makes a `Run` of what this returns. `on_epoch` gets each line of `metrics.jsonl`, `say` what
/// the program says.
#[pyfunction]
#[pyo3(signature = (scene, *, seed, method, epochs, patience, refine, precision, threads, memory, out, resume, on_epoch, say))]
#[expect(clippy::too_many_arguments, reason = "keywords")]
pub(crate) fn optimise<'py>(
    py: Python<'py>,
    scene: Option<Bound<'py, Scene>>,
    seed: Option<&Bound<'py, PyAny>>,
    method: Option<&Bound<'py, PyAny>>,
    epochs: Option<&Bound<'py, PyAny>>,
    patience: Option<&Bound<'py, PyAny>>,
    refine: bool,
    precision: Option<&Bound<'py, PyAny>>,
    threads: Option<&Bound<'py, PyAny>>,
    memory: &Bound<'py, PyAny>,
    out: Option<PathBuf>,
    resume: Option<PathBuf>,
    on_epoch: &Bound<'py, PyAny>,
    say: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let precision = precision.map(checked_precision).transpose()?.map(Into::into);
    let seed = seed.map(checked_seed).transpose()?;
    let method = method.map(checked_method).transpose()?;
    let epochs = epochs.map(|count| checked_epochs("epochs", count)).transpose()?;
    let patience = patience.map(|count| checked_epochs("patience", count)).transpose()?;
    let resources = resources(threads, memory)?;
    let arguments = RunArgs {
        scene: None,
        seed,
        method,
        epochs,
        patience,
        no_refine: !refine,
        precision,
        resources,
        out,
        resume,
        json: true,
    };
    let scene = scene.map(|scene| scene.get().0.clone());
    let (tell, told) = mpsc::channel::<String>();
    let told = Mutex::new(told);
    let on_epoch = on_epoch.clone().unbind();
    let look = |py: Python<'_>| -> PyResult<()> {
        let told = told.lock().unwrap_or_else(PoisonError::into_inner);
        told.try_iter().try_for_each(|line| on_epoch.call1(py, (line,)).map(drop))
    };
    object_of(py, say, look, |context| {
        // Nobody hears it where Python has raised something.
        match cli::run(&arguments, scene.as_ref(), &|line| drop(tell.send(line.to_owned())), context) {
            // A plan that misses is a result; it says so itself.
            Err(CliError::Missed(_)) => Ok(()),
            result => result,
        }
    })
}

/// The program `optimise`, with these arguments, its name first; returns its exit code.
#[pyfunction]
pub(crate) fn main(py: Python<'_>, arguments: Vec<String>) -> u8 {
    py.detach(|| cli::program(arguments))
}
