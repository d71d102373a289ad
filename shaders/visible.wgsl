// Which triangle each pixel shows, and where; and how much of each pixel the object covers.

#import frame.wgsl
#import surface.wgsl

struct Visible {
    @builtin(position) clip: vec4f,
    @location(0) @interpolate(flat) triangle: u32,
    /// Weights of the second and third corner.
    @location(1) weights: vec2f,
}

@vertex
fn visible_vertex(@builtin(vertex_index) index: u32) -> Visible {
    let corner = index % 3u;
    let weights = vec2f(f32(corner == 1u), f32(corner == 2u));
    return Visible(project(corner_position(index)), index / 3u, weights);
}

/// Number of the triangle plus one, and the weights in 16 bits each.
@fragment
fn visible_fragment(in: Visible) -> @location(0) vec2u {
    return vec2u(in.triangle + 1u, pack2x16unorm(in.weights));
}

@vertex
fn coverage_vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return project(corner_position(index));
}

@fragment
fn coverage_fragment() -> @location(0) vec4f {
    return vec4f(1.0);
}
