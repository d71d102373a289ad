//! The object as binary glTF 2.0: mesh, base colour, roughness, lamps and cameras in one file.
//!
//! What glTF has no word for is in `extras`: σ, m and F₀ of the material, the angle of a lamp. Light from everywhere is in
//! the maps beside it. Lights are in units of the base colour's light, not in lux: `intensity` is the irradiance that
//! multiplies base colour / π.

use std::collections::HashMap;

use glam::{Quat, Vec2, Vec3};
use serde_json::{Map, Value, json};

use super::asset::Asset;
use super::light_list::{ListedLamp, listed};
use rekindle_capture::{Camera, Mesh};

/// glTF's numbers for types of components and uses of buffers.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;
/// The chunks of a GLB file.
const JSON_CHUNK: u32 = 0x4E4F_534A;
const BINARY_CHUNK: u32 = 0x004E_4942;

/// A mesh with one texture coordinate per vertex: vertices on seams are doubled.
struct Vertices {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    /// v downwards.
    uvs: Vec<Vec2>,
    indices: Vec<u32>,
}

impl Vertices {
    fn new(mesh: &Mesh, corner_uvs: &[[Vec2; 3]]) -> Self {
        let mut known: HashMap<(u32, [u32; 2]), u32> = HashMap::new();
        let mut all = Self {
            positions: Vec::new(),
            normals: Vec::new(),
            uvs: Vec::new(),
            indices: Vec::new(),
        };
        for (triangle, uvs) in mesh.triangles.iter().zip(corner_uvs) {
            for (&vertex, uv) in triangle.iter().zip(uvs) {
                let key = (vertex, uv.to_array().map(f32::to_bits));
                let index = *known.entry(key).or_insert_with(|| {
                    all.positions.push(mesh.positions[vertex as usize]);
                    all.normals.push(mesh.normals[vertex as usize]);
                    all.uvs.push(Vec2::new(uv.x, 1.0 - uv.y));
                    all.positions.len() as u32 - 1
                });
                all.indices.push(index);
            }
        }
        all
    }
}

/// The binary part with the views into it.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Adds bytes; returns the view's index.
    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        let mut view = json!({
            "buffer": 0,
            "byteOffset": self.bytes.len(),
            "byteLength": bytes.len(),
        });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.bytes.extend_from_slice(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(view);
        self.views.len() - 1
    }

    fn accessor(&mut self, bytes: &[u8], target: u32, mut accessor: Value) -> usize {
        accessor["bufferView"] = json!(self.view(bytes, Some(target)));
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn vectors(&mut self, vectors: &[Vec3], bounds: bool) -> usize {
        let mut accessor =
            json!({ "componentType": FLOAT, "count": vectors.len(), "type": "VEC3" });
        if bounds {
            let least = vectors.iter().copied().fold(Vec3::INFINITY, Vec3::min);
            let most = vectors.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
            accessor["min"] = json!(least.to_array());
            accessor["max"] = json!(most.to_array());
        }
        let bytes = little_endian(vectors.iter().flat_map(Vec3::to_array).map(f32::to_bits));
        self.accessor(&bytes, ARRAY_BUFFER, accessor)
    }
}

fn little_endian(words: impl Iterator<Item = u32>) -> Vec<u8> {
    words.flat_map(u32::to_le_bytes).collect()
}

/// The file's bytes; `base_colour` is the texture as PNG, and where parts differ there follow in `gloss` that of roughness and specular
/// level, and that of the specular colour where these differ too.
pub fn glb(asset: &Asset, base_colour: &[u8], gloss: &[Vec<u8>]) -> Vec<u8> {
    let vertices = Vertices::new(&asset.mesh, &asset.uvs);
    let mut buffer = Buffer::default();
    let positions = buffer.vectors(&vertices.positions, true);
    let normals = buffer.vectors(&vertices.normals, false);
    let uv_bytes = little_endian(
        vertices
            .uvs
            .iter()
            .flat_map(Vec2::to_array)
            .map(f32::to_bits),
    );
    let uvs = buffer.accessor(
        &uv_bytes,
        ARRAY_BUFFER,
        json!({ "componentType": FLOAT, "count": vertices.uvs.len(), "type": "VEC2" }),
    );
    let indices = buffer.accessor(
        &little_endian(vertices.indices.iter().copied()),
        ELEMENT_ARRAY_BUFFER,
        json!({ "componentType": UNSIGNED_INT, "count": vertices.indices.len(), "type": "SCALAR" }),
    );
    let images: Vec<usize> = std::iter::once(base_colour)
        .chain(gloss.iter().map(Vec::as_slice))
        .map(|image| buffer.view(image, None))
        .collect();
    let lamps = listed(asset);
    let mut nodes = vec![json!({ "name": asset.name, "mesh": 0 })];
    nodes.extend(lamps.iter().enumerate().map(|(i, lamp)| lamp_node(i, lamp)));
    nodes.extend(
        asset
            .cameras
            .iter()
            .enumerate()
            .map(|(i, c)| camera_node(i, c)),
    );
    let mut root = json!({
        "asset": { "version": "2.0", "generator": "rekindle" },
        "scene": 0,
        "scenes": [{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }],
        "nodes": nodes,
        "meshes": [{ "name": asset.name, "primitives": [{
            "attributes": { "POSITION": positions, "NORMAL": normals, "TEXCOORD_0": uvs },
            "indices": indices,
            "material": 0,
        }] }],
        "materials": [material(asset)],
        "textures": (0..images.len()).map(|k| json!({ "source": k, "sampler": 0 })).collect::<Vec<_>>(),
        // Linear filtering without smaller copies, which would mix neighbouring charts; clamped at the edge.
        "samplers": [{ "magFilter": 9729, "minFilter": 9729, "wrapS": 33071, "wrapT": 33071 }],
        "images": images.iter().map(|view| json!({ "bufferView": view, "mimeType": "image/png" })).collect::<Vec<_>>(),
        "buffers": [{ "byteLength": buffer.bytes.len() }],
        "bufferViews": buffer.views,
        "accessors": buffer.accessors,
    });
    let mut used = vec!["KHR_materials_ior"];
    if !lamps.is_empty() {
        used.push("KHR_lights_punctual");
        let lights: Vec<Value> = lamps.iter().map(light).collect();
        root["extensions"] = json!({ "KHR_lights_punctual": { "lights": lights } });
    }
    if asset.material.model.is_none() || asset.gloss.is_some() {
        used.push("KHR_materials_specular");
    }
    if !asset.cameras.is_empty() {
        root["cameras"] = asset.cameras.iter().map(|(_, c)| camera(c)).collect();
    }
    root["extensionsUsed"] = json!(used);
    assemble(&root, &buffer.bytes)
}

fn material(asset: &Asset) -> Value {
    let material = &asset.material;
    let mut extensions = Map::new();
    let index = asset.strongest().refractive_index();
    extensions.insert("KHR_materials_ior".to_owned(), json!({ "ior": index }));
    if material.model.is_none() {
        let none = json!({ "specularFactor": 0.0 });
        extensions.insert("KHR_materials_specular".to_owned(), none);
    }
    let mut reflection = json!({
        "baseColorTexture": { "index": 0 },
        "metallicFactor": 0.0,
        "roughnessFactor": material.roughness(),
    });
    if asset.gloss.is_some() {
        reflection["roughnessFactor"] = json!(1.0);
        reflection["metallicRoughnessTexture"] = json!({ "index": 1 });
        let mut levels = json!({ "specularTexture": { "index": 1 } });
        if asset.is_coloured() {
            levels["specularColorTexture"] = json!({ "index": 2 });
        }
        extensions.insert("KHR_materials_specular".to_owned(), levels);
    }
    json!({
        "name": asset.name,
        "pbrMetallicRoughness": reflection,
        "extensions": extensions,
        "extras": {
            "sigma": material.sigma,
            "alpha": material.alpha(),
            "f0": material.f0,
            "k_s": material.specular_scale,
        },
    })
}

/// A lamp as punctual light: directional, or a point of the same radiant intensity where it is near.
fn light(lamp: &ListedLamp) -> Value {
    let (colour, strength) = lamp.colour_and_strength();
    let (kind, intensity) = match lamp.distance {
        None => ("directional", strength),
        Some(distance) => ("point", strength * distance * distance),
    };
    json!({
        "name": lamp.name,
        "type": kind,
        "color": colour,
        "intensity": intensity,
        "extras": { "angular_radius_deg": lamp.angular_radius.to_degrees() },
    })
}

fn lamp_node(index: usize, lamp: &ListedLamp) -> Value {
    // Lights shine along −Z.
    let turn = Quat::from_rotation_arc(Vec3::Z, lamp.direction);
    json!({
        "name": lamp.name,
        "rotation": turn.to_array(),
        "translation": lamp.position.unwrap_or(lamp.direction).to_array(),
        "extensions": { "KHR_lights_punctual": { "light": index } },
    })
}

fn camera(camera: &Camera) -> Value {
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    json!({
        "type": "perspective",
        "perspective": {
            "yfov": 2.0 * (0.5 * height / camera.focal.y).atan(),
            "aspectRatio": width / height * camera.focal.y / camera.focal.x,
            "znear": 1e-3,
        },
    })
}

fn camera_node(index: usize, (name, camera): &(String, Camera)) -> Value {
    let pose = camera.world_from_camera;
    let turn = glam::DQuat::from_mat3(&pose.matrix3).normalize();
    json!({
        "name": name,
        "camera": index,
        "rotation": turn.to_array(),
        "translation": pose.translation.to_array(),
    })
}

/// Header and chunks: the JSON filled up with spaces, the binary part with zeros.
fn assemble(root: &Value, binary: &[u8]) -> Vec<u8> {
    let mut text = root.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + text.len() + 8 + binary.len();
    let mut bytes = Vec::with_capacity(total);
    bytes.extend_from_slice(b"glTF");
    bytes.extend(little_endian([2, total as u32].into_iter()));
    for (kind, chunk) in [(JSON_CHUNK, text.as_slice()), (BINARY_CHUNK, binary)] {
        bytes.extend(little_endian([chunk.len() as u32, kind].into_iter()));
        bytes.extend_from_slice(chunk);
    }
    bytes
}
