//! Gloss under the light that the shading tells.
//!
//! Who states a roughness says that there is gloss. Where photographs don't show it under lights from anywhere, those that explain most at
//! that roughness stand for whatever else differs between views, and make views left out worse than no gloss at all. So the light is what
//! the shading says there, and the gloss as strong as the views allow under it.
//!
//! Where photographs show gloss that is faint and wide, as clay's and stone's, what surface and cameras are off by moves the lights that
//! explain it. The light by shading is fitted to none of that: two numbers, roughness and strength, are all that gloss has under it. If it then
//! explains views left out nearly as well, all the lights' unknowns aren't worth it; and if they make the texture less even, they are wrong.

use glam::Vec3;

use super::SpecularChoice;
use super::below::AllAround;
use super::course::{Ending, Grounds};
use super::fast::{Fit, Solver, Watch};
use super::gloss::WORTH;
use super::held_lights::HeldLights;
use super::held_out::{CHANCE, common_noise};
use super::interval;
use super::known_light::lobe_under;
use super::observer::{Stopped, go_on};
use super::shading::LightByShading;
use rekindle_scene::reflectance::SpecularModel;

/// What a surface with a diffuse part, which the light is told by, may reflect like.
const DIELECTRICS: [SpecularModel; 3] = [
    SpecularModel::Paper,
    SpecularModel::Beckmann,
    SpecularModel::Ggx,
];

/// Points at which views are predicted.
const POINTS: usize = 8000;

/// A gloss that is stated; `None` where no point says anything of it.
pub fn stated(
    solver: &Solver<'_>,
    light: &LightByShading,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<Ending>, Stopped> {
    let under = under(solver, light, choice, watch)?;
    Ok(under.map(|fit| ended(fit, light, Grounds::StatedUnderShading)))
}

/// Gloss that is found under other lights, if these are not worth their unknowns and make the texture less even, beyond chance.
pub fn bettered(
    solver: &Solver<'_>,
    ending: &Ending,
    light: &LightByShading,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<Ending>, Stopped> {
    let less_even = || light.less_even_under(solver, &ending.grid, &ending.fit.nodes);
    if watch.observer.enough() || less_even() <= CHANCE {
        return Ok(None);
    }
    let Some(found) = under(solver, light, choice, watch)? else {
        return Ok(None);
    };
    let around = AllAround::of(solver);
    let whole = around.solver(solver);
    let points = whole.colours(POINTS);
    let noise = common_noise(&whole.design(&points, &[]));
    let parted = (ending.fit.parts.as_ref()).map(|parts| whole.parted(parts));
    let left = |solver: &Solver<'_>, fit: &Fit| -> f64 {
        let lights = HeldLights::of(solver, fit.brdf, &fit.nodes);
        let left = lights.left_out_in_turn(solver, &points, noise);
        left.iter().map(|left| left.lit).sum()
    };
    let by_lights = left(parted.as_ref().unwrap_or(&whole), &ending.fit);
    let is_worth = by_lights < WORTH * left(&whole, &found.0);
    // Which lights there are is open, and so is what roughness either have.
    let sigma = found.0.brdf.sigma;
    let allowed = interval(&ending.fit, ending.allowed, None).map(|end| end / sigma);
    Ok((!is_worth).then(|| Ending {
        allowed,
        bound: ending.bound,
        ..ended(found, light, Grounds::Shading)
    }))
}

/// The lobe under the light by shading, and why that one.
fn under(
    solver: &Solver<'_>,
    light: &LightByShading,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<(Fit, String)>, Stopped> {
    go_on(watch.observer.progress("fitting roughness and gloss", 0.5))?;
    let around = AllAround::of(solver);
    let whole = around.solver(solver);
    let nodes = light.nodes();
    let Some(under) = lobe_under(&whole, nodes, choice.or(&DIELECTRICS), watch)? else {
        return Ok(None);
    };
    let scale = Vec3::from(under.scale);
    let scaled = nodes.iter().map(|&l| (scale * Vec3::from(l)).to_array());
    let fit = Fit {
        brdf: under.brdf,
        nodes: scaled.collect(),
        sigma_error: 0.0,
        noise_error: 0.0,
        misfit: under.misfit,
        parts: None,
    };
    Ok(Some((fit, under.because)))
}

fn ended((fit, because): (Fit, String), light: &LightByShading, grounds: Grounds) -> Ending {
    Ending {
        fit,
        because,
        refined: None,
        suspicion: None,
        bound: None,
        allowed: [1.0; 2],
        grid: light.grid().clone(),
        broad_light: Vec::new(),
        grounds,
        agreement: None,
    }
}
