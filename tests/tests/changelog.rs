//! What the changelog says of formats.

use powderline_shared::{plan, trajectory, wire::message::PROTOCOL_VERSION};
use powderline_simulator::{PHYSICS_VERSION, scene::DIGEST_VERSION};

#[test]
fn the_versions_in_the_changelog_are_those_of_the_code() {
    let text = include_str!("../../CHANGELOG.md");
    for (what, version) in [
        ("plan (`skill.plan`)", u32::from(plan::FORMAT_VERSION)),
        ("executed motion (`--executed`)", trajectory::FORMAT_VERSION),
        ("wire (`shared/PROTOCOL.md`)", u32::from(PROTOCOL_VERSION)),
        ("scene: the form that its digest is taken of", DIGEST_VERSION),
        ("`state` of a run: the physics that its epochs were simulated with", PHYSICS_VERSION),
    ] {
        assert!(text.contains(&format!("\n| {what} | {version} |")), "{what} is of version {version}");
    }
}
