//! The pass that finds which triangle each pixel shows, and how much of it the object covers: `visible.wgsl`.

use std::ops::Range;

use super::error::RenderError;
use super::frame::{DEPTH, Frame};
use super::gpu::Gpu;
use super::shader;
use super::surface::SurfaceBuffers;

/// Number of the triangle plus one, and its corners' weights.
pub(super) const VISIBLE: wgpu::TextureFormat = wgpu::TextureFormat::Rg32Uint;
/// Covered part of a pixel.
pub(super) const COVERED: wgpu::TextureFormat = wgpu::TextureFormat::R8Unorm;
/// Samples of a pixel's coverage while things move.
pub(super) const SAMPLES: u32 = 4;

/// The pipelines, and the frame's buffer that the other passes share.
pub(super) struct VisiblePass {
    visible: wgpu::RenderPipeline,
    coverage: wgpu::RenderPipeline,
    frame: wgpu::Buffer,
    pub frame_layout: wgpu::BindGroupLayout,
    pub frame_group: wgpu::BindGroup,
}

impl VisiblePass {
    pub(super) fn new(
        gpu: &Gpu,
        surface_layout: &wgpu::BindGroupLayout,
    ) -> Result<Self, RenderError> {
        let module = shader::module(gpu, "visible.wgsl")?;
        gpu.guarded("drawing the surface", || {
            let device = gpu.device();
            let frame_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("frame"),
                entries: &[shader::uniform(0)],
            });
            let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("visible"),
                bind_group_layouts: &[Some(&frame_layout), Some(surface_layout)],
                immediate_size: 0,
            });
            let frame = gpu.buffer(
                "frame",
                size_of::<Frame>() as u64,
                wgpu::BufferUsages::UNIFORM,
            );
            let frame_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("frame"),
                layout: &frame_layout,
                entries: &[shader::bind_buffer(0, &frame)],
            });
            Self {
                visible: pipeline(gpu, &module, &layout, false),
                coverage: pipeline(gpu, &module, &layout, true),
                frame,
                frame_layout,
                frame_group,
            }
        })
    }

    /// Writes the frame that the passes of this submission read.
    pub(super) fn set_frame(&self, gpu: &Gpu, frame: &Frame) {
        gpu.queue()
            .write_buffer(&self.frame, 0, bytemuck::bytes_of(frame));
    }

    /// Finds the visible triangles, of all rows or of some.
    pub(super) fn draw(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        surface: &SurfaceBuffers,
        visible: &wgpu::TextureView,
        depth: &wgpu::TextureView,
        rows: &Range<u32>,
    ) {
        let depth = wgpu::RenderPassDepthStencilAttachment {
            view: depth,
            depth_ops: Some(wgpu::Operations {
                load: wgpu::LoadOp::Clear(0.0),
                store: wgpu::StoreOp::Discard,
            }),
            stencil_ops: None,
        };
        self.run(
            encoder,
            &self.visible,
            surface,
            [visible, visible],
            Some(depth),
            Some(rows),
        );
    }

    /// Measures the covered part of each pixel, by way of a texture of four samples.
    pub(super) fn cover(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        surface: &SurfaceBuffers,
        samples: &wgpu::TextureView,
        coverage: &wgpu::TextureView,
    ) {
        self.run(
            encoder,
            &self.coverage,
            surface,
            [samples, coverage],
            None,
            None,
        );
    }

    fn run(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        pipeline: &wgpu::RenderPipeline,
        surface: &SurfaceBuffers,
        [target, resolved]: [&wgpu::TextureView; 2],
        depth: Option<wgpu::RenderPassDepthStencilAttachment>,
        rows: Option<&Range<u32>>,
    ) {
        let resolve = depth.is_none();
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("visible"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: target,
                depth_slice: None,
                resolve_target: resolve.then_some(resolved),
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: if resolve {
                        wgpu::StoreOp::Discard
                    } else {
                        wgpu::StoreOp::Store
                    },
                },
            })],
            depth_stencil_attachment: depth,
            ..wgpu::RenderPassDescriptor::default()
        });
        shader::limit_to_rows(&mut pass, target, rows);
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &self.frame_group, &[]);
        pass.set_bind_group(1, &surface.group, &[]);
        pass.draw(0..surface.corners, 0..1);
    }
}

fn pipeline(
    gpu: &Gpu,
    module: &wgpu::ShaderModule,
    layout: &wgpu::PipelineLayout,
    coverage: bool,
) -> wgpu::RenderPipeline {
    let [vertex, fragment] = if coverage {
        ["coverage_vertex", "coverage_fragment"]
    } else {
        ["visible_vertex", "visible_fragment"]
    };
    gpu.device()
        .create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(fragment),
            layout: Some(layout),
            vertex: wgpu::VertexState {
                module,
                entry_point: Some(vertex),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: (!coverage).then(|| wgpu::DepthStencilState {
                format: DEPTH,
                depth_write_enabled: Some(true),
                depth_compare: Some(wgpu::CompareFunction::Greater),
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState {
                count: if coverage { SAMPLES } else { 1 },
                ..wgpu::MultisampleState::default()
            },
            fragment: Some(wgpu::FragmentState {
                module,
                entry_point: Some(fragment),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &[Some(wgpu::ColorTargetState {
                    format: if coverage { COVERED } else { VISIBLE },
                    blend: None,
                    write_mask: wgpu::ColorWrites::ALL,
                })],
            }),
            multiview_mask: None,
            cache: None,
        })
}
