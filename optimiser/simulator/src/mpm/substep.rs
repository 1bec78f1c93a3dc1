//! One substep of all particles, forward and adjoint, and the sorting between substeps.

use std::sync::Arc;

use rayon::prelude::*;

use crate::mpm::Model;
use crate::mpm::bodies::Bodies;
use crate::mpm::connect::connected_anew;
use crate::mpm::contact::BodyStateBar;
use crate::mpm::g2p::{TileToParticles, TileToParticlesAdjoint};
use crate::mpm::grid_update::{UnforcedNodesBar, UpdateNodes, UpdateNodesAdjoint};
use crate::mpm::layout::{Block, Layout, Nodes, empty_tile};
use crate::mpm::p2g::{ParticlesToTile, ParticlesToTileAdjoint, ReturnMap, ReturnMapAdjoint};
use crate::mpm::particles::{Group, LANES, Particles};
use crate::mpm::sleep::{self, BlockStatus, SleepState};
use crate::mpm::sort::{EscapedParticle, Sorted, sort, sort_adjoint, sort_by_faces};
use crate::mpm::spare::{BufferPool, Size, fit, state_bytes};
use crate::mpm::stencil::Tile;
use crate::mpm::tiles::Tiles;
use crate::mpm::timings::{Pass, Stage, StageTimings};
use crate::mpm::walls::{self, LOOK_EVERY};
use crate::real::Real;

/// Most blocks in one parallel task. Blocks differ in their particles, so larger tasks would leave threads idle.
const MAX_BLOCKS: usize = 4;

/// The state at the beginning of a substep.
#[derive(Clone, Debug)]
pub(crate) struct State<T> {
    pub(crate) particles: Particles<T>,
    pub(crate) layout: Arc<Layout>,
    /// If the particles were sorted on the way here: where each came from, and how many groups there were.
    pub(crate) sorted_from: Option<(Arc<[u32]>, usize)>,
    /// Substeps since the last sort of all.
    age: u32,
    /// Substeps since volumes were held to the grid's density.
    since_held: u32,
    /// Of each block.
    rest: Vec<SleepState<T>>,
}

/// Substeps after which particles are sorted even if they could go on: fewer of a group are then in the same cell, and those
/// in the same cell are what transfers do at once.
const SORT_EVERY: u32 = 100;

/// Volumes are held to the grid's density in one of so many substeps: in 2 ms powder comes together by a fiftieth at most.
pub(crate) const HOLD_EVERY: u32 = 4;

impl<T: Real> State<T> {
    /// Whether volumes are held in the substep that begins here.
    pub(crate) fn holds_volume(&self, model: &Model<T>) -> bool {
        model.holds_volume && self.since_held == 0
    }

    /// Sorted state of the given particles.
    pub(crate) fn new(
        model: &Model<T>,
        bodies: &Bodies<T>,
        particles: &Particles<T>,
    ) -> Result<Self, EscapedParticle> {
        let (particles, layout, _) = sort(model, bodies, particles, &mut BufferPool::empty())?;
        let rest = sleep::all_awake(&layout);
        Ok(Self { particles, layout: Arc::new(layout), sorted_from: None, age: 0, since_held: 0, rest })
    }

    /// Nothing, to be written to.
    pub(crate) fn empty() -> Self {
        let layout = Arc::new(Layout::empty());
        let particles = Particles { groups: Vec::new(), ids: Arc::new([]) };
        Self { particles, layout, sorted_from: None, age: 0, since_held: 0, rest: Vec::new() }
    }

    /// The same again.
    pub(crate) fn copied(&self, spare: &mut BufferPool<T>) -> Self {
        let mut groups = spare.acquire_groups(self.particles.groups.len());
        groups.copy_from_slice(&self.particles.groups);
        Self {
            particles: Particles { groups, ids: Arc::clone(&self.particles.ids) },
            layout: Arc::clone(&self.layout),
            sorted_from: self.sorted_from.clone(),
            rest: self.rest.clone(),
            ..*self
        }
    }

    /// Is no longer needed.
    pub(crate) fn recycle_into(self, spare: &mut BufferPool<T>) {
        spare.return_groups(self.particles.groups);
    }

    /// One substep more than these.
    fn count(&mut self, age: u32, since_held: u32) {
        self.age = age + 1;
        self.since_held = (since_held + 1) % HOLD_EVERY;
    }

    /// Sorts.
    fn sort(
        &mut self,
        model: &Model<T>,
        bodies: &Bodies<T>,
        spare: &mut BufferPool<T>,
    ) -> Result<(), EscapedParticle> {
        self.fill();
        let sorted = sort(model, bodies, &self.particles, spare)?;
        self.take_over(sorted, spare);
        self.age = 0;
        Ok(())
    }

    /// Sorts some blocks by the faces that their particles are before.
    fn sort_by_faces(
        &mut self,
        model: &Model<T>,
        bodies: &Bodies<T>,
        is_wrong: &[bool],
        spare: &mut BufferPool<T>,
    ) {
        self.fill();
        let none = Particles { groups: Vec::new(), ids: Arc::new([]) };
        let particles = std::mem::replace(&mut self.particles, none);
        let sorted = sort_by_faces(model, bodies, (particles, &self.layout), is_wrong, spare);
        self.take_over(sorted, spare);
    }

    fn take_over(&mut self, (particles, layout, order): Sorted<T>, spare: &mut BufferPool<T>) {
        self.rest = sleep::after_sort(&self.rest, &self.layout, &layout, &order, &particles.groups);
        self.sorted_from = Some((order.into(), self.layout.groups()));
        self.layout = Arc::new(layout);
        spare.return_groups(std::mem::replace(&mut self.particles, particles).groups);
    }

    /// Puts the sleepers' particles among the state's own: a state that was written elsewhere than it began lacks them.
    pub(crate) fn fill(&mut self) {
        for (rest, groups) in self.rest.iter().zip(split(&self.layout, &mut self.particles.groups)) {
            rest.restore_into(groups);
        }
    }

    /// Which blocks sleep.
    pub(crate) fn sleepers(&self) -> impl Iterator<Item = bool> {
        self.rest.iter().map(SleepState::is_asleep)
    }

    #[cfg(test)]
    pub(crate) fn rest(&self) -> &[SleepState<T>] {
        &self.rest
    }

    /// These tiles of those who are awake, with the sleepers'.
    #[cfg(test)]
    pub(crate) fn tiles<'a>(&'a self, fresh: &'a [Tile<T>]) -> Tiles<'a, T> {
        Tiles { fresh, rest: &self.rest, reached: None, sleepers_send: true }
    }

    /// What keeping it takes, with what is on its grid. Some of what is beside its vectors, states share.
    pub(crate) fn size(&self, model: &Model<T>) -> Size {
        let groups = self.particles.groups.len();
        let besides = 2 * groups * LANES * size_of::<u32>()
            + self.layout.blocks.len() * size_of::<SleepState<T>>()
            + self.layout.bytes();
        let vectors = vectors_on_grid(model.residue.is_some());
        Size { groups, nodes: self.layout.nodes.len(), vectors, besides: besides as u64 }
    }

    /// Bytes of that.
    pub(crate) fn bytes(&self, model: &Model<T>) -> u64 {
        state_bytes::<T>(self.size(model))
    }
}

/// What was on the grid in the substep that begins at a state. The adjoint of that substep needs it.
#[derive(Debug)]
pub(crate) struct OnGrid<T> {
    /// Momentum and mass.
    momentum: Vec<Nodes<T>>,
    /// Velocity, after contact.
    velocity: Vec<Nodes<T>>,
    /// Velocity without forces, where the velocity residue is given back; else nothing.
    unforced: Vec<Nodes<T>>,
}

/// How many vectors there are for what is on the grid.
pub(crate) fn vectors_on_grid(gives_back_residue: bool) -> usize {
    if gives_back_residue { 3 } else { 2 }
}

impl<T: Real> OnGrid<T> {
    /// Nothing, to be written to.
    pub(crate) fn empty() -> Self {
        Self { momentum: Vec::new(), velocity: Vec::new(), unforced: Vec::new() }
    }

    fn fit(&mut self, model: &Model<T>, nodes: usize, spare: &mut BufferPool<T>) {
        spare.fit_nodes(&mut self.momentum, nodes);
        spare.fit_nodes(&mut self.velocity, nodes);
        if model.residue.is_some() {
            spare.fit_nodes(&mut self.unforced, nodes);
        }
    }

    /// Is no longer needed.
    pub(crate) fn recycle_into(self, spare: &mut BufferPool<T>) {
        spare.return_nodes(self.momentum);
        spare.return_nodes(self.velocity);
        spare.return_nodes(self.unforced);
    }
}

/// Scratch memory of the substeps, reused from one to the next.
pub(crate) struct Workspace<T> {
    tiles: Vec<Tile<T>>,
    /// Which neighbours of their blocks hold anything of them.
    reached: Vec<u32>,
    /// Of momentum without forces, where the velocity residue is given back; else none.
    unforced_tiles: Vec<Tile<T>>,
    /// Of the latest substep.
    pub(crate) on_grid: OnGrid<T>,
    /// The node blocks in which something moves so fast that it can wake sleepers.
    moving: Vec<bool>,
    momentum_bar: Vec<Nodes<T>>,
    /// As [`Self::unforced_tiles`].
    unforced_bar: Vec<Nodes<T>>,
    /// Cotangents of the particles, between two gradients.
    pub(crate) bar: Vec<Group<T>>,
    /// Changes places with them when they are put in another order.
    other_bar: Vec<Group<T>>,
    /// For what nobody asks for.
    unused: Vec<Group<T>>,
    pub(crate) spare: BufferPool<T>,
    pub(crate) timings: StageTimings,
}

/// Slices of a group array, one per block.
fn split<'a, U>(layout: &Layout, mut groups: &'a mut [U]) -> Vec<&'a mut [U]> {
    let mut out = Vec::with_capacity(layout.blocks.len());
    for block in &layout.blocks {
        let (head, tail) = groups.split_at_mut(block.groups());
        out.push(head);
        groups = tail;
    }
    out
}

/// All of so many, or none of them where they are not needed: another model may have left some.
fn each_if<U>(are_needed: bool, items: &mut [U], count: usize) -> Vec<Option<&mut U>> {
    if !are_needed {
        return (0..count).map(|_| None).collect();
    }
    assert_eq!(items.len(), count, "memory was taken for all");
    items.iter_mut().map(Some).collect()
}

impl<T: Real> Workspace<T> {
    pub(crate) fn new() -> Self {
        Self {
            tiles: Vec::new(),
            reached: Vec::new(),
            unforced_tiles: Vec::new(),
            on_grid: OnGrid::empty(),
            moving: Vec::new(),
            momentum_bar: Vec::new(),
            unforced_bar: Vec::new(),
            bar: Vec::new(),
            other_bar: Vec::new(),
            unused: Vec::new(),
            spare: BufferPool::empty(),
            timings: StageTimings::default(),
        }
    }

    /// Takes the memory for substeps that begin at such a state, and for their adjoints: what is left is for states.
    pub(crate) fn prepare(&mut self, model: &Model<T>, state: &State<T>) {
        let groups = state.particles.groups.len();
        self.fit(model, &state.layout);
        self.fit_bars(model, &state.layout);
        self.spare.fit_groups(&mut self.unused, groups);
        fit(&mut self.bar, groups, Group::ZERO);
        fit(&mut self.other_bar, groups, Group::ZERO);
    }

    fn fit(&mut self, model: &Model<T>, layout: &Layout) {
        fit(&mut self.tiles, layout.blocks.len(), empty_tile());
        fit(&mut self.reached, layout.blocks.len(), 0);
        if model.residue.is_some() {
            fit(&mut self.unforced_tiles, layout.blocks.len(), empty_tile());
        }
        self.on_grid.fit(model, layout.nodes.len(), &mut self.spare);
    }

    fn fit_bars(&mut self, model: &Model<T>, layout: &Layout) {
        self.spare.fit_nodes(&mut self.momentum_bar, layout.nodes.len());
        if model.residue.is_some() {
            self.spare.fit_nodes(&mut self.unforced_bar, layout.nodes.len());
        }
    }

    /// Advances the state by one substep in which the bodies are there.
    pub(crate) fn substep(
        &mut self,
        model: &Model<T>,
        bodies: &Bodies<T>,
        state: &mut State<T>,
    ) -> Result<(), EscapedParticle> {
        self.timings.begin(Pass::Forward);
        let holds = state.holds_volume(model);
        let groups = &mut state.particles.groups;
        self.particles_to_grid(model, bodies, holds, (&state.layout, &state.rest), None, groups);
        state.count(state.age, state.since_held);
        self.grid_to_particles(model, bodies, holds, state)
    }

    /// [`Self::substep`] with the state after the substep written elsewhere, into memory that is used again.
    pub(crate) fn substep_to(
        &mut self,
        model: &Model<T>,
        bodies: &Bodies<T>,
        from: &State<T>,
        to: &mut State<T>,
    ) -> Result<(), EscapedParticle> {
        self.timings.begin(Pass::Forward);
        let input = &from.particles.groups;
        self.spare.fit_groups(&mut to.particles.groups, input.len());
        to.particles.ids = Arc::clone(&from.particles.ids);
        to.layout = Arc::clone(&from.layout);
        to.rest.clone_from(&from.rest);
        to.count(from.age, from.since_held);
        let holds = from.holds_volume(model);
        let groups = &mut to.particles.groups;
        self.particles_to_grid(model, bodies, holds, (&from.layout, &from.rest), Some(input), groups);
        self.grid_to_particles(model, bodies, holds, to)
    }

    /// Gather, advection and, if one is due, the sort.
    fn grid_to_particles(
        &mut self,
        model: &Model<T>,
        bodies: &Bodies<T>,
        holds_volume: bool,
        state: &mut State<T>,
    ) -> Result<(), EscapedParticle> {
        let (layout, velocity) = (&*state.layout, &self.on_grid.velocity);
        let unforced = model.residue.map(|_| &self.on_grid.unforced[..]);
        let (before, moving, reached) = (&state.rest, &self.moving, &self.reached);
        let (seen, rest): (Vec<BlockStatus>, Vec<SleepState<T>>) = split(layout, &mut state.particles.groups)
            .into_par_iter()
            .zip(&layout.blocks)
            .zip(before.par_iter().zip(reached))
            .with_max_len(MAX_BLOCKS)
            .map(|((state, block), (before, reached))| {
                if !before.is_asleep() {
                    let seen = model.arch.dispatch(TileToParticles {
                        model,
                        bodies,
                        block,
                        reached: *reached,
                        velocity,
                        unforced,
                        holds_volume,
                        state,
                    });
                    return (seen, sleep::next_state(model, bodies, block, before, seen, false));
                }
                let disturbed = sleep::is_disturbed(model, block, before, velocity, moving);
                let rest = sleep::next_state(model, bodies, block, before, BlockStatus::ASLEEP, disturbed);
                if !rest.is_asleep() {
                    before.restore_into(state);
                }
                (BlockStatus::ASLEEP, rest)
            })
            .unzip();
        self.timings.mark(Stage::GridToParticles);
        state.rest = rest;
        self.keep_in_order(model, bodies, state, seen.iter().any(|seen| !seen.inside))?;
        self.timings.mark(Stage::Sort);
        Ok(())
    }

    /// Sorts and links anew what has to be, and lets fall asleep what may.
    fn keep_in_order(
        &mut self,
        model: &Model<T>,
        bodies: &Bodies<T>,
        state: &mut State<T>,
        some_outside: bool,
    ) -> Result<(), EscapedParticle> {
        state.sorted_from = None;
        if some_outside || state.age >= SORT_EVERY {
            return state.sort(model, bodies, &mut self.spare);
        }
        if model.walls.is_some() && state.age.is_multiple_of(LOOK_EVERY) {
            let groups = &state.particles.groups;
            let is_wrong = walls::before_other_faces(model, bodies, &state.layout, groups, &state.rest);
            if is_wrong.contains(&true) {
                state.sort_by_faces(model, bodies, &is_wrong, &mut self.spare);
                return Ok(());
            }
            if let Some(layout) = connected_anew(model, bodies, &state.layout) {
                state.layout = Arc::new(layout);
                return Ok(());
            }
        }
        // Elsewhere the nodes are others by now; those who would fall asleep do so in the next substep.
        let velocity = &self.on_grid.velocity;
        sleep::fall_asleep(model, &state.layout, velocity, &state.particles.groups, &mut state.rest);
        Ok(())
    }

    /// Material, scatter and grid update; leaves momentum and velocity in the workspace.
    fn particles_to_grid(
        &mut self,
        model: &Model<T>,
        bodies: &Bodies<T>,
        holds_volume: bool,
        (layout, rest): (&Layout, &[SleepState<T>]),
        from: Option<&[Group<T>]>,
        state: &mut [Group<T>],
    ) {
        self.fit(model, layout);
        let unforced = each_if(model.residue.is_some(), &mut self.unforced_tiles, layout.blocks.len());
        let tiles = self.tiles.par_iter_mut().zip(unforced).zip(&mut self.reached);
        let jobs = split(layout, state).into_par_iter().zip(tiles).zip(&layout.blocks).zip(rest);
        let jobs = jobs.with_max_len(MAX_BLOCKS);
        jobs.for_each(|(((state, ((tile, unforced), reached)), block), rest)| {
            let from = from.map(|from| &from[block.first_group..block.first_group + block.groups()]);
            *reached = match rest.sent() {
                None => model.arch.dispatch(ParticlesToTile { model, block, from, state, tile, unforced }),
                Some((_, reached)) => reached,
            };
        });
        self.timings.mark(Stage::ParticlesToGrid);
        let OnGrid { momentum, velocity, unforced } = &mut self.on_grid;
        let unforced = each_if(model.residue.is_some(), unforced, layout.nodes.len());
        let unforced_tiles = &self.unforced_tiles[..];
        let (fresh, reached) = (&self.tiles[..], Some(&self.reached[..]));
        let tiles = Tiles { fresh, rest, reached, sleepers_send: true };
        let nodes = layout.nodes.par_iter().zip(momentum).zip(velocity).zip(unforced);
        nodes
            .map(|(((node, momentum), velocity), unforced)| {
                model.arch.dispatch(UpdateNodes {
                    model,
                    bodies,
                    node,
                    tiles,
                    holds_volume,
                    momentum,
                    velocity,
                    unforced: unforced.map(|unforced| (unforced_tiles, unforced)),
                })
            })
            .collect_into_vec(&mut self.moving);
        self.timings.mark(Stage::GridUpdate);
    }

    /// Adjoint of [`Self::substep`], the sort at its end excepted: turns the cotangent `bar` of the state after the
    /// substep into the one of `state`, and returns the cotangent of the tool's motion. What was on the grid is computed again if
    /// it is not known.
    pub(crate) fn substep_adjoint(
        &mut self,
        model: &Model<T>,
        bodies: &Bodies<T>,
        state: &State<T>,
        known: Option<&OnGrid<T>>,
        bar: &mut [Group<T>],
    ) -> BodyStateBar {
        self.timings.begin(Pass::Adjoint);
        let layout = &*state.layout;
        let input = &state.particles.groups;
        let holds_volume = state.holds_volume(model);
        self.fit(model, layout);
        self.fit_bars(model, layout);
        if known.is_none() {
            let mut unused = std::mem::take(&mut self.unused);
            self.spare.fit_groups(&mut unused, input.len());
            let blocks = (layout, &state.rest[..]);
            self.particles_to_grid(model, bodies, holds_volume, blocks, Some(input), &mut unused);
            self.unused = unused;
        }
        let OnGrid { momentum, velocity, unforced } = known.unwrap_or(&self.on_grid);
        let unforced = model.residue.map(|_| &unforced[..]);
        let unforced_tiles = each_if(model.residue.is_some(), &mut self.unforced_tiles, layout.blocks.len());
        let at_particles: Vec<BodyStateBar> = split(layout, bar)
            .into_par_iter()
            .zip(self.tiles.par_iter_mut().zip(unforced_tiles).zip(&mut self.reached))
            .zip(&layout.blocks)
            .zip(&state.rest)
            .with_max_len(MAX_BLOCKS)
            .filter(|(_, rest)| !rest.is_asleep())
            .map(|(((bar, ((tile_bar, unforced_bar), reached)), block), _)| {
                let input = &input[block.first_group..block.first_group + block.groups()];
                let (tool_bar, sent_to) = model.arch.dispatch(TileToParticlesAdjoint {
                    model,
                    bodies,
                    block,
                    velocity,
                    unforced,
                    holds_volume,
                    input,
                    bar,
                    tile_bar,
                    unforced_bar,
                });
                *reached = sent_to;
                tool_bar
            })
            .collect();
        self.timings.mark(Stage::GridToParticlesAdjoint);
        let (fresh, reached) = (&self.tiles[..], Some(&self.reached[..]));
        let tiles = Tiles { fresh, rest: &state.rest, reached, sleepers_send: false };
        let unforced_tiles = &self.unforced_tiles[..];
        let unforced_bar = each_if(model.residue.is_some(), &mut self.unforced_bar, layout.nodes.len());
        let at_nodes: Vec<BodyStateBar> = layout
            .nodes
            .par_iter()
            .enumerate()
            .zip(momentum)
            .zip(self.momentum_bar.par_iter_mut().zip(unforced_bar))
            .map(|(((n, node), momentum), (momentum_bar, unforced_bar))| {
                let unforced = unforced.zip(unforced_bar).map(|(unforced, bar)| UnforcedNodesBar {
                    tiles: unforced_tiles,
                    velocity: &unforced[n],
                    bar,
                });
                model.arch.dispatch(UpdateNodesAdjoint {
                    model,
                    bodies,
                    node,
                    velocity_bar_tiles: tiles,
                    holds_volume,
                    momentum,
                    momentum_bar,
                    unforced,
                })
            })
            .collect();
        self.timings.mark(Stage::GridUpdateAdjoint);
        let nodes_bar = &self.momentum_bar;
        let unforced_bar = model.residue.map(|_| &self.unforced_bar[..]);
        split(layout, bar)
            .into_par_iter()
            .zip(&layout.blocks)
            .zip(state.rest.par_iter().zip(&self.reached))
            .with_max_len(MAX_BLOCKS)
            .for_each(|((bar, block), (rest, reached))| {
                let input = &input[block.first_group..block.first_group + block.groups()];
                if !rest.is_asleep() {
                    model.arch.dispatch(ParticlesToTileAdjoint {
                        model,
                        block,
                        input,
                        reached: *reached,
                        nodes_bar,
                        unforced_bar,
                        holds_volume,
                        bar,
                    });
                }
            });
        let mut total = BodyStateBar::default();
        at_particles.iter().chain(&at_nodes).for_each(|b| total.add(b));
        self.timings.mark(Stage::ParticlesToGridAdjoint);
        total
    }

    /// Sort, material and their adjoints by themselves, for the measuring tool. Leaves nothing behind.
    pub(crate) fn alone(
        &mut self,
        model: &Model<T>,
        bodies: &Bodies<T>,
        state: &State<T>,
    ) -> Result<(), EscapedParticle> {
        let (layout, input) = (&state.layout, &state.particles.groups);
        let mut output = std::mem::take(&mut self.unused);
        self.spare.fit_groups(&mut output, input.len());
        let of_block = |block: &Block| &input[block.first_group..block.first_group + block.groups()];
        self.timings.begin(Pass::Alone);
        split(layout, &mut output).into_par_iter().zip(&layout.blocks).for_each(|(output, block)| {
            model.arch.dispatch(ReturnMap { model, input: of_block(block), output });
        });
        self.timings.mark(Stage::ReturnMap);
        let mut bar: Vec<Group<T>> = output.clone();
        self.timings.skip();
        split(layout, &mut bar).into_par_iter().zip(&layout.blocks).for_each(|(bar, block)| {
            model.arch.dispatch(ReturnMapAdjoint { model, input: of_block(block), bar });
        });
        self.timings.mark(Stage::ReturnMapAdjoint);
        let sorted = sort(model, bodies, &state.particles, &mut self.spare);
        self.timings.mark(Stage::Sort);
        let (particles, _, order) = sorted?;
        self.spare.return_groups(particles.groups);
        bar.resize(order.len() / LANES, Group::ZERO);
        self.timings.skip();
        sort_adjoint(&bar, &order, input.len(), &mut self.other_bar);
        std::hint::black_box(&self.other_bar);
        self.timings.mark(Stage::SortAdjoint);
        self.unused = output;
        Ok(())
    }

    /// Undoes the sort at the end of the previous substep in the cotangents, if there was one.
    pub(crate) fn sort_adjoint(&mut self, state: &State<T>, bar: &mut Vec<Group<T>>) {
        if let Some((order, groups)) = &state.sorted_from {
            sort_adjoint(bar, order, *groups, &mut self.other_bar);
            std::mem::swap(bar, &mut self.other_bar);
        }
    }
}
