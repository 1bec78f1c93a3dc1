//! What no motion within the bounds can do: found out before anything is simulated.

use super::figures::{about, mass};
use super::solid::Vec3;
use super::{Aim, Scene};
use std::fmt;
use thiserror::Error;

/// Values of the transport displacement, and of the pitch, that stand for their ranges.
const TRANSPORTS: u32 = 128;
const ANGLES: u32 = 32;
/// A tool that carries less than this share of what it would if it did not lean leans too far.
const LEAST_OF_UPRIGHT: f64 = 0.05;
/// The shortest transport displacement that a scene may have, metres.
const LEAST_TRANSPORT_M: f64 = 0.001;

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
    /// At every pitch within the bounds nearly all slides off.
    #[error(
        "objective.amount is {}, but the tool carries hardly anything, {} at most: with skill.scooping_angle_deg = [{}, {}] it leans by {} \
         to {} degrees on its way, and powder stands up to {}; a larger skill.scooping_angle_deg would be right",
        mass(*wanted_kg), mass(*heaped_kg), about(scooping_angle_deg[0], 4), about(scooping_angle_deg[1], 4), about(pitch_deg[0], 4), about(pitch_deg[1], 4),
        about(*friction_angle_deg, 4)
    )]
    Leans {
        /// What is wanted.
        wanted_kg: f64,
        /// What the tool carries, heaped.
        heaped_kg: f64,
        /// The bounds of the skill.
        scooping_angle_deg: [f64; 2],
        /// Pitches of the tool while it carries.
        pitch_deg: [f64; 2],
        /// How steeply the powder stands.
        friction_angle_deg: f64,
    },
    /// The lip never comes over the target.
    #[error(
        "objective.target {target:?} is out of reach: within the bounds the tool's lip comes no nearer to its opening than {} mm; \
         {remedy}",
        about(1e3 * gap_m, 2)
    )]
    OutOfReach {
        /// The target container.
        target: String,
        /// Horizontal distance that is missing, metres.
        gap_m: f64,
        /// What would bring it there.
        remedy: Remedy,
    },
}

/// What would bring the lip over the target.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Remedy {
    /// The way leads over it, but ends before it or behind it.
    Transport {
        /// The transport displacement that would end over its middle, metres.
        wanted_m: f64,
        /// Bounds of the transport displacement, metres.
        bounds_m: [f64; 2],
    },
    /// The way leads past it.
    Heading {
        /// That of the way, degrees.
        now_deg: f64,
        /// How far beside the middle of the target it passes, metres.
        aside_m: f64,
        /// That from the start to the middle of the target, degrees.
        right_deg: f64,
        /// A transport displacement that would end there then, metres, if none within the bounds does.
        wanted_m: Option<f64>,
    },
    /// The way leads over it, but the sweep alone takes the tool beyond it.
    Farther,
}

impl fmt::Display for Remedy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Transport { wanted_m, bounds_m: [low_m, high_m] } => write!(
                f,
                "skill.transport_displacement_m goes from {} to {}, and one that holds {} would be right",
                about(low_m, 3),
                about(high_m, 3),
                about(wanted_m, 2)
            ),
            Self::Heading { now_deg, aside_m, right_deg, wanted_m } => {
                write!(
                    f,
                    "the way along skill.heading_deg = {} passes {} mm beside its middle; skill.heading_deg = {}",
                    about(now_deg, 4),
                    about(1e3 * aside_m.abs(), 2),
                    about(right_deg, 4)
                )?;
                if let Some(wanted_m) = wanted_m {
                    write!(f, " and a skill.transport_displacement_m that holds {}", about(wanted_m, 2))?;
                }
                f.write_str(" would be right, with source, tool.start_position_m and limits that leave room for it")
            }
            Self::Farther => f.write_str(
                "skill.sweep_m alone takes the tool beyond it; a start farther from the target would be right",
            ),
        }
    }
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
        if heaped_kg < LEAST_OF_UPRIGHT * self.heaped_upright_kg() {
            let (scooping_angle_deg, friction_angle_deg) =
                (self.skill.scooping_angle_deg, self.powder.friction_angle_deg);
            let pitch_deg = [1, 0].map(|end| self.tool.start_pitch_deg - scooping_angle_deg[end]);
            return Err(Infeasible::Leans {
                wanted_kg,
                heaped_kg,
                scooping_angle_deg,
                pitch_deg,
                friction_angle_deg,
            });
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
        Err(Infeasible::OutOfReach { target: target.name.clone(), gap_m, remedy: self.remedy(ahead_m) })
    }

    /// What would bring a lip that is so far ahead of the tool's origin over the target.
    fn remedy(&self, ahead_m: f64) -> Remedy {
        let (target, bounds_m) = (self.target(), self.skill.transport_displacement_m);
        let (along_m, aside_m) = self.seen_from_start_m(target.position_m);
        let transport_m = |distance_m: f64, ahead_m: f64| distance_m - self.skill.sweep_m - ahead_m;
        let passes_over = target.gap_to_opening_m(self.origin_after(along_m, 0.0)) <= 0.0;
        if passes_over && along_m > 0.0 {
            let wanted_m = transport_m(along_m, ahead_m);
            return if wanted_m >= LEAST_TRANSPORT_M {
                Remedy::Transport { wanted_m, bounds_m }
            } else {
                Remedy::Farther
            };
        }
        let distance_m = libm::hypot(along_m, aside_m);
        let [low_m, high_m] = bounds_m;
        let within = |ahead_m: &f64| (low_m..=high_m).contains(&transport_m(distance_m, *ahead_m));
        let lips_m = self.lips_ahead_m();
        let wanted_m = (!lips_m.iter().any(within)).then(|| transport_m(distance_m, 0.0));
        if wanted_m.is_some_and(|wanted_m| wanted_m < LEAST_TRANSPORT_M) {
            return Remedy::Farther;
        }
        let right_deg = self.skill.heading_deg + libm::atan2(aside_m, along_m).to_degrees();
        Remedy::Heading {
            now_deg: self.skill.heading_deg,
            aside_m,
            // As a person would write it.
            right_deg: (0.01 * (100.0 * right_deg).round()).rem_euclid(360.0),
            wanted_m,
        }
    }

    /// Distances ahead of the tool's origin at which powder may leave it: of the lip, at pitches a pour goes through, and 0.
    fn lips_ahead_m(&self) -> Vec<f64> {
        let [carried_deg, poured_deg] = self.carried_to_poured_deg();
        let ahead = |pitch_deg: f64| {
            let (sin, cos) = libm::sincos(pitch_deg.to_radians());
            self.tool.with_body(|body| body.lip_m([cos, 0.0, sin]))
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
    fn a_tool_that_leans_too_far_is_told_from_one_that_is_too_small() {
        let mut scene = Scene::load("bench").unwrap();
        scene.skill.scooping_angle_deg = [1.0, 5.0];
        scene.tool.start_pitch_deg = 105.0;
        let text = scene.check_feasible().unwrap_err().to_string();
        assert!(
            text.contains("it leans by 100 to 104 degrees")
                && text.contains("a larger skill.scooping_angle_deg"),
            "{text}"
        );
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
        assert!(
            text.contains("passes 110 mm beside its middle; skill.heading_deg = 0 would be right"),
            "{text}"
        );
    }

    /// Wherever the target stands, what is said to be right brings the lip over it.
    #[test]
    fn advice_about_the_way_helps() {
        let field = |text: &str, name: &str| -> Option<f64> {
            text.split_once(name)?.1.split([' ', ';']).next()?.parse().ok()
        };
        let mut kinds = [0; 3];
        for (turn_deg, distance_m) in
            (0..24).flat_map(|part| [0.012, 0.03, 0.08, 0.12, 0.3].map(|m| (15.0 * f64::from(part), m)))
        {
            let mut scene = Scene::load("bench").unwrap();
            scene.skill.heading_deg = 30.0;
            let (sin, cos) = libm::sincos(f64::to_radians(turn_deg));
            let [x, y, _] = scene.tool.start_position_m;
            let target = scene.containers.iter_mut().find(|one| one.name == "target").unwrap();
            target.position_m = [x + distance_m * cos, y + distance_m * sin, 0.004];
            target.shape =
                crate::scene::ContainerShape::Cylinder { inner_radius_m: 0.012, inner_height_m: 0.03 };
            let Err(error) = scene.check_feasible() else { continue };
            let Infeasible::OutOfReach { remedy, .. } = error else { panic!("{error:?}") };
            let text = error.to_string();
            match remedy {
                Remedy::Transport { .. } => kinds[0] += 1,
                Remedy::Heading { .. } => kinds[1] += 1,
                Remedy::Farther => {
                    kinds[2] += 1;
                    assert!(distance_m < 0.1, "{text}");
                    continue;
                }
            }
            if let Some(right_deg) = field(&text, "middle; skill.heading_deg = ") {
                scene.skill.heading_deg = right_deg;
            }
            if let Some(wanted_m) = field(&text, "that holds ") {
                scene.skill.transport_displacement_m = [wanted_m, wanted_m];
            }
            assert_eq!(scene.check_feasible(), Ok(()), "{turn_deg} {distance_m}: {text}");
        }
        assert!(kinds.iter().all(|count| *count > 0), "{kinds:?}");
    }
}
