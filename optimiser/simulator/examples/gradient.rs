//! The gradient of a whole motion, by skill parameter and by control step, beside a central difference:
//! `cargo run --release -p powderline-simulator --example gradient`.
//!
//! A motion of half a second, in f64. Over a motion of several seconds the adjoint is as exact, but powder forgets where each
//! grain came from: see `optimise gradcheck`.

use powderline_simulator::rollout::{Simulate, Simulator, SimulatorSettings};
use powderline_simulator::scene::Scene;
use powderline_simulator::skill::{SkillMap, Theta};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Falling asleep is a jump, if a small one, that no difference over a small step survives.
    let scene = Scene::load("bench-small")?.without_sleep();
    let mut simulator = Simulator::<f64>::new(&scene, &SimulatorSettings::default())?;
    let skill = SkillMap::new(&scene).controls(&Theta::new([0.3, 0.0, 0.0, 0.0, 0.3])?)?;
    // The spoon is in the powder then.
    let controls: Vec<_> = skill[..100].to_vec();
    let (at, gradient) = simulator.simulate_with_gradient(&controls)?;

    const STEP: usize = 80;
    const H: f64 = 1e-7;
    let mut moved = |h: f64| {
        let mut controls = controls.clone();
        controls[STEP].translation_m[2] += h;
        simulator.simulate(&controls).map(|found| found.loss)
    };
    let difference = (moved(H)? - moved(-H)?) / (2.0 * H);
    println!("loss {:.6} m", at.loss);
    println!(
        "by the height of control step {STEP}: adjoint {:.6}, difference {difference:.6}",
        gradient[STEP].per_metre[2]
    );
    Ok(())
}
