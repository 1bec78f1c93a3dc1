//! What the best motions of a comparison bring in other packings of the powder: how much of what a search found is chance.
//!
//! `cargo run --release -p powderline-optimiser --example other_packings -- FOLDER 12`, of the folder of `optimise compare`, reads the
//! `tries.jsonl` of its searches. For each search and each budget: the best motion so far, what it is off, loses and costs in the packing in
//! which it was found, and on average in so many others, of the seeds after that. The motions are simulated as a plan would ship them.

use powderline_optimiser::{
    compare::{Best, Track},
    optim::Method,
    report::{amounts::Amounts, tries::Try},
};
use powderline_shared::plan::Precision;
use powderline_simulator::{
    rollout::{Census, Evaluation, RolloutError, SimulatorSettings, boxed_simulator},
    scene::Scene,
    skill::{QuantisedControls, SkillMap, Theta},
};
use serde::Deserialize;
use std::{error::Error, fs, path::Path};

/// What of `comparison.json` is needed.
#[derive(Deserialize)]
struct Asked {
    precision: Precision,
    seeds: Vec<u64>,
    methods: Vec<Method>,
    rollouts: Vec<u32>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().ok_or("the folder of a comparison would be right")?;
    let packings: u64 = arguments.next().map_or(Ok(12), |count| count.parse())?;
    let folder = Path::new(&folder);
    let scene = Scene::load(&folder.join("scene.toml").to_string_lossy())?;
    let asked: Asked = serde_json::from_slice(&fs::read(folder.join("comparison.json"))?)?;
    println!(
        "| search | rollouts | off, lost, loss, as found | in {packings} other packings: off, its size, lost, loss |"
    );
    println!("|---|---|---|---|");
    for method in &asked.methods {
        for seed in &asked.seeds {
            let (method, seed) = (*method, *seed);
            let name = format!("{}-seed{seed}", method.name());
            let Ok(lines) = fs::read_to_string(folder.join(&name).join("tries.jsonl")) else { continue };
            let tries = lines.lines().map(serde_json::from_str).collect::<Result<Vec<Try>, _>>()?;
            show(&scene, &name, &Track { method, seed, tries }, &asked, packings)?;
        }
    }
    Ok(())
}

/// A line for each budget after which another motion is the best.
fn show(
    scene: &Scene,
    name: &str,
    track: &Track,
    asked: &Asked,
    packings: u64,
) -> Result<(), Box<dyn Error>> {
    let bests = track.bests(1.0);
    let mut before: Option<&Try> = None;
    for budget in &asked.rollouts {
        let within = bests.iter().take_while(|best| best.rollouts <= f64::from(*budget));
        let Some(Best { one, .. }) = within.last() else { continue };
        if before.replace(one) == Some(*one) {
            println!("| {name} | {budget} | the same | |");
            continue;
        }
        let amounts = Amounts::from(scene);
        let others = in_others(scene, (track.seed, asked.precision), one, packings)?;
        if others.is_empty() {
            println!("| {name} | {budget} | comes to an end in no other packing | |");
            continue;
        }
        let mean = |of: &dyn Fn(&Evaluation) -> f64| others.iter().map(of).sum::<f64>() / others.len() as f64;
        let miss = |census: &Census| 100.0 * amounts.miss(census.target);
        let lost = |census: &Census| 1e6 * amounts.kg(census.lost());
        println!(
            "| {name} | {budget} | {:+.2} %, {:.0} mg, {:.2} m | {:+.2} %, {:.2} %, {:.0} mg, {:.2} m |",
            miss(&one.census),
            lost(&one.census),
            one.loss,
            mean(&|found| miss(&found.census)),
            mean(&|found| miss(&found.census).abs()),
            mean(&|found| lost(&found.census)),
            mean(&|found| found.loss),
        );
    }
    Ok(())
}

/// What a motion brings in the packings of the seeds after its own, but for those in which it comes to no end.
///
/// # Errors
/// In its own it brings something else than was found: another version has other physics.
fn in_others(
    scene: &Scene,
    (seed, precision): (u64, Precision),
    one: &Try,
    packings: u64,
) -> Result<Vec<Evaluation>, Box<dyn Error>> {
    let theta = Theta::new(one.theta[..].try_into()?)?;
    let motion = SkillMap::new(scene).motion(&theta, one.splines.as_ref())?;
    let controls = QuantisedControls::new(&motion)?.controls;
    let simulated = |seed| -> Result<Evaluation, Box<dyn Error>> {
        let settings = SimulatorSettings { seed: Some(seed), ..SimulatorSettings::default() };
        Ok(boxed_simulator(scene, precision, &settings)?.simulate(&controls)?)
    };
    let own: Evaluation = simulated(seed)?;
    if one.rounded && own.loss.to_bits() != one.loss.to_bits() {
        return Err(format!("a loss of {} m was found, and now it is {} m", one.loss, own.loss).into());
    }
    let others = (1..=packings).map(|number| simulated(seed.wrapping_add(number)));
    let ends = |found: &Result<Evaluation, Box<dyn Error>>| match found {
        Ok(_) => true,
        Err(error) => !error.downcast_ref().is_some_and(RolloutError::is_of_motion),
    };
    others.filter(ends).collect()
}
