//! Pictures and textures as EXR files, 32-bit float, lossless.

use std::io;
use std::path::Path;

use exr::prelude::*;

fn to_io(error: exr::error::Error) -> io::Error {
    match error {
        exr::error::Error::Io(source) => source,
        other => io::Error::other(other.to_string()),
    }
}

fn encoding() -> Encoding {
    // Of the lossless methods the fastest at nearly the size of the best, for textures with empty parts.
    Encoding {
        compression: Compression::ZIP1,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    }
}

/// Writes RGB, row by row from the top.
pub fn write_rgb(path: &Path, width: u32, rgb: &[[f32; 3]]) -> io::Result<()> {
    let width = width as usize;
    let channels = SpecificChannels::rgb(|at: Vec2<usize>| {
        let [r, g, b] = rgb[at.1 * width + at.0];
        (r, g, b)
    });
    Image::from_encoded_channels((width, rgb.len() / width.max(1)), encoding(), channels)
        .write()
        .to_file(path)
        .map_err(to_io)
}

/// Writes RGBA, row by row from the top; RGB is premultiplied by alpha.
pub fn write_rgba(path: &Path, width: u32, rgb: &[[f32; 3]], alpha: &[f32]) -> io::Result<()> {
    let width = width as usize;
    let channels = SpecificChannels::rgba(|at: Vec2<usize>| {
        let [r, g, b] = rgb[at.1 * width + at.0];
        (r, g, b, alpha[at.1 * width + at.0])
    });
    Image::from_encoded_channels((width, rgb.len() / width.max(1)), encoding(), channels)
        .write()
        .to_file(path)
        .map_err(to_io)
}

/// Writes one channel, Y, row by row from the top.
pub fn write_gray(path: &Path, width: u32, values: &[f32]) -> io::Result<()> {
    let width = width as usize;
    let channels = SpecificChannels::build()
        .with_channel("Y")
        .with_pixel_fn(|at: Vec2<usize>| (values[at.1 * width + at.0],));
    Image::from_encoded_channels((width, values.len() / width.max(1)), encoding(), channels)
        .write()
        .to_file(path)
        .map_err(to_io)
}

/// Checks that a file has the stated size before memory is taken for what its header announces.
fn check_header(path: &Path, width: u32, height: u32) -> std::result::Result<(), String> {
    let meta = MetaData::read_from_file(path, false).map_err(|e| e.to_string())?;
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
    .map_err(|e| e.to_string())?;
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
        .map_err(|e| e.to_string())?;
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
}
