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

/// Change of the mean height, %; and the share of blocks that are awake after two seconds, %.
fn left_alone(
    law: &SceneSpec,
    powder: Powder,
    off_cells: f64,
    seed: u64,
    meter: &Meter<'_>,
) -> Result<Vec<f64>, Halt> {
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
    rig.run(ASLEEP_S, meter)?;
    let awake = 100.0 * rig.awake();
    rig.run(END_S - ASLEEP_S, meter)?;
    Ok(vec![100.0 * (height_m(&rig) / before_m - 1.0), awake])
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
        tolerance: [0.0, 10.0],
        why: "10 % of the blocks: some grains that lie alone beside a heap need not sleep",
        wrong: ["", "Of its blocks {} are awake"],
        ..claim
    };
    Case {
        claims: vec![sinks.within(powder.most_sunk()), awake],
        seeds: 1,
        work,
        measure: Box::new(move |seed, meter| left_alone(&law, powder, off_cells, seed, meter)),
    }
}

/// All of them, on the nodes and off them.
pub(super) fn cases(law: &SceneSpec, scope: Scope) -> Vec<Case<'static>> {
    let all: &[Powder] =
        if scope == Scope::Full { &[Powder::Bed, Powder::RoundBed, Powder::Heap] } else { &[] };
    all.iter().flat_map(|powder| OFF_CELLS.map(|place| case(law, *powder, place))).collect()
}
