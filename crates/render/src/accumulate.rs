//! The pass that adds a frame to the mean of a still picture: `accumulate.wgsl`.

use std::ops::Range;

use super::error::RenderError;
use super::frame::LINEAR;
use super::gpu::Gpu;
use super::shader;
use super::targets::Targets;

/// The pipeline and its weight.
pub(super) struct AccumulatePass {
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::RenderPipeline,
    weight: wgpu::Buffer,
}

impl AccumulatePass {
    pub(super) fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        let module = shader::module(gpu, "accumulate.wgsl")?;
        gpu.guarded("refining the picture", || {
            let layout = gpu
                .device()
                .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                    label: Some("accumulate"),
                    entries: &[shader::flat_texture(0, false), shader::uniform(1)],
                });
            let pipeline = shader::fullscreen(
                gpu,
                &module,
                "accumulate_fragment",
                &[&layout],
                LINEAR,
                Some(shader::ADD),
            );
            let weight = gpu.buffer("frame weight", 16, wgpu::BufferUsages::UNIFORM);
            Self {
                layout,
                pipeline,
                weight,
            }
        })
    }

    /// Binds the frame that is to be added.
    pub(super) fn bind(&self, gpu: &Gpu, frame: &wgpu::TextureView) -> wgpu::BindGroup {
        gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("accumulate"),
            layout: &self.layout,
            entries: &[
                shader::bind_texture(0, frame),
                shader::bind_buffer(1, &self.weight),
            ],
        })
    }

    /// Adds rows of the still frame times `weight`, to nothing if they are the first.
    pub(super) fn draw(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        targets: &Targets,
        rows: &Range<u32>,
        weight: f32,
        first: bool,
    ) {
        gpu.queue().write_buffer(
            &self.weight,
            0,
            bytemuck::bytes_of(&[weight, 0.0, 0.0, 0.0]),
        );
        shader::draw_fullscreen(
            encoder,
            &self.pipeline,
            &targets.mean_view,
            Some(rows),
            first,
            [&targets.accumulate],
        );
    }
}
