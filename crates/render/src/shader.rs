//! The shaders' source: files of `shaders/`, joined by `#import name.wgsl` lines. Every file comes in once, before the
//! line that asked for it.

use std::ops::Range;

use super::error::RenderError;
use super::gpu::Gpu;

/// Every file of `shaders/`.
const FILES: [(&str, &str); 13] = [
    (
        "accumulate.wgsl",
        include_str!("../../../shaders/accumulate.wgsl"),
    ),
    ("brdf.wgsl", include_str!("../../../shaders/brdf.wgsl")),
    (
        "combine.wgsl",
        include_str!("../../../shaders/combine.wgsl"),
    ),
    (
        "display.wgsl",
        include_str!("../../../shaders/display.wgsl"),
    ),
    ("frame.wgsl", include_str!("../../../shaders/frame.wgsl")),
    (
        "fullscreen.wgsl",
        include_str!("../../../shaders/fullscreen.wgsl"),
    ),
    ("mirror.wgsl", include_str!("../../../shaders/mirror.wgsl")),
    ("shade.wgsl", include_str!("../../../shaders/shade.wgsl")),
    ("shadow.wgsl", include_str!("../../../shaders/shadow.wgsl")),
    ("sky.wgsl", include_str!("../../../shaders/sky.wgsl")),
    (
        "surface.wgsl",
        include_str!("../../../shaders/surface.wgsl"),
    ),
    (
        "view_transform.wgsl",
        include_str!("../../../shaders/view_transform.wgsl"),
    ),
    (
        "visible.wgsl",
        include_str!("../../../shaders/visible.wgsl"),
    ),
];

/// The whole source of a shader, imports resolved.
pub(super) fn source(name: &str) -> String {
    let mut included = Vec::new();
    let mut text = String::new();
    include(name, &mut included, &mut text);
    text
}

/// Compiles a shader.
pub(super) fn module(gpu: &Gpu, name: &'static str) -> Result<wgpu::ShaderModule, RenderError> {
    let descriptor = wgpu::ShaderModuleDescriptor {
        label: Some(name),
        source: wgpu::ShaderSource::Wgsl(source(name).into()),
    };
    gpu.guarded(name, || gpu.device().create_shader_module(descriptor))
        .map_err(|error| match error {
            RenderError::Refused { reason, .. } => RenderError::Shader { name, reason },
            other => other,
        })
}

/// A pipeline that covers the whole picture and adds to what is there or replaces it.
pub(super) fn fullscreen(
    gpu: &Gpu,
    module: &wgpu::ShaderModule,
    entry_point: &str,
    layouts: &[&wgpu::BindGroupLayout],
    format: wgpu::TextureFormat,
    blend: Option<wgpu::BlendState>,
) -> wgpu::RenderPipeline {
    let device = gpu.device();
    let layouts: Vec<_> = layouts.iter().copied().map(Some).collect();
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(entry_point),
        bind_group_layouts: &layouts,
        immediate_size: 0,
    });
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(entry_point),
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("fullscreen_vertex"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some(entry_point),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(wgpu::ColorTargetState {
                format,
                blend,
                write_mask: wgpu::ColorWrites::ALL,
            })],
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// A pass that draws into a picture, or into some of its rows.
fn picture_pass<'e>(
    encoder: &'e mut wgpu::CommandEncoder,
    target: &wgpu::TextureView,
    rows: Option<&Range<u32>>,
    clear: bool,
) -> wgpu::RenderPass<'e> {
    let load = if clear {
        wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT)
    } else {
        wgpu::LoadOp::Load
    };
    let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("picture"),
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view: target,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations {
                load,
                store: wgpu::StoreOp::Store,
            },
        })],
        ..wgpu::RenderPassDescriptor::default()
    });
    limit_to_rows(&mut pass, target, rows);
    pass
}

/// Leaves all but some rows of a pass's target alone.
pub(super) fn limit_to_rows(
    pass: &mut wgpu::RenderPass<'_>,
    target: &wgpu::TextureView,
    rows: Option<&Range<u32>>,
) {
    if let Some(rows) = rows {
        let width = target.texture().width();
        pass.set_scissor_rect(0, rows.start, width, rows.end - rows.start);
    }
}

/// Draws a fullscreen pipeline once for each bind group.
pub(super) fn draw_fullscreen<'a>(
    encoder: &mut wgpu::CommandEncoder,
    pipeline: &wgpu::RenderPipeline,
    target: &wgpu::TextureView,
    rows: Option<&Range<u32>>,
    clear: bool,
    groups: impl IntoIterator<Item = &'a wgpu::BindGroup>,
) {
    let mut pass = picture_pass(encoder, target, rows, clear);
    pass.set_pipeline(pipeline);
    for group in groups {
        pass.set_bind_group(0, group, &[]);
        pass.draw(0..3, 0..1);
    }
}

/// One on one.
pub(super) const ADD: wgpu::BlendState = {
    let component = wgpu::BlendComponent {
        src_factor: wgpu::BlendFactor::One,
        dst_factor: wgpu::BlendFactor::One,
        operation: wgpu::BlendOperation::Add,
    };
    wgpu::BlendState {
        color: component,
        alpha: component,
    }
};

/// Layouts are shared by passes that draw and passes that compute.
pub(super) const STAGES: wgpu::ShaderStages =
    wgpu::ShaderStages::VERTEX_FRAGMENT.union(wgpu::ShaderStages::COMPUTE);

/// A uniform buffer's place in a layout.
pub(super) fn uniform(binding: u32) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: STAGES,
        ty: wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: false,
            min_binding_size: None,
        },
        count: None,
    }
}

/// A read-only storage buffer's place in a layout.
pub(super) fn storage(binding: u32) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        ty: wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Storage { read_only: true },
            has_dynamic_offset: false,
            min_binding_size: None,
        },
        ..uniform(binding)
    }
}

/// The place of a flat texture that is read texel by texel, or filtered.
pub(super) fn flat_texture(binding: u32, filterable: bool) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: STAGES,
        ty: wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable },
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        },
        count: None,
    }
}

/// A buffer in a bind group.
pub(super) fn bind_buffer(binding: u32, buffer: &wgpu::Buffer) -> wgpu::BindGroupEntry<'_> {
    wgpu::BindGroupEntry {
        binding,
        resource: buffer.as_entire_binding(),
    }
}

/// A texture in a bind group.
pub(super) fn bind_texture(binding: u32, view: &wgpu::TextureView) -> wgpu::BindGroupEntry<'_> {
    wgpu::BindGroupEntry {
        binding,
        resource: wgpu::BindingResource::TextureView(view),
    }
}

fn include(name: &str, included: &mut Vec<String>, text: &mut String) {
    if included.iter().any(|done| done == name) {
        return;
    }
    included.push(name.to_owned());
    let file = FILES.iter().find(|(file, _)| *file == name);
    for line in file.map_or("", |(_, source)| source).lines() {
        if let Some(imported) = line.strip_prefix("#import ") {
            include(imported.trim(), included, text);
        } else {
            text.push_str(line);
            text.push('\n');
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shader_is_valid_without_a_device() {
        use wgpu::naga;
        for (name, _) in FILES {
            let source = source(name);
            let module = naga::front::wgsl::parse_str(&source)
                .unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(&source)));
            let flags = naga::valid::ValidationFlags::all();
            let checked = naga::valid::Validator::new(flags, naga::valid::Capabilities::empty())
                .validate(&module);
            assert!(checked.is_ok(), "{name}: {:?}", checked.err());
        }
    }

    #[test]
    fn every_file_is_listed_and_every_import_exists() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shaders");
        let mut found: Vec<String> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        found.sort();
        assert_eq!(found, FILES.map(|(name, _)| name.to_owned()));
        for (name, text) in FILES {
            for imported in text.lines().filter_map(|l| l.strip_prefix("#import ")) {
                let exists = FILES.iter().any(|(file, _)| *file == imported.trim());
                assert!(exists, "{name} imports {imported}");
            }
        }
    }
}
