//! Merging a bracket of exposures to one radiance image on a scale shared by all views.
//!
//! A linear pixel value Z of a file taken with relative exposure H = t·(ISO/100)/N² measures radiance Z/H. Values
//! are averaged with the inverse of their variance as weight, w = H²/(q² + aZ): q is the file's quantisation step in
//! linear light and aZ the photon noise. Pixels clipped in any channel are left out; where every exposure
//! is clipped the pixel is saturated. 8-bit files are taken as sRGB-encoded: recovering another camera's response
//! curve is not done here.

use super::error::CaptureError;
use super::manifest::{Exposure, Manifest};
use super::picture::{Encoding, Picture};
use std::path::PathBuf;

/// Photon noise: variance per unit of linear value, about that of 10,000 electrons at full scale.
const PHOTON_NOISE: f64 = 1e-4;

/// One file of a view.
#[derive(Debug)]
pub(super) struct Part {
    /// The file.
    pub path: PathBuf,
    /// Relative exposure H, `None` for a view of one file.
    pub amount: Option<f64>,
    /// Its pixels.
    pub picture: Picture,
}

/// Refuses captures in which only some views are bracketed, or only some exposures state aperture or sensitivity: their
/// radiance scales would differ.
pub(super) fn check_scale(manifest: &Manifest) -> Result<(), CaptureError> {
    let bracketed = |i: usize| manifest.frames[i].exposures[0].amount.is_some();
    let all = || manifest.frames.iter().flat_map(|frame| &frame.exposures);
    for key in ["f_number", "iso"] {
        let states = |exposure: &&Exposure| exposure.stated.contains(&key);
        if let (Some(without), true) = (all().find(|e| !states(e)), all().any(|e| states(&e))) {
            let (prefix, _) = without.field.rsplit_once('.').unwrap_or(("", ""));
            return Err(CaptureError::Field {
                path: manifest.path.clone(),
                field: format!("{prefix}.{key}"),
                problem: "is missing while other exposures have it".to_owned(),
                advice: "state it for all exposures or for none, so that all are on one scale"
                    .to_owned(),
            });
        }
    }
    let odd = (1..manifest.frames.len()).find(|&i| bracketed(i) != bracketed(0));
    odd.map_or(Ok(()), |i| {
        let single = if bracketed(0) { i } else { 0 };
        Err(CaptureError::Field {
            path: manifest.path.clone(),
            field: format!("{}.exposures", manifest.frames[single].field),
            problem: "is missing while other frames have it".to_owned(),
            advice: "state the exposure of every frame, so that all are on one scale".to_owned(),
        })
    })
}

/// Merges the files of a view, at least one.
pub(super) fn merge(mut parts: Vec<Part>) -> Result<Picture, CaptureError> {
    if parts.len() == 1
        && let Some(part) = parts.pop()
    {
        let mut picture = part.picture;
        let scale = part.amount.map_or(1.0, |amount| (1.0 / amount) as f32);
        for pixel in &mut picture.rgb {
            *pixel = pixel.map(|v| v * scale);
        }
        return Ok(picture);
    }
    let (width, height) = (parts[0].picture.width, parts[0].picture.height);
    for part in &parts[1..] {
        let found = (part.picture.width, part.picture.height);
        if found != (width, height) {
            return Err(CaptureError::ImageSize {
                path: part.path.clone(),
                found,
                stated: (width, height),
                stated_by: format!("the first exposure {}", parts[0].path.display()),
            });
        }
    }
    // From the longest exposure to the shortest, so that the order in the manifest does not matter.
    parts.sort_by(|a, b| b.amount.unwrap_or(1.0).total_cmp(&a.amount.unwrap_or(1.0)));
    let (rgb, saturated) = (0..width as usize * height as usize)
        .map(|i| merge_pixel(&parts, i))
        .unzip();
    let alpha = parts.iter_mut().find_map(|part| part.picture.alpha.take());
    Ok(Picture {
        width,
        height,
        rgb,
        alpha,
        saturated,
        encoding: Encoding::Float,
    })
}

/// The merged value of a pixel, and whether all exposures are clipped there.
fn merge_pixel(parts: &[Part], i: usize) -> ([f32; 3], bool) {
    let (mut sum, mut weights) = ([0.0; 3], [0.0; 3]);
    let mut clipped = 0;
    for part in parts {
        let picture = &part.picture;
        if picture.saturated[i] {
            clipped += 1;
            continue;
        }
        let amount = part.amount.unwrap_or(1.0);
        let pixel = picture.rgb[i].map(f64::from);
        if !pixel.iter().all(|v| v.is_finite()) {
            continue;
        }
        for c in 0..3 {
            let weight = amount * amount / variance(picture.encoding, pixel[c]);
            sum[c] += weight * pixel[c] / amount;
            weights[c] += weight;
        }
    }
    if weights[0] == 0.0 {
        // Saturated, or without any finite value; that is told apart by the value.
        return if clipped > 0 {
            ([0.0; 3], true)
        } else {
            ([f32::NAN; 3], false)
        };
    }
    let merged = [0, 1, 2].map(|c| (sum[c] / weights[c]) as f32);
    (merged, false)
}

/// Relative variance of a linear value.
fn variance(encoding: Encoding, value: f64) -> f64 {
    let value = value.max(0.0);
    let step = match encoding {
        // Twelve bits is what sensors deliver at least.
        Encoding::Float | Encoding::Linear16 => 1.0 / 4096.0,
        // The slope of the sRGB curve times a code.
        Encoding::Srgb8 if value <= 0.003_130_8 => 1.0 / 12.92 / 255.0,
        Encoding::Srgb8 => 2.4 / 1.055 * value.powf(1.4 / 2.4) * 1.055 / 255.0,
    };
    step * step + PHOTON_NOISE * value
}
