//! A custom tool shape, put together from cuboids: `cargo run --release -p powderline-simulator --example tool_of_cuboids`.

use powderline_simulator::rollout::{Simulate, Simulator, SimulatorSettings};
use powderline_simulator::scene::{Cuboid, Scene, ToolShape};
use powderline_simulator::skill::Theta;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let bench = Scene::load("bench-small")?;
    // Two plates that lean against each other, and a rear wall; open at the front (+x) and the top (+z).
    let wall_m = bench.tool.wall_thickness_m;
    let plate = |side: f64| Cuboid {
        centre_m: [0.0, side * 0.0055, -0.0055],
        size_m: [0.022, 0.016, wall_m],
        rotation_deg: [side * 45.0, 0.0, 0.0],
    };
    let rear =
        Cuboid { centre_m: [-0.0115, 0.0, -0.005], size_m: [wall_m, 0.018, 0.014], rotation_deg: [0.0; 3] };
    let scene = bench.with(|spec| {
        spec.name = "a gutter".to_owned();
        spec.tool.shape = ToolShape::Cuboids { cuboid: vec![plate(-1.0), plate(1.0), rear] };
        // It reaches deeper than the bowl.
        spec.skill.scooping_depth_m = [0.002, 0.010];
    })?;

    let capacity = scene.tool_capacity();
    let [level_g, heaped_g] = [capacity.level_kg, capacity.heaped_kg].map(|kg| 1e3 * kg);
    println!("the gutter carries {level_g:.2} g level, {heaped_g:.2} g heaped");
    let mut simulator = Simulator::<f32>::new(&scene, &SimulatorSettings::default())?;
    let found = simulator.evaluate(&Theta::new([0.6, 0.0, 0.0, 0.0, 0.3])?)?;
    let particle_g = 1e3 * scene.particle_mass_kg();
    println!(
        "{:.2} g arrive, {:.2} g are lost",
        f64::from(found.census.target) * particle_g,
        f64::from(found.census.lost()) * particle_g
    );
    Ok(())
}
