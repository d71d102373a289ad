//! The diffuse part of an object that turns: irradiance of points by lights, fitted to what was measured with the albedos eliminated.

use std::sync::atomic::{AtomicBool, Ordering};

use faer::linalg::solvers::Solve;
use faer::{Col, Mat, Side};
use glam::Vec3;
use rayon::prelude::*;

use super::super::cells::{Cell, Pyramid};
use super::super::fast::Solver;
use super::super::observations::{Observations, Placed, Point, Row};
use super::super::shading::{hold_together, mean};
use super::super::weights::{magnitude, median};
use super::{Ground, Light, Source};
use rekindle_base::math::nnls::{self, NnlsParams};
use rekindle_scene::reflectance::Brdf;

/// How much cells are held to their neighbours, as a part of the mean diagonal of the equations.
const SMOOTHNESS: f64 = 1e-4;
/// Steps of variable projection, and the change of the light that ends them, relative.
const STEPS: usize = 20;
const SETTLED: f64 = 1e-3;
/// Rounds in which weights settle.
const REWEIGHTINGS: usize = 3;
/// What is added to the diagonal of equations for steps that are not held otherwise, as a part of it.
const DAMPING: f64 = 1e-3;
/// Residuals past so many standard deviations lose weight (Cauchy's function, whose efficiency then is 95 %).
const CAUCHY: f64 = 2.385;
/// Part of a point's radiance by which it is off at least.
const LEAST_ERROR: f64 = 0.003;
/// Part of the mean radiance that counts as nearly black.
const DARK: f64 = 0.05;

/// Irradiance of each row by each of some lights, and what was measured.
pub struct Shading<'a> {
    stop: &'a AtomicBool,
    observations: &'a Observations,
    /// Row by row, that by unit strength of each light.
    by_light: Vec<Vec<f64>>,
    /// Mean over the rows of that by each light.
    pub mean: Vec<f64>,
    /// Lights that lie beside each other.
    joined: Vec<[usize; 2]>,
    /// Mean radiance of all rows.
    pub usual: f64,
}

impl<'a> Shading<'a> {
    fn new(
        stop: &'a AtomicBool,
        observations: &'a Observations,
        lights: usize,
        joined: Vec<[usize; 2]>,
        row: impl Fn(&Point, &Placed) -> Vec<f64> + Sync,
    ) -> Self {
        let of_row = |(point, own): (&Point, &Row)| match own.placed {
            Some(placed) if !stop.load(Ordering::Relaxed) => row(point, &placed),
            _ => vec![0.0; lights],
        };
        let by_light: Vec<Vec<f64>> = placed_rows(observations)
            .into_par_iter()
            .map(of_row)
            .collect();
        let radiance = observations
            .rows
            .iter()
            .map(|row| f64::from(magnitude(row.radiance)));
        Self {
            stop,
            observations,
            mean: (0..lights)
                .map(|k| mean(&by_light.iter().map(|row| row[k]).collect::<Vec<_>>()))
                .collect(),
            by_light,
            joined,
            usual: mean(&radiance.collect::<Vec<_>>()),
        }
    }

    /// Cells of a pyramid, by unit radiance.
    pub fn of_cells(
        solver: &'a Solver<'_>,
        observations: &'a Observations,
        pyramid: &Pyramid,
        cells: &[Cell],
    ) -> Self {
        let geometry = pyramid.geometry(cells);
        let ground = Ground {
            occluder: solver.occluder,
            near: solver.near,
            brdf: None,
        };
        let sources: Vec<Source> = (geometry.directions.iter().zip(&geometry.solid_angles))
            .map(|(&direction, &solid_angle)| Source {
                direction,
                flux: Vec3::splat(solid_angle),
            })
            .collect();
        Self::new(
            solver.stop,
            observations,
            cells.len(),
            pyramid.joined(cells),
            |point, placed| {
                let mut row = vec![0.0; cells.len()];
                let origin = ground.occluder.offset_origin(point.position, point.normal);
                let sources = sources.iter().enumerate();
                ground.each_reaching((origin, placed), sources, |k, reaches, is_blocked| {
                    row[k] = if is_blocked { 0.0 } else { gray(reaches) };
                });
                row
            },
        )
    }

    /// Lights of some sources each, as strong as these are, and light from everywhere of irradiance 1.
    pub fn of_lights(
        (solver, brdf): (&'a Solver<'_>, Option<Brdf>),
        observations: &'a Observations,
        lights: &[Light],
    ) -> Self {
        let ground = Ground {
            occluder: solver.occluder,
            near: solver.near,
            brdf,
        };
        Self::new(
            solver.stop,
            observations,
            lights.len() + 1,
            Vec::new(),
            |point, placed| {
                let origin = ground.occluder.offset_origin(point.position, point.normal);
                let seen = |light| gray(ground.of_light((origin, placed), light)[0]);
                lights.iter().map(seen).chain([1.0]).collect()
            },
        )
    }

    /// Irradiance of each row.
    fn lit(&self, x: &[f64]) -> Vec<f64> {
        let sum = |row: &Vec<f64>| row.iter().zip(x).map(|(f, v)| f * v).sum();
        self.by_light.par_iter().map(sum).collect()
    }

    /// The lights' strengths under which the mean irradiance is 1.
    fn normalised(&self, mut x: Vec<f64>) -> Vec<f64> {
        let mean: f64 = x.iter().zip(&self.mean).map(|(x, mean)| x * mean).sum();
        if mean > 0.0 {
            for v in &mut x {
                *v /= mean;
            }
        }
        x
    }

    /// The strengths that leave least, of mean irradiance 1; sought from some, or from those under which the irradiance of points is
    /// most nearly along their radiance.
    pub fn light(&self, start: Option<Vec<f64>>) -> Vec<f64> {
        let measured = self.measured();
        let mut robust = vec![1.0; measured.len()];
        let mut x = self.normalised(match start {
            Some(start) => start,
            None => self.solved(&measured, &robust, &measured, vec![0.0; self.mean.len()]),
        });
        for _ in 0..STEPS {
            let lit = self.lit(&x);
            robust = self.robust(&measured, &robust, &lit);
            let next = self.solved(&measured, &robust, &lit, x.clone());
            let next = self.normalised(next);
            let change: f64 = next
                .iter()
                .zip(&x)
                .zip(&self.mean)
                .map(|((a, b), m)| (a - b).abs() * m)
                .sum();
            x = next;
            if change < SETTLED || self.stop.load(Ordering::Relaxed) {
                break;
            }
        }
        x
    }

    /// What is left of each row under some irradiance, as a part of its point's radiance, and the standard deviation of that.
    fn left(&self, measured: &[f64], weights: &[f64], lit: &[f64]) -> (Vec<f64>, f64) {
        let mut left = vec![0.0; measured.len()];
        for point in &self.observations.points {
            let own = point.rows.clone();
            let albedo = along(
                &measured[own.clone()],
                &lit[own.clone()],
                &weights[own.clone()],
            );
            let size = self.size(&measured[own.clone()]);
            for k in own {
                left[k] = (measured[k] - albedo * lit[k]) / size;
            }
        }
        let mut sizes: Vec<f32> = left.iter().map(|v| v.abs() as f32).collect();
        let deviation = (1.4826 * f64::from(median(&mut sizes))).max(LEAST_ERROR);
        (left, deviation)
    }

    /// Weight of each row: the outliers among a point's rows have less.
    fn robust(&self, measured: &[f64], before: &[f64], lit: &[f64]) -> Vec<f64> {
        let (left, deviation) = self.left(measured, before, lit);
        (left.iter())
            .map(|v| 1.0 / (1.0 + (v / (CAUCHY * deviation)).powi(2)))
            .collect()
    }

    /// By what part of it the irradiance of some strengths is off.
    pub fn error(&self, x: &[f64]) -> f32 {
        let (measured, lit) = (self.measured(), self.lit(x));
        let robust = self.settled(&measured, &lit);
        self.left(&measured, &robust, &lit).1 as f32
    }

    /// Gray radiance of each row.
    fn measured(&self) -> Vec<f64> {
        let rows = self.observations.rows.iter();
        rows.map(|row| f64::from(magnitude(row.radiance))).collect()
    }

    /// Radiance of a point that others are compared with.
    fn size(&self, measured: &[f64]) -> f64 {
        let square = measured.iter().map(|v| v * v).sum::<f64>() / measured.len().max(1) as f64;
        square.sqrt() + DARK * self.usual
    }

    /// One step: the strengths that leave least where the albedos are those under the irradiance `lit`, and changes of it along
    /// itself are eliminated.
    fn solved(&self, measured: &[f64], robust: &[f64], lit: &[f64], mut x: Vec<f64>) -> Vec<f64> {
        let n = self.mean.len();
        let is_first = x.iter().all(|&v| v == 0.0);
        let system = self.projected(&self.by_light, measured, robust, (lit, is_first));
        let (mut gram, falls) = system;
        let diagonal = (0..n).map(|k| gram[(k, k)]).sum::<f64>() / n as f64;
        hold_together(&mut gram, &self.joined, SMOOTHNESS * diagonal);
        // Only ratios count: the mean irradiance is held.
        let squares = self.mean.iter().map(|m| m * m).sum::<f64>();
        let held = diagonal * n as f64 / squares.max(f64::MIN_POSITIVE);
        for i in 0..n {
            gram[(i, i)] += 1e-9 * diagonal;
            for j in 0..n {
                gram[(i, j)] += held * self.mean[i] * self.mean[j];
            }
        }
        let right: Vec<f64> = (0..n).map(|k| falls[k] + held * self.mean[k]).collect();
        let params = NnlsParams {
            stop: Some(self.stop),
            ..NnlsParams::default()
        };
        nnls::solve(gram.as_ref(), &right, &mut x, &params);
        x
    }

    /// Normal equations of columns, row by row, that add to the irradiance `lit`, where changes of it along itself are eliminated. At
    /// first `lit` is what was measured, and only how far the columns are off it counts.
    fn projected(
        &self,
        by_column: &[Vec<f64>],
        measured: &[f64],
        robust: &[f64],
        (lit, is_first): (&[f64], bool),
    ) -> (Mat<f64>, Vec<f64>) {
        let n = by_column.first().map_or(0, Vec::len);
        let mut rows = Mat::<f64>::zeros(measured.len(), n);
        let mut right = Mat::<f64>::zeros(measured.len(), 1);
        for point in &self.observations.points {
            let own = point.rows.clone();
            let (weights, lit) = (&robust[own.clone()], &lit[own.clone()]);
            let measured = &measured[own.clone()];
            let (albedo, size) = if is_first {
                (1.0, 1.0)
            } else {
                (along(measured, lit, weights), self.size(measured))
            };
            let columns = &by_column[own.clone()];
            let squares: f64 = lit.iter().zip(weights).map(|(e, w)| w * e * e).sum();
            if squares <= 0.0 {
                continue;
            }
            for k in 0..n {
                let inner: f64 = (columns.iter().zip(lit).zip(weights))
                    .map(|((row, e), w)| w * e * row[k])
                    .sum();
                let part = inner / squares;
                for (i, row) in own.clone().enumerate() {
                    let scale = albedo * weights[i].sqrt() / size;
                    rows[(row, k)] = scale * (columns[i][k] - part * lit[i]);
                }
            }
            if !is_first {
                for (i, row) in own.enumerate() {
                    right[(row, 0)] = (measured[i] - albedo * lit[i]) * weights[i].sqrt() / size;
                }
            }
        }
        let falls = rows.transpose() * &right;
        let falls = (0..n).map(|k| falls[(k, 0)]).collect();
        (rows.transpose() * &rows, falls)
    }

    /// How much of each of some columns, made from each row's irradiances by unit strengths, leaves least where it is added to the
    /// irradiance of some strengths.
    pub fn step(&self, x: &[f64], columns: impl Fn(&[f64]) -> Vec<f64> + Sync) -> Vec<f64> {
        let (measured, lit) = (self.measured(), self.lit(x));
        let robust = self.settled(&measured, &lit);
        let by_column: Vec<Vec<f64>> = self.by_light.par_iter().map(|row| columns(row)).collect();
        let (mut gram, falls) = self.projected(&by_column, &measured, &robust, (&lit, false));
        let n = falls.len();
        for k in 0..n {
            gram[(k, k)] += DAMPING * gram[(k, k)] + f64::MIN_POSITIVE;
        }
        match gram.llt(Side::Lower) {
            Ok(factor) => {
                let solution = factor.solve(&Col::from_fn(n, |k| falls[k]));
                solution.iter().copied().collect()
            }
            Err(_) => vec![0.0; n],
        }
    }

    /// Some of the lights alone.
    #[must_use]
    pub fn only(&self, lights: &[usize]) -> Self {
        let pick = |of: &Vec<f64>| lights.iter().map(|&k| of[k]).collect();
        Self {
            by_light: self.by_light.iter().map(pick).collect(),
            mean: pick(&self.mean),
            joined: Vec::new(),
            ..*self
        }
    }

    /// What some strengths leave of each point, as a part of it, in the middle of its rows.
    pub fn left_of_points(&self, x: &[f64]) -> Vec<f64> {
        let (measured, lit) = (self.measured(), self.lit(x));
        let robust = self.settled(&measured, &lit);
        let (left, _) = self.left(&measured, &robust, &lit);
        let points = self.observations.points.iter();
        let middle = |point: &Point| {
            let own = left[point.rows.clone()].iter();
            let mut sizes: Vec<f32> = own.map(|v| v.abs() as f32).collect();
            f64::from(median(&mut sizes))
        };
        points.map(middle).collect()
    }

    /// Robust weights under some irradiance.
    fn settled(&self, measured: &[f64], lit: &[f64]) -> Vec<f64> {
        let mut robust = vec![1.0; measured.len()];
        for _ in 0..REWEIGHTINGS {
            robust = self.robust(measured, &robust, lit);
        }
        robust
    }

    /// What some strengths leave of all rows, by Cauchy's function of the standard deviation `error`.
    pub fn cost(&self, x: &[f64], error: f32) -> f64 {
        let (measured, lit) = (self.measured(), self.lit(x));
        let robust = self.settled(&measured, &lit);
        let (left, _) = self.left(&measured, &robust, &lit);
        let scale = CAUCHY * f64::from(error);
        left.iter().map(|v| (v / scale).powi(2).ln_1p()).sum()
    }
}

fn gray(of: Vec3) -> f64 {
    f64::from(of.element_sum() / 3.0)
}

/// The best multiple of `of` for `values`, by weight.
fn along(values: &[f64], of: &[f64], weights: &[f64]) -> f64 {
    let (mut product, mut square) = (0.0, 0.0);
    for ((v, e), w) in values.iter().zip(of).zip(weights) {
        product += w * v * e;
        square += w * e * e;
    }
    product / square.max(f64::MIN_POSITIVE)
}

/// Every row with its point.
pub fn placed_rows(observations: &Observations) -> Vec<(&Point, &Row)> {
    let points = observations.points.iter();
    let rows = points.flat_map(|point| {
        let rows = &observations.rows[point.rows.clone()];
        rows.iter().map(move |row| (point, row))
    });
    rows.collect()
}
