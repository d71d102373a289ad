//! From which views a part of the surface is reconstructed, where many see it.
//!
//! Eight views tell a texel's colour; of those beyond, each adds a little certainty and costs as much as the first. At every
//! vertex the views are ranked by what their pixels would weigh there: how many pixels there are to an area, at which
//! cosine they see it, and how strong a highlight has to be subtracted from them.

use rayon::prelude::*;

use super::diffuse::certainty;
use super::render::Scene;
use super::shading::{Shader, ShadingPoint, Visibility};
use super::triangle_shares::texels_of_triangles;
use crate::capture::{SurfacePoint, View};
use crate::surface::{Atlas, ViewSurface, observe};

/// Views that are enough for a part of the surface.
const ENOUGH: usize = 6;
/// Triangles of more texels may be seen by other views in their middle than at their corners: all views serve them.
const LARGE_TRIANGLE: u32 = 256;
/// Light of more groups comes from everywhere, and makes no view much worse than another.
const MOST_GROUPS: usize = 32;

/// For every triangle the views that serve it.
pub struct BestViews<'a> {
    triangles: &'a [[u32; 3]],
    /// Words of 64 views for each vertex.
    words: usize,
    /// One bit for each view that is among the best of a vertex, vertex by vertex.
    best: Vec<u64>,
    /// Texels of each triangle.
    texels: Vec<u32>,
}

impl<'a> BestViews<'a> {
    /// Ranks the views at every vertex; `None` where there are not too many of them. `surfaces` is what each of them sees,
    /// `shader` holds the lighting under which they were taken and `typical` is a typical diffuse radiance.
    pub fn new(
        scene: &Scene<'a>,
        views: &[View],
        surfaces: &[ViewSurface],
        atlas: &Atlas,
        shader: &Shader,
        typical: f32,
    ) -> Option<Self> {
        if views.len() <= ENOUGH {
            return None;
        }
        let mesh = scene.mesh;
        let words = views.len().div_ceil(64);
        let whole = vec![Visibility::Whole; shader.groups()];
        let shining = shader.groups() <= MOST_GROUPS;
        let best = (0..mesh.positions.len())
            .into_par_iter()
            .flat_map_iter(|v| {
                let point = SurfacePoint {
                    position: mesh.positions[v],
                    normal: mesh.normals[v],
                };
                let mut ranked: Vec<(f32, usize)> = views
                    .iter()
                    .zip(surfaces)
                    .enumerate()
                    .filter_map(|(i, (view, surface))| {
                        let seen = observe(i as u32, view, surface, &point)?;
                        let to_eye = view.camera.position().as_vec3() - point.position;
                        let resolution = view.camera.focal.max_element() as f32 / to_eye.length();
                        let highlight = if shining {
                            let point = ShadingPoint {
                                position: point.position,
                                normal: point.normal,
                                face_normal: point.normal,
                            };
                            let specular =
                                shader.specular(&point, to_eye.normalize_or_zero(), &whole);
                            certainty(specular, typical)
                        } else {
                            1.0
                        };
                        Some((seen.cosine * resolution * resolution * highlight, i))
                    })
                    .collect();
                let mut bits = vec![0_u64; words];
                if ranked.len() < ENOUGH {
                    bits.fill(u64::MAX);
                } else {
                    ranked.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
                    for &(_, view) in &ranked[..ENOUGH] {
                        bits[view / 64] |= 1 << (view % 64);
                    }
                }
                bits
            });
        Some(Self {
            triangles: &mesh.triangles,
            words,
            best: best.collect(),
            texels: texels_of_triangles(mesh, atlas),
        })
    }

    /// Whether a view is among the best at one of a triangle's corners.
    pub fn serve(&self, triangle: u32, view: usize) -> bool {
        let triangle = triangle as usize;
        self.texels[triangle] > LARGE_TRIANGLE
            || self.triangles[triangle].iter().any(|&vertex| {
                let word = self.best[vertex as usize * self.words + view / 64];
                word >> (view % 64) & 1 == 1
            })
    }
}
