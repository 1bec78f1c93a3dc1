//! Live progress on standard error: a line that is redrawn on a terminal, one line per epoch elsewhere.

use crate::optim::EpochRecord;
use crate::report::{
    amounts::{Amounts, percent},
    words::{duration, grouped},
};
use std::{
    io::Write,
    time::{Duration, Instant},
};

/// Time between two redraws.
const REDRAW: Duration = Duration::from_millis(100);

const BAR_CELLS: usize = 20;

/// Epochs in the small chart, and its bars.
const CHART_CELLS: usize = 20;
const BARS: [char; 8] =
    ['\u{2581}', '\u{2582}', '\u{2583}', '\u{2584}', '\u{2585}', '\u{2586}', '\u{2587}', '\u{2588}'];

/// Shows how far a command is.
pub struct Progress<'a> {
    out: &'a mut (dyn Write + Send),
    /// Whether `out` is a terminal, on which a line can be drawn over.
    live: bool,
    /// What is being done, such as `epoch 3/30`.
    task: String,
    started: Instant,
    drawn: Option<Instant>,
    /// Evaluations to come after the present one, and what one has taken on average, seconds.
    later: Option<(u32, f64)>,
    /// The indicator of the epochs before, drawn small, where the terminal can show it.
    chart: String,
    /// Shares of the task at the beginning and at the end of its present part.
    span: [f64; 2],
}

impl<'a> Progress<'a> {
    /// Progress shown on `out`.
    pub fn new(out: &'a mut (dyn Write + Send), live: bool) -> Self {
        Self {
            out,
            live,
            task: String::new(),
            started: Instant::now(),
            drawn: None,
            later: None,
            chart: String::new(),
            span: [0.0, 1.0],
        }
    }

    /// Begins a task; `later` evaluations follow it, each of the duration of those in `history`.
    pub fn begin(&mut self, task: &str, later: u32, history: &[EpochRecord]) {
        let mean_s = history.iter().map(|record| record.seconds).sum::<f64>() / history.len().max(1) as f64;
        self.task = task.into();
        self.started = Instant::now();
        self.drawn = None;
        self.later = (!history.is_empty()).then_some((later, mean_s));
        self.chart = if self.live && has_blocks() { chart(history) } else { String::new() };
        self.span = [0.0, 1.0];
        self.tick(0, 1);
    }

    /// Begins a part of the task: what is done and in total is the part's from now on, and takes the whole task from
    /// the first to the second of these shares.
    pub fn span(&mut self, shares: [f64; 2]) {
        self.span = shares;
    }

    /// Seconds since the task began.
    pub fn seconds(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    /// Called now and then with work units done and in total, of the task or its present part.
    pub fn tick(&mut self, done: u64, total: u64) {
        if !self.live || self.drawn.is_some_and(|drawn| drawn.elapsed() < REDRAW) {
            return;
        }
        self.drawn = Some(Instant::now());
        let [start, end] = self.span;
        let part = (done as f64 / total.max(1) as f64).clamp(0.0, 1.0);
        let share = start + (end - start) * part;
        let filled = (share * BAR_CELLS as f64) as usize;
        let left =
            self.left_s(share).map(|left| format!(", about {} left", duration(left))).unwrap_or_default();
        // A terminal that cannot be written to is no reason to stop a run.
        let _ = write!(
            self.out,
            "\r\x1b[2K{}{} [{}{}] {:3.0} %{left}",
            self.task,
            self.chart,
            "#".repeat(filled),
            ".".repeat(BAR_CELLS - filled),
            100.0 * share
        );
        let _ = self.out.flush();
    }

    /// Seconds to the end of the command, once there is something to judge by.
    fn left_s(&self, share: f64) -> Option<f64> {
        let elapsed_s = self.seconds();
        match self.later {
            Some((later, mean_s)) => Some(f64::from(later) * mean_s + (mean_s - elapsed_s).max(0.0)),
            None => (share > 0.02).then(|| elapsed_s * (1.0 - share) / share),
        }
    }

    /// Reports an epoch that is done.
    pub fn epoch(&mut self, record: &EpochRecord, amounts: &Amounts, epochs: u32, history: &[EpochRecord]) {
        let mean_s = history.iter().map(|record| record.seconds).sum::<f64>() / history.len().max(1) as f64;
        let left_s = mean_s * f64::from(epochs - record.epoch);
        let left = match record.epoch < epochs {
            true => format!("  about {} left", duration(left_s)),
            false => String::new(),
        };
        self.line(&format!(
            "epoch {:>3}/{epochs}  {:>9} arrive ({:>7})  {:>9} spill  loss {:>9.3} m {:>6.1} s{left}",
            record.epoch,
            amounts.mass(record.transported),
            signed(amounts.miss(record.transported)),
            amounts.mass(record.spilled),
            record.loss,
            record.seconds,
        ));
    }

    /// Writes a whole line, over the live one if there is one.
    pub fn line(&mut self, text: &str) {
        let clear = if self.live { "\r\x1b[2K" } else { "" };
        let _ = writeln!(self.out, "{clear}{text}");
        let _ = self.out.flush();
    }

    /// Takes the live line away.
    pub fn clear(&mut self) {
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

/// The indicator of the latest epochs as a row of bars, none below the lowest of them, and its latest value.
fn chart(history: &[EpochRecord]) -> String {
    let latest = &history[history.len().saturating_sub(CHART_CELLS)..];
    let Some(last) = latest.last() else { return String::new() };
    let values = || latest.iter().map(|record| record.indicator);
    let (low, high) = (values().min().unwrap_or_default(), values().max().unwrap_or_default());
    let bar = |value: i64| {
        let share = value.abs_diff(low) as f64 / high.abs_diff(low).max(1) as f64;
        BARS[(share * (BARS.len() - 1) as f64).round() as usize]
    };
    format!("  indicator {} {}", values().map(bar).collect::<String>(), grouped(last.indicator))
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

    fn record(epoch: u32) -> EpochRecord {
        EpochRecord {
            epoch,
            loss: 1158.9404,
            indicator: 146,
            transported: 1854,
            spilled: 3,
            theta: [0.0; 5],
            seconds: 2.0,
            ..EpochRecord::default()
        }
    }

    fn amounts() -> Amounts {
        Amounts { wanted_kg: 0.016, wanted_particles: 2000, tolerance: Some(0.02), particle_mass_kg: 8e-6 }
    }

    #[test]
    fn without_a_terminal_there_is_one_line_per_epoch() {
        let mut out = Vec::new();
        let mut progress = Progress::new(&mut out, false);
        progress.begin("epoch 0/30", 30, &[]);
        progress.tick(1, 2);
        progress.epoch(&record(0), &amounts(), 30, &[record(0)]);
        let text = String::from_utf8(out).unwrap();
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
        let mut out = Vec::new();
        let mut progress = Progress::new(&mut out, true);
        progress.begin("epoch 1/30", 29, &[record(0)]);
        progress.clear();
        let text = String::from_utf8(out).unwrap();
        assert!(text.starts_with("\r\x1b[2Kepoch 1/30"), "{text:?}");
        assert!(text.contains(" [....................]   0 %, about 1 min left"), "{text:?}");
    }

    #[test]
    fn parts_share_one_bar() {
        let mut out = Vec::new();
        let mut progress = Progress::new(&mut out, true);
        progress.begin("epoch 1/30", 29, &[record(0)]);
        progress.span([0.5, 0.7]);
        progress.drawn = None;
        progress.tick(1, 2);
        let text = String::from_utf8(out).unwrap();
        assert!(text.contains("[############........]  60 %"), "{text:?}");
    }

    #[test]
    fn the_chart_rises_and_falls_with_the_indicator() {
        let history: Vec<_> =
            [100, 50, 0, -100].map(|indicator| EpochRecord { indicator, ..EpochRecord::default() }).into();
        assert_eq!(chart(&history), "  indicator \u{2588}\u{2586}\u{2585}\u{2581} -100");
        assert_eq!(chart(&history[..1]), "  indicator \u{2581} 100");
        assert_eq!(chart(&[]), "");
        let many: Vec<_> = history.iter().cycle().take(70).copied().collect();
        assert_eq!(chart(&many).chars().filter(|c| BARS.contains(c)).count(), CHART_CELLS);
    }

    #[test]
    fn bars_are_for_terminals_that_have_them() {
        assert!(["en_GB.UTF-8", "C.utf8"].into_iter().all(is_unicode));
        assert!(!["C", "POSIX", "de_DE.ISO-8859-1"].into_iter().any(is_unicode));
    }
}
