//! Irradiance of every texel under a lighting.
//!
//! Most triangles of a fine mesh are far smaller than a penumbra. Their corners say how much of each lamp they see, and
//! their centroids where not all around them see the same; between them that is linear. Where the four disagree, and on
//! larger triangles at a shadow's edge, texels cast rays: every eighth one in both directions, those between only where
//! their neighbours differ by more than a smooth penumbra does.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::render::Scene;
use super::shading::{Shader, ShadingPoint, Visibility};
use crate::capture::Mesh;
use crate::surface::{Atlas, Texel};

/// Texels along each side of a tile, the unit of work: whole steps of the coarsest stride.
const TILE: usize = 32;
/// Texels of a grid this wide are looked at first …
const FIRST_STRIDE: usize = 8;
/// … then those half as far apart and so on to all, with how much the shares of the texels around them may differ for
/// them to take their mean. The error of that grows with the square of the distance.
const STRIDES: [(usize, f32); 4] = [(FIRST_STRIDE, 0.0), (4, 0.03), (2, 0.12), (1, 0.3)];
/// Triangles of at most this many texels need no look at their centroid.
const TINY_TRIANGLE: u32 = 1;
/// Triangles of at most this many texels have their visibility interpolated …
const SMALL_TRIANGLE: u32 = 40;
/// … where a lamp's seen part differs between their corners by no more than this part of the most that is seen: in
/// the dark, where an albedo is the quotient of two small numbers, as in the light …
const MAX_SPREAD: f32 = 0.4;
/// … and between their centroid and the corners' mean by no more than this part.
const MAX_BEND: f32 = 0.12;
/// Triangles of at most this many texels are taken as all lit or all dark where they are so at their corners, at those
/// of the triangles around, in the middles of their edges and in the centre.
const LARGE_TRIANGLE: u32 = 256;
/// A texel takes the mean of others where their normals' cosine is above this …
const SAME_SURFACE_COS: f32 = 0.8;
/// … and they are no further away than this many typical distances for each step.
const SAME_SURFACE: f32 = 4.0;

/// Irradiance of every texel by the light of `shader`, zero outside the atlas.
pub fn texel_irradiance(scene: &Scene, atlas: &Atlas, shader: &Shader) -> Vec<Vec3> {
    let (width, height) = (atlas.width as usize, atlas.height as usize);
    let triangles = triangle_shares(scene, atlas, shader);
    let shares_of = |texel: &Texel| triangles[texel.triangle as usize].as_deref();
    // Texels whose triangles tell all at once; the others are left for their tiles.
    let first: Vec<Option<Vec3>> = atlas
        .texels
        .par_iter()
        .map_with(Vec::new(), |seen, texel| {
            seen.clear();
            for shares in shares_of(texel)? {
                seen.push(Visibility::Fraction(between((*shares)?, texel.barycentric)));
            }
            let point = ShadingPoint::on(scene.mesh, texel.triangle, texel.barycentric);
            Some(shader.irradiance(&point, seen))
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
                known: texels
                    .iter()
                    .map(|t| t.and_then(|t| Some((shares_of(t)?, t.barycentric))))
                    .collect(),
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
    /// What their triangles tell, with their barycentric weights.
    known: Vec<Option<(&'a [Shares], Vec2)>>,
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
        let groups: Vec<Vec<Seen>> = (0..self.shader.groups()).map(|g| self.seen(g)).collect();
        (0..self.points.len())
            .filter(|&i| self.wanted[i])
            .filter_map(|i| {
                let point = self.points[i].as_ref()?;
                let seen: Vec<Visibility> = groups
                    .iter()
                    .map(|seen| match seen[i] {
                        Seen::Share(share) => Visibility::Fraction(share),
                        Seen::Unknown | Seen::Below => Visibility::Below,
                    })
                    .collect();
                Some((i, self.shader.irradiance(point, &seen)))
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
        let (shares, barycentric) = self.known[i]?;
        Some(between(shares[group]?, barycentric))
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

/// A share at barycentric weights, given those at the corners.
fn between([a, b, c]: [f32; 3], at: Vec2) -> f32 {
    (a + at.x * (b - a) + at.y * (c - a)).clamp(0.0, 1.0)
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

/// Seen part of a lamp at a triangle's corners, if it is linear between them.
type Shares = Option<[f32; 3]>;

/// Number of texels that belong to each triangle.
pub(super) fn texels_of_triangles(mesh: &Mesh, atlas: &Atlas) -> Vec<u32> {
    let mut texels = vec![0_u32; mesh.triangles.len()];
    for texel in atlas.texels.iter().filter(|t| !t.gutter) {
        texels[texel.triangle as usize] += 1;
    }
    texels
}

/// For every triangle and each lamp what its corners see of it; `None` for triangles that are too large to tell.
fn triangle_shares(scene: &Scene, atlas: &Atlas, shader: &Shader) -> Vec<Option<Vec<Shares>>> {
    let mesh = scene.mesh;
    let texels = texels_of_triangles(mesh, atlas);
    let tells = |t: usize| texels[t] <= LARGE_TRIANGLE;
    let mut needed = vec![false; mesh.positions.len()];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        for &v in triangle {
            needed[v as usize] |= tells(t);
        }
    }
    let groups = shader.groups();
    let shares = |point: &ShadingPoint| -> Vec<Option<f32>> {
        (0..groups).map(|g| shader.seen_share(point, g)).collect()
    };
    let corners: Vec<Vec<Option<f32>>> = (0..mesh.positions.len())
        .into_par_iter()
        .map(|v| {
            let normal = mesh.normals[v];
            let point = ShadingPoint {
                position: mesh.positions[v],
                normal,
                face_normal: normal,
            };
            if needed[v] {
                shares(&point)
            } else {
                Vec::new()
            }
        })
        .collect();
    let plain = plain_surroundings(mesh, &corners, groups);
    (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| {
            tells(t).then(|| {
                let triangle = mesh.triangles[t];
                let at_corners = |g: usize| triangle.map(|v| corners[v as usize][g]);
                let seen = |group: usize, at: Vec2| {
                    shader.seen_share(&ShadingPoint::on(mesh, t as u32, at), group)
                };
                let centroid = Vec2::splat(1.0 / 3.0);
                (0..groups)
                    .map(|g| {
                        let smooth = !shader.is_sharp(g) && texels[t] <= SMALL_TRIANGLE;
                        if smooth || texels[t] <= TINY_TRIANGLE {
                            return Some(linear_alone(at_corners(g)));
                        }
                        let same = triangle.map(|v| plain[v as usize * groups + g]);
                        let agreed = same[0].filter(|_| same[1] == same[0] && same[2] == same[0]);
                        if texels[t] <= SMALL_TRIANGLE {
                            return match agreed {
                                Some(share) => Some([share; 3]),
                                None => linear(at_corners(g), seen(g, centroid)),
                            };
                        }
                        let inside = [centroid, Vec2::X * 0.5, Vec2::Y * 0.5, Vec2::splat(0.5)];
                        agreed
                            .filter(|_| inside.iter().all(|&at| seen(g, at) == agreed))
                            .map(|share| [share; 3])
                    })
                    .collect()
            })
        })
        .collect()
}

/// For every vertex and each lamp: 0 or 1 where it and all vertices around it see none or all of the lamp.
fn plain_surroundings(mesh: &Mesh, shares: &[Vec<Option<f32>>], groups: usize) -> Vec<Option<f32>> {
    let mut plain: Vec<Option<f32>> = (0..mesh.positions.len() * groups)
        .map(|i| {
            let share = shares[i / groups].get(i % groups).copied().flatten();
            share.filter(|&s| s == 0.0 || s == 1.0)
        })
        .collect();
    for triangle in &mesh.triangles {
        for g in 0..groups {
            let at = |v: u32| shares[v as usize].get(g).copied().flatten();
            let [a, b, c] = triangle.map(at);
            if a != b || b != c {
                for &v in triangle {
                    plain[v as usize * groups + g] = None;
                }
            }
        }
    }
    plain
}

/// The corners' shares if they are linear over the triangle. A corner that the lamp is below takes what the centroid
/// sees: light is grazing there and hardly counts.
fn linear(corners: [Option<f32>; 3], centre: Option<f32>) -> Shares {
    let Some(at_centre) = centre else {
        let dark = corners.iter().all(|c| c.is_none_or(|share| share == 0.0));
        return dark.then_some([0.0; 3]);
    };
    let corners = corners.map(|c| c.unwrap_or(at_centre));
    let highest = corners.into_iter().fold(at_centre, f32::max);
    let lowest = corners.into_iter().fold(at_centre, f32::min);
    let mean = corners.iter().sum::<f32>() / 3.0;
    (highest - lowest <= MAX_SPREAD * highest && (mean - at_centre).abs() <= MAX_BEND * highest)
        .then_some(corners)
}

/// The corners' shares of a triangle that is no larger than a texel: nothing finer shows.
fn linear_alone(corners: [Option<f32>; 3]) -> [f32; 3] {
    let known = || corners.into_iter().flatten();
    let mean = known().sum::<f32>() / known().count().max(1) as f32;
    corners.map(|c| c.unwrap_or(mean))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shadows_edge_is_not_taken_for_a_ramp() {
        let whole = Some(1.0);
        assert_eq!(linear([whole; 3], whole), Some([1.0; 3]));
        assert_eq!(
            linear([whole, whole, Some(0.0)], Some(0.66)),
            None,
            "a sharp edge"
        );
        assert_eq!(
            linear([whole; 3], Some(0.0)),
            None,
            "a thin shadow across the middle"
        );
        assert_eq!(
            linear([Some(0.5), Some(0.6), Some(0.7)], Some(0.6)),
            Some([0.5, 0.6, 0.7])
        );
        assert_eq!(linear([None; 3], None), Some([0.0; 3]), "the lamp is below");
        assert_eq!(linear([None, whole, whole], whole), Some([1.0; 3]));
    }
}
