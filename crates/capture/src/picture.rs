//! Image files as linear radiance.
//!
//! * EXR: linear, premultiplied; the layer with plain R, G, B is preferred; the data window is placed in the
//!   display window.
//! * Radiance HDR, floating-point TIFF: linear.
//! * All of these: pixels on a plateau at the largest value are saturated.
//! * 16-bit PNG and TIFF: taken as linear. 8-bit PNG, TIFF and JPEG: decoded by the sRGB curve. Full scale is 1,
//!   and pixels at full scale in any channel are saturated: they say only "at least this much". Alpha in
//!   these files is straight and RGB gets multiplied by it after decoding. Their codes are kept, for brackets may tell
//!   of another curve.
//! * Camera raw files, by their ending: what the sensor measured, as `raw` develops it. The white level is 1, and saturated
//!   there.
//!
//! Pictures are turned as their EXIF orientation says, unless only the picture as stored has the size that it should have,
//! or its camera comes from COLMAP, which looks at pixels as they are stored.

use super::brackets::srgb_to_linear;
use super::clipping::mark_clipped;
use super::error::CaptureError;
use super::raw::{self, WhiteBalance};
use exr::meta::header::Header;
use exr::prelude::{FlatImage, FlatSamples, MetaData, ReadChannels, ReadLayers};
use half::slice::HalfFloatSliceExt;
use image::metadata::Orientation;
use image::{ColorType as C, DynamicImage, ImageDecoder, ImageReader};
use rayon::prelude::*;
use rekindle_base::files;
use std::io::{BufRead, BufReader, Cursor, Seek};
use std::ops::Range;
use std::path::Path;

/// Most pixels an image may have: beyond any camera, and small enough to fit in memory.
pub(super) const MAX_PIXELS: u64 = 256_000_000;

/// Numbers that a file may announce whatever its length, and those for each of its bytes: what deflate makes of nothing but
/// white, one bit a pixel.
const FREE_SAMPLES: u64 = 24_000_000;
const SAMPLES_PER_BYTE: u64 = 8_192;

/// Largest finite half float, where renderers and cameras clamp.
const HALF_MAX: f32 = 65_504.0;

/// How every EXR file starts.
const EXR_MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// Advice for files that end too early.
pub(super) const COPY_AGAIN: &str = "copy or export it anew";

/// What may refuse a picture by its width and height, before its pixels are decoded.
pub(super) type CheckSize<'a> = &'a dyn Fn((u32, u32)) -> Result<(), CaptureError>;

/// How values were stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    /// Linear floating point.
    Float,
    /// 16 bits, linear, clipped at full scale.
    Linear16,
    /// 8 bits, sRGB-encoded, clipped at full scale.
    Srgb8,
    /// A sensor's own, linear, clipped at its white level.
    Raw,
}

/// A decoded image.
#[derive(Debug)]
pub(super) struct Picture {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Linear RGB premultiplied by alpha, as stored otherwise: may be negative or not finite.
    pub rgb: Vec<[f32; 3]>,
    /// Alpha, if the file has a channel for it.
    pub alpha: Option<Vec<f32>>,
    /// Whether each pixel is clipped.
    pub saturated: Vec<bool>,
    /// How values were stored.
    pub encoding: Encoding,
    /// Straight RGB as stored in 8 or 16 bits.
    pub codes: Option<Codes>,
}

/// Integers that a file stores, as the decoder gives them.
#[derive(Debug)]
pub(super) enum Codes {
    /// Of 8 bits, so many to a pixel, colour first.
    Eight(Vec<u8>, usize),
    /// Of 16 bits, the same.
    Sixteen(Vec<u16>, usize),
}

impl Codes {
    /// Red, green and blue of a pixel on a scale of 16 bits.
    #[inline]
    pub(super) fn at(&self, pixel: usize) -> [u16; 3] {
        match self {
            Self::Eight(values, channels) => {
                [0, 1, 2].map(|c| u16::from(values[pixel * channels + c]) * 257)
            }
            Self::Sixteen(values, channels) => [0, 1, 2].map(|c| values[pixel * channels + c]),
        }
    }
}

/// Which pixels of a picture are kept.
pub(super) struct Mask {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Whether each pixel is white.
    pub white: Vec<bool>,
}

impl Mask {
    /// Reads an image file that `field` of the manifest names, `turned` as its orientation says.
    pub(super) fn read(path: &Path, field: &str, turned: bool) -> Result<Self, CaptureError> {
        let bytes = read_file(path, field)?;
        let any_size = |_| Ok(());
        if !bytes.starts_with(&EXR_MAGIC) {
            let image = decode_common(path, &bytes, turned, &any_size)?;
            if let C::L8 | C::Rgb8 = image.color() {
                let (width, height) = (image.width(), image.height());
                let table: Vec<bool> = (0..=255).map(|code| is_white(srgb_code(code))).collect();
                let channels = usize::from(image.color().channel_count());
                let pixels = image.as_bytes().chunks_exact(channels);
                let brightest = |pixel: &[u8]| pixel.iter().fold(0, |most, &code| most.max(code));
                return Ok(Self {
                    width,
                    height,
                    white: pixels.map(|p| table[usize::from(brightest(p))]).collect(),
                });
            }
        }
        let picture = Picture::decode(path, &bytes, turned, &any_size)?;
        let brightest = |[r, g, b]: &[f32; 3]| r.max(*g).max(*b);
        Ok(Self {
            width: picture.width,
            height: picture.height,
            white: (picture.rgb.iter())
                .map(|pixel| is_white(brightest(pixel)))
                .collect(),
        })
    }
}

/// Whether a mask keeps a pixel whose largest channel is this.
fn is_white(largest: f32) -> bool {
    // Half of full scale in sRGB code values, 0.214 in linear light.
    largest > 0.2
}

/// What a code of 8 bits stands for.
fn srgb_code(code: u8) -> f32 {
    srgb_to_linear(f32::from(code) / 255.0)
}

impl Picture {
    /// Reads an image file that `field` of the manifest names, `turned` as its orientation says, one of the camera that `white` is
    /// for with that white balance. `check_size` may refuse its width and height before the pixels are decoded.
    pub(super) fn read(
        path: &Path,
        field: &str,
        turned: bool,
        white: Option<&WhiteBalance>,
        check_size: CheckSize,
    ) -> Result<Self, CaptureError> {
        let bytes = read_file(path, field)?;
        if raw::is_raw(path) {
            return raw::read(path, bytes, turned, white, check_size);
        }
        Self::decode(path, &bytes, turned, check_size)
    }

    /// Decodes the bytes of the image file `path`, which is none of a camera's raw files.
    pub(super) fn decode(
        path: &Path,
        bytes: &[u8],
        turned: bool,
        check_size: CheckSize,
    ) -> Result<Self, CaptureError> {
        let mut picture = if bytes.starts_with(&EXR_MAGIC) {
            read_exr(path, bytes, check_size)?
        } else {
            read_common(path, bytes, turned, check_size)?
        };
        if picture.encoding == Encoding::Float {
            mark_clipped(&picture.rgb, &mut picture.saturated);
        }
        Ok(picture)
    }
}

/// Width and height of an image file, from its header.
pub(super) fn read_size(path: &Path, field: &str) -> Result<(u32, u32), CaptureError> {
    let unreadable = |source| CaptureError::Unreadable {
        path: path.to_owned(),
        source,
    };
    check_there(path, field)?;
    if raw::is_raw(path) {
        return raw::read_size(path, read_file(path, field)?);
    }
    let mut file = BufReader::new(files::open(path).map_err(unreadable)?);
    if file.fill_buf().map_err(unreadable)?.starts_with(&EXR_MAGIC) {
        let meta = MetaData::read_from_buffered(file, false)
            .map_err(|error| broken(path, exr_problem(&error), COPY_AGAIN))?;
        let window = display_size(path, meta.headers.first())?;
        return Ok((window.0 as u32, window.1 as u32));
    }
    let mut decoder = common_decoder(path, file)?;
    let size = decoder.dimensions();
    Ok(size_after(
        size,
        decoder.orientation().unwrap_or(Orientation::NoTransforms),
    ))
}

fn check_there(path: &Path, field: &str) -> Result<(), CaptureError> {
    if path.exists() {
        return Ok(());
    }
    Err(CaptureError::ImageMissing {
        path: path.to_owned(),
        field: field.to_owned(),
    })
}

fn read_file(path: &Path, field: &str) -> Result<Vec<u8>, CaptureError> {
    check_there(path, field)?;
    files::read(path).map_err(|source| CaptureError::Unreadable {
        path: path.to_owned(),
        source,
    })
}

/// What the decoder of EXR files says, in words for those who do not know its parts.
pub fn exr_problem(error: &exr::error::Error) -> String {
    match error {
        exr::error::Error::Io(source) => format!("it can't be read: {source}"),
        exr::error::Error::NotSupported(what) => {
            format!("it holds what is not understood here ({what})")
        }
        exr::error::Error::Invalid(what) if what.contains("missing bytes") => {
            "the file ends too early".to_owned()
        }
        exr::error::Error::Invalid(what) => format!("the file is damaged ({what})"),
        exr::error::Error::Aborted => "reading it was stopped".to_owned(),
    }
}

pub(super) fn broken(path: &Path, problem: impl Into<String>, advice: &str) -> CaptureError {
    CaptureError::ImageBroken {
        path: path.to_owned(),
        problem: problem.into(),
        advice: advice.to_owned(),
    }
}

/// Refuses sizes that no real image has, before memory is allocated for them.
pub(super) fn check_pixels(path: &Path, width: u64, height: u64) -> Result<(), CaptureError> {
    if width == 0 || height == 0 {
        return Err(broken(path, "it has no pixels", COPY_AGAIN));
    }
    if width.saturating_mul(height) > MAX_PIXELS {
        return Err(CaptureError::ImageTooLarge {
            path: path.to_owned(),
            width,
            height,
            limit: MAX_PIXELS / 1_000_000,
        });
    }
    Ok(())
}

/// Refuses more samples, in all channels and parts, than a file of so many bytes can hold.
pub(super) fn check_samples(path: &Path, bytes: &[u8], samples: u64) -> Result<(), CaptureError> {
    if samples <= FREE_SAMPLES.saturating_add(SAMPLES_PER_BYTE * bytes.len() as u64) {
        return Ok(());
    }
    let problem = format!(
        "its header announces {} million numbers, more than its {} bytes can hold",
        samples / 1_000_000,
        bytes.len()
    );
    Err(broken(path, problem, COPY_AGAIN))
}

/// The numbers that an EXR file announces: those stored, and the picture of `size` that they are placed in.
fn exr_samples(headers: &[Header], size: (usize, usize)) -> u64 {
    let stored = headers.iter().map(|header| {
        let pixels = header.layer_size.x() as u64 * header.layer_size.y() as u64;
        pixels.saturating_mul(header.channels.list.len() as u64)
    });
    let picture = 4 * size.0 as u64 * size.1 as u64;
    stored.fold(picture, u64::saturating_add)
}

/// Width and height of the display window of an EXR header.
fn display_size(path: &Path, header: Option<&Header>) -> Result<(usize, usize), CaptureError> {
    let header = header.ok_or_else(|| broken(path, "it holds no image", COPY_AGAIN))?;
    let size = header.shared_attributes.display_window.size;
    check_pixels(path, size.x() as u64, size.y() as u64)?;
    check_pixels(
        path,
        header.layer_size.x() as u64,
        header.layer_size.y() as u64,
    )?;
    Ok((size.x(), size.y()))
}

/// The channels of one EXR part that make up the picture: indices of R, G, B and perhaps A.
struct Layer {
    part: usize,
    rgb: [usize; 3],
    alpha: Option<usize>,
    /// Smaller is preferred.
    rank: usize,
}

/// Finds the best layer: plain R, G, B first, then the combined or beauty pass, then the first there is.
fn find_layer(headers: &[Header]) -> Option<Layer> {
    let mut best: Option<Layer> = None;
    for (part, header) in headers
        .iter()
        .enumerate()
        .filter(|(_, header)| !header.deep)
    {
        let names: Vec<String> = header
            .channels
            .list
            .iter()
            .map(|c| c.name.to_string())
            .collect();
        let find = |name: String| {
            names
                .iter()
                .position(|other| other.eq_ignore_ascii_case(&name))
        };
        for prefix in names.iter().filter_map(|name| {
            let stem = name.strip_suffix('R').or_else(|| name.strip_suffix('r'))?;
            (stem.is_empty() || stem.ends_with('.')).then_some(stem)
        }) {
            let channel = |letter: &str| find(format!("{prefix}{letter}"));
            let (Some(r), Some(g), Some(b)) = (channel("R"), channel("G"), channel("B")) else {
                continue;
            };
            let lower = prefix.to_lowercase();
            let rank = if prefix.is_empty() {
                0
            } else if ["combined", "beauty", "rgba", "color", "colour"]
                .iter()
                .any(|word| lower.contains(word))
            {
                1
            } else {
                2
            };
            if best.as_ref().is_none_or(|best| rank < best.rank) {
                best = Some(Layer {
                    part,
                    rgb: [r, g, b],
                    alpha: channel("A"),
                    rank,
                });
            }
        }
    }
    best
}

fn read_exr(path: &Path, bytes: &[u8], check_size: CheckSize) -> Result<Picture, CaptureError> {
    let damaged = |error: exr::error::Error| broken(path, exr_problem(&error), COPY_AGAIN);
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(damaged)?;
    let Some(layer) = find_layer(&meta.headers) else {
        let names: Vec<String> = meta
            .headers
            .iter()
            .flat_map(|header| header.channels.list.iter().map(|c| c.name.to_string()))
            .take(20)
            .collect();
        return Err(CaptureError::ImageChannels {
            path: path.to_owned(),
            channels: if names.is_empty() {
                "none".to_owned()
            } else {
                names.join(", ")
            },
        });
    };
    for header in &meta.headers {
        display_size(path, Some(header))?;
    }
    let header = &meta.headers[layer.part];
    let size = display_size(path, Some(header))?;
    check_samples(path, bytes, exr_samples(&meta.headers, size))?;
    check_size((size.0 as u32, size.1 as u32))?;
    let wanted = layer.rgb.iter().chain(&layer.alpha);
    if wanted
        .map(|&i| header.channels.list[i].sampling)
        .any(|s| s.x() != 1 || s.y() != 1)
    {
        return Err(broken(
            path,
            "its channels are subsampled",
            "save it as plain RGB",
        ));
    }
    let image: FlatImage = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(damaged)?;
    let part = image
        .layer_data
        .get(layer.part)
        .ok_or_else(|| broken(path, "a part is missing", COPY_AGAIN))?;
    let channels = &part.channel_data.list;
    let offset =
        header.own_attributes.layer_position - header.shared_attributes.display_window.position;
    let place = Placement {
        data_width: part.size.x(),
        data_height: part.size.y(),
        offset: (i64::from(offset.x()), i64::from(offset.y())),
        size,
    };
    let mut rgb = vec![[0.0; 3]; size.0 * size.1];
    let mut saturated = vec![false; rgb.len()];
    for (c, &index) in layer.rgb.iter().enumerate() {
        let samples = &channels[index].sample_data;
        let limit = match samples {
            FlatSamples::F16(_) => HALF_MAX,
            FlatSamples::F32(_) | FlatSamples::U32(_) => f32::INFINITY,
        };
        place.each_row(samples, |first, values| {
            let pixels = rgb[first..].iter_mut().zip(&mut saturated[first..]);
            for ((pixel, saturated), &value) in pixels.zip(values) {
                pixel[c] = value;
                *saturated |= value >= limit;
            }
        });
    }
    let alpha = layer.alpha.map(|index| {
        let mut alpha = vec![0.0; rgb.len()];
        place.each_row(&channels[index].sample_data, |first, values| {
            alpha[first..][..values.len()].copy_from_slice(values);
        });
        alpha
    });
    Ok(Picture {
        width: size.0 as u32,
        height: size.1 as u32,
        rgb,
        alpha,
        saturated,
        encoding: Encoding::Float,
        codes: None,
    })
}

/// Where a data window lies in the display window.
struct Placement {
    data_width: usize,
    data_height: usize,
    offset: (i64, i64),
    size: (usize, usize),
}

impl Placement {
    /// Calls `set` for every row of samples inside the display window, with the row's first pixel there and its values.
    fn each_row(&self, samples: &FlatSamples, mut set: impl FnMut(usize, &[f32])) {
        let (width, height) = self.size;
        let columns = inside(self.offset.0, self.data_width, width);
        if columns.is_empty() {
            return;
        }
        let mut values = vec![0.0; columns.len()];
        for y in inside(self.offset.1, self.data_height, height) {
            let start = y * self.data_width;
            let stored = start + columns.start..start + columns.end;
            match samples {
                FlatSamples::F16(all) => all[stored].convert_to_f32_slice(&mut values),
                FlatSamples::F32(all) => values.copy_from_slice(&all[stored]),
                FlatSamples::U32(all) => {
                    for (to, &from) in values.iter_mut().zip(&all[stored]) {
                        *to = from as f32;
                    }
                }
            }
            let row = (y as i64 + self.offset.1) as usize;
            let column = (columns.start as i64 + self.offset.0) as usize;
            set(row * width + column, &values);
        }
    }
}

/// The part of `0..data` that lies, moved by `offset`, in `0..display`.
fn inside(offset: i64, data: usize, display: usize) -> Range<usize> {
    let clamped = |end: i64| end.clamp(0, data as i64) as usize;
    clamped(-offset)..clamped(display as i64 - offset)
}

/// Decoder of a file that is not EXR, with limits on what its header may ask for.
fn common_decoder<'a>(
    path: &Path,
    bytes: impl BufRead + Seek + 'a,
) -> Result<impl ImageDecoder + 'a, CaptureError> {
    const KNOWN: &str = "use EXR, Radiance HDR, TIFF, PNG, JPEG or a camera's raw file";
    let mut reader = ImageReader::new(bytes)
        .with_guessed_format()
        .map_err(|error| broken(path, error.to_string(), COPY_AGAIN))?;
    if reader.format().is_none() {
        return Err(broken(path, "its format is not known", KNOWN));
    }
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(MAX_PIXELS * 16);
    reader.limits(limits);
    reader.into_decoder().map_err(|error| {
        let advice = if matches!(error, image::ImageError::Unsupported(_)) {
            KNOWN
        } else {
            COPY_AGAIN
        };
        broken(path, error.to_string(), advice)
    })
}

/// Width and height after turning.
pub(super) fn size_after((width, height): (u32, u32), orientation: Orientation) -> (u32, u32) {
    match orientation {
        Orientation::Rotate90
        | Orientation::Rotate270
        | Orientation::Rotate90FlipH
        | Orientation::Rotate270FlipH => (height, width),
        _ => (width, height),
    }
}

/// How a picture is turned: as its orientation says, unless it should only have the size that it has as it is stored.
pub(super) fn orientation_for(
    stored: (u32, u32),
    stated: Orientation,
    check_size: CheckSize,
) -> Result<Orientation, CaptureError> {
    let Err(error) = check_size(size_after(stored, stated)) else {
        return Ok(stated);
    };
    if check_size(stored).is_err() {
        return Err(error);
    }
    Ok(Orientation::NoTransforms)
}

fn read_common(
    path: &Path,
    bytes: &[u8],
    turned: bool,
    check_size: CheckSize,
) -> Result<Picture, CaptureError> {
    let image = decode_common(path, bytes, turned, check_size)?;
    let (width, height) = (image.width(), image.height());
    // JPEG's quantisation moves clipped pixels down by a code or so.
    let full = if is_jpeg(bytes) { 253 } else { 255 };
    let Decoded {
        encoding,
        rgb,
        alpha,
        saturated,
        codes,
    } = decode(image, full);
    Ok(Picture {
        width,
        height,
        rgb,
        alpha,
        saturated,
        encoding,
        codes,
    })
}

/// The pixels of a file that is not EXR, as stored, turned if asked for.
fn decode_common(
    path: &Path,
    bytes: &[u8],
    turned: bool,
    check_size: CheckSize,
) -> Result<DynamicImage, CaptureError> {
    let mut decoder = common_decoder(path, Cursor::new(bytes))?;
    let stored = decoder.dimensions();
    check_pixels(path, u64::from(stored.0), u64::from(stored.1))?;
    let channels = u64::from(decoder.color_type().channel_count());
    check_samples(
        path,
        bytes,
        channels * u64::from(stored.0) * u64::from(stored.1),
    )?;
    let stated = if turned {
        decoder.orientation().unwrap_or(Orientation::NoTransforms)
    } else {
        Orientation::NoTransforms
    };
    let orientation = orientation_for(stored, stated, check_size)?;
    let mut image = DynamicImage::from_decoder(decoder)
        .map_err(|error| broken(path, error.to_string(), COPY_AGAIN))?;
    image.apply_orientation(orientation);
    if is_jpeg(bytes) && !jpeg_ends(bytes) {
        return Err(broken(path, "the file ends too early", COPY_AGAIN));
    }
    Ok(image)
}

fn is_jpeg(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0xff, 0xd8])
}

/// Whether a JPEG file has its end-of-image marker; decoders fill up truncated files with grey.
fn jpeg_ends(bytes: &[u8]) -> bool {
    let mut at = 2;
    while let Some(&[0xff, marker]) = bytes.get(at..at + 2) {
        match marker {
            0xd9 => return true,
            0xff => at += 1,
            _ => {
                let Some(&[high, low]) = bytes.get(at + 2..at + 4) else {
                    return false;
                };
                at += 2 + usize::from(u16::from_be_bytes([high, low]));
                if marker == 0xda {
                    // Coded data: up to the next marker that is neither a stuffed zero nor a restart.
                    let rest = bytes.get(at..).unwrap_or_default();
                    let next = rest
                        .windows(2)
                        .position(|p| p[0] == 0xff && !matches!(p[1], 0x00 | 0xd0..=0xd7 | 0xff));
                    at += next.unwrap_or(rest.len());
                }
            }
        }
    }
    false
}

/// The pixels of a file.
struct Decoded {
    encoding: Encoding,
    /// Linear, premultiplied.
    rgb: Vec<[f32; 3]>,
    alpha: Option<Vec<f32>>,
    saturated: Vec<bool>,
    codes: Option<Codes>,
}

/// Values of an image as radiance; in files of 8 bits codes from `full` on are clipped.
fn decode(image: DynamicImage, full: u8) -> Decoded {
    let has_alpha = image.color().has_alpha();
    match image.color() {
        C::L8 | C::La8 | C::Rgb8 | C::Rgba8 => {
            let table: Vec<f32> = (0..=255).map(srgb_code).collect();
            let (values, channels) = if has_alpha {
                (image.into_rgba8().into_raw(), 4)
            } else {
                (image.into_rgb8().into_raw(), 3)
            };
            let value = |code: u8| table[usize::from(code)];
            let share = |code: u8| f32::from(code) / 255.0;
            Decoded {
                encoding: Encoding::Srgb8,
                rgb: premultiplied(&values, channels, value, share),
                alpha: has_alpha.then(|| alpha(&values, share)),
                saturated: clipped(&values, channels, full),
                codes: Some(Codes::Eight(values, channels)),
            }
        }
        C::L16 | C::La16 | C::Rgb16 | C::Rgba16 => {
            let (values, channels) = if has_alpha {
                (image.into_rgba16().into_raw(), 4)
            } else {
                (image.into_rgb16().into_raw(), 3)
            };
            let share = |code: u16| f32::from(code) / 65_535.0;
            Decoded {
                encoding: Encoding::Linear16,
                rgb: premultiplied(&values, channels, share, share),
                alpha: has_alpha.then(|| alpha(&values, share)),
                saturated: clipped(&values, channels, u16::MAX),
                codes: Some(Codes::Sixteen(values, channels)),
            }
        }
        _ => {
            let values = image.into_rgba32f().into_raw();
            let same = |value: f32| value;
            Decoded {
                encoding: Encoding::Float,
                saturated: vec![false; values.len() / 4],
                rgb: premultiplied(&values, 4, same, same),
                alpha: has_alpha.then(|| alpha(&values, same)),
                codes: None,
            }
        }
    }
}

/// Colours times the alpha in the fourth channel, if there is one.
fn premultiplied<T: Copy + Sync>(
    values: &[T],
    channels: usize,
    colour: impl Fn(T) -> f32 + Sync,
    share: impl Fn(T) -> f32 + Sync,
) -> Vec<[f32; 3]> {
    let pixels = values.par_chunks_exact(channels);
    let pixel = |p: &[T]| {
        let rgb = [p[0], p[1], p[2]].map(&colour);
        (p.get(3)).map_or(rgb, |&a| rgb.map(|v| v * share(a)))
    };
    pixels.map(pixel).collect()
}

/// The fourth channel of four.
fn alpha<T: Copy + Sync>(values: &[T], share: impl Fn(T) -> f32 + Sync) -> Vec<f32> {
    values.par_chunks_exact(4).map(|p| share(p[3])).collect()
}

/// Whether a colour of each pixel is at full scale.
fn clipped<T: Copy + Ord + Sync>(values: &[T], channels: usize, full: T) -> Vec<bool> {
    let pixels = values.par_chunks_exact(channels);
    pixels.map(|p| p[0].max(p[1]).max(p[2]) >= full).collect()
}
