//! Wires that carry frames. Nothing here ever waits: [`wait`](crate::wait) does, on [`Transport::interest`].

mod outgoing;
mod pty;
mod serial;
mod socketcan;

use std::path::Path;

use powderline_shared::wire::frame::{Dialect, Frame};

pub use outgoing::MAX_QUEUED;
pub use pty::Pty;
pub use serial::Serial;
pub use socketcan::SocketCan;

pub use crate::error::LinkError;
use crate::link::Link;
use crate::wait::Interest;

/// One end of a wire.
pub trait Transport {
    /// How messages are put into its frames.
    fn dialect(&self) -> Dialect;

    /// Hands a frame to the wire, if the wire takes it at once.
    ///
    /// # Errors
    /// If the wire can carry no frame any more, or never this one.
    fn send(&mut self, frame: &Frame) -> Result<Sent, LinkError>;

    /// What has arrived next; `None` if there is nothing. Also hands on what is left of frames that were taken in part, so
    /// call it until it gives `None` after every [`wait`](crate::wait).
    ///
    /// # Errors
    /// If the wire can carry no frame any more.
    fn receive(&mut self) -> Result<Option<Received>, LinkError>;

    /// What to wait for; `None` while nobody holds the other end, whose coming back shows only by looking again.
    fn interest(&self) -> Option<Interest<'_>>;

    /// Where the other end is to be opened, if this wire was made for it.
    fn other_end(&self) -> Option<&Path> {
        None
    }

    /// Pieces of the line that were no frames, since it was opened; always 0 where the hardware drops them itself.
    fn garbled(&self) -> u64 {
        0
    }
}

/// Opens a wire; `None` for an arm inside the same process, which has none.
///
/// # Errors
/// Why it cannot be opened.
pub fn open(link: &Link) -> Result<Option<Box<dyn Transport>>, LinkError> {
    Ok(match link {
        Link::Sim => None,
        Link::Can { interface, .. } => Some(Box::new(SocketCan::open(interface, Dialect::Classic)?)),
        Link::CanFd { interface, .. } => Some(Box::new(SocketCan::open(interface, Dialect::Fd)?)),
        Link::Serial { device, baud } => Some(Box::new(Serial::open(device, *baud)?)),
        Link::Pty => Some(Box::new(Pty::create()?)),
    })
}

/// What became of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// The wire has it.
    Done,
    /// The wire has no room now; nothing of the frame is kept. Try again after [`BUSY_US`].
    Busy,
}

/// When to try a frame again that the wire had no room for, microseconds. Only time helps: a socket counts as writable
/// while the queue behind it is full, and a process that waited for that would spin, before everybody else if it runs in
/// real time.
pub const BUSY_US: u64 = 1_000;

/// Something that has arrived.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Received {
    /// When, microseconds of `CLOCK_MONOTONIC`: by the kernel's stamp on CAN, when it was read elsewhere.
    pub at_us: u64,
    /// What.
    pub what: Incoming,
}

/// What arrives.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Incoming {
    /// A data frame with an 11-bit identifier.
    Frame(Frame),
    /// The CAN controller's view of the bus.
    Event(BusEvent),
}

/// What a CAN controller says of the bus, the gravest first: an error frame that holds several becomes the first of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum BusEvent {
    /// It has left the bus.
    BusOff,
    /// It is back on the bus.
    Restarted,
    /// Frames were lost between controller and kernel.
    Overflow,
    /// It may no longer signal errors.
    ErrorPassive,
    /// It counts many errors.
    Warning,
    /// It is as it should be again.
    ErrorActive,
    /// A frame that it sent was acknowledged by nobody.
    NoAck,
    /// A frame was damaged, or something else that the controller mends by itself.
    BusError,
}

impl BusEvent {
    /// Whether no session goes on after it.
    #[must_use]
    pub const fn ends_session(self) -> bool {
        matches!(self, Self::BusOff | Self::Restarted)
    }

    /// One plain sentence.
    #[must_use]
    pub const fn sentence(self) -> &'static str {
        match self {
            Self::BusOff => {
                "the CAN controller has left the bus after too many errors (bus-off): check wiring, termination and bit \
                 rate, then restart it by `ip link set IFACE type can restart` or by taking it down and up"
            }
            Self::Restarted => "the CAN controller was restarted: frames around it may be lost",
            Self::Overflow => {
                "the CAN controller lost frames because they came faster than they were fetched"
            }
            Self::ErrorPassive => {
                "the CAN controller counts so many errors that it is error-passive: check wiring, termination and bit rate"
            }
            Self::Warning => "the CAN controller counts many errors: check wiring, termination and bit rate",
            Self::ErrorActive => "the CAN controller counts few errors again",
            Self::NoAck => {
                "nobody on the bus acknowledges frames: the other end is off, unplugged or at another bit rate"
            }
            Self::BusError => "a frame was damaged on the bus",
        }
    }
}

impl std::fmt::Display for BusEvent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.sentence())
    }
}
