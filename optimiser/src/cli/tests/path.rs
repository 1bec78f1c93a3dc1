//! Runs whose motions are paths near a skill.

use super::*;

#[test]
fn a_path_is_found_shipped_told_apart_from_a_skill_and_gone_on_with_to_the_same_bits() {
    let place = Place::new();
    let run = |name: &str, epochs: &str, patience: u64| {
        let folder = place.text(name);
        let arguments = ["--method", "path", "--epochs", epochs, "--patience", "0", "--out", &folder];
        let done = optimise_for(patience, &[&["bench-small"][..], &arguments].concat());
        (folder, done)
    };
    let (folder, done) = run("whole", "22", u64::MAX);
    assert!(done.is_finished(), "{}", done.err);
    let turn = "  near the best skill, by splines that are added to its motion:";
    assert_eq!(done.err.matches(turn).count(), 1, "{}", done.err);
    let epochs = metrics(&folder);
    let is_path = |epoch: &&Value| !epoch["splines"].is_null();
    let (skills, paths): (Vec<_>, Vec<_>) = epochs.iter().partition(|epoch| !is_path(epoch));
    assert!(skills.len() > 8 && paths.len() > 5, "{} {}", skills.len(), paths.len());
    assert_eq!(paths[0]["splines"]["coefficients"].as_array().unwrap().len(), 36);
    let lowest = |epochs: &[&Value]| {
        epochs.iter().map(|epoch| epoch["loss"].as_f64().unwrap()).fold(f64::INFINITY, f64::min)
    };
    assert!(lowest(&paths) < lowest(&skills), "{} {}", lowest(&paths), lowest(&skills));
    let shipped = epochs.iter().find(|epoch| epoch["shipped"] == true).unwrap();
    assert!(
        is_path(&shipped) && done.out.contains("36 numbers say how it leaves the skill's"),
        "{}",
        done.out
    );
    // What the plan says of itself.
    let plan = format!("{folder}/skill.plan");
    let inspected = optimise(&["inspect", &plan]);
    assert!(inspected.out.contains("not this skill's own, but a path near it"), "{}", inspected.out);
    let simulated = optimise(&["simulate", "--plan", &plan]);
    assert!(simulated.code == 0, "{}", simulated.out);
    let skill = place.finished("skill", 3);
    let inspected = optimise(&["inspect", &format!("{skill}/skill.plan"), "--json"]);
    assert!(inspected.out.contains("\"path_coefficients\":0"), "{}", inspected.out);
    // Ended in the middle of the path, again and again.
    let (stopped, done) = run("stopped", "22", 150);
    assert_eq!(done.code, 130, "{}", done.err);
    while optimise_for(150, &["--resume", &stopped]).code == 130 {}
    assert_eq!(metrics(&stopped), epochs);
    assert_eq!(bytes(&stopped, "skill.plan"), bytes(&folder, "skill.plan"));
}

/// A search that has gained nothing for long as a skill begins its path all the same, and that has its patience, too.
#[test]
fn a_path_begins_before_patience_ends() {
    let place = Place::new();
    for patience in ["1", "2"] {
        let folder = place.text(patience);
        let search =
            ["bench-small", "--method", "path", "--no-refine", "--patience", patience, "--out", &folder];
        assert!(optimise(&search).is_finished());
        let paths = metrics(&folder).iter().filter(|epoch| !epoch["splines"].is_null()).count();
        assert!(paths > patience.parse().unwrap(), "{paths} after a patience of {patience}");
    }
}

/// Where powder escapes there is no gradient, and the search goes on without: to its plan, and to the same bits if it is stopped.
#[test]
fn a_motion_that_the_adjoint_cannot_follow_does_not_end_the_run() {
    let place = Place::new();
    let scene = Scene::load("bench-small").unwrap().with(|spec| spec.name = LEAKY.into()).unwrap();
    fs::write(place.path("leaky.toml"), scene.to_toml()).unwrap();
    let (file, [whole, stopped]) =
        (place.text("leaky.toml"), ["whole", "stopped"].map(|name| place.text(name)));
    let search = [&file, "--method", "path", "--epochs", "22", "--patience", "0", "--no-refine", "--out"];
    let done = optimise(&[&search[..], &[&whole]].concat());
    assert!(done.is_finished(), "{}", done.err);
    let tries = fs::read_to_string(format!("{whole}/tries.jsonl")).unwrap();
    let tries = tries.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let (known, lost): (Vec<_>, Vec<_>) =
        tries.filter(|line| !line["adjoint"].is_null()).partition(|line| !line["gradient"].is_null());
    assert!(known.len() > 2 && lost.len() > 2, "{} {}", known.len(), lost.len());
    let mut done = optimise_for(150, &[&search[..], &[&stopped]].concat());
    while done.code == 130 {
        done = optimise_for(150, &["--resume", &stopped]);
    }
    assert_eq!(bytes(&stopped, "skill.plan"), bytes(&whole, "skill.plan"));
}
