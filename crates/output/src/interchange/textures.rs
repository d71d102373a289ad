//! Pictures in files: the light as EXR and Radiance HDR, the base colour as EXR and PNG.

use std::io;
use std::path::Path;

use glam::Vec3;

use super::asset::Asset;
use super::gauge::Material;
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
    let bytes: Vec<u8> = asset
        .base_colour
        .iter()
        .flat_map(|&c| srgb(Vec3::from(c)).to_array().map(code))
        .collect();
    png(asset, png::ColorType::Rgb, &bytes)
}

/// Roughness √α of each texel as a grey PNG file, linear.
pub fn roughness_png(asset: &Asset) -> io::Result<Vec<u8>> {
    let bytes: Vec<u8> = texels(asset)
        .map(|k| code(asset.material_at(k).roughness()))
        .collect();
    png(asset, png::ColorType::Grayscale, &bytes)
}

/// Reflectance of each texel at normal incidence as a part of the strongest's, as a linear PNG file: grey, or RGB where parts reflect in
/// different colours.
pub fn specular_png(asset: &Asset) -> io::Result<Vec<u8>> {
    if !asset.is_coloured() {
        let bytes: Vec<u8> = specular_levels(asset).map(code).collect();
        return png(asset, png::ColorType::Grayscale, &bytes);
    }
    let levels = specular_levels(asset).zip(specular_colours(asset));
    let bytes: Vec<u8> = levels
        .flat_map(|(level, colour)| (level * colour).to_array().map(code))
        .collect();
    png(asset, png::ColorType::Rgb, &bytes)
}

/// What each texel reflects of each channel beside the one of which it reflects most, as an RGB PNG file, sRGB.
pub fn specular_colour_png(asset: &Asset) -> io::Result<Vec<u8>> {
    let bytes: Vec<u8> = specular_colours(asset)
        .flat_map(|colour| srgb(colour).to_array().map(code))
        .collect();
    png(asset, png::ColorType::Rgb, &bytes)
}

/// The same as linear EXR.
pub fn write_specular_colour(path: &Path, asset: &Asset) -> io::Result<()> {
    let colours: Vec<[f32; 3]> = specular_colours(asset).map(|c| c.to_array()).collect();
    write_rgb(path, asset.texture_width, &colours)
}

/// Both as glTF has them, linear: roughness in green, no metal in blue, the specular level in alpha.
pub fn gltf_gloss_png(asset: &Asset) -> io::Result<Vec<u8>> {
    let levels = texels(asset).zip(specular_levels(asset));
    let bytes: Vec<u8> = levels
        .flat_map(|(k, level)| [255, code(asset.material_at(k).roughness()), 0, code(level)])
        .collect();
    png(asset, png::ColorType::Rgba, &bytes)
}

/// Both as linear EXR: roughness in red, the specular level in green.
pub fn write_gloss(path: &Path, asset: &Asset) -> io::Result<()> {
    let levels = texels(asset).zip(specular_levels(asset));
    let pixels: Vec<[f32; 3]> = levels
        .map(|(k, level)| [asset.material_at(k).roughness(), level, 0.0])
        .collect();
    write_rgb(path, asset.texture_width, &pixels)
}

/// Where the part of this index is, as a white mask.
pub fn mask_png(asset: &Asset, part: usize) -> io::Result<Vec<u8>> {
    let own = asset.nearest_parts();
    let bytes: Vec<u8> = own.iter().map(|&k| code(f32::from(k == part))).collect();
    png(asset, png::ColorType::Grayscale, &bytes)
}

fn texels(asset: &Asset) -> std::ops::Range<usize> {
    0..asset.base_colour.len()
}

fn specular_levels(asset: &Asset) -> impl Iterator<Item = f32> {
    let strongest = asset.strongest().f0.max(f32::MIN_POSITIVE);
    texels(asset).map(move |k| (asset.material_at(k).f0 / strongest).min(1.0))
}

fn specular_colours(asset: &Asset) -> impl Iterator<Item = Vec3> {
    texels(asset).map(move |k| asset.material_at(k).colour)
}

/// Eight bits of a value from 0 to 1.
fn code(v: f32) -> u8 {
    (255.0 * v).round() as u8
}

/// A PNG file's bytes, of the texture's size.
fn png(asset: &Asset, colours: png::ColorType, bytes: &[u8]) -> io::Result<Vec<u8>> {
    let width = asset.texture_width;
    let height = asset.base_colour.len() as u32 / width.max(1);
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(colours);
    encoder
        .add_text_chunk("Software".to_owned(), MAKER.to_owned())
        .map_err(io::Error::other)?;
    let mut writer = encoder.write_header().map_err(io::Error::other)?;
    writer.write_image_data(bytes).map_err(io::Error::other)?;
    writer.finish().map_err(io::Error::other)?;
    Ok(file)
}

/// The base colour times a factor of the material there as the linear texture of an EXR file.
pub fn write_base_colour(
    path: &Path,
    asset: &Asset,
    factor: impl Fn(&Material) -> f32,
) -> io::Result<()> {
    let factors: Vec<f32> = (asset.parts.iter())
        .map(|part| factor(&part.material))
        .collect();
    let parts = asset.nearest_parts();
    let scaled: Vec<[f32; 3]> = (asset.base_colour.iter().zip(parts))
        .map(|(c, part)| c.map(|v| (v * factors[part]).clamp(0.0, 1.0)))
        .collect();
    write_rgb(path, asset.texture_width, &scaled)
}
