//! Runs that are stopped, and go on later with the same bits.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, ChildStderr, Command};
use std::thread::sleep;
use std::time::{Duration, Instant};

use powderline_shared::plan::PlanReader;

use crate::programs::{OPTIMISE, Place, assert_same_bits, bytes, command, metrics, run, wait};

const EPOCHS: u32 = 3;

/// Starts a run of the tiny scene that does not look at smaller cells; the process, and the rest of its standard error from the line on
/// that starts with `line`.
fn started_until(line: &str, scene: &str, folder: &str) -> (Child, BufReader<ChildStderr>) {
    let arguments = [scene, "--no-refine", "--epochs", &EPOCHS.to_string(), "--out", folder];
    until(line, &arguments)
}

/// Starts `optimise`, see [`started_until`].
fn until(line: &str, arguments: &[&str]) -> (Child, BufReader<ChildStderr>) {
    let mut child = command(OPTIMISE, arguments).spawn().unwrap();
    let mut err = BufReader::new(child.stderr.take().unwrap());
    let mut text = String::new();
    while !text.lines().last().unwrap_or_default().starts_with(line) {
        assert_ne!(err.read_line(&mut text).unwrap(), 0, "no `{line}` in: {text}");
    }
    (child, err)
}

/// A whole run, and a third of what one of its epochs takes here: a signal after that comes in the middle of one.
fn whole_run(place: &Place) -> (String, Duration) {
    let begin = Instant::now();
    let folder = place.tiny_run("whole", EPOCHS);
    (folder, begin.elapsed() / (3 * (EPOCHS + 1)))
}

/// `kill` as a shell has it built in; a program of that name is not everywhere.
#[cfg(unix)]
fn send(signal: &str, child: &Child) {
    let arguments = ["-c", "kill -\"$1\" \"$0\"", &child.id().to_string(), signal];
    assert!(Command::new("sh").args(arguments).status().unwrap().success());
}

#[cfg(unix)]
#[test]
fn a_run_stopped_in_the_middle_of_an_epoch_goes_on_to_the_same_bits() {
    let place = Place::new();
    let (whole, part_of_an_epoch) = whole_run(&place);
    for (signal, line, saved) in
        [("INT", "tiny: surrogate", 0), ("INT", "epoch   1/3", 2), ("TERM", "epoch   0/3", 1)]
    {
        let folder = place.path(&format!("stopped-{signal}-{saved}"));
        let (mut child, mut err) = started_until(line, &place.tiny(), &folder);
        sleep(part_of_an_epoch);
        send(signal, &child);
        let mut said = String::new();
        err.read_to_string(&mut said).unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(130), "{said}");
        let last = said.lines().last().unwrap();
        assert!(
            last.contains("stopped on request") && last.ends_with(&format!("--resume {folder}")),
            "{said}"
        );
        // No epoch came to its end after the signal, but for one that did at the same moment.
        let evaluated = Path::new(&folder).join("metrics.jsonl").exists().then(|| metrics(&folder).len());
        assert!((saved..=saved + 1).contains(&evaluated.unwrap_or(0)), "{said}");
        assert!(!Path::new(&folder).join("skill.plan").exists());
        run(OPTIMISE, &["--resume", &folder]).finished();
        assert_same_bits(&folder, &whole);
    }
}

#[test]
fn a_run_that_was_killed_goes_on_to_the_same_bits() {
    let place = Place::new();
    let (whole, part_of_an_epoch) = whole_run(&place);
    let folder = place.path("killed");
    let (mut child, _err) = started_until("epoch   0/3", &place.tiny(), &folder);
    sleep(part_of_an_epoch);
    child.kill().unwrap();
    child.wait().unwrap();
    run(OPTIMISE, &["--resume", &folder]).finished();
    assert_same_bits(&folder, &whole);
}

/// The plan that the search left is there, and says that nobody has seen it on smaller cells.
#[cfg(unix)]
#[test]
fn a_run_stopped_while_its_plan_is_corrected_has_a_plan_and_goes_on_to_the_same_bits() {
    let place = Place::new();
    let finer = |folder: &str| PlanReader::new(&bytes(folder, "skill.plan")).unwrap().header().finer;
    let (scene, whole) = (place.tiny(), place.path("whole"));
    run(OPTIMISE, &[&scene, "--epochs", "0", "--out", &whole]).finished();
    assert!(finer(&whole).is_some_and(|finer| (finer.cell_m - 0.004).abs() < 1e-12));
    for signal in ["INT", "KILL"] {
        let folder = place.path(signal);
        let (mut child, mut err) = until("  cells of 4 mm", &[&scene, "--epochs", "0", "--out", &folder]);
        send(signal, &child);
        let mut said = String::new();
        err.read_to_string(&mut said).unwrap();
        assert!(!child.wait().unwrap().success(), "{said}");
        assert_eq!(finer(&folder), None, "{said}");
        run(OPTIMISE, &["--resume", &folder]).finished();
        assert_same_bits(&folder, &whole);
    }
}

#[test]
fn a_second_run_into_one_folder_is_refused_and_the_first_not_disturbed() {
    let place = Place::new();
    let (scene, folder) = (place.tiny(), place.path("run"));
    let (mut first, mut err) = started_until("tiny: surrogate", &scene, &folder);
    let second = run(OPTIMISE, &[&scene, "--epochs", "1", "--out", &folder]);
    let resumed = run(OPTIMISE, &["--resume", &folder]);
    assert!(first.try_wait().unwrap().is_none(), "the first run is too short for this test");
    for other in [second, resumed] {
        other.refused(1, "another run is writing into");
    }
    let mut said = String::new();
    err.read_to_string(&mut said).unwrap();
    wait(first).finished();
    assert_eq!(metrics(&folder).len(), 4);
    let plan = bytes(&folder, "skill.plan");
    run(OPTIMISE, &[&scene, "--out", &folder]).refused(2, "which is not overwritten");
    assert_eq!(bytes(&folder, "skill.plan"), plan);
}
