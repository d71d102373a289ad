//! The pass that adds baked layers to the irradiance of all light: `combine.wgsl`.

use super::error::RenderError;
use super::frame::LINEAR;
use super::gpu::Gpu;
use super::shader;
use glam::Vec3;

/// The pipeline.
pub(super) struct CombinePass {
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::RenderPipeline,
}

/// A baked layer on the device.
pub(super) struct LayerTexture {
    weight: wgpu::Buffer,
    group: wgpu::BindGroup,
}

impl CombinePass {
    pub(super) fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        let module = shader::module(gpu, "combine.wgsl")?;
        gpu.guarded("adding light", || {
            let layout = gpu
                .device()
                .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                    label: Some("combine"),
                    entries: &[shader::flat_texture(0, false), shader::uniform(1)],
                });
            let pipeline = shader::fullscreen(
                gpu,
                &module,
                "combine_fragment",
                &[&layout],
                LINEAR,
                Some(shader::ADD),
            );
            Self { layout, pipeline }
        })
    }

    /// Copies a layer of `size` texels, given as the bits of half floats, to the device.
    pub(super) fn upload(
        &self,
        gpu: &Gpu,
        size: [u32; 2],
        bits: &[[u16; 4]],
    ) -> Result<LayerTexture, RenderError> {
        gpu.guarded("baked light", || {
            let texture = gpu.texture(
                "baked light",
                [size[0], size[1], 1],
                LINEAR,
                wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
                1,
            );
            gpu.fill(&texture, 0, size, bytemuck::cast_slice(bits));
            let weight = gpu.buffer("weight", 16, wgpu::BufferUsages::UNIFORM);
            let group = gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("baked light"),
                layout: &self.layout,
                entries: &[
                    shader::bind_texture(
                        0,
                        &texture.create_view(&wgpu::TextureViewDescriptor::default()),
                    ),
                    shader::bind_buffer(1, &weight),
                ],
            });
            LayerTexture { weight, group }
        })
    }

    /// Sets `target` to the sum of layers, each times its weight.
    pub(super) fn draw(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        target: &wgpu::TextureView,
        layers: &[(&LayerTexture, Vec3)],
    ) {
        for (layer, weight) in layers {
            let value = weight.extend(1.0).to_array();
            gpu.queue()
                .write_buffer(&layer.weight, 0, bytemuck::bytes_of(&value));
        }
        shader::draw_fullscreen(
            encoder,
            &self.pipeline,
            target,
            None,
            true,
            layers.iter().map(|(l, _)| &l.group),
        );
    }
}
