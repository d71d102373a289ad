//! Gloss that is only stated.
//!
//! Who states a roughness says that there is gloss. Where photographs don't show it under lights from anywhere, those that explain most at
//! that roughness stand for whatever else differs between views, and make views left out worse than no gloss at all. So the light is what
//! the shading says there, and the gloss as strong as the views allow under it.

use glam::Vec3;

use super::SpecularChoice;
use super::below::AllAround;
use super::course::{Ending, Grounds};
use super::fast::{Fit, Solver, Watch};
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

/// The lobe under the light by shading; `None` where no point says anything of it.
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
    let Some(under) = lobe_under(&whole, nodes, choice.or(&DIELECTRICS), watch)? else {
        return Ok(None);
    };
    let scale = Vec3::from(under.scale);
    let scaled = nodes.iter().map(|&l| (scale * Vec3::from(l)).to_array());
    Ok(Some(Ending {
        fit: Fit {
            brdf: under.brdf,
            nodes: scaled.collect(),
            sigma_error: 0.0,
            noise_error: 0.0,
            misfit: under.misfit,
            parts: None,
        },
        because: under.because,
        refined: None,
        suspicion: None,
        bound: None,
        allowed: [1.0; 2],
        grid: light.grid().clone(),
        broad_light: Vec::new(),
        grounds: Grounds::StatedUnderShading,
        agreement: None,
    }))
}
