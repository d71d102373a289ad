//! Light as the page adds it up: every lamp as few lobes, each with a mean direction, flux and spread, and a shadow of its own.

use glam::Vec3;
use serde_json::{Value, json};

use super::{Setup, list};
use rekindle_relight::lobes::{Lobe, Source, merge};
use rekindle_relight::{LightNode, Lighting, Shader, ShadingPoint};
use rekindle_scene::surface::{GlossTexture, Occluder};
use rekindle_solution::Solution;

/// Lobes of all light in a setup, unless every lamp needs one: as many shadow maps share one texture of 4096 × 4096.
const USUAL: usize = 64;
/// Of these at most for light of the estimate that belongs to no lamp, and for an environment.
const REST: usize = 24;
/// The most lamps of a setup: the page's shaders have room for 256 lobes.
pub(super) const MOST_LAMPS: usize = 200;
/// Largest variance of a lobe, in parts of that of the surface's lobe …
const LARGEST_SPREAD: f32 = 0.06;
/// … and of that of diffuse reflection, as which a surface without a lobe counts.
const DIFFUSE_VARIANCE: f32 = 0.1;

/// A setup as the page has it. `white` is the unit of radiance.
pub(super) fn setup(setup: &Setup, solution: &Solution, occluder: &Occluder, white: f32) -> Value {
    let lighting = &setup.lighting;
    let sigma = solution.brdf.map(|brdf| {
        let narrowest = solution.gloss.as_ref().map_or(1.0, GlossTexture::narrowest);
        brdf.sigma * narrowest
    });
    let spread = LARGEST_SPREAD * sigma.map_or(DIFFUSE_VARIANCE, |sigma| sigma * sigma);
    let environment: Vec<LightNode> = lighting
        .environment_lamps()
        .flat_map(|patch| patch.nodes.iter().copied())
        .collect();
    let room = |nodes: &[LightNode]| REST.min(nodes.len());
    let left = USUAL - room(&environment) - room(&lighting.remainder);
    let each = (left / lighting.lamps.len().max(1)).max(1);
    let lamps: Vec<Value> = (lighting.lamps.iter().enumerate())
        .map(|(i, lamp)| {
            let numbered = || format!("Light {}", i + 1);
            json!({
                "name": setup.names.get(i).cloned().unwrap_or_else(numbered),
                "direction": list(lamp.direction),
                "near": lamp.radius,
                "muted": lamp.muted,
                "lobes": lobes(&lamp.nodes, spread, each, white),
            })
        })
        .collect();
    json!({
        "name": setup.name,
        "captured": setup.captured,
        "ambient": list(ambient_irradiance(solution, occluder, lighting) / white),
        "ambientRadiance": list(lighting.ambient / white),
        "lamps": lamps,
        "rest": [
            { "near": lighting.radius, "lobes": lobes(&lighting.remainder, spread, REST, white) },
            { "near": null, "lobes": lobes(&environment, spread, REST, white) },
        ],
    })
}

/// Irradiance by light from everywhere, transmittance inside.
fn ambient_irradiance(solution: &Solution, occluder: &Occluder, lighting: &Lighting) -> Vec3 {
    let alone = Lighting {
        ambient: lighting.ambient,
        ..lighting.dark()
    };
    let point = ShadingPoint::smooth(lighting.centre, lighting.up);
    Shader::new(occluder, solution.brdf, &alone).irradiance(&point, &[])
}

/// Nodes as lobes: direction, flux and spread of each in one list of numbers.
fn lobes(nodes: &[LightNode], spread: f32, most: usize, white: f32) -> Vec<f32> {
    let source = |node: &LightNode| Source {
        direction: node.direction,
        flux: node.flux() / white,
        group: 0,
    };
    let numbers = |lobe: Lobe| {
        let [x, y, z] = list(lobe.direction);
        let [r, g, b] = list(lobe.flux);
        [x, y, z, r, g, b, lobe.spread]
    };
    let merged = merge(nodes.iter().map(source).collect(), spread, most);
    merged.into_iter().flat_map(numbers).collect()
}
