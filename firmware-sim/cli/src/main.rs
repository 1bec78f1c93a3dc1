//! The simulated arm controller, as a program.

use std::io::{self, IsTerminal, Write};
use std::ops::Range;
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::{Context, bail};
use clap::{Parser, Subcommand};
use powderline_firmware_sim_cli::link::faults::Faults;
use powderline_firmware_sim_cli::link::world::Logged;
use powderline_firmware_sim_cli::storm;
use powderline_shared::wire::frame::Dialect;

/// The simulated arm controller.
#[derive(Debug, Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Plays plans between executor and arm over a simulated wire, with faults drawn from seeds, and holds both to what
    /// may never happen
    Storm {
        /// Seeds to run, the last one not included
        #[arg(long, default_value = "0..1000", value_parser = parse_range)]
        seeds: Range<u64>,
        /// Run this seed only, with its log
        #[arg(long, conflicts_with = "seeds")]
        seed: Option<u64>,
        /// Instead, a table of what comes of plain loss and delay
        #[arg(long, conflicts_with = "seed")]
        table: bool,
    },
}

fn parse_range(text: &str) -> Result<Range<u64>, String> {
    let wrong = || format!("\"{text}\" is not a range of seeds; write 0..1000");
    let (from, to) = text.split_once("..").ok_or_else(wrong)?;
    let (from, to): (u64, u64) = (from.parse().map_err(|_| wrong())?, to.parse().map_err(|_| wrong())?);
    if from < to { Ok(from..to) } else { Err(wrong()) }
}

fn main() -> ExitCode {
    let Arguments { command: Command::Storm { seeds, seed, table } } = Arguments::parse();
    let done = match seed {
        Some(seed) => replay(seed),
        None if table => loss_table(seeds),
        None => storm(seeds),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("firmware-sim: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn storm(seeds: Range<u64>) -> anyhow::Result<()> {
    let total = seeds.end - seeds.start;
    let (done, shows) = (AtomicU64::new(0), io::stderr().is_terminal());
    let summary = storm::run_seeds(seeds, |more| {
        let so_far = done.fetch_add(more, Ordering::Relaxed) + more;
        if shows && so_far.is_multiple_of(256) {
            eprint!("\r  {so_far} of {total} runs");
        }
    });
    if shows {
        eprint!("\r\x1b[K");
    }
    say(&summary.to_string())?;
    if summary.breach_count > 0 {
        bail!("{} breaches; replay one with --seed", summary.breach_count);
    }
    Ok(())
}

fn replay(seed: u64) -> anyhow::Result<()> {
    let (run, log) = storm::run_seed(seed, true);
    for (at_us, logged) in log {
        let (seconds, micros) = (at_us / 1_000_000, at_us % 1_000_000);
        match logged {
            Logged::Frame(frame) => {
                let data: String = frame.data.iter().map(|byte| format!("{byte:02X}")).collect();
                let mark = if frame.data.len() > 8 { "##0" } else { "#" };
                say(&format!("({seconds:010}.{micros:06}) sim0 {:03X}{mark}{data}\n", frame.id))?;
            }
            Logged::Remark(text) => say(&format!("# {seconds}.{micros:06} {text}\n"))?,
        }
    }
    if !run.breaches.is_empty() {
        bail!("{} breaches, the first: {}", run.breaches.len(), run.breaches[0].what);
    }
    Ok(())
}

/// Loss by delay: how many plans complete, and how far the arm is from where it was due, at the worst.
fn loss_table(seeds: Range<u64>) -> anyhow::Result<()> {
    const LOSSES: [f64; 5] = [0.0, 0.001, 0.01, 0.05, 0.2];
    const DELAYS_US: [u64; 5] = [0, 1_000, 5_000, 20_000, 50_000];
    let mut breaches = 0;
    for dialect in [Dialect::Classic, Dialect::Fd] {
        say(&format!(
            "\n{dialect:?}, 100 Hz, {} plans each: completed (largest deviation on the way, mm)\n",
            seeds.end - seeds.start
        ))?;
        say("   loss")?;
        DELAYS_US.iter().try_for_each(|delay_us| say(&format!("  {:>10} ms", *delay_us as f64 / 1e3)))?;
        say("\n")?;
        for loss in LOSSES {
            say(&format!("{:>5.1} %", 100.0 * loss))?;
            for delay_us in DELAYS_US {
                let summary = storm::run_loss(seeds.clone(), &Faults::none(dialect, 10_000), loss, delay_us);
                let share = 100.0 * summary.completed as f64 / summary.runs as f64;
                breaches += summary.breach_count;
                say(&format!("  {share:>5.1} % ({:.2})", 1e3 * summary.worst_tracking_m))?;
            }
            say("\n")?;
        }
    }
    say("\nEvery plan that is not completed is stopped with its reason, which is latched.\n")?;
    if breaches > 0 {
        bail!("{breaches} breaches of what may never happen");
    }
    Ok(())
}

/// Writes to standard output. A reader that went away (`| head`) is no error of ours.
fn say(text: &str) -> anyhow::Result<()> {
    match io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(error).context("standard output cannot be written")
        }
        _ => Ok(()),
    }
}
