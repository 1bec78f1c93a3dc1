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
//! | l_i | what grain i costs at the end, `values` in `rollout/loss.rs` | `values` |
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
//! # What the tool carries
//!
//! It moves with the tool, and the slopes of V within the tool say nothing of that. What tool and powder cost when they are moved as
//! one is sum s_i over the grains on the tool plus what the tool's own pose has; a restart may not change it, so what it takes from
//! the grains' cotangents the tool's pose has to get. With b_i the exact position cotangents, p the tool's origin, and all sums over
//! the grains on the tool at this cut, there are two ways to do that:
//!
//! ```text
//! exact        force += sum (b_i - s_i)                        moment about p += sum (x_i - p) x (b_i - s_i)
//! of leavers   force  = that after the next cut + sum (s'_i - s_i), s'_i the slope at the next cut; moment as above
//! ```
//!
//! While the tool digs, the exact one is right. Once it is clear of the bed, it is noise: moved as one through air, powder and tool do
//! the same as before, but in other cells of the grid, and single grains make much of that. In the same stretch the invariance itself
//! says what the force is: all that moving both as one changes until the next cut is where the grains are that leave in between, and
//! what that costs is their slope there. Cells, contact and the chaos between the two cuts do not come in. It says nothing of turning
//! tool and powder as one, which turns them against gravity: the moment stays the exact one.
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
//! While the tool digs, a cotangent grows fastest; hence the cuts within the scoop. Cosines with differences over +-0.1 of theta, of
//! seven skills of `bench-small` by which the settings were chosen (`examples/restarted_ablation.rs`, one packing; the two that
//! deliver one particle or none come last):
//!
//! | skill | 0 | 1 | 3 | 4 | 6 | 2 | 5 |
//! |---|---|---|---|---|---|---|---|
//! | as it is | 0.98 | 0.93 | 0.95 | 0.88 | 0.96 | 0.95 | 0.81 |
//! | the same, force always the exact one, one cut in the scoop | | 0.77 | | 0.32 | | | |
//! | one cut in the scoop | | 0.85 | | 0.34 | | | |
//! | no force and moment while the tool digs | | 0.91 | | 0.81 | | | |
//! | eight cuts in the scoop, three in the lift | 0.99 | | 0.95 | 0.89 | 0.90 | 0.97 | 0.51 |
//! | eight cuts in the pour, two in the lift, one more before the scoop | 0.96 | | 0.84 | 0.94 | 0.94 | 0.85 | |
//! | two cells' radius | 0.97 | | 0.94 | 0.83 | 0.95 | 0.94 | |
//! | what the grid cannot hold given back as a constant | 0.91 | 0.98 | 0.86 | 0.93 | 0.67 | 0.84 | 0.28 |
//!
//! Of twenty drawn skills, two packings, the cosine is 0.86 in the median and 0.01 at worst (the exact adjoint's: 0.09 and -0.95), without
//! the mean direction of the other skills 0.90 and 0.19, its length 0.55 to 3.3 times the slope's.
//!
//! It fails where there are too few grains for a mean (fewer than [`LEAST_NEIGHBOURS`]: their slope is zero), and where position
//! alone does not tell the future: grains that fly through the same place with different velocities. Scooping and pouring angle,
//! which share the tool's pitch, get the moment of what is carried, still a sum of single grains' cotangents: of the six drawn skills
//! below 0.7 four have both angles wrong with opposite signs. The slope of the lift's height is too small nearly everywhere.

mod report;

pub use report::{CutReport, Population, Restarted};

use nalgebra::{Matrix3, Vector3};
use powderline_shared::pose::Pose;
use rayon::prelude::*;

use super::outcome::held_within;
use super::path::PoseBar;
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
    /// What becomes of the resultant of what the tool carries, at cuts before [`Self::clear_from`].
    pub while_digging: Resultant,
    /// The same at cuts from there on.
    pub while_clear: Resultant,
    /// Control step from which the way back leaves the motion out, because the tool rests from there on: what the powder has at the
    /// end is taken for what it has there, and the adjoint restarts there first. It is cheaper by that stretch; the controls in
    /// it have no derivative then. None: it goes back through all of it.
    pub rests_from: Option<usize>,
    /// Control step from which the tool is clear of the powder that it does not carry.
    pub clear_from: usize,
    /// Room around the tool in which powder is carried, metres.
    pub room_m: f64,
    /// Whether the way back goes through the velocity that is given back to particles because the grid cannot hold it
    /// ([`crate::scene::Transfer`]); otherwise it counts as a constant.
    pub through_residue: bool,
    /// Whether it begins with slopes as well, instead of the loss's own derivative.
    pub begins_with_slopes: bool,
}

impl Restarts {
    /// For the motion of a skill: at each quarter of scooping and pour, where powder moves against the tool, and at the ends of lift
    /// and transport, in neighbourhoods of 1.5 cells. The tool is clear from the end of the lift on. What is after the pour it takes in one piece: more cuts there made the slope of the transport worse.
    #[must_use]
    pub fn of_skill(scene: &Scene, map: &SkillMap, theta: &Theta) -> Self {
        let (period_s, horizon) = (scene.time.control_period_s(), scene.time.horizon_steps as usize);
        let (mut times_s, mut clear_from) = (Vec::new(), 0);
        for segment in map.segments(theta) {
            match segment.kind {
                SegmentKind::Approach | SegmentKind::Insert => {}
                SegmentKind::Scoop | SegmentKind::Pour => times_s.extend(
                    [0.25, 0.5, 0.75, 1.0]
                        .map(|share| segment.start_s + share * (segment.end_s - segment.start_s)),
                ),
                _ => times_s.push(segment.end_s),
            }
            if segment.kind == SegmentKind::Lift {
                clear_from = (segment.end_s / period_s).round() as usize;
            }
        }
        let steps = times_s.into_iter().map(|time_s| (time_s / period_s).round() as usize);
        let mut steps: Vec<usize> = steps.filter(|step| (1..horizon).contains(step)).collect();
        steps.sort_unstable();
        steps.dedup();
        Self {
            steps,
            radius_m: RADIUS_CELLS * scene.domain.cell_m,
            while_digging: Resultant::Exact,
            while_clear: Resultant::OfLeavers,
            clear_from,
            rests_from: None,
            room_m: scene.tool.wall_thickness_m,
            through_residue: true,
            begins_with_slopes: true,
        }
    }
}

/// What becomes of the resultant of what the tool carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Resultant {
    /// It is lost.
    Dropped,
    /// The tool's pose takes over what slopes leave of the exact one.
    Exact,
    /// Its force is what the grains bring that leave the tool before the next cut; its moment is the exact one.
    OfLeavers,
}

/// What a cut tells the one before it.
#[derive(Clone, Debug, Default)]
pub(super) struct Later {
    /// Cotangents of positions that the adjoint went on from, by identity.
    pub(super) slopes: Vec<[f64; 3]>,
    /// That of the tool's pose.
    pub(super) pose: PoseBar,
}

/// What is needed at a cut besides the powder.
pub(super) struct Cut<'a, T: Real> {
    pub(super) scene: &'a Scene,
    pub(super) model: &'a Model<T>,
    /// Tool and gates at the cut.
    pub(super) bodies: &'a Bodies<T>,
    /// The tool at the cut.
    pub(super) tool: Pose,
    /// Control step that begins there.
    pub(super) step: usize,
    pub(super) restarts: &'a Restarts,
}

impl<T: Real> Cut<'_, T> {
    /// Replaces the powder's cotangents, and says what the tool's pose has then. `values` by identity, metres; none of grains that
    /// the loss does not see. `pose` is what the tool's pose has before.
    pub(super) fn restart(
        &self,
        particles: &Particles<T>,
        values: &[Option<f64>],
        (bar, pose): (&mut [Group<T>], &PoseBar),
        later: &Later,
    ) -> (Later, CutReport) {
        let (positions, velocities) = (particles.positions_by_id(), particles.velocities_by_id());
        let slopes = self.slopes(&positions, values);
        let mut report = CutReport::new(self.step, pose);
        let (mut left, mut leavers) = (PoseBar::default(), Vector3::zeros());
        for (g, l, id) in particles.occupied() {
            let id = id as usize;
            let (x, slope) = (positions[id], Vector3::from(slopes[id]));
            let exact = Vector3::from([0, 1, 2].map(|axis| bar[g].x[axis][l].to_f64()));
            let carried = held_within(self.scene, &self.tool, &x, self.restarts.room_m);
            report.population(carried, &velocities[id]).take(&exact, &slope);
            if carried {
                left.position += exact - slope;
                left.rotation += (Vector3::from(x) - self.tool.position_m).cross(&(exact - slope));
                leavers += Vector3::from(later.slopes[id]) - slope;
            }
            bar[g].copy_lane(l, &Group::ZERO, l);
            set_vec(&mut bar[g].x, l, slopes[id].map(T::from_f64));
        }
        let Restarts { while_digging, while_clear, clear_from, .. } = *self.restarts;
        let new = match if self.step < clear_from { while_digging } else { while_clear } {
            Resultant::Dropped => *pose,
            Resultant::Exact => {
                PoseBar { position: pose.position + left.position, rotation: pose.rotation + left.rotation }
            }
            Resultant::OfLeavers => {
                PoseBar { position: later.pose.position + leavers, rotation: pose.rotation + left.rotation }
            }
        };
        report.tool_after = new.components();
        (Later { slopes, pose: new }, report)
    }

    /// Slopes of what grains cost, by identity, metres per metre. Each is a sum over neighbours in the order of their cells and identities,
    /// so its bits depend on nothing else.
    pub(super) fn slopes(&self, positions: &[[f64; 3]], values: &[Option<f64>]) -> Vec<[f64; 3]> {
        let cells = Cells::new(positions, self.restarts.radius_m);
        let walls = self.walls();
        (0..positions.len())
            .into_par_iter()
            .map(|id| {
                let near: Vec<Wall<'_, T>> = walls
                    .iter()
                    .filter(|wall| wall.distance_m(&positions[id]) < self.restarts.radius_m)
                    .copied()
                    .collect();
                let mut sums = Sums::new(self.restarts.radius_m);
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
            Some(Wall { piece, motion, deep_m: DEEP * half_m.min(0.5 * self.restarts.radius_m) })
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mpm::bodies::Moment;
    use crate::rollout::path::resting;

    struct Case {
        scene: Scene,
        model: Model<f64>,
        bodies: Bodies<f64>,
        tool: Pose,
        restarts: Restarts,
    }

    impl Case {
        /// `bench`, whose tool is at its start.
        fn new() -> Self {
            let scene = Scene::load("bench").unwrap();
            let (map, model) = (SkillMap::new(&scene), Model::new(&scene));
            let tool = *map.start_pose();
            let bodies = Bodies { tool: resting(&tool), gates: model.gates.at(Moment::Settling) };
            let restarts = Restarts::of_skill(&scene, &map, &[0.0; 5]);
            Self { scene, model, bodies, tool, restarts }
        }

        fn cut(&self) -> Cut<'_, f64> {
            let Self { scene, model, bodies, tool, restarts } = self;
            Cut { scene, model, bodies, tool: *tool, step: 1, restarts }
        }
    }

    /// Places 2 mm apart in a box, shaken a little, always the same.
    fn grains(from_m: [f64; 3], counts: [u32; 3]) -> Vec<[f64; 3]> {
        let [nx, ny, nz] = counts;
        let all = (0..nx * ny * nz).map(|index| [index / (ny * nz), index / nz % ny, index % nz]);
        let shaken = |index: u32, axis: u32| f64::from((index * 7919 + axis * 104_729) % 997) / 997.0 - 0.5;
        (0..)
            .zip(all)
            .map(|(index, ijk)| {
                [0, 1, 2].map(|k| from_m[k] + 0.002 * (f64::from(ijk[k]) + 0.4 * shaken(index, k as u32)))
            })
            .collect()
    }

    #[test]
    fn what_costs_in_proportion_to_its_place_has_that_slope() {
        let case = Case::new();
        let places = grains([0.030, 0.030, 0.006], [12, 12, 8]);
        let slope = [0.7, -0.4, 0.2];
        let value = |x: &[f64; 3]| 3.0 + x.iter().zip(slope).map(|(x, slope)| x * slope).sum::<f64>();
        let values: Vec<_> = places.iter().map(|x| Some(value(x))).collect();
        let slopes = case.cut().slopes(&places, &values);
        let middle = places.iter().zip(&slopes).filter(|(x, _)| {
            (0.038..0.046).contains(&x[0]) && (0.038..0.046).contains(&x[1]) && (0.012..0.016).contains(&x[2])
        });
        assert!(middle.clone().count() > 20);
        for (_, found) in middle {
            for (found, slope) in found.iter().zip(slope) {
                // The ridge takes a twelfth.
                assert!((found / slope - 0.92).abs() < 0.05, "{found} {slope}");
            }
        }
    }

    /// Inside and outside of the source's wall from 88 to 92 mm, and above its rim at 34 mm.
    #[test]
    fn nothing_is_compared_across_a_wall() {
        let case = Case::new();
        let steepest = |from_z_m: f64| {
            let mut places = grains([0.0845, 0.040, from_z_m], [2, 8, 4]);
            places.extend(grains([0.0925, 0.040, from_z_m], [2, 8, 4]));
            let values: Vec<_> = places.iter().map(|x| Some(if x[0] < 0.09 { 0.0 } else { 1.0 })).collect();
            let slopes = case.cut().slopes(&places, &values);
            slopes.iter().map(|slope| slope[0].abs()).fold(0.0, f64::max)
        };
        assert!(steepest(0.010) < 1e-9, "{}", steepest(0.010));
        assert!(steepest(0.040) > 1.0, "{}", steepest(0.040));
    }

    #[test]
    fn the_resultant_of_what_is_carried_stays() {
        let mut case = Case::new();
        case.restarts.clear_from = usize::MAX;
        let p: [f64; 3] = case.tool.position_m.into();
        // On the tool, and far from it.
        let mut places = grains([p[0] - 0.006, p[1] - 0.006, p[2] - 0.006], [6, 6, 4]);
        places.extend(grains([0.160, 0.040, 0.006], [6, 6, 4]));
        let particles = Particles::<f64>::at_rest(&places);
        let values: Vec<_> = places.iter().map(|x| Some(libm::sin(300.0 * x[0]))).collect();
        let mut bar = vec![Group::ZERO; particles.groups.len()];
        for (g, l, id) in particles.occupied() {
            set_vec(&mut bar[g].x, l, [f64::from(id % 7), 1.0, -f64::from(id % 3)]);
            bar[g].q[0][l] = 5.0;
        }
        let moments = |bar: &[Group<f64>]| {
            let on_tool =
                |id: u32| held_within(&case.scene, &case.tool, &places[id as usize], case.restarts.room_m);
            let all = particles.occupied().filter(|(_, _, id)| on_tool(*id)).map(|(g, l, id)| {
                let b = Vector3::from([0, 1, 2].map(|k| bar[g].x[k][l]));
                (b, (Vector3::from(places[id as usize]) - case.tool.position_m).cross(&b))
            });
            all.fold((Vector3::zeros(), Vector3::zeros()), |sum, one| (sum.0 + one.0, sum.1 + one.1))
        };
        let before = moments(&bar);
        let pose = PoseBar { position: [3.0, 1.0, -2.0].into(), rotation: [0.5, 0.0, 1.0].into() };
        let later = Later { slopes: vec![[0.0; 3]; places.len()], pose };
        let (new, _) = case.cut().restart(&particles, &values, (&mut bar, &pose), &later);
        let over = PoseBar {
            position: new.pose.position - pose.position,
            rotation: new.pose.rotation - pose.rotation,
        };
        let after = moments(&bar);
        assert!((before.0 - after.0 - over.position).norm() < 1e-9 && before.0.norm() > 100.0);
        assert!((before.1 - after.1 - over.rotation).norm() < 1e-9 && over.rotation.norm() > 1e-3);
        assert!(particles.occupied().all(|(g, l, _)| bar[g].q[0][l] == 0.0));
    }

    /// Moving tool and powder as one costs at a cut what it costs at the next one, whatever single grains' cotangents are in between.
    #[test]
    fn what_leaves_the_tool_takes_its_slope_along() {
        let mut case = Case::new();
        case.restarts.clear_from = 0;
        let p: [f64; 3] = case.tool.position_m.into();
        let mut places = grains([p[0] - 0.006, p[1] - 0.006, p[2] - 0.006], [6, 6, 4]);
        places.extend(grains([0.160, 0.040, 0.006], [6, 6, 4]));
        let particles = Particles::<f64>::at_rest(&places);
        let values: Vec<_> = places.iter().map(|x| Some(libm::sin(300.0 * x[0]))).collect();
        let later = Later {
            slopes: (0..places.len()).map(|id| [libm::cos(id as f64), 0.3, -1.0]).collect(),
            pose: PoseBar { position: [3.0, 1.0, -2.0].into(), rotation: Vector3::zeros() },
        };
        let held = |id: usize| held_within(&case.scene, &case.tool, &places[id], case.restarts.room_m);
        // What is linear in all positions and the tool's.
        let cost = |slopes: &[[f64; 3]], pose: &PoseBar, shift: &Vector3<f64>| {
            let moved = (0..places.len()).map(|id| {
                let by = if held(id) { *shift } else { Vector3::zeros() };
                Vector3::from(slopes[id]).dot(&(Vector3::from(places[id]) + by))
            });
            moved.sum::<f64>() + pose.position.dot(&(case.tool.position_m + shift))
        };
        for noise in [0.0, 1e4] {
            let mut bar = vec![Group::ZERO; particles.groups.len()];
            for (g, l, id) in particles.occupied() {
                set_vec(&mut bar[g].x, l, [noise * f64::from(id % 5), -noise, 0.0]);
            }
            let pose = PoseBar { position: [noise, 0.0, 0.0].into(), rotation: Vector3::zeros() };
            let (new, report) = case.cut().restart(&particles, &values, (&mut bar, &pose), &later);
            assert!(report.carried.grains > 50 && report.resting.grains > 50);
            assert_eq!(report.tool_after.map(f64::to_bits), new.pose.components().map(f64::to_bits));
            for axis in 0..3 {
                let rise = |slopes: &[[f64; 3]], pose: &PoseBar| {
                    let mut shift = Vector3::zeros();
                    shift[axis] = 1e-3;
                    (cost(slopes, pose, &shift) - cost(slopes, pose, &-shift)) / 2e-3
                };
                let (here, there) = (rise(&new.slopes, &new.pose), rise(&later.slopes, &later.pose));
                assert!((here - there).abs() < 1e-6 * (1.0 + there.abs()), "{axis}: {here} {there}");
            }
        }
    }

    #[test]
    fn cuts_go_by_the_skill() {
        let case = Case::new();
        let map = SkillMap::new(&case.scene);
        let steps = &case.restarts.steps;
        let horizon = case.scene.time.horizon_steps as usize;
        assert!(steps.len() == 10 && steps.windows(2).all(|pair| pair[0] < pair[1]), "{steps:?}");
        assert!(steps.iter().all(|step| (1..horizon).contains(step)));
        for segment in &map.segments(&[0.0; 5])[2..] {
            let step = (segment.end_s / case.scene.time.control_period_s()).round() as usize;
            assert!(steps.contains(&step), "{segment:?} {steps:?}");
        }
    }
}
