//! Photographs without alpha or mask: which of their pixels show nothing but the object?
//!
//! Those within the mesh's outline, a pixel smaller all round: at the outline the background shines in, and a mesh that lies
//! a little off lets it in as well.

use std::borrow::Cow;
use std::sync::Arc;

use rayon::prelude::*;

use rekindle_capture::{Capture, Photograph, View};
use rekindle_scene::surface::{NO_TRIANGLE, ViewSurface};

/// A background is lit if its mean radiance is at least this part of the object's.
const LIT: f64 = 0.005;

/// The capture with the pixels about the mesh's outline and outside it left out where photographs have no coverage, and what
/// there is to say of that; one surface a view.
pub fn within_outlines<'c>(
    capture: &'c Capture,
    surfaces: &[ViewSurface],
) -> (Cow<'c, Capture>, Option<String>) {
    if capture.views.iter().all(has_coverage) {
        return (Cow::Borrowed(capture), None);
    }
    let masked = capture.views.par_iter().zip(surfaces);
    let masked: Vec<(View, bool)> = masked
        .map(|(view, surface)| {
            if has_coverage(view) {
                (view.clone(), false)
            } else {
                (within_outline(view, surface), is_lit_behind(view, surface))
            }
        })
        .collect();
    let lit = masked.iter().any(|(_, lit)| *lit);
    let capture = Capture {
        views: masked.into_iter().map(|(view, _)| view).collect(),
        ..capture.clone()
    };
    let said = lit.then(|| {
        "The photographs have neither alpha nor masks, and their background is not black: only pixels within the mesh's outline \
         are used. Masks (mask_path) would let the outlines be compared."
            .to_owned()
    });
    (Cow::Owned(capture), said)
}

fn has_coverage(view: &View) -> bool {
    view.photograph.coverage.is_some()
}

fn within_outline(view: &View, surface: &ViewSurface) -> View {
    let photograph = &view.photograph;
    let within = |pixels: &Vec<bool>| -> Vec<bool> {
        let is_within = |p: usize| near(surface, p).all(|q| is_mesh(surface, q));
        let pixels = pixels.par_iter().enumerate();
        pixels.map(|(p, &of_use)| of_use && is_within(p)).collect()
    };
    View {
        photograph: Arc::new(Photograph {
            radiance: photograph.radiance.clone(),
            coverage: None,
            usable: within(&photograph.usable),
            clipped: photograph.clipped.as_ref().map(within),
            ..**photograph
        }),
        ..view.clone()
    }
}

/// Whether what is clear of the mesh is not black.
fn is_lit_behind(view: &View, surface: &ViewSurface) -> bool {
    let photograph = &view.photograph;
    let mean = |shown: &(dyn Fn(usize) -> bool + Sync)| {
        let pixels = (0..photograph.usable.len()).into_par_iter();
        let (sum, count) = pixels
            .filter(|&p| photograph.usable[p] && shown(p))
            .map(|p| {
                (
                    f64::from(photograph.radiance[p].iter().sum::<f32>()),
                    1_usize,
                )
            })
            .reduce(|| (0.0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        sum / count.max(1) as f64
    };
    let behind = mean(&|p| !near(surface, p).any(|q| is_mesh(surface, q)));
    behind > LIT * mean(&|p| is_mesh(surface, p))
}

fn is_mesh(surface: &ViewSurface, pixel: usize) -> bool {
    surface.triangle[pixel] != NO_TRIANGLE
}

/// A pixel and the up to eight about it.
fn near(surface: &ViewSurface, pixel: usize) -> impl Iterator<Item = usize> {
    let (width, height) = (surface.width as usize, surface.height as usize);
    let (x, y) = (pixel % width, pixel / width);
    let rows = y.saturating_sub(1)..(y + 2).min(height);
    rows.flat_map(move |row| {
        (x.saturating_sub(1)..(x + 2).min(width)).map(move |column| row * width + column)
    })
}
