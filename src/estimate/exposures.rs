//! Do the views' exposures agree, as far as the light found explains their differences?
//!
//! A view that is brighter than it should be by the factor 1 + a has rows y (1 − a) = t D + s, where s is the specular part.
//! With the points' diffuse colours D eliminated that is linear in a, and so are small differences of exposure found by
//! one least-squares problem with one unknown a view, whose sum is zero.

use faer::linalg::solvers::Solve;
use faer::{Col, Mat, Side};

use super::observations::{Point, Row};
use super::state::State;
use super::weights::transmitted_share;

/// Only differences past this, and past this many standard errors, are any.
const LEAST: f64 = 0.003;
const SURE: f64 = 5.0;
/// Points at which more than this share of a row is specular say little: coarse cells are not where the lamps are.
const MOST_SPECULAR: f32 = 0.1;
/// Every view has to have this many rows.
const ENOUGH: usize = 50;

/// How much brighter each view is than the common scale, if any differs; `views` is how many there are.
pub fn differing(state: &State<'_>, views: usize) -> Option<Vec<f64>> {
    let (excess, errors) = excess(state, views)?;
    let differs = |(a, e): (&f64, &f64)| a.abs() > LEAST.max(SURE * e);
    excess
        .iter()
        .zip(&errors)
        .any(differs)
        .then(|| excess.iter().map(|a| 1.0 + a).collect())
}

/// The excess a of each view and its standard error, with one group a point.
fn excess(state: &State<'_>, views: usize) -> Option<(Vec<f64>, Vec<f64>)> {
    let observations = state.design.observations;
    let diffuse: Vec<&Point> = observations
        .points
        .iter()
        .filter(|point| {
            point.rows.clone().all(|k| {
                let specular: f32 = state.specular(k).iter().sum();
                let all: f32 = observations.rows[k].radiance.iter().sum();
                specular <= MOST_SPECULAR * all
            })
        })
        .collect();
    let mut counts = vec![0; views];
    let mut gram = Mat::<f64>::zeros(views, views);
    let mut right = vec![0.0; views];
    for point in &diffuse {
        let columns = columns(state, point);
        for (j, (view, column)) in columns.iter().enumerate() {
            counts[*view] += 1;
            right[*view] += inner(state, point, column, |k| state.residuals.values[k]);
            for (other, second) in &columns[..=j] {
                let product = inner(state, point, column, |k| second[k - point.rows.start]);
                gram[(*view, *other)] += product;
                if view != other {
                    gram[(*other, *view)] += product;
                }
            }
        }
    }
    if counts.iter().any(|&count| count < ENOUGH) {
        return None;
    }
    let mean = (0..views).map(|v| gram[(v, v)]).sum::<f64>() / views as f64;
    let held = Mat::from_fn(views, views, |i, j| gram[(i, j)] + mean);
    let factor = held.llt(Side::Lower).ok()?;
    let solution = factor.solve(&Col::from_fn(views, |v| right[v]));
    let mut spread = Mat::<f64>::zeros(views, views);
    for point in &diffuse {
        let columns = columns(state, point);
        let left = |k: usize| {
            let mut left = state.residuals.values[k];
            for (view, column) in &columns {
                for (l, c) in left.iter_mut().zip(column[k - point.rows.start]) {
                    *l -= solution[*view] as f32 * c;
                }
            }
            left
        };
        let pulls: Vec<(usize, f64)> = columns
            .iter()
            .map(|(view, column)| (*view, inner(state, point, column, left)))
            .collect();
        for &(i, a) in &pulls {
            for &(j, b) in &pulls {
                spread[(i, j)] += a * b;
            }
        }
    }
    let half = factor.solve(&spread);
    let covariance = factor.solve(&half.transpose().to_owned());
    let errors = (0..views).map(|v| covariance[(v, v)].max(0.0).sqrt());
    Some((solution.iter().copied().collect(), errors.collect()))
}

/// What an excess of each view that sees a point adds to its rows, the diffuse colour eliminated.
fn columns(state: &State<'_>, point: &Point) -> Vec<(usize, Vec<[f32; 3]>)> {
    let rows: &[Row] = &state.design.observations.rows[point.rows.clone()];
    let weights = &state.weights[point.rows.clone()];
    let share = transmitted_share(&state.brdf, rows.iter().map(|r| r.cos_view), weights);
    (0..rows.len())
        .map(|own| {
            let column = (0..rows.len()).map(|k| {
                let kept = if k == own { 1.0 } else { 0.0 };
                let factor = kept - share[own].0 * share[k].1;
                rows[own].radiance.map(|v| factor * v)
            });
            (rows[own].view, column.collect())
        })
        .collect()
}

/// Weighted product of a column and values of a point's rows.
fn inner(
    state: &State<'_>,
    point: &Point,
    column: &[[f32; 3]],
    values: impl Fn(usize) -> [f32; 3],
) -> f64 {
    point
        .rows
        .clone()
        .zip(column)
        .map(|(k, c)| {
            let product: f32 = c.iter().zip(values(k)).map(|(c, v)| c * v).sum();
            f64::from(state.weights[k] * product)
        })
        .sum()
}
