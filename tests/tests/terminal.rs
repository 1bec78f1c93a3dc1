//! What a person sees: the programs on a pseudo-terminal, and which of its rows they use.

#![cfg(unix)]

use std::fs::File;
use std::io::Read;
use std::num::NonZero;
use std::os::fd::OwnedFd;
use std::process::{Child, Command, Stdio};

use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Winsize, tcsetwinsize};

use crate::programs::{EXECUTE, FIRMWARE_SIM, OPTIMISE, Place};

/// More than any of these programs has to say: nothing scrolls out of sight.
const ROWS: NonZero<u16> = NonZero::new(500).unwrap();

/// A program on a terminal of its own.
struct Terminal {
    child: Child,
    master: OwnedFd,
    output: File,
    emulator: vt100::Parser,
    /// All that was written.
    text: String,
}

impl Terminal {
    fn start(columns: u16, program: &str, arguments: &[&str], environment: &[(&str, &str)]) -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let name = ptsname(&master, Vec::new()).unwrap();
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let slave = rustix::fs::open(name, flags, Mode::empty()).unwrap();
        set_columns(&master, columns);
        let child = Command::new(program)
            .args(arguments)
            .env_remove("NO_COLOR")
            .envs([("TERM", "xterm"), ("LC_ALL", "C.UTF-8")])
            .envs(environment.iter().copied())
            .stdin(Stdio::null())
            .stdout(slave.try_clone().unwrap())
            .stderr(slave)
            .spawn()
            .unwrap();
        let output = File::from(master.try_clone().unwrap());
        Self {
            child,
            master,
            output,
            emulator: vt100::Parser::new(ROWS, NonZero::new(columns).unwrap(), 0),
            text: String::new(),
        }
    }

    fn resize(&mut self, columns: u16) {
        self.emulator.screen_mut().set_size(ROWS, NonZero::new(columns).unwrap());
        set_columns(&self.master, columns);
    }

    /// Shows the next of what the program writes; `false` once it has ended.
    fn show(&mut self) -> bool {
        let mut bytes = [0; 4096];
        // The end of the last program on it is an error of the terminal's.
        let count = self.output.read(&mut bytes).unwrap_or(0);
        self.emulator.process(&bytes[..count]);
        self.text += &String::from_utf8_lossy(&bytes[..count]);
        count > 0
    }

    fn rows(&self) -> Vec<String> {
        let (_, columns) = self.emulator.screen().size();
        self.emulator.screen().rows(0, columns.get()).map(|row| row.trim_end().to_owned()).collect()
    }

    /// Shows everything, and looks at every moment whether more than one row is live by this mark.
    fn watch(mut self, mark: &str) -> Self {
        while self.show() {
            let live = self.live(mark);
            assert!(live <= 1, "{live} rows with `{mark}`:\n{}", self.emulator.screen().contents());
        }
        self
    }

    fn live(&self, mark: &str) -> usize {
        self.rows().iter().filter(|row| has(row, mark)).count()
    }

    /// The last screen of a program that succeeded, or of a run whose plan misses the wanted amount.
    #[track_caller]
    fn ended(&mut self) -> Vec<String> {
        assert!(matches!(self.child.wait().unwrap().code(), Some(0 | 3)), "{}", self.text);
        self.rows()
    }
}

fn set_columns(terminal: &OwnedFd, columns: u16) {
    let size = Winsize { ws_row: 50, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 };
    tcsetwinsize(terminal, size).unwrap();
}

/// What begins a redraw, and what only a live line holds.
const REDRAW: &str = "\r\x1b[2K";
const BAR: &str = " [";

/// Whether a row holds a mark; a bar is empty or filled where it begins, unlike a range in a sentence.
fn has(row: &str, mark: &str) -> bool {
    let filled = |cell| row.contains(&format!("{mark}{cell}"));
    if mark == BAR { filled('#') || filled('.') } else { row.contains(mark) }
}

#[test]
fn progress_takes_one_row_of_any_terminal() {
    let place = Place::new();
    for columns in [30, 60, 80] {
        let folder = place.path(&format!("run{columns}"));
        let arguments = ["run", &place.tiny(), "--no-refine", "--epochs", "3", "--out", &folder];
        let mut terminal = Terminal::start(columns, OPTIMISE, &arguments, &[]).watch(BAR);
        let rows = terminal.ended();
        // What is left is what stays, each line in as many rows as it has to have.
        let lines = terminal.text.lines().map(|line| line.rsplit(REDRAW).next().unwrap_or_default());
        let needed: usize =
            lines.map(|line| line.trim_end().chars().count().div_ceil(columns.into()).max(1)).sum();
        let used = rows.iter().rposition(|row| !row.is_empty()).unwrap() + 1;
        assert_eq!(used, needed, "{columns} columns:\n{}", rows[..used].join("\n"));
        assert!(!rows.iter().any(|row| has(row, BAR)), "{}", rows.join("\n"));
        // It was live, with the chart where there is room for it.
        assert!(terminal.text.matches(REDRAW).count() > 2 * 4, "{:?}", terminal.text);
        let chart = terminal.text.contains("  missing \u{2581}");
        assert!(chart == (columns == 80) || columns == 60, "{:?}", terminal.text);
        // There, an epoch that is done is one row.
        let epochs: Vec<_> = rows.iter().filter(|row| row.starts_with("epoch")).collect();
        assert_eq!(epochs.len(), 4, "{}", rows.join("\n"));
        assert!(columns < 80 || epochs.iter().all(|row| row.ends_with(" s")), "{}", rows.join("\n"));
    }
}

#[test]
fn a_window_that_changes_while_it_runs_is_not_flooded() {
    let place = Place::new();
    let arguments = ["run", &place.tiny(), "--no-refine", "--epochs", "6", "--out", &place.path("run")];
    let mut terminal = Terminal::start(132, OPTIMISE, &arguments, &[]);
    let mut widths = [60, 100, 40, 80, 20].into_iter();
    let (mut changes, mut seen) = (0, 0);
    while terminal.show() {
        // A line that is under way while the window shrinks may leave a row behind, no more.
        assert!(terminal.live(BAR) <= 1 + changes, "{}", terminal.emulator.screen().contents());
        let drawn = terminal.text.matches(REDRAW).count();
        if drawn >= seen + 2
            && let Some(columns) = widths.next()
        {
            terminal.resize(columns);
            (changes, seen) = (changes + 1, drawn);
        }
    }
    assert!(changes > 0, "it never changed: {:?}", terminal.text);
    terminal.ended();
    assert!(terminal.live(BAR) <= changes, "{}", terminal.emulator.screen().contents());
}

#[test]
fn a_terminal_that_understands_nothing_gets_what_a_file_gets() {
    let place = Place::new();
    let arguments = ["run", &place.tiny(), "--no-refine", "--epochs", "1", "--out", &place.path("run")];
    let mut terminal = Terminal::start(80, OPTIMISE, &arguments, &[("TERM", "dumb")]).watch(BAR);
    terminal.ended();
    let text = terminal.text.replace("\r\n", "\n");
    assert!(text.contains("epoch   1/1") && !text.contains(['\r', '\x1b']), "{text:?}");
}

/// Whether any text is coloured, bold or underlined.
fn is_styled(text: &str) -> bool {
    let ends =
        |rest: &str| rest.trim_start_matches(|c: char| c.is_ascii_digit() || c == ';').starts_with('m');
    text.split("\x1b[").skip(1).any(ends)
}

#[test]
fn no_color_means_none() {
    let place = Place::new();
    let text = |program: &str, arguments: &[&str], environment: &[(&str, &str)]| {
        let mut terminal = Terminal::start(80, program, arguments, environment);
        while terminal.show() {}
        terminal.ended();
        terminal.text
    };
    for program in [OPTIMISE, EXECUTE, FIRMWARE_SIM] {
        assert!(is_styled(&text(program, &["--help"], &[])), "{program}");
        assert!(!is_styled(&text(program, &["--help"], &[("NO_COLOR", "1")])), "{program}");
    }
    // Progress has no colour to begin with.
    let run = ["run", &place.tiny(), "--no-refine", "--epochs", "0", "--out", &place.path("run")];
    let text = text(OPTIMISE, &run, &[]);
    assert!(text.contains(REDRAW) && !is_styled(&text), "{text:?}");
}

#[test]
fn the_ticks_of_a_motion_take_one_row() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.tiny_run("run", 0));
    let mut terminal = Terminal::start(40, EXECUTE, &[&plan, "--realtime"], &[]).watch("  tick ");
    let rows = terminal.ended();
    assert!(terminal.text.contains("\r\x1b[K  tick "), "{:?}", terminal.text);
    assert!(!rows.iter().any(|row| row.contains("  tick ")), "{}", rows.join("\n"));
}
