//! Live progress on standard error: a line that is redrawn on a terminal, one line per epoch elsewhere.
//!
//! A carriage return goes back to the beginning of a row, not of a line: the line is kept shorter than a row, by the width that
//! the terminal has at each redraw. A terminal that understands nothing (`TERM=dumb`) gets what a file gets. There is no colour
//! that `NO_COLOR` would have to take away.

use super::Interrupt;
use crate::optim::EpochRecord;
use crate::report::{
    amounts::{Amounts, percent},
    words::{duration, grouped},
};
use crate::run::MAX_EPOCHS;
use powderline_simulator::rollout::ProgressFn;
use std::{
    io::{self, IsTerminal, Write},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

/// Time between two redraws.
const REDRAW: Duration = Duration::from_millis(100);

/// How long a window keeps its new width before something is drawn in it: while it is dragged narrower, every line that was
/// drawn wider may leave a row behind.
const SETTLED: Duration = Duration::from_millis(300);

/// Columns of a terminal that does not tell, and the most that are used: only in a window narrower than that can a change of
/// its width do harm.
const COLUMNS: usize = 80;

/// Cells of the bar and of the small chart, best first: the first that fits is drawn.
const LAYOUTS: [[usize; 2]; 5] = [[20, 20], [10, 12], [20, 0], [10, 0], [0, 0]];

/// Epochs in the small chart at most, and its bars.
const CHART_CELLS: usize = 20;
const BARS: [char; 8] =
    ['\u{2581}', '\u{2582}', '\u{2583}', '\u{2584}', '\u{2585}', '\u{2586}', '\u{2587}', '\u{2588}'];

/// Whether standard error is a terminal on which a line can be drawn over.
pub fn is_live() -> bool {
    let understands = std::env::var_os("TERM").is_some_and(|term| !term.is_empty() && term != "dumb");
    io::stderr().is_terminal() && (understands || cfg!(windows))
}

/// Columns of the terminal on standard error, as it is now.
fn columns() -> Option<usize> {
    terminal_size::terminal_size_of(io::stderr()).map(|(width, _)| width.0.into())
}

/// Where a person reads what is said on the way: standard error, or a buffer.
#[derive(Clone)]
pub struct Stream(Arc<Mutex<dyn Write + Send>>);

impl Stream {
    /// What is written goes there.
    pub fn new(out: impl Write + Send + 'static) -> Self {
        Self(Arc::new(Mutex::new(out)))
    }
}

impl<W: Write + Send + 'static> From<Arc<Mutex<W>>> for Stream {
    fn from(out: Arc<Mutex<W>>) -> Self {
        Self(out)
    }
}

impl Write for Stream {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).flush()
    }
}

/// Shows how far a command is. Copies show the same.
#[derive(Clone)]
pub struct Progress(Arc<Mutex<Line>>);

impl Progress {
    /// Progress shown on `out`.
    pub fn new(out: &Stream, live: bool) -> Self {
        Self(Arc::new(Mutex::new(Line::new(out.clone(), live))))
    }

    fn line_of(&self) -> MutexGuard<'_, Line> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What a simulator is to tell, until the person asks to stop.
    pub fn watch(&self, interrupt: &Interrupt) -> ProgressFn {
        let (progress, interrupt) = (self.clone(), interrupt.clone());
        Box::new(move |share| {
            progress.tick(share);
            interrupt.flow()
        })
    }

    /// Begins a task; `later` evaluations follow it, each of the duration of those in `history`.
    pub fn begin(&self, task: &str, later: u32, history: &[EpochRecord]) {
        self.line_of().begin(task, later, history);
    }

    /// Seconds since the task began.
    pub fn seconds(&self) -> f64 {
        self.line_of().seconds()
    }

    /// Called now and then with the share of the task that is done.
    pub fn tick(&self, share: f64) {
        self.line_of().tick(share);
    }

    /// Reports an epoch that is done, of those until the last that is to come and of those that there might be; on a narrow
    /// terminal in fewer columns.
    pub fn epoch(
        &self,
        record: &EpochRecord,
        amounts: &Amounts,
        last_and_all: [u32; 2],
        history: &[EpochRecord],
    ) {
        self.line_of().epoch(record, amounts, last_and_all, history);
    }

    /// Writes a whole line, over the live one if there is one.
    pub fn line(&self, text: &str) {
        self.line_of().line(text);
    }

    /// Takes the live line away.
    pub fn clear(&self) {
        self.line_of().clear();
    }
}

/// The live line.
struct Line {
    out: Stream,
    /// Whether `out` is a terminal, on which a line can be drawn over.
    live: bool,
    /// Asks the terminal for its columns.
    columns: fn() -> Option<usize>,
    /// Its columns when last asked, and when they were found to be others than before.
    window: Option<(usize, Option<Instant>)>,
    /// What is being done, such as `epoch 3/30`.
    task: String,
    started: Instant,
    drawn: Option<Instant>,
    /// Evaluations to come after the present one, and what one has taken on average, seconds.
    later: Option<(u32, f64)>,
    /// The indicator of the latest epochs, drawn small, where the terminal can show it.
    indicators: Vec<i64>,
}

impl Line {
    fn new(out: Stream, live: bool) -> Self {
        Self {
            out,
            live,
            columns,
            window: None,
            task: String::new(),
            started: Instant::now(),
            drawn: None,
            later: None,
            indicators: Vec::new(),
        }
    }

    fn begin(&mut self, task: &str, later: u32, history: &[EpochRecord]) {
        let mean_s = history.iter().map(|record| record.seconds).sum::<f64>() / history.len().max(1) as f64;
        self.task = task.into();
        self.started = Instant::now();
        self.drawn = None;
        self.later = (!history.is_empty()).then_some((later, mean_s));
        self.indicators.clear();
        if self.live && has_blocks() {
            let latest = &history[history.len().saturating_sub(CHART_CELLS)..];
            self.indicators.extend(latest.iter().map(|record| record.indicator));
        }
        self.tick(0.0);
    }

    fn seconds(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    fn tick(&mut self, share: f64) {
        if !self.live || self.drawn.is_some_and(|drawn| drawn.elapsed() < REDRAW) {
            return;
        }
        let Some(room) = self.room() else { return };
        self.drawn = Some(Instant::now());
        let line = self.fitting(room, share.clamp(0.0, 1.0));
        // A terminal that cannot be written to is no reason to stop a run.
        let _ = write!(self.out, "\r\x1b[2K{line}");
        let _ = self.out.flush();
    }

    /// Columns for a line that is drawn over: one fewer than there are, as a full row may already begin the next. None while
    /// the window's width changes.
    fn room(&mut self) -> Option<usize> {
        let now = (self.columns)().unwrap_or(COLUMNS).min(COLUMNS);
        let settled = match self.window {
            None => {
                self.window = Some((now, None));
                true
            }
            Some((before, since)) if before == now => since.is_none_or(|since| since.elapsed() >= SETTLED),
            Some(_) => {
                self.window = Some((now, Some(Instant::now())));
                false
            }
        };
        settled.then_some(now - 1)
    }

    /// The live line in at most so many columns.
    fn fitting(&self, room: usize, share: f64) -> String {
        let left = self.left_s(share).map(|left| format!(", about {} left", duration(left)));
        let left = left.unwrap_or_default();
        let line = |[bar_cells, chart_cells]: [usize; 2]| {
            let Self { task, indicators, .. } = self;
            let latest = &indicators[indicators.len().saturating_sub(chart_cells)..];
            let (chart, bar) = (chart(latest), bar(share, bar_cells));
            format!("{task}{chart}{bar} {:3.0} %{left}", 100.0 * share)
        };
        let lines = LAYOUTS.map(line);
        let best = lines.iter().find(|line| line.chars().count() <= room);
        best.unwrap_or(&lines[LAYOUTS.len() - 1]).chars().take(room).collect()
    }

    /// Seconds to the end of the command, once there is something to judge by.
    fn left_s(&self, share: f64) -> Option<f64> {
        let elapsed_s = self.seconds();
        match self.later {
            Some((later, mean_s)) => Some(f64::from(later) * mean_s + (mean_s - elapsed_s).max(0.0)),
            None => (share > 0.02).then(|| elapsed_s * (1.0 - share) / share),
        }
    }

    fn epoch(
        &mut self,
        record: &EpochRecord,
        amounts: &Amounts,
        [last, epochs]: [u32; 2],
        history: &[EpochRecord],
    ) {
        let mean_s = history.iter().map(|record| record.seconds).sum::<f64>() / history.len().max(1) as f64;
        let left_s = mean_s * f64::from(last - record.epoch);
        // A search that others end does not know how many epochs it has.
        let is_open = epochs == MAX_EPOCHS;
        let all = if is_open { String::new() } else { format!("/{epochs}") };
        let left = match record.epoch < last && !is_open {
            true => format!("  about {} left", duration(left_s)),
            false => String::new(),
        };
        let done = format!(
            "epoch {:>3}{all} {:>9} arrive ({:>7}) {:>8} lost  loss {:>8.3} m {:>5.1} s",
            record.epoch,
            amounts.mass(record.census.target),
            signed(amounts.miss(record.census.target)),
            amounts.mass(record.census.lost()),
            record.loss,
            record.seconds,
        );
        let columns = if self.live { (self.columns)().unwrap_or(COLUMNS) } else { usize::MAX };
        // The time that is left is in the live line too, and the columns stand below each other only where there is room.
        if done.len() + left.len() < columns {
            self.line(&(done + &left));
        } else if done.len() < columns {
            self.line(&done);
        } else {
            self.line(&done.split_whitespace().collect::<Vec<_>>().join(" "));
        }
    }

    fn line(&mut self, text: &str) {
        let clear = if self.live { "\r\x1b[2K" } else { "" };
        let _ = writeln!(self.out, "{clear}{text}");
        let _ = self.out.flush();
    }

    fn clear(&mut self) {
        if self.live {
            let _ = write!(self.out, "\r\x1b[2K");
            let _ = self.out.flush();
        }
    }
}

/// A relative miss in per cent, with its sign.
fn signed(miss: f64) -> String {
    let share = percent(miss.abs());
    match miss {
        _ if share == "0 %" => share,
        miss if miss < 0.0 => format!("-{share}"),
        _ => format!("+{share}"),
    }
}

/// A bar that is filled to this share.
fn bar(share: f64, cells: usize) -> String {
    let filled = (share * cells as f64) as usize;
    if cells == 0 {
        String::new()
    } else {
        format!(" [{}{}]", "#".repeat(filled), ".".repeat(cells - filled))
    }
}

/// Particles that are missing as a row of bars, none below the lowest of them, and the last of them as a number.
fn chart(indicators: &[i64]) -> String {
    let Some(last) = indicators.last() else { return String::new() };
    let ends = (indicators.iter().min(), indicators.iter().max());
    let (low, high) = (ends.0.copied().unwrap_or_default(), ends.1.copied().unwrap_or_default());
    let bar = |value: &i64| {
        let share = value.abs_diff(low) as f64 / high.abs_diff(low).max(1) as f64;
        BARS[(share * (BARS.len() - 1) as f64).round() as usize]
    };
    format!("  missing {} {}", indicators.iter().map(bar).collect::<String>(), grouped(*last))
}

/// Whether the terminal's character set has bars.
fn has_blocks() -> bool {
    // The first that is set decides, as for the C library.
    let set = ["LC_ALL", "LC_CTYPE", "LANG"]
        .iter()
        .find_map(|name| std::env::var(name).ok().filter(|v| !v.is_empty()));
    set.is_some_and(|set| is_unicode(&set))
}

fn is_unicode(locale: &str) -> bool {
    let locale = locale.to_ascii_lowercase();
    locale.contains("utf-8") || locale.contains("utf8")
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_simulator::rollout::Census;

    fn record(epoch: u32) -> EpochRecord {
        EpochRecord {
            epoch,
            loss: 1158.9404,
            indicator: 146,
            census: Census { target: 1854, spilled: 3, ..Census::default() },
            seconds: 2.0,
            ..EpochRecord::default()
        }
    }

    fn amounts() -> Amounts {
        Amounts { wanted_kg: 0.016, wanted_particles: 2000, tolerance: Some(0.02), particle_mass_kg: 8e-6 }
    }

    #[test]
    fn without_a_terminal_there_is_one_line_per_epoch() {
        let out = Arc::new(Mutex::new(Vec::new()));
        let mut progress = Line::new(out.clone().into(), false);
        progress.begin("epoch 0/30", 30, &[]);
        progress.tick(0.5);
        progress.epoch(&record(0), &amounts(), [30; 2], &[record(0)]);
        let text = String::from_utf8(out.lock().unwrap().clone()).unwrap();
        assert_eq!(text.lines().count(), 1, "{text}");
        assert!(
            text.contains("1158.940")
                && text.contains("14.83 g arrive ( -7.3 %)")
                && text.contains("about 1 min left"),
            "{text}"
        );
    }

    #[test]
    fn on_a_terminal_the_line_is_redrawn() {
        let out = Arc::new(Mutex::new(Vec::new()));
        let mut progress = Line::new(out.clone().into(), true);
        progress.begin("epoch 1/30", 29, &[record(0)]);
        progress.clear();
        let text = String::from_utf8(out.lock().unwrap().clone()).unwrap();
        assert!(text.starts_with("\r\x1b[2Kepoch 1/30"), "{text:?}");
        assert!(text.contains(" [....................]   0 %, about 1 min left"), "{text:?}");
    }

    #[test]
    fn the_chart_rises_and_falls_with_the_indicator() {
        let indicators = [100, 50, 0, -100];
        assert_eq!(chart(&indicators), "  missing \u{2588}\u{2586}\u{2585}\u{2581} -100");
        assert_eq!(chart(&indicators[..1]), "  missing \u{2581} 100");
        assert_eq!(chart(&[]), "");
    }

    #[test]
    fn the_line_is_never_as_wide_as_its_terminal() {
        let out = Arc::new(Mutex::new(Vec::new()));
        let mut progress = Line::new(out.clone().into(), true);
        progress.begin("epoch 10/30", 20, &[record(9)]);
        progress.indicators = vec![-1_000; CHART_CELLS];
        progress.later = Some((20, 0.0));
        for columns in 1..=200 {
            let line = progress.fitting(columns - 1, 1.0);
            assert!(line.chars().count() < columns, "{columns}: {line}");
        }
        let at = |columns: usize| progress.fitting(columns - 1, 0.5);
        let chart = |cells: usize| format!("  missing {} -1,000", "\u{2581}".repeat(cells));
        assert_eq!(at(100), format!("epoch 10/30{} [##########..........]  50 %, about 0 s left", chart(20)));
        assert_eq!(at(80), format!("epoch 10/30{} [#####.....]  50 %, about 0 s left", chart(12)));
        assert_eq!(at(60), "epoch 10/30 [##########..........]  50 %, about 0 s left");
        assert_eq!(at(50), "epoch 10/30 [#####.....]  50 %, about 0 s left");
        assert_eq!(at(40), "epoch 10/30  50 %, about 0 s left");
        assert_eq!(at(20), "epoch 10/30  50 %, ");
    }

    #[test]
    fn an_epoch_takes_one_row_of_eighty_columns() {
        let out = Arc::new(Mutex::new(Vec::new()));
        let mut progress = Line::new(out.clone().into(), true);
        let widths: [fn() -> Option<usize>; 4] = [|| Some(120), || Some(95), || Some(80), || Some(78)];
        for columns in widths {
            progress.columns = columns;
            progress.epoch(&record(3), &amounts(), [30; 2], &[record(3)]);
        }
        let text = String::from_utf8(out.lock().unwrap().clone()).unwrap();
        let rows: Vec<&str> = text.split("\r\x1b[2K").skip(1).collect();
        assert!(rows[0].ends_with("   24 mg lost  loss 1158.940 m   2.0 s  about 54 s left\n"), "{text}");
        assert!(rows[1].ends_with("   24 mg lost  loss 1158.940 m   2.0 s\n"), "{text}");
        assert_eq!(
            rows[2],
            "epoch   3/30   14.83 g arrive ( -7.3 %)    24 mg lost  loss 1158.940 m   2.0 s\n"
        );
        assert_eq!(rows[3], "epoch 3/30 14.83 g arrive ( -7.3 %) 24 mg lost loss 1158.940 m 2.0 s\n");
    }

    #[test]
    fn nothing_is_drawn_while_the_window_changes() {
        let out = Arc::new(Mutex::new(Vec::new()));
        let mut progress = Line::new(out.clone().into(), true);
        progress.columns = || Some(100);
        assert_eq!((progress.room(), progress.room()), (Some(79), Some(79)));
        // Wider than what is ever used, it may be drawn as it likes.
        progress.columns = || Some(90);
        assert_eq!(progress.room(), Some(79));
        progress.columns = || Some(60);
        assert_eq!((progress.room(), progress.room()), (None, None));
        progress.window =
            progress.window.map(|(columns, since)| (columns, since.map(|since| since - SETTLED)));
        assert_eq!(progress.room(), Some(59));
    }

    #[test]
    fn bars_are_for_terminals_that_have_them() {
        assert!(["en_GB.UTF-8", "C.utf8"].into_iter().all(is_unicode));
        assert!(!["C", "POSIX", "de_DE.ISO-8859-1"].into_iter().any(is_unicode));
    }
}
