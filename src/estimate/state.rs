//! One estimate in progress: lights on cells, σ and robust weights, and the steps that improve each.

use faer::linalg::solvers::Solve;
use faer::{Col, Mat, Side};

use super::cells::Cell;
use super::design::{Design, NormalEquations, Prediction};
use super::model::Brdf;
use super::weights::{
    Residuals, eliminate, initial_weights, residuals, robust_objective, robust_weights,
    weighted_rms,
};
use crate::math::nnls::{self, NnlsParams};

/// How exactly the lights are solved for.
#[derive(Clone, Copy, Debug)]
pub struct Precision {
    /// Ridge as a share of the Gram matrix's mean diagonal: it keeps cells that the data cannot tell apart from
    /// making the solve slow.
    pub ridge: f64,
    /// See [`NnlsParams::tolerance`].
    pub tolerance: f64,
}

/// Enough to see where light is.
pub const ROUGH: Precision = Precision {
    ridge: 1e-6,
    tolerance: 1e-4,
};

/// Enough that σ and the lamps' extents are not biased: at a ridge of 1e-5 they were, by 4 % and a factor of two.
pub const EXACT: Precision = Precision {
    ridge: 1e-9,
    tolerance: 1e-7,
};

/// An estimate in progress.
#[derive(Clone)]
pub struct State<'a> {
    /// Rows and cells.
    pub design: Design<'a>,
    /// What each column of the design is.
    pub cells: Vec<Cell>,
    /// Radiance per cell, RGB.
    pub radiance: Vec<[f32; 3]>,
    /// Model and roughness.
    pub brdf: Brdf,
    /// One weight per row.
    pub weights: Vec<f32>,
    /// What the present lights leave over.
    pub residuals: Residuals,
    prediction: Prediction,
    equations: NormalEquations,
}

/// A Gauss-Newton step of σ.
#[derive(Clone, Copy, Debug)]
pub struct SigmaStep {
    /// Change of σ, radians.
    pub step: f64,
    /// Standard error of σ, radians; infinite where the rows do not determine it.
    pub error: f64,
}

impl<'a> State<'a> {
    /// A dark hemisphere.
    pub fn new(design: Design<'a>, cells: Vec<Cell>, brdf: Brdf) -> Self {
        Self {
            radiance: vec![[0.0; 3]; cells.len()],
            weights: initial_weights(&design),
            residuals: Residuals::default(),
            prediction: Prediction::default(),
            equations: NormalEquations::none(),
            design,
            cells,
            brdf,
        }
    }

    /// The same with some of the cells only; dark ones leave the fit as it is.
    pub fn restricted(&self, keep: impl Fn(&Cell) -> bool) -> Self {
        let kept: Vec<usize> = (0..self.cells.len())
            .filter(|&k| keep(&self.cells[k]))
            .collect();
        Self {
            design: self.design.restricted(&kept),
            cells: kept.iter().map(|&k| self.cells[k]).collect(),
            radiance: kept.iter().map(|&k| self.radiance[k]).collect(),
            equations: NormalEquations::none(),
            ..self.clone()
        }
    }

    /// Minimises over the lights at the present σ and weights.
    pub fn solve_lights(&mut self, precision: Precision) {
        let n = self.cells.len();
        self.equations = self.design.normal_equations(&self.brdf, &self.weights);
        let gram = &mut self.equations.gram;
        let mean = (0..n).map(|i| gram[(i, i)]).sum::<f64>() / n.max(1) as f64;
        for i in 0..n {
            // A cell that no row sees must stay dark, not singular.
            gram[(i, i)] += precision.ridge * mean + f64::MIN_POSITIVE;
        }
        let params = NnlsParams {
            tolerance: precision.tolerance,
            ..NnlsParams::default()
        };
        let channels = if self.design.observations.gray { 1 } else { 3 };
        for c in 0..channels {
            let mut x: Vec<f64> = self.radiance.iter().map(|l| f64::from(l[c])).collect();
            nnls::solve(gram.as_ref(), &self.equations.rhs[c], &mut x, &params);
            for (l, x) in self.radiance.iter_mut().zip(x) {
                l[c] = x as f32;
            }
        }
        if channels == 1 {
            for l in &mut self.radiance {
                *l = [l[0]; 3];
            }
        }
        self.prediction = self.design.predict(&self.brdf, &self.radiance);
        self.residuals = residuals(&self.design, &self.brdf, &self.weights, &self.prediction);
    }

    /// Takes weights from the present residuals.
    pub fn reweight(&mut self) {
        self.weights = robust_weights(&self.design, &self.residuals);
    }

    /// Huber's objective at the present noise level.
    pub fn objective(&self) -> f64 {
        robust_objective(&self.design, &self.residuals, self.residuals.noise)
    }

    /// Huber's objective of the same rows without any light, at the present noise level.
    pub fn dark_objective(&self) -> f64 {
        let none = Prediction {
            value: vec![[0.0; 3]; self.prediction.value.len()],
            by_sigma: Vec::new(),
        };
        let left = residuals(&self.design, &self.brdf, &self.weights, &none);
        robust_objective(&self.design, &left, self.residuals.noise)
    }

    /// Weighted root mean square residual, in units of the observations' scale.
    pub fn rms(&self) -> f32 {
        weighted_rms(&self.weights, &self.residuals)
    }

    /// The Gauss-Newton step of `f(σ) = min_L …` and the standard error of σ.
    ///
    /// The Jacobian of f is ∂A/∂σ L less what the lit columns can imitate of it (Kaufman, "A variable projection
    /// method for solving separable nonlinear least squares problems", 1975). The error is the sandwich estimate
    /// with one group per surface point, which holds whatever the noise's distribution is.
    pub fn sigma_step(&self) -> SigmaStep {
        const UNDETERMINED: SigmaStep = SigmaStep {
            step: 0.0,
            error: f64::INFINITY,
        };
        if self.radiance.iter().flatten().all(|&v| v <= 0.0) {
            return UNDETERMINED;
        }
        let unique = self.unexplained_derivative();
        let (mut slope, mut curvature, mut spread) = (0.0_f64, 0.0_f64, 0.0_f64);
        for point in &self.design.observations.points {
            let mut own = 0.0_f64;
            for k in point.rows.clone() {
                let w = f64::from(self.weights[k]);
                for (z, r) in unique[k].iter().zip(self.residuals.values[k]) {
                    own += w * f64::from(*z) * f64::from(r);
                    curvature += w * f64::from(z * z);
                }
            }
            slope += own;
            spread += own * own;
        }
        if curvature <= 0.0 {
            return UNDETERMINED;
        }
        SigmaStep {
            step: slope / curvature,
            error: spread.sqrt() / curvature,
        }
    }

    /// ∂A/∂σ L per row, less its weighted projection onto the lit columns and onto each point's diffuse colour.
    fn unexplained_derivative(&self) -> Vec<[f32; 3]> {
        let products = self
            .design
            .correlate(&self.brdf, &self.weights, &self.prediction.by_sigma);
        let mut imitation = vec![[0.0_f32; 3]; self.cells.len()];
        for c in 0..3 {
            let lit: Vec<usize> = (0..self.cells.len())
                .filter(|&k| self.radiance[k][c] > 0.0)
                .collect();
            for (k, value) in solve_restricted(&self.equations.gram, &products[c], &lit) {
                imitation[k][c] = value as f32;
            }
        }
        let imitated = self.design.predict(&self.brdf, &imitation);
        let mut unique = self.prediction.by_sigma.clone();
        for (u, i) in unique.iter_mut().zip(&imitated.value) {
            for c in 0..3 {
                u[c] -= i[c];
            }
        }
        let observations = self.design.observations;
        for point in &observations.points {
            let rows = point.rows.clone();
            let cosines = observations.rows[rows.clone()].iter().map(|r| r.cos_view);
            eliminate(
                &self.brdf,
                cosines,
                &self.weights[rows.clone()],
                &mut unique[rows],
            );
        }
        unique
    }
}

/// Solution of the equations of the columns `own` alone, as (column, value); nothing where they are singular.
fn solve_restricted(gram: &Mat<f64>, rhs: &[f64], own: &[usize]) -> Vec<(usize, f64)> {
    let block = Mat::from_fn(own.len(), own.len(), |i, j| gram[(own[i], own[j])]);
    let Ok(factor) = block.llt(Side::Lower) else {
        return Vec::new();
    };
    let x = factor.solve(&Col::from_fn(own.len(), |i| rhs[own[i]]));
    own.iter().enumerate().map(|(i, &k)| (k, x[i])).collect()
}
