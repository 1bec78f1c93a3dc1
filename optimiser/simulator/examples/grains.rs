//! Grains on their way, step by step: `cargo run --release -p powderline-simulator --example grains`.

use std::ops::ControlFlow;

use powderline_simulator::rollout::{Recording, Simulate, Simulator, SimulatorSettings, Snapshot};
use powderline_simulator::scene::Scene;
use powderline_simulator::skill::{SkillMap, Theta};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scene = Scene::load("bench-small")?;
    let mut simulator = Simulator::<f32>::new(&scene, &SimulatorSettings::default())?;
    let map = SkillMap::new(&scene);
    let controls = map.controls(&Theta::new([0.5, -0.5, 0.0, 0.0, 0.3])?)?;
    let recording = Recording { anchor: map.start_pose(), controls: &controls, every: 30 };
    let mut observer = |snapshot: &Snapshot<'_>| {
        let highest = snapshot.positions_m.iter().map(|[_, _, z]| *z).fold(f32::NEG_INFINITY, f32::max);
        let speed = |v: &[f32; 3]| v.iter().map(|v| v * v).sum::<f32>().sqrt();
        let fastest = snapshot.velocities_m_s.iter().map(speed).fold(0.0, f32::max);
        println!(
            "step {:3}: tool at {:5.1} mm, highest grain at {:5.1} mm, fastest {:.2} m/s",
            snapshot.step,
            1e3 * snapshot.tool.position_m.z,
            1e3 * highest,
            fastest
        );
        ControlFlow::Continue(())
    };
    let (found, fates) = simulator.record(&recording, &mut observer)?;
    println!("{} of {} particles arrive", found.census.target, fates.len());
    Ok(())
}
