//! Powder at rest sleeps: it is left alone until something happens to it.
//!
//! A block of particles whose speeds `|v|` and `|C| dx` have stayed below the scene's `sleep_speed_m_s` for [`QUIET_S`], and
//! that the tool is not near, falls asleep: its particles stay as they are, and what they send to the grid stays what it
//! was, so that neighbours that are awake still rest on it. Nodes to which sleepers alone send are not computed. It wakes when the
//! tool comes within [`TOOL_MARGIN_CELLS`], when a gate that moves or has just gone is as near, when one of its nodes moves
//! otherwise than when it fell asleep, by more than a multiple of that speed, or when a sort brings it a new particle or
//! takes one away. Above a free surface there are nodes with so little mass that gravity moves them in every substep, and no
//! particle with them: hence otherwise. Beside a gate that stays where it is a block sleeps as beside a wall.
//!
//! | | `sleep_by = "largest"` | `sleep_by = "mean_square"` |
//! |---|---|---|
//! | speeds of a block | of its fastest particle | root of the mean square over its particles |
//! | which are | `v` of the grid, `C dx` | `v` after contact, `C dx/2` |
//! | nodes that wake | all to which it sends | those to which it sends [`LIGHT_NODE`] of the mass of a full one, and more |
//! | when they change by more than | [`WAKE_RATIO`] `sleep_speed_m_s` | [`WAKE_RATIO_OF_MEAN`] `sleep_speed_m_s` |
//!
//! Where powder is thinner than a cell, at the foot of a heap and on its surface, some particle moves all the time: it hangs on nodes
//! that are nearly empty, which fall by `g dt` in every substep and pull it along by a multiple of that, until a floor holds it. By its largest
//! speed such a block never sleeps, and creeps. By the mean one that rests but for a single grain sleeps too, and the grain with it: one that is
//! slower than `sleep_speed_m_s sqrt(n)` among `n`.
//!
//! A sleeper sends the momentum with which it fell asleep for as long as it sleeps (`sleepers = "moving"`), which draws along what is awake
//! beside it: a block of powder that should stick to an incline creeps by 2.2 mm/s, with powder that never sleeps by 0.3. With `sleepers =
//! "still"` it sends its mass and its stress alone.
//!
//! Backwards a sleeper's cotangents stay as they are, like its particles: how its weight on its neighbours depends on them is
//! left out. What these decisions remember is part of the state, and gates go by time, so a rollout that restarts from a state
//! repeats them.

use std::sync::Arc;

use crate::mpm::Model;
use crate::mpm::bodies::Bodies;
use crate::mpm::layout::{Block, Layout, Nodes, any_shared, empty_tile, load_tile};
use crate::mpm::p2g::ParticlesToTile;
use crate::mpm::particles::{EMPTY_LANE, Group, LANES, Lanes, vec_of};
use crate::mpm::stencil::{TILE_LENGTH, Tile};
use crate::mpm::stencil_positions::ALL_NEIGHBOURS;
use crate::real::Real;
use crate::scene::{Domain, Scene, SleepBy, Sleepers};
use crate::small::dot;

/// How long a block has to be quiet before it falls asleep, s.
pub(crate) const QUIET_S: f64 = 0.03;
/// Distance from the tool, or from a gate that stirs, to the nearest cell that may sleep, in cells.
pub(crate) const TOOL_MARGIN_CELLS: usize = 2;
/// Change of a node's velocity that wakes, over the speed of particles that may sleep: over the largest one, and over a mean.
pub(crate) const WAKE_RATIO: f64 = 2.0;
pub(crate) const WAKE_RATIO_OF_MEAN: f64 = 5.0;
/// A node with less of the mass of a full one is light.
pub(crate) const LIGHT_NODE: f64 = 0.05;
/// `|C| dx` of particles that may sleep by the mean, over their speed.
const AFFINE_RATIO_OF_MEAN: f64 = 2.0;

/// Who may sleep, and what wakes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SleepLaw<T> {
    by: SleepBy,
    sleepers: Sleepers,
    /// Speed below which powder may sleep, m/s; 0: it never does.
    speed: T,
    /// Substeps for which it has to be quiet before.
    quiet_substeps: u32,
    /// What a block sends to a node that can wake it is more than this, kg.
    light_mass: T,
}

impl<T: Real> SleepLaw<T> {
    /// Of a scene, in substeps of so many seconds.
    pub(crate) fn of(scene: &Scene, dt: f64) -> Self {
        let Domain { cell_m, sleep_by: by, sleepers, sleep_speed_m_s, .. } = scene.domain;
        let light = if by == SleepBy::MeanSquare { LIGHT_NODE } else { 0.0 };
        Self {
            by,
            sleepers,
            speed: T::from_f64(sleep_speed_m_s),
            quiet_substeps: (QUIET_S / dt).ceil() as u32,
            light_mass: T::from_f64(light * scene.powder.density_kg_m3 * cell_m * cell_m * cell_m),
        }
    }

    /// Of powder that falls asleep below this speed, m/s, by its fastest particle.
    pub(crate) fn with_speed(&self, speed_m_s: f64) -> Self {
        Self { by: SleepBy::Largest, speed: T::from_f64(speed_m_s), light_mass: T::ZERO, ..*self }
    }

    pub(crate) fn may_sleep(&self) -> bool {
        self.speed > T::ZERO
    }

    /// Whether a node of this mass can wake anybody.
    #[inline(always)]
    pub(crate) fn has_weight(&self, mass: T) -> bool {
        mass > self.light_mass
    }

    /// Whether a node of this velocity can wake those who send to it; one that is no number does.
    #[inline(always)]
    pub(crate) fn can_wake(&self, &[x, y, z, _]: &[T; 4]) -> bool {
        let ratio = if self.by == SleepBy::MeanSquare { WAKE_RATIO_OF_MEAN } else { WAKE_RATIO };
        let limit = T::from_f64(ratio) * self.speed;
        let still = dot([x, y, z], [x, y, z]) <= limit * limit;
        !still
    }
}

/// How fast a block's particles are.
pub(crate) struct Speeds<T> {
    by_mean: bool,
    /// Squares of what `|v|` and `|C|` may be.
    limits: [T; 2],
    /// Of each, lane by lane: how many are not below; or the sum of the squares.
    found: [Lanes<T>; 2],
}

impl<T: Real> Speeds<T> {
    #[inline(always)]
    pub(crate) fn new(model: &Model<T>) -> Self {
        let (by_mean, speed) = (model.sleep.by == SleepBy::MeanSquare, model.sleep.speed);
        let affine = if by_mean { T::from_f64(AFFINE_RATIO_OF_MEAN) * speed } else { speed };
        let limits = [speed, affine * model.inverse_dx].map(|limit| limit * limit);
        Self { by_mean, limits, found: [Lanes::ZERO; 2] }
    }

    /// Adds a group's velocities, before contact at the particles and after it, and squares of `|C|`.
    #[inline(always)]
    pub(crate) fn add(&mut self, [before, after]: [&[Lanes<T>; 3]; 2], rates: &Lanes<T>, occupied: usize) {
        let v = if self.by_mean { after } else { before };
        for l in 0..LANES {
            let squares = [dot(vec_of(v, l), vec_of(v, l)), rates[l]];
            for k in 0..2 {
                // What is no number is not below.
                let is_below = squares[k] < self.limits[k];
                let new = if self.by_mean { squares[k] } else { T::ONE.only_if(!is_below) };
                self.found[k][l] += new.only_if(l < occupied);
            }
        }
    }

    /// Whether so many particles are slow enough to sleep.
    #[inline(always)]
    pub(crate) fn are_quiet(&self, particles: usize) -> bool {
        let is_quiet = |(found, limit): (&Lanes<T>, T)| {
            let sum = found.iter().fold(T::ZERO, |sum, lane| sum + *lane);
            if self.by_mean { sum < T::from_f64(particles as f64) * limit } else { sum == T::ZERO }
        };
        self.found.iter().zip(self.limits).all(is_quiet)
    }
}

/// What is to be known of a block's rest.
#[derive(Clone, Debug)]
pub(crate) struct SleepState<T> {
    /// Substeps for which it has been quiet.
    quiet: u32,
    /// If it sleeps.
    sleeper: Option<Arc<SleepingBlock<T>>>,
}

/// A block that sleeps.
#[derive(Debug)]
struct SleepingBlock<T> {
    /// What its particles send to the grid.
    tile: Tile<T>,
    /// To which neighbours.
    reached: u32,
    /// Its nodes that could wake it already when it fell asleep, in order, and their velocities then.
    unquiet: Vec<(u16, [T; 4])>,
    /// The particles. All states in which it sleeps share them, and need not have them among their own.
    groups: Vec<Group<T>>,
}

/// What grid to particles has seen of a block that is awake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct BlockStatus {
    /// All particles are within the reach of their tile.
    pub(crate) inside: bool,
    /// All particles are slower than the speed below which powder may sleep.
    pub(crate) quiet: bool,
}

impl BlockStatus {
    /// What is seen of a sleeper.
    pub(crate) const ASLEEP: Self = Self { inside: true, quiet: true };
}

impl<T: Copy> SleepState<T> {
    pub(crate) const AWAKE: Self = Self { quiet: 0, sleeper: None };

    pub(crate) fn is_asleep(&self) -> bool {
        self.sleeper.is_some()
    }

    /// What a sleeper sends to the grid, and to which neighbours.
    #[inline(always)]
    pub(crate) fn sent(&self) -> Option<(&Tile<T>, u32)> {
        self.sleeper.as_ref().map(|sleeper| (&sleeper.tile, sleeper.reached))
    }

    /// Puts a sleeper's particles where they belong.
    pub(crate) fn restore_into(&self, groups: &mut [Group<T>]) {
        if let Some(sleeper) = &self.sleeper {
            groups.copy_from_slice(&sleeper.groups);
        }
    }
}

/// Every block awake.
pub(crate) fn all_awake<T: Copy>(layout: &Layout) -> Vec<SleepState<T>> {
    layout.blocks.iter().map(|_| SleepState::AWAKE).collect()
}

impl<T: Real> SleepingBlock<T> {
    /// Whether this velocity of the tile's node wakes it.
    fn is_woken_by(&self, model: &Model<T>, at: usize, now: &[T; 4]) -> bool {
        if !self.is_woken_at(model, at) || !model.sleep.can_wake(now) {
            return false;
        }
        match self.unquiet.binary_search_by_key(&at, |(node, _)| usize::from(*node)) {
            Ok(found) => {
                let (_, then) = self.unquiet[found];
                model.sleep.can_wake(&std::array::from_fn(|k| now[k] - then[k]))
            }
            Err(_) => true,
        }
    }

    /// Whether a node of its tile can wake it at all.
    fn is_woken_at(&self, model: &Model<T>, at: usize) -> bool {
        model.sleep.has_weight(self.tile[at][3])
    }
}

/// Whether a sleeper is disturbed. `moving` are the node blocks in which any node moves so fast that it could.
pub(crate) fn is_disturbed<T: Real>(
    model: &Model<T>,
    block: &Block,
    rest: &SleepState<T>,
    velocity: &[Nodes<T>],
    moving: &[bool],
) -> bool {
    let Some(sleeper) = &rest.sleeper else { return false };
    any_shared(
        block,
        |neighbour, node_block| moving[node_block] && sleeper.reached >> neighbour & 1 == 1,
        |node_block, node, at| sleeper.is_woken_by(model, at, &velocity[node_block][node]),
    )
}

/// The rest of a block after a substep.
pub(crate) fn next_state<T: Real>(
    model: &Model<T>,
    bodies: &Bodies<T>,
    block: &Block,
    before: &SleepState<T>,
    seen: BlockStatus,
    disturbed: bool,
) -> SleepState<T> {
    if model.obstacles.is_stirred(&model.grid, block.coord, bodies, TOOL_MARGIN_CELLS) {
        return SleepState::AWAKE;
    }
    let near = || model.obstacles.tool_is_near(&model.grid, block.coord, &bodies.tool, TOOL_MARGIN_CELLS);
    if before.is_asleep() {
        return if disturbed || near() { SleepState::AWAKE } else { before.clone() };
    }
    if !seen.quiet {
        return SleepState::AWAKE;
    }
    let quiet = before.quiet.saturating_add(1);
    // Quiet long enough, but held awake by the tool: it waits.
    let quiet =
        if quiet >= model.sleep.quiet_substeps && near() { model.sleep.quiet_substeps - 1 } else { quiet };
    SleepState { quiet, sleeper: None }
}

/// Lets those fall asleep that have been quiet long enough. The nodes are those of this layout.
pub(crate) fn fall_asleep<T: Real>(
    model: &Model<T>,
    layout: &Layout,
    velocity: &[Nodes<T>],
    groups: &[Group<T>],
    rest: &mut [SleepState<T>],
) {
    let (mut unused, mut velocities) = (Vec::new(), empty_tile());
    for (block, rest) in layout.blocks.iter().zip(rest) {
        if rest.is_asleep() || rest.quiet < model.sleep.quiet_substeps {
            continue;
        }
        let groups = &groups[block.first_group..block.first_group + block.groups()];
        unused.resize(groups.len(), Group::ZERO);
        let (tile, groups_asleep) = (empty_tile(), groups.to_vec());
        let mut sleeper = SleepingBlock { tile, reached: 0, unquiet: Vec::new(), groups: groups_asleep };
        let still: Vec<Group<T>>;
        let sends = match model.sleep.sleepers {
            Sleepers::Moving => groups,
            Sleepers::Still => {
                still = groups.iter().map(Group::at_rest).collect();
                &still
            }
        };
        let (from, state, tile) = (Some(sends), &mut unused[..], &mut sleeper.tile);
        sleeper.reached =
            model.arch.dispatch(ParticlesToTile { model, block, from, state, tile, unforced: None });
        load_tile(block, velocity, ALL_NEIGHBOURS, &mut velocities);
        let unquiet = |at: &usize| sleeper.is_woken_at(model, *at) && model.sleep.can_wake(&velocities[*at]);
        sleeper.unquiet = (0..TILE_LENGTH).filter(unquiet).map(|at| (at as u16, velocities[at])).collect();
        rest.sleeper = Some(Arc::new(sleeper));
    }
}

/// What is left of rest after a sort: that of blocks which have the same particles as before. `order` is where each lane came
/// from, and `groups` are the particles after it.
pub(crate) fn after_sort<T: Copy>(
    before: &[SleepState<T>],
    old: &Layout,
    new: &Layout,
    order: &[u32],
    groups: &[Group<T>],
) -> Vec<SleepState<T>> {
    let rest_of = |block: &Block| {
        let range = block.first_group..block.first_group + block.groups();
        let places = &order[range.start * LANES..range.start * LANES + block.particles];
        let group_of = |place: u32| place as usize / LANES;
        let b = old.blocks.partition_point(|old| old.first_group <= group_of(places[0])) - 1;
        let old_block = &old.blocks[b];
        let old_groups = old_block.first_group..old_block.first_group + old_block.groups();
        let mut lanes = places.iter().filter(|place| **place != EMPTY_LANE);
        if old_block.particles != block.particles
            || !lanes.all(|place| old_groups.contains(&group_of(*place)))
        {
            return SleepState::AWAKE;
        }
        let in_order = places.iter().zip(old_groups.start * LANES..).all(|(place, at)| *place as usize == at);
        match &before[b].sleeper {
            Some(sleeper) if !in_order => {
                let sleeper = SleepingBlock {
                    groups: groups[range].to_vec(),
                    unquiet: sleeper.unquiet.clone(),
                    ..**sleeper
                };
                SleepState { quiet: before[b].quiet, sleeper: Some(Arc::new(sleeper)) }
            }
            _ => before[b].clone(),
        }
    };
    new.blocks.iter().map(rest_of).collect()
}
