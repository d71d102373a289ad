// The surface's corners, pulled by number. Mirrored by `render/surface.rs`; positions are relative to the object's centre.

struct Vertex {
    position: vec3f,
    /// Part of the sky that nothing hides.
    openness: f32,
    normal: vec3f,
}

struct Triangle {
    corners: vec3u,
    /// Texture coordinates of the first two corners, of the third, and of the first in the texture of baked light, …
    uv_a: vec4f,
    uv_b: vec4f,
    /// … and of the other two there.
    uv_c: vec4f,
}

@group(1) @binding(0) var<storage, read> vertices: array<Vertex>;
@group(1) @binding(1) var<storage, read> triangles: array<Triangle>;

/// Position of the corner that a draw without an index buffer calls `index`.
fn corner_position(index: u32) -> vec3f {
    return vertices[triangles[index / 3u].corners[index % 3u]].position;
}
