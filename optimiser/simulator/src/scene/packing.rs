//! The powder's initial particle positions: jittered stratified sampling of the fill box.
//!
//! The box is divided into a regular lattice of sub-cells no larger than a particle's own cube, of edge
//! cell / cbrt(particles_per_cell), and N of them (N as [`Scene::particle_count`] says) hold one particle each,
//! uniformly placed within. Where the box is a whole number of such cubes along every axis, as in the shipped
//! scenes, every sub-cell holds one. Otherwise the sub-cells are a little smaller and the few that stay empty are
//! chosen at random, every choice being equally likely.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::Scene;

impl Scene {
    /// Particles in the scene: volume of the fill box over the volume of a particle, rounded.
    pub fn particle_count(&self) -> usize {
        let fill_volume_m3: f64 = self.powder.fill_size_m().iter().product();
        let count = (fill_volume_m3 / self.particle_volume_m3()).round() as usize;
        count.min(Lattice::new(self).len())
    }

    /// Initial particle positions, metres, world frame, all inside the fill box.
    ///
    /// Order: by sub-cell, x running fastest, then y, then z. The numbers come from ChaCha8, whose 32-byte key is
    /// `seed` in little-endian followed by zeros, and depend on nothing else. A scene's own seed is `powder.seed`.
    pub fn particle_positions_m(&self, seed: u64) -> Vec<[f64; 3]> {
        let mut random = Random::new(seed);
        let lattice = Lattice::new(self);
        let mut wanted = self.particle_count();
        let mut positions = Vec::with_capacity(wanted);
        let total = lattice.len();
        for index in 0..total {
            // Selection sampling (Knuth, algorithm S): exactly `wanted` of what is left.
            let left = total - index;
            if wanted == left || random.unit() * (left as f64) < wanted as f64 {
                positions.push(lattice.jittered(index, &mut random));
                wanted -= 1;
            }
            if wanted == 0 {
                break;
            }
        }
        positions
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

    fn jittered(&self, index: usize, random: &mut Random) -> [f64; 3] {
        let [nx, ny, _] = self.counts;
        let cell = [index % nx, index / nx % ny, index / (nx * ny)];
        std::array::from_fn(|axis| {
            let place_m = self.min_m[axis] + (cell[axis] as f64 + random.unit()) * self.edges_m[axis];
            // The sum may round to just beyond the far side.
            place_m.min(self.max_m[axis])
        })
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
