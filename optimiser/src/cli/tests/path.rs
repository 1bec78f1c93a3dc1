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
