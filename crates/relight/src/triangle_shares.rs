//! How much of each lamp a triangle's corners see.
//!
//! Most triangles of a fine mesh are far smaller than a penumbra. Their corners say how much of each lamp they see, and
//! their centroids where not all around them see the same; between them that is linear. Where the four disagree, and on
//! larger triangles at a shadow's edge, nothing is said: whoever asks casts rays there.

use glam::Vec2;
use rayon::prelude::*;

use super::shading::{Shader, ShadingPoint, Visibility};
use rekindle_capture::Mesh;
use rekindle_scene::surface::Atlas;

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

/// Seen part of a lamp at a triangle's corners, if it is linear between them.
pub(super) type Shares = Option<[f32; 3]>;

/// Number of texels that belong to each triangle.
pub(super) fn texels_of_triangles(mesh: &Mesh, atlas: &Atlas) -> Vec<u32> {
    let mut texels = vec![0_u32; mesh.triangles.len()];
    for texel in atlas.texels.iter().filter(|t| !t.gutter) {
        texels[texel.triangle as usize] += 1;
    }
    texels
}

/// For every triangle and each lamp what its corners see of it.
pub struct TriangleShares {
    /// Nothing for triangles that are too large to tell.
    triangles: Vec<Option<Vec<Shares>>>,
}

impl TriangleShares {
    /// Looks from the corners of all triangles, and from their centroids where these do not agree.
    pub fn new(mesh: &Mesh, atlas: &Atlas, shader: &Shader) -> Self {
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
                let point = ShadingPoint::smooth(mesh.positions[v], normal);
                if needed[v] {
                    shares(&point)
                } else {
                    Vec::new()
                }
            })
            .collect();
        let plain = plain_surroundings(mesh, &corners, groups);
        let triangles = (0..mesh.triangles.len())
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
                            let agreed =
                                same[0].filter(|_| same[1] == same[0] && same[2] == same[0]);
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
            .collect();
        Self { triangles }
    }

    /// Whether a triangle tells of every lamp, and what there is to tell.
    pub(super) fn of(&self, triangle: u32) -> Option<&[Shares]> {
        self.triangles[triangle as usize].as_deref()
    }

    /// What a point of a triangle sees of a lamp, where its triangle tells.
    pub(super) fn told(
        &self,
        triangle: u32,
        barycentric: Vec2,
        group: usize,
    ) -> Option<Visibility> {
        let shares = self.of(triangle)?[group]?;
        Some(match between(shares, barycentric) {
            0.0 => Visibility::Hidden,
            1.0 => Visibility::Whole,
            share => Visibility::Fraction(share),
        })
    }
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

/// A share at barycentric weights, given those at the corners.
pub(super) fn between([a, b, c]: [f32; 3], at: Vec2) -> f32 {
    (a + at.x * (b - a) + at.y * (c - a)).clamp(0.0, 1.0)
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
