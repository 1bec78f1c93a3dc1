//! Heaps that are poured on a rough plate: how steep they are.

use crate::scene::SceneSpec;
use crate::validate::Scope;
use crate::validate::case::{Case, Claim, Halt, Meter};
use crate::validate::measures::Deposit;
use crate::validate::pour::Stream;
use crate::validate::rig::{Rig, apparatus, fall_speed, set_time_step};

/// Cell, m.
const CELL_M: f64 = 0.004;

/// Powder in the heap, m^3: five to nine cells high, by its angle.
const VOLUME_M3: f64 = 60e-6;

/// Half the plate's width, m: twice the foot of the flattest heap.
const REACH_M: f64 = 0.1;

/// Time to come to rest, s.
const REST_S: f64 = 0.5;

/// Height of a cone of that volume, m.
fn cone_height_m(angle_deg: f64) -> f64 {
    let tangent = libm::tan(angle_deg.to_radians());
    libm::cbrt(3.0 * VOLUME_M3 * tangent * tangent / core::f64::consts::PI)
}

/// The apparatus and the stream: it begins three cells above the top that the heap should have.
fn set_up(law: &SceneSpec, key_deg: f64) -> (SceneSpec, Stream) {
    let top = cone_height_m(key_deg) + 3.0 * CELL_M;
    let mut scene = apparatus(law, [2.0 * REACH_M, 2.0 * REACH_M, top + 4.0 * CELL_M], CELL_M);
    scene.powder.friction_angle_deg = key_deg;
    scene.domain.friction = 1.0;
    set_time_step(&mut scene, fall_speed(top));
    let middle = 0.5 * scene.domain.size_m[0];
    let from_m = [middle, middle, top];
    (scene, Stream { from_m, radius_m: 1.5 * CELL_M, speed_m_s: 0.1, volume_m3: VOLUME_M3 })
}

/// Poured as for this key, of powder with another friction angle if there is one given; its slope in degrees.
pub(super) fn slope_deg(
    law: &SceneSpec,
    key_deg: f64,
    friction_angle_deg: f64,
    seed: u64,
    meter: &Meter<'_>,
) -> Result<f64, Halt> {
    let (mut scene, stream) = set_up(law, key_deg);
    scene.powder.friction_angle_deg = friction_angle_deg;
    let volume = scene.particle_volume_m3();
    let mut rig = Rig::<f32>::new(scene, &[])?;
    stream.pour(&mut rig, seed, meter)?;
    rig.run(REST_S, meter)?;
    let [x, y, _] = stream.from_m;
    Ok(Deposit::new(&rig.positions(), [x, y], volume).slope().to_degrees())
}

/// Particles times substeps.
pub(super) fn work(law: &SceneSpec, key_deg: f64) -> f64 {
    let (scene, stream) = set_up(law, key_deg);
    let particles = VOLUME_M3 / scene.particle_volume_m3();
    particles * (0.5 * stream.seconds() + REST_S) / scene.time.substep_s()
}

/// What is claimed of the slope.
pub(super) fn claim(key_deg: f64) -> Claim {
    let claim = Claim {
        group: "slope of a poured heap",
        name: format!("angle of repose, key {key_deg} deg, {} mm cells", 1e3 * CELL_M),
        unit: "deg",
        reference: key_deg,
        tolerance: [0.0; 2],
        source: "Mohr-Coulomb: no slope of powder without cohesion is steeper than its friction angle, and \
                 one that has come to rest on a rough plate is hardly flatter",
        why: "2.5 deg: by so much angles of repose of one powder differ with the way of pouring",
        wrong: ["The heap is flatter than its key by {}", "The heap is steeper than its key by {}"],
        control: false,
    };
    claim.within(2.5)
}

/// Heaps of several keys.
pub(super) fn cases(law: &SceneSpec, scope: Scope) -> Vec<Case<'_>> {
    let keys: &[f64] = if scope == Scope::Full { &[25.0, 30.0, 35.0, 40.0] } else { &[30.0] };
    let case = |key: f64| Case {
        claims: vec![claim(key)],
        seeds: scope.seeds(),
        work: work(law, key),
        measure: Box::new(move |seed, meter| Ok(vec![slope_deg(law, key, key, seed, meter)?])),
    };
    keys.iter().map(|key| case(*key)).collect()
}
