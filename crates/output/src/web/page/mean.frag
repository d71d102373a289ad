#version 300 es
// The mean of all pictures so far.
precision highp float;
uniform highp sampler2D newest;
uniform highp sampler2D before;
/// The newest picture's share.
uniform float share;
out vec4 mean;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 added = texelFetch(newest, pixel, 0);
    mean = share >= 1.0 ? added : mix(texelFetch(before, pixel, 0), added, share);
}
