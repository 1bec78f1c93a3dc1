//! What a program for an arm's controller makes around the motion, in words and as JSON.

use powderline_shared::arm::Joints;
use powderline_simulator::{
    arm::{Clearance, Transit},
    scene::TurnBack,
};
use powderline_view::motion::urscript;
use serde::Serialize;

/// What a program makes around the motion, and how.
pub(super) struct Program {
    pub transit: Transit,
    pub payload_kg: Option<f64>,
    pub speed: f64,
    /// Otherwise nobody has looked what the tool may run into.
    pub knows_scene: bool,
}

impl Program {
    /// Sentences on the ways to the start and back.
    pub(super) fn text(&self) -> String {
        let Transit { height_m, turn_back, home, nearest, .. } = &self.transit;
        let Clearance { link, obstacle, distance_m, .. } = nearest;
        let from = if home.is_some() { "at its home" } else { "above the start" };
        let turned = match turn_back {
            TurnBack::Target => "target",
            TurnBack::Source => "source",
        };
        let looked = if self.knows_scene {
            String::new()
        } else {
            " Without the plan's scene nobody has looked what the tool may run into there: --scene names it."
                .into()
        };
        let speed = if self.speed < 1.0 {
            format!(
                " It goes at {} % of full speed; powder behaves as planned at full speed only.",
                urscript::percent(self.speed)
            )
        } else {
            String::new()
        };
        format!(
            "The program begins and ends {from}, goes across with the tool {:.0} mm high and turns it back above the {turned}; on these \
             ways its {} comes nearest to anything, {:.0} mm from {obstacle}.{looked}{speed}\n",
            1e3 * height_m,
            link.name(),
            1e3 * distance_m
        )
    }
}

/// The ways to the start and back.
#[derive(Debug, Serialize)]
pub(super) struct TransitUse {
    /// Share of full speed.
    speed: f64,
    payload_kg: Option<f64>,
    /// Otherwise nobody has looked what the tool may run into.
    knows_scene: bool,
    height_m: f64,
    turn_back_above: TurnBack,
    begin_rad: Joints,
    /// The link that comes nearest to anything on these ways, to what, and how near.
    link: &'static str,
    obstacle: String,
    distance_m: f64,
}

impl From<&Program> for TransitUse {
    fn from(program: &Program) -> Self {
        let transit = &program.transit;
        Self {
            speed: program.speed,
            payload_kg: program.payload_kg,
            knows_scene: program.knows_scene,
            height_m: transit.height_m,
            turn_back_above: transit.turn_back,
            begin_rad: *transit.begin(),
            link: transit.nearest.link.name(),
            obstacle: transit.nearest.obstacle.to_string(),
            distance_m: transit.nearest.distance_m,
        }
    }
}
