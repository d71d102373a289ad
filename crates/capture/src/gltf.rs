//! glTF 2.0 and GLB: all triangles of the scene as one mesh, nodes' transforms applied.
//!
//! Only what makes up the surface is read: positions, normals, the first texture coordinates and indices, of any component
//! type. Materials, skins and morph targets are passed over; compressed geometry is refused. Nothing is allocated beyond
//! what the file's bytes can fill, but for nodes that repeat a mesh, which are limited.

use super::error::CaptureError;
use super::mesh_file::RawMesh;
use glam::{DMat3, DMat4, DQuat, DVec3, Vec2, Vec3};
use rekindle_base::files;
use serde::Deserialize;
use std::io::ErrorKind;
use std::path::{Component, Path};

/// How every GLB file starts.
const MAGIC: &[u8] = b"glTF";
/// Most vertices and triangles that repeated meshes may make.
const MOST: usize = 100_000_000;
/// Extensions without which a mesh can't be read, and what they are.
const COMPRESSIONS: [(&str, &str); 3] = [
    ("KHR_draco_mesh_compression", "Draco"),
    ("EXT_meshopt_compression", "meshopt"),
    ("KHR_meshopt_compression", "meshopt"),
];

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", default)]
struct Document {
    scene: Option<usize>,
    scenes: Vec<Scene>,
    nodes: Vec<Node>,
    meshes: Vec<MeshEntry>,
    accessors: Vec<Accessor>,
    buffer_views: Vec<View>,
    buffers: Vec<Buffer>,
    extensions_required: Vec<String>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct Scene {
    nodes: Vec<usize>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct Node {
    mesh: Option<usize>,
    children: Vec<usize>,
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct MeshEntry {
    primitives: Vec<Primitive>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct Primitive {
    attributes: Attributes,
    indices: Option<usize>,
    mode: Option<u32>,
    extensions: serde_json::Map<String, serde_json::Value>,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE", default)]
struct Attributes {
    position: Option<usize>,
    normal: Option<usize>,
    #[serde(rename = "TEXCOORD_0")]
    uv: Option<usize>,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", default)]
struct Accessor {
    buffer_view: Option<usize>,
    byte_offset: usize,
    component_type: u32,
    normalized: bool,
    count: usize,
    #[serde(rename = "type")]
    kind: String,
    sparse: Option<serde_json::Value>,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", default)]
struct View {
    buffer: usize,
    byte_offset: usize,
    byte_length: usize,
    byte_stride: Option<usize>,
    extensions: serde_json::Map<String, serde_json::Value>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct Buffer {
    uri: Option<String>,
}

/// Where something is wrong, and what.
type Mistake = (String, String);

fn mistake(place: impl Into<String>, problem: impl Into<String>) -> Mistake {
    (place.into(), problem.into())
}

/// Parses the bytes of the glTF or GLB file `path`; buffers in files of their own are read from its folder.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<RawMesh, CaptureError> {
    let broken = |(place, problem): Mistake| CaptureError::MeshBroken {
        path: path.to_owned(),
        place,
        problem,
    };
    let (json, binary) = chunks(bytes).map_err(broken)?;
    let document: Document =
        serde_json::from_slice(json).map_err(|error| broken(mistake("JSON", error.to_string())))?;
    if let Some(kind) = compression(&document) {
        return Err(CaptureError::MeshMissing {
            path: path.to_owned(),
            problem: format!("its geometry is compressed ({kind})"),
            advice: "export it without compression of meshes".to_owned(),
        });
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let buffers = document
        .buffers
        .iter()
        .enumerate()
        .map(|(i, buffer)| match &buffer.uri {
            None => Ok(binary.unwrap_or_default().to_vec()),
            Some(uri) => {
                load(folder, uri).map_err(|problem| mistake(format!("buffers[{i}]"), problem))
            }
        });
    let buffers = buffers.collect::<Result<Vec<_>, _>>().map_err(broken)?;
    let mut builder = Builder {
        document: &document,
        buffers: &buffers,
        mesh: RawMesh::default(),
    };
    builder.add_scene().map_err(broken)?;
    if builder.mesh.triangles.is_empty() {
        return Err(CaptureError::MeshEmpty {
            path: path.to_owned(),
            problem: format!(
                "its scene has {} nodes but no triangles",
                document.nodes.len()
            ),
        });
    }
    let mut mesh = builder.mesh;
    if mesh.uvs.iter().all(|uv| uv.is_nan()) {
        mesh.uvs.clear();
    }
    Ok(mesh)
}

/// The JSON and the binary chunk of a GLB file, or all of a text file.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), Mistake> {
    if !bytes.starts_with(MAGIC) {
        return Ok((bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes), None));
    }
    let word = |at: usize| {
        let bytes = bytes.get(at..at + 4)?;
        Some(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    };
    if word(4) != Some(2) {
        return Err(mistake("header", "only version 2 of glTF is understood"));
    }
    let (mut json, mut binary) = (None, None);
    let mut at = 12;
    while let (Some(length), Some(kind)) = (word(at), word(at + 4)) {
        let start = at + 8;
        let end = start.checked_add(length as usize);
        let chunk = end.and_then(|end| bytes.get(start..end));
        let chunk = chunk.ok_or_else(|| mistake("header", "the file ends too early"))?;
        match kind {
            0x4e4f_534a => json = json.or(Some(chunk)),
            0x004e_4942 => binary = binary.or(Some(chunk)),
            _ => {}
        }
        at = start + length as usize;
    }
    let json = json.ok_or_else(|| mistake("header", "it has no JSON chunk"))?;
    Ok((json, binary))
}

/// What compresses the geometry, if anything does.
fn compression(document: &Document) -> Option<&'static str> {
    let primitives = document.meshes.iter().flat_map(|mesh| &mesh.primitives);
    let in_primitives = primitives.flat_map(|p| p.extensions.keys());
    let in_views = document
        .buffer_views
        .iter()
        .flat_map(|v| v.extensions.keys());
    let all = document
        .extensions_required
        .iter()
        .chain(in_primitives)
        .chain(in_views);
    all.filter_map(|name| COMPRESSIONS.iter().find(|(known, _)| known == name))
        .map(|(_, kind)| *kind)
        .next()
}

/// The bytes that a URI names: in it, or a file.
fn load(folder: &Path, uri: &str) -> Result<Vec<u8>, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, text) = data
            .split_once(";base64,")
            .ok_or("a data URI that is not base64")?;
        return base64(text).ok_or_else(|| "broken base64".to_owned());
    }
    let name = percent_decoded(uri);
    if leads_out(Path::new(&name)) {
        return Err(format!(
            "{name} is not in the folder of the mesh, so it is not read; put it beside the mesh"
        ));
    }
    files::read(&folder.join(&name)).map_err(|error| match error.kind() {
        ErrorKind::NotFound => format!("{name} can't be read: there is no such file"),
        _ => format!("{name} can't be read: {error}"),
    })
}

/// Whether a path leaves the folder that it begins in, though it may come back.
fn leads_out(path: &Path) -> bool {
    let mut depth = 0_usize;
    !path.components().all(|component| match component {
        Component::Normal(_) => {
            depth += 1;
            true
        }
        Component::CurDir => true,
        Component::ParentDir if depth > 0 => {
            depth -= 1;
            true
        }
        Component::ParentDir | Component::RootDir | Component::Prefix(_) => false,
    })
}

fn base64(text: &str) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(text.len() / 4 * 3);
    let (mut bits, mut count) = (0_u32, 0);
    for byte in text
        .bytes()
        .filter(|b| !b.is_ascii_whitespace() && *b != b'=')
    {
        let value = match byte {
            b'A'..=b'Z' => byte - b'A',
            b'a'..=b'z' => byte - b'a' + 26,
            b'0'..=b'9' => byte - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            _ => return None,
        };
        bits = bits << 6 | u32::from(value);
        count += 6;
        if count >= 8 {
            count -= 8;
            out.push((bits >> count) as u8);
        }
    }
    Some(out)
}

fn percent_decoded(uri: &str) -> String {
    let bytes = uri.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        let code = bytes
            .get(at + 1..at + 3)
            .and_then(|hex| std::str::from_utf8(hex).ok());
        let code = code.and_then(|hex| u8::from_str_radix(hex, 16).ok());
        let encoded = code.filter(|_| bytes[at] == b'%');
        out.push(encoded.unwrap_or(bytes[at]));
        at += if encoded.is_some() { 3 } else { 1 };
    }
    String::from_utf8_lossy(&out).into_owned()
}

impl Node {
    fn transform(&self) -> DMat4 {
        if let Some(matrix) = &self.matrix {
            return DMat4::from_cols_array(matrix);
        }
        let rotation = self.rotation.map_or(DQuat::IDENTITY, DQuat::from_array);
        DMat4::from_scale_rotation_translation(
            DVec3::from(self.scale.unwrap_or([1.0; 3])),
            if rotation.length_squared() > 0.0 {
                rotation.normalize()
            } else {
                DQuat::IDENTITY
            },
            DVec3::from(self.translation.unwrap_or_default()),
        )
    }
}

struct Builder<'a> {
    document: &'a Document,
    buffers: &'a [Vec<u8>],
    mesh: RawMesh,
}

impl Builder<'_> {
    /// Adds the meshes of the scene that is shown, or of all nodes where there is no scene.
    fn add_scene(&mut self) -> Result<(), Mistake> {
        let document = self.document;
        let roots: Vec<usize> = match document.scenes.get(document.scene.unwrap_or(0)) {
            Some(scene) => scene.nodes.clone(),
            None => (0..document.nodes.len())
                .filter(|&i| !document.nodes.iter().any(|node| node.children.contains(&i)))
                .collect(),
        };
        let mut visited = vec![false; document.nodes.len()];
        let mut stack: Vec<(usize, DMat4)> =
            roots.into_iter().map(|i| (i, DMat4::IDENTITY)).collect();
        while let Some((i, parent)) = stack.pop() {
            let node = document.nodes.get(i);
            let node =
                node.ok_or_else(|| mistake(format!("nodes[{i}]"), "there is no such node"))?;
            if std::mem::replace(&mut visited[i], true) {
                return Err(mistake(format!("nodes[{i}]"), "it has two parents"));
            }
            let transform = parent * node.transform();
            stack.extend(node.children.iter().map(|&child| (child, transform)));
            if let Some(mesh) = node.mesh {
                self.add_mesh(mesh, transform)?;
            }
        }
        Ok(())
    }

    fn add_mesh(&mut self, index: usize, transform: DMat4) -> Result<(), Mistake> {
        let mesh = self.document.meshes.get(index);
        let mesh =
            mesh.ok_or_else(|| mistake(format!("meshes[{index}]"), "there is no such mesh"))?;
        for (k, primitive) in mesh.primitives.iter().enumerate() {
            let place = format!("meshes[{index}].primitives[{k}]");
            let mode = primitive.mode.unwrap_or(4);
            // Points and lines have no surface.
            if !(4..=6).contains(&mode) {
                continue;
            }
            self.add_primitive(primitive, mode, transform)
                .map_err(|problem| mistake(place, problem))?;
        }
        Ok(())
    }

    fn add_primitive(
        &mut self,
        primitive: &Primitive,
        mode: u32,
        transform: DMat4,
    ) -> Result<(), String> {
        let attributes = &primitive.attributes;
        let positions = attributes.position.ok_or("it has no positions")?;
        let positions: Vec<[f32; 3]> = self.floats(positions)?;
        let count = positions.len();
        let first = self.mesh.positions.len();
        let corners: Vec<u32> = match primitive.indices {
            Some(accessor) => self.indices(accessor)?,
            None => (0..count as u32).collect(),
        };
        if first + count > MOST || self.mesh.triangles.len() + corners.len() > MOST {
            return Err("the scene repeats meshes until they are too many".to_owned());
        }
        if corners.iter().any(|&v| v as usize >= count) {
            return Err(format!(
                "an index is out of range: there are {count} vertices"
            ));
        }
        for (i, position) in positions.into_iter().enumerate() {
            let position = transform.transform_point3(Vec3::from(position).as_dvec3());
            if !position.as_vec3().is_finite() {
                return Err(format!("position {i} is NaN or not finite"));
            }
            self.mesh.positions.push(position);
        }
        let to_normal = DMat3::from_mat4(transform).inverse().transpose();
        let normals: Vec<[f32; 3]> = attributes
            .normal
            .map_or(Ok(Vec::new()), |a| self.floats(a))?;
        let uvs: Vec<[f32; 2]> = attributes.uv.map_or(Ok(Vec::new()), |a| self.floats(a))?;
        for i in 0..count {
            let normal = normals.get(i).map_or(Vec3::ZERO, |&n| {
                (to_normal * Vec3::from(n).as_dvec3()).as_vec3()
            });
            self.mesh.normals.push(if normal.is_finite() {
                normal
            } else {
                Vec3::ZERO
            });
            // v runs downwards in glTF.
            let uv = uvs
                .get(i)
                .map_or(Vec2::NAN, |&[u, v]| Vec2::new(u, 1.0 - v));
            self.mesh.uvs.push(uv);
        }
        let mirrored = DMat3::from_mat4(transform).determinant() < 0.0;
        let base = first as u32;
        let triangles = triangles(&corners, mode);
        self.mesh.triangles.extend(triangles.map(|[a, b, c]| {
            let [b, c] = if mirrored { [c, b] } else { [b, c] };
            [base + a, base + b, base + c]
        }));
        Ok(())
    }

    /// Bytes of each element of an accessor, its component's type and how many components it has.
    fn elements(&self, index: usize) -> Result<(Vec<&[u8]>, &Accessor, usize), String> {
        let accessor = self.document.accessors.get(index);
        let accessor = accessor.ok_or_else(|| format!("there is no accessor {index}"))?;
        let bad = |problem: &str| format!("accessor {index} {problem}");
        if accessor.sparse.is_some() {
            return Err(bad("is sparse; export plain meshes"));
        }
        let view = accessor
            .buffer_view
            .and_then(|v| self.document.buffer_views.get(v));
        let view = view.ok_or_else(|| bad("has no buffer view"))?;
        let size = match accessor.component_type {
            5120 | 5121 => 1,
            5122 | 5123 => 2,
            5125 | 5126 => 4,
            other => return Err(bad(&format!("has component type {other}"))),
        };
        let components = match accessor.kind.as_str() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            other => return Err(bad(&format!("is of type '{other}'"))),
        };
        let early = || bad("reaches beyond its buffer");
        let buffer = self.buffers.get(view.buffer).ok_or_else(early)?;
        let end = view
            .byte_offset
            .checked_add(view.byte_length)
            .ok_or_else(early)?;
        let bytes = buffer.get(view.byte_offset..end).ok_or_else(early)?;
        let bytes = bytes.get(accessor.byte_offset..).ok_or_else(early)?;
        let width = size * components;
        let stride = view.byte_stride.unwrap_or(width).max(width);
        if accessor.count > 0 {
            let needed = (accessor.count - 1)
                .checked_mul(stride)
                .and_then(|n| n.checked_add(width));
            needed
                .filter(|&needed| needed <= bytes.len())
                .ok_or_else(early)?;
        }
        let elements = (0..accessor.count).map(|i| &bytes[i * stride..i * stride + width]);
        Ok((elements.collect(), accessor, size))
    }

    /// The elements of an accessor as N floats each, of which it has that many at least.
    fn floats<const N: usize>(&self, index: usize) -> Result<Vec<[f32; N]>, String> {
        let (elements, accessor, size) = self.elements(index)?;
        if elements.first().is_some_and(|bytes| bytes.len() < N * size) {
            return Err(format!("accessor {index} has less than {N} components"));
        }
        let value = |bytes: &[u8]| component(bytes, accessor.component_type, accessor.normalized);
        let element = |bytes: &[u8]| std::array::from_fn(|c| value(&bytes[c * size..]));
        Ok(elements.into_iter().map(element).collect())
    }

    fn indices(&self, index: usize) -> Result<Vec<u32>, String> {
        let (elements, accessor, _) = self.elements(index)?;
        let index = |bytes: &[u8]| match (accessor.component_type, bytes) {
            (5121, &[a, ..]) => u32::from(a),
            (5123, &[a, b, ..]) => u32::from(u16::from_le_bytes([a, b])),
            (5125, &[a, b, c, d, ..]) => u32::from_le_bytes([a, b, c, d]),
            _ => u32::MAX,
        };
        Ok(elements.into_iter().map(index).collect())
    }
}

/// The value of a component, normalised to [0, 1] or [−1, 1] if it is to be.
fn component(bytes: &[u8], kind: u32, normalized: bool) -> f32 {
    let (value, full) = match (kind, bytes) {
        (5120, &[a, ..]) => (f32::from(a as i8), 127.0),
        (5121, &[a, ..]) => (f32::from(a), 255.0),
        (5122, &[a, b, ..]) => (f32::from(i16::from_le_bytes([a, b])), 32_767.0),
        (5123, &[a, b, ..]) => (f32::from(u16::from_le_bytes([a, b])), 65_535.0),
        (5126, &[a, b, c, d, ..]) => return f32::from_le_bytes([a, b, c, d]),
        (5125, &[a, b, c, d, ..]) => return u32::from_le_bytes([a, b, c, d]) as f32,
        _ => (f32::NAN, 1.0),
    };
    if normalized {
        (value / full).max(-1.0)
    } else {
        value
    }
}

/// The triangles of a list, a strip or a fan.
fn triangles(corners: &[u32], mode: u32) -> Box<dyn Iterator<Item = [u32; 3]> + '_> {
    let threes = corners.windows(3);
    match mode {
        4 => Box::new(corners.chunks_exact(3).map(|t| [t[0], t[1], t[2]])),
        // Every other triangle of a strip is wound the other way.
        5 => Box::new(threes.enumerate().map(|(i, t)| {
            if i.is_multiple_of(2) {
                [t[0], t[1], t[2]]
            } else {
                [t[1], t[0], t[2]]
            }
        })),
        _ => Box::new(threes.map(|t| [corners[0], t[1], t[2]])),
    }
}
