//! From a sensor's samples to linear RGB.
//!
//! 1. Black level is taken off, and what is left divided by the distance from there to the white level.
//! 2. Samples of hot pixels get the mean of their neighbours of the same colour.
//! 3. The two colours that a pixel lacks are interpolated, by the decoder's own routines.
//! 4. White balance, relative to green, and the camera's matrix make it linear sRGB. There is no tone curve, and nothing else that
//!    raw converters do to please.
//!
//! A pixel is clipped where a sample that it is interpolated from is. With white balance channels clip at different levels, and
//! what is clipped in all of them would be magenta. So clipped pixels are cut in all channels at the lowest of these levels, which
//! makes highlights white. As their radiance is taken for the least that there can be, no channel gets more from the matrix than it
//! has before: the matrix takes from each what others have, and of these a part may be missing.

use glam::{DMat3, DVec3};
use rawler::RawImage;
use rawler::cfa::CFA;
use rawler::imgop::chromatic_adaption::bradford_adaption_matrix;
use rawler::imgop::sensor::xtrans::bilinear::XTransBilinearDemosaic;
use rawler::imgop::sensor::{Demosaic, SensorType, bayer::ppg::PPGDemosaic};
use rawler::imgop::xyz::{Illuminant, SRGB_TO_XYZ_D65};
use rawler::imgop::{Dim2, Point, Rect};
use rawler::pixarray::PixF32;
use rawler::rawimage::{CFAConfig, RawImageData, RawPhotometricInterpretation as Kind};
use rayon::prelude::*;

use super::Fault;

/// From this part of white on samples are clipped: many sensors end a little below the level that is stated for them.
const CLIPPED_FROM: f32 = 0.99;

/// Samples about a pixel, along columns and rows, that it is interpolated from.
const REACH: usize = 2;

/// Pixels about the picture that are developed along with it, so that its borders are interpolated as well as all else.
const MARGIN: usize = 4;

/// How many times as bright as all about it of the same colour the sample of a hot pixel is.
const HOT: f32 = 10.0;

/// Illuminants that cameras' matrices are measured for, the one of sRGB first.
const ILLUMINANTS: [Illuminant; 9] = [
    Illuminant::D65,
    Illuminant::Daylight,
    Illuminant::D55,
    Illuminant::D50,
    Illuminant::Flash,
    Illuminant::D75,
    Illuminant::C,
    Illuminant::B,
    Illuminant::A,
];

/// What makes white of a grey thing, for one camera.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct WhiteBalance {
    /// Maker and model.
    pub camera: String,
    /// What red, green and blue are multiplied by; 1 for green.
    pub gains: [f32; 3],
}

/// A developed picture.
pub(super) struct Developed {
    /// Linear sRGB, row by row from the top, not negative; 1 is green's white level.
    pub rgb: Vec<[f32; 3]>,
    /// Whether each pixel is clipped.
    pub clipped: Vec<bool>,
}

/// Samples of a part of the sensor, in parts of white.
struct Samples {
    width: usize,
    height: usize,
    /// Row by row, with all channels of a pixel together.
    values: Vec<f32>,
    /// Whether each is clipped.
    clipped: Vec<bool>,
}

/// The white balance that the camera chose, or that of daylight where it says none.
pub(super) fn as_shot(image: &RawImage) -> Result<WhiteBalance, Fault> {
    let stated = [0, 1, 2].map(|c| image.wb_coeffs[c] / image.wb_coeffs[1]);
    let is_gain = |gain: &f32| *gain > 0.0 && gain.is_finite();
    let gains = if stated.iter().all(is_gain) {
        stated
    } else {
        let white = camera_from_srgb(image)? * DVec3::ONE;
        (white.y / white).to_array().map(|gain| gain as f32)
    };
    Ok(WhiteBalance {
        camera: format!("{} {}", image.make, image.model),
        gains,
    })
}

/// Where the picture lies on the sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Place {
    /// All that sees light.
    pub active: Rect,
    /// The picture, in there.
    pub picture: Rect,
    /// Where the pattern of black levels begins.
    pub origin: Point,
}

/// Develops a picture, with the white balance `white` if that is of the same camera.
pub(super) fn develop(
    image: RawImage,
    place: Place,
    white: Option<&WhiteBalance>,
) -> Result<Developed, Fault> {
    let shot = as_shot(&image)?;
    let gains = match white {
        Some(white) if white.camera == shot.camera => white.gains,
        _ => shot.gains,
    };
    let srgb_from_camera = srgb_from_camera(&image)?;
    let mut developed = match &image.photometric {
        Kind::Cfa(pattern) if image.cpp == 1 => {
            let pattern = pattern.clone();
            of_mosaic(image, place, &pattern)?
        }
        Kind::LinearRaw if image.cpp == 3 => of_linear(&image, place)?,
        _ => return Err(Fault::unknown("it has not the three colours of a picture")),
    };
    let lowest = DVec3::splat(
        gains
            .map(f64::from)
            .into_iter()
            .fold(f64::INFINITY, f64::min),
    );
    let colour = |(pixel, is_clipped): (&mut [f32; 3], &bool)| {
        let balanced = DVec3::from([0, 1, 2].map(|c| f64::from(pixel[c] * gains[c])));
        let srgb = if *is_clipped {
            let least = balanced.min(lowest);
            // What is missing of one channel would take from the others.
            (srgb_from_camera * least).min(least)
        } else {
            srgb_from_camera * balanced
        };
        // Colours outside of sRGB are not negative light.
        *pixel = srgb.to_array().map(|v| v.max(0.0) as f32);
    };
    let pixels = developed.rgb.par_iter_mut();
    pixels.zip(&developed.clipped).for_each(colour);
    Ok(developed)
}

/// The camera's RGB of a sensor with a colour filter on each sample.
fn of_mosaic(image: RawImage, place: Place, pattern: &CFAConfig) -> Result<Developed, Fault> {
    let area = grown(place.picture, place.active);
    let mut samples = samples(&image, area, place.origin)?;
    // Pictures are large: what is not needed any more goes.
    drop(image);
    let cfa = colours(&pattern.cfa, area.p, place.origin);
    cool(&mut samples, &cfa);
    let clipped = samples.reached();
    let bounds = clipped
        .par_iter()
        .enumerate()
        .filter(|(_, clipped)| **clipped);
    let bounds = bounds.map(|(i, _)| (i, samples.averaged(&cfa, i)));
    let bounds: Vec<(usize, [f32; 3])> = bounds.collect();
    let mut rgb = demosaiced(samples, pattern, &cfa)?;
    for (i, bound) in bounds {
        rgb[i] = bound;
    }
    let Rect { p, d } = place.picture;
    let first = (p.y - area.p.y) * area.d.w + p.x - area.p.x;
    let rows = || (0..d.h).map(|row| first + row * area.d.w..first + row * area.d.w + d.w);
    Ok(Developed {
        rgb: rows().flat_map(|row| rgb[row].iter().copied()).collect(),
        clipped: rows()
            .flat_map(|row| clipped[row].iter().copied())
            .collect(),
    })
}

/// The pattern of colours from `first` on. Of DNG files the decoder moves it from the corner of the active area, `origin`, on by as
/// much once more, where it should have moved it back to the sensor's; of others it begins at the sensor's corner.
fn colours(cfa: &CFA, first: Point, origin: Point) -> CFA {
    let along = |first: usize, origin: usize, side: usize| {
        (first % side + 2 * (side - origin % side)) % side
    };
    cfa.shift(
        along(first.x, origin.x, cfa.width),
        along(first.y, origin.y, cfa.height),
    )
}

/// The camera's RGB of a file that has all three colours of each pixel.
fn of_linear(image: &RawImage, place: Place) -> Result<Developed, Fault> {
    let samples = samples(image, place.picture, place.origin)?;
    let (rgb, _) = samples.values.as_chunks();
    let (clipped, _) = samples.clipped.as_chunks::<3>();
    Ok(Developed {
        rgb: rgb.to_vec(),
        clipped: clipped.iter().map(|c| c.contains(&true)).collect(),
    })
}

/// The area with a margin, where the sensor sees light.
fn grown(area: Rect, active: Rect) -> Rect {
    let before = |first: usize, least: usize| first.saturating_sub(MARGIN).max(least);
    let first = Point::new(before(area.p.x, active.p.x), before(area.p.y, active.p.y));
    let after = |end: usize, most: usize| (end + MARGIN).min(most);
    let end = Point::new(
        after(area.p.x + area.d.w, active.p.x + active.d.w),
        after(area.p.y + area.d.h, active.p.y + active.d.h),
    );
    Rect::new(first, Dim2::new(end.x - first.x, end.y - first.y))
}

/// The samples of an area, in parts of white.
fn samples(image: &RawImage, area: Rect, origin: Point) -> Result<Samples, Fault> {
    let channels = image.cpp;
    let blacks = image.blacklevel.as_vec();
    let (columns, rows) = (image.blacklevel.width, image.blacklevel.height);
    if blacks.is_empty() || blacks.len() != columns * rows * image.blacklevel.cpp {
        return Err(Fault::damaged("its black levels are incomplete"));
    }
    let whites = whites(image);
    let black = |x: usize, y: usize, channel: usize| {
        // Before the origin the pattern goes on as well.
        let column = (x + columns * origin.x.div_ceil(columns) - origin.x) % columns;
        let row = (y + rows * origin.y.div_ceil(rows) - origin.y) % rows;
        let cpp = image.blacklevel.cpp;
        blacks[(row * columns + column) * cpp + channel % cpp]
    };
    let darkest_white = whites.iter().copied().fold(f32::INFINITY, f32::min);
    if !blacks
        .iter()
        .all(|&black| black.is_finite() && black < darkest_white)
    {
        return Err(Fault::damaged(
            "its black level is not below its white level",
        ));
    }
    let count = match &image.data {
        RawImageData::Integer(all) => all.len(),
        RawImageData::Float(all) => all.len(),
    };
    if count < image.width * image.height * channels {
        return Err(Fault::damaged("it has fewer samples than pixels"));
    }
    let stored = |i: usize| match &image.data {
        RawImageData::Integer(all) => f32::from(all[i]),
        RawImageData::Float(all) => all[i],
    };
    let mut values = Vec::with_capacity(area.d.w * area.d.h * channels);
    for y in area.p.y..area.p.y + area.d.h {
        for x in area.p.x..area.p.x + area.d.w {
            for channel in 0..channels {
                let black = black(x, y, channel);
                let white = whites[channel % whites.len()];
                let sample = stored((y * image.width + x) * channels + channel);
                values.push((sample - black) / (white - black));
            }
        }
    }
    Ok(Samples {
        width: area.d.w,
        height: area.d.h,
        clipped: values.iter().map(|&v| v >= CLIPPED_FROM).collect(),
        values,
    })
}

/// White levels, one or one of each channel.
fn whites(image: &RawImage) -> Vec<f32> {
    let whites = image.whitelevel.as_vec();
    let lowest = whites.iter().copied().fold(f32::INFINITY, f32::min);
    let largest_integer = (2.0_f64.powi(image.bps.min(32) as i32) - 1.0) as f32;
    if matches!(image.data, RawImageData::Float(_)) && lowest >= largest_integer {
        // What the decoder takes where nothing is stated; but floating-point numbers end at 1 then.
        return vec![1.0];
    }
    if whites.len() == image.cpp && image.cpp > 1 {
        return whites;
    }
    vec![lowest]
}

/// Gives the samples of hot pixels what those about them of the same colour have: no lens shows such a point.
fn cool(samples: &mut Samples, cfa: &CFA) {
    let all = &samples.values;
    let mean = all.iter().map(|&v| f64::from(v)).sum::<f64>() / all.len().max(1) as f64;
    let others = |i: usize| {
        let colour = cfa.color_at(i / samples.width, i % samples.width);
        let alike = samples.alike(cfa, i, REACH, colour);
        alike.filter(move |&k| k != i).map(|k| all[k])
    };
    let is_hot = |&i: &usize| {
        let own = all[i];
        f64::from(own) > mean && others(i).all(|other| own > HOT * other)
    };
    let hot = (0..all.len()).into_par_iter().filter(is_hot);
    let hot: Vec<(usize, f32)> = hot.map(|i| (i, mean_of(others(i)))).collect();
    for (i, value) in hot {
        samples.values[i] = value;
        samples.clipped[i] = false;
    }
}

fn mean_of(values: impl Iterator<Item = f32>) -> f32 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v, count + 1.0_f32));
    sum / count.max(1.0)
}

impl Samples {
    /// Samples of a colour, up to `reach` columns and rows from one.
    fn alike(
        &self,
        cfa: &CFA,
        i: usize,
        reach: usize,
        colour: usize,
    ) -> impl Iterator<Item = usize> {
        let (width, height) = (self.width, self.height);
        let (x, y) = (i % width, i / width);
        let rows = y.saturating_sub(reach)..(y + reach + 1).min(height);
        rows.flat_map(move |row| {
            let columns = x.saturating_sub(reach)..(x + reach + 1).min(width);
            columns
                .filter(move |&column| cfa.color_at(row, column) == colour)
                .map(move |column| row * width + column)
        })
    }

    /// The camera's RGB of a pixel without what one colour tells of another, which is wrong where one of them is clipped: its own
    /// sample, and the means of the nearest of the other colours.
    fn averaged(&self, cfa: &CFA, i: usize) -> [f32; 3] {
        let own = cfa.color_at(i / self.width, i % self.width);
        [0, 1, 2].map(|colour| {
            let near = |reach: usize| self.alike(cfa, i, reach, colour).map(|k| self.values[k]);
            let near_by = near(1).next().map_or(REACH, |_| 1);
            if colour == own {
                self.values[i]
            } else {
                mean_of(near(near_by))
            }
        })
    }

    /// Whether each pixel is interpolated from a clipped sample.
    fn reached(&self) -> Vec<bool> {
        let (width, height) = (self.width, self.height);
        // Along rows first, then along columns.
        let along = |all: &[bool], at: usize, end: usize, step: usize, i: usize| {
            let low = at.saturating_sub(REACH);
            let high = (at + REACH).min(end - 1);
            (low..=high).any(|k| all[i + k * step - at * step])
        };
        let rows: Vec<bool> = (0..self.clipped.len())
            .map(|i| along(&self.clipped, i % width, width, 1, i))
            .collect();
        (0..rows.len())
            .map(|i| along(&rows, i / width, height, width, i))
            .collect()
    }
}

/// All three colours of each pixel.
fn demosaiced(samples: Samples, pattern: &CFAConfig, cfa: &CFA) -> Result<Vec<[f32; 3]>, Fault> {
    if !cfa.is_rgb() {
        return Err(Fault::unknown(
            "its sensor has other colours than red, green and blue",
        ));
    }
    let pixels = PixF32::new_with(samples.values, samples.width, samples.height);
    let all = pixels.rect();
    let rgb = match pattern.sensor {
        SensorType::Bayer => PPGDemosaic::new().demosaic(&pixels, cfa, &pattern.colors, all),
        SensorType::Xtrans => {
            XTransBilinearDemosaic::new().demosaic(&pixels, cfa, &pattern.colors, all)
        }
    };
    Ok(rgb.into_inner())
}

/// Camera's RGB from linear sRGB.
fn camera_from_srgb(image: &RawImage) -> Result<DMat3, Fault> {
    let usable = |matrix: &Vec<f32>| matrix.len() == 9 && matrix.iter().all(|v| v.is_finite());
    let known = ILLUMINANTS.iter().find_map(|illuminant| {
        let matrix = image.color_matrix.get(illuminant);
        matrix.filter(|m| usable(m)).map(|m| (*illuminant, m))
    });
    let Some((illuminant, matrix)) = known else {
        return Err(Fault::unknown("it has no colour matrix of its camera"));
    };
    let rows =
        |m: &[[f32; 3]; 3]| DMat3::from_cols_array_2d(&m.map(|row| row.map(f64::from))).transpose();
    let numbers: Vec<f64> = matrix.iter().map(|&v| f64::from(v)).collect();
    let camera_from_xyz = DMat3::from_cols_slice(&numbers).transpose();
    let adapted = rows(&bradford_adaption_matrix(&Illuminant::D65, &illuminant));
    Ok(camera_from_xyz * adapted * rows(&SRGB_TO_XYZ_D65))
}

/// Linear sRGB from a camera's RGB after white balance: what is white stays it.
fn srgb_from_camera(image: &RawImage) -> Result<DMat3, Fault> {
    let camera_from_srgb = camera_from_srgb(image)?;
    let white = camera_from_srgb * DVec3::ONE;
    let inverse = (DMat3::from_diagonal(white.recip()) * camera_from_srgb).inverse();
    if inverse.is_finite() {
        return Ok(inverse);
    }
    Err(Fault::damaged("its colour matrix makes no colours"))
}
