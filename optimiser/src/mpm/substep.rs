//! One substep of all particles, forward and adjoint, and the sorting between substeps.

use std::sync::Arc;

use rayon::prelude::*;

use crate::mpm::Model;
use crate::mpm::contact::{Motion, MotionBar};
use crate::mpm::g2p::{TileToParticles, TileToParticlesAdjoint};
use crate::mpm::grid_update::{UpdateNodes, UpdateNodesAdjoint};
use crate::mpm::laps::{Laps, Pass, Stage};
use crate::mpm::layout::{BLOCK_NODES, Layout, Lost, Nodes, empty_tile, sort, unsort};
use crate::mpm::p2g::{ParticlesToTile, ParticlesToTileAdjoint, Payload, ReturnMap, ReturnMapAdjoint};
use crate::mpm::particles::{Group, LANES, Particles};
use crate::mpm::stencil::Tile;
use crate::real::Real;

/// The state at the beginning of a substep.
#[derive(Debug)]
pub(crate) struct State<T> {
    pub(crate) particles: Particles<T>,
    pub(crate) layout: Arc<Layout>,
    /// If the particles were sorted on the way here: where each came from, and how many groups there were.
    pub(crate) sorted_from: Option<(Arc<[u32]>, usize)>,
    /// The next substep cannot begin before a sort.
    stale: bool,
}

impl<T: Clone> Clone for State<T> {
    fn clone(&self) -> Self {
        Self {
            particles: self.particles.clone(),
            layout: Arc::clone(&self.layout),
            sorted_from: self.sorted_from.clone(),
            stale: self.stale,
        }
    }

    /// Into the memory that is already there.
    fn clone_from(&mut self, from: &Self) {
        copy_exactly(&mut self.particles.groups, &from.particles.groups);
        copy_exactly(&mut self.particles.ids, &from.particles.ids);
        self.layout.clone_from(&from.layout);
        self.sorted_from.clone_from(&from.sorted_from);
        self.stale = from.stale;
    }
}

/// Into the memory that is already there, or as much more as is needed. The number of groups changes from sort to sort, and a
/// vector that is left to grow by itself takes twice the memory at the first group more.
fn copy_exactly<E: Clone>(to: &mut Vec<E>, from: &[E]) {
    to.clear();
    to.reserve_exact(from.len());
    to.extend_from_slice(from);
}

impl<T: Real> State<T> {
    /// Sorted state of the given particles.
    pub(crate) fn new(model: &Model<T>, particles: &Particles<T>) -> Result<Self, Lost> {
        let (particles, layout, _) = sort(&model.grid, particles)?;
        Ok(Self { particles, layout: Arc::new(layout), sorted_from: None, stale: false })
    }

    /// Sorts if a particle has come to the end of its block's reach.
    fn freshen(&mut self, model: &Model<T>) -> Result<(), Lost> {
        self.sorted_from = None;
        if self.stale {
            let groups = self.particles.groups.len();
            let (particles, layout, order) = sort(&model.grid, &self.particles)?;
            *self = Self {
                particles,
                layout: Arc::new(layout),
                sorted_from: Some((order.into(), groups)),
                stale: false,
            };
        }
        Ok(())
    }

    /// Bytes that keeping this state costs.
    pub(crate) fn bytes(&self) -> usize {
        let per_group = size_of::<Group<T>>() + 2 * LANES * size_of::<u32>();
        self.particles.groups.len() * per_group + self.layout.bytes()
    }
}

/// Scratch memory of the substeps, reused from one to the next.
pub(crate) struct Workspace<T> {
    tiles: Vec<Tile<T>>,
    momentum: Vec<Nodes<T>>,
    velocity: Vec<Nodes<T>>,
    momentum_bar: Vec<Nodes<T>>,
    payloads: Vec<Payload<T>>,
    spare: Vec<Group<T>>,
    pub(crate) laps: Laps,
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

impl<T: Real> Workspace<T> {
    pub(crate) fn new() -> Self {
        Self {
            tiles: Vec::new(),
            momentum: Vec::new(),
            velocity: Vec::new(),
            momentum_bar: Vec::new(),
            payloads: Vec::new(),
            spare: Vec::new(),
            laps: Laps::default(),
        }
    }

    /// Heap bytes that do not grow with the number of kept states.
    pub(crate) fn bytes(&self) -> usize {
        self.tiles.len() * size_of::<Tile<T>>()
            + 3 * self.momentum.len() * size_of::<Nodes<T>>()
            + self.spare.len() * size_of::<Payload<T>>()
    }

    fn fit(&mut self, layout: &Layout, groups: usize) {
        let zero_nodes = [[T::ZERO; 4]; BLOCK_NODES];
        self.tiles.resize(layout.blocks.len(), empty_tile());
        self.momentum.resize(layout.nodes.len(), zero_nodes);
        self.velocity.resize(layout.nodes.len(), zero_nodes);
        self.spare.resize(groups, Group::ZERO);
    }

    /// Advances the state by one substep with the tool's motion at the substep's end.
    pub(crate) fn advance(
        &mut self,
        model: &Model<T>,
        tool: &Motion<T>,
        state: &mut State<T>,
    ) -> Result<(), Lost> {
        self.laps.begin(Pass::Forward);
        let layout = Arc::clone(&state.layout);
        self.fit(&layout, state.particles.groups.len());
        let mut output = std::mem::take(&mut self.spare);
        self.particles_to_grid(model, tool, &layout, &state.particles.groups, &mut output, false);
        let (velocity, input) = (&self.velocity, &state.particles.groups);
        let inside = split(&layout, &mut output)
            .into_par_iter()
            .zip(&layout.blocks)
            .map(|(output, block)| {
                let input = &input[block.first_group..block.first_group + block.groups()];
                model.arch.dispatch(TileToParticles { model, tool, block, velocity, input, output })
            })
            .reduce(|| true, |a, b| a && b);
        std::mem::swap(&mut state.particles.groups, &mut output);
        self.spare = output;
        self.laps.mark(Stage::GridToParticles);
        state.stale = !inside;
        let freshened = state.freshen(model);
        self.laps.mark(Stage::Sort);
        freshened
    }

    /// Material, scatter and grid update; leaves momentum and velocity in the workspace.
    fn particles_to_grid(
        &mut self,
        model: &Model<T>,
        tool: &Motion<T>,
        layout: &Layout,
        input: &[Group<T>],
        output: &mut [Group<T>],
        keep: bool,
    ) {
        let jobs = split(layout, output).into_par_iter().zip(&mut self.tiles).zip(&layout.blocks);
        let scatter = |output, tile, block: &crate::mpm::layout::Block, payloads| {
            let input = &input[block.first_group..block.first_group + block.groups()];
            model.arch.dispatch(ParticlesToTile { model, block, input, output, tile, payloads });
        };
        if keep {
            self.payloads.resize(input.len(), Payload::ZERO);
            jobs.zip(split(layout, &mut self.payloads))
                .for_each(|(((output, tile), block), payloads)| scatter(output, tile, block, Some(payloads)));
        } else {
            jobs.for_each(|((output, tile), block)| scatter(output, tile, block, None));
        }
        self.laps.mark(Stage::ParticlesToGrid);
        let tiles = &self.tiles;
        layout.nodes.par_iter().zip(&mut self.momentum).zip(&mut self.velocity).for_each(
            |((node, momentum), velocity)| {
                model.arch.dispatch(UpdateNodes { model, tool, node, tiles, momentum, velocity });
            },
        );
        self.laps.mark(Stage::GridUpdate);
    }

    /// Adjoint of [`Self::advance`], the sort at its end excepted: turns the cotangent `bar` of the state after the
    /// substep into the one of `state`, and returns the cotangent of the tool's motion.
    pub(crate) fn retreat(
        &mut self,
        model: &Model<T>,
        tool: &Motion<T>,
        state: &State<T>,
        bar: &mut [Group<T>],
    ) -> MotionBar {
        self.laps.begin(Pass::Adjoint);
        let layout = &*state.layout;
        let input = &state.particles.groups;
        self.fit(layout, input.len());
        self.momentum_bar.resize(layout.nodes.len(), [[T::ZERO; 4]; BLOCK_NODES]);
        let mut output = std::mem::take(&mut self.spare);
        self.particles_to_grid(model, tool, layout, input, &mut output, true);
        self.spare = output;

        let velocity = &self.velocity;
        let at_particles: Vec<MotionBar> = split(layout, bar)
            .into_par_iter()
            .zip(&mut self.tiles)
            .zip(&layout.blocks)
            .map(|((bar, tile_bar), block)| {
                let input = &input[block.first_group..block.first_group + block.groups()];
                model.arch.dispatch(TileToParticlesAdjoint {
                    model,
                    tool,
                    block,
                    velocity,
                    input,
                    bar,
                    tile_bar,
                })
            })
            .collect();
        self.laps.mark(Stage::GridToParticlesAdjoint);
        let (tiles, momentum) = (&self.tiles, &self.momentum);
        let at_nodes: Vec<MotionBar> = layout
            .nodes
            .par_iter()
            .zip(momentum)
            .zip(&mut self.momentum_bar)
            .map(|((node, momentum), momentum_bar)| {
                model.arch.dispatch(UpdateNodesAdjoint {
                    model,
                    tool,
                    node,
                    velocity_bar_tiles: tiles,
                    momentum,
                    momentum_bar,
                })
            })
            .collect();
        self.laps.mark(Stage::GridUpdateAdjoint);
        let (nodes_bar, payloads) = (&self.momentum_bar, &self.payloads);
        split(layout, bar).into_par_iter().zip(&layout.blocks).for_each(|(bar, block)| {
            let range = block.first_group..block.first_group + block.groups();
            model.arch.dispatch(ParticlesToTileAdjoint {
                model,
                block,
                input: &input[range.clone()],
                payloads: &payloads[range],
                nodes_bar,
                bar,
            });
        });
        let mut total = MotionBar::default();
        at_particles.iter().chain(&at_nodes).for_each(|b| total.add(b));
        self.laps.mark(Stage::ParticlesToGridAdjoint);
        total
    }

    /// Sort, material and their adjoints by themselves, for the measuring tool. Leaves nothing behind.
    pub(crate) fn alone(&mut self, model: &Model<T>, state: &State<T>) -> Result<(), Lost> {
        let (layout, input) = (&state.layout, &state.particles.groups);
        self.fit(layout, input.len());
        let mut output = std::mem::take(&mut self.spare);
        let of_block =
            |block: &crate::mpm::layout::Block| &input[block.first_group..block.first_group + block.groups()];
        self.laps.begin(Pass::Alone);
        split(layout, &mut output).into_par_iter().zip(&layout.blocks).for_each(|(output, block)| {
            model.arch.dispatch(ReturnMap { model, input: of_block(block), output });
        });
        self.laps.mark(Stage::ReturnMap);
        split(layout, &mut output).into_par_iter().zip(&layout.blocks).for_each(|(bar, block)| {
            model.arch.dispatch(ReturnMapAdjoint { model, input: of_block(block), bar });
        });
        self.laps.mark(Stage::ReturnMapAdjoint);
        let sorted = sort(&model.grid, &state.particles);
        self.laps.mark(Stage::Sort);
        let (particles, _, order) = sorted?;
        self.laps.skip();
        std::hint::black_box(unsort(&particles.groups, &order, input.len()));
        self.laps.mark(Stage::Unsort);
        self.spare = output;
        Ok(())
    }
}

/// Undoes the sort at the end of the previous substep in the cotangents, if there was one.
pub(crate) fn unsort_bar<T: Real>(state: &State<T>, bar: Vec<Group<T>>) -> Vec<Group<T>> {
    match &state.sorted_from {
        Some((order, groups)) => unsort(&bar, order, *groups),
        None => bar,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_copy_takes_no_more_memory_than_it_needs() {
        let mut to: Vec<u64> = Vec::with_capacity(1_000);
        copy_exactly(&mut to, &[7; 1_001]);
        assert_eq!(to, [7; 1_001]);
        assert!(to.capacity() < 1_100, "{}", to.capacity());
        copy_exactly(&mut to, &[8; 10]);
        assert_eq!(to, [8; 10]);
    }
}
