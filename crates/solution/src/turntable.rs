//! An object that turns under lights that stand still: in every view it lights itself anew.
//!
//! What a place sends in a view is in the pictures: the texture that follows as if the surface did not light itself is its diffuse
//! radiance over the direct irradiance, whatever the light that is wanting came from. Times the direct irradiance of each view it is what
//! others get there. That is taken out of the pictures, and the estimate goes on with what comes straight from the lights.

use glam::{DAffine3, Vec2, Vec3};
use rayon::prelude::*;

use super::lighting::lighting;
use super::solve::{Measured, Sight, name_lamps, report_texture};
use rekindle_capture::Mesh;
use rekindle_estimate::estimate::{
    Estimate, EstimateInput, EstimateParams, First, Method, Observer, Stopped, estimate, watched,
};
use rekindle_relight::{
    DiffuseTexture, GlossMap, Interreflection, LightOfViews, Lighting, Scene, Shader, Surroundings,
    ViewLight, ambient_gain, filled_albedo, reconstruct,
};
use rekindle_scene::reflectance::Brdf;
use rekindle_scene::surface::{GlossTexture, Texel};

/// Part of the irradiance that has to come from the surface itself, in the view with most of it, for the estimate to be made again.
const MUCH: f32 = 0.01;

/// The lighting that was found as it stands to the object in each view.
pub fn lightings(found: &Estimate, motions: &[DAffine3]) -> Vec<Lighting> {
    let (lamps, lobe) = (name_lamps(found, false), (found.brdf, None));
    let ambient = found.ambient_irradiance.unwrap_or(Vec3::ZERO) / ambient_gain(found.brdf);
    let lit = lighting(&found.grid, &found.radiance, &lamps, ambient, lobe);
    motions.iter().map(|m| lit.moved(&m.inverse())).collect()
}

/// How a surface that turns lights itself, as its pictures show.
pub struct SelfLit<'a> {
    mesh: &'a Mesh,
    measured: &'a Measured,
    brdf: Brdf,
    around: Interreflection,
    /// The lights that were found, in each view.
    lightings: Vec<Lighting>,
    /// Diffuse radiance of every texel over its direct irradiance, RGB.
    factor: Vec<[f32; 3]>,
    /// What a texture leaves of the views as if the surface did not light itself, squared.
    left: f64,
}

impl<'a> SelfLit<'a> {
    /// Looks at the views under the lights that were found. `None` where the lobe leaves open how strong interreflection is.
    pub fn new(
        sight: Sight<'a>,
        gloss: Option<&GlossTexture>,
        found: &Estimate,
        motions: &[DAffine3],
        observer: &mut dyn Observer,
    ) -> Result<Option<Self>, Stopped> {
        let Sight { mesh, measured, .. } = sight;
        let around = Interreflection::new(mesh, &measured.occluder, found.brdf);
        let Some((around, brdf)) = around.zip(found.brdf) else {
            return Ok(None);
        };
        let lightings = lightings(found, motions);
        let atlas = &measured.atlas;
        let texture = texture(sight, (brdf, gloss), (&lightings, &[]), observer)?;
        let scene = plain(mesh, measured, brdf);
        Ok(Some(Self {
            factor: filled_albedo(&scene, atlas, &texture),
            left: left(&texture),
            mesh,
            measured,
            brdf,
            around,
            lightings,
        }))
    }

    /// Whether views are explained better where the surface lights itself as `sent` says: how strongly it does follows from the form of
    /// the lobe, which may be wrong.
    pub fn is_borne_out(
        &self,
        sight: Sight<'_>,
        gloss: Option<&GlossTexture>,
        sent: &[Surroundings<'_>],
        observer: &mut dyn Observer,
    ) -> Result<bool, Stopped> {
        let texture = texture(sight, (self.brdf, gloss), (&self.lightings, sent), observer)?;
        Ok(left(&texture) < self.left)
    }

    fn shader(&self, view: usize) -> Shader<'_> {
        let occluder = &self.measured.occluder;
        Shader::new(occluder, Some(self.brdf), &self.lightings[view])
    }

    /// What surrounds each place in each view.
    pub fn surroundings(&self) -> Vec<Surroundings<'_>> {
        let on = (self.mesh, &self.measured.atlas);
        let of_view = |view| {
            let shader = self.shader(view);
            Surroundings::pictured(&self.around, on, &shader, &self.factor)
        };
        (0..self.lightings.len()).map(of_view).collect()
    }

    /// A second estimate, without what the surface sends itself, where that is much.
    pub fn without_sent(
        &self,
        input: &EstimateInput<'_>,
        params: &EstimateParams,
        first: Estimate,
        sent: &[Surroundings<'_>],
        observer: &mut dyn Observer,
    ) -> Result<Estimate, Stopped> {
        let is_much = sent.iter().any(|view| view.indirect_part() > MUCH);
        if params.method != Method::Fast || observer.enough() || !is_much {
            return Ok(first);
        }
        let (mesh, atlas, brdf) = (self.mesh, &self.measured.atlas, self.brdf);
        let scene = plain(mesh, self.measured, brdf);
        let shaders: Vec<Shader<'_>> = (0..sent.len()).map(|view| self.shader(view)).collect();
        let albedo = self.albedo(sent);
        let mirrored = |place: (u32, Vec2), (view, to_camera): (usize, Vec3), number: u32| {
            let own = &sent[view];
            if own.is_hollow(&scene, place) {
                return None;
            }
            let cos_view = mesh.point(place.0, place.1).normal.dot(to_camera);
            let [_, indirect] = own.direct_and_indirect(mesh, place);
            let diffuse = atlas.sample(&albedo, place.0, place.1) * indirect;
            let towards = (to_camera, number as usize);
            let specular = own.reflected(&scene, &shaders[view], place, towards);
            Some((brdf.diffuse_exit(cos_view) * diffuse + specular).to_array())
        };
        let again = EstimateInput {
            first: Some(First {
                estimate: &first,
                mirrored: &mirrored,
            }),
            ..*input
        };
        estimate(&again, params, observer)
    }

    /// The albedo under all the light.
    fn albedo(&self, sent: &[Surroundings<'_>]) -> Vec<[f32; 3]> {
        let texels = &self.measured.atlas.texels;
        let of_texel = |texel: &Texel| {
            let place = (texel.triangle, texel.barycentric);
            let of_views = (sent.iter()).map(|view| view.direct_and_indirect(self.mesh, place));
            let [direct, indirect] = of_views.fold([Vec3::ZERO; 2], |sum, view| {
                [sum[0] + view[0], sum[1] + view[1]]
            });
            let all = (direct + indirect).max(Vec3::splat(f32::MIN_POSITIVE));
            Vec3::from(self.factor[texel.index as usize]) * direct / all
        };
        let of_texels: Vec<Vec3> = texels.par_iter().map(of_texel).collect();
        let mut albedo = vec![[0.0; 3]; self.factor.len()];
        for (texel, own) in texels.iter().zip(of_texels) {
            albedo[texel.index as usize] = own.to_array();
        }
        albedo
    }
}

/// A surface of one gloss.
fn plain<'a>(mesh: &'a Mesh, measured: &'a Measured, brdf: Brdf) -> Scene<'a> {
    Scene {
        mesh,
        occluder: &measured.occluder,
        brdf: Some(brdf),
        gloss: None,
        surroundings: None,
    }
}

/// What a texture leaves of its views, squared.
fn left(texture: &DiffuseTexture) -> f64 {
    texture.fit.iter().map(|view| view.squared).sum()
}

/// The texture of albedo that views show under these lights, with what surrounds each place in each view, where that is given.
fn texture(
    sight: Sight<'_>,
    (brdf, gloss): (Brdf, Option<&GlossTexture>),
    (lightings, sent): (&[Lighting], &[Surroundings<'_>]),
    observer: &mut dyn Observer,
) -> Result<DiffuseTexture, Stopped> {
    watched(observer, |watcher| {
        let mut observer = watcher;
        report_texture(&mut observer)?;
        let Sight { mesh, measured, .. } = sight;
        let atlas = &measured.atlas;
        let scene = Scene {
            gloss: gloss.map(|texture| GlossMap { atlas, texture }),
            ..plain(mesh, measured, brdf)
        };
        let light = |(view, lighting): (usize, &Lighting)| {
            let shader = Shader::new(scene.occluder, Some(brdf), lighting);
            ViewLight {
                surroundings: sent.get(view),
                ..ViewLight::new(mesh, atlas, shader.stopped_by(watcher.stop()))
            }
        };
        let lights: Vec<ViewLight<'_>> = lightings.iter().enumerate().map(light).collect();
        let of_views = LightOfViews::Each(&lights);
        let (views, surfaces) = (sight.views, sight.surfaces);
        let texture = reconstruct(&scene, views, surfaces, atlas, &of_views, sight.shortcuts);
        report_texture(&mut observer)?;
        Ok(texture)
    })
}
