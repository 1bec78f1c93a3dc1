//! The ways to search, and what they are given.

use super::black_box::BlackBox;
use super::coarse_to_fine::CoarseToFine;
use super::descent::{Descent, Source};
use super::path::{By, SkillThenPath};
use super::{Search, Trial, World, initial_theta};
use crate::able::obstacle;
use crate::report::amounts::Amounts;
use clap::ValueEnum;
use powderline_baseline::{CmaEs, RandomSearch, Sac};
use powderline_simulator::{
    rollout::Evaluation,
    scene::{Aim, PathSplines, Scene},
    skill::{SkillMap, Splines, Theta},
};
use serde::{Deserialize, Serialize};
use std::rc::Rc;

/// A way to search for a motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Gaussian processes of a coarse copy of the scene and of the scene itself
    #[default]
    Surrogate,
    /// RMSprop by the restarted adjoint mixed with central differences
    Restarted,
    /// RMSprop by the exact adjoint mixed with central differences
    Mixed,
    /// RMSprop by central differences
    Differences,
    /// RMSprop by the exact adjoint
    Exact,
    /// Covariance matrix adaptation
    CmaEs,
    /// Soft actor-critic, one motion an episode
    Sac,
    /// Motions drawn uniformly
    Random,
    /// A skill as surrogate finds it, then a path near it by the restarted adjoint
    Path,
    /// The same with the path by covariance matrix adaptation
    PathCmaEs,
}

impl Method {
    /// As the command line and figures name it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Surrogate => "surrogate",
            Self::Restarted => "restarted",
            Self::Mixed => "mixed",
            Self::Differences => "differences",
            Self::Exact => "exact",
            Self::CmaEs => "cma-es",
            Self::Sac => "sac",
            Self::Random => "random",
            Self::Path => "path",
            Self::PathCmaEs => "path-cma-es",
        }
    }

    /// All of them.
    pub fn all() -> &'static [Self] {
        Self::value_variants()
    }

    /// Whether it searches a skill first, and then something that is near it.
    pub fn begins_with_a_skill(self) -> bool {
        matches!(self, Self::Path | Self::PathCmaEs)
    }

    /// Whether it takes the adjoint.
    pub fn has_adjoint(self) -> bool {
        self == Self::Path || self.source().is_some_and(|source| source != Source::Differences)
    }

    fn source(self) -> Option<Source> {
        match self {
            Self::Restarted => Some(Source::Restarted),
            Self::Mixed => Some(Source::Mixed),
            Self::Differences => Some(Source::Differences),
            Self::Exact => Some(Source::Exact),
            _ => None,
        }
    }

    /// A search that begins.
    pub fn search(self, problem: &Problem) -> Box<dyn Search> {
        let (dimensions, seed) = (problem.first.len(), problem.seed);
        let black_box = |search| Box::new(BlackBox::new(search));
        if let Some(source) = self.source() {
            return Box::new(Descent::new(source, &problem.ranges, seed));
        }
        match self {
            Self::CmaEs => black_box(Box::new(CmaEs::new(dimensions, seed))),
            Self::Sac => black_box(Box::new(Sac::new(dimensions, seed))),
            Self::Random => black_box(Box::new(RandomSearch::new(dimensions, seed))),
            Self::Path => Box::new(SkillThenPath::new(problem.clone(), By::Gradient)),
            Self::PathCmaEs => Box::new(SkillThenPath::new(problem.clone(), By::Losses)),
            _ => Box::new(CoarseToFine::new(problem.clone())),
        }
    }
}

type IsAble = Rc<dyn Fn(&Theta, Option<&Splines>) -> bool>;

/// What a search has to know beforehand.
#[derive(Clone)]
pub struct Problem {
    /// Seed of whatever it draws.
    pub seed: u64,
    /// Where it begins, as the seed draws it from `ranges`.
    pub(super) first: Vec<f64>,
    /// `[low, high]` of each component, to begin in.
    pub(super) ranges: [[f64; 2]; 5],
    /// What it costs if all that is wanted is missing, metres; 0 where as much as can be had is wanted.
    pub(super) unit_m: f64,
    /// What is wanted.
    amounts: Amounts,
    has_coarse: bool,
    /// From a skill to its motion.
    pub(super) map: Rc<SkillMap>,
    /// What a path may add to it.
    pub(super) path: PathSplines,
    is_able: IsAble,
}

impl Problem {
    /// Of a scene, with the seed of the search.
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let ranges = scene.skill.initial_theta;
        let unit_m = match scene.objective.aim {
            Aim::Amount => scene.target_count() as f64 * scene.source_distance_m(),
            Aim::All => 0.0,
        };
        let (map, bench) = (Rc::new(SkillMap::new(scene)), scene.clone());
        Self {
            seed,
            first: initial_theta(&ranges, seed).components().to_vec(),
            ranges,
            unit_m,
            amounts: Amounts::from(scene),
            has_coarse: scene.coarse().is_some(),
            map: Rc::clone(&map),
            path: scene.skill.path.clone(),
            is_able: Rc::new(move |theta, splines| obstacle(&bench, &map, theta, splines).is_none()),
        }
    }

    /// Whether the arm may perform it, as far as that is known before it is simulated.
    pub(super) fn is_able(&self, trial: &Trial) -> bool {
        let theta = trial.point[..].try_into().ok().and_then(|point| Theta::new(point).ok());
        theta.is_some_and(|theta| (self.is_able)(&theta, trial.splines.as_ref()))
    }

    /// Whether what arrives is well within the tolerance, for a search to go on from. Without what rounding forgives elsewhere: on the very
    /// edge a better skill is near, and on `bench-small` a path that began there ended at 3.13 m for 2.85.
    pub(super) fn is_well_within(&self, found: &Evaluation) -> bool {
        (self.amount(found) - 1.0).abs() <= self.tolerance()
    }

    /// The cheapest world.
    pub(super) fn coarsest(&self) -> World {
        if self.has_coarse { World::Coarse } else { World::Fine }
    }

    /// What arrives, over what is wanted.
    pub(super) fn amount(&self, found: &Evaluation) -> f64 {
        f64::from(found.census.target) / f64::from(self.amounts.wanted_particles)
    }

    /// How far that may be off, relative; any distance where as much as can be had is wanted.
    pub(super) fn tolerance(&self) -> f64 {
        self.amounts.tolerance.unwrap_or(f64::INFINITY)
    }
}

#[cfg(test)]
impl Problem {
    /// The same where the arm may perform anything.
    pub(super) fn without_obstacles(self) -> Self {
        self.with_obstacle(|_| false)
    }

    /// The same where these are the paths that the arm may not perform.
    pub(super) fn with_blocked_paths(self, is_blocked: impl Fn(&Splines) -> bool + 'static) -> Self {
        Self { is_able: Rc::new(move |_, splines| !splines.is_some_and(&is_blocked)), ..self }
    }

    /// The same where this is what the arm may not perform.
    pub(super) fn with_obstacle(self, is_blocked: impl Fn(&Theta) -> bool + 'static) -> Self {
        Self { is_able: Rc::new(move |theta, _| !is_blocked(theta)), ..self }
    }
}
