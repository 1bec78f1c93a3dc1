//! Many runs, each with its own faults, and what came of them.

use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;

use powderline_executor::Outcome;
use powderline_host::words::counted;
use powderline_shared::plan::PlanReader;
use rayon::prelude::*;

use crate::link::bus::Line;
use crate::link::dice::Dice;
use crate::link::faults::{Event, Faults};
use crate::link::motion;
use crate::link::world::{self, Logged, RunOutcome};

/// Breaches that are kept with their words; the others are counted.
const KEPT_BREACHES: usize = 20;

/// What came of all runs.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    /// Runs.
    pub runs: u64,
    /// Simulated time, microseconds.
    pub simulated_us: u64,
    /// How often each event took place.
    pub events: BTreeMap<&'static str, u64>,
    /// What happened to frames.
    pub frames: BTreeMap<&'static str, u64>,
    /// How the executor's last session ended.
    pub endings: BTreeMap<String, u64>,
    /// What the arm latched first.
    pub arm_faults: BTreeMap<String, u64>,
    /// Longest time from the last that was heard of an executor to standstill, microseconds, and its seed.
    pub worst_silence_us: (u64, u64),
    /// Largest distance of a completed plan's final pose from the plan's end, LSB of the wire.
    pub worst_end_error_lsb: f64,
    /// Largest distance of the arm from where it was due while it followed setpoints, metres.
    pub worst_tracking_m: f64,
    /// Runs that completed.
    pub completed: u64,
    /// Breaches of what may never happen.
    pub breach_count: u64,
    /// The first of them: seed, and what happened.
    pub breaches: Vec<(u64, String)>,
}

/// The plans and faults of a seed, played.
#[must_use]
pub fn run_seed(seed: u64, logged: bool) -> (RunOutcome, Vec<(u64, Logged)>) {
    let mut dice = Dice::new(seed);
    let faults = Faults::random(&mut dice);
    play(dice, &faults, logged)
}

/// A plan drawn by chance, played while `faults` happen.
#[must_use]
pub fn play(mut dice: Dice, faults: &Faults, logged: bool) -> (RunOutcome, Vec<(u64, Logged)>) {
    let mut bytes = || {
        let moves = motion::random_moves(&mut dice, faults.period_us);
        motion::plan_bytes(&motion::start(), motion::limits(), faults.period_us, &moves)
    };
    let (right, wrong) = (bytes(), bytes());
    match (PlanReader::new(&right), PlanReader::new(&wrong)) {
        (Ok(right), Ok(wrong)) => world::run(dice, faults, [&right, &wrong], logged),
        (Err(error), _) | (_, Err(error)) => unreachable!("a plan of our own is no plan: {error}"),
    }
}

/// All seeds of a range, on all processors. `done` is called with the number of runs that have just ended.
pub fn run_seeds(seeds: Range<u64>, done: impl Fn(u64) + Sync) -> Summary {
    run_all(seeds, |seed| run_seed(seed, false).0, done)
}

/// All seeds of a range with frames lost at this rate and delayed by this time in both directions, and nothing else.
pub fn run_loss(seeds: Range<u64>, faults: &Faults, loss: f64, delay_us: u64) -> Summary {
    let line = Line { drop: loss, delay_us: (delay_us, delay_us), ..Line::default() };
    let faults = Faults { to_arm: line, from_arm: line, ..faults.clone() };
    run_all(seeds, |seed| play(Dice::new(seed), &faults, false).0, |_| {})
}

fn run_all(seeds: Range<u64>, run: impl Fn(u64) -> RunOutcome + Sync, done: impl Fn(u64) + Sync) -> Summary {
    // The order of addition does not matter: counts, extremes, and breaches that are sorted at the end.
    let add = |mut summary: Summary, seed: u64| {
        summary.add(seed, &run(seed));
        done(1);
        summary
    };
    let mut summary =
        seeds.into_par_iter().fold(Summary::default, add).reduce(Summary::default, Summary::joined);
    summary.breaches.sort();
    summary.breaches.truncate(KEPT_BREACHES);
    summary
}

impl Summary {
    fn add(&mut self, seed: u64, run: &RunOutcome) {
        self.runs += 1;
        self.simulated_us += run.duration_us;
        let mut count = |event: Event| *self.events.entry(event.name()).or_default() += 1;
        run.events.iter().for_each(|event| count(*event));
        for (name, value) in [
            ("sent", run.bus.frames),
            ("lost", run.bus.dropped),
            ("delivered twice", run.bus.duplicated),
            ("damaged", run.bus.corrupted),
            ("halves of a pair lost", run.bus.split),
            ("of a babbling node", run.babbled),
            ("not taken (ENOBUFS)", run.not_taken),
        ] {
            *self.frames.entry(name).or_default() += value;
        }
        let last = run.outcomes.last().copied().flatten();
        *self.endings.entry(ending(last)).or_default() += 1;
        self.completed += u64::from(last == Some(Outcome::Completed));
        if let Some(fault) = run.arm_fault {
            *self.arm_faults.entry(format!("{} {}", fault.code.number(), fault.code)).or_default() += 1;
        }
        self.worst_silence_us = self.worst_silence_us.max((run.worst_silence_us, seed));
        self.worst_end_error_lsb = self.worst_end_error_lsb.max(run.end_error_lsb.unwrap_or(0.0));
        self.worst_tracking_m = self.worst_tracking_m.max(run.telemetry.tracking_m);
        self.breach_count += run.breaches.len() as u64;
        self.breaches.extend(run.breaches.iter().take(1).map(|breach| (seed, breach.what.clone())));
    }

    fn joined(mut self, other: Self) -> Self {
        let add = |to: &mut BTreeMap<_, u64>, from| {
            for (key, value) in from {
                *to.entry(key).or_default() += value;
            }
        };
        add(&mut self.events, other.events);
        add(&mut self.frames, other.frames);
        for (key, value) in other.endings {
            *self.endings.entry(key).or_default() += value;
        }
        for (key, value) in other.arm_faults {
            *self.arm_faults.entry(key).or_default() += value;
        }
        self.breaches.extend(other.breaches);
        Self {
            runs: self.runs + other.runs,
            simulated_us: self.simulated_us + other.simulated_us,
            worst_silence_us: self.worst_silence_us.max(other.worst_silence_us),
            worst_end_error_lsb: self.worst_end_error_lsb.max(other.worst_end_error_lsb),
            worst_tracking_m: self.worst_tracking_m.max(other.worst_tracking_m),
            completed: self.completed + other.completed,
            breach_count: self.breach_count + other.breach_count,
            ..self
        }
    }
}

fn ending(outcome: Option<Outcome>) -> String {
    match outcome {
        None => String::from("never ended"),
        Some(Outcome::Completed) => String::from("completed"),
        Some(Outcome::Stopped { fault, standstill }) => {
            let doubt = if standstill { "" } else { " (standstill not confirmed)" };
            format!("{} {}{doubt}", fault.code.number(), fault.code)
        }
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let simulated_s = self.simulated_us as f64 / 1e6;
        let simulated = match simulated_s {
            3600.0.. => format!("{:.2} hours", simulated_s / 3600.0),
            _ => format!("{simulated_s:.0} seconds"),
        };
        writeln!(f, "{}, {simulated} of simulated time", counted(self.runs, "run", "runs"))?;
        table(f, "Frames", &self.frames)?;
        table(f, "Events", &self.events)?;
        table(f, "How the executor's last session ended", &self.endings)?;
        table(f, "What the arm latched first", &self.arm_faults)?;
        let (silence_us, seed) = self.worst_silence_us;
        writeln!(
            f,
            "\nFrom the executor's last sign of life to standstill: at most {:.1} ms (seed {seed})",
            silence_us as f64 / 1e3
        )?;
        writeln!(
            f,
            "Completed plans end at most {:.3} LSB of the wire off the plan's end",
            self.worst_end_error_lsb
        )?;
        writeln!(f, "Breaches of what may never happen: {}", self.breach_count)?;
        self.breaches.iter().try_for_each(|(seed, what)| writeln!(f, "  seed {seed}: {what}"))
    }
}

fn table<K: fmt::Display>(f: &mut fmt::Formatter<'_>, title: &str, rows: &BTreeMap<K, u64>) -> fmt::Result {
    writeln!(f, "\n{title}")?;
    rows.iter().try_for_each(|(name, count)| writeln!(f, "{count:>14}  {name}"))
}
