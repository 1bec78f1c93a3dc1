//! Pages of made-up motions, for the browser's test: `cargo run -p powderline-view --example page -- FOLDER`.
//!
//! `replay.html` shows powder that a bowl carries from a box to a round container, `curves.html` has no replay. Where
//! particle 0 is at which time is known in closed form: see [`carried`].

use std::f64::consts::{PI, TAU};
use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use powderline_shared::arm::ArmModel;
use powderline_shared::limits::Limits;
use powderline_shared::pose::Pose;
use powderline_simulator::arm::{ArmMotion, CYCLE_US, Mount, Surroundings, ToolPath};
use powderline_simulator::scene::{GateOpening, GateShape};
use powderline_simulator::skill::LSB;
use powderline_view::arm::Arm;
use powderline_view::extent::Extent;
use powderline_view::mesh::Mesh;
use powderline_view::page::{
    Chart, Figure, Heat, HeatMap, Mark, Page, Recorder, Row, Scale, Series, Table, Tone,
};
use powderline_view::{Bench, Container, Destination, Frame, Gate, Role, Sink, ViewError};

const PARTICLES: usize = 12_500;
const FRAMES: usize = 500;
const PERIOD_S: f64 = 0.01;
const SIZE_M: [f64; 3] = [0.48, 0.24, 0.3];
const SOURCE_M: [f64; 3] = [0.13, 0.12, 0.004];
const TARGET_M: [f64; 3] = [0.36, 0.12, 0.004];
const PLATE_M: [f64; 3] = [0.25, 0.12, 0.0];

fn main() -> Result<(), ViewError> {
    let folder = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| ".".into()));
    replay(&folder.join("replay.html"))?;
    curves(&folder.join("curves.html"))
}

/// A page with everything.
fn replay(path: &Path) -> Result<(), ViewError> {
    let way: Vec<Pose> = (0..FRAMES).map(|index| tool(index as f64 * PERIOD_S, 1.0)).collect();
    let bench = bench().framed(&way);
    let mut recorder = Recorder::new(&bench);
    for index in 0..FRAMES {
        let time_s = index as f64 * PERIOD_S;
        let (positions_m, velocities_m_s) = powder(time_s);
        recorder.frame(&Frame {
            index,
            time_s,
            tool: tool(time_s, 1.0),
            planned: Some(tool(time_s, 0.0)),
            positions_m: &positions_m,
            velocities_m_s: &velocities_m_s,
        })?;
    }
    recorder.finish(&(0..PARTICLES).map(destination).collect::<Vec<_>>())?;
    let page = Page {
        title: "Scoop & pour, as the arm executed it".into(),
        verdict: Some((Tone::Bad, "Misses the wanted amount by 7 %.".into())),
        figures: vec![
            Figure::new("Wanted", "9.60 g").with_note("1,200 particles"),
            Figure::new("Arrives", "8.93 g").with_note("1,116 particles"),
            Figure::new("Error", "-7 %").toned(Tone::Bad),
            Figure::new("Spilled", "0.10 g").with_note("12 particles"),
        ],
        replay: recorder.into_replay(),
        replay_shows: "The plan as the arm executed it, and the planned motion as a drawing: epoch 26, seed 1.".into(),
        charts: run_charts(),
        heat_maps: Vec::new(),
        tables: vec![skill(), epochs()],
        facts: facts(),
        notes: vec![
            "The powder of this page is no simulation: its particles follow formulas, so that a test can tell whether \
             the page shows them where they are."
                .into(),
            "Names may hold anything: </script><b>\"bold\"</b> & 'more'.".into(),
        ],
    };
    page.write(path)
}

/// A page that compares, without a replay.
fn curves(path: &Path) -> Result<(), ViewError> {
    let page = Page {
        title: "Methods compared".into(),
        figures: vec![
            Figure::new("Scene", "made up"),
            Figure::new("Seeds", "5"),
            Figure::new("Simulations", "30 each"),
            Figure::new("Best method's error", "+0.2 %").toned(Tone::Good),
        ],
        charts: comparison_charts(),
        heat_maps: vec![misses()],
        tables: vec![methods()],
        ..Page::default()
    };
    page.write(path)
}

fn misses() -> HeatMap {
    let heat =
        |text: &str, tone, strength| Some(Heat { text: text.into(), note: "3 seeds".into(), tone, strength });
    HeatMap {
        title: "Miss, the median of each cell".into(),
        axes: ["powder", "amount"].map(String::from),
        columns: ["100 mg", "200 mg", "400 mg", "800 mg"].map(String::from).into(),
        rows: vec![
            (
                "sugar".into(),
                vec![
                    heat("+1.2 %", Tone::Good, 1.0),
                    heat("-4 %", Tone::Bad, 0.2),
                    heat("-31 %", Tone::Bad, 1.0),
                    None,
                ],
            ),
            (
                "<flour> & co".into(),
                vec![heat("0 %", Tone::Plain, 0.0), None, heat("+12 %", Tone::Plain, 0.6), None],
            ),
        ],
    }
}

fn bench() -> Bench {
    let at = |[x, y, z]: [f64; 3]| Isometry3::translation(x, y, z);
    let source = Mesh::open_box([0.15, 0.12, 0.06], 0.004).moved(&at(SOURCE_M));
    let target = Mesh::open_cylinder(0.055, 0.06, 0.004).moved(&at(TARGET_M));
    Bench {
        name: "a made-up bench".into(),
        size_m: SIZE_M,
        extent: Extent::of_volume(SIZE_M),
        cell_m: 0.005,
        containers: vec![
            Container { name: "box".into(), role: Role::Source, mesh: source },
            Container { name: "beaker".into(), role: Role::Target, mesh: target },
        ],
        gates: gates(),
        tool: Mesh::bowl(0.03, 0.002).and(Mesh::capsule([0.0, 0.032, 0.0], [0.0, 0.09, 0.06], 0.004)),
        arm: Some(arm()),
        target_m: TARGET_M,
        particles: PARTICLES,
        period_s: PERIOD_S,
        frames: FRAMES,
    }
}

/// A UR5e beyond the edge y = 0 that does what the tool does.
fn arm() -> Arm {
    let model = ArmModel::bench();
    let world_from_base = Pose { position_m: Vector3::new(0.38, -0.8, -0.1), ..model.world_from_base };
    let ArmModel { kind, flange_from_tool, posture, .. } = model;
    let mount = Mount {
        kind,
        world_from_base,
        flange_from_tool,
        posture: Some(posture),
        near: None,
        clearance_m: None,
    };
    let poses = (0..FRAMES).map(|index| tool(index as f64 * PERIOD_S, 1.0)).collect();
    let any = 1e6;
    let limits = Limits {
        workspace_min_m: [-any; 3],
        workspace_max_m: [any; 3],
        linear_velocity_m_s: any,
        linear_acceleration_m_s2: any,
        linear_jerk_m_s3: any,
        angular_velocity_rad_s: any,
        angular_acceleration_rad_s2: any,
        angular_jerk_rad_s3: any,
    };
    let path = ToolPath { period_us: (1e6 * PERIOD_S) as u32, lsb: LSB, limits, poses };
    let motion =
        ArmMotion::new(&path, &mount, &Surroundings::table(-0.1), CYCLE_US).expect("within its reach");
    Arm { motion, path, table_m: -0.1, held_m: [0.0, 0.09, 0.06], bracket_radius_m: 0.004 }
}

/// A pipe that is gone after 1.2 s, and a plate that slides towards the reader for a second after 2 s.
fn gates() -> Vec<Gate> {
    let gate = |name: &str, opens_at_s, position_m: [f64; 3], shape, opening, mesh: Mesh| {
        let [x, y, z] = position_m;
        let name = name.into();
        let law = powderline_simulator::scene::Gate {
            name,
            position_m,
            yaw_deg: 0.0,
            friction: 0.4,
            opens_at_s,
            shape,
            opening,
        };
        Gate { law, mesh: mesh.moved(&Isometry3::translation(x, y, z)) }
    };
    let pipe = GateShape::Tube { inner_radius_m: 0.03, height_m: 0.05, wall_thickness_m: 0.004 };
    let plate = GateShape::Box { size_m: [0.004, 0.12, 0.1] };
    let slide = GateOpening::Slide { velocity_m_s: [0.0, -0.06, 0.0], travel_m: 0.06 };
    vec![
        gate("pipe", 1.2, TARGET_M, pipe, GateOpening::Vanish {}, Mesh::pipe(0.03, 0.05, 0.004)),
        gate("slide", 2.0, PLATE_M, plate, slide, Mesh::block([-0.002, -0.06, 0.0], [0.002, 0.06, 0.1])),
    ]
}

/// From 0 to 1 between two times, gently.
fn eased(time_s: f64, from_s: f64, to_s: f64) -> f64 {
    let share = ((time_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0);
    0.5 - 0.5 * (PI * share).cos()
}

/// Down into the powder, up, across, and over; an arm that is not perfect does it `off` its plan.
fn tool(time_s: f64, off: f64) -> Pose {
    let late_s = time_s - 0.06 * off;
    let down = eased(late_s, 0.2, 1.0) - eased(late_s, 1.4, 2.2);
    let across = eased(late_s, 2.0, 3.3);
    let wobble_m = 0.004 * off * (TAU * time_s).sin();
    let position_m = Vector3::new(
        SOURCE_M[0] + across * (TARGET_M[0] - SOURCE_M[0] - 0.02),
        SOURCE_M[1] + wobble_m,
        0.14 - 0.09 * down + 0.5 * wobble_m,
    );
    let turn = 2.1 * eased(late_s, 3.4, 4.5) - 0.5 * down;
    Pose { position_m, orientation: UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turn) }
}

/// A number between 0 and 1 for each particle and purpose, always the same.
fn chance(particle: usize, purpose: usize) -> f64 {
    let mixed = (particle * 3 + purpose + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15_u64 as usize);
    ((mixed ^ (mixed >> 31)).wrapping_mul(0xbf58_476d_1ce4_e5b9_u64 as usize) >> 40) as f64
        / (1_u64 << 24) as f64
}

fn is_carried(particle: usize) -> bool {
    particle.is_multiple_of(7)
}

fn destination(particle: usize) -> Destination {
    match particle {
        _ if !is_carried(particle) => Destination::Source,
        _ if particle.is_multiple_of(91) => Destination::Spilled,
        _ if particle.is_multiple_of(63) => Destination::Tool,
        _ => Destination::Target,
    }
}

fn powder(time_s: f64) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let step_s = 1e-4;
    let each = (0..PARTICLES).map(|particle| {
        let (now, next) = (place(particle, time_s), place(particle, time_s + step_s));
        let velocity = (next - now) / step_s;
        (<[f64; 3]>::from(now).map(|x| x as f32), <[f64; 3]>::from(velocity).map(|x| x as f32))
    });
    each.unzip()
}

fn place(particle: usize, time_s: f64) -> Vector3<f64> {
    if is_carried(particle) { carried(particle, time_s) } else { resting(particle) }
}

/// A heap in the box.
fn resting(particle: usize) -> Vector3<f64> {
    let [x, y] = [0.146 * (chance(particle, 0) - 0.5), 0.116 * (chance(particle, 1) - 0.5)];
    let top_m = 0.03 + 0.006 * (40.0 * x).cos() * (30.0 * y).cos();
    Vector3::from(SOURCE_M) + Vector3::new(x, y, top_m * chance(particle, 2).powf(0.9))
}

/// In the box, then in the bowl, then falling, then in the beaker, on the floor or still in the bowl.
fn carried(particle: usize, time_s: f64) -> Vector3<f64> {
    let [a, b, c] = [0, 1, 2].map(|purpose| chance(particle, purpose));
    // Particle 0 lies in the bowl's lowest point.
    let (radius_m, depth_m) = if particle == 0 { (0.0, 0.03) } else { (0.026 * a.sqrt(), 0.005 + 0.02 * c) };
    let radius_m = radius_m * (1.0 - (depth_m / 0.03).powi(2)).max(0.0).sqrt();
    let in_tool = Vector3::new(radius_m * (TAU * b).cos(), radius_m * (TAU * b).sin(), -depth_m);
    let scooped = tool(time_s, 1.0).world_from_tool(&in_tool);
    let at_first = Vector3::from(SOURCE_M) + Vector3::new(0.05 * (a - 0.5), 0.05 * (b - 0.5), 0.028 * c);
    let held = at_first.lerp(&scooped, eased(time_s, 0.9, 1.3));
    let leaves_s = 3.9 + 0.4 * b;
    if time_s < leaves_s || destination(particle) == Destination::Tool {
        return held;
    }
    let from = tool(leaves_s, 1.0).world_from_tool(&in_tool);
    fallen(particle, from, time_s - leaves_s)
}

fn fallen(particle: usize, from: Vector3<f64>, seconds: f64) -> Vector3<f64> {
    let [a, b, c] = [0, 1, 2].map(|purpose| chance(particle, purpose));
    let spilled = destination(particle) == Destination::Spilled;
    let radius_m = if spilled { 0.075 + 0.02 * a } else { 0.05 * a.sqrt() };
    let height_m = if spilled { 0.001 } else { TARGET_M[2] + 0.02 * c };
    let to = Vector3::new(
        TARGET_M[0] + radius_m * (TAU * b).cos(),
        TARGET_M[1] + radius_m * (TAU * b).sin(),
        height_m,
    );
    let falls_s = (2.0 * (from.z - to.z).max(0.0) / 9.81).sqrt();
    let share = (seconds / falls_s.max(1e-3)).min(1.0);
    let across = from.lerp(&to, share);
    Vector3::new(across.x, across.y, from.z - (from.z - to.z) * share * share)
}

/// From one value to another, ever slower, over 30 epochs.
fn curve(from: f64, to: f64, rate: f64) -> Vec<[f64; 2]> {
    (0..=30).map(f64::from).map(|x| [x, to + (from - to) * (-rate * x).exp()]).collect()
}

fn marked(chart: Chart) -> Chart {
    let handle = "the tool's handle would pass through container \"beaker\" at 3.21 s";
    let speed = "angular velocity 1.62 rad/s in tick 301, more than the limit of 1.57 rad/s";
    chart
        .marked(26.0, Mark::shipped())
        .marked(28.0, Mark::passed_over(handle))
        .marked(29.0, Mark::passed_over(speed))
        .shaded(0.0, 15.0, "only depth, angle and lift change")
}

fn run_charts() -> Vec<Chart> {
    let transported: Vec<_> = curve(15.0, 1120.0, 0.15).into_iter().map(|[x, y]| [x, y.round()]).collect();
    let parameter = |index: usize, name: &str, from: f64, to: f64| {
        Series::new(name, curve(from, to, 0.12)).coloured(index)
    };
    let lengths = vec![
        parameter(0, "scooping depth", 12.0, 14.25),
        parameter(2, "lift height", 61.0, 68.0),
        parameter(3, "transport displacement", 230.0, 222.5),
    ];
    let angles = vec![parameter(1, "scooping angle", 55.0, 71.0), parameter(4, "pouring angle", 80.0, 110.0)];
    let mut gap = curve(0.3, -0.62, 0.1);
    gap[12][1] = f64::NAN;
    let charts = vec![
        Chart::new("Loss", "epoch", "loss, m", vec![Series::new("loss", curve(95.5, 3.4, 0.25))])
            .scaled(Scale::LogIfWide),
        Chart::new(
            "Arriving",
            "epoch",
            "particles",
            vec![
                Series::new("arriving", transported),
                Series::reference("wanted", curve(1200.0, 1200.0, 1.0)),
            ],
        ),
        Chart::new("Skill: lengths", "epoch", "mm", lengths),
        Chart::new("Skill: angles", "epoch", "degrees", angles),
        Chart::new(
            "Weight of the adjoint",
            "epoch",
            "weight, 0 to 1",
            vec![Series::new("with a gap", gap), Series::new("another", curve(0.0, 0.004, 0.3))],
        ),
    ];
    // Far from one, on both sides.
    let far = [("Gradient", "m", 1.4e7, -2e6), ("Smallest weight", "0 to 1", 7e-6, 0.0)].map(
        |(title, unit, from, to)| {
            Chart::new(title, "epoch", unit, vec![Series::new("far", curve(from, to, 0.3))])
        },
    );
    charts.into_iter().chain(far).map(marked).collect()
}

fn comparison_charts() -> Vec<Chart> {
    let banded = |name: &str, points: Vec<[f64; 2]>, half: f64| Series {
        name: name.into(),
        band: Some(
            points.iter().map(|[x, y]| [y - half * (1.0 + x / 30.0), y + half * (1.0 + x / 20.0)]).collect(),
        ),
        points,
        ..Series::default()
    };
    let by_rollouts = |points: Vec<[f64; 2]>| points.iter().map(|[x, y]| [x * 3.63, *y]).collect();
    let names =
        ["gradient", "gradient-curriculum", "gradient-adjoint", "sac", "cma-es", "random", "a seventh"];
    let many = (0_u8..).zip(names).map(|(index, name)| {
        let index = f64::from(index);
        banded(name, by_rollouts(curve(95.0, 1.5 + 3.0 * index, 0.25 - 0.02 * index)), 1.2 + index)
    });
    vec![
        Chart::new(
            "Loss by method",
            "epoch",
            "loss, m",
            vec![
                banded("gradient", curve(1344.6, 1218.9, 0.2), 6.0),
                banded("cma-es", curve(1344.6, 1236.0, 0.09), 14.0),
                Series::new("random", curve(1344.6, 1290.0, 0.05)),
            ],
        ),
        Chart::new("Lowest loss so far", "rollouts", "loss, m", many.collect()).scaled(Scale::LogIfWide),
    ]
}

fn texts(texts: &[&str]) -> Vec<String> {
    texts.iter().map(|text| (*text).into()).collect()
}

fn methods() -> Table {
    let row = |cells: &[&str]| Row::from(texts(cells));
    Table {
        title: "Methods, median of 5 seeds".into(),
        columns: texts(&["Method", "Loss, m", "In the target", "Spilled", "Seconds", "Remark"]),
        rows: vec![
            row(&["gradient", "1218.9", "1,389", "12", "860", "one adjoint an update"])
                .marked(Some(Mark::replayed())),
            row(&["cma-es", "1236.0", "1,102", "31", "1,410", "population of 8"]),
            row(&["random", "1290.2", "512", "4", "1,395", "–"]),
        ],
    }
}

fn skill() -> Table {
    let rows = [["scooping depth", "14.2 mm", "0.1245"], ["scooping angle", "71.0 deg", "-0.7000"]];
    Table {
        title: "Skill".into(),
        columns: texts(&["parameter", "value", "theta"]),
        rows: rows.map(|row| texts(&row).into()).into(),
    }
}

fn epochs() -> Table {
    let (loss, arrived) = (curve(95.5, 3.4, 0.25), curve(15.0, 1120.0, 0.15));
    let mark = |epoch: f64| {
        run_charts()[0].marks.iter().find(|(x, _)| (x - epoch).abs() < 0.5).map(|(_, mark)| mark.clone())
    };
    let row = |([epoch, loss], [_, arrived]): (&[f64; 2], &[f64; 2])| {
        let error = format!("{:.1} % too little", 100.0 - arrived / 12.0);
        let [grams, particles] = [format!("{:.3} g", 0.008 * arrived), format!("{arrived:.0}")];
        let cells = texts(&[
            &epoch.to_string(),
            &grams,
            &particles,
            &error,
            "0.096 g",
            &format!("{loss:.3}"),
            "32.6",
        ]);
        Row::from(cells).marked(mark(*epoch))
    };
    Table {
        title: "Epochs".into(),
        columns: texts(&["epoch", "arrives", "particles", "error", "spilled", "loss, m", "seconds"]),
        rows: loss.iter().zip(&arrived).map(row).collect(),
    }
}

fn facts() -> Vec<(String, String)> {
    let facts = [
        ("Scene", "a made-up bench, seed 1, f32"),
        ("Powder", "12,500 particles of 0.008 g; friction angle 35 deg, no cohesion"),
        (
            "Limits used",
            "linear velocity 85 %, acceleration 81 %, jerk 64 %; angular velocity 90 %, jerk 32 %",
        ),
        ("Plan's digest", "3f1c9a5be0d24476a1c83b90d5f7e62248aa0b1dc5f3e79a6b4d2210f8c7e591"),
        ("Made by", "optimise 0.1.0"),
        ("Date", "2024-05-01 12:00 UTC"),
    ];
    facts.map(|(name, value)| (name.into(), value.into())).into()
}
