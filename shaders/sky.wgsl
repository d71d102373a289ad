// An environment's soft light as lobes mirror it: the twin of `relight/sky.rs`. One half vector of the lobe a frame, which sees
// the sky as blurred as it stands for others.

#import frame.wgsl

/// A lat-long picture of radiance, each level twice as blurred as the one before.
@group(2) @binding(12) var sky_texture: texture_2d<f32>;
@group(2) @binding(13) var sky_sampler: sampler;

const PI: f32 = 3.14159265;
/// Standard deviation of a picture's blur along each axis, in parts of a row.
const SKY_BLUR: f32 = 0.5;

fn has_sky() -> bool {
    return frame.sky_levels > 0u;
}

/// Radiance about a unit direction, blurred to this standard deviation along each axis, radians.
fn sky_radiance(direction: vec3f, spread: f32) -> vec3f {
    let d = vec3f(dot(frame.sky_x.xyz, direction), dot(frame.sky_y.xyz, direction), dot(frame.sky_z.xyz, direction));
    let uv = vec2f(0.5 + atan2(d.z, d.x) / (2.0 * PI), acos(clamp(d.y, -1.0, 1.0)) / PI);
    let finest = SKY_BLUR * PI / f32(textureDimensions(sky_texture).y);
    let level = log2(max(spread / finest, 1.0));
    let gain = vec3f(frame.sky_x.w, frame.sky_y.w, frame.sky_z.w);
    return gain * textureSampleLevel(sky_texture, sky_sampler, uv, level).rgb;
}

/// What the lobe is of uniform light, but for Fresnel factor and masking of the light.
fn drawn_scale(brdf: Brdf, cos_view: f32) -> f32 {
    let scale = 8.0 * PI * brdf.sigma * brdf.sigma;
    return select(scale, scale / masking(brdf, max(cos_view, MIN_COS_VIEW)), brdf.model == PAPER);
}

/// F G₁ of a facet of the slope `tangent`, F being 1 at normal incidence; in the paper's model how much more such facets count
/// than they are drawn.
fn drawn_reflectance(brdf: Brdf, tangent: f32, cos_light: f32, cos_between: f32) -> f32 {
    if (cos_light <= 0.0) {
        return 0.0;
    }
    if (brdf.model == PAPER) {
        let angle = atan(tangent);
        let cos_squared = 1.0 / (1.0 + tangent * tangent);
        let exponent = (tangent * tangent - angle * angle) / (2.0 * brdf.sigma * brdf.sigma);
        return exp(exponent) * cos_squared * cos_squared;
    }
    return masking(brdf, max(cos_light, 1e-4)) * fresnel_factor(brdf, cos_between);
}

/// Standard deviation along each axis, radians, of the light that one of `count` half vectors of the slope `tangent` stands for, of
/// those of which a part `below` of all lies nearer to the normal.
fn drawn_spread(brdf: Brdf, below: f32, tangent: f32, cos_between: f32, count: f32) -> f32 {
    let left = 1.0 - below;
    let density = select(left, left * left, brdf.model == GGX || brdf.model == METAL);
    let cos_half = inverseSqrt(1.0 + tangent * tangent);
    let half_vectors = 2.0 * PI * brdf.sigma * brdf.sigma * cos_half * cos_half * cos_half / (density * count);
    return 0.5 * sqrt(4.0 * cos_between * half_vectors / PI);
}

/// The same of the middle of the lobe for all of it.
fn middle_spread(brdf: Brdf, cos_view: f32) -> f32 {
    return 2.0 * brdf.sigma * sqrt(max(cos_view, 0.0));
}
