//! The velocity that the grid cannot hold, given back.
//!
//! What of the particles' velocities is finer than the grid, APIC throws away in every substep: powder then loses the more energy the
//! more substeps there are. With `transfer = { residue_time_s = tau }` it is given back and decays by time instead. What the grid
//! makes of the velocities alone is found by a second momentum, without forces, that goes to the nodes and back with the first one.
//! After Fei, Guo, Wu, Huang and Gao 2021, "Revisiting integration in the material point method" (AFLIP), where a share is given back
//! in each step, whatever its length.
//!
//! | symbol | identifier | meaning |
//! |---|---|---|
//! | `p0_i` | `unforced` | `sum w m (v + C (x_i - x))`: a node's momentum if no force acts |
//! | `v0_i` | `unforced` | `p0_i/m_i` |
//! | `e^(-dt/tau)` | `kept` | what is left after a substep |
//! | `d` | `residue` | `e^(-dt/tau) (v - sum w v0_i)` |
//! | `u` | | the grid's velocity at the particle, after contact |
//!
//! ```text
//! v' = u + d,   x' = x + dt u
//! ```
//!
//! Particles move with the grid, so that none goes through a wall or overtakes another. `sum m d` is 0: momentum is kept. Angular momentum
//! is not, since no part of `C` is given back. Sleepers send their mass and no momentum.
//!
//! All powder gets its residue back, dense or loose. Given to dense powder alone, by the volume correction `q`, how far columns run out
//! would depend on the time step again (by 10 % from one step to a quarter of it), as `q` is noise that grows with their number.
//!
//! `tau` decides between two things. With 50, 20, 10, 5 ms a column as high as its radius runs out 1.10, 1.10, 1.08, 1.06 radii (12 cells
//! per radius; sand 1.24), and with a quarter of the time step 0, 0, 2, 4 % less far; of 11 g that one skill of `bench` pours
//! 2.0, 1.6, 1.1, 0.8 g miss the target, as what has fallen keeps jumping for that long. The program's scenes have 10 ms.

use crate::mpm::Model;
use crate::mpm::gather::{Rows, Sent, gather_gradient, gather_with_gradient};
use crate::mpm::p2g::at_base;
use crate::mpm::particles::{Group, LANES, Lanes, mat_of, set_mat, set_vec, vec_of};
use crate::mpm::stencil::Tile;
use crate::mpm::stencil_positions::{StencilPositions, Weights};
use crate::real::Real;
use crate::scene::Transfer;
use crate::small::{scale, three, tr_mul_vec};

/// How much is given back.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Residue<T> {
    /// `e^(-dt/tau)`
    kept: T,
}

impl<T: Real> Residue<T> {
    /// Of a scene, in substeps of so many seconds.
    pub(crate) fn of(transfer: Transfer, dt: f64) -> Self {
        Self { kept: T::from_f64(libm::exp(-dt / transfer.residue_time_s)) }
    }

    /// What a group of particles with velocities `v` gets back; `smooth` is `sum w v0_i`.
    #[inline(always)]
    pub(crate) fn of_group(
        &self,
        smooth: &[Lanes<T>; 3],
        v: &[Lanes<T>; 3],
        occupied: usize,
    ) -> [Lanes<T>; 3] {
        let mut out = [Lanes::ZERO; 3];
        for axis in 0..3 {
            for l in 0..LANES {
                out[axis][l] = (self.kept * (v[axis][l] - smooth[axis][l])).only_if(l < occupied);
            }
        }
        out
    }

    /// Adjoint of [`Self::of_group`] for the cotangent of what is given back.
    #[inline(always)]
    pub(crate) fn adjoint(
        &self,
        tile: &Tile<T>,
        places: &StencilPositions<T>,
        weights: &Weights<T>,
        occupied: usize,
        bar: &[Lanes<T>; 3],
        rows: &mut Rows<T>,
    ) -> ResidueBar<T> {
        let (mut v, mut sent) = ([Lanes::ZERO; 3], Sent::ZERO);
        for axis in 0..3 {
            for l in 0..LANES {
                v[axis][l] = (self.kept * bar[axis][l]).only_if(l < occupied);
                sent.base[axis][l] = -v[axis][l];
            }
        }
        let x = gather_gradient(tile, places, weights, &sent, occupied, rows).gradient;
        ResidueBar { v, x, sent }
    }
}

/// What the adjoint of the residue gives.
pub(crate) struct ResidueBar<T> {
    /// Cotangents of the velocities before the substep.
    pub(crate) v: [Lanes<T>; 3],
    /// Of the places, in cells.
    pub(crate) x: [Lanes<T>; 3],
    /// What goes to the nodes' unforced velocities.
    pub(crate) sent: Sent<T>,
}

/// What the particles of a group send to the grid if no force acts.
#[inline(always)]
pub(crate) fn unforced<T: Real>(model: &Model<T>, input: &Group<T>, places: &StencilPositions<T>) -> Sent<T> {
    let mut sent = Sent::ZERO;
    for l in 0..LANES {
        let c = mat_of(&input.c, l);
        let a_dx = three!(i => three!(j => model.mass_dx * c[i][j]));
        set_mat(&mut sent.a_dx, l, a_dx);
        set_vec(&mut sent.base, l, at_base(scale(model.mass, vec_of(&input.v, l)), &a_dx, places.f(l)));
    }
    sent
}

/// Adjoint of [`unforced`] and of its way to the grid, `tile` having the cotangents of the nodes' momentum: adds to the cotangents of
/// positions and velocities, and returns those of the affine velocities.
#[inline(always)]
pub(crate) fn unforced_adjoint<T: Real>(
    model: &Model<T>,
    tile: &Tile<T>,
    places: &StencilPositions<T>,
    weights: &Weights<T>,
    (input, occupied): (&Group<T>, usize),
    rows: &mut Rows<T>,
    bar: &mut Group<T>,
) -> [Lanes<T>; 9] {
    let sent = unforced(model, input, places);
    let gathered = gather_with_gradient(tile, places, weights, &sent, &Lanes::ZERO, occupied, rows);
    let mut c_bar = [Lanes::ZERO; 9];
    for l in 0..LANES {
        let (f, a_dx) = (places.f(l), mat_of(&sent.a_dx, l));
        let (sum, first) = (vec_of(&gathered.sum, l), mat_of(&gathered.first, l));
        let (gradient, through_f) = (vec_of(&gathered.gradient, l), tr_mul_vec(&a_dx, sum));
        for axis in 0..3 {
            bar.x[axis][l] += model.inverse_dx * (gradient[axis] - through_f[axis]);
            bar.v[axis][l] += model.mass * sum[axis];
        }
        set_mat(&mut c_bar, l, three!(i => three!(j => model.mass_dx * (first[i][j] - sum[i] * f[j]))));
    }
    c_bar
}

/// A node's unforced velocity, from that momentum and its mass.
#[inline(always)]
pub(crate) fn unforced_velocity<T: Real>([x, y, z, _]: [T; 4], mass: T) -> [T; 4] {
    let inverse = if mass > T::ZERO { T::ONE / mass } else { T::ZERO };
    [x * inverse, y * inverse, z * inverse, T::ZERO]
}

/// Adjoint of [`unforced_velocity`], from its result: cotangents of momentum and, as fourth number, of mass.
#[inline(always)]
pub(crate) fn unforced_velocity_adjoint<T: Real>(velocity: [T; 4], mass: T, bar: [T; 4]) -> [T; 4] {
    let [x, y, z, _] = unforced_velocity(bar, mass);
    [x, y, z, -(x * velocity[0] + y * velocity[1] + z * velocity[2])]
}
