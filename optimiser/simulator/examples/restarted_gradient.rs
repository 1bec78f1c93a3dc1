//! The gradient of a skill by the exact adjoint, by the restarted one, and the slope over a step that a search might take.
//!
//!     cargo run --release -p powderline-simulator --example restarted_gradient [SCENE [DRAW [PACKING]]]
//!
//! Skills are drawn from all of theta's range, always the same ones. `optimise gradcheck SCENE --skills N` does it for many.

use powderline_simulator::rollout::restart::Restarts;
use powderline_simulator::rollout::slopes::{cosine, measure, skill};
use powderline_simulator::rollout::{Simulator, SimulatorSettings};
use powderline_simulator::scene::Scene;
use powderline_simulator::skill::SkillMap;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let scene = Scene::load(&arguments.next().unwrap_or("bench-small".into()))?;
    let mut number = |usual: u64| arguments.next().map_or(Ok(usual), |text| text.parse());
    let (theta, seed) = (skill(number(0)?), number(1)?);
    let mut simulator = Simulator::<f32>::new(
        &scene,
        &SimulatorSettings { seed: Some(seed), ..SimulatorSettings::default() },
    )?;
    let restarts = Restarts::of_skill(&scene, &SkillMap::new(&scene), &theta);
    println!("skill     {}", shown(theta.components()));
    let Some(found) = measure(&mut simulator, &theta, &restarts)? else {
        println!("It delivers next to nothing: there is no slope to speak of.");
        return Ok(());
    };
    println!("slope     {}   {} particles arrive", shown(found.slope), found.delivered);
    for (name, gradient) in [("exact    ", found.exact), ("restarted", found.restarted)] {
        println!("{name} {}   cosine {:.2}", shown(gradient), cosine(&gradient, &found.slope));
    }
    Ok(())
}

fn shown(numbers: [f64; 5]) -> String {
    numbers.map(|x| format!("{x:9.3}")).join(" ")
}
