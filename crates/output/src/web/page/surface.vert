#version 300 es
// A vertex of the surface, unpacked, with what the surface sends to it.
precision highp float;
layout(location = 0) in vec3 place;
layout(location = 1) in vec2 facing;
layout(location = 2) in vec2 texture_place;
layout(location = 3) in uint vertex;
uniform mat4 clip_from_object;
uniform vec3 low;
uniform vec3 size;
/// Per vertex ten texels in a row: how much of each coefficient of the light arrives by way of the surface.
uniform highp sampler2D transfer;
uniform bool has_transfer;
/// Coefficients of the light, in units of the stored bytes.
uniform vec3 coefficients[10];
out vec3 position;
out vec3 normal;
out vec2 uv;
out vec3 indirect;
invariant gl_Position;

const uint PER_ROW = 400u;

void main() {
    position = low + size * place;
    gl_Position = clip_from_object * vec4(position, 1.0);
    uv = texture_place;
    vec2 flat_place = facing * 2.0 - 1.0;
    float height = 1.0 - abs(flat_place.x) - abs(flat_place.y);
    float fold = max(-height, 0.0);
    normal = normalize(vec3(flat_place - fold * vec2(flat_place.x < 0.0 ? -1.0 : 1.0, flat_place.y < 0.0 ? -1.0 : 1.0), height));
    indirect = vec3(0.0);
    if (has_transfer) {
        ivec2 first = ivec2(10u * (vertex % PER_ROW), vertex / PER_ROW);
        for (int k = 0; k < 10; k++) {
            indirect += coefficients[k] * texelFetch(transfer, first + ivec2(k, 0), 0).rgb;
        }
    }
}
