//! What powder feels of a wall, and of what lies behind it.

use std::sync::Arc;

use crate::mpm::Model;
use crate::mpm::bodies::Bodies;
use crate::mpm::connect::{connected, connected_anew};
use crate::mpm::layout::{
    BLOCK_NODES, Block, Layout, NO_BLOCK, Nodes, SHARED_NODES, empty_tile, load_tile, places_in_tile,
};
use crate::mpm::obstacle::room_of;
use crate::mpm::particles::{EMPTY_LANE, Group, LANES, Particles, vec_of};
use crate::mpm::sleep::all_awake;
use crate::mpm::sort::sort_by_faces;
use crate::mpm::spare::BufferPool;
use crate::mpm::stencil_positions::ALL_NEIGHBOURS;
use crate::mpm::substep::{State, Workspace};
use crate::mpm::tests::{
    Settled, advance, awake, empty_bench, even_lattice, far_away, mean, settle, standing,
};
use crate::mpm::walls::{LOOK_EVERY, before_other_faces};
use crate::scene::{ContainerShape, Cuboid, Scene, ToolShape, Walls};
use crate::shape::{Bowl, Shape, Tube, with_solid};
use crate::small::{dot, sub};

/// A wall from x = `face` to `face + thickness` across the domain.
fn with_wall(walls: Walls, face: f64, thickness: f64, end: f64) -> Scene {
    let mut scene = awake("bench-small");
    scene.domain.walls = walls;
    scene.containers.truncate(1);
    let c = &mut scene.containers[0];
    c.wall_thickness_m = thickness;
    c.friction = 0.0;
    c.position_m = [0.5 * (face - 0.008), 0.016, 0.0];
    c.shape = ContainerShape::Box { inner_size_m: [face + 0.008, 0.048, 0.06] };
    scene.domain.friction = 0.0;
    scene.domain.size_m = [end, 0.032, 0.064];
    scene
}

/// A bed is pressed on a wall by gravity at 45 deg; behind the wall lies a thin layer. If both sides share their nodes, a wall no
/// thicker than a cell does not divide the density that the grid sees, which moves the layer by up to a tenth of a cell.
#[test]
fn powder_behind_a_wall_does_not_feel_what_presses_on_its_front() {
    let cases = [
        (Walls::Shared, 0.003, 0.17, 5e-4),
        (Walls::Shared, 0.004, 0.17, 5e-4),
        (Walls::TwoSided, 0.002, 1e-6, 1e-9),
        (Walls::TwoSided, 0.003, 1e-6, 1e-9),
        (Walls::TwoSided, 0.004, 1e-6, 1e-9),
    ];
    for (walls, thickness, most_felt, farthest) in cases {
        for step in 0..8 {
            let face = 0.024 + 0.0005 * f64::from(step);
            let (back, end) = (face + thickness, face + thickness + 0.008);
            let mut scene = with_wall(walls, face, thickness, end);
            scene.domain.gravity_m_s2 = [9.81, 0.0, -9.81];
            let layer = even_lattice([back, 0.0, 0.0], [end, 0.032, 0.008]);
            let both: Vec<_> =
                layer.iter().copied().chain(even_lattice([0.0; 3], [face, 0.032, 0.024])).collect();
            let pressed = settle(&scene, &both, 400);
            let alone = settle(&scene, &layer, 400);
            let behind = &pressed[..layer.len()];
            let through = pressed[layer.len()..].iter().filter(|p| p.x[0] > face + 0.5 * thickness).count();
            let pressure = |of: &[Settled]| mean(of, |_| true, |p| -p.stress[0]);
            let place = |of: &[Settled]| mean(of, |_| true, |p| p.x[0]);
            let push =
                mean(&pressed[layer.len()..], |p| p.x[2] < 0.008 && p.x[0] > face - 0.008, |p| -p.stress[0]);
            let felt = (pressure(behind) - pressure(&alone)) / push;
            let moved = place(behind) - place(&alone);
            println!(
                "{walls:?}, wall of {thickness} m at {face} m: {push:.0} Pa in front, {:.2} % felt behind, moved {moved:.1e} m",
                felt * 100.0
            );
            assert!(
                push > 150.0 && felt.abs() < most_felt && moved.abs() < farthest && through == 0,
                "{walls:?}, wall of {thickness} m at {face} m"
            );
        }
    }
}

#[test]
fn powder_falls_off_a_wall() {
    let free = 0.5 * 9.81 * 0.06f64.powi(2);
    let cases = [(Walls::Shared, 0.2..1.0), (Walls::TwoSided, 0.97..1.03)];
    for ((walls, right), step) in
        cases.into_iter().flat_map(|case| (0..4).map(move |step| (case.clone(), step)))
    {
        let face = 0.024 + 0.001 * f64::from(step);
        let back = face + 0.004;
        let mut scene = with_wall(walls, face, 0.004, 0.072);
        scene.domain.gravity_m_s2 = [9.81, 0.0, 0.0];
        let layer = even_lattice([back, 0.008, 0.008], [back + 0.008, 0.024, 0.032]);
        let end = settle(&scene, &layer, 120);
        let nearest = |of: &mut dyn Iterator<Item = f64>| of.fold(f64::INFINITY, f64::min);
        let nearest = nearest(&mut end.iter().map(|p| p.x[0])) - nearest(&mut layer.iter().map(|x| x[0]));
        println!("{walls:?}, wall at {face} m: nearest {:.2} mm off after 0.06 s", nearest * 1e3);
        assert!(right.contains(&(nearest / free)), "{walls:?}: {nearest} m");
    }
}

#[test]
fn a_full_spoon_leaks_nothing_in_five_seconds() {
    [Walls::Shared, Walls::TwoSided].into_iter().for_each(full_spoon);
}

fn full_spoon(walls: Walls) {
    let mut scene = awake("bench");
    scene.domain.walls = walls;
    let ToolShape::Bowl { inner_radius_m: r } = scene.tool.shape else { panic!("the bench has a bowl") };
    let centre = [0.12, 0.048, 0.12];
    let mut positions =
        even_lattice(centre.map(|c| c - 0.016), [centre[0] + 0.016, centre[1] + 0.016, centre[2]]);
    positions.retain(|p| {
        let d = sub(*p, centre);
        dot(d, d).sqrt() < r - 0.0005 && d[2] < -0.001
    });
    let model: Model<f32> = Model::new(&scene);
    let mut state = State::new(&model, &standing(centre), &Particles::at_rest(&positions)).unwrap();
    advance(&model, &standing(centre), &mut state, 10_000);
    let (mut leaked, mut over_the_rim) = (0, 0);
    for p in state.particles.positions_by_id() {
        let d = sub(p, centre);
        let far = dot(d, d).sqrt() > r + 0.5 * scene.tool.wall_thickness_m;
        leaked += usize::from(far && d[2] < 0.0);
        over_the_rim += usize::from(far && d[2] >= 0.0);
    }
    println!("{walls:?}: {} particles, {leaked} leaked, {over_the_rim} over the rim", positions.len());
    assert!(positions.len() > 800);
    assert_eq!((leaked, over_the_rim), (0, 0));
}

/// What becomes of a bed and of a layer above it when the level plate between them, half a cell thick, is lifted.
struct Lifted {
    /// How far they have risen on average, m; nothing of what is not there.
    bed_m: f64,
    layer_m: f64,
    /// In how many substeps some particles, or some nodes, counted for what they no longer were; and in how many in a row at most.
    stale: u32,
    stale_in_a_row: u32,
}

const LIFT_SPEED_M_S: f64 = 0.1;
const LIFT_SUBSTEPS: usize = 200;

fn lifted(walls: Walls, with_bed: bool, with_layer: bool) -> Lifted {
    let mut scene = empty_bench([0.048, 0.048, 0.064]);
    scene.domain.walls = walls;
    let plate = Cuboid { centre_m: [0.0; 3], size_m: [0.040, 0.040, 0.002], rotation_deg: [0.0; 3] };
    scene.tool.shape = ToolShape::Cuboids { cuboid: vec![plate] };
    let model: Model<f64> = Model::new(&scene);
    // No node is in the plate.
    let start = [0.024, 0.024, 0.0107];
    let bed = even_lattice([0.0; 3], [0.048, 0.048, start[2] - 0.001]);
    let layer = even_lattice([0.016, 0.016, start[2] + 0.001], [0.032, 0.032, start[2] + 0.005]);
    let [bed, layer] =
        [(bed, with_bed), (layer, with_layer)].map(|(of, there)| if there { of } else { Vec::new() });
    let mut tool = standing(start);
    let mut state =
        State::new(&model, &tool, &Particles::at_rest(&[bed.clone(), layer.clone()].concat())).unwrap();
    advance(&model, &tool, &mut state, 400);
    let heights = |state: &State<f64>| {
        let all = state.particles.positions_by_id();
        let (bed, layer) = all.split_at(bed.len());
        [bed, layer].map(|of| of.iter().map(|x| x[2]).sum::<f64>() / of.len().max(1) as f64)
    };
    let before = heights(&state);
    if walls == Walls::TwoSided && with_bed && with_layer {
        sorts_what_is_swapped(&model, &tool, &state);
    }
    let (mut stale, mut in_a_row, mut stale_in_a_row) = (0, 0, 0);
    let mut workspace = Workspace::new();
    tool.tool.velocity[2] = LIFT_SPEED_M_S;
    for _ in 0..LIFT_SUBSTEPS {
        tool.tool.position[2] += LIFT_SPEED_M_S * scene.time.substep_s();
        workspace.substep(&model, &tool, &mut state).unwrap();
        in_a_row = if is_stale(&model, &tool, &state) { in_a_row + 1 } else { 0 };
        (stale, stale_in_a_row) = (stale + u32::from(in_a_row > 0), stale_in_a_row.max(in_a_row));
    }
    if walls == Walls::TwoSided && with_bed && with_layer {
        loads_what_is_asked_for(&state.layout);
    }
    let after = heights(&state);
    Lifted { bed_m: after[0] - before[0], layer_m: after[1] - before[1], stale, stale_in_a_row }
}

fn is_stale(model: &Model<f64>, bodies: &Bodies<f64>, state: &State<f64>) -> bool {
    let particles = before_other_faces(model, bodies, &state.layout, &state.particles.groups, state.rest());
    if particles.contains(&true) {
        sorts_by_faces(model, bodies, state, &particles);
    }
    let anew = connected_anew(model, bodies, &state.layout);
    if let Some(anew) = &anew {
        is_as_if_connected_first(model, bodies, anew);
    }
    particles.contains(&true) || anew.is_some()
}

/// As if nothing had been connected before.
fn is_as_if_connected_first(model: &Model<f64>, bodies: &Bodies<f64>, layout: &Layout) {
    let unconnected = |block: &Block| Block { nodes: [NO_BLOCK; 27], detours: Vec::new(), ..block.clone() };
    let blocks = layout.blocks.iter().map(unconnected).collect();
    assert_eq!(format!("{layout:?}"), format!("{:?}", connected(model, bodies, blocks)));
}

/// Of two particles that have changed places across the plate, each comes to the other's block: nobody else moves, and nothing is connected
/// anew.
fn sorts_what_is_swapped(model: &Model<f64>, bodies: &Bodies<f64>, sorted: &State<f64>) {
    let mut state = sorted.clone();
    let parted = state.layout.blocks.windows(2).find(|two| two[0].coord == two[1].coord);
    let [a, b] = [0, 1].map(|k| parted.expect("some are above the plate, some below")[k].first_group);
    let groups = &mut state.particles.groups;
    let [of_a, of_b] = [a, b].map(|g| groups[g]);
    groups[a].copy_lane(0, &of_b, 0);
    groups[b].copy_lane(0, &of_a, 0);
    let layout = sorts_by_faces(model, bodies, &state, &vec![true; state.layout.blocks.len()]);
    assert_eq!(format!("{layout:?}"), format!("{:?}", state.layout));
}

/// A sort by faces brings all particles to blocks that are before what they are before.
fn sorts_by_faces(model: &Model<f64>, bodies: &Bodies<f64>, state: &State<f64>, is_wrong: &[bool]) -> Layout {
    let old = Particles { groups: state.particles.groups.clone(), ids: Arc::clone(&state.particles.ids) };
    let sorted = sort_by_faces(model, bodies, (old, &state.layout), is_wrong, &mut BufferPool::empty());
    let (new, layout, order) = &sorted;
    is_as_if_connected_first(model, bodies, layout);
    let awake = all_awake(layout);
    assert!(!before_other_faces(model, bodies, layout, &new.groups, &awake).contains(&true));
    let mut seen = vec![false; state.particles.groups.len() * LANES];
    let groups = layout.blocks.iter().flat_map(|block| (0..block.groups()).map(move |g| (block, g)));
    for (g, (block, in_block)) in groups.enumerate() {
        let (particles, resting) = (block.occupied(in_block), [EMPTY_LANE; LANES]);
        assert_eq!(g, block.first_group + in_block);
        assert_eq!(order[g * LANES + particles..(g + 1) * LANES], resting[particles..]);
        assert_eq!(new.ids[g][particles..], resting[particles..]);
        for l in 0..particles {
            let from = order[g * LANES + l] as usize;
            let (old_group, old_lane) = (from / LANES, from % LANES);
            assert!(!std::mem::replace(&mut seen[from], true));
            assert_eq!(new.ids[g][l], state.particles.ids[old_group][old_lane]);
            let [mut new, mut old] = [Group::ZERO; 2];
            new.copy_lane(0, &sorted.0.groups[g], l);
            old.copy_lane(0, &state.particles.groups[old_group], old_lane);
            assert_eq!(format!("{new:?}"), format!("{old:?}"));
        }
    }
    assert_eq!(seen.iter().filter(|seen| **seen).count(), state.particles.occupied().count());
    sorted.1
}

/// Who asks for the nodes of one neighbour gets them all, those in other layers too.
fn loads_what_is_asked_for(layout: &Layout) {
    let nodes: Vec<Nodes<f64>> = (0..layout.nodes.len())
        .map(|b| std::array::from_fn(|n| [1.0 + (b * BLOCK_NODES + n) as f64; 4]))
        .collect();
    assert!(layout.blocks.iter().any(|block| !block.detours.is_empty()));
    for block in &layout.blocks {
        let mut whole = empty_tile();
        load_tile(block, &nodes, ALL_NEIGHBOURS, &mut whole);
        for neighbour in 0..27 {
            let mut part = empty_tile();
            load_tile(block, &nodes, 1 << neighbour, &mut part);
            for (_, at) in places_in_tile(26 - neighbour, SHARED_NODES[26 - neighbour]) {
                assert_eq!(part[at].map(f64::to_bits), whole[at].map(f64::to_bits), "{neighbour} {at}");
                assert!(part[at][0] > 0.0, "{neighbour} {at}");
            }
        }
    }
}

/// A tool that moves takes its two sides with it.
#[test]
fn a_plate_that_is_lifted_takes_what_lies_on_it_and_leaves_what_lies_below() {
    let [shared, two_sided] = [Walls::Shared, Walls::TwoSided].map(|walls| {
        let [both, bed, layer] = [[true, true], [true, false], [false, true]].map(|[b, l]| lifted(walls, b, l));
        let apart = [both.bed_m - bed.bed_m, both.layer_m - layer.layer_m];
        println!(
            "{walls:?}: the plate goes 10 mm, the layer on it {:.3} mm, the bed {:.4} mm; {:.1e} m and {:.1e} m more than without the other; \
             stale in {} substeps, up to {} in a row",
            both.layer_m * 1e3, both.bed_m * 1e3, apart[1], apart[0], both.stale, both.stale_in_a_row
        );
        (both, apart)
    });
    let (found, [of_bed, of_layer]) = &two_sided;
    assert!(of_bed.abs() < 1e-6 && of_layer.abs() < 1e-6);
    assert!(found.bed_m.abs() < 1e-4 && found.layer_m > 0.009);
    assert!(found.stale > 0 && found.stale_in_a_row < LOOK_EVERY);
    assert!(shared.1.iter().any(|apart| apart.abs() > 1e-5), "nothing to cure");
}

/// Most blocks awake at a time before a wall and behind it, after what falls on a bed before it has arrived.
fn woken(walls: Walls) -> [usize; 2] {
    let (face, back) = (0.025, 0.027);
    let mut scene = with_wall(walls, face, back - face, 0.064);
    scene.domain.sleep_speed_m_s = 1e-3;
    scene.domain.size_m[2] = 0.112;
    scene.domain.friction = 0.4;
    scene.containers[0].friction = 0.4;
    (scene.powder.transfer, scene.powder.viscosity_pa_s) = (None, 0.08);
    let model: Model<f64> = Model::new(&scene);
    let mut beds = even_lattice([0.0; 3], [face, 0.032, 0.016]);
    beds.extend(even_lattice([back, 0.0, 0.0], [0.064, 0.032, 0.016]));
    let mut state = State::new(&model, &far_away(), &Particles::at_rest(&beds)).unwrap();
    advance(&model, &far_away(), &mut state, 1500);
    assert!(state.sleepers().all(|asleep| asleep), "{walls:?}: not at rest");
    state.fill();
    let lump = even_lattice([0.008, 0.008, 0.096], [0.020, 0.024, 0.104]);
    let mut all = Particles::at_rest(&[vec![[0.0; 3]; beds.len()], lump].concat());
    for (g, l, id) in state.particles.occupied() {
        all.groups[id as usize / LANES].copy_lane(id as usize % LANES, &state.particles.groups[g], l);
    }
    let mut state = State::new(&model, &far_away(), &all).unwrap();
    let mut most = [0; 2];
    let mut workspace = Workspace::new();
    for substep in 0..500 {
        workspace.substep(&model, &far_away(), &mut state).unwrap();
        let mut awake = [0; 2];
        for (block, asleep) in state.layout.blocks.iter().zip(state.sleepers()) {
            let x = |place: usize| vec_of(&state.particles.groups[place / LANES].x, place % LANES);
            let any = |on: &dyn Fn([f64; 3]) -> bool| !asleep && block.places().any(|place| on(x(place)));
            awake[0] += usize::from(any(&|x| x[0] < face && x[2] < 0.016));
            awake[1] += usize::from(any(&|x| x[0] > back));
        }
        // The lump arrives after 250 substeps.
        if substep < 200 {
            assert!(substep < 150 || awake == [0; 2], "{walls:?}: {awake:?} awake before anything has come");
        } else {
            most = [0, 1].map(|side| most[side].max(awake[side]));
        }
    }
    println!("{walls:?}: up to {} blocks awake before the wall, {} behind it", most[0], most[1]);
    most
}

/// Powder before a wall is stirred, powder behind it goes on sleeping.
#[test]
fn what_falls_before_a_wall_wakes_nobody_behind_it() {
    let [shared, two_sided] = [Walls::Shared, Walls::TwoSided].map(woken);
    assert!(two_sided[0] > 0 && two_sided[1] == 0);
    assert!(shared[1] > 0, "nothing to cure");
}

/// A round surface is flat to the nodes near it, a little off; by its axis, which is far from it, that is no measure of anything.
#[test]
fn a_round_wall_takes_no_room_from_nodes_near_its_axis() {
    let dx = 0.004;
    let tube = Shape::Tube(Tube { radius: 0.018, half_radial: 0.002, height: 0.0, half_axial: 0.02 });
    let bowl = Shape::Bowl(Bowl { radius: 0.018, half: 0.002 });
    for shape in [tube, bowl] {
        let room = |off_cells: f64| {
            let y = [0.6 * off_cells * dx, -0.8 * off_cells * dx, 0.0];
            with_solid!(shape, solid => room_of::<f64, _, true>(&solid, 1.0 / dx, y)).1
        };
        for off_cells in [0.0, 1e-6, 1e-4, 1e-3, 0.01, 0.03, 0.1, 0.5] {
            assert_eq!(room(off_cells), (1.0, 0.0), "{off_cells} cells off the axis");
        }
        let (beside, slope) = room(3.8);
        assert!(beside > 0.3 && beside < 0.9 && slope > 0.0, "a fifth of a cell before the wall: {beside}");
    }
}
