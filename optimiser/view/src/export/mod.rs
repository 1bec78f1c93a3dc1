//! Series of files for other programs: ParaView (`Vtk`), MeshLab (`Ply`), pandas and the like (`Csv`).
//!
//! Files are written as frames come, so memory holds one frame. Binary numbers are little-endian 32-bit floats, as the
//! frames hold them; numbers in text are the shortest that read back as the same. No file is ever overwritten.
//!
//! ```no_run
//! # use powderline_view::{Bench, Sink, ViewError, export::{Format, Series}};
//! # fn example(bench: &Bench) -> Result<(), ViewError> {
//! let mut series = Series::new(bench, Format::Vtk, "run/vtk", 4)?; // Every fourth frame.
//! // series.frame(&frame)? for every frame, then series.finish(&destinations)?
//! # Ok(())
//! # }
//! ```

mod csv;
mod ply;
mod vtk;

use std::fs::{self, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use nalgebra::Isometry3;
use powderline_shared::pose::Pose;

use crate::mesh::Mesh;
use crate::{Bench, Destination, Frame, Gate, Sink, ViewError};

/// What a series is written for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// XML PolyData, to be opened as `series.pvd` by ParaView: `powder-NNNNN.vtp` with velocity (m/s), speed (m/s) and
    /// particle number at each point, `tool-NNNNN.vtp`, `containers.vtp`, and `gates-NNNNN.vtp` while a gate is there.
    Vtk,
    /// Binary PLY: `powder-NNNNN.ply` with x, y, z (m), vx, vy, vz and speed (m/s), `tool-NNNNN.ply`, `containers.ply`,
    /// and `gates-NNNNN.ply` while a gate is there.
    Ply,
    /// `particles.csv`, a row for each particle and time, and `tool.csv`, a row for each time.
    Csv,
}

/// Writes every k-th frame into a folder, and at the end `destinations.csv`: for each particle `source`, `target`, `rims`,
/// `tool`, `spilled` or `in_flight`.
pub struct Series {
    folder: PathBuf,
    every: usize,
    tool: Mesh,
    gates: Vec<Gate>,
    /// Digits of a frame's number.
    digits: usize,
    writer: Writer,
}

enum Writer {
    Vtk(vtk::Collection),
    Ply,
    Csv(csv::Tables),
}

impl Series {
    /// For a folder of its own, which is made, and holds no series yet, of whatever format. Frames 0, `every`, 2 `every`
    /// and so on are written.
    ///
    /// # Errors
    /// If there is a file already that would be overwritten, if the system refuses, or if `every` is 0.
    pub fn new(
        bench: &Bench,
        format: Format,
        folder: impl Into<PathBuf>,
        every: usize,
    ) -> Result<Self, ViewError> {
        let folder = folder.into();
        if every == 0 {
            return Err(ViewError::Setting {
                what: "every 0th frame".to_owned(),
                wanted: "1 writes all frames, 2 every other one",
            });
        }
        fs::create_dir_all(&folder).map_err(|source| ViewError::File { path: folder.clone(), source })?;
        let destinations = folder.join(DESTINATIONS);
        if destinations.exists() {
            return Err(ViewError::Exists { path: destinations });
        }
        let containers = bench.containers.iter().fold(Mesh::default(), |all, one| all.and(one.mesh.clone()));
        let writer = match format {
            Format::Vtk => Writer::Vtk(vtk::Collection::new(&folder, &containers)?),
            Format::Ply => {
                write(&folder.join("containers.ply"), |file| ply::mesh(file, &containers, None))?;
                Writer::Ply
            }
            Format::Csv => Writer::Csv(csv::Tables::new(&folder)?),
        };
        let digits = bench.frames.saturating_sub(1).max(1).ilog10() as usize + 1;
        let (tool, gates) = (bench.tool.clone(), bench.gates.clone());
        Ok(Self { folder, every, tool, gates, digits: digits.max(4), writer })
    }

    /// The tool where it is.
    fn tool(&self, pose: &Pose) -> Mesh {
        self.tool.clone().moved(&Isometry3::from_parts(pose.position_m.into(), pose.orientation))
    }

    /// The gates that are there, if there are any.
    fn gates(&self, time_s: f64) -> Option<Mesh> {
        self.gates.iter().filter_map(|gate| gate.at(time_s)).reduce(Mesh::and)
    }
}

impl Sink for Series {
    fn frame(&mut self, frame: &Frame<'_>) -> Result<(), ViewError> {
        if !frame.index.is_multiple_of(self.every) {
            return Ok(());
        }
        let (tool, gates) = (self.tool(&frame.tool), self.gates(frame.time_s));
        let bodies = [("tool", Some(&tool)), ("gates", gates.as_ref())];
        let mut bodies = bodies.into_iter().filter_map(|(part, mesh)| Some((part, mesh?)));
        let name = |part: &str, ending: &str| {
            format!("{part}-{:0digits$}.{ending}", frame.index, digits = self.digits)
        };
        match &mut self.writer {
            Writer::Vtk(collection) => {
                let mut parts = vec![("powder", name("powder", "vtp"))];
                write(&self.folder.join(&parts[0].1), |file| vtk::powder(file, frame))?;
                for (part, mesh) in bodies {
                    let name = name(part, "vtp");
                    write(&self.folder.join(&name), |file| vtk::mesh(file, mesh))?;
                    parts.push((part, name));
                }
                collection.add(frame.time_s, parts);
                Ok(())
            }
            Writer::Ply => {
                write(&self.folder.join(name("powder", "ply")), |file| ply::powder(file, frame))?;
                bodies.try_for_each(|(part, mesh)| {
                    write(&self.folder.join(name(part, "ply")), |file| {
                        ply::mesh(file, mesh, Some(frame.time_s))
                    })
                })
            }
            Writer::Csv(tables) => tables.add(frame),
        }
    }

    fn finish(&mut self, destinations: &[Destination]) -> Result<(), ViewError> {
        match &mut self.writer {
            Writer::Vtk(collection) => collection.finish(&self.folder),
            Writer::Ply => Ok(()),
            Writer::Csv(tables) => tables.finish(),
        }?;
        // Last: where it is, all is there.
        write(&self.folder.join(DESTINATIONS), |file| csv::destinations(file, destinations))
    }
}

const DESTINATIONS: &str = "destinations.csv";

/// A file that is being written.
struct Open {
    path: PathBuf,
    file: BufWriter<fs::File>,
}

impl Open {
    /// A file that was not there.
    fn new(path: PathBuf) -> Result<Self, ViewError> {
        match OpenOptions::new().write(true).create_new(true).open(&path) {
            Ok(file) => Ok(Self { path, file: BufWriter::with_capacity(1 << 16, file) }),
            Err(source) if source.kind() == io::ErrorKind::AlreadyExists => Err(ViewError::Exists { path }),
            Err(source) => Err(ViewError::File { path, source }),
        }
    }

    fn write(&mut self, contents: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), ViewError> {
        contents(&mut self.file).map_err(|source| ViewError::File { path: self.path.clone(), source })
    }

    fn finish(&mut self) -> Result<(), ViewError> {
        self.write(|file| file.flush())
    }
}

/// Writes a whole file that was not there.
fn write(path: &Path, contents: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), ViewError> {
    let mut file = Open::new(path.to_path_buf())?;
    file.write(contents)?;
    file.finish()
}

/// Position, velocity and speed of each particle, metres and m/s. A particle without a velocity is at rest.
pub(crate) fn particles<'a>(
    frame: &'a Frame<'_>,
) -> impl Iterator<Item = ([f32; 3], [f32; 3], f32)> + use<'a> {
    frame.positions_m.iter().enumerate().map(|(index, position)| {
        let velocity = frame.velocities_m_s.get(index).copied().unwrap_or_default();
        (*position, velocity, velocity.iter().map(|part| part * part).sum::<f32>().sqrt())
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::picture::sample::{bench, frame, positions};

    const FORMATS: [Format; 3] = [Format::Vtk, Format::Ply, Format::Csv];
    const DESTINATIONS_OF_ALL: [Destination; 3] =
        [Destination::InFlight, Destination::Source, Destination::Rims];

    /// Six frames, of which every k-th is written.
    fn play(format: Format, folder: &Path, every: usize) -> Result<(), ViewError> {
        let mut series = Series::new(&bench(), format, folder, every)?;
        for index in 0..6 {
            series.frame(&frame(index, &positions(index)))?;
        }
        series.finish(&DESTINATIONS_OF_ALL)
    }

    fn names(folder: &Path) -> BTreeSet<String> {
        let entries = fs::read_dir(folder).expect("the folder");
        entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect()
    }

    /// Contents of all files, in the order of their names.
    fn contents(folder: &Path) -> Vec<Vec<u8>> {
        names(folder).iter().map(|name| fs::read(folder.join(name)).expect("a file")).collect()
    }

    #[test]
    fn every_kth_frame_is_written() {
        let folder = tempfile::tempdir().expect("a folder");
        for (format, ending, others) in [
            (Format::Vtk, "vtp", &["containers.vtp", "series.pvd"][..]),
            (Format::Ply, "ply", &["containers.ply"][..]),
        ] {
            let folder = folder.path().join(ending);
            play(format, &folder, 2).expect("a series");
            // After three of the frames the gate is gone.
            let parts = [("powder", &[0, 2, 4][..]), ("tool", &[0, 2, 4]), ("gates", &[0, 2])].into_iter();
            let frames = parts
                .flat_map(|(part, of)| of.iter().map(move |index| format!("{part}-{index:04}.{ending}")));
            let others = others.iter().chain(&["destinations.csv"]).map(|name| (*name).to_owned());
            assert_eq!(names(&folder), frames.chain(others).collect());
        }
        let series = fs::read_to_string(folder.path().join("vtp/series.pvd")).expect("the series");
        let times: BTreeSet<&str> = series.split("timestep=\"").skip(1).map(|rest| &rest[..3]).collect();
        assert_eq!(times, BTreeSet::from(["0\" ", "0.5", "1\" "]));
        assert_eq!(series.matches(r#"name="gates""#).count(), 2);
    }

    #[test]
    fn a_folder_that_holds_a_series_is_refused_and_left_as_it_is() {
        for format in FORMATS {
            let folder = tempfile::tempdir().expect("a folder");
            play(format, folder.path(), 1).expect("a series");
            let before = contents(folder.path());
            let error = play(format, folder.path(), 1).expect_err("a series is there");
            assert!(matches!(error, ViewError::Exists { .. }), "{error:?}");
            assert!(error.to_string().contains("exists already; name a directory"), "{error}");
            assert!(contents(folder.path()) == before, "{format:?}");
            // One that was given up has no destinations.
            fs::remove_file(folder.path().join(DESTINATIONS)).expect("the destinations");
            let before = contents(folder.path());
            let error = play(format, folder.path(), 1).expect_err("part of a series is there");
            assert!(matches!(error, ViewError::Exists { .. }), "{error:?}");
            assert!(contents(folder.path()) == before, "{format:?}");
        }
    }

    #[test]
    fn destinations_have_a_row_for_each_particle() {
        for format in FORMATS {
            let folder = tempfile::tempdir().expect("a folder");
            play(format, folder.path(), 3).expect("a series");
            let table = fs::read_to_string(folder.path().join(DESTINATIONS)).expect("the destinations");
            assert_eq!(table, "particle,destination\n0,in_flight\n1,source\n2,rims\n");
        }
    }

    #[test]
    fn numbers_of_frames_have_as_many_digits_as_the_last_one_needs() {
        let folder = tempfile::tempdir().expect("a folder");
        let long = Bench { frames: 100_001, ..bench() };
        let mut series = Series::new(&long, Format::Ply, folder.path(), 1).expect("a series");
        series.frame(&frame(7, &positions(7))).expect("a frame");
        assert!(names(folder.path()).contains("powder-000007.ply"));
    }

    #[test]
    fn every_0th_frame_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let error = play(Format::Csv, &folder.path().join("new"), 0).expect_err("no frame");
        assert_eq!(error.to_string(), "every 0th frame: 1 writes all frames, 2 every other one");
        assert!(!folder.path().join("new").exists());
    }

    #[test]
    fn numbers_that_are_none_are_written_as_they_are() {
        for format in FORMATS {
            let folder = tempfile::tempdir().expect("a folder");
            let mut series = Series::new(&bench(), format, folder.path(), 1).expect("a series");
            series.frame(&frame(0, &[[f32::NAN, f32::INFINITY, 0.0]])).expect("a frame");
            series.frame(&frame(1, &[])).expect("a frame without powder");
            series.finish(&[]).expect("a series");
        }
    }
}
