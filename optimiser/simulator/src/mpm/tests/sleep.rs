//! Powder that sleeps: what it changes, what wakes it, and that nobody else notices.

use crate::mpm::Model;
use crate::mpm::particles::{Group, LANES, Lanes, Particles};
use crate::mpm::sleep::{self, Speeds};
use crate::mpm::sort::sort;
use crate::mpm::spare::BufferPool;
use crate::mpm::substep::{State, Workspace};
use crate::mpm::tests::{Dice, advance, empty_bench, even_lattice, far_away, standing};
use crate::scene::{SleepBy, Sleepers, Transfer};

const SLEEP_SPEED: f64 = 5e-4;
/// The bed: a box of powder on the floor of an empty volume, between its walls.
const SIZE_M: [f64; 3] = [0.048, 0.032, 0.160];
const DEPTH_M: f64 = 0.032;

fn model(sleep_speed_m_s: f64) -> Model<f64> {
    model_with(SleepBy::Largest, sleep_speed_m_s, None)
}

fn model_with(sleep_by: SleepBy, sleep_speed_m_s: f64, transfer: Option<Transfer>) -> Model<f64> {
    let mut scene = empty_bench(SIZE_M);
    scene.domain.sleep_by = sleep_by;
    scene.domain.sleep_speed_m_s = sleep_speed_m_s;
    scene.powder.transfer = transfer;
    Model::new(&scene)
}

fn bed() -> Vec<[f64; 3]> {
    even_lattice([0.0; 3], [SIZE_M[0], SIZE_M[1], DEPTH_M])
}

/// The bed with a lump far above it, which arrives after 0.14 s; and how many particles the bed has.
fn bed_and_lump() -> (Vec<[f64; 3]>, usize) {
    let mut points = bed();
    let count = points.len();
    points.extend(even_lattice([0.016, 0.012, 0.130], [0.024, 0.020, 0.138]));
    (points, count)
}

/// After so many substeps without a tool.
fn rested(model: &Model<f64>, points: &[[f64; 3]], substeps: usize) -> State<f64> {
    let mut state = State::new(model, &far_away(), &Particles::at_rest(points)).unwrap();
    advance(model, &far_away(), &mut state, substeps);
    state
}

fn asleep(state: &State<f64>) -> usize {
    state.sleepers().filter(|asleep| *asleep).count()
}

fn farthest(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    let distance =
        |(a, b): (&[f64; 3], &[f64; 3])| [0, 1, 2].map(|i| (a[i] - b[i]).powi(2)).iter().sum::<f64>().sqrt();
    a.iter().zip(b).map(distance).fold(0.0, f64::max)
}

#[test]
fn a_bed_at_rest_falls_asleep_where_it_would_have_stayed() {
    let (sleepy, wakeful) = (model(SLEEP_SPEED), model(0.0));
    let points = bed();
    let mut state = rested(&sleepy, &points, 1500);
    assert_eq!(asleep(&state), state.layout.blocks.len(), "a bed at rest");
    let before = state.particles.groups.clone();
    advance(&sleepy, &far_away(), &mut state, 300);
    assert!(state.particles.groups == before, "sleepers stay as they are");

    let watched = rested(&wakeful, &points, 1800);
    assert_eq!(asleep(&watched), 0);
    let apart = farthest(&state.particles.positions_by_id(), &watched.particles.positions_by_id());
    println!("asleep after 0.75 s, at most {:.1e} m from where the awake bed is after 0.9 s", apart);
    assert!(apart < 5e-5, "{apart}");
}

#[test]
fn the_tool_wakes_what_it_comes_near_to() {
    let model = model(SLEEP_SPEED);
    let mut state = rested(&model, &bed(), 1500);
    let blocks = state.layout.blocks.len();
    // A bowl just above one end of the bed.
    let tool = standing([0.0, 0.016, DEPTH_M + 0.020]);
    advance(&model, &tool, &mut state, 2);
    let woken = blocks - asleep(&state);
    assert!(woken > 0 && woken < blocks, "{woken} of {blocks}");
    // As long as it is there they do not fall asleep again.
    advance(&model, &tool, &mut state, 300);
    assert_eq!(blocks - asleep(&state), woken);
    advance(&model, &far_away(), &mut state, 300);
    assert_eq!(asleep(&state), blocks);
}

#[test]
fn what_falls_on_sleepers_wakes_them_and_comes_to_rest_as_on_those_awake() {
    for sleep_by in [SleepBy::Largest, SleepBy::MeanSquare] {
        falls_on_sleepers(sleep_by, SLEEP_SPEED, None);
        // The bed comes to rest later if it gets its velocity back.
        falls_on_sleepers(sleep_by, 4.0 * SLEEP_SPEED, Some(Transfer { residue_time_s: 0.005 }));
    }
}

fn falls_on_sleepers(sleep_by: SleepBy, sleep_speed: f64, transfer: Option<Transfer>) {
    let [sleepy, wakeful] = [sleep_speed, 0.0].map(|speed| model_with(sleep_by, speed, transfer));
    let (points, count) = bed_and_lump();
    let mut state = State::new(&sleepy, &far_away(), &Particles::at_rest(&points)).unwrap();
    let mut workspace = Workspace::new();
    let (mut sleepers, mut awake) = (0, 0);
    for substep in 0..1200 {
        workspace.substep(&sleepy, &far_away(), &mut state).unwrap();
        if substep < 250 {
            sleepers = asleep(&state);
        } else {
            awake = awake.max(state.layout.blocks.len() - asleep(&state));
        }
    }
    println!("{sleep_by:?}: {sleepers} blocks asleep before the lump arrives, up to {awake} awake after it");
    assert!(sleepers > 0 && awake > 3, "{sleepers} {awake}");
    let want = rested(&wakeful, &points, 1200).particles.positions_by_id();
    let got = state.particles.positions_by_id();
    let height = |of: &[[f64; 3]]| of.iter().map(|x| x[2]).sum::<f64>() / of.len() as f64;
    for (name, range) in [("bed", 0..count), ("lump", count..points.len())] {
        let apart = height(&got[range.clone()]) - height(&want[range]);
        println!("{name}: {apart:.1e} m higher than awake, on average");
        assert!(apart.abs() < 2e-4, "{name}: {apart}");
    }
}

#[test]
fn cotangents_of_sleepers_stay_and_those_of_others_are_what_they_are_without_them() {
    [SleepBy::Largest, SleepBy::MeanSquare].into_iter().for_each(cotangents_of_sleepers_stay);
}

fn cotangents_of_sleepers_stay(sleep_by: SleepBy) {
    let [sleepy, wakeful] = [SLEEP_SPEED, 0.0].map(|speed| model_with(sleep_by, speed, None));
    let (points, count) = bed_and_lump();
    let mut state = rested(&sleepy, &points, 230);
    for _ in 0..200 {
        if asleep(&state) > 0 {
            break;
        }
        advance(&sleepy, &far_away(), &mut state, 1);
    }
    let sleepers: Vec<bool> = state.sleepers().collect();
    assert!(sleepers.iter().any(|asleep| *asleep));
    let mut dice = Dice::new(91);
    let mut bar = vec![Group::ZERO; state.particles.groups.len()];
    for (g, l, _) in state.particles.occupied() {
        (0..22).for_each(|k| super::row(&mut bar[g], k)[l] = dice.roll());
    }
    let before = bar.clone();
    let mut wide_awake = State::new(&wakeful, &far_away(), &state.particles).unwrap();
    assert_eq!(asleep(&wide_awake), 0);
    wide_awake.particles = state.particles.clone();
    wide_awake.layout = state.layout.clone();
    let mut other = bar.clone();
    Workspace::new().substep_adjoint(&sleepy, &far_away(), &state, None, &mut bar);
    Workspace::new().substep_adjoint(&wakeful, &far_away(), &wide_awake, None, &mut other);
    let (mut of_lump, mut kept) = (0, 0);
    for (block, asleep) in state.layout.blocks.iter().zip(sleepers) {
        for g in block.first_group..block.first_group + block.groups() {
            if asleep {
                assert!(bar[g] == before[g]);
                kept += 1;
            } else if state.particles.ids[g].iter().all(|id| *id as usize >= count) {
                assert!(bar[g] == other[g] && bar[g] != before[g]);
                of_lump += 1;
            }
        }
    }
    assert!(of_lump > 0 && kept > 0, "{of_lump} {kept}");
}

#[test]
fn at_rest_nothing_of_a_group_moves_and_all_else_is_as_it_was() {
    let mut group = Group::<f64>::ZERO;
    let rows = group.x.iter_mut().chain(&mut group.v).chain(&mut group.c);
    let rows = rows.chain(&mut group.strain).chain(&mut group.q);
    rows.zip(1..).for_each(|(row, k)| *row = Lanes([f64::from(k); LANES]));
    // Positions, velocities, velocity gradient, strain, volume correction.
    let left: Vec<f64> = group.at_rest().rows().map(|row| row[3]).collect();
    let moves = |k: &i32| (4..=15).contains(k);
    assert_eq!(left, (1..=22).map(|k| if moves(&k) { 0.0 } else { f64::from(k) }).collect::<Vec<_>>());
}

/// A lump that drifts, slowly, in weightlessness.
#[test]
fn who_sleeps_still_gives_no_momentum() {
    for (sleepers, share) in [(Sleepers::Moving, 1.0), (Sleepers::Still, 0.0)] {
        let mut scene = empty_bench(SIZE_M);
        scene.domain.gravity_m_s2 = [0.0; 3];
        scene.domain.sleep_speed_m_s = SLEEP_SPEED;
        scene.domain.sleepers = sleepers;
        let model = Model::<f64>::new(&scene);
        let mut particles = Particles::at_rest(&even_lattice([0.016, 0.012, 0.08], [0.032, 0.020, 0.096]));
        let drift = 0.5 * SLEEP_SPEED;
        particles.groups.iter_mut().for_each(|group| group.v[2] = Lanes([drift; LANES]));
        let count = particles.occupied().count() as f64;
        let mut state = State::new(&model, &far_away(), &particles).unwrap();
        advance(&model, &far_away(), &mut state, (0.1 / scene.time.substep_s()) as usize);
        let tiles = state.rest().iter().map(|rest| rest.sent().expect("all sleep").0);
        let sent = tiles.flatten().fold([0.0; 4], |sum, node| std::array::from_fn(|k| sum[k] + node[k]));
        let mass = count * scene.particle_mass_kg();
        assert!((sent[3] / mass - 1.0).abs() < 1e-12, "{sleepers:?} {sent:?}");
        assert!((sent[2] / (mass * drift) - share).abs() < 1e-9, "{sleepers:?} {sent:?}");
    }
}

/// One that is quiet but for a single grain is asleep by the mean, and the grain with it; of a grain that is faster it is not.
#[test]
fn by_the_mean_a_slow_grain_keeps_nobody_awake_and_a_fast_one_does() {
    let asleep_with = |sleep_by: SleepBy, speed: f64| {
        let model = model_with(sleep_by, SLEEP_SPEED, None);
        let (mut speeds, still, mut other) = (Speeds::new(&model), [Lanes::ZERO; 3], [Lanes::ZERO; 3]);
        other[1][3] = speed;
        for v in (0..25).map(|group| if group == 7 { &other } else { &still }) {
            speeds.add([v, v], &Lanes::ZERO, LANES);
        }
        speeds.are_quiet(400)
    };
    for (sleep_by, bound) in [(SleepBy::Largest, SLEEP_SPEED), (SleepBy::MeanSquare, 20.0 * SLEEP_SPEED)] {
        assert!(asleep_with(sleep_by, 0.99 * bound), "{sleep_by:?}");
        assert!(!asleep_with(sleep_by, 1.01 * bound), "{sleep_by:?}");
        assert!(!asleep_with(sleep_by, f64::NAN), "{sleep_by:?}");
    }
}

#[test]
fn a_sort_wakes_only_blocks_whose_particles_change() {
    let model = model(SLEEP_SPEED);
    let mut state = rested(&model, &bed(), 1500);
    let blocks = state.layout.blocks.len();
    let kept = |state: &State<f64>| {
        let (particles, layout, order) =
            sort(&model, &far_away(), &state.particles, &mut BufferPool::empty()).unwrap();
        let rest = sleep::after_sort(state.rest(), &state.layout, &layout, &order, &particles.groups);
        // Sleepers are the particles that the sort puts there, in its order.
        let mut groups = particles.groups.clone();
        for (block, rest) in layout.blocks.iter().zip(&rest) {
            rest.restore_into(&mut groups[block.first_group..block.first_group + block.groups()]);
        }
        for (g, l, _) in particles.occupied() {
            assert!(
                groups[g]
                    .rows()
                    .zip(particles.groups[g].rows())
                    .all(|(a, b)| a[l].to_bits() == b[l].to_bits())
            );
        }
        rest.iter().filter(|rest| rest.is_asleep()).count()
    };
    assert_eq!(kept(&state), blocks);
    // One particle goes to the block beside its own.
    let block = state.layout.blocks[0].clone();
    let group = &mut state.particles.groups[block.first_group];
    let lane = (0..LANES).max_by(|a, b| group.x[0][*a].total_cmp(&group.x[0][*b])).unwrap();
    group.x[0][lane] += 0.016;
    assert_eq!(kept(&state), blocks - 2);
}
