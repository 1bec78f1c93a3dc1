//! Tables. No value needs quotes.

use std::io::{self, Write};
use std::path::Path;

use powderline_shared::pose::Pose;

use super::Open;
use crate::{Destination, Frame, ViewError};

/// `particles.csv` and `tool.csv`.
pub(super) struct Tables {
    particles: Open,
    tool: Open,
}

impl Tables {
    pub(super) fn new(folder: &Path) -> Result<Self, ViewError> {
        let mut particles = Open::new(folder.join("particles.csv"))?;
        let mut tool = Open::new(folder.join("tool.csv"))?;
        particles.write(|file| writeln!(file, "time_s,particle,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s"))?;
        tool.write(|file| {
            let pose = |prefix| {
                ["x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"].map(|name| format!(",{prefix}{name}")).concat()
            };
            writeln!(file, "time_s{}{}", pose(""), pose("planned_"))
        })?;
        Ok(Self { particles, tool })
    }

    pub(super) fn add(&mut self, frame: &Frame<'_>) -> Result<(), ViewError> {
        let time_s = frame.time_s;
        self.particles.write(|file| {
            for (particle, ([x, y, z], [vx, vy, vz], _)) in super::particles(frame).enumerate() {
                writeln!(file, "{time_s},{particle},{x},{y},{z},{vx},{vy},{vz}")?;
            }
            Ok(())
        })?;
        self.tool.write(|file| {
            // Where nothing else was planned the cells are empty.
            let planned = frame.planned.as_ref().map_or_else(|| ",".repeat(7), columns);
            writeln!(file, "{time_s}{}{planned}", columns(&frame.tool))
        })
    }

    pub(super) fn finish(&mut self) -> Result<(), ViewError> {
        self.particles.finish()?;
        self.tool.finish()
    }
}

/// Position and quaternion, each after a comma.
fn columns(pose: &Pose) -> String {
    let turn = pose.orientation.quaternion();
    let values = [pose.position_m.x, pose.position_m.y, pose.position_m.z, turn.w, turn.i, turn.j, turn.k];
    values.map(|value| format!(",{value}")).concat()
}

/// Where each particle is when all is over.
pub(super) fn destinations(file: &mut dyn Write, destinations: &[Destination]) -> io::Result<()> {
    writeln!(file, "particle,destination")?;
    for (particle, destination) in destinations.iter().enumerate() {
        let name = match destination {
            Destination::Left => "left",
            Destination::Target => "target",
            Destination::Tool => "tool",
            Destination::Spilled => "spilled",
        };
        writeln!(file, "{particle},{name}")?;
    }
    Ok(())
}
