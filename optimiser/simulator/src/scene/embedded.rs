//! The scenes that come with the program.

/// The scene used when none is named.
pub const DEFAULT_SCENE: &str = "bench";

/// Names and TOML texts of the embedded scenes.
pub const EMBEDDED_SCENES: [(&str, &str); 5] = [
    ("bench", include_str!("../../scenes/bench.toml")),
    ("bench-small", include_str!("../../scenes/bench-small.toml")),
    ("bench-fine", include_str!("../../scenes/bench-fine.toml")),
    ("vial", include_str!("../../scenes/vial.toml")),
    ("workcell", include_str!("../../scenes/workcell.toml")),
];

/// TOML text of the embedded scene called `name`.
pub fn embedded_scene(name: &str) -> Option<&'static str> {
    EMBEDDED_SCENES.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// Names of the embedded scenes, for messages.
pub(super) fn known_names() -> String {
    EMBEDDED_SCENES.map(|(name, _)| name).join(", ")
}
