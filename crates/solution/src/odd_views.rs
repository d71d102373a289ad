//! Photographs that contradict the others, or do not lie where the mesh is, are left out: of the estimate altogether, and of the
//! textures where others show the same surface.

use std::borrow::Cow;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use rekindle_capture::{Capture, Photograph, View};
use rekindle_estimate::estimate::{
    Estimate, EstimateInput, EstimateParams, Observer, Stopped, estimate,
};
use rekindle_scene::surface::ViewSurface;

/// With fewer views left, lights can't be told from texture.
const FEWEST_VIEWS: usize = 3;

/// Views that were left out.
pub struct OddViews {
    /// Which, ascending.
    pub views: Vec<usize>,
    /// The capture in which they show only what no other does.
    pub capture: Capture,
    /// What to say of it.
    pub warning: String,
}

/// The estimate without the views at `odd`, ascending, if enough others are left and it explains no less of how these differ than
/// `found` does of all. What it says of single views is of all of them.
pub fn without(
    input: &EstimateInput<'_>,
    params: &EstimateParams,
    (found, odd): (&Estimate, Vec<usize>),
    observer: &mut dyn Observer,
) -> Result<Option<(Estimate, OddViews)>, Stopped> {
    let capture = input.capture;
    let left = capture.views.len() - odd.len();
    // More than half that are off are no exceptions. Where the object turned, all is told from the first view.
    let may_be_left_out = !odd.is_empty() && left >= FEWEST_VIEWS.max(odd.len() + 1);
    if !may_be_left_out || capture.motions().is_some() || observer.enough() {
        return Ok(None);
    }
    let is_kept = |index: &usize| odd.binary_search(index).is_err();
    let kept: Vec<usize> = (0..capture.views.len()).filter(is_kept).collect();
    let others = Capture {
        views: kept.iter().map(|&k| capture.views[k].clone()).collect(),
        ..capture.clone()
    };
    let surfaces: Vec<ViewSurface> = kept.iter().map(|&k| input.surfaces[k].clone()).collect();
    let of_others = EstimateInput {
        capture: &others,
        surfaces: &surfaces,
        ..*input
    };
    let mut bettered = estimate(&of_others, params, observer)?;
    let explains_no_less = match (bettered.misfit, found.misfit) {
        (Some(now), Some(before)) => now <= before,
        (now, _) => now.is_some(),
    };
    if !explains_no_less {
        return Ok(None);
    }
    if !bettered.exposures.is_empty() {
        let mut exposures = vec![1.0; capture.views.len()];
        for (&k, &exposure) in kept.iter().zip(&bettered.exposures) {
            exposures[k] = exposure;
        }
        bettered.exposures = exposures;
    }
    let mut shown = capture.clone();
    for &k in &odd {
        shown.views[k] = where_alone(input, k, &surfaces);
    }
    let odd = OddViews {
        warning: told(odd.iter().map(|&k| capture.views[k].name.as_str())),
        capture: shown,
        views: odd,
    };
    Ok(Some((bettered, odd)))
}

/// A view with its pixels where none of `others` sees what it does.
fn where_alone(input: &EstimateInput<'_>, index: usize, others: &[ViewSurface]) -> View {
    let (view, surface) = (&input.capture.views[index], &input.surfaces[index]);
    let photograph = &view.photograph;
    let is_alone = |pixel: usize| {
        let (x, y) = (
            pixel as u32 % photograph.width,
            pixel as u32 / photograph.width,
        );
        let point = surface.point(&input.capture.mesh, &view.camera, x, y);
        let is_seen = |p: Vec3| others.iter().any(|other| other.sees(p).is_some());
        point.is_some_and(|point| !is_seen(point.position))
    };
    let usable = photograph.usable.par_iter().enumerate();
    let usable = usable.map(|(pixel, &usable)| usable && is_alone(pixel));
    View {
        photograph: Arc::new(Photograph {
            radiance: photograph.radiance.clone(),
            coverage: photograph.coverage.clone(),
            usable: usable.collect(),
            clipped: None,
            ..**photograph
        }),
        ..view.clone()
    }
}

/// Says which views were left out.
fn told<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let names: Vec<&str> = names.collect();
    let (views, verb, [it, their]) = match names.len() {
        1 => (
            "The view",
            "does not fit the others or the mesh and was",
            ["it", "its"],
        ),
        _ => (
            "The views",
            "do not fit the others or the mesh and were",
            ["them", "their"],
        ),
    };
    let names: Cow<'_, str> = match names.as_slice() {
        [one] => Cow::Borrowed(one),
        [all @ .., last] => Cow::Owned(format!("{} and {last}", all.join(", "))),
        [] => Cow::Borrowed(""),
    };
    format!(
        "{views} {names} {verb} left out: roughness and lights come from the rest, and textures show of {it} only what no other view \
         does. Check {their} camera, focus, and whether the light was the same."
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_that_were_left_out_are_named() {
        let one = told(["a.jpg"].into_iter());
        assert!(
            one.starts_with("The view a.jpg does not fit the others or the mesh and was left out"),
            "{one}"
        );
        let three = told(["a.jpg", "b.jpg", "c.jpg"].into_iter());
        assert!(
            three.starts_with("The views a.jpg, b.jpg and c.jpg do not fit"),
            "{three}"
        );
        assert!(three.contains("Check their camera"), "{three}");
    }
}
