//! PLY, ASCII and binary, as scanners and Blender write it: one element `vertex`, one element `face`.
//!
//! Read here and not by `ply-rs-bw`, the best kept of the libraries: a header of a hundred bytes makes that one use up all
//! memory, and it skips a repeated property without reading its values.

use super::error::CaptureError;
use super::mesh_file::RawMesh;
use super::polygon::triangulate;
use glam::{DVec3, Vec2, Vec3};
use rekindle_base::files;
use std::io::Read;
use std::path::Path;

/// Longest header read when only looking for faces.
const HEADER_LIMIT: u64 = 65_536;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Ascii,
    LittleEndian,
    BigEndian,
}

#[derive(Clone, Copy, Debug)]
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

#[derive(Debug)]
struct Property {
    name: String,
    value: Scalar,
    /// Type of the length, for a list.
    length: Option<Scalar>,
}

#[derive(Debug)]
struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

/// Whether a PLY file's header announces faces.
pub(super) fn has_faces(path: &Path) -> bool {
    let mut bytes = Vec::new();
    let Ok(file) = files::open(path) else {
        return false;
    };
    if file.take(HEADER_LIMIT).read_to_end(&mut bytes).is_err() {
        return false;
    }
    header(&bytes).is_ok_and(|(_, elements, _)| {
        elements
            .iter()
            .any(|element| element.name == "face" && element.count > 0)
    })
}

/// Parses the bytes of the PLY file `path`.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<RawMesh, CaptureError> {
    let broken = |(place, problem): (String, String)| CaptureError::MeshBroken {
        path: path.to_owned(),
        place,
        problem,
    };
    let (format, elements, start) =
        header(bytes).map_err(|problem| broken(("header".to_owned(), problem)))?;
    let mut reader = Reader {
        format,
        rest: &bytes[start..],
    };
    let mut mesh = Builder::default();
    for element in &elements {
        // Every entry takes a byte at least: a count beyond that is a damaged header.
        if element.count > reader.rest.len() && !element.properties.is_empty() {
            let problem = format!(
                "{} entries are announced, but only {} bytes follow",
                element.count,
                reader.rest.len()
            );
            return Err(broken((format!("element {}", element.name), problem)));
        }
        let result = match element.name.as_str() {
            "vertex" => mesh.read_vertices(element, &mut reader),
            "face" => mesh.read_faces(element, &mut reader),
            _ => skip(element, &mut reader),
        };
        result.map_err(|(i, problem)| broken((format!("{} {i}", element.name), problem)))?;
    }
    mesh.finish()
        .map_err(|(i, problem)| broken((format!("face {i}"), problem)))
}

/// Format, elements and where the data starts.
fn header(bytes: &[u8]) -> Result<(Format, Vec<Element>, usize), String> {
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut at = 0;
    for (number, line) in bytes.split_inclusive(|&b| b == b'\n').enumerate() {
        at += line.len();
        let line = String::from_utf8_lossy(line);
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["ply"] if number == 0 => {}
            _ if number == 0 => return Err("the file does not start with 'ply'".to_owned()),
            ["format", name, ..] => {
                format = Some(match *name {
                    "ascii" => Format::Ascii,
                    "binary_little_endian" => Format::LittleEndian,
                    "binary_big_endian" => Format::BigEndian,
                    other => return Err(format!("format '{other}' is not known")),
                });
            }
            ["element", name, count] => elements.push(Element {
                name: (*name).to_owned(),
                count: count
                    .parse()
                    .map_err(|_| format!("'{count}' is not a number of entries"))?,
                properties: Vec::new(),
            }),
            ["property", rest @ ..] => {
                let property = property(rest)?;
                let element = elements.last_mut().ok_or("a property before any element")?;
                element.properties.push(property);
            }
            ["end_header"] => {
                let format = format.ok_or("the format line is missing")?;
                return Ok((format, elements, at));
            }
            // Comments, obj_info and empty lines.
            _ => {}
        }
    }
    Err("end_header is missing".to_owned())
}

fn property(words: &[&str]) -> Result<Property, String> {
    let scalar = |name: &str| {
        Ok(match name {
            "char" | "int8" => Scalar::I8,
            "uchar" | "uint8" => Scalar::U8,
            "short" | "int16" => Scalar::I16,
            "ushort" | "uint16" => Scalar::U16,
            "int" | "int32" => Scalar::I32,
            "uint" | "uint32" => Scalar::U32,
            "float" | "float32" => Scalar::F32,
            "double" | "float64" => Scalar::F64,
            other => return Err(format!("property type '{other}' is not known")),
        })
    };
    match words {
        ["list", length, value, name] => Ok(Property {
            name: (*name).to_owned(),
            value: scalar(value)?,
            length: Some(scalar(length)?),
        }),
        [value, name] => Ok(Property {
            name: (*name).to_owned(),
            value: scalar(value)?,
            length: None,
        }),
        _ => Err(format!("'property {}' is not understood", words.join(" "))),
    }
}

/// Reads values one after the other.
struct Reader<'a> {
    format: Format,
    rest: &'a [u8],
}

impl Reader<'_> {
    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (head, rest) = self
            .rest
            .split_first_chunk::<N>()
            .ok_or("the file ends too early")?;
        self.rest = rest;
        let mut bytes = *head;
        if self.format == Format::BigEndian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn value(&mut self, scalar: Scalar) -> Result<f64, String> {
        if self.format == Format::Ascii {
            return self.word();
        }
        Ok(match scalar {
            Scalar::I8 => f64::from(i8::from_le_bytes(self.bytes()?)),
            Scalar::U8 => f64::from(u8::from_le_bytes(self.bytes()?)),
            Scalar::I16 => f64::from(i16::from_le_bytes(self.bytes()?)),
            Scalar::U16 => f64::from(u16::from_le_bytes(self.bytes()?)),
            Scalar::I32 => f64::from(i32::from_le_bytes(self.bytes()?)),
            Scalar::U32 => f64::from(u32::from_le_bytes(self.bytes()?)),
            Scalar::F32 => f64::from(f32::from_le_bytes(self.bytes()?)),
            Scalar::F64 => f64::from_le_bytes(self.bytes()?),
        })
    }

    fn word(&mut self) -> Result<f64, String> {
        let text = self.rest.trim_ascii_start();
        let end = text
            .iter()
            .position(u8::is_ascii_whitespace)
            .unwrap_or(text.len());
        let (word, rest) = text.split_at(end);
        self.rest = rest;
        if word.is_empty() {
            return Err("the file ends too early".to_owned());
        }
        std::str::from_utf8(word)
            .ok()
            .and_then(|word| word.parse().ok())
            .ok_or_else(|| format!("'{}' is not a number", String::from_utf8_lossy(word)))
    }

    /// Appends the values of a list to `out`.
    fn list(
        &mut self,
        property: &Property,
        length: Scalar,
        out: &mut Vec<f64>,
    ) -> Result<(), String> {
        let count = self.value(length)?;
        if !(0.0..=self.rest.len() as f64).contains(&count) {
            return Err(format!("a list of {count} values"));
        }
        for _ in 0..count as usize {
            out.push(self.value(property.value)?);
        }
        Ok(())
    }
}

fn skip(element: &Element, reader: &mut Reader) -> Result<(), (usize, String)> {
    let mut list = Vec::new();
    if element.properties.is_empty() {
        return Ok(());
    }
    for i in 0..element.count {
        for property in &element.properties {
            list.clear();
            match property.length {
                Some(length) => reader.list(property, length, &mut list),
                None => reader.value(property.value).map(|_| ()),
            }
            .map_err(|problem| (i, problem))?;
        }
    }
    Ok(())
}

/// Whether texture coordinates differ; absent ones (NaN) are alike.
fn differ(a: Vec2, b: Vec2) -> bool {
    a.to_array().map(f32::to_bits) != b.to_array().map(f32::to_bits)
}

/// Where a vertex property goes.
const SLOTS: [&[&str]; 8] = [
    &["x"],
    &["y"],
    &["z"],
    &["nx"],
    &["ny"],
    &["nz"],
    &["s", "u", "texture_u", "tu"],
    &["t", "v", "texture_v", "tv"],
];

#[derive(Default)]
struct Builder {
    positions: Vec<DVec3>,
    normals: Vec<Vec3>,
    uvs: Vec<Vec2>,
    polygons: Vec<u32>,
    /// Where each face ends in `polygons`.
    ends: Vec<usize>,
    /// Texture coordinates of face corners, as `polygons`, NaN where absent; empty if there are none.
    corner_uvs: Vec<Vec2>,
}

impl Builder {
    fn read_vertices(
        &mut self,
        element: &Element,
        reader: &mut Reader,
    ) -> Result<(), (usize, String)> {
        let slots: Vec<Option<usize>> = element
            .properties
            .iter()
            .map(|property| {
                SLOTS
                    .iter()
                    .position(|names| names.contains(&property.name.as_str()))
            })
            .collect();
        let has = |slot: usize| slots.contains(&Some(slot));
        if !(0..3).all(has) {
            return Err((0, "the properties x, y and z are missing".to_owned()));
        }
        let (has_normals, has_uvs) = ((3..6).all(has), (6..8).all(has));
        let mut list = Vec::new();
        for i in 0..element.count {
            let at = |problem| (i, problem);
            let mut values = [0.0_f64; 8];
            for (property, slot) in element.properties.iter().zip(&slots) {
                if let Some(length) = property.length {
                    list.clear();
                    reader.list(property, length, &mut list).map_err(at)?;
                    continue;
                }
                let value = reader.value(property.value).map_err(at)?;
                if let Some(slot) = slot {
                    values[*slot] = value;
                }
            }
            let [x, y, z, nx, ny, nz, u, v] = values;
            let position = DVec3::new(x, y, z);
            if !position.as_vec3().is_finite() {
                return Err((i, "the position is NaN or not finite".to_owned()));
            }
            self.positions.push(position);
            if has_normals {
                self.normals.push(DVec3::new(nx, ny, nz).as_vec3());
            }
            if has_uvs {
                self.uvs.push(Vec2::new(u as f32, v as f32));
            }
        }
        Ok(())
    }

    fn read_faces(
        &mut self,
        element: &Element,
        reader: &mut Reader,
    ) -> Result<(), (usize, String)> {
        let indices = element
            .properties
            .iter()
            .position(|p| p.length.is_some() && p.name.starts_with("vert"))
            .ok_or((0, "the list vertex_indices is missing".to_owned()))?;
        let mut list = Vec::new();
        for i in 0..element.count {
            let at = |problem| (i, problem);
            let mut uvs = Vec::new();
            for (k, property) in element.properties.iter().enumerate() {
                let Some(length) = property.length else {
                    reader.value(property.value).map_err(at)?;
                    continue;
                };
                list.clear();
                reader.list(property, length, &mut list).map_err(at)?;
                if k == indices {
                    if list.len() < 3 {
                        return Err((i, format!("it has {} corners", list.len())));
                    }
                    self.polygons.extend(list.iter().map(|&v| {
                        // Negative and fractional numbers end up out of range, which is checked at the end.
                        if v >= 0.0 && v < f64::from(u32::MAX) {
                            v as u32
                        } else {
                            u32::MAX
                        }
                    }));
                } else if property.name == "texcoord" {
                    uvs.extend(
                        list.chunks_exact(2)
                            .map(|uv| Vec2::new(uv[0] as f32, uv[1] as f32)),
                    );
                }
            }
            self.ends.push(self.polygons.len());
            if !uvs.is_empty() || !self.corner_uvs.is_empty() {
                let before = self.ends.len().checked_sub(2).map_or(0, |k| self.ends[k]);
                self.corner_uvs.resize(before, Vec2::NAN);
                self.corner_uvs.extend(uvs);
                self.corner_uvs.resize(self.polygons.len(), Vec2::NAN);
            }
        }
        Ok(())
    }

    /// Gives corners of one vertex that differ in texture coordinate vertices of their own.
    fn split_corners(&mut self) {
        self.uvs = vec![Vec2::NAN; self.positions.len()];
        let mut next = vec![u32::MAX; self.positions.len()];
        let mut used = vec![false; self.positions.len()];
        for (vertex, uv) in self.polygons.iter_mut().zip(&self.corner_uvs) {
            let mut at = *vertex as usize;
            // Along the chain of vertices made from this one, to the one with this texture coordinate.
            while used[at] && differ(self.uvs[at], *uv) && next[at] != u32::MAX {
                at = next[at] as usize;
            }
            if used[at] && differ(self.uvs[at], *uv) {
                next[at] = self.positions.len() as u32;
                self.positions.push(self.positions[at]);
                if let Some(&normal) = self.normals.get(at) {
                    self.normals.push(normal);
                }
                self.uvs.push(Vec2::NAN);
                next.push(u32::MAX);
                used.push(false);
                at = self.positions.len() - 1;
            }
            used[at] = true;
            self.uvs[at] = *uv;
            *vertex = at as u32;
        }
    }

    fn finish(mut self) -> Result<RawMesh, (usize, String)> {
        let count = self.positions.len();
        if let Some(at) = self.polygons.iter().position(|&v| v as usize >= count) {
            let face = self.ends.partition_point(|&end| end <= at);
            let problem = format!("a vertex index is out of range: the file has {count} vertices");
            return Err((face, problem));
        }
        if !self.corner_uvs.is_empty() {
            self.split_corners();
        }
        let mut triangles = Vec::with_capacity(self.ends.len());
        let mut start = 0;
        for &end in &self.ends {
            triangulate(&self.polygons[start..end], &self.positions, &mut triangles);
            start = end;
        }
        Ok(RawMesh {
            positions: self.positions,
            normals: self.normals,
            uvs: self.uvs,
            triangles,
        })
    }
}
