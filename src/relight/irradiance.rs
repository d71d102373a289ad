//! Irradiance of every texel under a lighting.
//!
//! Most triangles of a fine mesh are far smaller than a penumbra. Their corners say how much of each lamp they see, and
//! their centroids where not all around them see the same; between them that is linear. Where the four disagree, and on
//! larger triangles at a shadow's edge, texels cast rays: every second one in both directions, the others where these
//! differ much.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::render::Scene;
use super::shading::{Shader, ShadingPoint, Visibility};
use crate::capture::Mesh;
use crate::surface::{Atlas, Texel};

/// Texels along each side of a tile, the unit of work.
const TILE: usize = 32;
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
/// Texels between others whose shares differ by no more than this take their mean …
const MAX_STEP: f32 = 0.3;
/// … where their normals' cosine is above this …
const SAME_SURFACE_COS: f32 = 0.8;
/// … and they are no further away than this many typical distances.
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
    // Index of each texel that is left, plus one.
    let mut left: Vec<u32> = vec![0; width * height];
    for (i, (value, texel)) in first.into_iter().zip(&atlas.texels).enumerate() {
        match value {
            Some(value) => irradiance[texel.index as usize] = value,
            None => left[texel.index as usize] = i as u32 + 1,
        }
    }
    let spacing = texel_spacing(scene, atlas);
    let columns = width.div_ceil(TILE);
    let tiles: Vec<Vec<(usize, Vec3)>> = (0..columns * height.div_ceil(TILE))
        .into_par_iter()
        .map(|tile| {
            let (x, y) = (tile % columns * TILE, tile / columns * TILE);
            let (w, h) = (TILE.min(width - x), TILE.min(height - y));
            let at = |i: usize| (y + i / w) * width + x + i % w;
            let texels: Vec<Option<&Texel>> = (0..w * h)
                .map(|i| Some(&atlas.texels[left[at(i)].checked_sub(1)? as usize]))
                .collect();
            if texels.iter().all(Option::is_none) {
                return Vec::new();
            }
            let tile = Tile {
                points: texels
                    .iter()
                    .map(|t| t.map(|t| ShadingPoint::on(scene.mesh, t.triangle, t.barycentric)))
                    .collect(),
                known: texels
                    .iter()
                    .map(|t| t.and_then(|t| Some((shares_of(t)?, t.barycentric))))
                    .collect(),
                size: [w, h],
                spacing,
                shader,
            };
            tile.irradiance().map(|(i, value)| (at(i), value)).collect()
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
    size: [usize; 2],
    /// Typical distance of neighbouring texels.
    spacing: f32,
    shader: &'a Shader<'a>,
}

impl Tile<'_> {
    /// Index and irradiance of each of its texels.
    fn irradiance(self) -> impl Iterator<Item = (usize, Vec3)> {
        let groups = self.shader.groups();
        let sparse = self.sparse_shares();
        (0..self.points.len()).filter_map(move |i| {
            let point = self.points[i].as_ref()?;
            let seen: Vec<Visibility> = (0..groups)
                .map(|g| {
                    self.told(i, g)
                        .or_else(|| self.interpolated(&sparse, i, g))
                        .map_or_else(|| self.shader.cast(point, g), Visibility::Fraction)
                })
                .collect();
            Some((i, self.shader.irradiance(point, &seen)))
        })
    }

    /// What a texel's triangle tells of a lamp's share.
    fn told(&self, i: usize, group: usize) -> Option<f32> {
        let (shares, barycentric) = self.known[i]?;
        Some(between(shares[group]?, barycentric))
    }

    /// Seen share of every lamp at every second texel in both directions, as far as it is not told; `None` also
    /// where the lamp is below.
    fn sparse_shares(&self) -> Vec<Option<f32>> {
        let groups = self.shader.groups();
        let [width, height] = [self.size[0].div_ceil(2), self.size[1].div_ceil(2)];
        let full = |i: usize| i / width * 2 * self.size[0] + i % width * 2;
        let points: Vec<Option<ShadingPoint>> =
            (0..width * height).map(|i| self.points[full(i)]).collect();
        let unknown = |i: usize, g: usize| points[i].is_some() && self.told(full(i), g).is_none();
        let seen = self
            .shader
            .visibility(&points, width, 2.0 * self.spacing, &unknown);
        (0..seen.len())
            .map(|k| {
                let (i, g) = (k / groups, k % groups);
                let point = points[i].as_ref()?;
                self.told(full(i), g)
                    .or_else(|| self.shader.share(point, g, &seen[k]))
            })
            .collect()
    }

    /// A lamp's share between the texels around that have been looked at, if it changes slowly from one to the next.
    fn interpolated(&self, sparse: &[Option<f32>], i: usize, group: usize) -> Option<f32> {
        let [width, height] = self.size;
        let (x, y) = (i % width, i / width);
        let point = self.points[i].as_ref()?;
        let (mut low, mut high, mut sum, mut count) = (f32::INFINITY, 0.0_f32, 0.0, 0.0);
        for ny in [y - y % 2, y + y % 2] {
            for nx in [x - x % 2, x + x % 2] {
                if nx >= width || ny >= height {
                    return None;
                }
                let corner = self.points[ny * width + nx].as_ref()?;
                let k = ny / 2 * width.div_ceil(2) + nx / 2;
                let share = sparse[k * self.shader.groups() + group]?;
                if corner.normal.dot(point.normal) < SAME_SURFACE_COS
                    || corner.position.distance(point.position) > SAME_SURFACE * self.spacing
                {
                    return None;
                }
                (low, high) = (low.min(share), high.max(share));
                sum += share;
                count += 1.0;
            }
        }
        (high - low <= MAX_STEP).then_some(sum / count)
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
fn texels_of_triangles(mesh: &Mesh, atlas: &Atlas) -> Vec<u32> {
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
                if texels[t] <= TINY_TRIANGLE {
                    return (0..groups)
                        .map(|g| Some(linear_alone(at_corners(g))))
                        .collect();
                }
                let seen = |group: usize, at: Vec2| {
                    shader.seen_share(&ShadingPoint::on(mesh, t as u32, at), group)
                };
                let centroid = Vec2::splat(1.0 / 3.0);
                (0..groups)
                    .map(|g| {
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
