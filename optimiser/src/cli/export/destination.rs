//! Where a motion is written to: a file, whole or not at all, or standard output.

use super::super::{CliError, Context, film::Film};
use powderline_view::{
    motion::{Motion, mcap::Recording},
    whole::Whole,
};
use std::{
    fmt,
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
};

/// What stands for standard output.
pub(super) const STDOUT: &str = "-";

/// A place for one file.
pub(super) struct Destination(PathBuf);

impl Destination {
    /// Looks whether anything is there already.
    ///
    /// # Errors
    /// Something is, and is not to be written over, or cannot be.
    pub(super) fn new(path: PathBuf, force: bool) -> Result<Self, CliError> {
        if path == Path::new(STDOUT) {
            return Ok(Self(path));
        }
        let taken = |why: &str| Err(CliError::Input(format!("{} {why}", path.display())));
        match path.metadata() {
            Ok(there) if there.is_dir() => taken("is a folder; name a file by --out"),
            // A file takes the place of another, so a device would be gone.
            Ok(there) if !there.is_file() => {
                taken("is no ordinary file; name one by --out, or - for standard output")
            }
            Ok(_) if !force => {
                taken("is there already; name another file by --out, or write over it by --force")
            }
            _ => Ok(Self(path)),
        }
    }

    pub(super) fn path(&self) -> &Path {
        &self.0
    }

    pub(super) fn is_stdout(&self) -> bool {
        self.0 == Path::new(STDOUT)
    }

    /// Writes what fills the file.
    pub(super) fn write(
        &self,
        stdout: &mut dyn Write,
        fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<(), CliError> {
        if self.is_stdout() {
            let mut out = BufWriter::new(stdout);
            fill(&mut out)?;
            return Ok(out.flush()?);
        }
        let whole = Whole::new(&self.0)?;
        let mut out = BufWriter::new(whole.file());
        fill(&mut out).and_then(|()| out.flush()).map_err(|error| whole.error(error))?;
        drop(out);
        Ok(whole.commit()?)
    }

    /// Simulates the powder and writes it beside the motion.
    pub(super) fn record(
        &self,
        motion: &Motion,
        film: &Film<'_>,
        context: &mut Context<'_>,
    ) -> Result<(), CliError> {
        let whole = Whole::new(&self.0)?;
        let mut out = BufWriter::new(whole.file());
        let mut recording = Recording::new(&mut out, motion, &self.0)?;
        film.shoot(&mut recording, context)?;
        drop(recording);
        out.flush().map_err(|error| whole.error(error))?;
        drop(out);
        Ok(whole.commit()?)
    }
}

impl fmt::Display for Destination {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_stdout() { f.write_str("standard output") } else { self.0.display().fmt(f) }
    }
}
