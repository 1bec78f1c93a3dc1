//! A pseudo-terminal: a serial line without hardware, for programs on one machine.

use std::ffi::OsString;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};

use powderline_shared::wire::frame::{Dialect, Frame};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::fs::{Mode, OFlags, fcntl_getfl, fcntl_setfl};
use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

use super::serial::{Ends, raw};
use super::{LinkError, Received, Sent, Transport};
use crate::wait::Interest;

/// The master of a new pair. Other programs open [`Pty::path`] as they open a serial line, one after the other; frames sent
/// while nobody has it open go nowhere, as on a cable whose other end is not plugged in.
#[derive(Debug)]
pub struct Pty {
    path: PathBuf,
    master: OwnedFd,
    ends: Ends,
}

impl Pty {
    /// Makes the pair.
    ///
    /// # Errors
    /// If the system has no pseudo-terminal left.
    pub fn create() -> Result<Self, LinkError> {
        Self::make().map_err(|error| LinkError::system("a new pseudo-terminal", error))
    }

    fn make() -> Result<Self, Errno> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        fcntl_setfl(&master, fcntl_getfl(&master)? | OFlags::NONBLOCK)?;
        let path = PathBuf::from(OsString::from_vec(ptsname(&master, Vec::new())?.into_bytes()));
        // Opened once, the slave keeps its settings, and the master knows from now on whether somebody has it open.
        let slave = rustix::fs::open(&path, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())?;
        let mut settings = tcgetattr(&slave)?;
        raw(&mut settings);
        tcsetattr(&slave, OptionalActions::Now, &settings)?;
        Ok(Self { path, master, ends: Ends::default() })
    }

    /// The slave, for the other program.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether somebody has the slave open.
    #[must_use]
    pub fn is_open(&self) -> bool {
        let mut fds = [PollFd::new(&self.master, PollFlags::empty())];
        let polled = poll(&mut fds, Some(&crate::clock::timespec(0)));
        polled.is_ok() && fds.iter().all(|fd| !fd.revents().contains(PollFlags::HUP))
    }

    fn failure(&self, error: Errno) -> LinkError {
        LinkError::system(self.path.display().to_string(), error)
    }
}

impl Transport for Pty {
    fn dialect(&self) -> Dialect {
        Dialect::Fd
    }

    fn send(&mut self, frame: &Frame) -> Result<Sent, LinkError> {
        if !self.is_open() {
            self.ends.reset();
            return Ok(Sent::Done);
        }
        self.ends.send(&self.master, frame).map_err(|error| self.failure(error))
    }

    fn receive(&mut self) -> Result<Option<Received>, LinkError> {
        match self.ends.receive(&self.master) {
            // The slave is closed, perhaps in mid-frame; what comes next is a new program's.
            Err(Errno::IO) => {
                self.ends.reset();
                Ok(None)
            }
            other => other.map_err(|error| self.failure(error)),
        }
    }

    fn interest(&self) -> Option<Interest<'_>> {
        self.is_open().then(|| Interest { fd: self.master.as_fd(), writable: self.ends.has_left() })
    }

    fn other_end(&self) -> Option<&Path> {
        Some(&self.path)
    }

    fn garbled(&self) -> u64 {
        self.ends.garbled()
    }
}
