//! Lines for a person, from a loop that must not wait for whoever reads them.

use std::io::Write;
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
pub struct Lines {
    /// Taken at the end.
    waiting: Option<SyncSender<String>>,
    written: Receiver<()>,
    left_out: u64,
}

impl Lines {
    /// Lines to be written there. Should that fail, nobody is left to be told.
    pub fn to(mut out: impl Write + Send + 'static) -> Self {
        let (waiting, lines) = sync_channel::<String>(WAITING);
        let (done, written) = sync_channel(1);
        thread::spawn(move || {
            for line in lines {
                let _ = writeln!(out, "{line}").and_then(|()| out.flush());
            }
            let _ = done.send(());
        });
        Self { waiting: Some(waiting), written, left_out: 0 }
    }

    /// One line.
    pub fn say(&mut self, line: &str) {
        if self.left_out > 0
            && self
                .has_room_for(format!("Left out before this: {}.", counted(self.left_out, "line", "lines")))
        {
            self.left_out = 0;
        }
        if self.left_out > 0 || !self.has_room_for(line.to_owned()) {
            self.left_out += 1;
        }
    }

    fn has_room_for(&self, line: String) -> bool {
        let Some(waiting) = &self.waiting else { return false };
        !matches!(waiting.try_send(line), Err(TrySendError::Full(_)))
    }
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
    use std::io;
    use std::sync::{Arc, Mutex};

    /// A pipe that takes nothing until it is let, and what came through it.
    struct Pipe {
        gate: Receiver<()>,
        is_open: bool,
        passed: Arc<Mutex<Vec<u8>>>,
    }

    impl Write for Pipe {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if !self.is_open {
                self.gate.recv().map_err(io::Error::other)?;
                self.is_open = true;
            }
            self.passed.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn nobody_waits_for_who_does_not_read() {
        let (opener, gate) = sync_channel(1);
        let passed = Arc::new(Mutex::new(Vec::new()));
        let mut lines = Lines::to(Pipe { gate, is_open: false, passed: passed.clone() });
        for k in 0..5000 {
            lines.say(&format!("line {k}"));
        }
        assert!(lines.left_out > 0);
        opener.send(()).unwrap();
        let mut all = 5000;
        while lines.left_out > 0 {
            thread::yield_now();
            lines.say("once more");
            all += 1;
        }
        drop(lines);
        let text = String::from_utf8(passed.lock().unwrap().clone()).unwrap();
        let said: Vec<&str> = text.lines().collect();
        assert!((0..WAITING).all(|k| said[k] == format!("line {k}")), "{text}");
        assert_eq!(said.last(), Some(&"once more"));
        // Each line is there, or counted.
        let number = |line: &&str| {
            let count = line.strip_prefix("Left out before this: ")?.split(' ').next()?;
            Some(count.parse::<usize>().unwrap())
        };
        let left_out: Vec<usize> = said.iter().filter_map(number).collect();
        assert_eq!(said.len() - left_out.len() + left_out.iter().sum::<usize>(), all, "{text}");
    }
}
