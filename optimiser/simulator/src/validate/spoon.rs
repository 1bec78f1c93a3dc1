//! Spoons that are filled until powder runs over: what they hold, beside geometry.
//!
//! A pipe full of powder stands 4 mm above the spoon. It is drawn up, and powder flows from below it until the heap on the spoon is as
//! steep as it gets and the rest runs over the edge.

use powderline_shared::pose::{Pose, exp_so3};

use crate::rollout::path::resting;
use crate::scene::{Gate, GateOpening, GateShape, Scene, SceneSpec, ToolShape};
use crate::validate::Scope;
use crate::validate::case::{Case, Claim, Halt, Meter};
use crate::validate::rig::{Rig, apparatus, fall_speed, packed_cylinder, set_time_step};

/// Where the spoon stands, m.
const PLACE_M: [f64; 3] = [0.064, 0.064, 0.075];
/// Inner radius of the pipe above it, the length of the powder in it, and from the spoon's edge to the pipe, m.
const PIPE_M: f64 = 0.008;
const COLUMN_M: f64 = 0.096;
const GAP_M: f64 = 0.004;
/// When the pipe is drawn up, s, how fast, m/s, and how far, m.
const SETTLE_S: f64 = 0.2;
const SPEED_M_S: f64 = 0.02;
const TRAVEL_M: f64 = 0.04;
/// From then on until it is looked at, s: when the last of it has run over, and when the heap has come to rest. Powder on a tool never
/// sleeps, and while it is awake its heap flattens.
const REST_S: [f64; 2] = [0.6, 3.6];
/// What is no farther below the spoon's middle is on it, m.
const ON_IT_M: f64 = 0.03;

/// A kind of spoon.
struct Spoon {
    name: &'static str,
    shape: ToolShape,
    /// Half its width, m.
    half_m: f64,
    /// Cells of each line: in words, and per half the width.
    cells: &'static [(&'static str, f64)],
    /// It leans back by so much, degrees.
    leans_deg: f64,
}

static SPOONS: [Spoon; 2] = [
    Spoon {
        name: "bowl",
        shape: ToolShape::Bowl { inner_radius_m: 0.016 },
        half_m: 0.016,
        cells: &[
            ("4 cells per radius", 4.0),
            ("6 cells per radius", 6.0),
            ("8 cells per radius", 8.0),
            ("12 cells per radius", 12.0),
        ],
        leans_deg: 0.0,
    },
    Spoon {
        name: "scoop",
        shape: ToolShape::BoxScoop { inner_size_m: [0.024, 0.024, 0.014] },
        half_m: 0.012,
        cells: &[("6 cells across", 3.0), ("9 cells across", 4.5), ("12 cells across", 6.0)],
        leans_deg: 20.0,
    },
];

/// A spoon that is so many cells from its middle to its edge, below the pipe.
fn set_up(law: &SceneSpec, spoon: &Spoon, cells: f64) -> Scene {
    let [x, y, z] = PLACE_M;
    let cell_m = spoon.half_m / cells;
    let mut scene = apparatus(law, [2.0 * x, 2.0 * y, z + GAP_M + COLUMN_M + TRAVEL_M], cell_m);
    scene.arm = None;
    scene.tool.shape = spoon.shape.clone();
    scene.tool.wall_thickness_m = 0.004;
    scene.tool.friction = 0.4;
    // What it holds by geometry is that at the angles that a skill may have.
    scene.tool.start_pitch_deg = 0.0;
    scene.skill.scooping_angle_deg = [spoon.leans_deg; 2];
    let opening = GateOpening::Slide { velocity_m_s: [0.0, 0.0, SPEED_M_S], travel_m: TRAVEL_M };
    scene.gates.push(Gate {
        name: "pipe".into(),
        position_m: [x, y, z + GAP_M],
        yaw_deg: 0.0,
        friction: 0.0,
        opens_at_s: SETTLE_S,
        shape: GateShape::Tube { inner_radius_m: PIPE_M, height_m: COLUMN_M, wall_thickness_m: 0.002 },
        opening,
    });
    set_time_step(&mut scene, fall_speed(z + GAP_M));
    scene.unchecked()
}

/// Powder in the pipe, m^3.
const POURED_M3: f64 = core::f64::consts::PI * PIPE_M * PIPE_M * COLUMN_M;

/// When the pipe is up, s.
const POURED_S: f64 = SETTLE_S + TRAVEL_M / SPEED_M_S;

/// What stays on it, kg, so many seconds after the pipe is up.
fn held_kg(
    scene: &Scene,
    leans_deg: f64,
    after_s: &[f64],
    seed: u64,
    meter: &Meter<'_>,
) -> Result<Vec<f64>, Halt> {
    let [x, y, z] = PLACE_M;
    let powder = packed_cylinder(scene, [x, y, z + GAP_M], PIPE_M, COLUMN_M, seed);
    let turned = exp_so3(&[0.0, -leans_deg.to_radians(), 0.0].into());
    let pose = Pose { position_m: PLACE_M.into(), orientation: turned };
    let mut rig = Rig::<f32>::with_tool((**scene).clone(), &powder, resting(&pose))?;
    rig.run(POURED_S, meter)?;
    let mut since_s = 0.0;
    let looks = after_s.iter().map(|after_s| {
        rig.run(after_s - since_s, meter)?;
        since_s = *after_s;
        let on_it = rig.positions().iter().filter(|p| p[2] > z - ON_IT_M).count();
        Ok(scene.particle_mass_kg() * on_it as f64)
    });
    looks.collect()
}

fn case(law: &SceneSpec, spoon: &'static Spoon, (name, cells): (&str, f64)) -> Case<'static> {
    let scene = set_up(law, spoon, cells);
    let claim = |rest_s: f64| Claim {
        group: "what a spoon holds",
        name: format!("heaped {}, {name}, after {rest_s} s", spoon.name),
        unit: "g",
        reference: 1e3 * scene.tool_capacity().heaped_kg,
        tolerance: [0.0; 2],
        source: "geometry: the highest surface that is nowhere steeper than the friction angle and passes \
                 through the spoon's edge",
        why: "5 %, as the powder's edge is known to half a cell; of the bowl, from 8 cells per radius on, 3 %",
        wrong: ["The spoon holds {} less than by geometry", "The spoon holds {} more than by geometry"],
        control: false,
    };
    let claims = REST_S.map(|rest_s| claim(rest_s).within_share(if cells < 8.0 { 0.05 } else { 0.03 }));
    let seconds = POURED_S + REST_S[1];
    Case {
        claims: claims.into(),
        seeds: 1,
        work: POURED_M3 / scene.particle_volume_m3() * seconds / scene.time.substep_s(),
        measure: Box::new(move |seed, meter| {
            let held = held_kg(&scene, spoon.leans_deg, &REST_S, seed, meter)?;
            Ok(held.into_iter().map(|held_kg| 1e3 * held_kg).collect())
        }),
    }
}

/// Both spoons on cells of several sizes.
pub(super) fn cases(law: &SceneSpec, scope: Scope) -> Vec<Case<'static>> {
    let spoons: &[Spoon] = if scope == Scope::Full { &SPOONS } else { &[] };
    spoons.iter().flat_map(|spoon| spoon.cells.iter().map(|cells| case(law, spoon, *cells))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::DEFAULT_SCENE;

    #[test]
    fn what_stays_on_a_spoon_is_what_fits_on_it() {
        let law = Scene::load(DEFAULT_SCENE).unwrap();
        for spoon in &SPOONS {
            let scene = set_up(&law, spoon, spoon.cells[0].1);
            let geometry = scene.tool_capacity();
            let [first_s, _] = REST_S;
            let held = held_kg(&scene, spoon.leans_deg, &[first_s], 1, &Meter::unwatched()).unwrap()[0];
            // More was there to run over.
            let there = POURED_M3 * scene.powder.density_kg_m3;
            assert!(
                there > 1.2 * held && geometry.heaped_kg > 1.2 * geometry.level_kg,
                "{there} {geometry:?}"
            );
            assert!(held > 1.05 * geometry.level_kg, "{}: {held} {geometry:?}", spoon.name);
            assert!((held / geometry.heaped_kg - 1.0).abs() < 0.2, "{}: {held} {geometry:?}", spoon.name);
        }
    }
}
