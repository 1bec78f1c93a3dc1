//! One skill of a shipped bench, and what it brings: `cargo run --release -p powderline-simulator --example rollout`.

use powderline_simulator::rollout::{Simulate, Simulator, SimulatorSettings};
use powderline_simulator::scene::Scene;
use powderline_simulator::skill::Theta;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scene = Scene::load("bench-small")?;
    let mut simulator = Simulator::<f32>::new(&scene, &SimulatorSettings::default())?;
    // Depth, scooping angle, lift, transport, pouring angle: each from -1 to 1 within the scene's bounds.
    for depth in [0.0, 0.5, 1.0] {
        let theta = Theta::new([depth, -0.5, 0.0, 0.0, 0.3])?;
        let found = simulator.evaluate(&theta)?;
        let grams = 1e3 * scene.particle_mass_kg() * f64::from(found.census.target);
        let (lost, loss) = (found.census.lost(), found.loss);
        println!("{theta:5.1}: {grams:.3} g arrive, {lost} particles are lost, loss {loss:.3} m");
    }
    Ok(())
}
