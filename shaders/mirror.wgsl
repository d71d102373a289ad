// What the surface mirrors of itself and of the sky: the twin of `relight/reflection.rs`. Some half vectors of the lobe a frame;
// sixteen frames make the lobe.

#import frame.wgsl
#import sky.wgsl
#import surface.wgsl

/// A node of the hierarchy, visited from one to the next; a missed box skips all that is in it.
struct WalkNode {
    low: vec3f,
    /// Where to go on past a missed box; of a leaf the first of its triangles.
    next: u32,
    high: vec3f,
    /// Triangles of a leaf, 0 for others.
    count: u32,
}

@group(2) @binding(9) var<storage, read> walk: array<WalkNode>;
@group(2) @binding(10) var<storage, read> walk_triangles: array<u32>;

/// Frames that a lobe's half vectors are spread over, and half vectors of each: a sky may have edges, which few would show one by
/// one.
const LOBE_FRAMES: u32 = 16u;
const SKY_RAYS: u32 = 4u;
/// Half vectors of a lobe while things move.
const FEW_HALF_VECTORS: u32 = 4u;
/// Lift of a ray's origin, in parts of the object's radius, and a triangle's tolerance in barycentric units.
const ORIGIN_LIFT: f32 = 2e-5;
const EDGE_TOLERANCE: f32 = 1e-6;
const NOTHING: u32 = 0xffffffffu;

struct Hit {
    triangle: u32,
    weights: vec3f,
}

/// The first triangle along a ray.
fn trace(origin: vec3f, direction: vec3f) -> Hit {
    let inverse = 1.0 / select(direction, vec3f(1e-12), abs(direction) < vec3f(1e-12));
    var hit = Hit(NOTHING, vec3f(0.0));
    var nearest = 1e30;
    var at = 0u;
    while (at < frame.walk_nodes) {
        let node = walk[at];
        let a = (node.low - origin) * inverse;
        let b = (node.high - origin) * inverse;
        let enter = min(a, b);
        let leave = max(a, b);
        let first = max(max(enter.x, enter.y), max(enter.z, 0.0));
        let last = min(min(leave.x, leave.y), min(leave.z, nearest));
        if (first > last) {
            at = select(node.next, at + 1u, node.count > 0u);
            continue;
        }
        for (var i = 0u; i < node.count; i++) {
            let index = walk_triangles[node.next + i];
            let corners = triangles[index].corners;
            // Möller and Trumbore (1997).
            let corner = vertices[corners.x].position;
            let edge1 = vertices[corners.y].position - corner;
            let edge2 = vertices[corners.z].position - corner;
            let p = cross(direction, edge2);
            let det = dot(edge1, p);
            let from_corner = origin - corner;
            let b1 = dot(from_corner, p) / det;
            let q = cross(from_corner, edge1);
            let b2 = dot(direction, q) / det;
            let distance = dot(edge2, q) / det;
            let inside = b1 >= -EDGE_TOLERANCE && b2 >= -EDGE_TOLERANCE && b1 + b2 <= 1.0 + EDGE_TOLERANCE;
            if (det != 0.0 && inside && distance > 0.0 && distance < nearest) {
                nearest = distance;
                hit = Hit(index, vec3f(1.0 - b1 - b2, b1, b2));
            }
        }
        at += 1u;
    }
    return hit;
}

/// Half vectors of a lobe in a still picture.
fn half_vectors() -> u32 {
    return LOBE_FRAMES * select(1u, SKY_RAYS, has_sky());
}

/// The part of all facets that lies nearer to the normal than one of so many half vectors of the lobe.
fn facets_below(i: u32, count: u32) -> f32 {
    return (f32(i) + 0.5) / f32(count);
}

/// A half vector of the lobe about +Z, by its place among all facets: for Beckmann, tan² of the tilt is exponential with the
/// mean 2σ².
fn lobe_half_vector(i: u32, count: u32, brdf: Brdf) -> vec3f {
    let u = facets_below(i, count);
    let tangent = brdf.sigma * sqrt(2.0 * select(-log(1.0 - u), u / (1.0 - u), brdf.model == GGX || brdf.model == METAL));
    let angle = f32(i) * 2.3999632;
    return normalize(vec3f(tangent * cos(angle), tangent * sin(angle), 1.0));
}

/// What facets seen at the cosine `c` pass on, without masking; a metal's without its colour.
fn facet_fresnel(brdf: Brdf, c: f32) -> f32 {
    let usual = select(NORMAL_FRESNEL, USUAL_METAL, brdf.model == METAL);
    return min(brdf.strength * usual * fresnel_factor(brdf, c), 1.0);
}

/// A ray and the part of what it meets that is seen: weighted as the facets that the viewer sees, times
/// Fresnel factor and masking.
struct MirrorRay {
    direction: vec3f,
    weight: f32,
    /// How far its half vector stands for others, as a multiple of the lobe's width.
    extent: f32,
    /// The part of the sky that it meets, and the standard deviation of what it stands for there along each axis, radians.
    sky_weight: f32,
    sky_spread: f32,
}

/// The ray of the middle of a lobe, which stands for all of it.
fn middle_ray(brdf: Brdf, normal: vec3f, view: vec3f) -> MirrorRay {
    let cos_view = dot(normal, view);
    let cos_light = max(cos_view, 1e-3);
    let passes = facet_fresnel(brdf, cos_light) * masking(brdf, max(cos_view, 1e-4));
    let sky = drawn_scale(brdf, cos_view) * drawn_reflectance(brdf, 0.0, cos_light, cos_light);
    return MirrorRay(normal * (2.0 * cos_view) - view, passes, 1.0, sky, middle_spread(brdf, cos_light));
}

/// The half vectors of a lobe at a point.
struct Drawn {
    tangent: vec3f,
    bitangent: vec3f,
    count: u32,
    /// Sum of the weights of all: as the facets that the viewer sees.
    total: f32,
}

fn drawn(brdf: Brdf, count: u32, normal: vec3f, view: vec3f) -> Drawn {
    let cos_view = dot(normal, view);
    var tangent = view - normal * cos_view;
    if (dot(tangent, tangent) < 1e-12) {
        tangent = cross(normal, select(vec3f(1.0, 0.0, 0.0), vec3f(0.0, 1.0, 0.0), abs(normal.x) > 0.7));
    }
    tangent = normalize(tangent);
    let bitangent = cross(normal, tangent);
    let along = vec3f(dot(view, tangent), dot(view, bitangent), cos_view);
    var total = 0.0;
    for (var i = 0u; i < count; i++) {
        let local = lobe_half_vector(i, count, brdf);
        total += max(dot(along, local), 0.0) / local.z;
    }
    return Drawn(tangent, bitangent, count, total);
}

/// The ray of the `i`th half vector; the sum of all is the lobe.
fn drawn_ray(brdf: Brdf, lobe: Drawn, i: u32, normal: vec3f, view: vec3f) -> MirrorRay {
    let local = lobe_half_vector(i, lobe.count, brdf);
    let half_vector = lobe.tangent * local.x + lobe.bitangent * local.y + normal * local.z;
    let between = dot(view, half_vector);
    let light = half_vector * (2.0 * between) - view;
    let cos_light = dot(normal, light);
    if (between <= 0.0 || cos_light <= 0.0) {
        return MirrorRay(light, 0.0, 0.0, 0.0, 1.0);
    }
    let share = between / local.z / max(lobe.total, 1e-6);
    let passes = facet_fresnel(brdf, between) * masking(brdf, max(cos_light, 1e-4));
    // Half the radius of its part of all slopes, of a metal.
    let below = facets_below(i, lobe.count);
    let extent = 1.0 / (sqrt(2.0 * f32(lobe.count)) * (1.0 - below));
    let tangent_half = length(local.xy) / local.z;
    let sky = share * drawn_scale(brdf, dot(normal, view)) * drawn_reflectance(brdf, tangent_half, cos_light, between);
    let spread = drawn_spread(brdf, below, tangent_half, between, f32(lobe.count));
    return MirrorRay(light, passes * share, extent, sky, spread);
}
