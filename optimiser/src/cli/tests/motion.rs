//! Which motion it is, and what is the matter with it.

use super::*;
use powderline_simulator::scene::{Gate, GateOpening, GateShape, Obstacle};

/// A finished run of a scene that is no embedded one.
fn run_of_ones_own(place: &Place) -> String {
    let mut scene = Scene::load("bench-small").unwrap().into_spec();
    scene.name = "my bench".into();
    fs::write(place.path("mine.toml"), scene.to_toml()).unwrap();
    let folder = place.text("run");
    let done = optimise(&[&place.text("mine.toml"), "--seed", "4", "--epochs", "1", "--out", &folder]);
    assert!(done.is_finished(), "{}", done.err);
    folder
}

#[test]
fn a_plan_moved_from_its_folder_says_which_scene_is_missing() {
    let place = Place::new();
    let folder = run_of_ones_own(&place);
    let moved = place.text("moved.plan");
    fs::copy(format!("{folder}/{PLAN}"), &moved).unwrap();
    let digest = Scene::load(&place.text("mine.toml")).unwrap().digest();
    let about = format!(
        "the scene that {moved} was made for (digest {}) is not beside it, nor is it an embedded one; the scene.toml of its run \
         would be right, beside it or as SCENE, as in `optimise simulate SCENE --plan {moved}`",
        hex(&digest[..4])
    );
    assert_sentence(&optimise(&["simulate", "--plan", &moved]), 2, &about);
    assert_sentence(&optimise(&["render", "--plan", &moved]), 2, &about);
    assert_eq!(optimise(&["simulate", &format!("{folder}/{SCENE}"), "--plan", &moved]).code, 0);
    // That of another run beside it is not taken for it.
    fs::write(place.path(SCENE), Scene::load("bench").unwrap().to_toml()).unwrap();
    assert_sentence(&optimise(&["simulate", "--plan", &moved]), 2, "scene.toml (digest");
    fs::copy(format!("{folder}/{SCENE}"), place.path(SCENE)).unwrap();
    assert_eq!(optimise(&["simulate", "--plan", &moved]).code, 0);
}

#[test]
fn a_moved_plan_of_an_embedded_scene_needs_no_scene() {
    let place = Place::new();
    let plan = format!("{}/{PLAN}", place.finished("run", 1));
    let alone = place.text("alone.plan");
    fs::copy(&plan, &alone).unwrap();
    let [there, here] = [&plan, &alone].map(|plan| {
        let done = optimise(&["simulate", "--plan", plan, "--json"]);
        let mut report: Value = serde_json::from_str(&done.out).unwrap();
        report["seconds"].take();
        report
    });
    assert_eq!(there, here);
    // Nor does that of another run beside it do harm.
    fs::write(place.path(SCENE), Scene::load("bench").unwrap().to_toml()).unwrap();
    assert_eq!(optimise(&["simulate", "--plan", &alone]).code, 0);
    // But what is named is meant.
    assert_sentence(
        &optimise(&["simulate", "bench", "--plan", &plan]),
        2,
        "made for another scene than bench",
    );
}

#[test]
fn a_skill_through_a_wall_is_said_first() {
    let place = Place::new();
    let mut scene = Scene::load("bench-small").unwrap().into_spec();
    scene.skill.lift_height_m[0] = 0.010;
    let file = place.text("low.toml");
    fs::write(&file, scene.to_toml()).unwrap();
    let (theta, collision) =
        powderline_simulator::skill::colliding_skill(&scene.validate().unwrap()).unwrap();
    let through = format!("--theta={}", theta.components().map(|x| x.to_string()).join(","));
    let Obstacle::Container(container) = collision.obstacle.clone() else { panic!("{collision}") };
    let sentence = format!("{collision}: the simulated tool can do that, an arm cannot");

    let done = optimise(&["simulate", &file, &through]);
    assert_eq!(done.code, 0, "{}", done.err);
    assert_eq!(done.out.lines().next().unwrap(), format!("Warning: {sentence}."));
    assert!(done.out.lines().nth(1).unwrap().starts_with("bench-small, seed 1"), "{}", done.out);
    let report: Value =
        serde_json::from_str(&optimise(&["simulate", &file, &through, "--json"]).out).unwrap();
    let found = &report["collision"];
    assert_eq!(
        (&found["container"], &found["sentence"]),
        (&Value::from(container), &Value::from(sentence.clone()))
    );
    assert_eq!((&found["part"], found["at_s"].as_f64()), (&"body".into(), Some(collision.at_s)));

    // Whoever only wants pictures is told as well.
    let pictures = place.text("pictures");
    let done = optimise(&["render", &file, &through, "--size", "64x48", "--at", "0", "--out", &pictures]);
    assert_eq!(done.code, 0, "{}", done.err);
    assert_eq!(done.err.trim_end(), format!("Warning: {sentence}."));

    let high = optimise(&["simulate", &file, "--theta", "0,0,1,0,0", "--json"]);
    assert!(serde_json::from_str::<Value>(&high.out).unwrap()["collision"].is_null());
    assert!(!optimise(&["simulate", &file, "--theta", "0,0,1,0,0"]).out.contains("Warning"));
}

#[test]
fn a_skill_through_a_gate_is_said_and_one_after_it_has_opened_is_not() {
    let place = Place::new();
    let mut scene = Scene::load("bench-small").unwrap().into_spec();
    scene.gates = vec![Gate {
        name: "lock".into(),
        position_m: [0.084, 0.032, 0.0],
        yaw_deg: 0.0,
        friction: 0.4,
        opens_at_s: 9.0,
        shape: GateShape::Box { size_m: [0.004, 0.060, 0.120] },
        opening: GateOpening::Vanish {},
    }];
    let mut collision = |opens_at_s: f64| {
        scene.gates[0].opens_at_s = opens_at_s;
        let file = place.text("lock.toml");
        fs::write(&file, scene.to_toml()).unwrap();
        let done = optimise(&["simulate", &file, "--theta", "0,0,0,0,0", "--json"]);
        assert_eq!(done.code, 0, "{}", done.err);
        serde_json::from_str::<Value>(&done.out).unwrap()["collision"].clone()
    };
    let found = collision(9.0);
    assert_eq!((&found["gate"], &found["container"]), (&"lock".into(), &Value::Null));
    let sentence = found["sentence"].as_str().unwrap();
    assert!(sentence.starts_with("the tool's body would pass through gate \"lock\" at "), "{sentence}");
    assert!(collision(found["at_s"].as_f64().unwrap() - 0.05).is_null());
}
