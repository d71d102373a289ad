//! A small solution that the tests of several rooms share.

use std::sync::Arc;

use glam::Vec3;

use rekindle_capture::{LightFrame, Mesh};
use rekindle_estimate::estimate::{Diagnostics, Method};
use rekindle_relight::{Scene, Shader, ShadingPoint};
use rekindle_scene::hemisphere::HemisphereGrid;
use rekindle_scene::reflectance::{Brdf, SpecularModel};
use rekindle_scene::surface::fixtures::bumpy_sphere;
use rekindle_scene::surface::{Atlas, Occluder};
use rekindle_solution::{Fit, Skipped, Solution, SolutionLamp, lighting};

/// A unit sphere.
pub fn sphere() -> (Mesh, Occluder) {
    let mesh = bumpy_sphere(48, 0.0);
    let occluder = Occluder::new(&mesh);
    (mesh, occluder)
}

/// Three lamps of seven nodes about a bumpy sphere, one stray node and some ambient light.
pub fn solution() -> Arc<Solution> {
    let mesh = bumpy_sphere(24, 0.08);
    let occluder = Occluder::new(&mesh);
    let grid = HemisphereGrid::new(20, Vec3::Y, None, Vec3::ZERO);
    let brdf = Some(Brdf::new(SpecularModel::Beckmann, 0.1));
    let mut radiance = vec![[0.0; 3]; grid.directions.len()];
    let mut lamps = Vec::new();
    for (i, (towards, light)) in [
        (Vec3::new(0.3, 0.8, 0.5), [400.0, 380.0, 350.0]),
        (Vec3::new(-0.7, 0.5, 0.4), [90.0, 110.0, 160.0]),
        (Vec3::new(0.5, 0.4, -0.7), [60.0, 50.0, 20.0]),
    ]
    .into_iter()
    .enumerate()
    {
        let middle = grid.nearest(towards.normalize_or_zero()).unwrap_or(0);
        let mut nodes: Vec<u32> = grid.neighbours(middle).map(|n| n as u32).collect();
        nodes.push(middle as u32);
        nodes.sort_unstable();
        for &node in &nodes {
            radiance[node as usize] = light;
        }
        lamps.push(SolutionLamp {
            name: format!("Light {}", i + 1),
            direction: grid.directions[middle],
            flux: nodes.len() as f32 * grid.solid_angle * Vec3::from(light),
            angular_radius: grid.spacing(),
            nodes,
        });
    }
    radiance[grid.nearest(Vec3::new(0.0, 0.6, -0.8)).unwrap_or(0)] = [9.0; 3];
    let ambient = Vec3::splat(0.4);
    let atlas = Atlas::new(&mesh, &vec![24.0; mesh.triangles.len()]);
    let light = lighting(&grid, &radiance, &lamps, ambient, (brdf, None));
    let shader = Shader::new(&occluder, brdf, &light);
    let scene = Scene {
        mesh: &mesh,
        occluder: &occluder,
        brdf,
        gloss: None,
        surroundings: None,
    };
    let mut albedo = vec![[0.0; 3]; atlas.len()];
    let mut diffuse = albedo.clone();
    for texel in &atlas.texels {
        let point = ShadingPoint::on(scene.mesh, texel.triangle, texel.barycentric);
        let stripe = 0.02 + 0.01 * (7.0 * point.position.y).sin();
        let own = Vec3::new(stripe, 0.015, 0.03 - stripe * 0.5);
        let seen: Vec<_> = (0..shader.groups())
            .map(|g| shader.cast(&point, g))
            .collect();
        albedo[texel.index as usize] = own.to_array();
        diffuse[texel.index as usize] = (own * shader.irradiance(&point, &seen)).to_array();
    }
    Arc::new(Solution {
        name: "bumps".to_owned(),
        method: Method::default(),
        brdf,
        chosen_because: "it was made so".to_owned(),
        origin: String::new(),
        corrections: Vec::new(),
        sigma_interval95: None,
        known_light: None,
        light_frame: LightFrame::World,
        grid,
        radiance,
        lamps,
        ambient,
        diagnostics: Diagnostics::default(),
        fit: Fit::default(),
        skipped: Skipped::default(),
        timings: Vec::new(),
        convergence: Vec::new(),
        cameras: Vec::new(),
        confidence: vec![1.0; atlas.len()],
        mesh,
        atlas,
        diffuse,
        albedo,
        gloss: None,
        pictures: Vec::new(),
    })
}
