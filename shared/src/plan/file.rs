//! Reading a plan file, with nothing taken for granted: the one way in for every program.
//!
//! Only regular files are read, so that no program waits for a writer that never comes, and no more of them than a plan can
//! have.

use core::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::vec::Vec;

use super::{MAX_FILE_BYTES, PlanError, PlanReader};
use crate::limits::Violation;

/// Why a file cannot be played. Each message names the file.
#[derive(Debug)]
pub struct LoadError {
    path: PathBuf,
    cause: LoadCause,
}

/// What is wrong with a file.
#[derive(Debug)]
pub enum LoadCause {
    /// The operating system refuses it.
    Io(io::Error),
    /// It is a directory.
    Directory,
    /// It is a device, a pipe or a socket.
    NotRegular,
    /// It has no bytes.
    Empty,
    /// It is no plan.
    Plan(PlanError),
    /// It is a plan that breaks its own limits.
    Limits(Violation),
}

impl LoadError {
    fn new(path: &Path, cause: LoadCause) -> Self {
        Self { path: PathBuf::from(path), cause }
    }

    /// What is wrong.
    #[must_use]
    pub fn cause(&self) -> &LoadCause {
        &self.cause
    }
}

impl fmt::Display for LoadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let path = self.path.display();
        match &self.cause {
            LoadCause::Io(error) if error.kind() == io::ErrorKind::NotFound => {
                write!(
                    f,
                    "{path}: there is no such file; give the path of a skill.plan that optimise has written"
                )
            }
            LoadCause::Io(error) => write!(f, "{path}: cannot be read: {error}"),
            LoadCause::Directory => {
                write!(f, "{path}: this is a directory; give the plan file in it, such as {path}/skill.plan")
            }
            LoadCause::NotRegular => {
                write!(f, "{path}: this is not a regular file; write what it holds to a file and give that")
            }
            LoadCause::Empty => write!(f, "{path}: the file is empty (0 bytes); a plan file was wanted"),
            LoadCause::Plan(error) => write!(f, "{path}: this is not a usable plan: {error}"),
            LoadCause::Limits(violation) => {
                write!(f, "{path}: the plan breaks its own limits: {violation}; make it anew")
            }
        }
    }
}

impl core::error::Error for LoadError {}

/// Bytes of a regular file that is not larger than a plan can be; a larger one is refused unread.
///
/// # Errors
/// What is wrong with the file.
pub fn read_plan_file(path: &Path) -> Result<Vec<u8>, LoadError> {
    let fail = |cause| LoadError::new(path, cause);
    let io = |error| fail(LoadCause::Io(error));
    let metadata = path.metadata().map_err(io)?;
    if metadata.is_dir() {
        return Err(fail(LoadCause::Directory));
    }
    if !metadata.is_file() {
        return Err(fail(LoadCause::NotRegular));
    }
    let bound = MAX_FILE_BYTES as u64;
    if metadata.len() > bound {
        return Err(fail(LoadCause::Plan(PlanError::TooLong { bytes: metadata.len() })));
    }
    let mut bytes = Vec::new();
    // One byte more than allowed, so that a file that grows meanwhile is noticed, and not read for ever.
    File::open(path)
        .and_then(|file| file.take(bound.saturating_add(1)).read_to_end(&mut bytes))
        .map_err(io)?;
    if bytes.is_empty() { Err(fail(LoadCause::Empty)) } else { Ok(bytes) }
}

/// A plan whose bytes have been checked.
///
/// # Errors
/// What is wrong with the plan in `path`.
pub fn parse_plan<'a>(path: &Path, bytes: &'a [u8]) -> Result<PlanReader<'a>, LoadError> {
    PlanReader::new(bytes).map_err(|error| LoadError::new(path, LoadCause::Plan(error)))
}

/// A plan whose bytes and whose motion have been checked.
///
/// # Errors
/// What is wrong with the plan in `path`.
pub fn check_plan<'a>(path: &Path, bytes: &'a [u8]) -> Result<PlanReader<'a>, LoadError> {
    let plan = parse_plan(path, bytes)?;
    plan.check_limits().map_err(|violation| LoadError::new(path, LoadCause::Limits(violation)))?;
    Ok(plan)
}
