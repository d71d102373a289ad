//! Finding and reading the mesh file, and making it fit to use: every vertex gets a unit normal.

use super::error::CaptureError;
use super::mesh::{Mesh, normals_moved_by};
use super::{gltf, obj, ply};
use glam::{DMat4, DVec3, Vec2, Vec3};
use rekindle_base::files;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Distance of an object from the world's origin, in its own sizes, beyond which single precision loses digits that a camera
/// could tell: 16 sizes away it resolves a millionth of the size.
const FAR: f64 = 16.0;

/// A mesh as its file has it.
#[derive(Debug, Default)]
pub(super) struct RawMesh {
    /// One finite position per vertex.
    pub positions: Vec<DVec3>,
    /// One normal per vertex, of any length, zero where the file has none.
    pub normals: Vec<Vec3>,
    /// One texture coordinate per vertex, NaN where the file has none, or empty.
    pub uvs: Vec<Vec2>,
    /// Triangles with indices in range.
    pub triangles: Vec<[u32; 3]>,
}

impl RawMesh {
    fn transform(&mut self, transform: &DMat4) {
        for position in &mut self.positions {
            *position = transform.transform_point3(*position);
        }
        let turned = normals_moved_by(transform);
        for normal in &mut self.normals {
            *normal = turned(*normal);
        }
    }
}

/// Where single precision is to count from: the world's own origin, or for an object far from it a round number near its
/// centre, so that what is written and read again has the same.
fn origin(raw: &RawMesh) -> DVec3 {
    let used = raw
        .triangles
        .iter()
        .flatten()
        .map(|&v| raw.positions[v as usize]);
    origin_near(used)
}

/// The origin for points: see [`Mesh::origin`].
pub fn origin_near(points: impl Iterator<Item = DVec3>) -> DVec3 {
    let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (low, high) = points.fold(none, |(low, high), p| (low.min(p), high.max(p)));
    let (centre, extent) = (0.5 * (low + high), (high - low).length());
    if !(extent > 0.0 && extent.is_finite() && centre.length() > FAR * extent) {
        return DVec3::ZERO;
    }
    let unit = extent.log2().floor().exp2();
    (centre / unit).round() * unit
}

/// The file that holds the mesh: the one named, or the only one in the folder.
pub(super) fn find(
    folder: &Path,
    named: Option<&str>,
    manifest: &Path,
) -> Result<PathBuf, CaptureError> {
    if let Some(name) = named {
        let plain = folder.join(name.strip_prefix("./").unwrap_or(name));
        let turned = folder.join(name.replace('\\', "/"));
        return [plain.clone(), turned]
            .into_iter()
            .find(|path| path.is_file())
            .ok_or_else(|| CaptureError::MeshMissing {
                path: plain,
                problem: "no such mesh".to_owned(),
                advice: format!(
                    "put it there or correct mesh_path in {}",
                    manifest.display()
                ),
            });
    }
    let missing = |problem: String, advice: &str| CaptureError::MeshMissing {
        path: folder.to_owned(),
        problem,
        advice: advice.to_owned(),
    };
    let entries = std::fs::read_dir(folder).map_err(|source| CaptureError::Unreadable {
        path: folder.to_owned(),
        source,
    })?;
    let mut found: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| match extension(path).as_str() {
            "obj" | "glb" | "gltf" => true,
            // nerfstudio leaves sparse point clouds beside the manifest.
            "ply" => ply::has_faces(path),
            _ => false,
        })
        .collect();
    found.sort();
    match found.as_slice() {
        [only] => Ok(only.clone()),
        [] => Err(missing(
            "no mesh in this folder".to_owned(),
            "add the object's mesh as OBJ, PLY or GLB and name it by mesh_path",
        )),
        several => {
            let names: Vec<_> = several
                .iter()
                .filter_map(|path| Some(path.file_name()?.to_string_lossy().into_owned()))
                .collect();
            Err(missing(
                format!("several meshes in this folder ({})", names.join(", ")),
                "name the right one by mesh_path in transforms.json",
            ))
        }
    }
}

fn extension(path: &Path) -> String {
    path.extension()
        .map(|e| e.to_string_lossy().to_lowercase())
        .unwrap_or_default()
}

/// Reads a mesh file and moves the mesh by a transform, which is not to mirror. Returns the mesh and what a user should know
/// of it.
pub(super) fn read(
    path: &Path,
    transform: Option<&DMat4>,
) -> Result<(Mesh, Vec<String>), CaptureError> {
    let kind = extension(path);
    let parse = match kind.as_str() {
        "obj" => obj::parse,
        "ply" => ply::parse,
        "glb" | "gltf" => gltf::parse,
        _ => {
            return Err(CaptureError::MeshMissing {
                path: path.to_owned(),
                problem: "not a mesh format known here".to_owned(),
                advice: "export the mesh as OBJ, PLY, GLB or glTF".to_owned(),
            });
        }
    };
    let bytes = files::read(path).map_err(|source| CaptureError::Unreadable {
        path: path.to_owned(),
        source,
    })?;
    let mut raw = parse(path, &bytes)?;
    if let Some(transform) = transform {
        raw.transform(transform);
    }
    finish(path, raw)
}

/// Drops degenerate triangles, repairs normals and texture coordinates.
pub(super) fn finish(path: &Path, raw: RawMesh) -> Result<(Mesh, Vec<String>), CaptureError> {
    let mut warnings = Vec::new();
    let origin = origin(&raw);
    let positions = raw.positions.iter();
    let mut mesh = Mesh {
        origin,
        positions: positions.map(|&p| (p - origin).as_vec3()).collect(),
        normals: raw.normals,
        uvs: raw.uvs,
        triangles: raw.triangles,
    };
    let stated = mesh.triangles.len();
    let positions = &mesh.positions;
    mesh.triangles.retain(|t| {
        let [a, b, c] = t.map(|v| positions[v as usize].as_dvec3());
        (b - a).cross(c - a).length_squared() > 0.0
    });
    let dropped = stated - mesh.triangles.len();
    if mesh.triangles.is_empty() {
        return Err(CaptureError::MeshEmpty {
            path: path.to_owned(),
            problem: if stated == 0 {
                format!("it has {} vertices but no faces", mesh.positions.len())
            } else {
                format!("all of its {stated} triangles have zero area")
            },
        });
    }
    if dropped > 0 {
        warnings.push(format!(
            "The mesh has {dropped} triangles of zero area, which were left out."
        ));
    }
    let repeated = drop_repeated(&mut mesh);
    if repeated > 0 {
        warnings.push(format!(
            "The mesh has {repeated} triangles that repeat others, which were left out."
        ));
    }
    if mesh.uvs.iter().any(|uv| !uv.is_finite()) {
        warnings
            .push("Texture coordinates of the mesh are incomplete and were left out.".to_owned());
        mesh.uvs.clear();
    }
    warnings.extend(orient(&mut mesh).map(str::to_owned));
    let computed = repair_normals(&mut mesh);
    if computed == mesh.positions.len() {
        warnings
            .push("The mesh has no normals; smooth ones were computed from its faces.".to_owned());
    } else if computed > 0 {
        warnings.push(format!(
            "{computed} vertex normals of the mesh were missing or unusable and were computed from its faces."
        ));
    }
    Ok((mesh, warnings))
}

/// Drops triangles that are where another one is, wound the same way: every ray through one would try them all. Returns how
/// many they were.
fn drop_repeated(mesh: &mut Mesh) -> usize {
    let places = mesh.places();
    let stated = mesh.triangles.len();
    let mut there = HashSet::with_capacity(stated);
    mesh.triangles.retain(|triangle| {
        let mut corners = triangle.map(|v| places[v as usize]);
        let first = (0..3).min_by_key(|&k| corners[k]).unwrap_or(0);
        corners.rotate_left(first);
        there.insert(corners)
    });
    stated - mesh.triangles.len()
}

/// Turns triangles and normals outwards where the whole mesh has them the wrong way round: a closed surface that
/// encloses a negative volume is inside out, and triangles wound against the normals follow the normals. Returns
/// what was done.
fn orient(mesh: &mut Mesh) -> Option<&'static str> {
    let centre = mesh.centre().as_dvec3();
    let (mut area, mut agreeing, mut volume, mut sum) = (0.0, 0.0, 0.0, glam::DVec3::ZERO);
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| mesh.positions[v as usize].as_dvec3() - centre);
        let normal = (b - a).cross(c - a);
        let shading: glam::DVec3 = triangle
            .iter()
            .filter_map(|&v| mesh.normals.get(v as usize))
            .map(|n| n.as_dvec3())
            .sum();
        area += normal.length();
        sum += normal;
        volume += a.dot(b.cross(c));
        agreeing += normal.length() * f64::from(u8::from(normal.dot(shading) > 0.0));
    }
    let closed = sum.length() < 1e-3 * area;
    let inside_out = closed && volume < 0.0;
    let has_normals = mesh.normals.iter().any(|n| *n != Vec3::ZERO);
    let against = has_normals && agreeing < 0.1 * area;
    let with = has_normals && agreeing > 0.9 * area;
    if inside_out || (against && !closed) {
        for triangle in &mut mesh.triangles {
            triangle.swap(1, 2);
        }
    }
    if (inside_out && with) || (closed && !inside_out && against) {
        for normal in &mut mesh.normals {
            *normal = -*normal;
        }
    }
    match (inside_out, against) {
        (true, _) => Some("The mesh was inside out; its triangles were turned to face outwards."),
        (false, true) if closed => {
            Some("The mesh's normals pointed inwards and were turned round.")
        }
        (false, true) => {
            Some("The mesh's triangles were wound against its normals and were turned round.")
        }
        (false, false) => None,
    }
}

/// Makes every normal unit length; where there is none, the mean of the adjacent face normals weighted by
/// the angle at the vertex. Vertices at the same position share their faces, so that texture seams stay
/// smooth. Returns how many normals were computed.
fn repair_normals(mesh: &mut Mesh) -> usize {
    mesh.normals.resize(mesh.positions.len(), Vec3::ZERO);
    for normal in &mut mesh.normals {
        *normal = normal
            .as_dvec3()
            .try_normalize()
            .map_or(Vec3::ZERO, glam::DVec3::as_vec3);
    }
    let computed = mesh.normals.iter().filter(|n| **n == Vec3::ZERO).count();
    if computed == 0 {
        return 0;
    }
    let places = mesh.places();
    let mut sums = vec![glam::DVec3::ZERO; mesh.positions.len()];
    for triangle in &mesh.triangles {
        let p = triangle.map(|v| mesh.positions[v as usize].as_dvec3());
        let face = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or_zero();
        for corner in 0..3 {
            let (here, next, last) = (p[corner], p[(corner + 1) % 3], p[(corner + 2) % 3]);
            let angle = (next - here).angle_between(last - here);
            if angle.is_finite() {
                sums[places[triangle[corner] as usize] as usize] += angle * face;
            }
        }
    }
    for (normal, &place) in mesh.normals.iter_mut().zip(&places) {
        if *normal == Vec3::ZERO {
            let sum = sums[place as usize].try_normalize();
            // Vertices without faces are never looked at, but a unit vector keeps the promise.
            *normal = sum.map_or(Vec3::Y, glam::DVec3::as_vec3);
        }
    }
    computed
}
