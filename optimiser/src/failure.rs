//! What a command ends with when it does not succeed.

use crate::report::{folder::FolderError, record::RecordError};
use powderline_shared::plan::file::LoadError;
use powderline_simulator::{
    rollout::RolloutError,
    scene::SceneError,
    skill::{SkillError, ThetaError},
};
use std::{io, path::Path};
use thiserror::Error;

/// One sentence for the person, and the exit code that goes with it.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum Failure {
    /// What was asked for makes no sense as it stands: exit code 2.
    #[error("{0}")]
    Input(String),
    /// It made sense, and failed: exit code 1.
    #[error("{0}")]
    Failed(String),
    /// It was done, and the plan misses the wanted amount by more than the tolerance: exit code 3.
    #[error("{0}")]
    Missed(String),
    /// Stopped by the person: exit code 130.
    #[error("{0}")]
    Interrupted(String),
    /// Whoever was to read the results went away (`| head`): nobody is told, and the exit code is 141, as a shell has it for a
    /// program that the closed pipe has ended.
    #[error("nobody reads the output")]
    Unread,
}

impl Failure {
    /// The number of the exit code.
    pub fn code(&self) -> u8 {
        match self {
            Self::Failed(_) => 1,
            Self::Input(_) => 2,
            Self::Missed(_) => 3,
            Self::Interrupted(_) => 130,
            Self::Unread => 141,
        }
    }

    /// Adds a remark, separated by a semicolon, that tells what is left to do.
    pub(crate) fn with_remark(mut self, remark: &str) -> Self {
        if let Self::Input(text) | Self::Failed(text) | Self::Missed(text) | Self::Interrupted(text) =
            &mut self
        {
            text.push_str("; ");
            text.push_str(remark);
        }
        self
    }
}

/// What the system has against doing something to a file, or a folder.
pub(crate) fn of_file(path: &Path, done: &str) -> impl Fn(io::Error) -> Failure {
    move |error| Failure::Failed(format!("{} cannot be {done}: {error}", path.display()))
}

impl From<SceneError> for Failure {
    fn from(error: SceneError) -> Self {
        Self::Input(error.to_string())
    }
}

impl From<SkillError> for Failure {
    fn from(error: SkillError) -> Self {
        Self::Input(error.to_string())
    }
}

impl From<ThetaError> for Failure {
    fn from(error: ThetaError) -> Self {
        Self::Input(error.to_string())
    }
}

impl From<RolloutError> for Failure {
    fn from(error: RolloutError) -> Self {
        match error {
            RolloutError::Stopped => Self::Interrupted(error.to_string()),
            RolloutError::Skill(skill) => skill.into(),
            RolloutError::Theta(theta) => theta.into(),
            RolloutError::Memory { .. }
            | RolloutError::Threads { .. }
            | RolloutError::Motion { .. }
            | RolloutError::Lengths { .. } => Self::Input(error.to_string()),
            _ => Self::Failed(error.to_string()),
        }
    }
}

impl From<FolderError> for Failure {
    fn from(error: FolderError) -> Self {
        match error {
            FolderError::Taken { .. } | FolderError::NoRun { .. } => Self::Input(error.to_string()),
            _ => Self::Failed(error.to_string()),
        }
    }
}

impl From<RecordError> for Failure {
    fn from(error: RecordError) -> Self {
        match error {
            RecordError::Folder(error) => error.into(),
            error => Self::Input(error.to_string()),
        }
    }
}

impl From<LoadError> for Failure {
    fn from(error: LoadError) -> Self {
        Self::Input(error.to_string())
    }
}

/// Standard output that went away (a closed pipe) or is full.
impl From<io::Error> for Failure {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::BrokenPipe => Self::Unread,
            _ => Self::Failed(format!("the output cannot be written: {error}")),
        }
    }
}
