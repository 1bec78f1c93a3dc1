//! How densely powder lies that has been poured.

use std::ops::ControlFlow;

use crate::rollout::{
    Destination, Recording, RolloutError, Simulate, Simulator, SimulatorSettings, Snapshot,
};
use crate::scene::{Container, ContainerShape, DEFAULT_SCENE, Scene, SceneSpec};
use crate::skill::{SkillMap, Theta};
use crate::validate::Scope;
use crate::validate::case::{Case, Claim, Halt, Meter};
use crate::validate::measures::{packing, quantile};
use crate::validate::pour::Stream;
use crate::validate::rig::{Rig, apparatus, fall_speed, set_time_step};

/// The box, m: inner width, height, and thickness of its walls. It stands on the domain's floor.
const WIDTH_M: f64 = 0.048;
const HEIGHT_M: f64 = 0.04;
const WALL_M: f64 = 0.004;

/// How deep powder of its own density would lie in it, m.
const DEPTH_M: f64 = 0.02;

/// The stream begins so far above the box, m.
const DROP_M: f64 = 0.04;

/// Time to come to rest, s.
const REST_S: f64 = 0.6;

/// Balls in which particles are counted, and distance of their centres, m: 34 particles at 4 mm cells.
const BALL_M: f64 = 0.004;
const STEP_M: f64 = 0.0015;

/// A skill that pours a heap into the target of the default scene.
const SKILL: [f64; 5] = [0.9, -0.35, 0.39, 0.07, 0.23];

fn container(middle: f64) -> Container {
    Container {
        name: "box".into(),
        position_m: [middle, middle, WALL_M],
        yaw_deg: 0.0,
        wall_thickness_m: WALL_M,
        friction: 0.4,
        shape: ContainerShape::Box { inner_size_m: [WIDTH_M, WIDTH_M, HEIGHT_M] },
    }
}

fn box_and_stream(law: &SceneSpec, cell_m: f64) -> (SceneSpec, Stream) {
    let width = WIDTH_M + 2.0 * WALL_M + 0.016;
    let top = WALL_M + HEIGHT_M + DROP_M;
    let mut scene = apparatus(law, [width, width, top + 0.016], cell_m);
    let middle = 0.5 * scene.domain.size_m[0];
    scene.containers.push(container(middle));
    set_time_step(&mut scene, fall_speed(top));
    let volume_m3 = WIDTH_M * WIDTH_M * DEPTH_M;
    (scene, Stream { from_m: [middle, middle, top], radius_m: 0.01, speed_m_s: 0.3, volume_m3 })
}

/// Median, and the quantiles of 10 and 90 %.
fn spread(particles: &[[f64; 3]], volume_m3: f64) -> [f64; 3] {
    let found = packing(particles, volume_m3, BALL_M, STEP_M);
    [0.5, 0.1, 0.9].map(|share| quantile(&found, share))
}

/// Of the box.
pub(super) fn in_box(
    law: &SceneSpec,
    cell_m: f64,
    forgets_volume: bool,
    seed: u64,
    meter: &Meter<'_>,
) -> Result<[f64; 3], Halt> {
    let (scene, stream) = box_and_stream(law, cell_m);
    let volume = scene.particle_volume_m3();
    let mut rig = Rig::<f32>::new(scene, &[])?;
    if forgets_volume {
        rig = rig.without_volume_correction();
    }
    stream.pour(&mut rig, seed, meter)?;
    rig.run(REST_S, meter)?;
    Ok(spread(&rig.positions(), volume))
}

/// Particles times substeps, of the box.
pub(super) fn work_of_box(law: &SceneSpec, cell_m: f64) -> f64 {
    let (scene, stream) = box_and_stream(law, cell_m);
    let particles = stream.volume_m3 / scene.particle_volume_m3();
    particles * (0.5 * stream.seconds() + REST_S) / scene.time.substep_s()
}

/// The default scene with the powder's law of another one, and finer by a whole number.
fn bench(law: &SceneSpec, finer: u32) -> Scene {
    let mut scene = Scene::load(DEFAULT_SCENE).expect("the shipped scene is valid").into_spec();
    let SceneSpec { domain, powder, .. } = apparatus(law, scene.domain.size_m, scene.domain.cell_m);
    let own = scene.clone();
    scene.powder = powder;
    scene.powder.fill_min_m = own.powder.fill_min_m;
    scene.powder.fill_max_m = own.powder.fill_max_m;
    scene.powder.friction_angle_deg = own.powder.friction_angle_deg;
    scene.domain.contact_band_cells = domain.contact_band_cells;
    scene.domain.sleep_speed_m_s = domain.sleep_speed_m_s;
    scene.domain.sleep_by = domain.sleep_by;
    scene.domain.sleepers = domain.sleepers;
    scene.domain.walls = domain.walls;
    scene.domain.cell_m /= f64::from(finer);
    // A powder that is lighter or more viscous than the scene's own may need more.
    set_time_step(&mut scene, 0.0);
    scene.time.substeps = scene.time.substeps.max(own.time.substeps * finer);
    scene.unchecked()
}

/// Of the heap that the skill leaves in the target; and how much arrives, kg.
fn in_target(scene: &Scene, seed: u64, meter: &Meter<'_>) -> Result<([f64; 3], f64), Halt> {
    let settings = SimulatorSettings { seed: Some(seed), threads: Some(1), ..SimulatorSettings::default() };
    let mut simulator = Simulator::<f32>::new(scene, &settings)?;
    let map = SkillMap::new(scene);
    let skill = Theta::new(SKILL).map_err(RolloutError::from)?;
    let controls = map.controls(&skill).map_err(RolloutError::from)?;
    let mut end = Vec::new();
    let (units, mut before) = (work_of_skill(scene) / controls.len() as f64, 0);
    let mut look = |snapshot: &Snapshot<'_>| {
        if snapshot.step == controls.len() {
            end = snapshot.positions_m.iter().map(|p| p.map(f64::from)).collect();
        }
        let steps = snapshot.step - std::mem::replace(&mut before, snapshot.step);
        match meter.spend((units * steps as f64) as u64) {
            Ok(()) => ControlFlow::Continue(()),
            Err(_) => ControlFlow::Break(()),
        }
    };
    let take = Recording { anchor: map.start_pose(), controls: &controls, every: 1 };
    let (evaluation, destinations) = simulator.record(&take, &mut look)?;
    let there = end.iter().zip(destinations).filter(|(_, to)| *to == Destination::Target);
    let there: Vec<_> = there.map(|(p, _)| *p).collect();
    let mass = f64::from(evaluation.census.target) * scene.particle_mass_kg();
    Ok((spread(&there, scene.particle_volume_m3()), mass))
}

/// Particles times substeps, of the skill.
fn work_of_skill(scene: &Scene) -> f64 {
    let substeps = f64::from(scene.time.horizon_steps) * f64::from(scene.time.substeps);
    scene.particle_count() as f64 * substeps
}

const GROUP: &str = "packing of poured powder, over the density of the scene";

/// What is claimed of the median and of the quantiles of 10 and 90 %, over the density of the scene.
pub(super) fn claims(of: &str, cell_m: f64, tolerance: [f64; 2]) -> [Claim; 3] {
    let median = "the powder's bulk density is that of the scene, wherever it has come from";
    let spread = "the same, ball by ball";
    let claim = |part: &str, tolerance, source, why| Claim {
        group: GROUP,
        name: format!("{of}, {} mm cells, {part}", 1e3 * cell_m),
        unit: "",
        reference: 1.0,
        tolerance,
        source,
        why,
        wrong: ["The powder lies {} too loosely", "The powder lies {} too densely"],
        control: false,
    };
    let of_median = if tolerance[0] < 0.95 {
        "8 % below and 5 % above: loose and dense random packings of spheres (0.55 and 0.64 of the volume) \
         lie so far to either side of their middle; a heap is poured as loosely as powder can be"
    } else {
        "5 %: a box that is filled by a stream comes to lie in the middle between loose and dense random \
         packing (0.55 and 0.64 of the volume, 7 % to either side)"
    };
    let of_spread = "20 %: the packings of spheres differ by 7 % from their middle, and 34 particles in a \
                     ball count to 10 %";
    [
        claim("median", tolerance, median, of_median),
        claim("10 % quantile", [0.8, 1.2], spread, of_spread),
        claim("90 % quantile", [0.8, 1.2], spread, of_spread),
    ]
}

/// What is claimed of the mass that arrives.
fn claim_of_mass() -> Claim {
    let claim = Claim {
        group: "independence of what is numerical",
        name: "mass that a skill delivers, 2 mm cells over 4 mm".into(),
        unit: "",
        reference: 1.0,
        tolerance: [0.0; 2],
        source: "powder knows no cells",
        why: "5 %: the cells of 4 mm are a quarter of the bowl's radius, and a plan is to meet its amount within 2 %",
        wrong: ["With finer cells {} less arrives", "With finer cells {} more arrives"],
        control: false,
    };
    claim.within(0.05)
}

/// The box, and in full the skill.
pub(super) fn cases(law: &SceneSpec, scope: Scope) -> Vec<Case<'_>> {
    let cells: &[f64] = if scope == Scope::Full { &[0.004, 0.002] } else { &[0.004] };
    let boxed = |cell: f64| Case {
        claims: claims("box", cell, [0.95, 1.05]).into(),
        // Fine ones differ by less than they cost.
        seeds: if cell < 0.004 { 1 } else { scope.seeds() },
        work: work_of_box(law, cell),
        measure: Box::new(move |seed, meter| Ok(in_box(law, cell, false, seed, meter)?.into())),
    };
    let mut cases: Vec<_> = cells.iter().map(|cell| boxed(*cell)).collect();
    if scope == Scope::Full {
        let of = |cell| claims("heap in the target of bench", cell, [0.92, 1.05]);
        let measure = move |seed, meter: &Meter<'_>| {
            let (coarse, coarse_kg) = in_target(&bench(law, 1), seed, meter)?;
            let (fine, fine_kg) = in_target(&bench(law, 2), seed, meter)?;
            Ok([&coarse[..], &fine, &[fine_kg / coarse_kg]].concat())
        };
        cases.push(Case {
            claims: of(0.004).into_iter().chain(of(0.002)).chain([claim_of_mass()]).collect(),
            seeds: scope.seeds(),
            work: [1, 2].map(|finer| work_of_skill(&bench(law, finer))).iter().sum(),
            measure: Box::new(measure),
        });
    }
    cases
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_scenes_powder_scoops_on_the_default_scene() {
        let scene = Scene::load(DEFAULT_SCENE).unwrap();
        assert_eq!(bench(&scene, 1), scene);
        let fine = bench(&scene, 2);
        assert_eq!((fine.domain.cell_m, fine.time.substeps), (0.002, 40));
        assert!(fine.clone().into_spec().validate_as("bench").is_ok());
        let light = bench(&Scene::load("vial").unwrap(), 2);
        assert!(
            light.clone().into_spec().validate_as("bench").is_ok() && light.time.substeps > 40,
            "{}",
            light.time.substeps
        );
    }
}
