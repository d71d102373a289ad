//! The captured object made ready for drawing: plain data on one side, its copy on the device on the other.

use std::sync::{Arc, OnceLock};

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};
use half::f16;
use rayon::prelude::*;

use super::error::RenderError;
use super::gpu::Gpu;
use super::shader;
use rekindle_base::math::GOLDEN_ANGLE;
use rekindle_capture::Mesh;
use rekindle_relight::{Interreflection, Lighting, Scene};
use rekindle_scene::reflectance::Gloss;
use rekindle_scene::surface::{Atlas, Occluder};
use rekindle_solution::Solution;

/// Texels that baked light has, about: some two to each pixel's side that the object takes in a picture of a thousand rows.
const LIGHT_TEXELS: f32 = 700_000.0;

/// A solution made ready for drawing. Making one takes about as long as reading the solution: do it beside the window's thread.
pub struct Surface {
    pub(super) solution: Arc<Solution>,
    pub(super) occluder: Occluder,
    /// Where baked light is stored: a texture of its own with an even density.
    pub(super) light_atlas: Atlas,
    /// The object's centre; positions on the device are relative to it.
    pub(super) centre: Vec3,
    /// Radius of a sphere about the centre that holds the object.
    pub(super) radius: f32,
    /// Radiance that is 1 on the device.
    pub(super) unit: f32,
    /// Pseudo-albedo that is 1 on the device.
    pub(super) albedo_unit: f32,
    /// The captured lighting.
    pub(super) original: Lighting,
    /// Per vertex the part of the sky that nothing hides, weighted by the cosine, 0 to 255: what is known of the visibility
    /// of any light before it is baked.
    pub(super) openness: Vec<u8>,
    /// Cast when the first light is baked.
    interreflection: OnceLock<Option<Interreflection>>,
}

/// Mirror of `Vertex` in `surface.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Default, Pod, Zeroable)]
struct GpuVertex {
    position: [f32; 3],
    openness: f32,
    normal: [f32; 3],
    pad2: u32,
}

/// Mirror of `Triangle` in `surface.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Default, Pod, Zeroable)]
struct GpuTriangle {
    corners: [u32; 3],
    pad: u32,
    /// Texture coordinates of the three corners, then those in the texture of baked light.
    uvs: [[f32; 2]; 6],
}

/// Mirror of `WalkNode` in `mirror.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Default, Pod, Zeroable)]
struct GpuWalkNode {
    low: [f32; 3],
    /// The next node for a ray that misses the box; of a leaf the first of its triangles.
    next: u32,
    high: [f32; 3],
    count: u32,
}

/// The surface's copy on the device.
pub(super) struct SurfaceBuffers {
    /// The hierarchy of the triangles for rays that the surface mirrors, and the list of triangles it refers to. Empty where
    /// nothing is mirrored, or where the device has no room for it.
    pub walk: wgpu::Buffer,
    pub walk_triangles: wgpu::Buffer,
    /// Number of the hierarchy's nodes.
    pub walk_nodes: u32,
    /// Binds vertices and triangles.
    pub group: wgpu::BindGroup,
    /// Three for each triangle.
    pub corners: u32,
    /// Stored diffuse radiance and, as alpha, its confidence.
    pub diffuse: wgpu::TextureView,
    pub albedo: wgpu::TextureView,
    /// Roughness and strength as multiples of the main lobe's; of one texel where there is one lobe for all.
    pub gloss: wgpu::TextureView,
}

/// Where shaders find the vertices and triangles.
pub(super) fn surface_layout(gpu: &Gpu) -> wgpu::BindGroupLayout {
    gpu.device()
        .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("surface"),
            entries: &[shader::storage(0), shader::storage(1)],
        })
}

impl Surface {
    /// Makes a solution ready.
    pub fn new(solution: Arc<Solution>) -> Self {
        Self::with_light_texels(solution, LIGHT_TEXELS)
    }

    /// The same with about so many texels for baked light.
    pub(super) fn with_light_texels(solution: Arc<Solution>, texels: f32) -> Self {
        let mesh = &solution.mesh;
        let (low, high) = mesh.bounds();
        let centre = if low.is_finite() && high.is_finite() {
            (low + high) * 0.5
        } else {
            Vec3::ZERO
        };
        let radius = (0.5 * (high - low).length()).max(f32::MIN_POSITIVE);
        let area: f32 = (0..mesh.triangles.len() as u32)
            .into_par_iter()
            .map(|t| {
                let [a, b, c] = mesh.corners(t);
                0.5 * (b - a).cross(c - a).length()
            })
            .collect::<Vec<f32>>()
            .iter()
            .sum();
        let density = (texels / area.max(f32::MIN_POSITIVE)).sqrt();
        let light_atlas = Atlas::lattice(mesh, &vec![density; mesh.triangles.len()]);
        let occluder = Occluder::new(mesh);
        Self {
            openness: openness(mesh, &occluder),
            occluder,
            light_atlas,
            centre,
            radius,
            unit: positive(solution.white()),
            albedo_unit: positive(solution.brightest(&solution.albedo)),
            original: solution.lighting(),
            interreflection: OnceLock::new(),
            solution,
        }
    }

    /// The solution.
    pub fn solution(&self) -> &Arc<Solution> {
        &self.solution
    }

    /// Radiance that is shown as white at an exposure of 0 stops.
    pub fn white(&self) -> f32 {
        self.unit
    }

    pub(super) fn interreflection(&self) -> Option<&Interreflection> {
        self.interreflection
            .get_or_init(|| {
                Interreflection::new(&self.solution.mesh, &self.occluder, self.solution.brdf)
            })
            .as_ref()
    }

    /// The object as the reference renderer has it; what it mirrors of itself is not baked.
    pub(super) fn scene(&self) -> Scene<'_> {
        Scene {
            mesh: &self.solution.mesh,
            occluder: &self.occluder,
            brdf: self.solution.brdf,
            gloss: self.solution.gloss_map(),
            surroundings: None,
        }
    }

    /// Irradiance per unit of irradiance on the device.
    pub(super) fn irradiance_unit(&self) -> f32 {
        self.unit / self.albedo_unit
    }

    /// Copies the surface to the device.
    pub(super) fn upload(
        &self,
        gpu: &Gpu,
        layout: &wgpu::BindGroupLayout,
    ) -> Result<SurfaceBuffers, RenderError> {
        let smaller = "decimate the mesh";
        let atlas = &self.solution.atlas;
        let size = [atlas.width, atlas.height];
        gpu.check_texture("the texture", size, smaller)?;
        gpu.check_texture(
            "the texture of baked light",
            [self.light_atlas.width, self.light_atlas.height],
            smaller,
        )?;
        let mesh = &self.solution.mesh;
        let vertices: Vec<GpuVertex> = mesh
            .positions
            .iter()
            .zip(&mesh.normals)
            .zip(&self.openness)
            .map(|((&position, normal), &openness)| GpuVertex {
                position: (position - self.centre).to_array(),
                openness: f32::from(openness) / 255.0,
                normal: normal.to_array(),
                ..GpuVertex::default()
            })
            .collect();
        let triangles = self.triangles();
        let storage = |what: &str, bytes: &[u8]| -> Result<wgpu::Buffer, RenderError> {
            let limits = gpu.device().limits();
            let (needed, allowed) = (
                bytes.len() as u64,
                limits
                    .max_storage_buffer_binding_size
                    .min(limits.max_buffer_size),
            );
            if needed > allowed {
                return Err(RenderError::Limit {
                    what: format!("the mesh's list of {what}, in bytes,"),
                    needed,
                    allowed,
                    advice: smaller,
                });
            }
            gpu.guarded("the surface", || {
                let buffer = gpu.buffer(what, needed, wgpu::BufferUsages::STORAGE);
                if !bytes.is_empty() {
                    gpu.queue().write_buffer(&buffer, 0, bytes);
                }
                buffer
            })
        };
        let vertices = storage("vertices", bytemuck::cast_slice(&vertices))?;
        let corners = 3 * triangles.len() as u32;
        let triangles = storage("triangles", bytemuck::cast_slice(&triangles))?;
        let (nodes, list) = self.mirror_walk();
        let fits = size_of_val(nodes.as_slice()) as u64
            <= gpu.device().limits().max_storage_buffer_binding_size;
        let (nodes, list) = if fits {
            (nodes, list)
        } else {
            (Vec::new(), Vec::new())
        };
        let walk = storage("hierarchy", bytemuck::cast_slice(&nodes))?;
        let walk_triangles = storage("hierarchy's triangles", bytemuck::cast_slice(&list))?;
        gpu.guarded("the surface's textures", || {
            let confidence = |i: usize| self.solution.confidence.get(i).copied().unwrap_or(0.0);
            SurfaceBuffers {
                group: gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
                    label: Some("surface"),
                    layout,
                    entries: &[
                        shader::bind_buffer(0, &vertices),
                        shader::bind_buffer(1, &triangles),
                    ],
                }),
                corners,
                walk,
                walk_triangles,
                walk_nodes: nodes.len() as u32,
                diffuse: upload_texture(
                    gpu,
                    "diffuse",
                    size,
                    &self.solution.diffuse,
                    self.unit,
                    &confidence,
                ),
                albedo: upload_texture(
                    gpu,
                    "albedo",
                    size,
                    &self.solution.albedo,
                    self.albedo_unit,
                    &|_| 1.0,
                ),
                gloss: self.upload_gloss(gpu, size),
            }
        })
    }

    /// Copies the gloss of all texels to the device.
    fn upload_gloss(&self, gpu: &Gpu, size: [u32; 2]) -> wgpu::TextureView {
        // So that what lies between texels is [`Gloss::mean`]. Textures hold nothing negative.
        let main = [Gloss::MAIN];
        let (size, glosses) = match &self.solution.gloss {
            Some(gloss) => (size, gloss.texels()),
            None => ([1, 1], &main[..]),
        };
        let scales: Vec<[f32; 3]> = glosses.iter().map(|g| g.scale().to_array()).collect();
        upload_texture(gpu, "gloss", size, &scales, 1.0, &|k| {
            let log = (glosses[k].roughness / LEAST_GLOSS_ROUGHNESS).ln();
            log.max(0.0) * glosses[k].strength
        })
    }

    /// The hierarchy of the triangles, if the surface mirrors what is around it.
    fn mirror_walk(&self) -> (Vec<GpuWalkNode>, Vec<u32>) {
        if self.solution.brdf.is_none() {
            return (Vec::new(), Vec::new());
        }
        let (nodes, list) = self.occluder.walk();
        let nodes = nodes
            .iter()
            .map(|node| GpuWalkNode {
                low: (node.low - self.centre).to_array(),
                next: if node.count > 0 {
                    node.first
                } else {
                    node.skip
                },
                high: (node.high - self.centre).to_array(),
                count: node.count,
            })
            .collect();
        (nodes, list)
    }

    /// All triangles as the device has them.
    fn triangles(&self) -> Vec<GpuTriangle> {
        let mesh = &self.solution.mesh;
        let scale = |atlas: &Atlas| Vec2::new(atlas.width as f32, atlas.height as f32).recip();
        let (uv_scale, light_scale) = (scale(&self.solution.atlas), scale(&self.light_atlas));
        (0..mesh.triangles.len())
            .into_par_iter()
            .map(|t| {
                let [a, b, c] =
                    self.solution.atlas.corner_uvs[t].map(|uv| (uv * uv_scale).to_array());
                let [d, e, f] =
                    self.light_atlas.corner_uvs[t].map(|uv| (uv * light_scale).to_array());
                GpuTriangle {
                    corners: mesh.triangles[t],
                    uvs: [a, b, c, d, e, f],
                    ..GpuTriangle::default()
                }
            })
            .collect()
    }
}

/// Half floats of a texture in units of `unit`, with an alpha.
fn upload_texture(
    gpu: &Gpu,
    label: &str,
    size: [u32; 2],
    texels: &[[f32; 3]],
    unit: f32,
    alpha: &(dyn Fn(usize) -> f32 + Sync),
) -> wgpu::TextureView {
    let texture = gpu.texture(
        label,
        [size[0], size[1], 1],
        wgpu::TextureFormat::Rgba16Float,
        wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        1,
    );
    let halves: Vec<[f16; 4]> = texels
        .par_iter()
        .enumerate()
        .map(|(i, &texel)| to_half(Vec3::from(texel) / unit, alpha(i)))
        .collect();
    gpu.fill(&texture, 0, size, bytemuck::cast_slice(&bits(&halves)));
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

/// A colour as the device stores it.
pub(super) fn to_half(colour: Vec3, alpha: f32) -> [f16; 4] {
    const LARGEST: f32 = 6e4;
    let c = colour.clamp(Vec3::ZERO, Vec3::splat(LARGEST));
    [c.x, c.y, c.z, alpha].map(f16::from_f32)
}

/// The bits of half floats, which can be copied as bytes.
pub(super) fn bits(halves: &[[f16; 4]]) -> Vec<[u16; 4]> {
    halves.iter().map(|h| h.map(f16::to_bits)).collect()
}

/// Roughness of a part, as a multiple of the main lobe's, whose logarithm is stored as 0; the shader has the same.
const LEAST_GLOSS_ROUGHNESS: f32 = 0.01;

/// A unit that can be divided by.
fn positive(value: f32) -> f32 {
    if value > 0.0 && value.is_finite() {
        value
    } else {
        1.0
    }
}

/// Part of the sky that each vertex sees, 0 to 255.
fn openness(mesh: &Mesh, occluder: &Occluder) -> Vec<u8> {
    /// Rays of all vertices together, about: a quarter of a second's work on one core.
    const RAYS: usize = 400_000;
    let rays = (RAYS / mesh.positions.len().max(1)).clamp(4, 48);
    (0..mesh.positions.len())
        .into_par_iter()
        .map(|v| {
            let normal = mesh.normals[v];
            let origin = occluder.offset_origin(mesh.positions[v], normal);
            let (tangent, bitangent) = normal.any_orthonormal_pair();
            let clear = (0..rays)
                .filter(|&i| {
                    // Distributed by the cosine (Malley's method) along a golden spiral.
                    let radius = ((i as f32 + 0.5) / rays as f32).sqrt();
                    let (sin, cos) = (i as f32 * GOLDEN_ANGLE).sin_cos();
                    let height = (1.0 - radius * radius).sqrt();
                    let direction = radius * (cos * tangent + sin * bitangent) + height * normal;
                    !occluder.occluded(origin, direction, f32::INFINITY)
                })
                .count();
            (clear * 255 / rays) as u8
        })
        .collect()
}
