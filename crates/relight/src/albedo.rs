//! The pseudo-albedo: diffuse radiance ÷ irradiance under the captured lighting (eq. 20), so that the new diffuse
//! radiance is pseudo-albedo × new irradiance (eq. 18–19).
//!
//! Where no estimated light reaches the surface, or no view saw it, there is nothing to divide: such texels are filled
//! from their surroundings by diffusion over the mesh, and the confidence says so.

use glam::Vec3;
use rayon::prelude::*;

use super::ambient::{Lit, ambient_irradiance};
use super::diffuse::{DiffuseTexture, ViewLight};
use super::fill::{Places, fill};
use super::interreflection::Interreflection;
use super::irradiance::texel_irradiance;
use super::reflection::HOLLOW;
use super::render::Scene;
use super::shading::{Shader, ambient_gain};
use super::triangle_shares::TriangleShares;
use super::trust::Trust;
use rekindle_scene::reflectance::SpecularModel;
use rekindle_scene::surface::{Atlas, Texel};

/// Of a metal irradiance below this part of the typical one says nothing about the albedo …
const DARK: f32 = 0.01;
/// … and above this part says all.
const LIT: f32 = 0.06;
/// A channel with less than this part of the irradiance of the brightest one says nothing about the albedo.
const DIM: f32 = 0.01;
/// Texels less confident than this count as never seen.
const SEEN: f32 = 0.01;

/// The albedo and the ambient light.
#[derive(Clone, Debug)]
pub struct Albedo {
    /// Pseudo-albedo of each texel, RGB; with `K_S`-scaled light its scale is that of `K_D / K_S`.
    pub albedo: Vec<[f32; 3]>,
    /// Ambient radiance, RGB, K_S-scaled.
    pub ambient: Vec3,
}

/// Whether there is light beside the lamps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ambient {
    /// There may be some: it is looked for.
    Sought,
    /// The lighting is all there is.
    None,
}

impl Ambient {
    /// Beside a lighting that is known or not.
    pub fn beside(is_known: bool) -> Self {
        if is_known { Self::None } else { Self::Sought }
    }
}

/// Divides the texture by its irradiance, fills what is unknown, and lets `texture` follow: unseen texels get filled
/// albedo × own irradiance, and the confidence of filled ones is lowered.
pub fn separate(
    scene: &Scene,
    atlas: &Atlas,
    shader: &Shader,
    triangles: &TriangleShares,
    texture: &mut DiffuseTexture,
    ambient: Ambient,
) -> Albedo {
    let mut irradiance = texel_irradiance(scene, atlas, shader, triangles);
    let direct: Vec<f32> = irradiance.iter().map(|e| e.element_sum() / 3.0).collect();
    if let Some(surroundings) = scene.surroundings {
        add_interreflection(
            scene,
            atlas,
            surroundings.interreflection,
            texture,
            &mut irradiance,
        );
    }
    let places = Places::new(scene.mesh);
    let confidence = &texture.confidence;
    let lit_by = |weight: &(dyn Fn(usize) -> f32 + Sync)| {
        let lit = (&irradiance[..], &direct[..]);
        lit_places((scene, atlas), &places, (&texture.radiance, weight), lit)
    };
    let mut lit = lit_by(&|t| confidence[t]);
    let ambient = match ambient {
        Ambient::Sought => {
            // Metals have no diffuse part that could show any.
            let shows = |t| f32::from(!scene.is_metal(t)) * confidence[t];
            let shown = scene.has_metals_beside().then(|| lit_by(&shows));
            let shown = shown.as_ref().unwrap_or(&lit);
            let added = ambient_beside((scene, atlas), &places, texture, (&irradiance, shown));
            for texel in &atlas.texels {
                irradiance[texel.index as usize] += added;
            }
            for place in lit.iter_mut().flatten() {
                place.irradiance += added;
            }
            added / ambient_gain(scene.brdf)
        }
        Ambient::None => Vec3::ZERO,
    };
    let typical = typical_irradiance(atlas, &irradiance);
    let is_metal = (scene.brdf).is_some_and(|brdf| brdf.model == SpecularModel::Metal);
    let trust = (!is_metal).then(|| Trust::new(&places, &lit, typical));
    // The quotient at each texel, and how far it is known, 0 to 1.
    let quotients: Vec<(Vec3, f32)> = atlas
        .texels
        .par_iter()
        .map(|texel| {
            let t = texel.index as usize;
            let light = irradiance[t].element_sum() / 3.0;
            if texture.confidence[t] < SEEN || light <= 0.0 {
                return (Vec3::ZERO, 0.0);
            }
            let albedo = quotient(texture.radiance[t].into(), irradiance[t]);
            let known = trust.as_ref().map_or_else(
                || lit_metal(light / typical),
                |trust| {
                    let (triangle, barycentric) = (texel.triangle, texel.barycentric);
                    let nearest = places.nearest(scene.mesh, triangle, barycentric);
                    trust.at(light, direct[t] / light, nearest)
                },
            );
            (albedo, known)
        })
        .collect();
    let texels = texture.radiance.len();
    let mut albedo = vec![Vec3::ZERO; texels];
    let mut known = vec![0.0_f32; texels];
    for (texel, (quotient, part)) in atlas.texels.iter().zip(quotients) {
        albedo[texel.index as usize] = quotient;
        known[texel.index as usize] = part;
    }
    if let Some(around) = scene.surroundings.filter(|_| is_metal) {
        even_hollows((scene, atlas), around.interreflection, &mut albedo, &known);
    }
    fill_unknown(
        (scene, atlas),
        &places,
        &mut albedo,
        &known,
        &texture.confidence,
    );
    for texel in &atlas.texels {
        let t = texel.index as usize;
        if texture.confidence[t] < SEEN {
            texture.radiance[t] = (albedo[t] * irradiance[t]).to_array();
            texture.confidence[t] = 0.0;
        } else {
            texture.confidence[t] *= 0.5 + 0.5 * known[t];
        }
    }
    Albedo {
        albedo: albedo.iter().map(Vec3::to_array).collect(),
        ambient,
    }
}

/// How far the quotient is known of a metal where this part of the typical irradiance arrives. It has no diffuse part of which its
/// surroundings could tell anything.
fn lit_metal(part: f32) -> f32 {
    let part = ((part - DARK) / (LIT - DARK)).clamp(0.0, 1.0);
    part * part * (3.0 - 2.0 * part)
}

/// Gives the hollows of a metal the albedo that it has elsewhere: what it mirrors of itself more than once is left over there, as if it
/// were diffuse.
fn even_hollows(
    (scene, atlas): (&Scene, &Atlas),
    interreflection: &Interreflection,
    albedo: &mut [Vec3],
    known: &[f32],
) {
    let open = |texel: &Texel| {
        let open = interreflection.openness(scene.mesh, texel.triangle, texel.barycentric);
        ((open - HOLLOW) / (1.0 - HOLLOW)).clamp(0.0, 1.0).powi(2)
    };
    let open: Vec<f32> = atlas.texels.par_iter().map(open).collect();
    let mut elsewhere = Mean::default();
    for (texel, open) in atlas.texels.iter().zip(&open).filter(|(t, _)| !t.gutter) {
        let t = texel.index as usize;
        elsewhere.add(albedo[t], known[t] * open);
    }
    for (texel, open) in atlas.texels.iter().zip(open) {
        let own = &mut albedo[texel.index as usize];
        *own = elsewhere.value().lerp(*own, open);
    }
}

/// The albedo of a texture that is of it, as views under a light of their own make it, with what is unknown filled.
pub fn filled_albedo(scene: &Scene, atlas: &Atlas, texture: &DiffuseTexture) -> Vec<[f32; 3]> {
    let mut albedo: Vec<Vec3> = texture.radiance.iter().map(|&a| a.into()).collect();
    let is_known = |&confidence: &f32| if confidence < SEEN { 0.0 } else { 1.0 };
    let known: Vec<f32> = texture.confidence.iter().map(is_known).collect();
    let places = Places::new(scene.mesh);
    fill_unknown(
        (scene, atlas),
        &places,
        &mut albedo,
        &known,
        &texture.confidence,
    );
    albedo.iter().map(Vec3::to_array).collect()
}

/// Makes a texture of albedo that of the diffuse radiance under the light of one view; `albedo` is the same without gaps.
pub fn light_texture(
    scene: &Scene,
    atlas: &Atlas,
    light: &ViewLight,
    albedo: &[[f32; 3]],
    texture: &mut DiffuseTexture,
) {
    let irradiance = light.irradiance(scene, atlas);
    for texel in &atlas.texels {
        let t = texel.index as usize;
        texture.radiance[t] = (Vec3::from(albedo[t]) * irradiance[t]).to_array();
        if texture.confidence[t] < SEEN {
            texture.confidence[t] = 0.0;
        }
    }
}

/// Fills an albedo from its surroundings as far as it isn't known, 0 to 1; what is known counts by its confidence.
fn fill_unknown(
    (scene, atlas): (&Scene, &Atlas),
    places: &Places,
    albedo: &mut [Vec3],
    known: &[f32],
    confidence: &[f32],
) {
    let filled = fill(scene.mesh, places, atlas, albedo, (known, confidence));
    for (texel, fill) in atlas.texels.iter().zip(filled) {
        let t = texel.index as usize;
        albedo[t] = between(fill, albedo[t], known[t]);
    }
}

/// An albedo between a likely one and a measured one, which has this part of the contrast between the two: however large the
/// quotient of little light is, it counts no further than it is known.
fn between(likely: Vec3, measured: Vec3, known: f32) -> Vec3 {
    if known >= 1.0 {
        return measured;
    }
    if known <= 0.0 {
        return likely;
    }
    let measured = measured.max(Vec3::ZERO);
    let sum = (likely + measured).max(Vec3::splat(f32::MIN_POSITIVE));
    let contrast = known * (measured - likely) / sum;
    likely * (1.0 + contrast) / (1.0 - contrast)
}

/// Radiance ÷ irradiance. A channel in which hardly any light arrives takes what the others say.
fn quotient(radiance: Vec3, irradiance: Vec3) -> Vec3 {
    let enough = DIM * irradiance.max_element();
    let dim = irradiance.cmplt(Vec3::splat(enough));
    let quotient = radiance / irradiance.max(Vec3::splat(enough));
    let lit = 3 - dim.bitmask().count_ones();
    let others = Vec3::select(dim, Vec3::ZERO, quotient).element_sum() / lit as f32;
    Vec3::select(dim, Vec3::splat(others), quotient)
}

/// What radiance and irradiance of texels of some weights are in the mean around each place.
fn lit_places(
    (scene, atlas): (&Scene, &Atlas),
    places: &Places,
    (radiance, weight): (&[[f32; 3]], &(dyn Fn(usize) -> f32 + Sync)),
    (irradiance, direct): (&[Vec3], &[f32]),
) -> Vec<Option<Lit>> {
    let all = |t: usize| {
        let direct = Vec3::splat(direct[t]);
        [radiance[t].into(), irradiance[t], direct]
    };
    let lit = |(means, area): (Option<[Vec3; 3]>, f32)| {
        let [radiance, irradiance, direct] = means?;
        Some(Lit {
            radiance,
            irradiance,
            direct: direct.x,
            area,
        })
    };
    let gathered = places.gather(scene.mesh, atlas, all, weight).into_iter();
    let areas = places.areas(scene.mesh);
    gathered.zip(areas).map(lit).collect()
}

/// The ambient light's irradiance beside this one, of texels and of places. An object without any lamp is taken to be lit by
/// ambient light alone, its albedo to be one half in the mean: the light's scale is open then.
fn ambient_beside(
    (scene, atlas): (&Scene, &Atlas),
    places: &Places,
    texture: &DiffuseTexture,
    (irradiance, lit): (&[Vec3], &[Option<Lit>]),
) -> Vec3 {
    if irradiance.iter().all(|&e| e == Vec3::ZERO) {
        let mut mean = Mean::default();
        for texel in atlas.texels.iter().filter(|t| !t.gutter) {
            let t = texel.index as usize;
            mean.add(texture.radiance[t].into(), texture.confidence[t]);
        }
        Vec3::splat(2.0 * mean.value().element_sum() / 3.0)
    } else if (scene.brdf).is_some_and(|brdf| brdf.model == SpecularModel::Metal) {
        // It has no diffuse part that could show any.
        Vec3::ZERO
    } else {
        let typical = typical_irradiance(atlas, irradiance);
        ambient_irradiance(lit, &|place| places.around(place), typical)
    }
}

/// Adds what the surface itself sends: its radiance is known from the pictures, and taken for the mean where it is not.
fn add_interreflection(
    scene: &Scene,
    atlas: &Atlas,
    interreflection: &Interreflection,
    texture: &DiffuseTexture,
    irradiance: &mut [Vec3],
) {
    let mut mean = Mean::default();
    for texel in atlas.texels.iter().filter(|t| !t.gutter) {
        let t = texel.index as usize;
        mean.add(texture.radiance[t].into(), texture.confidence[t]);
    }
    let radiance: Vec<[f32; 3]> = texture
        .radiance
        .iter()
        .zip(&texture.confidence)
        .map(|(&r, &c)| if c < SEEN { mean.value().into() } else { r })
        .collect();
    let indirect = interreflection.of_radiance(scene.mesh, &|triangle, barycentric| {
        atlas.sample(&radiance, triangle, barycentric)
    });
    let added: Vec<Vec3> = atlas
        .texels
        .par_iter()
        .map(|texel| indirect.at(scene.mesh, texel.triangle, texel.barycentric))
        .collect();
    for (texel, added) in atlas.texels.iter().zip(added) {
        irradiance[texel.index as usize] += added;
    }
}

/// A weighted mean.
#[derive(Default)]
pub(super) struct Mean {
    sum: glam::DVec3,
    weight: f64,
}

impl Mean {
    pub(super) fn add(&mut self, value: Vec3, weight: f32) {
        self.sum += value.as_dvec3() * f64::from(weight);
        self.weight += f64::from(weight);
    }

    pub(super) fn value(&self) -> Vec3 {
        if self.weight > 0.0 {
            (self.sum / self.weight).as_vec3()
        } else {
            Vec3::ZERO
        }
    }
}

/// Mean over channels of the 90th percentile of irradiance: that of a well-lit place.
pub(super) fn typical_irradiance(atlas: &Atlas, irradiance: &[Vec3]) -> f32 {
    let mut values: Vec<f32> = atlas
        .texels
        .iter()
        .filter(|t| !t.gutter)
        .map(|t| irradiance[t.index as usize].element_sum() / 3.0)
        .collect();
    if values.is_empty() {
        return 1.0;
    }
    let at = (values.len() - 1) * 9 / 10;
    values
        .select_nth_unstable_by(at, f32::total_cmp)
        .1
        .max(f32::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_hardly_known_stays_near_what_is_likely_however_large_it_is() {
        let likely = Vec3::new(0.5, 0.2, 0.0);
        for measured in [0.0, 1e-9, 0.3, 1e9, f32::MAX] {
            let found = between(likely, Vec3::splat(measured), 0.05);
            assert!(found.is_finite(), "{found}");
            assert!(
                (found - likely).abs().cmple(0.11 * likely + 1e-6).all(),
                "{found}"
            );
        }
        let measured = Vec3::new(0.1, 0.9, 0.4);
        assert_eq!(between(likely, measured, 1.0), measured);
        assert_eq!(between(likely, Vec3::INFINITY, 0.0), likely);
        let half = between(likely, measured, 0.5);
        let within = half.cmpgt(likely.min(measured)) & half.cmplt(likely.max(measured));
        assert!(within.x && within.y, "{half}");
    }
}
