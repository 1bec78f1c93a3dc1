//! Settles the powder of `bench-small`, on a grid twice as coarse, and then does a rollout, a restarted gradient, a motion of 1,000 frames, or nothing, for
//! `optimiser/python/examples/overhead.py` to compare with Python: `overhead rollout`.

use std::ops::ControlFlow;

use powderline_simulator::rollout::restart::Restarts;
use powderline_simulator::rollout::{
    Displacement, Recording, Simulate, Simulator, SimulatorSettings, Snapshot,
};
use powderline_simulator::scene::Scene;
use powderline_simulator::skill::{SkillMap, Theta};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let work = std::env::args().nth(1).unwrap_or_default();
    let scene = Scene::load("bench-small")?.with(|spec| {
        spec.domain.cell_m = 0.008;
        spec.time.substeps = 10;
    })?;
    let settings = SimulatorSettings { threads: Some(1), ..SimulatorSettings::default() };
    let mut simulator = Simulator::<f32>::new(&scene, &settings)?;
    let (map, theta) = (SkillMap::new(&scene), Theta::new([0.3, 0.0, 0.0, 0.0, 0.3])?);
    simulator.evaluate_all(&[])?;
    match work.as_str() {
        "nothing" => {}
        "rollout" => {
            simulator.evaluate(&theta)?;
        }
        "gradient" => {
            simulator.evaluate_restarted(&theta, &Restarts::of_skill(&scene, &map, &theta))?;
        }
        "frames" => {
            let rest = vec![Displacement::default(); 1000];
            let recording = Recording { anchor: map.start_pose(), controls: &rest, every: 1 };
            // All frames stay, as they do in Python.
            let mut frames = Vec::new();
            let mut keep = |snapshot: &Snapshot<'_>| {
                frames.push((snapshot.positions_m.to_vec(), snapshot.velocities_m_s.to_vec()));
                ControlFlow::Continue(())
            };
            simulator.record(&recording, &mut keep)?;
        }
        other => return Err(format!("`{other}` is none of nothing, rollout, gradient, frames").into()),
    }
    Ok(())
}
