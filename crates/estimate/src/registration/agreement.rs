//! What views have in common: how many see each point of the surface, and whether they agree on its radiance.
//!
//! Points are spread evenly over the surface's area. Diffuse light is the same in all views, and highlights are few enough
//! to leave medians alone: a view whose radiances all differ by one factor was exposed differently, and cameras that look
//! elsewhere than they are said to make views disagree where the texture changes.

use faer::linalg::solvers::Solve;
use faer::{Col, Mat};
use glam::{DVec2, Vec3};
use rayon::prelude::*;
use rekindle_base::math::{centred, median};
use rekindle_capture::{Mesh, Photograph, SurfacePoint, View};
use rekindle_scene::surface::ViewSurface;

/// Points that a view must share with others before its exposure is judged.
const ENOUGH: usize = 100;

/// Least cosine between normal and view at which radiance is compared: at lower ones a varnish reflects what the diffuse
/// body then lacks.
const LEAST_COSINE: f32 = 0.5;

/// Rounds of reweighting, and where Cauchy's weights fall to a half, in median sizes.
const ROUNDS: usize = 12;
const CAUCHY: f64 = 2.0;

/// How much brighter a view is than the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// Relative to the views' median, which no single view can move far.
    pub factor: f64,
    /// Standard error of its logarithm.
    pub error: f64,
}

/// Points of the surface and the views that see them.
pub struct Agreement {
    views: usize,
    /// Of each point, the views that see it, with its radiance there, RGB: zero where it is too grazing to compare or no data.
    points: Vec<Vec<(usize, [f64; 3])>>,
    /// Which of [`FACINGS`] sides each point faces.
    facing: Vec<usize>,
}

/// Sides that a point may face: along each axis, to and fro.
const FACINGS: usize = 6;

/// The side that a normal faces.
fn facing(normal: Vec3) -> usize {
    let axis = normal.abs().max_position();
    2 * axis + usize::from(normal[axis] < 0.0)
}

/// The mean of R, G and B.
fn gray(radiance: [f64; 3]) -> f64 {
    radiance.iter().sum::<f64>() / 3.0
}

impl Agreement {
    /// Looks at about `count` points from all views; one surface per view.
    pub fn new(mesh: &Mesh, views: &[View], surfaces: &[ViewSurface], count: usize) -> Self {
        let (points, facing) = mesh
            .spread(count)
            .into_par_iter()
            .map(|(triangle, at)| {
                let point = mesh.point(triangle, at);
                (seen_in(views, surfaces, &point), facing(point.normal))
            })
            .unzip();
        Self {
            views: views.len(),
            points,
            facing,
        }
    }

    /// Points that are at hand, each with the views that see it and its radiance there, RGB.
    pub fn of(views: usize, points: Vec<Vec<(usize, [f64; 3])>>) -> Self {
        Self {
            views,
            facing: vec![0; points.len()],
            points,
        }
    }

    /// The points that face one side, or those that don't.
    fn part(&self, side: usize, is_other: bool) -> Self {
        let placed = self.points.iter().zip(&self.facing);
        let (points, facing) = placed
            .filter(|&(_, facing)| (*facing != side) == is_other)
            .map(|(seen, facing)| (seen.clone(), *facing))
            .unzip();
        Self {
            views: self.views,
            points,
            facing,
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

    /// Relative exposure of each view, if all share enough points: least squares on the logarithms of the radiances, each
    /// point's own taken out, with weights that leave highlights alone.
    pub fn exposures(&self) -> Vec<Option<Exposure>> {
        self.exposures_of(gray)
    }

    /// How much brighter each view is than the others in each channel, if all share enough points.
    pub fn gains(&self) -> Option<Vec<[f64; 3]>> {
        let channels = [0, 1, 2].map(|c| self.exposures_of(|radiance| radiance[c]));
        let gain = |view: usize, c: usize| channels[c][view].map(|exposure| exposure.factor);
        (0..self.views)
            .map(|view| Some([gain(view, 0)?, gain(view, 1)?, gain(view, 2)?]))
            .collect()
    }

    /// Exposures as one number of each radiance has them.
    fn exposures_of(&self, number: impl Fn([f64; 3]) -> f64) -> Vec<Option<Exposure>> {
        let rows: Vec<Vec<(usize, f64)>> = self
            .points
            .iter()
            .map(|views| {
                let compared = views.iter().map(|&(view, r)| (view, number(r)));
                let compared = compared.filter(|(_, r)| *r > 0.0);
                compared.map(|(view, r)| (view, r.ln())).collect()
            })
            .filter(|row: &Vec<_>| row.len() >= 2)
            .collect();
        let none = vec![None; self.views];
        let mut shared = vec![0; self.views];
        for &(view, _) in rows.iter().flatten() {
            shared[view] += 1;
        }
        if self.views < 2 || shared.iter().any(|&count| count < ENOUGH) {
            return none;
        }
        let mut weights: Vec<Vec<f64>> = rows.iter().map(|row| vec![1.0; row.len()]).collect();
        let mut found = None;
        for _ in 0..ROUNDS {
            found = even_out(&rows, &weights, self.views);
            let Some((logs, _)) = &found else {
                return none;
            };
            reweight(&rows, &mut weights, logs);
        }
        let Some((logs, curvatures)) = found else {
            return none;
        };
        let spread = scatter(&rows, &weights, &logs);
        let common = median(&mut logs.clone()).unwrap_or(0.0);
        logs.iter()
            .zip(curvatures)
            .map(|(log, curvature)| {
                Some(Exposure {
                    factor: (log - common).exp(),
                    error: spread / curvature.sqrt(),
                })
            })
            .collect()
    }

    /// The same with each view divided by how much too bright it is in each channel.
    #[must_use]
    pub fn evened(&self, gains: &[[f64; 3]]) -> Self {
        let divided = |r: [f64; 3], gain: [f64; 3]| [0, 1, 2].map(|c| r[c] / gain[c]);
        let even = |row: &Vec<(usize, [f64; 3])>| {
            row.iter()
                .map(|&(v, r)| (v, divided(r, gains[v])))
                .collect()
        };
        Self {
            views: self.views,
            points: self.points.iter().map(even).collect(),
            facing: self.facing.clone(),
        }
    }

    /// By how much the views disagree: the median over points of the mean relative deviation from the point's median.
    pub fn disagreement(&self) -> f64 {
        median(&mut self.disagreements()).unwrap_or(0.0)
    }

    /// The same with each point evened by the gains that points say which face other sides: exposures hold for all of them, and what a flat
    /// side mirrors as a whole for itself. Where nobody else tells gains, all stays as it is.
    pub fn disagreement_evened_by_others(&self) -> f64 {
        let of_side = |side: usize| {
            let own = self.part(side, false);
            match self.part(side, true).gains() {
                Some(gains) => own.evened(&gains).disagreements(),
                None => own.disagreements(),
            }
        };
        let mut all: Vec<f64> = (0..FACINGS)
            .into_par_iter()
            .flat_map_iter(of_side)
            .collect();
        median(&mut all).unwrap_or(0.0)
    }

    fn disagreements(&self) -> Vec<f64> {
        self.points.iter().filter_map(|v| disagreement(v)).collect()
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

/// Mean deviation of a point's radiances from their median, relative to it, in the mean over the channels.
fn disagreement(views: &[(usize, [f64; 3])]) -> Option<f64> {
    let of = |c: usize| channel_disagreement(views.iter().map(|v| v.1[c]));
    Some((of(0)? + of(1)? + of(2)?) / 3.0)
}

fn channel_disagreement(radiances: impl Iterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = radiances.filter(|&r| r > 0.0).collect();
    if values.len() < 2 {
        return None;
    }
    let middle = median(&mut values.clone())?;
    let sum: f64 = values.iter().map(|v| (v - middle).abs()).sum();
    Some(sum / (values.len() as f64 * middle))
}

/// Logarithms of the views' exposures, whose sum is zero, by weighted least squares with each point's own logarithm
/// eliminated, and the sum of the weights that each rests on. `None` where some views have no points in common with others.
fn even_out(
    rows: &[Vec<(usize, f64)>],
    weights: &[Vec<f64>],
    views: usize,
) -> Option<(Vec<f64>, Vec<f64>)> {
    let mut gram = Mat::<f64>::zeros(views, views);
    let mut right = vec![0.0; views];
    for (row, weights) in rows.iter().zip(weights) {
        let total: f64 = weights.iter().sum();
        let mean = row.iter().zip(weights).map(|(r, w)| w * r.1).sum::<f64>() / total;
        for (&(view, log), &w) in row.iter().zip(weights) {
            right[view] += w * (log - mean);
            gram[(view, view)] += w;
            for (&(other, _), &v) in row.iter().zip(weights) {
                gram[(view, other)] -= w * v / total;
            }
        }
    }
    let solution = centred::factor(&gram)?.solve(&Col::from_fn(views, |v| right[v]));
    let logs: Vec<f64> = solution.iter().copied().collect();
    let curvatures = (0..views).map(|v| gram[(v, v)]).collect();
    logs.iter()
        .all(|l| l.is_finite())
        .then_some((logs, curvatures))
}

/// What each row differs by from its point's weighted mean, the exposures taken out.
fn differences<'a>(
    row: &'a [(usize, f64)],
    weights: &[f64],
    logs: &'a [f64],
) -> impl Iterator<Item = f64> + 'a {
    let total: f64 = weights.iter().sum();
    let evened = row.iter().map(|&(view, log)| log - logs[view]);
    let mean = evened.clone().zip(weights).map(|(v, w)| v * w).sum::<f64>() / total;
    evened.map(move |v| v - mean)
}

/// Cauchy's weights for the differences that are left, about their median size.
fn reweight(rows: &[Vec<(usize, f64)>], weights: &mut [Vec<f64>], logs: &[f64]) {
    let mut sizes: Vec<f64> = rows
        .iter()
        .zip(&*weights)
        .flat_map(|(row, weights)| differences(row, weights, logs).map(f64::abs))
        .collect();
    let scale = median(&mut sizes).unwrap_or(0.0).max(f64::MIN_POSITIVE);
    for (row, weights) in rows.iter().zip(weights) {
        let left: Vec<f64> = differences(row, weights, logs).collect();
        for (weight, left) in weights.iter_mut().zip(left) {
            *weight = (1.0 + (left / (CAUCHY * scale)).powi(2)).recip();
        }
    }
}

/// Weighted root mean square of the differences that are left.
fn scatter(rows: &[Vec<(usize, f64)>], weights: &[Vec<f64>], logs: &[f64]) -> f64 {
    let (mut sum, mut total) = (0.0, 0.0);
    for (row, weights) in rows.iter().zip(weights) {
        for (left, w) in differences(row, weights, logs).zip(weights) {
            sum += w * left * left;
            total += w;
        }
    }
    (sum / f64::max(total, f64::MIN_POSITIVE)).sqrt()
}

/// The views that see a point, with the radiance there, RGB; zero where it is too grazing to compare or not data.
fn seen_in(
    views: &[View],
    surfaces: &[ViewSurface],
    point: &SurfacePoint,
) -> Vec<(usize, [f64; 3])> {
    let mut out = Vec::new();
    for (i, (view, surface)) in views.iter().zip(surfaces).enumerate() {
        let to_eye = (view.camera.position().as_vec3() - point.position).normalize_or_zero();
        let cosine = point.normal.dot(to_eye);
        if cosine <= 0.0 {
            continue;
        }
        let Some(at) = surface.sees(point.position) else {
            continue;
        };
        let radiance = if cosine > LEAST_COSINE {
            sample(&view.photograph, at)
        } else {
            [0.0; 3]
        };
        out.push((i, radiance));
    }
    out
}

/// RGB at a pixel coordinate, bilinear; zero where a pixel that it needs is no data.
fn sample(photograph: &Photograph, at: DVec2) -> [f64; 3] {
    let corner = (at - 0.5).floor();
    let part = (at - 0.5 - corner).as_vec2();
    let first = corner.y as usize * photograph.width as usize + corner.x as usize;
    let mut sum = Vec3::ZERO;
    for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let i = first + y * photograph.width as usize + x;
        if !photograph.usable.get(i).copied().unwrap_or(false) {
            return [0.0; 3];
        }
        let weight = |one: bool, part: f32| if one { part } else { 1.0 - part };
        let weight = weight(x == 1, part.x) * weight(y == 1, part.y);
        sum += weight * Vec3::from(photograph.radiance[i]);
    }
    sum.as_dvec3().to_array()
}

#[cfg(test)]
mod tests {
    use rekindle_base::math::random::Random;

    use super::*;

    /// Three views of points that face all sides. The last sees mostly one side, and of each side so much brighter as `brighter` says.
    fn seen(brighter: impl Fn(usize) -> f64) -> Agreement {
        let random = Random::new(3, 0);
        let point = |i: usize| {
            let side = i % (FACINGS + 4);
            let facing = side.min(FACINGS - 1);
            let own = random.of(i as u64);
            let albedo = 0.2 + 0.6 * own.uniform(0);
            let radiance = |view: usize, factor: f64| {
                let noise = 1.0 + 0.01 * own.normal(1 + view as u64);
                (view, [albedo * factor * noise; 3])
            };
            let mut views = vec![radiance(0, 1.0), radiance(1, 1.0)];
            if facing == FACINGS - 1 || i.is_multiple_of(7) {
                views.push(radiance(2, brighter(facing)));
            }
            (views, facing)
        };
        let (points, facing) = (0..3000).map(point).unzip();
        Agreement {
            views: 3,
            points,
            facing,
        }
    }

    #[test]
    fn what_one_side_mirrors_is_no_exposure() {
        let exposed = seen(|_| 1.4);
        let mirroring = seen(|side| if side == FACINGS - 1 { 1.4 } else { 1.0 });
        for agreement in [&exposed, &mirroring] {
            let gains = agreement.gains().expect("enough is shared");
            assert!((gains[2][0] - 1.4).abs() < 0.02, "{gains:?}");
            let evened = agreement.evened(&gains).disagreement();
            assert!(evened < 0.7 * agreement.disagreement());
        }
        let evened = |agreement: &Agreement| {
            agreement.disagreement_evened_by_others() / agreement.disagreement()
        };
        assert!(evened(&exposed) < 0.7, "{}", evened(&exposed));
        assert!(evened(&mirroring) > 0.95, "{}", evened(&mirroring));
    }
}
