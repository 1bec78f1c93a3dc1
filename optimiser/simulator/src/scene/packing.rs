//! The powder's initial particle positions: jittered stratified sampling of the fill box, or of the column in it.
//!
//! The box is divided into a regular lattice of sub-cells no larger than a particle's own cube, of edge
//! cell / cbrt(particles_per_cell), and N of them (N as [`Scene::particle_count`] says) hold one particle each,
//! uniformly placed within. Where the box is a whole number of such cubes along every axis, as in the shipped
//! scenes, every sub-cell holds one. Otherwise the sub-cells are a little smaller and the few that stay empty are
//! chosen at random, every choice being equally likely.
//!
//! Of a column a sub-cell has a share: the volume that it has inside over that of a particle, at most 1. The shares are added
//! up in order, and each sub-cell at which the sum passes 1/2, 3/2, 5/2 and so on holds a particle, uniformly placed in
//! what it has inside: N in all, and along every stretch as many as belong there.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::{FillShape, Powder, Scene};

/// Places tried in a sub-cell that lies partly outside of a column.
const TRIES: usize = 64;

impl Scene {
    /// Particles in the scene: volume of the powder over the volume of a particle, rounded.
    pub fn particle_count(&self) -> usize {
        let count = (self.powder.fill_volume_m3() / self.particle_volume_m3()).round() as usize;
        match self.powder.fill_shape {
            FillShape::Box => count.min(Lattice::new(self).len()),
            FillShape::Cylinder => count,
        }
    }

    /// Initial particle positions, metres, world frame, all inside what is filled.
    ///
    /// Order: by sub-cell, x running fastest, then y, then z. The numbers come from ChaCha8, whose 32-byte key is
    /// `seed` in little-endian followed by zeros, and depend on nothing else. A scene's own seed is `powder.seed`.
    pub fn particle_positions_m(&self, seed: u64) -> Vec<[f64; 3]> {
        let (mut random, lattice) = (Random::new(seed), Lattice::new(self));
        match self.powder.fill_shape {
            FillShape::Box => lattice.fill(self.particle_count(), &mut random),
            FillShape::Cylinder => {
                let particles = self.powder.fill_volume_m3() / self.particle_volume_m3();
                lattice.fill_column(&Column::new(&self.powder), particles, &mut random)
            }
        }
    }
}

/// Sub-cells of the fill box.
struct Lattice {
    min_m: [f64; 3],
    max_m: [f64; 3],
    edges_m: [f64; 3],
    counts: [usize; 3],
}

impl Lattice {
    fn new(scene: &Scene) -> Self {
        let spacing_m = scene.particle_volume_m3().cbrt();
        let size_m = scene.powder.fill_size_m();
        // A millionth of a sub-cell is rounding, not room for another layer.
        let counts = size_m.map(|extent_m| ((extent_m / spacing_m - 1e-6).ceil() as usize).max(1));
        let edges_m = std::array::from_fn(|axis| size_m[axis] / counts[axis] as f64);
        Self { min_m: scene.powder.fill_min_m, max_m: scene.powder.fill_max_m, edges_m, counts }
    }

    fn len(&self) -> usize {
        self.counts.iter().product()
    }

    /// So many particles anywhere in the box.
    fn fill(&self, mut wanted: usize, random: &mut Random) -> Vec<[f64; 3]> {
        let mut positions = Vec::with_capacity(wanted);
        let total = self.len();
        for index in 0..total {
            // Selection sampling (Knuth, algorithm S): exactly `wanted` of what is left.
            let left = total - index;
            if wanted == left || random.unit() * (left as f64) < wanted as f64 {
                positions.push(self.jittered(index, random));
                wanted -= 1;
            }
            if wanted == 0 {
                break;
            }
        }
        positions
    }

    /// The particles of a column whose volume is that of so many, rounded.
    fn fill_column(&self, column: &Column, particles: f64, random: &mut Random) -> Vec<[f64; 3]> {
        let [nx, ny, nz] = self.counts;
        let layer = nx * ny;
        let inside: Vec<f64> = (0..layer).map(|index| column.area_m2(self.sides_m(index))).collect();
        let whole_m2: f64 = inside.iter().sum();
        let share = particles / (nz as f64 * whole_m2);
        // Where it begins, so that it ends at nothing: the sums' own rounding then takes no particle and brings none.
        let mut owed = particles.round() - particles;
        let mut positions = Vec::with_capacity(particles.round() as usize);
        for index in 0..self.len() {
            owed += share * inside[index % layer];
            if owed >= 0.5 && inside[index % layer] > 0.0 {
                positions.push(self.jittered_within(index, column, random));
                owed -= 1.0;
            }
        }
        positions
    }

    /// Which sub-cell along each axis.
    fn cell(&self, index: usize) -> [usize; 3] {
        let [nx, ny, _] = self.counts;
        [index % nx, index / nx % ny, index / (nx * ny)]
    }

    /// From where to where a sub-cell goes along x and y, metres.
    fn sides_m(&self, index: usize) -> [[f64; 2]; 2] {
        let cell = self.cell(index);
        [0, 1].map(|axis| [0, 1].map(|end| self.min_m[axis] + (cell[axis] + end) as f64 * self.edges_m[axis]))
    }

    fn jittered(&self, index: usize, random: &mut Random) -> [f64; 3] {
        let cell = self.cell(index);
        std::array::from_fn(|axis| {
            let place_m = self.min_m[axis] + (cell[axis] as f64 + random.unit()) * self.edges_m[axis];
            // The sum may round to just beyond the far side.
            place_m.min(self.max_m[axis])
        })
    }

    /// Somewhere in a sub-cell that is at least partly inside a column, and inside the column.
    fn jittered_within(&self, index: usize, column: &Column, random: &mut Random) -> [f64; 3] {
        let mut place_m = self.jittered(index, random);
        for _ in 1..TRIES {
            if column.holds(place_m) {
                return place_m;
            }
            place_m = self.jittered(index, random);
        }
        // Next to nothing of it is inside: its place nearest to the axis is.
        let [x, y] = column.nearest_m(self.sides_m(index));
        if column.holds(place_m) { place_m } else { [x, y, place_m[2]] }
    }
}

/// The upright round column inscribed in the fill box.
struct Column {
    middle_m: [f64; 2],
    radius_m: f64,
}

impl Column {
    fn new(powder: &Powder) -> Self {
        Self { middle_m: powder.fill_middle_m(), radius_m: powder.fill_radius_m() }
    }

    fn holds(&self, [x, y, _]: [f64; 3]) -> bool {
        libm::hypot(x - self.middle_m[0], y - self.middle_m[1]) <= self.radius_m
    }

    /// The point of a rectangle that is nearest to the axis.
    fn nearest_m(&self, sides_m: [[f64; 2]; 2]) -> [f64; 2] {
        [0, 1].map(|axis| self.middle_m[axis].clamp(sides_m[axis][0], sides_m[axis][1]))
    }

    /// Area that a rectangle has inside, square metres.
    fn area_m2(&self, sides_m: [[f64; 2]; 2]) -> f64 {
        let [x, y] = [0, 1].map(|axis| sides_m[axis].map(|side_m| side_m - self.middle_m[axis]));
        let area_m2 = self.corner_m2(x[1], y[1]) - self.corner_m2(x[0], y[1]) - self.corner_m2(x[1], y[0])
            + self.corner_m2(x[0], y[0]);
        let [dx, dy] = [x, y].map(|[from, to]| to - from);
        // Differences of nearly equal areas leave less than this of nothing.
        if area_m2 < 1e-9 * dx * dy { 0.0 } else { area_m2 }
    }

    /// Area that the rectangle from the axis to (x, y) has inside; negative where one of them is.
    fn corner_m2(&self, x: f64, y: f64) -> f64 {
        let r = self.radius_m;
        let [a, b] = [x, y].map(|side_m| side_m.abs().min(r));
        let whole_m2 = if a * a + b * b <= r * r {
            a * b
        } else {
            // As far as the rectangle's upper side is inside; from there on below the circle.
            let level_m = (r * r - b * b).max(0.0).sqrt();
            let below =
                |t: f64| 0.5 * (t * (r * r - t * t).max(0.0).sqrt() + r * r * libm::asin((t / r).min(1.0)));
            b * level_m + below(a) - below(level_m)
        };
        whole_m2 * x.signum() * y.signum()
    }
}

/// Uniform numbers strictly between 0 and 1.
struct Random(ChaCha8Rng);

impl Random {
    fn new(seed: u64) -> Self {
        let mut key = [0; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        Self(ChaCha8Rng::from_seed(key))
    }

    /// The middle of one of 2^52 equal parts of [0, 1], so that neither end is met.
    fn unit(&mut self) -> f64 {
        ((self.0.next_u64() >> 12) as f64 + 0.5) / (1u64 << 52) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_area_inside_a_column_is_that_of_fine_strips() {
        let column = Column { middle_m: [0.3, -0.2], radius_m: 0.5 };
        let strips = |[[x0, x1], [y0, y1]]: [[f64; 2]; 2]| {
            let parts = 20_000;
            let width = (x1 - x0) / f64::from(parts);
            (0..parts)
                .map(|part| {
                    let x = x0 + (f64::from(part) + 0.5) * width - column.middle_m[0];
                    let half = (0.25 - x * x).max(0.0).sqrt();
                    let [low, high] = [y0, y1].map(|y| (y - column.middle_m[1]).clamp(-half, half));
                    width * (high - low)
                })
                .sum::<f64>()
        };
        for sides in [
            [[0.2, 0.4], [-0.3, 0.1]],
            [[0.6, 0.9], [-0.2, 0.3]],
            [[-0.3, 0.3], [-0.8, -0.5]],
            [[-0.4, 1.0], [-0.9, 0.5]],
            [[0.79, 0.9], [-0.25, -0.1]],
            [[0.75, 0.9], [0.2, 0.3]],
            [[0.3, 0.8], [-0.2, 0.3]],
        ] {
            let (found, wanted) = (column.area_m2(sides), strips(sides));
            assert!((found - wanted).abs() < 2e-6, "{sides:?}: {found} {wanted}");
        }
        assert!(column.area_m2([[0.7, 0.8], [0.2, 0.3]]) <= 0.0);
    }
}
