//! Which cloud format bytes are in, and what can be wrong with them.

use super::{Measured, pcd, ply, xyz};

/// Why bytes are not a cloud.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FormatError {
    /// The name's ending is not one of ours and the content does not tell either.
    #[error("`{name}`: not a cloud format; allowed are .ply (ascii, binary), .pcd (ascii, binary), .xyz and .txt")]
    UnknownFormat {
        /// The file name given.
        name: String,
    },
    /// A line of a header or of text says something that is not allowed.
    #[error("line {line}: {problem}")]
    Line {
        /// Counted from 1.
        line: usize,
        /// What is wrong and what is allowed.
        problem: String,
    },
    /// Binary content ends too early or is of the wrong kind.
    #[error("byte {offset}: {problem}")]
    Byte {
        /// Counted from 0.
        offset: usize,
        /// What is wrong and what is allowed.
        problem: String,
    },
}

/// Reads a cloud from the bytes of a file; points that are not finite are dropped and counted.
///
/// The first bytes decide between PLY and PCD, the ending of `file_name_hint` (case does not matter) decides for text.
///
/// # Errors
/// When the format is not known or the bytes break its rules; the error names the line or byte.
pub fn read_cloud(file_name_hint: &str, bytes: &[u8]) -> Result<Measured, FormatError> {
    let ending = file_name_hint
        .rsplit('.')
        .next()
        .unwrap_or_default()
        .to_ascii_lowercase();
    if bytes.starts_with(b"ply") {
        return ply::read_ply(bytes);
    }
    match ending.as_str() {
        "ply" => ply::read_ply(bytes),
        "pcd" => pcd::read_pcd(bytes),
        "xyz" | "txt" | "asc" | "csv" => xyz::read_xyz(bytes),
        _ if bytes.starts_with(b"# .PCD") || bytes.starts_with(b"VERSION") => pcd::read_pcd(bytes),
        _ => Err(FormatError::UnknownFormat {
            name: file_name_hint.to_owned(),
        }),
    }
}

pub(super) fn line_error<T>(line: usize, problem: impl Into<String>) -> Result<T, FormatError> {
    Err(FormatError::Line {
        line,
        problem: problem.into(),
    })
}

/// Builds the cloud from rows of `[x y z]` and, if all of them have one, `[nx ny nz]`.
///
/// A point is dropped and counted if a coordinate is not finite. Normals are kept only if every kept point has one that
/// is finite and not zero.
pub(super) fn measured(points: Vec<[f64; 3]>, normals: Option<Vec<[f64; 3]>>) -> Measured {
    let finite: Vec<bool> = points
        .iter()
        .map(|point| point.iter().all(|value| value.is_finite()))
        .collect();
    let mut measured = super::PointCloud::from_measured(points.into_iter().map(nalgebra::Point3::from));
    if let Some(normals) = normals {
        let kept = normals
            .into_iter()
            .zip(&finite)
            .filter(|&(_, &finite)| finite)
            .map(|(normal, _)| nalgebra::Vector3::from(normal))
            .collect();
        if let Some(cloud) = measured.cloud.clone().with_normals(kept) {
            measured.cloud = cloud;
        }
    }
    measured
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_format_is_told_by_content_and_name() {
        assert_eq!(read_cloud("a.XYZ", b"1 2 3\n").unwrap().cloud.len(), 1);
        let ply = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n";
        assert_eq!(read_cloud("whatever", ply).unwrap().cloud.len(), 1);
        let error = read_cloud("a.stl", b"solid").unwrap_err();
        assert!(error.to_string().contains(".ply"), "{error}");
        assert!(read_cloud("a.ply", b"").is_err());
    }
}
