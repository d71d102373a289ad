//! The pass that shades what is visible: `shade.wgsl`. It computes in place of drawing, since devices made for computing
//! draw with a small part of what they have.

use std::ops::Range;

use super::error::RenderError;
use super::frame::{GpuShadowMap, LINEAR};
use super::gpu::Gpu;
use super::shader;
use super::shadow::MAX_SHADOW_MAPS;
use super::surface::SurfaceBuffers;

/// Size of the buffer of all shadow maps.
pub(super) const SHADOWS_SIZE: u64 = (MAX_SHADOW_MAPS * size_of::<GpuShadowMap>()) as u64;

/// Pixels on a side of what `shade.wgsl` calls a workgroup.
const GROUP_SIDE: u32 = 8;

/// The pipeline.
pub(super) struct ShadePass {
    scene_layout: wgpu::BindGroupLayout,
    pixel_layout: wgpu::BindGroupLayout,
    pipeline: wgpu::ComputePipeline,
    sampler: wgpu::Sampler,
    /// For lat-long pictures at several blurs.
    around: wgpu::Sampler,
}

/// What the shader reads besides the frame.
pub(super) struct SceneBindings<'a> {
    pub surface: &'a SurfaceBuffers,
    pub irradiance: &'a wgpu::TextureView,
    pub visibility: &'a wgpu::TextureView,
    pub shadow_maps: &'a wgpu::TextureView,
    pub lobes: &'a wgpu::Buffer,
    pub soft: &'a wgpu::Buffer,
    pub shadows: &'a wgpu::Buffer,
    pub sky: &'a wgpu::TextureView,
}

impl ShadePass {
    pub(super) fn new(
        gpu: &Gpu,
        frame_layout: &wgpu::BindGroupLayout,
        surface_layout: &wgpu::BindGroupLayout,
    ) -> Result<Self, RenderError> {
        let module = shader::module(gpu, "shade.wgsl")?;
        gpu.guarded("shading the surface", || {
            let device = gpu.device();
            let scene_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("scene"),
                entries: &scene_entries(),
            });
            let pixel_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("pixels"),
                entries: &[
                    wgpu::BindGroupLayoutEntry {
                        ty: wgpu::BindingType::Texture {
                            sample_type: wgpu::TextureSampleType::Uint,
                            view_dimension: wgpu::TextureViewDimension::D2,
                            multisampled: false,
                        },
                        ..shader::flat_texture(0, false)
                    },
                    shader::flat_texture(1, false),
                    wgpu::BindGroupLayoutEntry {
                        visibility: wgpu::ShaderStages::COMPUTE,
                        ty: wgpu::BindingType::StorageTexture {
                            access: wgpu::StorageTextureAccess::WriteOnly,
                            format: LINEAR,
                            view_dimension: wgpu::TextureViewDimension::D2,
                        },
                        ..shader::flat_texture(2, false)
                    },
                ],
            });
            let layouts = [frame_layout, surface_layout, &scene_layout, &pixel_layout];
            let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("shade"),
                bind_group_layouts: &layouts.map(Some),
                immediate_size: 0,
            });
            let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some("shade"),
                layout: Some(&layout),
                module: &module,
                entry_point: Some("shade_pixels"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            });
            let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("linear"),
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..wgpu::SamplerDescriptor::default()
            });
            let around = device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("around"),
                address_mode_u: wgpu::AddressMode::Repeat,
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                mipmap_filter: wgpu::MipmapFilterMode::Linear,
                ..wgpu::SamplerDescriptor::default()
            });
            Self {
                scene_layout,
                pixel_layout,
                pipeline,
                sampler,
                around,
            }
        })
    }

    /// Binds what the shader reads.
    pub(super) fn bind(&self, gpu: &Gpu, scene: &SceneBindings) -> wgpu::BindGroup {
        gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("scene"),
            layout: &self.scene_layout,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::Sampler(&self.sampler),
                },
                shader::bind_texture(1, &scene.surface.diffuse),
                shader::bind_texture(2, &scene.surface.albedo),
                shader::bind_texture(3, scene.irradiance),
                shader::bind_texture(4, scene.visibility),
                shader::bind_texture(5, scene.shadow_maps),
                shader::bind_buffer(6, scene.lobes),
                shader::bind_buffer(7, scene.soft),
                shader::bind_buffer(8, scene.shadows),
                shader::bind_buffer(9, &scene.surface.walk),
                shader::bind_buffer(10, &scene.surface.walk_triangles),
                shader::bind_texture(11, &scene.surface.gloss),
                shader::bind_texture(12, scene.sky),
                wgpu::BindGroupEntry {
                    binding: 13,
                    resource: wgpu::BindingResource::Sampler(&self.around),
                },
            ],
        })
    }

    /// Binds what was found visible, how much of each pixel is covered, and the picture.
    pub(super) fn bind_pixels(
        &self,
        gpu: &Gpu,
        visible: &wgpu::TextureView,
        coverage: &wgpu::TextureView,
        picture: &wgpu::TextureView,
    ) -> wgpu::BindGroup {
        gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("pixels"),
            layout: &self.pixel_layout,
            entries: &[
                shader::bind_texture(0, visible),
                shader::bind_texture(1, coverage),
                shader::bind_texture(2, picture),
            ],
        })
    }

    /// Shades the frame's rows of a picture this wide. The groups are those of the frame, the surface, the scene and the
    /// pixels.
    pub(super) fn run(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        groups: [&wgpu::BindGroup; 4],
        width: u32,
        rows: &Range<u32>,
    ) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&self.pipeline);
        for (i, group) in groups.into_iter().enumerate() {
            pass.set_bind_group(i as u32, group, &[]);
        }
        let groups = |pixels: u32| pixels.div_ceil(GROUP_SIDE);
        pass.dispatch_workgroups(groups(width), groups(rows.end - rows.start), 1);
    }
}

fn scene_entries() -> [wgpu::BindGroupLayoutEntry; 14] {
    let texture = |binding, sample_type, view_dimension| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: shader::STAGES,
        ty: wgpu::BindingType::Texture {
            sample_type,
            view_dimension,
            multisampled: false,
        },
        count: None,
    };
    let sampler = |binding| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: shader::STAGES,
        ty: wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
        count: None,
    };
    let colour = wgpu::TextureSampleType::Float { filterable: true };
    let flat = wgpu::TextureViewDimension::D2;
    let layers = wgpu::TextureViewDimension::D2Array;
    [
        sampler(0),
        texture(1, colour, flat),
        texture(2, colour, flat),
        texture(3, colour, flat),
        texture(4, colour, layers),
        texture(5, wgpu::TextureSampleType::Depth, layers),
        shader::storage(6),
        shader::storage(7),
        shader::uniform(8),
        shader::storage(9),
        shader::storage(10),
        texture(11, colour, flat),
        texture(12, colour, flat),
        sampler(13),
    ]
}
