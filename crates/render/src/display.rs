//! The pass that turns linear radiance into what a screen shows: `display.wgsl`.

use bytemuck::{Pod, Zeroable};

use super::error::RenderError;
use super::gpu::Gpu;
use super::shader;

/// What a window shows: sRGB-encoded, although the format doesn't say so.
pub(super) const SHOWN: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

/// Mirror of `Display` in `display.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Default, PartialEq, Pod, Zeroable)]
pub(super) struct Display {
    pub background: [f32; 4],
    pub world_x: [f32; 4],
    pub world_y: [f32; 4],
    pub world_z: [f32; 4],
    pub focal: [f32; 2],
    pub centre: [f32; 2],
    pub exposure: f32,
    pub transform: u32,
    pub kind: u32,
    pub pad: u32,
}

/// The pipeline.
pub(super) struct DisplayPass {
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::RenderPipeline,
    sampler: wgpu::Sampler,
    display: wgpu::Buffer,
}

impl DisplayPass {
    pub(super) fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        let module = shader::module(gpu, "display.wgsl")?;
        gpu.guarded("showing the picture", || {
            let layout = gpu
                .device()
                .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                    label: Some("display"),
                    entries: &[
                        shader::flat_texture(0, false),
                        shader::flat_texture(1, true),
                        wgpu::BindGroupLayoutEntry {
                            binding: 2,
                            visibility: wgpu::ShaderStages::FRAGMENT,
                            ty: wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
                            count: None,
                        },
                        shader::uniform(3),
                    ],
                });
            let pipeline =
                shader::fullscreen(gpu, &module, "display_fragment", &[&layout], SHOWN, None);
            let sampler = gpu.device().create_sampler(&wgpu::SamplerDescriptor {
                label: Some("light"),
                address_mode_u: wgpu::AddressMode::Repeat,
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..wgpu::SamplerDescriptor::default()
            });
            let display = gpu.buffer(
                "display",
                size_of::<Display>() as u64,
                wgpu::BufferUsages::UNIFORM,
            );
            Self {
                layout,
                pipeline,
                sampler,
                display,
            }
        })
    }

    /// Binds a linear picture and the light that may be its background.
    pub(super) fn bind(
        &self,
        gpu: &Gpu,
        picture: &wgpu::TextureView,
        light: &wgpu::TextureView,
    ) -> wgpu::BindGroup {
        gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("display"),
            layout: &self.layout,
            entries: &[
                shader::bind_texture(0, picture),
                shader::bind_texture(1, light),
                wgpu::BindGroupEntry {
                    binding: 2,
                    resource: wgpu::BindingResource::Sampler(&self.sampler),
                },
                shader::bind_buffer(3, &self.display),
            ],
        })
    }

    /// Writes the shown picture.
    pub(super) fn draw(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        display: &Display,
        picture: &wgpu::BindGroup,
        target: &wgpu::TextureView,
    ) {
        gpu.queue()
            .write_buffer(&self.display, 0, bytemuck::bytes_of(display));
        shader::draw_fullscreen(encoder, &self.pipeline, target, None, true, [picture]);
    }
}
