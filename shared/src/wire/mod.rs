//! What executor and arm say to each other: [`message`]s, and the [`state`]s they speak about.

pub mod message;
pub mod state;
