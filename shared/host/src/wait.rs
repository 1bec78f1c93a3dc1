//! Waiting for a moment, or for a wire before it.

use std::os::fd::BorrowedFd;

use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;
use rustix::thread::clock_nanosleep_absolute;
use rustix::time::ClockId;

use crate::clock;

/// The last stretch before a moment, microseconds, in which only the moment counts: from here the kernel is given the
/// moment itself, so that nothing which happens on the way to sleep makes it later. What arrives meanwhile is seen after it.
const LAST_STRETCH_US: u64 = 100;

/// A file descriptor to wait for: until it has something to read, and, if wanted, until it can be written.
#[derive(Clone, Copy, Debug)]
pub struct Interest<'fd> {
    /// Which.
    pub fd: BorrowedFd<'fd>,
    /// Whether room to write is waited for too.
    pub writable: bool,
}

impl<'fd> Interest<'fd> {
    fn poll_fd(&self) -> PollFd<'fd> {
        let flags = if self.writable { PollFlags::IN | PollFlags::OUT } else { PollFlags::IN };
        PollFd::from_borrowed_fd(self.fd, flags)
    }
}

/// Why waiting is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Woken<const N: usize> {
    /// Which of the interests have something to read, room to write as wanted, or have failed.
    pub ready: [bool; N],
    /// How long the moment had passed when the process ran again, microseconds; `None` if it was woken before it.
    pub late_us: Option<u64>,
}

/// Waits until a moment, microseconds of `CLOCK_MONOTONIC`, or until one of `interests` is ready; without a moment, until
/// the latter. A signal that is handled elsewhere does not end it.
///
/// # Errors
/// If a descriptor cannot be waited for.
pub fn wait_until<const N: usize>(
    moment_us: Option<u64>,
    interests: [Option<Interest<'_>>; N],
) -> std::io::Result<Woken<N>> {
    loop {
        let left_us = moment_us.map(|moment| moment.saturating_sub(clock::now_us()));
        if left_us.is_some_and(|left| left <= LAST_STRETCH_US) {
            return last_stretch(moment_us.unwrap_or(0), &interests);
        }
        let timeout_us = left_us.map(|left| left.saturating_sub(LAST_STRETCH_US));
        let ready = poll_for(timeout_us, &interests)?;
        if ready.contains(&true) {
            return Ok(Woken { ready, late_us: None });
        }
    }
}

fn last_stretch<const N: usize>(
    moment_us: u64,
    interests: &[Option<Interest<'_>>; N],
) -> std::io::Result<Woken<N>> {
    while clock::now_us() < moment_us {
        match clock_nanosleep_absolute(ClockId::Monotonic, &clock::timespec(moment_us)) {
            Ok(()) | Err(Errno::INTR) => {}
            Err(error) => return Err(error.into()),
        }
    }
    let late_us = Some(clock::now_us().saturating_sub(moment_us));
    Ok(Woken { ready: poll_for(Some(0), interests)?, late_us })
}

/// Polls once; nothing is ready after a signal.
fn poll_for<const N: usize>(
    timeout_us: Option<u64>,
    interests: &[Option<Interest<'_>>; N],
) -> std::io::Result<[bool; N]> {
    let mut fds: heapless::Vec<PollFd<'_>, N> = interests.iter().flatten().map(Interest::poll_fd).collect();
    match poll(&mut fds, timeout_us.map(clock::timespec).as_ref()) {
        Ok(_) => {}
        Err(Errno::INTR) => return Ok([false; N]),
        Err(error) => return Err(error.into()),
    }
    let mut polled = fds.iter().map(|fd| !fd.revents().is_empty());
    Ok(interests.each_ref().map(|interest| interest.is_some() && polled.next().unwrap_or(false)))
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::os::fd::AsFd;
    use std::os::unix::net::UnixStream;
    use std::time::Duration;

    use super::*;

    fn readable(stream: &UnixStream) -> Option<Interest<'_>> {
        Some(Interest { fd: stream.as_fd(), writable: false })
    }

    #[test]
    fn a_moment_is_never_early_and_its_lateness_is_measured() {
        let (here, _there) = UnixStream::pair().unwrap();
        for ahead_us in [0, 50, 300, 5_000] {
            let moment_us = clock::now_us() + ahead_us;
            let woken = wait_until(Some(moment_us), [readable(&here)]).unwrap();
            let now_us = clock::now_us();
            assert!(now_us >= moment_us);
            assert_eq!(woken.ready, [false]);
            assert!(woken.late_us.unwrap() <= now_us - moment_us);
        }
    }

    #[test]
    fn a_wire_ends_the_wait_and_a_moment_that_has_passed_still_shows_it() {
        let (here, mut there) = UnixStream::pair().unwrap();
        let (quiet, _other) = UnixStream::pair().unwrap();
        let writer = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(10));
            there.write_all(b"x").unwrap();
            there
        });
        let woken = wait_until(None, [None, readable(&quiet), readable(&here)]).unwrap();
        assert_eq!(woken, Woken { ready: [false, false, true], late_us: None });
        let _there = writer.join().unwrap();
        let woken = wait_until(Some(clock::now_us() - 1000), [readable(&here), None]).unwrap();
        assert_eq!(woken.ready, [true, false]);
        assert!(woken.late_us.unwrap() >= 1000);
        (&here).read_exact(&mut [0]).unwrap();
    }

    #[test]
    fn room_to_write_and_a_closed_end_are_ready_too() {
        let (here, there) = UnixStream::pair().unwrap();
        let writable = [Some(Interest { fd: here.as_fd(), writable: true })];
        assert_eq!(wait_until(None, writable).unwrap().ready, [true]);
        drop(there);
        assert_eq!(wait_until(None, [readable(&here)]).unwrap().ready, [true]);
    }
}
