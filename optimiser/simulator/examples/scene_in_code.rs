//! A bench that is built in code, not read from a file: `cargo run --release -p powderline-simulator --example scene_in_code`.

use powderline_simulator::rollout::{Simulate, Simulator, SimulatorSettings};
use powderline_simulator::scene::{ContainerShape, Scene};
use powderline_simulator::skill::Theta;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // What is not said is taken from a scene that exists. All is checked together, as a file is when it is read: the error says
    // field by field what is wrong and what would be right.
    let bench = Scene::load("bench-small")?;
    let scene = bench.with(|spec| {
        spec.name = "a finer powder and a beaker".to_owned();
        spec.powder.density_kg_m3 = 620.0;
        spec.powder.friction_angle_deg = 32.0;
        // Waves are faster in light powder.
        spec.time.substeps = 24;
        for target in spec.containers.iter_mut().filter(|one| one.name == bench.objective.target) {
            target.shape = ContainerShape::Cylinder { inner_radius_m: 0.018, inner_height_m: 0.02 };
        }
    })?;

    let capacity = scene.tool_capacity();
    let [level_g, heaped_g] = [capacity.level_kg, capacity.heaped_kg].map(|kg| 1e3 * kg);
    println!("the tool holds {level_g:.2} g level, {heaped_g:.2} g heaped");
    let mut simulator = Simulator::<f32>::new(&scene, &SimulatorSettings::default())?;
    let found = simulator.evaluate(&Theta::new([0.5, -0.5, 0.0, 0.0, 0.3])?)?;
    println!("{} particles arrive, {} are lost", found.census.target, found.census.lost());
    Ok(())
}
