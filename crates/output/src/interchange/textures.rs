//! Pictures in files: the light as EXR and Radiance HDR, the base colour as EXR and PNG.

use std::io;
use std::path::Path;

use glam::Vec3;

use super::asset::Asset;
use rekindle_base::staging::MAKER;
use rekindle_relight::srgb;
use rekindle_scene::hemisphere::Picture;
use rekindle_solution::write_rgb;

/// Writes a map as 32-bit float EXR.
pub fn write_exr(path: &Path, picture: &Picture) -> io::Result<()> {
    write_rgb(path, picture.width, &picture.radiance)
}

/// Writes a map as Radiance HDR, whose steps are about one per cent.
pub fn write_hdr(path: &Path, picture: &Picture) -> io::Result<()> {
    let pixels: Vec<image::Rgb<f32>> = picture.radiance.iter().map(|&p| image::Rgb(p)).collect();
    let file = io::BufWriter::new(std::fs::File::create(path)?);
    image::codecs::hdr::HdrEncoder::new(file)
        .encode(&pixels, picture.width as usize, picture.height as usize)
        .map_err(io::Error::other)
}

/// The base colour as the bytes of a PNG file: 8-bit sRGB, cut at 1.
pub fn base_colour_png(asset: &Asset) -> io::Result<Vec<u8>> {
    let width = asset.texture_width;
    let height = asset.base_colour.len() as u32 / width.max(1);
    let code = |v: f32| (255.0 * v).round() as u8;
    let bytes: Vec<u8> = asset
        .base_colour
        .iter()
        .flat_map(|&c| srgb(Vec3::from(c)).to_array().map(code))
        .collect();
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder
        .add_text_chunk("Software".to_owned(), MAKER.to_owned())
        .map_err(io::Error::other)?;
    let mut writer = encoder.write_header().map_err(io::Error::other)?;
    writer.write_image_data(&bytes).map_err(io::Error::other)?;
    writer.finish().map_err(io::Error::other)?;
    Ok(file)
}

/// The base colour times a factor as the linear texture of an EXR file.
pub fn write_base_colour(path: &Path, asset: &Asset, factor: f32) -> io::Result<()> {
    let scaled: Vec<[f32; 3]> = asset
        .base_colour
        .iter()
        .map(|c| c.map(|v| (v * factor).clamp(0.0, 1.0)))
        .collect();
    write_rgb(path, asset.texture_width, &scaled)
}
