//! The mechanics behind the controller: an ideal servo, which is where it is told to be.

use powderline_shared::pose::Pose;

/// An arm that follows without lag.
#[derive(Clone, Copy, Debug)]
pub struct Arm {
    pose: Pose,
}

impl Arm {
    /// Standing at `pose`.
    #[must_use]
    pub fn new(pose: Pose) -> Self {
        Self { pose }
    }

    /// Moves to the commanded pose.
    pub fn follow(&mut self, commanded: Pose) {
        self.pose = commanded;
    }

    /// Where the tool is.
    #[must_use]
    pub fn pose(&self) -> Pose {
        self.pose
    }
}
