//! `optimise refine`.

use super::{Done, MISSED, ON_FINER_CELLS, Place, assert_sentence, bytes, optimise, optimise_for};
use powderline_shared::plan::{PlanHeader, PlanReader};
use powderline_simulator::scene::{Amount, Quantity, Scene, SceneSpec};
use serde_json::Value;
use std::fs;

fn refined(place: &Place, plan: &str, out: &str, patience: u64) -> Done {
    optimise_for(patience, &["refine", plan, "--out", &place.text(out), "--json"])
}

#[test]
fn a_plan_is_corrected_until_the_finer_grid_brings_what_is_wanted() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.finished("run", 3));
    let done = refined(&place, &plan, "at-once", u64::MAX);
    assert!([0, MISSED].contains(&done.code), "{}", done.err);
    let report: Value = serde_json::from_str(&done.out).unwrap();
    let tried = report["tried"].as_array().unwrap();
    let miss = |line: &Value| line["miss"].as_f64().unwrap().abs();
    let best = &tried[report["best"].as_u64().unwrap() as usize];
    assert!(tried.len() > 1 && miss(best) < miss(&tried[0]), "{report}");
    // The plan says both.
    let bytes = fs::read(place.path("at-once").join("skill.plan")).unwrap();
    let header = *PlanReader::new(&bytes).unwrap().header();
    let finer = header.finer.unwrap();
    assert!((finer.cell_m - 0.002).abs() < 1e-12);
    assert_eq!(Some(finer.arrives_kg()), best["mass_kg"].as_f64());
    assert!((finer.arrives_kg() / header.predicted.arrives_kg() - ON_FINER_CELLS).abs() < 0.02);
    let plan_there = place.text("at-once") + "/skill.plan";
    let said = optimise(&["inspect", &plan_there]).out;
    assert!(said.starts_with("On a finer grid, with cells of 2 mm, the plan brings "), "{said}");
    let again = optimise(&["simulate", "--plan", &plan_there]);
    assert!(
        again.code == 0 && again.out.contains("by which the plan is judged, it says that "),
        "{}",
        again.out
    );
    // Once more: nothing is simulated.
    let again = refined(&place, &plan, "at-once", 1);
    assert_eq!((again.out, again.code), (done.out.clone(), done.code));
    // Stopped again and again, it comes to the same bytes.
    let mut stops = 0;
    while refined(&place, &plan, "stopped", 10).code == 130 {
        stops += 1;
    }
    let stopped = fs::read(place.path("stopped").join("skill.plan")).unwrap();
    assert!(stops > 2 && stopped == bytes, "{stops}");
}

#[test]
fn what_is_of_something_else_is_not_gone_on_with() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.finished("run", 1));
    refined(&place, &plan, "a", u64::MAX);
    let out = place.text("a");
    let other = optimise(&["refine", &plan, "--by", "3", "--out", &out]);
    assert_sentence(&other, 2, "looks.json was begun with --by 2, and 3 is asked for");
    fs::write(place.path("a").join("looks.json"), "{}").unwrap();
    assert_sentence(&optimise(&["refine", &plan, "--out", &out]), 2, "looks.json is nothing to go on from");
    let run = place.text("run");
    assert_sentence(&optimise(&["refine", &plan, "--out", &run]), 2, "holds a plan of something else");
    assert_sentence(&optimise(&["refine", &place.text("none.plan")]), 2, "no such file");
}

/// A run of a bench that wants what the smaller cells can bring, too.
fn run(place: &Place, folder: &str, patience: u64, more: &[&str]) -> Done {
    let little = |spec: &mut SceneSpec| {
        spec.objective.amount = Amount::new(Quantity::MassKg(0.0011));
        // Whether an arm can make each motion is not asked here, and would take its time.
        spec.arm = None;
    };
    let scene = Scene::load("bench-small").unwrap().with(little).unwrap();
    fs::write(place.path("little.toml"), scene.to_toml()).unwrap();
    let file = place.text("little.toml");
    let search = [&file, "--seed", "4", "--method", "mixed", "--epochs", "12", "--out", folder];
    optimise_for(patience, &[&search[..], more].concat())
}

fn header_in(folder: &str) -> PlanHeader {
    *PlanReader::new(&bytes(folder, "skill.plan")).unwrap().header()
}

#[test]
fn a_run_corrects_its_plan_by_smaller_cells_and_says_them_first() {
    let place = Place::new();
    let [folder, plain, stopped] = ["run", "plain", "stopped"].map(|name| place.text(name));
    let done = run(&place, &folder, u64::MAX, &["--json"]);
    let found: Value = serde_json::from_str(&done.out).unwrap();
    let finer = &found["finer"];
    let miss = |of: &Value| of["miss"].as_f64().unwrap().abs();
    assert!(miss(&finer["plan"]) < miss(&finer["before"][1]) && finer["corrected"] == true, "{found}");
    // It is judged there, not by what the scene's own cells bring.
    assert_eq!((&found["met"], done.code), (&true.into(), 0), "{found}");
    assert!(miss(&finer["plan"]) <= 0.02 && miss(&found["plan"]) > 0.02, "{found}");
    // One fact, one source: the plan, the words, the page and the run's own outcome.
    let header = header_in(&folder);
    assert_eq!(Some(header.finer.unwrap().arrives_kg()), finer["plan"]["mass_kg"].as_f64());
    assert_eq!(Some(header.predicted.arrives_kg()), found["plan"]["mass_kg"].as_f64());
    let plan = format!("{folder}/skill.plan");
    let inspected = optimise(&["inspect", &plan]).out;
    let first = inspected.lines().next().unwrap();
    assert!(
        first.starts_with("On cells of 2 mm the plan brings ")
            && first.contains("; on the scene's own of 4 mm")
    );
    assert!(inspected.contains("is what was corrected: of the epochs"), "{inspected}");
    let page = optimise(&["report", &folder, "--no-replay"]);
    assert!(page.out.starts_with(first), "{}", page.out);
    let html = fs::read_to_string(format!("{folder}/report.html")).unwrap();
    assert!(html.contains("The figures are those on cells of 2 mm"));
    assert!(html.contains("Brings the wanted amount on cells of 2 mm: "));
    // The search's own is what it is without.
    assert!(run(&place, &plain, u64::MAX, &["--no-refine"]).is_finished());
    let own = header_in(&plain);
    assert_eq!((own.finer, own.predicted.census.target > 0), (None, true));
    assert_eq!(Some(own.predicted.arrives_kg()), finer["before"][0]["mass_kg"].as_f64());
    assert_eq!(super::metrics(&folder), super::metrics(&plain));
    // Stopped again and again, it comes to the same plan.
    let mut done = run(&place, &stopped, 40, &[]);
    let mut stops = 0;
    while done.code == 130 {
        stops += 1;
        done = optimise_for(40, &["--resume", &stopped]);
    }
    assert!(stops > 3 && bytes(&stopped, "skill.plan") == bytes(&folder, "skill.plan"), "{stops}");
    assert!(optimise(&["--resume", &folder]).err.contains("is finished"));
}

/// More epochs are another plan, looked at anew or not at all.
#[test]
fn a_run_that_is_prolonged_is_looked_at_as_one_that_was_as_long_from_the_beginning() {
    let place = Place::new();
    for more in [&[][..], &["--no-refine"]] {
        let [short, long] = ["short", "long"].map(|name| format!("{}{}", place.text(name), more.len()));
        // No path and no skill of so few epochs has the amount.
        let few = |folder: &str, epochs: &str, more: &[&str]| {
            let search =
                ["bench-small", "--seed", "4", "--method", "mixed", "--patience", "0", "--out", folder];
            optimise(&[&search[..], &["--epochs", epochs], more].concat())
        };
        assert!(few(&short, "3", &[]).is_finished() && header_in(&short).finer.is_some());
        let first = bytes(&short, "skill.plan");
        assert!(few(&long, "5", more).is_finished());
        assert!(optimise(&[&["--resume", &short, "--epochs", "5"][..], more].concat()).is_finished());
        assert_eq!(header_in(&short).finer.is_none(), more.len() == 1);
        let plan = bytes(&short, "skill.plan");
        assert!(plan != first && plan == bytes(&long, "skill.plan"));
    }
}

#[test]
fn a_run_that_is_stopped_in_its_correction_may_leave_it_out() {
    let place = Place::new();
    let [stopped, plain] = ["stopped", "plain"].map(|name| place.text(name));
    run(&place, &plain, u64::MAX, &["--no-refine"]);
    let mut done = run(&place, &stopped, 40, &[]);
    while !done.err.contains("the plan that the search left is written") {
        assert_eq!(done.code, 130, "{}", done.err);
        done = optimise_for(40, &["--resume", &stopped]);
    }
    assert!(done.err.contains("go on with: "), "{}", done.err);
    assert_eq!(bytes(&stopped, "skill.plan"), bytes(&plain, "skill.plan"));
    assert!(optimise(&["--resume", &stopped, "--no-refine"]).is_finished());
    assert_eq!(bytes(&stopped, "skill.plan"), bytes(&plain, "skill.plan"));
}

#[test]
fn a_bench_too_large_for_smaller_cells_is_not_looked_at_there_and_it_is_said_why() {
    let place = Place::new();
    let folder = place.text("run");
    let done = optimise(&["bench-fine", "--method", "mixed", "--epochs", "1", "--out", &folder]);
    assert!(done.is_finished(), "{}", done.err);
    let why =
        "It was not looked at on smaller cells: a rollout there would take 2.9e10 substeps of particles";
    assert!(done.out.contains(why), "{}", done.out);
    assert!(
        header_in(&folder).finer.is_none()
            && optimise(&["inspect", &format!("{folder}/skill.plan")]).out.contains(why)
    );
}

/// Before anything runs: a plan that depended on the memory would break that the bits do not.
#[test]
fn memory_that_holds_the_search_alone_is_refused_and_it_is_said_what_leaves_the_rest_out() {
    let place = Place::new();
    let folder = place.text("run");
    let search =
        ["bench-small", "--method", "random", "--epochs", "0", "--threads", "2", "--memory", "48MiB"];
    let asked = [&search[..], &["--out", &folder]].concat();
    assert_sentence(
        &optimise(&asked),
        2,
        "that is for the plan on cells of 2 mm, which --no-refine leaves out",
    );
    assert!(!place.path("run").exists());
    let without = optimise(&[&asked[..], &["--no-refine"]].concat());
    assert!(without.is_finished(), "{}", without.err);
}
