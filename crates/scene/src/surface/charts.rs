//! The mesh's own texture coordinates as an atlas, where they are one: in [0, 1], free of overlap, with room between the
//! charts, and able to hold the detail that the images show.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::atlas::{Atlas, LARGEST_SIDE, Texel};
use super::visible::NO_TRIANGLE;
use rekindle_capture::Mesh;

/// Texels of gutter about a chart: a bilinear look-up reaches one texel out along each axis, diagonally √2.
const GUTTER: f32 = 2.0;
/// Share of the covered texels that may lie in two triangles, or touch a texel from elsewhere on the surface.
const FLAWS_ALLOWED: f64 = 0.002;
/// Share of the surface, weighted by the texels it wants, whose wanted density must be reached.
const WELL_RESOLVED: f64 = 0.9;
/// The most that the texture may exceed the texels that the surface wants: beyond, most would be wasted on gaps or on
/// charts larger than the images can fill.
const MOST_WASTE: f64 = 6.0;
/// Rows that one task rasterises.
const BAND_ROWS: usize = 32;

/// A chart's triangle in texels.
struct Placed {
    corners: [Vec2; 3],
    /// Twice the signed area.
    area: f32,
    low: Vec2,
    high: Vec2,
}

/// The nearest triangle of a texel.
#[derive(Clone, Copy)]
struct Claim {
    triangle: u32,
    /// Squared distance from the texel's centre in texels, zero inside.
    distance: f32,
    barycentric: Vec2,
    /// Number of triangles that hold the centre well inside.
    holders: u8,
}

const UNCLAIMED: Claim = Claim {
    triangle: NO_TRIANGLE,
    distance: GUTTER * GUTTER,
    barycentric: Vec2::ZERO,
    holders: 0,
};

fn cross(a: Vec2, b: Vec2) -> f32 {
    a.perp_dot(b)
}

impl Placed {
    fn new(corners: [Vec2; 3]) -> Self {
        let [a, b, c] = corners;
        Self {
            corners,
            area: cross(b - a, c - a),
            low: a.min(b).min(c) - GUTTER,
            high: a.max(b).max(c) + GUTTER,
        }
    }

    /// Weights of the second and third corner at the point of the triangle nearest to `p`, and the squared distance.
    fn nearest(&self, p: Vec2) -> (Vec2, f32) {
        let [a, b, c] = self.corners;
        let weights = Vec2::new(cross(p - a, c - a), cross(b - a, p - a)) / self.area;
        if weights.x >= 0.0 && weights.y >= 0.0 && weights.x + weights.y <= 1.0 {
            return (weights, 0.0);
        }
        let on_edge = |from: Vec2, to: Vec2| {
            let edge = to - from;
            let t = ((p - from).dot(edge) / edge.length_squared().max(1e-20)).clamp(0.0, 1.0);
            (t, p.distance_squared(from + t * edge))
        };
        let (t, ab) = on_edge(a, b);
        let mut best = (Vec2::new(t, 0.0), ab);
        let (t, ac) = on_edge(a, c);
        if ac < best.1 {
            best = (Vec2::new(0.0, t), ac);
        }
        let (t, bc) = on_edge(b, c);
        if bc < best.1 {
            best = (Vec2::new(1.0 - t, t), bc);
        }
        best
    }

    /// Enters the triangle's claims on rows `first_row..` of a band.
    fn claim(&self, triangle: u32, width: usize, first_row: usize, band: &mut [Claim]) {
        let rows = band.len() / width;
        let low = (self.low - 0.5).ceil().max(Vec2::ZERO);
        let high = (self.high - 0.5).floor();
        let last_row = (high.y.max(-1.0) + 1.0) as usize;
        let last_column = ((high.x.max(-1.0) + 1.0) as usize).min(width);
        for y in (low.y as usize).max(first_row)..last_row.min(first_row + rows) {
            for x in low.x as usize..last_column {
                let (barycentric, distance) =
                    self.nearest(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
                let claim = &mut band[(y - first_row) * width + x];
                let least = barycentric
                    .min_element()
                    .min(1.0 - barycentric.element_sum());
                if distance == 0.0 && least > 1e-3 {
                    claim.holders = claim.holders.saturating_add(1);
                }
                if distance < claim.distance {
                    claim.triangle = triangle;
                    claim.distance = distance;
                    claim.barycentric = barycentric;
                }
            }
        }
    }
}

/// The side of a square texture at which `WELL_RESOLVED` of the surface has its wanted density, and the number of texels
/// that the surface wants in all; `None` if the coordinates can't give it.
fn wanted_side(mesh: &Mesh, density: &[f32]) -> Option<(u32, f64)> {
    let mut sides: Vec<(f32, f64)> = (0..mesh.triangles.len())
        .into_par_iter()
        .filter_map(|t| {
            let [a, b, c] = mesh.corners(t as u32);
            let (e1, e2) = (b - a, c - a);
            let area = 0.5 * e1.cross(e2).length();
            let wanted = f64::from(area) * f64::from(density[t]).powi(2);
            if !(wanted > 0.0 && wanted.is_finite()) {
                return None;
            }
            let [u, v, w] = mesh.triangles[t].map(|vertex| mesh.uvs[vertex as usize]);
            Some((density[t] / least_stretch([e1, e2], [v - u, w - u]), wanted))
        })
        .collect();
    sides.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let total: f64 = sides.iter().map(|(_, wanted)| wanted).sum();
    let mut reached = 0.0;
    for (side, wanted) in sides {
        reached += wanted;
        if reached >= WELL_RESOLVED * total {
            let fits = side.is_finite() && side <= LARGEST_SIDE as f32;
            return fits.then(|| ((side.ceil() as u32).max(16), total));
        }
    }
    None
}

/// The smaller singular value of the map that takes a triangle's edges in space to those in the texture: texture units per
/// mesh unit along the direction in which the texture is coarsest.
fn least_stretch([e1, e2]: [Vec3; 2], [d1, d2]: [Vec2; 2]) -> f32 {
    // Orthonormal axes in the triangle's plane: e1 along the first.
    let length = e1.length();
    let x = e1 / length;
    let along = e2.dot(x);
    let height = (e2 - along * x).length();
    let by_x = d1 / length;
    let by_y = (d2 - along * by_x) / height;
    let trace = by_x.length_squared() + by_y.length_squared();
    let determinant = cross(by_x, by_y).abs();
    let root = (trace * trace - 4.0 * determinant * determinant)
        .max(0.0)
        .sqrt();
    // σ_min = |det| / σ_max keeps its digits where the difference would lose them.
    determinant / (0.5 * (trace + root)).sqrt()
}

/// An atlas by the mesh's own texture coordinates, `None` where they are none or no valid one.
pub(super) fn from_own_uvs(mesh: &Mesh, density: &[f32]) -> Option<Atlas> {
    let inside = |uv: &Vec2| uv.min_element() >= -1e-4 && uv.max_element() <= 1.0001;
    if mesh.uvs.len() != mesh.positions.len()
        || mesh.triangles.is_empty()
        || !mesh.uvs.iter().all(inside)
    {
        return None;
    }
    let (side, wanted) = wanted_side(mesh, density)?;
    if f64::from(side).powi(2) > MOST_WASTE * wanted {
        return None;
    }
    let size = side as f32;
    let placed: Vec<Placed> = mesh
        .triangles
        .par_iter()
        .map(|vertices| {
            Placed::new(vertices.map(|v| {
                let uv = mesh.uvs[v as usize];
                Vec2::new(uv.x, 1.0 - uv.y) * size
            }))
        })
        .collect();
    let width = side as usize;
    let mut claims = vec![UNCLAIMED; width * width];
    claims
        .par_chunks_mut(width * BAND_ROWS)
        .enumerate()
        .for_each(|(index, band)| {
            let first_row = index * BAND_ROWS;
            let (from, to) = (first_row as f32, (first_row + BAND_ROWS) as f32);
            for (t, triangle) in placed.iter().enumerate() {
                if triangle.low.y < to && triangle.high.y > from {
                    triangle.claim(t as u32, width, first_row, band);
                }
            }
        });
    if flaws(mesh, density, &claims, width) > FLAWS_ALLOWED {
        return None;
    }
    let texels = claims
        .par_iter()
        .enumerate()
        .filter(|(_, claim)| claim.triangle != NO_TRIANGLE)
        .map(|(index, claim)| Texel {
            index: index as u32,
            triangle: claim.triangle,
            barycentric: claim.barycentric,
            gutter: claim.distance > 0.0,
        })
        .collect();
    Some(Atlas {
        width: side,
        height: side,
        corner_uvs: placed.into_iter().map(|p| p.corners).collect(),
        texels,
        own_uvs: true,
        warnings: Vec::new(),
        patches: Vec::new(),
    })
}

/// Share of the covered texels that lie in two triangles or whose neighbour on the right or below shows a far part of the
/// surface.
fn flaws(mesh: &Mesh, density: &[f32], claims: &[Claim], width: usize) -> f64 {
    let covered = claims.par_iter().filter(|c| c.distance == 0.0).count();
    let place = |claim: &Claim| mesh.point(claim.triangle, claim.barycentric).position;
    let touches = |a: &Claim, b: &Claim| {
        b.distance == 0.0
            && a.triangle != b.triangle
            && place(a).distance(place(b)) * density[a.triangle as usize] > 8.0
    };
    let flawed = (0..claims.len())
        .into_par_iter()
        .filter(|&i| {
            let claim = &claims[i];
            claim.distance == 0.0
                && (claim.holders > 1
                    || ((i + 1) % width != 0 && touches(claim, &claims[i + 1]))
                    || (i + width < claims.len() && touches(claim, &claims[i + width])))
        })
        .count();
    flawed as f64 / covered.max(1) as f64
}
