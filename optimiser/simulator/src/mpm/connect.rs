//! Which tiles add to which blocks of nodes, and the layers of these.

use crate::mpm::Model;
use crate::mpm::bodies::Bodies;
use crate::mpm::layers::{Class, layers};
use crate::mpm::layout::{
    Block, Coord, Detour, Grid, HiddenBy, Layout, NodeBlock, NodeSet, SHARED_NODES, Source, WallFace,
    neighbour_offsets,
};
use crate::mpm::walls::{hidden_of, moving_hidden};
use crate::real::Real;
use crate::shape::Face;

/// Finds the node blocks that the particle blocks touch, with their layers, and links both ways.
pub(crate) fn connected<T: Real>(model: &Model<T>, bodies: &Bodies<T>, blocks: Vec<Block>) -> Layout {
    let touched = touched(&model.grid, &blocks);
    let moving = moving_hidden(model, bodies, &blocks, touched.iter().map(|index| model.grid.coord(*index)));
    connected_behind(model, moving, blocks, &touched)
}

/// The same where the moving pieces hide other nodes than they did when the layers were made; none where they hide the same.
pub(crate) fn connected_anew<T: Real>(
    model: &Model<T>,
    bodies: &Bodies<T>,
    layout: &Layout,
) -> Option<Layout> {
    let moving = moving_hidden(model, bodies, &layout.blocks, layout.places().map(|layers| layers[0].coord));
    (moving != layout.moving).then(|| {
        let touched: Vec<usize> = layout.places().map(|layers| model.grid.index(layers[0].coord)).collect();
        connected_behind(model, moving, layout.blocks.clone(), &touched)
    })
}

/// Numbers of the blocks around one, itself included.
fn around(grid: &Grid, coord: Coord) -> impl Iterator<Item = usize> {
    neighbour_offsets().map(move |o| grid.index([0, 1, 2].map(|a| coord[a] + o[a])))
}

/// Numbers of the node blocks that particle blocks touch, in order.
fn touched(grid: &Grid, blocks: &[Block]) -> Vec<usize> {
    let mut touched: Vec<usize> = Vec::with_capacity(27 * blocks.len());
    for parts in blocks.chunk_by(|a, b| a.coord == b.coord) {
        touched.extend(around(grid, parts[0].coord));
    }
    touched.sort_unstable();
    touched.dedup();
    touched
}

/// The layout of these blocks, which touch these node blocks; `moving` is what moving pieces hide of them.
fn connected_behind<T: Real>(
    model: &Model<T>,
    moving: Vec<HiddenBy>,
    mut blocks: Vec<Block>,
    touched: &[usize],
) -> Layout {
    let mut counts = vec![0; touched.len()];
    for parts in blocks.chunk_by_mut(|a, b| a.coord == b.coord) {
        let at = |index| touched.binary_search(&index).expect("collected above") as u32;
        let nodes: Vec<u32> = around(&model.grid, parts[0].coord).map(at).collect();
        nodes.iter().for_each(|at| counts[*at as usize] += parts.len());
        for block in parts {
            block.nodes.copy_from_slice(&nodes);
            block.detours.clear();
        }
    }
    let mut sources: Vec<Vec<Source>> = counts.into_iter().map(Vec::with_capacity).collect();
    for (tile, block) in (0..).zip(&blocks) {
        for (n, at) in (0..).zip(block.nodes) {
            // Seen from the node block, the particle block lies in the opposite direction.
            sources[at as usize].push(Source { tile, neighbour: 26 - n, nodes: NodeSet::MAX });
        }
    }
    let sets = FaceSets::of(&blocks);
    let mut nodes: Vec<NodeBlock> = Vec::with_capacity(touched.len());
    let (mut first_layers, mut later) = (Vec::with_capacity(touched.len()), &moving[..]);
    for (index, sources) in touched.iter().zip(sources) {
        let here = later.iter().take_while(|by| by.block as usize == *index).count();
        let (hiding, rest) = later.split_at(here);
        later = rest;
        first_layers.push(nodes.len() as u32);
        add_layers(model, (*index, hiding), sources, &sets, &mut blocks, &mut nodes);
    }
    for block in &mut blocks {
        for at in &mut block.nodes {
            *at = first_layers[*at as usize];
        }
    }
    Layout { blocks, nodes, moving }
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

/// Adds the layers of a block of nodes, and to the particle blocks their detours.
fn add_layers<T: Real>(
    model: &Model<T>,
    (index, hiding): (usize, &[HiddenBy]),
    sources: Vec<Source>,
    sets: &FaceSets,
    blocks: &mut [Block],
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
    let first = nodes.len();
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
            if layer > 0 {
                let node_block = (first + layer) as u32;
                let detour = Detour { neighbour: 26 - source.neighbour, node_block, nodes: own };
                blocks[source.tile as usize].detours.push(detour);
            }
        }
        nodes.push(NodeBlock { coord, sources: in_layer, sides });
    }
}
