//! What walls with two sides, and sleep by the mean, are worth: what one skill brings on the scene's cells and on cells of half the size.
//!
//! `cargo run --release -p powderline-simulator --example walls -- bench-small 0.3,0,0,0,0.3`
//!
//! The first parameter, the depth, is changed until each variant brings the amount that the scene wants, on its own cells.

use powderline_simulator::rollout::{Simulate, Simulator, SimulatorSettings};
use powderline_simulator::scene::{Scene, SceneError, SleepBy, Walls};
use powderline_simulator::skill::Theta;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

const VARIANTS: [(&str, Walls, SleepBy); 3] = [
    ("shared", Walls::Shared, SleepBy::Largest),
    ("two_sided", Walls::TwoSided, SleepBy::Largest),
    ("two_sided, mean_square", Walls::TwoSided, SleepBy::MeanSquare),
];

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match &arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [scene, theta] => skills(&Scene::load(scene)?, theta),
        _ => {
            Err("a scene and five parameters of a skill are needed, such as: bench-small 0.3,0,0,0,0.3"
                .into())
        }
    }
}

/// The same on cells that are smaller by a whole number.
fn refined(scene: &Scene, by: u32, walls: Walls, sleep_by: SleepBy) -> Result<Scene, SceneError> {
    scene.refined(by)?.with(|spec| {
        spec.domain.walls = walls;
        spec.domain.sleep_by = sleep_by;
    })
}

fn skills(scene: &Scene, theta: &str) -> Outcome<()> {
    let theta: Vec<f64> = theta.split(',').map(str::parse).collect::<Result<_, _>>()?;
    let theta: [f64; 5] = theta.try_into().map_err(|_| "a skill has five parameters")?;
    for (variant, walls, sleep_by) in VARIANTS {
        let [own, fine] = [1, 2].map(|by| refined(scene, by, walls, sleep_by));
        let (theta, own_g) = that_brings_it(&own?, theta)?;
        let fine_g = brought_g(&fine?, theta)?;
        println!(
            "{}, {variant}, depth {:.4}: {own_g:.3} g, on cells of half the size {fine_g:.3} g, {:+.1} %",
            scene.name,
            theta[0],
            100.0 * (fine_g / own_g - 1.0)
        );
    }
    Ok(())
}

fn brought_g(scene: &Scene, theta: [f64; 5]) -> Outcome<f64> {
    let found = Simulator::<f32>::new(scene, &SimulatorSettings::default())?.evaluate(&Theta::new(theta)?)?;
    Ok(1e3 * scene.particle_mass_kg() * f64::from(found.census.target))
}

/// The skill of another depth that brings what is wanted, or the nearest found, and what it brings.
fn that_brings_it(scene: &Scene, theta: [f64; 5]) -> Outcome<([f64; 5], f64)> {
    let wanted_g = 1e3 * scene.target_mass_kg();
    let at = |depth: f64| [depth, theta[1], theta[2], theta[3], theta[4]];
    let miss = |depth: f64| Ok::<f64, Box<dyn std::error::Error>>(brought_g(scene, at(depth))? - wanted_g);
    // Deeper brings more: two depths that have it between them, brought together.
    let (mut low, mut high) = ((-1.0, miss(-1.0)?), (1.0, miss(1.0)?));
    let mut best = if low.1.abs() < high.1.abs() { low } else { high };
    for _ in 0..10 {
        if best.1.abs() < 0.5 * scene.objective.amount.tolerance * wanted_g || low.1 * high.1 > 0.0 {
            break;
        }
        // Along the straight line, but not too near to either end.
        let share = (low.1 / (low.1 - high.1)).clamp(0.2, 0.8);
        let depth = low.0 + share * (high.0 - low.0);
        let next = (depth, miss(depth)?);
        *if next.1 < 0.0 { &mut low } else { &mut high } = next;
        best = if next.1.abs() < best.1.abs() { next } else { best };
    }
    Ok((at(best.0), wanted_g + best.1))
}
