//! Still pictures and animations, drawn without a GPU.
//!
//! A depth buffer holds the nearest surface of each sample, two by two samples to a pixel. Light comes from a sky and a
//! large lamp (see `light`), containers and gates are laid over the powder as translucent layers, or cut open. The same input
//! gives the same bytes, whatever the number of threads; those of the current rayon pool are used.
//!
//! ```no_run
//! # use powderline_view::{Bench, Frame, ViewError, picture::{Camera, Look, Painter}};
//! # fn example(bench: &Bench, frame: &Frame<'_>) -> Result<(), ViewError> {
//! let painter = Painter::new(bench, &Camera::default(), &Look::default())?;
//! painter.draw(frame, &[]).write(std::path::Path::new("bench.png"))
//! # }
//! ```

mod animation;
mod axes;
mod camera;
mod encode;
mod facet;
mod glass;
mod label;
mod light;
mod raster;
#[cfg(test)]
pub(crate) mod sample;
mod stills;

use nalgebra::UnitQuaternion;
use powderline_shared::pose::Pose;
use rayon::prelude::*;

use crate::arm::{Arm, Capsule};
use crate::mesh::Mesh;
use crate::{Bench, Container, Destination, Frame, Gate, Role, ViewError};

pub use animation::{Animation, Progress};
pub use camera::Camera;
pub use stills::Stills;

use camera::View;
use facet::{Facet, facets};
use glass::Glass;
use label::Pen;
use light::{Lights, Maps};
use raster::{Canvas, Finish, Texel};

type V = nalgebra::Vector3<f32>;

/// Red, green, blue as shown on a screen (sRGB).
pub type Rgb = [u8; 3];

/// Samples along an edge of a pixel, and in a pixel.
const FINE: usize = 2;
const SAMPLES: usize = FINE * FINE;

/// Radius of the sphere that has a particle's volume, where eight particles fill a cell; in cells.
const RADIUS_CELLS: f32 = 0.31;

/// Pixels along an edge of a picture.
const SIZE_PX: std::ops::RangeInclusive<usize> = 16..=8192;

/// Grains drawn for a particle.
const GRAINS: std::ops::RangeInclusive<usize> = 1..=64;

/// What a picture looks like.
#[derive(Clone, Debug, PartialEq)]
pub struct Look {
    /// Pixels across, 16 to 8192.
    pub width_px: usize,
    /// Pixels down, 16 to 8192.
    pub height_px: usize,
    /// What the powder's colour says.
    pub colouring: Colouring,
    /// Colour of what is behind everything, and of the floor.
    pub background: Rgb,
    /// How the powder in a container is made visible.
    pub containers: Containers,
    /// A particle stands for many grains of powder; so many of them are drawn at fixed random places about it, with
    /// its volume together. 1 draws each particle as one sphere, at its place. 1 to 64.
    pub grains: usize,
    /// Whether time, ruler and the meaning of colours are drawn.
    pub labels: bool,
    /// Whether the axes of the tool's frame are drawn, and with an arm those of its flange.
    pub axes: bool,
}

impl Default for Look {
    fn default() -> Self {
        Self {
            width_px: 1280,
            height_px: 960,
            colouring: Colouring::Plain([226, 176, 96]),
            background: [250, 250, 251],
            containers: Containers::Translucent,
            grains: 12,
            labels: true,
            axes: false,
        }
    }
}

/// What the powder's colour says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Colouring {
    /// Nothing: all of it has this one.
    Plain(Rgb),
    /// How fast a particle moves.
    Speed {
        /// Faster than this looks the same, m/s.
        max_m_s: f64,
    },
    /// How high a particle is above the floor.
    Height {
        /// Higher than this looks the same, metres.
        max_m: f64,
    },
    /// Where a particle is when all is over. Without destinations all is drawn as left.
    Destination,
}

/// How the powder in a container is made visible.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Containers {
    /// Walls are translucent.
    Translucent,
    /// Walls are solid, and cut open through the middle where they stand before the powder.
    CutOpen,
}

/// A finished picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Pixels across.
    pub width_px: usize,
    /// Pixels down.
    pub height_px: usize,
    /// Row by row from the top, three bytes a pixel.
    pub rgb: Vec<u8>,
}

impl Image {
    /// Lays a colour over a pixel, 255 covering it; pixels outside are left out.
    fn blend(&mut self, [column, row]: [usize; 2], colour: Rgb, cover: u8) {
        if column >= self.width_px || row >= self.height_px {
            return;
        }
        let at = 3 * (row * self.width_px + column);
        let cover = i32::from(cover);
        for (below, above) in self.rgb[at..at + 3].iter_mut().zip(colour) {
            *below = ((i32::from(*below) * (255 - cover) + i32::from(above) * cover + 127) / 255) as u8;
        }
    }
}

/// Something that powder may be seen through, or that is cut open.
struct Body {
    facets: Vec<Facet>,
    middle: V,
    /// Linear.
    colour: [f32; 3],
}

impl Body {
    fn new(mesh: &Mesh, colour: Rgb) -> Self {
        Self { facets: facets(mesh), middle: middle(mesh), colour: linear(colour) }
    }

    fn moved(&self, by: &V) -> Self {
        let still = UnitQuaternion::identity();
        let facets = self.facets.iter().map(|facet| facet.moved(&still, by)).collect();
        Self { facets, middle: self.middle + by, colour: self.colour }
    }
}

/// Draws moments of one bench with one camera.
pub struct Painter {
    camera: Camera,
    look: Look,
    view: View,
    lights: Lights,
    containers: Vec<Body>,
    /// The containers, if they are seen through.
    glass: Glass,
    /// Gates where they are shut, and where they are when.
    gates: Vec<(Body, Gate)>,
    tool: Vec<Facet>,
    arm: Option<Arm>,
    /// What the bench and the arm's base stand on.
    stand: Vec<Facet>,
    ground_m: f32,
    /// Length of axes that are drawn.
    axis_m: f32,
    ruler: Ruler,
    radius_m: f32,
}

impl Painter {
    /// Gets ready.
    ///
    /// # Errors
    /// If a number of the camera or the look is out of its range.
    pub fn new(bench: &Bench, camera: &Camera, look: &Look) -> Result<Self, ViewError> {
        check(bench, camera, look)?;
        let ruler = Ruler::new(bench, camera);
        let mut points = camera::corners(bench);
        points.extend(ruler.ends_m);
        let size_px = [look.width_px * FINE, look.height_px * FINE];
        let view = View::framing(camera, size_px, &points);
        let containers: Vec<_> = bench.containers.iter().map(|it| Body::new(&it.mesh, tint(it))).collect();
        let walls = all_facets(&containers);
        let [middle, size] =
            [bench.extent.middle_m(), bench.extent.size_m()].map(|of| V::from(of.map(|x| x as f32)));
        let texel_m = bench.cell_m as f32 / 6.0;
        let azimuth_rad = camera.azimuth_deg.to_radians() as f32;
        let lights = Lights::new(middle, 0.62 * facet::length(&size), texel_m, azimuth_rad, &walls);
        let lights = match &bench.arm {
            Some(_) => {
                let all = bench.clone().framed_with_arm().extent;
                let [middle, size] = [all.middle_m(), all.size_m()].map(|of| V::from(of.map(|x| x as f32)));
                lights.beyond(middle, 0.65 * facet::length(&size))
            }
            None => lights,
        };
        let is_glass = look.containers == Containers::Translucent;
        let glass = Glass::new(&view, containers.iter().filter(|_| is_glass));
        let gates = bench.gates.iter().map(|gate| (Body::new(&gate.mesh, GATE), gate.clone())).collect();
        let radius_m = RADIUS_CELLS * bench.cell_m as f32;
        let (tool, camera, look) = (facets(&bench.tool), *camera, look.clone());
        let axis_m = AXIS * facet::length(&size);
        let (arm, ground_m) = (bench.arm.clone(), bench.ground_m() as f32);
        let stand = bench.stand().map_or_else(Vec::new, |stand| facets(&stand));
        Ok(Self {
            camera,
            look,
            view,
            lights,
            containers,
            glass,
            gates,
            tool,
            arm,
            stand,
            ground_m,
            axis_m,
            ruler,
            radius_m,
        })
    }

    /// Draws a frame. `destinations` may be empty, unless they are what is to be seen.
    #[must_use]
    pub fn draw(&self, frame: &Frame<'_>, destinations: &[Destination]) -> Image {
        self.paint(&Moment::from(frame), destinations)
    }

    fn paint(&self, moment: &Moment, destinations: &[Destination]) -> Image {
        let (tool, gates) = (self.tool_at(&moment.tool), self.gates_at(moment.time_s));
        let arm = self.arm_at(moment.time_s);
        let canvas = self.surfaces(moment, [&tool, &arm], &gates, destinations);
        let places: Vec<V> = moment.powder.iter().map(place).filter(is_finite).collect();
        let large = [&arm[..], &self.stand].concat();
        let maps = self.lights.maps(&places, self.radius_m, [&tool, &large], &all_facets(&gates));
        let glass = self.is_glass() && !gates.is_empty();
        let glass = glass.then(|| Glass::new(&self.view, self.containers.iter().chain(&gates)));
        let seen = Seen { canvas, maps, glass: glass.as_ref().unwrap_or(&self.glass) };
        let background = linear(self.look.background);
        let shades = Shades::new();
        let mut rgb = vec![0; 3 * self.look.width_px * self.look.height_px];
        rgb.par_chunks_mut(3 * self.look.width_px).enumerate().for_each(|(row, line)| {
            for (column, pixel) in line.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                let mut sum = [0.0; 3];
                for sample in 0..SAMPLES {
                    let at = (FINE * column + sample % FINE, FINE * row + sample / FINE);
                    let colour = self.sample(&seen, sample, at, &background);
                    sum = [0, 1, 2].map(|part| sum[part] + colour[part].min(1.0) / SAMPLES as f32);
                }
                *pixel = sum.map(|part| shades.of(part));
            }
        });
        let mut image = Image { width_px: self.look.width_px, height_px: self.look.height_px, rgb };
        if self.look.axes {
            self.axes(&mut image, moment);
        }
        if self.look.labels {
            self.label(&mut image, moment.time_s, destinations);
        }
        image
    }

    /// The tool's surface where the tool is; nowhere if that cannot be said.
    fn tool_at(&self, pose: &Pose) -> Vec<Facet> {
        let by = V::from([pose.position_m.x, pose.position_m.y, pose.position_m.z].map(|x| x as f32));
        let turn: UnitQuaternion<f32> = pose.orientation.cast();
        if !is_finite(&by) || !turn.coords.iter().all(|part| part.is_finite()) {
            return Vec::new();
        }
        self.tool.iter().map(|facet| facet.moved(&turn, &by)).collect()
    }

    /// The arm's surface at a time; nothing where there is none.
    fn arm_at(&self, time_s: f64) -> Vec<Facet> {
        let capsules = |arm: &Arm| [arm.standing(), arm.moving(time_s).into()].concat();
        let drawn = |Capsule { ends_m: [from, to], radius_m }| facets(&Mesh::capsule(from, to, radius_m));
        self.arm.iter().flat_map(capsules).flat_map(drawn).collect()
    }

    /// The gates that are there at a time.
    fn gates_at(&self, time_s: f64) -> Vec<Body> {
        let at = |(body, gate): &(Body, Gate)| {
            Some(body.moved(&V::from(gate.law.displacement_m(time_s)?.map(|along_m| along_m as f32))))
        };
        self.gates.iter().filter_map(at).collect()
    }

    fn is_glass(&self) -> bool {
        self.look.containers == Containers::Translucent
    }

    /// What is seen where, behind translucent walls.
    fn surfaces(
        &self,
        moment: &Moment,
        [tool, arm]: [&[Facet]; 2],
        gates: &[Body],
        destinations: &[Destination],
    ) -> Canvas<'_> {
        let mut canvas = Canvas::floor(&self.view, self.ground_m);
        canvas.solid(&self.stand, [0.0; 3], Finish::Floor);
        let facing = self.camera.facing();
        let cut = self.containers.iter().chain(gates).filter(|_| !self.is_glass());
        for Body { facets, middle, colour } in cut {
            canvas.cut(facets, middle, &facing, [*colour, colour.map(|part| 0.55 * part)]);
        }
        if self.look.labels {
            self.ruler.draw(&mut canvas);
        }
        canvas.solid(arm, linear(ARM), Finish::Matt);
        canvas.solid(tool, linear([150, 158, 170]), Finish::Metal);
        for (index, grain) in moment.powder.iter().enumerate() {
            let at = place(grain);
            if is_finite(&at) {
                let colour = linear(self.look.colouring.of(grain, destinations.get(index).copied()));
                self.grains(&mut canvas, index as u32, &at, colour);
            }
        }
        canvas
    }

    fn grains(&self, canvas: &mut Canvas<'_>, particle: u32, at: &V, colour: [f32; 3]) {
        let count = self.look.grains;
        if count == 1 {
            let shade = 0.92 + 0.16 * random(particle, 0);
            return canvas.sphere(at, self.radius_m, colour.map(|part| part * shade));
        }
        // Spheres do not fill space: a little larger than their share.
        let radius_m = 1.12 * self.radius_m / (count as f32).cbrt();
        for grain in 0..count as u32 {
            let number = |which| random(particle, 5 * grain + which);
            let aside =
                V::new(number(1), number(2), number(3)).map(|part| (2.0 * part - 1.0) * 0.9 * self.radius_m);
            let shade = 0.86 + 0.28 * number(4);
            canvas.sphere(&(at + aside), radius_m * (0.8 + 0.4 * number(5)), colour.map(|part| part * shade));
        }
    }

    /// The colour in one of a pixel's samples, linear.
    fn sample(
        &self,
        seen: &Seen<'_>,
        sample: usize,
        (column, row): (usize, usize),
        background: &[f32; 3],
    ) -> [f32; 3] {
        let index = row * self.view.size_px[0] + column;
        let texel = &seen.canvas.texels[index];
        if texel.finish == Finish::Empty {
            return seen.glass.over(index, texel.depth_m, *background);
        }
        let point = self.view.eye + self.view.world(&self.view.ray(column, row)) * texel.depth_m;
        let light = self.lights.at(&seen.maps, sample, &point, &texel.normal);
        let colour = match texel.finish {
            Finish::Metal => self.metal(texel, &point, light),
            Finish::Floor => background.map(|part| part * light.min(1.0)),
            Finish::Matt | Finish::Empty => texel.albedo.map(|part| part * light),
        };
        seen.glass.over(index, texel.depth_m, colour)
    }

    /// Polished metal: it reflects a sky that is bright above and a floor that is darker.
    fn metal(&self, texel: &Texel, point: &V, light: f32) -> [f32; 3] {
        let sight = facet::unit(&(point - self.view.eye));
        let slant = -sight.dot(&texel.normal);
        let mirrored = sight + texel.normal * (2.0 * slant);
        let share = (0.5 + 0.9 * mirrored.z).clamp(0.0, 1.0);
        let sky = 0.12 + 0.75 * share * share * (3.0 - 2.0 * share);
        let edge = 0.25 + 0.75 * (1.0 - slant.clamp(0.0, 1.0)).powi(4);
        // Where little light comes to, little is reflected.
        let reflected = edge * sky * (0.25 + 0.75 * light.min(1.0));
        texel.albedo.map(|part| part * light * 0.75 + reflected * 0.8)
    }

    fn axes(&self, image: &mut Image, moment: &Moment) {
        let length_m = f64::from(self.axis_m);
        axes::draw(image, &self.view, &moment.tool, length_m, "tool");
        if let Some(arm) = &self.arm {
            axes::draw(image, &self.view, &arm.flange(moment.time_s), length_m, "flange");
        }
    }

    fn label(&self, image: &mut Image, time_s: f64, destinations: &[Destination]) {
        let pen = Pen::on(image, self.look.background);
        let margin = pen.line_px();
        pen.write(image, [margin, margin / 2], &format!("{time_s:.2} s"));
        if let Some([x, y]) = self.ruler.label_px(&self.view) {
            let left = (x as usize).saturating_sub(pen.width_px(&self.ruler.name) / 2);
            pen.write(image, [left, y as usize + pen.line_px() / 6], &self.ruler.name);
        }
        // A picture may be narrower than a tall one's margin.
        let corner = [image.width_px.saturating_sub(margin), image.height_px.saturating_sub(margin / 2)];
        match self.look.colouring {
            Colouring::Plain(_) => {}
            Colouring::Speed { max_m_s } => {
                pen.scale(image, corner, ["0", &format!("{max_m_s} m/s")], speed_colour)
            }
            Colouring::Height { max_m } => {
                pen.scale(image, corner, ["0", &format!("{} mm", rounded(1e3 * max_m))], height_colour);
            }
            Colouring::Destination => pen.key(image, corner, &key(destinations)),
        }
    }
}

/// What there is to be seen in a moment.
struct Seen<'a> {
    /// Behind translucent walls.
    canvas: Canvas<'a>,
    maps: Maps<'a>,
    glass: &'a Glass,
}

/// One frame, kept.
struct Moment {
    time_s: f64,
    tool: Pose,
    /// x, y, z in metres and speed in m/s.
    powder: Vec<[f32; 4]>,
}

impl From<&Frame<'_>> for Moment {
    fn from(frame: &Frame<'_>) -> Self {
        let still = [0.0; 3];
        let speed = |index: usize| {
            let velocity = frame.velocities_m_s.get(index).unwrap_or(&still);
            facet::length(&V::from(*velocity))
        };
        let powder =
            frame.positions_m.iter().enumerate().map(|(index, [x, y, z])| [*x, *y, *z, speed(index)]);
        Self { time_s: frame.time_s, tool: frame.tool, powder: powder.collect() }
    }
}

impl Colouring {
    fn of(&self, [_, _, z, speed]: &[f32; 4], destination: Option<Destination>) -> Rgb {
        match self {
            Self::Plain(colour) => *colour,
            Self::Speed { max_m_s } => speed_colour(f64::from(*speed) / max_m_s),
            Self::Height { max_m } => height_colour(f64::from(*z) / max_m),
            Self::Destination => destination_colour(destination.unwrap_or(Destination::Source)),
        }
    }

    fn is_valid(&self) -> bool {
        match self {
            Self::Plain(_) | Self::Destination => true,
            Self::Speed { max_m_s: max } | Self::Height { max_m: max } => (1e-9..=1e9).contains(max),
        }
    }
}

/// Slow is dark blue, fast is yellow; both colour-blind readers and printers without colour can tell them apart.
fn speed_colour(share: f64) -> Rgb {
    colorous::PLASMA.eval_continuous(clamped(share)).as_array()
}

fn height_colour(share: f64) -> Rgb {
    colorous::VIRIDIS.eval_continuous(clamped(share)).as_array()
}

/// From 0 to 1; not-a-number is 0.
fn clamped(share: f64) -> f64 {
    if share > 0.0 { share.min(1.0) } else { 0.0 }
}

/// Colours that colour-blind readers can tell apart, after M. Okabe and K. Ito.
fn destination_colour(destination: Destination) -> Rgb {
    match destination {
        Destination::Source => [205, 190, 165],
        Destination::Target => [0, 158, 115],
        Destination::Tool => [0, 114, 178],
        Destination::Spilled => [213, 74, 20],
        Destination::Rims => [240, 228, 66],
        Destination::InFlight => [204, 121, 167],
    }
}

fn key(destinations: &[Destination]) -> Vec<(Rgb, String)> {
    let count = |which| destinations.iter().filter(|destination| **destination == which).count();
    let entry = |which: Destination| {
        let name = which.name().replace('_', " ");
        (destination_colour(which), format!("{name:<9}{:>6}", count(which)))
    };
    let is_there = |which: &Destination| destinations.is_empty() || count(*which) > 0;
    Destination::ALL.into_iter().filter(is_there).map(entry).collect()
}

/// Length of a frame's axes, of the diagonal of what is to be seen.
const AXIS: f32 = 0.14;

/// Colour of the arm.
const ARM: Rgb = [216, 219, 224];

/// Colour of gates.
const GATE: Rgb = [134, 112, 160];

fn tint(container: &Container) -> Rgb {
    match container.role {
        Role::Source => [118, 132, 158],
        Role::Target => [70, 150, 150],
        Role::Bystander => [150, 150, 150],
    }
}

/// Middle of the box about a mesh.
fn middle(mesh: &Mesh) -> V {
    let end = |axis: usize, pick: fn(f64, f64) -> f64| {
        mesh.points_m.iter().map(|point| point[axis]).reduce(pick).unwrap_or(0.0)
    };
    V::from([0, 1, 2].map(|axis| 0.5 * (end(axis, f64::min) + end(axis, f64::max)) as f32))
}

fn all_facets(bodies: &[Body]) -> Vec<Facet> {
    bodies.iter().flat_map(|body| body.facets.iter().cloned()).collect()
}

/// A ruler on the floor before the bench, in five parts.
struct Ruler {
    /// Where the parts begin, and where the last one ends.
    ends_m: [V; 6],
    /// Across the ruler, away from the bench; its width.
    across_m: V,
    name: String,
}

impl Ruler {
    fn new(bench: &Bench, camera: &Camera) -> Self {
        let facing = camera.facing();
        let along = V::z().cross(&facing);
        let extent = along.dot(&V::from(bench.extent.size_m().map(|size| size as f32))).abs();
        let length_m = round_length(0.22 * f64::from(extent)) as f32;
        // From the lower left corner of the bench as it is seen, to the right.
        let outwards = facing - along;
        let ends = [bench.extent.low_m, bench.extent.high_m];
        let corner = [0, 1].map(|axis| ends[usize::from(outwards[axis] > 0.0)][axis] as f32);
        let across_m = facing * (0.05 * length_m);
        let beside = facing * (0.06 * extent);
        let start = match bench.stand() {
            // Beyond the block there is no floor to lie on, unless all of it and more is to be seen.
            Some(_) if bench.extent.low_m[2] >= 0.0 => {
                let on = |axis: usize| {
                    let least = (-across_m[axis]).max(0.0);
                    let most = bench.size_m[axis] as f32 - across_m[axis].max(0.0);
                    (corner[axis] + beside[axis]).clamp(least.min(most), most)
                };
                V::new(on(0), on(1), 0.0)
            }
            _ => V::new(corner[0], corner[1], bench.extent.low_m[2].min(0.0) as f32) + beside,
        };
        let ends_m = [0, 1, 2, 3, 4, 5].map(|part| start + along * (length_m * part as f32 / 5.0));
        Self { ends_m, across_m, name: format!("{} mm", rounded(1e3 * f64::from(length_m))) }
    }

    fn draw(&self, canvas: &mut Canvas<'_>) {
        for part in 0..5 {
            let [a, b] = [self.ends_m[part], self.ends_m[part + 1]];
            let corners = [a, a + self.across_m, b + self.across_m, b];
            // Just above the floor, to be seen.
            let lift = V::z() * 1e-4;
            let facet = |[i, j, k]: [usize; 3]| Facet {
                corners: [i, j, k].map(|corner| corners[corner] + lift),
                normals: [V::z(); 3],
                creases: [false; 3],
            };
            let colour = linear(if part % 2 == 0 { [60, 66, 78] } else { [228, 230, 234] });
            canvas.solid(&[facet([0, 1, 2]), facet([0, 2, 3])], colour, Finish::Matt);
        }
    }

    /// Where the upper middle of its name belongs.
    fn label_px(&self, view: &View) -> Option<[f32; 2]> {
        let middle = 0.5 * (self.ends_m[0] + self.ends_m[5]) + self.across_m;
        let [x, y, _] = view.pixel(&view.local(&middle))?;
        (x >= 0.0 && y >= 0.0).then_some([x / FINE as f32, y / FINE as f32])
    }
}

/// The largest 1, 2 or 5 times a power of ten that is no longer, metres.
fn round_length(at_most_m: f64) -> f64 {
    let decade = 10f64.powi(at_most_m.max(1e-6).log10().floor() as i32);
    [5.0, 2.0, 1.0]
        .map(|digit| digit * decade)
        .into_iter()
        .find(|length| *length <= at_most_m)
        .unwrap_or(decade)
}

/// Without digits that only come from arithmetic.
fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

fn place([x, y, z, _]: &[f32; 4]) -> V {
    V::new(*x, *y, *z)
}

fn is_finite(point: &V) -> bool {
    point.iter().all(|part| part.is_finite())
}

/// From 0 to 1, always the same for a particle and a number (the finaliser of MurmurHash3).
fn random(particle: u32, number: u32) -> f32 {
    let mut bits =
        particle.wrapping_mul(0x9e37_79b9) ^ number.wrapping_mul(0x85eb_ca77).wrapping_add(0x1656_67b1);
    bits = (bits ^ bits >> 16).wrapping_mul(0x85eb_ca6b);
    bits = (bits ^ bits >> 13).wrapping_mul(0xc2b2_ae35);
    ((bits ^ bits >> 16) >> 8) as f32 / (1 << 24) as f32
}

/// Linear light of a colour on a screen.
fn linear(colour: Rgb) -> [f32; 3] {
    colour.map(|part| {
        let part = f32::from(part) / 255.0;
        if part <= 0.040_45 { part / 12.92 } else { ((part + 0.055) / 1.055).powf(2.4) }
    })
}

/// Numbers on a screen of linear light, as a table.
struct Shades(Vec<u8>);

impl Shades {
    const STEPS: usize = 8192;

    fn new() -> Self {
        let shade = |step: usize| {
            let light = step as f32 / Self::STEPS as f32;
            let part =
                if light <= 0.003_130_8 { light * 12.92 } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 };
            (part * 255.0).round() as u8
        };
        Self((0..=Self::STEPS).map(shade).collect())
    }

    fn of(&self, light: f32) -> u8 {
        self.0[((light * Self::STEPS as f32).round() as usize).min(Self::STEPS)]
    }
}

fn check(bench: &Bench, camera: &Camera, look: &Look) -> Result<(), ViewError> {
    let setting = |what: String, wanted: &'static str| Err(ViewError::Setting { what, wanted });
    let extent_m = bench.extent.size_m();
    if !extent_m.iter().chain([&bench.cell_m]).all(|size| (1e-6..=1e6).contains(size)) {
        return setting(
            format!("a picture of {extent_m:?} m"),
            "what is to be seen and the cells must be larger than zero",
        );
    }
    let Camera { azimuth_deg, elevation_deg, zoom, field_of_view_deg } = camera;
    if !camera.is_valid() {
        return setting(
            format!(
                "a camera with azimuth {azimuth_deg}, elevation {elevation_deg}, zoom {zoom}, field of view {field_of_view_deg}"
            ),
            "azimuth must be a number of degrees, elevation -90 to 90 degrees, zoom 0.01 to 1000, field of view 5 to 120 degrees",
        );
    }
    if !SIZE_PX.contains(&look.width_px) || !SIZE_PX.contains(&look.height_px) {
        return setting(format!("{} x {} pixels", look.width_px, look.height_px), "each must be 16 to 8192");
    }
    if !GRAINS.contains(&look.grains) {
        return setting(format!("{} grains for a particle", look.grains), "it must be 1 to 64");
    }
    if !look.colouring.is_valid() {
        return setting(format!("{:?}", look.colouring), "the maximum must be larger than zero");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use powderline_simulator::scene::GateOpening;

    use crate::extent::Extent;

    use super::sample::{self, bare, bench, frame, look, positions};
    use super::*;

    const RED: Rgb = [230, 20, 20];

    /// A bench without container and tool, whose cells are so large that a particle covers hundreds of pixels.
    fn empty_bench() -> Bench {
        Bench { cell_m: 0.04, containers: Vec::new(), gates: Vec::new(), tool: Mesh::default(), ..bench() }
    }

    fn painter(bench: &Bench, look: &Look) -> Painter {
        Painter::new(bench, &Camera::default(), look).expect("settings in range")
    }

    fn draw(painter: &Painter, positions_m: &[[f32; 3]], destinations: &[Destination]) -> Image {
        painter.draw(&frame(0, positions_m), destinations)
    }

    /// Pixels of which one channel stands out.
    fn count(image: &Image, channel: usize) -> usize {
        let stands_out = |pixel: &&Rgb| {
            let others = [(channel + 1) % 3, (channel + 2) % 3].map(|other| pixel[other]);
            pixel[channel] > others[0].max(others[1]).saturating_add(20)
        };
        image.rgb.as_chunks::<3>().0.iter().filter(stands_out).count()
    }

    #[test]
    fn a_particle_covers_the_area_that_its_radius_says() {
        let painter = painter(&empty_bench(), &bare(Colouring::Plain(RED)));
        assert_eq!(count(&draw(&painter, &[], &[]), 0), 0);
        for at in [[0.05, 0.05, 0.05], [0.02, 0.08, 0.06], [0.08, 0.02, 0.04]] {
            let depth_m = painter.view.local(&V::from(at)).z;
            let radius_px = painter.view.focal_px / FINE as f32 * painter.radius_m / depth_m;
            let expected = std::f32::consts::PI * radius_px * radius_px;
            let found = count(&draw(&painter, &[at], &[]), 0) as f32;
            assert!(expected > 300.0, "{expected} pixels are too few to be compared");
            assert!((found / expected - 1.0).abs() < 0.06, "{found} pixels, not {expected}, at {at:?}");
        }
    }

    #[test]
    fn a_particle_out_of_view_covers_nothing() {
        let painter = painter(&empty_bench(), &bare(Colouring::Plain(RED)));
        let behind = painter.view.eye - painter.view.forward * 0.1;
        let aside = painter.view.eye + painter.view.forward * 0.1 + painter.view.right;
        for at in [behind, aside] {
            assert_eq!(count(&draw(&painter, &[at.into()], &[]), 0), 0, "{at}");
        }
    }

    #[test]
    fn the_nearer_of_two_particles_is_seen_whichever_is_drawn_first() {
        let painter = painter(&empty_bench(), &bare(Colouring::Destination));
        let far = V::new(0.05, 0.05, 0.05);
        let near = far + (painter.view.eye - far) * 0.1;
        // Spilled powder is red, powder in the target is green.
        let [red, green] = [Destination::Spilled, Destination::Target];
        for (first, second) in [(near, far), (far, near)] {
            let image = draw(&painter, &[first.into(), second.into()], &[red, green]);
            let [seen, hidden] = if first == near { [0, 1] } else { [1, 0] };
            assert!(count(&image, seen) > 300);
            assert_eq!(count(&image, hidden), 0);
        }
    }

    #[test]
    fn the_same_bytes_come_twice_and_with_any_number_of_threads() {
        let bench = bench();
        let draw = |threads: usize, containers| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let look = Look { containers, colouring: Colouring::Height { max_m: 0.05 }, ..look() };
            pool.install(|| painter(&bench, &look).draw(&frame(4, &positions(4)), &[]).to_png())
        };
        for containers in [Containers::Translucent, Containers::CutOpen] {
            let one = draw(1, containers);
            assert!(one == draw(1, containers), "drawn twice");
            assert!(one == draw(2, containers), "drawn with two threads");
        }
        assert!(draw(1, Containers::Translucent) != draw(1, Containers::CutOpen));
    }

    #[test]
    fn gates_are_drawn_where_they_are_while_they_are_there() {
        let slid = |travel_m: f64| {
            let mut gate = sample::gate();
            let velocity_m_s = [0.0, 0.0, 0.04];
            gate.law.opening = GateOpening::Slide { velocity_m_s, travel_m };
            Bench { gates: vec![gate], ..bench() }
        };
        for containers in [Containers::Translucent, Containers::CutOpen] {
            let drawn = |bench: &Bench, index: usize| {
                let look = Look { containers, labels: false, ..look() };
                painter(bench, &look).draw(&frame(index, &positions(0)), &[])
            };
            let without = Bench { gates: Vec::new(), ..bench() };
            assert!(drawn(&bench(), 2) != drawn(&without, 2), "it is there");
            assert!(drawn(&bench(), 3) == drawn(&without, 3), "it has gone");
            // After half a second a gate of 40 mm/s is 20 mm away, however far it goes on.
            let [near, far] = [0.02, 0.03].map(slid);
            assert!(drawn(&near, 2) == drawn(&bench(), 2), "not yet");
            assert!(drawn(&near, 5) == drawn(&far, 5) && drawn(&near, 5) != drawn(&near, 4), "on its way");
            assert!(drawn(&near, 9) == drawn(&near, 5) && drawn(&far, 9) != drawn(&near, 9), "at its end");
        }
    }

    /// Containers stand on the floor; where their own floor is cut through, none of the floor below may be seen.
    #[test]
    fn the_cut_through_a_container_that_stands_on_the_floor_is_whole() {
        let wall_m = 0.004;
        for mesh in [Mesh::open_cylinder(0.03, 0.02, wall_m), Mesh::open_box([0.06, 0.06, 0.02], wall_m)] {
            let mesh = mesh.moved(&nalgebra::Isometry3::translation(0.05, 0.05, wall_m));
            let container = Container { name: "target".to_owned(), role: Role::Target, mesh };
            let bench = Bench { containers: vec![container], ..empty_bench() };
            for (azimuth_deg, elevation_deg) in [(0.0, 20.0), (22.0, 24.0), (-35.0, 50.0)] {
                let containers = Containers::CutOpen;
                let look = Look { width_px: 960, height_px: 720, containers, ..bare(Colouring::Destination) };
                let camera = Camera { azimuth_deg, elevation_deg, ..Camera::default() };
                let painter = Painter::new(&bench, &camera, &look).expect("settings in range");
                let image = draw(&painter, &[], &[]);
                // The section through the container's floor, but for its rim.
                for (step, level) in (1..60).flat_map(|step| [0.3, 0.5, 0.7].map(|level| (step, level))) {
                    let at = V::new(0.02 + 0.001 * step as f32, 0.05, level * wall_m as f32);
                    let [x, y, _] = painter.view.pixel(&painter.view.local(&at)).expect("before the camera");
                    let pixel = (y as usize / FINE) * image.width_px + x as usize / FINE;
                    let [red, green, _] = image.rgb.as_chunks::<3>().0[pixel];
                    assert!(green > red.saturating_add(20), "{red} {green} at {at}, azimuth {azimuth_deg}");
                }
            }
        }
    }

    /// The arm hides what is behind it, stands on its table, and is another one when the joints are.
    #[test]
    fn the_arm_is_drawn_where_its_capsules_are() {
        let arm = sample::arm();
        let with = Bench { arm: Some(arm.clone()), ..empty_bench() }.framed_with_arm();
        let without = Bench { arm: None, ..with.clone() };
        let look = bare(Colouring::Plain(RED));
        let camera = Camera { azimuth_deg: with.front_deg() + 22.0, ..Camera::default() };
        let draw = |bench: &Bench, time_s: f64| {
            let painter = Painter::new(bench, &camera, &look).expect("settings in range");
            let image = painter.draw(&Frame { time_s, ..frame(0, &[]) }, &[]);
            (painter, image)
        };
        let (painter, image) = draw(&with, 0.0);
        let (_, empty) = draw(&without, 0.0);
        let [upper_arm, forearm, ..] = arm.moving(0.0);
        for Capsule { ends_m: [from, to], .. } in [upper_arm, forearm] {
            let middle = V::from([0, 1, 2].map(|axis| (0.5 * (from[axis] + to[axis])) as f32));
            let [x, y, _] = painter.view.pixel(&painter.view.local(&middle)).expect("before the camera");
            let pixel = (y as usize / FINE) * image.width_px + x as usize / FINE;
            let [found, floor] = [&image, &empty].map(|image| image.rgb.as_chunks::<3>().0[pixel]);
            assert!(found != floor, "{found:?} at {x}, {y}");
        }
        assert!(image != draw(&with, 0.2).1, "it moves");
        // The table is lower than the bench's floor: what is seen of it is farther away.
        let corner = painter.view.size_px[0] * (painter.view.size_px[1] - 1);
        let moment = Moment::from(&frame(0, &[]));
        let depth_m =
            |painter: &Painter| painter.surfaces(&moment, [&[], &[]], &[], &[]).texels[corner].depth_m;
        let (bare_painter, _) = draw(&without, 0.0);
        assert!(depth_m(&painter) > depth_m(&bare_painter) + 0.05);
    }

    #[test]
    fn axes_are_drawn_over_everything() {
        let drawn = |arm: Option<Arm>| {
            let bench = Bench { arm, ..empty_bench() }.framed_with_arm();
            let look = Look { axes: true, ..bare(Colouring::Plain([200; 3])) };
            draw(&painter(&bench, &look), &[], &[])
        };
        let (tool, both) = (drawn(None), drawn(Some(sample::arm())));
        for (image, least) in [(&tool, 20), (&both, 10)] {
            assert!((0..3).all(|channel| count(image, channel) > least), "red, green and blue");
        }
    }

    #[test]
    fn particles_without_a_place_are_left_out() {
        let painter = painter(&empty_bench(), &look());
        let at = [0.05; 3];
        let expected = draw(&painter, &[at], &[]);
        for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, 1e30] {
            let image = draw(&painter, &[at, [odd, 0.05, 0.05], [0.05, odd, odd], [0.05, 0.05, odd]], &[]);
            assert!(image == expected, "{odd}");
        }
    }

    #[test]
    fn a_tool_or_speed_that_cannot_be_said_is_no_reason_to_stop() {
        let look = Look { colouring: Colouring::Speed { max_m_s: 1.0 }, ..look() };
        let painter = painter(&bench(), &look);
        let at = [[0.05; 3]];
        let with_tool = draw(&painter, &at, &[]);
        let mut odd = frame(0, &at);
        odd.velocities_m_s = &[[f32::NAN; 3]];
        assert!(painter.draw(&odd, &[]) == with_tool, "a speed that is none is shown as rest");
        odd.tool.position_m.x = f64::NAN;
        assert!(painter.draw(&odd, &[]) != with_tool, "the tool is nowhere");
    }

    #[test]
    fn the_smallest_and_the_narrowest_pictures_say_what_colours_mean() {
        let scale = (Colouring::Height { max_m: 0.1 }, height_colour(0.0));
        let key = (Colouring::Destination, destination_colour(Destination::InFlight));
        for (width_px, height_px) in [(16, 16), (16, 1300), (1300, 16)] {
            for (colouring, colour) in [scale, key] {
                let has_colour = |labels| {
                    let look = Look { width_px, height_px, colouring, labels, ..look() };
                    let image = draw(&painter(&bench(), &look), &[], &[]);
                    image.rgb.as_chunks::<3>().0.contains(&colour)
                };
                assert!(has_colour(true) && !has_colour(false), "{width_px} x {height_px}: {colouring:?}");
            }
        }
    }

    #[test]
    fn settings_out_of_range_are_refused_with_one_sentence() {
        let (camera, look) = (Camera::default(), look());
        let settings = [
            (camera, Look { width_px: 15, ..look.clone() }, "15 x 72 pixels: "),
            (camera, Look { height_px: 8193, ..look.clone() }, "96 x 8193 pixels: "),
            (camera, Look { grains: 0, ..look.clone() }, "0 grains"),
            (camera, Look { grains: 65, ..look.clone() }, "65 grains"),
            (camera, Look { colouring: Colouring::Speed { max_m_s: 0.0 }, ..look.clone() }, "Speed"),
            (camera, Look { colouring: Colouring::Height { max_m: f64::NAN }, ..look.clone() }, "Height"),
            (Camera { zoom: 0.0, ..camera }, look.clone(), "zoom"),
            (Camera { elevation_deg: 91.0, ..camera }, look.clone(), "elevation"),
            (Camera { azimuth_deg: f64::INFINITY, ..camera }, look.clone(), "azimuth"),
            (Camera { field_of_view_deg: 180.0, ..camera }, look.clone(), "field of view"),
        ];
        for (camera, look, says) in settings {
            refused(Painter::new(&bench(), &camera, &look).map(drop), says);
        }
        let flat = Bench { extent: Extent { low_m: [0.0; 3], high_m: [0.1, 0.0, 0.1] }, ..bench() };
        refused(Painter::new(&flat, &camera, &look).map(drop), "larger than zero");
    }

    fn refused(result: Result<(), ViewError>, says: &str) {
        let error = result.expect_err(says);
        assert!(matches!(error, ViewError::Setting { .. }), "{error:?}");
        let sentence = error.to_string();
        assert!(
            sentence.contains(says) && !sentence.contains('\n') && !sentence.contains(". "),
            "{sentence}"
        );
    }
}
