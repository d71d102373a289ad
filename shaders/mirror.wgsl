// The surface mirrored in itself: the twin of `relight/reflection.rs`. One half vector of the lobe a frame; sixteen make
// the lobe.

#import frame.wgsl
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

/// Half vectors of a lobe.
const HALF_VECTORS: u32 = 16u;
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

/// A half vector of the lobe about +Z, by its place among all facets: for Beckmann, tan² of the tilt is exponential with the
/// mean 2σ².
fn lobe_half_vector(i: u32, brdf: Brdf) -> vec3f {
    let u = (f32(i) + 0.5) / f32(HALF_VECTORS);
    let tangent = brdf.sigma * sqrt(2.0 * select(-log(1.0 - u), u / (1.0 - u), brdf.model == GGX || brdf.model == METAL));
    let angle = f32(i) * 2.3999632;
    return normalize(vec3f(tangent * cos(angle), tangent * sin(angle), 1.0));
}

/// What facets seen at the cosine `c` pass on, without masking; a metal's without its colour.
fn facet_fresnel(brdf: Brdf, c: f32) -> f32 {
    return min(brdf.strength * select(fresnel(c), USUAL_METAL, brdf.model == METAL), 1.0);
}

/// A ray of this frame and the part of what it meets that is seen: weighted as the facets that the viewer sees, times
/// Fresnel factor and masking.
struct MirrorRay {
    direction: vec3f,
    weight: f32,
    /// How far its half vector stands for others, as a multiple of the lobe's width.
    extent: f32,
}

fn mirror_ray(brdf: Brdf, normal: vec3f, view: vec3f) -> MirrorRay {
    let cos_view = dot(normal, view);
    if (frame.half_vector >= HALF_VECTORS) {
        let light = normal * (2.0 * cos_view) - view;
        return MirrorRay(light, facet_fresnel(brdf, max(cos_view, 1e-3)) * masking(brdf, max(cos_view, 1e-4)), 1.0);
    }
    var tangent = view - normal * cos_view;
    if (dot(tangent, tangent) < 1e-12) {
        tangent = cross(normal, select(vec3f(1.0, 0.0, 0.0), vec3f(0.0, 1.0, 0.0), abs(normal.x) > 0.7));
    }
    tangent = normalize(tangent);
    let bitangent = cross(normal, tangent);
    var total = 0.0;
    for (var i = 0u; i < HALF_VECTORS; i++) {
        let local = lobe_half_vector(i, brdf);
        let between = dot(view, tangent) * local.x + dot(view, bitangent) * local.y + cos_view * local.z;
        total += max(between, 0.0) / local.z;
    }
    let local = lobe_half_vector(frame.half_vector, brdf);
    let half_vector = tangent * local.x + bitangent * local.y + normal * local.z;
    let between = dot(view, half_vector);
    let light = half_vector * (2.0 * between) - view;
    let cos_light = dot(normal, light);
    if (between <= 0.0 || cos_light <= 0.0) {
        return MirrorRay(light, 0.0, 0.0);
    }
    let passes = facet_fresnel(brdf, between) * masking(brdf, max(cos_light, 1e-4));
    // Half the radius of its part of all slopes, of a metal.
    let above = 1.0 - (f32(frame.half_vector) + 0.5) / f32(HALF_VECTORS);
    let extent = 1.0 / (sqrt(2.0 * f32(HALF_VECTORS)) * above);
    return MirrorRay(light, passes * between / local.z * f32(HALF_VECTORS) / max(total, 1e-6), extent);
}
