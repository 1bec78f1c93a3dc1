//! The storm as a test: few seeds, the same each time. The program `firmware-sim` runs as many as one has time for.

use powderline_firmware_sim_cli::link::faults::Event;
use powderline_firmware_sim_cli::storm;

#[test]
fn whatever_goes_wrong_what_may_never_happen_does_not() {
    let runs: u64 = if cfg!(debug_assertions) { 200 } else { 2_000 };
    let summary = storm::run_seeds(0..runs, |_| {});
    assert_eq!((summary.runs, summary.breach_count), (runs, 0), "{summary}");
    // And it is a storm, in which there is yet something to be broken.
    assert!(summary.completed > runs / 4 && summary.completed < runs * 3 / 4, "{summary}");
    assert_eq!(summary.events.len(), Event::ALL.len(), "{summary}");
    let least = |name: &str| summary.frames.get(name).copied().unwrap_or(0);
    assert!(
        ["lost", "delivered twice", "damaged", "of a babbling node"].map(least).iter().all(|n| *n > runs),
        "{summary}"
    );
    assert!(summary.arm_faults.len() >= 5, "{summary}");
}
