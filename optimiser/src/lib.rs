//! From a bench description to a motion: search, comparison, reports, and the program `optimise`.

pub mod cli;
pub mod compare;
pub mod optim;
pub mod report;
