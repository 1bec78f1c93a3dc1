//! What the gradient is compared with: searches that see losses and nothing else.
//!
//! [`RandomSearch`] is the least that any search must beat, [`CmaEs`] a strong search without gradients, [`Sac`] the
//! reinforcement learning that Wei et al. 2025 (arXiv 2510.01438) compare with.

mod cmaes;
mod noise;
mod random;
pub mod sac;

pub use cmaes::CmaEs;
pub use random::RandomSearch;
pub use sac::Sac;

/// A search over [-1, 1]^n that asks for points in batches and is told their losses.
///
/// A search is a function of its seed and of the losses it was told, to the last bit: whoever keeps those can make it again.
pub trait Search {
    /// The next points to evaluate, at least one; may be fewer than `most`, never more. They do not depend on each
    /// other's losses.
    fn ask(&mut self, most: usize) -> Vec<Vec<f64>>;

    /// The losses of the points asked for last, in their order; lower is better.
    fn tell(&mut self, losses: &[f64]);
}
