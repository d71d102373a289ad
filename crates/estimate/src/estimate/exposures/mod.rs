//! Do the views' exposures agree, as far as the light found explains their differences?
//!
//! A view that is brighter than it should be by the factor 1 + a has rows y (1 − a) = t D + s, where s is the specular part.
//! With the points' diffuse colours D eliminated that is linear in a, and so are small differences of exposure found by
//! one least-squares problem with one unknown a view, whose sum is zero.

use faer::linalg::solvers::Solve;
use faer::{Col, Mat};

mod by_lights;

use super::observations::{Point, Row};
use super::state::State;
use super::weights::transmitted_share;
pub use by_lights::{ExposuresByLights, by_lights};
use rekindle_base::math::{centred, median};

/// Only differences past this, or where there are any past the other, and past this many standard errors, are any.
const LEAST: f64 = 0.003;
const LEAST_KNOWN: f64 = 0.001;
const SURE: f64 = 5.0;
/// Points at which more than this share of a row is specular say little: coarse cells are not where the lamps are.
const MOST_SPECULAR: f32 = 0.1;
/// Every view has to have this many rows.
const ENOUGH: usize = 50;
/// Exposures must account for this part of what is left over: where the model of light is not the object's, they take up some
/// of that.
const LEAST_EXPLAINED: f64 = 0.5;

/// How much brighter each view is than the common scale, if any differs; `views` is how many there are. Where exposures are
/// `known` to differ, this is how much is left of that.
pub fn differing(state: &State<'_>, views: usize, known: bool) -> Option<Vec<f64>> {
    let observations = state.design.observations;
    let points = observations.points.iter();
    let diffuse: Vec<&Point> = points.filter(|point| is_diffuse(state, point)).collect();
    let (excess, errors, explained) = excess(state, views, &diffuse)?;
    let least = if known { LEAST_KNOWN } else { LEAST };
    let differs = |(a, e): (&f64, &f64)| a.abs() > least.max(SURE * e);
    let matters = known || explained > LEAST_EXPLAINED;
    let differ = matters && excess.iter().zip(&errors).any(differs);
    differ.then(|| excess.iter().map(|a| 1.0 + a).collect())
}

/// Factors found before, nothing where there were none, and after: both.
pub fn together(before: &[f64], mut factors: Vec<f64>) -> Vec<f64> {
    for (factor, before) in factors.iter_mut().zip(before) {
        *factor *= before;
    }
    factors
}

/// Whether little of any of a point's rows is specular.
fn is_diffuse(state: &State<'_>, point: &Point) -> bool {
    point.rows.clone().all(|k| {
        let specular: f32 = state.specular(k).iter().sum();
        let all: f32 = state.design.observations.rows[k].radiance.iter().sum();
        specular <= MOST_SPECULAR * all
    })
}

/// The excess a of each view, as some points say, its standard error, with one group a point, and the part of the
/// weighted squared residuals that goes away with it.
fn excess(state: &State<'_>, views: usize, points: &[&Point]) -> Option<(Vec<f64>, Vec<f64>, f64)> {
    let inner = |point: &Point, column: &[[f32; 3]], values: &dyn Fn(usize) -> [f32; 3]| {
        inner(state, point, column, values)
    };
    let mut counts = vec![0; views];
    let mut gram = Mat::<f64>::zeros(views, views);
    let mut right = vec![0.0; views];
    let mut squares = 0.0;
    for point in points {
        let columns = columns(state, point);
        let all = &state.residuals.values[point.rows.clone()];
        squares += inner(point, all, &|k| state.residuals.values[k]);
        for (j, (view, column)) in columns.iter().enumerate() {
            counts[*view] += 1;
            right[*view] += inner(point, column, &|k| state.residuals.values[k]);
            for (other, second) in &columns[..=j] {
                let product = inner(point, column, &|k| second[k - point.rows.start]);
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
    let factor = centred::factor(&gram)?;
    let solution = factor.solve(&Col::from_fn(views, |v| right[v]));
    let mut spread = Mat::<f64>::zeros(views, views);
    for point in points {
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
            .map(|(view, column)| (*view, inner(point, column, &left)))
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
    let mut excess: Vec<f64> = solution.iter().copied().collect();
    let fall: f64 = excess.iter().zip(&right).map(|(a, b)| a * b).sum();
    // The scale is that of most views, which none can move far by itself.
    let common = median(&mut excess.clone()).unwrap_or(0.0);
    for excess in &mut excess {
        *excess -= common;
    }
    Some((
        excess,
        errors.collect(),
        fall / squares.max(f64::MIN_POSITIVE),
    ))
}

/// What an excess of each view that sees a point adds to its rows, the diffuse colour eliminated.
fn columns(state: &State<'_>, point: &Point) -> Vec<(usize, Vec<[f32; 3]>)> {
    let rows: &[Row] = &state.design.observations.rows[point.rows.clone()];
    let weights = &state.weights[point.rows.clone()];
    let brdf = state
        .brdf
        .at(state.design.observations.glosses[point.gloss]);
    let share = transmitted_share(&brdf, rows, weights);
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
    values: &dyn Fn(usize) -> [f32; 3],
) -> f64 {
    point
        .rows
        .clone()
        .zip(column)
        .map(|(k, c)| {
            let values = values(k);
            let product: f32 = c.iter().zip(values).map(|(c, v)| c * v).sum();
            f64::from(state.weights[k] * product)
        })
        .sum()
}
