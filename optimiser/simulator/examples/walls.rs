//! What walls with two sides, and sleep by the mean, are worth: what spoons hold, beside geometry, and what one skill brings
//! on the scene's cells and on cells of half the size.
//!
//! `cargo run --release -p powderline-simulator --example walls -- spoon`
//! `cargo run --release -p powderline-simulator --example walls -- skill bench-small 0.3,0,0,0,0.3`
//!
//! With `skill` the first parameter, the depth, is changed until each variant brings the amount that the scene wants, on its own cells.

use powderline_shared::pose::{Displacement, Pose, exp_so3};
use powderline_simulator::rollout::{Simulate, Simulator, SimulatorSettings};
use powderline_simulator::scene::{
    FillShape, Gate, GateOpening, GateShape, Scene, SceneError, SleepBy, ToolShape, Walls,
};
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
        ["spoon"] => spoons(),
        ["skill", scene, theta] => skills(&Scene::load(scene)?, theta),
        _ => Err("either `spoon`, or `skill SCENE A,B,C,D,E`".into()),
    }
}

/// The same on cells that are smaller by a whole number.
fn refined(scene: &Scene, by: u32, walls: Walls, sleep_by: SleepBy) -> Result<Scene, SceneError> {
    scene.refined(by)?.with(|spec| {
        spec.domain.walls = walls;
        spec.domain.sleep_by = sleep_by;
    })
}

/// What each spoon of `bench` holds that is filled through a pipe, drawn up while powder runs over.
fn spoons() -> Outcome<()> {
    let bench = Scene::load("bench")?;
    let scoop = ToolShape::BoxScoop { inner_size_m: [0.024, 0.024, 0.014] };
    for (name, shape, pitch_deg) in
        [("bowl", bench.tool.shape.clone(), 0.0), ("scoop, leaning back by 20 deg", scoop, -20.0)]
    {
        let scene = below_pipe(&bench, shape, pitch_deg)?;
        let geometry_g = 1e3 * scene.tool_capacity().heaped_kg;
        println!("{name}: {geometry_g:.2} g by geometry");
        for by in [1, 2] {
            for (variant, walls, sleep_by) in VARIANTS {
                let scene = refined(&scene, by, walls, sleep_by)?;
                let held_g = held_g(&scene, pitch_deg)?;
                let off = 100.0 * (held_g / geometry_g - 1.0);
                println!("  {} mm cells, {variant}: {held_g:.2} g, {off:+.1} %", 1e3 * scene.domain.cell_m);
            }
        }
    }
    Ok(())
}

/// Where the spoon stands, m, and inner radius of the pipe above it.
const SPOON_M: [f64; 3] = [0.176, 0.048, 0.075];
const PIPE_M: f64 = 0.008;
/// From the spoon's rims to the pipe, and the length of the powder in it, m.
const GAP_M: f64 = 0.004;
const COLUMN_M: f64 = 0.096;
/// How fast the pipe is drawn up, m/s, and how far, m.
const SPEED_M_S: f64 = 0.02;
const TRAVEL_M: f64 = 0.04;
/// Until all is at rest, s.
const REST_S: f64 = 0.6;

fn below_pipe(bench: &Scene, shape: ToolShape, pitch_deg: f64) -> Result<Scene, SceneError> {
    let [x, y, z] = SPOON_M;
    bench.with(|spec| {
        spec.tool.shape = shape;
        spec.arm = None;
        // The capacity by geometry is that of the angles that a skill may have.
        let turn_deg = spec.tool.start_pitch_deg - pitch_deg;
        spec.skill.scooping_angle_deg = [turn_deg, turn_deg + 0.01];
        // Nothing is scooped, but every skill has to stay above the floor.
        spec.skill.scooping_depth_m = [0.002, 0.015];
        spec.powder.fill_shape = FillShape::Cylinder;
        spec.powder.fill_min_m = [x - PIPE_M, y - PIPE_M, z + GAP_M];
        spec.powder.fill_max_m = [x + PIPE_M, y + PIPE_M, z + GAP_M + COLUMN_M];
        spec.gates = vec![Gate {
            name: "pipe".to_owned(),
            position_m: [x, y, z + GAP_M],
            yaw_deg: 0.0,
            friction: 0.0,
            opens_at_s: 0.0,
            shape: GateShape::Tube { inner_radius_m: PIPE_M, height_m: COLUMN_M, wall_thickness_m: 0.002 },
            opening: GateOpening::Slide { velocity_m_s: [0.0, 0.0, SPEED_M_S], travel_m: TRAVEL_M },
        }];
    })
}

fn held_g(scene: &Scene, pitch_deg: f64) -> Outcome<f64> {
    let turn = exp_so3(&[0.0, pitch_deg.to_radians(), 0.0].into());
    let anchor = Pose { position_m: SPOON_M.into(), orientation: turn };
    let step_s = 1e-6 * f64::from(scene.time.control_period_us);
    let steps = ((TRAVEL_M / SPEED_M_S + REST_S) / step_s).round() as usize;
    let mut simulator = Simulator::<f32>::new(scene, &SimulatorSettings::default())?;
    let found = simulator.simulate_from(&anchor, &vec![Displacement::default(); steps])?;
    Ok(1e3 * scene.particle_mass_kg() * f64::from(found.census.tool))
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
