//! Light from shading, where no gloss tells of it.
//!
//! The albedo of a surface mostly stays the same from one point to the next, and the light on it does not. So the light x ≥ 0 on
//! broad cells all around is sought under which the albedos ρ = (D + d)/(E(x) + e) of neighbouring points differ least, as the
//! minimum of
//!
//! `Σ log(1 + log²(ρ₁/ρ₂)/κ²) + λ Σ (xᵢ − xⱼ)²`
//!
//! with E of mean 1. Edges of the texture say little there, nor does what is nearly black: d and e are a part of the means. It is
//! what Retinex takes for shading (Land and McCann, "Lightness and Retinex theory", 1971), with shape and shadows known. λ is
//! what explains points that had no say best. The channels are then sought one by one, each with a mean of 1: the
//! light is white on the whole, and known up to its strength. What the cells show is then told as [`discs`], to a fraction of a degree, and
//! where highlights have told lights, these are a witness of them ([`agreement`]).

use std::f64::consts::PI;
use std::sync::atomic::{AtomicBool, Ordering};

use faer::Mat;
use glam::Vec3;
use rayon::prelude::*;
use rstar::RTree;
use rstar::primitives::GeomWithData;

mod agreement;
mod discs;
mod region;

use super::cells::{Cell, CellGeometry, Pyramid};
use super::fast::Solver;
use super::lobes::light_from;
use super::neighbours::Neighbours;
use super::observations::{Observations, Point};
use super::weights::{magnitude, median};
pub use agreement::Agreement;
use discs::{Discs, Fitting};
use region::Receivers;
use rekindle_base::math::nnls::{self, NnlsParams};
use rekindle_base::math::ranks::{SURE, placed_signed_ranks, signed_ranks};
use rekindle_scene::hemisphere::{HemisphereGrid, find_lamps};

/// Receivers that are looked at, and frequency of the grid of the cells: 162 of them, 16° apart.
const POINTS: usize = 3000;
const FREQUENCY: u32 = 4;

/// How often cells that are not nearly dark are split, if that says more of other points, and which part of the brightest is dark.
const SPLITS: usize = 2;
const DIM: f64 = 0.02;
/// More cells than this are as fine as shading tells.
const MOST_CELLS: usize = 300;

/// Part of the mean irradiance that the brightest cells give, which are kept.
const MOST: f64 = 0.9;

/// How much cells are held to their neighbours, as parts of the mean diagonal of the equations.
const SMOOTHNESS: [f64; 5] = [1e-3, 1e-2, 0.1, 1.0, 10.0];

/// Rounds in which weights and light take turns, and the change of the light that ends them, relative.
const ROUNDS: usize = 12;
const SETTLED: f64 = 1e-2;
/// Part of the means of radiance and irradiance that counts as nearly black.
const DARK: f64 = 0.1;
/// Difference that noise makes at least.
const LEAST_DIFFERENCE: f64 = 0.01;

/// Mean albedo that an object is taken to have, as the light's strength is open.
pub const MEAN_ALBEDO: f64 = 0.5;

/// What shading is looked at on.
struct Shading<'a> {
    stop: &'a AtomicBool,
    /// Mean diffuse radiance, gray, in units of the observations' scale.
    usual: f64,
    /// That of each point over the mean, or that of one channel.
    radiance: Vec<f64>,
    /// Mean over the points of the irradiance by unit radiance of each cell.
    mean: Vec<f64>,
    /// Irradiance of each point by unit radiance of each cell, point by point.
    irradiance: Vec<Vec<f64>>,
    /// Neighbours.
    pairs: &'a [[usize; 2]],
    /// Cells that lie beside each other.
    joined: Vec<[usize; 2]>,
}

/// The light that shading tells.
pub struct LightByShading {
    /// Nodes all around.
    grid: HemisphereGrid,
    pyramid: Pyramid,
    cells: Vec<Cell>,
    /// Radiance of each cell, RGB, in the capture's units.
    radiance: Vec<[f32; 3]>,
    /// Radiance of each node, RGB, by discs where these say more than cells.
    nodes: Vec<[f32; 3]>,
}

impl LightByShading {
    /// What makes the albedos evener than light from everywhere would, beyond chance; `None` where nothing does.
    pub fn of(solver: &Solver<'_>) -> Option<Self> {
        let grid = solver.grid.to_whole();
        let pyramid = Pyramid::new(&grid, FREQUENCY);
        let observations = solver.colours(POINTS).measured();
        let mut cells = pyramid.roots();
        let pairs = pairs(&observations.points);
        let mut shading = Shading::new(solver, &observations, &pyramid, &cells, &pairs);
        let beside = shading.beside(solver, &observations.points, &pyramid.geometry(&cells));
        let (smoothness, mut judged) = shading.smoothness()?;
        for _ in 0..SPLITS {
            let x = shading.light(shading.pairs, smoothness);
            let finer = lit_children(&pyramid, &cells, &x);
            if finer.len() > MOST_CELLS {
                break;
            }
            let on_finer = Shading::new(solver, &observations, &pyramid, &finer, &pairs);
            let again = on_finer.judged(smoothness);
            if signed_ranks(&judged, &again) <= SURE {
                break;
            }
            (cells, shading, judged) = (finer, on_finer, again);
        }
        let x = shading.light(shading.pairs, smoothness);
        // The others are left to the ambient light, which is read off the texture.
        let bright = brightest(&x, &shading.mean, MOST);
        let unit = f64::from(solver.coarse.scale) * shading.usual / MEAN_ALBEDO;
        let gray = std::mem::take(&mut shading.radiance);
        let by_channel =
            [0, 1, 2].map(|channel| over_mean(&diffuse(&observations, |v| v[channel])).1);
        let channels = by_channel.each_ref().map(|radiance| {
            shading.radiance.clone_from(radiance);
            shading.light(shading.pairs, smoothness)
        });
        let of_cell = |k: usize| {
            let unit = if bright[k] { unit } else { 0.0 };
            channels.each_ref().map(|x| (unit * x[k]) as f32)
        };
        let radiance: Vec<[f32; 3]> = (0..cells.len()).map(of_cell).collect();
        let by_cells = pyramid.to_nodes(&cells, &radiance);
        let fitting = Fitting {
            on: Receivers {
                solver,
                grid: &grid,
                points: &observations.points,
            },
            radiance: &gray,
            beside: &beside,
            regions: &[],
        };
        let start = Discs::of(&find_lamps(&grid, &by_cells), &grid, &by_cells);
        let by_discs = fitting.by_discs(start, (&pairs, &judged), (&by_channel, unit));
        let nodes = by_discs.unwrap_or(by_cells);
        Some(Self {
            grid,
            pyramid,
            cells,
            radiance,
            nodes,
        })
    }

    /// The nodes, all around.
    pub fn grid(&self) -> &HemisphereGrid {
        &self.grid
    }

    /// Radiance per node, RGB.
    pub fn nodes(&self) -> &[[f32; 3]] {
        &self.nodes
    }

    /// Whether other lights make neighbouring albedos differ by no more than this one does, in most parts of the surface: what is fitted to
    /// that on coarse cells does no better than the true lights. On path-traced captures these did better by 0.8 to 3.2 deviations, others
    /// worse by 0.6 and 4.8.
    pub fn bears_out(
        &self,
        solver: &Solver<'_>,
        grid: &HemisphereGrid,
        nodes: &[[f32; 3]],
    ) -> bool {
        self.less_even_under(solver, grid, nodes) <= 0.0
    }

    /// In how many more parts of the surface other lights make neighbouring albedos differ by more than this one does than by less: standard
    /// deviations of what chance would make of it.
    pub fn less_even_under(
        &self,
        solver: &Solver<'_>,
        grid: &HemisphereGrid,
        nodes: &[[f32; 3]],
    ) -> f64 {
        let observations = solver.colours(POINTS).measured();
        let pairs = pairs(&observations.points);
        let gray = |radiance: &[[f32; 3]]| -> Vec<f64> {
            let gray = radiance.iter().map(|&l| f64::from(magnitude(l)));
            gray.collect()
        };
        let own = Shading::new(solver, &observations, &self.pyramid, &self.cells, &pairs);
        let own = own.contrasts(&pairs, &own.normalised(gray(&self.radiance)));
        let lit: Vec<usize> = (0..nodes.len())
            .filter(|&k| magnitude(nodes[k]) > 0.0)
            .collect();
        let lights: Vec<(Vec3, f32)> = lit
            .iter()
            .map(|&k| (grid.directions[k], grid.solid_angle))
            .collect();
        let radiance: Vec<[f32; 3]> = lit.iter().map(|&k| nodes[k]).collect();
        let other = Shading::under(solver, &observations, &lights, &pairs);
        let other = other.contrasts(&pairs, &other.normalised(gray(&radiance)));
        let places = pairs
            .iter()
            .map(|pair| observations.points[pair[0]].position);
        let placed: Vec<_> = (places.zip(other).zip(own))
            .map(|((at, other), own)| (at, other, own))
            .collect();
        placed_signed_ranks(&placed)
    }

    /// Directions of the cells that are lit.
    pub fn directions(&self) -> Vec<Vec3> {
        let directions = self.pyramid.geometry(&self.cells).directions.into_iter();
        let lit = directions.zip(&self.radiance);
        lit.filter(|(_, light)| light.iter().any(|&v| v > 0.0))
            .map(|(direction, _)| direction)
            .collect()
    }
}

/// Neighbouring points, the first of each pair before the second.
fn pairs(points: &[Point]) -> Vec<[usize; 2]> {
    let neighbours = Neighbours::of(points);
    let pairs = neighbours.iter().enumerate().flat_map(|(p, near)| {
        let others = near.iter().map(|&q| q as usize);
        others.filter(move |&q| p < q).map(move |q| [p, q])
    });
    pairs.collect()
}

/// Adds the squared differences of joined unknowns to normal equations, each with a weight.
pub fn hold_together(gram: &mut Mat<f64>, joined: &[[usize; 2]], weight: f64) {
    for &[i, j] in joined {
        gram[(i, i)] += weight;
        gram[(j, j)] += weight;
        gram[(i, j)] -= weight;
        gram[(j, i)] -= weight;
    }
}

/// Which of some lights give the part `most` of the mean irradiance, which is 1 and by unit strength of each is `mean`.
pub fn brightest(x: &[f64], mean: &[f64], most: f64) -> Vec<bool> {
    let share = |k: usize| x[k] * mean[k];
    let mut order: Vec<usize> = (0..x.len()).collect();
    order.sort_by(|&a, &b| share(b).total_cmp(&share(a)));
    let mut is_bright = vec![false; x.len()];
    let mut left = most;
    for k in order {
        is_bright[k] = left > 0.0;
        left -= share(k);
    }
    is_bright
}

/// The finer cells of those that are not nearly dark.
pub fn lit_children(pyramid: &Pyramid, cells: &[Cell], x: &[f64]) -> Vec<Cell> {
    let brightest = x.iter().copied().fold(0.0, f64::max);
    let lit = cells.iter().zip(x).filter(|(_, v)| **v > DIM * brightest);
    lit.flat_map(|(&cell, _)| pyramid.children(cell)).collect()
}

impl<'a> Shading<'a> {
    fn new(
        solver: &'a Solver<'_>,
        observations: &Observations,
        pyramid: &Pyramid,
        cells: &[Cell],
        pairs: &'a [[usize; 2]],
    ) -> Self {
        let geometry = pyramid.geometry(cells);
        let lights = geometry.directions.into_iter().zip(geometry.solid_angles);
        Self {
            joined: pyramid.joined(cells),
            ..Self::under(solver, observations, &lights.collect::<Vec<_>>(), pairs)
        }
    }

    /// The same under any lights, in directions and of solid angles, that are not held together.
    fn under(
        solver: &'a Solver<'_>,
        observations: &Observations,
        lights: &[(Vec3, f32)],
        pairs: &'a [[usize; 2]],
    ) -> Self {
        let (usual, radiance) = over_mean(&diffuse(observations, magnitude));
        let irradiance = |point: &Point| -> Vec<f64> {
            if solver.stop.load(Ordering::Relaxed) {
                return vec![0.0; lights.len()];
            }
            let origin = solver.occluder.offset_origin(point.position, point.normal);
            let rays = lights
                .iter()
                .enumerate()
                .filter_map(|(k, &(direction, solid_angle))| {
                    let (to, falloff) = light_from(solver.near, direction, point.position);
                    let cosine = point.normal.dot(to);
                    let value = f64::from(falloff * cosine * solid_angle);
                    (cosine > 0.0).then_some(((k, value), to, f32::INFINITY))
                });
            let mut irradiance = vec![0.0; lights.len()];
            (solver.occluder).each_occluded(origin, rays, |(k, value), is_hidden| {
                if !is_hidden {
                    irradiance[k] = value;
                }
            });
            irradiance
        };
        let irradiance: Vec<Vec<f64>> = observations.points.par_iter().map(irradiance).collect();
        let of_light = |k: usize| mean(&irradiance.iter().map(|row| row[k]).collect::<Vec<_>>());
        Self {
            stop: solver.stop,
            usual,
            radiance,
            mean: (0..lights.len()).map(of_light).collect(),
            irradiance,
            pairs,
            joined: Vec::new(),
        }
    }

    /// The smoothness by which points say most of others, and how far the albedos of pairs then differ by what others say; `None`
    /// where that is no less than under light from everywhere.
    fn smoothness(&self) -> Option<(f64, Vec<f64>)> {
        let sum = |of: &(f64, Vec<f64>)| of.1.iter().sum::<f64>();
        let judged = SMOOTHNESS.into_par_iter().map(|s| (s, self.judged(s)));
        let best = judged.min_by(|a, b| sum(a).total_cmp(&sum(b)))?;
        let even = self.normalised(vec![1.0; self.mean.len()]);
        let even = [1, 0].map(|half| self.contrasts(&self.half(half), &even));
        (signed_ranks(&even.concat(), &best.1) > SURE).then_some(best)
    }

    /// How far the albedos of pairs differ under the light that the others say.
    fn judged(&self, smoothness: f64) -> Vec<f64> {
        let judged = [0, 1].map(|half| {
            let x = self.light(&self.half(half), smoothness);
            self.contrasts(&self.half(1 - half), &x)
        });
        judged.concat()
    }

    /// Every second point's pairs.
    fn half(&self, half: usize) -> Vec<[usize; 2]> {
        every_second(self.pairs, half)
    }

    /// Irradiance of each point.
    fn lit(&self, x: &[f64]) -> Vec<f64> {
        let sum = |row: &Vec<f64>| row.iter().zip(x).map(|(f, v)| f * v).sum();
        self.irradiance.par_iter().map(sum).collect()
    }

    /// Irradiance of each point by light from everywhere, and by what the surface sends to itself, in units of the points' radiance, where
    /// the shading is of cells all around.
    fn beside(&self, solver: &Solver<'_>, points: &[Point], cells: &CellGeometry) -> [Vec<f64>; 2] {
        let everywhere = self.normalised(vec![1.0; self.mean.len()]);
        let bounced = bounced(solver, points, (&self.radiance, &cells.directions));
        [self.lit(&everywhere), bounced]
    }

    /// How far each pair's albedos differ under a light.
    fn contrasts(&self, pairs: &[[usize; 2]], x: &[f64]) -> Vec<f64> {
        contrasts(pairs, &self.radiance, &self.lit(x))
    }

    /// The light by which the mean irradiance is 1.
    fn normalised(&self, mut x: Vec<f64>) -> Vec<f64> {
        let mean = mean(&self.lit(&x));
        if mean > 0.0 {
            for v in &mut x {
                *v /= mean;
            }
        }
        x
    }

    /// The light of least differences.
    fn light(&self, pairs: &[[usize; 2]], smoothness: f64) -> Vec<f64> {
        let mut x = self.normalised(vec![1.0; self.mean.len()]);
        for _ in 0..ROUNDS {
            let next = self.improved(pairs, smoothness, &x);
            let change: f64 = next.iter().zip(&x).map(|(a, b)| (a - b).abs()).sum();
            let all: f64 = x.iter().sum();
            x = next;
            if change < SETTLED * all || self.stop.load(Ordering::Relaxed) {
                break;
            }
        }
        x
    }

    /// A Gauss-Newton step from a light, with the weights that it gives.
    fn improved(&self, pairs: &[[usize; 2]], smoothness: f64, x: &[f64]) -> Vec<f64> {
        let n = self.mean.len();
        let lit = self.lit(x);
        let differences = differences(pairs, &self.radiance, &lit);
        let (_, weights) = robust_weights(&differences);
        let slope = |p: usize, k: usize| self.irradiance[p][k] / (lit[p] + DARK);
        let rows = Mat::from_fn(pairs.len(), n, |row, k| {
            let [p, q] = pairs[row];
            weights[row] * (slope(p, k) - slope(q, k))
        });
        let here = Mat::from_fn(n, 1, |k, _| x[k]);
        let said = &rows * &here;
        let said = Mat::from_fn(pairs.len(), 1, |row, _| {
            said[(row, 0)] + weights[row] * differences[row]
        });
        let mut gram = rows.transpose() * &rows;
        let right = rows.transpose() * &said;
        let diagonal = (0..n).map(|k| gram[(k, k)]).sum::<f64>() / n as f64;
        hold_together(&mut gram, &self.joined, smoothness * diagonal);
        // Only ratios count: the mean irradiance is held.
        let held = diagonal * n as f64;
        for i in 0..n {
            for j in 0..n {
                gram[(i, j)] += held * self.mean[i] * self.mean[j];
            }
        }
        let right: Vec<f64> = (0..n)
            .map(|k| right[(k, 0)] + held * self.mean[k])
            .collect();
        let params = NnlsParams {
            stop: Some(self.stop),
            ..NnlsParams::default()
        };
        let mut next = x.to_vec();
        nnls::solve(gram.as_ref(), &right, &mut next, &params);
        self.normalised(next)
    }
}

/// Irradiance of each point by what the surface sends to itself, in units of the points' radiance, looked at in directions all around.
fn bounced(
    solver: &Solver<'_>,
    points: &[Point],
    (radiance, directions): (&[f64], &[Vec3]),
) -> Vec<f64> {
    let placed = points.iter().zip(radiance);
    let placed = placed.map(|(p, &l)| GeomWithData::new(p.position.to_array(), l));
    let tree: RTree<GeomWithData<[f32; 3], f64>> = RTree::bulk_load(placed.collect());
    let share = 4.0 * PI / directions.len() as f64;
    let at = |point: &Point| {
        let origin = solver.occluder.offset_origin(point.position, point.normal);
        let cosines = directions.iter().map(|&d| (d, point.normal.dot(d)));
        let rays = cosines
            .filter(|(_, cosine)| *cosine > 0.0)
            .map(|ray| (ray, ray.0));
        let mut sum = 0.0;
        solver
            .occluder
            .each_hit(origin, rays, |(direction, cosine), hit| {
                let place = hit.map(|hit| (origin + hit.distance * direction).to_array());
                let sender = place.and_then(|place| tree.nearest_neighbor(place));
                sum += f64::from(cosine) * sender.map_or(0.0, |sender| sender.data);
            });
        share * sum
    };
    points.par_iter().map(at).collect()
}

/// The pairs of every second point.
fn every_second(pairs: &[[usize; 2]], half: usize) -> Vec<[usize; 2]> {
    let own = pairs.iter().filter(|pair| pair[0] % 2 == half);
    own.copied().collect()
}

/// Logarithm of the ratio of each pair's albedos, by the points' radiance and irradiance, both with a mean of 1.
fn differences(pairs: &[[usize; 2]], radiance: &[f64], lit: &[f64]) -> Vec<f64> {
    let albedo = radiance.iter().zip(lit);
    let albedo: Vec<f64> = albedo
        .map(|(radiance, lit)| ((radiance + DARK) / (lit + DARK)).ln())
        .collect();
    pairs.iter().map(|&[p, q]| albedo[p] - albedo[q]).collect()
}

/// Their sizes.
fn contrasts(pairs: &[[usize; 2]], radiance: &[f64], lit: &[f64]) -> Vec<f64> {
    let differences = differences(pairs, radiance, lit).into_iter();
    differences.map(f64::abs).collect()
}

/// What is usual among differences, and the square root of the weight of each.
fn robust_weights(differences: &[f64]) -> (f64, Vec<f64>) {
    let mut sizes: Vec<f32> = differences.iter().map(|d| d.abs() as f32).collect();
    let usual = f64::from(median(&mut sizes)).max(LEAST_DIFFERENCE);
    let weight = |d: &f64| (1.0 + (d / usual).powi(2)).sqrt().recip();
    (usual, differences.iter().map(weight).collect())
}

/// Diffuse radiance of each point: the median over its views, of which few show a highlight there.
fn diffuse(observations: &Observations, channel: impl Fn([f32; 3]) -> f32) -> Vec<f64> {
    let of = |point: &Point| {
        let rows = observations.rows[point.rows.clone()].iter();
        let mut values: Vec<f32> = rows.map(|row| channel(row.radiance)).collect();
        f64::from(median(&mut values))
    };
    observations.points.iter().map(of).collect()
}

/// The mean of values, and each over it.
fn over_mean(values: &[f64]) -> (f64, Vec<f64>) {
    let mean = mean(values).max(f64::MIN_POSITIVE);
    (mean, values.iter().map(|v| v / mean).collect())
}

/// The mean; 0 of nothing.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}
