//! PNG pictures and animations, written row by row: display values with straight alpha, or opaque before a background.

use std::fs::File;
use std::io::{self, BufWriter, Write as _};
use std::path::Path;

use glam::Vec3;

use rekindle_base::staging::MAKER;
use rekindle_relight::Stop;

/// Rows that are encoded and compressed at once.
const ROWS: usize = 8;

/// Bits of each channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depth {
    /// 8 bits.
    Eight,
    /// 16 bits.
    Sixteen,
}

/// How linear radiance becomes the values of a PNG.
#[derive(Clone, Copy)]
pub struct Shown<'a> {
    /// Display values in [0, 1] of linear radiance that is not premultiplied.
    pub display: &'a (dyn Fn(Vec3) -> Vec3 + Sync),
    /// Display values of what stands behind the object; `None` leaves it transparent.
    pub background: Option<Vec3>,
}

impl Shown<'_> {
    fn channels(&self) -> png::ColorType {
        if self.background.is_some() {
            png::ColorType::Rgb
        } else {
            png::ColorType::Rgba
        }
    }

    /// The bytes of pixels of premultiplied radiance with their coverage.
    pub(super) fn encode(&self, rgb: &[[f32; 3]], coverage: &[f32], depth: Depth) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(8 * rgb.len());
        let mut put = |value: f32| match depth {
            Depth::Eight => bytes.push((value * 255.0 + 0.5) as u8),
            Depth::Sixteen => {
                bytes.extend_from_slice(&((value * 65535.0 + 0.5) as u16).to_be_bytes());
            }
        };
        for (&pixel, &alpha) in rgb.iter().zip(coverage) {
            let alpha = alpha.clamp(0.0, 1.0);
            let mut shown = (self.display)(Vec3::from(pixel) / alpha.max(1e-6));
            if let Some(background) = self.background {
                shown = background.lerp(shown, alpha);
            }
            shown.to_array().into_iter().for_each(&mut put);
            if self.background.is_none() {
                put(alpha);
            }
        }
        bytes
    }
}

fn to_io(error: png::EncodingError) -> io::Error {
    match error {
        png::EncodingError::IoError(source) => source,
        other => io::Error::other(other),
    }
}

fn encoder(
    path: &Path,
    [width, height]: [u32; 2],
    depth: Depth,
    shown: &Shown,
) -> io::Result<png::Encoder<'static, BufWriter<File>>> {
    let file = BufWriter::new(File::create(path)?);
    let mut encoder = png::Encoder::new(file, width, height);
    encoder.set_color(shown.channels());
    encoder.set_depth(match depth {
        Depth::Eight => png::BitDepth::Eight,
        Depth::Sixteen => png::BitDepth::Sixteen,
    });
    encoder
        .add_text_chunk("Software".to_owned(), MAKER.to_owned())
        .map_err(to_io)?;
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    Ok(encoder)
}

/// A PNG being written from the top.
pub struct PngFile<'a> {
    writer: png::StreamWriter<'static, BufWriter<File>>,
    width: usize,
    depth: Depth,
    shown: Shown<'a>,
}

impl<'a> PngFile<'a> {
    /// A file of `size` (width, height) pixels.
    pub fn create(path: &Path, size: [u32; 2], depth: Depth, shown: Shown<'a>) -> io::Result<Self> {
        let encoder = encoder(path, size, depth, &shown)?;
        let writer = encoder.write_header().map_err(to_io)?;
        Ok(Self {
            writer: writer.into_stream_writer().map_err(to_io)?,
            width: size[0] as usize,
            depth,
            shown,
        })
    }

    /// Writes whole rows of premultiplied radiance with their coverage. Fails soon after `stop` says so.
    pub fn rows(&mut self, rgb: &[[f32; 3]], coverage: &[f32], stop: Stop) -> io::Result<()> {
        let some = (ROWS * self.width).max(1);
        for (rgb, coverage) in rgb.chunks(some).zip(coverage.chunks(some)) {
            if stop() {
                return Err(io::Error::other("stopped"));
            }
            let bytes = self.shown.encode(rgb, coverage, self.depth);
            self.writer.write_all(&bytes)?;
        }
        Ok(())
    }

    /// Ends the file, which must have all its rows.
    pub fn finish(self) -> io::Result<()> {
        self.writer.finish().map_err(to_io)
    }
}

/// An animated PNG being written: frames of 8 bits that are shown over and over.
pub(super) struct Animation {
    writer: png::Writer<BufWriter<File>>,
}

impl Animation {
    pub(super) fn create(
        path: &Path,
        size: [u32; 2],
        frames: u32,
        frames_per_second: u16,
        shown: &Shown,
    ) -> io::Result<Self> {
        let mut encoder = encoder(path, size, Depth::Eight, shown)?;
        encoder.set_animated(frames, 0).map_err(to_io)?;
        encoder
            .set_frame_delay(1, frames_per_second.max(1))
            .map_err(to_io)?;
        Ok(Self {
            writer: encoder.write_header().map_err(to_io)?,
        })
    }

    pub(super) fn frame(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.writer.write_image_data(bytes).map_err(to_io)
    }

    pub(super) fn finish(self) -> io::Result<()> {
        self.writer.finish().map_err(to_io)
    }
}
