//! The arm at the other end of the wire, simulated.
//!
//! [`controller::Controller`] is what would run in a robot's cabinet: it believes nothing that it is told. It keeps its
//! own states, its own buffer and its own limits, and it comes to rest by itself when setpoints fail to arrive. It shares
//! the words of `powderline-shared` with the executor, and no line of the executor's code.
//!
//! Time is an argument throughout: microseconds since any fixed moment.
#![forbid(unsafe_code)]
#![warn(clippy::arithmetic_side_effects, clippy::indexing_slicing)]

pub mod arm;
pub mod buffer;
pub mod clock;
pub mod controller;
pub mod endpoint;
pub mod interpolator;
mod session;
pub mod stop;
