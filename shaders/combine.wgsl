// Adds a baked layer to the irradiance of all light: blended one on one, so that a sum is as many draws as it has layers.

#import fullscreen.wgsl

@group(0) @binding(0) var layer: texture_2d<f32>;
/// Colour of the light that the layer was baked for with unit flux.
@group(0) @binding(1) var<uniform> weight: vec4f;

@fragment
fn combine_fragment(@builtin(position) at: vec4f) -> @location(0) vec4f {
    return textureLoad(layer, vec2i(at.xy), 0) * weight;
}
