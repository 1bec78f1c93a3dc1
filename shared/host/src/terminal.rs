//! A line that is drawn over again and again on a person's terminal.

use std::io::{self, IsTerminal, Write};

use rustix::termios::tcgetwinsize;

/// Columns of a terminal that does not tell.
const COLUMNS: u16 = 80;

/// A live line on standard error.
///
/// A carriage return goes back to the beginning of a row, not of a line: what is drawn is cut to fit into one row of the
/// terminal as wide as it is at that moment.
#[derive(Clone, Copy, Debug)]
pub struct LiveLine(());

impl LiveLine {
    /// A line on standard error; none where that is no terminal, or one that cannot go back (`TERM=dumb`).
    #[must_use]
    pub fn on_stderr() -> Option<Self> {
        let understands = std::env::var_os("TERM").is_some_and(|term| !term.is_empty() && term != "dumb");
        (understands && io::stderr().is_terminal()).then_some(Self(()))
    }

    /// Draws over what was drawn before. A terminal that cannot be written to is nobody's concern.
    pub fn draw(self, text: &str) {
        let columns = tcgetwinsize(io::stderr()).map_or(0, |size| size.ws_col);
        show(&format!("\r\x1b[K{}", fitting(text, if columns == 0 { COLUMNS } else { columns })));
    }

    /// Takes the line away.
    pub fn clear(self) {
        show("\r\x1b[K");
    }
}

/// As much of a line as leaves the last column free: a full row may already begin the next.
fn fitting(text: &str, columns: u16) -> &str {
    let end = text.char_indices().nth(usize::from(columns.saturating_sub(1)));
    end.and_then(|(end, _)| text.get(..end)).unwrap_or(text)
}

fn show(text: &str) {
    let mut err = io::stderr().lock();
    let _ = err.write_all(text.as_bytes()).and_then(|()| err.flush());
}

#[cfg(test)]
mod tests {
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
}
