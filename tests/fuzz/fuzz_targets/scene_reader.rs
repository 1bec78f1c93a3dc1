//! A scene with anything in it: refused in one sentence, or read, written and read again to an equal scene. An input that
//! begins with `=` is a list of changes to a shipped scene, so that what comes after the syntax is reached: in each line a
//! character that chooses a field, then what takes the place of its value.
#![no_main]

use libfuzzer_sys::fuzz_target;
use powderline_fuzz::{assert_sentence, plant};
use powderline_simulator::scene::{EMBEDDED_SCENES, Scene, embedded_scene};

fuzz_target!(init: plant(seeds()), |bytes: &[u8]| {
    // Files that are no text are refused before.
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match text.strip_prefix('=') {
        None => check(text),
        Some(changes) => check(&changed(changes)),
    }
});

fn check(text: &str) {
    let scene = match Scene::from_toml("scene.toml", text) {
        Ok(scene) => scene,
        Err(error) => return assert_sentence(&error),
    };
    let again = Scene::from_toml("again.toml", &scene.to_toml());
    assert_eq!(again.as_ref(), Ok(&scene));
    assert_eq!(again.map(|scene| scene.digest()), Ok(scene.digest()));
    scene.warnings().iter().for_each(assert_sentence);
}

/// `bench-small` with some of its values replaced.
fn changed(changes: &str) -> String {
    let mut lines: Vec<String> =
        embedded_scene("bench-small").expect("it is shipped").lines().map(str::to_owned).collect();
    let values: Vec<usize> = (0..lines.len()).filter(|line| lines[*line].contains(" = ")).collect();
    for change in changes.lines() {
        let mut rest = change.chars();
        let Some(choice) = rest.next() else { continue };
        let line = &mut lines[values[choice as usize % values.len()]];
        let name = line.split(" = ").next().unwrap_or_default();
        *line = format!("{name} = {}", rest.as_str());
    }
    lines.join("\n")
}

/// The shipped scenes without comments, and each value of one of them replaced by itself.
fn seeds() -> Vec<Vec<u8>> {
    let plain = |text: &str| -> String {
        text.lines().filter(|line| !line.starts_with('#')).map(|line| line.to_owned() + "\n").collect()
    };
    let base = plain(include_str!("../../../optimiser/simulator/tests/scene/base.toml"));
    let scenes = EMBEDDED_SCENES.map(|(_, text)| plain(text));
    let values: Vec<&str> =
        scenes[1].lines().filter_map(|line| line.split_once(" = ")).map(|(_, value)| value).collect();
    let choices = (b' '..).map(char::from).take(values.len());
    let changes: Vec<String> =
        choices.map(|choice| format!("{choice}{}", values[choice as usize % values.len()])).collect();
    let all = format!("={}", changes.join("\n"));
    let single = changes.into_iter().map(|change| format!("={change}"));
    scenes.iter().cloned().chain([base, all]).chain(single).map(String::into_bytes).collect()
}
