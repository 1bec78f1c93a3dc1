//! A run as its folder holds it, read back by whoever goes on with it or reports on it.

use super::{
    amounts::Amounts,
    finding::{Finding, RunSoFar, Shipped},
    folder::{FolderError, PLAN, SCENE, STATE, read_file},
    judged::Judged,
    sealed::StateError,
    state::{Evaluated, RunState},
};
use crate::optim::EpochRecord;
use powderline_shared::plan::{
    PlanError, PlanReader,
    file::{LoadError, read_plan_file},
};
use powderline_simulator::{
    scene::{Scene, SceneError},
    skill::SkillMap,
};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a folder holds no run that can be read.
#[derive(Debug, Error)]
pub enum RecordError {
    /// A file is missing or cannot be read.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// The scene is not one.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The state is not one.
    #[error("{path} cannot be resumed from: {source}")]
    State {
        /// The file.
        path: PathBuf,
        /// Why.
        source: StateError,
    },
    /// The scene was changed.
    #[error(
        "{path} is no longer the scene that the run was started with, or a version did that whose digests have another form: a \
         new run would be right then"
    )]
    OtherScene {
        /// The file.
        path: PathBuf,
    },
    /// The plan cannot be read.
    #[error(transparent)]
    PlanFile(#[from] LoadError),
    /// The plan is not one.
    #[error("{path} is no usable plan: {source}")]
    Plan {
        /// The file.
        path: PathBuf,
        /// Why.
        source: PlanError,
    },
}

/// A run: what it is about, its epochs, and the plan once there is one.
#[derive(Clone, Debug)]
pub struct RunRecord {
    /// The scene.
    pub scene: Scene,
    /// The mapping of that scene.
    pub map: SkillMap,
    /// All that the run needs to go on.
    pub state: RunState,
    /// The epochs of `state`, and what keeps the arm from performing each.
    pub epochs: Vec<Judged>,
    /// The plan of the finished run.
    pub shipped: Option<Shipped>,
}

impl RunRecord {
    /// A run with the epochs of its state.
    pub fn new(scene: Scene, state: RunState) -> Self {
        let map = SkillMap::new(&scene);
        let judged = |record: EpochRecord| Judged::new(&scene, &map, record);
        let epochs = state.history().into_iter().map(judged).collect();
        Self { scene, map, state, epochs, shipped: None }
    }

    /// The run in a folder.
    ///
    /// # Errors
    /// One sentence, with the file.
    pub fn read(folder: &Path) -> Result<Self, RecordError> {
        let file = |name: &str| folder.join(name);
        if !file(STATE).exists() {
            return Err(FolderError::NoRun { path: folder.into(), file: STATE }.into());
        }
        let state = RunState::from_bytes(&read_file(&file(STATE))?)
            .map_err(|source| RecordError::State { path: file(STATE), source })?;
        let scene = Scene::load(&file(SCENE).display().to_string())?;
        if scene.digest() != state.scene {
            return Err(RecordError::OtherScene { path: file(SCENE) });
        }
        let mut record = Self::new(scene, state);
        if record.state.finished {
            record
                .ship(&read_plan_file(&file(PLAN))?)
                .map_err(|source| RecordError::Plan { path: file(PLAN), source })?;
        }
        Ok(record)
    }

    /// Takes an epoch that was evaluated.
    pub fn push(&mut self, epoch: Evaluated) {
        self.epochs.push(Judged::new(&self.scene, &self.map, epoch.record.clone()));
        self.state.epochs.push(epoch);
    }

    /// Takes the bytes of the plan that was made of it.
    ///
    /// # Errors
    /// They are no plan.
    pub fn ship(&mut self, plan: &[u8]) -> Result<(), PlanError> {
        let plan = PlanReader::new(plan)?;
        self.shipped = Some(Shipped::new(&Amounts::from(&self.scene), plan.header(), &self.state.looks)?);
        Ok(())
    }

    /// The skill parameters at the first epoch and those of the plan, in physical units; those of theta = 0 where there are none.
    pub fn skills(&self) -> [[f64; 5]; 2] {
        let first = self.epochs.first().map(|epoch| epoch.record.theta);
        let plan = self.shipped.map(|plan| plan.theta);
        [first, plan].map(|theta| self.map.parameters(&theta.unwrap_or_default()))
    }

    /// What was found; nothing before the first epoch.
    pub fn finding(&self) -> Option<Finding> {
        Finding::new(&RunSoFar {
            scene: &self.scene,
            seed: self.state.seed,
            precision: self.state.precision,
            epochs: &self.epochs,
            settings: self.state.settings,
            ended_of: self.state.is_settled().then_some(self.state.settings.epochs),
            shipped: self.shipped.as_ref(),
            unrefined: self.state.unrefined.as_deref(),
        })
    }
}
