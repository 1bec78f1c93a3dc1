//! `optimise shorten`.

use super::{Done, MISSED, Place, assert_sentence, bytes, optimise, optimise_for};
use powderline_shared::plan::{PlanHeader, PlanReader};
use powderline_simulator::scene::{Scene, SceneSpec};
use serde_json::Value;
use std::fs;

fn shortened(place: &Place, plan: &str, out: &str, patience: u64) -> Done {
    optimise_for(patience, &["shorten", plan, "--out", &place.text(out), "--json"])
}

fn header(place: &Place, folder: &str) -> PlanHeader {
    *PlanReader::new(&bytes(&place.text(folder), "skill.plan")).unwrap().header()
}

#[test]
fn a_plan_is_made_as_fast_as_the_powder_on_the_tool_bears() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.finished("run", 12));
    let done = shortened(&place, &plan, "at-once", u64::MAX);
    assert!([0, MISSED].contains(&done.code), "{}", done.err);
    let report: Value = serde_json::from_str(&done.out).unwrap();
    let number = |field: &str| report[field].as_f64().unwrap();
    // Of the tool's speeds that are looked at, all above this one are too much.
    assert_eq!(report["haste"], serde_json::json!({"overlap": 1.0, "linear": 1.0, "angular": 0.75}));
    assert!(number("duration_s") < number("duration_before_s") - 0.2, "{report}");
    // Nobody looks at smaller cells, so nothing is simulated twice.
    let tried = report["tried"].as_array().unwrap().len() as u64;
    let simulated: u64 = report["rollouts"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).sum();
    assert_eq!(simulated, if tried == 1 { 1 } else { tried + 10 }, "{report}");
    let saved_s = number("plan_before_s") - number("plan_s");
    assert!((saved_s - (number("duration_before_s") - number("duration_s"))).abs() < 0.0101, "{report}");
    // The plan is one of its own scene, and every command takes it.
    let scene = Scene::from_toml(
        "scene.toml",
        &String::from_utf8(bytes(&place.text("at-once"), "scene.toml")).unwrap(),
    );
    let (scene, header) = (scene.unwrap(), header(&place, "at-once"));
    assert_eq!((header.scene_digest, header.step_count), (scene.digest(), scene.time.horizon_steps));
    assert!(header.finer.is_none() && (scene.skill.overlap - 1.0).abs() < 1e-12);
    let plan_there = place.text("at-once") + "/skill.plan";
    let again = optimise(&["simulate", "--plan", &plan_there]);
    assert!(again.code == 0 && again.out.contains("exactly those that the plan predicts"), "{}", again.out);
    // Once more: nothing is simulated. Stopped again and again: the same bytes.
    let again = shortened(&place, &plan, "at-once", 1);
    assert_eq!((again.out, again.code), (done.out, done.code));
    let mut stops = 0;
    loop {
        let done = shortened(&place, &plan, "stopped", 8);
        if done.code != 130 {
            break;
        }
        assert!(done.err.contains("the same command goes on from there"), "{}", done.err);
        stops += 1;
    }
    assert!(
        stops > 2
            && bytes(&place.text("stopped"), "skill.plan") == bytes(&place.text("at-once"), "skill.plan")
    );
    let words = optimise(&["shorten", &plan, "--out", &place.text("at-once")]).out;
    assert!(words.starts_with("The motion takes ") && words.contains("\nThe plan brings "), "{words}");
    assert!(
        words.contains("\nThe skill is as it came")
            || words.contains("\nWith the skill as it came, the faster motion brought ")
    );
    // In the folder of another plan.
    assert_sentence(
        &optimise(&["shorten", &plan_there, "--out", &place.text("at-once")]),
        2,
        "haste.json was begun with plan",
    );
}

#[test]
fn a_plan_that_was_looked_at_on_smaller_cells_is_so_again() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.finished("run", 12));
    optimise(&["refine", &plan]);
    let refined = place.text("run") + "/refined/skill.plan";
    let done = optimise(&["shorten", &refined]);
    assert!([0, MISSED].contains(&done.code), "{}", done.err);
    assert!(done.out.contains("\nOn cells of 2 mm the plan brings "), "{}", done.out);
    let (before, now) = (header(&place, "run/refined"), header(&place, "run/refined/shortened"));
    assert!((now.finer.unwrap().cell_m - 0.002).abs() < 1e-12 && now.step_count < before.step_count);
}

/// What a path adds to its skill's motion goes on being added.
#[test]
fn a_path_is_made_faster_as_the_path_that_it_is() {
    let place = Place::new();
    let folder = place.text("run");
    let search = ["bench-small", "--method", "path", "--no-refine", "--epochs", "22", "--patience", "0"];
    assert!(optimise(&[&search[..], &["--out", &folder]].concat()).is_finished());
    let done = optimise(&["shorten", &format!("{folder}/skill.plan")]);
    assert!([0, MISSED].contains(&done.code), "{}", done.err);
    let (before, now) = (header(&place, "run"), header(&place, "run/shortened"));
    assert!(now.path_coefficients == before.path_coefficients && now.path_coefficients > 0);
    assert!(now.step_count < before.step_count);
    // What was looked at is what is in the plan.
    let again = optimise(&["simulate", "--plan", &format!("{folder}/shortened/skill.plan")]);
    assert!(again.code == 0 && again.out.contains("exactly those that the plan predicts"), "{}", again.out);
}

/// A finished run of `bench-small`, changed, without its arm; and the shortening of its plan.
fn shortening(place: &Place, change: fn(&mut SceneSpec)) -> Done {
    let changed = |spec: &mut SceneSpec| {
        spec.arm = None;
        spec.skill.overlap = 1.0;
        spec.skill.linear_speed_m_s = spec.limits.linear_velocity_m_s / 1.875;
        change(spec);
    };
    let scene = Scene::load("bench-small").unwrap().with(changed).unwrap();
    fs::write(place.path("changed.toml"), scene.to_toml()).unwrap();
    let (file, folder) = (place.text("changed.toml"), place.text("run"));
    let search = ["--method", "mixed", "--no-refine", "--epochs", "3", "--out", &folder];
    assert!(optimise(&[&[file.as_str()][..], &search].concat()).is_finished());
    optimise(&["shorten", &format!("{folder}/skill.plan")])
}

#[test]
fn a_motion_that_is_as_fast_as_it_can_be_stays_and_it_is_said_why() {
    let place = Place::new();
    // The arm could turn the tool twice as fast, but the powder is spilled by that.
    let done = shortening(&place, |spec| spec.limits.angular_velocity_rad_s *= 2.0);
    assert_sentence(&done, 1, "the motion stays as it is: with the least haste that is looked at ");
    assert!(done.err.contains(" are lost, before ") && !place.path("run/shortened/skill.plan").exists());
    let place = Place::new();
    let at_limit =
        |spec: &mut SceneSpec| spec.skill.angular_speed_rad_s = spec.limits.angular_velocity_rad_s / 1.875;
    assert_sentence(
        &shortening(&place, at_limit),
        1,
        "the motion stays as it is: it is as fast as the limits allow; ",
    );
}

/// Looks at the plan as it was, in the same folder, are not those at the faster one; and a run that is not done is left alone.
#[test]
fn what_is_of_another_scene_or_run_is_not_gone_on_with() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.finished("run", 12));
    let out = place.text("both");
    let mut patience = 10;
    while optimise_for(patience, &["refine", &plan, "--out", &out]).code != 130 {
        patience -= 1;
    }
    assert!(place.path("both/looks.json").exists() && !place.path("both/skill.plan").exists());
    let done = optimise(&["shorten", &plan, "--out", &out]);
    assert_sentence(&done, 2, "looks.json was begun with ");
    let stopped = place.text("stopped");
    let search = ["bench-small", "--method", "mixed", "--no-refine", "--epochs", "9", "--out", &stopped];
    assert_eq!(optimise_for(60, &search).code, 130);
    let before = bytes(&stopped, "scene.toml");
    for command in ["shorten", "refine"] {
        let done = optimise(&[command, &plan, "--out", &stopped]);
        assert_sentence(&done, 2, "stopped holds a run of something else; another --out would be right");
    }
    assert_eq!(bytes(&stopped, "scene.toml"), before);
}

/// As by a version that did not look at what this one looks at.
#[test]
fn what_was_seen_before_is_asked_again_whether_the_arm_may_perform_it() {
    let place = Place::new();
    let folder = place.text("run");
    let search = ["run", "bench", "--method", "mixed", "--no-refine", "--epochs", "3", "--out", &folder];
    assert!(optimise(&search).is_finished());
    let plan = format!("{folder}/skill.plan");
    let done = shortened(&place, &plan, "quick", u64::MAX);
    let mut kept: Value = serde_json::from_slice(&bytes(&place.text("quick"), "haste.json")).unwrap();
    let looks = kept["looks"].as_array_mut().unwrap();
    let before = looks[0]["census"].clone();
    let refused = looks.iter_mut().filter(|look| !look["obstacle"].is_null());
    let refused =
        refused.map(|look| (look["obstacle"], look["census"]) = (Value::Null, before.clone())).count();
    assert!(refused > 0, "{kept}");
    fs::create_dir(place.path("again")).unwrap();
    fs::write(place.path("again/haste.json"), kept.to_string()).unwrap();
    let again = shortened(&place, &plan, "again", u64::MAX);
    assert_eq!((again.code, header(&place, "again")), (done.code, header(&place, "quick")));
}
