//! VTK's XML PolyData, its arrays appended as raw bytes, and ParaView's collection of files with times.
//!
//! Written here, as the crate for it has had but release candidates for years and brings parsers and compressors, of
//! which nothing is needed: a header and arrays.

use std::io::{self, Write};
use std::path::Path;

use super::particles;
use crate::mesh::Mesh;
use crate::{Frame, ViewError};

/// What a file shows, and its name.
pub(super) type Part = (&'static str, String);

/// `series.pvd`: which files belong to which time.
#[derive(Default)]
pub(super) struct Collection {
    moments: Vec<(f64, Vec<Part>)>,
}

impl Collection {
    pub(super) fn new(folder: &Path, containers: &Mesh) -> Result<Self, ViewError> {
        let series = folder.join(SERIES);
        if series.exists() {
            return Err(ViewError::Exists { path: series });
        }
        super::write(&folder.join(CONTAINERS), |file| mesh(file, containers))?;
        Ok(Self::default())
    }

    pub(super) fn add(&mut self, time_s: f64, parts: Vec<Part>) {
        self.moments.push((time_s, parts));
    }

    pub(super) fn finish(&self, folder: &Path) -> Result<(), ViewError> {
        super::write(&folder.join(SERIES), |file| {
            writeln!(file, r#"<?xml version="1.0"?>"#)?;
            writeln!(file, r#"<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">"#)?;
            writeln!(file, "  <Collection>")?;
            for (time_s, parts) in &self.moments {
                // The containers belong to every time: a part without one would not be shown there.
                let parts = parts.iter().map(|(name, path)| (*name, path.as_str()));
                for (part, (name, path)) in parts.chain([("containers", CONTAINERS)]).enumerate() {
                    writeln!(
                        file,
                        r#"    <DataSet timestep="{time_s}" group="" part="{part}" name="{name}" file="{path}"/>"#
                    )?;
                }
            }
            writeln!(file, "  </Collection>\n</VTKFile>")
        })
    }
}

const SERIES: &str = "series.pvd";
const CONTAINERS: &str = "containers.vtp";

/// The particles of a frame: points, each a cell, with velocity, speed and number.
pub(super) fn powder(file: &mut dyn Write, frame: &Frame<'_>) -> io::Result<()> {
    let count = frame.positions_m.len();
    let [mut points, mut velocities, mut speeds] = [Vec::new(), Vec::new(), Vec::new()];
    for (position, velocity, speed) in particles(frame) {
        points.extend(position.into_iter().flat_map(f32::to_le_bytes));
        velocities.extend(velocity.into_iter().flat_map(f32::to_le_bytes));
        speeds.extend(speed.to_le_bytes());
    }
    let numbers = integers(0..count);
    let mut data = Data::default();
    let points = data.array("Float32", "Points", 3, points);
    let values = [
        data.array("Float32", "velocity", 3, velocities),
        data.array("Float32", "speed", 1, speeds),
        data.array("Int32", "particle", 1, numbers.clone()),
    ];
    let cells = [
        data.array("Int32", "connectivity", 1, numbers),
        data.array("Int32", "offsets", 1, integers(1..count + 1)),
    ];
    let point_data =
        format!(r#"<PointData Vectors="velocity" Scalars="speed">{}</PointData>"#, values.concat());
    let piece = format!("{point_data}<Points>{points}</Points><Verts>{}</Verts>", cells.concat());
    data.write(file, &format!(r#"NumberOfPoints="{count}" NumberOfVerts="{count}""#), &piece)
}

/// Triangles.
pub(super) fn mesh(file: &mut dyn Write, mesh: &Mesh) -> io::Result<()> {
    let (points, triangles) = (mesh.points_m.len(), mesh.triangles.len());
    let mut data = Data::default();
    let values = mesh.points_m.iter().flatten().flat_map(|value| (*value as f32).to_le_bytes()).collect();
    let array = data.array("Float32", "Points", 3, values);
    let cells = [
        data.array(
            "Int32",
            "connectivity",
            1,
            integers(mesh.triangles.iter().flatten().map(|i| *i as usize)),
        ),
        data.array("Int32", "offsets", 1, integers((1..=triangles).map(|triangle| 3 * triangle))),
    ];
    let piece = format!("<Points>{array}</Points><Polys>{}</Polys>", cells.concat());
    data.write(file, &format!(r#"NumberOfPoints="{points}" NumberOfPolys="{triangles}""#), &piece)
}

fn integers(values: impl Iterator<Item = usize>) -> Vec<u8> {
    values.flat_map(|value| (value as i32).to_le_bytes()).collect()
}

/// Arrays, each after its length in bytes.
#[derive(Default)]
struct Data {
    bytes: Vec<u8>,
}

impl Data {
    /// Appends an array; returns the element that refers to it.
    fn array(&mut self, kind: &str, name: &str, components: usize, values: Vec<u8>) -> String {
        let offset = self.bytes.len();
        self.bytes.extend((values.len() as u64).to_le_bytes());
        self.bytes.extend(values);
        format!(
            r#"<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" format="appended" offset="{offset}"/>"#
        )
    }

    fn write(&self, file: &mut dyn Write, counts: &str, piece: &str) -> io::Result<()> {
        let kind = r#"type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64""#;
        writeln!(file, r#"<?xml version="1.0"?>"#)?;
        writeln!(file, "<VTKFile {kind}>\n<PolyData><Piece {counts}>\n{piece}\n</Piece></PolyData>")?;
        write!(file, r#"<AppendedData encoding="raw">_"#)?;
        file.write_all(&self.bytes)?;
        writeln!(file, "</AppendedData>\n</VTKFile>")
    }
}
