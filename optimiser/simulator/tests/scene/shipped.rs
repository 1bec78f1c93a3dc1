//! The scenes that come with the program.

use powderline_shared::arm::ArmModel;
use powderline_shared::arm::inverse::Posture;
use powderline_simulator::arm::Mount;
use powderline_simulator::scene::figures::{about, grouped, mass};
use powderline_simulator::scene::{EMBEDDED_SCENES, Elbow, PostureChoice, Scene, Shoulder, ToolShape, Wrist};

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

/// What the reference shows in comments is a gate.
#[test]
fn the_gate_that_the_reference_shows_is_one() {
    let (_, text) = EMBEDDED_SCENES[0];
    let shown = text.lines().skip_while(|line| !line.starts_with("# [[gate]]"));
    let shown: Vec<&str> = shown.map_while(|line| line.strip_prefix("# ")).collect();
    let with_it = format!("{text}\n{}\n", shown.join("\n"));
    let scene = Scene::from_toml("bench", &with_it).unwrap();
    assert_eq!((shown.len(), scene.gates.len()), (12, 1));
    let other = |from: &str, to: &str| Scene::from_toml("bench", &with_it.replacen(from, to, 1)).unwrap();
    // The other kinds, as they stand there.
    let inline = |begins: &str| {
        let start = with_it.find(begins).unwrap();
        with_it[start..].split_inclusive('}').next().unwrap()
    };
    let (tube, plate) = (inline("{ kind = \"tube\""), inline("{ kind = \"box\", size_m"));
    let (vanish, slide) = (inline("{ kind = \"vanish\""), inline("{ kind = \"slide\""));
    assert_ne!(other(&format!("\nshape = {tube}"), &format!("\nshape = {plate}")).gates, scene.gates);
    assert_ne!(other(&format!("\nopening = {vanish}"), &format!("\nopening = {slide}")).gates, scene.gates);
}

/// The arm beside the bench stands in its scene, and with the programs that know no scenes.
#[test]
fn the_simulated_arm_is_that_of_the_bench() {
    let arm = Scene::load("bench").unwrap().into_spec().arm.unwrap();
    let (of_scene, known) = (Mount::of(&arm).model(Posture::PREFERRED[0]), ArmModel::bench());
    let poses = |model: &ArmModel| [model.world_from_base, model.flange_from_tool];
    for (a, b) in poses(&of_scene).iter().zip(&poses(&known)) {
        assert!(a.displacement_to(b).components().iter().all(|off| off.abs() < 1e-15), "{a:?} {b:?}");
    }
}

/// The bench with the arm's keys that the reference shows in comments.
#[test]
fn the_arm_that_the_reference_shows_is_one() {
    let (_, text) = EMBEDDED_SCENES[0];
    let with = text.replacen("# posture = {", "posture = {", 1).replacen(
        "# payload_kg = 0.4",
        "payload_kg = 0.4",
        1,
    );
    let arm = Scene::from_toml("bench", &with).unwrap().into_spec().arm.unwrap();
    let chosen = PostureChoice { shoulder: Shoulder::Forward, elbow: Elbow::Up, wrist: Wrist::Positive };
    assert_eq!((arm.posture, arm.payload_kg), (Some(chosen), Some(0.4)));
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
    assert_eq!(figures("workcell"), (7_168, [334, 334, 100], [88, 88, 29], 444));
}

#[test]
fn the_documentation_tells_the_shipped_scenes_as_they_are() {
    let told = include_str!("../../src/scene/mod.rs").lines().filter(|line| line.starts_with("//! | `"));
    let told: Vec<&str> = told.collect();
    assert_eq!(told.len(), EMBEDDED_SCENES.len());
    for (row, (name, text)) in told.iter().zip(EMBEDDED_SCENES) {
        let scene = Scene::load(name).unwrap();
        let mm = |metres: f64| about(1e3 * metres, 6);
        let tool = match &scene.tool.shape {
            ToolShape::Bowl { inner_radius_m } => format!("bowl, radius {} mm", mm(*inner_radius_m)),
            ToolShape::BoxScoop { inner_size_m } => {
                format!("box scoop, {} mm", inner_size_m.map(mm).join(" x "))
            }
            ToolShape::Cuboids { cuboid } => format!("{} cuboids", cuboid.len()),
        };
        let particles = grouped(scene.particle_count() as i64);
        let is = format!(
            "//! | `{name}` | {particles} of {} | {} mm | {tool} | {} | ",
            mass(scene.particle_mass_kg()),
            mm(scene.domain.cell_m),
            mass(scene.target_mass_kg())
        );
        assert!(row.starts_with(&is), "{row}\nbut it is\n{is}");
        // So do their own remarks.
        assert!(text.contains(&format!("{particles} particles")), "{name}");
    }
}
