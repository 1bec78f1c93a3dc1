//! How much light reaches a point: a sky and a large lamp, as a number of directions with a depth map each.
//!
//! Each map holds how high the topmost powder or tool lies, seen from the direction that the light comes from. The
//! maps of all directions together give ambient occlusion and soft shadows, the same whichever way the camera looks and
//! without noise. A pixel has four samples, and each of them asks a quarter of the directions.

use std::borrow::Cow;

use rayon::prelude::*;

use super::facet::{Facet, unit};
use super::raster::covered;
use super::{SAMPLES, V};

/// Directions to the sky and to points of the lamp. Multiples of [`SAMPLES`].
const SKY: usize = 36;
const LAMP: usize = 20;

/// Share of the light on a level surface that comes from the lamp.
const LAMP_SHARE: f32 = 0.55;

/// Tangent of the angle that the lamp's radius is seen at: how soft shadows are.
const LAMP_TANGENT: f32 = 0.16;

/// Share of the light that comes through a translucent wall.
const THROUGH: f32 = 0.72;

/// Light that comes from below, scattered by the floor, as a share of that on a level surface.
const BOUNCE: f32 = 0.22;

/// What shades in one moment, a map for each light.
pub(super) struct Maps<'a> {
    opaque: Vec<Map>,
    translucent: Cow<'a, [Map]>,
    /// Of what is large, over the surroundings; empty where there are none.
    far: Vec<Map>,
}

/// Directions, and the regions of space that their maps cover.
pub(super) struct Lights {
    lights: Vec<Light>,
    near: Region,
    /// Beyond it, coarser.
    far: Option<Region>,
    /// For each light, how high the topmost translucent wall lies.
    walls: Vec<Map>,
}

/// What a light's map covers.
#[derive(Clone, Copy)]
struct Region {
    middle_m: V,
    /// Texels along an edge of a map.
    size: usize,
    texel_m: f32,
}

/// Texels along an edge of a coarse map.
const FAR_TEXELS: usize = 400;

impl Region {
    /// A sphere of a radius about `middle_m`.
    fn new(middle_m: V, radius_m: f32, texel_m: f32) -> Self {
        Self { middle_m, size: (2.0 * radius_m / texel_m).ceil() as usize, texel_m }
    }

    fn nothing(&self) -> Map {
        vec![f32::NEG_INFINITY; self.size * self.size]
    }

    /// Column and row in a light's map, and height towards it in metres.
    fn place(&self, light: &Light, point_m: &V) -> [f32; 3] {
        let [across, along, towards] = &light.axes;
        let from = point_m - self.middle_m;
        let half = 0.5 * self.size as f32;
        [half + from.dot(across) / self.texel_m, half + from.dot(along) / self.texel_m, from.dot(towards)]
    }

    /// The texel that shades a point, and how high the point is over the middle; none outside.
    fn texel(&self, light: &Light, point_m: &V) -> Option<(usize, f32)> {
        let [x, y, height] = self.place(light, point_m);
        let inside = |value: f32| value >= 0.0 && value < self.size as f32;
        (inside(x) && inside(y)).then(|| (y as usize * self.size + x as usize, height))
    }
}

struct Light {
    /// Two axes across the light and one towards it.
    axes: [V; 3],
    weight: f32,
}

/// Height over the middle along the light's direction, metres; minus infinity where nothing is.
type Map = Vec<f32>;

impl Lights {
    /// Lights over a sphere of a radius about `middle_m`; the lamp stands to the left of a camera that looks at azimuth
    /// `azimuth_rad`.
    pub(super) fn new(middle_m: V, radius_m: f32, texel_m: f32, azimuth_rad: f32, walls: &[Facet]) -> Self {
        let texel_m = texel_m.clamp(radius_m / 320.0, radius_m / 32.0);
        let near = Region::new(middle_m, radius_m, texel_m);
        let mut lights = Self { lights: directions(azimuth_rad), near, far: None, walls: Vec::new() };
        lights.walls = (0..lights.lights.len())
            .map(|light| lights.map(&near, near.nothing(), light, &[], 0.0, walls))
            .collect();
        lights
    }

    /// The same, where something large also shades what is beyond: over a sphere about another middle.
    pub(super) fn beyond(mut self, middle_m: V, radius_m: f32) -> Self {
        self.far = Some(Region::new(middle_m, radius_m, 2.0 * radius_m / FAR_TEXELS as f32));
        self
    }

    /// The maps for powder of a radius, for solids, of which the last ones, `large`, shade what is beyond as well, and for
    /// translucent walls besides those that are always there.
    pub(super) fn maps(
        &self,
        powder_m: &[V],
        radius_m: f32,
        [small, large]: [&[Facet]; 2],
        more_walls: &[Facet],
    ) -> Maps<'_> {
        let near = &self.near;
        let opaque = (0..self.lights.len())
            .into_par_iter()
            .map(|light| {
                let map = self.map(near, near.nothing(), light, powder_m, radius_m, small);
                self.map(near, map, light, &[], 0.0, &self.facing(light, large))
            })
            .collect();
        let with_more =
            |(light, map): (usize, &Map)| self.map(near, map.clone(), light, &[], 0.0, more_walls);
        let translucent = match more_walls {
            [] => Cow::Borrowed(&self.walls[..]),
            _ => Cow::Owned(self.walls.par_iter().enumerate().map(with_more).collect()),
        };
        let beyond = |far: &Region| {
            let map = |light| self.map(far, far.nothing(), light, &[], 0.0, &self.facing(light, large));
            (0..self.lights.len()).into_par_iter().map(map).collect()
        };
        Maps { opaque, translucent, far: self.far.as_ref().map_or_else(Vec::new, beyond) }
    }

    /// The triangles of closed solids that face a light: no others are topmost.
    fn facing(&self, light: usize, solids: &[Facet]) -> Vec<Facet> {
        let towards = &self.lights[light].axes[2];
        let faces = |facet: &&Facet| facet.normals.iter().any(|normal| normal.dot(towards) > 0.0);
        solids.iter().filter(faces).cloned().collect()
    }

    /// A map with more in it.
    fn map(
        &self,
        region: &Region,
        mut map: Map,
        light: usize,
        powder_m: &[V],
        radius_m: f32,
        solids: &[Facet],
    ) -> Map {
        let (light, size) = (&self.lights[light], region.size);
        let reach = radius_m / region.texel_m;
        for centre in powder_m {
            let [x, y, height] = region.place(light, centre);
            let rows =
                (y - reach).max(0.0).round() as usize..((y + reach).round().max(0.0) as usize).min(size);
            for row in rows {
                let aside = row as f32 + 0.5 - y;
                let half = (reach * reach - aside * aside).max(0.0).sqrt();
                let first = (x - half).max(0.0).round() as usize;
                let end = ((x + half).round().max(0.0) as usize).min(size);
                for texel in &mut map[row * size + first.min(end)..row * size + end] {
                    *texel = texel.max(height);
                }
            }
        }
        for facet in solids {
            let corners = facet.corners.map(|corner| region.place(light, &corner));
            covered(corners, [size; 2], |column, row, share, _| {
                let height = (0..3).map(|corner| share[corner] * corners[corner][2]).sum::<f32>();
                let texel = &mut map[row * size + column];
                *texel = texel.max(height);
            });
        }
        map
    }

    /// Light on a surface in one of a pixel's samples; 1 on a level surface that nothing shades.
    pub(super) fn at(&self, maps: &Maps<'_>, sample: usize, point_m: &V, normal: &V) -> f32 {
        // A surface must not shade itself by the coarseness of the map.
        let above = |region: &Region| point_m + normal * (1.5 * region.texel_m);
        let (near, far) = (above(&self.near), self.far.as_ref().map(above));
        let mut sum = BOUNCE * (0.5 - 0.5 * normal.z);
        for (index, light) in self.lights.iter().enumerate().skip(sample).step_by(SAMPLES) {
            let incidence = normal.dot(&light.axes[2]);
            if incidence > 0.0 {
                sum += light.weight * incidence * self.passes(maps, index, &near, far.as_ref());
            }
        }
        sum
    }

    /// Share of a light that reaches a point, which is given a little above its surface, for near and for coarse maps.
    fn passes(&self, maps: &Maps<'_>, light: usize, point_m: &V, far_point_m: Option<&V>) -> f32 {
        let Some((texel, height)) = self.near.texel(&self.lights[light], point_m) else {
            let beyond = self.far.as_ref().zip(far_point_m);
            let found = beyond.and_then(|(far, point_m)| far.texel(&self.lights[light], point_m));
            let is_shaded = found.is_some_and(|(texel, height)| maps.far[light][texel] > height);
            return if is_shaded { 0.0 } else { 1.0 };
        };
        match (maps.opaque[light][texel] > height, maps.translucent[light][texel] > height) {
            (true, _) => 0.0,
            (false, true) => THROUGH,
            (false, false) => 1.0,
        }
    }
}

fn directions(azimuth_rad: f32) -> Vec<Light> {
    let (sine, cosine) = azimuth_rad.sin_cos();
    let (right, away) = (V::new(cosine, sine, 0.0), V::new(-sine, cosine, 0.0));
    let lamp = unit(&(right * -0.62 - away * 0.30 + V::z() * 0.95));
    let (across, along) = basis(&lamp);
    // Sunflower spirals, which cover a disc evenly; of every four neighbours each sample gets one.
    let turn = |index: usize| (2.399_963 * index as f32).sin_cos();
    let sky = (0..SKY).map(|index| {
        // The projection of a sky of even brightness is a disc of even density.
        let share = (index as f32 + 0.5) / SKY as f32;
        let (radius, (y, x)) = (0.97 * share.sqrt(), turn(index));
        let up = (1.0 - radius * radius).sqrt();
        (V::new(radius * x, radius * y, up), (1.0 - LAMP_SHARE) / up)
    });
    let points = (0..LAMP).map(|index| {
        let radius = LAMP_TANGENT * ((index as f32 + 0.5) / LAMP as f32).sqrt();
        let (y, x) = turn(index);
        let direction = unit(&(lamp + across * (radius * x) + along * (radius * y)));
        (direction, LAMP_SHARE / direction.z * SKY as f32 / LAMP as f32)
    });
    let mut lights: Vec<_> = sky
        .chain(points)
        .map(|(direction, weight)| {
            let (across, along) = basis(&direction);
            Light { axes: [across, along, direction], weight }
        })
        .collect();
    for sample in 0..SAMPLES {
        let level: f32 =
            lights.iter().skip(sample).step_by(SAMPLES).map(|light| light.weight * light.axes[2].z).sum();
        lights.iter_mut().skip(sample).step_by(SAMPLES).for_each(|light| light.weight /= level);
    }
    lights
}

/// Two directions across a third.
fn basis(direction: &V) -> (V, V) {
    let helper = if direction.z.abs() < 0.9 { V::z() } else { V::x() };
    let across = unit(&helper.cross(direction));
    (across, direction.cross(&across))
}
