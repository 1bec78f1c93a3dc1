//! Plays a plan to an arm.
//!
//! The core neither reads a clock nor touches a wire: time is an argument, messages go in by
//! [`Executor::handle_message`] and come out of [`Executor::poll`]. So the same code runs under virtual time, on a host's
//! bus and on a microcontroller, with the plan left in flash. No allocation, no unsafe code. Nothing here is meant to
//! panic; the lints below keep out what can be seen to, which is no proof.
//!
//! ```text
//! plan -> player -> guard -> schedule -> session -> (wire) -> arm
//! ```
//!
//! The program `execute` is in `cli/`. [`adapters`] has the one driver loop, for every wire; for firmware, the features
//! `embedded-can` and `embedded-io`, off by default, bring it to every CAN controller or serial line whose driver implements the
//! traits of these crates.
#![no_std]
#![forbid(unsafe_code)]
#![warn(
    clippy::indexing_slicing,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::std_instead_of_core
)]
#![cfg_attr(test, expect(clippy::unwrap_used, reason = "a test may stop at the first surprise"))]

#[cfg(test)]
extern crate std;

pub mod adapters;
pub mod belief;
pub mod endpoint;
pub mod guard;
pub mod player;
pub mod recorder;
pub mod round_trip;
pub mod schedule;
pub mod session;
pub mod telemetry;
pub mod window;

pub use endpoint::{Endpoint, FrameAction};
pub use session::{Action, Config, Executor, Outcome};
pub use telemetry::Telemetry;
