//! The paper's reference methods: alternating minimisation of eq. 17 (AMUH and AMHU), and of eq. 8 for comparison.
//!
//! Diffuse colours are fixed beforehand as the least radiance over the views (paper, 2.1), what exceeds them is taken
//! as specular, and nodes are kept where the views' partial hemispheres agree (2.2). Then lights at fixed σ and σ at
//! fixed lights are improved in turn, from σ = 0.1. They are here to compare with: the minimum over views is biased
//! by noise and by overlapping highlights, and alternation creeps where lights and σ can stand in for each other.

use std::collections::{BTreeMap, BTreeSet};

use faer::{Col, Mat};
use glam::Vec3;

use super::cells::{Cell, Pyramid};
use super::design::{Design, Prediction};
use super::diagnose;
use super::fast::{Solver, Watch};
use super::observations::{Observations, Sampling};
use super::observer::{Iteration, Stopped, go_on};
use super::total_variation::TotalVariation;
use super::visibility::{SeenCells, cell_visibility};
use super::weights::{
    Residuals, magnitude, median, robust_objective, robust_weights, weighted_rms,
};
use rekindle_scene::hemisphere::HemisphereGrid;
use rekindle_scene::reflectance::{Brdf, SpecularModel};

/// Roughness to start from, radians (paper, 3.3).
const FIRST_SIGMA: f32 = 0.1;

/// Weight ρ of the total variation (eq. 17), for radiances in units of the observations' scale.
const SMOOTHNESS: f64 = 1e-6;

/// Surface points looked at for the initial hemisphere, and kept for the minimisation.
const VOTING_POINTS: usize = 24_000;
const POINTS: usize = 3000;

/// Most unknown nodes; those with the dimmest evidence are dropped.
const MOST_NODES: usize = 1500;

/// Share of the brightest value of a partial hemisphere that counts as clearly positive.
const CLEARLY_POSITIVE: f32 = 0.05;

/// Outer iterations at most, and the relative fall of the objective that ends them.
const MOST_ITERATIONS: u32 = 30;
const SETTLED: f64 = 1e-4;

/// Reweighted solves in one half-step over the lights, and Newton steps in one over σ.
const LIGHT_ROUNDS: usize = 2;
const SIGMA_ROUNDS: usize = 6;

/// Restarts of the conjugate gradients with another set of clamped nodes, and steps within each.
const RESTARTS: usize = 12;
const GRADIENT_STEPS: usize = 30;

/// A share of its unclamped gradient at the start that ends the conjugate gradients.
const GRADIENT_TOLERANCE: f64 = 1e-4;

/// Halvings of a step before it is given up.
const HALVINGS: usize = 8;

/// Which half-step comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// AMUH: the lights u, then the lobe h.
    LightsFirst,
    /// AMHU: the lobe h, then the lights u.
    LobeFirst,
}

/// What is minimised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Terms {
    /// Eq. 17: an M-estimator over the residuals and the total variation of the lights.
    Robust,
    /// Eq. 8: the residuals' squares alone.
    Squares,
}

/// What alternation came to.
pub struct Solution {
    /// Model and roughness.
    pub brdf: Brdf,
    /// Radiance per node of the finest grid, in the capture's units.
    pub nodes: Vec<[f32; 3]>,
}

/// Minimises eq. 17, or eq. 8, by alternation; `None` where nothing specular is found.
pub fn solve(
    solver: &Solver<'_>,
    grid: &HemisphereGrid,
    (order, terms): (Order, Terms),
    model: SpecularModel,
    watch: &mut Watch<'_>,
) -> Result<Option<Solution>, Stopped> {
    go_on(watch.observer.progress("initial hemisphere", 0.0))?;
    let mut all = Observations::gather(
        &solver.seen,
        &Sampling {
            candidates: VOTING_POINTS,
            limit: VOTING_POINTS,
            keep: &|_, _, _| true,
            scale: Some(solver.coarse.scale),
            stop: solver.stop,
        },
    )
    .measured();
    subtract_minimum(&mut all);
    let evidence = initial_hemisphere(solver, grid, &all);
    if evidence.is_empty() {
        return Ok(None);
    }
    let (cells, start) = unknowns(solver.pyramid, &evidence);
    let brdf = Brdf::new(model, FIRST_SIGMA);
    let coarse: Vec<Cell> = evidence.keys().copied().collect();
    let directions = solver.pyramid.geometry(&coarse).directions;
    let mut observations = solver.points_showing(&directions, &brdf, POINTS).measured();
    subtract_minimum(&mut observations);
    go_on(watch.observer.progress("shadows", 0.05))?;
    let mut design = Design {
        observations: &observations,
        geometry: solver.pyramid.geometry(&cells),
        near: solver.near,
        seen: SeenCells::default(),
        diffuse_known: true,
        shortcuts: solver.shortcuts,
        workspace: solver.workspace,
        stop: solver.stop,
    };
    design.seen = cell_visibility(&design, solver.pyramid, &cells, &brdf, solver.occluder);
    let variation = TotalVariation::new(solver.pyramid, &cells);
    let mut state = Alternation::new(design, terms, variation, brdf, start);
    let dark = state.dark_sum();
    for iteration in 1..=MOST_ITERATIONS {
        let fall = state.iterate(order, iteration, watch)?;
        report(solver, &cells, &state, watch)?;
        if fall < SETTLED || watch.observer.enough() {
            break;
        }
    }
    if state.residuals.absolute_sum() > (1.0 - diagnose::LEAST_EXPLAINED) * dark {
        return Ok(None);
    }
    Ok(Some(Solution {
        brdf: state.brdf,
        nodes: solver.nodes(&cells, &state.radiance),
    }))
}

/// Replaces each row's radiance by what exceeds the least of its point's views, by magnitude (paper, 2.1), under equal irradiance.
fn subtract_minimum(observations: &mut Observations) {
    for point in &observations.points {
        let rows = &mut observations.rows[point.rows.clone()];
        let least = rows
            .iter()
            .map(|r| r.radiance.map(|value| value / r.irradiance))
            .min_by(|&a, &b| magnitude(a).total_cmp(&magnitude(b)));
        let diffuse = Vec3::from(least.unwrap_or_default());
        for row in rows {
            row.radiance = (Vec3::from(row.radiance) - diffuse * row.irradiance).to_array();
        }
    }
}

/// Cells one level above the nodes where the views agree that there is light, with the least they see there.
///
/// Views without a point that mirrors a cell have no vote on it. Where not one cell has the votes of all others, two
/// may be missing (paper, 2.2).
fn initial_hemisphere(
    solver: &Solver<'_>,
    grid: &HemisphereGrid,
    observations: &Observations,
) -> BTreeMap<Cell, f32> {
    let mut partial: BTreeMap<(Cell, usize), (f32, f32)> = BTreeMap::new();
    for point in &observations.points {
        for row in &observations.rows[point.rows.clone()] {
            let (position, normal, to_camera) = row
                .placed
                .map_or((point.position, point.normal, row.to_camera), |placed| {
                    (placed.position, placed.normal, placed.to_camera)
                });
            let mirrored = 2.0 * row.cos_view * normal - to_camera;
            if let Some(node) = grid.nearest_along(position, mirrored.normalize_or_zero()) {
                let cell = solver.pyramid.parent(Cell {
                    level: solver.pyramid.finest(),
                    node: node as u32,
                });
                let (sum, count) = partial.entry((cell, row.view)).or_default();
                *sum += row.cos_view * magnitude(row.radiance);
                *count += 1.0;
            }
        }
    }
    let mut seen: BTreeMap<Cell, Vec<f32>> = BTreeMap::new();
    for ((cell, _), (sum, count)) in partial {
        seen.entry(cell).or_default().push(sum / count);
    }
    let brightest = seen.values().flatten().fold(0.0_f32, |m, &v| m.max(v));
    let clearly = |v: &f32| *v > CLEARLY_POSITIVE * brightest;
    let kept = |missing: usize| -> BTreeMap<Cell, f32> {
        seen.iter()
            .filter_map(|(&cell, values)| {
                let votes = values.iter().filter(|v| clearly(v)).count();
                let least = values.iter().copied().filter(|v| clearly(v));
                (votes >= 2 && votes + missing >= values.len())
                    .then(|| (cell, least.fold(f32::INFINITY, f32::min)))
            })
            .collect()
    };
    let all = kept(0);
    if all.is_empty() { kept(2) } else { all }
}

/// The nodes of the cells with evidence and of a ring about them, with the evidence as radiance to start from.
fn unknowns(pyramid: &Pyramid, evidence: &BTreeMap<Cell, f32>) -> (Vec<Cell>, Vec<[f32; 3]>) {
    let mut ordered: Vec<(f32, Cell)> = evidence.iter().map(|(&c, &v)| (v, c)).collect();
    ordered.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let ring: BTreeSet<Cell> = evidence
        .keys()
        .flat_map(|&c| pyramid.neighbours(c))
        .filter(|c| !evidence.contains_key(c))
        .collect();
    ordered.extend(ring.into_iter().map(|c| (0.0, c)));
    let mut found: Vec<(Cell, [f32; 3])> = Vec::new();
    for (value, cell) in ordered {
        if cell.level == pyramid.finest() {
            found.push((cell, [value; 3]));
        }
        found.extend(pyramid.children(cell).map(|c| (c, [value; 3])));
    }
    found.truncate(MOST_NODES);
    found.sort_unstable_by_key(|f| f.0);
    found.into_iter().unzip()
}

fn report(
    solver: &Solver<'_>,
    cells: &[Cell],
    state: &Alternation<'_>,
    watch: &mut Watch<'_>,
) -> Result<(), Stopped> {
    let scale = solver.coarse.scale;
    let iteration = Iteration {
        iteration: watch.iterations.len() as u32 + 1,
        elapsed_s: solver.started.elapsed().as_secs_f64(),
        objective: state.objective * f64::from(scale).powi(2),
        sigma: state.brdf.sigma,
        residual_rms: weighted_rms(&state.weights, &state.residuals) * scale,
    };
    watch.iterations.push(iteration);
    go_on(
        watch
            .observer
            .iteration(&iteration, &|| solver.nodes(cells, &state.radiance)),
    )
}

/// An alternation in progress.
struct Alternation<'a> {
    design: Design<'a>,
    terms: Terms,
    variation: TotalVariation,
    brdf: Brdf,
    radiance: Vec<[f32; 3]>,
    prediction: Prediction,
    residuals: Residuals,
    weights: Vec<f32>,
    objective: f64,
}

impl<'a> Alternation<'a> {
    /// Starts from radiances up to a common factor, which is fitted.
    fn new(
        design: Design<'a>,
        terms: Terms,
        variation: TotalVariation,
        brdf: Brdf,
        mut start: Vec<[f32; 3]>,
    ) -> Self {
        let predicted = design.predict(&brdf, &start).value;
        let rows = design.observations.rows.iter();
        let (mut above, mut below) = (0.0_f32, 0.0_f32);
        for (row, &p) in rows.zip(&predicted) {
            above += Vec3::from(row.radiance).dot(p.into());
            below += Vec3::from(p).length_squared();
        }
        let factor = (above / below.max(f32::MIN_POSITIVE)).max(0.0);
        start.iter_mut().flatten().for_each(|v| *v *= factor);
        let mut state = Self {
            weights: Vec::new(),
            prediction: design.predict(&brdf, &start),
            residuals: Residuals::default(),
            objective: f64::INFINITY,
            radiance: start,
            design,
            terms,
            variation,
            brdf,
        };
        state.residuals = state.left_by(&state.prediction);
        state
    }

    /// Σ |measured| without any light.
    fn dark_sum(&self) -> f64 {
        let rows = &self.design.observations.rows;
        rows.iter().map(|r| f64::from(magnitude(r.radiance))).sum()
    }

    /// Measured − predicted at the present noise level.
    fn left_by(&self, prediction: &Prediction) -> Residuals {
        let rows = self.design.observations.rows.iter();
        let values = rows
            .zip(&prediction.value)
            .map(|(row, &p)| (Vec3::from(row.radiance) - Vec3::from(p)).to_array())
            .collect();
        Residuals {
            values,
            noise: self.residuals.noise,
        }
    }

    /// Eq. 17 with Huber's function, or eq. 8; the mean over the channels.
    fn cost(&self, residuals: &Residuals, radiance: &[[f32; 3]]) -> f64 {
        if self.terms == Terms::Squares {
            let squares = residuals.values.iter().map(|&r| magnitude(r).powi(2));
            return squares.map(f64::from).sum();
        }
        let variation: f64 = (0..3)
            .map(|c| self.variation.value(&channel(radiance, c)))
            .sum();
        robust_objective(&self.design, residuals, residuals.noise) + SMOOTHNESS * variation / 3.0
    }

    /// One outer iteration at one noise level, from the median residual; the relative fall of the objective.
    fn iterate(
        &mut self,
        order: Order,
        iteration: u32,
        watch: &mut Watch<'_>,
    ) -> Result<f64, Stopped> {
        let mut sizes: Vec<f32> = self
            .residuals
            .values
            .iter()
            .map(|&r| magnitude(r))
            .collect();
        // The median of the root mean square of three normal deviates is 0.888 standard deviations.
        self.residuals.noise = median(&mut sizes) / 0.888;
        self.objective = self.cost(&self.residuals, &self.radiance);
        let before = self.objective;
        let done = 0.05 + 0.95 * (iteration - 1) as f32 / MOST_ITERATIONS as f32;
        if order == Order::LobeFirst {
            self.improve_sigma();
        }
        self.improve_lights(done, watch)?;
        if order == Order::LightsFirst {
            self.improve_sigma();
        }
        Ok((before - self.objective) / before.max(f64::MIN_POSITIVE))
    }

    /// Takes over a candidate if the objective falls.
    fn accept(&mut self, brdf: Brdf, radiance: &[[f32; 3]]) -> bool {
        let prediction = self.design.predict(&brdf, radiance);
        let residuals = self.left_by(&prediction);
        let cost = self.cost(&residuals, radiance);
        if cost >= self.objective {
            return false;
        }
        (self.brdf, self.prediction, self.residuals) = (brdf, prediction, residuals);
        self.radiance.copy_from_slice(radiance);
        self.objective = cost;
        true
    }

    /// Weights of the rows under the present residuals.
    fn reweighted(&self) -> Vec<f32> {
        match self.terms {
            Terms::Robust => robust_weights(&self.design, &self.residuals),
            Terms::Squares => vec![1.0; self.residuals.values.len()],
        }
    }

    /// The half-step over u: reweighted least squares with lagged diffusivity.
    fn improve_lights(&mut self, done: f32, watch: &mut Watch<'_>) -> Result<(), Stopped> {
        for _ in 0..LIGHT_ROUNDS {
            self.weights = self.reweighted();
            let equations = self.design.normal_equations(&self.brdf, &self.weights);
            let mut best = self.radiance.clone();
            for (c, rhs) in equations.rhs.iter().enumerate() {
                let mut x = channel(&self.radiance, c);
                let mut matrix = equations.gram.clone();
                if self.terms == Terms::Robust {
                    // Half of ρ: the quadratic ½ xᵀ H x − bᵀ x is half the objective.
                    self.variation
                        .add_diffusion(&x, 0.5 * SMOOTHNESS, &mut matrix);
                }
                minimise(&matrix, rhs, &mut x, &mut || {
                    go_on(watch.observer.progress("alternating", done))
                })?;
                for (value, x) in best.iter_mut().zip(x) {
                    value[c] = x as f32;
                }
            }
            let from = self.radiance.clone();
            let moved = (0..HALVINGS).any(|k| {
                let trial: Vec<[f32; 3]> = from
                    .iter()
                    .zip(&best)
                    .map(|(&a, &b)| Vec3::from(a).lerp(b.into(), 0.5_f32.powi(k as i32)).into())
                    .collect();
                self.accept(self.brdf, &trial)
            });
            if !moved {
                break;
            }
        }
        Ok(())
    }

    /// The half-step over h: Gauss-Newton in σ alone.
    fn improve_sigma(&mut self) {
        for _ in 0..SIGMA_ROUNDS {
            self.weights = self.reweighted();
            let (mut slope, mut curvature) = (0.0_f64, 0.0_f64);
            for (k, &w) in self.weights.iter().enumerate() {
                let by_sigma = Vec3::from(self.prediction.by_sigma[k]);
                slope += f64::from(w * by_sigma.dot(self.residuals.values[k].into()));
                curvature += f64::from(w * by_sigma.length_squared());
            }
            let sigma = self.brdf.sigma;
            let step = (slope / curvature.max(f64::MIN_POSITIVE)) as f32;
            let step = step.clamp(-0.3 * sigma, 0.3 * sigma);
            let radiance = self.radiance.clone();
            let moved = (0..HALVINGS).any(|k| {
                let brdf = Brdf {
                    sigma: (sigma + step * 0.5_f32.powi(k as i32)).clamp(0.003, 1.0),
                    ..self.brdf
                };
                self.accept(brdf, &radiance)
            });
            if !moved || step.abs() < 1e-4 * sigma {
                break;
            }
        }
    }
}

fn channel(radiance: &[[f32; 3]], c: usize) -> Vec<f64> {
    radiance.iter().map(|l| f64::from(l[c])).collect()
}

/// Lowers ½ xᵀ H x − bᵀ x over x ≥ 0: conjugate gradients over the nodes that are not clamped at zero, a projected
/// step along what they found, and again with the nodes that are clamped then.
fn minimise(
    matrix: &Mat<f64>,
    rhs: &[f64],
    x: &mut [f64],
    pulse: &mut dyn FnMut() -> Result<(), Stopped>,
) -> Result<(), Stopped> {
    let mut first = None;
    for _ in 0..RESTARTS {
        pulse()?;
        let gradient = gradient(matrix, rhs, x);
        let free: Vec<usize> = (0..x.len())
            .filter(|&i| x[i] > 0.0 || gradient[i] < 0.0)
            .collect();
        let size = free.iter().map(|&i| gradient[i].powi(2)).sum::<f64>();
        if size <= GRADIENT_TOLERANCE.powi(2) * *first.get_or_insert(size) {
            break;
        }
        let block = Mat::from_fn(free.len(), free.len(), |i, j| matrix[(free[i], free[j])]);
        let downhill = Col::from_fn(free.len(), |i| -gradient[free[i]]);
        let direction = conjugate_gradients(&block, downhill, pulse)?;
        let lowered = (0..2 * HALVINGS).find_map(|k| {
            let mut trial = x.to_vec();
            for (&i, d) in free.iter().zip(direction.iter()) {
                trial[i] = (x[i] + 0.5_f64.powi(k as i32) * d).max(0.0);
            }
            // The quadratic's change is ½ (g + g')ᵀ (x' − x).
            let there = self::gradient(matrix, rhs, &trial);
            let change: f64 = (0..x.len())
                .map(|i| 0.5 * (gradient[i] + there[i]) * (trial[i] - x[i]))
                .sum();
            (change < 0.0).then_some(trial)
        });
        match lowered {
            Some(trial) => x.copy_from_slice(&trial),
            None => break,
        }
    }
    Ok(())
}

/// H x − b.
fn gradient(matrix: &Mat<f64>, rhs: &[f64], x: &[f64]) -> Vec<f64> {
    let product = matrix * Col::from_fn(x.len(), |i| x[i]);
    product.iter().zip(rhs).map(|(p, b)| p - b).collect()
}

/// An approximate solution of H d = r from d = 0.
fn conjugate_gradients(
    matrix: &Mat<f64>,
    mut residual: Col<f64>,
    pulse: &mut dyn FnMut() -> Result<(), Stopped>,
) -> Result<Col<f64>, Stopped> {
    let mut solution = Col::<f64>::zeros(residual.nrows());
    let mut direction = residual.clone();
    let mut size = residual.squared_norm_l2();
    let enough = GRADIENT_TOLERANCE.powi(2) * size;
    for step in 0..GRADIENT_STEPS {
        if step % 8 == 0 {
            pulse()?;
        }
        let product = matrix * &direction;
        let curvature = direction.transpose() * &product;
        if size <= enough || curvature <= 0.0 {
            break;
        }
        let along = size / curvature;
        solution += faer::Scale(along) * &direction;
        residual -= faer::Scale(along) * &product;
        let next = residual.squared_norm_l2();
        direction = &residual + faer::Scale(next / size) * &direction;
        size = next;
    }
    Ok(solution)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::{Estimate, EstimateInput, EstimateParams, Method, Unobserved, estimate};
    use glam::Vec3;
    use rekindle_capture::Capture;
    use rekindle_scene::hemisphere::HemisphereGrid;
    use rekindle_scene::surface::{Occluder, ViewSurface};

    #[test]
    fn both_lamps_are_found() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/captures/spot_paper");
        let capture = Capture::load(&folder).expect("test capture");
        let occluder = Occluder::new(&capture.mesh);
        let surfaces: Vec<ViewSurface> = capture
            .views
            .iter()
            .map(|v| ViewSurface::new(&capture.mesh, &occluder, &v.camera))
            .collect();
        let up = capture.light_hemisphere.up.as_vec3();
        let grid = HemisphereGrid::new(24, up, None, capture.mesh.centre());
        let input = EstimateInput {
            capture: &capture,
            surfaces: &surfaces,
            occluder: &occluder,
            grid: &grid,
            first: None,
        };
        for method in [Method::Amuh, Method::Plain] {
            let params = EstimateParams {
                method,
                ..EstimateParams::default()
            };
            let found = estimate(&input, &params, &mut Unobserved).expect("nobody stops it");
            check(&grid, &found);
        }
    }

    /// Roughness and both lamps must be near the truth.
    fn check(grid: &HemisphereGrid, found: &Estimate) {
        let sigma = found.brdf.expect("there are highlights").sigma;
        assert!((sigma / 0.085 - 1.0).abs() < 0.15, "{sigma}");
        // From the capture's truth.json.
        for lamp in [
            Vec3::new(-0.619_74, 0.587_79, 0.520_03),
            Vec3::new(0.405_58, std::f32::consts::FRAC_1_SQRT_2, 0.579_23),
        ] {
            let centroid: Vec3 = (0..grid.directions.len())
                .filter(|&i| grid.directions[i].angle_between(lamp) < 0.2)
                .map(|i| grid.directions[i] * Vec3::from(found.radiance[i]).element_sum())
                .sum();
            let off = centroid.angle_between(lamp).to_degrees();
            assert!(off < 3.0, "{off}° off");
        }
    }
}
