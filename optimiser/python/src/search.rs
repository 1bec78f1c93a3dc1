//! `optimise run` from Python, and the whole program.

use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError, mpsc};

use powderline_optimiser::cli::{
    self, CliError, Context, Interrupt, MAX_EPOCHS, Memory, Resources, RunArgs, Stream,
};
use powderline_optimiser::optim::Method;
use pyo3::prelude::*;

use crate::scene::Scene;
use crate::simulator::{checked_precision, checked_seed, checked_threads, memory_bytes};
use crate::watched::meanwhile;
use crate::{errors, given, json};

/// What the search says, until Python prints it.
#[derive(Clone, Default)]
struct Said(Arc<Mutex<Vec<u8>>>);

impl Said {
    fn take(&self) -> String {
        let bytes = std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner));
        String::from_utf8_lossy(&bytes).into_owned()
    }
}

impl Write for Said {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

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
#[pyo3(signature = (scene, *, seed, method, epochs, patience, precision, threads, memory, out, resume, on_epoch, say))]
#[expect(clippy::too_many_arguments, reason = "keywords")]
pub(crate) fn optimise<'py>(
    py: Python<'py>,
    scene: Option<Bound<'py, Scene>>,
    seed: Option<&Bound<'py, PyAny>>,
    method: Option<&Bound<'py, PyAny>>,
    epochs: Option<&Bound<'py, PyAny>>,
    patience: Option<&Bound<'py, PyAny>>,
    precision: Option<&Bound<'py, PyAny>>,
    threads: Option<&Bound<'py, PyAny>>,
    memory: &Bound<'py, PyAny>,
    out: Option<PathBuf>,
    resume: Option<PathBuf>,
    on_epoch: &Bound<'py, PyAny>,
    say: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let precision = precision.map(checked_precision).transpose()?.map(Into::into);
    let threads = threads.map(checked_threads).transpose()?;
    let seed = seed.map(checked_seed).transpose()?;
    let method = method.map(checked_method).transpose()?;
    let epochs = epochs.map(|count| checked_epochs("epochs", count)).transpose()?;
    let patience = patience.map(|count| checked_epochs("patience", count)).transpose()?;
    let resources = Resources { threads, memory: Memory::Bytes(memory_bytes(memory)?) };
    let arguments = RunArgs {
        scene: None,
        seed,
        method,
        epochs,
        patience,
        precision,
        resources,
        out,
        resume,
        json: true,
    };
    let scene = scene.map(|scene| scene.get().0.clone());
    let (said, interrupt, mut found) = (Said::default(), Interrupt::default(), Vec::new());
    let (tell, told) = mpsc::channel::<String>();
    let told = Mutex::new(told);
    let stop = interrupt.clone();
    let (on_epoch, say) = (on_epoch.clone().unbind(), say.clone().unbind());
    let look = |py: Python<'_>| -> PyResult<()> {
        let text = said.take();
        if !text.is_empty() {
            say.call1(py, (text,))?;
        }
        for line in told.lock().unwrap_or_else(PoisonError::into_inner).try_iter() {
            on_epoch.call1(py, (line,))?;
        }
        Ok(())
    };
    let job = || {
        let mut context = Context {
            factory: &|scene, setup| setup.simulator(scene),
            interrupt: interrupt.clone(),
            out: &mut found,
            err: Stream::new(said.clone()),
            live: false,
        };
        // Nobody hears it where Python has raised something.
        cli::run(&arguments, scene.as_ref(), &|line| drop(tell.send(line.to_owned())), &mut context)
    };
    let (result, raised) = meanwhile(py, job, || stop.request(), look);
    if let (Err(error), Err(_)) = (&result, &raised) {
        // How to go on.
        say.call1(py, (format!("{error}\n"),))?;
    }
    raised?;
    look(py)?;
    match result {
        // A plan that misses is a result; it says so itself.
        Ok(()) | Err(CliError::Missed(_)) => {}
        Err(error) => return Err(errors::of_command(error)),
    }
    let found: serde_json::Value = serde_json::from_slice(&found).expect("`--json` prints one object");
    json::to_python(py, &found)
}

/// The program `optimise`, with these arguments, its name first; returns its exit code.
#[pyfunction]
pub(crate) fn main(py: Python<'_>, arguments: Vec<String>) -> u8 {
    py.detach(|| cli::program(arguments))
}
