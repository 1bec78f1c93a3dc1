//! Ctrl-C: the first one asks the run to stop where it can go on later, the second one ends the process.

use std::{
    io::{self, Write},
    ops::ControlFlow,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

/// Whether the person asked to stop.
#[derive(Clone, Debug, Default)]
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Listens to Ctrl-C and to the system's request to end.
    pub fn install() -> Self {
        let interrupt = Self::default();
        let requested = interrupt.clone();
        let handler = move || {
            if requested.0.swap(true, Ordering::Relaxed) {
                std::process::exit(130);
            }
            say("\nstopping (once more to end at once; a run's folder can be resumed either way)");
        };
        if let Err(error) = ctrlc::set_handler(handler) {
            say(&format!("Ctrl-C will end the process at once, since it cannot be listened to: {error}"));
        }
        interrupt
    }

    /// Whether a stop was asked for.
    pub fn is_requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// What is answered to whoever asks whether to go on.
    pub fn flow(&self) -> ControlFlow<()> {
        if self.is_requested() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// Asks for a stop.
    pub fn request(&self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// To whom it may concern: a standard error that nobody reads any more must not end what listens here.
fn say(text: &str) {
    let _ = writeln!(io::stderr(), "{text}");
}
