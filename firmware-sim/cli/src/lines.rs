//! Lines for a person, from a loop that must not wait for whoever reads them.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread;
use std::time::Duration;

use powderline_host::words::counted;

/// Lines that wait to be read, at most.
const WAITING: usize = 1024;

/// How long those that still wait are given at the end.
const AT_THE_END: Duration = Duration::from_secs(1);

/// Writes lines from a thread of its own. An arm is looked after by whoever says them: where nobody reads, as behind a full pipe or a terminal
/// that Ctrl-S has stopped, lines are left out, and it says how many once there is room again.
pub(crate) struct Lines {
    /// Taken at the end.
    waiting: Option<SyncSender<String>>,
    written: Receiver<()>,
    left_out: Arc<AtomicU64>,
}

impl Lines {
    /// Lines to be written there. Should that fail, nobody is left to be told.
    ///
    /// # Errors
    /// There is no thread to be had.
    pub(crate) fn to(mut out: impl Write + Send + 'static) -> io::Result<Self> {
        let (waiting, lines) = sync_channel::<String>(WAITING);
        let (done, written) = sync_channel(1);
        let left_out = Arc::new(AtomicU64::new(0));
        let at_the_end = left_out.clone();
        thread::Builder::new().spawn(move || {
            let mut write = |line: &str| {
                let _ = writeln!(out, "{line}").and_then(|()| out.flush());
            };
            lines.into_iter().for_each(|line| write(&line));
            let count = at_the_end.load(Ordering::Relaxed);
            if count > 0 {
                write(&left_out_in_words(count));
            }
            let _ = done.send(());
        })?;
        Ok(Self { waiting: Some(waiting), written, left_out })
    }

    /// One line.
    pub(crate) fn say(&mut self, line: &str) {
        let count = self.left_out.load(Ordering::Relaxed);
        let is_told = count == 0 || self.has_room_for(left_out_in_words(count));
        let is_said = is_told && self.has_room_for(line.to_owned());
        let still = if is_told { 0 } else { count };
        self.left_out.store(still + u64::from(!is_said), Ordering::Relaxed);
    }

    fn has_room_for(&self, line: String) -> bool {
        let Some(waiting) = &self.waiting else { return false };
        !matches!(waiting.try_send(line), Err(TrySendError::Full(_)))
    }
}

fn left_out_in_words(count: u64) -> String {
    format!("Left out before this: {}.", counted(count, "line", "lines"))
}

impl Drop for Lines {
    fn drop(&mut self) {
        drop(self.waiting.take());
        let _ = self.written.recv_timeout(AT_THE_END);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pipe that takes nothing until it is let.
    struct Pipe {
        gate: Receiver<()>,
        is_open: bool,
        passed: SyncSender<Vec<u8>>,
    }

    impl Write for Pipe {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if !self.is_open {
                self.gate.recv().map_err(io::Error::other)?;
                self.is_open = true;
            }
            self.passed.send(bytes.to_vec()).map_err(io::Error::other)?;
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// All that passes a pipe that is opened after 5000 lines, and how many lines were said; `later` says some more.
    fn said(later: impl FnOnce(&mut Lines) -> usize) -> (Vec<String>, usize) {
        let (opener, gate) = sync_channel(1);
        let (passed, passing) = sync_channel(1 << 16);
        let mut lines = Lines::to(Pipe { gate, is_open: false, passed }).unwrap();
        for k in 0..5000 {
            lines.say(&format!("line {k}"));
        }
        assert!(lines.left_out.load(Ordering::Relaxed) > 0);
        opener.send(()).unwrap();
        let all = 5000 + later(&mut lines);
        drop(lines);
        // Until nobody writes any more.
        let bytes: Vec<u8> = passing.iter().flatten().collect();
        let text = String::from_utf8(bytes).unwrap();
        (text.lines().map(String::from).collect(), all)
    }

    /// Each line is there, or counted.
    fn all_is_accounted_for(said: &[String], all: usize) {
        assert!((0..WAITING).all(|k| said[k] == format!("line {k}")), "{said:?}");
        let number = |line: &String| {
            let count = line.strip_prefix("Left out before this: ")?.split(' ').next()?;
            Some(count.parse::<usize>().unwrap())
        };
        let left_out: Vec<usize> = said.iter().filter_map(number).collect();
        assert_eq!(said.len() - left_out.len() + left_out.iter().sum::<usize>(), all, "{said:?}");
    }

    #[test]
    fn nobody_waits_for_who_does_not_read() {
        let (lines, all) = said(|lines| {
            let mut said = 0;
            while lines.left_out.load(Ordering::Relaxed) > 0 {
                thread::yield_now();
                lines.say("once more");
                said += 1;
            }
            said
        });
        all_is_accounted_for(&lines, all);
        assert_eq!(lines.last().map(String::as_str), Some("once more"));
    }

    #[test]
    fn who_reads_again_at_the_end_is_told_what_is_missing() {
        let (lines, all) = said(|_| 0);
        all_is_accounted_for(&lines, all);
        assert!(lines.last().unwrap().starts_with("Left out before this: "));
    }
}
