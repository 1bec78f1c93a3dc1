//! `optimise refine`.

use super::{Done, MISSED, ON_FINER_CELLS, Place, assert_sentence, optimise, optimise_for};
use powderline_shared::plan::PlanReader;
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
    assert_eq!(optimise(&["simulate", "--plan", &plan_there]).code, 0);
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
