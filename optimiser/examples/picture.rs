//! Draws the picture in the README: the bench from the side at four moments of a simulated skill.
//!
//! ```text
//! cargo run --release -p powderline-optimiser --example picture > optimiser/guide/bench.svg
//! ```
//!
//! Each dot is a simulated particle within [`SLICE_M`] of the plane that the tool moves in. Same bytes on every run.

use std::fmt::Write as _;

use nalgebra::Vector3;
use powderline_shared::pose::Pose;
use powderline_simulator::rollout::{Simulate, Simulator, SimulatorSettings};
use powderline_simulator::scene::{ContainerShape, Scene, ToolShape};
use powderline_simulator::skill::{SegmentKind, SkillMap, Theta};

/// A deep scoop that pours well before the end.
const THETA: [f64; 5] = [0.9, -0.35, 0.39, 0.07, 0.23];

/// Half the thickness of the drawn slice, metres.
const SLICE_M: f64 = 0.004;

/// Moments: a name, a segment, and how much of it has passed.
const MOMENTS: [(&str, SegmentKind, f64); 4] = [
    ("scoop", SegmentKind::Scoop, 0.5),
    ("lift", SegmentKind::Lift, 1.0),
    ("transport", SegmentKind::Transport, 0.6),
    ("pour", SegmentKind::Pour, 0.8),
];

/// Drawing units in a metre.
const UNITS_PER_M: f64 = 10_000.0;

/// Lowest and highest drawn x and z, metres.
const VIEW_X_M: [f64; 2] = [0.008, 0.232];
const VIEW_Z_M: [f64; 2] = [-0.004, 0.166];

/// Room between two views, metres.
const GAP_M: f64 = 0.006;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scene = Scene::load("bench")?;
    let (map, theta) = (SkillMap::new(&scene), Theta::new(THETA)?);
    let controls = map.quantise(&theta)?.controls;
    let settings = SimulatorSettings::default();
    let mut simulator = Simulator::<f32>::new(&scene, &settings)?;
    let mut svg = String::new();
    open(&mut svg)?;
    for (place, (name, kind, share)) in MOMENTS.into_iter().enumerate() {
        let segments = map.segments(&theta);
        let span = segments.iter().find(|span| span.kind == kind).ok_or("the skill has no such segment")?;
        let time_s = span.start_s + share * (span.end_s - span.start_s);
        let steps = (time_s / scene.time.control_period_s()).round() as usize;
        let begun = &controls[..steps.min(controls.len())];
        let tool = begun.iter().fold(*map.start_pose(), |pose, control| pose.displaced(control));
        let positions = simulator.final_positions_m(begun)?;
        let view = View { left_m: place as f64 * (VIEW_X_M[1] - VIEW_X_M[0] + GAP_M) - VIEW_X_M[0] };
        view.draw(&mut svg, &scene, &tool, &positions)?;
        let [x, y] = view.at(VIEW_X_M[0] + 0.004, VIEW_Z_M[1] - 0.012);
        writeln!(svg, r#"<text x="{x}" y="{y}">{name}, {time_s:.1} s</text>"#)?;
    }
    svg.push_str("</svg>\n");
    print!("{svg}");
    Ok(())
}

fn open(svg: &mut String) -> std::fmt::Result {
    let count = MOMENTS.len() as f64;
    let width_m = count * (VIEW_X_M[1] - VIEW_X_M[0]) + (count - 1.0) * GAP_M;
    let [width, height] = [width_m, VIEW_Z_M[1] - VIEW_Z_M[0]].map(units);
    writeln!(svg, r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img">"#)?;
    writeln!(svg, "<title>A bowl scoops powder out of a box, carries it and pours it into another</title>")?;
    writeln!(
        svg,
        "<style>.powder{{fill:none;stroke:#b7791f;stroke-width:17;stroke-linecap:round}}.box{{fill:#94a3b8}}\
         .tool{{fill:#1e3a5f}}.handle{{stroke:#1e3a5f;stroke-linecap:round}}\
         text{{font:90px sans-serif;fill:#334155}}</style>"
    )?;
    writeln!(svg, r##"<rect width="{width}" height="{height}" fill="#fff"/>"##)
}

/// One of the side views.
struct View {
    /// What is added to x, metres.
    left_m: f64,
}

impl View {
    /// Where a point in the tool's plane is drawn.
    fn at(&self, x_m: f64, z_m: f64) -> [i64; 2] {
        [x_m + self.left_m, VIEW_Z_M[1] - z_m].map(units)
    }

    fn draw(&self, svg: &mut String, scene: &Scene, tool: &Pose, positions: &[[f64; 3]]) -> std::fmt::Result {
        let [[left, ground], [right, bottom]] =
            [self.at(VIEW_X_M[0], 0.0), self.at(VIEW_X_M[1], VIEW_Z_M[0])];
        let (width, height) = (right - left, bottom - ground);
        writeln!(
            svg,
            r##"<rect x="{left}" y="{ground}" width="{width}" height="{height}" fill="#cbd5e1"/>"##
        )?;
        for container in &scene.containers {
            let (half, height) = match container.shape {
                ContainerShape::Box { inner_size_m } | ContainerShape::SlottedBox { inner_size_m, .. } => {
                    (0.5 * inner_size_m[0], inner_size_m[2])
                }
                ContainerShape::Cylinder { inner_radius_m, inner_height_m }
                | ContainerShape::Silo { inner_radius_m, inner_height_m, .. }
                | ContainerShape::Hopper { inner_radius_m, inner_height_m, .. } => {
                    (inner_radius_m, inner_height_m)
                }
            };
            let (wall, [x, _, z]) = (container.wall_thickness_m, container.position_m);
            let outline = open_box(-half, half, height, wall).map(|[along, up]| self.at(x + along, z + up));
            polygon(svg, "box", &outline)?;
        }
        self.powder(svg, tool.position_m.y, positions)?;
        self.tool(svg, scene, tool)
    }

    /// All particles as one path of dots.
    fn powder(&self, svg: &mut String, plane_m: f64, positions: &[[f64; 3]]) -> std::fmt::Result {
        svg.push_str(r#"<path class="powder" d=""#);
        for [x, y, z] in positions {
            if (y - plane_m).abs() <= SLICE_M {
                let [x, y] = self.at(*x, *z);
                write!(svg, "M{x} {y}h0")?;
            }
        }
        writeln!(svg, r#""/>"#)
    }

    fn tool(&self, svg: &mut String, scene: &Scene, pose: &Pose) -> std::fmt::Result {
        let place = |[x, z]: [f64; 2]| {
            let point = pose.position_m + pose.orientation * Vector3::new(x, 0.0, z);
            self.at(point.x, point.z)
        };
        let [near, far] = scene.tool.handle_axis_m().map(|[x, _, z]| place([x, z]));
        let ([x1, y1], [x2, y2]) = (near, far);
        let width = units(2.0 * scene.tool.handle.radius_m);
        writeln!(
            svg,
            r#"<line class="handle" x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}" stroke-width="{width}"/>"#
        )?;
        let wall = scene.tool.wall_thickness_m;
        let outline = match scene.tool.shape {
            ToolShape::Bowl { inner_radius_m } => [inner_radius_m, inner_radius_m + wall]
                .into_iter()
                .zip([false, true])
                .flat_map(|(radius, back)| half_circle(radius, back))
                .map(place)
                .collect::<Vec<_>>(),
            ToolShape::BoxScoop { inner_size_m: [length, _, height] } => {
                // Open at the front, so the floor ends there without a wall.
                let (rear, front) = (-0.5 * length, 0.5 * length);
                [
                    [rear - wall, 0.0],
                    [rear - wall, -height - wall],
                    [front, -height - wall],
                    [front, -height],
                    [rear, -height],
                    [rear, 0.0],
                ]
                .map(place)
                .to_vec()
            }
            // The benches that are drawn here have none.
            _ => return Ok(()),
        };
        polygon(svg, "tool", &outline)
    }
}

/// A box open at the top, from the side; its inner floor is at 0.
fn open_box(left: f64, right: f64, height: f64, wall: f64) -> [[f64; 2]; 8] {
    [
        [left - wall, height],
        [left - wall, -wall],
        [right + wall, -wall],
        [right + wall, height],
        [right, height],
        [right, 0.0],
        [left, 0.0],
        [left, height],
    ]
}

/// The lower half of a circle, from one end to the other.
fn half_circle(radius: f64, back: bool) -> impl Iterator<Item = [f64; 2]> {
    const CORNERS: u32 = 24;
    (0..=CORNERS).map(move |corner| {
        let part = f64::from(if back { CORNERS - corner } else { corner }) / f64::from(CORNERS);
        let (sin, cos) = (std::f64::consts::PI * part).sin_cos();
        [-radius * cos, -radius * sin]
    })
}

fn polygon(svg: &mut String, class: &str, corners: &[[i64; 2]]) -> std::fmt::Result {
    write!(svg, r#"<polygon class="{class}" points=""#)?;
    for [x, y] in corners {
        write!(svg, "{x},{y} ")?;
    }
    writeln!(svg, r#""/>"#)
}

fn units(metres: f64) -> i64 {
    (metres * UNITS_PER_M).round() as i64
}
