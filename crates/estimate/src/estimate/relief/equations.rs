//! Equations of heights, of which there are many but few meet, and of some other unknowns that meet all.

use faer::linalg::solvers::Solve;
use faer::{Col, Mat};
use glam::DVec2;

use super::{TURN, tilted};
use crate::estimate::design::Design;
use crate::estimate::observations::Point;
use crate::estimate::weights::{Elimination, mean_weights, residuals};
use rekindle_base::math::sparse::LowerEntries;
use rekindle_scene::reflectance::Brdf;
use rekindle_scene::surface::Fairing;

/// Normal equations of heights and lamps.
pub struct Equations {
    /// Of the heights.
    heights: LowerEntries,
    gradient: Vec<f64>,
    /// Of each lamps' unknown with the heights, one column each.
    coupling: Vec<Vec<f64>>,
    /// Of the lamps' unknowns.
    lamps: Mat<f64>,
    lamps_gradient: Col<f64>,
}

impl Equations {
    pub fn new(heights: usize, unknowns: usize) -> Self {
        Self {
            heights: LowerEntries::default(),
            gradient: vec![0.0; heights],
            coupling: vec![vec![0.0; heights]; unknowns],
            lamps: Mat::zeros(unknowns, unknowns),
            lamps_gradient: Col::zeros(unknowns),
        }
    }

    /// Adds a point: `tilts` holds the derivative of its normal's tilt, along two tangents, by each height that turns it.
    pub fn add(&mut self, point: &PointEquations, tilts: &[(usize, DVec2)]) {
        for &(i, a) in tilts {
            self.gradient[i] += point.gradient.dot(a);
            for (column, coupling) in self.coupling.iter_mut().zip(&point.coupling) {
                column[i] += coupling.dot(a);
            }
            let product = DVec2::new(
                point.tilt[0] * a.x + point.tilt[1] * a.y,
                point.tilt[1] * a.x + point.tilt[2] * a.y,
            );
            for &(j, b) in tilts {
                self.heights.add(i, j, product.dot(b));
            }
        }
    }

    /// Adds the equations of other points.
    pub fn merge(&mut self, other: &Self) {
        self.heights.extend(&other.heights);
        let coupling = self.coupling.iter_mut().zip(&other.coupling);
        for (sums, values) in coupling.chain([(&mut self.gradient, &other.gradient)]) {
            for (sum, value) in sums.iter_mut().zip(values) {
                *sum += value;
            }
        }
        self.lamps += &other.lamps;
        self.lamps_gradient += &other.lamps_gradient;
    }

    /// Adds what a fair surface says of its heights, which are at `heights`.
    pub fn hold(&mut self, fairing: &Fairing, heights: &[f64]) {
        fairing.add_prior(heights, &mut self.heights, &mut self.gradient);
    }

    /// Steps of heights and lamps: the heights are eliminated first, as there are many of them but few that meet.
    pub fn solve(mut self) -> Option<(Vec<f64>, Col<f64>)> {
        let (count, unknowns) = (self.gradient.len(), self.coupling.len());
        let rhs = Mat::from_fn(count, 1 + unknowns, |i, k| match k {
            0 => self.gradient[i],
            _ => self.coupling[k - 1][i],
        });
        let x = self.heights.solve(&rhs)?;
        let product = |a: usize, k: usize| -> f64 {
            let column = self.coupling[a].iter().enumerate();
            column.map(|(i, c)| c * x[(i, k)]).sum()
        };
        for a in 0..unknowns {
            self.lamps_gradient[a] -= product(a, 0);
            for b in 0..unknowns {
                self.lamps[(a, b)] -= product(a, b + 1);
            }
            // An unknown that is held, or that no row tells of, stays.
            self.lamps[(a, a)] += 1e-6 * self.lamps[(a, a)].abs() + f64::MIN_POSITIVE.sqrt();
        }
        let lamps = if unknowns == 0 {
            Col::zeros(0)
        } else {
            self.lamps.partial_piv_lu().solve(&self.lamps_gradient)
        };
        let heights = (0..count)
            .map(|i| x[(i, 0)] - (0..unknowns).map(|a| x[(i, a + 1)] * lamps[a]).sum::<f64>())
            .collect();
        lamps.is_all_finite().then_some((heights, lamps))
    }
}

/// Residuals of all rows with their derivatives, each point's diffuse colour taken out of both.
pub struct LinearRows {
    /// Weights over the variance of the residuals.
    pub weights: Vec<f64>,
    left: Vec<[f32; 3]>,
    /// By the tilt of the point's normal along the two tangents of its frame.
    by_tilt: [Vec<[f32; 3]>; 2],
    /// By each of the lamps' unknowns.
    pub by_lamps: Vec<Vec<[f32; 3]>>,
}

impl LinearRows {
    /// Under lights of some radiance, with the derivatives `by_lamps` of what may change beside the normals.
    pub fn new(
        design: &Design<'_>,
        (brdf, radiance): (&Brdf, &[[f32; 3]]),
        mut by_lamps: Vec<Vec<[f32; 3]>>,
    ) -> Self {
        let prediction = design.predict(brdf, radiance);
        let (weights, variance) = mean_weights(design, brdf, &prediction.value);
        let left = residuals(design, brdf, &weights, &prediction.value).values;
        let mut by_tilt = [false, true].map(|second| {
            central_difference(|angle| {
                let observations = &tilted(design.observations, second, angle);
                let design = Design {
                    observations,
                    ..design.clone()
                };
                design.predict_values(brdf, radiance)
            })
        });
        let elimination = Elimination::of(design.observations, brdf, &weights);
        for column in by_tilt.iter_mut().chain(&mut by_lamps) {
            elimination.apply(column);
        }
        Self {
            weights: weights.iter().map(|w| f64::from(*w) / variance).collect(),
            left,
            by_tilt,
            by_lamps,
        }
    }

    /// A point's equations; those of the lamps alone are added to `equations`.
    pub fn point_equations(&self, point: &Point, equations: &mut Equations) -> PointEquations {
        let mut own = PointEquations {
            tilt: [0.0; 3],
            gradient: DVec2::ZERO,
            coupling: vec![DVec2::ZERO; self.by_lamps.len()],
        };
        for row in point.rows.clone() {
            let weight = self.weights[row];
            for channel in 0..3 {
                let at = |rows: &[[f32; 3]]| f64::from(rows[row][channel]);
                let tilt = DVec2::new(at(&self.by_tilt[0]), at(&self.by_tilt[1]));
                let z = weight * at(&self.left);
                own.gradient += z * tilt;
                own.tilt[0] += weight * tilt.x * tilt.x;
                own.tilt[1] += weight * tilt.x * tilt.y;
                own.tilt[2] += weight * tilt.y * tilt.y;
                for (a, column) in self.by_lamps.iter().enumerate() {
                    let d = at(column);
                    if d == 0.0 {
                        continue;
                    }
                    own.coupling[a] += weight * d * tilt;
                    equations.lamps_gradient[a] += z * d;
                    for (b, other) in self.by_lamps.iter().enumerate() {
                        equations.lamps[(a, b)] += weight * d * at(other);
                    }
                }
            }
        }
        own
    }
}

/// The derivative of rows by an angle, at zero.
fn central_difference(rows: impl Fn(f32) -> Vec<[f32; 3]>) -> Vec<[f32; 3]> {
    let mut difference = rows(TURN);
    for (high, low) in difference.iter_mut().zip(rows(-TURN)) {
        for (h, l) in high.iter_mut().zip(low) {
            *h = (*h - l) / (2.0 * TURN);
        }
    }
    difference
}

/// What one point's rows say: of its normal's tilt (xx, xy, yy), and of the tilt with each lamps' unknown.
pub struct PointEquations {
    tilt: [f64; 3],
    gradient: DVec2,
    coupling: Vec<DVec2>,
}
