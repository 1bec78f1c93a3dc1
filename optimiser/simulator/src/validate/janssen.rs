//! A silo that is filled slowly: its walls bear a part of the powder, the more the deeper it lies.

use std::f64::consts::PI;

use crate::scene::{Container, ContainerShape, SceneSpec};
use crate::validate::Scope;
use crate::validate::case::{Case, Claim, Halt, Meter};
use crate::validate::pour::Stream;
use crate::validate::rig::{FRICTION_ANGLE, GRAVITY, Rig, apparatus, fall_speed, set_time_step};

/// Cell, m, and radius of the silo and depth of the powder in it, in cells.
const CELL_M: f64 = 0.004;
const RADIUS_M: f64 = 6.0 * CELL_M;
const DEPTH_M: f64 = 24.0 * CELL_M;

/// Friction of its wall.
const FRICTION: f64 = 0.4;

/// Where the stream begins above the floor, m.
const FROM_M: f64 = DEPTH_M + 4.0 * CELL_M;

/// Time to come to rest, then a time over which pressures are means, s, and in how many looks.
const REST_S: f64 = 0.5;
const SWING_S: f64 = 0.5;
const LOOKS: usize = 25;

/// Depths at which it is measured, over the radius.
const DEPTHS: [f64; 3] = [1.0, 2.0, 3.0];

fn set_up(law: &SceneSpec) -> (SceneSpec, Stream) {
    let width = 2.0 * RADIUS_M + 8.0 * CELL_M;
    let mut scene = apparatus(law, [width, width, FROM_M + 6.0 * CELL_M], CELL_M);
    let middle = 0.5 * scene.domain.size_m[0];
    scene.containers.push(Container {
        name: "silo".into(),
        position_m: [middle, middle, CELL_M],
        yaw_deg: 0.0,
        wall_thickness_m: CELL_M,
        friction: FRICTION,
        shape: ContainerShape::Cylinder { inner_radius_m: RADIUS_M, inner_height_m: FROM_M + CELL_M },
    });
    set_time_step(&mut scene, fall_speed(FROM_M));
    let volume_m3 = PI * RADIUS_M * RADIUS_M * DEPTH_M;
    let from_m = [middle, middle, CELL_M + FROM_M];
    (scene, Stream { from_m, radius_m: 4.0 * CELL_M, speed_m_s: 0.15, volume_m3 })
}

/// Janssen's share of the weight above that is borne by what is below, at a depth over the radius: `(1 - exp(-k))/k`, `k` twice friction,
/// ratio of pressures and depth.
fn janssen(depth: f64) -> f64 {
    let ratio = 1.0 - libm::sin(FRICTION_ANGLE.to_radians());
    let k = 2.0 * FRICTION * ratio * depth;
    -libm::expm1(-k) / k
}

/// Vertical pressure at each of [`DEPTHS`] over the weight of what is above, by what Janssen has.
fn pressures(law: &SceneSpec, seed: u64, meter: &Meter<'_>) -> Result<Vec<f64>, Halt> {
    let (scene, stream) = set_up(law);
    let (density, volume) = (scene.powder.density_kg_m3, scene.particle_volume_m3());
    let mut rig = Rig::<f32>::new(scene, &[])?;
    stream.pour(&mut rig, seed, meter)?;
    rig.run(REST_S, meter)?;
    let heights: Vec<f64> = rig.positions().iter().map(|x| x[2]).collect();
    // Depths by how much lies above: a cell's thickness of powder about each of them.
    let mut from_top: Vec<usize> = (0..heights.len()).collect();
    from_top.sort_by(|a, b| heights[*b].total_cmp(&heights[*a]));
    let above = |depth_m: f64| ((PI * RADIUS_M * RADIUS_M * depth_m / volume) as usize).min(from_top.len());
    let slabs = DEPTHS.map(|depth| {
        let [low, high] = [-0.5, 0.5].map(|cells| above(depth * RADIUS_M + cells * CELL_M));
        &from_top[low..high]
    });
    let mut sums = [0.0; DEPTHS.len()];
    for _ in 0..LOOKS {
        rig.run(SWING_S / LOOKS as f64, meter)?;
        let stresses = rig.stresses();
        for (sum, slab) in sums.iter_mut().zip(slabs) {
            let pressure: f64 = slab.iter().map(|particle| -stresses[*particle][2]).sum();
            *sum += pressure / slab.len() as f64 / LOOKS as f64;
        }
    }
    let over = |(sum, depth): (f64, f64)| sum / (density * GRAVITY * depth * RADIUS_M * janssen(depth));
    Ok(sums.into_iter().zip(DEPTHS).map(over).collect())
}

/// One silo.
pub(super) fn cases(law: &SceneSpec, scope: Scope) -> Vec<Case<'_>> {
    if scope == Scope::Short {
        return Vec::new();
    }
    let claim = |depth: f64| {
        let claim = Claim {
            group: "a silo that is filled slowly, over Janssen's law",
            name: format!("vertical pressure, depth over radius {depth}"),
            unit: "",
            reference: 1.0,
            tolerance: [0.0; 2],
            source: "Janssen 1895, Z. VDI 39: the wall bears friction times the pressure on it, which is 1 - sin(friction \
                     angle) of the vertical one (Jaky 1944)",
            why: "15 %: ratios of pressures from 0.36 to 0.63, as bulk solids have (EN 1991-4, table E.1), give 12 % less to 15 % more \
                  three radii down",
            wrong: [
                "The walls bear too much: {} less than by Janssen",
                "The walls bear too little: {} more than by Janssen",
            ],
            control: false,
        };
        claim.within(0.15)
    };
    let (scene, stream) = set_up(law);
    let seconds = 0.5 * stream.seconds() + REST_S + SWING_S;
    vec![Case {
        claims: DEPTHS.map(claim).into(),
        seeds: scope.seeds(),
        work: stream.volume_m3 / scene.particle_volume_m3() * seconds / scene.time.substep_s(),
        measure: Box::new(move |seed, meter| pressures(law, seed, meter)),
    }]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_the_surface_all_of_it_is_borne_and_far_below_no_more_than_a_certain_depth() {
        assert!((janssen(1e-6) - 1.0).abs() < 1e-6);
        // R/(2 mu K) is 2.5 radii.
        assert!((janssen(1e3) * 1e3 - 2.5).abs() < 1e-9);
    }
}
