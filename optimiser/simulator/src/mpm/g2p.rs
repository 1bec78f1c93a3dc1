//! Grid to particle: velocity and affine velocity, contact at the particle, advection.
//!
//! `v = sum w v_i`, `C = (4/dx^2) sum w v_i (x_i - x)^T` (APIC for quadratic splines), then contact, then
//! `x' = x + dt v'`; and, if the scene asks for it, the volume is held to the grid's density ([`super::density`]), and the velocity
//! gets back what the grid cannot hold ([`super::residue`]).

use crate::mpm::Model;
use crate::mpm::bodies::Bodies;
use crate::mpm::contact::BodyStateBar;
use crate::mpm::density::{hold_volume, hold_volume_adjoint};
use crate::mpm::gather::{Rows, Sent, gather_all, gather_gradient, gather_gradient_of_four, gather_sum};
use crate::mpm::grid_update::{Meeting, contact_lanes, contact_lanes_adjoint, find_near, meet};
use crate::mpm::layout::{Block, Grid, Nodes, empty_tile, load_tile};
use crate::mpm::p2g::at_base;
use crate::mpm::particles::{Group, LANES, Lanes, mat_of, set_mat, set_vec, vec_of};
use crate::mpm::residue::Residue;
use crate::mpm::sleep::{BlockStatus, Speeds};
use crate::mpm::stencil::{TILE_EDGE, Tile, scatter};
use crate::mpm::stencil_positions::{ALL_NEIGHBOURS, Reach, StencilPositions};
use crate::real::Real;
use crate::small::{dot, three, tr_mul_vec};

/// What is given back of the velocities' residue, and the tile of the velocities without forces.
#[inline(always)]
fn load_unforced<T: Real>(
    model: &Model<T>,
    block: &Block,
    unforced: Option<&[Nodes<T>]>,
    reached: u32,
) -> Option<(Residue<T>, Tile<T>)> {
    model.residue.zip(unforced).map(|(residue, nodes)| {
        let mut tile = empty_tile();
        load_tile(block, nodes, reached, &mut tile);
        (residue, tile)
    })
}

/// Moves one block's particles.
pub(crate) struct TileToParticles<'a, T> {
    pub(crate) model: &'a Model<T>,
    pub(crate) bodies: &'a Bodies<T>,
    pub(crate) block: &'a Block,
    /// To which neighbours its particles have sent.
    pub(crate) reached: u32,
    pub(crate) velocity: &'a [Nodes<T>],
    /// Velocity without forces, where the residue is given back.
    pub(crate) unforced: Option<&'a [Nodes<T>]>,
    /// Whether volumes are held in this substep.
    pub(crate) holds_volume: bool,
    pub(crate) state: &'a mut [Group<T>],
}

impl<T: Real> pulp::NullaryFnOnce for TileToParticles<'_, T> {
    type Output = BlockStatus;

    #[inline(always)]
    fn call(self) -> BlockStatus {
        let model = self.model;
        let shift = Grid::tile_shift(self.block.coord).map(T::from_f64);
        let mut tile = empty_tile();
        load_tile(self.block, self.velocity, self.reached, &mut tile);
        let unforced = load_unforced(model, self.block, self.unforced, self.reached);
        let touching = model.obstacles.at_particles(&model.grid, self.block.coord, self.bodies);
        let (mut inside, mut speeds) = (true, Speeds::new(model));
        for (g, state) in self.state.iter_mut().enumerate() {
            let x = state.x;
            let places = StencilPositions::of(model.inverse_dx, shift, &x);
            let occupied = self.block.occupied(g);
            let weights = places.weights();
            let other = unforced.as_ref().map(|(_, tile)| tile);
            let taken = gather_all(&tile, other, self.holds_volume, &places, &weights, occupied);
            let residue =
                unforced.as_ref().map(|(residue, _)| residue.of_group(&taken.unforced, &state.v, occupied));
            if self.holds_volume {
                hold_volume(&tile, &taken.density, &places, &weights, occupied, &model.loosening, state);
            }
            let gathered = &taken.velocity;
            let mut rates = Lanes::ZERO;
            for l in 0..LANES {
                let (f, v, first) = (places.f(l), vec_of(&gathered.sum, l), mat_of(&gathered.first, l));
                let c = three!(i => three!(j => model.four_per_dx * (first[i][j] - v[i] * f[j])));
                set_mat(&mut state.c, l, c);
                rates[l] = dot(c[0], c[0]) + dot(c[1], c[1]) + dot(c[2], c[2]);
            }
            let mut v = gathered.sum;
            for t in &touching {
                contact_lanes(t, &t.piece.particle_law, &x, &mut v);
            }
            speeds.add([&gathered.sum, &v], &rates, occupied);
            let reach = T::from_f64((TILE_EDGE - 2) as f64);
            let mut outside = Lanes::ZERO;
            for axis in 0..3 {
                let mut next = x[axis];
                for l in 0..LANES {
                    next[l] = x[axis][l] + model.dt * v[axis][l];
                    let base = next[l] * model.inverse_dx + shift[axis] - T::from_f64(0.5);
                    // A number that is not finite counts as outside, too.
                    outside[l] = if base >= T::ZERO && base < reach { outside[l] } else { T::ONE };
                }
                state.x[axis] = next;
            }
            if let Some(residue) = residue {
                for axis in 0..3 {
                    for l in 0..LANES {
                        v[axis][l] += residue[axis][l];
                    }
                }
            }
            state.v = v;
            inside = inside && outside[..occupied].iter().all(|lane| *lane == T::ZERO);
        }
        BlockStatus { inside, quiet: speeds.are_quiet(self.block.particles) }
    }
}

/// Adjoint of [`TileToParticles`] for one block: scatters the cotangent of the nodes' velocities into a tile.
/// On return `bar.x` is the cotangent of the input positions as far as this stage goes; `bar.v` and `bar.c`
/// are used up, but for `bar.v` where the residue is given back: that is the cotangent of the input velocities as far as this stage
/// goes. Where volume is held to the grid's density, `bar.c[0]` is the cotangent of the logarithmic volume,
/// `bar.c[1]` is `k`, that of the velocity gradient being `k 2 dev D`.
pub(crate) struct TileToParticlesAdjoint<'a, T> {
    pub(crate) model: &'a Model<T>,
    pub(crate) bodies: &'a Bodies<T>,
    pub(crate) block: &'a Block,
    pub(crate) velocity: &'a [Nodes<T>],
    /// Velocity without forces, where the residue is given back.
    pub(crate) unforced: Option<&'a [Nodes<T>]>,
    /// Whether volumes were held in this substep.
    pub(crate) holds_volume: bool,
    pub(crate) input: &'a [Group<T>],
    pub(crate) bar: &'a mut [Group<T>],
    pub(crate) tile_bar: &'a mut Tile<T>,
    /// For the cotangent of the velocity without forces, where the residue is given back.
    pub(crate) unforced_bar: Option<&'a mut Tile<T>>,
}

impl<T: Real> pulp::NullaryFnOnce for TileToParticlesAdjoint<'_, T> {
    /// Of the tool; and which neighbours they send to.
    type Output = (BodyStateBar, u32);

    #[inline(always)]
    fn call(mut self) -> (BodyStateBar, u32) {
        let mut reach = Reach::NOTHING;
        let model = self.model;
        let shift = Grid::tile_shift(self.block.coord).map(T::from_f64);
        let mut tile = empty_tile();
        load_tile(self.block, self.velocity, ALL_NEIGHBOURS, &mut tile);
        *self.tile_bar = empty_tile();
        let unforced = load_unforced(model, self.block, self.unforced, ALL_NEIGHBOURS);
        if let Some(tile_bar) = &mut self.unforced_bar {
            **tile_bar = empty_tile();
        }
        let touching = model.obstacles.at_particles(&model.grid, self.block.coord, self.bodies);
        let mut tool_bar = BodyStateBar::default();
        let mut met = Vec::with_capacity(touching.len());
        // If the compiler knew that this is 0, it would drop a quarter of each row and no longer vectorise.
        let no_mass = std::hint::black_box(T::ZERO);
        let mut rows = Rows::new();
        for g in 0..self.input.len() {
            let (input, bar) = (&self.input[g], &mut self.bar[g]);
            let places = StencilPositions::of(model.inverse_dx, shift, &input.x);
            reach.add(&places.start);
            let (occupied, weights) = (self.block.occupied(g), places.weights());
            let v_bar = bar.v;
            // x' = x + dt u
            for axis in 0..3 {
                for l in 0..LANES {
                    bar.v[axis][l] += model.dt * bar.x[axis][l];
                }
            }
            let meetings = touching.iter().copied().map(Meeting::of_all);
            find_near(meetings, |piece| &piece.particle_law, &input.x, &mut met);
            if !met.is_empty() {
                meet(&mut met, &input.x, gather_sum(&tile, &places, &weights, occupied));
            }
            for m in met.iter().rev() {
                contact_lanes_adjoint(m, &input.x, &mut bar.v, Some(&mut bar.x), &mut tool_bar);
            }
            let mut sent = Sent::ZERO;
            for l in 0..LANES {
                let scaled = three!(i => three!(j => model.four_per_dx * bar.c[3 * i + j][l]));
                set_mat(&mut sent.a_dx, l, scaled);
                set_vec(&mut sent.base, l, at_base(vec_of(&bar.v, l), &scaled, places.f(l)));
            }
            let stencils = places.stencils(&weights);
            let (q_bar, law) = (bar.q[0], (model.dt, &model.loosening));
            // Not by a closure: one that is not inlined is compiled for the baseline instruction set.
            let held = if self.holds_volume {
                Some(hold_volume_adjoint(&tile, &places, &weights, occupied, law, input, &q_bar))
            } else {
                None
            };
            let through_f = if let Some(Some(held)) = &held {
                let fourth = &held.fourth;
                scatter(self.tile_bar, occupied, |l| stencils.of(l), |l| sent.affine_of_four(l, fourth));
                held.through_f
            } else {
                scatter(self.tile_bar, occupied, |l| stencils.of(l), |l| sent.affine(l, no_mass));
                [Lanes::ZERO; 3]
            };
            let gathered = match &held {
                Some(Some(held)) => gather_gradient_of_four(
                    &tile,
                    &places,
                    &weights,
                    &sent,
                    &held.fourth,
                    occupied,
                    &mut rows,
                ),
                _ => gather_gradient(&tile, &places, &weights, &sent, occupied, &mut rows),
            };
            for l in 0..LANES {
                let through_v = tr_mul_vec(&mat_of(&sent.a_dx, l), vec_of(&gathered.sum, l));
                let gradient = vec_of(&gathered.gradient, l);
                for axis in 0..3 {
                    let through = through_v[axis] + through_f[axis][l];
                    bar.x[axis][l] += model.inverse_dx * (gradient[axis] - through);
                }
            }
            if let Some(held) = held {
                (bar.c[0], bar.c[1]) =
                    held.map_or((Lanes::ZERO, Lanes::ZERO), |held| (held.volume, held.shear));
            }
            if let (Some((residue, tile)), Some(tile_bar)) = (&unforced, &mut self.unforced_bar) {
                let back = residue.adjoint(tile, &places, &weights, occupied, &v_bar, &mut rows);
                scatter(tile_bar, occupied, |l| stencils.of(l), |l| back.sent.affine(l, no_mass));
                for l in 0..LANES {
                    for axis in 0..3 {
                        bar.x[axis][l] += model.inverse_dx * back.x[axis][l];
                    }
                }
                bar.v = back.v;
            }
        }
        (tool_bar, reach.neighbours())
    }
}
