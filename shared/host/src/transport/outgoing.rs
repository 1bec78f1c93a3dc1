//! Bytes on their way into a terminal, which may take a frame in parts.

use std::os::fd::BorrowedFd;

use heapless::Vec;
use powderline_shared::wire::serial::MAX_LINE_BYTES;
use rustix::io::{Errno, write};

use super::Sent;
use crate::system;

/// Most bytes that wait in front of a line, here and in its driver together: more would be setpoints that come too late.
/// A tick of one executor, with its heartbeat, is 68 bytes; one of an arm, with status, fault and heartbeat, 120.
pub const MAX_QUEUED: usize = 4 * MAX_LINE_BYTES;

/// What is left of frames that were taken in part.
#[derive(Debug, Default)]
pub(super) struct Outgoing {
    left: Vec<u8, MAX_QUEUED>,
}

impl Outgoing {
    pub(super) fn is_empty(&self) -> bool {
        self.left.is_empty()
    }

    pub(super) fn clear(&mut self) {
        self.left.clear();
    }

    /// Takes all of a frame or nothing of it, and hands on what it can.
    pub(super) fn send(&mut self, terminal: BorrowedFd<'_>, encoded: &[u8]) -> Result<Sent, Errno> {
        self.flush(terminal)?;
        // A driver that does not tell how much it holds is asked for room only by writing to it.
        let held = system::bytes_to_be_sent(terminal).unwrap_or(0);
        let queued = held.saturating_add(self.left.len()).saturating_add(encoded.len());
        if queued > MAX_QUEUED || self.left.extend_from_slice(encoded).is_err() {
            return Ok(Sent::Busy);
        }
        self.flush(terminal)?;
        Ok(Sent::Done)
    }

    /// Writes what the terminal takes at once.
    pub(super) fn flush(&mut self, terminal: BorrowedFd<'_>) -> Result<(), Errno> {
        while !self.left.is_empty() {
            match write(terminal, &self.left) {
                Ok(written) => self.remove(written),
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => break,
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn remove(&mut self, written: usize) {
        let written = written.min(self.left.len());
        self.left.rotate_left(written);
        self.left.truncate(self.left.len().saturating_sub(written));
    }
}
