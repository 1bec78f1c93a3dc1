//! Long work: without Python's lock, with Ctrl-C and progress.

use std::sync::{
    Mutex, TryLockError,
    atomic::{AtomicBool, AtomicU64, Ordering},
    mpsc::{RecvTimeoutError, channel},
};
use std::{ops::ControlFlow, sync::Arc, thread, time::Duration};

use powderline_simulator::rollout::{AnySimulator, RolloutError};
use pyo3::{exceptions::PyRuntimeError, prelude::*};

use crate::errors;

/// From one look at Python's signals to the next.
const LOOK: Duration = Duration::from_millis(50);

/// What the thread that works and the one that Python waits in tell each other.
#[derive(Clone, Default)]
pub(crate) struct Link(Arc<(AtomicBool, AtomicU64)>);

impl Link {
    /// Asks the work to stop.
    pub(crate) fn stop(&self) {
        self.0.0.store(true, Ordering::Relaxed);
    }

    fn told(&self, share: f64) -> ControlFlow<()> {
        self.0.1.store(share.to_bits(), Ordering::Relaxed);
        if self.0.0.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn share(&self) -> f64 {
        f64::from_bits(self.0.1.load(Ordering::Relaxed))
    }
}

/// Does the job in another thread. Meanwhile this one listens to Ctrl-C, which only Python's first thread hears, and calls `look`
/// now and then; what either raises ends the job by `stop`, and comes back beside what the job found.
pub(crate) fn meanwhile<R: Send>(
    py: Python<'_>,
    job: impl FnOnce() -> R + Send,
    stop: impl Fn() + Sync,
    look: impl Fn(Python<'_>) -> PyResult<()> + Sync,
) -> (R, PyResult<()>) {
    py.detach(|| {
        thread::scope(|scope| {
            let (done, is_done) = channel::<()>();
            let work = scope.spawn(move || {
                let found = job();
                drop(done);
                found
            });
            let mut raised = None;
            while is_done.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout) {
                let heard = || Python::attach(|py| py.check_signals().and_then(|()| look(py)));
                if raised.is_none()
                    && let Err(error) = heard()
                {
                    raised = Some(error);
                    stop();
                }
            }
            let found = work.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            (found, raised.map_or(Ok(()), Err))
        })
    })
}

/// A simulator's work. `progress` is called with the share that is done.
pub(crate) fn simulated<R: Send>(
    py: Python<'_>,
    simulator: &Mutex<AnySimulator>,
    progress: Option<&Py<PyAny>>,
    job: impl FnOnce(&mut AnySimulator, &Link) -> Result<R, RolloutError> + Send,
) -> PyResult<R> {
    let mut simulator = match simulator.try_lock() {
        Ok(simulator) => simulator,
        // What a panic left is not known.
        Err(TryLockError::Poisoned(_)) => {
            return Err(PyRuntimeError::new_err("this simulator has failed before: make another one"));
        }
        Err(TryLockError::WouldBlock) => {
            return Err(PyRuntimeError::new_err(
                "this simulator is at work in another thread, or further up in this one: make one for each",
            ));
        }
    };
    let link = Link::default();
    let told = link.clone();
    simulator.as_dyn().set_progress(Box::new(move |share| told.told(share)));
    let look = |py: Python<'_>| match progress {
        Some(progress) => progress.call1(py, (link.share(),)).map(drop),
        None => Ok(()),
    };
    let (working, linked) = (&mut *simulator, &link);
    let (found, raised) = meanwhile(py, move || job(working, linked), || link.stop(), look);
    raised?;
    let found = found.map_err(errors::of_rollout)?;
    if let Some(progress) = progress {
        progress.call1(py, (1.0,))?;
    }
    Ok(found)
}
