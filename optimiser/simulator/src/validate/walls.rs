//! What a thin wall keeps apart: powder behind it from what presses on its front, and powder that falls off its back from the wall.

use crate::scene::{Container, ContainerShape, SceneSpec};
use crate::validate::Scope;
use crate::validate::case::{Case, Claim, Halt, Meter};
use crate::validate::rig::{GRAVITY, Rig, apparatus, packed, set_time_step};

/// Cell, m.
const CELL_M: f64 = 0.004;

/// Where the wall's front would be on the nodes, across the domain, and how deep the bed before it is, m.
const FACE_M: f64 = 0.024;
const DEPTH_M: f64 = 0.024;
const WIDTH_M: f64 = 0.032;
/// The layer behind it, m.
const LAYER_M: f64 = 0.008;

/// Where the wall is, cells off the nodes: what is farthest from the reference counts.
const OFF_CELLS: [f64; 8] = [0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875];

/// Thicknesses, in words and in cells.
const THICKNESSES: [(&str, f64); 3] =
    [("half a cell", 0.5), ("three quarters of a cell", 0.75), ("a cell", 1.0)];

/// How long powder is pressed on the wall, and how long it falls off it, s.
const PRESSED_S: f64 = 0.2;
const FALLS_S: f64 = 0.06;

/// A wall without friction from `face_m` on, so thick.
fn with_wall(law: &SceneSpec, face_m: f64, thickness_m: f64, end_m: f64) -> SceneSpec {
    let mut scene = apparatus(law, [end_m, WIDTH_M, 0.064], CELL_M);
    // Not whole blocks: it ends behind the layer.
    scene.domain.size_m[0] = end_m;
    scene.domain.friction = 0.0;
    scene.containers.push(Container {
        name: "box".into(),
        position_m: [0.5 * (face_m - 0.008), 0.5 * WIDTH_M, 0.0],
        yaw_deg: 0.0,
        wall_thickness_m: thickness_m,
        friction: 0.0,
        shape: ContainerShape::Box { inner_size_m: [face_m + 0.008, WIDTH_M + 0.016, 0.06] },
    });
    set_time_step(&mut scene, 1.0);
    scene
}

/// Pressure that a layer behind the wall feels of a bed that is pressed on its front by gravity at 45 degrees, over that on the front, %.
fn felt_percent(
    law: &SceneSpec,
    face_m: f64,
    thickness_m: f64,
    seed: u64,
    meter: &Meter<'_>,
) -> Result<f64, Halt> {
    let (back, end) = (face_m + thickness_m, face_m + thickness_m + LAYER_M);
    let mut scene = with_wall(law, face_m, thickness_m, end);
    scene.domain.gravity_m_s2 = [GRAVITY, 0.0, -GRAVITY];
    let layer = packed(&scene, [back, 0.0, 0.0], [end, WIDTH_M, LAYER_M], seed);
    let bed = packed(&scene, [0.0; 3], [face_m, WIDTH_M, DEPTH_M], seed);
    // Pressures along x.
    let pressed = |powder: &[[f64; 3]]| -> Result<Vec<([f64; 3], f64)>, Halt> {
        let mut rig = Rig::<f64>::new(scene.clone(), powder)?;
        rig.run(PRESSED_S, meter)?;
        Ok(rig.positions().into_iter().zip(rig.stresses().iter().map(|stress| -stress[0])).collect())
    };
    let mean = |of: &mut dyn Iterator<Item = f64>| {
        let (count, sum) = of.fold((0.0, 0.0), |(count, sum), pressure| (count + 1.0, sum + pressure));
        sum / count
    };
    let (both, alone) = (pressed(&[&layer[..], &bed].concat())?, pressed(&layer)?);
    let (behind, before) = both.split_at(layer.len());
    let low = |at: &&([f64; 3], f64)| at.0[2] < LAYER_M && at.0[0] > face_m - LAYER_M;
    let push = mean(&mut before.iter().filter(low).map(|at| at.1));
    let [behind, alone] = [behind, &alone].map(|of| mean(&mut of.iter().map(|at| at.1)));
    Ok(100.0 * (behind - alone) / push)
}

/// How far the nearest grain of a layer falls off the back of a wall, over how far it would fall freely.
fn fallen(law: &SceneSpec, face_m: f64, seed: u64, meter: &Meter<'_>) -> Result<f64, Halt> {
    let back = face_m + CELL_M;
    let mut scene = with_wall(law, face_m, CELL_M, 0.072);
    scene.domain.gravity_m_s2 = [GRAVITY, 0.0, 0.0];
    let layer = packed(&scene, [back, 0.008, 0.008], [back + LAYER_M, 0.024, 0.032], seed);
    let mut rig = Rig::<f32>::new(scene, &layer)?;
    rig.run(FALLS_S, meter)?;
    let nearest = |of: &[[f64; 3]]| of.iter().map(|x| x[0]).fold(f64::INFINITY, f64::min);
    Ok((nearest(&rig.positions()) - nearest(&layer)) / (0.5 * GRAVITY * FALLS_S * FALLS_S))
}

/// Of walls at all places what is farthest from the reference.
fn worst(reference: f64, mut of: impl FnMut(f64) -> Result<f64, Halt>) -> Result<Vec<f64>, Halt> {
    let found = OFF_CELLS.iter().map(|off| of(FACE_M + off * CELL_M)).collect::<Result<Vec<_>, _>>()?;
    let far = |number: &f64| (number - reference).abs();
    Ok(found.into_iter().max_by(|a, b| far(a).total_cmp(&far(b))).into_iter().collect())
}

const GROUP: &str = "walls between powders, the worst of eight places between the nodes";

fn pressed(law: &SceneSpec, (name, cells): (&str, f64)) -> Case<'static> {
    let law = law.clone();
    let claim = Claim {
        group: GROUP,
        name: format!("felt behind a wall of {name}"),
        unit: "%",
        reference: 0.0,
        tolerance: [0.0; 2],
        source: "powder behind a wall does not feel what presses on its front",
        why: "1 % of the pressure: amounts are to be met within 2 %",
        wrong: [
            "Powder behind the wall is drawn by {} of the pressure",
            "Powder behind the wall feels {} of the pressure",
        ],
        control: false,
    };
    let scene = with_wall(&law, FACE_M, cells * CELL_M, FACE_M + cells * CELL_M + LAYER_M);
    let volume = WIDTH_M * (FACE_M * DEPTH_M + 2.0 * LAYER_M * LAYER_M);
    let work = volume / scene.particle_volume_m3() * PRESSED_S / scene.time.substep_s();
    let measure = move |seed, meter: &Meter<'_>| {
        worst(0.0, |face_m| felt_percent(&law, face_m, cells * CELL_M, seed, meter))
    };
    Case {
        claims: vec![claim.within(1.0)],
        seeds: 1,
        work: OFF_CELLS.len() as f64 * work,
        measure: Box::new(measure),
    }
}

fn falls(law: &SceneSpec) -> Case<'static> {
    let law = law.clone();
    let claim = Claim {
        group: GROUP,
        name: "fall off a wall, over free fall".into(),
        unit: "",
        reference: 1.0,
        tolerance: [0.0; 2],
        source: "dry powder does not stick to a wall",
        why: "3 % of the way in 0.06 s: a seventh of a cell",
        wrong: ["Powder falls {} short", "Powder falls {} too far"],
        control: false,
    };
    let scene = with_wall(&law, FACE_M, CELL_M, 0.072);
    let particles = LAYER_M * 0.016 * 0.024 / scene.particle_volume_m3();
    let work = particles * FALLS_S / scene.time.substep_s();
    let measure = move |seed, meter: &Meter<'_>| worst(1.0, |face_m| fallen(&law, face_m, seed, meter));
    Case {
        claims: vec![claim.within(0.03)],
        seeds: 1,
        work: OFF_CELLS.len() as f64 * work,
        measure: Box::new(measure),
    }
}

/// Pressure through walls of three thicknesses, and the fall.
pub(super) fn cases(law: &SceneSpec, scope: Scope) -> Vec<Case<'static>> {
    if scope == Scope::Short {
        return Vec::new();
    }
    THICKNESSES.into_iter().map(|thickness| pressed(law, thickness)).chain([falls(law)]).collect()
}
