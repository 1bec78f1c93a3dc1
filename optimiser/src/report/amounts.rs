//! Particles as the powder that they stand for: grams first, particles beside them.

use super::words::{capitalised, count};
use powderline_simulator::{
    rollout::Census,
    scene::{Aim, Scene, figures::mass},
};
use serde::Serialize;

/// What a scene wants, and what its particles weigh.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Amounts {
    /// Wanted in the target container, kilogram.
    pub wanted_kg: f64,
    /// The same as whole particles.
    pub wanted_particles: u32,
    /// Largest miss that counts as met, relative; none where as much as can be had is wanted.
    pub tolerance: Option<f64>,
    /// Mass of a particle, kilogram.
    pub particle_mass_kg: f64,
}

impl From<&Scene> for Amounts {
    fn from(scene: &Scene) -> Self {
        Self {
            wanted_kg: scene.target_mass_kg(),
            wanted_particles: scene.target_count() as u32,
            tolerance: (scene.objective.aim == Aim::Amount).then_some(scene.objective.amount.tolerance),
            particle_mass_kg: scene.particle_mass_kg(),
        }
    }
}

impl Amounts {
    /// The same where particles have another mass.
    pub fn in_particles_of(self, particle_mass_kg: f64) -> Self {
        let wanted_particles = ((self.wanted_kg / particle_mass_kg).round() as u32).max(1);
        Self { wanted_particles, particle_mass_kg, ..self }
    }

    /// Mass of so many particles, kilogram.
    pub fn kg(&self, particles: u32) -> f64 {
        f64::from(particles) * self.particle_mass_kg
    }

    /// How far so many particles are off the wanted mass, relative: negative where powder is missing.
    pub fn miss(&self, particles: u32) -> f64 {
        // To a billionth: what is off by as much on either side, or just within the tolerance, is not parted by rounding.
        ((self.kg(particles) / self.wanted_kg - 1.0) * 1e9).round() / 1e9
    }

    /// Whether so many particles are the wanted amount, within the tolerance; none where as much as can be had is wanted.
    pub fn is_met(&self, particles: u32) -> Option<bool> {
        self.tolerance.map(|tolerance| self.miss(particles).abs() <= tolerance * (1.0 + 1e-9))
    }

    /// Such as `9.584 g (1,198 particles)`.
    pub fn powder(&self, particles: u32) -> String {
        format!("{} ({})", mass(self.kg(particles)), counted(particles))
    }

    /// Such as `9.584 g`.
    pub fn mass(&self, particles: u32) -> String {
        mass(self.kg(particles))
    }

    /// Where the powder is that did not arrive, as a sentence.
    pub fn rest(&self, census: &Census) -> String {
        capitalised(&census.rest(self.particle_mass_kg).to_string()) + "."
    }

    /// What is wrong where one particle more or less decides.
    pub fn grains_too_large(&self) -> Option<String> {
        let grain = self.particle_mass_kg / self.wanted_kg;
        (grain > self.tolerance?).then(|| {
            format!(
                "one particle is {} of the wanted amount, more than the tolerance of {}; a larger powder.particles_per_cell or smaller \
                 cells would be right",
                percent(grain),
                self.tolerance()
            )
        })
    }

    /// Such as `9.6 g (1,200 particles)`.
    pub fn wanted(&self) -> String {
        format!("{} ({})", mass(self.wanted_kg), counted(self.wanted_particles))
    }

    /// Such as `0.17 % too little`; in as many digits as tell it from the tolerance where it is beyond that.
    pub fn off(&self, particles: u32) -> String {
        let miss = self.miss(particles);
        let beyond = self.tolerance.filter(|_| self.is_met(particles) == Some(false));
        match beyond.filter(|tolerance| percent(*tolerance) == percent(miss.abs())) {
            None => off(miss),
            Some(tolerance) => too_much_or_little(miss, &told_apart(miss.abs(), tolerance)),
        }
    }

    /// The tolerance, such as `2 %`.
    pub fn tolerance(&self) -> String {
        self.tolerance.map_or("none".into(), percent)
    }
}

/// Such as `1,198 particles`, `1 particle`.
pub fn counted(particles: u32) -> String {
    count(particles.into(), "particle")
}

/// A share in per cent: two digits below ten, whole numbers above.
pub fn percent(share: f64) -> String {
    let percent = 100.0 * share;
    let text = match percent.abs() {
        0.0..0.995 => format!("{percent:.2}"),
        0.995..9.95 => format!("{percent:.1}"),
        _ => format!("{percent:.0}"),
    };
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{} %", if text == "-0" { "0" } else { text })
}

/// How far something is off the wanted amount, such as `0.17 % too little`.
pub fn off(miss: f64) -> String {
    match percent(miss.abs()) {
        none if none == "0 %" => "no more and no less".into(),
        percent => too_much_or_little(miss, &percent),
    }
}

fn too_much_or_little(miss: f64, percent: &str) -> String {
    format!("{percent} too {}", if miss < 0.0 { "little" } else { "much" })
}

/// A share in per cent, in so few digits that it is not what another one is in as many.
fn told_apart(share: f64, other: f64) -> String {
    let [share, other] = [share, other].map(|share| move |digits| format!("{:.digits$} %", 100.0 * share));
    let digits = (2..9).find(|digits| share(*digits) != other(*digits));
    share(digits.unwrap_or(9))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powder_is_said_in_grams_and_particles() {
        let amounts = Amounts::from(&Scene::load("bench").unwrap());
        assert_eq!(amounts.powder(1198), "9.584 g (1,198 particles)");
        assert_eq!(amounts.powder(1), "8 mg (1 particle)");
        assert_eq!(amounts.wanted(), "9.6 g (1,200 particles)");
        assert_eq!(amounts.off(1198), "0.17 % too little");
        assert_eq!(amounts.off(1260), "5 % too much");
        assert_eq!(amounts.off(1200), "no more and no less");
        assert_eq!(amounts.off(0), "100 % too little");
        // Beyond a tolerance of 2 % it never reads like it.
        let mut many = Amounts { wanted_particles: 9_600, ..amounts };
        many.particle_mass_kg = many.wanted_kg / 9_600.0;
        assert_eq!(
            [192, 193, 195].map(|more| many.off(9_600 + more)),
            ["2 % too much", "2.01 % too much", "2.03 % too much"]
        );
        assert_eq!(many.off(9_600 - 193), "2.01 % too little");
        let met = |particles| amounts.is_met(particles);
        assert_eq!([1175, 1176, 1224, 1225].map(met), [Some(false), Some(true), Some(true), Some(false)]);
    }

    #[test]
    fn shares_have_two_digits() {
        let shown = [0.0, -1e-9, 0.00167, 0.02, 0.0251, 0.123, 1.0, 12.0].map(percent);
        assert_eq!(shown, ["0 %", "0 %", "0.17 %", "2 %", "2.5 %", "12 %", "100 %", "1200 %"]);
    }

    #[test]
    fn as_much_as_can_be_had_is_neither_met_nor_missed() {
        let scene = Scene::load("bench").unwrap().with(|spec| spec.objective.aim = Aim::All).unwrap();
        assert_eq!(Amounts::from(&scene).is_met(3), None);
    }
}
