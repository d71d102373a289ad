//! The directories of raw files that are laid out as TIFF, as most are, looked at before they are decoded: the decoder takes what
//! they announce, however much memory that asks for, and goes round in circles where they do.

use std::path::Path;

use crate::error::CaptureError;
use crate::picture::{COPY_AGAIN, broken, check_pixels, check_samples};

/// Marks after the two letters of the byte order: TIFF's own, Panasonic's and Olympus' two.
const MARKS: [u16; 4] = [42, 0x55, 0x5352, 0x4f52];

/// Directories in a row; files have a handful.
const MOST_DIRECTORIES: usize = 64;

/// Bytes that an entry may announce whatever the length of its file, as entries without meaning do in some cameras' files.
const FREE_BYTES: u64 = 1 << 28;

/// Entries that lead to directories: pictures below others, EXIF data, places.
const BELOW: [u16; 3] = [330, 34_665, 34_853];

/// Entries of sizes: of the picture, of the tiles that it is stored in, and how many numbers a pixel has.
const WIDTH: u16 = 256;
const HEIGHT: u16 = 257;
const TILE_WIDTH: u16 = 322;
const TILE_HEIGHT: u16 = 323;
const CHANNELS: u16 = 277;

/// Powers of two that are the bytes of numbers of each type; of unknown ones, bytes.
const SHIFTS: [u32; 13] = [0, 0, 0, 1, 2, 3, 0, 0, 1, 2, 3, 2, 3];

struct Tiff<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    is_big_endian: bool,
}

/// What one directory says.
#[derive(Default)]
struct Directory {
    /// Places of directories below.
    below: Vec<usize>,
    /// Place of the next one, zero for none.
    next: usize,
    /// First value of each entry of sizes that is there.
    sizes: Vec<(u16, u64)>,
}

/// Refuses directories that no camera writes. Files that are not laid out as TIFF have none.
pub(super) fn check(path: &Path, bytes: &[u8]) -> Result<(), CaptureError> {
    let is_big_endian = match bytes.get(..2) {
        Some(b"II") => false,
        Some(b"MM") => true,
        _ => return Ok(()),
    };
    let tiff = Tiff {
        path,
        bytes,
        is_big_endian,
    };
    if !tiff.short(2).is_some_and(|mark| MARKS.contains(&mark)) {
        return Ok(());
    }
    let mut seen = Vec::new();
    let mut at = tiff.long(4).unwrap_or(0);
    while at != 0 {
        if seen.contains(&at) || seen.len() == MOST_DIRECTORIES {
            return Err(tiff.damaged("its directories have no end"));
        }
        seen.push(at);
        let directory = tiff.directory(at)?;
        for &below in &directory.below {
            tiff.directory(below)?;
        }
        at = directory.next;
    }
    Ok(())
}

impl Tiff<'_> {
    fn short(&self, at: usize) -> Option<u16> {
        let bytes = self.bytes.get(at..)?.first_chunk()?;
        let [read, turned] = [u16::from_le_bytes(*bytes), u16::from_be_bytes(*bytes)];
        Some(if self.is_big_endian { turned } else { read })
    }

    fn long(&self, at: usize) -> Option<usize> {
        let bytes = self.bytes.get(at..)?.first_chunk()?;
        let [read, turned] = [u32::from_le_bytes(*bytes), u32::from_be_bytes(*bytes)];
        Some(if self.is_big_endian { turned } else { read } as usize)
    }

    fn damaged(&self, problem: &str) -> CaptureError {
        broken(self.path, format!("it is damaged: {problem}"), COPY_AGAIN)
    }

    /// Reads a directory and checks its entries; one that the file has not has none.
    fn directory(&self, at: usize) -> Result<Directory, CaptureError> {
        let mut directory = Directory::default();
        let count = usize::from(self.short(at).unwrap_or(0));
        for entry in (0..count).map(|i| at + 2 + 12 * i) {
            let (Some(tag), Some(kind), Some(count)) = (
                self.short(entry),
                self.short(entry + 2),
                self.long(entry + 4),
            ) else {
                return Ok(directory);
            };
            let shift = SHIFTS.get(usize::from(kind)).copied().unwrap_or(0);
            let size = (count as u64) << shift;
            if size > FREE_BYTES.max(self.bytes.len() as u64) {
                return Err(self.damaged("an entry of its directory is longer than the file"));
            }
            let place = match self.long(entry + 8) {
                Some(place) if size > 4 => place,
                _ => entry + 8,
            };
            let value = |i: usize| match shift {
                1 => self.short(place + 2 * i).map(usize::from),
                _ => self.long(place + 4 * i),
            };
            if BELOW.contains(&tag) {
                let places = (0..count.min(MOST_DIRECTORIES)).filter_map(value);
                directory.below.extend(places);
            } else if [WIDTH, HEIGHT, TILE_WIDTH, TILE_HEIGHT, CHANNELS].contains(&tag) {
                directory
                    .sizes
                    .push((tag, value(0).unwrap_or_default() as u64));
            }
        }
        directory.next = self.long(at + 2 + 12 * count).unwrap_or(0);
        self.check_size(&directory)?;
        Ok(directory)
    }

    /// Refuses pictures that are too large, also in the whole tiles that they are decoded in.
    fn check_size(&self, directory: &Directory) -> Result<(), CaptureError> {
        let stated = |tag: u16| {
            let found = directory.sizes.iter().find(|(other, _)| *other == tag);
            found.map(|(_, size)| *size)
        };
        let (Some(width), Some(height)) = (stated(WIDTH), stated(HEIGHT)) else {
            return Ok(());
        };
        let whole = |side: u64, tile: Option<u64>| match tile {
            Some(tile @ 1..) => side.div_ceil(tile).saturating_mul(tile),
            _ => side,
        };
        let [width, height] = [
            whole(width, stated(TILE_WIDTH)).max(1),
            whole(height, stated(TILE_HEIGHT)).max(1),
        ];
        check_pixels(self.path, width, height)?;
        let channels = stated(CHANNELS).unwrap_or(1);
        check_samples(self.path, self.bytes, width * height * channels)
    }
}
