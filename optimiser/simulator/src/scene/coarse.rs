//! A copy of a scene that takes a fraction of the time, for a search to look around in.
//!
//! What it saves is particles and substeps, not cells: what a tool carries hangs by the cells that its walls are in. Of 24 skills of
//! `bench`, drawn within 0.6 of the middle, the amounts that arrive have a correlation of 0.98 with those of the scene itself at 0.30 of the processor time; with cells half as
//! large again it is 0.81 at 0.25, with cells twice as large 0.77 at 0.12. Of 14 skills of `vial` and `bench-small`: 0.997 and 0.976, cells half as large
//! again 0.84 and 0.93. The example `coarse_copy` measures it over the whole range.

use super::{Objective, Observation, Quantity, Scene, SceneSpec};

/// Particles in a cell of the copy.
const PARTICLES_PER_CELL: u32 = 2;

/// By how much softer its powder is, at the most. The substep goes by the root of that.
const MOST_SOFTER: f64 = 4.0;

/// Its Young's modulus over the pressure of the bed on its floor, at the least: the bed may sink by a tenth.
const LEAST_STIFFNESS: f64 = 10.0;

impl Scene {
    /// The same bench with two particles in a cell, and with powder up to four times as soft, for which longer substeps do. None if
    /// that saves nothing.
    #[must_use]
    pub fn coarse(&self) -> Option<Self> {
        let softer = (self.powder.youngs_modulus_pa / (LEAST_STIFFNESS * self.bed_pressure_pa()))
            .clamp(1.0, MOST_SOFTER);
        // Where viscosity forbids longer substeps, fewer particles are a coarser world still.
        [softer, 1.0].into_iter().find_map(|softer| {
            let coarse = self.with(|spec| spec.coarsen(softer)).ok()?;
            let work = |scene: &Self| scene.powder.particles_per_cell * scene.time.substeps;
            (work(&coarse) < work(self)).then_some(coarse)
        })
    }

    /// The pressure at the foot of the powder, pascal.
    fn bed_pressure_pa(&self) -> f64 {
        let [x, y, z] = self.domain.gravity_m_s2;
        self.powder.density_kg_m3 * libm::sqrt(x * x + y * y + z * z) * self.powder.fill_size_m()[2]
    }
}

impl SceneSpec {
    fn coarsen(&mut self, softer: f64) {
        let before_kg = self.particle_mass_kg();
        self.powder.particles_per_cell = self.powder.particles_per_cell.min(PARTICLES_PER_CELL);
        self.powder.youngs_modulus_pa /= softer;
        self.time.substeps = libm::ceil(f64::from(self.time.substeps) / libm::sqrt(softer)) as u32;
        let heavier = self.particle_mass_kg() / before_kg;
        let Objective { amount, observation, .. } = &mut self.objective;
        if let Quantity::Particles(particles) = amount.wanted {
            amount.wanted = Quantity::MassKg(f64::from(particles) * before_kg);
        }
        if let Observation::Subsample { particles } = observation {
            *particles = libm::round(f64::from(*particles) / heavier).max(1.0) as u32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Amount;

    #[test]
    fn the_copy_has_fewer_particles_and_substeps_and_wants_the_same() {
        for (name, substeps, softer) in [("bench", 10, 4.0), ("bench-small", 10, 4.0), ("vial", 15, 4.0)] {
            let scene = Scene::load(name).unwrap();
            let coarse = scene.coarse().unwrap();
            assert_eq!((coarse.powder.particles_per_cell, coarse.time.substeps), (2, substeps), "{name}");
            assert!(
                (scene.powder.youngs_modulus_pa / coarse.powder.youngs_modulus_pa - softer).abs() < 1e-9,
                "{name}"
            );
            assert!((coarse.target_mass_kg() - scene.target_mass_kg()).abs() < 1e-12, "{name}");
            assert_eq!(coarse.domain, scene.domain);
        }
    }

    #[test]
    fn the_bed_does_not_sink_by_more_than_a_tenth() {
        let deep = Scene::load("bench").unwrap().with(|spec| spec.powder.density_kg_m3 = 2500.0).unwrap();
        let coarse = deep.coarse().unwrap();
        assert!((coarse.powder.youngs_modulus_pa - LEAST_STIFFNESS * deep.bed_pressure_pa()).abs() < 1e-6);
        assert!((10..20).contains(&coarse.time.substeps));
    }

    #[test]
    fn particles_that_are_wanted_or_seen_are_as_much_powder() {
        let scene = Scene::load("bench").unwrap();
        let counted = scene.with(|spec| {
            spec.objective.amount = Amount::new(Quantity::Particles(1200));
            spec.objective.observation = Observation::Subsample { particles: 1000 };
        });
        let (counted, coarse) = (counted.as_ref().unwrap(), counted.as_ref().unwrap().coarse().unwrap());
        assert!((coarse.target_mass_kg() - counted.target_mass_kg()).abs() < 1e-12);
        assert_eq!(coarse.objective.observation, Observation::Subsample { particles: 250 });
    }
}
