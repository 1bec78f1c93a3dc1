//! Beds and heaps that are left alone: how far they sink, and whether they fall asleep.

use crate::scene::{Container, ContainerShape, SceneSpec};
use crate::validate::Scope;
use crate::validate::case::{Case, Claim, Halt, Meter};
use crate::validate::rig::{Rig, apparatus, packed, packed_cylinder, set_time_step};

/// Cell, and how deep the powder is at first, m.
const CELL_M: f64 = 0.004;
const DEPTH_M: f64 = 0.024;

/// Time to come to rest, from then on until it should sleep, and until it is looked at again, s.
const SETTLE_S: f64 = 0.6;
const ASLEEP_S: f64 = 2.0;
const END_S: f64 = 10.0;

/// Blocks that may be awake then, %.
const MOST_AWAKE: f64 = 10.0;

/// Where walls and floor are, cells off the nodes.
const OFF_CELLS: [(&str, f64); 3] = [("on nodes", 0.0), ("a quarter off", 0.25), ("midway", 0.5)];

/// What is left alone.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Powder {
    /// A column that has collapsed on a rough plate.
    Heap,
    /// A bed in a box.
    Bed,
    /// A bed in a round container.
    RoundBed,
}

impl Powder {
    fn name(self) -> &'static str {
        match self {
            Self::Heap => "heap",
            Self::Bed => "square bed",
            Self::RoundBed => "round bed",
        }
    }

    /// How much it may sink, %.
    fn most_sunk(self) -> f64 {
        if self == Self::Heap { 0.3 } else { 0.1 }
    }
}

/// The apparatus, and its powder by seed.
fn set_up(law: &SceneSpec, powder: Powder, off_cells: f64) -> SceneSpec {
    let off = off_cells * CELL_M;
    let mut scene = apparatus(law, [0.128, 0.128, 0.064], CELL_M);
    let half = 0.024 + off;
    let square = |half: f64| ContainerShape::Box { inner_size_m: [2.0 * half, 2.0 * half, 0.032] };
    let (shape, friction) = match powder {
        Powder::Heap => (square(0.056), 0.8),
        Powder::Bed => (square(half), 0.4),
        Powder::RoundBed => (ContainerShape::Cylinder { inner_radius_m: half, inner_height_m: 0.032 }, 0.4),
    };
    scene.containers.push(Container {
        name: "box".into(),
        position_m: [0.064, 0.064, 0.008 + off],
        yaw_deg: 0.0,
        wall_thickness_m: CELL_M,
        friction,
        shape,
    });
    set_time_step(&mut scene, 1.0);
    scene
}

fn particles(scene: &SceneSpec, powder: Powder, off_cells: f64, seed: u64) -> Vec<[f64; 3]> {
    let [x, y, z] = scene.containers[0].position_m;
    let half = 0.024 + off_cells * CELL_M;
    match powder {
        Powder::Heap => packed_cylinder(scene, [x, y, z], 0.020, DEPTH_M, seed),
        Powder::Bed => packed(scene, [x - half, y - half, z], [x + half, y + half, z + DEPTH_M], seed),
        Powder::RoundBed => packed_cylinder(scene, [x, y, z], half, DEPTH_M, seed),
    }
}

/// What has become of it.
struct Watched {
    /// Change of the mean height from when it has come to rest, %: until it should sleep, and until the end.
    risen: [f64; 2],
    /// Share of the blocks that are awake then, %.
    awake: [f64; 2],
}

fn left_alone(
    law: &SceneSpec,
    (powder, off_cells): (Powder, f64),
    end_s: f64,
    seed: u64,
    meter: &Meter<'_>,
) -> Result<Watched, Halt> {
    let scene = set_up(law, powder, off_cells);
    let floor_m = scene.containers[0].position_m[2];
    let there = particles(&scene, powder, off_cells, seed);
    let height_m = |rig: &Rig<f32>| {
        let all = rig.positions();
        all.iter().map(|x| x[2] - floor_m).sum::<f64>() / all.len() as f64
    };
    let mut rig = Rig::<f32>::new(scene, &there)?;
    rig.run(SETTLE_S, meter)?;
    let before_m = height_m(&rig);
    let mut found = Watched { risen: [0.0; 2], awake: [0.0; 2] };
    for (look, seconds) in [ASLEEP_S, end_s - ASLEEP_S].into_iter().enumerate() {
        rig.run(seconds, meter)?;
        found.risen[look] = 100.0 * (height_m(&rig) / before_m - 1.0);
        found.awake[look] = 100.0 * rig.awake();
    }
    Ok(found)
}

fn case(law: &SceneSpec, powder: Powder, (place, off_cells): (&str, f64)) -> Case<'static> {
    let law = law.clone();
    let scene = set_up(&law, powder, off_cells);
    let work =
        particles(&scene, powder, off_cells, 1).len() as f64 * (SETTLE_S + END_S) / scene.time.substep_s();
    let claim = Claim {
        group: "powder that is left alone",
        name: String::new(),
        unit: "%",
        reference: 0.0,
        tolerance: [0.0; 2],
        source: "what has come to rest stays where it is",
        why: "",
        wrong: [""; 2],
        control: false,
    };
    let sinks = Claim {
        name: format!("{}, {place}, change of its height in 10 s", powder.name()),
        why: match powder {
            Powder::Heap => "0.3 %: three thousandths of a cell",
            _ => "0.1 %: three thousandths of a cell",
        },
        wrong: ["It sinks by {}", "It rises by {}"],
        ..claim.clone()
    };
    let awake = Claim {
        name: format!("{}, {place}, awake after 2 s", powder.name()),
        tolerance: [0.0, MOST_AWAKE],
        why: "10 % of the blocks: some grains that lie alone beside a heap need not sleep",
        wrong: ["", "Of its blocks {} are awake"],
        ..claim
    };
    Case {
        claims: vec![sinks.within(powder.most_sunk()), awake],
        seeds: 1,
        work,
        measure: Box::new(move |seed, meter| {
            let found = left_alone(&law, (powder, off_cells), END_S, seed, meter)?;
            Ok(vec![found.risen[1], found.awake[0]])
        }),
    }
}

/// All of them, on the nodes and off them.
pub(super) fn cases(law: &SceneSpec, scope: Scope) -> Vec<Case<'static>> {
    let all: &[Powder] =
        if scope == Scope::Full { &[Powder::Bed, Powder::RoundBed, Powder::Heap] } else { &[] };
    all.iter().flat_map(|powder| OFF_CELLS.map(|place| case(law, *powder, place))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{DEFAULT_SCENE, Scene, SleepBy, Sleepers};

    fn law() -> SceneSpec {
        (*Scene::load(DEFAULT_SCENE).unwrap()).clone()
    }

    /// With the first seed.
    fn watched(law: &SceneSpec, powder: Powder, off_cells: f64, end_s: f64) -> Watched {
        let found = left_alone(law, (powder, off_cells), end_s, 1, &Meter::unwatched()).unwrap();
        let Watched { risen, awake } = &found;
        println!(
            "{}, {off_cells} cells off the nodes, {end_s} s: {risen:+.4?} %; awake {awake:.1?} %",
            powder.name()
        );
        found
    }

    #[test]
    fn what_is_left_alone_stays_where_it_is() {
        for powder in [Powder::Bed, Powder::RoundBed, Powder::Heap] {
            for (_, off_cells) in OFF_CELLS {
                let Watched { risen: [_, risen], awake } = watched(&law(), powder, off_cells, END_S);
                assert!(risen.abs() < powder.most_sunk() && awake[0] <= MOST_AWAKE);
            }
        }
    }

    /// Who stands still gives no momentum: a heap that falls asleep at once stays to a hundredth of a per cent, where one whose sleepers
    /// move sinks by 0.8 %.
    #[test]
    fn heaps_whose_sleepers_are_still_stay_where_they_are() {
        let mut law = law();
        (law.domain.sleepers, law.domain.sleep_speed_m_s) = (Sleepers::Still, 0.002);
        for (_, off_cells) in OFF_CELLS {
            let found = watched(&law, Powder::Heap, off_cells, END_S);
            assert!(found.risen[1].abs() < 0.01);
        }
    }

    /// What there is to cure.
    #[test]
    fn by_its_fastest_grain_or_with_sleepers_that_move_a_heap_sinks() {
        let moving = |sleep_by| {
            let mut law = law();
            (law.domain.sleep_by, law.domain.sleepers) = (sleep_by, Sleepers::Moving);
            law.domain.sleep_speed_m_s = 0.002;
            law
        };
        let by_fastest = watched(&moving(SleepBy::Largest), Powder::Heap, 0.25, 5.0);
        assert!(by_fastest.risen[1] < -0.5 && by_fastest.awake[1] > 0.0);
        let by_mean = watched(&moving(SleepBy::MeanSquare), Powder::Heap, 0.0, END_S);
        assert!(by_mean.risen[1] < -Powder::Heap.most_sunk());
    }

    /// A heap that never sleeps, as on a tool.
    #[test]
    fn powder_that_is_loosened_by_shear_alone_stays_a_heap_when_awake() {
        let [at_rest, by_shear] = [None, Some(1.0)].map(|loosening_strain| {
            let mut law = law();
            law.domain.sleep_speed_m_s = 0.0;
            law.powder.loosening_strain = loosening_strain;
            watched(&law, Powder::Heap, 0.0, 4.0).risen[1]
        });
        assert!(by_shear.abs() < 0.5 * at_rest.abs() && at_rest < -1.0);
    }
}
