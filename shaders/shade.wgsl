// Every visible point shaded: diffuse texture or pseudo-albedo × irradiance (eq. 18), plus the lobes of the light (eq. 7).
//
// Irradiance and visibility of lamps are baked in texture space; light that isn't baked yet is added here from its lobes,
// with shadow maps.

#import frame.wgsl
#import mirror.wgsl
#import sky.wgsl
#import surface.wgsl

struct Lobe {
    /// Unit direction, or position relative to the centre where it is near.
    place: vec3f,
    /// Angular variance of the nodes it stands for, per axis, seen from the centre; radians².
    spread: f32,
    flux: vec3f,
    /// Bits 0–7: index; 8–9: what hides it (0 nothing, 1 visibility texture, 2 the vertices, 3 shadow map);
    /// 16: adds irradiance; 17: near; 18: no lobe shows it, as what the sky is.
    bits: u32,
}

struct ShadowMap {
    /// World (relative to the centre) to clip.
    clip_from_world: mat4x4f,
    /// Unit direction or position of the lamp's middle.
    place: vec3f,
    /// Tangent of the lamp's angular radius; its radius in mesh units where it is near.
    softness: f32,
    /// Depth range, near lamps only.
    near_plane: f32,
    far_plane: f32,
    /// Tangent of half the field of view; 0 for distant lamps.
    half_tangent: f32,
    /// Size of a texel on the surface.
    texel: f32,
}

const MAX_SHADOW_MAPS: u32 = 4u;

struct ShadowMaps {
    maps: array<ShadowMap, 4>,
}

@group(2) @binding(0) var linear_sampler: sampler;
@group(2) @binding(1) var diffuse_texture: texture_2d<f32>;
@group(2) @binding(2) var albedo_texture: texture_2d<f32>;
@group(2) @binding(3) var irradiance_texture: texture_2d<f32>;
@group(2) @binding(4) var visibility_texture: texture_2d_array<f32>;
@group(2) @binding(5) var shadow_texture: texture_depth_2d_array;
@group(2) @binding(6) var<storage, read> lobes: array<Lobe>;
@group(2) @binding(7) var<storage, read> soft_visibility: array<u32>;
@group(2) @binding(8) var<uniform> shadows: ShadowMaps;
/// Roughness and strength as multiples of the main lobe's.
@group(2) @binding(11) var gloss_texture: texture_2d<f32>;
@group(3) @binding(0) var visible: texture_2d<u32>;
@group(3) @binding(1) var coverage: texture_2d<f32>;
@group(3) @binding(2) var picture: texture_storage_2d<rgba16float, write>;

const TAPS: u32 = 12u;

/// Points of a golden spiral in the unit disc.
fn spiral(i: u32) -> vec2f {
    let angle = f32(i) * 2.3999632;
    return sqrt((f32(i) + 0.5) / f32(TAPS)) * vec2f(cos(angle), sin(angle));
}

/// Depth of the nearest surface at a place of a shadow map: 0 near the lamp, 1 far.
fn shadow_depth(map: u32, uv: vec2f) -> f32 {
    let size = vec2f(textureDimensions(shadow_texture));
    let texel = clamp(vec2i(uv * size), vec2i(0), vec2i(size) - 1);
    return textureLoad(shadow_texture, texel, map, 0);
}

/// Distance from the lamp, at a depth of the map of a near one.
fn distance_at(lamp: ShadowMap, depth: f32) -> f32 {
    return lamp.near_plane * lamp.far_plane / (lamp.far_plane - depth * (lamp.far_plane - lamp.near_plane));
}

/// Half width, in parts of the map, over which a shadow's edge spreads at the depth `here` if it is cast at `there`.
fn penumbra(lamp: ShadowMap, here: f32, there: f32) -> f32 {
    if (lamp.half_tangent == 0.0) {
        return lamp.softness * (here - there);
    }
    let receiver = distance_at(lamp, here);
    let blocker = max(distance_at(lamp, there), lamp.near_plane);
    return lamp.softness * (receiver - blocker) / blocker / (2.0 * receiver * lamp.half_tangent);
}

/// Part of a lamp that a point sees, by its shadow map: the edge's width follows from the distance between what casts the
/// shadow and the point (Fernando 2005).
fn shadow_map_visibility(map: u32, position: vec3f, face_normal: vec3f) -> f32 {
    let lamp = shadows.maps[map];
    let lifted = position + face_normal * (1.5 * lamp.texel);
    let clip = lamp.clip_from_world * vec4f(lifted, 1.0);
    let ndc = clip.xyz / clip.w;
    let uv = ndc.xy * vec2f(0.5, -0.5) + 0.5;
    let texel = 1.0 / f32(textureDimensions(shadow_texture).x);
    var blockers = 0.0;
    var depths = 0.0;
    let search = clamp(penumbra(lamp, ndc.z, 0.0) * 0.5, texel, 0.05);
    for (var i = 0u; i < TAPS; i++) {
        let depth = shadow_depth(map, uv + spiral(i) * search);
        if (depth < ndc.z) {
            blockers += 1.0;
            depths += depth;
        }
    }
    if (blockers == 0.0) {
        return 1.0;
    }
    let radius = clamp(penumbra(lamp, ndc.z, depths / blockers), 0.7 * texel, 0.05);
    var clear = 0.0;
    for (var i = 0u; i < TAPS; i++) {
        clear += select(0.0, 1.0, shadow_depth(map, uv + spiral(i) * radius) >= ndc.z);
    }
    return clear / f32(TAPS);
}

struct Shade {
    specular: vec3f,
    irradiance: vec3f,
}

/// A visible point.
struct Surface {
    position: vec3f,
    normal: vec3f,
    face_normal: vec3f,
    uv: vec2f,
    light_uv: vec2f,
}

/// The visible point that a pixel of `visible` holds.
fn surface_at(triangle: Triangle, weights: vec3f) -> Surface {
    let a = vertices[triangle.corners.x];
    let b = vertices[triangle.corners.y];
    let c = vertices[triangle.corners.z];
    let position = a.position * weights.x + b.position * weights.y + c.position * weights.z;
    let sum = a.normal * weights.x + b.normal * weights.y + c.normal * weights.z;
    let across = cross(b.position - a.position, c.position - a.position);
    let area = length(across);
    var face_normal = across / max(area, 1e-30);
    let normal = select(face_normal, sum * inverseSqrt(max(dot(sum, sum), 1e-30)), dot(sum, sum) > 1e-12);
    face_normal = select(normal, face_normal, area > 1e-30);
    let uv = triangle.uv_a.xy * weights.x + triangle.uv_a.zw * weights.y + triangle.uv_b.xy * weights.z;
    let light_uv = triangle.uv_b.zw * weights.x + triangle.uv_c.xy * weights.y + triangle.uv_c.zw * weights.z;
    return Surface(position, normal, face_normal, uv, light_uv);
}

/// Visibilities of this frame's groups at a point, from its triangle's corners.
fn soft_at(triangle: Triangle, weights: vec3f) -> array<vec4f, 6> {
    var soft: array<vec4f, 6>;
    if (frame.row_words == 0u) {
        return soft;
    }
    let rows = triangle.corners * frame.row_words + frame.first_word;
    for (var i = 0u; i < 6u; i++) {
        soft[i] = unpack4x8unorm(soft_visibility[rows.x + i]) * weights.x
            + unpack4x8unorm(soft_visibility[rows.y + i]) * weights.y
            + unpack4x8unorm(soft_visibility[rows.z + i]) * weights.z;
    }
    return soft;
}

/// What the point in work sees of lamps, of groups and of lamps with shadow maps.
var<private> lamp_words: array<vec4f, 8>;
var<private> soft: array<vec4f, 6>;
var<private> mapped: vec4f;

fn add_lobes(surface: Surface, brdf: Brdf, terms: ViewTerms, range: vec2u, weight: f32) -> Shade {
    var sum = Shade(vec3f(0.0), vec3f(0.0));
    for (var i = range.x; i < range.y; i++) {
        let light = lobes[i];
        let index = light.bits & 0xffu;
        let kind = (light.bits >> 8u) & 3u;
        var l = light.place;
        var falloff = 1.0;
        if ((light.bits & 0x20000u) != 0u) {
            let offset = light.place - surface.position;
            let squared_radius = dot(light.place, light.place);
            let squared = max(dot(offset, offset), 0.01 * squared_radius);
            l = offset * inverseSqrt(squared);
            falloff = squared_radius / squared;
        }
        let cos_light = dot(l, surface.normal);
        let spread = light.spread * falloff;
        if (above_horizon(min(cos_light, dot(l, surface.face_normal)), spread) <= 0.0) {
            continue;
        }
        let live = (light.bits & 0x10000u) != 0u;
        var value = 0.0;
        if (brdf.model != NO_LOBE && (light.bits & 0x40000u) == 0u) {
            value = lobe(brdf, terms, l, spread);
        }
        if (value == 0.0 && !live) {
            continue;
        }
        var seen = 1.0;
        if (kind == 1u) {
            seen = lamp_words[index / 4u][index % 4u];
        } else if (kind == 2u) {
            seen = soft[index / 4u][index % 4u];
        } else if (kind == 3u) {
            seen = mapped[index];
        }
        let arriving = light.flux * (falloff * weight * seen);
        sum.specular += arriving * value;
        if (live) {
            sum.irradiance += arriving * (max(cos_light, 0.0) * diffuse_entry(brdf, cos_light) * frame.irradiance_scale);
        }
    }
    return sum;
}

/// Reads the visibilities of a place in the visibility texture: four lamps to a layer.
fn read_lamps(light_uv: vec2f) {
    for (var layer = 0u; layer < min(textureNumLayers(visibility_texture), 8u); layer++) {
        lamp_words[layer] = textureSampleLevel(visibility_texture, linear_sampler, light_uv, layer, 0.0);
    }
}

const BEAUTY: u32 = 0u;
const DIFFUSE: u32 = 1u;
const SPECULAR: u32 = 2u;
const ALBEDO: u32 = 3u;
const IRRADIANCE: u32 = 4u;
const NORMALS: u32 = 5u;
const SHADOW: u32 = 6u;
const CONFIDENCE: u32 = 7u;
/// Roughness of a part, as a multiple of the main lobe's, whose logarithm is stored as 0.
const LEAST_GLOSS_ROUGHNESS: f32 = 0.01;
const ROUGHNESS: u32 = 8u;
const STRENGTH: u32 = 9u;
const STORED: u32 = 1u;
const COVERAGE: u32 = 2u;
const LARGEST: f32 = 6e4;

/// Specular reflection of other parts of the surface and of the sky.
fn mirrored(brdf: Brdf, triangle: Triangle, surface: Surface, view: vec3f) -> vec3f {
    if (brdf.model == NO_LOBE || (brdf.model == PAPER && !has_sky())) {
        return vec3f(0.0);
    }
    let open = min(vertices[triangle.corners.x].openness,
        min(vertices[triangle.corners.y].openness, vertices[triangle.corners.z].openness));
    // Nothing of the surface is in sight of what sees the whole sky.
    let is_sheltered = frame.walk_nodes != 0u && open < 1.0;
    if (!is_sheltered && !has_sky()) {
        return vec3f(0.0);
    }
    if (frame.half_vector >= LOBE_FRAMES) {
        return mirrored_moving(brdf, surface, view, is_sheltered);
    }
    let lobe = drawn(brdf, half_vectors(), surface.normal, view);
    var sum = vec3f(0.0);
    for (var i = frame.half_vector; i < lobe.count; i += LOBE_FRAMES) {
        sum += mirrored_by(brdf, drawn_ray(brdf, lobe, i, surface.normal, view), surface, is_sheltered);
    }
    // The mean over the frames is the lobe.
    return sum * f32(LOBE_FRAMES);
}

/// The same while things move: what hides the middle of the lobe hides all of it.
fn mirrored_moving(brdf: Brdf, surface: Surface, view: vec3f, is_sheltered: bool) -> vec3f {
    let middle = middle_ray(brdf, surface.normal, view);
    if (is_sheltered && dot(middle.direction, surface.face_normal) > 0.0) {
        let hit = trace(surface.position + surface.face_normal * (ORIGIN_LIFT * frame.radius), middle.direction);
        if (hit.triangle != NOTHING) {
            return mirrored_surface(brdf, middle, hit);
        }
    }
    var sum = vec3f(0.0);
    if (has_sky()) {
        let lobe = drawn(brdf, FEW_HALF_VECTORS, surface.normal, view);
        for (var i = 0u; i < lobe.count; i++) {
            sum += mirrored_by(brdf, drawn_ray(brdf, lobe, i, surface.normal, view), surface, false);
        }
    }
    return sum;
}

/// What one ray shows.
fn mirrored_by(brdf: Brdf, ray: MirrorRay, surface: Surface, is_sheltered: bool) -> vec3f {
    if (dot(ray.direction, surface.face_normal) <= 0.0) {
        return vec3f(0.0);
    }
    if (is_sheltered) {
        let hit = trace(surface.position + surface.face_normal * (ORIGIN_LIFT * frame.radius), ray.direction);
        if (hit.triangle != NOTHING) {
            return mirrored_surface(brdf, ray, hit);
        }
    }
    if (!has_sky()) {
        return vec3f(0.0);
    }
    return sky_radiance(ray.direction, ray.sky_spread) * (ray.sky_weight * lobe_height(brdf));
}

/// Peak of a part's lobe as a multiple of the main one's: a lobe of the same strength is lower the wider it is.
fn lobe_height(brdf: Brdf) -> f32 {
    let wider = brdf.sigma / max(frame.sigma, 1e-9);
    return brdf.strength / max(frame.strength, 1e-9) / max(wider * wider, 1e-9);
}

/// What a ray shows of the surface where it meets it.
fn mirrored_surface(brdf: Brdf, ray: MirrorRay, hit: Hit) -> vec3f {
    let there = surface_at(triangles[hit.triangle], hit.weights);
    let cosine = -dot(there.normal, ray.direction);
    // The paper's model leaves open how much is mirrored.
    if (cosine <= 0.0 || dot(there.face_normal, ray.direction) >= 0.0 || brdf.model == PAPER) {
        return vec3f(0.0);
    }
    var radiance: vec3f;
    if ((frame.flags & STORED) != 0u) {
        radiance = textureSampleLevel(diffuse_texture, linear_sampler, there.uv, 0.0).rgb;
    } else {
        radiance = textureSampleLevel(albedo_texture, linear_sampler, there.uv, 0.0).rgb
            * (textureSampleLevel(irradiance_texture, linear_sampler, there.light_uv, 0.0).rgb + frame.ambient);
    }
    var gloss = gloss_at(there.uv);
    radiance *= diffuse_exit(brdf_of(gloss), cosine);
    if (is_metal(brdf)) {
        // The ray stands for all in its half vector's extent: a lobe as much wider shows no sparks.
        let wider = length(vec2f(gloss.roughness, ray.extent * brdf.sigma / frame.sigma));
        gloss.roughness = min(wider, 1.0 / frame.sigma);
        radiance += lit(triangles[hit.triangle], hit.weights, there, gloss, -ray.direction).specular;
        radiance += sky_in_mirror(triangles[hit.triangle], hit.weights, there, gloss, -ray.direction);
    }
    return radiance * frame.tint * ray.weight;
}

/// What a point that is seen in a mirror shows of the sky, by the middle of its lobe; it is hidden as much as the whole sky.
fn sky_in_mirror(triangle: Triangle, weights: vec3f, surface: Surface, gloss: Gloss, view: vec3f) -> vec3f {
    if (!has_sky()) {
        return vec3f(0.0);
    }
    let brdf = brdf_of(gloss);
    let ray = middle_ray(brdf, surface.normal, view);
    let open = vertices[triangle.corners.x].openness * weights.x + vertices[triangle.corners.y].openness * weights.y
        + vertices[triangle.corners.z].openness * weights.z;
    let seen = select(0.0, open, dot(ray.direction, surface.face_normal) > 0.0);
    return sky_radiance(ray.direction, ray.sky_spread) * (ray.sky_weight * lobe_height(brdf) * seen * gloss.tint);
}

/// What light that comes straight from the lamps makes of a point, seen from the unit direction `view`.
fn lit(triangle: Triangle, weights: vec3f, surface: Surface, gloss: Gloss, view: vec3f) -> Shade {
    read_visibility(triangle, weights, surface);
    let brdf = brdf_of(gloss);
    let terms = view_terms(brdf, surface.normal, view);
    var sum = add_lobes(surface, brdf, terms, frame.always, 1.0);
    if (frame.window.y > frame.window.x) {
        let more = add_lobes(surface, brdf, terms, frame.window, frame.window_weight);
        sum.specular += more.specular;
        sum.irradiance += more.irradiance;
    }
    sum.specular *= lobe_height(brdf) * gloss.tint;
    return sum;
}

/// Reads what a point sees of lamps, of groups and of lamps with shadow maps.
fn read_visibility(triangle: Triangle, weights: vec3f, surface: Surface) {
    read_lamps(surface.light_uv);
    soft = soft_at(triangle, weights);
    mapped = vec4f(1.0);
    for (var i = 0u; i < MAX_SHADOW_MAPS; i++) {
        if ((frame.flags & (16u << i)) != 0u) {
            let lamp = shadows.maps[i];
            let towards = select(lamp.place, lamp.place - surface.position, lamp.half_tangent > 0.0);
            if (dot(towards, surface.face_normal) > 0.0) {
                mapped[i] = shadow_map_visibility(i, surface.position, surface.face_normal);
            }
        }
    }
}

/// What a lamp's shadow mode shows.
fn shown_visibility() -> f32 {
    let at = frame.shown_lamp;
    if (at >= 256u + MAX_SHADOW_MAPS) {
        return 1.0;
    }
    if (at >= 256u) {
        return mapped[at - 256u];
    }
    return lamp_words[at / 4u][at % 4u];
}

/// How the lobe of a place differs from the main one.
struct Gloss {
    /// Roughness and strength as multiples of the main lobe's.
    roughness: f32,
    strength: f32,
    /// Colour of what it reflects beside the main lobe, of mean 1.
    tint: vec3f,
}

/// The gloss of a place; between texels roughness is weighted by strength. The texture has the strength in each channel.
fn gloss_at(uv: vec2f) -> Gloss {
    let stored = textureSampleLevel(gloss_texture, linear_sampler, uv, 0.0);
    let strength = dot(stored.rgb, vec3f(1.0 / 3.0));
    let divisor = max(strength, 1e-6);
    let tint = select(vec3f(1.0), stored.rgb / divisor, strength > 0.0);
    return Gloss(LEAST_GLOSS_ROUGHNESS * exp(stored.a / divisor), strength, tint);
}

/// The lobe of a part of the surface.
fn brdf_of(gloss: Gloss) -> Brdf {
    return Brdf(frame.model, frame.sigma * gloss.roughness, frame.strength * gloss.strength);
}

/// √α of the lobe, as other programs call roughness; 1 where nothing is reflected.
fn shown_roughness(gloss: Gloss) -> f32 {
    if (frame.model == NO_LOBE || gloss.strength <= 0.0) {
        return 1.0;
    }
    return sqrt(min(sqrt(2.0) * frame.sigma * gloss.roughness, 1.0));
}

/// The picture's value at a visible point.
fn shade(triangle: Triangle, weights: vec3f) -> vec3f {
    let surface = surface_at(triangle, weights);
    if (frame.mode == NORMALS) {
        return surface.normal * 0.5 + 0.5;
    }
    let stored = textureSampleLevel(diffuse_texture, linear_sampler, surface.uv, 0.0);
    if (frame.mode == CONFIDENCE) {
        return vec3f(stored.a);
    }
    let albedo = textureSampleLevel(albedo_texture, linear_sampler, surface.uv, 0.0).rgb;
    if (frame.mode == ALBEDO) {
        return albedo;
    }
    let gloss = gloss_at(surface.uv);
    if (frame.mode == ROUGHNESS) {
        return vec3f(shown_roughness(gloss));
    }
    if (frame.mode == STRENGTH) {
        return vec3f(select(gloss.strength / max(frame.strongest, 1e-6), 0.0, frame.model == NO_LOBE));
    }
    if (frame.mode == SHADOW) {
        read_visibility(triangle, weights, surface);
        return vec3f(shown_visibility());
    }
    let brdf = brdf_of(gloss);
    let view = normalize(eye() - surface.position);
    var sum = lit(triangle, weights, surface, gloss, view);
    let baked = textureSampleLevel(irradiance_texture, linear_sampler, surface.light_uv, 0.0).rgb;
    let irradiance = baked + sum.irradiance + frame.ambient;
    if (frame.mode == IRRADIANCE) {
        return min(irradiance, vec3f(LARGEST));
    }
    if (frame.mode != DIFFUSE) {
        sum.specular += mirrored(brdf, triangle, surface, view) * gloss.tint;
    }
    let through = diffuse_exit(brdf, dot(surface.normal, view));
    let diffuse = select(albedo * irradiance, stored.rgb, (frame.flags & STORED) != 0u) * through;
    var radiance = diffuse + sum.specular;
    if (frame.mode == DIFFUSE) {
        radiance = diffuse;
    } else if (frame.mode == SPECULAR) {
        radiance = sum.specular;
    }
    return min(radiance, vec3f(LARGEST));
}

/// The neighbours of a pixel, the nearest first.
const AROUND: array<vec2i, 9> = array<vec2i, 9>(vec2i(0, 0), vec2i(1, 0), vec2i(-1, 0), vec2i(0, 1), vec2i(0, -1),
    vec2i(1, 1), vec2i(-1, 1), vec2i(1, -1), vec2i(-1, -1));

/// A pixel of the picture: radiance times coverage, and coverage.
fn shaded(pixel: vec2i) -> vec4f {
    var seen = textureLoad(visible, pixel, 0).xy;
    var covered = 1.0;
    if ((frame.flags & COVERAGE) != 0u) {
        covered = textureLoad(coverage, pixel, 0).x;
        if (covered == 0.0) {
            return vec4f(0.0);
        }
        // At a silhouette the pixel's centre may miss what some of its samples meet.
        var around = AROUND;
        let last = vec2i(textureDimensions(visible)) - 1;
        for (var i = 1u; i < 9u && seen.x == 0u; i++) {
            seen = textureLoad(visible, clamp(pixel + around[i], vec2i(0), last), 0).xy;
        }
    }
    if (seen.x == 0u) {
        return vec4f(0.0);
    }
    let b = unpack2x16unorm(seen.y);
    return vec4f(shade(triangles[seen.x - 1u], vec3f(1.0 - b.x - b.y, b)), 1.0) * covered;
}

@compute @workgroup_size(8, 8)
fn shade_pixels(@builtin(global_invocation_id) id: vec3u) {
    let pixel = vec2u(id.x, id.y + frame.rows.x);
    if (pixel.x < textureDimensions(visible).x && pixel.y < frame.rows.y) {
        textureStore(picture, pixel, shaded(vec2i(pixel)));
    }
}
