//! How well is a photograph predicted from the others? The measure for captures of real objects, of which nothing else is known.
//!
//! Each view is left out in turn: what the others give is rendered as its camera sees it, brought to its photograph by one gain a
//! channel, as exposure and white balance are the photograph's own, and compared. So is what they give where all is taken as
//! diffuse: lights that were found have to explain more than none.

use std::fmt::Write as _;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};

use super::Audience;
use super::error::BenchError;
use super::table::{cell, with_unit};
use rekindle_base::math::median;
use rekindle_capture::{Capture, Photograph, View};
use rekindle_estimate::estimate::{Iteration, Observer};
use rekindle_output::export::{Photographer, Renderer};
use rekindle_relight::{Picture, brighter_than, psnr_below, white};
use rekindle_solution::{SolveOptions, diffuse_alone, solve};

/// Pixels by which what the object covers is shrunk: outlines are a matter of cameras and masks.
const MARGIN: usize = 3;
/// Coverage from which a pixel shows nothing but the object.
const COVERED: f32 = 0.999;
/// This part of the pixels is less bright than a highlight.
const BELOW_HIGHLIGHTS: f32 = 0.9;
/// Rounds in which the gain is found, and the residuals, as a multiple of their median, from which a pixel counts less.
const ROUNDS: usize = 8;
const OUTLIER: f64 = 3.0;

/// PSNR of a prediction, dB.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct PredictionError {
    /// Over all pixels of the object.
    pub all: f32,
    /// Over the brightest tenth of them.
    pub highlights: f32,
}

/// A view as the others of its capture predict it.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Predicted {
    /// The capture's name.
    pub capture: String,
    /// Counts from 0.
    pub view: usize,
    /// The photograph's name.
    pub photograph: String,
    /// How many lamps the others gave.
    pub lamps: usize,
    /// The roughness that they gave, radians.
    pub sigma: Option<f32>,
    /// By the light found.
    pub predicted: PredictionError,
    /// With all taken as diffuse.
    pub diffuse: PredictionError,
}

/// Predicts every view of some captures from the others.
pub fn leave_one_out(
    folders: &[PathBuf],
    options: &SolveOptions,
    audience: &mut dyn Audience,
) -> Result<Vec<Predicted>, BenchError> {
    let captures = folders
        .iter()
        .map(|folder| loaded(folder))
        .collect::<Result<Vec<Capture>, BenchError>>()?;
    let all: usize = captures.iter().map(|capture| capture.views.len()).sum();
    let mut predicted = Vec::with_capacity(all);
    for capture in &captures {
        for view in 0..capture.views.len() {
            let what = format!("{}: without view {}", capture.name, view + 1);
            audience.stage(&what, predicted.len() as f32 / all as f32);
            predicted.extend(predict(capture, view, options, audience)?);
        }
    }
    Ok(predicted)
}

fn loaded(folder: &Path) -> Result<Capture, BenchError> {
    let capture = Capture::load(folder)?;
    if capture.views.len() < 2 {
        return Err(BenchError::OneView {
            path: folder.to_owned(),
        });
    }
    Ok(capture)
}

/// Ends a solve when the audience wants it to.
struct Stopping<'a>(&'a mut dyn Audience);

impl Observer for Stopping<'_> {
    fn progress(&mut self, _: &str, _: f32) -> ControlFlow<()> {
        if self.0.stop() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    }

    fn iteration(&mut self, _: &Iteration, _: &dyn Fn() -> Vec<[f32; 3]>) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
}

/// A view from the others; nothing where no pixel of it can be compared.
fn predict(
    capture: &Capture,
    index: usize,
    options: &SolveOptions,
    audience: &mut dyn Audience,
) -> Result<Option<Predicted>, BenchError> {
    let mut others = capture.clone();
    let view = others.views.remove(index);
    let solution = solve(&others, options, 0.0, &mut Stopping(audience));
    let solution = solution.map_err(|_| BenchError::Stopped)?;
    let renderer = Renderer::new(&solution);
    let lit = Photographer::new(&renderer, renderer.original()).picture(&view.camera);
    let cameras = std::slice::from_ref(&view.camera);
    let mut diffuse = diffuse_alone(&others, &solution, cameras);
    let (Some(predicted), Some(diffuse)) = (
        compare(&view, &lit),
        diffuse.pop().and_then(|picture| compare(&view, &picture)),
    ) else {
        return Ok(None);
    };
    Ok(Some(Predicted {
        capture: capture.name.clone(),
        view: index,
        photograph: view.name,
        lamps: solution.lamps.len(),
        sigma: solution.brdf.map(|brdf| brdf.sigma),
        predicted,
        diffuse,
    }))
}

/// How near a picture comes to a view's photograph.
fn compare(view: &View, picture: &Picture) -> Option<PredictionError> {
    let photograph = &view.photograph;
    let inside = inside(photograph);
    let (mut measured, mut found) = (Vec::new(), Vec::new());
    for i in (0..inside.len()).filter(|&i| inside[i]) {
        let rendered = Vec3::from(picture.diffuse[i]) + Vec3::from(picture.specular[i]);
        if rendered.max_element() > 0.0 {
            measured.push(Vec3::from(photograph.radiance[i]));
            found.push(rendered);
        }
    }
    let gain = gain(&measured, &found)?.as_vec3();
    for value in &mut found {
        *value *= gain;
    }
    let white = white(&measured);
    let bright = 3.0 * brighter_than(BELOW_HIGHLIGHTS, &measured);
    let pairs = measured.iter().zip(&found);
    let (highlights, of_highlights): (Vec<Vec3>, Vec<Vec3>) = pairs
        .filter(|(measured, _)| measured.element_sum() >= bright)
        .unzip();
    Some(PredictionError {
        all: psnr_below(white, &measured, &found),
        highlights: psnr_below(white, &highlights, &of_highlights),
    })
}

/// Pixels that are data and clear of the outline.
fn inside(photograph: &Photograph) -> Vec<bool> {
    let (width, height) = (photograph.width as usize, photograph.height as usize);
    let coverage = photograph.coverage.as_ref();
    let covered = |i: usize| coverage.is_none_or(|coverage| coverage[i] > COVERED);
    let mut object: Vec<bool> = (0..width * height).map(covered).collect();
    for _ in 0..MARGIN {
        let keeps = |i: usize| {
            let (x, y) = (i % width, i / width);
            let surrounded = x > 0 && y > 0 && x + 1 < width && y + 1 < height;
            object[i]
                && surrounded
                && [i - 1, i + 1, i - width, i + width]
                    .iter()
                    .all(|&k| object[k])
        };
        object = (0..object.len()).map(keeps).collect();
    }
    let usable = object.iter().zip(&photograph.usable);
    usable.map(|(&object, &usable)| object && usable).collect()
}

/// By what to multiply each channel of what was found; `None` where there is nothing to compare. Pixels far off count less.
fn gain(measured: &[Vec3], found: &[Vec3]) -> Option<DVec3> {
    if measured.is_empty() {
        return None;
    }
    let channel = |c: usize| {
        let pairs = measured.iter().zip(found);
        let pairs: Vec<[f64; 2]> = pairs.map(|(m, f)| [m[c].into(), f[c].into()]).collect();
        let mut gain = 1.0;
        for _ in 0..ROUNDS {
            let off = |&[m, f]: &[f64; 2]| (m - gain * f).abs();
            let mut residuals: Vec<f64> = pairs.iter().map(off).collect();
            let limit = OUTLIER * median(&mut residuals).unwrap_or(0.0) + f64::MIN_POSITIVE;
            let (mut product, mut square) = (0.0, 0.0);
            for pair in &pairs {
                let weight = 1.0 / (off(pair) / limit).max(1.0);
                product += weight * pair[0] * pair[1];
                square += weight * pair[1] * pair[1];
            }
            gain = if square > 0.0 { product / square } else { 1.0 };
        }
        gain
    };
    Some(DVec3::new(channel(0), channel(1), channel(2)))
}

/// A table of predictions, with a line for each capture's mean.
pub fn table(predicted: &[Predicted]) -> String {
    let mut text = String::from(
        "| capture | left out | lights | all, dB | highlights, dB | diffuse alone: all, dB | highlights, dB |\n\
         | --- | --- | --- | --- | --- | --- | --- |\n",
    );
    for views in predicted.chunk_by(|a, b| a.capture == b.capture) {
        for view in views {
            let errors = [view.predicted, view.diffuse];
            add_row(
                &mut text,
                view,
                &view.photograph,
                &view.lamps.to_string(),
                errors,
            );
        }
        let mean = |of: fn(&Predicted) -> PredictionError| {
            let mean = |part: fn(PredictionError) -> f32| {
                views.iter().map(|view| part(of(view))).sum::<f32>() / views.len() as f32
            };
            PredictionError {
                all: mean(|error| error.all),
                highlights: mean(|error| error.highlights),
            }
        };
        let errors = [mean(|view| view.predicted), mean(|view| view.diffuse)];
        add_row(&mut text, &views[0], "mean", "", errors);
    }
    text
}

fn add_row(
    text: &mut String,
    Predicted { capture, .. }: &Predicted,
    name: &str,
    lamps: &str,
    errors: [PredictionError; 2],
) {
    let [[all, highlights], [diffuse_all, diffuse_highlights]] = errors
        .map(|error| [error.all, error.highlights].map(|db| with_unit(cell(Some(db), 1), "")));
    // Writing into a string can't fail.
    let _ = writeln!(
        text,
        "| {capture} | {name} | {lamps} | {all} | {highlights} | {diffuse_all} | {diffuse_highlights} |"
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gain_is_that_of_most_pixels() {
        let found: Vec<Vec3> = (1..=400).map(|i| Vec3::splat(i as f32)).collect();
        let wanted = Vec3::new(0.5, 1.0, 2.0);
        let mut measured: Vec<Vec3> = found.iter().map(|&f| wanted * f).collect();
        for highlight in &mut measured[..20] {
            *highlight += 300.0;
        }
        let gain = gain(&measured, &found).expect("pixels").as_vec3();
        let off = (gain / wanted - 1.0).abs().max_element();
        assert!(off < 0.02, "{gain}");
    }

    #[test]
    fn what_is_compared_is_data_and_clear_of_the_outline() {
        let (width, height) = (20, 16);
        let covered = |i: usize| f32::from(u8::from(i % width >= 5));
        let mut usable = vec![true; width * height];
        usable[8 * width + 10] = false;
        let photograph = Photograph {
            width: width as u32,
            height: height as u32,
            radiance: vec![[1.0; 3]; width * height],
            coverage: Some((0..width * height).map(covered).collect()),
            usable,
            clipped: None,
            crop: None,
        };
        let inside = inside(&photograph);
        let at = |x: usize, y: usize| inside[y * width + x];
        assert!(at(8, 8) && !at(7, 8), "three pixels off the outline");
        assert!(at(16, 8) && !at(17, 8) && !at(12, 2), "and off the edges");
        assert!(!at(10, 8), "no data");
    }
}
