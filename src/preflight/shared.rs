//! What views have in common: how many see each point of the surface, and whether their exposures agree.
//!
//! Points are spread evenly over the surface's area. The exposure of a view is compared by the median, over the points
//! that it shares with others, of the ratio of its radiance to the median of the other views that see the point: diffuse
//! light is the same in all views, and highlights are few enough to leave a median alone.

use crate::capture::{Capture, Mesh, SurfacePoint, View};
use crate::surface::ViewSurface;
use glam::{DVec2, Vec2};
use rayon::prelude::*;

/// Points on the surface that are examined.
const POINTS: usize = 20_000;

/// Points that a view must share with others before its exposure is judged.
const ENOUGH: usize = 100;

/// Least cosine between normal and view at which radiance is compared.
const LEAST_COSINE: f32 = 0.3;

/// What views have in common.
pub(super) struct Shared {
    /// Share of the surface seen by no view, one, two, and three or more.
    pub seen_by: [f64; 4],
    /// Relative exposure of each view, if it shares enough points.
    pub exposures: Vec<Option<f64>>,
}

impl Shared {
    /// Examines the views; one surface per view.
    pub(super) fn new(capture: &Capture, surfaces: &[ViewSurface]) -> Self {
        let points = spread(&capture.mesh, POINTS);
        let seen: Vec<Vec<(usize, f64)>> = points
            .par_iter()
            .map(|point| seen_in(capture, surfaces, point))
            .collect();
        let mut counts = [0_usize; 4];
        for views in &seen {
            counts[views.len().min(3)] += 1;
        }
        let mut ratios = vec![Vec::new(); capture.views.len()];
        for views in &seen {
            for &(view, radiance) in views {
                let mut others: Vec<f64> = views
                    .iter()
                    .filter(|(other, radiance)| *other != view && *radiance > 0.0)
                    .map(|(_, radiance)| *radiance)
                    .collect();
                if let (Some(middle), true) = (median(&mut others), radiance > 0.0) {
                    ratios[view].push(radiance / middle);
                }
            }
        }
        Self {
            seen_by: counts.map(|count| count as f64 / seen.len().max(1) as f64),
            exposures: ratios
                .iter_mut()
                .map(|ratios| {
                    if ratios.len() < ENOUGH {
                        None
                    } else {
                        median(ratios)
                    }
                })
                .collect(),
        }
    }
}

/// The views that see a point, with the mean radiance of RGB there; zero where it is too grazing to compare or not data.
fn seen_in(capture: &Capture, surfaces: &[ViewSurface], point: &SurfacePoint) -> Vec<(usize, f64)> {
    let mut out = Vec::new();
    for (i, (view, surface)) in capture.views.iter().zip(surfaces).enumerate() {
        let to_eye = (view.camera.position().as_vec3() - point.position).normalize_or_zero();
        let cosine = point.normal.dot(to_eye);
        if cosine <= 0.0 {
            continue;
        }
        let Some(at) = surface.sees(&view.camera, point.position) else {
            continue;
        };
        let radiance = if cosine > LEAST_COSINE {
            sample(view, at)
        } else {
            0.0
        };
        out.push((i, radiance));
    }
    out
}

/// Mean of RGB at the pixel of a coordinate, zero where it is not data.
fn sample(view: &View, at: DVec2) -> f64 {
    let photograph = &view.photograph;
    let i = at.y as usize * photograph.width as usize + at.x as usize;
    if !photograph.usable[i] {
        return 0.0;
    }
    photograph.radiance[i]
        .iter()
        .map(|&v| f64::from(v))
        .sum::<f64>()
        / 3.0
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
