//! What executor and arm say to each other: [`message`]s, the [`state`]s they speak about, and the [`frame`]s that carry
//! them.
//!
//! ```text
//! message <-> codec <-> frame <-> bus, or serial line (cobs)
//!             words, cyclic classic / FD, handshake records, checksums
//! ```
//! [`codec`] is the one way from the one to the other; `PROTOCOL.md` has every bit of it. [`auth`] has tags for two ends with a key. [`load`] tells whether a control
//! period fits a bus at all.

pub mod auth;
mod checksum;
mod classic;
pub mod cobs;
pub mod codec;
mod fd;
mod fields;
pub mod frame;
mod handshake;
mod history;
pub mod ids;
pub mod load;
pub mod message;
mod rejected;
pub mod serial;
pub mod state;
pub mod words;

pub use checksum::Context;
