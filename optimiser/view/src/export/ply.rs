//! The Polygon File Format, binary, little-endian.

use std::io::{self, Write};

use super::particles;
use crate::Frame;
use crate::mesh::Mesh;

/// The particles of a frame.
pub(super) fn powder(file: &mut dyn Write, frame: &Frame<'_>) -> io::Result<()> {
    header(file, Some(frame.time_s), frame.positions_m.len(), &["x", "y", "z", "vx", "vy", "vz", "speed"])?;
    file.write_all(b"end_header\n")?;
    for (position, velocity, speed) in particles(frame) {
        for value in position.into_iter().chain(velocity).chain([speed]) {
            file.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
}

/// Triangles.
pub(super) fn mesh(file: &mut dyn Write, mesh: &Mesh, time_s: Option<f64>) -> io::Result<()> {
    header(file, time_s, mesh.points_m.len(), &["x", "y", "z"])?;
    writeln!(
        file,
        "element face {}\nproperty list uchar int vertex_indices\nend_header",
        mesh.triangles.len()
    )?;
    for value in mesh.points_m.iter().flatten() {
        file.write_all(&(*value as f32).to_le_bytes())?;
    }
    for triangle in &mesh.triangles {
        file.write_all(&[3])?;
        for corner in triangle {
            file.write_all(&corner.to_le_bytes())?;
        }
    }
    Ok(())
}

fn header(file: &mut dyn Write, time_s: Option<f64>, count: usize, properties: &[&str]) -> io::Result<()> {
    writeln!(file, "ply\nformat binary_little_endian 1.0\ncomment Powderline; metres, seconds, z up")?;
    if let Some(time_s) = time_s {
        writeln!(file, "comment time_s {time_s}")?;
    }
    writeln!(file, "element vertex {count}")?;
    properties.iter().try_for_each(|property| writeln!(file, "property float {property}"))
}
