//! Text with one point a line: `x y z`, or `x y z nx ny nz`.

use super::Measured;
use super::formats::{FormatError, line_error, measured};

/// Reads lines of three or more numbers separated by blanks, tabs, commas or semicolons.
///
/// Empty lines and lines that begin with `#` or `//` are skipped. If every line has exactly six numbers and the last
/// three are a unit vector (to 1 %), they are normals; further numbers are ignored otherwise. `nan` is allowed and
/// dropped with count.
///
/// # Errors
/// The first line with fewer than three numbers or with something that is no number.
pub fn read_xyz(bytes: &[u8]) -> Result<Measured, FormatError> {
    let mut points = Vec::new();
    let mut normals = Some(Vec::new());
    for (index, line) in bytes.split(|&byte| byte == b'\n').enumerate() {
        let line_number = index + 1;
        let Ok(line) = std::str::from_utf8(line) else {
            return line_error(line_number, "is not text");
        };
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') || line.starts_with("//") {
            continue;
        }
        let mut numbers = [0.0; 6];
        let mut count = 0;
        let words = line.split(|c: char| c.is_whitespace() || c == ',' || c == ';');
        for word in words.filter(|word| !word.is_empty()) {
            if count < 6 {
                let Ok(number) = word.parse::<f64>() else {
                    return line_error(line_number, format!("`{word}` is not a number"));
                };
                numbers[count] = number;
            }
            count += 1;
        }
        if count < 3 {
            return line_error(line_number, format!("has {count} numbers; a point needs x y z"));
        }
        let [x, y, z, nx, ny, nz] = numbers;
        points.push([x, y, z]);
        let length = (nx * nx + ny * ny + nz * nz).sqrt();
        let finite = x.is_finite() && y.is_finite() && z.is_finite();
        if count == 6 && ((length - 1.0).abs() < 0.01 || !finite) {
            if let Some(normals) = &mut normals {
                normals.push([nx, ny, nz]);
            }
        } else {
            normals = None;
        }
    }
    Ok(measured(points, normals))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_normals_comments_and_holes_are_read() {
        let text = b"# a comment\n1 2 3 0 0 1\n\n4,5,6,0,1,0\nnan 0 0 0 0 1\r\n";
        let read = read_xyz(text).unwrap();
        assert_eq!((read.cloud.len(), read.dropped_count), (2, 1));
        assert_eq!(read.cloud.points()[1], nalgebra::Point3::new(4.0, 5.0, 6.0));
        assert_eq!(read.cloud.normals().unwrap()[0], nalgebra::Vector3::z());
        let colours = read_xyz(b"1 2 3 255 0 0\n").unwrap();
        assert!(colours.cloud.normals().is_none());
        assert!(read_xyz(b"").unwrap().cloud.is_empty());
    }

    #[test]
    fn a_broken_line_is_named() {
        assert_eq!(
            read_xyz(b"1 2 3\n1 2\n").unwrap_err().to_string(),
            "line 2: has 2 numbers; a point needs x y z"
        );
        assert!(read_xyz(b"1 2 x\n").unwrap_err().to_string().contains("`x`"));
        assert!(read_xyz(b"1 2 3\n\xff\xfe 1 2").is_err());
    }
}
