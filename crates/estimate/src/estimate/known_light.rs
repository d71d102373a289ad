//! What does the surface reflect under a light that is known?
//!
//! A picture of all the light of the place leaves little to be sought: the roughness σ, the strength `K_S` of the lobe, and how
//! the picture is turned about the vertical. With S(σ) the specular radiance of a row under that light for `K_S` = 1, rows are
//!
//! `y = t D + K_S S(σ)`
//!
//! and `K_S` follows from σ by least squares, the diffuse colours D eliminated as everywhere. σ moves by Gauss-Newton steps on
//! what is left (Kaufman 1975, as for lights that are sought). Nothing is open then: lights have their units, and so have `K_S`, the
//! reflectance at normal incidence F₀ = 8πσ² `K_S` and the albedo.
//!
//! The turn is the one under which highlights are explained best. It is sought on every second point; the others, which had no
//! say, tell whether it is better than any other turn beyond chance.

use std::collections::{BTreeMap, BinaryHeap};
use std::f32::consts::{PI, TAU};
use std::sync::atomic::Ordering;
use std::time::Instant;

use glam::{DVec3, Quat, Vec3};
use rayon::prelude::*;

use super::cells::{Cell, CellGeometry, Pyramid};
use super::design::Design;
use super::fast::{self, SIGMAS, Solver, Watch};
use super::misfit::Misfit;
use super::observations::{Observations, Point};
use super::observer::{Interim, Observer, Stopped, go_on, watched};
use super::state::{CLUSTERS, State, spread};
use super::weights::{
    Residuals, eliminate_all, initial_weights, magnitude, residuals, robust_weights,
};
use super::workspace::Workspace;
use super::{
    Estimate, EstimateInput, EstimateParams, HALF_INTERVAL, Reduced, SpecularChoice, diagnose,
};
use rekindle_base::math::ranks::{SURE, signed_ranks};
use rekindle_scene::hemisphere::HemisphereGrid;
use rekindle_scene::reflectance::{Brdf, SpecularModel};
use rekindle_scene::shortcuts::Shortcuts;
use rekindle_scene::surface::GlossParts;

/// Turns that are tried first, 7.5° apart: the widest lobe of those below sees light 23° wide.
const TURNS: usize = 48;
/// Roughnesses with which they are tried, radians.
const SEARCHED: [f32; 2] = [0.2, 0.08];
/// Turns that differ by less than this are one, radians.
const SAME_TURN: f32 = 0.35;
/// Turns that are refined, and the step at which refining ends, radians.
const REFINED: usize = 3;
const LEAST_TURN: f32 = 2e-3;
/// Part of what two turns say differently that the points have which are asked for the better one.
const ASKED: f64 = 0.9;
/// Cells that the light is divided into beyond the coarsest, fewer while it is turned and forms of the lobe are compared.
const CELLS: usize = 4000;
const FEW_CELLS: usize = 1000;
/// Points that roughness and strength are fitted to.
const POINTS: usize = 4000;
/// A form of the lobe that leaves so many times as much as another from the start is not improved.
const CLEARLY_MORE: f64 = 1.25;
/// Rounds of weights, strength and roughness in turn, in the end and while the light is turned.
const ROUNDS: usize = 15;
const TURNING_ROUNDS: usize = 3;
/// The last step of σ and of the strength, as a part of them.
const SETTLED: f64 = 3e-4;
/// Longest step of σ as a part of it, and its range, radians.
const LONGEST: f64 = 0.3;
const LEAST_SIGMA: f32 = 0.003;
const MOST_SIGMA: f32 = 1.0;
/// Rounds in which glosses and the lobe take turns.
const GLOSS_ROUNDS: usize = 2;
/// More than this is reflected at normal incidence by no dielectric, as diamond reflects 17 %, and nothing reflects more than 1.
const MOST_DIELECTRIC: f32 = 0.2;
/// Less than this neither: water reflects 2 %.
const LEAST_DIELECTRIC: f32 = 0.01;

/// What is said where the surface shows no gloss.
const NO_SPECULAR: &str = "No specular part was found: the given light, reflected, explains no differences between views. Everything \
    is taken as diffuse; the albedo is in absolute units all the same.";
/// What is said where the turn is open.
const TURN_OPEN: &str = "The highlights don't tell how the given light is turned: another turn explains them about as well. State the turn \
    in degrees (--light-rotation), or turn it by hand on the capture's page.";

/// Light that is known.
pub struct GivenLight<'a> {
    /// Radiance per node of the input's grid, RGB, in the capture's units, once it is turned about the grid's pole by an angle,
    /// radians, counter-clockwise seen from the pole.
    pub nodes: &'a (dyn Fn(f32) -> Vec<[f32; 3]> + Sync),
    /// The turn, radians; sought where it is not stated.
    pub turn: Option<f32>,
}

/// What was found under a light that is known.
pub struct UnderGivenLight {
    /// Roughness, and the light times `K_S` in each channel as all estimates have it.
    pub estimate: Estimate,
    /// How the light is turned, radians.
    pub turn: f32,
    /// `K_S` of each channel: what the estimate's light was multiplied by; 1 where no specular part was found.
    pub specular_scale: [f32; 3],
}

/// Estimates roughness and strength of the specular part of a capture under a light that is known.
pub fn estimate_under(
    input: &EstimateInput<'_>,
    params: &EstimateParams,
    light: &GivenLight<'_>,
    observer: &mut dyn Observer,
) -> Result<UnderGivenLight, Stopped> {
    watched(observer, |mut watcher| {
        let shortcuts = Shortcuts::without(params.avoided);
        let reduced = Reduced::of(input);
        let input = reduced.as_ref().map_or(*input, |r| r.input(input));
        let stop = watcher.stop();
        let pyramid = Pyramid::new(input.grid, fast::COARSEST);
        let workspace = Workspace::new();
        let solver = Solver::new(
            &input,
            params.sigma,
            &pyramid,
            (&shortcuts, &workspace),
            None,
            Instant::now(),
            stop,
        );
        let mut iterations = Vec::new();
        let mut watch = Watch {
            iterations: &mut iterations,
            observer: &mut watcher,
        };
        let mut found = run(&solver, &input, params, light, &mut watch)?;
        found.estimate.convergence = iterations;
        found.estimate.left_out = shortcuts.counted();
        if stop.load(Ordering::Relaxed) {
            return Err(Stopped);
        }
        Ok(found)
    })
}

fn run(
    solver: &Solver<'_>,
    input: &EstimateInput<'_>,
    params: &EstimateParams,
    light: &GivenLight<'_>,
    watch: &mut Watch<'_>,
) -> Result<UnderGivenLight, Stopped> {
    let estimate = Estimate::dark(params.method, solver.grid);
    if let Some(reason) = diagnose::unseparable(input.capture, &solver.coarse) {
        let turn = light.turn.unwrap_or(0.0);
        return Ok(diffuse(estimate, turn, (light.nodes)(turn), vec![reason]));
    }
    let turned = match light.turn {
        Some(angle) => Turned { angle, doubt: None },
        None => align(solver, light, watch)?,
    };
    go_on(watch.observer.progress("fitting roughness and gloss", 0.5))?;
    let nodes = (light.nodes)(turned.angle);
    let few = solver.coarse_colours();
    let cells = LitCells::of(solver, &nodes, FEW_CELLS);
    let lit = Lit::new(solver, &few, &cells);
    let Some((lobe, because)) = choose(solver, &lit, params.specular, watch)? else {
        let said = [Some(NO_SPECULAR.to_owned()), turned.doubt];
        let said = said.into_iter().flatten().collect();
        return Ok(diffuse(estimate, turned.angle, nodes, said));
    };
    let observations = solver.colours(POINTS);
    let cells = LitCells::of(solver, &nodes, CELLS);
    let lit = Lit::new(solver, &observations, &cells);
    let lobe = lit.scaled(lobe.brdf, initial_weights(&lit.design));
    let found = with_parts(solver, &lit, lobe, GLOSS_ROUNDS, watch)?;
    Ok(told(estimate, found, turned, because, &nodes))
}

/// The lobe, of some forms, that explains most under a light, radiance per node in the capture's units, on the coarsest points. It is no weaker
/// than that of any dielectric.
pub fn lobe_under(
    solver: &Solver<'_>,
    nodes: &[[f32; 3]],
    models: &[SpecularModel],
    watch: &mut Watch<'_>,
) -> Result<Option<LobeUnderLight>, Stopped> {
    let few = solver.coarse_colours();
    let lit = Lit::new(solver, &few, &LitCells::of(solver, nodes, FEW_CELLS));
    let best = best(solver, &lit, models, watch)?;
    Ok(best.map(|(mut lobe, because)| {
        if lobe.reflectance() < LEAST_DIELECTRIC {
            lobe.scale = [f64::from(LEAST_DIELECTRIC / lobe.reflectance_of_unit_scale()); 3];
        }
        LobeUnderLight {
            brdf: Brdf::new(lobe.brdf.model, lobe.brdf.sigma),
            scale: lobe.scale.map(|k| k as f32),
            misfit: Misfit::of(&lit.state(&lobe)),
            because,
        }
    }))
}

/// A lobe under a light.
pub struct LobeUnderLight {
    /// Model and roughness.
    pub brdf: Brdf,
    /// `K_S` of each channel: what the light is multiplied by.
    pub scale: [f32; 3],
    /// What it leaves.
    pub misfit: Misfit,
    /// Why this lobe.
    pub because: String,
}

/// The light divided into cells.
struct LitCells {
    cells: Vec<Cell>,
    /// In units of the observations' scale.
    radiance: Vec<[f32; 3]>,
    /// Where the light of each cell comes from in the mean, and how far it is spread: so lobes have the moments that they have
    /// under its nodes, up to the second.
    geometry: CellGeometry,
}

/// Flux of a cell, and its moments.
#[derive(Clone, Copy, Default)]
struct Moments {
    flux: DVec3,
    /// Σ of the directions of its nodes, weighted by their flux in all channels.
    towards: DVec3,
}

impl Moments {
    fn add(&mut self, flux: DVec3, direction: Vec3) {
        self.flux += flux;
        self.towards += flux.element_sum() * direction.as_dvec3();
    }

    /// Variance that its extent adds to σ²: a quarter of that of its directions along an axis, the half vector turning by half the
    /// light's angle.
    fn spread(&self) -> f64 {
        let mean = self.towards.length() / self.flux.element_sum().max(f64::MIN_POSITIVE);
        // The mean of unit vectors at small angles a from their middle is 1 - a²/2 long, and a² has a share on each of two axes.
        0.25 * (1.0 - mean).max(0.0)
    }
}

/// A cell with what is gained where it is split: flux times the variance of where it comes from.
struct Split {
    gain: f64,
    cell: Cell,
}

impl PartialEq for Split {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}
impl Eq for Split {}
impl PartialOrd for Split {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Split {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        let by_gain = self.gain.total_cmp(&other.gain);
        by_gain.then_with(|| self.cell.cmp(&other.cell))
    }
}

impl LitCells {
    /// A radiance per node in cells, up to `split` more than the coarsest of them: finest where much light is spread widely.
    fn of(solver: &Solver<'_>, nodes: &[[f32; 3]], split: usize) -> Self {
        let pyramid = solver.pyramid;
        let moments = moments(pyramid, solver.grid, nodes);
        let of = |cell: &Cell| moments.get(cell).copied().unwrap_or_default();
        let worth = |cell: Cell| {
            let moments = of(&cell);
            let gain = moments.flux.element_sum() * moments.spread();
            Split { gain, cell }
        };
        let roots = pyramid.roots();
        let count = roots.len() + split;
        let lit = |cell: &Cell| moments.contains_key(cell);
        let mut waiting: BinaryHeap<Split> = roots.into_iter().filter(lit).map(worth).collect();
        let mut cells = Vec::new();
        while let Some(Split { gain, cell }) = waiting.pop() {
            let is_whole = cell.level == pyramid.finest() || gain <= 0.0;
            if is_whole || waiting.len() + cells.len() >= count {
                cells.push(cell);
            } else {
                waiting.extend(pyramid.children(cell).filter(lit).map(worth));
            }
        }
        cells.sort_unstable();
        let mut geometry = pyramid.geometry(&cells);
        let scale = f64::from(solver.coarse.scale);
        let mut radiance = Vec::with_capacity(cells.len());
        for (k, cell) in cells.iter().enumerate() {
            let moments = of(cell);
            let angle = f64::from(geometry.solid_angles[k]);
            radiance.push((moments.flux / (angle * scale)).as_vec3().to_array());
            geometry.directions[k] = moments.towards.normalize_or_zero().as_vec3();
            geometry.spread[k] = moments.spread() as f32;
        }
        Self {
            cells,
            radiance,
            geometry,
        }
    }

    /// The coarsest cells, dark.
    fn roots(solver: &Solver<'_>) -> Self {
        let cells = solver.pyramid.roots();
        Self {
            radiance: vec![[0.0; 3]; cells.len()],
            geometry: solver.pyramid.geometry(&cells),
            cells,
        }
    }
}

/// Flux and moments of the cells of all levels that have any.
fn moments(
    pyramid: &Pyramid,
    grid: &HemisphereGrid,
    nodes: &[[f32; 3]],
) -> BTreeMap<Cell, Moments> {
    let mut moments: BTreeMap<Cell, Moments> = BTreeMap::new();
    let lit = nodes.iter().enumerate().filter(|(_, r)| **r != [0.0; 3]);
    for (node, radiance) in lit {
        let flux = f64::from(grid.solid_angle) * Vec3::from(*radiance).as_dvec3();
        let mut cell = Cell {
            level: pyramid.finest(),
            node: node as u32,
        };
        loop {
            let of_cell = moments.entry(cell).or_default();
            of_cell.add(flux, grid.directions[node]);
            if cell.level == 0 {
                break;
            }
            cell = pyramid.parent(cell);
        }
    }
    moments
}

/// Points under the light.
struct Lit<'s> {
    design: Design<'s>,
    cells: Vec<Cell>,
    radiance: Vec<[f32; 3]>,
}

/// A lobe under the light.
#[derive(Clone)]
struct Lobe {
    brdf: Brdf,
    /// `K_S` of each channel.
    scale: [f64; 3],
    /// One weight per row.
    weights: Vec<f32>,
    /// What it leaves.
    residuals: Residuals,
    /// Derivative of each row's specular radiance by σ, the diffuse colour and what another `K_S` would do taken out.
    by_sigma: Vec<[f32; 3]>,
}

/// A step of σ, its slope taken out of the weighted squares, and the standard error of σ, radians.
struct Step {
    change: f64,
    error: f64,
}

impl Lobe {
    /// Sum of what it leaves.
    fn left(&self) -> f64 {
        self.residuals.absolute_sum()
    }

    /// F₀, the reflectance at normal incidence.
    fn reflectance(&self) -> f32 {
        self.reflectance_of_unit_scale() * self.mean_scale() as f32
    }

    /// F₀ of a lobe whose `K_S` is 1.
    fn reflectance_of_unit_scale(&self) -> f32 {
        8.0 * PI * self.brdf.sigma.powi(2)
    }

    /// `K_S` in the mean over channels.
    fn mean_scale(&self) -> f64 {
        self.scale.iter().sum::<f64>() / 3.0
    }
}

impl<'s> Lit<'s> {
    fn new(solver: &'s Solver<'_>, observations: &'s Observations, light: &LitCells) -> Self {
        let widest = Brdf::new(SpecularModel::Ggx, SIGMAS[0]);
        let mut design = solver.shadowed_design(observations, &light.cells, &widest);
        design.geometry.clone_from(&light.geometry);
        Self {
            design,
            cells: light.cells.clone(),
            radiance: if observations.gray {
                light.radiance.iter().map(|&l| gray(l)).collect()
            } else {
                light.radiance.clone()
            },
        }
    }

    fn points(&self) -> &[Point] {
        &self.design.observations.points
    }

    /// The best multiple of a lobe.
    fn scaled(&self, brdf: Brdf, weights: Vec<f32>) -> Lobe {
        let mut prediction = self.design.predict(&brdf, &self.radiance);
        let rows = &self.design.observations.rows;
        let mut measured: Vec<[f32; 3]> = rows.iter().map(|row| row.radiance).collect();
        let mut unit = prediction.value.clone();
        let out = |values: &mut [[f32; 3]]| {
            eliminate_all(self.design.observations, &brdf, &weights, values);
        };
        out(&mut measured);
        out(&mut unit);
        let [with, of] = [&measured, &unit].map(|other| products(&weights, &unit, other));
        let scale = ratios(brdf.model, with, of);
        let times = |values: &mut [[f32; 3]]| {
            for value in values {
                *value = [0, 1, 2].map(|c| value[c] * scale[c] as f32);
            }
        };
        times(&mut prediction.value);
        times(&mut prediction.by_sigma);
        let mut by_sigma = prediction.by_sigma.clone();
        out(&mut by_sigma);
        let imitated = ratios_of_any_sign(brdf.model, products(&weights, &unit, &by_sigma), of);
        for (derivative, unit) in by_sigma.iter_mut().zip(&unit) {
            *derivative = [0, 1, 2].map(|c| derivative[c] - imitated[c] as f32 * unit[c]);
        }
        let residuals = residuals(&self.design, &brdf, &weights, &prediction.value);
        Lobe {
            brdf,
            scale,
            weights,
            residuals,
            by_sigma,
        }
    }

    /// The best of some roughnesses.
    fn searched(&self, model: SpecularModel, sigmas: &[f32]) -> Option<Lobe> {
        let weights = initial_weights(&self.design);
        let lobes = sigmas
            .iter()
            .map(|&sigma| self.scaled(Brdf::new(model, sigma), weights.clone()));
        lobes.min_by(|a, b| a.left().total_cmp(&b.left()))
    }

    /// A lobe after rounds of weights, `K_S` and σ in turn; σ stays where it is `stated`. With the standard error of σ.
    fn improved(&self, mut lobe: Lobe, stated: bool, rounds: usize) -> (Lobe, f64) {
        let mut error = f64::INFINITY;
        for _ in 0..rounds {
            let mut brdf = lobe.brdf;
            let step = self.step(&lobe);
            error = step.error;
            let sigma = f64::from(brdf.sigma);
            let change = if stated {
                0.0
            } else {
                step.change.clamp(-LONGEST * sigma, LONGEST * sigma)
            };
            brdf.sigma = ((sigma + change) as f32).clamp(LEAST_SIGMA, MOST_SIGMA);
            brdf.strength = 1.0;
            brdf.strength = lobe.mean_scale() as f32 / brdf.usual_specular_scale();
            let weights = robust_weights(&self.design, &lobe.residuals);
            let settled = change.abs() < SETTLED * sigma && lobe.scale.iter().all(|v| *v > 0.0);
            let before = lobe.mean_scale();
            lobe = self.scaled(brdf, weights);
            let moved = (lobe.mean_scale() - before).abs();
            if self.design.stop.load(Ordering::Relaxed) || settled && moved < SETTLED * before {
                break;
            }
        }
        (lobe, error)
    }

    /// Gauss-Newton's step of σ.
    fn step(&self, lobe: &Lobe) -> Step {
        let (mut slope, mut curvature) = (0.0, 0.0);
        let mut pulls = Vec::with_capacity(self.points().len());
        for point in self.points() {
            let mut own = 0.0;
            for k in point.rows.clone() {
                let w = f64::from(lobe.weights[k]);
                for (z, r) in lobe.by_sigma[k].into_iter().zip(lobe.residuals.values[k]) {
                    own += w * f64::from(z * r);
                    curvature += w * f64::from(z * z);
                }
            }
            slope += own;
            pulls.push(own);
        }
        if curvature <= 0.0 {
            return Step {
                change: 0.0,
                error: f64::INFINITY,
            };
        }
        Step {
            change: slope / curvature,
            error: spread(&pulls, pulls.len().div_ceil(CLUSTERS)) / curvature,
        }
    }

    /// What a lobe leaves of each point.
    fn left_by(&self, lobe: &Lobe) -> Vec<f64> {
        lengths(self.points(), &self.state(lobe).residuals.values)
    }

    /// The light times `K_S`, as estimates have it.
    fn state(&self, lobe: &Lobe) -> State<'s> {
        let scaled = self
            .radiance
            .iter()
            .map(|l| [0, 1, 2].map(|c| l[c] * lobe.scale[c] as f32));
        let mut state = State::new(self.design.clone(), self.cells.clone(), lobe.brdf);
        state.light_by(&scaled.collect::<Vec<_>>());
        state
    }
}

/// The lengths of the rows of each point together.
fn lengths(points: &[Point], values: &[[f32; 3]]) -> Vec<f64> {
    let of_point = |point: &Point| {
        let rows = values[point.rows.clone()].iter();
        rows.map(|&value| f64::from(magnitude(value))).sum()
    };
    points.iter().map(of_point).collect()
}

/// Σ w a b in each channel.
fn products(weights: &[f32], one: &[[f32; 3]], other: &[[f32; 3]]) -> [f64; 3] {
    let mut sums = [0.0; 3];
    for ((&w, a), b) in weights.iter().zip(one).zip(other) {
        for (c, sum) in sums.iter_mut().enumerate() {
            *sum += f64::from(w * a[c] * b[c]);
        }
    }
    sums
}

/// One over the other: in each channel for a metal, whose reflection has a colour; else of all together.
fn ratios_of_any_sign(model: SpecularModel, above: [f64; 3], below: [f64; 3]) -> [f64; 3] {
    let ratio = |above: f64, below: f64| if below > 0.0 { above / below } else { 0.0 };
    if model == SpecularModel::Metal {
        [0, 1, 2].map(|c| ratio(above[c], below[c]))
    } else {
        [ratio(above.iter().sum(), below.iter().sum()); 3]
    }
}

/// The same where nothing is negative.
fn ratios(model: SpecularModel, above: [f64; 3], below: [f64; 3]) -> [f64; 3] {
    ratios_of_any_sign(model, above, below).map(|ratio| ratio.max(0.0))
}

/// The lobe of the form asked for, or of the one that leaves least, with the reason in words; none where it explains no more of the
/// points than diffuse colours alone do, beyond chance.
fn choose(
    solver: &Solver<'_>,
    lit: &Lit<'_>,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<(Lobe, String)>, Stopped> {
    let best = best(solver, lit, choice.or(&SpecularModel::ALL), watch)?;
    Ok(best.filter(|(best, _)| {
        let without = Lobe {
            scale: [0.0; 3],
            ..best.clone()
        };
        signed_ranks(&lit.left_by(&without), &lit.left_by(best)) > SURE
    }))
}

/// The lobe that leaves least of some forms, with the reason in words.
fn best(
    solver: &Solver<'_>,
    lit: &Lit<'_>,
    models: &[SpecularModel],
    watch: &mut Watch<'_>,
) -> Result<Option<(Lobe, String)>, Stopped> {
    let sigmas: &[f32] = solver.sigma.as_ref().map_or(&SIGMAS, std::slice::from_ref);
    let mut fits = Vec::with_capacity(models.len());
    for &model in models {
        watch.observer.interim(Interim::Lobe(model));
        go_on(watch.observer.progress("comparing lobes", 0.6))?;
        fits.extend(lit.searched(model, sigmas));
    }
    let least = fits.iter().map(Lobe::left).fold(f64::INFINITY, f64::min);
    fits.retain(|lobe| lobe.left() <= CLEARLY_MORE * least);
    let stated = solver.sigma.is_some();
    for lobe in &mut fits {
        go_on(watch.observer.progress("comparing lobes", 0.65))?;
        *lobe = lit.improved(lobe.clone(), stated, ROUNDS).0;
    }
    fits.sort_by(|a, b| a.left().total_cmp(&b.left()));
    let because = match &fits[..] {
        [best, second, ..] => diagnose::chosen([best, second].map(|l| (l.left(), l.brdf.model))),
        _ if models.len() == 1 => "it was asked for".to_owned(),
        _ => "every other form of the lobe leaves clearly more".to_owned(),
    };
    Ok(fits.into_iter().next().map(|best| (best, because)))
}

/// How the light is turned, radians, and what to doubt about it.
struct Turned {
    angle: f32,
    doubt: Option<String>,
}

/// A turn that was tried, with what it leaves.
struct Trial {
    angle: f32,
    left: f64,
    lobe: Lobe,
}

/// The turn under which the highlights are explained best.
fn align(
    solver: &Solver<'_>,
    light: &GivenLight<'_>,
    watch: &mut Watch<'_>,
) -> Result<Turned, Stopped> {
    go_on(watch.observer.progress("turning the light", 0.0))?;
    let nodes = (light.nodes)(0.0);
    let halves = [0, 1].map(|half| solver.coarse.every(2, half));
    let mut lit = Lit::new(solver, &halves[0], &LitCells::roots(solver));
    let stated = solver.sigma.as_ref();
    let sigmas: &[f32] = stated.map_or(&SEARCHED, std::slice::from_ref);
    let mut tried: Vec<Trial> = Vec::with_capacity(TURNS);
    for k in 0..TURNS {
        go_on(
            watch
                .observer
                .progress("turning the light", 0.3 * k as f32 / TURNS as f32),
        )?;
        let angle = k as f32 * TAU / TURNS as f32;
        lit.radiance = turned(solver, &nodes, angle);
        let best = lit.searched(SpecularModel::Ggx, sigmas);
        tried.extend(best.map(|lobe| Trial {
            angle,
            left: lobe.left(),
            lobe,
        }));
    }
    tried.sort_by(|a, b| a.left.total_cmp(&b.left));
    let mut apart: Vec<Trial> = Vec::new();
    for trial in tried {
        if apart.len() < REFINED
            && apart
                .iter()
                .all(|other| turn_between(other.angle, trial.angle) > SAME_TURN)
        {
            apart.push(trial);
        }
    }
    go_on(watch.observer.progress("turning the light", 0.35))?;
    let refined = apart
        .into_par_iter()
        .map(|trial| refined(solver, light, &halves, trial));
    let mut refined: Vec<(Trial, Vec<[f32; 3]>)> = refined.collect();
    refined.sort_by(|a, b| a.0.left.total_cmp(&b.0.left));
    let Some((best, left)) = refined.first() else {
        return Ok(Turned {
            angle: 0.0,
            doubt: None,
        });
    };
    // Those that came to the same turn are no other.
    let mut other = refined[1..]
        .iter()
        .filter(|(trial, _)| turn_between(best.angle, trial.angle) > SAME_TURN);
    let judges = &halves[1].points;
    let is_sure = best.lobe.mean_scale() > 0.0
        && other.all(|(_, by_other)| is_better(judges, left, by_other));
    Ok(Turned {
        angle: best.angle,
        doubt: (!is_sure).then(|| TURN_OPEN.to_owned()),
    })
}

/// Whether points are better explained by what leaves `left` of their rows than by what leaves `by_other`, beyond chance. Only those
/// are asked on which the two differ: most points show no highlight under either.
fn is_better(points: &[Point], left: &[[f32; 3]], by_other: &[[f32; 3]]) -> bool {
    let apart = left.iter().zip(by_other);
    let apart: Vec<[f32; 3]> = apart
        .map(|(a, b)| (Vec3::from(*a) - Vec3::from(*b)).to_array())
        .collect();
    // What they say differently is the difference of what they leave, whatever was measured.
    let apart = lengths(points, &apart);
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| apart[b].total_cmp(&apart[a]));
    let mut unasked = ASKED * apart.iter().sum::<f64>();
    order.retain(|&point| {
        let is_asked = unasked > 0.0;
        unasked -= apart[point];
        is_asked
    });
    // Neighbours stay together.
    order.sort_unstable();
    let [left, by_other] = [left, by_other].map(|values| {
        let of_point = lengths(points, values);
        order
            .iter()
            .map(|&point| of_point[point])
            .collect::<Vec<f64>>()
    });
    signed_ranks(&by_other, &left) > SURE
}

/// The smaller angle between two turns, radians.
fn turn_between(one: f32, other: f32) -> f32 {
    let apart = (one - other).rem_euclid(TAU);
    apart.min(TAU - apart)
}

/// Radiance of the coarsest cells under a turned light, in units of the observations' scale.
fn turned(solver: &Solver<'_>, nodes: &[[f32; 3]], angle: f32) -> Vec<[f32; 3]> {
    let turn = Quat::from_axis_angle(solver.grid.up, angle);
    let roots = solver.pyramid.roots();
    let geometry = solver.pyramid.geometry(&roots);
    let mut radiance = vec![Vec3::ZERO; roots.len()];
    let lit = nodes
        .iter()
        .zip(&solver.grid.directions)
        .filter(|(r, _)| **r != [0.0; 3]);
    for (value, &direction) in lit {
        let root = solver.pyramid.root_at(turn * direction).node as usize;
        let share = solver.grid.solid_angle / (geometry.solid_angles[root] * solver.coarse.scale);
        radiance[root] += Vec3::from(*value) * share;
    }
    radiance.into_iter().map(|r| gray(r.into())).collect()
}

/// The mean of the channels in each of them.
fn gray(radiance: [f32; 3]) -> [f32; 3] {
    [radiance.iter().sum::<f32>() / 3.0; 3]
}

/// A turn brought to where it leaves least of the first half of the points, and what it then leaves of the rows of the others.
fn refined(
    solver: &Solver<'_>,
    light: &GivenLight<'_>,
    halves: &[Observations; 2],
    mut trial: Trial,
) -> (Trial, Vec<[f32; 3]>) {
    let nodes = (light.nodes)(trial.angle);
    let cells = LitCells::of(solver, &nodes, FEW_CELLS);
    let [mut own, mut others] = halves.each_ref().map(|half| Lit::new(solver, half, &cells));
    let directions = own.design.geometry.directions.clone();
    let start = trial.angle;
    // Turned cells are taken to be hidden where they were before.
    let turn_to = |lit: &mut Lit<'_>, angle: f32| {
        let turn = Quat::from_axis_angle(solver.grid.up, angle - start);
        for (to, from) in lit.design.geometry.directions.iter_mut().zip(&directions) {
            *to = turn * *from;
        }
    };
    let stated = solver.sigma.is_some();
    let model = trial.lobe.brdf.model;
    let sigmas = [trial.lobe.brdf.sigma];
    let mut tried = |angle: f32| {
        turn_to(&mut own, angle);
        let (lobe, _) = own
            .searched(model, &sigmas)
            .map(|lobe| own.improved(lobe, stated, TURNING_ROUNDS))?;
        Some(Trial {
            angle,
            left: lobe.left(),
            lobe,
        })
    };
    if let Some(here) = tried(start) {
        trial = here;
    }
    let mut step = 0.5 * TAU / TURNS as f32;
    while step > LEAST_TURN && !solver.stop.load(Ordering::Relaxed) {
        let beside = [-step, step]
            .into_iter()
            .filter_map(|by| tried(trial.angle + by));
        match beside.min_by(|a, b| a.left.total_cmp(&b.left)) {
            Some(better) if better.left < trial.left => trial = better,
            _ => step *= 0.5,
        }
    }
    turn_to(&mut others, trial.angle);
    let left = others.state(&trial.lobe).residuals.values;
    (trial, left)
}

/// Roughness and strength in the end.
struct Found {
    lobe: Lobe,
    /// Standard error of σ, radians.
    error: f64,
    misfit: Misfit,
    parts: Option<GlossParts>,
}

/// A lobe's end, after `rounds` in which the surface's parts and the lobe take turns where some parts are glossier than others.
fn with_parts(
    solver: &Solver<'_>,
    lit: &Lit<'_>,
    lobe: Lobe,
    rounds: usize,
    watch: &mut Watch<'_>,
) -> Result<Found, Stopped> {
    go_on(
        watch
            .observer
            .progress("looking for parts of other gloss", 0.8),
    )?;
    let stated = solver.sigma.is_some();
    let (lobe, error) = lit.improved(lobe, stated, ROUNDS);
    let state = lit.state(&lobe);
    solver.report(&state, watch)?;
    let parts = if rounds > 0 && !stated {
        solver.gloss_parts(&state, [SURE])
    } else {
        None
    };
    let Some((parts, main)) = parts else {
        return Ok(Found {
            misfit: Misfit::of(&state),
            parts: solver.seen.parts.cloned(),
            lobe,
            error,
        });
    };
    let parted = solver.parted(&parts);
    let observations = lit.design.observations.of_parts(&parts);
    let cells = LitCells {
        cells: lit.cells.clone(),
        radiance: lit.radiance.clone(),
        geometry: lit.design.geometry.clone(),
    };
    let on_parts = Lit::new(&parted, &observations, &cells);
    let mut brdf = lobe.brdf;
    brdf.sigma *= main.roughness;
    let start = on_parts.scaled(brdf, lobe.weights);
    with_parts(&parted, &on_parts, start, rounds - 1, watch)
}

/// The result without a specular part, with what is to be said.
fn diffuse(
    mut estimate: Estimate,
    turn: f32,
    nodes: Vec<[f32; 3]>,
    said: Vec<String>,
) -> UnderGivenLight {
    estimate.radiance = nodes;
    estimate.diagnostics.warnings = said;
    UnderGivenLight {
        estimate,
        turn,
        specular_scale: [1.0; 3],
    }
}

/// The result, with what is to be said of it.
fn told(
    mut estimate: Estimate,
    found: Found,
    turned: Turned,
    because: String,
    nodes: &[[f32; 3]],
) -> UnderGivenLight {
    let Found {
        lobe,
        error,
        misfit,
        parts,
    } = found;
    let reflectance = lobe.reflectance();
    let brdf = lobe.brdf.with_reflectance(reflectance);
    let scale = lobe.scale.map(|k| k as f32);
    let scaled = nodes.iter().map(|l| [0, 1, 2].map(|c| l[c] * scale[c]));
    estimate.radiance = scaled.collect();
    estimate.chosen_because = because;
    if let Some(parts) = &parts {
        estimate.chosen_because += &diagnose::parts(parts, brdf.sigma);
    }
    let half = HALF_INTERVAL * error as f32;
    let interval = [brdf.sigma - half, brdf.sigma + half].map(|end| end.clamp(0.0, MOST_SIGMA));
    estimate.sigma_interval95 = (error > 0.0 && error.is_finite()).then_some(interval);
    let doubts = [
        turned.doubt,
        units(brdf.model, reflectance),
        diagnose::misfit(&misfit, None),
    ];
    estimate.diagnostics.well_posed = doubts.iter().all(Option::is_none);
    estimate.diagnostics.warnings = doubts.into_iter().flatten().collect();
    estimate.diagnostics.specular_found = true;
    estimate.misfit = Some(misfit.share);
    estimate.brdf = Some(brdf);
    estimate.parts = parts;
    UnderGivenLight {
        estimate,
        turn: turned.angle,
        specular_scale: scale,
    }
}

/// What to doubt about a reflectance at normal incidence that no such surface has.
fn units(model: SpecularModel, reflectance: f32) -> Option<String> {
    let range = match model {
        SpecularModel::Metal => LEAST_DIELECTRIC..=1.0,
        _ => LEAST_DIELECTRIC..=MOST_DIELECTRIC,
    };
    (!range.contains(&reflectance)).then(|| {
        format!(
            "Under the given light the surface reflects {:.1} % at normal incidence, which hardly anything does: the light's picture and \
             the photographs are probably not in the same units, or the picture's lights are clipped. Albedo and gloss are off by the \
             same factor. Give both the same exposure scale.",
            100.0 * reflectance
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_of_light_spreads_a_lobe_by_a_quarter_of_its_variance() {
        let up = Vec3::new(0.48, 0.6, 0.64);
        let grid = HemisphereGrid::new(70, up, None, Vec3::ZERO);
        for radius in [0.1_f32, 0.2] {
            let mut disc = Moments::default();
            for &direction in &grid.directions {
                if direction.dot(up) > radius.cos() {
                    disc.add(DVec3::new(1.0, 2.0, 3.0), direction);
                }
            }
            // A disc's variance along an axis is a quarter of its radius squared.
            let expected = f64::from(radius * radius) / 16.0;
            assert!((disc.spread() / expected - 1.0).abs() < 0.05, "{radius}");
            assert!(disc.towards.as_vec3().angle_between(up) < 0.01);
        }
        let mut point = Moments::default();
        point.add(DVec3::ONE, up);
        assert!(point.spread() < 1e-7);
    }
}
