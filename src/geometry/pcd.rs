//! The PCD format (Point Cloud Library), ascii and binary.

use super::Measured;
use super::formats::{FormatError, line_error, measured};

/// Reads `x y z`, and `normal_x normal_y normal_z` if there; other fields are skipped.
///
/// Binary content is little-endian. Points with a coordinate that is not finite are dropped and counted.
///
/// # Errors
/// A header line that is not allowed, fields without `x y z`, compressed content (not supported), or content shorter
/// than declared.
pub fn read_pcd(bytes: &[u8]) -> Result<Measured, FormatError> {
    let header = Header::parse(bytes)?;
    let find = |name: &str| header.fields.iter().position(|field| field.name == name);
    let (Some(x), Some(y), Some(z)) = (find("x"), find("y"), find("z")) else {
        return line_error(header.line_count, "FIELDS must contain x, y and z");
    };
    let normal = find("normal_x").zip(find("normal_y")).zip(find("normal_z"));
    let mut columns = vec![x, y, z];
    if let Some(((nx, ny), nz)) = normal {
        columns.extend([nx, ny, nz]);
    }
    let rows = if header.binary {
        read_binary(bytes, &header, &columns)?
    } else {
        read_ascii(bytes, &header, &columns)?
    };
    let points = rows.iter().map(|row| [row[0], row[1], row[2]]).collect();
    let normals = normal.map(|_| rows.iter().map(|row| [row[3], row[4], row[5]]).collect());
    Ok(measured(points, normals))
}

#[derive(Clone)]
struct Field {
    name: String,
    size: usize,
    kind: char,
    count: usize,
}

struct Header {
    fields: Vec<Field>,
    point_count: usize,
    binary: bool,
    length: usize,
    line_count: usize,
}

impl Header {
    fn parse(bytes: &[u8]) -> Result<Self, FormatError> {
        let mut fields: Vec<Field> = Vec::new();
        let (mut width, mut height, mut points) = (None, None, None);
        let mut position = 0;
        for line_number in 1..=HEADER_LINE_MAX_COUNT {
            let Some(length) = bytes[position..].iter().position(|&byte| byte == b'\n') else {
                return line_error(line_number, "the header has no DATA line");
            };
            let Ok(line) = std::str::from_utf8(&bytes[position..position + length]) else {
                return line_error(line_number, "the header is not text");
            };
            position += length + 1;
            let words: Vec<&str> = line.split_whitespace().collect();
            let Some((&key, values)) = words.split_first() else {
                continue;
            };
            let count = |word: &str| match word.parse::<usize>() {
                Ok(count) => Ok(count),
                Err(_) => line_error(line_number, format!("`{word}` is not a count")),
            };
            match key {
                "VERSION" | "VIEWPOINT" => {}
                _ if key.starts_with('#') => {}
                "FIELDS" | "COLUMNS" => {
                    fields = values
                        .iter()
                        .map(|name| Field {
                            name: (*name).to_owned(),
                            size: 4,
                            kind: 'F',
                            count: 1,
                        })
                        .collect();
                }
                "SIZE" | "TYPE" | "COUNT" if values.len() != fields.len() => {
                    return line_error(
                        line_number,
                        format!("{key} has {} entries for {} fields", values.len(), fields.len()),
                    );
                }
                "SIZE" => {
                    for (field, word) in fields.iter_mut().zip(values) {
                        field.size = count(word)?;
                    }
                }
                "TYPE" => {
                    for (field, word) in fields.iter_mut().zip(values) {
                        field.kind = word.chars().next().unwrap_or('?');
                    }
                }
                "COUNT" => {
                    for (field, word) in fields.iter_mut().zip(values) {
                        field.count = count(word)?;
                    }
                }
                "WIDTH" => width = Some(count(values.first().unwrap_or(&""))?),
                "HEIGHT" => height = Some(count(values.first().unwrap_or(&""))?),
                "POINTS" => points = Some(count(values.first().unwrap_or(&""))?),
                "DATA" => {
                    let binary = match values {
                        ["ascii"] => false,
                        ["binary"] => true,
                        ["binary_compressed"] => {
                            return line_error(
                                line_number,
                                "DATA binary_compressed is not supported; allowed are ascii and binary",
                            );
                        }
                        _ => return line_error(line_number, "DATA must be ascii or binary"),
                    };
                    let grid = width.zip(height).map(|(w, h): (usize, usize)| w.saturating_mul(h));
                    let Some(point_count) = points.or(grid) else {
                        return line_error(line_number, "neither POINTS nor WIDTH and HEIGHT are given");
                    };
                    let known = |f: &Field| matches!((f.kind, f.size), ('F', 4 | 8) | ('I' | 'U', 1 | 2 | 4 | 8));
                    if let Some(field) = fields.iter().find(|field| !known(field)) {
                        return line_error(
                            line_number,
                            format!(
                                "field {} is {}{}; allowed are F4 F8 I1 I2 I4 I8 U1 U2 U4 U8",
                                field.name, field.kind, field.size
                            ),
                        );
                    }
                    return Ok(Self {
                        fields,
                        point_count,
                        binary,
                        length: position,
                        line_count: line_number,
                    });
                }
                _ => return line_error(line_number, format!("`{key}` is not a header entry")),
            }
        }
        line_error(HEADER_LINE_MAX_COUNT, "the header is too long")
    }
}

const HEADER_LINE_MAX_COUNT: usize = 1000;

fn read_binary(bytes: &[u8], header: &Header, columns: &[usize]) -> Result<Vec<[f64; 6]>, FormatError> {
    let mut offsets = Vec::with_capacity(header.fields.len());
    let mut stride = 0usize;
    for field in &header.fields {
        offsets.push(stride);
        stride = stride.saturating_add(field.size.saturating_mul(field.count));
    }
    let body = &bytes[header.length..];
    let there = body.len() / stride.max(1);
    if there < header.point_count {
        return Err(FormatError::Byte {
            offset: bytes.len(),
            problem: format!("ends within point {there} of {}", header.point_count),
        });
    }
    if let Some(&column) = columns.iter().find(|&&column| header.fields[column].count != 1) {
        let name = &header.fields[column].name;
        return line_error(header.line_count, format!("field {name} must have COUNT 1"));
    }
    Ok(body
        .chunks_exact(stride.max(1))
        .take(header.point_count)
        .map(|row| {
            let mut values = [0.0; 6];
            for (value, &column) in values.iter_mut().zip(columns) {
                *value = header.fields[column].value(&row[offsets[column]..]);
            }
            values
        })
        .collect())
}

impl Field {
    /// The value of the first bytes of `bytes`; the caller has checked that they are there.
    fn value(&self, bytes: &[u8]) -> f64 {
        let mut raw = [0u8; 8];
        raw[..self.size].copy_from_slice(&bytes[..self.size]);
        let unsigned = u64::from_le_bytes(raw);
        let unused_bits = 64 - 8 * self.size as u32;
        match (self.kind, self.size) {
            ('F', 4) => f64::from(f32::from_bits(unsigned as u32)),
            ('F', _) => f64::from_bits(unsigned),
            ('I', _) => ((unsigned << unused_bits) as i64 >> unused_bits) as f64,
            _ => unsigned as f64,
        }
    }
}

fn read_ascii(bytes: &[u8], header: &Header, columns: &[usize]) -> Result<Vec<[f64; 6]>, FormatError> {
    let mut starts = Vec::with_capacity(header.fields.len());
    let mut word_count = 0usize;
    for field in &header.fields {
        starts.push(word_count);
        word_count = word_count.saturating_add(field.count);
    }
    let mut rows = Vec::new();
    let lines = bytes[header.length..].split(|&byte| byte == b'\n').enumerate();
    for (index, line) in lines {
        if rows.len() == header.point_count {
            break;
        }
        let number = header.line_count + 1 + index;
        let Ok(line) = std::str::from_utf8(line) else {
            return line_error(number, "is not text");
        };
        let words: Vec<&str> = line.split_whitespace().collect();
        if words.is_empty() {
            continue;
        }
        if words.len() < word_count {
            return line_error(
                number,
                format!("has {} numbers, {word_count} are declared", words.len()),
            );
        }
        let mut values = [0.0; 6];
        for (value, &column) in values.iter_mut().zip(columns) {
            let word = words[starts[column]];
            match word.parse() {
                Ok(parsed) => *value = parsed,
                Err(_) => return line_error(number, format!("`{word}` is not a number")),
            }
        }
        rows.push(values);
    }
    if rows.len() < header.point_count {
        return line_error(
            header.line_count,
            format!("{} points are declared, {} are there", header.point_count, rows.len()),
        );
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};

    #[test]
    fn ascii_with_normals_and_holes_is_read() {
        let text = b"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z rgb normal_x normal_y normal_z\nSIZE 4 4 4 4 4 4 4\n\
            TYPE F F F U F F F\nCOUNT 1 1 1 1 1 1 1\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n\
            1 2 3 77 0 0 2\nnan nan nan 0 nan nan nan\n";
        let read = read_pcd(text).unwrap();
        assert_eq!(read.cloud.points(), [Point3::new(1.0, 2.0, 3.0)]);
        assert_eq!(read.cloud.normals().unwrap(), [Vector3::z()]);
        assert_eq!(read.dropped_count, 1);
    }

    #[test]
    fn binary_with_mixed_fields_is_read() {
        let mut bytes = b"FIELDS i x y z\nSIZE 2 4 8 1\nTYPE I F F I\nCOUNT 2 1 1 1\nPOINTS 1\nDATA binary\n".to_vec();
        bytes.extend([9, 9, 9, 9]);
        bytes.extend(1.5f32.to_le_bytes());
        bytes.extend(2.5f64.to_le_bytes());
        bytes.push(0xfd);
        assert_eq!(read_pcd(&bytes).unwrap().cloud.points(), [Point3::new(1.5, 2.5, -3.0)]);
        bytes.pop();
        assert!(
            read_pcd(&bytes)
                .unwrap_err()
                .to_string()
                .contains("ends within point 0 of 1")
        );
    }

    #[test]
    fn broken_headers_are_refused_with_the_line() {
        for (text, part) in [
            ("", "line 1"),
            ("FIELDS x y z\nSIZE 4 4\n", "line 2: SIZE has 2"),
            ("FIELDS x y z\nDATA ascii\n", "POINTS"),
            ("FIELDS x y\nPOINTS 0\nDATA ascii\n", "x, y and z"),
            ("FIELDS x y z\nPOINTS 1\nDATA binary_compressed\n", "not supported"),
            ("FIELDS x y z\nSIZE 3 4 4\nPOINTS 1\nDATA binary\n", "F3"),
            (
                "FIELDS x y z\nPOINTS 18446744073709551615\nDATA binary\n",
                "ends within",
            ),
            (
                "FIELDS x y z\nPOINTS 2\nDATA ascii\n1 2 3\n",
                "2 points are declared, 1",
            ),
            ("FIELDS x y z\nPOINTS 1\nDATA ascii\n1 2\n", "line 4"),
            ("HELLO\n", "line 1: `HELLO`"),
        ] {
            let error = read_pcd(text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(part), "{text:?}: {error}");
        }
    }
}
