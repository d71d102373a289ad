//! Shadow z-buffers: depth of the surface seen from a lamp that moves, `shadow.wgsl`. They stand in for baked light.

use glam::{Mat4, Vec3};

use super::error::RenderError;
use super::frame::{DEPTH, GpuShadowMap};
use super::gpu::Gpu;
use super::shader;
use super::surface::SurfaceBuffers;
use rekindle_relight::LampNodes;

/// Lamps that can move at a time and cast a shadow meanwhile.
pub(super) const MAX_SHADOW_MAPS: usize = 4;
/// Texels along each side.
const SIDE: u32 = 1024;
/// A lamp nearer to the object than this part of its radius casts no shadow from a single z-buffer.
const NEAREST: f32 = 1.05;

/// The pipeline and the maps.
pub(super) struct ShadowPass {
    pipeline: wgpu::RenderPipeline,
    matrices: Vec<(wgpu::Buffer, wgpu::BindGroup)>,
    layers: Vec<wgpu::TextureView>,
    /// All maps, for the shader that reads them.
    pub maps: wgpu::TextureView,
}

impl ShadowPass {
    pub(super) fn new(
        gpu: &Gpu,
        surface_layout: &wgpu::BindGroupLayout,
    ) -> Result<Self, RenderError> {
        let module = shader::module(gpu, "shadow.wgsl")?;
        gpu.guarded("shadow maps", || {
            let device = gpu.device();
            let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("shadow"),
                entries: &[shader::uniform(0)],
            });
            let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("shadow"),
                bind_group_layouts: &[Some(&layout), Some(surface_layout)],
                immediate_size: 0,
            });
            let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some("shadow"),
                layout: Some(&pipeline_layout),
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some("shadow_vertex"),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    buffers: &[],
                },
                primitive: wgpu::PrimitiveState::default(),
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: DEPTH,
                    depth_write_enabled: Some(true),
                    depth_compare: Some(wgpu::CompareFunction::Less),
                    stencil: wgpu::StencilState::default(),
                    bias: wgpu::DepthBiasState {
                        constant: 0,
                        slope_scale: 1.5,
                        clamp: 0.0,
                    },
                }),
                multisample: wgpu::MultisampleState::default(),
                fragment: None,
                multiview_mask: None,
                cache: None,
            });
            let texture = gpu.texture(
                "shadow maps",
                [SIDE, SIDE, MAX_SHADOW_MAPS as u32],
                DEPTH,
                wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING,
                1,
            );
            let matrices = (0..MAX_SHADOW_MAPS)
                .map(|_| {
                    let buffer = gpu.buffer("lamp", 64, wgpu::BufferUsages::UNIFORM);
                    let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
                        label: Some("lamp"),
                        layout: &layout,
                        entries: &[shader::bind_buffer(0, &buffer)],
                    });
                    (buffer, group)
                })
                .collect();
            let layers = (0..MAX_SHADOW_MAPS as u32)
                .map(|layer| {
                    texture.create_view(&wgpu::TextureViewDescriptor {
                        dimension: Some(wgpu::TextureViewDimension::D2),
                        base_array_layer: layer,
                        array_layer_count: Some(1),
                        ..wgpu::TextureViewDescriptor::default()
                    })
                })
                .collect();
            let maps = texture.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2Array),
                ..wgpu::TextureViewDescriptor::default()
            });
            Self {
                pipeline,
                matrices,
                layers,
                maps,
            }
        })
    }

    /// Draws the surface as a lamp sees it into map `index`.
    pub(super) fn draw(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        index: usize,
        map: &GpuShadowMap,
        surface: &SurfaceBuffers,
    ) {
        let (buffer, group) = &self.matrices[index];
        gpu.queue()
            .write_buffer(buffer, 0, bytemuck::bytes_of(&map.clip_from_world));
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shadow"),
            color_attachments: &[],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.layers[index],
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(1.0),
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: None,
            }),
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, group, &[]);
        pass.set_bind_group(1, &surface.group, &[]);
        pass.draw(0..surface.corners, 0..1);
    }
}

/// How a lamp sees an object of `radius` about the centre; `None` where it is too near for one map.
pub(super) fn shadow_map(lamp: &LampNodes, radius: f32) -> Option<GpuShadowMap> {
    let reach = lamp
        .nodes
        .iter()
        .map(|n| n.direction.angle_between(lamp.direction))
        .fold(0.0_f32, f32::max)
        .min(1.2);
    let direction = lamp.direction;
    let (right, up) = direction.any_orthonormal_pair();
    let mut map = GpuShadowMap {
        softness: reach.tan(),
        texel: 2.0 * radius / SIDE as f32,
        ..GpuShadowMap::default()
    };
    if let Some(distance) = lamp.radius {
        if distance < NEAREST * radius {
            return None;
        }
        let (near, far) = (distance - radius, distance + radius);
        let half_tangent = radius / (distance * distance - radius * radius).sqrt();
        let place = direction * distance;
        // Depth towards the centre.
        let to_lamp = Mat4::from_cols(
            right.extend(0.0),
            up.extend(0.0),
            (-direction).extend(0.0),
            glam::Vec4::W,
        )
        .transpose()
            * Mat4::from_translation(-place);
        let depth = far / (far - near);
        let perspective = Mat4::from_cols(
            glam::Vec4::new(1.0 / half_tangent, 0.0, 0.0, 0.0),
            glam::Vec4::new(0.0, 1.0 / half_tangent, 0.0, 0.0),
            glam::Vec4::new(0.0, 0.0, depth, 1.0),
            glam::Vec4::new(0.0, 0.0, -near * depth, 0.0),
        );
        map.set_matrix(perspective * to_lamp);
        map.place = place.to_array();
        map.softness *= distance;
        (map.near_plane, map.far_plane, map.half_tangent) = (near, far, half_tangent);
        map.texel = 2.0 * far * half_tangent / SIDE as f32;
    } else {
        let row = |axis: Vec3, scale: f32, offset: f32| (axis * scale).extend(offset);
        let rows = Mat4::from_cols(
            row(right, 1.0 / radius, 0.0),
            row(up, 1.0 / radius, 0.0),
            row(direction, -0.5 / radius, 0.5),
            glam::Vec4::W,
        );
        map.set_matrix(rows.transpose());
        map.place = direction.to_array();
    }
    Some(map)
}
