//! The layers of a block of nodes: which of those who send to it have nodes of their own there.
//!
//! A node is keyed by the faces that it is behind, as seen by who sends to it. Those for whom the key is the same share the node, the
//! others have another one at the same place. Layer 0 has the first of the nodes of each place, layer 1 the second, and so on, so
//! that where all agree there is one layer.

use crate::mpm::layout::{Hidden, NodeSet, Side, WallFace};
use crate::shape::Face;

/// Some who send to a block of nodes and are before the same faces.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Class {
    /// Before which face of each piece in question; none if the piece is too far off to matter.
    pub(crate) faces: Vec<Option<Face>>,
    /// The nodes that they send to.
    pub(crate) reach: NodeSet,
}

/// What comes of it.
#[derive(Debug)]
pub(crate) struct Layers {
    /// For each class the nodes that it sends to in each layer.
    pub(crate) of_class: Vec<Vec<NodeSet>>,
    /// For each layer what its nodes are behind.
    pub(crate) sides: Vec<Vec<Side>>,
}

/// What a class does not see for a piece, and because of which face.
#[derive(Clone, Copy)]
struct View {
    face: Option<Face>,
    hidden: NodeSet,
}

/// Finds the layers; `pieces` are those in question with what they hide.
pub(crate) fn layers(classes: &[Class], pieces: &[(u16, Hidden)]) -> Layers {
    let views: Vec<Vec<View>> = classes.iter().map(|class| views(class, classes, pieces)).collect();
    let same = |c: usize, d: usize| {
        let both = views[c].iter().zip(&views[d]);
        both.fold(NodeSet::MAX, |same, (a, b)| {
            same & !if a.face == b.face { a.hidden ^ b.hidden } else { a.hidden | b.hidden }
        })
    };
    let mut of_class: Vec<Vec<NodeSet>> = Vec::with_capacity(classes.len());
    for (c, class) in classes.iter().enumerate() {
        let (mut mine, mut left) = (Vec::new(), class.reach);
        for (d, other) in of_class.iter().enumerate() {
            let shared = left & same(c, d) & classes[d].reach;
            other.iter().enumerate().for_each(|(layer, nodes)| add(&mut mine, layer, nodes & shared));
            left &= !shared;
        }
        for layer in 0.. {
            if left == 0 {
                break;
            }
            let taken = of_class.iter().fold(0, |taken, other| taken | other.get(layer).unwrap_or(&0));
            add(&mut mine, layer, left & !taken);
            left &= taken;
        }
        of_class.push(mine);
    }
    let count = of_class.iter().map(Vec::len).max().unwrap_or(0);
    let sides = (0..count).map(|layer| sides(layer, &of_class, &views, pieces)).collect();
    Layers { of_class, sides }
}

fn add(layers: &mut Vec<NodeSet>, layer: usize, nodes: NodeSet) {
    if nodes != 0 {
        layers.resize(layers.len().max(layer + 1), 0);
        layers[layer] |= nodes;
    }
}

fn views(class: &Class, classes: &[Class], pieces: &[(u16, Hidden)]) -> Vec<View> {
    let view = |(k, (_, hidden)): (usize, &(u16, Hidden))| match class.faces[k] {
        Some(face) => View { face: Some(face), hidden: hidden.from(face) },
        // Nothing of theirs gets into the solid: they may go with whoever is there.
        None => View { face: classes.iter().filter_map(|other| other.faces[k]).min(), hidden: hidden.solid },
    };
    pieces.iter().enumerate().map(view).collect()
}

fn sides(
    layer: usize,
    of_class: &[Vec<NodeSet>],
    views: &[Vec<View>],
    pieces: &[(u16, Hidden)],
) -> Vec<Side> {
    let mut out: Vec<Side> = Vec::new();
    for (k, (piece, _)) in pieces.iter().enumerate() {
        let first = out.len();
        for (nodes, views) in of_class.iter().zip(views) {
            let nodes = nodes.get(layer).unwrap_or(&0) & views[k].hidden;
            let Some(face) = views[k].face.filter(|_| nodes != 0) else { continue };
            match out[first..].iter_mut().find(|side| side.of.face == face) {
                Some(side) => side.nodes |= nodes,
                None => out.push(Side { of: WallFace { piece: *piece, face }, nodes }),
            }
        }
        out[first..].sort_by_key(|side| side.of);
    }
    out
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    const PIECES: usize = 3;

    fn hidden() -> impl Strategy<Value = Hidden> {
        // Few nodes in question, so that all cases come together.
        (any::<u8>(), [any::<u8>(); Face::PAIRED]).prop_map(|(solid, before)| Hidden {
            solid: solid.into(),
            before: before.map(|nodes| NodeSet::from(nodes & !solid)),
        })
    }

    fn class() -> impl Strategy<Value = Class> {
        let face = prop_oneof![Just(None), (0..8i32).prop_map(|face| Some(Face::from_number(face)))];
        let faces = [face.clone(), face.clone(), face];
        (faces, any::<u8>()).prop_map(|(faces, reach)| Class { faces: faces.to_vec(), reach: reach.into() })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4096))]

        /// Who reaches a node is in one of its layers, with those who have the same key and with nobody else; layers are taken
        /// from the first one on; and a layer's sides are the keys of those in it.
        #[test]
        fn those_with_the_same_key_share_a_node(
            pieces in [hidden(), hidden(), hidden()], classes in prop::collection::vec(class(), 1..6),
        ) {
            let pieces: Vec<(u16, Hidden)> = (10..).zip(pieces).collect();
            let found = layers(&classes, &pieces);
            for node in 0..8 {
                let bit = |nodes: NodeSet| nodes >> node & 1 == 1;
                let mut used = BTreeSet::new();
                let mut keys: Vec<(usize, BTreeSet<(u16, Face)>)> = Vec::new();
                for (class, layers) in classes.iter().zip(&found.of_class) {
                    let layer: Vec<usize> = (0..layers.len()).filter(|l| bit(layers[*l])).collect();
                    prop_assert_eq!(layer.len(), usize::from(bit(class.reach)));
                    let Some(layer) = layer.first() else { continue };
                    let mut key = BTreeSet::new();
                    for (k, (piece, hidden)) in pieces.iter().enumerate() {
                        let (face, nodes) = match class.faces[k] {
                            Some(face) => (Some(face), hidden.from(face)),
                            None => (classes.iter().filter_map(|c| c.faces[k]).min(), hidden.solid),
                        };
                        key.extend(face.filter(|_| bit(nodes)).map(|face| (*piece, face)));
                    }
                    let sides: BTreeSet<_> = found.sides[*layer]
                        .iter()
                        .filter(|side| bit(side.nodes))
                        .map(|side| (side.of.piece, side.of.face))
                        .collect();
                    prop_assert_eq!(&sides, &key);
                    for (other_layer, other) in &keys {
                        prop_assert_eq!(other_layer == layer, *other == key);
                    }
                    keys.push((*layer, key));
                    used.insert(*layer);
                }
                prop_assert!(used.iter().copied().eq(0..used.len()));
            }
            prop_assert_eq!(pieces.len(), PIECES);
            for sides in &found.sides {
                prop_assert!(sides.windows(2).all(|pair| pair[0].of < pair[1].of));
            }
        }
    }

    #[test]
    fn where_all_are_before_the_same_face_there_is_one_layer() {
        let hidden = Hidden { solid: 0xff, before: [0, 0xff00, 0, 0, 0, 0] };
        let class = |face: Option<i32>, reach| Class { faces: vec![face.map(Face::from_number)], reach };
        let one =
            layers(&[class(Some(0), 0xffff), class(Some(0), 0xff_ff00), class(None, !0)], &[(4, hidden)]);
        // Who is too far off does not reach into the solid, but may be beyond it.
        assert_eq!(one.of_class, [vec![0xffff], vec![0xff_ff00], vec![!0xff00, 0xff00]]);
        let two = layers(&[class(Some(0), 0xffff), class(Some(1), 0xffff)], &[(4, hidden)]);
        assert_eq!(two.of_class, [vec![0xffff], vec![0, 0xffff]]);
        assert_eq!(
            two.sides[1],
            [Side { of: WallFace { piece: 4, face: Face::from_number(1) }, nodes: 0xff }]
        );
    }
}
