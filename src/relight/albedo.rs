//! The pseudo-albedo: diffuse radiance ÷ irradiance under the light of the capture (eq. 20), so that the new diffuse
//! radiance is pseudo-albedo × new irradiance (eq. 18–19).
//!
//! Where no estimated light reaches the surface, or no view saw it, there is nothing to divide: such texels are filled
//! from their surroundings by diffusion over the mesh, and the confidence says so.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::diffuse::DiffuseTexture;
use super::interreflection::Interreflection;
use super::render::Scene;
use super::shading::{Shader, ShadingPoint, Visibility};
use crate::surface::Atlas;

/// Texels along each side of a tile, the unit of work.
const TILE: usize = 32;
/// Triangles of at most this many texels have one visibility unless a shadow's edge is near.
const SMALL_TRIANGLE: u32 = 40;
/// Irradiance below this part of the typical one says nothing about the albedo …
const DARK: f32 = 0.01;
/// … and above this part says all.
const LIT: f32 = 0.06;
/// Texels less confident than this count as never seen.
const SEEN: f32 = 0.01;
/// Rounds of diffusion at most: each carries values one edge further.
const MAX_ROUNDS: usize = 400;

/// The albedo and what it was made from.
#[derive(Clone, Debug)]
pub struct Albedo {
    /// Pseudo-albedo of each texel, RGB; with `K_S`-scaled light its scale is that of `K_D / K_S`.
    pub albedo: Vec<[f32; 3]>,
    /// Irradiance of each texel under the light of the capture.
    pub irradiance: Vec<[f32; 3]>,
    /// Ambient radiance, RGB, K_S-scaled.
    pub ambient: Vec3,
}

/// Divides the texture by its irradiance, fills what is unknown, and lets `texture` follow: unseen texels get filled
/// albedo × own irradiance, and the confidence of filled ones is lowered.
pub fn separate(
    scene: &Scene,
    atlas: &Atlas,
    shader: &Shader,
    texture: &mut DiffuseTexture,
) -> Albedo {
    let mut irradiance = texel_irradiance(scene, atlas, shader);
    if let Some(surroundings) = scene.surroundings {
        add_interreflection(
            scene,
            atlas,
            surroundings.interreflection,
            texture,
            &mut irradiance,
        );
    }
    let typical = typical_irradiance(atlas, &irradiance);
    let texels = texture.radiance.len();
    let mut albedo = vec![Vec3::ZERO; texels];
    // How far the quotient is known, 0 to 1.
    let mut known = vec![0.0_f32; texels];
    for texel in &atlas.texels {
        let t = texel.index as usize;
        if texture.confidence[t] < SEEN {
            continue;
        }
        let light = irradiance[t].min_element();
        let part = ((light / typical - DARK) / (LIT - DARK)).clamp(0.0, 1.0);
        if part > 0.0 {
            albedo[t] = Vec3::from(texture.radiance[t]) / irradiance[t];
            known[t] = part * part * (3.0 - 2.0 * part);
        }
    }
    let filled = fill(scene, atlas, &albedo, &known, &texture.confidence);
    for (texel, fill) in atlas.texels.iter().zip(filled) {
        let t = texel.index as usize;
        albedo[t] = albedo[t] * known[t] + fill * (1.0 - known[t]);
        if texture.confidence[t] < SEEN {
            texture.radiance[t] = (albedo[t] * irradiance[t]).to_array();
            texture.confidence[t] = 0.0;
        } else {
            texture.confidence[t] *= 0.5 + 0.5 * known[t];
        }
    }
    Albedo {
        albedo: albedo.iter().map(Vec3::to_array).collect(),
        irradiance: irradiance.iter().map(Vec3::to_array).collect(),
        ambient: Vec3::ZERO,
    }
}

/// Adds what the surface itself sends: its radiance is known from the pictures, and taken for the mean where it is not.
fn add_interreflection(
    scene: &Scene,
    atlas: &Atlas,
    interreflection: &Interreflection,
    texture: &DiffuseTexture,
    irradiance: &mut [Vec3],
) {
    let mut mean = Mean::default();
    for texel in atlas.texels.iter().filter(|t| !t.gutter) {
        let t = texel.index as usize;
        mean.add(texture.radiance[t].into(), texture.confidence[t]);
    }
    let radiance: Vec<[f32; 3]> = texture
        .radiance
        .iter()
        .zip(&texture.confidence)
        .map(|(&r, &c)| if c < SEEN { mean.value().into() } else { r })
        .collect();
    let indirect = interreflection.of_radiance(scene.mesh, &|triangle, barycentric| {
        atlas.sample(&radiance, triangle, barycentric)
    });
    let added: Vec<Vec3> = atlas
        .texels
        .par_iter()
        .map(|texel| indirect.at(scene.mesh, texel.triangle, texel.barycentric))
        .collect();
    for (texel, added) in atlas.texels.iter().zip(added) {
        irradiance[texel.index as usize] += added;
    }
}

/// A weighted mean.
#[derive(Default)]
struct Mean {
    sum: glam::DVec3,
    weight: f64,
}

impl Mean {
    fn add(&mut self, value: Vec3, weight: f32) {
        self.sum += value.as_dvec3() * f64::from(weight);
        self.weight += f64::from(weight);
    }

    fn value(&self) -> Vec3 {
        if self.weight > 0.0 {
            (self.sum / self.weight).as_vec3()
        } else {
            Vec3::ZERO
        }
    }
}

/// What whole triangles see of each lamp: a triangle of few texels has the visibility of its centroid where all its
/// neighbours' centroids have the same. `None` for triangles that are larger or lie at a shadow's edge.
fn triangle_visibility(
    scene: &Scene,
    atlas: &Atlas,
    shader: &Shader,
) -> Vec<Option<Vec<Visibility>>> {
    let mesh = scene.mesh;
    let mut texels = vec![0_u32; mesh.triangles.len()];
    for texel in atlas.texels.iter().filter(|t| !t.gutter) {
        texels[texel.triangle as usize] += 1;
    }
    let groups = shader.groups();
    let seen: Vec<Vec<Visibility>> = (0..mesh.triangles.len() as u32)
        .into_par_iter()
        .map(|t| {
            if texels[t as usize] > SMALL_TRIANGLE {
                return Vec::new();
            }
            let centroid = ShadingPoint::on(mesh, t, Vec2::splat(1.0 / 3.0));
            (0..groups).map(|g| shader.cast(&centroid, g)).collect()
        })
        .collect();
    let welded = weld(&mesh.positions);
    let places = welded.iter().map(|&w| w as usize + 1).max().unwrap_or(0);
    // What all triangles around a place agree on.
    let mut around: Vec<Option<u32>> = vec![None; places];
    let mut agreed = vec![true; places];
    let plain = |v: &[Visibility]| {
        v.len() == groups
            && v.iter().all(|v| {
                matches!(
                    v,
                    Visibility::Whole | Visibility::Hidden | Visibility::Below
                )
            })
    };
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        for &v in triangle {
            let place = welded[v as usize] as usize;
            match around[place] {
                None => {
                    around[place] = Some(t as u32);
                    agreed[place] = plain(&seen[t]);
                }
                Some(first) => agreed[place] &= seen[first as usize] == seen[t],
            }
        }
    }
    seen.into_iter()
        .zip(&mesh.triangles)
        .map(|(seen, triangle)| {
            let sure = triangle
                .iter()
                .all(|&v| agreed[welded[v as usize] as usize]);
            sure.then_some(seen)
        })
        .collect()
}

/// Irradiance of every texel, zero outside the atlas.
fn texel_irradiance(scene: &Scene, atlas: &Atlas, shader: &Shader) -> Vec<Vec3> {
    let (width, height) = (atlas.width as usize, atlas.height as usize);
    let triangles = triangle_visibility(scene, atlas, shader);
    // Texels of plain triangles at once; the others are left for their tiles.
    let first: Vec<(u32, Result<Vec3, ShadingPoint>)> = atlas
        .texels
        .par_iter()
        .map(|texel| {
            let point = ShadingPoint::on(scene.mesh, texel.triangle, texel.barycentric);
            let value = match &triangles[texel.triangle as usize] {
                Some(seen) => Ok(shader.irradiance(&point, seen)),
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
            let groups = shader.groups();
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

/// Mean over channels of the 90th percentile of irradiance: that of a well-lit place.
fn typical_irradiance(atlas: &Atlas, irradiance: &[Vec3]) -> f32 {
    let mut values: Vec<f32> = atlas
        .texels
        .iter()
        .filter(|t| !t.gutter)
        .map(|t| irradiance[t.index as usize].element_sum() / 3.0)
        .collect();
    if values.is_empty() {
        return 1.0;
    }
    let at = (values.len() - 1) * 9 / 10;
    values
        .select_nth_unstable_by(at, f32::total_cmp)
        .1
        .max(f32::MIN_POSITIVE)
}

/// For every entry of `atlas.texels`, what its surroundings say about its albedo: known values are gathered at the
/// vertices, spread over the mesh's edges to those without, and interpolated.
fn fill(
    scene: &Scene,
    atlas: &Atlas,
    albedo: &[Vec3],
    known: &[f32],
    confidence: &[f32],
) -> Vec<Vec3> {
    let mesh = scene.mesh;
    // Vertices at one place are one, whatever their normals and texture coordinates.
    let welded = weld(&mesh.positions);
    let places = welded.iter().map(|&w| w as usize + 1).max().unwrap_or(0);
    let mut sum = vec![glam::DVec3::ZERO; places];
    let mut weight = vec![0.0_f64; places];
    let mut mean = Mean::default();
    for texel in atlas.texels.iter().filter(|t| !t.gutter) {
        let t = texel.index as usize;
        let w = f64::from(known[t] * confidence[t]);
        if w == 0.0 {
            continue;
        }
        let value = albedo[t].as_dvec3();
        mean.add(albedo[t], known[t] * confidence[t]);
        let (u, v) = (texel.barycentric.x, texel.barycentric.y);
        let corners = mesh.triangles[texel.triangle as usize];
        for (corner, share) in corners.into_iter().zip([1.0 - u - v, u, v]) {
            let place = welded[corner as usize] as usize;
            let w = w * f64::from(share.max(0.0));
            sum[place] += value * w;
            weight[place] += w;
        }
    }
    let mean = mean.value();
    let mut value: Vec<Option<Vec3>> = (0..places)
        .map(|p| (weight[p] > 1e-6).then(|| (sum[p] / weight[p]).as_vec3()))
        .collect();
    let fixed: Vec<bool> = value.iter().map(Option::is_some).collect();
    diffuse_over_edges(&neighbours(mesh, &welded, places), &mut value, &fixed);
    atlas
        .texels
        .par_iter()
        .map(|texel| {
            let (u, v) = (
                texel.barycentric.x.clamp(0.0, 1.0),
                texel.barycentric.y.clamp(0.0, 1.0),
            );
            let corners = mesh.triangles[texel.triangle as usize];
            let (mut sum, mut total) = (Vec3::ZERO, 0.0);
            for (corner, share) in corners.into_iter().zip([(1.0 - u - v).max(0.0), u, v]) {
                if let Some(value) = value[welded[corner as usize] as usize] {
                    sum += value * share;
                    total += share;
                }
            }
            if total > 1e-6 { sum / total } else { mean }
        })
        .collect()
}

/// For every vertex the number of its place: equal positions have equal numbers.
fn weld(positions: &[Vec3]) -> Vec<u32> {
    let bits = |p: &Vec3| p.to_array().map(|c| (c + 0.0).to_bits());
    let mut order: Vec<u32> = (0..positions.len() as u32).collect();
    order.par_sort_unstable_by_key(|&i| (bits(&positions[i as usize]), i));
    let mut place = vec![0; positions.len()];
    let mut next = 0;
    for pair in 0..order.len() {
        if pair > 0
            && bits(&positions[order[pair] as usize]) != bits(&positions[order[pair - 1] as usize])
        {
            next += 1;
        }
        place[order[pair] as usize] = next;
    }
    place
}

/// Places joined by an edge, in compressed rows.
fn neighbours(mesh: &crate::capture::Mesh, welded: &[u32], places: usize) -> (Vec<u32>, Vec<u32>) {
    let mut edges: Vec<(u32, u32)> = Vec::with_capacity(6 * mesh.triangles.len());
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| welded[v as usize]);
        edges.extend([(a, b), (b, a), (b, c), (c, b), (c, a), (a, c)]);
    }
    edges.par_sort_unstable();
    edges.dedup();
    let mut starts = vec![0_u32; places + 1];
    for &(from, _) in &edges {
        starts[from as usize + 1] += 1;
    }
    for i in 0..places {
        starts[i + 1] += starts[i];
    }
    (starts, edges.into_iter().map(|(_, to)| to).collect())
}

/// Spreads values from the fixed places: first outwards, ring by ring, then smoothed towards the mean of neighbours.
fn diffuse_over_edges(
    (starts, list): &(Vec<u32>, Vec<u32>),
    value: &mut [Option<Vec3>],
    fixed: &[bool],
) {
    let around = |p: usize| &list[starts[p] as usize..starts[p + 1] as usize];
    let mean = |value: &[Option<Vec3>], p: usize| {
        let known: Vec<Vec3> = around(p)
            .iter()
            .filter_map(|&n| value[n as usize])
            .collect();
        (!known.is_empty()).then(|| known.iter().sum::<Vec3>() / known.len() as f32)
    };
    let mut open: Vec<u32> = (0..value.len() as u32)
        .filter(|&p| !fixed[p as usize])
        .collect();
    let free = open.clone();
    while !open.is_empty() {
        let reached: Vec<(u32, Vec3)> = open
            .par_iter()
            .filter_map(|&p| mean(value, p as usize).map(|v| (p, v)))
            .collect();
        if reached.is_empty() {
            // What is left hangs together with nothing known.
            break;
        }
        for (p, v) in reached {
            value[p as usize] = Some(v);
        }
        open.retain(|&p| value[p as usize].is_none());
    }
    for _ in 0..MAX_ROUNDS {
        let smoothed: Vec<Option<Vec3>> =
            free.par_iter().map(|&p| mean(value, p as usize)).collect();
        let mut change = 0.0_f32;
        for (&p, v) in free.iter().zip(smoothed) {
            let old = value[p as usize];
            if let (Some(new), Some(old)) = (v, old) {
                change = change.max((new - old).abs().max_element() / old.max_element().max(1e-30));
            }
            value[p as usize] = v.or(old);
        }
        if change < 1e-3 {
            break;
        }
    }
}
