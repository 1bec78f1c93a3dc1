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
        writeln!(file, "{particle},{}", destination.name())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Sink as _;
    use crate::export::{Format, Series};
    use crate::picture::sample::{bench, frame};

    /// The cells of a table below its names.
    fn rows(path: &Path) -> Vec<Vec<String>> {
        let table = std::fs::read_to_string(path).expect("a table");
        table.lines().skip(1).map(|line| line.split(',').map(str::to_owned).collect()).collect()
    }

    #[test]
    fn numbers_read_back_as_the_same() {
        let folder = tempfile::tempdir().expect("a folder");
        let odd =
            [0.1, -0.0, f32::MIN_POSITIVE, 1e-45, f32::MAX, 16_777_216.0, f32::EPSILON, 1.0 / 3.0, -1e-7];
        let positions_m = [0, 3, 6].map(|first| [odd[first], odd[first + 1], odd[first + 2]]);
        let velocities_m_s = positions_m.map(|[x, y, z]| [z, x, y]);
        let mut written = frame(3, &positions_m);
        written.velocities_m_s = &velocities_m_s;
        written.time_s = 0.1 + 0.2;
        let mut series = Series::new(&bench(), Format::Csv, folder.path(), 3).expect("a series");
        series.frame(&written).expect("a frame");
        series.finish(&[]).expect("a series");
        let rows = rows(&folder.path().join("particles.csv"));
        assert_eq!(rows.len(), 3);
        for (particle, row) in rows.iter().enumerate() {
            assert_eq!(row[0].parse::<f64>().map(f64::to_bits), Ok(written.time_s.to_bits()));
            assert_eq!(row[1], particle.to_string());
            let expected = positions_m[particle].into_iter().chain(velocities_m_s[particle]);
            let bits = row[2..].iter().map(|cell| cell.parse::<f32>().expect("a number").to_bits());
            assert!(bits.eq(expected.map(f32::to_bits)), "{row:?}");
        }
    }

    #[test]
    fn rows_are_written_for_every_kth_frame_with_the_plan_where_there_is_one() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut series = Series::new(&bench(), Format::Csv, folder.path(), 2).expect("a series");
        for index in 0..5 {
            let mut moment = frame(index, &[[0.0; 3]; 2]);
            moment.planned = (index == 2).then_some(moment.tool);
            series.frame(&moment).expect("a frame");
        }
        series.finish(&[]).expect("a series");
        let times = |name| rows(&folder.path().join(name)).into_iter().map(|row| row[0].clone());
        assert!(times("particles.csv").eq(["0", "0", "0.5", "0.5", "1", "1"]));
        assert!(times("tool.csv").eq(["0", "0.5", "1"]));
        for (row, is_planned) in rows(&folder.path().join("tool.csv")).iter().zip([false, true, false]) {
            assert_eq!(row.len(), 15);
            assert_eq!(row[8..].iter().all(|cell| !cell.is_empty()), is_planned);
            assert!(!is_planned || row[8..] == row[1..8]);
        }
    }
}
