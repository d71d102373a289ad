//! The surface mirrored in itself: specular reflection of its own diffuse radiance, and by what of it is a metal, of its specular
//! radiance.
//!
//! Towards v a point sends R(cos θ_r) · B̄, with B̄ the mean over the lobe of the radiance that the mirrored
//! directions meet (nothing where they leave the surface) and R the reflectance of the whole lobe. Half vectors are
//! distributed as the facets that v sees (Heitz 2018): a fixed set is drawn from the lobe's distribution and each
//! weighted by (v·h)/(n·h), the weights normalised, so that nothing blows up at grazing views. What passes on is then
//! F(v·h) G₁(l).

use std::sync::OnceLock;

use glam::{Mat3, Vec2, Vec3};
use smallvec::SmallVec;

use super::interreflection::{Field, Interreflection, Relit, exit_cosine};
use super::render::Scene;
use super::shading::{Shader, ShadingPoint};
use rekindle_base::math::GOLDEN_ANGLE;
use rekindle_capture::Mesh;
use rekindle_scene::reflectance::{Brdf, Gloss};
use rekindle_scene::surface::Atlas;

/// Half vectors of a dielectric's lobe, as on the device, and of a metal's, which mirrors highlights.
const RAYS: usize = 16;
const METAL_RAYS: usize = 64;
/// A metal less open than this is a hollow, in which light goes to and fro.
pub(super) const HOLLOW: f32 = 0.7;
/// Entries of the reflectance table, over the cosine of the view.
const TABLE: usize = 64;

/// The half vectors of a roughness.
pub struct Lobe {
    brdf: Brdf,
    of_dielectric: Vec<HalfVector>,
    of_metal: Vec<HalfVector>,
    /// R at the cosines 0 to 1.
    reflectance: Vec<f32>,
}

/// The half vector of a part of all facets.
struct HalfVector {
    /// Around the normal: towards the view, across, along the normal.
    direction: Vec3,
    /// How far it stands for others, as a multiple of σ: half the radius, of a metal, of its part of all slopes.
    extent: f32,
}

impl HalfVector {
    /// So many of them for all facets of a lobe.
    fn of(brdf: &Brdf, count: usize) -> Vec<Self> {
        let nth = |i: usize| {
            let u = (i as f32 + 0.5) / count as f32;
            let tan = brdf.facet_slope(u);
            let (sin, cos) = (i as f32 * GOLDEN_ANGLE).sin_cos();
            Self {
                direction: Vec3::new(tan * cos, tan * sin, 1.0).normalize_or(Vec3::Z),
                // With s = u/(1 − u), facets of the slopes between two such s have the area 2πσ² Δs.
                extent: (2.0 * count as f32).sqrt().recip() / (1.0 - u),
            }
        };
        (0..count).map(nth).collect()
    }
}

impl Lobe {
    pub(super) fn new(brdf: Brdf) -> Self {
        let mut lobe = Self {
            brdf,
            of_dielectric: HalfVector::of(&brdf, RAYS),
            of_metal: HalfVector::of(&brdf, METAL_RAYS),
            reflectance: Vec::new(),
        };
        lobe.reflectance = (0..TABLE)
            .map(|i| {
                let cos = (i as f32 / (TABLE - 1) as f32).max(1e-3);
                let view = Vec3::new((1.0 - cos * cos).max(0.0).sqrt(), 0.0, cos);
                let (mut sum, mut total) = (0.0, 0.0);
                lobe.each((Gloss::MAIN, 0.0), Vec3::Z, view, |_, weight, passes, _| {
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

    /// Calls `add(l, weight, part passed on, extent)` for all mirrored directions l of a view, where the lobe is a part's and its
    /// half vectors are turned about the normal by this angle; the extent is that of the half vector as a multiple of the main
    /// roughness.
    fn each(
        &self,
        (gloss, turn): (Gloss, f32),
        normal: Vec3,
        view: Vec3,
        mut add: impl FnMut(Vec3, f32, f32, f32),
    ) {
        let turn = Vec2::from_angle(turn);
        let frame = facing_frame(normal, view);
        let part = self.brdf.at(gloss);
        let half_vectors = if part.is_metal() {
            &self.of_metal
        } else {
            &self.of_dielectric
        };
        for HalfVector { direction, extent } in half_vectors {
            let wider = gloss.roughness * turn.rotate(direction.truncate());
            let local = wider.extend(direction.z).normalize_or(Vec3::Z);
            let half = frame * local;
            let cos_between = view.dot(half);
            if cos_between <= 0.0 {
                continue;
            }
            let light = half * (2.0 * cos_between) - view;
            let passes = part.facet_reflectance(normal.dot(light), cos_between);
            add(
                light,
                cos_between / local.z,
                passes,
                gloss.roughness * extent,
            );
        }
    }
}

/// Axes at a point: towards the view along the surface, across, and the normal.
pub(super) fn facing_frame(normal: Vec3, view: Vec3) -> Mat3 {
    let tangent = (view - normal * normal.dot(view))
        .try_normalize()
        .unwrap_or_else(|| normal.any_orthonormal_vector());
    Mat3::from_cols(tangent, normal.cross(tangent), normal)
}

/// What surrounds a point of the surface: the rest of the surface with its radiance.
pub struct Surroundings<'a> {
    /// How light passes from surface to surface.
    pub(super) interreflection: &'a Interreflection,
    diffuse: Option<(&'a Atlas, &'a [[f32; 3]])>,
    relit: Option<Relit<'a>>,
    /// What the gather points that mirrored rays come near see of each of a shader's groups, in 255ths; looked for once asked.
    shares: Vec<OnceLock<Box<[u8]>>>,
}

impl<'a> Surroundings<'a> {
    /// The surface with its diffuse radiance towards normal incidence as a texture on an atlas, where it has any; where there is new
    /// light, with its pseudo-albedo. For one shader only.
    pub fn new(
        interreflection: &'a Interreflection,
        diffuse: Option<(&'a Atlas, &'a [[f32; 3]])>,
        relit: Option<Relit<'a>>,
    ) -> Self {
        let shares = interreflection.gather_points().iter();
        Self {
            interreflection,
            diffuse,
            relit,
            shares: shares.map(|_| OnceLock::new()).collect(),
        }
    }

    /// The surface as pictures under the light of `shader` show it: its diffuse radiance towards normal incidence is so many times
    /// its direct irradiance.
    pub fn pictured(
        interreflection: &'a Interreflection,
        (mesh, atlas): (&Mesh, &'a Atlas),
        shader: &Shader,
        factor: &'a [[f32; 3]],
    ) -> Self {
        let relit = interreflection.of_pictured(mesh, shader, atlas, factor);
        Self::new(interreflection, Some((atlas, factor)), Some(relit))
    }

    /// Irradiance that the surface has from itself over the other, over all of it; nothing where no new light is known.
    pub fn indirect_part(&self) -> f32 {
        let sum = |field: &Field| {
            f64::from(
                field
                    .irradiance
                    .iter()
                    .map(|e| e.element_sum())
                    .sum::<f32>(),
            )
        };
        let part = |relit: &Relit| sum(&relit.indirect) / sum(&relit.total).max(f64::MIN_POSITIVE);
        self.relit.as_ref().map_or(0.0, |relit| part(relit) as f32)
    }

    /// Irradiance at a place, from elsewhere and from the surface itself, where new light is known.
    pub fn direct_and_indirect(
        &self,
        mesh: &Mesh,
        (triangle, barycentric): (u32, Vec2),
    ) -> [Vec3; 2] {
        let Some(relit) = &self.relit else {
            return [Vec3::ZERO; 2];
        };
        [&relit.total, &relit.indirect].map(|field| field.at(mesh, triangle, barycentric))
    }

    /// Specular radiance that a place of the surface sends in the unit direction `view`, in light that it sees as the gather point
    /// nearest to it does. The ray towards it stands for all in the extent of a half vector, as a multiple of the main roughness:
    /// the lobe is as much wider, or single rays would meet its peak and show as sparks (as Kaplanyan and Dachsbacher, "Path space
    /// regularization for holistic and robust light transport", 2013).
    fn specular(
        &self,
        scene: &Scene,
        shader: &Shader,
        (triangle, barycentric): (u32, Vec2),
        (view, extent): (Vec3, f32),
    ) -> Vec3 {
        let gather = (self.interreflection).gather_point(scene.mesh, triangle, barycentric);
        let look = |group| {
            let point = &self.interreflection.gather_points()[gather];
            (255.0 * shader.seen_share(point, group).unwrap_or(0.0)).round() as u8
        };
        let shares = self.shares[gather].get_or_init(|| (0..shader.groups()).map(look).collect());
        let mut point = scene.point(triangle, barycentric);
        let widest = self.interreflection.lobe.brdf.sigma.recip();
        point.gloss.roughness = point.gloss.roughness.hypot(extent).min(widest);
        let lamps =
            shader.specular_of_shares(&point, view, |group| f32::from(shares[group]) / 255.0);
        lamps + shader.specular_of_sky_in_mirror(&point, view)
    }

    /// Whether what a part of this gloss mirrors is specular too: it is a metal's.
    pub(super) fn is_metal(&self, gloss: Gloss) -> bool {
        self.interreflection.lobe.brdf.at(gloss).is_metal()
    }

    /// Whether a place lies in a hollow of a metal, which is full of light that comes by way of several others.
    pub fn is_hollow(&self, scene: &Scene, (triangle, barycentric): (u32, Vec2)) -> bool {
        let open = || (self.interreflection).openness(scene.mesh, triangle, barycentric);
        self.is_metal(scene.gloss_at(triangle, barycentric)) && open() < HOLLOW
    }

    /// Diffuse radiance of the surface towards normal incidence.
    fn radiance(&self, mesh: &Mesh, triangle: u32, barycentric: Vec2) -> Vec3 {
        let Some((atlas, texture)) = self.diffuse else {
            return Vec3::ZERO;
        };
        let texture = atlas.sample(texture, triangle, barycentric);
        match &self.relit {
            None => texture,
            Some(relit) => texture * relit.total.at(mesh, triangle, barycentric),
        }
    }

    /// Interreflected irradiance under the new light, transmittance inside, K_S-scaled.
    pub(super) fn irradiance(&self, mesh: &Mesh, triangle: u32, barycentric: Vec2) -> Vec3 {
        self.relit.as_ref().map_or(Vec3::ZERO, |relit| {
            relit.indirect.at(mesh, triangle, barycentric)
        })
    }

    /// Whether any surface can be seen from near this point.
    pub(super) fn is_sheltered(&self, mesh: &Mesh, triangle: u32, barycentric: Vec2) -> bool {
        self.interreflection
            .is_sheltered(mesh, triangle, barycentric)
    }

    /// B̄, the mean over the lobe of what is mirrored towards the unit direction `view`, times the colour of the surface. A metal's
    /// half vectors are turned by the number of the pixel, so that neighbours complete each other.
    pub(super) fn mirrored(
        &self,
        scene: &Scene,
        shader: &Shader,
        point: &ShadingPoint,
        (view, pixel): (Vec3, usize),
    ) -> Vec3 {
        let Scene { mesh, occluder, .. } = *scene;
        let lobe = &self.interreflection.lobe;
        let is_metal = self.is_metal(point.gloss);
        let turn = if is_metal {
            pixel as f32 * GOLDEN_ANGLE
        } else {
            0.0
        };
        let origin = occluder.offset_origin(point.position, point.face_normal);
        let mut rays: SmallVec<[(Vec3, f32, f32); METAL_RAYS]> = SmallVec::new();
        let mut total = 0.0;
        lobe.each(
            (point.gloss, turn),
            point.normal,
            view,
            |light, weight, passes, extent| {
                let weight = weight * passes;
                total += weight;
                if weight > 0.0 && light.dot(point.face_normal) > 0.0 {
                    rays.push((light, weight, extent));
                }
            },
        );
        let mut sum = Vec3::ZERO;
        let rays = rays.iter().map(|ray| (ray, ray.0));
        occluder.each_hit(origin, rays, |&(light, weight, extent), hit| {
            let Some(hit) = hit else { return };
            if let Some(cos) = exit_cosine(mesh, hit.triangle, hit.barycentric, light) {
                let gloss = scene.gloss_at(hit.triangle, hit.barycentric);
                sum += self.radiance(mesh, hit.triangle, hit.barycentric)
                    * (weight * scene.diffuse_exit(gloss, cos));
                if is_metal {
                    let place = (hit.triangle, hit.barycentric);
                    sum += weight * self.specular(scene, shader, place, (-light, extent));
                }
            }
        });
        if total > 0.0 {
            shader.tint() * sum / total
        } else {
            Vec3::ZERO
        }
    }

    /// What a place of the surface mirrors of the rest of it in the unit direction `view`, RGB; places with other numbers are looked
    /// at by other rays.
    pub fn reflected(
        &self,
        scene: &Scene,
        shader: &Shader,
        (triangle, barycentric): (u32, Vec2),
        (view, number): (Vec3, usize),
    ) -> Vec3 {
        if !self.is_sheltered(scene.mesh, triangle, barycentric) {
            return Vec3::ZERO;
        }
        let point = scene.point(triangle, barycentric);
        let cos_view = point.normal.dot(view);
        let part = self.reflectance(point.gloss, cos_view);
        part * self.mirrored(scene, shader, &point, (view, number))
    }

    /// R, the part of B̄ that is seen at the cosine `cos` between normal and view where the surface has this gloss, RGB.
    pub(super) fn reflectance(&self, gloss: Gloss, cos: f32) -> Vec3 {
        let lobe = &self.interreflection.lobe;
        let rise = lobe.brdf.at(gloss).rise();
        gloss.scale() * (rise * lobe.reflectance(cos) + (1.0 - rise) * lobe.reflectance(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LampNodes, Lighting, Visibility};
    use rekindle_capture::Mesh;
    use rekindle_scene::reflectance::{Brdf, SpecularModel};
    use rekindle_scene::surface::Occluder;

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

    /// Two plates that meet at a right angle: one lies in the plane y = 0, the other stands in the plane x = 0.
    fn corner() -> Mesh {
        let plate = |across: Vec3| [Vec3::ZERO, across, across + 2.0 * Vec3::Z, 2.0 * Vec3::Z];
        let positions = [plate(2.0 * Vec3::X), plate(2.0 * Vec3::Y)].concat();
        let normals = [[Vec3::Y; 4], [Vec3::X; 4]].concat();
        let triangles = vec![[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]];
        Mesh {
            positions,
            normals,
            triangles,
            ..Mesh::default()
        }
    }

    /// What comes back of a wide light by way of both plates of the corner, per unit of what one plate would show of it.
    fn twice_over_once(brdf: Brdf, specular_scale: Vec3) -> Vec3 {
        let mesh = corner();
        let occluder = Occluder::new(&mesh);
        // Over both plates light goes back to where it came from.
        let view = Vec3::new(0.8, 1.0, 0.1).normalize_or_zero();
        let light = Vec3::new(view.x, view.y, -view.z);
        let lighting = Lighting {
            specular_scale: specular_scale * brdf.usual_specular_scale(),
            ..Lighting::of(vec![LampNodes::disc_of(4000, light, Vec3::ONE, 0.3, None)])
        };
        let shader = Shader::new(&occluder, Some(brdf), &lighting);
        let scene = Scene {
            mesh: &mesh,
            occluder: &occluder,
            brdf: Some(brdf),
            gloss: None,
            surroundings: None,
        };
        let around = Interreflection::new(&mesh, &occluder, Some(brdf)).expect("a metal mirrors");
        let surroundings = Surroundings::new(&around, None, None);
        let point = ShadingPoint::smooth(Vec3::new(0.4, 0.0, 1.0), Vec3::Y);
        let twice = surroundings.mirrored(&scene, &shader, &point, (view, 0))
            * surroundings.reflectance(Gloss::MAIN, view.y);
        // One plate alone, turned so that it shows the middle of the light.
        let facing =
            ShadingPoint::smooth(Vec3::new(0.0, 0.0, 0.0), (view + light).normalize_or_zero());
        let seen: Vec<_> = (0..shader.groups()).map(|_| Visibility::Whole).collect();
        twice / shader.specular(&facing, view, &seen)
    }

    #[test]
    fn a_metal_shows_by_way_of_two_plates_what_one_reflects_of_the_other() {
        let metal = Brdf::new(SpecularModel::Metal, 0.02);
        let half = twice_over_once(metal, Vec3::ONE);
        assert!((half / 0.5 - 1.0).abs().max_element() < 0.05, "{half}");
        // A metal's colour counts once more with each reflection, and no channel reflects more than all.
        let gold = twice_over_once(metal, Vec3::new(1.5, 1.0, 0.5));
        let expected = Vec3::new(0.75, 0.5, 0.25);
        assert!((gold / expected - 1.0).abs().max_element() < 0.05, "{gold}");
        let too_bright = twice_over_once(metal, Vec3::new(9.0, 1.0, 1.0));
        assert!((too_bright.x - 1.0).abs() < 0.05, "{too_bright}");
    }

    #[test]
    fn a_part_of_metal_mirrors_highlights_and_a_dielectric_does_not() {
        let part =
            |strength: f32| Brdf::new(SpecularModel::Ggx, 0.02).at(Gloss::new(1.0, strength));
        // Facets of 4 % at normal incidence, twelve times as much in a metal's part.
        let twice = twice_over_once(part(12.0), Vec3::ONE);
        assert!((twice / 0.48 - 1.0).abs().max_element() < 0.05, "{twice}");
        assert_eq!(twice_over_once(part(1.0), Vec3::ONE), Vec3::ZERO);
    }
}
