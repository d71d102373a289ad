//! From which views a part of the surface is reconstructed, where many see it.
//!
//! Six views tell a texel's colour; of those beyond, each adds a little certainty and costs as much as the first. At every
//! vertex the views are ranked by what their pixels would weigh there: how many pixels there are to an area, at which
//! cosine they see it, and how strong a highlight has to be subtracted from them.

use rayon::prelude::*;

use super::diffuse::certainty;
use super::render::Scene;
use super::shading::{Shader, ShadingPoint, Visibility};
use super::triangle_shares::texels_of_triangles;
use rekindle_capture::{SurfacePoint, View};
use rekindle_scene::surface::{Atlas, Reading, ViewSurface};

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
        let judge = Judge {
            views,
            readings: Reading::of_all(views, surfaces),
            shader,
            typical,
            whole: vec![Visibility::Whole; shader.groups()],
        };
        let best = (0..mesh.positions.len())
            .into_par_iter()
            .flat_map_iter(|v| {
                let point = SurfacePoint {
                    position: mesh.positions[v],
                    normal: mesh.normals[v],
                };
                judge.best(&point, words)
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

/// What views are ranked by.
struct Judge<'a> {
    views: &'a [View],
    readings: Vec<Reading<'a>>,
    /// The lighting under which they were taken.
    shader: &'a Shader<'a>,
    /// A typical diffuse radiance.
    typical: f32,
    /// Nothing is hidden: one for each group of the light.
    whole: Vec<Visibility>,
}

impl Judge<'_> {
    /// The best views of a point as bits in so many words; all of them where there are not enough.
    fn best(&self, point: &SurfacePoint, words: usize) -> Vec<u64> {
        if self.shader.is_stopped() {
            return vec![0; words];
        }
        let mut ranked: Vec<(f32, usize)> = (0..self.views.len())
            .filter_map(|view| Some((self.worth(point, view)?, view)))
            .collect();
        if ranked.len() < ENOUGH {
            return vec![u64::MAX; words];
        }
        ranked.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut bits = vec![0; words];
        for &(_, view) in &ranked[..ENOUGH] {
            bits[view / 64] |= 1 << (view % 64);
        }
        bits
    }

    /// What a view's pixels would weigh at a point, up to one factor for all; `None` where it does not show it.
    fn worth(&self, point: &SurfacePoint, index: usize) -> Option<f32> {
        let view = &self.views[index];
        let seen = self.readings[index].observe(point)?;
        let to_eye = view.camera.position().as_vec3() - point.position;
        let resolution = view.camera.focal.max_element() as f32 / to_eye.length();
        let worth = seen.cosine * resolution * resolution;
        if self.whole.len() > MOST_GROUPS {
            return Some(worth);
        }
        let point = ShadingPoint::smooth(point.position, point.normal);
        let direction = to_eye.normalize_or_zero();
        let specular = self.shader.specular(&point, direction, &self.whole);
        Some(worth * certainty(specular, self.typical))
    }
}
