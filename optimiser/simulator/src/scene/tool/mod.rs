//! The tool: its shape and its handle, and where it stands. One file per shape, each of which answers as a [`Body`].

mod body;
mod bowl;
mod box_scoop;
mod cuboid;
mod cuboids;
mod placed;

use serde::{Deserialize, Serialize};

use super::solid::{Vec3, dot};
use crate::shape::{Capsule, Shape};
use bowl::Bowl;
use box_scoop::BoxScoop;
use cuboids::Cuboids;

pub(super) use body::{Body, Point};
pub use cuboid::{Cuboid, MAX_CUBOIDS};
pub(crate) use placed::PlacedTool;
pub use placed::ToolPart;

/// The tool's own frame: origin at the middle of the opening (rim plane), +z out of the opening, +x the
/// direction in which it scoops and pours (its lip), handle along -x.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tool {
    /// Shape and inner dimensions.
    pub shape: ToolShape,
    /// Thickness of the tool's walls, outside the inner dimensions, metres; half a cell to 1,
    /// typically one cell. Cuboids have sizes of their own: there it only moves the handle's end
    /// into the rear wall.
    pub wall_thickness_m: f64,
    /// Coulomb friction of the tool, dimensionless; 0 to 2, typically 0.4.
    pub friction: f64,
    /// Start position of the tool's origin, metres, world frame. The tool, as its convex hull, must
    /// be clear of the powder there, and `skill.approach_m` above it.
    pub start_position_m: [f64; 3],
    /// Start pitch, degrees: how far the opening is tilted from straight up towards the scooping
    /// direction; -90 to 90, typically 80.
    pub start_pitch_deg: f64,
    /// Rod that joins the tool to the arm.
    pub handle: Handle,
}

/// Inner dimensions of the tool.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum ToolShape {
    /// Hemispherical bowl, below the rim plane.
    Bowl {
        /// Inner radius, metres; one cell to 1, typically 0.016.
        inner_radius_m: f64,
    },
    /// Box scoop, open at +x (front) and +z (top), walls at -x, -y, +y and -z.
    BoxScoop {
        /// Inner length (x), width (y) and height (z), metres; each one cell to 1.
        inner_size_m: [f64; 3],
    },
    /// Any shape that can be put together from cuboids, in the tool's frame: origin where the
    /// opening's middle should be, what holds powder below it (z < 0), lip towards +x. Tool and
    /// powder turn about the origin. Here a plate that leans outwards by 30 degrees:
    ///
    /// ```
    /// # use powderline_simulator::scene::{Cuboid, ToolShape};
    /// let blade = Cuboid {
    ///     centre_m: [0.0, 0.0, -0.005],
    ///     size_m: [0.020, 0.012, 0.002],
    ///     rotation_deg: [0.0; 3],
    /// };
    /// let rim = Cuboid {
    ///     centre_m: [0.0, 0.008, -0.003],
    ///     size_m: [0.020, 0.002, 0.005],
    ///     rotation_deg: [-30.0, 0.0, 0.0],
    /// };
    /// let shape = ToolShape::Cuboids { cuboid: vec![blade, rim] };
    /// ```
    Cuboids {
        /// The cuboids, 1 to [`MAX_CUBOIDS`]; they may overlap.
        cuboid: Vec<Cuboid>,
    },
}

impl ToolShape {
    /// Asks the body of this shape with walls that thick: the one place that tells the shapes apart.
    pub(super) fn with_body<A>(&self, wall_m: f64, ask: impl FnOnce(&dyn Body) -> A) -> A {
        match self {
            Self::Bowl { inner_radius_m } => ask(&Bowl { inner_radius_m: *inner_radius_m, wall_m }),
            Self::BoxScoop { inner_size_m } => ask(&BoxScoop { inner_size_m: *inner_size_m, wall_m }),
            Self::Cuboids { cuboid } => ask(&Cuboids { cuboids: cuboid, wall_m }),
        }
    }
}

/// Straight round rod (capsule) that starts at the tool's rear rim and runs along -x, raised by
/// `rise_deg` towards +z. Behind cuboids it starts at z = 0, as far back as they reach.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Handle {
    /// Length of the capsule's axis, metres; 0.001 to 1, typically 0.04.
    pub length_m: f64,
    /// Radius, metres; a quarter of a cell to 0.1, typically one cell.
    pub radius_m: f64,
    /// Angle between the rod and the tool's -x axis, degrees, positive towards +z; -90 to 90,
    /// typically 85.
    pub rise_deg: f64,
}

impl Tool {
    /// Asks the tool's body.
    pub(super) fn with_body<A>(&self, ask: impl FnOnce(&dyn Body) -> A) -> A {
        self.shape.with_body(self.wall_thickness_m, ask)
    }

    /// Distance from the tool's origin to its lowest point when the opening looks straight up, metres.
    pub fn body_depth_m(&self) -> f64 {
        self.body_support([0.0, 0.0, -1.0])
    }

    /// Ends of the handle's axis in the tool's frame, metres: its round end touches the inside of the rear wall.
    pub fn handle_axis_m(&self) -> [[f64; 3]; 2] {
        let (start, along) = self.handle();
        [start, [0, 1, 2].map(|i| start[i] + along[i])]
    }

    /// Where the handle's axis begins, and from there to its end, tool frame, metres.
    fn handle(&self) -> (Vec3, Vec3) {
        let start =
            self.with_body(|body| body.rear_m()) + (0.5 * self.wall_thickness_m).max(self.handle.radius_m);
        let (rise, length) = (self.handle.rise_deg.to_radians(), self.handle.length_m);
        ([-start, 0.0, 0.0], [-length * libm::cos(rise), 0.0, length * libm::sin(rise)])
    }

    /// What powder meets, tool frame: the body's walls, then the handle.
    pub(crate) fn solids(&self) -> Vec<Shape<f64>> {
        let (from, along) = self.handle();
        let mut solids = self.with_body(|body| body.solids());
        solids.push(Shape::Capsule(Capsule { from, along, radius: self.handle.radius_m }));
        solids
    }

    /// Whether powder at a point of the tool's frame counts as lying on it, with so much room around, metres.
    pub(crate) fn carries(&self, point: Vec3, room_m: f64) -> bool {
        self.with_body(|body| body.carries(point, room_m))
    }

    /// Of a ball around the tool's origin that holds all of it, metres.
    pub(crate) fn bounding_radius_m(&self) -> f64 {
        let body = self.body_radius_m();
        let ends = self.handle_axis_m().map(|end| libm::sqrt(dot(end, end)) + self.handle.radius_m);
        body.max(ends[0]).max(ends[1])
    }

    /// The same of the body alone.
    pub(crate) fn body_radius_m(&self) -> f64 {
        self.with_body(|body| body.bounding_radius_m())
    }

    /// Lowest and highest coordinates of the body, tool frame, metres.
    #[cfg(test)]
    pub(crate) fn body_extent_m(&self) -> [Vec3; 2] {
        self.with_body(|body| body.extent_m())
    }

    /// Reach of the body from the tool's origin, tool frame.
    fn body_support(&self, direction: Vec3) -> f64 {
        self.with_body(|body| body.support(direction))
    }

    /// Reach of the handle from the tool's origin, tool frame.
    fn handle_support(&self, direction: Vec3) -> f64 {
        let [near, far] = self.handle_axis_m();
        dot(near, direction).max(dot(far, direction)) + self.handle.radius_m
    }
}

#[cfg(test)]
mod tests;
