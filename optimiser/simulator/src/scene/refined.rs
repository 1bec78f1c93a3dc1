//! A copy of a scene on smaller cells, to see what a motion brings there.
//!
//! What a cell hides is what a tool's wall and a heap's edge do within it: the same skill of `bench` brings up to a sixth less on cells
//! of half the size. A finer grid is no truth either, but it says how far an amount is to be believed.

use super::{Observation, Quantity, Scene, SceneError, SceneSpec};

impl Scene {
    /// The same bench on cells that are smaller by `by`, with as many particles in each and substeps shorter by as much, for a sound
    /// wave crosses no more of a cell in one then. It holds `by`³ times the particles, and a rollout takes `by`⁴ times the time.
    ///
    /// # Errors
    /// The grid or the powder would have more than is allowed.
    pub fn refined(&self, by: u32) -> Result<Self, SceneError> {
        self.with(|spec| spec.refine(by))
    }
}

impl SceneSpec {
    fn refine(&mut self, by: u32) {
        let before_kg = self.particle_mass_kg();
        self.domain.cell_m /= f64::from(by);
        self.time.substeps = self.time.substeps.saturating_mul(by);
        let lighter = before_kg / self.particle_mass_kg();
        if let Quantity::Particles(particles) = self.objective.amount.wanted {
            self.objective.amount.wanted = Quantity::MassKg(f64::from(particles) * before_kg);
        }
        if let Observation::Subsample { particles } = &mut self.objective.observation {
            *particles = libm::round(f64::from(*particles) * lighter) as u32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Amount;

    #[test]
    fn finer_cells_hold_the_same_powder_and_want_the_same() {
        for name in ["bench", "bench-small", "vial"] {
            let scene = Scene::load(name).unwrap();
            let counted = scene.with(|spec| {
                spec.objective.amount = Amount::new(Quantity::Particles(200));
                spec.objective.observation = Observation::Subsample { particles: 100 };
            });
            for (scene, seen) in [(scene.clone(), None), (counted.unwrap(), Some(800))] {
                let fine = scene.refined(2).unwrap();
                assert!((fine.domain.cell_m - 0.5 * scene.domain.cell_m).abs() < 1e-15, "{name}");
                assert_eq!(fine.time.substeps, 2 * scene.time.substeps);
                assert!((fine.target_mass_kg() - scene.target_mass_kg()).abs() < 1e-12, "{name}");
                assert!((fine.powder.fill_size_m()[2] - scene.powder.fill_size_m()[2]).abs() < 1e-15);
                let heavier = scene.particle_mass_kg() / fine.particle_mass_kg();
                assert!((heavier - 8.0).abs() < 1e-9, "{name}: {heavier}");
                if let Some(seen) = seen {
                    assert_eq!(fine.objective.observation, Observation::Subsample { particles: seen });
                }
            }
        }
    }

    #[test]
    fn cells_that_would_be_too_many_are_refused_with_what_would_be_right() {
        let error = Scene::load("workcell").unwrap().refined(2).unwrap_err().to_string();
        assert!(error.contains("domain.cell_m is 0.0015") && error.contains("would be right"), "{error}");
        assert!(Scene::load("bench").unwrap().refined(u32::MAX).is_err());
    }
}
