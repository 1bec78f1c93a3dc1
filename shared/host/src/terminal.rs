//! A line that is drawn over again and again on a person's terminal.

use std::fs::File;
use std::io::{self, IsTerminal, Write};
use std::os::fd::{AsFd, AsRawFd};
use std::sync::OnceLock;

use rustix::fs::{Mode, OFlags, open};
use rustix::termios::tcgetwinsize;

/// Columns of a terminal that does not tell.
const COLUMNS: u16 = 80;

/// A live line on standard error, which never waits: what the terminal has no room for, because Ctrl-S has stopped it or a line
/// to it has stalled, is left out. Whoever draws may have an arm to look after.
///
/// A carriage return goes back to the beginning of a row, not of a line: what is drawn is cut to fit into one row of the
/// terminal as wide as it is at that moment.
#[derive(Clone, Copy, Debug)]
pub struct LiveLine(&'static File);

impl LiveLine {
    /// A line on standard error; none where that is no terminal, or one that cannot go back (`TERM=dumb`), or cannot be opened
    /// once more.
    #[must_use]
    pub fn on_stderr() -> Option<Self> {
        static OPENED: OnceLock<Option<File>> = OnceLock::new();
        let understands = std::env::var_os("TERM").is_some_and(|term| !term.is_empty() && term != "dumb");
        if !understands || !io::stderr().is_terminal() {
            return None;
        }
        OPENED.get_or_init(|| opened_anew(io::stderr()).ok()).as_ref().map(Self)
    }

    /// Draws over what was drawn before. A terminal that cannot be written to is nobody's concern.
    pub fn draw(self, text: &str) {
        let columns = tcgetwinsize(self.0).map_or(0, |size| size.ws_col);
        self.show(&format!("\r\x1b[K{}", fitting(text, if columns == 0 { COLUMNS } else { columns })));
    }

    /// Takes the line away.
    pub fn clear(self) {
        self.show("\r\x1b[K");
    }

    /// The rest of what was cut off is drawn over by the next.
    fn show(mut self, text: &str) {
        let _ = self.0.write(text.as_bytes());
    }
}

/// The same terminal, opened so that writing does not wait. That is a property of what was opened, and others have what this
/// process was given open too. Whether there is room cannot be asked beforehand: there may be some, but too little.
fn opened_anew(terminal: impl AsFd) -> io::Result<File> {
    let path = format!("/proc/self/fd/{}", terminal.as_fd().as_raw_fd());
    let flags = OFlags::WRONLY | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
    Ok(File::from(open(path, flags, Mode::empty())?))
}

/// As much of a line as leaves the last column free: a full row may already begin the next.
fn fitting(text: &str, columns: u16) -> &str {
    let end = text.char_indices().nth(usize::from(columns.saturating_sub(1)));
    end.and_then(|(end, _)| text.get(..end)).unwrap_or(text)
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    use rustix::termios::{Action, tcflow};

    use super::*;

    #[test]
    fn a_line_is_shorter_than_its_row() {
        assert_eq!(fitting("tick 1", 80), "tick 1");
        assert_eq!(fitting("tick 1", 7), "tick 1");
        assert_eq!(fitting("tick 1", 6), "tick ");
        assert_eq!(
            (fitting("\u{2581}\u{2582}", 2), fitting("tick 1", 1), fitting("", 0)),
            ("\u{2581}", "", "")
        );
    }

    /// Both ends of a terminal.
    fn terminal() -> (File, File) {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let name = ptsname(&master, Vec::new()).unwrap();
        let slave = open(name, OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).unwrap();
        (File::from(master), File::from(slave))
    }

    fn line_on(terminal: &File) -> LiveLine {
        LiveLine(Box::leak(Box::new(opened_anew(terminal).unwrap())))
    }

    /// All that comes until a mark has.
    fn read_until(master: &mut File, mark: &str) -> String {
        let mut seen = String::new();
        while !seen.contains(mark) {
            let mut bytes = [0; 4096];
            let count = master.read(&mut bytes).unwrap();
            seen.push_str(str::from_utf8(&bytes[..count]).unwrap());
        }
        seen
    }

    #[test]
    fn a_terminal_that_nobody_reads_is_not_waited_for() {
        let (mut master, slave) = terminal();
        let line = line_on(&slave);
        for _ in 0..10_000 {
            line.draw("tick 1");
        }
        // Until it is full; then there is room for a part of what is drawn.
        while (&*line.0).write(b"x").is_ok() {}
        let _ = master.read(&mut [0; 4]).unwrap();
        line.draw(&"tick 2 ".repeat(10));
        line.clear();
        // Once somebody reads again, it is drawn again.
        let reader = std::thread::spawn(move || read_until(&mut master, "tick 3"));
        while !reader.is_finished() {
            line.draw("tick 3");
        }
        reader.join().unwrap();
        // What the process was given waits as before.
        let flags = rustix::fs::fcntl_getfl(&slave).unwrap();
        assert!(!flags.contains(OFlags::NONBLOCK));
    }

    #[test]
    fn a_terminal_that_was_stopped_is_not_waited_for() {
        let (mut master, slave) = terminal();
        let line = line_on(&slave);
        // As Ctrl-S and Ctrl-Q do.
        tcflow(&slave, Action::OOff).unwrap();
        line.draw("tick 1");
        tcflow(&slave, Action::OOn).unwrap();
        line.draw("tick 2");
        assert_eq!(read_until(&mut master, "tick 2"), "\r\x1b[Ktick 2");
    }
}
