// From linear radiance to what the screen shows: exposure, view transform, background.

#import fullscreen.wgsl
#import view_transform.wgsl

struct Display {
    /// Display colour of the background; w: 1 shows the light itself instead.
    background: vec4f,
    /// Rows of the rotation from the camera into the world.
    world_x: vec4f,
    world_y: vec4f,
    world_z: vec4f,
    /// Focal lengths and principal point in pixels.
    focal: vec2f,
    centre: vec2f,
    exposure: f32,
    transform: u32,
    /// 0: radiance, 1: linear without a view transform, 2: display values.
    kind: u32,
    pad: u32,
}

@group(0) @binding(0) var picture: texture_2d<f32>;
@group(0) @binding(1) var light: texture_2d<f32>;
@group(0) @binding(2) var light_sampler: sampler;
@group(0) @binding(3) var<uniform> display: Display;

/// The light in a direction, as `hemisphere::lat_long_from_direction` maps it.
fn radiance_from(direction: vec3f) -> vec3f {
    let u = 0.5 + atan2(direction.z, direction.x) / 6.283185307;
    let v = acos(clamp(direction.y, -1.0, 1.0)) / 3.141592654;
    return textureSampleLevel(light, light_sampler, vec2f(u, v), 0.0).rgb;
}

@fragment
fn display_fragment(@builtin(position) at: vec4f) -> @location(0) vec4f {
    let value = textureLoad(picture, vec2i(at.xy), 0);
    let alpha = clamp(value.a, 0.0, 1.0);
    var colour = value.rgb;
    if (display.kind == 0u && display.background.w == 1.0) {
        let u = (at.xy - display.centre) / display.focal;
        let ray = vec3f(u.x, -u.y, -1.0);
        let direction = normalize(vec3f(dot(display.world_x.xyz, ray), dot(display.world_y.xyz, ray),
            dot(display.world_z.xyz, ray)));
        colour += radiance_from(direction) * (1.0 - alpha);
        return vec4f(view_transform(display.transform, colour * display.exposure), 1.0);
    }
    if (alpha == 0.0) {
        return vec4f(display.background.rgb, 1.0);
    }
    colour /= max(alpha, 1e-4);
    switch display.kind {
        case 0u: { colour = view_transform(display.transform, colour * display.exposure); }
        case 1u: { colour = srgb_encode(colour); }
        default: { colour = clamp(colour, vec3f(0.0), vec3f(1.0)); }
    }
    return vec4f(mix(display.background.rgb, colour, alpha), 1.0);
}
