//! The methods that are compared.

use clap::ValueEnum;
use powderline_baseline::{CmaEs, RandomSearch, Sac, Search};
use powderline_simulator::scene::{GradientEstimator, Scene, SceneError, Timing};
use serde::{Deserialize, Serialize};

/// A way to search for a skill.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// RMSprop, as the scene has it
    Gradient,
    /// The same, with only depth, angle and lift in the first half of the epochs, as in the paper
    GradientCurriculum,
    /// The same, with every segment of the motion in whole control steps
    GradientRounded,
    /// The same, by the exact adjoint mixed with central differences
    GradientMixed,
    /// The same, by the restarted adjoint mixed with central differences
    GradientRestarted,
    /// The same, by central differences alone
    GradientDifferences,
    /// The same, by the exact adjoint alone, without central differences
    GradientAdjoint,
    /// RMSprop on every displacement of the motion instead of the skill, by the adjoint
    GradientSteps,
    /// Soft actor-critic, one skill an episode
    Sac,
    /// Covariance matrix adaptation
    CmaEs,
    /// Skills drawn uniformly
    Random,
}

impl Method {
    /// As the figure names it; also the name of its folder.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gradient => "gradient",
            Self::GradientCurriculum => "gradient-curriculum",
            Self::GradientRounded => "gradient-rounded",
            Self::GradientMixed => "gradient-mixed",
            Self::GradientRestarted => "gradient-restarted",
            Self::GradientDifferences => "gradient-differences",
            Self::GradientAdjoint => "gradient-adjoint",
            Self::GradientSteps => "gradient-steps",
            Self::Sac => "sac",
            Self::CmaEs => "cma-es",
            Self::Random => "random",
        }
    }

    /// Whether it goes along a gradient, with one motion an epoch.
    pub fn is_gradient(self) -> bool {
        !matches!(self, Self::Sac | Self::CmaEs | Self::Random)
    }

    /// The scene as this method has it.
    ///
    /// # Errors
    /// If the method's scene is not a valid one: rounded segments may not fit into the horizon.
    pub fn scene(self, scene: &Scene) -> Result<Scene, SceneError> {
        scene.with(|spec| {
            // As many rollouts for each, whatever they have found.
            spec.optimiser.patience_epochs = 0;
            match self {
                Self::GradientCurriculum => spec.optimiser.curriculum_epochs = spec.optimiser.epochs / 2,
                Self::GradientRounded => spec.skill.timing = Timing::Rounded,
                Self::GradientMixed => spec.optimiser.gradient = GradientEstimator::Mixed,
                Self::GradientRestarted => spec.optimiser.gradient = GradientEstimator::Restarted,
                Self::GradientDifferences => spec.optimiser.gradient = GradientEstimator::Differences,
                Self::GradientAdjoint => spec.optimiser.gradient = GradientEstimator::Adjoint,
                Self::Gradient | Self::GradientSteps | Self::Sac | Self::CmaEs | Self::Random => {}
            }
        })
    }

    /// The search over five parameters; none for a method that goes along a gradient.
    pub fn search(self, seed: u64) -> Option<Box<dyn Search>> {
        const PARAMETERS: usize = 5;
        match self {
            Self::Sac => Some(Box::new(Sac::new(PARAMETERS, seed))),
            Self::CmaEs => Some(Box::new(CmaEs::new(PARAMETERS, seed))),
            Self::Random => Some(Box::new(RandomSearch::new(PARAMETERS, seed))),
            _ => None,
        }
    }
}
