//! How much powder is wanted, and how near to it is near enough.

use serde::{Deserialize, Serialize};

/// Tolerance of an amount that states none.
pub const DEFAULT_TOLERANCE: f64 = 0.02;

/// How much powder should arrive in the target container: `{ mass_kg = 0.001, tolerance = 0.02 }` or `{ particles = 125 }`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Table", into = "Table")]
pub struct Amount {
    /// The amount.
    pub wanted: Quantity,
    /// Largest miss that still counts as met, relative to the wanted amount; 0 to 1, 0.02 if it is not stated.
    pub tolerance: f64,
}

/// An amount of powder.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Quantity {
    /// Particles; 1 to all of them.
    Particles(u32),
    /// Mass, kilogram; above 0, up to all of it. Simulated as the nearest number of whole particles.
    MassKg(f64),
}

impl Amount {
    /// An amount with the usual tolerance.
    pub fn new(wanted: Quantity) -> Self {
        Self { wanted, tolerance: DEFAULT_TOLERANCE }
    }
}

/// An amount as a scene file has it.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    mass_kg: Option<f64>,
    particles: Option<u32>,
    tolerance: Option<f64>,
}

impl TryFrom<Table> for Amount {
    type Error = &'static str;

    fn try_from(table: Table) -> Result<Self, Self::Error> {
        let wanted = match (table.mass_kg, table.particles) {
            (Some(mass_kg), None) => Quantity::MassKg(mass_kg),
            (None, Some(particles)) => Quantity::Particles(particles),
            (None, None) => {
                return Err("neither `mass_kg` nor `particles` is given; one of them would be right");
            }
            (Some(_), Some(_)) => {
                return Err("both `mass_kg` and `particles` are given; one of them would be right");
            }
        };
        Ok(Self { wanted, tolerance: table.tolerance.unwrap_or(DEFAULT_TOLERANCE) })
    }
}

impl From<Amount> for Table {
    fn from(Amount { wanted, tolerance }: Amount) -> Self {
        let (mass_kg, particles) = match wanted {
            Quantity::MassKg(mass_kg) => (Some(mass_kg), None),
            Quantity::Particles(particles) => (None, Some(particles)),
        };
        Self { mass_kg, particles, tolerance: Some(tolerance) }
    }
}
