//! The true scene, rendered by the reference renderer.
//!
//! The renderer works with light times K_S; so do the lamps here, and the albedo is divided by K_S in return. Radiances
//! come out in the units of the lamps.

use std::f32::consts::PI;

use glam::{Quat, Vec3};
use rayon::prelude::*;

use super::lamps::TrueLamp;
use super::recipe::{Light, Recipe};
use super::tessellate::tessellate;
use super::texture::Texture;
use rekindle_base::math::random::Random;
use rekindle_capture::{Camera, Mesh};
use rekindle_relight::{
    Diffuse, Environment, Interreflection, LampNodes, LatLong, Lighting, Picture, Scene, Shader,
    Surroundings, render,
};
use rekindle_scene::reflectance::Brdf;
use rekindle_scene::surface::{Atlas, Occluder};

/// Texels of the true texture along a pixel where the object is nearest.
const TEXELS_PER_PIXEL: f64 = 1.5;

/// The photographed surface.
pub(super) struct TrueSurface {
    pub mesh: Mesh,
    occluder: Occluder,
    atlas: Atlas,
    /// Albedo / (π K_S) per texel.
    texture: Vec<[f32; 3]>,
    brdf: Brdf,
    strength: f32,
    interreflection: Option<Interreflection>,
    supersampling: u32,
}

impl TrueSurface {
    /// The surface of a recipe, its texture as fine as `magnification` pixels per unit of length show.
    pub(super) fn new(recipe: &Recipe, mesh: Mesh, magnification: f64, random: Random) -> Self {
        let occluder = Occluder::new(&mesh);
        let density = (magnification * TEXELS_PER_PIXEL) as f32;
        let atlas = Atlas::lattice(&mesh, &vec![density; mesh.triangles.len()]);
        let mut texture = Texture::new(recipe.texture_contrast, random).bake(&mesh, &atlas);
        let material = recipe.material;
        for value in texture.iter_mut().flatten() {
            *value /= PI * material.strength;
        }
        let brdf = Brdf::new(material.model, material.sigma);
        let interreflection = recipe
            .interreflection
            .then(|| Interreflection::new(&mesh, &occluder, Some(brdf)))
            .flatten();
        Self {
            mesh,
            occluder,
            atlas,
            texture,
            brdf,
            strength: material.strength,
            interreflection,
            supersampling: recipe.views.supersampling,
        }
    }

    /// The surface as a recipe has it, without texture.
    pub(super) fn mesh_of(recipe: &Recipe) -> Mesh {
        tessellate(recipe.object, recipe.triangles)
    }

    fn lighting(&self, lamps: Vec<LampNodes>, environment: Option<Environment>) -> Lighting {
        Lighting {
            environment,
            centre: self.mesh.centre(),
            specular_scale: Vec3::splat(self.strength),
            ..Lighting::of(lamps)
        }
    }

    /// The light of these lamps.
    pub(super) fn lamps(&self, lamps: &[TrueLamp]) -> Lighting {
        let nodes = lamps
            .iter()
            .map(|lamp| lamp.nodes(self.brdf.sigma, self.strength))
            .collect();
        self.lighting(nodes, None)
    }

    /// The light of a probe, its radiance times `scale`.
    pub(super) fn probe(&self, probe: &LatLong, scale: f32) -> Lighting {
        let gain = Vec3::splat(scale * self.strength);
        self.lighting(Vec::new(), probe.environment(Quat::IDENTITY, gain))
    }

    /// What the cameras see under a light; `each` is told every picture's number and may stop by an error.
    pub(super) fn photographs<E>(
        &self,
        lighting: &Lighting,
        cameras: &[Camera],
        each: &mut dyn FnMut(usize) -> Result<(), E>,
    ) -> Result<Vec<Picture>, E> {
        let shader = Shader::new(&self.occluder, Some(self.brdf), lighting);
        let relit = self
            .interreflection
            .as_ref()
            .map(|i| i.of_light(&self.mesh, &shader, &self.atlas, &self.texture));
        let surroundings = (self.interreflection.as_ref())
            .map(|around| Surroundings::new(around, Some((&self.atlas, &self.texture)), relit));
        let scene = Scene {
            mesh: &self.mesh,
            occluder: &self.occluder,
            brdf: Some(self.brdf),
            gloss: None,
            surroundings: surroundings.as_ref(),
        };
        let diffuse = Diffuse::Relit(&self.atlas, &self.texture);
        cameras
            .iter()
            .enumerate()
            .map(|(i, camera)| {
                each(i)?;
                let fine = camera.supersampled(self.supersampling);
                Ok(reduced(
                    render(&scene, &fine, &shader, diffuse),
                    self.supersampling,
                ))
            })
            .collect()
    }
}

/// Means over squares of pixels.
fn reduced(fine: Picture, factor: u32) -> Picture {
    if factor == 1 {
        return fine;
    }
    let (width, height) = (fine.width / factor, fine.height / factor);
    let share = 1.0 / (factor * factor) as f32;
    let mean = |pixel: usize, value: &dyn Fn(usize) -> Vec3| {
        let (x, y) = (pixel as u32 % width * factor, pixel as u32 / width * factor);
        let squares =
            (0..factor * factor).map(|k| ((y + k / factor) * fine.width + x + k % factor) as usize);
        squares.map(value).sum::<Vec3>() * share
    };
    let pixels = 0..(width * height) as usize;
    let means = |values: &[[f32; 3]]| -> Vec<[f32; 3]> {
        pixels
            .clone()
            .into_par_iter()
            .map(|i| mean(i, &|k| values[k].into()).to_array())
            .collect()
    };
    Picture {
        width,
        height,
        coverage: pixels
            .clone()
            .map(|i| mean(i, &|k| Vec3::splat(fine.coverage[k])).x)
            .collect(),
        diffuse: means(&fine.diffuse),
        specular: means(&fine.specular),
    }
}

/// Light of a recipe as it is: lamps, or a probe's picture.
pub(super) enum TrueLight {
    Lamps(Vec<TrueLamp>),
    Probe(LatLong),
}

impl TrueLight {
    /// Places the lamps or reads the probe; the error is a whole sentence that names its file.
    pub(super) fn new(recipe: &Recipe, random: Random) -> Result<Self, String> {
        match &recipe.light {
            Light::Lamps(lamps) => Ok(Self::Lamps(super::lamps::place(
                lamps,
                recipe.views.scale,
                random,
            ))),
            Light::Probe(path) => LatLong::load(path).map(Self::Probe),
        }
    }

    /// The lamps, none of a probe.
    pub(super) fn lamps(&self) -> &[TrueLamp] {
        match self {
            Self::Lamps(lamps) => lamps,
            Self::Probe(_) => &[],
        }
    }
}
