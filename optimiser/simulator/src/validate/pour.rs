//! A stream of powder that falls, layer by layer.

use crate::real::Real;
use crate::validate::case::{Halt, Meter};
use crate::validate::rig::{Rig, packed_cylinder};

/// A round stream, straight down.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stream {
    /// Middle of where it begins, m.
    pub(super) from_m: [f64; 3],
    pub(super) radius_m: f64,
    /// Where it begins, m/s.
    pub(super) speed_m_s: f64,
    /// How much is poured, m^3.
    pub(super) volume_m3: f64,
}

impl Stream {
    /// How long it lasts, s.
    pub(super) fn seconds(&self) -> f64 {
        self.volume_m3 / (core::f64::consts::PI * self.radius_m * self.radius_m * self.speed_m_s)
    }

    /// Pours all of it; whatever is still falling has yet to come to rest.
    pub(super) fn pour<T: Real>(&self, rig: &mut Rig<T>, seed: u64, meter: &Meter<'_>) -> Result<(), Halt> {
        let scene = rig.scene().clone();
        let thickness = libm::cbrt(scene.particle_volume_m3());
        let goal = rig.len() + (self.volume_m3 / scene.particle_volume_m3()).round() as usize;
        let mut layers = 0;
        while rig.len() < goal {
            let seed = seed << 32 | layers;
            let layer = packed_cylinder(&scene, self.from_m, self.radius_m, thickness, seed);
            rig.insert(&layer, [0.0, 0.0, -self.speed_m_s])?;
            rig.run(thickness / self.speed_m_s, meter)?;
            layers += 1;
        }
        Ok(())
    }
}
