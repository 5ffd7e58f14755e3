//! STL files: written as binary, read as binary or ASCII.

use super::Mesh;
use nalgebra::{Point3, Vector3};
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Why an STL file gave no mesh.
#[derive(Debug, thiserror::Error)]
pub enum StlError {
    /// The file cannot be opened, read or parsed.
    #[error("cannot read the STL file {}: {source}", path.display())]
    Unreadable {
        /// Which file.
        path: PathBuf,
        /// What the operating system or the parser said.
        source: io::Error,
    },
    /// The file holds no triangle of positive area.
    #[error("the STL file {} holds no triangle", path.display())]
    Empty {
        /// Which file.
        path: PathBuf,
    },
    /// A corner is NaN or infinite.
    #[error("triangle {triangle_index} of the STL file {} has a coordinate that is not a number", path.display())]
    NotFinite {
        /// Which file.
        path: PathBuf,
        /// Which triangle, from 0, in the file's order.
        triangle_index: usize,
    },
}

/// Reads a mesh from an STL file, coordinates taken as mm; equal corners become one vertex.
///
/// Triangles with two equal corners are left out. Neither closedness nor orientation is checked: a scan of an open
/// surface is a mesh too.
pub fn read(path: &Path) -> Result<Mesh, StlError> {
    let unreadable = |source| StlError::Unreadable {
        path: path.to_owned(),
        source,
    };
    let file = File::open(path).map_err(unreadable)?;
    let welded = stl_io::read_stl(&mut BufReader::new(file)).map_err(unreadable)?;
    let vertices: Vec<_> = welded
        .vertices
        .iter()
        .map(|vertex| Point3::new(f64::from(vertex[0]), f64::from(vertex[1]), f64::from(vertex[2])))
        .collect();
    let mut triangles = Vec::with_capacity(welded.faces.len());
    for (triangle_index, face) in welded.faces.iter().enumerate() {
        let [a, b, c] = face.vertices;
        if [a, b, c]
            .iter()
            .any(|&corner| !vertices[corner].iter().all(|value| value.is_finite()))
        {
            return Err(StlError::NotFinite {
                path: path.to_owned(),
                triangle_index,
            });
        }
        if a != b && b != c && c != a {
            triangles.push([a, b, c].map(super::index));
        }
    }
    if triangles.is_empty() {
        return Err(StlError::Empty { path: path.to_owned() });
    }
    Ok(Mesh { vertices, triangles })
}

/// Writes a binary STL file, coordinates in mm as 32-bit floats, normals from the triangles. An existing file is replaced.
///
/// Layout: 80 bytes of header, the count as little-endian u32, then 50 bytes a triangle.
pub fn write(path: &Path, mesh: &Mesh) -> io::Result<()> {
    let mut out = BufWriter::new(File::create(path)?);
    let mut header = [b' '; 80];
    header[..HEADER.len()].copy_from_slice(HEADER);
    out.write_all(&header)?;
    out.write_all(&super::index(mesh.triangles.len()).to_le_bytes())?;
    for triangle in &mesh.triangles {
        let [a, b, c] = mesh.corners(triangle);
        let normal = (b - a)
            .cross(&(c - a))
            .try_normalize(0.0)
            .unwrap_or_else(Vector3::zeros);
        for vector in [normal, a.coords, b.coords, c.coords] {
            for value in vector.iter() {
                out.write_all(&(*value as f32).to_le_bytes())?;
            }
        }
        out.write_all(&[0, 0])?;
    }
    out.flush()
}

/// Must not begin with `solid`: readers would take the file for ASCII.
const HEADER: &[u8] = b"binary STL, mm, simulated blade";

#[cfg(test)]
mod tests {
    use super::super::Builtin;
    use super::*;

    fn temporary(name: &str) -> PathBuf {
        std::env::temp_dir().join(format!("hw-sim-stl-{}-{name}", std::process::id()))
    }

    #[test]
    fn a_blade_survives_the_round_trip_to_float_precision() {
        let path = temporary("round-trip.stl");
        let mesh = Builtin::HptA.mesh();
        write(&path, &mesh).unwrap();
        let read_back = read(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        assert_eq!(read_back.triangles.len(), mesh.triangles.len());
        assert_eq!(read_back.vertices.len(), mesh.vertices.len());
        for (before, after) in mesh.triangles.iter().zip(&read_back.triangles) {
            for (a, b) in mesh.corners(before).iter().zip(read_back.corners(after)) {
                assert!((a - b).norm() < 1e-5, "{a} {b}");
            }
        }
        assert!((read_back.volume_mm3() / mesh.volume_mm3() - 1.0).abs() < 1e-6);
    }

    #[test]
    fn a_missing_file_is_named_in_the_error() {
        let error = read(Path::new("/nonexistent/blade.stl")).unwrap_err();
        assert!(error.to_string().contains("/nonexistent/blade.stl"), "{error}");
    }

    #[test]
    fn a_cut_file_and_an_empty_one_are_errors() {
        let path = temporary("cut.stl");
        write(&path, &Builtin::HptA.mesh()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..1000]).unwrap();
        assert!(matches!(read(&path), Err(StlError::Unreadable { .. })));
        write(
            &path,
            &Mesh {
                vertices: vec![],
                triangles: vec![],
            },
        )
        .unwrap();
        assert!(matches!(read(&path), Err(StlError::Empty { .. })));
        let corner = Point3::new(f64::NAN, 0.0, 0.0);
        let broken = Mesh {
            vertices: vec![corner, Point3::origin(), Point3::new(1.0, 1.0, 0.0)],
            triangles: vec![[0, 1, 2]],
        };
        write(&path, &broken).unwrap();
        assert!(matches!(
            read(&path),
            Err(StlError::NotFinite { triangle_index: 0, .. })
        ));
        std::fs::remove_file(&path).unwrap();
    }
}
