//! Of large photographs only the rectangle about the object is kept: nothing else is asked for once a capture is solved.

use std::ops::Range;

use super::{Camera, Photograph, View};
use glam::DVec2;

/// Photographs of fewer pixels are kept whole: nothing is gained.
const LARGE: usize = 2_000_000;
/// A crop that keeps more than this part of a photograph is none.
const MOST_KEPT: f64 = 0.75;
/// Room about the object, as a part of its longer side: for outlines that are to be found there.
const MARGIN: f64 = 1.0 / 16.0;
/// Whole blocks of so many pixels are cut off on the left and above, so that what works in blocks cuts the rest as before.
const BLOCK: usize = 32;

/// A part of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crop {
    /// Columns and rows before its first pixel.
    pub first: [u32; 2],
    /// Width and height of the picture.
    pub whole: [u32; 2],
}

impl Photograph {
    /// The part of a large photograph that shows the object, by its coverage; all of it where that isn't known.
    pub(super) fn about_object(self) -> Self {
        let size = [self.width as usize, self.height as usize];
        let Some([columns, rows]) = self.object() else {
            return self;
        };
        let kept = columns.len() * rows.len();
        if size[0] * size[1] < LARGE || kept as f64 > MOST_KEPT * (size[0] * size[1]) as f64 {
            return self;
        }
        Self {
            width: columns.len() as u32,
            height: rows.len() as u32,
            radiance: part(&self.radiance, size[0], &columns, &rows),
            coverage: (self.coverage.as_ref()).map(|c| part(c, size[0], &columns, &rows)),
            usable: part(&self.usable, size[0], &columns, &rows),
            crop: Some(Crop {
                first: [columns.start as u32, rows.start as u32],
                whole: [self.width, self.height],
            }),
        }
    }

    /// Columns and rows that show the object, with room about it.
    fn object(&self) -> Option<[Range<usize>; 2]> {
        let [width, height] = [self.width as usize, self.height as usize];
        let (mut low, mut high) = ([width, height], [0, 0]);
        for (y, row) in self.coverage.as_ref()?.chunks_exact(width).enumerate() {
            let is_shown = |covered: &f32| *covered > 0.0;
            if let (Some(first), Some(last)) = (
                row.iter().position(is_shown),
                row.iter().rposition(is_shown),
            ) {
                low = [low[0].min(first), low[1].min(y)];
                high = [high[0].max(last + 1), y + 1];
            }
        }
        let longer = high[0]
            .saturating_sub(low[0])
            .max(high[1].saturating_sub(low[1]));
        let margin = (MARGIN * longer as f64).ceil() as usize;
        let along = |axis: usize, size: usize| {
            let first = low[axis].saturating_sub(margin);
            first - first % BLOCK..(high[axis] + margin).min(size)
        };
        (longer > 0).then(|| [along(0, width), along(1, height)])
    }
}

fn part<T: Copy>(
    values: &[T],
    width: usize,
    columns: &Range<usize>,
    rows: &Range<usize>,
) -> Vec<T> {
    let rows = rows.clone().map(|y| &values[y * width..][columns.clone()]);
    rows.flatten().copied().collect()
}

impl Camera {
    /// The same camera that takes a part of its picture, of `size` pixels after the `first`.
    pub(super) fn cropped(self, first: [u32; 2], [width, height]: [u32; 2]) -> Self {
        Self {
            width,
            height,
            centre: self.centre - first_pixel(first),
            ..self
        }
    }
}

impl View {
    /// The camera that takes the whole picture of its file.
    pub fn whole_camera(&self) -> Camera {
        let camera = self.camera.clone();
        match self.photograph.crop {
            None => camera,
            Some(Crop {
                first,
                whole: [width, height],
            }) => Camera {
                width,
                height,
                centre: camera.centre + first_pixel(first),
                ..camera
            },
        }
    }
}

fn first_pixel([x, y]: [u32; 2]) -> DVec2 {
    DVec2::new(f64::from(x), f64::from(y))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A photograph whose pixels know where they are, of an object in some columns and rows.
    fn photograph(size: [u32; 2], object: [Range<u32>; 2]) -> Photograph {
        let [width, height] = size;
        let places = || (0..width * height).map(|p| [p % width, p / width]);
        let covered = |[x, y]: [u32; 2]| object[0].contains(&x) && object[1].contains(&y);
        Photograph {
            width,
            height,
            radiance: places().map(|[x, y]| [x as f32, y as f32, 1.0]).collect(),
            coverage: Some(
                places()
                    .map(|at| f32::from(u8::from(covered(at))))
                    .collect(),
            ),
            usable: places().map(covered).collect(),
            crop: None,
        }
    }

    #[test]
    fn of_a_large_photograph_the_object_is_kept_with_room_about_it() {
        let cropped = photograph([2000, 1500], [700..1100, 3..803]).about_object();
        let crop = cropped.crop.expect("a part");
        assert_eq!(crop.whole, [2000, 1500]);
        assert_eq!(crop.first, [640, 0], "whole blocks are cut off");
        assert_eq!([cropped.width, cropped.height], [1150 - 640, 853]);
        for (i, pixel) in cropped.radiance.iter().enumerate() {
            let [x, y] = [i as u32 % cropped.width, i as u32 / cropped.width];
            assert_eq!(*pixel, [(x + 640) as f32, y as f32, 1.0]);
        }
        let coverage = cropped.coverage.expect("it is known");
        assert_eq!(coverage.iter().sum::<f32>(), 400.0 * 800.0);
        assert_eq!(cropped.usable.iter().filter(|u| **u).count(), 400 * 800);
    }

    #[test]
    fn what_is_small_or_full_or_without_coverage_is_kept_whole() {
        let small = photograph([800, 600], [100..200, 100..200]);
        let full = photograph([2000, 1500], [50..1900, 50..1450]);
        let unknown = Photograph {
            coverage: None,
            ..photograph([2000, 1500], [700..1100, 300..800])
        };
        for whole in [small, full, unknown] {
            let size = [whole.width, whole.height];
            let kept = whole.about_object();
            assert_eq!((kept.crop, [kept.width, kept.height]), (None, size));
        }
    }
}
