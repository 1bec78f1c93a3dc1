//! A custom loss, differentiated by the motion: `cargo run --release -p powderline-simulator --example objective`.
//!
//! How high the powder is on average, which the scene's own loss does not ask for.

use powderline_simulator::rollout::{Simulate, Simulator, SimulatorSettings};
use powderline_simulator::scene::Scene;
use powderline_simulator::skill::{SkillMap, Theta};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scene = Scene::load("bench-small")?;
    let mut simulator = Simulator::<f64>::new(&scene, &SimulatorSettings::default())?;
    let skill = SkillMap::new(&scene).controls(&Theta::new([0.3, 0.0, 0.0, 0.0, 0.3])?)?;
    let controls: Vec<_> = skill[..150].to_vec();
    let mean_height = |positions_m: &[[f64; 3]], slopes: &mut [[f64; 3]]| {
        let share = 1.0 / positions_m.len() as f64;
        slopes.fill([0.0, 0.0, share]);
        positions_m.iter().map(|[_, _, z]| z * share).sum()
    };
    let (height_m, gradient) = simulator.gradient_of_custom_loss(&controls, &mean_height)?;
    println!("the powder is {:.3} mm high on average", 1e3 * height_m);
    // Later displacements have less time to work.
    for step in [20, 60, 100, 140] {
        println!(
            "raising the tool in control step {step}: {:+.2e} m of height per m",
            gradient[step].per_metre[2]
        );
    }
    Ok(())
}
