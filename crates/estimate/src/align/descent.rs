//! Least squares over similarity transforms, by Levenberg and Marquardt's method with numerical derivatives.

use faer::linalg::solvers::Solve;
use faer::{Col, Mat, Side};
use glam::DVec3;

use super::{Similarity, Stop};

/// Numbers of a transform.
const UNKNOWNS: usize = 7;
/// Dampings tried for one step.
const TRIES: usize = 5;
/// A step that gains less than this part is the last.
const GAIN: f64 = 1e-4;

/// How to descend.
pub(super) struct Descent<'a> {
    /// The mesh's centre, about which turns and scalings go.
    pub(super) centre: DVec3,
    /// Its radius, in parts of which shifts are counted.
    pub(super) radius: f64,
    /// Step of the numerical derivatives, radians and parts of the radius.
    pub(super) step: f64,
    /// Most steps.
    pub(super) steps: usize,
    /// Whether to stop where it is.
    pub(super) stop: Stop<'a>,
}

impl Descent<'_> {
    /// The transform from `start` on that makes the sum of squares of the residuals least.
    pub(super) fn settle(
        &self,
        start: Similarity,
        residuals_of: impl Fn(&Similarity) -> Vec<f32>,
    ) -> Similarity {
        let mut transform = start;
        let mut residuals = residuals_of(&transform);
        let mut damping = 1e-3;
        for _ in 0..self.steps {
            let columns = self.derivatives(&transform, &residuals, &residuals_of);
            if (self.stop)() {
                break;
            }
            let before = cost(&residuals);
            let mut best = None;
            for _ in 0..TRIES {
                let Some(by) = solve(&columns, &residuals, damping) else {
                    break;
                };
                let next = self.nudged(&transform, &by);
                let after = residuals_of(&next);
                if cost(&after) < before {
                    best = Some((next, after));
                    damping = (damping * 0.2).max(1e-7);
                    break;
                }
                damping *= 8.0;
            }
            let Some((next, after)) = best else { break };
            let gained = 1.0 - cost(&after) / before;
            (transform, residuals) = (next, after);
            if gained < GAIN {
                break;
            }
        }
        transform
    }

    /// How far the numbers of a transform are from being told by the residuals: the least eigenvalue of the normal equations
    /// over the largest, 0 where some change of the transform changes nothing.
    pub(super) fn condition(
        &self,
        transform: &Similarity,
        residuals_of: impl Fn(&Similarity) -> Vec<f32>,
    ) -> f64 {
        let residuals = residuals_of(transform);
        let columns = self.derivatives(transform, &residuals, &residuals_of);
        let eigenvalues = normal(&columns).self_adjoint_eigenvalues(Side::Lower);
        let Some((&least, &largest)) = eigenvalues
            .as_ref()
            .ok()
            .and_then(|e| e.first().zip(e.last()))
        else {
            return 0.0;
        };
        least.max(0.0) / largest.max(f64::MIN_POSITIVE)
    }

    fn nudged(&self, transform: &Similarity, by: &[f64; UNKNOWNS]) -> Similarity {
        transform.nudged(by, self.centre, self.radius * transform.scale)
    }

    /// Derivatives of the residuals, one column per number of the transform.
    fn derivatives(
        &self,
        transform: &Similarity,
        residuals: &[f32],
        residuals_of: impl Fn(&Similarity) -> Vec<f32>,
    ) -> Vec<Vec<f32>> {
        (0..UNKNOWNS)
            .take_while(|_| !(self.stop)())
            .map(|k| {
                let mut by = [0.0; UNKNOWNS];
                by[k] = self.step;
                let moved = residuals_of(&self.nudged(transform, &by));
                let rows = moved.iter().zip(residuals);
                rows.map(|(a, b)| (a - b) / self.step as f32).collect()
            })
            .collect()
    }
}

pub(super) fn cost(residuals: &[f32]) -> f64 {
    dot(residuals, residuals)
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(a, b)| f64::from(*a) * f64::from(*b))
        .sum()
}

/// The normal equations' matrix.
fn normal(columns: &[Vec<f32>]) -> Mat<f64> {
    Mat::from_fn(UNKNOWNS, UNKNOWNS, |i, j| dot(&columns[i], &columns[j]))
}

/// The step that makes residuals with these derivatives least, held back by `damping` times the diagonal.
fn solve(columns: &[Vec<f32>], residuals: &[f32], damping: f64) -> Option<[f64; UNKNOWNS]> {
    let mut matrix = normal(columns);
    let scale = (0..UNKNOWNS).map(|i| matrix[(i, i)]).fold(0.0, f64::max);
    for i in 0..UNKNOWNS {
        // What the residuals don't show is left as it is.
        matrix[(i, i)] = matrix[(i, i)] * (1.0 + damping) + 1e-9 * scale;
    }
    let rhs = Col::from_fn(UNKNOWNS, |i| -dot(&columns[i], residuals));
    let step = matrix.llt(Side::Lower).ok()?.solve(rhs);
    Some(std::array::from_fn(|i| step[i])).filter(|step| step.iter().all(|s| s.is_finite()))
}
