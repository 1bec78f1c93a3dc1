//! Writes a plan that takes no optimiser: from the start of the scene `bench`, 8 cm up, 6 cm forward while tilting, and back.
//!
//! ```text
//! cargo run --release -p powderline-firmware-sim-cli --example move -- FILE [PERIOD_US]
//! ```

use std::process::ExitCode;

use powderline_firmware_sim::controller::ArmConfig;
use powderline_firmware_sim_cli::link::motion::{Move, plan_bytes};
use powderline_firmware_sim_cli::serve::bench_start;

/// One way, seconds.
const LENGTH_S: f64 = 1.0;

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let (file, period_us) =
        (arguments.next(), arguments.next().map_or(Ok(10_000), |text| text.parse::<u32>()));
    let (Some(file), Ok(period_us @ 100..=100_000)) = (file, period_us) else {
        eprintln!("move: give a file, and a control period of 100 to 100000 microseconds or none");
        return ExitCode::FAILURE;
    };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "10 to 10,000 steps")]
    let steps = (LENGTH_S * 1e6 / f64::from(period_us)).ceil() as u32;
    let part = |sign: f64, translation_m: [f64; 3], pitch_rad: f64| Move {
        translation_m: translation_m.map(|x| sign * x),
        rotation_rad: [0.0, sign * pitch_rad, 0.0],
        steps,
    };
    let (up, forward) = ([0.0, 0.0, 0.08], [0.06, 0.0, 0.0]);
    let moves = [part(1.0, up, 0.0), part(1.0, forward, 0.6), part(-1.0, forward, 0.6), part(-1.0, up, 0.0)];
    // Rounding to counts shows in the jerk, the more the shorter the period; the arm's own limits have room for it.
    let limits = ArmConfig::ideal(bench_start()).limits;
    match std::fs::write(&file, plan_bytes(&bench_start(), limits, period_us, &moves)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("move: {file}: cannot be written: {error}");
            ExitCode::FAILURE
        }
    }
}
