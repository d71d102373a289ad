//! What views have in common: how many see each point of the surface, and whether they agree on its radiance.
//!
//! Points are spread evenly over the surface's area. Diffuse light is the same in all views, and highlights are few enough
//! to leave medians alone: a view whose radiances all differ by one factor was exposed differently, and cameras that look
//! elsewhere than they are said to make views disagree where the texture changes.

use crate::capture::{Mesh, Photograph, SurfacePoint, View};
use crate::surface::ViewSurface;
use glam::{DVec2, Vec2, Vec3};
use rayon::prelude::*;

/// Points that a view must share with others before its exposure is judged.
const ENOUGH: usize = 100;

/// Least cosine between normal and view at which radiance is compared: at lower ones a varnish reflects what the diffuse
/// body then lacks.
const LEAST_COSINE: f32 = 0.5;

/// Rounds in which points and exposures take turns.
const ROUNDS: usize = 10;

/// How much brighter a view is than the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// Relative to the views' geometric mean.
    pub factor: f64,
    /// Standard error of its logarithm.
    pub error: f64,
}

/// Points of the surface and the views that see them.
pub struct Agreement {
    views: usize,
    /// Of each point, the views that see it, with the mean of its R, G and B there: zero where it is too grazing to compare
    /// or no data.
    points: Vec<Vec<(usize, f64)>>,
}

impl Agreement {
    /// Looks at about `count` points from all views; one surface per view.
    pub fn new(mesh: &Mesh, views: &[View], surfaces: &[ViewSurface], count: usize) -> Self {
        let points = spread(mesh, count)
            .par_iter()
            .map(|point| seen_in(views, surfaces, point))
            .collect();
        Self {
            views: views.len(),
            points,
        }
    }

    /// Share of the surface seen by no view, one, two, and three or more.
    pub fn seen_by(&self) -> [f64; 4] {
        let mut counts = [0_usize; 4];
        for views in &self.points {
            counts[views.len().min(3)] += 1;
        }
        counts.map(|count| count as f64 / self.points.len().max(1) as f64)
    }

    /// Relative exposure of each view that shares enough points: medians, over points, of logarithms less the point's own
    /// median over views, repeated with the exposures found.
    pub fn exposures(&self) -> Vec<Option<Exposure>> {
        let rows: Vec<Vec<(usize, f64)>> = self
            .points
            .iter()
            .map(|views| {
                let compared = views.iter().filter(|(_, radiance)| *radiance > 0.0);
                compared.map(|&(view, r)| (view, r.ln())).collect()
            })
            .filter(|row: &Vec<_>| row.len() >= 2)
            .collect();
        let mut logs = vec![0.0; self.views];
        let mut found = vec![None; self.views];
        for _ in 0..ROUNDS {
            let mut differences = vec![Vec::new(); self.views];
            for row in &rows {
                let mut values: Vec<f64> = row.iter().map(|&(v, log)| log - logs[v]).collect();
                let Some(middle) = median(&mut values) else {
                    continue;
                };
                for &(view, log) in row {
                    differences[view].push(log - middle);
                }
            }
            found = differences.iter_mut().map(|d| centre(d)).collect();
            let known: Vec<f64> = found.iter().flatten().map(|&(log, _)| log).collect();
            let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
            for (log, found) in logs.iter_mut().zip(&mut found) {
                if let Some((value, _)) = found {
                    *value -= mean;
                    *log = *value;
                }
            }
        }
        let exposure = |(log, error): (f64, f64)| Exposure {
            factor: log.exp(),
            error,
        };
        found.into_iter().map(|f| f.map(exposure)).collect()
    }

    /// By how much the views disagree less than in `other`, which has the same points: the mean, over the points that both
    /// compare, of the fall of the mean relative deviation from the median, and its standard error.
    pub fn gain_over(&self, other: &Self) -> (f64, f64) {
        let falls: Vec<f64> = self
            .points
            .iter()
            .zip(&other.points)
            .filter_map(|(now, before)| Some(disagreement(before)? - disagreement(now)?))
            .collect();
        let count = falls.len().max(1) as f64;
        let mean = falls.iter().sum::<f64>() / count;
        let squares: f64 = falls.iter().map(|f| (f - mean).powi(2)).sum();
        (mean, squares.sqrt() / count)
    }
}

/// Mean deviation of a point's radiances from their median, relative to it.
fn disagreement(views: &[(usize, f64)]) -> Option<f64> {
    let values: Vec<f64> = views.iter().map(|v| v.1).filter(|&r| r > 0.0).collect();
    if values.len() < 2 {
        return None;
    }
    let middle = median(&mut values.clone())?;
    let sum: f64 = values.iter().map(|v| (v - middle).abs()).sum();
    Some(sum / (values.len() as f64 * middle))
}

/// Median and its standard error, by the median absolute deviation, of enough values.
fn centre(values: &mut [f64]) -> Option<(f64, f64)> {
    if values.len() < ENOUGH {
        return None;
    }
    let middle = median(values)?;
    let mut off: Vec<f64> = values.iter().map(|v| (v - middle).abs()).collect();
    // As for a normal distribution.
    let spread = 1.4826 * median(&mut off)?;
    Some((middle, 1.2533 * spread / (values.len() as f64).sqrt()))
}

/// The views that see a point, with the mean radiance of RGB there; zero where it is too grazing to compare or not data.
fn seen_in(views: &[View], surfaces: &[ViewSurface], point: &SurfacePoint) -> Vec<(usize, f64)> {
    let mut out = Vec::new();
    for (i, (view, surface)) in views.iter().zip(surfaces).enumerate() {
        let to_eye = (view.camera.position().as_vec3() - point.position).normalize_or_zero();
        let cosine = point.normal.dot(to_eye);
        if cosine <= 0.0 {
            continue;
        }
        let Some(at) = surface.sees(&view.camera, point.position) else {
            continue;
        };
        let radiance = if cosine > LEAST_COSINE {
            sample(&view.photograph, at)
        } else {
            0.0
        };
        out.push((i, radiance));
    }
    out
}

/// Mean of RGB at a pixel coordinate, bilinear; zero where a pixel that it needs is no data.
fn sample(photograph: &Photograph, at: DVec2) -> f64 {
    let corner = (at - 0.5).floor();
    let part = (at - 0.5 - corner).as_vec2();
    let first = corner.y as usize * photograph.width as usize + corner.x as usize;
    let mut sum = 0.0;
    for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let i = first + y * photograph.width as usize + x;
        if !photograph.usable.get(i).copied().unwrap_or(false) {
            return 0.0;
        }
        let weight = |one: bool, part: f32| if one { part } else { 1.0 - part };
        let weight = weight(x == 1, part.x) * weight(y == 1, part.y);
        sum += weight * Vec3::from(photograph.radiance[i]).element_sum() / 3.0;
    }
    f64::from(sum)
}

fn median(values: &mut [f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    let even = values.len().is_multiple_of(2);
    let (lower, &mut upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    let below = lower.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    Some(if even { 0.5 * (below + upper) } else { upper })
}

/// Points spread evenly over the area of a mesh.
fn spread(mesh: &Mesh, count: usize) -> Vec<SurfacePoint> {
    let areas: Vec<f64> = mesh
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|v| mesh.positions[v as usize].as_dvec3());
            (b - a).cross(c - a).length()
        })
        .collect();
    let step = areas.iter().sum::<f64>() / count as f64;
    let mut points = Vec::with_capacity(count + 1);
    let mut owed = 0.5;
    for (triangle, area) in areas.iter().enumerate() {
        owed += area / step;
        while owed >= 1.0 {
            owed -= 1.0;
            // Roberts' R2 sequence, folded into the triangle.
            let k = points.len() as f64;
            let (u, v) = (
                (0.5 + 0.754_877_666 * k).fract(),
                (0.5 + 0.569_840_291 * k).fract(),
            );
            let (u, v) = if u + v > 1.0 {
                (1.0 - u, 1.0 - v)
            } else {
                (u, v)
            };
            points.push(mesh.point(triangle as u32, Vec2::new(u as f32, v as f32)));
        }
    }
    points
}
