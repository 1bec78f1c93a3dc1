//! What executor and arm say to each other: [`message`]s, the [`state`]s they speak about, and the [`frame`]s that carry
//! them.

pub mod frame;
pub mod message;
pub mod state;
