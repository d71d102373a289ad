//! Wavefront OBJ: `v`, `vt`, `vn` and `f`; groups, objects and materials make one mesh.

use super::error::CaptureError;
use super::mesh_file::RawMesh;
use super::polygon::triangulate;
use glam::{Vec2, Vec3};
use std::path::Path;

const NONE: u32 = u32::MAX;

/// What the three indices of a corner refer to, for messages.
const WHAT: [&str; 3] = ["vertex", "texture coordinate", "normal"];

/// A corner's indices of position, texture coordinate and normal; `NONE` where absent.
type Corner = [u32; 3];

#[derive(Default)]
struct Parser {
    positions: Vec<Vec3>,
    uvs: Vec<Vec2>,
    normals: Vec<Vec3>,
    /// First vertex made of each position, and for each vertex the next one made of the same position.
    first: Vec<u32>,
    next: Vec<u32>,
    corners: Vec<Corner>,
    triangles: Vec<[u32; 3]>,
    out: Vec<Vec3>,
    polygon: Vec<u32>,
    /// Positions, texture coordinates and normals before the current line, which negative indices count from.
    before: [usize; 3],
}

/// Parses the bytes of the OBJ file `path`.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<RawMesh, CaptureError> {
    let mut parser = Parser::default();
    let joined;
    let bytes = if bytes.contains(&b'\\') {
        joined = join_continued(bytes);
        &joined
    } else {
        bytes
    };
    // Faces may stand before the vertices that they refer to: vertices are read first.
    for pass in [Parser::vertex_line, Parser::face_line] {
        for (i, line) in bytes.split(|&b| b == b'\n').enumerate() {
            pass(&mut parser, line).map_err(|problem| CaptureError::MeshBroken {
                path: path.to_owned(),
                place: format!("line {}", i + 1),
                problem,
            })?;
        }
    }
    if parser.triangles.is_empty() {
        return Err(CaptureError::MeshEmpty {
            path: path.to_owned(),
            problem: format!("{} vertices but no faces", parser.positions.len()),
        });
    }
    Ok(parser.finish())
}

/// Joins lines that end in a backslash, keeping the number of lines.
fn join_continued(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes.len());
    let mut owed = 0;
    for line in bytes.split_inclusive(|&b| b == b'\n') {
        let text = line.trim_ascii_end();
        if let Some(text) = text.strip_suffix(b"\\") {
            out.extend_from_slice(text);
            out.push(b' ');
            owed += 1;
        } else {
            out.extend_from_slice(line);
            out.extend(std::iter::repeat_n(b'\n', owed));
            owed = 0;
        }
    }
    out
}

impl Parser {
    fn vertex_line(&mut self, line: &[u8]) -> Result<(), String> {
        let mut words = words(line);
        match words.next() {
            Some(b"v") => {
                let [x, y, z] = numbers(&mut words)?;
                let position = Vec3::new(x, y, z);
                if !position.is_finite() {
                    return Err("the vertex is NaN or not finite".to_owned());
                }
                self.positions.push(position);
                self.first.push(NONE);
            }
            Some(b"vn") => self.normals.push(Vec3::from(numbers(&mut words)?)),
            Some(b"vt") => {
                let u = number(words.next())?;
                let v = words.next().map_or(Ok(0.0), |word| number(Some(word)))?;
                self.uvs.push(Vec2::new(u, v));
            }
            _ => {}
        }
        Ok(())
    }

    fn face_line(&mut self, line: &[u8]) -> Result<(), String> {
        let mut words = words(line);
        match words.next() {
            Some(b"v") => self.before[0] += 1,
            Some(b"vt") => self.before[1] += 1,
            Some(b"vn") => self.before[2] += 1,
            Some(b"f" | b"fo") => self.face(words)?,
            _ => {}
        }
        Ok(())
    }

    fn face<'a>(&mut self, words: impl Iterator<Item = &'a [u8]>) -> Result<(), String> {
        let mut polygon = std::mem::take(&mut self.polygon);
        polygon.clear();
        for word in words.take_while(|word| !word.starts_with(b"#")) {
            let corner = self.corner(word)?;
            polygon.push(self.vertex(corner));
        }
        if polygon.len() < 3 {
            return Err(format!("a face with {} corners", polygon.len()));
        }
        triangulate(&polygon, &self.out, &mut self.triangles);
        self.polygon = polygon;
        Ok(())
    }

    /// The indices in `v`, `v/vt`, `v//vn` or `v/vt/vn`, from 1 or, if negative, from the end.
    fn corner(&self, word: &[u8]) -> Result<Corner, String> {
        let counts = [self.positions.len(), self.uvs.len(), self.normals.len()];
        let mut corner = [NONE; 3];
        for (i, part) in word.split(|&b| b == b'/').enumerate() {
            if i > 2 || (part.is_empty() && i == 0) {
                return Err(format!(
                    "'{}' is not a corner of a face",
                    String::from_utf8_lossy(word)
                ));
            }
            if part.is_empty() {
                continue;
            }
            let index = std::str::from_utf8(part)
                .ok()
                .and_then(|text| text.parse::<i32>().ok())
                .map(i64::from)
                .ok_or_else(|| format!("'{}' is not an index", String::from_utf8_lossy(part)))?;
            let count = counts[i] as i64;
            let place = if index < 0 {
                self.before[i] as i64 + index
            } else {
                index - 1
            };
            if !(0..count).contains(&place) {
                return Err(format!(
                    "{} index {index} is out of range: the file has {count}",
                    WHAT[i]
                ));
            }
            corner[i] = place as u32;
        }
        Ok(corner)
    }

    /// The vertex for a corner, made on first use.
    fn vertex(&mut self, corner: Corner) -> u32 {
        let position = corner[0] as usize;
        let mut at = self.first[position];
        while at != NONE {
            if self.corners[at as usize] == corner {
                return at;
            }
            at = self.next[at as usize];
        }
        let new = self.corners.len() as u32;
        self.corners.push(corner);
        self.out.push(self.positions[position]);
        self.next.push(self.first[position]);
        self.first[position] = new;
        new
    }

    fn finish(self) -> RawMesh {
        let normals = self
            .corners
            .iter()
            .map(|corner| {
                self.normals
                    .get(corner[2] as usize)
                    .copied()
                    .unwrap_or(Vec3::ZERO)
            })
            .collect();
        let uvs = if self.corners.iter().all(|corner| corner[1] == NONE) {
            Vec::new()
        } else {
            self.corners
                .iter()
                .map(|corner| {
                    self.uvs
                        .get(corner[1] as usize)
                        .copied()
                        .unwrap_or(Vec2::NAN)
                })
                .collect()
        };
        RawMesh {
            positions: self.out,
            normals,
            uvs,
            triangles: self.triangles,
        }
    }
}

fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace)
        .filter(|word| !word.is_empty())
}

fn numbers<'a, const N: usize>(
    words: &mut impl Iterator<Item = &'a [u8]>,
) -> Result<[f32; N], String> {
    let mut out = [0.0; N];
    for value in &mut out {
        *value = number(words.next())?;
    }
    Ok(out)
}

fn number(word: Option<&[u8]>) -> Result<f32, String> {
    let word = word.ok_or("numbers are missing")?;
    std::str::from_utf8(word)
        .ok()
        .and_then(|text| text.parse().ok())
        .ok_or_else(|| format!("'{}' is not a number", String::from_utf8_lossy(word)))
}
