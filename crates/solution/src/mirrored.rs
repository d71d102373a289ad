//! A second look at a surface of metal, all or in part, that mirrors itself.

use std::borrow::Cow;

use glam::Vec3;

use super::lighting::lighting;
use super::solve::{Measured, gloss, name_lamps};
use rekindle_estimate::estimate::{
    Estimate, EstimateInput, EstimateParams, First, Method, Observer, Stopped, estimate,
};
use rekindle_relight::{GlossMap, Interreflection, Scene, Shader, Surroundings};
use rekindle_scene::reflectance::Brdf;
use rekindle_scene::surface::{GlossTexture, MinimumTexture};

/// Directions about the normal in which the rays of a place are cast.
const TURNS: usize = 2;

/// A second estimate of a surface with metal, from what comes straight from the lights, where that leaves no more unexplained than
/// the first. Whatever else reflects mirrors too little of itself to change anything. `input` has the surface that the first one holds
/// for, of which `on` says what was measured and its dark texture.
pub fn without_mirrored(
    input: &EstimateInput<'_>,
    on: (&Measured, &MinimumTexture),
    params: &EstimateParams,
    first: Estimate,
    observer: &mut dyn Observer,
) -> Result<Estimate, Stopped> {
    let Some(brdf) = first.brdf.filter(|_| first.has_metal()) else {
        return Ok(first);
    };
    let EstimateInput { occluder, .. } = *input;
    let mesh = &input.capture.mesh;
    let around = match params.method {
        Method::Fast if !observer.enough() => Interreflection::new(mesh, occluder, Some(brdf)),
        _ => None,
    };
    let Some(around) = around else {
        return Ok(first);
    };
    let (lamps, lobe) = (name_lamps(&first, false), (Some(brdf), None));
    let lit = lighting(&first.grid, &first.radiance, &lamps, Vec3::ZERO, lobe);
    let shader = Shader::new(occluder, Some(brdf), &lit);
    let (atlas, minimum) = (&on.0.atlas, on.1);
    let texture = gloss(&first, mesh, atlas, minimum);
    let guess = diffuse_guess(Some(brdf), texture.as_ref(), &minimum.radiance);
    let guess = guess.as_deref().map(|guess| (atlas, guess));
    let surroundings = Surroundings::new(&around, guess, None);
    let scene = Scene {
        mesh,
        occluder,
        brdf: Some(brdf),
        gloss: texture.as_ref().map(|texture| GlossMap { atlas, texture }),
        surroundings: Some(&surroundings),
    };
    // Rays of pixels beside each other complete each other in a picture, but here each place is alone.
    let mirrored = |place, (_, view), number: u32| {
        let turns = (0..TURNS).map(|turn| number as usize + turn);
        let of_turn = |turn| surroundings.reflected(&scene, &shader, place, (view, turn));
        let is_clear = !surroundings.is_hollow(&scene, place);
        is_clear.then(|| (turns.map(of_turn).sum::<Vec3>() / TURNS as f32).into())
    };
    let mut without = |mirrored| {
        let first = First {
            estimate: &first,
            mirrored,
        };
        let again = EstimateInput {
            first: Some(first),
            ..*input
        };
        estimate(&again, params, observer)
    };
    let mut second = without(&mirrored)?;
    if second.misfit > first.misfit {
        if !brdf.is_metal() {
            return Ok(first);
        }
        // Something else is wrong, which the first one of a metal did not look for.
        second = without(&|_, _, _| Some([0.0; 3]))?;
    }
    Ok(Estimate {
        exposures: first.exposures,
        refined: first.refined,
        ..second
    })
}

/// A first guess at the diffuse texture, of which the surface mirrors a part: its dark texture where it isn't of metal; none where all
/// of it is.
pub fn diffuse_guess<'m>(
    brdf: Option<Brdf>,
    gloss: Option<&GlossTexture>,
    dark: &'m [[f32; 3]],
) -> Option<Cow<'m, [[f32; 3]]>> {
    let Some(main) = brdf else {
        return Some(Cow::Borrowed(dark));
    };
    let is_metal = |gloss: &_| main.at(*gloss).is_metal();
    let part = |(dark, gloss): (&[f32; 3], _)| if is_metal(gloss) { [0.0; 3] } else { *dark };
    match gloss.map(GlossTexture::texels) {
        None => (!main.is_metal()).then_some(Cow::Borrowed(dark)),
        Some(texels) if texels.iter().any(is_metal) => {
            Some(dark.iter().zip(texels).map(part).collect())
        }
        Some(_) => Some(Cow::Borrowed(dark)),
    }
}
