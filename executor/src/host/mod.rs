//! The host's part: the simulated arm in the same process, and what a run has to say.
#![expect(clippy::std_instead_of_core, reason = "this module exists on hosts only")]

pub mod load;
pub mod pace;
pub mod report;
pub mod run;
