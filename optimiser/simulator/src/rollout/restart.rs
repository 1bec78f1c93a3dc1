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
//! # What the bed does
//!
//! A grain's own fate is not all that its place decides: it stands in the way of others. A tool that digs deeper pushes the bed before
//! it, and what counts is how deep it is in the bed, not how deep it is. So what the exact cotangents b_i of the grains that the tool
//! does not carry have beside the slopes, b_i - s_i, goes on as well, each shared out among its neighbourhood by the weights w. Their
//! sum stays, so that tool and bed moved as one cost what they did; single grains average out.
//!
//! # What the tool carries
//!
//! It moves with the tool, and the slopes of V within the tool say nothing of that. What tool and powder cost when they are moved as
//! one is sum s_i over the grains on the tool plus what the tool's own pose has; a restart may not change it, so what it takes from
//! the grains' cotangents the tool's pose gets. With b_i the exact position cotangents, p the tool's origin, and all sums over
//! the grains on the tool:
//!
//! ```text
//! force += sum (b_i - s_i)        moment about p += sum (x_i - p) x (b_i - s_i)
//! ```
//!
//! While the tool digs, that is right. Once it is clear of the bed, it is noise: moved as one through air, powder and tool do the same
//! as before, but in other cells of the grid, and single grains make much of that. All that moving both as one changes there is which
//! grains leave, and where. So from the step [`Carrying::from`] on nothing goes back through the powder. Tool and powder count as one body
//! whose motion costs a force F and a moment M, and these are measured: the rollout branches off where the tool begins to pour, the body
//! is moved along and against each of [`Carrying::ways`] while it pours, and the losses at the end say the slopes. Beginning and
//! packing are the same in all branches, so that their differences have little noise, and a branch costs only the rest of the motion.
//!
//! ```text
//! F d = (L(+d) - L(-d)) / 2,   M likewise; d: the way
//! a control at step t:  F share(t),  M      until the end of the pour, nothing after it
//! where the digging ends, the tool's pose:  F - sum s_i,   M - sum (x_i - p) x s_i
//! ```
//!
//! share(t) is how much of the powder that leaves the body on the rest of the way is still on it. The moment has no such factor: powder
//! in a tool that is turned flows by the angle, whenever that is reached.
//!
//! # Bias and variance
//!
//! Between cuts the derivative is exact. A cut forgets what velocities, strains and neighbours have to do with the future: a bias.
//! A wider neighbourhood smooths V over more than a divide is wide: a bias as well. In exchange the variance of a cut is that of a
//! mean over about (4/3) pi h^3/V_0 grains, V_0 a grain's volume, instead of that of single grains with their amplification. It
//! is to the exact derivative what an actor's critic is to a return that is followed to its end, and to a mixture of first and
//! zeroth order (alpha-order gradients, Suh et al. 2022) what a conditional expectation is to a weighted mean: the zeroth-order part
//! is taken over grains of one rollout instead of over rollouts, and where few numbers say all, over branches of it.
//!
//! One body is a bias, too: how fast it is moved, and when, does not count. A component of the motion along none of the ways has no
//! derivative once the tool is clear.
//!
//! It fails where there are too few grains for a mean (fewer than [`LEAST_NEIGHBOURS`]: their slope is zero), and where position
//! alone does not tell the future. On a tool that is full one more grain may push another off: that is the guess for draw 611 of `bench`,
//! by depth -200 m for -60.
//!
//! Of twenty drawn skills of `bench-small`, two packings, settings fixed before (`optimise gradcheck bench-small --skills 20 --packings 2
//! --first 700`, differences over +-0.1), the cosine is 0.97 in the median and 0.30 at worst (the exact adjoint's: -0.53 and
//! -0.97), the length 0.62 to 1.89 times the slope's (0.5 to 4e4). Of the components whose slope is above its noise the sign
//! is right in 17 of 18 (depth), 11 of 15 (scooping angle), 15 of 16 (lift), 19 of 19 (transport) and 17 of 17 (pouring angle).
//! The worst are four whose differences look across the edge where the wanted amount arrives; all others have 0.83 and more.
//! It costs 4.6 rollouts: one for the motion, some 1.4 for the branches, in which only what is carried, falls and lands is awake, the
//! rest for the digging. Of twenty of `bench` the cosine is 0.95 and 0.53, for 5.5 rollouts. Of twenty of `vial` it is 0.88 and -0.46,
//! for 6.7: of skills that bring about what is wanted, or more, the slope is shallow, and what is left of it is how much the scoop
//! takes up, of which the adjoint knows least.
//!
//! What did worse: the moment of what is carried as a sum of single grains' cotangents, and the force by the slopes of what leaves (twenty
//! other skills: 0.86 and 0.01, with signs right in 11, 7, 12 and 9 of 19, 17, 18 and 16 for all but depth); four branches that
//! move the body along three ways at once, half a factorial design, with the adjoint from the end of the scooping, at
//! 5.2 rollouts (twenty other skills: 0.93 and 0.60, but lift right in 5 of 17 and pouring angle in 10 of 15: what two ways do
//! together counts for the third); flying grains compared by where they land (nothing gained).

mod report;

pub use report::{CutReport, Population, Restarted};

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};
use powderline_shared::displacement::Displacement;
use powderline_shared::pose::Pose;
use rayon::prelude::*;

use super::outcome::held_within;
use super::path::PoseBar;
use super::slopes::HALF_STEP;
use crate::mpm::Model;
use crate::mpm::bodies::Bodies;
use crate::mpm::contact::BodyState;
use crate::mpm::obstacle::{Collider, distance};
use crate::mpm::particles::{Group, Particles, set_vec};
use crate::real::Real;
use crate::scene::Scene;
use crate::skill::{Control, Freedom, SegmentKind, SegmentSpan, SkillMap, Theta};

/// Neighbours, the grain itself among them, below which there is no slope.
pub const LEAST_NEIGHBOURS: usize = 6;

/// Radius of a neighbourhood, in cells.
const RADIUS_CELLS: f64 = 1.5;

/// Ridge of the regression, in squared radii.
const RIDGE: f64 = 0.01;

/// How deep in a wall a line between two grains is for the wall to lie between them, as a share of half its thickness: grains that
/// lean on it stand in its surface.
const DEEP: f64 = 0.5;

/// Speed below which powder falls asleep while the body is moved, over that at which it does otherwise. What creeps on in the source or
/// the target differs by nothing between two branches.
const SLEEP_RATIO: f64 = 50.0;

/// Looks along a line between two grains.
const LOOKS: usize = 7;

/// Where and how the adjoint restarts.
#[derive(Clone, Debug, PartialEq)]
pub struct Restarts {
    /// Control steps before which it restarts; those from [`Carrying::from`] on do not count.
    pub steps: Vec<usize>,
    /// Radius of the neighbourhoods, metres.
    pub radius_m: f64,
    /// Powder is compared by where it would be after this time if it kept its velocity, seconds; 0: by where it is.
    pub ahead_s: f64,
    /// Room around the tool in which powder is carried, metres.
    pub room_m: f64,
    /// Whether the way back goes through the velocity that is given back to particles because the grid cannot hold it
    /// ([`crate::scene::Transfer`]); otherwise it counts as a constant.
    pub through_residue: bool,
    /// Whether what grains that the tool does not carry do to the fate of others goes on past a cut, as a mean over the neighbourhood.
    pub through_bed: bool,
    /// Whether it begins with slopes as well, instead of the loss's own derivative.
    pub begins_with_slopes: bool,
    /// The part of the motion on which the tool carries what it has got; none: the adjoint goes through all of it.
    pub carrying: Option<Carrying>,
}

/// A part of a motion on which the tool is clear of the powder that it does not carry.
#[derive(Clone, Debug, PartialEq)]
pub struct Carrying {
    /// Control step with which it begins.
    pub from: usize,
    /// Control step from which the tool's motion counts no more: what it had to pour is poured.
    pub until: usize,
    /// Control steps over which the body is moved to see what that costs, within the part; before them no powder has left.
    pub over: Range<usize>,
    /// The ways along which it is moved, as far as that: each a translation or a rotation, all of them at right angles.
    pub ways: Vec<Displacement>,
    /// Powder that stays slower than this falls asleep while it is moved, m/s: only what is carried, falls and lands has to be
    /// awake.
    pub sleep_speed_m_s: f64,
}

impl Restarts {
    /// For the motion of a skill: at each quarter of the scooping and each third of the lift, in neighbourhoods of 1.5 cells. From there on
    /// tool and powder are one body, which is moved over the pour, in the skill's plane, as far as [`HALF_STEP`] moves
    /// transport, lift and pouring angle.
    #[must_use]
    pub fn of_skill(scene: &Scene, map: &SkillMap, theta: &Theta) -> Self {
        let horizon = scene.time.horizon_steps as usize;
        let step_at = |time_s: f64| ((time_s / scene.time.control_period_s()).round() as usize).min(horizon);
        let within = |segment: &SegmentSpan, share: f64| {
            step_at(segment.start_s + share * (segment.end_s - segment.start_s))
        };
        let (mut steps, mut from, mut pour) = (Vec::new(), 0, 0..0);
        for segment in map.segments(theta) {
            let [start_s, end_s] = [segment.start_s, segment.end_s];
            match segment.kind {
                SegmentKind::Approach | SegmentKind::Insert | SegmentKind::Transport => {}
                SegmentKind::Scoop => {
                    steps.extend([0.25, 0.5, 0.75, 1.0].map(|share| within(&segment, share)));
                }
                SegmentKind::Lift => {
                    steps.extend([1.0 / 3.0, 2.0 / 3.0].map(|share| within(&segment, share)));
                    from = step_at(end_s);
                }
                SegmentKind::Pour => pour = step_at(start_s)..step_at(end_s),
            }
        }
        steps.dedup();
        // With an overlap the pour may begin before the lift ends.
        let from = from.min(pour.start);
        Self {
            steps,
            radius_m: RADIUS_CELLS * scene.domain.cell_m,
            ahead_s: 0.0,
            room_m: scene.tool.wall_thickness_m,
            through_residue: true,
            through_bed: true,
            begins_with_slopes: true,
            carrying: Some(Carrying {
                from,
                until: pour.end,
                over: pour,
                ways: Freedom::OF_SKILL.into_iter().filter_map(|freedom| way(scene, freedom)).collect(),
                sleep_speed_m_s: SLEEP_RATIO * scene.domain.sleep_speed_m_s,
            }),
        }
    }

    /// For a path near it: the body is moved along whatever else the path may do, too.
    #[must_use]
    pub fn of_path(scene: &Scene, map: &SkillMap, theta: &Theta, freedoms: &[Freedom]) -> Self {
        let mut restarts = Self::of_skill(scene, map, theta);
        let beside = freedoms.iter().filter(|freedom| !Freedom::OF_SKILL.contains(freedom));
        let ways = beside.filter_map(|freedom| way(scene, *freedom));
        restarts.carrying.iter_mut().for_each(|carrying| carrying.ways.extend(ways.clone()));
        restarts
    }

    /// The same, but nothing restarts: the exact adjoint.
    #[must_use]
    pub fn without_cuts(&self) -> Self {
        Self {
            steps: Vec::new(),
            through_residue: true,
            begins_with_slopes: false,
            carrying: None,
            ..self.clone()
        }
    }
}

/// A freedom as a way to move the body; none where the parameter that says how far may not change.
fn way(scene: &Scene, freedom: Freedom) -> Option<Displacement> {
    let skill = &scene.skill;
    let part = |[low, high]: [f64; 2]| 0.5 * (high - low) * HALF_STEP;
    let size = match freedom {
        Freedom::Forward | Freedom::Sideways => part(skill.transport_displacement_m),
        Freedom::Up => part(skill.lift_height_m),
        Freedom::Pitch | Freedom::Roll | Freedom::Yaw => part(skill.pouring_angle_deg).to_radians(),
    };
    let (sin, cos) = libm::sincos(skill.heading_deg.to_radians());
    let direction = freedom.direction([cos, sin, 0.0], [-sin, cos, 0.0]);
    (size != 0.0).then(|| Displacement::from(direction.map(|x| size * x)))
}

impl Carrying {
    /// The same motion with the body moved along a way, times `sign`.
    pub(super) fn moved(
        &self,
        controls: &[Displacement],
        way: &Displacement,
        sign: f64,
    ) -> Vec<Displacement> {
        let (share, way) = (sign / self.over.len() as f64, way.components());
        let mut moved = controls.to_vec();
        for control in &mut moved[self.over.clone()] {
            let components = control.components();
            *control = Displacement::from(std::array::from_fn(|k| components[k] + share * way[k]));
        }
        moved
    }

    /// What the body's pose has, of the losses along each way and against it.
    pub(super) fn body(&self, ends: &[[f64; 2]]) -> PoseBar {
        let mut body = PoseBar::default();
        for (way, [along, against]) in self.ways.iter().zip(ends) {
            let rise = 0.5 * (along - against);
            // Of a way that is none there is no slope along it.
            let slope = |way: Vector3<f64>| match way.norm_squared() {
                0.0 => Vector3::zeros(),
                squared => way * (rise / squared),
            };
            body.position += slope(way.translation());
            body.rotation += slope(way.rotation());
        }
        body
    }

    /// Cotangents of the controls from [`Self::from`] to the end of a motion of so many steps; `shares` as [`shares`] gives them, from
    /// the beginning of `over` on.
    pub(super) fn controls(
        &self,
        body: &PoseBar,
        shares: &[f64],
        steps: usize,
    ) -> impl Iterator<Item = Control> {
        (self.from..steps).map(move |step| {
            if step >= self.until {
                return [0.0; 6];
            }
            let share = step.checked_sub(self.over.start).map_or(1.0, |later| shares[later]);
            PoseBar { position: body.position * share, ..*body }.components()
        })
    }

    /// Whether all of it is within a motion of so many steps.
    pub(super) fn fits(&self, steps: usize) -> bool {
        let Self { from, until, over, .. } = self;
        0 < *from && *from <= over.start && over.start < over.end && over.end <= *until && *until <= steps
    }
}

/// How many of these places are on the tool, or within `room_m` of it.
pub(super) fn held_by_tool(scene: &Scene, tool: &Pose, positions: &[[f64; 3]], room_m: f64) -> u32 {
    positions.iter().filter(|x| held_within(scene, tool, x, room_m)).count() as u32
}

/// How much of the powder that leaves the body is still on it, by what is on it at the beginning of each control step and at the end.
pub(super) fn shares(on_body: &[u32]) -> Vec<f64> {
    let most = on_body.iter().copied().max().unwrap_or(0);
    let least = on_body.last().copied().unwrap_or(0);
    let leaving = f64::from(most.saturating_sub(least));
    let share = |now: &u32| if leaving > 0.0 { f64::from(now.saturating_sub(least)) / leaving } else { 1.0 };
    on_body.iter().map(share).collect()
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
    /// the loss does not see. `pose` is what the tool's pose has before: without the powder on it, or with it, as one `body`.
    pub(super) fn restart(
        &self,
        particles: &Particles<T>,
        values: &[Option<f64>],
        bar: &mut [Group<T>],
        (pose, body): (&PoseBar, bool),
    ) -> (PoseBar, CutReport) {
        let (positions, velocities) = (particles.positions_by_id(), particles.velocities_by_id());
        let ahead_s = self.restarts.ahead_s;
        let ahead = |(x, v): (&[f64; 3], &[f64; 3])| [0, 1, 2].map(|axis| x[axis] + ahead_s * v[axis]);
        let places: Vec<[f64; 3]> = positions.iter().zip(&velocities).map(ahead).collect();
        let slopes = self.slopes(&places, values);
        let mut report = CutReport::new(self.step, pose);
        let mut new = *pose;
        // Of the bed's grains.
        let mut beside = vec![None; positions.len()];
        for (g, l, id) in particles.occupied() {
            let id = id as usize;
            let (x, slope) = (positions[id], Vector3::from(slopes[id]));
            let exact = Vector3::from([0, 1, 2].map(|axis| bar[g].x[axis][l].to_f64()));
            let carried = self.is_carried(&x);
            report.population(carried, &velocities[id]).take(&exact, &slope);
            if carried {
                let before = if body { Vector3::zeros() } else { exact };
                new.push(&(Vector3::from(x) - self.tool.position_m), &(before - slope));
            } else if self.restarts.through_bed && !body {
                beside[id] = Some(exact - slope);
            }
            bar[g].copy_lane(l, &Group::ZERO, l);
            set_vec(&mut bar[g].v, l, slopes[id].map(|slope| T::from_f64(ahead_s * slope)));
        }
        let kept = self.spread(&positions, &beside);
        for (g, l, id) in particles.occupied() {
            let whole = Vector3::from(slopes[id as usize]) + kept[id as usize];
            set_vec(&mut bar[g].x, l, [0, 1, 2].map(|axis| T::from_f64(whole[axis])));
        }
        report.tool_after = new.components();
        (new, report)
    }

    fn is_carried(&self, x: &[f64; 3]) -> bool {
        held_within(self.scene, &self.tool, x, self.restarts.room_m)
    }

    /// Slopes of what grains cost, by identity, metres per metre. Each is a sum over neighbours in the order of their cells and identities,
    /// so its bits depend on nothing else.
    pub(super) fn slopes(&self, positions: &[[f64; 3]], values: &[Option<f64>]) -> Vec<[f64; 3]> {
        let (cells, walls) = (Cells::new(positions, self.restarts.radius_m), self.walls());
        let slope = |id: usize| {
            let mut sums = Sums::new(self.restarts.radius_m);
            let known = |other: usize| values[other].is_some();
            self.neighbours((&cells, &walls), positions, (id, &known), |other, away| {
                sums.take(away, values[other].expect("known"));
            });
            sums.slope()
        };
        (0..positions.len()).into_par_iter().map(slope).collect()
    }

    /// What each grain has, shared out among those of its neighbourhood that have something, by the weights of the slopes: the sums stay.
    /// By identity, as `shares`.
    fn spread(&self, positions: &[[f64; 3]], shares: &[Option<Vector3<f64>>]) -> Vec<Vector3<f64>> {
        if shares.iter().all(Option::is_none) {
            return vec![Vector3::zeros(); positions.len()];
        }
        let (cells, walls) = (Cells::new(positions, self.restarts.radius_m), self.walls());
        let square_m2 = self.restarts.radius_m * self.restarts.radius_m;
        let has = |other: usize| shares[other].is_some();
        let sum = |id: usize, of: &mut dyn FnMut(usize, f64)| {
            self.neighbours((&cells, &walls), positions, (id, &has), |other, away| {
                of(other, weight(&Vector3::from(*away), square_m2));
            });
        };
        let whole: Vec<Option<f64>> = (0..positions.len())
            .into_par_iter()
            .map(|id| {
                let mut whole = 0.0;
                shares[id]?;
                sum(id, &mut |_, weight| whole += weight);
                Some(whole)
            })
            .collect();
        let gathered = |id: usize| {
            let mut kept = Vector3::zeros();
            if has(id) {
                // What goes from the one to the other weighs as much as what goes back.
                sum(id, &mut |other, weight| {
                    if let (Some(share), Some(whole)) = (shares[other], whole[other]) {
                        kept += share * (weight / whole);
                    }
                });
            }
            kept
        };
        (0..positions.len()).into_par_iter().map(gathered).collect()
    }

    /// Those within the radius of a grain that are wanted and between which and it there is no wall, itself among them, and how far
    /// away they are.
    fn neighbours(
        &self,
        (cells, walls): (&Cells, &[Wall<'_, T>]),
        positions: &[[f64; 3]],
        (id, is_wanted): (usize, &dyn Fn(usize) -> bool),
        mut visit: impl FnMut(usize, &[f64; 3]),
    ) {
        let radius_m = self.restarts.radius_m;
        let near: Vec<Wall<'_, T>> =
            walls.iter().filter(|wall| wall.distance_m(&positions[id]) < radius_m).copied().collect();
        cells.around(&positions[id], |other| {
            let away = [0, 1, 2].map(|axis| positions[other][axis] - positions[id][axis]);
            let reaches = away.iter().map(|x| x * x).sum::<f64>() < radius_m * radius_m;
            if reaches && is_wanted(other) && !parted(&near, &positions[id], &away) {
                visit(other, &away);
            }
        });
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

/// What a neighbour counts.
fn weight(away: &Vector3<f64>, radius_squared_m2: f64) -> f64 {
    let left = 1.0 - away.norm_squared() / radius_squared_m2;
    left * left
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

    fn take(&mut self, away: &[f64; 3], value: f64) {
        let d = Vector3::from(*away);
        let w = weight(&d, self.square_m2);
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
            let restarts = Restarts::of_skill(&scene, &map, &Theta::MIDDLE);
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
    fn what_is_spread_stays_the_same_in_sum_and_nearby() {
        let case = Case::new();
        let places = grains([0.030, 0.030, 0.006], [12, 12, 8]);
        let share = |id: usize| Vector3::new(id as f64, -1.0, (id % 7) as f64);
        let mut shares: Vec<_> = (0..places.len()).map(|id| Some(share(id))).collect();
        let cut = case.cut();
        let sum = |all: &[Vector3<f64>]| all.iter().sum::<Vector3<f64>>();
        let kept = cut.spread(&places, &shares);
        let before = sum(&shares.iter().flatten().copied().collect::<Vec<_>>());
        assert!((sum(&kept) - before).norm() < 1e-12 * before.norm());
        assert!(kept.iter().all(|kept| (kept.y + 1.0).abs() < 0.5), "what all have, all keep");
        // One that has nothing gets nothing.
        let left_out = places.len() / 2;
        shares[left_out] = None;
        assert_eq!(cut.spread(&places, &shares)[left_out], Vector3::zeros());
        // What one has goes no further than its neighbourhood.
        let (from, radius_m) = (places[left_out], case.restarts.radius_m);
        shares.fill(Some(Vector3::zeros()));
        shares[left_out] = Some(Vector3::x());
        for (kept, place) in cut.spread(&places, &shares).iter().zip(&places) {
            let away_m = (Vector3::from(*place) - Vector3::from(from)).norm();
            assert_eq!(kept.x > 0.0, away_m < radius_m, "{away_m}");
        }
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
            let shares: Vec<_> = values.iter().map(|value| value.map(|value| Vector3::x() * value)).collect();
            let spread = case.cut().spread(&places, &shares);
            let gets = spread.iter().zip(&values).any(|(got, had)| *had == Some(0.0) && got.x > 0.0);
            assert_eq!(gets, from_z_m > 0.02, "what is spread goes through no wall either");
            slopes.iter().map(|slope| slope[0].abs()).fold(0.0, f64::max)
        };
        assert!(steepest(0.010) < 1e-9, "{}", steepest(0.010));
        assert!(steepest(0.040) > 1.0, "{}", steepest(0.040));
    }

    /// What moving and turning tool and powder as one costs is the same after a restart: as the exact cotangents have it, or as measured.
    #[test]
    fn the_resultants_of_what_is_carried_and_of_the_bed_stay() {
        let case = Case::new();
        let p: [f64; 3] = case.tool.position_m.into();
        // On the tool, and far from it.
        let mut places = grains([p[0] - 0.006, p[1] - 0.006, p[2] - 0.006], [6, 6, 4]);
        places.extend(grains([0.160, 0.040, 0.006], [6, 6, 4]));
        let particles = Particles::<f64>::at_rest(&places);
        let values: Vec<_> = places.iter().map(|x| Some(libm::sin(300.0 * x[0]))).collect();
        let pose = PoseBar { position: [3.0, 1.0, -2.0].into(), rotation: [0.5, 0.0, 1.0].into() };
        let cut = case.cut();
        let all_of = |bar: &[Group<f64>], pose: &PoseBar| {
            let mut all = *pose;
            for (g, l, id) in particles.occupied().filter(|(_, _, id)| cut.is_carried(&places[*id as usize]))
            {
                let arm = Vector3::from(places[id as usize]) - case.tool.position_m;
                all.push(&arm, &[0, 1, 2].map(|k| bar[g].x[k][l]).into());
            }
            all
        };
        let bed_of = |bar: &[Group<f64>]| -> Vector3<f64> {
            let bed = particles.occupied().filter(|(_, _, id)| !cut.is_carried(&places[*id as usize]));
            bed.map(|(g, l, _)| Vector3::from([0, 1, 2].map(|k| bar[g].x[k][l]))).sum()
        };
        for body in [false, true] {
            let mut bar = vec![Group::ZERO; particles.groups.len()];
            for (g, l, id) in particles.occupied() {
                set_vec(&mut bar[g].x, l, [f64::from(id % 7), 1.0, -f64::from(id % 3)]);
                bar[g].q[0][l] = 5.0;
            }
            let before = if body { pose } else { all_of(&bar, &pose) };
            let bed_before = bed_of(&bar);
            let (new, report) = cut.restart(&particles, &values, &mut bar, (&pose, body));
            let after = all_of(&bar, &new);
            assert!(report.carried.grains > 50 && report.resting.grains > 50);
            assert!(
                (new.position - pose.position).norm() > 1.0 && (new.rotation - pose.rotation).norm() > 1e-3
            );
            assert!((before.position - after.position).norm() < 1e-9, "{before:?} {after:?}");
            assert!((before.rotation - after.rotation).norm() < 1e-9, "{before:?} {after:?}");
            // The bed keeps its sum as well, but from where nothing came back.
            assert_eq!(body, (bed_of(&bar) - bed_before).norm() > 1e-9);
            assert!(particles.occupied().all(|(g, l, _)| bar[g].q[0][l] == 0.0));
            assert_eq!(report.tool_after.map(f64::to_bits), new.components().map(f64::to_bits));
            assert!(particles.occupied().all(|(g, l, _)| (0..3).all(|k| bar[g].v[k][l] == 0.0)));
        }
        // Powder that is compared by where it will be has a slope by its velocity as well.
        let ahead = Restarts { ahead_s: 0.02, through_bed: false, ..case.restarts.clone() };
        let mut bar = vec![Group::ZERO; particles.groups.len()];
        Cut { restarts: &ahead, ..cut }.restart(&particles, &values, &mut bar, (&pose, false));
        let is_near = |[v, x]: [f64; 2]| (v - 0.02 * x).abs() < 1e-12;
        let ratio =
            |(g, l, _): (usize, usize, u32)| (0..3).all(|k| is_near([bar[g].v[k][l], bar[g].x[k][l]]));
        assert!(
            particles.occupied().all(ratio) && bar.iter().any(|group| group.v[0].iter().any(|v| *v != 0.0))
        );
    }

    /// With an overlap the pour may begin before the lift ends, and then they are one body from there on.
    #[test]
    fn tool_and_powder_are_one_body_before_they_pour() {
        let scene = Scene::load("bench").unwrap().with(|spec| spec.skill.overlap = 1.0).unwrap();
        let map = SkillMap::new(&scene);
        // A high lift, a short transport, a wide pour; and the middle of all.
        for (theta, early) in [(Theta::clamped([0.0, 0.0, 1.0, -1.0, 1.0]), true), (Theta::MIDDLE, false)] {
            let carrying = Restarts::of_skill(&scene, &map, &theta).carrying.unwrap();
            let lift = map.segments(&theta)[3];
            assert!(carrying.fits(map.controls(&theta).unwrap().len()));
            assert_eq!((carrying.from as f64) < (lift.end_s / 0.01).round(), early, "{carrying:?} {lift:?}");
        }
    }

    /// A loss that is linear in how far the body is moved and turned has that slope along the ways, however many, and none beside them.
    #[test]
    fn the_ways_tell_what_moving_the_body_costs() {
        let mut scene = Scene::load("bench").unwrap();
        scene.skill.heading_deg = 30.0;
        let map = SkillMap::new(&scene);
        let [carrying, of_path, of_less] =
            [&[][..], &[Freedom::Yaw, Freedom::Up, Freedom::Sideways], &[Freedom::Up]]
                .map(|freedoms| Restarts::of_path(&scene, &map, &Theta::MIDDLE, freedoms).carrying.unwrap());
        let controls: Vec<Displacement> = map.controls(&Theta::MIDDLE).unwrap();
        assert!(carrying.fits(controls.len()) && carrying.ways.len() == 3);
        assert_eq!(carrying, Restarts::of_skill(&scene, &map, &Theta::MIDDLE).carrying.unwrap());
        // What a path may do beside it is looked at, too, and what it may not do is, as the skill's own.
        assert_eq!(carrying, of_less);
        let beside: Vec<[f64; 6]> = of_path.ways[3..].iter().map(Displacement::components).collect();
        let [forward, _, tilt] = [0, 1, 2].map(|way| carrying.ways[way].components());
        let size = |way: &[f64; 6]| libm::sqrt(way.iter().map(|x| x * x).sum());
        let yaw = [0.0, 0.0, 0.0, 0.0, 0.0, size(&tilt)];
        let sideways = [-forward[1], forward[0], 0.0, 0.0, 0.0, 0.0];
        let is_near = |(found, expected): (&[f64; 6], [f64; 6])| {
            found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15)
        };
        assert!(beside.len() == 2 && beside.iter().zip([yaw, sideways]).all(is_near), "{beside:?}");
        // Of many particles losses are large, and must not run over.
        for scale in [1.0, 1e6] {
            the_body_has_the_slopes(&carrying, &controls, scale);
        }
    }

    fn the_body_has_the_slopes(carrying: &Carrying, controls: &[Displacement], scale: f64) {
        let slope = [2.0, -1.0, 5.0, 0.5, 3.0, -4.0];
        let loss = |moved: &[Displacement]| {
            let change = |(moved, usual): (&Displacement, &Displacement)| {
                let both = moved.components().into_iter().zip(usual.components());
                both.zip(slope).map(|((a, b), slope)| (a - b) * slope).sum::<f64>()
            };
            7.0 + scale * moved.iter().zip(controls).map(change).sum::<f64>()
        };
        let found = |carrying: &Carrying| {
            let ends = |way| [1.0, -1.0].map(|sign| loss(&carrying.moved(controls, way, sign)));
            carrying.body(&carrying.ways.iter().map(ends).collect::<Vec<_>>()).components()
        };
        let assert_near = |found: [f64; 6], expected: [f64; 6]| {
            let off = |(a, b): (&f64, f64)| (a / scale - b).abs();
            let is_near = found.iter().zip(expected).map(off).all(|off| off < 1e-8);
            assert!(is_near, "{found:?} {expected:?}");
        };
        let (sin, cos) = libm::sincos(30.0f64.to_radians());
        let (forward, tilt) = (2.0 * cos - sin, 3.0 * cos - 0.5 * sin);
        assert_near(found(carrying), [forward * cos, forward * sin, 5.0, -tilt * sin, tilt * cos, 0.0]);
        // Along the axes.
        let along =
            |axis: usize| Displacement::from(std::array::from_fn(|k| if k == axis { 0.002 } else { 0.0 }));
        for count in [0, 1, 3, 6] {
            let some = Carrying { ways: (0..count).map(along).collect(), ..carrying.clone() };
            assert_near(found(&some), std::array::from_fn(|k| if k < count { slope[k] } else { 0.0 }));
        }
    }

    #[test]
    fn what_has_left_counts_no_more() {
        assert_eq!(shares(&[100, 100, 60, 20, 20]), [1.0, 1.0, 0.5, 0.0, 0.0]);
        assert_eq!(shares(&[30, 30]), [1.0, 1.0]);
        assert!(shares(&[]).is_empty());
        // The force fades with what is left on the body, the moment ends with the pour.
        let carrying = Carrying { from: 2, over: 3..5, until: 6, ways: Vec::new(), sleep_speed_m_s: 0.0 };
        let body = PoseBar { position: [4.0, 0.0, 0.0].into(), rotation: [0.0, 3.0, 0.0].into() };
        let controls: Vec<_> = carrying.controls(&body, &[1.0, 0.5, 0.25, 0.0, 0.0], 8).collect();
        let force_and_moment = controls.iter().map(|control| [control[0], control[4]]);
        let expected = [[4.0, 3.0], [4.0, 3.0], [2.0, 3.0], [1.0, 3.0], [0.0, 0.0], [0.0, 0.0]];
        assert!(force_and_moment.eq(expected), "{controls:?}");
    }

    #[test]
    fn cuts_go_by_the_skill() {
        let case = Case::new();
        let map = SkillMap::new(&case.scene);
        let Restarts { steps, carrying, .. } = &case.restarts;
        let carrying = carrying.as_ref().unwrap();
        let ends: Vec<usize> = map
            .segments(&Theta::MIDDLE)
            .iter()
            .map(|segment| (segment.end_s / case.scene.time.control_period_s()).round() as usize)
            .collect();
        let [_, _, scoop, lift, transport, pour] = ends[..] else { panic!("{ends:?}") };
        assert!(steps.len() == 6 && steps.windows(2).all(|pair| pair[0] < pair[1]), "{steps:?}");
        assert_eq!((steps[3], carrying.from, carrying.over.clone()), (scoop, lift, transport..pour));
        assert!(steps[5] < lift, "{steps:?}");
        assert_eq!(carrying.until, pour);
    }
}
