//! Whether a view and the mesh fit: silhouettes, the camera's place, the part of the object in the picture.

use crate::registration::Silhouettes;
use glam::DVec3;
use rekindle_capture::{Camera, Mesh, PixelCounts, View};
use rekindle_scene::surface::{NO_TRIANGLE, Occluder, ViewSurface};
use serde::Serialize;

/// Rays cast from a camera to find out whether it is inside the mesh.
const RAYS: u32 = 64;

/// What one view is like.
#[derive(Clone, Debug, Serialize)]
pub struct ViewReport {
    /// The view's name.
    pub name: String,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Bad pixels.
    pub pixels: PixelCounts,
    /// Number of pixels whose centre shows the mesh.
    pub object_pixels: usize,
    /// Share of those that are saturated.
    pub saturated_share: f64,
    /// Silhouette of the mesh against coverage above one half: intersection over union, if coverage is known.
    pub silhouette_iou: Option<f64>,
    /// How far the picture's silhouette lies from the mesh's, by their centres of mass, in pixels (x, y).
    pub silhouette_shift: Option<[f64; 2]>,
    /// Share of the image's border that shows the object: a cropped object.
    pub border_share: f64,
    /// Share of the object's pixels that show the back of a triangle.
    pub back_share: f64,
    /// Whether the camera is inside the mesh.
    pub inside: bool,
    /// Largest radiance in the view, on the capture's scale.
    pub max_radiance: f32,
    /// This view's brightness relative to the other views at the same surface points: 1 if exposures agree, none if too
    /// few points are shared.
    pub relative_exposure: Option<f64>,
}

impl ViewReport {
    /// Compares a view with what its camera should see of the mesh.
    pub(super) fn new(
        view: &View,
        pixels: PixelCounts,
        surface: &ViewSurface,
        mesh: &Mesh,
        occluder: &Occluder,
    ) -> Self {
        let photograph = &view.photograph;
        let object_pixels = surface
            .triangle
            .iter()
            .filter(|&&t| t != NO_TRIANGLE)
            .count();
        let share = |count: usize| count as f64 / object_pixels.max(1) as f64;
        let silhouettes = photograph
            .coverage
            .as_ref()
            .and_then(|coverage| Silhouettes::new(coverage, surface))
            .map(|silhouettes| (silhouettes.overlap, silhouettes.shift()));
        let max_radiance = photograph
            .radiance
            .iter()
            .flatten()
            .fold(0.0, |largest: f32, &v| largest.max(v));
        Self {
            name: view.name.clone(),
            width: photograph.width,
            height: photograph.height,
            pixels,
            object_pixels,
            saturated_share: share(pixels.saturated.min(object_pixels)),
            silhouette_iou: silhouettes.map(|(iou, _)| iou),
            silhouette_shift: silhouettes.map(|(_, shift)| shift.to_array()),
            border_share: border_share(surface),
            back_share: share(back_pixels(&view.camera, surface, mesh)),
            inside: is_inside(view.camera.position(), mesh, occluder),
            max_radiance,
            relative_exposure: None,
        }
    }
}

fn border_share(surface: &ViewSurface) -> f64 {
    let (width, height) = (surface.width as usize, surface.height as usize);
    let of_row = |y: usize| {
        let ends = y == 0 || y + 1 == height;
        let step = if ends { 1 } else { (width - 1).max(1) };
        (0..width).step_by(step).map(move |x| y * width + x)
    };
    let (mut shown, mut all) = (0_usize, 0_usize);
    for pixel in (0..height).flat_map(of_row) {
        all += 1;
        shown += usize::from(surface.triangle[pixel] != NO_TRIANGLE);
    }
    shown as f64 / all.max(1) as f64
}

/// Number of pixels whose triangle is wound away from the camera.
fn back_pixels(camera: &Camera, surface: &ViewSurface, mesh: &Mesh) -> usize {
    let eye = camera.position();
    surface
        .triangle
        .iter()
        .filter(|&&triangle| {
            triangle != NO_TRIANGLE && {
                let [a, b, c] = mesh.corners(triangle).map(glam::Vec3::as_dvec3);
                (b - a).cross(c - a).dot(eye - a) < 0.0
            }
        })
        .count()
}

/// Whether nearly all rays from a point, in directions spread evenly, meet the back of a triangle first.
fn is_inside(eye: DVec3, mesh: &Mesh, occluder: &Occluder) -> bool {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let back = (0..RAYS).filter(|&i| {
        // Fibonacci's spiral on the sphere.
        let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(RAYS);
        let (sin, cos) = (golden * f64::from(i)).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        let direction = DVec3::new(radius * cos, radius * sin, z).as_vec3();
        occluder
            .hit(eye.as_vec3(), direction)
            .is_some_and(|hit| mesh.face_normal(hit.triangle).dot(direction) > 0.0)
    });
    back.count() as u32 * 10 >= RAYS * 9
}
