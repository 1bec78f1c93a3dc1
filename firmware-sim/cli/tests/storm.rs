//! Executor and arm on the simulated wire.

use powderline_executor::Outcome;
use powderline_firmware_sim_cli::link::faults::{Event, Faults};
use powderline_firmware_sim_cli::link::world::Logged;
use powderline_firmware_sim_cli::storm::{run_loss, run_seed, run_seeds};
use powderline_shared::wire::frame::Dialect;

/// More of them: `firmware-sim storm --seeds 0..100000`.
const SEEDS: u64 = 3_000;

#[test]
fn whatever_goes_wrong_nothing_happens_that_may_never_happen() {
    let summary = run_seeds(0..SEEDS, |_| {});
    assert_eq!(summary.breach_count, 0, "{summary}");
    // A storm in which nothing is wrong, or in which nothing gets through, shows nothing.
    assert_eq!((summary.runs, summary.events.len()), (SEEDS, Event::ALL.len()));
    assert!(summary.frames.values().all(|count| *count > 100), "{summary}");
    assert!(summary.completed > SEEDS / 10 && summary.arm_faults.len() >= 5, "{summary}");
    assert!(summary.worst_silence_us.0 > 100_000, "{summary}");
}

#[test]
fn the_same_seed_is_the_same_run() {
    for seed in 0..50 {
        let words =
            |log: Vec<(u64, Logged)>| -> Vec<_> { log.iter().map(|line| format!("{line:?}")).collect() };
        let ((one, log), (other, again)) = (run_seed(seed, true), run_seed(seed, true));
        assert_eq!(words(log), words(again));
        let (silent, _) = run_seed(seed, false);
        assert_eq!(format!("{one:?}"), format!("{other:?}"));
        assert_eq!(format!("{one:?}"), format!("{silent:?}"));
    }
}

#[test]
fn a_wire_in_order_completes_every_plan_and_a_little_loss_hardly_any_less() {
    for dialect in [Dialect::Classic, Dialect::Fd] {
        let faults = Faults::none(dialect, 10_000);
        for delay_us in [0, 5_000, 50_000] {
            let summary = run_loss(0..30, &faults, 0.0, delay_us);
            assert_eq!(
                (summary.completed, summary.breach_count),
                (30, 0),
                "{dialect:?} {delay_us} us: {summary}"
            );
        }
        let summary = run_loss(0..100, &faults, 0.01, 1_000);
        assert!(summary.completed >= 95 && summary.breach_count == 0, "{dialect:?}: {summary}");
    }
}

#[test]
fn a_run_without_faults_ends_where_the_plan_does() {
    let faults = Faults::none(Dialect::Fd, 10_000);
    let (run, _) = powderline_firmware_sim_cli::storm::play(
        powderline_firmware_sim_cli::link::dice::Dice::new(1),
        &faults,
        false,
    );
    assert_eq!(run.outcomes, [Some(Outcome::Completed)]);
    assert_eq!(run.arm_fault, None);
    assert!(run.end_error_lsb.is_some_and(|error| error < 1e-6), "{:?}", run.end_error_lsb);
}
