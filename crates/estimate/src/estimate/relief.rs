//! The surface of a mesh that is coarser or noisier than its highlights allow, refined by them.
//!
//! Normals that are off by as much as the lobe is wide make highlights look like those of many lights in a narrow lobe.
//! The fair surface through the mesh ([`Fairing`]) is nearer to the object, but not near enough. So its places are moved
//! along its normals by heights d, which are estimated together with a few lamps and σ as the minimum of
//!
//! `Σ w (I − I_S(n(d), lamps, σ) − diffuse)²/s² + dᵀ P d`
//!
//! over the rows of all points that show a lamp, each point's diffuse colour eliminated as everywhere. s² is the mean
//! squared residual and P the precision of the fair surface, so both parts are in their own units
//! and nothing is tuned. A height moves the normals around it; what it does to places is left to the next round.
//!
//! Lamps are points here. Cells would do what normals are wanted to do: with many of them lit, any normals will do. And
//! they are looked for with a lobe that is too wide, which lights few cells. The final lights and σ are estimated from
//! the refined surface afresh.
//!
//! Under broad light, as in a room, few lamps are no explanation, and normals bent to serve as one are worse than the fair
//! ones. So the first rounds leave some views out, which the heights then have to explain better than the fair surface does;
//! where they do not, the fair surface it is.

use std::borrow::Cow;
use std::collections::BTreeMap;

use faer::linalg::solvers::Solve;
use faer::{Col, Mat};
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::SpecularChoice;
use super::cells::{Cell, CellGeometry};
use super::course::choose;
use super::design::Design;
use super::fast::{CoarseFit, Solver, Watch};
use super::held_out::{CHANCE, common_noise, in_noise, left_in};
use super::observations::{Observations, Point, Seen};
use super::observer::{Stopped, go_on};
use super::state::ROUGH;
use super::visibility::{SeenCells, cell_visibility};
use super::weights::{eliminate_all, mean_weights, median, residuals};
use rekindle_base::math::ranks::signed_ranks;
use rekindle_base::math::sparse::LowerEntries;
use rekindle_capture::{Mesh, View};
use rekindle_scene::hemisphere::{Lamp, find_lamps};
use rekindle_scene::reflectance::{Brdf, SpecularModel};
use rekindle_scene::surface::{
    Fairing, NO_TRIANGLE, Occluder, ViewSurface, area_vectors, simplified,
};

/// The lobe with which lamps are looked for over the one that fits best on unrefined normals.
const WIDER: f32 = 2.0;

/// Most lamps, and the least share of the flux of one.
const MOST_LAMPS: usize = 12;
const LEAST_SHARE: f32 = 0.03;

/// Rounds, and those in which σ stays as it is, so that the lamps find their places first.
const ROUNDS: usize = 8;
const ROUNDS_AT_FIRST_SIGMA: usize = 2;
/// Rounds from all views but some, which then have to be explained better; and the points at which they are looked at.
const ROUNDS_ON_TRIAL: usize = 4;
const POINTS_ON_TRIAL: usize = 4000;
/// One view in so many is left out then.
const TURNS: usize = 3;
/// A round that changes σ by less than this part of it is the last.
const SETTLED: f32 = 5e-3;

/// Pixels that a triangle must cover for the views to show more than it says: it is divided into sixteen.
const LEAST_PIXELS: f64 = 16.0;

/// Most triangles of a surface with places of its own to move.
const MOST_TRIANGLES: usize = 90_000;
/// How noisy surfaces are smoothed: how many times fewer triangles they get, and below which length, in their edges. What is
/// smoothed much needs few triangles.
const SMOOTHINGS: [(usize, f64); 6] = [
    (1, 0.25),
    (1, 0.5),
    (1, 1.0),
    (4, 1.0),
    (16, 1.0),
    (64, 1.0),
];

/// A surface that leaves so many times as much as a less smooth one is smoothed too much, as all smoother ones are.
const TOO_MUCH: f64 = 1.25;

/// Most points that take part.
const POINTS: usize = 24_000;
/// They are always cut into this many runs, so that sums come out the same on any number of threads.
const RUNS: usize = 4;

/// Pixels of a view at which the normals of two surfaces are compared, about.
const TILTS_PER_VIEW: usize = 20_000;

/// Angle by which normals and lamps are turned for their derivatives, radians.
const TURN: f32 = 1e-3;

/// Longest step of σ and of a flux, relative, and of a lamp's direction, radians.
const LONGEST_SIGMA_STEP: f64 = 0.3;
const LONGEST_FLUX_STEP: f32 = 0.5;
const LONGEST_TURN: f32 = 0.05;

/// Unknowns of one lamp: two of its direction, three of its flux.
const PER_LAMP: usize = 5;

/// A finer mesh in place of a coarse one.
#[derive(Clone, Debug)]
pub struct RefinedSurface {
    /// The surface, without texture coordinates.
    pub mesh: Mesh,
    /// Median angle by which normals were turned, radians.
    pub median_tilt: f32,
}

/// What a solver needs beside a mesh: what the views see of it, and what hides what.
pub struct Bench {
    occluder: Occluder,
    surfaces: Vec<ViewSurface>,
}

impl Bench {
    /// Looks at a mesh from all views.
    pub fn new(mesh: &Mesh, views: &[View]) -> Self {
        let occluder = Occluder::new(mesh);
        let surfaces = views
            .iter()
            .map(|v| ViewSurface::new(mesh, &occluder, &v.camera))
            .collect();
        Self { occluder, surfaces }
    }

    /// The solver of the same capture with `mesh` in place of its own.
    pub fn solver<'b>(&'b self, other: &'b Solver<'_>, mesh: &'b Mesh) -> Solver<'b> {
        let seen = Seen {
            mesh,
            surfaces: &self.surfaces,
            ..other.seen
        };
        Solver {
            coarse: Solver::coarse_observations(&seen, Some(other.coarse.scale), other.stop),
            seen,
            occluder: &self.occluder,
            ..*other
        }
    }
}

/// Point lights with the lobe that shows them.
#[derive(Clone, Debug)]
struct Lamps {
    /// Unit directions from the object's centre.
    directions: Vec<Vec3>,
    /// Radiance × solid angle, RGB, in units of the observations' scale.
    flux: Vec<[f32; 3]>,
    brdf: Brdf,
}

/// A surface on its way.
struct Relief {
    fairing: Fairing,
    /// Unit normals of the fair surface, along which places move.
    along: Vec<DVec3>,
    /// How far, mesh units.
    heights: Vec<f64>,
}

/// A surface that explains the highlights better than the solver's; `None` where the mesh is neither coarse nor noisy or does not
/// determine a fair one, or no lamps are found. `coarse` is a fit on the solver's own surface.
pub fn refine(
    solver: &Solver<'_>,
    coarse: &CoarseFit<'_>,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<Mesh>, Stopped> {
    const WHAT: &str = "refining the surface";
    go_on(watch.observer.progress(WHAT, 0.3))?;
    let start = if pixels_per_triangle(&solver.seen) >= LEAST_PIXELS {
        Fairing::new(solver.seen.mesh).map(Relief::new)
    } else {
        smoothed(solver, coarse, watch)?
    };
    let Some(mut relief) = start else {
        return Ok(None);
    };
    let smooth = relief.mesh();
    let bench = Bench::new(&smooth, solver.seen.views);
    let solver = bench.solver(solver, &smooth);
    let (mut lamps, sigma) = wide_lamps(&solver, choice, watch)?;
    if lamps.directions.is_empty() {
        return Ok(None);
    }
    let is_out = |view: usize| view.is_multiple_of(TURNS);
    // Of fewer views none can be spared.
    let on_trial = if solver.seen.views.len() < TURNS {
        0
    } else {
        ROUNDS_ON_TRIAL
    };
    for round in 0..ROUNDS {
        let done = 0.3 + 0.3 * round as f32 / ROUNDS as f32;
        go_on(watch.observer.progress(WHAT, done))?;
        let mut points = relief.points(&solver, &lamps);
        if round < on_trial {
            points = points.without_views(is_out).0;
        }
        let free_sigma = round >= ROUNDS_AT_FIRST_SIGMA;
        let before = lamps.brdf.sigma;
        let step = relief.step(&solver, &mut lamps, &points, free_sigma);
        if step.is_none() || watch.observer.enough() {
            break;
        }
        if round + 1 == on_trial {
            let sigmas = [sigma, WIDER * sigma, lamps.brdf.sigma];
            if !relief.predicts(&solver, &lamps, &sigmas, is_out) {
                return Ok(Some(smooth));
            }
        }
        if free_sigma && round >= on_trial && (lamps.brdf.sigma / before - 1.0).abs() < SETTLED {
            break;
        }
    }
    Ok(Some(relief.mesh()))
}

/// Median angle between the normals of two surfaces at the pixels that show both, radians.
pub fn median_tilt(before: &Seen<'_>, after: &Seen<'_>) -> f32 {
    let mut tilts = Vec::new();
    let surfaces = before.surfaces.iter().zip(after.surfaces);
    for (view, (one, other)) in before.views.iter().zip(surfaces) {
        // An odd step falls on all columns in turn.
        let step = one.interior.len().div_ceil(TILTS_PER_VIEW) | 1;
        for i in (0..one.interior.len()).step_by(step) {
            let (x, y) = (i as u32 % one.width, i as u32 / one.width);
            let normal = |surface: &ViewSurface, mesh| {
                let point = surface.point(mesh, &view.camera, x, y)?;
                surface.interior[i].then_some(point.normal)
            };
            if let (Some(a), Some(b)) = (normal(one, before.mesh), normal(other, after.mesh)) {
                tilts.push(a.angle_between(b));
            }
        }
    }
    median(&mut tilts)
}

/// The surface through a mesh that is as fine as the pictures, smoothed as much as these say: until a coarse fit leaves more
/// than with less smoothing. What is smoothed much needs few triangles.
fn smoothed(
    solver: &Solver<'_>,
    coarse: &CoarseFit<'_>,
    watch: &mut Watch<'_>,
) -> Result<Option<Relief>, Stopped> {
    let pixels = |surface: &ViewSurface| {
        let object = surface.triangle.iter().filter(|&&t| t != NO_TRIANGLE);
        object.count()
    };
    let largest = solver.seen.surfaces.iter().map(pixels).max().unwrap_or(0);
    let model = coarse.state.brdf.model;
    let (mut least, mut best) = (f64::INFINITY, None);
    let mut simpler = (0, Cow::Borrowed(solver.seen.mesh));
    for (coarser, length) in SMOOTHINGS {
        go_on(watch.observer.progress("smoothing the surface", 0.3))?;
        if coarser != simpler.0 {
            let triangles = largest.min(MOST_TRIANGLES) / coarser;
            simpler = (coarser, Cow::Owned(simplified(solver.seen.mesh, triangles)));
        }
        let mesh = &*simpler.1;
        let Some(fairing) = Fairing::smoothing(mesh, length * spacing(mesh)) else {
            continue;
        };
        let relief = Relief::new(fairing);
        let smooth = relief.mesh();
        let bench = Bench::new(&smooth, solver.seen.views);
        let again = bench.solver(solver, &smooth);
        let fit = again.compare_sigmas(model, None, watch)?;
        if fit.unexplained > TOO_MUCH * least {
            break;
        }
        if fit.unexplained < least {
            (least, best) = (fit.unexplained, Some(relief));
        }
    }
    Ok(best)
}

/// Mean length of the edges of a mesh with one vertex a place.
fn spacing(mesh: &Mesh) -> f64 {
    let edges = mesh.triangles.iter().flat_map(|&[a, b, c]| {
        [(a, b), (b, c), (c, a)].map(|(p, q)| {
            let [p, q] = [p, q].map(|v| mesh.positions[v as usize]);
            f64::from(p.distance(q))
        })
    });
    edges.sum::<f64>() / (3 * mesh.triangles.len()).max(1) as f64
}

/// Pixels that a triangle covers in a view that shows it, in the mean.
fn pixels_per_triangle(seen: &Seen<'_>) -> f64 {
    let (mut pixels, mut shown) = (0_usize, 0_usize);
    for surface in seen.surfaces {
        let object = surface.triangle.iter().filter(|&&t| t != NO_TRIANGLE);
        let mut triangles: Vec<u32> = object.copied().collect();
        pixels += triangles.len();
        triangles.sort_unstable();
        triangles.dedup();
        shown += triangles.len();
    }
    pixels as f64 / shown.max(1) as f64
}

/// Long tails would explain normals that are off.
const SHORT_TAILED: [SpecularModel; 2] = [SpecularModel::Paper, SpecularModel::Beckmann];

/// Lamps in a lobe that is too wide: few, and where the highlights are in the mean over the surface. Beside them the σ of the lobe
/// that fits best.
fn wide_lamps(
    solver: &Solver<'_>,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<(Lamps, f32), Stopped> {
    let (coarse, _) = choose(solver, choice, &SHORT_TAILED, watch)?;
    let points = solver.middle_observations(&coarse.state);
    let mut state = solver.refine(&coarse.state, &points);
    state.brdf.sigma *= WIDER;
    state.solve_lights(ROUGH);
    let nodes = solver.pyramid.to_nodes(&state.cells, &state.radiance);
    let mut found = find_lamps(solver.grid, &nodes);
    let total: f32 = found.iter().map(Lamp::mean_flux).sum();
    found.retain(|l| l.mean_flux() > LEAST_SHARE * total);
    found.truncate(MOST_LAMPS);
    let lamps = Lamps {
        directions: found.iter().map(|l| l.direction).collect(),
        flux: found.iter().map(|l| l.flux).collect(),
        brdf: state.brdf,
    };
    Ok((lamps, coarse.state.brdf.sigma))
}

impl Lamps {
    fn geometry(&self) -> CellGeometry {
        CellGeometry {
            directions: self.directions.clone(),
            solid_angles: vec![1.0; self.directions.len()],
            spread: vec![0.0; self.directions.len()],
        }
    }

    /// The coarsest cells that they lie in.
    fn around(&self, solver: &Solver<'_>) -> Vec<Cell> {
        let directions = self.directions.iter();
        directions.map(|&d| solver.pyramid.root_at(d)).collect()
    }

    fn turned(&self, lamp: usize, by: Vec3) -> Self {
        let mut turned = self.clone();
        turned.directions[lamp] = (self.directions[lamp] + by).normalize_or_zero();
        turned
    }

    /// Derivatives of every row's specular radiance: by σ, then lamp by lamp by the direction along two tangents and by
    /// the three channels' flux.
    fn derivatives(&self, design: &Design<'_>) -> Vec<Vec<[f32; 3]>> {
        let mut columns = vec![design.predict(&self.brdf, &self.flux).by_sigma];
        for (lamp, direction) in self.directions.iter().enumerate() {
            let (t1, t2) = direction.any_orthonormal_pair();
            for tangent in [t1, t2] {
                columns.push(central_difference(|by| {
                    let geometry = self.turned(lamp, by * tangent).geometry();
                    let turned = Design {
                        geometry,
                        ..design.clone()
                    };
                    turned.predict(&self.brdf, &self.flux).value
                }));
            }
            for channel in 0..3 {
                let mut unit = vec![[0.0; 3]; self.flux.len()];
                unit[lamp][channel] = 1.0;
                columns.push(design.predict(&self.brdf, &unit).value);
            }
        }
        columns
    }

    /// Takes a step of the unknowns in the order of [`Lamps::derivatives`], no part of it too long.
    fn take(&mut self, step: &Col<f64>) {
        let sigma = f64::from(self.brdf.sigma);
        let limit = LONGEST_SIGMA_STEP * sigma;
        self.brdf.sigma = (sigma + step[0].clamp(-limit, limit)) as f32;
        for lamp in 0..self.directions.len() {
            let at = |k: usize| step[1 + PER_LAMP * lamp + k] as f32;
            let (t1, t2) = self.directions[lamp].any_orthonormal_pair();
            let turn = (at(0) * t1 + at(1) * t2).clamp_length_max(LONGEST_TURN);
            self.directions[lamp] = (self.directions[lamp] + turn).normalize_or_zero();
            for (channel, flux) in self.flux[lamp].iter_mut().enumerate() {
                let limit = LONGEST_FLUX_STEP * *flux;
                *flux += at(2 + channel).clamp(-limit, limit);
            }
        }
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

/// The same points with every normal turned by `angle` towards the first or second tangent of its frame.
pub fn tilted(observations: &Observations, second: bool, angle: f32) -> Observations {
    let mut tilted = observations.clone();
    turn(&mut tilted, |point| {
        let (t1, t2) = point.normal.any_orthonormal_pair();
        let tangent = if second { t2 } else { t1 };
        (point.normal + angle * tangent).normalize_or_zero()
    });
    tilted
}

/// Gives every point another normal.
fn turn(observations: &mut Observations, normal: impl Fn(&Point) -> Vec3) {
    for point in &mut observations.points {
        point.normal = normal(point);
        for row in &mut observations.rows[point.rows.clone()] {
            row.cos_view = point.normal.dot(row.to_camera);
        }
    }
}

/// Normal equations of heights and lamps.
struct Equations {
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
    fn new(heights: usize, unknowns: usize) -> Self {
        Self {
            heights: LowerEntries::default(),
            gradient: vec![0.0; heights],
            coupling: vec![vec![0.0; heights]; unknowns],
            lamps: Mat::zeros(unknowns, unknowns),
            lamps_gradient: Col::zeros(unknowns),
        }
    }

    /// Adds a point: `tilts` holds the derivative of its normal's tilt, along two tangents, by each height that turns it.
    fn add(&mut self, point: &PointEquations, tilts: &[(usize, DVec2)]) {
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
    fn merge(&mut self, other: &Self) {
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

    /// Steps of heights and lamps: the heights are eliminated first, as there are many of them but few that meet.
    fn solve(mut self) -> Option<(Vec<f64>, Col<f64>)> {
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
        let lamps = self.lamps.partial_piv_lu().solve(&self.lamps_gradient);
        let heights = (0..count)
            .map(|i| x[(i, 0)] - (0..unknowns).map(|a| x[(i, a + 1)] * lamps[a]).sum::<f64>())
            .collect();
        lamps.is_all_finite().then_some((heights, lamps))
    }
}

/// Residuals of all rows with their derivatives, each point's diffuse colour taken out of both.
struct LinearRows {
    /// Weights over the variance of the residuals.
    weights: Vec<f64>,
    left: Vec<[f32; 3]>,
    /// By the tilt of the point's normal along the two tangents of its frame.
    by_tilt: [Vec<[f32; 3]>; 2],
    /// By each of the lamps' unknowns.
    by_lamps: Vec<Vec<[f32; 3]>>,
}

impl LinearRows {
    fn new(design: &Design<'_>, lamps: &Lamps, free_sigma: bool) -> Self {
        let brdf = &lamps.brdf;
        let prediction = design.predict(brdf, &lamps.flux);
        let (weights, variance) = mean_weights(design, brdf, &prediction);
        let left = residuals(design, brdf, &weights, &prediction).values;
        let mut by_tilt = [false, true].map(|second| {
            central_difference(|angle| {
                let observations = &tilted(design.observations, second, angle);
                let design = Design {
                    observations,
                    ..design.clone()
                };
                design.predict(brdf, &lamps.flux).value
            })
        });
        let mut by_lamps = lamps.derivatives(design);
        if !free_sigma {
            by_lamps[0].fill([0.0; 3]);
        }
        for column in by_tilt.iter_mut().chain(&mut by_lamps) {
            eliminate_all(design.observations, brdf, &weights, column);
        }
        Self {
            weights: weights.iter().map(|w| f64::from(*w) / variance).collect(),
            left,
            by_tilt,
            by_lamps,
        }
    }

    /// A point's equations; those of the lamps alone are added to `equations`.
    fn point_equations(&self, point: &Point, equations: &mut Equations) -> PointEquations {
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

/// What one point's rows say: of its normal's tilt (xx, xy, yy), and of the tilt with each lamps' unknown.
struct PointEquations {
    tilt: [f64; 3],
    gradient: DVec2,
    coupling: Vec<DVec2>,
}

/// A unit normal with its derivatives by heights.
type Slopes = (DVec3, Vec<(usize, DVec3)>);

impl Relief {
    fn new(fairing: Fairing) -> Self {
        let along = area_vectors(&fairing.positions, &fairing.triangles)
            .iter()
            .map(|n| n.normalize_or_zero())
            .collect();
        let heights = vec![0.0; fairing.positions.len()];
        Self {
            fairing,
            along,
            heights,
        }
    }

    fn positions(&self) -> Vec<DVec3> {
        let places = self.fairing.positions.iter().zip(&self.along);
        places
            .zip(&self.heights)
            .map(|((p, n), h)| *p + *h * *n)
            .collect()
    }

    fn mesh(&self) -> Mesh {
        self.fairing.mesh_at(&self.positions())
    }

    /// Points that show a lamp, with the normals of the present surface; `solver` is of the fair one.
    fn points(&self, solver: &Solver<'_>, lamps: &Lamps) -> Observations {
        let mut points = solver.points_showing(&lamps.directions, &lamps.brdf, POINTS);
        self.turn(&mut points);
        points
    }

    /// Gives points of the fair surface the normals of the present one.
    fn turn(&self, observations: &mut Observations) {
        let mesh = self.mesh();
        turn(observations, |point| {
            mesh.point(point.on.0, point.on.1).normal
        });
    }

    /// Whether views that had no say in the heights are explained better by them, beyond chance, than by the fair surface at any of
    /// some roughnesses: with the lamps that were found, as bright on each surface as the other views say.
    fn predicts(
        &self,
        solver: &Solver<'_>,
        lamps: &Lamps,
        sigmas: &[f32],
        is_out: impl Fn(usize) -> bool,
    ) -> bool {
        let fair = solver.points_showing(&lamps.directions, &lamps.brdf, POINTS_ON_TRIAL);
        let fair = fair.to_gray();
        let mut present = fair.clone();
        self.turn(&mut present);
        let [fair, present] = [&fair, &present].map(|points| design(solver, lamps, points));
        let around = lamps.around(solver);
        let noise = common_noise(&fair);
        let left = |on: &Design<'_>, sigma: f32| -> Vec<f64> {
            let brdf = Brdf {
                sigma,
                ..lamps.brdf
            };
            let left = left_in(on, &around, brdf, &in_noise(on, noise), &[0.0], &is_out);
            left.iter().flatten().map(|left| left.lit).collect()
        };
        let refined = left(&present, lamps.brdf.sigma);
        let is_better = |&sigma: &f32| signed_ranks(&left(&fair, sigma), &refined) > CHANCE;
        sigmas.iter().all(is_better)
    }

    /// A Gauss-Newton step of heights and lamps from points with the present surface's normals. `None` where there is none.
    fn step(
        &mut self,
        solver: &Solver<'_>,
        lamps: &mut Lamps,
        observations: &Observations,
        free_sigma: bool,
    ) -> Option<()> {
        let rows = LinearRows::new(&design(solver, lamps, observations), lamps, free_sigma);
        let slopes = self.slopes();
        let points = &observations.points;
        let parts: Vec<Equations> = (0..RUNS)
            .into_par_iter()
            .map(|run| {
                let cut = |k: usize| points.len() * k / RUNS;
                let mut equations = Equations::new(self.heights.len(), rows.by_lamps.len());
                for point in &points[cut(run)..cut(run + 1)] {
                    let own = rows.point_equations(point, &mut equations);
                    equations.add(&own, &self.tilts(point, &slopes));
                }
                equations
            })
            .collect();
        let mut equations = Equations::new(self.heights.len(), rows.by_lamps.len());
        for part in &parts {
            equations.merge(part);
        }
        let Equations {
            heights, gradient, ..
        } = &mut equations;
        self.fairing.add_prior(&self.heights, heights, gradient);
        let (step, lamps_step) = equations.solve()?;
        for (h, s) in self.heights.iter_mut().zip(step) {
            *h += s;
        }
        lamps.take(&lamps_step);
        Some(())
    }

    /// For each place its unit normal, and the derivative of that by every height that turns it.
    fn slopes(&self) -> Vec<Slopes> {
        let positions = self.positions();
        let triangles = &self.fairing.triangles;
        let mut by_height: Vec<BTreeMap<usize, DVec3>> = vec![BTreeMap::new(); positions.len()];
        for t in triangles {
            for k in 0..3 {
                let [i, j, l] = [t[k], t[(k + 1) % 3], t[(k + 2) % 3]];
                // Of the area vector ½ (xᵢ × xⱼ + xⱼ × xₗ + xₗ × xᵢ).
                let slope = 0.5 * (positions[l] - positions[j]).cross(self.along[i]);
                for &place in t {
                    *by_height[place].entry(i).or_default() += slope;
                }
            }
        }
        let sums = area_vectors(&positions, triangles);
        sums.into_iter()
            .zip(by_height)
            .map(|(sum, slopes)| {
                let normal = sum.normalize_or_zero();
                let unit = |d: DVec3| (d - normal * normal.dot(d)) / sum.length().max(1e-300);
                (
                    normal,
                    slopes.into_iter().map(|(i, d)| (i, unit(d))).collect(),
                )
            })
            .collect()
    }

    /// Derivative of a point's normal, along the tangents of its frame, by every height that turns it.
    fn tilts(&self, point: &Point, slopes: &[Slopes]) -> Vec<(usize, DVec2)> {
        let (triangle, barycentric) = point.on;
        let weights = [
            1.0 - barycentric.x - barycentric.y,
            barycentric.x,
            barycentric.y,
        ];
        let corners = self.fairing.triangles[triangle as usize];
        let (t1, t2) = point.normal.any_orthonormal_pair();
        let (t1, t2) = (t1.as_dvec3(), t2.as_dvec3());
        let mut sum = DVec3::ZERO;
        let mut tilts: BTreeMap<usize, DVec2> = BTreeMap::new();
        for (&place, weight) in corners.iter().zip(weights) {
            let (normal, slopes) = &slopes[place];
            sum += f64::from(weight) * *normal;
            for (i, slope) in slopes {
                let tilt = DVec2::new(t1.dot(*slope), t2.dot(*slope));
                *tilts.entry(*i).or_default() += f64::from(weight) * tilt;
            }
        }
        let length = sum.length().max(1e-300);
        tilts.into_iter().map(|(i, t)| (i, t / length)).collect()
    }
}

/// Rows under the lamps, with their shadows.
fn design<'o>(solver: &Solver<'o>, lamps: &Lamps, observations: &'o Observations) -> Design<'o> {
    let mut design = Design {
        observations,
        geometry: lamps.geometry(),
        near: solver.near,
        seen: SeenCells::default(),
        diffuse_known: false,
        shortcuts: solver.shortcuts,
        workspace: solver.workspace,
        stop: solver.stop,
    };
    let around = lamps.around(solver);
    design.seen = cell_visibility(
        &design,
        solver.pyramid,
        &around,
        &lamps.brdf,
        solver.occluder,
    );
    design
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::*;
    use rekindle_scene::surface::fixtures::bumpy_sphere;

    #[test]
    fn tilts_by_heights_agree_with_finite_differences() {
        let mut relief = Relief::new(Fairing::new(&bumpy_sphere(8, 0.1)).unwrap());
        for (i, height) in relief.heights.iter_mut().enumerate() {
            *height = 0.01 * (i as f64).sin();
        }
        let on = (700, Vec2::new(0.2, 0.5));
        let normal = |relief: &Relief| relief.mesh().point(on.0, on.1).normal;
        let point = Point {
            position: Vec3::ZERO,
            normal: normal(&relief),
            on,
            gloss: 0,
            rows: 0..0,
        };
        let (t1, t2) = point.normal.any_orthonormal_pair();
        let tilts = relief.tilts(&point, &relief.slopes());
        assert!(tilts.len() >= 10, "{} places turn the normal", tilts.len());
        let largest = tilts.iter().fold(0.0_f64, |m, t| m.max(t.1.length()));
        for (place, tilt) in tilts {
            let step = 1e-3;
            let at = |height: f64| {
                let mut moved = Relief {
                    fairing: relief.fairing.clone(),
                    along: relief.along.clone(),
                    heights: relief.heights.clone(),
                };
                moved.heights[place] += height;
                normal(&moved)
            };
            let turned = (at(step) - at(-step)) / (2.0 * step as f32);
            let difference = Vec2::new(t1.dot(turned), t2.dot(turned)).as_dvec2();
            assert!(
                (difference - tilt).length() < 5e-3 * largest,
                "{difference} against {tilt}, the largest is {largest}"
            );
        }
    }
}
