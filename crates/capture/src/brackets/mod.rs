//! Brackets of exposures: what each file's exposure is, the camera's response, and the radiance that they make together.
//!
//! Exposures are stated, from the strongest source to the weakest, by `exposures.csv`, by the manifest, or by the files'
//! EXIF data. All views share one response and one scale.

mod groups;
mod merge;
mod photos;
mod recover;
mod response;
mod sample;
mod shot;
mod table;
#[cfg(test)]
mod tests;

pub use groups::{Group, Photo};
pub use merge::ExposureUse;
pub(super) use merge::{Part, merge};
pub use photos::{MergedPhoto, Photos};
pub(super) use response::srgb_to_linear;
pub use response::{KNOTS, Origin, Response};
pub use shot::{Settings, Shot};
use table::TABLE;
pub(super) use table::Table;

use super::error::CaptureError;
use super::manifest::Manifest;
use super::picture::Encoding;
use serde::Serialize;

/// Most views that the response is recovered from, spread evenly among all.
const VIEWS: usize = 8;

/// How the photographs of a capture were merged.
#[derive(Clone, Debug, Serialize)]
pub struct Brackets {
    /// The camera's response.
    pub response: Response,
    /// What each exposure of each view gave, the longest exposure first.
    pub views: Vec<Vec<ExposureUse>>,
}

impl Brackets {
    /// Relative exposure of full scale, in green.
    pub fn full_scale(&self) -> f64 {
        f64::from(self.response.curves[1][KNOTS - 1])
    }

    /// The share of each exposure of a view in the weights of a pixel of this radiance.
    pub fn shares(&self, view: &[ExposureUse], radiance: f64) -> Vec<f64> {
        merge::shares(view, &self.response, radiance)
    }

    /// What a user should know of the response, in a whole sentence.
    pub(super) fn note(&self) -> Option<String> {
        let Response {
            disagreement: Some(left),
            disagreement_assumed: Some(before),
            ..
        } = self.response
        else {
            return None;
        };
        let percent = |part: f64| 100.0 * part;
        (!self.response.is_assumed()).then(|| {
            format!(
                "The camera's response was recovered from the brackets: exposures agree within {:.1} % under it, within {:.1} % \
                 under the curve that such files are taken to have.",
                percent(left),
                percent(before)
            )
        })
    }
}

/// Gives every exposure of a manifest its settings, as far as they are known, and refuses captures whose views would be on
/// different scales.
pub(super) fn settle(manifest: &mut Manifest, table: &Table) -> Result<(), CaptureError> {
    for frame in &mut manifest.frames {
        for exposure in &mut frame.exposures {
            if let Some(settings) = table.settings(&exposure.path) {
                exposure.settings = Some(settings);
            } else if frame.bracketed && exposure.settings.is_none() {
                exposure.settings = Shot::read(&exposure.path).settings;
            }
        }
    }
    settle_singles(manifest);
    for frame in manifest.frames.iter().filter(|frame| frame.bracketed) {
        if let Some(unknown) = frame.exposures.iter().find(|e| e.settings.is_none()) {
            let (prefix, _) = unknown.field.rsplit_once('.').unwrap_or(("", ""));
            return Err(CaptureError::Field {
                path: manifest.path.clone(),
                field: format!("{prefix}.exposure_time"),
                problem: format!(
                    "is missing, and {} has no exposure time in EXIF data",
                    unknown.path.display()
                ),
                advice: format!(
                    "write the seconds there, or a line file,time in {TABLE} beside it"
                ),
            });
        }
    }
    check_scale(manifest)
}

/// Takes the exposures of single files from their EXIF data where all of them state the same things.
fn settle_singles(manifest: &mut Manifest) {
    if manifest.frames.iter().any(|frame| frame.bracketed) {
        return;
    }
    let found: Vec<Option<Settings>> = manifest
        .frames
        .iter()
        .map(|frame| &frame.exposures[0])
        .map(|e| e.settings.or_else(|| Shot::read(&e.path).settings))
        .collect();
    let kind = |s: &Option<Settings>| s.map(|s| (s.f_number.is_some(), s.iso.is_some()));
    let alike = found
        .iter()
        .all(|s| s.is_some() && kind(s) == kind(&found[0]));
    if alike {
        for (frame, settings) in manifest.frames.iter_mut().zip(found) {
            frame.exposures[0].settings = settings;
        }
    }
}

/// Refuses captures in which only some views state their exposure, or only some exposures state aperture or sensitivity:
/// their radiance scales would differ.
fn check_scale(manifest: &Manifest) -> Result<(), CaptureError> {
    let stated = |i: usize| manifest.frames[i].exposures[0].settings.is_some();
    let all = || manifest.frames.iter().flat_map(|frame| &frame.exposures);
    for (key, _, has) in shot::OPTIONAL {
        let states =
            |exposure: &&super::manifest::Exposure| exposure.settings.is_some_and(|s| has(&s));
        if let (Some(without), true) = (all().find(|e| !states(e)), all().any(|e| states(&e))) {
            let (prefix, _) = without.field.rsplit_once('.').unwrap_or(("", ""));
            return Err(CaptureError::Field {
                path: manifest.path.clone(),
                field: format!("{prefix}.{key}"),
                problem: format!(
                    "is missing for {} while other exposures have it",
                    without.path.display()
                ),
                advice: format!(
                    "state it for all exposures or for none, here or in {TABLE}, so that all are on one scale"
                ),
            });
        }
    }
    let odd = (1..manifest.frames.len()).find(|&i| stated(i) != stated(0));
    odd.map_or(Ok(()), |i| {
        let single = if stated(0) { i } else { 0 };
        Err(CaptureError::Field {
            path: manifest.path.clone(),
            field: format!("{}.exposures", manifest.frames[single].field),
            problem: "is missing while other frames have it".to_owned(),
            advice: "state the exposure of every frame, so that all are on one scale".to_owned(),
        })
    })
}

/// The response of the camera that took brackets, whose files `read` reads: what files are taken as where there are none
/// or they don't tell.
pub(super) fn response<T: Copy>(
    brackets: &[T],
    read: &dyn Fn(T) -> Result<Vec<Part>, CaptureError>,
) -> Result<Response, CaptureError> {
    let step = brackets.len().div_ceil(VIEWS).max(1);
    let mut samples = Vec::new();
    let mut assumed = Origin::Srgb;
    for &bracket in brackets.iter().step_by(step) {
        let parts = read(bracket)?;
        let linear =
            |part: &Part| matches!(part.picture.encoding, Encoding::Linear16 | Encoding::Raw);
        if samples.is_empty() && parts.iter().any(linear) {
            assumed = Origin::Linear;
        }
        samples.extend(sample::samples(&parts));
    }
    Ok(recover::recover(&samples, assumed))
}
