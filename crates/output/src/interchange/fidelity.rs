//! How near another program's material comes to the estimated one.
//!
//! The object is shaded once as rekindle does and once by the reflection model of the program, at the same surface points
//! under the same light and shadows, so that nothing but the material differs:
//!
//! * Beckmann, as in Mitsuba and Blender's Glossy BSDF: `F D G/(4 cos θ_r)` with Smith's masking, which the paper's model does
//!   not have;
//! * GGX, as in glTF, USD and Blender's Principled BSDF: longer tails, Fresnel factor, and a diffuse part that gets what the
//!   lobe leaves, 1 − F.
//!
//! Uniform ambient light is reflected by both; here it lights the diffuse part only. What the surface sends to itself is left
//! out.

use std::f32::consts::PI;

use glam::{DVec2, Vec2, Vec3};
use rayon::prelude::*;

use super::asset::Asset;
use super::gauge::{Material, fresnel};
use rekindle_capture::Camera;
use rekindle_relight::{LampNodes, Stop, psnr};
use rekindle_scene::reflectance::{Brdf, Gloss, SpecularModel};
use rekindle_scene::surface::Occluder;

/// Columns of the pictures that are compared.
const COLUMNS: u32 = 128;
/// Views that are compared at most.
const VIEWS: usize = 6;

/// PSNR of the worst view against rekindle's own shading, dB: sRGB-encoded, over the pixels of the object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fidelity {
    /// For programs with a Beckmann lobe.
    pub beckmann_db: f32,
    /// For programs that know GGX only.
    pub ggx_db: f32,
}

/// A lobe of other programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Lobe {
    Beckmann,
    Ggx,
}

/// A point of the surface with what it sees of each lamp.
struct Place {
    position: Vec3,
    normal: Vec3,
    view: Vec3,
    base_colour: Vec3,
    material: Material,
    brdf: Brdf,
    /// Lamps that reach it.
    seen: Vec<bool>,
}

/// Compares the asset's views; `None` without cameras, without a lobe, where no view shows the object, and where `stop` says
/// so.
pub fn fidelity(asset: &Asset, stop: Stop) -> Option<Fidelity> {
    let main = Brdf::new(asset.material.model?, asset.material.sigma);
    let occluder = Occluder::new(&asset.mesh);
    let lamps = lamps(asset);
    let mut worst: Option<Fidelity> = None;
    let step = asset.cameras.len().div_ceil(VIEWS).max(1);
    for (_, camera) in asset.cameras.iter().step_by(step) {
        if stop() {
            return None;
        }
        let places = places(asset, (&occluder, main), &lamps, camera);
        if places.is_empty() {
            continue;
        }
        let shaded = |shade: &(dyn Fn(&Place) -> Vec3 + Sync)| -> Vec<Vec3> {
            places.par_iter().map(shade).collect()
        };
        let own = shaded(&|place| own_radiance(asset, &lamps, place));
        let other = |lobe| psnr(&own, &shaded(&|place| radiance(asset, lobe, &lamps, place)));
        let here = Fidelity {
            beckmann_db: other(Lobe::Beckmann),
            ggx_db: other(Lobe::Ggx),
        };
        worst = Some(worst.map_or(here, |before| Fidelity {
            beckmann_db: here.beckmann_db.min(before.beckmann_db),
            ggx_db: here.ggx_db.min(before.ggx_db),
        }));
    }
    worst
}

/// Everything that has a direction.
fn lamps(asset: &Asset) -> Vec<LampNodes> {
    let lighting = &asset.lighting;
    let strays = lighting.remainder.iter();
    let strays = strays.filter_map(|&node| LampNodes::new(vec![node], lighting.radius));
    let lamps = lighting.lamps.iter().chain(lighting.environment_lamps());
    lamps.cloned().chain(strays).collect()
}

/// The surface at the pixels' centres; `main` is its main lobe.
fn places(
    asset: &Asset,
    (occluder, main): (&Occluder, Brdf),
    lamps: &[LampNodes],
    camera: &Camera,
) -> Vec<Place> {
    let rows = (COLUMNS * camera.height)
        .div_ceil(camera.width.max(1))
        .max(1);
    let small = camera.resized(COLUMNS, rows);
    let eye = small.position().as_vec3();
    let at = |pixel: u32| {
        let pixel = DVec2::new(f64::from(pixel % COLUMNS), f64::from(pixel / COLUMNS));
        let hit = occluder.hit(eye, small.ray(pixel + 0.5).as_vec3())?;
        let point = asset.mesh.point(hit.triangle, hit.barycentric);
        let face = asset.mesh.face_normal(hit.triangle);
        let view = (eye - point.position).normalize_or(point.normal);
        if view.dot(face) <= 0.0 || view.dot(point.normal) <= 0.0 {
            return None;
        }
        let texel = texel(asset, hit.triangle, hit.barycentric);
        let gloss = (asset.gloss.as_ref()).map_or(Gloss::MAIN, |gloss| gloss.texels()[texel]);
        let origin = occluder.offset_origin(point.position, face);
        let seen = lamps
            .iter()
            .map(|lamp| {
                let (l, _, distance) = towards(asset, lamp, lamp.direction, point.position);
                l.dot(face) > 0.0 && !occluder.occluded(origin, l, distance)
            })
            .collect();
        Some(Place {
            position: point.position,
            normal: point.normal,
            view,
            base_colour: Vec3::from(asset.base_colour[texel]).min(Vec3::ONE),
            material: asset.material_at(texel),
            brdf: main.at(gloss),
            seen,
        })
    };
    (0..COLUMNS * rows).into_par_iter().filter_map(at).collect()
}

/// The nearest texel.
fn texel(asset: &Asset, triangle: u32, barycentric: Vec2) -> usize {
    let [a, b, c] = asset.uvs[triangle as usize];
    let uv = a + (b - a) * barycentric.x + (c - a) * barycentric.y;
    let width = asset.texture_width as usize;
    let height = asset.base_colour.len() / width.max(1);
    let column = ((uv.x * width as f32) as usize).min(width.saturating_sub(1));
    let row = (((1.0 - uv.y) * height as f32) as usize).min(height.saturating_sub(1));
    row * width + column
}

/// Unit direction from a surface point to a node, its fall-off and its distance.
fn towards(asset: &Asset, lamp: &LampNodes, node: Vec3, from: Vec3) -> (Vec3, f32, f32) {
    match lamp.radius {
        None => (node, 1.0, f32::INFINITY),
        Some(radius) => {
            let offset = asset.lighting.centre + radius * node - from;
            let distance = offset.length().max(0.1 * radius);
            (offset / distance, (radius / distance).powi(2), distance)
        }
    }
}

/// Calls `add(l, cos θ_i, flux)` for the nodes that light a place.
fn each_node(
    asset: &Asset,
    lamps: &[LampNodes],
    place: &Place,
    mut add: impl FnMut(Vec3, f32, Vec3),
) {
    for (lamp, _) in lamps.iter().zip(&place.seen).filter(|(_, seen)| **seen) {
        for node in &lamp.nodes {
            let (l, falloff, _) = towards(asset, lamp, node.direction, place.position);
            let cos = l.dot(place.normal);
            if cos > 0.0 {
                add(l, cos, node.flux() * falloff);
            }
        }
    }
}

/// Radiance as rekindle shades it.
fn own_radiance(asset: &Asset, lamps: &[LampNodes], place: &Place) -> Vec3 {
    let Place { material, brdf, .. } = place;
    let terms = brdf.view_terms(place.normal, place.view);
    let mean = match brdf.model {
        SpecularModel::Paper | SpecularModel::Metal => 1.0,
        SpecularModel::Beckmann | SpecularModel::Ggx => {
            (1.0 - material.mean_reflectance()) / (1.0 - material.f0)
        }
    };
    let mut irradiance = asset.lighting.ambient * PI * mean;
    let mut specular = Vec3::ZERO;
    each_node(asset, lamps, place, |l, cos, flux| {
        irradiance += flux * cos * brdf.diffuse_entry(cos);
        specular += flux * brdf.lobe(&terms, l);
    });
    let through = brdf.diffuse_exit(terms.cos_view()) * (1.0 - material.f0);
    place.base_colour / PI * irradiance * through + specular * material.specular_scale
}

/// Radiance as a program with this lobe shades it.
fn radiance(asset: &Asset, lobe: Lobe, lamps: &[LampNodes], place: &Place) -> Vec3 {
    let material = &place.material;
    let (alpha, index) = (material.alpha(), material.refractive_index());
    // The exact form of the paper's model is a mixture by F₀; what knows GGX only has a Fresnel factor.
    let mixed = matches!(
        (lobe, asset.material.model),
        (Lobe::Beckmann, Some(SpecularModel::Paper)) | (Lobe::Ggx, Some(SpecularModel::Metal))
    );
    let reflects = |cos: f32| {
        if mixed {
            material.f0
        } else {
            fresnel(cos, index)
        }
    };
    let (n, v) = (place.normal, place.view);
    let cos_view = n.dot(v);
    let at_view = reflects(cos_view);
    let mut sum = asset.lighting.ambient * (place.base_colour * (1.0 - at_view) + at_view);
    each_node(asset, lamps, place, |l, cos, flux| {
        let h = (l + v).normalize_or(n);
        let reflected = reflects(l.dot(h).clamp(1e-3, 1.0));
        let density = lobe.density(n.dot(h), alpha);
        let masking = lobe.masking(cos, alpha) * lobe.masking(cos_view, alpha);
        let diffuse = place.base_colour / PI * ((1.0 - reflected) * cos);
        sum += flux * (diffuse + reflected * density * masking / (4.0 * cos_view));
    });
    sum
}

impl Lobe {
    /// D at the cosine `cos` between normal and half vector, sr⁻¹.
    fn density(self, cos: f32, alpha: f32) -> f32 {
        let (cos2, squared) = ((cos * cos).max(1e-6), alpha * alpha);
        match self {
            Self::Beckmann => {
                let slope2 = (1.0 - cos2) / cos2;
                (-slope2 / squared).exp() / (PI * squared * cos2 * cos2)
            }
            Self::Ggx => squared / (PI * (cos2 * (squared - 1.0) + 1.0).powi(2)),
        }
    }

    /// Smith's G₁ at the cosine `cos` (Walter et al. 2007).
    fn masking(self, cos: f32, alpha: f32) -> f32 {
        let tangent2 = (1.0 - cos * cos).max(0.0) / (cos * cos).max(1e-6);
        match self {
            Self::Beckmann => {
                let a = 1.0 / (alpha * tangent2.sqrt()).max(1e-6);
                if a < 1.6 {
                    a * (3.535 + 2.181 * a) / (1.0 + a * (2.276 + 2.577 * a))
                } else {
                    1.0
                }
            }
            Self::Ggx => 2.0 / (1.0 + (1.0 + alpha * alpha * tangent2).sqrt()),
        }
    }
}
