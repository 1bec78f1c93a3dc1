//! The adjoint, restarted from an empirical value function.
//!
//! # What is wrong with the exact derivative
//!
//! How much powder a tool carries is decided where the ways of grains part: at its rim, some stay on it and their neighbours fall.
//! The loss as a function of the skill is then a sum of jumps, smoothed by how many grains there are. Its slope is a flux: how fast
//! the divide moves over the powder, times what a grain is worth on one side less what it is worth on the other. The derivative of
//! one rollout sees no jump. What it sees is the few grains that happen to lie near the divide, with amplifications of 10^2 to 10^5,
//! so that it is either next to nothing or enormous.
//!
//! # What is done here
//!
//! | symbol | meaning | in code |
//! |---|---|---|
//! | x_i | position of grain i at a cut, a moment of the motion | `positions` |
//! | l_i | what grain i costs at the end, see [`super::loss::values`] | `values` |
//! | V(x) | what a grain costs on average that is at x at the cut: E\[l \| x\] | |
//! | h | radius of a neighbourhood | [`Restarts::radius_m`] |
//! | s_i | slope of V at x_i | `slopes` |
//!
//! When a rollout is over, each grain's l_i is known, and V is sampled at as many places as there are grains. At a cut the way back
//! forgets the cotangents that it has, and goes on from s_i for the position of grain i and from nothing for all else. s_i is the
//! slope of a local linear regression of l on x over the grains j within h,
//!
//! ```text
//! w_j = (1 - |x_j - x_i|^2/h^2)^2,   d_j = x_j - x_i less its weighted mean,   e_j = l_j less its weighted mean
//! s_i = (sum w_j d_j d_j^T / sum w_j + 0.01 h^2)^-1 (sum w_j d_j e_j / sum w_j)
//! ```
//!
//! Across a divide it is the missing flux: the jump, spread over the neighbourhood. Grains j behind a wall of a container, a gate or
//! the tool are left out: what lies on the other side of a wall has another fate, and nothing flows through it.
//!
//! What the tool carries moves with it, and the slopes of V within the tool say nothing of that: there the exact cotangents' rigid
//! resultant is kept. With b_i the exact position cotangents and p the tool's origin, the tool's pose gets
//!
//! ```text
//! sum (b_i - s_i)   and about p   sum (x_i - p) x (b_i - s_i)
//! ```
//!
//! over the grains that are on the tool, so that a motion of tool and powder as one has the derivative that it had.
//!
//! # Bias and variance
//!
//! Between cuts the derivative is exact. A cut forgets what velocities, strains and neighbours have to do with the future: a bias.
//! A wider neighbourhood smooths V over more than a divide is wide: a bias as well. In exchange the variance of a cut is that of a
//! mean over about (4/3) pi h^3/V_0 grains, V_0 a grain's volume, instead of that of single grains with their amplification. It
//! is to the exact derivative what an actor's critic is to a return that is followed to its end, and to a mixture of first and
//! zeroth order (alpha-order gradients, Suh et al. 2022) what a conditional expectation is to a weighted mean: the zeroth-order part
//! is taken over grains of one rollout instead of over rollouts.
//!
//! It fails where there are too few grains for a mean (fewer than [`LEAST_NEIGHBOURS`]: their slope is zero), and where position
//! alone does not tell the future: grains that fly through the same place with different velocities.

use nalgebra::{Matrix3, Vector3};
use powderline_shared::pose::Pose;
use rayon::prelude::*;

use super::outcome::held;
use crate::mpm::Model;
use crate::mpm::bodies::Bodies;
use crate::mpm::contact::BodyState;
use crate::mpm::obstacle::{Collider, distance};
use crate::mpm::particles::{Group, Particles, set_vec};
use crate::real::Real;
use crate::scene::Scene;
use crate::skill::{SegmentKind, SkillMap, Theta};

/// Neighbours, the grain itself among them, below which there is no slope.
pub const LEAST_NEIGHBOURS: usize = 6;

/// Radius of a neighbourhood, in cells.
const RADIUS_CELLS: f64 = 1.5;

/// Ridge of the regression, in squared radii.
const RIDGE: f64 = 0.01;

/// How deep in a wall a line between two grains is for the wall to lie between them, as a share of half its thickness: grains that
/// lean on it stand in its surface.
const DEEP: f64 = 0.5;

/// Looks along a line between two grains.
const LOOKS: usize = 7;

/// Where and how the adjoint restarts.
#[derive(Clone, Debug, PartialEq)]
pub struct Restarts {
    /// Control steps before which it restarts.
    pub steps: Vec<usize>,
    /// Radius of the neighbourhoods, metres.
    pub radius_m: f64,
}

impl Restarts {
    /// For the motion of a skill: at the ends of scooping, lift, transport and pour, and at each quarter of the pour, in
    /// neighbourhoods of 1.5 cells.
    #[must_use]
    pub fn of_skill(scene: &Scene, map: &SkillMap, theta: &Theta) -> Self {
        let period_s = scene.time.control_period_s();
        let mut times_s = Vec::new();
        for segment in map.segments(theta) {
            match segment.kind {
                SegmentKind::Insert => {}
                SegmentKind::Pour => times_s.extend(
                    [0.25, 0.5, 0.75, 1.0]
                        .map(|share| segment.start_s + share * (segment.end_s - segment.start_s)),
                ),
                _ => times_s.push(segment.end_s),
            }
        }
        let mut steps: Vec<usize> = times_s.into_iter().map(|time_s| (time_s / period_s).round() as usize).collect();
        steps.sort_unstable();
        steps.dedup();
        Self { steps, radius_m: RADIUS_CELLS * scene.domain.cell_m }
    }
}

/// What is needed at a cut besides the powder.
pub(super) struct Cut<'a, T: Real> {
    pub(super) scene: &'a Scene,
    pub(super) model: &'a Model<T>,
    /// Tool and gates at the cut.
    pub(super) bodies: &'a Bodies<T>,
    /// The tool at the cut.
    pub(super) tool: Pose,
    pub(super) radius_m: f64,
}

/// Cotangent of a pose: of its position, and of its rotation from the left.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct PoseBar {
    pub(super) position: Vector3<f64>,
    pub(super) rotation: Vector3<f64>,
}

impl<T: Real> Cut<'_, T> {
    /// Replaces the powder's cotangents, and says what the tool's pose takes over. `values` by identity, metres; none of grains that
    /// the loss does not see.
    pub(super) fn restart(
        &self,
        particles: &Particles<T>,
        values: &[Option<f64>],
        bar: &mut [Group<T>],
    ) -> PoseBar {
        let positions = particles.positions_by_id();
        let slopes = self.slopes(&positions, values);
        let mut over = PoseBar::default();
        for (g, l, id) in particles.occupied() {
            let (x, slope) = (positions[id as usize], slopes[id as usize]);
            if held(self.scene, &self.tool, &x) {
                let exact = [0, 1, 2].map(|axis| bar[g].x[axis][l].to_f64());
                let left = Vector3::from(exact) - Vector3::from(slope);
                over.position += left;
                over.rotation += (Vector3::from(x) - self.tool.position_m).cross(&left);
            }
            bar[g].copy_lane(l, &Group::ZERO, l);
            set_vec(&mut bar[g].x, l, slope.map(T::from_f64));
        }
        over
    }

    /// Slopes of what grains cost, by identity, metres per metre. Each is a sum over neighbours in the order of their cells and identities,
    /// so its bits depend on nothing else.
    pub(super) fn slopes(&self, positions: &[[f64; 3]], values: &[Option<f64>]) -> Vec<[f64; 3]> {
        let cells = Cells::new(positions, self.radius_m);
        let walls = self.walls();
        (0..positions.len())
            .into_par_iter()
            .map(|id| {
                let near: Vec<Wall<'_, T>> =
                    walls.iter().filter(|wall| wall.distance_m(&positions[id]) < self.radius_m).copied().collect();
                let mut sums = Sums::new(self.radius_m);
                cells.around(&positions[id], |other| {
                    let Some(value) = values[other] else { return };
                    let away = [0, 1, 2].map(|axis| positions[other][axis] - positions[id][axis]);
                    if sums.reaches(&away) && !parted(&near, &positions[id], &away) {
                        sums.take(&away, value);
                    }
                });
                sums.slope()
            })
            .collect()
    }

    /// What may lie between two grains. What has no other side, the simulated volume's bounds, does not.
    fn walls(&self) -> Vec<Wall<'_, T>> {
        let obstacles = &self.model.obstacles;
        let fixed = obstacles.fixed.iter().map(|fixed| (&fixed.piece, &fixed.motion));
        let there = obstacles.gates.iter().zip(&self.bodies.gates).filter(|(_, gate)| gate.is_there);
        let gates = there.map(|(piece, gate)| (piece, &gate.motion));
        let tool = obstacles.tool.iter().map(|piece| (piece, &self.bodies.tool));
        let all = fixed.chain(gates).chain(tool);
        all.filter_map(|(piece, motion)| {
            let half_m = piece.shape.half_thickness()?.to_f64();
            Some(Wall { piece, motion, deep_m: DEEP * half_m.min(0.5 * self.radius_m) })
        })
        .collect()
    }
}

/// A piece that has two sides.
struct Wall<'a, T> {
    piece: &'a Collider<T>,
    motion: &'a BodyState<T>,
    deep_m: f64,
}

impl<T> Clone for Wall<'_, T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Wall<'_, T> {}

impl<T: Real> Wall<'_, T> {
    /// Signed distance, metres.
    fn distance_m(&self, x: &[f64; 3]) -> f64 {
        distance(self.piece, self.motion, x.map(T::from_f64)).to_f64()
    }

    /// Whether the line from one grain to another goes deep into it.
    fn parts(&self, from: &[f64; 3], away: &[f64; 3]) -> bool {
        let at = |share: f64| self.distance_m(&[0, 1, 2].map(|axis| from[axis] + share * away[axis]));
        let length_m = libm::sqrt(away.iter().map(|x| x * x).sum());
        // A distance changes by at most a metre a metre.
        at(0.5) - 0.5 * length_m < -self.deep_m
            && (1..=LOOKS).any(|look| at(look as f64 / (LOOKS + 1) as f64) < -self.deep_m)
    }
}

fn parted<T: Real>(walls: &[Wall<'_, T>], from: &[f64; 3], away: &[f64; 3]) -> bool {
    walls.iter().any(|wall| wall.parts(from, away))
}

/// Weighted sums of a regression.
struct Sums {
    square_m2: f64,
    count: usize,
    weight: f64,
    value: f64,
    away: Vector3<f64>,
    away_away: Matrix3<f64>,
    away_value: Vector3<f64>,
}

impl Sums {
    fn new(radius_m: f64) -> Self {
        Self {
            square_m2: radius_m * radius_m,
            count: 0,
            weight: 0.0,
            value: 0.0,
            away: Vector3::zeros(),
            away_away: Matrix3::zeros(),
            away_value: Vector3::zeros(),
        }
    }

    fn reaches(&self, [x, y, z]: &[f64; 3]) -> bool {
        x * x + y * y + z * z < self.square_m2
    }

    fn take(&mut self, away: &[f64; 3], value: f64) {
        let d = Vector3::from(*away);
        let left = 1.0 - d.norm_squared() / self.square_m2;
        let w = left * left;
        self.count += 1;
        self.weight += w;
        self.value += w * value;
        self.away += d * w;
        self.away_away += d * d.transpose() * w;
        self.away_value += d * (w * value);
    }

    fn slope(&self) -> [f64; 3] {
        if self.count < LEAST_NEIGHBOURS {
            return [0.0; 3];
        }
        let (mean_value, mean_away) = (self.value / self.weight, self.away / self.weight);
        let spread = self.away_away / self.weight - mean_away * mean_away.transpose()
            + Matrix3::identity() * (RIDGE * self.square_m2);
        let together = self.away_value / self.weight - mean_away * mean_value;
        spread.try_inverse().map_or([0.0; 3], |inverse| (inverse * together).into())
    }
}

/// Grains by the cells that they are in, of the edge of a radius.
struct Cells {
    edge_m: f64,
    /// Cell and identity, sorted.
    sorted: Vec<([i64; 3], usize)>,
}

impl Cells {
    fn new(positions: &[[f64; 3]], edge_m: f64) -> Self {
        let mut cells = Self { edge_m, sorted: Vec::new() };
        cells.sorted = positions.iter().enumerate().map(|(id, x)| (cells.of(x), id)).collect();
        cells.sorted.sort_unstable();
        cells
    }

    fn of(&self, x: &[f64; 3]) -> [i64; 3] {
        x.map(|x| (x / self.edge_m).floor() as i64)
    }

    /// All in the 27 cells around a point.
    fn around(&self, x: &[f64; 3], mut look: impl FnMut(usize)) {
        let [i, j, k] = self.of(x);
        for (i, j) in (i - 1..=i + 1).flat_map(|i| (j - 1..=j + 1).map(move |j| (i, j))) {
            // Along the last axis they lie one after another.
            let from = self.sorted.partition_point(|(cell, _)| *cell < [i, j, k - 1]);
            let these = self.sorted[from..].iter().take_while(|(cell, _)| *cell <= [i, j, k + 1]);
            these.for_each(|(_, id)| look(*id));
        }
    }
}
