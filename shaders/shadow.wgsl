// Depth of the surface seen from a lamp.

#import surface.wgsl

struct Lamp {
    clip_from_world: mat4x4f,
}

@group(0) @binding(0) var<uniform> lamp: Lamp;

@vertex
fn shadow_vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return lamp.clip_from_world * vec4f(corner_position(index), 1.0);
}
