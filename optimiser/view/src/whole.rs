//! Files that are either whole or not there.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use crate::ViewError;

/// A file that has its name only when it is complete, and otherwise vanishes.
#[derive(Debug)]
pub struct Whole {
    path: PathBuf,
    part: PathBuf,
    file: File,
    is_complete: bool,
}

impl Whole {
    /// An empty file beside `path`, whose folder is made.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn new(path: &Path) -> Result<Self, ViewError> {
        let mut name = path.file_name().unwrap_or_default().to_os_string();
        name.push(".part");
        let part = path.with_file_name(name);
        let error = |source| ViewError::File { path: path.to_path_buf(), source };
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(error)?;
        }
        let file = File::create(&part).map_err(error)?;
        Ok(Self { path: path.to_path_buf(), part, file, is_complete: false })
    }

    /// The file, to be written to.
    #[must_use]
    pub fn file(&self) -> &File {
        &self.file
    }

    /// What to say when it cannot be written.
    pub fn error(&self, source: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> ViewError {
        ViewError::File { path: self.path.clone(), source: io::Error::other(source) }
    }

    /// Gives the file its name, in place of one that has it.
    ///
    /// # Errors
    /// If the system refuses; what was there is then there still.
    pub fn commit(mut self) -> Result<(), ViewError> {
        self.file
            .sync_all()
            .and_then(|()| fs::rename(&self.part, &self.path))
            .map_err(|source| self.error(source))?;
        self.is_complete = true;
        Ok(())
    }
}

impl Drop for Whole {
    fn drop(&mut self) {
        if !self.is_complete {
            // Nobody is left to be told.
            let _ = fs::remove_file(&self.part);
        }
    }
}
