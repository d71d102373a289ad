//! Merging a bracket of exposures to one radiance image on a scale shared by all views.
//!
//! A value Z of a file taken with relative exposure H = t·(ISO/100)/N² measures radiance Z/H; Z is the camera's response
//! to the stored code. Values are averaged with the inverse of their variance as weight, w = H²/(q² + aZ): q is the
//! code's rounding in linear light, the slope of the response, and aZ the photon noise. Pixels clipped in any channel are
//! left out; where every exposure is clipped the pixel is saturated.

use super::super::error::CaptureError;
use super::super::picture::{Encoding, Picture};
use super::response::{Origin, Response};
use rayon::prelude::*;
use serde::Serialize;
use std::path::PathBuf;

/// Photon noise: variance per unit of linear value, about that of 10,000 electrons at full scale.
const PHOTON_NOISE: f64 = 1e-4;
/// Rounding of values that files of more than 8 bits hold: twelve bits is what sensors deliver at least.
const FINE_STEP: f64 = 1.0 / 4096.0;
/// Pixels at which exposures are compared.
const COMPARED: usize = 40_000;
/// Fewer pixels say nothing of an exposure.
const ENOUGH: usize = 50;
/// Exposures are compared where the shorter one's value is this large at least, in parts of full scale.
const BRIGHT: f64 = 0.02;
/// Factors by which pixels may differ from what the stated exposures say: beyond the first a user should know, and
/// where the exposures are stated as equal, beyond the second they can't be.
const ODD: f64 = 1.2;
const DIFFERENT: f64 = 1.1;

/// Variance of a value whose rounding is `step`, both in parts of full scale.
fn variance(value: f64, step: f64) -> f64 {
    step * step + PHOTON_NOISE * value.max(0.0)
}

/// How wide a code is, in codes of 8 bits.
fn code_width(encoding: Encoding) -> f64 {
    match encoding {
        Encoding::Srgb8 => 1.0,
        Encoding::Linear16 | Encoding::Float | Encoding::Raw => 255.0 * FINE_STEP,
    }
}

/// The share of each exposure in the weights of a pixel of this radiance, by green: what [`merge`] gives them.
pub(super) fn shares(uses: &[ExposureUse], response: &Response, radiance: f64) -> Vec<f64> {
    const GREEN: usize = 1;
    let linear = response.assumed == Origin::Linear;
    let width = code_width(if linear {
        Encoding::Linear16
    } else {
        Encoding::Srgb8
    });
    let weights = uses.iter().map(|exposure| {
        let value = radiance * exposure.amount;
        let code = response.code(GREEN, value as f32);
        code.map_or(0.0, |code| {
            let step = width * f64::from(response.slope(GREEN, code));
            exposure.amount * exposure.amount / variance(value, step)
        })
    });
    let weights: Vec<f64> = weights.collect();
    let total = weights.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    weights.into_iter().map(|w| w / total).collect()
}

/// One file of a view.
#[derive(Debug)]
pub(crate) struct Part {
    /// The file.
    pub path: PathBuf,
    /// Relative exposure H, `None` for a view of one file.
    pub amount: Option<f64>,
    /// Its pixels.
    pub picture: Picture,
}

/// What one exposure gave to its view.
#[derive(Clone, Debug, Serialize)]
pub struct ExposureUse {
    /// The file's name.
    pub file: String,
    /// Relative exposure H = t·(ISO/100)/N².
    pub amount: f64,
    /// Its share of all weights, from 0 to 1.
    pub weight: f64,
    /// Share of the pixels that are clipped in it.
    pub clipped: f64,
    /// The exposure that its pixels speak for, compared with the other files', as a factor of the stated one; none if too
    /// few pixels tell.
    pub measured_factor: Option<f64>,
}

/// A view of one or more exposures.
pub(crate) struct Merged {
    /// Radiance.
    pub picture: Picture,
    /// One per file, the longest exposure first; empty for a view of one file.
    pub uses: Vec<ExposureUse>,
    /// What a user should know.
    pub warnings: Vec<String>,
}

impl Part {
    fn amount(&self) -> f64 {
        self.amount.unwrap_or(1.0)
    }

    fn name(&self) -> String {
        let name = self.path.file_name();
        name.map_or_else(String::new, |n| n.to_string_lossy().into_owned())
    }

    /// Linear straight values of a pixel, what premultiplies them, and the variance of each, in parts of full scale.
    fn values(&self, i: usize, response: &Response) -> ([f64; 3], f64, [f64; 3]) {
        let picture = &self.picture;
        let (values, steps) = match &picture.codes {
            None => (picture.rgb[i].map(f64::from), [FINE_STEP; 3]),
            Some(codes) => {
                let code = codes.at(i);
                let values = [0, 1, 2].map(|c| f64::from(response.exposure(c, code[c])));
                let width = code_width(picture.encoding);
                let steps = [0, 1, 2].map(|c| width * f64::from(response.slope(c, code[c])));
                (values, steps)
            }
        };
        let alpha = match (&picture.codes, &picture.alpha) {
            (Some(_), Some(alpha)) => f64::from(alpha[i]),
            _ => 1.0,
        };
        (
            values,
            alpha,
            [0, 1, 2].map(|c| variance(values[c], steps[c])),
        )
    }
}

/// Merges the files of a view, at least one.
pub(crate) fn merge(mut parts: Vec<Part>, response: &Response) -> Result<Merged, CaptureError> {
    if parts.len() == 1
        && let Some(part) = parts.pop()
    {
        return Ok(Merged {
            picture: scaled(part, response),
            uses: Vec::new(),
            warnings: Vec::new(),
        });
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
    parts.sort_by(|a, b| b.amount().total_cmp(&a.amount()));
    let uses = uses(&parts, response);
    let warnings = check(&parts, &uses, response)?;
    let (rgb, saturated) = (0..width as usize * height as usize)
        .into_par_iter()
        .map(|i| merge_pixel(&parts, i, response))
        .unzip();
    let alpha = parts.iter_mut().find_map(|part| part.picture.alpha.take());
    let picture = Picture {
        width,
        height,
        rgb,
        alpha,
        saturated,
        encoding: Encoding::Float,
        codes: None,
    };
    Ok(Merged {
        picture,
        uses,
        warnings,
    })
}

/// The one file of a view, in units of its exposure.
fn scaled(part: Part, response: &Response) -> Picture {
    let recovered = !response.is_assumed() && part.picture.codes.is_some();
    if part.amount.is_none() && !recovered {
        return part.picture;
    }
    let amount = part.amount();
    let scale = (1.0 / amount) as f32;
    let pixel = |i: usize| {
        if !recovered {
            return part.picture.rgb[i].map(|v| v * scale);
        }
        let (values, alpha, _) = part.values(i, response);
        values.map(|v| (v * alpha / amount) as f32)
    };
    let rgb = (0..part.picture.rgb.len()).map(pixel).collect();
    Picture {
        rgb,
        ..part.picture
    }
}

/// The merged value of a pixel, and whether all exposures are clipped there.
fn merge_pixel(parts: &[Part], i: usize, response: &Response) -> ([f32; 3], bool) {
    let (mut sum, mut weights) = ([0.0; 3], [0.0; 3]);
    let mut clipped = false;
    let mut at_least = [0.0; 3];
    for part in parts {
        let (values, alpha, variance) = part.values(i, response);
        if part.picture.saturated[i] {
            clipped = true;
            for (least, value) in at_least.iter_mut().zip(values) {
                *least = f64::max(*least, alpha * value / part.amount());
            }
            continue;
        }
        if !values.iter().all(|v| v.is_finite()) {
            continue;
        }
        let amount = part.amount();
        for c in 0..3 {
            let weight = amount * amount / variance[c];
            sum[c] += weight * alpha * values[c] / amount;
            weights[c] += weight;
        }
    }
    if weights[0] == 0.0 {
        // Saturated, or without any finite value; that is told apart by the value.
        let finite = |v: f64| if v.is_finite() { v as f32 } else { 0.0 };
        let least = at_least.map(finite);
        return (if clipped { least } else { [f32::NAN; 3] }, clipped);
    }
    let merged = [0, 1, 2].map(|c| (sum[c] / weights[c]) as f32);
    (merged, false)
}

/// What each part gives: its share of the weights in green, where it is clipped, and whether its pixels agree with
/// those of the next part, which is shorter, or of the one before for the last.
fn uses(parts: &[Part], response: &Response) -> Vec<ExposureUse> {
    let pixels = parts[0].picture.rgb.len();
    let step = pixels.div_ceil(COMPARED).max(1);
    let mut weights = vec![0.0; parts.len()];
    let mut clipped = vec![0_usize; parts.len()];
    let mut count = 0;
    for i in (0..pixels).step_by(step) {
        let opaque = parts[0].picture.alpha.as_ref().is_none_or(|a| a[i] > 0.5);
        if !opaque {
            continue;
        }
        count += 1;
        let each: Vec<f64> = parts
            .iter()
            .map(|part| {
                let (_, _, variance) = part.values(i, response);
                let usable = !part.picture.saturated[i] && variance[1].is_finite();
                if usable {
                    part.amount() * part.amount() / variance[1]
                } else {
                    0.0
                }
            })
            .collect();
        let total: f64 = each.iter().sum();
        for (k, weight) in each.iter().enumerate() {
            clipped[k] += usize::from(parts[k].picture.saturated[i]);
            weights[k] += if total > 0.0 { weight / total } else { 0.0 };
        }
    }
    let share = |value: f64| value / f64::from(count.max(1));
    (0..parts.len())
        .map(|k| {
            let other = if k + 1 < parts.len() { k + 1 } else { k - 1 };
            ExposureUse {
                file: parts[k].name(),
                amount: parts[k].amount(),
                weight: share(weights[k]),
                clipped: share(clipped[k] as f64),
                measured_factor: factor(&parts[k], &parts[other], response, step),
            }
        })
        .collect()
}

/// By which factor a part is brighter than another one and their exposures say: the median over pixels that both show.
fn factor(part: &Part, other: &Part, response: &Response, step: usize) -> Option<f64> {
    let stated = part.amount() / other.amount();
    let mut ratios: Vec<f64> = (0..part.picture.rgb.len())
        .step_by(step)
        .filter(|&i| !part.picture.saturated[i] && !other.picture.saturated[i])
        .flat_map(|i| {
            let (here, there) = (part.values(i, response).0, other.values(i, response).0);
            [0, 1, 2].map(|c| (here[c], there[c]))
        })
        .filter(|(here, there)| here.min(*there) > BRIGHT)
        .map(|(here, there)| here / there / stated)
        .collect();
    if ratios.len() < ENOUGH {
        return None;
    }
    let middle = ratios.len() / 2;
    Some(*ratios.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Refuses exposures that the pixels contradict, and tells of those that they doubt.
fn check(
    parts: &[Part],
    uses: &[ExposureUse],
    response: &Response,
) -> Result<Vec<String>, CaptureError> {
    const TABLE: &str =
        "state the exposures in exposures.csv beside the manifest, one line file,time a file";
    let mut warnings = Vec::new();
    let step = parts[0].picture.rgb.len().div_ceil(COMPARED).max(1);
    for (k, pair) in parts.windows(2).enumerate() {
        let [long, short] = pair else { continue };
        let stated = long.amount() / short.amount();
        let Some(odd) = factor(long, short, response, step) else {
            continue;
        };
        let contradiction = |problem: String| CaptureError::Exposure {
            path: short.path.clone(),
            problem,
            advice: TABLE.to_owned(),
        };
        let found = odd * stated;
        if stated < 1.001 && !(1.0 / DIFFERENT..DIFFERENT).contains(&odd) {
            return Err(contradiction(format!(
                "it is stated to have the same exposure as {}, but its pixels differ by a factor of {:.2}",
                long.name(),
                found.max(1.0 / found)
            )));
        }
        if stated >= ODD && found <= 1.0 {
            return Err(contradiction(format!(
                "it is stated to have {stated:.3} times less exposure than {}, but is brighter",
                long.name()
            )));
        }
        if !(1.0 / ODD..ODD).contains(&odd) {
            warnings.push(format!(
                "{} and {} are stated to be a factor of {stated:.2} apart in exposure; their pixels say {found:.2}. \
                 Correct them in the manifest or in exposures.csv.",
                uses[k].file,
                uses[k + 1].file
            ));
        }
    }
    Ok(warnings)
}
