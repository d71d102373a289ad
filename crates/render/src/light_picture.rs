//! The light as a picture: what is seen behind the object when the light itself is the background.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};
use half::f16;
use rayon::prelude::*;

use super::surface::to_half;
use rekindle_relight::{LightNode, Lighting};
use rekindle_scene::hemisphere::direction_from_lat_long;

/// Rows of the picture.
const ROWS: u32 = 256;
/// A lamp's node is drawn this much wider than it is, so that neighbours leave no gaps.
const WIDER: f32 = 1.3;

/// The light from every direction, by `hemisphere::lat_long_from_direction`, in units of radiance `unit`.
pub(super) fn light_picture(lighting: &Lighting, unit: f32) -> ([u32; 2], Vec<[f16; 4]>) {
    let size = [2 * ROWS, ROWS];
    let suns = lighting.environment.iter().flat_map(|e| &e.suns);
    let sky = lighting.environment.as_ref().map(|e| &e.sky);
    let spread = 0.5 * PI / ROWS as f32;
    let lamps: Vec<(LightNode, f32)> = lighting
        .lamps
        .iter()
        .filter(|lamp| !lamp.muted)
        .flat_map(|lamp| &lamp.nodes)
        .chain(&lighting.remainder)
        .chain(suns.flat_map(|sun| &sun.nodes))
        .map(|node| (*node, node_cos(node)))
        .collect();
    let lit = rows_with_lamps(&lamps);
    let pixels = (0..size[0] * size[1])
        .into_par_iter()
        .map(|i| {
            let (x, y) = (i % size[0], i / size[0]);
            let uv = Vec2::new(
                (x as f32 + 0.5) / size[0] as f32,
                (y as f32 + 0.5) / size[1] as f32,
            );
            let direction = direction_from_lat_long(uv);
            let mut radiance = lighting.ambient;
            radiance += sky.map_or(Vec3::ZERO, |sky| sky.radiance(direction, spread));
            if lit[y as usize] {
                let inside = lamps
                    .iter()
                    .filter(|(node, cos)| node.direction.dot(direction) > *cos)
                    .map(|(node, _)| node);
                radiance +=
                    nearest(inside, direction).map_or(Vec3::ZERO, |(_, node)| node.radiance);
            }
            to_half(radiance / unit, 1.0)
        })
        .collect();
    (size, pixels)
}

/// Cosine of the radius of the disc that stands for a node.
fn node_cos(node: &LightNode) -> f32 {
    let angle = (1.0 - node.solid_angle / TAU).clamp(-1.0, 1.0).acos() * WIDER;
    // At least a pixel, or a small node would fall between them.
    angle.clamp(PI / ROWS as f32, PI).cos()
}

/// Which rows show any node of a lamp.
fn rows_with_lamps(lamps: &[(LightNode, f32)]) -> Vec<bool> {
    let mut lit = vec![false; ROWS as usize];
    for (node, cos) in lamps {
        let (middle, reach) = (node.direction.y.clamp(-1.0, 1.0).acos(), cos.acos());
        let row = |angle: f32| (angle / PI * ROWS as f32).clamp(0.0, ROWS as f32) as usize;
        let last = (row(middle + reach) + 1).min(ROWS as usize);
        lit[row(middle - reach).min(last)..last].fill(true);
    }
    lit
}

fn nearest<'a>(
    nodes: impl Iterator<Item = &'a LightNode>,
    direction: Vec3,
) -> Option<(f32, &'a LightNode)> {
    nodes
        .map(|n| (n.direction.dot(direction), n))
        .max_by(|a, b| a.0.total_cmp(&b.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rekindle_relight::LampNodes;
    use rekindle_scene::hemisphere::lat_long_from_direction;

    #[test]
    fn a_lamp_is_seen_where_it_is() {
        let direction = Vec3::new(0.3, 0.5, -0.7).normalize_or_zero();
        let colour = Vec3::new(2.0, 1.0, 0.5);
        let lighting = Lighting::of(vec![LampNodes::disc(direction, colour, 0.1, None)]);
        let ([width, height], pixels) = light_picture(&lighting, 1.0);
        let at = |d: Vec3| {
            let uv = lat_long_from_direction(d) * Vec2::new(width as f32, height as f32);
            pixels[uv.y as usize * width as usize + uv.x as usize].map(f16::to_f32)
        };
        let radiance = lighting.lamps[0].nodes[0].radiance;
        let found = at(direction);
        assert!(
            (found[0] / radiance.x - 1.0).abs() < 2e-3,
            "{found:?}, not {radiance}"
        );
        assert_eq!(at(-direction)[0], 0.0);
        // The picture has the lamp's flux, but for the discs' rims.
        let flux: f32 = (0..pixels.len())
            .map(|i| {
                let fall = (i / width as usize) as f32 + 0.5;
                let solid_angle = (PI / height as f32).powi(2) * (fall * PI / height as f32).sin();
                pixels[i][0].to_f32() * solid_angle
            })
            .sum();
        assert!((flux / 2.0 - 1.0).abs() < 0.2, "{flux}");
    }
}
