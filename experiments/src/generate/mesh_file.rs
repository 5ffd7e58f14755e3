//! Triangle meshes from PLY files; STL is the simulator's.

use std::error::Error;
use std::fs;
use std::path::Path;

use hw_sim::blade::{Mesh, stl};
use nalgebra::Point3;

/// Reads an STL file, or the `vertex` and `face` elements of a PLY file (binary little-endian, or ascii).
pub(super) fn read(path: &Path) -> Result<Mesh, Box<dyn Error>> {
    let bytes = fs::read(path)?;
    if bytes.starts_with(b"ply") {
        read_ply(&bytes).map_err(|problem| format!("{}: {problem}", path.display()).into())
    } else {
        Ok(stl::read(path)?)
    }
}

/// A named scalar of a PLY element; a list has the type of its length too.
struct Property<'a> {
    name: &'a str,
    kind: &'a str,
    length_kind: Option<&'a str>,
}

fn read_ply(bytes: &[u8]) -> Result<Mesh, String> {
    const END: &[u8] = b"end_header\n";
    let end = bytes
        .windows(END.len())
        .position(|window| window == END)
        .ok_or("the header has no end")?;
    let header = std::str::from_utf8(&bytes[..end]).map_err(|_| "the header is not text")?;
    let mut elements: Vec<(&str, usize, Vec<Property>)> = Vec::new();
    let mut is_ascii = false;
    for line in header.lines() {
        match line.split_whitespace().collect::<Vec<_>>().as_slice() {
            ["format", "ascii", _] => is_ascii = true,
            ["format", "binary_little_endian", _] => {}
            ["format", ..] => return Err("only ascii and little-endian PLY files are read".into()),
            ["element", name, count] => elements.push((name, count.parse().map_err(|_| "bad count")?, Vec::new())),
            ["property", "list", length_kind, kind, name] => {
                elements.last_mut().ok_or("no element")?.2.push(Property {
                    name,
                    kind,
                    length_kind: Some(length_kind),
                })
            }
            ["property", kind, name] => elements.last_mut().ok_or("no element")?.2.push(Property {
                name,
                kind,
                length_kind: None,
            }),
            _ => {}
        }
    }
    let mut content = Content {
        rest: &bytes[end + END.len()..],
        is_ascii,
    };
    let mut mesh = Mesh {
        vertices: Vec::new(),
        triangles: Vec::new(),
    };
    for (element, count, properties) in &elements {
        for _ in 0..*count {
            let mut point = [f64::NAN; 3];
            for property in properties {
                let length = match property.length_kind {
                    Some(kind) => content.number(kind)? as usize,
                    None => 1,
                };
                let values: Vec<f64> = (0..length)
                    .map(|_| content.number(property.kind))
                    .collect::<Result<_, _>>()?;
                match (*element, property.name) {
                    ("vertex", "x") => point[0] = values[0],
                    ("vertex", "y") => point[1] = values[0],
                    ("vertex", "z") => point[2] = values[0],
                    ("face", "vertex_indices" | "vertex_index") => {
                        // A polygon becomes a fan.
                        for i in 2..values.len() {
                            mesh.triangles
                                .push([values[0] as u32, values[i - 1] as u32, values[i] as u32]);
                        }
                    }
                    _ => {}
                }
            }
            if *element == "vertex" {
                mesh.vertices.push(Point3::from(point));
            }
        }
    }
    let finite = mesh.vertices.iter().all(|vertex| vertex.iter().all(|x| x.is_finite()));
    let known = |corner: &u32| (*corner as usize) < mesh.vertices.len();
    if !finite || mesh.triangles.is_empty() || !mesh.triangles.iter().flatten().all(known) {
        return Err("no triangles of finite vertices".into());
    }
    Ok(mesh)
}

struct Content<'a> {
    rest: &'a [u8],
    is_ascii: bool,
}

impl Content<'_> {
    fn number(&mut self, kind: &str) -> Result<f64, String> {
        if self.is_ascii {
            let text = self.rest.trim_ascii_start();
            let length = text.iter().position(u8::is_ascii_whitespace).unwrap_or(text.len());
            self.rest = &text[length..];
            let word = std::str::from_utf8(&text[..length]).unwrap_or_default();
            return word.parse().map_err(|_| format!("`{word}` is not a number"));
        }
        Ok(match kind {
            "char" | "int8" => f64::from(i8::from_le_bytes(self.take()?)),
            "uchar" | "uint8" => f64::from(u8::from_le_bytes(self.take()?)),
            "short" | "int16" => f64::from(i16::from_le_bytes(self.take()?)),
            "ushort" | "uint16" => f64::from(u16::from_le_bytes(self.take()?)),
            "int" | "int32" => f64::from(i32::from_le_bytes(self.take()?)),
            "uint" | "uint32" => f64::from(u32::from_le_bytes(self.take()?)),
            "float" | "float32" => f64::from(f32::from_le_bytes(self.take()?)),
            "double" | "float64" => f64::from_le_bytes(self.take()?),
            _ => return Err(format!("`{kind}` is not a type")),
        })
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (taken, rest) = self.rest.split_first_chunk().ok_or("the content ends too early")?;
        self.rest = rest;
        Ok(*taken)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ascii_and_binary_files_give_the_same_mesh_and_a_square_two_triangles() {
        let header = |format: &str| {
            format!(
                "ply\nformat {format} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                 element face 1\nproperty list uchar int vertex_indices\nend_header\n"
            )
        };
        let corners = [[0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.5]];
        let ascii = header("ascii") + "0 0 0\n1 0 0\n1 1 0\n0 1 0.5\n4 0 1 2 3\n";
        let mut binary = header("binary_little_endian").into_bytes();
        for value in corners.iter().flatten() {
            binary.extend(value.to_le_bytes());
        }
        binary.push(4);
        for index in [0i32, 1, 2, 3] {
            binary.extend(index.to_le_bytes());
        }
        let mesh = read_ply(ascii.as_bytes()).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh, read_ply(&binary).unwrap());
        assert!(read_ply(&binary[..binary.len() - 1]).is_err());
        assert!(read_ply(ascii.replace("0 1 2 3", "0 1 2 4").as_bytes()).is_err());
    }
}
