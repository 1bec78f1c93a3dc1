//! Powder in an apparatus of its own: a scene, particles, and the engine that moves them.

use crate::mpm::Model;
use crate::mpm::bodies::{Bodies, Moment};
use crate::mpm::contact::BodyState;
use crate::mpm::material::{self, Material};
use crate::mpm::particles::{EMPTY_LANE, Group, LANES, Lanes, Particles, mat_of, set_vec, vec_of};
use crate::mpm::principal;
use crate::mpm::sort::EscapedParticle;
use crate::mpm::substep::{State, Workspace};
use crate::real::Real;
use crate::scene::{BLOCK_CELLS, FillShape, MAX_VISCOUS_LOSS, Scene, SceneSpec};
use crate::small::{Sym3, inner, plus_diagonal, trace};
use crate::validate::case::{Halt, Meter};

/// Gravity, m/s^2.
pub(super) const GRAVITY: f64 = 9.81;

/// Control period of every apparatus, s.
pub(super) const PERIOD_S: f64 = 0.01;

/// CFL number of the sound and the fastest particle together.
const CFL: f64 = 0.5;

/// An empty apparatus: the law of the powder and the numerics of `law`, and nothing else of it.
///
/// The powder is dry and is as stiff, and has the friction angle, that lines have unless they say otherwise.
pub(super) fn apparatus(law: &SceneSpec, size_m: [f64; 3], cell_m: f64) -> SceneSpec {
    let mut scene = law.clone();
    let block_m = BLOCK_CELLS as f64 * cell_m;
    scene.domain.size_m = size_m.map(|length| (length / block_m - 1e-6).ceil() * block_m);
    scene.domain.cell_m = cell_m;
    scene.domain.gravity_m_s2 = [0.0, 0.0, -GRAVITY];
    scene.containers.clear();
    scene.gates.clear();
    scene.powder.fill_shape = FillShape::Box;
    scene.powder.cohesion_pa = 0.0;
    scene.powder.tensile_strength_pa = None;
    scene.powder.youngs_modulus_pa = YOUNGS_MODULUS;
    scene.powder.friction_angle_deg = FRICTION_ANGLE;
    scene.domain.friction = libm::tan(FRICTION_ANGLE.to_radians());
    scene
}

/// Friction angle of most lines, degrees, and Young's modulus, Pa.
pub(super) const FRICTION_ANGLE: f64 = 30.0;
pub(super) const YOUNGS_MODULUS: f64 = 1e4;

/// Sets the time step for powder that is nowhere faster than `speed_m_s`.
pub(super) fn set_time_step(scene: &mut SceneSpec, speed_m_s: f64) {
    scene.time.control_period_us = (1e6 * PERIOD_S) as u32;
    let sound = scene.powder.sound_speed_m_s();
    let by_speed = PERIOD_S * (sound + speed_m_s) / (CFL * scene.domain.cell_m);
    scene.time.substeps = 1;
    let by_viscosity = scene.viscous_loss() / MAX_VISCOUS_LOSS;
    scene.time.substeps = by_speed.max(by_viscosity).ceil().max(1.0) as u32;
}

/// Speed of a fall from a height, m/s.
pub(super) fn fall_speed(height_m: f64) -> f64 {
    (2.0 * GRAVITY * height_m).sqrt()
}

/// Particles of a box, as a scene packs its own.
pub(super) fn packed(scene: &SceneSpec, min_m: [f64; 3], max_m: [f64; 3], seed: u64) -> Vec<[f64; 3]> {
    let mut filled = scene.clone();
    filled.powder.fill_min_m = min_m;
    filled.powder.fill_max_m = max_m;
    filled.unchecked().particle_positions_m(seed)
}

/// Particles of an upright cylinder.
pub(super) fn packed_cylinder(
    scene: &SceneSpec,
    [x, y, z]: [f64; 3],
    radius_m: f64,
    height_m: f64,
    seed: u64,
) -> Vec<[f64; 3]> {
    let low = [x - radius_m, y - radius_m, z];
    let mut points = packed(scene, low, [x + radius_m, y + radius_m, z + height_m], seed);
    points.retain(|p| libm::hypot(p[0] - x, p[1] - y) < radius_m);
    points
}

/// The return map as a substep of slow powder takes it: Kirchhoff stress (Pa), strain and volume correction.
pub(super) fn returned<T: Real>(material: &Material<T>, trial: Sym3<T>, q: T) -> (Sym3<T>, Sym3<T>, T) {
    let slowly = [q, T::ZERO];
    if material::is_mild(trial) {
        material::return_map(material, trial, slowly)
    } else {
        principal::return_map(material, trial, slowly)
    }
}

/// Powder in an apparatus.
pub(super) struct Rig<T: Real> {
    scene: Scene,
    model: Model<T>,
    state: State<T>,
    workspace: Workspace<T>,
    bodies: Bodies<T>,
    /// Substeps that are done: gates open when it is time.
    done: usize,
    forgets_volume: bool,
}

impl<T: Real> Rig<T> {
    /// Particles at rest and free of stress, and no tool.
    pub(super) fn new(scene: SceneSpec, particles: &[[f64; 3]]) -> Result<Self, Halt> {
        Self::with_tool(scene, particles, away())
    }

    /// The same with the scene's tool, which stays where it is.
    pub(super) fn with_tool(
        scene: SceneSpec,
        particles: &[[f64; 3]],
        tool: BodyState<T>,
    ) -> Result<Self, Halt> {
        let scene = scene.unchecked();
        let model = Model::new(&scene);
        let bodies = Bodies { tool, gates: model.gates.at(Moment::After(0)) };
        let state = State::new(&model, &bodies, &Particles::at_rest(particles))?;
        Ok(Self { scene, model, state, workspace: Workspace::new(), bodies, done: 0, forgets_volume: false })
    }

    /// The same between sides without friction; the floor keeps its own.
    pub(super) fn with_smooth_sides(mut self) -> Self {
        for wall in &mut self.model.obstacles.fixed[1..6] {
            wall.piece.node_law.friction = T::ZERO;
            wall.piece.particle_law.friction = T::ZERO;
        }
        self
    }

    /// The same without volume correction: what a particle has expanded by is forgotten after each substep.
    pub(super) fn without_volume_correction(mut self) -> Self {
        self.forgets_volume = true;
        self
    }

    pub(super) fn scene(&self) -> &SceneSpec {
        &self.scene
    }

    /// Particles.
    pub(super) fn len(&self) -> usize {
        self.state.particles.occupied().count()
    }

    /// Share of the blocks that do not sleep.
    pub(super) fn awake(&self) -> f64 {
        let awake = self.state.sleepers().filter(|asleep| !asleep).count();
        awake as f64 / self.state.layout.blocks.len() as f64
    }

    /// Goes on for about so long, in whole substeps.
    pub(super) fn run(&mut self, seconds: f64, meter: &Meter<'_>) -> Result<(), Halt> {
        let particles = self.len() as u64;
        let period = self.scene.time.substeps as usize;
        let substeps = (seconds / self.scene.time.substep_s()).round() as usize;
        for substep in 0..substeps {
            if !self.bodies.gates.is_empty() {
                self.bodies.gates = self.model.gates.at(Moment::After(self.done));
            }
            self.workspace.substep(&self.model, &self.bodies, &mut self.state)?;
            self.done += 1;
            if self.forgets_volume {
                self.state.particles.groups.iter_mut().for_each(|group| group.q = [Lanes::ZERO; 1]);
            }
            if substep % period == 0 {
                meter.spend(particles * period.min(substeps - substep) as u64)?;
            }
        }
        Ok(())
    }

    /// Adds particles, free of stress, that all move with one velocity.
    pub(super) fn insert(&mut self, particles: &[[f64; 3]], velocity_m_s: [f64; 3]) -> Result<(), Halt> {
        self.state.fill();
        let old = &self.state.particles;
        let mut all = Particles::at_rest(particles);
        for group in &mut all.groups {
            (0..LANES).for_each(|l| set_vec(&mut group.v, l, velocity_m_s.map(T::from_f64)));
        }
        let mut ids = all.ids.to_vec();
        // Those that are there keep their identity, the new ones come after them.
        let there = old.occupied().count() as u32;
        ids.iter_mut().flatten().filter(|id| **id != EMPTY_LANE).for_each(|id| *id += there);
        for (n, (g, l, id)) in old.occupied().enumerate() {
            if n % LANES == 0 {
                all.groups.push(Group::ZERO);
                ids.push([EMPTY_LANE; LANES]);
            }
            let last = ids.len() - 1;
            all.groups[last].copy_lane(n % LANES, &old.groups[g], l);
            ids[last][n % LANES] = id;
        }
        let all = Particles { groups: all.groups, ids: ids.into() };
        self.state = State::new(&self.model, &self.bodies, &all)?;
        Ok(())
    }

    /// Positions in the order in which particles came, m.
    pub(super) fn positions(&self) -> Vec<[f64; 3]> {
        self.numbers(|_, group, l| vec_of(&group.x, l).map(T::to_f64))
    }

    /// Velocities, m/s.
    pub(super) fn velocities(&self) -> Vec<[f64; 3]> {
        self.numbers(|_, group, l| vec_of(&group.v, l).map(T::to_f64))
    }

    /// Kirchhoff stresses, Pa.
    pub(super) fn stresses(&self) -> Vec<[f64; 6]> {
        self.numbers(|rig, group, l| rig.stress(group, l))
    }

    /// Kinetic energy with that of the affine velocities, energy above the floor, and elastic energy, J.
    pub(super) fn energy(&self) -> f64 {
        let (m, dx) = (self.model.mass.to_f64(), self.scene.domain.cell_m);
        let volume = self.scene.particle_volume_m3();
        let gravity = self.scene.domain.gravity_m_s2;
        let of = |rig: &Self, group: &Group<T>, l: usize| {
            let (x, v) = (vec_of(&group.x, l).map(T::to_f64), vec_of(&group.v, l).map(T::to_f64));
            let c = mat_of(&group.c, l).map(|row| row.map(T::to_f64));
            let affine: f64 = c.iter().flatten().map(|c| c * c).sum();
            let speed: f64 = v.iter().map(|v| v * v).sum();
            let height: f64 = (0..3).map(|a| -gravity[a] * x[a]).sum();
            m * (0.5 * speed + 0.125 * dx * dx * affine + height) + volume * rig.elastic(rig.stress(group, l))
        };
        self.numbers(of).iter().sum()
    }

    fn stress(&self, group: &Group<T>, l: usize) -> Sym3<f64> {
        let (tau, _, _) = returned(&self.model.material, group.strain_of(l), group.q[0][l]);
        tau.map(T::to_f64)
    }

    /// Elastic energy of a stress, Pa.
    fn elastic(&self, tau: Sym3<f64>) -> f64 {
        let (lambda, mu) = (self.model.material.lambda.to_f64(), self.model.material.mu.to_f64());
        let sum = trace(tau);
        let deviator = plus_diagonal(tau, -sum / 3.0);
        inner(deviator, deviator) / (4.0 * mu) + sum * sum / (18.0 * lambda + 12.0 * mu)
    }

    fn numbers<N: Copy>(&self, of: impl Fn(&Self, &Group<T>, usize) -> N) -> Vec<N> {
        let mut state = self.state.clone();
        state.fill();
        let particles = &state.particles;
        let mut all: Vec<_> =
            particles.occupied().map(|(g, l, id)| (id, of(self, &particles.groups[g], l))).collect();
        all.sort_by_key(|(id, _)| *id);
        all.into_iter().map(|(_, number)| number).collect()
    }
}

impl From<EscapedParticle> for Halt {
    fn from(EscapedParticle { particle }: EscapedParticle) -> Self {
        Self::Failed(format!("particle {particle} left the simulated volume"))
    }
}

/// A tool out of everybody's reach.
fn away<T: Real>() -> BodyState<T> {
    let (zero, one) = (T::ZERO, T::ONE);
    BodyState {
        rotation: [[one, zero, zero], [zero, one, zero], [zero, zero, one]],
        position: [T::from_f64(-1e3); 3],
        velocity: [zero; 3],
        angular_velocity: [zero; 3],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::DEFAULT_SCENE;

    fn scene() -> SceneSpec {
        let law = Scene::load(DEFAULT_SCENE).unwrap();
        let mut scene = apparatus(&law, [0.03; 3], 0.004);
        set_time_step(&mut scene, 1.0);
        scene
    }

    #[test]
    fn an_apparatus_has_whole_blocks_and_a_stable_time_step() {
        let scene = scene();
        assert_eq!(scene.cell_counts(), [8; 3]);
        assert!(scene.cfl_number() < 0.5 && scene.viscous_loss() < MAX_VISCOUS_LOSS);
        let mut viscous = scene.clone();
        viscous.powder.viscosity_pa_s = 10.0;
        set_time_step(&mut viscous, 1.0);
        assert!(viscous.time.substeps > scene.time.substeps && viscous.viscous_loss() <= MAX_VISCOUS_LOSS);
    }

    /// Nothing of where a scene's own powder lies is taken from it.
    #[test]
    fn a_box_is_filled_whatever_the_shape_of_the_scenes_powder() {
        let mut law = Scene::load(DEFAULT_SCENE).unwrap().into_spec();
        let packed = |law: &SceneSpec| packed(&apparatus(law, [0.03; 3], 0.004), [0.004; 3], [0.012; 3], 1);
        let boxed = packed(&law);
        law.powder.fill_shape = FillShape::Cylinder;
        assert_eq!(packed(&law), boxed);
    }

    #[test]
    fn what_is_inserted_comes_last_and_falls_freely() {
        let scene = scene();
        let meter = Meter::unwatched();
        let first = packed(&scene, [0.004; 3], [0.008; 3], 1);
        let mut rig = Rig::<f64>::new(scene.clone(), &first).unwrap();
        let more = packed(&scene, [0.012; 3], [0.02; 3], 2);
        rig.insert(&more, [0.1, 0.0, 0.0]).unwrap();
        assert_eq!((rig.positions(), rig.len()), ([first.clone(), more.clone()].concat(), 72));
        rig.insert(&[], [0.0; 3]).unwrap();
        rig.run(0.02, &meter).unwrap();
        let after = rig.velocities();
        let falling = -GRAVITY * 0.02;
        assert!(after[8..].iter().all(|v| (v[0] - 0.1).abs() < 3e-3 && (v[2] - falling).abs() < 3e-3));
        // They share some nodes, and the first ones those of the floor.
        assert!(after[..8].iter().all(|v| v[0].abs() < 0.03 && v[2] > 1.05 * falling), "{after:?}");
    }

    #[test]
    fn energies_are_counted_in_joule() {
        let mut scene = scene();
        scene.powder.viscosity_pa_s = 0.0;
        let cube = packed(&scene, [0.012; 3], [0.02; 3], 1);
        let mut rig = Rig::<f64>::new(scene.clone(), &cube).unwrap();
        let mass = rig.len() as f64 * scene.particle_mass_kg();
        let height = cube.iter().map(|p| p[2]).sum::<f64>() / cube.len() as f64;
        let energy = rig.energy();
        assert!((energy / (mass * GRAVITY * height) - 1.0).abs() < 1e-12, "{energy}");
        // Squeezed by a thousandth along each axis, which no yield surface limits: 9/2 K eps^2 in each unit
        // of volume.
        let squeeze = |rig: &mut Rig<f64>, strain: f64| {
            rig.state.particles.groups.iter_mut().for_each(|group| {
                group.strain[..3].iter_mut().for_each(|row| *row = Lanes([strain; LANES]));
            });
        };
        squeeze(&mut rig, -0.002);
        let bulk = scene.powder.lame_lambda_pa() + 2.0 / 3.0 * scene.powder.lame_mu_pa();
        let want = rig.len() as f64 * scene.particle_volume_m3() * 4.5 * bulk * 1e-6;
        let elastic = rig.energy() - energy;
        assert!((elastic / want - 1.0).abs() < 0.005, "{elastic} {want}");
        squeeze(&mut rig, 0.0);
        // It falls: what it loses of height it gains of speed, but for the height that it falls in half a
        // substep.
        rig.run(0.03, &Meter::unwatched()).unwrap();
        let late = 0.5 * scene.time.substep_s() * GRAVITY * 0.03 / height;
        assert!((rig.energy() / energy - (1.0 - late)).abs() < 2e-4, "{} {energy} {late}", rig.energy());
        // Spin of the affine velocities counts.
        let before = rig.energy();
        rig.state.particles.groups.iter_mut().for_each(|group| group.c[1] = Lanes([5.0; LANES]));
        assert!(rig.energy() > before);
    }

    #[test]
    fn sides_without_friction_leave_the_floor_its_own() {
        let rig = Rig::<f32>::new(scene(), &[[0.01; 3]]).unwrap().with_smooth_sides();
        let fixed = &rig.model.obstacles.fixed;
        let frictions: Vec<bool> = fixed.iter().map(|wall| wall.piece.node_law.friction > 0.0).collect();
        assert_eq!(frictions, [true, false, false, false, false, false]);
    }
}
