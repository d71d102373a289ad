//! The mesh of a solution: `mesh.ply` (binary, exact, with texture coordinates per corner, as `MeshLab` writes them) for
//! programs, `mesh.obj` for people and modellers.

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::Path;

use glam::{DVec3, Vec2, Vec3};

use rekindle_base::files;
use rekindle_capture::{Mesh, origin_near};

/// A mesh with the texture coordinates of every triangle's corners, v upwards, both in [0, 1].
#[derive(Clone, Debug, PartialEq)]
pub struct TexturedMesh {
    /// The surface; its own per-vertex texture coordinates are left out.
    pub mesh: MeshParts,
    /// One triple per triangle.
    pub corner_uvs: Vec<[Vec2; 3]>,
}

/// What is stored of a mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshParts {
    /// As [`Mesh::origin`].
    pub origin: DVec3,
    /// One position per vertex, from the origin.
    pub positions: Vec<Vec3>,
    /// One unit normal per vertex.
    pub normals: Vec<Vec3>,
    /// Three vertex indices per triangle.
    pub triangles: Vec<[u32; 3]>,
}

/// Bytes of a triangle in the PLY file.
const TRIANGLE_BYTES: usize = 1 + 3 * 4 + 1 + 6 * 4;

/// How the file states positions: surveyed ones need double precision.
#[derive(Clone, Copy)]
enum Positions {
    Single,
    Double,
}

impl Positions {
    fn vertex_bytes(self) -> usize {
        match self {
            Self::Single => 6 * 4,
            Self::Double => 3 * 8 + 3 * 4,
        }
    }
}

fn header(positions: Positions, vertices: usize, triangles: usize) -> String {
    let real = match positions {
        Positions::Single => "float",
        Positions::Double => "double",
    };
    format!(
        "ply\nformat binary_little_endian 1.0\ncomment written by rekindle; texture diffuse.exr\n\
         element vertex {vertices}\nproperty {real} x\nproperty {real} y\nproperty {real} z\n\
         property float nx\nproperty float ny\nproperty float nz\n\
         element face {triangles}\nproperty list uchar uint vertex_indices\n\
         property list uchar float texcoord\nend_header\n"
    )
}

/// Writes the binary PLY file.
pub fn write_ply(path: &Path, mesh: &Mesh, corner_uvs: &[[Vec2; 3]]) -> io::Result<()> {
    let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
    let kind = if mesh.origin == DVec3::ZERO {
        Positions::Single
    } else {
        Positions::Double
    };
    let mut bytes = header(kind, vertices, triangles).into_bytes();
    bytes.reserve(vertices * kind.vertex_bytes() + triangles * TRIANGLE_BYTES);
    for (&position, normal) in mesh.positions.iter().zip(&mesh.normals) {
        match kind {
            Positions::Single => put_all(&mut bytes, position.to_array().map(f32::to_le_bytes)),
            Positions::Double => {
                let world = mesh.in_world(position);
                put_all(&mut bytes, world.to_array().map(f64::to_le_bytes));
            }
        }
        put_all(&mut bytes, normal.to_array().map(f32::to_le_bytes));
    }
    for (triangle, uvs) in mesh.triangles.iter().zip(corner_uvs) {
        bytes.push(3);
        for index in triangle {
            bytes.extend(index.to_le_bytes());
        }
        bytes.push(6);
        for uv in uvs {
            bytes.extend(uv.x.to_le_bytes());
            bytes.extend(uv.y.to_le_bytes());
        }
    }
    fs::write(path, bytes)
}

fn put_all<const N: usize>(bytes: &mut Vec<u8>, values: [[u8; N]; 3]) {
    bytes.extend(values.into_iter().flatten());
}

/// Reads what [`write_ply`] wrote; the error says what is wrong with the file.
pub fn read_ply(path: &Path) -> Result<TexturedMesh, String> {
    let bytes = files::read(path).map_err(|e| format!("it can't be read: {e}"))?;
    let marker = b"end_header\n";
    let end = bytes
        .windows(marker.len())
        .take(4096)
        .position(|w| w == marker)
        .ok_or("it has no PLY header")?
        + marker.len();
    let text = std::str::from_utf8(&bytes[..end]).map_err(|_| "its header is not text")?;
    let count = |element: &str| {
        text.lines()
            .find_map(|line| line.strip_prefix(element)?.trim().parse::<usize>().ok())
            .ok_or_else(|| format!("its header lacks \"{element}\""))
    };
    let (vertices, triangles) = (count("element vertex ")?, count("element face ")?);
    let kinds = [Positions::Single, Positions::Double];
    let kind = kinds
        .into_iter()
        .find(|&kind| text == header(kind, vertices, triangles))
        .ok_or("it is not as rekindle wrote it")?;
    let vertex_bytes = kind.vertex_bytes();
    let expected = vertices
        .checked_mul(vertex_bytes)
        .zip(triangles.checked_mul(TRIANGLE_BYTES))
        .and_then(|(v, t)| v.checked_add(t));
    if expected != Some(bytes.len() - end) {
        return Err("it is cut short, or goes on after its end".to_owned());
    }
    let (vertex_part, face_bytes) = bytes[end..].split_at(vertices * vertex_bytes);
    let (positions, normals): (Vec<DVec3>, Vec<Vec3>) = vertex_part
        .chunks_exact(vertex_bytes)
        .map(|chunk| vertex(kind, chunk))
        .unzip();
    if !positions.iter().all(|p| p.as_vec3().is_finite()) || !normals.iter().all(|n| n.is_finite())
    {
        return Err("it has vertices that are not finite".to_owned());
    }
    let mut faces = Vec::with_capacity(triangles);
    let mut corner_uvs = Vec::with_capacity(triangles);
    for chunk in face_bytes.chunks_exact(TRIANGLE_BYTES) {
        let triangle = [1, 5, 9].map(|at| u32::from_le_bytes(word(chunk, at)));
        let uv = |corner: usize| {
            let value = |i: usize| f32::from_le_bytes(word(chunk, 14 + 4 * (2 * corner + i)));
            Vec2::new(value(0), value(1))
        };
        let uvs = [uv(0), uv(1), uv(2)];
        if chunk[0] != 3 || chunk[13] != 6 || triangle.iter().any(|&i| i as usize >= vertices) {
            return Err("it has a triangle with an index out of range".to_owned());
        }
        if uvs.iter().any(|uv| !uv.is_finite()) {
            return Err("it has texture coordinates that are not finite".to_owned());
        }
        faces.push(triangle);
        corner_uvs.push(uvs);
    }
    if triangles == 0 {
        return Err("it has no triangles".to_owned());
    }
    let used = faces.iter().flatten().map(|&v| positions[v as usize]);
    let origin = match kind {
        Positions::Single => DVec3::ZERO,
        Positions::Double => origin_near(used),
    };
    Ok(TexturedMesh {
        mesh: MeshParts {
            origin,
            positions: positions.iter().map(|&p| (p - origin).as_vec3()).collect(),
            normals,
            triangles: faces,
        },
        corner_uvs,
    })
}

/// Position in the world and normal of one vertex.
fn vertex(kind: Positions, bytes: &[u8]) -> (DVec3, Vec3) {
    let single = |at: usize| f32::from_le_bytes(word(bytes, at));
    let double = |at: usize| f64::from_le_bytes(word(bytes, at));
    let normal = |at: usize| Vec3::new(single(at), single(at + 4), single(at + 8));
    match kind {
        Positions::Single => (
            Vec3::new(single(0), single(4), single(8)).as_dvec3(),
            normal(12),
        ),
        Positions::Double => (DVec3::new(double(0), double(8), double(16)), normal(24)),
    }
}

/// The bytes at `at`; zeros past the end.
fn word<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    bytes
        .get(at..at + N)
        .and_then(|b| b.try_into().ok())
        .unwrap_or([0; N])
}

/// Positions and normals as lines of a Wavefront OBJ file; writing into a string can't fail.
fn obj_vertices(text: &mut String, mesh: &Mesh) {
    for &p in &mesh.positions {
        let _ = if mesh.origin == DVec3::ZERO {
            writeln!(text, "v {} {} {}", p.x, p.y, p.z)
        } else {
            let p = mesh.in_world(p);
            writeln!(text, "v {} {} {}", p.x, p.y, p.z)
        };
    }
    for n in &mesh.normals {
        let _ = writeln!(text, "vn {} {} {}", n.x, n.y, n.z);
    }
}

/// Writes a Wavefront OBJ file without texture coordinates.
pub fn write_plain_obj(path: &Path, mesh: &Mesh) -> io::Result<()> {
    let mut text = String::from("# written by rekindle\n");
    obj_vertices(&mut text, mesh);
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| i + 1);
        let _ = writeln!(text, "f {a}//{a} {b}//{b} {c}//{c}");
    }
    fs::write(path, text)
}

/// Writes a Wavefront OBJ file that begins with the lines `head`.
pub fn write_obj(path: &Path, head: &str, mesh: &Mesh, corner_uvs: &[[Vec2; 3]]) -> io::Result<()> {
    let mut text = head.to_owned();
    obj_vertices(&mut text, mesh);
    for uv in corner_uvs.iter().flatten() {
        let _ = writeln!(text, "vt {} {}", uv.x, uv.y);
    }
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let [a, b, c] = triangle.map(|i| i + 1);
        let uv = 3 * t + 1;
        let _ = writeln!(text, "f {a}/{uv}/{a} {b}/{}/{b} {c}/{}/{c}", uv + 1, uv + 2);
    }
    fs::write(path, text)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> (Mesh, Vec<[Vec2; 3]>) {
        let mesh = Mesh {
            origin: DVec3::ZERO,
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(0.1, 0.7, 1e-9)],
            normals: vec![Vec3::Z; 3],
            uvs: Vec::new(),
            triangles: vec![[0, 1, 2]],
        };
        (mesh, vec![[Vec2::ZERO, Vec2::X, Vec2::new(0.3, 0.1)]])
    }

    #[test]
    fn a_mesh_comes_back_exactly() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh.ply");
        let (mesh, uvs) = example();
        write_ply(&path, &mesh, &uvs).unwrap();
        let read = read_ply(&path).unwrap();
        assert_eq!(read.mesh.positions, mesh.positions);
        assert_eq!(read.mesh.triangles, mesh.triangles);
        assert_eq!(read.corner_uvs, uvs);
    }

    #[test]
    fn broken_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh.ply");
        let (mut mesh, uvs) = example();
        write_ply(&path, &mesh, &uvs).unwrap();
        let whole = fs::read(&path).unwrap();
        fs::write(&path, &whole[..whole.len() - 5]).unwrap();
        assert!(read_ply(&path).unwrap_err().contains("cut short"));
        mesh.triangles[0][1] = 7;
        write_ply(&path, &mesh, &uvs).unwrap();
        assert!(read_ply(&path).unwrap_err().contains("out of range"));
    }
}
