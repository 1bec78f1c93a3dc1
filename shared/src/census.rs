//! Where the powder of a bench is when a motion is over.

use core::fmt;

use serde::{Deserialize, Serialize};

use crate::mass::Mass;

/// A number for each place that a grain can end in. There is no seventh place: the six add up to all there is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Places<T> {
    /// In the container that it came from, heaps above its rim included, or in another one that is not the target.
    pub source: T,
    /// In the target container, below its rim.
    pub target: T,
    /// On the wall of a container, or heaped above the rim of the target: lost when somebody carries it away.
    pub rims: T,
    /// On the tool.
    pub tool: T,
    /// At rest anywhere else.
    pub spilled: T,
    /// In no container, not on the tool and not at rest.
    pub in_flight: T,
}

/// Particles in each place.
pub type Census = Places<u32>;

impl<T: Copy> Places<T> {
    /// Each place under the name that files and messages have for it.
    #[must_use]
    pub const fn named(&self) -> [(&'static str, T); 6] {
        let Self { source, target, rims, tool, spilled, in_flight } = *self;
        [
            ("source", source),
            ("target", target),
            ("rims", rims),
            ("tool", tool),
            ("spilled", spilled),
            ("in_flight", in_flight),
        ]
    }

    /// Each number turned into another one.
    pub fn map<R>(&self, f: impl Fn(T) -> R) -> Places<R> {
        Places {
            source: f(self.source),
            target: f(self.target),
            rims: f(self.rims),
            tool: f(self.tool),
            spilled: f(self.spilled),
            in_flight: f(self.in_flight),
        }
    }
}

impl Census {
    /// All particles.
    #[must_use]
    pub const fn all(&self) -> u32 {
        let kept = self.source.saturating_add(self.target).saturating_add(self.tool);
        kept.saturating_add(self.lost())
    }

    /// Those that nobody can use any more: on rims, spilled, in flight.
    #[must_use]
    pub const fn lost(&self) -> u32 {
        self.rims.saturating_add(self.spilled).saturating_add(self.in_flight)
    }

    /// What did not arrive, in words; particles of `particle_mass_kg` each.
    #[must_use]
    pub const fn rest(&self, particle_mass_kg: f64) -> Rest {
        Rest { census: *self, particle_mass_kg }
    }
}

/// Where the powder is that did not arrive, such as `56.7 mg are lost: 40.5 mg on rims, 16.2 mg spilled; 8 mg stay on the tool,
/// 12.29 g in the source`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rest {
    census: Census,
    particle_mass_kg: f64,
}

impl fmt::Display for Rest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Census { source, rims, tool, spilled, in_flight, .. } = self.census;
        let mass = |particles: u32| Mass(f64::from(particles) * self.particle_mass_kg);
        let lost = [(rims, "on rims"), (spilled, "spilled"), (in_flight, "in flight")];
        let kept = [(tool, "on the tool"), (source, "in the source")];
        let all = self.census.lost();
        match all {
            0 => f.write_str("nothing is lost")?,
            _ => write!(f, "{} are lost", mass(all))?,
        }
        let mut separator = ": ";
        for (particles, place) in lost.into_iter().filter(|(particles, _)| *particles > 0) {
            if particles == all {
                write!(f, ", all {place}")?;
            } else {
                write!(f, "{separator}{} {place}", mass(particles))?;
            }
            separator = ", ";
        }
        let mut separator = "; ";
        let mut verb = "stay ";
        for (particles, place) in kept.into_iter().filter(|(particles, _)| *particles > 0) {
            write!(f, "{separator}{} {verb}{place}", mass(particles))?;
            (separator, verb) = (", ", "");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    const CENSUS: Census = Census { source: 1536, target: 75, rims: 5, tool: 1, spilled: 2, in_flight: 0 };

    #[test]
    fn six_places_add_up() {
        assert_eq!((CENSUS.all(), CENSUS.lost()), (1619, 7));
        assert_eq!(CENSUS.named().map(|(_, particles)| particles).iter().sum::<u32>(), CENSUS.all());
        let doubled = CENSUS.map(|particles| 2 * particles);
        assert_eq!((doubled.source, doubled.in_flight, doubled.all()), (3072, 0, 3238));
        let most = Census { source: u32::MAX, ..CENSUS };
        assert_eq!(most.all(), u32::MAX);
    }

    #[test]
    fn the_rest_is_said_place_by_place() {
        let said = |census: Census| census.rest(8e-6).to_string();
        assert_eq!(
            said(CENSUS),
            "56 mg are lost: 40 mg on rims, 16 mg spilled; 8 mg stay on the tool, 12.29 g in the source"
        );
        assert_eq!(
            said(Census { rims: 0, tool: 0, in_flight: 1, spilled: 0, ..CENSUS }),
            "8 mg are lost, all in flight; 12.29 g stay in the source"
        );
        assert_eq!(said(Census { target: 9, ..Census::default() }), "nothing is lost");
    }
}
