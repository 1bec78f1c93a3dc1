//! A person's wish to stop: Ctrl-C, `kill`, or the terminal closed.

use std::io;
use std::io::Read;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;

use signal_hook::SigId;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::low_level::{pipe, unregister};

use crate::wait::Interest;

/// What is wished.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum StopWish {
    /// Nothing.
    #[default]
    None,
    /// A controlled stop: once asked.
    Controlled,
    /// An end at once, whatever the arm does: asked again.
    Immediate,
}

/// Takes SIGINT, SIGTERM and SIGHUP from the system, which would end the process, and counts them instead. SIGQUIT
/// (Ctrl-\) still ends the process, should it ever hang.
///
/// SIGHUP is a wish, but never a second one: a terminal that is closed sends it twice, and a service manager beside SIGTERM.
///
/// Each arrives as a byte on a pipe, so that it wakes [`wait_until`](crate::wait::wait_until) even if it comes just before
/// the wait.
#[derive(Debug)]
pub struct Signals {
    read_end: UnixStream,
    /// A byte for each that has been read there.
    hang_up_end: UnixStream,
    registered: Vec<SigId>,
    arrived: usize,
    hang_ups: usize,
}

impl Signals {
    /// Takes the signals; dropping gives up the pipe, not the signals, which then do nothing.
    ///
    /// # Errors
    /// If the system has no pipe or no handler to give.
    pub fn install() -> io::Result<Self> {
        let (read_end, write_end) = UnixStream::pair()?;
        let (hang_up_end, hang_up) = UnixStream::pair()?;
        for end in [&read_end, &hang_up_end] {
            end.set_nonblocking(true)?;
        }
        let mut signals = Self { read_end, hang_up_end, registered: Vec::new(), arrived: 0, hang_ups: 0 };
        // First of its two: whoever finds its byte among all of them finds it here too.
        signals.registered.push(pipe::register(SIGHUP, hang_up)?);
        for signal in [SIGINT, SIGTERM, SIGHUP] {
            signals.registered.push(pipe::register(signal, write_end.try_clone()?)?);
        }
        Ok(signals)
    }

    /// What to wait for.
    #[must_use]
    pub fn interest(&self) -> Interest<'_> {
        Interest { fd: self.read_end.as_fd(), writable: false }
    }

    /// What is wished by now.
    pub fn wish(&mut self) -> StopWish {
        self.arrived = self.arrived.saturating_add(drained(&mut self.read_end));
        self.hang_ups = self.hang_ups.saturating_add(drained(&mut self.hang_up_end));
        match (self.arrived.saturating_sub(self.hang_ups), self.hang_ups) {
            (0, 0) => StopWish::None,
            (0 | 1, _) => StopWish::Controlled,
            _ => StopWish::Immediate,
        }
    }
}

/// How many bytes there were.
fn drained(end: &mut UnixStream) -> usize {
    let (mut bytes, mut all) = ([0; 16], 0_usize);
    while let Ok(count @ 1..) = end.read(&mut bytes) {
        all = all.saturating_add(count);
    }
    all
}

impl Drop for Signals {
    fn drop(&mut self) {
        for id in self.registered.drain(..) {
            unregister(id);
        }
    }
}

#[cfg(test)]
mod tests {
    use signal_hook::low_level::raise;

    use super::*;
    use crate::clock;
    use crate::wait::wait_until;

    #[test]
    fn presses_are_counted_and_wake_a_wait() {
        let mut signals = Signals::install().unwrap();
        assert_eq!(signals.wish(), StopWish::None);
        let in_a_minute_us = clock::now_us() + 60_000_000;
        let press = std::thread::spawn(|| raise(SIGINT).unwrap());
        let woken = wait_until(Some(in_a_minute_us), [Some(signals.interest())]).unwrap();
        press.join().unwrap();
        assert_eq!((woken.ready, woken.late_us), ([true], None));
        assert_eq!(signals.wish(), StopWish::Controlled);
        assert_eq!(signals.wish(), StopWish::Controlled, "a wish stays");
        for _ in 0..2 {
            raise(SIGHUP).unwrap();
            assert_eq!(signals.wish(), StopWish::Controlled, "a terminal that was closed");
        }
        raise(SIGTERM).unwrap();
        assert_eq!(signals.wish(), StopWish::Immediate);
        drop(signals);
        let mut signals = Signals::install().unwrap();
        raise(SIGHUP).unwrap();
        raise(SIGTERM).unwrap();
        assert_eq!(signals.wish(), StopWish::Controlled);
    }
}
