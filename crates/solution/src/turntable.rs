//! An object that turns under lights that stand still: in every view it lights itself anew.
//!
//! What a place sends in a view is in the pictures: the texture that follows as if the surface did not light itself is its diffuse
//! radiance over the direct irradiance, whatever the light that is wanting came from. Times the direct irradiance of each view it is what
//! others get there. That is taken out of the pictures, and the estimate goes on with what comes straight from the lights.

use glam::{DAffine3, Vec3};
use rayon::prelude::*;

use super::lighting;
use super::solve::{Sight, name_lamps, report_texture};
use rekindle_estimate::estimate::{
    Estimate, EstimateInput, EstimateParams, First, Method, Observer, Stopped, estimate, watched,
};
use rekindle_relight::{
    GlossMap, Interreflection, LightOfViews, Lighting, Scene, Shader, Surroundings, ViewLight,
    ambient_gain, filled_albedo, reconstruct,
};
use rekindle_scene::reflectance::Brdf;
use rekindle_scene::surface::GlossTexture;

/// Part of the irradiance that has to come from the surface itself, in the view with most of it, for the estimate to be made again.
const MUCH: f32 = 0.01;

/// The lighting that was found as it stands to the object in each view.
pub fn lightings(found: &Estimate, motions: &[DAffine3]) -> Vec<Lighting> {
    let (lamps, lobe) = (name_lamps(found, false), (found.brdf, None));
    let ambient = found.ambient_irradiance.unwrap_or(Vec3::ZERO) / ambient_gain(found.brdf);
    let lit = lighting(&found.grid, &found.radiance, &lamps, ambient, lobe);
    motions.iter().map(|m| lit.moved(&m.inverse())).collect()
}

/// Diffuse radiance of every texel over its direct irradiance, RGB, as views under these lights show it.
pub fn pictured(
    sight: Sight<'_>,
    (brdf, gloss): (Option<Brdf>, Option<&GlossTexture>),
    lightings: &[Lighting],
    observer: &mut dyn Observer,
) -> Result<Vec<[f32; 3]>, Stopped> {
    watched(observer, |watcher| {
        let mut observer = watcher;
        report_texture(&mut observer)?;
        let Sight { mesh, measured, .. } = sight;
        let atlas = &measured.atlas;
        let scene = Scene {
            mesh,
            occluder: &measured.occluder,
            brdf,
            gloss: gloss.map(|texture| GlossMap { atlas, texture }),
            surroundings: None,
        };
        let light = |lighting: &Lighting| {
            let shader = Shader::new(scene.occluder, brdf, lighting).stopped_by(watcher.stop());
            ViewLight::new(mesh, atlas, shader)
        };
        let lights: Vec<ViewLight<'_>> = lightings.iter().map(light).collect();
        let of_views = LightOfViews::Each(&lights);
        let (views, surfaces) = (sight.views, sight.surfaces);
        let texture = reconstruct(&scene, views, surfaces, atlas, &of_views, sight.shortcuts);
        report_texture(&mut observer)?;
        Ok(filled_albedo(&scene, atlas, &texture))
    })
}

/// The surface as it lights itself in each view.
pub fn surroundings<'a>(
    around: &'a Interreflection,
    sight: &Sight<'a>,
    brdf: Option<Brdf>,
    lightings: &[Lighting],
    pictured: &'a [[f32; 3]],
) -> Vec<Surroundings<'a>> {
    let of_view = |lighting: &Lighting| {
        let shader = Shader::new(&sight.measured.occluder, brdf, lighting);
        let on = (sight.mesh, &sight.measured.atlas);
        Surroundings::pictured(around, on, &shader, pictured)
    };
    lightings.iter().map(of_view).collect()
}

/// A second estimate, without what the surface sends itself under the lights of the first one, where that is much. `pictured` is on the
/// atlas of `sight`.
pub fn without_sent(
    input: &EstimateInput<'_>,
    params: &EstimateParams,
    first: Estimate,
    (sight, sent, lightings): (&Sight<'_>, &[Surroundings<'_>], &[Lighting]),
    pictured: &[[f32; 3]],
    observer: &mut dyn Observer,
) -> Result<Estimate, Stopped> {
    let is_much = sent.iter().any(|view| view.indirect_part() > MUCH);
    if params.method != Method::Fast || observer.enough() || !is_much {
        return Ok(first);
    }
    let Some(brdf) = first.brdf else {
        return Ok(first);
    };
    let (mesh, atlas) = (sight.mesh, &sight.measured.atlas);
    let scene = Scene {
        mesh,
        occluder: input.occluder,
        brdf: Some(brdf),
        gloss: None,
        surroundings: None,
    };
    let shader = |lighting| Shader::new(input.occluder, Some(brdf), lighting);
    let shaders: Vec<Shader<'_>> = lightings.iter().map(shader).collect();
    let mut albedo = pictured.to_vec();
    let of_texels: Vec<Vec3> = (atlas.texels.par_iter())
        .map(|texel| {
            let place = (texel.triangle, texel.barycentric);
            let of_views = sent
                .iter()
                .map(|view| view.direct_and_indirect(mesh, place));
            let [direct, indirect] = of_views.fold([Vec3::ZERO; 2], |sum, view| {
                [sum[0] + view[0], sum[1] + view[1]]
            });
            let all = (direct + indirect).max(Vec3::splat(f32::MIN_POSITIVE));
            Vec3::from(pictured[texel.index as usize]) * direct / all
        })
        .collect();
    for (texel, own) in atlas.texels.iter().zip(of_texels) {
        albedo[texel.index as usize] = own.to_array();
    }
    let mirrored = |place: (u32, glam::Vec2), (view, to_camera): (usize, Vec3), number: u32| {
        let own = &sent[view];
        let cos_view = mesh.point(place.0, place.1).normal.dot(to_camera);
        let [_, indirect] = own.direct_and_indirect(mesh, place);
        let diffuse = atlas.sample(&albedo, place.0, place.1) * indirect;
        let specular = own.reflected(&scene, &shaders[view], place, (to_camera, number as usize));
        (brdf.diffuse_exit(cos_view) * diffuse + specular).to_array()
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
