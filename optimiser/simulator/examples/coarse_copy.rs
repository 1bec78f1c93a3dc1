//! What a scene's coarse copy is worth: skills drawn from all over the range are simulated in both. How what arrives goes together, how
//! the losses do, and what the copy costs.
//!
//! `cargo run --release -p powderline-simulator --example coarse_copy -- bench 24`

use powderline_shared::plan::Precision;
use powderline_simulator::bench::cpu_seconds;
use powderline_simulator::rollout::{Evaluation, RolloutError, SimulatorSettings, boxed_simulator};
use powderline_simulator::scene::Scene;
use powderline_simulator::skill::Theta;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let scene = Scene::load(&arguments.next().unwrap_or_else(|| "bench".into()))?;
    let skills: i32 = arguments.next().map_or(Ok(24), |count| count.parse())?;
    let coarse = scene.coarse().ok_or("the scene has no coarse copy")?;
    let thetas: Vec<Theta> = (1..=skills).map(drawn).collect();
    let (fine, fine_s) = simulated(&scene, &thetas)?;
    let (copy, copy_s) = simulated(&coarse, &thetas)?;
    // Where one of them came to no end, there is nothing to compare.
    let both: Vec<(&Evaluation, &Evaluation)> =
        fine.iter().zip(&copy).filter_map(|(a, b)| Some((a.as_ref()?, b.as_ref()?))).collect();
    let heavier = coarse.particle_mass_kg() / scene.particle_mass_kg();
    let arrives =
        both.iter().map(|(a, b)| (f64::from(a.census.target), heavier * f64::from(b.census.target)));
    let losses = both.iter().map(|(a, b)| (a.loss, heavier * b.loss));
    println!("{}: {} skills, of which {} came to an end in both", scene.name, skills, both.len());
    println!("correlation of what arrives {:.3}", correlation(&arrives.collect::<Vec<_>>()));
    println!("correlation of the losses   {:.3}", correlation(&losses.collect::<Vec<_>>()));
    println!(
        "processor time of the copy  {:.2} of the scene's {:.2} s",
        copy_s / fine_s,
        fine_s / f64::from(skills)
    );
    Ok(())
}

/// A sequence that fills the range evenly (Roberts 2018).
fn drawn(number: i32) -> Theta {
    let root = (0..60).fold(2.0, |x: f64, _| (1.0 + x).powf(1.0 / 6.0));
    Theta::clamped(std::array::from_fn(|k| {
        2.0 * (0.5 + f64::from(number) / root.powi(k as i32 + 1)).fract() - 1.0
    }))
}

/// What each skill brings, and the processor time of all.
fn simulated(scene: &Scene, thetas: &[Theta]) -> Result<(Vec<Option<Evaluation>>, f64), RolloutError> {
    let mut simulator = boxed_simulator(scene, Precision::F32, &SimulatorSettings::default())?;
    // Settles the powder, which both have to.
    simulator.evaluate_all(&[])?;
    let begun_s = cpu_seconds();
    let mut found = Vec::new();
    for theta in thetas {
        found.push(match simulator.evaluate(theta) {
            Err(error) if error.is_of_motion() => None,
            other => Some(other?),
        });
    }
    Ok((found, cpu_seconds() - begun_s))
}

fn correlation(pairs: &[(f64, f64)]) -> f64 {
    let count = pairs.len() as f64;
    let (x, y) = pairs.iter().fold((0.0, 0.0), |(x, y), (a, b)| (x + a / count, y + b / count));
    let sum = |of: fn(f64, f64) -> f64| pairs.iter().map(|(a, b)| of(a - x, b - y)).sum::<f64>();
    sum(|a, b| a * b) / (sum(|a, _| a * a) * sum(|_, b| b * b)).sqrt()
}
