//! A second look at a metal that mirrors itself.

use glam::Vec3;

use super::lighting;
use super::solve::name_lamps;
use rekindle_estimate::estimate::{
    Estimate, EstimateInput, EstimateParams, First, Method, Observer, Stopped, estimate,
};
use rekindle_relight::{Interreflection, Scene, Shader, Surroundings};
use rekindle_scene::reflectance::{Brdf, SpecularModel};

/// Directions about the normal in which the rays of a place are cast.
const TURNS: usize = 2;

/// A second estimate of a metal, from what comes straight from the lights, where that leaves no more unexplained than the first.
/// Whatever else reflects mirrors too little of itself to change anything. `input` has the surface that the first one holds for.
pub fn without_mirrored(
    input: &EstimateInput<'_>,
    params: &EstimateParams,
    first: Estimate,
    observer: &mut dyn Observer,
) -> Result<Estimate, Stopped> {
    let is_metal = |brdf: &Brdf| brdf.model == SpecularModel::Metal;
    let Some(brdf) = first.brdf.filter(is_metal) else {
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
    let surroundings = Surroundings::new(&around, None, None);
    let scene = Scene {
        mesh,
        occluder,
        brdf: Some(brdf),
        gloss: None,
        surroundings: Some(&surroundings),
    };
    // Rays of pixels beside each other complete each other in a picture, but here each place is alone.
    let mirrored = |place, (_, view), number: u32| {
        let turns = (0..TURNS).map(|turn| number as usize + turn);
        let of_turn = |turn| surroundings.reflected(&scene, &shader, place, (view, turn));
        let is_clear = !surroundings.is_hollow(mesh, place);
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
        // Something else is wrong, which the first one did not look for.
        second = without(&|_, _, _| Some([0.0; 3]))?;
    }
    Ok(Estimate {
        exposures: first.exposures,
        refined: first.refined,
        ..second
    })
}
