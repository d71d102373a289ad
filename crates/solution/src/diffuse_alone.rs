//! What a capture gives where all that it shows is taken as diffuse: what an estimate of lights has to be better than.

use rayon::prelude::*;

use super::Solution;
use rekindle_capture::{Camera, Capture};
use rekindle_estimate::registration::{corrected, within_outlines};
use rekindle_relight::{
    Diffuse, LightOfViews, Lighting, Picture, Scene, Shader, ViewLight, reconstruct, render,
};
use rekindle_scene::shortcuts::Shortcuts;
use rekindle_scene::surface::{Occluder, ViewSurface};

/// Pictures that `cameras` take of a solution's surface with the texture that its capture's views give without any lobe.
pub fn diffuse_alone(capture: &Capture, solution: &Solution, cameras: &[Camera]) -> Vec<Picture> {
    let Solution { mesh, atlas, .. } = solution;
    let occluder = Occluder::new(mesh);
    let see = |capture: &Capture| -> Vec<ViewSurface> {
        let views = capture.views.par_iter();
        let seen = views.map(|view| ViewSurface::new(mesh, &occluder, &view.camera));
        seen.collect()
    };
    let capture = corrected(capture, &solution.corrections);
    let surfaces = see(&capture);
    let (capture, _) = within_outlines(&capture, &surfaces);
    let scene = Scene {
        mesh,
        occluder: &occluder,
        brdf: None,
        gloss: None,
        surroundings: None,
    };
    let shader = Shader::new(&occluder, None, &without_light(solution));
    let light = ViewLight::new(mesh, atlas, shader);
    let shortcuts = Shortcuts::default();
    let texture = reconstruct(
        &scene,
        &capture.views,
        surfaces,
        atlas,
        &LightOfViews::Same(&light),
        &shortcuts,
    );
    let diffuse = Diffuse::Stored(atlas, &texture.radiance);
    let picture = |camera| render(&scene, camera, &light.shader, diffuse);
    cameras.iter().map(picture).collect()
}

/// The captured lighting with nothing lit.
fn without_light(solution: &Solution) -> Lighting {
    Lighting {
        lamps: Vec::new(),
        remainder: Vec::new(),
        ..solution.lighting()
    }
}
