//! Processor seconds that a rollout, a restarted gradient and a motion of 1,000 frames take, for `optimiser/python/examples/overhead.py` to compare
//! with Python: `cargo run --release -p powderline-simulator --example overhead`.

use std::ops::ControlFlow;

use powderline_simulator::bench::cpu_seconds;
use powderline_simulator::rollout::restart::Restarts;
use powderline_simulator::rollout::{
    Displacement, Recording, Simulate, Simulator, SimulatorSettings, Snapshot,
};
use powderline_simulator::scene::Scene;
use powderline_simulator::skill::{SkillMap, Theta};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scene = Scene::load("bench-small")?;
    let settings = SimulatorSettings { threads: Some(1), ..SimulatorSettings::default() };
    let mut simulator = Simulator::<f32>::new(&scene, &settings)?;
    let (map, theta) = (SkillMap::new(&scene), Theta::new([0.3, 0.0, 0.0, 0.0, 0.3])?);
    simulator.evaluate_all(&[])?;
    let began = cpu_seconds();
    simulator.evaluate(&theta)?;
    let rollout = cpu_seconds() - began;
    let began = cpu_seconds();
    simulator.evaluate_restarted(&theta, &Restarts::of_skill(&scene, &map, &theta))?;
    let gradient = cpu_seconds() - began;
    let began = cpu_seconds();
    let rest = vec![Displacement::default(); 1000];
    let recording = Recording { anchor: map.start_pose(), controls: &rest, every: 1 };
    // All frames stay, as they do in Python.
    let mut frames = Vec::new();
    let mut keep = |snapshot: &Snapshot<'_>| {
        frames.push((snapshot.positions_m.to_vec(), snapshot.velocities_m_s.to_vec()));
        ControlFlow::Continue(())
    };
    simulator.record(&recording, &mut keep)?;
    let frames = cpu_seconds() - began;
    println!(r#"{{"rollout": {rollout}, "gradient": {gradient}, "frames": {frames}}}"#);
    Ok(())
}
