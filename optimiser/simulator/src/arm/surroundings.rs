//! What the links of an arm must stay clear of, and how near a link comes to it.
//!
//! A link is a capsule: every point within its radius of an axis, a straight line from one end to the other. Its distance from a
//! solid is the least signed distance along the axis, less the radius. A signed distance changes by at most a metre a metre, so a
//! part of the axis of length l with the distances f and g at its ends comes no nearer than (f + g - l) / 2: parts that cannot
//! come nearer than what is known are not looked into.

use crate::mpm::bodies::turned;
use crate::mpm::obstacle::{container_shapes, gate_shape};
use crate::scene::{Gate, Obstacle, Scene, Tool, ToolPart};
use crate::shape::{AlignedBox, HalfSpace, Shape};
use crate::small::tr_mul_vec;
use nalgebra::Vector3;

/// Distances are right to this, metres.
const EXACT_M: f64 = 1e-4;

/// A table, what stands on it, gates while they are there, and the tool that the arm itself holds.
#[derive(Clone, Debug)]
pub struct Surroundings {
    pieces: Vec<Piece>,
    /// In its own frame.
    tool: Vec<(ToolPart, Shape<f64>)>,
}

/// A convex piece, or a pipe.
#[derive(Clone, Debug)]
struct Piece {
    obstacle: Obstacle,
    shape: Shape<f64>,
    position_m: [f64; 3],
    /// From its own frame to the world.
    turn: [[f64; 3]; 3],
    /// The gate that it is, if it is one.
    gate: Option<Gate>,
}

/// How near something comes to one of the surroundings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Near<'a> {
    pub(super) obstacle: &'a Obstacle,
    pub(super) distance_m: f64,
}

impl Surroundings {
    /// A level table alone, whose top is at a height in the world, metres; nobody knows the tool.
    #[must_use]
    pub fn table(height_m: f64) -> Self {
        let table = Piece::at(Obstacle::Table, Shape::HalfSpace(HalfSpace), [0.0, 0.0, height_m]);
        Self { pieces: vec![table], tool: Vec::new() }
    }

    /// A table with a scene's containers and gates, and below its floor, down to the table, the stand that it needs.
    #[must_use]
    pub fn of_scene(scene: &Scene, table_m: f64) -> Self {
        let mut pieces = Self::table(table_m).pieces;
        if table_m < 0.0 {
            let [x, y, _] = scene.domain.size_m.map(|size_m| 0.5 * size_m);
            let stand = AlignedBox { centre: [x, y, 0.5 * table_m], half: [x, y, -0.5 * table_m] };
            pieces.push(Piece::at(Obstacle::Stand, Shape::AlignedBox(stand), [0.0; 3]));
        }
        for container in &scene.containers {
            let shapes = container_shapes(container).into_iter();
            pieces.extend(shapes.map(|shape| Piece {
                turn: turned(container.yaw_deg),
                ..Piece::at(Obstacle::Container(container.name.clone()), shape, container.position_m)
            }));
        }
        pieces.extend(scene.gates.iter().map(|gate| Piece {
            turn: turned(gate.yaw_deg),
            gate: Some(gate.clone()),
            ..Piece::at(Obstacle::Gate(gate.name.clone()), gate_shape(gate), gate.position_m)
        }));
        Self { pieces, tool: tool_solids(&scene.tool) }
    }

    /// The tool's parts, in its own frame.
    pub(super) fn tool(&self) -> &[(ToolPart, Shape<f64>)] {
        &self.tool
    }

    /// The same with gates that stay where they are so long after the motion's start.
    #[must_use]
    pub fn standing(&self, time_s: f64) -> Self {
        let stand = |piece: &Piece| {
            let moved_m = piece.displacement_m(time_s)?;
            let position_m = std::array::from_fn(|axis| piece.position_m[axis] + moved_m[axis]);
            Some(Piece { position_m, gate: None, ..piece.clone() })
        };
        Self { pieces: self.pieces.iter().filter_map(stand).collect(), tool: self.tool.clone() }
    }

    /// What a capsule comes nearest to, if that is nearer than `known_m`, so long after the motion's start. `axis` holds its ends.
    pub(super) fn nearest(
        &self,
        axis: [Vector3<f64>; 2],
        radius_m: f64,
        time_s: f64,
        known_m: f64,
    ) -> Option<Near<'_>> {
        let mut nearest: Option<Near<'_>> = None;
        for piece in &self.pieces {
            let known_m = nearest.map_or(known_m, |near| near.distance_m);
            let distance_m = piece.distance_m(axis, radius_m, time_s, known_m);
            if distance_m < known_m {
                nearest = Some(Near { obstacle: &piece.obstacle, distance_m });
            }
        }
        nearest
    }
}

/// The body's walls, then the handle.
fn tool_solids(tool: &Tool) -> Vec<(ToolPart, Shape<f64>)> {
    let solids = tool.solids();
    let last = solids.len() - 1;
    let named = |(k, solid)| (if k == last { ToolPart::Handle } else { ToolPart::Body }, solid);
    solids.into_iter().enumerate().map(named).collect()
}

impl Piece {
    fn at(obstacle: Obstacle, shape: Shape<f64>, position_m: [f64; 3]) -> Self {
        Self { obstacle, shape, position_m, turn: turned(0.0), gate: None }
    }

    /// How far it is from its place; none if it is gone.
    fn displacement_m(&self, time_s: f64) -> Option<[f64; 3]> {
        self.gate.as_ref().map_or(Some([0.0; 3]), |gate| gate.displacement_m(time_s))
    }

    /// From the capsule to the piece, or `known_m` where it is not nearer than that.
    fn distance_m(&self, axis: [Vector3<f64>; 2], radius_m: f64, time_s: f64, known_m: f64) -> f64 {
        let Some(away_m) = self.displacement_m(time_s) else { return known_m };
        let origin_m: Vector3<f64> = Vector3::from(self.position_m) + Vector3::from(away_m);
        let along = |share: f64| {
            let own_m: [f64; 3] = (axis[0] + (axis[1] - axis[0]) * share - origin_m).into();
            self.shape.distance_at(tr_mul_vec(&self.turn, own_m)) - radius_m
        };
        least(along, (axis[1] - axis[0]).norm(), known_m)
    }
}

/// The least of a function on [0, 1] that changes by at most `rise` from end to end, or `known` if it does not come below that.
pub(super) fn least(at: impl Fn(f64) -> f64, rise: f64, known: f64) -> f64 {
    if at(0.5) - 0.5 * rise >= known {
        return known;
    }
    let (first, last) = (at(0.0), at(1.0));
    let mut best = known.min(first).min(last);
    let mut parts = vec![([0.0, 1.0], [first, last])];
    while let Some(([from, to], [left, right])) = parts.pop() {
        let lowest = 0.5 * (left + right - rise * (to - from));
        if lowest < best - EXACT_M {
            let middle = 0.5 * (from + to);
            let value = at(middle);
            best = best.min(value);
            parts.push(([from, middle], [left, value]));
            parts.push(([middle, to], [value, right]));
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    fn brute(surroundings: &Surroundings, axis: [Vector3<f64>; 2], radius_m: f64, time_s: f64) -> f64 {
        let at = |share: f64| {
            let point = axis[0] + (axis[1] - axis[0]) * share;
            surroundings.nearest([point, point], radius_m, time_s, f64::INFINITY).unwrap().distance_m
        };
        (0..=4000).map(|k| at(f64::from(k) / 4000.0)).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn the_nearest_point_of_an_axis_is_found() {
        let mut scene = Scene::load("vial").unwrap();
        scene.containers[0].yaw_deg = 30.0;
        let surroundings = Surroundings::of_scene(&scene, -0.1);
        let corner = |k: u32, seed: u32| {
            let share = |axis: u32| f64::from((k * 7919 + seed * 104_729 + axis * 15_485_863) % 997) / 997.0;
            Vector3::new(0.3 * share(0) - 0.05, 0.2 * share(1) - 0.05, 0.3 * share(2) - 0.1)
        };
        for k in 0..200 {
            let axis = [corner(k, 1), corner(k, 2)];
            let found = surroundings.nearest(axis, 0.03, 0.0, f64::INFINITY).unwrap().distance_m;
            let wanted = brute(&surroundings, axis, 0.03, 0.0);
            assert!((found - wanted).abs() < 2.0 * EXACT_M, "{found} {wanted} {axis:?}");
            // What is known to be nearer is not looked for.
            assert_eq!(surroundings.nearest(axis, 0.03, 0.0, wanted - 2.0 * EXACT_M), None);
        }
    }

    #[test]
    fn what_is_near_is_named() {
        let scene = Scene::load("vial").unwrap();
        let [surroundings, flat] = [-0.1, 0.0].map(|table_m| Surroundings::of_scene(&scene, table_m));
        let [x, y, _] = scene.target().position_m;
        let named = |surroundings: &Surroundings, point: [f64; 3]| {
            let point = Vector3::from(point);
            surroundings.nearest([point, point], 0.0, 0.0, f64::INFINITY).unwrap().obstacle.clone()
        };
        let vial = Obstacle::Container("vial".into());
        assert_eq!(named(&surroundings, [x, y, 0.1]), vial);
        // Beside the bench the table is 0.1 m lower.
        assert_eq!(named(&surroundings, [-0.2, y, 0.0]), Obstacle::Table);
        assert_eq!(named(&surroundings, [-0.01, y, -0.03]), Obstacle::Stand);
        assert_eq!(named(&flat, [-0.01, y, 0.001]), Obstacle::Table);
    }

    #[test]
    fn a_gate_is_in_the_way_while_it_is_there() {
        use crate::scene::{GateOpening, GateShape};
        let mut scene = Scene::load("bench").unwrap();
        scene.gates = vec![Gate {
            name: "lid".into(),
            position_m: [0.1, 0.05, 0.5],
            yaw_deg: 0.0,
            friction: 0.4,
            opens_at_s: 1.0,
            shape: GateShape::Box { size_m: [0.1, 0.1, 0.004] },
            opening: GateOpening::Vanish {},
        }];
        let surroundings = Surroundings::of_scene(&scene, 0.0);
        let point = Vector3::new(0.1, 0.05, 0.6);
        let at = |time_s| surroundings.nearest([point, point], 0.01, time_s, f64::INFINITY).unwrap();
        assert_eq!(at(0.5).obstacle, &Obstacle::Gate("lid".into()));
        assert!((at(0.5).distance_m - 0.086).abs() < 1e-9);
        assert!(matches!(at(1.5).obstacle, Obstacle::Container(_)));
    }
}
