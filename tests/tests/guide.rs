//! What the guide has a reader write.

use powderline_simulator::scene::{ContainerShape, FillShape, GateOpening, GateShape, Scene, embedded_scene};
use powderline_simulator::skill::{SkillMap, Theta, collision};

const GUIDE: &str = include_str!("../../optimiser/guide/scenes.md");

/// Its pieces of TOML.
fn blocks() -> Vec<&'static str> {
    GUIDE.split("```toml\n").skip(1).map(|rest| rest.split("```").next().unwrap()).collect()
}

#[test]
fn the_silo_of_the_guide_is_a_scene() {
    let silo = blocks()[2];
    let (low, high) = ("fill_min_m = [0.160, 0.032, 0.124]", "fill_max_m = [0.192, 0.064, 0.164]");
    assert!(GUIDE.contains(&format!("`{low}`")) && GUIDE.contains(&format!("`{high}`")));
    let changed = |line: &'static str| match line.split(" =").next() {
        Some("fill_min_m") => low,
        Some("fill_max_m") => high,
        Some("fill_shape") => "fill_shape = \"cylinder\"",
        _ => line,
    };
    let text: Vec<&str> = embedded_scene("bench").unwrap().lines().map(changed).collect();
    let scene = Scene::from_toml("silo.toml", &format!("{}\n{silo}", text.join("\n"))).unwrap();
    assert_eq!((scene.containers.len(), scene.gates.len()), (3, 1));

    // The hopper in its place.
    let (_, after) = GUIDE.split_once("A hopper has a cone").unwrap();
    let code = |key: &str| after.split('`').find(|code| code.starts_with(key)).unwrap();
    let changed = |line: &'static str| match line {
        line if line == low => code("fill_min_m"),
        line if line == high => code("fill_max_m"),
        "position_m = [0.176, 0.048, 0.116]" => code("position_m"),
        line if line.starts_with("shape = { kind = \"silo\"") => code("shape"),
        line => line,
    };
    let hopper: Vec<&str> = text.into_iter().chain(silo.lines()).map(changed).collect();
    let scene = Scene::from_toml("hopper.toml", &hopper.join("\n")).unwrap();
    assert!(matches!(scene.containers[2].shape, ContainerShape::Hopper { .. }));
    let heights_m = [scene.gates[0].position_m[2], scene.powder.fill_min_m[2]];
    assert!((heights_m[0] - 0.120).abs() < 1e-12 && (heights_m[1] - 0.140).abs() < 1e-12, "{heights_m:?}");
}

#[test]
fn the_slotted_box_of_the_guide_is_a_scene() {
    let silo = blocks()[2];
    let (_, after) = GUIDE.split_once("A box has a slot").unwrap();
    let mut shapes = after.split('`').filter(|code| code.starts_with("shape = "));
    let opening = after.split('`').find(|code| code.starts_with("opening = ")).unwrap();
    let mut changed = |line: &'static str| match line.split(" =").next() {
        Some("shape") => shapes.next().unwrap(),
        Some("opening") => opening,
        _ => line,
    };
    let slotted: Vec<&str> = silo.lines().map(&mut changed).collect();
    let text = format!("{}\n{}", embedded_scene("bench").unwrap(), slotted.join("\n"));
    let scene = Scene::from_toml("slotted.toml", &text).unwrap();
    let Some(ContainerShape::SlottedBox { inner_size_m, slot_width_m }) =
        scene.containers.get(2).map(|c| &c.shape)
    else {
        panic!("{:?}", scene.containers)
    };
    let GateShape::Box { size_m } = scene.gates[0].shape else { panic!("{:?}", scene.gates) };
    assert!(size_m[0] > *slot_width_m && size_m[1] > inner_size_m[1], "{size_m:?}");
    // Open, it leaves the slot free.
    let GateOpening::Slide { velocity_m_s, travel_m } = scene.gates[0].opening else {
        panic!("{:?}", scene.gates)
    };
    assert!(velocity_m_s[0] > 0.0 && travel_m > 0.5 * (size_m[0] + slot_width_m), "{travel_m}");
}

#[test]
fn the_column_of_the_guide_is_a_scene() {
    let blocks = blocks();
    let [lines, gate, _] = blocks[..] else { panic!("{blocks:?}") };
    let key = |line: &str| line.split(" =").next().unwrap_or_default().to_owned();
    let changed = |line: &str| lines.lines().find(|new| key(new) == key(line)).unwrap_or(line).to_owned();
    let bench = embedded_scene("bench").unwrap();
    let text: Vec<String> = bench.lines().map(changed).collect();
    let scene = Scene::from_toml("column.toml", &format!("{}\n{gate}", text.join("\n"))).unwrap();
    assert_eq!((scene.gates.len(), scene.powder.fill_shape), (1, FillShape::Cylinder));
    assert_eq!(text.iter().zip(bench.lines()).filter(|(new, old)| new != old).count(), lines.lines().count());
    // The pipe is out of the spoon's way by then.
    let map = SkillMap::new(&scene);
    let motion = map.quantise(&Theta::MIDDLE).unwrap().controls;
    assert_eq!(collision(&scene, map.start_pose(), &motion), None);
    let shut = scene.with(|spec| spec.gates[0].opens_at_s = 9.0).unwrap();
    assert!(collision(&shut, map.start_pose(), &motion).is_some());
}
