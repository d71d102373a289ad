// Adds a frame to the mean of those before: blended one on one.

#import fullscreen.wgsl

@group(0) @binding(0) var sample_frame: texture_2d<f32>;
/// x: one over the number of frames.
@group(0) @binding(1) var<uniform> weight: vec4f;

@fragment
fn accumulate_fragment(@builtin(position) at: vec4f) -> @location(0) vec4f {
    return textureLoad(sample_frame, vec2i(at.xy), 0) * weight.x;
}
