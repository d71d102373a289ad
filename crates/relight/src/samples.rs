//! Which points of the surface each pixel's area shows: sub-samples on a regular grid inside the pixel.

use std::ops::Range;

use glam::Vec2;
use rayon::prelude::*;

use super::render::{Stop, TILE};
use rekindle_capture::{Camera, Mesh};
use rekindle_scene::surface::{Barycentrics, NO_TRIANGLE, Occluder, front_most};

/// Sub-samples held at a time: larger pictures are worked through in bands of rows.
const BAND_SAMPLES: usize = 4 << 20;

/// One sub-sample that meets the surface.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Front-most triangle.
    pub triangle: u32,
    /// Place in the pixel: row × factor + column.
    pub slot: u8,
    /// Weights of the triangle's second and third corner.
    pub barycentric: Vec2,
}

/// The sub-samples of some rows of a picture.
pub struct Samples {
    /// Sub-samples along each side of a pixel.
    pub factor: u32,
    /// The picture's width in pixels.
    pub width: usize,
    /// Rows of the picture.
    pub rows: Range<usize>,
    /// Samples of the band's pixel `i` are `points[starts[i]..starts[i + 1]]`, by slot.
    starts: Vec<u32>,
    points: Vec<Sample>,
    /// Pixels that show the surface but were not wanted.
    pub left_out: usize,
}

/// Which pixels of a picture are wanted, given column, row and the front-most triangle at the first of their sub-samples that
/// meets the surface.
pub type Wanted<'a> = &'a (dyn Fn([usize; 2], u32) -> bool + Sync);

impl Samples {
    /// The samples of a pixel, `index` counted from the band's first pixel.
    pub fn of(&self, index: usize) -> &[Sample] {
        &self.points[self.starts[index] as usize..self.starts[index + 1] as usize]
    }

    /// Samples that a pixel would have if the surface covered it.
    pub fn full(&self) -> usize {
        (self.factor * self.factor) as usize
    }

    /// Traces the `wanted` pixels in `rows` of the picture that `camera` takes. Where `stop` says so, rows stay empty.
    pub fn trace(
        mesh: &Mesh,
        occluder: &Occluder,
        camera: &Camera,
        rows: Range<usize>,
        factor: u32,
        wanted: Wanted,
        stop: Stop,
    ) -> Self {
        let fine = Self::fine(camera, &rows, factor);
        let (triangles, _) = front_most(mesh, occluder, &fine);
        Self::collect(mesh, &fine, &triangles, rows, factor, wanted, stop)
    }

    /// The `wanted` pixels in `rows` of a view, one sample each, given the front-most triangles at the pixels of these rows.
    pub fn of_view(
        mesh: &Mesh,
        camera: &Camera,
        triangles: &[u32],
        rows: Range<usize>,
        wanted: Wanted,
    ) -> Self {
        let fine = Self::fine(camera, &rows, 1);
        Self::collect(mesh, &fine, triangles, rows, 1, wanted, &|| false)
    }

    /// The camera with a pixel for each sample of some rows.
    fn fine(camera: &Camera, rows: &Range<usize>, factor: u32) -> Camera {
        let mut fine = camera.supersampled(factor);
        fine.centre.y -= f64::from(rows.start as u32 * factor);
        fine.height = rows.len() as u32 * factor;
        fine
    }

    fn collect(
        mesh: &Mesh,
        fine: &Camera,
        triangles: &[u32],
        rows: Range<usize>,
        factor: u32,
        wanted: Wanted,
        stop: Stop,
    ) -> Self {
        let (width, factor_) = ((fine.width / factor) as usize, factor as usize);
        let row_samples: Vec<(Vec<u32>, Vec<Sample>, usize)> = (0..rows.len())
            .into_par_iter()
            .map(|row| {
                let mut ends = Vec::with_capacity(width);
                let mut samples = Vec::new();
                let mut left_out = 0;
                let mut barycentrics = Barycentrics::new(mesh, fine);
                for x in 0..width {
                    if x.is_multiple_of(TILE) && stop() {
                        return (vec![0; width], Vec::new(), 0);
                    }
                    let mut is_wanted = None;
                    for slot in 0..factor_ * factor_ {
                        let (fx, fy) =
                            (x * factor_ + slot % factor_, row * factor_ + slot / factor_);
                        let triangle = triangles[fy * width * factor_ + fx];
                        if triangle == NO_TRIANGLE {
                            continue;
                        }
                        let ask = || wanted([x, rows.start + row], triangle);
                        if !*is_wanted.get_or_insert_with(ask) {
                            left_out += 1;
                            break;
                        }
                        if let Some(barycentric) = barycentrics.at(triangle, fx as u32, fy as u32) {
                            samples.push(Sample {
                                triangle,
                                slot: slot as u8,
                                barycentric,
                            });
                        }
                    }
                    ends.push(samples.len() as u32);
                }
                (ends, samples, left_out)
            })
            .collect();
        let mut starts = Vec::with_capacity(rows.len() * width + 1);
        starts.push(0);
        let mut samples = Vec::with_capacity(row_samples.iter().map(|r| r.1.len()).sum());
        let mut left_out = 0;
        for (ends, row, left_out_of_row) in row_samples {
            left_out += left_out_of_row;
            let base = samples.len() as u32;
            starts.extend(ends.iter().map(|e| base + e));
            samples.extend(row);
        }
        Self {
            factor,
            width,
            rows,
            starts,
            points: samples,
            left_out,
        }
    }
}

/// Ranges of rows to trace one after the other. Each but the last is whole tiles of the renderer, so that a picture doesn't
/// depend on how it is cut.
pub fn bands(camera: &Camera, factor: u32) -> impl Iterator<Item = Range<usize>> {
    let per_row = camera.width as usize * (factor * factor) as usize;
    let tiles = (BAND_SAMPLES / (per_row * TILE).max(1)).max(1);
    let height = camera.height as usize;
    (0..height)
        .step_by(tiles * TILE)
        .map(move |start| start..(start + tiles * TILE).min(height))
}
