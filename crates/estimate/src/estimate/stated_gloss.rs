//! Gloss that is only stated.
//!
//! Who states a roughness says that there is gloss. Where photographs don't show it under lights from anywhere, those that explain most at
//! that roughness stand for whatever else differs between views, and make views left out worse than no gloss at all. So the light is what
//! the shading says there, and the gloss as strong as the views allow under it, if it then explains each of them better where that has no
//! say in diffuse colours.

use glam::Vec3;

use super::SpecularChoice;
use super::below::AllAround;
use super::course::{Ending, Grounds};
use super::fast::{Fit, Solver, Watch};
use super::held_lights::HeldLights;
use super::held_out::{CHANCE, common_noise, gain};
use super::known_light::lobe_under;
use super::observer::{Stopped, go_on};
use super::shading::LightByShading;

/// Points at which views are predicted.
const POINTS: usize = 8000;

/// The lobe under the light by shading; `None` where it explains views no better than diffuse colours alone, beyond what chance does in one
/// case of twenty.
pub fn under_shading(
    solver: &Solver<'_>,
    light: &LightByShading,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<Ending>, Stopped> {
    go_on(watch.observer.progress("fitting roughness and gloss", 0.5))?;
    let around = AllAround::of(solver);
    let whole = around.solver(solver);
    let nodes = light.nodes();
    let Some(under) = lobe_under(&whole, &nodes, choice, watch)? else {
        return Ok(None);
    };
    let scale = Vec3::from(under.scale);
    let nodes = nodes
        .into_iter()
        .map(|l| (scale * Vec3::from(l)).to_array());
    let fit = Fit {
        brdf: under.brdf,
        nodes: nodes.collect(),
        sigma_error: 0.0,
        noise_error: 0.0,
        misfit: under.misfit,
        parts: None,
    };
    let held = HeldLights::of(&whole, fit.brdf, &fit.nodes);
    let points = held.points(&whole, POINTS);
    let noise = common_noise(&whole.design(&points, &[]));
    let left = held.left_out_in_turn(&whole, &points, noise);
    Ok((gain(&left) > CHANCE).then(|| Ending {
        fit,
        because: under.because,
        refined: None,
        suspicion: None,
        bound: None,
        allowed: [1.0; 2],
        grid: light.grid().clone(),
        grounds: Grounds::StatedUnderShading,
    }))
}
