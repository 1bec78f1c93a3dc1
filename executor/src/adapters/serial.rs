//! Serial lines: the executor on any UART or virtual port whose driver implements the traits of [`embedded_io`].
//!
//! Nothing is read or written unless the driver says that it would not wait, and `flush`, which waits, is never called: a
//! driver has to send what was written to it by itself.
//!
//! ```
//! use embedded_io::{Read, ReadReady, Write, WriteReady};
//! use powderline_executor::adapters::Turn;
//! use powderline_executor::adapters::serial::{DIALECT, SerialWire};
//! use powderline_executor::guard::rehearse;
//! use powderline_executor::{Config, Endpoint, Outcome};
//! use powderline_shared::plan::PlanReader;
//!
//! /// Plays a plan; `None` if it is none, or breaks its own limits.
//! fn play<P>(port: P, plan: &[u8], now_us: impl Fn() -> u64) -> Option<Outcome>
//! where
//!     P: Read + ReadReady + Write + WriteReady,
//! {
//!     let plan = PlanReader::new(plan).ok()?;
//!     // Its limits, as it is rounded to the counts of this wire, and what the wire can tell apart.
//!     rehearse(&plan, DIALECT.lsb(), plan.header().control_period_us, DIALECT.span()).ok()?;
//!     let mut endpoint = Endpoint::new(now_us(), &plan, DIALECT, Config::default());
//!     let mut wire = SerialWire::new(port);
//!     loop {
//!         if let Turn::Finished(outcome) = wire.turn(&now_us, &mut endpoint) {
//!             return Some(outcome);
//!         }
//!     }
//! }
//! ```

use embedded_io::{Error, ErrorKind, Read, ReadReady, Write, WriteReady};
use heapless::Vec;
use powderline_shared::wire::cobs::DELIMITER;
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::serial::{LineReader, MAX_LINE_BYTES, to_line};

use super::{Device, Gone, Turn};
use crate::endpoint::Endpoint;

/// How messages are put into frames here; what the [`Endpoint`] is to be made with.
pub const DIALECT: Dialect = Dialect::Fd;

/// Bytes read at once; many UARTs hold less.
const CHUNK: usize = 32;

/// Bytes that wait at most: a frame, and the stop behind it.
const MAX_WAITING: usize = 2 * MAX_LINE_BYTES;

/// Moves frames between an [`Endpoint`] of the dialect [`DIALECT`] and a serial line.
#[derive(Debug)]
pub struct SerialWire<P: Read + ReadReady + Write + WriteReady> {
    port: P,
    reader: LineReader,
    /// On their way into the port.
    waiting: Vec<u8, MAX_WAITING>,
    /// How many of them the port has taken.
    taken: usize,
    harmless: fn(&P::Error) -> bool,
    harmless_errors: u32,
    garbled: u32,
    failure: Option<P::Error>,
}

impl<P: Read + ReadReady + Write + WriteReady> SerialWire<P> {
    /// Takes a port that is set up: 8 data bits, no parity, one stop bit. Every error ends the session, except the one that
    /// means "again" ([`ErrorKind::Interrupted`]).
    #[must_use]
    pub fn new(port: P) -> Self {
        Self {
            port,
            reader: LineReader::new(),
            // Ends whatever the line held before.
            waiting: Vec::from_array([DELIMITER]),
            taken: 0,
            harmless: |error| error.kind() == ErrorKind::Interrupted,
            harmless_errors: 0,
            garbled: 0,
            failure: None,
        }
    }

    /// Says which errors cost no more than bytes. Many drivers report a byte that came too fast or was damaged as an error;
    /// the checksums of the frames find those, and what is lost is sent again or else missed.
    #[must_use]
    pub fn tolerating(self, harmless: fn(&P::Error) -> bool) -> Self {
        Self { harmless, ..self }
    }

    /// One round of the loop, with the clock in microseconds, which never goes back: all that has arrived goes to the endpoint, all that it has to say
    /// goes to the port, as far as there is room.
    pub fn turn(&mut self, now_us: impl Fn() -> u64, endpoint: &mut Endpoint<'_>) -> Turn {
        super::turn(self, now_us, endpoint)
    }

    /// The first error that ended a session; none if the port ended without one.
    #[must_use]
    pub fn failure(&self) -> Option<&P::Error> {
        self.failure.as_ref()
    }

    /// Errors that cost no more than bytes.
    #[must_use]
    pub fn harmless_errors(&self) -> u32 {
        self.harmless_errors
    }

    /// Pieces of the line that were no frames.
    #[must_use]
    pub fn garbled(&self) -> u32 {
        self.garbled
    }

    /// Gives the port back. What still waits for room is forgotten, and may have been sent in part.
    #[must_use]
    pub fn into_inner(self) -> P {
        self.port
    }

    fn judge(&mut self, error: P::Error) -> Result<(), Gone> {
        if (self.harmless)(&error) {
            self.harmless_errors = self.harmless_errors.saturating_add(1);
            return Ok(());
        }
        self.failure.get_or_insert(error);
        Err(Gone)
    }

    /// The bytes that have arrived; `None` if there are none.
    fn read(&mut self, chunk: &mut [u8; CHUNK]) -> Result<Option<usize>, P::Error> {
        if self.port.read_ready()? { self.port.read(chunk).map(Some) } else { Ok(None) }
    }

    /// How many bytes the port has taken; `None` if it has no room.
    fn write(&mut self) -> Result<Option<usize>, P::Error> {
        let left = self.waiting.get(self.taken..).unwrap_or_default();
        if self.port.write_ready()? { self.port.write(left).map(Some) } else { Ok(None) }
    }
}

impl<P: Read + ReadReady + Write + WriteReady> Device for SerialWire<P> {
    fn fetch(&mut self, mut heard: impl FnMut(&Frame)) -> Result<bool, Gone> {
        let mut chunk = [0; CHUNK];
        let count = match self.read(&mut chunk) {
            // The end of a line that has none.
            Ok(Some(0)) => return Err(Gone),
            Ok(Some(count)) => count,
            Ok(None) => return Ok(false),
            Err(error) => return self.judge(error).map(|()| true),
        };
        for byte in chunk.iter().take(count) {
            match self.reader.push(*byte) {
                Some(Ok(frame)) => heard(&frame),
                Some(Err(_)) => self.garbled = self.garbled.saturating_add(1),
                None => {}
            }
        }
        Ok(true)
    }

    fn make_room(&mut self) -> Result<bool, Gone> {
        while self.taken < self.waiting.len() {
            match self.write() {
                // A port with room that takes nothing must not be asked for ever.
                Ok(None | Some(0)) => return Ok(false),
                Ok(Some(count)) => self.taken = self.taken.saturating_add(count),
                // What the port has taken of it is not known. Should it recover, the rest ends the frame, whole or not.
                Err(error) => return self.judge(error).map(|()| false),
            }
        }
        self.waiting.clear();
        self.taken = 0;
        Ok(true)
    }

    fn put(&mut self, frame: &Frame) -> Result<(), Gone> {
        let line = to_line(frame);
        // A stop comes behind what waits, which may have been sent in part. More stops than there is room for are needless.
        if self.waiting.capacity().saturating_sub(self.waiting.len()) >= line.len() {
            for byte in &line {
                // There is room.
                let _ = self.waiting.push(*byte);
            }
        }
        Ok(())
    }
}
