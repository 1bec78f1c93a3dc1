//! Transfers, grid update, one whole substep, and the sorting between substeps, against finite differences.
//!
//! All numbers are scaled to order one, so that a random direction moves each of them by its own measure.

use crate::mpm::Model;
use crate::mpm::bodies::Bodies;
use crate::mpm::contact::{BodyState, BodyStateBar};
use crate::mpm::g2p::TileToParticlesAdjoint;
use crate::mpm::gather::{Gathered, Rows, Sent, gather_all, gather_fourth};
use crate::mpm::gather::{gather_gradient, gather_sum, gather_with_gradient};
use crate::mpm::grid_update::UpdateNodesAdjoint;
use crate::mpm::layout::{BLOCK_NODES, NodeBlock, Nodes, empty_tile, load_tile};
use crate::mpm::material::{Material, twice_shear};
use crate::mpm::p2g::{ParticlesToTileAdjoint, affine, at_base};
use crate::mpm::particles::{Group, LANES, Lanes, Particles, mat_of, set_mat};
use crate::mpm::residue::{unforced_velocity, unforced_velocity_adjoint};
use crate::mpm::sort::{sort, sort_adjoint};
use crate::mpm::spare::BufferPool;
use crate::mpm::stencil::{Affine, Stencil, TILE_EDGE, TILE_LENGTH, Tile, scatter, weight_slopes, weights};
use crate::mpm::stencil_positions::{ALL_NEIGHBOURS, StencilPositions};
use crate::mpm::substep::{State, Workspace};
use crate::mpm::tests::{
    Dice, assert_gradient, empty_bench, far_away, lattice, moved, on_grid, row, standing, to_particles,
    to_tiles,
};
use crate::mpm::tiles::Tiles;
use crate::real::Real;
use crate::scene::{Flow, Transfer, VolumeCorrection, Walls, YieldSurface};
use crate::shape::SignedDistance;
use crate::small::{Mat3, Vec3, mul_vec, sub, three, tr_mul_vec};

/// Typical cell size (m), speed (m/s), affine velocity (1/s), strain.
const CELL: f64 = 0.004;
const SPEED: f64 = 0.1;
const RATE: f64 = 5.0;
const STRAIN: f64 = 0.01;
/// Typical size of each of a particle's 22 numbers.
const SIZES: [f64; 22] = {
    let mut sizes = [STRAIN; 22];
    let mut k = 0;
    while k < 15 {
        sizes[k] = if k < 3 { CELL } else { if k < 6 { SPEED } else { RATE } };
        k += 1;
    }
    sizes
};
/// Typical size of each of the twelve numbers of the tool's motion: m, rad, m/s, rad/s.
const TOOL_SIZES: [f64; 12] = [CELL, CELL, CELL, 0.1, 0.1, 0.1, SPEED, SPEED, SPEED, 2.0, 2.0, 2.0];

fn scaled(x: &[f64], sizes: &[f64]) -> Vec<f64> {
    x.iter().zip(sizes.iter().cycle()).map(|(x, s)| x * s).collect()
}

/// 22 numbers of every particle, in memory order, each in units of its typical size.
fn numbers(particles: &Particles<f64>) -> Vec<f64> {
    let of = |(g, l, _): (usize, usize, u32)| {
        let group: &Group<f64> = &particles.groups[g];
        group.rows().zip(SIZES).map(|(row, size)| row[l] / size).collect::<Vec<_>>()
    };
    particles.occupied().flat_map(of).collect()
}

fn with_numbers(state: &State<f64>, x: &[f64]) -> State<f64> {
    let mut state = state.clone();
    let places: Vec<_> = state.particles.occupied().collect();
    for ((g, l, _), x) in places.into_iter().zip(x.chunks(22)) {
        for k in 0..22 {
            row(&mut state.particles.groups[g], k)[l] = x[k] * SIZES[k];
        }
    }
    state
}

/// Derivative by [`numbers`] from cotangents; those of a strain count the off-diagonal entries once.
fn simulate_with_gradient(particles: &Particles<f64>, bar: &[Group<f64>]) -> Vec<f64> {
    let twice = |k: usize| if (18..21).contains(&k) { 2.0 } else { 1.0 };
    let of = |(g, l, _): (usize, usize, u32)| {
        let rows = bar[g].rows().enumerate();
        rows.map(|(k, row)| row[l] * SIZES[k] * twice(k)).collect::<Vec<_>>()
    };
    particles.occupied().flat_map(of).collect()
}

fn tool_gradient(bar: &BodyStateBar) -> Vec<f64> {
    let all = [bar.position, bar.rotation, bar.velocity, bar.angular_velocity].concat();
    scaled(&all, &TOOL_SIZES)
}

/// A made-up measurement of all particles: 22 weights for each identity.
struct Measure(Vec<[f64; 22]>);

impl Measure {
    fn random(particles: usize, rows: std::ops::Range<usize>, dice: &mut Dice) -> Self {
        let weight = |k: usize, roll: f64| if rows.contains(&k) { roll / SIZES[k] } else { 0.0 };
        Self((0..particles).map(|_| std::array::from_fn(|k| weight(k, dice.roll()))).collect())
    }

    fn of(&self, ids: &Particles<f64>, groups: &[Group<f64>]) -> f64 {
        let one = |(g, l, id): (usize, usize, u32)| -> f64 {
            groups[g].rows().zip(self.0[id as usize]).map(|(row, w)| w * row[l]).sum()
        };
        ids.occupied().map(one).sum()
    }

    fn cotangent(&self, ids: &Particles<f64>) -> Vec<Group<f64>> {
        let mut bar = vec![Group::ZERO; ids.groups.len()];
        for (g, l, id) in ids.occupied() {
            for k in 0..22 {
                let twice = if (18..21).contains(&k) { 0.5 } else { 1.0 };
                row(&mut bar[g], k)[l] = twice * self.0[id as usize][k];
            }
        }
        bar
    }
}

/// Strains well inside one branch of the return map each (elastic, cone, apex), and velocities at random.
fn stir(state: &mut State<f64>, dice: &mut Dice) {
    const BRANCHES: [[f64; 6]; 3] = [
        [-0.031, -0.028, -0.034, 0.0021, -0.0013, 0.0008],
        [-0.031, 0.012, -0.024, 0.021, -0.013, 0.008],
        [0.031, 0.012, 0.024, 0.021, -0.013, 0.008],
    ];
    let places: Vec<_> = state.particles.occupied().collect();
    for (g, l, id) in places {
        let strain = BRANCHES[id as usize % 3];
        for k in 3..22 {
            let (middle, size) = match k {
                3..15 => (0.0, SIZES[k]),
                15..21 => (strain[k - 15], 0.001),
                _ => (0.004, 0.001),
            };
            row(&mut state.particles.groups[g], k)[l] = middle + size * dice.roll();
        }
    }
}

/// What can be another in a powder: its yield surface, its volume correction and the strain over which it is loosened, whether it gets its
/// velocity residue back, whether it has two angles; and its walls.
type Law = (YieldSurface, (VolumeCorrection, Option<f64>), Option<Transfer>, Option<Flow>, Walls);

const BY_STRAIN: (VolumeCorrection, Option<f64>) = (VolumeCorrection::Strain, None);
const BY_GRID: (VolumeCorrection, Option<f64>) = (VolumeCorrection::Grid, None);
/// A strain such that at the rates here powder is loosened by a part.
const BY_SHEAR: (VolumeCorrection, Option<f64>) = (VolumeCorrection::Grid, Some(0.5));

const GIVEN_BACK: Option<Transfer> = Some(Transfer { residue_time_s: 0.01 });
/// Grains so large that at the rates here the slope is between both.
const TWO_ANGLES: Option<Flow> = Some(Flow { grain_diameter_m: 2e-2, grain_density_kg_m3: 1667.0 });

/// Powders of every law.
const POWDERS: [Law; 10] = [
    (YieldSurface::DruckerPrager, BY_STRAIN, None, None, Walls::Shared),
    (YieldSurface::MatsuokaNakai, BY_STRAIN, None, None, Walls::Shared),
    (YieldSurface::DruckerPrager, BY_GRID, None, None, Walls::Shared),
    (YieldSurface::DruckerPrager, BY_STRAIN, GIVEN_BACK, None, Walls::Shared),
    (YieldSurface::MatsuokaNakai, BY_STRAIN, None, TWO_ANGLES, Walls::Shared),
    (YieldSurface::MatsuokaNakai, BY_GRID, GIVEN_BACK, TWO_ANGLES, Walls::Shared),
    (YieldSurface::DruckerPrager, BY_STRAIN, None, None, Walls::TwoSided),
    (YieldSurface::MatsuokaNakai, BY_GRID, GIVEN_BACK, TWO_ANGLES, Walls::TwoSided),
    (YieldSurface::DruckerPrager, BY_SHEAR, None, None, Walls::Shared),
    (YieldSurface::MatsuokaNakai, BY_SHEAR, GIVEN_BACK, TWO_ANGLES, Walls::TwoSided),
];

/// A bowl that pushes down and forward into stirred powder on the floor, tilted, turning. Where volume is held to the grid's density,
/// every seventh particle believes to be looser than it is; the others lie looser than they believe.
fn scooping_of(
    (yield_surface, (volume_correction, loosening_strain), transfer, flow, walls): Law,
) -> (Model<f64>, State<f64>, Bodies<f64>) {
    let mut dice = Dice::new(71);
    let mut scene = empty_bench([0.064; 3]);
    scene.powder.yield_surface = yield_surface;
    scene.powder.volume_correction = volume_correction;
    scene.powder.loosening_strain = loosening_strain;
    scene.powder.transfer = transfer;
    scene.powder.flow = flow;
    scene.domain.walls = walls;
    let model = Model::<f64>::new(&scene);
    let tool = BodyState {
        velocity: [0.12, 0.03, -0.1],
        angular_velocity: [0.3, -2.0, 0.4],
        ..moved(
            &standing([0.029, 0.033, 0.022]),
            &[0.0, 0.0, 0.0, 0.1, 0.7, -0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        )
        .tool
    };
    // Powder around the bowl and in it, a little of it in the surface.
    let clear = |x: &[f64; 3]| {
        let y = tr_mul_vec(&tool.rotation, sub(*x, tool.position));
        let crate::shape::Shape::Bowl(bowl) = model.obstacles.tool[0].shape else { panic!("a bowl") };
        bowl.distance::<f64>(y).0 > -0.0005
    };
    let points = lattice([0.017, 0.021, 0.001], [0.045, 0.045, 0.019], 0.0023, &mut dice);
    let points: Vec<_> = points.into_iter().filter(clear).collect();
    let bodies = Bodies { tool, gates: Vec::new() };
    let mut state = State::new(&model, &bodies, &Particles::at_rest(&points)).unwrap();
    stir(&mut state, &mut dice);
    if model.holds_volume {
        for (g, l, _) in state.particles.clone().occupied().filter(|(.., id)| id % 7 == 0) {
            state.particles.groups[g].q[0][l] = 0.6;
        }
    }
    (model, state, bodies)
}

/// Three numbers along each axis.
type Along = [[f64; 3]; 3];

/// Of a particle somewhere in a tile, from its cell coordinate: where its nodes begin, its weights along each axis, their slopes,
/// and its distance from the first node.
fn place(x: Vec3<f64>) -> (usize, Along, Along, Vec3<f64>) {
    let base = x.map(|x| (x - 0.5).floor());
    let start = base.iter().fold(0, |start, b| start * TILE_EDGE + *b as usize);
    let f = sub(x, base);
    (start, f.map(weights), f.map(weight_slopes), f)
}

fn stencil(x: Vec3<f64>) -> Stencil<f64> {
    let (start, [x, y, along], ..) = place(x);
    Stencil { start, rows: std::array::from_fn(|n| x[n / 3] * y[n % 3]), along }
}

fn random_tile(dice: &mut Dice) -> Tile<f64> {
    let mut tile = empty_tile();
    tile.iter_mut().for_each(|node| *node = dice.many(1.0));
    tile
}

/// What a particle takes from its 27 nodes, one after another: `sum w g` and `sum w g (i, j, k)` of all four numbers, and
/// `sum (dw/dX) (g.P)`.
fn taken(tile: &Tile<f64>, x: Vec3<f64>, sent: &Affine<f64>) -> ([f64; 4], [[f64; 4]; 3], [f64; 3]) {
    let (start, weights, slopes, _) = place(x);
    let (mut sum, mut first, mut gradient) = ([0.0; 4], [[0.0; 4]; 3], [0.0; 3]);
    for n in 0..27 {
        let ijk = [n / 9, n / 3 % 3, n % 3];
        let g = tile[start + (ijk[0] * TILE_EDGE + ijk[1]) * TILE_EDGE + ijk[2]];
        let w = [0, 1, 2].map(|axis| weights[axis][ijk[axis]]);
        let mut product = 0.0;
        for c in 0..4 {
            let steps: f64 = (0..3).map(|axis| ijk[axis] as f64 * sent.steps[axis][c]).sum();
            product += g[c] * (sent.p[c] + steps);
            sum[c] += w[0] * w[1] * w[2] * g[c];
            for axis in 0..3 {
                first[axis][c] += w[0] * w[1] * w[2] * g[c] * ijk[axis] as f64;
            }
        }
        for axis in 0..3 {
            let others = w[(axis + 1) % 3] * w[(axis + 2) % 3];
            gradient[axis] += slopes[axis][ijk[axis]] * others * product;
        }
    }
    (sum, first, gradient)
}

/// A group of particles at coordinates in a tile, and what they send.
fn group_at<T: Real>(x: &[Vec3<f64>], sent: &[Affine<f64>]) -> (StencilPositions<T>, Sent<T>) {
    let mut at = [Lanes([T::from_f64(4.0); LANES]); 3];
    let mut out = Sent::ZERO;
    for (l, (x, sent)) in x.iter().zip(sent).enumerate() {
        for c in 0..3 {
            at[c][l] = T::from_f64(x[c]);
            out.base[c][l] = T::from_f64(sent.p[c]);
            for axis in 0..3 {
                out.a_dx[3 * c + axis][l] = T::from_f64(sent.steps[axis][c]);
            }
        }
    }
    (StencilPositions::of(T::ONE, [T::ZERO; 3], &at), out)
}

/// An affine function whose fourth number is the same at all nodes.
fn random_affine(dice: &mut Dice, mass: f64) -> Affine<f64> {
    let step = |[a, b, c]: [f64; 3]| [a, b, c, 0.0];
    let [a, b, c]: [f64; 3] = dice.many(1.0);
    Affine { p: [a, b, c, mass], steps: [step(dice.many(1.0)), step(dice.many(1.0)), step(dice.many(1.0))] }
}

/// Groups as they are: sorted, a few cells along z; with strayers; anywhere; and with lanes that hold nobody.
fn positions_in_a_tile(which: usize, dice: &mut Dice) -> Vec<Vec3<f64>> {
    let spread = [[0.4, 0.4, 1.1], [1.2, 0.4, 1.1], [2.4, 2.4, 2.4]][which % 3];
    let occupied = if which % 4 == 3 { 5 } else { LANES };
    let mut out: Vec<Vec3<f64>> =
        (0..occupied).map(|_| [0, 1, 2].map(|axis| 4.0 + spread[axis] * dice.roll())).collect();
    out.sort_by(|a, b| a[2].total_cmp(&b[2]));
    out
}

fn gathered_as_taken<T: Real>(rounding: f64) {
    const MASS: f64 = 0.7;
    let mut dice = Dice::new(51);
    for which in 0..60 {
        let x: Vec<Vec3<f64>> = positions_in_a_tile(which, &mut dice)
            .into_iter()
            .map(|x| x.map(|x| T::from_f64(x).to_f64()))
            .collect();
        let sent: Vec<_> = x.iter().map(|_| random_affine(&mut dice, MASS)).collect();
        let tile = random_tile(&mut dice);
        let narrow = tile.map(|node| node.map(T::from_f64));
        let (places, sends) = group_at::<T>(&x, &sent);
        let (w, occupied) = (places.weights(), x.len());
        let masses = Lanes([T::from_f64(MASS); LANES]);
        let all = gather_with_gradient(&narrow, &places, &w, &sends, &masses, occupied, &mut Rows::new());
        let alone = gather_sum(&narrow, &places, &w, occupied);
        let other = random_tile(&mut dice).map(|node| node.map(T::from_f64));
        let plain = gather_all(&narrow, None, false, &places, &w, occupied);
        let in_one_go = gather_all(&narrow, Some(&other), true, &places, &w, occupied);
        // To the bit what is gathered one after another.
        assert_eq!(in_one_go.density, gather_fourth::<T, false>(&narrow, &places, &w, occupied).sum);
        assert_eq!(in_one_go.unforced, gather_sum(&other, &places, &w, occupied));
        assert_eq!(in_one_go.velocity.sum, plain.velocity.sum);
        assert_eq!(in_one_go.velocity.first, plain.velocity.first);
        let plain = plain.velocity;
        let massless = gather_gradient(&narrow, &places, &w, &sends, occupied, &mut Rows::new());
        let same = |got: T, want: f64, what: &str| {
            assert!((got.to_f64() - want).abs() < rounding, "{which}, {what}: {got} for {want}");
        };
        for (l, (x, sent)) in x.iter().zip(&sent).enumerate() {
            let (sum, first, gradient) = taken(&tile, *x, sent);
            let mut without = *sent;
            without.p[3] = 0.0;
            let (.., gradient_without) = taken(&tile, *x, &without);
            for c in 0..3 {
                for of in [&all, &plain, &massless] {
                    same(of.sum[c][l], sum[c], "sum");
                }
                same(alone[c][l], sum[c], "sum alone");
                for of in [&all, &plain] {
                    (0..3).for_each(|axis| same(of.first[3 * c + axis][l], first[axis][c], "first moment"));
                }
                same(all.gradient[c][l], gradient[c], "gradient");
                same(massless.gradient[c][l], gradient_without[c], "gradient without mass");
            }
        }
        let rows = |g: &Gathered<T>| -> Vec<T> {
            g.sum.iter().chain(&g.first).chain(&g.gradient).flat_map(|row| row.0).collect()
        };
        for (n, number) in [&all, &plain, &massless].into_iter().flat_map(rows).enumerate() {
            assert!(n % LANES < occupied || number == T::ZERO, "{which}: {number} for nobody");
        }
    }
}

#[test]
fn a_group_gathers_what_its_particles_would_take_one_by_one() {
    gathered_as_taken::<f64>(1e-13);
    gathered_as_taken::<f32>(2e-5);
}

#[test]
fn scatter_is_the_adjoint_of_taking() {
    let mut dice = Dice::new(58);
    for _ in 0..200 {
        let x = dice.many(2.4).map(|x: f64| x + 4.0);
        let a = Affine { p: dice.many(1.0), steps: [dice.many(1.0), dice.many(1.0), dice.many(1.0)] };
        let g = random_tile(&mut dice);
        let mut sent = empty_tile();
        scatter(&mut sent, 1, |_| stencil(x), |_| a);
        let (sum, first, _) = taken(&g, x, &a);
        let dot = |x: [f64; 4], y: [f64; 4]| -> f64 { x.iter().zip(y).map(|(x, y)| x * y).sum() };
        let received = dot(a.p, sum) + (0..3).map(|i| dot(a.steps[i], first[i])).sum::<f64>();
        let given: f64 = g.as_flattened().iter().zip(sent.as_flattened()).map(|(a, b)| a * b).sum();
        assert!((given - received).abs() < 4e-15, "{given} {received}");
    }
}

/// A particle writes to a tile that others have written to and reads back; both ways see its position.
#[test]
fn round_trip_of_a_particle_has_taylor_slope_two_in_its_position() {
    const MASS: f64 = 0.7;
    let mut dice = Dice::new(52);
    let others = random_tile(&mut dice);
    let (v, matrix): (Vec3<f64>, Mat3<f64>) =
        (dice.many(1.0), [dice.many(1.0), dice.many(1.0), dice.many(1.0)]);
    let weight = random_affine(&mut dice, MASS);
    let sends = |x: Vec3<f64>| affine(at_base(v, &matrix, place(x).3), &matrix, MASS);
    let with = |tile: &Tile<f64>, x: Vec3<f64>, sent: &Affine<f64>| {
        let (places, sends) = group_at::<f64>(&[x], &[*sent]);
        let masses = Lanes([MASS; LANES]);
        gather_with_gradient(tile, &places, &places.weights(), &sends, &masses, 1, &mut Rows::new())
    };
    for x in [[2.8, 3.3, 4.1], [3.6, 2.7, 5.2], [4.4, 4.0, 3.1]] {
        let f = |x: &[f64]| {
            let x = [x[0], x[1], x[2]];
            let mut tile = others;
            scatter(&mut tile, 1, |_| stencil(x), |_| sends(x));
            let (sum, first, _) = taken(&tile, x, &weight);
            let of = |w: [f64; 4], m: [f64; 4]| w.iter().zip(m).map(|(w, m)| w * m).sum::<f64>();
            of(weight.p, sum) + (0..3).map(|axis| of(weight.steps[axis], first[axis])).sum::<f64>()
        };
        let sent = sends(x);
        let mut tile = others;
        scatter(&mut tile, 1, |_| stencil(x), |_| sent);
        let reading = with(&tile, x, &weight);
        let mut tile_bar = empty_tile();
        scatter(&mut tile_bar, 1, |_| stencil(x), |_| weight);
        let writing = with(&tile_bar, x, &sent);
        let through_f = tr_mul_vec(&matrix, [0, 1, 2].map(|c| writing.sum[c][0]));
        let gradient = [0, 1, 2].map(|i| reading.gradient[i][0] + writing.gradient[i][0] - through_f[i]);
        assert_gradient("round trip", 1e-2, &f, &x, &gradient);
    }
}

fn random_nodes(blocks: usize, unit: [f64; 4], dice: &mut Dice) -> Vec<Nodes<f64>> {
    let mut nodes = vec![[[0.0; 4]; BLOCK_NODES]; blocks];
    nodes.iter_mut().flatten().for_each(|n| *n = unit.map(|u| u * dice.roll()));
    nodes
}

fn summed(tiles: &Tiles<'_, f64>, node: &NodeBlock) -> Nodes<f64> {
    let mut sum = [[0.0; 4]; BLOCK_NODES];
    tiles.sum(node, &mut sum);
    sum
}

fn inner_nodes(a: &[Nodes<f64>], b: &[Nodes<f64>]) -> f64 {
    a.as_flattened().as_flattened().iter().zip(b.as_flattened().as_flattened()).map(|(a, b)| a * b).sum()
}

#[test]
fn particle_to_grid_has_taylor_slope_two() {
    POWDERS.into_iter().for_each(particle_to_grid_gradient);
}

fn particle_to_grid_gradient(powder: Law) {
    let (model, state, _) = scooping_of(powder);
    let mut dice = Dice::new(53);
    let momentum = 1.0 / (model.mass * SPEED);
    let nodes_bar =
        random_nodes(state.layout.nodes.len(), [momentum, momentum, momentum, 1.0 / model.mass], &mut dice);
    let unit = if model.residue.is_some() { momentum } else { 0.0 };
    let unforced_bar = random_nodes(state.layout.nodes.len(), [unit, unit, unit, 0.0], &mut dice);
    let measure = Measure::random(state.particles.occupied().count(), 15..22, &mut dice);
    let f = |x: &[f64]| {
        let state = with_numbers(&state, x);
        let sent = to_tiles(&model, &state);
        let sum = |tiles: &[Tile<f64>]| -> Vec<_> {
            state.layout.nodes.iter().map(|n| summed(&state.tiles(tiles), n)).collect()
        };
        inner_nodes(&nodes_bar, &sum(&sent.tiles))
            + inner_nodes(&unforced_bar, &sum(&sent.unforced))
            + measure.of(&state.particles, &sent.groups)
    };
    let mut bar = measure.cotangent(&state.particles);
    for block in &state.layout.blocks {
        let range = block.first_group..block.first_group + block.groups();
        model.arch.dispatch(ParticlesToTileAdjoint {
            model: &model,
            block,
            input: &state.particles.groups[range.clone()],
            reached: ALL_NEIGHBOURS,
            nodes_bar: &nodes_bar,
            unforced_bar: model.residue.map(|_| &unforced_bar[..]),
            holds_volume: false,
            bar: &mut bar[range],
        });
    }
    let gradient = simulate_with_gradient(&state.particles, &bar);
    assert_gradient(
        &format!("particle to grid, {powder:?}"),
        1e-3,
        &f,
        &numbers(&state.particles),
        &gradient,
    );
}

/// The tiles' numbers as variables: momentum over typical momentum, mass over a particle's mass.
fn tile_units(model: &Model<f64>) -> [f64; 4] {
    let momentum = model.mass * SPEED;
    [momentum, momentum, momentum, model.mass]
}

#[test]
fn grid_update_has_taylor_slope_two_in_momentum_mass_and_the_tools_motion() {
    [POWDERS[0], POWDERS[2], POWDERS[6], POWDERS[7]].into_iter().for_each(grid_update_gradient);
}

fn grid_update_gradient(powder: Law) {
    let (model, state, bodies) = scooping_of(powder);
    let mut dice = Dice::new(54);
    let units = tile_units(&model);
    // Every node of every tile holds mass; what no tile reaches is no node of the grid.
    let tiles: Vec<f64> = (0..state.layout.blocks.len() * TILE_LENGTH)
        .flat_map(|_| {
            let m = 2.0 + dice.roll();
            let v: [f64; 3] = dice.many(m);
            [v[0], v[1], v[2], m]
        })
        .collect();
    let of_density = if model.holds_volume { 1.0 } else { 0.0 };
    let unit = [1.0 / SPEED, 1.0 / SPEED, 1.0 / SPEED, of_density];
    let mut weights = random_nodes(state.layout.nodes.len(), unit, &mut dice);
    let reached = tiles_at_nodes(&state);
    for (w, r) in weights.iter_mut().flatten().zip(reached.iter().flatten()) {
        *w = w.map(|w| if *r > 0.0 { w } else { 0.0 });
    }
    let as_tiles = |x: &[f64]| -> Vec<Tile<f64>> {
        let entry = |c: &[f64]| [c[0] * units[0], c[1] * units[1], c[2] * units[2], c[3] * units[3]];
        x.chunks(4 * TILE_LENGTH).map(|t| std::array::from_fn(|n| entry(&t[4 * n..4 * n + 4]))).collect()
    };
    let count = tiles.len();
    let f = |x: &[f64]| {
        let bodies = moved(&bodies, &scaled(&x[count..], &TOOL_SIZES));
        let (_, velocity) = on_grid(&model, &bodies, &state, &as_tiles(&x[..count]));
        inner_nodes(&weights, &velocity)
    };
    let (momentum, _) = on_grid(&model, &bodies, &state, &as_tiles(&tiles));
    let bar_tiles = shared_out(&state, &weights, &reached);
    let (bars, tool_bar) = grid_adjoint(&model, &bodies, &state, &bar_tiles, &momentum);
    let mut gradient = Vec::new();
    for block in &state.layout.blocks {
        let mut tile = empty_tile();
        load_tile(block, &bars, ALL_NEIGHBOURS, &mut tile);
        gradient.extend(scaled(tile.as_flattened(), &units));
    }
    gradient.extend(tool_gradient(&tool_bar));
    let x: Vec<f64> = tiles.iter().copied().chain([0.0; 12]).collect();
    assert_gradient(&format!("grid update, {powder:?}"), 1e-4, &f, &x, &gradient);
    let (masses, motion) = x.split_at(count);
    let tool_only = |d: &[f64]| f(&[masses, d].concat());
    assert_gradient(&format!("grid update, tool, {powder:?}"), 1e-4, &tool_only, motion, &gradient[count..]);
}

/// How many particles' volume corrections are lowered and raised by what the grid sees.
fn bounds_met(
    model: &Model<f64>,
    bodies: &Bodies<f64>,
    state: &State<f64>,
    velocity: &[Nodes<f64>],
) -> (usize, usize) {
    let after = to_particles(model, bodies, state, [velocity; 2]);
    let change = |(g, l, _): (usize, usize, u32)| after[g].q[0][l] - state.particles.groups[g].q[0][l];
    let changes: Vec<f64> = state.particles.occupied().map(change).collect();
    let count = |of: &dyn Fn(f64) -> bool| changes.iter().filter(|change| of(**change)).count();
    (count(&|change| change < 0.0), count(&|change| change > 0.0))
}

/// From the cotangent of the logarithmic volume, which `bar.c[0]` is, to those of strain and correction.
fn through_volume(input: &Group<f64>, bar: &mut Group<f64>) {
    use nalgebra::Matrix3;
    for l in 0..LANES {
        let [xx, yy, zz, xy, xz, yz] = input.strain_of(l);
        let b = Matrix3::identity() + Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let inverse = b.try_inverse().unwrap() * (0.5 * bar.c[0][l]);
        let entries = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
        for (k, entry) in entries.into_iter().enumerate() {
            bar.strain[k][l] = inverse[entry];
        }
        bar.q[0][l] += bar.c[0][l];
    }
}

/// How many tiles reach each node.
fn tiles_at_nodes(state: &State<f64>) -> Vec<[f64; BLOCK_NODES]> {
    let mut ones = vec![empty_tile(); state.layout.blocks.len()];
    ones.as_flattened_mut().iter_mut().for_each(|n| *n = [1.0; 4]);
    state.layout.nodes.iter().map(|n| summed(&state.tiles(&ones), n).map(|n| n[0])).collect()
}

/// Tiles that add up to the given values at the nodes: each takes its share.
fn shared_out(state: &State<f64>, values: &[Nodes<f64>], reached: &[[f64; BLOCK_NODES]]) -> Vec<Tile<f64>> {
    let share = |(v, r): (&Nodes<f64>, &[f64; BLOCK_NODES])| -> Nodes<f64> {
        std::array::from_fn(|n| v[n].map(|v| v / r[n].max(1.0)))
    };
    let shares: Vec<_> = values.iter().zip(reached).map(share).collect();
    let mut tiles = vec![empty_tile(); state.layout.blocks.len()];
    for (block, tile) in state.layout.blocks.iter().zip(&mut tiles) {
        load_tile(block, &shares, ALL_NEIGHBOURS, tile);
    }
    tiles
}

fn grid_adjoint(
    model: &Model<f64>,
    bodies: &Bodies<f64>,
    state: &State<f64>,
    velocity_bar_tiles: &[Tile<f64>],
    momentum: &[Nodes<f64>],
) -> (Vec<Nodes<f64>>, BodyStateBar) {
    let mut bars = vec![[[0.0; 4]; BLOCK_NODES]; momentum.len()];
    let mut total = BodyStateBar::default();
    for ((node, momentum), momentum_bar) in state.layout.nodes.iter().zip(momentum).zip(&mut bars) {
        total.add(&model.arch.dispatch(UpdateNodesAdjoint {
            model,
            bodies,
            node,
            velocity_bar_tiles: state.tiles(velocity_bar_tiles),
            holds_volume: state.holds_volume(model),
            momentum,
            momentum_bar,
            unforced: None,
        }));
    }
    (bars, total)
}

#[test]
fn grid_to_particle_has_taylor_slope_two_in_positions_velocities_and_the_tools_motion() {
    POWDERS.into_iter().for_each(grid_to_particle_gradient);
}

fn grid_to_particle_gradient(powder: Law) {
    let (model, mut state, bodies) = scooping_of(powder);
    let mut dice = Dice::new(55);
    let mut velocity = random_nodes(state.layout.nodes.len(), [SPEED, SPEED, SPEED, 0.0], &mut dice);
    let mut measure = Measure::random(state.particles.occupied().count(), 0..15, &mut dice);
    if model.holds_volume {
        // Block by block loose and dense, so that there are places with little slope; and volumes as they are after the return.
        for (n, nodes) in velocity.iter_mut().enumerate() {
            nodes.iter_mut().for_each(|node| node[3] = [0.65, 1.2][n % 2] + 0.01 * dice.roll());
        }
        measure.0.iter_mut().for_each(|weights| weights[21] = dice.roll() / SIZES[21]);
        // They shear, and do not grow.
        for group in &mut state.particles.groups {
            group.c = [Lanes::ZERO; 9];
            (0..LANES).for_each(|l| group.c[1][l] = 100.0 + 60.0 * dice.roll());
        }
        let (above, below) = bounds_met(&model, &bodies, &state, &velocity);
        assert!(above > 50 && below > 50, "{above} too loose, {below} too dense");
    }
    let state = state;
    let particles = 22 * state.particles.occupied().count();
    let unforced = random_nodes(velocity.len(), [SPEED, SPEED, SPEED, 0.0], &mut dice);
    let nodes = [&velocity[..], &unforced].concat();
    let nodes = nodes.as_flattened().as_flattened();
    let f = |x: &[f64]| {
        let state = with_numbers(&state, &x[..particles]);
        let (at_nodes, tool_numbers) = x[particles..].split_at(nodes.len());
        let unit = |c: usize| if c < 3 { SPEED } else { 1.0 };
        let of = |n: &[f64]| std::array::from_fn(|k| std::array::from_fn(|c| unit(c) * n[4 * k + c]));
        let at_nodes: Vec<Nodes<f64>> = at_nodes.chunks(4 * BLOCK_NODES).map(of).collect();
        let (velocity, unforced) = at_nodes.split_at(velocity.len());
        let bodies = moved(&bodies, &scaled(tool_numbers, &TOOL_SIZES));
        measure.of(&state.particles, &to_particles(&model, &bodies, &state, [velocity, unforced]))
    };
    let mut bar = measure.cotangent(&state.particles);
    let mut tiles = vec![empty_tile(); state.layout.blocks.len()];
    let mut unforced_tiles = tiles.clone();
    let mut tool_bar = BodyStateBar::default();
    let both = tiles.iter_mut().zip(&mut unforced_tiles);
    for (block, (tile_bar, unforced_bar)) in state.layout.blocks.iter().zip(both) {
        let range = block.first_group..block.first_group + block.groups();
        let input = &state.particles.groups[range.clone()];
        let (of_tool, _) = model.arch.dispatch(TileToParticlesAdjoint {
            model: &model,
            bodies: &bodies,
            block,
            velocity: &velocity,
            unforced: model.residue.map(|_| &unforced[..]),
            holds_volume: model.holds_volume,
            input,
            bar: &mut bar[range],
            tile_bar,
            unforced_bar: model.residue.map(|_| unforced_bar),
        });
        tool_bar.add(&of_tool);
    }
    // Only the cotangents of positions, of volume where it is held, of shear where that loosens, and of velocities where they get something
    // back are results of this stage.
    for (g, input) in bar.iter_mut().zip(&state.particles.groups) {
        let v = if model.residue.is_some() { g.v } else { [Lanes::ZERO; 3] };
        let mut c = [Lanes::ZERO; 9];
        for l in (0..LANES).filter(|_| model.loosening.is_some()) {
            let (twice, _) = twice_shear(&mat_of(&input.c, l));
            set_mat(&mut c, l, three!(i => three!(j => g.c[1][l] * twice[i][j])));
        }
        *g = Group { x: g.x, v, c: g.c, q: g.q, ..Group::ZERO };
        if model.holds_volume {
            through_volume(input, g);
        }
        *g = Group { x: g.x, v, c, strain: g.strain, q: g.q };
    }
    let mut gradient = simulate_with_gradient(&state.particles, &bar);
    for tiles in [&tiles, &unforced_tiles] {
        for node in &state.layout.nodes {
            // The fourth number at a node is no velocity.
            let sums = summed(&state.tiles(tiles), node);
            gradient.extend(sums.iter().flat_map(|b| [b[0] * SPEED, b[1] * SPEED, b[2] * SPEED, b[3]]));
        }
    }
    gradient.extend(tool_gradient(&tool_bar));
    let mut x = numbers(&state.particles);
    x.extend(nodes.iter().enumerate().map(|(n, v)| if n % 4 < 3 { v / SPEED } else { *v }));
    x.extend([0.0; 12]);
    assert_gradient(&format!("grid to particle, {powder:?}"), 1e-4, &f, &x, &gradient);
}

#[test]
fn a_nodes_unforced_velocity_has_taylor_slope_two() {
    let mut dice = Dice::new(59);
    let (x, weight): ([f64; 4], [f64; 4]) = ([0.3, -0.2, 0.5, 1.3], dice.many(1.0));
    let f = |x: &[f64]| {
        let v = unforced_velocity([x[0], x[1], x[2], 0.0], x[3]);
        (0..3).map(|c| v[c] * weight[c]).sum()
    };
    let gradient = unforced_velocity_adjoint(unforced_velocity(x, x[3]), x[3], weight);
    assert_gradient("unforced velocity of a node", 1e-3, &f, &x, &gradient);
    // Nobody is there.
    assert_eq!(unforced_velocity([0.0; 4], 0.0).map(f64::to_bits), [0; 4]);
    assert_eq!(unforced_velocity_adjoint([0.0; 4], 0.0, weight)[..3], [0.0; 3]);
}

#[test]
fn a_whole_substep_has_taylor_slope_two_in_the_state_and_the_tools_motion() {
    POWDERS.into_iter().for_each(whole_substep_gradient);
}

fn whole_substep_gradient(powder: Law) {
    let (model, state, bodies) = scooping_of(powder);
    let mut dice = Dice::new(56);
    let count = state.particles.occupied().count();
    let measure = Measure::random(count, 0..22, &mut dice);
    let f = |x: &[f64]| {
        let mut state = with_numbers(&state, &x[..22 * count]);
        let bodies = moved(&bodies, &scaled(&x[22 * count..], &TOOL_SIZES));
        Workspace::new().substep(&model, &bodies, &mut state).unwrap();
        measure.of(&state.particles, &state.particles.groups)
    };
    let mut after = state.clone();
    let mut workspace = Workspace::new();
    workspace.substep(&model, &bodies, &mut after).unwrap();
    if model.holds_volume {
        let by = |other: Model<f64>| {
            let mut unlike = state.clone();
            Workspace::new().substep(&other, &bodies, &mut unlike).unwrap();
            unlike.particles
        };
        let free = by(Model { holds_volume: false, ..model.clone() });
        let at_once = by(Model { loosening: None, ..model.clone() });
        let change = |particles: &Particles<f64>, (g, l, _): (usize, usize, u32)| {
            particles.groups[g].q[0][l] - free.groups[g].q[0][l]
        };
        let both = |at| (change(&after.particles, at), change(&at_once, at));
        let changes: Vec<(f64, f64)> = after.particles.occupied().map(both).collect();
        let count = |of: &dyn Fn(f64, f64) -> bool| changes.iter().filter(|both| of(both.0, both.1)).count();
        let (above, below) = (count(&|change, _| change < 0.0), count(&|change, _| change > 0.0));
        assert!(above > 20 && below > 20, "{above} too loose, {below} too dense");
        let in_part = count(&|change, at_once| at_once > 0.0 && (0.1..0.9).contains(&(change / at_once)));
        assert!(model.loosening.is_none() || in_part > 20, "{in_part} loosened in part");
    }
    let mut bar = measure.cotangent(&after.particles);
    workspace.sort_adjoint(&after, &mut bar);
    let tool_bar = workspace.substep_adjoint(&model, &bodies, &state, None, &mut bar);
    let mut gradient = simulate_with_gradient(&state.particles, &bar);
    gradient.extend(tool_gradient(&tool_bar));
    let mut x = numbers(&state.particles);
    x.extend([0.0; 12]);
    assert_gradient(&format!("whole substep, {powder:?}"), 1e-4, &f, &x, &gradient);

    // The tool alone: among thousands of particles its share would hide.
    let (particles, motion) = x.split_at(22 * count);
    let tool_only = |d: &[f64]| f(&[particles, d].concat());
    assert_gradient(
        &format!("whole substep, tool, {powder:?}"),
        1e-4,
        &tool_only,
        motion,
        &gradient[22 * count..],
    );
}

/// A cohesive, hence elastic, cloud that flies and spins through the blocks. Nothing holds its volume: a state made anew
/// would do so in other substeps.
fn flying_cloud() -> (Model<f64>, State<f64>) {
    let mut dice = Dice::new(81);
    let mut scene = empty_bench([0.080; 3]);
    scene.powder.volume_correction = VolumeCorrection::Strain;
    let mut model = Model::<f64>::new(&scene);
    model.material = Material::new(1e4, 0.2, 0.6, 4e3 / libm::tan(0.6), YieldSurface::DruckerPrager);
    let points = lattice([0.014, 0.016, 0.018], [0.026, 0.028, 0.030], 0.003, &mut dice);
    let mut state = State::new(&model, &far_away(), &Particles::at_rest(&points)).unwrap();
    let middle = [0.020, 0.022, 0.024];
    let places: Vec<_> = state.particles.occupied().collect();
    for (g, l, _) in places {
        let group = &mut state.particles.groups[g];
        let arm = sub([group.x[0][l], group.x[1][l], group.x[2][l]], middle);
        let spin = mul_vec(&[[0.0, -12.0, 3.0], [12.0, 0.0, -5.0], [-3.0, 5.0, 0.0]], arm);
        for k in 0..21 {
            let number = match k {
                3..6 => [1.1, 0.9, 0.7][k - 3] + spin[k - 3] + 0.02 * dice.roll(),
                6..15 => dice.roll(),
                15..21 => 0.01 * dice.roll(),
                _ => continue,
            };
            row(group, k)[l] = number;
        }
    }
    (model, state)
}

#[test]
fn cotangents_survive_sorting() {
    const SUBSTEPS: usize = 60;
    let (model, first) = flying_cloud();
    let bodies = far_away();
    let count = first.particles.occupied().count();
    let mut dice = Dice::new(57);
    let measure = Measure::random(count, 0..22, &mut dice);
    let mut workspace = Workspace::new();

    let end = |x: &[f64]| {
        let mut state = with_numbers(&first, x);
        let mut workspace = Workspace::new();
        for _ in 0..SUBSTEPS {
            workspace.substep(&model, &bodies, &mut state).unwrap();
        }
        measure.of(&state.particles, &state.particles.groups)
    };
    // Forward, first with a sort of our own before every second substep, then with those that happen by themselves.
    let mut states = Vec::new();
    let mut state = first.clone();
    let (mut own, mut needed) = (0, 0);
    for substep in 0..SUBSTEPS {
        let groups = state.particles.groups.len();
        let order = if substep < 20 && substep % 2 == 1 {
            let (_, _, order) = sort(&model, &bodies, &state.particles, &mut BufferPool::empty()).unwrap();
            own += usize::from(order.iter().enumerate().any(|(to, from)| to as u32 != *from));
            state = State::new(&model, &bodies, &state.particles).unwrap();
            order
        } else {
            (0..groups * crate::mpm::particles::LANES).map(|i| i as u32).collect()
        };
        states.push((state.clone(), order, groups));
        workspace.substep(&model, &bodies, &mut state).unwrap();
        needed += usize::from(state.sorted_from.is_some());
    }
    let mut after = state;
    let mut bar = measure.cotangent(&after.particles);
    for (state, order, groups) in states.into_iter().rev() {
        workspace.sort_adjoint(&after, &mut bar);
        workspace.substep_adjoint(&model, &bodies, &state, None, &mut bar);
        if state.sorted_from.is_none() {
            let sorted = bar.clone();
            sort_adjoint(&sorted, &order, groups, &mut bar);
        }
        after = state;
    }
    let gradient = simulate_with_gradient(&first.particles, &bar);
    let x = numbers(&first.particles);
    let mut worst: f64 = 0.0;
    for direction in super::directions(x.len(), 5) {
        let at = |h: f64| end(&x.iter().zip(&direction).map(|(x, d)| x + h * d).collect::<Vec<_>>());
        let slope = gradient.iter().zip(&direction).map(|(g, d)| g * d).sum::<f64>();
        let difference = (at(1e-5) - at(-1e-5)) / 2e-5;
        worst = worst.max((difference - slope).abs() / slope.abs().max(1.0));
    }
    println!(
        "sorting: {own} sorts of our own that moved particles, {needed} needed, worst relative error {worst:.1e}"
    );
    assert!(own > 5 && needed > 0);
    assert!(worst < 1e-7, "{worst}");
}
