//! Fills what no view saw, or no light reached, from its surroundings.

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::albedo::Mean;
use rekindle_capture::Mesh;
use rekindle_scene::surface::Atlas;

/// Rounds of diffusion at most: each carries values one edge further.
const MAX_ROUNDS: usize = 400;
/// Places that all rounds together visit at most: on meshes of millions of triangles more would take longer than all else.
const MOST_STEPS: usize = 40_000_000;
/// Parts in which texels are gathered, each with sums of its own, unless there are too many places for that.
const PARTS: usize = 4;
const FEW_PLACES: usize = 500_000;

/// The mesh's vertices by where they are: vertices at one place are one, whatever their normals and texture coordinates.
pub(super) struct Places {
    /// Place of each vertex.
    of: Vec<u32>,
    /// Where each place is.
    positions: Vec<Vec3>,
    /// Places joined to place `i` by an edge: `list[starts[i]..starts[i + 1]]`.
    starts: Vec<u32>,
    list: Vec<u32>,
}

impl Places {
    pub(super) fn new(mesh: &Mesh) -> Self {
        let of = mesh.places();
        let count = of.iter().map(|&w| w as usize + 1).max().unwrap_or(0);
        let (starts, list) = neighbours(mesh, &of, count);
        let mut positions = vec![Vec3::ZERO; count];
        for (&place, &position) in of.iter().zip(&mesh.positions) {
            positions[place as usize] = position;
        }
        Self {
            of,
            positions,
            starts,
            list,
        }
    }

    pub(super) fn count(&self) -> usize {
        self.starts.len() - 1
    }

    pub(super) fn position(&self, place: usize) -> Vec3 {
        self.positions[place]
    }

    /// Places joined to a place by an edge.
    pub(super) fn around(&self, place: usize) -> &[u32] {
        &self.list[self.starts[place] as usize..self.starts[place + 1] as usize]
    }

    /// The place nearest to a point of a triangle, by the weights of its second and third corner.
    pub(super) fn nearest(&self, mesh: &Mesh, triangle: u32, barycentric: Vec2) -> usize {
        let [a, b, c] = mesh.triangles[triangle as usize];
        let (u, v) = (barycentric.x, barycentric.y);
        let first = 1.0 - u - v;
        let corner = if first >= u.max(v) {
            a
        } else if u >= v {
            b
        } else {
            c
        };
        self.of[corner as usize] as usize
    }

    /// The area that each place stands for, in square units of the mesh: a third of the triangles that meet there.
    pub(super) fn areas(&self, mesh: &Mesh) -> Vec<f32> {
        let mut areas = vec![0.0_f64; self.count()];
        for (t, corners) in mesh.triangles.iter().enumerate() {
            let [a, b, c] = mesh.corners(t as u32).map(Vec3::as_dvec3);
            let third = (b - a).cross(c - a).length() / 6.0;
            for &corner in corners {
                areas[self.of[corner as usize] as usize] += third;
            }
        }
        areas.into_iter().map(|area| area as f32).collect()
    }

    /// Weighted means around each place of the N things that texels have; `None` where they have no weight.
    pub(super) fn gather<const N: usize>(
        &self,
        mesh: &Mesh,
        atlas: &Atlas,
        values: impl Fn(usize) -> [Vec3; N] + Sync,
        weight: impl Fn(usize) -> f32 + Sync,
    ) -> Vec<Option<[Vec3; N]>> {
        // The order of the sums is that of the parts, whatever the number of threads.
        let parts = if self.count() > FEW_PLACES { 1 } else { PARTS };
        let sums: Vec<Vec<([DVec3; N], f64)>> = (0..parts)
            .into_par_iter()
            .map(|part| {
                let cut = |k: usize| atlas.texels.len() * k / parts;
                let mut sums = vec![([DVec3::ZERO; N], 0.0_f64); self.count()];
                for texel in &atlas.texels[cut(part)..cut(part + 1)] {
                    let t = texel.index as usize;
                    let w = f64::from(weight(t));
                    if texel.gutter || w == 0.0 {
                        continue;
                    }
                    let values = values(t).map(Vec3::as_dvec3);
                    let (u, v) = (texel.barycentric.x, texel.barycentric.y);
                    let corners = mesh.triangles[texel.triangle as usize];
                    for (corner, share) in corners.into_iter().zip([1.0 - u - v, u, v]) {
                        let (sum, total) = &mut sums[self.of[corner as usize] as usize];
                        let w = w * f64::from(share.max(0.0));
                        for (sum, value) in sum.iter_mut().zip(values) {
                            *sum += value * w;
                        }
                        *total += w;
                    }
                }
                sums
            })
            .collect();
        (0..self.count())
            .into_par_iter()
            .map(|place| {
                let total: f64 = sums.iter().map(|part| part[place].1).sum();
                let mean = |k: usize| {
                    let sum: DVec3 = sums.iter().map(|part| part[place].0[k]).sum();
                    (sum / total).as_vec3()
                };
                (total > 1e-6).then(|| std::array::from_fn(mean))
            })
            .collect()
    }
}

/// For every entry of `atlas.texels`, what its surroundings say about its albedo: known values are gathered at the
/// vertices, spread over the mesh's edges to those without, and interpolated. What is `known`, 0 to 1, counts by its confidence.
pub(super) fn fill(
    mesh: &Mesh,
    places: &Places,
    atlas: &Atlas,
    albedo: &[Vec3],
    (known, confidence): (&[f32], &[f32]),
) -> Vec<Vec3> {
    // A place of which the surroundings tell more than it does itself is filled.
    let told = |t: usize| {
        let counts = if known[t] >= 0.5 { known[t] } else { 0.0 };
        let albedo = if counts > 0.0 { albedo[t] } else { Vec3::ZERO };
        [albedo * counts, Vec3::new(counts, known[t], 0.0)]
    };
    let gathered = places.gather(mesh, atlas, told, |t| confidence[t]);
    let mut value: Vec<Option<Vec3>> = (gathered.into_iter())
        .map(|told| {
            told.filter(|[_, k]| k.y >= 0.5 && k.x > 0.0)
                .map(|[sum, k]| sum / k.x)
        })
        .collect();
    let mut mean = Mean::default();
    for texel in atlas.texels.iter().filter(|t| !t.gutter) {
        let t = texel.index as usize;
        if known[t] >= 0.5 {
            mean.add(albedo[t], known[t] * confidence[t]);
        }
    }
    let mean = mean.value();
    let fixed: Vec<bool> = value.iter().map(Option::is_some).collect();
    diffuse_over_edges(places, &mut value, &fixed);
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
                if let Some(value) = value[places.of[corner as usize] as usize] {
                    sum += value * share;
                    total += share;
                }
            }
            if total > 1e-6 { sum / total } else { mean }
        })
        .collect()
}

/// Places joined by an edge, in compressed rows.
fn neighbours(mesh: &Mesh, welded: &[u32], places: usize) -> (Vec<u32>, Vec<u32>) {
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
fn diffuse_over_edges(places: &Places, value: &mut [Option<Vec3>], fixed: &[bool]) {
    let mean = |value: &[Option<Vec3>], p: u32| {
        let known = places.around(p as usize).iter();
        let known = known.filter_map(|&n| value[n as usize]);
        let (sum, count) = known.fold((Vec3::ZERO, 0_u32), |(sum, k), v| (sum + v, k + 1));
        (count > 0).then(|| sum / count as f32)
    };
    let free: Vec<u32> = (0..value.len() as u32)
        .filter(|&p| !fixed[p as usize])
        .collect();
    let mut ring: Vec<u32> = free
        .par_iter()
        .copied()
        .filter(|&p| mean(value, p).is_some())
        .collect();
    let mut reached = fixed.to_vec();
    while !ring.is_empty() {
        let values: Vec<Option<Vec3>> = ring.par_iter().map(|&p| mean(value, p)).collect();
        for (&p, v) in ring.iter().zip(values) {
            value[p as usize] = v;
            reached[p as usize] = true;
        }
        let around = ring.iter().flat_map(|&p| places.around(p as usize));
        let mut next = Vec::new();
        for &p in around {
            if !std::mem::replace(&mut reached[p as usize], true) {
                next.push(p);
            }
        }
        ring = next;
    }
    let rounds = (MOST_STEPS / free.len().max(1)).min(MAX_ROUNDS);
    for _ in 0..rounds {
        let smoothed: Vec<Option<Vec3>> = free.par_iter().map(|&p| mean(value, p)).collect();
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
