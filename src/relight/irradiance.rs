//! Irradiance of every texel under a lighting.
//!
//! Most triangles of a fine mesh are far smaller than a penumbra. Their corners say how much of each lamp they see, and
//! their centroids where not all around them see the same; between them that is linear. Only where the four disagree
//! every texel casts its own rays.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::render::Scene;
use super::shading::{Shader, ShadingPoint, Visibility};
use crate::capture::Mesh;
use crate::surface::Atlas;

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

/// Irradiance of every texel by the light of `shader`, zero outside the atlas.
pub fn texel_irradiance(scene: &Scene, atlas: &Atlas, shader: &Shader) -> Vec<Vec3> {
    let (width, height) = (atlas.width as usize, atlas.height as usize);
    let triangles = triangle_shares(scene, atlas, shader);
    let groups = shader.groups();
    // Texels of small triangles at once; the others are left for their tiles.
    let first: Vec<(u32, Result<Vec3, ShadingPoint>)> = atlas
        .texels
        .par_iter()
        .map_with(vec![Visibility::Below; groups], |seen, texel| {
            let point = ShadingPoint::on(scene.mesh, texel.triangle, texel.barycentric);
            let value = match &triangles[texel.triangle as usize] {
                Some(shares) => {
                    let (u, v) = (texel.barycentric.x, texel.barycentric.y);
                    for (group, (seen, corners)) in seen.iter_mut().zip(shares).enumerate() {
                        *seen = match corners {
                            Some([a, b, c]) => {
                                let share = a + u * (b - a) + v * (c - a);
                                Visibility::Fraction(share.clamp(0.0, 1.0))
                            }
                            None => shader.cast(&point, group),
                        };
                    }
                    Ok(shader.irradiance(&point, seen))
                }
                None => Err(point),
            };
            (texel.index, value)
        })
        .collect();
    let mut irradiance = vec![Vec3::ZERO; width * height];
    let mut points: Vec<Option<ShadingPoint>> = vec![None; width * height];
    for (index, value) in first {
        match value {
            Ok(value) => irradiance[index as usize] = value,
            Err(point) => points[index as usize] = Some(point),
        }
    }
    let spacing = texel_spacing(scene, atlas);
    let columns = width.div_ceil(TILE);
    let tiles: Vec<Vec<(usize, Vec3)>> = (0..columns * height.div_ceil(TILE))
        .into_par_iter()
        .map(|tile| {
            let (x, y) = (tile % columns * TILE, tile / columns * TILE);
            let (w, h) = (TILE.min(width - x), TILE.min(height - y));
            let local: Vec<Option<ShadingPoint>> = (y..y + h)
                .flat_map(|row| points[row * width + x..row * width + x + w].iter().copied())
                .collect();
            if local.iter().all(Option::is_none) {
                return Vec::new();
            }
            let seen: Vec<Visibility> = shader.visibility(&local, w, spacing, &|_, _| true);
            local
                .iter()
                .enumerate()
                .filter_map(|(i, point)| {
                    let point = point.as_ref()?;
                    let value = shader.irradiance(point, &seen[i * groups..(i + 1) * groups]);
                    Some(((y + i / w) * width + x + i % w, value))
                })
                .collect()
        })
        .collect();
    for (index, value) in tiles.into_iter().flatten() {
        irradiance[index] = value;
    }
    irradiance
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

/// For every small triangle and each lamp what its corners see of it; `None` for large triangles.
fn triangle_shares(scene: &Scene, atlas: &Atlas, shader: &Shader) -> Vec<Option<Vec<Shares>>> {
    let mesh = scene.mesh;
    let mut texels = vec![0_u32; mesh.triangles.len()];
    for texel in atlas.texels.iter().filter(|t| !t.gutter) {
        texels[texel.triangle as usize] += 1;
    }
    let small = |t: usize| texels[t] <= SMALL_TRIANGLE;
    let mut needed = vec![false; mesh.positions.len()];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        for &v in triangle {
            needed[v as usize] |= small(t);
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
            small(t).then(|| {
                let triangle = mesh.triangles[t];
                let at_corners = |g: usize| triangle.map(|v| corners[v as usize][g]);
                if texels[t] <= TINY_TRIANGLE {
                    return (0..groups)
                        .map(|g| Some(linear_alone(at_corners(g))))
                        .collect();
                }
                let centroid = ShadingPoint::on(mesh, t as u32, Vec2::splat(1.0 / 3.0));
                (0..groups)
                    .map(|g| {
                        let same = triangle.map(|v| plain[v as usize * groups + g]);
                        if let [Some(share), ..] = same
                            && same.iter().all(|s| *s == Some(share))
                        {
                            return Some([share; 3]);
                        }
                        linear(at_corners(g), shader.seen_share(&centroid, g))
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
