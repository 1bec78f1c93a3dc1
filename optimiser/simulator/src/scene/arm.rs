//! The arm of a bench: which one, where it stands, how it holds the tool.

use powderline_shared::arm::ArmKind;
use powderline_shared::arm::inverse::Posture;
use serde::{Deserialize, Serialize};

/// Rotations are roll, pitch and yaw in degrees, about the fixed x, y and z axes in turn.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Arm {
    /// Which arm.
    pub kind: ArmKind,
    /// Its base in the world, metres; -10 to 10.
    pub base_position_m: [f64; 3],
    /// Its base in the world, degrees; -360 to 360.
    pub base_rotation_deg: [f64; 3],
    /// Origin of the tool's frame in the flange's, metres; -1 to 1.
    pub tool_position_m: [f64; 3],
    /// The tool's frame in the flange's, degrees; -360 to 360.
    pub tool_rotation_deg: [f64; 3],
    /// How it has to reach; the best of the eight ways, by its margins over the whole motion, if the file does not say.
    #[serde(default)]
    pub posture: Option<PostureChoice>,
    /// Top of the table that arm and bench stand on, metres, world frame; -10 to 0. Where it is below the floor, z = 0, the
    /// simulated volume stands on a block as wide as itself.
    pub table_height_m: f64,
    /// What every link of the arm keeps from table, block, containers and gates, metres; 0 to 1, typically 0.02.
    pub clearance_m: f64,
    /// What hangs at the flange (bracket, handle, tool), kilograms, for the arm's own controller; 0 to what the arm carries. The
    /// controller keeps what it has been told if the file does not say.
    #[serde(default)]
    pub payload_kg: Option<f64>,
    /// Above what a program for the arm turns the tool back after the motion; the target if the file does not say.
    #[serde(default)]
    pub turn_back_above: Option<TurnBack>,
}

/// Where the tool, with what is left on it, is turned back after the motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TurnBack {
    /// Where the motion ends: what still falls, falls there.
    #[default]
    Target,
    /// Where the motion begins.
    Source,
}

/// One of the eight ways to reach a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PostureChoice {
    /// Where the arm reaches.
    pub shoulder: Shoulder,
    /// Where its elbow is.
    pub elbow: Elbow,
    /// Which way wrist 2 is turned.
    pub wrist: Wrist,
}

/// Where the arm reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Shoulder {
    /// Along its base's -x, as with all joints at zero.
    Forward,
    /// Backward, over its own base.
    Backward,
}

/// Where the elbow is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Elbow {
    /// Above the line from shoulder to wrist.
    Up,
    /// Below it.
    Down,
}

/// Which way wrist 2 (joint 5) is turned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Wrist {
    /// The sine of its angle is positive.
    Positive,
    /// The sine of its angle is negative.
    Negative,
}

impl From<PostureChoice> for Posture {
    fn from(choice: PostureChoice) -> Self {
        let reaches_forward = choice.shoulder == Shoulder::Forward;
        Self {
            reaches_forward,
            elbow_positive: (choice.elbow == Elbow::Up) == reaches_forward,
            wrist_positive: choice.wrist == Wrist::Positive,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_choice_is_the_posture_that_it_names() {
        let mut chosen = Vec::new();
        for shoulder in [Shoulder::Forward, Shoulder::Backward] {
            for elbow in [Elbow::Up, Elbow::Down] {
                for wrist in [Wrist::Positive, Wrist::Negative] {
                    let posture = Posture::from(PostureChoice { shoulder, elbow, wrist });
                    assert_eq!(posture.reaches_forward, shoulder == Shoulder::Forward);
                    assert_eq!(posture.elbow_is_up(), elbow == Elbow::Up);
                    assert_eq!(posture.wrist_positive, wrist == Wrist::Positive);
                    chosen.push(posture);
                }
            }
        }
        assert!(Posture::PREFERRED.iter().all(|posture| chosen.contains(posture)));
    }
}
