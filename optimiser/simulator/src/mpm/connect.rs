//! Which tiles add to which blocks of nodes, and the layers of these.

use crate::mpm::Model;
use crate::mpm::bodies::Bodies;
use crate::mpm::layers::{Class, layers};
use crate::mpm::layout::{
    Block, Coord, Detour, Grid, HiddenBy, Layout, NO_BLOCK, NodeBlock, NodeSet, SHARED_NODES, Source,
    WallFace, neighbour_offsets,
};
use crate::mpm::walls::{hidden_of, moving_hidden};
use crate::real::Real;
use crate::shape::Face;

/// Finds the node blocks that the particle blocks touch, with their layers, and links both ways.
pub(crate) fn connected<T: Real>(model: &Model<T>, bodies: &Bodies<T>, mut blocks: Vec<Block>) -> Layout {
    let touched = touch(&model.grid, &mut blocks);
    let coords = touched.iter().map(|place| model.grid.coord(place.index));
    let moving = moving_hidden(model, bodies, &blocks, coords);
    let mut sources: Vec<Vec<Source>> =
        touched.iter().map(|place| Vec::with_capacity(place.touching)).collect();
    for (tile, block) in (0..).zip(&blocks) {
        for (n, at) in (0..).zip(block.nodes) {
            // Seen from the node block, the particle block lies in the opposite direction.
            sources[at as usize].push(Source { tile, neighbour: 26 - n, nodes: NodeSet::MAX });
        }
    }
    let sets = FaceSets::of(&blocks);
    let mut nodes: Vec<NodeBlock> = Vec::with_capacity(touched.len());
    let mut first_layers = Vec::with_capacity(touched.len());
    let mut hiding = InOrder(&moving);
    for (place, sources) in touched.iter().zip(sources) {
        first_layers.push(nodes.len() as u32);
        add_layers(model, (place.index, hiding.of(place.index)), sources, &sets, &mut nodes);
    }
    lead_to(&first_layers, &nodes, &mut blocks);
    Layout { blocks, nodes, moving }
}

/// The same, for blocks that are where those of a layout are and before the same faces; other particles may be in them.
pub(crate) fn connected_like<T: Real>(
    model: &Model<T>,
    bodies: &Bodies<T>,
    blocks: Vec<Block>,
    layout: &Layout,
) -> Layout {
    let moving = moving_hidden(model, bodies, &blocks, coords(layout));
    connected_behind(model, moving, blocks, layout)
}

/// The layout anew where the moving pieces hide other nodes than they did when the layers were made; none where they hide the same.
pub(crate) fn connected_anew<T: Real>(
    model: &Model<T>,
    bodies: &Bodies<T>,
    layout: &Layout,
) -> Option<Layout> {
    let moving = moving_hidden(model, bodies, &layout.blocks, coords(layout));
    (moving != layout.moving).then(|| connected_behind(model, moving, layout.blocks.clone(), layout))
}

fn coords(layout: &Layout) -> impl Iterator<Item = Coord> {
    layout.places().map(|layers| layers[0].coord)
}

/// The layout of blocks as in [`connected_like`]. Places of which `moving` hides the same as in `layout` keep their layers.
fn connected_behind<T: Real>(
    model: &Model<T>,
    moving: Vec<HiddenBy>,
    mut blocks: Vec<Block>,
    layout: &Layout,
) -> Layout {
    for (block, known) in blocks.iter_mut().zip(&layout.blocks) {
        block.nodes = known.nodes;
    }
    let sets = FaceSets::of(&blocks);
    let mut nodes: Vec<NodeBlock> = Vec::with_capacity(layout.nodes.len());
    let mut first_layers = vec![NO_BLOCK; layout.nodes.len()];
    let (mut hid, mut hiding, mut before) = (InOrder(&layout.moving), InOrder(&moving), 0);
    for layers in layout.places() {
        let index = model.grid.index(layers[0].coord);
        first_layers[before] = nodes.len() as u32;
        before += layers.len();
        let (hid, hiding) = (hid.of(index), hiding.of(index));
        if hid == hiding {
            nodes.extend_from_slice(layers);
        } else {
            add_layers(model, (index, hiding), senders_of(layers), &sets, &mut nodes);
        }
    }
    lead_to(&first_layers, &nodes, &mut blocks);
    Layout { blocks, nodes, moving }
}

/// Those who send to any layer of a place, by tiles in order.
fn senders_of(layers: &[NodeBlock]) -> Vec<Source> {
    let all = layers.iter().flat_map(|layer| &layer.sources);
    let mut all: Vec<Source> = all.map(|source| Source { nodes: NodeSet::MAX, ..*source }).collect();
    all.sort_unstable_by_key(|source| source.tile);
    all.dedup();
    all
}

/// What is left of what moving pieces hide, by blocks of the grid in order.
struct InOrder<'a>(&'a [HiddenBy]);

impl<'a> InOrder<'a> {
    /// What they hide of the next block.
    fn of(&mut self, index: usize) -> &'a [HiddenBy] {
        let here = self.0.iter().take_while(|by| by.block as usize == index).count();
        let (of_it, later) = self.0.split_at(here);
        self.0 = later;
        of_it
    }
}

/// A block of nodes that is touched.
struct Place {
    /// Its number.
    index: usize,
    /// By how many particle blocks.
    touching: usize,
}

/// The node blocks that particle blocks touch, in order; each particle block gets their numbers among them.
fn touch(grid: &Grid, blocks: &mut [Block]) -> Vec<Place> {
    let mut counts = vec![0u32; grid.block_count()];
    for block in blocks.iter() {
        around(grid, block.coord).for_each(|index| counts[index] += 1);
    }
    let mut touched = Vec::new();
    for (index, count) in counts.iter_mut().enumerate().filter(|(_, count)| **count > 0) {
        touched.push(Place { index, touching: *count as usize });
        *count = touched.len() as u32 - 1;
    }
    for block in blocks {
        for (at, index) in block.nodes.iter_mut().zip(around(grid, block.coord)) {
            *at = counts[index];
        }
    }
    touched
}

/// Numbers of the blocks around one, itself included.
fn around(grid: &Grid, coord: Coord) -> impl Iterator<Item = usize> {
    let [stride_x, stride_y] = [[1, 0, 0], [0, 1, 0]].map(|coord| grid.index(coord) as isize);
    let here = grid.index(coord);
    neighbour_offsets().map(move |offset| {
        let [x, y, z] = offset.map(|o| o as isize);
        here.wrapping_add_signed(x * stride_x + y * stride_y + z)
    })
}

/// Replaces the numbers in each block's `nodes` by those of first layers, `first_layers[number]`, and finds the detours to later layers.
fn lead_to(first_layers: &[u32], nodes: &[NodeBlock], blocks: &mut [Block]) {
    for block in &mut *blocks {
        block.nodes = block.nodes.map(|at| first_layers[at as usize]);
        block.detours.clear();
    }
    let with_the_one_before = (1..).zip(nodes.windows(2));
    for (node_block, layer) in with_the_one_before.filter(|(_, two)| two[0].coord == two[1].coord) {
        for source in &layer[1].sources {
            let nodes = source.nodes & SHARED_NODES[usize::from(source.neighbour)];
            let detour = Detour { neighbour: 26 - source.neighbour, node_block, nodes };
            blocks[source.tile as usize].detours.push(detour);
        }
    }
}

/// The sets of faces that particles of some block are before.
struct FaceSets {
    sets: Vec<Vec<WallFace>>,
    /// Number of each block's.
    of_block: Vec<u32>,
}

impl FaceSets {
    fn of(blocks: &[Block]) -> Self {
        let mut sets: Vec<Vec<WallFace>> = Vec::new();
        let mut number = |block: &Block| {
            let known = sets.iter().position(|set| *set == block.faces);
            known.unwrap_or_else(|| {
                sets.push(block.faces.clone());
                sets.len() - 1
            }) as u32
        };
        let of_block = blocks.iter().map(&mut number).collect();
        Self { sets, of_block }
    }

    fn face(&self, set: u32, piece: u16) -> Option<Face> {
        self.sets[set as usize].iter().find(|face| face.piece == piece).map(|face| face.face)
    }
}

/// Adds the layers of a block of nodes.
fn add_layers<T: Real>(
    model: &Model<T>,
    (index, hiding): (usize, &[HiddenBy]),
    sources: Vec<Source>,
    sets: &FaceSets,
    nodes: &mut Vec<NodeBlock>,
) {
    let coord = model.grid.coord(index);
    // Sets of faces of those who send here, and the nodes that they reach.
    let mut senders: Vec<(u32, NodeSet)> = Vec::new();
    let set_of = |source: &Source| sets.of_block[source.tile as usize];
    for source in &sources {
        let reach = SHARED_NODES[usize::from(source.neighbour)];
        match senders.iter_mut().find(|(set, _)| *set == set_of(source)) {
            Some((_, nodes)) => *nodes |= reach,
            None => senders.push((set_of(source), reach)),
        }
    }
    let is_before_it = |piece: u16| senders.iter().any(|(set, _)| sets.face(*set, piece).is_some());
    let pieces = hidden_of(model, index, hiding, is_before_it);
    if pieces.is_empty() {
        nodes.push(NodeBlock { coord, sources, sides: Vec::new() });
        return;
    }
    let mut classes: Vec<Class> = Vec::new();
    let mut class_of = vec![0; sets.sets.len()];
    for (set, reach) in senders {
        let faces: Vec<_> = pieces.iter().map(|(piece, _)| sets.face(set, *piece)).collect();
        let known = classes.iter().position(|class| class.faces == faces);
        class_of[set as usize] = known.unwrap_or(classes.len());
        match known {
            Some(class) => classes[class].reach |= reach,
            None => classes.push(Class { faces, reach }),
        }
    }
    let found = layers(&classes, &pieces);
    for (layer, sides) in found.sides.into_iter().enumerate() {
        let mut in_layer = Vec::with_capacity(sources.len());
        for source in &sources {
            let shared = SHARED_NODES[usize::from(source.neighbour)];
            let of_class = &found.of_class[class_of[set_of(source) as usize]];
            let own = shared & of_class.get(layer).unwrap_or(&0);
            if own == 0 {
                continue;
            }
            in_layer.push(Source { nodes: if own == shared { NodeSet::MAX } else { own }, ..*source });
        }
        nodes.push(NodeBlock { coord, sources: in_layer, sides });
    }
}
