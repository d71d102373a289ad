//! The lights of an estimate as lamps that can be edited.

use glam::Vec3;

use super::{KnownLight, SolutionLamp};
use rekindle_relight::{LampNodes, LightNode, Lighting};
use rekindle_scene::hemisphere::HemisphereGrid;
use rekindle_scene::reflectance::{Brdf, SpecularModel};

/// Lit nodes outside all lamps that are kept apart.
const MAX_STRAYS: usize = 24;
/// Nodes outside all lamps that together have no more than this part of the flux, the weakest, are left dark: their
/// highlights are as much weaker than a lamp's, and each would cost what a lamp costs.
const NEGLIGIBLE_SHARE: f32 = 2e-3;

/// The lighting of an estimate. A compact lamp shines as a uniform disc with its direction, flux and extent: single nodes of
/// a solved lamp are spiky, and a shadow's soft edge would show each of them. Wider lamps keep their nodes. Lit nodes that
/// no lamp claims are the remainder.
pub fn lighting(
    grid: &HemisphereGrid,
    radiance: &[[f32; 3]],
    lamps: &[SolutionLamp],
    ambient: Vec3,
    (brdf, known): (Option<Brdf>, Option<&KnownLight>),
) -> Lighting {
    let node = |i: u32| LightNode {
        direction: grid.directions[i as usize],
        radiance: radiance[i as usize].into(),
        solid_angle: grid.solid_angle,
    };
    let mut claimed = vec![false; radiance.len()];
    for &i in lamps.iter().flat_map(|l| &l.nodes) {
        claimed[i as usize] = true;
    }
    let lamps: Vec<LampNodes> = lamps
        .iter()
        .filter_map(|lamp| {
            LampNodes::new(lamp.nodes.iter().map(|&i| node(i)).collect(), grid.radius)
        })
        .collect();
    let strays = (0..radiance.len() as u32)
        .filter(|&i| !claimed[i as usize] && radiance[i as usize] != [0.0; 3])
        .map(node)
        .collect();
    let flux: Vec3 = lamps.iter().map(LampNodes::flux).sum();
    let total = flux.element_sum();
    // Of a metal and its light only the product is seen: where the light isn't known it is taken as white, so that new light is
    // coloured.
    let tint = match (brdf, known) {
        (Some(brdf), Some(known)) if brdf.model == SpecularModel::Metal => known.tint(),
        (Some(brdf), None) if brdf.model == SpecularModel::Metal && total > 0.0 => {
            Some(3.0 * flux / total)
        }
        _ => None,
    };
    let tint = tint.unwrap_or(Vec3::ONE);
    Lighting {
        lamps,
        remainder: strongest(strays, NEGLIGIBLE_SHARE * total),
        environment: None,
        ambient,
        centre: grid.centre,
        radius: grid.radius,
        up: grid.up,
        specular_scale: tint * brdf.map_or(1.0, |brdf| brdf.usual_specular_scale()),
    }
}

/// At most [`MAX_STRAYS`] nodes, the strongest; each takes the light of the weaker ones it is nearest to. The weakest are
/// left out, up to the flux `negligible` of all of them.
fn strongest(mut strays: Vec<LightNode>, mut negligible: f32) -> Vec<LightNode> {
    let strength = |n: &LightNode| n.flux().element_sum();
    strays.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
    while let Some(weakest) = strays.last().map(strength)
        && weakest <= negligible
    {
        negligible -= weakest;
        strays.pop();
    }
    let weaker = strays.split_off(strays.len().min(MAX_STRAYS));
    for node in weaker {
        let closeness = |n: &LightNode| n.direction.dot(node.direction);
        let nearest = strays
            .iter_mut()
            .max_by(|a, b| closeness(a).total_cmp(&closeness(b)));
        if let Some(nearest) = nearest {
            nearest.radiance += node.radiance;
        }
    }
    strays
}
