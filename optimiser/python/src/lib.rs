//! The Python package `powderline`: scenes, the simulator, plans and the search of the Rust crates, under Python's names.
//!
//! | Python | here | Rust |
//! |---|---|---|
//! | `Scene` | `scene.rs` | `powderline_simulator::scene` |
//! | `Simulator`, `Episode` | `simulator.rs`, `episode.rs` | `powderline_simulator::rollout` |
//! | `Evaluation`, `Motion` | `evaluation.rs`, `motion.rs` | the same |
//! | `Plan` | `plan.rs` | `powderline_shared::plan` |
//! | `optimise`, `report` | `search.rs`, `report.rs` | `powderline_optimiser::cli`, as `optimise run` and `optimise report` |
//! | `campaign` | `campaign.rs` | `powderline_optimiser::campaign` and `cli`, as `optimise campaign` |
//!
//! What is typed for Python, with shapes and units, stands in `python/powderline/_native.pyi`; docstrings are those of this crate.

mod arrays;
mod campaign;
mod command;
mod episode;
mod errors;
mod evaluation;
mod given;
mod json;
mod motion;
mod plan;
mod report;
mod scene;
mod search;
mod simulator;
mod watched;

use pyo3::prelude::*;

/// What is written in Rust; import `powderline`.
#[pymodule]
mod _native {
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::campaign::{Campaign, CampaignFolder, perform_cases};
    #[pymodule_export]
    use crate::episode::Episode;
    #[pymodule_export]
    use crate::errors::{MotionError, PlanError, SceneError, SimulationError, SkillError};
    #[pymodule_export]
    use crate::evaluation::Evaluation;
    #[pymodule_export]
    use crate::motion::Motion;
    #[pymodule_export]
    use crate::plan::Plan;
    #[pymodule_export]
    use crate::report::{report, summary};
    #[pymodule_export]
    use crate::scene::Scene;
    #[pymodule_export]
    use crate::search::{main, optimise};
    #[pymodule_export]
    use crate::simulator::{Simulator, checked_resources};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
