#version 300 es
// Display values of linear radiance: twin of shaders/view_transform.wgsl, where the formulas' sources are named.
precision highp float;
uniform highp sampler2D picture;
uniform float exposure;
uniform int transform;
uniform vec3 background;
out vec4 shown;

vec3 srgb_encode(vec3 linear) {
    vec3 c = clamp(linear, 0.0, 1.0);
    return mix(1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, 12.92 * c, lessThanEqual(c, vec3(0.0031308)));
}

vec3 agx(vec3 linear) {
    mat3 to_rec2020 = mat3(0.6274, 0.0691, 0.0164, 0.3293, 0.9195, 0.0880, 0.0433, 0.0113, 0.8956);
    mat3 from_rec2020 = mat3(1.6605, -0.1246, -0.0182, -0.5876, 1.1329, -0.1006, -0.0728, -0.0083, 1.1187);
    mat3 inset = mat3(0.856627153315983, 0.137318972929847, 0.11189821299995, 0.0951212405381588,
        0.761241990602591, 0.0767994186031903, 0.0482516061458583, 0.101439036467562, 0.811302368396859);
    mat3 outset = mat3(1.1271005818144368, -0.1413297634984383, -0.14132976349843826, -0.11060664309660323,
        1.157823702216272, -0.11060664309660294, -0.016493938717834573, -0.016493938717834257, 1.2519364065950405);
    vec3 stops = log2(max(inset * (to_rec2020 * linear), 1e-10));
    vec3 x = clamp((stops + 12.47393) / (4.026069 + 12.47393), 0.0, 1.0);
    vec3 x2 = x * x;
    vec3 x4 = x2 * x2;
    vec3 curve = 15.5 * x4 * x2 - 40.14 * x4 * x + 31.96 * x4 - 6.868 * x2 * x + 0.4298 * x2 + 0.1191 * x - 0.00232;
    return from_rec2020 * pow(max(outset * curve, 0.0), vec3(2.2));
}

vec3 aces(vec3 linear) {
    mat3 inner = mat3(0.59719, 0.07600, 0.02840, 0.35458, 0.90834, 0.13383, 0.04823, 0.01566, 0.83777);
    mat3 outer = mat3(1.60475, -0.10208, -0.00327, -0.53108, 1.10813, -0.07276, -0.07367, -0.00605, 1.07602);
    vec3 v = inner * min(linear, 1e15);
    return outer * ((v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.4329510) + 0.238081));
}

vec3 pbr_neutral(vec3 linear) {
    float start = 0.8 - 0.04;
    float least = min(linear.r, min(linear.g, linear.b));
    float offset = least < 0.08 ? least - 6.25 * least * least : 0.04;
    vec3 colour = linear - offset;
    float peak = max(colour.r, max(colour.g, colour.b));
    if (peak < start) {
        return colour;
    }
    float room = 1.0 - start;
    float new_peak = 1.0 - room * room / (peak + room - start);
    float grey = 1.0 - 1.0 / (0.15 * (peak - new_peak) + 1.0);
    return mix(colour * (new_peak / peak), vec3(new_peak), grey);
}

void main() {
    vec4 mean = texelFetch(picture, ivec2(gl_FragCoord.xy), 0);
    vec3 linear = max(mean.rgb / max(mean.a, 1e-6) * exposure, 0.0);
    vec3 display = srgb_encode(transform == 1 ? agx(linear) : transform == 2 ? aces(linear)
        : transform == 3 ? pbr_neutral(linear) : linear);
    shown = vec4(mix(background, display, clamp(mean.a, 0.0, 1.0)), 1.0);
}
