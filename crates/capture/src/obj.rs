//! Wavefront OBJ, read by `tobj`; groups, objects and materials make one mesh.
//!
//! Exporters write more than `tobj` understands, so it gets the statements that matter in plain form from [`Plain`].
//! Its errors name no line: the file is then gone through again for the first line that is wrong ([`first_mistake`]).

use super::error::CaptureError;
use super::mesh_file::RawMesh;
use super::polygon::triangulate;
use glam::{DVec3, Vec2, Vec3};
use std::io::{self, BufRead, Read};
use std::path::Path;

/// What the three indices of a corner refer to, for messages.
const WHAT: [&str; 3] = ["vertex", "texture coordinate", "normal"];
/// More digits than any index has: they could overflow `tobj`'s arithmetic.
const MOST_DIGITS: usize = 12;
/// Polygons are cut here, because `tobj`'s fans leave those that are concave.
const OPTIONS: tobj::LoadOptions = tobj::LoadOptions {
    single_index: true,
    triangulate: false,
    ignore_points: true,
    ignore_lines: true,
};

/// Parses the bytes of the OBJ file `path`.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<RawMesh, CaptureError> {
    let mut plain = Plain::new(bytes);
    // Materials are never asked for: the statements that name them are left out.
    let no_materials = |_: &Path| Err(tobj::LoadError::OpenFileFailed);
    let loaded = tobj::load_obj_buf(&mut plain, &OPTIONS, no_materials);
    let broken = |place: String, problem: String| CaptureError::MeshBroken {
        path: path.to_owned(),
        place,
        problem,
    };
    let finite = |mesh: &tobj::Mesh| mesh.positions.iter().all(|v| v.is_finite());
    let (mesh, problem) = match loaded {
        Ok((models, _)) => {
            let mesh = models.into_iter().next().map(|model| model.mesh);
            (mesh.unwrap_or_default(), None)
        }
        Err(error) => (tobj::Mesh::default(), Some(error.to_string())),
    };
    if problem.is_some() || plain.filled || !finite(&mesh) {
        if let Some((line, problem)) = first_mistake(bytes, plain.totals) {
            return Err(broken(format!("line {line}"), problem));
        }
        if let Some(problem) = problem {
            return Err(broken("the file".to_owned(), problem));
        }
    }
    let raw = to_raw(&mesh);
    if raw.triangles.is_empty() {
        return Err(CaptureError::MeshEmpty {
            path: path.to_owned(),
            problem: format!("it has {} vertices but no faces", plain.totals[0]),
        });
    }
    Ok(raw)
}

/// The mesh with its polygons cut into triangles.
fn to_raw(mesh: &tobj::Mesh) -> RawMesh {
    let threes = |values: &[f64]| -> Vec<DVec3> {
        let triples = values.chunks_exact(3);
        triples.map(|v| DVec3::new(v[0], v[1], v[2])).collect()
    };
    let positions = threes(&mesh.positions);
    let normals = threes(&mesh.normals).into_iter();
    let mut normals: Vec<Vec3> = normals.map(DVec3::as_vec3).collect();
    normals.resize(positions.len(), Vec3::ZERO);
    let uvs = mesh.texcoords.chunks_exact(2);
    let uvs: Vec<Vec2> = uvs
        .map(|uv| Vec2::new(uv[0] as f32, uv[1] as f32))
        .collect();
    let absent = uvs.iter().all(|uv| uv.is_nan());
    let mut triangles = Vec::with_capacity(mesh.indices.len() / 3);
    if mesh.face_arities.is_empty() {
        let faces = mesh.indices.chunks_exact(3);
        triangles.extend(faces.map(|face| [face[0], face[1], face[2]]));
    }
    let mut rest = mesh.indices.as_slice();
    for &count in &mesh.face_arities {
        let (polygon, others) = rest.split_at(rest.len().min(count as usize));
        triangulate(polygon, &positions, &mut triangles);
        rest = others;
    }
    RawMesh {
        positions,
        normals,
        uvs: if absent { Vec::new() } else { uvs },
        triangles,
    }
}

/// The statements of an OBJ file: lines that end in a backslash joined, comments left out.
struct Statements<'a> {
    rest: &'a [u8],
    /// Line on which the last statement starts, from 1.
    line: usize,
    /// Lines up to the end of the last statement.
    lines: usize,
    joined: Vec<u8>,
}

impl<'a> Statements<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self {
            rest: bytes,
            line: 0,
            lines: 0,
            joined: Vec::new(),
        }
    }

    /// One line without its comment.
    fn line(&mut self) -> Option<&'a [u8]> {
        if self.rest.is_empty() {
            return None;
        }
        self.lines += 1;
        let end = self.rest.iter().position(|&b| b == b'\n');
        let (line, rest) = self.rest.split_at(end.unwrap_or(self.rest.len()));
        self.rest = rest.get(1..).unwrap_or_default();
        let end = line.iter().position(|&b| b == b'#').unwrap_or(line.len());
        Some(line[..end].trim_ascii_end())
    }

    fn next(&mut self) -> Option<&[u8]> {
        self.line = self.lines + 1;
        let line = self.line()?;
        let Some(start) = line.strip_suffix(b"\\") else {
            return Some(line);
        };
        self.joined.clear();
        self.joined.extend_from_slice(start);
        while let Some(line) = self.line() {
            self.joined.push(b' ');
            let part = line.strip_suffix(b"\\");
            self.joined.extend_from_slice(part.unwrap_or(line));
            if part.is_none() {
                break;
            }
        }
        Some(&self.joined)
    }
}

/// The plain form of an OBJ file, statement by statement:
/// * `v`, `vt`, `vn` and `f` only: names may be in any encoding, and groups would divide the mesh;
/// * vertices have three numbers, without weight or colour, and texture coordinates two;
/// * faces have three corners or more, and all their corners an index of everything that the file has: where one is
///   missing it is that of an entry at the file's end, NaN for texture coordinates and zero for normals.
struct Plain<'a> {
    statements: Statements<'a>,
    /// How many vertices, texture coordinates and normals the file has.
    totals: [usize; 3],
    /// How many of them come before the current statement's end.
    before: [usize; 3],
    /// Whether any index was missing and the file has such entries.
    filled: bool,
    ended: bool,
    /// The current statement and how much of it was read.
    text: Vec<u8>,
    read: usize,
}

impl<'a> Plain<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        let mut totals = [0; 3];
        let mut statements = Statements::new(bytes);
        while let Some(statement) = statements.next() {
            if let Some(kind) = words(statement).next().and_then(entry) {
                totals[kind] += 1;
            }
        }
        Self {
            statements: Statements::new(bytes),
            totals,
            before: [0; 3],
            filled: false,
            ended: false,
            text: Vec::new(),
            read: 0,
        }
    }

    /// Puts the next statement into `text`, which stays empty at the end.
    fn advance(&mut self) -> io::Result<()> {
        self.text.clear();
        self.read = 0;
        while let Some(statement) = self.statements.next() {
            let mut words = words(statement);
            let name = words.next();
            if let Some(kind) = name.and_then(entry) {
                self.before[kind] += 1;
            }
            match name {
                Some(b"v") => push(&mut self.text, "v", words.take(3)),
                Some(b"vn") => push(&mut self.text, "vn", words),
                Some(b"vt") => {
                    push(&mut self.text, "vt", words.take(2));
                    // The second is zero where it is left out; a third is not read.
                    self.text.extend_from_slice(b" 0");
                }
                Some(b"f" | b"fo") => {
                    self.text.extend_from_slice(b"f ");
                    let mut corners = 0;
                    for word in words {
                        self.filled |= push_corner(&mut self.text, word, self.totals, self.before)?;
                        corners += 1;
                    }
                    if corners < 3 {
                        return Err(io::ErrorKind::InvalidData.into());
                    }
                }
                _ => continue,
            }
            self.text.push(b'\n');
            return Ok(());
        }
        if self.filled && !self.ended {
            self.text.extend_from_slice(b"vt NaN NaN\nvn 0 0 0\n");
        }
        self.ended = true;
        Ok(())
    }
}

impl Read for Plain<'_> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let count = self.fill_buf()?.read(out)?;
        self.consume(count);
        Ok(count)
    }
}

impl BufRead for Plain<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.read >= self.text.len() {
            self.advance()?;
        }
        Ok(&self.text[self.read..])
    }

    fn consume(&mut self, count: usize) {
        self.read += count;
    }
}

fn words(statement: &[u8]) -> impl Iterator<Item = &[u8]> {
    let pieces = statement.split(u8::is_ascii_whitespace);
    pieces.filter(|word| !word.is_empty())
}

/// Which of [`WHAT`] a statement adds to.
fn entry(name: &[u8]) -> Option<usize> {
    match name {
        b"v" => Some(0),
        b"vt" => Some(1),
        b"vn" => Some(2),
        _ => None,
    }
}

fn push<'a>(text: &mut Vec<u8>, name: &str, words: impl Iterator<Item = &'a [u8]>) {
    text.extend_from_slice(name.as_bytes());
    for word in words {
        text.push(b' ');
        text.extend_from_slice(word);
    }
}

/// The up to three indices of a corner as they stand there.
fn indices(word: &[u8]) -> Option<[&[u8]; 3]> {
    let mut parts = [&b""[..]; 3];
    for (i, part) in word.split(|&b| b == b'/').enumerate() {
        *parts.get_mut(i)? = part;
    }
    Some(parts)
}

/// Adds a corner with all its indices to a face; whether one was missing.
fn push_corner(
    text: &mut Vec<u8>,
    word: &[u8],
    totals: [usize; 3],
    before: [usize; 3],
) -> io::Result<bool> {
    let refused = || io::Error::from(io::ErrorKind::InvalidData);
    let parts = indices(word).ok_or_else(refused)?;
    let zero = |part: &[u8]| part.iter().all(|b| b"+-0".contains(b));
    let mut filled = false;
    for (i, part) in parts.iter().enumerate() {
        if i > 0 {
            text.push(b'/');
        }
        if !part.is_empty() {
            // tobj takes zero for an index that is left out, and counts back beyond the first entry.
            if part.len() > MOST_DIGITS || zero(part) || reaches_back(part, before[i]) {
                return Err(refused());
            }
            text.extend_from_slice(part);
        } else if totals[i] > 0 {
            text.extend_from_slice((totals[i] + 1).to_string().as_bytes());
            filled = true;
        }
    }
    text.push(b' ');
    Ok(filled)
}

/// Whether an index that counts backwards does so beyond the first of the entries `before` it.
fn reaches_back(part: &[u8], before: usize) -> bool {
    let back = part.strip_prefix(b"-").map(std::str::from_utf8);
    back.is_some_and(|digits| {
        let count = digits.ok().and_then(|digits| digits.parse::<usize>().ok());
        count.is_none_or(|count| count > before)
    })
}

/// The first line that is wrong, and how.
fn first_mistake(bytes: &[u8], totals: [usize; 3]) -> Option<(usize, String)> {
    let mut statements = Statements::new(bytes);
    let mut before = [0; 3];
    while let Some(statement) = statements.next() {
        if let Err(problem) = check(statement, totals, &mut before) {
            return Some((statements.line, problem));
        }
    }
    None
}

/// Checks a statement and counts the entries `before` the next.
fn check(statement: &[u8], totals: [usize; 3], before: &mut [usize; 3]) -> Result<(), String> {
    let mut words = words(statement);
    let name = words.next().unwrap_or_default();
    match name {
        b"v" => vertex(&mut words)?,
        b"vn" => (0..3).try_for_each(|_| number(words.next()).map(drop))?,
        b"vt" => {
            number(words.next())?;
            words.next().map_or(Ok(0.0), |word| number(Some(word)))?;
        }
        b"f" | b"fo" => face(words, totals, *before)?,
        _ => {}
    }
    if let Some(kind) = entry(name) {
        before[kind] += 1;
    }
    Ok(())
}

fn vertex<'a>(words: &mut impl Iterator<Item = &'a [u8]>) -> Result<(), String> {
    for _ in 0..3 {
        if !number(words.next())?.is_finite() {
            return Err("the vertex is NaN or not finite".to_owned());
        }
    }
    Ok(())
}

fn number(word: Option<&[u8]>) -> Result<f32, String> {
    let word = word.ok_or("numbers are missing")?;
    std::str::from_utf8(word)
        .ok()
        .and_then(|text| text.parse().ok())
        .ok_or_else(|| format!("'{}' is not a number", String::from_utf8_lossy(word)))
}

/// Checks a face. Negative indices count back from the entries `before` it.
fn face<'a>(
    words: impl Iterator<Item = &'a [u8]>,
    totals: [usize; 3],
    before: [usize; 3],
) -> Result<(), String> {
    let mut corners = 0;
    for word in words {
        corners += 1;
        let no_corner = || {
            format!(
                "'{}' is not a corner of a face",
                String::from_utf8_lossy(word)
            )
        };
        let parts = indices(word).ok_or_else(no_corner)?;
        if parts[0].is_empty() {
            return Err(no_corner());
        }
        for (i, part) in parts.into_iter().enumerate() {
            if part.is_empty() {
                continue;
            }
            let index = std::str::from_utf8(part)
                .ok()
                .and_then(|text| text.parse::<i32>().ok())
                .map(i64::from)
                .ok_or_else(|| format!("'{}' is not an index", String::from_utf8_lossy(part)))?;
            let count = totals[i] as i64;
            let place = if index < 0 {
                before[i] as i64 + index
            } else {
                index - 1
            };
            if !(0..count).contains(&place) {
                return Err(format!(
                    "{} index {index} is out of range: the file has {count}",
                    WHAT[i]
                ));
            }
        }
    }
    if corners < 3 {
        return Err(format!("a face with {corners} corners"));
    }
    Ok(())
}
