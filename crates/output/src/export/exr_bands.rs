//! OpenEXR pictures with any channels, 32-bit float, written in bands of rows.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;

use exr::block::chunk::Chunk;
use exr::block::writer::ChunksWriter as _;
use exr::block::{BlockIndex, UncompressedBlock};
use exr::meta::BlockDescription;
use exr::meta::attribute::{ChannelDescription, SampleType, Text};
use exr::meta::header::Header;
use exr::prelude::{Compression, LineOrder, Vec2};
use rayon::prelude::*;

use rekindle_base::staging::MAKER;
use rekindle_relight::Stop;

/// Takes the next rows of a picture: for each channel its values, row by row.
pub(super) type Sink<'a> = dyn FnMut(&[Vec<f32>]) -> io::Result<()> + 'a;

fn to_io(error: exr::error::Error) -> io::Error {
    match error {
        exr::error::Error::Io(source) => source,
        other => io::Error::other(other.to_string()),
    }
}

/// Writes a picture of `size` (width, height) pixels. `channels` are in alphabetical order, and `produce` gives their values
/// to the sink from the top, in whole rows. Fails soon after `stop` says so.
pub(super) fn write(
    path: &Path,
    [width, height]: [u32; 2],
    channels: &[String],
    stop: Stop,
    produce: impl FnOnce(&mut Sink) -> io::Result<()>,
) -> io::Result<()> {
    let names = channels.iter().map(|name| {
        let name = Text::new_or_none(name).ok_or_else(|| io::Error::other("a channel's name"))?;
        Ok(ChannelDescription::named(name, SampleType::F32))
    });
    let names = names.collect::<io::Result<_>>()?;
    let width = width as usize;
    let mut header = Header::new(Text::default(), (width, height as usize), names).with_encoding(
        Compression::ZIP1,
        BlockDescription::ScanLines,
        LineOrder::Increasing,
    );
    header.own_attributes.software_name = Text::new_or_none(MAKER);
    let file = BufWriter::new(File::create(path)?);
    let headers = [header.clone()];
    let mut next = 0;
    exr::block::write(
        file,
        std::iter::once(header).collect(),
        true,
        |_, writer| {
            let mut sink = |planes: &[Vec<f32>]| {
                let rows = planes.first().map_or(0, |p| p.len() / width.max(1));
                // A row is a block: what is compressed at once is small, so that a stop is heard.
                let chunks: Vec<Chunk> = (0..rows)
                    .into_par_iter()
                    .map(|row| {
                        if stop() {
                            return Err(io::Error::other("stopped"));
                        }
                        let index = BlockIndex {
                            layer: 0,
                            pixel_position: Vec2(0, next + row),
                            pixel_size: Vec2(width, 1),
                            level: Vec2(0, 0),
                        };
                        let data = line(planes, width, row);
                        let block = UncompressedBlock { index, data };
                        block.compress_to_chunk(&headers).map_err(to_io)
                    })
                    .collect::<io::Result<_>>()?;
                for chunk in chunks {
                    writer.write_chunk(next, chunk).map_err(to_io)?;
                    next += 1;
                }
                Ok(())
            };
            produce(&mut sink).map_err(exr::error::Error::Io)
        },
    )
    .map_err(to_io)
}

/// The bytes of a row: channel by channel.
fn line(planes: &[Vec<f32>], width: usize, row: usize) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(4 * planes.len() * width);
    for plane in planes {
        for value in &plane[row * width..(row + 1) * width] {
            bytes.extend_from_slice(&value.to_ne_bytes());
        }
    }
    bytes
}
