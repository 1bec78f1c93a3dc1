//! Triangles ready to be drawn: with smooth normals, and knowing which of their edges are edges of the solid.

use std::collections::HashMap;

use super::V;
use crate::mesh::Mesh;

/// Cosine of the angle up to which neighbouring triangles are one curved surface.
const CREASE_COSINE: f32 = 0.77;

/// Corners nearer to each other than this are one, metres.
const WELD_M: f64 = 1e-8;

/// A triangle.
#[derive(Clone, Debug)]
pub(super) struct Facet {
    pub(super) corners: [V; 3],
    pub(super) normals: [V; 3],
    /// Whether the surface has a fold at the edge opposite to each corner.
    pub(super) creases: [bool; 3],
}

impl Facet {
    /// The same elsewhere.
    pub(super) fn moved(&self, turn: &nalgebra::UnitQuaternion<f32>, by: &V) -> Self {
        Self {
            corners: self.corners.map(|corner| turn * corner + by),
            normals: self.normals.map(|normal| turn * normal),
            creases: self.creases,
        }
    }
}

/// All triangles of a mesh that have an area.
pub(super) fn facets(mesh: &Mesh) -> Vec<Facet> {
    let triangles: Vec<_> = mesh.triangles.iter().filter_map(|triangle| Flat::new(mesh, triangle)).collect();
    let mut around: HashMap<Key, Vec<usize>> = HashMap::new();
    let mut beside: HashMap<[Key; 2], Vec<usize>> = HashMap::new();
    for (index, flat) in triangles.iter().enumerate() {
        for corner in 0..3 {
            around.entry(flat.keys[corner]).or_default().push(index);
            beside.entry(flat.edge(corner)).or_default().push(index);
        }
    }
    let smooth = |one: &Flat, other: usize| one.normal.dot(&triangles[other].normal) > CREASE_COSINE;
    let normal = |flat: &Flat, corner: usize| {
        let near = around[&flat.keys[corner]].iter().filter(|other| smooth(flat, **other));
        unit(&near.map(|other| triangles[*other].normal * triangles[*other].area_m2).sum())
    };
    let crease =
        |flat: &Flat, corner: usize| !beside[&flat.edge(corner)].iter().all(|other| smooth(flat, *other));
    let facet = |flat: &Flat| Facet {
        corners: flat.corners,
        normals: [0, 1, 2].map(|corner| normal(flat, corner)),
        creases: [0, 1, 2].map(|corner| crease(flat, corner)),
    };
    triangles.iter().map(facet).collect()
}

/// A corner's place, in units of [`WELD_M`].
type Key = [i64; 3];

struct Flat {
    corners: [V; 3],
    keys: [Key; 3],
    normal: V,
    area_m2: f32,
}

impl Flat {
    fn new(mesh: &Mesh, triangle: &[u32; 3]) -> Option<Self> {
        let points =
            triangle.map(|corner| mesh.points_m.get(corner as usize).copied().unwrap_or([f64::NAN; 3]));
        let corners = points.map(|point| V::from(point.map(|x| x as f32)));
        let across = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        let area_m2 = 0.5 * length(&across);
        let keys = points.map(|point| point.map(|x| (x / WELD_M).round() as i64));
        (area_m2 > 0.0).then(|| Self { corners, keys, normal: unit(&across), area_m2 })
    }

    /// The edge opposite to a corner, whichever way it is run through.
    fn edge(&self, corner: usize) -> [Key; 2] {
        let mut edge = [self.keys[(corner + 1) % 3], self.keys[(corner + 2) % 3]];
        edge.sort_unstable();
        edge
    }
}

/// Length of a vector: `sqrt` of the processor, which nalgebra's `norm` is not here.
pub(super) fn length(vector: &V) -> f32 {
    vector.dot(vector).sqrt()
}

/// A vector made one long; zero stays zero.
pub(super) fn unit(vector: &V) -> V {
    vector / length(vector).max(f32::MIN_POSITIVE)
}
