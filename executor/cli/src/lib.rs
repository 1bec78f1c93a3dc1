//! The program `execute`: reads a plan, plays it with the executor's core, says what came of it.

pub mod pace;
pub mod report;
pub mod run;
pub mod wire;
