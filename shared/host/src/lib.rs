//! What the programs `execute` and `firmware-sim` need of Linux, and nothing of what they do with it.
//!
//! The cores of both ends neither read a clock nor touch a wire. Here is the other side of that line: addresses as they are
//! typed ([`link`]), wires that carry [`Frame`](powderline_shared::wire::frame::Frame)s ([`transport`]), what a CAN
//! interface says of itself ([`interface`]), the [`clock`], waiting for a moment or a wire ([`wait`]), a person's wish to
//! stop ([`signals`]), real-time scheduling ([`realtime`]), how late wake-ups are ([`jitter`]) and logs in candump's
//! format ([`candump`]), keys ([`key`]), a line of progress ([`terminal`]), numbers in sentences ([`words`]).
//!
//! # When the wire fails
//! * An interface that is taken down, or unplugged, makes the next call fail with one sentence ([`LinkError::Down`],
//!   [`LinkError::Gone`]); a socket whose interface was only taken down works again when it is up.
//! * A CAN controller that goes bus-off says so by [`BusEvent::BusOff`], and sending then fails with [`LinkError::BusOff`]
//!   until it is restarted: the session is over for both ends, and the arm stops by its own watchdog.
//! * A wire that cannot take a frame at once answers [`Sent::Busy`] and keeps nothing of it: nothing here ever waits to
//!   send.
//!
//! [`LinkError::Down`]: transport::LinkError::Down
//! [`LinkError::BusOff`]: transport::LinkError::BusOff
//! [`LinkError::Gone`]: transport::LinkError::Gone
//! [`BusEvent::BusOff`]: transport::BusEvent::BusOff
//! [`Sent::Busy`]: transport::Sent::Busy
#![warn(
    clippy::indexing_slicing,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation
)]
#![cfg_attr(
    test,
    expect(
        clippy::unwrap_used,
        clippy::indexing_slicing,
        clippy::arithmetic_side_effects,
        reason = "a test may stop at the first surprise"
    )
)]

pub mod candump;
pub mod clock;
mod error;
pub mod interface;
pub mod jitter;
pub mod key;
pub mod link;
pub mod realtime;
pub mod signals;
mod system;
pub mod terminal;
pub mod transport;
pub mod wait;
pub mod words;
