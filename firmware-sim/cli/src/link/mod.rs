//! Executor and arm on a simulated wire, under virtual time. One number drives everything that goes wrong.
//!
//! ```text
//! seed -> faults -> world (executors, bus, arm) -> witness -> outcome
//! ```
//!
//! The two state machines are the very ones that run on a real wire. What they say passes through the codec of the wire,
//! byte by byte.

pub mod bus;
pub mod dice;
pub mod faults;
pub mod motion;
pub mod witness;
pub mod world;
