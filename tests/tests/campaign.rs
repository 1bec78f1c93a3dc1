//! Campaigns: many cases, several at a time, stopped, killed and gone on with.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Child;
use std::thread::sleep;
use std::time::{Duration, Instant, SystemTime};

use powderline_shared::plan::PlanReader;

use crate::programs::{Done, OPTIMISE, Place, assert_same_bits, bytes, command, run, wait};

/// A few rollouts of the tiny scene, of two powders, two amounts and two draws.
const ROLLOUTS: &str = r#"
name = "few"
benches = ["tiny.toml"]
amounts_kg = [0.0008, 0.0016]
seeds = [1, 7]
theta = [0.3, 0.0, 0.0, 0.0, 0.3]

[[powder]]
name = "heavy"
density_kg_m3 = 1500.0

[[powder]]
name = "steep"
friction_angle_deg = 38.0

[draws]
count = 2
seed = 1
powder.cohesion_pa = { low = 0.0, high = 20.0 }
"#;
const CASES: usize = 16;

/// The same with more of it to do, for what is stopped in the middle.
fn many() -> String {
    ROLLOUTS.replace("count = 2", "count = 6")
}

/// Searches of the tiny scene.
const SEARCHES: &str =
    "name = \"searches\"\nbenches = [\"tiny.toml\"]\nseeds = { first = 1, count = 2 }\nepochs = 1\n";

fn campaign(place: &Place, text: &str) -> String {
    place.tiny();
    place.write("campaign.toml", text.as_bytes())
}

fn done(place: &Place, file: &str, out: &str, more: &[&str]) -> (Done, String) {
    let out = place.path(out);
    let done = run(OPTIMISE, &[&["campaign", file, "--out", &out][..], more].concat());
    (done, out)
}

/// When each case came to its outcome.
fn outcomes(folder: &str) -> BTreeMap<String, SystemTime> {
    let Ok(cases) = fs::read_dir(Path::new(folder).join("cases")) else { return BTreeMap::new() };
    let when = |case: fs::DirEntry| {
        let written = fs::metadata(case.path().join("outcome.json")).ok()?.modified().unwrap();
        Some((case.file_name().into_string().unwrap(), written))
    };
    cases.filter_map(|case| when(case.unwrap())).collect()
}

/// Waits until so many cases are done.
fn wait_for(cases: usize, folder: &str) {
    let begin = Instant::now();
    while outcomes(folder).len() < cases {
        assert!(begin.elapsed() < Duration::from_secs(120), "nothing comes of {folder}");
        sleep(Duration::from_millis(20));
    }
}

/// Processes that this one has started.
#[cfg(target_os = "linux")]
fn workers(of: &Child) -> Vec<String> {
    let parent = of.id().to_string();
    let is_child = |id: &String| {
        let stat = fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
        stat.rsplit(')').next().and_then(|rest| rest.split_whitespace().nth(1)) == Some(&parent)
    };
    let all =
        fs::read_dir("/proc").unwrap().filter_map(|entry| entry.unwrap().file_name().into_string().ok());
    all.filter(is_child).collect()
}

#[cfg(unix)]
fn send(signal: &str, process: &str) {
    let arguments = ["-c", "kill -\"$1\" \"$0\"", process, signal];
    assert!(std::process::Command::new("sh").args(arguments).status().unwrap().success());
}

#[test]
fn however_many_are_done_at_a_time_the_table_is_the_same_bytes() {
    let place = Place::new();
    let file = campaign(&place, ROLLOUTS);
    let (one, alone) = done(&place, &file, "alone", &["--threads", "1"]);
    assert_eq!(one.err.lines().filter(|line| line.starts_with('[')).count(), CASES, "{one:?}");
    assert!(
        one.err.contains("1 case at a time") && one.succeeded().contains("Of 16 cases, 16 are simulated.")
    );
    let (three, together) = done(&place, &file, "together", &["--threads", "3", "--json"]);
    assert!(three.err.contains("3 cases at a time, with 1 thread"), "{three:?}");
    let found = three.json();
    assert_eq!(
        (found["cases"].as_u64(), found["done"].as_u64(), found["failed"].as_u64()),
        (Some(16), Some(16), Some(0))
    );
    assert!(bytes(&alone, "table.parquet") == bytes(&together, "table.parquet"));
    // Each what a rollout of its scene is.
    let page = String::from_utf8(bytes(&alone, "report.html")).unwrap();
    assert!(page.contains("tiny_steep_1.6g_draw2_seed7") && page.contains("class=\"table heat\""), "{page}");
    let outcome = |case: &str| -> serde_json::Value {
        serde_json::from_slice(&bytes(Path::new(&alone).join("cases").join(case), "outcome.json")).unwrap()
    };
    let [heavy, steep] = ["heavy", "steep"].map(|powder| outcome(&format!("tiny_{powder}_1.6g_draw1_seed7")));
    assert_ne!(heavy["found"]["loss_m"], steep["found"]["loss_m"]);
    assert_eq!(heavy["found"]["wanted_kg"].as_f64().map(|kg| (kg * 1e4).round()), Some(16.0));
}

#[test]
fn each_search_is_a_run_like_any_other() {
    let place = Place::new();
    let file = campaign(&place, SEARCHES);
    let (ended, folder) = done(&place, &file, "searches", &["--threads", "2"]);
    ended.finished();
    for seed in ["1", "2"] {
        let case = format!("{folder}/cases/tiny_seed{seed}");
        let alone = place.path(seed);
        run(OPTIMISE, &["run", &place.path("tiny.toml"), "--seed", seed, "--epochs", "1", "--out", &alone])
            .finished();
        assert_same_bits(&case, &alone);
        assert!(Path::new(&case).join("report.html").exists());
        // The amount is that on the smaller cells, the loss that on the bench's own: a plan has both.
        let plan = bytes(&case, "skill.plan");
        let header = *PlanReader::new(&plan).unwrap().header();
        let outcome: serde_json::Value = serde_json::from_slice(&bytes(&case, "outcome.json")).unwrap();
        let number = |key: &str| outcome["found"][key].as_f64();
        assert_eq!(number("loss_m").map(f64::to_bits), Some(header.predicted.loss_m.to_bits()), "{outcome}");
        assert_eq!(number("own_mass_kg"), Some(header.predicted.arrives_kg()));
        assert_eq!(number("mass_kg"), header.finer.map(|finer| finer.arrives_kg()));
    }
    let page = String::from_utf8(bytes(&folder, "report.html")).unwrap();
    assert!(page.contains("href=\"cases/tiny_seed1/report.html\""), "{page}");
    // It is done: nothing is done again.
    let before = outcomes(&folder);
    let again = run(OPTIMISE, &["campaign", "--resume", &folder]);
    assert!(again.err.contains("are done"), "{again:?}");
    assert_eq!(outcomes(&folder), before);
    // And with more seeds, only those.
    let more = campaign(&place, &SEARCHES.replace("count = 2", "count = 3"));
    run(OPTIMISE, &["campaign", &more, "--resume", &folder]).finished();
    let after = outcomes(&folder);
    assert_eq!((after.len(), before.iter().all(|(case, when)| after[case] == *when)), (3, true));
}

/// And it is other work: what was done with the one is no result of the other.
#[test]
fn plans_stay_as_the_search_left_them_where_the_file_says_so() {
    let place = Place::new();
    let one = SEARCHES.replace("count = 2", "count = 1") + "replays = false\n";
    let plain = campaign(&place, &format!("{one}refine = false\n"));
    let (ended, folder) = done(&place, &plain, "plain", &["--threads", "2"]);
    ended.finished();
    let plan = bytes(format!("{folder}/cases/tiny_seed1"), "skill.plan");
    assert_eq!(PlanReader::new(&plan).unwrap().header().finer, None);
    let refined = campaign(&place, &one);
    run(OPTIMISE, &["campaign", &refined, "--resume", &folder]).ended(2, "is of another case");
}

#[cfg(target_os = "linux")]
#[test]
fn what_is_stopped_or_killed_goes_on_to_the_same_table() {
    let place = Place::new();
    let file = campaign(&place, &many());
    let (whole, folder) = done(&place, &file, "whole", &["--threads", "2"]);
    whole.succeeded();
    let table = bytes(&folder, "table.parquet");
    for signal in ["INT", "TERM", "KILL"] {
        let folder = place.path(signal);
        let child =
            command(OPTIMISE, &["campaign", &file, "--out", &folder, "--threads", "2"]).spawn().unwrap();
        wait_for(5, &folder);
        let employed = workers(&child);
        assert_eq!(employed.len(), 2);
        send(signal, &child.id().to_string());
        let ended = wait(child);
        if signal != "KILL" {
            ended.ended(130, "stopped on request; what is done is saved, go on with: ");
            assert!(ended.err.trim_end().ends_with(&format!("campaign --resume {folder}")), "{ended:?}");
        }
        let before = outcomes(&folder);
        assert!((5..CASES * 3).contains(&before.len()), "{}", before.len());
        let rest = run(OPTIMISE, &["campaign", "--resume", &folder, "--threads", "1"]);
        assert!(rest.err.contains("are done already"), "{rest:?}");
        rest.succeeded();
        assert!(bytes(&folder, "table.parquet") == table, "{signal}");
        let after = outcomes(&folder);
        // What a worker that was left alone was about to finish, it finished.
        assert!(before.iter().all(|(case, when)| after[case] == *when), "{signal}: something was done twice");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_worker_that_is_killed_takes_no_other_case_along() {
    let place = Place::new();
    let file = campaign(&place, &many());
    let (_, whole) = done(&place, &file, "whole", &[]);
    // One that is asked to end says that it was stopped; from here it was not.
    for (signal, how) in [("KILL", "was killed"), ("TERM", "was stopped by somebody else")] {
        let folder = place.path(signal);
        let child =
            command(OPTIMISE, &["campaign", &file, "--out", &folder, "--threads", "2"]).spawn().unwrap();
        wait_for(3, &folder);
        send(signal, &workers(&child)[0]);
        let ended = wait(child);
        assert_eq!(ended.code, Some(1), "{ended:?}");
        let last = ended.err.lines().last().unwrap();
        assert!(last.starts_with(&format!("1 case failed; the first: its process {how}")), "{ended:?}");
        assert!(ended.out.contains("Of 48 cases, 1 failed, 47 are simulated."), "{ended:?}");
        let page = String::from_utf8(bytes(&folder, "report.html")).unwrap();
        assert!(page.contains(&format!("its process {how}")));
        // It is tried again.
        run(OPTIMISE, &["campaign", "--resume", &folder]).succeeded();
        assert!(bytes(&folder, "table.parquet") == bytes(&whole, "table.parquet"));
    }
}

#[test]
fn what_makes_no_sense_is_refused_before_anything_is_begun() {
    let place = Place::new();
    let refused = |text: &str| {
        let file = campaign(&place, text);
        let (ended, folder) = done(&place, &file, "never", &[]);
        assert!(
            ended.code == Some(2) && ended.out.is_empty() && !ended.err.contains("panicked"),
            "{ended:?}"
        );
        assert!(!Path::new(&folder).exists(), "{folder}");
        ended.err
    };
    let changed = |from: &str, to: &str| ROLLOUTS.replacen(from, to, 1);
    for (text, about) in [
        (
            changed("amounts_kg", "amount_kg"),
            "line 4: unknown key `amount_kg`; did you mean `amounts_kg`? Possible are",
        ),
        (
            changed("seeds = [1, 7]", "seeds = { first = 1, count = 1000000000 }"),
            "2 powders x 2 amounts x 2 draws x 1000000000 seeds are more than 100000 cases",
        ),
        (changed("[1, 7]", "\"all\""), "expected a list of seeds, or { first = 1, count = 30 }"),
        (changed("[1, 7]", "[1, 1]"), "seeds: 1 is there twice"),
        (changed("tiny.toml", "tinny.toml"), "tinny.toml"),
        (changed("0.0008", "-1.0"), "amounts_kg has -1, but each must be above 0"),
        (changed("0.3, 0.0", "1.3, 0.0"), "theta has 1.3"),
        (changed("\"heavy\"", "\"very heavy\""), "powder.name is \"very heavy\""),
        (changed("low = 0.0", "low = 30.0"), "low must not be above high"),
        (changed("low = 0.0, high = 20.0", "within = 0.1"), "{ relative = 0.1 }"),
        (changed("theta", "epochs = 3\ntheta"), "epochs and theta exclude each other"),
        (changed("friction_angle_deg", "seed = 3\nfriction_angle_deg"), "has a seed"),
    ] {
        let said = refused(&text);
        assert!(said.contains(about), "{about} in {said}");
    }
    // Whatever is wrong with a case is said, and with which.
    let wrong = changed("1500.0", "-1.0")
        .replace("0.0016", "0.5")
        .replace("friction_angle_deg", "friktion_angle_deg");
    let said = refused(&wrong);
    for about in [
        "few: 8 of 8 cases cannot be run, each with 2 seeds, and nothing was begun:",
        "tiny_heavy_0.8g_draw1: powder.density_kg_m3 is -1",
        "tiny_heavy_500g_draw2: ",
        "tiny_steep_0.8g_draw1: powder.friktion_angle_deg: unknown field `friktion_angle_deg`; did you mean `friction_angle_deg`?",
    ] {
        assert!(said.contains(about), "{about} in {said}");
    }
    // A search also has to be possible.
    let impossible = format!("{SEARCHES}amounts_kg = [0.015]\n");
    let said = refused(&impossible);
    assert!(said.contains("tiny_15g: "), "{said}");
    // And what would fit is only looked at.
    let file = campaign(&place, ROLLOUTS);
    let looked = run(OPTIMISE, &["campaign", &file, "--check"]);
    assert!(looked.succeeded().contains("few can be run: "));
}

#[test]
fn a_folder_keeps_what_it_was_begun_with() {
    let place = Place::new();
    let file = campaign(&place, &ROLLOUTS.replace("count = 2", "count = 1"));
    let (first, folder) = done(&place, &file, "few", &[]);
    first.succeeded();
    let (second, _) = done(&place, &file, "few", &[]);
    second.ended(2, "already holds a campaign, which is not overwritten");
    let other = campaign(&place, &ROLLOUTS.replace("count = 2", "count = 1").replace("[0.3,", "[0.4,"));
    let refused = run(OPTIMISE, &["campaign", &other, "--resume", &folder]);
    refused.ended(2, "is of another case");
    run(OPTIMISE, &["campaign", "--resume", &place.path("nowhere")]).ended(2, "holds nothing to resume");
}
