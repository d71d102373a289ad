//! What a fit leaves that is no noise.
//!
//! A row's image detail, by how much the pixels about it differ from a plane, bounds what noise and interpolation do to it. A
//! residual beyond that has a cause: light, lobe, camera or normal are not what they are taken for. Two things tell these
//! apart: whether points with nearly the same normal share their residuals, as they do where the model is wrong for all of
//! them, and whether a turn of the single point's normal would take its residuals away.

use super::observations::{Observations, Point};
use super::relief::tilted;
use super::state::State;
use super::weights::{deviation, magnitude};

/// What is left over once lights and noise have explained their part.
#[derive(Clone, Copy, Debug, Default)]
pub struct Misfit {
    /// Root mean square residual beyond the rows' image detail, as a part of what the differences between views have beyond
    /// it; rows are weighted by their noise.
    pub share: f64,
    /// Correlation of the residuals of neighbouring points, in [−1, 1]; 0 of noise.
    pub correlation: f64,
    /// What turned normals would explain of it.
    pub tilt: Tilt,
}

/// What turning every point's normal would explain.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tilt {
    /// Part of the squared residuals that goes away beyond what two more unknowns a point take from noise.
    pub explained: f64,
    /// Root mean square angle by which normals would turn, radians.
    pub angle: f32,
}

/// Rows below which a point says nothing about its normal.
const FEWEST_ROWS: usize = 4;
/// Turns that differ by less than this are one.
const LEAST_DETERMINED: f64 = 1e-2;
/// Half the difference of angles by which rows are differentiated, radians.
const TURN: f32 = 1e-3;

impl Misfit {
    /// Of a fit whose residuals are up to date.
    pub fn of(state: &State<'_>) -> Self {
        let share = share(state);
        Self {
            share,
            correlation: correlation(state),
            tilt: if share > 0.0 {
                tilt(state)
            } else {
                Tilt::default()
            },
        }
    }
}

fn share(state: &State<'_>) -> f64 {
    let rows = &state.design.observations.rows;
    let noise = state.residuals.noise.max(f32::MIN_POSITIVE);
    let dark = state.dark_residuals();
    let (mut left, mut all) = (0.0_f64, 0.0_f64);
    for ((row, &residual), &difference) in
        rows.iter().zip(&state.residuals.values).zip(&dark.values)
    {
        let square = |v: [f32; 3]| f64::from(magnitude(v)).powi(2);
        let detail = f64::from(row.detail).powi(2);
        let weight = f64::from(deviation(noise, row.detail)).powi(-2);
        left += weight * (square(residual) - detail);
        all += weight * (square(difference) - detail);
    }
    if left > 0.0 && all > 0.0 {
        (left / all).sqrt()
    } else {
        0.0
    }
}

/// Of points that follow each other, which have nearly the same normal, in the same view.
fn correlation(state: &State<'_>) -> f64 {
    let observations = state.design.observations;
    let noise = state.residuals.noise.max(f32::MIN_POSITIVE);
    let whitened = |k: usize| {
        let scale = deviation(noise, observations.rows[k].detail).recip();
        state.residuals.values[k].map(|v| v * scale)
    };
    let (mut shared, mut all) = (0.0_f64, 0.0_f64);
    for pair in observations.points.windows(2) {
        for (i, j) in common_views(observations, &pair[0], &pair[1]) {
            for (a, b) in whitened(i).into_iter().zip(whitened(j)) {
                shared += f64::from(a * b);
                all += 0.5 * f64::from(a * a + b * b);
            }
        }
    }
    if all > 0.0 { shared / all } else { 0.0 }
}

/// Rows of two points in one view.
fn common_views(
    observations: &Observations,
    one: &Point,
    other: &Point,
) -> impl Iterator<Item = (usize, usize)> {
    let (first, second) = (one.rows.clone(), other.rows.clone());
    first.filter_map(move |i| {
        let view = observations.rows[i].view;
        let same = second.clone().find(|&j| observations.rows[j].view == view);
        same.map(|j| (i, j))
    })
}

fn tilt(state: &State<'_>) -> Tilt {
    let derivatives = [false, true].map(|second| by_tilt(state, second));
    let (mut explained, mut by_chance, mut all) = (0.0_f64, 0.0_f64, 0.0_f64);
    let (mut angles, mut weights) = (0.0_f64, 0.0_f64);
    for point in &state.design.observations.points {
        if point.rows.len() < FEWEST_ROWS {
            continue;
        }
        let fit = TiltFit::of(state, point, &derivatives);
        // The point's colour has taken one of its rows, light that is shared hardly any.
        let freedom = 3.0 * (point.rows.len() - 1) as f64;
        explained += fit.explained;
        by_chance += fit.all * 2.0 / freedom;
        all += fit.all;
        angles += fit.weight * fit.squared_angle;
        weights += fit.weight;
    }
    Tilt {
        explained: ((explained - by_chance) / all.max(f64::MIN_POSITIVE)).max(0.0),
        angle: (angles / weights.max(f64::MIN_POSITIVE)).sqrt() as f32,
    }
}

/// Derivatives of what is predicted by a turn of the normals, the points' colours taken out.
fn by_tilt(state: &State<'_>, second: bool) -> Vec<[f32; 3]> {
    let at = |angle: f32| {
        let observations = tilted(state.design.observations, second, angle);
        let mut design = state.design.clone();
        design.observations = &observations;
        design.predict_values(&state.brdf, &state.radiance)
    };
    let mut difference = at(TURN);
    for (high, low) in difference.iter_mut().zip(at(-TURN)) {
        for (h, l) in high.iter_mut().zip(low) {
            *h = (*h - l) / (2.0 * TURN);
        }
    }
    state.eliminate(&mut difference);
    difference
}

/// The turn of one point's normal that takes most off its weighted squared residuals.
struct TiltFit {
    explained: f64,
    all: f64,
    squared_angle: f64,
    /// How much the point's rows say of its normal.
    weight: f64,
}

impl TiltFit {
    fn of(state: &State<'_>, point: &Point, derivatives: &[Vec<[f32; 3]>; 2]) -> Self {
        let (mut gram, mut right, mut all) = ([0.0_f64; 3], [0.0_f64; 2], 0.0_f64);
        for k in point.rows.clone() {
            let w = f64::from(state.weights[k]);
            let [by_first, by_second] = [0, 1].map(|t| derivatives[t][k].map(f64::from));
            let left = state.residuals.values[k].map(f64::from);
            for ((a, b), r) in by_first.into_iter().zip(by_second).zip(left) {
                gram[0] += w * a * a;
                gram[1] += w * a * b;
                gram[2] += w * b * b;
                right[0] += w * a * r;
                right[1] += w * b * r;
                all += w * r * r;
            }
        }
        let [aa, ab, bb] = gram;
        let determinant = aa * bb - ab * ab;
        // Where all rows show the same turn, or none, it says nothing.
        if determinant <= LEAST_DETERMINED * aa * bb {
            return Self {
                explained: 0.0,
                all,
                squared_angle: 0.0,
                weight: 0.0,
            };
        }
        let x = (bb * right[0] - ab * right[1]) / determinant;
        let y = (aa * right[1] - ab * right[0]) / determinant;
        Self {
            explained: x * right[0] + y * right[1],
            all,
            squared_angle: x * x + y * y,
            weight: determinant / (aa + bb),
        }
    }
}
