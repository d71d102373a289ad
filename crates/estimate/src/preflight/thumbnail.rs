//! Small pictures of the views with the mesh's outline, to see at a glance whether they fit.

use rayon::prelude::*;

use rekindle_capture::{Camera, Mesh, View};
use rekindle_scene::hemisphere::srgb;
use rekindle_scene::surface::{NO_TRIANGLE, Occluder, front_most};

/// Longest side in pixels.
const SIDE: u32 = 720;
/// Share of a view's pixels that may be brighter than white.
const CLIPPED: f64 = 0.005;
/// A jump in depth by more than this part of the mesh's diagonal is an outline.
const JUMP: f32 = 0.02;

/// A small picture of a view.
#[derive(Clone, Debug)]
pub struct Thumbnail {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// The photograph, sRGB, row by row from the top.
    pub photograph: Vec<[u8; 3]>,
    /// Where the mesh has an outline, as its camera sees it.
    pub outline: Vec<bool>,
}

impl Thumbnail {
    /// The small picture of a view.
    pub fn new(view: &View, mesh: &Mesh, occluder: &Occluder) -> Self {
        let photograph = &view.photograph;
        let longest = photograph.width.max(photograph.height).max(1);
        let scale = f64::from(SIDE.min(longest)) / f64::from(longest);
        let small = |side: u32| ((f64::from(side) * scale).round() as u32).max(1);
        let (width, height) = (small(photograph.width), small(photograph.height));
        let white = white(&photograph.radiance);
        let pixel = |i: usize| {
            let (x, y) = (i as u32 % width, i as u32 / width);
            let columns = span(x, width, photograph.width);
            let mut sum = glam::Vec3::ZERO;
            let mut count = 0.0;
            for row in span(y, height, photograph.height) {
                for column in columns.clone() {
                    let at = (row * photograph.width + column) as usize;
                    sum += glam::Vec3::from(photograph.radiance[at]);
                    count += 1.0;
                }
            }
            (sum / (count * white))
                .to_array()
                .map(|v| (255.0 * srgb(v.min(1.0))).round() as u8)
        };
        let pixels = (width * height) as usize;
        let camera = view.camera.resized(width, height);
        Self {
            width,
            height,
            photograph: (0..pixels).into_par_iter().map(pixel).collect(),
            outline: outline(mesh, occluder, &camera),
        }
    }
}

/// Where a mesh has an outline, as a camera sees it, by its pixels: two of them wide, to be seen on a small picture.
pub fn outline(mesh: &Mesh, occluder: &Occluder, camera: &Camera) -> Vec<bool> {
    let (triangles, depth) = front_most(mesh, occluder, camera);
    let (width, height) = (camera.width, camera.height);
    let jump = JUMP * mesh.diagonal();
    let edge = |i: usize| {
        let (x, y) = (i as u32 % width, i as u32 / width);
        let here = triangles[i] != NO_TRIANGLE;
        let differs = |j: usize| {
            let there = triangles[j] != NO_TRIANGLE;
            here != there || here && (depth[i] - depth[j]).abs() > jump
        };
        x > 0 && differs(i - 1)
            || y > 0 && differs(i - width as usize)
            || x + 1 < width && differs(i + 1)
            || y + 1 < height && differs(i + width as usize)
    };
    (0..triangles.len()).into_par_iter().map(edge).collect()
}

/// The large picture's columns, or rows, that a small one's shows.
fn span(at: u32, small: u32, large: u32) -> std::ops::Range<u32> {
    let edge = |at: u32| (u64::from(at) * u64::from(large) / u64::from(small)) as u32;
    let first = edge(at).min(large - 1);
    first..edge(at + 1).max(first + 1).min(large)
}

/// Radiance that only [`CLIPPED`] of the pixels exceed.
fn white(radiance: &[[f32; 3]]) -> f32 {
    let mut levels: Vec<f32> = radiance
        .iter()
        .map(|p| p.iter().copied().fold(0.0, f32::max))
        .filter(|&v| v > 0.0)
        .collect();
    if levels.is_empty() {
        return 1.0;
    }
    let at = ((levels.len() - 1) as f64 * (1.0 - CLIPPED)) as usize;
    *levels.select_nth_unstable_by(at, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use rekindle_capture::Capture;
    use std::path::Path;

    #[test]
    fn the_outline_lies_around_the_object() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/captures/spot_paper");
        let capture = Capture::load(&folder).unwrap();
        let occluder = Occluder::new(&capture.mesh);
        for view in &capture.views {
            let small = Thumbnail::new(view, &capture.mesh, &occluder);
            assert_eq!(
                (small.width, small.height),
                (view.photograph.width, view.photograph.height),
                "small photographs keep their size"
            );
            let coverage = view.photograph.coverage.as_ref().unwrap();
            let width = small.width as usize;
            let around = |i: usize| [i - width, i - 1, i, i + 1, i + width];
            let mut silhouette = 0;
            for i in width..coverage.len() - width {
                let outlined = around(i).iter().any(|&j| small.outline[j]);
                if (coverage[i] > 0.5) != (coverage[i + 1] > 0.5) {
                    silhouette += 1;
                    assert!(outlined, "no outline at the silhouette's pixel {i}");
                }
                let empty = around(i).iter().all(|&j| coverage[j] == 0.0);
                assert!(!(empty && small.outline[i]), "outline off the object: {i}");
            }
            assert!(silhouette > 100, "{silhouette} pixels of silhouette");
        }
    }
}
