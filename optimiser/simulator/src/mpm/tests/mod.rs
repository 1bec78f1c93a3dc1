//! The derivative of every stage against the stage itself, and the physics that must hold.

mod bulk;
mod conservation;
mod gates;
mod sleep;
mod stages;
mod substep;
mod walls;

use nalgebra::{Matrix3, Rotation3, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::mpm::Model;
use crate::mpm::bodies::Bodies;
use crate::mpm::contact::BodyState;
use crate::mpm::g2p::TileToParticles;
use crate::mpm::grid_update::UpdateNodes;
use crate::mpm::layout::{BLOCK_NODES, Nodes, empty_tile};
use crate::mpm::p2g::ParticlesToTile;
use crate::mpm::particles::{Group, Lanes, Particles, vec_of};
use crate::mpm::principal::return_map;
use crate::mpm::stencil::Tile;
use crate::mpm::stencil_positions::ALL_NEIGHBOURS;
use crate::mpm::substep::{State, Workspace};
use crate::real::Real;
use crate::scene::Scene;

/// Uniform numbers in [-1, 1].
pub(crate) struct Dice(ChaCha8Rng);

impl Dice {
    pub(crate) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }
    pub(crate) fn roll(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
    pub(crate) fn many<const N: usize>(&mut self, scale: f64) -> [f64; N] {
        std::array::from_fn(|_| scale * self.roll())
    }
}

/// Slope of the Taylor remainder `|f(x + h d) - f(x) - h g.d|` in a log-log plot: 2 if `g` is the gradient.
///
/// The remainder is the largest over several directions at each `h`, so that a direction in which the second
/// derivative happens to vanish does not spoil the slope.
pub(crate) fn taylor_slope(
    dimensions: usize,
    seed: u64,
    scale: f64,
    f: &dyn Fn(&[f64]) -> f64,
    x: &[f64],
    gradient: &[f64],
) -> f64 {
    let directions = directions(dimensions, seed);
    let at = f(x);
    let remainder = |h: f64| {
        let along = |d: &Vec<f64>| {
            let moved: Vec<f64> = x.iter().zip(d).map(|(x, d)| x + h * d).collect();
            let slope: f64 = gradient.iter().zip(d).map(|(g, d)| g * d).sum();
            (f(&moved) - at - h * slope).abs()
        };
        directions.iter().map(along).fold(0.0, f64::max)
    };
    let (big, small) = (scale, scale / 16.0);
    // Linear to rounding: as good as a slope of two.
    if remainder(big) < 1e-14 {
        return 2.0;
    }
    (remainder(big) / remainder(small)).log2() / 4.0
}

/// Four random directions.
fn directions(dimensions: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut dice = Dice::new(seed);
    (0..4).map(|_| (0..dimensions).map(|_| dice.roll()).collect()).collect()
}

/// The same slope of the symmetric second differences `|f(x + h d) - 2 f(x) + f(x - h d)|`, which knows nothing
/// of any gradient: 2 where `f` is smooth, less if a kink lies within reach.
fn second_difference_slope(
    dimensions: usize,
    seed: u64,
    scale: f64,
    f: &dyn Fn(&[f64]) -> f64,
    x: &[f64],
) -> f64 {
    let directions = directions(dimensions, seed);
    let at = f(x);
    let step = |d: &Vec<f64>, h: f64| -> Vec<f64> { x.iter().zip(d).map(|(x, d)| x + h * d).collect() };
    let along = |d: &Vec<f64>, h: f64| (f(&step(d, h)) - 2.0 * at + f(&step(d, -h))).abs();
    let difference = |h: f64| directions.iter().map(|d| along(d, h)).fold(0.0, f64::max);
    (difference(scale) / difference(scale / 16.0)).log2() / 4.0
}

/// Taylor slope two of `gradient`, at a place that is first shown to be away from kinks.
pub(crate) fn assert_gradient(
    name: &str,
    scale: f64,
    f: &dyn Fn(&[f64]) -> f64,
    x: &[f64],
    gradient: &[f64],
) {
    assert_eq!(x.len(), gradient.len(), "{name}");
    let smooth = second_difference_slope(x.len(), 3, scale, f, x);
    let slope = taylor_slope(x.len(), 3, scale, f, x, gradient);
    println!("{name}: Taylor slope {slope:.4}, slope of the second differences {smooth:.4}");
    assert!((smooth - 2.0).abs() < 0.1, "{name}: a kink is near: {smooth}");
    assert_slope_two(name, slope);
}

fn assert_slope_two(name: &str, slope: f64) {
    assert!((slope - 2.0).abs() < 0.1, "{name}: Taylor slope {slope}");
}

/// A shipped scene whose powder never sleeps.
fn awake(name: &str) -> Scene {
    let mut scene = Scene::load(name).unwrap();
    scene.domain.sleep_speed_m_s = 0.0;
    scene
}

/// The floor and walls of a box of the given size, and the tool of the small bench.
fn empty_bench(size_m: [f64; 3]) -> Scene {
    let mut scene = awake("bench-small");
    scene.domain.size_m = size_m;
    scene.containers.clear();
    // Viscosity is there to be tested; what is given back of the velocity is what some tests are about.
    scene.powder.viscosity_pa_s = 0.08;
    scene.powder.transfer = None;
    scene
}

/// An upright tool at rest, and no gate.
fn standing<T: Real>(position: [f64; 3]) -> Bodies<T> {
    let (zero, one) = (T::ZERO, T::ONE);
    let tool = BodyState {
        rotation: [[one, zero, zero], [zero, one, zero], [zero, zero, one]],
        position: position.map(T::from_f64),
        velocity: [zero; 3],
        angular_velocity: [zero; 3],
    };
    Bodies { tool, gates: Vec::new() }
}

/// A tool out of everybody's reach, and no gate.
fn far_away<T: Real>() -> Bodies<T> {
    standing([10.0; 3])
}

/// The tool after a small change of position, of orientation (from the left), of velocity and of angular velocity.
fn moved(bodies: &Bodies<f64>, d: &[f64]) -> Bodies<f64> {
    let tool = &bodies.tool;
    let turn = Rotation3::from_scaled_axis(Vector3::new(d[3], d[4], d[5])).into_inner();
    let rotation = turn * Matrix3::from_fn(|i, j| tool.rotation[i][j]);
    let tool = BodyState {
        rotation: std::array::from_fn(|i| std::array::from_fn(|j| rotation[(i, j)])),
        position: std::array::from_fn(|i| tool.position[i] + d[i]),
        velocity: std::array::from_fn(|i| tool.velocity[i] + d[6 + i]),
        angular_velocity: std::array::from_fn(|i| tool.angular_velocity[i] + d[9 + i]),
    };
    Bodies { tool, gates: bodies.gates.clone() }
}

/// Points of a jittered lattice in a box.
fn lattice(min: [f64; 3], max: [f64; 3], spacing: f64, dice: &mut Dice) -> Vec<[f64; 3]> {
    let count = [0, 1, 2].map(|a| ((max[a] - min[a]) / spacing + 1e-6) as usize);
    let mut out = Vec::new();
    for n in 0..count[0] * count[1] * count[2] {
        let cell = [n % count[0], n / count[0] % count[1], n / count[0] / count[1]];
        out.push([0, 1, 2].map(|a| min[a] + spacing * (cell[a] as f64 + 0.5 + 0.45 * dice.roll())));
    }
    out
}

/// Points of an even lattice in a box, eight to a cell of 4 mm.
fn even_lattice(low: [f64; 3], high: [f64; 3]) -> Vec<[f64; 3]> {
    let count = [0, 1, 2].map(|a| ((high[a] - low[a]) / 0.002).round() as usize);
    let mut out = Vec::new();
    for n in 0..count[0] * count[1] * count[2] {
        let cell = [n % count[0], n / count[0] % count[1], n / count[0] / count[1]];
        out.push([0, 1, 2].map(|a| low[a] + (cell[a] as f64 + 0.5) * (high[a] - low[a]) / count[a] as f64));
    }
    out
}

/// Row `k` of the 22 of a group, in the order of [`Group::rows`].
fn row<T>(group: &mut Group<T>, k: usize) -> &mut Lanes<T> {
    match k {
        0..3 => &mut group.x[k],
        3..6 => &mut group.v[k - 3],
        6..15 => &mut group.c[k - 6],
        15..21 => &mut group.strain[k - 15],
        _ => &mut group.q[0],
    }
}

/// What all blocks send to the grid: tiles, those without forces where they are asked for, and the particles with their new strains.
struct OnTiles<T> {
    tiles: Vec<Tile<T>>,
    unforced: Vec<Tile<T>>,
    groups: Vec<Group<T>>,
}

/// Material and scatter of all blocks.
fn to_tiles<T: Real>(model: &Model<T>, state: &State<T>) -> OnTiles<T> {
    let input = &state.particles.groups;
    let mut tiles = vec![empty_tile(); state.layout.blocks.len()];
    let (mut unforced_tiles, mut groups) = (tiles.clone(), vec![Group::ZERO; input.len()]);
    for ((block, tile), unforced) in state.layout.blocks.iter().zip(&mut tiles).zip(&mut unforced_tiles) {
        let range = block.first_group..block.first_group + block.groups();
        let (from, state) = (Some(&input[range.clone()]), &mut groups[range]);
        let unforced = model.residue.map(|_| unforced);
        model.arch.dispatch(ParticlesToTile { model, block, from, state, tile, unforced });
    }
    OnTiles { tiles, unforced: unforced_tiles, groups }
}

/// Grid update of all node blocks: momentum and mass before, velocity after.
fn on_grid<T: Real>(
    model: &Model<T>,
    bodies: &Bodies<T>,
    state: &State<T>,
    tiles: &[Tile<T>],
) -> (Vec<Nodes<T>>, Vec<Nodes<T>>) {
    let zero = vec![[[T::ZERO; 4]; BLOCK_NODES]; state.layout.nodes.len()];
    let (mut momentum, mut velocity) = (zero.clone(), zero);
    for ((node, momentum), velocity) in state.layout.nodes.iter().zip(&mut momentum).zip(&mut velocity) {
        let (tiles, holds_volume, unforced) = (state.tiles(tiles), state.holds_volume(model), None);
        let update = UpdateNodes { model, bodies, node, tiles, holds_volume, momentum, velocity, unforced };
        model.arch.dispatch(update);
    }
    (momentum, velocity)
}

/// Gather, contact at particles and advection of all blocks; strain and volume correction are left alone. `at_nodes` are velocity,
/// and velocity without forces.
fn to_particles<T: Real>(
    model: &Model<T>,
    bodies: &Bodies<T>,
    state: &State<T>,
    [velocity, unforced]: [&[Nodes<T>]; 2],
) -> Vec<Group<T>> {
    let mut output = state.particles.groups.clone();
    let (holds_volume, unforced) = (state.holds_volume(model), model.residue.map(|_| unforced));
    for block in &state.layout.blocks {
        let state = &mut output[block.first_group..block.first_group + block.groups()];
        model.arch.dispatch(TileToParticles {
            model,
            bodies,
            block,
            reached: ALL_NEIGHBOURS,
            velocity,
            unforced,
            holds_volume,
            state,
        });
    }
    output
}

/// Advances by a number of substeps under a tool and gates that do not change.
fn advance<T: Real>(model: &Model<T>, bodies: &Bodies<T>, state: &mut State<T>, substeps: usize) {
    let mut workspace = Workspace::new();
    for _ in 0..substeps {
        workspace.substep(model, bodies, state).unwrap();
    }
}

/// A particle at rest.
#[derive(Clone, Copy)]
struct Settled {
    x: [f64; 3],
    /// Kirchhoff stress, Pa: xx, yy, zz, and shear.
    stress: [f64; 6],
}

/// Every particle after `substeps` without a tool.
fn settle(scene: &Scene, positions: &[[f64; 3]], substeps: usize) -> Vec<Settled> {
    settled_often(scene, positions, substeps, 1, 0).remove(0)
}

/// The same, and `times` more, each after `every` further substeps.
fn settled_often(
    scene: &Scene,
    positions: &[[f64; 3]],
    substeps: usize,
    every: usize,
    times: usize,
) -> Vec<Vec<Settled>> {
    let model: Model<f64> = Model::new(scene);
    let mut state = State::new(&model, &far_away(), &Particles::at_rest(positions)).unwrap();
    let later = std::iter::repeat_n(every, times);
    let look = |substeps: usize| {
        advance(&model, &far_away(), &mut state, substeps);
        looked_at(&model, &state)
    };
    std::iter::once(substeps).chain(later).map(look).collect()
}

/// Every particle as it is.
fn looked_at(model: &Model<f64>, state: &State<f64>) -> Vec<Settled> {
    let particles = state.particles.occupied().count();
    let mut out = vec![Settled { x: [0.0; 3], stress: [0.0; 6] }; particles];
    for (g, l, id) in state.particles.occupied() {
        let group = &state.particles.groups[g];
        let (stress, _, _) = return_map(&model.material, group.strain_of(l), [0.0; 2]);
        out[id as usize] = Settled { x: vec_of(&group.x, l), stress };
    }
    out
}

/// Mean of a number over the particles for which `keep` holds.
fn mean(of: &[Settled], keep: impl Fn(&Settled) -> bool, number: impl Fn(&Settled) -> f64) -> f64 {
    let kept: Vec<f64> = of.iter().filter(|p| keep(p)).map(number).collect();
    kept.iter().sum::<f64>() / kept.len() as f64
}
