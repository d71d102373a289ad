#version 300 es
// What a visible point looks like: twin of shaders/shade.wgsl and shaders/brdf.wgsl, where the formulas are explained.
precision highp float;
precision highp int;
precision highp sampler2DShadow;
in vec3 position;
in vec3 normal;
in vec2 uv;
in vec3 indirect;
uniform sampler2D diffuse_texture;
uniform sampler2D gloss_texture;
/// Depths as lights see the surface, in tiles; compared and as they are.
uniform sampler2DShadow shadow_test;
uniform highp sampler2D shadow_depths;
/// Lobes of the light, ten texels each; see `Renderer.writeLobes`.
uniform highp sampler2D lobes;
uniform int lobe_count;
/// While things move, shadows' edges are softened here and not by the mean over many pictures.
uniform bool moving;
/// The captured light: the texture holds radiance, else pseudo-albedo.
uniform bool stored;
uniform float texture_scale;
uniform bool has_gloss;
uniform vec4 gloss_scale;
uniform vec3 eye;
uniform vec3 ambient;
uniform int model;
uniform float main_sigma;
/// That of the main lobe, as a multiple of what such surfaces usually have.
uniform float main_strength;
out vec4 radiance;

const int PAPER = 0;
const int BECKMANN = 1;
const int GGX = 2;
const int METAL = 3;
const int NO_LOBE = 4;
const float MIN_COS_VIEW = 1e-3;
const float REFRACTIVE_INDEX = 1.5;
const float NORMAL_FRESNEL = 0.04;
const float MOST_OF_DIELECTRIC = 4.0;
const float CUT_EXPONENT = 11.5;
const float LEAST_GLOSS_ROUGHNESS = 0.01;
const float LARGEST = 6e4;
const int TAPS = 12;

float sigma;
float strength;

float fresnel(float c) {
    float g = sqrt(REFRACTIVE_INDEX * REFRACTIVE_INDEX - 1.0 + c * c);
    float a = (g - c) / (g + c);
    float b = (c * (g + c) - 1.0) / (c * (g - c) + 1.0);
    return 0.5 * a * a * (1.0 + b * b);
}

// Fresnel factor on facets, 1 at normal incidence: that of metals beside dielectrics rises less.
float fresnel_factor(float c) {
    if (model == METAL) {
        return 1.0;
    }
    float reflected = min((strength > MOST_OF_DIELECTRIC ? strength : 1.0) * NORMAL_FRESNEL, 1.0);
    float rise = (1.0 - reflected) / reflected * (NORMAL_FRESNEL / (1.0 - NORMAL_FRESNEL));
    return mix(1.0, fresnel(c) / NORMAL_FRESNEL, rise);
}

float masking(float c) {
    float tangent = sqrt(max(1.0 - c * c, 0.0)) / c;
    if (model == GGX || model == METAL) {
        return 2.0 / (1.0 + sqrt(1.0 + 2.0 * sigma * sigma * tangent * tangent));
    }
    float a = 1.0 / max(1.414213562 * sigma * tangent, 1e-6);
    return a < 1.6 ? a * (3.535 + 2.181 * a) / (1.0 + a * (2.276 + 2.577 * a)) : 1.0;
}

float squared_arccos(float c) {
    float p = -0.0012624911;
    p = p * c + 0.00667009;
    p = p * c - 0.017088126;
    p = p * c + 0.03089188;
    p = p * c - 0.050174303;
    p = p * c + 0.08897899;
    p = p * c - 0.2145988;
    p = p * c + 1.5707963;
    return (1.0 - c) * p * p;
}

float smooth_transmittance(float cosine) {
    float part = min(strength, 1.0);
    return (1.0 - part * fresnel(clamp(cosine, 1e-3, 1.0))) / (1.0 - part * NORMAL_FRESNEL);
}

float ggx_reflectance(float cosine) {
    float c = clamp(cosine, 1e-3, 1.0);
    float alpha = 1.414213562 * sigma;
    float tilt = 1.0 - c;
    float steeper = min(c * c + 1.0738 * pow(alpha, 1.4252) * pow(tilt, 0.8577), 1.0);
    float lost = 1.0 + alpha * alpha * (1.3559 - 2.7057 * pow(tilt, 2.5463));
    return min(fresnel(sqrt(steeper)) / max(lost, 0.2), 0.99);
}

float diffuse_entry(float cosine) {
    return model == BECKMANN ? smooth_transmittance(cosine) : 1.0;
}

float diffuse_exit(float cosine) {
    if (model == BECKMANN) {
        return smooth_transmittance(cosine);
    }
    if (model == GGX) {
        float part = min(strength, 1.0);
        return (1.0 - part * ggx_reflectance(cosine)) / (1.0 - part * ggx_reflectance(1.0));
    }
    return 1.0;
}

float above_horizon(float cos_light, float spread) {
    float radius = 2.0 * sqrt(spread);
    return clamp(0.5 + 0.5 * cos_light / max(radius, 1e-6), 0.0, 1.0);
}

/// The lobe for light from `light` that is spread about it; `scale` is masking towards the viewer over cos θ_r.
float lobe(vec3 n, vec3 view, float scale, vec3 light, float spread) {
    float cos_light = dot(n, light);
    float above = above_horizon(cos_light, spread);
    if (above <= 0.0) {
        return 0.0;
    }
    vec3 sum = light + view;
    float inverse_length = inversesqrt(max(dot(sum, sum), 1e-12));
    vec3 half_vector = sum * inverse_length;
    float cos_half = clamp(dot(n, half_vector), 1e-3, 1.0);
    float cos_between = max(0.5 / inverse_length, 0.05);
    float variance = sigma * sigma;
    vec3 along = light - view;
    float along_squared = dot(along, along);
    vec3 offset = n - half_vector * cos_half;
    float offset_squared = dot(offset, offset);
    float projected = dot(offset, along);
    float share = along_squared * offset_squared > 1e-14
        ? projected * projected / max(along_squared * offset_squared, 1e-20) : 0.5;
    float width_along = variance + 0.25 * spread;
    float width_across = variance + 0.25 * spread / (cos_between * cos_between);
    float cos_squared = cos_half * cos_half;
    float squared = model == PAPER ? squared_arccos(cos_half) : (1.0 - cos_squared) / cos_squared;
    float exponent = 0.5 * squared * (share / width_along + (1.0 - share) / width_across);
    float height = above * scale * variance * inversesqrt(width_along * width_across);
    float density;
    if (model == GGX || model == METAL) {
        density = 1.0 / ((1.0 + exponent) * (1.0 + exponent));
    } else {
        if (exponent > CUT_EXPONENT) {
            return 0.0;
        }
        density = exp(-exponent);
    }
    if (model == PAPER) {
        return height * density;
    }
    return height * density * fresnel_factor(0.5 / inverse_length) * masking(max(cos_light, 1e-4)) / (cos_squared * cos_squared);
}

vec2 spiral(int i) {
    float angle = float(i) * 2.3999632;
    return sqrt((float(i) + 0.5) / float(TAPS)) * vec2(cos(angle), sin(angle));
}

/// Half width, in parts of the tile, over which a shadow's edge spreads at the depth `here` if it is cast at `there`. `lens` is
/// softness, half tangent, near and far plane.
float penumbra(vec4 lens, float here, float there) {
    if (lens.y == 0.0) {
        return lens.x * (here - there);
    }
    float receiver = lens.z * lens.w / (lens.w - here * (lens.w - lens.z));
    float blocker = max(lens.z * lens.w / (lens.w - there * (lens.w - lens.z)), lens.z);
    return lens.x * (receiver - blocker) / blocker / (2.0 * receiver * lens.y);
}

/// Part of a lobe's light that reaches the point, by its tile.
float visibility(int i, vec3 face_normal) {
    vec4 lens = texelFetch(lobes, ivec2(6, i), 0);
    if (lens.x < 0.0) {
        return 1.0;
    }
    mat4 tile_from_object = mat4(texelFetch(lobes, ivec2(2, i), 0), texelFetch(lobes, ivec2(3, i), 0),
        texelFetch(lobes, ivec2(4, i), 0), texelFetch(lobes, ivec2(5, i), 0));
    vec4 tile = texelFetch(lobes, ivec2(7, i), 0);
    vec4 clip = tile_from_object * vec4(position + face_normal * (1.5 * tile.w), 1.0);
    vec3 at = clip.xyz / clip.w * 0.5 + 0.5;
    float texel = 1.0 / (tile.z * float(textureSize(shadow_depths, 0).x));
    vec2 least = vec2(texel);
    vec2 most = vec2(1.0 - texel);
    if (!moving) {
        return texture(shadow_test, vec3(tile.xy + tile.z * clamp(at.xy, least, most), at.z));
    }
    float blockers = 0.0;
    float depths = 0.0;
    float search = clamp(penumbra(lens, at.z, 0.0) * 0.5, texel, 0.05);
    for (int k = 0; k < TAPS; k++) {
        vec2 there = clamp(at.xy + spiral(k) * search, least, most);
        float depth = texture(shadow_depths, tile.xy + tile.z * there).r;
        if (depth < at.z) {
            blockers += 1.0;
            depths += depth;
        }
    }
    if (blockers == 0.0) {
        return 1.0;
    }
    float radius = clamp(penumbra(lens, at.z, depths / blockers), 0.7 * texel, 0.05);
    float clear = 0.0;
    for (int k = 0; k < TAPS; k++) {
        vec2 there = clamp(at.xy + spiral(k) * radius, least, most);
        clear += texture(shadow_test, vec3(tile.xy + tile.z * there, at.z));
    }
    return clear / float(TAPS);
}

/// Unit direction to a place of the light and fall-off; `near` is a near light's squared distance from the centre.
vec4 towards(vec3 place, float near) {
    if (near == 0.0) {
        return vec4(place, 1.0);
    }
    vec3 offset = place - position;
    float squared = max(dot(offset, offset), 0.01 * near);
    return vec4(offset * inversesqrt(squared), near / squared);
}

void main() {
    vec3 n = normalize(normal);
    vec3 view = normalize(eye - position);
    vec3 across = cross(dFdx(position), dFdy(position));
    vec3 face_normal = dot(across, across) > 0.0 ? normalize(across) : n;
    // Towards the side that the triangle's corners say, whichever is seen.
    face_normal *= (dot(face_normal, view) < 0.0) == gl_FrontFacing ? -1.0 : 1.0;
    float roughness = 1.0;
    vec3 part = vec3(1.0);
    float mean_part = 1.0;
    if (has_gloss) {
        vec4 gloss = texture(gloss_texture, uv) * gloss_scale;
        part = gloss.rgb;
        mean_part = dot(part, vec3(1.0 / 3.0));
        roughness = LEAST_GLOSS_ROUGHNESS * exp(gloss.a / max(mean_part, 1e-6));
    }
    sigma = main_sigma * roughness;
    strength = main_strength * mean_part;
    float cos_view = max(dot(n, view), MIN_COS_VIEW);
    float scale = (model == PAPER || model == NO_LOBE ? 1.0 : masking(cos_view)) / cos_view;
    vec3 specular = vec3(0.0);
    vec3 irradiance = ambient + indirect;
    for (int i = 0; i < lobe_count; i++) {
        vec4 place = texelFetch(lobes, ivec2(0, i), 0);
        vec4 flux = texelFetch(lobes, ivec2(1, i), 0);
        vec4 sample_place = texelFetch(lobes, ivec2(8, i), 0);
        vec4 middle = towards(place.xyz, flux.w);
        float spread = place.w * middle.w;
        float value = 0.0;
        if (model != NO_LOBE && strength > 0.0
            && above_horizon(min(dot(n, middle.xyz), dot(face_normal, middle.xyz)), spread) > 0.0) {
            value = lobe(n, view, scale, middle.xyz, spread);
        }
        vec4 drawn = towards(sample_place.xyz, flux.w);
        float cos_light = dot(n, drawn.xyz);
        float arriving = 0.0;
        if (!stored && cos_light > 0.0 && dot(face_normal, drawn.xyz) > 0.0) {
            arriving = drawn.w * cos_light * diffuse_entry(cos_light);
        }
        if (value == 0.0 && arriving == 0.0) {
            continue;
        }
        float seen = visibility(i, face_normal);
        specular += flux.rgb * (value * seen * middle.w);
        irradiance += flux.rgb * (arriving * seen);
    }
    // A lobe of the same strength is lower the wider it is.
    specular *= part / (roughness * roughness);
    vec3 diffuse = texture(diffuse_texture, uv).rgb * texture_scale * diffuse_exit(dot(n, view));
    if (!stored) {
        diffuse *= irradiance;
    }
    radiance = vec4(min(diffuse + specular, vec3(LARGEST)), 1.0);
}
