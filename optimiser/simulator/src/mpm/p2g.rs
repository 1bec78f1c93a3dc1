//! Particle to grid: trial strain, return map, and the scatter of mass and momentum.
//!
//! `m_i += w m`, `p_i += w [m v + A (x_i - x)]`, `A = m C - dt V0 (4/dx^2) tau` (MLS-MPM, Hu et al. 2018,
//! equations 16 and 28, for quadratic splines). In `A`, `C` stands without the part of the strain rate that
//! viscosity takes.

use crate::mpm::Model;
use crate::mpm::gather::{Fourth, Rows, Sent, gather_with_gradient};
use crate::mpm::layout::{Block, Grid, Nodes, empty_tile, load_tile};
use crate::mpm::material::{self, ReturnBar, is_mild, trial_strain, trial_strain_adjoint};
use crate::mpm::particles::{Group, LANES, Lanes, mat_of, set_mat, set_vec, vec_of};
use crate::mpm::principal;
use crate::mpm::residue::{unforced, unforced_adjoint};
use crate::mpm::stencil::{Affine, Tile, scatter, scatter_all};
use crate::mpm::stencil_positions::{Reach, StencilPositions};
use crate::real::Real;
use crate::small::{Mat3, Sym3, Vec3, full, mul_vec, scale, sub, three, tr_mul_vec};

/// Value at node (0, 0, 0) of `v + A_dx ((i, j, k) - f)`.
#[inline(always)]
pub(crate) fn at_base<T: Real>(v: Vec3<T>, a_dx: &Mat3<T>, f: Vec3<T>) -> Vec3<T> {
    sub(v, mul_vec(a_dx, f))
}

/// `P_ijk = [p + A_dx (i, j, k), mass]` as an affine function of the node index.
#[inline(always)]
pub(crate) fn affine<T: Real>(p: Vec3<T>, a_dx: &Mat3<T>, mass: T) -> Affine<T> {
    let step = |c: usize| [a_dx[0][c], a_dx[1][c], a_dx[2][c], T::ZERO];
    Affine { p: [p[0], p[1], p[2], mass], steps: [step(0), step(1), step(2)] }
}

impl<T: Real> Sent<T> {
    pub(crate) const ZERO: Self = Self { base: [Lanes::ZERO; 3], a_dx: [Lanes::ZERO; 9] };

    /// What one particle sends, and a fourth number.
    #[inline(always)]
    pub(crate) fn affine(&self, l: usize, mass: T) -> Affine<T> {
        affine(vec_of(&self.base, l), &mat_of(&self.a_dx, l), mass)
    }

    /// The same, the fourth number being affine too.
    #[inline(always)]
    pub(crate) fn affine_of_four(&self, l: usize, fourth: &Fourth<T>) -> Affine<T> {
        let mut out = self.affine(l, fourth.base[l]);
        for axis in 0..3 {
            out.steps[axis][3] = fourth.steps[axis][l];
        }
        out
    }
}

/// Scatters one block's particles into its tile and writes their new strain and volume correction; and their positions, if
/// they come from elsewhere (and their velocities and velocity gradients, if those are still asked for).
pub(crate) struct ParticlesToTile<'a, T> {
    pub(crate) model: &'a Model<T>,
    pub(crate) block: &'a Block,
    /// Where the particles are, if not in `state`.
    pub(crate) from: Option<&'a [Group<T>]>,
    pub(crate) state: &'a mut [Group<T>],
    pub(crate) tile: &'a mut Tile<T>,
    /// For momentum without forces, where the velocity residue is given back.
    pub(crate) unforced: Option<&'a mut Tile<T>>,
}

impl<T: Real> pulp::NullaryFnOnce for ParticlesToTile<'_, T> {
    /// Which neighbours they send to.
    type Output = u32;

    #[inline(always)]
    fn call(mut self) -> u32 {
        let mut reach = Reach::NOTHING;
        let shift = Grid::tile_shift(self.block.coord).map(T::from_f64);
        *self.tile = empty_tile();
        if let Some(tile) = &mut self.unforced {
            **tile = empty_tile();
        }
        // If the compiler knew that this is 0, it would drop a quarter of each row and no longer vectorise.
        let no_mass = std::hint::black_box(T::ZERO);
        for g in 0..self.state.len() {
            let input = self.from.map_or(&self.state[g], |from| &from[g]);
            let places = StencilPositions::of(self.model.inverse_dx, shift, &input.x);
            reach.add(&places.start);
            let mut returned = Returned::ZERO;
            stress(self.model, input, &TrialStrains::new(self.model, input), &places, &mut returned);
            let unforced = self.unforced.as_mut().map(|tile| (tile, unforced(self.model, input, &places)));
            let (x, v, c, sent, state) = (input.x, input.v, input.c, &returned.sent, &mut self.state[g]);
            state.strain = returned.strain;
            state.q = returned.q;
            if self.from.is_some() {
                state.x = x;
                if self.model.loosening.is_some() {
                    state.c = c;
                }
            }
            let stencils = places.stencils(&places.weights());
            let occupied = self.block.occupied(g);
            let affine = |l: usize| sent.affine(l, self.model.mass);
            if let Some((tile, unforced)) = unforced {
                if self.from.is_some() {
                    state.v = v;
                }
                let both = |l: usize| [affine(l), unforced.affine(l, no_mass)];
                scatter_all([&mut *self.tile, tile], occupied, |l| stencils.of(l), both);
            } else {
                scatter(self.tile, occupied, |l| stencils.of(l), affine);
            }
        }
        reach.neighbours()
    }
}

/// What the return map makes of a group.
struct Returned<T> {
    strain: [Lanes<T>; 6],
    q: [Lanes<T>; 1],
    /// The momentum it sends.
    sent: Sent<T>,
}

impl<T: Real> Returned<T> {
    const ZERO: Self = Self { strain: [Lanes::ZERO; 6], q: [Lanes::ZERO; 1], sent: Sent::ZERO };
}

/// Return map of a group, and the momentum it sends.
#[inline(always)]
fn stress<T: Real>(
    model: &Model<T>,
    input: &Group<T>,
    trial: &TrialStrains<T>,
    places: &StencilPositions<T>,
    out: &mut Returned<T>,
) {
    if trial.all_mild {
        send::<T, true>(model, input, trial, places, out);
    } else {
        send_sheared(model, input, trial, places, out);
    }
}

/// Trial strains of a group.
struct TrialStrains<T> {
    strain: [Lanes<T>; 6],
    /// Whether the quick return map is good for all of them.
    all_mild: bool,
}

impl<T: Real> TrialStrains<T> {
    #[inline(always)]
    fn new(model: &Model<T>, input: &Group<T>) -> Self {
        let mut strain = [Lanes::ZERO; 6];
        let mut mild = Lanes::ZERO;
        for l in 0..LANES {
            let trial = trial_strain(input.strain_of(l), &dt_times(model.dt, &mat_of(&input.c, l)));
            for i in 0..6 {
                strain[i][l] = trial[i];
            }
            mild[l] = T::ONE.only_if(is_mild(trial));
        }
        Self { strain, all_mild: mild.iter().all(|mild| *mild == T::ONE) }
    }

    #[inline(always)]
    fn of(&self, l: usize) -> Sym3<T> {
        let s = &self.strain;
        [s[0][l], s[1][l], s[2][l], s[3][l], s[4][l], s[5][l]]
    }
}

/// [`send`] for large shear, which is rare: not inlined, so compiled once, for the baseline instruction set.
#[inline(never)]
fn send_sheared<T: Real>(
    model: &Model<T>,
    input: &Group<T>,
    trial: &TrialStrains<T>,
    places: &StencilPositions<T>,
    out: &mut Returned<T>,
) {
    send::<T, false>(model, input, trial, places, out);
}

#[inline(always)]
fn send<T: Real, const MILD: bool>(
    model: &Model<T>,
    input: &Group<T>,
    trial: &TrialStrains<T>,
    places: &StencilPositions<T>,
    out: &mut Returned<T>,
) {
    for l in 0..LANES {
        let c = mat_of(&input.c, l);
        let (trial, (shear, _)) = (trial.of(l), model.material.shear(&c));
        let beside = [input.q[0][l], shear];
        let (tau, strain, q) = if MILD {
            material::return_map(&model.material, trial, beside)
        } else {
            principal::return_map(&model.material, trial, beside)
        };
        for i in 0..6 {
            out.strain[i][l] = strain[i];
        }
        out.q[0][l] = q;
        let tau = full(tau);
        let c = without_viscosity(&c, model.viscous_loss);
        let mut a_dx = [[T::ZERO; 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                a_dx[i][j] = model.mass_dx * c[i][j] - model.stress_dx * tau[i][j];
            }
        }
        set_mat(&mut out.sent.a_dx, l, a_dx);
        let momentum = scale(model.mass, vec_of(&input.v, l));
        set_vec(&mut out.sent.base, l, at_base(momentum, &a_dx, places.f(l)));
    }
}

/// `C` less what viscosity takes of its symmetric part, the strain rate `D`; spin is left alone, so that angular
/// momentum is kept. Taking the fraction `z` of `m D` is the stress `2 eta D` with `eta = z rho dx^2/(8 dt)`.
/// The map is symmetric: it is its own adjoint.
#[inline(always)]
fn without_viscosity<T: Real>(c: &Mat3<T>, loss: T) -> Mat3<T> {
    let half_loss = T::from_f64(0.5) * loss;
    three!(i => three!(j => c[i][j] - half_loss * (c[i][j] + c[j][i])))
}

#[inline(always)]
fn dt_times<T: Real>(dt: T, c: &Mat3<T>) -> Mat3<T> {
    three!(i => three!(j => dt * c[i][j]))
}

/// Adjoint of [`ParticlesToTile`] for one block. On entry `bar` holds the cotangent of the new strain and
/// volume correction, what is already known of the positions' (and, where the velocity residue is given back, of the velocities'), and, where volume is held to the grid's density, in `bar.c[0]` the
/// cotangent of the logarithmic volume and in `bar.c[1]` `k`, that of the velocity gradient being `k 2 dev D`; on return, the cotangent of the input.
pub(crate) struct ParticlesToTileAdjoint<'a, T> {
    pub(crate) model: &'a Model<T>,
    pub(crate) block: &'a Block,
    pub(crate) input: &'a [Group<T>],
    /// To which neighbours its particles have sent.
    pub(crate) reached: u32,
    /// Cotangents of momentum and mass.
    pub(crate) nodes_bar: &'a [Nodes<T>],
    /// Of momentum without forces, where the velocity residue is given back.
    pub(crate) unforced_bar: Option<&'a [Nodes<T>]>,
    /// Whether volumes were held in this substep.
    pub(crate) holds_volume: bool,
    pub(crate) bar: &'a mut [Group<T>],
}

impl<T: Real> pulp::NullaryFnOnce for ParticlesToTileAdjoint<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let model = self.model;
        let shift = Grid::tile_shift(self.block.coord).map(T::from_f64);
        let mut tile = empty_tile();
        load_tile(self.block, self.nodes_bar, self.reached, &mut tile);
        let mass = Lanes([model.mass; LANES]);
        let unforced = self.unforced_bar.map(|nodes| {
            let mut tile = empty_tile();
            load_tile(self.block, nodes, self.reached, &mut tile);
            tile
        });
        let mut rows = Rows::new();
        for g in 0..self.input.len() {
            let (input, bar) = (&self.input[g], &mut self.bar[g]);
            let places = StencilPositions::of(model.inverse_dx, shift, &input.x);
            let (trial, weights) = (TrialStrains::new(model, input), places.weights());
            let mut returned = Returned::ZERO;
            stress(model, input, &trial, &places, &mut returned);
            let sent = &returned.sent;
            let occupied = self.block.occupied(g);
            let gathered = gather_with_gradient(&tile, &places, &weights, sent, &mass, occupied, &mut rows);
            if unforced.is_none() {
                // What is added to -0 stays what it is.
                bar.v = [Lanes([-T::ZERO; LANES]); 3];
            }
            let mut a_dx_bar = [Lanes::ZERO; 9];
            for l in 0..LANES {
                let (f, a_dx) = (places.f(l), mat_of(&sent.a_dx, l));
                let (sum, first) = (vec_of(&gathered.sum, l), mat_of(&gathered.first, l));
                let (gradient, through_f) = (vec_of(&gathered.gradient, l), tr_mul_vec(&a_dx, sum));
                for axis in 0..3 {
                    bar.x[axis][l] += model.inverse_dx * (gradient[axis] - through_f[axis]);
                    bar.v[axis][l] += model.mass * sum[axis];
                    for c in 0..3 {
                        a_dx_bar[3 * axis + c][l] = first[axis][c] - sum[axis] * f[c];
                    }
                }
            }
            if !self.holds_volume {
                (bar.c[0], bar.c[1]) = (Lanes::ZERO, Lanes::ZERO);
            }
            let through_unforced = unforced.as_ref().map(|tile| {
                unforced_adjoint(model, tile, &places, &weights, (input, occupied), &mut rows, bar)
            });
            stress_adjoint(model, input, &trial, &a_dx_bar, bar);
            if let Some(c_bar) = through_unforced {
                for k in 0..9 {
                    for l in 0..LANES {
                        bar.c[k][l] += c_bar[k][l];
                    }
                }
            }
        }
    }
}

/// Adjoint of [`stress`]: fills `bar.c`, `bar.strain` and `bar.q`.
#[inline(always)]
fn stress_adjoint<T: Real>(
    model: &Model<T>,
    input: &Group<T>,
    trial: &TrialStrains<T>,
    a_dx_bar: &[Lanes<T>; 9],
    bar: &mut Group<T>,
) {
    if trial.all_mild {
        send_adjoint::<T, true>(model, input, trial, a_dx_bar, bar);
    } else {
        send_sheared_adjoint(model, input, trial, a_dx_bar, bar);
    }
}

/// [`send_adjoint`] as in [`send_sheared`].
#[inline(never)]
fn send_sheared_adjoint<T: Real>(
    model: &Model<T>,
    input: &Group<T>,
    trial: &TrialStrains<T>,
    a_dx_bar: &[Lanes<T>; 9],
    bar: &mut Group<T>,
) {
    send_adjoint::<T, false>(model, input, trial, a_dx_bar, bar);
}

#[inline(always)]
fn send_adjoint<T: Real, const MILD: bool>(
    model: &Model<T>,
    input: &Group<T>,
    trial: &TrialStrains<T>,
    a_dx_bar: &[Lanes<T>; 9],
    bar: &mut Group<T>,
) {
    let half = T::from_f64(0.5);
    for l in 0..LANES {
        let c = mat_of(&input.c, l);
        let l_of = dt_times(model.dt, &c);
        let (shear, twice_rate) = model.material.shear(&c);
        let a_bar = mat_of(a_dx_bar, l);
        let to_tau = |i: usize, j: usize| -(model.stress_dx * half * (a_bar[i][j] + a_bar[j][i]));
        let tau_bar = [to_tau(0, 0), to_tau(1, 1), to_tau(2, 2), to_tau(0, 1), to_tau(0, 2), to_tau(1, 2)];
        let strain = input.strain_of(l);
        let (trial, beside) = (trial.of(l), [input.q[0][l], shear]);
        // Where [`super::g2p::TileToParticlesAdjoint`] leaves it.
        let (volume, by_shear) = (bar.c[0][l], bar.c[1][l]);
        let returned = ReturnBar { tau: tau_bar, strain: bar.strain_of(l), q: bar.q[0][l], volume };
        let (trial_bar, [q_bar, shear_bar]) = if MILD {
            material::return_map_adjoint(&model.material, trial, beside, &returned)
        } else {
            principal::return_map_adjoint(&model.material, trial, beside, &returned)
        };
        let through_shear = model.material.shear_adjoint(&twice_rate, shear_bar);
        let (strain_bar, l_bar) = trial_strain_adjoint(strain, &l_of, trial_bar);
        for i in 0..6 {
            bar.strain[i][l] = strain_bar[i];
        }
        bar.q[0][l] = q_bar;
        let a_bar = without_viscosity(&a_bar, model.viscous_loss);
        let mut c_bar = [[T::ZERO; 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                c_bar[i][j] = model.mass_dx * a_bar[i][j] + model.dt * l_bar[i][j];
                if model.material.has_two_angles() {
                    c_bar[i][j] += through_shear[i][j];
                }
                if model.loosening.is_some() {
                    c_bar[i][j] += by_shear * twice_rate[i][j];
                }
            }
        }
        set_mat(&mut bar.c, l, c_bar);
    }
}

/// The material of some groups without the transfers around it, to see what it takes by itself.
pub(crate) struct ReturnMap<'a, T> {
    pub(crate) model: &'a Model<T>,
    pub(crate) input: &'a [Group<T>],
    pub(crate) output: &'a mut [Group<T>],
}

impl<T: Real> pulp::NullaryFnOnce for ReturnMap<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let places = StencilPositions { start: [0; LANES], f: [Lanes([T::ONE; LANES]); 3] };
        for (input, output) in self.input.iter().zip(self.output) {
            let trial = TrialStrains::new(self.model, input);
            let mut returned = Returned::ZERO;
            stress(self.model, input, &trial, &places, &mut returned);
            output.strain = returned.strain;
            std::hint::black_box(&returned.sent);
        }
    }
}

/// Adjoint of [`ReturnMap`]. The cotangents are whatever numbers `bar` holds; those of the stress are taken from the
/// input's affine velocities.
pub(crate) struct ReturnMapAdjoint<'a, T> {
    pub(crate) model: &'a Model<T>,
    pub(crate) input: &'a [Group<T>],
    pub(crate) bar: &'a mut [Group<T>],
}

impl<T: Real> pulp::NullaryFnOnce for ReturnMapAdjoint<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for (input, bar) in self.input.iter().zip(self.bar) {
            stress_adjoint(self.model, input, &TrialStrains::new(self.model, input), &input.c, bar);
        }
    }
}
