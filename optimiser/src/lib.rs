//! From a bench description to a motion: search, comparison, reports, and the program `optimise`.

mod able;
pub mod campaign;
pub mod cli;
pub mod compare;
pub mod failure;
pub mod optim;
pub mod refine;
pub mod report;
pub mod run;
pub mod shorten;

/// The guide, as it stands in `optimiser/guide/`.
#[cfg(doc)]
pub mod guide {
    #[doc = include_str!("../guide/commands.md")]
    pub mod commands {}
    #[doc = include_str!("../guide/results.md")]
    pub mod results {}
    #[doc = include_str!("../guide/scenes.md")]
    pub mod scenes {}
    #[doc = include_str!("../guide/campaigns.md")]
    pub mod campaigns {}
    #[doc = include_str!("../guide/wire.md")]
    pub mod wire {}
    #[doc = include_str!("../guide/figures.md")]
    pub mod figures {}
    #[doc = include_str!("../guide/limits.md")]
    pub mod limits {}
}
