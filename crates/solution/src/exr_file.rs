//! Pictures and textures as EXR files, lossless: as half floats where all numbers are such, else as 32-bit floats.

use std::io::{self, BufReader};
use std::path::Path;

use exr::prelude::*;

use rekindle_base::files;
use rekindle_base::staging::MAKER;
use rekindle_capture::exr_problem;

/// More texels than a byte of a compressed file can hold.
const TEXELS_PER_BYTE: u64 = 8_192;

fn to_io(error: exr::error::Error) -> io::Error {
    match error {
        exr::error::Error::Io(source) => source,
        other => io::Error::other(other.to_string()),
    }
}

fn encoding() -> Encoding {
    // Of the lossless methods the fastest: deflate makes textures a quarter to a third smaller, and took three times as long.
    Encoding {
        compression: Compression::RLE,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    }
}

/// Writes RGB, row by row from the top.
pub fn write_rgb(path: &Path, width: u32, rgb: &[[f32; 3]]) -> io::Result<()> {
    write(path, width, rgb_planes(rgb))
}

/// Writes RGBA, row by row from the top; RGB is premultiplied by alpha.
pub fn write_rgba(path: &Path, width: u32, rgb: &[[f32; 3]], alpha: &[f32]) -> io::Result<()> {
    let mut planes = rgb_planes(rgb);
    planes.push(("A", alpha.to_vec()));
    write(path, width, planes)
}

/// Writes one channel, Y, row by row from the top.
pub fn write_gray(path: &Path, width: u32, values: &[f32]) -> io::Result<()> {
    write(path, width, vec![("Y", values.to_vec())])
}

fn rgb_planes(rgb: &[[f32; 3]]) -> Vec<(&'static str, Vec<f32>)> {
    let plane = |c: usize| rgb.iter().map(|pixel| pixel[c]).collect();
    vec![("R", plane(0)), ("G", plane(1)), ("B", plane(2))]
}

fn write(path: &Path, width: u32, planes: Vec<(&str, Vec<f32>)>) -> io::Result<()> {
    let count = planes.first().map_or(0, |(_, values)| values.len());
    let halves = planes.iter().all(|(_, values)| are_halves(values));
    let channels = planes
        .into_iter()
        .map(|(name, values)| {
            let samples = if halves {
                FlatSamples::F16(values.into_iter().map(f16::from_f32).collect())
            } else {
                FlatSamples::F32(values)
            };
            AnyChannel::new(name, samples)
        })
        .collect();
    let width = width as usize;
    let mut image = Image::from_encoded_channels(
        (width, count / width.max(1)),
        encoding(),
        AnyChannels::sort(channels),
    );
    image.layer_data.attributes.software_name = Text::new_or_none(MAKER);
    image.write().non_parallel().to_file(path).map_err(to_io)
}

/// Whether half floats hold these numbers exactly.
fn are_halves(values: &[f32]) -> bool {
    values
        .iter()
        .all(|&v| f16::from_f32(v).to_f32().to_bits() == v.to_bits())
}

/// Checks that a file has the stated size before memory is taken for what its header announces.
fn check_header(path: &Path, width: u32, height: u32) -> std::result::Result<(), String> {
    let meta = {
        let file = files::open(path).map_err(|e| format!("it can't be read: {e}"))?;
        MetaData::read_from_buffered(BufReader::new(file), false).map_err(|e| exr_problem(&e))?
    };
    let length = std::fs::metadata(path).map_err(|e| e.to_string())?.len();
    let texels = u64::from(width) * u64::from(height);
    if texels > TEXELS_PER_BYTE * length {
        return Err(format!("{length} bytes can't hold {width}×{height} texels"));
    }
    for header in &meta.headers {
        let size = header.layer_size;
        if (size.x(), size.y()) != (width as usize, height as usize) {
            return Err(format!(
                "it is {}×{}, expected {width}×{height}",
                size.x(),
                size.y()
            ));
        }
    }
    Ok(())
}

/// Reads RGB of the stated size; the error says what is wrong with the file.
pub fn read_rgb(
    path: &Path,
    width: u32,
    height: u32,
) -> std::result::Result<Vec<[f32; 3]>, String> {
    check_header(path, width, height)?;
    let picture = read_first_rgba_layer_from_file(
        path,
        |size, _| (size.0, vec![[0.0_f32; 3]; size.0 * size.1]),
        |(width, pixels), at, (r, g, b, _): (f32, f32, f32, f32)| {
            pixels[at.1 * *width + at.0] = [r, g, b];
        },
    )
    .map_err(|e| exr_problem(&e))?;
    let (_, pixels) = picture.layer_data.channel_data.pixels;
    if pixels.iter().flatten().all(|v| v.is_finite()) {
        Ok(pixels)
    } else {
        Err("it has values that are not finite".to_owned())
    }
}

/// Reads one channel, Y, of the stated size; the error says what is wrong with the file.
pub fn read_gray(path: &Path, width: u32, height: u32) -> std::result::Result<Vec<f32>, String> {
    check_header(path, width, height)?;
    let picture = read()
        .no_deep_data()
        .largest_resolution_level()
        .specific_channels()
        .required("Y")
        .collect_pixels(
            |size, _| (size.0, vec![0.0_f32; size.0 * size.1]),
            |(width, pixels), at, (y,): (f32,)| pixels[at.1 * *width + at.0] = y,
        )
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .map_err(|e| exr_problem(&e))?;
    let (_, pixels) = picture.layer_data.channel_data.pixels;
    if pixels.iter().all(|v| v.is_finite()) {
        Ok(pixels)
    } else {
        Err("it has values that are not finite".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn textures_come_back_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let rgb: Vec<[f32; 3]> = (0..12).map(|i| [i as f32 * 0.1, 1e-30, 1e30]).collect();
        write_rgb(&path, 4, &rgb).unwrap();
        assert_eq!(read_rgb(&path, 4, 3).unwrap(), rgb);
        assert!(read_rgb(&path, 3, 4).unwrap_err().contains("expected 3×4"));
        let gray: Vec<f32> = (0..12).map(|i| i as f32 / 7.0).collect();
        write_gray(&path, 4, &gray).unwrap();
        assert_eq!(read_gray(&path, 4, 3).unwrap(), gray);
    }

    #[test]
    fn what_halves_hold_is_written_as_halves() {
        let folder = tempfile::tempdir().unwrap();
        let size = |name: &str, value: f32| {
            let path = folder.path().join(name);
            // Numbers that don't compress.
            let rgb: Vec<[f32; 3]> = (0..4096_u32)
                .map(|i| {
                    let bits = i.wrapping_mul(2_654_435_761) >> 20;
                    [(1024 + bits % 1024) as f32 * value; 3]
                })
                .collect();
            write_rgb(&path, 64, &rgb).unwrap();
            assert_eq!(read_rgb(&path, 64, 64).unwrap(), rgb, "{name}");
            std::fs::metadata(&path).unwrap().len()
        };
        let (half, float) = (size("half.exr", 0.25), size("float.exr", 0.1));
        assert!(half < float, "{half} bytes as halves, {float} as floats");
        size("too_large.exr", 100.0);
        size("too_small.exr", 1e-9);
    }
}
