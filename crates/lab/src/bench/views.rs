//! How near a solution's pictures come to the true ones: PSNR of novel views and of views under new light.

use std::path::Path;

use glam::{DVec3, Vec3};

use super::Audience;
use super::error::BenchError;
use super::truth::Truth;
use rekindle_capture::{Covered, read_cameras, read_covered};
use rekindle_output::export::{Photographer, Renderer};
use rekindle_relight::{Picture, apply, psnr};
use rekindle_solution::Solution;

/// Coverage from which a pixel shows nothing but the object.
const COVERED: f32 = 0.999;

/// PSNR of a solution's pictures, dB, one per view.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ViewErrors {
    /// From elsewhere, under the captured lighting.
    pub novel: Vec<f32>,
    /// Under new light, by the case's name. Empty where the light couldn't be made, as no lamp was found.
    pub relit: Vec<(String, Vec<f32>)>,
}

impl ViewErrors {
    /// Mean over the novel views.
    pub fn novel_mean(&self) -> Option<f32> {
        mean(&self.novel)
    }

    /// Mean over all views with one lamp alone.
    pub fn alone_mean(&self) -> Option<f32> {
        let alone = self
            .relit
            .iter()
            .filter(|(name, _)| name.starts_with("light_"));
        mean(
            &alone
                .flat_map(|(_, values)| values.clone())
                .collect::<Vec<_>>(),
        )
    }

    /// Mean over the views with a lamp moved.
    pub fn moved_mean(&self) -> Option<f32> {
        let moved = self.relit.iter().find(|(name, _)| name == "moved");
        mean(&moved?.1)
    }
}

fn mean(values: &[f32]) -> Option<f32> {
    (!values.is_empty()).then(|| values.iter().sum::<f32>() / values.len() as f32)
}

/// Renders what the truth has pictures of and compares.
pub(super) fn compare(
    solution: &Solution,
    truth: &Truth,
    audience: &dyn Audience,
) -> Result<ViewErrors, BenchError> {
    let renderer = Renderer::new(solution);
    let origin = solution.mesh.origin;
    let mut errors = ViewErrors::default();
    if let Some(cameras) = &truth.novel {
        let captured = Photographer::new(&renderer, renderer.original());
        errors.novel = views(&captured, cameras, origin, audience)?;
    }
    for case in &truth.relit {
        // What a solution without lamps looks like under one of them can't be said.
        let values = match apply(&case.edits, renderer.original()) {
            Ok(light) => {
                let photographer = Photographer::new(&renderer, &light);
                views(&photographer, &case.cameras, origin, audience)?
            }
            Err(_) if solution.lamps.is_empty() => Vec::new(),
            Err(error) => return Err(error.into()),
        };
        errors.relit.push((case.name.clone(), values));
    }
    Ok(errors)
}

/// PSNR of every view of a `transforms.json` beside whose frames the true pictures lie.
fn views(
    photographer: &Photographer<'_>,
    cameras: &Path,
    origin: DVec3,
    audience: &dyn Audience,
) -> Result<Vec<f32>, BenchError> {
    let folder = cameras.parent().unwrap_or(Path::new("."));
    read_cameras(cameras, origin)?
        .into_iter()
        .map(|(name, camera)| {
            if audience.stop() {
                return Err(BenchError::Stopped);
            }
            let reference = read_covered(&folder.join(name))?;
            Ok(inside(&reference, &photographer.picture(&camera)))
        })
        .collect()
}

/// PSNR inside the object, by the reference's coverage.
fn inside(reference: &Covered, picture: &Picture) -> f32 {
    let (mut wanted, mut found) = (Vec::new(), Vec::new());
    for i in 0..reference.coverage.len().min(picture.coverage.len()) {
        if reference.coverage[i] > COVERED {
            wanted.push(Vec3::from(reference.radiance[i]));
            found.push(Vec3::from(picture.diffuse[i]) + Vec3::from(picture.specular[i]));
        }
    }
    psnr(&wanted, &found)
}
