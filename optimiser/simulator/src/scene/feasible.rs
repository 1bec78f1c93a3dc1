//! What no motion within the bounds can do: found out before anything is simulated.

use super::figures::{about, mass};
use super::solid::Vec3;
use super::{Aim, Scene, ToolShape};
use thiserror::Error;

/// Values of the transport displacement, and of the pitch, that stand for their ranges.
const TRANSPORTS: u32 = 128;
const ANGLES: u32 = 32;

/// Why the wanted amount cannot arrive, and what would be right.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum Infeasible {
    /// More than one spoonful.
    #[error(
        "objective.amount is {}, but the tool carries at most about {} heaped; {trips} trips of {} each would be right \
         (amount = {{ mass_kg = {} }}, the bed smoothed between them), or a larger tool",
        mass(*wanted_kg), mass(*heaped_kg), mass(*wanted_kg / f64::from(*trips)), about(wanted_kg / f64::from(*trips), 4)
    )]
    TooMuch {
        /// What is wanted.
        wanted_kg: f64,
        /// What the tool carries, heaped.
        heaped_kg: f64,
        /// In how many equal parts it could be brought.
        trips: u32,
    },
    /// The lip never comes over the target.
    #[error(
        "objective.target {target:?} is out of reach: within the bounds the tool's lip comes no nearer to its opening than {} mm; \
         {}",
        about(1e3 * gap_m, 2), remedy(*aside_m, *wanted_m, *bounds_m)
    )]
    OutOfReach {
        /// The target container.
        target: String,
        /// Horizontal distance that is missing, metres.
        gap_m: f64,
        /// How far the tool passes beside the middle of the target, metres.
        aside_m: f64,
        /// The transport displacement that would bring the lip over the middle of the target, metres.
        wanted_m: f64,
        /// Bounds of the transport displacement, metres.
        bounds_m: [f64; 2],
    },
}

fn remedy(aside_m: f64, wanted_m: f64, [low_m, high_m]: [f64; 2]) -> String {
    if (low_m..=high_m).contains(&wanted_m) || wanted_m <= 0.0 {
        return format!(
            "the way along skill.heading_deg passes {} mm beside its middle, another heading would be right",
            about(1e3 * aside_m.abs(), 2)
        );
    }
    format!(
        "skill.transport_displacement_m goes from {} to {}, and one that holds {} would be right",
        about(low_m, 3),
        about(high_m, 3),
        about(wanted_m, 2)
    )
}

impl Scene {
    /// Whether some motion within the bounds could bring the wanted amount, as far as geometry tells.
    ///
    /// # Errors
    /// What stands against it.
    pub fn check_feasible(&self) -> Result<(), Infeasible> {
        self.check_reach()?;
        if self.objective.aim == Aim::Amount { self.check_capacity() } else { Ok(()) }
    }

    fn check_capacity(&self) -> Result<(), Infeasible> {
        let (wanted_kg, heaped_kg) = (self.target_mass_kg(), self.tool_capacity().heaped_kg);
        if wanted_kg <= heaped_kg {
            return Ok(());
        }
        // A spoon is not filled to its last grain.
        let trips = (wanted_kg / (0.9 * heaped_kg)).ceil().max(2.0) as u32;
        Err(Infeasible::TooMuch { wanted_kg, heaped_kg, trips })
    }

    /// The lip at the end of the pour, and what of the tool lies behind it, against the opening of the target.
    fn check_reach(&self) -> Result<(), Infeasible> {
        let target = self.target();
        let bounds_m = self.skill.transport_displacement_m;
        let mut nearest = (f64::INFINITY, 0.0);
        for transport_m in spread(bounds_m, TRANSPORTS) {
            let origin = self.origin_after(self.skill.sweep_m + transport_m, 0.0);
            for ahead_m in self.lips_ahead_m() {
                let gap_m = target.gap_to_opening_m(self.ahead_of(origin, ahead_m));
                nearest = if gap_m < nearest.0 { (gap_m, ahead_m) } else { nearest };
            }
        }
        let (gap_m, ahead_m) = nearest;
        if gap_m <= 0.0 {
            return Ok(());
        }
        let (along_m, aside_m) = self.seen_from_start_m(target.position_m);
        Err(Infeasible::OutOfReach {
            target: target.name.clone(),
            gap_m,
            aside_m,
            wanted_m: along_m - self.skill.sweep_m - ahead_m,
            bounds_m,
        })
    }

    /// Distances ahead of the tool's origin at which powder may leave it: of the lip, at pitches a pour goes through, and 0.
    fn lips_ahead_m(&self) -> Vec<f64> {
        let lip = |forward: Vec3| match &self.tool.shape {
            ToolShape::Bowl { inner_radius_m } => inner_radius_m * forward[0],
            ToolShape::BoxScoop { inner_size_m: [length, _, height] } => {
                0.5 * length * forward[0] - height * forward[2]
            }
            ToolShape::Cuboids { .. } => self.tool.body_support(forward),
        };
        let [carried_deg, poured_deg] = self.carried_to_poured_deg();
        let ahead = |pitch_deg: f64| {
            let (sin, cos) = libm::sincos(pitch_deg.to_radians());
            lip([cos, 0.0, sin])
        };
        spread([carried_deg, poured_deg], ANGLES).map(ahead).chain([0.0]).collect()
    }

    /// From the furthest back that the tool leans while it carries to the furthest forward that it pours, degrees.
    fn carried_to_poured_deg(&self) -> [f64; 2] {
        let (start_deg, skill) = (self.tool.start_pitch_deg, &self.skill);
        [
            start_deg - skill.scooping_angle_deg[1],
            start_deg - skill.scooping_angle_deg[0] + skill.pouring_angle_deg[1],
        ]
    }

    fn ahead_of(&self, [x, y, z]: Vec3, ahead_m: f64) -> Vec3 {
        let (sin, cos) = libm::sincos(self.skill.heading_deg.to_radians());
        [x + ahead_m * cos, y + ahead_m * sin, z]
    }

    /// Where a point lies from the tool's start: along the heading and to its left, metres.
    fn seen_from_start_m(&self, point: Vec3) -> (f64, f64) {
        let (sin, cos) = libm::sincos(self.skill.heading_deg.to_radians());
        let [dx, dy] = [0, 1].map(|axis| point[axis] - self.tool.start_position_m[axis]);
        (dx * cos + dy * sin, dy * cos - dx * sin)
    }
}

fn spread([low, high]: [f64; 2], parts: u32) -> impl Iterator<Item = f64> {
    (0..=parts).map(move |part| low + f64::from(part) / f64::from(parts) * (high - low))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Amount, EMBEDDED_SCENES, Quantity};

    #[test]
    fn the_shipped_scenes_are_feasible() {
        for (name, _) in EMBEDDED_SCENES {
            assert_eq!(Scene::load(name).unwrap().check_feasible(), Ok(()), "{name}");
        }
    }

    #[test]
    fn more_than_a_spoonful_is_split() {
        let mut scene = Scene::load("bench").unwrap();
        scene.objective.amount = Amount::new(Quantity::MassKg(0.030));
        let error = scene.check_feasible().unwrap_err();
        assert!(matches!(error, Infeasible::TooMuch { trips: 3, .. }), "{error:?}");
        let text = error.to_string();
        assert!(
            text.starts_with("objective.amount is 30 g, but the tool carries at most about 11."),
            "{text}"
        );
        assert!(text.contains("3 trips of 10 g each") && text.contains("{ mass_kg = 0.01 }"), "{text}");
        // Each part is feasible, and so is as much as can be had.
        scene.objective.amount = Amount::new(Quantity::MassKg(0.010));
        assert_eq!(scene.check_feasible(), Ok(()));
        scene.objective.amount = Amount::new(Quantity::MassKg(0.030));
        scene.objective.aim = Aim::All;
        assert_eq!(scene.check_feasible(), Ok(()));
    }

    #[test]
    fn a_target_that_no_transport_reaches_is_said_with_one_that_would() {
        let mut scene = Scene::load("bench").unwrap();
        scene.skill.transport_displacement_m = [0.020, 0.040];
        let text = scene.check_feasible().unwrap_err().to_string();
        assert!(
            text.starts_with("objective.target \"target\" is out of reach") && text.contains("0.02 to 0.04"),
            "{text}"
        );
        let wanted: f64 =
            text.split("one that holds ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
        scene.skill.transport_displacement_m = [0.020, wanted];
        assert_eq!(scene.check_feasible(), Ok(()));
        scene.skill.transport_displacement_m = [0.060, 0.160];
        scene.skill.heading_deg = 60.0;
        let text = scene.check_feasible().unwrap_err().to_string();
        assert!(text.contains("another heading would be right"), "{text}");
    }
}
