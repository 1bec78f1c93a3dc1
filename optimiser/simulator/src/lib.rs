//! Differentiable powder simulation: how much powder a spoon moved along a path carries from one
//! container to another, and the exact derivative of the loss with respect to every displacement of
//! the path.
//!
//! The powder is a continuum, moved by the moving least squares material point method (MLS-MPM)
//! with Matsuoka-Nakai or Drucker-Prager plasticity, in contact with rigid containers, gates that open,
//! and a rigid tool by Coulomb friction. Every stage of a substep has its adjoint beside it, tested by
//! Taylor slopes. The same scene, seed and precision give the same bits on any machine, for any number
//! of threads and any memory budget.
//!
//! "The paper" is here Wei, Yang, Lai and Ji 2025, "Differentiable Skill Optimisation for Powder
//! Manipulation in Laboratory Automation", [arXiv 2510.01438](https://arxiv.org/abs/2510.01438):
//! the five skill parameters, the loss and the search come from there.
//!
//! ```
//! use powderline_shared::plan::Precision;
//! use powderline_simulator::rollout::{SimulatorSettings, boxed_simulator};
//! use powderline_simulator::scene::Scene;
//! use powderline_simulator::skill::{SkillMap, Theta};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // An embedded scene. `Scene::from_toml` reads your own; its error says what is wrong.
//! let scene = Scene::load("bench-small")?;
//! let mut simulator = boxed_simulator(&scene, Precision::F32, &SimulatorSettings::default())?;
//!
//! // Five parameters, each from -1 to 1, become one displacement of the tool per control step.
//! let theta = Theta::new([0.3, 0.0, 0.0, 0.0, 0.3])?;
//! let skill = SkillMap::new(&scene).controls(&theta)?;
//! let controls: Vec<_> = skill.into_iter().take(60).collect();
//!
//! // Simulate them.
//! let found = simulator.simulate(&controls)?;
//! println!("loss {} m, {} particles in the target", found.loss, found.census.target);
//!
//! // And the derivative of the loss by each of these displacements.
//! let (_, gradient) = simulator.simulate_with_gradient(&controls)?;
//! assert!(gradient.iter().flat_map(|step| step.components()).any(|slope| slope != 0.0));
//! # Ok(())
//! # }
//! ```
//!
//! More in [`examples`]: a whole skill, the gradient beside a difference and restarted, a bench built in code, a
//! custom tool shape, a custom loss, every grain on its way.
//!
//! # Data flow
//!
//! ```text
//! scene.toml -> scene::Scene -> skill::SkillMap -- theta -> displacements --+
//!                    |                                                      v
//!                    +-> packing, shapes, material -----------> rollout::Simulator
//!                                                                |         ^
//!                       Evaluation, gradient <-------------------+         |
//!                                          mpm: p2g -> grid_update -> g2p, and back
//! ```
//!
//! A control step is one displacement of the tool in world axes (metres, radians), cut into
//! substeps. The adjoint goes back over them, from states that were kept and, where memory is
//! short, computed again ([`memory`]).
//!
//! # Where each equation lives
//!
//! Files are those of the source, below `src/`; what the modules say of themselves is not repeated here.
//!
//! | What | Where | Source |
//! |---|---|---|
//! | transfers, affine velocities | `mpm/p2g.rs`, `mpm/g2p.rs` | Hu et al. 2018, MLS-MPM |
//! | splines and their slopes | `mpm/stencil.rs` | Steffen et al. 2008 |
//! | elasticity, yield surface, volume correction, cohesion | `mpm/material.rs` | Klar et al. 2016; Matsuoka and Nakai 1974; Tampubolon et al. 2017 |
//! | friction at rest and flowing | `mpm/material.rs` | MiDi 2004, inertial number |
//! | volume held to the grid's density | `mpm/density.rs` | after Dunatunga and Kamrin 2015 |
//! | sleep, by the fastest particle or the mean | `mpm/sleep.rs` | |
//! | velocity residue, given back | `mpm/residue.rs` | after Fei et al. 2021, AFLIP |
//! | contact, friction | `mpm/contact.rs`, `mpm/grid_update.rs` | Coulomb; Stomakhin et al. 2013 |
//! | walls with two sides: who sees which nodes | `mpm/walls.rs`, `mpm/layers.rs` | after Hu et al. 2018, CPIC, without its ghost velocities |
//! | signed distances, with second derivatives | `shape`, a file per solid | |
//! | faces of solids, continued beyond their edges | `shape/face.rs` | |
//! | what a tool's shape answers | `scene/tool`, a file per shape | |
//! | which states are kept | `rollout/schedule.rs` | Griewank and Walther 2000, revolve |
//! | the loss | `rollout/loss.rs` | the paper's, and one that asks for an amount |
//! | the skill | `skill` | the paper's five parameters; minimum jerk |
//! | whether the bench's arm can make it | [`arm`] | closed-form inverse kinematics; capsules for links |
//! | what a tool holds, heaped | `scene/capacity.rs` | the friction angle over every edge |
//! | how true all this is | [`validate`] | soil mechanics, experiments |
//!
//! Units are SI, and stand in the names of fields: `cell_m`, `density_kg_m3`. World frame: z up,
//! the floor at z = 0.
//!
//! # Extending
//!
//! - **A loss**: no change here; give a function to
//!   [`rollout::Simulate::gradient_of_custom_loss`].
//! - **A tool shape**: no change here either, if it can be put together from cuboids:
//!   [`scene::ToolShape::Cuboids`]. One that is round takes three things in `scene/tool/`: a variant
//!   of [`scene::ToolShape`] with its fields (`mod.rs`); a file beside `bowl.rs` that answers what
//!   `body.rs` asks of every shape, from the ranges of its fields to what it holds; its line in
//!   `ToolShape::with_body` (`mod.rs`), the only place of this crate that tells shapes apart. In the
//!   list of `scene/tool/tests.rs` its answers are held against each other. Walls that are none
//!   of the solids in `shape` take a file there, with the signed distance written once (the same
//!   code gives normal and curvature), a variant of `Shape` and its lines in `with_solid!` and
//!   `Shape::rounded`. Then the compiler names the drawing (`optimiser/src/report/view.rs`) and the
//!   tests that list shapes; [`rollout::Destination::Tool`] and `scenes/bench.toml` tell of it in words.
//! - **A material**: `mpm/material.rs` has the return map and its adjoint side by side;
//!   `mpm/tests/` holds both to a Taylor slope of 2 and to the closed forms of the element tests.
//!   What a run was simulated with is [`PHYSICS_VERSION`]: raise it.
//!
//! # Features, versions
//!
//! No features. Semantic versioning: errors, results and choices that will grow are
//! `#[non_exhaustive]`. The shapes of a scene and its aim are not, so that whoever draws or
//! converts them hears of a new one from the compiler; a new one is a breaking change. Of
//! dependencies, `nalgebra`'s vectors appear in [`powderline_shared::pose`] and `serde`'s traits
//! are implemented, both on purpose; no other's types are in the interface.

pub mod arm;
pub mod bench;
pub mod memory;
mod mpm;
mod real;
pub mod rollout;
pub mod scene;
mod shape;
pub mod skill;
mod small;
pub mod validate;

pub use mpm::PHYSICS_VERSION;
pub use real::Real;

/// The programs in `examples/`: `cargo run --release -p powderline-simulator --example NAME`.
///
/// # A whole skill: `rollout`
///
/// ```ignore
#[cfg_attr(doc, doc = include_str!("../examples/rollout.rs"))]
/// ```
///
/// # The gradient beside a difference: `gradient`
///
/// ```ignore
#[cfg_attr(doc, doc = include_str!("../examples/gradient.rs"))]
/// ```
///
/// # The same beside the restarted adjoint: `restarted_gradient`
///
/// ```ignore
#[cfg_attr(doc, doc = include_str!("../examples/restarted_gradient.rs"))]
/// ```
///
/// # What a scene's coarse copy is worth: `coarse_copy`
///
/// ```ignore
#[cfg_attr(doc, doc = include_str!("../examples/coarse_copy.rs"))]
/// ```
///
/// # What its settings do, and what happens at its cuts: `restarted_ablation`
///
/// ```ignore
#[cfg_attr(doc, doc = include_str!("../examples/restarted_ablation.rs"))]
/// ```
///
/// # A bench built in code: `scene_in_code`
///
/// ```ignore
#[cfg_attr(doc, doc = include_str!("../examples/scene_in_code.rs"))]
/// ```
///
/// # A custom tool shape: `tool_of_cuboids`
///
/// ```ignore
#[cfg_attr(doc, doc = include_str!("../examples/tool_of_cuboids.rs"))]
/// ```
///
/// # A custom loss: `objective`
///
/// ```ignore
#[cfg_attr(doc, doc = include_str!("../examples/objective.rs"))]
/// ```
///
/// # What walls with two sides, and sleep by the mean, are worth: `walls`
///
/// ```ignore
#[cfg_attr(doc, doc = include_str!("../examples/walls.rs"))]
/// ```
///
/// # Every grain on its way: `grains`
///
/// ```ignore
#[cfg_attr(doc, doc = include_str!("../examples/grains.rs"))]
/// ```
#[cfg(doc)]
pub mod examples {}
