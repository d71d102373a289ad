//! Irradiance of every texel under a lighting.
//!
//! Most triangles tell what their texels see of each lamp ([`TriangleShares`]). On the others texels cast rays: every eighth
//! one in both directions, those between only where their neighbours differ by more than a smooth penumbra does.

use glam::Vec3;
use rayon::prelude::*;

use super::render::Scene;
use super::shading::{Shader, ShadingPoint, Visibility};
use super::triangle_shares::{TriangleShares, between};
use rekindle_scene::surface::{Atlas, Texel};

/// Texels along each side of a tile, the unit of work: whole steps of the coarsest stride.
const TILE: usize = 32;
/// Texels of a grid this wide are looked at first …
const FIRST_STRIDE: usize = 8;
/// … then those half as far apart and so on to all, with how much the shares of the texels around them may differ for
/// them to take their mean. The error of that grows with the square of the distance.
const STRIDES: [(usize, f32); 4] = [(FIRST_STRIDE, 0.0), (4, 0.03), (2, 0.12), (1, 0.3)];
/// A texel takes the mean of others where their normals' cosine is above this …
const SAME_SURFACE_COS: f32 = 0.8;
/// … and they are no further away than this many typical distances for each step.
const SAME_SURFACE: f32 = 4.0;

/// Irradiance of every texel by the light of `shader`, zero outside the atlas. `triangles` tells what these see of it.
pub fn texel_irradiance(
    scene: &Scene,
    atlas: &Atlas,
    shader: &Shader,
    triangles: &TriangleShares,
) -> Vec<Vec3> {
    let (width, height) = (atlas.width as usize, atlas.height as usize);
    // Texels whose triangles tell all at once; the others are left for their tiles.
    let first: Vec<Option<Vec3>> = atlas
        .texels
        .par_iter()
        .map_with(Vec::new(), |seen, texel| {
            let (soft, groups) = triangles.beforehand(texel.triangle, texel.barycentric);
            seen.clear();
            for &group in groups {
                let shares = triangles.of(texel.triangle, group)?;
                seen.push((
                    group,
                    Visibility::Fraction(between(shares, texel.barycentric)),
                ));
            }
            let point = ShadingPoint::on(scene.mesh, texel.triangle, texel.barycentric);
            let told = seen.iter().map(|(group, seen)| (*group, seen));
            Some(shader.ambient + soft + shader.irradiance_by(&point, told))
        })
        .collect();
    let mut irradiance = vec![Vec3::ZERO; width * height];
    // Index of each texel in the atlas' list, plus one, and which are left.
    let mut listed: Vec<u32> = vec![0; width * height];
    let mut left = vec![false; width * height];
    for (i, (value, texel)) in first.into_iter().zip(&atlas.texels).enumerate() {
        listed[texel.index as usize] = i as u32 + 1;
        match value {
            Some(value) => irradiance[texel.index as usize] = value,
            None => left[texel.index as usize] = true,
        }
    }
    let spacing = texel_spacing(scene, atlas);
    let columns = width.div_ceil(TILE);
    let tiles: Vec<Vec<(usize, Vec3)>> = (0..columns * height.div_ceil(TILE))
        .into_par_iter()
        .map(|tile| {
            let (x, y) = (tile % columns * TILE, tile / columns * TILE);
            // The first texels of the tiles beside it tell of those between.
            let (w, h) = ((TILE + 1).min(width - x), (TILE + 1).min(height - y));
            let at = |i: usize| (y + i / w) * width + x + i % w;
            let own = |i: usize| i % w < TILE && i / w < TILE;
            let wanted: Vec<bool> = (0..w * h).map(|i| own(i) && left[at(i)]).collect();
            if wanted.iter().all(|w| !w) {
                return Vec::new();
            }
            let texels: Vec<Option<&Texel>> = (0..w * h)
                .map(|i| Some(&atlas.texels[listed[at(i)].checked_sub(1)? as usize]))
                .collect();
            let tile = Tile {
                points: texels
                    .iter()
                    .map(|t| t.map(|t| ShadingPoint::on(scene.mesh, t.triangle, t.barycentric)))
                    .collect(),
                texels,
                triangles,
                wanted,
                size: [w, h],
                spacing,
                shader,
            };
            let values = tile.irradiance();
            values.into_iter().map(|(i, e)| (at(i), e)).collect()
        })
        .collect();
    for (index, value) in tiles.into_iter().flatten() {
        irradiance[index] = value;
    }
    irradiance
}

/// A rectangle of texels, some of which are looked at one by one.
struct Tile<'a> {
    points: Vec<Option<ShadingPoint>>,
    texels: Vec<Option<&'a Texel>>,
    triangles: &'a TriangleShares,
    /// Texels whose irradiance is asked for.
    wanted: Vec<bool>,
    size: [usize; 2],
    /// Typical distance of neighbouring texels.
    spacing: f32,
    shader: &'a Shader<'a>,
}

/// Seen part of a lamp at a texel.
#[derive(Clone, Copy, PartialEq)]
enum Seen {
    /// Not looked at.
    Unknown,
    /// The lamp is behind the surface.
    Below,
    /// This share of what is above the horizon.
    Share(f32),
}

impl Tile<'_> {
    /// Index and irradiance of each of the wanted texels.
    fn irradiance(&self) -> Vec<(usize, Vec3)> {
        let beforehand: Vec<Option<(Vec3, &[usize])>> = (self.texels.iter().zip(&self.wanted))
            .map(|(texel, wanted)| {
                let texel = (*texel).filter(|_| *wanted)?;
                Some((self.triangles).beforehand(texel.triangle, texel.barycentric))
            })
            .collect();
        let mut groups: Vec<Vec<Seen>> = vec![Vec::new(); self.shader.groups()];
        for &group in beforehand.iter().flatten().flat_map(|(_, left)| *left) {
            if groups[group].is_empty() {
                groups[group] = self.seen(group);
            }
        }
        (beforehand.iter().enumerate())
            .filter_map(|(i, beforehand)| {
                let (point, (soft, left)) = (self.points[i].as_ref()?, (*beforehand)?);
                let seen = left.iter().filter_map(|&group| match groups[group][i] {
                    Seen::Share(share) => Some((group, Visibility::Fraction(share))),
                    Seen::Unknown | Seen::Below => None,
                });
                let looked_at = self.shader.irradiance_by(point, seen);
                Some((i, self.shader.ambient + soft + looked_at))
            })
            .collect()
    }

    /// What each wanted texel sees of a lamp, and others that tell of them.
    fn seen(&self, group: usize) -> Vec<Seen> {
        let [width, height] = self.size;
        let mut seen = vec![Seen::Unknown; self.points.len()];
        let smooth = !self.shader.is_sharp(group);
        for (stride, max_step) in STRIDES {
            let max_step = if smooth { 1.0 } else { max_step };
            for y in (0..height).step_by(stride) {
                for x in (0..width).step_by(stride) {
                    let i = y * width + x;
                    if seen[i] != Seen::Unknown || !self.is_of_use([x, y], stride) {
                        continue;
                    }
                    let Some(point) = &self.points[i] else {
                        continue;
                    };
                    seen[i] = self
                        .told(i, group)
                        .or_else(|| {
                            let around = (stride < FIRST_STRIDE).then_some(2 * stride)?;
                            self.between(&seen, [x, y], around, max_step)
                        })
                        .or_else(|| self.shader.seen_share(point, group))
                        .map_or(Seen::Below, Seen::Share);
                }
            }
        }
        seen
    }

    /// Whether a texel of a stride is wanted or has one around it that is.
    fn is_of_use(&self, [x, y]: [usize; 2], stride: usize) -> bool {
        let [width, height] = self.size;
        let reach = stride - 1;
        (y.saturating_sub(reach)..(y + reach + 1).min(height)).any(|y| {
            (x.saturating_sub(reach)..(x + reach + 1).min(width))
                .any(|x| self.wanted[y * width + x])
        })
    }

    /// What a texel's triangle tells of a lamp's share.
    fn told(&self, i: usize, group: usize) -> Option<f32> {
        let texel = self.texels[i]?;
        let shares = self.triangles.of(texel.triangle, group)?;
        Some(between(shares, texel.barycentric))
    }

    /// The mean of the texels around that are on the grid of a stride, if they differ by no more than `max_step`.
    fn between(
        &self,
        seen: &[Seen],
        [x, y]: [usize; 2],
        stride: usize,
        max_step: f32,
    ) -> Option<f32> {
        let [width, height] = self.size;
        let point = self.points[y * width + x].as_ref()?;
        let ends = |at: usize| [at - at % stride, at.next_multiple_of(stride)];
        let reach = SAME_SURFACE * self.spacing * 0.5 * stride as f32;
        let (mut low, mut high, mut sum) = (f32::INFINITY, 0.0_f32, 0.0);
        for ny in ends(y) {
            for nx in ends(x) {
                if nx >= width || ny >= height {
                    return None;
                }
                let Seen::Share(share) = seen[ny * width + nx] else {
                    return None;
                };
                let corner = self.points[ny * width + nx].as_ref()?;
                if corner.normal.dot(point.normal) < SAME_SURFACE_COS
                    || corner.position.distance(point.position) > reach
                {
                    return None;
                }
                (low, high) = (low.min(share), high.max(share));
                sum += share;
            }
        }
        (high - low <= max_step).then_some(sum / 4.0)
    }
}

/// Mean distance of neighbouring texels on the surface.
fn texel_spacing(scene: &Scene, atlas: &Atlas) -> f32 {
    let area: f64 = (0..scene.mesh.triangles.len() as u32)
        .map(|t| {
            let [a, b, c] = scene.mesh.corners(t);
            0.5 * f64::from((b - a).cross(c - a).length())
        })
        .sum();
    let inside = atlas.texels.iter().filter(|t| !t.gutter).count();
    (area / inside.max(1) as f64).sqrt() as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lighting::{LampNodes, Lighting};
    use rekindle_scene::surface::Occluder;
    use rekindle_scene::surface::fixtures::bumpy_sphere;

    /// Irradiance of a point with a ray to every node of a distant lamp.
    fn node_by_node(occluder: &Occluder, point: &ShadingPoint, lamp: &LampNodes) -> f32 {
        let origin = occluder.offset_origin(point.position, point.face_normal);
        let is_seen = |l: Vec3| {
            l.dot(point.face_normal) > 0.0 && !occluder.occluded(origin, l, f32::INFINITY)
        };
        let nodes = lamp.nodes.iter().filter(|n| is_seen(n.direction));
        let lit = nodes.map(|n| n.flux().x * n.direction.dot(point.normal).max(0.0));
        lit.sum()
    }

    #[test]
    fn a_wide_lamp_lights_texels_of_fine_triangles_as_all_its_nodes_do() {
        let mesh = bumpy_sphere(130, 0.15);
        let occluder = Occluder::new(&mesh);
        // More texels than a small triangle has.
        let atlas = Atlas::lattice(&mesh, &vec![420.0; mesh.triangles.len()]);
        let towards = Vec3::new(0.6, 0.48, 0.64);
        let lamp = LampNodes::disc_of(3000, towards, Vec3::ONE, 1.0, None);
        let lighting = Lighting::of(vec![lamp.clone()]);
        let shader = Shader::new(&occluder, None, &lighting);
        let triangles = TriangleShares::new(&mesh, &atlas, &shader);
        let scene = Scene {
            mesh: &mesh,
            occluder: &occluder,
            brdf: None,
            gloss: None,
            surroundings: None,
        };
        let is_told = |t: &&Texel| triangles.beforehand(t.triangle, t.barycentric).1.is_empty();
        let told = atlas.texels.iter().filter(is_told).count();
        let all = atlas.texels.len();
        assert!(2 * told > all, "{told} of {all} texels are told");
        let irradiance = texel_irradiance(&scene, &atlas, &shader, &triangles);
        let texels = atlas.texels.iter().filter(|t| !t.gutter).step_by(49_999);
        let mut errors: Vec<f32> = texels
            .map(|texel| {
                let point = ShadingPoint::on(&mesh, texel.triangle, texel.barycentric);
                let exact = node_by_node(&occluder, &point, &lamp);
                (irradiance[texel.index as usize].x - exact).abs()
            })
            .collect();
        errors.sort_by(f32::total_cmp);
        let [median, most] = [0.5, 0.98].map(|part| errors[(part * errors.len() as f32) as usize]);
        assert!(
            median < 0.001 && most < 0.005,
            "off by {median} in the median and {most} at one texel in fifty, of 1"
        );
    }
}
