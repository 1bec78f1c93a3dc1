//! What a command ends with when it does not succeed.

use crate::report::{folder::FolderError, record::RecordError};
use powderline_shared::plan::file::LoadError;
use powderline_simulator::{
    rollout::RolloutError,
    scene::SceneError,
    skill::{SkillError, ThetaError},
};
use std::{fmt, io, process::ExitCode};

/// One sentence for the person, and the exit code that goes with it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Failure {
    /// What was asked for makes no sense as it stands: exit code 2.
    Input(String),
    /// It made sense, and failed: exit code 1.
    Failed(String),
    /// It was done, and the plan misses the wanted amount by more than the tolerance: exit code 3.
    Missed(String),
    /// Stopped by the person: exit code 130.
    Interrupted(String),
    /// Whoever was to read the results went away (`| head`): nobody is told, and the exit code is 141, as a shell has it for a
    /// program that the closed pipe has ended.
    Unread,
}

impl Failure {
    /// The process's exit code.
    pub fn exit_code(&self) -> ExitCode {
        ExitCode::from(self.code())
    }

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
    pub(crate) fn with_remark(self, remark: &str) -> Self {
        match self {
            Self::Input(text) => Self::Input(format!("{text}; {remark}")),
            Self::Failed(text) => Self::Failed(format!("{text}; {remark}")),
            Self::Missed(text) => Self::Missed(format!("{text}; {remark}")),
            Self::Interrupted(text) => Self::Interrupted(format!("{text}; {remark}")),
            Self::Unread => Self::Unread,
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Input(text) | Self::Failed(text) | Self::Missed(text) | Self::Interrupted(text) => {
                f.write_str(text)
            }
            Self::Unread => f.write_str("nobody reads the output"),
        }
    }
}

impl std::error::Error for Failure {}

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

/// Standard output that went away (a closed pipe) or is full.
impl From<LoadError> for Failure {
    fn from(error: LoadError) -> Self {
        Self::Input(error.to_string())
    }
}

impl From<io::Error> for Failure {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::BrokenPipe => Self::Unread,
            _ => Self::Failed(format!("the output cannot be written: {error}")),
        }
    }
}
