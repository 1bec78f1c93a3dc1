//! A made-up motion, not simulated, in every format: powder in a box, a bowl that carries some of it into another.
//!
//! ```text
//! cargo run --release -p powderline-view --example synthetic -- DIR [pictures]
//! ```
//!
//! Writes `DIR/vtk`, `DIR/ply`, `DIR/csv` and `DIR/expected.json`, which says what must be in them (`tests/exports/run`
//! holds other programs to it); with `pictures` also stills and animations.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use std::time::Instant;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use powderline_shared::pose::Pose;
use powderline_simulator::scene::{GateOpening, GateShape};
use powderline_view::export::{Format, Series};
use powderline_view::extent::Extent;
use powderline_view::mesh::Mesh;
use powderline_view::picture::{Animation, Camera, Colouring, Containers, Look, Stills};
use powderline_view::{Bench, Container, Destination, Frame, Gate, Role, Sink, ViewError};
use serde_json::{Value, json};

const PERIOD_S: f64 = 0.01;
const FRAMES: usize = 501;

/// Every so many frames are exported.
const EVERY: usize = 100;

const SPACING_M: f64 = 0.002;
const BOWL_M: f64 = 0.016;

/// Corners of the powder at first, metres.
const BED_M: [[f64; 3]; 2] = [[0.024, 0.016, 0.004], [0.088, 0.080, 0.027]];

/// The volume, metres.
const SIZE_M: [f64; 3] = [0.256, 0.096, 0.208];

/// Middles of the boxes' floors, metres.
const SOURCE_M: [f64; 3] = [0.056, 0.048, 0.004];
const TARGET_M: [f64; 3] = [0.176, 0.048, 0.004];

/// The tool's place, metres, and pitch, degrees, at times, seconds; in between they change smoothly.
const PATH: [(f64, [f64; 4]); 7] = [
    (0.0, [0.0455, 0.048, 0.066, 80.0]),
    (1.0, [0.0455, 0.048, 0.030, 80.0]),
    (1.7, [0.0655, 0.048, 0.030, 0.0]),
    (2.4, [0.0655, 0.048, 0.100, 0.0]),
    (3.4, [0.1560, 0.048, 0.100, 0.0]),
    (4.3, [0.1560, 0.048, 0.100, 115.0]),
    (5.0, [0.1560, 0.048, 0.100, 115.0]),
];

/// When the bowl closes about the powder.
const SCOOPED_S: f64 = 1.7;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1);
    let folder = PathBuf::from(words.next().ok_or("name a directory to write into")?);
    let with_pictures = match words.next().as_deref() {
        None => false,
        Some("pictures") => true,
        Some(_) => return Err("the second word can only be: pictures".into()),
    };
    let way: Vec<Pose> = (0..FRAMES).map(|index| tool(index as f64 * PERIOD_S)).collect();
    let (bench, motion) = (bench().framed(&way), Motion::new());
    println!("{} particles, {FRAMES} frames", bench.particles);
    exports(&bench, &motion, &folder)?;
    if with_pictures {
        stills(&bench, &motion, &folder)?;
        animations(&bench, &motion, &folder)?;
    }
    Ok(())
}

fn exports(bench: &Bench, motion: &Motion, folder: &Path) -> Result<(), Box<dyn std::error::Error>> {
    for (format, name) in [(Format::Vtk, "vtk"), (Format::Ply, "ply"), (Format::Csv, "csv")] {
        let began = Instant::now();
        play(motion, EVERY, &mut Series::new(bench, format, folder.join(name), EVERY)?)?;
        println!("{name}: {:.2} s", began.elapsed().as_secs_f64());
    }
    let mut expected = Expected::new(bench);
    play(motion, EVERY, &mut expected)?;
    std::fs::write(folder.join("expected.json"), serde_json::to_string_pretty(&expected.contents)?)?;
    Ok(())
}

fn stills(bench: &Bench, motion: &Motion, folder: &Path) -> Result<(), ViewError> {
    for (name, look) in looks() {
        let began = Instant::now();
        let times = [0.0, 1.5, 2.4, 4.05, 5.0];
        let folder = folder.join("stills");
        play(motion, 1, &mut Stills::new(bench, &Camera::default(), &look, folder, name, &times)?)?;
        println!("{} stills {name}: {:.2} s", times.len(), began.elapsed().as_secs_f64());
    }
    Ok(())
}

fn animations(bench: &Bench, motion: &Motion, folder: &Path) -> Result<(), ViewError> {
    let look = Look { width_px: 640, height_px: 480, ..Look::default() };
    let began = Instant::now();
    let files = ["motion.gif", "motion.png"].map(|name| folder.join(name));
    let progress = |done, all| {
        println!("{done} of {all} pictures");
        true
    };
    let animation = Animation::new(bench, &Camera::default(), &look, 25.0, &files)?;
    play(motion, 1, &mut animation.with_progress(Box::new(progress)))?;
    println!("animations: {:.2} s", began.elapsed().as_secs_f64());
    Ok(())
}

fn looks() -> [(&'static str, Look); 5] {
    let look = Look::default();
    [
        ("plain", look.clone()),
        ("speed", Look { colouring: Colouring::Speed { max_m_s: 1.0 }, ..look.clone() }),
        ("height", Look { colouring: Colouring::Height { max_m: 0.12 }, ..look.clone() }),
        ("destination", Look { colouring: Colouring::Destination, grains: 1, ..look.clone() }),
        ("cut", Look { containers: Containers::CutOpen, ..look }),
    ]
}

/// Hands over every k-th frame: those between would be left out by the exports anyway.
fn play(motion: &Motion, every: usize, sink: &mut dyn Sink) -> Result<(), ViewError> {
    for index in (0..FRAMES).step_by(every) {
        let time_s = index as f64 * PERIOD_S;
        let (positions_m, velocities_m_s): (Vec<_>, Vec<_>) =
            motion.bed_m.iter().enumerate().map(|(particle, _)| motion.at(particle, time_s)).unzip();
        sink.frame(&Frame {
            index,
            time_s,
            tool: tool(time_s),
            planned: (index % 200 == 0).then(|| tool(time_s)),
            positions_m: &positions_m,
            velocities_m_s: &velocities_m_s,
        })?;
    }
    sink.finish(&motion.destinations)
}

/// What a program that opens the exports must find: counts, times, and sums that tell if a value or the order differs.
struct Expected {
    contents: Value,
    tool: Mesh,
    gates: Vec<Gate>,
}

impl Expected {
    fn new(bench: &Bench) -> Self {
        let containers = bench.containers.iter().fold(Mesh::default(), |all, one| all.and(one.mesh.clone()));
        let contents = json!({
            "particles": bench.particles,
            "containers": solid(&containers),
            "frames": [],
            "destinations": {},
        });
        Self { contents, tool: bench.tool.clone(), gates: bench.gates.clone() }
    }
}

impl Sink for Expected {
    fn frame(&mut self, frame: &Frame<'_>) -> Result<(), ViewError> {
        let at = Isometry3::from_parts(frame.tool.position_m.into(), frame.tool.orientation);
        let speeds = frame.velocities_m_s.iter().map(|velocity| {
            [velocity.iter().map(|part| f64::from(*part).powi(2)).sum::<f64>().sqrt(), 0.0, 0.0]
        });
        let gates = self.gates.iter().filter_map(|gate| gate.at(frame.time_s)).reduce(Mesh::and);
        let moment = json!({
            "index": frame.index,
            "time_s": frame.time_s,
            "positions_m": sums(frame.positions_m.iter().map(|at| at.map(f64::from))),
            "velocities_m_s": sums(frame.velocities_m_s.iter().map(|at| at.map(f64::from))),
            "speeds_m_s": sums(speeds).map(|sums| sums[0]),
            "tool": solid(&self.tool.clone().moved(&at)),
            "gates": gates.map(|gates| solid(&gates)),
            "pose": pose(&frame.tool),
            "planned": frame.planned.as_ref().map(pose),
        });
        if let Some(frames) = self.contents["frames"].as_array_mut() {
            frames.push(moment);
        }
        Ok(())
    }

    fn finish(&mut self, destinations: &[Destination]) -> Result<(), ViewError> {
        for which in Destination::ALL {
            let count = destinations.iter().filter(|destination| **destination == which).count();
            self.contents["destinations"][which.name()] = count.into();
        }
        Ok(())
    }
}

/// Sum of values, and sum of values times their number from 1, which tells their order.
fn sums(values: impl Iterator<Item = [f64; 3]>) -> [[f64; 3]; 2] {
    let mut sums = [[0.0; 3]; 2];
    for (index, value) in values.enumerate() {
        for axis in 0..3 {
            sums[0][axis] += value[axis];
            sums[1][axis] += value[axis] * (index + 1) as f64;
        }
    }
    sums
}

/// Counts, sums of the corners, and the volume, which tells if a triangle has other corners or is turned inside out.
fn solid(mesh: &Mesh) -> Value {
    // Files hold single precision.
    let points_m: Vec<_> =
        mesh.points_m.iter().map(|point| point.map(|part| f64::from(part as f32))).collect();
    let volume_m3 = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|corner| Vector3::from(points_m[corner as usize]));
        a.dot(&b.cross(&c)) / 6.0
    };
    json!({
        "points": points_m.len(),
        "triangles": mesh.triangles.len(),
        "corners_m": sums(points_m.iter().copied()),
        "volume_m3": mesh.triangles.iter().map(volume_m3).sum::<f64>(),
    })
}

/// As the columns of `tool.csv`.
fn pose(pose: &Pose) -> [f64; 7] {
    let (at, turn) = (pose.position_m, pose.orientation.quaternion());
    [at.x, at.y, at.z, turn.w, turn.i, turn.j, turn.k]
}

fn bench() -> Bench {
    let container = |name: &str, role, at: [f64; 3], height_m| Container {
        name: name.to_owned(),
        role,
        mesh: Mesh::open_box([0.064, 0.064, height_m], 0.004)
            .moved(&Isometry3::translation(at[0], at[1], at[2])),
    };
    let rise = 75f64.to_radians();
    let handle = [-0.05 * rise.cos() - BOWL_M - 0.002, 0.0, 0.05 * rise.sin()];
    Bench {
        name: "synthetic".to_owned(),
        size_m: SIZE_M,
        extent: Extent::of_volume(SIZE_M),
        cell_m: 2.0 * SPACING_M,
        containers: vec![
            container("source", Role::Source, SOURCE_M, 0.030),
            container("target", Role::Target, TARGET_M, 0.040),
        ],
        gates: gates(),
        tool: Mesh::bowl(BOWL_M, 0.004).and(Mesh::capsule([-BOWL_M - 0.002, 0.0, 0.0], handle, 0.004)),
        arm: None,
        target_m: [0.176, 0.048, 0.010],
        particles: Motion::new().bed_m.len(),
        period_s: PERIOD_S,
        frames: FRAMES,
    }
}

/// A pipe in the target that is gone after 1.5 s, and a plate between the boxes that slides down for a second after 2.5 s.
fn gates() -> Vec<Gate> {
    let law = |name: &str, opens_at_s, position_m, shape, opening| powderline_simulator::scene::Gate {
        name: name.to_owned(),
        position_m,
        yaw_deg: 0.0,
        friction: 0.4,
        opens_at_s,
        shape,
        opening,
    };
    let at = |[x, y, z]: [f64; 3]| Isometry3::translation(x, y, z);
    let pipe = GateShape::Tube { inner_radius_m: 0.012, height_m: 0.030, wall_thickness_m: 0.004 };
    let plate_m = [0.116, 0.048, 0.040];
    let slide = GateOpening::Slide { velocity_m_s: [0.0, 0.0, -0.035], travel_m: 0.035 };
    vec![
        Gate {
            law: law("pipe", 1.5, TARGET_M, pipe, GateOpening::Vanish {}),
            mesh: Mesh::pipe(0.012, 0.030, 0.004).moved(&at(TARGET_M)),
        },
        Gate {
            law: law("plate", 2.5, plate_m, GateShape::Box { size_m: [0.004, 0.04, 0.03] }, slide),
            mesh: Mesh::block([-0.002, -0.02, 0.0], [0.002, 0.02, 0.03]).moved(&at(plate_m)),
        },
    ]
}

/// The tool at a time.
fn tool(time_s: f64) -> Pose {
    let next = PATH.iter().position(|(at_s, _)| time_s < *at_s).unwrap_or(PATH.len() - 1).max(1);
    let ((from_s, from), (to_s, to)) = (PATH[next - 1], PATH[next]);
    let share = ((time_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0);
    let share = share * share * (3.0 - 2.0 * share);
    let [x, y, z, pitch_deg] = [0, 1, 2, 3].map(|part| from[part] + share * (to[part] - from[part]));
    let orientation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), pitch_deg.to_radians());
    Pose { position_m: Vector3::new(x, y, z), orientation }
}

/// Powder that rests, rides in the bowl, falls, and rests again.
struct Motion {
    bed_m: Vec<Vector3<f64>>,
    /// Of each particle that is carried: its place in the bowl, when it leaves, and how much above the floor it ends.
    carried: Vec<Option<([f64; 3], f64, f64)>>,
    destinations: Vec<Destination>,
}

impl Motion {
    fn new() -> Self {
        let counts = [0, 1, 2].map(|axis| ((BED_M[1][axis] - BED_M[0][axis]) / SPACING_M).round() as usize);
        let cells = (0..counts[2])
            .flat_map(|k| (0..counts[1]).flat_map(move |j| (0..counts[0]).map(move |i| [i, j, k])));
        let place = |(index, cell): (usize, [usize; 3])| {
            let along = |axis: usize| cell[axis] as f64 + 0.1 + 0.8 * random(3 * index + axis);
            Vector3::from([0, 1, 2].map(|axis| BED_M[0][axis] + SPACING_M * along(axis)))
        };
        let bed_m: Vec<_> = cells.enumerate().map(place).collect();
        let scooped = tool(SCOOPED_S);
        let carried: Vec<_> = bed_m
            .iter()
            .enumerate()
            .map(|(index, at)| {
                let inside = scooped.tool_from_world(at);
                // The bed's surface lies below the rim: what the bowl takes along is heaped a little.
                let rises = Vector3::new(inside.x, inside.y, inside.z + 0.006);
                let is_in = inside.norm() < BOWL_M - 0.0012 && rises.norm() < 1.6 * BOWL_M;
                let leaves_s = 3.75
                    + 0.5 * random(7 * index + 1)
                    + 20.0 * (rises.x.mul_add(-1.0, BOWL_M) * 0.25).max(0.0) * 0.1;
                is_in.then_some((rises.into(), leaves_s, 0.004 + 0.008 * random(11 * index).powi(2)))
            })
            .collect();
        let destination = |(index, carried): (usize, &Option<_>)| match carried {
            None => Destination::Source,
            Some(_) if index % 97 == 0 => Destination::Spilled,
            Some(_) if index % 29 == 0 => Destination::Tool,
            Some(_) => Destination::Target,
        };
        let destinations = carried.iter().enumerate().map(destination).collect();
        Self { bed_m, carried, destinations }
    }

    /// Place in metres and velocity in m/s of a particle.
    fn at(&self, particle: usize, time_s: f64) -> ([f32; 3], [f32; 3]) {
        let step = 1e-4;
        let now = self.place(particle, time_s);
        let velocity = (now - self.place(particle, time_s - step)) / step;
        let single = |vector: Vector3<f64>| <[f64; 3]>::from(vector).map(|part| part as f32);
        (single(now), single(velocity))
    }

    fn place(&self, particle: usize, time_s: f64) -> Vector3<f64> {
        let bed = self.bed_m[particle];
        let Some((in_bowl, leaves_s, rests_m)) = self.carried[particle] else {
            return self.pushed(bed, time_s);
        };
        let in_bowl = Vector3::from(in_bowl);
        let ride = |time_s: f64| tool(time_s).world_from_tool(&in_bowl);
        if time_s < SCOOPED_S {
            let share = (time_s / SCOOPED_S).clamp(0.0, 1.0).powi(8);
            return bed.lerp(&ride(SCOOPED_S), share);
        }
        if time_s < leaves_s || self.destinations[particle] == Destination::Tool {
            return ride(time_s);
        }
        let fell_s = time_s - leaves_s;
        let from = ride(leaves_s);
        let aside = if self.destinations[particle] == Destination::Spilled { -0.045 } else { 0.0 };
        let land = Vector3::new(TARGET_M[0] + aside, TARGET_M[1], 0.0)
            + Vector3::new(0.05 * (random(5 * particle) - 0.5), 0.05 * (random(9 * particle) - 0.5), 0.0);
        let rests_m = if aside < 0.0 { 0.001 } else { rests_m };
        let lasts_s = (2.0 * (from.z - rests_m) / 9.81).sqrt();
        let share = (fell_s / lasts_s).min(1.0);
        let height = (from.z - 0.5 * 9.81 * fell_s * fell_s).max(rests_m);
        Vector3::new(from.x + share * (land.x - from.x), from.y + share * (land.y - from.y), height)
    }

    /// Powder that stays makes way for the bowl, and fills the hole in part.
    fn pushed(&self, bed: Vector3<f64>, time_s: f64) -> Vector3<f64> {
        let hole = tool(SCOOPED_S).position_m;
        let aside = ((bed.x - hole.x).powi(2) + (bed.y - hole.y).powi(2)).sqrt();
        let share = ((time_s - 1.0) / 1.2).clamp(0.0, 1.0);
        let heap = 0.003 * (-((aside - 0.024) / 0.005).powi(2)).exp() * (bed.z - BED_M[0][2]) / 0.02;
        bed + Vector3::z() * (heap * 0.5 * (1.0 - (PI * share).cos()))
    }
}

/// From 0 to 1, always the same for a number.
fn random(number: usize) -> f64 {
    let bits = (number as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let bits = (bits ^ bits >> 31).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (bits >> 11) as f64 / (1u64 << 53) as f64
}
