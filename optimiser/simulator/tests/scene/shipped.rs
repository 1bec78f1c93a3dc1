//! The scenes that come with the program.

use powderline_simulator::scene::{EMBEDDED_SCENES, Scene};

#[test]
fn shipped_scenes_are_valid_and_round_trip() {
    for (name, _) in EMBEDDED_SCENES {
        let scene = Scene::load(name).unwrap();
        assert_eq!(scene.name, name);
        let again = Scene::from_toml("again", &scene.to_toml()).unwrap();
        assert_eq!(again, scene);
        assert_eq!(again.digest(), scene.digest());
    }
}

#[test]
fn figures_of_the_shipped_scenes() {
    let figures = |name| {
        let scene = Scene::load(name).unwrap();
        (scene.particle_count(), scene.cell_counts(), scene.block_counts(), scene.target_count())
    };
    assert_eq!(figures("bench"), (11_264, [64, 24, 52], [20, 10, 17], 1200));
    assert_eq!(figures("bench-small"), (2_772, [44, 16, 32], [15, 8, 12], 200));
    assert_eq!(figures("bench-fine"), (90_112, [128, 48, 104], [36, 16, 30], 9_600));
    assert_eq!(figures("vial"), (7_168, [55, 22, 42], [18, 10, 15], 478));
}
