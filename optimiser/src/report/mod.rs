//! What a run leaves behind: its folder, the state to resume from, the plan, curves, and words.

pub mod curves;
pub mod folder;
pub(crate) mod ink;
pub mod plan;
pub(crate) mod sealed;
pub mod state;
pub mod summary;
pub mod view;
pub(crate) mod words;
