// What every pass of a frame knows. Mirrored by `Frame` in `render/frame.rs`; positions are relative to the object's
// centre, radiance is in units of the surface's white.

#import brdf.wgsl

struct Frame {
    /// Rows of the rotation from the world into the camera, which looks along −Z; w: the eye's position.
    camera_x: vec4f,
    camera_y: vec4f,
    camera_z: vec4f,
    /// Focal lengths and principal point in parts of the picture: ndc = u · focal + centre, y upwards.
    focal: vec2f,
    centre: vec2f,
    /// Radial and tangential lens distortion as in `capture::Distortion`.
    radial: vec4f,
    denominator: vec4f,
    tangential: vec2f,
    distorted: u32,
    near: f32,
    /// Picture size in pixels.
    size: vec2f,
    sigma: f32,
    /// 0: the paper's lobe, 1: Beckmann's, 2: GGX's, 3: a metal's, 4: none.
    model: u32,
    mode: u32,
    /// Bit 0: the diffuse part is the stored texture; 1: pixels are partly covered; 4–7: shadow maps in use.
    flags: u32,
    /// Lobes that every frame adds.
    always: vec2u,
    /// Lobes of this frame's window …
    window: vec2u,
    /// … which stand for all windows.
    window_weight: f32,
    /// First of the six words of soft visibility in a vertex's row that this frame's lobes refer to.
    first_word: u32,
    /// Words per vertex, 0 where nothing is baked yet.
    row_words: u32,
    /// What the shadow mode shows: a lamp's place in the visibility texture, or 256 + its shadow map.
    shown_lamp: u32,
    /// Nodes of the hierarchy, 0 where the surface doesn't mirror itself.
    walk_nodes: u32,
    /// Which of a lobe's sixteen half vectors this frame traces; 16 is the middle of all.
    half_vector: u32,
    /// Irradiance by the ambient part where its layer is not baked yet.
    ambient: vec3f,
    /// Irradiance unit over radiance unit.
    irradiance_scale: f32,
    /// First row to shade, and the one after the last.
    rows: vec2u,
    /// Radius of a sphere about the centre that holds the object.
    radius: f32,
    /// Largest specular strength of any part, as a multiple of the main lobe's.
    strongest: f32,
    /// The surface's colour where it is a metal, else 1.
    tint: vec3f,
    /// Specular strength of the main lobe, as a multiple of what such surfaces usually have.
    strength: f32,
    /// Rows of the turn from the world to the environment's sky; w: what its red, green and blue are multiplied by.
    sky_x: vec4f,
    sky_y: vec4f,
    sky_z: vec4f,
    /// Levels of the sky, 0 without any.
    sky_levels: u32,
}

@group(0) @binding(0) var<uniform> frame: Frame;

fn eye() -> vec3f {
    return vec3f(frame.camera_x.w, frame.camera_y.w, frame.camera_z.w);
}

/// The OPENCV model, extended, or the OPENCV_FISHEYE model: distorted normalised coordinates.
fn distort(u: vec2f) -> vec2f {
    let r2 = dot(u, u);
    let k = frame.radial;
    if (frame.distorted == 2u) {
        let r = max(sqrt(r2), 1e-9);
        let angle = atan(r);
        let a2 = angle * angle;
        return u * (angle / r * (1.0 + a2 * (k.x + a2 * (k.y + a2 * (k.z + a2 * k.w)))));
    }
    let d = frame.denominator;
    let radial = (1.0 + r2 * (k.x + r2 * (k.y + r2 * (k.z + r2 * k.w)))) / (1.0 + r2 * (d.x + r2 * (d.y + r2 * d.z)));
    let p = frame.tangential;
    let xy = 2.0 * u.x * u.y;
    return u * radial + vec2f(p.x * xy + p.y * (r2 + 2.0 * u.x * u.x), p.y * xy + p.x * (r2 + 2.0 * u.y * u.y));
}

/// Clip position of a world position; depth runs from 1 at the near plane to 0 far away.
fn project(position: vec3f) -> vec4f {
    let offset = position - eye();
    let c = vec3f(dot(frame.camera_x.xyz, offset), dot(frame.camera_y.xyz, offset), dot(frame.camera_z.xyz, offset));
    let depth = -c.z;
    var xy = vec2f(c.x, -c.y);
    if (frame.distorted != 0u && depth > frame.near) {
        xy = distort(xy / depth) * depth;
    }
    return vec4f(xy.x * frame.focal.x + frame.centre.x * depth, -(xy.y * frame.focal.y + frame.centre.y * depth),
        frame.near, depth);
}
