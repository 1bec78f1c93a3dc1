//! Reading a scene: by name, from a file, from text.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::{EMBEDDED_SCENES, Scene, SceneError, closest_match::did_you_mean, embedded, parse::parse};

/// A scene file longer than this is refused without being read, bytes.
pub const MAX_SCENE_BYTES: u64 = 1 << 20;

impl Scene {
    /// Loads an embedded scene by name (`bench`, `bench-small`, `bench-fine`, `vial`, `workcell`) or a scene file by path.
    ///
    /// A name wins over a file of the same name in the working folder; write `./bench` for the file.
    ///
    /// # Errors
    /// A [`SceneError`] that names the file and what would be right.
    pub fn load(path_or_name: &str) -> Result<Self, SceneError> {
        match embedded::embedded_scene(path_or_name) {
            Some(text) => Self::from_toml(path_or_name, text),
            None => Self::from_toml(path_or_name, &read_text(path_or_name)?),
        }
    }

    /// Reads and validates a scene from TOML. `source_name` stands for the file in messages.
    ///
    /// # Errors
    /// A [`SceneError`] that names the field, its value and what would be right.
    pub fn from_toml(source_name: &str, text: &str) -> Result<Self, SceneError> {
        if text.lines().all(|line| line.trim_start().is_empty() || line.trim_start().starts_with('#')) {
            return Err(SceneError::Empty { file: source_name.to_owned() });
        }
        parse(source_name, text)?.validate_as(source_name)
    }
}

fn read_text(path: &str) -> Result<String, SceneError> {
    let file = || path.to_owned();
    let unreadable =
        |error: std::io::Error| SceneError::Unreadable { file: file(), reason: error.to_string() };
    // A bare word that is no file was meant as the name of a scene.
    if !Path::new(path).exists() && !path.contains(['/', '\\', '.']) {
        let meant = did_you_mean(path, EMBEDDED_SCENES.map(|(name, _)| name));
        return Err(SceneError::UnknownName { name: file(), known: embedded::known_names(), meant });
    }
    let metadata = std::fs::metadata(path).map_err(unreadable)?;
    let not_a_file = |what| {
        let within = Path::new(path).join("scene.toml");
        let right = match within.is_file() {
            true => within.display().to_string(),
            false => "the path of a scene in TOML".to_owned(),
        };
        Err(SceneError::NotAFile { file: file(), what, right })
    };
    if metadata.is_dir() {
        return not_a_file("a folder");
    }
    if !metadata.is_file() {
        return not_a_file("a pipe or a device");
    }
    let too_large = |bytes| SceneError::TooLarge { file: file(), bytes, limit: MAX_SCENE_BYTES };
    if metadata.len() > MAX_SCENE_BYTES {
        return Err(too_large(metadata.len()));
    }
    let mut bytes = Vec::new();
    // The file may have grown since it was measured.
    File::open(path)
        .and_then(|opened| opened.take(MAX_SCENE_BYTES + 1).read_to_end(&mut bytes))
        .map_err(unreadable)?;
    if bytes.len() as u64 > MAX_SCENE_BYTES {
        return Err(too_large(bytes.len() as u64));
    }
    String::from_utf8(bytes)
        .map_err(|error| SceneError::NotText { file: file(), offset: error.utf8_error().valid_up_to() })
}
