//! Gates: walls that are there until they open.

use serde::{Deserialize, Serialize};

/// Most gates of one scene.
pub const MAX_GATES: usize = 16;

/// A time so little before a gate's own counts as that: times are sums of rounded steps, s.
const SLACK_S: f64 = 1e-9;

/// A wall that is there until it opens, by time alone: a pipe around a column of powder, a slide
/// below a hopper, a lock. It is shut while the powder settles. Shut it may touch or overlap
/// containers and other gates, but neither the powder nor the tool; where it goes when it opens,
/// nobody asks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gate {
    /// Name, 1 to 64 printable characters, unique among the gates.
    pub name: String,
    /// Centre of its lower side while it is shut, metres, world frame: a gate that stands on a
    /// container's inner floor has that floor's z.
    pub position_m: [f64; 3],
    /// Rotation about the vertical, degrees, counter-clockwise from above; -360 to 360.
    pub yaw_deg: f64,
    /// Coulomb friction, dimensionless; 0 to 2, typically 0.4.
    pub friction: f64,
    /// When it opens, seconds after the motion's start; 0 to 10,000. Beyond the motion's end it
    /// stays shut.
    pub opens_at_s: f64,
    /// Shape and dimensions.
    pub shape: GateShape,
    /// How it opens.
    pub opening: GateOpening,
}

/// Shape of a gate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum GateShape {
    /// A solid plate or block.
    Box {
        /// Length (x), width (y) and height (z) in the gate's own frame, metres; each half a cell
        /// to 10.
        size_m: [f64; 3],
    },
    /// An upright round pipe, open below and above.
    Tube {
        /// Inner radius, metres; one cell to 10.
        inner_radius_m: f64,
        /// Height, metres; one cell to 10.
        height_m: f64,
        /// Thickness of its wall, metres; half a cell to 1, typically one cell.
        wall_thickness_m: f64,
    },
}

/// How a gate opens.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum GateOpening {
    /// From one substep to the next it is no longer there.
    // With braces: serde lets a unit take any keys besides its `kind`.
    Vanish {},
    /// It moves at a constant velocity, and then stays where it has come to.
    Slide {
        /// Velocity, m/s, world frame; each -10 to 10, not all 0, together at most half a cell in
        /// a substep.
        velocity_m_s: [f64; 3],
        /// How far it moves, metres; above 0, up to 10.
        travel_m: f64,
    },
}

impl GateShape {
    /// Height, metres.
    pub fn height_m(&self) -> f64 {
        match *self {
            Self::Box { size_m } => size_m[2],
            Self::Tube { height_m, .. } => height_m,
        }
    }

    /// The thinnest wall, metres.
    pub(crate) fn least_thickness_m(&self) -> f64 {
        match *self {
            Self::Box { size_m: [x, y, z] } => x.min(y).min(z),
            Self::Tube { wall_thickness_m, height_m, .. } => wall_thickness_m.min(height_m),
        }
    }
}

impl GateOpening {
    /// How fast a gate moves, m/s; 0 for one that does not.
    pub(crate) fn speed_m_s(&self) -> f64 {
        match *self {
            Self::Vanish {} => 0.0,
            Self::Slide { velocity_m_s: [x, y, z], .. } => (x * x + y * y + z * z).sqrt(),
        }
    }
}

impl Gate {
    /// Whether it moves so long after the motion's start, seconds.
    pub(crate) fn is_sliding(&self, time_s: f64) -> bool {
        match self.opening {
            GateOpening::Vanish {} => false,
            GateOpening::Slide { travel_m, .. } => {
                let open_s = time_s - self.opens_at_s;
                open_s > 0.0 && open_s + SLACK_S < travel_m / self.opening.speed_m_s()
            }
        }
    }

    /// How far it is from its shut place so long after the motion's start, metres, world frame;
    /// none if it is no longer there. Before the motion it is shut.
    pub fn displacement_m(&self, time_s: f64) -> Option<[f64; 3]> {
        let open_s = time_s - self.opens_at_s;
        match self.opening {
            GateOpening::Vanish {} => (open_s < -SLACK_S).then_some([0.0; 3]),
            GateOpening::Slide { velocity_m_s, travel_m } => {
                let moving_s = open_s.clamp(0.0, travel_m / self.opening.speed_m_s());
                Some(velocity_m_s.map(|along_m_s| along_m_s * moving_s))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gate(opening: GateOpening) -> Gate {
        Gate {
            name: "lid".into(),
            position_m: [0.1, 0.2, 0.3],
            yaw_deg: 30.0,
            friction: 0.4,
            opens_at_s: 0.3,
            shape: GateShape::Box { size_m: [0.1, 0.1, 0.004] },
            opening,
        }
    }

    #[test]
    fn a_gate_is_there_until_the_moment_it_vanishes() {
        let gate = gate(GateOpening::Vanish {});
        let there = |time_s: f64| gate.displacement_m(time_s).is_some();
        assert!(there(-1.0) && there(0.0) && there(0.2999));
        // Three steps of 0.1 s are a little more than 0.3 s, 600 of 0.5 ms may be a little less.
        assert!(!there(0.3) && !there(3.0 * 0.1) && !there(0.3f64.next_down()) && !there(1e9));
    }

    #[test]
    fn a_gate_slides_at_its_velocity_and_stays_where_it_has_come_to() {
        let gate = gate(GateOpening::Slide { velocity_m_s: [0.03, 0.0, -0.04], travel_m: 0.1 });
        assert_eq!(gate.displacement_m(0.3), Some([0.0; 3]));
        let near = |time_s: f64, wanted: [f64; 3]| {
            let found = gate.displacement_m(time_s).unwrap();
            assert!((0..3).all(|axis| (found[axis] - wanted[axis]).abs() < 1e-12), "{found:?}");
        };
        near(1.3, [0.03, 0.0, -0.04]);
        near(2.3, [0.06, 0.0, -0.08]);
        near(99.0, [0.06, 0.0, -0.08]);
    }
}
