//! The PLY format: ascii and binary of either byte order, with any layout of scalar and list properties.

use super::formats::{FormatError, line_error, measured};
use super::{Measured, PointCloud};

/// Reads the `vertex` element: `x y z`, and `nx ny nz` if there; everything else is skipped.
///
/// Points with a coordinate that is not finite are dropped and counted. Normals are kept only if every kept point has
/// one that is not zero.
///
/// # Errors
/// A header line that is not allowed, a `vertex` element without `x y z`, or content shorter than declared. Nothing is
/// allocated for points that the bytes cannot hold.
pub fn read_ply(bytes: &[u8]) -> Result<Measured, FormatError> {
    let header = Header::parse(bytes)?;
    let Some(vertex_position) = header.elements.iter().position(|element| element.name == "vertex") else {
        return line_error(header.line_count, "there is no `element vertex`");
    };
    let vertex = &header.elements[vertex_position];
    let index = |name: &str| vertex.properties.iter().position(|property| property.name == name);
    let (Some(x), Some(y), Some(z)) = (index("x"), index("y"), index("z")) else {
        return line_error(header.line_count, "`element vertex` needs the properties x, y and z");
    };
    let normals = index("nx").zip(index("ny")).zip(index("nz"));
    let mut columns = vec![x, y, z];
    if let Some(((nx, ny), nz)) = normals {
        columns.extend([nx, ny, nz]);
    }
    if columns.iter().any(|&column| vertex.properties[column].list.is_some()) {
        return line_error(header.line_count, "x, y, z, nx, ny, nz must be scalars, not lists");
    }
    let mut sink = Sink {
        columns,
        points: Vec::new(),
        normals: Vec::new(),
    };
    match header.format {
        Format::Ascii => read_ascii(bytes, &header, vertex_position, &mut sink)?,
        Format::Little => read_binary(bytes, &header, vertex_position, &mut sink, true)?,
        Format::Big => read_binary(bytes, &header, vertex_position, &mut sink, false)?,
    }
    Ok(measured(sink.points, normals.map(|_| sink.normals)))
}

/// Writes a binary little-endian PLY of `float` properties, with normals if the cloud has them.
///
/// Each of `comments` becomes a header comment (line breaks in it become blanks).
pub fn write_ply(cloud: &PointCloud, comments: &[&str]) -> Vec<u8> {
    let mut out = String::from("ply\nformat binary_little_endian 1.0\n");
    for comment in comments {
        let line = comment.replace(['\n', '\r'], " ");
        out.push_str(&format!("comment {line}\n"));
    }
    out.push_str(&format!("element vertex {}\n", cloud.len()));
    let names: &[&str] = if cloud.normals().is_some() {
        &["x", "y", "z", "nx", "ny", "nz"]
    } else {
        &["x", "y", "z"]
    };
    for name in names {
        out.push_str(&format!("property float {name}\n"));
    }
    out.push_str("end_header\n");
    let mut out = out.into_bytes();
    out.reserve(cloud.len() * names.len() * 4);
    for (index, point) in cloud.points().iter().enumerate() {
        for value in point.coords.iter() {
            out.extend((*value as f32).to_le_bytes());
        }
        if let Some(normals) = cloud.normals() {
            for value in normals[index].iter() {
                out.extend((*value as f32).to_le_bytes());
            }
        }
    }
    out
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Format {
    Ascii,
    Little,
    Big,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

struct Property {
    name: String,
    scalar: Scalar,
    /// The type of the length, for a list.
    list: Option<Scalar>,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

struct Header {
    format: Format,
    elements: Vec<Element>,
    /// Where the content begins.
    length: usize,
    line_count: usize,
}

impl Header {
    fn parse(bytes: &[u8]) -> Result<Self, FormatError> {
        let mut format = None;
        let mut elements: Vec<Element> = Vec::new();
        let mut position = 0;
        for line_number in 1..=HEADER_LINE_MAX_COUNT {
            let Some(length) = bytes[position..].iter().position(|&byte| byte == b'\n') else {
                return line_error(line_number, "the header has no `end_header`");
            };
            let Ok(line) = std::str::from_utf8(&bytes[position..position + length]) else {
                return line_error(line_number, "the header is not text");
            };
            position += length + 1;
            let words: Vec<&str> = line.split_whitespace().collect();
            match words.as_slice() {
                ["ply"] if line_number == 1 => {}
                _ if line_number == 1 => return line_error(1, "a PLY file begins with `ply`"),
                ["format", name, _] => format = Some(parse_format(name, line_number)?),
                ["comment" | "obj_info", ..] | [] => {}
                ["element", name, count] => {
                    let Ok(count) = count.parse() else {
                        return line_error(line_number, format!("`{count}` is not a count"));
                    };
                    elements.push(Element {
                        name: (*name).to_owned(),
                        count,
                        properties: Vec::new(),
                    });
                }
                ["property", rest @ ..] => {
                    let property = parse_property(rest, line_number)?;
                    let Some(element) = elements.last_mut() else {
                        return line_error(line_number, "a property before the first element");
                    };
                    element.properties.push(property);
                }
                ["end_header"] => {
                    let Some(format) = format else {
                        return line_error(line_number, "the header has no `format`");
                    };
                    return Ok(Self {
                        format,
                        elements,
                        length: position,
                        line_count: line_number,
                    });
                }
                _ => {
                    return line_error(
                        line_number,
                        format!(
                            "`{}` is not format, comment, element, property or end_header",
                            line.trim()
                        ),
                    );
                }
            }
        }
        line_error(HEADER_LINE_MAX_COUNT, "the header is too long")
    }
}

const HEADER_LINE_MAX_COUNT: usize = 10_000;

fn parse_format(name: &str, line: usize) -> Result<Format, FormatError> {
    match name {
        "ascii" => Ok(Format::Ascii),
        "binary_little_endian" => Ok(Format::Little),
        "binary_big_endian" => Ok(Format::Big),
        _ => line_error(
            line,
            format!("format `{name}`; allowed are ascii, binary_little_endian, binary_big_endian"),
        ),
    }
}

fn parse_property(words: &[&str], line: usize) -> Result<Property, FormatError> {
    match words {
        ["list", length, scalar, name] => Ok(Property {
            name: (*name).to_owned(),
            scalar: parse_scalar(scalar, line)?,
            list: Some(parse_scalar(length, line)?),
        }),
        [scalar, name] => Ok(Property {
            name: (*name).to_owned(),
            scalar: parse_scalar(scalar, line)?,
            list: None,
        }),
        _ => line_error(line, "a property is `TYPE NAME` or `list LENGTH_TYPE TYPE NAME`"),
    }
}

fn parse_scalar(name: &str, line: usize) -> Result<Scalar, FormatError> {
    Ok(match name {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => {
            return line_error(
                line,
                format!(
                    "type `{name}`; allowed are char, uchar, short, ushort, int, uint, float, double and int8 ... float64"
                ),
            );
        }
    })
}

impl Scalar {
    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The value of the first `size` of `bytes`; the caller has checked that they are there.
    fn value(self, bytes: &[u8], little: bool) -> f64 {
        let mut raw = [0; 8];
        let size = self.size();
        for (to, index) in raw.iter_mut().zip(0..size) {
            *to = bytes[if little { index } else { size - 1 - index }];
        }
        let [a, b, c, d, ..] = raw;
        match self {
            Self::I8 => f64::from(a as i8),
            Self::U8 => f64::from(a),
            Self::I16 => f64::from(i16::from_le_bytes([a, b])),
            Self::U16 => f64::from(u16::from_le_bytes([a, b])),
            Self::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Self::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(raw),
        }
    }
}

struct Sink {
    columns: Vec<usize>,
    points: Vec<[f64; 3]>,
    normals: Vec<[f64; 3]>,
}

impl Sink {
    fn take(&mut self, value: impl Fn(usize) -> f64) {
        let at = |i: usize| value(self.columns[i]);
        self.points.push([at(0), at(1), at(2)]);
        if self.columns.len() == 6 {
            self.normals.push([at(3), at(4), at(5)]);
        }
    }
}

fn read_ascii(bytes: &[u8], header: &Header, vertex: usize, sink: &mut Sink) -> Result<(), FormatError> {
    let mut lines = bytes[header.length..]
        .split(|&byte| byte == b'\n')
        .enumerate()
        .map(|(index, line)| (header.line_count + 1 + index, line))
        .filter(|(_, line)| !line.trim_ascii().is_empty());
    for element in &header.elements[..vertex] {
        for _ in 0..element.count {
            if lines.next().is_none() {
                return line_error(
                    header.line_count,
                    format!("fewer lines than `{}` declares", element.name),
                );
            }
        }
    }
    let element = &header.elements[vertex];
    let mut values = vec![0.0; element.properties.len()];
    for row in 0..element.count {
        let Some((number, line)) = lines.next() else {
            return line_error(
                header.line_count,
                format!("{} vertices are declared, {row} are there", element.count),
            );
        };
        let Ok(line) = std::str::from_utf8(line) else {
            return line_error(number, "is not text");
        };
        let mut words = line.split_whitespace();
        let mut next = || match words.next() {
            Some(word) => match word.parse::<f64>() {
                Ok(value) => Ok(value),
                Err(_) => line_error(number, format!("`{word}` is not a number")),
            },
            None => line_error(number, "too few numbers for a vertex"),
        };
        for (value, property) in values.iter_mut().zip(&element.properties) {
            *value = next()?;
            if property.list.is_some() {
                for _ in 0..*value as usize {
                    next()?;
                }
            }
        }
        sink.take(|column| values[column]);
    }
    Ok(())
}

fn read_binary(bytes: &[u8], header: &Header, vertex: usize, sink: &mut Sink, little: bool) -> Result<(), FormatError> {
    let mut position = header.length;
    for element in &header.elements[..vertex] {
        position = skip(bytes, position, element, little)?;
    }
    let element = &header.elements[vertex];
    let too_short = |row: usize| FormatError::Byte {
        offset: bytes.len(),
        problem: format!("ends within vertex {row} of {}", element.count),
    };
    if element.properties.iter().all(|property| property.list.is_none()) {
        let offsets: Vec<usize> = element
            .properties
            .iter()
            .scan(0, |at, property| {
                let start = *at;
                *at += property.scalar.size();
                Some(start)
            })
            .collect();
        let stride: usize = element.properties.iter().map(|property| property.scalar.size()).sum();
        let there = bytes.len().saturating_sub(position) / stride.max(1);
        if there < element.count {
            return Err(too_short(there));
        }
        sink.points.reserve(element.count);
        for row in bytes[position..].chunks_exact(stride).take(element.count) {
            sink.take(|column| element.properties[column].scalar.value(&row[offsets[column]..], little));
        }
        return Ok(());
    }
    let mut values = vec![0.0; element.properties.len()];
    for row in 0..element.count {
        for (value, property) in values.iter_mut().zip(&element.properties) {
            let (read, next) = property_at(bytes, position, property, little).ok_or_else(|| too_short(row))?;
            (*value, position) = (read, next);
        }
        sink.take(|column| values[column]);
    }
    Ok(())
}

/// Where the content after `element` begins.
fn skip(bytes: &[u8], start: usize, element: &Element, little: bool) -> Result<usize, FormatError> {
    let mut position = start;
    if element.properties.is_empty() {
        return Ok(position);
    }
    for row in 0..element.count {
        for property in &element.properties {
            let Some((_, next)) = property_at(bytes, position, property, little) else {
                return Err(FormatError::Byte {
                    offset: bytes.len(),
                    problem: format!("ends within {} {row} of {}", element.name, element.count),
                });
            };
            position = next;
        }
    }
    Ok(position)
}

/// The value at `position` (a list's length) and where the next property begins; `None` past the end.
fn property_at(bytes: &[u8], position: usize, property: &Property, little: bool) -> Option<(f64, usize)> {
    let head = property.list.unwrap_or(property.scalar);
    let body = position.checked_add(head.size())?;
    let value = head.value(bytes.get(position..body)?, little);
    if property.list.is_none() {
        return Some((value, body));
    }
    let items = (value.max(0.0) as usize).checked_mul(property.scalar.size())?;
    let end = body.checked_add(items).filter(|&end| end <= bytes.len())?;
    Some((value, end))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};

    fn cloud() -> PointCloud {
        let points = (0..5).map(|i| Point3::new(f64::from(i), 0.5, -2.25));
        let cloud = PointCloud::from_measured(points).cloud;
        cloud.with_normals(vec![Vector3::new(0.0, 0.0, -1.0); 5]).unwrap()
    }

    #[test]
    fn what_is_written_is_read_back() {
        let bytes = write_ply(&cloud(), &["frame view_0, mm", "two\nlines"]);
        let text = String::from_utf8_lossy(&bytes);
        assert!(text.contains("comment frame view_0, mm\ncomment two lines\n"));
        let read = read_ply(&bytes).unwrap();
        assert_eq!((read.cloud, read.dropped_count), (cloud(), 0));
        assert!(
            read_ply(&write_ply(&PointCloud::default(), &[]))
                .unwrap()
                .cloud
                .is_empty()
        );
    }

    #[test]
    fn ascii_with_extra_properties_lists_and_faces_is_read() {
        let text = b"ply\nformat ascii 1.0\ncomment hi\nelement camera 1\nproperty float f\nelement vertex 2\n\
            property uchar red\nproperty double x\nproperty list uchar int tags\nproperty double y\nproperty double z\n\
            element face 1\nproperty list uchar int vertex_indices\nend_header\n9\n255 1 2 7 8 2 3\n0 nan 0 0 0\n3 0 1 0\n";
        let read = read_ply(text).unwrap();
        assert_eq!(read.cloud.points(), [Point3::new(1.0, 2.0, 3.0)]);
        assert_eq!(read.dropped_count, 1);
        assert!(read.cloud.normals().is_none());
    }

    #[test]
    fn big_endian_with_a_list_before_the_vertices_is_read() {
        let mut bytes = b"ply\nformat binary_big_endian 1.0\nelement strip 1\nproperty list int short v\n\
            element vertex 1\nproperty double z\nproperty float y\nproperty short x\nend_header\n"
            .to_vec();
        bytes.extend(2i32.to_be_bytes());
        bytes.extend([0, 1, 0, 2]);
        bytes.extend(3.5f64.to_be_bytes());
        bytes.extend((-2.0f32).to_be_bytes());
        bytes.extend((-7i16).to_be_bytes());
        assert_eq!(read_ply(&bytes).unwrap().cloud.points(), [Point3::new(-7.0, -2.0, 3.5)]);
    }

    #[test]
    fn broken_files_are_refused_with_the_place() {
        let header = "ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\nproperty float x\n\
            property float y\nproperty float z\nend_header\n";
        let error = read_ply(header.as_bytes()).unwrap_err();
        assert_eq!(
            error.to_string(),
            format!("byte {}: ends within vertex 0 of 99999999999", header.len())
        );
        for (text, part) in [
            ("solid", "line 1"),
            ("ply\nformat ebcdic 1.0\n", "allowed are ascii"),
            ("ply\nformat ascii 1.0\nelement vertex two\n", "line 3: `two`"),
            ("ply\nformat ascii 1.0\nproperty float x\n", "before the first element"),
            (
                "ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\n",
                "line 4: type `quad`",
            ),
            (
                "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nend_header\n",
                "x, y and z",
            ),
            ("ply\nformat ascii 1.0\nend_header\n", "element vertex"),
            ("ply\nelement vertex 0\nend_header\n", "no `format`"),
            ("ply\nformat ascii 1.0\n", "end_header"),
        ] {
            let error = read_ply(text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(part), "{text:?}: {error}");
        }
        let mut bytes = write_ply(&cloud(), &[]);
        for length in 0..bytes.len() {
            assert!(read_ply(&bytes[..length]).is_err(), "{length}");
        }
        bytes.push(0);
        assert!(read_ply(&bytes).is_ok());
    }
}
