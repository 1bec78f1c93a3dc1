//! What an arm has to do to make a motion, in words and as JSON.

use powderline_shared::{limits::PeakUse, plan::Mounting};
use powderline_simulator::arm::{ArmMotion, Clearance, Figures};
use powderline_view::motion::table;
use serde::Serialize;

/// How near the arm comes to what is around it.
pub(super) fn clearance_words(figures: &Figures) -> String {
    let nearest = figures.nearest();
    let Clearance { link, obstacle, distance_m, time_s } = nearest;
    let link = link.name();
    if *distance_m < 0.0 {
        return format!(
            "Warning: its {link} would {nearest} at {time_s:.2} s. --table, or [arm] in the scene, finds a motion without that, or \
             refuses."
        );
    }
    format!(
        "Its {link} comes nearest to anything: {:.0} mm from {obstacle} at {time_s:.2} s.",
        1e3 * distance_m
    )
}

/// The arm, and what it has to do.
#[derive(Debug, Serialize)]
pub(super) struct ArmUse {
    #[serde(flatten)]
    arm: table::Arm,
    /// The joint that comes nearest to its speed, from 1.
    fastest_joint: usize,
    speed_rad_s: f64,
    /// The joint nearest to a singularity, from 1, and how far from it: 1 is best.
    singular_joint: u8,
    singularity_margin: f64,
    /// Shares of the plan's limits.
    limit_use: PeakUse,
    /// How near each link comes to what is around it.
    clearances: Vec<ClearanceUse>,
}

/// How near a link comes.
#[derive(Clone, Debug, Serialize)]
struct ClearanceUse {
    link: &'static str,
    /// What it comes near to.
    obstacle: String,
    distance_m: f64,
    time_s: f64,
}

impl From<&Clearance> for ClearanceUse {
    fn from(clearance: &Clearance) -> Self {
        Self {
            link: clearance.link.name(),
            obstacle: clearance.obstacle.to_string(),
            distance_m: clearance.distance_m,
            time_s: clearance.time_s,
        }
    }
}

impl From<&ArmMotion> for ArmUse {
    fn from(arm: &ArmMotion) -> Self {
        let Figures { fastest_joint, speed_rad_s, singular_joint, margin, limit_use, clearances, .. } =
            &arm.figures;
        Self {
            arm: table::Arm::from(&Mounting::from(&arm.model)),
            fastest_joint: *fastest_joint,
            speed_rad_s: *speed_rad_s,
            singular_joint: *singular_joint,
            singularity_margin: *margin,
            limit_use: *limit_use,
            clearances: clearances.iter().map(ClearanceUse::from).collect(),
        }
    }
}
