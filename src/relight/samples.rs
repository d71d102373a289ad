//! Which points of the surface each pixel's area shows: sub-samples on a regular grid inside the pixel.

use std::ops::Range;

use glam::Vec2;
use rayon::prelude::*;

use super::render::{Stop, TILE};
use crate::capture::{Camera, Mesh};
use crate::surface::{NO_TRIANGLE, Occluder, barycentric_at, front_most};

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
}

impl Samples {
    /// The samples of a pixel, `index` counted from the band's first pixel.
    pub fn of(&self, index: usize) -> &[Sample] {
        &self.points[self.starts[index] as usize..self.starts[index + 1] as usize]
    }

    /// Number of samples in a row, counted from the band's first.
    pub fn in_row(&self, row: usize) -> usize {
        let [first, end] = [row, row + 1].map(|row| self.starts[row * self.width]);
        (end - first) as usize
    }

    /// Samples that a pixel would have if the surface covered it.
    pub fn full(&self) -> usize {
        (self.factor * self.factor) as usize
    }

    /// Traces `rows` of the picture that `camera` takes. Where `stop` says so, rows stay empty.
    pub fn trace(
        mesh: &Mesh,
        occluder: &Occluder,
        camera: &Camera,
        rows: Range<usize>,
        factor: u32,
        stop: Stop,
    ) -> Self {
        let mut fine = camera.supersampled(factor);
        fine.centre.y -= f64::from(rows.start as u32 * factor);
        fine.height = rows.len() as u32 * factor;
        let (triangles, _) = front_most(mesh, occluder, &fine);
        let (width, factor_) = (camera.width as usize, factor as usize);
        let row_samples: Vec<(Vec<u32>, Vec<Sample>)> = (0..rows.len())
            .into_par_iter()
            .map(|row| {
                let mut ends = Vec::with_capacity(width);
                let mut samples = Vec::new();
                for x in 0..width {
                    if x.is_multiple_of(TILE) && stop() {
                        return (vec![0; width], Vec::new());
                    }
                    for slot in 0..factor_ * factor_ {
                        let (fx, fy) =
                            (x * factor_ + slot % factor_, row * factor_ + slot / factor_);
                        let triangle = triangles[fy * width * factor_ + fx];
                        if triangle == NO_TRIANGLE {
                            continue;
                        }
                        if let Some(barycentric) =
                            barycentric_at(mesh, &fine, triangle, fx as u32, fy as u32)
                        {
                            samples.push(Sample {
                                triangle,
                                slot: slot as u8,
                                barycentric,
                            });
                        }
                    }
                    ends.push(samples.len() as u32);
                }
                (ends, samples)
            })
            .collect();
        let mut starts = Vec::with_capacity(rows.len() * width + 1);
        starts.push(0);
        let mut samples = Vec::with_capacity(row_samples.iter().map(|r| r.1.len()).sum());
        for (ends, row) in row_samples {
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
