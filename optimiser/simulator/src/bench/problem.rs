//! The powder that is measured: a bed of any size in a box, and a bowl that goes back and forth in it.

use powderline_shared::displacement::Displacement;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::BenchError;
use crate::mpm::Model;
use crate::mpm::contact::BodyState;
use crate::mpm::obstacle::distance;
use crate::rollout::path::resting;
use crate::scene::{Container, ContainerShape, DEFAULT_SCENE, Scene, ToolShape};
use crate::skill::SkillMap;

/// Particles in a cell.
pub const PARTICLES_PER_CELL: u32 = 8;

/// Substeps in a control step.
pub const SUBSTEPS: u32 = 20;

/// Cells between the bed's surface and the top of the grid, at least.
const HEADROOM_CELLS: usize = 4;

/// Speed of the bowl in the middle of its way, m/s, and how fast it goes to and fro at most, rad/s.
const SPEED_M_S: f64 = 0.1;
const PULSE_RAD_S: f64 = 15.0;

/// By how much the bowl tilts to either side, rad.
const TILT_RAD: f64 = 0.1;

/// Bed, box and bowl.
#[derive(Clone)]
pub(crate) struct Problem {
    pub(crate) scene: Scene,
    /// Where the particles are at first, m.
    pub(crate) packing: Vec<[f64; 3]>,
    /// How far the bowl goes to either side, m.
    swing_m: f64,
}

/// Lengths in cells.
struct Shape {
    /// Inner width of the box: even, so that its walls lie on nodes.
    width: usize,
    depth: f64,
    /// Inner radius of the bowl.
    radius: f64,
}

impl Shape {
    /// A bed two and a half times as wide as deep if the grid is wide enough.
    fn new(particles: usize, grid: usize) -> Self {
        let cells = particles as f64 / f64::from(PARTICLES_PER_CELL);
        // One cell for the wall and one beyond it, on either side.
        let widest = (grid - 4) / 2 * 2;
        let width = (((2.5 * cells).cbrt() / 2.0).round() as usize * 2).clamp(6, widest);
        let depth = cells / (width * width) as f64;
        Self { width, depth, radius: (0.25 * width as f64).min(depth - 1.5).max(1.5) }
    }
}

impl Problem {
    /// A bed of so many particles in a grid with so many cells along each edge.
    ///
    /// # Errors
    /// [`BenchError::Grid`] if the bed does not fit in.
    pub(crate) fn new(particles: usize, grid: usize) -> Result<Self, BenchError> {
        let shape = Shape::new(particles, grid);
        let scene = scene(&shape, grid);
        let packing = packing(&scene, &shape, particles, grid)?;
        let swing = (0.5 * shape.width as f64 - shape.radius - 1.5).clamp(0.25, 4.0);
        Ok(Self { swing_m: swing * scene.domain.cell_m, scene, packing })
    }

    /// The same with control steps of one substep each.
    pub(crate) fn by_substeps(&self) -> Self {
        let mut scene = self.scene.clone().into_spec();
        scene.time.control_period_us /= SUBSTEPS;
        scene.time.substeps = 1;
        Self { scene: scene.unchecked(), packing: self.packing.clone(), ..*self }
    }

    /// Controls of the bowl in these control steps.
    pub(crate) fn controls(&self, steps: std::ops::Range<usize>) -> Vec<Displacement> {
        let pulse = (SPEED_M_S / self.swing_m).min(PULSE_RAD_S);
        let at = |step: usize| libm::sin(pulse * step as f64 * self.scene.time.control_period_s());
        steps
            .map(|step| {
                let part = at(step + 1) - at(step);
                Displacement {
                    translation_m: [self.swing_m * part, 0.0, 0.0],
                    rotation_rad: [0.0, TILT_RAD * part, 0.0],
                }
            })
            .collect()
    }
}

/// The shipped bench with another box, another bowl and another grid. Beyond what is changed here nothing of it
/// matters.
fn scene(shape: &Shape, grid: usize) -> Scene {
    let mut scene = Scene::load(DEFAULT_SCENE).expect("the shipped scene is valid").into_spec();
    let cell = scene.domain.cell_m;
    let middle = (grid / 2) as f64 * cell;
    let half_width = 0.5 * shape.width as f64 * cell;
    scene.name = "bed".into();
    scene.domain.size_m = [grid as f64 * cell; 3];
    scene.domain.sleep_speed_m_s = 0.0;
    scene.powder.particles_per_cell = PARTICLES_PER_CELL;
    scene.powder.fill_min_m = [middle - half_width, middle - half_width, cell];
    scene.powder.fill_max_m = [middle + half_width, middle + half_width, (1.0 + shape.depth) * cell];
    scene.time.substeps = SUBSTEPS;
    scene.time.settle_s = 0.0;
    let height = shape.depth + 0.5 * HEADROOM_CELLS as f64;
    let inner_size_m = [2.0 * half_width, 2.0 * half_width, height * cell];
    let source = &scene.containers[0];
    scene.containers = vec![Container {
        position_m: [middle, middle, cell],
        wall_thickness_m: cell,
        shape: ContainerShape::Box { inner_size_m },
        ..source.clone()
    }];
    scene.objective.target.clone_from(&scene.containers[0].name);
    scene.objective.p_target_m = [middle, middle, cell];
    scene.tool.shape = ToolShape::Bowl { inner_radius_m: shape.radius * cell };
    scene.tool.wall_thickness_m = cell;
    scene.tool.handle.radius_m = 0.5 * cell;
    scene.tool.start_position_m = [middle, middle, (1.0 + shape.depth) * cell];
    scene.tool.start_pitch_deg = 20.0;
    scene.unchecked()
}

/// Positions, m: one particle somewhere in each eighth of a cell that the bowl leaves free, from the floor upwards.
fn packing(scene: &Scene, shape: &Shape, particles: usize, grid: usize) -> Result<Vec<[f64; 3]>, BenchError> {
    let model = Model::<f64>::new(scene);
    let bowl: BodyState<f64> = resting(SkillMap::new(scene).start_pose());
    let cell = scene.domain.cell_m;
    let edge = 0.5 * cell;
    let [x0, y0, z0] = scene.powder.fill_min_m;
    let per_side = 2 * shape.width;
    let layers = 2 * grid.saturating_sub(HEADROOM_CELLS + 1);
    let mut random = ChaCha8Rng::seed_from_u64(scene.powder.seed);
    let mut part = || (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    let mut positions = Vec::with_capacity(particles);
    for place in 0..layers * per_side * per_side {
        if positions.len() == particles {
            break;
        }
        let [i, j, k] = [place % per_side, place / per_side % per_side, place / (per_side * per_side)];
        let mut at = |origin: f64, index: usize| origin + (index as f64 + part()) * edge;
        let position = [at(x0, i), at(y0, j), at(z0, k)];
        if model.obstacles.tool.iter().all(|piece| distance(piece, &bowl, position) > 0.1 * cell) {
            positions.push(position);
        }
    }
    if positions.len() < particles {
        return Err(BenchError::Grid { particles, grid, most: positions.len() });
    }
    Ok(positions)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beds_hold_as_many_particles_as_wanted_and_none_in_the_wall_of_the_bowl() {
        for (particles, grid) in [(1_000, 16), (5_000, 64), (20_000, 64), (30_001, 32), (300_000, 48)] {
            let problem = Problem::new(particles, grid).expect("fits");
            assert_eq!(problem.packing.len(), particles);
            let [min, max] = [problem.scene.powder.fill_min_m, problem.scene.powder.fill_max_m];
            let tool = problem.scene.tool.start_position_m;
            let ToolShape::Bowl { inner_radius_m } = problem.scene.tool.shape else { panic!("a bowl") };
            let wall = inner_radius_m..inner_radius_m + problem.scene.tool.wall_thickness_m;
            // The bowl tilts by less than this.
            let low = tool[2] - 0.4 * wall.end;
            for x in &problem.packing {
                assert!((0..2).all(|axis| (min[axis]..=max[axis]).contains(&x[axis])) && x[2] >= min[2]);
                let distance = (0..3).map(|axis| (x[axis] - tool[axis]).powi(2)).sum::<f64>().sqrt();
                assert!(x[2] > low || !wall.contains(&distance), "{x:?} is in the bowl's wall");
            }
            let inside = problem.packing.iter().filter(|x| {
                (0..3).map(|axis| (x[axis] - tool[axis]).powi(2)).sum::<f64>().sqrt() < inner_radius_m
            });
            assert!(inside.count() > 0, "the bowl is full");
        }
    }

    #[test]
    fn the_bowl_stays_in_the_box_and_comes_back() {
        let problem = Problem::new(20_000, 64).expect("fits");
        let mut x: f64 = 0.0;
        let mut turned: f64 = 0.0;
        let mut widest: f64 = 0.0;
        for control in problem.controls(0..400) {
            x += control.translation_m[0];
            turned += control.rotation_rad[1];
            widest = widest.max(x.abs());
            assert!(control.translation_m[0].abs() <= 1.001 * SPEED_M_S * 0.01);
            assert!(turned.abs() <= TILT_RAD + 1e-12);
        }
        assert!(widest <= problem.swing_m + 1e-12 && widest > 0.9 * problem.swing_m);
        let finer: f64 = problem.by_substeps().controls(0..8000).iter().map(|c| c.translation_m[0]).sum();
        assert!((finer - x).abs() < 1e-12);
    }

    #[test]
    fn a_bed_that_the_grid_cannot_hold_is_refused() {
        let refused = Problem::new(100_000, 16).map(|_| ());
        let Err(BenchError::Grid { most, .. }) = refused else { panic!("{refused:?}") };
        assert!((5_000..100_000).contains(&most));
        // A shallower bed has a smaller bowl in it, somewhere else.
        assert!(Problem::new(most * 9 / 10, 16).is_ok());
    }
}
