//! What a metal mirrors beside its lights.
//!
//! Lights are told by what differs between views, each point's diffuse colour eliminated. Walls, floor and sky are broad and dim: in a metal
//! they hardly differ from view to view, go into the diffuse colours, and are then lit by any other light as if the metal were painted. But a
//! metal has no diffuse part: all that it shows beside its lights comes from somewhere. So light x ≥ 0 on broad cells all around is sought that
//! explains this with no diffuse colour, as the minimum of
//!
//! `Σ w (z − A x)² + λ Σ (xᵢ − xⱼ)²`
//!
//! with z what the lights leave and λ what explains views best that had no say. There is such broad light if it explains those views better
//! than diffuse colours do, beyond chance; else it is paint.

use std::sync::atomic::{AtomicBool, Ordering};

use faer::Mat;
use glam::Vec3;
use rayon::prelude::*;

use super::below::AllAround;
use super::cells::Cell;
use super::fast::Solver;
use super::held_lights::HeldLights;
use super::observations::{Observations, Point};
use super::observer::Stopped;
use super::shading::hold_together;
use super::state::State;
use super::weights::{magnitude, median};
use rekindle_base::math::nnls::{self, NnlsParams};
use rekindle_base::math::ranks::{SURE, placed_signed_ranks};
use rekindle_scene::hemisphere::HemisphereGrid;
use rekindle_scene::reflectance::Brdf;

/// Points that are looked at, and frequency of the grid of the cells: 492 of them, 9° apart.
const POINTS: usize = 3000;
pub(super) const FREQUENCY: u32 = 7;
/// The same where it is only asked whether there is a diffuse part: 162 cells, 16° apart.
const FEWER_POINTS: usize = 1500;
const ROUGH_FREQUENCY: u32 = 4;
/// How much cells are held to their neighbours, as parts of the mean diagonal of the equations.
const SMOOTHNESS: [f64; 4] = [1e-3, 1e-2, 0.1, 1.0];
/// Views are left out in so many turns.
const TURNS: usize = 3;
/// Squared standard deviations beyond which a cell says nothing of a node.
const FARTHEST: f32 = 16.0;
/// Part of all radiance below which what broad light shows is what else is left: of gold in the dark, exact and as a scan, it was 0.002, in
/// a room 0.29.
const NEGLIGIBLE: f64 = 0.01;
/// Rounds in which weights and light take turns.
const ROUNDS: usize = 3;

/// Light from all around beside lights.
pub struct BroadLight {
    /// Nodes all around, those above the horizon first.
    pub grid: HemisphereGrid,
    /// Radiance per node, RGB, in the capture's units, of lights and broad light together.
    pub nodes: Vec<[f32; 3]>,
    /// The nodes of the broad light, which no other light has.
    pub own: Vec<u32>,
}

/// What a metal of this lobe mirrors beside lights, radiance per node of the first of all nodes around; `None` where diffuse colours explain it
/// as well.
pub fn beside(
    solver: &Solver<'_>,
    brdf: Brdf,
    lights: &[[f32; 3]],
) -> Result<Option<BroadLight>, Stopped> {
    let around = AllAround::on_cells_of(solver, FREQUENCY);
    let whole = around.solver(solver);
    let mut nodes = lights.to_vec();
    nodes.resize(whole.grid.directions.len(), [0.0; 3]);
    let observations = whole.colours(POINTS).measured();
    let cells = whole.pyramid.roots();
    let found = mirrored_in(&whole, &observations, &cells, (brdf, &nodes));
    if solver.stop.load(Ordering::Relaxed) {
        return Err(Stopped);
    }
    Ok(found.map(|radiance| {
        let own = add(&whole, &mut nodes, (&cells, &radiance));
        let grid = whole.grid.clone();
        BroadLight { grid, nodes, own }
    }))
}

/// By how many standard deviations light from all around explains views left out better than diffuse colours do, beside the lights of a state
/// of a metal, at the points of a kind. A metal mirrors all that it shows, and what has a diffuse part shows mostly that: on path-traced
/// captures it was 4.7 and more of metals, in the dark and in rooms, and below −4.9 of others.
pub fn against_colours(
    solver: &Solver<'_>,
    metal: &State<'_>,
    is_asked: impl Fn(&Point) -> bool,
) -> Result<f64, Stopped> {
    let mut nodes = solver.nodes(&metal.cells, &metal.radiance);
    let around = AllAround::on_cells_of(solver, ROUGH_FREQUENCY);
    let whole = around.solver(solver);
    nodes.resize(whole.grid.directions.len(), [0.0; 3]);
    let observations = whole.colours(FEWER_POINTS).measured().of_points(is_asked);
    let cells = whole.pyramid.roots();
    let deviations = against_colours_in(&whole, &observations, &cells, (metal.brdf, &nodes));
    if solver.stop.load(Ordering::Relaxed) {
        return Err(Stopped);
    }
    Ok(deviations)
}

/// The same of light on some cells beside lights of a radiance per node.
pub(super) fn against_colours_in(
    solver: &Solver<'_>,
    observations: &Observations,
    cells: &[Cell],
    metal: (Brdf, &[[f32; 3]]),
) -> f64 {
    let mirror = Mirror::of(solver, observations, cells, metal);
    mirror.against_colours().map_or(0.0, |told| told.deviations)
}

/// Radiance of each of some cells, RGB, in units of the observations' scale, that a metal mirrors beside lights of a radiance per node; `None`
/// where diffuse colours explain views left out as well.
pub(super) fn mirrored_in(
    solver: &Solver<'_>,
    observations: &Observations,
    cells: &[Cell],
    (brdf, lights): (Brdf, &[[f32; 3]]),
) -> Option<Vec<[f32; 3]>> {
    Mirror::of(solver, observations, cells, (brdf, lights)).light_around()
}

/// Adds light of cells, smoothly, to nodes that are dark; which they are.
pub fn add(
    whole: &Solver<'_>,
    nodes: &mut [[f32; 3]],
    (cells, radiance): (&[Cell], &[[f32; 3]]),
) -> Vec<u32> {
    let directions = whole.pyramid.geometry(cells).directions;
    let width = 0.5 * whole.pyramid.spacing(0);
    let at = |direction: Vec3| {
        let (mut sum, mut total) = (Vec3::ZERO, 0.0);
        for (middle, light) in directions.iter().zip(radiance) {
            // Twice 1 − cos of an angle is the square of its chord.
            let chords = middle.distance_squared(direction) / (width * width);
            if chords < FARTHEST {
                let weight = (-0.5 * chords).exp();
                sum += weight * Vec3::from(*light);
                total += weight;
            }
        }
        whole.coarse.scale * sum / total.max(f32::MIN_POSITIVE)
    };
    let around = nodes.par_iter_mut().zip(&whole.grid.directions).enumerate();
    around
        .filter_map(|(node, (radiance, &direction))| {
            let light = at(direction);
            let is_added = *radiance == [0.0; 3] && light != Vec3::ZERO;
            is_added.then(|| {
                *radiance = light.to_array();
                node as u32
            })
        })
        .collect()
}

/// Radiance per node of light on the coarsest cells, smoothly.
pub fn smooth_nodes(whole: &Solver<'_>, cells: &[Cell], radiance: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let mut nodes = vec![[0.0; 3]; whole.grid.directions.len()];
    add(whole, &mut nodes, (cells, radiance));
    nodes
}

/// Rows of points without what lights show in them.
struct Mirror<'s> {
    observations: &'s Observations,
    /// What is left of each row, and the mean of its channels.
    left: Vec<[f32; 3]>,
    gray: Vec<f32>,
    /// What unit radiance of each cell shows in each row, row by row.
    shown: Vec<f32>,
    cells: usize,
    joined: Vec<[usize; 2]>,
    stop: &'s AtomicBool,
}

/// What views left out say of light all around.
struct Told {
    /// By how many standard deviations it explains them better than diffuse colours do.
    deviations: f64,
    /// How much its cells are held together where it explains most.
    smoothness: f64,
}

impl<'s> Mirror<'s> {
    /// What lights of a radiance per node leave, with a lobe.
    fn of(
        solver: &'s Solver<'_>,
        observations: &'s Observations,
        cells: &[Cell],
        (brdf, lights): (Brdf, &[[f32; 3]]),
    ) -> Self {
        let design = solver.shadowed_design(observations, cells, &brdf);
        let held = HeldLights::of(solver, brdf, lights);
        let lit = solver.shadowed_design(observations, &held.cells, &brdf);
        let by_lights = lit.predict_values(&brdf, &held.radiance);
        let rows = observations.rows.iter().zip(by_lights);
        let left = rows.map(|(row, light)| (Vec3::from(row.radiance) - Vec3::from(light)).into());
        let left: Vec<[f32; 3]> = left.collect();
        Self {
            observations,
            gray: left.iter().map(|&z| mean(z)).collect(),
            left,
            shown: design.matrix(&brdf),
            cells: cells.len(),
            joined: solver.pyramid.joined(cells),
            stop: solver.stop,
        }
    }

    /// Radiance of each cell, RGB, in units of the observations' scale; `None` where diffuse colours explain views left out as well.
    fn light_around(&self) -> Option<Vec<[f32; 3]>> {
        // In the dark there is nothing to be told.
        let all = self.light(&self.gray, SMOOTHNESS[0], |_| true);
        let rows = 0..self.gray.len();
        let shown: f64 = rows.map(|k| self.predicted(k, &all)).sum();
        let rows = self.observations.rows.iter();
        let seen: f64 = rows.map(|row| f64::from(mean(row.radiance))).sum();
        if shown <= NEGLIGIBLE * seen {
            return None;
        }
        let told = self.against_colours()?;
        if told.deviations <= SURE {
            return None;
        }
        let channels = [0, 1, 2].map(|c| {
            let left: Vec<f32> = self.left.iter().map(|z| z[c]).collect();
            self.light(&left, told.smoothness, |_| true)
        });
        let of_cell = |k: usize| channels.each_ref().map(|x| x[k] as f32);
        Some((0..self.cells).map(of_cell).collect())
    }

    /// What views left out say; `None` where there is nothing to say it of.
    fn against_colours(&self) -> Option<Told> {
        let judged = |&smoothness: &f64| {
            let left = self.left_out(smoothness);
            let by_light = left.iter().map(|(_, _, own)| own).sum::<f64>();
            (by_light, smoothness, left)
        };
        let tried = SMOOTHNESS.par_iter().map(judged);
        let (_, smoothness, left) = tried.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(Told {
            deviations: placed_signed_ranks(&left),
            smoothness,
        })
    }

    /// What diffuse colours and broad light leave of each point in views that had no say, with its place.
    fn left_out(&self, smoothness: f64) -> Vec<(Vec3, f64, f64)> {
        let Observations { points, rows, .. } = self.observations;
        let left = &self.gray;
        let mut sums: Vec<(Vec3, f64, f64)> =
            points.iter().map(|p| (p.position, 0.0, 0.0)).collect();
        for turn in 0..TURNS {
            let is_out = |k: usize| rows[k].view % TURNS == turn;
            let x = self.light(left, smoothness, |k| !is_out(k));
            for (point, (_, by_colour, by_light)) in points.iter().zip(&mut sums) {
                let mut kept: Vec<f32> = point
                    .rows
                    .clone()
                    .filter(|&k| !is_out(k))
                    .map(|k| left[k])
                    .collect();
                if kept.is_empty() {
                    continue;
                }
                let colour = median(&mut kept);
                for k in point.rows.clone().filter(|&k| is_out(k)) {
                    *by_colour += f64::from((left[k] - colour).abs());
                    *by_light += (f64::from(left[k]) - self.predicted(k, &x)).abs();
                }
            }
        }
        sums
    }

    fn row(&self, k: usize) -> &[f32] {
        &self.shown[k * self.cells..(k + 1) * self.cells]
    }

    fn predicted(&self, k: usize, x: &[f64]) -> f64 {
        let products = self.row(k).iter().zip(x).map(|(&a, x)| f64::from(a) * x);
        products.sum()
    }

    /// The light that rows say which have a say, one channel of which is `left`.
    fn light(
        &self,
        left: &[f32],
        smoothness: f64,
        has_say: impl Fn(usize) -> bool + Sync,
    ) -> Vec<f64> {
        let heard: Vec<usize> = (0..left.len()).filter(|&k| has_say(k)).collect();
        let mut x = vec![0.0; self.cells];
        let mut residuals: Vec<f32> = Vec::new();
        for round in 0..ROUNDS {
            if self.stop.load(Ordering::Relaxed) {
                break;
            }
            let weights = self.weights(&heard, &residuals);
            self.improve(&heard, (left, &weights), smoothness, &mut x);
            if round + 1 < ROUNDS {
                let residual = |&k: &usize| left[k] - self.predicted(k, &x) as f32;
                residuals = heard.par_iter().map(residual).collect();
            }
        }
        x
    }

    /// Square roots of the weights of rows, by their image detail and what was left of them: as under Cauchy's distribution.
    fn weights(&self, heard: &[usize], residuals: &[f32]) -> Vec<f32> {
        let size = |k: usize| magnitude(self.left[k]);
        let mut sizes: Vec<f32> = if residuals.is_empty() {
            heard.iter().map(|&k| size(k)).collect()
        } else {
            residuals.iter().map(|r| r.abs()).collect()
        };
        let usual = median(&mut sizes).max(f32::MIN_POSITIVE);
        let of = |(i, &k): (usize, &usize)| {
            let residual = residuals.get(i).copied().unwrap_or(0.0);
            let detail = self.observations.rows[k].detail;
            (1.0 + (residual / usual).powi(2) + (detail / usual).powi(2))
                .sqrt()
                .recip()
        };
        heard.iter().enumerate().map(of).collect()
    }

    fn improve(
        &self,
        heard: &[usize],
        (left, weights): (&[f32], &[f32]),
        smoothness: f64,
        x: &mut [f64],
    ) {
        let n = self.cells;
        let rows = Mat::from_fn(heard.len(), n, |i, c| weights[i] * self.row(heard[i])[c]);
        let said = Mat::from_fn(heard.len(), 1, |i, _| weights[i] * left[heard[i]]);
        let (gram, right) = (rows.transpose() * &rows, rows.transpose() * &said);
        let mut gram = Mat::from_fn(n, n, |i, j| f64::from(gram[(i, j)]));
        let right: Vec<f64> = (0..n).map(|i| f64::from(right[(i, 0)])).collect();
        let diagonal = (0..n).map(|i| gram[(i, i)]).sum::<f64>() / n as f64;
        hold_together(&mut gram, &self.joined, smoothness * diagonal);
        let params = NnlsParams {
            stop: Some(self.stop),
            ..NnlsParams::default()
        };
        nnls::solve(gram.as_ref(), &right, x, &params);
    }
}

fn mean(z: [f32; 3]) -> f32 {
    z.iter().sum::<f32>() / 3.0
}
