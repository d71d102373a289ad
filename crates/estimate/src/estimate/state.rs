//! One estimate in progress: lights on cells, σ and robust weights, and the steps that improve each.

use std::sync::atomic::Ordering;

use faer::linalg::solvers::{Llt, Solve};
use faer::{Col, Mat, Side};
use rayon::prelude::*;

use super::cells::Cell;
use super::design::{Design, NormalEquations};
use super::shading::hold_together;
use super::weights::{
    Residuals, dark_residuals, eliminate_all, initial_weights, magnitude, residuals,
    robust_objective, robust_weights, weighted_rms,
};
use rekindle_base::math::nnls::{self, NnlsParams};
use rekindle_scene::reflectance::{Brdf, Gloss};
use rekindle_scene::shortcuts::Shortcut;

/// How exactly the lights are solved for.
#[derive(Clone, Copy, Debug)]
pub struct Precision {
    /// Ridge as a share of the Gram matrix's mean diagonal: it keeps cells that the data cannot tell apart from
    /// making the solve slow.
    pub ridge: f64,
    /// See [`NnlsParams::tolerance`].
    pub tolerance: f64,
    /// Whether every solve makes sure that no cell away from the lit ones would take light, or the last one only.
    pub looks_around: bool,
    /// Price of light: how much of a cell's own column the residuals must hold for it to be lit, in units of the observations'
    /// scale per root of the column's square (the lasso's penalty on columns of length 1: Tibshirani, "Regression Shrinkage and
    /// Selection via the Lasso", 1996).
    pub price: f64,
}

/// Enough to see where light is. At a tolerance of 1e-4 slopes of σ were those of unfinished fits, and its steps went astray.
pub const ROUGH: Precision = Precision {
    ridge: 1e-6,
    tolerance: 1e-6,
    looks_around: true,
    price: 0.0,
};

/// Enough that σ and the lamps' extents are not biased: at a ridge of 1e-5 they were, by 4 % and a factor of two.
pub const EXACT: Precision = Precision {
    ridge: 1e-9,
    tolerance: 1e-7,
    looks_around: false,
    price: 0.0,
};

/// Distance between the roughnesses at which f is looked at, as a share of σ, and how many they are at most.
const PROBE: f64 = 0.03;
const MOST_PROBES: usize = 6;

/// Groups of points of like normals whose pulls on σ are compared.
pub const CLUSTERS: usize = 32;

/// A shift of σ by less than this part of it is not worth solving the lights again.
const NO_SHIFT: f64 = 1e-5;

/// Curvature of f as a share of Gauss-Newton's below which what is measured of it is noise.
const LEAST_CURVATURE: f64 = 0.05;

/// Cells no further from a lit one than this many spacings may come to be lit next.
const BESIDE: f32 = 1.4;
/// Where more than this part of all cells may be lit, all are taken.
const MOST_CHOSEN: f32 = 0.8;

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
    /// Specular radiance of each row under the present lights.
    predicted: Vec<[f32; 3]>,
    /// Cells that may be lit, ascending. Whether the others stay dark is looked at after each solve.
    candidates: Vec<usize>,
    /// The last solve's equations, once there was one.
    system: Option<System>,
}

/// Normal equations of some of the cells.
#[derive(Clone)]
struct System {
    /// The cells, ascending.
    columns: Vec<usize>,
    equations: NormalEquations,
    /// See [`Precision::ridge`].
    ridge: f64,
    /// Model, roughness and weights that they are of.
    brdf: Brdf,
    weights: Vec<f32>,
}

/// A Gauss-Newton step of σ.
#[derive(Clone, Copy, Debug)]
pub struct SigmaStep {
    /// Change of σ, radians.
    pub step: f64,
    /// Half the fall of the weighted squared residuals per radian of σ.
    pub slope: f64,
    /// Gauss-Newton's share of its change, Σ w z².
    pub curvature: f64,
    /// Standard error of σ, radians; infinite where the rows do not determine it.
    pub error: f64,
    /// The same with one group for many points of like normals, which misfit that they share makes larger.
    pub clustered_error: f64,
}

impl<'a> State<'a> {
    /// A dark hemisphere.
    pub fn new(design: Design<'a>, cells: Vec<Cell>, brdf: Brdf) -> Self {
        Self {
            radiance: vec![[0.0; 3]; cells.len()],
            weights: initial_weights(&design),
            residuals: Residuals::default(),
            predicted: Vec::new(),
            candidates: (0..cells.len()).collect(),
            system: None,
            design,
            cells,
            brdf,
        }
    }

    /// Takes the lights of another state of the same rows, cells and lobe, and what they show.
    pub fn light_as(&mut self, other: &Self) {
        self.radiance.clone_from(&other.radiance);
        self.predicted.clone_from(&other.predicted);
        self.leave();
    }

    /// Takes other lights, radiance per cell.
    pub fn light_by(&mut self, radiance: &[[f32; 3]]) {
        self.radiance.clone_from_slice(radiance);
        self.predict();
    }

    /// The lights at another σ, sought from darkness.
    pub fn lit_at(&self, sigma: f32) -> Self {
        let mut state = self.clone();
        state.brdf.sigma = sigma;
        state.radiance.fill([0.0; 3]);
        state.solve_lights(ROUGH);
        state
    }

    /// The same with some of the cells only; dark ones leave the fit as it is.
    pub fn restricted(&self, keep: impl Fn(&Cell) -> bool) -> Self {
        let kept: Vec<usize> = (0..self.cells.len())
            .filter(|&k| keep(&self.cells[k]))
            .collect();
        self.with_cells(&kept)
    }

    /// The same with the cells at these places only, ascending. What others gave has to be solved for again.
    pub fn with_cells(&self, kept: &[usize]) -> Self {
        let mut some = Self {
            design: self.design.restricted(kept),
            cells: kept.iter().map(|&k| self.cells[k]).collect(),
            radiance: kept.iter().map(|&k| self.radiance[k]).collect(),
            system: self.system.as_ref().map(|s| s.among(kept)),
            ..self.clone()
        };
        some.candidates = some.around(&some.lit());
        if let Some(system) = some.system.as_ref().filter(|s| s.is_of(&some)) {
            // The others were dark, and the equations of these are at hand.
            some.candidates
                .retain(|k| system.columns.binary_search(k).is_ok());
        }
        some
    }

    /// Specular radiance of a row under the present lights, in units of the observations' scale.
    pub fn specular(&self, row: usize) -> [f32; 3] {
        self.predicted[row]
    }

    /// The same lights and σ looked at on other points.
    pub fn on<'b>(&self, design: Design<'b>) -> State<'b> {
        let mut moved = State::new(design, self.cells.clone(), self.brdf);
        moved.radiance.clone_from(&self.radiance);
        moved.candidates.clone_from(&self.candidates);
        moved.predict();
        moved
    }

    /// Takes away the say of rows that don't `tell`.
    pub fn silence(&mut self, tell: impl Fn(usize) -> bool) {
        for (k, weight) in self.weights.iter_mut().enumerate() {
            if !tell(k) {
                *weight = 0.0;
            }
        }
    }

    /// The same where a gloss that was another's becomes the main one: the lights' units are the main lobe's.
    #[must_use]
    pub fn with_main(&self, main: Gloss) -> Self {
        let mut state = self.clone();
        state.brdf.sigma *= main.roughness;
        for value in state.radiance.as_flattened_mut() {
            *value *= main.height();
        }
        state
    }

    /// Minimises over the lights at the present σ and weights.
    pub fn solve_lights(&mut self, precision: Precision) {
        self.candidates = (0..self.cells.len()).collect();
        self.solve_candidates(precision);
        self.candidates = self.around(&self.lit());
    }

    /// Takes the cells that are lit and those beside them alone as candidates, until lights are sought on others again.
    pub fn keep_to_lit(&mut self) {
        if self.design.shortcuts.takes(Shortcut::FarCells) {
            self.candidates = self.around(&self.lit());
        }
    }

    /// [`State::solve_lights`] over the cells that are lit and those beside them, which are few, as long as others stay dark.
    pub fn solve_lit(&mut self, precision: Precision) {
        if !self.design.shortcuts.takes(Shortcut::FarCells) {
            self.candidates = (0..self.cells.len()).collect();
        }
        self.solve_candidates(precision);
        self.candidates = self.around(&self.lit());
    }

    /// Goes on from [`State::solve_lit`] until no other cell would take light; whether there was any.
    pub fn light_missed(&mut self, precision: Precision) -> bool {
        let mut any = false;
        loop {
            let missed = self.missed(precision);
            if missed.is_empty() || self.design.stop.load(Ordering::Relaxed) {
                return any;
            }
            any = true;
            self.candidates.extend(self.around(&missed));
            self.candidates.sort_unstable();
            self.candidates.dedup();
            self.solve_candidates(precision);
        }
    }

    /// [`State::solve_lights`] with a further ridge on some of the cells, as a share of the Gram matrix's mean diagonal.
    pub fn solve_lights_evenly(
        &mut self,
        even: impl Fn(&Cell) -> bool,
        ridge: f64,
        precision: Precision,
    ) {
        self.solve_lights_held(precision, |cells, gram| {
            let mean = mean_diagonal(gram);
            for (i, _) in cells.iter().enumerate().filter(|(_, c)| even(c)) {
                gram[(i, i)] += ridge * mean;
            }
        });
    }

    /// [`State::solve_lights`] where cells that are `joined` differ little, by `smoothness` as a share of the Gram matrix's mean diagonal.
    pub fn solve_lights_smoothly(
        &mut self,
        joined: &[[usize; 2]],
        smoothness: f64,
        precision: Precision,
    ) {
        self.solve_lights_held(precision, |_, gram| {
            let weight = smoothness * mean_diagonal(gram);
            hold_together(gram, joined, weight);
        });
    }

    /// [`State::solve_lights`] with something more known of the lights than rows say, which is added to the Gram matrix.
    fn solve_lights_held(
        &mut self,
        precision: Precision,
        hold: impl FnOnce(&[Cell], &mut Mat<f64>),
    ) {
        self.candidates = (0..self.cells.len()).collect();
        let system = self.take_system(precision);
        let mut held = system.equations.clone();
        hold(&self.cells, &mut held.gram);
        self.radiance = self.fitted(&held, &self.candidates, &self.radiance, precision);
        self.system = Some(system);
        self.predict();
    }

    /// Minimises over the lights of the candidates; the other cells are dark.
    pub fn solve_candidates(&mut self, precision: Precision) {
        let system = self.take_system(precision);
        let equations = &system.equations;
        self.radiance = self.fitted(equations, &self.candidates, &self.radiance, precision);
        self.system = Some(system);
        self.predict();
    }

    /// The equations of the candidates: those of the last solve where nothing that they depend on has changed.
    fn take_system(&mut self, precision: Precision) -> System {
        let known = self.system.take();
        known
            .filter(|known| known.is_of(self) && known.ridge == precision.ridge)
            .and_then(|known| known.only(&self.candidates))
            .unwrap_or_else(|| self.equations(precision))
    }

    /// The equations of the candidates, with the ridge of `precision`.
    fn equations(&self, precision: Precision) -> System {
        let restricted;
        let design = if self.candidates.len() == self.cells.len() {
            &self.design
        } else {
            restricted = self.design.restricted(&self.candidates);
            &restricted
        };
        let mut equations = design.normal_equations(&self.brdf, &self.weights);
        let (n, all) = (self.candidates.len(), self.cells.len());
        let shortcuts = self.design.shortcuts;
        shortcuts.count(Shortcut::FarCells, all, all - n);
        let gram = &mut equations.gram;
        let mean = mean_diagonal(gram);
        for i in 0..n {
            // A cell that no row sees must stay dark, not singular.
            gram[(i, i)] += precision.ridge * mean + f64::MIN_POSITIVE;
        }
        System {
            columns: self.candidates.clone(),
            equations,
            ridge: precision.ridge,
            brdf: self.brdf,
            weights: self.weights.clone(),
        }
    }

    /// Radiances that solve the last solve's equations where only the cells lit in `start` may be, which it starts from.
    pub fn refit(&self, start: &[[f32; 3]], precision: Precision) -> Vec<[f32; 3]> {
        let Some(system) = &self.system else {
            return start.to_vec();
        };
        let (at, lit): (Vec<usize>, Vec<usize>) = (system.columns.iter().copied().enumerate())
            .filter(|&(_, k)| start[k] != [0.0; 3])
            .unzip();
        self.fitted(&system.some(&at), &lit, start, precision)
    }

    /// Radiance per cell that solves the equations of `cells`, started from `start`; other cells keep what that says.
    fn fitted(
        &self,
        equations: &NormalEquations,
        cells: &[usize],
        start: &[[f32; 3]],
        precision: Precision,
    ) -> Vec<[f32; 3]> {
        let params = NnlsParams {
            tolerance: precision.tolerance,
            stop: Some(self.design.stop),
            ..NnlsParams::default()
        };
        let own = if self.design.observations.gray { 1 } else { 3 };
        let gram = equations.gram.as_ref();
        let solved: Vec<Vec<f64>> = (0..own)
            .into_par_iter()
            .map(|c| {
                let mut x: Vec<f64> = cells.iter().map(|&k| f64::from(start[k][c])).collect();
                let priced = |(i, b): (usize, &f64)| b - precision.price * gram[(i, i)].sqrt();
                let rhs: Vec<f64> = equations.rhs[c].iter().enumerate().map(priced).collect();
                nnls::solve(gram, &rhs, &mut x, &params);
                x
            })
            .collect();
        let mut radiance = start.to_vec();
        for (i, &k) in cells.iter().enumerate() {
            // Gray light is solved for once.
            radiance[k] = std::array::from_fn(|c| solved[c % own][i] as f32);
        }
        radiance
    }

    fn predict(&mut self) {
        self.predicted = self.design.predict_values(&self.brdf, &self.radiance);
        self.leave();
    }

    /// Takes residuals from what the present lights show.
    fn leave(&mut self) {
        self.residuals = residuals(&self.design, &self.brdf, &self.weights, &self.predicted);
    }

    /// Cells that are no candidates and would come to be lit.
    fn missed(&self, precision: Precision) -> Vec<usize> {
        let Some(system) = &self.system else {
            return Vec::new();
        };
        if system.columns.len() == self.cells.len() {
            return Vec::new();
        }
        let mut is_candidate = vec![false; self.cells.len()];
        for &k in &system.columns {
            is_candidate[k] = true;
        }
        let others: Vec<usize> = (0..self.cells.len())
            .filter(|&k| !is_candidate[k])
            .collect();
        let fall = self.design.restricted(&others).correlate(
            &self.brdf,
            &self.weights,
            &self.residuals.values,
        );
        let least = system.equations.rhs.each_ref().map(|rhs| {
            let scale = rhs.iter().fold(0.0_f64, |m, b| m.max(b.abs()));
            precision.tolerance * scale
        });
        let (_, missed): (Vec<usize>, Vec<usize>) = (others.into_iter().enumerate())
            .filter(|&(i, _)| (0..3).any(|c| fall[c][i] > least[c]))
            .unzip();
        missed
    }

    /// Cells with light, ascending.
    pub fn lit(&self) -> Vec<usize> {
        (0..self.cells.len())
            .filter(|&k| self.radiance[k].iter().any(|&v| v > 0.0))
            .collect()
    }

    /// Some cells and those beside them, ascending; all where there are none, or not many others.
    fn around(&self, some: &[usize]) -> Vec<usize> {
        let all = 0..self.cells.len();
        let around: Vec<usize> = all
            .clone()
            .filter(|&k| some.iter().any(|&lit| self.is_beside(k, lit)))
            .collect();
        if around.is_empty() || around.len() as f32 > MOST_CHOSEN * all.len() as f32 {
            all.collect()
        } else {
            around
        }
    }

    /// Standard deviation of the lobe in the light's direction, radians: the half vector turns by half the light's angle.
    pub fn lobe_width(&self) -> f32 {
        2.0 * self.brdf.sigma
    }

    /// Σ over channels of a cell's radiance times its solid angle.
    pub fn cell_flux(&self, cell: usize) -> f32 {
        self.design.geometry.solid_angles[cell] * self.radiance[cell].iter().sum::<f32>()
    }

    /// The same of some cells together.
    pub fn flux(&self, cells: &[usize]) -> f32 {
        cells.iter().map(|&k| self.cell_flux(k)).sum()
    }

    /// Solid angle that an even light of the same flux and the same mean square radiance would fill, steradians.
    pub fn light_extent(&self) -> f64 {
        let (mut flux, mut squares) = (0.0_f64, 0.0_f64);
        for (radiance, &angle) in self.radiance.iter().zip(&self.design.geometry.solid_angles) {
            let bright = f64::from(magnitude(*radiance));
            flux += bright * f64::from(angle);
            squares += bright * bright * f64::from(angle);
        }
        if squares > 0.0 {
            flux * flux / squares
        } else {
            0.0
        }
    }

    /// Whether two cells lie beside each other.
    pub fn is_beside(&self, one: usize, other: usize) -> bool {
        let geometry = &self.design.geometry;
        // Nodes of a hexagonal grid, each of which has the solid angle √3/2 spacing².
        let spacing = |k: usize| (geometry.solid_angles[k] * 2.0 / 3.0_f32.sqrt()).sqrt();
        let reach = BESIDE * spacing(one).max(spacing(other));
        geometry.directions[one].distance_squared(geometry.directions[other]) < reach * reach
    }

    /// Takes weights from the present residuals.
    pub fn reweight(&mut self) {
        self.weights = robust_weights(&self.design, &self.residuals);
    }

    /// Mean absolute residual per degree of freedom, by which fits of different roughness and model are compared.
    ///
    /// Each lit cell and each diffuse colour takes one degree of freedom (generalised cross-validation; the number
    /// of positive unknowns is the dimension of a non-negative fit). A lobe that is too narrow lights many cells,
    /// with which it imitates noise: the plain residual would prefer it. It needs no noise level, which no fit has
    /// given yet.
    pub fn unexplained(&self) -> f64 {
        let lit = self.radiance.iter().filter(|l| l.iter().any(|&v| v > 0.0));
        let observations = self.design.observations;
        let known = if self.design.diffuse_known {
            0
        } else {
            observations.points.len()
        };
        let freedom = observations.rows.len() as f64 - (known + lit.count()) as f64;
        self.residuals.absolute_sum() / freedom.max(1.0)
    }

    /// Huber's objective at the present noise level.
    pub fn objective(&self) -> f64 {
        robust_objective(&self.design, &self.residuals, self.residuals.noise)
    }

    /// Huber's objective of the same rows without any light, at the present noise level.
    pub fn dark_objective(&self) -> f64 {
        robust_objective(&self.design, &self.dark_residuals(), self.residuals.noise)
    }

    /// Sum of the residuals' lengths as a part of what it is without any light.
    pub fn unexplained_share(&self) -> f64 {
        let dark = self.dark_residuals().absolute_sum();
        self.residuals.absolute_sum() / dark.max(f64::MIN_POSITIVE)
    }

    /// What the rows show without any light.
    pub fn dark_residuals(&self) -> Residuals {
        dark_residuals(&self.design, &self.brdf, &self.weights)
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
            slope: 0.0,
            curvature: 0.0,
            error: f64::INFINITY,
            clustered_error: f64::INFINITY,
        };
        if self.radiance.iter().flatten().all(|&v| v <= 0.0) {
            return UNDETERMINED;
        }
        let by_sigma = self.design.predict(&self.brdf, &self.radiance).by_sigma;
        let unique = self.unexplained_part(by_sigma.clone());
        let (mut slope, mut curvature) = (0.0_f64, 0.0_f64);
        let mut pulls = Vec::with_capacity(self.design.observations.points.len());
        for point in &self.design.observations.points {
            let mut own = 0.0_f64;
            for k in point.rows.clone() {
                let w = f64::from(self.weights[k]);
                let at_fixed_lights = by_sigma[k];
                for ((z, r), d) in unique[k]
                    .iter()
                    .zip(self.residuals.values[k])
                    .zip(at_fixed_lights)
                {
                    own += w * f64::from(*z) * f64::from(r);
                    curvature += w * f64::from(z * z);
                    // At the minimum over the lights no lit column correlates with the residuals, and what is
                    // left of the slope is the derivative at fixed lights. The projected one has the same value in
                    // exact numbers; in these, large cancelling imitations drown it.
                    slope += w * f64::from(d) * f64::from(r);
                }
            }
            pulls.push(own);
        }
        if curvature <= 0.0 {
            return UNDETERMINED;
        }
        SigmaStep {
            step: slope / curvature,
            slope,
            curvature,
            error: spread(&pulls, 1) / curvature,
            clustered_error: spread(&pulls, pulls.len().div_ceil(CLUSTERS)) / curvature,
        }
    }

    /// Moves σ from the minimum of f to that of `f + 2 s² p` with p the number of lit cells and s² the variance of the
    /// noise, solves the lights there, and returns the standard error of σ. The lights have been solved at the present σ, and `step`
    /// belongs to it.
    ///
    /// A narrower lobe lights more cells, and each of them takes away one variance of the noise from f: the minimum of
    /// f lies below the true σ, the more so the noisier the data. Mallows's Cp counts them (as does
    /// [`State::unexplained`]). From the minimum upward, at the present weights, f is taken as quadratic and p as
    /// linear in steps of a few percent. There f also shows its true curvature, which is less than Gauss-Newton's where
    /// cells go dark and light up.
    pub fn settle_sigma(&mut self, step: &SigmaStep, precision: Precision) -> f64 {
        if !step.error.is_finite() {
            return step.error;
        }
        let sigma = f64::from(self.brdf.sigma);
        let away = PROBE * sigma;
        let variance = step.error * step.error * step.curvature;
        let mut probe = self.clone();
        let mut at = |offset: f64| {
            probe.brdf.sigma = (sigma + offset) as f32;
            probe.solve_lights(precision);
            (probe.squares(), probe.lit_unknowns())
        };
        let mut here = (self.squares(), self.lit_unknowns());
        // f falls at twice the slope of Σ w z r.
        let mut rise = -2.0 * step.slope;
        let below = 2.0 * (at(-away).0 - here.0 + rise * away) / (away * away);
        let mut least = below.min(2.0 * step.curvature);
        let mut shift = 0.0;
        for _ in 0..MOST_PROBES {
            let next = at(shift + away);
            let curvature = 2.0 * (next.0 - here.0 - rise * away) / (away * away);
            let excess = rise + 2.0 * variance * (next.1 - here.1) / away;
            let part = if curvature > 0.0 {
                (-excess / curvature).max(-away)
            } else {
                away
            };
            shift += part.min(away);
            if part < away {
                break;
            }
            least = least.min(curvature);
            rise += curvature * away;
            here = next;
        }
        if shift > NO_SHIFT * sigma {
            self.brdf.sigma = (sigma + shift) as f32;
            self.solve_lights(precision);
        }
        let curvature = (0.5 * least).max(LEAST_CURVATURE * step.curvature);
        (variance / curvature).sqrt()
    }

    /// Σ w r² over rows and channels.
    pub fn squares(&self) -> f64 {
        self.weights
            .iter()
            .zip(&self.residuals.values)
            .map(|(&w, &r)| 3.0 * f64::from(w * magnitude(r).powi(2)))
            .sum()
    }

    /// Lit cells, counted once per channel that is its own.
    pub fn lit_unknowns(&self) -> f64 {
        let lit = self.radiance.iter().flatten().filter(|&&v| v > 0.0).count();
        let same = if self.design.observations.gray { 3 } else { 1 };
        (lit / same) as f64
    }

    /// One RGB value per row, less its weighted projection onto the lit columns and onto each point's diffuse colour.
    fn unexplained_part(&self, mut unique: Vec<[f32; 3]>) -> Vec<[f32; 3]> {
        self.eliminate(&mut unique);
        let Some(system) = &self.system else {
            return unique;
        };
        let lit = self.lit();
        let products = self
            .design
            .restricted(&lit)
            .correlate(&self.brdf, &self.weights, &unique);
        let mut imitation = vec![[0.0_f32; 3]; self.cells.len()];
        for c in 0..3 {
            let (own, rhs): (Vec<usize>, Vec<f64>) = lit
                .iter()
                .zip(&products[c])
                .filter(|(k, _)| self.radiance[**k][c] > 0.0)
                .unzip();
            for (&k, value) in own.iter().zip(system.solve(&own, &rhs)) {
                imitation[k][c] = value as f32;
            }
        }
        let imitated = self.design.predict_values(&self.brdf, &imitation);
        for (u, i) in unique.iter_mut().zip(&imitated) {
            for c in 0..3 {
                u[c] -= i[c];
            }
        }
        self.eliminate(&mut unique);
        unique
    }

    /// Radiances of some cells with which those that are lit in a channel imitate values best, column by column, whose weighted products
    /// with the cells' columns are `products`.
    pub fn imitation(&self, channel: usize, cells: &[usize], products: &Mat<f64>) -> Mat<f64> {
        let mut imitation = Mat::zeros(products.nrows(), products.ncols());
        let (at, own): (Vec<usize>, Vec<usize>) = (cells.iter().copied().enumerate())
            .filter(|&(_, k)| self.radiance[k][channel] > 0.0)
            .unzip();
        if own.is_empty() {
            return imitation;
        }
        let factor = self.system.as_ref().and_then(|system| system.factor(&own));
        if let Some(factor) = factor {
            let solved = factor.solve(Mat::from_fn(at.len(), products.ncols(), |i, j| {
                products[(at[i], j)]
            }));
            for (i, &row) in at.iter().enumerate() {
                imitation.row_mut(row).copy_from(solved.row(i));
            }
        }
        imitation
    }

    /// Takes the best diffuse colour of each point out of one RGB value per row.
    pub fn eliminate(&self, values: &mut [[f32; 3]]) {
        eliminate_all(self.design.observations, &self.brdf, &self.weights, values);
    }
}

/// Root of the sum of squares of the pulls of runs of `size` points.
pub fn spread(pulls: &[f64], size: usize) -> f64 {
    let runs = pulls.chunks(size.max(1));
    runs.map(|run| run.iter().sum::<f64>().powi(2))
        .sum::<f64>()
        .sqrt()
}

/// Mean of a matrix's diagonal.
fn mean_diagonal(matrix: &Mat<f64>) -> f64 {
    let n = matrix.ncols();
    (0..n).map(|i| matrix[(i, i)]).sum::<f64>() / n.max(1) as f64
}

impl System {
    /// Whether these are equations of a state's present roughness and weights.
    fn is_of(&self, state: &State<'_>) -> bool {
        self.brdf == state.brdf && self.weights == state.weights
    }

    /// The equations of those columns that are among some cells, which are counted anew.
    fn among(&self, kept: &[usize]) -> Self {
        let (at, columns): (Vec<usize>, Vec<usize>) = (kept.iter().enumerate())
            .filter_map(|(new, old)| Some((self.columns.binary_search(old).ok()?, new)))
            .unzip();
        self.at(&at, columns)
    }

    /// The equations of some cells, which all must be among the columns.
    fn only(self, cells: &[usize]) -> Option<Self> {
        if self.columns == cells {
            return Some(self);
        }
        let at: Option<Vec<usize>> = (cells.iter())
            .map(|k| self.columns.binary_search(k).ok())
            .collect();
        Some(self.at(&at?, cells.to_vec()))
    }

    /// The equations of the columns at these places alone, which are called `columns`.
    fn at(&self, at: &[usize], columns: Vec<usize>) -> Self {
        Self {
            columns,
            equations: self.some(at),
            ridge: self.ridge,
            brdf: self.brdf,
            weights: self.weights.clone(),
        }
    }

    /// The equations of the columns at these places alone.
    fn some(&self, at: &[usize]) -> NormalEquations {
        let rhs = (self.equations.rhs.each_ref()).map(|rhs| at.iter().map(|&i| rhs[i]).collect());
        NormalEquations {
            gram: self.block(at),
            rhs,
        }
    }

    /// The matrix of the columns at these places alone.
    fn block(&self, at: &[usize]) -> Mat<f64> {
        Mat::from_fn(at.len(), at.len(), |i, j| {
            self.equations.gram[(at[i], at[j])]
        })
    }

    /// Solution of the equations of the cells `own` alone, which are among the columns; nothing where they are singular.
    fn solve(&self, own: &[usize], rhs: &[f64]) -> Vec<f64> {
        let Some(factor) = self.factor(own) else {
            return Vec::new();
        };
        let x = factor.solve(&Col::from_fn(rhs.len(), |i| rhs[i]));
        x.iter().copied().collect()
    }

    /// Factor of the equations of the cells `own` alone, which are among the columns; `None` where they are singular.
    fn factor(&self, own: &[usize]) -> Option<Llt<f64>> {
        let at: Vec<usize> = own
            .iter()
            .filter_map(|k| self.columns.binary_search(k).ok())
            .collect();
        self.block(&at).llt(Side::Lower).ok()
    }
}
