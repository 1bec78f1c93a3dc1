//! A bench that is built in code, not read from a file: `cargo run --release -p powderline-simulator --example scene_in_code`.

use powderline_simulator::rollout::{Evaluate, Simulator, SimulatorSettings};
use powderline_simulator::scene::{Container, ContainerShape, Scene, ToolShape};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Every field is public; what is not said is taken from a scene that exists.
    let mut scene = Scene::load("bench-small")?;
    scene.name = "a finer powder and a beaker".to_owned();
    scene.powder.density_kg_m3 = 620.0;
    scene.powder.friction_angle_deg = 32.0;
    // Waves are faster in light powder.
    scene.time.substeps = 24;
    let target = scene.containers.iter_mut().find(|one| one.name == scene.objective.target);
    let target = target.ok_or("the scene has no target")?;
    *target = Container {
        shape: ContainerShape::Cylinder { inner_radius_m: 0.018, inner_height_m: 0.02 },
        ..target.clone()
    };
    if let ToolShape::Bowl { inner_radius_m } = &scene.tool.shape {
        println!("a bowl of {} mm", 1e3 * inner_radius_m);
    }
    // As a file is checked when it is read: one sentence says what is wrong and what would be right.
    scene.validate("the bench of this example")?;

    let capacity = scene.tool_capacity();
    println!(
        "the tool holds {:.2} g level, {:.2} g heaped",
        1e3 * capacity.level_kg,
        1e3 * capacity.heaped_kg
    );
    let mut simulator = Simulator::<f32>::new(&scene, &SimulatorSettings::default())?;
    let found = simulator.evaluate(&[0.5, -0.5, 0.0, 0.0, 0.3], false, &mut |_, _| true)?;
    println!("{} particles arrive, {} are lost", found.census.target, found.census.lost());
    Ok(())
}
