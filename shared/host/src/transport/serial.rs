//! A serial line.

use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};

use heapless::Vec;
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::serial::{LineReader, to_line};
use rustix::fs::{FlockOperation, Mode, OFlags, flock, fstat, major};
use rustix::io::{Errno, read};
use rustix::termios::{
    ControlModes, OptionalActions, QueueSelector, SpecialCodeIndex, Termios, ioctl_tiocexcl, tcflush,
    tcgetattr, tcsetattr,
};

use super::outgoing::Outgoing;
use super::{Incoming, LinkError, Received, Sent, Transport};
use crate::clock;
use crate::wait::Interest;

/// Bytes fetched from the driver at once; a UART's own buffer holds less.
const CHUNK: usize = 256;

/// Chunks without a frame after which whoever asks has a look at the time.
const MOST_FETCHES: usize = 16;

/// Device numbers of pseudo-terminals (`UNIX98_PTY_SLAVE_MAJOR` of `linux/major.h`, and the seven after it).
const PTY_SLAVE_MAJORS: std::ops::RangeInclusive<u32> = 136..=143;

/// A serial line, opened for one program alone: 8 data bits, no parity, one stop bit, no flow control.
#[derive(Debug)]
pub struct Serial {
    device: PathBuf,
    line: OwnedFd,
    ends: Ends,
}

/// Both directions of a terminal.
#[derive(Debug, Default)]
pub(super) struct Ends {
    reader: LineReader,
    /// Pieces between delimiters that were no frames, since the beginning.
    garbled: u64,
    /// Bytes fetched and not decoded yet, and how many of them have been.
    fetched: Vec<u8, CHUNK>,
    taken: usize,
    outgoing: Outgoing,
}

impl Serial {
    /// Opens a device and sets its rate, baud.
    ///
    /// # Errors
    /// If the device is missing, not permitted, in use, no serial line, or without that rate.
    pub fn open(device: &Path, baud: u32) -> Result<Self, LinkError> {
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let line = rustix::fs::open(device, flags, Mode::empty()).map_err(|error| refusal(device, error))?;
        let mut serial = Self { device: device.to_owned(), line, ends: Ends::default() };
        serial.claim().map_err(|error| refusal(device, error))?;
        serial.set_up(baud)?;
        // What was sent to nobody, before this program, is not for this program; and a zero ends what the other end may
        // have got of a frame whose sender has died.
        tcflush(&serial.line, QueueSelector::IOFlush).map_err(|error| refusal(device, error))?;
        serial.ends.outgoing.send(serial.line.as_fd(), &[0]).map_err(|error| refusal(device, error))?;
        Ok(serial)
    }

    /// Keeps other programs out: the lock those that ask for one, the other those that do not, unless they are root's.
    fn claim(&self) -> Result<(), Errno> {
        tcgetattr(&self.line)?;
        flock(&self.line, FlockOperation::NonBlockingLockExclusive)?;
        // A pseudo-terminal would stay exclusive for as long as its master lives, against the next program too.
        let pseudo = PTY_SLAVE_MAJORS.contains(&major(fstat(&self.line)?.st_rdev));
        if pseudo { Ok(()) } else { ioctl_tiocexcl(&self.line) }
    }

    fn set_up(&self, baud: u32) -> Result<(), LinkError> {
        let system = |error| refusal(&self.device, error);
        let mut settings = tcgetattr(&self.line).map_err(system)?;
        raw(&mut settings);
        settings.set_speed(baud).map_err(system)?;
        tcsetattr(&self.line, OptionalActions::Now, &settings).map_err(system)?;
        // A driver that cannot keep a rate takes another, without a word.
        let offered = tcgetattr(&self.line).map_err(system)?.output_speed();
        if offered.abs_diff(baud) > baud / 50 {
            return Err(LinkError::Baud { device: self.device.clone(), typed: baud, offered });
        }
        Ok(())
    }

    fn failure(&self, error: Errno) -> LinkError {
        let link = self.device.display().to_string();
        match error {
            Errno::IO | Errno::NODEV | Errno::NXIO => LinkError::Gone { link },
            other => LinkError::system(link, other),
        }
    }
}

/// No line editing, no echo, no flow control; reading returns with one byte.
pub(super) fn raw(settings: &mut Termios) {
    settings.make_raw();
    settings.control_modes.remove(ControlModes::CSTOPB | ControlModes::CRTSCTS | ControlModes::PARENB);
    settings.control_modes.insert(ControlModes::CLOCAL | ControlModes::CREAD);
    settings.special_codes[SpecialCodeIndex::VMIN] = 1;
    settings.special_codes[SpecialCodeIndex::VTIME] = 0;
}

fn refusal(device: &Path, error: Errno) -> LinkError {
    let device = device.to_owned();
    match error {
        Errno::NOENT | Errno::NODEV | Errno::NXIO => LinkError::NoDevice { device },
        Errno::ACCESS | Errno::PERM => LinkError::Permission { device },
        Errno::BUSY | Errno::AGAIN => LinkError::InUse { device },
        Errno::NOTTY | Errno::ISDIR => LinkError::NotSerial { device },
        other => LinkError::system(device.display().to_string(), other),
    }
}

impl Ends {
    /// The next frame among the bytes that the terminal has. A line that babbles without end has none after a while.
    pub(super) fn receive(&mut self, terminal: impl AsFd) -> Result<Option<Received>, Errno> {
        self.outgoing.flush(terminal.as_fd())?;
        for _ in 0..MOST_FETCHES {
            let frame = self.frame();
            if frame.is_some() || !self.fetch(terminal.as_fd())? {
                return Ok(frame);
            }
        }
        Ok(self.frame())
    }

    /// The next frame among the bytes that were fetched.
    fn frame(&mut self) -> Option<Received> {
        while let Some(byte) = self.fetched.get(self.taken) {
            self.taken = self.taken.saturating_add(1);
            match self.reader.push(*byte) {
                Some(Ok(frame)) => {
                    return Some(Received { at_us: clock::now_us(), what: Incoming::Frame(frame) });
                }
                Some(Err(_)) => self.garbled = self.garbled.saturating_add(1),
                None => {}
            }
        }
        None
    }

    /// Whether there were bytes.
    fn fetch(&mut self, terminal: impl AsFd) -> Result<bool, Errno> {
        let mut chunk = [0; CHUNK];
        let count = loop {
            match read(&terminal, &mut chunk) {
                // A terminal that has hung up reads as the end of a file.
                Ok(0) => return Err(Errno::IO),
                Ok(count) => break count,
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => return Ok(false),
                Err(error) => return Err(error),
            }
        };
        self.taken = 0;
        self.fetched.clear();
        // At most a chunk was read, and a chunk has room.
        let _ = self.fetched.extend_from_slice(chunk.get(..count).unwrap_or_default());
        Ok(true)
    }

    pub(super) fn send(&mut self, terminal: impl AsFd, frame: &Frame) -> Result<Sent, Errno> {
        self.outgoing.send(terminal.as_fd(), &to_line(frame))
    }

    /// Whether something waits to be written.
    pub(super) fn has_left(&self) -> bool {
        !self.outgoing.is_empty()
    }

    pub(super) fn garbled(&self) -> u64 {
        self.garbled
    }

    /// Forgets both directions, when the other end has gone.
    pub(super) fn reset(&mut self) {
        self.outgoing.clear();
        self.reader = LineReader::new();
    }
}

impl Transport for Serial {
    fn dialect(&self) -> Dialect {
        Dialect::Fd
    }

    fn send(&mut self, frame: &Frame) -> Result<Sent, LinkError> {
        self.ends.send(&self.line, frame).map_err(|error| self.failure(error))
    }

    fn receive(&mut self) -> Result<Option<Received>, LinkError> {
        self.ends.receive(&self.line).map_err(|error| self.failure(error))
    }

    fn interest(&self) -> Option<Interest<'_>> {
        Some(Interest { fd: self.line.as_fd(), writable: self.ends.has_left() })
    }

    fn garbled(&self) -> u64 {
        self.ends.garbled()
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read as _, Write as _};
    use std::os::unix::net::UnixStream;

    use super::*;

    #[test]
    fn a_line_that_babbles_holds_nobody_up() {
        let (mut line, mut babbler) = UnixStream::pair().unwrap();
        line.set_nonblocking(true).unwrap();
        babbler.write_all(&[0x55; 3 * CHUNK * MOST_FETCHES]).unwrap();
        assert!(Ends::default().receive(&line).unwrap().is_none());
        // There is more, and whoever waits for the line hears so at once.
        let mut left = std::vec::Vec::new();
        assert!(line.read_to_end(&mut left).is_err());
        assert_eq!(left.len(), 2 * CHUNK * MOST_FETCHES);
    }

    #[test]
    fn what_the_system_refuses_is_said_with_what_would_be_right() {
        for (error, words) in [
            (Errno::NOENT, "there is no device /dev/ttyS0"),
            (Errno::ACCESS, "/dev/ttyS0 may not be opened by this user: join the group that owns it"),
            (Errno::BUSY, "/dev/ttyS0 is in use by another program"),
            (Errno::NOTTY, "/dev/ttyS0 is no serial line"),
            (Errno::INVAL, "/dev/ttyS0 cannot be used: Invalid argument"),
        ] {
            let sentence = refusal(Path::new("/dev/ttyS0"), error).to_string();
            assert!(sentence.starts_with(words), "{sentence}");
        }
    }
}
