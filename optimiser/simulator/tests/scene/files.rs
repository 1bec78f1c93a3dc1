//! Scene files that are no scene files.

use std::fs;
use std::path::Path;

use powderline_simulator::scene::{Scene, embedded_scene};

fn refusal(path: &Path) -> String {
    Scene::load(path.to_str().unwrap()).expect_err("the file should be refused").to_string()
}

#[test]
fn a_mistyped_name_lists_the_embedded_scenes() {
    assert_eq!(
        Scene::load("bnch").unwrap_err().to_string(),
        "there is no scene and no file called `bnch`; the embedded scenes are bench, bench-small, bench-fine, vial, workcell; did you mean \
         `bench`?"
    );
    assert_eq!(
        Scene::load("kitchen").unwrap_err().to_string(),
        "there is no scene and no file called `kitchen`; the embedded scenes are bench, bench-small, bench-fine, vial, workcell"
    );
}

#[test]
fn a_scene_file_loads_like_the_embedded_scene() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mine.toml");
    fs::write(&path, embedded_scene("bench").unwrap()).unwrap();
    assert_eq!(Scene::load(path.to_str().unwrap()).unwrap(), Scene::load("bench").unwrap());
}

#[test]
fn missing_file_and_folder() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("missing.toml");
    assert_eq!(
        refusal(&missing),
        format!("{} cannot be read: No such file or directory (os error 2)", missing.display())
    );
    assert_eq!(
        refusal(folder.path()),
        format!(
            "{} is a folder, not a file; the path of a scene in TOML would be right",
            folder.path().display()
        )
    );
    // That of a run, for one.
    let within = folder.path().join("scene.toml");
    fs::write(&within, "").unwrap();
    assert!(refusal(folder.path()).ends_with(&format!("not a file; {} would be right", within.display())));
}

#[test]
fn empty_binary_and_truncated_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.toml");
    let shown = path.display();
    fs::write(&path, "").unwrap();
    assert_eq!(
        refusal(&path),
        format!("{shown} is empty; a scene in TOML would be right (`optimise new FILE` writes an example)")
    );
    fs::write(&path, [b'a', 0xff, 0xfe, 0x00]).unwrap();
    assert_eq!(
        refusal(&path),
        format!("{shown} is not a text file: byte 1 is not valid UTF-8; a scene in TOML would be right")
    );
    let (whole, last) = (Scene::load("bench").unwrap().to_toml(), "poissons_ratio = ");
    let cut = &whole[..whole.find(last).unwrap() + last.len()];
    fs::write(&path, cut).unwrap();
    assert_eq!(
        refusal(&path),
        format!(
            "{shown} is not valid TOML at line {}, column {}: string values must be quoted, expected literal string",
            cut.lines().count(),
            last.len() + 1
        )
    );
}

#[test]
fn a_gigabyte_is_refused_unread() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("huge.toml");
    // A file with a hole: it takes no space and, were it read, a second.
    fs::File::create(&path).unwrap().set_len(1_000_000_000).unwrap();
    assert_eq!(
        refusal(&path),
        format!("{} holds 1000000000 bytes, but a scene has at most 1048576 bytes", path.display())
    );
}
