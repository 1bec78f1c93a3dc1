//! What a step of the simulated arm costs: `cargo run --release -p powderline-firmware-sim --example arm_speed`.

use std::f64::consts::TAU;
use std::hint::black_box;
use std::time::Instant;

use nalgebra::Vector3;
use powderline_firmware_sim::arm::Arm;
use powderline_firmware_sim::arm::servo::Lag;
use powderline_shared::arm::{ArmError, ArmModel};
use powderline_shared::pose::{Pose, exp_so3};

const STEPS: u32 = 1_000_000;

/// A slow circle over the bench, pitching to and fro.
fn pose(phase: f64) -> Pose {
    let (sine, cosine) = phase.sin_cos();
    Pose {
        position_m: Vector3::new(0.125 + 0.05 * cosine, 0.048, 0.1 + 0.05 * sine),
        orientation: exp_so3(&Vector3::new(0.0, 1.1 + 0.5 * sine, 0.0)),
    }
}

fn measure(name: &str, mut arm: Arm, way: &[Pose]) -> Result<(), ArmError> {
    let begin = Instant::now();
    for pose in way.iter().cycle().take(STEPS as usize) {
        let target = arm.target(arm.told(), black_box(pose), 0.01)?;
        arm.follow(target, 0.01);
    }
    let ns = begin.elapsed().as_secs_f64() * 1e9 / f64::from(STEPS);
    println!("{name:<12} {ns:7.0} ns per follow, tool at {:?}", black_box(arm.pose()).position_m);
    Ok(())
}

fn main() -> Result<(), ArmError> {
    let way: Vec<Pose> = (0..1_000).map(|step| pose(TAU * f64::from(step) / 1_000.0)).collect();
    let arm = |lag| Arm::new(ArmModel::bench(), lag, pose(0.0));
    measure("ideal", Arm::ideal(pose(0.0)), &way)?;
    measure("without lag", arm(Lag::NONE)?, &way)?;
    measure("with lag", arm(Lag::default())?, &way)
}
