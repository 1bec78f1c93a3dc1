//! The folder of a run: one owner at a time, files that are either whole or not there.

use std::{
    fs::{self, File, OpenOptions, TryLockError},
    io::{self, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
};
use thiserror::Error;

/// Resume state.
pub const STATE: &str = "state";
/// One JSON line per epoch.
pub const METRICS: &str = "metrics.jsonl";
/// Curves of loss, indicator and theta.
pub const CURVES: &str = "curves.svg";
/// The resolved scene.
pub const SCENE: &str = "scene.toml";
/// What was tried, one JSON line each.
pub const TRIES: &str = "tries.jsonl";
/// What a comparison was begun with.
pub const COMPARISON: &str = "comparison.json";
/// What a campaign is of.
pub const CAMPAIGN: &str = "campaign.toml";
/// The plan.
pub const PLAN: &str = "skill.plan";
/// What a folder with this file is the folder of.
fn kind(file: &str) -> &'static str {
    match file {
        COMPARISON => "comparison",
        CAMPAIGN => "campaign",
        _ => "run",
    }
}

/// A file longer than this is not from a run, bytes.
const MAX_FILE_BYTES: u64 = 64 << 20;
/// Held locked by the run that writes here.
const LOCK: &str = "lock";

/// How many folders of one name are tried before giving up.
const MAX_NUMBER: u32 = 10_000;

/// Why a folder or a file in it cannot be used.
#[derive(Debug, Error)]
pub enum FolderError {
    /// The folder cannot be created.
    #[error("the folder {path} cannot be created: {source}")]
    Create {
        /// The folder.
        path: PathBuf,
        /// The operating system's reason.
        source: io::Error,
    },
    /// A file cannot be written.
    #[error("{path} cannot be written: {source}")]
    Write {
        /// The file.
        path: PathBuf,
        /// The operating system's reason.
        source: io::Error,
    },
    /// A file cannot be read.
    #[error("{path} cannot be read: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// The operating system's reason.
        source: io::Error,
    },
    /// Another run holds the folder's lock.
    #[error("another run is writing into {path}; wait for it, or choose another folder")]
    Locked {
        /// The folder.
        path: PathBuf,
    },
    /// A new run was to go where one already is.
    #[error(
        "{path} already holds a {}, which is not overwritten ({file}); choose another --out, or go on with it by --resume {path}",
        kind(file)
    )]
    Taken {
        /// The folder.
        path: PathBuf,
        /// The file that shows it.
        file: &'static str,
    },
    /// Nothing to resume.
    #[error("{path} holds nothing to resume (there is no {file} file in it)")]
    NoRun {
        /// The folder.
        path: PathBuf,
        /// The file that is missing.
        file: &'static str,
    },
}

/// How a file is locked: alone, or beside others.
type Lock = fn(&File) -> Result<(), TryLockError>;

/// An open folder, locked unless it is only looked at. The lock goes with the value.
#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
    _lock: Option<File>,
}

impl RunFolder {
    /// Takes `path` for a new run, creating it if need be.
    ///
    /// # Errors
    /// It cannot be created or written, is locked, or holds a run.
    pub fn create(path: &Path) -> Result<Self, FolderError> {
        let folder = Self::take(path)?;
        match [STATE, COMPARISON, CAMPAIGN, PLAN, METRICS, SCENE, CURVES]
            .into_iter()
            .find(|file| path.join(file).exists())
        {
            Some(file) => Err(FolderError::Taken { path: path.into(), file }),
            None => Ok(folder),
        }
    }

    /// Takes the first of `path`, `path-2`, `path-3`, ... that does not exist yet.
    ///
    /// # Errors
    /// It cannot be created or written.
    pub fn create_numbered(path: &Path) -> Result<Self, FolderError> {
        let failed = |source| FolderError::Create { path: path.into(), source };
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(failed)?;
        }
        for number in 1..=MAX_NUMBER {
            let candidate = numbered(path, number);
            // Creating is the test: of two runs started at once only one can succeed.
            match fs::create_dir(&candidate) {
                Ok(()) => return Self::lock(&candidate),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(FolderError::Create { path: candidate, source: error }),
            }
        }
        Err(failed(io::ErrorKind::AlreadyExists.into()))
    }

    /// Takes a folder that holds a run.
    ///
    /// # Errors
    /// There is no run, it is locked, or cannot be written.
    pub fn open(path: &Path) -> Result<Self, FolderError> {
        Self::open_with(path, STATE)
    }

    /// Takes a folder that holds this file.
    ///
    /// # Errors
    /// It does not, it is locked, or cannot be written.
    pub fn open_with(path: &Path, file: &'static str) -> Result<Self, FolderError> {
        Self::holding(path, file, File::try_lock)
    }

    /// The same beside others who do so too, and nobody who takes it: for whoever replaces none of its files.
    ///
    /// # Errors
    /// As [`Self::open_with`].
    pub fn share(path: &Path, file: &'static str) -> Result<Self, FolderError> {
        Self::holding(path, file, File::try_lock_shared)
    }

    /// The same beside whoever works in it: for whoever only reads.
    ///
    /// # Errors
    /// It holds no such file.
    pub fn look(path: &Path, file: &'static str) -> Result<Self, FolderError> {
        match path.join(file).exists() {
            true => Ok(Self { path: path.into(), _lock: None }),
            false => Err(FolderError::NoRun { path: path.into(), file }),
        }
    }

    fn holding(path: &Path, file: &'static str, lock: Lock) -> Result<Self, FolderError> {
        match path.join(file).exists() {
            true => Self::lock_by(path, lock),
            false => Err(FolderError::NoRun { path: path.into(), file }),
        }
    }

    /// Takes a folder, whatever it holds, creating it if need be.
    ///
    /// # Errors
    /// It cannot be created or written, or is locked.
    pub fn take(path: &Path) -> Result<Self, FolderError> {
        fs::create_dir_all(path).map_err(|source| FolderError::Create { path: path.into(), source })?;
        Self::lock(path)
    }

    fn lock(path: &Path) -> Result<Self, FolderError> {
        Self::lock_by(path, File::try_lock)
    }

    fn lock_by(path: &Path, lock: Lock) -> Result<Self, FolderError> {
        let file = path.join(LOCK);
        let failed = |source| FolderError::Write { path: file.clone(), source };
        let held = OpenOptions::new().write(true).create(true).truncate(false).open(&file).map_err(failed)?;
        match lock(&held) {
            Ok(()) => Ok(Self { path: path.into(), _lock: Some(held) }),
            Err(TryLockError::WouldBlock) => Err(FolderError::Locked { path: path.into() }),
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }

    /// Where the folder is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Path of a file in the folder.
    pub fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// The contents of a file.
    ///
    /// # Errors
    /// [`FolderError::Read`].
    pub fn read(&self, name: &str) -> Result<Vec<u8>, FolderError> {
        read_file(&self.file(name))
    }

    /// Replaces a file so that, whatever happens, either the old or the new contents are there, whole.
    ///
    /// # Errors
    /// [`FolderError::Write`]; the old contents are then still there.
    pub fn replace(&self, name: &str, contents: &[u8]) -> Result<(), FolderError> {
        let path = self.file(name);
        let fresh = self.file(&format!("{name}.new"));
        write_through(&fresh, contents)
            .and_then(|()| fs::rename(&fresh, &path))
            .and_then(|()| sync_folder(&self.path))
            .map_err(|source| {
                // What is left of a failed write only takes up room.
                let _ = fs::remove_file(&fresh);
                FolderError::Write { path, source }
            })
    }

    /// Removes a file, if that is possible.
    pub fn discard(&self, name: &str) {
        let _ = fs::remove_file(self.file(name));
    }

    /// Appends to a file; a write that fails half way is taken back.
    ///
    /// # Errors
    /// [`FolderError::Write`].
    pub fn append(&self, name: &str, contents: &[u8]) -> Result<(), FolderError> {
        let path = self.file(name);
        append_through(&path, contents).map_err(|source| FolderError::Write { path, source })
    }
}

/// The contents of a file of a run; a longer one than any run writes is refused.
///
/// # Errors
/// [`FolderError::Read`].
pub fn read_file(path: &Path) -> Result<Vec<u8>, FolderError> {
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes));
    let failed = |source| FolderError::Read { path: path.into(), source };
    match read {
        Ok(count) if count as u64 > MAX_FILE_BYTES => {
            Err(failed(io::Error::new(io::ErrorKind::FileTooLarge, "no run writes a file of this size")))
        }
        Ok(_) => Ok(bytes),
        Err(source) => Err(failed(source)),
    }
}

fn numbered(path: &Path, number: u32) -> PathBuf {
    if number == 1 {
        return path.into();
    }
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!("-{number}"));
    path.with_file_name(name)
}

fn write_through(path: &Path, contents: &[u8]) -> io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(contents)?;
    file.sync_all()
}

fn append_through(path: &Path, contents: &[u8]) -> io::Result<()> {
    // Not opened in append mode: the file must be cut back if the write fails.
    let mut file = OpenOptions::new().write(true).create(true).truncate(false).open(path)?;
    let length = file.seek(SeekFrom::End(0))?;
    file.write_all(contents).and_then(|()| file.sync_data()).inspect_err(|_| {
        let _ = file.set_len(length);
    })
}

/// A rename is on the disk only when its folder is.
#[cfg(unix)]
fn sync_folder(path: &Path) -> io::Result<()> {
    File::open(path)?.sync_all()
}

#[cfg(not(unix))]
fn sync_folder(_path: &Path) -> io::Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn second_run_into_one_folder_is_refused() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("run");
        let first = RunFolder::create(&path).unwrap();
        let error = RunFolder::create(&path).unwrap_err();
        assert!(matches!(error, FolderError::Locked { .. }), "{error}");
        drop(first);
        RunFolder::create(&path).unwrap();
    }

    #[test]
    fn folder_with_a_run_is_not_overwritten() {
        let place = tempfile::tempdir().unwrap();
        for file in [STATE, PLAN, METRICS] {
            let path = place.path().join(file);
            RunFolder::create(&path).unwrap().replace(file, b"x").unwrap();
            let error = RunFolder::create(&path).unwrap_err();
            assert!(error.to_string().contains("not overwritten"), "{error}");
        }
    }

    #[test]
    fn numbered_folders_follow_each_other() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("runs/bench-seed1");
        let names: Vec<_> = (0..3)
            .map(|_| RunFolder::create_numbered(&path).unwrap().path().file_name().unwrap().to_owned())
            .collect();
        assert_eq!(names, ["bench-seed1", "bench-seed1-2", "bench-seed1-3"]);
    }

    #[test]
    fn folder_below_a_file_is_refused_in_one_sentence() {
        let place = tempfile::NamedTempFile::new().unwrap();
        for error in [
            RunFolder::create(&place.path().join("run")).unwrap_err(),
            RunFolder::create_numbered(&place.path().join("run")).unwrap_err(),
        ] {
            assert!(error.to_string().contains("cannot be created"), "{error}");
        }
    }

    #[test]
    fn resuming_where_nothing_is_says_so() {
        let place = tempfile::tempdir().unwrap();
        let error = RunFolder::open(place.path()).unwrap_err();
        assert!(error.to_string().contains("nothing to resume"), "{error}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn full_disk_keeps_the_old_contents() {
        let place = tempfile::tempdir().unwrap();
        let folder = RunFolder::create(&place.path().join("run")).unwrap();
        folder.replace(STATE, b"old").unwrap();
        std::os::unix::fs::symlink("/dev/full", folder.file("state.new")).unwrap();
        let error = folder.replace(STATE, b"new").unwrap_err();
        assert!(error.to_string().contains("No space left"), "{error}");
        assert_eq!(folder.read(STATE).unwrap(), b"old");
    }

    #[test]
    fn appends() {
        let place = tempfile::tempdir().unwrap();
        let folder = RunFolder::create(&place.path().join("run")).unwrap();
        folder.append(METRICS, b"one\n").unwrap();
        folder.append(METRICS, b"two\n").unwrap();
        assert_eq!(folder.read(METRICS).unwrap(), b"one\ntwo\n");
    }
}
