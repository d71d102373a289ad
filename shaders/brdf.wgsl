// The specular lobe and the diffuse transmittance: the twin of `crates/scene/src/reflectance.rs`, equations 3 and 4.
//
// A lobe here may stand for several nodes of light: `spread` is their angular variance about the mean direction, per
// axis, radians². The half vector turns by half of the light's turn in the plane of incidence and by 1/(2 l·h) of it
// across, so the Gaussian widens by a quarter of the spread in one direction and by spread/(2 l·h)² in the other.

const PAPER: u32 = 0u;
const BECKMANN: u32 = 1u;
const GGX: u32 = 2u;
const METAL: u32 = 3u;
const NO_LOBE: u32 = 4u;
const MIN_COS_VIEW: f32 = 1e-3;
const REFRACTIVE_INDEX: f32 = 1.5;
const NORMAL_FRESNEL: f32 = 0.04;
const USUAL_METAL: f32 = 0.5;
/// How many times as much as a usual dielectric one reflects at most.
const MOST_OF_DIELECTRIC: f32 = 4.0;
/// Exponent beyond which a lobe is nothing: 1e-5 of its peak.
const CUT_EXPONENT: f32 = 11.5;

struct Brdf {
    /// PAPER, BECKMANN, GGX, METAL or NO_LOBE.
    model: u32,
    sigma: f32,
    /// What it reflects, as a multiple of what such surfaces usually do.
    strength: f32,
}

/// What depends on normal and view only.
struct ViewTerms {
    normal: vec3f,
    view: vec3f,
    cos_view: f32,
    /// Masking towards the viewer over cos θ_r.
    scale: f32,
}

/// Unpolarised Fresnel reflectance (Walter et al. 2007, eq. 22).
fn fresnel(c: f32) -> f32 {
    let g = sqrt(REFRACTIVE_INDEX * REFRACTIVE_INDEX - 1.0 + c * c);
    let a = (g - c) / (g + c);
    let b = (c * (g + c) - 1.0) / (c * (g - c) + 1.0);
    return 0.5 * a * a * (1.0 + b * b);
}

/// Whether it is a metal's, which has no diffuse part to speak of: it reflects more than a dielectric can.
fn is_metal(brdf: Brdf) -> bool {
    return brdf.model == METAL || ((brdf.model == BECKMANN || brdf.model == GGX) && brdf.strength > MOST_OF_DIELECTRIC);
}

/// Fresnel factor on facets, 1 at normal incidence: that of metals beside dielectrics rises less.
fn fresnel_factor(brdf: Brdf, c: f32) -> f32 {
    if (brdf.model == METAL) {
        return 1.0;
    }
    let strength = select(1.0, brdf.strength, is_metal(brdf));
    let reflected = min(strength * NORMAL_FRESNEL, 1.0);
    let rise = (1.0 - reflected) / reflected * (NORMAL_FRESNEL / (1.0 - NORMAL_FRESNEL));
    return mix(1.0, fresnel(c) / NORMAL_FRESNEL, rise);
}

/// Smith's masking for slopes of width √2 σ.
fn masking(brdf: Brdf, c: f32) -> f32 {
    let sigma = brdf.sigma;
    let tangent = sqrt(max(1.0 - c * c, 0.0)) / c;
    if (brdf.model == GGX || brdf.model == METAL) {
        return 2.0 / (1.0 + sqrt(1.0 + 2.0 * sigma * sigma * tangent * tangent));
    }
    let a = 1.0 / max(1.414213562 * sigma * tangent, 1e-6);
    let value = a * (3.535 + 2.181 * a) / (1.0 + a * (2.276 + 2.577 * a));
    return select(1.0, value, a < 1.6);
}

/// acos(c)² for c in [0, 1] (Abramowitz and Stegun, 4.4.46).
fn squared_arccos(c: f32) -> f32 {
    var p = -0.0012624911;
    p = p * c + 0.00667009;
    p = p * c - 0.017088126;
    p = p * c + 0.03089188;
    p = p * c - 0.050174303;
    p = p * c + 0.08897899;
    p = p * c - 0.2145988;
    p = p * c + 1.5707963;
    return (1.0 - c) * p * p;
}

fn smooth_transmittance(cosine: f32, strength: f32) -> f32 {
    let part = min(strength, 1.0);
    return (1.0 - part * fresnel(clamp(cosine, 1e-3, 1.0))) / (1.0 - part * NORMAL_FRESNEL);
}

/// Part of uniform light that a GGX lobe sends towards a viewer.
fn ggx_reflectance(cosine: f32, sigma: f32) -> f32 {
    let c = clamp(cosine, 1e-3, 1.0);
    let alpha = 1.414213562 * sigma;
    let tilt = 1.0 - c;
    let steeper = min(c * c + 1.0738 * pow(alpha, 1.4252) * pow(tilt, 0.8577), 1.0);
    let lost = 1.0 + alpha * alpha * (1.3559 - 2.7057 * pow(tilt, 2.5463));
    return min(fresnel(sqrt(steeper)) / max(lost, 0.2), 0.99);
}

/// How much of the light for the diffuse part passes the surface at a cosine, against normal incidence.
fn diffuse_entry(brdf: Brdf, cosine: f32) -> f32 {
    if (brdf.model != BECKMANN) {
        return 1.0;
    }
    return smooth_transmittance(cosine, brdf.strength);
}

/// How much of diffusely reflected light passes the surface towards a viewer, against normal exitance.
fn diffuse_exit(brdf: Brdf, cosine: f32) -> f32 {
    if (brdf.model == BECKMANN) {
        return smooth_transmittance(cosine, brdf.strength);
    }
    if (brdf.model == GGX) {
        let part = min(brdf.strength, 1.0);
        return (1.0 - part * ggx_reflectance(cosine, brdf.sigma)) / (1.0 - part * ggx_reflectance(1.0, brdf.sigma));
    }
    return 1.0;
}

fn view_terms(brdf: Brdf, normal: vec3f, view: vec3f) -> ViewTerms {
    let cos_view = max(dot(normal, view), MIN_COS_VIEW);
    var mask = 1.0;
    if (brdf.model == BECKMANN || brdf.model == GGX || brdf.model == METAL) {
        mask = masking(brdf, cos_view);
    }
    return ViewTerms(normal, view, cos_view, mask / cos_view);
}

/// Part of light spread about a direction at the cosine `cos_light` that comes from above the horizon: that of a disc,
/// taken to rise evenly.
fn above_horizon(cos_light: f32, spread: f32) -> f32 {
    let radius = 2.0 * sqrt(spread);
    return clamp(0.5 + 0.5 * cos_light / max(radius, 1e-6), 0.0, 1.0);
}

/// The lobe for light from `light` (unit) that is spread about it.
fn lobe(brdf: Brdf, terms: ViewTerms, light: vec3f, spread: f32) -> f32 {
    let cos_light = dot(terms.normal, light);
    let above = above_horizon(cos_light, spread);
    if (above <= 0.0) {
        return 0.0;
    }
    let sum = light + terms.view;
    let inverse_length = inverseSqrt(max(dot(sum, sum), 1e-12));
    let half_vector = sum * inverse_length;
    let cos_half = clamp(dot(terms.normal, half_vector), 1e-3, 1.0);
    let cos_between = max(0.5 / inverse_length, 0.05);
    let variance = brdf.sigma * brdf.sigma;
    // The normal's offset from the half vector, split along the plane of incidence and across.
    let along = light - terms.view;
    let along_squared = dot(along, along);
    let offset = terms.normal - half_vector * cos_half;
    let offset_squared = dot(offset, offset);
    let projected = dot(offset, along);
    // Seen along the light there is no plane of incidence, and both widths are the same.
    let share = select(0.5, projected * projected / max(along_squared * offset_squared, 1e-20),
        along_squared * offset_squared > 1e-14);
    let width_along = variance + 0.25 * spread;
    let width_across = variance + 0.25 * spread / (cos_between * cos_between);
    var squared: f32;
    let cos_squared = cos_half * cos_half;
    if (brdf.model == PAPER) {
        squared = squared_arccos(cos_half);
    } else {
        squared = (1.0 - cos_squared) / cos_squared;
    }
    let exponent = 0.5 * squared * (share / width_along + (1.0 - share) / width_across);
    let strength = above * terms.scale * variance * inverseSqrt(width_along * width_across);
    var density: f32;
    if (brdf.model == GGX || brdf.model == METAL) {
        density = 1.0 / ((1.0 + exponent) * (1.0 + exponent));
    } else {
        if (exponent > CUT_EXPONENT) {
            return 0.0;
        }
        density = exp(-exponent);
    }
    if (brdf.model == PAPER) {
        return strength * density;
    }
    return strength * density * fresnel_factor(brdf, 0.5 / inverse_length) * masking(brdf, max(cos_light, 1e-4))
        / (cos_squared * cos_squared);
}
