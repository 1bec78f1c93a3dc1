//! Motions of powder and tool as pictures, as a page with a 3-D replay, and as files for robots and other programs.
//!
//! The simulator hands over a [`Bench`] once, then a [`Frame`] after another, to a [`Sink`]. It knows nothing of what
//! becomes of them, and this package nothing of where they come from.
//!
//! World frame: z up, floor at z = 0, the simulated volume is `[0, size_m]`. Lengths in metres, times in seconds.

pub mod arm;
pub mod export;
pub mod extent;
pub mod mesh;
pub mod motion;
pub mod page;
pub mod picture;
pub mod whole;

use nalgebra::Isometry3;
use powderline_shared::pose::Pose;
pub use powderline_simulator::rollout::Destination;

use arm::Arm;
use extent::Extent;
use mesh::Mesh;

/// What stands still, what the tool looks like, and how many frames are to come.
#[derive(Clone, Debug)]
pub struct Bench {
    /// Name of the scene.
    pub name: String,
    /// The simulated volume.
    pub size_m: [f64; 3],
    /// What a picture has to show: the volume may be much larger than what happens in it.
    pub extent: Extent,
    /// Edge of a grid cell; particles lie a half or a third of it apart.
    pub cell_m: f64,
    /// Containers, world frame.
    pub containers: Vec<Container>,
    /// Walls that are there until they open.
    pub gates: Vec<Gate>,
    /// The tool in its own frame: origin at the middle of its opening, +z out of it, +x the direction in which it pours.
    pub tool: Mesh,
    /// The arm that moves the tool, where it is to be seen.
    pub arm: Option<Arm>,
    /// The point that the loss draws the powder to.
    pub target_m: [f64; 3],
    /// How many particles there are.
    pub particles: usize,
    /// From one frame to the next.
    pub period_s: f64,
    /// How many frames there will be.
    pub frames: usize,
}

impl Bench {
    /// The same, of which pictures show containers, gates where they are shut, and the tool at these poses.
    #[must_use]
    pub fn framed(mut self, tool: &[Pose]) -> Self {
        let standing = self.containers.iter().map(|it| &it.mesh).chain(self.gates.iter().map(|it| &it.mesh));
        let about = standing.filter_map(|mesh| Extent::about(mesh.points_m.iter().copied()));
        let all = about.chain(Extent::swept(&self.tool, tool)).reduce(|all, one| all.and(&one));
        self.extent = all.unwrap_or(self.extent);
        self
    }

    /// The same, of which pictures show all of the arm, wherever it goes, besides what they show anyway.
    #[must_use]
    pub fn framed_with_arm(mut self) -> Self {
        self.extent = self.arm.iter().fold(self.extent, |extent, arm| extent.and(&arm.extent()));
        self
    }

    /// The side from which it is looked at if nothing else is asked for, as a camera's azimuth counts, degrees: the front, or where
    /// there is an arm, the side opposite to it, for it would be in the way.
    #[must_use]
    pub fn front_deg(&self) -> f64 {
        let middle_m = Extent::of_volume(self.size_m).middle_m();
        self.arm.as_ref().map_or(0.0, |arm| arm.far_side_deg(middle_m))
    }

    /// Height of what everything stands on: the table beneath the arm, or the bench's own floor.
    #[must_use]
    pub fn ground_m(&self) -> f64 {
        self.arm.as_ref().map_or(0.0, |arm| arm.table_m.min(0.0))
    }

    /// The block between table and floor, as wide as the simulated volume; none where the bench stands on the table itself.
    #[must_use]
    pub fn stand(&self) -> Option<Mesh> {
        let ([x, y, _], low_m) = (self.size_m, self.ground_m());
        (low_m < 0.0).then(|| Mesh::block([0.0, 0.0, low_m], [x, y, 0.0]))
    }
}

/// A container.
#[derive(Clone, Debug)]
pub struct Container {
    /// Its name.
    pub name: String,
    /// What the powder is to do with it.
    pub role: Role,
    /// World frame.
    pub mesh: Mesh,
}

/// A gate.
#[derive(Clone, Debug)]
pub struct Gate {
    /// Its name, and where it is when.
    pub law: powderline_simulator::scene::Gate,
    /// Where it is shut, world frame.
    pub mesh: Mesh,
}

impl Gate {
    /// Where it is at a time after the motion's start, if it is there.
    #[must_use]
    pub fn at(&self, time_s: f64) -> Option<Mesh> {
        let [x, y, z] = self.law.displacement_m(time_s)?;
        Some(self.mesh.clone().moved(&Isometry3::translation(x, y, z)))
    }
}

/// What a container is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// The powder is there at first.
    Source,
    /// The powder should come there.
    Target,
    /// Neither.
    Bystander,
}

/// One moment.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// 0 first.
    pub index: usize,
    /// Since the motion began.
    pub time_s: f64,
    /// The tool as it was.
    pub tool: Pose,
    /// The tool as planned, where that is something else.
    pub planned: Option<Pose>,
    /// Particles, each always at the same index, metres.
    pub positions_m: &'a [[f32; 3]],
    /// Their velocities, m/s.
    pub velocities_m_s: &'a [[f32; 3]],
}

/// What takes frames: a picture, a page, a series of files.
pub trait Sink {
    /// The next frame.
    ///
    /// # Errors
    /// What became of writing.
    fn frame(&mut self, frame: &Frame<'_>) -> Result<(), ViewError>;

    /// There are no more; and where the particles have got to, in order.
    ///
    /// # Errors
    /// What became of writing.
    fn finish(&mut self, destinations: &[Destination]) -> Result<(), ViewError>;
}

/// Why there is no picture, no page, no file.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// A file could not be written.
    #[error("{} cannot be written: {source}", path.display())]
    File {
        /// The file.
        path: std::path::PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A file is there already that would have been overwritten.
    #[error("{}: exists already; name a directory that holds no series yet, or remove this one", path.display())]
    Exists {
        /// The file.
        path: std::path::PathBuf,
    },
    /// What was asked for cannot be drawn or written.
    #[error("{what}: {wanted}")]
    Setting {
        /// What was asked for.
        what: String,
        /// What would be right.
        wanted: &'static str,
    },
    /// The one who was told of the progress of an animation wanted no more. None of its files is left.
    #[error("stopped; the animation was not written")]
    Stopped,
}
