//! Of large photographs only the rectangle about the object is kept: nothing else is asked for once a capture is solved. Of many
//! large ones blocks of pixels are taken together: lights and roughness come out the same from 0.1 megapixels a view on, and a
//! texture that many views show in fewer pixels is as certain.

use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use super::{Camera, Capture, Photograph, View};
use glam::{DVec2, Vec3};

/// Photographs of fewer pixels are kept whole: nothing is gained.
const LARGE: usize = 500_000;
/// A crop that keeps more than this part of a photograph is none.
const MOST_KEPT: f64 = 0.75;
/// Room about the object, as a part of its longer side: for outlines that are to be found there.
const MARGIN: f64 = 1.0 / 16.0;
/// Whole blocks of so many pixels are cut off on the left and above, so that what works in blocks cuts the rest as before.
const BLOCK: usize = 32;

/// Pixels that all views together may keep, and that one may keep however many there are.
const ALL_VIEWS: usize = 64_000_000;
const ONE_VIEW: usize = 2_500_000;

/// What is kept of photographs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kept {
    /// Every pixel.
    All,
    /// Of large ones those about the object.
    Object,
    /// The same, in blocks where one of so many views would keep more than its share.
    Shared(usize),
}

/// A part of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crop {
    /// Columns and rows of the picture before its first pixel.
    pub first: [u32; 2],
    /// Width and height of the picture.
    pub whole: [u32; 2],
    /// Pixels of the picture along each side of one of its own.
    pub block: u32,
}

impl Kept {
    /// Pixels of a photograph that are kept at most, if that is limited.
    pub(super) fn at_most(self) -> Option<usize> {
        match self {
            Self::All | Self::Object => None,
            Self::Shared(views) => Some((ALL_VIEWS / views.max(1)).max(ONE_VIEW)),
        }
    }

    /// What is kept of a photograph.
    pub(super) fn of(self, photograph: Photograph) -> Photograph {
        if self == Self::All {
            return photograph;
        }
        let kept = photograph.about_object();
        let most = self.at_most().unwrap_or(usize::MAX);
        let mut block = 1;
        while kept.usable.len() / (block * block) > most {
            block += 1;
        }
        match block {
            1 => kept,
            block => kept.in_blocks(block),
        }
    }
}

impl Capture {
    /// The capture with as many pixels as [`Capture::load`] keeps, if it has all.
    #[must_use]
    pub fn reduced(&self) -> Self {
        let kept = Kept::Shared(self.views.len());
        let reduced = |view: &View| {
            let photograph = &view.photograph;
            if photograph.crop.is_some() || photograph.usable.len() < LARGE {
                return view.clone();
            }
            let photograph = kept.of(Photograph::clone(photograph));
            let size = [photograph.width, photograph.height];
            let camera = view.camera.clone();
            View {
                name: view.name.clone(),
                camera: match photograph.crop {
                    None => camera,
                    Some(crop) => camera.cropped(crop, size),
                },
                photograph: Arc::new(photograph),
            }
        };
        let views: Vec<View> = self.views.par_iter().map(reduced).collect();
        let mut warnings = self.warnings.clone();
        warnings.extend(note(&views).filter(|note| !warnings.contains(note)));
        Self {
            views,
            warnings,
            ..self.clone()
        }
    }
}

impl View {
    /// The same with one pixel for each block of `block` × `block`, for questions that need no more.
    #[must_use]
    pub fn in_blocks(&self, block: u32) -> Self {
        let mut camera = self.camera.clone();
        camera.width /= block;
        camera.height /= block;
        camera.focal /= f64::from(block);
        camera.centre /= f64::from(block);
        Self {
            name: self.name.clone(),
            photograph: Arc::new(self.photograph.in_blocks(block as usize)),
            camera,
        }
    }
}

/// What there is to say of views of which blocks of pixels are kept.
pub(super) fn note(views: &[View]) -> Option<String> {
    let blocks = views.iter().filter_map(|view| view.photograph.crop);
    let blocks: Vec<u32> = blocks.map(|crop| crop.block).filter(|&b| b > 1).collect();
    let block = blocks.iter().max()?;
    Some(format!(
        "Of {} large photographs blocks of up to {block}×{block} pixels are taken as one, and the texture is as coarse as that;          `rekindle solve --do-all pixels` keeps each.",
        blocks.len()
    ))
}

impl Photograph {
    /// The means over blocks of so many pixels along each side; what can't be used of a block spoils it.
    fn in_blocks(&self, block: usize) -> Self {
        let [width, height] = [self.width as usize, self.height as usize].map(|side| side / block);
        let pixels = |i: usize| {
            let first = i / width * block * self.width as usize + i % width * block;
            (0..block * block).map(move |k| first + k / block * self.width as usize + k % block)
        };
        let share = 1.0 / (block * block) as f32;
        let all = || (0..width * height).into_par_iter();
        let usable: Vec<bool> = all().map(|i| pixels(i).all(|p| self.usable[p])).collect();
        let is_known = |p: usize| self.usable[p] || self.is_clipped(p);
        let clipped: Option<Vec<bool>> = self.clipped.is_some().then(|| {
            let at_least = |i: usize| !usable[i] && pixels(i).all(is_known);
            all().map(at_least).collect()
        });
        let is_clipped = |i: usize| clipped.as_ref().is_some_and(|clipped| clipped[i]);
        let mean = |i: usize| {
            let sum = || {
                pixels(i)
                    .map(|p| Vec3::from(self.radiance[p]))
                    .sum::<Vec3>()
            };
            if usable[i] || is_clipped(i) {
                (sum() * share).to_array()
            } else {
                [0.0; 3]
            }
        };
        let covered = |c: &Vec<f32>| {
            let mean = |i: usize| pixels(i).map(|p| c[p]).sum::<f32>() * share;
            all().map(mean).collect()
        };
        let crop = self.crop.unwrap_or(Crop {
            first: [0; 2],
            whole: [self.width, self.height],
            block: 1,
        });
        Self {
            width: width as u32,
            height: height as u32,
            radiance: all().map(mean).collect(),
            coverage: self.coverage.as_ref().map(covered),
            crop: Some(Crop {
                block: block as u32 * crop.block,
                ..crop
            }),
            clipped,
            usable,
        }
    }

    /// The part of a large photograph that shows the object, by its coverage; all of it where that isn't known.
    fn about_object(self) -> Self {
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
            clipped: (self.clipped.as_ref()).map(|c| part(c, size[0], &columns, &rows)),
            crop: Some(Crop {
                first: [columns.start as u32, rows.start as u32],
                whole: [self.width, self.height],
                block: 1,
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
    /// The same camera that takes `crop` of its picture, of `size` pixels.
    pub(super) fn cropped(self, crop: Crop, [width, height]: [u32; 2]) -> Self {
        let block = f64::from(crop.block);
        Self {
            width,
            height,
            focal: self.focal / block,
            centre: (self.centre - crop.first_pixel()) / block,
            ..self
        }
    }
}

impl View {
    /// The camera that takes the whole picture of its file.
    pub fn whole_camera(&self) -> Camera {
        let camera = self.camera.clone();
        let Some(crop) = self.photograph.crop else {
            return camera;
        };
        let [width, height] = crop.whole;
        let block = f64::from(crop.block);
        Camera {
            width,
            height,
            focal: camera.focal * block,
            centre: camera.centre * block + crop.first_pixel(),
            ..camera
        }
    }
}

impl Crop {
    fn first_pixel(&self) -> DVec2 {
        let [x, y] = self.first;
        DVec2::new(f64::from(x), f64::from(y))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A photograph whose pixels know where they are, of an object in some columns and rows.
    fn photograph(size: [u32; 2], object: &[Range<u32>; 2]) -> Photograph {
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
            clipped: None,
            crop: None,
        }
    }

    #[test]
    fn of_a_large_photograph_the_object_is_kept_with_room_about_it() {
        let cropped = photograph([2000, 1500], &[700..1100, 3..803]).about_object();
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
    fn a_block_with_a_clipped_pixel_is_at_least_as_bright_as_its_mean() {
        let mut whole = photograph([8, 4], &[0..8, 0..4]);
        // One pixel of the first block is clipped, one of the second no data, and one of the third either.
        let mut clipped = vec![false; 32];
        for (pixel, is_clipped) in [(1, true), (2, false), (4, true), (5, false)] {
            whole.usable[pixel] = false;
            clipped[pixel] = is_clipped;
        }
        whole.clipped = Some(clipped);
        let blocks = whole.in_blocks(2);
        assert_eq!(blocks.usable[..4], [false, false, false, true]);
        let is_clipped: Vec<bool> = (0..8).map(|i| blocks.is_clipped(i)).collect();
        assert_eq!(is_clipped[..4], [true, false, false, false]);
        assert_eq!(blocks.radiance[0], [0.5, 0.5, 1.0]);
        assert_eq!(blocks.radiance[1], [0.0; 3]);
    }

    #[test]
    fn of_many_views_blocks_are_kept_that_show_where_they_were() {
        let whole = photograph([4000, 3000], &[800..2800, 200..2700]);
        let alone = Kept::Shared(6).of(whole.clone());
        assert_eq!(alone.crop.map(|crop| crop.block), Some(1));
        let kept = Kept::Shared(40).of(whole);
        let crop = kept.crop.expect("a part");
        assert_eq!((crop.block, kept.width), (2, alone.width / 2));
        let first = crop.first.map(|at| at as f32);
        for i in (0..kept.usable.len()).filter(|&i| kept.usable[i]) {
            let [x, y] = [i as u32 % kept.width, i as u32 / kept.width].map(|at| 2.0 * at as f32);
            let [r, g, b] = kept.radiance[i];
            let near = (r - first[0] - x - 0.5)
                .abs()
                .max((g - first[1] - y - 0.5).abs());
            assert!(near < 1e-2 && b == 1.0, "{r} {g}");
        }
        let shown = |p: &Photograph| p.coverage.iter().flatten().sum::<f32>();
        assert_eq!(4.0 * shown(&kept), shown(&alone));
        // A camera sees a point of the whole picture where it lies in the part.
        let camera = Camera {
            width: 4000,
            height: 3000,
            focal: DVec2::new(3000.0, 3100.0),
            centre: DVec2::new(2011.0, 1507.0),
            distortion: crate::Distortion::default(),
            world_from_camera: glam::DAffine3::IDENTITY,
        };
        let view = View {
            name: String::new(),
            camera: camera.clone().cropped(crop, [kept.width, kept.height]),
            photograph: Arc::new(kept),
        };
        let point = glam::DVec3::new(0.1, 0.2, -3.0);
        let [part, all, again] = [&view.camera, &camera, &view.whole_camera()]
            .map(|camera| camera.project(point).expect("before the camera"));
        let said = note(std::slice::from_ref(&view)).expect("a note");
        assert!(said.contains("2×2"), "{said}");
        assert!((part * 2.0 + crop.first_pixel()).distance(all) < 1e-9);
        assert!(again.distance(all) < 1e-9);
    }

    #[test]
    fn a_capture_with_all_pixels_is_reduced_once_and_knows_its_whole_cameras() {
        let photograph = photograph([2000, 1500], &[700..1100, 3..803]);
        let camera = Camera {
            width: 2000,
            height: 1500,
            focal: DVec2::splat(1800.0),
            centre: DVec2::new(1003.0, 747.0),
            distortion: crate::Distortion::default(),
            world_from_camera: glam::DAffine3::IDENTITY,
        };
        let view = View {
            name: "view".to_owned(),
            camera: camera.clone(),
            photograph: Arc::new(photograph),
        };
        let capture = Capture {
            name: "thing".to_owned(),
            views: vec![view],
            mesh: crate::Mesh {
                origin: glam::DVec3::ZERO,
                positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
                normals: vec![Vec3::Z; 3],
                uvs: Vec::new(),
                triangles: vec![[0, 1, 2]],
            },
            light_hemisphere: crate::LightHemisphere {
                up: glam::DVec3::Z,
                radius: None,
                frame: None,
            },
            is_developed: false,
            brackets: None,
            warnings: Vec::new(),
        };
        let reduced = capture.reduced();
        let kept = &reduced.views[0];
        assert_eq!([kept.camera.width, kept.camera.height], [510, 853]);
        assert_eq!(kept.camera.centre, camera.centre - DVec2::new(640.0, 0.0));
        let whole = kept.whole_camera();
        assert_eq!([whole.width, whole.height], [2000, 1500]);
        assert_eq!(whole.centre, camera.centre);
        assert!(reduced.warnings.is_empty(), "nothing is coarser");
        assert_eq!(reduced.reduced().fingerprint(), reduced.fingerprint());
    }

    #[test]
    fn what_is_small_or_full_or_without_coverage_is_kept_whole() {
        let small = photograph([800, 600], &[100..200, 100..200]);
        let full = photograph([2000, 1500], &[50..1900, 50..1450]);
        let unknown = Photograph {
            coverage: None,
            ..photograph([2000, 1500], &[700..1100, 300..800])
        };
        for whole in [small, full, unknown] {
            let size = [whole.width, whole.height];
            let kept = whole.about_object();
            assert_eq!((kept.crop, [kept.width, kept.height]), (None, size));
        }
    }
}
