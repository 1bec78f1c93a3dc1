//! `optimise check` as a program.

use std::process::{Command, Output};

use powderline_simulator::scene::{Scene, SceneSpec};
use serde_json::Value;

fn optimise(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_optimise")).args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

#[test]
fn checks_the_default_scene() {
    let output = optimise(&["check"]);
    assert_eq!(output.status.code(), Some(0));
    assert!(text(&output.stdout).starts_with("bench is a valid scene.\n"));
    assert_eq!(text(&output.stderr), "");
}

#[test]
fn json_is_one_object_and_nothing_else() {
    let output = optimise(&["check", "bench-small", "--json"]);
    assert_eq!(output.status.code(), Some(0));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["particles"], 2772);
    assert_eq!(report["cells"], serde_json::json!([44, 16, 32]));
    assert_eq!(report["horizon_steps"], 330);
    assert_eq!(report["memory"].as_array().unwrap().len(), 8);
    assert_eq!(report["digest"].as_str().unwrap().len(), 64);
    assert_eq!(text(&output.stdout).lines().count(), 1);
}

#[test]
fn a_bad_scene_is_one_sentence_on_standard_error_and_exit_code_2() {
    let sentence = "there is no scene and no file called `bnch`; the embedded scenes are bench, bench-small, bench-fine, vial, workcell; did \
                    you mean `bench`?";
    for (arguments, out) in [
        (&["check", "bnch"][..], String::new()),
        (&["check", "bnch", "--json"], format!("{{\"error\":\"{sentence}\",\"exit_code\":2}}\n")),
    ] {
        let output = optimise(arguments);
        assert_eq!(output.status.code(), Some(2));
        assert_eq!((text(&output.stdout), text(&output.stderr)), (out, format!("{sentence}\n")));
    }
}

#[test]
fn skills_that_take_the_tool_through_a_wall_are_noted() {
    let mut scene = Scene::load("bench-small").unwrap().into_spec();
    scene.skill.lift_height_m[0] = 0.010;
    let file = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("low-lift.toml");
    std::fs::write(&file, scene.to_toml()).unwrap();
    let output = optimise(&["check", file.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0));
    let said = text(&output.stdout);
    let note = said.lines().find(|line| line.contains("would pass over")).unwrap();
    assert!(note.starts_with("Note: ") && note.contains("through container \"target\" at "), "{note}");
    for scene in ["bench", "bench-small", "bench-fine", "vial", "workcell"] {
        // Of what comes along only the cells are worth a note.
        let said = text(&optimise(&["check", scene]).stdout);
        let notes: Vec<&str> = said.lines().filter(|line| line.starts_with("Note: ")).collect();
        assert!(matches!(notes[..], [cells] if cells.contains(" cells in radius")), "{scene}: {notes:?}");
    }
}

#[test]
fn what_the_arm_can_do_is_said_and_what_it_cannot_is_refused() {
    let said = text(&optimise(&["check", "bench"]).stdout);
    let arm = said.lines().find(|line| line.starts_with("arm ")).unwrap();
    assert!(arm.contains("UR5e reaches forward, elbow up") && arm.contains("mm from the table at"), "{arm}");
    let checked = |name: &str, change: fn(&mut SceneSpec)| {
        let mut scene = Scene::load("bench").unwrap().into_spec();
        change(&mut scene);
        let file = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        std::fs::write(&file, scene.to_toml()).unwrap();
        let output = optimise(&["check", file.to_str().unwrap()]);
        (output.status.code(), text(&output.stdout) + &text(&output.stderr))
    };
    let (code, said) = checked("far.toml", |scene| scene.arm.as_mut().unwrap().base_position_m[1] = -2.0);
    assert_eq!(code, Some(2));
    assert!(
        said.contains("the UR5e of [arm] can make no motion of [skill]") && said.contains("mm nearer"),
        "{said}"
    );
    // Near the end of its reach it makes the shorter transports only.
    let (code, said) = checked("edge.toml", |scene| {
        scene.arm.as_mut().unwrap().base_position_m[1] = -1.04;
    });
    assert_eq!(code, Some(0));
    let note = said.lines().find(|line| line.contains("would pass over")).unwrap_or_else(|| panic!("{said}"));
    assert!(note.starts_with("Note: ") && note.contains("the arm cannot make the motion: at "), "{note}");
    let (code, said) = checked("none.toml", |scene| scene.arm = None);
    assert!(code == Some(0) && said.contains("Note: the scene has no [arm]"), "{said}");
}

#[test]
fn unknown_arguments_are_bad_input() {
    assert_eq!(optimise(&["check", "--jsn"]).status.code(), Some(2));
}
