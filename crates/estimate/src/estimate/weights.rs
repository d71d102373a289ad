//! Robust weights of rows and the noise level they imply.

use glam::Vec3;
use rayon::prelude::*;

use super::design::Design;
use super::observations::{Observations, Point, Row};
use rekindle_scene::reflectance::Brdf;

/// Residuals past this many standard deviations lose weight (Huber's constant for 95 % efficiency).
const HUBER: f32 = 1.345;

/// How much of a row's local image detail counts as interpolation noise.
pub const DETAIL_SHARE: f32 = 0.3;

/// Points that are worth a thread.
const POINTS_AT_ONCE: usize = 512;

/// What a fit left over, row by row.
#[derive(Clone, Debug, Default)]
pub struct Residuals {
    /// Measured − predicted, RGB, per row, each point's best diffuse colour taken out; zero where a bound is met.
    pub values: Vec<[f32; 3]>,
    /// Standard deviation of the noise of a row without image detail, per channel.
    pub noise: f32,
}

impl Residuals {
    /// Sum of the residuals' lengths.
    pub fn absolute_sum(&self) -> f64 {
        self.values.iter().map(|&r| f64::from(magnitude(r))).sum()
    }
}

/// Standard deviation of a row's noise, per channel.
pub fn deviation(noise: f32, detail: f32) -> f32 {
    noise.hypot(DETAIL_SHARE * detail)
}

/// Root mean square over the channels.
pub fn magnitude(r: [f32; 3]) -> f32 {
    (r.iter().map(|c| c * c).sum::<f32>() / 3.0).sqrt()
}

/// Weights before any fit: by image detail alone, in relation to its median; none for bounds, which say nothing as long as there is
/// nothing that may contradict them.
pub fn initial_weights(design: &Design<'_>) -> Vec<f32> {
    let rows = &design.observations.rows;
    let mut details: Vec<f32> = rows.iter().map(|r| r.detail).collect();
    let typical = median(&mut details).max(1e-6);
    let of = |r: &Row| {
        if r.is_bound {
            0.0
        } else {
            (1.0 + (r.detail / typical).powi(2)).recip()
        }
    };
    rows.iter().map(of).collect()
}

/// Residuals of predicted specular radiance, one RGB value per row, under the weights that eliminate the diffuse colours.
pub fn residuals(
    design: &Design<'_>,
    brdf: &Brdf,
    weights: &[f32],
    predicted: &[[f32; 3]],
) -> Residuals {
    let mut values = predicted.to_vec();
    let rows = &design.observations.rows;
    for point in &design.observations.points {
        for k in point.rows.clone() {
            for (value, measured) in values[k].iter_mut().zip(rows[k].radiance) {
                *value = measured - *value;
            }
        }
    }
    eliminate_all(design.observations, brdf, weights, &mut values);
    for (row, value) in rows.iter().zip(&mut values) {
        if row.is_bound && value.iter().sum::<f32>() <= 0.0 {
            *value = [0.0; 3];
        }
    }
    let noise = noise_level(design, weights, &values);
    Residuals { values, noise }
}

/// What the rows of a design show without any light.
pub fn dark_residuals(design: &Design<'_>, brdf: &Brdf, weights: &[f32]) -> Residuals {
    let none = vec![[0.0; 3]; design.observations.rows.len()];
    residuals(design, brdf, weights, &none)
}

/// What takes the best diffuse colour of each point out of any values of its rows; see [`transmitted_share`].
pub struct Elimination<'o> {
    points: &'o [Point],
    shares: Vec<(f32, f32)>,
}

impl<'o> Elimination<'o> {
    /// Under these weights, where `brdf` is the main lobe.
    pub fn of(observations: &'o Observations, brdf: &Brdf, weights: &[f32]) -> Self {
        let Observations { points, rows, .. } = observations;
        let glosses = observations.glosses.iter();
        let brdfs: Vec<Brdf> = glosses.map(|&gloss| brdf.at(gloss)).collect();
        let mut shares = vec![(0.0, 0.0); rows.len()];
        each_point(points, &mut shares, |point, shares| {
            let own = point.rows.clone();
            let brdf = &brdfs[point.gloss];
            let of_point = transmitted_share(brdf, &rows[own.clone()], &weights[own]);
            shares.copy_from_slice(&of_point);
        });
        Self { points, shares }
    }

    /// Takes it out of one RGB value per row.
    pub fn apply(&self, values: &mut [[f32; 3]]) {
        each_point(self.points, values, |point, values| {
            take_out(&self.shares[point.rows.clone()], values);
        });
    }
}

/// Does something to the values of each point's rows, which follow on one another.
fn each_point<T: Send>(points: &[Point], values: &mut [T], each: impl Fn(&Point, &mut [T]) + Sync) {
    let mut rest = values;
    let own = points.iter().map(|point| {
        let own = rest.split_off_mut(..point.rows.len());
        (point, own.unwrap_or_default())
    });
    let own: Vec<(&Point, &mut [T])> = own.collect();
    let own = own.into_par_iter().with_min_len(POINTS_AT_ONCE);
    own.for_each(|(point, values)| each(point, values));
}

/// Takes the best diffuse colour of each point out of one RGB value per row, where `brdf` is the main lobe.
pub fn eliminate_all(
    observations: &Observations,
    brdf: &Brdf,
    weights: &[f32],
    values: &mut [[f32; 3]],
) {
    Elimination::of(observations, brdf, weights).apply(values);
}

/// Of each of a point's rows, the part of it that goes into the point's diffuse colour, and the part of the diffuse colour
/// that it shows.
pub fn transmitted_share(brdf: &Brdf, rows: &[Row], weights: &[f32]) -> Vec<(f32, f32)> {
    let transmittance: Vec<f32> = rows.iter().map(|row| row.diffuse_share(brdf)).collect();
    shares(&transmittance, weights)
}

/// The same of rows that show these parts of the diffuse colour.
pub fn shares(transmittance: &[f32], weights: &[f32]) -> Vec<(f32, f32)> {
    let total: f32 = weights
        .iter()
        .zip(transmittance)
        .map(|(w, t)| w * t * t)
        .sum();
    let part = if total > 0.0 { total.recip() } else { 0.0 };
    weights
        .iter()
        .zip(transmittance)
        .map(|(w, t)| (w * t * part, *t))
        .collect()
}

/// Takes the best multiple of the diffuse transmittance out of one point's rows.
pub fn eliminate(brdf: &Brdf, rows: &[Row], weights: &[f32], values: &mut [[f32; 3]]) {
    take_out(&transmitted_share(brdf, rows, weights), values);
}

fn take_out(share: &[(f32, f32)], values: &mut [[f32; 3]]) {
    let mut mean = [0.0_f32; 3];
    for ((into, _), v) in share.iter().zip(values.iter()) {
        for (m, v) in mean.iter_mut().zip(v) {
            *m += into * v;
        }
    }
    for ((_, t), v) in share.iter().zip(values.iter_mut()) {
        for (m, v) in mean.iter().zip(v) {
            *v -= t * m;
        }
    }
}

/// Logarithm of each point's diffuse radiance, RGB, where its rows' specular radiance is `shown`.
pub fn log_diffuse(
    observations: &Observations,
    brdf: &Brdf,
    weights: &[f32],
    shown: &[[f32; 3]],
) -> Vec<Vec3> {
    let colour = |point: &Point| {
        let (mut sum, mut total) = (Vec3::ZERO, 0.0);
        for k in point.rows.clone() {
            let row = &observations.rows[k];
            let through = row.diffuse_share(brdf);
            let diffuse = Vec3::from(row.radiance) - Vec3::from(shown[k]);
            sum += weights[k] * through * diffuse;
            total += weights[k] * through * through;
        }
        let colour = (sum / total.max(f32::MIN_POSITIVE)).max(Vec3::splat(1e-4));
        Vec3::from(colour.to_array().map(f32::ln))
    };
    observations.points.iter().map(colour).collect()
}

/// Noise from the median residual of the rows that have a weight, with the degrees of freedom that the elimination took given
/// back.
fn noise_level(design: &Design<'_>, weights: &[f32], residuals: &[[f32; 3]]) -> f32 {
    let mut magnitudes = Vec::with_capacity(residuals.len());
    for point in &design.observations.points {
        let heard = point.rows.clone().filter(|&k| weights[k] > 0.0);
        let m = heard.clone().count() as f32;
        if m > 1.0 {
            let correction = (m / (m - 1.0)).sqrt();
            magnitudes.extend(heard.map(|k| correction * magnitude(residuals[k])));
        }
    }
    // The median of the root mean square of three normal deviates is 0.888 standard deviations.
    median(&mut magnitudes) / 0.888
}

/// Huber weights over the variance of each row; none for bounds that are met.
pub fn robust_weights(design: &Design<'_>, residuals: &Residuals) -> Vec<f32> {
    let floor = residuals.noise.max(1e-7);
    design
        .observations
        .rows
        .iter()
        .zip(&residuals.values)
        .map(|(row, &r)| {
            if row.is_bound && r == [0.0; 3] {
                return 0.0;
            }
            let s = deviation(floor, row.detail);
            let t = magnitude(r) / s;
            // Relative to the floor, so that weights are of order one.
            (floor / s).powi(2) * if t <= HUBER { 1.0 } else { HUBER / t }
        })
        .collect()
}

/// Huber weights about the mean squared residual, of which the second value is, in place of the median: where the model is
/// wrong for most highlights, the median is of the rows without any and takes all highlights for outliers.
pub fn mean_weights(design: &Design<'_>, brdf: &Brdf, predicted: &[[f32; 3]]) -> (Vec<f32>, f64) {
    const ROUNDS: usize = 3;
    let mut weights = initial_weights(design);
    let mut noise = 0.0;
    for _ in 0..ROUNDS {
        let left = residuals(design, brdf, &weights, predicted);
        noise = weighted_rms(&weights, &left);
        weights = robust_weights(design, &Residuals { noise, ..left });
    }
    (weights, f64::from(noise).powi(2).max(1e-14))
}

/// Huber's objective over all rows in units of the squared scale of the observations, for a given noise level.
pub fn robust_objective(design: &Design<'_>, residuals: &Residuals, noise: f32) -> f64 {
    let floor = noise.max(1e-7);
    design
        .observations
        .rows
        .iter()
        .zip(&residuals.values)
        .map(|(row, &r)| {
            let s = deviation(floor, row.detail);
            let t = f64::from(magnitude(r) / s);
            let h = f64::from(HUBER);
            f64::from(floor * floor) * if t <= h { t * t } else { h * (2.0 * t - h) }
        })
        .sum()
}

/// Weighted root mean square of the residuals, in units of the observations' scale.
pub fn weighted_rms(weights: &[f32], residuals: &Residuals) -> f32 {
    let (mut sum, mut total) = (0.0_f64, 0.0_f64);
    for (&w, &r) in weights.iter().zip(&residuals.values) {
        sum += f64::from(w * magnitude(r).powi(2));
        total += f64::from(w);
    }
    (sum / total.max(1e-30)).sqrt() as f32
}

/// The middle value; 0 of nothing. Reorders its input.
pub fn median(values: &mut [f32]) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}
