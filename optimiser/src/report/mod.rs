//! What a run leaves behind: its folder, the state to resume from, the plan, curves, and words.

mod advice;
pub mod amounts;
pub mod curves;
pub mod finding;
pub mod folder;
pub(crate) mod ink;
pub mod judged;
pub mod looks;
pub mod plan;
pub mod record;
pub(crate) mod sealed;
pub mod state;
pub(crate) mod summary;
pub mod tries;
pub mod view;
pub(crate) mod words;
