//! `optimise compare` with the stand-in.

use super::*;
use crate::compare::{EXACT_ADJOINT, cost_of};
use crate::report::{
    folder::{COMPARISON, RunFolder},
    tries::Try,
};

const METHODS: &str = "surrogate,mixed,sac,cma-es,random";

fn arguments<'a>(folder: &'a str, rollouts: &'a str) -> Vec<&'a str> {
    let which = ["--methods", METHODS, "--seeds", "1,2", "--rollouts", rollouts];
    [&["compare", "bench-small", "--out", folder][..], &which].concat()
}

/// What was tried.
fn tries(folder: &str, track: &str) -> Vec<Try> {
    let text = fs::read_to_string(Path::new(folder).join(track).join(TRIES)).unwrap();
    // Without what a clock says.
    let parse = |line| Try { cpu_seconds: 0.0, ..serde_json::from_str(line).unwrap() };
    text.lines().map(parse).collect()
}

fn assert_same(folder: &str, other: &str) {
    for seed in [1, 2] {
        for method in METHODS.split(',') {
            let track = format!("{method}-seed{seed}");
            assert_eq!(tries(folder, &track), tries(other, &track), "{track}");
            let metrics = |folder: &str| metrics(&format!("{folder}/{track}"));
            assert_eq!(metrics(folder), metrics(other), "{track}");
        }
    }
}

#[test]
fn a_comparison_leaves_figure_table_and_summary() {
    let place = Place::new();
    let folder = place.text("comparison");
    let done = optimise(&arguments(&folder, "12,30"));
    assert_eq!(done.code, 0, "{}", done.err);
    for file in [SCENE, COMPARISON, CURVES, "curves.png", "comparison.csv", "summary.md"] {
        assert!(Path::new(&folder).join(file).is_file(), "{file}");
    }
    let summary = String::from_utf8(bytes(&folder, "summary.md")).unwrap();
    assert!(done.out.contains(&summary), "{}", done.out);
    let again = optimise(&["compare", "--resume", &folder, "--json"]);
    let report: Value = serde_json::from_str(&again.out).unwrap();
    let named: Vec<&str> =
        report["rows"].as_array().unwrap().iter().map(|row| row["method"].as_str().unwrap()).collect();
    assert!(report["folder"] == *folder && report["seeds"] == serde_json::json!([1, 2]), "{report}");
    let rows: Vec<&str> =
        summary.lines().skip(2).map(|line| line.split('|').nth(1).unwrap().trim()).collect();
    assert_eq!(named, rows);
    assert_eq!(named, METHODS.split(',').collect::<Vec<_>>());
    let widths: Vec<usize> = summary.lines().map(str::len).collect();
    assert!(widths.iter().all(|width| *width == widths[0]), "{summary}");
    let mut count = 0;
    for seed in [1, 2] {
        for method in METHODS.split(',') {
            let tries = tries(&folder, &format!("{method}-seed{seed}"));
            count += tries.len();
            // The last epoch may go beyond the budget, and none begins there.
            let cost = cost_of(&tries);
            let last = tries.last().unwrap().epoch;
            let before = cost_of(tries.iter().filter(|one| one.epoch < last));
            assert!(cost >= 30.0 && before < 30.0, "{method}: {cost} {before}");
        }
        // There is no plan: it is about searches.
        assert!(!Path::new(&folder).join(format!("mixed-seed{seed}")).join(PLAN).exists());
    }
    let table = String::from_utf8(bytes(&folder, "comparison.csv")).unwrap();
    assert_eq!(table.lines().count(), 1 + count);
    let widths: Vec<usize> = table.lines().map(|line| line.split(',').count()).collect();
    assert!(widths.iter().all(|width| *width == widths[0]), "{table}");
    assert!(table.contains(",coarse,,") && table.contains(",fine,exact,"), "{table}");
    // The page shows the best skill of all.
    assert_eq!(optimise(&["report", &folder]).code, 0);
    let page = String::from_utf8(bytes(&folder, "report.html")).unwrap();
    assert!(page.contains("The skill with the lowest loss of all"), "{page}");
}

#[test]
fn a_comparison_interrupted_again_and_again_has_the_same_bits() {
    let place = Place::new();
    let [whole, folder] = ["whole", "parts"].map(|name| place.text(name));
    let done = optimise(&arguments(&whole, "30"));
    assert_eq!(done.code, 0);
    // Nobody knows how many epochs there will be.
    assert!(done.err.contains("\nepoch   1 ") && !done.err.contains(" left"), "{}", done.err);
    let mut done = optimise_for(20, &arguments(&folder, "30"));
    let mut resumptions = 0;
    while done.code == 130 && resumptions < 1000 {
        assert!(done.err.contains(&format!("compare --resume {folder}")), "{}", done.err);
        // Enough for the longest epoch.
        done = optimise_for(14 * TICKS, &["compare", "--resume", &folder]);
        resumptions += 1;
    }
    assert!(done.code == 0 && resumptions > 3, "{} after {resumptions}", done.err);
    assert_same(&folder, &whole);
}

#[test]
fn a_prolonged_comparison_has_the_bits_of_a_longer_one() {
    let place = Place::new();
    let [long, short] = ["long", "short"].map(|name| place.text(name));
    assert_eq!(optimise(&arguments(&long, "40")).code, 0);
    assert_eq!(optimise(&arguments(&short, "15")).code, 0);
    let drawn = || [CURVES, "comparison.csv", "summary.md"].map(|name| bytes(&short, name));
    let prolong = ["compare", "--resume", &short, "--rollouts", "15,40"];
    // Stopped among the last searches, it leaves what was drawn of all of them.
    let before = drawn();
    let done = optimise_for(TICKS * 200, &prolong);
    assert!(done.code == 130 && done.err.contains("surrogate, seed 2,"), "{}", done.err);
    assert_eq!(drawn(), before);
    let done = optimise(&prolong);
    assert_eq!(done.code, 0, "{}", done.err);
    assert_ne!(drawn(), before);
    assert_same(&short, &long);
    let done = optimise(&["compare", "--resume", &short, "--rollouts", "20"]);
    assert_sentence(&done, 2, "it can only be prolonged");
}

#[test]
fn searches_done_one_by_one_make_the_comparison_that_one_process_makes() {
    let place = Place::new();
    let [whole, folder] = ["whole", "parts"].map(|name| place.text(name));
    assert_eq!(optimise(&arguments(&whole, "15")).code, 0);
    let prepared = optimise(&[&arguments(&folder, "15")[..], &["--prepare"]].concat());
    assert_eq!(prepared.code, 0, "{}", prepared.err);
    let names: Vec<&str> = prepared.out.lines().collect();
    assert!(prepared.err.contains(&format!("compare --resume {folder} --only SEARCH")), "{}", prepared.err);
    assert_eq!(names.len(), 2 * METHODS.split(',').count());
    // Others may be at it in the meantime, but nobody who draws.
    let beside = RunFolder::share(Path::new(&folder), COMPARISON).unwrap();
    assert_sentence(&optimise(&["compare", "--resume", &folder]), 1, "another run is writing");
    let stopped = optimise_for(5, &["compare", "--resume", &folder, "--only", names[0]]);
    assert_sentence(&stopped, 130, &format!("compare --resume {folder} --only {}", names[0]));
    // A page of it can be made at any time.
    let whole_folder = RunFolder::open_with(Path::new(&folder), COMPARISON);
    assert!(whole_folder.is_err(), "it is shared");
    let page = optimise(&["report", &folder, "--no-replay", "--out", &place.text("page.html")]);
    assert_eq!(page.code, 0, "{}", page.err);
    for two in names.rchunks(2) {
        let done = optimise(&["compare", "--resume", &folder, "--only", &two.join(",")]);
        assert_eq!(done.code, 0, "{}", done.err);
        assert!(!Path::new(&folder).join(CURVES).exists());
    }
    drop(beside);
    let left = optimise(&["compare", "--resume", &folder, "--prepare", "--json"]);
    assert_eq!(serde_json::from_str::<Value>(&left.out).unwrap()["left"], serde_json::json!([]));
    let done = optimise(&["compare", "--resume", &folder]);
    assert!(done.code == 0 && !done.err.contains("epoch"), "{}", done.err);
    assert_same(&folder, &whole);
    let no_such = optimise(&["compare", "--resume", &folder, "--only", "sac-seed3"]);
    assert_sentence(&no_such, 2, "sac-seed3, but the comparison has surrogate-seed1, ");
}

/// Killed between its first two files.
#[test]
fn a_search_that_had_hardly_begun_is_begun_anew() {
    let place = Place::new();
    let folder = place.text("killed");
    let search = [
        "compare",
        "bench-small",
        "--methods",
        "random",
        "--seeds",
        "1",
        "--rollouts",
        "3",
        "--out",
        &folder,
    ];
    assert_eq!(optimise(&search).code, 0);
    let begun = place.path("killed/random-seed1");
    for file in fs::read_dir(&begun).unwrap().map(|file| file.unwrap().path()) {
        if file.file_name().is_some_and(|name| name != SCENE) {
            fs::remove_file(file).unwrap();
        }
    }
    let done = optimise(&["compare", "--resume", &folder]);
    assert!(done.code == 0 && begun.join(STATE).exists(), "{}", done.err);
    // Another scene is nobody's to be taken away.
    fs::remove_file(begun.join(STATE)).unwrap();
    fs::write(begun.join(SCENE), "something else").unwrap();
    assert_eq!(optimise(&["compare", "--resume", &folder]).code, 2);
    assert_eq!(bytes(begun.to_str().unwrap(), SCENE), b"something else");
}

#[test]
fn ways_down_the_gradient_differ_in_what_they_are_called_by() {
    let place = Place::new();
    let folder = place.text("variants");
    let methods = "mixed,restarted,differences,exact";
    let more = ["--methods", methods, "--seeds", "4", "--rollouts", "20", "--out", &folder];
    let done = optimise(&[&["compare", "bench-small"][..], &more].concat());
    assert_eq!(done.code, 0, "{}", done.err);
    for method in methods.split(',') {
        let first = &metrics(&format!("{folder}/{method}-seed4"))[0]["slopes"];
        let (adjoint, differences) = (&first["adjoint"][0], &first["differences"][0]);
        assert_eq!(adjoint.is_null(), method == "differences", "{method}");
        assert_eq!(differences.is_null(), method == "exact", "{method}");
        let tries = tries(&folder, &format!("{method}-seed4"));
        let has_adjoint = tries[0].adjoint.map(crate::optim::Adjoint::name);
        let expected = match method {
            "restarted" => Some("restarted"),
            "differences" => None,
            _ => Some("exact"),
        };
        assert_eq!(has_adjoint, expected, "{method}");
    }
    let exact = tries(&folder, "exact-seed4");
    assert!((cost_of(&exact[..1]) - 1.0 - EXACT_ADJOINT).abs() < 1e-12);
}

#[test]
fn what_makes_no_comparison_is_refused() {
    let place = Place::new();
    let folder = place.text("comparison");
    let compare = |more: &[&str]| {
        let all: Vec<&str> =
            ["compare", "bench-small", "--out", &folder].iter().chain(more).copied().collect();
        optimise(&all)
    };
    assert_sentence(&compare(&["--seeds", "1,2,1"]), 2, "--seeds names 1 twice");
    assert_sentence(&compare(&["--methods", "random,random"]), 2, "--methods names Random twice");
    assert_sentence(&compare(&["--rollouts", "200000"]), 2, "at most 100000");
    assert_sentence(&compare(&["--rollouts", "30,20"]), 2, "that rise would be right");
    assert_sentence(&compare(&["--rollouts", "0"]), 2, "above 0");
    assert!(!Path::new(&folder).exists());
    assert_sentence(&optimise(&["compare", "--resume", &folder]), 2, "holds nothing to resume");
    fs::create_dir(&folder).unwrap();
    assert_sentence(&optimise(&["compare", "--resume", &folder]), 2, COMPARISON);
}

#[test]
fn a_comparison_that_was_changed_is_refused() {
    let place = Place::new();
    let folder = place.text("comparison");
    let begin = [
        "compare",
        "bench-small",
        "--methods",
        "random",
        "--seeds",
        "1,2",
        "--rollouts",
        "11",
        "--out",
        &folder,
    ];
    assert_eq!(optimise(&begin).code, 0);
    assert_sentence(&optimise(&begin), 2, "already holds");
    let change = |file: &str, from: &str, to: &str| {
        let path = Path::new(&folder).join(file);
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{text}");
        fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let done = optimise(&["compare", "--resume", &folder]);
        fs::write(&path, text).unwrap();
        done
    };
    assert_sentence(&change(SCENE, "friction = 0.4", "friction = 0.3"), 2, "no longer the scene");
    assert_sentence(&change(COMPARISON, "\"random\"", "\"luck\""), 2, COMPARISON);
    let path = Path::new(&folder).join("random-seed1/state");
    let whole = fs::read(&path).unwrap();
    let mut flipped = whole.clone();
    flipped[100] ^= 1;
    for (broken, about) in [
        (whole[..whole.len() / 2].to_vec(), "damaged"),
        (flipped, "damaged"),
        (b"{}".to_vec(), "not a state file"),
        (bytes(&folder, "random-seed2/state"), "holds another run than the comparison's random-seed1"),
    ] {
        fs::write(&path, &broken).unwrap();
        assert_sentence(&optimise(&["compare", "--resume", &folder]), 2, about);
    }
    // What stands beside the state is put right by it.
    fs::write(&path, &whole).unwrap();
    let before = tries(&folder, "random-seed1");
    fs::write(Path::new(&folder).join("random-seed1").join(TRIES), "").unwrap();
    assert_eq!(optimise(&["compare", "--resume", &folder]).code, 0);
    assert_eq!(tries(&folder, "random-seed1"), before);
}
