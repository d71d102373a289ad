//! The textures as pictures that browsers decode: diffuse radiance and pseudo-albedo as JPEG, sRGB-encoded up to a largest value;
//! gloss as PNG, whose steps must stay as they are.

use std::io;

use glam::{Vec2, Vec3, Vec4};
use image::codecs::jpeg::JpegEncoder;
use rayon::prelude::*;
use serde_json::{Value, json};

use super::page::Page;
use rekindle_relight::srgb;
use rekindle_scene::reflectance::Gloss;
use rekindle_scene::surface::Atlas;
use rekindle_solution::Solution;

/// Quality of JPEG pictures, of 100.
const QUALITY: u8 = 92;
/// Texels of a texture in the page; a solution with more gets a coarser one.
const MOST_TEXELS: f32 = 4.2e6;
/// Part of the texels that may be brighter than the largest value that is kept.
const CLIPPED: f32 = 2e-4;
/// Roughness of a part, as a multiple of the main lobe's, whose logarithm is stored as 0.
const LEAST_ROUGHNESS: f32 = 0.01;

/// The object's textures.
pub(super) struct Textures {
    /// Texture coordinates of each triangle's corners, in [0, 1], v downwards.
    pub(super) corner_uvs: Vec<[Vec2; 3]>,
    diffuse: Encoded,
    albedo: Encoded,
    gloss: Option<GlossPicture>,
}

/// Colours as a JPEG file.
struct Encoded {
    file: Vec<u8>,
    /// The value that white stands for.
    scale: f32,
}

/// Gloss as a PNG file: the strength of each channel, and in alpha their mean times the logarithm of roughness.
struct GlossPicture {
    file: Vec<u8>,
    /// The values that the largest bytes stand for.
    scales: [f32; 4],
}

impl Textures {
    /// The textures of a solution.
    pub(super) fn new(solution: &Solution) -> io::Result<Self> {
        let layout = Layout::new(solution);
        let texture = |texels: &[[f32; 3]]| {
            let colours = layout.colours(
                |texel| Vec3::from(texels[texel]),
                |triangle, barycentric| solution.atlas.sample(texels, triangle, barycentric),
            );
            encode(&layout, colours)
        };
        let gloss = (solution.gloss.as_ref()).map(|gloss| {
            let code = |gloss: Gloss| {
                let log = (gloss.roughness / LEAST_ROUGHNESS).ln().max(0.0);
                gloss.scale().extend(log * gloss.strength)
            };
            let texels = layout.colours(
                |texel| code(gloss.texels()[texel]),
                |triangle, barycentric| code(gloss.at(&solution.atlas, triangle, barycentric)),
            );
            encode_gloss(layout.size, &texels)
        });
        let [width, height] = layout.size.map(|side| side as f32);
        let uvs = layout.atlas().corner_uvs.iter();
        Ok(Self {
            corner_uvs: uvs
                .map(|corners| corners.map(|at| at / Vec2::new(width, height)))
                .collect(),
            diffuse: texture(&solution.diffuse)?,
            albedo: texture(&solution.albedo)?,
            gloss: gloss.transpose()?,
        })
    }

    /// Puts the pictures into the page; what it has to know of them. `white` is the unit of radiance.
    pub(super) fn put(&self, white: f32, page: &mut Page) -> Value {
        page.put("diffuse", "image/jpeg", &self.diffuse.file);
        page.put("albedo", "image/jpeg", &self.albedo.file);
        if let Some(gloss) = &self.gloss {
            page.put("gloss", "image/png", &gloss.file);
        }
        json!({
            "diffuse": self.diffuse.scale / white,
            "albedo": self.albedo.scale,
            "gloss": self.gloss.as_ref().map(|gloss| gloss.scales),
        })
    }
}

/// Where the page's texels lie: as in the solution, or further apart where these are many.
struct Layout<'a> {
    solution: &'a Solution,
    /// Its own, where it isn't the solution's.
    coarser: Option<Atlas>,
    size: [u32; 2],
    /// Per texel, whether it shows the surface.
    known: Vec<bool>,
}

impl<'a> Layout<'a> {
    fn new(solution: &'a Solution) -> Self {
        let own = &solution.atlas;
        if own.width as f32 * own.height as f32 <= MOST_TEXELS {
            return Self {
                solution,
                coarser: None,
                size: [own.width, own.height],
                known: solution.albedo.iter().map(|a| *a != [0.0; 3]).collect(),
            };
        }
        let mesh = &solution.mesh;
        let area: f64 = (0..mesh.triangles.len() as u32)
            .map(|t| {
                let [a, b, c] = mesh.corners(t);
                0.5 * f64::from((b - a).cross(c - a).length())
            })
            .sum();
        let density = (f64::from(MOST_TEXELS) / area.max(f64::MIN_POSITIVE)).sqrt() as f32;
        let coarser = Atlas::lattice(mesh, &vec![density; mesh.triangles.len()]);
        let mut known = vec![false; coarser.len()];
        for texel in &coarser.texels {
            known[texel.index as usize] = true;
        }
        Self {
            solution,
            size: [coarser.width, coarser.height],
            coarser: Some(coarser),
            known,
        }
    }

    fn atlas(&self) -> &Atlas {
        self.coarser.as_ref().unwrap_or(&self.solution.atlas)
    }

    /// The value of each texel, from that of a texel of the solution or of a point of the mesh; black where there is no surface.
    fn colours<T: Copy + Default + Send>(
        &self,
        own: impl Fn(usize) -> T + Sync + Send,
        at: impl Fn(u32, Vec2) -> T + Sync,
    ) -> Vec<T> {
        let Some(atlas) = &self.coarser else {
            return (0..self.known.len()).into_par_iter().map(own).collect();
        };
        let mut all = vec![T::default(); atlas.len()];
        let values: Vec<T> = (atlas.texels.par_iter())
            .map(|texel| at(texel.triangle, texel.barycentric))
            .collect();
        for (texel, value) in atlas.texels.iter().zip(values) {
            all[texel.index as usize] = value;
        }
        all
    }
}

/// Colours as JPEG. Texels without surface take the colours around them, which cost least.
fn encode(layout: &Layout, colours: Vec<Vec3>) -> io::Result<Encoded> {
    let known = colours.iter().zip(&layout.known).filter(|(_, k)| **k);
    let mut values: Vec<f32> = known.map(|(colour, _)| colour.max_element()).collect();
    let scale = if values.is_empty() {
        1.0
    } else {
        let at = ((values.len() - 1) as f32 * (1.0 - CLIPPED)) as usize;
        let (_, value, _) = values.select_nth_unstable_by(at, f32::total_cmp);
        value.max(f32::MIN_POSITIVE)
    };
    let [width, height] = layout.size;
    let codes: Vec<Vec3> = (colours.into_par_iter())
        .map(|colour| srgb(colour / scale))
        .collect();
    let filled = filled([width as usize, height as usize], codes, &layout.known);
    let bytes: Vec<u8> = (filled.iter())
        .flat_map(|colour| colour.to_array().map(byte))
        .collect();
    let mut file = Vec::new();
    JpegEncoder::new_with_quality(&mut file, QUALITY)
        .encode(&bytes, width, height, image::ExtendedColorType::Rgb8)
        .map_err(io::Error::other)?;
    Ok(Encoded { file, scale })
}

fn encode_gloss([width, height]: [u32; 2], texels: &[Vec4]) -> io::Result<GlossPicture> {
    let largest = texels.iter().copied().fold(Vec4::splat(1e-6), Vec4::max);
    // Equal strengths in all channels are coded alike.
    let strongest = Vec3::splat(largest.truncate().max_element());
    let largest = strongest.extend(largest.w);
    let bytes: Vec<u8> = (texels.iter())
        .flat_map(|&texel| (texel / largest).to_array().map(byte))
        .collect();
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(png::ColorType::Rgba);
    let mut writer = encoder.write_header().map_err(io::Error::other)?;
    writer.write_image_data(&bytes).map_err(io::Error::other)?;
    writer.finish().map_err(io::Error::other)?;
    Ok(GlossPicture {
        file,
        scales: largest.to_array(),
    })
}

/// Eight bits of a value from 0 to 1.
fn byte(value: f32) -> u8 {
    (255.0 * value.clamp(0.0, 1.0)).round() as u8
}

/// A picture whose unknown pixels have the mean of the known ones around them, from ever coarser pictures (pull-push, Gortler et
/// al. 1996).
fn filled([width, height]: [usize; 2], mut colours: Vec<Vec3>, known: &[bool]) -> Vec<Vec3> {
    if known.iter().all(|k| *k) || width * height <= 1 {
        return colours;
    }
    let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
    let mut sums = vec![(Vec3::ZERO, 0.0_f32); half_width * half_height];
    for (i, colour) in colours.iter().enumerate().filter(|(i, _)| known[*i]) {
        let coarse = &mut sums[i / width / 2 * half_width + i % width / 2];
        *coarse = (coarse.0 + colour, coarse.1 + 1.0);
    }
    let coarse_known: Vec<bool> = sums.iter().map(|sum| sum.1 > 0.0).collect();
    let means = sums.iter().map(|sum| sum.0 / sum.1.max(1.0)).collect();
    let coarse = filled([half_width, half_height], means, &coarse_known);
    for (i, colour) in colours.iter_mut().enumerate().filter(|(i, _)| !known[*i]) {
        *colour = coarse[i / width / 2 * half_width + i % width / 2];
    }
    colours
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_take_the_colours_beside_them_and_known_texels_stay() {
        let size = [13, 7];
        let mut colours = vec![Vec3::ZERO; 13 * 7];
        let mut known = vec![false; colours.len()];
        for (at, colour) in [(0, Vec3::X), (1, Vec3::X), (90, Vec3::Z)] {
            (colours[at], known[at]) = (colour, true);
        }
        let all = filled(size, colours, &known);
        assert_eq!((all[0], all[1], all[90]), (Vec3::X, Vec3::X, Vec3::Z));
        assert_eq!((all[14], all[89]), (Vec3::X, Vec3::Z));
        assert!(all.iter().all(|c| (c.element_sum() - 1.0).abs() < 1e-5));
    }
}
