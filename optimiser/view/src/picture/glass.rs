//! Containers and gates that the powder is seen through.

use super::Body;
use super::camera::View;
use super::facet::unit;
use super::raster::fragments;

/// Width of the line along a fold, in samples.
const LINE_PX: f32 = 2.2;

/// What is not covered by one layer of a wall seen head-on, along its rim, and along a line.
const WALL: f32 = 0.075;
const GRAZING: f32 = 0.30;
const RIM: f32 = 0.30;
const LINE: f32 = 0.60;

/// One translucent layer in a sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layer {
    depth_m: f32,
    colour: [f32; 3],
    cover: f32,
}

/// All layers, sample after sample, in each from back to front.
pub(super) struct Glass {
    layers: Vec<Layer>,
    /// Where each sample's layers begin, and where the last one's end.
    first: Vec<u32>,
}

impl Glass {
    /// Some bodies.
    pub(super) fn new<'a>(view: &View, bodies: impl Iterator<Item = &'a Body>) -> Self {
        let mut found: Vec<(u32, Layer)> = Vec::new();
        for Body { facets, colour, .. } in bodies {
            for facet in facets {
                fragments(view, facet, |fragment| {
                    let sight = unit(&(view.eye - fragment.point_m));
                    let slant = fragment.normal.dot(&sight);
                    if slant > 0.0 {
                        let cover = cover(slant, fragment.normal.z, fragment.to_crease_px);
                        let colour = colour.map(|part| part * (0.75 + 0.35 * fragment.normal.z.max(0.0)));
                        found.push((
                            fragment.pixel as u32,
                            Layer { depth_m: fragment.depth_m, colour, cover },
                        ));
                    }
                });
            }
        }
        // A stable sort: layers that touch stay in the order of the mesh.
        found.sort_by(|a, b| a.0.cmp(&b.0).then(b.1.depth_m.total_cmp(&a.1.depth_m)));
        let samples = view.size_px[0] * view.size_px[1];
        let mut first = vec![0; samples + 1];
        for (sample, _) in &found {
            first[*sample as usize + 1] += 1;
        }
        for sample in 0..samples {
            first[sample + 1] += first[sample];
        }
        Self { layers: found.into_iter().map(|(_, layer)| layer).collect(), first }
    }

    /// A colour as it is seen through all layers nearer than it.
    pub(super) fn over(&self, sample: usize, depth_m: f32, colour: [f32; 3]) -> [f32; 3] {
        let layers = &self.layers[self.first[sample] as usize..self.first[sample + 1] as usize];
        layers.iter().filter(|layer| layer.depth_m < depth_m).fold(colour, |below, layer| {
            [0, 1, 2].map(|part| below[part] + layer.cover * (layer.colour[part] - below[part]))
        })
    }
}

fn cover(slant: f32, level: f32, to_crease_px: f32) -> f32 {
    let grazing = (1.0 - slant).powi(3);
    let wall = WALL + GRAZING * grazing;
    let surface = if level > 0.9 { wall.max(RIM * level) } else { wall };
    let line = (1.5 - to_crease_px / LINE_PX).clamp(0.0, 1.0);
    surface + (LINE - surface).max(0.0) * line
}
