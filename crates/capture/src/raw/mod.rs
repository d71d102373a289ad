//! Camera raw files: what the sensor measured, developed to linear radiance.
//!
//! `rawler` knows the formats and cameras. It gives samples, levels, white balance, colour matrix and the part of the sensor that
//! the picture is; `develop` makes a picture of these. It may panic and take memory without end where files are damaged: `guard`
//! and `directory` see to it that this comes to an error.

mod develop;
mod directory;
#[cfg(test)]
mod dng;
mod guard;
#[cfg(test)]
mod tests;

use std::path::Path;
use std::sync::Arc;

use image::metadata::Orientation;
use rawler::decoders::{Decoder, FormatHint, RawDecodeParams, RawMetadata, WellKnownIFD};
use rawler::formats::tiff::IFD;
use rawler::imgop::{Dim2, Point, Rect};
use rawler::rawsource::RawSource;
use rawler::tags::{DngTag, TiffCommonTag};
use rawler::{RawImage, RawlerError};

use crate::error::CaptureError;
use crate::picture::{
    COPY_AGAIN, CheckSize, Encoding, Picture, broken, check_pixels, orientation_for, size_after,
};
use develop::{Developed, Place};
use guard::guarded;

pub(crate) use develop::WhiteBalance;

/// Endings of raw files, those of cameras in the order of their makers.
pub(crate) const ENDINGS: [&str; 10] = [
    "dng", "cr2", "cr3", "nef", "nrw", "arw", "raf", "rw2", "orf", "pef",
];

/// Advice where the file is sound but not understood.
const CONVERT: &str = "convert it to DNG, or develop it to a linear 16-bit TIFF";

/// Pixels along each side at least; what interpolates colours looks that far.
const LEAST_SIDE: usize = 16;

/// What is wrong with a file, without its name.
pub(crate) struct Fault {
    problem: String,
    advice: &'static str,
}

impl Fault {
    fn damaged(problem: &str) -> Self {
        Self {
            problem: problem.to_owned(),
            advice: COPY_AGAIN,
        }
    }

    fn unknown(problem: &str) -> Self {
        Self {
            problem: problem.to_owned(),
            advice: CONVERT,
        }
    }

    fn of(self, path: &Path) -> CaptureError {
        broken(path, self.problem, self.advice)
    }
}

impl From<RawlerError> for Fault {
    fn from(error: RawlerError) -> Self {
        match error {
            RawlerError::Unsupported { make, model, .. } if !make.is_empty() => Self::unknown(
                &format!("raw files of the camera {make} {model} are not understood here"),
            ),
            RawlerError::Unsupported { .. } => {
                Self::unknown("it is no raw file, or of an unknown camera")
            }
            RawlerError::DecoderFailed(what)
                if ["EOF", "Eof", "too short"]
                    .iter()
                    .any(|end| what.contains(end)) =>
            {
                Self::damaged("the file ends too early")
            }
            RawlerError::DecoderFailed(what) => {
                let line = what.lines().next().unwrap_or_default();
                Self::damaged(&format!("the decoder of raw files says: {line}"))
            }
        }
    }
}

/// A raw file whose headers are read.
struct Opened {
    source: RawSource,
    decoder: Box<dyn Decoder>,
    place: Place,
    orientation: Orientation,
}

/// Whether a file's ending says that it is raw.
pub(crate) fn is_raw(path: &Path) -> bool {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str()))
}

/// Develops the bytes of the raw file `path`, `turned` as its orientation says, with the white balance `white` if that is of the same
/// camera and else its own. `check_size` may refuse its width and height before the samples are decoded.
pub(crate) fn read(
    path: &Path,
    bytes: Vec<u8>,
    turned: bool,
    white: Option<&WhiteBalance>,
    check_size: CheckSize,
) -> Result<Picture, CaptureError> {
    let opened = open(path, bytes)?;
    let area = opened.place.picture.d;
    let stored = (area.w as u32, area.h as u32);
    let stated = if turned {
        opened.orientation
    } else {
        Orientation::NoTransforms
    };
    let orientation = orientation_for(stored, stated, check_size)?;
    let develop = move || {
        let image = opened.decode(false)?;
        develop::develop(image, opened.place, white)
    };
    let Developed { rgb, clipped } = attempt(path, develop)?;
    let (width, height) = size_after(stored, orientation);
    Ok(Picture {
        width,
        height,
        rgb: oriented(rgb, stored, orientation),
        alpha: None,
        saturated: oriented(clipped, stored, orientation),
        encoding: Encoding::Raw,
        codes: None,
    })
}

/// Width and height of the picture of a raw file, from its header.
pub(crate) fn read_size(path: &Path, bytes: Vec<u8>) -> Result<(u32, u32), CaptureError> {
    let opened = open(path, bytes)?;
    let area = opened.place.picture.d;
    Ok(size_after(
        (area.w as u32, area.h as u32),
        opened.orientation,
    ))
}

/// The white balance of the first of these files that is raw. Views of one camera share it, as they share the light: what a camera
/// chooses differs from view to view, and the sensor's own samples know nothing of it.
pub(crate) fn white_balance<'a>(mut paths: impl Iterator<Item = &'a Path>) -> Option<WhiteBalance> {
    let path = paths.find(|path| is_raw(path))?;
    let bytes = rekindle_base::files::read(path).ok()?;
    let opened = open(path, bytes).ok()?;
    guarded(move || develop::as_shot(&opened.decode(true)?)).and_then(Result::ok)
}

/// What a raw file says of how it was taken.
pub(crate) fn metadata(path: &Path, bytes: Vec<u8>) -> Option<RawMetadata> {
    directory::check(path, &bytes).ok()?;
    let source = RawSource::new_from_shared_vec(Arc::new(bytes));
    guarded(|| {
        let decoder = rawler::get_decoder(&source).ok()?;
        decoder
            .raw_metadata(&source, &RawDecodeParams::default())
            .ok()
    })?
}

/// What `work` gives; where it panics, the file is damaged.
fn attempt<T: Send>(
    path: &Path,
    work: impl FnOnce() -> Result<T, Fault> + Send,
) -> Result<T, CaptureError> {
    let done = guarded(work).unwrap_or_else(|| {
        Err(Fault::damaged(
            "it is damaged, or of a kind that is not understood here",
        ))
    });
    done.map_err(|fault| fault.of(path))
}

/// Reads the headers of a raw file.
fn open(path: &Path, bytes: Vec<u8>) -> Result<Opened, CaptureError> {
    directory::check(path, &bytes)?;
    let source = RawSource::new_from_shared_vec(Arc::new(bytes));
    let (opened, full) = attempt(path, move || {
        let decoder = rawler::get_decoder(&source)?;
        let params = RawDecodeParams::default();
        let metadata = decoder.raw_metadata(&source, &params).ok();
        let turned = metadata.and_then(|metadata| metadata.exif.orientation);
        let mut opened = Opened {
            source,
            decoder,
            place: Place::default(),
            orientation: turned
                .and_then(|code| Orientation::from_exif(code.try_into().ok()?))
                .unwrap_or(Orientation::NoTransforms),
        };
        let (place, full) = match opened.decoder.ifd(WellKnownIFD::Raw)? {
            Some(raw) if opened.decoder.format_hint() == FormatHint::DNG => dng_place(&raw),
            _ => place(&opened.decode(true)?),
        };
        opened.place = place;
        Ok((opened, full))
    })?;
    check_pixels(path, full.w as u64, full.h as u64)?;
    let within = |inner: Rect, outer: Rect| {
        let end = |first: usize, length: usize| first.checked_add(length);
        let fits = |first: usize, length: usize, least: usize, most: usize| {
            first >= least && end(first, length) <= end(least, most)
        };
        fits(inner.p.x, inner.d.w, outer.p.x, outer.d.w)
            && fits(inner.p.y, inner.d.h, outer.p.y, outer.d.h)
    };
    let Place {
        active, picture, ..
    } = opened.place;
    if !within(active, Rect::new(Point::zero(), full)) || !within(picture, active) {
        let problem = "its picture lies outside of its sensor";
        return Err(Fault::damaged(problem).of(path));
    }
    if picture.d.w.min(picture.d.h) < LEAST_SIDE {
        return Err(Fault::damaged("it has hardly any pixels").of(path));
    }
    Ok(opened)
}

impl Opened {
    /// The sensor's samples, or only what there is to say of them.
    fn decode(&self, is_header: bool) -> Result<RawImage, Fault> {
        let params = RawDecodeParams::default();
        let image = self.decoder.raw_image(&self.source, &params, is_header)?;
        if !matches!(image.cpp, 1 | 3) || image.fuji_rotation_width.is_some() {
            return Err(Fault::unknown("its sensor has an unusual layout"));
        }
        Ok(image)
    }
}

/// Where the picture is on the sensor, and the sensor's size.
fn place(image: &RawImage) -> (Place, Dim2) {
    let full = image.dim();
    let active = image.active_area.unwrap_or(Rect::new(Point::zero(), full));
    let picture = image.crop_area.unwrap_or(active);
    // Some cameras' pictures reach beyond what is said to see light.
    let active = if picture.p.x < active.p.x || picture.p.y < active.p.y {
        Rect::new(Point::zero(), full)
    } else {
        active
    };
    let origin = Point::zero();
    (
        Place {
            active,
            picture,
            origin,
        },
        full,
    )
}

/// The same of a DNG file, by its directory: the decoder would decode all of it. Black levels repeat from the active area on.
fn dng_place(raw: &IFD) -> (Place, Dim2) {
    let numbers = |tag: DngTag| {
        let entry = raw.get_entry(tag)?;
        Some(move |i: usize| entry.force_usize(i))
    };
    let side = |tag: TiffCommonTag| raw.get_entry(tag).map_or(0, |entry| entry.force_usize(0));
    let full = Dim2::new(
        side(TiffCommonTag::ImageWidth),
        side(TiffCommonTag::ImageLength),
    );
    let active = numbers(DngTag::ActiveArea).map_or(Rect::new(Point::zero(), full), |edge| {
        let [top, left, bottom, right] = [0, 1, 2, 3].map(edge);
        let size = Dim2::new(right.saturating_sub(left), bottom.saturating_sub(top));
        Rect::new(Point::new(left, top), size)
    });
    let crop = numbers(DngTag::DefaultCropOrigin).zip(numbers(DngTag::DefaultCropSize));
    let picture = crop.map_or(active, |(first, size)| {
        let first = Point::new(
            active.p.x.saturating_add(first(0)),
            active.p.y.saturating_add(first(1)),
        );
        Rect::new(first, Dim2::new(size(0), size(1)))
    });
    let origin = active.p;
    (
        Place {
            active,
            picture,
            origin,
        },
        full,
    )
}

/// Pixels of a picture of the size `stored`, turned.
fn oriented<T: Copy>(pixels: Vec<T>, stored: (u32, u32), orientation: Orientation) -> Vec<T> {
    if orientation == Orientation::NoTransforms {
        return pixels;
    }
    let (width, height) = (stored.0 as usize, stored.1 as usize);
    let (columns, rows) = size_after(stored, orientation);
    let (right, bottom) = (width - 1, height - 1);
    let from = |x: usize, y: usize| match orientation {
        Orientation::NoTransforms => (x, y),
        Orientation::FlipHorizontal => (right - x, y),
        Orientation::Rotate180 => (right - x, bottom - y),
        Orientation::FlipVertical => (x, bottom - y),
        Orientation::Rotate90FlipH => (y, x),
        Orientation::Rotate90 => (y, bottom - x),
        Orientation::Rotate270FlipH => (right - y, bottom - x),
        Orientation::Rotate270 => (right - y, x),
    };
    let places = (0..rows as usize).flat_map(|y| (0..columns as usize).map(move |x| (x, y)));
    let turned = places.map(|(x, y)| {
        let (column, row) = from(x, y);
        pixels[row * width + column]
    });
    turned.collect()
}
