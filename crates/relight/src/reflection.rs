//! The surface mirrored in itself: specular reflection of its own diffuse radiance.
//!
//! Towards v a point sends R(cos θ_r) · B̄, with B̄ the mean over the lobe of the diffuse radiance that the mirrored
//! directions meet (nothing where they leave the surface) and R the reflectance of the whole lobe. Half vectors are
//! distributed as the facets that v sees (Heitz 2018): a fixed set is drawn from the lobe's distribution and each
//! weighted by (v·h)/(n·h), the weights normalised, so that nothing blows up at grazing views. What passes on is then
//! F(v·h) G₁(l).

use glam::{Vec2, Vec3};

use super::interreflection::{Interreflection, Relit, exit_cosine};
use super::shading::ShadingPoint;
use rekindle_base::math::GOLDEN_ANGLE;
use rekindle_capture::Mesh;
use rekindle_scene::reflectance::Brdf;
use rekindle_scene::surface::{Atlas, Occluder};

/// Half vectors of a lobe.
const RAYS: usize = 12;
/// Entries of the reflectance table, over the cosine of the view.
const TABLE: usize = 64;

/// The half vectors of a roughness.
pub struct Lobe {
    brdf: Brdf,
    /// Around the normal: towards the view, across, along the normal.
    half_vectors: Vec<Vec3>,
    /// R at the cosines 0 to 1.
    reflectance: Vec<f32>,
}

impl Lobe {
    pub(super) fn new(brdf: Brdf) -> Self {
        let half_vectors = (0..RAYS)
            .map(|i| {
                let u = (i as f32 + 0.5) / RAYS as f32;
                let tan = brdf.facet_slope(u);
                let (sin, cos) = (i as f32 * GOLDEN_ANGLE).sin_cos();
                Vec3::new(tan * cos, tan * sin, 1.0).normalize_or(Vec3::Z)
            })
            .collect();
        let mut lobe = Self {
            brdf,
            half_vectors,
            reflectance: Vec::new(),
        };
        lobe.reflectance = (0..TABLE)
            .map(|i| {
                let cos = (i as f32 / (TABLE - 1) as f32).max(1e-3);
                let view = Vec3::new((1.0 - cos * cos).max(0.0).sqrt(), 0.0, cos);
                let (mut sum, mut total) = (0.0, 0.0);
                lobe.each(1.0, Vec3::Z, view, |_, weight, passes| {
                    sum += weight * passes;
                    total += weight;
                });
                if total > 0.0 { sum / total } else { 0.0 }
            })
            .collect();
        lobe
    }

    /// Part of uniform radiance that the lobe sends towards a view at the cosine `cos`.
    pub(super) fn reflectance(&self, cos: f32) -> f32 {
        let at = cos.clamp(0.0, 1.0) * (TABLE - 1) as f32;
        let low = (at as usize).min(TABLE - 2);
        let t = at - low as f32;
        self.reflectance[low] * (1.0 - t) + self.reflectance[low + 1] * t
    }

    /// Calls `add(l, weight, part passed on)` for all mirrored directions l of a view, where the lobe has this multiple of the main
    /// roughness.
    fn each(&self, roughness: f32, normal: Vec3, view: Vec3, mut add: impl FnMut(Vec3, f32, f32)) {
        let cos_view = normal.dot(view);
        let tangent = (view - normal * cos_view)
            .try_normalize()
            .unwrap_or_else(|| normal.any_orthonormal_vector());
        let bitangent = normal.cross(tangent);
        for local in &self.half_vectors {
            let wider = Vec3::new(roughness * local.x, roughness * local.y, local.z);
            let local = wider.normalize_or(Vec3::Z);
            let half = tangent * local.x + bitangent * local.y + normal * local.z;
            let cos_between = view.dot(half);
            if cos_between <= 0.0 {
                continue;
            }
            let light = half * (2.0 * cos_between) - view;
            let passes = self.brdf.facet_reflectance(normal.dot(light), cos_between);
            add(light, cos_between / local.z, passes);
        }
    }
}

/// What surrounds a point of the surface: the rest of the surface with its diffuse radiance.
#[derive(Clone, Copy)]
pub struct Surroundings<'a> {
    /// How light passes from surface to surface.
    pub interreflection: &'a Interreflection,
    /// Where each triangle lies in the texture.
    pub atlas: &'a Atlas,
    /// Diffuse radiance towards normal incidence; where there is new light, the pseudo-albedo.
    pub texture: &'a [[f32; 3]],
    /// The new light.
    pub relit: Option<&'a Relit<'a>>,
}

impl Surroundings<'_> {
    /// Diffuse radiance of the surface towards normal incidence.
    fn radiance(&self, mesh: &Mesh, triangle: u32, barycentric: Vec2) -> Vec3 {
        let texture = self.atlas.sample(self.texture, triangle, barycentric);
        match self.relit {
            None => texture,
            Some(relit) => texture * relit.total.at(mesh, triangle, barycentric),
        }
    }

    /// Interreflected irradiance under the new light, transmittance inside, K_S-scaled.
    pub(super) fn irradiance(&self, mesh: &Mesh, triangle: u32, barycentric: Vec2) -> Vec3 {
        self.relit.map_or(Vec3::ZERO, |relit| {
            relit.indirect.at(mesh, triangle, barycentric)
        })
    }

    /// Whether any surface can be seen from near this point.
    pub(super) fn is_sheltered(&self, mesh: &Mesh, triangle: u32, barycentric: Vec2) -> bool {
        self.interreflection
            .is_sheltered(mesh, triangle, barycentric)
    }

    /// B̄, the mean over the lobe of what is mirrored towards the unit direction `view`.
    pub(super) fn mirrored(
        &self,
        mesh: &Mesh,
        occluder: &Occluder,
        point: &ShadingPoint,
        view: Vec3,
    ) -> Vec3 {
        let lobe = &self.interreflection.lobe;
        let origin = occluder.offset_origin(point.position, point.face_normal);
        let mut rays = [(Vec3::ZERO, 0.0); RAYS];
        let (mut count, mut total) = (0, 0.0);
        lobe.each(
            point.gloss.roughness,
            point.normal,
            view,
            |light, weight, passes| {
                let weight = weight * passes;
                total += weight;
                if weight > 0.0 && light.dot(point.face_normal) > 0.0 {
                    rays[count] = (light, weight);
                    count += 1;
                }
            },
        );
        let mut sum = Vec3::ZERO;
        let rays = rays[..count].iter().map(|ray| (ray, ray.0));
        occluder.each_hit(origin, rays, |&(light, weight), hit| {
            let Some(hit) = hit else { return };
            if let Some(cos) = exit_cosine(mesh, hit.triangle, hit.barycentric, light) {
                sum += self.radiance(mesh, hit.triangle, hit.barycentric)
                    * (weight * lobe.brdf.diffuse_exit(cos));
            }
        });
        if total > 0.0 { sum / total } else { Vec3::ZERO }
    }

    /// R, the part of B̄ that is seen at the cosine `cos` between normal and view.
    pub(super) fn reflectance(&self, cos: f32) -> f32 {
        self.interreflection.lobe.reflectance(cos)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rekindle_scene::reflectance::SpecularModel;

    /// Fresnel's equations for an index of 1.5, written out for both polarisations.
    fn fresnel(cos: f64) -> f64 {
        let sin_inside = (1.0 - cos * cos).sqrt() / 1.5;
        let cos_inside = (1.0 - sin_inside * sin_inside).sqrt();
        let across = (cos - 1.5 * cos_inside) / (cos + 1.5 * cos_inside);
        let along = (1.5 * cos - cos_inside) / (1.5 * cos + cos_inside);
        0.5 * (across * across + along * along)
    }

    #[test]
    fn a_smooth_lobe_reflects_as_fresnel_says() {
        let lobe = Lobe::new(Brdf::new(SpecularModel::Beckmann, 0.005));
        for cos in [1.0, 0.8, 0.5, 0.3, 0.15] {
            let found = f64::from(lobe.reflectance(cos));
            let expected = fresnel(f64::from(cos));
            // The table is linear between cosines 1/63 apart, where the curve bends.
            assert!(
                (found / expected - 1.0).abs() < 0.03,
                "{found} at {cos}, not {expected}"
            );
        }
    }

    #[test]
    fn a_rough_lobe_never_reflects_more_than_it_gets() {
        for sigma in [0.02, 0.1, 0.3, 0.5] {
            let lobe = Lobe::new(Brdf::new(SpecularModel::Beckmann, sigma));
            for i in 0..=100 {
                let r = lobe.reflectance(i as f32 / 100.0);
                assert!((0.0..=1.0).contains(&r), "{r} at roughness {sigma}");
            }
        }
    }
}
