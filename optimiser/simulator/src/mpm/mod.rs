//! The moving least squares material point method (Hu et al. 2018), forward and adjoint.
//!
//! One substep is three stages, each with its adjoint beside it in one file:
//! `p2g` (material and scatter), `grid_update` (gravity and contact at nodes), `g2p` (gather, contact at
//! particles, advection). `substep` runs them over all blocks.
//!
//! `x_bar` is the cotangent of `x`: the derivative of the loss with respect to it.
//!
//! Kernels are written for one particle and looped over the lanes of a group; the loop is what becomes vector
//! instructions, with the widest instruction set found at run time. Where a product and a sum are rounded once, the kernels
//! say so (`mul_add`), and nothing else is contracted: the bits are the same on every machine.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over lanes, axes and tensor indices read as the formulas do, and vectorise as they stand"
)]

pub(crate) mod bodies;
pub(crate) mod connect;
pub(crate) mod contact;
pub(crate) mod density;
pub(crate) mod g2p;
pub(crate) mod gather;
pub(crate) mod grid_update;
pub(crate) mod layers;
pub(crate) mod layout;
pub(crate) mod material;
pub(crate) mod matrix_polynomial;
pub(crate) mod obstacle;
pub(crate) mod p2g;
pub(crate) mod particles;
pub(crate) mod principal;
pub(crate) mod residue;
pub(crate) mod sleep;
pub(crate) mod sort;
pub(crate) mod spare;
pub(crate) mod stencil;
pub(crate) mod stencil_positions;
pub(crate) mod substep;
#[cfg(test)]
pub(crate) mod tests;
pub(crate) mod tiles;
pub(crate) mod timings;
pub(crate) mod walls;

/// Raised with every change of what a substep or a gradient computes: a run is not resumed by another physics.
pub const PHYSICS_VERSION: u32 = 8;

use std::marker::PhantomData;

use crate::real::Real;
use crate::scene::{Scene, VolumeCorrection};

/// How the kernels of a type of numbers are run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arch<T>(pulp::Arch, PhantomData<T>);

impl<T: Real> Arch<T> {
    fn new() -> Self {
        Self(pulp::Arch::new(), PhantomData)
    }

    #[inline(always)]
    pub(crate) fn dispatch<K: pulp::NullaryFnOnce>(&self, kernel: K) -> K::Output {
        T::dispatch(self.0, kernel)
    }
}

/// Everything that does not change during a rollout.
#[derive(Clone, Debug)]
pub(crate) struct Model<T> {
    pub(crate) grid: layout::Grid,
    pub(crate) obstacles: obstacle::Colliders<T>,
    /// What walls hide, where they have two sides.
    pub(crate) walls: Option<walls::Walls>,
    pub(crate) gates: bodies::Gates,
    pub(crate) material: material::Material<T>,
    pub(crate) dt: T,
    pub(crate) inverse_dx: T,
    pub(crate) four_per_dx: T,
    /// Positions of a block's nodes from its first one, m.
    pub(crate) node_places: grid_update::NodeLanes<T>,
    /// Mass of a particle, kg.
    pub(crate) mass: T,
    /// Mass times cell size: `m C dx`.
    pub(crate) mass_dx: T,
    /// `dt V0 (4/dx^2) dx`: what the stress is multiplied with in `A dx`.
    pub(crate) stress_dx: T,
    /// Fraction of the strain rate's momentum that viscosity takes in a substep, `8 eta dt/(rho dx^2)`.
    pub(crate) viscous_loss: T,
    /// Whether volume is held to the density that the grid sees, see [`density`].
    pub(crate) holds_volume: bool,
    /// How powder that is looser than it believes is loosened; none: by all of it in each hold, at rest too.
    pub(crate) loosening: Option<density::Loosening<T>>,
    /// What is given back of the velocity that the grid cannot hold; none if nothing is.
    pub(crate) residue: Option<residue::Residue<T>>,
    /// Density over the mass of a node whose spline is all room: `1/(rho_0 dx^3)`, 1/kg.
    pub(crate) density_per_mass: T,
    /// Gravity times substep, m/s.
    pub(crate) gravity_dt: [T; 3],
    pub(crate) sleep: sleep::SleepLaw<T>,
    pub(crate) arch: Arch<T>,
}

impl<T: Real> Model<T> {
    /// The same that gives nothing back. Its adjoint takes what is given back for a constant.
    pub(crate) fn without_residue(&self) -> Self {
        Self { residue: None, ..self.clone() }
    }

    /// The same with powder that falls asleep below this speed, m/s.
    pub(crate) fn with_sleep_speed(&self, speed_m_s: f64) -> Self {
        Self { sleep: self.sleep.with_speed(speed_m_s), ..self.clone() }
    }

    pub(crate) fn new(scene: &Scene) -> Self {
        let grid = layout::Grid::new(scene);
        let dx = scene.domain.cell_m;
        let dt = f64::from(scene.time.control_period_us) * 1e-6 / f64::from(scene.time.substeps);
        let volume = dx * dx * dx / f64::from(scene.powder.particles_per_cell);
        let mass = volume * scene.powder.density_kg_m3;
        let (node_places, arch) = (grid_update::node_places(T::from_f64(dx)), Arch::new());
        let obstacles = obstacle::Colliders::new(scene, &grid);
        Self {
            grid,
            walls: walls::Walls::new(&grid, &obstacles, &node_places, arch),
            obstacles,
            gates: bodies::Gates::new(scene),
            material: material::Material::of(&scene.powder),
            dt: T::from_f64(dt),
            inverse_dx: T::from_f64(1.0 / dx),
            four_per_dx: T::from_f64(4.0 / dx),
            node_places,
            mass: T::from_f64(mass),
            mass_dx: T::from_f64(mass * dx),
            stress_dx: T::from_f64(dt * volume * 4.0 / dx),
            viscous_loss: T::from_f64(scene.viscous_loss()),
            holds_volume: scene.powder.volume_correction == VolumeCorrection::Grid,
            loosening: scene
                .powder
                .loosening_strain
                .map(|strain| density::Loosening::new(strain, f64::from(substep::HOLD_EVERY) * dt)),
            residue: scene.powder.transfer.map(|transfer| residue::Residue::of(transfer, dt)),
            density_per_mass: T::from_f64(1.0 / (scene.powder.density_kg_m3 * dx * dx * dx)),
            sleep: sleep::SleepLaw::of(scene, dt),
            gravity_dt: scene.domain.gravity_m_s2.map(|g| T::from_f64(g * dt)),
            arch,
        }
    }
}
