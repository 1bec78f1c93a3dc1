//! Memory, and what to do without disk.

#![cfg(target_os = "linux")]

use std::fs;
use std::path::Path;
use std::process::Command;
use std::thread::sleep;
use std::time::Duration;

use crate::programs::{Done, EXECUTE, OPTIMISE, Place, assert_same_bits, command, metrics, run, wait};

/// Kibibytes of the process's largest resident set so far; none once it has ended.
fn peak_kib(process: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix(" kB")?.parse().ok()
}

/// Over several epochs: what grows from one to the next shows only then.
#[test]
fn a_memory_budget_holds_as_the_operating_system_counts_and_changes_no_bit() {
    let place = Place::new();
    let run_with = |memory: &str, threads: &str, folder: &str| {
        let resources = ["--memory", memory, "--threads", threads, "--out", folder];
        let arguments =
            [&["run", "bench-small", "--method", "mixed", "--epochs", "4", "--no-refine"][..], &resources]
                .concat();
        let mut child = command(OPTIMISE, &arguments).spawn().unwrap();
        let mut peak = 0;
        // The peak only grows, so the last reading before the end is the peak but for the last moment.
        while child.try_wait().unwrap().is_none() {
            peak = peak_kib(child.id()).unwrap_or(peak);
            sleep(Duration::from_millis(5));
        }
        wait(child).finished();
        peak
    };
    let free = place.path("free");
    let most = run_with("none", "2", &free);
    for (mebibytes, threads) in [(64, "2"), (128, "2"), (128, "16")] {
        let folder = place.path(&format!("{mebibytes}-{threads}"));
        let (peak, budget) = (run_with(&format!("{mebibytes}MiB"), threads, &folder), mebibytes << 10);
        println!("{peak} KiB of {budget} KiB, {threads} threads; {most} KiB without a budget");
        assert!(most > 4 * budget, "the budget of {budget} KiB is no restriction: {most} KiB without it");
        // What is allowed is used: memory saves time.
        assert!((budget / 4 * 3..=budget).contains(&peak), "{peak} KiB, but {budget} KiB were allowed");
        assert_same_bits(&free, &folder);
    }
}

#[test]
fn a_memory_budget_that_cannot_do_is_refused_before_anything_is_written() {
    let place = Place::new();
    let folder = place.path("run");
    let asked = ["run", "bench-small", "--method", "mixed", "--memory", "16MiB", "--threads", "2"];
    let arguments = [&asked[..], &["--out", &folder]].concat();
    run(OPTIMISE, &arguments).ended(
        2,
        "a memory budget of 16 MiB is too little: this scene needs 52 MiB for a gradient, with 2 threads",
    );
    assert!(!Path::new(&folder).exists());
}

/// Runs `optimise` where no file can grow beyond `blocks` of 512 bytes.
fn on_a_full_disk(blocks: u32, arguments: &[&str]) -> Done {
    let script = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" \"$@\"");
    let arguments = [&["-c", &script, OPTIMISE], arguments].concat();
    run("/bin/sh", &arguments)
}

#[test]
fn a_disk_that_fills_up_during_a_run_costs_nothing_that_was_saved() {
    let place = Place::new();
    let whole = place.tiny_run("whole", 2);
    let folder = place.path("run");
    // Room for the scene and the state, not for the curves of the first epoch.
    let done = on_a_full_disk(10, &[&place.tiny(), "--no-refine", "--epochs", "2", "--out", &folder]);
    done.ended(1, "curves.svg cannot be written");
    assert!(done.err.contains("the epochs before are saved, go on with"), "{}", done.err);
    assert_eq!(metrics(&folder), metrics(&whole)[..1]);
    run(OPTIMISE, &["--resume", &folder]).finished();
    assert_same_bits(&folder, &whole);
    let leftovers = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name());
    let leftovers: Vec<_> = leftovers.filter(|name| name.to_string_lossy().ends_with(".new")).collect();
    assert!(leftovers.is_empty(), "{leftovers:?}");
}

#[test]
fn a_disk_that_is_full_from_the_start_leaves_the_way_free() {
    let place = Place::new();
    let folder = place.path("run");
    on_a_full_disk(1, &[&place.tiny(), "--out", &folder]).refused(1, "scene.toml cannot be written");
    run(OPTIMISE, &[&place.tiny(), "--no-refine", "--epochs", "0", "--out", &folder]).finished();
}

#[test]
fn a_place_that_cannot_be_written_is_refused_before_anything_is_simulated() {
    let place = Place::new();
    // Permissions would not keep an administrator out; this folder keeps out everyone.
    run(OPTIMISE, &[&place.tiny(), "--out", "/proc/powderline"])
        .refused(1, "the folder /proc/powderline cannot be created");
    let done = Command::new(OPTIMISE).arg(place.tiny()).current_dir("/proc").output().unwrap();
    assert_eq!(done.status.code(), Some(1));
    assert!(
        String::from_utf8(done.stderr).unwrap().starts_with("the folder runs/tiny-seed1 cannot be created")
    );
    assert!(!Path::new("/proc/runs").exists());
}

#[test]
fn results_that_cannot_be_written_are_a_failure() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.tiny_run("run", 0));
    for (program, arguments, code) in [
        (OPTIMISE, &["check", "bench-small", "--json"][..], 1),
        (OPTIMISE, &["inspect", &plan], 1),
        (EXECUTE, &[&plan, "--json"], 5),
    ] {
        let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let output = command(program, arguments).stdout(full).output().unwrap();
        assert_eq!(output.status.code(), Some(code));
        let err = String::from_utf8(output.stderr).unwrap();
        assert!(err.lines().count() == 1 && err.contains("cannot be written"), "{err}");
    }
}
