//! The diffuse texture by the minimum over the views (2.1), and what of each view is left over it (2.2).
//!
//! Object and light are fixed and only the camera moves: the diffuse part of a surface point is the same in every view and
//! the specular part only adds (eq. 1). So of the colours that the views show of a texel, the one of least magnitude
//! √(R² + G² + B²) is its diffuse colour. Noise makes the least of several colours too dark, and a point that shows a
//! highlight in every view keeps some of it: this texture is the start of the estimation, not its result.

use glam::Vec3;
use rayon::prelude::*;

use super::atlas::{Atlas, Texel};
use super::visible::{NO_TRIANGLE, ViewSurface};
use rekindle_capture::{Mesh, Photograph, SurfacePoint, View};

/// Views that see a point at a smaller cosine to its normal count only where there is no better one: the image smears the
/// surface there, and eq. 4 amplifies what is wrong by 1/cos θᵣ.
pub const GRAZING: f32 = 0.15;
/// Texels that are looked at from one view after the other, so that what they read of a view stays in the fastest cache.
const AT_ONCE: usize = 512;
/// Coverage from which a pixel shows nothing but the object.
pub const FULL_COVERAGE: f32 = 0.999;

/// One surface point seen in one view.
#[derive(Clone, Copy, Debug)]
pub struct Observation {
    /// Cosine of the angle between the shading normal and the direction to the camera, cos θᵣ.
    pub cosine: f32,
    /// Radiance towards the camera, RGB, bilinear between pixel centres.
    pub radiance: Vec3,
}

/// The diffuse radiance of the surface under the capture's light.
#[derive(Clone, Debug)]
pub struct MinimumTexture {
    /// Diffuse radiance, RGB, one per texel of the atlas.
    pub radiance: Vec<[f32; 3]>,
    /// Σ cos θᵣ over the views that see the texel, one per texel: 0 where none does, and around 1 or less where one view
    /// alone says nothing about how much of it is specular.
    pub confidence: Vec<f32>,
}

/// Whether a pixel is data and shows nothing but the object.
pub fn is_object(photograph: &Photograph, pixel: usize) -> bool {
    photograph.usable[pixel]
        && photograph
            .coverage
            .as_ref()
            .is_none_or(|coverage| coverage[pixel] >= FULL_COVERAGE)
}

/// A view's photograph as a texture is read from it.
pub struct Reading<'a> {
    view: &'a View,
    surface: &'a ViewSurface,
    /// Whether a pixel and those right of it, below it and across are data and show nothing but one piece of the object.
    readable: Vec<bool>,
    /// The camera's position.
    eye: Vec3,
}

impl<'a> Reading<'a> {
    /// Of a view and what it sees.
    pub fn new(view: &'a View, surface: &'a ViewSurface) -> Self {
        Self {
            view,
            surface,
            readable: surface.readable(&|pixel| is_object(&view.photograph, pixel)),
            eye: view.camera.position().as_vec3(),
        }
    }

    /// Of all views.
    pub fn of_all(views: &'a [View], surfaces: &'a [ViewSurface]) -> Vec<Self> {
        let views = views.iter().zip(surfaces);
        views
            .map(|(view, surface)| Self::new(view, surface))
            .collect()
    }

    /// What the view shows of a surface point, from in front; `None` where it is hidden, at a silhouette or on unusable
    /// pixels.
    pub fn observe(&self, point: &SurfacePoint) -> Option<Observation> {
        let to_camera = self.eye - point.position;
        let height = point.normal.dot(to_camera);
        if height <= 0.0 {
            return None;
        }
        let between = self.surface.between(point.position, &self.readable)?;
        let of = |pixel: usize| Vec3::from(self.view.photograph.radiance[pixel]);
        let weighted = between.pixels.iter().zip(between.weights.to_array());
        Some(Observation {
            cosine: height / to_camera.length(),
            radiance: weighted.map(|(&pixel, weight)| weight * of(pixel)).sum(),
        })
    }
}

/// Texels per mesh unit for each triangle, such that a texel is as large as 1 / `texels_per_pixel` pixels in the view that
/// shows the triangle largest: focal length / distance × foreshortening. Triangles that no view shows get half the
/// median, or 1 / 100 of the object's diagonal where no triangle is seen at all.
pub fn wanted_density(
    mesh: &Mesh,
    views: &[View],
    surfaces: &[ViewSurface],
    texels_per_pixel: f32,
) -> Vec<f32> {
    let shown: Vec<Vec<bool>> = surfaces
        .par_iter()
        .map(|surface| {
            let mut shown = vec![false; mesh.triangles.len()];
            for &t in surface.triangle.iter().filter(|&&t| t != NO_TRIANGLE) {
                shown[t as usize] = true;
            }
            shown
        })
        .collect();
    let mut density: Vec<f32> =
        (0..mesh.triangles.len())
            .into_par_iter()
            .map(|t| {
                let [a, b, c] = mesh.corners(t as u32);
                let centroid = (a + b + c) / 3.0;
                let normal = mesh.face_normal(t as u32);
                let pixels_per_unit = views.iter().zip(surfaces).zip(&shown).filter_map(
                    |((view, surface), shown)| {
                        let to_camera = view.camera.position().as_vec3() - centroid;
                        let distance = to_camera.length();
                        let cosine = normal.dot(to_camera) / distance;
                        // Triangles smaller than a pixel slip between the pixels' centres.
                        let seen = shown[t] || surface.sees(centroid).is_some();
                        (cosine > 0.0 && seen)
                            .then(|| view.camera.focal.max_element() as f32 / distance * cosine)
                    },
                );
                texels_per_pixel * pixels_per_unit.fold(0.0, f32::max)
            })
            .collect();
    let mut seen: Vec<f32> = density.iter().copied().filter(|&d| d > 0.0).collect();
    let fallback = if seen.is_empty() {
        100.0 / mesh.diagonal().max(f32::MIN_POSITIVE)
    } else {
        let middle = seen.len() / 2;
        0.5 * *seen.select_nth_unstable_by(middle, f32::total_cmp).1
    };
    for d in density.iter_mut().filter(|d| **d <= 0.0) {
        *d = fallback;
    }
    density
}

/// The diffuse texture by the minimum over the views (2.1).
pub fn minimum_texture(
    mesh: &Mesh,
    atlas: &Atlas,
    views: &[View],
    surfaces: &[ViewSurface],
) -> MinimumTexture {
    let readings = Reading::of_all(views, surfaces);
    let texels: Vec<Least> = atlas
        .texels
        .par_chunks(AT_ONCE)
        .flat_map_iter(|texels| {
            let point = |texel: &Texel| mesh.point(texel.triangle, texel.barycentric);
            let points: Vec<SurfacePoint> = texels.iter().map(point).collect();
            let mut least = vec![Least::default(); points.len()];
            for reading in &readings {
                for (point, least) in points.iter().zip(&mut least) {
                    least.hear(reading.observe(point));
                }
            }
            least
        })
        .collect();
    let mut texture = MinimumTexture {
        radiance: vec![[0.0; 3]; atlas.len()],
        confidence: vec![0.0; atlas.len()],
    };
    for (texel, least) in atlas.texels.iter().zip(texels) {
        texture.radiance[texel.index as usize] = least.radiance.to_array();
        texture.confidence[texel.index as usize] = least.confidence;
    }
    texture
}

/// The colour of least magnitude among those heard of so far. Grazing views count only where there is no other.
#[derive(Clone, Copy)]
struct Least {
    radiance: Vec3,
    /// Whether it is from a grazing view, and its squared magnitude.
    rank: (bool, f32),
    /// Σ cos θᵣ.
    confidence: f32,
}

impl Default for Least {
    fn default() -> Self {
        Self {
            radiance: Vec3::ZERO,
            rank: (true, f32::INFINITY),
            confidence: 0.0,
        }
    }
}

impl Least {
    fn hear(&mut self, seen: Option<Observation>) {
        let Some(Observation { cosine, radiance }) = seen else {
            return;
        };
        self.confidence += cosine;
        let rank = (cosine < GRAZING, radiance.length_squared());
        if rank < self.rank {
            (self.rank, self.radiance) = (rank, radiance);
        }
    }
}

impl MinimumTexture {
    /// The texture as `view` sees it, one radiance per pixel, zero off the object. `None` for a pixel where it is unknown.
    pub fn render(
        &self,
        mesh: &Mesh,
        atlas: &Atlas,
        view: &View,
        surface: &ViewSurface,
    ) -> Vec<Option<[f32; 3]>> {
        let width = surface.width as usize;
        (0..surface.triangle.len())
            .into_par_iter()
            .map(|pixel| {
                let (x, y) = ((pixel % width) as u32, (pixel / width) as u32);
                let barycentric = surface.barycentric(mesh, &view.camera, x, y)?;
                self.at(atlas, surface.triangle[pixel], barycentric)
            })
            .collect()
    }

    /// The texture at a point of a triangle: bilinear where all four texels are known, else the mean of those known.
    pub fn at(&self, atlas: &Atlas, triangle: u32, barycentric: glam::Vec2) -> Option<[f32; 3]> {
        let taps = atlas.taps(triangle, barycentric);
        let mut sum = Vec3::ZERO;
        let mut known = 0.0;
        for (texel, weight) in taps {
            if self.confidence[texel] > 0.0 {
                sum += weight * Vec3::from(self.radiance[texel]);
                known += weight;
            }
        }
        (known > 1e-3).then(|| (sum / known).to_array())
    }
}
