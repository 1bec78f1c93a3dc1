//! A command of the program `optimise`, for whoever calls it from Python.

use std::io::{self, Write};
use std::sync::{Arc, Mutex, PoisonError};

use powderline_optimiser::cli::{CliError, Context, Interrupt, Memory, Resources, Stream};
use pyo3::prelude::*;

use crate::simulator::{checked_threads, memory_bytes};
use crate::watched::meanwhile;
use crate::{errors, json};

/// What a command says, until Python prints it.
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

/// Threads and memory, as they were given.
pub(crate) fn resources(
    threads: Option<&Bound<'_, PyAny>>,
    memory: &Bound<'_, PyAny>,
) -> PyResult<Resources> {
    let threads = threads.map(checked_threads).transpose()?;
    Ok(Resources { threads, memory: Memory::Bytes(memory_bytes(memory)?) })
}

/// Runs a command that prints one JSON object, and returns that. Meanwhile `say` gets what the command says, `look` is called now and
/// then, and once more at the end; what either raises stops the command.
pub(crate) fn object_of<'py>(
    py: Python<'py>,
    say: &Bound<'py, PyAny>,
    look: impl Fn(Python<'_>) -> PyResult<()> + Sync,
    command: impl FnOnce(&mut Context<'_>) -> Result<(), CliError> + Send,
) -> PyResult<Bound<'py, PyAny>> {
    let (said, interrupt, mut found) = (Said::default(), Interrupt::default(), Vec::new());
    let (stop, say) = (interrupt.clone(), say.clone().unbind());
    let look = |py: Python<'_>| -> PyResult<()> {
        let text = said.take();
        if !text.is_empty() {
            say.call1(py, (text,))?;
        }
        look(py)
    };
    let job = || {
        command(&mut Context {
            factory: &|scene, setup| setup.simulator(scene),
            interrupt: interrupt.clone(),
            out: &mut found,
            err: Stream::new(said.clone()),
            live: false,
        })
    };
    let (result, raised) = meanwhile(py, job, || stop.request(), look);
    if let (Err(error), Err(_)) = (&result, &raised) {
        // How to go on.
        say.call1(py, (format!("{error}\n"),))?;
    }
    raised?;
    look(py)?;
    result.map_err(errors::of_command)?;
    let found: serde_json::Value = serde_json::from_slice(&found).expect("`--json` prints one object");
    json::to_python(py, &found)
}
