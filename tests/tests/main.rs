//! The programs, end to end and from outside: processes, files, exit codes.
//!
//! What one package can show of itself is shown there, with less effort: the commands with a stand-in for the
//! simulator in `optimiser/src/cli/tests.rs`, plans in `shared/tests`, the arm's refusals in `executor/tests`.
//!
//! Two scenes: `bench-small`, where the simulator matters, and the same on a coarser grid, where any simulator would do.

mod campaign;
mod changelog;
mod executed;
mod guide;
mod interrupted;
mod links;
mod next;
mod pipeline;
mod pipes;
mod programs;
mod refusals;
mod resources;
mod terminal;
mod wire;
