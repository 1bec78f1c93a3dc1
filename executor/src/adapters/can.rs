//! Classic CAN: the executor on any controller whose driver implements [`embedded_can::nb::Can`].
//!
//! The blocking trait of that crate has no counterpart here: its `receive` waits until a frame arrives, and an executor that
//! waits notices no silence.
//!
//! ```
//! use embedded_can::nb::Can;
//! use powderline_executor::adapters::Turn;
//! use powderline_executor::adapters::can::{CanWire, DIALECT};
//! use powderline_executor::guard::rehearse;
//! use powderline_executor::{Config, Endpoint, Outcome};
//! use powderline_shared::plan::PlanReader;
//!
//! /// Plays a plan; `None` if it is none, or breaks its own limits.
//! fn play<C: Can>(
//!     can: C,
//!     plan: &[u8],
//!     now_us: impl Fn() -> u64,
//!     stop_pressed: impl Fn() -> bool,
//! ) -> Option<Outcome> {
//!     let plan = PlanReader::new(plan).ok()?;
//!     // Its limits, as it is rounded to the counts of this wire, and what the wire can tell apart.
//!     rehearse(&plan, DIALECT.lsb(), plan.header().control_period_us, DIALECT.span()).ok()?;
//!     let mut endpoint = Endpoint::new(now_us(), &plan, DIALECT, Config::default());
//!     let mut wire = CanWire::new(can);
//!     loop {
//!         if stop_pressed() {
//!             endpoint.executor_mut().handle_stop(now_us());
//!         }
//!         match wire.turn(&now_us, &mut endpoint) {
//!             Turn::Finished(outcome) => return Some(outcome),
//!             // A frame waits for room: come again.
//!             Turn::Unfinished => {}
//!             // Here the processor may sleep until `endpoint.poll_at()` or an interrupt of the controller.
//!             Turn::Idle => {}
//!         }
//!     }
//! }
//! ```

use embedded_can::nb::Can;
use embedded_can::{Error, ErrorKind, Id, StandardId};
use powderline_shared::wire::frame::{Dialect, Frame};

use super::{Device, Gone, Turn};
use crate::endpoint::Endpoint;

/// How messages are put into frames here; what the [`Endpoint`] is to be made with.
pub const DIALECT: Dialect = Dialect::Classic;

/// Moves frames between an [`Endpoint`] of the dialect [`DIALECT`] and a CAN controller: data frames with identifiers of 11
/// bits; all others are passed over.
#[derive(Debug)]
pub struct CanWire<C: Can> {
    can: C,
    /// Waits until the controller has room, or was given back by it for a more urgent one.
    waiting: Option<C::Frame>,
    harmless: fn(&C::Error) -> bool,
    harmless_errors: u32,
    failure: Option<C::Error>,
}

impl<C: Can> CanWire<C> {
    /// Takes a controller that is set up and on the bus. An overrun is harmless, since lost frames are sent again or else
    /// missed; any other error ends the session.
    #[must_use]
    pub fn new(can: C) -> Self {
        let harmless = |error: &C::Error| error.kind() == ErrorKind::Overrun;
        Self { can, waiting: None, harmless, harmless_errors: 0, failure: None }
    }

    /// Says which errors cost no more than frames, for a driver that reports as errors what its controller mends by itself.
    #[must_use]
    pub fn tolerating(self, harmless: fn(&C::Error) -> bool) -> Self {
        Self { harmless, ..self }
    }

    /// One round of the loop, with the clock in microseconds, which never goes back: all that has arrived goes to the endpoint, all that it has to say
    /// goes to the controller, as far as there is room.
    pub fn turn(&mut self, now_us: impl Fn() -> u64, endpoint: &mut Endpoint<'_>) -> Turn {
        super::turn(self, now_us, endpoint)
    }

    /// The first error that ended a session.
    #[must_use]
    pub fn failure(&self) -> Option<&C::Error> {
        self.failure.as_ref()
    }

    /// Errors that cost no more than frames.
    #[must_use]
    pub fn harmless_errors(&self) -> u32 {
        self.harmless_errors
    }

    /// Gives the controller back. A frame that still waits for room is forgotten.
    #[must_use]
    pub fn into_inner(self) -> C {
        self.can
    }

    fn judge(&mut self, error: C::Error) -> Result<(), Gone> {
        if (self.harmless)(&error) {
            self.harmless_errors = self.harmless_errors.saturating_add(1);
            return Ok(());
        }
        self.failure.get_or_insert(error);
        Err(Gone)
    }
}

impl<C: Can> Device for CanWire<C> {
    fn fetch(&mut self, heard: impl FnMut(&Frame)) -> Result<bool, Gone> {
        match self.can.receive() {
            Ok(received) => from_device(&received).iter().for_each(heard),
            Err(nb::Error::WouldBlock) => return Ok(false),
            Err(nb::Error::Other(error)) => self.judge(error)?,
        }
        Ok(true)
    }

    fn make_room(&mut self) -> Result<bool, Gone> {
        let Some(frame) = self.waiting.take() else { return Ok(true) };
        match self.can.transmit(&frame) {
            Ok(replaced) => self.waiting = replaced,
            Err(nb::Error::WouldBlock) => self.waiting = Some(frame),
            Err(nb::Error::Other(error)) => {
                let judged = self.judge(error);
                if judged.is_err() {
                    // Tried again, should the controller recover: the stop comes behind it.
                    self.waiting = Some(frame);
                }
                judged?;
            }
        }
        Ok(self.waiting.is_none())
    }

    fn put(&mut self, frame: &Frame) -> Result<(), Gone> {
        // None has more than 8 bytes, or the endpoint is of the other dialect.
        self.waiting = Some(to_device(frame).ok_or(Gone)?);
        Ok(())
    }
}

fn from_device(received: &impl embedded_can::Frame) -> Option<Frame> {
    match received.id() {
        Id::Standard(id) if received.is_data_frame() => Frame::new(id.as_raw(), received.data()),
        Id::Standard(_) | Id::Extended(_) => None,
    }
}

fn to_device<F: embedded_can::Frame>(frame: &Frame) -> Option<F> {
    F::new(StandardId::new(frame.id)?, &frame.data)
}
