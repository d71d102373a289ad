#version 300 es
// Depth of the surface seen from a light.
precision highp float;
layout(location = 0) in vec3 place;
uniform mat4 clip_from_object;
uniform vec3 low;
uniform vec3 size;

void main() {
    gl_Position = clip_from_object * vec4(low + size * place, 1.0);
}
