//! Powder that stands or slides as a whole: its weight on the base of a box, a block of it on an incline.

use crate::scene::{Container, ContainerShape, SceneSpec};
use crate::validate::case::{Case, Claim, Halt, Meter};
use crate::validate::measures::line;
use crate::validate::rig::{GRAVITY, Rig, apparatus, packed, set_time_step};

/// Cell, m.
const CELL_M: f64 = 0.004;

/// Width of the box and depth of the bed, m.
const WIDTH_M: f64 = 0.032;
const DEPTH_M: f64 = 0.024;

/// Time to come to rest, s. Dry powder between walls without friction swings longer: pressures are means over the last half second, some
/// seventeen times its period.
const REST_S: f64 = 4.0;
const SWING_S: f64 = 0.5;
const LOOKS: usize = 25;

/// A bed in a box without friction whose walls and floor lie so many cells off the nodes.
fn boxed(law: &SceneSpec, shift_cells: f64) -> SceneSpec {
    let shift = shift_cells * CELL_M;
    let mut scene = apparatus(law, [0.064, 0.064, 0.048], CELL_M);
    scene.containers.push(Container {
        name: "box".into(),
        position_m: [0.032 + shift, 0.032 + shift, 0.008 + shift],
        yaw_deg: 0.0,
        wall_thickness_m: CELL_M,
        friction: 0.0,
        shape: ContainerShape::Box { inner_size_m: [WIDTH_M, WIDTH_M, 0.036] },
    });
    set_time_step(&mut scene, 0.1);
    scene
}

/// Pressure at the base over the weight above it, mean over time.
fn base_pressure(scene: SceneSpec, seed: u64, meter: &Meter<'_>) -> Result<f64, Halt> {
    let [x, y, z] = scene.containers[0].position_m;
    let half = 0.5 * WIDTH_M;
    let bed = packed(&scene, [x - half, y - half, z], [x + half, y + half, z + DEPTH_M], seed);
    let weight = scene.powder.density_kg_m3 * GRAVITY * DEPTH_M;
    let mut rig = Rig::<f32>::new(scene, &bed)?;
    rig.run(REST_S - SWING_S, meter)?;
    // Vertical pressure over height in the bed as it was made: what lies above a particle stays above it.
    let mut points: Vec<_> = bed.iter().map(|p| [p[2] - z, 0.0]).collect();
    for _ in 0..LOOKS {
        rig.run(SWING_S / LOOKS as f64, meter)?;
        for (point, stress) in points.iter_mut().zip(rig.stresses()) {
            point[1] -= stress[2] / LOOKS as f64;
        }
    }
    Ok(line(&points)[0] / weight)
}

fn base(law: &SceneSpec, shift_cells: f64, place: &str) -> Case<'static> {
    let scene = boxed(law, shift_cells);
    let claim = Claim {
        group: "weight on a base",
        name: format!("pressure over weight, walls {place}"),
        unit: "",
        reference: 1.0,
        tolerance: [0.0; 2],
        source: "between walls without friction the base bears the whole weight, density times gravity times depth",
        why: "5 %: a quarter of a cell's height of powder; a floor is known to no fraction of that",
        wrong: ["The base bears {} too little", "The base bears {} too much"],
        control: false,
    };
    let particles = WIDTH_M * WIDTH_M * DEPTH_M / scene.particle_volume_m3();
    Case {
        claims: vec![claim.within(0.05)],
        seeds: 1,
        work: particles * REST_S / scene.time.substep_s(),
        measure: Box::new(move |seed, meter| Ok(vec![base_pressure(scene.clone(), seed, meter)?])),
    }
}

/// Friction of the incline, and friction angle of the powder on it, degrees: it slides before it yields.
const FRICTION: f64 = 0.4;
const BLOCK_ANGLE: f64 = 45.0;

/// The block at first, m: along the incline, across it (from one side without friction to the other), and
/// upwards.
const BLOCK_M: [f64; 3] = [0.048, 0.032, 0.012];

/// Until it lies or slides, and how long it is watched then, s.
const LIES_S: [f64; 2] = [0.4, 1.0];
const SLIDES_S: [f64; 2] = [0.1, 0.3];

/// A block on an incline, which is a level floor under gravity that is tilted.
fn incline(law: &SceneSpec, tilt_deg: f64) -> SceneSpec {
    let mut scene = apparatus(law, [0.512, BLOCK_M[1], 0.032], CELL_M);
    let (sin, cos) = libm::sincos(tilt_deg.to_radians());
    scene.domain.gravity_m_s2 = [GRAVITY * sin, 0.0, -GRAVITY * cos];
    scene.domain.friction = FRICTION;
    scene.powder.friction_angle_deg = BLOCK_ANGLE;
    set_time_step(&mut scene, 1.0);
    scene
}

/// Mean velocity down the incline before and after it is watched, m/s, and mean way, m: of its middle third,
/// as its ends crumble.
fn slide(
    scene: SceneSpec,
    [before_s, watched_s]: [f64; 2],
    seed: u64,
    meter: &Meter<'_>,
) -> Result<([f64; 2], f64), Halt> {
    let [length, width, height] = BLOCK_M;
    let low = [0.5 * length, 0.0, 0.0];
    let block = packed(&scene, low, [low[0] + length, width, height], seed);
    let mean = |of: Vec<[f64; 3]>| {
        let third = block.iter().zip(of).filter(|(p, _)| (p[0] - length).abs() < length / 6.0);
        let third: Vec<_> = third.map(|(_, number)| number[0]).collect();
        third.iter().sum::<f64>() / third.len() as f64
    };
    let mut rig = Rig::<f32>::new(scene, &block)?.with_smooth_sides();
    rig.run(before_s, meter)?;
    let (from, early) = (mean(rig.positions()), mean(rig.velocities()));
    rig.run(watched_s, meter)?;
    Ok(([early, mean(rig.velocities())], mean(rig.positions()) - from))
}

fn on_incline(law: &SceneSpec, tilt_deg: f64) -> Case<'static> {
    let scene = incline(law, tilt_deg);
    let (sin, cos) = libm::sincos(tilt_deg.to_radians());
    let slides = sin > FRICTION * cos;
    let times = if slides { SLIDES_S } else { LIES_S };
    let particles = BLOCK_M.iter().product::<f64>() / scene.particle_volume_m3();
    let work = particles * times.iter().sum::<f64>() / scene.time.substep_s();
    let claim = Claim {
        group: "a block on an incline",
        name: String::new(),
        unit: "",
        reference: 0.0,
        tolerance: [0.0; 2],
        source: "Coulomb: friction of 0.4 holds a block up to 21.8 deg; beyond, it slides with a = g (sin t \
                 - 0.4 cos t)",
        why: "",
        wrong: [""; 2],
        control: false,
    };
    let claim = if slides {
        let claim = Claim {
            name: format!("acceleration, tilted by {tilt_deg} deg"),
            unit: "m/s^2",
            reference: GRAVITY * (sin - FRICTION * cos),
            why: "5 %: the block is soft, and bounces a little on the floor",
            wrong: ["The block slides too slowly by {}", "The block slides too fast by {}"],
            ..claim
        };
        claim.within_share(0.05)
    } else {
        Claim {
            name: format!("creep, tilted by {tilt_deg} deg"),
            unit: "m/s",
            tolerance: [-2e-4, 2e-4],
            why: "0.0002 m/s: a quarter of a cell in the five seconds of a motion",
            wrong: ["The block creeps uphill by {}", "The block creeps downhill by {}"],
            ..claim
        }
    };
    let measure = move |seed, meter: &Meter<'_>| {
        let ([early, late], way) = slide(scene.clone(), times, seed, meter)?;
        Ok(vec![if slides { late - early } else { way } / times[1]])
    };
    Case { claims: vec![claim], seeds: 1, work, measure: Box::new(measure) }
}

/// All of it.
pub(super) fn cases(law: &SceneSpec) -> Vec<Case<'_>> {
    let bases =
        [(0.0, "on nodes"), (0.5, "midway between nodes")].map(|(shift, place)| base(law, shift, place));
    let inclines = [10.0, 18.0, 25.0, 35.0].map(|tilt| on_incline(law, tilt));
    bases.into_iter().chain(inclines).collect()
}
